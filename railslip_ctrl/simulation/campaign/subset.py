"""Probability of a rare event of standard normal inputs: subset simulation, and importance sampling beside it.

Subset simulation reaches the event in levels, each about a tenth as likely as the one before ([Au2001]); chains of
conditional sampling fill a level from the points that are beyond it ([Papaioannou2015]). A pilot chooses levels and
steps. The repeats that count take both as given, so that each of them is an estimate without bias.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from railslip_ctrl.core.arguments import Floats
from railslip_ctrl.core.records import by_content, dataclass

from .statistics import CONFIDENCE

LimitState = Callable[[Floats], Floats]
"""Values of points (n by dimensions), (n,); the event is a value above a threshold. Infinite values are allowed."""

SHARE = 0.1
"""Share of the points beyond the next level; from 0.05 to 0.2 the number of calls for one accuracy is the same."""

ACCEPTED = 0.35
"""Share of moves that the pilot's steps aim at; [Papaioannou2015] has 0.44, which takes 15 % more calls at 1e-9."""

_KEPT = 20  # points of the event that a repeat keeps
_PAIRS = 40  # of such points, whose middle is looked at
_FARTHEST = 1.5  # of the mean of the event's points: the event begins before


class Level(NamedTuple):
    """A threshold, and the step of the moves among the points that reach it (1: each is drawn anew)."""

    threshold: float
    step: float


@dataclass(frozen=True)
class Repeat:
    """An independent estimate.

    - shares: of the points that reach each level's threshold, (levels,).
    - accepted: share of the moves that stay beyond it, (levels,).
    - values: of the points of no level, then of each, (levels + 1, n); -inf where no point reached it.
    - mean, points: mean, and some, of the points of the event, or of the last level where none is; in the latter case
      and without a threshold too.
    - calls: of the limit state.
    """

    shares: Floats
    accepted: Floats
    values: Floats
    mean: Floats
    points: Floats
    calls: int

    @property
    def reached(self) -> Floats:
        """Probability of no level (1), then of each, (levels + 1,)."""
        return np.concatenate([[1.0], np.cumprod(self.shares)])

    def probability(self, threshold: float) -> float:
        """Estimate of the event."""
        return float(self.reached[-1] * np.mean(self.values[-1] > threshold))

    def exceeded(self, x: Floats, levels: Sequence[Level]) -> Floats:
        """Probabilities of values of at least `x`, as many."""
        place = np.searchsorted([level.threshold for level in levels], x, side="right")
        shares = [np.mean(self.values[k] >= at) for k, at in zip(place, x, strict=True)]
        return np.asarray(self.reached[place] * shares)


def pilot(
    limit_state: LimitState,
    dimension: int,
    threshold: float,
    rng: np.random.Generator,
    *,
    count: int,
    fresh: int = 0,
    smallest: float = 1e-12,
) -> tuple[Level, ...]:
    """Levels on the way to the event, or to probabilities `smallest`; they end where the values rise no more.

    Of `count` points: half of a repeat's will do, as the levels need not be exact.

    The last `fresh` coordinates are drawn anew in every move: their values need not be remembered.
    """
    points = rng.standard_normal((count, dimension))
    values, levels, step, reached = limit_state(points), list[Level](), 0.8, 1.0
    while np.mean(values > threshold) < SHARE and reached > 1.001 * smallest / SHARE:
        places, counts = np.unique(values, return_counts=True)
        shares = np.cumsum(counts[::-1])[::-1] / count
        if len(places) == 1:
            break
        k = 1 + int(np.argmin(np.abs(np.log(shares[1:] / SHARE))))  # of a discrete outcome the nearest share
        at = Level(float(places[k]), step)
        points, values, step, _ = _conditional(limit_state, points, values, at, rng, fresh, adapt=True)
        levels.append(at._replace(step=step))
        reached *= float(shares[k])
    return tuple(levels)


def repeat(
    limit_state: LimitState,
    dimension: int,
    levels: Sequence[Level],
    threshold: float,
    rng: np.random.Generator,
    *,
    count: int,
    fresh: int = 0,
) -> Repeat:
    """An estimate with given levels and `count` points at each; `fresh` as of `pilot`."""
    points = rng.standard_normal((count, dimension))
    values, calls = limit_state(points), count
    found, shares, accepted = [values], np.zeros(len(levels)), np.zeros(len(levels))
    for k, level in enumerate(levels):
        beyond = int(np.count_nonzero(values >= level.threshold))
        if not beyond:
            found += [np.full(count, -math.inf)] * (len(levels) - k)
            break
        points, values, _, accepted[k] = _conditional(limit_state, points, values, level, rng, fresh)
        shares[k], calls = beyond / count, calls + count - beyond
        found.append(values)
    inside = points[values > threshold] if np.any(values > threshold) else points
    kept = inside[rng.permutation(len(inside))[:_KEPT]]
    return Repeat(shares, accepted, np.array(found), inside.mean(axis=0), kept, calls)


def _conditional(
    limit_state: LimitState,
    points: Floats,
    values: Floats,
    level: Level,
    rng: np.random.Generator,
    fresh: int,
    *,
    adapt: bool = False,
) -> tuple[Floats, Floats, float, float]:
    """As many points beyond a level: (points, values, step, share of moves accepted).

    Chains begin at the points that reach it. A move is z' = sqrt(1 - s^2) z + s w with w standard normal, refused
    where it leaves the level.
    """
    start = rng.permutation(np.flatnonzero(values >= level.threshold))
    at, value, step, left = points[start], values[start], level.step, len(values) - len(start)
    found, accepted = [(at, value)], list[float]()
    while left > 0:
        at, value = at[:left], value[:left]
        steps = np.full(at.shape[1], step)
        steps[at.shape[1] - fresh :] = 1.0
        new = np.sqrt(1.0 - steps**2) * at + steps * rng.standard_normal(at.shape)
        new_value = limit_state(new)
        stays = new_value >= level.threshold
        at, value = np.where(stays[:, None], new, at), np.where(stays, new_value, value)
        found.append((at, value))
        accepted.append(float(stays.mean()))
        left -= len(at)
        if adapt:
            step = min(1.0, step * math.exp((accepted[-1] - ACCEPTED) / math.sqrt(len(accepted))))
    every, valued = (np.concatenate(one) for one in zip(*found, strict=True))
    return every, valued, step, float(np.mean(accepted)) if accepted else 1.0


@by_content
class Pooled(NamedTuple):
    """Mean of independent estimates, bounds of its interval, and its coefficient of variation; each of one shape."""

    value: Floats
    low: Floats
    high: Floats
    variation: Floats


def pooled(estimates: Floats) -> Pooled:
    """Estimates, (repeats, ...), together; the interval is that of the mean of a log-normal variable (Cox's)."""
    from scipy import stats

    count, mean = len(estimates), np.mean(estimates, axis=0)
    variation = np.std(estimates, axis=0, ddof=1) / np.where(mean > 0.0, mean, 1.0)
    spread = np.log1p(variation**2)
    quantile = float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, count - 1))
    factor = np.exp(quantile * np.sqrt(spread / count + spread**2 / (2.0 * (count - 1))))
    return Pooled(mean, mean / factor, mean * factor, variation / math.sqrt(count))


# --- what makes the event likely --------------------------------------------------------------------------------------


@by_content
class Direction(NamedTuple):
    """Mean of the event's points, each group's as far as the repeats agree on it, and the groups' shares of it.

    A share is that of the squared length, as the squared sensitivities of a first-order reliability method.
    """

    mean: Floats
    shares: Floats


def direction(repeats: Sequence[Repeat], groups: Sequence[slice]) -> Direction:
    """Mean and shares; the squared lengths are from products of different repeats, so that chance adds nothing."""
    means = np.array([one.mean for one in repeats])
    count, mean = len(means), means.mean(axis=0)
    squared = ((count * mean) ** 2 - np.sum(means**2, axis=0)) / (count * (count - 1))
    lengths = np.array([max(float(squared[group].sum()), 0.0) for group in groups])
    shrunk = np.zeros_like(mean)
    for group, length in zip(groups, lengths, strict=True):
        shrunk[group] = mean[group] * min(1.0, length / max(float(np.sum(mean[group] ** 2)), 1e-300))
    return Direction(shrunk, lengths / max(float(lengths.sum()), 1e-300))


def design_point(limit_state: LimitState, mean: Floats, threshold: float) -> Floats | None:
    """The first point of the event on the way from the origin to the mean of its points; None if none is on it."""
    low, high = 0.0, _FARTHEST
    for count in (30, 20):  # to 1/600 of the way
        ways = np.linspace(low, high, count + 1)[1:]
        beyond = np.flatnonzero(limit_state(ways[:, None] * mean) > threshold)
        if not len(beyond):
            return None
        low, high = ways[beyond[0]] - (high - low) / count, ways[beyond[0]]
    return np.asarray(high * mean)


def importance(
    limit_state: LimitState, centre: Floats, threshold: float, rng: np.random.Generator, *, count: int
) -> float:
    """Estimate of the event by sampling about its design point, `centre`."""
    points = centre + rng.standard_normal((count, len(centre)))
    weights = np.exp(0.5 * float(centre @ centre) - points @ centre)
    return float(np.mean(weights * (limit_state(points) > threshold)))


# --- where the estimate cannot be trusted -----------------------------------------------------------------------------


def apart(limit_state: LimitState, points: Floats, threshold: float, rng: np.random.Generator) -> float:
    """Share of pairs of points of the event between which there is none of it: 0 of one region without holes."""
    first, second = (points[rng.integers(len(points), size=_PAIRS)] for _ in range(2))
    middle, length = 0.5 * (first + second), 0.5 * np.linalg.norm([first, second], axis=2).sum(axis=0)
    middle *= (length / np.maximum(np.linalg.norm(middle, axis=1), 1e-300))[:, None]
    return float(np.mean(limit_state(middle) <= threshold))


def repeated(repeats: Sequence[Repeat]) -> float:
    """The largest share of a level's new points whose finite value another point has: 0 of a continuous outcome."""
    found = 0.0
    for one in repeats:
        new = one.values.shape[1] * np.concatenate([[1.0], (1.0 - one.shares) * one.accepted])
        for row, count in zip(one.values, new, strict=True):
            different = len(np.unique(row[np.isfinite(row)])) + np.count_nonzero(np.isinf(row))
            found = max(found, 1.0 - different / max(count, 1.0))
    return found
