"""The braking runs of a design report, of the laws and loads of its envelope.

Plain stops, dry and wet; stops with errors of sensors and brake; stops on a rail that turns wet, and dry again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import chain, product
from types import MappingProxyType
from typing import Any

import numpy as np

from railslip_ctrl.controllers.braking import braking_control
from railslip_ctrl.controllers.linear import LinearControl, full_brake_torque
from railslip_ctrl.controllers.systems import wheel_slip_loop
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH
from railslip_ctrl.design.envelope import Envelope, EnvelopePoints
from railslip_ctrl.design.envelope_tuning import operating_plants
from railslip_ctrl.design.judging import Judgement
from railslip_ctrl.model.adhesion import ReferenceSlip, in_reading, named_law
from railslip_ctrl.model.linearization import OperatingPoint, linearize_rolling
from railslip_ctrl.model.vehicle import Actuator, Rail, Vehicle
from railslip_ctrl.simulation import BrakeLimits, Event, Measurement, Run, Scenario, Simulator, stop
from railslip_ctrl.simulation.bound import ClairvoyantStop, attainable_stop, clairvoyant_stop
from railslip_ctrl.simulation.population import GAIN, RADIUS, SPEED_NOISE, SPEED_SCALE
from railslip_ctrl.simulation.population import TEETH as ENCODERS
from railslip_ctrl.simulation.run import LOCKED_SHARE, REACHED_SHARE

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
    held: float  # median of slip over the second half of the time under control, without the noise and the start
    reference: float  # the slip ratio to be held, or of a controller that has its `own_slip`, that of the law
    cut_out: float = 0.0  # m/s: below, the slip is not controlled
    errors: str = ""  # those of sensors and brake, or the change of rail, in words; empty: as given
    bound: ClairvoyantStop | None = None  # no controller of this brake stops sooner; None if not known or not asked for
    attainable: ClairvoyantStop | None = None  # without noise, by a controller that knows the rail; None as of `bound`
    own_slip: bool = False  # whether the controller finds its slip, or is known by its step alone
    brake_torque: float = math.inf  # N*m, the largest, with which the bound is
    locked_from: float = 0.0  # m/s, the highest train speed at which the wheel was locked with some seed; 0: none
    air: float = 0.0  # mean of the torque that was filled in, over the vehicle's full brake torque

    @property
    def swings(self) -> bool:
        """Whether under control in `run` the braked wheel turns faster than the train, by half the reference slip: it
        oscillates."""
        signals = self.run.signals
        assert signals is not None, "the run is recorded"
        controlled = signals.speed > self.cut_out
        return bool(signals.slip[controlled].min(initial=0.0) < -0.5 * self.reference)

    @property
    def braked_scenario(self) -> Scenario:
        """Its scenario, with the largest torque of the brake."""
        most = self.brake_torque
        return self.run.scenario if math.isinf(most) else _limited(self.run.scenario, most)

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


SEEDS = (0, 1)  #: of the noise; statistics over many are the campaign's
NARROW = "polach"
"""Law with a narrow peak, in the stops if no laws were chosen. The default envelope is without it: it has no reference
slip, and with tolerances no design that holds a share of its peak's slip is robust."""

ERRORS: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        name: (1 - error, 1 + error)
        for name, error in (("torque", GAIN), ("train speed", SPEED_SCALE), ("radius", RADIUS))
    }
)
"""Factors on acting torque, measured train speed and wheel radius, the ends of the population's; the controller assumes
1."""

TEETH = float(min(ENCODERS))
"""Teeth of the wheel's encoder in half of the stops with errors, which have the population's speed noise too."""

# places of the change, m, over the square of the initial speed, s^2/m: 50 and 120 m at 100 km/h, which is a quarter and
# a half of a stop from any speed
_WET, _DRY_AGAIN = 0.065, 0.155
_TWO_LEVELS = np.array([[(i >> k & 1) for k in range(3)] for i in range(8)])
_ARRAY = np.column_stack([_TWO_LEVELS, _TWO_LEVELS[:, [0, 0, 1]] ^ _TWO_LEVELS[:, [1, 2, 2]], _TWO_LEVELS.sum(1) % 2])
# orthogonal array L8: seven errors at two levels in eight stops, every two of them in each combination twice
LOG_PERIOD = 0.01  #: s, between the samples of a recorded run: those of `railslip simulate`


def as_run(design: Any, judgement: Judgement, hand_over_kmh: float, name: str = "") -> LinearControl:
    """A linear design as `braking_control` runs it at the points of a judgement; where their laws hold different slips,
    those of the law of the first stops."""
    operating = operating_points(judgement.points)
    reference = judgement.envelope.reference or as_reference(operating)
    return braking_control(
        design, operating, reference, name=name or design.structure.lower(), hand_over_kmh=hand_over_kmh
    )


def as_reference(operating: Sequence[OperatingPoint]) -> ReferenceSlip:
    """The slips of the law of the first stops; on a rail that is not among the points the other's."""
    first = min((point.law for point in operating), key=lambda law: law.has_state).name  # a static one has a bound
    slips = {point.rail: point.slip for point in operating if point.law.name == first}
    return ReferenceSlip(**{rail.value: slips.get(rail, next(iter(slips.values()))) for rail in Rail})


def operating_points(points: EnvelopePoints) -> list[OperatingPoint]:
    """The operating points of an envelope."""
    return [plant.point for plant in operating_plants(points)]


def stops(control: Any, judgement: Judgement, *, every_law: bool = True) -> tuple[Stop, ...]:
    """A stop from the envelope's initial speed on each of its rails and loads, with the static law first."""
    laws = laws_of_stops(judgement) if every_law else laws_of_stops(judgement)[:1]
    return tuple(
        _stop(control, stop_scenario(judgement.envelope, judgement.points, law, load, rail), load)
        for law, load, rail in product(laws, _loads(judgement), judgement.envelope.rails)
    )


def laws_of_stops(judgement: Judgement) -> list[str]:
    """Names of the laws, static ones first, and `NARROW` too where no laws were chosen."""
    operating = operating_points(judgement.points)
    dynamic = {point.law.name: point.law.has_state for point in operating}
    if judgement.envelope.laws == Envelope.model_fields["laws"].default:
        dynamic[NARROW] = False
    return sorted(dynamic, key=lambda name: dynamic[name])


def _loads(judgement: Judgement) -> list[str]:
    return list(dict.fromkeys(judgement.points.load[judgement.points.operating].tolist()))


def stop_scenario(envelope: Envelope, points: EnvelopePoints, law: str, load: str, rail: Rail) -> Scenario:
    """The stop of a load on a rail with a law of the envelope, by name."""
    of_load = np.flatnonzero(points.operating & (points.load == load))
    here = [points.plants[int(points.plant[i])].point for i in of_load]
    point = next((one for one in here if one.law.name == law), None)
    car: Vehicle = here[0].vehicle
    if point is None or law in envelope.laws:
        own = named_law(law, car, envelope.law_speed * KMH)
    else:
        own = in_reading(point.law.on(Rail.DRY), car)
    return stop(car, rail, speed_kmh=envelope.initial_speed, adhesion=own)


def harder_scenarios(judgement: Judgement) -> Iterator[tuple[Scenario, str, str]]:
    """Stops with errors of sensors and brake, eight on each law by an orthogonal array, its rails in turn; and on each
    law and load one on a dry rail that turns wet and dry again; with what is wrong in words, and the load."""
    envelope, loads = judgement.envelope, _loads(judgement)
    for (i, law), (k, row) in product(enumerate(laws_of_stops(judgement)), enumerate(_ARRAY.tolist())):
        rail = envelope.rails[(i + k) % len(envelope.rails)]
        scenario = stop_scenario(judgement.envelope, judgement.points, law, loads[row[6] % len(loads)], rail)
        yield (*_with_errors(scenario, envelope, row), loads[row[6] % len(loads)])
    if len(envelope.rails) < len(Rail):
        return
    for law, load in product(laws_of_stops(judgement), loads):
        scenario = stop_scenario(judgement.envelope, judgement.points, law, load, Rail.DRY)
        places = (factor * scenario.initial_speed**2 for factor in (_WET, _DRY_AGAIN))
        events = [Event(distance=place, rail=rail) for place, rail in zip(places, (Rail.WET, Rail.DRY), strict=True)]
        yield scenario.with_changes(events=tuple(events)), CHANGES, load


CHANGES = "turns wet and dry again"
"""In words, of a rail."""


def _with_errors(scenario: Scenario, envelope: Envelope, row: Sequence[int]) -> tuple[Scenario, str]:
    ends = {"dead time": envelope.dead_time, "lag": envelope.lag} | dict(ERRORS)
    chosen = {name: (min(axis), max(axis))[side] for (name, axis), side in zip(ends.items(), row, strict=False)}
    car, brake = scenario.vehicle, scenario.vehicle.actuator
    actuator = Actuator(dead_time=chosen["dead time"] * brake.dead_time, lag=chosen["lag"] * brake.lag)
    wheel = car.wheel.model_copy(update={"radius": chosen["radius"] * car.wheel.radius})
    sensors = {"speed_noise": SPEED_NOISE, "encoder_teeth": TEETH} if row[5] else {}
    wrong = scenario.with_changes(
        vehicle=car.model_copy(update={"actuator": actuator, "wheel": wheel}),
        limits=BrakeLimits(torque_gain=chosen["torque"]),
        measurement=Measurement(speed_scale=chosen["train speed"], **sensors),
    )
    words = [f"{name} {100 * (value - 1):+.3g} %" for name, value in chosen.items() if value != 1.0]
    return wrong, ", ".join([*words, *(["noise and teeth"] if sensors else [])])


def harder_stops(control: Any, judgement: Judgement) -> tuple[Stop, ...]:
    """The stops of `harder_scenarios`, with one seed of the noise each."""
    return tuple(_stop(control, one, load, SEEDS[:1], words) for one, words, load in harder_scenarios(judgement))


def locks_at_once(control: Any, judgement: Judgement, above: float, *, hard: bool) -> bool:
    """Whether in some stop, if `hard` of the harder ones too, the wheel locks above a speed, m/s: ends with the
    first."""
    cases = product(laws_of_stops(judgement), _loads(judgement), judgement.envelope.rails)
    plain = ((stop_scenario(judgement.envelope, judgement.points, law, load, rail), load) for law, load, rail in cases)
    harder = ((scenario, load) for scenario, _, load in harder_scenarios(judgement)) if hard else ()
    every = chain(plain, harder)
    return any(_stop(control, scenario, load, SEEDS[:1], CHANGES).locked_from > above for scenario, load in every)


def stopping_distance(run: Run) -> float:
    """Braking distance of a run, m; inf if it does not stop."""
    return run.braking_distance if run.stopped else math.inf


def _stop(control: Any, scenario: Scenario, load: str, seeds: tuple[int, ...] = SEEDS, errors: str = "") -> Stop:
    simulator = Simulator(scenario, control)
    every, held = max(round(LOG_PERIOD / simulator.period), 1), control.reference or scenario.adhesion.reference
    # without what is not shown, and much to be sent from another process
    runs = [replace(simulator.run(seed, record_every=every), controller_signals={}) for seed in seeds]
    run, cut_out = max(runs, key=stopping_distance), control.controlled_from
    most = braked(scenario, control).limits.torque_max or math.inf
    found = Stop(
        control.label,
        scenario.adhesion.name,
        scenario.rail,
        load,
        run,
        tuple(replace(one, signals=None) for one in runs if one is not run),
        _held(run, cut_out),
        math.nan if held is None else held.on(scenario.rail),
        cut_out,
        errors,
        own_slip=not control.follows_reference,
        brake_torque=most,
        locked_from=max(_locked_from(one) for one in runs),
        air=float(np.mean([_filled(one) for one in runs])) / full_brake_torque(scenario.vehicle),
    )
    return replace(found, run=replace(run, signals=None)) if errors else found


def _locked_from(run: Run) -> float:
    """The highest train speed, m/s, at which the wheel was locked; 0: it was not."""
    assert run.signals is not None, "the run is recorded"
    return float(run.signals.speed[run.signals.slip > 1 - LOCKED_SHARE].max(initial=0.0))


def _filled(run: Run) -> float:
    """All that the acting torque rose by, N*m."""
    assert run.signals is not None, "the run is recorded"
    return float(np.maximum(np.diff(run.signals.torque, prepend=0.0), 0.0).sum())


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
    """The median of slip over the second half of the time in which it is controlled, above the `cut_out` speed, m/s;
    NaN where it never is."""
    assert run.signals is not None, "the run is recorded"
    slip = run.signals.slip[run.signals.speed > cut_out]
    return float(np.median(slip[slip.size // 2 :])) if slip.size else math.nan


def braked(scenario: Scenario, control: Any) -> Scenario:
    """The scenario with the largest torque of the vehicle's brake, or of a controller that asks for more."""
    most = max(full_brake_torque(scenario.vehicle), control.largest_torque)
    return scenario if math.isinf(most) else _limited(scenario, most)


def _limited(scenario: Scenario, most: float) -> Scenario:
    limits = scenario.limits.model_copy(update={"torque_max": most})
    return scenario.with_changes(limits=limits)


def clairvoyant_stops(scenarios: Sequence[Scenario]) -> list[tuple[ClairvoyantStop | None, ClairvoyantStop | None]]:
    """The bound of each stop, and the attainable stop; None where it is not known."""
    return [(_known(clairvoyant_stop, scenario), _known(attainable_stop, scenario)) for scenario in scenarios]


@lru_cache(64)
def _known(stop: Callable[[Scenario], ClairvoyantStop], scenario: Scenario) -> ClairvoyantStop | None:
    try:
        return stop(scenario)
    except InputError:
        return None
