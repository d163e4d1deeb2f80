"""What lag and dead time do to the published law and to the robust variants, and what is left of the gains.

theta_hat' = k s phi ([Park2008] (49)) with a constant regressor phi adds (J/r) w int s dt to the torque, with
w = k (Ta^2 + 12.96 omega^2) in SI (published k, units of `relay_loop`). With an ideal actuator and exact feed-forward
s'' + (r/J) D s' + w s = 0: an oscillator that only D damps. With the actuator the integral path costs phase the loop
does not have. The relay enters as a gain N: 0 for excursions far above its height, larger for smaller ones.

A largest K/layer found with k = 0 and a largest k found without relay are no advice: both together may be unstable.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from railslip_ctrl.core.errors import DomainError, UnstableLoopError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.design.catalogue import is_published
from railslip_ctrl.model.vehicle import AS_PUBLISHED_INERTIA_SCALE, INITIAL_SPEED_KMH, PARK2008, Actuator, Rail, Vehicle

from .limit_cycles import (
    LINEAR_CHANGE,
    LimitCycle,
    critical_gains,
    largest_relay_gain,
    law_runs,
    linear_limit_cycle,
    linearisation_change,
    nonlinear_limit_cycle,
    predict_limit_cycle,
    simulated_limit_cycle,
    smallest_layer,
)
from .rails import RailAdhesion
from .relay_loop import TABLE4_SLIDING, SlidingExistence, SurfaceLoop
from .robust import LAYER_WIDTH, effective_torque
from .verdict import RULE, Condition, checked_at

_RATIO = 1.2  # steps in which a gain is raised until the loop is lost; the limit is then bisected
_STEPS = 76  # up to a factor of 1e6, beyond which a limit is none
_TOLERANCE = 1e-9  # relative, of the bisection: far above the rounding of the root count
SLIP_AMPLITUDE = 0.02  #: half of the slip's swing, a ratio, within which a relay is to hold the wheel
_FIRST = 1e-4  # 1/s^2, the adaptation's k |phi|^2 tried first: an oscillation with a period of 10 minutes
_RELAY_SAMPLES = 11  # relay gains tried between 0 and the limit cycle's, for the most favourable


def without_actuator(loop: SurfaceLoop) -> SurfaceLoop:
    """The same loop with an ideal actuator."""
    return replace(loop, actuator=Actuator(dead_time=0.0, lag=0.0))


def adaptive_unstable_poles(loop: SurfaceLoop) -> float:
    """Poles in the closed right half plane of the loop with its adaptation k, exactly counted."""
    return loop.linear_loop(adaptation=loop.gains.k).unstable_closed_loop_poles


def first_limit(stable: Callable[[float], bool], start: float) -> float:
    """Smallest value above `start` (> 0) at which `stable` is lost, bisected to 1e-9; inf beyond 1e6 start.

    Raised in steps of 20 %: an unstable interval narrower than that may be passed over. UnstableLoopError where the
    loop is not stable at the start.
    """
    if not stable(start):
        raise UnstableLoopError(
            f"largest gain: the loop is unstable at {start:.6g}, where the search starts; start where it is stable",
            unstable_poles=math.nan,
            stabilizing_gain_range=None,
        )
    low = start
    for _ in range(_STEPS):
        high = low * _RATIO
        if not stable(high):
            break
        low = high
    else:
        return math.inf
    return _bisected(stable, low, high, _TOLERANCE)


def _bisected(holds: Callable[[float], bool], low: float, high: float, tolerance: float) -> float:
    """Largest value between `low`, where it holds, and `high`, where it does not, to a relative tolerance."""
    while high - low > tolerance * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def largest_adaptation(loop: SurfaceLoop) -> float:
    """Largest k, as printed, with which the loop is stable without relay; inf without bound, 0 where it never is."""
    start = _FIRST / loop.regressor_power
    return first_limit(lambda k: loop.is_stable(adaptation=k), start) if loop.is_stable(adaptation=start) else 0.0


def survivable_excursion(loop: SurfaceLoop) -> float:
    """Amplitude of s, m/s, up to which the adaptive loop with its relay comes back, by the describing function.

    inf where the linear loop with its k is stable without the relay's help; 0 where no relay gain (sampled) helps.
    """

    def helps(relay_gain: float) -> bool:
        return loop.is_stable(relay_gain=relay_gain, adaptation=loop.gains.k)

    if helps(0.0):
        return math.inf
    top = max((c.gain for c in critical_gains(loop) if c.stable_below), default=0.0)
    helped = next(filter(helps, np.linspace(0.0, top, _RELAY_SAMPLES).tolist()), None)
    if helped is None:
        return 0.0
    return 4 * loop.gains.K / (math.pi * _bisected(lambda gain: not helps(gain), 0.0, helped, _TOLERANCE))


@dataclass(frozen=True)
class Survivors:
    """The largest gains that survive the actuator, each with the others as they are and the relay as a gain of 0.

    stable: whether the linear part (rho, D, feed-forward) is stable at all; if not, the largest gains are 0. K: N*m,
    for a limit cycle within `SLIP_AMPLITUDE`, linearised, without load, which makes it smaller; 0 where no K gives a
    stable cycle, inf where none oscillates; linear_change: `linearisation_change` over that amplitude. k; rho, 1/s; D,
    N*m/(m/s); relay_gain: largest that may replace the relay, N*m/(m/s); layer: smallest without limit cycle at the
    gains' own K, m/s; inf where there is no bound, or no layer. excursion: see `survivable_excursion`, m/s.
    """

    stable: bool
    k: float
    K: float
    linear_change: float
    rho: float
    D: float
    relay_gain: float
    layer: float
    excursion: float


def survivors(loop: SurfaceLoop) -> Survivors:
    """Bisect each gain on exact stability; K by the linearised limit cycle within a slip amplitude."""
    gains, stable, gain = loop.gains, loop.is_stable(), largest_relay_gain(loop)
    # without a finite gain at which it starts there is no cycle: nothing to bound, or nothing that is stable
    relay = SLIP_AMPLITUDE / linear_limit_cycle(loop, K=1.0).slip_amplitude if 0.0 < gain < math.inf else gain
    finite = 0.0 < relay < math.inf
    return Survivors(
        stable=stable,
        k=largest_adaptation(loop),
        K=relay,
        linear_change=linearisation_change(loop, linear_limit_cycle(loop, K=relay)) if finite else 0.0,
        rho=first_limit(lambda rho: loop.with_gains(rho=rho).is_stable(), gains.rho) if stable else 0.0,
        D=first_limit(lambda D: loop.with_gains(D=D).is_stable(), gains.D) if stable else 0.0,
        relay_gain=gain,
        layer=gains.K / gain if gain > 0 else math.inf,
        excursion=survivable_excursion(loop),
    )


# --- the effect at one operating point --------------------------------------------------------------------------------


COMPARED_RELAYS = (70.0, 200.0, 400.0)
"""K, N*m: Table 4's, and what it takes to carry disturbances of the size the paper simulates."""


def published_loop(
    rail: Rail,
    *,
    inertia_scale: float = 1.0,
    adhesion: str = "bristle",
    speed_kmh: float = INITIAL_SPEED_KMH,
    vehicle: Vehicle = PARK2008,
) -> SurfaceLoop:
    """The published law's loop on a rail at the reference slip of the bristle, curve or beam law.

    `inertia_scale` is a factor on M, J, B and the stiffness of the bristle model. Its gains are Table 4's bristle
    column (beam for the beam law).
    """
    scaled = vehicle.model_copy(update={"inertia_scale": inertia_scale})
    plant = RailAdhesion(adhesion, (rail,)).plants(scaled, speed_kmh=speed_kmh)[rail]
    column = TABLE4_SLIDING["beam" if adhesion == "beam" else "bristle"]
    return SurfaceLoop(plant, column, scaled.actuator)


@dataclass(frozen=True)
class RelayCycle:
    """The limit cycle for one K, with the load the law leaves out.

    predicted, linear: of the linearised loop, by describing function and with every harmonic; linear_change: see
    `linearisation_change`; actual: of the wheel with its adhesion curve, adaptation off and speed frozen; where it
    leaves 0 to v, as simulated; None where the wheel is lost.
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

    cycles: one for each K compared that has one, ascending; unstable_ideal, unstable_actual: right-half-plane poles of
    the adaptive loop without and with actuator, the relay as a gain of 0; unstable_linear: with it, no adaptation.
    """

    loop: SurfaceLoop
    existence: SlidingExistence
    cycles: tuple[RelayCycle, ...]
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
    def own_cycle(self) -> RelayCycle | None:
        """The cycle with the gains' own K, where there is one."""
        return self.cycles[0] if self.cycles and self.cycles[0].linear.K == self.loop.gains.K else None

    @property
    def holds_the_wheel(self) -> bool:
        """Whether the cycle with the gains' own K, adaptation off, keeps the slip between 0 and twice the reference.

        Without a cycle: whether the loop is stable about its rest.
        """
        cycle = self.own_cycle
        if cycle is None:
            return self.unstable_linear == 0
        low, high = cycle.actual.sigma_range if cycle.actual is not None else (-math.inf, math.inf)
        return low > 0.0 and high < 2 * self.loop.plant.point.sigma


def actuator_effect(loop: SurfaceLoop) -> ActuatorEffect:
    """Analyse one loop."""
    relays = (loop.gains.K, *(K for K in COMPARED_RELAYS if K > loop.gains.K))
    return ActuatorEffect(
        loop=loop,
        existence=loop.sliding_existence(),
        cycles=_relay_cycles(loop, relays),
        unstable_ideal=adaptive_unstable_poles(without_actuator(loop)),
        unstable_actual=adaptive_unstable_poles(loop),
        unstable_linear=adaptive_unstable_poles(loop.with_gains(k=0.0)),
        survivors=survivors(loop),
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


# --- the published law behind the actuator ----------------------------------------------------------------------------


@dataclass(frozen=True)
class PublishedBehind:
    """What is concluded of the published law from beside the verdicts; see `report.verification`.

    as_published: largest k that is stable over the printed one in the as-published reading, by adhesion and rail, the
    relay's help left out; empty where nothing is published of the vehicle.
    """

    effects: tuple[ActuatorEffect, ...]
    as_published: Mapping[str, float]

    @property
    def accuracy(self) -> tuple[float, float] | None:
        """Largest errors of the describing function, of period and amplitude, shares, where the linearisation holds."""
        cycles = [cycle for effect in self.effects for cycle in effect.cycles]
        errors = [
            (abs(cycle.period_error), abs(cycle.amplitude_error))
            for cycle in cycles
            if cycle.actual is not None and cycle.linear_holds
        ]
        return (max(one for one, _ in errors), max(one for _, one in errors)) if errors else None


def published_behind_actuator(K: float, D: float, vehicle: Vehicle) -> tuple[tuple[Condition, ...], PublishedBehind]:
    """Conditions, and what is concluded from, with these gains (N*m, N*m/(m/s)), rho and k as printed.

    At the published reference slip of the bristle model at 100 km/h.
    """
    effects = tuple(actuator_effect(_loop(rail, K, D, vehicle)) for rail in Rail)
    ratios = {}
    if is_published(vehicle) and not effects[0].existence.exists:
        for adhesion, rail in product(("bristle", "curve"), Rail):
            scale: dict[str, Any] = {"inertia_scale": AS_PUBLISHED_INERTIA_SCALE, "vehicle": vehicle}
            loop = published_loop(rail, adhesion=adhesion, **scale).with_gains(D=D)
            ratios[f"{adhesion} {rail}"] = largest_adaptation(loop) / loop.gains.k
    found = PublishedBehind(effects, ratios)
    return _conditions(effects), found


def _loop(rail: Rail, K: float, D: float, vehicle: Vehicle, *, speed_kmh: float = INITIAL_SPEED_KMH) -> SurfaceLoop:
    loop = published_loop(rail, inertia_scale=vehicle.inertia_scale, vehicle=vehicle, speed_kmh=speed_kmh)
    return loop.with_gains(K=K, D=D)


def _conditions(effects: tuple[ActuatorEffect, ...]) -> tuple[Condition, ...]:
    first, about = effects[0], {"effects": effects}
    actuator, gains = first.loop.actuator, first.loop.gains
    runs = {effect.name: law_runs(effect.loop) for effect in effects}
    slides = all(effect.existence.exists for effect in effects)
    spares = all(effect.holds_the_wheel for effect in effects)
    law_spares = all(one.held for pair in runs.values() for one in pair.values())
    stable = all(effect.unstable_actual == 0 for effect in effects)
    acting = {"dead_time": actuator.dead_time, "lag": actuator.lag, "existence": first.existence}
    ran = {"runs": runs, "K": gains.K, "k": gains.k}
    return (
        Condition("sliding exists behind the actuator", slides, RULE, acting, claimed=True),
        Condition("the relay's own cycle spares the wheel", spares, checked_at(len(effects)), about),
        Condition("the law behind the actuator spares the wheel", law_spares, "simulated", ran, claimed=True),
        Condition(
            "the adaptive loop is stable behind the actuator", stable, checked_at(len(effects)), about, claimed=True
        ),
    )


# --- the robust variants behind the actuator --------------------------------------------------------------------------


@dataclass(frozen=True)
class VariantsBehind:
    """Largest K, N*m, whose layer is stable on both rails; what the reaching condition asks; whether all holds."""

    carried: float
    asked: float
    all_hold: bool


def variants_behind_actuator(K: float, D: float, vehicle: Vehicle) -> tuple[tuple[Condition, ...], VariantsBehind]:
    """The conditions of layer and relay behind the actuator, and what is concluded from; gains in N*m, N*m/(m/s)."""
    loops = {rail: _loop(rail, K, D, vehicle).with_gains(k=0.0) for rail in Rail}
    stable = {rail: loop.is_stable(relay_gain=K / LAYER_WIDTH) for rail, loop in loops.items()}
    carried = {rail: _carried(loop) for rail, loop in loops.items()}
    existence = loops[Rail.DRY].sliding_existence()
    asked = effective_torque(vehicle)
    numbers = {"K": K, "layer": LAYER_WIDTH, "stable": stable, "carried": carried, "asked": asked}
    conditions = (
        Condition("the layer is stable behind the actuator", all(stable.values()), checked_at(len(stable)), numbers),
        Condition("the relay slides behind the actuator", existence.exists, RULE, {"existence": existence}),
    )
    all_hold = all(one.holds for one in conditions)
    return conditions, VariantsBehind(min(carried.values()), asked, all_hold)


def _carried(loop: SurfaceLoop) -> float:
    """Largest K, N*m, whose layer is stable; 0 where none is."""
    try:
        per_torque = smallest_layer(loop, K=1.0)
    except DomainError:
        return 0.0
    return LAYER_WIDTH / per_torque if per_torque > 0 else math.inf
