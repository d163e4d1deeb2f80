"""Computation of a design report, and its records.

`design_report` tunes each linear structure over the envelope (`Selection`). It runs the most robust designs, and every
kind that follows from the vehicle alone, in the same stops (`Trial`), and takes the best by `ordered`. For that one it
computes margins, limits and gain maps and, if no candidate qualifies, a remedy (`DesignReport`).
"""

from __future__ import annotations

import datetime
import math
import pickle
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from railslip_ctrl.controllers.base import Controller
from railslip_ctrl.controllers.files import as_control
from railslip_ctrl.controllers.pi import PI
from railslip_ctrl.controllers.slide_protection import SlideProtection
from railslip_ctrl.controllers.systems import PIController, linear_controller, linear_of
from railslip_ctrl.core.errors import InputError, RailslipError
from railslip_ctrl.core.folders import cache_folder, cached, look_up
from railslip_ctrl.core.processes import cpu_count, processes
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH
from railslip_ctrl.design.assessment import limits_of, slip_responses
from railslip_ctrl.design.envelope import Envelope
from railslip_ctrl.design.envelope_tuning import (
    Selection,
    StructureChoice,
    hand_over_of,
    select,
)
from railslip_ctrl.design.judging import Judgement, WorstCase, judge, judge_points, margins_at
from railslip_ctrl.design.limits import Limits
from railslip_ctrl.loop.deadtime import FrequencyCurve, frequency_curve
from railslip_ctrl.loop.responses import TimeResponse
from railslip_ctrl.model.adhesion import law_names
from railslip_ctrl.model.linearization import OperatingPoint
from railslip_ctrl.model.numeric import Peak, adhesion_coefficient, peak
from railslip_ctrl.model.vehicle import PIGains, Rail, Vehicle
from railslip_ctrl.verification.verdict import NoLock, ReleasedRun, Verification

from . import candidates
from .candidates import SEEKING, Beside, Remedy, Trial
from .stops import (
    RollingLoop,
    Stop,
    as_run,
    clairvoyant_stops,
    operating_points,
    rolling_loops,
    stops,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


@dataclass(frozen=True)
class LawCurve:
    """Adhesion coefficient over the slip ratio for a law, rail and speed, and its peak."""

    point: OperatingPoint
    slip: Floats
    coefficient: Floats
    peak: Peak


@dataclass(frozen=True)
class ShownLoop:
    """A loop for a picture: its label, the loop, and its frequency response."""

    label: str
    loop: Any
    curve: FrequencyCurve


@dataclass(frozen=True)
class GainMap:
    """Worst Ms at operating points over kp (m,) and ki (n,) with the design's lead, (m, n); inf if unstable."""

    kp: Floats
    ki: Floats
    ms: Floats
    chosen: tuple[float, float]
    points: int


@dataclass(frozen=True)
class Responses:
    """Responses of the recommended design to a step of the reference slip velocity and of torque at the wheel."""

    point: OperatingPoint
    load_step: float
    reference: TimeResponse
    load: TimeResponse


@dataclass(frozen=True)
class Sliding:
    """Conditions of the predictive sliding-mode law; None with the reason if they are not known."""

    verification: Verification | None
    reason: str = ""


@dataclass(frozen=True)
class Released:
    """A recorded stop of the recommended design beside the certified no-lock region of its law, load and rail.

    `region` is computed only for stops that are drawn. Both fields are None with the reason if there is no certificate.
    """

    stop: Stop
    certified: ReleasedRun | None = None
    region: NoLock | None = None
    reason: str = ""


@dataclass(frozen=True)
class HeldElsewhere:
    """Slip ratios held in stops on a law and rail but not judged, and the worst Ms there, inf if unstable."""

    law: str
    rail: Rail
    slips: tuple[float, ...]
    ms: float


@dataclass(frozen=True)
class Rival:
    """A user's controller, run beside the recommended one, and judged, or the `reason` why it cannot be judged."""

    name: str
    judgement: Judgement | None
    stops: tuple[Stop, ...]
    reason: str = ""

    @property
    def above_kmh(self) -> float | None:
        """Speed, km/h, above which it may be used, by its margins and the stops as given; see `Trial`."""
        robust = None if self.judgement is None else self.judgement.robust_from_kmh
        return None if any(stop.locked_from > stop.cut_out for stop in self.stops) else robust


@dataclass(frozen=True)
class DesignReport:
    """Content of a report on a vehicle; fields without content are empty or None."""

    envelope: Envelope  # the envelope of the design, with the vehicle
    nominal: bool  # whether only operating points are judged
    selection: Selection  # the linear designs, the best first
    trials: tuple[Trial, ...] = ()  # every candidate that ran, the best first
    control: Controller | None = None  # the recommended controller as in `recommended.toml`
    above_kmh: float | None = None  # speed of the best trial from which it qualifies
    # judged from `above_kmh` or the hand-over up; if it is None, at all speeds at which it is stable, or at all speeds;
    # None without margins
    in_use: Judgement | None = None
    worst_loops: tuple[ShownLoop, ...] = ()  # loops at the worst operating point, and at the worst with tolerances
    stops: tuple[Stop, ...] = ()  # stops of the recommended design
    harder_stops: tuple[Stop, ...] = ()  # its stops with errors of sensors and brake, and on a changing rail
    held_elsewhere: tuple[HeldElsewhere, ...] = ()  # slips that the seeking controller holds but that were not judged
    rolling: tuple[RollingLoop, ...] = ()  # loops for the laws and loads with which the wheel oscillates
    rivals: tuple[Rival, ...] = ()  # the user's controllers
    limits: tuple[tuple[OperatingPoint, Limits], ...] = ()  # limits of any controller, hardest for each rail and load
    curves: tuple[LawCurve, ...] = ()
    gains: GainMap | None = None
    responses: Responses | None = None
    remedy: Remedy | None = None  # change of the brake that helps if no candidate qualifies
    prefer: str = "distance"
    sliding: Sliding = Sliding(None)
    released: tuple[Released, ...] = ()  # no-lock regions of the recommended design's stops
    seconds: float = math.nan
    date: datetime.date = field(default_factory=datetime.date.today)

    @property
    def vehicle(self) -> Vehicle:
        """Vehicle with its empty mass."""
        return self.envelope.vehicle

    @property
    def best(self) -> StructureChoice | None:
        """The recommended choice."""
        return self.trials[0].choice if self.trials else None

    @property
    def judgement(self) -> Judgement | None:
        """Judgement of the best design over the whole envelope."""
        return None if self.best is None or self.best.design is None else self.best.design.judgement

    @property
    def judged_envelope(self) -> Envelope:
        """Envelope with the additional speeds of the best design."""
        return self.envelope if self.judgement is None else self.judgement.envelope

    @property
    def hands_over(self) -> bool:
        """Whether the controller stops controlling slip below some speed."""
        return self.usable and self.control is not None and self.control.controlled_from > 0

    @property
    def seeking(self) -> Trial | None:
        """Trial of the seeking controller; None if it has no gains for this vehicle."""
        return next((trial for trial in self.trials if trial.choice.structure == SEEKING), None)

    @property
    def peer(self) -> Trial | None:
        """Trial of the rule-based slide protection."""
        return next((trial for trial in self.trials if trial.choice.structure == SlideProtection.kind), None)

    @property
    def qualified(self) -> tuple[Trial, ...]:
        """Candidates that qualify, the best first."""
        return tuple(trial for trial in self.trials if trial.above_kmh is not None)

    def trial_of(self, choice: StructureChoice) -> Trial | None:
        """Trial of a choice; None if it did not run."""
        return next((trial for trial in self.trials if trial.choice is choice), None)

    @property
    def usable(self) -> bool:
        """Whether a design can be used."""
        return self.above_kmh is not None

    @property
    def longest_stops(self) -> tuple[Stop, ...]:
        """Longest stop on each rail over all laws and loads, for the first page."""
        return longest(self.stops)


def longest(stops: Sequence[Stop]) -> tuple[Stop, ...]:
    """Longest stop on each rail."""
    rails = dict.fromkeys(stop.rail for stop in stops)
    return tuple(max((s for s in stops if s.rail is rail), key=lambda s: s.distance) for rail in rails)


def restricted(judgement: Judgement, from_kmh: float) -> Judgement:
    """Judgement over the speeds from `from_kmh`, km/h, up."""
    from_kmh *= 1 - 1e-9  # rounding of the conversion from m/s
    kept = judgement.points.speed_kmh >= from_kmh
    columns: dict[str, Any] = {name: values[kept] for name, values in vars(judgement.margins).items()}
    speeds = tuple(v for v in judgement.envelope.speeds if v >= from_kmh)
    envelope = judgement.envelope.at(speeds=speeds)
    margins = replace(judgement.margins, **columns)
    return replace(judgement, envelope=envelope, points=judgement.points.take(kept), margins=margins)


def laws_of(judgement: Judgement) -> Collection[OperatingPoint]:
    """An operating point of each law and rail, with the first load, at the highest speed."""
    operating = operating_points(judgement.points)
    loads = judgement.points.load[judgement.points.operating].tolist()
    top = max(point.speed for point in operating)
    result: dict[tuple[str, Rail], OperatingPoint] = {}
    for point, load in zip(operating, loads, strict=True):
        if load == loads[0] and point.speed > 0.999 * top:
            result.setdefault((point.law.name, point.rail), point)
    return result.values()


# --- the best design over an envelope, and further results for a design review --------------------------------------


Progress = Callable[[str], None]

LOAD_STEP = 100.0
"""Step of torque at the wheel for the load response, N*m."""

_CACHED = "conditions-predictive"
_LARGEST_SLIP, _SLIPS = 0.5, 401  # end of the adhesion curves, slip ratio, and number of points
_GAINS = 4.0 ** np.linspace(-1.0, 1.0, 21)  # factors on the design's gains; 1 is in the middle
_RESPONSE_TIME, _RESPONSE_POINTS = 10.0, 1001  # s, duration of the responses, and number of points

_QUICK_FILTER = 0.05  # share of the lead, tried beside a tenth: twice the gain on noise, but more integral gain


def design_report(
    envelope: Envelope,
    *,
    nominal: bool = False,
    given: dict[str, Any] | None = None,
    sliding: bool = True,
    fresh: bool = False,
    prefer: str = "distance",
    progress: Progress = lambda message: None,
    meanwhile: Callable[[DesignReport], object] = lambda report: None,
) -> DesignReport:
    """Compute everything that a design review needs for one vehicle.

    - envelope: envelope of the design; `nominal`: judge only its operating points.
    - given: user's controllers by name; they run beside, as their file states, and are judged if they have margins.
    - sliding: also decide the conditions of the predictive sliding-mode law, and where the brake can be released
      without a lock, in another process if there are two cores. `fresh`: do not reuse the conditions of an earlier
      report on the same vehicle.
    - prefer: {"distance", "robustness"}; order of the candidates that qualify, see `ordered`.
    - progress: receives a line for each step.
    - meanwhile: receives the report without rivals and without the results that the other process still computes (gains
      around the design, attainable stops), so that its pictures can be drawn.

    InputError: an envelope without points, or an object that is not a controller.
    """
    started, vehicle, lead = time.perf_counter(), envelope.vehicle, partial(select, envelope, ("pi-lead",))
    rivals: dict[str, Rival] = {}

    def run_beside(item: str, controller: Any) -> None:
        progress(f"{item}, judged and run beside")
        rivals[item] = _rival(item, controller, envelope, nominal)

    for name, controller in (given or {}).items():
        if candidates.no_margins(controller):  # its step may fail: run it before the long work
            run_beside(name, controller)
    with _beside() as submit:
        # the other process cannot import a user's law
        sent = all(isinstance(law, str) and law in law_names() for law in envelope.laws)
        here: Beside = submit if sent else partial
        progress(f"the best design over the envelope of {vehicle.name}")
        plain = here(select, envelope, ("pi",))
        others = [here(candidates.rule_trial, name, envelope, nominal, False) for name in candidates.named(vehicle)]
        conditions: Callable[[], Sliding] = partial(Sliding, None, "not asked for")
        if sliding:
            before = None if fresh else look_up(_CACHED, vehicle.model_dump_json())
            conditions = submit(_verified, vehicle) if before is None else partial(Sliding, before)
        result = lead().choices if vehicle.actuator.lag > 0 else ()
        best = min(result, key=lambda choice: choice.rank, default=None)
        if best is not None and best.design is not None:
            result += lead((best.reference_factor,), _QUICK_FILTER).choices
        selection = Selection(tuple(sorted((*result, *plain().choices), key=lambda choice: choice.rank)))
        report = _designed(envelope, nominal, selection, (here, others), prefer, progress, meanwhile)
        no_locks: Callable[[], tuple[Released, ...]] = here(_released, report.stops) if sliding else tuple
        for name, controller in (given or {}).items():
            if name not in rivals:
                run_beside(name, controller)
        progress("conditions of the predictive sliding-mode law")
        shown = tuple(rivals[name] for name in given or {})
        report = replace(report, rivals=shown, sliding=conditions(), released=no_locks())
        return replace(report, seconds=time.perf_counter() - started)


@contextmanager
def _beside() -> Iterator[Beside]:
    """Run functions in another process if there are two cores."""
    if cpu_count() < 2:
        yield partial
        return
    cache_folder()  # the other process inherits a temporary one
    with processes(1) as submit:
        # pickle now: lazily cached properties could change the object while the pool's thread pickles it
        yield lambda function, *arguments: submit(_called, pickle.dumps((function, arguments))).result


def _called(content: bytes) -> Any:
    function, arguments = pickle.loads(content)
    return function(*arguments)


def _verified(vehicle: Vehicle) -> Sliding:
    """Conditions of the predictive law, or the reason why they cannot be decided for this vehicle."""
    from railslip_ctrl.verification.joint_verification import verify  # imports SymPy, which other reports do not need

    def decide() -> Verification:
        result = verify(law="predictive", vehicle=vehicle)
        return replace(
            result, conditions=tuple(replace(item, numbers={}) for item in result.conditions)
        )  # numbers unused

    try:
        return Sliding(cached(_CACHED, decide, vehicle.model_dump_json(), fresh=True))
    except RailslipError as error:
        return Sliding(None, str(error))


_REGION_SPEEDS = np.array([1.0, 0.8, 0.6, 0.4, 0.25])  # speeds of a drawn region over the initial speed
_REGION_SLIPS = np.linspace(0.0, 0.36, 13)


def _released(stops: Sequence[Stop]) -> tuple[Released, ...]:
    """No-lock results of the recorded stops, with the region for the stops of the first static law and load."""
    from railslip_ctrl.verification.no_lock import no_lock, released_run  # imports SymPy, as above

    result: list[Released] = []
    for stop in stops:
        scenario = stop.run.scenario
        law, most = scenario.law(scenario.rail), stop.brake_torque
        speeds = scenario.initial_speed / KMH * _REGION_SPEEDS
        try:
            run = released_run(stop.run, above=stop.cut_out)
        except InputError as error:
            result.append(Released(stop, reason=str(error)))
            continue
        first = next((item.stop for item in result if item.certified is not None), stop)
        drawn = (stop.law, stop.load) == (first.law, first.load)
        most = most if math.isfinite(most) else float(np.max(run.torque))
        region = no_lock(law, scenario.vehicle, speeds, _REGION_SLIPS, torque_max=most) if drawn else None
        result.append(Released(stop, run, region))
    return tuple(result)


def _designed(
    envelope: Envelope,
    nominal: bool,
    selection: Selection,
    beside: tuple[Beside, list[Callable[[], Trial | None]]],
    prefer: str,
    progress: Progress,
    meanwhile: Callable[[DesignReport], object],
) -> DesignReport:
    """Report without rivals and sliding-mode law. `beside`: runs functions elsewhere, and has computed trials."""
    submit, others = beside
    progress("braking runs")
    designed = [item for item in selection.choices if item.design is not None][: candidates.MOST_LINEAR]
    trials = [candidates.linear_trial(item, nominal, False) for item in designed]  # the kinds by rule run in the other
    trials += [item for get in others if (item := get()) is not None]
    trials = candidates.decided(trials, envelope, nominal, prefer, submit)
    best, control = trials[0], trials[0].control
    bounded = {i for i, item in enumerate(trials) if i == 0 or item.choice.structure in (SEEKING, SlideProtection.kind)}
    had = submit(clairvoyant_stops, [stop.braked_scenario for i in sorted(bounded) for stop in trials[i].stops])
    remedy: Callable[[], Remedy | None] = lambda: None  # noqa: E731
    if best.above_kmh is None:
        progress("what would help")
        remedy = submit(candidates.remedy_of, envelope, trials, nominal)
    progress("limits, gains around the design, responses")
    judgement = best.judgement
    in_use = judgement
    if judgement is not None and (least := max(best.lowest_kmh, judgement.hand_over_kmh)) <= max(envelope.speeds):
        in_use = restricted(judgement, least)
    plain = control.system if isinstance(control, PI) else None
    gains = submit(_gain_map, in_use, plain) if plain is not None else lambda: None
    shown = candidates.unjudged(envelope) if judgement is None else judgement
    result = DesignReport(
        envelope,
        nominal,
        selection,
        trials=tuple(trials),
        control=control,
        above_kmh=best.above_kmh,
        in_use=in_use,
        worst_loops=() if in_use is None else _worst_loops(in_use),
        stops=best.stops,
        harder_stops=best.harder,
        held_elsewhere=tuple(_held_elsewhere(best.stops, in_use)) if in_use is not None and plain is None else (),
        rolling=() if plain is None or judgement is None else rolling_loops(best.stops, plain, judgement),
        limits=_limits(shown),
        curves=tuple(map(_curve, laws_of(shown))),
        responses=None if plain is None or in_use is None else _responses(in_use.worst, plain),
        prefer=prefer,
    )
    meanwhile(result)
    known = iter(had())
    trials = [
        replace(item, stops=_with_bounds(item.stops, known)) if i in bounded else item for i, item in enumerate(trials)
    ]
    return replace(result, trials=tuple(trials), stops=trials[0].stops, gains=gains(), remedy=remedy())


def _with_bounds(runs: Iterable[Stop], known: Iterable[tuple[Any, Any]]) -> tuple[Stop, ...]:
    """Stops with their bound and their attainable stop."""
    return tuple(replace(run, bound=bound, attainable=had) for run, (bound, had) in zip(runs, known, strict=False))


def _rival(name: str, controller: Any, envelope: Envelope, nominal: bool) -> Rival:
    result = _rival_alone(name, controller, envelope, nominal)
    return replace(
        result, stops=_with_bounds(result.stops, clairvoyant_stops([run.braked_scenario for run in result.stops]))
    )


def _rival_alone(name: str, controller: Any, envelope: Envelope, nominal: bool) -> Rival:
    if reason := candidates.no_margins(controller):
        blank = candidates.unjudged(envelope)
        held = envelope.reference or blank.points.plants[0].point.law.reference
        control = as_control(controller, envelope.vehicle, held, name)
        return Rival(name, None, stops(control, blank, every_law=False), reason)
    runs = isinstance(controller, Controller)  # a controller of a file runs as the file states
    design = controller if runs or callable(linear_of(controller)) else linear_controller(controller)
    judgement = judge(envelope, design, nominal=nominal)
    control = controller if runs else as_run(controller, judgement, hand_over_of(judgement), name)
    return Rival(name, judgement, stops(control, judgement, every_law=False))


# --- loops ----------------------------------------------------------------------------------------------------------


def _worst_loops(judgement: Judgement) -> tuple[ShownLoop, ...]:
    cases = [judgement.worst] + ([] if judgement.nominal else [judgement.worst_with_tolerances])
    bands = [case.loop.feature_band() for case in cases]
    low, high = min(band[0] for band in bands), max(band[1] for band in bands)
    return tuple(ShownLoop(case.loop_description, case.loop, frequency_curve(case.loop, low, high)) for case in cases)


def _held_elsewhere(runs: Sequence[Stop], judged: Judgement) -> Iterator[HeldElsewhere]:
    """Slips that a controller holds in stops but at which it was not judged, with Ms there."""
    for law, rail in dict.fromkeys((stop.law, stop.rail) for stop in runs):
        points = [plant.point for plant in judged.points.plants]
        known = [point.slip for point in points if (point.law.name, point.rail) == (law, rail)]
        here = {stop.held for stop in runs if (stop.law, stop.rail) == (law, rail) and not math.isnan(stop.held)}
        slips = tuple(sorted(slip for slip in here if not known or not min(known) <= slip <= max(known)))
        most = 0.0
        for slip in slips:
            envelope = judged.envelope.at(rails=(rail,), **({} if known else {"laws": (law,)}))
            there = envelope.points(nominal=True, held=lambda *of, slip=slip: slip)
            result = judge_points(envelope, judged.controller, there, nominal=True)
            mine = [result.points.plants[i].point.law.name == law for i in result.points.plant.tolist()]
            most = max(most, float(result.ms[mine].max()))
        if slips:
            yield HeldElsewhere(law, rail, slips, most)


def _limits(judgement: Judgement) -> tuple[tuple[OperatingPoint, Limits], ...]:
    """Limits of any controller at the hardest operating point of each rail and load."""
    points = judgement.points
    operating = points.plant[points.operating].tolist()
    result: dict[tuple[str, str], tuple[OperatingPoint, Limits]] = {}
    for i in operating:
        point, here = points.plants[i].point, limits_of(points.plants[i], points.vehicle.actuator)
        key = (point.rail.value, points.loads[i])
        if key not in result or here.ms_bound > result[key][1].ms_bound:
            result[key] = (point, here)
    return tuple(result.values())


def _gain_map(judgement: Judgement, design: PIController) -> GainMap:
    """Worst Ms around the design's gains, at the operating points of the lowest and the highest speed in use."""
    points = judgement.points
    speeds = points.speed_kmh
    some = points.take(points.operating & ((speeds == speeds.min()) | (speeds == speeds.max())))
    kp, ki = design.gains.kp * _GAINS, design.gains.ki * _GAINS
    n = _GAINS.size
    ms = np.empty((n, n))
    for shift in range(1 - n, n):  # controllers of a diagonal have one integral time and differ by a factor
        i = np.arange(max(0, -shift), min(n, n - shift))
        gains = PIGains(kp=float(kp[i[0]]), ki=float(ki[i[0] + shift]))
        result = margins_at(PIController(gains, design.lead, design.lead_filter), some, _GAINS[i] / _GAINS[i[0]])
        worst = np.where(result.stable, result.ms, math.inf).reshape(i.size, len(some)).max(axis=1)
        ms[i, i + shift] = worst
    return GainMap(kp, ki, ms, (design.gains.kp, design.gains.ki), len(some))


def _responses(worst: WorstCase, design: PIController) -> Responses | None:
    """Responses at the worst operating point; None for a loop too fast or too slow for the duration."""
    if worst.margins is None:
        return None
    times = np.linspace(0.0, _RESPONSE_TIME, _RESPONSE_POINTS)
    given = {"reference": KMH, "torque": LOAD_STEP}
    try:
        step, push = slip_responses(design, worst.case.plant, worst.case.actuator, times, **given)
    except RailslipError:
        return None
    return Responses(worst.point, LOAD_STEP, step, push)


# --- adhesion -------------------------------------------------------------------------------------------------------


def _curve(point: OperatingPoint) -> LawCurve:
    law, load = point.law, point.vehicle.wheel_load
    end = min(_LARGEST_SLIP, law.domain_limit(point.speed)[0] * (1.0 - 1e-9))
    slip = np.linspace(1e-6 if law.has_state else 0.0, end, _SLIPS)  # a dynamic law has no rest state at slip 0
    coefficient = np.asarray(adhesion_coefficient(law, point.speed, slip, load))
    return LawCurve(point, slip, coefficient, peak(law, point.speed, load))
