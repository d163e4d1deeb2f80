"""Controllers side by side over the same braking runs: what each needs, and how far it is from what could be had."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
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
    """A controller over the seeds of a scenario; means over the runs that stopped.

    Attributes
    ----------
    name : str
    runs, stopped : int
        How many there were, and how many came to the final speed.
    outcomes : mapping
        How many runs had each outcome.
    braking_time, braking_distance, brake_energy : Mean
        s, m, J.
    slip_error, slip_error_published, max_slip : Mean
        Mean of |slip - reference|, the controller's own and [Park2008]'s 0.132/0.092 (NaN where the scenario is not the
        published one); highest slip ratio.
    lock_time : Mean
        Time with r omega < 0.02 v, s.
    rms_torque_rate, max_torque : Mean
        Of the acting torque, N*m/s and N*m.
    beyond_bound : Mean
        Braking distance beyond the clairvoyant's, m.
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
    """Rows of controllers over one scenario, with the bound that none can beat."""

    scenario: Scenario
    seeds: tuple[int, ...]
    bound: ClairvoyantStop
    rows: tuple[ControllerRow, ...]

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

    Returns
    -------
    RunComparison
        Means for each controller, SI, and the bound of `clairvoyant_stop`, without noise: where the scenario sets no
        largest torque, it has the actuator's dead time but not its lag, which a large enough command overcomes.
    """
    bound = clairvoyant_stop(scenario)
    rows = []
    with ThreadPoolExecutor() as pool:  # the kernel holds no lock of the interpreter
        for name, controller in controllers.items():
            simulator = Simulator(scenario, controller)
            runs = list(pool.map(simulator.run, seeds))
            rows.append(_row(name, runs, bound))
    return RunComparison(scenario, tuple(seeds), bound, tuple(rows))


def _row(name: str, runs: list[Run], bound: ClairvoyantStop) -> ControllerRow:
    stopped = [run for run in runs if run.stopped]
    outcomes = {outcome: sum(run.outcome is outcome for run in runs) for outcome in Outcome}
    return ControllerRow(
        name=name,
        runs=len(runs),
        stopped=len(stopped),
        outcomes={outcome: count for outcome, count in outcomes.items() if count},
        braking_time=_mean([run.braking_time for run in stopped]),
        braking_distance=_mean([run.braking_distance for run in stopped]),
        brake_energy=_mean([run.brake_energy for run in stopped]),
        slip_error=_mean([run.mean_abs_slip_error for run in stopped]),
        slip_error_published=_mean([run.mean_abs_slip_error_published for run in stopped]),
        max_slip=_mean([run.max_slip for run in stopped]),
        lock_time=_mean([run.locked_fraction * run.braking_time for run in stopped]),
        rms_torque_rate=_mean([run.rms_torque_rate for run in stopped]),
        max_torque=_mean([run.max_torque for run in stopped]),
        beyond_bound=_mean([run.braking_distance - bound.braking_distance for run in stopped]),
    )


def _mean(values: list[float]) -> Mean:
    if not values:
        return Mean(math.nan, math.nan)
    error = float(np.std(values, ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else math.nan
    return Mean(float(np.mean(values)), error)
