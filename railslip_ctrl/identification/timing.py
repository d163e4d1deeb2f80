"""Are the columns of a log in step? A wheel speed that is late shows in how well the motion can be followed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.model.vehicle import Vehicle

from .alignment import LONGEST_DELAY
from .fits import Fit
from .motion import is_followed
from .prediction import Along
from .record import Record

Floats = NDArray[np.float64]

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


class _Followed(Along):
    """The whitened errors, with the likelihood of the best parameters."""

    def likeliest(self, start: Floats) -> tuple[float, Floats]:
        """-2 log likelihood, but for a constant, of the best parameters from a start; and those parameters."""
        found, _ = self.solve([start])  # the factor has the scale in it: as many whitened squares as there are errors
        assert self._factor is not None
        return 2.0 * float(np.sum(np.log(self._factor[0]))), self.coordinates.values(found)


class _Shifted:
    """-2 log likelihood of the motion over the lag, each value found once; fits begin where the best one ended."""

    def __init__(self, fit: Fit, record: Record, vehicle: Vehicle, wheel_load: float) -> None:
        self._fit, self._record, self._vehicle, self._wheel_load = fit, record, vehicle, wheel_load
        self._start = fit.values
        self._known: dict[float, float] = {}

    def __call__(self, lag: float) -> float:
        if lag not in self._known:
            shifted = earlier(self._record, lag)
            problem = _Followed(self._fit.model, shifted, self._vehicle, self._wheel_load)
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

# --- the unit of the time ---------------------------------------------------------------------------------------

_OTHER_CLOCK = 200.0  # ratio of decelerations; of s and ms it is 1000, and a train brakes with more than the one wheel
_SLOWED = 0.02  # of its speed that the train loses in the runs: on a rig that keeps its speed this tells nothing
_PULLS = (0.02, 1.0)  # highest brake torque by wheel load and radius: else the torque's unit is what is wrong


def time_fault(record: Record, vehicle: Vehicle, highest_pull: float) -> str | None:
    """A sentence where the train slows down as if its time had another unit than it is read in; else None.

    The speed lost in the runs under brake is set against that by the brake torque on the vehicle's mass, each wheel its
    own. `highest_pull` as of `Survey`.
    """
    if not len(record) or not _PULLS[0] < highest_pull < _PULLS[1]:
        return None
    inside = np.diff(record.run) == 0
    lost = -float(np.diff(record.speed)[inside].sum())
    begins = np.flatnonzero(np.diff(record.run, prepend=-1))
    asked = float((np.diff(record.time) * record.torque[1:])[inside].sum())
    asked /= vehicle.wheel.radius * vehicle.effective_mass
    if not lost > _SLOWED * float(record.speed[begins].sum()) or not asked > 0.0:
        return None
    ratio = lost / asked
    if 1.0 / _OTHER_CLOCK < ratio < _OTHER_CLOCK:
        return None
    slow = ratio < 1.0
    likely, read = ("ms", "s") if slow else ("s", "ms")
    shown = 1.0 / ratio if slow else ratio
    return (
        f"the train slows down {shown:.2g} times {'less' if slow else 'more'} than the brake torque on it makes it: "
        f"the time seems to be in {likely}, and is read as {read}; give --unit time={likely}"
    )


# --- the train's speed ---------------------------------------------------------------------------------------------

TRAIN_LAG = 0.01
"""s, of the train's speed, that is told what it would do: a message of a bus, or a short filter."""

_ABOUT_PEAK = (0.7, 1.3)  # of the slip of the peak, between which the deceleration is taken
_LEAST_ROWS = 3  # of a run between them, to have a slope


@dataclass(frozen=True)
class TrainLag:
    """What a lag of the train's speed of `TRAIN_LAG` would do to the slip at the peak of the adhesion.

    A train that slows down by a m/s^2 reads a tau faster than it is, so that the slip ratio is (1 - slip) a tau/v too
    large. While the adhesion alone slows it down, a is proportional to mu, and the shift cannot be told from a softer
    contact: no single log shows such a lag. A fit takes it for one, so that its peak moves by more than the rows do: of
    the brush model, whose peak is near 3 mu N/Kx and whose 1/Kx grows by the shift over mu N, by three times as much
    where the rise alone tells Kx.

    Attributes
    ----------
    lag : float
        s.
    slip_shift : float
        By how much the slip ratio at the peak would be too large.
    peak_slip : float
    deceleration, speed : float
        Of the train about the peak, m/s^2 and m/s.
    """

    lag: float
    slip_shift: float
    peak_slip: float
    deceleration: float
    speed: float

    def __str__(self) -> str:
        return (
            f"a lag of {1e3 * self.lag:g} ms, which this log cannot show, moves slip by {self.slip_shift:.2g} at the "
            f"peak (slip of peak {self.peak_slip:.3g}), and that of a fit by up to three times as much; give "
            "--delay train_speed= if there is one"
        )


def train_lag(record: Record, radius: float, peak_slip: float, lag: float = TRAIN_LAG) -> TrainLag | None:
    """The shift of the slip at the peak by a lag in s, from deceleration and speed on the runs' way up there.

    `radius` of the wheel in m. None where no run has rows enough about the peak, or the train does not slow down there.
    """
    low, high = (share * peak_slip for share in _ABOUT_PEAK)
    slip = 1.0 - radius * record.omega / record.speed
    products, squares, speeds = 0.0, 0.0, []
    for run in np.unique(record.run):
        at = record.run == run
        time, speed, of_run = record.time[at], record.speed[at], slip[at]
        beyond = of_run > high
        end = int(np.argmax(beyond)) if beyond.any() else len(of_run)
        near = np.flatnonzero(of_run[:end] >= low)
        if len(near) >= _LEAST_ROWS:
            t = time[near] - time[near].mean()
            products, squares = products + float(t @ speed[near]), squares + float(t @ t)
            speeds.append(float(speed[near].mean()))
    if not products < 0.0:
        return None
    deceleration, speed_there = -products / squares, float(np.mean(speeds))
    return TrainLag(lag, (1.0 - peak_slip) * deceleration * lag / speed_there, peak_slip, deceleration, speed_there)
