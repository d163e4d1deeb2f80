"""What is kept of the samples: sums by cell of slip and speed, bins of the curve, and sums of stretches of time.

All of it is of bounded size, and all that least squares over every sample needs: with n, the mean and the scatter of
mu in a cell, and the moments of the slips that it is the mean over, the model's mean there is a two-point Gauss rule,
exact for a cubic; cells are 1/800 of the range wide or less.

The noise of neighbouring samples is correlated: by the observer's filter, by the rig, by the run. So its long-run
variance, that of means over long times, is taken from stretches of time, their number halved whenever they, or their
entries by cell, grow beyond bounds, by adding neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.units import KMH

from .observed import Observed

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SLIP_CELLS = 400
"""Cells over the slip ratio, of equal width in its square root: narrow where the curve rises."""

SPEED_CELL = 10.0 * KMH
_SPEED_CELLS = 80

STRETCH = 5.0
"""Length of the shortest stretches, in time constants of the observer."""

_MOST_STRETCHES = 8192
_MOST_ENTRIES = 1 << 18  # of stretch and cell: 6 MB, and where a log fills many cells, some hundred stretches still

BINS = 50
"""Bins of the curve over slip ratios 0 to 1, as in [Park2008] Fig. 13: to be shown. Fits take the cells, finer ones."""


@dataclass(frozen=True)
class Bins:
    """mu over slip, by bins that hold a sample: arrays of one length, as [Park2008] Fig. 13."""

    low: Floats
    high: Floats
    slip: Floats
    count: Integers
    mean: Floats
    deviation: Floats
    least: Floats
    most: Floats


@dataclass(frozen=True)
class Cells:
    """The cells that hold samples, an array each of one length.

    Attributes
    ----------
    count : number of samples.
    slip, speed, load : mean slip ratio, speed, m/s, and wheel load, N.
    mu, squares : mean of mu, and sum of the squared deviations from it.
    nodes, node_speeds, weights : arrays (2, cells)
        Slip ratios, speeds and weights of the rule that gives the mean of a function over a cell.
    time, slip_gain : seconds, and the slip gained in them.
    """

    count: Floats
    slip: Floats
    speed: Floats
    load: Floats
    mu: Floats
    squares: Floats
    nodes: Floats
    node_speeds: Floats
    weights: Floats
    time: Floats
    slip_gain: Floats


@dataclass(frozen=True)
class Stretches:
    """Sums by stretch of time and cell: entry k holds `count[k]` samples and `total[k]` of mu.

    Attributes
    ----------
    length : float
        Of a stretch, s.
    stretch, cell : array of int
        Which, the cell by its place in `Cells`.
    """

    length: float
    stretch: Integers
    cell: Integers
    count: Floats
    total: Floats


@dataclass(frozen=True)
class SlipCounts:
    """How many samples there are by slip, finely: `counts` in steps of a millionth, so that any slip may part them."""

    counts: Integers

    def parted_at(self, slip: float) -> tuple[int, int]:
        """How many lie below a slip ratio, and how many from there on."""
        below = int(self.counts[: round(slip * _FINE)].sum())
        return below, int(self.counts.sum()) - below


_FINE = 1_000_000
_SUMS = ("count", "slip", "slip2", "slip3", "speed", "slip_speed", "mu", "mu2", "load", "step", "slip_step")


class Accumulator:
    """Sums over samples that come in blocks of any size; the result does not depend on how they come."""

    def __init__(self, time_constant: float) -> None:
        self._length = STRETCH * time_constant
        self._sums = np.zeros((len(_SUMS), SLIP_CELLS * _SPEED_CELLS))
        self._centre = 0.0  # mu is summed about it, so that squares do not cancel
        self._bins = np.zeros((4, BINS))
        self._slips = np.zeros(_FINE, dtype=np.int64)
        self._least, self._most = np.full(BINS, np.inf), np.full(BINS, -np.inf)
        self._keys = np.empty(0, dtype=np.int64)
        self._entries = np.empty((2, 0))
        self._origin: float | None = None

    def add(self, samples: Observed) -> None:
        """Take samples in."""
        if not len(samples):
            return
        if self._origin is None:
            self._origin, self._centre = float(samples.time[0]), float(samples.mu[0])
        cell = _cell(samples)
        mu = samples.mu - self._centre
        values = (
            samples.slip,
            samples.slip2,
            samples.slip3,
            samples.speed,
            samples.slip_speed,
            mu,
            mu**2,
            samples.load,
        )
        for row, weights in enumerate((None, *values, samples.step, samples.slip_step)):
            self._sums[row] += np.bincount(cell, weights, minlength=self._sums.shape[1])
        self._slips += np.bincount((samples.slip * _FINE).astype(np.int64), minlength=_FINE)
        self._add_to_bins(samples, mu)
        self._add_stretches(samples, cell, mu)

    def _add_to_bins(self, samples: Observed, mu: Floats) -> None:
        at = np.minimum((samples.slip * BINS).astype(np.int64), BINS - 1)
        for row, weights in enumerate((None, samples.slip, mu, mu**2)):
            self._bins[row] += np.bincount(at, weights, minlength=BINS)
        np.minimum.at(self._least, at, samples.mu)
        np.maximum.at(self._most, at, samples.mu)

    def _add_stretches(self, samples: Observed, cell: Integers, mu: Floats) -> None:
        assert self._origin is not None
        stretch = ((samples.time - self._origin) / self._length).astype(np.int64)
        keys, entries = _summed(stretch * _CELLS + cell, np.stack([np.ones(len(mu)), mu]))
        self._keys, self._entries = _summed(
            np.concatenate([self._keys, keys]), np.concatenate([self._entries, entries], axis=1)
        )
        while len(self._keys) > _MOST_ENTRIES or len(np.unique(self._keys // _CELLS)) > _MOST_STRETCHES:
            stretch, cell = self._keys // _CELLS, self._keys % _CELLS
            self._length *= 2.0
            self._keys, self._entries = _summed(stretch // 2 * _CELLS + cell, self._entries)

    def bins(self) -> Bins:
        """The curve so far."""
        full = self._bins[0] > 0
        count, slip, total, squares = self._bins[:, full]
        edges = np.arange(BINS + 1) / BINS
        mean = total / count
        variance = np.maximum(squares / count - mean**2, 0.0) * count / np.maximum(count - 1.0, 1.0)
        return Bins(
            low=edges[:-1][full],
            high=edges[1:][full],
            slip=slip / count,
            count=count.astype(np.int64),
            mean=mean + self._centre,
            deviation=np.sqrt(variance),
            least=self._least[full],
            most=self._most[full],
        )

    def slip_counts(self) -> SlipCounts:
        """The counts by slip so far."""
        return SlipCounts(self._slips.copy())

    def cells(self) -> Cells:
        """The cells so far."""
        s = dict(zip(_SUMS, self._sums[:, self._sums[0] > 0], strict=True))
        n = s["count"]
        mean = {name: s[name] / n for name in _SUMS[1:9]}
        nodes, weights = _gauss_rule(mean["slip"], mean["slip2"], mean["slip3"])
        variance = mean["slip2"] - mean["slip"] ** 2
        covariance = mean["slip_speed"] - mean["slip"] * mean["speed"]
        tilt = np.divide(covariance, variance, out=np.zeros_like(n), where=variance > _NO_SPREAD)
        return Cells(
            count=n,
            slip=mean["slip"],
            speed=mean["speed"],
            load=mean["load"],
            mu=mean["mu"] + self._centre,
            squares=np.maximum(s["mu2"] - n * mean["mu"] ** 2, 0.0),
            nodes=nodes,
            node_speeds=np.maximum(mean["speed"] + tilt * (nodes - mean["slip"]), 0.5 * mean["speed"]),
            weights=weights,
            time=s["step"],
            slip_gain=s["slip_step"],
        )

    def stretches(self) -> Stretches:
        """The stretches so far."""
        place = np.cumsum(self._sums[0] > 0) - 1
        count, total = self._entries
        return Stretches(
            length=self._length,
            stretch=self._keys // _CELLS,
            cell=place[self._keys % _CELLS],
            count=count,
            total=total + self._centre * count,
        )


_CELLS = SLIP_CELLS * _SPEED_CELLS

# Spread of slip, squared, that is rounding of moments of slips up to 1, not spread.
_NO_SPREAD = 1e-13


def _cell(samples: Observed) -> Integers:
    slip = np.clip((np.sqrt(samples.slip) * SLIP_CELLS).astype(np.int64), 0, SLIP_CELLS - 1)
    speed = np.clip((samples.speed / SPEED_CELL).astype(np.int64), 0, _SPEED_CELLS - 1)
    return slip * _SPEED_CELLS + speed


def _summed(keys: Integers, values: Floats) -> tuple[Integers, Floats]:
    """The distinct keys in order, and the sums of their columns."""
    distinct, place = np.unique(keys, return_inverse=True)
    return distinct, np.stack([np.bincount(place, row, minlength=len(distinct)) for row in values])


def _gauss_rule(m1: Floats, m2: Floats, m3: Floats) -> tuple[Floats, Floats]:
    """Nodes and weights, (2, n) each, of the two-point rule with the moments 1, m1, m2, m3.

    About the mean, with variance V and third moment T, the nodes solve x^2 - (T/V) x - V = 0.
    """
    variance = np.maximum(m2 - m1**2, 0.0)
    spread = variance > _NO_SPREAD
    third = m3 - 3.0 * m1 * m2 + 2.0 * m1**3
    skew = np.divide(third, 2.0 * variance, out=np.zeros_like(m1), where=spread)
    # a node may not leave the curve's rise for slips below 0: rounding and noise of the moments, not slip
    skew = np.clip(skew, -np.sqrt(variance), np.sqrt(variance))
    root = np.sqrt(skew**2 + variance)
    low, high = skew - root, skew + root
    share = np.divide(high, high - low, out=np.full_like(m1, 0.5), where=spread)
    nodes = np.where(spread, m1 + np.stack([low, high]), m1)
    return np.clip(nodes, 0.0, 1.0), np.stack([share, 1.0 - share])
