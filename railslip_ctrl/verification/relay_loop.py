"""Linear loop around the relay of the published sliding-mode law, with the brake actuator.

The law is [Park2008] (33)-(36), (41), (45), with gains in SI: s = e + rho int e, e = lambda_d v - sigma, and

    Tb_cmd = (J/r)[sigma_d' + (1/(r M) + r/J) Ta_model - (r B/J) omega + rho e + theta phi] + D s + K sgn s.

The loop is linear, for deviations from an operating point at frozen speed. From (3), (4): sigma = P q, with the acting
torque q and 1/P = (J/r) s + Q. Q = (J/r)[(1/M + r^2/J) F(s) + B/J] is the effect of adhesion and friction; F(s) is the
transfer function from sigma to the adhesion force. The law feeds Q_m sigma forward, where Q_m has the F of the model.
With the actuator Ga, G = (s + rho)/s and s_surface = -G sigma, the linear part of the law is

    Tb_cmd = -C sigma + relay,    C = (J/r) rho + D G - Q_m,    q = Ga Tb_cmd,

    W = -s_surface/relay = G Ga/(1/P + Ga C) = G Ga/[(J/r) s + Q - Ga Q_m + Ga ((J/r) rho + D G)].

With an ideal actuator and Q_m = Q the adhesion cancels: W = (r/J)/(s + (r/J) D), [Park2008] (37). With the actuator
Q (1 - Ga) remains in the loop: the feed-forward is delayed, so it does not cancel the wheel's unstable pole.

A gain N in place of the relay acts like D. Adaptation theta_hat' = k s phi ([Park2008] (49)) with a constant phi adds
(J/r) w int s dt to the torque, w = k (Ta^2 + 12.96 omega^2) in SI.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from railslip_ctrl.core.arguments import Floats
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.loop import DeadTimeLoop, Rational
from railslip_ctrl.model.linearization import LinearPlant
from railslip_ctrl.model.vehicle import Actuator
from railslip_ctrl.sliding.law import PUBLISHED_LAW, LawGains

OMEGA_UNIT_FACTOR = PUBLISHED_LAW.k2 / PUBLISHED_LAW.k1
"""Factor 3.6^2 in theta2_hat' = 12.96 k s omega in SI: the printed k is for s and omega from speeds in km/h."""

SLOWEST = 1e-4  # first rate tried, 1/s (for the adaptation, its square): far slower than any stop
_RATIO, _STEPS = 1.2, 76  # factor between the gains tried, and their number: up to 1e6 times the first
_TOLERANCE = 1e-9  # relative tolerance of the bisection, far above the rounding of the root count


def stable_up_to(stable: Callable[[float], bool], start: float) -> float:
    """Return the upper end of the first range of gains above `start` (> 0) in which `stable` is true.

    The result is 0 if no such range is found, and inf if the range reaches 1e6 `start`. A range in which the gain rises
    by less than 20 % may be missed.
    """
    gains = [start * _RATIO**n for n in range(_STEPS)]
    first = next((n for n, gain in enumerate(gains) if stable(gain)), None)
    if first is None:
        return 0.0
    lost = next((n for n in range(first + 1, _STEPS) if not stable(gains[n])), None)
    if lost is None:
        return math.inf
    low, high = gains[lost - 1], gains[lost]
    while high - low > _TOLERANCE * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


@dataclass(frozen=True)
class SurfaceLoop:
    """Linear loop around the relay of the published law at frozen speed, with rho and D, without K and adaptation.

    InputError for a plant that has the train speed as a state.
    """

    plant: LinearPlant
    gains: LawGains
    actuator: Actuator

    def __post_init__(self) -> None:
        if self.plant.speed_state:
            raise InputError("plant: the train speed is a state; linearise at constant speed (speed_state=False)")

    def with_gains(self, **changes: Any) -> SurfaceLoop:
        return replace(self, gains=replace(self.gains, **changes))

    @property
    def load(self) -> float:
        """Torque (J/r) Fr/M, N*m, that the law neglects, because [Park2008] (36) has no travelling resistance Fr."""
        vehicle, v = self.plant.point.vehicle, self.plant.point.speed
        return float(vehicle.resistance.force(v) / vehicle.effective_mass / self.plant.gain)

    @property
    def regressor_power(self) -> float:
        """Ta^2 + 12.96 omega^2 at the operating point; multiplied by k, it is the gain of the adaptation, 1/s^2."""
        point = self.plant.point
        radius = point.vehicle.wheel.radius
        omega = (point.speed - point.sigma) / radius
        return (radius * point.adhesion_force) ** 2 + OMEGA_UNIT_FACTOR * omega**2

    @cached_property
    def _wheel(self) -> tuple[Floats, Floats]:
        # monic numerator and denominator of the transfer function from torque to sigma
        numerator, denominator = self.plant.transfer_function()
        return np.atleast_1d(numerator / self.plant.gain), denominator

    def controller(self, *, relay_gain: float = 0.0, adaptation: float = 0.0) -> Rational:
        """Return the controller C(s) from -sigma to the commanded torque, N*m/(m/s).

        `relay_gain`, N*m/(m/s), replaces the relay (describing function, or K/layer). `adaptation` is k as printed.
        """
        zeros, poles = self._wheel
        inertia, rho = 1.0 / self.plant.gain, self.gains.rho  # J/r
        compensation = inertia * np.polysub(poles, np.polymul([1.0, 0.0], zeros))  # Q_m times the zeros
        direct = np.polysub(inertia * rho * zeros, compensation)
        surface = np.array([1.0, rho])  # s G(s)
        on_s = [self.gains.D + relay_gain, inertia * adaptation * self.regressor_power]
        numerator = np.polymul([1.0, 0.0, 0.0], direct)
        numerator = np.polyadd(numerator, np.polymul(np.polymul(on_s, surface), zeros))
        denominator = np.polymul([1.0, 0.0, 0.0], zeros)
        # without adaptation, a pole and a zero at 0 cancel
        while numerator.size > 1 and numerator[-1] == 0.0 and denominator[-1] == 0.0:
            numerator, denominator = numerator[:-1], denominator[:-1]
        return Rational.from_polynomials(numerator, denominator)

    def linear_loop(self, *, relay_gain: float = 0.0, adaptation: float = 0.0) -> DeadTimeLoop:
        """Return the loop opened at the commanded torque, with exact dead time; arguments as for `controller`."""
        lag = Rational.from_polynomials(np.array([1.0]), np.trim_zeros(np.array([self.actuator.lag, 1.0]), "f"))
        acted_on = lag * Rational(self.plant.zeros, self.plant.poles, self.plant.gain)
        controller = self.controller(relay_gain=relay_gain, adaptation=adaptation)
        return DeadTimeLoop(controller * acted_on, self.actuator.dead_time)

    def unstable_poles(self, *, relay_gain: float = 0.0, adaptation: float = 0.0) -> float:
        """Return the exact number of unstable closed-loop poles; arguments as for `controller`."""
        return self.linear_loop(relay_gain=relay_gain, adaptation=adaptation).unstable_closed_loop_poles

    def is_stable(self, *, relay_gain: float = 0.0, adaptation: float = 0.0) -> bool:
        """Return True if the linear loop is stable, by the exact root count; arguments as for `controller`."""
        return self.linear_loop(relay_gain=relay_gain, adaptation=adaptation).is_stable()

    def sliding_existence(self) -> dict[str, Any]:
        """Decide whether an ideal sliding mode on s = 0 exists ([Utkin1992]); return verdict and reasons in a dict.

        W is the transfer function from the torque of the relay to -s. A switch of the relay reverses s' at once only if
        W has relative degree 1 and no dead time.

        - exists: True if the mode exists.
        - relative_degree: number of poles minus number of zeros of W without its dead time.
        - high_frequency_gain: limit of s^relative_degree W(s) for s to infinity, (m/s) s^-relative_degree/(N*m), > 0.
        - dead_time, lag: those of the actuator, s.
        """
        lag, dead_time = self.actuator.lag, self.actuator.dead_time
        degree, gain = (2, self.plant.gain / lag) if lag > 0 else (1, self.plant.gain)
        found = {"relative_degree": degree, "high_frequency_gain": gain, "dead_time": dead_time, "lag": lag}
        return {**found, "exists": degree == 1 and dead_time == 0}

    @cached_property
    def largest_relay_gain(self) -> float:
        """Largest stable relay gain, N*m/(m/s); inf if every gain is stable, 0 if no gain is stable."""
        return stable_up_to(lambda gain: self.is_stable(relay_gain=gain), SLOWEST / self.plant.gain)
