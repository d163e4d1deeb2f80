"""Least squares over all samples by way of their cells, and what is then known of the parameters.

One way for fits to the cells and for prediction-error fits (`prediction`): `search` finds the least, with one answer
whatever the data; `estimate` takes the covariance from the slopes of the residuals and their long-run variance, or from
what differs between tests, and an interval from the profile of the likelihood wherever the symmetric one does not hold.
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
from .models import SLIDING_ALONE, Coordinates, FitModel, Setting
from .words import told

# --- the search ----------------------------------------------------------------------------------------------------

# Without more, a search runs along a direction in which the residuals do not change for as long as rounding lets it:
# the processor decides which numbers come out. Tikhonov's remedy: to the residuals is added, for every coordinate, its
# distance from a centre in sizes, with a weight so small beside the noise that it moves nothing which the data tell.


Residuals = Callable[[Floats], Floats]

PULL = 0.1
"""Weight in standard deviations of the noise: the centre counts as known to ten sizes of a coordinate.

An estimate with a standard error of one size, three sizes away, is moved by 3 % of that error.
"""

_STEP = 1e-4  # of a coordinate's size, for differences: rounding and the third derivative both leave some 1e-8


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
    """The sum of squares and the coordinates where it is least, within their bounds, looked for from `begin`.

    `residuals` are of the values; `weight` is `PULL` in their unit; the `centre` is where the search begins unless it
    is given. It ends when the sum would change by less than `tolerance` of it, or after `most` evaluations.
    """
    from scipy.optimize import least_squares

    size, centre = coordinates.sizes(begin), begin if centre is None else centre
    pull = weight / np.maximum(np.abs(centre), np.abs(coordinates.at(coordinates.typical)))

    def pulled(y: Floats) -> Floats:
        x = y * size
        return np.concatenate([residuals(coordinates.values(x)), pull * (x - centre)])

    def slopes(y: Floats) -> Floats:
        x = y * size
        own = differences(residuals, coordinates, x, _STEP * coordinates.sizes(x))
        return np.concatenate([own, np.diag(pull)]) * size

    found = least_squares(
        pulled,
        begin / size,
        jac=slopes,
        bounds=(coordinates.lower / size, coordinates.upper / size),
        x_scale="jac",
        method="dogbox",  # it ends on a bound, where SciPy's other way only tends to it
        ftol=tolerance,
        xtol=tolerance,
        gtol=tolerance,
        max_nfev=most,
    )
    x = found.x * size
    return 2.0 * float(found.cost) - float(np.sum((pull * (x - centre)) ** 2)), x


def differences(
    residuals: Residuals, coordinates: Coordinates, x: Floats, steps: Floats, places: Iterable[int] | None = None
) -> Floats:
    """Derivatives by the coordinates, all or some, (residuals, coordinates), by differences inside the bounds."""
    columns = []
    for i in range(len(x)) if places is None else places:
        high, low = x.copy(), x.copy()
        high[i], low[i] = min(x[i] + steps[i], coordinates.upper[i]), max(x[i] - steps[i], coordinates.lower[i])
        difference = residuals(coordinates.values(high)) - residuals(coordinates.values(low))
        columns.append(difference / (high[i] - low[i]))
    return np.stack(columns, axis=1)


# --- clustered covariance ------------------------------------------------------------------------------------------

# Rail, weather and warmth are those of a test, and shift all its rows alike; one number for the noise of a long time
# would widen every parameter as if all of that went into it. So, where the runs disagree, the covariance is that of the
# jackknife which leaves out one test after the other (CV3 of [MacKinnon2023]), with Student's distribution of as many
# degrees of freedom as there are tests, less one. It holds for any correlation within a test.


LEAST_TESTS = 5  #: with fewer, Student's quantile is so large that nothing is told

_ALONE = 0.99  # share of what is known of a direction: a test with more stands alone, and cannot be left out
_DISAGREE = 0.01  # probability of runs that differ as these do, or more, by the noise within them
_ONE_TEST = 0.5  # of the longest run: runs nearer to each other than that are pieces of one test
_SEEN = 1e-8  # of the largest singular value: a direction that a test shows at all


def whole_tests(time: Floats, step: Floats, run: Integers) -> Integers:
    """The test that each interval belongs to, 0 on; its end at `time`, s, its length `step`, s, and its `run`.

    Runs that a gap or a release has parted are pieces of one test where they lie near to each other.
    """
    first = np.flatnonzero(np.diff(run, prepend=-1))
    if not len(first):
        return np.zeros(0, dtype=np.int64)
    begin, end = time[first] - step[first], time[np.append(first[1:], len(time)) - 1]
    apart = begin[1:] - end[:-1] > _ONE_TEST * float(np.max(end - begin))
    test = np.concatenate([[0], np.cumsum(apart)]).astype(np.int64)
    return np.repeat(test, np.diff(np.append(first, len(time))))


def clustered_covariance(slopes: Floats, residuals: Floats, test: Integers) -> tuple[Floats, int] | None:
    """What the tests say of the estimates by differing: covariance (p, p) and degrees of freedom.

    None where they agree, or are too few. `residuals` of least squares, of variance 1 each, `slopes` their derivatives
    (residuals, parameters) at the least, of full rank, and the `test` of each, 0 on.
    """
    tests, size = int(test.max(initial=-1)) + 1, slopes.shape[1]
    if tests < max(LEAST_TESTS, size + 2):
        return None
    basis, triangle = np.linalg.qr(slopes)
    known = np.array([basis[test == i].T @ basis[test == i] for i in range(tests)])  # they add up to one
    pull = np.array([basis[test == i].T @ residuals[test == i] for i in range(tests)])
    if not _disagree(known, pull) or float(np.linalg.eigvalsh(known).max()) > _ALONE:
        return None
    # the estimates without a test, by one step of Gauss and Newton
    without = -np.linalg.solve(np.eye(size) - known, pull[:, :, None])[:, :, 0]
    without = np.linalg.solve(triangle, (without - without.mean(axis=0)).T)
    return (tests - 1) / tests * (without @ without.T), tests - 1


def _disagree(known: Floats, pull: Floats) -> bool:
    """Whether fits to each test alone would lower the sum of squares by more than noise within the tests does."""
    from scipy.stats import chi2

    singular, directions = np.linalg.eigh(known)
    seen = singular > _SEEN
    along = np.einsum("tji,tj->ti", directions, pull)
    lowered = float(np.sum(along[seen] ** 2 / singular[seen]))
    freedom = int(seen.sum()) - pull.shape[1]
    return freedom > 0 and float(chi2.sf(lowered, freedom)) < _DISAGREE


# --- intervals from the profile of the likelihood ------------------------------------------------------------------

# The rise of the sum of squares that a profile goes to is that which gives a nearly linear parameter its symmetric
# interval: the vertical adjustment of [ChandlerBate2007].


_REACH = 2.6  # standard errors, or the parameter's size where that is less: the first place to look for an end;
_FURTHER = 1.6  # and times that from trial to trial
_TRIALS = 12  # up to 280 sizes: further than that the searches know nothing
_FINE = 0.02  # of a standard error: how well the end is found
_OFF_BOUND = 1e-3  # of a coordinate's size, at which a search begins
_PROFILE_CONVERGED = 1e-6
_PROFILE_SEARCH = 60  # evaluations at most of the residuals and their slopes
_SLOPE_STEP = 1e-3  # of a standard error, or of the value where that is less
_TOLERATED = 0.125  # of an interval's half width; twice that of the rise of the sum of squares, which is quadratic


def is_symmetric(
    residuals: Residuals, coordinates: Coordinates, x: Floats, end: Floats, index: int, half: float, rise: float
) -> bool:
    """Whether a parameter's symmetric interval holds, by what is met on the way from the coordinates x to both ends.

    `end` is by how much the coordinates move, as their covariance has them follow, `half` by how much the parameter
    then should have moved, and `rise` by how much the sum of squares should have risen. No end may lie beyond a bound.
    """
    value = float(coordinates.values(x)[index])
    least = float(np.sum(residuals(coordinates.values(x)) ** 2))
    for side in (-1.0, 1.0):
        there = x + side * end
        if np.any(there <= coordinates.lower) or np.any(there >= coordinates.upper):
            return False
        values = coordinates.values(there)
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
    """Where the sum of squares, least over the other parameters, has risen by `rise`; a bound where it does not.

    `values` are the best ones; `stderr` of the parameter `index` is for the first guess. `beside` is half the interval
    of an error that the residuals do not show, and widens the interval by the rule for independent errors. No interval
    is narrower than with the other parameters known: a search that stays above the best sum of squares tells nothing.
    """
    inverse, value = coordinates.by_inverse(index), float(values[index])
    best, unit = coordinates.followed(index, value), value**-2 if inverse else 1.0
    bounds = coordinates.range_of(index, coordinates.at(values))
    least, most = float(coordinates.least[index]), float(coordinates.most[index])
    profile = _Profile(residuals, coordinates, values, index, rise)
    narrowest = unit * profile.alone(stderr)
    found = []
    ends = [profile.end(side, bound, stderr * unit) for side, bound in zip((-1.0, 1.0), bounds, strict=True)]
    for side, end, bound in zip((-1.0, 1.0), ends, bounds, strict=True):
        outer = best + side * math.hypot(max(abs(best - end), narrowest), beside * unit)
        if end == bound or side * outer >= side * bound:
            found.append(least if (side < 0.0) != inverse else most)
        else:
            found.append(coordinates.followed(index, outer))
    return min(found), max(found)


class _Profile:
    """The least sum of squares over one parameter, or over its inverse where it is followed by that."""

    def __init__(self, residuals: Residuals, coordinates: Coordinates, values: Floats, index: int, rise: float) -> None:
        self._residuals, self._coordinates, self._values = residuals, coordinates, values
        self._index, self._rise = index, rise
        self._best, usual = (coordinates.followed(index, float(x[index])) for x in (values, coordinates.typical))
        self._size = max(abs(self._best), abs(usual))
        self._least = float(np.sum(residuals(values) ** 2))
        self._above, self._ways = {self._best: -rise}, {self._best: coordinates.at(values)}

    def alone(self, stderr: float) -> float:
        """By how much the parameter alone moves while the sum of squares rises so far; 0 where it does not rise."""
        value, step = float(self._values[self._index]), np.zeros_like(self._values)
        step[self._index] = _SLOPE_STEP * min(stderr, abs(value) or stderr)
        here = self._residuals(self._values)
        slope = (self._residuals(self._values + step) - here) / step[self._index]
        steepness, gradient = float(slope @ slope), abs(float(slope @ here))  # beside a bound the sum has a slope too
        if not (steepness > 0.0 and math.isfinite(steepness)):
            return 0.0
        return self._rise / (gradient + math.sqrt(gradient**2 + steepness * self._rise))

    def end(self, side: float, bound: float, stderr: float) -> float:
        """The end of the interval on one side."""
        from scipy.optimize import brentq

        best = inside = self._best
        distance = min(_REACH * stderr, self._size)
        for _ in range(_TRIALS):
            outside = max(best - distance, bound) if side < 0 else min(best + distance, bound)
            if self._excess(outside) > 0.0:
                return float(brentq(self._excess, inside, outside, xtol=_FINE * stderr))
            if outside == bound:
                break
            inside, distance = outside, _FURTHER * distance
        return bound

    def _excess(self, x: float) -> float:
        """By how much the sum lies above the end of the interval."""
        above, coordinates = self._above, self._coordinates
        if x in above:  # a search from elsewhere could end a little lower, and turn the sign
            return above[x]
        way = coordinates.values(np.clip(self._way_to(x), coordinates.lower, coordinates.upper))
        for start in (way, coordinates.typical):  # the way may lead to a least that is not the least of all
            squares, there = self._held(start, coordinates.followed(self._index, x))
            if not above.get(x, math.inf) <= squares - self._least - self._rise:
                above[x], self._ways[x] = squares - self._least - self._rise, coordinates.at(there)
            if above[x] <= 0.0:
                break
        return above[x]

    def _way_to(self, x: float) -> Floats:
        """Where the others are likely to be: on the line through the nearest that are known."""
        known = sorted(self._ways)
        if len(known) == 1:
            return self._ways[known[0]]
        place = min(max(bisect(known, x), 1), len(known) - 1)
        low, high = known[place - 1], known[place]
        share = (x - low) / (high - low)
        return (1.0 - share) * self._ways[low] + share * self._ways[high]

    def _held(self, start: Floats, value: float) -> tuple[float, Floats]:
        """The least sum of squares with the parameter held at a value, and where it is."""
        at = self._coordinates.moved(start, self._index, value)
        others = np.arange(len(at)) != self._index
        if not others.any():
            return float(np.sum(self._residuals(at) ** 2)), at
        rest = self._coordinates.without(self._index)
        begin = rest.inside(rest.at(at[others]), _OFF_BOUND)

        def held(values: Floats) -> Floats:
            trial = at.copy()
            trial[others] = values
            return self._residuals(trial)

        weight = PULL * math.sqrt(self._rise) / _REACH
        squares, x = search(held, rest, begin, weight=weight, tolerance=_PROFILE_CONVERGED, most=_PROFILE_SEARCH)
        at[others] = rest.values(x)
        return squares, at


# --- what is known of the parameters -------------------------------------------------------------------------------


CONFIDENCE = 0.99  #: of the intervals given

NORMAL_QUANTILE = 2.5758293035489004  #: half width of a normal 99 % interval in standard errors

SINGULAR = 1e-6
"""Singular values of the scaled Jacobian below this share of the largest: a direction in which the parameters can move
without the curve following, so that the pull of a search decides. Differences of numbers of 1e-16, over steps of 1e-5
of a parameter, leave 1e-10.
"""

_DIFFERENCE = 1e-5  # of a coordinate's size, for derivatives
_AT_BOUND = 1e-6  # of a coordinate's size: the search stays inside its bounds and only tends to them
_NEAR_BOUND = 0.1  # of a standard error: a coordinate nearer to its bound rests on it,
_NEXT_TO_BOUND = 0.05  # if it is nearer than this share of what is typical too: an error may be however large


class Problem(Protocol):
    """Residuals whose squares are made least, and the coordinates in which that is done."""

    coordinates: Coordinates

    def residuals(self, values: Floats) -> Floats: ...


@dataclass(frozen=True)
class ParameterEstimate:
    """What is known of the free parameters; arrays by parameter.

    `covariance`, (p, p), is scaled as `Parameter.stderr`; rows of parameters that are not identified are NaN, while one
    that rests on a bound has a row: the others are not as sure as if it were known. `coordinate_covariance` is that of
    the coordinates of the search, in which a step of some standard errors is as good as linear. `active` is which bound
    a parameter rests on: -1 the lower, 1 the upper, 0 none; `dead` are those that are not identifiable. `limits` are
    intervals from the profile, by the place of the parameter, where the symmetric one does not hold.
    """

    values: Floats
    covariance: Floats
    coordinates: Coordinates
    coordinate_covariance: Floats
    active: NDArray[np.int_]
    dead: Flags
    limits: Mapping[int, tuple[float, float]]


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
    """What is known at the best coordinates x, where the residuals have `slopes` and a long-run variance.

    `tests` that the residuals, then of variance 1, belong to: where these disagree, that is what the errors are taken
    from, if the model is straight as far as the interval without them reaches. `shifts` of the coordinates by errors
    of the method, each a standard error of its own. Without `profiles` no interval but the symmetric ones.
    """
    coordinates = problem.coordinates
    dead = unidentified(slopes * coordinates.sizes(x))
    unit = covariance_of(slopes, ~dead)
    own = unit * variance * _wider(freedom) ** 2 if math.isfinite(variance) else np.full_like(unit, np.nan)
    turn = coordinates.slopes(x)
    of_dead = (turn[:, dead] != 0.0).any(axis=1)
    alive = np.where(of_dead[:, None], np.nan, turn)
    bias = np.array([turn @ np.where(dead, 0.0, shift) for shift in shifts]).reshape(-1, len(x))
    beside = NORMAL_QUANTILE * np.sqrt(np.sum(bias**2, axis=0))
    limits = {}
    if profiles and math.isfinite(variance):
        limits = _profiles(problem, x, alive, unit, own, beside)
    # estimates without a test are one linear step away: not where the model bends within the interval
    found = None
    if tests is not None and not limits:
        found = clustered_covariance(slopes[:, ~dead], problem.residuals(coordinates.values(x)), tests)
    if found is not None:
        own[np.ix_(~dead, ~dead)] = found[0] * _wider(found[1]) ** 2
        limits = _profiles(problem, x, alive, unit, own, beside) if profiles else {}
    active = _bounds_at(x, coordinates, own)
    for shift in shifts:
        own = own + np.outer(shift, shift)
    return ParameterEstimate(
        values=coordinates.values(x),
        covariance=_turned(own, turn, of_dead, dead),
        coordinates=coordinates,
        coordinate_covariance=own,
        active=_of_values(active, coordinates),
        dead=of_dead,
        limits=limits,
    )


def _wider(freedom: int) -> float:
    """By how much Student's interval is wider than the normal one."""
    from scipy.stats import t as student

    return float(student.ppf(0.5 + CONFIDENCE / 2.0, freedom)) / NORMAL_QUANTILE


def _turned(own: Floats, turn: Floats, of_dead: Flags, dead: Flags) -> Floats:
    """Covariance of the values from that of the coordinates."""
    result: Floats = turn[:, ~dead] @ own[np.ix_(~dead, ~dead)] @ turn[:, ~dead].T
    result[of_dead] = np.nan
    result[:, of_dead] = np.nan
    return result


def _profiles(
    problem: Problem, x: Floats, turn: Floats, unit: Floats, own: Floats, beside: Floats
) -> dict[int, tuple[float, float]]:
    """Intervals where the symmetric one does not hold; `unit`: how the others follow, `own`: how far."""
    coordinates, residuals, found = problem.coordinates, problem.residuals, {}
    own, unit = np.nan_to_num(own), np.nan_to_num(unit)
    for i in (int(each) for each in np.flatnonzero(np.isfinite(turn).all(axis=1))):
        stderr, scale = math.sqrt(turn[i] @ own @ turn[i]), float(turn[i] @ unit @ turn[i])
        if stderr == 0.0:
            continue
        half = NORMAL_QUANTILE * stderr
        end, rise = half / scale * (unit @ turn[i]), half**2 / scale
        if not is_symmetric(residuals, coordinates, x, end, i, half, rise):
            values, wider = coordinates.values(x), float(beside[i])
            found[i] = profile_interval(residuals, coordinates, values, i, stderr=stderr, rise=rise, beside=wider)
    return found


def _bounds_at(x: Floats, coordinates: Coordinates, covariance: Floats) -> NDArray[np.int_]:
    """Which bound each coordinate rests on: -1 the lower, 1 the upper, 0 none."""
    near = np.nan_to_num(_NEAR_BOUND * np.sqrt(np.diag(covariance)))
    next_to = _NEXT_TO_BOUND * np.abs(coordinates.at(coordinates.typical))
    distance = np.maximum(_AT_BOUND * coordinates.sizes(x), np.minimum(near, next_to))
    return np.where(x - coordinates.lower <= distance, -1, np.where(coordinates.upper - x <= distance, 1, 0))


def _of_values(active: NDArray[np.int_], coordinates: Coordinates) -> NDArray[np.int_]:
    """The bounds of the values that bounds of the coordinates stand for."""
    found = active.copy()
    if coordinates.pair is not None:
        b, g = coordinates.pair
        found[g] = -active[g]
        found[b] = 1 if active[g] < 0 and not np.isfinite(coordinates.most[g]) else 0
    elif coordinates.inverse is not None:
        found[coordinates.inverse] = -active[coordinates.inverse]
    return found


def slopes_of(problem: Problem, x: Floats) -> Floats:
    """`differences` of a problem's residuals."""
    return differences(problem.residuals, problem.coordinates, x, _DIFFERENCE * problem.coordinates.sizes(x))


def unidentified(scaled: Floats) -> Flags:
    """Parameters that take part in a direction in which the residuals do not change."""
    if not scaled.size:
        return np.zeros(scaled.shape[1], dtype=bool)
    _, singular, directions = np.linalg.svd(scaled, full_matrices=False)
    flat = singular <= SINGULAR * singular[0]
    return np.asarray((np.abs(directions[flat]) > 1e-3).any(axis=0))


def covariance_of(slopes: Floats, free: Flags) -> Floats:
    """Covariance by residuals of variance 1, NaN for what is not free."""
    size = slopes.shape[1]
    covariance = np.full((size, size), np.nan)
    if free.any():
        _, triangle = np.linalg.qr(slopes[:, free])
        root = np.linalg.inv(triangle)
        covariance[np.ix_(free, free)] = root @ root.T
    return covariance


# --- fits to the cells ---------------------------------------------------------------------------------------------


_LEAST_FREEDOM = 5  # a variance with less is too uncertain to be preferred to that of shorter stretches

_CONVERGED = 1e-14
_SEARCH = 300  # evaluations at most of the residuals and their slopes
_STATUS = {-1: "at lower bound", 0: "fitted", 1: "at upper bound"}
_NOTHING = 1e-9  # of a value: a lower end below it says nothing
_ALIKE = 1e-9  # relative: two searches whose sums of squares agree so ended in one place, and no third is needed
_INSIDE = 1e-6  # of a coordinate's size: how far inside its bounds a search begins


@dataclass(frozen=True)
class Parameter:
    """A fitted parameter, SI.

    `stderr` is the half width of its 99 % interval over 2.576, so that it holds the uncertainty of the noise level
    too; NaN where the parameter is not identified or rests on a bound. `status` is "fitted", "at lower bound",
    "at upper bound" or "not identifiable". `limits` is the interval from the profile of the likelihood, where the
    symmetric one would not hold: beside a bound, and where the data hardly show the parameter; it may have no end. A
    symmetric one that reaches beyond a bound ends there.
    """

    name: str
    value: float
    stderr: float
    status: str
    limits: tuple[float, float] | None = None

    @property
    def interval(self) -> tuple[float, float]:
        """The 99 % interval."""
        if self.limits is not None:
            return self.limits
        half = NORMAL_QUANTILE * self.stderr
        return self.value - half, self.value + half

    @property
    def is_open(self) -> bool:
        """Whether the interval has no upper end."""
        return self.status == "fitted" and math.isinf(self.interval[1])

    @property
    def is_untold(self) -> bool:
        """Whether the log agrees with any value, so that this one is of the search."""
        return self.is_open and self.interval[0] < _NOTHING * self.value

    @property
    def remark(self) -> str:
        """What is to be said of its bound, or of an interval without an end; else empty."""
        low, high = self.interval
        if self.is_untold:
            return f"{self.name}: this log cannot tell it"
        if self.is_open:
            return f"{self.name}: by this log it is not less than {low:.4g} (99 %), and has no upper end"
        if "bound" not in self.status:
            return ""
        end = f"more than {high:.4g}" if "lower" in self.status else f"less than {low:.4g}"
        text = f"{self.name}: rests {self.status.replace('at', 'on its', 1)}"
        return text if self.limits is None else f"{text}; by this log it is not {end} (99 %)"


@dataclass(frozen=True)
class Fit:
    """A model fitted: its `law` has the fitted parameters.

    `residual_squares` is the sum of the squared deviations of all samples from the model, `cell_coefficients` its mean
    mu of each cell. The variance of a mean over n samples is `long_run_variance` over n, NaN where it cannot be had.
    `followed`, (2, k), is slip ratio and mu as a dynamic model had them along the log's motion, None for a model that
    is a curve; `known_stderrs` are standard deviations of parameters that are known from elsewhere, by name.
    `with_profiles` tells whether intervals were taken from the profile of the likelihood where that is needed.

    A prediction-error fit has its `deviance`, -2 log likelihood of the wheel's motion, and its `inflation`, the
    long-run variance of the whitened errors with its degrees of freedom. `coarse` is mu at the knots of a table by the
    fit with every second knot, None for other models.
    """

    model: FitModel
    law: AdhesionLaw
    parameters: tuple[Parameter, ...]
    known: ParameterEstimate
    residual_squares: float
    cell_coefficients: Floats
    long_run_variance: float
    degrees_of_freedom: int
    notes: tuple[str, ...]
    followed: Floats | None = None
    known_stderrs: Mapping[str, float] = field(default_factory=dict)
    with_profiles: bool = True
    deviance: float = math.nan
    inflation: tuple[float, int] = (math.nan, 0)
    coarse: Floats | None = None

    @property
    def values(self) -> Floats:
        """The fitted values."""
        return np.array([p.value for p in self.parameters])

    @property
    def covariance(self) -> Floats:
        """Of the fitted values."""
        return self.known.covariance

    @property
    def correlation(self) -> Floats:
        """Correlation of the estimates, NaN as in `covariance`."""
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
    """Fit a model to the cells: the sum over all samples of (mu - model)^2 is made least, within the bounds.

    `sliding_from` is the slip ratio where sliding begins, for the models of it alone; `tau` is the observer's time
    constant, s. Without `profiles` every interval is the symmetric one. InputError for fewer cells than parameters.
    """
    used = cells.slip >= sliding_from if model.name in SLIDING_ALONE else np.ones(len(cells.slip), dtype=bool)
    if used.sum() <= len(model.names):
        raise InputError(told("too few slips", slips=used.sum(), parameters=len(model.names), model=model.name))
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
    """The fit with what is known of the parameters; `noise` is its long-run variance and degrees of freedom."""
    mean, spread = in_cells(model, known.values, cells)
    if followed is not None:
        mean = np.interp(cells.slip, *followed)
    # of the scatter in a cell, that which the model has there too is no residual
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
        status = "not identifiable" if known.dead[i] else _STATUS[int(known.active[i])]
        parameters.append(Parameter(name, value, stderr, status, known.limits.get(i) or cut_off))
    return Fit(
        model=model,
        law=model.make(known.values, setting.rail),
        parameters=tuple(parameters),
        known=known,
        residual_squares=float(np.sum(inside + cells.count * (cells.mu - mean) ** 2)),
        cell_coefficients=mean,
        long_run_variance=noise[0],
        degrees_of_freedom=noise[1],
        notes=(*model.notes, *_remarks(parameters, noise[0])),
        followed=followed,
    )


def in_cells(model: FitModel, values: Floats, cells: Cells) -> tuple[Floats, Floats]:
    """The model's mean and variance of mu in every cell."""
    mu = model.coefficient(values, cells.nodes, cells.node_speeds, cells.load)
    mean: Floats = np.sum(cells.weights * mu, axis=0)
    return mean, np.sum(cells.weights * (mu - mean) ** 2, axis=0)


class _Problem:
    """The residuals of the cells used, and their solution by SciPy, in coordinates scaled by the start."""

    def __init__(self, model: FitModel, cells: Cells, used: Flags) -> None:
        self.model, self.cells, self.used = model, cells, used
        self.coordinates = model.coordinates
        self.root = np.sqrt(cells.count[used])

    def residuals(self, values: Floats) -> Floats:
        """How far the model's mean of mu lies above that of the samples, in the cells used, by root of the samples."""
        c, at = self.cells, self.used
        mu = self.model.coefficient(values, c.nodes[:, at], c.node_speeds[:, at], c.load[at])
        return np.asarray(self.root * (np.sum(c.weights[:, at] * mu, axis=0) - c.mu[at]))

    def solve(self) -> Floats:
        """The best of the solutions from all starts, in coordinates; of those that are alike the first."""
        coordinates, found = self.coordinates, []
        weight = SINGULAR * float(np.linalg.norm(self.root * self.cells.mu[self.used]))
        starts = [coordinates.at(start) for start in self.model.starts]
        for start in starts:
            begin = coordinates.inside(start, _INSIDE)
            end = search(
                self.residuals, coordinates, begin, weight=weight, centre=starts[0], tolerance=_CONVERGED, most=_SEARCH
            )
            found.append(end)
            least = min(squares for squares, _ in found)
            alike = [x for squares, x in found if squares <= (1.0 + _ALIKE) * least]
            if len(alike) > 1:
                break
        return alike[0]


def long_run_variance(
    mean: Floats, used: Flags, stretches: Stretches, parameters: int, tau: float
) -> tuple[float, int]:
    """Variance of sums of the residuals over stretches of time, by sample, and its degrees of freedom.

    The largest over all lengths of stretch that leave some freedom: too short ones do not see scatter from run to run.
    What the correlation through the filter alone takes from a stretch of finite length is given back; `tau` of 0 is
    for residuals that passed no filter.
    """
    entry = used[stretches.cell]
    stretch, length = stretches.stretch[entry], stretches.length
    deviation = stretches.total[entry] - stretches.count[entry] * mean[stretches.cell[entry]]
    count = stretches.count[entry].sum()
    best = (math.nan, 0)
    while True:
        _, place = np.unique(stretch, return_inverse=True)
        sums = np.bincount(place, deviation)
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
    dead = [p.name for p in parameters if p.status == "not identifiable"]
    if dead:
        change = "it changes" if len(dead) == 1 else "they change together"
        remarks.append(told("not identifiable", names=", ".join(dead), change=change))
    remarks += [p.remark for p in sorted(parameters, key=lambda p: p.is_open) if p.remark]
    loose = [p.name for p in parameters if p.stderr > abs(p.value) and not p.is_open]
    if loose:
        remarks.append(f"{', '.join(loose)}: hardly identified, standard error larger than the value")
    if math.isnan(variance) and all(math.isnan(p.stderr) for p in parameters):
        remarks.append("too few independent stretches of data for standard errors")
    return tuple(remarks)
