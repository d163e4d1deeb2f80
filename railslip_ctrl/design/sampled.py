"""The design as a discrete controller: difference equations, anti-windup, and what sampling costs in margin.

The lead acts on the error first, the PI on its result, so that the integrator is the last state before the limits
and anti-windup acts on it alone. With Tustin's rule s = 2/h (z - 1)/(z + 1), with the backward difference
s = (z - 1)/(h z) ([Astrom1997] 8).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from railslip_ctrl.arguments import check_fields, checked, number
from railslip_ctrl.errors import InputError
from railslip_ctrl.linearization import LinearPlant
from railslip_ctrl.loop import DeadTimeLoop, Margins, Rational
from railslip_ctrl.loop.sampled_loop import SampledLoop
from railslip_ctrl.loop.sampled_system import check_period
from railslip_ctrl.parameters import Actuator

from .controllers import PIController, actuated_plant

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


class Rule(StrEnum):
    """How s becomes a difference."""

    TUSTIN = "tustin"
    BACKWARD = "backward"


class SampledState(NamedTuple):
    """What the controller remembers from one sample to the next.

    Attributes
    ----------
    integral : float
        Integral part of the torque, N*m.
    error, filtered_error : float
        Latest error and what the lead made of it, m/s.
    unlimited, torque : float
        Latest torque before and after the limits, N*m.
    """

    integral: float
    error: float
    filtered_error: float
    unlimited: float
    torque: float


@dataclass(frozen=True)
class SampledController:
    """A `PIController` at a fixed period, with torque limits and anti-windup by back-calculation ([Astrom1997] 8).

    At sample k, with e the slip-velocity error and f what the lead makes of it (f = e without one)::

        f[k] = p f[k-1] + q0 e[k] + q1 e[k-1]
        I[k] = I[k-1] + ki h (b0 f[k] + b1 f[k-1]) + (h/Tt) (acted[k-1] - unlimited[k-1])
        unlimited[k] = kp f[k] + I[k],    torque[k] = unlimited[k] within the limits

    b0 = b1 = 1/2 with Tustin's rule; b0 = 1, b1 = 0 with the backward difference.

    Parameters
    ----------
    design : PIController
        Gains and lead, continuous.
    period : float
        h, s, > 0; with a lead and Tustin's rule at most twice its filter's time constant (else the filter rings).
    torque_low, torque_high : float
        N*m, limits of the command, low < high; a brake's are 0 and its largest torque.
    rule : Rule
        Tustin's, or the backward difference.
    tracking_time : float, optional
        Tt of the back-calculation, s, >= h; left out the integral time kp/ki, at least h.
        inf switches the anti-windup off.

    Raises
    ------
    InputError
        A period, limit or tracking time out of its range.
    """

    design: PIController
    period: float
    torque_low: float = -math.inf
    torque_high: float = math.inf
    rule: Rule = Rule.TUSTIN
    tracking_time: float | None = None
    _step: tuple[float, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_fields(self)
        h, filter_time = check_period(self.period), self.design.lead_filter
        if self.rule is Rule.TUSTIN and 0 < filter_time < h / 2:
            raise InputError(
                f"period: {h:g} s is not allowed with a lead filter of {filter_time:g} s; give a value <= "
                f"{2 * filter_time:g} (s), or the backward rule"
            )
        if not self.torque_low < self.torque_high:
            raise InputError(
                f"torque limits: low {self.torque_low:g} and high {self.torque_high:g} N*m are not allowed; give "
                "low < high"
            )
        if self.tracking_time is not None and not self.tracking_time >= h:
            raise InputError(
                f"tracking time: {self.tracking_time:g} s is not allowed; give a value >= the period {h:g} (s)"
            )
        object.__setattr__(self, "_step", self._constants())

    def _constants(self) -> tuple[float, ...]:
        """kp, p, q0, q1, the integrator's weights of f[k] and f[k-1], and h/Tt."""
        h, gains = self.period, self.design.gains
        q0, q1, p = self._lead
        b0, b1 = (0.5, 0.5) if self.rule is Rule.TUSTIN else (1.0, 0.0)
        tracking = h / self.effective_tracking_time if gains.ki != 0 else 0.0
        return gains.kp, p, q0, q1, gains.ki * h * b0, gains.ki * h * b1, tracking

    @property
    def constants(self) -> tuple[float, ...]:
        """kp, p, q0, q1, ki h b0, ki h b1 and h/Tt of the difference equations."""
        return self._step

    @property
    def effective_tracking_time(self) -> float:
        """Tt in use, s."""
        gains = self.design.gains
        if self.tracking_time is not None:
            return self.tracking_time
        return max(self.period, abs(gains.kp / gains.ki)) if gains.ki != 0 else math.inf

    @property
    def _lead(self) -> tuple[float, float, float]:
        """q0, q1 and p of the lead (q0 z + q1)/(z - p)."""
        h = self.period
        lead, lag = self.design.lead / h, self.design.lead_filter / h
        if lead == lag == 0:
            return 1.0, 0.0, 0.0
        if self.rule is Rule.TUSTIN:
            scale = 1 + 2 * lag
            return (1 + 2 * lead) / scale, (1 - 2 * lead) / scale, (2 * lag - 1) / scale
        scale = 1 + lag
        return (1 + lead) / scale, -lead / scale, lag / scale

    # -- the difference equations -------------------------------------------------------------------------

    def step(
        self, state: SampledState, error: float, torque_applied: float | None = None
    ) -> tuple[SampledState, float]:
        """The state after a sample and the torque to command until the next, N*m; a pure function.

        `error` is lambda_d v - sigma, m/s. `torque_applied` is the command that the brake accepted since the
        previous sample, N*m, where something beyond the controller's own limits held it back; left out, its own. A
        sample that is not finite is skipped: state and torque stay as they were.
        """
        if not math.isfinite(error):
            return state, state.torque
        kp, p, q0, q1, now, before, tracking = self._step
        acted = state.torque if torque_applied is None else torque_applied
        filtered = p * state.filtered_error + q0 * error + q1 * state.error
        integral = state.integral + now * filtered + before * state.filtered_error
        integral += tracking * (acted - state.unlimited)
        unlimited = kp * filtered + integral
        torque = min(max(unlimited, self.torque_low), self.torque_high)
        return SampledState(integral, error, filtered, unlimited, torque), torque

    def initial_state(self, torque: float = 0.0, error: float = 0.0) -> SampledState:
        """The state from which a first step with `error` (m/s) gives exactly this `torque` (N*m): no bump.

        The error counts as having stood since long, so that the lead is at rest.

        Raises InputError if the torque is outside the limits.
        """
        if not self.torque_low <= torque <= self.torque_high:
            raise InputError(
                f"initial torque: {torque:g} N*m is not allowed; give a value from {self.torque_low:g} to "
                f"{self.torque_high:g} (N*m)"
            )
        kp, _, _, _, now, before, _ = self._step
        return SampledState(torque - (kp + now + before) * error, error, error, torque, torque)

    def take_over(self, state: SampledState) -> SampledState:
        """The state of another controller of the same lead, for this one to go on from without a bump in torque.

        For gain scheduling: only the integral part changes, by what the proportional part will.
        """
        torque = min(max(state.unlimited, self.torque_low), self.torque_high)
        integral = state.unlimited - self.design.gains.kp * state.filtered_error
        return state._replace(integral=integral, torque=torque)

    # -- as a transfer function ---------------------------------------------------------------------------

    @property
    def transfer_function(self) -> Rational:
        """C in the variable z, between the limits; its pole at 1 is exact."""
        kp, p, q0, q1, now, before, _ = self._step
        pi = Rational(np.array([]), np.array([]), kp)
        if self.design.gains.ki != 0:
            # kp + (now z + before)/(z - 1)
            pi = _first_order(kp + now, before - kp, -1.0)
        if (q1, p) == (0.0, 0.0):
            return pi
        return pi * _first_order(q0, q1, -p)

    @cached_property
    def coefficients(self) -> tuple[Floats, Floats]:
        """Numerator and denominator of C, powers of 1/z ascending (b0 + b1/z + ..., 1 + a1/z + ...), one length."""
        c = self.transfer_function
        numerator = np.atleast_1d(c.gain * np.real(np.poly(c.zeros)))
        denominator = np.atleast_1d(np.real(np.poly(c.poles)))
        return np.concatenate([np.zeros(denominator.size - numerator.size), numerator]), denominator


def _first_order(b0: float, b1: float, a1: float) -> Rational:
    """(b0 z + b1)/(z + a1)."""
    if b0 == 0:
        return Rational(np.array([]), np.array([-a1]), b1)
    return Rational(np.array([-b1 / b0]), np.array([-a1]), b0)


# --- margins ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SampledMargins:
    """Margins of one design, each None where that loop is unstable.

    Attributes
    ----------
    period, computation : float
        h and the computing time between sample and command, s.
    continuous : Margins or None
        Of the continuous design, as if never sampled.
    equivalent : Margins or None
        Of the continuous design with h/2 (the hold) and the computing time as additional dead time.
    exact : Margins or None
        Of the sampled loop itself: zero-order hold and dead time exact.
    """

    period: float
    computation: float
    continuous: Margins | None
    equivalent: Margins | None
    exact: Margins | None


@checked
def sampled_loop(
    controller: SampledController, plant: LinearPlant, actuator: Actuator, *, computation: float = 0.0
) -> SampledLoop:
    """The wheel-slip loop with a discrete controller, exact; `computation` (s) adds to the actuator's dead time."""
    extra = _computation(computation)
    return SampledLoop(
        controller.transfer_function, actuated_plant(plant, actuator), actuator.dead_time + extra, controller.period
    )


@checked
def continuous_equivalent(
    controller: SampledController, plant: LinearPlant, actuator: Actuator, *, computation: float = 0.0
) -> DeadTimeLoop:
    """The continuous loop that a sampled one resembles: h/2 for the hold, and `computation` (s), more dead time.

    Agrees with `sampled_loop` to the order of h squared ([Astrom1997] 8 replaces the hold by this delay).
    """
    delay = actuator.dead_time + controller.period / 2 + _computation(computation)
    return DeadTimeLoop(controller.design.transfer_function * actuated_plant(plant, actuator), delay)


@checked
def sampled_margins(
    controller: SampledController, plant: LinearPlant, actuator: Actuator, *, computation: float = 0.0
) -> SampledMargins:
    """Margins of a design unsampled, by the continuous equivalent, and of the exact sampled loop."""
    equivalent = continuous_equivalent(controller, plant, actuator, computation=computation)
    exact = sampled_loop(controller, plant, actuator, computation=computation)
    continuous = DeadTimeLoop(equivalent.system, actuator.dead_time)
    return SampledMargins(
        period=controller.period,
        computation=computation,
        continuous=continuous.margins() if continuous.is_stable() else None,
        equivalent=equivalent.margins() if equivalent.is_stable() else None,
        exact=exact.margins() if exact.is_stable() else None,
    )


@checked
def suggested_period(margins: Margins, *, share: float = 0.1, computation: float = 0.0) -> float:
    """The period, s, at which hold and computing take `share` of the delay margin: h/2 + computation = share delay_s.

    The hold delays by h/2 on average, and the delay margin is what the continuous design can bear. At the crossover
    wc of that margin this costs `share` of the phase margin: h wc = 2 share * phase margin (rad). The rule of thumb
    h wc = 0.15 to 0.5 of [Astrom1997] 8 is share 0.1 at phase margins from 43 deg; for the fragile loops below, this
    one asks for a shorter period.

    Raises
    ------
    InputError
        A share outside (0, 1), an unbounded delay margin, or a computing time that alone takes the share.
    """
    if not 0 < share < 1:
        raise InputError(f"share: {share:g} is not allowed; give a value > 0 and < 1")
    if not math.isfinite(margins.delay_s):
        raise InputError("period: the delay margin is unbounded and sets none; choose it from the signals' bandwidth")
    period = 2 * (share * margins.delay_s - _computation(computation))
    if period <= 0:
        raise InputError(
            f"computation: {computation:g} s is not allowed with a share of {share:g}; give less than "
            f"{share * margins.delay_s:.3g} (s), or a larger share"
        )
    return period


def _computation(time: float) -> float:
    return number("computation", time, "s", ge=0)
