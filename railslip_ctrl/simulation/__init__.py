"""Braking runs: what is simulated, what brakes, and what comes out. Imports from design, sliding, model and core.

Begin with `simulate` in `run`. `scenario` says what a run is and reads its files; `controllers` and `step_objects`
are what brakes, `catalogue` has those with a name and `controller_files` those of the user. `kernel` is the
integration loop and `steps` the controllers' samples: their texts are put together and compiled by Numba, so a law of
adhesion and a controller cost no call. `seeking` is the controller that finds the peak of adhesion, `seeking_step` its
sample. `bound` is the stop that no controller can beat, and compares runs with it; `campaign` makes many.
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
    "BrakeLimits",
    "Disturbances",
    "Energies",
    "Event",
    "LinearControl",
    "Measurement",
    "Outcome",
    "Run",
    "Scenario",
    "ScheduledControl",
    "SeekingControl",
    "Signals",
    "Simulator",
    "SlideProtection",
    "SlidingControl",
    "StepControl",
    "TorqueProfile",
    "built_in_scenario",
    "published_scenario",
    "simulate",
    "stop",
]
