"""Probability of a rare event of standard normal inputs, by subset simulation and by importance sampling.

Subset simulation reaches the event in levels, each about a tenth as likely as the one before ([Au2001]). Chains of
adaptive conditional sampling fill a level from the points beyond its threshold ([Papaioannou2015]). A pilot run chooses
thresholds and steps; the repeats keep them fixed, so that each repeat is an unbiased estimate.

A limit state maps points, (n, inputs), to values, (n,), which may be infinite. The event is a value above the
`threshold`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from railslip_ctrl.core.arguments import Floats
from railslip_ctrl.core.records import by_content

from .statistics import CONFIDENCE

LimitState = Callable[[Floats], Floats]

_SHARE = 0.1  # share of the points beyond the next threshold
_ACCEPTED = 0.35  # share of accepted moves; with 0.44 of [Papaioannou2015] the estimate varies by a fifth more
_KEPT = 20  # points of the event that a repeat keeps
_PAIRS = 40  # pairs of these points between which the event is checked
_FARTHEST = 1.5  # times a point of the event: the farthest point of the search for the event's boundary


@by_content
class Levels(NamedTuple):
    """Thresholds, and the step of the moves in each level, (n,); a step of 1 draws a new point."""

    thresholds: Floats
    steps: Floats


@by_content
class Repeat(NamedTuple):
    """One independent estimate.

    - thresholds, shares, accepted: of each level, with the shares of points that reach it and of moves that stay
      beyond it, (levels,).
    - values: of the first points, then of the points of each level, (levels + 1, n); -inf if no point reached it.
    - mean, points: mean, and some, of the points of the event, or of the last level if no point met the event.
    """

    thresholds: Floats
    shares: Floats
    accepted: Floats
    values: Floats
    mean: Floats
    points: Floats

    def exceeded(self, x: Floats) -> Floats:
        """Probabilities of values of at least `x`, in the shape of `x`."""
        place = np.searchsorted(self.thresholds, x, side="right")
        shares = [np.mean(self.values[k] >= at) for k, at in zip(place, x, strict=True)]
        return np.asarray(np.append(1.0, np.cumprod(self.shares))[place] * shares)

    def probability(self, threshold: float) -> float:
        """Estimate of the event's probability."""
        return float(self.exceeded(np.nextafter([threshold], math.inf))[0])


@by_content
class Sampled(NamedTuple):
    """An estimate by importance sampling."""

    value: Floats


def pilot(limit_state: LimitState, inputs: int, rng: Any, threshold: float, smallest: float, count: int) -> Levels:
    """Levels down to the event, or to probability `smallest`; they end if the values rise no more."""
    points = rng.standard_normal((count, inputs))
    values, reached, step, thresholds, steps = limit_state(points), 1.0, 0.8, list[float](), list[float]()
    while np.mean(values > threshold) < _SHARE and reached > 1.001 * smallest / _SHARE:
        places, counts = np.unique(values, return_counts=True)
        if len(places) == 1:
            break
        shares = np.cumsum(counts[::-1])[::-1] / count
        k = 1 + int(np.argmin(np.abs(np.log(shares[1:] / _SHARE))))  # the nearest of a discrete outcome's shares
        points, values, _, step = _beyond(limit_state, points, values, places[k], step, rng, adapt=True)
        reached *= float(shares[k])
        thresholds.append(float(places[k]))
        steps.append(step)
    return Levels(np.array(thresholds), np.array(steps))


def repeat(
    limit_state: LimitState, inputs: int, rng: Any, threshold: float, levels: Sequence[Floats], count: int
) -> Repeat:
    """Make an estimate with given levels and `count` points in each."""
    thresholds, steps = levels
    points = rng.standard_normal((count, inputs))
    values, shares, accepted = limit_state(points), np.zeros(len(thresholds)), np.zeros(len(thresholds))
    found = np.full((len(thresholds) + 1, count), -math.inf)
    found[0] = values
    for k, (level, step) in enumerate(zip(thresholds, steps, strict=True)):
        shares[k] = np.mean(values >= level)
        if not shares[k]:
            break
        points, values, accepted[k], _ = _beyond(limit_state, points, values, level, step, rng)
        found[k + 1] = values
    inside = points[values > threshold] if np.any(values > threshold) else points
    return Repeat(thresholds, shares, accepted, found, inside.mean(axis=0), rng.permutation(inside)[:_KEPT])


def _beyond(
    limit_state: LimitState, points: Floats, values: Floats, level: float, step: float, rng: Any, adapt: bool = False
) -> tuple[Floats, Floats, float, float]:
    """Points beyond a level, their values, the share of accepted moves, and the step, which may `adapt`.

    Chains begin at the points that reach the level. A move is z' = sqrt(1 - s^2) z + s w with w standard normal; it is
    refused if it leaves the level.
    """
    start = rng.permutation(np.flatnonzero(values >= level))
    at, value, left = points[start], values[start], len(values) - len(start)
    found, accepted = [(at, value)], list[float]()
    while left > 0:
        at, value = at[:left], value[:left]
        new = np.sqrt(1.0 - step**2) * at + step * rng.standard_normal(at.shape)
        new_value = limit_state(new)
        stays = new_value >= level
        at, value = np.where(stays[:, None], new, at), np.where(stays, new_value, value)
        found.append((at, value))
        accepted.append(float(stays.mean()))
        left -= len(at)
        if adapt:
            step = min(1.0, step * math.exp((accepted[-1] - _ACCEPTED) / math.sqrt(len(accepted))))
    every, valued = (np.concatenate(one) for one in zip(*found, strict=True))
    return every, valued, float(np.mean(accepted)) if accepted else 1.0, step


@by_content
class Pooled(NamedTuple):
    """Mean of independent estimates, its interval and its coefficient of variation, all of one shape."""

    value: Any
    low: Any
    high: Any
    variation: Any


def pooled(estimates: Floats) -> Pooled:
    """Pool estimates, (repeats, ...); the interval is that of the mean of a log-normal variable (Cox)."""
    from scipy.special import stdtrit

    count, mean = len(estimates), np.mean(estimates, axis=0)
    variation = np.std(estimates, axis=0, ddof=1) / np.where(mean > 0.0, mean, 1.0)
    spread = np.log1p(variation**2)
    quantile = stdtrit(count - 1, 0.5 + 0.5 * CONFIDENCE)
    factor = np.exp(quantile * np.sqrt(spread / count + spread**2 / (2.0 * (count - 1))))
    return Pooled(mean, mean / factor, mean * factor, variation / math.sqrt(count))


def direction(means: Floats, groups: Iterable[slice]) -> tuple[Floats, Floats]:
    """Mean of the repeats' `means`, each group scaled by their agreement, and the groups' shares of its squared length.

    The squared lengths are products of different repeats, so that chance does not increase them.
    """
    count, mean = len(means), means.mean(axis=0)
    squared = ((count * mean) ** 2 - np.sum(means**2, axis=0)) / (count * (count - 1))
    shares, shrunk = list[float](), np.zeros_like(mean)
    for group in groups:
        shares.append(max(float(squared[group].sum()), 0.0))
        shrunk[group] = mean[group] * min(1.0, shares[-1] / max(float(np.sum(mean[group] ** 2)), 1e-300))
    return shrunk, np.array(shares) / max(sum(shares), 1e-300)


def design_point(limit_state: LimitState, candidates: Iterable[Floats], threshold: float) -> Floats:
    """First point of the event between the origin and the first candidate that has one, else the last candidate."""
    for way in candidates:
        low, high = 0.0, _FARTHEST
        for count in (30, 20):  # resolves 1/400 of the distance
            scales = np.linspace(low, high, count + 1)[1:]
            beyond = scales[limit_state(scales[:, None] * way) > threshold]
            if not len(beyond):
                break
            low, high = beyond[0] - (high - low) / count, beyond[0]
        else:
            return np.asarray(high * way)
    return way


def importance(limit_state: LimitState, inputs: int, rng: Any, threshold: float, centre: Floats, count: int) -> Sampled:
    """Estimate of the event's probability from `count` points about its design point, `centre`."""
    points = centre + rng.standard_normal((count, inputs))
    weights = np.exp(0.5 * float(centre @ centre) - points @ centre)
    return Sampled(np.mean(weights * (limit_state(points) > threshold)))


def apart(limit_state: LimitState, points: Floats, threshold: float, rng: Any) -> float:
    """Share of pairs of event points with a point outside the event between them: 0 for one region without holes."""
    first, second = points[rng.integers(len(points), size=(2, _PAIRS))]
    middle, length = first + second, 0.5 * np.linalg.norm([first, second], axis=2).sum(axis=0)
    middle *= (length / np.maximum(np.linalg.norm(middle, axis=1), 1e-300))[:, None]
    return float(np.mean(limit_state(middle) <= threshold))


def repeated(found: Repeat) -> float:
    """Largest share of a level's new finite values that are repeated: 0 for a continuous outcome."""
    new = found.values.shape[1] * np.append(1.0, (1.0 - found.shares) * found.accepted)
    different = [len(np.unique(row[np.isfinite(row)])) + np.count_nonzero(np.isinf(row)) for row in found.values]
    return float(np.max(1.0 - np.array(different) / np.maximum(new, 1.0)))
