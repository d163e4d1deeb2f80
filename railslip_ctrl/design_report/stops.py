"""Braking runs of a design report: the same stop with every controller."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from railslip_ctrl.adhesion import AdhesionLaw, ReferenceSlip
from railslip_ctrl.design.controllers import PIController
from railslip_ctrl.errors import InputError, RailslipError
from railslip_ctrl.linearization import OperatingPoint
from railslip_ctrl.parameters import INITIAL_SPEED_KMH, PIGains, Rail, Vehicle
from railslip_ctrl.simulation import LinearControl, Scenario, Simulator, published_scenario
from railslip_ctrl.simulation.catalogue import controller_named
from railslip_ctrl.simulation.clairvoyant import ClairvoyantStop, clairvoyant_stop
from railslip_ctrl.simulation.controllers import Controller
from railslip_ctrl.simulation.designed import is_published
from railslip_ctrl.simulation.published import Column, published_reference
from railslip_ctrl.simulation.scenario import named_law
from railslip_ctrl.units import KMH

from .records import Stop, StopRun

CONTROLLERS = {
    "pi": "published PI",
    "asmc": "published ASMC",
    "pi-lead": "PI-lead, recommended",
    "slide-protection": "slide protection",
}
"""Controllers of the catalogue that are run, and what the report calls them."""

SEED = 0
_LOG_PERIOD = 0.05  # s: a picture needs no more


def stops(points: Sequence[OperatingPoint], given: PIGains | None) -> tuple[Stop, ...]:
    """A stop on each rail asked for and, of the published vehicle, the published one in its own units.

    Points of one vehicle. The bristle model's static curve, the same model along a slip ramp ([Park2008] Fig. 17),
    takes its place, as in the reading that gives the paper's Table 5: controllers are compared over the curve that they
    were published for. Linear controllers are run again with the dynamic model itself, `Stop.dynamic`.
    """
    vehicle, first = points[0].vehicle, points[0]
    column: Column = "beam" if first.adhesion == "beam" else "bristle"
    reference = _reference(points, column)
    controllers = _controllers(vehicle, column, reference)
    if given is not None:
        controllers["given PI"] = LinearControl(PIController(given), reference)
    found = []
    for rail in dict.fromkeys(point.rail for point in points):
        scenario = _plain(vehicle, first, rail)
        if scenario is not None:
            title = f"{rail} rail from the start, inertia scale {vehicle.inertia_scale:g}"
            found.append(_stop(title, scenario, controllers, dynamic=first.adhesion == "bristle"))
    if is_published(vehicle):
        title = "the published run as published (inertia scale 3.6): loaded and wet from 25 s on"
        scenario = published_scenario()
        controllers = _controllers(scenario.vehicle, column, published_reference(column))
        found.append(_stop(title, scenario, controllers))
    return tuple(found)


def _plain(vehicle: Vehicle, point: OperatingPoint, rail: Rail) -> Scenario | None:
    """The published disturbances without its events; None where the law cannot be had on this rail."""
    v0 = (INITIAL_SPEED_KMH if point.initial_speed_kmh is None else point.initial_speed_kmh) * KMH
    try:
        law: AdhesionLaw = point.law if point.adhesion != "bristle" else named_law("curve", vehicle, v0)
        if point.adhesion in ("beam", "curve"):
            law = named_law(point.adhesion, vehicle, v0)
        law.on(rail)
    except RailslipError:
        return None
    return published_scenario(as_published=False).with_changes(
        name=f"{rail} rail", vehicle=vehicle, adhesion=law, rail=rail, initial_speed=v0, events=()
    )


def _reference(points: Sequence[OperatingPoint], column: Column) -> ReferenceSlip:
    """The slips of the operating points, the published ones where a rail has none."""
    published = published_reference(column)
    slips = {point.rail: point.slip for point in reversed(points) if point.slip > 0}
    return ReferenceSlip(dry=slips.get(Rail.DRY, published.dry), wet=slips.get(Rail.WET, published.wet))


def _controllers(vehicle: Vehicle, column: Column, reference: ReferenceSlip) -> dict[str, Controller | str]:
    """Controllers by what the report calls them; the reason in place of one that the vehicle does not allow."""
    made: dict[str, Controller | str] = {}
    for name, shown in CONTROLLERS.items():
        try:
            made[shown] = controller_named(name, vehicle, column=column, reference=reference)
        except RailslipError as error:
            made[shown] = str(error)
    return made


def _stop(title: str, scenario: Scenario, controllers: dict[str, Controller | str], *, dynamic: bool = False) -> Stop:
    runs = tuple(_run(name, scenario, controller) for name, controller in controllers.items())
    again = tuple(_dynamic(scenario, controllers)) if dynamic else ()
    return Stop(title, scenario, SEED, runs, again, _bound(scenario))


def _dynamic(scenario: Scenario, controllers: dict[str, Controller | str]) -> Iterator[StopRun]:
    """The linear controllers over the bristle model itself: one kernel to compile serves them all."""
    law = named_law("bristle", scenario.vehicle, scenario.initial_speed)
    for name, controller in controllers.items():
        if isinstance(controller, LinearControl):
            yield _run(name, scenario.with_changes(adhesion=law), controller)


def _run(name: str, scenario: Scenario, controller: Controller | str) -> StopRun:
    if isinstance(controller, str):
        return StopRun(name, None, controller)
    try:
        simulator = Simulator(scenario, controller)
        every = max(round(_LOG_PERIOD / simulator.period), 1)  # of the controller's own samples
        return StopRun(name, simulator.run(SEED, record_every=every), "")
    except RailslipError as error:
        return StopRun(name, None, str(error))


def _bound(scenario: Scenario) -> ClairvoyantStop | None:
    try:
        return clairvoyant_stop(scenario)
    except InputError:
        return None
