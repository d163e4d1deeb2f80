"""What a log shows to be wrong with itself or the vehicle, said in a line; and no slip to hold where there is none."""

from __future__ import annotations

import json

import numpy as np
import pytest
from rig_logs import rig_rows, write_log

from railslip_ctrl.adhesion import published_law
from railslip_ctrl.identification.identify import Options, curve_of, identify_curve
from railslip_ctrl.identification.survey import FreeRolling, mu_warning
from railslip_ctrl.numeric import adhesion_coefficient
from railslip_ctrl.parameters import PARK2008, Rail
from railslip_ctrl.units import KMH

BEAM = published_law("beam", Rail.DRY)


@pytest.fixture(scope="module")
def rows():
    """Two runs on a rig with the published beam."""
    return rig_rows(BEAM, runs=2, seed=3)[0]


# --- free rolling --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("factor", [1.012, 0.97])
def test_a_wrong_wheel_radius_shows_in_free_rolling(railslip, tmp_path, factor):
    """1.2 % are 5 mm of the published wheel."""
    rows = rig_rows(BEAM, seed=3, runs=2)[0]
    right = railslip("identify", write_log(tmp_path / "right.csv", rows), "--model", "beam")[2]
    rows.columns["wheel_angular_speed"] = factor * rows.columns["wheel_angular_speed"]
    err = railslip("identify", write_log(tmp_path / "worn.csv", rows), "--model", "beam")[2]
    assert f"free rolling shows a slip of {100 * (1 - factor):.1f} %: the wheel radius may be " in err
    radius = float(err.split("radius may be ")[1].split(" m")[0])
    assert radius == pytest.approx(0.43 / factor, abs=2e-4)  # the torque below 2 % of the load's slips by some 1e-4
    assert "free rolling" not in right


def test_a_wheel_that_recovers_after_each_brake_does_not_hide_a_wrong_radius(rows):
    """Half of the rows without brake are of a wheel coming back from half slip, as on a rig that records a second."""
    time = rows.columns["time"]
    released = np.concatenate([[False], np.diff(rows.columns["brake_torque"]) < -1000.0])
    since = time - np.maximum.accumulate(np.where(released, time, -np.inf))
    kept = ~((since > 1.0) & (since < 4.0))
    shown = rows.where(kept)
    shown.columns["wheel_angular_speed"] = 1.012 * shown.columns["wheel_angular_speed"]
    warnings = curve_of(shown, PARK2008, Options()).warnings
    assert any("the wheel radius may be 0.42" in text for text in warnings)


def test_a_wheel_recovering_is_not_rolling_freely():
    rolling, recovering = FreeRolling(), FreeRolling()
    none = np.zeros(5000)
    rolling.add(np.random.default_rng(0).normal(-0.013, 0.002, 5000), none)
    recovering.add(np.linspace(0.5, 0.0, 200), none[:200])
    assert rolling.slip == pytest.approx(-0.013, abs=2e-4)  # five standard errors of the median, and its bins
    assert recovering.slip is None
    assert FreeRolling().slip is None
    assert abs(rolling.torque) < 1e-5  # the width of a bin


# --- what cannot be ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["best", "burckhardt"])
def test_a_wheel_far_too_large_is_told_whether_or_not_a_model_follows_it(railslip, tmp_path, model):
    """A wheel that seems to run 12 % faster than its train: some fits end where numbers overflow."""
    wrong = rig_rows(BEAM, runs=1, seed=3)[0]
    wrong.columns["wheel_angular_speed"] = 1.117 * wrong.columns["wheel_angular_speed"]
    status, _, err = railslip("identify", write_log(tmp_path / "large.csv", wrong), "--model", model)
    assert status in (0, 2)
    assert "free rolling shows a slip of -11.7 %: the wheel radius may be 0.385" in err
    assert all(line.startswith("railslip: ") for line in err.splitlines())  # no warning of a library


def test_adhesion_that_steel_does_not_have_is_told(rows):
    """A torque in kgf*m read as one in daN*m or so: ten times the adhesion."""
    scaled = type(rows)(rows.line, {**rows.columns, "brake_torque": 9.80665 * rows.columns["brake_torque"]})
    warnings = curve_of(scaled, PARK2008, Options()).warnings
    (text,) = (text for text in warnings if "the highest mean adhesion coefficient is " in text)
    assert 2.0 < float(text.split("coefficient is ")[1].split(",")[0]) < 10.0
    assert not any("adhesion coefficient is" in text for text in curve_of(rows, PARK2008, Options()).warnings)
    assert mu_warning(np.array([0.2, 0.3])) is None
    assert "is 0.004," in mu_warning(np.array([0.004]))


def test_one_log_of_several_speeds_says_which_v0_it_is_taken_at():
    fast, slow = (rig_rows(BEAM, runs=1, seed=k, initial_speed=v * KMH)[0] for k, v in ((0, 100.0), (1, 50.0)))
    slow.columns["time"] = slow.columns["time"] + 30.0
    warnings = curve_of(fast.then(slow), PARK2008, Options()).warnings
    (text,) = (text for text in warnings if "braking begins between" in text)
    begin, end = (float(x) for x in text.split("between ")[1].split(" km/h")[0].split(" and "))
    assert 45.0 < begin < 51.0  # the train has lost a little when the slip comes to 0.005
    assert 95.0 < end < 101.0
    assert "is taken as 100 km/h" in text
    assert not any("braking begins" in text for text in curve_of(fast, PARK2008, Options()).warnings)


# --- the slip to hold ----------------------------------------------------------------------------------------------


def test_a_log_that_stays_below_the_peak_has_no_slip_to_hold(railslip, rows, tmp_path):
    """The peak of a formula beyond all data is the formula's alone: up to 1.7 times the true one, and once slip 1."""
    speed, omega = rows.columns["train_speed"], rows.columns["wheel_angular_speed"]
    below = (1.0 - PARK2008.wheel.radius * omega / speed < 0.03).reshape(2, -1)
    kept = np.logical_and.accumulate(below, axis=1).ravel()
    path = write_log(tmp_path / "below.csv", rows.where(kept))
    status, out, _ = railslip("identify", path, "--model", "beam", "--out", tmp_path / "fitted")
    assert status == 0
    assert "Reference: none; the slip of this log goes up to 0.0" in out
    assert "and the model's peak lies beyond; give a log that goes past the peak" in " ".join(out.split())
    assert "[reference_slip]" not in (tmp_path / "fitted" / "model.toml").read_text()
    found = json.loads((tmp_path / "fitted" / "identification.json").read_text())
    assert found["reference_slip"] is None
    assert all(peak["reference_slip"] is None for peak in found["peaks"] if peak["rail"] == "dry")
    assert all(peak["slip"] is not None for peak in found["peaks"])  # where the formula has it is told


def test_the_peak_of_a_table_is_known_to_its_knots_at_best(rows):
    """Its peak rests on a knot whatever the values are: the derivative by them is nought, the uncertainty is not."""
    options = Options(model="table")
    found = identify_curve(curve_of(rows, PARK2008, options), PARK2008, options)
    knots = np.array(found.chosen.fit.model.known["slip"])
    peak = found.peaks[-1]
    top = int(np.argmin(np.abs(knots - peak.slip)))
    assert peak.slip == pytest.approx(knots[top], abs=1e-6)
    reach = 2.576 * peak.slip_stderr
    assert reach >= 0.99 * max(knots[top] - knots[top - 1], knots[top + 1] - knots[top])
    # the truth, in the closed form of the published beam, is inside
    slips = np.linspace(0.01, 0.6, 6000)
    mu = [float(adhesion_coefficient(BEAM, 100.0 * KMH, slip, PARK2008.wheel_load)) for slip in slips]
    assert abs(slips[int(np.argmax(mu))] - peak.slip) < reach
