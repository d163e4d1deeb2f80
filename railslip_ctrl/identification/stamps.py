"""Time stamps: they must grow, but for one that stands far off by itself, which is left out as an outlier."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.errors import InputError

from .rows import Floats, Lines, Rows

BESIDE = 16
"""Rows on either side among which a stamp that is left out must be the only one out of order."""

FAR = 100.0
"""How far from both its neighbours a stamp that is left out must be, in usual intervals: the median of those beside it.

A stamp that is nearer is a row out of its place, or a clock set back.
"""

_LEAST_BESIDE = 4  # other stamps, without which nothing tells the usual interval
_MOST_NAMED = 5

# A stamp jumps ahead where its step is this many times the way back to the next one; neighbours exchanged have less.
_JUMP = 5.0
_KEPT = 64  # rows judged already: neighbours of those to come, and among them a jump is looked for


class StampFilter:
    """Leaves out rows whose time stamp is an outlier, and refuses time that does not grow without them.

    An outlier is a single stamp that is more than `FAR` usual intervals away from both its neighbours, while without it
    time grows over the `BESIDE` rows on either side of it: a glitch. At the ends of a log it has one neighbour. Two in
    a row, or two within `BESIDE` rows, are a second clock as well, so they are refused; so are a stamp that repeats
    another or steps back by less. A stamp far ahead that time then goes on from is a gap; so is one in the last row,
    and one far behind in the first, as nothing tells it from a pause.

    Rows come in blocks of any size and the result does not depend on it: the last rows wait for the next block.

    Parameters
    ----------
    name : str
        Of the log, for errors.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.count = 0
        self.named: list[str] = []
        self._waiting: Rows | None = None
        self._before = 0  # rows at the front of `_waiting` that are judged already

    def add(self, rows: Rows) -> Rows:
        """The rows that can be judged now, without the outliers; InputError where time does not grow."""
        together = rows if self._waiting is None else self._waiting.then(rows)
        stop = len(together) - BESIDE - 1
        if stop <= self._before:
            self._waiting = together
            return together.part(0, 0)
        return self._judged(together, stop)

    def finish(self) -> Rows | None:
        """The rows that were waiting, at the end of the log; InputError where time does not grow."""
        if self._waiting is None:
            return None
        return self._judged(self._waiting, len(self._waiting))

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was left out, a sentence each."""
        more = self.count - len(self.named)
        return (*self.named, f"{self.count} rows with outlying time stamps in all") if more else tuple(self.named)

    def _judged(self, rows: Rows, stop: int) -> Rows:
        time, start = rows.columns["time"], self._before
        bad = self._outliers(rows.line, time, start, stop)[start:stop]
        found = rows.part(start, stop)
        self.count += int(bad.sum())
        for line, stamp in zip(found.line[bad], found.columns["time"][bad], strict=True):
            if len(self.named) < _MOST_NAMED:
                self.named.append(f"line {line}: time {stamp:.9g} s stands apart from those beside it; it is left out")
        keep_from = max(0, stop - _KEPT)
        self._waiting, self._before = rows.part(keep_from, None), stop - keep_from
        return found.where(~bad) if bad.any() else found

    def _outliers(self, lines: Lines, time: Floats, start: int, stop: int) -> NDArray[np.bool_]:
        """Which stamps are outliers, true for those from `start` to `stop`."""
        bad = np.zeros(len(time), dtype=bool)
        # the step into the first row was judged with the rows before, but tells whether the first row is the outlier
        first, end = max(start - 1, 0), min(stop, len(time) - 1)
        for i in first + np.flatnonzero(time[first + 1 : end + 1] <= time[first:end]):
            outlier = _outlier(time, int(i))
            if outlier is None:
                raise InputError(f"{self.name}: {_complaint(lines, time, int(i) + 1)}; give times that grow")
            bad[outlier] = True
        return bad


def _outlier(time: Floats, i: int) -> int | None:
    """Of the stamps i and i+1, the latter not later, the one that is an outlier; None where neither is."""
    # where both may be, that with two neighbours
    for at in (i, i + 1) if i > 0 else (i + 1, i):
        low = max(at - BESIDE, 0)
        others = np.delete(time[low : at + BESIDE + 1], at - low)
        steps = np.diff(others)
        if len(others) < _LEAST_BESIDE or not (steps > 0.0).all():
            continue
        beside = others[max(at - low - 1, 0) : at - low + 1]
        if np.abs(time[at] - beside).min() > FAR * np.median(steps):
            return at
    return None


def _complaint(lines: Lines, time: Floats, at: int) -> str:
    """What is wrong with the stamp at a place, which is not later than that before it."""
    earlier = np.flatnonzero(time[:at] < time[at])
    sound = int(earlier[-1]) + 1 if len(earlier) else 0  # from here on stamps are later than that at the place
    if 0 < sound < at and time[sound] - time[sound - 1] > _JUMP * (time[at] - time[sound - 1]):
        return (
            f"line {lines[sound]}: time jumps from {time[sound - 1]:.9g} s to {time[sound]:.9g} s, "
            f"but line {lines[at]} has {time[at]:.9g} s"
        )
    kind = "repeats" if time[at] == time[at - 1] else "goes back from"
    return f"line {lines[at]}: time {time[at]:.9g} s {kind} {time[at - 1]:.9g} s"
