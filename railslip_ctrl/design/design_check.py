"""Loops of one controller under one title, and Table 4's gains in both readings of the units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from railslip_ctrl.design import PIController
from railslip_ctrl.loop.deadtime import FrequencyCurve, frequency_curve
from railslip_ctrl.model.linearization import OperatingPoint, linearize, operating_point
from railslip_ctrl.model.vehicle import AS_PUBLISHED_INERTIA_SCALE, Vehicle, table4_gains

from .assessment import Assessment, assess


@dataclass(frozen=True)
class ControllerGroup:
    """One controller in one reading of the units, at every operating point, each with its frequency response."""

    title: str
    assessments: tuple[Assessment, ...]
    curves: tuple[FrequencyCurve, ...]


def published_groups(points: Sequence[OperatingPoint]) -> tuple[ControllerGroup, ...]:
    """Table 4's PI gains at operating points, in SI and as published: M, J and B times 3.6."""
    return tuple(_published(points, scale, name) for scale, name in _READINGS)


_READINGS = ((1.0, "SI"), (AS_PUBLISHED_INERTIA_SCALE, "as published"))


def _published(points: Sequence[OperatingPoint], scale: float, name: str) -> ControllerGroup:
    title = f"Table 4's gains, inertia scale {scale:g} ({name})"
    found = []
    for point in points:
        scaled = _at_scale(point, point.vehicle.model_copy(update={"inertia_scale": scale}))
        gains = PIController(table4_gains(point.adhesion))
        found.append(assess(linearize(scaled), gains, point.vehicle.actuator, label=title))
    return controller_group(title, tuple(found))


def _at_scale(point: OperatingPoint, vehicle: Vehicle) -> OperatingPoint:
    v0 = point.initial_speed_kmh
    return operating_point(point.law, vehicle, point.speed, point.slip, rail=point.rail, initial_speed_kmh=v0)


def controller_group(title: str, assessments: tuple[Assessment, ...]) -> ControllerGroup:
    """Assessed loops under one title, with frequency responses over their common band."""
    bands = [a.loop.feature_band() for a in assessments]
    low, high = min(band[0] for band in bands), max(band[1] for band in bands)
    return ControllerGroup(title, assessments, tuple(frequency_curve(a.loop, low, high) for a in assessments))
