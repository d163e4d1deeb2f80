"""Alternatives to the rules of the reading, each as a change of a setup."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from railslip_ctrl.core.units import KMH
from railslip_ctrl.design.controllers import PIController
from railslip_ctrl.model.adhesion import ReferenceSlip, published_law
from railslip_ctrl.model.adhesion.curve import Curve
from railslip_ctrl.model.vehicle import (
    PARK2008,
    TABLE4_PI_PRINTED,
    TABLE4_SLIDING_PRINTED,
    Actuator,
    PIGains,
    Rail,
    Resistance,
)
from railslip_ctrl.simulation import BrakeLimits, LinearControl, SlidingControl, published_scenario
from railslip_ctrl.simulation.catalogue import published_controller, published_law_gains, published_reference

from .runs import Setup

Change = Callable[[Setup], Setup | None]
"""From the reading's setup of a column to the alternative's; None where it does not concern the column."""

_LOAD_RATIO = PARK2008.mass_loaded / PARK2008.mass
_FREE_TORQUE = BrakeLimits(torque_min=-1e9)  # N*m, beyond anything a controller here asks for


@dataclass(frozen=True)
class Alternative:
    """A rule of the reading by name, what is done instead, and the change of a setup that does it."""

    rule: str
    name: str
    change: Change


class _HalvedCurve(Curve):
    """The curve whose wet force is half the dry one at every slip: alpha halved too, which leaves the peak's slip."""

    __module__ = Curve.__module__  # the same equations: the generated code is the curve's
    wet_factors: ClassVar[Mapping[str, float]] = MappingProxyType({"alpha": 0.5, "beta": 2.0})


class _LoadedWetCurve(Curve):
    """The curve whose wheel load follows the mass when the rail turns wet: alpha grows and beta falls with it."""

    __module__ = Curve.__module__  # the same equations: the generated code is the curve's
    wet_factors: ClassVar[Mapping[str, float]] = MappingProxyType({"alpha": _LOAD_RATIO, "beta": 2.0 / _LOAD_RATIO})


# --- kinds of change -----------------------------------------------------------------------------------------------


def _scenario(**changes: Any) -> Change:
    """Fields of the scenario."""
    return lambda setup: replace(setup, scenario=setup.scenario.with_changes(**changes))


def _vehicle(**changes: Any) -> Change:
    """Fields of the vehicle."""

    def change(setup: Setup) -> Setup:
        vehicle = setup.scenario.vehicle.model_copy(update=changes)
        return replace(setup, scenario=setup.scenario.with_changes(vehicle=vehicle))

    return change


def _disturbances(**changes: Any) -> Change:
    """Fields of the scenario's disturbances."""

    def change(setup: Setup) -> Setup:
        disturbances = setup.scenario.disturbances.model_copy(update=changes)
        return replace(setup, scenario=setup.scenario.with_changes(disturbances=disturbances))

    return change


def _ramp(factor: float) -> Change:
    """The slip acceleration of the curve's ramp."""

    def change(setup: Setup) -> Setup:
        law = setup.scenario.adhesion
        assert isinstance(law, Curve), "the reading's plant has the curve"
        changed = law.model_copy(update={"R": factor * law.R})
        return replace(setup, scenario=setup.scenario.with_changes(adhesion=changed))

    return change


def _wet_by(law: type[Curve]) -> Change:
    """Another way in which the curve turns wet."""

    def change(setup: Setup) -> Setup:
        dry = setup.scenario.adhesion
        changed = law(**{name: getattr(dry, name) for name in type(dry).model_fields})
        return replace(setup, scenario=setup.scenario.with_changes(adhesion=changed))

    return change


def _plant(adhesion: str, *columns: str) -> Change:
    """Another law in the plant, and in the ASMC that takes the plant's, in these columns (none named: all)."""

    def change(setup: Setup) -> Setup | None:
        if columns and setup.case.gains not in columns:
            return None
        return replace(setup, scenario=published_scenario(adhesion=adhesion))

    return change


def _asmc(**changes: Any) -> Change:
    """Fields of the sliding-mode controller."""

    def change(setup: Setup) -> Setup | None:
        if not isinstance(setup.controller, SlidingControl):
            return None
        return replace(setup, controller=replace(setup.controller, **changes))

    return change


def _asmc_gains(gains: Callable[[Setup], dict[str, Any]]) -> Change:
    """Gains of the sliding-mode controller."""

    def change(setup: Setup) -> Setup | None:
        if not isinstance(setup.controller, SlidingControl):
            return None
        return replace(
            setup, controller=replace(setup.controller, gains=replace(setup.controller.gains, **gains(setup)))
        )

    return change


def _pi(change_controller: Callable[[LinearControl, Setup], LinearControl]) -> Change:
    """The PI controller."""

    def change(setup: Setup) -> Setup | None:
        if not isinstance(setup.controller, LinearControl):
            return None
        return replace(setup, controller=change_controller(setup.controller, setup))

    return change


def _si(setup: Setup) -> Setup:
    return replace(setup, scenario=published_scenario(as_published=False))


def _one_reference(reference: ReferenceSlip) -> Change:
    """The same reference slip held in every column."""

    def change(setup: Setup) -> Setup:
        controller = published_controller(setup.case.kind, setup.case.gains, reference=reference)
        return replace(setup, controller=controller)

    return change


def _beam_model(setup: Setup) -> Setup | None:
    if not isinstance(setup.controller, SlidingControl) or setup.case.gains != "beam":
        return None
    return replace(setup, controller=replace(setup.controller, model_law=published_law("beam", Rail.DRY)))


def _si_gains(controller: LinearControl, setup: Setup) -> LinearControl:
    printed = TABLE4_PI_PRINTED[setup.case.gains]
    return replace(controller, design=PIController(PIGains(kp=printed.Kp, ki=printed.Ki)))


def _rates_of_s(setup: Setup) -> dict[str, Any]:
    """D and K as (38)-(39) have them, rates of s in the printed 1/h and km/h^2, brought to torque by J/r."""
    printed, vehicle = TABLE4_SLIDING_PRINTED[setup.case.gains], setup.scenario.vehicle
    per_hour = 1.0 / 3600.0
    torque = vehicle.effective_inertia / vehicle.wheel.radius
    return {"D": torque * printed.D * per_hour, "K": torque * printed.K * KMH * per_hour}


def _adaptation(setup: Setup) -> dict[str, Any]:
    gains = published_law_gains(setup.case.gains, adaptive=True)
    return {"k1": gains.k1, "k2": gains.k2}


# --- the alternatives ----------------------------------------------------------------------------------------------

ALTERNATIVES = (
    Alternative("inertia scale", "SI: M, J and B as they are", _si),
    Alternative("energy unit", "energy in joules", lambda setup: replace(setup, energy_in_joules=True)),
    Alternative("plant law", "beam law in all columns", _plant("beam")),
    Alternative("plant law", "beam law in the beam columns", _plant("beam", "beam")),
    Alternative("plant law", "dynamic bristle law", _plant("bristle")),
    Alternative("ramp of the curve", "R 10 % less", _ramp(0.9)),
    Alternative("ramp of the curve", "R 10 % more", _ramp(1.1)),
    Alternative("wet rail", "half the force at every slip", _wet_by(_HalvedCurve)),
    Alternative("wheel load", "N follows M at 25 s", _wet_by(_LoadedWetCurve)),
    Alternative("PI units", "gains in N m per m/s", _pi(_si_gains)),
    Alternative(
        "PI limits",
        "anti-windup, Tt = Kp/Ki",
        _pi(lambda controller, _: replace(controller, torque_low=0.0, tracking_time=None)),
    ),
    Alternative("references", "bristle reference in all columns", _one_reference(published_reference("bristle"))),
    Alternative("references", "beam reference in all columns", _one_reference(published_reference("beam"))),
    Alternative("ASMC units", "D and K as rates of s, (39), as printed", _asmc_gains(_rates_of_s)),
    Alternative(
        "ASMC units",
        "rho per hour",
        _asmc_gains(lambda setup: {"rho": TABLE4_SLIDING_PRINTED[setup.case.gains].rho / 3600.0}),
    ),
    Alternative("ASMC model", "the wet rail is not known: dry curve kept", _asmc(knows_rail=False)),
    Alternative("ASMC model", "beam model in the beam column", _beam_model),
    Alternative("ASMC nominal mass", "Mn loaded", _asmc(nominal_mass=PARK2008.mass_loaded)),
    Alternative("adaptation", "k = 2.1e-8 as printed", _asmc_gains(_adaptation)),
    Alternative("acceleration filter", "tau 0.02 s", _asmc(filter_time=0.02)),
    Alternative("acceleration filter", "tau 0.5 s", _asmc(filter_time=0.5)),
    Alternative("actuator", "none: torque at once", _vehicle(actuator=Actuator(dead_time=0.0, lag=0.0))),
    Alternative("torque sign", "Tb < 0 allowed", _scenario(limits=_FREE_TORQUE)),
    Alternative(
        "resistance",
        "v in km/h",
        _vehicle(resistance=Resistance(quadratic=PARK2008.resistance.quadratic / KMH**2)),
    ),
    Alternative("random force", "none", _disturbances(random_force=0.0)),
    Alternative("noise hold", "1 ms", _disturbances(random_hold=0.001)),
    Alternative("noise hold", "0.1 s", _disturbances(random_hold=0.1)),
    Alternative("viscous friction", "B at least 0", _scenario(viscous_least=0.0)),
    Alternative("caliper", "no Td", _disturbances(caliper_fraction=0.0)),
    Alternative("slip error", "against each column's own reference", lambda setup: replace(setup, own_reference=True)),
)
"""One or more for each rule that could be read otherwise, in the order of `reading.READING`."""
