"""Braking runs: what [Park2008] publishes comes out, and the energy balance closes."""

from __future__ import annotations

import numpy as np
import pytest

from railslip_ctrl.design import PIController
from railslip_ctrl.model.adhesion import ReferenceSlip
from railslip_ctrl.model.vehicle import TABLE4_PI
from railslip_ctrl.simulation import LinearControl, Outcome, Simulator, built_in_scenario, simulate

REFERENCE = ReferenceSlip(dry=0.132, wet=0.092)


def published_pi() -> LinearControl:
    return LinearControl(PIController(TABLE4_PI["bristle"]), REFERENCE)


def test_the_published_pi_stops_as_published() -> None:
    """[Park2008] Table 5, PI bristle: 58.9 s, 682 m, 1.77e7, 0.0351. Within 4 %, the tolerance of the reading."""
    simulator = Simulator(built_in_scenario("park2008"), published_pi())
    runs = [simulator.run(seed) for seed in range(16)]
    assert all(run.outcome is Outcome.STOPPED for run in runs)
    found = np.mean(
        [
            (run.braking_time, run.braking_distance, 3.6 * run.brake_energy, run.mean_abs_slip_error_published)
            for run in runs
        ],
        axis=0,
    )
    assert found == pytest.approx([58.9, 682.0, 1.77e7, 0.0351], rel=0.04)


def test_the_energy_balance_closes() -> None:
    """1e-6 of the starting energy is asked; Runge-Kutta at 1 ms leaves far less."""
    run = simulate(built_in_scenario("park2008"), published_pi(), seed=1)
    assert abs(run.energies.error) < 1e-9
    assert run.energies.booked == pytest.approx(0.5 * 3.6 * (5276 - 3517) * np.interp(25.0, *run.signals[:3:2]) ** 2)
