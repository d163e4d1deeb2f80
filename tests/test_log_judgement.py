"""What is said of a fit: what cannot be is refused, what is by rule or extrapolated is marked, the unseen is told."""

from __future__ import annotations

import dataclasses
import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
from project import refused
from rig_logs import changed, identified, rig_rows, write_log

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import KMH
from railslip_ctrl.identification import identify as job
from railslip_ctrl.identification.cleaning import OutlierFilter
from railslip_ctrl.identification.curves import Options, curve_of, read_curve
from railslip_ctrl.identification.fits import NORMAL_QUANTILE, Parameter, fit
from railslip_ctrl.identification.identify import IMPOSSIBLE_MU, Identification, Lag, LogSeries, check_fit, fit_doubts
from railslip_ctrl.identification.log_checks import train_lag
from railslip_ctrl.identification.logs import Rows
from railslip_ctrl.identification.models import fit_model, shape_of
from railslip_ctrl.identification.observed import AdhesionStream
from railslip_ctrl.identification.results import Regimes, over_initial_speed, peak_of_law
from railslip_ctrl.identification.virtual_rig import RigTest, run_tests
from railslip_ctrl.model.adhesion import load_law, published_law
from railslip_ctrl.model.vehicle import PARK2008, Rail
from railslip_ctrl.report.identification import (
    identification_json,
    identification_text,
    model_toml,
    series_json,
    series_toml,
)

BEAM = published_law("beam", Rail.DRY)
RADIUS = PARK2008.wheel.radius


pytestmark = pytest.mark.usefixtures("without_lag_search")


@pytest.fixture(scope="module")
def rows() -> Rows:
    """Two runs on a rig with the published beam."""
    return rig_rows(BEAM, runs=2, seed=3)[0]


@pytest.fixture(scope="module")
def dry(rows) -> Identification:
    return identified(rows)


# --- what cannot be ------------------------------------------------------------------------------------------------


def test_a_fit_above_what_steel_has_is_refused_and_leaves_nothing(railslip, rows, tmp_path):
    """A wheel load of 2 kN where it is 34.5: the published 0.261 becomes 4.5."""
    lines = write_log(tmp_path / "log.csv", rows).read_text().splitlines()
    (tmp_path / "log.csv").write_text("\n".join([lines[0] + ",wheel load [kN]", *(f"{x},2" for x in lines[1:])]) + "\n")
    out, observed = tmp_path / "fitted", tmp_path / "observed.csv"
    line = refused(railslip("identify", tmp_path / "log.csv", "--model", "beam", "--out", out, "--observed", observed))
    assert float(line.split("(mu_max), is ")[1].split(",")[0]) == pytest.approx(0.261 * 34.5 / 2, rel=0.03)
    assert f"above {IMPOSSIBLE_MU:g}, which no steel on steel in air has; check the unit of the brake torque" in line
    assert "the wheel load and the wheel's radius (--vehicle)" in line
    assert {each.name for each in tmp_path.iterdir()} == {"log.csv"}


def test_models_left_out_as_impossible_are_warned_of(rows, monkeypatch):
    """Of several models one whose adhesion cannot be: what did that may be wrong of the one that is taken."""
    monkeypatch.setattr("railslip_ctrl.identification.identify.CANDIDATES", ("burckhardt", "beam"))
    monkeypatch.setattr(job, "highest_mu", lambda fit, _: ("peak", 2.0 if fit.model.name != "beam" else 0.3))
    found = identified(rows, "best")
    assert found.chosen.fit.model.name == "beam"
    assert (
        "log: burckhardt: fitted to this log its highest adhesion coefficient, the peak, is 2," in found.not_fitted[0]
    )
    (told,) = found.warnings
    assert told.startswith("log: burckhardt: left out, as fitted to this log their adhesion cannot be")


def test_a_log_that_does_not_tell_a_model_is_refused_as_that(dry):
    """The elastic rise alone: mu_max of the beam is free to be any."""
    found, fit = dry, dry.chosen.fit
    free = dataclasses.replace(fit.parameters[0], value=2.4e8)
    vague = dataclasses.replace(fit, parameters=(free, *fit.parameters[1:]))
    words = r"limit of friction \(mu_max\), is 2.4e\+08, above 1, .*not tell this model.*--bound mu_max=0:0.7"
    with pytest.raises(InputError, match=words):
        check_fit(vague, found.setting, found.curve)


def test_a_fit_that_may_hardly_be_is_told_everywhere(rows):
    """A wheel load of 0.36 of the rig's."""
    load = np.full(len(rows), 0.36 * PARK2008.wheel_load)
    found = identified(changed(rows, wheel_load=load))
    (doubt,) = found.doubts
    assert "the fitted beam has a highest adhesion coefficient, its limit of friction (mu_max), of 0.72" in doubt
    assert "where steel on steel has 0.01 to 0.7: check the unit of the brake torque" in doubt
    assert doubt in " ".join(identification_text(found).split())
    assert doubt in identification_json(found)["log"]["warnings"]
    assert doubt in model_toml(found)


def test_a_parameter_on_its_bound_is_told_with_bound_and_cause(dry):
    fit, setting = dry.chosen.fit, dry.setting
    at = (Parameter("mu_max", 0.26, math.nan, "at upper bound"), Parameter("a", 1e-12, math.nan, "at lower bound"))
    resting = dataclasses.replace(fit, parameters=(*at, fit.parameters[2]))
    given = dataclasses.replace(setting, bounds={"mu_max": (0.1, float(fit.model.upper[0]))})
    sound, high_up = (SimpleNamespace(name="log", highest_mu=mu, factors={}) for mu in (0.25, 3.0))
    high, low = fit_doubts(resting, given, sound)
    assert high.startswith(
        "log: the fitted mu_max of 0.26 rests on its upper bound, infinity: which is given by --bound"
    )
    assert "the fitted a of 1e-12 rests on its lower bound, 0: likely this log does not tell it" in low
    assert "likely by a wrong unit of the brake torque" in fit_doubts(resting, setting, high_up)[0]
    assert fit_doubts(fit, setting, sound) == ()
    free = dataclasses.replace(fit.parameters[1], limits=(1e-12, math.inf))
    (told,) = fit_doubts(
        dataclasses.replace(fit, parameters=(fit.parameters[0], free, fit.parameters[2])), setting, sound
    )
    assert told.startswith(f"log: the fitted a of {free.value:.4g} may as well be any other by this log")


# --- units ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("header", "scale", "unit"), [("N*m", 1.0, "kN*m"), ("kN*m", 1e3, "N*m")])
def test_a_torque_a_thousand_times_off_is_told_with_the_option_that_mends_it(
    railslip, rows, tmp_path, header, scale, unit
):
    right = write_log(tmp_path / "right.csv", rows)
    scaled = changed(rows, brake_torque=scale * rows.columns["brake_torque"])
    path = write_log(tmp_path / "log.csv", scaled)
    path.write_text(path.read_text().replace("brake torque [kN*m]", f"brake torque [{header}]"))
    line = refused(railslip("identify", path, "--model", "table"))
    assert f"brake_torque seems to be in {unit} (--unit brake_torque={unit}), which would make it 0." in line
    mended = read_curve(path, PARK2008, Options(units={"brake_torque": unit}))
    assert mended.bins.mean == pytest.approx(read_curve(right, PARK2008, Options()).bins.mean, rel=1e-6)


# --- by rule, extrapolated -----------------------------------------------------------------------------------------


def test_what_is_not_from_the_log_is_marked(dry):
    found = identification_json(dry)
    own, other = found["peaks"][4], found["peaks"][0]
    assert (own["from"], own["extrapolated"], other["extrapolated"]) == ("log", False, True)
    assert own["slip_stderr"] > 0.0
    wet = [each for each in found["peaks"] if each["rail"] == "wet"]
    assert {each["from"] for each in wet} == {"rule"}
    assert all(each["slip_stderr"] is None and each["mu_stderr"] is None for each in wet)
    assert all(each["reference_slip"] is not None for each in wet)
    for note in dry.peak_notes:
        assert note in found["notes"]
    text = identification_text(dry)
    lines = [line.split() for line in text.splitlines() if line.split()[:1] in (["dry"], ["wet"])]
    assert [line[1] for line in lines] == ["log,"] * 4 + ["log"] + ["rule,"] * 4 + ["rule"]
    assert ["±" in line for line in lines] == [True] * 5 + [False] * 5
    assert "the log is of v0 = 100 km/h" in text
    assert f"# {dry.peak_notes[1]}" in model_toml(dry)


def test_a_log_of_wet_rail_has_its_own_wet_peak(rows):
    found = identified(rows, rail=Rail.WET)
    assert not any(peak.by_rule for peak in found.peaks)
    assert found.peaks[-1].slip_stderr > 0.0
    assert len(found.peak_notes) == 1  # the other speeds alone


def test_a_model_without_a_slip_to_hold_says_why(rows, dry):
    found = identification_json(identified(rows, "lugre"))
    assert found["reference_slip"] is None
    assert found["reference_slip_reason"].startswith("this model falls from the start")
    assert identification_json(dry)["reference_slip_reason"] is None


# --- the regime of each row ----------------------------------------------------------------------------------------


def test_each_observed_row_has_its_regime(railslip, rows, tmp_path):
    log, file = write_log(tmp_path / "log.csv", rows), tmp_path / "observed.csv"
    status, out, _ = railslip("identify", log, "--model", "table", "--observed", file, "--json")
    assert status == 0
    found = json.loads(out)
    lines = [line.split(",") for line in file.read_text().splitlines()[1:]]
    slip, regime = np.array([float(line[2]) for line in lines]), np.array([line[6] for line in lines])
    top = found["log"]["sliding_from_slip"]
    assert np.array_equal(regime, np.where(slip < top, "adhesion", "sliding"))
    for each in found["curve"]:  # bins by the same rule
        if each["slip_to"] <= top or each["slip_from"] >= top:
            inside = (slip >= each["slip_from"]) & (slip < each["slip_to"])
            assert set(regime[inside]) == {each["regime"]}
    for name in ("adhesion", "sliding"):
        assert int(np.sum(regime == name)) == found["log"][f"{name}_regime_points"]


def test_regimes_part_at_the_peak_of_the_model_and_not_where_noise_is_highest():
    """Two tests of a rig: the data's own highest mu may be far off on the beam's flat top, the fit's is not."""
    speed, law = 30.0, published_law("beam", Rail.DRY, 30.0)
    found = identified(run_tests(RigTest(PARK2008, law, speed * KMH), tests=2, seed=5))
    true = peak_of_law(law, speed * KMH, PARK2008.wheel_load).slip
    assert found.regimes == Regimes(found.own_peak.slip, "the peak of beam")
    assert found.regimes.boundary == pytest.approx(true, abs=NORMAL_QUANTILE * found.own_peak.slip_stderr)
    assert found.regimes.boundary != found.curve.peak_slip
    assert sum(found.curve.parted_at(found.regimes.boundary)) == found.curve.survey.used
    assert found.train_lag.peak_slip == found.regimes.boundary


def test_a_model_of_sliding_alone_begins_where_the_others_peak(rows, monkeypatch):
    monkeypatch.setattr("railslip_ctrl.identification.identify.CANDIDATES", ("lugre", "burckhardt"))
    best = identified(rows, model="best")
    assert best.regimes == Regimes(best.own_peak.slip, "the peak of burckhardt")
    lugre = next(each.fit for each in best.scores if each.fit.model.name == "lugre")
    cells, setting = best.curve.cells, best.setting
    model = fit_model("lugre", cells, shape_of(cells, best.curve.peak_slip), setting)
    again = fit(model, cells, best.curve.stretches, setting, best.regimes.boundary, best.curve.time_constant)
    assert [p.value for p in lugre.parameters] == [p.value for p in again.parameters]


# --- a lag of the train's speed ------------------------------------------------------------------------------------


def late_train(rows: Rows, lag: float) -> Rows:
    """The log with the train's speed as it was `lag` s before, in pauses between tests as it stands."""
    time, speed = rows.columns["time"], rows.columns["train_speed"]
    return changed(rows, train_speed=np.interp(time - lag, time, speed))


def observed_slip(rows: Rows):
    stream = AdhesionStream(PARK2008)
    return stream.add(rows)


@pytest.mark.parametrize("speed", [60.0, 140.0])
def test_a_lag_of_the_train_shifts_the_slip_as_told(speed):
    """The virtual rig's log with its train's speed read 20 ms late, against the same without, row by row."""
    test = RigTest(PARK2008, published_law("beam", Rail.DRY, speed), speed * KMH)
    rows = run_tests(test, tests=4, seed=2)
    curve = curve_of(rows, PARK2008, Options())
    told = train_lag(curve.record, RADIUS, curve.peak_slip, 0.02)
    true, late = observed_slip(rows), observed_slip(late_train(rows, 0.02))
    # rows of one time, about the peak on the way up: the train's speed has not yet changed by the release
    _, i, j = np.intersect1d(true.time, late.time, return_indices=True)
    near = np.abs(true.slip[i] / curve.peak_slip - 1.0) < 0.1
    measured = np.median((late.slip[j] - true.slip[i])[near])
    # the deceleration is a mean over slips of 0.7 to 1.3 of the peak's, where mu is 0.97 of its highest and more
    assert told.slip_shift == pytest.approx(measured, rel=0.03)
    assert told.slip_shift > 3e-4


# --- outliers ------------------------------------------------------------------------------------------------------


def test_a_wheel_that_is_noisier_under_brake_has_no_outliers():
    """Four times the noise of rolling in a tenth of the rows: a limit from rolling is two deviations there."""
    generator = np.random.default_rng(4)
    count = 100_000
    braking = np.arange(count) % 1000 < 100
    noise = np.where(braking, 0.4, 0.1) * generator.standard_normal(count)
    spikes = np.array([50, 12_345, 50_020, 70_500])  # two of them under brake
    columns = {"time": 0.01 * np.arange(count), "wheel_angular_speed": 60.0 + noise}
    for at, expected in (([], 0), (spikes, len(spikes))):
        omega = columns["wheel_angular_speed"].copy()
        omega[at] += 8.0
        outliers = OutlierFilter()
        list(outliers.rows(iter([Rows(np.arange(count), {**columns, "wheel_angular_speed": omega})])))
        assert outliers.count == expected


# --- several logs --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def campaign(dry) -> LogSeries:
    """One identification as if of three logs at three speeds, with parameters and errors of their own."""
    speeds, logs = (60.0 * KMH, 100.0 * KMH, 140.0 * KMH), []
    for v0, factor, error in zip(speeds, (1.2, 1.0, 0.9), (1.0, 0.5, 2.0), strict=True):
        fit = dry.chosen.fit
        own = tuple(dataclasses.replace(p, value=factor * p.value, stderr=error * p.stderr) for p in fit.parameters)
        score = dataclasses.replace(dry.chosen, fit=dataclasses.replace(fit, parameters=own))
        setting = dataclasses.replace(dry.setting, initial_speed=v0)
        logs.append(dataclasses.replace(dry, chosen=score, setting=setting))
    return LogSeries(tuple(logs), over_initial_speed(speeds, [each.chosen.fit for each in logs]))


def test_a_file_of_several_logs_has_the_standard_errors_of_its_coefficients(campaign, tmp_path):
    """Three logs determine a parabola: the errors by Lagrange's polynomials, and at each log its own."""
    text = series_toml(campaign)
    path = tmp_path / "model.toml"
    path.write_text(text, encoding="utf-8")
    assert load_law(path, initial_speed_kmh=100.0).mu_max == pytest.approx(campaign.polynomials[0].at(100.0))
    for k, p in enumerate(campaign.polynomials):
        own = np.array([each.chosen.fit.parameters[k].stderr for each in campaign.logs])
        basis = np.linalg.inv(np.vander(p.speeds_kmh, 3, increasing=True))  # coefficients by values
        assert p.stderrs == pytest.approx(np.sqrt(basis**2 @ own**2), rel=1e-6)
        (line,) = (line for line in text.splitlines() if line.startswith(f"# {p.name}: standard errors of the"))
        errors = [float(x) for x in line.split("coefficients ")[1].split(";")[0].split(", ")]
        assert errors == pytest.approx(p.stderrs, rel=6e-3)  # three digits are told
        values = [float(part.split(" at ")[0]) for part in line.split("of the value ")[1].split(", ")]
        assert values == pytest.approx(own, rel=6e-3)
        covariance = np.array(series_json(campaign)["parameters"][p.name]["covariance"])
        assert np.sqrt(np.diag(covariance)) == pytest.approx(p.stderrs)


def test_a_parabola_of_more_logs_has_the_errors_of_their_scatter(campaign):
    """Five logs, a weighted fit: the scatter of the coefficients over draws of the values, by NumPy's polyfit."""
    speeds = np.array([40.0, 60.0, 90.0, 120.0, 140.0])
    stderrs = np.array([4.0, 2.0, 1.0, 2.0, 3.0]) * 1e-3
    fit = campaign.logs[0].chosen.fit
    fits = [
        dataclasses.replace(fit, parameters=(Parameter("mu_max", 0.3, error, "fitted"), *fit.parameters[1:]))
        for error in stderrs
    ]
    generator = np.random.default_rng(0)
    drawn = [
        np.polyfit(speeds, 0.3 + stderrs * generator.standard_normal(5), 2, w=1.0 / stderrs)[::-1] for _ in range(4000)
    ]
    found = over_initial_speed(speeds * KMH, fits)[0]
    # the scatter of 4000 draws is known to 1.1 %; four of those
    assert found.stderrs == pytest.approx(np.std(drawn, axis=0), rel=0.045)


# --- intervals -----------------------------------------------------------------------------------------------------


def test_the_chosen_model_has_the_intervals_that_it_has_alone(rows, monkeypatch):
    """Those of the others are not worked out; their values are the same."""
    monkeypatch.setattr("railslip_ctrl.identification.identify.CANDIDATES", ("burckhardt", "beam"))
    both = identified(rows, model="best")
    alone = {name: identified(rows, model=name) for name in ("burckhardt", "beam")}
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


# --- the train's deceleration --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def rig_log() -> Rows:
    return run_tests(RigTest(PARK2008, BEAM, 100 * KMH), tests=2, seed=4)


@pytest.mark.parametrize("factor", [0.5, 0.7376, 1.0, 2.0])  # half the wheels; lb*ft for N*m; right; twice
def test_a_torque_of_the_wrong_scale_shows_in_the_train_s_deceleration(rig_log, factor):
    rows = changed(rig_log, brake_torque=factor * rig_log.columns["brake_torque"])
    curve = curve_of(rows, PARK2008, Options())
    # by hand, of the first run: M times the speed lost, against force of torque and wheel by momentum, and resistance
    run = curve.record.run == curve.record.run[0]
    t, v, omega, torque = (getattr(curve.record, name)[run] for name in ("time", "speed", "omega", "torque"))
    wheel = np.trapezoid(torque + 0.25 * omega, t) + 60.35 * (omega[-1] - omega[0])
    own = 3517.0 * (v[0] - v[-1]) / (wheel / RADIUS + np.trapezoid(0.63 * v**2, t))
    assert curve.deceleration_ratio == pytest.approx(own, rel=0.01)  # of two runs, whose noise differs
    told = [text for text in curve.warnings if "the train slows down" in text]
    if factor == 1.0:
        assert curve.deceleration_ratio == pytest.approx(1.0, abs=2e-3)
        assert told == []
    else:
        assert (curve.deceleration_ratio > 1.0) == (factor < 1.0)
        assert f"slows down {curve.deceleration_ratio:.3g} times as much as the adhesion of this wheel makes" in told[0]


def test_no_delay_is_advised_where_the_deceleration_does_not_fit(rig_log, monkeypatch):
    monkeypatch.setattr(job, "lag_of", lambda *_: Lag(-0.0043, 0.001))
    half = changed(rig_log, brake_torque=0.5 * rig_log.columns["brake_torque"])
    text = " ".join(identified(half).warnings)
    assert "shifted by -0.0043 s, which a torque of the wrong scale, or a wrong vehicle, makes too" in text
    assert "undoes it" not in text
    monkeypatch.setattr(job.Candidates, "better_followed", lambda self, fit: fit)
    assert "undoes it" in " ".join(identified(rig_log).warnings)


def test_a_rig_that_keeps_its_speed_has_no_deceleration_to_compare(rows):
    v = np.full(len(rows), 100.0 / 3.6)
    omega = rows.columns["wheel_angular_speed"] * v / rows.columns["train_speed"]
    kept = curve_of(changed(rows, train_speed=v, wheel_angular_speed=omega), PARK2008, Options())
    assert math.isnan(kept.deceleration_ratio)
    assert kept.warnings == ()
