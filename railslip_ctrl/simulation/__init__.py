"""Braking runs: scenarios, controllers that run, one compiled kernel, campaigns."""

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
