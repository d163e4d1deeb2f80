"""Virtual brake rig: simulates the adhesion test of [Park2008] pp. 49-51, and writes its log.

The wheel rolls freely at v0, then the brake torque rises on a ramp and is released at a slip ratio of 0.5 ([Park2008]
Fig. 12). Flywheels with the inertia of the quarter car slow down like the train. A random adhesion force and sensor
noise disturb the measured adhesion.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from scipy.integrate import cumulative_trapezoid

from railslip_ctrl.core.arguments import Floats, number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.folders import staged
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion import AdhesionLaw, ReferenceSlip, published_law
from railslip_ctrl.model.adhesion.base import RANDOM_FORCE
from railslip_ctrl.model.vehicle import PARK2008, Actuator, Rail, Vehicle
from railslip_ctrl.simulation import Disturbances, Measurement, Outcome, Scenario, simulate

from .logs import Rows
from .messages import message
from .observer import Encoder, TorqueSensor

TEST_SPEEDS_KMH = (30.0, 60.0, 100.0, 140.0)  #: [Park2008] Table 1

#: header of a written log
COLUMNS = ("time [s]", "train speed [km/h]", "wheel angular speed [rad/s]", "brake torque [kN*m]", "wheel load [kN]")

RIG_BRAKE = Actuator(dead_time=0.02, lag=0.05)  #: assumed brake of the rig, which releases before the wheel locks


class RigProcedure:
    """Controller of a rig test.

    From the time `begin`, s, the torque rises at `rate`, N*m/s, until the slip ratio exceeds `release_slip`; it then
    falls at `fall`, N*m/s. `period` is the sampling period, s, and `radius` the wheel's radius, m.
    """

    name = "rig-procedure"
    reference = ReferenceSlip(dry=0.5, wet=0.5)  # unused by the procedure, but required by `simulate`

    def __init__(
        self, begin: float, rate: float, release_slip: float, period: float, radius: float, fall: float = math.inf
    ) -> None:
        self.begin, self.rate, self.release_slip, self.period = begin, rate, release_slip, period
        self.radius, self.fall = radius, fall

    def reset(self, t: float, v: float, omega: float) -> None:
        self.torque, self.released = 0.0, False

    def step(self, t: float, v: float, omega: float) -> float:
        self.released = self.released or v - self.radius * omega > self.release_slip * v
        ramp = self.rate * max(t - self.begin, 0.0)
        self.torque = max(self.torque - self.fall * self.period, 0.0) if self.released else ramp
        return self.torque


@dataclass(frozen=True)
class RigTest:
    """Conditions and sensors of a rig test, SI; InputError for a value out of its range."""

    vehicle: Vehicle
    law: AdhesionLaw  # the true adhesion law
    initial_speed: float  # speed of free rolling before the brake is applied, m/s
    rate: float = 4000.0  # of the rising torque, N*m/s
    release_slip: float = 0.5  # slip ratio at which the brake is released
    interval: float = 0.01  # sampling interval of the log, s
    random_force: float = RANDOM_FORCE  # N, standard deviation; a new value in each interval
    wheel_noise: float = 0.01  # rad/s, standard deviation; unused with an encoder
    speed_noise: float = 0.0  # m/s, standard deviation
    torque_noise: float = 0.0  # N*m, standard deviation
    encoder: Encoder | None = None  # measures the wheel speed if given
    torque_offset: float = 0.0  # sensor offset, N*m
    spread: float = 0.0  # standard deviation of ln(factor on the adhesion) from test to test
    brake: Actuator = RIG_BRAKE

    def __post_init__(self) -> None:
        number("release_slip", self.release_slip, gt=0, lt=1)
        for name in ("initial_speed", "rate", "interval"):
            number(name, getattr(self, name), gt=0)
        for name in ("random_force", "wheel_noise", "speed_noise", "torque_noise", "spread"):
            number(name, getattr(self, name), ge=0)


_QUANTITIES = ("time", "train_speed", "wheel_angular_speed", "brake_torque", "wheel_load")
_BEGIN = 0.5  # s of free rolling before the ramp
_AFTER = 1.0  # s recorded after the release
_PAUSE = 30.0  # s to run up again between tests
_STEP = 1e-3  # integration step, s


def run_tests(test: RigTest, *, tests: int = 6, seed: int = 0) -> Rows:
    """Simulate rig tests under equal conditions and return their rows as one log, with a pause between tests.

    `tests` is the number of tests, `seed` the seed of all random numbers. InputError if the flywheels stop before the
    slip reaches `release_slip`.
    """
    if not 1 <= tests <= 10_000:
        raise InputError(f"tests: {tests} is not allowed; give an integer from 1 to 10000")
    streams = np.random.SeedSequence(seed).spawn(tests)
    parts, start = [], 0.0
    for stream in streams:
        of_rail, of_run, of_sensors = stream.spawn(3)
        factor = math.exp(test.spread * np.random.default_rng(of_rail).standard_normal())
        part = _one_test(test, factor, of_run, np.random.default_rng(of_sensors))
        parts.append([part[0] + start, *part[1:]])
        start += float(part[0][-1]) + _PAUSE
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    return Rows(np.arange(columns[0].size) + 2, dict(zip(_QUANTITIES, columns, strict=True)))


def _one_test(
    test: RigTest, factor: float, of_run: np.random.SeedSequence, generator: np.random.Generator
) -> list[Floats]:
    vehicle = test.vehicle
    longest = _BEGIN + 4.0 * vehicle.wheel_load * vehicle.wheel.radius / test.rate + 10.0  # s, a ramp far beyond mu = 1
    scenario = Scenario(
        name="rig",
        vehicle=vehicle.model_copy(update={"actuator": test.brake}),
        adhesion=test.law if factor == 1.0 else test.law.weakened(factor),
        rail=test.law.rail,
        initial_speed=test.initial_speed,
        final_speed=0.05 * test.initial_speed,
        longest_time=longest,
        disturbances=Disturbances(random_force=test.random_force, random_hold=test.interval),
        measurement=Measurement(speed_noise=test.speed_noise, wheel_noise=test.wheel_noise),
        step=_STEP,
    )
    procedure = RigProcedure(_BEGIN, test.rate, test.release_slip, test.interval, vehicle.wheel.radius)
    run = simulate(scenario, procedure, seed=of_run)
    signals = run.signals
    assert signals is not None, "the run was recorded"
    released = (signals.command == 0.0) & (signals.time > _BEGIN)
    if run.outcome is Outcome.OUTSIDE_DOMAIN:
        raise InputError(message("rig leaves the law", slip=test.release_slip, law=test.law.name))
    if not released.any():
        raise InputError(message("rig stops", test=test))
    end = int(np.searchsorted(signals.time, signals.time[int(np.argmax(released))] + _AFTER))
    torque = signals.torque[:end] + test.torque_offset + test.torque_noise * generator.standard_normal(end)
    load = np.full(end, vehicle.wheel_load)
    time, speed, omega = signals.time[:end], signals.measured_speed[:end], signals.measured_wheel_speed[:end]
    if test.encoder is None:
        return [time, speed, omega, torque, load]
    angle = cumulative_trapezoid(signals.wheel_speed[:end], time, initial=0.0)
    return [time[1:], speed[1:], test.encoder.speed(time, angle), torque[1:], load[1:]]


def published_tests(
    law_name: str = "beam", *, vehicle: Vehicle = PARK2008, rail: Rail = Rail.DRY
) -> tuple[RigTest, ...]:
    """Return the tests at the four speeds of [Park2008] Table 1, with published parameters of the law `law_name`."""
    return tuple(
        RigTest(vehicle, published_law(law_name, rail, speed, vehicle.wheel_load), speed * KMH)
        for speed in TEST_SPEEDS_KMH
    )


def write_log(log: Rows, path: Path) -> None:
    """Write a log as a CSV file with the header `COLUMNS`; if writing is interrupted, no file remains."""
    columns = [log.columns[name] / unit for name, unit in zip(_QUANTITIES, (1.0, KMH, 1.0, 1e3, 1e3), strict=True)]
    header = ",".join(COLUMNS)
    with staged(path.parent) as new:
        np.savetxt(new / path.name, np.column_stack(columns), fmt="%.10g", delimiter=",", header=header, comments="")


# --- a brake trial with known adhesion, to test an observer ----------------------------------------------------------

# The trial follows [Park2008] Fig. 12: the wheel rolls freely, the brake torque rises until the slip exceeds a bound,
# the brake is released, and the wheel speeds up again.

_SLOWEST = 1.0  # m/s; below it the slip ratio has no meaning
_COMMANDS = 1e-4  # period of the torque commands, s: steps of 6 N*m at the default `fall`


@dataclass(frozen=True)
class BrakeCourse:
    """Brake torque of a trial over time.

    From the time `start`, s, the torque rises at `rise`, N*m/s. When the slip ratio exceeds `release_slip`, the torque
    falls at `fall`, N*m/s. The simulation ends `recovery`, s, after the release begins. InputError for a number out of
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
    """True signals of a brake trial at constant intervals; SI, arrays of equal length.

    `time` has the times of the samples, `speed` is the train speed. The wheel has the speed `omega`, the `angle`, and
    the speed `rim_speed` at its circumference. `brake_torque` and `adhesion_torque` act on the wheel. The brake is
    applied at `brake_time`; its release begins at `release_time`.
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
        """Sampling interval, s."""
        return float(self.time[1] - self.time[0])


@dataclass(frozen=True)
class Measurements:
    """Sensor signals: `time` (s), brake `torque` (N*m), wheel speed `omega` (rad/s); arrays of equal length."""

    time: Floats
    torque: Floats
    omega: Floats


def brake_trial(
    law: AdhesionLaw, vehicle: Vehicle, speed: float, *, interval: float, course: BrakeCourse
) -> BrakeTrial:
    """Simulate a brake trial of a `vehicle` with an adhesion `law`, from free rolling at `speed`, m/s.

    The brake torque follows `course`. The signals are sampled at `interval`, s.

    InputError for a number out of range, or if the train stops before the slip reaches `course.release_slip`.
    DomainError if `course.release_slip` is outside the law's domain.
    """
    number("speed", speed, "m/s", gt=0)
    number("interval", interval, "s", gt=0)
    law.check_domain(speed, course.release_slip * speed)
    radius, every = vehicle.wheel.radius, max(round(interval / _COMMANDS), 1)
    # angular impulse, N*m*s, that stops train and wheel, independent of the adhesion
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
        remedy = "give a lower value or a faster rise"
        raise InputError(f"release_slip: the train stops before the slip reaches {course.release_slip:g}; {remedy}")
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
    """Return the signals that `encoder` and `sensor` measure in a `trial`, with noise from `seed`.

    The first sample is left out, because the encoder's speed is the difference of two angles.
    """
    torque = sensor.measured(trial.brake_torque[1:], np.random.default_rng(seed))
    return Measurements(trial.time[1:], torque, encoder.speed(trial.time, trial.angle))
