"""Which gains keep an Ms at every operating point, as rows of a map; Ms over any two numbers of a controller, as cells.

A row is exact in its ends, by what each frequency forbids (`tuning_search`), as far as the loop within it is stable, by
its root count.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

from railslip_ctrl.controllers.base import Controller
from railslip_ctrl.controllers.pi import PI
from railslip_ctrl.controllers.systems import (
    PIController,
    actuated_plant,
    controller_system,
    pi_transfer_function,
    wheel_slip_loop,
)
from railslip_ctrl.core.arguments import Complexes, Floats
from railslip_ctrl.core.errors import RailslipError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.loop import DeadTimeLoop
from railslip_ctrl.model.linearization import LinearPlant
from railslip_ctrl.model.vehicle import Actuator, PIGains

from .decomposition import Interval
from .envelope import EnvelopePoints
from .specification import Specification, family_margins
from .tuning_search import Family

LEVELS = (4.0, 3.0, 2.5, 2.0, 1.8, 1.6, 1.4)
"""Ms of the contours, falling; the first bounds the map."""

_SHARES = 1 - (1 - np.linspace(1e-4, 1.0, 12)) ** 1.7  # rows of a contour over its largest ki, closer near that
_HALVINGS = 8  # of where a contour ends
_HARDEST = 5  # plants that the quick map is of
_SPAN = 4.0  # of cells: each number from a quarter to four times
_LEAST_KI = 0.1  # 1/s: ki over kp, from which the top of a map is looked for where there is no integral action
_NEAR_TOP = 1.06  # ratio to which the top is found
_MOST_KI = 1e9  # over the gain that the top is looked for from: beyond, nothing bounds it
_GRID = 200  # frequencies at which the hardest plant is looked for

Row = tuple[float, list[Interval]]


@dataclass(frozen=True)
class GainLevel:
    """The gains that keep an Ms, or if that is None are stable: rows of ki, N*m/m, ascending, each with its intervals
    of kp, N*m/(m/s)."""

    ms: float | None
    rows: tuple[Row, ...]


def gain_levels(control: PI, plants: Sequence[LinearPlant], actuator: Actuator) -> tuple[GainLevel, ...]:
    """The map of a PI's gains behind its lead, from stable to the least Ms of `LEVELS` that some gains keep at all the
    plants; empty where nothing is stable."""
    shape = PIController(PIGains(kp=1.0, ki=0.0), control.lead, control.lead_filter).transfer_function
    systems = [shape * actuated_plant(plant, actuator) for plant in plants]
    family = Family(systems, [actuator.dead_time] * len(systems), True, ())

    order = list(range(len(systems)))

    def holds_all(kp: float, ki: float) -> bool:
        """By exact root counts; a plant that says no is asked first the next time."""
        controller = pi_transfer_function(kp, ki)
        for place, i in enumerate(order):
            if not DeadTimeLoop(controller * systems[i], actuator.dead_time).is_stable():
                order.insert(0, order.pop(place))
                return False
        return True

    @cache
    def stable(ki: float) -> list[Interval]:
        found: list[Interval] = []
        for low, high in family.forbidden.gaps(ki, Specification()):
            if holds_all(0.5 * (low + high), ki):
                touches = bool(found) and found[-1][1] == low
                found[-1:] = [(found[-1][0], high)] if touches else [*found[-1:], (low, high)]
        return found

    def row(ki: float, ms: float | None) -> list[Interval]:
        """No pole is on the axis where Ms is kept: what lies in a stable interval is stable."""
        if ms is None or not stable(ki):
            return stable(ki)
        gaps = family.forbidden.gaps(ki, Specification(ms), ki)
        return [(a, b) for a, b in gaps if any(low <= 0.5 * (a + b) <= high for low, high in stable(ki))]

    begin = abs(control.ki) or _LEAST_KI * abs(control.kp) or _LEAST_KI
    bounds: list[float | None] = [LEVELS[0], None]
    shown = [ms for ms in bounds if any(row(begin / 8.0**k, ms) for k in range(5))]
    if not shown:
        return ()
    top = _top(lambda ki: bool(row(ki, shown[0])), begin)
    found: list[GainLevel] = []
    for ms in (None, *LEVELS):
        top = top if ms is None else _tip(lambda ki, ms=ms: bool(row(ki, ms)), top)  # type: ignore[misc]
        rows = [(ki, gaps) for ki in (top * _SHARES).tolist() if (gaps := row(ki, ms))]
        if not rows:
            break
        found.append(GainLevel(ms, tuple(rows)))
    return tuple(found)


def _top(met: Callable[[float], bool], begin: float) -> float:
    """A ki above all that meet something, and near the largest that does."""
    ki, ratio = begin, 2.0
    while ratio > _NEAR_TOP:
        higher = met(ki)
        while met(ki * ratio if higher else ki / ratio) == higher and begin / _MOST_KI < ki < _MOST_KI * begin:
            ki = ki * ratio if higher else ki / ratio
        ki, ratio = (ki * ratio if higher else ki), math.sqrt(ratio)
    return ki


def _tip(met: Callable[[float], bool], high: float) -> float:
    """The largest ki up to one that meets something, by halving."""
    if met(high):
        return high
    low = 0.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if met(middle) else (low, middle)
    return low


def ms_cells(
    made: Callable[[float, float], Controller],
    around: tuple[float, float],
    count: tuple[int, int],
    plants: Sequence[LinearPlant],
    actuator: Actuator,
) -> tuple[list[float], list[float], Floats]:
    """Worst Ms over two numbers of a controller: their values around two, and Ms, inf where a loop is unstable, NaN
    where `made` allows no controller."""
    x, y = (_around(*pair) for pair in zip(around, count, strict=True))
    ms, loops, places = np.full(count, np.nan), list[DeadTimeLoop](), list[tuple[int, int]]()
    case = np.arange(len(plants)), np.zeros(len(plants), dtype=int)
    for i, j in np.ndindex(*count):
        try:
            control = made(x[i], y[j])
        except RailslipError:
            continue
        own = control.stable_and_ms([plant.point for plant in plants], [actuator], case)
        if own is not None:
            ms[i, j] = float(np.where(own[0], own[1], np.inf).max())
            continue
        loops += [wheel_slip_loop(plant, control, actuator) for plant in plants]
        places += [(i, j)] * len(plants)
    margins = family_margins(loops, gain_margins=False)
    np.fmax.at(ms, tuple(np.array(places, dtype=int).reshape(-1, 2).T), np.where(margins.stable, margins.ms, np.inf))
    return x, y, ms


def _around(value: float, count: int) -> list[float]:
    """Values around one in equal ratios; around 0 from -1 to 1."""
    share = np.linspace(-1.0, 1.0, count)
    return [float(x) for x in (value * _SPAN**share if value else share)]


def hard_plants(plants: Sequence[LinearPlant]) -> list[LinearPlant]:
    """The fastest plants and the slowest: those that bound the gains from below and from above, as a rule."""
    order = sorted(plants, key=_pole)
    return order if len(order) <= _HARDEST else [order[0], *order[1 - _HARDEST :]]


def _pole(plant: LinearPlant) -> float:
    return float(plant.poles.real.max(initial=-math.inf))


@dataclass(frozen=True)
class Screen:
    """Which of many plants is the hardest for a controller, by |S| on a grid of frequencies; made by `of`.

    A look, to choose whose margins are worth their time: of a plant's loop that seems unstable the exact count decides.

    - omega: (m,), rad/s; responses: (n, m), of brake and wheel; right: (n,), poles of these right of the axis, those on
      it by half; speeds: (n,), km/h; poles: (n,), the fastest, 1/s.
    """

    omega: Floats
    responses: Complexes
    right: Floats
    speeds: Floats
    poles: Floats

    @classmethod
    def of(cls, points: EnvelopePoints) -> Screen:
        """The plants of some points, with the brake as given."""
        brake = points.vehicle.actuator
        loops = [DeadTimeLoop(actuated_plant(plant, brake), brake.dead_time) for plant in points.plants]
        low, high = zip(*(loop.feature_band() for loop in loops), strict=True)
        omega = np.geomspace(min(low), max(high), _GRID)
        return cls(
            omega=omega,
            responses=np.array([loop.response(omega) for loop in loops]),
            right=np.array([loop.open_loop_unstable_poles + loop.integrators / 2 for loop in loops], dtype=float),
            speeds=np.array([plant.point.speed_kmh for plant in points.plants]),
            poles=np.array([_pole(plant) for plant in points.plants]),
        )

    def hardest(self, system: Any, from_kmh: float = 0.0) -> int:
        """The number of the plant, from a speed up, that is hardest for a continuous linear system; without one (None)
        the fastest."""
        above = self.speeds > from_kmh * (1 - 1e-9)
        allowed = above if above.any() else ~above
        if system is None:
            return int(np.argmax(np.where(allowed, self.poles, -np.inf)))
        c = controller_system(system)
        with np.errstate(all="ignore"):
            back = 1 + c(1j * self.omega) * self.responses
            turned = np.unwrap(np.angle(back), axis=1)
            peak = np.nan_to_num(1 / np.abs(back).min(axis=1), posinf=1e300)
        # Nyquist's count, from 0 to infinity: what lacks of half a turn a pole right of the axis is unstable
        right = self.right + np.count_nonzero(c.poles.real > 0) + np.count_nonzero(c.poles == 0) / 2
        unstable = (turned[:, -1] - turned[:, 0]) / np.pi < right - 0.5
        score = np.where(unstable, 1e300 * (1.5 + np.arctan(self.poles) / np.pi), peak)
        return int(np.argmax(np.where(allowed, score, -np.inf)))
