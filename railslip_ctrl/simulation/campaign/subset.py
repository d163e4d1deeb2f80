"""Probability of a rare event of standard normal inputs, by subset simulation and by importance sampling.

A point is a vector of all inputs. A limit state is a function that maps points, (n, inputs), to values, (n,), which may
be infinite. The event is a value above the `threshold`.

Subset simulation reaches the event in levels ([Au2001]). All points of a level have values of at least the level's
threshold. About a tenth of the points of a level reach the threshold of the next level. From this tenth, Markov chains
produce the other points of the next level (adaptive conditional sampling, [Papaioannou2015]). `pilot` chooses the
thresholds and the step sizes of the chains once for all repeats of the estimate, so that each repeat is unbiased.
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

_SHARE = 0.1  # share of the points of a level that reach the next threshold
_ACCEPTED = 0.35  # share of accepted moves; with the 0.44 of [Papaioannou2015] the variation is a fifth larger
_KEPT = 20  # number of points of the event that a repeat returns
_PAIRS = 40  # number of pairs of these points for which the point in the middle is checked
_FARTHEST = 1.5  # end of the search for the event's boundary, relative to a point of the event


@by_content
class Levels(NamedTuple):
    """Thresholds and step sizes (ratios) of the Markov chains of n levels, (n,); step size 1: independent points."""

    thresholds: Floats
    steps: Floats


@by_content
class Repeat(NamedTuple):
    """One independent estimate by subset simulation.

    - thresholds: threshold of each level, (levels,).
    - shares: share of the previous level's points that reach the threshold of a level, (levels,).
    - accepted: share of accepted moves in each level, (levels,).
    - values: values of the first points, then of the points of each level, (levels + 1, n); -inf if no point
      reached the level.
    - mean: mean of the points with the event, (inputs,), or of the points of the last level if none has the event.
    - points: a random selection of these points, (m, inputs).
    """

    thresholds: Floats
    shares: Floats
    accepted: Floats
    values: Floats
    mean: Floats
    points: Floats

    def exceeded(self, x: Floats) -> Floats:
        """Return the estimated probability that the limit state is at least x, for each entry of `x`, 1-D."""
        place = np.searchsorted(self.thresholds, x, side="right")
        shares = [np.mean(self.values[k] >= at) for k, at in zip(place, x, strict=True)]
        return np.asarray(np.append(1.0, np.cumprod(self.shares))[place] * shares)

    def probability(self, threshold: float) -> float:
        return float(self.exceeded(np.nextafter([threshold], math.inf))[0])


@by_content
class Sampled(NamedTuple):
    """Probability of the event in one repeat of importance sampling."""

    value: Floats


def pilot(limit_state: LimitState, inputs: int, rng: Any, threshold: float, smallest: float, count: int) -> Levels:
    """Choose thresholds and step sizes for levels of decreasing probability; each level has `count` points.

    The search ends when at least a tenth of the points of the last level have the event, when the probability of the
    last level is about ten times `smallest`, or when all points have the same value.
    """
    points = rng.standard_normal((count, inputs))
    values, reached, step, thresholds, steps = limit_state(points), 1.0, 0.8, list[float](), list[float]()
    while np.mean(values > threshold) < _SHARE and reached > 1.001 * smallest / _SHARE:
        places, counts = np.unique(values, return_counts=True)
        if len(places) == 1:
            break
        shares = np.cumsum(counts[::-1])[::-1] / count
        k = 1 + int(np.argmin(np.abs(np.log(shares[1:] / _SHARE))))  # nearest share: a discrete outcome has few
        points, values, _, step = _beyond(limit_state, points, values, places[k], step, rng, adapt=True)
        reached *= float(shares[k])
        thresholds.append(float(places[k]))
        steps.append(step)
    return Levels(np.array(thresholds), np.array(steps))


def repeat(
    limit_state: LimitState, inputs: int, rng: Any, threshold: float, levels: Sequence[Floats], count: int
) -> Repeat:
    """Return an independent estimate with given `levels` and `count` points in each level."""
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
    """Start Markov chains at the points that reach a level; return points, values, share of accepted moves, step."""
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
    """Mean of independent estimates, its confidence interval and its coefficient of variation, of equal shape."""

    value: Any
    low: Any
    high: Any
    variation: Any


def pooled(estimates: Floats) -> Pooled:
    """Return the mean over the first axis of independent estimates, with Cox's interval for log-normal variables."""
    from scipy.special import stdtrit

    count, mean = len(estimates), np.mean(estimates, axis=0)
    variation = np.std(estimates, axis=0, ddof=1) / np.where(mean > 0.0, mean, 1.0)
    spread = np.log1p(variation**2)
    quantile = stdtrit(count - 1, 0.5 + 0.5 * CONFIDENCE)
    factor = np.exp(quantile * np.sqrt(spread / count + spread**2 / (2.0 * (count - 1))))
    return Pooled(mean, mean / factor, mean * factor, variation / math.sqrt(count))


def direction(means: Floats, groups: Iterable[slice]) -> tuple[Floats, Floats]:
    """Return the mean vector over the repeats, and the share of each group of inputs in its squared length.

    Squared lengths are estimated by products of components from different repeats, because squares of one repeat are
    too large on average. If the estimate for a group is smaller than the squared length of the group in the mean
    vector, the group is multiplied by the ratio of the two.
    """
    count, mean = len(means), means.mean(axis=0)
    squared = ((count * mean) ** 2 - np.sum(means**2, axis=0)) / (count * (count - 1))
    shares, shrunk = list[float](), np.zeros_like(mean)
    for group in groups:
        shares.append(max(float(squared[group].sum()), 0.0))
        shrunk[group] = mean[group] * min(1.0, shares[-1] / max(float(np.sum(mean[group] ** 2)), 1e-300))
    return shrunk, np.array(shares) / max(sum(shares), 1e-300)


def design_point(limit_state: LimitState, candidates: Iterable[Floats], threshold: float) -> Floats:
    """Return the point nearest to 0 at which the event occurs, on a ray from 0 through one of the `candidates`.

    The first candidate whose ray has a point with the event is used; if there is none, the last candidate is returned.
    """
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
    """Estimate the probability by importance sampling, with `count` normally distributed points around `centre`."""
    points = centre + rng.standard_normal((count, inputs))
    weights = np.exp(0.5 * float(centre @ centre) - points @ centre)
    return Sampled(np.mean(weights * (limit_state(points) > threshold)))


def apart(limit_state: LimitState, points: Floats, threshold: float, rng: Any) -> float:
    """Return the share of random pairs of `points` for which the point at mean direction and length lacks the event.

    All `points`, (n, inputs), have the event. A large share means that the event has several separate regions.
    """
    first, second = points[rng.integers(len(points), size=(2, _PAIRS))]
    middle, length = first + second, 0.5 * np.linalg.norm([first, second], axis=2).sum(axis=0)
    middle *= (length / np.maximum(np.linalg.norm(middle, axis=1), 1e-300))[:, None]
    return float(np.mean(limit_state(middle) <= threshold))


def repeated(found: Repeat) -> float:
    """Return the share of newly drawn points with the same finite value as another point; the largest of all levels."""
    new = found.values.shape[1] * np.append(1.0, (1.0 - found.shares) * found.accepted)
    different = [len(np.unique(row[np.isfinite(row)])) + np.count_nonzero(np.isinf(row)) for row in found.values]
    return float(np.max(1.0 - np.array(different) / np.maximum(new, 1.0)))
