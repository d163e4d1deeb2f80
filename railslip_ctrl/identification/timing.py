"""Are the columns of a log in step? A wheel speed that is late shows in how well the motion can be followed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from railslip_ctrl.parameters import Vehicle

from .fits import Fit
from .motion import is_followed
from .prediction import Along
from .record import Record

_MOST_ROWS = 4000  # of whole runs from the record's beginning: some twenty rig tests are more than enough
_LEAST_GAIN = 40.0  # of the deviance; a model that is not the rig's own gains up to 26 by a shift there is no cause for


def half_interval_late(fit: Fit, record: Record, vehicle: Vehicle, wheel_load: float) -> float | None:
    """Half the log's interval, s, where the wheel's speed is late by about as much, negative where early; else None.

    The motion is followed with the other columns read off half an interval earlier, and later; told is the one of
    these that is far more likely than the log as it stands.
    """
    if not is_followed(fit.model, record):
        return None
    kept = replace(record, **{name: values[: _whole_runs(record)] for name, values in vars(record).items()})
    step = np.diff(kept.time)[np.diff(kept.run) == 0]
    if not is_followed(fit.model, kept):
        return None
    half = float(np.median(step)) / 2.0

    def deviance(late: float) -> float:
        return Along(fit.model, _earlier(kept, late), vehicle, wheel_load).deviance([fit.values])

    try:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a search may try what overflows
            now = deviance(0.0)
            gains = {late: now - deviance(late) for late in (half, -half)}
    except ValueError:  # SciPy's and LAPACK's word for errors that are not finite: nothing can be told
        return None
    late = max(gains, key=lambda each: gains[each])
    return late if gains[late] > _LEAST_GAIN else None


def _whole_runs(record: Record) -> int:
    """Rows of as many whole runs as there is room for, the first in any case."""
    ends = np.append(np.flatnonzero(np.diff(record.run)) + 1, len(record))
    fitting = ends[ends <= _MOST_ROWS]
    return int(fitting[-1] if len(fitting) else min(ends[0], _MOST_ROWS))


def _earlier(record: Record, late: float) -> Record:
    """The record with train speed and brake torque as they were some seconds earlier, run by run."""
    speed, torque = record.speed.copy(), record.torque.copy()
    for run in np.unique(record.run):
        at = record.run == run
        time = record.time[at]
        for values in (speed, torque):
            values[at] = np.interp(time - late, time, values[at])
    return replace(record, speed=speed, torque=torque)
