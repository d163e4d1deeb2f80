"""The command as its users meet it: output, JSON, exit status, and bad input."""

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from project import refused

PUBLISHED_CASE = {"adhesion": "bristle", "rail": "dry", "speed_kmh": 100.0, "slip": 0.132, "mass_kg": 3517.0}


@pytest.fixture
def cases(railslip):
    """The cases of a command's JSON, its exit status, and standard error."""

    def run(words):
        status, out, err = railslip(*shlex.split(words), "--json")
        return json.loads(out)["cases"], status, err

    return run


def test_margins_json_has_the_contract_s_keys_and_oracle_numbers(cases):
    (case,), *ended = cases("margins --rail dry --kp 190 --ki 5")
    assert ended == [0, ""]
    assert {k: case[k] for k in PUBLISHED_CASE} == PUBLISHED_CASE
    assert case["controller"] == {"kp_si": 190.0, "ki_si": 5.0}
    assert case["actuator"] == {"dead_time_s": 0.15, "lag_s": 0.6}
    assert (case["stable"], case["unstable_closed_loop_poles"], case["open_loop_unstable_poles"]) == (True, 0, 1)
    assert np.diff([p[0] for p in case["closed_loop_poles"]]).max() <= 0
    gains = (case["gain_decrease"], case["gain_increase"])
    assert gains == pytest.approx((0.70170425, 2.89166823), abs=5.1e-9)
    assert case["stabilizing_gain_range"] == pytest.approx(gains)
    assert case["disk_margin"] == pytest.approx(0.1792, abs=5e-5)
    assert [row["order"] for row in case["pade"]] == [1, 2, 3, 4, 5]
    assert case["pade"][4]["phase_margin_deg"] == pytest.approx(case["phase_margin_deg"], rel=1e-9)


def test_margins_default_is_both_rails_table_4_in_si_and_unstable(cases):
    found, status, _ = cases("margins")
    assert (status, [c["rail"] for c in found]) == (1, ["dry", "wet"])
    for case in found:
        assert case["controller"] == pytest.approx({"kp_si": 2340.0, "ki_si": 97.2})
        assert (case["stable"], case["unstable_closed_loop_poles"]) == (False, 2)
        names = ("gain_increase", "gain_decrease", "phase_margin_deg", "delay_margin_s", "ms", "mt", "disk_margin")
        assert {case[name] for name in names} == {None}
        assert case["stabilizing_gain_range"][1] < 1


def test_linearize_json(cases):
    (case,), status, _ = cases("linearize --rail dry")
    assert (status, case["states"], case["outputs"]) == (0, ["sigma", "z"], ["sigma", "lambda", "error"])
    assert case["brake_torque_nm"] == pytest.approx(4787.78, abs=0.0051)
    assert case["adhesion_force_n"] / 34500 == pytest.approx(0.29850, abs=5.1e-6)
    eigenvalues = np.linalg.eigvals(np.array(case["A"]))
    assert sorted(p[0] for p in case["poles"]) == pytest.approx(sorted(eigenvalues.real), rel=1e-12)
    assert cases("linearize --rail dry --speed-state")[0][0]["states"] == ["v", "sigma", "z"]


def test_values_may_carry_their_unit_and_dead_time_and_lag_be_zero(cases):
    (a,), *_ = cases("margins --rail dry --kp 234 --ki 5 --mass 3500")
    (b,), *_ = cases("margins --rail dry --kp '65 N*m/(km/h)' --ki '5 N' --mass '3.5 t' --speed '100 km/h'")
    assert a["stable"]
    assert a["phase_margin_deg"] == pytest.approx(b["phase_margin_deg"], rel=1e-12)
    (case,), status, _ = cases("margins --rail dry --dead-time 0 --lag 0 --kp 2000 --ki 90")
    assert (status, case["gain_increase"]) == (0, None)  # without bound
    assert all(row["stable"] for row in case["pade"])


FILES = {
    "law.toml": 'law = "dahl"\nparameters = {alpha = 1e4, Fc = 9e3}\nreference_slip = {dry = 0.1, wet = 0.1}',
    "log.csv": "time [s],v [m/s],omega [rad/s],torque [N*m]\n0,30,69,0\n",
    "mine.toml": 'extends = "park2008"\ninitial_speed = 50.0\nadhesion = "law.toml"\n',
    "own.toml": 'kind = "pi"\nkp = 100\nki = 10\n',
}
GIVEN = "does not go with a controller from a file"
TWICE = "identify log.csv {0} train_speed=1 {0} train_speed=2"
SEEDS = "give a whole number from 2 to 100000"


@pytest.mark.parametrize(("words", "told"), [
    ("margins --mass -3", "--mass: -3 kg is not allowed; give a value > 0 kg"),
    ("margins --slip 1", "--slip: 1 is not allowed; give a value < 1"),
    ("margins --slip 0", "rest"),
    ("margins --speed 1e9", "--speed: the law's own slip 0.132 at 1e+09 km/h is outside the domain"),
    ("margins --speed 1e9 --slip 0.1", "--slip: 0.1 at 1e+09 km/h is outside the domain"),
    ("margins --speed 1e9 --envelope default", "--speed: 1e+09 is not allowed; give finite values > 0 and <= 1000"),
    ("margins --slip 0.9 --envelope default", "--slip: 1.25 times the reference slip on dry rail, 0.9, is a"),
    ("margins --adhesion nosuch --envelope default", "error: --adhesion: 'nosuch' is not a law"),
    ("margins --adhesion nosuch.py --envelope default", "error: --adhesion: nosuch.py: no such file"),
    ("margins --adhesion table --envelope default", "error: --adhesion 'table': a table gives no parameters"),
    ("margins --initial-speed 200 --envelope default", "error: --initial-speed: 200 km/h is outside 30 to 140"),
    ("margins --controller asmc", "error: --controller: asmc is not linear and has no margins"),
    ("margins --kp nan --ki 5", "--kp: nan is not allowed; give a finite number"),
    ("margins --kp '65 N*m' --ki 5", "--kp: '65 N*m' has the wrong dimension"),
    ("margins --kp 190", "--ki: is missing beside --kp; give both gains"),
    ("margins --rail icy", "--rail: 'icy' is not a rail condition; choose dry or wet"),
    ("margins --initial-speed 140 --speed 140 --slip 0.9", "0.827"),
    (f"margins --adhesion beam --slip {3 * 0.261 * 34500 / 274360!r} --rail dry", "kink"),
    ("margins --inertia-scale 0", "--inertia-scale: 0 is not allowed; give a value > 0"),
    ("margins --dead-time -1", "--dead-time: -1 s is not allowed; give a value >= 0 s"),
    ("margins --vehicle .", "--vehicle: '.' is not a file; give its path"),
    ("margins --nonsense", "--nonsense"),
    ("margin", "'margin' is no command; did you mean 'margins'?"),
    ("xyzzy", "'xyzzy' is no command; choose one of report, "),
    ("tune", "--ms-max: is missing"),
    ("tune --ms-max 1", "--ms-max: 1 is not allowed; give a value > 1"),
    ("tune --minimise-ms", "--minimise-ms and --ki-min: go together"),
    ("tune --structure pdf", "error: --structure: 'pdf' is not known; choose one of pi, pi-lead, pid"),
    ("tune --ms-max 2 --lead 0.6", "error: --lead: does not go with structure 'pi'"),
    ("tune --ms-max 2 --lead-filter 0.6", "error: --lead-filter: does not go with structure 'pi'"),
    ("report --no-html --out .", "--out: the working folder itself is not taken"),
    ("verify --law paper --adhesion law.toml", "--adhesion: dahl as given does not go with the law 'paper'"),
    ("verify --law paper --slip 0.1", "--slip: 0.1 does not go with the law 'paper'"),
    ("verify --law robust --ki-min 60", "--ki-min: 60 is not allowed; the law 'robust' is not tuned, leave it out"),
    ("verify --law theirs", "--law: 'theirs' is not allowed; give 'paper' or 'robust' or 'layered'"),
    ("verify --K 1e6", "--K: 1e+06 is not allowed; give a value from 0 to 10000 (N*m)"),
    ("verify --law layered --D 3", "--D: 3 is not allowed; the layered law has no D, leave it out"),
    ("verify --D 0.01", "--D: 0.01 is not allowed; give a value from 0.1 to 10000 (N*m/(m/s))"),
    ("verify --law layered --K 0", "--K: 0 is not allowed; the layered law takes a value > 0 up to 10000 (N*m)"),
    ("verify --inertia-scale 50", "--inertia-scale: 50 is not allowed; give a value from 0.5 to 10"),
    *((f"verify --seed {seed}", "give a whole number from 0 to 2147483648") for seed in ("1.5", "99999999999999")),
    ("derive --reference falling", "--reference: 'falling' is not known"),
    ("derive --adhesion glue", "--adhesion: 'glue' is not a law"),
    ("derive --adhesion law.py", "--adhesion: law.py: a Python file is not derived with"),
    ("derive --out .", "--out: '.' is a folder"),
    ("derive --format c --json", "--format: 'c' beside --json is not allowed; give one of the two"),
    *((f"derive {law} --initial-speed 60", "--initial-speed: goes with a file") for law in ("", "--adhesion beam")),
    *((f"reproduce --seeds={seeds}", SEEDS) for seeds in ("1", "many", "100001", "9" * 30)),
    ("identify log.csv --model beem", "--model: 'beem' cannot be fitted; did you mean 'beam'"),
    ("identify log.csv --observer luenberger", "--observer: 'luenberger' is not known; choose corrected, printed, kal"),
    ("identify log.csv --tau 0", "--tau: 0 s is not allowed; give a value > 0 s"),
    ("identify log.csv --column time", "--column: 'time' is not allowed; give NAME=VALUE"),
    ("identify log.csv --fix mu_max=high", "--fix mu_max: 'high' is not a number"),
    ("identify log.csv --bound mu_max=0.2", "--bound mu_max: '0.2' is not allowed; give LOW:HIGH"),
    ("identify log.csv --fix q=1", "--fix: 'q' is no parameter here"),
    ("identify log.csv --vehicle nothing.toml", "--vehicle: nothing.toml"),
    ("simulate --scenario park2009", "--scenario: 'park2009' is not one; choose one of park2008, park2008-si, stop"),
    ("simulate --controller pid", "--controller: 'pid' is not one; did you mean 'pi'"),
    ("simulate --gains dahl", "--gains: 'dahl' is not a column of Table 4; choose beam or bristle"),
    ("simulate --controller asmc --kp 1 --ki 1", "'asmc' has no kp and ki"),
    ("simulate --unknown-rail", "--controller: 'pi' has neither adaptation nor a model"),
    ("simulate --adaptive --controller pi-lead", "choose 'asmc'"),
    ("simulate --seed -1", "--seed: '-1' is not allowed; give a whole number"),
    ("simulate --initial-speed 5", "--initial-speed: 5 km/h is outside 30 to 140 km/h"),
    ("simulate --speed 5", "--speed: 5 km/h is not allowed; give a value > 5 km/h, at which the run ends"),
    ("simulate --step 3", "error: --step: 3 s is not allowed; give a value <= 1 s"),
    ("simulate --period 0", "--period: 0 s is not allowed"),
    ("simulate --csv no/such/folder/run.csv", "--csv: 'no/such/folder' is not a folder to write to"),
    (f"simulate --csv {os.devnull}", "is not a regular file; choose another"),
    ("simulate --csv .", "--csv: '.' is a folder; give a file name"),
    *((f"simulate --controller own.toml {x}", GIVEN) for x in ("--gains beam", "--kp 1", "--slip 0.1", "--adaptive")),
    ("simulate --controller own.toml --period 0.1", GIVEN),
    ("simulate --scenario mine.toml --initial-speed 80", "this scenario's adhesion has parameters of its"),
    # the scenario's own initial speed is what a published law cannot have
    ("simulate --scenario mine.toml --adhesion curve", "--scenario: its initial speed 180 km/h is outside 30 to 140"),
    ("margins --kp 1 --ki 1 --kp 2", "--kp: is given 2 times; give it once"),
    ("simulate --seed 1 --seed=1", "--seed: is given 2 times; give it once"),
    ("report --html --no-html", "--html: is given 2 times; give it once"),
    *((TWICE.format(x), f"{x}: train_speed is given twice") for x in ("--delay", "--zero", "--column", "--unit")),
])  # fmt: skip
def test_bad_input_is_one_clear_line_and_exit_2(railslip, file, words, told):
    written = {file(name, text) for name, text in FILES.items()}
    assert told in refused(railslip(*shlex.split(words)))
    assert {path.name for path in Path.cwd().iterdir()} == written


def test_an_option_that_may_be_given_again_counts_once(railslip):
    once = railslip("linearize", "--speed", "100", "--rail", "dry", "--json")
    assert once[0] == 0
    assert railslip("linearize", "--speed", "100", "--speed", "100", "--rail", "dry", "--json", "--json") == once


DAHL = """law = "dahl"
initial_speed_range = [30, 110]
parameters = {alpha = 2.0e4}
polynomials = {Fc = [1e4, -10]}
reference_slip = {dry = 0.12, wet = 0.08}
"""


@pytest.mark.parametrize(("arguments", "speed", "advised"), [
    (("--speed", "100 m/s"), "360", False),  # above 140 km/h, to where the published parameters go
    (("--speed", "120"), "120", True),
    (("--speed", "100 m/s", "--adhesion", "polach", "--slip", "0.05"), "360", True),  # knows no v0
    (("--speed", "120", "--adhesion", "law.toml"), "120", False),  # its polynomials end at 110 km/h
    (("--speed", "105", "--adhesion", "law.toml"), "105", True),
])  # fmt: skip
def test_a_speed_above_v0_is_advised_only_what_is_taken(railslip, file, arguments, speed, advised):
    file("law.toml", DAHL)
    status, _, err = railslip("linearize", "--rail", "dry", *arguments)
    (told,) = (line for line in err.splitlines() if line.startswith("railslip: warning: --speed: "))
    assert (status, "--initial-speed" in told) == (0, advised)
    status, _, err = railslip("linearize", "--rail", "dry", *arguments, "--initial-speed", speed)
    assert status == (0 if advised else 2)
    if advised:
        assert told.endswith(f"give another, or --initial-speed {speed}")
        assert "--speed: " not in err


def test_what_was_assumed_of_a_railtoolkit_vehicle_is_said(railslip, cases):
    yaml = "tests/data/rolling-stock/Facs124.yaml"
    for command in ("margins", "linearize"):
        _, out, err = railslip(command, "--vehicle", yaml, "--rail", "dry")
        assert "4 axles are assumed" in err
        assert "Facs 124" in out
    (case,), *_ = cases(f"margins --vehicle {yaml} --rail dry --initial-speed 80")
    assert (any("axles" in note for note in case["notes"]), case["initial_speed_kmh"]) == (True, 80)


def test_a_report_that_cannot_be_written_is_refused_before_the_work(railslip, tmp_path):
    (tmp_path / "report.txt").write_text("old")
    (tmp_path / "loop.png").mkdir()  # in the way of a picture
    for out, told in ((tmp_path, "loop.png"), (tmp_path / "report.txt", "--out")):
        assert told in refused(railslip("report", "--rail", "dry", "--out", out))
    assert (tmp_path / "report.txt").read_text() == "old"
    assert {p.name for p in tmp_path.iterdir()} == {"report.txt", "loop.png"}


def test_output_survives_a_closed_pipe():
    command = [sys.executable, "-m", "railslip_ctrl", "margins", "--rail", "dry", "--kp", "190", "--ki", "5"]
    piped = subprocess.run(["sh", "-c", f"{' '.join(command)} | head -1"], capture_output=True, check=True)
    assert piped.stderr == b""


def test_tune_infeasible_is_exit_1_with_the_reason_and_what_can_be_had(railslip):
    status, out, _ = railslip(*shlex.split("tune --ms-max 2 --speed 100 --json"))
    found = json.loads(out)
    assert (status, found["feasible"], found["kp_si"], found["worst"]) == (1, False, None, None)
    assert "Ms <= 2 is asked for" in found["reason"]
