"""Designs that a report compares: published, given, holding, behind a lead, and the layered law within its layer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from railslip_ctrl.design import PIController, actuated_plant
from railslip_ctrl.design.holding import NO_FEEDBACK_NEEDED, needs_feedback
from railslip_ctrl.design.specification import ROBUST_MS
from railslip_ctrl.design.tuning import PIDesign, tune_pi
from railslip_ctrl.design_check import DesignCheck
from railslip_ctrl.errors import InfeasibleDesignError, InputError
from railslip_ctrl.linearization import LinearPlant, OperatingPoint
from railslip_ctrl.parameters import PIGains, Vehicle, table4_gains
from railslip_ctrl.simulation.designed import (
    MS_MAX,
    SPEEDS_KMH,
    full_range_gains,
    is_tuned_when_asked,
    lag_lead,
    lead_of,
    recommended_pi_lead,
)
from railslip_ctrl.sliding_verification.layered import LEAST_INTEGRAL_GAIN, layered_design

from .held_laws import own_design_points
from .records import Origin

KI_MIN = 5.0
"""Least ki of the tuned designs, N*m/m: without a least one the integral action vanishes."""


@dataclass(frozen=True)
class DesignNames:
    """What a report calls the designs tuned for a vehicle: a "PI-lead" only where there is a lag to lead."""

    full_range: str
    least_ms: str
    largest_ki: str

    @property
    def started_dry(self) -> str:
        """The full-range design begun with the torque of a dry rail."""
        return f"{self.full_range}, started for dry rail"


def design_names(vehicle: Vehicle) -> DesignNames:
    """The names for a vehicle."""
    full = _structure(lead_of(vehicle))
    own = _structure(lag_lead(vehicle.actuator))
    return DesignNames(f"{full}, full range", f"{own}, least Ms", f"{own}, largest ki")


def _structure(lead: tuple[float, float]) -> str:
    return PIController(PIGains(kp=1.0, ki=1.0), *lead).structure


@dataclass(frozen=True)
class Candidate:
    """A controller with what `LoopDesign` says of where it comes from."""

    name: str
    how: str
    controller: PIController
    origin: Origin = Origin.COMPUTED
    over_range: bool = False
    needs_hold: bool = False


Made = Callable[[], Candidate]


def candidates(
    check: DesignCheck, plants: Sequence[LinearPlant], given: PIGains | None
) -> tuple[tuple[Candidate, ...], dict[str, str]]:
    """Designs in order; and those that do not exist, with the reason."""
    vehicle = check.vehicle
    how = "[Park2008] Table 4, read as N·m per km/h"
    found = [Candidate("published PI", how, PIController(table4_gains(plants[0].point.adhesion)), Origin.CITED)]
    refused: dict[str, str] = {}
    if given is not None:
        found.append(Candidate("given PI", "as given", PIController(given), Origin.GIVEN))
    if check.holding is None:
        refused["holding PI"] = check.holding_reason
    else:
        how = f"least worst Ms over these points at an integral time of {check.holding.integral_time:g} s"
        found.append(Candidate("holding PI", how, check.holding.controller))
    names = design_names(vehicle)
    made: dict[str, Made] = {
        names.least_ms: lambda: least_ms(plants, vehicle),
        names.full_range: lambda: full_range(vehicle, [plant.point for plant in plants]),
        "layered law, in its layer": lambda: _layered(vehicle),
    }
    if not needs_feedback(plants):  # in place of a least Ms, which no feedback has
        made = {names.largest_ki: lambda: _largest_ki(plants, vehicle), **made}
    for name, make in made.items():
        try:
            found.append(make())
        except (InfeasibleDesignError, InputError) as error:
            refused[name] = _finding(error)
    return tuple(found), refused


def _finding(error: Exception) -> str:
    """What a search found, without the advice to whoever asked for the design, and how it was told."""
    found = str(error).partition("; relax the specification")[0].partition(": no kp stabilises with small ki")[0]
    return found.replace("no PI behind the compensator stabilises the plant(s): ", "no gains hold ")


def least_ms(plants: Sequence[LinearPlant], vehicle: Vehicle) -> Candidate:
    """The PI behind a lead of least worst Ms over the plants.

    InfeasibleDesignError if none holds them, or if they need no feedback: then it would have next to no gain.
    """
    if not needs_feedback(plants):
        raise InfeasibleDesignError(NO_FEEDBACK_NEEDED)
    tuned = least_ms_gains(plants, vehicle, vehicle.actuator.dead_time)
    how = f"least worst Ms over these points, ki ≥ {KI_MIN:g} N·m/m{_behind(vehicle)}"
    return Candidate(design_names(vehicle).least_ms, how, _controller(tuned, vehicle))


def least_ms_gains(plants: Sequence[LinearPlant], vehicle: Vehicle, dead_time: float) -> PIDesign:
    """Of `least_ms`, for a brake of another `dead_time`, s, but the same lag."""
    return _tuned(plants, vehicle, dead_time, minimise_ms=True, ki_min=KI_MIN)


def _largest_ki(plants: Sequence[LinearPlant], vehicle: Vehicle) -> Candidate:
    """The PI behind a lead of largest ki with Ms <= `ROBUST_MS` over the plants ([Astrom1998])."""
    tuned = _tuned(plants, vehicle, vehicle.actuator.dead_time, ms_max=ROBUST_MS)
    how = f"largest ki with Ms ≤ {ROBUST_MS:g} over these points{_behind(vehicle)}"
    return Candidate(design_names(vehicle).largest_ki, how, _controller(tuned, vehicle))


def _tuned(
    plants: Sequence[LinearPlant],
    vehicle: Vehicle,
    dead_time: float,
    *,
    ms_max: float | None = None,
    minimise_ms: bool = False,
    ki_min: float | None = None,
) -> PIDesign:
    lead, lead_filter = lag_lead(vehicle.actuator)
    return tune_pi(
        [actuated_plant(plant, vehicle.actuator) for plant in plants],
        dead_time,
        ms_max=ms_max,
        minimise_ms=minimise_ms,
        ki_min=ki_min,
        compensator=PIController(PIGains(kp=1.0, ki=0.0), lead, lead_filter).transfer_function if lead > 0 else None,
        names=[plant.point.words for plant in plants],
    )


def _controller(tuned: PIDesign, vehicle: Vehicle) -> PIController:
    return PIController(PIGains(kp=tuned.kp, ki=tuned.ki), *lag_lead(vehicle.actuator))


def _behind(vehicle: Vehicle) -> str:
    return ", behind a lead on the brake's lag" if vehicle.actuator.lag > 0 else ""


def full_range(vehicle: Vehicle, points: Sequence[OperatingPoint]) -> Candidate:
    """The design tuned over speeds, rails and loads on the laws of `held_laws`; InfeasibleDesignError if none holds."""
    plants = own_design_points(points)
    tuned = bool(plants) or is_tuned_when_asked("pi-lead", vehicle)
    rails = " and ".join(dict.fromkeys(str(point.rail) for point in points)) if plants else "dry and wet"
    law = f"the law {points[0].adhesion} of this report" if plants else "two adhesion laws"
    low, high = min(SPEEDS_KMH), max(SPEEDS_KMH)
    how = f"largest ki with Ms ≤ {MS_MAX:g} from {low:g} to {high:g} km/h, {rails}, empty and loaded, {law}"
    return Candidate(
        design_names(vehicle).full_range,
        how if tuned else f"{how}; rounded, and kept with the package",
        recommended_pi_lead(vehicle, gains=full_range_gains(vehicle, plants)).design,
        Origin.COMPUTED if tuned else Origin.KEPT,
        over_range=True,
    )


def _layered(vehicle: Vehicle) -> Candidate:
    design = layered_design(vehicle, K=1.0)  # its authority K only widens the layer: within it C does not depend on K
    return Candidate(
        "layered law, in its layer",
        "the sliding-mode law with a boundary layer is this PI about a known holding torque while it stays in the "
        f"layer; least worst Ms, ki ≥ {LEAST_INTEGRAL_GAIN * vehicle.inertia_scale:g} N·m/m, dry and wet at the "
        "bristle model's reference slips",
        PIController(PIGains(kp=design.kp, ki=design.ki), design.lead, design.lead_filter),
        needs_hold=True,
    )
