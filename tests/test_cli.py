"""The command as its users meet it: output, JSON, exit status, and bad input."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys

import numpy as np
import pytest

from railslip_ctrl.model.adhesion import law_classes

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
    assert case["open_loop_unstable_poles"] == 1
    assert (case["stable"], case["unstable_closed_loop_poles"]) == (True, 0)
    assert len(case["closed_loop_poles"]) >= 4
    assert np.diff([p[0] for p in case["closed_loop_poles"]]).max() <= 0
    assert case["gain_increase"] == pytest.approx(2.89166823, abs=5.1e-9)
    assert case["gain_decrease"] == pytest.approx(0.70170425, abs=5.1e-9)
    assert case["stabilizing_gain_range"] == pytest.approx([case["gain_decrease"], case["gain_increase"]])
    assert case["disk_margin"] == pytest.approx(0.1792, abs=5e-5)
    assert [row["order"] for row in case["pade"]] == [1, 2, 3, 4, 5]
    assert case["pade"][4]["phase_margin_deg"] == pytest.approx(case["phase_margin_deg"], rel=1e-9)


def test_margins_default_is_both_rails_table_4_in_si_and_unstable(railslip):
    status, out, _ = railslip("margins", "--json")
    assert status == 1
    found = cases(out)
    assert [c["rail"] for c in found] == ["dry", "wet"]
    for case in found:
        assert case["controller"] == pytest.approx({"kp_si": 2340.0, "ki_si": 97.2})
        assert case["stable"] is False
        assert case["unstable_closed_loop_poles"] == 2
        for key in ("gain_increase", "gain_decrease", "phase_margin_deg", "delay_margin_s", "ms", "mt", "disk_margin"):
            assert case[key] is None
        assert case["stabilizing_gain_range"][1] < 1


def test_margins_exit_1_if_any_case_fails(railslip):
    status, out, _ = railslip("margins", "--kp", "128", "--ki", "3.5", "--json")
    assert [c["stable"] for c in cases(out)] == [False, True]
    assert status == 1


def test_cases_come_in_the_order_rail_speed(railslip):
    _, out, _ = railslip("linearize", "--speed", 60, "--speed", 100, "--rail", "wet", "--rail", "dry", "--json")
    assert [(c["rail"], c["speed_kmh"]) for c in cases(out)] == [
        ("wet", pytest.approx(60)),
        ("wet", pytest.approx(100)),
        ("dry", pytest.approx(60)),
        ("dry", pytest.approx(100)),
    ]


def test_linearize_json(railslip):
    status, out, _ = railslip("linearize", "--rail", "dry", "--json")
    assert status == 0
    (case,) = cases(out)
    assert case["states"] == ["sigma", "z"]
    assert case["outputs"] == ["sigma", "lambda", "error"]
    assert case["brake_torque_nm"] == pytest.approx(4787.78, abs=0.0051)
    assert case["adhesion_force_n"] / 34500 == pytest.approx(0.29850, abs=5.1e-6)
    eigenvalues = np.linalg.eigvals(np.array(case["A"]))
    assert sorted(p[0] for p in case["poles"]) == pytest.approx(sorted(eigenvalues.real), rel=1e-12)
    status, out, _ = railslip("linearize", "--rail", "dry", "--speed-state", "--json")
    assert cases(out)[0]["states"] == ["v", "sigma", "z"]


def test_readable_output_names_units_and_verdict(railslip):
    status, out, _ = railslip("margins", "--rail", "dry", "--kp", "190", "--ki", "5")
    assert status == 0
    assert "\x1b" not in out
    for text in ("Gain increase", "Delay margin", "rad/s", "deg", "Verdict: stable but fragile (Ms 5.58)", "exact"):
        assert text in out
    assert max(len(line) for line in out.splitlines()) <= 110
    status, out, _ = railslip("margins", "--rail", "dry")
    assert status == 1
    assert "Verdict: unstable: 2 closed-loop poles in" in out
    status, out, _ = railslip("linearize")
    assert "Brake torque" in out
    assert "4787.775 N·m" in out


def test_values_may_carry_their_unit(railslip):
    plain = railslip("margins", "--rail", "dry", "--kp", "234", "--ki", "5", "--mass", "3500", "--json")
    with_unit = railslip(
        "margins",
        "--rail",
        "dry",
        "--kp",
        "65 N*m/(km/h)",
        "--ki",
        "5 N",
        "--mass",
        "3.5 t",
        "--speed",
        "100 km/h",
        "--json",
    )
    assert plain[0] == with_unit[0] == 0
    a, b = cases(plain[1])[0], cases(with_unit[1])[0]
    assert a["phase_margin_deg"] == pytest.approx(b["phase_margin_deg"], rel=1e-12)


def test_inertia_scale_multiplies_m_j_and_b_alone(railslip):
    _, out, _ = railslip("margins", "--rail", "dry", "--inertia-scale", "3.6", "--json")
    case = cases(out)[0]
    assert (case["inertia_scale"], case["mass_kg"]) == (3.6, 3517.0)
    assert case["phase_margin_deg"] == pytest.approx(6.376, abs=1e-3)


def test_dead_time_and_lag_zero_are_allowed(railslip):
    status, out, _ = railslip(
        "margins", "--rail", "dry", "--dead-time", 0, "--lag", 0, "--kp", 2000, "--ki", 90, "--json"
    )
    assert status == 0
    assert cases(out)[0]["gain_increase"] is None  # without bound
    assert all(row["stable"] for row in cases(out)[0]["pade"])


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--mass", "-3"), ("--mass", "-3", "> 0")),
        (("--mass", "0"), ("--mass", "> 0")),
        (("--slip", "1.2"), ("--slip", "1.2", "< 1")),
        (("--slip", "1"), ("--slip", "1", "< 1")),
        (("--slip", "-0.1"), ("--slip", "-0.1", ">= 0")),
        (("--slip", "0"), ("slip", "0", "rest")),
        (("--speed", "0"), ("--speed", "0", "> 0")),
        (("--speed", "-10"), ("--speed", "-10", "> 0")),
        (("--speed", "fast"), ("--speed", "fast", "km/h")),
        (("--speed", "inf"), ("--speed", "inf", "finite")),
        (("--kp", "nan", "--ki", "5"), ("--kp", "nan", "finite")),
        (("--kp", "65 N*m", "--ki", "5"), ("--kp", "65 N*m", "N*m/(m/s)")),
        (("--kp", "190"), ("--ki", "both")),
        (("--ki", "5"), ("--kp", "both")),
        (("--rail", "icy"), ("--rail", "icy", "dry or wet")),
        (("--adhesion", "magic"), ("adhesion", "magic", "bristle")),
        (("--adhesion", "lugre"), ("lugre", "--adhesion FILE.toml")),
        (("--adhesion", "missing.toml"), ("missing.toml",)),
        (("--initial-speed", "200"), ("--initial-speed", "200", "30 to 140")),
        (("--initial-speed", "140", "--speed", "140", "--slip", "0.9"), ("slip", "0.9", "0.827")),
        (("--adhesion", "beam", "--slip", repr(3 * 0.261 * 34500 / 274360), "--rail", "dry"), ("kink", "0.0984")),
        (("--inertia-scale", "0"), ("--inertia-scale", "0", "> 0")),
        (("--dead-time", "-1"), ("--dead-time", "-1", ">= 0")),
        (("--lag", "-1"), ("--lag", "-1", ">= 0")),
        (("--lead", "0.6", "--lead-filter", "0"), ("--lead-filter", "> 0")),
        (("--vehicle", "missing.toml"), ("missing.toml",)),
        (("--vehicle", "."), ("--vehicle", "not a file")),
        (("--nonsense",), ("--nonsense",)),
        (("surplus",), ("surplus",)),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else None,
)
def test_bad_input_is_one_clear_line_and_exit_2(railslip, arguments, told):
    status, out, err = railslip("margins", *arguments, "--json")
    assert (status, out) == (2, "")
    assert err.startswith("railslip: error: ")
    assert err.count("\n") == 1
    for text in told:
        assert text in err


@pytest.mark.parametrize(
    ("given", "told"),
    [("margin", "did you mean 'margins'?"), ("Reports", "did you mean 'report'?"), ("xyzzy", "choose one of report, ")],
)
def test_a_command_misspelt_is_told_the_nearest(railslip, given, told):
    status, out, err = railslip(given, "--json")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert err.startswith(f"railslip: error: {given!r} is no command; {told}")


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"", "empty"),
        (b"\x00\xff\xfe\x01", "UTF-8"),
        (b"mass = 3517\nmas = 1\n", "mas"),
        (b'mass = "65 N*m"\n', "mass"),
        (b'mass = 3517\n[actuator]\ndead_time = "150"\n', "actuator.dead_time: '150' is text without a unit"),
        (b"mass = -1\n", "mass"),
        (b"mass = nan\n", "mass"),
        (b"mass = [1]\n", "mass"),
        (b"mass = \nname = 'x'\n", "line 1"),
        (b"mass = 3517\n[wheel]\nradius = 0\n", "wheel.radius"),
    ],
)
def test_bad_vehicle_files_are_one_clear_line_and_exit_2(railslip, tmp_path, content, told):
    file = tmp_path / "train.toml"
    file.write_bytes(content)
    status, out, err = railslip("linearize", "--vehicle", file)
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert "train.toml" in err
    assert told in err


@pytest.mark.parametrize(
    ("arguments", "advised"),
    [
        (("--speed", "100 m/s"), False),  # above 140 km/h, to where the published parameters go
        (("--speed", "120"), True),
        (("--speed", "100 m/s", "--adhesion", "polach", "--slip", "0.05"), True),  # knows no v0
        (("--speed", "120", "--adhesion", "LAW"), False),  # its polynomials end at 110 km/h
        (("--speed", "105", "--adhesion", "LAW"), True),
    ],
)
def test_a_speed_above_v0_is_advised_only_what_is_taken(railslip, tmp_path, arguments, advised):
    law = tmp_path / "law.toml"
    law.write_text(
        'law = "dahl"\ninitial_speed_range = [30, 110]\n[parameters]\nalpha = 2.0e4\n[polynomials]\nFc = [1e4, -10]\n'
        "[reference_slip]\ndry = 0.12\nwet = 0.08\n"
    )
    words = ["linearize", "--rail", "dry", *(law if word == "LAW" else word for word in arguments)]
    status, _, err = railslip(*words)
    (told,) = (line for line in err.splitlines() if line.startswith("railslip: warning: --speed: "))
    assert status == 0
    assert ("--initial-speed" in told) is advised
    speed = "360" if "m/s" in arguments[1] else arguments[1]
    status, _, err = railslip(*words, "--initial-speed", speed)
    assert status == (0 if advised else 2)
    if advised:
        assert told.endswith(f"give another, or --initial-speed {speed}")
        assert "--speed: " not in err


@pytest.mark.parametrize(
    "law", [name for name in law_classes() if name not in ("dahl", "lugre", "tyre_lugre", "table")]
)
def test_slip_0_is_a_point_of_the_laws_that_the_help_names(railslip, law):
    """Of those with published parameters."""
    (named,) = re.findall(r"or 0 with a static law \((.+?)\)", " ".join(railslip("linearize", "--help")[1].split()))
    status = railslip("linearize", "--adhesion", law, "--slip", "0", "--rail", "dry")[0]
    assert status == (0 if law in named.split(", ") else 2)


def test_adhesion_law_from_a_file(railslip, tmp_path):
    file = tmp_path / "law.toml"
    file.write_text(
        'law = "dahl"\n[parameters]\nalpha = 2.0e4\nFc = "10.3 kN"\n[reference_slip]\ndry = 0.12\nwet = 0.08\n'
    )
    status, out, err = railslip("linearize", "--adhesion", file, "--json")
    assert (status, err) == (0, "")
    assert [c["slip"] for c in cases(out)] == [0.12, 0.08]
    assert [c["adhesion_force_n"] for c in cases(out)] == pytest.approx([10300.0, 5150.0])  # Coulomb; half when wet


def test_vehicle_from_toml_with_rolling_stock(railslip):
    status, out, err = railslip(
        "linearize", "--vehicle", "designs/vehicles/desiro_classic.toml", "--rail", "dry", "--json"
    )
    assert status == 0
    assert all(line.startswith("railslip: note: Siemens Desiro") for line in err.splitlines())
    assert cases(out)[0]["mass_kg"] == pytest.approx(68000 / 6)
    _, out, _ = railslip(
        "linearize", "--vehicle", "designs/vehicles/desiro_classic.toml", "--loaded", "--rail", "dry", "--json"
    )
    assert cases(out)[0]["mass_kg"] == pytest.approx(88000 / 6)


def test_what_was_assumed_of_a_railtoolkit_vehicle_is_said_by_every_command(railslip, tmp_path):
    yaml = "tests/data/rolling-stock/Facs124.yaml"
    for command in (("margins",), ("linearize",), ("report", "--no-html", "--out", tmp_path / "out")):
        _, out, err = railslip(*command, "--vehicle", yaml, "--rail", "dry")
        assert "4 axles are assumed" in err
        assert "Facs 124" in out
    _, out, _ = railslip("margins", "--vehicle", yaml, "--rail", "dry", "--json", "--initial-speed", "80")
    case = cases(out)[0]
    assert any("axles" in note for note in case["notes"])
    assert case["initial_speed_kmh"] == 80


@pytest.mark.parametrize(
    "arguments",
    [
        ("--dead-time", "1e-9"),
        ("--dead-time", "50"),
        ("--inertia-scale", "1000"),
        ("--lag", "1e6"),
        ("--mass", "1e-3"),
        ("--mass", "1e-6"),
        ("--inertia-scale", "1e-9"),
        ("--dead-time", "1e9"),
    ],
    ids=" ".join,
)
def test_extreme_numbers_give_a_verdict_or_one_line(railslip, arguments):
    status, out, err = railslip("margins", "--rail", "dry", "--kp", "190", "--ki", "5", *arguments, "--json")
    assert status in (0, 1) or (status == 2 and err.count("\n") == 1 and out == "")
    if status != 2:
        assert len(cases(out)) == 1


@pytest.mark.parametrize("out_dir", ["", "."])
def test_report_does_not_write_into_the_working_folder_itself(railslip, tmp_path, monkeypatch, out_dir):
    monkeypatch.chdir(tmp_path)
    status, out, err = railslip("report", "--no-html", "--rail", "dry", "--out", out_dir)
    assert (status, out) == (2, "")
    assert "--out" in err
    assert list(tmp_path.iterdir()) == []


def test_report_without_its_page_writes_all_else(report_of_the_readme):
    out_dir, status, out, err = report_of_the_readme
    assert status == 0
    content = json.loads((out_dir / "report.json").read_text())
    written = {p.name for p in out_dir.iterdir()}
    assert written == set(content["files"]) >= {"report.txt", "report.json", "recommended.toml", "map.png", "loop.svg"}
    assert (out_dir / "report.txt").read_text(encoding="utf-8") == out
    assert f"wrote {len(written)} files" in err
    assert "report.html" not in err  # it was told --no-html
    assert (out_dir / "loop.png").read_bytes().startswith(b"\x89PNG")


def test_report_json_is_one_object_and_nothing_else(railslip, tmp_path):
    where = ("--rail", "dry", "--speed", 100, "--loaded")
    status, out, _ = railslip("report", "--no-html", "--json", "--out", tmp_path / "new" / "folder", *where)
    assert status == 0
    assert json.loads(out)["envelope"]["loads"] == ["loaded"]
    assert (tmp_path / "new" / "folder" / "report.json").read_text(encoding="utf-8") == out


def test_report_that_cannot_be_written_leaves_the_old_one(railslip, tmp_path):
    (tmp_path / "report.txt").write_text("old")
    (tmp_path / "loop.png").mkdir()  # in the way of a picture
    status, out, err = railslip("report", "--rail", "dry", "--out", tmp_path)
    assert (status, out) == (2, "")
    assert "loop.png" in err
    assert (tmp_path / "report.txt").read_text() == "old"
    assert {p.name for p in tmp_path.iterdir()} == {"report.txt", "loop.png"}


def test_report_into_a_file_s_place_is_refused(railslip, tmp_path):
    file = tmp_path / "taken"
    file.write_text("mine")
    status, _, err = railslip("report", "--rail", "dry", "--out", file)
    assert status == 2
    assert "--out" in err
    assert file.read_text() == "mine"


def test_help_and_version(railslip):
    status, out, _ = railslip("--help")
    assert status == 0
    for name in ("report", "linearize", "margins"):
        assert name in out
        _, text, _ = railslip(name, "--help")
        assert "Example" in text
    assert "0.1.0" in railslip("--version")[1]
    assert railslip("nonsense")[0] == 2
    assert railslip()[0] == 2


def test_commands_that_evaluate_numbers_import_neither_sympy_nor_matplotlib_nor_control():
    code = (
        "import sys\n"
        "from railslip_ctrl.cli import main\n"
        "try:\n    main(['margins', '--rail', 'dry', '--json'])\n"
        "except SystemExit: pass\n"
        "found = [m for m in ('sympy', 'matplotlib', 'control', 'pint', 'scipy', 'yaml') if m in sys.modules]\n"
        "print(found, file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"


def test_output_survives_a_closed_pipe_and_a_plain_terminal():
    command = [sys.executable, "-m", "railslip_ctrl", "margins", "--rail", "dry", "--kp", "190", "--ki", "5"]
    done = subprocess.run(command, capture_output=True, env={**os.environ, "PYTHONIOENCODING": "ascii"}, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    piped = subprocess.run(["sh", "-c", f"{' '.join(command)} | head -1"], capture_output=True, check=True)
    assert piped.stderr == b""


def test_tune_json_has_the_contract_s_keys_and_the_issue_s_numbers(railslip):
    family = ["--speed", 20, "--speed", 60, "--speed", 100, "--mass", 3517, "--mass", 5276]
    status, out, err = railslip("tune", *family, "--structure", "pi-lead", "--minimise-ms", "--ki-min", 5, "--json")
    assert (status, err) == (0, "")
    found = json.loads(out)
    assert (found["feasible"], found["reason"]) == (True, "")
    assert found["ki_si"] == 5
    assert found["worst"]["ms"] == pytest.approx(1.4291, abs=5.1e-5)
    assert len(found["cases"]) == 12
    assert {c["mass_kg"] for c in found["cases"]} == {3517, 5276}
    assert [c["rail"] for c in found["cases"]] == ["dry"] * 6 + ["wet"] * 6
    assert max(c["ms"] for c in found["cases"]) == pytest.approx(found["worst"]["ms"], rel=1e-12)
    assert found["worst"]["case"]["rail"] == "dry"


def test_tune_maximises_ki_under_ms_max(railslip):
    status, out, _ = railslip("tune", "--rail", "dry", "--structure", "pi-lead", "--ms-max", "1.8", "--json")
    found = json.loads(out)
    assert status == 0
    assert found["ms_max_asked"] == 1.8
    assert found["worst"]["ms"] == pytest.approx(1.8, rel=1e-9)


def test_tune_infeasible_is_exit_1_with_the_reason_and_what_can_be_had(railslip):
    status, out, _ = railslip("tune", "--ms-max", "2", "--speed", "100", "--json")
    found = json.loads(out)
    assert (status, found["feasible"], found["kp_si"], found["worst"]) == (1, False, None, None)
    assert "Ms <= 2 is asked for" in found["reason"]
    status, out, _ = railslip("tune", "--ms-max", "2", "--speed", "100")
    assert status == 1
    assert "infeasible" in out


def test_tune_readable(railslip):
    status, out, _ = railslip("tune", "--ms-max", "7", "--phase-min", "8", "--speed", "100")
    assert status == 0
    for text in ("maximise ki, Ms <= 7, phase margin >= 8 deg", "N·m/(m/s)", "Verdict: worst Ms"):
        assert text in out


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ((), "--ms-max"),
        (("--ms-max", "1"), "> 1"),
        (("--ms-max", "2", "--ki-min", "5"), "--minimise-ms"),
        (("--minimise-ms",), "--ki-min"),
        (("--ms-max", "2", "--structure", "pdf"), "pi, pi-lead, pid"),
        (("--ms-max", "2", "--lead", "0.6"), "lead"),
        (("--ms-max", "nan"), "nan"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else None,
)
def test_tune_bad_input(railslip, arguments, told):
    status, out, err = railslip("tune", *arguments, "--json")
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert told in err
