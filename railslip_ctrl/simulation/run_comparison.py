"""Controllers side by side over the same braking runs: what each needs, and how far it is from what could be had."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np

from railslip_ctrl.core.arguments import checked
from railslip_ctrl.simulation import Outcome, Run, Scenario, Simulator

from .bound import ClairvoyantStop, clairvoyant_stop


@dataclass(frozen=True)
class Mean:
    """Mean over the runs and its standard error (NaN for a single run); NaN where no run stopped."""

    value: float
    error: float


@dataclass(frozen=True)
class ControllerRow:
    """A controller over the seeds of a scenario: `outcomes` of all `runs`, means over those that `stopped`.

    SI, as of `Run`; `lock_time` is that with r omega < 0.02 v, s; `beyond_bound` the braking distance beyond the
    clairvoyant's, m.
    """

    name: str
    runs: int
    stopped: int
    outcomes: Mapping[Outcome, int]
    braking_time: Mean
    braking_distance: Mean
    brake_energy: Mean
    slip_error: Mean
    slip_error_published: Mean
    max_slip: Mean
    lock_time: Mean
    rms_torque_rate: Mean
    max_torque: Mean
    beyond_bound: Mean


@dataclass(frozen=True)
class RunComparison:
    """`rows` of controllers over one scenario, each over all `seeds`, with the `bound` that none can beat."""

    scenario: Scenario
    seeds: tuple[int, ...]
    bound: ClairvoyantStop
    rows: tuple[ControllerRow, ...]

    def __str__(self) -> str:
        text = import_module("railslip_ctrl.report.simulation")  # a room above this one, asked for by the user
        return str(text.run_comparison_text(self))

    def row(self, name: str) -> ControllerRow:
        """The row of a controller by name; KeyError for another."""
        return {row.name: row for row in self.rows}[name]


@checked
def compare_runs(scenario: Scenario, controllers: Mapping[str, Any], seeds: Sequence[int]) -> RunComparison:
    """Run every controller through the scenario with every seed, on all cores; all meet the same noise.

    Parameters
    ----------
    scenario : Scenario
        The run, SI.
    controllers : mapping
        By name, what `simulate` takes.
    seeds : sequence of int
        One for each run, any number of them.

    Returns means for each controller, SI, and the bound of `clairvoyant_stop`, without noise: where the scenario sets
    no largest torque, it has the actuator's dead time but not its lag, which a large enough command overcomes.
    """
    bound = clairvoyant_stop(scenario)
    simulators = {name: Simulator(scenario, controller) for name, controller in controllers.items()}
    with ThreadPoolExecutor() as pool:  # the kernel holds no lock of the interpreter
        rows = [_row(name, list(pool.map(one.run, seeds)), bound) for name, one in simulators.items()]
    return RunComparison(scenario, tuple(seeds), bound, tuple(rows))


_MEANS: dict[str, Callable[[Run], float]] = {
    "braking_time": lambda run: run.braking_time,
    "braking_distance": lambda run: run.braking_distance,
    "brake_energy": lambda run: run.brake_energy,
    "slip_error": lambda run: run.mean_abs_slip_error,
    "slip_error_published": lambda run: run.mean_abs_slip_error_published,
    "max_slip": lambda run: run.max_slip,
    "lock_time": lambda run: run.locked_fraction * run.braking_time,
    "rms_torque_rate": lambda run: run.rms_torque_rate,
    "max_torque": lambda run: run.max_torque,
}


def _row(name: str, runs: list[Run], bound: ClairvoyantStop) -> ControllerRow:
    stopped = [run for run in runs if run.stopped]
    return ControllerRow(
        name=name,
        runs=len(runs),
        stopped=len(stopped),
        outcomes={outcome: n for outcome in Outcome if (n := sum(run.outcome is outcome for run in runs))},
        beyond_bound=_mean([run.braking_distance - bound.braking_distance for run in stopped]),
        **{column: _mean([read(run) for run in stopped]) for column, read in _MEANS.items()},
    )


def _mean(values: list[float]) -> Mean:
    if not values:
        return Mean(math.nan, math.nan)
    error = float(np.std(values, ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else math.nan
    return Mean(float(np.mean(values)), error)
