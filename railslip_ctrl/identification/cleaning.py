"""Rows made good: stray time stamps and outliers left out, columns brought to one time and one zero.

Each works on rows that come in blocks of any size, and what comes out does not depend on the blocks.
"""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.arguments import Flags, Floats
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import shown
from railslip_ctrl.core.user_files import close_match

from .logs import UNITS, Lines, Rows


class RowFilter(ABC):
    """Leaves out rows by comparing them with those beside them; `count` tells how many.

    A row's judgement needs so many rows `ahead` and `behind`; the rows of a `piece` are judged together.
    """

    ahead: ClassVar[int]
    behind: ClassVar[int]
    piece: ClassVar[int]

    def __init__(self) -> None:
        self.count = 0

    def rows(self, blocks: Iterator[Rows]) -> Iterator[Rows]:
        """The rows that stay; the last ones wait for those after them, or for the log's end."""
        waiting: Rows | None = None
        start = 0  # rows at the front of those waiting that are judged already
        for block in itertools.chain(blocks, (None,)):
            if block is not None:
                waiting = block if waiting is None else waiting.then(block)
            if waiting is None:
                return
            ready = len(waiting) - start
            if block is not None:
                ready = max(ready - self.ahead, 0) // self.piece * self.piece
            stop = start + ready
            bad = self._bad(waiting, start, stop)
            self.count += int(bad.sum())
            yield waiting.part(start, stop).where(~bad)
            keep = max(0, stop - self.behind)
            waiting, start = waiting.part(keep, None), stop - keep

    @abstractmethod
    def _bad(self, rows: Rows, start: int, stop: int) -> Flags:
        """Which of the rows from start to stop are left out."""


# --- time stamps ---------------------------------------------------------------------------------------------------

BESIDE = 16  #: rows on either side among which a stamp that is left out must be the only one out of order

FAR = 100.0
"""How far from both its neighbours a stamp that is left out must be, in usual intervals: the median of those beside it.

A stamp that is nearer is a row out of its place, or a clock set back.
"""

_LEAST_BESIDE = 4  # other stamps, without which nothing tells the usual interval

# A stamp jumps ahead where its step is this many times the way back to the next one; neighbours exchanged have less.
_JUMP = 5.0
_STAMPS_KEPT = 64  # rows judged already, among which a jump is looked for
_MOST_NAMED = 5


class StampFilter(RowFilter):
    """Leaves out rows whose time stamp is an outlier, and refuses time that does not grow without them.

    An outlier is a single stamp more than `FAR` usual intervals away from both its neighbours (at an end of a log: from
    one), without which time grows over the `BESIDE` rows on either side. Two within `BESIDE` rows are a second clock,
    and refused, as is a stamp that repeats another or steps back by less. A stamp far ahead that time goes on from is a
    gap; so is one in the last row, and one far behind in the first. `name` is the log's, for errors.
    """

    ahead, behind, piece = BESIDE + 1, _STAMPS_KEPT, 1

    def __init__(self, name: str) -> None:
        super().__init__()
        self.name = name
        self.named: list[str] = []

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was left out, a sentence each."""
        more = self.count - len(self.named)
        return (*self.named, f"{self.count} rows with outlying time stamps in all") if more else tuple(self.named)

    def _bad(self, rows: Rows, start: int, stop: int) -> Flags:
        bad, time = np.zeros(len(rows), dtype=bool), rows.columns["time"]
        # the step into the first row was judged with the rows before, but tells whether the first row is the outlier
        first, end = max(start - 1, 0), min(stop, len(time) - 1)
        for i in first + np.flatnonzero(time[first + 1 : end + 1] <= time[first:end]):
            outlier = _outlier(time, int(i))
            if outlier is None:
                raise InputError(f"{self.name}: {_complaint(rows.line, time, int(i) + 1)}; give times that grow")
            bad[outlier] = True
        for at in start + np.flatnonzero(bad[start:stop]):
            if len(self.named) < _MOST_NAMED:
                where = f"line {rows.line[at]}: time {time[at]:.9g} s"
                self.named.append(f"{where} stands apart from those beside it; it is left out")
        return bad[start:stop]


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


# --- the steps in which values come --------------------------------------------------------------------------------

# Second differences: of values in steps they are whole steps, of a straight ramp they are 0, so that a ramp is
# not taken for a staircase. 0 is what rounding leaves of the values.
_ROUNDING = 1e-7
_LEAST_CHANGES = 20
_LEAST_SHARE = 0.01  # of the rows: fewer are the corners of ramps

# The step is the largest of these quantiles of the differences in which all but a few of them are whole numbers: the
# least ones may be of a glitch. Of differences without a step a fifth would be within this tolerance of one.
_QUANTILES = (0.0, 0.01, 0.03, 0.1, 0.3, 0.5)
_TOLERANCE = 0.1
_WHOLE_SHARE = 0.95
_FEW = 20.0  # steps: of larger differences, uneven intervals of an encoder blur the step


def step_of(values: Floats) -> float:
    """The step in which some values, in the order they came, change; 0 where they show none."""
    changes = np.abs(np.diff(values, 2))
    changes = changes[changes > _ROUNDING * np.abs(values).max(initial=0.0)]
    if len(changes) < max(_LEAST_CHANGES, _LEAST_SHARE * len(values)):
        return 0.0
    return max((float(step) for step in np.quantile(changes, _QUANTILES) if _comes_in(changes, step)), default=0.0)


def _comes_in(changes: Floats, step: float) -> bool:
    counts = changes[changes < _FEW * step] / step
    whole = np.abs(counts - np.round(counts)) < _TOLERANCE
    # below half a step a difference is none of it
    return bool(len(counts) >= _LEAST_CHANGES and np.mean(whole & (counts > 0.5)) >= _WHOLE_SHARE)


class Resolution:
    """Steps of the columns of a log, from pieces of it: the least that any piece shows, as a piece may miss some."""

    def __init__(self) -> None:
        self._steps: dict[str, float] = {}

    def add(self, name: str, values: Floats) -> None:
        """Take a piece of a column in."""
        step = step_of(values)
        if step > 0.0:
            self._steps[name] = min(step, self._steps.get(name, step))

    def __getitem__(self, name: str) -> float:
        """The step of a column, SI; 0 where none was seen."""
        return self._steps.get(name, 0.0)


# --- outliers ------------------------------------------------------------------------------------------------------

HALF_WINDOW = 4  #: rows on either side with which a row is compared

NOISE_ROWS = 64  #: rows before a row, and as many after it, whose noise it is compared with

# All of them must be passed. Of normal noise one row in some 200 passes the local limit, as the spread of nine values
# is a poor estimate: it is there for slopes and corners. The overall limit is of the log's first rows, and a wheel
# under brake is noisier than when it rolled there. What then guards a row is the spread beside it, on the side where it
# is larger, as braking begins between two rows. The median S of 64 absolute normal deviates has P(S < x) = P(Bin(64,
# 2 Phi(x) - 1) > 32), so that a deviate exceeds 8 * 1.4826 times the larger S of two sides with probability 1e-11, and
# that of one side, at the end of a noisier stretch, with 1e-8: at 10 million rows of three
# columns no false outlier is to be expected.
_LOCAL_LIMIT = 6.0
_OVERALL_LIMIT = 8.0
_BESIDE_LIMIT = 8.0
_SIGMA_PER_MAD = 1.4826

_REACH = NOISE_ROWS + HALF_WINDOW  # rows that a judgement needs on either side

# What is never an outlier, m/s and N*m (rad/s: of a wheel of 0.5 m): resolution of the usual pickups.
_FLOOR = {"train_speed": 0.1, "wheel_speed": 0.1, "wheel_angular_speed": 0.2, "brake_torque": 50.0}

# Steps in which a column's values come: rounding puts a value and the median of its neighbours half a step off each,
# and a count more or less is another two, so that what is further off is none of it.
_LEAST_STEPS = 3.5

PIECE = 4096  #: rows judged together: from the first, the noise of the log is known


class OutlierFilter(RowFilter):
    """Leaves out rows where a speed or the torque deviates from the median of its neighbours far beyond the noise.

    The Hampel filter. `first_line` tells the first that was left out, `resolution` the steps in which values come.
    """

    ahead = behind = _REACH
    piece = PIECE

    def __init__(self) -> None:
        super().__init__()
        self.first_line: int | None = None
        self.resolution = Resolution()
        self._scale: dict[str, float] = {}

    def _bad(self, rows: Rows, start: int, stop: int) -> Flags:
        bad = np.zeros(stop, dtype=bool)
        for first in range(start, stop, self.piece):
            last, low = min(first + self.piece, stop), max(first - _REACH, 0)
            bad[first:last] = self._outliers(rows.part(low, last + _REACH))[first - low : last - low]
        if self.first_line is None and bad[start:].any():
            self.first_line = int(rows.line[np.argmax(bad)])
        return bad[start:]

    def _outliers(self, rows: Rows) -> Flags:
        bad = np.zeros(len(rows), dtype=bool)
        for name in _FLOOR.keys() & rows.columns.keys():
            values = rows.columns[name]
            self.resolution.add(name, values)
            bad |= self._stands_out(name, values)
        return bad

    def _stands_out(self, name: str, values: Floats) -> Flags:
        from scipy.ndimage import median_filter

        deviation: Floats = np.abs(values - median_filter(values, size=2 * HALF_WINDOW + 1, mode="reflect"))
        if name not in self._scale:
            self._scale[name] = _SIGMA_PER_MAD * float(np.median(deviation))
        least = max(_OVERALL_LIMIT * self._scale[name], _FLOOR[name], _LEAST_STEPS * self.resolution[name])
        bad: Flags = deviation > least
        limits = ((_LOCAL_LIMIT, values, _local_spread), (_BESIDE_LIMIT, deviation, _spread_beside))
        for limit, of, spread in limits:
            at = np.flatnonzero(bad)
            bad[at] = deviation[at] > limit * _SIGMA_PER_MAD * spread(of, at)
        return bad


def _local_spread(values: Floats, at: NDArray[np.intp]) -> Floats:
    """Median absolute deviation from the median in the windows of some values."""
    padded = np.pad(values, HALF_WINDOW, mode="symmetric")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * HALF_WINDOW + 1)[at]
    return np.median(np.abs(windows - np.median(windows, axis=1, keepdims=True)), axis=1)


def _spread_beside(deviation: Floats, at: NDArray[np.intp]) -> Floats:
    """Median of the deviations before some rows, or of those after them where it is larger."""
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(deviation, NOISE_ROWS, mode="symmetric"), NOISE_ROWS)
    return np.maximum(np.median(windows[at], axis=1), np.median(windows[at + NOISE_ROWS + 1], axis=1))


# --- alignment -----------------------------------------------------------------------------------------------------

LONGEST_DELAY = 2.0  #: s, of a column; what is later is another event, not a delay

_WHEEL = ("wheel_angular_speed", "wheel_speed")  # the first of them in a log is the one used


def corrections_told(delays: Mapping[str, float], zeros: Mapping[str, float]) -> tuple[str, ...]:
    """The options by which a log is corrected, as they were given, in one sentence if any."""
    given = [f"`delays` {name}={delay:g}" for name, delay in delays.items()]
    given += [f"`zeros` {name}={zero:g}" for name, zero in zeros.items()]
    return (f"the rows are corrected by {', '.join(given)}",) if given else ()


def check_corrections(delays: Mapping[str, float], zeros: Mapping[str, float]) -> None:
    """InputError unless delays (s) and zeros (SI) are of quantities of a log, and in range."""
    known = tuple(name for name in UNITS if name != "time")
    for option, given in (("`delays`", delays), ("`zeros`", zeros)):
        for name, value in given.items():
            if name not in known:
                hint = close_match(name, known)
                raise InputError(
                    f"{option}: {shown(name)} is no quantity of a log; {hint}choose one of {', '.join(known)}"
                )
            if not math.isfinite(value):
                raise InputError(f"{option} {name}: {value:g} is not allowed; give a finite value")
    for name, delay in delays.items():
        if abs(delay) > LONGEST_DELAY:
            raise InputError(f"`delays` {name}: {delay:g} s is not allowed; give at most {LONGEST_DELAY:g} s each way")


class Alignment:
    """The rows of a log with sensor offsets taken off and the delays of the columns made equal.

    An encoder's speed, a difference of counts, is the mean over its interval and so half an interval late; a filtered
    torque is late by its filter. Only the difference in delay counts, so the wheel's samples, whose noise a
    prediction-error fit is to see, stay as they are, and the others, which are smooth, are read off between theirs.
    `delays`, s, and `zeros`, SI, are by quantity; `name` is the log's. InputError for a quantity that it does not have.
    """

    def __init__(self, delays: Mapping[str, float], zeros: Mapping[str, float], name: str) -> None:
        self._delays, self._zeros, self._name = dict(delays), dict(zeros), name
        self._held: Rows | None = None  # what later rows are read off from, and rows that wait for them
        self._told = 0  # rows of these that were given out

    def rows(self, blocks: Iterator[Rows]) -> Iterator[Rows]:
        """The rows of the blocks, corrected; none is lost."""
        if not (self._delays or self._zeros):
            yield from blocks
            return
        for rows in blocks:
            for name in (*self._delays, *self._zeros):
                if name not in rows.columns:
                    raise InputError(f"{self._name}: no column {name} to correct; it has {', '.join(rows.columns)}")
            columns = {name: values - self._zeros.get(name, 0.0) for name, values in rows.columns.items()}
            rows = Rows(rows.line, columns)
            held = rows if self._held is None else self._held.then(rows)
            time = held.columns["time"]
            known = time[-1] - max(0.0, *self._shifts(held).values()) if len(time) else 0.0
            yield self._given(held, int(np.searchsorted(time, known, side="right")))
        if self._held is not None:
            yield self._given(self._held, len(self._held))

    def _shifts(self, rows: Rows) -> dict[str, float]:
        """By how much later than the wheel's sample each column shows the same moment, s."""
        wheel = next(name for name in _WHEEL if name in rows.columns)
        late = self._delays.get(wheel, 0.0)
        return {n: self._delays.get(n, 0.0) - late for n in rows.columns if n not in ("time", *_WHEEL)}

    def _given(self, held: Rows, stop: int) -> Rows:
        """The rows up to a place among those held; what later ones are not read off from is forgotten."""
        stop = max(stop, self._told)
        time, shifts = held.columns["time"], self._shifts(held)
        out = held.part(self._told, stop)
        moved = {
            name: np.interp(out.columns["time"] + shift, time, held.columns[name])
            for name, shift in shifts.items()
            if shift and len(out)
        }
        behind = max(0.0, *(-shift for shift in shifts.values()))
        keep = max(int(np.searchsorted(time, time[min(stop, len(time) - 1)] - behind)) - 1, 0) if len(time) else 0
        self._held, self._told = held.part(keep, None), stop - keep
        return Rows(out.line, {**out.columns, **moved})
