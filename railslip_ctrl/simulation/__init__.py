"""Braking runs and their scenarios, campaigns of many runs, and the shortest stop that any controller can reach.

Imports `design`, `controllers`, `sliding`, `loop`, `model` and `core`. Begin with `simulate` in `run`.

- `scenario`: the record of a braking run, and its files; `paths` finds numbers in a record by dotted path.
- `kernel`: the integration loop. Its text, that of an adhesion law and that of a controller form one module, which
  Numba compiles.
- `bound`: the stop that no controller can beat, and a comparison of runs with this stop.
- `campaign`: many runs with varied quantities; `population`: random vehicles and rails.
- `embedded`: C99 program of a controller.
- `gpu`: runs on a CUDA device, with the random numbers of `counted`.
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
