"""From a log to its adhesion curve, and all that is to be said of the log before anything is fitted.

Samples are reduced to sums by cell of slip and speed, to bins of the curve, and to sums over stretches of time: memory
is bounded, and least squares over every sample needs no more. With n, the mean and the scatter of mu in a cell, and the
moments of the slips that it is the mean over, the model's mean there is a two-point Gauss rule, exact for a cubic;
cells are 1/800 of the range wide or less. The noise of neighbouring samples is correlated: by the observer's filter, by
the rig, by the run. So its long-run variance, that of means over long times, is taken from stretches of time, their
number halved whenever they, or their entries by cell, grow beyond bounds, by adding neighbours.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import field
from pathlib import Path

import numpy as np

from railslip_ctrl.core.arguments import Floats, Integers
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.vehicle import Rail, Vehicle

from . import log_checks
from .cleaning import Alignment, OutlierFilter, StampFilter, corrections_told
from .logs import BLOCK_BYTES, Broken, Column, Log, Rows
from .observed import LEAST_PULL, MOST_ROWS, SLIP_RANGE, AdhesionStream, BrakedRows, Observed, Observer, Survey
from .words import told


@dataclass(frozen=True)
class Options:
    """How to identify; None takes it from the log. See `railslip identify --help`.

    - model: a model's name, or "best": of those with a formula the one with the lowest BIC.
    - rail
    - initial_speed, slip_acceleration, time_constant: v0, m/s; R of the ramps, m/s^2; tau of the `observer`, s.
    - columns, units: header and unit of a quantity's column, by quantity.
    - delays, zeros: column delay, s, and sensor offset, SI, by quantity.
    - fixed, bounds: value (SI), or lowest and highest, of a parameter, by name.
    - skip_lines: lines at the beginning of a log, before which no header is looked for.
    - block_bytes: how much of a log is read at a time.
    """

    model: str = "best"
    rail: Rail = Rail.DRY
    initial_speed: float | None = None
    slip_acceleration: float | None = None
    time_constant: float | None = None
    observer: Observer = Observer.CORRECTED
    columns: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    delays: Mapping[str, float] = field(default_factory=dict)
    zeros: Mapping[str, float] = field(default_factory=dict)
    fixed: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    skip_lines: int = 0
    block_bytes: int = BLOCK_BYTES


# --- sums over the samples -----------------------------------------------------------------------------------------


SLIP_CELLS = 400  #: cells over the slip ratio, of equal width in its square root: narrow where the curve rises

SPEED_CELL = 10.0 * KMH
_SPEED_CELLS = 80

STRETCH = 5.0  #: length of the shortest stretches, in time constants of the observer

_MOST_STRETCHES = 8192
_MOST_ENTRIES = 1 << 18  # of stretch and cell: 6 MB, and where a log fills many cells, some hundred stretches still

BINS = 50
"""Bins of the curve over slip ratios 0 to 1, as in [Park2008] Fig. 13: to be shown. Fits take the cells, finer ones."""


@dataclass(frozen=True)
class Bins:
    """mu over slip ratio, by bins that hold a sample: arrays of one length, as [Park2008] Fig. 13."""

    low: Floats
    high: Floats
    slip: Floats
    count: Integers
    mean: Floats
    deviation: Floats
    least: Floats
    most: Floats


@dataclass(frozen=True)
class Cells:
    """The cells that hold samples, arrays of one length: their count and means, SI.

    `squares` is the sum of the squared deviations from mu. `nodes`, `node_speeds` and `weights`, (2, cells), give the
    mean of a function over a cell.
    """

    count: Floats
    slip: Floats
    speed: Floats
    load: Floats
    mu: Floats
    squares: Floats
    nodes: Floats
    node_speeds: Floats
    weights: Floats


@dataclass(frozen=True)
class Stretches:
    """Sums by stretch of time, of a `length` in s, and cell, by its place in `Cells`: samples and total of mu."""

    length: float
    stretch: Integers
    cell: Integers
    count: Floats
    total: Floats


_FINE = 1_000_000
_SUMS = ("count", "slip", "slip2", "slip3", "speed", "slip_speed", "mu", "mu2", "load")


class Accumulator:
    """Sums over samples that come in blocks of any size; the result does not depend on how they come.

    `slip_counts` are samples by slip, in steps of a millionth, so that any slip may part them.
    """

    def __init__(self, time_constant: float) -> None:
        self._length = STRETCH * time_constant
        self._sums = np.zeros((len(_SUMS), SLIP_CELLS * _SPEED_CELLS))
        self._centre = 0.0  # mu is summed about it, so that squares do not cancel
        self._bins = np.zeros((4, BINS))
        self.slip_counts = np.zeros(_FINE, dtype=np.int64)
        self._least, self._most = np.full(BINS, np.inf), np.full(BINS, -np.inf)
        self._keys = np.empty(0, dtype=np.int64)
        self._entries = np.empty((2, 0))
        self._origin: float | None = None

    def add(self, samples: Observed) -> None:
        """Take samples in."""
        if not len(samples):
            return
        if self._origin is None:
            self._origin, self._centre = float(samples.time[0]), float(samples.mu[0])
        slip_cell = np.clip((np.sqrt(samples.slip) * SLIP_CELLS).astype(np.int64), 0, SLIP_CELLS - 1)
        speed_cell = np.clip((samples.speed / SPEED_CELL).astype(np.int64), 0, _SPEED_CELLS - 1)
        cell = slip_cell * _SPEED_CELLS + speed_cell
        mu = samples.mu - self._centre
        given = {"count": None, **vars(samples), "mu": mu, "mu2": mu**2}
        for row, weights in enumerate(given[name] for name in _SUMS):
            self._sums[row] += np.bincount(cell, weights, minlength=self._sums.shape[1])
        self.slip_counts += np.bincount((samples.slip * _FINE).astype(np.int64), minlength=_FINE)
        self._add_to_bins(samples, mu)
        self._add_stretches(samples, cell, mu)

    def _add_to_bins(self, samples: Observed, mu: Floats) -> None:
        at = np.minimum((samples.slip * BINS).astype(np.int64), BINS - 1)
        for row, weights in enumerate((None, samples.slip, mu, mu**2)):
            self._bins[row] += np.bincount(at, weights, minlength=BINS)
        np.minimum.at(self._least, at, samples.mu)
        np.maximum.at(self._most, at, samples.mu)

    def _add_stretches(self, samples: Observed, cell: Integers, mu: Floats) -> None:
        assert self._origin is not None
        stretch = ((samples.time - self._origin) / self._length).astype(np.int64)
        keys, entries = _summed(stretch * _CELLS + cell, np.stack([np.ones(len(mu)), mu]))
        self._keys, self._entries = _summed(
            np.concatenate([self._keys, keys]), np.concatenate([self._entries, entries], axis=1)
        )
        while len(self._keys) > _MOST_ENTRIES or len(np.unique(self._keys // _CELLS)) > _MOST_STRETCHES:
            stretch, cell = self._keys // _CELLS, self._keys % _CELLS
            self._length *= 2.0
            self._keys, self._entries = _summed(stretch // 2 * _CELLS + cell, self._entries)

    def bins(self) -> Bins:
        """The curve so far."""
        full = self._bins[0] > 0
        count, slip, total, squares = self._bins[:, full]
        edges = np.arange(BINS + 1) / BINS
        mean = total / count
        variance = np.maximum(squares / count - mean**2, 0.0) * count / np.maximum(count - 1.0, 1.0)
        return Bins(
            low=edges[:-1][full],
            high=edges[1:][full],
            slip=slip / count,
            count=count.astype(np.int64),
            mean=mean + self._centre,
            deviation=np.sqrt(variance),
            least=self._least[full],
            most=self._most[full],
        )

    def cells(self) -> Cells:
        """The cells so far."""
        s = dict(zip(_SUMS, self._sums[:, self._sums[0] > 0], strict=True))
        n = s["count"]
        mean = {name: s[name] / n for name in _SUMS[1:]}
        nodes, weights = _gauss_rule(mean["slip"], mean["slip2"], mean["slip3"])
        variance = mean["slip2"] - mean["slip"] ** 2
        covariance = mean["slip_speed"] - mean["slip"] * mean["speed"]
        tilt = np.divide(covariance, variance, out=np.zeros_like(n), where=variance > _NO_SPREAD)
        return Cells(
            count=n,
            slip=mean["slip"],
            speed=mean["speed"],
            load=mean["load"],
            mu=mean["mu"] + self._centre,
            squares=np.maximum(s["mu2"] - n * mean["mu"] ** 2, 0.0),
            nodes=nodes,
            node_speeds=np.maximum(mean["speed"] + tilt * (nodes - mean["slip"]), 0.5 * mean["speed"]),
            weights=weights,
        )

    def stretches(self) -> Stretches:
        """The stretches so far."""
        place = np.cumsum(self._sums[0] > 0) - 1
        count, total = self._entries
        return Stretches(
            length=self._length,
            stretch=self._keys // _CELLS,
            cell=place[self._keys % _CELLS],
            count=count,
            total=total + self._centre * count,
        )


_CELLS = SLIP_CELLS * _SPEED_CELLS

# Spread of slip, squared, that is rounding of moments of slips up to 1, not spread.
_NO_SPREAD = 1e-13


def _summed(keys: Integers, values: Floats) -> tuple[Integers, Floats]:
    """The distinct keys in order, and the sums of their columns."""
    distinct, place = np.unique(keys, return_inverse=True)
    return distinct, np.stack([np.bincount(place, row, minlength=len(distinct)) for row in values])


def _gauss_rule(m1: Floats, m2: Floats, m3: Floats) -> tuple[Floats, Floats]:
    """Nodes and weights, (2, n) each, of the two-point rule with the moments 1, m1, m2, m3.

    About the mean, with variance V and third moment T, the nodes solve x^2 - (T/V) x - V = 0.
    """
    variance = np.maximum(m2 - m1**2, 0.0)
    spread = variance > _NO_SPREAD
    third = m3 - 3.0 * m1 * m2 + 2.0 * m1**3
    skew = np.divide(third, 2.0 * variance, out=np.zeros_like(m1), where=spread)
    # a node may not leave the curve's rise for slips below 0: rounding and noise of the moments, not slip
    skew = np.clip(skew, -np.sqrt(variance), np.sqrt(variance))
    root = np.sqrt(skew**2 + variance)
    low, high = skew - root, skew + root
    share = np.divide(high, high - low, out=np.full_like(m1, 0.5), where=spread)
    nodes = np.where(spread, m1 + np.stack([low, high]), m1)
    return np.clip(nodes, 0.0, 1.0), np.stack([share, 1.0 - share])


_PEAK_WINDOW = 0.15  # half width, relative, of the window in which mu is averaged to find its peak
_LEAST_SHARE = 0.002  # of all samples that such a window must hold


def peak_slip(cells: Cells) -> float:
    """The slip ratio at which the data's mu, averaged over neighbouring cells, is highest."""
    order = np.argsort(cells.slip)
    slip, n, total = cells.slip[order], cells.count[order], (cells.count * cells.mu)[order]
    counts, totals = (np.concatenate([[0.0], np.cumsum(x)]) for x in (n, total))
    low = np.searchsorted(slip, slip * (1.0 - _PEAK_WINDOW))
    high = np.searchsorted(slip, slip * (1.0 + _PEAK_WINDOW), side="right")
    held = counts[high] - counts[low]
    mean = np.where(held >= _LEAST_SHARE * counts[-1], (totals[high] - totals[low]) / held, -math.inf)
    return float(slip[np.argmax(mean)])


# --- the curve -----------------------------------------------------------------------------------------------------


_LEAST_SAMPLES = 20


@dataclass(frozen=True)
class AdhesionCurve:
    """What was taken from a log before anything is fitted.

    `name` is the file, `time_constant` tau, s. `record` has rows for prediction-error fits, of one run in
    `record_stride`. `peak_slip` is where the data's own mu is highest, of which noise tells a part on a flat top:
    searches for a fit start there. `wheel_column` is the quantity that the wheel's speed was read from, `rolling` what
    the wheel showed without brake. `deceleration_ratio` is the train's deceleration over that which the wheel's
    adhesion and the resistance make, NaN where it is not known. `factors` have what one of a column's unit is in SI, by
    quantity. `findings` are what was wrong with the log, `notes` what was assumed.
    """

    name: str
    survey: Survey
    time_constant: float
    bins: Bins
    cells: Cells
    stretches: Stretches
    slip_counts: Integers
    record: BrakedRows
    record_stride: int
    peak_slip: float
    wheel_column: str
    deceleration_ratio: float
    rolling: log_checks.Rolling | None
    steps: tuple[log_checks.ColumnStep, ...]
    factors: Mapping[str, float]
    broken_lines: int
    outliers: int
    findings: tuple[log_checks.Finding, ...]
    notes: tuple[str, ...]

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings, a sentence each."""
        return tuple(f"{self.name}: {finding.text}" for finding in self.findings)

    def parted_at(self, slip: float) -> tuple[int, int]:
        """How many samples lie below a slip ratio, and how many from there on."""
        below = int(self.slip_counts[: round(slip * _FINE)].sum())
        return below, int(self.slip_counts.sum()) - below

    @property
    def highest_mu(self) -> float:
        """Highest mean of mu in a bin."""
        return float(self.bins.mean.max())

    @property
    def followed_note(self) -> str:
        """Which rows the prediction-error fits are of, where that is not every row under brake; else empty."""
        if self.record_stride == 1:
            return ""
        return told("rows followed", rows=len(self.record), most=MOST_ROWS, stride=self.record_stride)


def read_curve(
    path: Path,
    vehicle: Vehicle,
    options: Options,
    *,
    progress: Callable[[float], None] | None = None,
    observed: Callable[[Observed], None] | None = None,
) -> AdhesionCurve:
    """The adhesion curve of a log; memory does not grow with it.

    `progress` is told the share read, `observed` is given the samples as they come.
    InputError with one line for a log that cannot be used.
    """
    o = options
    log = Log(path, columns=o.columns, units=o.units, skip_lines=o.skip_lines, block_bytes=o.block_bytes)

    def blocks() -> Iterator[Rows]:
        for rows in log.rows():
            yield rows
            if progress is not None:
                progress(log.share)
        if progress is not None:
            progress(log.share)

    stamps = StampFilter(log.name)
    try:
        gathered = _Gathered(log.name, vehicle, options, stamps.rows(blocks()), log.columns, observed)
    except InputError as error:  # what was assumed or not read may be what is wrong
        raise log.refused(error) from None
    finally:
        log.close()
    return gathered.curve(log.broken, stamps, log.notes)


def curve_of(rows: Rows, vehicle: Vehicle, options: Options, *, name: str = "log") -> AdhesionCurve:
    """The adhesion curve of rows in memory, time growing from row to row. InputError as `read_curve`."""
    return _Gathered(name, vehicle, options, iter([rows]), {}).curve(Broken(), StampFilter(name), ())


class _Gathered:
    """What is gathered from the rows of a log, and what it shows; InputError where there is nothing to use."""

    def __init__(
        self,
        name: str,
        vehicle: Vehicle,
        options: Options,
        blocks: Iterator[Rows],
        columns: Mapping[str, Column],
        observed: Callable[[Observed], None] | None = None,
    ) -> None:
        self._name, self._vehicle, self._options, self._columns = name, vehicle, options, columns
        self._factors = {"brake_torque": 1.0, **{name: column.factor for name, column in columns.items()}}
        self._outliers, self._speeds = OutlierFilter(), log_checks.WheelSpeeds()
        self._free = log_checks.FreeRolling(vehicle)
        self._stream = AdhesionStream(vehicle, time_constant=options.time_constant, observer=options.observer)
        self._sums: Accumulator | None = None
        for rows in Alignment(options.delays, options.zeros, name).rows(self._outliers.rows(blocks)):
            if not len(rows):
                continue
            self._speeds.add(rows)
            self._free.add(self._stream.signals(rows))
            samples = self._stream.add(rows)
            if observed is not None:
                observed(samples)
            self._sums = self._sums or Accumulator(self._stream.time_constant)
            self._sums.add(samples)
        resolution, radius = self._outliers.resolution, vehicle.wheel.radius
        omega_step = max(resolution["wheel_angular_speed"], resolution["wheel_speed"] / radius)
        self._rolling = self._free.found(speed_step=resolution["train_speed"], omega_step=omega_step)
        self._record = self._stream.recorder.record()
        self._check()

    def _check(self) -> None:
        survey = self._stream.survey
        read = self._factors.get("time", 1.0)
        clock = log_checks.time_fault(self._record, self._vehicle, survey.highest_pull, read)
        if clock is not None:
            raise InputError(f"{self._name}: {clock}")
        try:
            self._stream.check(self._name)
            if survey.used < _LEAST_SAMPLES:
                raise InputError(told("too few rows", name=self._name, survey=survey, slips=SLIP_RANGE))
        except InputError as error:  # a wheel that does not follow its train may be the cause
            given = corrections_told(self._options.delays, self._options.zeros)
            wheel = [finding.text for finding in log_checks.rolling_findings(self._rolling, self._known())]
            raise InputError("; ".join([str(error), *given, *self._torque_told(), *wheel])) from None
        fault = log_checks.rolling_fault(self._rolling, self._known())
        if fault is not None:
            raise InputError(f"{self._name}: {fault}")

    def _torque_told(self) -> tuple[str, ...]:
        """What is to be said of torques that are all below what counts as braking, or of a unit that they may have."""
        pull = self._stream.survey.highest_pull
        hint = log_checks.unit_hint(pull, self._factors)
        if pull > log_checks.HIGHEST_MU:
            return (hint,) if hint else ()
        if not 0.0 < pull < LEAST_PULL:
            return ()
        text = told("weak brake", pull=pull, least=LEAST_PULL)
        return (f"{text}; {hint}" if hint else text,)

    def _known(self, slope: float = math.inf, peak: float = 0.0) -> log_checks.Known:
        return log_checks.Known(self._vehicle, slope, peak, self._stream.wheel_column, self._options.zeros)

    def curve(self, broken: Broken, stamps: StampFilter, notes: tuple[str, ...]) -> AdhesionCurve:
        """The curve, with what else was met."""
        assert self._sums is not None, "checked"
        cells, bins, survey = self._sums.cells(), self._sums.bins(), self._stream.survey
        peak, radius, record = peak_slip(cells), self._vehicle.wheel.radius, self._record
        steps = log_checks.column_steps(
            self._outliers.resolution, self._columns, radius, survey.initial_speed, survey.wheel_load
        )
        free = [*log_checks.rolling_findings(self._rolling, self._known(float(bins.mean[0] / bins.slip[0]), peak))]
        ratio = log_checks.deceleration_ratio(record, self._vehicle)
        differs = log_checks.deceleration_differs(ratio) and not free  # else the cause is told
        other = (log_checks.Finding("deceleration", told("other deceleration", ratio=ratio)),) if differs else ()
        findings = (
            *self._left_out(broken, stamps),
            *log_checks.survey_findings(survey),
            *free,
            *(
                log_checks.Finding("steps", f"column {step}: what is finer is known from means alone")
                for step in steps
                if step.matters
            ),
            *log_checks.load_findings(record, self._vehicle.wheel_load),
            *self._speeds.findings(radius),
            *log_checks.mu_findings(bins.mean, self._factors),
            *other,
        )
        return AdhesionCurve(
            name=self._name,
            survey=survey,
            time_constant=self._stream.time_constant,
            bins=bins,
            cells=cells,
            stretches=self._sums.stretches(),
            slip_counts=self._sums.slip_counts,
            record=record,
            record_stride=self._stream.recorder.stride,
            peak_slip=peak,
            wheel_column=self._stream.wheel_column,
            deceleration_ratio=ratio,
            rolling=self._rolling,
            steps=steps,
            factors=self._factors,
            broken_lines=broken.count,
            outliers=self._outliers.count + stamps.count,
            findings=findings,
            notes=notes,
        )

    def _left_out(self, broken: Broken, stamps: StampFilter) -> Iterator[log_checks.Finding]:
        """Lines that were no rows, stray time stamps, outliers."""
        yield from (log_checks.Finding("lines", text) for text in broken.first)
        if broken.count > len(broken.first):
            yield log_checks.Finding("lines", told("broken lines", broken=broken))
        yield from (log_checks.Finding("time stamps", text) for text in stamps.warnings)
        if count := self._outliers.count:
            rows = "1 row" if count == 1 else f"{count} rows"
            yield log_checks.Finding("outliers", told("outliers", rows=rows, line=self._outliers.first_line))
