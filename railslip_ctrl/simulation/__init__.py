"""Braking runs and their scenarios, campaigns of many runs, and the shortest stop that any controller can reach.

This package imports `design`, `controllers`, `sliding`, `loop`, `model` and `core`. Begin with `simulate` in `run`.
`scenario` defines the conditions of a run, and `paths` changes single numbers of these. `kernel` integrates a run;
`gpu` integrates runs on a GPU, with the random numbers of `counted`. `campaign` makes many runs with varied quantities,
and `population` makes random vehicles and rails. `bound` computes the stop that no controller can beat. `embedded`
writes a controller as a C99 program.
"""

from __future__ import annotations

from .run import Energies, Noise, Outcome, Run, Signals, Simulator, simulate
from .scenario import (
    Beliefs,
    BrakeLimits,
    Disturbances,
    Event,
    Measurement,
    Scenario,
    built_in_scenario,
    published_scenario,
    stop,
)

__all__ = [
    "Beliefs", "BrakeLimits", "Disturbances", "Energies", "Event", "Measurement", "Noise", "Outcome", "Run",
    "Scenario", "Signals", "Simulator", "built_in_scenario", "published_scenario", "simulate", "stop",
]  # fmt: skip
