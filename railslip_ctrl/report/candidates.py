"""Candidates of a design report: they are judged, simulated in stops, and sorted.

Nominal stops are simulated with each candidate whose margins suffice. Harder stops, with errors of brake, wheel
and sensors or with a changing rail, are simulated with the best candidates.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

from railslip_ctrl.controllers.base import Controller
from railslip_ctrl.controllers.pi import PI
from railslip_ctrl.controllers.seeking import Seeking
from railslip_ctrl.controllers.slide_protection import SlideProtection
from railslip_ctrl.controllers.systems import has_step, linear_of
from railslip_ctrl.controllers.user_step import StepControl
from railslip_ctrl.core.errors import RailslipError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH
from railslip_ctrl.design.catalogue import BY_RULE, controller_named, is_published, is_tuned_when_asked
from railslip_ctrl.design.envelope import Envelope
from railslip_ctrl.design.envelope_tuning import Design, StructureChoice, common_reference, hand_over_of
from railslip_ctrl.design.judging import Judgement, judge
from railslip_ctrl.model.adhesion import ReferenceSlip
from railslip_ctrl.model.vehicle import Actuator, Vehicle

from .stops import Stop, as_reference, as_run, harder_stops, locks_at_once, operating_points, stopping_distance, stops

SEEKING = Seeking.kind

TIE = 0.02
"""Relative difference below which two mean stops, or two worst Ms, are considered equal."""

PREFERENCES = ("distance", "robustness")

NOT_RUN = "not run in the harder stops"  #: reason for a candidate that others surpass in the nominal stops

NEARLY_UNSTABLE = 50.0
"""Largest worst Ms with tolerances of a candidate that qualifies; no gain error of 1.9 % then makes a loop unstable."""

FASTER = (0.75, 0.5, 0.25)
"""Factors on dead time and lag of the faster brakes that are tried if no candidate qualifies."""

HELD_SHARE = 0.75
"""Share of the envelope's reference slip that untuned controllers track, to stay below the adhesion peak."""

MOST_LINEAR = 3  # number of linear designs that run in stops; the most robust one may not have the shortest stop
_LATEST = 0.5  # largest hand-over speed over the highest speed; slip is then controlled over 3/4 of the stop or more
_COMPLETE = 2  # number of qualified candidates that run the harder stops: the best two
_NEAR = 0.1  # relative difference of nominal mean stops, or of worst Ms, that the harder stops may reverse

Beside = Callable[..., Callable[[], Any]]
"""Function that starts another function in a second process, and returns a function that waits for the result."""


@dataclass(frozen=True)
class Trial:
    """A candidate with its results in the stops of the report.

    A candidate qualifies if no wheel locks above its hand-over speed and the train stops in every run. If it has
    margins, Ms above this speed must be at most 2 at the operating points and at most `NEARLY_UNSTABLE` in all cases.

    - above_kmh: speed, km/h, above which the candidate qualifies. If it does not qualify, this is None, and `reason`
      says why.
    - lowest_kmh: speed, km/h, below which `worst_ms` ignores all cases.
    - stops, harder: results of the nominal and of the harder stops.
    """

    choice: StructureChoice
    above_kmh: float | None
    lowest_kmh: float
    control: Controller
    stops: tuple[Stop, ...]
    harder: tuple[Stop, ...] = ()
    reason: str = ""
    robust_kmh: float | None = None  # km/h, speed above which the margins are robust; 0 without margins

    @property
    def judgement(self) -> Judgement | None:
        return None if self.choice.design is None else self.choice.design.judgement

    def distance(self) -> float:
        """Mean braking distance of all runs in nominal and harder stops, m; inf if the train does not stop in a run."""
        return _mean(stopping_distance(run) for stop in (*self.stops, *self.harder) for run in stop.runs)

    def distance_as_given(self) -> float:
        """Mean braking distance of the nominal stops, m; inf if the train does not stop in a run."""
        return _mean(stopping_distance(run) for stop in self.stops for run in stop.runs)

    @property
    def air(self) -> float:
        """Mean air consumption, a ratio: sum of all rises of the torque in a stop, divided by the full brake torque."""
        return _mean(stop.air for stop in (*self.stops, *self.harder))

    @property
    def locked(self) -> int:
        """Number of stops in which the wheel locks above the hand-over speed."""
        return sum(stop.locked_from > self.control.controlled_from for stop in (*self.stops, *self.harder))

    @cached_property
    def worst_ms(self) -> float:
        """Worst Ms at speeds of at least `lowest_kmh` and the hand-over speed; inf if unstable or without margins."""
        if self.judgement is None:
            return math.inf
        speeds = self.judgement.points.speed_kmh
        used = speeds >= max(self.lowest_kmh, self.judgement.hand_over_kmh) * (1 - 1e-9)
        return float(self.judgement.run_ms[used].max(initial=0.0)) if used.any() else math.inf


def _mean(values: Iterable[float]) -> float:
    result = list(values)
    return sum(result) / len(result) if result else math.inf


def ordered(trials: Sequence[Trial], prefer: str = "distance") -> list[Trial]:
    """Sort the trials, the best first.

    Candidates that qualify come first, in the order of mean braking distance. Those within `TIE` of the shortest
    distance are sorted by worst Ms, then by air consumption. If `prefer` is "robustness", distance and worst Ms change
    places.
    """
    first, second = (Trial.distance, _worst) if prefer == "distance" else (_worst, Trial.distance)
    good = sorted((trial for trial in trials if trial.above_kmh is not None), key=first)
    limit = (1 + TIE) * first(good[0]) if good else 0.0
    level = [trial for trial in good if first(trial) <= limit]
    level.sort(key=lambda trial: (second(trial), trial.air))
    rest = sorted((trial for trial in trials if trial.above_kmh is None), key=_as_given)
    return [*level, *good[len(level) :], *rest]


def _worst(trial: Trial) -> float:
    return trial.worst_ms


def _as_given(trial: Trial) -> tuple[bool, int, float]:
    return (
        not trial.stops,
        sum(stop.locked_from > trial.control.controlled_from for stop in trial.stops),
        trial.distance_as_given(),
    )


@dataclass(frozen=True)
class Remedy:
    """A faster brake, described in words, and the trial of a controller that qualifies with this brake."""

    description: str
    trial: Trial


def decided(trials: Sequence[Trial], envelope: Envelope, nominal: bool, prefer: str, submit: Beside) -> list[Trial]:
    """Simulate the harder stops with the candidates that can be the best, and sort all trials, the best first.

    Candidates are tried in the order of nominal distance (worst Ms if `prefer` is "robustness") until two qualify. Then
    only candidates within 10 % of the first that qualified are tried. `submit` starts a function in a second process.
    """
    if nominal and any(trial.above_kmh is not None for trial in trials):
        return ordered(trials, prefer)
    key = Trial.distance_as_given if prefer == "distance" else _worst
    waiting = sorted((trial for trial in trials if trial.above_kmh is not None), key=key)
    done = [trial for trial in trials if trial.above_kmh is None]
    good: list[Trial] = []
    while waiting:
        near = good and key(waiting[0]) <= (1 + _NEAR) * key(good[0])
        if len(good) >= _COMPLETE and not near:
            break
        now, waiting = waiting[:2], waiting[2:]
        # an untuned controller runs in the second process, which has compiled its step
        here = next((trial for trial in now if trial.choice.structure not in named(envelope.vehicle)), now[0])
        apart = {i: submit(_completed, trial, envelope) for i, trial in enumerate(now) if trial is not here}
        mine = _completed(here, envelope)
        ran = [apart[i]() if i in apart else mine for i in range(len(now))]
        good += [trial for trial in ran if trial.above_kmh is not None]
        done += [trial for trial in ran if trial.above_kmh is None]
    done += [replace(trial, above_kmh=None, reason=NOT_RUN) for trial in waiting]
    if good:
        return ordered([*good, *done], prefer)
    result = ordered([_with_stops(trial, envelope) for trial in done], prefer)
    return [
        _with_harder(trial, envelope)
        if not nominal and (trial is result[0] or trial.choice.structure == SlideProtection.kind)
        else trial
        for trial in result
    ]


def _completed(trial: Trial, envelope: Envelope) -> Trial:
    result = _with_harder(trial, envelope)
    if result.above_kmh is not None:
        return result
    if trial.choice.structure in named(envelope.vehicle):
        return rule_trial(trial.choice.structure, envelope, False, True) or result
    return linear_trial(trial.choice, False, True)


def _with_stops(trial: Trial, envelope: Envelope) -> Trial:
    if trial.stops:
        return trial
    judgement = trial.judgement or unjudged(envelope)
    return _concluded(replace(trial, stops=stops(trial.control, judgement)), judgement)


def _with_harder(trial: Trial, envelope: Envelope) -> Trial:
    if trial.harder:
        return trial
    judgement = trial.judgement or unjudged(envelope)
    return _concluded(replace(trial, harder=harder_stops(trial.control, judgement)), judgement)


def named(vehicle: Vehicle) -> tuple[str, ...]:
    """Names of the controllers that can run on this vehicle without tuning."""
    own = ("asmc", "scheduled") if is_published(vehicle) and not is_tuned_when_asked("scheduled", vehicle) else ()
    return (*BY_RULE, *own)


def rule_trial(name: str, envelope: Envelope, nominal: bool, hard: bool) -> Trial | None:
    """Trial of the untuned controller `name`; None if it has no parameters for the vehicle.

    If `hard`, harder stops are simulated too.
    """
    try:
        control = controller_named(name, envelope.vehicle)
    except RailslipError:
        return None
    if no_margins(control) and not control.follows_reference:
        control = control.model_copy(update={"reference": None})
        choice = StructureChoice(name, 1.0, None, no_margins(control))
        return _trial(choice, control, unjudged(envelope), 0.0, hard)
    if control.follows_reference:
        slips = common_reference(envelope, envelope.points(nominal=True))
        held = slips or as_reference(operating_points(envelope.points(nominal=True)))
        less = ReferenceSlip(dry=HELD_SHARE * held.dry, wet=HELD_SHARE * held.wet)
        control, envelope = control.model_copy(update={"reference": less}), envelope.at(reference=less)
    if reason := no_margins(control):
        return _trial(StructureChoice(name, HELD_SHARE, None, reason), control, unjudged(envelope), 0.0, hard)
    result = _judged(name, control, envelope, nominal, hard)
    if result.above_kmh is not None or "fade_speed" not in type(control).model_fields:
        return result
    for later in _handed_over_later(control, envelope, result.judgement):
        if not locks_at_once(later, unjudged(envelope), later.controlled_from, hard=hard):
            other = _judged(name, later, envelope, nominal, hard)
            if other.above_kmh is not None:
                return other
    return result


def _handed_over_later(control: Any, envelope: Envelope, judged: Judgement | None) -> Iterator[Controller]:
    robust = None if judged is None else judged.robust_from_kmh
    for speed in sorted(envelope.speeds):
        ratio = speed * KMH / control.controlled_from
        if ratio > 1 + 1e-9 and robust is not None and robust <= speed <= _LATEST * max(envelope.speeds):
            faster = {"hand_over_speed": speed * KMH, "fade_speed": ratio * control.fade_speed}
            yield control.model_copy(update=faster)


def _judged(name: str, control: Controller, envelope: Envelope, nominal: bool, hard: bool) -> Trial:
    judgement = judge(envelope, control, nominal)
    factor = HELD_SHARE if control.follows_reference else 1.0
    choice = StructureChoice(name, factor, Design(control, judgement), reach_s=0.0, stop_s=0.0)
    return _trial(choice, control, judgement, judgement.robust_from_kmh, hard)


def _trial(
    choice: StructureChoice, control: Controller, judgement: Judgement, robust: float | None, hard: bool
) -> Trial:
    # `robust` is the speed, km/h, above which the margins are robust; None if there is none, 0 without margins
    lowest = robust if robust is not None else judgement.usable_from_kmh or 0.0 if judgement.controller else 0.0
    result = _concluded(Trial(choice, None, lowest, control, (), robust_kmh=robust), judgement)
    if not result.reason:
        result = _concluded(replace(result, stops=stops(control, judgement)), judgement)
    if hard and not result.reason:
        result = _concluded(replace(result, harder=harder_stops(control, judgement)), judgement)
    return result


def _concluded(trial: Trial, judgement: Judgement) -> Trial:
    reason = "; ".join(_lacks(trial, judgement))
    return replace(trial, above_kmh=None if reason else trial.robust_kmh, reason=reason)


def _lacks(trial: Trial, judgement: Judgement) -> Iterator[str]:
    over, robust = trial.control.controlled_from / KMH, trial.robust_kmh
    if robust is None:
        yield "not robust at the highest speed"
    elif robust > max(_LATEST * max(judgement.envelope.speeds), min(judgement.envelope.speeds)):
        yield f"robust only from {robust:g} km/h up"
    elif robust > max(over, min(judgement.envelope.speeds)) * (1 + 1e-9):
        yield f"robust from {robust:g} km/h up, but already controls slip from {over:.3g} km/h up"
    elif trial.judgement is not None and trial.worst_ms > NEARLY_UNSTABLE:
        worst = "unstable" if math.isinf(trial.worst_ms) else f"Ms {trial.worst_ms:.3g}, nearly unstable"
        yield f"with tolerances {worst}"
    if trial.locked:
        first = max((*trial.stops, *trial.harder), key=lambda stop: stop.locked_from)
        where = ", ".join(filter(None, (first.law, first.load, first.errors or str(first.rail))))
        speed = f"{first.locked_from / KMH:.0f} km/h"
        yield f"a wheel locks in {trial.locked} of {len(trial.stops) + len(trial.harder)} stops ({where}, at {speed})"
    runs = [run for stop in (*trial.stops, *trial.harder) for run in stop.runs]
    if lost := [run.outcome.value for run in runs if not run.stopped]:
        yield f"{len(lost)} of {len(runs)} runs do not stop: {', '.join(dict.fromkeys(lost))}"


def linear_trial(choice: StructureChoice, nominal: bool, hard: bool) -> Trial:
    """Trial of a tuned linear design; the hand-over speed is raised until the design qualifies.

    If `hard`, harder stops are simulated too.
    """
    assert choice.design is not None, "only choices with a design are tried"
    design, judgement = choice.design, choice.design.judgement
    if nominal:
        judgement = judge(judgement.envelope, judgement.controller, nominal=True)
        choice = replace(choice, design=replace(design, judgement=judgement))
    assert isinstance(design.controller, PI), "`select` tunes only PI and PI-lead"
    plain = design.controller.system
    robust, begins = judgement.robust_from_kmh, hand_over_of(judgement)
    lowest = robust if robust is not None else judgement.usable_from_kmh or 0.0
    latest = _LATEST * max(judgement.envelope.speeds)
    later = [speed for speed in sorted(judgement.envelope.speeds) if lowest < speed <= latest]
    first = None
    for speed in [lowest, *(later if robust is not None else [])]:
        control = as_run(plain, judgement, speed if begins else 0.0)
        if first is not None and locks_at_once(control, judgement, speed * KMH, hard=hard):
            continue
        result = _trial(choice, control, judgement, None if robust is None else speed, hard)
        first = first or result
        if result.above_kmh is not None:
            return replace(result, lowest_kmh=speed)
    assert first is not None
    return first


def remedy_of(envelope: Envelope, trials: Sequence[Trial], nominal: bool) -> Remedy | None:
    """Find the slowest of the brakes `FASTER` with which an untuned controller qualifies; None if there is none."""
    names = [trial.choice.structure for trial in trials if trial.choice.structure in BY_RULE]
    old = envelope.vehicle.actuator
    for factor in FASTER:
        actuator = Actuator(dead_time=factor * old.dead_time, lag=factor * old.lag)
        faster = envelope.at(vehicle=envelope.vehicle.model_copy(update={"actuator": actuator}))
        for name in names:
            result = rule_trial(name, faster, nominal, not nominal)
            if result is not None and result.above_kmh is not None:
                return Remedy(f"dead time {actuator.dead_time:.3g} s and lag {actuator.lag:.3g} s", result)
    return None


def unjudged(envelope: Envelope) -> Judgement:
    """Judgement that contains the operating points of an envelope, but no controller and no margins."""
    return Judgement(None, envelope, True, envelope.points(nominal=True), None)  # type: ignore[arg-type]


def no_margins(controller: Any) -> str:
    """Reason why a controller has no stability margins; empty if it has them."""
    thing = controller.thing.thing if isinstance(controller, StepControl) else controller
    if isinstance(thing, Controller):
        own = type(thing)
        linear = own.linear is not Controller.linear or own.loop is not Controller.loop
        return "" if linear else "not linear"
    return "known only by its step function" if has_step(thing) and not callable(linear_of(thing)) else ""
