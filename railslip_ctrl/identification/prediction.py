"""Prediction-error fits: each row's wheel speed predicted from the row before, the errors made least.

A random force acts on the wheel and shows in its slip. Where the characteristic is steep it shows there more than in
the force, and a curve laid through force over slip comes out too flat. The wheel speed one interval ahead does not
suffer from it: what the force will do is not yet in the slip of now. With w the random force (white, held between
rows), n the pickup's noise and A the decay of a deviation over the interval, the error of a prediction is

    r[k] = n[k+1] - A[k] n[k] + g[k] w[k],    g = (r/J) (interval, shortened by the decay),

whose covariance is tridiagonal; the variances are the likeliest ones, and least squares are of the whitened errors. A
force that is correlated over several rows is in part in the slip already: on steep rises a bias remains, and the
intervals are widened by the whitened errors' long-run variance, which shows part of it.

The bristles' deflection z is integrated along the measured slip, in which z' is linear; its value at the start of a
run is unknown and is fitted with the rest, run by run.

Between rows brake torque and train speed are taken to bend as their neighbours say: a released brake's torque dies out
so fast that the mean of both ends is 1 % too high, and the adhesion would seem to fall the less for it; and the slip
where the characteristic is steep is so small that the bend of the train's speed is seen in it.
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
from .fits import PULL, Fit, estimate, fit_of, long_run_variance, search, slopes_of, whole_tests
from .models import FitModel, Setting, spline
from .observed import BrakedRows
from .observer import linear_recursion, mean_phi, phi
from .words import told

STATIC = ("beam", "polach", "burckhardt", "curve", "table")
"""Models whose force is a function of slip and speed that is fitted over its whole range."""

DYNAMIC = ("bristle",)

_LEAST_INTERVALS = 60  # fewer say nothing of two variances and the parameters
_SUBSTEPS = (1, 2)  # of an interval: while deviations decay little in it, and where they do
_LITTLE = 0.3  # times the decay per interval, below which one substep's error is some 1e-5 of the force
_SLIP_STEP = 1e-6  # for the slope of the force: the steepest law bends over 1e-3
_ROUNDS = 4  # at most, of estimating the variances and the parameters in turn;
_SETTLED = 1e-6  # relative change of the parameters from round to round
_RATIOS = (math.log(1e-8), math.log(1e6))  # of the pickup's variance to the effect of the random force
_LARGEST_SLIP = 0.999
_WILDEST = 50.0  # growth of a deviation over a step, as a logarithm: what is beyond is as wrong, and a finite number
_OFF_BOUND = 1e-3  # of a coordinate's size, at which a search begins
_CONVERGED = 1e-10
_SEARCH = 300  # evaluations at most of the errors and their slopes
_ALIKE = 1e-6  # relative: searches whose sums of squares agree so ended in one place
_FOLLOWED_CELLS = 100  # over the slip ratio
_SPLINE_POINTS = 256  # over the root of the slip: its error is some 256^-4 of mu
_SPLINE_REACH = 0.005  # of slip, beyond the record's highest, to which a prediction may come


class Errors(NamedTuple):
    """Of the predictions: r and the decay A (both by interval), and by how much r moves with each run's start."""

    error: Floats
    decay: Floats
    start: Floats | None


@dataclass(frozen=True)
class Intervals:
    """Neighbouring rows of one run, an array each of one length: at the beginning (0) and the end (1).

    `speed_bend` is the second derivative of the train's speed by the interval squared, m/s.
    """

    step: Floats
    speed0: Floats
    speed1: Floats
    omega0: Floats
    omega1: Floats
    torque0: Floats
    torque1: Floats
    load: Floats
    time: Floats
    run: Integers
    speed_bend: Floats

    @classmethod
    def of(cls, record: BrakedRows) -> Intervals:
        """Of a record."""
        same = np.diff(record.run) == 0
        v0, omega0, torque0 = (x[:-1][same] for x in (record.speed, record.omega, record.torque))
        v1, omega1, torque1, time = (x[1:][same] for x in (record.speed, record.omega, record.torque, record.time))
        run = np.unique(record.run[:-1][same], return_inverse=True)[1].astype(np.int64)
        step, load = np.diff(record.time)[same], record.load[:-1][same]
        return cls(step, v0, v1, omega0, omega1, torque0, torque1, load, time, run, np.zeros_like(step))

    def __len__(self) -> int:
        return len(self.step)

    def bent(self, *, steeper: bool = False) -> Intervals:
        """With the bend of the train's speed, and torques between which a line has the mean of a parabola.

        Of the two parabolas through three rows, with the row before and with the row after, the flatter: none goes
        across a corner. The steeper does, and bounds what a corner between two rows may do.
        """
        excess = self._bend(self.torque0, self.torque1, steeper=steeper) / 12.0
        bend = self._bend(self.speed0, self.speed1, steeper=steeper)
        return replace(self, torque0=self.torque0 - excess, torque1=self.torque1 - excess, speed_bend=bend)

    def _bend(self, begin: Floats, end: Floats, *, steeper: bool) -> Floats:
        """Second derivative by the interval squared; 0 where no neighbour tells it."""
        slope = (end - begin) / self.step
        bend = np.full(len(self) + 1, np.nan)  # where two intervals meet; unknown at both ends of a run
        bend[1:-1] = 2.0 * np.diff(slope) / (self.step[1:] + self.step[:-1])
        bend[:-1][self.begins] = np.nan
        before, after = bend[:-1], bend[1:]
        size = np.abs(before) - np.abs(after)
        chosen = np.where((size > 0.0) == steeper, before, after)
        known = np.where(np.isnan(size), np.where(np.isnan(before), after, before), chosen)
        return np.nan_to_num(known) * self.step**2

    @property
    def begins(self) -> Flags:
        """The first of each run."""
        return np.asarray(np.diff(self.run, prepend=-1) != 0)


class PredictionErrors:
    """The whitened errors of a model along a record."""

    def __init__(self, model: FitModel, record: BrakedRows, vehicle: Vehicle, wheel_load: float) -> None:
        self.model, self.coordinates, self.wheel_load = model, model.coordinates, wheel_load
        self.radius, self.J = vehicle.wheel.radius, vehicle.effective_inertia
        self.B = vehicle.effective_viscous_friction
        self._straight = Intervals.of(record)
        self.intervals = self._straight.bent()
        self._factor: Floats | None = None
        self._substeps = _SUBSTEPS[1]
        self._spline: tuple[tuple[float, ...], Any] | None = None
        slip = 1.0 - self.radius * record.omega / record.speed
        self._highest_root = math.sqrt(min(float(np.max(slip, initial=0.0)) + _SPLINE_REACH, _LARGEST_SLIP))

    # --- one interval ahead -----------------------------------------------------------------------------------------

    def errors(self, values: Floats) -> Errors:
        """The predictions' errors."""
        return self._bristles(values)[0] if self.model.name in DYNAMIC else self._static_errors(values)

    def _force(self, values: Floats, sigma: Floats, v: Floats) -> Floats:
        slip = np.minimum(np.abs(sigma) / v, _LARGEST_SLIP)
        if self.model.name == "curve":  # an integral for every value, of the slip alone; a force, whatever the load
            force = self._curve(tuple(values))(np.sqrt(slip)) * self.wheel_load
        else:
            force = self.model.coefficient(values, slip, v, self.intervals.load) * self.intervals.load
        return np.asarray(np.sign(sigma) * force)

    def _curve(self, values: tuple[float, ...]) -> Any:
        """mu of a model that depends on the slip alone, as a spline over its root, kept for the last values."""
        from scipy.interpolate import CubicSpline

        if self._spline is None or self._spline[0] != values:
            root = np.linspace(0.0, self._highest_root, _SPLINE_POINTS)
            mu = self.model.coefficient(np.array(values), root**2, np.ones_like(root), self.wheel_load)
            self._spline = values, CubicSpline(root, mu)
        return self._spline[1]

    def _static_errors(self, values: Floats) -> Errors:
        """The exponential Rosenbrock method of order 2, exact for a straight characteristic, however steep, and ramps.

        In sigma, with the train's speed as it was measured: where the characteristic is steep the wheel follows the
        train at once, and omega would move far while sigma hardly does.
        """
        i = self.intervals
        h = i.step / self._substeps
        dv, dtorque = (i.speed1 - i.speed0) / self._substeps, (i.torque1 - i.torque0) / self._substeps
        bend = i.speed_bend / self._substeps**2
        v, torque, sigma, decay = i.speed0, i.torque0, i.speed0 - self.radius * i.omega0, np.ones(len(i))
        dv = dv - bend * (self._substeps - 1) / 2.0
        for _ in range(self._substeps):
            at = np.stack([sigma, sigma + _SLIP_STEP * v, sigma])  # in one call: rows are few, calls are slow
            force, steeper, later = self._force(values, at, np.stack([v, v, v + dv]))
            q = (self.radius**2 * (steeper - force) / (_SLIP_STEP * v) + self.B) / self.J * h
            q = np.maximum(q, -_WILDEST)
            turning = self.B * (v - sigma) + self.radius * torque - self.radius**2 * force
            change = self.B * dv + self.radius * dtorque - self.radius**2 * (later - force)
            decayed, mean = phi(q), mean_phi(q)
            sigma = sigma + (dv + h / self.J * turning) * decayed + h / self.J * change * mean
            sigma = sigma + bend * (mean - decayed / 2.0)
            decay = decay * np.exp(-q)
            v, torque, dv = v + dv, torque + dtorque, dv + bend
        return Errors(i.omega1 - (i.speed1 - sigma) / self.radius, decay, None)

    def followed(self, values: Floats) -> Floats:
        """mu over slip as the bristles had it in the runs, means in cells of the slip's root: (2, cells)."""
        found, sigma, mean, left = self._bristles(values)
        assert found.start is not None
        assert self._factor is not None, "set_variances comes first"
        i, run = self.intervals, self.intervals.run
        error, start = (self._whitened(x, self._factor) for x in (found.error, found.start))
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
        """The errors; sigma, the mean of z from nothing at the start, and what the mean keeps of z at the start.

        z' = sigma - alpha h sigma z with sigma the mean of both ends.
        """
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
        # mean over the interval: of what was there, and of what is added
        mean = z0 * share + i.step * sigma * mean_phi(q)
        worn = np.cumsum(q) - q
        left = np.exp(-(worn - worn[begins][i.run]))  # of the deflection at the start of the run
        gain = i.step / self.J * self.radius * alpha
        torque = (i.torque0 + i.torque1) / 2
        predicted = i.omega0 + gain * mean - i.step / self.J * (torque + self.B * omega)
        errors = Errors(i.omega1 - predicted, np.ones(len(i)), -gain * left * share)
        return errors, sigma, mean, left * share

    # --- whitening --------------------------------------------------------------------------------------------------

    def set_variances(self, values: Floats) -> None:
        """The likeliest variances for the errors at some parameters; they are whitened with them from now on.

        Of both, the ratio is looked for; the common factor follows from it.
        """
        from scipy.optimize import minimize_scalar

        found = self.errors(values)
        error, bands = self._without_start(found.error, found.start), self._covariance_bands(found.decay)

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
        """The errors' covariance, banded: of a random force of effect 1, of a pickup of variance 1; `A` the decay."""
        i = self.intervals
        # a force held for a nominal interval; over another its mean is the surer the longer
        gain = phi(-np.log(np.clip(A, 1e-12, 1e12))) * np.sqrt(i.step / np.median(i.step))
        force, pickup = np.zeros((2, len(i))), np.zeros((2, len(i)))
        force[0], pickup[0] = gain**2, 1 + A**2
        pickup[1, :-1] = np.where(i.begins[1:], 0.0, -A[1:])
        return force, pickup

    def residuals(self, values: Floats) -> Floats:
        """The whitened errors, of variance 1 each where the model is right."""
        found = self.errors(values)
        assert self._factor is not None, "set_variances comes first"
        start = None if found.start is None else self._whitened(found.start, self._factor)
        return self._without_start(self._whitened(found.error, self._factor), start)

    @staticmethod
    def _whitened(x: Floats, factor: Floats) -> Floats:
        from scipy.linalg.blas import dtbsv

        # `solve_banded` pivots, of which a triangle has no need; ValueError where x is not finite, as it has
        return np.asarray(dtbsv(1, factor, np.asarray_chkfinite(x), lower=1))

    def _without_start(self, error: Floats, start: Floats | None) -> Floats:
        """The errors with the best start of each run."""
        if start is None:
            return error
        run = self.intervals.run
        best = np.bincount(run, start * error) / np.bincount(run, start**2)
        return error - start * best[run]

    # --- the fit ----------------------------------------------------------------------------------------------------

    def solve(self, starts: Sequence[Floats]) -> tuple[Floats, Floats]:
        """The best coordinates from several starts of the parameters, and the whitened errors there."""
        if self.model.name in STATIC:
            steepest = float(np.max(-np.log(self.errors(starts[0]).decay)))
            self._substeps = _SUBSTEPS[steepest > _LITTLE]
        at, values = self.coordinates.at, self.coordinates.values
        tried = [self._search(at(start)) for start in starts]
        least = min(squares for squares, _ in tried)
        found = next(x for squares, x in tried if squares <= (1.0 + _ALIKE) * least)
        for _ in range(_ROUNDS - 1):
            before, found = found, self._search(found)[1]
            if np.all(np.abs(found - before) <= _SETTLED * self.coordinates.sizes(found)):
                break
        self.set_variances(values(found))
        return found, self.residuals(values(found))

    def likeliest(self, start: Floats) -> tuple[float, Floats, float]:
        """-2 log likelihood, but for a constant, of the best parameters from a start; these; the errors' inflation."""
        found, errors = self.solve([start])
        return self.deviance, self.coordinates.values(found), _inflation(self.intervals, errors, len(found))[0]

    @property
    def deviance(self) -> float:
        """-2 log likelihood, but for a constant, at the parameters that the variances were set at."""
        # the factor has the scale in it: as many whitened squares as there are errors
        assert self._factor is not None, "set_variances comes first"
        return 2.0 * float(np.sum(np.log(self._factor[0])))

    def _search(self, start: Floats) -> tuple[float, Floats]:
        coordinates = self.coordinates
        centre = coordinates.at(self.model.starts[0])
        self.set_variances(coordinates.values(start))
        begin = coordinates.inside(start, _OFF_BOUND)
        _, x = search(
            self.residuals, coordinates, begin, weight=PULL, centre=centre, tolerance=_CONVERGED, most=_SEARCH
        )
        return float(np.sum(self.errors(coordinates.values(x)).error ** 2)), x

    def discretisation(self, x: Floats, slopes: Floats) -> list[Floats]:
        """By how much the coordinates are shifted by what happens between the rows, cause by cause.

        The bends of torque and train speed count as if parabolas took out none of them, and once more with the steeper
        of the two parabolas in each interval, as where the brake is released between rows. The steps inside an interval
        count by Richardson's estimate, of order 2; the bristles' state is integrated exactly along the measured slip.
        """
        values, inverse = self.coordinates.values(x), np.linalg.pinv(slopes)
        here, bent = self.residuals(values), self.intervals
        shifts = []
        for other in (self._straight, self._straight.bent(steeper=True)):
            self.intervals = other
            shifts.append(inverse @ (self.residuals(values) - here))
        self.intervals = bent
        if self.model.name in STATIC:
            steps = self._substeps
            self._substeps = 2 * steps
            shifts.append(inverse @ (here - self.residuals(values)) * 4.0 / 3.0)
            self._substeps = steps
        return shifts


_ZERO = np.zeros(1)


def _covariance_factor(bands: tuple[Floats, Floats], ratio: float) -> Floats:
    """Cholesky factor, banded, of the covariance for a pickup's variance over the effect of the random force."""
    from scipy.linalg import cholesky_banded

    force, pickup = bands
    return np.asarray(cholesky_banded(force + ratio * pickup, lower=True))


# --- a fit to the cells, fitted again to the prediction errors -----------------------------------------------------


_LEAST_ROWS = 4  # between two knots of a table: a wheel that runs away leaves wide gaps between its rows
_STRETCH = 10.0  # intervals: the shortest stretch over which the errors are summed,
_STRETCHES_A_PARAMETER = 3.0  # unless that leaves fewer of them, as a variance needs some freedom
_ALPHA_FACTORS = (0.2, 1.0)  # slip that runs away lets the stiffness seem larger than it is, so the search starts below
_FAR_BELOW = 1 / 3  # of the slip that a ramp is looked at up to
_RAMP_RANGE = 2.0  # the peak is told for ramps slower and steeper by this factor


def is_followed(model: FitModel, record: BrakedRows) -> bool:
    """Whether a model has a prediction-error fit: not every one has, and none to a record of few intervals."""
    return model.name in (*STATIC, *DYNAMIC) and int(np.sum(np.diff(record.run) == 0)) >= _LEAST_INTERVALS


def prediction_error_fit(
    found: Fit, record: BrakedRows, vehicle: Vehicle, cells: Cells, setting: Setting, *, profiles: bool = True
) -> Fit:
    """A fit to the cells, fitted again to the prediction errors; as it was where `is_followed` says no.

    `profiles` as of `fits.fit`. InputError for a log whose wheel the model cannot follow.
    """
    if not is_followed(found.model, record):
        return found
    try:
        return _refitted(found, record, vehicle, cells, setting, profiles)
    except RailslipError:
        raise
    except ValueError as error:  # SciPy's and LAPACK's word for errors that are not finite
        raise InputError(told("cannot follow")) from error


def _refitted(found: Fit, record: BrakedRows, vehicle: Vehicle, cells: Cells, setting: Setting, profiles: bool) -> Fit:
    model, values = found.model, found.values
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
    noise = (found.long_run_variance, found.degrees_of_freedom)  # over the cells
    known = estimate(problem, x, slopes, variance, freedom, tests=tests, shifts=shifts, profiles=profiles)
    judged: dict[str, Any] = {"deviance": problem.deviance, "inflation": (variance, freedom)}
    if model.name == "table":
        every_second = sorted({*range(0, len(model.knots), 2), len(model.knots) - 1})
        coarser, start = model.with_knots(every_second), known.values[every_second]
        halved = PredictionErrors(coarser, record, vehicle, setting.wheel_load).likeliest(start)[1]
        judged["coarse"] = spline(coarser.knots, halved)(model.knots)
    if model.name in STATIC:
        return replace(fit_of(model, known, cells, setting, noise), **judged)
    model, spread = _with_ramp(model, known.values, setting)
    again = fit_of(model, known, cells, setting, noise, problem.followed(known.values))
    return replace(again, known_stderrs={} if spread is None else {"R": spread}, **judged)


def _knots_with_rows(knots: Floats, slip: Floats) -> list[int]:
    """The knots of a table between which a record has rows enough, the last one among them."""
    kept = [0]
    for i in range(1, len(knots)):
        if np.count_nonzero((slip > knots[kept[-1]]) & (slip <= knots[i])) >= _LEAST_ROWS:
            kept.append(i)
    return [*kept[:-1], len(knots) - 1]


def _inflation(intervals: Intervals, errors: Floats, parameters: int) -> tuple[float, int]:
    """Long-run variance of the whitened errors, 1 or more where they are not as white as they should be."""
    rows = min(_STRETCH, len(errors) / (_STRETCHES_A_PARAMETER * parameters))
    length = max(rows, 1.0) * float(np.median(intervals.step))
    stretch = ((intervals.time - intervals.time[0]) / length).astype(np.int64)
    none = np.zeros(len(errors), dtype=np.int64)
    sums = Stretches(length, stretch, none, np.ones(len(errors)), errors)
    return long_run_variance(np.zeros(1), np.ones(1, dtype=bool), sums, parameters, 0.0)


def slip_ramp(record: BrakedRows, radius: float, top: float, initial_speed: float) -> tuple[float, float | None]:
    """Mean slip acceleration R, m/s^2, on the way up to a slip ratio, and its standard deviation from test to test.

    Of the tests that come to it from below, each until it does, by their time; of all, as far as they go, where none
    does. Tests that begin far below go before those that are cut off there, as slip rises the faster the nearer the
    peak. 0 for an empty record; no deviation where fewer than two tests come there.
    """
    slip = 1.0 - radius * record.omega / record.speed
    test = whole_tests(record.time, np.zeros(len(record)), record.run.astype(np.int64))
    cuts = np.flatnonzero(np.diff(test)) + 1
    ways = []
    for time, of_test in zip(np.split(record.time, cuts), np.split(slip, cuts), strict=True):
        if len(time) > 1 and of_test[0] < top:
            up = of_test >= top
            end = int(np.argmax(up)) if up.any() else -1
            gain = initial_speed * (of_test[end] - of_test[0])
            ways.append((time[end] - time[0], gain, float(up.any()), float(of_test[0] < _FAR_BELOW * top)))
    if not ways:
        return 0.0, None
    duration, gain, arrived, whole = np.array(ways).T
    kept = arrived > 0.0 if arrived.any() else np.ones(len(ways), dtype=bool)
    kept = kept & (whole > 0.0) if (kept & (whole > 0.0)).any() else kept
    duration, gain = duration[kept], gain[kept]
    mean = float(gain.sum() / duration.sum())
    if not arrived.any() or len(duration) < 2:
        return mean, None
    scatter = np.sum(duration * (gain / duration - mean) ** 2) / duration.sum() * len(duration) / (len(duration) - 1)
    return mean, float(np.sqrt(scatter))


def _with_ramp(model: FitModel, values: Floats, setting: Setting) -> tuple[FitModel, float | None]:
    """The model with the ramp whose build-up its peak is of, said in its note; and the ramp's scatter, if shown."""
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
    counted = told("no scatter") if spread is None else told("scatter", spread=spread)
    note = told("ramp of the peak", R=R, source=source, slip=slip, low=low, high=high, counted=counted)
    return replace(chosen, notes=(note,)), spread
