"""Tuning rules against their sources' tables, and refused where they do not hold."""

from __future__ import annotations

import math

import numpy as np
import pytest
from test_assessment import plant as wheel

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.design import actuated_plant
from railslip_ctrl.design.tuning import Kind, first_order_model, rotstein_lewin, simc_pi
from railslip_ctrl.loop import DeadTimeLoop, Rational
from railslip_ctrl.model.vehicle import PARK2008, Rail

TAU = PARK2008.actuator.dead_time


def lags(*times, gain=1.0, leads=(), integrators=0):
    """gain prod(lead s + 1)/(s^integrators prod(time s + 1))."""
    zeros, poles = [-1 / t for t in leads], [-1 / t for t in times] + [0.0] * integrators
    return Rational(np.array(zeros), np.array(poles), gain * np.prod(leads) / np.prod(times))


@pytest.mark.parametrize(
    ("plant", "theta", "time_constant", "kp", "integral_time"),
    [
        # [Skogestad2003], examples E1, E2, E4, E5, E7, E8 as PI
        (lags(1.0, 0.2), 0.1, 1.1, 5.5, 0.8),
        (lags(2.0, 1.0, 0.4, 0.2, 0.05, 0.05, 0.05, leads=(-0.3, 0.08)), 1.47, 2.5, 0.85, 2.5),
        (lags(1.0, 1.0, 1.0, 1.0), 2.5, 1.5, 0.3, 1.5),
        (lags(1.0, 0.2, 0.04, 0.008), 0.148, 1.1, 3.72, 1.1),
        (lags(1.0, 1.0, 1.0, leads=(-2.0,)), 3.5, 1.5, 0.214, 1.5),
        (lags(1.0, 1.0, integrators=1), 1.5, math.inf, 0.33, 12.0),
    ],
)
def test_simc_table_of_examples(plant, theta, time_constant, kp, integral_time):
    tuning = simc_pi(plant, 0.0)
    assert tuning.model.dead_time == pytest.approx(theta, rel=1e-12)
    assert tuning.model.time_constant == pytest.approx(time_constant, rel=1e-12)
    assert tuning.gains.kp == pytest.approx(kp, abs=0.0051)
    assert tuning.gains.kp / tuning.gains.ki == pytest.approx(integral_time, rel=1e-12)
    assert tuning.closed_loop_time == tuning.model.dead_time


def test_simc_tight_first_order_loop_has_the_margins_its_author_gives():
    # [Skogestad2003]: k exp(-theta s)/(T s + 1), T <= 8 theta, tau_c = theta: GM 3.14, PM 61.4 deg, Ms 1.59
    tuning = simc_pi(lags(4.0, gain=2.0), 1.0)
    m = DeadTimeLoop(tuning.transfer_function() * tuning.model.transfer_function, 1.0).margins()
    assert m.gain_increase == pytest.approx(3.14, abs=0.005)
    assert m.phase_deg == pytest.approx(61.4, abs=0.05)
    assert m.ms == pytest.approx(1.59, abs=0.005)


def test_rotstein_lewin_without_dead_time_places_the_closed_loop_exactly():
    k, t, lam = 3.0, 1.25, 0.7
    plant = Rational(np.array([]), np.array([1 / t]), k / t)
    tuning = rotstein_lewin(plant, 0.0, closed_loop_time=lam)
    alpha = lam * (lam / t + 2)
    loop = DeadTimeLoop(tuning.transfer_function() * plant)
    s = np.array([0.3, 1.0, 4.0])
    expected = (alpha * 1j * s + 1) / (lam * 1j * s + 1) ** 2
    assert loop.complementary_sensitivity(s) == pytest.approx(expected, rel=1e-12)
    assert tuning.gains.kp == pytest.approx((2 * t + lam) / (k * lam), rel=1e-13)


def test_rotstein_lewin_pid_is_the_pi_in_series_with_half_the_dead_time():
    plant, theta, lam = Rational(np.array([]), np.array([0.5]), 0.5 * 4), 0.4, 1.2
    pi, pid = (rotstein_lewin(plant, theta, closed_loop_time=lam, derivative=d) for d in (False, True))
    s = 1j * np.array([0.2, 1.0, 3.0])
    ideal = pid.gains.kp + pid.gains.ki / s + pid.derivative_gain * s
    assert ideal == pytest.approx(pi.transfer_function()(s) * (theta / 2 * s + 1), rel=1e-12)
    filtered = pid.transfer_function(0.01)(s)
    expected = pid.gains.kp + pid.gains.ki / s + pid.derivative_gain * s / (0.01 * s + 1)
    assert filtered == pytest.approx(expected, rel=1e-12)
    assert pi.derivative_gain == 0


def test_the_wheel_is_reduced_to_an_unstable_lag_and_the_rule_closes_the_full_loop():
    plant = actuated_plant(wheel(Rail.DRY), PARK2008.actuator)
    model = first_order_model(plant, TAU)
    assert model.kind is Kind.UNSTABLE
    assert model.time_constant == pytest.approx(1 / 0.82083763, rel=1e-8)
    assert model.dead_time == pytest.approx(0.15 + 0.6 + 1 / 8.63596062 - 1 / 7.81098049, rel=1e-8)
    s = 1e-3j  # the reduction keeps the slope of ln G at 0: value, phase slope and unstable pole
    assert model.transfer_function(s) * np.exp(-model.dead_time * s) == pytest.approx(
        plant(s) * np.exp(-TAU * s), rel=1e-6
    )
    with pytest.raises(InputError, match=r"SIMC: the plant has an unstable pole at 0\.8208"):
        simc_pi(plant, TAU)
    pi = rotstein_lewin(plant, TAU, closed_loop_time=5.0)
    assert DeadTimeLoop(pi.transfer_function() * plant, TAU).margins().ms == pytest.approx(5.865, abs=5e-4)
    pid = rotstein_lewin(plant, TAU, closed_loop_time=2.0, derivative=True)
    assert DeadTimeLoop(pid.transfer_function(0.06) * plant, TAU).margins().ms == pytest.approx(1.974, abs=5e-4)


def test_models_reproduce_a_stable_and_an_integrating_plant_at_low_frequency():
    for plant in (lags(3.0, gain=2.0), lags(integrators=1, gain=0.5)):
        model = first_order_model(plant, 0.2)
        assert model.transfer_function(0.7j) == pytest.approx(plant(0.7j), rel=1e-13)
        assert model.dead_time == 0.2


@pytest.mark.parametrize(
    ("rule", "match"),
    [
        (lambda: simc_pi(lags(1.0), 0.0), "give closed_loop_time"),
        (lambda: simc_pi(lags(1.0), 0.1, closed_loop_time=-0.1), "closed-loop time"),
        (lambda: simc_pi(lags(1.0), -0.1), "dead time"),
        (lambda: simc_pi(Rational(np.array([]), np.array([]), 1.0), 0.1), "must have poles"),
        (lambda: simc_pi(Rational(np.array([]), np.array([-1 + 2j, -1 - 2j]), 1.0), 0.1), "roots real"),
        (lambda: simc_pi(lags(integrators=2), 0.1), "several poles"),
        (lambda: simc_pi(lags(1.0, 0.1, leads=(0.5,)), 0.1), "slower than the effective dead time"),
        (lambda: simc_pi(lags(5.0, 0.2, 0.2, leads=(0.2, 0.2)), 0.05), "zeros leave a dead time"),
        (lambda: rotstein_lewin(lags(1.0), 0.1, closed_loop_time=1.0), "the plant is stable"),
        (lambda: rotstein_lewin(lags(-1.0), 0.1, closed_loop_time=0.0), "closed-loop time"),
        (lambda: rotstein_lewin(lags(-1.0), 1.0, closed_loop_time=1.0), "that a PI can stabilise"),
        (lambda: rotstein_lewin(lags(-1.0), 2.0, closed_loop_time=1.0, derivative=True), "that a PID can stabilise"),
        (
            lambda: rotstein_lewin(lags(-1.0), 0.2, closed_loop_time=1.0, derivative=True).transfer_function(),
            "derivative filter",
        ),
    ],
)
def test_refused_where_it_does_not_apply(rule, match):
    with pytest.raises(InputError, match=match):
        rule()
