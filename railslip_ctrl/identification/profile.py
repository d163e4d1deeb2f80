"""Intervals where a symmetric one does not hold, beside a bound or along a bend: from the profile of the likelihood."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from .coordinates import Coordinates

Floats = NDArray[np.float64]
Residuals = Callable[[Floats], Floats]

_REACH = 2.6  # standard errors: the first place to look for the end of an interval;
_FURTHER = 1.6  # and times that from trial to trial
_TRIALS = 12
_FINE = 0.02  # of a standard error: how well the end is found
_OFF_BOUND = 1e-3  # of a coordinate's size, at which a search begins
_SEARCH = 30  # evaluations at most of the residuals and their slopes
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
    narrowest = unit * _alone(residuals, values, index, stderr, rise)
    found = []
    for side, end, bound in zip(
        (-1.0, 1.0), _ends(residuals, coordinates, values, index, stderr * unit, rise, bounds), bounds, strict=True
    ):
        outer = best + side * math.hypot(max(abs(best - end), narrowest), beside * unit)
        if end == bound or side * outer >= side * bound:
            found.append(least if (side < 0.0) != inverse else most)
        else:
            found.append(coordinates.followed(index, outer))
    return min(found), max(found)


def _alone(residuals: Residuals, values: Floats, index: int, stderr: float, rise: float) -> float:
    """By how much a parameter alone moves while the sum of squares rises so far; 0 where it does not rise."""
    value, step = float(values[index]), np.zeros_like(values)
    step[index] = _SLOPE_STEP * min(stderr, abs(value) or stderr)
    here = residuals(values)
    slope = (residuals(values + step) - here) / step[index]
    steepness, gradient = float(slope @ slope), abs(float(slope @ here))  # beside a bound the sum has a slope too
    if not (steepness > 0.0 and math.isfinite(steepness)):
        return 0.0
    return rise / (gradient + math.sqrt(gradient**2 + steepness * rise))


def _ends(
    residuals: Residuals,
    coordinates: Coordinates,
    values: Floats,
    index: int,
    stderr: float,
    rise: float,
    bounds: tuple[float, float],
) -> tuple[float, float]:
    """Of the interval of the parameter, or of its inverse where it is followed by that."""
    best = coordinates.followed(index, float(values[index]))
    least = float(np.sum(residuals(values) ** 2))
    above, ways = {best: -rise}, {best: coordinates.at(values)}

    def excess(x: float) -> float:
        if x not in above:  # a search from elsewhere could end a little lower, and turn the sign
            start = coordinates.values(_between(ways, x))
            squares, there = _held(residuals, coordinates, start, index, coordinates.followed(index, x))
            above[x], ways[x] = squares - least - rise, coordinates.at(there)
        return above[x]

    def end(side: float, bound: float) -> float:
        from scipy.optimize import brentq

        inside, distance = best, _REACH * stderr
        for _ in range(_TRIALS):
            outside = max(best - distance, bound) if side < 0 else min(best + distance, bound)
            if excess(outside) > 0.0:
                return float(brentq(excess, inside, outside, xtol=_FINE * stderr))
            if outside == bound:
                break
            inside, distance = outside, _FURTHER * distance
        return bound

    return end(-1.0, bounds[0]), end(1.0, bounds[1])


def _between(ways: Mapping[float, Floats], x: float) -> Floats:
    """Where the way through points known by one number is likely to be at another: on the line between neighbours."""
    below, beyond = [k for k in ways if k < x], [k for k in ways if k > x]
    if not below or not beyond:
        return ways[min(ways, key=lambda k: abs(k - x))]
    low, high = max(below), min(beyond)
    share = (x - low) / (high - low)
    return (1.0 - share) * ways[low] + share * ways[high]


def _held(
    residuals: Residuals, coordinates: Coordinates, start: Floats, index: int, value: float
) -> tuple[float, Floats]:
    """The least sum of squares with one parameter held at a value, and where it is."""
    from scipy.optimize import least_squares

    at = coordinates.moved(start, index, value)
    others = np.arange(len(at)) != index
    if not others.any():
        return float(np.sum(residuals(at) ** 2)), at
    rest = coordinates.without(index)
    begin = rest.inside(rest.at(at[others]), _OFF_BOUND)
    size = rest.sizes(begin)

    def held(x: Floats) -> Floats:
        trial = at.copy()
        trial[others] = rest.values(x * size)
        return residuals(trial)

    bounds = (rest.lower / size, rest.upper / size)
    found = least_squares(held, begin / size, bounds=bounds, x_scale="jac", ftol=1e-6, xtol=1e-6, max_nfev=_SEARCH)
    at[others] = rest.values(found.x * size)
    return 2.0 * float(found.cost), at
