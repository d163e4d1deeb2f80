"""How good is an adhesion-torque observer? A brake trial with known truth, lag against noise.

The trial is the course of [Park2008] Fig. 12, simulated: free rolling, the brake torque rises until the slip passes a
bound (0.5 in the source), then it is released and the wheel recovers. The lag's error is what the observer does to a
trial with perfect sensors, the half interval by which an encoder's speed is late included; the noise's is the H2 norm.
They are independent: their squares add.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import cumulative_trapezoid

from railslip_ctrl.core.arguments import number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.model.vehicle import Actuator, Vehicle
from railslip_ctrl.simulation import Scenario, simulate

from .observer import Encoder, Floats, TorqueObserver, TorqueSensor, noise_deviation
from .virtual_rig import RigProcedure

__all__ = [
    "BrakeCourse",
    "BrakeTrial",
    "Measurements",
    "ObserverErrors",
    "TradeOff",
    "brake_trial",
    "measured",
    "observer_errors",
    "trade_off",
]

# --- a brake trial ---------------------------------------------------------------------------------------------------


_SLOWEST = 1.0  # m/s: below, the slip ratio says nothing any more
_STEP = 1e-4  # s, between commands of the torque: 6 N*m of the release


@dataclass(frozen=True)
class BrakeCourse:
    """The brake torque: none until `start`, s; then its rate is `rise` and, past the slip ratio `release_slip`, `fall`.

    Rates in N*m/s. `recovery` is the time that is simulated after the release begins, s. InputError for a number out of
    range.
    """

    start: float = 0.5
    rise: float = 2500.0
    fall: float = 60_000.0
    release_slip: float = 0.5
    recovery: float = 2.0

    def __post_init__(self) -> None:
        number("start", self.start, "s", ge=0)
        for name, unit in (("rise", "N*m/s"), ("fall", "N*m/s"), ("recovery", "s")):
            number(name, getattr(self, name), unit, gt=0)
        if not 0 < self.release_slip < 1:
            raise InputError(f"release_slip: {self.release_slip:g} is not allowed; give a value between 0 and 1")


@dataclass(frozen=True)
class BrakeTrial:
    """What truly happened, at constant intervals; SI, arrays of one length.

    `time`; the train's `speed`, the wheel's `rim_speed` v - sigma, `omega` and `angle`; `brake_torque` and
    `adhesion_torque`. `brake_time` and `release_time` are when the brake was applied and when its release began.
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
    """What the sensors give: `time`, s, brake `torque`, N*m, and the wheel's `omega`, rad/s; arrays of one length."""

    time: Floats
    torque: Floats
    omega: Floats


def brake_trial(
    law: AdhesionLaw, vehicle: Vehicle, speed: float, *, interval: float, course: BrakeCourse
) -> BrakeTrial:
    """A brake `course` of a `vehicle` on a `law`, from free rolling at a `speed`, m/s, sampled at an `interval`, s.

    InputError for a number out of range, or where the train stops before the slip reaches the course's bound;
    DomainError where the law ends before that slip.
    """
    number("speed", speed, "m/s", gt=0)
    number("interval", interval, "s", gt=0)
    law.check_domain(speed, course.release_slip * speed)
    radius, every = vehicle.wheel.radius, max(round(interval / _STEP), 1)
    # the impulse of the torque that stops train and wheel, whatever the adhesion
    impulse = (vehicle.effective_inertia / radius + vehicle.effective_mass * radius) * speed
    run = simulate(
        Scenario(
            name="brake trial",
            vehicle=vehicle.model_copy(update={"actuator": Actuator(dead_time=0.0, lag=0.0)}),
            adhesion=law,
            rail=law.rail,
            initial_speed=speed,
            final_speed=_SLOWEST,
            longest_time=course.start + math.sqrt(2 * impulse / course.rise) + course.recovery,
        ),
        RigProcedure(course.start, course.rise, course.release_slip, interval / every, radius, course.fall),
        seed=None,
    )
    signals = run.signals
    assert signals is not None, "the run was recorded"
    falls = np.diff(signals.command) < 0.0
    if not falls.any():
        remedy = "the train stops before; give a lower value or a faster rise"
        raise InputError(f"release_slip: {course.release_slip:g} is not reached, {remedy}")
    released = float(signals.time[1:][np.argmax(falls)])
    angle = cumulative_trapezoid(signals.wheel_speed, signals.time, initial=0.0)
    end = int(np.searchsorted(signals.time, released + course.recovery))
    at = slice(0, end, every)
    omega = signals.wheel_speed[at]
    return BrakeTrial(
        time=signals.time[at],
        speed=signals.speed[at],
        rim_speed=radius * omega,
        omega=omega,
        angle=angle[at],
        brake_torque=signals.torque[at],
        adhesion_torque=radius * signals.adhesion_force[at],
        brake_time=course.start,
        release_time=released,
    )


def measured(trial: BrakeTrial, encoder: Encoder, sensor: TorqueSensor, *, seed: int) -> Measurements:
    """A `trial` through `encoder` and `sensor`; a sample fewer, as a speed needs two angles; `seed` of the noise."""
    torque = sensor.measured(trial.brake_torque[1:], np.random.default_rng(seed))
    return Measurements(trial.time[1:], torque, encoder.speed(trial.time, trial.angle))


# --- lag against noise -----------------------------------------------------------------------------------------------


_LOG_TOLERANCE = 1e-4  # of the setting's logarithm; the error is flat at its minimum


@dataclass(frozen=True)
class ObserverErrors:
    """Root mean square errors of Ta_hat over a trial from the time the brake is applied, N*m.

    Before that an observer settles from its first sample. `lag` is that with perfect sensors, `noise` what the sensors
    add, from the H2 norm; `simulated` is on counts of the encoder and noise drawn for the torque, an independent check
    of `total`.
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

    `errors` are those at the `settings`, 1-D, `at_best` that at the setting `best`, which has the least total error.
    """

    settings: Floats
    errors: tuple[ObserverErrors, ...]
    best: float
    at_best: ObserverErrors


def estimated(observer: TorqueObserver, trial: BrakeTrial) -> Floats:
    """Ta_hat (N*m) with perfect sensors, at all times of a trial but the first; speed by difference of the angle."""
    speed = np.diff(trial.angle) / np.diff(trial.time)
    return observer.run(trial.time[1:], trial.brake_torque[1:], speed).adhesion_torque


def observer_errors(
    observer: TorqueObserver, trial: BrakeTrial, encoder: Encoder, sensor: TorqueSensor, *, seed: int
) -> ObserverErrors:
    """Errors of one `observer` over a `trial`, seen by `encoder` and `sensor`; `seed` of the torque's noise."""
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
    make: Callable[[float], TorqueObserver],
    settings: ArrayLike,
    trial: BrakeTrial,
    encoder: Encoder,
    sensor: TorqueSensor,
    *,
    seed: int,
) -> TradeOff:
    """Errors over a setting of the observer, and the best setting between its first and last value.

    `make` gives the observer for a setting; `settings`, s or (N*m)^2/s, 1-D, are > 0 and grow. `trial`, `encoder`,
    `sensor` and `seed` as of `observer_errors`.
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
