"""Gains scheduled over speed and rail, the lowest stable speed, and margins swept over speed or slip."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from railslip_ctrl.controllers.scheduled import GainSchedule, ScheduleEntry
from railslip_ctrl.controllers.systems import PIController, actuated_plant, controller_system, wheel_slip_loop
from railslip_ctrl.core.arguments import Floats, checked
from railslip_ctrl.core.errors import InfeasibleDesignError, InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH
from railslip_ctrl.loop import DeadTimeLoop
from railslip_ctrl.loop.batch import BatchMargins
from railslip_ctrl.model.adhesion import published_law
from railslip_ctrl.model.linearization import LinearPlant, linearize, operating_point
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH, PARK2008, Actuator, PIGains, Rail, Vehicle

from .specification import family_margins
from .stabilizing import stabilizing_pi
from .tuning import tune_pi

_SPEED_TOLERANCE_KMH = 1e-6  # km/h, tolerance of the bisection for the lowest speed
_LOWEST_KMH = 0.5  # km/h, lowest speed that is searched; slip is not controlled below
_BETWEEN = 25  # number of speeds at which interpolated gains are checked


@checked
def plant_at(
    law: str, vehicle: Vehicle, rail: Rail, speed_kmh: float, initial_speed_kmh: float = INITIAL_SPEED_KMH
) -> LinearPlant:
    """Return the linear plant at a law's published reference slip, SI.

    - law: name of a published law; the law is evaluated at the vehicle's wheel load.
    - vehicle: quarter car, empty or loaded.
    - rail: "dry" or "wet".
    - speed_kmh, initial_speed_kmh: train speed and v0 of the law, km/h.

    InputError: a law without a reference slip, or an argument of wrong type.
    """
    adhesion = published_law(law, rail, initial_speed_kmh, vehicle.wheel_load)
    slip = adhesion.reference_slip(rail)
    if slip is None:
        raise InputError(f"adhesion {law!r} has no reference slip; choose a law that has one")
    return linearize(operating_point(adhesion, vehicle, speed_kmh * KMH, slip, rail=rail))


@checked
def schedule_gains(
    speeds_kmh: Sequence[float],
    *,
    law: str = "bristle",
    vehicle: Vehicle = PARK2008,
    rails: Sequence[Rail] = tuple(Rail),
    ms_max: float,
    lead: float = 0.0,
    lead_filter: float = 0.0,
) -> GainSchedule:
    """Tune a PI at each speed and rail for the empty and the loaded vehicle, with the largest ki.

    - speeds_kmh: speeds of the entries of the schedule, km/h.
    - law: name of a published law with a reference slip.
    - vehicle: quarter car with its empty and loaded mass.
    - rails: rail conditions.
    - ms_max: largest Ms at the entries, a ratio, > 1. Between entries Ms may be slightly larger.
    - lead, lead_filter: time constants of a lead and its filter, common to all entries, s; 0 for none.

    InfeasibleDesignError if no gains meet `ms_max` at a speed; InputError if `speeds_kmh` is empty.
    """
    compensator = PIController(PIGains(kp=1.0, ki=0.0), lead, lead_filter).transfer_function
    actuator = vehicle.actuator
    entries = []
    for rail in rails:
        for speed in speeds_kmh:
            plants = [plant_at(law, loaded, rail, speed) for loaded in (vehicle, vehicle.loaded())]
            try:
                systems = [actuated_plant(plant, actuator) for plant in plants]
                design = tune_pi(systems, actuator.dead_time, ms_max=ms_max, compensator=compensator)
            except InfeasibleDesignError as error:
                raise InfeasibleDesignError(f"{rail} rail, {speed:g} km/h: {error}") from None
            entries.append(ScheduleEntry(rail, float(speed), PIGains(kp=design.kp, ki=design.ki), design.worst.ms))
    return _checked(GainSchedule(tuple(entries), lead, lead_filter, 0.0, 1.0), law, vehicle)


def _checked(draft: GainSchedule, law: str, vehicle: Vehicle) -> GainSchedule:
    """Compute worst Ms, also between the entries, and lowest stable speed; return a schedule with these values."""

    def loops(rail: Rail, speed_kmh: float) -> list[DeadTimeLoop]:
        controller = draft.controller(speed_kmh * KMH, rail)
        plants = [plant_at(law, loaded, rail, speed_kmh) for loaded in (vehicle, vehicle.loaded())]
        return [wheel_slip_loop(plant, controller, vehicle.actuator) for plant in plants]

    worst, lowest = 1.0, 0.0
    for rail in dict.fromkeys(e.rail for e in draft.entries):
        speeds = [e.speed_kmh for e in draft.entries if e.rail is rail]
        between = np.linspace(min(speeds), max(speeds), _BETWEEN)
        margins = family_margins([loop for speed in between for loop in loops(rail, float(speed))])
        worst = max(worst, float(margins.ms.max()) if margins.stable.all() else math.inf)
        top = max(speeds)

        def stable(speed_kmh: float, rail: Rail = rail) -> bool:
            return all(loop.is_stable() for loop in loops(rail, speed_kmh))

        lowest = max(
            lowest, _lowest(stable, min(_LOWEST_KMH, top / 2), top, "the loop with this gain schedule is unstable")
        )
    return replace(draft, lowest_speed_kmh=lowest, worst_ms=worst)


def lowest_held_speed(
    plant: Callable[[float], LinearPlant],
    controller: PIController,
    actuator: Actuator,
    *,
    ms_max: float = math.inf,
    low_kmh: float = _LOWEST_KMH,
) -> float:
    """Return the lower end of the speed range up to 100 km/h in which the loop is stable with Ms <= `ms_max`, km/h.

    `plant` returns the linear plant at a speed, km/h. `low_kmh` is the lower end of the search, km/h. By default
    `ms_max` is infinite, and only stability is required. InfeasibleDesignError if the requirement is not met at 100
    km/h.
    """

    def stable(speed_kmh: float) -> bool:
        loop = wheel_slip_loop(plant(speed_kmh), controller, actuator)
        return loop.is_stable() and (math.isinf(ms_max) or loop.margins().ms <= ms_max)

    return _lowest(stable, low_kmh, INITIAL_SPEED_KMH, "the loop with this controller is unstable or has too large Ms")


def lowest_stabilisable_speed(
    plant: Callable[[float], LinearPlant], actuator: Actuator, *, lead: float = 0.0, lead_filter: float = 0.0
) -> float:
    """Return the lower end of the speed range up to 100 km/h in which a PI can stabilise the loop, km/h.

    `plant` returns the linear plant at a speed, km/h. `lead` and `lead_filter` are the time constants, s, of a lead in
    series with the PI; 0 for none. The search ends at 0.5 km/h.
    """
    compensator = PIController(PIGains(kp=1.0, ki=0.0), lead, lead_filter).transfer_function

    def stabilisable(speed_kmh: float) -> bool:
        system = compensator * actuated_plant(plant(speed_kmh), actuator)
        return stabilizing_pi(system, dead_time=actuator.dead_time).kp_range is not None

    return _lowest(stabilisable, _LOWEST_KMH, INITIAL_SPEED_KMH, "no PI of this structure stabilises the loop")


def _lowest(holds: Callable[[float], bool], low: float, high: float, message: str) -> float:
    if not holds(high):
        raise InfeasibleDesignError(f"{message} at {high:g} km/h; reduce the highest speed or change the design")
    grid = np.geomspace(high, low, 60)
    failing = next((i for i, speed in enumerate(grid) if not holds(float(speed))), None)
    if failing is None:
        return low
    good, bad = float(grid[failing - 1]), float(grid[failing])
    while good - bad > _SPEED_TOLERANCE_KMH:
        middle = 0.5 * (good + bad)
        good, bad = (middle, bad) if holds(middle) else (good, middle)
    return good


Controller = Any
"""Linear controller that `systems.linear_controller` accepts, or a function that returns it for a speed or slip."""


@dataclass(frozen=True)
class MarginSweep:
    """Margins of several controllers over the values of one quantity.

    - axis, unit: name and unit of the quantity.
    - values: values of the quantity, (n,), in `unit`.
    - pole: real part of the plant's rightmost pole at each value, 1/s, (n,).
    - margins: margins of each controller, (n,) each, NaN if the loop is unstable; the keys are the controllers' names.
    """

    title: str
    axis: str
    unit: str
    values: Floats
    pole: Floats
    margins: Mapping[str, BatchMargins]


def sweep_speed(
    controllers: Mapping[str, Controller],
    speeds_kmh: Sequence[float],
    *,
    law: str = "bristle",
    rail: Rail = Rail.DRY,
    vehicle: Vehicle = PARK2008,
    initial_speed_kmh: float = INITIAL_SPEED_KMH,
) -> MarginSweep:
    """Return the margins of controllers over train speed, at the reference slip of a published adhesion law.

    `controllers` maps names to linear controllers, or to functions that return a controller for a speed, km/h.
    `initial_speed_kmh` is v0 of the law, km/h.
    """
    plants = [plant_at(law, vehicle, rail, speed, initial_speed_kmh) for speed in speeds_kmh]
    slip = plants[0].point.slip if plants else math.nan
    title = f"{law}, {rail} rail, slip {slip:g}, M {vehicle.mass:g} kg"
    return _sweep(title, "speed", "km/h", speeds_kmh, plants, controllers)


def sweep_slip(
    controllers: Mapping[str, Controller],
    slips: Sequence[float],
    *,
    law: str = "curve",
    rail: Rail = Rail.DRY,
    speed_kmh: float = 100.0,
    vehicle: Vehicle = PARK2008,
    initial_speed_kmh: float = INITIAL_SPEED_KMH,
) -> MarginSweep:
    """Return the margins of controllers over slip ratio at one train speed, also beyond the adhesion peak.

    `controllers` maps names to linear controllers, or to functions that return a controller for a slip ratio. `law` is
    the name of a published law, and `initial_speed_kmh` is v0 of this law, km/h.
    """
    adhesion = published_law(law, rail, initial_speed_kmh, vehicle.wheel_load)
    plants = [linearize(operating_point(adhesion, vehicle, speed_kmh * KMH, slip, rail=rail)) for slip in slips]
    title = f"{law}, {rail} rail, {speed_kmh:g} km/h, M {vehicle.mass:g} kg"
    return _sweep(title, "slip ratio", "-", slips, plants, controllers)


def _sweep(
    title: str,
    axis: str,
    unit: str,
    values: Sequence[float],
    plants: Sequence[LinearPlant],
    controllers: Mapping[str, Controller],
) -> MarginSweep:
    if not plants or not controllers:
        raise InputError("sweep: give at least one value and one controller")
    margins = {}
    for name, controller in controllers.items():
        scheduled = inspect.isfunction(controller) or inspect.ismethod(controller)
        fixed = [controller(float(x)) if scheduled else controller for x in values]
        loops = [wheel_slip_loop(p, controller_system(c, p.point)) for p, c in zip(plants, fixed, strict=True)]
        margins[name] = family_margins(loops)
    pole = np.array([float(plant.poles.real.max()) for plant in plants])
    return MarginSweep(title, axis, unit, np.asarray(values, dtype=float), pole, margins)
