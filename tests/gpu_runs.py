"""Stops by the text for CUDA beside those of the CPU: on a GPU, or in Numba's simulator of one, which interprets it.

    NUMBA_ENABLE_CUDASIM=1 python tests/gpu_runs.py FOLDER

prints the largest relative difference for every law and every controller, and of a campaign in FOLDER, as JSON.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from sample_laws import ALL_LAWS, sample_law

import railslip_ctrl as rs
from railslip_ctrl.design.catalogue import controller_named, published_controller
from railslip_ctrl.simulation import Scenario
from railslip_ctrl.simulation.campaign import Campaign, Normal, Quantity, execute, replay
from railslip_ctrl.simulation.counted import Counted
from railslip_ctrl.simulation.gpu import run_batch

NUMBERS = (
    *("braking_time", "braking_distance", "final_speed", "brake_energy", "mean_abs_slip_error", "max_slip"),
    *("locked_fraction", "max_torque", "max_torque_rate", "rms_torque_rate", "steps"),
)
EVENTS = (
    rs.Event(time=0.03, rail="wet", adhesion_factor=0.9),
    rs.Event(distance=0.5, rail="dry", adhesion_factor=0.7, mass=4000.0),
)
BRIEF = {"initial_speed": 30 / 3.6, "final_speed": 29 / 3.6, "step": 0.01, "longest_time": 0.12, "events": EVENTS}
SENSORS = {"speed_noise": 0.02, "wheel_noise": 0.05, "wheel_quantum": 0.01, "filter_time": 0.02, "encoder_teeth": 80}
CONTROLLERS = ("asmc", "pi-lead", "predictive", "seeking", "slide-protection")


def brief(law: object = "curve", **changes: object) -> Scenario:
    """A tenth of a second of braking, with noise and events."""
    scenario = rs.stop(speed_kmh=100.0, adhesion=law)
    return scenario.with_changes(**BRIEF, measurement=SENSORS, **changes)


def difference(simulators: list[rs.Simulator]) -> float:
    seeds = [Counted(7 * i, 2**32 - 1 - i) for i in range(len(simulators))]
    here = np.array([numbers(simulator.run(seed)) for simulator, seed in zip(simulators, seeds, strict=True)])
    there = np.array([numbers(run) for run in run_batch(list(zip(simulators, seeds, strict=True)))])
    both = np.isfinite(here)
    assert (np.isfinite(there) == both).all()
    return float(np.max(np.abs(here - there)[both] / np.maximum(np.abs(here[both]), 1e-3)))


def numbers(run: rs.Run) -> list[float]:
    """What a run ended with."""
    return [float(getattr(run, name)) for name in NUMBERS] + [list(type(run.outcome)).index(run.outcome)]


def simulated(folder: Path) -> dict[str, float]:
    """Over laws, controllers, and a campaign with a quantity."""
    pi, found = published_controller("pi").model_copy(update={"period": 0.01}), {}
    for name in ALL_LAWS:
        found[name] = difference([rs.Simulator(brief(sample_law(name), vehicle=one), pi) for one in vehicles(2)])
    for name in CONTROLLERS:
        found[name] = difference([rs.Simulator(brief(), controller_named(name, rs.PARK2008))])
    mass = Quantity(("vehicle.mass",), Normal(1.0, 0.02), relative=True)
    campaign = Campaign(brief(), (pi,), 3, (mass,), seed=5)
    store = execute(replace(campaign, device="gpu"), folder / "out")
    for i in range(3):
        (again,) = replay(store.campaign, i, store.folder).runs.values()
        row = store.row(i)["pi"]
        found[f"campaign {i}"] = abs(row["ended_at_m"] - again.braking_distance)
    return found


def vehicles(count: int) -> list[rs.Vehicle]:
    masses = np.linspace(0.95, 1.05, count) * rs.PARK2008.mass
    return [rs.PARK2008.model_copy(update={"mass": float(mass)}) for mass in masses]


if __name__ == "__main__":
    print(json.dumps(simulated(Path(sys.argv[1]))))
