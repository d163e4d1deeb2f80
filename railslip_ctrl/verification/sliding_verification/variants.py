"""What the actuator leaves of the robust variants, which are proved for torque that acts at once."""

from __future__ import annotations

from dataclasses import replace

from railslip_ctrl.core.errors import DomainError
from railslip_ctrl.model.vehicle import Rail, Vehicle
from railslip_ctrl.verification.robust import LAYER_WIDTH, effective_torque
from railslip_ctrl.verification.switching import SlidingGains
from railslip_ctrl.verification.switching.effects import published_loop
from railslip_ctrl.verification.switching.limit_cycle import smallest_layer
from railslip_ctrl.verification.switching.surface_loop import SurfaceLoop
from railslip_ctrl.verification.verdict import Condition


def variants_behind_actuator(K: float, D: float, vehicle: Vehicle) -> tuple[tuple[Condition, ...], str]:
    """The conditions of layer and relay behind the actuator, and the conclusion; gains in N*m and N*m/(m/s)."""
    loops = {rail: _loop(rail, K, D, vehicle) for rail in Rail}
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
    return conditions, _conclusion(conditions, min(carried.values()), asked)


def _loop(rail: Rail, K: float, D: float, vehicle: Vehicle) -> SurfaceLoop:
    loop = published_loop(rail, inertia_scale=vehicle.inertia_scale, vehicle=vehicle)
    return replace(loop, gains=SlidingGains(K=K, D=D, rho=loop.gains.rho))


def _carried(loop: SurfaceLoop) -> float:
    """Largest K, N*m, whose layer is stable; 0 where none is."""
    try:
        per_torque = smallest_layer(loop, K=1.0)
    except DomainError:
        return 0.0
    return LAYER_WIDTH / per_torque if per_torque > 0 else float("inf")


def _conclusion(conditions: tuple[Condition, ...], carried: float, asked: float) -> str:
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
