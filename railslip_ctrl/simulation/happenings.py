"""When the events of a run happened."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .run import Run
from .scenario import Event


class Happening(NamedTuple):
    """An event and the time at which it happened, s; NaN: never."""

    event: Event
    time: float

    @property
    def reached(self) -> bool:
        """Whether the event happened."""
        return not math.isnan(self.time)

    @property
    def text(self) -> str:
        """Where it is, what it changes, and when it happened: "from 25 s: wet rail, M 5276 kg"."""
        event = self.event
        place = f"from {event.time:g} s" if event.time is not None else f"from {event.distance:g} m"
        changes = [
            *([f"{event.rail} rail"] if event.rail is not None else []),
            *([f"{event.adhesion_factor:g} times the rail's adhesion"] if event.adhesion_factor is not None else []),
            *([f"M {event.mass:g} kg"] if event.mass is not None else []),
        ]
        when = f" (at {self.time:.4g} s)" if event.time is None else ""
        return f"{place}: {', '.join(changes)}{when if self.reached else ' (NOT REACHED)'}"


def happenings(run: Run) -> tuple[Happening, ...]:
    """The events of a run in order of happening, those not reached last; needs `run.signals` for events in distance."""
    found = [Happening(event, _time(event, run)) for event in run.scenario.events]
    return tuple(sorted(found, key=lambda one: one.time if one.reached else math.inf))


def _time(event: Event, run: Run) -> float:
    """Time of an event, s; one at the very end of the run changes nothing any more: NaN."""
    if event.time is not None:
        return event.time if event.time < run.braking_time else math.nan
    assert event.distance is not None, "an event has a time or a distance"
    if not event.distance < run.braking_distance:
        return math.nan
    return _time_at(event.distance, run)


def _time_at(distance: float, run: Run) -> float:
    """Time at which a distance was passed, s: between rows the cubic that keeps both distances and speeds."""
    from scipy.interpolate import CubicHermiteSpline  # here, as most runs start without it

    assert run.signals is not None, "the run was recorded"
    on = np.diff(run.signals.distance, prepend=-math.inf) > 0  # a run that breaks off may have its last row twice
    signals = [series[on] for series in (run.signals.distance, run.signals.time, run.signals.speed)]
    return float(CubicHermiteSpline(signals[0], signals[1], 1.0 / signals[2])(distance))
