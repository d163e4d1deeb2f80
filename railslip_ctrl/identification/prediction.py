"""Prediction-error fits: predict each row's wheel speed from the row before, and minimise the errors.

A random force on the wheel also changes its slip. A curve fitted to force over slip is therefore too flat where the
adhesion characteristic is steep. A prediction of the wheel speed one interval ahead has no such bias: if the
random force is not correlated over several rows, the present slip does not depend on the next force.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from railslip_ctrl.core.arguments import Flags, Floats, Integers
from railslip_ctrl.core.errors import InputError, RailslipError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.model.adhesion.curve import SLIP_ACCELERATION
from railslip_ctrl.model.numeric import peak
from railslip_ctrl.model.vehicle import Vehicle

from .curves import Cells, Stretches
from .fits import REGULARISATION, Fit, estimate, fit_of, long_run_variance, search, slopes_of, whole_tests
from .messages import message
from .models import FitModel, Setting, spline
from .observed import BrakedRows
from .observer import linear_recursion, mean_phi, phi

#: models whose force is a function of slip and speed, fitted over the whole range of slip
STATIC = ("beam", "polach", "burckhardt", "curve", "table")

DYNAMIC = ("bristle",)  #: models with a state

_LEAST_INTERVALS = 60  # fewer intervals do not determine two variances and the parameters
_SUBSTEPS = (1, 2)  # substeps of an interval, for slow and for fast decay of a deviation
_SLOW_DECAY = 0.3  # largest logarithmic decay per interval for one substep; the error is then some 1e-5 of the force
_SLIP_STEP = 1e-6  # slip difference for the slope of the force; the steepest law changes its slope over 1e-3
_ROUNDS = 4  # most rounds of estimating variances and parameters alternately
_SETTLED = 1e-6  # relative change of the parameters that ends the rounds
_RATIOS = (math.log(1e-8), math.log(1e6))  # log range of the ratio of variances: sensor noise to random force's effect
_LARGEST_SLIP = 0.999  # slip ratio; larger trial values are set to it
_LARGEST_GROWTH = 50.0  # largest logarithmic growth of a deviation over a step; keeps the numbers finite
_OFF_BOUND = 1e-3  # distance from a bound at which a search begins, in sizes of the coordinate
_CONVERGED = 1e-10  # relative tolerance of the sum of squares
_SEARCH = 300  # most evaluations of the errors and their Jacobian
_SAME_MINIMUM = 1e-6  # relative difference of the sums of squares of searches that reached the same minimum
_FOLLOWED_CELLS = 100  # number of cells, equally wide in the square root of the slip ratio
_SPLINE_POINTS = 256  # number of points, equally spaced in the square root of the slip; the error is 256^-4 of mu
_SPLINE_REACH = 0.005  # slip by which the spline extends beyond the record's highest slip, for predictions


class Errors(NamedTuple):
    """Prediction errors of the wheel speed, rad/s; arrays with one entry for each interval between rows."""

    error: Floats
    decay: Floats  # factor by which a deviation of the wheel speed shrinks over the interval
    start: Floats | None  # derivative by the deflection of the bristles at the start of the run


@dataclass(frozen=True)
class Intervals:
    """Intervals between neighbouring rows, SI. Names that end in 0 or 1 are values at the beginning or end."""

    step: Floats  # length of the interval
    speed0: Floats
    speed1: Floats
    omega0: Floats
    omega1: Floats
    torque0: Floats
    torque1: Floats
    load: Floats
    time: Floats  # end of the interval
    run: Integers
    speed_bend: Floats  # second derivative of the train speed times `step` squared, m/s

    @classmethod
    def of(cls, record: BrakedRows) -> Intervals:
        same = np.diff(record.run) == 0
        v0, omega0, torque0 = (x[:-1][same] for x in (record.speed, record.omega, record.torque))
        v1, omega1, torque1, time = (x[1:][same] for x in (record.speed, record.omega, record.torque, record.time))
        run = np.unique(record.run[:-1][same], return_inverse=True)[1].astype(np.int64)
        step, load = np.diff(record.time)[same], record.load[:-1][same]
        return cls(step, v0, v1, omega0, omega1, torque0, torque1, load, time, run, np.zeros_like(step))

    def __len__(self) -> int:
        return len(self.step)

    def with_curvature(self, *, steeper: bool = False) -> Intervals:
        """Return the intervals with `speed_bend`, and with torques whose mean is that of a parabola.

        One parabola passes through both ends of the interval and the row before it, another through both ends and the
        row after it. The flatter parabola is used, because it does not cross a corner of the signal; if `steeper`, the
        steeper parabola is used.
        """
        # the torque of a released brake decays so fast that the mean of its values at both ends is 1 % too high
        excess = self._curvature(self.torque0, self.torque1, steeper=steeper) / 12.0
        bend = self._curvature(self.speed0, self.speed1, steeper=steeper)
        return replace(self, torque0=self.torque0 - excess, torque1=self.torque1 - excess, speed_bend=bend)

    def _curvature(self, begin: Floats, end: Floats, *, steeper: bool) -> Floats:
        slope = (end - begin) / self.step
        bend = np.full(len(self) + 1, np.nan)  # at the rows between two intervals; unknown at both ends of a run
        bend[1:-1] = 2.0 * np.diff(slope) / (self.step[1:] + self.step[:-1])
        bend[:-1][self.begins] = np.nan
        before, after = bend[:-1], bend[1:]
        size = np.abs(before) - np.abs(after)
        chosen = np.where((size > 0.0) == steeper, before, after)
        known = np.where(np.isnan(size), np.where(np.isnan(before), after, before), chosen)
        return np.nan_to_num(known) * self.step**2

    @property
    def begins(self) -> Flags:
        return np.asarray(np.diff(self.run, prepend=-1) != 0)


class PredictionErrors:
    """Least-squares problem whose residuals are the whitened prediction errors of a model along a record."""

    def __init__(self, model: FitModel, record: BrakedRows, vehicle: Vehicle, wheel_load: float) -> None:
        self.model, self.coordinates, self.wheel_load = model, model.coordinates, wheel_load
        self.radius, self.J = vehicle.wheel.radius, vehicle.effective_inertia
        self.B = vehicle.effective_viscous_friction
        self._straight = Intervals.of(record)
        self.intervals = self._straight.with_curvature()
        self._factor: Floats | None = None
        self._substeps = _SUBSTEPS[1]
        self._spline: tuple[tuple[float, ...], Any] | None = None
        slip = 1.0 - self.radius * record.omega / record.speed
        self._highest_root = math.sqrt(min(float(np.max(slip, initial=0.0)) + _SPLINE_REACH, _LARGEST_SLIP))

    # --- one interval ahead -----------------------------------------------------------------------------------------

    def errors(self, values: Floats) -> Errors:
        return self._bristles(values)[0] if self.model.name in DYNAMIC else self._static_errors(values)

    def _force(self, values: Floats, sigma: Floats, v: Floats) -> Floats:
        slip = np.minimum(np.abs(sigma) / v, _LARGEST_SLIP)
        if self.model.name == "curve":  # each value is an integral, so a spline replaces it; mu does not depend on load
            force = self._curve(tuple(values))(np.sqrt(slip)) * self.wheel_load
        else:
            force = self.model.coefficient(values, slip, v, self.intervals.load) * self.intervals.load
        return np.asarray(np.sign(sigma) * force)

    def _curve(self, values: tuple[float, ...]) -> Any:
        from scipy.interpolate import CubicSpline

        if self._spline is None or self._spline[0] != values:
            root = np.linspace(0.0, self._highest_root, _SPLINE_POINTS)
            mu = self.model.coefficient(np.array(values), root**2, np.ones_like(root), self.wheel_load)
            self._spline = values, CubicSpline(root, mu)
        return self._spline[1]

    def _static_errors(self, values: Floats) -> Errors:
        # Exponential Rosenbrock method of order 2, exact if adhesion is linear in slip, and torque and train speed in
        # time. It integrates sigma instead of omega, which changes much where the characteristic is steep.
        i = self.intervals
        h = i.step / self._substeps
        dv, dtorque = (i.speed1 - i.speed0) / self._substeps, (i.torque1 - i.torque0) / self._substeps
        bend = i.speed_bend / self._substeps**2
        v, torque, sigma, decay = i.speed0, i.torque0, i.speed0 - self.radius * i.omega0, np.ones(len(i))
        dv = dv - bend * (self._substeps - 1) / 2.0
        for _ in range(self._substeps):
            at = np.stack([sigma, sigma + _SLIP_STEP * v, sigma])  # one call, because for few rows each call takes long
            force, steeper, later = self._force(values, at, np.stack([v, v, v + dv]))
            q = (self.radius**2 * (steeper - force) / (_SLIP_STEP * v) + self.B) / self.J * h
            q = np.maximum(q, -_LARGEST_GROWTH)
            turning = self.B * (v - sigma) + self.radius * torque - self.radius**2 * force
            change = self.B * dv + self.radius * dtorque - self.radius**2 * (later - force)
            decayed, mean = phi(q), mean_phi(q)
            sigma = sigma + (dv + h / self.J * turning) * decayed + h / self.J * change * mean
            sigma = sigma + bend * (mean - decayed / 2.0)
            decay = decay * np.exp(-q)
            v, torque, dv = v + dv, torque + dtorque, dv + bend
        return Errors(i.omega1 - (i.speed1 - sigma) / self.radius, decay, None)

    def followed(self, values: Floats) -> Floats:
        """Mean slip ratio and mean mu of the bristle model in each cell of slip, shape (2, cells)."""
        errors, sigma, mean, left = self._bristles(values)
        assert errors.start is not None
        assert self._factor is not None, "set_variances comes first"
        i, run = self.intervals, self.intervals.run
        error, start = (self._whitened(x, self._factor) for x in (errors.error, errors.start))
        z0 = -np.bincount(run, start * error) / np.bincount(run, start**2)
        force = self._values(values)[0] * (mean + left * z0[run])
        slip = np.clip(sigma / ((i.speed0 + i.speed1) / 2), 0.0, 1.0)
        cell = (np.sqrt(slip) * _FOLLOWED_CELLS).astype(np.int64)
        count = np.bincount(cell)
        sums = np.stack([np.bincount(cell, slip), np.bincount(cell, force / i.load)])
        return np.asarray(sums[:, count > 0] / count[count > 0])

    def _values(self, values: Floats) -> tuple[float, float, float]:
        given = {**self.model.known, **dict(zip(self.model.names, values, strict=True))}
        alpha, beta, gamma = (float(given[name]) for name in ("alpha", "beta", "gamma"))
        return alpha, beta, gamma

    def _bristles(self, values: Floats) -> tuple[Errors, Floats, Floats, Floats]:
        # z' = sigma - alpha beta |sigma| z/(gamma - |sigma|) for the deflection z of the bristles, with the mean sigma
        # of each interval; the last result is the derivative of the mean z by z at the start of the run
        i = self.intervals
        alpha, beta, gamma = self._values(values)
        v, omega = (i.speed0 + i.speed1) / 2, (i.omega0 + i.omega1) / 2
        sigma = v - self.radius * omega
        q = i.step * alpha * beta * np.abs(sigma) / np.maximum(gamma - np.abs(sigma), 1e-3 * gamma)
        share = phi(q)
        begins = i.begins
        z1 = linear_recursion(
            np.where(begins, 0.0, np.exp(-q))[:, None, None], (i.step * sigma * share)[:, None], _ZERO
        )
        z0 = np.where(begins, 0.0, np.concatenate([_ZERO, z1[:-1, 0]]))
        # mean over the interval: part due to z at its beginning, and part due to growth within it
        mean = z0 * share + i.step * sigma * mean_phi(q)
        decay = np.cumsum(q) - q
        left = np.exp(-(decay - decay[begins][i.run]))  # remaining share of z at the start of the run
        gain = i.step / self.J * self.radius * alpha
        torque = (i.torque0 + i.torque1) / 2
        predicted = i.omega0 + gain * mean - i.step / self.J * (torque + self.B * omega)
        errors = Errors(i.omega1 - predicted, np.ones(len(i)), -gain * left * share)
        return errors, sigma, mean, left * share

    # --- whitening --------------------------------------------------------------------------------------------------

    def set_variances(self, values: Floats) -> None:
        """Estimate the variances of random force and sensor noise by maximum likelihood.

        `residuals` whitens the errors with these variances.
        """
        from scipy.optimize import minimize_scalar

        errors = self.errors(values)
        error, bands = self._without_start(errors.error, errors.start), self._covariance_bands(errors.decay)

        def deviance(log_ratio: float) -> float:
            factor = _covariance_factor(bands, math.exp(log_ratio))
            white = self._whitened(error, factor)
            size = float(np.sum(white**2)) + np.finfo(float).tiny
            return len(white) * math.log(size) + 2.0 * float(np.sum(np.log(factor[0])))

        best = minimize_scalar(deviance, bounds=_RATIOS, method="bounded", options={"xatol": 1e-3})
        factor = _covariance_factor(bands, math.exp(best.x))
        scale = math.sqrt(float(np.mean(self._whitened(error, factor) ** 2))) or 1.0
        self._factor = factor * scale

    def _covariance_bands(self, A: Floats) -> tuple[Floats, Floats]:
        # e[k] = n[k+1] - A[k] n[k] + gain[k] w[k], with noise n of the measured wheel speed and random force w
        i = self.intervals
        # the force is constant over a nominal interval; over a longer interval the variance of its mean is smaller
        gain = phi(-np.log(np.clip(A, 1e-12, 1e12))) * np.sqrt(i.step / np.median(i.step))
        force, sensor = np.zeros((2, len(i))), np.zeros((2, len(i)))  # bands of the covariances, for variance 1
        force[0], sensor[0] = gain**2, 1 + A**2
        sensor[1, :-1] = np.where(i.begins[1:], 0.0, -A[1:])
        return force, sensor

    def residuals(self, values: Floats) -> Floats:
        """Whitened errors; each has variance 1 if the model is right."""
        errors = self.errors(values)
        assert self._factor is not None, "set_variances comes first"
        start = None if errors.start is None else self._whitened(errors.start, self._factor)
        return self._without_start(self._whitened(errors.error, self._factor), start)

    @staticmethod
    def _whitened(x: Floats, factor: Floats) -> Floats:
        from scipy.linalg.blas import dtbsv

        # faster than `solve_banded`, which pivots needlessly; both raise ValueError if x is not finite
        return np.asarray(dtbsv(1, factor, np.asarray_chkfinite(x), lower=1))

    def _without_start(self, error: Floats, start: Floats | None) -> Floats:
        """Errors that remain if each run starts with the best-fitting deflection of the bristles."""
        if start is None:
            return error
        run = self.intervals.run
        best = np.bincount(run, start * error) / np.bincount(run, start**2)
        return error - start * best[run]

    # --- the fit ----------------------------------------------------------------------------------------------------

    def solve(self, starts: Sequence[Floats]) -> tuple[Floats, Floats]:
        """Search from several starting values; return the best search coordinates and the whitened errors for them."""
        if self.model.name in STATIC:
            steepest = float(np.max(-np.log(self.errors(starts[0]).decay)))
            self._substeps = _SUBSTEPS[steepest > _SLOW_DECAY]
        at, values = self.coordinates.at, self.coordinates.values
        tried = [self._search(at(start)) for start in starts]
        least = min(squares for squares, _ in tried)
        best = next(x for squares, x in tried if squares <= (1.0 + _SAME_MINIMUM) * least)
        for _ in range(_ROUNDS - 1):
            before, best = best, self._search(best)[1]
            if np.all(np.abs(best - before) <= _SETTLED * self.coordinates.sizes(best)):
                break
        self.set_variances(values(best))
        return best, self.residuals(values(best))

    def maximum_likelihood(self, start: Floats) -> tuple[float, Floats, float]:
        """Fit from the starting values `start`.

        Returns -2 log likelihood up to a constant, the best values, and the long-run variance of the whitened errors.
        """
        best, errors = self.solve([start])
        return self.deviance, self.coordinates.values(best), _inflation(self.intervals, errors, len(best))[0]

    @property
    def deviance(self) -> float:
        """-2 log likelihood, up to a constant, of the values last given to `set_variances`."""
        # the factor includes the common scale, so the sum of the whitened squares is constant
        assert self._factor is not None, "set_variances comes first"
        return 2.0 * float(np.sum(np.log(self._factor[0])))

    def _search(self, start: Floats) -> tuple[float, Floats]:
        coordinates = self.coordinates
        centre = coordinates.at(self.model.starts[0])
        self.set_variances(coordinates.values(start))
        begin = coordinates.inside(start, _OFF_BOUND)
        _, x = search(
            self.residuals, coordinates, begin, weight=REGULARISATION, centre=centre, tolerance=_CONVERGED, most=_SEARCH
        )
        return float(np.sum(self.errors(coordinates.values(x)).error ** 2)), x

    def discretisation(self, x: Floats, slopes: Floats) -> list[Floats]:
        """Shifts of the best search coordinates `x` under other assumptions about the motion between rows.

        The assumptions are straight lines instead of parabolas, the steeper parabola in each interval, and, for a
        static model, an integration step of zero (Richardson's estimate of order 2).
        """
        values, inverse = self.coordinates.values(x), np.linalg.pinv(slopes)
        here, intervals = self.residuals(values), self.intervals
        shifts = []
        for other in (self._straight, self._straight.with_curvature(steeper=True)):
            self.intervals = other
            shifts.append(inverse @ (self.residuals(values) - here))
        self.intervals = intervals
        if self.model.name in STATIC:
            steps = self._substeps
            self._substeps = 2 * steps
            shifts.append(inverse @ (here - self.residuals(values)) * 4.0 / 3.0)
            self._substeps = steps
        return shifts


_ZERO = np.zeros(1)


def _covariance_factor(bands: tuple[Floats, Floats], ratio: float) -> Floats:
    from scipy.linalg import cholesky_banded

    force, sensor = bands
    return np.asarray(cholesky_banded(force + ratio * sensor, lower=True))


# --- prediction-error fit, starting from a fit to the cells --------------------------------------------------------

_LEAST_ROWS = 4  # least rows between two knots of a table; rapidly growing slip leaves gaps between the rows
_STRETCH = 10.0  # shortest stretch over which errors are summed, in intervals
_STRETCHES_A_PARAMETER = 3.0  # least stretches for each parameter; a log with fewer gets shorter stretches
_ALPHA_FACTORS = (0.2, 1.0)  # starts of alpha over its value from the cells, which is too large if slip grows rapidly
_WHOLE_TEST = 1 / 3  # a whole test begins below this share of the slip up to which its ramp is measured
_RAMP_RANGE = 2.0  # a note gives the peak for slip accelerations lower and higher by this factor


def has_prediction_errors(model: FitModel, record: BrakedRows) -> bool:
    """True if a model has a prediction-error fit and the record has enough intervals for it."""
    return model.name in (*STATIC, *DYNAMIC) and int(np.sum(np.diff(record.run) == 0)) >= _LEAST_INTERVALS


def prediction_error_fit(
    first: Fit, record: BrakedRows, vehicle: Vehicle, cells: Cells, setting: Setting, *, profiles: bool = True
) -> Fit:
    """Refit the model of `first`, a fit to the cells, by minimising the prediction errors.

    Returns `first` if `has_prediction_errors` is false. InputError if the model cannot reproduce the motion of the
    wheel.
    """
    if not has_prediction_errors(first.model, record):
        return first
    try:
        return _refitted(first, record, vehicle, cells, setting, profiles)
    except RailslipError:
        raise
    except ValueError as error:  # raised by SciPy and LAPACK if the errors are not finite
        raise InputError(message("cannot follow")) from error


def _refitted(first: Fit, record: BrakedRows, vehicle: Vehicle, cells: Cells, setting: Setting, profiles: bool) -> Fit:
    model, values = first.model, first.values
    if model.name == "table":
        kept = _knots_with_rows(model.knots, 1.0 - vehicle.wheel.radius * record.omega / record.speed)
        model, values = model.with_knots(kept), values[kept]
    problem = PredictionErrors(model, record, vehicle, setting.wheel_load)
    factors = _ALPHA_FACTORS if model.name in DYNAMIC and "alpha" in model.names else (1.0,)
    starts = [np.array([f if name == "alpha" else 1.0 for name in model.names]) * values for f in factors]
    x, errors = problem.solve(starts)
    slopes = slopes_of(problem, x)
    variance, freedom = _inflation(problem.intervals, errors, len(x))
    i, shifts = problem.intervals, problem.discretisation(x, slopes)
    tests = whole_tests(i.time, i.step, i.run)
    noise = (first.long_run_variance, first.degrees_of_freedom)  # over the cells
    known = estimate(problem, x, slopes, variance, freedom, tests=tests, shifts=shifts, profiles=profiles)
    quality: dict[str, Any] = {"deviance": problem.deviance, "inflation": (variance, freedom)}
    if model.name == "table":
        every_second = sorted({*range(0, len(model.knots), 2), len(model.knots) - 1})
        coarser, start = model.with_knots(every_second), known.values[every_second]
        halved = PredictionErrors(coarser, record, vehicle, setting.wheel_load).maximum_likelihood(start)[1]
        quality["coarse"] = spline(coarser.knots, halved)(model.knots)
    if model.name in STATIC:
        return replace(fit_of(model, known, cells, setting, noise), **quality)
    model, spread = _with_ramp(model, known.values, setting)
    second = fit_of(model, known, cells, setting, noise, problem.followed(known.values))
    return replace(second, known_stderrs={} if spread is None else {"R": spread}, **quality)


def _knots_with_rows(knots: Floats, slip: Floats) -> list[int]:
    """Indices of knots that have enough rows between them; the last knot is always among them."""
    kept = [0]
    for i in range(1, len(knots)):
        if np.count_nonzero((slip > knots[kept[-1]]) & (slip <= knots[i])) >= _LEAST_ROWS:
            kept.append(i)
    return [*kept[:-1], len(knots) - 1]


def _inflation(intervals: Intervals, errors: Floats, parameters: int) -> tuple[float, int]:
    """Long-run variance of the whitened errors (1 if they are white), and its degrees of freedom."""
    rows = min(_STRETCH, len(errors) / (_STRETCHES_A_PARAMETER * parameters))
    length = max(rows, 1.0) * float(np.median(intervals.step))
    stretch = ((intervals.time - intervals.time[0]) / length).astype(np.int64)
    none = np.zeros(len(errors), dtype=np.int64)
    sums = Stretches(length, stretch, none, np.ones(len(errors)), errors)
    return long_run_variance(np.zeros(1), np.ones(1, dtype=bool), sums, parameters, 0.0)


def slip_ramp(record: BrakedRows, radius: float, top: float, initial_speed: float) -> tuple[float, float | None]:
    """Mean slip acceleration R, m/s^2, up to the slip ratio `top`, and its standard deviation from test to test.

    R is the time-weighted mean over the tests that reach `top` from below, or over all tests that begin below `top` if
    none reaches it. If some of these tests begin far below `top`, only they are used, because the slip rises faster
    near the peak. `radius` is in m, `initial_speed` in m/s. R is 0 if no test begins below `top`; the standard
    deviation is None if fewer than two tests reach `top`.
    """
    slip = 1.0 - radius * record.omega / record.speed
    test = whole_tests(record.time, np.zeros(len(record)), record.run.astype(np.int64))
    cuts = np.flatnonzero(np.diff(test)) + 1
    ramps = []
    for time, of_test in zip(np.split(record.time, cuts), np.split(slip, cuts), strict=True):
        if len(time) > 1 and of_test[0] < top:
            up = of_test >= top
            end = int(np.argmax(up)) if up.any() else -1
            gain = initial_speed * (of_test[end] - of_test[0])
            ramps.append((time[end] - time[0], gain, float(up.any()), float(of_test[0] < _WHOLE_TEST * top)))
    if not ramps:
        return 0.0, None
    duration, gain, arrived, whole = np.array(ramps).T
    kept = arrived > 0.0 if arrived.any() else np.ones(len(ramps), dtype=bool)
    kept = kept & (whole > 0.0) if (kept & (whole > 0.0)).any() else kept
    duration, gain = duration[kept], gain[kept]
    mean = float(gain.sum() / duration.sum())
    if not arrived.any() or len(duration) < 2:
        return mean, None
    scatter = np.sum(duration * (gain / duration - mean) ** 2) / duration.sum() * len(duration) / (len(duration) - 1)
    return mean, float(np.sqrt(scatter))


def _with_ramp(model: FitModel, values: Floats, setting: Setting) -> tuple[FitModel, float | None]:
    """Return the model with the slip acceleration R that determines its peak, and the standard deviation of R.

    The standard deviation is that between runs, None if not known. The model also gets a note about R.
    """
    R, source, spread = setting.given_acceleration, "as given", None
    if R is None:
        R, source, spread = setting.slip_acceleration, "the log's mean up to its peak", setting.acceleration_spread
    if R is None:
        R, source, spread = SLIP_ACCELERATION, "the default", None

    def at(ramp: float) -> tuple[FitModel, float]:
        trial = replace(model, known={**model.known, "R": ramp})
        law = trial.make_force_law(values, setting.rail)
        return trial, peak(law, setting.initial_speed, setting.wheel_load).slip

    chosen, slip = at(R)
    low, high = (at(ramp)[1] for ramp in (R / _RAMP_RANGE, R * _RAMP_RANGE))
    counted = message("no scatter") if spread is None else message("scatter", spread=spread)
    note = message("ramp of the peak", R=R, source=source, slip=slip, low=low, high=high, counted=counted)
    return replace(chosen, notes=(note,)), spread
