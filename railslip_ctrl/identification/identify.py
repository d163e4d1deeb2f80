"""A log, or several, to adhesion curve, fitted models compared, and the slip to hold: the record `Identification`.

Intervals are for the chosen model, as they take most of the time. A wheel speed that is late shows in how well the
motion can be followed.
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
    ORDINARY,
    deceleration_differs,
    is_wrong_wheel,
    units_or,
)
from .observed import BrakedRows, Observed
from .prediction import PredictionErrors, is_followed, prediction_error_fit, slip_ramp
from .words import told

# --- can a fit be? ---------------------------------------------------------------------------------------------------


IMPOSSIBLE_MU = 1.0
"""A highest adhesion coefficient above this is refused.

Clean dry steel on steel in air has 0.6 to 0.8 in every handbook; more than the wheel load itself is pulled only where
bare metals seize, as in vacuum. A law that has it would lead every command that takes it astray.
"""


# --- the fit -------------------------------------------------------------------------------------------------------


def highest_mu(found: Fit, setting: models.Setting) -> float:
    """The highest adhesion coefficient of a fitted model, at the lowest or the highest of `DRIFT_SPEEDS`.

    InputError for a law whose force nowhere brakes.
    """
    speeds = (share * setting.initial_speed for share in (DRIFT_SPEEDS[0], DRIFT_SPEEDS[-1]))
    law = found.model.make_force_law(found.values, found.law.rail)
    try:
        return max(peak(law, speed, setting.wheel_load).coefficient for speed in speeds)
    except DomainError:
        raise InputError(told("nowhere positive")) from None


def check_fit(found: Fit, setting: models.Setting, curve: AdhesionCurve) -> None:
    """InputError for a fit with adhesion above `IMPOSSIBLE_MU`, or nowhere positive."""
    value = highest_mu(found, setting)
    if value <= IMPOSSIBLE_MU:
        return
    seen = curve.highest_mu  # of the log itself, which tells the likely cause
    cause = units_or(seen, curve.factors)
    if LOWEST_MU <= seen <= HIGHEST_MU:
        cause = told("log is ordinary", seen=seen)
    given = [f"`fixed` {name}={value:g}" for name, value in setting.fixed.items() if name in found.model.known]
    cause = told("fixed is given", values=", ".join(given), cause=cause) if given else cause
    raise InputError(told("impossible mu", value=value, limit=IMPOSSIBLE_MU, cause=cause))


def fit_doubts(found: Fit, setting: models.Setting, curve: AdhesionCurve) -> tuple[str, ...]:
    """What is not to be believed of a fit that is no impossible one, a sentence each."""
    value = highest_mu(found, setting)
    ordinary = LOWEST_MU <= value <= HIGHEST_MU
    doubts = []
    if not ordinary:
        cause = units_or(value, curve.factors)
        doubts.append(told("fitted mu", model=found.model.name, value=value, **ORDINARY, cause=cause))
    untold = [f"{p.name} of {p.value:.4g}" for p in found.parameters if p.is_untold]
    if untold:
        doubts.append(told("any other", parameters=", ".join(untold)))
    log_ordinary = ordinary and LOWEST_MU <= curve.highest_mu <= HIGHEST_MU
    for p, low, high in zip(found.parameters, found.model.lower, found.model.upper, strict=True):
        if "bound" in p.status:
            side, bound = ("lower", low) if "lower" in p.status else ("upper", high)
            by_user = bound in setting.bounds.get(p.name, ())
            why = told("bound given" if by_user else "bound, log ordinary" if log_ordinary else "bound, units")
            # the smallest number stands for a 0 that is open
            end = "infinity" if math.isinf(bound) else f"{0.0 if bound < _NOTHING else bound:.4g}"
            doubts.append(f"the fitted {p.name} of {p.value:.4g} rests on its {side} bound, {end}: {why}")
    return tuple(f"{curve.name}: {text}" for text in doubts)


_NOTHING = 1e-11  # stands for a bound of 0 that is open
_ALIKE = 2.6  # standard errors
# --- the delay of the wheel's speed ----------------------------------------------------------------------------------

_MOST_ROWS = 2000  # of whole runs from the record's beginning: ten rig tests tell a tenth of an interval
_LEAST_GAIN = 40.0  # of the deviance, over the whitened errors' long-run variance: seen without a delay is up to 26
_GAIN_OF_TABLE = 6.6  # of a table's deviance, at least: chi-squared at 1 %; a table takes a part of a delay itself
_HOPELESS = 0.5  # of this gain, below which that of a parabola through three lags is not searched further
_RESOLVED = 0.03  # of the log's interval, to which a lag is looked for: a fifth or less of its error
_MOST_LAGS = 10  # of the search between two ends, as each is a fit
_BETWEEN = 0.1  # of the interval: standard error that what happens between rows adds, as seen on the virtual rig
_CURVED = 0.25  # of the interval, over which the deviance's bend about the lag is taken


@dataclass(frozen=True)
class Lag:
    """By how much the wheel's speed is late beside the other columns, s, with its standard error; negative: early."""

    seconds: float
    stderr: float


class Shifted:
    """How well a model follows the wheel's motion with the wheel's speed shifted, its parameters fitted anew.

    Of whole runs from the record's beginning, `_MOST_ROWS` at most, but the first in any case.
    """

    def __init__(self, fit: Fit, record: BrakedRows, vehicle: Vehicle, wheel_load: float) -> None:
        ends = np.append(np.flatnonzero(np.diff(record.run)) + 1, len(record))
        whole = ends[ends <= _MOST_ROWS]
        rows = int(whole[-1] if len(whole) else min(ends[0], _MOST_ROWS))
        self._record = replace(record, **{name: values[:rows] for name, values in vars(record).items()})
        self._model, self._vehicle, self._wheel_load = fit.model, vehicle, wheel_load
        self._start, self._known = fit.values, dict[float, tuple[float, float]]()
        self.followed = is_followed(fit.model, self._record)
        self.interval = float(np.median(np.diff(self._record.time)[np.diff(self._record.run) == 0]))  # s

    def inflation(self, lag: float) -> float:
        """Long-run variance of the whitened errors at a lag that was tried, 1 or more."""
        return max(self._known[lag][1], 1.0)

    def deviance(self, lag: float) -> float:
        """-2 log likelihood; a search begins where the best one before it ended."""
        if lag not in self._known:
            problem = PredictionErrors(self._model, earlier(self._record, lag), self._vehicle, self._wheel_load)
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a search may try what overflows
                found, values, inflation = problem.likeliest(self._start)
            self._known[lag] = found, inflation
            self._start = values if found <= min(self._known.values())[0] else self._start
        return self._known[lag][0]


def lag_of(
    fit: Fit, record: BrakedRows, vehicle: Vehicle, wheel_load: float, *, table: Fit | None = None
) -> Lag | None:
    """Most likely delay of the wheel's speed, or None if the motion does not clearly favour one.

    If a `table` is given it has to follow the motion better with the delay too.
    """
    shifted = Shifted(fit, record, vehicle, wheel_load)
    if not shifted.followed:
        return None
    try:
        lag = _likeliest(shifted)
        if lag is None or table is None:
            return lag
        beside = Shifted(table, record, vehicle, wheel_load)
        return lag if beside.deviance(0.0) - beside.deviance(lag.seconds) > _GAIN_OF_TABLE else None
    except ValueError:  # SciPy's and LAPACK's word for errors that are not finite: nothing can be told
        return None


def _likeliest(shifted: Shifted) -> Lag | None:
    """Where -2 log likelihood of the motion is least over the lag, far below that without one; else None."""
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
    if now - least <= _HOPELESS * _LEAST_GAIN:
        return None
    options = {"maxiter": _MOST_LAGS, "xatol": _RESOLVED * interval}
    found = minimize_scalar(deviance, bounds=(low, high), method="bounded", options=options)
    lag, step = float(found.x), _CURVED * interval
    inflation = shifted.inflation(found.x)
    bend = (deviance(lag + step) + deviance(lag - step) - 2.0 * found.fun) / step**2 / inflation
    if (now - found.fun) / inflation <= _LEAST_GAIN or not bend > 0.0:
        return None
    stderr = math.hypot(math.sqrt(2.0 / bend), _BETWEEN * interval)
    return Lag(lag, stderr) if abs(lag) > _ALIKE * stderr else None


def earlier(record: BrakedRows, lag: float) -> BrakedRows:
    """The record with train speed and brake torque as they were some seconds earlier, run by run."""
    speed, torque = record.speed.copy(), record.torque.copy()
    for run in np.unique(record.run):
        at = record.run == run
        time = record.time[at]
        for values in (speed, torque):
            values[at] = np.interp(time - lag, time, values[at])
    return replace(record, speed=speed, torque=torque)


def lag_warning(lag: Lag, interval: float, wheel_column: str, delays: Mapping[str, float]) -> str:
    """What a lag is to be told as, the log's interval in s; `delays` are those that the user has given, s."""
    late, given = lag.seconds, delays.get(wheel_column, 0.0)
    cause = ""
    if not given and abs(late - interval / 2.0) < _ALIKE * lag.stderr:
        late, cause = interval / 2.0, "half an interval, as a difference of counts is: "
    remedy = f"{cause}`delays` {wheel_column}={given + late:.3g} undoes it"
    remedy = told("no such delay") if abs(given + late) > LONGEST_DELAY else remedy
    side, seconds = "late" if late > 0 else "early", abs(lag.seconds)
    return told("wheel is late", side=side, seconds=seconds, error=lag.stderr, remedy=remedy)


# --- the models of a log ---------------------------------------------------------------------------------------------


DRIFT_SPEEDS = (0.2, 0.4, 0.6, 0.8, 1.0)  #: speeds at which a fit is looked at, of the initial speed


class Candidates:
    """What can be fitted to a curve; the regimes are parted where the data's mu is highest."""

    def __init__(self, curve: AdhesionCurve, vehicle: Vehicle, setting: models.Setting) -> None:
        self.curve, self.vehicle, self.setting = curve, vehicle, setting
        self.regimes = results.regimes_of_data(curve.cells)

    def fitted(self, names: Sequence[str]) -> tuple[tuple[Fit, ...], tuple[str, ...]]:
        """The models of some names, with the intervals of a single one; and why others have none, a sentence each."""
        fits, failures, alone = list[Fit](), list[str](), len(names) == 1
        for name in names:
            try:
                fits.append(self._fit(name, profiles=alone))
            except InputError as error:
                failures.append(f"{self.curve.name}: {error}" if alone else f"{self.curve.name}: {name}: {error}")
        return tuple(fits), tuple(failures)

    def with_intervals(self, found: Fit) -> Fit:
        """A fit of these with the intervals of its parameters; as it is where it has them."""
        return found if found.with_profiles else self._fit(found.model.name, profiles=True)

    def table_of(self, fits: Sequence[Fit]) -> Fit | None:
        """The table among some fits, else one fitted now; None if the motion cannot be followed with a table."""
        found = next((each for each in fits if each.model.name == "table"), None)
        if found is None:
            with suppress(InputError):
                found = self._fit("table", profiles=False)
        return found if found is not None and found.coarse is not None else None

    def _fit(self, name: str, *, profiles: bool) -> Fit:
        """One model. InputError where it cannot be fitted, or has adhesion that cannot be."""
        curve, setting, profiles = self.curve, self.setting, profiles and name != "table"
        model = models.fit_model(name, curve.cells, models.shape_of(curve.cells, curve.peak_slip), setting)
        known = (curve.cells, curve.stretches, setting, self.regimes.boundary, curve.time_constant)
        first = fit(model, *known, profiles=profiles and not is_followed(model, curve.record))
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a search may try what overflows
            found = prediction_error_fit(first, curve.record, self.vehicle, curve.cells, setting, profiles=profiles)
            check_fit(found, setting, curve)
        return replace(found, with_profiles=profiles or name == "table")


# --- the job: a log, or several, to adhesion curve, fits and the slip to hold, as records ----------------------------


_LINE_POINTS = 200
_RAMP_SLIP = 0.05  # the ramp is looked at up to here at least, where the peak is lower
_OTHER_SPEED = 1.25  # ratio of a speed that is given to the log's: a log may begin after the brake was applied
_OTHER_RAMP = 3.0  # ratio of a ramp that is given to the log's: runs of one log differ by less
_LEAST_RAMP = 0.05  # m/s^2: slower than this, slip is held, not ramped


@dataclass(frozen=True)
class ModelLine:
    """A fitted model's mu over slip, at the mean speed that the log has at each slip."""

    name: str
    slip: Floats
    mu: Floats


@dataclass(frozen=True)
class Identification:
    """A log identified.

    `vehicle` and `options` are as given, `setting` is what the fits took as known, `curve` what was taken from the log.
    `scores` are of all models fitted, the lowest BIC first, `lines` their curves in that order; `chosen` is the model
    asked for, the first formula that fits, or the table; `not_fitted` says why models were left out. `peaks` are over
    speed, on the log's rail and on wet rail; `regimes` are parted at the chosen model's, where the log goes past it;
    `reference` has the slips to hold at the initial speed, None without a peak. `warnings` are what was wrong with the
    log, and what the fits show to be, `doubts` what is not to be believed of the chosen model.
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
    doubts: tuple[str, ...] = ()

    @property
    def speeds_shown(self) -> tuple[float, float]:
        """The lowest and the highest v0 that the log stands for, m/s: of one that begins at many speeds all of them."""
        return speeds_shown(self.curve, self.setting)

    @property
    def own_peak(self) -> results.PeakSlip:
        """At the initial speed, on the log's own rail."""
        return [each for each in self.peaks if each.rail is self.setting.rail][-1]

    @property
    def no_reference(self) -> str | None:
        """Why there is no slip to hold; None where there is one."""
        if self.reference is not None:
            return None
        seen = float(self.curve.cells.slip.max())
        return told("peak beyond", seen=seen) if self.own_peak.slip >= seen else told("no peak")

    @property
    def peak_notes(self) -> tuple[str, ...]:
        """What of the peaks is not from the log, a sentence each."""
        return results.peak_notes(self.peaks, self.chosen.fit.model.name, self.speeds_shown)


def speeds_shown(curve: AdhesionCurve, setting: models.Setting) -> tuple[float, float]:
    """As `Identification.speeds_shown`."""
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
    """Identify a log: its curve, fits of the models asked for, their comparison, and the slip to hold.

    - path: the CSV, as `railslip identify --help` says.
    - vehicle: its wheel and load, SI.
    - options: the rest; without it, what `railslip identify` takes unless told.
    - progress: callable; told the share that is read, a ratio of 0 to 1.
    - observed: callable; given the observed samples as they come, SI.

    In SI. InputError: a log or an option that cannot be used, in one line.
    """
    path, options = Path(path), options or Options()
    _model_names(options)  # before a large log is read
    curve = read_curve(path, vehicle, options, progress=progress, observed=observed)
    return identify_curve(curve, vehicle, options)


def _model_names(options: Options) -> tuple[str, ...]:
    names = models.CANDIDATES if options.model == "best" else (options.model,)
    models.check_model(options.model)
    models.check_options(names, options.fixed, options.bounds)
    check_corrections(options.delays, options.zeros)
    return names


def identify_curve(curve: AdhesionCurve, vehicle: Vehicle, options: Options) -> Identification:
    """Identify from an adhesion curve that is read already. InputError as `identify`."""
    names = _model_names(options)
    setting = setting_of(curve, vehicle, options)
    candidates = Candidates(curve, vehicle, setting)
    fits, failures = candidates.fitted(names)
    if not fits:
        raise InputError("; ".join([*_wheel_told(curve), failures[0]]))
    table = candidates.table_of(fits)
    scores, chosen, peaks, without = _chosen(results.compare(fits, curve.cells), candidates, table)
    warnings = (
        *_misfit(scores, chosen.fit, table, curve.name),
        *curve.warnings,
        *_against_the_log(curve, setting, options),
        *_late(chosen.fit, table, candidates, options),
    )
    of_model = _of_model(chosen, peaks, candidates)
    return Identification(
        vehicle=vehicle,
        options=options,
        curve=curve,
        setting=setting,
        scores=scores,
        not_fitted=(*failures, *without),
        lines=tuple(_line(score.fit, curve.cells, setting) for score in scores),
        warnings=warnings,
        **of_model,
    )


def _of_model(chosen: results.Score, peaks: tuple[results.PeakSlip, ...], candidates: Candidates) -> dict[str, Any]:
    """What of an `Identification` follows from the model chosen: the last peaks of each rail are at v0."""
    curve, setting = candidates.curve, candidates.setting
    at_v0 = {peak.rail: peak for peak in peaks}
    # of a wet log both slips to hold are the wet one
    dry, wet = at_v0[setting.rail].reference, at_v0[Rail.WET].reference
    return {
        "chosen": chosen,
        "peaks": peaks,
        "regimes": results.regimes_of(at_v0[setting.rail].slip, chosen.fit.model.name, curve.cells, candidates.regimes),
        "reference": ReferenceSlip(dry=dry, wet=wet) if math.isfinite(dry) and math.isfinite(wet) else None,
        "doubts": fit_doubts(chosen.fit, setting, curve),
    }


def _chosen(
    scores: tuple[results.Score, ...], candidates: Candidates, table: Fit | None
) -> tuple[tuple[results.Score, ...], results.Score, tuple[results.PeakSlip, ...], tuple[str, ...]]:
    """The scores, the first formula that fits, its peaks, and why models before it had none; else InputError.

    The table is chosen if no formula fits.
    """
    failures: list[str] = []
    curve, setting = candidates.curve, candidates.setting

    def rank(score: results.Score) -> int:  # formulas that the motion does not judge come after the table
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
    raise InputError("; ".join([*_wheel_told(curve), failures[0]]))


def _against_the_log(curve: AdhesionCurve, setting: models.Setting, options: Options) -> tuple[str, ...]:
    """A sentence for each value that is given and that the log shows to be another."""
    found, seen, v0 = [], curve.survey.initial_speed, setting.initial_speed
    if options.initial_speed is not None and not 1.0 / _OTHER_SPEED < v0 / seen < _OTHER_SPEED:
        found.append(told("other initial speed", given=v0 / KMH, seen=seen / KMH))
    given, ramp = options.slip_acceleration, setting.slip_acceleration
    if given is not None and ramp is not None and not 1.0 / _OTHER_RAMP < given / ramp < _OTHER_RAMP:
        found.append(told("other ramp", given=given, seen=ramp))
    return tuple(f"{curve.name}: {text}" for text in found)


def _misfit(scores: Sequence[results.Score], chosen: Fit, table: Fit | None, log: str) -> tuple[str, ...]:
    """A sentence if the chosen formula does not fit, or none does."""
    nearest = next((score.fit for score in scores if score.fit.model.name != "table"), chosen)
    of = chosen if chosen.model.name != "table" else nearest
    if table is None or not results.is_misfit(of, table):
        return ()
    numbers = {"model": of.model.name, "limit": results.FALSE_MISFIT, "most": results.departure(of, table)}
    return (f"{log}: {told('no formula fits' if chosen is not of else 'model does not fit', **numbers)}",)


def _late(fit: Fit, table: Fit | None, candidates: Candidates, options: Options) -> tuple[str, ...]:
    """A sentence where the motion shows that the columns are out of step, unless something else is amiss first.

    It rests on a formula only if that fits, else on the table.
    """
    curve, load = candidates.curve, candidates.setting.wheel_load
    if curve.survey.is_mixed or is_wrong_wheel(curve.rolling) or deceleration_differs(curve.deceleration_ratio):
        return ()
    best = table if table is not None and results.is_misfit(fit, table) else fit
    lag = lag_of(best, curve.record, candidates.vehicle, load, table=table)
    if lag is None:
        return ()
    return (f"{curve.name}: {lag_warning(lag, curve.survey.interval, curve.wheel_column, options.delays)}",)


def _wheel_told(curve: AdhesionCurve) -> tuple[str, ...]:
    """What was said of a wheel that does not follow its train, as the cause of what fails."""
    return tuple(f"{curve.name}: {each.text}" for each in curve.findings if each.check == "free rolling")


def _peaks(
    score: results.Score, setting: models.Setting, curve: AdhesionCurve, table: Fit | None
) -> tuple[results.PeakSlip, ...]:
    """The peaks over speed; a peak beyond all slip of the log is the formula's alone, and no slip to hold.

    The interval of a formula contains that of the table, unless the formula follows the motion better than any table.
    """
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
    """What the fits take as known: the wheel load, v0 and the ramp of the log, unless they are given."""
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
    """Several logs identified with one model, and its parameters over the initial speed.

    `warnings` are of the logs together, beside those that each has.
    """

    logs: tuple[Identification, ...]
    polynomials: tuple[results.ParameterPolynomial, ...]
    warnings: tuple[str, ...] = ()


def identify_several(
    paths: Sequence[Path], vehicle: Vehicle, options: Options, *, progress: Callable[[float], None] | None = None
) -> LogSeries:
    """Identify logs at several initial speeds, `paths`, with one model; of "best", the one with the lowest sum of BIC.

    `vehicle`, `options`, `progress` and InputError as of `identify`.
    """
    whole = [path.resolve() for path in paths]
    for i, path in enumerate(whole):
        if path in whole[:i]:
            raise InputError(told("given twice", path=paths[i]))
    for first, second in itertools.combinations([path for path in paths if path.is_file()], 2):
        if first.stat().st_size == second.stat().st_size and filecmp.cmp(first, second, shallow=False):
            raise InputError(told("a copy", path=second, other=first))
    done = []
    for i, path in enumerate(paths):
        share = None if progress is None else (lambda x, i=i: progress((i + x) / len(paths)))
        done.append(identify(path, vehicle, options, progress=share))
    if options.model == "best":
        done = _with_one_model(done)
    fits = [each.chosen.fit for each in done]
    return LogSeries(
        logs=tuple(done),
        polynomials=results.over_initial_speed([each.setting.initial_speed for each in done], fits),
        warnings=different_loads([(each.curve.name, each.setting.wheel_load) for each in done]),
    )


def different_loads(loads: Sequence[tuple[str, float]]) -> tuple[str, ...]:
    """A sentence where the mean wheel loads of logs, by name, N, are not one."""
    (least, low), (most, high) = (pick(loads, key=lambda each: each[1]) for pick in (min, max))
    if low * LOADS_DIFFER >= high:
        return ()
    mean = sum(load for _, load in loads) / len(loads)
    return (told("loads of logs", low=low, least=least, high=high, most=most, mean=mean),)


def _with_one_model(done: Sequence[Identification]) -> list[Identification]:
    totals: dict[str, float] = {}
    for score in done[0].scores:
        name = score.fit.model.name
        same = [s for each in done for s in each.scores if s.fit.model.name == name]
        if len(same) == len(done) and name != "table":  # the knots of tables differ from log to log
            totals[name] = sum(s.bic for s in same)
    if not totals:
        raise InputError("model: no model fits every log; name one with `model`")
    for best in sorted(totals, key=lambda name: totals[name]):
        with suppress(DomainError):  # of a model that has no peak in one of the logs
            return [_choosing(each, best) for each in done]
    raise InputError("model: no model has a peak in every log; name one with `model`")


def _choosing(identification: Identification, name: str) -> Identification:
    if identification.chosen.fit.model.name == name:
        return identification
    curve, setting = identification.curve, identification.setting
    candidates = Candidates(curve, identification.vehicle, setting)
    score = next(s for s in identification.scores if s.fit.model.name == name)
    chosen = replace(score, fit=candidates.with_intervals(score.fit))
    peaks = _peaks(chosen, setting, curve, candidates.table_of([each.fit for each in identification.scores]))
    scores = tuple(chosen if each is score else each for each in identification.scores)
    return replace(identification, scores=scores, **_of_model(chosen, peaks, candidates))
