"""The conditions of the layered law behind the actuator, and what an engineer may conclude from them.

The layered law over whole stops: disturbances, the falling speed, and a holding torque that is not known exactly.

The law carries the holding torque of its own parameters as a function of the speed; a stop starts at the reference slip
with that torque acting, be it right or wrong, and ends at 5 km/h. The slip that a random force makes grows as the speed
falls, so that the law is cut out before the stop ends: the wheel is then braked open loop, below what it would slip at.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from railslip_ctrl.core.errors import DomainError, InfeasibleDesignError
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.linearization import OperatingPoint, operating_point
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH, PARK2008, Rail, Vehicle
from railslip_ctrl.simulation.catalogue import is_published

from .fine_simulation import END_SPEED, simulate_fine, slip_range
from .layered import (
    DISTURBANCE,
    DURATION,
    HOLD_ERROR,
    OFFSET,
    PUBLISHED_ADHESION,
    SPEEDS_KMH,
    STEP,
    LayeredDesign,
    LayeredLaw,
    LowestSpeeds,
    RailAdhesion,
    RailBounds,
    Torque,
    bounded_disturbance,
    bounded_errors,
    layer_loop,
    layered_design,
    least_authority,
    load_cases,
    lowest_speeds,
    published_torque,
    rail_bounds,
    random_torque,
    run_errors,
)
from .reaching import ADHESION_NOISE
from .robust import LOWEST_FRICTION
from .verdict import Condition, Verification

_AUTHORITY = (
    "K >= ||h_Tb||_1 (|d| + remainder): the layer is not left, from rest and from an error of "
    f"{OFFSET:g} m/s. It stands for (40)."
)
_KEPT = "The nonlinear wheel with lag and dead time stays within the bounds under torques of that size, at 100 km/h."
_GONE = 0.01  # share of the offset that counts as gone in a bound's reaching time
_STABLE = "layer stable behind the actuator"
_BOUND = "bound with the actuator"


def verify_layered(
    vehicle: Vehicle,
    adhesion: RailAdhesion = PUBLISHED_ADHESION,
    *,
    K: float | None,
    seed: int,
    ki_min: float | None = None,
) -> tuple[Verification, str]:
    """The conditions and the conclusion.

    Where no gains stabilise the rails the first condition does not hold, and the others, which are about a law that
    there is none of, are not decided; K is then 0 unless given.
    """
    try:
        design = layered_design(vehicle, adhesion, K=K, ki_min=ki_min)
    except InfeasibleDesignError as error:
        conditions = _without_design(str(error), vehicle, adhesion)
        none = Verification("layered", vehicle.inertia_scale, K or 0.0, None, seed, tuple(conditions))
        return none, _no_design(vehicle, adhesion)
    conditions = [layered_stability(design, vehicle, adhesion)]
    try:
        bounds = rail_bounds(design, vehicle, adhesion)
    except InfeasibleDesignError as error:
        bounds = {}
        conditions += _without_bound(str(error), vehicle)
    else:
        conditions += _bounded(design, bounds, lowest_speeds(design, vehicle, adhesion), vehicle, adhesion)
    tolerances = {rail: tolerated(design, plant.point) for rail, plant in adhesion.plants(vehicle).items()}
    unknown = uncertainties(design, tolerances, vehicle, adhesion)
    disturbed, cut_out = held_under_published_disturbances(design, vehicle, seed, adhesion)
    conditions += [
        disturbed,
        cut_out_condition(cut_out, vehicle, seed, adhesion),
        held_while_the_speed_falls(design, vehicle, adhesion),
        hold_known(design, tolerances, vehicle, adhesion),
        published_uncertainties(unknown, vehicle, adhesion),
    ]
    found = Verification("layered", vehicle.inertia_scale, design.K, None, seed, tuple(conditions))
    promised = f"on {adhesion.rails_text} rail, {' and '.join(load_cases(vehicle))}"
    failing = [one.name for one in found.failing if one.name != uncertain_name(vehicle)]
    if failing or cut_out is None:
        asked = least_authority(design, vehicle, adhesion)
        more = failing == [HOLD_NAME] and asked <= design.K
        return found, _refusal(found, failing, _more(design) if more else _remedy(design, bounds, asked, adhesion))
    return found, _promise(design, bounds, promised, cut_out) + _unknown_advice(unknown)


def _no_design(vehicle: Vehicle, adhesion: RailAdhesion) -> str:
    return (
        f"There is no layered law for {vehicle.name} with the {adhesion.text} on {adhesion.rails_text} rail: no gains "
        "stabilise the wheel at the reference slip. Remedy: a smaller reference slip, where the adhesion falls less, a "
        "wheel of more inertia, or an actuator with less lag and dead time."
    )


def layered_stability(
    design: LayeredDesign, vehicle: Vehicle, adhesion: RailAdhesion = PUBLISHED_ADHESION
) -> Condition:
    """The loop within the layer over the stop, by the exact root count."""
    margins, unstable = {}, {}
    for speed_kmh in SPEEDS_KMH:
        for load, laden in load_cases(vehicle).items():
            for rail, plant in adhesion.plants(laden, speed_kmh=speed_kmh).items():
                loop = layer_loop(design, plant, vehicle.actuator)
                name = f"{rail}, {speed_kmh:g} km/h, {load}"
                if loop.is_stable():
                    margins[name] = loop.margins().ms
                else:
                    unstable[name] = speed_kmh
    worst = max(margins, key=lambda name: margins[name], default=None)
    least = "" if worst is None else f"; largest Ms {margins[worst]:.3f} ({worst})"
    return Condition(
        _STABLE,
        _stable_statement(vehicle, adhesion),
        not unstable,
        "sampled",
        f"kp = K/layer = {design.kp:.4g} N m/(m/s), ki = rho kp = {design.ki:.4g} N m/m, lead {design.lead:g} s over "
        f"{design.lead_filter:g} s. Exact root counts, {adhesion.text}, reference slip, {len(margins) + len(unstable)} "
        f"points: {'all stable' if not unstable else 'unstable at ' + '; '.join(unstable)}{least}.",
        down_to_kmh=min((one for one in SPEEDS_KMH if one > max(unstable.values(), default=0.0)), default=None),
    )


def _stable_statement(vehicle: Vehicle, adhesion: RailAdhesion) -> str:
    rails = "both rails" if len(adhesion.rails) > 1 else f"{adhesion.rails_text} rail"
    return (
        f"With dead time and lag the loop within the layer is stable on {rails}, {' and '.join(load_cases(vehicle))}, "
        f"from {SPEEDS_KMH[-1]:g} to {SPEEDS_KMH[0]:g} km/h."
    )


def _without_design(reason: str, vehicle: Vehicle, adhesion: RailAdhesion) -> list[Condition]:
    """Every condition where no gains stabilise the rails: that one fails, and leaves no law to decide the others by."""
    none = f"There is no law to decide it by: see `{_STABLE}`."
    undecided = (
        (_BOUND, _bound_statement(vehicle)),
        ("authority", _AUTHORITY),
        ("bounds kept, simulated", _KEPT),
        (DISTURBED_NAME, DISTURBED),
        (CUT_OUT_NAME, CUT_OUT),
        ("speed falling, simulated", FALLING_HELD),
        (HOLD_NAME, HOLD_KNOWN),
        (uncertain_name(vehicle), "What the law does not know leaves the holding torque known well enough."),
    )
    return [
        Condition(_STABLE, _stable_statement(vehicle, adhesion), False, "sampled", f"No gains do that: {reason}."),
        *(Condition(name, statement, None, None, none) for name, statement in undecided),
    ]


def _without_bound(reason: str, vehicle: Vehicle) -> list[Condition]:
    """The bound's conditions where there is none: what is about the bound itself is not decided."""
    none = f"There is no bound to decide it by: see `{_BOUND}`."
    return [
        _bound_condition(False, reason, vehicle),
        Condition("authority", _AUTHORITY, None, None, none),
        Condition("bounds kept, simulated", _KEPT, None, None, none),
    ]


def _bound_condition(holds: bool, evidence: str, vehicle: Vehicle, down_to_kmh: float | None = None) -> Condition:
    return Condition(_BOUND, _bound_statement(vehicle), holds, "sampled", evidence, down_to_kmh=down_to_kmh)


def _bound_statement(vehicle: Vehicle) -> str:
    return (
        f"|torque at the wheel| <= {bounded_disturbance(vehicle):.3g} N m ({100 * DISTURBANCE:.2g} % of wheel load "
        "times radius) from rest keeps the slip between 0 and twice the reference."
    )


def _bounded(
    design: LayeredDesign,
    bounds: dict[Rail, RailBounds],
    lowest: LowestSpeeds,
    vehicle: Vehicle,
    adhesion: RailAdhesion,
) -> list[Condition]:
    """Bound, authority, offset, and the simulations that must keep them."""
    listed = "; ".join(
        f"{rail}: |sigma error| <= {one.at_rest.error:.3f} m/s (a slip of "
        f"{one.at_rest.slip_error(one.plant.point.speed):.4f}), |s| <= {one.at_rest.surface:.3f} m/s"
        for rail, one in bounds.items()
    )
    asked = "; ".join(
        f"{rail}: {one.at_rest.command:.0f} N m from rest, {one.from_offset.command:.0f} N m from the error, then "
        f"below {one.from_offset.error + _GONE * OFFSET:.3f} m/s after {one.from_offset.reaching_time:.1f} s"
        for rail, one in bounds.items()
    )
    return [
        _bound_condition(
            lowest.held is not None,
            f"{listed}: at 100 km/h, speed frozen, {adhesion.text}, {next(iter(load_cases(vehicle)))}. L1 norms of the "
            "impulse responses, dead time exact, the linearisation's remainder sampled.",
            vehicle,
            lowest.held,
        ),
        Condition(
            "authority",
            _AUTHORITY,
            lowest.kept is not None,
            "sampled",
            f"K = {design.K:.4g} N m, layer {design.layer:.3f} m/s; asked at 100 km/h {asked}.",
            down_to_kmh=lowest.kept,
        ),
        bounds_kept(design, bounds),
    ]


def bounds_kept(design: LayeredDesign, bounds: dict[Rail, RailBounds]) -> Condition:
    """The nonlinear wheel against the bounds."""
    lines, kept = [], True
    for rail, one in bounds.items():
        try:
            errors = bounded_errors(design, one)
            start = [run_errors(design, one.plant, lambda _: 0.0, offset=sign * OFFSET) for sign in (1.0, -1.0)]
        except DomainError as error:
            lines.append(f"{rail}: {error}")
            kept = False
            continue
        name = max(errors, key=lambda key: errors[key][0])
        largest, command = errors[name][0], max(command for _, command in errors.values())
        kept &= largest <= one.at_rest.error and command <= one.at_rest.command
        kept &= all(e <= one.from_offset.largest_error and c <= one.from_offset.command for e, c in start)
        lines.append(
            f"{rail}: |sigma error| up to {largest:.3f} of {one.at_rest.error:.3f} m/s ({name}), |Tb - hold| up to "
            f"{command:.0f} of {one.at_rest.command:.0f} N m; from the offset {max(c for _, c in start):.0f} of "
            f"{one.from_offset.command:.0f} N m"
        )
    return Condition(
        "bounds kept, simulated",
        _KEPT,
        kept,
        "simulated",
        f"{'; '.join(lines)}. Step, sines, held noise, the linear loop's worst case, offsets of +-{OFFSET:g} m/s, "
        f"{DURATION:g} s each, speed frozen.",
        down_to_kmh=INITIAL_SPEED_KMH if kept else None,
    )


def _refusal(found: Verification, failing: list[str], remedy: str) -> str:
    open_ = [one.name for one in found.undecided]
    rest = f"; not decided: {'; '.join(open_)}" if open_ else ""
    return f"Do not use the layered law like this; not met: {'; '.join(failing)}{rest}. Remedy: {remedy}."


def _promise(design: LayeredDesign, bounds: dict[Rail, RailBounds], where: str, cut_out: float) -> str:
    """What the law promises, where all but the condition on what is not known hold."""
    worst = max(one.at_rest.error for one in bounds.values())
    height = next(iter(bounds.values())).at_rest.disturbance
    below = f"Below {cut_out:g} km/h cut it out: {100 * CUT_OUT_SHARE:g} % of the holding torque, open loop. "
    return (
        f"Use kp = K/layer = {design.kp:.4g} N m/(m/s), rho = {design.rho:.4g} 1/s, a lead of {design.lead:g} s over "
        f"{design.lead_filter:g} s, K = {design.K:.0f} N m about the holding torque at the speed of the moment, from "
        f"100 to {cut_out:g} km/h {where}, with the holding torque known to {100 * HOLD_ERROR:g} %. "
        f"{below if cut_out > SPEEDS_KMH[0] else ''}At 100 km/h |sigma error| stays below {worst:.3f} m/s for torque "
        f"errors up to {height:.3g} N m; disturbed stops are simulated, not proved."
    )


def _unknown_advice(unknown: Uncertainties) -> str:
    """What has to be known; empty where nothing has to be."""
    told = "".join(
        f" Has to be known: {one.name}, which on {one.rail} rail puts the holding torque wrong by "
        f"{100 * one.error:+.1f} %, more than is tolerated."
        for one in unknown.beyond
    )
    return told + (_rail_advice(unknown.mistaken) if unknown.rail_matters else "")


def _rail_advice(mistaken: dict[Rail, LayeredStop]) -> str:
    """What it means that the law has to know the rail."""
    told = []
    for on, found in mistaken.items():
        fate = "is held" if found.held else "is lost" if found.lost else "is not held at the reference, but not lost"
        told.append(f"a wheel on {on} rail taken for {Rail.DRY if on is Rail.WET else Rail.WET} {fate}")
    safe = ", and where it is not identified those of the wet rail" if mistaken[Rail.DRY].lost is None else ""
    return (
        f" The rail has to be known: {'; '.join(told)}. Take reference and torque from an identified rail (`railslip "
        f"identify`, the observers){safe}."
    )


def _more(design: LayeredDesign) -> str:
    """What takes a wrong holding torque out sooner, where K suffices and all else holds."""
    return (
        f"ask for more integral gain than ki = {design.ki:.4g} N m/m (--ki-min), as far as the other conditions bear it"
    )


def _remedy(design: LayeredDesign, bounds: dict[Rail, RailBounds], asked: float, adhesion: RailAdhesion) -> str:
    if not bounds:
        slip = "" if adhesion == PUBLISHED_ADHESION else "a reference slip where the adhesion bends and falls less, "
        return (
            f"{slip}a wheel whose inertia is larger beside the adhesion (a larger inertia scale), or an actuator with "
            "less lag and dead time: no K makes up for it"
        )
    if math.isfinite(asked) and asked > design.K:
        return f"give K >= {asked:.0f} N m, or leave K out"
    slip = "" if adhesion == PUBLISHED_ADHESION else "reference slip, "
    return f"choose another {slip}vehicle or actuator; K is large enough"


# --- whole stops ------------------------------------------------------------------------------------------------------


_LONGEST = 60.0  # s, times the inertia scale: longer than any stop of the published vehicle
_LONGEST_SHARE = 2.0  # of the time that the adhesion at the reference takes to stop the train, where that is longer
_TABLE = 24  # speeds of the hold's table, between which it is linear: it bends by a tenth over the stop
_FARTHEST = 0.5  # share of the hold by which errors are tried, either way
_RESOLUTION = 0.005  # of the tolerated error, found by bisection
RUNS = 4
"""Disturbed stops of each rail and load."""

LARGEST_CUT_OUT_KMH = 30.0
"""Above it a law is no slide protection: a tenth of the stop's energy would be left."""

CUT_OUT_SHARE = 0.8
"""Of the holding torque, below the cut-out speed."""

# over the highest speed at which a run left the range (40 seeds reach 1.3 times what 4 do); rounded up to
_CUT_OUT_MARGIN, _CUT_OUT_STEP_KMH = 1.4, 5.0
_LOWEST_KMH = END_SPEED / KMH
_FRICTION_FALL = PARK2008.wheel.viscous_friction - LOWEST_FRICTION  # N m s, over the longest published stop

DISTURBED_NAME = "published disturbances, simulated"
DISTURBED = (
    "From 100 km/h down to the cut-out the slip stays between 0 and twice the reference under the published random "
    f"force ({100 * ADHESION_NOISE:.3g} % of the wheel load, cut at 3 sigma) and Td; cut-out at "
    f"{LARGEST_CUT_OUT_KMH:g} km/h at most."
)
CUT_OUT_NAME = "cut-out, simulated"
CUT_OUT = (
    f"Below the cut-out, with {100 * CUT_OUT_SHARE:g} % of the holding torque open loop, no wheel locks under the "
    f"random force down to {_LOWEST_KMH:g} km/h."
)
FALLING_HELD = (
    f"Undisturbed, from 100 to {_LOWEST_KMH:g} km/h, where the stop ends, the slip stays between 0 and twice the "
    "reference."
)
HOLD_NAME = "holding torque known"
HOLD_KNOWN = (
    f"The same with the holding torque known to +-{100 * HOLD_ERROR:g} %: the integral in the layer takes the error "
    "out."
)


@dataclass(frozen=True)
class LayeredStop:
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
        late = "" if self.ended else f" and not at {_LOWEST_KMH:g} km/h yet"
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
) -> LayeredStop:
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
        run = simulate_fine(point, law, actuator, duration=longest, step=STEP, frozen=False, end_speed=END_SPEED)
    except DomainError as error:
        return LayeredStop((0.0, 1.0), float("nan"), str(error), False, ended=False)
    low, high = slip_range(run)
    end = float(run.time[-1])
    ended = end < longest - 2.0 * STEP
    return LayeredStop((low, high), end, None, ended and low > 0.0 and high < 2.0 * believed.slip, ended)


def _longest(point: OperatingPoint) -> float:
    """Seconds after which a stop is given up."""
    vehicle = point.vehicle
    ideal = vehicle.effective_mass * point.speed / point.adhesion_force if point.adhesion_force > 0.0 else 0.0
    return max(_LONGEST * vehicle.inertia_scale, _LONGEST_SHARE * ideal)


# --- disturbed -------------------------------------------------------------------------------------------------------


class _Watched:
    """A law, and the speed, m/s, at which the slip first left 0 to twice the reference; 0 where it never did."""

    def __init__(self, law: LayeredLaw) -> None:
        self.law, self.left = law, 0.0

    def command(self, v: float, sigma: float, v_rate: float, step: float) -> tuple[float, float]:
        """See `fine_simulation.SteppedLaw`."""
        if self.left == 0.0 and not 0.0 < sigma < 2.0 * self.law.slip * v:
            self.left = v
        return self.law.command(v, sigma, v_rate, step)


class _OpenLoop:
    """`CUT_OUT_SHARE` of a torque of the speed, whatever the slip; the largest slip ratio seen."""

    def __init__(self, hold: Callable[[float], float]) -> None:
        self.hold, self.slip = hold, 0.0

    def command(self, v: float, sigma: float, v_rate: float, step: float) -> tuple[float, float]:
        """See `fine_simulation.SteppedLaw`."""
        self.slip = max(self.slip, sigma / v)
        return CUT_OUT_SHARE * self.hold(v), 0.0


def range_left(design: LayeredDesign, point: OperatingPoint, seed: int) -> float:
    """Speed, km/h, at which the slip of a stop with the published disturbances first leaves its range; 0 if never."""
    law = _Watched(LayeredLaw(point.slip, hold_table(point), design=design))
    _disturbed(point, law, published_torque(design, point, seed, _longest(point)))
    return law.left / KMH


def open_loop_slip(point: OperatingPoint, seed: int) -> float:
    """Largest slip ratio from the cut-out at the point's speed and reference slip on; 1 for a wheel that locks."""
    law = _OpenLoop(hold_table(point))
    return law.slip if _disturbed(point, law, random_torque(point, seed, _longest(point))) else 1.0


def _disturbed(point: OperatingPoint, law: _Watched | _OpenLoop, torque: Torque) -> bool:
    """Run a stop; whether the wheel was not lost."""
    longest, actuator = _longest(point), point.vehicle.actuator
    try:
        simulate_fine(
            point, law, actuator, duration=longest, step=STEP, disturbance=torque, frozen=False, end_speed=END_SPEED
        )
    except DomainError:
        return False
    return True


def held_under_published_disturbances(
    design: LayeredDesign, vehicle: Vehicle, seed: int, adhesion: RailAdhesion = PUBLISHED_ADHESION
) -> tuple[Condition, float | None]:
    """Whole stops with the published disturbances, which no L1 bound covers; and the cut-out, km/h, None without."""
    seeds = range(seed, seed + RUNS)
    left = {
        f"{rail}, {load}": max(range_left(design, plant.point, one) for one in seeds)
        for load, laden in load_cases(vehicle).items()
        for rail, plant in adhesion.plants(laden).items()
    }
    highest = max(left.values())
    steps = math.ceil(_CUT_OUT_MARGIN * highest / _CUT_OUT_STEP_KMH)
    cut_out = max(_LOWEST_KMH, steps * _CUT_OUT_STEP_KMH)
    holds = cut_out <= LARGEST_CUT_OUT_KMH
    told = "; ".join(
        f"{name}: {f'left at {speed:.1f} km/h' if speed else 'never left'}" for name, speed in left.items()
    )
    runs = f"{RUNS} stops each, seeds {seed} to {seed + RUNS - 1}"
    found = Condition(
        DISTURBED_NAME,
        DISTURBED,
        holds,
        "simulated",
        f"{told}. Cut-out: {f'{cut_out:g} km/h' if holds else 'none'}, {_CUT_OUT_MARGIN:g} times the highest, "
        f"rounded up. {runs}.",
        down_to_kmh=cut_out if cut_out < INITIAL_SPEED_KMH else None,
    )
    return found, cut_out if holds else None


def cut_out_condition(
    cut_out: float | None, vehicle: Vehicle, seed: int, adhesion: RailAdhesion = PUBLISHED_ADHESION
) -> Condition:
    """The wheel from the cut-out, km/h, on."""
    if cut_out is None:
        return Condition(CUT_OUT_NAME, CUT_OUT, None, None, f"There is no cut-out: see `{DISTURBED_NAME}`.")
    if cut_out <= _LOWEST_KMH:
        return Condition(CUT_OUT_NAME, CUT_OUT, True, "simulated", "None is needed.", down_to_kmh=_LOWEST_KMH)
    seeds = range(seed, seed + RUNS)
    slips = {
        f"{rail}, {load}": max(open_loop_slip(plant.point, one) for one in seeds)
        for load, laden in load_cases(vehicle).items()
        for rail, plant in adhesion.plants(laden, speed_kmh=cut_out).items()
    }
    return Condition(
        CUT_OUT_NAME,
        CUT_OUT,
        max(slips.values()) < 1.0,
        "simulated",
        f"Largest slip from {cut_out:g} km/h on: {'; '.join(f'{name}: {slip:.2f}' for name, slip in slips.items())}. "
        f"{RUNS} runs each, seeds {seed} to {seed + RUNS - 1}.",
        down_to_kmh=_LOWEST_KMH if max(slips.values()) < 1.0 else None,
    )


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
        f"{'; '.join(lines)}. From the reference slip at rest, mass and rail known.",
        down_to_kmh=_LOWEST_KMH if held else None,
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
    """How well the holding torque must be known."""
    lines = [
        f"{rail}: held from {_edge_text(below, -1.0)} to {_edge_text(above, 1.0)} %"
        for rail, (below, above) in tolerances.items()
    ]
    held = all(min(edges) >= HOLD_ERROR for edges in tolerances.values())
    return Condition(
        HOLD_NAME,
        HOLD_KNOWN,
        held,
        "simulated",
        f"{'; '.join(lines)}. The wrong torque from the first moment on, {next(iter(load_cases(vehicle)))}; edges to "
        f"{100 * _RESOLUTION:g} %, K = {design.K:.0f} N m.",
        down_to_kmh=_LOWEST_KMH if held else None,
        tolerated={f"holding torque, {rail}": min(edges) for rail, edges in tolerances.items()},
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
    mistaken: dict[Rail, LayeredStop]

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
