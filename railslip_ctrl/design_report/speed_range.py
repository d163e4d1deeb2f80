"""One controller over speed: its loops linearised at each speed in turn, down to walking pace."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import bisect

from railslip_ctrl.adhesion import AdhesionLaw
from railslip_ctrl.assessment import ROBUST_MS
from railslip_ctrl.design.controllers import PIController, wheel_slip_loop
from railslip_ctrl.design.families import family_margins
from railslip_ctrl.errors import RailslipError
from railslip_ctrl.linearization import LinearPlant, linearize, operating_point
from railslip_ctrl.loop import DeadTimeLoop
from railslip_ctrl.parameters import Rail, Vehicle
from railslip_ctrl.simulation.scenario import named_law
from railslip_ctrl.units import KMH

from .records import RangeLine, SpeedRange

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

TUNED_LAWS = ("curve", "bristle")
"""Laws that the full-range design is tuned for, see `simulation.designed.design_points`."""

SHOWN_KMH = (1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 40.0, 60.0, 80.0, 100.0)
"""Speeds of the tables; the first is the least looked at."""

_SPEEDS = 22  # of the picture, in equal ratios, beside those shown
_MS_SLACK = 1e-6  # a design tuned to the limit meets it to less than that
_TOLERANCE_KMH = 1e-3  # of the speed at which stability ends; the tables show 0.01
_LARGEST_MS = ROBUST_MS * (1.0 + _MS_SLACK)


def speed_range(name: str, controller: PIController, plants: Sequence[LinearPlant]) -> SpeedRange | None:
    """The loops of a controller over speed, on the laws it is tuned for and the one asked about, empty and loaded.

    `plants` are those of the report: their vehicle, rails and law are taken, the published reference slips of the
    tuned laws, and of the law asked about its own slips. None where no law has a linear plant.
    """
    first = plants[0].point
    speeds = _speeds([plant.point.speed_kmh for plant in plants])
    lines, skipped = [], []
    for law, slips, tuned in _laws(plants):
        for rail, slip in slips.items():
            for vehicle in _loads(first.vehicle):
                try:
                    lines.append(_line(law.on(rail), rail, vehicle, slip, controller, speeds, tuned=tuned))
                except RailslipError as error:
                    skipped.append(f"{law.name}, {rail} rail, M {vehicle.mass:g} kg: {error}")
    shown = tuple(sorted({*SHOWN_KMH, *(plant.point.speed_kmh for plant in plants)}))
    return SpeedRange(name, tuple(lines), shown, tuple(skipped)) if lines else None


def _speeds(asked: Sequence[float]) -> Floats:
    """Ascending, km/h: those of the tables, those asked about, and enough between them to draw."""
    top = max(*SHOWN_KMH, *asked)
    return np.unique(np.concatenate([SHOWN_KMH, asked, np.geomspace(SHOWN_KMH[0], top, _SPEEDS)[:-1]]))


def _laws(plants: Sequence[LinearPlant]) -> list[tuple[AdhesionLaw, dict[Rail, float], bool]]:
    """Laws with the slip held on each rail, and whether the full-range design is tuned for them."""
    asked, rails = plants[0].point, list(dict.fromkeys(plant.point.rail for plant in plants))
    found = []
    for name in TUNED_LAWS:
        law = named_law(name, asked.vehicle)
        slips = {rail: law.on(rail).reference_slip(rail) for rail in rails}
        found.append((law, {rail: slip for rail, slip in slips.items() if slip is not None}, True))
    if asked.adhesion not in TUNED_LAWS:
        own = {plant.point.rail: plant.point for plant in reversed(plants)}
        found += [(own[rail].law, {rail: own[rail].slip}, False) for rail in rails]
    return found


def _loads(vehicle: Vehicle) -> list[Vehicle]:
    return [vehicle] if vehicle.mass == vehicle.mass_loaded else [vehicle, vehicle.loaded()]


def _line(
    law: AdhesionLaw,
    rail: Rail,
    vehicle: Vehicle,
    slip: float,
    controller: PIController,
    speeds: Floats,
    *,
    tuned: bool,
) -> RangeLine:
    def loop(speed: float) -> DeadTimeLoop:
        plant = linearize(operating_point(law, vehicle, speed * KMH, slip, rail=rail))
        return wheel_slip_loop(plant, controller, vehicle.actuator)

    def robust(speed: float) -> bool:
        one = loop(speed)
        return one.is_stable() and one.margins().ms <= _LARGEST_MS

    found = family_margins([loop(speed) for speed in speeds.tolist()])
    return RangeLine(
        law=law.name,
        rail=rail,
        mass=vehicle.mass,
        slip=slip,
        tuned=tuned,
        speeds_kmh=speeds,
        margins=found,
        stable_from=_lower_end(speeds, found.stable, lambda speed: loop(speed).is_stable()),
        robust_from=_lower_end(speeds, found.stable & (np.nan_to_num(found.ms, nan=math.inf) <= _LARGEST_MS), robust),
    )


def _lower_end(speeds: Floats, held: object, holds: Callable[[float], bool]) -> float:
    """Lower end of the speeds, up to the highest, at which something holds: between two of them by bisection."""
    failing = np.flatnonzero(~np.asarray(held, dtype=bool))
    if failing.size == 0:
        return float(speeds[0])
    last = int(failing[-1])
    if last == speeds.size - 1:
        return math.inf
    return float(bisect(lambda v: 1.0 if holds(v) else -1.0, speeds[last], speeds[last + 1], xtol=_TOLERANCE_KMH))
