"""The main job: the published gains in both readings and gains that hold, at every operating point asked for."""

from __future__ import annotations

import datetime
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from .assessment import Assessment, Verdict, assess
from .comparison import PythonControlMargins, python_control_margins
from .design import HoldingDesign, PIController, holding_gains
from .errors import InfeasibleDesignError
from .linearization import LinearPlant, OperatingPoint, linearize, operating_point
from .loop.curves import FrequencyCurve, frequency_curve
from .parameters import AS_PUBLISHED_INERTIA_SCALE, PIGains, Vehicle, table4_gains
from .rounding import rounded_up

Progress = Callable[[str], None]


@dataclass(frozen=True)
class ControllerGroup:
    """One controller in one reading of the units, at every operating point.

    Beside each assessment stand its frequency response and what python-control's margins say of the loop.
    """

    title: str
    remark: str
    assessments: tuple[Assessment, ...]
    curves: tuple[FrequencyCurve, ...]
    python_control: tuple[PythonControlMargins, ...]


@dataclass(frozen=True)
class DesignCheck:
    """The whole check. `holding` is None where no single PI holds all points, with the reason beside it."""

    vehicle: Vehicle
    groups: tuple[ControllerGroup, ...]
    holding: HoldingDesign | None
    holding_reason: str
    date: datetime.date = field(default_factory=datetime.date.today)

    @property
    def conclusion(self) -> str:
        """The check in a sentence or two."""
        parts = []
        for group in self.groups:
            bad = [a for a in group.assessments if a.verdict is Verdict.UNSTABLE]
            fragile = [a for a in group.assessments if a.verdict is Verdict.FRAGILE]
            open_loop = [a for a in group.assessments if a.verdict is Verdict.NO_FEEDBACK]
            total = len(group.assessments)
            if bad:
                of = "the operating point" if total == 1 else f"{len(bad)} of {total} operating points"
                parts.append(f"{group.title}: unstable at {of}")
            elif fragile:
                worst = max(a.margins.ms for a in fragile if a.margins is not None)
                parts.append(f"{group.title}: stable but fragile (worst Ms {rounded_up(worst):g})")
            elif open_loop:
                parts.append(f"{group.title}: no feedback, and the wheel stable by itself")
            else:
                points = "the operating point" if total == 1 else f"all {total} operating points"
                parts.append(f"{group.title}: robust at {points}")
        if self.holding is None:
            parts.append(f"a single PI that holds all points: none ({self.holding_reason})")
        return "; ".join(parts) + "."


def design_check(
    vehicle: Vehicle,
    points: Sequence[OperatingPoint],
    *,
    given: PIGains | None = None,
    progress: Progress = lambda message: None,
) -> DesignCheck:
    """Check the published gains (and given ones) at operating points of one vehicle, and find gains that hold.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle of all the points.
    points : sequence of OperatingPoint
    given : PIGains or None
        Gains to check beside the published ones (SI), at the vehicle's own inertia scale.
    progress : callable
        Told what is being done, a line at a time.

    Notes
    -----
    The published gains are checked in both readings of the units, inertia scale 1 and 3.6, and at the vehicle's own
    scale if that is another.
    """
    plants = [linearize(point) for point in points]
    groups = []
    if given is not None:
        progress("the given gains")
        title = f"Given gains, {_scale_name(vehicle.inertia_scale)}"
        groups.append(_group(title, "as given", [(plant, PIController(given)) for plant in plants]))
    for scale in dict.fromkeys((1.0, AS_PUBLISHED_INERTIA_SCALE, vehicle.inertia_scale)):
        progress(f"Table 4's gains, {_scale_name(scale)}")
        groups.append(_published_group(vehicle, plants, scale))
    progress("a PI that holds all operating points")
    try:
        holding = holding_gains(plants, vehicle.actuator)
    except InfeasibleDesignError as error:
        return DesignCheck(vehicle, tuple(groups), None, str(error))
    groups.append(
        _group(
            f"Holding PI, {_scale_name(vehicle.inertia_scale)}",
            f"least worst Ms at integral time {holding.integral_time:g} s; with that integral time, kp "
            f"{_range_words(holding.gain_range)} stabilises all operating points",
            [(plant, holding.controller) for plant in plants],
        )
    )
    return DesignCheck(vehicle, tuple(groups), holding, "")


def _range_words(gains: tuple[float, float]) -> str:
    low, high = gains
    return f"above {low:.4g} N*m/(m/s)" if math.isinf(high) else f"from {low:.4g} to {high:.4g} N*m/(m/s)"


def _scale_name(scale: float) -> str:
    names = {1.0: " (SI)", AS_PUBLISHED_INERTIA_SCALE: " (as published)"}
    return f"inertia scale {scale:g}{names.get(scale, '')}"


def _published_group(vehicle: Vehicle, plants: Sequence[LinearPlant], scale: float) -> ControllerGroup:
    remark = "[Park2008] Table 4, read as N*m per km/h and converted to SI"
    if scale == AS_PUBLISHED_INERTIA_SCALE:
        remark += "; M, J and B times 3.6: the units under which the published results come out"
    scaled = vehicle.model_copy(update={"inertia_scale": scale})
    loops = [(_at_scale(plant, scaled), PIController(table4_gains(plant.point.adhesion))) for plant in plants]
    return _group(f"Table 4's gains, {_scale_name(scale)}", remark, loops)


def _at_scale(plant: LinearPlant, vehicle: Vehicle) -> LinearPlant:
    point = plant.point
    return linearize(
        operating_point(
            point.law,
            vehicle,
            point.speed,
            point.slip,
            rail=point.rail,
            initial_speed_kmh=point.initial_speed_kmh,
        )
    )


def _group(title: str, remark: str, loops: Sequence[tuple[LinearPlant, PIController]]) -> ControllerGroup:
    assessments = (assess(plant, controller, plant.point.vehicle.actuator, label=title) for plant, controller in loops)
    return controller_group(title, remark, tuple(assessments))


def controller_group(title: str, remark: str, assessments: tuple[Assessment, ...]) -> ControllerGroup:
    """Assessed loops under one title, with frequency responses over their common band."""
    bands = [a.loop.feature_band() for a in assessments]
    low, high = min(band[0] for band in bands), max(band[1] for band in bands)
    return ControllerGroup(
        title,
        remark,
        assessments,
        curves=tuple(frequency_curve(a.loop, low, high) for a in assessments),
        python_control=tuple(python_control_margins(a.loop) for a in assessments),
    )
