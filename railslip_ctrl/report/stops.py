"""Simulated stops of a design report, with the adhesion laws and loads of the envelope.

In nominal stops, sensors and brake have no errors, and the rail is dry or wet. In harder stops, sensors and brake have
errors, or a dry rail turns wet and dry again.
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

SLIDING = 0.5  #: slip ratio above which a wheel slides: halfway to a locked wheel


@dataclass(frozen=True)
class Stop:
    """One stop with one controller, simulated with one or more noise seeds."""

    controller: str
    law: str  # name of the adhesion law
    rail: Rail
    load: str  # "empty" or "loaded"
    run: Run  # longest run of all seeds, with its signals
    others: tuple[Run, ...]  # runs with the other seeds, without signals
    settled_slip: float  # median slip ratio over the second half of the time under control of `run`
    reference: float  # slip ratio to hold; for a controller with `own_slip` the law's reference slip
    cut_out: float = 0.0  # m/s, speed below which slip is not controlled
    errors: str = ""  # errors of sensors and brake, or change of rail, as text; empty in nominal stops
    bound: ClairvoyantStop | None = None  # lower bound of the stop with this brake; None if unknown
    attainable: ClairvoyantStop | None = None  # best stop if the rail is known, without noise; None if unknown
    own_slip: bool = False  # true if the controller does not follow the reference slip
    brake_torque: float = math.inf  # N*m, largest torque, used for the bound
    locked_from: float = 0.0  # m/s, highest train speed with a locked wheel over all seeds; 0 without a lock
    air: float = 0.0  # mean sum of all rises of the torque over the full brake torque, a ratio

    @property
    def swings(self) -> bool:
        """True if the wheel oscillates: while slip is controlled, the slip ratio falls below -reference/2."""
        signals = self.run.signals
        assert signals is not None, "the run is recorded"
        controlled = signals.speed > self.cut_out
        return bool(signals.slip[controlled].min(initial=0.0) < -0.5 * self.reference)

    @property
    def braked_scenario(self) -> Scenario:
        most = self.brake_torque
        return self.run.scenario if math.isinf(most) else _limited(self.run.scenario, most)

    @property
    def distance(self) -> float:
        """Longest braking distance of all seeds, m; inf if a run does not stop."""
        return stopping_distance(self.run)

    @property
    def runs(self) -> tuple[Run, ...]:
        return tuple(sorted((self.run, *self.others), key=lambda run: run.seed or 0))

    @property
    def reached(self) -> bool:
        """True if `settled_slip` is at least 95 % of the reference slip."""
        return self.settled_slip >= REACHED_SHARE * self.reference

    @property
    def max_slip(self) -> float:
        return max(run.max_slip for run in self.runs)

    @property
    def slides(self) -> bool:
        return self.max_slip > SLIDING

    @property
    def locks(self) -> bool:
        return any(run.locked_fraction > 0 for run in self.runs)

    @property
    def over_bound(self) -> float:
        """Ratio `distance`/bound - 1; NaN if a run does not stop or the bound is unknown."""
        if self.bound is None or not self.run.stopped or math.isinf(self.bound.braking_distance):
            return math.nan
        return self.distance / self.bound.braking_distance - 1


@dataclass(frozen=True)
class RollingLoop:
    """Loop of the recommended design, linearised at slip 0, for a nominal stop in which the wheel oscillates.

    - frequency: natural frequency of the rolling wheel on the elastic contact, without control, rad/s.
    - stable: true if the closed loop is stable.
    """

    law: str
    load: str
    rail: Rail
    frequency: float
    stable: bool


SEEDS = (0, 1)  #: noise seeds of a nominal stop; a campaign runs more seeds
NARROW = "polach"
"""Adhesion law with a narrow peak; if the user chose no laws, stops with this law are simulated too."""

ERRORS: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        name: (1 - error, 1 + error)
        for name, error in (("torque", GAIN), ("train speed", SPEED_SCALE), ("radius", RADIUS))
    }
)
"""Smallest and largest factors on acting torque, measured train speed and wheel radius in stops with errors."""

TEETH = float(min(ENCODERS))
"""Number of teeth of the wheel encoder in half of the stops with errors; the others have no encoder and no noise."""

# distances at which the rail turns wet and dry again, over the square of the initial speed, s^2/m: 50 and 120 m at
# 100 km/h, about a quarter and a half of a stop from any speed
_WET, _DRY_AGAIN = 0.065, 0.155
_TWO_LEVELS = np.array([[(i >> k & 1) for k in range(3)] for i in range(8)])
_ARRAY = np.column_stack([_TWO_LEVELS, _TWO_LEVELS[:, [0, 0, 1]] ^ _TWO_LEVELS[:, [1, 2, 2]], _TWO_LEVELS.sum(1) % 2])
# orthogonal array L8: seven errors with two levels in eight stops; each pair of levels of two errors occurs twice
LOG_PERIOD = 0.01  #: s, interval between recorded samples of a run, as in `railslip simulate`


def as_run(design: Any, judgement: Judgement, hand_over_kmh: float, name: str = "") -> LinearControl:
    """Controller that runs a linear design in stops, with the reference slip at which the design was judged."""
    operating = operating_points(judgement.points)
    reference = judgement.envelope.reference or as_reference(operating)
    return braking_control(
        design, operating, reference, name=name or design.structure.lower(), hand_over_kmh=hand_over_kmh
    )


def as_reference(operating: Sequence[OperatingPoint]) -> ReferenceSlip:
    """Reference slips: the slips of the operating points with one adhesion law, which is static if a static law exists.

    If the law has points on only one rail, the slip on this rail is used for the other rail too.
    """
    first = min((point.law for point in operating), key=lambda law: law.has_state).name  # static laws come first
    slips = {point.rail: point.slip for point in operating if point.law.name == first}
    return ReferenceSlip(**{rail.value: slips.get(rail, next(iter(slips.values()))) for rail in Rail})


def operating_points(points: EnvelopePoints) -> list[OperatingPoint]:
    """Operating points of an envelope."""
    return [plant.point for plant in operating_plants(points)]


def stops(control: Any, judgement: Judgement, *, every_law: bool = True) -> tuple[Stop, ...]:
    """Nominal stops, one for each law, load and rail of the envelope; if not `every_law`, only for the first law."""
    laws = laws_of_stops(judgement) if every_law else laws_of_stops(judgement)[:1]
    return tuple(
        _stop(control, stop_scenario(judgement.envelope, judgement.points, law, load, rail), load)
        for law, load, rail in product(laws, _loads(judgement), judgement.envelope.rails)
    )


def laws_of_stops(judgement: Judgement) -> list[str]:
    """Names of the adhesion laws of the envelope, and `NARROW` if the user chose no laws; static laws come first."""
    operating = operating_points(judgement.points)
    dynamic = {point.law.name: point.law.has_state for point in operating}
    if judgement.envelope.laws == Envelope.model_fields["laws"].default:
        dynamic[NARROW] = False
    return sorted(dynamic, key=lambda name: dynamic[name])


def _loads(judgement: Judgement) -> list[str]:
    return list(dict.fromkeys(judgement.points.load[judgement.points.operating].tolist()))


def stop_scenario(envelope: Envelope, points: EnvelopePoints, law: str, load: str, rail: Rail) -> Scenario:
    """Scenario of the nominal stop with an adhesion law, a load ("empty" or "loaded") and a rail."""
    of_load = np.flatnonzero(points.operating & (points.load == load))
    here = [points.plants[int(points.plant[i])].point for i in of_load]
    point = next((item for item in here if item.law.name == law), None)
    car: Vehicle = here[0].vehicle
    if point is None or law in envelope.laws:
        own = named_law(law, car, envelope.law_speed * KMH)
    else:
        own = in_reading(point.law.on(Rail.DRY), car)
    return stop(car, rail, speed_kmh=envelope.initial_speed, adhesion=own)


def harder_scenarios(judgement: Judgement) -> Iterator[tuple[Scenario, str, str]]:
    """Yield scenario, description of the errors, and load of each harder stop.

    Each adhesion law has eight scenarios, whose errors are combined by an orthogonal array. If the envelope has both
    rails, each law and load has one more scenario, in which the rail turns wet and dry again.
    """
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


CHANGES = "turns wet and dry again"  #: description of the rail


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
    errors = [f"{name} {100 * (value - 1):+.3g} %" for name, value in chosen.items() if value != 1.0]
    return wrong, ", ".join([*errors, *(["speed noise, encoder"] if sensors else [])])


def harder_stops(control: Any, judgement: Judgement) -> tuple[Stop, ...]:
    """Stops of `harder_scenarios`, each with one noise seed."""
    return tuple(_stop(control, item, load, SEEDS[:1], errors) for item, errors, load in harder_scenarios(judgement))


def locks_at_once(control: Any, judgement: Judgement, above: float, *, hard: bool) -> bool:
    """True if a wheel locks above the speed `above`, m/s, in a nominal stop or, if `hard`, in a harder stop."""
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
    # drop signals that are not shown, because the result is sent to another process
    runs = [replace(simulator.run(seed, record_every=every), controller_signals={}) for seed in seeds]
    run, cut_out = max(runs, key=stopping_distance), control.controlled_from
    most = braked(scenario, control).limits.torque_max or math.inf
    result = Stop(
        control.label,
        scenario.adhesion.name,
        scenario.rail,
        load,
        run,
        tuple(replace(item, signals=None) for item in runs if item is not run),
        _settled_slip(run, cut_out),
        math.nan if held is None else held.on(scenario.rail),
        cut_out,
        errors,
        own_slip=not control.follows_reference,
        brake_torque=most,
        locked_from=max(_locked_from(item) for item in runs),
        air=float(np.mean([_filled(item) for item in runs])) / full_brake_torque(scenario.vehicle),
    )
    return replace(result, run=replace(run, signals=None)) if errors else result


def _locked_from(run: Run) -> float:
    assert run.signals is not None, "the run is recorded"
    return float(run.signals.speed[run.signals.slip > 1 - LOCKED_SHARE].max(initial=0.0))


def _filled(run: Run) -> float:
    assert run.signals is not None, "the run is recorded"
    return float(np.maximum(np.diff(run.signals.torque, prepend=0.0), 0.0).sum())


def rolling_loops(nominal: Sequence[Stop], design: Any, judgement: Judgement) -> tuple[RollingLoop, ...]:
    """Loops linearised at slip 0, for the nominal stops in which the wheel oscillates."""
    result = []
    for item in nominal:
        if item.swings:
            scenario = stop_scenario(judgement.envelope, judgement.points, item.law, item.load, item.rail)
            plant = linearize_rolling(scenario.law(item.rail), scenario.vehicle, scenario.initial_speed)
            stable = wheel_slip_loop(plant, design).is_stable()
            result.append(RollingLoop(item.law, item.load, item.rail, float(abs(plant.poles).max()), stable))
    return tuple(result)


def _settled_slip(run: Run, cut_out: float) -> float:
    assert run.signals is not None, "the run is recorded"
    slip = run.signals.slip[run.signals.speed > cut_out]
    return float(np.median(slip[slip.size // 2 :])) if slip.size else math.nan


def braked(scenario: Scenario, control: Any) -> Scenario:
    """Scenario with a torque limit: the full brake torque, or the controller's largest torque if that is larger."""
    most = max(full_brake_torque(scenario.vehicle), control.largest_torque)
    return scenario if math.isinf(most) else _limited(scenario, most)


def _limited(scenario: Scenario, most: float) -> Scenario:
    limits = scenario.limits.model_copy(update={"torque_max": most})
    return scenario.with_changes(limits=limits)


def clairvoyant_stops(scenarios: Sequence[Scenario]) -> list[tuple[ClairvoyantStop | None, ClairvoyantStop | None]]:
    """Bound and attainable stop of each scenario; None if it cannot be computed."""
    return [(_known(clairvoyant_stop, scenario), _known(attainable_stop, scenario)) for scenario in scenarios]


@lru_cache(64)
def _known(stop: Callable[[Scenario], ClairvoyantStop], scenario: Scenario) -> ClairvoyantStop | None:
    try:
        return stop(scenario)
    except InputError:
        return None
