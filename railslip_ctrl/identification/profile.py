"""Intervals where a symmetric one does not hold, beside a bound or along a bend: from the profile of the likelihood."""

from __future__ import annotations

import math
from bisect import bisect
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from .coordinates import Coordinates
from .search import PULL, Residuals, search

Floats = NDArray[np.float64]

_REACH = 2.6  # standard errors, or the parameter's size where that is less: the first place to look for an end;
_FURTHER = 1.6  # and times that from trial to trial
_TRIALS = 12  # up to 280 sizes: further than that the searches know nothing
_FINE = 0.02  # of a standard error: how well the end is found
_OFF_BOUND = 1e-3  # of a coordinate's size, at which a search begins
_CONVERGED = 1e-6
_SEARCH = 60  # evaluations at most of the residuals and their slopes
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
    best, usual = (coordinates.followed(index, float(x[index])) for x in (values, coordinates.typical))
    size = max(abs(best), abs(usual))
    least = float(np.sum(residuals(values) ** 2))
    above, ways = {best: -rise}, {best: coordinates.at(values)}

    def excess(x: float) -> float:
        if x in above:  # a search from elsewhere could end a little lower, and turn the sign
            return above[x]
        way = coordinates.values(np.clip(_between(ways, x), coordinates.lower, coordinates.upper))
        for start in (way, coordinates.typical):  # the way may lead to a least that is not the least of all
            squares, there = _held(residuals, coordinates, start, index, coordinates.followed(index, x), rise)
            if not above.get(x, math.inf) <= squares - least - rise:
                above[x], ways[x] = squares - least - rise, coordinates.at(there)
            if above[x] <= 0.0:
                break
        return above[x]

    def end(side: float, bound: float) -> float:
        from scipy.optimize import brentq

        inside, distance = best, min(_REACH * stderr, size)
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
    """Where the way through points known by one number is likely to be at another: on the line through the nearest."""
    known = sorted(ways)
    if len(known) == 1:
        return ways[known[0]]
    place = min(max(bisect(known, x), 1), len(known) - 1)
    low, high = known[place - 1], known[place]
    share = (x - low) / (high - low)
    return (1.0 - share) * ways[low] + share * ways[high]


def _held(
    residuals: Residuals, coordinates: Coordinates, start: Floats, index: int, value: float, rise: float
) -> tuple[float, Floats]:
    """The least sum of squares with one parameter held at a value, and where it is."""
    at = coordinates.moved(start, index, value)
    others = np.arange(len(at)) != index
    if not others.any():
        return float(np.sum(residuals(at) ** 2)), at
    rest = coordinates.without(index)
    begin = rest.inside(rest.at(at[others]), _OFF_BOUND)

    def held(values: Floats) -> Floats:
        trial = at.copy()
        trial[others] = values
        return residuals(trial)

    weight = PULL * math.sqrt(rise) / _REACH
    squares, x = search(held, rest, begin, weight=weight, tolerance=_CONVERGED, most=_SEARCH)
    at[others] = rest.values(x)
    return squares, at
