"""The models of a log, fitted to be compared; whether a fit can be; whether a column is late, as the motion shows.

Intervals are for the chosen model, as they take most of the time. A wheel speed that is late shows in how well the
motion can be followed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.errors import DomainError, InputError
from railslip_ctrl.model.numeric import peak
from railslip_ctrl.model.vehicle import Vehicle

from .cleaning import LONGEST_DELAY
from .curves import Curve
from .fits import Fit, Parameter, fit
from .log_checks import HIGHEST_MU, LOWEST_MU, units_or
from .models import SLIDING_ALONE, Setting, fit_model, shape_of
from .observed import Record
from .prediction import PredictionErrors, is_followed, prediction_error_fit
from .results import Regimes, compare, peak_of_law, regimes_of, regimes_of_data

Floats = NDArray[np.float64]


# --- can a fit be? ---------------------------------------------------------------------------------------------------


IMPOSSIBLE_MU = 1.0
"""A highest adhesion coefficient above this is refused.

Adhesion is friction at most, and that of clean dry steel on steel in air is 0.6 to 0.8 in every handbook: more than the
wheel load itself is pulled only where bare metals seize, as in vacuum. A law that has it would lead every command that
takes it astray, so that no warning will do.
"""

_LIMITS: Mapping[str, str] = MappingProxyType(
    {
        "beam": "mu_max",
        "polach": "mu0",
        "lugre": "Fs by wheel load",
        **dict.fromkeys(("bristle", "bristle_rest", "curve"), "gamma/beta by wheel load"),
    }
)


class ImpossibleFitError(InputError):
    """A fit with adhesion that cannot be."""


# --- the fit -------------------------------------------------------------------------------------------------------


def highest_mu(found: Fit, setting: Setting, speeds: tuple[float, float]) -> tuple[str, float]:
    """The highest adhesion coefficient of a fitted model, and what it is called: its peak or its limit of friction.

    The peak is that at the lowest or the highest of the `speeds`, m/s. InputError for a law whose force is nowhere one
    that brakes.
    """
    law = found.model.make_force_law(found.values, found.law.rail)
    try:
        top = max(peak(law, speed, setting.wheel_load).coefficient for speed in speeds)
    except DomainError:
        raise InputError(
            "fitted to this log its adhesion is nowhere positive; check units, the wheel's radius and load (--vehicle)"
        ) from None
    limit = _limit_of_friction(found, setting.wheel_load)
    return (f"limit of friction ({_LIMITS[found.model.name]})", limit) if limit > top else ("peak", top)


def _limit_of_friction(found: Fit, wheel_load: float) -> float:
    """Adhesion coefficient that a model tends to as it slides slowly; NaN for one without such a parameter.

    A log too short of slip leaves it free while the peak, up to slip 1, may look like any other.
    """
    given = {**found.model.known, **{p.name: p.value for p in found.parameters}}
    match found.model.name:
        case "beam" | "polach" as name:
            return float(given[_LIMITS[name]])  # type: ignore[arg-type]
        case "lugre":
            return float(given["Fs"]) / wheel_load  # type: ignore[arg-type]
        case "bristle" | "bristle_rest" | "curve":
            return float(given["gamma"]) / float(given["beta"]) / wheel_load  # type: ignore[arg-type]
    return math.nan


def check_fit(
    found: Fit, setting: Setting, speeds: tuple[float, float], seen: float, factors: Mapping[str, float]
) -> None:
    """ImpossibleFitError for a fit with adhesion above `IMPOSSIBLE_MU`, InputError for one that is nowhere positive.

    `seen` is the highest mean mu of the log itself, which tells the likely cause; `speeds` as of `highest_mu`,
    `factors` as of `unit_hint`.
    """
    what, value = highest_mu(found, setting, speeds)
    if value <= IMPOSSIBLE_MU:
        return
    cause = units_or(seen, factors)
    if LOWEST_MU <= seen <= HIGHEST_MU:
        # a log that stays below the peak leaves the limit free: its stiffness can still be had, within a bound
        name = _LIMITS.get(found.model.name, "")
        bound = f"--bound {name}=0:{HIGHEST_MU:g}" if name in found.model.names else "another --model"
        cause = (
            f"the log itself shows {seen:.2g}, so that it does not tell this model, or the vehicle is another one; "
            f"check --vehicle and the wheel load, give a log with more slip, or {bound}"
        )
    given = [name for name in setting.fixed if name in found.model.known]
    if given:
        values = ", ".join(f"--fix {name}={setting.fixed[name]:g}" for name in given)
        cause = f"{values} is given: leave it out, or give another value; else {cause}"
    raise ImpossibleFitError(
        f"fitted to this log its highest adhesion coefficient, the {what}, is {value:.3g}, above {IMPOSSIBLE_MU:g}, "
        f"which no steel on steel in air has; {cause}"
    )


def fit_doubts(
    found: Fit, setting: Setting, speeds: tuple[float, float], seen: float, factors: Mapping[str, float]
) -> tuple[str, ...]:
    """What is not to be believed of a fit that is no impossible one, a sentence each; arguments as of `check_fit`."""
    what, value = highest_mu(found, setting, speeds)
    ordinary = LOWEST_MU <= value <= HIGHEST_MU
    doubts = []
    if not ordinary:
        doubts.append(
            f"the fitted {found.model.name} has a highest adhesion coefficient, its {what}, of {value:.3g}, where "
            f"steel on steel has {LOWEST_MU:g} to {HIGHEST_MU:g}: {units_or(value, factors)}"
        )
    cause = (
        "likely this log does not tell it, or the model is not this log's; a wrong unit of the brake torque (--unit), "
        "wheel load or vehicle (--vehicle) does the same"
        if ordinary and LOWEST_MU <= seen <= HIGHEST_MU
        else "likely by a wrong unit of the brake torque (--unit), wheel load or vehicle (--vehicle)"
    )
    untold = [f"{p.name} of {p.value:.4g}" for p in found.parameters if p.is_untold]
    if untold:
        doubts.append(
            f"the fitted {', '.join(untold)} may as well be any other by this log, and is near to where it was first "
            "looked for: give a log with more slip, a known value (--fix), or another --model"
        )
    ends = zip(found.parameters, found.model.lower, found.model.upper, strict=True)
    doubts += [_at_bound(p, low, high, setting, cause) for p, low, high in ends if "bound" in p.status]
    return tuple(doubts)


def _at_bound(p: Parameter, low: float, high: float, setting: Setting, cause: str) -> str:
    side, bound = ("lower", low) if "lower" in p.status else ("upper", high)
    if bound in setting.bounds.get(p.name, ()):
        cause = "which is given by --bound: the log asks for a value beyond it"
    # the smallest number stands for a 0 that is open
    end = "infinity" if math.isinf(bound) else f"{0.0 if bound < _NOUGHT else bound:.4g}"
    return f"the fitted {p.name} of {p.value:.4g} rests on its {side} bound, {end}: {cause}"


_NOUGHT = 1e-11


_MOST_ROWS = 2000  # of whole runs from the record's beginning: ten rig tests tell a tenth of an interval
_LEAST_GAIN = 40.0  # of the deviance; a model that is not the rig's own gains up to 26 by a shift there is no cause for
_HOPELESS = 0.5  # of this gain, below which that of a parabola through three lags is not searched further
_RESOLVED = 0.03  # of the log's interval, to which a lag is looked for: a fifth or less of its error
_MOST_LAGS = 10  # of the search between two ends, as each is a fit
_BETWEEN = 0.1  # of the interval: standard error that what happens between rows adds, as seen on the virtual rig
_CURVED = 0.25  # of the interval, over which the deviance's bend about the lag is taken


@dataclass(frozen=True)
class Lag:
    """By how much the wheel's speed is late beside the other columns, s, with its standard error; negative: early.

    The error is NaN where the likelihood does not bend as at a maximum.
    """

    seconds: float
    stderr: float


def lag_of(fit: Fit, record: Record, vehicle: Vehicle, wheel_load: float) -> Lag | None:
    """The likeliest lag of the wheel's speed; None where none is far more likely than no lag.

    The motion is followed with the other columns read off earlier, or later, and the parameters are fitted anew for
    each lag that is tried: first half an interval either way, then further while it gets likelier.
    """
    if not is_followed(fit.model, record):
        return None
    kept = replace(record, **{name: values[: _whole_runs(record)] for name, values in vars(record).items()})
    if not is_followed(fit.model, kept):
        return None
    interval = float(np.median(np.diff(kept.time)[np.diff(kept.run) == 0]))
    try:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a search may try what overflows
            return _likeliest(_Shifted(fit, kept, vehicle, wheel_load), interval)
    except ValueError:  # SciPy's and LAPACK's word for errors that are not finite: nothing can be told
        return None


class _Shifted:
    """-2 log likelihood of the motion over the lag, each value found once; fits begin where the best one ended."""

    def __init__(self, fit: Fit, record: Record, vehicle: Vehicle, wheel_load: float) -> None:
        self._fit, self._record, self._vehicle, self._wheel_load = fit, record, vehicle, wheel_load
        self._start = fit.values
        self._known: dict[float, float] = {}

    def __call__(self, lag: float) -> float:
        if lag not in self._known:
            shifted = earlier(self._record, lag)
            problem = PredictionErrors(self._fit.model, shifted, self._vehicle, self._wheel_load)
            self._known[lag], values = problem.likeliest(self._start)
            if self._known[lag] <= min(self._known.values()):
                self._start = values
        return self._known[lag]


def _likeliest(deviance: Callable[[float], float], interval: float) -> Lag | None:
    from scipy.optimize import minimize_scalar

    now, half = deviance(0.0), interval / 2.0
    ahead = min((half, -half), key=deviance)
    if deviance(ahead) >= now:  # within half an interval: searched where a parabola through the three gains enough
        bend, tilt = deviance(half) + deviance(-half) - 2.0 * now, deviance(half) - deviance(-half)
        if not bend > 0.0 or tilt**2 / (8.0 * bend) <= _LEAST_GAIN:
            return None
        low, high = -half, half
    else:
        low, between, high = _beyond(deviance, ahead)
        if now - _lowest_of_parabola(deviance, low, between, high) <= _HOPELESS * _LEAST_GAIN:
            return None
    options = {"maxiter": _MOST_LAGS, "xatol": _RESOLVED * interval}
    found = minimize_scalar(deviance, bounds=(low, high), method="bounded", options=options)
    if now - found.fun <= _LEAST_GAIN:
        return None
    lag, step = float(found.x), _CURVED * interval
    bend = (deviance(lag + step) + deviance(lag - step) - 2.0 * deviance(lag)) / step**2
    return Lag(lag, math.hypot(math.sqrt(2.0 / bend), _BETWEEN * interval) if bend > 0.0 else math.nan)


def _beyond(deviance: Callable[[float], float], lag: float) -> tuple[float, float, float]:
    """The ends, in order, between which the deviance is least beyond a lag that is better than none; a lag between."""
    before = 0.0
    while abs(lag) < LONGEST_DELAY and deviance(2.0 * lag) < deviance(lag):
        before, lag = lag, 2.0 * lag
    low, high = sorted((before, 2.0 * lag))
    return low, lag, high


def _lowest_of_parabola(deviance: Callable[[float], float], *lags: float) -> float:
    """Of the parabola through three lags, of which that in the middle is the likeliest; -inf where it has no lowest."""
    square, slope, constant = np.polynomial.polynomial.polyfit(lags, [deviance(lag) for lag in lags], 2)[::-1]
    return float(constant - slope**2 / (4.0 * square)) if square > 0.0 else -math.inf


def _whole_runs(record: Record) -> int:
    """Rows of as many whole runs as there is room for, the first in any case."""
    ends = np.append(np.flatnonzero(np.diff(record.run)) + 1, len(record))
    fitting = ends[ends <= _MOST_ROWS]
    return int(fitting[-1] if len(fitting) else min(ends[0], _MOST_ROWS))


def earlier(record: Record, lag: float) -> Record:
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
    error = f" ± {lag.stderr:.1g} s" if math.isfinite(lag.stderr) else ""
    beside = f", more than the --delay {wheel_column}={given:.4g} that is given" if given else ""
    cause = ""
    if not given and abs(late - interval / 2.0) < _ALIKE * lag.stderr:
        late, cause = interval / 2.0, " half an interval, as a difference of counts is:"
    remedy = f"{cause} --delay {wheel_column}={given + late:.3g} undoes it"
    if abs(given + late) > LONGEST_DELAY:
        remedy = " no delay is so long: check the unit of the time, and that the columns are of one recording"
    return (
        f"the wheel's speed seems to be {'late' if late > 0 else 'early'} by {abs(lag.seconds):.3g} s{error} beside "
        f"the other columns{beside}, which falsifies the fits;{remedy}"
    )


_ALIKE = 2.6  # standard errors


# --- the models of a log ---------------------------------------------------------------------------------------------


DRIFT_SPEEDS = (0.2, 0.4, 0.6, 0.8, 1.0)
"""Speeds at which a fit is looked at, of the initial speed."""

OF_EACH_KIND = ("bristle", "beam", "burckhardt")
"""Models with a prediction-error fit: one that builds up, one with a kink, a smooth one."""

_NO_PEAK = (*SLIDING_ALONE, "table")  # or one that lies on a knot


def speeds_looked_at(setting: Setting) -> tuple[float, float]:
    """The lowest and the highest speed at which a fit is looked at, m/s."""
    return DRIFT_SPEEDS[0] * setting.initial_speed, DRIFT_SPEEDS[-1] * setting.initial_speed


@dataclass(frozen=True)
class Fitted:
    """The fits; why models have none, a sentence each; and which of these for adhesion that cannot be."""

    fits: tuple[Fit, ...]
    failures: tuple[str, ...]
    impossible: tuple[str, ...]


class Candidates:
    """What can be fitted to a curve.

    The regimes are parted at the peak of the best of the models fitted that follow the whole curve by a formula;
    without one, where the data's mu is highest.
    """

    def __init__(self, curve: Curve, vehicle: Vehicle, setting: Setting, regimes: Regimes | None = None) -> None:
        self.curve, self.vehicle, self.setting = curve, vehicle, setting
        self.regimes = regimes or regimes_of_data(curve.cells)

    def fitted(self, names: Sequence[str]) -> Fitted:
        """The models of some names, with the intervals of a single one."""
        fits: list[Fit] = []
        failures, impossible, alone = [], [], len(names) == 1
        for name in sorted(names, key=SLIDING_ALONE.__contains__):  # last: the others tell where sliding begins
            if name in SLIDING_ALONE:
                self.regimes = self._regimes_of(fits)
            try:
                fits.append(self._fit(name, profiles=alone))
            except InputError as error:
                failures.append(f"{self.curve.name}: {error}" if alone else f"{self.curve.name}: {name}: {error}")
                impossible += [name] if isinstance(error, ImpossibleFitError) else []
        self.regimes = self._regimes_of(fits)
        return Fitted(tuple(fits), tuple(failures), tuple(impossible))

    def with_intervals(self, found: Fit) -> Fit:
        """A fit of these with the intervals of its parameters; as it is where it has them."""
        return found if found.with_profiles else self._fit(found.model.name, profiles=True)

    def better_followed(self, found: Fit) -> Fit:
        """The best of some models with a prediction-error fit, where it is better than one of the user's."""
        free = Candidates(self.curve, self.vehicle, replace(self.setting, fixed={}, bounds={}))
        others = free.fitted([name for name in OF_EACH_KIND if name != found.model.name]).fits
        return compare([found, *others], self.curve.cells)[0].fit

    def _fit(self, name: str, *, profiles: bool) -> Fit:
        """One model. InputError where it cannot be fitted, or has adhesion that cannot be."""
        curve, setting = self.curve, self.setting
        model = fit_model(name, curve.cells, shape_of(curve.cells, curve.peak_slip), setting)
        known = (curve.cells, curve.stretches, setting, self.regimes.boundary, curve.time_constant)
        first = fit(model, *known, profiles=profiles and not is_followed(model, curve.record))
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a search may try what overflows
            found = prediction_error_fit(first, curve.record, self.vehicle, curve.cells, setting, profiles=profiles)
            check_fit(found, setting, speeds_looked_at(setting), curve.highest_mu, curve.factors)
        return replace(found, with_profiles=profiles)

    def _regimes_of(self, fits: Sequence[Fit]) -> Regimes:
        whole, own = [each for each in fits if each.model.name not in _NO_PEAK], regimes_of_data(self.curve.cells)
        if not whole:
            return own
        best, setting = compare(whole, self.curve.cells)[0].fit, self.setting
        law = best.model.make_force_law(best.values, setting.rail)
        with suppress(DomainError):
            found = peak_of_law(law, setting.initial_speed, setting.wheel_load)
            return regimes_of(found.slip, best.model.name, self.curve.cells, own)
        return own
