"""The four columns of Table 5 as setups to run, and many runs of them on all cores."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.processes import cores
from railslip_ctrl.simulation import Run, Scenario, Simulator, published_scenario, simulate
from railslip_ctrl.simulation.catalogue import Column, Kind, published_controller
from railslip_ctrl.simulation.controllers import Controller

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

QUANTITIES = ("braking_time_s", "braking_distance_m", "brake_energy_published_reading", "mean_abs_slip_error")
"""What Table 5 gives of each column, by the names of the comparison."""

MOST_SEEDS = 100_000

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Case:
    """A column of Table 5: kind of controller, and the column of Table 4 whose gains and reference it has."""

    kind: Kind
    gains: Column

    @property
    def name(self) -> str:
        """As Table 5 heads it."""
        return f"{self.kind.upper()} {self.gains}"


CASES = (Case("pi", "beam"), Case("pi", "bristle"), Case("asmc", "beam"), Case("asmc", "bristle"))
"""The columns of Table 5, in its order."""


@dataclass(frozen=True)
class Setup:
    """What is run for a column, and how its numbers are read.

    Attributes
    ----------
    case : Case
        The column.
    scenario, controller
        What is run.
    own_reference : bool
        Take the slip error against the controller's reference instead of 0.132/0.092.
    energy_in_joules : bool
        Leave the energy as it is instead of multiplying it with the inertia scale.
    """

    case: Case
    scenario: Scenario
    controller: Controller
    own_reference: bool = False
    energy_in_joules: bool = False

    def numbers(self, run: Run) -> tuple[float, ...]:
        """The `QUANTITIES` of a run: s, m, J times the unit's factor, slip ratio."""
        unit = 1.0 if self.energy_in_joules else self.scenario.vehicle.inertia_scale
        error = run.mean_abs_slip_error if self.own_reference else run.mean_abs_slip_error_published
        return run.braking_time, run.braking_distance, unit * run.brake_energy, error


def published_setup(case: Case) -> Setup:
    """The setup of a `case`, a column of Table 5, in the reading of `reading.READING`."""
    return Setup(case, published_scenario(), published_controller(case.kind, case.gains))


@dataclass(frozen=True)
class CaseResult:
    """Runs of a setup.

    Attributes
    ----------
    setup : Setup
    values : array (runs, 4)
        The `QUANTITIES` of each run, by rows, in the units they name; NaN where it did not stop.
    failures : tuple of str
        What became of the runs that did not stop.
    """

    setup: Setup
    values: Floats
    failures: tuple[str, ...]

    @property
    def mean(self) -> Floats:
        """Means over the runs, (4,); NaN unless all of them stopped."""
        return np.asarray(self.values.mean(axis=0))

    @property
    def standard_error(self) -> Floats:
        """Standard errors of the means, (4,); NaN for a single run."""
        runs = self.values.shape[0]
        if runs < 2:
            return np.full(len(QUANTITIES), math.nan)
        return np.asarray(self.values.std(axis=0, ddof=1) / math.sqrt(runs))


def checked_seeds(seeds: int) -> int:
    """The number of seeds, 2 to `MOST_SEEDS`; InputError for another."""
    if not 2 <= seeds <= MOST_SEEDS:
        raise InputError(f"seeds: {seeds} is not allowed; give a whole number from 2 to {MOST_SEEDS}")
    return seeds


def run_setups(setups: Sequence[Setup], seeds: int, *, progress: Progress | None = None) -> tuple[CaseResult, ...]:
    """Run each setup with seeds 0, 1, ... on all cores; a setup without random force runs once.

    Parameters
    ----------
    setups : sequence of Setup
    seeds : int
        Runs of each, 1 or more; the same seeds for all, so that differences between setups are not noise.
    progress : callable, optional
        Told what is run, a line for each setup done.
    """
    results = []
    with ThreadPoolExecutor(cores()) as pool:  # threads: a run leaves the interpreter's lock
        for setup in setups:
            simulator = Simulator(setup.scenario, setup.controller)
            noisy = setup.scenario.disturbances.random_force > 0
            first = simulator.run(0 if noisy else None)  # alone, so that the kernel is compiled or loaded once
            runs = [first, *pool.map(simulator.run, range(1, seeds if noisy else 1))]
            values = [setup.numbers(run) if run.stopped else (math.nan,) * len(QUANTITIES) for run in runs]
            failures = tuple(str(run.outcome) for run in runs if not run.stopped)
            results.append(CaseResult(setup, np.array(values), failures))
            if progress is not None:
                progress(f"{setup.case.name}: {len(runs)} runs ({len(results)} of {len(setups)} setups)")
    return tuple(results)


def published_runs(*, seed: int | None = 0, every: int = 20) -> dict[str, Run]:
    """One recorded run of each column of Table 5, by name.

    Parameters
    ----------
    seed : int or None
        Of the random force; None: no noise.
    every : int
        Steps of 1 ms from one row of signals to the next.
    """
    setups = [published_setup(case) for case in CASES]
    return {s.case.name: simulate(s.scenario, s.controller, seed=seed, record_every=every) for s in setups}
