"""One verification of a law, conditions without and with the actuator in it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

from railslip_ctrl.errors import InputError
from railslip_ctrl.parameters import PARK2008, Vehicle
from railslip_ctrl.sliding.conditions import LARGEST_GAIN, Verification, check_arguments, verify
from railslip_ctrl.sliding.gains import PUBLISHED_LAW
from railslip_ctrl.switching.effects import ActuatorEffect

from .layered_conditions import verify_layered
from .published import published_behind_actuator
from .variants import variants_behind_actuator

Law = Literal["paper", "robust", "layered"]


@dataclass(frozen=True)
class FullVerification:
    """All conditions, the analyses behind those of the published law, and what an engineer may conclude."""

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
    """Decide every condition of a law, the actuator's included, on dry and wet rail at 100 km/h.

    Parameters
    ----------
    law : str
        "paper" and "robust" as of `sliding.conditions.verify`; "layered": the design that accounts for the actuator
        (`switching.layered`), tuned for the vehicle.
    vehicle, K, D, seed
        As of `sliding.conditions.verify`. K of the layered law is its authority, > 0, 1.05 times what its bound
        and a holding torque known to 10 % ask for if left out; it has no D.

    Raises
    ------
    InputError
        A value outside its range, or D for the layered law.
    """
    if law not in get_args(Law):
        raise InputError(f"law: {law!r} is not known; choose one of {', '.join(get_args(Law))}")
    if law == "layered":
        if D is not None:
            raise InputError(f"D: {D:g} is not allowed; the layered law has no D, leave it out")
        check_arguments(vehicle, K, None, seed)
        if K == 0.0:
            raise InputError(
                f"K: 0 is not allowed; the layered law takes a value > 0 up to {LARGEST_GAIN:g} (N*m), or leave it out"
            )
        return FullVerification(*verify_layered(vehicle, K=K, seed=seed))
    ideal = verify(law=law, vehicle=vehicle, K=K, D=D, seed=seed)
    damping = PUBLISHED_LAW.D if D is None else D
    if law == "robust":
        found, told = variants_behind_actuator(ideal.K, damping, vehicle)
        effects: tuple[ActuatorEffect, ...] = ()
    else:
        found, effects, told = published_behind_actuator(ideal.K, damping, vehicle)
    return FullVerification(replace(ideal, conditions=(*ideal.conditions, *found)), effects, told)
