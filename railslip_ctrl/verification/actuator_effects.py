"""What lag and dead time do to the published law and to the robust variants, and what is left of the gains.

The linear half is `relay_loop`: whether sliding exists, exact root counts, and the largest gains, each alone. A largest
K/layer found with k = 0 and a largest k found without relay are no advice: both together may be unstable. The relay
enters the adaptive loop as a gain: 0 for excursions far above its height, larger for smaller ones. What the nonlinear
wheel does is simulated (`fixed_step`); where it locks or leaves its adhesion law's domain it is lost.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from railslip_ctrl.core.errors import DomainError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH
from railslip_ctrl.design.catalogue import is_published
from railslip_ctrl.model.linearization import linearize
from railslip_ctrl.model.vehicle import AS_PUBLISHED_INERTIA_SCALE, PARK2008, Actuator, Rail, Vehicle
from railslip_ctrl.sliding.law import PUBLISHED_LAW

from .fixed_step import FixedRun, simulate_behind
from .rails import RailAdhesion
from .relay_loop import SLOWEST, SurfaceLoop, stable_up_to
from .robust import LAYER_WIDTH, effective_torque
from .verdict import RULE, Condition, checked_at

_OFFSET = 0.05  # of the reference, where runs start above it
_SETTLING, _MEASURED = 30.0, 20.0  # s, times the inertia scale: some 8 and 5 periods of the relay's cycle
_LONGEST = 60.0  # s, times the inertia scale: longer than any stop
_LEAST_CROSSINGS = 3  # upward crossings of s that make two periods


def published_loop(
    rail: Rail, *, inertia_scale: float | None = None, adhesion: str = "bristle", vehicle: Vehicle = PARK2008
) -> SurfaceLoop:
    """The published law's loop on a rail at 100 km/h and the law's reference slip, with Table 4's bristle column.

    `inertia_scale` is a factor on M, J, B and the stiffness of the bristle model; left out, the vehicle's.
    """
    if inertia_scale is not None:
        vehicle = vehicle.model_copy(update={"inertia_scale": inertia_scale})
    point = RailAdhesion(adhesion, (rail,)).point(rail, vehicle)
    return SurfaceLoop(linearize(point), PUBLISHED_LAW, vehicle.actuator)


def without_actuator(loop: SurfaceLoop) -> SurfaceLoop:
    """The same loop with an ideal actuator."""
    return replace(loop, actuator=Actuator(dead_time=0.0, lag=0.0))


# --- what is left of the gains ----------------------------------------------------------------------------------------


def largest_adaptation(loop: SurfaceLoop) -> float:
    """Largest k, as printed, with which the loop is stable without relay; inf without bound, 0 where none is."""
    return stable_up_to(lambda k: loop.is_stable(adaptation=k), SLOWEST / loop.regressor_power)


@dataclass(frozen=True)
class Survivors:
    """The largest gains that survive the actuator, each with the others as they are and the relay as a gain of 0.

    stable: whether the linear part (rho, D, feed-forward) is stable at all; if not, the largest gains are 0. k; rho,
    1/s; D, N*m/(m/s); layer: smallest without limit cycle at the gains' own K, m/s; inf where there is no bound, or no
    layer.
    """

    stable: bool
    k: float
    rho: float
    D: float
    layer: float


def survivors(loop: SurfaceLoop) -> Survivors:
    """Bisect each gain on exact stability."""
    gains, stable, gain = loop.gains, loop.is_stable(), loop.largest_relay_gain
    return Survivors(
        stable=stable,
        k=largest_adaptation(loop) if stable else 0.0,
        rho=stable_up_to(lambda rho: loop.with_gains(rho=rho).is_stable(), gains.rho) if stable else 0.0,
        D=gains.D + gain if stable else 0.0,  # a relay gain is a D
        layer=gains.K / gain if gain > 0 else math.inf,
    )


# --- runs -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class HeldRun:
    """Whether a run held the wheel: the slip stayed between 0 and twice the reference; NaN where it is `lost`, and how.

    amplitude, period: half of the slip's swing, and s between upward crossings of 0 by s; NaN where it does not cycle.
    """

    slip_range: tuple[float, float]
    held: bool
    lost: str | None = None
    period: float = math.nan

    @property
    def amplitude(self) -> float:
        """Half of the slip's swing, a ratio."""
        return 0.5 * (self.slip_range[1] - self.slip_range[0])


def whole_periods(run: FixedRun) -> tuple[float, slice]:
    """Period of s, s, and the part of a run from its first to its last upward crossing of 0; NaN without three."""
    s, time = run.s, run.time
    up = np.flatnonzero((s[:-1] <= 0) & (s[1:] > 0))
    if up.size < _LEAST_CROSSINGS:
        return math.nan, slice(None)
    ends = up[[0, -1]]
    instants = time[ends] - s[ends] / (s[ends + 1] - s[ends]) * (time[ends + 1] - time[ends])
    return float((instants[1] - instants[0]) / (up.size - 1)), slice(int(up[0]), int(up[-1]))


def run_behind(loop: SurfaceLoop, *, frozen: bool, duration: float, settling: float = 0.0) -> HeldRun:
    """The law from 5 % above the reference, undisturbed, parameters known; times in s, before the inertia scale.

    The speed is frozen, or falls to 5 km/h. The range is that from `settling` on, over whole periods where s cycles.
    """
    point, scale = loop.plant.point, loop.plant.point.vehicle.inertia_scale
    started = {"duration": scale * duration, "offset": _OFFSET * point.sigma}
    try:
        run = simulate_behind(point, loop.gains, loop.actuator, frozen=frozen, **started)
    except DomainError as error:
        return HeldRun((math.nan, math.nan), False, str(error))
    late = run.time >= scale * settling
    run = FixedRun(*(one[late] for one in vars(run).values()))
    period, part = whole_periods(run) if settling else (math.nan, slice(None))
    slip = run.sigma[part] / run.speed[part]
    low, high = float(slip.min()), float(slip.max())
    return HeldRun((low, high), low > 0.0 and high < 2.0 * point.slip, None, period)


def relay_cycle(loop: SurfaceLoop) -> HeldRun | None:
    """The relay's own cycle, adaptation off and speed frozen; None where it has none, or does not carry the load."""
    if not (0.0 < loop.largest_relay_gain < math.inf and loop.load < loop.gains.K):
        return None
    still = loop.with_gains(k1=0.0, k2=0.0)
    run = run_behind(still, frozen=True, duration=_SETTLING + _MEASURED, settling=_SETTLING)
    return None if run.lost is None and math.isnan(run.period) else run


# --- the published law behind the actuator ----------------------------------------------------------------------------


@dataclass(frozen=True)
class ActuatorEffect:
    """What lag and dead time do to the published law at one operating point.

    cycle: `relay_cycle` with the gains' own K; runs: of the whole law, by name; unstable_ideal, unstable_actual: poles
    right of the axis of the adaptive loop without and with actuator, the relay as a gain of 0; unstable_linear: with
    it, no adaptation.
    """

    loop: SurfaceLoop
    existence: Mapping[str, Any]
    cycle: HeldRun | None
    runs: Mapping[str, HeldRun]
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
        """Whether the relay's own cycle does; without one, whether the loop is stable about its rest."""
        return self.unstable_linear == 0 if self.cycle is None else self.cycle.held


def actuator_effect(loop: SurfaceLoop) -> ActuatorEffect:
    """Analyse one loop."""
    k = loop.gains.k1
    return ActuatorEffect(
        loop=loop,
        existence=loop.sliding_existence(),
        cycle=relay_cycle(loop),
        runs={
            f"{loop.plant.point.speed / KMH:.3g} km/h frozen": run_behind(loop, frozen=True, duration=_LONGEST),
            "speed falling": run_behind(loop, frozen=False, duration=_LONGEST),
        },
        unstable_ideal=without_actuator(loop).unstable_poles(adaptation=k),
        unstable_actual=loop.unstable_poles(adaptation=k),
        unstable_linear=loop.unstable_poles(),
        survivors=survivors(loop),
    )


def published_behind_actuator(K: float, D: float, vehicle: Vehicle) -> tuple[tuple[Condition, ...], dict[str, Any]]:
    """Conditions, and what is concluded from, with these gains (N*m, N*m/(m/s)), rho and k as printed.

    At the published reference slip of the bristle model at 100 km/h. as_published: largest k that is stable over the
    printed one in the as-published reading, by adhesion and rail, the relay's help left out; empty where nothing is
    published of the vehicle.
    """
    effects = tuple(actuator_effect(published_loop(rail, vehicle=vehicle).with_gains(K=K, D=D)) for rail in Rail)
    first, about, points = effects[0], {"effects": effects}, checked_at(len(effects))
    ratios = {}
    if is_published(vehicle) and not first.existence["exists"]:
        for adhesion, rail in product(("bristle", "curve"), Rail):
            scaled = published_loop(
                rail, adhesion=adhesion, inertia_scale=AS_PUBLISHED_INERTIA_SCALE, vehicle=vehicle
            ).with_gains(D=D)
            ratios[f"{adhesion} {rail}"] = largest_adaptation(scaled) / scaled.gains.k1
    acting = {**first.existence, "existence": first.existence}
    ran = {"runs": {one.name: one.runs for one in effects}, "K": K, "k": first.loop.gains.k1}
    spares = all(one.holds_the_wheel for one in effects)
    law_spares = all(run.held for one in effects for run in one.runs.values())
    stable = all(one.unstable_actual == 0 for one in effects)
    conditions = (
        Condition("sliding exists behind the actuator", first.existence["exists"], RULE, acting, claimed=True),
        Condition("the relay's own cycle spares the wheel", spares, "simulated", about),
        Condition("the law behind the actuator spares the wheel", law_spares, "simulated", ran, claimed=True),
        Condition("the adaptive loop is stable behind the actuator", stable, points, about, claimed=True),
    )
    return conditions, {"effects": effects, "as_published": ratios}


# --- the robust variants behind the actuator --------------------------------------------------------------------------


def variants_behind_actuator(K: float, D: float, vehicle: Vehicle) -> tuple[tuple[Condition, ...], dict[str, Any]]:
    """The conditions of layer and relay behind the actuator, and what is concluded from; gains in N*m, N*m/(m/s).

    carried: largest K, N*m, whose layer is stable, by rail, and on both; asked: what the reaching condition asks.
    """
    loops = {rail: published_loop(rail, vehicle=vehicle).with_gains(K=K, D=D) for rail in Rail}
    stable = {rail: loop.is_stable(relay_gain=K / LAYER_WIDTH) for rail, loop in loops.items()}
    carried = {rail: LAYER_WIDTH * loop.largest_relay_gain for rail, loop in loops.items()}
    existence, asked = loops[Rail.DRY].sliding_existence(), effective_torque(vehicle)
    numbers = {"K": K, "layer": LAYER_WIDTH, "stable": stable, "carried": carried, "asked": asked}
    conditions = (
        Condition("the layer is stable behind the actuator", all(stable.values()), checked_at(len(stable)), numbers),
        Condition("the relay slides behind the actuator", existence["exists"], RULE, {"existence": existence}),
    )
    all_hold = all(one.holds for one in conditions)
    return conditions, {"carried": min(carried.values()), "asked": asked, "all_hold": all_hold}
