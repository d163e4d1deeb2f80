"""Computation of a design report, and records of the contents of the report.

`design_report` tunes and judges controllers, simulates stops with them, and chooses the best one.
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
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from railslip_ctrl.controllers.base import Controller
from railslip_ctrl.controllers.files import as_control
from railslip_ctrl.controllers.pi import PI
from railslip_ctrl.controllers.slide_protection import SlideProtection
from railslip_ctrl.controllers.systems import PIController, linear_controller, linear_of
from railslip_ctrl.core.arguments import checked
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
    """Adhesion coefficient, shape (n,), over slip ratio, shape (n,), at the speed of `point`, and the adhesion peak."""

    point: OperatingPoint
    slip: Floats
    coefficient: Floats
    peak: Peak


@dataclass(frozen=True)
class ShownLoop:
    """A loop in a picture, with its label and its frequency response."""

    label: str
    loop: Any
    curve: FrequencyCurve


@dataclass(frozen=True)
class GainMap:
    """Worst Ms over `points` operating points, for gains near those of the design and with the lead of the design.

    - kp, ki: gains, SI, shapes (m,) and (n,).
    - ms: worst Ms, shape (m, n); inf if a loop is unstable.
    - chosen: kp and ki of the design.
    """

    kp: Floats
    ki: Floats
    ms: Floats
    chosen: tuple[float, float]
    points: int


@dataclass(frozen=True)
class Responses:
    """Linear responses of the recommended design: to a step of the reference slip velocity, and to a load step.

    The load step is a torque step at the wheel of `load_step`, N*m.
    """

    point: OperatingPoint
    load_step: float
    reference: TimeResponse
    load: TimeResponse


@dataclass(frozen=True)
class Sliding:
    """Verified conditions of the predictive sliding-mode law; if `verification` is None, `reason` says why."""

    verification: Verification | None
    reason: str = ""


@dataclass(frozen=True)
class Released:
    """A stop of the recommended design, and the samples at which it is proved that a brake release prevents a lock.

    If the stop cannot be certified, `certified` is None and `reason` says why. `region` is None if it is not drawn.
    """

    stop: Stop
    certified: ReleasedRun | None = None
    region: NoLock | None = None
    reason: str = ""


@dataclass(frozen=True)
class UnjudgedSlips:
    """Slip ratios that a design holds in stops but at which it was not judged, and the worst Ms at these slips."""

    law: str
    rail: Rail
    slips: tuple[float, ...]
    ms: float


@dataclass(frozen=True)
class Rival:
    """A user's controller with its nominal stops and its judgement; if `judgement` is None, `reason` says why."""

    name: str
    judgement: Judgement | None
    stops: tuple[Stop, ...]
    reason: str = ""

    @property
    def above_kmh(self) -> float | None:
        """Speed, km/h, above which the controller is robust; None if never, or if a wheel locks during slip control."""
        robust = None if self.judgement is None else self.judgement.robust_from_kmh
        return None if any(stop.locked_from > stop.cut_out for stop in self.stops) else robust


@dataclass(frozen=True)
class DesignReport:
    """Content of the design report of a vehicle; a field that was not computed is empty or None."""

    envelope: Envelope  # envelope of the design, which contains the vehicle
    nominal: bool  # true if only operating points are judged, without tolerances
    selection: Selection  # tuned linear designs, the best first
    trials: tuple[Trial, ...] = ()  # every candidate that ran, the best first
    control: Controller | None = None  # the recommended controller as in `recommended.toml`
    above_kmh: float | None = None  # km/h, speed above which the best candidate qualifies
    # judgement at speeds above the best trial's lowest speed and the hand-over speed; at all speeds if none is above;
    # None for a controller without margins
    in_use: Judgement | None = None
    worst_loops: tuple[ShownLoop, ...] = ()  # loops at the worst operating point, and at the worst with tolerances
    stops: tuple[Stop, ...] = ()  # nominal stops of the recommended design
    harder_stops: tuple[Stop, ...] = ()  # stops of this design with errors or on a changing rail
    unjudged_slips: tuple[UnjudgedSlips, ...] = ()  # slips held in stops but not judged
    rolling: tuple[RollingLoop, ...] = ()  # loops near free rolling, where the wheel oscillates
    rivals: tuple[Rival, ...] = ()  # the user's controllers
    limits: tuple[tuple[OperatingPoint, Limits], ...] = ()  # limits for any controller
    curves: tuple[LawCurve, ...] = ()
    gains: GainMap | None = None
    responses: Responses | None = None
    remedy: Remedy | None = None  # better brake if no candidate qualifies
    prefer: str = "distance"
    sliding: Sliding = Sliding(None)
    released: tuple[Released, ...] = ()  # certified samples of the recommended design's stops
    seconds: float = math.nan
    date: datetime.date = field(default_factory=datetime.date.today)

    @property
    def vehicle(self) -> Vehicle:
        return self.envelope.vehicle

    @property
    def best(self) -> StructureChoice | None:
        return self.trials[0].choice if self.trials else None

    @property
    def judgement(self) -> Judgement | None:
        """Judgement of the best candidate over the whole envelope; None if this candidate has no margins."""
        return None if self.best is None or self.best.design is None else self.best.design.judgement

    @property
    def judged_envelope(self) -> Envelope:
        """Envelope with the slips at which the best candidate was judged."""
        return self.envelope if self.judgement is None else self.judgement.envelope

    @property
    def hands_over(self) -> bool:
        """True if the best candidate qualifies and has a hand-over speed."""
        return self.usable and self.control is not None and self.control.controlled_from > 0

    @property
    def seeking(self) -> Trial | None:
        return next((trial for trial in self.trials if trial.choice.structure == SEEKING), None)

    @property
    def peer(self) -> Trial | None:
        return next((trial for trial in self.trials if trial.choice.structure == SlideProtection.kind), None)

    @property
    def qualified(self) -> tuple[Trial, ...]:
        return tuple(trial for trial in self.trials if trial.above_kmh is not None)

    def trial_of(self, choice: StructureChoice) -> Trial | None:
        return next((trial for trial in self.trials if trial.choice is choice), None)

    @property
    def usable(self) -> bool:
        return self.above_kmh is not None

    @property
    def longest_stops(self) -> tuple[Stop, ...]:
        return longest(self.stops)


def longest(stops: Sequence[Stop]) -> tuple[Stop, ...]:
    """Return the longest stop on each rail."""
    rails = dict.fromkeys(stop.rail for stop in stops)
    return tuple(max((s for s in stops if s.rail is rail), key=lambda s: s.distance) for rail in rails)


def restricted(judgement: Judgement, from_kmh: float) -> Judgement:
    """Judgement without the cases at speeds below `from_kmh`, km/h."""
    from_kmh *= 1 - 1e-9  # rounding of the conversion from m/s
    kept = judgement.points.speed_kmh >= from_kmh
    columns: dict[str, Any] = {name: values[kept] for name, values in vars(judgement.margins).items()}
    speeds = tuple(v for v in judgement.envelope.speeds if v >= from_kmh)
    envelope = judgement.envelope.at(speeds=speeds)
    margins = replace(judgement.margins, **columns)
    return replace(judgement, envelope=envelope, points=judgement.points.take(kept), margins=margins)


def laws_of(judgement: Judgement) -> Collection[OperatingPoint]:
    """One operating point for each law and rail, with the first load and the highest speed."""
    operating = operating_points(judgement.points)
    loads = judgement.points.load[judgement.points.operating].tolist()
    top = max(point.speed for point in operating)
    result: dict[tuple[str, Rail], OperatingPoint] = {}
    for point, load in zip(operating, loads, strict=True):
        if load == loads[0] and point.speed > 0.999 * top:
            result.setdefault((point.law.name, point.rail), point)
    return result.values()


Progress = Callable[[str], None]

LOAD_STEP = 100.0  #: torque step at the wheel for the load response, N*m

_CACHED = "conditions-predictive"  # name of the cache of the verified conditions
_LARGEST_SLIP, _SLIPS = 0.5, 401  # end of the adhesion curves, slip ratio, and number of points
_GAINS = 4.0 ** np.linspace(-1.0, 1.0, 21)  # factors on the design's gains; 1 is in the middle
_RESPONSE_TIME, _RESPONSE_POINTS = 10.0, 1001  # s, duration of the responses, and number of points

_QUICK_FILTER = 0.05  # ratio of the time constants of filter and lead, tried besides 0.1: larger ki, but more noise


@checked
def design_report(
    envelope: Envelope,
    *,
    nominal: bool = False,
    given: dict[str, Any] | None = None,
    sliding: bool = True,
    fresh: bool = False,
    prefer: Literal["distance", "robustness"] = "distance",
    progress: Progress = lambda message: None,
    meanwhile: Callable[[DesignReport], object] = lambda report: None,
) -> DesignReport:
    """Compute recommendation, margins, stops and limits for the design review of a vehicle.

    - nominal: judge only the operating points, without tolerances.
    - given: user's controllers by name; simulated in the same stops, and judged if they have margins.
    - sliding: also verify the conditions of the predictive sliding-mode law, and find where a brake release prevents a
      lock.
    - fresh: verify the conditions of the predictive law again instead of reading the result from the cache.
    - prefer: first criterion for the order of the candidates that qualify; "robustness" means the worst Ms.
    - meanwhile: called once with the unfinished report, to draw the first pictures during the computation.

    InputError: the envelope has no points, or an object in `given` is not a controller.
    """
    started, vehicle, lead = time.perf_counter(), envelope.vehicle, partial(select, envelope, ("pi-lead",))
    rivals: dict[str, Rival] = {}

    def run_rival(name: str, controller: Any) -> None:
        progress(f"judge controller {name} and simulate its stops")
        rivals[name] = _rival(name, controller, envelope, nominal)

    for name, controller in (given or {}).items():
        if candidates.no_margins(controller):  # the step may fail, so run it before the long computation
            run_rival(name, controller)
    with _beside() as submit:
        # a second process cannot import a user's law
        sent = all(isinstance(law, str) and law in law_names() for law in envelope.laws)
        here: Beside = submit if sent else partial
        progress(f"tune designs over the envelope of {vehicle.name}")
        plain = here(select, envelope, ("pi",))
        others = [here(candidates.rule_trial, name, envelope, nominal, False) for name in candidates.named(vehicle)]
        conditions: Callable[[], Sliding] = partial(Sliding, None, "not requested")
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
                run_rival(name, controller)
        progress("verify the conditions of the predictive sliding-mode law")
        shown = tuple(rivals[name] for name in given or {})
        report = replace(report, rivals=shown, sliding=conditions(), released=no_locks())
        return replace(report, seconds=time.perf_counter() - started)


@contextmanager
def _beside() -> Iterator[Beside]:
    if cpu_count() < 2:
        yield partial
        return
    cache_folder()  # if it is temporary, the second process inherits it
    with processes(1) as submit:
        # pickle now: lazily cached properties could change the object while the pool's thread pickles it
        yield lambda function, *arguments: submit(_called, pickle.dumps((function, arguments))).result


def _called(content: bytes) -> Any:
    function, arguments = pickle.loads(content)
    return function(*arguments)


def _verified(vehicle: Vehicle) -> Sliding:
    from railslip_ctrl.verification.joint_verification import verify  # imports SymPy: slow

    def decide() -> Verification:
        result = verify(law="predictive", vehicle=vehicle)
        return replace(
            result, conditions=tuple(replace(item, numbers={}) for item in result.conditions)
        )  # the report does not show the numbers

    try:
        return Sliding(cached(_CACHED, decide, vehicle.model_dump_json(), fresh=True))
    except RailslipError as error:
        return Sliding(None, str(error))


_REGION_SPEEDS = np.array([1.0, 0.8, 0.6, 0.4, 0.25])  # speeds of a drawn region, relative to the initial speed
_REGION_SLIPS = np.linspace(0.0, 0.36, 13)  # slip ratios of a drawn region


def _released(stops: Sequence[Stop]) -> tuple[Released, ...]:
    from railslip_ctrl.verification.no_lock import no_lock, released_run  # imports SymPy, which is slow

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
    submit, others = beside
    progress("simulate the stops")
    designed = [item for item in selection.choices if item.design is not None][: candidates.MOST_LINEAR]
    trials = [candidates.linear_trial(item, nominal, False) for item in designed]  # others run in the second process
    trials += [item for get in others if (item := get()) is not None]
    trials = candidates.decided(trials, envelope, nominal, prefer, submit)
    best, control = trials[0], trials[0].control
    bounded = {i for i, item in enumerate(trials) if i == 0 or item.choice.structure in (SEEKING, SlideProtection.kind)}
    had = submit(clairvoyant_stops, [stop.braked_scenario for i in sorted(bounded) for stop in trials[i].stops])
    remedy: Callable[[], Remedy | None] = lambda: None  # noqa: E731
    if best.above_kmh is None:
        progress("search for a faster brake with which a controller qualifies")
        remedy = submit(candidates.remedy_of, envelope, trials, nominal)
    progress("compute limits, gain map and responses")
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
        unjudged_slips=tuple(_unjudged_slips(best.stops, in_use)) if in_use is not None and plain is None else (),
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
    runs = isinstance(controller, Controller)  # a controller from a file keeps its own settings
    design = controller if runs or callable(linear_of(controller)) else linear_controller(controller)
    judgement = judge(envelope, design, nominal=nominal)
    control = controller if runs else as_run(controller, judgement, hand_over_of(judgement), name)
    return Rival(name, judgement, stops(control, judgement, every_law=False))


def _worst_loops(judgement: Judgement) -> tuple[ShownLoop, ...]:
    cases = [judgement.worst] + ([] if judgement.nominal else [judgement.worst_with_tolerances])
    bands = [case.loop.feature_band() for case in cases]
    low, high = min(band[0] for band in bands), max(band[1] for band in bands)
    return tuple(ShownLoop(case.loop_description, case.loop, frequency_curve(case.loop, low, high)) for case in cases)


def _unjudged_slips(runs: Sequence[Stop], judged: Judgement) -> Iterator[UnjudgedSlips]:
    for law, rail in dict.fromkeys((stop.law, stop.rail) for stop in runs):
        points = [plant.point for plant in judged.points.plants]
        known = [point.slip for point in points if (point.law.name, point.rail) == (law, rail)]
        here = {stop.settled_slip for stop in runs if (stop.law, stop.rail) == (law, rail)}
        slips = tuple(sorted(s for s in here if not (math.isnan(s) or (known and min(known) <= s <= max(known)))))
        most = 0.0
        for slip in slips:
            envelope = judged.envelope.at(rails=(rail,), **({} if known else {"laws": (law,)}))
            there = envelope.points(nominal=True, slip_of=lambda *of, slip=slip: slip)
            result = judge_points(envelope, judged.controller, there, nominal=True)
            mine = [result.points.plants[i].point.law.name == law for i in result.points.plant.tolist()]
            most = max(most, float(result.ms[mine].max()))
        if slips:
            yield UnjudgedSlips(law, rail, slips, most)


def _limits(judgement: Judgement) -> tuple[tuple[OperatingPoint, Limits], ...]:
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
    points = judgement.points
    speeds = points.speed_kmh
    some = points.take(points.operating & ((speeds == speeds.min()) | (speeds == speeds.max())))
    kp, ki = design.gains.kp * _GAINS, design.gains.ki * _GAINS
    n = _GAINS.size
    ms = np.empty((n, n))
    for shift in range(1 - n, n):  # controllers on a diagonal differ only by a factor on the loop gain
        i = np.arange(max(0, -shift), min(n, n - shift))
        gains = PIGains(kp=float(kp[i[0]]), ki=float(ki[i[0] + shift]))
        result = margins_at(PIController(gains, design.lead, design.lead_filter), some, _GAINS[i] / _GAINS[i[0]])
        worst = np.where(result.stable, result.ms, math.inf).reshape(i.size, len(some)).max(axis=1)
        ms[i, i + shift] = worst
    return GainMap(kp, ki, ms, (design.gains.kp, design.gains.ki), len(some))


def _responses(worst: WorstCase, design: PIController) -> Responses | None:
    if worst.margins is None:
        return None
    times = np.linspace(0.0, _RESPONSE_TIME, _RESPONSE_POINTS)
    given = {"reference": KMH, "torque": LOAD_STEP}
    try:
        step, push = slip_responses(design, worst.case.plant, worst.case.actuator, times, **given)
    except RailslipError:
        return None
    return Responses(worst.point, LOAD_STEP, step, push)


def _curve(point: OperatingPoint) -> LawCurve:
    law, load = point.law, point.vehicle.wheel_load
    end = min(_LARGEST_SLIP, law.domain_limit(point.speed)[0] * (1.0 - 1e-9))
    slip = np.linspace(1e-6 if law.has_state else 0.0, end, _SLIPS)  # a dynamic law has no rest state at slip 0
    coefficient = np.asarray(adhesion_coefficient(law, point.speed, slip, load))
    return LawCurve(point, slip, coefficient, peak(law, point.speed, load))
