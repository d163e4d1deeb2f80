"""The wheel-slip loop: oracles, assessment, the computed holding gains, and the shaping scripts' functions."""

from __future__ import annotations

import math
from dataclasses import replace

import control as ct
import numpy as np
import pytest

from railslip_ctrl.core.errors import InfeasibleDesignError, InputError
from railslip_ctrl.design import (
    PIController,
    actuated_plant,
    common_pi,
    gain_for_crossover,
    most_phase,
    wheel_slip_loop,
)
from railslip_ctrl.design.assessment import Verdict, assess
from railslip_ctrl.loop import DeadTimeLoop
from railslip_ctrl.model.adhesion import published_law
from railslip_ctrl.model.linearization import linearize, operating_point
from railslip_ctrl.model.vehicle import PARK2008, TABLE4_PI, Actuator, PIGains, Rail

SPEED = 100 / 3.6


def plant(rail=Rail.DRY, *, vehicle=PARK2008, speed=SPEED, speed_state=False):
    law = published_law("bristle", rail)
    point = operating_point(law, vehicle, speed, law.reference_slip(rail), rail=rail)
    return linearize(point, speed_state=speed_state)


def pi(kp, ki):
    return PIController(PIGains(kp=kp, ki=ki))


def test_oracles_md_the_wheel_slip_loop_in_si():
    a = assess(plant(), pi(190.0, 5.0), PARK2008.actuator)
    m = a.margins
    assert a.stable
    assert a.plant.poles == pytest.approx([0.82083763, -8.63596062], abs=5.1e-9)
    assert a.point.brake_torque == pytest.approx(4787.78, abs=0.0051)
    assert m.gain_increase == pytest.approx(2.89166823, abs=5.1e-9)
    assert m.gain_decrease == pytest.approx(0.70170425, abs=5.1e-9)
    assert (m.phase_deg, m.phase_frequency) == pytest.approx((10.2839822, 0.75683443), abs=5.1e-8)
    assert m.delay_s == pytest.approx(0.23715801, abs=5.1e-9)
    assert (m.ms, m.mt) == pytest.approx((5.579, 5.681), abs=5.1e-4)
    assert a.verdict_line == "stable but fragile (Ms 5.58)"


@pytest.mark.parametrize(("column", "slip", "phase"), [("bristle", 0.132, 6), ("beam", 0.119, 15)])
def test_published_md_gains_only_just_stable_as_published_and_unstable_in_si(column, slip, phase):
    law = published_law("bristle", Rail.DRY)
    controller = PIController(TABLE4_PI[column])
    for scale, stable in ((3.6, True), (1.0, False)):
        vehicle = PARK2008.model_copy(update={"inertia_scale": scale})
        a = assess(linearize(operating_point(law, vehicle, SPEED, slip)), controller, vehicle.actuator)
        assert a.stable is stable
        if stable:
            assert a.margins.phase_deg == pytest.approx(phase, abs=0.5)  # printed without decimals
        else:
            assert a.verdict is Verdict.UNSTABLE
            assert "times this loop gain would stabilise it" in a.verdict_line


def test_loop_equals_python_control_series_connection():
    p = plant()
    loop = wheel_slip_loop(p, PIController(PIGains(kp=190.0, ki=5.0), lead=0.6, lead_filter=0.06), PARK2008.actuator)
    s = ct.tf("s")
    expected = (190 + 5 / s) * (0.6 * s + 1) / (0.06 * s + 1) / (0.6 * s + 1) * ct.tf(p.to_control()[0, 0])
    omega = np.geomspace(1e-2, 1e2, 40)
    assert loop(1j * omega) == pytest.approx(
        expected(1j * omega) * np.exp(-0.15j * omega), rel=1e-9
    )  # python-control goes through polynomials


def test_speed_as_a_state_changes_the_fast_margins_little():
    frozen = assess(plant(), pi(190.0, 5.0), PARK2008.actuator).loop
    moving = wheel_slip_loop(plant(speed_state=True), pi(190.0, 5.0), PARK2008.actuator)
    omega = np.geomspace(0.5, 10, 9)
    # the speed's own mode lies near 0.01 1/s: its share at 0.5 rad/s is 0.01/0.5
    assert moving(1j * omega) == pytest.approx(frozen(1j * omega), rel=0.02)


def test_limits_are_those_of_the_pole_and_the_dead_time():
    limits = assess(plant(), pi(190.0, 5.0), PARK2008.actuator).limits
    p = 0.82083763
    assert limits.actuator_product == pytest.approx(p * 0.75, rel=1e-7)
    assert limits.mt_bound == pytest.approx(math.exp(p * 0.15), rel=1e-7)
    # the bound is one: no loop of the family gets below it
    for kp in (150.0, 200.0, 400.0):
        assert assess(plant(), pi(kp, 1.0), PARK2008.actuator).margins.mt > limits.mt_bound


def test_common_pi_are_a_minimum_and_inside_their_range():
    plants = [plant(rail) for rail in Rail]
    design = common_pi(plants, PARK2008.actuator)
    kp = design.controller.gains.kp
    assert design.gain_range[0] < kp < design.gain_range[1]

    def worst(factor):
        g = design.controller.gains
        return max(assess(p, pi(g.kp * factor, g.ki * factor), PARK2008.actuator).margins.ms for p in plants)

    assert worst(1.0) == pytest.approx(design.worst_ms, rel=1e-12)
    assert worst(0.99) > design.worst_ms < worst(1.01)
    assert design.integral_time == pytest.approx(50 * (PARK2008.actuator.dead_time + PARK2008.actuator.lag))


def test_without_dead_time_and_lag_least_ms_is_that_of_ever_larger_gains():
    unstable = plant()
    pole_at_0 = replace(unstable, A=unstable.A - unstable.poles.real.max() * np.eye(2))
    for one in (unstable, pole_at_0):
        design = common_pi([one], Actuator(dead_time=0.0, lag=0.0))
        assert (design.integral_time, design.gain_range[1]) == (1.0, math.inf)
        assert design.worst_ms < 1.001


def test_common_pi_refuse_what_no_pi_holds():
    slow = Actuator(dead_time=0.5, lag=2.0)
    with pytest.raises(InfeasibleDesignError, match=r"stabilising kp: dry 100 km/h: none .*2\.05"):
        common_pi([plant()], slow)
    with pytest.raises(InfeasibleDesignError, match=r"no single PI .*133\.4 to 549\.1 .*1\.334 to 5\.491"):
        common_pi([plant(), replace(plant(), B=100 * plant().B)], PARK2008.actuator)
    with pytest.raises(InputError, match="no operating point"):
        common_pi([], slow)


def test_no_gain_at_all_is_no_design_of_least_ms():
    """Below the adhesion peak the wheel is stable: the less gain, the nearer Ms is to 1, which says nothing."""
    law = published_law("beam", Rail.DRY)
    stable = linearize(operating_point(law, PARK2008, SPEED, 0.05))
    assert stable.poles.real.max() < 0
    with pytest.raises(InfeasibleDesignError, match=r"stable by itself at every operating point.*zero gain"):
        common_pi([stable, stable], PARK2008.actuator)
    assert common_pi([stable, plant()], PARK2008.actuator).controller.gains.kp > 1.0  # one needs to be held
    idle = assess(stable, pi(0.0, 0.0), PARK2008.actuator)
    assert (idle.stable, idle.margins.ms) == (True, 1.0)
    assert idle.verdict is Verdict.NO_FEEDBACK
    assert "this is no controller" in idle.verdict_line
    assert assess(stable, pi(10.0, 100.0), PARK2008.actuator).verdict is Verdict.ROBUST


def test_loop_shaping_puts_the_crossover_where_the_phase_is_largest():
    loop = DeadTimeLoop(actuated_plant(plant(), PARK2008.actuator), PARK2008.actuator.dead_time)
    omega, phase = most_phase(loop)
    nearby = loop.phase(omega * np.array([0.999, 1.001]))
    assert np.all(nearby < phase)
    k = gain_for_crossover(loop, omega)
    shaped = loop.scaled(k)
    assert abs(shaped(1j * omega)) == pytest.approx(1.0, abs=1e-12)
    assert shaped.margins().phase_deg == pytest.approx(180 + math.degrees(phase), rel=1e-9)
    with pytest.raises(InputError, match="no maximum"):
        most_phase(DeadTimeLoop(ct.tf([1], [1, 0]), 0.1))
    with pytest.raises(InputError, match="crossover: 0"):
        gain_for_crossover(loop, 0.0)


@pytest.mark.parametrize(
    ("lead", "lead_filter", "match"),
    [(-1, 0, "lead: -1"), (0.6, 0.0, "not proper"), (0.6, float("nan"), "lead filter")],
)
def test_controller_refuses_what_is_not_proper(lead, lead_filter, match):
    with pytest.raises(InputError, match=match):
        PIController(PIGains(kp=1.0, ki=1.0), lead, lead_filter)
    with pytest.raises(InputError, match="gains"):
        PIController((1.0, 1.0))


def test_controller_without_one_of_its_gains():
    assert PIController(PIGains(kp=2.0, ki=0.0)).transfer_function.poles.size == 0
    assert PIController(PIGains(kp=0.0, ki=3.0)).transfer_function(2j) == pytest.approx(3 / 2j)
