"""Why no design of a report is robust, and what the brake would have to be."""

from __future__ import annotations

from collections.abc import Sequence

from railslip_ctrl.assessment import limits_of
from railslip_ctrl.design import wheel_slip_loop
from railslip_ctrl.design.specification import ROBUST_MS, is_robust
from railslip_ctrl.errors import InfeasibleDesignError
from railslip_ctrl.linearization import LinearPlant
from railslip_ctrl.parameters import Vehicle

from .candidates import design_names, least_ms, least_ms_gains
from .records import Attempt, Shortfall

_TOLERANCE = 0.01  # of the dead time that is found by bisection; two digits of it are shown


def shortfall(plants: Sequence[LinearPlant], vehicle: Vehicle, *, held_together: bool) -> Shortfall:
    """What keeps the plants of a vehicle from a robust design.

    Parameters
    ----------
    plants : sequence of LinearPlant
        The report's, at least one of them unstable.
    vehicle : Vehicle
    held_together : bool
        Whether a design holds all of them. If none does, the PI behind a lead of least Ms is tuned for each alone.
    """
    limits = [limits_of(plant, vehicle.actuator) for plant in plants]
    worst = max(range(len(plants)), key=lambda i: limits[i].ms_bound)
    any_controller = min(one.longest_dead_time(ROBUST_MS) for one in limits)
    alone = () if held_together else tuple(_alone(plant, vehicle) for plant in plants)
    return Shortfall(
        point=plants[worst].point,
        limits=limits[worst],
        longest_dead_time=any_controller,
        lead_dead_time=_lead_dead_time(plants, vehicle, min(any_controller, vehicle.actuator.dead_time)),
        alone=alone,
    )


def _lead_dead_time(plants: Sequence[LinearPlant], vehicle: Vehicle, longest: float) -> float:
    """Largest dead time, s, up to `longest`, with which `candidates.least_ms` is robust; 0 if with none.

    Least Ms rises with the dead time: what is held at a longer one is held at a shorter one behind that much more.
    """

    def robust(dead_time: float) -> bool:
        try:
            return is_robust(least_ms_gains(plants, vehicle, dead_time).worst.ms)
        except InfeasibleDesignError:
            return False

    low, high = 0.0, longest
    while high - low > _TOLERANCE * longest:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if robust(middle) else (low, middle)
    return low


def _alone(plant: LinearPlant, vehicle: Vehicle) -> Attempt:
    """The design of least Ms for one plant alone."""
    name = design_names(vehicle).least_ms
    try:
        controller = least_ms([plant], vehicle).controller
    except InfeasibleDesignError as error:
        return Attempt(name, plant.point, None, str(error))
    margins = wheel_slip_loop(plant, controller, vehicle.actuator).margins()
    return Attempt(name, plant.point, margins, "", controller)
