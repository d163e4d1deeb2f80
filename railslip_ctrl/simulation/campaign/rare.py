"""Probability of a rare event over a campaign's quantities, its random force and its sensor noise.

All of them are standard normal inputs of a stop: a quantity is its distribution's value at Phi(z). Noise later than
`_REMEMBERED` times the nominal stop is drawn anew in every move, from a seed that is the last input.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from railslip_ctrl import __version__
from railslip_ctrl.controllers.base import Controller
from railslip_ctrl.core.arguments import Floats, checked, number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.folders import claimed, staged
from railslip_ctrl.core.records import by_content, dataclass
from railslip_ctrl.core.units import shown, to_unit
from railslip_ctrl.simulation.run import LOCKED_SHARE, Noise, Outcome, Run, Simulator
from railslip_ctrl.simulation.scenario import Scenario

from . import subset
from .execution import workers_for
from .specification import Campaign, Grid, described
from .statistics import Estimate, share

REPEATS = 8  #: independent estimates
POINTS = 1200  #: stops in a level of each: with `REPEATS`, 1e-9 takes some 85 000 stops
FORCE, SENSORS = "random force", "sensor noise"
EBCL = range(10)
"""Confidence levels of the emergency brake deceleration of ETCS: 0 is 50 %, n is 1 - 10^-n (M_NVEBCL)."""

_REMEMBERED = 2.0
_SMALLEST_LEVEL = 1e-9
_ABOUT = 250  # stops about the design point for each repeat
_MOST_APART, _MOST_VARIATION, _LEAST_ACCEPTED, _MOST_REPEATED = 0.1, 0.3, 0.05, 0.05
_DISAGREE = 2.6  # standard deviations: chance reaches them in 1 of 100
_SHOWN = 8  # failing stops, and scales of their noise, among which that of least noise is looked for
_SEED = 2**32 - 2  # the child of the campaign's seed for all this; no run has this number

_MEASURES: dict[str, tuple[str, Callable[[Run], float]]] = {
    "distance": ("m", lambda run: run.braking_distance if run.stopped else math.inf),
    "time": ("s", lambda run: run.braking_time if run.stopped else math.inf),
    "slip": ("1", lambda run: run.max_slip),
    "deceleration": ("m/s^2", lambda run: -mean_deceleration(run)),
}


def mean_deceleration(run: Run) -> float:
    """Mean deceleration of a stop over its distance, (v0^2 - v1^2)/(2 s), m/s^2; 0 of a run that did not stop."""
    if not run.stopped:
        return 0.0
    return (run.scenario.initial_speed**2 - run.scenario.final_speed**2) / (2.0 * run.braking_distance)


class Event(NamedTuple):
    """A `measure` of a stop above a `threshold`, in the measure's unit."""

    measure: str
    threshold: float

    @property
    def unit(self) -> str:
        """Of the threshold."""
        return _MEASURES[self.measure][0]

    def __str__(self) -> str:
        """As it could be given again."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.measure} > {self.threshold:g}{unit}"

    @classmethod
    def read(cls, text: str) -> Event:
        """An event as "distance > 420 m", "time > 20 s", "slip > 0.5" or "lock". InputError for another text."""
        found = re.fullmatch(r"\s*(distance|time|slip)\s*>\s*(.+)", text)
        if text.strip() == "lock":
            return cls("slip", 1.0 - LOCKED_SHARE)
        if found is None:
            raise InputError(
                f'event: {shown(text)} is not allowed; give lock, or a bound: "distance > 420 m", "time > 20 s", '
                '"slip > 0.5"'
            )
        unit = _MEASURES[found[1]][0]
        threshold = to_unit(found[2], unit, name=f"event: {found[1]}", text_needs_unit=unit != "1")
        return cls(found[1], number(f"event: {found[1]}", threshold, "" if unit == "1" else unit, ge=0.0))


class Drawn(NamedTuple):
    """A stop made ready: sampled values by name, scenario, controller and noise."""

    values: dict[str, float]
    scenario: Scenario
    controller: Controller
    noise: Noise


class Stops:
    """The limit state of a campaign's stops: a measure of each, +inf where a stop has none.

    `groups` are the places of each quantity, and of the random force and the sensors' noise if there is any.
    InputError for a campaign of several controllers, of a grid, or without anything random.
    """

    def __init__(self, campaign: Campaign, measure: str) -> None:
        self.campaign, self.read, self.unresolved = campaign, _MEASURES[measure][1], 0
        if len(campaign.controllers) > 1:
            raise InputError(f"controllers: {len(campaign.controllers)} given; a rare event is of one, give it alone")
        for quantity in campaign.quantities:
            if isinstance(quantity.distribution, Grid):
                raise InputError(f"quantity: {quantity.name!r} is a grid, which has no probability; give a choice")
        simulator = Simulator(campaign.scenario, campaign.controllers[0])
        self.nominal = simulator.run(None)
        noise, remembered = campaign.scenario.measurement, _REMEMBERED * self.nominal.braking_time
        disturbances = campaign.scenario.disturbances
        forces = math.ceil(remembered / disturbances.random_hold) if disturbances.random_force > 0 else 0
        sensed = noise.speed_noise > 0 or noise.wheel_noise > 0
        samples = math.ceil(remembered / simulator.period) if sensed else 0
        sizes = {**dict.fromkeys(campaign.quantity_units, 1), FORCE: forces, SENSORS: 2 * samples}
        ends = np.cumsum(list(sizes.values())).tolist()
        self.groups = {name: slice(end - n, end) for (name, n), end in zip(sizes.items(), ends, strict=True) if n}
        self.dimension = ends[-1] + 1
        if not self.groups:
            raise InputError("quantity: nothing is random; give a quantity, a random force or sensor noise")

    def drawn(self, point: Floats) -> Drawn:
        """The stop of a point. InputError for values that a record refuses."""
        from scipy.special import ndtr

        count = len(self.campaign.quantities)
        pairs = zip(self.campaign.quantities, ndtr(point[:count]).tolist(), strict=True)
        values = {quantity.name: quantity.distribution.at(u) for quantity, u in pairs}
        force, sensors = (point[self.groups.get(name, slice(0, 0))] for name in (FORCE, SENSORS))
        seed = int(np.float64(point[-1]).view(np.int64)) & (2**63 - 1)
        scenario, (controller,) = self.campaign.with_values(values.values())
        return Drawn(values, scenario, controller, Noise(force, sensors.reshape(-1, 2), seed))

    def run(self, point: Floats, *, record_every: int | None = None) -> Run | None:
        """The stop of a point; None of one whose values a record refuses."""
        try:
            drawn = self.drawn(point)
            return Simulator(drawn.scenario, drawn.controller).run(drawn.noise, record_every=record_every)
        except InputError:
            return None

    def __call__(self, points: Floats) -> Floats:
        """Values of points (n by dimension), (n,); `unresolved` counts stops that the simulation broke off."""
        values = np.full(len(points), math.inf)
        for i, point in enumerate(points):
            run = self.run(point)
            if run is None or run.outcome not in (Outcome.STOPPED, Outcome.OUT_OF_TIME):
                self.unresolved += 1
            else:
                values[i] = self.read(run)
        return values


# --- results ----------------------------------------------------------------------------------------------------------


@by_content
class Tail(NamedTuple):
    """Probability of what is worse than each value.

    - x: values, 1-D, in the measure's unit.
    - value, low, high: probability and its interval, arrays of one length, ratios.
    - plain: of the independent stops alone, Wilson's: rows of (x, share, low, high), (n, 4), ratios.
    """

    x: Floats
    value: Floats
    low: Floats
    high: Floats
    plain: Floats


@dataclass(frozen=True)
class FailingStop:
    """The most likely failing stop found: its `distance` from the middle of all inputs in standard deviations, what was
    `drawn`, and its run."""

    distance: float
    drawn: Drawn
    run: Run


@dataclass(frozen=True)
class RareEvent:
    """Probability of an event in a campaign's stops, by subset simulation.

    - probability, variation: estimate with its 95 % interval, and its coefficient of variation.
    - importance, importance_variation: the same by importance sampling; the latter is a ratio. None where no stop met
      the event.
    - levels, accepted: values on the way, in the event's unit, and the share of moves accepted at each.
    - shares: share of each quantity, and of the noise, in the mean of the event's inputs.
    - directions: number of standard deviations that a quantity is off, on average, in the event.
    - stop: the most likely one found; None if none was.
    - tail: of the event's measure, in its unit.
    - stops: number of simulated stops.
    - warnings: why the numbers cannot be trusted; empty where nothing was found.
    """

    campaign: Campaign
    event: Event
    probability: Estimate
    variation: float
    importance: Estimate | None
    importance_variation: float
    levels: tuple[float, ...]
    accepted: tuple[float, ...]
    shares: dict[str, float]
    directions: dict[str, float]
    stop: FailingStop | None
    tail: Tail
    stops: int
    warnings: tuple[str, ...]

    def __str__(self) -> str:
        """The estimate, in a line."""
        value, low, high = self.probability
        return f"P({self.event}) = {value:.3g} [{low:.2g}, {high:.2g}], {self.stops} stops"


class Factor(NamedTuple):
    """Kdry_rst of a confidence level: the mean deceleration (m/s^2) that is exceeded with 1 - `probability`, over the
    nominal one."""

    level: int
    probability: float
    deceleration: float
    factor: Estimate


@dataclass(frozen=True)
class ConfidenceLevels:
    """Table of Kdry_rst over the confidence levels of ETCS.

    - campaign: what varies.
    - nominal: mean deceleration of the nominal stop, m/s^2.
    - factors: one for each of `EBCL`.
    - tail: probability of a smaller factor.
    - stops: number of simulated stops.
    - warnings: why the numbers cannot be trusted; empty where nothing was found.
    """

    campaign: Campaign
    nominal: float
    factors: tuple[Factor, ...]
    tail: Tail
    stops: int
    warnings: tuple[str, ...]


# --- the work ---------------------------------------------------------------------------------------------------------


class Task(NamedTuple):
    """A pilot, a repeat or an importance sample, by its kind and number, and what it is given."""

    kind: str
    number: int
    threshold: float
    smallest: float
    points: int
    given: Any = ()  # levels of a repeat, design point of an importance sample


def work(shared: tuple[Campaign, str], task: Task, version: str) -> dict[str, Any]:
    """Arrays of a finished task by name; what a worker does."""
    if version != __version__:
        raise InputError(f"scheduler: a worker has version {__version__} in place of {version}; install the same there")
    stops = Stops(*shared)
    kinds = ("pilot", "repeat", "importance")
    key = (_SEED, kinds.index(task.kind), task.number)
    rng = np.random.default_rng(np.random.SeedSequence(shared[0].seed, spawn_key=key))
    if task.kind == "pilot":
        count, smallest = task.points // 2, task.smallest
        levels = subset.pilot(stops, stops.dimension, task.threshold, rng, count=count, fresh=1, smallest=smallest)
        return {"levels": np.array(levels).reshape(-1, 2)}
    if task.kind == "importance":
        value = subset.importance(stops, task.given, task.threshold, rng, count=_ABOUT)
        return {"value": np.array(value)}
    found = subset.repeat(stops, stops.dimension, task.given, task.threshold, rng, count=task.points, fresh=1)
    return {**vars(found), "unresolved": np.array(stops.unresolved)}


class _Study:
    """A campaign, a measure, a threshold: tasks done once, kept in a folder, and what they give together."""

    def __init__(self, campaign: Campaign, event: Event, smallest: float, points: int, repeats: int) -> None:
        number("points", points, ge=100)
        number("repeats", repeats, ge=3)
        self.event, self.repeat_count, self.points = event, repeats, points
        self._task = Task("pilot", 0, event.threshold, smallest, points)
        self.stops, self.shared = Stops(campaign, event.measure), (campaign, event.measure)
        what = json.dumps([__version__, {**described(campaign), "runs": 0}, *map(str, self._task)])
        self._name = f"rare-{hashlib.sha256(what.encode()).hexdigest()[:12]}"

    @contextmanager
    def at_work(
        self, folder: Path | None, workers: int | None, scheduler: str | None, progress: Callable[[str], None]
    ) -> Iterator[_Study]:
        """With workers, and a folder to resume from."""
        self._progress = progress
        claim = nullcontext() if folder is None else claimed(folder)
        with workers_for(work, self.shared, workers, scheduler) as (self._submit, _), claim:
            self._folder = None if folder is None else folder / self._name
            if self._folder is not None:
                self._folder.mkdir(exist_ok=True)
            self.levels = tuple(subset.Level(*row) for row in self._done([self._task])[0]["levels"].tolist())
            tasks = [self._task._replace(kind="repeat", number=i, given=self.levels) for i in range(self.repeat_count)]
            found = self._done(tasks)
            self.unresolved = sum(int(one.pop("unresolved")) for one in found)
            self.repeats = [subset.Repeat(**one) for one in found]
            self.calls = self.points // 2 * (1 + len(self.levels)) + sum(int(one.calls) for one in self.repeats)
            yield self

    def importance(self, centre: Floats) -> Floats:
        """Estimates by importance sampling about a point."""
        tasks = [self._task._replace(kind="importance", number=i, given=centre) for i in range(self.repeat_count)]
        self.calls += _ABOUT * len(tasks)
        return np.array([float(one["value"]) for one in self._done(tasks)])

    def failing_stop(self, kept: Floats, centre: Floats | None) -> FailingStop | None:
        """That of the design point `centre`; without one, of some failing stops that which fails with least noise."""
        if centre is None:
            count = len(self.shared[0].quantities)
            nearest = kept[np.argsort(np.linalg.norm(kept[:, :count], axis=1))[:_SHOWN]]
            scales = np.ones((_SHOWN, 1, kept.shape[1]))
            scales[:, :, count:-1] = np.linspace(0.0, 1.0, _SHOWN)[:, None, None]
            tried = (scales * nearest).reshape(-1, kept.shape[1])
            failing = tried[self.stops(tried) > self.event.threshold]
            self.calls += len(tried)
            if not len(failing):
                return None
            centre = failing[np.argmin(np.linalg.norm(failing, axis=1))]
        run = self.stops.run(centre, record_every=1)
        return None if run is None else FailingStop(float(np.linalg.norm(centre)), self.stops.drawn(centre), run)

    def _done(self, tasks: Sequence[Task]) -> list[dict[str, Any]]:
        """The results of tasks, those that the folder has from there."""
        paths = [None if self._folder is None else self._folder / f"{one.kind}-{one.number}.npz" for one in tasks]
        waiting: list[dict[str, Any] | Future[Any]] = []
        for task, path in zip(tasks, paths, strict=True):
            waiting.append(self._submit(task) if path is None or not path.is_file() else dict(np.load(path)))
        found = []
        for task, path, one in zip(tasks, paths, waiting, strict=True):
            result = one if isinstance(one, dict) else one.result()
            if path is not None and not path.is_file():
                with staged(path.parent) as new:
                    np.savez_compressed(new / path.name, **result)
            self._progress(f"{task.kind} {task.number + 1} of {len(tasks)}")
            found.append(result)
        return found

    def tail(self) -> Tail:
        """Over the values of every level."""
        rows = [np.concatenate([one.values[k] for one in self.repeats]) for k in range(len(self.levels) + 1)]
        places = np.linspace(0.005, 0.995, 100)
        x = np.unique(
            np.concatenate([np.quantile(row[np.isfinite(row)], places) for row in rows if np.isfinite(row).any()])
        )
        curves = subset.pooled(np.array([one.exceeded(x, self.levels) for one in self.repeats]))
        first = np.sort(rows[0])[::-1]
        ranks = np.unique(np.geomspace(1, len(first) / 2, 30).astype(int))
        plain = np.array([(first[rank - 1], *share(int(rank), len(first))) for rank in ranks])
        return Tail(x, curves.value, curves.low, curves.high, plain)

    def warnings(self) -> Iterator[str]:
        """What is wrong with levels and outcomes."""
        reached = np.mean([one.reached[-1] for one in self.repeats])
        low = min(
            (float(np.mean([one.accepted[k] for one in self.repeats])) for k in range(len(self.levels))), default=1.0
        )
        if (same := subset.repeated(self.repeats)) > _MOST_REPEATED:
            yield f"the outcome is discrete: {100 * same:.0f} % of the stops of a level have a value that others have"
        if low < _LEAST_ACCEPTED:
            yield f"the levels stall: at one only {100 * low:.1f} % of the moves are accepted; give more points"
        if all(one.probability(self.event.threshold) == 0.0 for one in self.repeats) and math.isfinite(
            self.event.threshold
        ):
            yield f"the levels stall: no stop met the event; its probability is below {reached:.1g}"
        if self.unresolved:
            yield f"{self.unresolved} of {self.calls} stops were refused or broken off; they count as the event"


@checked
def rare_event(
    campaign: Campaign,
    event: str,
    *,
    folder: str | Path | None = None,
    workers: int | None = 1,
    scheduler: str | None = None,
    points: int = POINTS,
    repeats: int = REPEATS,
    progress: Callable[[str], None] = lambda message: None,
) -> RareEvent:
    """Probability of an event over a campaign's quantities, random force and sensor noise.

    - campaign: of one controller and no grid; its number of runs and its sampling do not matter.
    - event: "lock", or a bound with its unit: "distance > 420 m", "time > 20 s", "slip > 0.5" (ratio).
    - folder: where finished repeats are kept, and resumed; left out, nothing is kept.
    - workers, scheduler: processes, or a Dask scheduler, as of `execute`; the numbers depend on neither.
    - points: number of stops in each level of a repeat.
    - repeats: number of independent repeats, which give the interval.
    - progress: told what is done.

    Returns the probability with its interval, in a `RareEvent`. InputError for another event or campaign.
    """
    study = _Study(campaign, Event.read(event), 1e-12, points, repeats)
    threshold = study.event.threshold
    with study.at_work(None if folder is None else Path(folder), workers, scheduler, progress):
        estimates = np.array([one.probability(threshold) for one in study.repeats])
        value, low, high, variation = map(float, subset.pooled(estimates))
        if value == 0.0:
            high = float(np.mean([one.reached[-1] for one in study.repeats]))
        groups = list(study.stops.groups.values())
        direction = subset.direction(study.repeats, groups)
        warnings, importance, other, stop = list(study.warnings()), None, math.nan, None
        rng = np.random.default_rng(np.random.SeedSequence(campaign.seed, spawn_key=(_SEED, 3)))
        if value > 0.0:
            kept = np.concatenate([one.points for one in study.repeats if one.probability(threshold) > 0.0])
            centre = subset.design_point(study.stops, direction.mean, threshold)
            study.calls += 50 + 40
            between = subset.apart(study.stops, kept, threshold, rng)
            if between > _MOST_APART:
                warnings.append(
                    f"the event is not one region about its mean: between {100 * between:.0f} % of pairs of its stops "
                    "there is none of it; a region that no repeat has met is missing from the probability"
                )
            by_repeat = subset.pooled(study.importance(direction.mean if centre is None else centre))
            importance, other = Estimate(*map(float, by_repeat[:3])), float(by_repeat.variation)
            if not abs(math.log(max(importance.value, 1e-300) / value)) <= _DISAGREE * math.hypot(variation, other):
                warnings.append(f"the methods disagree: importance sampling has {importance.value:.3g}")
            stop = study.failing_stop(kept, centre)
        if variation > _MOST_VARIATION:
            warnings.append(f"the coefficient of variation is {100 * variation:.0f} %; give more points")
    means = np.mean([one.mean for one in study.repeats], axis=0)
    return RareEvent(
        campaign=campaign,
        event=study.event,
        probability=Estimate(value, low, high),
        variation=variation,
        importance=importance,
        importance_variation=other,
        levels=tuple(level.threshold for level in study.levels),
        accepted=tuple(np.mean([one.accepted for one in study.repeats], axis=0).tolist()),
        shares=dict(zip(study.stops.groups, direction.shares.tolist(), strict=True)),
        directions={
            name: float(means[place.start])
            for name, place in study.stops.groups.items()
            if place.stop - place.start == 1
        },
        stop=stop,
        tail=study.tail(),
        stops=study.calls,
        warnings=tuple(warnings),
    )


@checked
def confidence_levels(
    campaign: Campaign,
    *,
    folder: str | Path | None = None,
    workers: int | None = 1,
    scheduler: str | None = None,
    points: int = POINTS,
    repeats: int = REPEATS,
    progress: Callable[[str], None] = lambda message: None,
) -> ConfidenceLevels:
    """The factor Kdry_rst of the deceleration for ETCS confidence levels 0 to 9.

    - campaign, folder, workers, scheduler, points, repeats, progress: as of `rare_event`.

    Returns ratios with 95 % intervals, and the whole tail. InputError as of `rare_event`, and for a nominal run that
    does not stop.
    """
    study = _Study(campaign, Event("deceleration", math.inf), _SMALLEST_LEVEL, points, repeats)
    nominal = mean_deceleration(study.stops.nominal)
    if nominal <= 0.0:
        raise InputError("scenario: its nominal run does not stop; give a controller that stops it")
    with study.at_work(None if folder is None else Path(folder), workers, scheduler, progress):
        tail = study.tail()
    probabilities = [0.5, *(10.0**-n for n in EBCL[1:])]
    curves = [np.where(curve > 0.0, curve, np.nan) for curve in (tail.value, tail.low, tail.high)]
    at = [-_exceeding(tail.x, curve, probabilities) / nominal for curve in curves]
    factors = tuple(
        Factor(n, p, float(k * nominal), Estimate(float(k), float(low), float(high)))
        for n, p, k, high, low in zip(EBCL, probabilities, *at, strict=True)
    )
    plain = tail.plain.copy()
    plain[:, 0] /= -nominal
    scaled = Tail(-tail.x / nominal, tail.value, tail.low, tail.high, plain)
    return ConfidenceLevels(campaign, nominal, factors, scaled, study.calls, tuple(study.warnings()))


def _exceeding(x: Floats, curve: Floats, probabilities: Sequence[float]) -> Floats:
    """Where a falling curve of probabilities over x has each of some; NaN beyond its end."""
    known = np.isfinite(curve)
    fall = -np.log(curve[known])
    return np.interp(-np.log(probabilities), fall, x[known], right=math.nan)
