"""What a log shows to be wrong with itself or the vehicle, said in a line; and no slip to hold where there is none."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from rig_logs import rig_rows, write_log

from railslip_ctrl.core.units import KMH
from railslip_ctrl.identification.identify import Options, curve_of, identify_curve
from railslip_ctrl.identification.plausibility import mu_warning
from railslip_ctrl.identification.rolling import FreeRolling
from railslip_ctrl.model.adhesion import published_law
from railslip_ctrl.model.numeric import adhesion_coefficient
from railslip_ctrl.model.vehicle import PARK2008, Rail

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
    shown = float(err.split("free rolling shows a slip of ")[1].split(" %: the wheel radius may be ")[0])
    assert shown == pytest.approx(100 * (1 - factor), abs=0.03)  # in %: some 1e-4 of slip from friction, and rounding
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


def rolling_rows(slip: np.ndarray, torque: np.ndarray | float = 0.0) -> np.ndarray:
    """Rows as `FreeRolling` takes them, at 100 km/h, a hundred a second."""
    count = len(slip)
    speed = np.full(count, 100.0 * KMH)
    omega = (1.0 - slip) * speed / PARK2008.wheel.radius
    load = np.full(count, PARK2008.wheel_load)
    return np.stack([0.01 * np.arange(count), speed, omega, np.broadcast_to(torque, count), load])


def test_a_wheel_recovering_is_not_rolling_freely():
    rolling, recovering = FreeRolling(PARK2008), FreeRolling(PARK2008)
    rolling.add(rolling_rows(np.random.default_rng(0).normal(-0.013, 0.002, 5000)))
    recovering.add(rolling_rows(np.linspace(0.5, 0.0, 200)))
    found = rolling.found()
    assert found.slip == pytest.approx(-0.013, abs=5 * found.slip_error)
    # of a median of means: 1.25 sigma over root n, and windows that lie half over each other
    assert found.slip_error == pytest.approx(1.25 * 0.002 / np.sqrt(5000), rel=0.3)
    assert found.torque == 0.0
    assert recovering.found() is None
    assert FreeRolling(PARK2008).found() is None


@pytest.mark.parametrize("sizes", [[700, 300], [1, 13, 400, 586]])
def test_free_rolling_does_not_depend_on_the_blocks(sizes):
    rows = rolling_rows(np.random.default_rng(1).normal(0.0, 0.001, 1000), 120.0)
    whole, parts = FreeRolling(PARK2008), FreeRolling(PARK2008)
    whole.add(rows)
    for part in np.split(rows, np.cumsum(sizes)[:-1], axis=1):
        parts.add(part)
    assert parts.found() == whole.found()


def test_a_constant_torque_that_slows_the_train_is_braking():
    """3000 N*m on the rig's flywheels: 2 m/s^2. The same reading on a train that only coasts is a torque's zero."""
    braking, coasting = (rolling_rows(np.full(300, 0.01), 3000.0) for _ in range(2))
    time = braking[0]
    for rows, deceleration in ((braking, 3000.0 / (PARK2008.wheel.radius * PARK2008.mass)), (coasting, 0.14)):
        ratio = 1.0 - deceleration * time / rows[1]
        rows[1], rows[2] = ratio * rows[1], ratio * rows[2]
    found = []
    for rows in (braking, coasting):
        rolling = FreeRolling(PARK2008)
        rolling.add(rows)
        found.append(rolling.found())
    assert found[0] is None
    assert found[1].torque == pytest.approx(3000.0)


# --- what cannot be ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["best", "burckhardt"])
def test_a_wheel_far_too_large_is_told_whether_or_not_a_model_follows_it(railslip, tmp_path, model):
    """A wheel that seems to run 12 % faster than its train: some fits end where numbers overflow."""
    wrong = rig_rows(BEAM, runs=1, seed=3)[0]
    wrong.columns["wheel_angular_speed"] = 1.117 * wrong.columns["wheel_angular_speed"]
    status, _, err = railslip("identify", write_log(tmp_path / "large.csv", wrong), "--model", model)
    assert status in (0, 2)
    assert "free rolling shows a slip of -11.7 %: the wheel radius may be 0.38" in err
    assert all(line.startswith("railslip: ") for line in err.splitlines())  # no warning of a library


def test_adhesion_that_steel_does_not_have_is_told(rows):
    """A torque in kgf*m read as one in daN*m or so: ten times the adhesion."""
    scaled = type(rows)(rows.line, {**rows.columns, "brake_torque": 9.80665 * rows.columns["brake_torque"]})
    warnings = curve_of(scaled, PARK2008, Options()).warnings
    (text,) = (text for text in warnings if "the highest mean adhesion coefficient is " in text)
    assert 2.0 < float(text.split("coefficient is ")[1].split(",")[0]) < 10.0
    assert not any("adhesion coefficient is" in text for text in curve_of(rows, PARK2008, Options()).warnings)
    assert mu_warning(np.array([0.2, 0.3]), {}) is None
    assert "is 0.004," in mu_warning(np.array([0.004]), {})


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
    told = re.search(r"mu_max: by this log it is not less than (0\.\d+) \(99 %\), and has no upper end", out)
    assert 0.5 * BEAM.mu_max < float(told[1]) < BEAM.mu_max  # the rise alone leaves it free upwards
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
    peak = found.own_peak
    top = int(np.argmin(np.abs(knots - peak.slip)))
    assert peak.slip == pytest.approx(knots[top], abs=1e-6)
    reach = 2.576 * peak.slip_stderr
    assert reach >= 0.99 * max(knots[top] - knots[top - 1], knots[top + 1] - knots[top])
    # the truth, in the closed form of the published beam, is inside
    slips = np.linspace(0.01, 0.6, 6000)
    mu = [float(adhesion_coefficient(BEAM, 100.0 * KMH, slip, PARK2008.wheel_load)) for slip in slips]
    assert abs(slips[int(np.argmax(mu))] - peak.slip) < reach
