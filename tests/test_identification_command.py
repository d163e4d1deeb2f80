"""`railslip identify`: the contract, the files it writes, what it says of fits and of bad logs."""

import json
import re
import tomllib

import numpy as np
import pytest
from project import refused
from rig_logs import BEAM, HEADER, changed, found_in, identified, rig_rows, two_runs, write_log
from scipy.integrate import cumulative_trapezoid

from railslip_ctrl import PARK2008, Rail, identify, load_law, published_law
from railslip_ctrl.core.units import KMH
from railslip_ctrl.identification import identify as job
from railslip_ctrl.identification.curves import Options, curve_of, read_curve
from railslip_ctrl.identification.fits import NORMAL_QUANTILE
from railslip_ctrl.identification.identify import IMPOSSIBLE_MU
from railslip_ctrl.identification.observed import time_history_of
from railslip_ctrl.identification.results import Regimes, peak_of_law
from railslip_ctrl.identification.virtual_rig import RigTest, run_tests
from railslip_ctrl.model.adhesion import initial_speeds_in
from railslip_ctrl.model.numeric import adhesion_coefficient
from railslip_ctrl.report.identification import identification_json, identification_text, model_toml

RADIUS, LOAD = PARK2008.wheel.radius, PARK2008.wheel_load
pytestmark = pytest.mark.usefixtures("without_lag_search")


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return write_log(tmp_path_factory.mktemp("logs") / "beam.csv", rig_rows(BEAM, seed=3))


def test_what_is_printed_is_what_is_written_and_the_truth_is_in_its_intervals(railslip, log, tmp_path):
    out, file = tmp_path / "out", tmp_path / "observed.csv"
    _, printed, err = railslip("identify", log, "--model", "beam", "--json", "--out", out, "--observed", file)
    found = json.loads(printed)
    data = found["log"]
    assert {"model", "parameters", "mean_abs_error", "points"} <= found.keys()
    assert (found["model"], found["parameters"].keys()) == ("beam", {"mu_max", "a", "Kx"})
    for name, parameter in found["parameters"].items():
        low, high = parameter["interval_99"]
        assert low < getattr(BEAM, name) < high
        assert abs(parameter["value"] - getattr(BEAM, name)) < 2.576 * parameter["stderr"]
    assert 0.0 < found["mean_abs_error"] < 0.005  # the noise of bins, far below the 0.0085 to 0.0132 of Table 3
    assert found["points"] == data["adhesion_regime_points"] + data["sliding_regime_points"]
    assert np.diag(found["correlation"]) == pytest.approx(np.ones(3))
    # the files
    assert re.fullmatch(r"railslip: wrote 9 files.*\n", err)
    pictures = {f"{name}.{suffix}" for name in ("adhesion", "peak", "braking") for suffix in ("png", "svg")}
    texts = {"model.toml", "identification.txt", "identification.json"}
    assert {path.name for path in out.iterdir()} == texts | pictures
    assert found == json.loads((out / "identification.json").read_text())
    law = load_law(out / "model.toml")
    assert law.mu_max == found["parameters"]["mu_max"]["value"]
    assert law.reference.dry == found["reference_slip"]["dry"]
    for command in (["margins", "--kp", "190", "--ki", "5"], ["linearize"]):
        status, text, err = railslip(*command, "--adhesion", out / "model.toml", "--json")
        assert status in (0, 1), err
        assert json.loads(text)["cases"][0]["slip"] == pytest.approx(law.reference.dry)
    # the observed adhesion row by row: from its lines the bins of the curve come out, which are summed on another way
    header = "time [s],filtered train speed [km/h],filtered slip [1],filtered wheel load [N],adhesion torque [N*m]"
    assert file.read_text().startswith(f"{header},mu [1],regime\n")
    _, _, slip, load, torque, mu = np.loadtxt(file, delimiter=",", skiprows=1, usecols=range(6)).T
    assert slip.size == found["points"] == sum(bin_["count"] for bin_ in found["curve"])
    regime = np.array([line.rpartition(",")[2] for line in file.read_text().splitlines()[1:]])
    assert np.array_equal(regime == "adhesion", slip < data["sliding_from_slip"])
    assert np.sum(regime == "sliding") == data["sliding_regime_points"]
    assert mu == pytest.approx(torque / (RADIUS * load), rel=1e-8)  # ten digits
    for each in found["curve"]:
        inside = (slip >= each["slip_from"]) & (slip < each["slip_to"])
        assert (inside.sum(), mu[inside].max()) == (each["count"], pytest.approx(each["max"], rel=1e-8))
        assert each["min"] <= each["mean"] <= each["max"]
        assert each["regime"] == ("adhesion" if each["slip"] < data["sliding_from_slip"] else "sliding")


def test_nothing_is_written_by_halves_nor_over_a_log(railslip, log, tmp_path):
    none, before = tmp_path / "none.csv", log.read_bytes()
    broken, copy = tmp_path / "broken.csv", tmp_path / "copy.csv"
    broken.write_text(log.read_text()[:600])
    copy.write_bytes(before)
    for arguments, told in (
        ((broken, "--model", "beam", "--observed", none), "rows are under brake"),
        ((log, log, "--observed", none), "--observed is only for one log, but there are 2"),
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
    found = identify(log, PARK2008, Options(model="beam"))
    run = time_history_of(found.curve.record, PARK2008, found.curve.time_constant)
    seen, wheel = np.isfinite(run.adhesion_torque), PARK2008.wheel
    omega = run.wheel_speed[seen] / RADIUS
    turning = (run.adhesion_torque[seen] - run.brake_torque[seen] - wheel.viscous_friction * omega) / wheel.inertia
    # the filter is 0.05 s late, in which omega goes up to 3 rad/s
    assert cumulative_trapezoid(turning, run.time[seen], initial=0.0) == pytest.approx(omega - omega[0], abs=3.0)
    assert np.ptp(omega) > 25.0


@pytest.mark.long
def test_several_logs_give_polynomials_of_v0(railslip, tmp_path):
    speeds = (60.0, 100.0, 140.0)
    logs = [tmp_path / f"v{v0:.0f}.csv" for v0 in speeds]
    for path, v0 in zip(logs, speeds, strict=True):
        given = {"runs": 3, "initial_speed": v0 / 3.6, "force_noise": 50.0}
        write_log(path, rig_rows(published_law("beam", Rail.DRY, v0), **given))
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
    for v0, each in zip(speeds, found["logs"], strict=True):  # the slip to hold: of each at its speed, not the lowest
        held = load_law(tmp_path / "fitted" / "model.toml", initial_speed_kmh=v0).reference
        assert held.dry == pytest.approx(each["reference_slip"]["dry"], rel=1e-6)  # v0 to a tenth of a km/h
    status, out, _ = railslip("identify", *logs[:2])
    assert (status, "Parameters over the initial speed v0" in out) == (0, True)


def test_what_is_told_of_given_values_names_options_and_not_arguments(railslip, log, tmp_path, monkeypatch):
    monkeypatch.setattr("railslip_ctrl.cli.identify._BAR_FROM_BYTES", 1000)
    odd = ("--initial-speed", "60", "--fix", "Kx=274.36 kN", "--bound", "a=0:0.003")
    status, out, err = railslip("identify", log, "--model", "beam", *odd, "--json", "--out", tmp_path / "out")
    assert (status, "reading" in err) == (0, True)
    files = (file.read_text() for file in (tmp_path / "out").iterdir() if file.suffix not in (".png", ".svg"))
    texts = [" ".join(text.split()) for text in (out, err, *files)]
    assert len(texts) == 5
    for text in texts:
        assert "--initial-speed is 60 km/h" in text
        assert "--bound gives this bound" in text
        assert "`" not in text
    found = json.loads(out)
    assert found["known"] == {"Kx": 274360.0}
    assert (found["parameters"]["a"]["status"], found["parameters"]["a"]["stderr"]) == ("at upper bound", None)
    assert any("rests on its upper bound" in note for note in found["notes"])


def test_broken_logs_are_survived_and_told(railslip, log, tmp_path):
    lines = log.read_text().replace(HEADER, "a,b,c,d").splitlines(keepends=True)
    lines[400] = "\x00\xff\n"
    lines[700] = lines[700].replace(lines[700].split(",")[2], "500")
    del lines[2000:2100]
    path = tmp_path / "broken.csv"
    path.write_text("".join(lines)[:-5], encoding="latin-1")
    names = zip(("time", "train_speed", "wheel_angular_speed", "brake_torque"), "abcd", strict=True)
    options = [*(f"--column={name}={cell}" for name, cell in names), "--unit=train_speed=km/h"]
    arguments = ("identify", path, "--model", "beam", *options, "--unit=brake_torque=kNm", "--json")
    status, out, err = railslip(*arguments)
    assert (status, json.loads(out)["log"]["broken_lines"]) == (0, 2)
    for told in (
        "line 401: a control character",
        f"line {len(lines)}: the file ends within this line",
        "1 row with outliers: left out, the first in line 701",
        "s before line 2001",
        "column 'a' has no unit: time is read in s",
    ):
        assert told in err
    assert all(line.startswith(("railslip: warning: ", "railslip: note: ")) for line in err.splitlines())
    low, high = json.loads(out)["parameters"]["mu_max"]["interval_99"]
    assert low < BEAM.mu_max < high
    assert refused(railslip("identify", tmp_path / "nothing.csv")).endswith("no such file; give a CSV file\n")
    path.write_text(HEADER + "\n" + "".join(f"{0.1 * i},100,64.6,0\n" for i in range(200)))
    assert "0 of 200 rows are under brake" in refused(railslip("identify", path))
    assert not list(tmp_path.glob("railslip*"))


def test_a_fit_above_what_steel_has_is_refused_and_leaves_nothing(railslip, log, tmp_path):
    """A wheel load of 2 kN where it is 34.5: the published 0.261 becomes 4.5."""
    lines, path = log.read_text().splitlines(), tmp_path / "log.csv"
    path.write_text("\n".join([lines[0] + ",wheel load [kN]", *(f"{x},2" for x in lines[1:])]) + "\n")
    files = ("--out", tmp_path / "fitted", "--observed", tmp_path / "observed.csv")
    line = refused(railslip("identify", path, "--model", "beam", *files))
    assert float(line.split(", above ")[0].split()[-1]) == pytest.approx(0.261 * 34.5 / 2, rel=0.03)
    assert all(part in line for part in (f"above {IMPOSSIBLE_MU:g},", "check the unit of the brake torque"))
    assert {each.name for each in tmp_path.iterdir()} == {"log.csv"}


@pytest.mark.parametrize(("header", "scale", "unit"), [("N*m", 1.0, "kN*m"), ("kN*m", 1e3, "N*m")])
def test_a_torque_a_thousand_times_off_is_told_with_its_remedy(railslip, tmp_path, header, scale, unit):
    rows = two_runs()
    path = write_log(tmp_path / "log.csv", changed(rows, brake_torque=scale * rows.columns["brake_torque"]))
    path.write_text(path.read_text().replace("brake torque [kN*m]", f"brake torque [{header}]"))
    line = refused(railslip("identify", path, "--model", "table"))
    assert f"brake_torque seems to be in {unit} (--unit brake_torque={unit})" in line
    mended = read_curve(path, PARK2008, Options(units={"brake_torque": unit}))
    assert mended.bins.mean == pytest.approx(curve_of(rows, PARK2008, Options()).bins.mean, rel=1e-6)


def test_warnings_and_doubts_are_in_the_report_the_file_and_json():
    rows = two_runs()
    odd = changed(rows, wheel_speed=1.16 * RADIUS * rows.columns["wheel_angular_speed"])
    found = identified(changed(odd, wheel_load=np.full(len(rows), 0.36 * LOAD)), initial_speed=60.0)
    told = (
        f"wheel load of the log is {0.36 * LOAD:.4g} N, but the wheel load of the vehicle is {LOAD:.4g} N",
        "wheel speed is 1.16 times",
        "`initial_speed` is 216 km/h, but the highest train speed of the log is 100 km/h",
        "of the fitted beam is 0.7",
    )
    text, file = " ".join(identification_text(found).split()), model_toml(found)
    assert all(heading in text for heading in ("Std. error", "Correlation", "BIC"))
    for sentence in told:
        assert sum(sentence in each for each in (*found.warnings, *found.fit_warnings)) == 1
        assert sentence in text
        assert any(line.startswith("# Warning: ") and sentence in line for line in file.splitlines())
        assert any(sentence in each for each in identification_json(found)["log"]["warnings"])
    assert f"(in the log; the vehicle has {LOAD:g} N)" in text


def test_what_is_not_from_the_log_is_marked(file):
    dry = found_in("beam")
    found = identification_json(dry)
    own, other = found["peaks"][4], found["peaks"][0]
    assert (own["from"], own["slip_stderr"] > 0) == ("log", True)
    assert (own["extrapolated"], other["extrapolated"]) == (False, True)
    wet = [each for each in found["peaks"] if each["rail"] == "wet"]
    assert {(each["from"], each["slip_stderr"], each["mu_stderr"]) for each in wet} == {("rule", None, None)}
    assert all(each["reference_slip"] is not None for each in wet)
    assert set(dry.peak_notes) <= set(found["notes"])
    assert f"# {dry.peak_notes[1]}" in model_toml(dry)
    # a log of wet rail has its own wet peak, and no slip for dry rail
    wet = found_in("burckhardt", rail=Rail.WET)
    assert not any(peak.by_rule for peak in wet.peaks)
    assert (wet.peaks[-1].slip_stderr > 0.0, len(wet.peak_notes)) == (True, 1)  # the other speeds alone
    path = file("model.toml", model_toml(wet))
    assert tomllib.loads(model_toml(wet))["reference_slip"] == {"wet": wet.reference.wet}
    assert load_law(path).reference_slip(Rail.WET) == wet.reference.wet


def test_the_peak_of_a_table_needs_no_formula():
    """The truth, in the closed form of the published beam, is in the intervals; they are a table's, not a formula's."""
    found, formula = found_in("table").own_peak, found_in("beam").own_peak
    slips = np.linspace(0.01, 0.6, 6000)
    mu = adhesion_coefficient(BEAM, 100.0 * KMH, slips, LOAD)
    for peak in (found, formula):
        assert peak.slip_interval[0] < slips[np.argmax(mu)] < peak.slip_interval[1]
        assert peak.coefficient_interval[0] < mu.max() < peak.coefficient_interval[1]


def test_a_log_that_stays_below_the_peak_has_no_slip_to_hold(railslip, tmp_path):
    """The peak of a formula beyond all data is the formula's alone: up to 1.7 times the true one, and once slip 1."""
    rows = two_runs()
    slip = 1.0 - RADIUS * rows.columns["wheel_angular_speed"] / rows.columns["train_speed"]
    kept = np.logical_and.accumulate((slip < 0.03).reshape(2, -1), axis=1).ravel()
    path = write_log(tmp_path / "below.csv", rows.where(kept))
    status, out, _ = railslip("identify", path, "--model", "beam", "--out", tmp_path / "fitted")
    assert (status, "largest slip of this log, 0.0" in out) == (0, True)
    told = re.search(r"mu_max: at least (0\.\d+) by this log \(99 %\)", out)
    assert 0.5 * BEAM.mu_max < float(told[1]) < BEAM.mu_max  # the rise alone leaves it free upwards
    assert "[reference_slip]" not in (tmp_path / "fitted" / "model.toml").read_text()
    found = json.loads((tmp_path / "fitted" / "identification.json").read_text())
    assert {found["reference_slip"], *(p["reference_slip"] for p in found["peaks"] if p["rail"] == "dry")} == {None}
    own = found["peaks"][4]  # on dry rail at v0: the peak lies beyond, so that no interval of it has an upper end
    assert (own["slip_interval_95"][1], own["mu_interval_95"][1]) == (None, None)
    assert all(peak["slip"] is not None for peak in found["peaks"])  # where the formula has it is told
    parted, data = ("the highest mean mu of the log", found["log"]["data_peak_slip"]), found["log"]
    assert (data["sliding_from"], data["sliding_from_slip"]) == parted


def test_regimes_part_at_the_peak_of_the_model_and_not_where_noise_is_highest():
    """Two tests of a rig: the data's own highest mu may be far off on the beam's flat top, the fit's is not."""
    speed, law = 30.0, published_law("beam", Rail.DRY, 30.0)
    found = identified(run_tests(RigTest(PARK2008, law, speed * KMH), tests=2, seed=5))
    true, own = peak_of_law(law, speed * KMH, LOAD).slip, found.own_peak
    assert found.regimes == Regimes(own.slip, "the peak of beam")
    assert own.slip == pytest.approx(true, abs=NORMAL_QUANTILE * own.slip_stderr)
    assert sum(found.curve.split_counts(own.slip)) == found.curve.survey.used


def test_the_chosen_model_has_the_intervals_that_it_has_alone(monkeypatch):
    alone = {name: found_in(name) for name in ("burckhardt", "beam")}
    monkeypatch.setattr(job.models, "CANDIDATES", tuple(alone))
    both = found_in("best")
    assert {score.fit.model.name for score in both.scores} == {*alone}
    for name in alone:  # the better one, and the other where several logs ask for it
        found = job._with_model(both, name)
        assert (found.chosen.fit.parameters, found.regimes) == (alone[name].chosen.fit.parameters, alone[name].regimes)
        assert sum(each is found.chosen for each in found.scores) == 1
    assert [each.fit.with_profiles for each in both.scores] == [each is both.chosen for each in both.scores]
    for each in both.scores:
        assert each.fit.values.tolist() == alone[each.fit.model.name].chosen.fit.values.tolist()


@pytest.mark.parametrize("factor", [0.5, 0.7376, 1.0, 2.0])  # half the wheels; lb*ft for N*m; right; twice
def test_a_torque_of_the_wrong_scale_shows_in_the_train_s_deceleration(factor):
    log = run_tests(RigTest(PARK2008, BEAM, 100 * KMH), tests=2, seed=4)
    curve = curve_of(changed(log, brake_torque=factor * log.columns["brake_torque"]), PARK2008, Options())
    # by hand, of the first run: M times the speed lost, against force of torque and wheel by momentum, and resistance
    run = curve.record.run == curve.record.run[0]
    t, v, omega, torque = (getattr(curve.record, name)[run] for name in ("time", "speed", "omega", "torque"))
    wheel = np.trapezoid(torque + 0.25 * omega, t) + 60.35 * (omega[-1] - omega[0])
    own = 3517.0 * (v[0] - v[-1]) / (wheel / RADIUS + np.trapezoid(0.63 * v**2, t))
    assert curve.deceleration_ratio == pytest.approx(own, rel=0.01)  # of two runs, whose noise differs
    ratio = f" {curve.deceleration_ratio:.3g} times "
    assert [ratio in text for text in curve.warnings if "train's deceleration" in text] == [True] * (factor != 1.0)
    assert factor != 1.0 or curve.deceleration_ratio == pytest.approx(1.0, abs=2e-3)
