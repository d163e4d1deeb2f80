"""Margins of controllers along one axis: speed, or slip through the adhesion peak."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import KMH
from railslip_ctrl.loop.batch import BatchMargins
from railslip_ctrl.model.adhesion import published_law
from railslip_ctrl.model.linearization import LinearPlant, linearize, operating_point
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH, PARK2008, Rail, Vehicle

from .controllers import controller_system, wheel_slip_loop
from .families import family_margins

Controller = Any
"""A fixed linear controller (`controllers.linear_controller`), or a function of the sweep's own axis that gives one."""


@dataclass(frozen=True)
class MarginSweep:
    """Margins of named controllers along an axis.

    axis, unit: what varies. values: array (n,). pole: rightmost plant pole at each, 1/s. margins: by controller name,
    arrays (n,), NaN where unstable. title: what is fixed.
    """

    title: str
    axis: str
    unit: str
    values: NDArray[np.float64]
    pole: NDArray[np.float64]
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
    """Margins against train speed (km/h) at the law's reference slip."""
    adhesion = published_law(law, rail, initial_speed_kmh, vehicle.wheel_load)
    slip = adhesion.reference_slip(rail)
    if slip is None:
        raise InputError(f"adhesion {law!r} has no reference slip; sweep another law")
    plants = [
        linearize(operating_point(adhesion, vehicle, v * KMH, slip, rail=rail, initial_speed_kmh=initial_speed_kmh))
        for v in speeds_kmh
    ]
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
    """Margins against slip ratio at one train speed (km/h), through the adhesion peak."""
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
