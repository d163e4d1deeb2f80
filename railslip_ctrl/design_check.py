"""The main job: the published gains in both readings and gains that hold, at every operating point asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from .assessment import Assessment, Verdict, assess
from .comparison import PythonControlMargins, python_control_margins
from .design import HoldingDesign, PIController, holding_gains
from .errors import InfeasibleDesignError
from .linearization import LinearPlant, OperatingPoint, linearize, operating_point
from .loop.curves import FrequencyCurve, frequency_curve
from .parameters import AS_PUBLISHED_INERTIA_SCALE, PIGains, Vehicle

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

    @property
    def conclusion(self) -> str:
        """The check in a sentence or two."""
        parts = []
        for group in self.groups:
            bad = [a for a in group.assessments if a.verdict is Verdict.UNSTABLE]
            fragile = [a for a in group.assessments if a.verdict is Verdict.FRAGILE]
            total = len(group.assessments)
            if bad:
                parts.append(f"{group.title}: unstable at {len(bad)} of {total} operating points")
            elif fragile:
                worst = max(a.margins.ms for a in fragile if a.margins is not None)
                parts.append(f"{group.title}: stable but fragile (worst Ms {worst:.3g})")
            else:
                parts.append(f"{group.title}: robust at all {total} operating points")
        if self.holding is None:
            parts.append(f"a single PI that holds all points: none ({self.holding_reason})")
        return "; ".join(parts) + "."


def design_check(
    vehicle: Vehicle,
    points: Sequence[OperatingPoint],
    gains: Callable[[OperatingPoint], PIGains],
    *,
    given: bool = False,
    progress: Progress = lambda message: None,
) -> DesignCheck:
    """Check gains at operating points of one vehicle, in its own reading and as published, and gains that hold.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle of all the points.
    points : sequence of OperatingPoint
    gains : callable
        The PI gains to check at a point (SI).
    given : bool
        Whether these gains are the user's; else they are called Table 4's.
    progress : callable
        Told what is being done, a line at a time.
    """
    plants = [linearize(point) for point in points]
    name = "Given gains" if given else "Table 4's gains"
    progress(f"{name.lower()}, inertia scale {vehicle.inertia_scale:g}")
    groups = [
        _group(
            f"{name}, inertia scale {vehicle.inertia_scale:g}" + (" (SI)" if vehicle.inertia_scale == 1 else ""),
            "as given" if given else "[Park2008] Table 4, read as N*m per km/h and converted to SI",
            [(plant, PIController(gains(plant.point))) for plant in plants],
        )
    ]
    if vehicle.inertia_scale != AS_PUBLISHED_INERTIA_SCALE:
        progress(f"{name.lower()}, as-published reading")
        scaled = vehicle.model_copy(update={"inertia_scale": AS_PUBLISHED_INERTIA_SCALE})
        groups.append(
            _group(
                f"{name}, inertia scale {AS_PUBLISHED_INERTIA_SCALE:g} (as published)",
                "the units under which the published results come out: M, J and B are multiplied by 3.6",
                [(_at_scale(plant, scaled), PIController(gains(plant.point))) for plant in plants],
            )
        )
    progress("a PI that holds all operating points")
    try:
        holding = holding_gains(plants, vehicle.actuator)
    except InfeasibleDesignError as error:
        return DesignCheck(vehicle, tuple(groups), None, str(error))
    groups.append(
        _group(
            f"Holding PI, inertia scale {vehicle.inertia_scale:g}" + (" (SI)" if vehicle.inertia_scale == 1 else ""),
            f"least worst Ms at integral time {holding.integral_time:g} s; kp from {holding.gain_range[0]:.4g} to "
            f"{holding.gain_range[1]:.4g} N*m/(m/s) stabilises all operating points",
            [(plant, holding.controller) for plant in plants],
        )
    )
    return DesignCheck(vehicle, tuple(groups), holding, "")


def _at_scale(plant: LinearPlant, vehicle: Vehicle) -> LinearPlant:
    point = plant.point
    return linearize(operating_point(point.law, vehicle, point.speed, point.slip, rail=point.rail))


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
