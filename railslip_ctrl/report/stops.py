"""The braking runs of a design report: plain stops, dry and wet, of the laws and loads of its envelope."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np

from railslip_ctrl.controllers.braking import braking_control
from railslip_ctrl.controllers.linear import LinearControl, full_brake_torque
from railslip_ctrl.controllers.systems import wheel_slip_loop
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.design.envelope import Envelope, EnvelopePoints
from railslip_ctrl.design.envelope_tuning import operating_plants
from railslip_ctrl.design.judging import Judgement
from railslip_ctrl.model.adhesion import AdhesionLaw, ReferenceSlip, in_reading
from railslip_ctrl.model.linearization import OperatingPoint, linearize_rolling
from railslip_ctrl.model.vehicle import Actuator, Rail, Vehicle
from railslip_ctrl.simulation import BrakeLimits, Run, Scenario, Simulator, stop
from railslip_ctrl.simulation.bound import ClairvoyantStop, attainable_stop, clairvoyant_stop
from railslip_ctrl.simulation.run import REACHED_SHARE

SLIDING = 0.5  #: slip ratio, halfway to a locked wheel


@dataclass(frozen=True)
class Stop:
    """One controller in one stop."""

    controller: str
    law: str  # the adhesion law's name
    rail: Rail
    load: str  # "empty" or "loaded"
    run: Run  # the longest of all seeds, recorded
    others: tuple[Run, ...]  # of the other seeds
    bound: ClairvoyantStop | None  # what no controller of this brake beats; None where none is known
    held: float  # median of slip over the second half of the time under control, without the noise and the start
    reference: float  # the slip ratio to be held, or of a controller that has its `own_slip`, that of the law
    cut_out: float = 0.0  # m/s: below, the slip is not controlled
    brake: str = ""  # the actuator's tolerances in words; empty: as given
    attainable: ClairvoyantStop | None = None  # a stop without noise that one can have who knows the rail; or None
    own_slip: bool = False  # whether the controller finds its slip, or is known by its step alone
    brake_torque: float = math.inf  # N*m, the largest, with which the bound is

    @property
    def swings(self) -> bool:
        """Whether under control in `run` the braked wheel turns faster than the train, by half the reference slip: it
        oscillates."""
        signals = self.run.signals
        assert signals is not None, "the run is recorded"
        controlled = signals.speed > self.cut_out
        return bool(signals.slip[controlled].min(initial=0.0) < -0.5 * self.reference)

    @property
    def distance(self) -> float:
        """The longest braking distance of all seeds, m; inf if one does not stop."""
        return stopping_distance(self.run)

    @property
    def runs(self) -> tuple[Run, ...]:
        """Of all seeds, in their order."""
        return tuple(sorted((self.run, *self.others), key=lambda run: run.seed or 0))

    @property
    def reached(self) -> bool:
        """Whether the slip comes to 0.95 of the reference."""
        return self.held >= REACHED_SHARE * self.reference

    @property
    def max_slip(self) -> float:
        """Highest slip ratio with any seed."""
        return max(run.max_slip for run in self.runs)

    @property
    def slides(self) -> bool:
        """Whether the slip passes one half, halfway to a locked wheel, with some seed."""
        return self.max_slip > SLIDING

    @property
    def locks(self) -> bool:
        """Whether the wheel locks with some seed."""
        return any(run.locked_fraction > 0 for run in self.runs)

    @property
    def over_bound(self) -> float:
        """`distance` over the bound, less 1; NaN without either."""
        if self.bound is None or not self.run.stopped or math.isinf(self.bound.braking_distance):
            return math.nan
        return self.distance / self.bound.braking_distance - 1


@dataclass(frozen=True)
class RollingLoop:
    """The recommended loop about free rolling (`linearize_rolling`), of a law with which the wheel oscillates.

    `frequency` is that at which the wheel swings against its contact without a loop, rad/s.
    """

    law: str
    load: str
    rail: Rail
    frequency: float
    stable: bool


SEEDS = (0, 1, 2, 3)  #: of the noise; statistics over many are the campaign's
LOG_PERIOD = 0.01  #: s, between the samples of a recorded run: those of `railslip simulate`


def as_run(design: Any, judgement: Judgement, hand_over_kmh: float, name: str = "") -> LinearControl:
    """A linear design as `braking_control` runs it at the points of a judgement; where their laws hold different slips,
    those of the law of the first stops."""
    operating = operating_points(judgement.points)
    first = min((point.law for point in operating), key=lambda law: law.has_state).name  # a static one has a bound
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
    loads = dict.fromkeys(judgement.points.load[judgement.points.operating].tolist())
    names = sorted({point.law.name: point.law.has_state for point in operating}.items(), key=lambda one: one[1])
    laws = [name for name, _ in names] if every_law else [names[0][0]]
    return tuple(
        _stop(control, stop_scenario(judgement.envelope, judgement.points, law, load, rail), load)
        for law, load, rail in product(laws, loads, judgement.envelope.rails)
    )


def stop_scenario(envelope: Envelope, points: EnvelopePoints, law: str, load: str, rail: Rail) -> Scenario:
    """The stop of a load on a rail with a law of the envelope, by name."""
    of_load = np.flatnonzero(points.operating & (points.load == load))
    point = next(p for p in (points.plants[int(points.plant[i])].point for i in of_load) if p.law.name == law)
    car: Vehicle = point.vehicle
    own: str | AdhesionLaw = law if law in envelope.laws else in_reading(point.law.on(Rail.DRY), car)
    return stop(car, rail, speed_kmh=envelope.initial_speed, adhesion=own)


def tolerance_stops(nominal: Sequence[Stop], control: Any, judgement: Judgement) -> tuple[Stop, ...]:
    """The nominal stops with each end of the tolerances on dead time and lag."""
    envelope = judgement.envelope
    actuator = envelope.vehicle.actuator
    found = []
    for one in nominal:
        scenario = stop_scenario(envelope, judgement.points, one.law, one.load, one.rail)
        for late, slow in product(*(sorted({min(axis), max(axis)}) for axis in (envelope.dead_time, envelope.lag))):
            brake = Actuator(dead_time=late * actuator.dead_time, lag=slow * actuator.lag)
            car = scenario.vehicle.model_copy(update={"actuator": brake})
            words = f"dead time {100 * (late - 1):+.3g} %, lag {100 * (slow - 1):+.3g} %"
            found.append(_stop(control, scenario.with_changes(vehicle=car), one.load, SEEDS[:1], words))
    return tuple(found)


def stopping_distance(run: Run) -> float:
    """Braking distance of a run, m; inf if it does not stop."""
    return run.braking_distance if run.stopped else math.inf


def _stop(control: Any, scenario: Scenario, load: str, seeds: tuple[int, ...] = SEEDS, brake: str = "") -> Stop:
    simulator, limited = Simulator(scenario, control), braked(scenario, control)
    every, held = max(round(LOG_PERIOD / simulator.period), 1), control.reference or scenario.adhesion.reference
    # without what is not shown, and much to be sent from another process
    runs = [replace(simulator.run(seed, record_every=every), controller_signals={}) for seed in seeds]
    run, cut_out = max(runs, key=stopping_distance), control.controlled_from
    return Stop(
        control.label,
        scenario.adhesion.name,
        scenario.rail,
        load,
        run,
        tuple(replace(one, signals=None) for one in runs if one is not run),
        None if brake else _known(clairvoyant_stop, limited),
        _held(run, cut_out),
        math.nan if held is None else held.on(scenario.rail),
        cut_out,
        brake,
        own_slip=not control.follows_reference,
        brake_torque=limited.limits.torque_max or math.inf,
    )


def rolling_loops(nominal: Sequence[Stop], design: Any, judgement: Judgement) -> tuple[RollingLoop, ...]:
    """Exact loops about free rolling, where the stops oscillate. An operating point of constant slip shows nothing of
    it: there a dynamic law slides."""
    found = []
    for one in nominal:
        if one.swings:
            scenario = stop_scenario(judgement.envelope, judgement.points, one.law, one.load, one.rail)
            plant = linearize_rolling(scenario.law(one.rail), scenario.vehicle, scenario.initial_speed)
            stable = wheel_slip_loop(plant, design).is_stable()
            found.append(RollingLoop(one.law, one.load, one.rail, float(abs(plant.poles).max()), stable))
    return tuple(found)


def _held(run: Run, cut_out: float) -> float:
    """The median of slip over the second half of the time in which it is controlled, above the `cut_out` speed, m/s."""
    assert run.signals is not None, "the run is recorded"
    slip = run.signals.slip[run.signals.speed > cut_out]
    return float(np.median(slip[slip.size // 2 :]))


def braked(scenario: Scenario, control: Any) -> Scenario:
    """The scenario with the largest torque of the vehicle's brake, or of a controller that asks for more."""
    most = max(full_brake_torque(scenario.vehicle), control.largest_torque)
    return scenario if math.isinf(most) else scenario.with_changes(limits=BrakeLimits(torque_max=most))


def attainable_stops(scenarios: Sequence[Scenario]) -> list[ClairvoyantStop | None]:
    """What can be had in each by one who knows the rail; None where that is not known."""
    return [_known(attainable_stop, scenario) for scenario in scenarios]


@lru_cache(64)
def _known(stop: Callable[[Scenario], ClairvoyantStop], scenario: Scenario) -> ClairvoyantStop | None:
    try:
        return stop(scenario)
    except InputError:
        return None
