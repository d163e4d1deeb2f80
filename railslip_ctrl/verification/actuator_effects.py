"""Effect of lag and dead time on the published law and its robust variants, and the largest stable gains.

The linear loop (`relay_loop`) shows whether a sliding mode exists, and how many poles are unstable. The nonlinear wheel
is simulated (`fixed_step`). A run is lost if the wheel locks or leaves the domain of the adhesion law.
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

_OFFSET = 0.05  # initial slip velocity of a run above the reference slip velocity, relative to the reference
# Settling and measuring time, s, to be multiplied by the inertia scale; about 8 and 5 periods of the relay's cycle
_SETTLING, _MEASURED = 30.0, 20.0
_LONGEST = 60.0  # s, to be multiplied by the inertia scale; longer than any stop
_LEAST_CROSSINGS = 3  # least number of upward zero crossings of s for a period; three enclose two whole periods


def published_loop(
    rail: Rail, *, inertia_scale: float | None = None, adhesion: str = "bristle", vehicle: Vehicle = PARK2008
) -> SurfaceLoop:
    """Return the loop of the published law on a rail, at 100 km/h and the reference slip of the law `adhesion`.

    The gains are those of [Park2008] Table 4, bristle column. `inertia_scale` multiplies M, J, B and the stiffness of a
    dynamic adhesion law; by default it is that of the vehicle.
    """
    if inertia_scale is not None:
        vehicle = vehicle.model_copy(update={"inertia_scale": inertia_scale})
    point = RailAdhesion(adhesion, (rail,)).point(rail, vehicle)
    return SurfaceLoop(linearize(point), PUBLISHED_LAW, vehicle.actuator)


def without_actuator(loop: SurfaceLoop) -> SurfaceLoop:
    """Return the loop with an ideal actuator."""
    return replace(loop, actuator=Actuator(dead_time=0.0, lag=0.0))


def largest_adaptation(loop: SurfaceLoop) -> float:
    """Return the largest adaptation gain k at which the loop without relay is stable; 0 if none, inf without limit."""
    return stable_up_to(lambda k: loop.is_stable(adaptation=k), SLOWEST / loop.regressor_power)


@dataclass(frozen=True)
class Survivors:
    """Limits of each gain for a stable loop with actuator and without relay; the other gains are unchanged.

    - stable: True if the loop without adaptation is stable; if not, k, rho and D are 0.
    - k, rho, D: largest stable values, in 1, 1/s and N*m/(m/s); inf without a limit.
    - layer: smallest half width of the boundary layer, m/s, at which the loop is stable; inf if there is none.
    """

    stable: bool
    k: float
    rho: float
    D: float
    layer: float


def survivors(loop: SurfaceLoop) -> Survivors:
    """Find the limit of each gain by bisection, with exact root counts."""
    gains, stable, gain = loop.gains, loop.is_stable(), loop.largest_relay_gain
    return Survivors(
        stable=stable,
        k=largest_adaptation(loop) if stable else 0.0,
        rho=stable_up_to(lambda rho: loop.with_gains(rho=rho).is_stable(), gains.rho) if stable else 0.0,
        D=gains.D + gain if stable else 0.0,  # a relay gain acts like D
        layer=gains.K / gain if gain > 0 else math.inf,
    )


@dataclass(frozen=True)
class SlipRun:
    """Slip of a run with actuator.

    - slip_range: smallest and largest slip ratio; NaN if the run was lost.
    - in_range: True if the slip stayed between 0 and twice the reference slip.
    - lost: reason if the wheel locked or left the adhesion law's domain, else None.
    - period: time between upward zero crossings of the sliding variable, s; NaN if it does not oscillate.
    """

    slip_range: tuple[float, float]
    in_range: bool
    lost: str | None = None
    period: float = math.nan

    @property
    def amplitude(self) -> float:
        """Amplitude of the slip ratio: half of its range."""
        return 0.5 * (self.slip_range[1] - self.slip_range[0])


def whole_periods(run: FixedRun) -> tuple[float, slice]:
    """Return mean period, s, and slice of whole periods of the sliding variable; NaN if there are fewer than two."""
    s, time = run.s, run.time
    up = np.flatnonzero((s[:-1] <= 0) & (s[1:] > 0))
    if up.size < _LEAST_CROSSINGS:
        return math.nan, slice(None)
    ends = up[[0, -1]]
    instants = time[ends] - s[ends] / (s[ends + 1] - s[ends]) * (time[ends + 1] - time[ends])
    return float((instants[1] - instants[0]) / (up.size - 1)), slice(int(up[0]), int(up[-1]))


def run_behind(loop: SurfaceLoop, *, frozen: bool, duration: float, settling: float = 0.0) -> SlipRun:
    """Simulate the law with actuator and without disturbances; the law's parameters are exact.

    The run starts 5 % above the reference slip velocity. The speed is constant if `frozen` is true, otherwise it falls
    to 5 km/h. The result describes the time after `settling`. `duration` and `settling`, s, are multiplied by
    the inertia scale.
    """
    point, scale = loop.plant.point, loop.plant.point.vehicle.inertia_scale
    started = {"duration": scale * duration, "offset": _OFFSET * point.sigma}
    try:
        run = simulate_behind(point, loop.gains, loop.actuator, frozen=frozen, **started)
    except DomainError as error:
        return SlipRun((math.nan, math.nan), False, str(error))
    late = run.time >= scale * settling
    run = FixedRun(*(one[late] for one in vars(run).values()))
    period, part = whole_periods(run) if settling else (math.nan, slice(None))
    slip = run.sigma[part] / run.speed[part]
    low, high = float(slip.min()), float(slip.max())
    return SlipRun((low, high), low > 0.0 and high < 2.0 * point.slip, None, period)


def relay_cycle(loop: SurfaceLoop) -> SlipRun | None:
    """Simulate the law with relay, without adaptation, at constant speed; None if there is no limit cycle."""
    # K must exceed the torque that the law neglects
    if not (0.0 < loop.largest_relay_gain < math.inf and loop.load < loop.gains.K):
        return None
    still = loop.with_gains(k1=0.0, k2=0.0)
    run = run_behind(still, frozen=True, duration=_SETTLING + _MEASURED, settling=_SETTLING)
    return None if run.lost is None and math.isnan(run.period) else run


@dataclass(frozen=True)
class ActuatorEffect:
    """Effect of lag and dead time on the published law at one operating point.

    - existence, cycle, survivors: results of `SurfaceLoop.sliding_existence`, `relay_cycle` and `survivors`.
    - runs: simulated runs of the law with adaptation, by name.
    - unstable_ideal, unstable_actual: number of unstable poles of the loop with adaptation and without relay; the
      first is without actuator, the second with actuator.
    - unstable_linear: number of unstable poles of the loop with actuator, without adaptation and without relay.
    """

    loop: SurfaceLoop
    existence: Mapping[str, Any]
    cycle: SlipRun | None
    runs: Mapping[str, SlipRun]
    unstable_ideal: float
    unstable_actual: float
    unstable_linear: float
    survivors: Survivors

    @property
    def name(self) -> str:
        point = self.loop.plant.point
        return f"{point.adhesion} {point.rail.value}, inertia x {point.vehicle.inertia_scale:g}"

    @property
    def keeps_slip_in_range(self) -> bool:
        """True if the slip stays in range in the limit cycle; without a cycle, True if the linear loop is stable."""
        return self.unstable_linear == 0 if self.cycle is None else self.cycle.in_range


def actuator_effect(loop: SurfaceLoop) -> ActuatorEffect:
    """Analyse the effect of the actuator on a loop."""
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
    """Decide whether the conditions of the published law hold with the actuator; return conditions and findings.

    K in N*m, D in N*m/(m/s); the other gains are the published ones. The operating points are at 100 km/h and at the
    published reference slips of the bristle model. The finding `as_published` has, for each adhesion law and rail, the
    largest stable k divided by the printed k, with the as-published inertia scale. The finding is empty if the
    vehicle is not the published one, or if a sliding mode exists.
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
    spares = all(one.keeps_slip_in_range for one in effects)
    law_spares = all(run.in_range for one in effects for run in one.runs.values())
    stable = all(one.unstable_actual == 0 for one in effects)
    conditions = (
        Condition("sliding exists behind the actuator", first.existence["exists"], RULE, acting, claimed=True),
        Condition("the relay's own cycle spares the wheel", spares, "simulated", about),
        Condition("the law behind the actuator spares the wheel", law_spares, "simulated", ran, claimed=True),
        Condition("the adaptive loop is stable behind the actuator", stable, points, about, claimed=True),
    )
    return conditions, {"effects": effects, "as_published": ratios}


def variants_behind_actuator(K: float, D: float, vehicle: Vehicle) -> tuple[tuple[Condition, ...], dict[str, Any]]:
    """Decide whether boundary layer and relay work with the actuator; return the conditions and the findings.

    K in N*m, D in N*m/(m/s). Findings: `carried`, the largest K, N*m, with which the boundary layer is stable; `asked`,
    the least K, N*m, with which the reaching condition holds; `all_hold`, True if every condition holds.
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
