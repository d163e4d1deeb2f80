"""The loop around s: what the relay of the published sliding-mode law sees once the brake actuator stands between.

The law is [Park2008] (33)-(36), (41), (45), its gains read in SI: s = e + rho int e, e = lambda_d v - sigma, and

    Tb_cmd = (J/r)[sigma_d' + (1/(r M) + r/J) Ta_model - (r B/J) omega + rho e + theta phi] + D s + K sgn(s).

Deviations from an operating point with the speed frozen. From (3), (4): sigma (1/P) = q with 1/P = (J/r) s + Q, where
Q = (J/r)[(1/M + r^2/J) F(s) + B/J] is what adhesion and friction do, F(s) from sigma to the adhesion force. The law's
feed-forward is Q_m sigma with F from the model, driven by the measured slip velocity, so that its linear part is, with
G = (s + rho)/s and s_surface = -G sigma,

    Tb_cmd = -C sigma + relay,    C = (J/r) rho + D G - Q_m,    q = Ga Tb_cmd,

    W = -s_surface/relay = G Ga/(1/P + Ga C) = G Ga/[(J/r) s + Q - Ga Q_m + Ga ((J/r) rho + D G)].

With an ideal actuator and Q_m = Q the adhesion cancels: W = (r/J)/(s + (r/J) D), [Park2008] (37). With the actuator
Q (1 - Ga) stays in the loop: the feed-forward arrives late, and the wheel's unstable pole is back.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from railslip_ctrl.core.arguments import Complexes, Floats, number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.loop import DeadTimeLoop, Rational
from railslip_ctrl.model.linearization import LinearPlant
from railslip_ctrl.model.vehicle import Actuator
from railslip_ctrl.sliding.law import TABLE4_LAWS


@dataclass(frozen=True)
class SlidingGains:
    """Gains of the law, SI, >= 0; InputError for one that is negative or not finite.

    K, height of the relay, N*m, and D, N*m/(m/s), are added to the torque; rho, 1/s; k, adaptation gain as printed:
    theta1' = k s Ta and theta2' = 12.96 k s omega in SI (theta1 in SI is 3.6 times smaller than the printed one).
    """

    K: float
    D: float
    rho: float
    k: float = 0.0

    def __post_init__(self) -> None:
        for name in ("K", "D", "rho", "k"):
            number(name, getattr(self, name), ge=0)


OMEGA_UNIT_FACTOR = 12.96
"""3.6^2: theta2' = 12.96 k s omega in SI, since s and omega are both 3.6 times larger in km/h."""

TABLE4_SLIDING = MappingProxyType(
    {column: SlidingGains(K=row.K, D=row.D, rho=row.rho, k=row.k1) for column, row in TABLE4_LAWS.items()}
)
"""Table 4's sliding-mode gains by column, SI."""


# --- the brake actuator -----------------------------------------------------------------------------------------------


def actuator_response(actuator: Actuator, s: Complexes) -> Complexes:
    """Ga(s), commanded to acting torque, at complex s (1/s), any shape."""
    return np.asarray(np.exp(-s * actuator.dead_time) / (actuator.lag * s + 1.0))


def actuator_lag(actuator: Actuator) -> Rational:
    """Ga without its dead time."""
    return Rational.from_polynomials(np.array([1.0]), np.trim_zeros(np.array([actuator.lag, 1.0]), "f"))


# --- the loop around s ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SlidingExistence:
    """Whether an ideal sliding mode exists on s = 0, by the relay's own path W ([Utkin1992]).

    relative_degree: poles minus zeros of W without its dead time (s); high_frequency_gain: lim s^relative_degree W(s)
    (dead time apart), (m/s) s^-relative_degree/(N*m). It exists with relative degree 1, positive gain and no dead time:
    only then does a switch turn s' round at once.
    """

    relative_degree: int
    high_frequency_gain: float
    dead_time: float
    lag: float
    exists: bool


@dataclass(frozen=True)
class SurfaceLoop:
    """The linear loop around the relay of the law, the speed frozen; InputError for a plant with it as a state.

    rho and D close the linear part; K and k are used where a method says so.
    """

    plant: LinearPlant
    gains: SlidingGains
    actuator: Actuator

    def __post_init__(self) -> None:
        if self.plant.speed_state:
            raise InputError("plant: the speed is a state; linearise with the speed frozen (speed_state=False)")

    def with_gains(self, **changes: float) -> SurfaceLoop:
        """The loop with some of its gains changed (K, D, rho, k)."""
        return replace(self, gains=replace(self.gains, **changes))

    # -- its parts ----------------------------------------------------------------------------------------

    @property
    def inertia_over_radius(self) -> float:
        """J/r, N*m per m/s^2 of slip acceleration."""
        return 1.0 / self.plant.gain

    @property
    def load(self) -> float:
        """Torque the law leaves out, N*m: (J/r) Fr/M, since [Park2008] (36) has no travelling resistance."""
        vehicle, v = self.plant.point.vehicle, self.plant.point.speed
        return float(self.inertia_over_radius * vehicle.resistance.force(v) / vehicle.effective_mass)

    @property
    def regressor_power(self) -> float:
        """Ta^2 + 12.96 omega^2 at the operating point: k times it is the gain of the adaptation, 1/s^2."""
        point = self.plant.point
        radius = point.vehicle.wheel.radius
        omega = (point.speed - point.sigma) / radius
        return (radius * point.adhesion_force) ** 2 + OMEGA_UNIT_FACTOR * omega**2

    @cached_property
    def _wheel(self) -> tuple[Floats, Floats]:
        """Numerator without its gain, and denominator, of torque to sigma; monic."""
        numerator, denominator = self.plant.transfer_function()
        return np.atleast_1d(numerator / self.plant.gain), denominator

    @cached_property
    def _behind_the_controller(self) -> Rational:
        """Lag and wheel: what the controller acts through, its dead time apart."""
        return actuator_lag(self.actuator) * Rational(self.plant.zeros, self.plant.poles, self.plant.gain)

    @cached_property
    def _direct(self) -> Rational:
        """The controller without relay and adaptation."""
        return self.controller()

    @cached_property
    def _compensation(self) -> tuple[Floats, Floats]:
        """Q_m as numerator and denominator, N*m/(m/s)."""
        zeros, poles = self._wheel
        return self.inertia_over_radius * np.polysub(poles, np.polymul([1.0, 0.0], zeros)), zeros

    def controller(self, *, relay_gain: float = 0.0, adaptation: float = 0.0) -> Rational:
        """C(s) from -sigma to the commanded torque, N*m/(m/s).

        `relay_gain` (N*m/(m/s)) stands for the relay (describing function, or K/layer); `adaptation` is k as printed,
        whose linear part about s = 0 with a constant regressor is (J/r) k (Ta^2 + 12.96 omega^2) int s dt.
        """
        inertia, rho, d = self.inertia_over_radius, self.gains.rho, self.gains.D + relay_gain
        q_num, q_den = self._compensation
        surface = np.array([1.0, rho])  # s G(s)
        integral = inertia * adaptation * self.regressor_power
        direct = np.polysub(inertia * rho * q_den, q_num)
        numerator = np.polymul([1.0, 0.0, 0.0], direct)
        numerator = np.polyadd(numerator, np.polymul(np.polymul([d, integral], surface), q_den))
        denominator = np.polymul([1.0, 0.0, 0.0], q_den)
        # an integrator whose output nothing uses (no D, no adaptation) is not part of the loop
        while numerator.size > 1 and numerator[-1] == 0.0 and denominator[-1] == 0.0:
            numerator, denominator = numerator[:-1], denominator[:-1]
        return Rational.from_polynomials(numerator, denominator)

    def linear_loop(self, *, relay_gain: float = 0.0, adaptation: float = 0.0) -> DeadTimeLoop:
        """The loop opened at the commanded torque, dead time exact; `relay_gain`, `adaptation` as of `controller`."""
        controller = self.controller(relay_gain=relay_gain, adaptation=adaptation)
        return DeadTimeLoop(controller * self._behind_the_controller, self.actuator.dead_time)

    def is_stable(self, *, relay_gain: float = 0.0, adaptation: float = 0.0) -> bool:
        """Whether the linear loop is stable, by the exact root count; `relay_gain`, `adaptation` as of `controller`."""
        return self.linear_loop(relay_gain=relay_gain, adaptation=adaptation).is_stable()

    # -- what the relay sees ------------------------------------------------------------------------------

    def surface_response(self, omega: ArrayLike) -> Complexes:
        """W(j omega) from the relay's output to -s, (m/s)/(N*m); omega > 0, rad/s, any shape."""
        s = 1j * np.asarray(omega, dtype=float)
        return np.asarray((s + self.gains.rho) / s * self.slip_response(omega))

    def slip_response(self, omega: ArrayLike) -> Complexes:
        """From the relay's output to sigma, (m/s)/(N*m): W/G; omega > 0, rad/s, any shape."""
        s = 1j * np.asarray(omega, dtype=float)
        actuator = actuator_response(self.actuator, s)
        return np.asarray(actuator / (self.inverse_wheel(s) + actuator * self._direct(s)))

    def torque_response(self, omega: ArrayLike) -> Complexes:
        """From the relay's output to the acting torque, N*m/(N*m); omega > 0, rad/s, any shape."""
        s = 1j * np.asarray(omega, dtype=float)
        return np.asarray(self.slip_response(omega) * self.inverse_wheel(s))

    def inverse_wheel(self, s: Complexes) -> Complexes:
        """1/P(s): from sigma to the torque that moves it, N*m/(m/s), at complex s, 1/s, any shape."""
        zeros, poles = self._wheel
        return np.asarray(self.inertia_over_radius * np.polyval(poles, s) / np.polyval(zeros, s))

    def sliding_existence(self) -> SlidingExistence:
        """Whether an ideal sliding mode exists; see `SlidingExistence`."""
        lag, dead_time = actuator_lag(self.actuator), self.actuator.dead_time
        # 1/P + Ga C grows as (J/r) s, and G tends to 1
        degree = 1 + lag.poles.size - lag.zeros.size
        gain = self.plant.gain * lag.gain
        exists = degree == 1 and dead_time == 0
        return SlidingExistence(degree, gain, dead_time, self.actuator.lag, exists)
