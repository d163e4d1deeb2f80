"""A campaign of 1 000 runs on two cores against one in the same session; start of workers and disk in the time."""

import time

from railslip_ctrl.core.processes import cpu_count
from railslip_ctrl.simulation import built_in_scenario
from railslip_ctrl.simulation.campaign import Campaign, Normal, Quantity, Triangular, Uniform, execute
from railslip_ctrl.simulation.catalogue import published_controller

RUNS = 1000
QUANTITIES = (
    Quantity(("vehicle.mass", "vehicle.mass_loaded", "events.0.mass"), Uniform(0.8, 1.2), relative=True),
    Quantity(("adhesion_factor",), Normal(1.0, 0.1)),  # another adhesion table for every run: the dearest to make ready
    Quantity(("vehicle.actuator.dead_time",), Triangular(0.1, 0.15, 0.25)),
)


def test_two_cores_are_worth_1_8_of_one(tmp_path):
    assert cpu_count() >= 2, "two cores are needed to measure what the second is worth"
    campaign = Campaign(built_in_scenario("park2008"), (published_controller("pi"),), RUNS, QUANTITIES)
    execute(Campaign(campaign.scenario, campaign.controllers, 1), tmp_path / "compiled", workers=1)
    seconds = {}
    for workers in (1, 2):
        begin = time.perf_counter()
        execute(campaign, tmp_path / str(workers), workers=workers)
        seconds[workers] = time.perf_counter() - begin
    ratio = seconds[1] / seconds[2]
    print(
        f"\n{RUNS} runs: {seconds[1]:.1f} s in one process, {seconds[2]:.1f} s in two, ratio {ratio:.2f}; "
        f"{1e3 * seconds[1] / RUNS:.1f} ms a run"
    )
    assert ratio >= 1.8
