"""Intervals beside a bound, where a symmetric one does not hold: from the profile of the likelihood."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_REACH = 2.6  # standard errors: the first place to look for the end of an interval;
_FURTHER = 1.6  # and times that from trial to trial
_TRIALS = 12
_FINE = 0.02  # of a standard error: how well the end is found
_OFF_BOUND = 1e-3  # of a parameter's size, at which a search begins
_SEARCH = 30  # evaluations at most of the residuals and their slopes


def profile_interval(
    residuals: Callable[[Floats], Floats],
    values: Floats,
    lower: Floats,
    upper: Floats,
    index: int,
    *,
    size: Floats,
    stderr: float,
    rise: float,
) -> tuple[float, float]:
    """Where the sum of squares, least over the other parameters, has risen by `rise`; a bound where it does not.

    `values` are the best ones within `lower` and `upper`, `size` what is large for each; `stderr` of the parameter
    `index` is for the first guess.
    """
    least = float(np.sum(residuals(values) ** 2))
    others = np.arange(len(values)) != index
    best = float(values[index])
    above = {best: -rise}
    near = values

    def excess(x: float) -> float:
        nonlocal near
        if x not in above:  # a search from elsewhere could end a little lower, and turn the sign
            squares, near = _least_squares(residuals, near, lower, upper, size, others, index, x)
            above[x] = squares - least - rise
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
        return float(bound)

    return end(-1.0, float(lower[index])), end(1.0, float(upper[index]))


def _least_squares(
    residuals: Callable[[Floats], Floats],
    start: Floats,
    lower: Floats,
    upper: Floats,
    size: Floats,
    others: NDArray[np.bool_],
    index: int,
    x: float,
) -> tuple[float, Floats]:
    """The least sum of squares with one parameter held at x, and where it is."""
    from scipy.optimize import least_squares

    at = start.copy()
    at[index] = x
    if not others.any():
        return float(np.sum(residuals(at) ** 2)), at
    scale = size[others]

    def held(free: Floats) -> Floats:
        trial = at.copy()
        trial[others] = free * scale
        return residuals(trial)

    low, high = lower[others] / scale, upper[others] / scale
    # on a bound the search would hardly leave it
    begin = np.clip(start[others] / scale, low + _OFF_BOUND, high - _OFF_BOUND)
    found = least_squares(held, begin, bounds=(low, high), x_scale="jac", ftol=1e-6, xtol=1e-6, max_nfev=_SEARCH)
    at[others] = found.x * scale
    return 2.0 * float(found.cost), at
