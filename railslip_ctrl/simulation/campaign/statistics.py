"""What a campaign shows: statistics over its parts, read one after the other; comparisons; the worst runs."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from heapq import nlargest
from importlib import import_module
from itertools import combinations
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.user_files import close_match
from railslip_ctrl.simulation.run import Outcome

from .intervals import Estimate, Moments, quantile_ranks, share
from .rows import MEASURES
from .sampling import grid_points
from .selection import order_statistics
from .specification import Campaign
from .storage import Store

if TYPE_CHECKING:
    import pyarrow as pa
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

LEVELS = (0.05, 0.5, 0.95)
"""Quantiles reported."""

WORST = 5
"""Worst runs listed of each controller."""

LISTED = 20
"""Failed runs listed by number."""

BINS = 120
_SHOWN = 2000  # runs in the record for pictures: the first ones, which are as random as any
_HELD = 2_000_000  # numbers kept in memory between two passes; a longer campaign is read again

Series = tuple[str, str]  # controller, measure
Batch = dict[str, "NDArray[Any]"]
Quantiles = dict[float, Estimate]


class Histogram(NamedTuple):
    """Counts between `edges` (one more than counts); their running sum is the distribution function at the edges."""

    edges: Floats
    counts: NDArray[np.int64]

    def merged(self) -> Histogram:
        """With no more bins than its number of values can fill: about 2 n^(1/3), the rule of Rice University."""
        most = 2.0 * max(int(self.counts.sum()), 1) ** (1.0 / 3.0)
        bins = self.counts.size
        size = next(k for k in range(1, bins + 1) if (bins % k == 0 and bins / k <= most) or k == bins)
        return Histogram(self.edges[::size], self.counts.reshape(-1, size).sum(axis=1))


@dataclass(frozen=True)
class MeasureSummary:
    """A measure over the runs that stopped and have a finite value of it; `excluded` stopped without one."""

    name: str
    moments: Moments
    excluded: int
    quantiles: Quantiles
    histogram: Histogram

    @property
    def mean(self) -> Estimate:
        """With its interval."""
        return self.moments.estimate


@dataclass(frozen=True)
class ControllerSummary:
    """One controller over the runs that are there.

    `outcomes` counts every run; `failed` names, by outcome, the first runs that did not stop; `not_stopped` and
    `locked` are shares of all runs, and `worst` the rows of the stopped runs with the highest `worst_by`.
    """

    name: str
    outcomes: dict[str, int]
    failed: dict[str, tuple[int, ...]]
    not_stopped: Estimate
    locked: Estimate
    measures: dict[str, MeasureSummary]
    worst: tuple[dict[str, Any], ...]

    @property
    def stopped(self) -> int:
        """Runs that stopped."""
        return self.outcomes.get(Outcome.STOPPED.value, 0)


@dataclass(frozen=True)
class Paired:
    """Two controllers on the same sampled runs, where both stopped: `second` minus `first`."""

    first: str
    second: str
    measure: str
    pairs: int
    difference: Estimate
    second_smaller: Estimate


@dataclass(frozen=True)
class PointSummary:
    """One point of the campaign's grids: its values, and by controller the means and the runs that did not stop."""

    values: dict[str, float]
    means: dict[Series, Estimate]
    not_stopped: dict[str, Estimate]


@dataclass(frozen=True)
class CampaignSummary:
    """Results of the `runs` of a `campaign` that are there: by `controllers`, `paired`, and by `points` of the grids.

    `worst_by` is what the worst runs have most of; `sample` has the first runs' columns by controller, for pictures.
    """

    campaign: Campaign
    runs: int
    controllers: dict[str, ControllerSummary]
    paired: tuple[Paired, ...]
    points: tuple[PointSummary, ...]
    worst_by: str
    sample: dict[str, Batch]

    def table(self) -> str:
        """A line a controller: runs that stopped, braking distance, slip, and runs that locked a wheel."""
        text: str = import_module("railslip_ctrl.report.campaign").campaign_table(self)  # a room above this one
        return text

    @property
    def complete(self) -> bool:
        """Whether every run is there."""
        return self.runs == self.campaign.runs

    @property
    def any_stopped(self) -> bool:
        """Whether there is a run of any controller that stopped."""
        return any(found.stopped for found in self.controllers.values())


def summarise(store: Store, *, worst_by: str = "braking_distance_m") -> CampaignSummary:
    """The statistics of a campaign's `store`, finished or not; memory does not grow with its runs.

    Raises
    ------
    InputError
        `worst_by` is no measure, or the campaign has no finished part.
    """
    check_measure(worst_by)
    read = _reader(store)
    first = _FirstPass(store.campaign, worst_by)
    for batch in read():
        first.take(batch)
    if first.runs == 0:
        raise InputError(f"--out: {str(store.folder)!r} has no finished part yet; run the campaign")
    return first.summary(*_distributions(read, first.moments))


def check_measure(name: str) -> None:
    """InputError, with the nearest name, unless a measure has this name."""
    names = [measure.name for measure in MEASURES]
    if name not in names:
        raise InputError(
            f"--worst-by: {name!r} is no measure; {close_match(name, names)}choose one of {', '.join(names)}"
        )


# --- reading --------------------------------------------------------------------------------------------------------


class _Rows(NamedTuple):
    """Rows of one controller in a part, by column, and which of them stopped."""

    run: NDArray[np.int64]
    outcome: NDArray[np.str_]
    columns: Batch
    stopped: NDArray[np.bool_]


_Read = Callable[[], Iterable[dict[str, _Rows]]]


def _reader(store: Store) -> _Read:
    """Gives the parts from the beginning, by controller; kept where they are few."""
    width = len(store.schema().names)
    total = sum(part.stop - part.start for part in store.finished()) * len(store.campaign.controllers) * width

    def read() -> Iterator[dict[str, _Rows]]:
        return (_by_controller(table, store.campaign.controller_names) for table in store.tables())

    if total > _HELD:
        return read
    held = list(read())
    return lambda: held


def _by_controller(table: pa.Table, names: tuple[str, ...]) -> dict[str, _Rows]:
    """Rows come run by run, controllers in order within each."""
    plain = {name: table.column(name).to_numpy() for name in table.column_names}
    found = {}
    for k, name in enumerate(names):
        own = {column: values[k :: len(names)] for column, values in plain.items()}
        run, outcome = own.pop("run"), own.pop("outcome").astype(str)
        assert (own.pop("controller") == name).all(), "written in the order of the controllers"
        found[name] = _Rows(run, outcome, own, outcome == Outcome.STOPPED.value)
    return found


def _usable(rows: _Rows, measure: str) -> Floats:
    values = rows.columns[measure][rows.stopped]
    return values[np.isfinite(values)]


# --- passes ---------------------------------------------------------------------------------------------------------


def _moments(values: Floats) -> Moments:
    if values.size == 0:
        return Moments()
    mean = float(np.mean(values))
    return Moments(values.size, mean, float(np.sum((values - mean) ** 2)), float(values.min()), float(values.max()))


class _FirstPass:
    """Everything that one reading of the parts can tell."""

    def __init__(self, campaign: Campaign, worst_by: str) -> None:
        self._campaign, self._worst_by, self.runs = campaign, worst_by, 0
        names = campaign.controller_names
        self.moments = {(name, measure.name): Moments() for name in names for measure in MEASURES}
        self._outcomes = {name: Counter[str]() for name in names}
        self._failed: dict[str, dict[str, list[int]]] = {name: {} for name in names}
        self._stopped, self._locked = Counter[str](), Counter[str]()
        self._worst: dict[str, list[dict[str, Any]]] = {name: [] for name in names}
        self._pairs = list(combinations(names, 2))
        self._differences = {(*pair, measure.name): Moments() for pair in self._pairs for measure in MEASURES}
        self._smaller = Counter[tuple[str, str, str]]()
        self._points = grid_points([quantity.distribution for quantity in campaign.quantities])
        self._at_point: dict[tuple[int, str, str], Moments] = {}
        self._of_point, self._stopped_at = Counter[tuple[int, str]](), Counter[tuple[int, str]]()
        self._sample: dict[str, list[Batch]] = {name: [] for name in names}

    def take(self, batch: dict[str, _Rows]) -> None:
        """A part."""
        sampled = self.runs < _SHOWN
        self.runs += len(next(iter(batch.values())).run)
        for name, rows in batch.items():
            self._count(name, rows)
            self._keep_worst(name, rows)
            for measure in MEASURES:
                key = name, measure.name
                self.moments[key] = self.moments[key].joined(_moments(_usable(rows, measure.name)))
            if self._points > 1:
                self._group(name, rows)
            if sampled:
                self._sample[name].append({**rows.columns, "run": rows.run, "stopped": rows.stopped})
        for pair in self._pairs:
            self._compare(pair, batch[pair[0]], batch[pair[1]])

    def _count(self, name: str, rows: _Rows) -> None:
        self._outcomes[name].update(rows.outcome.tolist())
        self._stopped[name] += int(rows.stopped.sum())
        self._locked[name] += int(np.isfinite(rows.columns["first_lock_s"]).sum())
        for outcome in set(rows.outcome[~rows.stopped].tolist()):
            listed = self._failed[name].setdefault(outcome, [])
            listed += rows.run[rows.outcome == outcome][: LISTED - len(listed)].tolist()

    def _keep_worst(self, name: str, rows: _Rows) -> None:
        values = np.where(rows.stopped, rows.columns[self._worst_by], np.nan)
        usable = np.flatnonzero(np.isfinite(values))
        most = usable[np.argsort(values[usable], kind="stable")[-WORST:]]
        rows_of = [
            {"run": int(rows.run[i]), **{column: float(v[i]) for column, v in rows.columns.items()}} for i in most
        ]
        self._worst[name] = nlargest(WORST, [*self._worst[name], *rows_of], key=lambda row: row[self._worst_by])

    def _compare(self, pair: tuple[str, str], first: _Rows, second: _Rows) -> None:
        both = first.stopped & second.stopped
        for measure in MEASURES:
            difference = second.columns[measure.name][both] - first.columns[measure.name][both]
            difference, key = difference[np.isfinite(difference)], (*pair, measure.name)
            self._differences[key] = self._differences[key].joined(_moments(difference))
            self._smaller[key] += int((difference < 0).sum())

    def _group(self, name: str, rows: _Rows) -> None:
        points = rows.run % self._points
        for point in np.unique(points).tolist():
            here = points == point
            self._of_point[point, name] += int(here.sum())
            self._stopped_at[point, name] += int((here & rows.stopped).sum())
            for measure in MEASURES:
                values = rows.columns[measure.name][here & rows.stopped]
                key = point, name, measure.name
                self._at_point[key] = self._at_point.get(key, Moments()).joined(_moments(values[np.isfinite(values)]))

    def summary(self, quantiles: dict[Series, Quantiles], shapes: dict[Series, Histogram]) -> CampaignSummary:
        """All of it, with what the later passes found."""
        return CampaignSummary(
            campaign=self._campaign,
            runs=self.runs,
            controllers={name: self._controller(name, quantiles, shapes) for name in self._campaign.controller_names},
            paired=tuple(
                Paired(*key, found.count, found.estimate, share(self._smaller[key], found.count))
                for key, found in self._differences.items()
            ),
            points=tuple(self._point(point) for point in range(self._points)) if self._points > 1 else (),
            worst_by=self._worst_by,
            sample={
                name: {column: np.concatenate([part[column] for part in parts])[:_SHOWN] for column in parts[0]}
                for name, parts in self._sample.items()
            },
        )

    def _controller(
        self, name: str, quantiles: dict[Series, Quantiles], shapes: dict[Series, Histogram]
    ) -> ControllerSummary:
        stopped = self._stopped[name]
        measures = {}
        for measure in MEASURES:
            key = name, measure.name
            moments = self.moments[key]
            excluded = stopped - moments.count
            measures[measure.name] = MeasureSummary(measure.name, moments, excluded, quantiles[key], shapes[key])
        return ControllerSummary(
            name=name,
            outcomes=dict(self._outcomes[name]),
            failed={outcome: tuple(runs) for outcome, runs in self._failed[name].items()},
            not_stopped=share(self.runs - stopped, self.runs),
            locked=share(self._locked[name], self.runs),
            measures=measures,
            worst=tuple(self._worst[name]),
        )

    def _point(self, point: int) -> PointSummary:
        names = self._campaign.controller_names
        values = self._campaign.grid_values(point)
        means = {
            (name, measure.name): self._at_point.get((point, name, measure.name), Moments()).estimate
            for name in names
            for measure in MEASURES
        }
        failed = {}
        for name in names:
            total = self._of_point[point, name]
            failed[name] = share(total - self._stopped_at[point, name], total)
        return PointSummary(values, means, failed)


def _distributions(
    read: _Read, moments: dict[Series, Moments]
) -> tuple[dict[Series, Quantiles], dict[Series, Histogram]]:
    """Quantiles and histograms of every measure of every controller."""

    def batches() -> Iterator[dict[Series, Floats]]:
        return ({key: _usable(batch[key[0]], key[1]) for key in moments} for batch in read())

    ranks = {
        key: {level: quantile_ranks(level, found.count) for level in LEVELS}
        for key, found in moments.items()
        if found.count
    }
    flat = {key: sorted({r for of in levels.values() for r in of if r is not None}) for key, levels in ranks.items()}
    values = {
        key: dict(zip(flat[key], found.tolist(), strict=True)) for key, found in order_statistics(batches, flat).items()
    }
    quantiles = {key: _quantiles(ranks.get(key, {}), values.get(key, {})) for key in moments}
    edges = {key: np.linspace(*_range(found), BINS + 1) for key, found in moments.items()}
    counts = {key: np.zeros(BINS, dtype=np.int64) for key in moments}
    for batch in batches():
        for key, data in batch.items():
            counts[key] += np.histogram(data, edges[key])[0]
    return quantiles, {key: Histogram(edges[key], counts[key]) for key in moments}


def _quantiles(
    ranks: dict[float, tuple[int, int | None, int | None]], values: dict[int, float]
) -> dict[float, Estimate]:
    return {
        level: Estimate(
            values[own], -math.inf if low is None else values[low], math.inf if high is None else values[high]
        )
        for level, (own, low, high) in ranks.items()
    }


def _range(found: Moments) -> tuple[float, float]:
    """Of a histogram: a single value gets a width of its own."""
    if found.count == 0:
        return 0.0, 1.0
    width = found.high - found.low or max(abs(found.low), 1.0) * 1e-3
    return found.low, found.low + width
