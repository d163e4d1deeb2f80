"""Fit models by least squares to the mean mu in cells of slip and speed; compute the parameters' uncertainty.

`search` and `estimate` also serve prediction-error fits (`prediction`).
"""

from __future__ import annotations

import math
from bisect import bisect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.arguments import Flags, Floats, Integers
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.model.adhesion import AdhesionLaw

from .curves import Cells, Stretches
from .messages import message
from .models import SLIDING_ALONE, Coordinates, FitModel, Setting

# --- the search ----------------------------------------------------------------------------------------------------

# Along a direction in which the residuals do not change, rounding would decide where a search ends. Tikhonov
# regularisation avoids this: each coordinate's scaled distance from a centre is added to the residuals.

Residuals = Callable[[Floats], Floats]

REGULARISATION = 0.1  #: weight of the regularisation, in standard deviations of the noise

_STEP = 1e-4  # difference step, in sizes of a coordinate: rounding and truncation errors are then both about 1e-8


def search(
    residuals: Residuals,
    coordinates: Coordinates,
    begin: Floats,
    *,
    weight: float,
    centre: Floats | None = None,
    tolerance: float,
    most: int,
) -> tuple[float, Floats]:
    """Minimise the sum of squared residuals within the bounds; return (least sum, coordinates of the minimum).

    `residuals` is a function of the parameter values. The search begins at the coordinates `begin` and ends when the
    relative change of the sum is below `tolerance`, or after `most` evaluations. A regularisation pulls the coordinates
    towards `centre`, by default `begin`, with a `weight` in the unit of the residuals. The returned sum does not
    include the regularisation.
    """
    from scipy.optimize import least_squares

    size, centre = coordinates.sizes(begin), begin if centre is None else centre
    penalty = weight / np.maximum(np.abs(centre), np.abs(coordinates.at(coordinates.typical)))

    def penalised(y: Floats) -> Floats:
        x = y * size
        return np.concatenate([residuals(coordinates.values(x)), penalty * (x - centre)])

    def slopes(y: Floats) -> Floats:
        x = y * size
        jacobian = differences(residuals, coordinates, x, _STEP * coordinates.sizes(x))
        return np.concatenate([jacobian, np.diag(penalty)]) * size

    solution = least_squares(
        penalised,
        begin / size,
        jac=slopes,
        bounds=(coordinates.lower / size, coordinates.upper / size),
        x_scale="jac",
        method="dogbox",  # reaches a bound exactly; SciPy's "trf" only approaches it
        ftol=tolerance,
        xtol=tolerance,
        gtol=tolerance,
        max_nfev=most,
    )
    x = solution.x * size
    return 2.0 * float(solution.cost) - float(np.sum((penalty * (x - centre)) ** 2)), x


def differences(
    residuals: Residuals, coordinates: Coordinates, x: Floats, steps: Floats, indices: Iterable[int] | None = None
) -> Floats:
    """Jacobian of the residuals, (residuals, coordinates), by central differences that stay within the bounds.

    `steps` are the half widths of the differences. `indices` selects the coordinates; None: all.
    """
    columns = []
    for i in range(len(x)) if indices is None else indices:
        high, low = x.copy(), x.copy()
        high[i], low[i] = min(x[i] + steps[i], coordinates.upper[i]), max(x[i] - steps[i], coordinates.lower[i])
        difference = residuals(coordinates.values(high)) - residuals(coordinates.values(low))
        columns.append(difference / (high[i] - low[i]))
    return np.stack(columns, axis=1)


# --- clustered covariance ------------------------------------------------------------------------------------------

# Rail, weather and temperature shift all rows of a test alike. If the tests disagree, the covariance is therefore that
# of the delete-one-test jackknife (CV3 of [MacKinnon2023]), with Student's distribution of (tests - 1) degrees of
# freedom. The jackknife is valid for any correlation within a test.

LEAST_TESTS = 5  #: tests needed for the jackknife; with fewer, Student's quantile is too large to be useful

_LARGEST_SHARE = 0.99  # a test with a larger share of the information in some direction cannot be left out
_DISAGREE = 0.01  # tests disagree if the noise within tests explains their differences with a lower probability
_TEST_GAP = 0.5  # in lengths of the longest run: runs separated by a smaller gap belong to one test
_LEAST_INFORMATION = 1e-8  # share of the information below which a test does not determine a direction


def whole_tests(time: Floats, step: Floats, run: Integers) -> Integers:
    """Return the number, from 0, of the test to which each interval between rows belongs; arrays of equal length.

    An interval ends at `time`, s, has the length `step`, s, and belongs to the run with the number `run`. If the pause
    between two runs, for example a short release of the brake, is shorter than half the longest run, they belong to
    the same test.
    """
    first = np.flatnonzero(np.diff(run, prepend=-1))
    if not len(first):
        return np.zeros(0, dtype=np.int64)
    begin, end = time[first] - step[first], time[np.append(first[1:], len(time)) - 1]
    apart = begin[1:] - end[:-1] > _TEST_GAP * float(np.max(end - begin))
    test = np.concatenate([[0], np.cumsum(apart)]).astype(np.int64)
    return np.repeat(test, np.diff(np.append(first, len(time))))


def clustered_covariance(slopes: Floats, residuals: Floats, test: Integers) -> tuple[Floats, int] | None:
    """Covariance of p parameters, (p, p), by a jackknife over the tests, and degrees of freedom.

    The `residuals` at the least-squares solution have variance 1. `slopes` is their Jacobian, (residuals, p), of full
    rank. `test` has, for each residual, the number of its test, from 0. Returns None if noise explains the differences
    between the tests, if there are too few tests, or if a single test has nearly all information on some combination
    of parameters.
    """
    tests, size = int(test.max(initial=-1)) + 1, slopes.shape[1]
    if tests < max(LEAST_TESTS, size + 2):
        return None
    basis, triangle = np.linalg.qr(slopes)
    known = np.array([basis[test == i].T @ basis[test == i] for i in range(tests)])  # these sum to the identity
    gradient = np.array([basis[test == i].T @ residuals[test == i] for i in range(tests)])
    if not _disagree(known, gradient) or float(np.linalg.eigvalsh(known).max()) > _LARGEST_SHARE:
        return None
    # estimates with one test left out, by one Gauss-Newton step
    without = -np.linalg.solve(np.eye(size) - known, gradient[:, :, None])[:, :, 0]
    without = np.linalg.solve(triangle, (without - without.mean(axis=0)).T)
    return (tests - 1) / tests * (without @ without.T), tests - 1


def _disagree(known: Floats, gradient: Floats) -> bool:
    from scipy.stats import chi2

    information, directions = np.linalg.eigh(known)
    determined = information > _LEAST_INFORMATION
    along = np.einsum("tji,tj->ti", directions, gradient)
    lowered = float(np.sum(along[determined] ** 2 / information[determined]))
    freedom = int(determined.sum()) - gradient.shape[1]
    return freedom > 0 and float(chi2.sf(lowered, freedom)) < _DISAGREE


# --- intervals from the profile of the likelihood ------------------------------------------------------------------

# An interval ends where the profiled sum of squares has risen by the amount that gives the symmetric interval if the
# model is nearly linear in the parameter: the vertical adjustment of [ChandlerBate2007].

_REACH = 2.6  # first trial distance from the best value, in standard errors; 1 size of the parameter if that is less
_TRIAL_FACTOR = 1.6  # factor on the distance from trial to trial
_TRIALS = 12  # most trials; they reach 280 sizes, beyond which the searches are not reliable
_FINE = 0.02  # tolerance of an interval's end, in standard errors
_OFF_BOUND = 1e-3  # distance from a bound at which a search begins, in sizes of the coordinate
_PROFILE_CONVERGED = 1e-6  # relative tolerance of the sum of squares
_PROFILE_SEARCH = 60  # most evaluations of the residuals and their Jacobian
_SLOPE_STEP = 1e-3  # difference step, in standard errors, or relative to the value if that is less
_TOLERATED = 0.125  # accepted relative error of a symmetric interval's half width; twice this for the sum of squares


def is_symmetric(
    residuals: Residuals, coordinates: Coordinates, x: Floats, end: Floats, index: int, half: float, rise: float
) -> bool:
    """True if the symmetric interval of the parameter `index` is valid; both its ends are checked.

    The coordinates at the ends are x - `end` and x + `end`, where `x` are the best coordinates. There the parameter
    must differ from its best value by about `half`, and the sum of squares from its least value by about `rise`. No
    coordinate may be on or beyond a bound.
    """
    value = float(coordinates.values(x)[index])
    least = float(np.sum(residuals(coordinates.values(x)) ** 2))
    for side in (-1.0, 1.0):
        shifted = x + side * end
        if np.any(shifted <= coordinates.lower) or np.any(shifted >= coordinates.upper):
            return False
        values = coordinates.values(shifted)
        if not abs(abs(values[index] - value) - half) <= _TOLERATED * half:
            return False
        if not abs(float(np.sum(residuals(values) ** 2)) - least - rise) <= 2.0 * _TOLERATED * rise:
            return False
    return True


def profile_interval(
    residuals: Residuals,
    coordinates: Coordinates,
    values: Floats,
    index: int,
    *,
    stderr: float,
    rise: float,
    beside: float = 0.0,
) -> tuple[float, float]:
    """Profile-likelihood interval of the parameter `index`: at its ends the sum of squares has risen by `rise`.

    For each value of this parameter all other parameters are fitted again. If the sum has risen by less than `rise` at
    the bound of the parameter, the interval ends at the bound. `values` are the best values of all parameters. `stderr`
    is the standard error of the parameter. `beside` is the half width due to an independent error; it is added in
    quadrature.
    """
    inverse, value = coordinates.by_inverse(index), float(values[index])
    best, unit = coordinates.represented(index, value), value**-2 if inverse else 1.0
    bounds = coordinates.range_of(index, coordinates.at(values))
    least, most = float(coordinates.least[index]), float(coordinates.most[index])
    profile = _Profile(residuals, coordinates, values, index, rise)
    narrowest = unit * profile.unprofiled(stderr)
    limits = []
    ends = [profile.end(side, bound, stderr * unit) for side, bound in zip((-1.0, 1.0), bounds, strict=True)]
    for side, end, bound in zip((-1.0, 1.0), ends, bounds, strict=True):
        outer = best + side * math.hypot(max(abs(best - end), narrowest), beside * unit)
        if end == bound or side * outer >= side * bound:
            limits.append(least if (side < 0.0) != inverse else most)
        else:
            limits.append(coordinates.represented(index, outer))
    return min(limits), max(limits)


class _Profile:
    """Least sum of squares as a function of one parameter, or of 1/parameter where `Coordinates` uses the inverse."""

    def __init__(self, residuals: Residuals, coordinates: Coordinates, values: Floats, index: int, rise: float) -> None:
        self._residuals, self._coordinates, self._values = residuals, coordinates, values
        self._index, self._rise = index, rise
        self._best, usual = (coordinates.represented(index, float(x[index])) for x in (values, coordinates.typical))
        self._size = max(abs(self._best), abs(usual))
        self._least = float(np.sum(residuals(values) ** 2))
        self._excesses, self._solutions = {self._best: -rise}, {self._best: coordinates.at(values)}

    def unprofiled(self, stderr: float) -> float:
        """Half width of the interval if all other parameters stay fixed; 0 if the sum does not rise."""
        value, step = float(self._values[self._index]), np.zeros_like(self._values)
        step[self._index] = _SLOPE_STEP * min(stderr, abs(value) or stderr)
        here = self._residuals(self._values)
        slope = (self._residuals(self._values + step) - here) / step[self._index]
        steepness, gradient = float(slope @ slope), abs(float(slope @ here))  # the gradient is not 0 on a bound
        if not (steepness > 0.0 and math.isfinite(steepness)):
            return 0.0
        return self._rise / (gradient + math.sqrt(gradient**2 + steepness * self._rise))

    def end(self, side: float, bound: float, stderr: float) -> float:
        from scipy.optimize import brentq

        best = inside = self._best
        distance = min(_REACH * stderr, self._size)
        for _ in range(_TRIALS):
            outside = max(best - distance, bound) if side < 0 else min(best + distance, bound)
            if self._excess(outside) > 0.0:
                return float(brentq(self._excess, inside, outside, xtol=_FINE * stderr))
            if outside == bound:
                break
            inside, distance = outside, _TRIAL_FACTOR * distance
        return bound

    def _excess(self, x: float) -> float:
        excesses, coordinates = self._excesses, self._coordinates
        if x in excesses:  # a repeated search could end a little lower and change the sign
            return excesses[x]
        guess = coordinates.values(np.clip(self._guess_at(x), coordinates.lower, coordinates.upper))
        for start in (guess, coordinates.typical):  # the first start may lead to a local minimum
            squares, values = self._minimised(start, coordinates.represented(self._index, x))
            if not excesses.get(x, math.inf) <= squares - self._least - self._rise:
                excesses[x], self._solutions[x] = squares - self._least - self._rise, coordinates.at(values)
            if excesses[x] <= 0.0:
                break
        return excesses[x]

    def _guess_at(self, x: float) -> Floats:
        profiled = sorted(self._solutions)
        if len(profiled) == 1:
            return self._solutions[profiled[0]]
        i = min(max(bisect(profiled, x), 1), len(profiled) - 1)
        low, high = profiled[i - 1], profiled[i]
        share = (x - low) / (high - low)
        return (1.0 - share) * self._solutions[low] + share * self._solutions[high]

    def _minimised(self, start: Floats, value: float) -> tuple[float, Floats]:
        at = self._coordinates.moved(start, self._index, value)
        others = np.arange(len(at)) != self._index
        if not others.any():
            return float(np.sum(self._residuals(at) ** 2)), at
        rest = self._coordinates.without(self._index)
        begin = rest.inside(rest.at(at[others]), _OFF_BOUND)

        def of_others(values: Floats) -> Floats:
            trial = at.copy()
            trial[others] = values
            return self._residuals(trial)

        weight = REGULARISATION * math.sqrt(self._rise) / _REACH
        squares, x = search(of_others, rest, begin, weight=weight, tolerance=_PROFILE_CONVERGED, most=_PROFILE_SEARCH)
        at[others] = rest.values(x)
        return squares, at


# --- estimates and their uncertainty -------------------------------------------------------------------------------

CONFIDENCE = 0.99  #: confidence level of the parameters' intervals

NORMAL_QUANTILE = 2.5758293035489004  #: half width of a normal 99 % interval in standard errors

# Singular value of the scaled Jacobian, relative to the largest one, below which a direction is not identifiable.
# Rounding errors cause relative singular values of about 1e-10.
SINGULAR = 1e-6

_DIFFERENCE = 1e-5  # difference step, in sizes of a coordinate
_AT_BOUND = 1e-6  # in sizes of a coordinate: a search may end this far inside a bound
_NEAR_BOUND = 0.1  # in standard errors: a coordinate nearer to its bound is assumed to be on it
_LARGEST_DISTANCE = 0.05  # of the typical value: limit of the distance `_NEAR_BOUND`, as a standard error may be huge


class Problem(Protocol):
    """Least-squares problem: residuals as a function of the parameter values, and search coordinates."""

    coordinates: Coordinates

    def residuals(self, values: Floats) -> Floats: ...


@dataclass(frozen=True)
class ParameterEstimate:
    """Estimates of p free parameters with their uncertainty; arrays with an entry for each parameter."""

    values: Floats
    covariance: Floats  # (p, p); NaN for parameters that are not identifiable
    coordinates: Coordinates
    coordinate_covariance: Floats  # in the search coordinates, in which the model is nearly linear
    active: NDArray[np.int_]  # bound on which the parameter rests: -1 lower, 1 upper, 0 none
    unidentified: Flags  # true if the parameter is not identifiable
    limits: Mapping[int, tuple[float, float]]  # profile-likelihood intervals, by index


def estimate(
    problem: Problem,
    x: Floats,
    slopes: Floats,
    variance: float,
    freedom: int,
    *,
    tests: Integers | None = None,
    shifts: Sequence[Floats] = (),
    profiles: bool = True,
) -> ParameterEstimate:
    """Estimate the uncertainty of a fit at its best coordinates x.

    - slopes: Jacobian of the residuals at x.
    - variance, freedom: long-run variance of the residuals, and its degrees of freedom.
    - tests: number of the test to which each residual belongs; the residuals must then have variance 1. If the tests
      disagree and the model is nearly linear, the covariance comes from the differences between the tests.
    - shifts: errors of the coordinates due to the numerical method, added to their standard errors in quadrature.
    - profiles: if false, every interval is symmetric.
    """
    coordinates = problem.coordinates
    free = ~unidentified(slopes * coordinates.sizes(x))  # identifiable coordinates
    unit = covariance_of(slopes, free)
    own = unit * variance * _student_ratio(freedom) ** 2 if math.isfinite(variance) else np.full_like(unit, np.nan)
    jacobian = coordinates.slopes(x)
    unknown = (jacobian[:, ~free] != 0.0).any(axis=1)  # parameters that are not identifiable
    identified = np.where(unknown[:, None], np.nan, jacobian)
    bias = np.array([jacobian @ np.where(free, shift, 0.0) for shift in shifts]).reshape(-1, len(x))
    beside = NORMAL_QUANTILE * np.sqrt(np.sum(bias**2, axis=0))
    limits = {}
    if profiles and math.isfinite(variance):
        limits = _profiles(problem, x, identified, unit, own, beside)
    # the jackknife takes one linear step, so it is not used if the model is nonlinear within the interval
    clustered = None
    if tests is not None and not limits:
        clustered = clustered_covariance(slopes[:, free], problem.residuals(coordinates.values(x)), tests)
    if clustered is not None:
        own[np.ix_(free, free)] = clustered[0] * _student_ratio(clustered[1]) ** 2
        limits = _profiles(problem, x, identified, unit, own, beside) if profiles else {}
    active = _bounds_at(x, coordinates, own)
    for shift in shifts:
        own = own + np.outer(shift, shift)
    return ParameterEstimate(
        values=coordinates.values(x),
        covariance=_transformed(own, jacobian, unknown, free),
        coordinates=coordinates,
        coordinate_covariance=own,
        active=_of_values(active, coordinates),
        unidentified=unknown,
        limits=limits,
    )


def _student_ratio(freedom: int) -> float:
    from scipy.stats import t as student

    return float(student.ppf(0.5 + CONFIDENCE / 2.0, freedom)) / NORMAL_QUANTILE


def _transformed(own: Floats, jacobian: Floats, unknown: Flags, free: Flags) -> Floats:
    result: Floats = jacobian[:, free] @ own[np.ix_(free, free)] @ jacobian[:, free].T
    result[unknown] = np.nan
    result[:, unknown] = np.nan
    return result


def _profiles(
    problem: Problem, x: Floats, jacobian: Floats, unit: Floats, own: Floats, beside: Floats
) -> dict[int, tuple[float, float]]:
    """Profile-likelihood intervals of the parameters whose symmetric interval is not valid; the keys are their indices.

    `unit` is the covariance of the coordinates for residuals of variance 1. `own` is the estimated covariance of the
    coordinates. `beside` has, for each parameter, the half width due to errors of the numerical method.
    """
    coordinates, residuals, intervals = problem.coordinates, problem.residuals, {}
    own, unit = np.nan_to_num(own), np.nan_to_num(unit)
    for i in (int(each) for each in np.flatnonzero(np.isfinite(jacobian).all(axis=1))):
        stderr, scale = math.sqrt(jacobian[i] @ own @ jacobian[i]), float(jacobian[i] @ unit @ jacobian[i])
        if stderr == 0.0:
            continue
        half = NORMAL_QUANTILE * stderr
        end, rise = half / scale * (unit @ jacobian[i]), half**2 / scale
        if not is_symmetric(residuals, coordinates, x, end, i, half, rise):
            values, bias = coordinates.values(x), float(beside[i])
            intervals[i] = profile_interval(residuals, coordinates, values, i, stderr=stderr, rise=rise, beside=bias)
    return intervals


def _bounds_at(x: Floats, coordinates: Coordinates, covariance: Floats) -> NDArray[np.int_]:
    near = np.nan_to_num(_NEAR_BOUND * np.sqrt(np.diag(covariance)))
    next_to = _LARGEST_DISTANCE * np.abs(coordinates.at(coordinates.typical))
    distance = np.maximum(_AT_BOUND * coordinates.sizes(x), np.minimum(near, next_to))
    return np.where(x - coordinates.lower <= distance, -1, np.where(coordinates.upper - x <= distance, 1, 0))


def _of_values(active: NDArray[np.int_], coordinates: Coordinates) -> NDArray[np.int_]:
    result = active.copy()
    if coordinates.pair is not None:
        b, g = coordinates.pair
        result[g] = -active[g]
        result[b] = 1 if active[g] < 0 and not np.isfinite(coordinates.most[g]) else 0
    elif coordinates.inverse is not None:
        result[coordinates.inverse] = -active[coordinates.inverse]
    return result


def slopes_of(problem: Problem, x: Floats) -> Floats:
    """Compute the Jacobian of a problem's residuals with respect to the coordinates, at the coordinates `x`."""
    return differences(problem.residuals, problem.coordinates, x, _DIFFERENCE * problem.coordinates.sizes(x))


def unidentified(scaled: Floats) -> Flags:
    """True for each coordinate that can change, alone or with others, without a change of the residuals.

    `scaled` is the Jacobian of the residuals with respect to the coordinates, each divided by its size.
    """
    if not scaled.size:
        return np.zeros(scaled.shape[1], dtype=bool)
    _, singular, directions = np.linalg.svd(scaled, full_matrices=False)
    flat = singular <= SINGULAR * singular[0]
    return np.asarray((np.abs(directions[flat]) > 1e-3).any(axis=0))


def covariance_of(slopes: Floats, free: Flags) -> Floats:
    """Covariance of the coordinates for residuals of variance 1; NaN for coordinates that are not `free`."""
    size = slopes.shape[1]
    covariance = np.full((size, size), np.nan)
    if free.any():
        _, triangle = np.linalg.qr(slopes[:, free])
        root = np.linalg.inv(triangle)
        covariance[np.ix_(free, free)] = root @ root.T
    return covariance


# --- fits to the cells ---------------------------------------------------------------------------------------------

_LEAST_FREEDOM = 5  # with fewer degrees of freedom the variance from longer stretches is too uncertain to be used

_CONVERGED = 1e-14  # relative tolerance of the sum of squares
_SEARCH = 300  # most evaluations of the residuals and their Jacobian
_STATUS = {-1: "at lower bound", 0: "fitted", 1: "at upper bound"}
_NEGLIGIBLE = 1e-9  # of the value: a smaller lower limit is not a constraint
_SAME_MINIMUM = 1e-9  # relative difference of the sums of squares of two searches that reached the same minimum
_INSIDE = 1e-6  # distance from the bounds at which a search begins, in sizes of the coordinate


@dataclass(frozen=True)
class Parameter:
    """A fitted parameter with its uncertainty, SI."""

    name: str
    value: float
    stderr: float  # half width of the symmetric 99 % interval over 2.576; NaN on a bound or if not identifiable
    status: str  # "fitted", "at lower bound", "at upper bound" or "not identifiable"
    limits: tuple[float, float] | None = None  # ends of the 99 % interval if it is not symmetric

    @property
    def interval(self) -> tuple[float, float]:
        if self.limits is not None:
            return self.limits
        half = NORMAL_QUANTILE * self.stderr
        return self.value - half, self.value + half

    @property
    def is_open(self) -> bool:
        return self.status == "fitted" and math.isinf(self.interval[1])

    @property
    def is_unconstrained(self) -> bool:
        """True if the log does not determine the parameter at all."""
        return self.is_open and self.interval[0] < _NEGLIGIBLE * self.value

    @property
    def remark(self) -> str:
        """Text if the parameter is at a bound or its interval has no upper end; else empty."""
        low, high = self.interval
        if self.is_unconstrained:
            return f"{self.name}: this log does not determine it"
        if self.is_open:
            return f"{self.name}: at least {low:.4g} by this log (99 %), without an upper limit"
        if "bound" not in self.status:
            return ""
        end = f"at most {high:.4g}" if "lower" in self.status else f"at least {low:.4g}"
        text = f"{self.name}: rests {self.status.replace('at', 'on its', 1)}"
        return text if self.limits is None else f"{text}; {end} by this log (99 %)"


@dataclass(frozen=True)
class Fit:
    """A fitted model."""

    model: FitModel
    law: AdhesionLaw  # with the fitted parameters
    parameters: tuple[Parameter, ...]
    estimate: ParameterEstimate
    residual_squares: float  # sum of the squared deviations of all samples of mu from the model
    cell_coefficients: Floats  # mean mu of the model in each cell of slip and speed
    long_run_variance: float  # of the residuals; NaN if it cannot be estimated
    degrees_of_freedom: int
    notes: tuple[str, ...]
    followed: Floats | None = None  # slip ratio and mu of a dynamic model along the motion, (2, k)
    known_stderrs: Mapping[str, float] = field(default_factory=dict)  # of parameters that were not fitted
    with_profiles: bool = True  # true if profile-likelihood intervals were computed where needed
    deviance: float = math.nan  # -2 log likelihood of the motion; NaN without a prediction-error fit
    inflation: tuple[float, int] = (math.nan, 0)  # long-run variance of the whitened errors, degrees of freedom
    coarse: Floats | None = None  # mu of a table at its knots, fitted with every second knot

    @property
    def values(self) -> Floats:
        return np.array([p.value for p in self.parameters])

    @property
    def covariance(self) -> Floats:
        return self.estimate.covariance

    @property
    def correlation(self) -> Floats:
        deviation = np.sqrt(np.diag(self.covariance))
        return np.asarray(self.covariance / np.outer(deviation, deviation))


def fit(
    model: FitModel,
    cells: Cells,
    stretches: Stretches,
    setting: Setting,
    sliding_from: float,
    tau: float,
    *,
    profiles: bool = True,
) -> Fit:
    """Fit a model to the cells: minimise the sum of (mu - mu of the model)^2 over all samples, within the bounds.

    The models in `SLIDING_ALONE` are fitted only to cells with slip ratios of at least `sliding_from`. `tau` is the
    observer's time constant, s. Without `profiles` every confidence interval of a parameter is symmetric. InputError if
    there are not more cells than parameters.
    """
    used = cells.slip >= sliding_from if model.name in SLIDING_ALONE else np.ones(len(cells.slip), dtype=bool)
    if used.sum() <= len(model.names):
        raise InputError(message("too few slips", slips=used.sum(), parameters=len(model.names), model=model.name))
    problem = _Problem(model, cells, used)
    x = problem.solve()
    mean, _ = in_cells(model, problem.coordinates.values(x), cells)
    noise = long_run_variance(mean, used, stretches, len(x), tau)
    known = estimate(problem, x, slopes_of(problem, x), *noise, profiles=profiles)
    return fit_of(model, known, cells, setting, noise)


def fit_of(
    model: FitModel,
    known: ParameterEstimate,
    cells: Cells,
    setting: Setting,
    noise: tuple[float, int],
    followed: Floats | None = None,
) -> Fit:
    """Build a `Fit` from the estimates `known`; `noise`: long-run variance and its degrees of freedom."""
    mean, spread = in_cells(model, known.values, cells)
    if followed is not None:
        mean = np.interp(cells.slip, *followed)
    # the model's own variation within a cell is not a residual
    inside = np.maximum(cells.squares - cells.count * spread, 0.0)
    stderrs = np.where(known.active == 0, np.sqrt(np.diag(known.covariance)), np.nan)
    parameters = []
    for i, name in enumerate(model.names):
        value, stderr, bounds = (
            float(known.values[i]),
            float(stderrs[i]),
            (float(model.lower[i]), float(model.upper[i])),
        )
        low, high = value - NORMAL_QUANTILE * stderr, value + NORMAL_QUANTILE * stderr
        cut_off = (max(low, bounds[0]), min(high, bounds[1])) if low < bounds[0] or high > bounds[1] else None
        status = "not identifiable" if known.unidentified[i] else _STATUS[int(known.active[i])]
        parameters.append(Parameter(name, value, stderr, status, known.limits.get(i) or cut_off))
    return Fit(
        model=model,
        law=model.make(known.values, setting.rail),
        parameters=tuple(parameters),
        estimate=known,
        residual_squares=float(np.sum(inside + cells.count * (cells.mu - mean) ** 2)),
        cell_coefficients=mean,
        long_run_variance=noise[0],
        degrees_of_freedom=noise[1],
        notes=(*model.notes, *_remarks(parameters, noise[0])),
        followed=followed,
    )


def in_cells(model: FitModel, values: Floats, cells: Cells) -> tuple[Floats, Floats]:
    """Mean and variance of the model's mu within each cell."""
    mu = model.coefficient(values, cells.nodes, cells.node_speeds, cells.load)
    mean: Floats = np.sum(cells.weights * mu, axis=0)
    return mean, np.sum(cells.weights * (mu - mean) ** 2, axis=0)


class _Problem:
    def __init__(self, model: FitModel, cells: Cells, used: Flags) -> None:
        self.model, self.cells, self.used = model, cells, used
        self.coordinates = model.coordinates
        self.root = np.sqrt(cells.count[used])

    def residuals(self, values: Floats) -> Floats:
        c, at = self.cells, self.used
        mu = self.model.coefficient(values, c.nodes[:, at], c.node_speeds[:, at], c.load[at])
        return np.asarray(self.root * (np.sum(c.weights[:, at] * mu, axis=0) - c.mu[at]))

    def solve(self) -> Floats:
        coordinates, solutions = self.coordinates, []
        weight = SINGULAR * float(np.linalg.norm(self.root * self.cells.mu[self.used]))
        starts = [coordinates.at(start) for start in self.model.starts]
        for start in starts:
            begin = coordinates.inside(start, _INSIDE)
            end = search(
                self.residuals, coordinates, begin, weight=weight, centre=starts[0], tolerance=_CONVERGED, most=_SEARCH
            )
            solutions.append(end)
            least = min(squares for squares, _ in solutions)
            equal = [x for squares, x in solutions if squares <= (1.0 + _SAME_MINIMUM) * least]
            if len(equal) > 1:  # a third search is not needed
                break
        return equal[0]


def long_run_variance(
    mean: Floats, used: Flags, stretches: Stretches, parameters: int, tau: float
) -> tuple[float, int]:
    """Long-run variance of the residuals (n times the variance of the mean of n samples), and its degrees of freedom.

    The data are divided into stretches of time. The variance is computed for several lengths of the stretches, because
    short ones do not show the scatter from run to run. The largest variance with enough degrees of freedom is returned.
    `mean` is the model's mean mu in each cell of slip and speed. `used` is True for the cells that were fitted.
    `parameters` is the number of fitted parameters, and `tau` the observer's time constant, s (0: no observer).
    """
    entry = used[stretches.cell]
    stretch, length = stretches.stretch[entry], stretches.length
    deviation = stretches.total[entry] - stretches.count[entry] * mean[stretches.cell[entry]]
    count = stretches.count[entry].sum()
    best = (math.nan, 0)
    while True:
        _, index = np.unique(stretch, return_inverse=True)
        sums = np.bincount(index, deviation)
        freedom = len(sums) - parameters
        if freedom < 1 or (freedom < _LEAST_FREEDOM and best[1]):
            return best
        share = 1.0 - tau / length * -math.expm1(-length / tau) if tau > 0.0 else 1.0
        variance = float(np.sum(sums**2)) / count * len(sums) / freedom / share
        if not variance <= best[0]:
            best = variance, freedom
        stretch, length = stretch // 2, 2.0 * length
        if len(sums) < 2:
            return best


def _remarks(parameters: Sequence[Parameter], variance: float) -> tuple[str, ...]:
    remarks = []
    free = [p.name for p in parameters if p.status == "not identifiable"]
    if free:
        change = "it changes" if len(free) == 1 else "they change together"
        remarks.append(message("not identifiable", names=", ".join(free), change=change))
    remarks += [p.remark for p in sorted(parameters, key=lambda p: p.is_open) if p.remark]
    loose = [p.name for p in parameters if p.stderr > abs(p.value) and not p.is_open]
    if loose:
        remarks.append(f"{', '.join(loose)}: hardly identified, standard error larger than the value")
    if math.isnan(variance) and all(math.isnan(p.stderr) for p in parameters):
        remarks.append("the log is too short to compute standard errors")
    return tuple(remarks)
