"""Sampled linear controllers: difference equations with limits and anti-windup, and their exact loops.

Tustin's rule replaces s by 2/h (z - 1)/(z + 1), the backward difference by (z - 1)/(h z), with the period h
([Astrom1997] 8).
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

_SLOWEST = 1e-9  # zeros and poles with a magnitude below this, relative to 1/h, count as 0
_LEAST_RATIO = 1.01  # smallest ratio of rates at which a pole is moved; rounding splits double poles by 1e-8
# `sampled_peak`: smallest magnitude of poles that cause a peak; lowest frequency relative to the slowest feature;
# points of the grid; points of a refinement; number of refinements
_NEAR_CIRCLE, _LOWEST, _GRID, _FINE_GRID, _REFINEMENTS = 0.5, 1e-3, 200, 13, 6
_AT_INFINITY = 1e-12  # relative distance from 2/h (backward: 1/h) below which a root maps to infinity in z


class Rule(StrEnum):
    """Rule that replaces s by a function of z."""

    TUSTIN = "tustin"
    BACKWARD = "backward"


@dataclass(frozen=True)
class SampledController:
    """Linear controller at a fixed period, with torque limits and anti-windup by back-calculation ([Astrom1997] 9).

    The continuous design is x' = A x + B e, torque = C x + D e. For a `PIController` the states are the integral part
    of the torque and the error after the lead's filter. At sample k::

        x[k] = phi x[k-1] + now e[k] + before e[k-1] + back (acted[k-1] - unlimited[k-1])
        unlimited[k] = C x[k] + D e[k],    torque[k] = unlimited[k] within the limits

    phi, now and before follow exactly from the rule, or are those of a discrete design. `acted` is the torque that the
    brake applied. While a limit acts, `back` moves the slow poles and leaves the poles of leads and filters unchanged.
    To find the slow poles, poles and zeros are sorted by magnitude and paired; a pole slower than its zero moves to z =
    1 - h/T, where 1/T is the magnitude of the zero. If all poles move to the zeros, the result is the conditioned
    controller of [Hanus1987]: its states are those for an error that gives exactly the applied torque. For a PI the
    result is back-calculation with Tt = kp/ki. `linear_step` evaluates the equations.

    - design: linear system, as for `systems.linear_controller`; the field is the record that this function returns.
    - period: h, s, > 0; for a discrete design the period of the design. With Tustin's rule no real pole may be faster
      than 2/h, because its response would alternate in sign.
    - torque_min, torque_max: limits of the command, N*m, torque_min < torque_max; for a brake 0 and the full brake.
    - rule: Tustin's rule or the backward difference.
    - tracking_time: Tt of the slowest pole, often an integrator, s, >= h; inf: no anti-windup. The default is the time
      constant of the slowest zero (for a PI kp/ki). If there are fewer zeros than poles, the magnitude of the fastest
      pole replaces the missing zeros, or 1/h if all poles are 0.

    InputError: a design that is not linear, or a period, limit or tracking time out of its range.
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
        """Sampled controller that a run uses: this object."""
        return self

    def linear(self, point: OperatingPoint) -> LinearController:
        """Return the design, which is the same at every operating point."""
        return self.design  # type: ignore[no-any-return]

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states of the difference equations, in their order."""
        return state_names(self.design)

    @cached_property
    def numbers(self) -> Mapping[str, Any]:
        """Parameters of `linear_step` by name."""
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
        """Anti-windup decay rates, 1/s, slowest first: lower bounds on the decay of the poles while a limit acts."""
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
        """Return the state in which a constant `torque`, N*m, is commanded as long as the error is 0.

        InputError if the torque is outside the limits.
        """
        if not self.torque_min <= torque <= self.torque_max:
            raise InputError(
                f"initial torque: {torque:g} N*m is not allowed; give a value from {self.torque_min:g} to "
                f"{self.torque_max:g} (N*m)"
            )
        return SimpleNamespace(
            **{name: list(x) if isinstance(x, tuple) else x for name, x in self.at_rest(torque).items()}
        )

    def at_rest(self, torque: float) -> dict[str, Any]:
        """Return the fields of the state of `start`, for a constant `torque`, N*m."""
        rest = (0.0,) * (len(self.states) - 1)
        return {"error": 0.0, "unlimited_torque": torque, "states": (torque, *rest), "room": (0.0, *rest)}

    def step(self, state: Any, error: float, applied: float | None = None) -> float:
        """Return the torque to command until the next sample, N*m, and update `state`.

        - state: from `start`.
        - error: slip error lambda_d v - sigma, m/s.
        - applied: torque that the brake applied since the previous sample, N*m; by default the last command. Give it if
          something besides the controller's limits changed the torque.

        If the error is not finite, state and torque do not change.
        """
        if applied is None:
            applied = min(max(state.unlimited_torque, self.torque_min), self.torque_max)
        return float(linear_step(state, self._parameters, error, applied))

    @cached_property
    def _parameters(self) -> SimpleNamespace:
        return SimpleNamespace(**self.numbers)

    @cached_property
    def transfer_function(self) -> Rational:
        """Transfer function C(z) of the equations without limits; the pole of an integrator is exactly 1."""
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

    - state: `states` and `room` (n each), `error` (m/s) and `unlimited_torque` (N*m) of the previous sample.
    - parameters: `output`, `now`, `before`, `tracking` (n each), `transition` (n by n, by rows), `direct`, limits.
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
    """Return gain and roots in z of the product of all s - root, without the denominators of the rule."""
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
                f"period: {h:g} s is not allowed; give that of the discrete controller, {design.period:g} s"
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
    """Return the sampling period of a design, s: its own period if it is discrete, else `period`.

    The default of `period` is `PERIOD`, or twice the time constant of the lead's filter if that is shorter.
    """
    if not isinstance(design, PIController):
        return design.period or period or PERIOD
    return period or (min(PERIOD, 2 * design.lead_filter) if design.lead_filter > 0 else PERIOD)


def state_names(design: LinearController) -> tuple[str, ...]:
    """Return the names of the states of a design's difference equations."""
    if isinstance(design, PIController):
        return ("integral", "lagged_error") if design.lead_filter > 0 else ("integral",)
    return ("initial_torque", *(f"x{i + 1}" for i in range(_continuous(design)[1].size - 1)))


def _continuous(design: LinearController) -> tuple[Floats, Floats, Floats, float]:
    """Return A, B, C, D; the first state is the integral part of a PI's torque, for other designs a constant torque."""
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
    """Return phi, now, before, C and D of the difference equations of `SampledController`."""
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
    """Return the gains on acted - unlimited that move slow poles of phi to 1 - h rate; see `SampledController`.

    The matrix `slow` has the invariant subspaces of phi; its poles are those of the design in s, or (z - 1)/h. The
    function applies Ackermann's formula to the subspace of the poles up to the fastest one that moves. It uses the
    variable (z - 1)/h, in which poles near z = 1 are well separated. Modes that are unobservable in the torque do not
    move.
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
    inner, row = (basis.T @ phi @ basis - identity) / h, c @ basis
    observed = np.array([row @ np.linalg.matrix_power(inner, k) for k in range(count)])
    weights = np.linalg.lstsq(observed, identity[:, -1], rcond=None)[0]
    for rate in np.minimum(np.maximum(rates, decays), 1 / h)[:count]:
        weights = inner @ weights + rate * weights
    return np.asarray(h * basis @ weights)


# --- margins of sampled loops -----------------------------------------------------------------------------------------


@checked
def sampled_loop(
    plant: LinearPlant, controller: SampledController, actuator: Actuator, *, computation: float = 0.0
) -> SampledLoop:
    """Return the exact wheel-slip loop with a sampled controller.

    `computation` is the computing time of a sample, s, >= 0, which is added to the actuator's dead time.
    """
    extra = number("computation", computation, "s", ge=0)
    return SampledLoop(
        controller.transfer_function, actuated_plant(plant, actuator), actuator.dead_time + extra, controller.period
    )


def loop_as_run(plant: LinearPlant, controller: Any, actuator: Actuator) -> Any:
    """Return the sampled loop of a controller at its sampling period.

    None if the controller has no period, or if the period is so short that sampling makes no difference.
    """
    if isinstance(controller, Controller) and (own := controller.loop_as_run(plant.point, actuator)) is not None:
        return own
    sampled = getattr(controller, "as_run", None)
    if sampled is None or actuator.dead_time > MOST_PERIODS * sampled.period:
        return None
    return sampled_loop(plant, sampled, actuator)


def sampled_peak(loop: SampledLoop) -> float:
    """Return Ms of a sampled loop, inf if the loop is unstable, from a grid of frequencies.

    The grid includes the angles of the closed-loop poles near the unit circle, where |S| has its peaks, and is refined
    around the highest peak. `margins` is exact but slower.
    """
    if not loop.is_stable():
        return math.inf
    poles = loop.closed_loop_poles()
    rings = np.abs(np.angle(poles[np.abs(poles) > _NEAR_CIRCLE])) / loop.period
    low, high = math.log(loop.feature_frequencies.min() * _LOWEST), math.log(loop.nyquist_frequency)
    return peak_near(loop, np.union1d(np.exp(np.linspace(min(low, high - 1), high, _GRID)), rings[rings > 0]))


def peak_near(loop: Any, omega: Floats) -> float:
    """Return the highest |S| on a grid of frequencies `omega`, rad/s, refined around the maximum."""
    for _ in range(_REFINEMENTS):
        size = 1 / np.abs(1 + loop.response(omega))
        top = int(np.argmax(size))
        omega = np.linspace(omega[max(top - 1, 0)], omega[min(top + 1, omega.size - 1)], _FINE_GRID)
    return float(size.max())
