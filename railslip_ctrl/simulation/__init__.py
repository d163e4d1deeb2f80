"""Braking runs: scenarios, controllers, results; campaigns of many runs, and the stop that none can beat.

Imports `design`, `sliding`, `loop`, `model` and `core`. Begin with `simulate` in `run`. `scenario` says what a run is
and reads its files; `controllers` has the records that run, `step_objects` a user's own step, called by `step_calls`;
`catalogue` has those with a name, `controller_files` reads those in TOML. `kernel` is the integration loop and
`steps` the controllers' samples: their source text is assembled and compiled by Numba, so that an adhesion law and a
controller cost no call. `seeking` finds the peak of adhesion, by the sample in `seeking_step`, which `seeking_code`
prints as C99. `bound` has the stop that no controller can beat, and compares runs with it; `campaign` makes many.
"""

from __future__ import annotations

from .controllers import LinearControl, ScheduledControl, SlideProtection, SlidingControl, TorqueProfile
from .run import Energies, Outcome, Run, Signals, Simulator, simulate
from .scenario import (
    BrakeLimits,
    Disturbances,
    Event,
    Measurement,
    Scenario,
    built_in_scenario,
    published_scenario,
    stop,
)
from .seeking import SeekingControl
from .step_objects import StepControl

__all__ = [
    "BrakeLimits", "Disturbances", "Energies", "Event", "LinearControl", "Measurement", "Outcome", "Run",
    "Scenario", "ScheduledControl", "SeekingControl", "Signals", "Simulator", "SlideProtection", "SlidingControl",
    "StepControl", "TorqueProfile", "built_in_scenario", "published_scenario", "simulate", "stop",
]  # fmt: skip
