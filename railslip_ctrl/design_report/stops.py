"""Braking runs of a design report: the same stop with every controller."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from railslip_ctrl.adhesion import ReferenceSlip
from railslip_ctrl.design.controllers import PIController
from railslip_ctrl.errors import InputError, RailslipError
from railslip_ctrl.law_sources import is_own
from railslip_ctrl.linearization import OperatingPoint, linearize
from railslip_ctrl.parameters import INITIAL_SPEED_KMH, PIGains, Rail, Vehicle
from railslip_ctrl.simulation import LinearControl, Scenario, Simulator, published_scenario
from railslip_ctrl.simulation.catalogue import controller_named
from railslip_ctrl.simulation.clairvoyant import ClairvoyantStop, clairvoyant_stop
from railslip_ctrl.simulation.controllers import Controller
from railslip_ctrl.simulation.designed import (
    TRACKING_TIME,
    full_brake_torque,
    is_published,
    recommended_pi_lead,
)
from railslip_ctrl.simulation.published import Column, published_reference
from railslip_ctrl.simulation.scenario import in_reading, named_law
from railslip_ctrl.units import KMH

from .candidates import DesignNames, design_names, least_ms
from .held_laws import own_design_points, torques
from .loops import COMPARED_LAWS
from .records import Stop, StopRun
from .slow_end import HANDED_OVER, handing_over, slow_ends

CONTROLLERS = {
    "pi": "published PI",
    "asmc": "published ASMC",
    "pi-lead": "full range",
    "slide-protection": "slide protection",
}
"""Controllers of the catalogue that are run, and what the report calls them; `design_names` has the full-range one."""

SEED = 0
SPREAD_SEEDS = range(4)
"""Noise seeds of the spread in braking distance; statistics over many are the campaign's."""

HOLDING, RELAY = "holding PI", "relay"

_RELAY_GAIN = 1e7  # N*m/(m/s): full torque within a slip velocity of a millimetre a second
_LOG_PERIOD = 0.05  # s: a picture needs no more


def stops(
    points: Sequence[OperatingPoint], given: PIGains | None, holding: PIController | None = None
) -> tuple[Stop, ...]:
    """A stop on each rail asked for and, of the published vehicle, the published one in its own units.

    Points of one vehicle; `given` and `holding` are a PI to run too. The published bristle model's static curve, the
    same model along a slip ramp ([Park2008] Fig. 17), takes its place, as in the reading that gives the paper's
    Table 5: controllers are compared over the curve that they were published for. Linear controllers are run again
    with the dynamic model itself, `Stop.dynamic`. A law of the user's own is run as it is.
    """
    vehicle, first = points[0].vehicle, points[0]
    column: Column = "beam" if first.adhesion == "beam" else "bristle"
    reference = _reference(points, column)
    controllers = _controllers(points, column, reference)
    if given is not None:
        controllers["given PI"] = LinearControl(PIController(given), reference)
    compared = _compared(points, holding, controllers, reference)
    found = []
    by_rail = {point.rail: point for point in reversed(points)}
    for rail in dict.fromkeys(point.rail for point in points):
        title = f"{rail} rail from the start, inertia scale {vehicle.inertia_scale:g}"
        again = first.adhesion == "bristle" and not is_own(first)
        found.append(_stop(title, _plain(by_rail[rail]), controllers, compared, torques(points).sure, dynamic=again))
    if is_published(vehicle):
        title = "the published run as published (inertia scale 3.6): loaded and wet from 25 s on"
        scenario = published_scenario()
        controllers = _published_controllers(scenario.vehicle, column, published_reference(column))
        # of the same kind, but with the gains of that reading
        controllers = {f"{name}{_as_read(one, first)}": one for name, one in controllers.items()}
        found.append(_stop(title, scenario, controllers, {}))
    return tuple(found)


def _compared(
    points: Sequence[OperatingPoint],
    holding: PIController | None,
    controllers: dict[str, Controller | str],
    reference: ReferenceSlip,
) -> dict[str, Controller | str]:
    """Linear controllers run for comparison: one kernel serves them all, so that they cost only their runs.

    The designs that the linear part names, with start, limits and anti-windup of the full-range one; that one started
    for dry rail; and a relay, full torque below the reference slip and none above.
    """
    vehicle = points[0].vehicle
    start, names = torques(points), design_names(vehicle)
    made: dict[str, Controller | str] = {}

    def as_full_range(design: PIController, name: str) -> LinearControl:
        return LinearControl(
            design,
            reference,
            name=name,
            torque_low=0.0,
            torque_high=full_brake_torque(vehicle),
            tracking_time=TRACKING_TIME,
            initial_torque=start.sure,
        )

    if holding is not None:
        made[HOLDING] = as_full_range(holding, "pi")
    try:
        least = least_ms([linearize(point) for point in points], vehicle).controller
        made[names.least_ms] = as_full_range(least, "pi-lead")
    except RailslipError as error:
        made[names.least_ms] = str(error)
    full_range = controllers[names.full_range]
    if isinstance(full_range, LinearControl):
        made[names.started_dry] = replace(full_range, initial_torque=start.dry)
    made[RELAY] = LinearControl(
        PIController(PIGains(kp=_RELAY_GAIN, ki=0.0)),
        reference,
        name="relay",
        torque_low=0.0,
        torque_high=start.relay,
    )
    return made


def _as_read(controller: Controller | str, point: OperatingPoint) -> str:
    """The gains of a design of this project's in the published run, whose units make them others; to be appended."""
    if isinstance(controller, LinearControl) and controller.name == "pi-lead" and point.vehicle.inertia_scale == 1.0:
        gains = controller.design.gains
        return f", kp {gains.kp:g}, ki {gains.ki:g}"
    return ""


def _plain(point: OperatingPoint) -> Scenario:
    """The published disturbances without its events, with the law of a point; of the published bristles their curve."""
    v0 = (INITIAL_SPEED_KMH if point.initial_speed_kmh is None else point.initial_speed_kmh) * KMH
    rail, vehicle, name = point.rail, point.vehicle, point.adhesion
    if is_own(point) or name not in COMPARED_LAWS:
        law = in_reading(point.law, vehicle)
    else:
        law = named_law("curve" if name == "bristle" else name, vehicle, v0)
    return published_scenario(as_published=False).with_changes(
        name=f"{rail} rail", vehicle=vehicle, adhesion=law, rail=rail, initial_speed=v0, events=()
    )


def _reference(points: Sequence[OperatingPoint], column: Column) -> ReferenceSlip:
    """The slips of the operating points, the published ones where a rail has none."""
    published = published_reference(column)
    slips = {point.rail: point.slip for point in reversed(points) if point.slip > 0}
    return ReferenceSlip(dry=slips.get(Rail.DRY, published.dry), wet=slips.get(Rail.WET, published.wet))


def _controllers(
    points: Sequence[OperatingPoint], column: Column, reference: ReferenceSlip
) -> dict[str, Controller | str]:
    """Controllers by what the report calls them; the full-range one is tuned for the law where it is the user's own."""
    vehicle = points[0].vehicle
    made, name = _published_controllers(vehicle, column, reference), design_names(vehicle).full_range
    if is_own(points[0]):
        try:
            own = recommended_pi_lead(vehicle, reference=reference, plants=own_design_points(points))
            made[name] = replace(own, initial_torque=torques(points).sure)
        except RailslipError as error:
            made[name] = str(error)
    return made


def _published_controllers(vehicle: Vehicle, column: Column, reference: ReferenceSlip) -> dict[str, Controller | str]:
    """Those of the catalogue; the reason in place of one that the vehicle does not allow."""
    made: dict[str, Controller | str] = {}
    for name, shown in (CONTROLLERS | {"pi-lead": design_names(vehicle).full_range}).items():
        try:
            made[shown] = controller_named(name, vehicle, column=column, reference=reference)
        except RailslipError as error:
            made[shown] = str(error)
    return made


def _stop(
    title: str,
    scenario: Scenario,
    controllers: dict[str, Controller | str],
    compared: dict[str, Controller | str],
    held: float = 0.0,
    *,
    dynamic: bool = False,
) -> Stop:
    spread = bool(compared)
    runs = [_run(name, scenario, controller, spread=spread) for name, controller in controllers.items()]
    names = design_names(scenario.vehicle)
    chief = _chief(controllers | compared, names)
    design = (controllers | compared).get(chief) if compared else None
    for name, one in ((chief, design), (names.started_dry, compared.get(names.started_dry))):
        if isinstance(one, LinearControl):
            compared = compared | {f"{name}{HANDED_OVER}": handing_over(one, held)}
    runs += [_run(name, scenario, one, spread=spread, drawn=name == chief) for name, one in compared.items()]
    laws, again = [scenario.adhesion], []
    if dynamic:
        laws.append(named_law("bristle", scenario.vehicle, scenario.initial_speed))
        again = list(_dynamic(scenario.with_changes(adhesion=laws[1]), controllers | compared))
    ends = slow_ends(scenario, chief, design, laws, SPREAD_SEEDS, held) if isinstance(design, LinearControl) else ()
    return Stop(title, scenario, SEED, tuple(runs), tuple(again), _bound(scenario), ends)


def _chief(controllers: dict[str, Controller | str], names: DesignNames) -> str:
    """The design that is recommended where it exists, or else the next one: full range, least Ms, holding."""
    looked_for = (names.full_range, names.least_ms, HOLDING)
    return next((name for name in looked_for if isinstance(controllers.get(name), LinearControl)), "")


def _dynamic(scenario: Scenario, controllers: dict[str, Controller | str]) -> Iterator[StopRun]:
    """The linear controllers over the bristle model itself: one kernel to compile serves them all."""
    for name, controller in controllers.items():
        if isinstance(controller, LinearControl):
            yield _run(name, scenario, controller, spread=True)


def _run(
    name: str, scenario: Scenario, controller: Controller | str, *, spread: bool = False, drawn: bool = True
) -> StopRun:
    if isinstance(controller, str):
        return StopRun(name, None, controller)
    try:
        simulator = Simulator(scenario, controller)
        every = max(round(_LOG_PERIOD / simulator.period), 1)  # of the controller's own samples
        run = simulator.run(SEED, record_every=every)
        found = [run]
        found += [simulator.run(seed, record_every=every) for seed in SPREAD_SEEDS if spread and seed != SEED]
        worst = max(found, key=lambda one: one.max_slip)
        assert worst.signals is not None, "the run is recorded"
        return StopRun(
            name,
            run,
            "",
            distances=tuple(one.braking_distance for one in found if one.stopped) if spread else (),
            drawn=drawn,
            most_locked=max(one.locked_fraction for one in found),
            highest_slip=worst.max_slip,
            highest_slip_kmh=float(worst.signals.speed[int(np.argmax(worst.signals.slip))] / KMH),
            locking_seeds=tuple(one.seed for one in found if one.locked_fraction > 0 and one.seed is not None),
            endless_seeds=tuple(one.seed for one in found if not one.stopped and one.seed is not None),
        )
    except RailslipError as error:
        return StopRun(name, None, str(error))


def _bound(scenario: Scenario) -> ClairvoyantStop | None:
    try:
        return clairvoyant_stop(scenario)
    except InputError:
        return None
