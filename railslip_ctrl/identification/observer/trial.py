"""A brake application to try observers on, its adhesion torque known: the course of [Park2008] Fig. 12, simulated.

Free rolling, the brake torque rises until the slip passes a bound (0.5 in the source), then it is released and the
wheel recovers. Wheel and train are the plant's, integrated by SciPy; nothing of an observer is in it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.model.numeric import NumericPlant, numeric_plant, plant_parameters
from railslip_ctrl.model.vehicle import Vehicle

from .samples import Floats, require
from .sensors import Encoder, TorqueSensor

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
