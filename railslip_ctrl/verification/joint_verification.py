"""Verification of a sliding-mode law: the claims of [Park2008] (33)-(49) and other conditions."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from railslip_ctrl.core.arguments import checked
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.model.vehicle import PARK2008, Vehicle
from railslip_ctrl.sliding.law import PUBLISHED_LAW

from .actuator_effects import published_behind_actuator, variants_behind_actuator
from .predictive import verify_predictive
from .published_law import lyapunov_conditions, reaching_conditions
from .rails import PUBLISHED_ADHESION, RailAdhesion
from .robust import design_gain, robust_conditions
from .verdict import Verification

LARGEST_GAIN = 10_000.0  #: largest K (N m) and D (N m/(m/s)); beyond it, sampling at 2 ms distorts the relay
LEAST_D = 0.1  # N m/(m/s); with less, D0 is below 1e-3 1/s, too slow for a stop

INERTIA_SCALES = (0.5, 10.0)  #: range in which a stop takes seconds to minutes
LARGEST_SEED = 2**31  #: upper limit of seeds

Law = Literal["paper", "robust", "predictive"]


@checked
def verify(
    *,
    law: Law = "paper",
    vehicle: Vehicle = PARK2008,
    K: float | None = None,
    D: float | None = None,
    seed: int = 2008,
    adhesion: RailAdhesion = PUBLISHED_ADHESION,
    actuator: bool = True,
) -> Verification:
    """Decide whether the stability conditions of a sliding-mode law hold.

    - law: "paper" (the published law, then its robust variants), "robust" (the variants only), or "predictive" (the law
      that accounts for the actuator, over a box of speed, slip and load).
    - vehicle: the braking vehicle.
    - K: switching gain, 0 to 1e4, N*m, for the predictive law N*m/s. Defaults: for "paper" that of [Park2008] Table 4,
      bristle column; for "robust" 1.1 times the least gain that the reaching condition, (40), needs; for "predictive"
      that of `Predictive.for_vehicle`.
    - D: gain on s, 0.1 to 1e4, N*m/(m/s); by default that of Table 4. The predictive law has no D.
    - seed: first seed of sampled and simulated conditions, 0 to 2^31.
    - adhesion: static adhesion law, rails and reference slip for the predictive law. The bristle model is replaced by
      its static curve. The other laws are verified only with the bristle model, on both rails.
    - actuator: False leaves out the conditions with the actuator; no effect for the predictive law.

    InputError for a value outside its range, or an argument that the law does not use.
    """
    if law == "predictive":
        if D is not None:
            raise InputError(f"D: {D:g} is not allowed; the predictive law has no D; leave D out")
        _check_ranges(vehicle, K, None, seed)
        return verify_predictive(vehicle, adhesion, K=K, seed=seed)
    # the conditions of these laws use the published bristle model only
    for name, value, expected in (
        ("adhesion", adhesion.law if isinstance(adhesion.law, str) else f"{adhesion.name} as given", "bristle"),
        ("rail", " and ".join(adhesion.rails), " and ".join(PUBLISHED_ADHESION.rails)),
        ("slip", adhesion.slip, None),
        ("initial speed", adhesion.initial_speed_kmh, PUBLISHED_ADHESION.initial_speed_kmh),
    ):
        if value != expected:
            value = f"{value:g}" if isinstance(value, float) else value
            raise InputError(
                f"{name}: {value} is not allowed with the law {law!r}, which is verified only for the published "
                "bristle model; leave it out, or give the law 'predictive', which is verified for any static law"
            )
    _check_ranges(vehicle, K, D, seed)
    if K is None:
        K = PUBLISHED_LAW.K if law == "paper" else design_gain(vehicle)
    own = replace(PUBLISHED_LAW, K=K, D=PUBLISHED_LAW.D if D is None else D)
    if law == "robust":
        conditions = robust_conditions(vehicle, K=K, D=own.D, seed=seed)
    else:
        conditions = (
            *lyapunov_conditions(vehicle, own, seed=seed),
            *reaching_conditions(vehicle, own, seed=seed),
            *robust_conditions(vehicle, K=None, D=PUBLISHED_LAW.D, seed=seed),
        )
    known = (law, vehicle.inertia_scale, K, own.D, seed)
    if not actuator:
        return Verification(*known, conditions)
    behind = variants_behind_actuator if law == "robust" else published_behind_actuator
    with_actuator, findings = behind(K, own.D, vehicle)
    return Verification(*known, (*conditions, *with_actuator), findings=findings)


def _check_ranges(vehicle: Vehicle, K: float | None, D: float | None, seed: int) -> None:
    for name, value, low, high, unit in (
        ("K", K, 0.0, LARGEST_GAIN, " (N*m)"),
        ("D", D, LEAST_D, LARGEST_GAIN, " (N*m/(m/s))"),
        ("inertia scale", vehicle.inertia_scale, *INERTIA_SCALES, ""),
        ("seed", seed, 0, LARGEST_SEED, ""),
    ):
        if value is not None and not low <= value <= high:
            raise InputError(f"{name}: {value:g} is not allowed; give a value from {low:g} to {high:g}{unit}")
