"""Clean a log: remove stray time stamps and outliers, correct sensor offsets and delays between columns.

The filters work on blocks of rows; their results do not depend on the block size.
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
    """Drops rows of a log after a comparison with their neighbours; `count` is the number of dropped rows."""

    ahead: ClassVar[int]  # number of later rows needed to judge a row
    behind: ClassVar[int]  # number of earlier rows needed to judge a row
    piece: ClassVar[int]  # number of rows judged together

    def __init__(self) -> None:
        self.count = 0

    def rows(self, blocks: Iterator[Rows]) -> Iterator[Rows]:
        waiting: Rows | None = None
        start = 0  # number of rows at the front of `waiting` that were judged before
        for block in itertools.chain(blocks, (None,)):
            if block is not None:
                waiting = block if waiting is None else waiting.then(block)
            if waiting is None:
                return
            ready = len(waiting) - start
            if block is not None:
                ready = max(ready - self.ahead, 0) // self.piece * self.piece
            stop = start + ready
            bad = self._dropped(waiting, start, stop)
            self.count += int(bad.sum())
            yield waiting.part(start, stop).where(~bad)
            keep = max(0, stop - self.behind)
            waiting, start = waiting.part(keep, None), stop - keep

    @abstractmethod
    def _dropped(self, rows: Rows, start: int, stop: int) -> Flags:
        """Return, for each row from `start` to `stop`, True if the row is to be dropped."""


# --- time stamps ---------------------------------------------------------------------------------------------------

BESIDE = 16  #: rows on either side of an outlying time stamp, among which no other stamp may be out of order

FAR_STAMP = 100.0  #: least distance of an outlying time stamp from its neighbours, in median intervals of nearby rows

_LEAST_BESIDE = 4  # neighbouring stamps needed to estimate the usual interval
_JUMP = 5.0  # least ratio of a jump forward to the step back after it; swapped rows have a smaller ratio
_STAMPS_KEPT = 64  # judged rows that are kept, to find the line of a jump
_MOST_NAMED = 5  # stamps that have a warning of their own


class StampFilter(RowFilter):
    """Drops rows with an outlying time stamp; raises InputError if the remaining time stamps do not increase.

    A time stamp out of order is an outlier if it is more than `FAR_STAMP` usual intervals away from both neighbours,
    and if the `BESIDE` time stamps on either side increase once the outlier is removed. A long step forward is a
    gap, not an outlier, if all later time stamps increase. `name` is the name of the log in messages.
    """

    ahead, behind, piece = BESIDE + 1, _STAMPS_KEPT, 1

    def __init__(self, name: str) -> None:
        super().__init__()
        self.name = name
        self.named: list[str] = []

    @property
    def warnings(self) -> tuple[str, ...]:
        more = self.count - len(self.named)
        return (*self.named, f"{self.count} rows with outlying time stamps in all") if more else tuple(self.named)

    def _dropped(self, rows: Rows, start: int, stop: int) -> Flags:
        bad, time = np.zeros(len(rows), dtype=bool), rows.columns["time"]
        # include the step to the first row, although it was checked before: the first row itself may be the outlier
        first, end = max(start - 1, 0), min(stop, len(time) - 1)
        for i in first + np.flatnonzero(time[first + 1 : end + 1] <= time[first:end]):
            outlier = _outlier(time, int(i))
            if outlier is None:
                raise InputError(f"{self.name}: {_time_fault(rows.line, time, int(i) + 1)}; give increasing times")
            bad[outlier] = True
        for at in start + np.flatnonzero(bad[start:stop]):
            if len(self.named) < _MOST_NAMED:
                where = f"line {rows.line[at]}: time {time[at]:.9g} s"
                self.named.append(f"{where} is far from its neighbours; the row is left out")
        return bad[start:stop]


def _outlier(time: Floats, i: int) -> int | None:
    """Return the index of the outlier among the time stamps i and i + 1; None if neither is an outlier."""
    # if both qualify, the stamp with two neighbours is taken
    for at in (i, i + 1) if i > 0 else (i + 1, i):
        low = max(at - BESIDE, 0)
        others = np.delete(time[low : at + BESIDE + 1], at - low)
        steps = np.diff(others)
        if len(others) < _LEAST_BESIDE or not (steps > 0.0).all():
            continue
        beside = others[max(at - low - 1, 0) : at - low + 1]
        if np.abs(time[at] - beside).min() > FAR_STAMP * np.median(steps):
            return at
    return None


def _time_fault(lines: Lines, time: Floats, at: int) -> str:
    earlier = np.flatnonzero(time[:at] < time[at])
    # the stamps from `jump` to `at` - 1 are not earlier than the stamp at `at`
    jump = int(earlier[-1]) + 1 if len(earlier) else 0
    if 0 < jump < at and time[jump] - time[jump - 1] > _JUMP * (time[at] - time[jump - 1]):
        return (
            f"line {lines[jump]}: time jumps from {time[jump - 1]:.9g} s to {time[jump]:.9g} s, "
            f"but line {lines[at]} has {time[at]:.9g} s"
        )
    kind = "repeats" if time[at] == time[at - 1] else "goes back from"
    return f"line {lines[at]}: time {time[at]:.9g} s {kind} {time[at - 1]:.9g} s"


# --- resolution of the columns -------------------------------------------------------------------------------------

# The resolution comes from second differences. For quantised values they are multiples of the step. On a straight ramp
# they are 0, so that a ramp does not look quantised.
_ROUNDING = 1e-7  # relative to the largest value; smaller differences are rounding errors
_LEAST_CHANGES = 20  # nonzero differences needed for an estimate
_LEAST_SHARE = 0.01  # of the rows; fewer nonzero differences may be the corners of ramps

# Nearly all differences must be multiples of the step. The step is the largest of these quantiles of the differences
# that meets this condition. The smallest difference alone is not used, because it may come from a glitch.
_QUANTILES = (0.0, 0.01, 0.03, 0.1, 0.3, 0.5)
_TOLERANCE = 0.1  # largest deviation from a multiple, in steps; a fifth of unquantised differences deviate by less
_WHOLE_SHARE = 0.95  # share of the differences that must be multiples
_MOST_STEPS = 20.0  # in steps; larger differences are not used, because an encoder's uneven intervals blur them


def step_of(values: Floats) -> float:
    """Quantisation step of a sequence of values; 0 if the values do not look quantised."""
    changes = np.abs(np.diff(values, 2))
    changes = changes[changes > _ROUNDING * np.abs(values).max(initial=0.0)]
    if len(changes) < max(_LEAST_CHANGES, _LEAST_SHARE * len(values)):
        return 0.0
    return max((float(step) for step in np.quantile(changes, _QUANTILES) if _are_multiples(changes, step)), default=0.0)


def _are_multiples(changes: Floats, step: float) -> bool:
    counts = changes[changes < _MOST_STEPS * step] / step
    whole = np.abs(counts - np.round(counts)) < _TOLERANCE
    # a difference below half a step is not a multiple of the step
    return bool(len(counts) >= _LEAST_CHANGES and np.mean(whole & (counts > 0.5)) >= _WHOLE_SHARE)


class Resolution:
    """Quantisation step of each column of a log, SI, by quantity; 0 if the column does not look quantised."""

    def __init__(self) -> None:
        self._steps: dict[str, float] = {}

    def add(self, name: str, values: Floats) -> None:
        step = step_of(values)
        if step > 0.0:
            self._steps[name] = min(step, self._steps.get(name, step))

    def __getitem__(self, name: str) -> float:
        return self._steps.get(name, 0.0)


# --- outliers ------------------------------------------------------------------------------------------------------

HALF_WINDOW = 4  #: rows on either side; a row is compared with the median of this window

NOISE_ROWS = 64  #: rows before and after a row from which the noise near it is estimated

# An outlier exceeds three limits, each in standard deviations of the noise.
# - Local limit, by the spread in the window of nine rows: it keeps rows on slopes and at corners.
# - Overall limit, by the noise of the log's first rows, usually free rolling. Under brake the noise is higher.
# - Beside limit, by the noise on the noisier side of the row, because braking may begin at the row. Normal noise
#   exceeds this limit with a probability of 1e-11 per row, or 1e-8 at the end of a noisier stretch.
_LOCAL_LIMIT = 6.0
_OVERALL_LIMIT = 8.0
_BESIDE_LIMIT = 8.0
_SIGMA_PER_MAD = 1.4826  # standard deviation over the median absolute deviation of normal noise

_REACH = NOISE_ROWS + HALF_WINDOW  # rows needed on either side to judge a row

# Smallest deviation of an outlier: the resolution of usual sensors, m/s and N*m (rad/s for a wheel of 0.5 m).
_FLOOR = {"train_speed": 0.1, "wheel_speed": 0.1, "wheel_angular_speed": 0.2, "brake_torque": 50.0}

# Smallest deviation in steps of the column. Rounding of the value and of the median explains half a step each; one
# encoder count more or less explains two steps.
_LEAST_STEPS = 3.5

PIECE = 4096  #: rows judged together; the first of these groups gives the overall noise of the log


class OutlierFilter(RowFilter):
    """Hampel filter: drops rows in which a speed or the torque is far from the median of the rows around them.

    The limit depends on noise and quantisation. `first_line` is the line number of the first dropped row; None if no
    row is dropped.
    """

    ahead = behind = _REACH
    piece = PIECE

    def __init__(self) -> None:
        super().__init__()
        self.first_line: int | None = None
        self.resolution = Resolution()
        self._scale: dict[str, float] = {}

    def _dropped(self, rows: Rows, start: int, stop: int) -> Flags:
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
            bad |= self._are_outliers(name, values)
        return bad

    def _are_outliers(self, name: str, values: Floats) -> Flags:
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
    padded = np.pad(values, HALF_WINDOW, mode="symmetric")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * HALF_WINDOW + 1)[at]
    return np.median(np.abs(windows - np.median(windows, axis=1, keepdims=True)), axis=1)


def _spread_beside(deviation: Floats, at: NDArray[np.intp]) -> Floats:
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(deviation, NOISE_ROWS, mode="symmetric"), NOISE_ROWS)
    return np.maximum(np.median(windows[at], axis=1), np.median(windows[at + NOISE_ROWS + 1], axis=1))


# --- alignment -----------------------------------------------------------------------------------------------------

LONGEST_DELAY = 2.0  #: longest accepted delay of a column, s; a longer shift would align different events

_WHEEL = ("wheel_angular_speed", "wheel_speed")  # in order of priority: the first one in the log is used


def corrections_note(delays: Mapping[str, float], zeros: Mapping[str, float]) -> tuple[str, ...]:
    """Sentence that lists the corrections given as options; empty if none is given."""
    given = [f"`delays` {name}={delay:g}" for name, delay in delays.items()]
    given += [f"`zeros` {name}={zero:g}" for name, zero in zeros.items()]
    return (f"the rows are corrected by {', '.join(given)}",) if given else ()


def check_corrections(delays: Mapping[str, float], zeros: Mapping[str, float]) -> None:
    """Raise InputError if a delay (s) or a sensor offset in `zeros` (SI) is out of range or has an unknown key."""
    known = tuple(name for name in UNITS if name != "time")
    for option, given in (("`delays`", delays), ("`zeros`", zeros)):
        for name, value in given.items():
            if name not in known:
                hint = close_match(name, known)
                raise InputError(
                    f"{option}: {shown(name)} is not a quantity of a log; {hint}choose one of {', '.join(known)}"
                )
            if not math.isfinite(value):
                raise InputError(f"{option} {name}: {value:g} is not allowed; give a finite value")
    for name, delay in delays.items():
        if abs(delay) > LONGEST_DELAY:
            raise InputError(
                f"`delays` {name}: {delay:g} s is not allowed; give -{LONGEST_DELAY:g} to {LONGEST_DELAY:g} (s)"
            )


class Alignment:
    """Subtracts sensor offsets and compensates the differences between the delays of the columns of a log.

    `delays`, s, and `zeros` (sensor offsets, SI) have quantities as keys; `name` is the name of the log. The wheel
    speed is not shifted in time, because interpolation would change its noise, and a prediction-error fit needs the
    original noise. The other columns are shifted relative to the wheel speed. InputError if a key has no column.
    """

    def __init__(self, delays: Mapping[str, float], zeros: Mapping[str, float], name: str) -> None:
        self._delays, self._zeros, self._name = dict(delays), dict(zeros), name
        self._buffer: Rows | None = None  # yielded rows that are still needed, then rows that wait for later rows
        self._yielded = 0  # number of buffered rows that were yielded

    def rows(self, blocks: Iterator[Rows]) -> Iterator[Rows]:
        if not (self._delays or self._zeros):
            yield from blocks
            return
        for rows in blocks:
            for name in (*self._delays, *self._zeros):
                if name not in rows.columns:
                    names, option = ", ".join(rows.columns), "delays" if name in self._delays else "zeros"
                    raise InputError(
                        f"{self._name}: no column {name}, which `{option}` should correct; choose one of {names}"
                    )
            columns = {name: values - self._zeros.get(name, 0.0) for name, values in rows.columns.items()}
            rows = Rows(rows.line, columns)
            buffer = rows if self._buffer is None else self._buffer.then(rows)
            time = buffer.columns["time"]
            known = time[-1] - max(0.0, *self._shifts(buffer).values()) if len(time) else 0.0
            yield self._corrected(buffer, int(np.searchsorted(time, known, side="right")))
        if self._buffer is not None:
            yield self._corrected(self._buffer, len(self._buffer))

    def _shifts(self, rows: Rows) -> dict[str, float]:
        wheel = next(name for name in _WHEEL if name in rows.columns)
        late = self._delays.get(wheel, 0.0)
        return {n: self._delays.get(n, 0.0) - late for n in rows.columns if n not in ("time", *_WHEEL)}

    def _corrected(self, buffer: Rows, stop: int) -> Rows:
        stop = max(stop, self._yielded)
        time, shifts = buffer.columns["time"], self._shifts(buffer)
        out = buffer.part(self._yielded, stop)
        moved = {
            name: np.interp(out.columns["time"] + shift, time, buffer.columns[name])
            for name, shift in shifts.items()
            if shift and len(out)
        }
        behind = max(0.0, *(-shift for shift in shifts.values()))
        keep = max(int(np.searchsorted(time, time[min(stop, len(time) - 1)] - behind)) - 1, 0) if len(time) else 0
        self._buffer, self._yielded = buffer.part(keep, None), stop - keep
        return Rows(out.line, {**out.columns, **moved})
