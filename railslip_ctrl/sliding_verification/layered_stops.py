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
from railslip_ctrl.parameters import PARK2008, Rail, Vehicle
from railslip_ctrl.simulation.designed import is_published
from railslip_ctrl.sliding.robust import LOWEST_FRICTION
from railslip_ctrl.sliding.verdict import Condition
from railslip_ctrl.switching import LayeredDesign
from railslip_ctrl.switching.simulate import simulate
from railslip_ctrl.switching.simulated_cycle import END_SPEED, slip_range
from railslip_ctrl.switching.stepped import LayeredLaw
from railslip_ctrl.units import KMH

from .layered import HOLD_ERROR
from .rail_adhesion import PUBLISHED_ADHESION, RailAdhesion, load_cases

_STEP = 5e-3  # s: a twelfth of the lead's filter
_LONGEST = 60.0  # s, times the inertia scale: longer than any stop of the published vehicle
_LONGEST_SHARE = 2.0  # of the time that the adhesion at the reference takes to stop the train, where that is longer
_TABLE = 24  # speeds of the hold's table, between which it is linear: it bends by a tenth over the stop
_FARTHEST = 0.5  # share of the hold by which errors are tried, either way
_RESOLUTION = 0.005  # of the tolerated error, found by bisection
_FRICTION_FALL = PARK2008.wheel.viscous_friction - LOWEST_FRICTION  # N m s, over the longest published stop

FALLING_HELD = (
    f"From 100 km/h down to {END_SPEED / KMH:g} km/h, where the stop ends, the slip stays between 0 and twice the "
    "reference."
)
HOLD_NAME = "holding torque known"
HOLD_KNOWN = (
    f"With the holding torque known to +-{100 * HOLD_ERROR:g} % the slip stays between 0 and twice the reference down "
    f"to {END_SPEED / KMH:g} km/h: the integral in the layer takes the error out."
)


@dataclass(frozen=True)
class Stop:
    """One stop: range of the slip ratio, time (s) at its end, and where the wheel was lost, or None.

    `ended`: `END_SPEED` was reached. `held`: it was, and the slip stayed between 0 and twice the reference.
    """

    slip_range: tuple[float, float]
    time: float
    lost: str | None
    held: bool
    ended: bool = True

    @property
    def text(self) -> str:
        """In words."""
        if self.lost is not None:
            return self.lost.removeprefix("simulation: ")
        low, high = self.slip_range
        late = "" if self.ended else f" and not at {END_SPEED / KMH:g} km/h yet"
        return f"slip {low:.3f} to {high:.3f}{', released' if low <= 0 else ''}, {self.time:.1f} s{late}"


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
    longest = _longest(point)
    try:
        run = simulate(point, law, actuator, duration=longest, step=_STEP, frozen=False, end_speed=END_SPEED)
    except DomainError as error:
        return Stop((0.0, 1.0), float("nan"), str(error), False, ended=False)
    low, high = slip_range(run)
    end = float(run.time[-1])
    ended = end < longest - 2.0 * _STEP
    return Stop((low, high), end, None, ended and low > 0.0 and high < 2.0 * believed.slip, ended)


def _longest(point: OperatingPoint) -> float:
    """Seconds after which a stop is given up."""
    vehicle = point.vehicle
    ideal = vehicle.effective_mass * point.speed / point.adhesion_force if point.adhesion_force > 0.0 else 0.0
    return max(_LONGEST * vehicle.inertia_scale, _LONGEST_SHARE * ideal)


def held_while_the_speed_falls(
    design: LayeredDesign, vehicle: Vehicle, adhesion: RailAdhesion = PUBLISHED_ADHESION
) -> Condition:
    """Whole stops, which the bound, at frozen speed, leaves out."""
    lines, held = [], True
    for load, laden in load_cases(vehicle).items():
        for rail, plant in adhesion.plants(laden).items():
            found = stop(design, plant.point)
            held &= found.held
            lines.append(f"{rail}, {load}: {found.text}")
    return Condition(
        "speed falling, simulated",
        FALLING_HELD,
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


def hold_known(
    design: LayeredDesign,
    tolerances: dict[Rail, tuple[float, float]],
    vehicle: Vehicle,
    adhesion: RailAdhesion = PUBLISHED_ADHESION,
) -> Condition:
    """How well the holding torque must be known, and what happens beyond."""
    lines = []
    for rail, plant in adhesion.plants(vehicle).items():
        below, above = tolerances[rail]
        beyond = [
            f"at {100 * sign * (edge + 0.05):+.0f} % {stop(design, plant.point, share=1 + sign * (edge + 0.05)).text}"
            for sign, edge in ((-1.0, below), (1.0, above))
        ]
        edges = f"{_edge_text(below, -1.0)} to {_edge_text(above, 1.0)} %"
        lines.append(f"{rail}: held from {edges}; {', '.join(beyond)}")
    return Condition(
        HOLD_NAME,
        HOLD_KNOWN,
        all(min(edges) >= HOLD_ERROR for edges in tolerances.values()),
        "simulated",
        f"{'; '.join(lines)}. The wrong torque from the first moment on, speed falling from 100 km/h, "
        f"{next(iter(load_cases(vehicle)))}; edges to {100 * _RESOLUTION:g} %. K = {design.K:.0f} N m is what makes "
        "up for it.",
    )


def _edge_text(edge: float, sign: float) -> str:
    """A tolerated share in percent; the search ends at `_FARTHEST`."""
    reached = " (the farthest tried)" if edge >= _FARTHEST - _RESOLUTION else ""
    return f"{100 * sign * edge:+.1f}{reached}"


# --- what is not known ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TorqueError:
    """A change of the vehicle that the law does not know: the error of its holding torque, a share."""

    name: str
    rail: Rail
    error: float
    tolerated: bool


@dataclass(frozen=True)
class Uncertainties:
    """Mass and friction not known, as errors of the torque; and the rail, as whole stops by the rail there is."""

    errors: tuple[TorqueError, ...]
    mistaken: dict[Rail, Stop]

    @property
    def beyond(self) -> tuple[TorqueError, ...]:
        """The errors that are not tolerated."""
        return tuple(one for one in self.errors if not one.tolerated)

    @property
    def rail_matters(self) -> bool:
        """Whether a stop with the rail mistaken is not held."""
        return not all(found.held for found in self.mistaken.values())


def uncertainties(
    design: LayeredDesign,
    tolerances: dict[Rail, tuple[float, float]],
    vehicle: Vehicle,
    adhesion: RailAdhesion = PUBLISHED_ADHESION,
) -> Uncertainties:
    """What the vehicle's loaded mass, the published fall of the pad's friction and the other rail do to the law.

    Without a second rail that differs from the first, `mistaken` is empty.
    """
    points = {rail: plant.point for rail, plant in adhesion.plants(vehicle).items()}
    friction = vehicle.wheel.viscous_friction - _FRICTION_FALL
    worn = vehicle.model_copy(update={"wheel": vehicle.wheel.model_copy(update={"viscous_friction": friction})})
    worn_name = "friction of the longest stop" if is_published(vehicle) else f"friction {_FRICTION_FALL:g} N m s lower"
    others = {worn_name: worn}
    if len(load_cases(vehicle)) > 1:
        others = {"loaded taken for empty": vehicle.loaded(), **others}
    errors = []
    for name, other in others.items():
        for rail, plant in adhesion.plants(other).items():
            error = points[rail].brake_torque / plant.point.brake_torque - 1.0
            below, above = tolerances[rail]
            errors.append(TorqueError(name, rail, error, -below <= error <= above))
    mistaken = {}
    if adhesion.tells_rails_apart(vehicle):
        pairs = ((Rail.WET, Rail.DRY), (Rail.DRY, Rail.WET))
        mistaken = {on: stop(design, points[on], known=points[taken]) for on, taken in pairs}
    return Uncertainties(tuple(errors), mistaken)


def published_uncertainties(
    found: Uncertainties, vehicle: Vehicle, adhesion: RailAdhesion = PUBLISHED_ADHESION
) -> Condition:
    """Whether mass, friction and rail, as they change in the published run, leave the holding torque known that well.

    Of another vehicle: its own masses, and a friction that falls as much.
    """
    points = {rail: plant.point for rail, plant in adhesion.plants(vehicle).items()}
    lines = [f"{one.name}, {one.rail}: {100 * one.error:+.1f} %" for one in found.errors]
    for on, one in found.mistaken.items():
        taken = Rail.DRY if on is Rail.WET else Rail.WET
        error = points[taken].brake_torque / points[on].brake_torque - 1.0
        lines.append(f"{on} rail taken for {taken}: {100 * error:+.0f} %, {one.text}")
    masses = ["mass"] if len(load_cases(vehicle)) > 1 else []
    listed = _listed([*masses, "friction", *(["rail"] if found.mistaken else [])])
    published = is_published(vehicle) and bool(found.mistaken)
    how = " as they change in the published run" if published else ", as far as they may change,"
    if found.mistaken:
        rails = "the rail's by whole stops from the reference slip of the rail there is"
    else:
        known = f"{adhesion.rails_text} alone" if len(adhesion.rails) < len(Rail) else "two that do not differ"
        rails = f"a mistaken rail is not among them, as the rails verified are {known}"
    return Condition(
        uncertain_name(vehicle),
        f"{listed[0].upper()}{listed[1:]}{how} leave the holding torque known well enough.",
        not found.beyond and not found.rail_matters,
        "simulated",
        f"{'; '.join(lines)}. Errors of the torque against the tolerated ones of the condition before; {rails}.",
    )


def uncertain_name(vehicle: Vehicle) -> str:
    """The name of that condition; those of the published run are the published vehicle's."""
    return "published uncertainties" if is_published(vehicle) else "uncertainties"


def _listed(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
