"""Columns of a log brought to one time and one zero: what pickups and recorders do to them, undone.

An encoder's speed, a difference of counts, is the mean over its interval and so half an interval late; a filtered
torque is late by its filter. Of the columns only the difference in delay counts, so that the wheel's samples stay as
they are, whose noise a fit along the motion is to see, and the others, which are smooth, are read off between theirs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import shown
from railslip_ctrl.core.user_files import close_match

from .columns import UNITS
from .rows import Rows

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
