"""Maps for the design by hand: PI gains with Ms below a level, and Ms over two parameters of any controller."""

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
"""Ms of the contours of the map, descending; the map ends at the contour of the first."""

_SHARES = 1 - (1 - np.linspace(1e-4, 1.0, 12)) ** 1.7  # ki of the rows over the largest ki of a contour, denser near 1
_HALVINGS = 8  # bisections for the end of a contour
_HARDEST = 5  # number of plants of the quick map
_SPAN = 4.0  # ratio of the largest to the middle value of a parameter in `ms_cells`
_LEAST_KI = 0.1  # 1/s, ratio ki/kp at which the search for the largest ki begins if the controller has no integral
_NEAR_TOP = 1.06  # ratio of successive ki at which the search for the largest ki ends
_MOST_KI = 1e9  # ratio of ki to the first ki at which the search ends, because nothing bounds ki
_GRID = 200  # number of frequencies for finding the hardest plant

Row = tuple[float, list[Interval]]


@dataclass(frozen=True)
class GainLevel:
    """Gains with Ms of at most `ms` at all plants, or all stabilising gains if `ms` is None.

    Each row is a ki, N*m/m, with the intervals of kp, N*m/(m/s), at this ki; ki ascends from row to row.
    """

    ms: float | None
    rows: tuple[Row, ...]


def gain_levels(control: PI, plants: Sequence[LinearPlant], actuator: Actuator) -> tuple[GainLevel, ...]:
    """Return the gains of a PI that stabilise all plants, then for each of `LEVELS` those with Ms up to this level.

    The lead of `control` is in series with all gains. The result ends before the first level without gains, and it is
    empty if no gains stabilise all plants.
    """
    shape = PIController(PIGains(kp=1.0, ki=0.0), control.lead, control.lead_filter).transfer_function
    systems = [shape * actuated_plant(plant, actuator) for plant in plants]
    family = Family(systems, [actuator.dead_time] * len(systems), True, ())

    # the plant whose loop was unstable last is checked first
    order = list(range(len(systems)))

    def holds_all(kp: float, ki: float) -> bool:
        controller = pi_transfer_function(kp, ki)
        for position, i in enumerate(order):
            if not DeadTimeLoop(controller * systems[i], actuator.dead_time).is_stable():
                order.insert(0, order.pop(position))
                return False
        return True

    @cache
    def stable(ki: float) -> list[Interval]:
        intervals: list[Interval] = []
        for low, high in family.forbidden.gaps(ki, Specification()):
            if holds_all(0.5 * (low + high), ki):
                touches = bool(intervals) and intervals[-1][1] == low
                intervals[-1:] = [(intervals[-1][0], high)] if touches else [*intervals[-1:], (low, high)]
        return intervals

    def row(ki: float, ms: float | None) -> list[Interval]:
        if ms is None or not stable(ki):
            return stable(ki)
        # a gap cannot extend beyond a stable interval, because Ms is infinite at the ends of the interval
        gaps = family.forbidden.gaps(ki, Specification(ms), ki)
        return [(a, b) for a, b in gaps if any(low <= 0.5 * (a + b) <= high for low, high in stable(ki))]

    begin = abs(control.ki) or _LEAST_KI * abs(control.kp) or _LEAST_KI
    bounds: list[float | None] = [LEVELS[0], None]
    shown = [ms for ms in bounds if any(row(begin / 8.0**k, ms) for k in range(5))]
    if not shown:
        return ()
    top = _top(lambda ki: bool(row(ki, shown[0])), begin)
    levels: list[GainLevel] = []
    for ms in (None, *LEVELS):
        top = top if ms is None else _tip(lambda ki, ms=ms: bool(row(ki, ms)), top)  # type: ignore[misc]
        rows = [(ki, gaps) for ki in (top * _SHARES).tolist() if (gaps := row(ki, ms))]
        if not rows:
            break
        levels.append(GainLevel(ms, tuple(rows)))
    return tuple(levels)


def _top(met: Callable[[float], bool], begin: float) -> float:
    """Return a ki slightly above the largest ki for which `met` is true."""
    ki, ratio = begin, 2.0
    while ratio > _NEAR_TOP:
        higher = met(ki)
        while met(ki * ratio if higher else ki / ratio) == higher and begin / _MOST_KI < ki < _MOST_KI * begin:
            ki = ki * ratio if higher else ki / ratio
        ki, ratio = (ki * ratio if higher else ki), math.sqrt(ratio)
    return ki


def _tip(met: Callable[[float], bool], high: float) -> float:
    if met(high):
        return high
    low = 0.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if met(middle) else (low, middle)
    return low


def ms_cells(
    control_at: Callable[[float, float], Controller],
    around: tuple[float, float],
    count: tuple[int, int],
    plants: Sequence[LinearPlant],
    actuator: Actuator,
) -> tuple[list[float], list[float], Floats]:
    """Return the values of two parameters of a controller, and the worst Ms over all plants at each pair of values.

    - control_at: function of the two parameters that returns the controller.
    - around, count: middle value and number of values of each of the two parameters.

    Ms is inf if a loop is unstable, and NaN if `control_at` raises an error.
    """
    x, y = (_around(*pair) for pair in zip(around, count, strict=True))
    ms, loops, cells = np.full(count, np.nan), list[DeadTimeLoop](), list[tuple[int, int]]()
    case = np.arange(len(plants)), np.zeros(len(plants), dtype=int)
    for i, j in np.ndindex(*count):
        try:
            control = control_at(x[i], y[j])
        except RailslipError:
            continue
        own = control.stable_and_ms([plant.point for plant in plants], [actuator], case)
        if own is not None:
            ms[i, j] = float(np.where(own[0], own[1], np.inf).max())
            continue
        loops += [wheel_slip_loop(plant, control, actuator) for plant in plants]
        cells += [(i, j)] * len(plants)
    margins = family_margins(loops, gain_margins=False)
    np.fmax.at(ms, tuple(np.array(cells, dtype=int).reshape(-1, 2).T), np.where(margins.stable, margins.ms, np.inf))
    return x, y, ms


def _around(value: float, count: int) -> list[float]:
    share = np.linspace(-1.0, 1.0, count)
    return [float(x) for x in (value * _SPAN**share if value else share)]


def hard_plants(plants: Sequence[LinearPlant]) -> list[LinearPlant]:
    """Return at most five plants, which usually limit the gains: those with the largest poles and the smallest pole."""
    order = sorted(plants, key=_pole)
    return order if len(order) <= _HARDEST else [order[0], *order[1 - _HARDEST :]]


def _pole(plant: LinearPlant) -> float:
    return float(plant.poles.real.max(initial=-math.inf))


@dataclass(frozen=True)
class Screen:
    """Quick search for the plant, among n, with which a controller has the largest Ms, estimated at m frequencies.

    - omega: frequencies, rad/s, (m,).
    - responses: frequency responses of brake and wheel, (n, m).
    - right: number of poles of brake and wheel with positive real part, plus half the number of poles at 0, (n,).
    - speeds: train speeds, km/h, (n,).
    - poles: largest real part of the poles of each plant, 1/s, (n,).
    """

    omega: Floats
    responses: Complexes
    right: Floats
    speeds: Floats
    poles: Floats

    @classmethod
    def of(cls, points: EnvelopePoints) -> Screen:
        """Prepare the search for the plants of `points` with the vehicle's actuator."""
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
        """Return the index of the plant with the largest Ms at speeds of at least `from_kmh`, km/h.

        If loops are unstable, return the index of the plant with the fastest pole among the plants of these loops.
        """
        c = controller_system(system)
        with np.errstate(all="ignore"):
            back = 1 + c(1j * self.omega) * self.responses
            turned = np.unwrap(np.angle(back), axis=1)
            peak = np.nan_to_num(1 / np.abs(back).min(axis=1), posinf=1e300)
        # Nyquist criterion from 0 to infinity: stable if the angle turns by half a turn for each pole right of the axis
        right = self.right + np.count_nonzero(c.poles.real > 0) + np.count_nonzero(c.poles == 0) / 2
        unstable = (turned[:, -1] - turned[:, 0]) / np.pi < right - 0.5
        score = np.where(unstable, 1e300 * (1.5 + np.arctan(self.poles) / np.pi), peak)
        return _largest(score, self.speeds, from_kmh)


def fastest(points: EnvelopePoints, from_kmh: float = 0.0) -> int:
    """Return the index of the plant with the fastest pole at speeds of at least `from_kmh`, km/h."""
    plants = points.plants
    return _largest(np.array([_pole(one) for one in plants]), [one.point.speed_kmh for one in plants], from_kmh)


def _largest(score: Floats, speeds: Sequence[float] | Floats, from_kmh: float) -> int:
    above = np.asarray(speeds) > from_kmh * (1 - 1e-9)
    return int(np.argmax(np.where(above if above.any() else ~above, score, -np.inf)))
