"""The layered law over whole stops: the falling speed, and a holding torque that is not known exactly.

The law carries the holding torque of its own parameters as a function of the speed; a stop starts at the reference slip
with that torque acting, be it right or wrong, and ends at 5 km/h.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from railslip_ctrl.errors import DomainError
from railslip_ctrl.linearization import OperatingPoint, operating_point
from railslip_ctrl.parameters import Rail, Vehicle
from railslip_ctrl.sliding.robust import LOWEST_FRICTION
from railslip_ctrl.sliding.verdict import Condition
from railslip_ctrl.switching import LayeredDesign
from railslip_ctrl.switching.simulate import simulate
from railslip_ctrl.switching.simulated_cycle import END_SPEED, slip_range
from railslip_ctrl.switching.stepped import LayeredLaw
from railslip_ctrl.units import KMH

from .layered import HOLD_ERROR, rail_plants

_STEP = 5e-3  # s: a twelfth of the lead's filter
_LONGEST = 60.0  # s, times the inertia scale: longer than any stop
_TABLE = 24  # speeds of the hold's table, between which it is linear: it bends by a tenth over the stop
_FARTHEST = 0.5  # share of the hold by which errors are tried, either way
_RESOLUTION = 0.005  # of the tolerated error, found by bisection


@dataclass(frozen=True)
class Stop:
    """One stop: range of the slip ratio, time (s) and speed (m/s) at its end, and where the wheel was lost, or None.

    `held`: down to `END_SPEED` the slip stayed between 0 and twice the reference.
    """

    slip_range: tuple[float, float]
    time: float
    lost: str | None
    held: bool

    @property
    def text(self) -> str:
        """In words."""
        if self.lost is not None:
            return self.lost.removeprefix("simulation: ")
        low, high = self.slip_range
        return f"slip {low:.3f} to {high:.3f}{', released' if low <= 0 else ''}, {self.time:.1f} s"


@lru_cache(maxsize=64)
def hold_table(point: OperatingPoint) -> Callable[[float], float]:
    """The torque that keeps the point's slip ratio, N*m, as a function of the speed, m/s, up to the point's."""
    speeds = np.linspace(END_SPEED, point.speed, _TABLE)
    torques = [
        operating_point(point.law, point.vehicle, float(v), point.slip, rail=point.rail).brake_torque for v in speeds
    ]
    return lambda v: float(np.interp(v, speeds, torques))


def stop(
    design: LayeredDesign, point: OperatingPoint, *, known: OperatingPoint | None = None, share: float = 1.0
) -> Stop:
    """Brake the wheel of `point` from its speed, undisturbed.

    The law knows the vehicle and rail of `known` (left out: of `point`) and applies `share` of the torque that holds
    its slip; the wheel starts at its slip under the torque of `point` and gets the law's after dead time and lag.
    """
    believed = known or point
    hold = hold_table(believed)
    law = LayeredLaw(believed.slip, lambda v: share * hold(v), design=design)
    actuator = point.vehicle.actuator
    longest = _LONGEST * point.vehicle.inertia_scale
    try:
        run = simulate(point, law, actuator, duration=longest, step=_STEP, frozen=False, end_speed=END_SPEED)
    except DomainError as error:
        return Stop((0.0, 1.0), float("nan"), str(error), False)
    low, high = slip_range(run)
    return Stop((low, high), float(run.time[-1]), None, low > 0.0 and high < 2.0 * believed.slip)


def held_while_the_speed_falls(design: LayeredDesign, vehicle: Vehicle) -> Condition:
    """Whole stops, which the bound, at frozen speed, leaves out."""
    lines, held = [], True
    for loaded in (False, True):
        for rail, plant in rail_plants(vehicle.loaded() if loaded else vehicle).items():
            found = stop(design, plant.point)
            held &= found.held
            lines.append(f"{rail}, {'loaded' if loaded else 'empty'}: {found.text}")
    return Condition(
        "speed falling, simulated",
        f"From 100 km/h down to {END_SPEED / KMH:g} km/h, where the stop ends, the slip stays between 0 and twice the "
        "reference.",
        held,
        "simulated",
        f"{'; '.join(lines)}. From the reference slip at rest, undisturbed, mass and rail known, the holding torque "
        "following the speed.",
    )


def tolerated(design: LayeredDesign, point: OperatingPoint) -> tuple[float, float]:
    """Errors of the holding torque, shares below and above, up to which a stop is held; bisected to 0.5 %."""
    below, above = (_edge(design, point, sign) for sign in (-1.0, 1.0))
    return below, above


def _edge(design: LayeredDesign, point: OperatingPoint, sign: float) -> float:
    low, high = 0.0, _FARTHEST
    while high - low > _RESOLUTION:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stop(design, point, share=1.0 + sign * middle).held else (low, middle)
    return low


def hold_known(design: LayeredDesign, tolerances: dict[Rail, tuple[float, float]], vehicle: Vehicle) -> Condition:
    """How well the holding torque must be known, and what happens beyond."""
    lines = []
    for rail, plant in rail_plants(vehicle).items():
        below, above = tolerances[rail]
        beyond = [
            f"at {100 * sign * (edge + 0.05):+.0f} % {stop(design, plant.point, share=1 + sign * (edge + 0.05)).text}"
            for sign, edge in ((-1.0, below), (1.0, above))
        ]
        lines.append(f"{rail}: held from {-100 * below:.1f} to {100 * above:+.1f} %; {', '.join(beyond)}")
    return Condition(
        "holding torque known",
        f"With the holding torque known to +-{100 * HOLD_ERROR:g} % the slip stays between 0 and twice the reference "
        f"down to {END_SPEED / KMH:g} km/h: the integral in the layer takes the error out.",
        all(min(edges) >= HOLD_ERROR for edges in tolerances.values()),
        "simulated",
        f"{'; '.join(lines)}. The wrong torque from the first moment on, speed falling from 100 km/h, empty; edges to "
        f"{100 * _RESOLUTION:g} %. K = {design.K:.0f} N m is what makes up for it.",
    )


def rail_mistaken(design: LayeredDesign, vehicle: Vehicle) -> dict[Rail, Stop]:
    """Stops on each rail, from its reference slip, with the law that takes it for the other."""
    points = {rail: plant.point for rail, plant in rail_plants(vehicle).items()}
    return {
        on: stop(design, points[on], known=points[taken]) for on, taken in ((Rail.WET, Rail.DRY), (Rail.DRY, Rail.WET))
    }


def published_uncertainties(
    tolerances: dict[Rail, tuple[float, float]], mistaken: dict[Rail, Stop], vehicle: Vehicle
) -> Condition:
    """Whether mass, friction and rail of the published run leave the holding torque known that well."""
    points = {rail: plant.point for rail, plant in rail_plants(vehicle).items()}
    worn = vehicle.model_copy(update={"wheel": vehicle.wheel.model_copy(update={"viscous_friction": LOWEST_FRICTION})})
    lines, within = [], True
    for name, other in (("loaded taken for empty", vehicle.loaded()), ("friction of the longest stop", worn)):
        for rail, plant in rail_plants(other).items():
            error = points[rail].brake_torque / plant.point.brake_torque - 1.0
            below, above = tolerances[rail]
            within &= -below <= error <= above
            lines.append(f"{name}, {rail}: {100 * error:+.1f} %")
    for on, found in mistaken.items():
        taken = Rail.DRY if on is Rail.WET else Rail.WET
        within &= found.held
        error = points[taken].brake_torque / points[on].brake_torque - 1.0
        lines.append(f"{on} rail taken for {taken}: {100 * error:+.0f} %, {found.text}")
    return Condition(
        "published uncertainties",
        "Mass, friction and rail as they change in the published run leave the holding torque known well enough.",
        within,
        "simulated",
        f"{'; '.join(lines)}. Errors of the torque against the tolerated ones of the condition before; the rail's by "
        "whole stops from the reference slip of the rail there is.",
    )
