"""Controllers by name, for a vehicle."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.user_files import close_match
from railslip_ctrl.design.controllers import PIController
from railslip_ctrl.model.adhesion import AdhesionLaw, ReferenceSlip
from railslip_ctrl.model.vehicle import PIGains, Vehicle

from .designed import recommended_pi_lead, recommended_schedule, slide_protection
from .published import Column, published_controller, published_pi, published_reference

if TYPE_CHECKING:
    from .controllers import Controller

NAMES = ("pi", "asmc", "pi-lead", "scheduled", "slide-protection")
"""Names of the controllers that come with the package."""

_LINEAR = ("pi", "pi-lead")


def default_column(law: AdhesionLaw) -> Column:
    """The column of Table 4 for an adhesion law: its own for the beam, else that of the bristles."""
    return "beam" if law.name == "beam" else "bristle"


def reference_of(law: AdhesionLaw, name: str, remedy: str) -> ReferenceSlip:
    """The slips that an adhesion law is to be held at.

    InputError, which begins with `name` and ends with the `remedy`, where neither its source nor its file gives any.
    """
    if law.reference is None:
        raise InputError(f"{name}: adhesion {law.name!r} has no reference slip; give {remedy}")
    return law.reference


def controller_named(
    name: str,
    vehicle: Vehicle,
    *,
    column: Column = "bristle",
    gains: PIGains | None = None,
    reference: ReferenceSlip | None = None,
    knows_rail: bool = True,
    adaptive: bool = False,
    period: float | None = None,
) -> Controller:
    """A controller of `NAMES` for a vehicle.

    Parameters
    ----------
    name : str
        "pi" and "asmc" are [Park2008] Table 4's (see `published_controller`), the others this project's (`designed`).
    column : {"beam", "bristle"}
        Of Table 4: gains of "pi" and "asmc", and the reference slip of all.
    gains : PIGains, optional
        In place of those of "pi" or "pi-lead".
    reference, knows_rail, adaptive, period
        As in `published_controller`.

    Raises
    ------
    InputError
        Another name, or an option that the controller does not have.
    """
    if name not in NAMES:
        raise InputError(
            f"controller: {name!r} is not one; {close_match(name, NAMES)}choose one of {', '.join(NAMES)}, or give a "
            "TOML file"
        )
    if gains is not None and name not in _LINEAR:
        raise InputError(f"controller: {name!r} has no kp and ki; leave them out or choose {' or '.join(_LINEAR)}")
    if name != "asmc" and (adaptive or not knows_rail):
        raise InputError(
            f"controller: {name!r} has neither adaptation nor a model of the rail to keep dry; choose 'asmc' for those"
        )
    held = published_reference(column) if reference is None else reference
    if name == "scheduled":
        return recommended_schedule(vehicle, reference=held, period=period)
    if name == "slide-protection":
        return slide_protection(vehicle, reference=held, period=period)
    if name == "asmc":
        return published_controller(
            "asmc", column, knows_rail=knows_rail, adaptive=adaptive, reference=held, period=period
        )
    if name == "pi-lead":
        return recommended_pi_lead(vehicle, gains=gains, reference=held, period=period)
    published = published_pi(column, reference=held, period=period)
    return published if gains is None else replace(published, design=PIController(gains))
