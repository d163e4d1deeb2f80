"""Which controller is taken for an envelope: the criterion, against a grid of gains, and what it tells."""

from __future__ import annotations

import math

import numpy as np
import pytest
from sample_vehicles import COACH

from railslip_ctrl.design import PIController, wheel_slip_loop
from railslip_ctrl.design.envelope import Envelope
from railslip_ctrl.design.envelope_tuning import REACH_SHARE, Choice, operating_plants, select
from railslip_ctrl.design.judging import judge
from railslip_ctrl.model.vehicle import PARK2008, Actuator, PIGains

SMALL = Envelope(speeds=(20, 40, 100), rails="dry", laws="curve", loads="empty", radius=1.0)


@pytest.fixture(scope="module")
def selection():
    return select(SMALL)


def choice(selection, structure, factor) -> Choice:
    (found,) = (c for c in selection.choices if (c.structure, c.reference_factor) == (structure, factor))
    return found


def test_the_best_is_robust_at_a_smaller_slip_and_its_judgement_is_that_of_judge(selection):
    best = selection.best
    assert (best.structure, best.reference_factor) == ("pi", 0.75)
    assert best.design.reference.dry == pytest.approx(0.099)
    again = judge(best.design, SMALL)  # at the design's own reference
    assert again.verdict == best.design.judgement.verdict == "robust"
    assert again.ms == pytest.approx(best.design.judgement.ms, rel=1e-12)
    assert again.worst.point.slip == best.design.reference.dry
    assert [c.rank for c in selection.choices] == sorted(c.rank for c in selection.choices)
    assert len(selection.choices) == 6
    assert str(selection).startswith("PI, 0.75 of the reference slip: robust: Ms")


@pytest.mark.parametrize(("envelope", "factor"), [(SMALL, 1.0), (SMALL, 0.75), (Envelope(speeds=40.0), 1.0)])
def test_no_gains_of_a_grid_do_more_than_those_chosen(selection, envelope, factor):
    """None is robust from a lower speed, or from the same one with a larger ki."""
    selected = selection if envelope is SMALL else select(envelope, ["pi-lead"], [factor])
    found = choice(selected, "pi-lead", factor)
    mine, gains = found.design.judgement.robust_from_kmh, found.design.gains
    assert mine is not None
    for kp in gains.kp * np.geomspace(0.2, 5.0, 9):
        for ki in gains.ki * np.array([0.1, 1.0, 1.2]):  # the search ends at 1.05, its gains are 1.1 apart
            other = PIController(PIGains(kp=kp, ki=ki), found.design.lead, found.design.lead_filter)
            judged = judge(other, envelope.at(reference=found.design.reference))
            robust = math.inf if judged.robust_from_kmh is None else judged.robust_from_kmh
            assert robust > mine if ki > gains.ki else robust >= mine


def test_where_none_is_robust_the_least_ms_is_given_up_by_a_twentieth_for_ki(monkeypatch):
    monkeypatch.setattr("railslip_ctrl.design.envelope_tuning._INTEGRAL_TIMES", 64.0 * 2.0 ** -np.arange(0, 2, 0.25))
    brake = Actuator(dead_time=0.15, lag=0.3)
    envelope = SMALL.at(vehicle=PARK2008.model_copy(update={"actuator": brake}), speeds=100.0, laws="bristle")
    (found,) = select(envelope, ["pi"], [1.0]).choices
    gains, (plant,) = found.design.gains, operating_plants(envelope.points(nominal=True))

    def least(time):
        loops = [wheel_slip_loop(plant, PIController(PIGains(kp=kp, ki=kp / time))) for kp in range(180, 260, 4)]
        return min(loop.margins().ms for loop in loops)

    slowest = least(64 * 0.45)
    assert slowest > 2.0
    # grids of kp: 1 % of the interval here, 5 % there
    assert 0.99 * least(gains.kp / gains.ki) <= found.design.judgement.worst.ms <= 1.055 * slowest
    assert least(gains.kp / gains.ki / 2**0.25) > 1.045 * slowest


def test_without_dead_time_and_lag_any_gain_holds_a_stable_wheel():
    prompt = PARK2008.model_copy(update={"actuator": Actuator(dead_time=0.0, lag=0.0)})
    below_the_peak = SMALL.at(vehicle=prompt, speeds=20.0, slip=1.0, reference={"dry": 0.1, "wet": 0.1})
    assert select(below_the_peak).best.design.judgement.verdict == "robust"


def test_the_time_to_the_reference_is_that_of_the_integral(selection):
    found = choice(selection, "pi-lead", 1.0)
    points = [plant.point for plant in found.design.judgement.points.plants if plant.point.slip == 0.132]
    start = 0.8 * min(point.brake_torque for point in points)
    times = []
    for point in (p for p in points if p.speed_kmh > 99):
        # counted in steps of a millisecond, error and gains held
        error, torque, time = point.slip * point.speed, start + found.design.gains.kp * point.slip * point.speed, 0.0
        while torque < point.brake_torque:
            torque, time = torque + 1e-3 * found.design.gains.ki * error, time + 1e-3
        times.append((time, PARK2008.mass * (100 / 3.6) / point.adhesion_force))
    assert found.reach_s == pytest.approx(max(time for time, _ in times), abs=2e-3)
    assert found.stop_s in [pytest.approx(stop, rel=1e-12) for _, stop in times]
    assert found.reaches == (found.reach_s <= REACH_SHARE * found.stop_s)
    assert ("its reference takes" in found.words) != found.reaches


def test_a_smaller_slip_tells_what_it_costs(selection):
    own, less = choice(selection, "pi-lead", 1.0), choice(selection, "pi-lead", 0.5)
    assert own.adhesion_share == 1.0
    assert 0.6 < less.adhesion_share < 1.0
    assert f"adhesion {100 * (less.adhesion_share - 1):+.2g} %" in less.words


def test_where_nothing_holds_there_is_no_best_and_without_lag_no_lead():
    late = COACH.model_copy(update={"actuator": Actuator(dead_time=1.5, lag=0.0)})
    found = select(SMALL.at(vehicle=late, speeds=(20.0,), laws="bristle"))
    assert found.best is None
    assert {c.structure for c in found.choices} == {"pi"}
    assert "no gains found that hold every loop" in str(found)
