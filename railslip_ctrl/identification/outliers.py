"""Values that stand out from their neighbours: the Hampel filter, over rows that come in blocks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .resolution import Resolution
from .rows import Rows

Floats = NDArray[np.float64]

HALF_WINDOW = 4
"""Rows on either side with which a row is compared."""

BESIDE = 64
"""Rows before a row, and as many after it, whose noise it is compared with."""

# All of them must be passed. Of normal noise one row in some 200 passes the local limit, as the spread of nine values
# is a poor estimate: it is there for slopes and corners. The overall limit is of the log's first rows, and a wheel
# under brake is noisier than when it rolled there. What then guards a row is the spread beside it, on the side where it
# is larger, as braking begins between two rows. The median S of 64 absolute normal deviates has P(S < x) = P(Bin(64,
# 2 Phi(x) - 1) > 32), so that a deviate exceeds 8 * 1.4826 times the larger S of two sides with probability 1e-11, and
# that of one side, at the end of a noisier stretch, with 1e-8 (a test integrates both): at 10 million rows of three
# columns no false outlier is to be expected.
_LOCAL_LIMIT = 6.0
_OVERALL_LIMIT = 8.0
_BESIDE_LIMIT = 8.0
_SIGMA_PER_MAD = 1.4826

_REACH = BESIDE + HALF_WINDOW  # rows that a judgement needs on either side

# What is never an outlier, m/s and N*m (rad/s: of a wheel of 0.5 m): resolution of the usual pickups.
_FLOOR = {"train_speed": 0.1, "wheel_speed": 0.1, "wheel_angular_speed": 0.2, "brake_torque": 50.0}

# Steps in which a column's values come: rounding puts a value and the median of its neighbours half a step off each,
# and a count more or less is another two, so that what is further off is none of it.
_LEAST_STEPS = 3.5

PIECE = 4096
"""Rows judged together: from the first, the noise of the log is known."""


class OutlierFilter:
    """Leaves out rows where a speed or the torque deviates from the median of its neighbours far beyond the noise.

    Rows come in blocks of any size and the result does not depend on it: they wait until there are `PIECE` of them, or
    the log ends. `count` and `first_line` tell what was left out, `resolution` the steps in which values come.
    """

    def __init__(self) -> None:
        self.count = 0
        self.first_line: int | None = None
        self.resolution = Resolution()
        self._waiting: Rows | None = None
        self._scale: dict[str, float] = {}
        self._before = 0  # rows at the front of `_waiting` that are there as neighbours only

    def add(self, rows: Rows) -> Rows:
        """The rows that can be judged now, without the outliers."""
        together = rows if self._waiting is None else self._waiting.then(rows)
        return self._judged(together, (len(together) - self._before - _REACH) // PIECE * PIECE)

    def finish(self) -> Rows | None:
        """The rows that were waiting, at the end of the log."""
        if self._waiting is None:
            return None
        return self._judged(self._waiting, len(self._waiting) - self._before)

    def _judged(self, rows: Rows, count: int) -> Rows:
        """So many of the rows, without the outliers, piece by piece; the others wait."""
        start, stop = self._before, self._before + max(count, 0)
        bad = np.zeros(stop, dtype=bool)
        for first in range(start, stop, PIECE):
            last = min(first + PIECE, stop)
            low = max(first - _REACH, 0)
            bad[first:last] = self._outliers(rows.part(low, last + _REACH))[first - low : last - low]
        bad = bad[start:]
        if bad.any():
            self.count += int(bad.sum())
            if self.first_line is None:
                self.first_line = int(rows.line[start:stop][bad][0])
        keep_from = max(0, stop - _REACH)
        self._waiting, self._before = rows.part(keep_from, None), stop - keep_from
        return rows.part(start, stop).where(~bad)

    def _outliers(self, rows: Rows) -> NDArray[np.bool_]:
        bad = np.zeros(len(rows), dtype=bool)
        for name in _FLOOR.keys() & rows.columns.keys():
            values = rows.columns[name]
            self.resolution.add(name, values)
            bad |= self._stands_out(name, values)
        return bad

    def _stands_out(self, name: str, values: Floats) -> NDArray[np.bool_]:
        deviation = np.abs(values - _median(values))
        if name not in self._scale:
            self._scale[name] = _SIGMA_PER_MAD * float(np.median(deviation))
        least = max(_OVERALL_LIMIT * self._scale[name], _FLOOR[name], _LEAST_STEPS * self.resolution[name])
        bad: NDArray[np.bool_] = deviation > least
        limits = ((_LOCAL_LIMIT, values, _local_spread), (_BESIDE_LIMIT, deviation, _spread_beside))
        for limit, of, spread in limits:
            at = np.flatnonzero(bad)
            bad[at] = deviation[at] > limit * _SIGMA_PER_MAD * spread(of, at)
        return bad


def _median(values: Floats) -> Floats:
    """The median of every value's window; at the ends the window is mirrored."""
    from scipy.ndimage import median_filter

    result: Floats = median_filter(values, size=2 * HALF_WINDOW + 1, mode="reflect")
    return result


def _local_spread(values: Floats, at: NDArray[np.intp]) -> Floats:
    """Median absolute deviation from the median in the windows of some values."""
    padded = np.pad(values, HALF_WINDOW, mode="symmetric")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * HALF_WINDOW + 1)[at]
    result: Floats = np.median(np.abs(windows - np.median(windows, axis=1, keepdims=True)), axis=1)
    return result


def _spread_beside(deviation: Floats, at: NDArray[np.intp]) -> Floats:
    """Median of the deviations before some rows, or of those after them where it is larger."""
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(deviation, BESIDE, mode="symmetric"), BESIDE)
    result: Floats = np.maximum(np.median(windows[at], axis=1), np.median(windows[at + BESIDE + 1], axis=1))
    return result
