"""Statistics of a campaign: estimates, comparisons of controllers, and worst runs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import nullcontext
from importlib import import_module
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from railslip_ctrl.core.arguments import Floats, Integers, checked
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import by_content, dataclass
from railslip_ctrl.core.user_files import close_match
from railslip_ctrl.simulation.run import Outcome
from railslip_ctrl.simulation.scenario import Scenario

from .execution import MEASURES, Store, execute
from .specification import Campaign, Quantity

if TYPE_CHECKING:
    import pyarrow as pa

    Columns = dict[str, Floats]

CONFIDENCE = 0.95  #: confidence level of every interval
LEVELS = (0.05, 0.5, 0.95)  #: levels of the reported quantiles
WORST = 5  #: number of worst runs listed for each controller
LISTED = 20  #: largest number of failed runs listed for an outcome
BINS = 120

_SHOWN = 2000  # number of runs in pictures; runs are independent, so that the first ones are a random sample


class Estimate(NamedTuple):
    """Estimated value and its confidence interval from `low` to `high`; with too few runs a bound is infinite."""

    value: float
    low: float
    high: float


_UNKNOWN = Estimate(math.nan, math.nan, math.nan)


@dataclass(frozen=True)
class Moments:
    """Number, mean, sample standard deviation, minimum and maximum; mean and deviation of too few values are NaN."""

    count: int
    mean: float
    std: float
    low: float
    high: float

    @classmethod
    def of(cls, values: Floats) -> Moments:
        finite = values[np.isfinite(values)]
        if not finite.size:
            return cls(0, math.nan, math.nan, math.inf, -math.inf)
        std = float(finite.std(ddof=1)) if finite.size > 1 else math.nan
        return cls(finite.size, float(finite.mean()), std, float(finite.min()), float(finite.max()))

    @property
    def estimate(self) -> Estimate:
        """Mean with its confidence interval by Student's t-distribution."""
        if self.count < 2:
            return Estimate(self.mean, -math.inf, math.inf) if self.count else _UNKNOWN
        from scipy import stats

        half = float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, self.count - 1)) * self.std / math.sqrt(self.count)
        return Estimate(self.mean, self.mean - half, self.mean + half)


def share(count: int, total: int) -> Estimate:
    """Return the ratio `count`/`total` with Wilson's confidence interval; NaN if `total` is 0."""
    if total == 0:
        return _UNKNOWN
    from scipy import stats

    interval = stats.binomtest(count, total).proportion_ci(CONFIDENCE, method="wilson")
    return Estimate(count / total, float(interval.low), float(interval.high))


def quantile(values: Floats, level: float) -> Estimate:
    """Return the quantile of `values`, 1-D, at probability `level` (ratio), with its confidence interval."""
    from scipy import stats

    # interval from order statistics: Conover, Practical Nonparametric Statistics, 3.2
    low, high = stats.quantile_test(values, p=level).confidence_interval(CONFIDENCE)
    return Estimate(
        float(np.quantile(values, level, method="inverted_cdf")),
        -math.inf if math.isnan(low) else float(low),
        math.inf if math.isnan(high) else float(high),
    )


@by_content
class Histogram(NamedTuple):
    """Histogram with n `counts` between n + 1 `edges`."""

    edges: Floats
    counts: Integers

    @classmethod
    def of(cls, values: Floats) -> Histogram:
        """Return the histogram of finite `values`, 1-D, with `BINS` bins of equal width."""
        low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
        edges = np.linspace(low, high if high > low else low + max(abs(low), 1.0) * 1e-3, BINS + 1)
        return cls(edges, np.histogram(values, edges)[0])

    def merged(self) -> Histogram:
        """Return a histogram with fewer, wider bins: at most 2 n^(1/3) bins for n values."""
        most = 2.0 * max(int(self.counts.sum()), 1) ** (1.0 / 3.0)
        bins = self.counts.size
        size = next(k for k in range(1, bins + 1) if (bins % k == 0 and bins / k <= most) or k == bins)
        return Histogram(self.edges[::size], self.counts.reshape(-1, size).sum(axis=1))


@dataclass(frozen=True)
class MeasureSummary:
    """Statistics of a measure over those runs of a controller that stopped and in which the measure is finite.

    `excluded` is the number of stopped runs in which the measure is not finite.
    """

    moments: Moments
    excluded: int
    quantiles: dict[float, Estimate]
    histogram: Histogram


@dataclass(frozen=True)
class ControllerSummary:
    """Statistics of one controller over the finished runs.

    - outcomes: number of runs by outcome.
    - failed: for each outcome other than a stop, the numbers of the first runs with this outcome.
    - not_stopped, locked: share of the runs that did not stop, and share of the runs with a locked wheel.
    - measures: statistics of each measure, by name.
    - worst: results of the stopped runs with the highest values of the measure `worst_by` of the `CampaignSummary`.
    """

    name: str
    outcomes: dict[str, int]
    failed: dict[str, list[int]]
    not_stopped: Estimate
    locked: Estimate
    measures: dict[str, MeasureSummary]
    worst: list[dict[str, Any]]

    @property
    def stopped(self) -> int:
        return self.outcomes.get(Outcome.STOPPED.value, 0)


@dataclass(frozen=True)
class Paired:
    """Comparison of two controllers, `first` and `second`, by a measure, over the runs in which both stopped.

    - pairs: number of these runs.
    - difference: mean of the value of `second` minus that of `first`.
    - second_smaller: share of these runs in which the value of `second` is smaller.
    """

    first: str
    second: str
    measure: str
    pairs: int
    difference: Estimate
    second_smaller: Estimate


@dataclass(frozen=True)
class PointSummary:
    """Statistics of the runs with one combination of grid values.

    - values: grid values by name of the quantity, SI.
    - means: mean of each measure, by (controller, measure).
    - not_stopped: share of the runs that did not stop, by controller.
    """

    values: dict[str, float]
    means: dict[tuple[str, str], Estimate]
    not_stopped: dict[str, Estimate]


@dataclass(frozen=True)
class CampaignSummary:
    """Statistics of the finished runs of a `campaign`.

    - runs: number of finished runs.
    - controllers: statistics of each controller, by name.
    - paired: comparison of every two controllers by each measure.
    - points: statistics for each combination of grid values; empty without a grid.
    - worst_by: name of the measure that ranks the worst runs.
    - sample: values for pictures, SI: for each controller, the quantities and the measure `worst_by` in the first runs.
      The measure is NaN for a run that did not stop.
    """

    campaign: Campaign
    runs: int
    controllers: dict[str, ControllerSummary]
    paired: list[Paired]
    points: list[PointSummary]
    worst_by: str
    sample: dict[str, Columns]

    def table(self) -> str:
        """Return a table with stopped runs, braking distance, slip and locked runs of each controller, as text."""
        # imported when called, because `report` imports this package
        text: str = import_module("railslip_ctrl.report.campaign").campaign_table(self)
        return text

    @property
    def complete(self) -> bool:
        """True if every run is finished."""
        return self.runs == self.campaign.runs

    @property
    def any_stopped(self) -> bool:
        """True if at least one run of any controller stopped."""
        return any(summary.stopped for summary in self.controllers.values())


def check_measure(name: str) -> None:
    """Raise InputError if `name` is not the name of a measure."""
    names = [measure.name for measure in MEASURES]
    if name not in names:
        raise InputError(
            f"worst by: unknown measure {name!r}; {close_match(name, names)}choose one of {', '.join(names)}"
        )


class _Runs:
    """Results of all finished parts of a campaign; each column is an array of shape (runs, controllers)."""

    def __init__(self, store: Store) -> None:
        self._store, self._parts = store, list(store.finished())
        self.names = store.campaign.controller_names
        if not self._parts:
            raise InputError(f"out: {str(store.folder)!r} has no results yet; run the campaign")
        self.number = np.concatenate([np.arange(*part) for part in self._parts])
        outcomes = self._column("outcome").combine_chunks().dictionary_encode()
        self.outcomes: list[str] = outcomes.dictionary.to_pylist()
        self.outcome = outcomes.indices.to_numpy().reshape(-1, len(self.names))
        self.stopped = np.isin(self.outcome, [k for k, o in enumerate(self.outcomes) if o == Outcome.STOPPED.value])

    def _column(self, name: str) -> pa.ChunkedArray:
        import pyarrow as pa

        return pa.concat_tables(self._store.read(part, [name]) for part in self._parts).column(0)

    def column(self, name: str) -> Floats:
        values: Floats = self._column(name).to_numpy().reshape(-1, len(self.names))
        return values

    def of_stopped(self, name: str) -> Floats:
        values = np.where(self.stopped, self.column(name), np.nan)
        return np.where(np.isfinite(values), values, np.nan)

    def rows(self, k: int, values: Floats) -> list[dict[str, Any]]:
        order = np.argsort(-values, kind="stable")[: min(WORST, np.isfinite(values).sum())]
        rows = []
        for i in self.number[order].tolist():
            row = self._store.row(i)[self.names[k]]
            del row["controller"], row["outcome"]
            rows.append({name: math.nan if value is None else value for name, value in row.items()})
        return rows


def summarise(store: Store, *, worst_by: str = "braking_distance_m") -> CampaignSummary:
    """Return the statistics of the finished runs in a campaign's `store`.

    `worst_by` is the name of the measure that ranks the worst runs. InputError for an unknown measure, or if the store
    has no results yet.
    """
    check_measure(worst_by)
    runs, campaign = _Runs(store), store.campaign
    pairs = list(combinations(range(len(runs.names)), 2))
    point, count = runs.number % campaign.grid_points, campaign.grid_points
    points = [np.flatnonzero(point == p) for p in range(count if count > 1 else 0)]  # indices of the runs at each point
    controllers = _controllers(runs)
    paired: list[list[Paired]] = []
    means: list[dict[tuple[str, str], Estimate]] = [{} for _ in points]
    for measure in MEASURES:  # one column in memory at a time
        values = runs.of_stopped(measure.name)
        paired.append([_paired(runs, first, second, measure.name, values) for first, second in pairs])
        for k, (name, summary) in enumerate(controllers.items()):
            summary.measures[measure.name] = _measure(values[:, k], summary.stopped)
            for at, mean in zip(points, means, strict=True):
                mean[name, measure.name] = Moments.of(values[at, k]).estimate
            if measure.name == worst_by:
                summary.worst.extend(runs.rows(k, values[:, k]))
                shown = values[:_SHOWN].copy()
    sampled = {name: runs.column(name)[:_SHOWN].copy() for name in campaign.quantity_units}
    return CampaignSummary(
        campaign=campaign,
        runs=runs.number.size,
        controllers=controllers,
        paired=[row[p] for p in range(len(pairs)) for row in paired],
        points=[
            PointSummary(
                campaign.grid_values(p),
                {(name, measure.name): means[p][name, measure.name] for name in runs.names for measure in MEASURES},
                {name: share(int((~runs.stopped[at, k]).sum()), at.size) for k, name in enumerate(runs.names)},
            )
            for p, at in enumerate(points)
        ],
        worst_by=worst_by,
        sample={
            name: {**{q: v[:, k] for q, v in sampled.items()}, worst_by: shown[:, k]}
            for k, name in enumerate(runs.names)
        },
    )


def _controllers(runs: _Runs) -> dict[str, ControllerSummary]:
    locked, summaries = np.isfinite(runs.column("first_lock_s")), {}
    for k, name in enumerate(runs.names):
        numbers = {outcome: runs.number[runs.outcome[:, k] == i] for i, outcome in enumerate(runs.outcomes)}
        numbers = {outcome: own for outcome, own in numbers.items() if own.size}
        summaries[name] = ControllerSummary(
            name=name,
            outcomes={outcome: own.size for outcome, own in numbers.items()},
            failed={outcome: own[:LISTED].tolist() for outcome, own in numbers.items() if outcome != Outcome.STOPPED},
            not_stopped=share(int((~runs.stopped[:, k]).sum()), runs.number.size),
            locked=share(int(locked[:, k].sum()), runs.number.size),
            measures={},
            worst=[],
        )
    return summaries


def _measure(values: Floats, stopped: int) -> MeasureSummary:
    finite = values[np.isfinite(values)]
    quantiles = {level: quantile(finite, level) for level in LEVELS if finite.size}
    return MeasureSummary(Moments.of(finite), stopped - finite.size, quantiles, Histogram.of(finite))


def _paired(runs: _Runs, first: int, second: int, measure: str, values: Floats) -> Paired:
    difference = values[:, second] - values[:, first]
    moments = Moments.of(difference)
    smaller = share(int((difference < 0).sum()), moments.count)
    return Paired(runs.names[first], runs.names[second], measure, moments.count, moments.estimate, smaller)


@checked
def campaign(
    scenario: Scenario,
    controllers: Sequence[Any],
    runs: int = 200,
    *,
    quantities: Sequence[Quantity] = (),
    seed: int = 0,
    folder: str | Path | None = None,
    workers: int = 1,
) -> CampaignSummary:
    """Run a scenario many times and return the statistics, SI.

    Each run has its own noise, which is the same for every controller.

    - scenario: braking run, SI.
    - controllers: one or more controllers as for `simulate`.
    - runs: number of runs of each controller.
    - quantities: quantities that vary from run to run, SI.
    - seed: seed of the campaign; the same seed gives the same runs.
    - folder: folder for the results, from which an interrupted campaign continues; by default no results are stored.
    - workers: number of processes. With more than one, the calling script needs `if __name__ == "__main__"`, because
      each process imports it.

    InputError as for `Campaign` and `execute`.
    """
    made = Campaign(scenario, tuple(controllers), runs, tuple(quantities), seed)
    with nullcontext(folder) if folder is not None else TemporaryDirectory() as place:
        return summarise(execute(made, Path(place), workers=workers))
