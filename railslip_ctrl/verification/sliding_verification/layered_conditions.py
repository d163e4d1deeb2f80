"""The conditions of the layered law behind the actuator, and what an engineer may conclude from them."""

from __future__ import annotations

import math

from railslip_ctrl.core.errors import DomainError, InfeasibleDesignError
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH, Rail, Vehicle
from railslip_ctrl.verification.switching import LayeredDesign, layer_loop
from railslip_ctrl.verification.switching.effects import ActuatorEffect
from railslip_ctrl.verification.verdict import Condition, Verification

from .layered import (
    DISTURBANCE,
    DURATION,
    HOLD_ERROR,
    OFFSET,
    LowestSpeeds,
    RailBounds,
    bounded_disturbance,
    bounded_errors,
    layered_design,
    least_authority,
    lowest_speeds,
    rail_bounds,
    run_errors,
)
from .layered_stops import (
    CUT_OUT,
    CUT_OUT_NAME,
    CUT_OUT_SHARE,
    DISTURBED,
    DISTURBED_NAME,
    FALLING_HELD,
    HOLD_KNOWN,
    HOLD_NAME,
    Stop,
    Uncertainties,
    cut_out_condition,
    held_under_published_disturbances,
    held_while_the_speed_falls,
    hold_known,
    published_uncertainties,
    tolerated,
    uncertain_name,
    uncertainties,
)
from .published import SPEEDS_KMH
from .rail_adhesion import PUBLISHED_ADHESION, RailAdhesion, load_cases

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
) -> tuple[Verification, tuple[ActuatorEffect, ...], str]:
    """The conditions, no analyses of the published law, and the conclusion.

    Where no gains stabilise the rails the first condition does not hold, and the others, which are about a law that
    there is none of, are not decided; K is then 0 unless given.
    """
    try:
        design = layered_design(vehicle, adhesion, K=K, ki_min=ki_min)
    except InfeasibleDesignError as error:
        conditions = _without_design(str(error), vehicle, adhesion)
        none = Verification("layered", vehicle.inertia_scale, K or 0.0, None, seed, tuple(conditions))
        return none, (), _no_design(vehicle, adhesion)
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
        return found, (), _refusal(found, failing, _more(design) if more else _remedy(design, bounds, asked, adhesion))
    return found, (), _promise(design, bounds, promised, cut_out) + _unknown_advice(unknown)


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


def _rail_advice(mistaken: dict[Rail, Stop]) -> str:
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
