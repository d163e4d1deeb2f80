"""What lag and dead time do to the published law and to the robust variants: records, conditions, conclusions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from railslip_ctrl.core.errors import DomainError
from railslip_ctrl.model.vehicle import (
    AS_PUBLISHED_INERTIA_SCALE,
    INITIAL_SPEED_KMH,
    PARK2008,
    Rail,
    Vehicle,
)
from railslip_ctrl.simulation.catalogue import is_published

from .layered import SPEEDS_KMH, RailAdhesion
from .limit_cycles import (
    LINEAR_CHANGE,
    LimitCycle,
    law_runs,
    linear_limit_cycle,
    linearisation_change,
    nonlinear_limit_cycle,
    predict_limit_cycle,
    simulated_limit_cycle,
    smallest_layer,
)
from .relay_loop import (
    TABLE4_SLIDING,
    FeedForward,
    SlidingExistence,
    SlidingGains,
    SurfaceLoop,
)
from .robust import LAYER_WIDTH, effective_torque
from .surviving_gains import (
    JointAdvice,
    Survivors,
    adaptive_unstable_poles,
    advice_text,
    joint_advice,
    largest_adaptation,
    survivors,
    without_actuator,
)
from .verdict import Condition

COMPARED_RELAYS = (70.0, 200.0, 400.0)
"""K, N*m: Table 4's, and what it takes to carry disturbances of the size the paper simulates."""


def published_loop(
    rail: Rail,
    *,
    inertia_scale: float = 1.0,
    adhesion: str = "bristle",
    speed_kmh: float = INITIAL_SPEED_KMH,
    vehicle: Vehicle = PARK2008,
    gains: SlidingGains | None = None,
    feed_forward: FeedForward = FeedForward.MODEL,
) -> SurfaceLoop:
    """The published law's loop on a rail at the reference slip of the bristle, curve or beam law.

    `inertia_scale` is a factor on M, J, B and, as a change of units demands, the stiffness of the bristle model.
    `gains` left out: Table 4's bristle column (beam for the beam law).
    """
    scaled = vehicle.model_copy(update={"inertia_scale": inertia_scale})
    plant = RailAdhesion(adhesion, (rail,)).plants(scaled, speed_kmh=speed_kmh)[rail]
    column = TABLE4_SLIDING["beam" if adhesion == "beam" else "bristle"]
    return SurfaceLoop(plant, gains or column, scaled.actuator, feed_forward)


@dataclass(frozen=True)
class RelayCycle:
    """The limit cycle for one K, with the load the law leaves out.

    predicted, linear: of the linearised loop, by describing function and with every harmonic; linear_change: change of
    the wheel's response over the swing of `linear`, a ratio, see `linearisation_change`; actual: of the wheel with its
    adhesion curve, adaptation off and speed frozen; where it leaves 0 to v, as simulated; None where the wheel is lost.
    """

    predicted: LimitCycle
    linear: LimitCycle
    linear_change: float
    actual: LimitCycle | None

    @property
    def linear_holds(self) -> bool:
        """Whether the linearisation holds over the swing."""
        return self.linear_change <= LINEAR_CHANGE

    @property
    def period_error(self) -> float:
        """Describing function over actual, less 1; NaN where the wheel is lost."""
        return math.nan if self.actual is None else self.predicted.period / self.actual.period - 1

    @property
    def amplitude_error(self) -> float:
        """Of the amplitude of s: describing function over actual, less 1; NaN where the wheel is lost."""
        actual = self.actual
        return math.nan if actual is None else self.predicted.surface_amplitude / actual.surface_amplitude - 1


@dataclass(frozen=True)
class ActuatorEffect:
    """What lag and dead time do to the published law at one operating point.

    cycles: one for each K compared that has one, ascending; no_cycle: why the gains' own K has none, empty where it
    has; ideal: what the adaptation would do with an ideal actuator; unstable_ideal, unstable_actual: number of
    right-half-plane poles of the adaptive loop without and with actuator, the relay as a gain of 0; unstable_linear: of
    those with actuator and without adaptation.
    """

    loop: SurfaceLoop
    existence: SlidingExistence
    cycles: tuple[RelayCycle, ...]
    no_cycle: str
    unstable_ideal: float
    unstable_actual: float
    unstable_linear: float
    survivors: Survivors

    @property
    def name(self) -> str:
        """For tables: adhesion, rail and inertia scale."""
        point = self.loop.plant.point
        return f"{point.adhesion} {point.rail.value}, inertia x {point.vehicle.inertia_scale:g}"

    @property
    def holds_the_wheel(self) -> bool:
        """Whether the cycle with the gains' own K, adaptation off, keeps the slip between 0 and twice the reference.

        Without a cycle: whether the loop is stable about its rest.
        """
        if self.no_cycle:
            return self.unstable_linear == 0
        actual = self.cycles[0].actual
        if actual is None:
            return False
        return actual.sigma_range[0] > 0.0 and actual.sigma_range[1] < 2 * self.loop.plant.point.sigma

    @property
    def cycle_text(self) -> str:
        """The cycle with the gains' own K in words, with the slip's range."""
        if self.no_cycle:
            return self.no_cycle
        cycle = self.cycles[0]
        actual, K, speed = cycle.actual, cycle.linear.K, self.loop.plant.point.speed
        if actual is None:
            return f"with K = {K:g} N*m the wheel locks or leaves the adhesion model in the simulation: it is lost"
        low, high = (sigma / speed for sigma in actual.sigma_range)
        held = "" if high < 2 * self.loop.plant.point.slip else ", beyond twice the reference"
        held += "" if low > 0 else ", releasing the wheel once a period"
        beyond = "" if cycle.linear_holds else f"; the linearised loop would say {cycle.linear.slip_amplitude:.4f}"
        return (
            f"K = {K:g} N*m cycles with {actual.period:.2f} s and a slip amplitude of {actual.slip_amplitude:.4f} "
            f"({low:.3f} to {high:.3f}{held}{beyond})"
        )

    @property
    def adaptation_hopeless(self) -> bool:
        """Whether the printed k is unstable at every relay gain."""
        return self.survivors.excursion == 0


def actuator_effect(loop: SurfaceLoop, *, slip_amplitude: float = 0.02) -> ActuatorEffect:
    """Analyse one loop; `slip_amplitude`: what K may make of the slip, a ratio, > 0, see `largest_relay`."""
    relays = (loop.gains.K, *(K for K in COMPARED_RELAYS if K > loop.gains.K))
    unstable = adaptive_unstable_poles(loop.with_gains(k=0.0))
    cycles = _relay_cycles(loop, relays)
    own = bool(cycles) and cycles[0].linear.K == loop.gains.K
    return ActuatorEffect(
        loop=loop,
        existence=loop.sliding_existence(),
        cycles=cycles,
        no_cycle="" if own else _why_no_cycle(loop, unstable),
        unstable_ideal=adaptive_unstable_poles(without_actuator(loop)),
        unstable_actual=adaptive_unstable_poles(loop),
        unstable_linear=unstable,
        survivors=survivors(loop, slip_amplitude=slip_amplitude),
    )


def _relay_cycles(loop: SurfaceLoop, relays: Sequence[float]) -> tuple[RelayCycle, ...]:
    """For relays in ascending order, those that have a cycle; where one loses the wheel a higher one does."""
    cycles: list[RelayCycle] = []
    for K in relays:
        try:
            linear = linear_limit_cycle(loop, K=K, load=loop.load)
            predicted = predict_limit_cycle(loop, K=K, load=loop.load)
            lost = bool(cycles) and cycles[-1].actual is None
            actual = None if lost else nonlinear_limit_cycle(loop, K=K) or simulated_limit_cycle(loop, K=K)
        except DomainError:  # no stable cycle, or a relay that rests on one side: the caller says which
            continue
        cycles.append(RelayCycle(predicted, linear, linearisation_change(loop, linear), actual))
    return tuple(cycles)


def _why_no_cycle(loop: SurfaceLoop, unstable: float) -> str:
    """For the gains' own K, from the poles without relay and adaptation."""
    K, gains = loop.gains.K, f"D = {loop.gains.D:.4g} N*m/(m/s) and rho = {loop.gains.rho:.4g} 1/s"
    if unstable:
        return (
            f"no stable cycle: {gains} leave {unstable:.0f} unstable poles whatever the relay does, so that small "
            "swings grow"
        )
    if loop.load >= K:
        return (
            f"K = {K:g} N*m does not carry the {loop.load:.1f} N*m of travelling resistance: the relay rests on one "
            f"side, D s carries the rest, and nothing cycles ({gains} are stable by themselves)"
        )
    if loop.sliding_existence().exists:
        return f"no cycle: the relay acts at once, K = {K:g} N*m"
    return f"K = {K:g} N*m has no cycle with two switches a period ({gains} are stable by themselves)"


def cycle_table(effects: Sequence[ActuatorEffect]) -> str:
    """Limit cycles of some `effects` as text.

    For each K the wheel's, then the linearised loop's and the describing function's error.
    """
    lines = [
        f"{'case':28} {'K':>5} {'period s':>9} {'s m/s':>7} {'slip':>7} {'torque N*m':>10} "
        f"{'lin. T':>7} {'lin. slip':>10} {'DF T':>6} {'DF s':>6}"
    ]
    for effect in effects:
        if effect.no_cycle:
            lines.append(f"{effect.name:28} {effect.loop.gains.K:5.0f} {'--':>9}")
        lines += [f"{effect.name:28} {cycle.linear.K:5.0f} {_row(cycle)}" for cycle in effect.cycles]
    return "\n".join(
        [
            *lines,
            "Adaptation off, speed frozen. lost: the wheel locks; --: no stable cycle; DF: describing function against "
            "the wheel.",
            f"*: beyond the linearisation: over the swing the wheel's response changes by over {LINEAR_CHANGE:.0%}, or "
            "the slip leaves the model.",
        ]
    )


def _row(cycle: RelayCycle) -> str:
    c, linear = cycle.actual, cycle.linear
    own = f"{'lost':>9} {'-':>7} {'-':>7} {'-':>10}"
    errors = f"{'-':>6} {'-':>6}"
    if c is not None:
        own = f"{c.period:9.3f} {c.surface_amplitude:7.3f} {c.slip_amplitude:7.4f} {c.torque_amplitude:10.1f}"
        errors = f"{100 * cycle.period_error:+5.1f}% {100 * cycle.amplitude_error:+5.1f}%"
    mark = " " if cycle.linear_holds else "*"
    return f"{own} {linear.period:7.3f} {linear.slip_amplitude:9.4f}{mark} {errors}"


def conclusion(effects: Sequence[ActuatorEffect], advice: JointAdvice, points: str) -> str:
    """One paragraph for an engineer, from the numbers of the effects, closed by the joint advice.

    `points` says in words over which operating points the advice was decided. DomainError without any effect.
    """
    if not effects:
        raise DomainError("conclusion: no operating point was analysed; give at least one")
    first = effects[0]
    if first.existence.exists:
        return "This actuator acts at once: sliding exists, nothing cycles, and it sets no limit to K, D, rho and k."
    small = [cycle for effect in effects for cycle in effect.cycles if cycle.actual is not None and cycle.linear_holds]
    opening = f"With the actuator no ideal sliding mode exists: {first.existence.reason}."
    if any(effect.cycles for effect in effects):
        opening += (
            " What takes its place is a limit cycle whose period depends little on K and whose amplitude grows with K"
            f"{_accuracy(small)}. Alone, with the adaptation off and the speed frozen:"
        )
    cases = (_of_case(effect) for effect in effects)
    return " ".join([opening, *cases, advice_text(advice, points)])


def _accuracy(cycles: Sequence[RelayCycle]) -> str:
    """How good the describing function is for cycles over which the linearisation holds; nothing of none."""
    if not cycles:
        return ""
    period = 100 * max(abs(cycle.period_error) for cycle in cycles)
    amplitude = 100 * max(abs(cycle.amplitude_error) for cycle in cycles)
    return (
        f" (describing function within {period:.1f} % of the period and {amplitude:.1f} % of the amplitude of s, where "
        "the swing is small enough for the linearisation)"
    )


def _of_case(effect: ActuatorEffect) -> str:
    left, k = effect.survivors, effect.loop.gains.k
    short = "" if effect.loop.load < left.K else f", less than the {effect.loop.load:.1f} N*m of travelling resistance"
    hint = "" if left.linear_change <= LINEAR_CHANGE else " (linearised beyond its range)"
    if k == 0:
        adaptation = f"adaptation would be stable up to k = {left.k:.3g}"
    elif effect.adaptation_hopeless:
        adaptation = (
            f"the adaptation with k = {k:.3g} is unstable whatever the relay does ({effect.unstable_actual:.0f} poles; "
            f"ideal actuator: {effect.unstable_ideal:.0f}), k <= {left.k:.3g} survives"
        )
    elif effect.unstable_actual:
        adaptation = (
            f"the adaptation with k = {k:.3g} is unstable once s exceeds {left.excursion:.2g} m/s, for then the relay "
            f"is too small to damp it; k <= {left.k:.3g} survives"
        )
    else:
        adaptation = f"k = {k:.3g} is stable, {left.k / k:.2f} times as much is not"
    if not left.stable:
        return f"{effect.name}: {effect.cycle_text}; no layer and no k makes it stable."
    return (
        f"{effect.name}: {effect.cycle_text}. One at a time, the others as they are, the limits here are: "
        f"{_at_most('K', left.K, '.1f', 'N*m')}{hint}{short} for a slip amplitude of {left.slip_amplitude:g}; a "
        f"boundary layer of {left.layer:.3f} m/s at K = {effect.loop.gains.K:g} N*m; "
        f"{_at_most('rho', left.rho, '.3g', '1/s')}; {_at_most('D', left.D, '.4g', 'N*m/(m/s)')}; {adaptation}."
    )


def _at_most(name: str, limit: float, form: str, unit: str) -> str:
    return f"{name} without limit" if math.isinf(limit) else f"{name} <= {limit:{form}} {unit}"


# --- the published law behind the actuator ----------------------------------------------------------------------------


POINTS = f"{SPEEDS_KMH[0]:g} to {SPEEDS_KMH[-1]:g} km/h, dry and wet, empty and loaded"


def published_behind_actuator(K: float, D: float, vehicle: Vehicle) -> tuple[tuple[Condition, ...], str]:
    """Conditions and conclusion with these gains (N*m, N*m/(m/s)), rho and k as printed.

    Decided at the published reference slip of the bristle model at 100 km/h, by the exact root count, the exact limit
    cycle of the linearised loop and simulation of the whole law; the advice over the whole stop.
    """
    effects = tuple(actuator_effect(_loop(rail, K, D, vehicle)) for rail in Rail)
    advice = joint_advice(stop_loops(K, D, vehicle))
    told = conclusion(effects, advice, POINTS)
    if is_published(vehicle) and not effects[0].existence.exists:  # of another vehicle nothing is published
        told = f"{told} {_as_published(D, vehicle)}"
    return tuple(_conditions(effects)), told


def stop_loops(K: float, D: float, vehicle: Vehicle) -> dict[str, SurfaceLoop]:
    """The law's loops over a stop, by name: speeds, rails, empty and loaded."""
    return {
        f"{rail}, {speed_kmh:g} km/h, {'loaded' if loaded else 'empty'}": _loop(
            rail, K, D, vehicle.loaded() if loaded else vehicle, speed_kmh=speed_kmh
        )
        for loaded in (False, True)
        for speed_kmh in SPEEDS_KMH
        for rail in Rail
    }


def _loop(rail: Rail, K: float, D: float, vehicle: Vehicle, *, speed_kmh: float = INITIAL_SPEED_KMH) -> SurfaceLoop:
    loop = published_loop(rail, inertia_scale=vehicle.inertia_scale, vehicle=vehicle, speed_kmh=speed_kmh)
    return replace(loop, gains=SlidingGains(K=K, D=D, rho=loop.gains.rho, k=loop.gains.k))


def _as_published(D: float, vehicle: Vehicle) -> str:
    """How far the printed k is from unstable in the as-published reading, the relay's help left out."""
    scale, ratios = AS_PUBLISHED_INERTIA_SCALE, []
    for adhesion in ("bristle", "curve"):
        for rail in Rail:
            loop = published_loop(rail, inertia_scale=scale, adhesion=adhesion, vehicle=vehicle).with_gains(D=D)
            ratios.append(f"{adhesion} {rail} {largest_adaptation(loop) / loop.gains.k:.2f}")
    return (
        f"In the as-published reading (inertia x {scale:g}) the largest k that is stable, over the printed one, is: "
        f"{', '.join(ratios)}; below 1 the printed adaptation is unstable, little above 1 barely stable."
    )


def _conditions(effects: tuple[ActuatorEffect, ...]) -> list[Condition]:
    set_of_points = "bristle model, 100 km/h, published reference slip; " + "; ".join(effect.name for effect in effects)
    actuator = effects[0].loop.actuator
    return [
        Condition(
            "sliding exists behind the actuator",
            f"With dead time {actuator.dead_time:g} s and lag {actuator.lag:g} s between command and torque, s reaches "
            "0 and stays there.",
            all(effect.existence.exists for effect in effects),
            "symbolic",
            effects[0].existence.reason,
            claimed=True,
        ),
        Condition(
            "the relay's own cycle spares the wheel",
            "Without adaptation, at frozen speed and undisturbed, the oscillation that takes the place of sliding "
            "keeps the slip between 0 and twice the reference.",
            all(effect.holds_the_wheel for effect in effects),
            "sampled",
            f"Limit cycles of the nonlinear wheel over: {set_of_points}. "
            + "; ".join(f"{effect.name}: {effect.cycle_text}" for effect in effects)
            + ".",
        ),
        _spared(effects),
        Condition(
            "the adaptive loop is stable behind the actuator",
            "With the gain k of the law the linearised adaptive loop has no pole right of the axis.",
            all(effect.unstable_actual == 0 for effect in effects),
            "sampled",
            f"Exact root counts over: {set_of_points}. " + "; ".join(_adaptation(e) for e in effects) + ".",
            claimed=True,
        ),
    ]


def _spared(effects: tuple[ActuatorEffect, ...]) -> Condition:
    """The whole law, simulated."""
    runs = {effect.name: law_runs(effect.loop) for effect in effects}
    return Condition(
        "the law behind the actuator spares the wheel",
        "(45) with its relay and the adaptation (49) keeps the slip between 0 and twice the reference.",
        all(one.spared for pair in runs.values() for one in pair),
        "simulated",
        "; ".join(f"{name}: {', '.join(one.text for one in pair)}" for name, pair in runs.items())
        + f". Nonlinear wheel, from 5 % above the reference at 100 km/h, undisturbed, parameters known, theta_hat from "
        f"0: {effects[0].loop.gains.K:g} N*m relay, k = {effects[0].loop.gains.k:g}, steps of 5 ms; the speed frozen "
        "for 60 s times the inertia scale, and falling to 5 km/h.",
        claimed=True,
    )


def _adaptation(effect: ActuatorEffect) -> str:
    survives = (
        (f"up to k = {effect.survivors.k:.3g} none" if math.isfinite(effect.survivors.k) else "nor at any other k")
        if effect.survivors.stable
        else f"{effect.unstable_linear:g} of them without any adaptation"
    )
    return (
        f"{effect.name}: {effect.unstable_actual:g} unstable poles (ideal actuator: {effect.unstable_ideal:g}) at "
        f"k = {effect.loop.gains.k:g}, {survives}"
    )


# --- the robust variants behind the actuator --------------------------------------------------------------------------


def variants_behind_actuator(K: float, D: float, vehicle: Vehicle) -> tuple[tuple[Condition, ...], str]:
    """The conditions of layer and relay behind the actuator, and the conclusion; gains in N*m and N*m/(m/s)."""
    loops = {rail: _variant_loop(rail, K, D, vehicle) for rail in Rail}
    stable = {rail: loop.is_stable(relay_gain=K / LAYER_WIDTH) for rail, loop in loops.items()}
    carried = {rail: _carried(loop) for rail, loop in loops.items()}
    existence = loops[Rail.DRY].sliding_existence()
    asked = effective_torque(vehicle)
    listed = "; ".join(
        f"{rail}: {'stable' if stable[rail] else 'UNSTABLE'}, stable up to K = {carried[rail]:.4g} N m" for rail in Rail
    )
    conditions = (
        Condition(
            "the layer is stable behind the actuator",
            f"With the actuator the loop within the layer, a gain K/Phi on s, has no pole right of the axis (Phi = "
            f"{LAYER_WIDTH:g} m/s).",
            all(stable.values()),
            "sampled",
            f"K/Phi = {K / LAYER_WIDTH:.4g} N m/(m/s), exact root counts, bristle model, 100 km/h, published reference "
            f"slip: {listed}. The reaching condition asks K > {asked:.4g} N m.",
        ),
        Condition(
            "the relay slides behind the actuator",
            "With the actuator s of the variant with a relay (sigma-modification) reaches 0 and stays there.",
            existence.exists,
            "symbolic",
            existence.reason,
        ),
    )
    return conditions, _variants_conclusion(conditions, min(carried.values()), asked)


def _variant_loop(rail: Rail, K: float, D: float, vehicle: Vehicle) -> SurfaceLoop:
    loop = published_loop(rail, inertia_scale=vehicle.inertia_scale, vehicle=vehicle)
    return replace(loop, gains=SlidingGains(K=K, D=D, rho=loop.gains.rho))


def _carried(loop: SurfaceLoop) -> float:
    """Largest K, N*m, whose layer is stable; 0 where none is."""
    try:
        per_torque = smallest_layer(loop, K=1.0)
    except DomainError:
        return 0.0
    return LAYER_WIDTH / per_torque if per_torque > 0 else float("inf")


def _variants_conclusion(conditions: tuple[Condition, ...], carried: float, asked: float) -> str:
    if all(one.holds for one in conditions):
        return "With this actuator the layer carries the gain that the reaching condition asks for."
    both = (
        f"The layer carries at most K = {carried:.4g} N m on both rails behind it, while the reaching condition asks "
        f"more than {asked:.4g} N m: no K does both. "
        if carried < asked
        else ""
    )
    return (
        "Proved for torque that acts at once; do not use these variants behind the pneumatic brake. "
        f"{both}A sliding-mode law that has the actuator in it: `railslip verify --law layered`."
    )
