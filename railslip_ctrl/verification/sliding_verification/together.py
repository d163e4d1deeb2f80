"""One verification of a law, conditions without and with the actuator in it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

from railslip_ctrl.core.arguments import number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.model.vehicle import PARK2008, Vehicle
from railslip_ctrl.sliding.gains import PUBLISHED_LAW
from railslip_ctrl.verification.conditions import LARGEST_GAIN, Verification, check_arguments, verify
from railslip_ctrl.verification.switching.effects import ActuatorEffect

from .layered_conditions import verify_layered
from .published import published_behind_actuator
from .rail_adhesion import PUBLISHED_ADHESION, RailAdhesion
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
    adhesion: RailAdhesion = PUBLISHED_ADHESION,
    ki_min: float | None = None,
) -> FullVerification:
    """Decide every condition of a law, the actuator's included, from 100 km/h on.

    Parameters
    ----------
    law : str
        "paper" and "robust" as of `sliding.conditions.verify`; "layered": the design that accounts for the actuator
        (`switching.layered`), tuned for the vehicle.
    vehicle, K, D, seed
        As of `sliding.conditions.verify`. K of the layered law is its authority, > 0, 1.05 times what its bound
        and a holding torque known to 10 % ask for if left out; it has no D.
    adhesion : RailAdhesion
        Law, rails and reference slip of the layered law. The others are verified for the published bristle model on
        dry and wet rail alone.
    ki_min : float, optional
        Least integral gain of the layered law, N*m/m, > 0; left out, 100 times the inertia scale. The others have none.

    Raises
    ------
    InputError
        A value outside its range, D for the layered law, another adhesion or a `ki_min` for the other laws, or an
        adhesion without a reference slip.
    DomainError, KinkError
        A reference slip at which the adhesion law does not hold, or cannot be linearised.
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
        if ki_min is not None:
            number("ki_min", ki_min, "N*m/m", gt=0)
        return FullVerification(*verify_layered(vehicle, adhesion, K=K, seed=seed, ki_min=ki_min))
    if ki_min is not None:
        raise InputError(f"ki_min: {ki_min:g} is not allowed; the law {law!r} is not tuned, leave it out")
    _check_bristle(law, adhesion)
    ideal = verify(law=law, vehicle=vehicle, K=K, D=D, seed=seed)
    damping = PUBLISHED_LAW.D if D is None else D
    if law == "robust":
        found, told = variants_behind_actuator(ideal.K, damping, vehicle)
        effects: tuple[ActuatorEffect, ...] = ()
    else:
        found, effects, told = published_behind_actuator(ideal.K, damping, vehicle)
    return FullVerification(replace(ideal, conditions=(*ideal.conditions, *found)), effects, told)


def _check_bristle(law: Law, adhesion: RailAdhesion) -> None:
    """Refuse another adhesion than the one that sets, runs and limit cycles of the law's conditions are made with."""
    for name, value, own in (
        ("adhesion", adhesion.law if isinstance(adhesion.law, str) else f"{adhesion.name} as given", "bristle"),
        ("rail", adhesion.rails_text, PUBLISHED_ADHESION.rails_text),
        ("slip", adhesion.slip, None),
        ("initial speed", adhesion.initial_speed_kmh, PUBLISHED_ADHESION.initial_speed_kmh),
    ):
        if value != own:
            value = f"{value:g}" if isinstance(value, float) else value
            raise InputError(
                f"{name}: {value} does not go with the law {law!r}, whose conditions are decided over sets, runs and "
                "limit cycles of the published bristle model; leave it out, or take the law 'layered', which is "
                "verified for any"
            )
