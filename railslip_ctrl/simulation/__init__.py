"""Braking runs and their scenarios, campaigns of many runs, and the shortest stop that any controller can reach.

Imports `design`, `controllers`, `sliding`, `loop`, `model` and `core`. Begin with `simulate` in `run`. `scenario` says
what a run is and reads its files, `paths` finds numbers in it. `kernel` is the integration loop: its source text is
assembled with those of an adhesion law and a controller and compiled by Numba, so that neither costs a call. `bound`
has the stop that no controller can beat, and compares runs with it; `campaign` makes many; `population` draws random
vehicles and rails; `embedded` writes a controller's C99 program. `gpu` runs stops on a CUDA device, with the draws of
`counted`.
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
