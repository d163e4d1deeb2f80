"""One controller over speed: its loops linearised at each speed in turn, down to walking pace."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import bisect

from railslip_ctrl.design.controllers import PIController, wheel_slip_loop
from railslip_ctrl.design.families import family_margins
from railslip_ctrl.design.specification import is_robust
from railslip_ctrl.errors import RailslipError
from railslip_ctrl.linearization import LinearPlant, linearize, operating_point
from railslip_ctrl.loop import DeadTimeLoop
from railslip_ctrl.loop.batch import BatchMargins
from railslip_ctrl.parameters import Vehicle
from railslip_ctrl.units import KMH

from .held_laws import HeldLaw, held_laws
from .records import RangeLine, SpeedRange

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

SHOWN_KMH = (1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 40.0, 60.0, 80.0, 100.0)
"""Speeds of the tables; the first is the least looked at."""

_SPEEDS = 22  # of the picture, in equal ratios, beside those shown
_TOLERANCE_KMH = 1e-3  # of the speed at which stability ends; the tables show 0.01
_NEAR = (1.001, 1.02, 1.06, 1.15, 1.3, 1.4, 1.5, 1.6, 1.8, 2.0)  # above the end of stability, by it


def speed_range(name: str, controller: PIController, plants: Sequence[LinearPlant]) -> SpeedRange | None:
    """The loops of a controller over speed, on the laws it is tuned for and the one asked about, empty and loaded.

    `plants` are those of the report; `held_laws` says which laws and slips follow. None where no law has a linear
    plant.
    """
    points = [plant.point for plant in plants]
    speeds = _speeds([point.speed_kmh for point in points])
    lines: list[tuple[RangeLine, _Loops]] = []
    skipped = []
    for held in held_laws(points):
        for vehicle in points[0].vehicle.loads():
            loops = _Loops(held, vehicle, controller)
            try:
                lines.append((_line(loops, speeds), loops))
            except RailslipError as error:
                skipped.append(f"{held.law.name}, {held.rail} rail, M {vehicle.mass:g} kg: {error}")
    more = _near_ends([line for line, _ in lines], speeds)
    shown = tuple(sorted({*SHOWN_KMH, *(point.speed_kmh for point in points)}))
    return SpeedRange(name, tuple(_finer(*each, more) for each in lines), shown, tuple(skipped)) if lines else None


@dataclass(frozen=True)
class _Loops:
    """The loops of a controller on a law with one load, over speed, km/h."""

    held: HeldLaw
    vehicle: Vehicle
    controller: PIController

    def at(self, speed_kmh: float) -> DeadTimeLoop:
        law, held = self.held.at(self.vehicle), self.held
        plant = linearize(operating_point(law, self.vehicle, speed_kmh * KMH, held.slip, rail=held.rail))
        return wheel_slip_loop(plant, self.controller, self.vehicle.actuator)

    def is_stable(self, speed_kmh: float) -> bool:
        return self.at(speed_kmh).is_stable()

    def is_robust(self, speed_kmh: float) -> bool:
        loop = self.at(speed_kmh)
        return loop.is_stable() and is_robust(loop.margins().ms)

    def margins(self, speeds_kmh: Floats) -> BatchMargins:
        return family_margins([self.at(speed) for speed in speeds_kmh.tolist()])


def _speeds(asked: Sequence[float]) -> Floats:
    """Ascending, km/h: those of the tables, those asked about, and enough between them to draw."""
    top = max(*SHOWN_KMH, *asked)
    return np.unique(np.concatenate([SHOWN_KMH, asked, np.geomspace(SHOWN_KMH[0], top, _SPEEDS)[:-1]]))


def _line(loops: _Loops, speeds: Floats) -> RangeLine:
    found = loops.margins(speeds)
    robust = found.stable & [is_robust(ms) for ms in found.ms.tolist()]
    return RangeLine(
        law=loops.held.law.name,
        rail=loops.held.rail,
        mass=loops.vehicle.mass,
        slip=loops.held.slip,
        tuned=loops.held.tuned,
        speeds_kmh=speeds,
        margins=found,
        stable_from=_lower_end(speeds, found.stable, loops.is_stable),
        robust_from=_lower_end(speeds, robust, loops.is_robust),
    )


def _near_ends(lines: Sequence[RangeLine], speeds: Floats) -> Floats:
    """Speeds, beside those there are, close above where stability ends: there the margins bend most."""
    ends = [line.stable_from for line in lines if math.isfinite(line.stable_from) and not line.holds_throughout]
    near = np.outer(ends, _NEAR).ravel()
    return np.setdiff1d(near[near < speeds[-1]], speeds)


def _finer(line: RangeLine, loops: _Loops, more: Floats) -> RangeLine:
    """The line with its margins at some more speeds."""
    if not more.size:
        return line
    found = loops.margins(more)
    speeds = np.concatenate([line.speeds_kmh, more])
    order = np.argsort(speeds)
    both = {
        field.name: np.concatenate([getattr(line.margins, field.name), getattr(found, field.name)])[order]
        for field in fields(BatchMargins)
    }
    return replace(line, speeds_kmh=speeds[order], margins=BatchMargins(**both))


def _lower_end(speeds: Floats, held: object, holds: Callable[[float], bool]) -> float:
    """Lower end of the speeds, up to the highest, at which something holds: between two of them by bisection."""
    failing = np.flatnonzero(~np.asarray(held, dtype=bool))
    if failing.size == 0:
        return float(speeds[0])
    last = int(failing[-1])
    if last == speeds.size - 1:
        return math.inf
    return float(bisect(lambda v: 1.0 if holds(v) else -1.0, speeds[last], speeds[last + 1], xtol=_TOLERANCE_KMH))
