"""What the actuator does to the published law: its conditions, and the conclusion in both readings of the units."""

from __future__ import annotations

from dataclasses import replace

from railslip_ctrl.errors import DomainError
from railslip_ctrl.parameters import AS_PUBLISHED_INERTIA_SCALE, Rail, Vehicle
from railslip_ctrl.sliding.verdict import Condition
from railslip_ctrl.switching import SlidingGains, largest_adaptation
from railslip_ctrl.switching.effects import ActuatorEffect, actuator_effect, conclusion, published_loop


def published_behind_actuator(
    K: float, D: float, vehicle: Vehicle
) -> tuple[tuple[Condition, ...], tuple[ActuatorEffect, ...], str]:
    """Conditions, analyses and conclusion with these gains (N*m, N*m/(m/s)), rho and k as printed.

    Decided at the published reference slip of the bristle model at 100 km/h, by the exact root count and the exact
    limit cycle of the linearised loop.
    """
    effects: list[ActuatorEffect] = []
    quiet: list[str] = []
    for rail in Rail:
        loop = published_loop(rail, inertia_scale=vehicle.inertia_scale, vehicle=vehicle)
        gains = SlidingGains(K=K, D=D, rho=loop.gains.rho, k=loop.gains.k)
        try:
            effects.append(actuator_effect(replace(loop, gains=gains)))
        except DomainError as error:
            quiet.append(f"{rail}: {error}")
    told = f"{conclusion(effects)} {_as_published(D, vehicle)}" if effects else ""
    return tuple(_conditions(effects, quiet)), tuple(effects), told


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


def _conditions(effects: list[ActuatorEffect], quiet: list[str]) -> list[Condition]:
    if not effects:
        return []
    set_of_points = "bristle model, 100 km/h, published reference slip; " + "; ".join(effect.name for effect in effects)
    actuator = effects[0].loop.actuator
    left_out = f" Not analysed: {'; '.join(quiet)}." if quiet else ""
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
            "the limit cycle behind the actuator spares the wheel",
            "The oscillation that takes the place of sliding keeps the slip between 0 and twice the reference.",
            all(effect.holds_the_wheel for effect in effects),
            "sampled",
            f"Limit cycles of the nonlinear wheel over: {set_of_points}. "
            + "; ".join(f"{effect.name}: {effect.cycle_text}" for effect in effects)
            + f".{left_out}",
            claimed=True,
        ),
        Condition(
            "the adaptive loop is stable behind the actuator",
            "With the gain k of the law the linearised adaptive loop has no pole right of the axis.",
            all(effect.unstable_actual == 0 for effect in effects),
            "sampled",
            f"Exact root counts over: {set_of_points}. " + "; ".join(_adaptation(e) for e in effects) + f".{left_out}",
            claimed=True,
        ),
    ]


def _adaptation(effect: ActuatorEffect) -> str:
    return (
        f"{effect.name}: {effect.unstable_actual:g} unstable poles (ideal actuator: {effect.unstable_ideal:g}) at "
        f"k = {effect.loop.gains.k:g}, up to k = {effect.survivors.k:.3g} none"
    )
