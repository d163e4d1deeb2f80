"""The command as its users meet it: output, JSON, exit status, and bad input."""

import json
import shlex
import subprocess
import sys

import numpy as np
import pytest
from project import refused

PUBLISHED_CASE = {"adhesion": "bristle", "rail": "dry", "speed_kmh": 100.0, "slip": 0.132, "mass_kg": 3517.0}


def cases(out):
    return json.loads(out)["cases"]


def test_margins_json_has_the_contract_s_keys_and_oracle_numbers(railslip):
    status, out, err = railslip("margins", "--rail", "dry", "--kp", "190", "--ki", "5", "--json")
    assert (status, err) == (0, "")
    (case,) = cases(out)
    assert {k: case[k] for k in PUBLISHED_CASE} == PUBLISHED_CASE
    assert case["controller"] == {"kp_si": 190.0, "ki_si": 5.0}
    assert case["actuator"] == {"dead_time_s": 0.15, "lag_s": 0.6}
    assert (case["stable"], case["unstable_closed_loop_poles"], case["open_loop_unstable_poles"]) == (True, 0, 1)
    assert len(case["closed_loop_poles"]) >= 4
    assert np.diff([p[0] for p in case["closed_loop_poles"]]).max() <= 0
    gains = (case["gain_decrease"], case["gain_increase"])
    assert gains == pytest.approx((0.70170425, 2.89166823), abs=5.1e-9)
    assert case["stabilizing_gain_range"] == pytest.approx(gains)
    assert case["disk_margin"] == pytest.approx(0.1792, abs=5e-5)
    assert [row["order"] for row in case["pade"]] == [1, 2, 3, 4, 5]
    assert case["pade"][4]["phase_margin_deg"] == pytest.approx(case["phase_margin_deg"], rel=1e-9)


def test_margins_default_is_both_rails_table_4_in_si_and_unstable(railslip):
    status, out, _ = railslip("margins", "--json")
    found = cases(out)
    assert (status, [c["rail"] for c in found]) == (1, ["dry", "wet"])
    for case in found:
        assert case["controller"] == pytest.approx({"kp_si": 2340.0, "ki_si": 97.2})
        assert (case["stable"], case["unstable_closed_loop_poles"]) == (False, 2)
        names = ("gain_increase", "gain_decrease", "phase_margin_deg", "delay_margin_s", "ms", "mt", "disk_margin")
        assert {case[name] for name in names} == {None}
        assert case["stabilizing_gain_range"][1] < 1


def test_linearize_json(railslip):
    status, out, _ = railslip("linearize", "--rail", "dry", "--json")
    (case,) = cases(out)
    assert (status, case["states"], case["outputs"]) == (0, ["sigma", "z"], ["sigma", "lambda", "error"])
    assert case["brake_torque_nm"] == pytest.approx(4787.78, abs=0.0051)
    assert case["adhesion_force_n"] / 34500 == pytest.approx(0.29850, abs=5.1e-6)
    eigenvalues = np.linalg.eigvals(np.array(case["A"]))
    assert sorted(p[0] for p in case["poles"]) == pytest.approx(sorted(eigenvalues.real), rel=1e-12)
    out = railslip("linearize", "--rail", "dry", "--speed-state", "--json")[1]
    assert cases(out)[0]["states"] == ["v", "sigma", "z"]


def test_values_may_carry_their_unit_and_dead_time_and_lag_be_zero(railslip):
    plain = "margins --rail dry --kp 234 --ki 5 --mass 3500 --json"
    with_unit = "margins --rail dry --kp '65 N*m/(km/h)' --ki '5 N' --mass '3.5 t' --speed '100 km/h' --json"
    a, b = (cases(railslip(*shlex.split(words))[1])[0] for words in (plain, with_unit))
    assert a["stable"]
    assert a["phase_margin_deg"] == pytest.approx(b["phase_margin_deg"], rel=1e-12)
    status, out, _ = railslip(*shlex.split("margins --rail dry --dead-time 0 --lag 0 --kp 2000 --ki 90 --json"))
    assert (status, cases(out)[0]["gain_increase"]) == (0, None)  # without bound
    assert all(row["stable"] for row in cases(out)[0]["pade"])


@pytest.mark.parametrize(("words", "told"), [
    ("margins --mass -3", "--mass: -3 kg is not allowed; give a value > 0 kg"),
    ("margins --slip 1", "--slip: 1 is not allowed; give a value < 1"),
    ("margins --slip -0.1", "--slip: -0.1 is not allowed; give a value >= 0"),
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
    ("margins --speed fast", "km/h"),
    ("margins --kp nan --ki 5", "--kp: nan is not allowed; give a finite number"),
    ("margins --kp '65 N*m' --ki 5", "--kp: '65 N*m' has the wrong dimension"),
    ("margins --kp 190", "--ki: is missing beside --kp; give both gains"),
    ("margins --rail icy", "--rail: 'icy' is not a rail condition; choose dry or wet"),
    ("margins --adhesion lugre", "--adhesion 'lugre': "),
    ("margins --initial-speed 200", "30 to 140"),
    ("margins --initial-speed 140 --speed 140 --slip 0.9", "0.827"),
    (f"margins --adhesion beam --slip {3 * 0.261 * 34500 / 274360!r} --rail dry", "kink"),
    ("margins --inertia-scale 0", "--inertia-scale: 0 is not allowed; give a value > 0"),
    ("margins --dead-time -1", "--dead-time: -1 s is not allowed; give a value >= 0 s"),
    ("margins --vehicle .", "--vehicle: '.' is not a file; give its path"),
    ("margins --nonsense", "--nonsense"),
    ("margins surplus", "surplus"),
    ("margin", "'margin' is no command; did you mean 'margins'?"),
    ("xyzzy", "'xyzzy' is no command; choose one of report, "),
    ("tune", "--ms-max: is missing"),
    ("tune --ms-max 1", "--ms-max: 1 is not allowed; give a value > 1"),
    ("tune --ms-max 2 --ki-min 5", "--minimise-ms and --ki-min: go together"),
    ("tune --minimise-ms", "--minimise-ms and --ki-min: go together"),
    ("tune --structure pdf", "error: --structure: 'pdf' is not known; choose one of pi, pi-lead, pid"),
    ("tune --ms-max 2 --lead 0.6", "error: --lead: does not go with structure 'pi'"),
    ("tune --ms-max 2 --lead-filter 0.6", "error: --lead-filter: does not go with structure 'pi'"),
    ("report --no-html --out .", "--out: the working folder itself is not taken"),
])  # fmt: skip
def test_bad_input_is_one_clear_line_and_exit_2(railslip, words, told, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert told in refused(railslip(*shlex.split(words), "--json"))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("arguments", "speed", "advised"), [
    (("--speed", "100 m/s"), "360", False),  # above 140 km/h, to where the published parameters go
    (("--speed", "120"), "120", True),
    (("--speed", "100 m/s", "--adhesion", "polach", "--slip", "0.05"), "360", True),  # knows no v0
    (("--speed", "120", "--adhesion", "law.toml"), "120", False),  # its polynomials end at 110 km/h
    (("--speed", "105", "--adhesion", "law.toml"), "105", True),
])  # fmt: skip
def test_a_speed_above_v0_is_advised_only_what_is_taken(railslip, tmp_path, monkeypatch, arguments, speed, advised):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "law.toml").write_text(
        'law = "dahl"\ninitial_speed_range = [30, 110]\n[parameters]\nalpha = 2.0e4\n[polynomials]\nFc = [1e4, -10]\n'
        "[reference_slip]\ndry = 0.12\nwet = 0.08\n"
    )
    status, _, err = railslip("linearize", "--rail", "dry", *arguments)
    (told,) = (line for line in err.splitlines() if line.startswith("railslip: warning: --speed: "))
    assert (status, "--initial-speed" in told) == (0, advised)
    status, _, err = railslip("linearize", "--rail", "dry", *arguments, "--initial-speed", speed)
    assert status == (0 if advised else 2)
    if advised:
        assert told.endswith(f"give another, or --initial-speed {speed}")
        assert "--speed: " not in err


def test_what_was_assumed_of_a_railtoolkit_vehicle_is_said(railslip):
    yaml = "tests/data/rolling-stock/Facs124.yaml"
    for command in ("margins", "linearize"):
        _, out, err = railslip(command, "--vehicle", yaml, "--rail", "dry")
        assert "4 axles are assumed" in err
        assert "Facs 124" in out
    case = cases(railslip("margins", "--vehicle", yaml, "--rail", "dry", "--json", "--initial-speed", "80")[1])[0]
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
