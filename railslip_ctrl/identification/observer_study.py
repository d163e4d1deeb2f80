"""How good is an adhesion-torque observer? Its symbolic statement, a brake trial with known truth, lag against noise.

The statement derives the observer as printed and as corrected from the wheel's equation: [Park2008] (25)-(28). The
trial is the course of Fig. 12, simulated: free rolling, the brake torque rises until the slip passes a bound (0.5 in
the source), then it is released and the wheel recovers. Wheel and train are the plant's, integrated by SciPy; nothing
of an observer is in it. The lag's error is what the observer does to a trial with perfect sensors, the half interval by
which an encoder's speed is late included; the noise's is the H2 norm. They are independent: their squares add.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import ArrayLike

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.notation import symbol
from railslip_ctrl.model import plant
from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.model.numeric import NumericPlant, numeric_plant, plant_parameters
from railslip_ctrl.model.vehicle import Vehicle

from .observer import Floats, TorqueObserver, noise_deviation
from .sensors import Encoder, TorqueSensor, require

__all__ = [
    "BrakeCourse",
    "Measurements",
    "ObserverErrors",
    "TradeOff",
    "Trial",
    "brake_trial",
    "measured",
    "observer_errors",
    "trade_off",
]

# --- the statement, in Laplace's s -----------------------------------------------------------------------------------


s = symbol("s")
tau = sp.Symbol("tau", positive=True)


@dataclass(frozen=True)
class Transfers:
    """Ta_hat = torque * Tb + speed * omega, both measured; expressions in s, tau, J, B (1 and N*m*s)."""

    torque: sp.Expr
    speed: sp.Expr


@dataclass(frozen=True)
class WheelTransfers:
    """From what acts on the wheel, and from sensor noise, to Ta_hat; the wheel's equation (3) is in them.

    `adhesion` is from the true Ta and Tr, which is part of it, `brake` from the measured Tb, `disturbance` from Td, and
    the noises from what the sensors add to Tb (N*m) and to omega (rad/s).
    """

    adhesion: sp.Expr
    brake: sp.Expr
    disturbance: sp.Expr
    torque_noise: sp.Expr
    speed_noise: sp.Expr


@cache
def adhesion_torque() -> sp.Expr:
    """(25): Ta in omega', omega and Tb, from (3) without the torques that nobody measures (Td = Tr = 0)."""
    return sp.expand(sp.solve(plant.WHEEL.subs({plant.Td: 0, plant.Tr: 0}), plant.Ta)[0])


def printed() -> Transfers:
    """(27): only J omega' goes through the filter."""
    rate = sp.diff(adhesion_torque(), plant.omega_rate) * plant.omega_rate
    rest = adhesion_torque() - rate
    return _transfers(rate.subs(plant.omega_rate, s * plant.omega) / (tau * s + 1) + rest)


def printed_without_derivative() -> Transfers:
    """(28): (B + J/tau - (J/tau)/(tau s + 1)) omega + Tb, as printed."""
    J, B = plant.J, plant.B
    return Transfers(torque=sp.Integer(1), speed=B + J / tau - (J / tau) / (tau * s + 1))


def corrected() -> Transfers:
    """Every term of (26) through the filter."""
    return _transfers(adhesion_torque().subs(plant.omega_rate, s * plant.omega) / (tau * s + 1))


def behind_the_wheel(observer: Transfers) -> WheelTransfers:
    """The observer's transfers with omega from the wheel's equation (3) in them."""
    acting = {plant.Ta: "adhesion", plant.Tb: "brake", plant.Td: "disturbance"}
    equation = plant.WHEEL.subs({plant.omega_rate: s * plant.omega, plant.Tr: 0})
    wheel = sp.solve(equation, plant.omega)[0]
    estimate = observer.torque * plant.Tb + observer.speed * wheel
    by_torque = {name: sp.factor(sp.together(sp.diff(estimate, torque))) for torque, name in acting.items()}
    return WheelTransfers(**by_torque, torque_noise=observer.torque, speed_noise=observer.speed)


def passed_at_once(transfer: sp.Expr) -> sp.Expr:
    """The share of a step that is in the estimate at once: the transfer at infinite s."""
    return sp.limit(transfer, s, sp.oo)


def _transfers(estimate: sp.Expr) -> Transfers:
    return Transfers(*(sp.together(sp.diff(estimate, measured)) for measured in (plant.Tb, plant.omega)))


# --- a brake trial ---------------------------------------------------------------------------------------------------


# An observer differentiates the angle twice: at a sampling interval of 1 ms an error of 1e-11 rad is 6e-4 N*m.
_RTOL, _ATOL = 1e-10, 1e-11
_SLOWEST = 1.0  # m/s: below, the slip ratio says nothing any more


@dataclass(frozen=True)
class BrakeCourse:
    """The course of the acting brake torque.

    Parameters
    ----------
    start : float
        Time before the brake is applied, s, >= 0.
    rise, fall : float
        Rates of the torque when it is applied and released, N*m/s, > 0.
    release_slip : float
        Slip ratio that ends the rise, 0 to 1.
    recovery : float
        Time that is simulated after the release begins, s, > 0.

    Raises
    ------
    InputError
        A number out of range.
    """

    start: float = 0.5
    rise: float = 2500.0
    fall: float = 60_000.0
    release_slip: float = 0.5
    recovery: float = 2.0

    def __post_init__(self) -> None:
        require("start", self.start, "s", zero_allowed=True)
        for name, unit in (("rise", "N*m/s"), ("fall", "N*m/s"), ("recovery", "s")):
            require(name, getattr(self, name), unit)
        if not 0 < self.release_slip < 1:
            raise InputError(f"release_slip: {self.release_slip:g} is not allowed; give a value between 0 and 1")


@dataclass(frozen=True)
class Trial:
    """What truly happened, at constant intervals; arrays of one length.

    Attributes
    ----------
    time, speed, rim_speed, omega, angle : array
        s; v and r omega in m/s; the wheel's speed in rad/s and angle in rad.
    brake_torque, adhesion_torque : array
        Tb and Ta, N*m.
    brake_time, release_time : float
        When the brake was applied, and when its release began, s.
    """

    time: Floats
    speed: Floats
    rim_speed: Floats
    omega: Floats
    angle: Floats
    brake_torque: Floats
    adhesion_torque: Floats
    brake_time: float
    release_time: float

    @property
    def interval(self) -> float:
        """s."""
        return float(self.time[1] - self.time[0])


@dataclass(frozen=True)
class Measurements:
    """What the sensors give, arrays of one length.

    Attributes
    ----------
    time : array
        s, growing.
    torque : array
        Brake torque, N*m.
    omega : array
        Speed of the wheel, rad/s.
    """

    time: Floats
    torque: Floats
    omega: Floats


def brake_trial(law: AdhesionLaw, vehicle: Vehicle, speed: float, *, interval: float, course: BrakeCourse) -> Trial:
    """Simulate a brake course from free rolling.

    Parameters
    ----------
    law : AdhesionLaw
    vehicle : Vehicle
    speed : float
        At the start, m/s, > 0.
    interval : float
        Between samples, s, > 0.
    course : BrakeCourse
        What the brake does.

    Raises
    ------
    InputError
        A number out of range, or the train stops before the slip reaches the course's bound.
    DomainError
        The law ends before that slip.
    """
    require("speed", speed, "m/s")
    require("interval", interval, "s")
    law.check_domain(speed, course.release_slip * speed)
    wheel = _Wheel(numeric_plant(type(law)), plant_parameters(law, vehicle), vehicle.wheel.radius)
    none, rising = _ramp(0.0, 0.0, 0.0), _ramp(course.start, 0.0, course.rise)
    free = wheel.advance(0.0, course.start, np.array([speed, 0.0, 0.0, 0.0]), none)
    # the impulse of the torque that stops train and wheel, whatever the adhesion
    impulse = (vehicle.effective_inertia / vehicle.wheel.radius + vehicle.effective_mass * vehicle.wheel.radius) * speed
    latest = course.start + float(np.sqrt(2 * impulse / course.rise))
    risen = wheel.advance(course.start, latest, free.y[:, -1], rising, release_slip=course.release_slip)
    if not risen.t_events[0].size:
        remedy = "the train stops before; give a lower value or a faster rise"
        raise InputError(f"release_slip: {course.release_slip:g} is not reached, {remedy}")
    released = float(risen.t[-1])
    falling = _ramp(released, rising(released), -course.fall)
    end = released + rising(released) / course.fall
    fallen = wheel.advance(released, end, risen.y[:, -1], falling)
    rolling = wheel.advance(end, max(end, released + course.recovery), fallen.y[:, -1], none)
    return wheel.sampled(
        (free, risen, fallen, rolling), (none, rising, falling, none), interval, (course.start, released)
    )


def measured(trial: Trial, encoder: Encoder, sensor: TorqueSensor, *, seed: int) -> Measurements:
    """A trial through its sensors; one sample fewer, as the encoder's speed needs two angles.

    Parameters
    ----------
    trial : Trial
        The truth.
    encoder, sensor : Encoder, TorqueSensor
        What measures the wheel's speed and the brake torque.
    seed : int
        Of the torque's noise; the same seed gives the same noise.
    """
    torque = sensor.measured(trial.brake_torque[1:], np.random.default_rng(seed))
    return Measurements(trial.time[1:], torque, encoder.speed(trial.time, trial.angle))


def _ramp(begin: float, value: float, rate: float) -> Callable[[Any], Any]:
    return lambda t: value + rate * (t - begin)


@dataclass(frozen=True)
class _Wheel:
    """The plant with the wheel's angle as a fourth state: v, sigma, z, angle."""

    plant: NumericPlant
    p: tuple[float, ...]
    radius: float

    def advance(
        self, begin: float, end: float, state: Floats, torque: Callable[[Any], Any], release_slip: float | None = None
    ) -> Any:
        from scipy.integrate import solve_ivp

        def rates(t: float, x: Floats) -> tuple[float, ...]:
            v, sigma, z, _ = x
            return (*self.plant.rates(v, sigma, z, torque(t), 0.0, 0.0, self.p), (v - sigma) / self.radius)

        def passed(_: float, x: Floats) -> float:
            return float(x[1] - (release_slip or 1.0) * x[0])

        def stopped(_: float, x: Floats) -> float:
            return float(x[0] - _SLOWEST)

        passed.terminal = stopped.terminal = True  # type: ignore[attr-defined]
        return solve_ivp(
            rates,
            (begin, end),
            state,
            method="DOP853",
            rtol=_RTOL,
            atol=_ATOL,
            dense_output=True,
            events=None if release_slip is None else (passed, stopped),
        )

    def sampled(
        self,
        parts: tuple[Any, ...],
        torques: tuple[Callable[[Any], Any], ...],
        interval: float,
        events: tuple[float, float],
    ) -> Trial:
        time = np.asarray(np.arange(int(parts[-1].t[-1] / interval) + 1) * interval, dtype=float)
        ends = [part.t[-1] for part in parts[:-1]]
        which = np.searchsorted(ends, time, side="right")
        x, torque = np.empty((4, time.size)), np.empty(time.size)
        for i, part in enumerate(parts):
            mine = which == i
            x[:, mine], torque[mine] = part.sol(time[mine]), torques[i](time[mine])
        v, sigma, z, angle = x
        force = self.plant.force(v, sigma, z, torque, 0.0, 0.0, self.p)
        return Trial(
            time, v, v - sigma, (v - sigma) / self.radius, angle, torque, np.asarray(self.radius * force), *events
        )


# --- lag against noise -----------------------------------------------------------------------------------------------


_LOG_TOLERANCE = 1e-4  # of the setting's logarithm; the error is flat at its minimum


@dataclass(frozen=True)
class ObserverErrors:
    """Root mean square errors of Ta_hat over a trial from the time the brake is applied, N*m.

    Before that an observer settles from its first sample.

    Attributes
    ----------
    lag : float
        With perfect sensors.
    noise : float
        Standard deviation that the sensors' noise gives the estimate, from the H2 norm.
    simulated : float
        On counts of the encoder and noise drawn for the torque: an independent check of `total`.
    """

    lag: float
    noise: float
    simulated: float

    @property
    def total(self) -> float:
        """lag and noise together."""
        return math.hypot(self.lag, self.noise)


@dataclass(frozen=True)
class TradeOff:
    """Errors over a setting: tau (s) of the filter, or the walk ((N*m)^2/s) of the Kalman filter.

    Attributes
    ----------
    settings : array, 1-D
    errors : tuple of ObserverErrors
        At the settings.
    best : float
        The setting with the least total error, between the first and last of `settings`, in their unit.
    at_best : ObserverErrors
    """

    settings: Floats
    errors: tuple[ObserverErrors, ...]
    best: float
    at_best: ObserverErrors


def estimated(observer: TorqueObserver[Any], trial: Trial) -> Floats:
    """Ta_hat (N*m) with perfect sensors, at all times of a trial but the first; speed by difference of the angle."""
    speed = np.diff(trial.angle) / np.diff(trial.time)
    return observer.run(trial.time[1:], trial.brake_torque[1:], speed).adhesion_torque


def observer_errors(
    observer: TorqueObserver[Any], trial: Trial, encoder: Encoder, sensor: TorqueSensor, *, seed: int
) -> ObserverErrors:
    """Errors of one observer over a trial.

    Parameters
    ----------
    observer : TorqueObserver[Any]
    trial : Trial
        The truth.
    encoder, sensor : Encoder, TorqueSensor
        What measures the wheel's speed and the brake torque.
    seed : int
        Of the torque's noise.
    """
    braked = trial.time[1:] >= trial.brake_time
    truth = trial.adhesion_torque[1:]
    seen = measured(trial, encoder, sensor, seed=seed)
    noisy = observer.run(seen.time, seen.torque, seen.omega).adhesion_torque
    return ObserverErrors(
        lag=_rms((estimated(observer, trial) - truth)[braked]),
        noise=noise_deviation(observer.sampled(trial.interval), encoder, sensor),
        simulated=_rms((noisy - truth)[braked]),
    )


def trade_off(
    make: Callable[[float], TorqueObserver[Any]],
    settings: ArrayLike,
    trial: Trial,
    encoder: Encoder,
    sensor: TorqueSensor,
    *,
    seed: int,
) -> TradeOff:
    """Errors over a setting of the observer, and the best setting between its first and last value.

    Parameters
    ----------
    make : callable
        The observer for a setting.
    settings : array, 1-D
        > 0, growing: tau (s) of the filter, or the walk ((N*m)^2/s) of the Kalman filter.
    trial, encoder, sensor, seed
        As of `observer_errors`.
    """
    from scipy.optimize import minimize_scalar

    values = np.asarray(settings, dtype=float)

    def errors(setting: float) -> ObserverErrors:
        return observer_errors(make(setting), trial, encoder, sensor, seed=seed)

    found = minimize_scalar(
        lambda logarithm: errors(math.exp(logarithm)).total,
        bounds=(math.log(values[0]), math.log(values[-1])),
        method="bounded",
        options={"xatol": _LOG_TOLERANCE},
    )
    best = math.exp(found.x)
    return TradeOff(values, tuple(errors(float(value)) for value in values), best, errors(best))


def _rms(error: Floats) -> float:
    return float(np.sqrt(np.mean(error**2)))
