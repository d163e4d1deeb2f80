"""Compute the adhesion curve of a log and collect the faults of the log; no model is fitted here.

Samples of mu are not stored. Their sums in cells of slip and train speed are enough for a least-squares fit to all
samples. A two-point Gauss rule gives the mean of a model's mu over a cell; it is exact if mu is a cubic polynomial of
slip. The noise of neighbouring samples is correlated. Sums over time intervals therefore give its long-run variance,
which is n times the variance of the mean of n samples for large n.
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
from .cleaning import Alignment, OutlierFilter, StampFilter, corrections_note
from .logs import BLOCK_BYTES, Broken, Column, Log, Rows
from .messages import message
from .observed import LEAST_PULL, MOST_ROWS, SLIP_RANGE, AdhesionStream, BrakedRows, Observed, Observer, Survey


@dataclass(frozen=True)
class Options:
    """Options of an identification, as in `railslip identify --help`.

    - model: name of a model, or "best": the formula with the lowest BIC that fits, or the table if no formula fits.
    - rail: rail condition of the log.
    - initial_speed: v0, m/s; None: the highest train speed of the log.
    - slip_acceleration: rate R of slip velocity on slip ramps, m/s^2; None: measured in the log, or 2.93 for "curve".
    - time_constant: tau of the `observer`, s; None: 0.05, or five intervals between rows if that is more.
    - columns, units: header cell of the column of each quantity, and its unit; the keys are quantities.
    - delays, zeros: delay, s, and sensor offset, SI, of each quantity; the keys are quantities.
    - fixed, bounds: values of parameters that are not fitted, and (lower, upper) bounds of fitted ones, SI.
    - skip_lines: number of lines to skip before the header.
    - block_bytes: number of bytes of a log that are read at a time.
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

SLIP_CELLS = 400  #: cells over slip ratios 0 to 1, equally wide in the slip's square root, hence narrow at low slip

SPEED_CELL = 10.0 * KMH  #: width of a cell in train speed, m/s
_SPEED_CELLS = 80  # up to 800 km/h

STRETCH = 5.0  #: length of the shortest stretches, in time constants of the observer

_MOST_STRETCHES = 8192  # if there are more, neighbouring stretches are added in pairs
_MOST_ENTRIES = 1 << 18  # (stretch, cell) pairs, 6 MB; leaves some hundred stretches if a log fills many cells

BINS = 50  #: number of bins over slip ratios 0 to 1, for display, as in [Park2008] Fig. 13


@dataclass(frozen=True)
class Bins:
    """Statistics of mu in each bin of slip ratio that has samples, as in [Park2008] Fig. 13; arrays of equal length."""

    low: Floats  # lower limit of the bin, slip ratio
    high: Floats  # upper limit of the bin, slip ratio
    slip: Floats  # mean slip ratio
    count: Integers  # number of samples
    mean: Floats  # mean mu
    deviation: Floats  # standard deviation of mu
    least: Floats  # smallest mu
    most: Floats  # largest mu


@dataclass(frozen=True)
class Cells:
    """Number of samples and means of slip, speed, load and mu in each cell that has samples; SI."""

    count: Floats  # number of samples
    slip: Floats
    speed: Floats
    load: Floats
    mu: Floats
    squares: Floats  # sum of the squared deviations of mu from its mean in the cell
    nodes: Floats  # slip ratios of a two-point Gauss rule for means over the cell, (2, cells)
    node_speeds: Floats  # m/s, (2, cells)
    weights: Floats  # weights of the rule, (2, cells)


@dataclass(frozen=True)
class Stretches:
    """Sums of the samples in each combination of time interval and cell that has samples; arrays of equal length."""

    length: float  # of every stretch, s
    stretch: Integers  # number of the stretch
    cell: Integers  # index of the cell in `Cells`
    count: Floats  # number of samples
    total: Floats  # sum of mu


_FINE = 1_000_000  # slip steps of `slip_counts`
_SUMS = ("count", "slip", "slip2", "slip3", "speed", "slip_speed", "mu", "mu2", "load")


class Accumulator:
    """Adds samples of mu to sums, block by block; `time_constant` is that of the observer, s.

    `slip_counts` contains the number of samples in each interval of the slip ratio; an interval is 1e-6 wide.
    """

    def __init__(self, time_constant: float) -> None:
        self._length = STRETCH * time_constant
        self._sums = np.zeros((len(_SUMS), SLIP_CELLS * _SPEED_CELLS))
        self._centre = 0.0  # subtracted from mu before summing, to avoid cancellation in the variance
        self._bins = np.zeros((4, BINS))
        self.slip_counts = np.zeros(_FINE, dtype=np.int64)
        self._least, self._most = np.full(BINS, np.inf), np.full(BINS, -np.inf)
        self._keys = np.empty(0, dtype=np.int64)
        self._entries = np.empty((2, 0))
        self._origin: float | None = None

    def add(self, samples: Observed) -> None:
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
        index = np.cumsum(self._sums[0] > 0) - 1  # index of a cell among the cells with samples
        count, total = self._entries
        return Stretches(
            length=self._length,
            stretch=self._keys // _CELLS,
            cell=index[self._keys % _CELLS],
            count=count,
            total=total + self._centre * count,
        )


_CELLS = SLIP_CELLS * _SPEED_CELLS

# Largest variance of the slip that can be due to rounding of its moments, for slip ratios up to 1.
_NO_SPREAD = 1e-13


def _summed(keys: Integers, values: Floats) -> tuple[Integers, Floats]:
    """Return the distinct `keys` in ascending order, and for each key the sum of each row of `values`."""
    distinct, index = np.unique(keys, return_inverse=True)
    return distinct, np.stack([np.bincount(index, row, minlength=len(distinct)) for row in values])


def _gauss_rule(m1: Floats, m2: Floats, m3: Floats) -> tuple[Floats, Floats]:
    """Nodes and weights, (2, n), of two-point Gauss rules for n distributions with moments m1, m2 and m3."""
    variance = np.maximum(m2 - m1**2, 0.0)
    spread = variance > _NO_SPREAD
    third = m3 - 3.0 * m1 * m2 + 2.0 * m1**3
    # with the variance V and the third central moment T, the nodes are at distances x from the mean, where
    # x^2 - (T/V) x - V = 0
    skew = np.divide(third, 2.0 * variance, out=np.zeros_like(m1), where=spread)
    # keeps a node from slips below 0, to which rounding and noise of the moments could move it
    skew = np.clip(skew, -np.sqrt(variance), np.sqrt(variance))
    root = np.sqrt(skew**2 + variance)
    low, high = skew - root, skew + root
    share = np.divide(high, high - low, out=np.full_like(m1, 0.5), where=spread)
    nodes = np.where(spread, m1 + np.stack([low, high]), m1)
    return np.clip(nodes, 0.0, 1.0), np.stack([share, 1.0 - share])


_PEAK_WINDOW = 0.15  # relative half width of the slip window over which mu is averaged to find its peak
_LEAST_SHARE = 0.002  # a window with a smaller share of all samples is not used


def peak_slip(cells: Cells) -> float:
    """Slip ratio at which the measured mu, averaged over neighbouring cells, is highest."""
    order = np.argsort(cells.slip)
    slip, n, total = cells.slip[order], cells.count[order], (cells.count * cells.mu)[order]
    counts, totals = (np.concatenate([[0.0], np.cumsum(x)]) for x in (n, total))
    low = np.searchsorted(slip, slip * (1.0 - _PEAK_WINDOW))
    high = np.searchsorted(slip, slip * (1.0 + _PEAK_WINDOW), side="right")
    samples = counts[high] - counts[low]
    mean = np.where(samples >= _LEAST_SHARE * counts[-1], (totals[high] - totals[low]) / samples, -math.inf)
    return float(slip[np.argmax(mean)])


# --- the curve -----------------------------------------------------------------------------------------------------

_LEAST_SAMPLES = 20  # a log with fewer samples under brake is refused


@dataclass(frozen=True)
class AdhesionCurve:
    """Adhesion data of a log, to which models can be fitted."""

    name: str  # file name of the log
    survey: Survey
    time_constant: float  # tau of the observer, s
    bins: Bins
    cells: Cells
    stretches: Stretches
    slip_counts: Integers
    record: BrakedRows  # unfiltered rows for prediction-error fits
    record_stride: int  # the record has one run in every `record_stride` runs of the log
    peak_slip: float  # slip ratio of the highest measured mu
    wheel_column: str  # quantity from which the wheel speed was read
    deceleration_ratio: float  # see `log_checks.deceleration_ratio`
    rolling: log_checks.Rolling | None  # None if the wheel never rolls without brake
    steps: tuple[log_checks.ColumnStep, ...]  # quantisation steps of the columns
    factors: Mapping[str, float]  # SI value of the unit in which each quantity is read
    broken_lines: int
    outliers: int
    findings: tuple[log_checks.Finding, ...]  # faults of the log
    notes: tuple[str, ...]  # assumptions made when the log is read

    @property
    def warnings(self) -> tuple[str, ...]:
        return tuple(f"{self.name}: {finding.text}" for finding in self.findings)

    def split_counts(self, slip: float) -> tuple[int, int]:
        """Number of samples below the slip ratio `slip`, and number of samples at or above it."""
        below = int(self.slip_counts[: round(slip * _FINE)].sum())
        return below, int(self.slip_counts.sum()) - below

    @property
    def highest_mu(self) -> float:
        return float(self.bins.mean.max())

    @property
    def followed_note(self) -> str:
        """Note on the number of rows that prediction-error fits use; empty if they use all rows."""
        if self.record_stride == 1:
            return ""
        return message("rows followed", rows=len(self.record), most=MOST_ROWS, stride=self.record_stride)


def read_curve(
    path: Path,
    vehicle: Vehicle,
    options: Options,
    *,
    progress: Callable[[float], None] | None = None,
    observed: Callable[[Observed], None] | None = None,
) -> AdhesionCurve:
    """Compute the adhesion curve of a log file; memory does not grow with the length of the file.

    `progress` is called with the share of the file that has been read, 0 to 1, and `observed` with each block of
    samples. InputError for a log that cannot be used.
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
        data = _LogData(log.name, vehicle, options, stamps.rows(blocks()), log.columns, observed)
    except InputError as error:  # the cause may be assumptions about the columns, or lines that could not be read
        raise log.refused(error) from None
    finally:
        log.close()
    return data.curve(log.broken, stamps, log.notes)


def curve_of(rows: Rows, vehicle: Vehicle, options: Options, *, name: str = "log") -> AdhesionCurve:
    """Compute the adhesion curve of rows in memory, ordered by time; InputError for rows that cannot be used."""
    return _LogData(name, vehicle, options, iter([rows]), {}).curve(Broken(), StampFilter(name), ())


class _LogData:
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
        self._rolling = self._free.result(speed_step=resolution["train_speed"], omega_step=omega_step)
        self._record = self._stream.recorder.record()
        self._check()

    def _check(self) -> None:
        survey = self._stream.survey
        unit = self._factors.get("time", 1.0)
        fault = log_checks.time_fault(self._record, self._vehicle, survey.highest_pull, unit)
        if fault is not None:
            raise InputError(f"{self._name}: {fault}")
        try:
            self._stream.check(self._name)
            if survey.used < _LEAST_SAMPLES:
                raise InputError(message("too few rows", name=self._name, survey=survey, slips=SLIP_RANGE))
        except InputError as error:  # a wrong wheel radius or speed unit may be the cause
            given = corrections_note(self._options.delays, self._options.zeros)
            wheel = [finding.text for finding in log_checks.rolling_findings(self._rolling, self._known())]
            raise InputError("; ".join([str(error), *given, *self._torque_hints(), *wheel])) from None
        fault = log_checks.rolling_fault(self._rolling, self._known())
        if fault is not None:
            raise InputError(f"{self._name}: {fault}")

    def _torque_hints(self) -> tuple[str, ...]:
        pull = self._stream.survey.highest_pull
        hint = log_checks.unit_hint(pull, self._factors)
        if pull > log_checks.HIGHEST_MU:
            return (hint,) if hint else ()
        if not 0.0 < pull < LEAST_PULL:
            return ()
        text = message("weak brake", pull=pull, least=LEAST_PULL)
        return (f"{text}; {hint}" if hint else text,)

    def _known(self, slope: float = math.inf, peak: float = 0.0) -> log_checks.Known:
        return log_checks.Known(self._vehicle, slope, peak, self._stream.wheel_column, self._options.zeros)

    def curve(self, broken: Broken, stamps: StampFilter, notes: tuple[str, ...]) -> AdhesionCurve:
        assert self._sums is not None, "checked"
        cells, bins, survey = self._sums.cells(), self._sums.bins(), self._stream.survey
        peak, radius, record = peak_slip(cells), self._vehicle.wheel.radius, self._record
        steps = log_checks.column_steps(
            self._outliers.resolution, self._columns, radius, survey.initial_speed, survey.wheel_load
        )
        free = [*log_checks.rolling_findings(self._rolling, self._known(float(bins.mean[0] / bins.slip[0]), peak))]
        ratio = log_checks.deceleration_ratio(record, self._vehicle)
        differs = log_checks.deceleration_differs(ratio) and not free  # a finding in `free` would be the cause
        other = (log_checks.Finding("deceleration", message("other deceleration", ratio=ratio)),) if differs else ()
        findings = (
            *self._dropped_rows(broken, stamps),
            *log_checks.survey_findings(survey),
            *free,
            *(
                log_checks.Finding("steps", f"column {step}: smaller changes are resolved only by averaging")
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

    def _dropped_rows(self, broken: Broken, stamps: StampFilter) -> Iterator[log_checks.Finding]:
        yield from (log_checks.Finding("lines", text) for text in broken.first)
        if broken.count > len(broken.first):
            yield log_checks.Finding("lines", message("broken lines", broken=broken))
        yield from (log_checks.Finding("time stamps", text) for text in stamps.warnings)
        if count := self._outliers.count:
            rows = "1 row" if count == 1 else f"{count} rows"
            yield log_checks.Finding("outliers", message("outliers", rows=rows, line=self._outliers.first_line))
