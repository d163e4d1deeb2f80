"""The adhesion laws that a report computes with, each with the slip held on it: published ones, or the user's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from railslip_ctrl.adhesion import AdhesionLaw
from railslip_ctrl.law_sources import is_own
from railslip_ctrl.linearization import LinearPlant, OperatingPoint, linearize, operating_point
from railslip_ctrl.numeric import peak
from railslip_ctrl.parameters import Rail, Vehicle
from railslip_ctrl.simulation.designed import INITIAL_SHARE, SPEEDS_KMH
from railslip_ctrl.simulation.scenario import named_law
from railslip_ctrl.units import KMH

TUNED_LAWS = ("curve", "bristle")
"""Published laws that the full-range design is tuned for, see `simulation.designed.design_points`."""


DRY_START = 0.25
"""Initial torque by wheel load times radius where the rail is known to be dry; the published curve's peak is 0.3."""

RELAY_SHARE = 1.0 / 3.0
"""Torque of the relay by wheel load times radius: what the best published dry adhesion takes, about."""

_WET_PEAK, _DRY_PEAK = 0.153, 0.3  # of the published curve, which the shares are made for


@dataclass(frozen=True)
class Torques:
    """Torques that runs begin with, N*m: what every rail takes, what a dry one does, and the relay's."""

    sure: float
    dry: float
    relay: float


@dataclass(frozen=True)
class HeldLaw:
    """A law on a rail, with the slip ratio held, and whether the full-range design is tuned for it.

    `law` is at `wheel_load`, N.
    """

    law: AdhesionLaw
    rail: Rail
    slip: float
    wheel_load: float
    tuned: bool

    def at(self, vehicle: Vehicle) -> AdhesionLaw:
        """The law at the vehicle's wheel load, mu as it was."""
        return self.law.at_wheel_load(vehicle.wheel_load / self.wheel_load)


def held_laws(points: Sequence[OperatingPoint]) -> tuple[HeldLaw, ...]:
    """Law by law, rail by rail: those tuned for, and the one asked about where it is another.

    Of the published laws asked about, the slips are the published ones; of a law of the user's own, which alone is
    tuned for then, those of its points, the first on each rail.
    """
    own = {point.rail: point for point in reversed(points)}
    rails = list(dict.fromkeys(point.rail for point in points))
    first, load = points[0], points[0].vehicle.wheel_load
    asked = [HeldLaw(own[rail].law, rail, own[rail].slip, load, tuned=is_own(first)) for rail in rails]
    if is_own(first):
        return tuple(asked)
    tuned = [
        HeldLaw(law.on(rail), rail, getattr(law.reference, rail.value), load, tuned=True)
        for law in (named_law(name, first.vehicle) for name in TUNED_LAWS)
        for rail in rails
    ]
    return tuple(tuned if first.adhesion in TUNED_LAWS else tuned + asked)


def torques(points: Sequence[OperatingPoint]) -> Torques:
    """What the runs of a vehicle begin with: the published shares of wheel load times radius.

    Of a law of the user's own, the same parts of its peaks, the lowest over its rails and `SPEEDS_KMH` and the lowest
    on the rail that has most.
    """
    vehicle = points[0].vehicle
    load = vehicle.wheel_load * vehicle.wheel.radius
    low = high = 1.0
    if is_own(points[0]):
        peaks = [
            min(peak(held.law, speed * KMH, vehicle.wheel_load).coefficient for speed in SPEEDS_KMH)
            for held in held_laws(points)
        ]
        low, high = min(peaks) / _WET_PEAK, max(peaks) / _DRY_PEAK
    return Torques(sure=low * INITIAL_SHARE * load, dry=high * DRY_START * load, relay=high * RELAY_SHARE * load)


def own_design_points(points: Sequence[OperatingPoint]) -> list[LinearPlant]:
    """Linear plants over speeds and loads of a law of the user's own, for the full-range design to be tuned over.

    Empty where the points are of a published law, for which `simulation.designed.design_points` has them.
    """
    if not is_own(points[0]):
        return []
    return [
        linearize(operating_point(held.at(load), load, speed * KMH, held.slip, rail=held.rail))
        for held in held_laws(points)
        for load in points[0].vehicle.loads()
        for speed in SPEEDS_KMH
    ]
