"""`verify`: which stability claims of [Park2008] (33)-(49) hold, and which a robust law keeps.

The conditions are decided in `lyapunov_conditions` (symbolic), `reaching_conditions` (the published disturbances) and
`robust_conditions` (the variants of `robust`). All are about the loop without the actuator: what fails here fails
before lag and dead time.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal, get_args

from railslip_ctrl.core.arguments import checked
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.model.vehicle import PARK2008, Vehicle
from railslip_ctrl.sliding.gains import PUBLISHED_LAW

from .lyapunov_conditions import lyapunov_conditions
from .reaching_conditions import reaching_conditions
from .robust import design_gain
from .robust_conditions import robust_conditions
from .verdict import Condition, Verification

__all__ = ["Condition", "LawName", "Verification", "check_arguments", "verify"]

LawName = Literal["paper", "robust"]

LARGEST_GAIN = 10_000.0
"""Of K (N m) and D (N m/(m/s)): beyond it the relay sampled at 2 ms no longer shows the law."""

LEAST_D = 0.1  # N m/(m/s): below it D0 is less than 1e-3 1/s and nothing is reached in a stop

INERTIA_SCALES = (0.5, 10.0)
"""Between them a stop takes seconds to minutes."""

LARGEST_SEED = 2**31


@checked
def verify(
    *,
    law: LawName = "paper",
    vehicle: Vehicle = PARK2008,
    K: float | None = None,
    D: float | None = None,
    seed: int = 2008,
) -> Verification:
    """Decide the conditions of a law.

    Parameters
    ----------
    law : str
        "paper": the published law's conditions and, after them, the robust variants'; "robust": these alone.
    vehicle : Vehicle
        Its `inertia_scale` is the reading: 1 SI, 3.6 as published.
    K, D : float, optional
        Gains of `law`, N m (0 to 1e4) and N m/(m/s) (0.1 to 1e4). Left out: Table 4's, bristle column; for the
        robust law K is 1.1 times what (40) asks for over the published run, Ta and v' estimated to 10 %.
    seed : int
        First seed of sampled and simulated conditions, 0 to 2^31.

    Raises
    ------
    InputError
        A value outside its range.
    """
    if law not in get_args(LawName):
        raise InputError(f"law: {law!r} is not known; choose paper or robust")
    check_arguments(vehicle, K, D, seed)
    design = design_gain(vehicle)
    conditions: tuple[Condition, ...] = ()
    own = PUBLISHED_LAW if law == "paper" else replace(PUBLISHED_LAW, K=design)
    own = replace(own, K=own.K if K is None else K, D=own.D if D is None else D)
    if law == "paper":
        conditions += lyapunov_conditions(vehicle, own, seed=seed)
        conditions += reaching_conditions(vehicle, own, seed=seed)
        conditions += robust_conditions(vehicle, K=None, D=PUBLISHED_LAW.D, seed=seed)
    else:
        conditions += robust_conditions(vehicle, K=own.K, D=own.D, seed=seed)
    return Verification(law, vehicle.inertia_scale, own.K, own.D, seed, conditions)


@checked
def check_arguments(vehicle: Vehicle, K: float | None, D: float | None, seed: int) -> None:
    """InputError for a gain, inertia scale or seed outside the range that `verify` takes."""
    for name, value, low, high in (
        ("K", K, 0.0, LARGEST_GAIN),
        ("D", D, LEAST_D, LARGEST_GAIN),
        ("inertia scale", vehicle.inertia_scale, *INERTIA_SCALES),
        ("seed", seed, 0, LARGEST_SEED),
    ):
        if value is not None and not (math.isfinite(value) and low <= value <= high):
            raise InputError(f"{name}: {value:g} is not allowed; give a value from {low:g} to {high:g}")
