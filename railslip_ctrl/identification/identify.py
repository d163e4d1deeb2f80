"""The job: a log, or several, to adhesion curve, fits and the slip to hold, as records."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.adhesion import ReferenceSlip
from railslip_ctrl.errors import DomainError, InputError
from railslip_ctrl.numeric import peak
from railslip_ctrl.parameters import Rail, Vehicle

from .alignment import Alignment, check_corrections
from .cells import Accumulator, Bins, Cells, Stretches
from .comparison import Score, compare, peak_slip
from .fits import Fit, fit
from .logs import BLOCK_BYTES, Broken, Log
from .models import CANDIDATES, Setting, check_model, check_options, fit_model, shape_of
from .motion import along_the_motion, is_followed, slip_ramp
from .observed import AdhesionStream, Observed, Observer
from .outliers import OutlierFilter
from .polynomials import ParameterPolynomial, over_initial_speed
from .record import Record
from .reference import PeakSlip, drift
from .rows import Rows
from .stamps import StampFilter
from .survey import Survey, mu_warning
from .timing import half_interval_late

Floats = NDArray[np.float64]

_LEAST_SAMPLES = 20
_LINE_POINTS = 200
_DRIFT_SPEEDS = (0.2, 0.4, 0.6, 0.8, 1.0)  # of the initial speed
_RAMP_SLIP = 0.05  # the ramp is looked at up to here at least, where the peak is lower
_LEAST_RAMP = 0.05  # m/s^2: slower than this, slip is held, not ramped


@dataclass(frozen=True)
class Options:
    """How to identify; None takes it from the log. See `railslip identify --help`.

    Parameters
    ----------
    model : str
        A model's name, or "best": of those with a formula the one with the lowest BIC.
    rail : Rail
    initial_speed, slip_acceleration, time_constant : float or None
        v0, m/s; R of the ramps, m/s^2; tau of the `observer`, s.
    columns, units : mapping
        Header and unit of a quantity's column, by quantity.
    delays, zeros : mapping
        By how much a quantity's column is late, s, and what it reads where it should read nought, SI; by quantity.
    fixed, bounds : mapping
        Value (SI), or lowest and highest, of a parameter, by name.
    block_bytes : int
        How much of a log is read at a time.
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
    block_bytes: int = BLOCK_BYTES


@dataclass(frozen=True)
class Curve:
    """What was taken from a log before anything is fitted.

    Attributes
    ----------
    name : str
        The file.
    survey : Survey
    time_constant : float
        tau, s.
    bins, cells, stretches : Bins, Cells, Stretches
    record : Record
        Rows for the fits along the motion.
    peak_slip : float
        Where the data's mu is highest: the adhesion regime lies below.
    wheel_column : str
        The quantity that the wheel's speed was read from.
    adhesion_samples, sliding_samples : int
    broken_lines, outliers : int
        Lines that were no rows; rows left out as outliers, those of time among them.
    warnings, notes : tuple of str
        What was wrong with the log; what was assumed.
    """

    name: str
    survey: Survey
    time_constant: float
    bins: Bins
    cells: Cells
    stretches: Stretches
    record: Record
    peak_slip: float
    wheel_column: str
    adhesion_samples: int
    sliding_samples: int
    broken_lines: int
    outliers: int
    warnings: tuple[str, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class ModelLine:
    """A fitted model's mu over slip, at the mean speed that the log has at each slip."""

    name: str
    slip: Floats
    mu: Floats


@dataclass(frozen=True)
class Identification:
    """A log identified.

    Attributes
    ----------
    vehicle : Vehicle
    options : Options
    curve : Curve
    setting : Setting
    scores : tuple of Score
        All models fitted, the lowest BIC first.
    chosen : Score
        The model asked for, or the first that is not the table.
    not_fitted : tuple of str
        Models left out of the comparison, and why.
    peaks : tuple of PeakSlip
        Over speed, on the log's rail and on wet rail.
    reference : ReferenceSlip or None
        Slips to hold at the initial speed; None without a peak.
    lines : tuple of ModelLine
        The models' curves, in the order of `scores`.
    warnings : tuple of str
        What was wrong with the log, and what the fits show to be.
    """

    vehicle: Vehicle
    options: Options
    curve: Curve
    setting: Setting
    scores: tuple[Score, ...]
    chosen: Score
    not_fitted: tuple[str, ...]
    peaks: tuple[PeakSlip, ...]
    reference: ReferenceSlip | None
    lines: tuple[ModelLine, ...]
    warnings: tuple[str, ...]


def read_curve(
    path: Path,
    vehicle: Vehicle,
    options: Options,
    *,
    progress: Callable[[float], None] | None = None,
    observed: Callable[[Observed], None] | None = None,
) -> Curve:
    """The adhesion curve of a log; memory does not grow with it.

    `progress` is told the share read, `observed` is given the samples as they come.
    InputError with one line for a log that cannot be used.
    """
    log = Log(path, columns=options.columns, units=options.units, block_bytes=options.block_bytes)

    def told() -> Iterator[Rows]:
        for rows in log.rows():
            yield rows
            if progress is not None:
                progress(log.share)
        if progress is not None:
            progress(log.share)

    try:
        gathered = _gathered(told(), log.name, vehicle, options, observed)
    except InputError as error:  # what was assumed may be what is wrong
        raise InputError("; ".join([str(error), *log.notes])) from None
    return _curve(*gathered, log.name, log.broken, log.stamps, log.notes)


def curve_of(rows: Rows, vehicle: Vehicle, options: Options, *, name: str = "log") -> Curve:
    """The adhesion curve of rows in memory, time growing from row to row. InputError as `read_curve`."""
    gathered = _gathered(iter([rows]), name, vehicle, options)
    return _curve(*gathered, name, Broken(), StampFilter(name), ())


def _gathered(
    blocks: Iterator[Rows],
    name: str,
    vehicle: Vehicle,
    options: Options,
    observed: Callable[[Observed], None] | None = None,
) -> tuple[OutlierFilter, AdhesionStream, Accumulator]:
    outliers = OutlierFilter()
    aligned = Alignment(options.delays, options.zeros, name)
    stream = AdhesionStream(vehicle, time_constant=options.time_constant, observer=options.observer)
    sums: Accumulator | None = None
    for rows in aligned.rows(_kept(blocks, outliers)):
        samples = stream.add(rows)
        if observed is not None:
            observed(samples)
        sums = sums or (Accumulator(stream.time_constant) if len(rows) else None)
        if sums is not None:
            sums.add(samples)
    stream.check(name)
    if sums is None or stream.survey.used < _LEAST_SAMPLES:
        raise InputError(
            f"{name}: {stream.survey.used} of {stream.survey.rows} rows are under brake with slip between "
            "0.005 and 0.98; give a log with braking, and check columns, units, --vehicle and the wheel's radius"
        )
    return outliers, stream, sums


def _kept(blocks: Iterator[Rows], outliers: OutlierFilter) -> Iterator[Rows]:
    """The rows without the outliers."""
    for rows in blocks:
        yield outliers.add(rows)
    rest = outliers.finish()
    if rest is not None:
        yield rest


def _curve(
    outliers: OutlierFilter,
    stream: AdhesionStream,
    sums: Accumulator,
    name: str,
    broken: Broken,
    stamps: StampFilter,
    notes: tuple[str, ...],
) -> Curve:
    cells, bins = sums.cells(), sums.bins()
    strange = mu_warning(bins.mean)
    peak = peak_slip(cells)
    below = cells.slip < peak
    return Curve(
        name=name,
        survey=stream.survey,
        time_constant=stream.time_constant,
        bins=bins,
        cells=cells,
        stretches=sums.stretches(),
        record=stream.recorder.record(),
        peak_slip=peak,
        wheel_column=stream.wheel_column,
        adhesion_samples=int(cells.count[below].sum()),
        sliding_samples=int(cells.count[~below].sum()),
        broken_lines=broken.count,
        outliers=outliers.count + stamps.count,
        warnings=(
            *_warnings(name, broken, stamps, outliers, stream),
            *(() if strange is None else (f"{name}: {strange}",)),
        ),
        notes=notes,
    )


def _warnings(
    name: str, broken: Broken, stamps: StampFilter, outliers: OutlierFilter, stream: AdhesionStream
) -> tuple[str, ...]:
    found = [f"{name}: {text}" for text in broken.first]
    if broken.count > len(broken.first):
        found.append(
            f"{name}: {broken.count} broken lines in all, the last line {broken.last}; every other line is used"
        )
    found += [f"{name}: {text}" for text in stamps.warnings]
    if outliers.count:
        found.append(f"{name}: {outliers.count} rows with outliers left out, the first in line {outliers.first_line}")
    found += [f"{name}: {text}" for text in stream.warnings]
    return tuple(found)


def identify(
    path: Path,
    vehicle: Vehicle,
    options: Options,
    *,
    progress: Callable[[float], None] | None = None,
    observed: Callable[[Observed], None] | None = None,
) -> Identification:
    """Identify a log: its curve, fits of the models asked for, their comparison, and the slip to hold.

    The CSV at `path` is as `railslip identify --help` says; `vehicle` gives wheel and load, `options` the rest;
    `progress` is told the share that is read, 0 to 1; `observed` is given the observed samples as they come.

    Raises
    ------
    InputError
        A log or an option that cannot be used, in one line.
    """
    _model_names(options)  # before a large log is read
    curve = read_curve(path, vehicle, options, progress=progress, observed=observed)
    return identify_curve(curve, vehicle, options)


def _model_names(options: Options) -> tuple[str, ...]:
    names = CANDIDATES if options.model == "best" else (options.model,)
    check_model(options.model)
    check_options(names, options.fixed, options.bounds)
    check_corrections(options.delays, options.zeros)
    return names


def identify_curve(curve: Curve, vehicle: Vehicle, options: Options) -> Identification:
    """Identify from an adhesion curve that is read already. InputError as `identify`."""
    names = _model_names(options)
    setting = setting_of(curve, vehicle, options)
    fits, failures = _fits(names, curve, vehicle, setting)
    if not fits:
        raise InputError("; ".join([failures[0], *(text for text in curve.warnings if "free rolling" in text)]))
    scores = compare(fits, curve.cells, curve.peak_slip)
    # the table follows any curve: it shows what a formula leaves, and is taken where it is asked for
    chosen = next((score for score in scores if score.fit.model.name != "table"), scores[0])
    peaks = _peaks(chosen, setting, curve.cells)
    return Identification(
        vehicle=vehicle,
        options=options,
        curve=curve,
        setting=setting,
        scores=scores,
        chosen=chosen,
        not_fitted=failures,
        peaks=peaks,
        reference=_reference(peaks, setting.rail),
        lines=tuple(_line(score.fit, curve.cells, setting) for score in scores),
        warnings=(*curve.warnings, *_late(chosen.fit, curve, vehicle, setting, options)),
    )


def _late(fit: Fit, curve: Curve, vehicle: Vehicle, setting: Setting, options: Options) -> tuple[str, ...]:
    """A sentence where the motion shows that the columns are out of step; not where one v0 stands for several."""
    if curve.survey.is_mixed:
        return ()
    late = half_interval_late(fit, curve.record, vehicle, setting.wheel_load)
    if late is None:
        return ()
    given = options.delays.get(curve.wheel_column, 0.0)
    remedy = f"if it is a difference of counts, give --delay {curve.wheel_column}={given + late:.3g}"
    if given:
        remedy = f"more than the --delay {curve.wheel_column}={given:.3g} that is given seems to be needed"
    if late < 0.0:
        remedy = "if torque or train speed are filtered, give their --delay"
    return (
        f"{curve.name}: the wheel's speed seems to be half an interval ({abs(late):.3g} s) or more "
        f"{'late' if late > 0 else 'early'} beside the other columns, which falsifies the fits; {remedy}",
    )


def _peaks(score: Score, setting: Setting, cells: Cells) -> tuple[PeakSlip, ...]:
    """The peaks over speed; a peak beyond all slip of the log is the formula's alone, and no slip to hold."""
    speeds = [share * setting.initial_speed for share in _DRIFT_SPEEDS]
    peaks = drift(score.fit, speeds, setting.wheel_load)
    seen = float(cells.slip.max())
    return tuple(peak.without_reference() if peak.slip > seen else peak for peak in peaks)


def _line(fit: Fit, cells: Cells, setting: Setting) -> ModelLine:
    order = np.argsort(cells.slip)
    slip = np.linspace(math.sqrt(cells.slip[order[0]]), math.sqrt(cells.slip[order[-1]]), _LINE_POINTS) ** 2
    if fit.followed is not None:
        return ModelLine(fit.model.name, slip, np.interp(slip, *fit.followed))
    speed = np.interp(slip, cells.slip[order], cells.speed[order])
    return ModelLine(fit.model.name, slip, fit.model.coefficient(fit.values, slip, speed, setting.wheel_load))


def setting_of(curve: Curve, vehicle: Vehicle, options: Options) -> Setting:
    """What the fits take as known: the wheel load, v0 and the ramp of the log, unless they are given."""
    v0 = curve.survey.initial_speed if options.initial_speed is None else options.initial_speed
    ramp, spread = slip_ramp(curve.record, vehicle.wheel.radius, max(curve.peak_slip, _RAMP_SLIP), v0)
    ramped = ramp >= _LEAST_RAMP
    return Setting(
        wheel_load=curve.survey.wheel_load,
        initial_speed=v0,
        slip_acceleration=ramp if ramped else None,
        given_acceleration=options.slip_acceleration,
        rail=options.rail,
        fixed=options.fixed,
        bounds=options.bounds,
        acceleration_spread=spread if ramped else None,
    )


def _fits(names: Sequence[str], curve: Curve, vehicle: Vehicle, setting: Setting) -> tuple[list[Fit], tuple[str, ...]]:
    shape = shape_of(curve.cells, curve.peak_slip)
    fits, failures = [], []
    for name in names:
        try:
            model = fit_model(name, curve.cells, shape, setting)
            profiles = not is_followed(model, curve.record)
            known = (curve.cells, curve.stretches, setting, curve.peak_slip, curve.time_constant)
            first = fit(model, *known, profiles=profiles)
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a search may try what overflows
                found = along_the_motion(first, curve.record, vehicle, curve.cells, setting)
                _check_peaks(found, setting)
                fits.append(found)
        except InputError as error:
            failures.append(f"{curve.name}: {name}: {error}" if len(names) > 1 else f"{curve.name}: {error}")
    return fits, tuple(failures)


def _check_peaks(found: Fit, setting: Setting) -> None:
    """InputError for a fitted law whose force is nowhere one that brakes, at the highest or the lowest speed."""
    for share in (_DRIFT_SPEEDS[0], _DRIFT_SPEEDS[-1]):
        law = found.model.make_force_law(found.values, found.law.rail)
        try:
            peak(law, share * setting.initial_speed, setting.wheel_load)
        except DomainError:
            raise InputError(
                "fitted to this log its adhesion is nowhere positive; check units, the wheel's radius and load "
                "(--vehicle)"
            ) from None


def _reference(peaks: Sequence[PeakSlip], rail: Rail) -> ReferenceSlip | None:
    """The slips to hold at the initial speed, the last of each rail; of a wet log both are the wet one."""
    held = {peak.rail: peak.reference for peak in peaks}
    dry, wet = held.get(rail, math.nan), held[Rail.WET]
    return ReferenceSlip(dry=dry, wet=wet) if math.isfinite(dry) and math.isfinite(wet) else None


@dataclass(frozen=True)
class Campaign:
    """Several logs identified with one model, and its parameters over the initial speed."""

    logs: tuple[Identification, ...]
    polynomials: tuple[ParameterPolynomial, ...]


def identify_several(
    paths: Sequence[Path], vehicle: Vehicle, options: Options, *, progress: Callable[[float], None] | None = None
) -> Campaign:
    """Identify logs at several initial speeds, `paths`, with one model; of "best", the one with the lowest sum of BIC.

    `vehicle`, `options`, `progress` and InputError as of `identify`.
    """
    whole = [path.resolve() for path in paths]
    for i, path in enumerate(whole):
        if path in whole[:i]:
            raise InputError(
                f"LOG.csv: {paths[i]} is given twice; give each log once, as each counts as a test of its own"
            )
    done = []
    for i, path in enumerate(paths):
        share = None if progress is None else (lambda x, i=i: progress((i + x) / len(paths)))
        done.append(identify(path, vehicle, options, progress=share))
    if options.model == "best":
        done = _with_one_model(done)
    fits = [each.chosen.fit for each in done]
    return Campaign(tuple(done), over_initial_speed([each.setting.initial_speed for each in done], fits))


def _with_one_model(done: Sequence[Identification]) -> list[Identification]:
    totals: dict[str, float] = {}
    for score in done[0].scores:
        name = score.fit.model.name
        same = [s for each in done for s in each.scores if s.fit.model.name == name]
        if len(same) == len(done) and name != "table":  # the knots of tables differ from log to log
            totals[name] = sum(s.bic for s in same)
    if not totals:
        raise InputError("model: no model fits every log; name one with --model")
    best = min(totals, key=lambda name: totals[name])
    return [_choosing(each, best) for each in done]


def _choosing(identification: Identification, name: str) -> Identification:
    chosen = next(s for s in identification.scores if s.fit.model.name == name)
    peaks = _peaks(chosen, identification.setting, identification.curve.cells)
    return replace(identification, chosen=chosen, peaks=peaks, reference=_reference(peaks, identification.setting.rail))
