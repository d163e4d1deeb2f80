"""The conditions of the sliding-mode law together with what the actuator does to them: what `railslip verify` shows.

`sliding` decides the conditions for an actuator that acts at once, as the paper's proof assumes; `switching` analyses
the loop that lag and dead time really close. Here the second joins the first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from .errors import DomainError
from .parameters import PARK2008, Rail, Vehicle
from .sliding.conditions import Condition, Verification, verify
from .sliding.robust import LAYER_WIDTH
from .switching import SlidingGains
from .switching.effects import ActuatorEffect, actuator_effect, conclusion, published_loop

Law = Literal["paper", "robust"]


@dataclass(frozen=True)
class FullVerification:
    """The conditions, with and without the actuator, and what an engineer may conclude (empty for the variants)."""

    verification: Verification
    effects: tuple[ActuatorEffect, ...]
    conclusion: str


def verify_with_actuator(
    *,
    law: Law = "paper",
    vehicle: Vehicle = PARK2008,
    K: float | None = None,
    D: float | None = None,
    seed: int = 2008,
) -> FullVerification:
    """Decide every condition of the law; for the published one also behind the actuator, dry and wet, 100 km/h.

    Arguments as of `sliding.conditions.verify`. The actuator's conditions are decided at the published reference
    slip of the bristle model, by the exact root count and the exact limit cycle of the linearised loop.
    """
    ideal = verify(law=law, vehicle=vehicle, K=K, D=D, seed=seed)
    if law != "paper":
        return FullVerification(ideal, (), _warning(ideal, vehicle))
    effects: list[ActuatorEffect] = []
    quiet: list[str] = []
    for rail in Rail:
        loop = published_loop(rail, inertia_scale=vehicle.inertia_scale, vehicle=vehicle)
        gains = SlidingGains(K=ideal.K, D=ideal.D, rho=loop.gains.rho, k=loop.gains.k)
        try:
            effects.append(actuator_effect(replace(loop, gains=gains)))
        except DomainError as error:
            quiet.append(f"{rail}: {error}")
    conditions = (*ideal.conditions, *_conditions(effects, quiet))
    told = conclusion(effects) if effects else ""
    return FullVerification(replace(ideal, conditions=conditions), tuple(effects), told)


def _warning(ideal: Verification, vehicle: Vehicle) -> str:
    """What the actuator leaves of the robust variants, which are proved for torque that acts at once."""
    slope = ideal.K / LAYER_WIDTH
    verdicts = []
    for rail in Rail:
        loop = published_loop(rail, inertia_scale=vehicle.inertia_scale, vehicle=vehicle)
        linear = replace(loop, gains=SlidingGains(K=0.0, D=ideal.D, rho=loop.gains.rho))
        verdicts.append(f"{rail}: {'stable' if linear.is_stable(relay_gain=slope) else 'UNSTABLE'}")
    return (
        "These variants are proved for torque that acts at once. Behind the actuator the layer is a gain of K/Phi = "
        f"{slope:.4g} N*m/(m/s) on s, and by the exact root count the linearised loop with it is {', '.join(verdicts)} "
        "(bristle model, 100 km/h). The design that accounts for the actuator is designs/asmc_robust.py."
    )


def _conditions(effects: list[ActuatorEffect], quiet: list[str]) -> list[Condition]:
    if not effects:
        return []
    set_of_points = "bristle model, 100 km/h, published reference slip; " + "; ".join(effect.name for effect in effects)
    left_out = f" Not analysed: {'; '.join(quiet)}." if quiet else ""
    return [
        Condition(
            "sliding exists behind the actuator",
            "With dead time 0.15 s and lag 0.6 s between command and torque, s reaches 0 and stays there.",
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
            f"Exact limit cycles over: {set_of_points}. " + "; ".join(_cycle(e) for e in effects) + f".{left_out}",
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


def _cycle(effect: ActuatorEffect) -> str:
    cycle = effect.cycles[0].exact
    return (
        f"{effect.name}: period {cycle.period:.3g} s, slip amplitude {cycle.slip_amplitude:.3g} at K = {cycle.K:g} N m"
    )


def _adaptation(effect: ActuatorEffect) -> str:
    return (
        f"{effect.name}: {effect.unstable_actual:g} unstable poles (ideal actuator: {effect.unstable_ideal:g}) at "
        f"k = {effect.loop.gains.k:g}, up to k = {effect.survivors.k:.3g} none"
    )
