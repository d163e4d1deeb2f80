"""What forbids a slip controller to do better than the seeking one: bounds against its own runs and closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from project import script

import railslip_ctrl as rs
from railslip_ctrl.model.numeric import numeric_plant, peak, plant_parameters

KMH = 1 / 3.6
CAR = rs.PARK2008
CONTROL = rs.Seeking.for_vehicle(CAR)


@pytest.fixture(scope="module")
def limits():
    return script("analysis/seeking_limits.py")


# --- limits ---------------------------------------------------------------------------------------------------------


def test_below_a_speed_a_change_to_wet_locks_whatever_one_does(limits):
    """47 km/h on curve is another simulator's, in the contract of the seeking controller; a quick brake is worth 15."""
    law = limits.law_of("curve")
    speed = limits.least_speed(law, limits.braked("empty", 1.0), 1.0)
    assert speed == pytest.approx(47, abs=1.0)
    assert limits.least_speed(law, limits.braked("empty", 0.7), 1.0) == pytest.approx(speed - 15, abs=1.5)
    assert limits.least_speed(limits.law_of("polach"), CAR, 1.0) == pytest.approx(57, abs=1.0)
    assert limits.least_speed(limits.law_of("bristle"), CAR, 1.0) == 0.0  # held with hardly any slip


def test_what_letting_go_would_not_save(limits):
    """Polach's at 90 m, whose wheel comes there at 45 km/h; none at 40 m."""
    slow, fast, locked, doomed = limits.change("polach", "empty", 1.3, 90.0, range(3))
    assert fast < limits.least_speed(limits.law_of("polach"), limits.braked("empty", 1.3), 1.0)
    assert (slow > 30, doomed) == (True, locked)
    assert limits.change("polach", "loaded", 1.3, 40.0, range(3))[3] == 0


def test_who_holds_the_dry_peak_and_lets_go_at_the_change(limits):
    """A slow brake locks at 90 m on curve, empty, as the speed there says; polach's at 40 m does not, and is late."""
    law, slow = limits.law_of("curve"), limits.braked("empty", 1.3)
    speed = limits.speed_there(law, slow, 90.0)
    assert speed / KMH < limits.least_speed(law, slow, 1.0)
    assert math.isinf(limits.released_at_change("curve", "empty", 1.3, 90.0))
    short = limits.stop_on(law, "dry", slow, final_speed=speed)
    assert limits.clairvoyant_stop(short).braking_distance == pytest.approx(90.0, abs=0.1)
    assert limits.released_at_change("polach", "empty", 1.3, 40.0) == pytest.approx(15.5, abs=0.2)


def test_filling_is_noise_that_the_loop_answers(limits):
    least, stops = limits.filling("curve", "wet", range(2))
    quiet, noisy, slower = (torque for torque, _ in stops)
    assert least == pytest.approx(2.46, abs=0.01)
    assert least < quiet < slower < noisy
    assert slower < 12  # the contract's


def test_the_pole_past_a_steep_peak_against_the_dead_time(limits):
    """e^(p theta) of p = -r/(J v) dT_hold/dslip, the wheel alone: 3 % for what the train's motion adds."""
    law, v = limits.law_of("polach"), 100 * KMH
    least_ms, share, away = limits.steep(law, 100.0)
    slips = 1.25 * peak(law, v, CAR.wheel_load).slip + np.array([-1e-5, 1e-5])
    plant, known = numeric_plant(type(law)), plant_parameters(law, CAR)
    held = [plant.trim_torque(v, slip * v, 0.0, 0.0, 0.0, 0.0, known) for slip in slips]
    pole = -CAR.wheel.radius / (CAR.wheel.inertia * v) * np.diff(held)[0] / 2e-5
    assert least_ms[1] == pytest.approx(math.exp(pole * 0.15), rel=0.03)
    assert least_ms[0] == pytest.approx(1.0, abs=1e-3)
    assert 1.1 < share < 1.25
    assert away < 0.1  # per cent of the adhesion: no distance


def test_noise_locks_no_wheel_under_less_torque_on_a_static_curve(limits):
    assert limits.locks_under("curve", "dry", 0.9, range(10)) == 0
    assert limits.locks_under("curve", "wet", 1.0, range(10)) > 5  # the whole torque would


# --- the scripts ----------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_script(limits, capsys, monkeypatch):
    seen = limits.run(2, ("polach",), ("dry",))
    monkeypatch.setattr(limits, "run", lambda seeds: seen)
    monkeypatch.setattr("sys.argv", ["seeking_limits.py"])
    limits.main()
    assert "polach" in capsys.readouterr().out
