"""Braking runs of a design report: plain stops, dry and wet, with the recommended controller."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.design.envelope import EnvelopePoints
from railslip_ctrl.design.envelope_tuning import operating_plants
from railslip_ctrl.design.judging import Judgement
from railslip_ctrl.model.adhesion import AdhesionLaw, ReferenceSlip
from railslip_ctrl.model.linearization import OperatingPoint
from railslip_ctrl.model.vehicle import Rail, Vehicle
from railslip_ctrl.simulation import BrakeLimits, LinearControl, Run, Scenario, Simulator, stop
from railslip_ctrl.simulation.bound import ClairvoyantStop, clairvoyant_stop
from railslip_ctrl.simulation.catalogue import braking_control
from railslip_ctrl.simulation.controllers import reference_slip
from railslip_ctrl.simulation.scenario import in_reading

from .records import Stop

SEED = 0
OTHER_SEEDS = (1, 2, 3)
"""Noise seeds of the spread; statistics over many are the campaign's."""

LOG_PERIOD = 0.01
"""s, between the samples of a recorded run: those of `railslip simulate`."""


def as_run(design: Any, judgement: Judgement, hand_over_kmh: float, name: str = "") -> LinearControl:
    """A linear design as `braking_control` runs it at the points of a judgement; where their laws hold different slips,
    those of the law of the first stops."""
    operating = operating_points(judgement.points)
    first = _running_law(operating).name
    slips = {point.rail: point.slip for point in operating if point.law.name == first}
    held = {rail.value: slips.get(rail, next(iter(slips.values()))) for rail in Rail}
    reference = judgement.envelope.reference or ReferenceSlip(**held)
    return braking_control(
        design, operating, reference, name=name or design.structure.lower(), hand_over_kmh=hand_over_kmh
    )


def operating_points(points: EnvelopePoints) -> list[OperatingPoint]:
    """The operating points of an envelope."""
    return [plant.point for plant in operating_plants(points)]


def stops(control: Any, judgement: Judgement, *, every_law: bool = True) -> tuple[Stop, ...]:
    """A stop from the envelope's initial speed on each of its rails and loads, with the static law first."""
    operating = operating_points(judgement.points)
    loads = dict(zip(judgement.points.load[judgement.points.operating].tolist(), operating, strict=True))
    names = sorted({point.law.name: point.law.has_state for point in operating}.items(), key=lambda one: one[1])
    laws = [name for name, _ in names] if every_law else [names[0][0]]
    found = []
    for law in laws:
        for load in loads:
            for rail in judgement.envelope.rails:
                scenario = stop_scenario(judgement, law, load, rail)
                found.append(_stop(control, scenario, load))
    return tuple(found)


def stop_scenario(judgement: Judgement, law: str, load: str, rail: Rail) -> Scenario:
    """The stop of a load on a rail with a law of the envelope, by name."""
    envelope, points = judgement.envelope, judgement.points
    of_load = np.flatnonzero(points.operating & (points.load == load))
    point = next(p for p in (points.plants[int(points.plant[i])].point for i in of_load) if p.law.name == law)
    car: Vehicle = point.vehicle
    own: str | AdhesionLaw = law if law in envelope.laws else in_reading(point.law.on(Rail.DRY), car)
    return stop(car, rail, speed_kmh=envelope.initial_speed, adhesion=own)


def _running_law(operating: list[OperatingPoint]) -> AdhesionLaw:
    """The law of the first stops: the first without a state, which has a bound, if there is one."""
    return min((point.law for point in operating), key=lambda law: law.has_state)


def _stop(control: Any, scenario: Scenario, load: str) -> Stop:
    simulator = Simulator(scenario, control)
    every = max(round(LOG_PERIOD / simulator.period), 1)
    run = simulator.run(SEED, record_every=every)
    return Stop(
        control.name,
        scenario.adhesion.name,
        scenario.rail,
        load,
        run,
        tuple(replace(simulator.run(seed, record_every=every), signals=None) for seed in OTHER_SEEDS),
        _bound(scenario, getattr(control, "torque_high", None)),
        _held(run),
        reference_slip(control.reference, scenario.rail),
    )


def _held(run: Run) -> float:
    """The median of slip over the second half of a stop."""
    assert run.signals is not None, "the run is recorded"
    slip = run.signals.slip
    return float(np.median(slip[slip.size // 2 :]))


@lru_cache(64)
def _bound(scenario: Scenario, torque_max: float | None) -> ClairvoyantStop | None:
    """With this brake: dead time, and lag up to the largest torque."""
    limits = BrakeLimits(torque_max=torque_max) if torque_max is not None and np.isfinite(torque_max) else None
    try:
        return clairvoyant_stop(scenario if limits is None else scenario.with_changes(limits=limits))
    except InputError:
        return None


def laws_of(judgement: Judgement) -> Iterator[OperatingPoint]:
    """An operating point of each law and rail, of the first load, at the highest speed."""
    operating = operating_points(judgement.points)
    loads = judgement.points.load[judgement.points.operating].tolist()
    top = max(point.speed for point in operating)
    told = set()
    for point, load in zip(operating, loads, strict=True):
        key = (point.law.name, point.rail)
        if load == loads[0] and point.speed > 0.999 * top and key not in told:
            told.add(key)
            yield point
