"""Stops continued to walking pace, and adhesion laws of one's own in a report."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from railslip_ctrl.adhesion import ReferenceSlip, published_law
from railslip_ctrl.adhesion.beam import Beam
from railslip_ctrl.design.specification import is_robust
from railslip_ctrl.design_report.candidates import design_names, full_range
from railslip_ctrl.design_report.held_laws import held_laws
from railslip_ctrl.design_report.slow_end import slow_ends
from railslip_ctrl.design_report.speed_range import speed_range
from railslip_ctrl.design_report.stops import stops
from railslip_ctrl.errors import InputError
from railslip_ctrl.law_sources import is_own
from railslip_ctrl.linearization import linearize, operating_point
from railslip_ctrl.numeric import adhesion_coefficient, peak
from railslip_ctrl.parameters import PARK2008, Rail
from railslip_ctrl.report.html.numbers import above, below, short
from railslip_ctrl.report.html.verdict import verdict
from railslip_ctrl.report.html.words import policy_words, slow_words
from railslip_ctrl.simulation import Simulator, published_scenario
from railslip_ctrl.simulation.controller_files import load_controller
from railslip_ctrl.simulation.designed import initial_torque, recommended_pi_lead
from railslip_ctrl.simulation.scenario import named_law
from railslip_ctrl.units import KMH

TAKEN = recommended_pi_lead(PARK2008)
V100 = 100.0 * KMH


def a_stop(rail):
    law = named_law("curve", PARK2008)
    return published_scenario(as_published=False).with_changes(
        vehicle=PARK2008, adhesion=law, rail=rail, initial_speed=V100, events=()
    )


@pytest.fixture(scope="module")
def wet_end():
    (end,) = slow_ends(
        a_stop(Rail.WET), "pi-lead", TAKEN, [named_law("curve", PARK2008)], range(4), initial_torque(PARK2008)
    )
    return end


def test_end_of_a_stop_is_what_its_runs_do(wet_end):
    """The same runs made here, of the loaded vehicle, with one of the seeds."""
    seed, start, usual = 2, wet_end.from_kmh * KMH, wet_end.usual_kmh * KMH
    handed = replace(TAKEN, cut_out_speed=start, cut_out_torque=wet_end.torque)
    whole = a_stop(Rail.WET).with_changes(final_speed=wet_end.least_kmh * KMH, vehicle=PARK2008.loaded())
    for controller, runs in ((TAKEN, wet_end.controlled), (handed, wet_end.handed_over)):
        signals = Simulator(whole, controller).run(seed, record_every=1).signals
        slow = signals.speed < start
        one = next(run for run in runs if (run.seed, run.mass) == (seed, PARK2008.mass_loaded))
        assert one.highest_slip == signals.slip[slow].max()
        assert one.highest_slip_usual == signals.slip[slow & (signals.speed >= usual)].max()
        locked = signals.speed[slow & (signals.locked > 0)]
        assert one.locks == bool(locked.size)
        assert locked.max(initial=-np.inf) / KMH == (one.locked_kmh if one.locks else -np.inf)


def test_below_the_cut_out_speed_the_torque_is_the_one_asked_for():
    handed = replace(TAKEN, cut_out_speed=20 * KMH, cut_out_torque=1500.0)
    quiet = a_stop(Rail.DRY)
    signals, alone = (Simulator(quiet, one).run(0, record_every=1).signals for one in (handed, TAKEN))
    # one row is that of the step in which the speed is passed
    below = signals.measured_speed < 20 * KMH
    assert np.all(signals.command[below][1:] == 1500.0)
    first = int(np.flatnonzero(below)[0])
    np.testing.assert_array_equal(signals.command[:first], alone.command[:first])


def test_a_controller_file_asks_for_the_cut_out(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('kind = "pi"\nkp = 330\nki = 129\ncut_out_speed = "20 km/h"\ncut_out_torque = "1.5 kN*m"\n')
    made = load_controller(path)
    assert (made.cut_out_speed, made.cut_out_torque) == pytest.approx((20 * KMH, 1500.0))
    path.write_text('kind = "pi"\nkp = 330\nki = 129\ncut_out_speed = -1\n')
    with pytest.raises(InputError, match=r"mine.toml: cut_out_speed: -1 is not allowed; give a value >= 0 \(m/s\)"):
        load_controller(path)


def test_what_locks_a_slow_wheel_is_the_disturbance(wet_end):
    """On wet rail the loop is stable down to 1 km/h, and so is the undisturbed run; with the random force it locks."""
    point = operating_point(published_law("curve", Rail.WET), PARK2008, V100, wet_end.reference, rail=Rail.WET)
    lines = [one for one in speed_range("", TAKEN.design, [linearize(point)]).lines if one.law == "curve"]
    assert [line.holds_throughout for line in lines] == [True, True]
    assert len(wet_end.controlled) == 8
    assert all(one.locks for one in wet_end.controlled)
    assert [(one.seed, one.locks) for one in wet_end.undisturbed] == [(None, False)] * 2
    assert max(one.highest_slip for one in wet_end.undisturbed) < 1.1 * wet_end.reference
    told = slow_words([wet_end])
    assert "locked in 8 of 8" in told
    assert "locked by the disturbance" in told
    assert "locked by the disturbance" not in slow_words([replace(wet_end, undisturbed=wet_end.controlled)])


def test_a_policy_that_locks_a_wheel_is_no_advice(wet_end):
    assert not any(one.locks for one in wet_end.handed_over)
    assert "Use: from 20 km/h down" in policy_words([wet_end])
    # the controlled runs lock above 5 km/h, where a stop usually ends
    both = replace(wet_end, handed_over=wet_end.controlled)
    told = policy_words([both])
    assert "no remedy" in told
    assert "Use:" not in told
    # and then what: the controller goes on where its own runs do, and hands over where they are lost
    kept = replace(wet_end, handed_over=wet_end.controlled, controlled=wet_end.handed_over)
    assert np.isnan(kept.lost_at)
    assert "What follows: leave slip control on; its own runs lock no wheel above 5 km/h." in policy_words([kept])
    # a wheel that only slips is kept, one that locks is not
    slips = replace(kept, controlled=tuple(replace(one, beyond_kmh=19.0) for one in kept.controlled))
    assert "though slip passes twice its reference from 19 km/h" in policy_words([slips])
    locks = both.held_locks_at
    assert locks == both.locks_at == max(one.locked_kmh for one in wet_end.controlled)
    assert both.lost_at == max(locks, *(one.beyond_kmh for one in wet_end.controlled))
    assert f"use slip control down to {above(locks, 2)} km/h" in told
    assert f"(the torque held down to {above(locks, 2)} km/h)" in told
    assert f"Below {above(locks, 2)} km/h neither does" in told
    assert both.friction_needed < both.friction_there
    assert f"at most {short(both.friction_there, 2)} by the law {both.law}" in told
    assert "and it locks nevertheless" in told
    icy = replace(both, friction_needed=1.5 * both.friction_there)  # more than the friction there is
    assert f"a torque below {below(icy.torque_there, 2)} N·m; the" in policy_words([icy])


def test_friction_that_a_held_torque_needs_is_that_of_constant_slip(wet_end):
    law, speed = named_law("curve", PARK2008).on(Rail.WET), wet_end.from_kmh * KMH
    for slip in (0.03, 0.05):
        point = operating_point(law, PARK2008, speed, slip, rail=Rail.WET)
        needed = wet_end.friction_needed * point.brake_torque / wet_end.torque
        # lambda' = 0 there: the wheel slows down by 1 - lambda of what is taken, on a share of 9 % (J/(M r^2)), and
        # the viscous torque of 3 N*m is counted, 0.4 % of the torque
        assert needed == pytest.approx(point.adhesion_coefficient, rel=0.05 * 0.09 + 4e-3)
    assert wet_end.friction_there == peak(law, speed, PARK2008.wheel_load).coefficient
    assert wet_end.torque_there / wet_end.torque == pytest.approx(wet_end.friction_there / wet_end.friction_needed)


def test_a_design_that_hands_over_is_told_where_it_is_the_best(record):
    """Handed over before the speeds at which the wheel is lost, it may begin with the torque of a dry rail."""
    name = "PI-lead, full range, started for dry rail, handed over at 20 km/h"
    runs = {stop.scenario.rail: {one.name: one for one in stop.runs} for stop in record.stops[:2]}
    assert runs[Rail.WET]["PI-lead, full range"].locks
    assert not any(of_rail[name].locks for of_rail in runs.values())
    told = [f"{of_rail[name].run.braking_distance:.3g} m on {rail} rail" for rail, of_rail in runs.items()]
    assert f"The shortest that locks on neither rail is “{name}”: {told[0]} and {told[1]}." in verdict(record).paragraph
    # the shortest on dry rail, but it locks the wheel on wet rail
    first = record.stops[0]
    assert first.shortest_unlocked.run.braking_distance < first.run_of(name).braking_distance


# --- an adhesion law of one's own -----------------------------------------------------------------------------------

OWN = Beam(mu_max=0.21, a=0.006, Kx=2.0e5, reference=ReferenceSlip(dry=0.13, wet=0.07))
"""Not the published beam, whose name it has."""


def own_points(rails=tuple(Rail)):
    return [
        operating_point(OWN.on(rail), PARK2008, V100, OWN.reference_slip(rail), rail=rail, initial_speed_kmh=100.0)
        for rail in rails
    ]


def test_a_law_is_the_user_s_own_by_its_parameters_not_by_its_name():
    published = published_law("beam", Rail.WET)
    point = operating_point(published, PARK2008, V100, 0.059, rail=Rail.WET, initial_speed_kmh=100.0)
    assert not is_own(point)
    assert [is_own(point) for point in own_points()] == [True, True]
    assert [(held.law, held.slip, held.tuned) for held in held_laws(own_points())] == [
        (OWN, 0.13, True),
        (OWN.wet(), 0.07, True),
    ]


def test_runs_of_a_report_are_with_the_user_s_law():
    for stop, rail in zip(stops(own_points(), None)[:2], Rail, strict=True):
        assert stop.scenario.adhesion.on(rail) == OWN.on(rail)
        assert stop.scenario.rail is rail
        assert all(end.law == "beam" for end in stop.slow)
        names = design_names(PARK2008)
        ran = {one.name for one in stop.runs if one.run is not None}
        assert {names.full_range, names.least_ms, "published PI", "published ASMC", "slide protection"} <= ran
        # begun with what its own wet rail takes, not the published one
        begun = stop.run_of(names.full_range).controller.initial_torque
        wet = peak(OWN.wet(), V100, PARK2008.wheel_load).coefficient * PARK2008.wheel_load * PARK2008.wheel.radius
        assert 0.6 * wet < begun < 0.8 * wet  # the share of the published wet peak, over all speeds
        assert begun < initial_torque(PARK2008)


def test_the_full_range_design_is_tuned_for_the_user_s_law():
    points = own_points()
    plants = [linearize(point) for point in points]
    design = full_range(PARK2008, points)
    assert "the law beam of this report" in design.how
    assert design.controller.gains != TAKEN.design.gains
    speeds = speed_range(design.name, design.controller, plants)
    assert {line.law for line in speeds.lines} == {"beam"}
    # tuned to it at 20, 60 and 100 km/h; between them it is passed by little
    assert speeds.worst_ms(20.0, 100.0) == pytest.approx(2.0, rel=0.02)


@pytest.mark.parametrize("name", ["beam", "curve", "bristle", "polach", "burckhardt"])
def test_a_law_at_another_wheel_load_keeps_its_adhesion_coefficients(name):
    """Of the laws of [Park2008] the published sets at that load say the same."""
    law, load = published_law(name, Rail.DRY), PARK2008.wheel_load
    heavier = law.at_wheel_load(1.5)
    if name in ("beam", "curve", "bristle"):
        expected = published_law(name, Rail.DRY, wheel_load=1.5 * load)
        np.testing.assert_allclose(heavier.parameters(), expected.parameters(), rtol=1e-14)  # rounding
    if name != "polach":  # whose contact ellipse stays as it is
        slip = np.array([0.01, 0.1, 0.3])
        mu = adhesion_coefficient(law, V100, slip, load)
        np.testing.assert_allclose(adhesion_coefficient(heavier, V100, slip, 1.5 * load), mu, rtol=1e-12)


def test_a_design_tuned_to_the_limit_is_robust():
    """At 100 km/h, which is among its speeds, its Ms is 2 and some rounding."""
    assert is_robust(2.0 * (1.0 + 1e-12))
    assert not is_robust(2.001)
