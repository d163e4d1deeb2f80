"""cleaning"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import shown
from railslip_ctrl.model.parameters.validation import close_match

from .logs import UNITS, Column, Rows

Floats = NDArray[np.float64]


# --- resolution ---


# Second differences: of values in steps they are whole steps, of a straight ramp they are nought, so that a ramp is
# not taken for a staircase. Nought is what rounding leaves of the values.
_NOUGHT = 1e-7
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
    changes = changes[changes > _NOUGHT * np.abs(values).max(initial=0.0)]
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


@dataclass(frozen=True)
class ColumnStep:
    """A column that comes in steps.

    Attributes
    ----------
    label : str
        The column's header with its unit, or the quantity and its SI unit.
    step : float
        In the file's unit.
    share : float
        As slip ratio at the initial speed; of a torque as adhesion coefficient.
    is_torque : bool
    """

    label: str
    step: float
    share: float
    is_torque: bool

    @property
    def matters(self) -> bool:
        """Whether the step is coarser than the lowest slips that are used, or than that of mu."""
        return self.share >= _COARSE

    def __str__(self) -> str:
        if self.is_torque:
            return f"{self.label!r} in steps of {self.step:.4g}, {self.share:.2g} of mu"
        return f"{self.label!r} in steps of {self.step:.4g}, {100.0 * self.share:.2g} % of slip at the initial speed"


_COARSE = 0.005


def column_steps(
    resolution: Resolution, columns: Mapping[str, Column], radius: float, speed: float, load: float
) -> tuple[ColumnStep, ...]:
    """The steps of the columns of a log (none: SI), at a wheel radius, m, initial speed, m/s, and wheel load, N."""
    slips = {"train_speed": 1.0 / speed, "wheel_speed": 1.0 / speed, "wheel_angular_speed": radius / speed}
    found = []
    for name, slip in (*slips.items(), ("brake_torque", 1.0 / (radius * load))):
        if step := resolution[name]:
            column = columns.get(name)
            label, factor = (f"{name} [{UNITS[name]}]", 1.0) if column is None else (column.header, column.factor)
            found.append(ColumnStep(label, step / factor, step * slip, name == "brake_torque"))
    return tuple(found)


def step_warnings(steps: tuple[ColumnStep, ...]) -> tuple[str, ...]:
    """A sentence for each step that matters."""
    return tuple(f"column {step}: what is finer is known from means alone" for step in steps if step.matters)


# --- outliers ---


HALF_WINDOW = 4
"""Rows on either side with which a row is compared."""

NOISE_ROWS = 64
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

_REACH = NOISE_ROWS + HALF_WINDOW  # rows that a judgement needs on either side

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
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(deviation, NOISE_ROWS, mode="symmetric"), NOISE_ROWS)
    result: Floats = np.maximum(np.median(windows[at], axis=1), np.median(windows[at + NOISE_ROWS + 1], axis=1))
    return result


# --- alignment ---


LONGEST_DELAY = 2.0
"""s, of a column; what is later is another event, not a delay."""

_WHEEL = ("wheel_angular_speed", "wheel_speed")  # the first of them in a log is the one used


def corrections_told(delays: Mapping[str, float], zeros: Mapping[str, float]) -> tuple[str, ...]:
    """The options by which a log is corrected, as they were given, in one sentence if any."""
    given = [f"--delay {name}={delay:g}" for name, delay in delays.items()]
    given += [f"--zero {name}={zero:g}" for name, zero in zeros.items()]
    return (f"the rows are corrected by {', '.join(given)}",) if given else ()


def check_corrections(delays: Mapping[str, float], zeros: Mapping[str, float]) -> None:
    """InputError unless delays (s) and zeros (SI) are of quantities of a log, and in range."""
    known = tuple(name for name in UNITS if name != "time")
    for option, given in (("--delay", delays), ("--zero", zeros)):
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
            raise InputError(f"--delay {name}: {delay:g} s is not allowed; give at most {LONGEST_DELAY:g} s either way")


class Alignment:
    """The rows of a log, block by block, with zeros taken off and the delays of the columns made equal.

    Parameters
    ----------
    delays : mapping
        By quantity, s: by how much its column is later than what it shows.
    zeros : mapping
        By quantity, SI: what its column reads where it should read nought.
    name : str
        The log, for messages.

    Raises
    ------
    InputError
        While running, a quantity that the log does not have.
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
            yield self._add(self._without_zeros(rows))
        if self._held is not None:
            yield self._given(self._held, len(self._held))

    def _without_zeros(self, rows: Rows) -> Rows:
        for name in (*self._delays, *self._zeros):
            if name not in rows.columns:
                raise InputError(f"{self._name}: no column {name} to correct; it has {', '.join(rows.columns)}")
        return Rows(rows.line, {name: values - self._zeros.get(name, 0.0) for name, values in rows.columns.items()})

    def _add(self, rows: Rows) -> Rows:
        held = rows if self._held is None else self._held.then(rows)
        time = held.columns["time"]
        ahead = max(0.0, *self._shifts(held).values())
        return self._given(held, int(np.searchsorted(time, time[-1] - ahead, side="right")) if len(time) else 0)

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
