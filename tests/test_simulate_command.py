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


@pytest.fixture
def numbers(railslip):
    """The JSON of a run that stops."""

    def run(*arguments):
        status, out, err = railslip(*arguments, "--json")
        assert status == 0, err
        return json.loads(out)

    return run


def test_json_has_the_contract_s_keys_and_the_run_s_numbers(numbers):
    found = numbers("--scenario", "park2008", "--controller", "asmc", "--gains", "beam", "--seed", "7")
    assert set(KEYS) <= found.keys()
    run = simulate(built_in_scenario("park2008"), published_controller("asmc", "beam"), seed=7)
    assert [found[key] for key in KEYS[:6]] == ["park2008", "asmc", "beam", 3.6, 7, True]
    for name in ("braking_time_s", "braking_distance_m", "mean_abs_slip_error", "mean_abs_slip_error_published"):
        assert found[name] == getattr(run, name.removesuffix("_s").removesuffix("_m"))
    assert found["mean_abs_slip_error_published"] != found["mean_abs_slip_error"]  # 0.119/0.059 is held
    assert found["reference_slip"] == {"dry": 0.119, "wet": 0.059}


def test_the_default_run_is_the_published_pi_with_noise(numbers):
    found = numbers()
    assert (found["scenario"], found["controller"], found["gains"], found["seed"]) == ("park2008", "pi", "bristle", 0)
    assert found["gain_values"]["kp_si"] == pytest.approx(3.6 * 650)
    quiet = numbers("--no-noise")
    assert (quiet["seed"], quiet["energy_balance"]["random_force_j"]) == (None, 0.0)


def test_options_reach_the_run(numbers):
    found = numbers("--scenario", "park2008-si", "--kp", 190, "--ki", 5, "--step", "2 ms", "--period", 0.01)
    assert found["gain_values"] == {"kp_si": 190.0, "ki_si": 5.0, "lead_s": 0.0, "lead_filter_s": 0.0}
    assert [found[key] for key in ("inertia_scale", "gains", "step_s", "period_s")] == [1.0, None, 0.002, 0.01]
    scaled = numbers("--scenario", "park2008-si", "--inertia-scale", 3.6)
    assert scaled["braking_time_s"] == pytest.approx(numbers()["braking_time_s"])
    slower = numbers("--scenario", "park2008-si", "--controller", "asmc", "--speed", 80, "--slip", 0.1)
    assert slower["energy_balance"]["starting_j"] == pytest.approx(0.5 * (3517 + 60.35 / 0.43**2) * (80 / 3.6) ** 2)
    assert slower["reference_slip"] == {"dry": 0.1, "wet": 0.1}


def test_other_adhesion_and_an_unknown_rail(numbers):
    for law, slip in (("beam", 0.119), ("bristle", 0.132)):
        found = numbers("--adhesion", law, "--controller", "pi-lead", "--no-noise")
        assert (found["adhesion"], found["reference_slip"]["dry"]) == (law, slip)
    known, unknown = (numbers("--controller", "asmc", *more) for more in ((), ("--unknown-rail",)))
    assert known["max_slip"] < 1.0 == unknown["max_slip"]
    assert unknown["first_lock_s"] > 25.0


def test_another_vehicle_with_what_was_assumed_of_it(railslip, file):
    train = file("train.toml", "mass = 3000\nmass_loaded = 4000\n")
    given = ("--vehicle", train, "--controller", "slide-protection", "--loaded")
    status, out, err = railslip(*given, "--json")
    found = json.loads(out)
    assert (status, found["vehicle"], found["inertia_scale"]) == (0, "train", 1.0)
    assert "inertia scale 1, the file's, in place of the scenario's 3.6" in err
    assert "No travelling resistance is given" in err
    assert f"Begins with            mass 4000 kg, wheel load {4000 * 9.80665:g} N" in railslip(*given)[1]
    assert found["energy_balance"]["starting_j"] == pytest.approx(0.5 * (4000 + 60.35 / 0.43**2) * (100 / 3.6) ** 2)


@pytest.mark.long
@pytest.mark.parametrize(("limits", "profile"), [
    ("", "times = [0]\ntorques = [0]\n"),
    ("[limits]\ntorque_min = -1e308\n", "times = [0, 1]\ntorques = [0, -1e308]\n"),
], ids=["no torque", "beyond all bounds"])  # fmt: skip
def test_a_run_that_does_not_stop_has_no_braking_distance(railslip, file, limits, profile):
    own, free = f'kind = "torque-profile"\n{profile}', f'extends = "park2008"\n{limits}'
    run = ("--scenario", file("free.toml", free), "--controller", file("own.toml", own))
    status, out, _ = railslip(*run, "--json")
    found = json.loads(out)
    assert (status, found["stopped"], found["outcome"] == "did not stop") == (1, False, not limits)
    for key in ("braking_time_s", "braking_distance_m", "brake_energy_j", "mean_abs_slip_error"):
        assert found[key] is None
    assert found["ended_at_s"] == 180.0 or limits
    assert f"NO STOP: {found['outcome']}, after" in railslip(*run)[1]


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


def test_a_log_period_between_samples_is_said(railslip):
    arguments = ("--csv", "run.csv", "--log-period")
    assert "--log-period: rows are 0.014 s apart, not 0.0137 s" in railslip(*arguments, "0.0137")[2]
    assert np.diff(pd.read_csv("run.csv")["time [s]"])[:-1] == pytest.approx(0.014)  # the last is the stop
    assert "--log-period" not in railslip(*arguments, "0.03")[2]
    assert "--log-period" not in railslip("--log-period", "0.0137")[2]  # nothing is written


def test_a_folder_takes_report_series_and_pictures(railslip):
    status, _, err = railslip("--controller", "scheduled", "--out", "run")
    assert (status, "wrote 5 files to run" in err) == (0, True)
    assert {path.name for path in Path("run").iterdir()} == {
        f"simulation.{x}" for x in ["txt", "json", "csv", "png", "svg"]
    }
