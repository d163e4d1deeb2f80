"""Identify an adhesion law from one log or several; the result is an `Identification` or a `LogSeries`.

The confidence intervals of the parameters take most of the computing time; only the chosen model gets them.
"""

from __future__ import annotations

import filecmp
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from railslip_ctrl.core.arguments import Floats, checked
from railslip_ctrl.core.errors import DomainError, InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion import ReferenceSlip
from railslip_ctrl.model.numeric import peak
from railslip_ctrl.model.vehicle import Rail, Vehicle

from . import models, results
from .cleaning import LONGEST_DELAY, check_corrections
from .curves import AdhesionCurve, Cells, Options, read_curve
from .fits import Fit, fit
from .log_checks import (
    HIGHEST_MU,
    LOADS_DIFFER,
    LOWEST_MU,
    MU_RANGE,
    deceleration_differs,
    is_wrong_wheel,
    units_or,
)
from .messages import message
from .observed import BrakedRows, Observed
from .prediction import PredictionErrors, has_prediction_errors, prediction_error_fit, slip_ramp

# --- plausibility of a fit -------------------------------------------------------------------------------------------

IMPOSSIBLE_MU = 1.0  #: largest adhesion coefficient of an accepted fit; clean dry steel on steel has 0.6 to 0.8 in air


def highest_mu(fitted: Fit, setting: models.Setting) -> float:
    """Highest adhesion coefficient of a fitted model at the lowest and the highest of `DRIFT_SPEEDS`.

    InputError if the adhesion is not positive at any slip.
    """
    speeds = (share * setting.initial_speed for share in (DRIFT_SPEEDS[0], DRIFT_SPEEDS[-1]))
    law = fitted.model.make_force_law(fitted.values, fitted.law.rail)
    try:
        return max(peak(law, speed, setting.wheel_load).coefficient for speed in speeds)
    except DomainError:
        raise InputError(message("nowhere positive")) from None


def check_fit(fitted: Fit, setting: models.Setting, curve: AdhesionCurve) -> None:
    """Raise InputError if the highest adhesion coefficient of a fit is above `IMPOSSIBLE_MU` or not positive."""
    value = highest_mu(fitted, setting)
    if value <= IMPOSSIBLE_MU:
        return
    seen = curve.highest_mu  # if the measured values are plausible, a wrong unit is not the cause
    cause = units_or(seen, curve.factors)
    if LOWEST_MU <= seen <= HIGHEST_MU:
        cause = message("log is ordinary", seen=seen)
    given = [f"`fixed` {name}={value:g}" for name, value in setting.fixed.items() if name in fitted.model.known]
    cause = message("fixed is given", values=", ".join(given), cause=cause) if given else cause
    raise InputError(message("impossible mu", value=value, limit=IMPOSSIBLE_MU, cause=cause))


def fit_warnings(fitted: Fit, setting: models.Setting, curve: AdhesionCurve) -> tuple[str, ...]:
    """Warnings about an implausible but not impossible fit, one sentence each."""
    value = highest_mu(fitted, setting)
    ordinary = LOWEST_MU <= value <= HIGHEST_MU
    warnings = []
    if not ordinary:
        cause = units_or(value, curve.factors)
        warnings.append(message("fitted mu", model=fitted.model.name, value=value, **MU_RANGE, cause=cause))
    unconstrained = [f"{p.name} (fitted value {p.value:.4g})" for p in fitted.parameters if p.is_unconstrained]
    if unconstrained:
        warnings.append(message("any other", parameters=", ".join(unconstrained)))
    log_ordinary = ordinary and LOWEST_MU <= curve.highest_mu <= HIGHEST_MU
    for p, low, high in zip(fitted.parameters, fitted.model.lower, fitted.model.upper, strict=True):
        if "bound" in p.status:
            side, bound = ("lower", low) if "lower" in p.status else ("upper", high)
            by_user = bound in setting.bounds.get(p.name, ())
            why = message("bound given" if by_user else "bound, log ordinary" if log_ordinary else "bound, units")
            # a tiny bound represents an open bound of 0
            end = "infinity" if math.isinf(bound) else f"{0.0 if bound < _OPEN_BOUND else bound:.4g}"
            warnings.append(f"the fitted {p.name} of {p.value:.4g} rests on its {side} bound, {end}: {why}")
    return tuple(f"{curve.name}: {text}" for text in warnings)


_OPEN_BOUND = 1e-11  # a bound below this represents an open bound of 0

# --- the delay of the wheel's speed ----------------------------------------------------------------------------------

_EQUAL = 2.6  # in standard errors: two delays that differ by less are regarded as equal (99 %)
_MOST_ROWS = 2000  # most rows used, in whole runs from the start; enough to resolve a delay of a tenth of an interval
_LEAST_GAIN = 40.0  # least fall of the deviance over the errors' long-run variance; logs without a delay reached 26
_GAIN_OF_TABLE = 6.6  # least fall of a table's deviance (chi-squared, 1 %); lower, as a table absorbs part of a delay
_LEAST_TRIAL_GAIN = 0.5  # of `_LEAST_GAIN`: the search ends if a parabola through three lags falls by less
_RESOLVED = 0.03  # tolerance of the lag, in intervals of the log: at most a fifth of its standard error
_MOST_LAGS = 10  # most evaluations of the final search; each is a fit
_MOTION_STDERR = 0.1  # standard error due to the motion between rows, in intervals, as found on the virtual rig
_CURVATURE_STEP = 0.25  # difference step for the curvature of the deviance, in intervals


@dataclass(frozen=True)
class Lag:
    """Delay of the wheel speed relative to the other columns, s (negative: too early), and its standard error, s."""

    seconds: float
    stderr: float


class Shifted:
    """Fits a model again for trial delays of the wheel speed.

    Only the first runs of the record are used: whole runs, with at most `_MOST_ROWS` rows in total. If the first run is
    longer, only its first `_MOST_ROWS` rows are used.
    """

    def __init__(self, fit: Fit, record: BrakedRows, vehicle: Vehicle, wheel_load: float) -> None:
        ends = np.append(np.flatnonzero(np.diff(record.run)) + 1, len(record))
        whole = ends[ends <= _MOST_ROWS]
        rows = int(whole[-1] if len(whole) else min(ends[0], _MOST_ROWS))
        self._record = replace(record, **{name: values[:rows] for name, values in vars(record).items()})
        self._model, self._vehicle, self._wheel_load = fit.model, vehicle, wheel_load
        self._start, self._results = fit.values, dict[float, tuple[float, float]]()
        self.is_usable = has_prediction_errors(fit.model, self._record)
        self.interval = float(np.median(np.diff(self._record.time)[np.diff(self._record.run) == 0]))  # s

    def inflation(self, lag: float) -> float:
        return max(self._results[lag][1], 1.0)

    def deviance(self, lag: float) -> float:
        """Return the -2 log likelihood of the fit with the delay `lag`, s."""
        if lag not in self._results:
            problem = PredictionErrors(self._model, delayed(self._record, lag), self._vehicle, self._wheel_load)
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a search may try extreme values
                deviance, values, inflation = problem.maximum_likelihood(self._start)
            self._results[lag] = deviance, inflation
            self._start = values if deviance <= min(self._results.values())[0] else self._start
        return self._results[lag][0]


def lag_of(
    fit: Fit, record: BrakedRows, vehicle: Vehicle, wheel_load: float, *, table: Fit | None = None
) -> Lag | None:
    """Most likely delay of the wheel speed; None if no delay clearly improves the fit to the wheel's motion.

    If a fitted `table` is given, the delay must also improve the fit of the table.
    """
    shifted = Shifted(fit, record, vehicle, wheel_load)
    if not shifted.is_usable:
        return None
    try:
        lag = _most_likely(shifted)
        if lag is None or table is None:
            return lag
        beside = Shifted(table, record, vehicle, wheel_load)
        return lag if beside.deviance(0.0) - beside.deviance(lag.seconds) > _GAIN_OF_TABLE else None
    except ValueError:  # raised by SciPy and LAPACK if the errors are not finite; the delay is then unknown
        return None


def _most_likely(shifted: Shifted) -> Lag | None:
    from scipy.optimize import minimize_scalar

    deviance, interval = shifted.deviance, shifted.interval
    now, half = deviance(0.0), interval / 2.0
    low, middle, high = -half, 0.0, half
    ahead = min((half, -half), key=deviance)
    if deviance(ahead) < now:
        before, middle = 0.0, ahead
        while abs(middle) < LONGEST_DELAY and deviance(2.0 * middle) < deviance(middle):
            before, middle = middle, 2.0 * middle
        low, high = sorted((before, 2.0 * middle))
    at = (low, middle, high)
    constant, slope, square = np.polynomial.polynomial.polyfit(at, [*map(deviance, at)], 2)
    least = constant - slope**2 / (4.0 * square) if square > 0.0 else deviance(middle)
    if now - least <= _LEAST_TRIAL_GAIN * _LEAST_GAIN:
        return None
    options = {"maxiter": _MOST_LAGS, "xatol": _RESOLVED * interval}
    best = minimize_scalar(deviance, bounds=(low, high), method="bounded", options=options)
    lag, step = float(best.x), _CURVATURE_STEP * interval
    inflation = shifted.inflation(best.x)
    bend = (deviance(lag + step) + deviance(lag - step) - 2.0 * best.fun) / step**2 / inflation
    if (now - best.fun) / inflation <= _LEAST_GAIN or not bend > 0.0:
        return None
    stderr = math.hypot(math.sqrt(2.0 / bend), _MOTION_STDERR * interval)
    return Lag(lag, stderr) if abs(lag) > _EQUAL * stderr else None


def delayed(record: BrakedRows, lag: float) -> BrakedRows:
    """Delay train speed and brake torque by `lag`, s, so that they match a wheel speed that is late by `lag`."""
    speed, torque = record.speed.copy(), record.torque.copy()
    for run in np.unique(record.run):
        at = record.run == run
        time = record.time[at]
        for values in (speed, torque):
            values[at] = np.interp(time - lag, time, values[at])
    return replace(record, speed=speed, torque=torque)


def lag_warning(lag: Lag, interval: float, wheel_column: str, delays: Mapping[str, float]) -> str:
    """Warning about a delay; `interval`: time between rows, s; `delays`: corrections given by the user, s."""
    late, given = lag.seconds, delays.get(wheel_column, 0.0)
    cause = ""
    if not given and abs(late - interval / 2.0) < _EQUAL * lag.stderr:
        late, cause = interval / 2.0, "a speed computed from encoder counts is late by half an interval between rows: "
    remedy = f"{cause}`delays` {wheel_column}={given + late:.3g} corrects this"
    remedy = message("no such delay", longest=LONGEST_DELAY) if abs(given + late) > LONGEST_DELAY else remedy
    side, seconds = "late" if late > 0 else "early", abs(lag.seconds)
    return message("wheel is late", side=side, seconds=seconds, error=lag.stderr, remedy=remedy)


# --- the models of a log ---------------------------------------------------------------------------------------------

DRIFT_SPEEDS = (0.2, 0.4, 0.6, 0.8, 1.0)  #: speeds at which the peak is reported, as shares of the initial speed


class Candidates:
    """Fits models to an adhesion curve."""

    def __init__(self, curve: AdhesionCurve, vehicle: Vehicle, setting: models.Setting) -> None:
        self.curve, self.vehicle, self.setting = curve, vehicle, setting
        self.regimes = results.regimes_of_data(curve.cells)

    def fitted(self, names: Sequence[str]) -> tuple[tuple[Fit, ...], tuple[str, ...]]:
        """Fit the models `names`; return (fits, messages about failed fits)."""
        fits, failures, alone = list[Fit](), list[str](), len(names) == 1
        for name in names:
            try:
                fits.append(self._fit(name, profiles=alone))
            except InputError as error:
                failures.append(f"{self.curve.name}: {error}" if alone else f"{self.curve.name}: {name}: {error}")
        return tuple(fits), tuple(failures)

    def with_intervals(self, fitted: Fit) -> Fit:
        """Return the fit with intervals of its parameters; if it has none, the model is fitted again."""
        return fitted if fitted.with_profiles else self._fit(fitted.model.name, profiles=True)

    def table_of(self, fits: Sequence[Fit]) -> Fit | None:
        """Return the table in `fits`, else fit a table; None if no table can be fitted to the wheel's motion."""
        table = next((each for each in fits if each.model.name == "table"), None)
        if table is None:
            with suppress(InputError):
                table = self._fit("table", profiles=False)
        return table if table is not None and table.coarse is not None else None

    def _fit(self, name: str, *, profiles: bool) -> Fit:
        curve, setting, profiles = self.curve, self.setting, profiles and name != "table"
        model = models.fit_model(name, curve.cells, models.shape_of(curve.cells, curve.peak_slip), setting)
        known = (curve.cells, curve.stretches, setting, self.regimes.boundary, curve.time_constant)
        first = fit(model, *known, profiles=profiles and not has_prediction_errors(model, curve.record))
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a search may try extreme values
            fitted = prediction_error_fit(first, curve.record, self.vehicle, curve.cells, setting, profiles=profiles)
            check_fit(fitted, setting, curve)
        return replace(fitted, with_profiles=profiles or name == "table")


# --- identification of one log, or of several ------------------------------------------------------------------------

_LINE_POINTS = 200  # points of a model's curve in a picture
_RAMP_SLIP = 0.05  # least slip ratio up to which the ramp is measured, for a peak at a lower slip
_OTHER_SPEED = 1.25  # accepted ratio of given and logged initial speed; a log may begin while the train is braking
_OTHER_RAMP = 3.0  # accepted ratio of given and logged slip acceleration; runs of one log differ by less
_LEAST_RAMP = 0.05  # m/s^2; a slower change counts as constant slip


@dataclass(frozen=True)
class ModelLine:
    """Curve of mu over slip ratio of a fitted model; at each slip, the speed is the mean speed in the log."""

    name: str
    slip: Floats
    mu: Floats


@dataclass(frozen=True)
class Identification:
    """Result of identifying a log.

    - vehicle, options: the arguments of the identification.
    - setting: quantities that the fits take as known.
    - curve: the adhesion data of the log.
    - scores, lines: scores of all fitted models, lowest BIC first, and curves of these models in the same order.
    - chosen: score of the model that the user gave, else of the best formula that fits the log, else of the table.
    - not_fitted: reasons why models are left out, one sentence each.
    - peaks: adhesion peaks at several speeds, on the log's rail and on wet rail.
    - regimes: adhesion and sliding, with the slip ratio at which sliding begins.
    - reference: reference slips at the initial speed; None if the model has no peak within the slips of the log.
    - warnings, fit_warnings: faults of the log, and warnings about the chosen model.
    - delay: delay of the wheel speed; None if no delay was found.
    """

    vehicle: Vehicle
    options: Options
    curve: AdhesionCurve
    setting: models.Setting
    scores: tuple[results.Score, ...]
    chosen: results.Score
    not_fitted: tuple[str, ...]
    peaks: tuple[results.PeakSlip, ...]
    regimes: results.Regimes
    reference: ReferenceSlip | None
    lines: tuple[ModelLine, ...]
    warnings: tuple[str, ...]
    fit_warnings: tuple[str, ...] = ()
    delay: Lag | None = None

    @property
    def speeds_shown(self) -> tuple[float, float]:
        """Lowest and highest initial speed that the log covers, m/s."""
        return speeds_shown(self.curve, self.setting)

    @property
    def own_peak(self) -> results.PeakSlip:
        """Adhesion peak at the initial speed, on the rail of the log."""
        return [each for each in self.peaks if each.rail is self.setting.rail][-1]

    @property
    def no_reference(self) -> str | None:
        """Reason why there is no reference slip; None if there is a reference slip."""
        if self.reference is not None:
            return None
        seen = float(self.curve.cells.slip.max())
        return message("peak beyond", seen=seen) if self.own_peak.slip >= seen else message("no peak")

    @property
    def peak_notes(self) -> tuple[str, ...]:
        """Notes on peaks that do not come from the log, one sentence each."""
        return results.peak_notes(self.peaks, self.chosen.fit.model.name, self.speeds_shown)


def speeds_shown(curve: AdhesionCurve, setting: models.Setting) -> tuple[float, float]:
    """Lowest and highest initial speed that the log covers, m/s."""
    v0, survey = setting.initial_speed, curve.survey
    return (min(survey.slowest_start, v0) if survey.is_mixed else v0), v0


@checked
def identify(
    path: str | Path,
    vehicle: Vehicle,
    options: Options | None = None,
    *,
    progress: Callable[[float], None] | None = None,
    observed: Callable[[Observed], None] | None = None,
) -> Identification:
    """Identify the adhesion law from a log: fit the models, compare the fits and compute the reference slip.

    - path: the CSV file, in the format of `railslip identify --help`.
    - vehicle: vehicle whose wheel and wheel load are used, SI.
    - options: further options; None: the defaults of `railslip identify`.
    - progress: called with the share of the file that has been read, 0 to 1.
    - observed: called with each block of adhesion samples (`Observed`), SI.

    InputError for a log or an option that cannot be used.
    """
    path, options = Path(path), options or Options()
    _model_names(options)  # raises an error before a large log is read
    curve = read_curve(path, vehicle, options, progress=progress, observed=observed)
    return identify_curve(curve, vehicle, options)


def _model_names(options: Options) -> tuple[str, ...]:
    names = models.CANDIDATES if options.model == "best" else (options.model,)
    models.check_model(options.model)
    models.check_options(names, options.fixed, options.bounds)
    check_corrections(options.delays, options.zeros)
    return names


def identify_curve(curve: AdhesionCurve, vehicle: Vehicle, options: Options) -> Identification:
    """Identify the adhesion law from an adhesion curve. InputError as for `identify`."""
    names = _model_names(options)
    setting = setting_of(curve, vehicle, options)
    candidates = Candidates(curve, vehicle, setting)
    fits, failures = candidates.fitted(names)
    if not fits:
        raise InputError("; ".join([*_wheel_findings(curve), failures[0]]))
    table = candidates.table_of(fits)
    scores, chosen, peaks, without = _chosen(results.compare(fits, curve.cells), candidates, table)
    delay = _delay(chosen.fit, table, candidates)
    of_delay = [] if delay is None else [lag_warning(delay, curve.survey.interval, curve.wheel_column, options.delays)]
    warnings = (
        *_misfit_warning(scores, chosen.fit, table, curve.name),
        *curve.warnings,
        *_contradictions(curve, setting, options),
        *(f"{curve.name}: {text}" for text in of_delay),
    )
    of_model = _model_fields(chosen, peaks, candidates)
    return Identification(
        vehicle=vehicle,
        options=options,
        curve=curve,
        setting=setting,
        scores=scores,
        not_fitted=(*failures, *without),
        lines=tuple(_line(score.fit, curve.cells, setting) for score in scores),
        warnings=warnings,
        delay=delay,
        **of_model,
    )


def _model_fields(chosen: results.Score, peaks: tuple[results.PeakSlip, ...], candidates: Candidates) -> dict[str, Any]:
    curve, setting = candidates.curve, candidates.setting
    at_v0 = {peak.rail: peak for peak in peaks}
    # for a wet log, both reference slips are those of the wet rail
    dry, wet = at_v0[setting.rail].reference, at_v0[Rail.WET].reference
    return {
        "chosen": chosen,
        "peaks": peaks,
        "regimes": results.regimes_of(at_v0[setting.rail].slip, chosen.fit.model.name, curve.cells, candidates.regimes),
        "reference": ReferenceSlip(dry=dry, wet=wet) if math.isfinite(dry) and math.isfinite(wet) else None,
        "fit_warnings": fit_warnings(chosen.fit, setting, curve),
    }


def _chosen(
    scores: tuple[results.Score, ...], candidates: Candidates, table: Fit | None
) -> tuple[tuple[results.Score, ...], results.Score, tuple[results.PeakSlip, ...], tuple[str, ...]]:
    """Choose the first model with a peak, in this order: formulas that fit the log, the table, other formulas.

    Returns (scores, chosen score, peaks of the chosen model, messages for models without a peak). InputError if no
    model has a peak.
    """
    failures: list[str] = []
    curve, setting = candidates.curve, candidates.setting

    def rank(score: results.Score) -> int:  # formulas without a misfit probability (NaN) come after the table
        if score.fit.model.name == "table" or table is None:
            return int(score.fit.model.name == "table")
        return 0 if results.misfit_probability(score.fit, table) >= results.FALSE_MISFIT else 2

    for score in sorted(scores, key=rank):
        with_intervals = replace(score, fit=candidates.with_intervals(score.fit))
        try:
            peaks = _peaks(with_intervals, setting, curve, table)
        except DomainError as error:
            failures.append(f"{curve.name}: {score.fit.model.name}: {error}")
            scores = tuple(each for each in scores if each is not score)
        else:
            scores = tuple(with_intervals if each is score else each for each in scores)
            return scores, with_intervals, peaks, tuple(failures)
    raise InputError("; ".join([*_wheel_findings(curve), failures[0]]))


def _contradictions(curve: AdhesionCurve, setting: models.Setting, options: Options) -> tuple[str, ...]:
    """Warnings about given values that contradict the log."""
    warnings, seen, v0 = [], curve.survey.initial_speed, setting.initial_speed
    if options.initial_speed is not None and not 1.0 / _OTHER_SPEED < v0 / seen < _OTHER_SPEED:
        warnings.append(message("other initial speed", given=v0 / KMH, seen=seen / KMH))
    given, ramp = options.slip_acceleration, setting.slip_acceleration
    if given is not None and ramp is not None and not 1.0 / _OTHER_RAMP < given / ramp < _OTHER_RAMP:
        warnings.append(message("other ramp", given=given, seen=ramp))
    return tuple(f"{curve.name}: {text}" for text in warnings)


def _misfit_warning(scores: Sequence[results.Score], chosen: Fit, table: Fit | None, log: str) -> tuple[str, ...]:
    nearest = next((score.fit for score in scores if score.fit.model.name != "table"), chosen)
    formula = chosen if chosen.model.name != "table" else nearest
    if table is None or not results.is_misfit(formula, table):
        return ()
    key = "model does not fit" if chosen is formula else "no formula fits"
    most = results.largest_difference(formula, table)
    return (f"{log}: {message(key, model=formula.model.name, limit=results.FALSE_MISFIT, most=most)}",)


def _delay(fit: Fit, table: Fit | None, candidates: Candidates) -> Lag | None:
    """Delay of the wheel speed; None if there is none, or if another fault of the log could look like a delay."""
    curve, load = candidates.curve, candidates.setting.wheel_load
    if curve.survey.is_mixed or is_wrong_wheel(curve.rolling) or deceleration_differs(curve.deceleration_ratio):
        return None
    best = table if table is not None and results.is_misfit(fit, table) else fit
    return lag_of(best, curve.record, candidates.vehicle, load, table=table)


def _wheel_findings(curve: AdhesionCurve) -> tuple[str, ...]:
    return tuple(f"{curve.name}: {each.text}" for each in curve.findings if each.check == "free rolling")


def _peaks(
    score: results.Score, setting: models.Setting, curve: AdhesionCurve, table: Fit | None
) -> tuple[results.PeakSlip, ...]:
    # unless the formula fits the motion better than the table, its interval also contains that of the table's peak
    fit, v0, widest = score.fit, setting.initial_speed, None
    speeds = [share * v0 for share in DRIFT_SPEEDS]
    if table is not None and fit.model.name != "table" and not fit.deviance < table.deviance:
        own = results.peak_of_fit(fit, v0, setting.wheel_load, setting.rail)
        widest = results.table_intervals(table) / np.array([[own.slip], [own.coefficient]])
    peaks = results.drift(fit, speeds, setting.wheel_load, shown=speeds_shown(curve, setting), widest=widest)
    seen = float(curve.cells.slip.max())
    return tuple(
        replace(peak, reference=math.nan, reference_coefficient=math.nan) if peak.slip >= seen else peak
        for peak in peaks
    )


def _line(fit: Fit, cells: Cells, setting: models.Setting) -> ModelLine:
    order = np.argsort(cells.slip)
    slip = np.linspace(math.sqrt(cells.slip[order[0]]), math.sqrt(cells.slip[order[-1]]), _LINE_POINTS) ** 2
    if fit.followed is not None:
        return ModelLine(fit.model.name, slip, np.interp(slip, *fit.followed))
    speed = np.interp(slip, cells.slip[order], cells.speed[order])
    return ModelLine(fit.model.name, slip, fit.model.coefficient(fit.values, slip, speed, setting.wheel_load))


def setting_of(curve: AdhesionCurve, vehicle: Vehicle, options: Options) -> models.Setting:
    """Quantities that the fits take as known; an initial speed in the options replaces that of the log."""
    v0 = curve.survey.initial_speed if options.initial_speed is None else options.initial_speed
    ramp, spread = slip_ramp(curve.record, vehicle.wheel.radius, max(curve.peak_slip, _RAMP_SLIP), v0)
    ramped = ramp >= _LEAST_RAMP
    return models.Setting(
        wheel_load=curve.survey.wheel_load,
        initial_speed=v0,
        slip_acceleration=ramp if ramped else None,
        given_acceleration=options.slip_acceleration,
        rail=options.rail,
        fixed=options.fixed,
        bounds=options.bounds,
        acceleration_spread=spread if ramped else None,
    )


@dataclass(frozen=True)
class LogSeries:
    """Several logs identified with one model, and the model's parameters as polynomials of the initial speed.

    `warnings` are about differences between the logs.
    """

    logs: tuple[Identification, ...]
    polynomials: tuple[results.ParameterPolynomial, ...]
    warnings: tuple[str, ...] = ()


def identify_several(
    paths: Sequence[Path], vehicle: Vehicle, options: Options, *, progress: Callable[[float], None] | None = None
) -> LogSeries:
    """Identify logs of several initial speeds with one model.

    The model "best" in `options` selects the formula with the lowest sum of BIC over the logs. `paths` are the logs;
    `vehicle`, `options` and `progress` are as in `identify`. InputError as for `identify`, or if a log is given twice.
    """
    whole = [path.resolve() for path in paths]
    for i, path in enumerate(whole):
        if path in whole[:i]:
            raise InputError(message("given twice", path=paths[i]))
    for first, second in itertools.combinations([path for path in paths if path.is_file()], 2):
        if first.stat().st_size == second.stat().st_size and filecmp.cmp(first, second, shallow=False):
            raise InputError(message("a copy", path=second, other=first))
    identified = []
    for i, path in enumerate(paths):
        share = None if progress is None else (lambda x, i=i: progress((i + x) / len(paths)))
        identified.append(identify(path, vehicle, options, progress=share))
    if options.model == "best":
        identified = _with_one_model(identified)
    fits = [each.chosen.fit for each in identified]
    return LogSeries(
        logs=tuple(identified),
        polynomials=results.over_initial_speed([each.setting.initial_speed for each in identified], fits),
        warnings=different_loads([(each.curve.name, each.setting.wheel_load) for each in identified]),
    )


def different_loads(loads: Sequence[tuple[str, float]]) -> tuple[str, ...]:
    """Warning if the mean wheel loads of the logs differ too much; `loads` are pairs (log name, load in N)."""
    (least, low), (most, high) = (pick(loads, key=lambda each: each[1]) for pick in (min, max))
    if low * LOADS_DIFFER >= high:
        return ()
    mean = sum(load for _, load in loads) / len(loads)
    return (message("loads of logs", low=low, least=least, high=high, most=most, mean=mean),)


def _with_one_model(identified: Sequence[Identification]) -> list[Identification]:
    totals: dict[str, float] = {}
    for score in identified[0].scores:
        name = score.fit.model.name
        same = [s for each in identified for s in each.scores if s.fit.model.name == name]
        if len(same) == len(identified) and name != "table":  # tables have different knots in each log
            totals[name] = sum(s.bic for s in same)
    if not totals:
        raise InputError(
            "model: no model could be fitted to every log; choose a model with `model`, or leave out a log"
        )
    for best in sorted(totals, key=lambda name: totals[name]):
        with suppress(DomainError):  # raised if the model has no peak in one of the logs
            return [_with_model(each, best) for each in identified]
    raise InputError("model: no model has a peak in every log; choose a model with `model`")


def _with_model(identification: Identification, name: str) -> Identification:
    if identification.chosen.fit.model.name == name:
        return identification
    curve, setting = identification.curve, identification.setting
    candidates = Candidates(curve, identification.vehicle, setting)
    score = next(s for s in identification.scores if s.fit.model.name == name)
    chosen = replace(score, fit=candidates.with_intervals(score.fit))
    peaks = _peaks(chosen, setting, curve, candidates.table_of([each.fit for each in identification.scores]))
    scores = tuple(chosen if each is score else each for each in identification.scores)
    return replace(identification, scores=scores, **_model_fields(chosen, peaks, candidates))
