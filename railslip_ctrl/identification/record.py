"""Rows under brake kept as they came, as many as are allowed: what a fit along the motion needs (`prediction`).

Whole runs are kept, from the brake's application to its release. When there are more rows than `MOST_ROWS`, every
second run is dropped, again and again, so that what stays is spread over the whole log.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

MOST_ROWS = 20_000
"""Rows kept; a hundred rig tests at 100 rows a second."""

_LONGEST_RUN = 4096  # rows; a longer run is cut, so that one run cannot take all the room for ever


@dataclass(frozen=True)
class Record:
    """Rows under brake: arrays of one length; s, m/s, rad/s, N*m, N, and the number of the run a row belongs to."""

    time: Floats
    speed: Floats
    omega: Floats
    torque: Floats
    load: Floats
    run: Floats

    def __len__(self) -> int:
        return len(self.time)


class Recorder:
    """Takes rows that come in blocks of any size; the record does not depend on how they come."""

    def __init__(self, most_rows: int = MOST_ROWS) -> None:
        self._most = most_rows
        self._stride = 1
        self._kept = np.empty((6, 0))
        self._run, self._place = -1, 0  # of the last row used: its run, and its place in it
        self._last_used = False

    def add(self, rows: Floats, used: NDArray[np.bool_], apart: NDArray[np.bool_]) -> None:
        """Take in rows (5 by k, the columns of `Record`), which are used, and which stand after a gap."""
        if not used.any():
            self._last_used = bool(used[-1]) if used.size else self._last_used
            return
        follows = used & np.concatenate([[self._last_used], used[:-1]]) & ~apart
        index = np.arange(used.size)
        start = np.maximum.accumulate(np.where(used & ~follows, index, -1))
        place = np.where(start >= 0, index - start, self._place + 1 + index)
        begins = used & (~follows | (place % _LONGEST_RUN == 0))
        run = self._run + np.cumsum(begins)
        self._run, self._place, self._last_used = int(run[-1]), int(place[-1]), bool(used[-1])
        keep = used & (run % self._stride == 0)
        self._kept = np.concatenate([self._kept, np.vstack([rows[:, keep], run[keep]])], axis=1)
        while self._kept.shape[1] > self._most and self._stride <= self._run:
            self._stride *= 2
            self._kept = self._kept[:, self._kept[5] % self._stride == 0]

    @property
    def stride(self) -> int:
        """Of how many runs one is kept."""
        return self._stride

    def record(self) -> Record:
        """The rows kept so far."""
        return Record(*self._kept)
