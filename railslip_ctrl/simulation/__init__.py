"""Braking runs and their scenarios, campaigns of many runs, and the shortest stop that any controller can reach.

This package imports `design`, `controllers`, `sliding`, `loop`, `model` and `core`. Begin with `simulate` in `run`.

- `scenario`: conditions of a braking run as a record, and scenario files; `paths` reads and changes single numbers of a
  record by a path such as "vehicle.mass".
- `kernel`: the integration loop. Its source text is joined with the texts of an adhesion law and a controller to one
  module, which Numba compiles.
- `bound`: the stop that no controller can beat, and a comparison of controllers with this stop.
- `campaign`: many runs with varied quantities; `population`: random vehicles and rails.
- `embedded`: writes a controller as a C99 program.
- `gpu`: simulates runs on a CUDA GPU, with the random numbers of `counted`.
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
