"""`railslip identify`: the contract, the files it writes, and what it says of bad logs."""

import contextlib
import io
import json
import re

import numpy as np
import pytest
from project import refused
from rig_logs import HEADER, rig_rows, write_log

from railslip_ctrl import PARK2008, Rail, identify
from railslip_ctrl.cli import main
from railslip_ctrl.identification.curves import Options
from railslip_ctrl.identification.observed import time_history_of
from railslip_ctrl.model.adhesion import initial_speeds_in, load_law, published_law

BEAM = published_law("beam", Rail.DRY)

pytestmark = pytest.mark.usefixtures("without_lag_search")


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A log of six runs on a rig with the published beam."""
    return write_log(tmp_path_factory.mktemp("logs") / "beam.csv", rig_rows(BEAM, seed=3))


@pytest.fixture(scope="module")
def fitted(log, tmp_path_factory):
    """`identify` run once with all that it writes: the folder, what was found as JSON, and standard error."""
    folder, err = tmp_path_factory.mktemp("fitted"), io.StringIO()
    files = ["--out", str(folder / "out"), "--observed", str(folder / "observed.csv")]
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(err), pytest.raises(SystemExit):
        main(["identify", str(log), "--model", "beam", "--json", *files])
    return folder, json.loads(out.getvalue()), err.getvalue()


@pytest.fixture
def found_in(railslip):
    """`identify --model beam --json` of a log that is taken: what was found, and standard error."""

    def run(path, *more):
        status, out, err = railslip("identify", path, "--model", "beam", *more, "--json")
        assert status == 0, err
        return json.loads(out), err

    return run


def test_json_has_the_contract_s_keys_and_the_truth_in_its_intervals(fitted):
    _, found, _ = fitted
    log = found["log"]
    assert {"model", "parameters", "mean_abs_error", "points"} <= found.keys()
    assert (found["model"], found["parameters"].keys()) == ("beam", {"mu_max", "a", "Kx"})
    for name, parameter in found["parameters"].items():
        low, high = parameter["interval_99"]
        assert low < getattr(BEAM, name) < high
        assert abs(parameter["value"] - getattr(BEAM, name)) < 2.576 * parameter["stderr"]
    assert 0.0 < found["mean_abs_error"] < 0.005  # the noise of bins, far below the 0.0085 to 0.0132 of Table 3
    assert found["points"] == sum(bin_["count"] for bin_ in found["curve"])
    assert found["points"] == log["adhesion_regime_points"] + log["sliding_regime_points"]
    assert np.diag(found["correlation"]) == pytest.approx(np.ones(3))
    for bin_ in found["curve"]:
        assert bin_["min"] <= bin_["mean"] <= bin_["max"]
        assert bin_["regime"] == ("adhesion" if bin_["slip"] < log["sliding_from_slip"] else "sliding")


def test_every_command_takes_the_model_that_was_fitted(railslip, fitted):
    out = fitted[0] / "out"
    assert re.fullmatch(r"railslip: wrote 9 files.*\n", fitted[2])
    pictures = {f"{name}.{suffix}" for name in ("adhesion", "peak", "braking") for suffix in ("png", "svg")}
    texts = {"model.toml", "identification.txt", "identification.json"}
    assert {path.name for path in out.iterdir()} == texts | pictures
    found = json.loads((out / "identification.json").read_text())
    assert found == fitted[1]
    law = load_law(out / "model.toml")
    assert law.mu_max == found["parameters"]["mu_max"]["value"]
    assert law.reference.dry == found["reference_slip"]["dry"]
    for command in (["margins", "--kp", "190", "--ki", "5"], ["linearize"]):
        status, text, err = railslip(*command, "--adhesion", out / "model.toml", "--json")
        assert status in (0, 1), err
        assert json.loads(text)["cases"][0]["slip"] == pytest.approx(law.reference.dry)


def test_the_observed_adhesion_is_written_row_by_row(fitted):
    """From its lines the bins of the curve come out, which are summed on another way."""
    file, found = fitted[0] / "observed.csv", fitted[1]
    header = "time [s],filtered train speed [km/h],filtered slip [1],filtered wheel load [N],adhesion torque [N*m]"
    assert file.read_text().startswith(f"{header},mu [1],regime\n")
    _, _, slip, load, torque, mu = np.loadtxt(file, delimiter=",", skiprows=1, usecols=range(6)).T
    assert slip.size == found["points"]
    regime = np.array([line.rpartition(",")[2] for line in file.read_text().splitlines()[1:]])
    assert np.array_equal(regime == "adhesion", slip < found["log"]["sliding_from_slip"])
    assert np.sum(regime == "sliding") == found["log"]["sliding_regime_points"]
    assert mu == pytest.approx(torque / (PARK2008.wheel.radius * load), rel=1e-8)  # ten digits
    for each in found["curve"]:
        inside = (slip >= each["slip_from"]) & (slip < each["slip_to"])
        assert (inside.sum(), mu[inside].max()) == (each["count"], pytest.approx(each["max"], rel=1e-8))


def test_nothing_is_written_by_halves_nor_over_a_log(railslip, log, tmp_path):
    none, before = tmp_path / "none.csv", log.read_bytes()
    broken, copy = tmp_path / "broken.csv", tmp_path / "copy.csv"
    broken.write_text(log.read_text()[:600])
    copy.write_bytes(before)
    for arguments, told in (
        ((broken, "--model", "beam", "--observed", none), "rows are under brake"),
        ((log, log, "--observed", none), "--observed: is for one log, but there are 2"),
        ((log, log), "is given twice"),
        ((log, copy), "copy.csv is a copy of "),
        (("-", "-"), "standard input can be read once"),
        ((log, "--observed", log), "is the log itself"),
        ((log, copy, "--initial-speed", "100"), "--initial-speed"),
        ((log, "--out", tmp_path / "o", "--observed", tmp_path / "o"), "--observed: "),
        ((log, "--out", tmp_path / "o", "--observed", tmp_path / "o/model.toml"), "--observed: "),
    ):
        assert told in refused(railslip("identify", *arguments))
    assert log.read_bytes() == before
    assert {path.name for path in tmp_path.iterdir()} == {"broken.csv", "copy.csv"}


def test_the_time_history_of_a_braking_shows_the_torque_that_the_adhesion_had(log):
    """The wheel turns as brake and adhesion torque ask: omega comes out of the observed torque again."""
    found = identify(log, PARK2008, Options(model="beam"))
    run = time_history_of(found.curve.record, PARK2008, found.curve.time_constant)
    J, B = PARK2008.effective_inertia, PARK2008.effective_viscous_friction
    omega = run.wheel_speed / PARK2008.wheel.radius
    seen = np.isfinite(run.adhesion_torque)
    turning = (run.adhesion_torque - run.brake_torque - B * omega) / J
    time, change = run.time[seen], np.zeros(seen.sum())
    change[1:] = np.cumsum(np.diff(time) * (turning[seen][1:] + turning[seen][:-1]) / 2)
    # the filter is 0.05 s late, in which omega goes up to 3 rad/s
    assert change == pytest.approx(omega[seen] - omega[seen][0], abs=3.0)
    assert np.ptp(omega[seen]) > 25.0


@pytest.mark.long
def test_several_logs_give_polynomials_of_v0(railslip, tmp_path):
    speeds = (60.0, 100.0, 140.0)
    logs = [tmp_path / f"v{v0:.0f}.csv" for v0 in speeds]
    for path, v0 in zip(logs, speeds, strict=True):
        law = published_law("beam", Rail.DRY, v0)
        write_log(path, rig_rows(law, runs=3, initial_speed=v0 / 3.6, force_noise=50.0))
    status, out, err = railslip("identify", *logs, "--model", "beam", "--out", tmp_path / "fitted", "--json")
    assert status == 0, err
    found = json.loads(out)
    mu_max = found["parameters"]["mu_max"]
    assert mu_max["initial_speeds_kmh"] == pytest.approx(speeds, rel=1e-6)
    assert np.polynomial.polynomial.polyval(100.0, mu_max["coefficients"]) == pytest.approx(0.261, abs=0.003)
    assert len(mu_max["coefficients"]) == 3
    assert load_law(tmp_path / "fitted" / "model-3.toml").mu_max == pytest.approx(0.226, abs=0.003)
    assert initial_speeds_in(tmp_path / "fitted" / "model-3.toml") == (140.0, 140.0)
    assert (tmp_path / "fitted" / "coefficients.png").exists()
    # the slip to hold is that of each log at its speed, not the lowest of all
    for v0, each in zip(speeds, found["logs"], strict=True):
        held = load_law(tmp_path / "fitted" / "model.toml", initial_speed_kmh=v0).reference
        assert held.dry == pytest.approx(each["reference_slip"]["dry"], rel=1e-6)  # v0 to a tenth of a km/h
    status, out, _ = railslip("identify", *logs[:2])
    assert (status, "Parameters over the initial speed v0" in out) == (0, True)


def test_columns_and_units_by_option(found_in, log, fitted, tmp_path):
    other = tmp_path / "other.csv"
    other.write_text(log.read_text().replace(HEADER, "a,b,c,d"))
    quantities = zip(("time", "train_speed", "wheel_angular_speed", "brake_torque"), "abcd", strict=True)
    columns = [f"--column={name}={cell}" for name, cell in quantities]
    found, err = found_in(other, *columns, "--unit=train_speed=km/h", "--unit=brake_torque=kNm")
    assert found["parameters"] == fitted[1]["parameters"]
    assert "column 'a' names no unit: s is taken for time" in err


def test_a_bar_is_shown_for_a_large_log(found_in, log, monkeypatch):
    monkeypatch.setattr("railslip_ctrl.cli.identify._BAR_FROM_BYTES", 1000)
    assert "reading" in found_in(log)[1]


def test_what_is_told_names_options_and_not_arguments(log, tmp_path, railslip):
    """In all that it prints and writes: the package's own texts name the arguments of Python."""
    odd = ("--initial-speed", "60", "--bound", "a=0:0.003")
    status, out, err = railslip("identify", log, "--model", "beam", *odd, "--json", "--out", tmp_path / "out")
    assert status == 0
    files = (file.read_text() for file in (tmp_path / "out").iterdir() if file.suffix not in (".png", ".svg"))
    texts = [" ".join(text.split()) for text in (out, err, *files)]
    assert len(texts) == 5
    for text in texts:
        assert "--initial-speed is 60 km/h, and the highest" in text
        assert "is given by --bound: the log asks" in text
        assert "`" not in text


def test_fixed_and_bounded_parameters(found_in, log):
    found, _ = found_in(log, "--fix", "Kx=274.36 kN", "--bound", "a=0:0.003")
    assert found["known"] == {"Kx": 274360.0}
    assert (found["parameters"]["a"]["status"], found["parameters"]["a"]["stderr"]) == ("at upper bound", None)
    assert any("rests on its upper bound" in note for note in found["notes"])


def test_broken_logs_are_survived_and_told(railslip, found_in, log, tmp_path):
    lines = log.read_text().splitlines(keepends=True)
    lines[400] = "\x00\xff\n"
    lines[700] = lines[700].replace(lines[700].split(",")[2], "500")
    del lines[2000:2100]
    path = tmp_path / "broken.csv"
    path.write_text("".join(lines)[:-5], encoding="latin-1")
    found, err = found_in(path)
    assert found["log"]["broken_lines"] == 2
    for told in (
        "line 401: a control character",
        f"line {len(lines)}: the file ends within this line",
        "1 row with outliers left out, the first in line 701",
        "before line 2001: the observer starts anew",
    ):
        assert told in err
    assert all(line.startswith("railslip: warning: ") for line in err.splitlines())
    low, high = found["parameters"]["mu_max"]["interval_99"]
    assert low < BEAM.mu_max < high
    assert refused(railslip("identify", tmp_path / "nothing.csv")).endswith("no such file; give a CSV file\n")
    path.write_text(HEADER + "\n" + "".join(f"{0.1 * i},100,64.6,0\n" for i in range(200)))
    assert "0 of 200 rows are under brake" in refused(railslip("identify", path))
    assert not list(tmp_path.glob("railslip*"))
