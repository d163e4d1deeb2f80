"""Table 4's controllers of [Park2008] as records."""

from __future__ import annotations

from typing import Literal, get_args

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.design.controllers import PIController
from railslip_ctrl.model.adhesion import ReferenceSlip, published_law
from railslip_ctrl.model.vehicle import PARK2008, TABLE4_PI, TABLE4_SLIDING_PRINTED, Rail
from railslip_ctrl.sliding.law import LawGains

from .controllers import LinearControl, SlidingControl

Kind = Literal["pi", "asmc"]
Column = Literal["beam", "bristle"]
KINDS: tuple[Kind, ...] = get_args(Kind)
COLUMNS: tuple[Column, ...] = get_args(Column)

FILTER_TIME = 0.1
"""s, of the filter that estimates v' in the ASMC; any value serves, [Park2008] gives none."""


def published_controller(
    kind: Kind,
    column: Column = "bristle",
    *,
    knows_rail: bool = True,
    adaptive: bool = False,
    reference: ReferenceSlip | None = None,
    period: float | None = None,
) -> LinearControl | SlidingControl:
    """A controller of [Park2008] Table 4, SI, in the reading under which Table 5 comes out.

    PI: the column's gains, no limits or anti-windup of its own. ASMC: law (45) with D and K added as torque, rho per
    second, Ta from the plant's adhesion law at the measured slip, Mn the empty mass, the adaptation off.

    Parameters
    ----------
    kind : {"pi", "asmc"}
    column : {"beam", "bristle"}
        Of Table 4: its gains and its reference slip (beam 0.119 dry, 0.059 wet; bristle 0.132, 0.092).
    knows_rail : bool
        ASMC: whether its adhesion model turns wet with the rail; the reference always does.
    adaptive : bool
        ASMC: the printed adaptation, k = 2.1e-8 read in km/h: k1 = k, k2 = 3.6^2 k.
    reference : ReferenceSlip, optional
        Another reference slip.
    period : float, optional
        Sampling period, s; every step of the scenario if not given.

    Raises
    ------
    InputError
        Another kind or column, or an option of the ASMC with the PI.
    """
    if kind not in KINDS:
        raise InputError(f"controller: {kind!r} is not in [Park2008] Table 4; choose {' or '.join(KINDS)}")
    if column not in COLUMNS:
        raise InputError(f"gains: {column!r} is not a column of [Park2008] Table 4; choose {' or '.join(COLUMNS)}")
    held = published_reference(column) if reference is None else reference
    if kind == "pi":
        if adaptive or not knows_rail:
            raise InputError("controller: 'pi' has neither adaptation nor adhesion model; choose 'asmc' for those")
        return published_pi(column, reference=held, period=period)
    return SlidingControl(
        published_law_gains(column, adaptive=adaptive),
        held,
        period=period,
        nominal_mass=PARK2008.mass,
        filter_time=FILTER_TIME,
        knows_rail=knows_rail,
    )


def published_pi(
    column: Column, *, reference: ReferenceSlip | None = None, period: float | None = None
) -> LinearControl:
    """Table 4's PI of a column; see `published_controller`."""
    held = published_reference(column) if reference is None else reference
    return LinearControl(PIController(TABLE4_PI[column]), held, period=period)


def published_law_gains(column: Column, *, adaptive: bool = False) -> LawGains:
    """Table 4's ASMC gains of a column, SI; without `adaptive` k1 = k2 = 0."""
    printed = TABLE4_SLIDING_PRINTED[column]
    k = printed.k if adaptive else 0.0
    # in km/h theta1 is 3.6 times its SI value and s is too; theta2 has the same value, s and omega do not
    return LawGains(K=printed.K, D=3.6 * printed.D, rho=printed.rho, k1=k, k2=3.6**2 * k)


def published_reference(column: Column) -> ReferenceSlip:
    """A column's reference slip, dry and wet."""
    reference = published_law(column, Rail.DRY).reference
    assert reference is not None, "both published laws have one"
    return reference
