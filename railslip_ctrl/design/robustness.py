"""Worst case of a controller over the operating range: rail, speed, load, slip, actuator, adhesion law."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.adhesion import AdhesionLaw, published_law
from railslip_ctrl.errors import DomainError, InputError, KinkError
from railslip_ctrl.linearization import LinearPlant, linearize, operating_point
from railslip_ctrl.loop.batch import BatchMargins
from railslip_ctrl.parameters import INITIAL_SPEED_KMH, PARK2008, Actuator, Rail, Vehicle
from railslip_ctrl.units import KMH

from .controllers import PIController, wheel_slip_loop
from .families import family_margins

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class OperatingRange:
    """What the loop is asked to stand, each list of values combined with every other.

    speeds_kmh: km/h. masses: kg; empty means the vehicle's empty and loaded. slip_factors: on the law's reference
    slip of the rail, so that values below and above 1 go through the adhesion peak. dead_time_factors, lag_factors:
    on the actuator's. laws: names of adhesion laws with published parameters.
    """

    rails: tuple[Rail, ...] = tuple(Rail)
    speeds_kmh: tuple[float, ...] = (5.0, 10.0, 20.0, 40.0, 60.0, 80.0, 100.0, 120.0, 140.0)
    masses: tuple[float, ...] = ()
    slip_factors: tuple[float, ...] = (0.5, 0.75, 0.9, 1.0, 1.1, 1.25, 1.5)
    dead_time_factors: tuple[float, ...] = (0.7, 1.0, 1.3)
    lag_factors: tuple[float, ...] = (0.7, 1.0, 1.3)
    laws: tuple[str, ...] = ("bristle", "curve", "beam")
    initial_speed_kmh: float = INITIAL_SPEED_KMH

    def __post_init__(self) -> None:
        for name in ("rails", "speeds_kmh", "slip_factors", "dead_time_factors", "lag_factors", "laws"):
            if not getattr(self, name):
                raise InputError(f"operating range: {name} is empty; give at least one value")
        for name in ("speeds_kmh", "masses", "slip_factors"):
            bad = [x for x in getattr(self, name) if not (math.isfinite(x) and x > 0)]
            if bad:
                raise InputError(f"operating range: {name}: {bad[0]:g} is not allowed; give finite values > 0")
        for name in ("dead_time_factors", "lag_factors"):
            bad = [x for x in getattr(self, name) if not (math.isfinite(x) and x >= 0)]
            if bad:
                raise InputError(f"operating range: {name}: {bad[0]:g} is not allowed; give finite values >= 0")


@dataclass(frozen=True)
class RangeCase:
    """One member of the range: the linear plant at its operating point, the actuator, and the factor on the slip."""

    plant: LinearPlant
    actuator: Actuator
    slip_factor: float

    @property
    def axes(self) -> dict[str, object]:
        """What the case is, by axis of the range."""
        point = self.plant.point
        return {
            "adhesion": point.adhesion,
            "rail": point.rail.value,
            "speed, km/h": point.speed_kmh,
            "mass, kg": point.vehicle.mass,
            "slip / reference": self.slip_factor,
            "dead time, s": self.actuator.dead_time,
            "lag, s": self.actuator.lag,
        }


@dataclass(frozen=True)
class SkippedCase:
    """A member that has no linear plant, and why (outside the law's domain, or a kink)."""

    what: str
    reason: str


def range_cases(
    operating_range: OperatingRange, vehicle: Vehicle = PARK2008
) -> tuple[tuple[RangeCase, ...], tuple[SkippedCase, ...]]:
    """The cases of the range, in the order laws, rails, speeds, masses, slips, dead times, lags; and those left out."""
    cases: list[RangeCase] = []
    skipped: list[SkippedCase] = []
    actuators = [
        Actuator(dead_time=a * vehicle.actuator.dead_time, lag=b * vehicle.actuator.lag)
        for a, b in product(operating_range.dead_time_factors, operating_range.lag_factors)
    ]
    loads = _loads(operating_range, vehicle)
    for name, rail in product(operating_range.laws, operating_range.rails):
        laws = [published_law(name, rail, operating_range.initial_speed_kmh, each.wheel_load) for each in loads]
        under_loads = list(zip(laws, loads, strict=True))
        for speed, (law, loaded), factor in product(
            operating_range.speeds_kmh, under_loads, operating_range.slip_factors
        ):
            try:
                plant = linearize(operating_point(law, loaded, speed * KMH, factor * _reference(law, rail), rail=rail))
            except (DomainError, KinkError) as error:
                skipped.append(SkippedCase(f"{name}, {rail}, {speed:g} km/h, slip factor {factor:g}", str(error)))
                continue
            cases += [RangeCase(plant, actuator, factor) for actuator in actuators]
    return tuple(cases), tuple(skipped)


def _loads(operating_range: OperatingRange, vehicle: Vehicle) -> list[Vehicle]:
    if operating_range.masses:
        return [vehicle.model_copy(update={"mass": m, "mass_loaded": m}) for m in operating_range.masses]
    return list(vehicle.loads())


def _reference(law: AdhesionLaw, rail: Rail) -> float:
    slip = law.reference_slip(rail)
    if slip is None:
        raise InputError(f"operating range: adhesion {law.name!r} has no reference slip; leave it out")
    return slip


@dataclass(frozen=True)
class Robustness:
    """A controller over a range: the margins of every case, and the cases left out."""

    controller: PIController
    cases: tuple[RangeCase, ...]
    margins: BatchMargins
    skipped: tuple[SkippedCase, ...]

    @property
    def stable_share(self) -> float:
        """Share of the cases in which the loop is stable."""
        return float(self.margins.stable.mean())

    @cached_property
    def worst_index(self) -> int:
        """The worst case: of unstable loops the one whose plant pole is fastest against its actuator, p (tau + T);
        if all are stable the one of largest Ms."""
        if self.margins.stable.all():
            return int(np.argmax(self.margins.ms))
        products = np.array([c.plant.poles.real.max() * (c.actuator.dead_time + c.actuator.lag) for c in self.cases])
        return int(np.argmax(np.where(self.margins.stable, -np.inf, products)))

    @property
    def worst(self) -> RangeCase:
        """The worst case."""
        return self.cases[self.worst_index]

    @property
    def worst_ms(self) -> float:
        """Largest Ms; inf if any loop is unstable."""
        return float(self.margins.ms.max()) if self.margins.stable.all() else math.inf

    def suffices(self, ms_max: float) -> bool:
        """Whether this one gain set keeps every case stable with Ms <= ms_max."""
        return self.worst_ms <= ms_max

    def by_axis(self) -> dict[str, dict[object, tuple[float, float]]]:
        """For each axis of the range and each of its values: (share stable, worst Ms of the stable ones)."""
        table: dict[str, dict[object, tuple[float, float]]] = {}
        labels = [case.axes for case in self.cases]
        for axis in labels[0]:
            values = np.array([label[axis] for label in labels], dtype=object)
            table[axis] = {value: self._summary(values == value) for value in dict.fromkeys(values)}
        return table

    def speed_slip_map(self, law: str, rail: Rail) -> tuple[Floats, Floats, Floats]:
        """(speeds km/h, slip factors, worst Ms over load and actuator): shapes (m,), (n,), (m, n); inf is unstable,
        NaN left out."""
        mine = [i for i, c in enumerate(self.cases) if (c.plant.point.adhesion, c.plant.point.rail) == (law, rail)]
        speeds = np.array(sorted({round(self.cases[i].plant.point.speed_kmh, 9) for i in mine}))
        slips = np.array(sorted({self.cases[i].slip_factor for i in mine}))
        worst = np.full((speeds.size, slips.size), np.nan)
        for i in mine:
            row = int(np.searchsorted(speeds, round(self.cases[i].plant.point.speed_kmh, 9)))
            column = int(np.searchsorted(slips, self.cases[i].slip_factor))
            value = self.margins.ms[i] if self.margins.stable[i] else np.inf
            worst[row, column] = np.fmax(worst[row, column], value)
        return speeds, slips, worst

    def _summary(self, chosen: NDArray[np.bool_]) -> tuple[float, float]:
        stable = self.margins.stable & chosen
        worst = float(self.margins.ms[stable].max()) if stable.any() else math.inf
        return float(stable.sum() / chosen.sum()), worst


def robustness(
    controller: PIController, operating_range: OperatingRange | None = None, vehicle: Vehicle = PARK2008
) -> Robustness:
    """Margins of one controller over the whole range (the default one if none is given), the dead time exact."""
    cases, skipped = range_cases(operating_range or OperatingRange(), vehicle)
    return robustness_of(controller, cases, skipped)


def robustness_of(
    controller: PIController, cases: Sequence[RangeCase], skipped: Sequence[SkippedCase] = ()
) -> Robustness:
    """As `robustness`, for cases already made by `range_cases` (to compare controllers on the same ones)."""
    if not cases:
        raise InputError("operating range: no case is left; widen it")
    margins = family_margins([wheel_slip_loop(case.plant, controller, case.actuator) for case in cases])
    return Robustness(controller, tuple(cases), margins, tuple(skipped))
