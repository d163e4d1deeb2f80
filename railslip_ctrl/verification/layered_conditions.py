"""The conditions of the layered law behind the actuator: the loop in the layer, its bounds, and whole stops.

In a stop the law carries the holding torque of its own parameters as a function of the speed; the stop starts at the
reference slip with that torque acting, be it right or wrong, and ends at 5 km/h. The slip that a random force makes
grows as the speed falls, so that the law is cut out before the stop ends: the wheel is then braked open loop, below
what it would slip at.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from railslip_ctrl.core.errors import DomainError, InfeasibleDesignError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH
from railslip_ctrl.design.catalogue import is_published
from railslip_ctrl.model.linearization import OperatingPoint, linearize, operating_point
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH, PARK2008, Rail, Vehicle
from railslip_ctrl.verification import layered

from .fixed_step import END_SPEED, FineRun, HeldRun, SteppedLaw, held_run, simulate_fine, slip_range
from .reaching import with_friction
from .robust import LOWEST_FRICTION
from .verdict import Condition, Verification

_STABLE, _BOUND = "layer stable behind the actuator", "bound with the actuator"
_DISTURBED, _CUT_OUT = "published disturbances, simulated", "cut-out, simulated"
HOLD_NAME = "holding torque known"


@dataclass(frozen=True)
class LayeredFindings:
    """What is concluded from beside the verdicts; see `report.verification`.

    design: None where no gains stabilise the rails, and then nothing that follows is; bounds: by rail, empty where
    there is none; cut_out: speed, km/h, None without.
    """

    vehicle: Vehicle
    adhesion: layered.RailAdhesion
    design: layered.LayeredDesign | None = None
    bounds: Mapping[Rail, layered.RailBounds] | None = None
    cut_out: float | None = None
    unknown: Uncertainties | None = None

    @property
    def asked(self) -> float:
        """Least authority, N*m; NaN without a design."""
        return math.nan if self.design is None else layered.least_authority(self.design, self.vehicle, self.adhesion)

    @property
    def loads(self) -> tuple[str, ...]:
        """The loads it was decided for."""
        return tuple(layered.load_cases(self.vehicle))


def verify_layered(
    vehicle: Vehicle, adhesion: layered.RailAdhesion, *, K: float | None, seed: int, ki_min: float | None
) -> tuple[Verification, LayeredFindings]:
    """The conditions, and what is concluded from.

    Where no gains stabilise the rails the first condition does not hold, and the others, which are about a law that
    there is none of, are not decided; K is then 0 unless given.
    """
    found = LayeredFindings(vehicle, adhesion)
    about = {"adhesion": adhesion, "loads": found.loads, "disturbance": layered.bounded_disturbance(vehicle)}
    of_bound = ("authority", "bounds kept, simulated")
    try:
        design = layered.layered_design(vehicle, adhesion, K=K, ki_min=ki_min)
    except InfeasibleDesignError as error:
        stops = (_DISTURBED, _CUT_OUT, "speed falling, simulated", HOLD_NAME, uncertain_name(vehicle))
        conditions = [
            Condition(_STABLE, False, "sampled", {**about, "reason": str(error)}),
            *(Condition(name, None, None, {**about, "missing": "law"}) for name in (_BOUND, *of_bound, *stops)),
        ]
        return Verification("layered", vehicle.inertia_scale, K or 0.0, None, seed, tuple(conditions)), found
    conditions = [layered_stability(design, vehicle, adhesion)]
    bounds: dict[Rail, layered.RailBounds] = {}
    try:
        bounds = layered.rail_bounds(design, vehicle, adhesion)
    except InfeasibleDesignError as error:
        conditions += [
            Condition(_BOUND, False, "sampled", {**about, "reason": str(error)}),
            *(Condition(name, None, None, {**about, "missing": "bound"}) for name in of_bound),
        ]
    else:
        held, kept = layered.lowest_speeds(design, vehicle, adhesion)
        numbers = {**about, "design": design, "bounds": bounds}
        conditions += [
            Condition(_BOUND, held is not None, "sampled", numbers, down_to_kmh=held),
            Condition("authority", kept is not None, "sampled", numbers, down_to_kmh=kept),
            bounds_kept(design, bounds),
        ]
    tolerances = {rail: tolerated(design, adhesion.point(rail, vehicle)) for rail in adhesion.rails}
    unknown = uncertainties(design, tolerances, vehicle, adhesion)
    disturbed, cut_out = held_under_published_disturbances(design, vehicle, seed, adhesion)
    conditions += [
        disturbed,
        cut_out_condition(cut_out, vehicle, seed, adhesion),
        held_while_the_speed_falls(design, vehicle, adhesion),
        hold_known(design, tolerances, vehicle),
        published_uncertainties(unknown, vehicle, adhesion),
    ]
    found = replace(found, design=design, bounds=bounds, cut_out=cut_out, unknown=unknown)
    return Verification("layered", vehicle.inertia_scale, design.K, None, seed, tuple(conditions)), found


def layered_stability(design: layered.LayeredDesign, vehicle: Vehicle, adhesion: layered.RailAdhesion) -> Condition:
    """The loop within the layer over the stop, by the exact root count."""
    margins, unstable = {}, {}
    for speed_kmh in layered.SPEEDS_KMH:
        for name, point in _points(adhesion, vehicle, speed_kmh=speed_kmh).items():
            loop = layered.layer_loop(design, linearize(point), vehicle.actuator)
            name = name.replace(", ", f", {speed_kmh:g} km/h, ")
            if loop.is_stable():
                margins[name] = loop.margins().ms
            else:
                unstable[name] = speed_kmh
    about = {"design": design, "adhesion": adhesion, "loads": tuple(layered.load_cases(vehicle))}
    worst = max(margins, key=lambda name: margins[name], default=None)
    down_to = min((one for one in layered.SPEEDS_KMH if one > max(unstable.values(), default=0.0)), default=None)
    numbers = {**about, "margins": margins, "unstable": unstable, "worst": worst}
    return Condition(_STABLE, not unstable, "sampled", numbers, down_to_kmh=down_to)


def _points(
    adhesion: layered.RailAdhesion, vehicle: Vehicle, *, speed_kmh: float = INITIAL_SPEED_KMH
) -> dict[str, OperatingPoint]:
    """The reference slip on every rail, empty and loaded, by "rail, load"."""
    return {
        f"{rail}, {load}": adhesion.point(rail, laden, speed_kmh=speed_kmh)
        for load, laden in layered.load_cases(vehicle).items()
        for rail in adhesion.rails
    }


def bounds_kept(design: layered.LayeredDesign, bounds: Mapping[Rail, layered.RailBounds]) -> Condition:
    """The nonlinear wheel against the bounds."""
    found: dict[Rail, dict[str, Any]] = {}
    kept = True
    for rail, one in bounds.items():
        try:
            errors = layered.bounded_errors(design, one)
            start = [
                layered.run_errors(design, one.plant, lambda _: 0.0, offset=sign * layered.OFFSET)
                for sign in (1.0, -1.0)
            ]
        except DomainError as error:
            found[rail], kept = {"lost": str(error)}, False
            continue
        worst = max(errors, key=lambda key: errors[key][0])
        largest, command = errors[worst][0], max(command for _, command in errors.values())
        kept &= largest <= one.at_rest.error and command <= one.at_rest.command
        kept &= all(e <= one.from_offset.largest_error and c <= one.from_offset.command for e, c in start)
        measured = {"worst": worst, "error": largest, "command": command, "offset_command": max(c for _, c in start)}
        found[rail] = {"bounds": one, "lost": None, **measured}
    numbers = {"found": found, "duration": layered.DURATION}
    down_to = INITIAL_SPEED_KMH if kept else None
    return Condition("bounds kept, simulated", kept, "simulated", numbers, down_to_kmh=down_to)


# --- whole stops ------------------------------------------------------------------------------------------------------


_LONGEST = 60.0  # s, times the inertia scale: longer than any stop of the published vehicle
_LONGEST_SHARE = 2.0  # of the time that the adhesion at the reference takes to stop the train, where that is longer
_TABLE = 24  # speeds of the hold's table, between which it is linear: it bends by a tenth over the stop
_FARTHEST = 0.5  # share of the hold by which errors are tried, either way
_RESOLUTION = 0.005  # of the tolerated error, found by bisection
RUNS = 4  #: disturbed stops of each rail and load
LARGEST_CUT_OUT_KMH = 30.0  #: above it a law is no slide protection: a tenth of the stop's energy would be left
CUT_OUT_SHARE = 0.8  #: of the holding torque, below the cut-out speed

# over the highest speed at which a run left the range (40 seeds reach 1.3 times what 4 do); rounded up to
_CUT_OUT_MARGIN, _CUT_OUT_STEP_KMH = 1.4, 5.0
_LOWEST_KMH = END_SPEED / KMH
_FRICTION_FALL = PARK2008.wheel.viscous_friction - LOWEST_FRICTION  # N m s, over the longest published stop


@lru_cache(maxsize=64)
def hold_table(point: OperatingPoint) -> Callable[[float], float]:
    """The torque that keeps the point's slip ratio, N*m, as a function of the speed, m/s, up to the point's."""
    speeds = np.linspace(END_SPEED, point.speed, _TABLE)
    torques = [
        operating_point(point.law, point.vehicle, float(v), point.slip, rail=point.rail).brake_torque for v in speeds
    ]
    return lambda v: float(np.interp(v, speeds, torques))


def stop(
    design: layered.LayeredDesign, point: OperatingPoint, *, known: OperatingPoint | None = None, share: float = 1.0
) -> HeldRun:
    """Brake the wheel of `point` from its speed, undisturbed.

    The law knows the vehicle and rail of `known` (left out: of `point`) and applies `share` of the torque that holds
    its slip; the wheel starts at its slip under the torque of `point` and gets the law's after dead time and lag.
    """
    believed = known or point
    hold = hold_table(believed)
    law = layered.LayeredLaw(believed.slip, lambda v: share * hold(v), design=design)
    return held_run(lambda: _run(point, law), believed.slip, before=_longest(point) - 2.0 * layered.STEP)


def _run(point: OperatingPoint, law: SteppedLaw, torque: layered.Torque | None = None) -> FineRun:
    """A stop of the wheel behind its actuator; DomainError where it is lost."""
    known: dict[str, Any] = {"frozen": False, "end_speed": END_SPEED, "disturbance": torque}
    return simulate_fine(point, law, point.vehicle.actuator, duration=_longest(point), step=layered.STEP, **known)


def _longest(point: OperatingPoint) -> float:
    """Seconds after which a stop is given up."""
    vehicle = point.vehicle
    ideal = vehicle.effective_mass * point.speed / point.adhesion_force if point.adhesion_force > 0.0 else 0.0
    return max(_LONGEST * vehicle.inertia_scale, _LONGEST_SHARE * ideal)


# --- disturbed -------------------------------------------------------------------------------------------------------


def range_left(design: layered.LayeredDesign, point: OperatingPoint, seed: int) -> float:
    """Speed, km/h, at which the slip of a stop with the published disturbances first leaves its range; 0 if never."""
    law, left = layered.LayeredLaw(point.slip, hold_table(point), design=design), 0.0

    def watched(v: float, sigma: float, v_rate: float, step: float) -> tuple[float, float]:
        nonlocal left
        if left == 0.0 and not 0.0 < sigma < 2.0 * point.slip * v:
            left = v
        return law(v, sigma, v_rate, step)

    with suppress(DomainError):  # the speed stands by then
        _run(point, watched, layered.published_torque(design, point, seed, _longest(point)))
    return left / KMH


def open_loop_slip(point: OperatingPoint, seed: int) -> float:
    """Largest slip ratio from the cut-out at the point's speed and reference slip on; 1 for a wheel that locks."""
    hold = hold_table(point)
    try:
        run = _run(
            point, lambda v, *_: (CUT_OUT_SHARE * hold(v), 0.0), layered.random_torque(point, seed, _longest(point))
        )
    except DomainError:
        return 1.0
    return max(0.0, slip_range(run)[1])


def held_under_published_disturbances(
    design: layered.LayeredDesign, vehicle: Vehicle, seed: int, adhesion: layered.RailAdhesion
) -> tuple[Condition, float | None]:
    """Whole stops with the published disturbances, which no L1 bound covers; and the cut-out, km/h, None without."""
    left = {
        name: max(range_left(design, point, one) for one in range(seed, seed + RUNS))
        for name, point in _points(adhesion, vehicle).items()
    }
    steps = math.ceil(_CUT_OUT_MARGIN * max(left.values()) / _CUT_OUT_STEP_KMH)
    lowest = max(_LOWEST_KMH, steps * _CUT_OUT_STEP_KMH)
    cut_out = lowest if lowest <= LARGEST_CUT_OUT_KMH else None
    numbers = {"left": left, "cut_out": cut_out, "margin": _CUT_OUT_MARGIN, "runs": RUNS, "seed": seed}
    down_to = lowest if lowest < INITIAL_SPEED_KMH else None
    return Condition(_DISTURBED, cut_out is not None, "simulated", numbers, down_to_kmh=down_to), cut_out


def cut_out_condition(cut_out: float | None, vehicle: Vehicle, seed: int, adhesion: layered.RailAdhesion) -> Condition:
    """The wheel from the cut-out, km/h, on."""
    if cut_out is None:
        return Condition(_CUT_OUT, None, None, {"missing": "cut_out"})
    slips = {
        name: max(open_loop_slip(point, one) for one in range(seed, seed + RUNS))
        for name, point in _points(adhesion, vehicle, speed_kmh=cut_out).items()
        if cut_out > _LOWEST_KMH
    }
    holds = max(slips.values(), default=0.0) < 1.0
    numbers = {"slips": slips, "cut_out": cut_out, "runs": RUNS, "seed": seed}
    return Condition(_CUT_OUT, holds, "simulated", numbers, down_to_kmh=_LOWEST_KMH if holds else None)


def held_while_the_speed_falls(
    design: layered.LayeredDesign, vehicle: Vehicle, adhesion: layered.RailAdhesion
) -> Condition:
    """Whole stops, which the bound, at frozen speed, leaves out."""
    stops = {name: stop(design, point) for name, point in _points(adhesion, vehicle).items()}
    held = all(one.held for one in stops.values())
    down_to = _LOWEST_KMH if held else None
    return Condition("speed falling, simulated", held, "simulated", {"stops": stops}, down_to_kmh=down_to)


def tolerated(design: layered.LayeredDesign, point: OperatingPoint) -> tuple[float, float]:
    """Errors of the holding torque, shares below and above, up to which a stop is held; bisected to 0.5 %."""
    edges = []
    for sign in (-1.0, 1.0):
        low, high = 0.0, _FARTHEST
        while high - low > _RESOLUTION:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if stop(design, point, share=1.0 + sign * middle).held else (low, middle)
        edges.append(low)
    return edges[0], edges[1]


def hold_known(
    design: layered.LayeredDesign, tolerances: Mapping[Rail, tuple[float, float]], vehicle: Vehicle
) -> Condition:
    """How well the holding torque must be known."""
    held = all(min(edges) >= layered.HOLD_ERROR for edges in tolerances.values())
    numbers = {
        **{"tolerances": tolerances, "farthest": _FARTHEST - _RESOLUTION, "resolution": _RESOLUTION},
        **{"loads": tuple(layered.load_cases(vehicle)), "K": design.K},
    }
    bears = {f"holding torque, {rail}": min(edges) for rail, edges in tolerances.items()}
    down_to = _LOWEST_KMH if held else None
    return Condition(HOLD_NAME, held, "simulated", numbers, down_to_kmh=down_to, tolerated=bears)


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
    """Mass and friction not known, as errors of the torque; and the rail, as whole stops by the rail there is.

    `mistaken_errors`: the errors of the torque in these stops, shares.
    """

    errors: tuple[TorqueError, ...]
    mistaken: Mapping[Rail, HeldRun]
    mistaken_errors: Mapping[Rail, float]

    @property
    def beyond(self) -> tuple[TorqueError, ...]:
        """The errors that are not tolerated."""
        return tuple(one for one in self.errors if not one.tolerated)

    @property
    def rail_matters(self) -> bool:
        """Whether a stop with the rail mistaken is not held."""
        return not all(found.held for found in self.mistaken.values())


def uncertainties(
    design: layered.LayeredDesign,
    tolerances: Mapping[Rail, tuple[float, float]],
    vehicle: Vehicle,
    adhesion: layered.RailAdhesion,
) -> Uncertainties:
    """What the vehicle's loaded mass, the published fall of the pad's friction and the other rail do to the law.

    Without a second rail that differs from the first, `mistaken` is empty.
    """
    points = {rail: adhesion.point(rail, vehicle) for rail in adhesion.rails}
    worn = "friction of the longest stop" if is_published(vehicle) else f"friction {_FRICTION_FALL:g} N m s lower"
    others = {"loaded taken for empty": vehicle.loaded()} if len(layered.load_cases(vehicle)) > 1 else {}
    others[worn] = with_friction(vehicle, vehicle.wheel.viscous_friction - _FRICTION_FALL)
    errors = []
    for name, other in others.items():
        for rail in adhesion.rails:
            error = points[rail].brake_torque / adhesion.point(rail, other).brake_torque - 1.0
            below, above = tolerances[rail]
            errors.append(TorqueError(name, rail, error, -below <= error <= above))
    pairs = {Rail.WET: Rail.DRY, Rail.DRY: Rail.WET} if adhesion.tells_rails_apart(vehicle) else {}
    return Uncertainties(
        errors=tuple(errors),
        mistaken={on: stop(design, points[on], known=points[taken]) for on, taken in pairs.items()},
        mistaken_errors={on: points[taken].brake_torque / points[on].brake_torque - 1.0 for on, taken in pairs.items()},
    )


def published_uncertainties(found: Uncertainties, vehicle: Vehicle, adhesion: layered.RailAdhesion) -> Condition:
    """Whether mass, friction and rail, as they change in the published run, leave the holding torque known that well.

    Of another vehicle: its own masses, and a friction that falls as much.
    """
    about = {"loads": tuple(layered.load_cases(vehicle)), "published": is_published(vehicle), "adhesion": adhesion}
    holds = not found.beyond and not found.rail_matters
    return Condition(uncertain_name(vehicle), holds, "simulated", {**vars(found), **about})


def uncertain_name(vehicle: Vehicle) -> str:
    """The name of that condition; those of the published run are the published vehicle's."""
    return "published uncertainties" if is_published(vehicle) else "uncertainties"
