"""What a controller believes of the vehicle where it is not so: in a scenario, from the command line, in a campaign."""

import json
import math

import numpy as np
import pytest

from railslip_ctrl import PARK2008, ReferenceSlip, simulate, stop
from railslip_ctrl.controllers.guard import ControlUnit
from railslip_ctrl.controllers.pi import PILead
from railslip_ctrl.controllers.predictive import Predictive
from railslip_ctrl.controllers.torque_profile import TorqueProfile
from railslip_ctrl.design.catalogue import controller_named
from railslip_ctrl.model.adhesion.table import LookupTable
from railslip_ctrl.simulation.campaign import Campaign, Grid, Quantity
from railslip_ctrl.simulation.campaign.execution import run_rows

QUIET = stop(PARK2008, "dry").with_changes(disturbances={}, final_speed=12.0)
REFERENCE = ReferenceSlip(dry=0.1, wet=0.06)
HELD = PILead(
    kp=330.0, ki=129.0, lead=0.6, lead_filter=0.06, period=0.01, reference=REFERENCE, initial_torque=1800.0,
    torque_min=0.0, torque_max=9e3,
)  # fmt: skip
PREDICTIVE = Predictive.for_vehicle(PARK2008, reference=REFERENCE)
ASSUMING = controller_named("asmc", PARK2008, reference=REFERENCE, period=0.01)
TABLE = LookupTable(slip=(0.0, 0.02, 0.1, 0.3, 1.0), mu=(0.0, 0.12, 0.2, 0.15, 0.1))
ON_TABLE = stop(PARK2008, "dry", adhesion=TABLE).with_changes(disturbances={}, limits={"torque_max": 9e3})


def believing(path, value, scenario=QUIET):
    table, name = path.split(".")
    return scenario.with_changes(**{table: {name: value}})


def designed(control, **believed):
    return control.model_copy(update=believed)


@pytest.mark.parametrize("radius", [0.42, 0.44])
def test_the_slip_error_is_that_of_the_believed_radius_and_the_wheel_slips_by_it(radius):
    """The error is 0 at a slip of 1 - (1 - reference) r/r'."""
    run, usual = simulate(believing("beliefs.radius", radius), HELD, seed=None), simulate(QUIET, HELD, seed=None)
    v, omega = run.signals.measured_speed[:-1], run.signals.measured_wheel_speed[:-1]
    error = REFERENCE.dry * v - (v - radius * omega)
    assert run.controller_signals["error"][:-1] == pytest.approx(error, rel=1e-9, abs=1e-9)
    more = run.signals.slip[-1] - usual.signals.slip[-1]
    held = (1 - REFERENCE.dry) * (1 - PARK2008.wheel.radius / radius)
    assert 0.3 < more / held < 1.0  # on its way there


@pytest.mark.parametrize("share", [0.7, 1.0, 1.4])
def test_a_believed_inertia_changes_the_observed_adhesion_torque_by_its_share_of_the_acceleration(share):
    inertia = share * PARK2008.wheel.inertia
    signals = (run := simulate(QUIET, designed(PREDICTIVE, wheel_inertia=inertia), seed=None)).signals
    late = slice(-400, -1)
    error = run.controller_signals["adhesion_torque"][late] - PARK2008.wheel.radius * signals.adhesion_force[late]
    turning = np.gradient(signals.wheel_speed, signals.time)[late]
    expected = (share - 1.0) * PARK2008.wheel.inertia * turning.mean()
    assert error.mean() == pytest.approx(expected, abs=12.0)  # N*m, of 85 and 150: it is filtered, and rises


@pytest.mark.parametrize("dead_time", [0.1, 0.15, 0.2])
def test_the_modelled_torque_is_that_of_the_brake_earlier_by_what_the_dead_time_is_believed_less(dead_time):
    signals = (run := simulate(QUIET, designed(PREDICTIVE, dead_time=dead_time), seed=None)).signals
    late = round((PARK2008.actuator.dead_time - dead_time) / 0.01)  # samples
    blend = 1.0 - math.exp(-0.01 / run.controller.observer_time)
    filtered, torque = 0.0, signals.torque
    for k in range(40, 300):
        filtered = run.controller_signals["filtered_torque"][k - 1] * (1 - blend) + blend * torque[k + late]
        assert run.controller_signals["filtered_torque"][k] == pytest.approx(filtered, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("lag", [0.4, 0.9])
def test_the_modelled_torque_follows_the_command_with_the_believed_lag(lag):
    signals = (run := simulate(QUIET, designed(PREDICTIVE, lag=lag), seed=None)).signals
    ahead, command = run.controller_signals["torque_ahead"][:-1], signals.command[:-2]
    expected = ahead[:-1] + (1.0 - math.exp(-0.01 / lag)) * (command - ahead[:-1])
    assert ahead[1:] == pytest.approx(expected, rel=1e-9, abs=1e-6)


@pytest.mark.parametrize("share", [0.8, 1.0, 1.1])
def test_an_assumed_law_is_under_the_believed_wheel_load(share):
    law, load = (
        LookupTable(slip=(0.0, 0.02, 0.1, 0.3, 1.0), mu=(0.0, 0.12, 0.2, 0.15, 0.1)),
        share * PARK2008.wheel_load,
    )
    control = controller_named("asmc", PARK2008, reference=REFERENCE, period=0.01)
    scenario = stop(PARK2008, "dry", adhesion=law).with_changes(disturbances={}, limits={"torque_max": 9e3})
    run = simulate(believing("beliefs.wheel_load", load, scenario), control, seed=None)
    signals, unit = run.signals, ControlUnit(run.controller.assuming(law), PARK2008, run.signals.speed[0])
    before = 0.0
    for k in range(100):
        assert unit.step(signals.measured_speed[k], signals.measured_wheel_speed[k], before).torque == pytest.approx(
            signals.command[k], rel=1e-9, abs=1e-6
        )
        before = signals.command[k]
    assert run.controller.wheel_load == load


@pytest.mark.parametrize("gain", [0.8, 1.0, 1.2])
def test_the_acting_torque_is_the_gain_times_the_command(gain):
    profile = TorqueProfile(times=(0.0,), torques=(1500.0,), period=0.01)
    run = simulate(believing("limits.torque_gain", gain), profile, seed=None)
    assert run.signals.torque[-1] == pytest.approx(gain * 1500.0, rel=1e-3)


PATHS = {
    **{"beliefs.radius": (0.42, 0.44), "beliefs.wheel_inertia": (45.0, 80.0), "beliefs.wheel_load": (2e4, 4e4)},
    **{"beliefs.dead_time": (0.12, 0.18), "beliefs.lag": (0.5, 0.7), "limits.torque_gain": (0.8, 1.1)},
}


@pytest.mark.parametrize("path", PATHS)
def test_a_campaign_draws_it_and_leaves_the_gains_as_they_are(path):
    nominal, scenario = (ASSUMING, ON_TABLE) if path == "beliefs.wheel_load" else (PREDICTIVE, QUIET)
    campaign = Campaign(scenario, (nominal,), 2, (Quantity((path,), Grid(PATHS[path])),))
    name = path.partition(".")[2]
    distances = []
    for i, value in enumerate(PATHS[path]):
        control = designed(nominal, **({name: value} if path.startswith("beliefs") else {}))
        alone = simulate(believing(path, value, scenario), control, seed=campaign.case(i).seed)
        (row,) = run_rows(campaign, i)
        assert row["braking_distance_m"] == alone.braking_distance
        distances.append(alone.braking_distance)
    assert distances[0] != distances[1]


def test_in_a_campaign_the_drawn_vehicle_does_not_reach_the_controller():
    quantities = tuple(
        Quantity((path,), Grid(values))
        for path, values in {"vehicle.wheel.radius": (0.41,), "beliefs.lag": (0.5,)}.items()
    )
    case = Campaign(QUIET, (PREDICTIVE,), 1, quantities).case(0)
    assert (case.scenario.vehicle.wheel.radius, case.controllers[0].radius) == (0.41, PARK2008.wheel.radius)
    assert case.controllers[0].lag == 0.5


def test_unnamed_controllers_of_a_campaign_have_the_names_of_their_kinds():
    twins = [HELD.model_copy(update={"ki": ki, "name": ""}) for ki in (100.0, 129.0)]
    campaign = Campaign(QUIET, (*twins, Predictive, 300 * np.ones(1)[0]), 1)
    assert campaign.controller_names[:3] == ("pi-lead", "pi-lead 2", "predictive")
    rows = run_rows(campaign, 0)
    assert [row["controller"] for row in rows] == list(campaign.controller_names)
    assert rows[0]["braking_distance_m"] != rows[1]["braking_distance_m"]


def test_the_command_line_s_controllers_believe_what_the_scenario_says(tmp_path, railslip):
    (tmp_path / "own.toml").write_text('extends = "stop"\n[beliefs]\nradius = 0.42\n')
    status, text, _ = railslip(
        "simulate", "--scenario", tmp_path / "own.toml", "--controller", "predictive", "--json", "--no-noise"
    )
    control = controller_named(
        "predictive", PARK2008.model_copy(update={"wheel": PARK2008.wheel.model_copy(update={"radius": 0.42})})
    )
    run = simulate(stop(PARK2008, "dry"), control, seed=None)
    assert (status, json.loads(text)["braking_distance_m"]) == (0, pytest.approx(run.braking_distance, rel=1e-9))
