"""Probability of a rare event over the random quantities of a campaign, its random force and its sensor noise.

The random inputs of a stop are standard normal variables. An input z of a quantity gives the value at which the
distribution function of the quantity is Phi(z), the standard normal distribution function. Other inputs
are the random numbers of random force and sensor noise up to `_REMEMBERED` times the duration of the nominal stop. The
last input gives the seed of the random numbers after this time.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from railslip_ctrl import __version__
from railslip_ctrl.core.arguments import Floats, checked, number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.folders import claimed, staged
from railslip_ctrl.core.records import by_content, dataclass
from railslip_ctrl.core.units import shown, to_unit
from railslip_ctrl.simulation.run import LOCKED_SHARE, Noise, Outcome, Run, Simulator

from . import subset
from .execution import check_version, workers_for
from .specification import Campaign, Grid, described, stream
from .statistics import Estimate, share
from .subset import Pooled

REPEATS, POINTS = 8, 1000  #: default number of independent estimates, and of stops in each level of an estimate
EBCL = range(10)  #: confidence levels of the emergency brake deceleration of ETCS: 0 is 50 %, n is 1 - 10^-n
FORCE, SENSORS = "random force", "sensor noise"

_REMEMBERED = 2.0
# limits of the warnings: share of pairs apart, coefficient of variation, share of accepted moves, share of equal values
_MOST_APART, _MOST_VARIATION, _LEAST_ACCEPTED, _MOST_REPEATED = 0.1, 0.3, 0.05, 0.05
_DISAGREE = 3.5  # standard errors between the two methods; with 8 repeats 1 of 100 differences is larger by chance
_SHOWN = 8  # number of failing stops among which the stop with the least noise is chosen
_STREAM = 2**32 - 2  # child of the campaign's seed; no run has this number

_MEASURES: dict[str, tuple[str, Callable[[Run], float]]] = {
    "distance": ("m", lambda run: run.braking_distance if run.stopped else math.inf),
    "time": ("s", lambda run: run.braking_time if run.stopped else math.inf),
    "slip": ("1", lambda run: run.max_slip),
    "deceleration": ("m/s^2", lambda run: -_deceleration(run)),
}
_KINDS: dict[str, tuple[Any, Any]] = {
    "pilot": (subset.pilot, subset.Levels),
    "repeat": (subset.repeat, subset.Repeat),
    "importance": (subset.importance, subset.Sampled),
}


def _deceleration(run: Run) -> float:
    """Mean deceleration over the distance of a stop, m/s^2; 0 if the train did not stop."""
    scenario = run.scenario
    change = scenario.initial_speed**2 - scenario.final_speed**2
    return change / (2.0 * run.braking_distance) if run.stopped else 0.0


class Event(NamedTuple):
    """The event that a result of a stop, named `measure`, exceeds a `threshold` in its unit."""

    measure: str
    threshold: float

    @property
    def unit(self) -> str:
        return _MEASURES[self.measure][0]

    def __str__(self) -> str:
        return f"{self.measure} > {self.threshold:g} {self.unit}".removesuffix(" 1")

    @classmethod
    def read(cls, text: str) -> Event:
        """Return the event for text: "distance > 420 m", "time > 20 s", "slip > 0.5", "lock"; otherwise InputError."""
        if text.strip() == "lock":
            return cls("slip", 1.0 - LOCKED_SHARE)
        found = re.fullmatch(r"\s*(distance|time|slip)\s*>\s*(.+)", text)
        if found is None or (found[1] != "slip" and re.fullmatch(r"[\d.\s]+", found[2])):
            raise InputError(
                f'event: {shown(text)} is not allowed; give lock, or a bound with its unit: "distance > 420 m", '
                '"time > 20 s", "slip > 0.5"'
            )
        name, unit = f"event: {found[1]}", _MEASURES[found[1]][0]
        threshold = to_unit(found[2], unit, name=name, text_needs_unit=unit != "1")
        return cls(found[1], number(name, threshold, "" if unit == "1" else unit, ge=0.0))


class Stops:
    """Function that simulates stops of a campaign; the result is the `measure` of each stop, or inf without a result.

    - groups: name of each quantity, of the random force and of the sensor noise, with the slice of its entries in the
      vector of random inputs.
    - counts: number of stops so far, and number of stops that did not reach their end, because a value was not allowed
      or the simulation failed.

    InputError for a campaign with several controllers, with a grid, or without a random input.
    """

    def __init__(self, campaign: Campaign, measure: str) -> None:
        self.campaign, self.read, self.counts = campaign, _MEASURES[measure][1], np.zeros(2, dtype=int)
        if len(campaign.controllers) > 1:
            raise InputError(f"controllers: {len(campaign.controllers)} given; a rare event needs exactly one")
        for quantity in campaign.quantities:
            if isinstance(quantity.distribution, Grid):
                raise InputError(
                    f"quantity: {quantity.name!r} is a grid, which has no probabilities; give the distribution 'choice'"
                )
        simulator = Simulator(campaign.scenario, campaign.controllers[0])
        self.nominal = simulator.run(None)
        force, noise = campaign.scenario.disturbances, campaign.scenario.measurement
        remembered = _REMEMBERED * self.nominal.braking_time
        forces = math.ceil(remembered / force.random_hold) if force.random_force > 0 else 0
        sensed = math.ceil(remembered / simulator.period) if max(noise.speed_noise, noise.wheel_noise) > 0 else 0
        sizes = {**dict.fromkeys(campaign.quantity_units, 1), FORCE: forces, SENSORS: 2 * sensed}
        ends = np.cumsum(list(sizes.values())).tolist()
        self.groups = {name: slice(end - n, end) for (name, n), end in zip(sizes.items(), ends, strict=True) if n}
        self.inputs = ends[-1] + 1
        if not self.groups:
            raise InputError(
                "campaign: nothing is random; give a quantity with a distribution, a random force or sensor noise"
            )

    def drawn(self, point: Floats) -> tuple[dict[str, float], Noise]:
        """Return each quantity's name and value, SI, and the noise for a `point`: values of all random inputs, (n,)."""
        from scipy.special import ndtr

        quantities = self.campaign.quantities
        shares = ndtr(point[: len(quantities)]).tolist()
        values = {one.name: one.distribution.at(u) for one, u in zip(quantities, shares, strict=True)}
        force, sensors = (point[self.groups.get(name, slice(0, 0))] for name in (FORCE, SENSORS))
        return values, Noise(force, sensors.reshape(-1, 2), int(point[-1:].view(np.int64)[0]) & (2**63 - 1))

    def run(self, point: Floats, record_every: int | None = None) -> Run:
        """Simulate the stop for a `point`, the values of all random inputs, (n,); InputError for values not allowed."""
        values, noise = self.drawn(point)
        scenario, (controller,) = self.campaign.with_values(values.values())
        return Simulator(scenario, controller).run(noise, record_every=record_every)

    def __call__(self, points: Floats) -> Floats:
        """Return the measure of n stops, (n,); each row of `points`, (n, inputs), has the random inputs of a stop."""
        return np.array([self._value(point) for point in points])

    def _value(self, point: Floats) -> float:
        self.counts[0] += 1
        try:
            run = self.run(point)
        except InputError:
            run = None
        if run is not None and run.outcome in (Outcome.STOPPED, Outcome.OUT_OF_TIME):
            return self.read(run)
        self.counts[1] += 1
        return math.inf


@by_content
class Tail(NamedTuple):
    """Probability that a result of a stop is worse than x, as a function of x.

    - x: values of the result, 1-D, in its unit.
    - value, low, high: probability and its interval at each x, ratios.
    - plain: for comparison, the share of worse stops among independently drawn stops, with Wilson's interval: rows
      (x, share, low, high), (n, 4), shares as ratios.
    """

    x: Floats
    value: Floats
    low: Floats
    high: Floats
    plain: Floats


@by_content
class FailingStop(NamedTuple):
    """Most likely stop in which the event occurs.

    - distance: length of the vector of all random inputs, measured from their medians, in standard deviations.
    - values: value of each quantity, SI; the keys are the names.
    - noise: random numbers of the random force and of the sensor noise.
    - run: the simulated stop.
    """

    distance: float
    values: dict[str, float]
    noise: Noise
    run: Run


@dataclass(frozen=True)
class RareEvent:
    """Probability of an event in a campaign's stops.

    - probability: `importance` if it has the smaller coefficient of variation and there is no warning, else `subset`.
    - subset, importance: estimates by subset simulation and by importance sampling, with 95 % interval and coefficient
      of variation, ratios; `importance` is None if no stop had the event.
    - levels: thresholds of the levels of subset simulation, in the unit of the event.
    - shares: contribution of each quantity, of the random force and of the sensor noise to the event, ratios. The
      random inputs are averaged over the stops with the event; a share is the part of the squared length of this mean.
    - stop: most likely stop with the event; None if no stop had the event, or if the values of this stop are not
      allowed.
    - tail: probability that the result of a stop is worse than a value, as a function of this value.
    - stops: number of simulated stops.
    - warnings: reasons not to trust the numbers; empty if there are none.
    """

    campaign: Campaign
    event: Event
    probability: Pooled
    subset: Pooled
    importance: Pooled | None
    levels: tuple[float, ...]
    shares: dict[str, float]
    stop: FailingStop | None
    tail: Tail
    stops: int
    warnings: tuple[str, ...]

    @property
    def measured(self) -> tuple[str, str]:
        """Name and unit of the result on the x axis of `tail`."""
        return self.event.measure, self.event.unit

    def __str__(self) -> str:
        value, low, high, _ = self.probability
        return f"P({self.event}) = {value:.3g} [{low:.2g}, {high:.2g}], {self.stops} stops"


class Factor(NamedTuple):
    """Factor Kdry_rst of ETCS for a confidence `level`.

    `probability` is the probability that the deceleration of a stop is below `factor` times the nominal deceleration.
    """

    level: int
    probability: float
    factor: Estimate


@dataclass(frozen=True)
class ConfidenceLevels:
    """The deceleration factor Kdry_rst for each confidence level of ETCS.

    - nominal: mean deceleration of the nominal stop, m/s^2.
    - factors: a `Factor` for each confidence level of `EBCL`.
    - tail: probability that the deceleration is below a factor times the nominal one, as a function of this factor.
    - campaign, stops, warnings, measured: as in `RareEvent`.
    """

    measured = "Kdry_rst", "1"

    campaign: Campaign
    nominal: float
    factors: tuple[Factor, ...]
    tail: Tail
    stops: int
    warnings: tuple[str, ...]

    def __str__(self) -> str:
        last = self.factors[-1]
        return f"Kdry_rst = {last.factor.value:.3g} at EBCL {last.level}, {self.stops} stops"


def work(shared: tuple[Campaign, Event], task: tuple[str, int, Any], version: str) -> dict[str, Any]:
    """Compute a `task` in a worker process; a task is a key of `_KINDS`, a number, and arguments for this kind."""
    check_version(version)
    (campaign, event), (kind, i, given) = shared, task
    stops = Stops(campaign, event.measure)
    rng = stream(campaign.seed, _STREAM, list(_KINDS).index(kind), i)
    found = _KINDS[kind][0](stops, stops.inputs, rng, event.threshold, *given)
    return {**found._asdict(), "counts": stops.counts}


class _Study:
    """Computation of the probability of an event; the results of finished tasks are kept in a folder."""

    def __init__(self, campaign: Campaign, event: Event, points: int, repeats: int) -> None:
        number("points", points, ge=100)
        number("repeats", repeats, ge=3)
        self.event, self.points, self.number, self.stops = event, points, repeats, Stops(campaign, event.measure)

    @contextmanager
    def at_work(
        self, folder: str | Path | None, workers: int | None, scheduler: str | None, progress: Callable[[str], None]
    ) -> Iterator[None]:
        """Start the worker processes, choose the levels of subset simulation, and compute the independent estimates."""
        campaign, event, self._progress = self.stops.campaign, self.event, progress
        what = json.dumps([__version__, {**described(campaign), "runs": 0}, *map(str, event), self.points])
        where = TemporaryDirectory() if folder is None else nullcontext(folder)
        made = workers_for(work, (campaign, event), workers, scheduler)
        with where as name, made as (self._submit, _), claimed(Path(name)):
            self._folder = Path(name) / f"rare-{hashlib.sha256(what.encode()).hexdigest()[:12]}"
            self._folder.mkdir(exist_ok=True)
            smallest = 1e-9 if math.isinf(event.threshold) else 1e-12
            (levels,) = self.done("pilot", 1, smallest, self.points // 2)
            self.repeats = self.done("repeat", self.number, tuple(levels), self.points)
            yield

    def done(self, kind: str, count: int, *given: Any) -> list[Any]:
        """Return the results of `count` tasks of a `kind` in `_KINDS` with the arguments `given`."""
        paths = [self._folder / f"{kind}-{i}.npz" for i in range(count)]
        waiting = {path: self._submit((kind, i, given)) for i, path in enumerate(paths) if not path.is_file()}
        found = []
        for i, path in enumerate(paths):
            if path in waiting:
                with staged(path.parent) as new:
                    np.savez_compressed(new / path.name, **waiting[path].result())
            result = dict(np.load(path))
            self._progress(f"{kind} {i + 1} of {count}")
            self.stops.counts += result.pop("counts")
            found.append(_KINDS[kind][1](**result))
        return found

    def tail(self) -> Tail:
        rows = np.concatenate([one.values for one in self.repeats], axis=1)
        finite = [row[np.isfinite(row)] for row in rows]
        if not any(row.size for row in finite):
            raise InputError(
                f"{self.event.measure}: no stop gave a value; each took more than longest_time "
                f"{self.stops.campaign.scenario.longest_time:g} s, or one of its quantities had a forbidden value; "
                "give a longer time, or narrower distributions"
            )
        x = np.unique(np.concatenate([np.quantile(row, np.linspace(0.005, 0.995, 100)) for row in finite if row.size]))
        first = np.sort(rows[0])[::-1]
        ranks = np.unique(np.geomspace(1, len(first) / 2, 30).astype(int))
        plain = np.array([(first[rank - 1], *share(int(rank), len(first))) for rank in ranks])
        return Tail(x, *subset.pooled(np.array([one.exceeded(x) for one in self.repeats]))[:3], plain)

    def warnings(self) -> list[str]:
        found, threshold = [], self.event.threshold
        if (same := max(map(subset.repeated, self.repeats))) > _MOST_REPEATED:
            found.append(f"the outcome is discrete: {100 * same:.0f} % of the stops in a level have equal results")
        if (low := np.mean([one.accepted for one in self.repeats], axis=0).min(initial=1.0)) < _LEAST_ACCEPTED:
            found.append(f"subset simulation accepts only {100 * low:.1f} % of a level's moves; give more points")
        if not any(one.probability(threshold) for one in self.repeats) and math.isfinite(threshold):
            found.append(f"the event occurred in no simulated stop; its probability is below {self.reached:.1g}")
        total, unresolved = self.stops.counts
        if unresolved:
            found.append(f"{unresolved} of {total} stops were not simulated to the end and count as the event")
        return found

    @property
    def reached(self) -> float:
        """Estimated probability that a stop reaches the last level of subset simulation."""
        return float(np.mean([np.prod(one.shares) for one in self.repeats]))

    def candidates(self, mean: Floats, kept: Floats) -> Iterator[Floats]:
        """Yield directions to search for the most likely failing stop: `mean`, then rows of `kept` with less noise."""
        yield mean
        count = len(self.stops.campaign.quantities)
        nearest = kept[np.argsort(np.linalg.norm(kept[:, :count], axis=1))[:_SHOWN]]
        for scale in np.linspace(0.0, 1.0, _SHOWN):
            yield from np.hstack([nearest[:, :count], scale * nearest[:, count:]])


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
    """Compute the probability of an event in stops with random quantities, random force and sensor noise.

    - campaign: campaign with one controller and no grid; its number of runs and its sampling have no effect.
    - event: "lock", or a bound with its unit: "distance > 420 m", "time > 20 s", "slip > 0.5" (ratio).
    - folder: folder for finished repeats, so that an interrupted study is resumed; by default no results are stored.
    - workers, scheduler: number of processes, or a Dask scheduler, as for `execute`; the results do not depend on them.
    - points: number of stops in each level of a repeat, and number of stops in a repeat of importance sampling.
    - repeats: number of independent estimates by each method; the intervals are computed from their differences.
    - progress: function that is called with a line of text for each finished task.

    InputError for a wrong event or campaign.
    """
    study = _Study(campaign, Event.read(event), points, repeats)
    stops, threshold, importance, stop = study.stops, study.event.threshold, None, None
    with study.at_work(folder, workers, scheduler, progress):
        found, warnings = study.repeats, study.warnings()
        estimates = np.array([one.probability(threshold) for one in found])
        by_subset = subset.pooled(estimates)
        mean, shares = subset.direction(np.array([one.mean for one in found]), stops.groups.values())
        if by_subset.value == 0.0:
            by_subset = by_subset._replace(high=study.reached)
        else:
            kept = np.concatenate([one.points for one, p in zip(found, estimates, strict=True) if p > 0.0])
            centre = subset.design_point(stops, study.candidates(mean, kept), threshold)
            between = subset.apart(stops, kept, threshold, stream(campaign.seed, _STREAM, len(_KINDS)))
            if between > _MOST_APART:
                warnings.append(
                    f"the event may have several regions: for {100 * between:.0f} % of the pairs of stops with the "
                    "event the stop midway does not have it; the probability lacks the regions that no repeat found"
                )
            values = np.array([one.value for one in study.done("importance", repeats, centre, points)])
            importance = subset.pooled(values)
            off = abs(math.log(max(importance.value, 1e-300) / by_subset.value))
            if off > _DISAGREE * math.hypot(by_subset.variation, importance.variation):
                warnings.append(
                    f"the methods disagree: importance sampling gives {importance.value:.3g}, subset simulation "
                    f"{by_subset.value:.3g}"
                )
            with suppress(InputError):  # the values are not allowed; `study.warnings` reports such stops
                run = stops.run(centre, record_every=1)
                stop = FailingStop(float(np.linalg.norm(centre)), *stops.drawn(centre), run)
        better = importance is not None and importance.variation < by_subset.variation and not warnings
        probability = importance if importance is not None and better else by_subset
        if probability.variation > _MOST_VARIATION:
            warnings.append(
                f"the coefficient of variation is {100 * probability.variation:.0f} %, more than "
                f"{100 * _MOST_VARIATION:g} %; give more points"
            )
    return RareEvent(
        campaign=campaign,
        event=study.event,
        probability=probability,
        subset=by_subset,
        importance=importance,
        levels=tuple(found[0].thresholds.tolist()),
        shares=dict(zip(stops.groups, shares.tolist(), strict=True)),
        stop=stop,
        tail=study.tail(),
        stops=int(stops.counts[0]),
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
    """Compute the factor Kdry_rst of the deceleration for ETCS confidence levels 0 to 9.

    - campaign, folder, workers, scheduler, points, repeats, progress: as in `rare_event`.

    Returns the factors with 95 % intervals, and the probability as a function of the factor. InputError as for
    `rare_event`, or if the train does not stop in the nominal run.
    """
    study = _Study(campaign, Event("deceleration", math.inf), points, repeats)
    nominal = _deceleration(study.stops.nominal)
    if nominal <= 0.0:
        raise InputError("scenario: the nominal run does not stop; give a controller that stops the train")
    with study.at_work(folder, workers, scheduler, progress):
        tail, warnings = study.tail(), study.warnings()
    ratio, plain = -tail.x / nominal, tail.plain / [-nominal, 1.0, 1.0, 1.0]
    probabilities = [0.5, *(10.0**-n for n in EBCL[1:])]
    value, high, low = (  # factors at which the curves of probability reach each level; NaN beyond their end
        np.interp(-np.log(probabilities), -np.log(curve[curve > 0.0]), ratio[curve > 0.0], right=math.nan)
        for curve in tail[1:4]
    )
    factors = (Estimate(*map(float, one)) for one in zip(value, low, high, strict=True))
    rows = tuple(Factor(*row) for row in zip(EBCL, probabilities, factors, strict=True))
    scaled = tail._replace(x=ratio, plain=plain)
    return ConfidenceLevels(campaign, nominal, rows, scaled, int(study.stops.counts[0]), tuple(warnings))
