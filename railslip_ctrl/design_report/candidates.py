"""Designs that a report compares: published, given, holding, behind a lead, and the layered law within its layer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from railslip_ctrl.design import PIController, actuated_plant
from railslip_ctrl.design.tuning import tune_pi
from railslip_ctrl.design_check import DesignCheck
from railslip_ctrl.errors import InfeasibleDesignError, InputError
from railslip_ctrl.linearization import LinearPlant
from railslip_ctrl.parameters import PIGains, Vehicle, table4_gains
from railslip_ctrl.simulation.designed import is_tuned_when_asked, lag_lead, recommended_pi_lead
from railslip_ctrl.sliding_verification.layered import LEAST_INTEGRAL_GAIN, layered_design

from .records import Origin

KI_MIN = 5.0
"""Least ki of the tuned designs, N*m/m: without a least one the integral action vanishes."""

LEAST_MS, FULL_RANGE = "PI-lead, least Ms", "PI-lead, full range"


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
    made: dict[str, Made] = {
        LEAST_MS: lambda: least_ms(plants, vehicle),
        FULL_RANGE: lambda: _full_range(vehicle),
        "layered law, in its layer": lambda: _layered(vehicle),
    }
    for name, make in made.items():
        try:
            found.append(make())
        except (InfeasibleDesignError, InputError) as error:
            refused[name] = str(error)
    return tuple(found), refused


def least_ms(plants: Sequence[LinearPlant], vehicle: Vehicle) -> Candidate:
    """The PI behind a lead of least worst Ms over the plants; InfeasibleDesignError if none holds them."""
    lead, lead_filter = lag_lead(vehicle.actuator)
    compensator = PIController(PIGains(kp=1.0, ki=0.0), lead, lead_filter).transfer_function
    loops = [actuated_plant(plant, vehicle.actuator) for plant in plants]
    tuned = tune_pi(loops, vehicle.actuator.dead_time, minimise_ms=True, ki_min=KI_MIN, compensator=compensator)
    how = f"least worst Ms over these points, ki ≥ {KI_MIN:g} N·m/m, behind a lead on the brake's lag"
    return Candidate(LEAST_MS, how, PIController(PIGains(kp=tuned.kp, ki=tuned.ki), lead, lead_filter))


def _full_range(vehicle: Vehicle) -> Candidate:
    tuned = is_tuned_when_asked("pi-lead", vehicle)
    how = "largest ki with Ms ≤ 2 from 20 to 100 km/h, dry and wet, empty and loaded, two adhesion laws"
    return Candidate(
        FULL_RANGE,
        how if tuned else f"{how}; rounded, and kept with the package",
        recommended_pi_lead(vehicle).design,
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
