"""What the actuator does to the published law: its conditions, and the conclusion in both readings of the units."""

from __future__ import annotations

import math
from dataclasses import replace

from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.vehicle import AS_PUBLISHED_INERTIA_SCALE, INITIAL_SPEED_KMH, Rail, Vehicle
from railslip_ctrl.simulation.catalogue import is_published
from railslip_ctrl.verification.switching import SlidingGains, SurfaceLoop, joint_advice, largest_adaptation, law_runs
from railslip_ctrl.verification.switching.effects import ActuatorEffect, actuator_effect, conclusion, published_loop
from railslip_ctrl.verification.verdict import Condition

SPEEDS_KMH = (5.0, 10.0, 20.0, 40.0, 60.0, 80.0, 100.0)
"""Where the stability of a stop is decided, here and for the layered law."""

POINTS = f"{SPEEDS_KMH[0]:g} to {SPEEDS_KMH[-1]:g} km/h, dry and wet, empty and loaded"


def published_behind_actuator(
    K: float, D: float, vehicle: Vehicle
) -> tuple[tuple[Condition, ...], tuple[ActuatorEffect, ...], str]:
    """Conditions, analyses and conclusion with these gains (N*m, N*m/(m/s)), rho and k as printed.

    Decided at the published reference slip of the bristle model at 100 km/h, by the exact root count, the exact limit
    cycle of the linearised loop and simulation of the whole law; the advice over the whole stop.
    """
    effects = tuple(actuator_effect(_loop(rail, K, D, vehicle)) for rail in Rail)
    advice = joint_advice(stop_loops(K, D, vehicle))
    told = conclusion(effects, advice, POINTS)
    if is_published(vehicle) and not effects[0].existence.exists:  # of another vehicle nothing is published
        told = f"{told} {_as_published(D, vehicle)}"
    return tuple(_conditions(effects)), effects, told


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
    loop = published_loop(rail, inertia_scale=vehicle.inertia_scale, vehicle=vehicle, speed=speed_kmh * KMH)
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
