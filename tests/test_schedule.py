"""Margins along one axis, gain schedules, lowest speed."""

from __future__ import annotations

import pytest

from railslip_ctrl.core.errors import InfeasibleDesignError, InputError
from railslip_ctrl.design import PIController, wheel_slip_loop
from railslip_ctrl.design.schedule import (
    GainSchedule,
    lowest_held_speed,
    lowest_stabilisable_speed,
    plant_at,
    schedule_gains,
    sweep_slip,
    sweep_speed,
)
from railslip_ctrl.model.adhesion import published_law
from railslip_ctrl.model.linearization import linearize, operating_point
from railslip_ctrl.model.vehicle import PARK2008, Actuator, PIGains, Rail

PI_LEAD = PIController(PIGains(kp=229.4, ki=5.0), lead=0.6, lead_filter=0.06)


def test_sweeps_have_the_margins_of_each_loop_and_the_pole_of_each_plant():
    scheduled = {"fixed": PI_LEAD, "scheduled": lambda x: PIController(PIGains(kp=200.0 + x, ki=5.0), 0.6, 0.06)}
    speed = sweep_speed(scheduled, (50.0, 100.0), law="bristle", rail=Rail.WET)
    slip = sweep_slip({"fixed": PI_LEAD}, (0.092, 0.2), law="bristle", rail=Rail.WET, speed_kmh=50.0)
    assert (speed.margins["fixed"].ms[0], speed.pole[0]) == pytest.approx((slip.margins["fixed"].ms[0], slip.pole[0]))
    for axis, v, slips in ((speed, (50.0, 100.0), (0.092, 0.092)), (slip, (50.0, 50.0), (0.092, 0.2))):
        for i, value in enumerate(axis.values):
            plant = linearize(operating_point(published_law("bristle", Rail.WET), PARK2008, v[i] / 3.6, slips[i]))
            assert axis.pole[i] == pytest.approx(plant.poles[0].real, rel=1e-12)
            for name, margins in axis.margins.items():
                controller = PI_LEAD if name == "fixed" else scheduled[name](value)
                loop = wheel_slip_loop(plant, controller, PARK2008.actuator)
                assert margins.ms[i] == pytest.approx(loop.margins().ms, rel=1e-7)
    for controllers, speeds in (({}, (50.0,)), (scheduled, ())):
        with pytest.raises(InputError, match="at least one value and one controller"):
            sweep_speed(controllers, speeds)


@pytest.fixture(scope="module")
def schedule():
    return schedule_gains((40.0, 100.0), rails=(Rail.DRY,), ms_max=1.8, lead=0.6, lead_filter=0.06)


def test_schedule_keeps_its_bound_at_the_entries_and_between(schedule):
    for speed in (40.0, 70.0, 100.0):
        controller = schedule.controller(speed / 3.6, Rail.DRY)
        for vehicle in (PARK2008, PARK2008.loaded()):
            loop = wheel_slip_loop(plant_at("bristle", vehicle, Rail.DRY, speed), controller, PARK2008.actuator)
            # exactly at the entries; half-way between 40 and 100 km/h linear gains cost a few per cent
            assert loop.margins().ms <= (1.8 * (1 + 1e-9) if speed != 70.0 else 1.05 * 1.8)


def test_schedule_interpolates_holds_its_ends_and_round_trips(schedule):
    first, last = (e.gains.kp for e in schedule.entries)
    assert schedule.controller(70 / 3.6, Rail.DRY).gains.kp == pytest.approx((first + last) / 2)
    assert schedule.controller(1.0, Rail.DRY).gains.kp == first
    assert schedule.controller(50.0, Rail.DRY).gains.kp == last
    assert GainSchedule.from_json(schedule.to_json()) == schedule


@pytest.mark.parametrize(
    "text", ["", "{}", "[]", '{"entries": 3}', '{"lead_s":0,"lead_filter_s":0,"lowest_speed_kmh":1,"entries":[]}']
)
def test_schedule_refuses_what_it_did_not_write(text):
    with pytest.raises(InputError, match="gain schedule"):
        GainSchedule.from_json(text)


def test_schedule_checks_speed_and_rail(schedule):
    with pytest.raises(InputError, match="speed"):
        schedule.controller(0.0, Rail.DRY)
    with pytest.raises(InputError, match="no entries for wet"):
        schedule.controller(10.0, Rail.WET)


def test_schedule_names_the_entry_that_cannot_be_met():
    with pytest.raises(InfeasibleDesignError, match="dry rail, 100 km/h: specification cannot be met"):
        schedule_gains((100.0,), rails=(Rail.DRY,), ms_max=2.0)


@pytest.mark.parametrize(("lead", "expected"), [({}, 14.314), ({"lead": 0.6, "lead_filter": 0.06}, 4.0169)])
def test_lowest_speed_at_which_a_pi_can_hold_the_falling_curve(lead, expected):
    # the curve is a function of slip: dF/dsigma, and with it the unstable pole, grows as 1/v
    def plant(v):
        return plant_at("curve", PARK2008, Rail.DRY, v)

    lowest = lowest_stabilisable_speed(plant, PARK2008.actuator, **lead)
    assert lowest == pytest.approx(expected, rel=1e-4)
    if not lead:
        # p (dead time + lag) = 1 there: the condition for a PI, exact for one pole alone
        p = plant(lowest).poles.real.max()
        assert p * 0.75 == pytest.approx(1.0, abs=0.01)


def test_lowest_speed_of_a_given_controller():
    def plant(v):
        return plant_at("curve", PARK2008, Rail.DRY, v)

    lowest = lowest_held_speed(plant, PI_LEAD, PARK2008.actuator)
    assert wheel_slip_loop(plant(lowest), PI_LEAD, PARK2008.actuator).is_stable()
    assert not wheel_slip_loop(plant(lowest - 1e-3), PI_LEAD, PARK2008.actuator).is_stable()
    fussy = lowest_held_speed(plant, PI_LEAD, PARK2008.actuator, ms_max=1.8)
    assert fussy > lowest
    with pytest.raises(InfeasibleDesignError, match="does not hold the loop at 100"):
        lowest_held_speed(plant, PIController(PIGains(kp=1e6, ki=1.0)), PARK2008.actuator)
    assert lowest_held_speed(plant, PI_LEAD, Actuator(dead_time=0.0, lag=0.0), low_kmh=60.0) == 60.0


@pytest.mark.parametrize(
    "change",
    [
        ('"speed_kmh": 40.0', '"speed_kmh": NaN'),
        ('"speed_kmh": 40.0', '"speed_kmh": -40.0'),
        ('"speed_kmh": 40.0', '"speed_kmh": 100.0'),
        ('"lead_s": 0.6', '"lead_s": -3'),
        ('"kp_si": 3', '"kp_si": "3'),
        ('"worst_ms": 1.', '"worst_ms": 0.'),
        ('"lowest_speed_kmh": ', '"lowest_speed_kmh": -1'),
    ],
)
def test_schedule_refuses_nonsense_in_one_line(schedule, change):
    text = schedule.to_json()
    assert change[0] in text
    with pytest.raises(InputError, match=r"gain schedule|lead") as caught:
        GainSchedule.from_json(text.replace(*change))
    assert "\n" not in str(caught.value)
    assert "http" not in str(caught.value)


def test_schedule_s_lowest_speed_is_its_own_and_the_gains_between_are_checked():
    made = schedule_gains((60.0, 100.0), law="curve", rails=(Rail.DRY,), ms_max=1.8, lead=0.6, lead_filter=0.06)
    for offset, stable in ((1e-3, True), (-1e-3, False)):
        speed = made.lowest_speed_kmh + offset
        controller = made.controller(speed / 3.6, Rail.DRY)
        loops = [
            wheel_slip_loop(plant_at("curve", vehicle, Rail.DRY, speed), controller, PARK2008.actuator)
            for vehicle in (PARK2008, PARK2008.loaded())
        ]
        assert all(loop.is_stable() for loop in loops) is stable
    assert made.worst_ms == pytest.approx(1.8, rel=0.05)
    with pytest.raises(InputError, match="no entries"):
        schedule_gains((), ms_max=1.8)
