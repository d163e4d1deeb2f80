"""A campaign of short runs that the campaign's tests share."""

from __future__ import annotations

from railslip_ctrl.design import PIController
from railslip_ctrl.model.vehicle import PIGains
from railslip_ctrl.simulation import LinearControl, built_in_scenario
from railslip_ctrl.simulation.campaign import Campaign, Normal, Quantity, Uniform
from railslip_ctrl.simulation.catalogue import published_controller

SHORT = built_in_scenario("park2008").with_changes(
    initial_speed=30 / 3.6, final_speed=27 / 3.6, longest_time=20.0, events=()
)
PI = published_controller("pi")
SOFT = LinearControl(PIController(PIGains(kp=1500.0, ki=97.0)), PI.reference, name="soft")
MASS = Quantity(("vehicle.mass",), Uniform(3000.0, 4000.0))
DEAD_TIME = Quantity(("vehicle.actuator.dead_time",), Normal(0.15, 0.02))

TOML = """
scenario = "short.toml"
runs = {runs}
seed = 3

[[controller]]
controller = "pi"

[[controller]]
controller = "pi"
name = "soft"
kp = 1500
ki = "27 N*m/(km/h)/s"

[[quantity]]
path = "vehicle.mass"
distribution = "uniform"
low = "3 t"
high = 4000
"""
SHORT_TOML = """
extends = "park2008"
initial_speed = "30 km/h"
final_speed = "27 km/h"
longest_time = 20
events = []
"""


def short_campaign(runs: int = 24, quantities: tuple[Quantity, ...] = (MASS, DEAD_TIME), **changes: object) -> Campaign:
    return Campaign(SHORT, (PI, SOFT), runs, quantities, 3, **changes)


def write_campaign(folder, runs: int):
    """The campaign as files; the path of its TOML."""
    (folder / "short.toml").write_text(SHORT_TOML)
    path = folder / "campaign.toml"
    path.write_text(TOML.format(runs=runs))
    return path
