"""`railslip simulate` as its users meet it."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from railslip_ctrl.identification.logs import find_columns
from railslip_ctrl.report.simulation import CSV_COLUMNS, write_simulation_csv
from railslip_ctrl.simulation import Signals, built_in_scenario, simulate
from railslip_ctrl.simulation.catalogue import published_controller
from railslip_ctrl.simulation.scenario import load_scenario

KEYS = (  # interface.md
    *("scenario", "controller", "gains", "inertia_scale", "seed", "stopped", "braking_time_s", "braking_distance_m"),
    *("brake_energy_j", "mean_abs_slip_error", "max_slip", "locked_fraction", "max_torque_nm"),
)


@pytest.fixture
def railslip(railslip, file):
    """`railslip simulate`, in a folder of its own."""
    return partial(railslip, "simulate")


def energy(mass, speed_kmh):
    """What a train and its wheel begin with, J."""
    return pytest.approx(0.5 * (mass + 60.35 / 0.43**2) * (speed_kmh / 3.6) ** 2)


SI = "--scenario park2008-si"
PUBLISHED = {"kp_si": 2340.0, "ki_si": 97.2, "lead_s": 0.0, "lead_filter_s": 0.0}
GAINS = {"kp_si": 190.0, "ki_si": 5.0, "lead_s": 0.0, "lead_filter_s": 0.0}
ENDLESS = "--scenario free.toml --controller"
NONE = dict.fromkeys(("braking_time_s", "braking_distance_m", "brake_energy_j", "mean_abs_slip_error"))
CASES = [
    ("", {"scenario": "park2008", "controller": "pi", "gains": "bristle", "seed": 0, "inertia_scale": 3.6}),
    (f"{SI} --inertia-scale 3.6", {"braking_time_s": pytest.approx(59.0, abs=1.0), "gain_values": PUBLISHED}),
    ("--no-noise", {"seed": None, "random_force_j": 0.0}),
    (f"{SI} --kp 190 --ki 5 --step 2e-3", {"gain_values": GAINS, "gains": None, "step_s": 2e-3, "inertia_scale": 1.0}),
    (f"{SI} --period 0.01 --slip 0.1", {"period_s": 0.01, "reference_slip": {"dry": 0.1, "wet": 0.1}}),
    (f"{SI} --controller asmc --speed 80", {"starting_j": energy(3517, 80)}),
    ("--adhesion beam --controller pi-lead", {"adhesion": "beam", "reference_slip": {"dry": 0.119, "wet": 0.059}}),
    ("--adhesion bristle --no-noise", {"adhesion": "bristle", "reference_slip": {"dry": 0.132, "wet": 0.092}}),
    ("--controller asmc", {"max_slip": pytest.approx(0.4, abs=0.2), "first_lock_s": None}),
    ("--controller asmc --unknown-rail", {"max_slip": 1.0, "first_lock_s": pytest.approx(54.6, abs=1)}),
    ("--vehicle train.toml --loaded", {"vehicle": "train", "inertia_scale": 1.0, "starting_j": energy(4000, 100)}),
    (f"{ENDLESS} huge.toml", {**NONE, "stopped": False, "outcome": "not a number"}),
    pytest.param(f"{ENDLESS} idle.toml", {**NONE, "stopped": False, "ended_at_s": 180.0}, marks=pytest.mark.long),
]


@pytest.mark.parametrize(("words", "expected"), CASES)
def test_options_reach_the_run(railslip, file, words, expected):
    file("train.toml", "mass = 3000\nmass_loaded = 4000\n")
    file("free.toml", 'extends = "park2008"\n[limits]\ntorque_min = -1e308\n')
    for name, torque in (("idle", 0), ("huge", -1e308)):
        file(f"{name}.toml", f'kind = "torque-profile"\ntimes = [0, 1]\ntorques = [0, {torque}]\n')
    status, out, err = railslip(*words.split(), "--json")
    found = json.loads(out)
    assert status == (0 if expected.get("stopped", True) else 1), err
    assert {name: (found | found["energy_balance"])[name] for name in expected} == expected
    if "train" in words:
        assert "inertia scale 1, the file's, in place of the scenario's 3.6" in err
        assert "No travelling resistance is given" in err
        assert f"Begins with            mass 4000 kg, wheel load {4000 * 9.80665:g} N" in railslip(*words.split())[1]
    if not found["stopped"]:
        assert f"NO STOP: {found['outcome']}, after" in railslip(*words.split())[1]


def test_json_has_the_contract_s_keys_and_the_run_s_numbers(railslip):
    found = json.loads(railslip("--scenario", "park2008", "--gains", "beam", "--seed", "7", "--json")[1])
    assert set(KEYS) <= found.keys()
    run = simulate(built_in_scenario("park2008"), published_controller("pi", "beam"), seed=7)
    assert [found[key] for key in KEYS[:6]] == ["park2008", "pi", "beam", 3.6, 7, True]
    for name in ("braking_time_s", "braking_distance_m", "mean_abs_slip_error", "mean_abs_slip_error_published"):
        assert found[name] == getattr(run, name.removesuffix("_s").removesuffix("_m"))
    assert found["mean_abs_slip_error_published"] != found["mean_abs_slip_error"]  # 0.119/0.059 is held


def test_the_csv_is_the_record(tmp_path):
    run = simulate(built_in_scenario("park2008-si"), published_controller("asmc"), seed=2, record_every=10)
    write_simulation_csv(run, tmp_path / "run.csv")
    back = pd.read_csv(tmp_path / "run.csv")
    assert tuple(CSV_COLUMNS) == Signals._fields
    assert list(back)[: len(CSV_COLUMNS)] == list(CSV_COLUMNS.values())
    assert list(back)[len(CSV_COLUMNS) :] == [f"controller {name}" for name in run.controller_signals]
    record = pd.DataFrame({**run.signals._asdict(), **run.controller_signals})
    # 12 digits are written
    np.testing.assert_allclose(back.to_numpy(), record.to_numpy(), rtol=1e-11, atol=1e-300)
    found = find_columns(list(back))  # as `railslip identify` reads it
    units = {"time": "s", "train_speed": "m/s", "wheel_angular_speed": "rad/s", "brake_torque": "N*m"}
    headers = {name: f"{name.replace('_', ' ')} [{unit}]" for name, unit in units.items()}
    assert {name: column.header for name, column in found.items()} == headers


EVENTS = """extends = "park2008-si"
rail = "wet"
events = [{distance = 100000, mass = 5000}, {time = 9.0, mass = 4000},
          {distance = 100, mass = 3800}, {time = 1.0, mass = 3700}]
"""


@pytest.mark.parametrize("log_period", ["0.01", "2.5"])
def test_events_are_told_in_order_of_happening(railslip, file, log_period):
    """Three events out of order in the file, the one in distance second; a fourth is never reached."""
    signals = simulate(load_scenario(file("events.toml", EVENTS)), published_controller("pi"), seed=0).signals
    at = np.interp(100.0, signals.distance, signals.time)  # rows every 1 ms, the train's speed all but constant
    assert signals.mass[np.searchsorted(signals.time, at + 0.001)] == 3800.0  # as the plant had it
    arguments = ("--scenario", "events.toml", "--log-period", log_period)
    found = json.loads(railslip(*arguments, "--json")[1])["events"]
    assert [event["mass"] for event in found] == [3700.0, 3800.0, 4000.0, 5000.0]
    assert [event["reached"] for event in found] == [True, True, True, False]
    # the cubic between rows 2.5 s apart: a few ms of smooth change, and the noise in the speed at its ends
    assert found[1]["happened_at_s"] == pytest.approx(at, abs=1e-6 if log_period == "0.01" else 0.02)
    assert found[3]["happened_at_s"] is None
    lines = [line for line in railslip(*arguments)[1].splitlines() if line.startswith("Event")]
    assert [line.split()[2] for line in lines] == ["1", "100", "9", "100000"]
    assert f"(at {found[1]['happened_at_s']:.4g} s)" in lines[1]
    assert ["NOT REACHED" in line for line in lines] == [False, False, False, True]


def test_a_log_period_between_samples_is_said_and_a_folder_takes_report_series_and_pictures(railslip):
    arguments = ("--csv", "run.csv", "--log-period")
    assert "--log-period: rows are 0.014 s apart, not 0.0137 s" in railslip(*arguments, "0.0137")[2]
    assert np.diff(pd.read_csv("run.csv")["time [s]"])[:-1] == pytest.approx(0.014)  # the last is the stop
    assert "--log-period" not in railslip(*arguments, "0.03")[2]
    assert "--log-period" not in railslip("--log-period", "0.0137")[2]  # nothing is written
    status, _, err = railslip("--controller", "scheduled", "--out", "run")
    assert (status, "wrote 5 files to run" in err) == (0, True)
    written = {path.name for path in Path("run").iterdir()}
    assert written == {f"simulation.{form}" for form in ("txt", "json", "csv", "png", "svg")}
