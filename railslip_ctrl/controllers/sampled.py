"""Sampled linear controllers: difference equations with torque limits and anti-windup, and the exact sampled loop.

Tustin's rule replaces s by 2/h (z - 1)/(z + 1), and the backward difference replaces s by (z - 1)/(h z). h is the
sampling period ([Astrom1997] 8).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import StrEnum
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import numpy as np

from railslip_ctrl.core.arguments import Complexes, Floats, check_fields, checked, number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.loop import Rational
from railslip_ctrl.loop.rational import realise
from railslip_ctrl.loop.sampled import MOST_PERIODS, SampledLoop, check_period
from railslip_ctrl.model.linearization import LinearPlant, OperatingPoint
from railslip_ctrl.model.vehicle import Actuator

from .base import PERIOD, Controller
from .systems import (
    LinearController,
    PIController,
    StateSpaceController,
    actuated_plant,
    linear_controller,
)

_SLOWEST = 1e-9  # zeros and poles with a magnitude below this, relative to 1/h, are treated as 0
_LEAST_RATIO = 1.01  # smallest ratio of rates at which a pole is moved; rounding splits double poles by 1e-8
# `sampled_peak`: smallest magnitude of poles that cause a peak; lowest frequency relative to the slowest feature;
# points of the grid; points of a refinement; number of refinements
_NEAR_CIRCLE, _LOWEST, _GRID, _FINE_GRID, _REFINEMENTS = 0.5, 1e-3, 200, 13, 6
_AT_INFINITY = 1e-12  # relative distance from 2/h (backward: 1/h) below which a root maps to infinity in z


class Rule(StrEnum):
    """Discretisation rule, which replaces s by a function of z."""

    TUSTIN = "tustin"
    BACKWARD = "backward"


@dataclass(frozen=True)
class SampledController:
    """Linear controller at a fixed period, with torque limits and anti-windup by back-calculation ([Astrom1997] 9).

    The continuous design is x' = A x + B e, torque = C x + D e. The states of a `PIController` are the integral part of
    the torque and, if it has a lead or a filter, the error filtered by 1/(lead_filter s + 1). At sample k::

        x[k] = phi x[k-1] + now e[k] + before e[k-1] + back (acted[k-1] - unlimited[k-1])
        unlimited[k] = C x[k] + D e[k],    torque[k] = unlimited[k] within the limits

    The matrices `phi`, `now` and `before` follow from `rule`, or are those of a discrete design. `acted` is the torque
    that the brake applied; it differs from `unlimited` while a limit acts. While it differs, the gains `back` make slow
    states decay, for example an integrator: the poles and zeros of the design are sorted by magnitude and paired. A
    pole that is slower than its zero moves to z = 1 - h/T, where 1/T is the magnitude of the zero. Other
    poles do not move. If every pole moves to its zero, the result is the conditioned controller of [Hanus1987].

    - design: linear system that `systems.linear_controller` accepts; the field contains the result of this function.
    - period: h, s, > 0; for a discrete design its period. With Tustin's rule no real pole may be faster than 2/h; its
      response would alternate in sign.
    - torque_min, torque_max: limits of the command, N*m, torque_min < torque_max; for a brake 0 and the full brake.
    - rule: Tustin's rule or the backward difference.
    - tracking_time: T of the slowest pole, s, >= h; inf: no anti-windup. By default 1/T is the magnitude of the slowest
      zero (for a PI T = kp/ki). If there are fewer zeros than poles, each missing zero is replaced by a zero with the
      magnitude of the fastest pole, or 1/h if all poles are 0.

    InputError: a design that is not linear, or a period, limit or tracking time that is not allowed.
    """

    design: Any
    period: float
    torque_min: float = -math.inf
    torque_max: float = math.inf
    rule: Rule = Rule.TUSTIN
    tracking_time: float | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        object.__setattr__(self, "design", linear_controller(self.design))
        h = check_period(self.period)
        _check_rule(self.design, self.rule, h)
        if not self.torque_min < self.torque_max:
            raise InputError(
                f"torque limits: low {self.torque_min:g} and high {self.torque_max:g} N*m are not allowed; give "
                "low < high"
            )
        if self.tracking_time is not None and not self.tracking_time >= h:
            raise InputError(
                f"tracking time: {self.tracking_time:g} s is not allowed; give a value >= the period {h:g} (s)"
            )

    @property
    def as_run(self) -> SampledController:
        """Return this object, which can be simulated without changes."""
        return self

    def linear(self, point: OperatingPoint) -> LinearController:
        """Return the linear design, which does not depend on the operating point."""
        return self.design  # type: ignore[no-any-return]

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states of the difference equations, in their order."""
        return state_names(self.design)

    @cached_property
    def numbers(self) -> Mapping[str, Any]:
        """Parameters that `linear_step` reads; the keys are their names."""
        phi, now, before, c, d = _difference(self.design, self.rule, self.period)
        arrays = {"output": c, "now": now, "before": before, "tracking": self._back(phi, c), "transition": phi.ravel()}
        limits = {"torque_min": self.torque_min, "torque_max": self.torque_max}
        return {**limits, "direct": float(d), **{name: tuple(map(float, each)) for name, each in arrays.items()}}

    def _back(self, phi: Floats, c: Floats) -> Floats:
        rates, h = self._tracking_rates, self.period
        if isinstance(self.design, PIController):  # only the integral winds up, not the filtered error
            return np.append(h * rates, np.zeros(c.size - 1))
        slow = (phi[1:, 1:] - np.eye(c.size - 1)) / h if self.design.period else _continuous(self.design)[0][1:, 1:]
        return np.append(0.0, _back_calculation(phi[1:, 1:], slow, c[1:], h, rates))

    @cached_property
    def _tracking_rates(self) -> Floats:
        system, h = self.design.transfer_function, self.period
        if isinstance(self.design, PIController):
            gains = self.design.gains
            rates = np.array([0.0 if gains.ki == 0 else abs(gains.ki / gains.kp) if gains.kp != 0 else math.inf])
        else:
            roots = (system.zeros, system.poles)
            zeros, poles = (np.abs(each if self.design.period is None else (each - 1) / h) for each in roots)
            fastest = np.max(poles, initial=0.0)
            missing = fastest if fastest > _SLOWEST / h else math.inf
            rates = np.sort(np.append(zeros, np.full(system.relative_degree, missing)))
        if self.tracking_time is not None:
            rates[:1] = np.where(rates[:1] > 0, 1 / self.tracking_time, 0.0)
        return np.zeros(rates.size) if self.tracking_time == math.inf else np.minimum(rates, 1 / h)

    def start(self, torque: float = 0.0) -> SimpleNamespace:
        """Return a state that commands the `torque`, N*m, at zero error; InputError if it is outside the limits."""
        if not self.torque_min <= torque <= self.torque_max:
            raise InputError(
                f"initial torque: {torque:g} N*m is not allowed; give a value from {self.torque_min:g} to "
                f"{self.torque_max:g} (N*m)"
            )
        return SimpleNamespace(
            **{name: list(x) if isinstance(x, tuple) else x for name, x in self.at_rest(torque).items()}
        )

    def at_rest(self, torque: float) -> dict[str, Any]:
        """Return the names and values of all fields of a state that commands a constant `torque`, N*m."""
        rest = (0.0,) * (len(self.states) - 1)
        return {"error": 0.0, "unlimited_torque": torque, "states": (torque, *rest), "room": (0.0, *rest)}

    def step(self, state: Any, error: float, applied: float | None = None) -> float:
        """Return the torque to command until the next sample, N*m, and update `state`.

        - state: initially the result of `start`.
        - error: slip error lambda_d v - sigma, m/s; if it is not finite, state and torque do not change.
        - applied: torque that the brake applied since the previous sample, N*m; by default the last command.
        """
        if applied is None:
            applied = min(max(state.unlimited_torque, self.torque_min), self.torque_max)
        return float(linear_step(state, self._parameters, error, applied))

    @cached_property
    def _parameters(self) -> SimpleNamespace:
        return SimpleNamespace(**self.numbers)

    @cached_property
    def transfer_function(self) -> Rational:
        """Transfer function C(z) while no limit acts; an integrator has its pole exactly at z = 1."""
        system: Rational = self.design.transfer_function
        if not isinstance(self.design, PIController) and self.design.period is not None:
            return system
        h = self.period
        above, zeros = _mapped(system.zeros, self.rule, h)
        below, poles = _mapped(system.poles, self.rule, h)
        # every factor s - root has the denominator z + 1 (Tustin's rule) or z (backward difference)
        rest = np.full(system.relative_degree, -1.0 if self.rule is Rule.TUSTIN else 0.0)
        return Rational(np.append(zeros, rest), poles, float((system.gain * above / below).real))


def linear_step(state: Any, parameters: Any, error: float, applied: float) -> Any:
    """Return the torque to command, N*m, by the equations of `SampledController`, and update `state`.

    - state: `states` and `room` (memory for new states), shape (n,) each; `error`, m/s, and `unlimited_torque`, N*m,
      of the previous sample.
    - parameters: the values of `SampledController.numbers`; `transition` has the rows of `phi` one after the other.
    - error: slip error lambda_d v - sigma, m/s; if it is not finite, the state does not change.
    - applied: torque that the brake applied since the previous sample, N*m.
    """
    if not math.isfinite(error):
        return applied
    n = len(parameters.output)
    excess = applied - state.unlimited_torque
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += parameters.transition[i * n + j] * state.states[j]
        inputs = parameters.now[i] * error + parameters.before[i] * state.error + parameters.tracking[i] * excess
        state.room[i] = total + inputs
    torque = parameters.direct * error
    for i in range(n):
        state.states[i] = state.room[i]
        torque += parameters.output[i] * state.states[i]
    state.error, state.unlimited_torque = error, torque
    return min(max(torque, parameters.torque_min), parameters.torque_max)


def _mapped(roots: Complexes, rule: Rule, h: float) -> tuple[complex, Complexes]:
    """Discretise a polynomial in s, given by its roots; return leading coefficient and roots of the numerator in z."""
    ahead, behind = (1 - roots * h / 2, 1 + roots * h / 2) if rule is Rule.TUSTIN else (1 - roots * h, 1.0 + 0 * roots)
    at_infinity = np.abs(ahead) < _AT_INFINITY
    scale = 2 / h if rule is Rule.TUSTIN else 1 / h
    leading = np.prod(np.where(at_infinity, -behind, ahead) * scale)
    return complex(leading), np.asarray(behind[~at_infinity] / ahead[~at_infinity])


def _check_rule(design: LinearController, rule: Rule, h: float) -> None:
    if isinstance(design, PIController):
        filter_time = design.lead_filter
        if rule is Rule.TUSTIN and 0 < filter_time < h / 2:
            raise InputError(
                f"period: {h:g} s is not allowed with a lead filter of {filter_time:g} s; give a value <= "
                f"{2 * filter_time:g} (s), or the backward rule"
            )
        return
    if design.period is not None:
        if not math.isclose(design.period, h):
            raise InputError(
                f"period: {h:g} s is not allowed; give the period of the discrete controller, {design.period:g} s"
            )
        return
    poles = design.transfer_function.poles
    real = poles[poles.imag == 0].real
    limit = 2.0 if rule is Rule.TUSTIN else 1.0
    rising, falling = float(np.max(real, initial=0.0)), float(np.max(-real, initial=0.0))
    fastest = max(rising, falling) if rule is Rule.TUSTIN else rising
    if rising * h >= limit or (rule is Rule.TUSTIN and falling * h > limit):
        other = ', or the backward rule (in a file rule = "backward")' if rule is Rule.TUSTIN else ""
        raise InputError(
            f"period: {h:g} s is not allowed with a pole of {fastest:g} 1/s; give a value <= {limit / fastest:.3g} (s)"
            f"{other}"
        )


def run_period(design: LinearController, period: float | None = None) -> float:
    """Return the sampling period of a design, s: for a discrete design its period, otherwise `period`.

    If `period` is None, the result is `PERIOD`, or twice the time constant of the lead's filter if that is shorter.
    """
    if not isinstance(design, PIController):
        return design.period or period or PERIOD
    return period or (min(PERIOD, 2 * design.lead_filter) if design.lead_filter > 0 else PERIOD)


def state_names(design: LinearController) -> tuple[str, ...]:
    """Return the names of the states in the difference equations of a design."""
    if isinstance(design, PIController):
        return ("integral", "lagged_error") if design.lead_filter > 0 else ("integral",)
    return ("initial_torque", *(f"x{i + 1}" for i in range(_continuous(design)[1].size - 1)))


def _continuous(design: LinearController) -> tuple[Floats, Floats, Floats, float]:
    """Return A, B, C and D. The first state is the integral part of a PI; for other designs it is a constant torque."""
    if isinstance(design, PIController):
        kp, ki, lag = design.gains.kp, design.gains.ki, design.lead_filter
        if lag == 0:
            return np.zeros((1, 1)), np.array([ki]), np.ones(1), kp
        direct = design.lead / lag  # (lead s + 1)/(lag s + 1) = direct + (1 - direct)/(lag s + 1)
        a = np.array([[0.0, ki * (1 - direct)], [0.0, -1 / lag]])
        return a, np.array([ki * direct, 1 / lag]), np.array([1.0, kp * (1 - direct)]), kp * direct
    if isinstance(design, StateSpaceController):
        inner, b, c, d = np.array(design.a, dtype=float), np.array(design.b), np.array(design.c), design.d
    else:
        system = realise(design.transfer_function)
        inner, b, c, d = system.a, system.b, system.c, system.d
    n = b.size
    a = np.zeros((n + 1, n + 1))
    a[1:, 1:] = inner.reshape(n, n)
    return a, np.append(0.0, b), np.append(1.0, c), d


def _difference(design: LinearController, rule: Rule, h: float) -> tuple[Floats, Floats, Floats, Floats, float]:
    """Return `phi`, `now`, `before`, C and D as in `SampledController`; `h` is the period, s."""
    a, b, c, d = _continuous(design)
    identity = np.eye(b.size)
    if not isinstance(design, PIController) and design.period is not None:
        a[0, 0] = 1.0
        return a, 0.0 * b, b, c, d
    if rule is Rule.BACKWARD:
        inverse = np.linalg.inv(identity - h * a).astype(float)
        return inverse, inverse @ (b * h), 0.0 * b, c, d
    inverse = np.linalg.inv(identity - h / 2 * a).astype(float)
    share = inverse @ (b * h * 0.5)
    return inverse @ (identity + h / 2 * a), share, share, c, d


def _back_calculation(phi: Floats, slow: Floats, c: Floats, h: float, rates: Floats) -> Floats:
    """Return the gains `back` of `SampledController`, which move slow poles to z = 1 - h rate with the given `rates`.

    The matrices `slow` and `phi` have equal invariant subspaces. The eigenvalues of `slow` are the poles in s, or
    (z - 1)/h for a discrete design.
    """
    from scipy.linalg import schur

    poles = np.linalg.eigvals(slow)
    poles = poles[np.argsort(np.abs(poles))]
    decays = np.minimum(np.abs(poles), -2 * poles.real)  # the second is smaller for a damping ratio below 0.5
    moved = np.flatnonzero(rates > decays * _LEAST_RATIO)
    if not moved.size:
        return np.zeros(c.size)
    limit = abs(poles[moved[-1]]) * (1 + 1e-6) + _SLOWEST / h
    _, basis, count = schur(slow, output="real", sort=lambda re, im: math.hypot(re, im) <= limit)
    basis, identity = basis[:, :count], np.eye(count)
    # Ackermann's formula in (z - 1)/h, in which poles near z = 1 are well separated
    inner, row = (basis.T @ phi @ basis - identity) / h, c @ basis
    observed = np.array([row @ np.linalg.matrix_power(inner, k) for k in range(count)])
    weights = np.linalg.lstsq(observed, identity[:, -1], rcond=None)[0]
    for rate in np.minimum(np.maximum(rates, decays), 1 / h)[:count]:
        weights = inner @ weights + rate * weights
    return np.asarray(h * basis @ weights)


@checked
def sampled_loop(
    plant: LinearPlant, controller: SampledController, actuator: Actuator, *, computation: float = 0.0
) -> SampledLoop:
    """Return the exact sampled wheel-slip loop of a linear wheel, a sampled controller and an actuator.

    `computation` is the computing time of a sample, s, >= 0, which is added to the actuator's dead time.
    """
    extra = number("computation", computation, "s", ge=0)
    return SampledLoop(
        controller.transfer_function, actuated_plant(plant, actuator), actuator.dead_time + extra, controller.period
    )


def loop_as_run(plant: LinearPlant, controller: Any, actuator: Actuator) -> Any:
    """Return the sampled loop of a controller at its sampling period.

    None if the controller has no sampling period, or if the dead time has more than `MOST_PERIODS` periods.
    """
    if isinstance(controller, Controller) and (own := controller.loop_as_run(plant.point, actuator)) is not None:
        return own
    sampled = getattr(controller, "as_run", None)
    if sampled is None or actuator.dead_time > MOST_PERIODS * sampled.period:
        return None
    return sampled_loop(plant, sampled, actuator)


def sampled_peak(loop: SampledLoop) -> float:
    """Return Ms of a sampled loop, computed on a refined grid of frequencies; inf if the loop is unstable.

    The grid includes the angles of the poles near the unit circle. The method `margins` of the loop is exact but
    slower.
    """
    if not loop.is_stable():
        return math.inf
    poles = loop.closed_loop_poles()
    rings = np.abs(np.angle(poles[np.abs(poles) > _NEAR_CIRCLE])) / loop.period
    low, high = math.log(loop.feature_frequencies.min() * _LOWEST), math.log(loop.nyquist_frequency)
    return peak_near(loop, np.union1d(np.exp(np.linspace(min(low, high - 1), high, _GRID)), rings[rings > 0]))


def peak_near(loop: Any, omega: Floats) -> float:
    """Return the largest |1/(1 + L)| of a loop at frequencies `omega`, rad/s, 1-D, refined around the maximum."""
    for _ in range(_REFINEMENTS):
        size = 1 / np.abs(1 + loop.response(omega))
        top = int(np.argmax(size))
        omega = np.linspace(omega[max(top - 1, 0)], omega[min(top + 1, omega.size - 1)], _FINE_GRID)
    return float(size.max())
