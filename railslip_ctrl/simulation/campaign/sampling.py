"""Distributions of a campaign's quantities, and the values that run number i takes.

Every value is a function of the campaign and the run's number alone: nothing is drawn from a shared stream.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property, lru_cache
from itertools import accumulate
from typing import TYPE_CHECKING, Protocol

import numpy as np

from railslip_ctrl.core.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

CUT = 4.0
"""Standard deviations at which a normal distribution ends where no bounds are given: no part has infinite mass."""

_DRAW = 2  # the simulation's random force and noise have the children 0 and 1 of a run's seed
_DESIGN = 2**32 - 1  # the child of the campaign's seed for points that are laid out together; no run has this number


class Sampling(StrEnum):
    """How points are laid out in the unit cube."""

    RANDOM = "random"
    LATIN_HYPERCUBE = "latin-hypercube"
    SOBOL = "sobol"


class Distribution(Protocol):
    """A quantity's distribution, by its quantile function; SI."""

    @property
    def ends(self) -> tuple[float, float]:
        """The least and the greatest value."""

    def at(self, u: float) -> float:
        """The value at a share `u` of the distribution, 0 <= u < 1."""


@dataclass(frozen=True)
class Uniform:
    """Equally likely from `low` to `high`, SI. InputError unless low < high."""

    low: float
    high: float

    def __post_init__(self) -> None:
        _check_order("uniform", self.low, self.high)

    @property
    def ends(self) -> tuple[float, float]:
        return self.low, self.high

    def at(self, u: float) -> float:
        """See `Distribution`."""
        return self.low + u * (self.high - self.low)


@dataclass(frozen=True)
class Normal:
    """Normal with `mean` and standard deviation `std`, SI, cut off at `low` and `high`; left out, at `CUT` deviations.

    InputError for a `std` <= 0 or bounds that leave next to nothing of the distribution.
    """

    mean: float
    std: float
    low: float | None = None
    high: float | None = None

    def __post_init__(self) -> None:
        _check_positive("normal", "std", self.std)
        _check_order("normal", *self.ends)
        _check_reach("normal", self._cut)

    @property
    def ends(self) -> tuple[float, float]:
        low = self.mean - CUT * self.std if self.low is None else self.low
        return low, self.mean + CUT * self.std if self.high is None else self.high

    @property
    def _cut(self) -> tuple[float, float]:
        low, high = self.ends
        return (low - self.mean) / self.std, (high - self.mean) / self.std

    def at(self, u: float) -> float:
        """See `Distribution`."""
        from scipy.special import ndtr, ndtri  # a worker starts half a second sooner without scipy.stats

        (low, high), (least, most) = self._cut, self.ends
        if low > 0.0:  # beyond the mean the other tail has the digits
            above, below = ndtr(-low), ndtr(-high)
            z = -float(ndtri(above - u * (above - below)))
        else:
            below, above = ndtr(low), ndtr(high)
            z = float(ndtri(below + u * (above - below)))
        return min(max(self.mean + self.std * z, least), most)


@dataclass(frozen=True)
class LogNormal:
    """A quantity, SI, with normal logarithm: `median`, and `spread`, the standard deviation of the logarithm.

    Cut off at `low` and `high`; left out, at `CUT` standard deviations. InputError for a median, spread or low that is
    not positive.
    """

    median: float
    spread: float
    low: float | None = None
    high: float | None = None

    def __post_init__(self) -> None:
        _check_positive("lognormal", "median", self.median)
        _check_positive("lognormal", "spread", self.spread)
        if self.low is not None:
            _check_positive("lognormal", "low", self.low)
        _check_order("lognormal", *self.ends)
        _check_reach("lognormal", self._logarithm._cut)

    @property
    def ends(self) -> tuple[float, float]:
        low = self.median * math.exp(-CUT * self.spread) if self.low is None else self.low
        return low, self.median * math.exp(CUT * self.spread) if self.high is None else self.high

    @cached_property
    def _logarithm(self) -> Normal:
        return Normal(math.log(self.median), self.spread, *(math.log(end) for end in self.ends))

    def at(self, u: float) -> float:
        """See `Distribution`."""
        return math.exp(self._logarithm.at(u))


@dataclass(frozen=True)
class Triangular:
    """Most likely at `mode`, falling linearly to `low` and `high`, SI. InputError unless low <= mode <= high."""

    low: float
    mode: float
    high: float

    def __post_init__(self) -> None:
        _check_order("triangular", self.low, self.high)
        if not self.low <= self.mode <= self.high:
            raise InputError(
                f"triangular: mode {self.mode:g} is not allowed; give a value from {self.low:g} to {self.high:g}"
            )

    @property
    def ends(self) -> tuple[float, float]:
        return self.low, self.high

    def at(self, u: float) -> float:
        """See `Distribution`."""
        width, rise, fall = self.high - self.low, self.mode - self.low, self.high - self.mode
        if u * width < rise:
            return self.low + math.sqrt(u * width * rise)
        return self.high - math.sqrt((1.0 - u) * width * fall)


@dataclass(frozen=True)
class Choice:
    """One of some `values`, SI, equally likely or by `weights`, factors > 0.

    InputError for no value, or weights that do not fit.
    """

    values: tuple[float, ...]
    weights: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        _check_values("choice", self.values)
        weights = self.weights
        if weights is not None and (len(weights) != len(self.values) or any(not 0 < w < math.inf for w in weights)):
            raise InputError(
                f"choice: weights {list(weights)} are not allowed; give a value > 0 for each of the values"
            )

    @property
    def ends(self) -> tuple[float, float]:
        return min(self.values), max(self.values)

    def at(self, u: float) -> float:
        """See `Distribution`."""
        upto = list(accumulate(self.weights or (1.0,) * len(self.values)))
        return next((v for v, w in zip(self.values, upto, strict=True) if u * upto[-1] < w), self.values[-1])


@dataclass(frozen=True)
class Grid:
    """Every one of the `values` (SI) in turn, combined with every value of the campaign's other grids.

    InputError for none, or one that is not finite.
    """

    values: tuple[float, ...]

    def __post_init__(self) -> None:
        _check_values("grid", self.values)

    @property
    def ends(self) -> tuple[float, float]:
        return min(self.values), max(self.values)

    def at(self, u: float) -> float:
        """See `Distribution`."""
        return self.values[min(int(u * len(self.values)), len(self.values) - 1)]


def grid_points(distributions: Sequence[Distribution]) -> int:
    """Combinations of all grids; 1 without any."""
    return math.prod(len(d.values) for d in distributions if isinstance(d, Grid))


def draw(distributions: Sequence[Distribution], sampling: Sampling, runs: int, seed: int, i: int) -> tuple[float, ...]:
    """The values of run number i, in the order of the distributions.

    The grids' point is i modulo their number of points, the first grid's value changing fastest.
    """
    shares = iter(_shares(sum(not isinstance(d, Grid) for d in distributions), sampling, runs, seed, i))
    point, values = i % grid_points(distributions), []
    for distribution in distributions:
        if isinstance(distribution, Grid):
            point, place = divmod(point, len(distribution.values))
            values.append(distribution.values[place])
        else:
            values.append(distribution.at(float(next(shares))))
    return tuple(values)


def _shares(count: int, sampling: Sampling, runs: int, seed: int, i: int) -> Floats:
    """Point number i of the unit cube."""
    if count == 0 or sampling is Sampling.RANDOM:
        return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i, _DRAW))).random(count)
    from scipy.stats import qmc

    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_DESIGN,)))
    if sampling is Sampling.SOBOL:
        points = qmc.Sobol(count, rng=rng)
        if i:  # SciPy has no way forward by nothing
            points.fast_forward(i)
        shares: Floats = points.random(1)[0]
        return shares
    point: Floats = _latin_hypercube(count, runs, seed)[i]
    return point


@lru_cache(maxsize=4)
def _latin_hypercube(count: int, runs: int, seed: int) -> Floats:
    """All points: each depends on every other, so that they are made together (8 bytes a number)."""
    from scipy.stats import qmc

    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_DESIGN,)))
    points: Floats = qmc.LatinHypercube(count, rng=rng).random(runs)
    return points


def _check_order(kind: str, low: float, high: float) -> None:
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise InputError(f"{kind}: from {low:g} to {high:g} is not allowed; give finite bounds, low < high")


def _check_positive(kind: str, name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"{kind}: {name} {value:g} is not allowed; give a finite value > 0")


def _check_reach(kind: str, cut: tuple[float, float]) -> None:
    """A tail beyond 8 standard deviations (1e-15) is no distribution of a measured quantity but a slip of the pen."""
    if cut[0] > 8.0 or cut[1] < -8.0:
        raise InputError(f"{kind}: the bounds leave nothing of the distribution; give bounds nearer to its middle")


def _check_values(kind: str, values: tuple[float, ...]) -> None:
    if not values or not all(map(math.isfinite, values)):
        raise InputError(f"{kind}: values {list(values)} are not allowed; give at least one, all finite")
