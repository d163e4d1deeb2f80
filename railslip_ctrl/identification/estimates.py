"""From the least squares of a problem to what is known of its parameters: covariance, bounds they rest on, intervals.

One way for fits to the cells and for fits along the motion: the covariance of the coordinates of the search, from the
slopes of the residuals and their long-run variance or from what differs between tests, and of the parameters by the
derivatives of the coordinates; an interval from the profile of the likelihood wherever the symmetric one does not hold.
The rise of the sum of squares that a profile goes to is then that which gives a nearly linear parameter its symmetric
interval: the vertical adjustment of [ChandlerBate2007].
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .between_runs import between_runs
from .coordinates import Coordinates
from .profile import is_symmetric, profile_interval
from .search import differences

Floats = NDArray[np.float64]

CONFIDENCE = 0.99
"""Of the intervals given."""

NORMAL_QUANTILE = 2.5758293035489004
"""Half width of a normal 99 % interval in standard errors."""

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
class Estimate:
    """What is known of the free parameters; arrays by parameter.

    Attributes
    ----------
    values : array
    covariance : array, (p, p)
        Scaled as `fits.Parameter.stderr`; rows of parameters that are not identified are NaN. One that rests on a bound
        has a row: the others are not as sure as if it were known.
    coordinates : Coordinates
    coordinate_covariance : array, (p, p)
        The same of the coordinates.
    active : array of int
        Which bound a parameter rests on: -1 the lower, 1 the upper, 0 none.
    dead : array of bool
        Parameters that are not identifiable.
    limits : mapping
        Intervals from the profile, by the place of the parameter, where the symmetric one does not hold.
    """

    values: Floats
    covariance: Floats
    coordinates: Coordinates
    coordinate_covariance: Floats
    active: NDArray[np.int_]
    dead: NDArray[np.bool_]
    limits: Mapping[int, tuple[float, float]]


def estimate(
    problem: Problem,
    x: Floats,
    slopes: Floats,
    variance: float,
    freedom: int,
    *,
    tests: NDArray[np.int64] | None = None,
    shifts: Sequence[Floats] = (),
    profiles: bool = True,
) -> Estimate:
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
        found = between_runs(slopes[:, ~dead], problem.residuals(coordinates.values(x)), tests)
    if found is not None:
        own[np.ix_(~dead, ~dead)] = found.covariance * _wider(found.freedom) ** 2
        limits = _profiles(problem, x, alive, unit, own, beside) if profiles else {}
    active = _bounds_at(x, coordinates, own)
    for shift in shifts:
        own = own + np.outer(shift, shift)
    return Estimate(
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


def _turned(own: Floats, turn: Floats, of_dead: NDArray[np.bool_], dead: NDArray[np.bool_]) -> Floats:
    """Covariance of the values from that of the coordinates."""
    result: Floats = turn[:, ~dead] @ own[np.ix_(~dead, ~dead)] @ turn[:, ~dead].T
    result[of_dead] = np.nan
    result[:, of_dead] = np.nan
    return result


def _profiles(
    problem: Problem, x: Floats, turn: Floats, unit: Floats, own: Floats, beside: Floats
) -> dict[int, tuple[float, float]]:
    """Intervals of the parameters whose symmetric one does not hold.

    `own` is the covariance of the coordinates, `unit` that by residuals of variance 1, along which the others follow.
    """
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
    """Derivatives of the residuals by the coordinates, (residuals, coordinates), by differences inside the bounds."""
    steps = _DIFFERENCE * problem.coordinates.sizes(x)
    return differences(problem.residuals, problem.coordinates, x, steps)


def unidentified(scaled: Floats) -> NDArray[np.bool_]:
    """Parameters that take part in a direction in which the residuals do not change."""
    if not scaled.size:
        return np.zeros(scaled.shape[1], dtype=bool)
    _, singular, directions = np.linalg.svd(scaled, full_matrices=False)
    flat = singular <= SINGULAR * singular[0]
    result: NDArray[np.bool_] = (np.abs(directions[flat]) > 1e-3).any(axis=0)
    return result


def covariance_of(slopes: Floats, free: NDArray[np.bool_]) -> Floats:
    """Covariance by residuals of variance 1, NaN for what is not free."""
    size = slopes.shape[1]
    covariance = np.full((size, size), np.nan)
    if free.any():
        _, triangle = np.linalg.qr(slopes[:, free])
        root = np.linalg.inv(triangle)
        covariance[np.ix_(free, free)] = root @ root.T
    return covariance
