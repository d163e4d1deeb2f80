"""What is proven of the seeking controller, and what forbids better: bounds against its own runs and closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from project import script, show

import railslip_ctrl as rs
from railslip_ctrl.controllers import seeking as step
from railslip_ctrl.model.adhesion import law_class, published_law
from railslip_ctrl.model.numeric import adhesion_coefficient, numeric_plant, peak, plant_parameters

KMH = 1 / 3.6
CAR = rs.PARK2008
CONTROL = rs.Seeking.for_vehicle(CAR)


@pytest.fixture(scope="module")
def proofs():
    return script("analysis/seeking_proofs.py")


@pytest.fixture(scope="module")
def limits():
    return script("analysis/seeking_limits.py")


# --- the slip after the start ---------------------------------------------------------------------------------------


def test_the_holding_torque_is_the_plant_s(proofs):
    law, v, slip = published_law("beam", "dry"), 20.0, 0.07
    mu = adhesion_coefficient(law, v, slip, CAR.wheel_load)
    exact = numeric_plant(type(law)).trim_torque(v, slip * v, 0.0, 0.0, 0.0, 0.0, plant_parameters(law, CAR))
    assert proofs.holding(CAR, slip, mu, v, v * (1 - slip)) == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize(("law", "rail", "times"), [("beam", "dry", 4.0), ("beam", "wet", 2.0), ("curve", "wet", 2.0)])
def test_no_start_slips_more_than_its_bound(proofs, law, rail, times):
    """The bound holds and says something: so many times what is simulated at most. A start up to more slips more."""
    simulated, again = proofs.first_maximum(proofs.quiet(law, rail, 100 * KMH))
    box = proofs.box_about(published_law(law, rail), 100 * KMH, CAR.wheel_load, 0.0)
    bound = proofs.overshoot(CAR, CONTROL, box, 100 * KMH, again=again)
    assert simulated < bound < min(times * simulated, 1.0)
    later = CONTROL.model_copy(update={"first_slip": 1.1 * CONTROL.first_slip})
    assert proofs.overshoot(CAR, later, box, 100 * KMH, again=again) > bound


def any_curve(proofs, box, rng):
    """A table of a curve of a box: its place between the two rises up to the hump, then goes where the fall allows."""
    slip = np.concatenate([np.linspace(0.002, 0.3, 75), np.linspace(0.32, 1.0, 18)])
    least, most = (np.interp(slip, proofs.SLIPS, mu) for mu in (box.least, box.most))
    before = slip <= box.hump
    place = np.sort(rng.uniform(size=2))[np.searchsorted([rng.uniform(0, box.hump)], slip)]
    place[~before] = np.interp(slip[~before], [box.hump, 0.4, 1.0], [place[before][-1], *rng.uniform(size=2)])
    mu = least + (most - least) * place
    mu[~before] = np.maximum(mu[~before], mu[before][-1] - box.fall * (slip[~before] - slip[before][-1]))
    inside = np.all(np.diff(mu[before]) >= 0) and np.all(np.diff(mu[~before]) >= -box.fall * np.diff(slip[~before]))
    return law_class("table")(slip=tuple(slip), mu=tuple(mu), reference=rs.ReferenceSlip(dry=0.1, wet=0.1)), inside


@pytest.mark.long
@pytest.mark.parametrize(("law", "rail"), [("beam", "dry"), ("beam", "wet"), ("curve", "wet")])
def test_no_curve_of_a_box_slips_more_than_its_bound(proofs, law, rail):
    rng, width, v, seen = np.random.default_rng(7), 0.05, 100 * KMH, []
    box = proofs.box_about(published_law(law, rail), v, CAR.wheel_load, width)
    bounds = [proofs.overshoot(CAR, CONTROL, box, v, again=again) for again in range(4)]
    for _ in range(120):
        table, inside = any_curve(proofs, box, rng)
        if inside:
            highest, again = proofs.first_maximum(proofs.quiet(table, "dry", v))
            seen.append(highest / bounds[again])
    assert len(seen) > 12
    assert max(seen) < 1.0


# --- seeking, re-adhesion -------------------------------------------------------------------------------------------


def test_the_map_fits_what_it_was_given(proofs):
    """Within its bound on a parabola, whose curvature is the same everywhere, and not far below it."""
    rng, bend = np.random.default_rng(2), 20.0
    x, p = proofs.state_and_parameters()
    slips = rng.uniform(0.06, 0.12, 400)
    mus = 0.3 - 0.5 * bend * (slips - 0.09) ** 2
    weights = math.exp(-proofs.PERIOD / CONTROL.forgetting) ** np.arange(len(slips))[::-1]
    for k, (slip, mu) in enumerate(zip(slips, mus, strict=True)):
        x.samples, x.filtered_sigma, x.adhesion_torque = 1000 + k, slip, mu * CONTROL.wheel_load
        step.learn(x, p)
    step.solve_map(x, p)
    found = np.interp(slips, proofs.KNOTS, x.adhesion)
    rms = math.sqrt(weights @ (found - mus) ** 2 / weights.sum())
    bound = proofs.misfit(bend, CONTROL, 0.06, 0.12, float(weights.sum()))
    assert 0.1 * bound < rms < bound


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("at", [0.015, 0.05, 0.09])
def test_a_hump_is_found(proofs, at, power):
    """Simulated: within a flatness and a half on average, and never far away."""
    distance, mean, most = proofs.seek_hump(at, power)
    assert distance < 0.025
    assert mean < 1.5 * CONTROL.flatness
    assert most < 3 * CONTROL.flatness


def test_where_it_rests_it_gives_away_the_flatness(proofs):
    """By the map of the last sample, on a curve on which it rests."""
    curve = proofs.hump(0.05, 1.0)
    slips = proofs.sought(curve, 3.0)
    assert np.ptp(slips[-30:]) < 1e-3
    assert 1 - curve(slips[-1]) / 0.3 < CONTROL.flatness + 2 * 0.003  # of the map, `misfit`


def test_a_peak_below_the_knots_is_not_found(proofs):
    distance, mean, _most = proofs.seek_hump(0.003, 1.0)
    assert distance == pytest.approx(CONTROL.largest_slip - 0.003, abs=1e-6)
    assert mean > 0.5


@pytest.mark.parametrize("law", ["curve", "beam"])
def test_the_second_start_is_commanded_in_time(proofs, law):
    bound, simulated = proofs.restart(law)
    assert simulated <= bound < 0.5
    dry = published_law(law, "dry")
    hardly = 0.95 * float(adhesion_coefficient(dry, 20.0, 0.08, CAR.wheel_load))
    assert math.isinf(proofs.restart_within(hardly, dry, 20.0, 0.08))  # too little better to be told


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


def test_the_pole_past_a_steep_peak_against_the_dead_time(limits, proofs):
    """e^(p theta) of p = -r/(J v) dT_hold/dslip, the wheel alone: 3 % for what the train's motion adds."""
    law, v = limits.law_of("polach"), 100 * KMH
    least_ms, share, away = limits.steep(law, 100.0)
    slips = 1.25 * peak(law, v, CAR.wheel_load).slip + np.array([-1e-5, 1e-5])
    held = proofs.holding(CAR, slips, adhesion_coefficient(law, v, slips, CAR.wheel_load), v, v * (1 - slips))
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
def test_scripts(proofs, limits, tmp_path, capsys, monkeypatch):
    found = proofs.run()
    for (law, _, kmh), (bounds, simulated, _, more) in found.starts.items():
        assert simulated <= more
        assert bounds == sorted(bounds)
        assert (law, kmh) != ("beam", 100.0) or max(bounds) < 1
    show(proofs, found, tmp_path, monkeypatch)
    assert capsys.readouterr().out.count("\n") == 2 + len(found.starts) + 2 + len(found.humps) + 2 + 2
    seen = limits.run(2, ("polach",), ("dry",))
    monkeypatch.setattr(limits, "run", lambda seeds: seen)
    monkeypatch.setattr("sys.argv", ["seeking_limits.py"])
    limits.main()
    assert "polach" in capsys.readouterr().out
