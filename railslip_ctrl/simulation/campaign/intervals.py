"""Estimates with their confidence intervals."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

CONFIDENCE = 0.95
"""Of every interval."""


class Estimate(NamedTuple):
    """A value and the bounds of its interval; an infinite bound: too few runs to say."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Moments:
    """Count, mean and sum of squares about it, of data that comes in parts (Chan, Golub and LeVeque 1979)."""

    count: int = 0
    mean: float = 0.0
    squares: float = 0.0
    low: float = math.inf
    high: float = -math.inf

    def joined(self, other: Moments) -> Moments:
        """Those of both together."""
        count = self.count + other.count
        if count == 0:
            return self
        step = other.mean - self.mean
        return Moments(
            count,
            self.mean + step * other.count / count,
            self.squares + other.squares + step * step * self.count * other.count / count,
            min(self.low, other.low),
            max(self.high, other.high),
        )

    @property
    def std(self) -> float:
        """Standard deviation, of a sample; NaN below two values."""
        return math.sqrt(self.squares / (self.count - 1)) if self.count > 1 else math.nan

    @property
    def estimate(self) -> Estimate:
        """The mean with Student's interval; NaN without values."""
        if self.count == 0:
            return Estimate(math.nan, math.nan, math.nan)
        if self.count == 1:
            return Estimate(self.mean, -math.inf, math.inf)
        from scipy import stats

        half = float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, self.count - 1)) * self.std / math.sqrt(self.count)
        return Estimate(self.mean, self.mean - half, self.mean + half)


def share(count: int, total: int) -> Estimate:
    """A share with Wilson's interval; NaN of nothing."""
    if total == 0:
        return Estimate(math.nan, math.nan, math.nan)
    from scipy import stats

    interval = stats.binomtest(count, total).proportion_ci(CONFIDENCE, method="wilson")
    return Estimate(count / total, float(interval.low), float(interval.high))


def quantile_ranks(level: float, count: int) -> tuple[int, int | None, int | None]:
    """Ranks (0 the smallest) of a quantile and of its interval's bounds; None where `count` values give no bound.

    The number of values below the quantile is binomial, whatever the distribution: the interval holds it with at
    least the confidence asked for (Conover, Practical Nonparametric Statistics, 3.2).
    """
    from scipy import stats

    tail = 0.5 * (1.0 - CONFIDENCE)
    low = int(stats.binom.ppf(tail, count, level)) - 1
    high = int(stats.binom.ppf(1.0 - tail, count, level))
    # a product such as 0.07 * 100 may round up past the whole number it is
    own = min(max(math.ceil(round(level * count, 9)) - 1, 0), count - 1)
    return own, (low if low >= 0 else None), (high if high < count else None)
