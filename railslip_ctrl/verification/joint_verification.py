"""`verify`: which claims of [Park2008] (33)-(49) hold, which a robust law keeps, and what lag and dead time do.

The conditions of `published_law` and `robust` are about the loop without the actuator: what fails there fails before
lag and dead time, which `actuator_effects` puts in; `predictive` is the law that accounts for them.
"""

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

LARGEST_GAIN = 10_000.0  #: of K (N m) and D (N m/(m/s)): beyond it the relay sampled at 2 ms no longer shows the law
LEAST_D = 0.1  # N m/(m/s): below it D0 is less than 1e-3 1/s and nothing is reached in a stop

INERTIA_SCALES = (0.5, 10.0)  #: between them a stop takes seconds to minutes
LARGEST_SEED = 2**31

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
    """Decide every condition of a law.

    - law: "paper", the published law's conditions and, after them, the robust variants'; "robust", these alone;
      "predictive", the law that slides behind the actuator, decided over a box of speed, slip and load.
    - vehicle: which brakes.
    - K: gain, 0 to 1e4; N*m, of the predictive law N*m/s; left out, Table 4's, bristle column, of the robust law 1.1
      times what (40) asks over its box, of the predictive law by its own rule.
    - D: gain on s, 0.1 to 1e4, N*m/(m/s); left out, Table 4's; the predictive law has none.
    - seed: first of sampled and simulated conditions, 0 to 2^31.
    - adhesion: static law, rails and reference slip of the predictive law, which takes the bristle model by its static
      curve; the others are verified for the published bristle model on both rails alone.
    - actuator: whether those behind the actuator are decided too; the predictive law's all are.

    InputError for a value outside its range, or an argument that the law does not have.
    """
    if law == "predictive":
        if D is not None:
            raise InputError(f"D: {D:g} is not allowed; the predictive law has no D, leave it out")
        _check_ranges(vehicle, K, None, seed)
        return verify_predictive(vehicle, adhesion, K=K, seed=seed)
    # another adhesion than the one that sets, runs and limit cycles of the conditions are made with
    for name, value, expected in (
        ("adhesion", adhesion.law if isinstance(adhesion.law, str) else f"{adhesion.name} as given", "bristle"),
        ("rail", adhesion.rails_text, PUBLISHED_ADHESION.rails_text),
        ("slip", adhesion.slip, None),
        ("initial speed", adhesion.initial_speed_kmh, PUBLISHED_ADHESION.initial_speed_kmh),
    ):
        if value != expected:
            value = f"{value:g}" if isinstance(value, float) else value
            raise InputError(
                f"{name}: {value} does not go with the law {law!r}, whose conditions are decided over sets, runs and "
                "limit cycles of the published bristle model; leave it out, or take the law 'predictive', which is "
                "verified for any static law"
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
    found, findings = behind(K, own.D, vehicle)
    return Verification(*known, (*conditions, *found), findings=findings)


def _check_ranges(vehicle: Vehicle, K: float | None, D: float | None, seed: int) -> None:
    for name, value, low, high, unit in (
        ("K", K, 0.0, LARGEST_GAIN, " (N*m)"),
        ("D", D, LEAST_D, LARGEST_GAIN, " (N*m/(m/s))"),
        ("inertia scale", vehicle.inertia_scale, *INERTIA_SCALES, ""),
        ("seed", seed, 0, LARGEST_SEED, ""),
    ):
        if value is not None and not low <= value <= high:
            raise InputError(f"{name}: {value:g} is not allowed; give a value from {low:g} to {high:g}{unit}")
