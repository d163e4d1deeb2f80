"""What is said of a fit: what cannot be is refused, what is by rule or extrapolated is marked, the unseen is told."""

import json
import re
import tomllib

import numpy as np
import pytest
from project import refused
from rig_logs import BEAM, changed, found_in, identified, two_runs, write_log

from railslip_ctrl import PARK2008, Rail, load_law, published_law
from railslip_ctrl.core.units import KMH
from railslip_ctrl.identification import identify as job
from railslip_ctrl.identification.curves import Options, curve_of, read_curve
from railslip_ctrl.identification.fits import NORMAL_QUANTILE
from railslip_ctrl.identification.identify import IMPOSSIBLE_MU
from railslip_ctrl.identification.log_checks import train_lag
from railslip_ctrl.identification.logs import Rows
from railslip_ctrl.identification.observed import AdhesionStream
from railslip_ctrl.identification.results import Regimes, peak_of_law
from railslip_ctrl.identification.virtual_rig import RigTest, run_tests
from railslip_ctrl.model.numeric import adhesion_coefficient
from railslip_ctrl.report.identification import identification_json, identification_text, model_toml

RADIUS, LOAD = PARK2008.wheel.radius, PARK2008.wheel_load
pytestmark = pytest.mark.usefixtures("without_lag_search")


@pytest.fixture
def rows() -> Rows:
    return two_runs()


@pytest.fixture
def log(tmp_path, rows):
    return write_log(tmp_path / "log.csv", rows)


def test_a_fit_above_what_steel_has_is_refused_and_leaves_nothing(railslip, log, tmp_path):
    """A wheel load of 2 kN where it is 34.5: the published 0.261 becomes 4.5."""
    lines = log.read_text().splitlines()
    log.write_text("\n".join([lines[0] + ",wheel load [kN]", *(f"{x},2" for x in lines[1:])]) + "\n")
    out, observed = tmp_path / "fitted", tmp_path / "observed.csv"
    line = refused(railslip("identify", log, "--model", "beam", "--out", out, "--observed", observed))
    assert float(line.split("(mu_max), is ")[1].split(",")[0]) == pytest.approx(0.261 * 34.5 / 2, rel=0.03)
    assert f"above {IMPOSSIBLE_MU:g}, which no steel on steel in air has; check the unit of the brake torque" in line
    assert {each.name for each in tmp_path.iterdir()} == {"log.csv"}


@pytest.mark.parametrize(("header", "scale", "unit"), [("N*m", 1.0, "kN*m"), ("kN*m", 1e3, "N*m")])
def test_a_torque_a_thousand_times_off_is_told_with_its_remedy(railslip, rows, tmp_path, header, scale, unit):
    path = write_log(tmp_path / "log.csv", changed(rows, brake_torque=scale * rows.columns["brake_torque"]))
    path.write_text(path.read_text().replace("brake torque [kN*m]", f"brake torque [{header}]"))
    line = refused(railslip("identify", path, "--model", "table"))
    assert f"brake_torque seems to be in {unit} (--unit brake_torque={unit}), which would make it 0." in line
    mended = read_curve(path, PARK2008, Options(units={"brake_torque": unit}))
    assert mended.bins.mean == pytest.approx(curve_of(rows, PARK2008, Options()).bins.mean, rel=1e-6)


def test_warnings_and_doubts_are_in_the_report_the_file_and_json(rows):
    odd = changed(rows, wheel_speed=1.16 * RADIUS * rows.columns["wheel_angular_speed"])
    found = identified(changed(odd, wheel_load=np.full(len(rows), 0.36 * LOAD)), initial_speed=60.0)
    told = (
        f"wheel load of the log is {0.36 * LOAD:.4g} N on average, that of the vehicle {LOAD:.4g} N",
        "wheel speed is 1.16 times the angular speed",
        "`initial_speed` is 216 km/h, and the highest train speed of the log 100 km/h",
        "the fitted beam has a highest adhesion coefficient, its limit of friction (mu_max), of 0.72",
    )
    text, file = " ".join(identification_text(found).split()), model_toml(found)
    assert all(heading in text for heading in ("Std. error", "Correlation", "BIC"))
    for sentence in told:
        assert sum(sentence in each for each in (*found.warnings, *found.doubts)) == 1
        assert sentence in text
        assert any(line.startswith("# Warning: ") and sentence in line for line in file.splitlines())
        assert any(sentence in each for each in identification_json(found)["log"]["warnings"])
    assert f"(the log's; the vehicle's is {LOAD:g} N)" in text


def test_what_is_not_from_the_log_is_marked():
    dry = found_in("beam")
    found = identification_json(dry)
    own, other = found["peaks"][4], found["peaks"][0]
    assert (own["from"], own["extrapolated"], other["extrapolated"]) == ("log", False, True)
    assert own["slip_stderr"] > 0.0
    wet = [each for each in found["peaks"] if each["rail"] == "wet"]
    assert {(each["from"], each["slip_stderr"], each["mu_stderr"]) for each in wet} == {("rule", None, None)}
    assert all(each["reference_slip"] is not None for each in wet)
    assert set(dry.peak_notes) <= set(found["notes"])
    assert f"# {dry.peak_notes[1]}" in model_toml(dry)


def test_a_log_of_wet_rail_has_its_own_wet_peak_and_no_slip_for_dry_rail(tmp_path):
    found = found_in("burckhardt", rail=Rail.WET)
    assert not any(peak.by_rule for peak in found.peaks)
    assert found.peaks[-1].slip_stderr > 0.0
    assert len(found.peak_notes) == 1  # the other speeds alone
    (tmp_path / "model.toml").write_text(model_toml(found))
    assert tomllib.loads(model_toml(found))["reference_slip"] == {"wet": found.reference.wet}
    assert load_law(tmp_path / "model.toml").reference_slip(Rail.WET) == found.reference.wet


def test_the_peak_of_a_table_is_known_to_its_knots_at_best():
    """Its peak rests on a knot whatever the values are: the derivative by them is nought, the uncertainty is not."""
    found = found_in("table")
    knots, peak = np.array(found.chosen.fit.model.known["slip"]), found.own_peak
    top = int(np.argmin(np.abs(knots - peak.slip)))
    assert peak.slip == pytest.approx(knots[top], abs=1e-6)
    reach = 2.576 * peak.slip_stderr
    assert reach >= 0.99 * max(knots[top] - knots[top - 1], knots[top + 1] - knots[top])
    # the truth, in the closed form of the published beam, is inside
    slips = np.linspace(0.01, 0.6, 6000)
    assert abs(slips[np.argmax(adhesion_coefficient(BEAM, 100.0 * KMH, slips, LOAD))] - peak.slip) < reach


def test_a_log_that_stays_below_the_peak_has_no_slip_to_hold(railslip, rows, tmp_path):
    """The peak of a formula beyond all data is the formula's alone: up to 1.7 times the true one, and once slip 1."""
    slip = 1.0 - RADIUS * rows.columns["wheel_angular_speed"] / rows.columns["train_speed"]
    kept = np.logical_and.accumulate((slip < 0.03).reshape(2, -1), axis=1).ravel()
    path = write_log(tmp_path / "below.csv", rows.where(kept))
    status, out, _ = railslip("identify", path, "--model", "beam", "--out", tmp_path / "fitted")
    assert (status, "Reference: none; the slip of this log goes up to 0.0" in out) == (0, True)
    told = re.search(r"mu_max: by this log it is not less than (0\.\d+) \(99 %\), and has no upper end", out)
    assert 0.5 * BEAM.mu_max < float(told[1]) < BEAM.mu_max  # the rise alone leaves it free upwards
    assert "[reference_slip]" not in (tmp_path / "fitted" / "model.toml").read_text()
    found = json.loads((tmp_path / "fitted" / "identification.json").read_text())
    assert found["reference_slip"] is None
    assert all(peak["reference_slip"] is None for peak in found["peaks"] if peak["rail"] == "dry")
    assert all(peak["slip"] is not None for peak in found["peaks"])  # where the formula has it is told
    assert found["log"]["sliding_from"] == "the highest mean mu of the log"
    assert found["log"]["sliding_from_slip"] == found["log"]["data_peak_slip"]


def test_regimes_part_at_the_peak_of_the_model_and_not_where_noise_is_highest():
    """Two tests of a rig: the data's own highest mu may be far off on the beam's flat top, the fit's is not."""
    speed, law = 30.0, published_law("beam", Rail.DRY, 30.0)
    found = identified(run_tests(RigTest(PARK2008, law, speed * KMH), tests=2, seed=5))
    true = peak_of_law(law, speed * KMH, LOAD).slip
    assert found.regimes == Regimes(found.own_peak.slip, "the peak of beam")
    assert found.regimes.boundary == pytest.approx(true, abs=NORMAL_QUANTILE * found.own_peak.slip_stderr)
    assert found.regimes.boundary != found.curve.peak_slip
    assert sum(found.curve.parted_at(found.regimes.boundary)) == found.curve.survey.used
    assert found.train_lag.peak_slip == found.regimes.boundary


def test_the_chosen_model_has_the_intervals_that_it_has_alone(monkeypatch):
    """Those of the others are not worked out; their values are the same."""
    monkeypatch.setattr(job.models, "CANDIDATES", ("burckhardt", "beam"))
    both = found_in("best")
    alone = {name: found_in(name) for name in ("burckhardt", "beam")}
    chosen = both.chosen.fit.model.name
    assert both.chosen.fit.parameters == alone[chosen].chosen.fit.parameters
    assert [each.fit.with_profiles for each in both.scores] == [each is both.chosen for each in both.scores]
    for each in both.scores:
        assert each.fit.values.tolist() == alone[each.fit.model.name].chosen.fit.values.tolist()
    other = next(name for name in alone if name != chosen)
    taken = job._choosing(both, other)
    assert taken.chosen.fit.parameters == alone[other].chosen.fit.parameters
    assert taken.regimes == alone[other].regimes
    assert sum(each is taken.chosen for each in taken.scores) == 1


@pytest.mark.parametrize("speed", [60.0, 140.0])
def test_a_lag_of_the_train_shifts_the_slip_as_told(speed):
    """The virtual rig's log with its train's speed read 20 ms late, against the same without, row by row."""
    rows = run_tests(RigTest(PARK2008, published_law("beam", Rail.DRY, speed), speed * KMH), tests=4, seed=2)
    curve = curve_of(rows, PARK2008, Options())
    told = train_lag(curve.record, RADIUS, curve.peak_slip, 0.02)
    before = np.interp(rows.columns["time"] - 0.02, rows.columns["time"], rows.columns["train_speed"])
    true, late = (AdhesionStream(PARK2008).add(each) for each in (rows, changed(rows, train_speed=before)))
    # rows of one time, about the peak on the way up: the train's speed has not yet changed by the release
    _, i, j = np.intersect1d(true.time, late.time, return_indices=True)
    near = np.abs(true.slip[i] / curve.peak_slip - 1.0) < 0.1
    measured = np.median((late.slip[j] - true.slip[i])[near])
    # the deceleration is a mean over slips of 0.7 to 1.3 of the peak's, where mu is 0.97 of its highest and more
    assert told.slip_shift == pytest.approx(measured, rel=0.03)
    assert told.slip_shift > 3e-4


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
    words = f"slows down {curve.deceleration_ratio:.3g} times as much as the adhesion of this wheel makes"
    assert [words in text for text in curve.warnings if "the train slows down" in text] == [True] * (factor != 1.0)
    assert factor != 1.0 or curve.deceleration_ratio == pytest.approx(1.0, abs=2e-3)
