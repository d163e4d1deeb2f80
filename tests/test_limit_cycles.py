"""Limit cycles of the relay behind the actuator: describing function, linearised, nonlinear, simulated."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from sliding_cases import ACTUATOR, effect_on

from railslip_ctrl.core.errors import DomainError
from railslip_ctrl.model.parameters import PARK2008, Actuator, Rail
from railslip_ctrl.verification.actuator_effects import actuator_effect, cycle_table, published_loop
from railslip_ctrl.verification.fine_simulation import PublishedLaw, measure_oscillation, simulate
from railslip_ctrl.verification.limit_cycles import (
    LINEAR_CHANGE,
    law_runs,
    layer_describing_function,
    linear_limit_cycle,
    linearisation_change,
    nonlinear_limit_cycle,
    predict_layer_cycle,
    predict_limit_cycle,
    simulated_limit_cycle,
    smallest_layer,
    tsypkin_locus,
)
from railslip_ctrl.verification.relay_loop import FeedForward, SlidingGains

# --- limit cycles ----------------------------------------------------------------------------------------------------

CYCLES = [(Rail.DRY, 3.6, K) for K in (70.0, 400.0)] + [(Rail.WET, 1.0, K) for K in (30.0, 70.0, 200.0)]
CYCLES += [(Rail.WET, 3.6, 70.0), *((Rail.DRY, 1.0, K) for K in (30.0, 40.0, 70.0, 90.0))]
AMPLITUDES = ("surface_amplitude", "sigma_amplitude", "torque_amplitude")


@pytest.mark.parametrize(("rail", "scale", "K"), CYCLES)
def test_limit_cycle_against_the_nonlinear_wheel(rail, scale, K):
    loop = published_loop(rail, inertia_scale=scale)
    actual, linear = nonlinear_limit_cycle(loop, K=K), linear_limit_cycle(loop, K=K, load=loop.load)
    predicted = predict_limit_cycle(loop, K=K, load=loop.load)
    measured = _simulated(loop, K, actual.sigma_amplitude)
    # of the same wheel: what is left is 2 ms of the switches and, at K = 30, 2 % of a transient that dies out slowly
    assert actual.period == pytest.approx(measured.period, rel=0.005)
    for name in (*AMPLITUDES, "surface_mean"):
        assert getattr(actual, name) == pytest.approx(getattr(measured, name), rel=0.03), name
    # the linearised cycles are within 10 % wherever their own criterion says so
    assert predicted.period == pytest.approx(measured.period, rel=0.05)
    if linearisation_change(loop, linear) <= LINEAR_CHANGE:
        for name in AMPLITUDES:
            assert getattr(linear, name) == pytest.approx(getattr(measured, name), rel=0.1), name
            if 2 * loop.load < K:  # the describing function: where the relay does more than carry the load
                assert getattr(predicted, name) == pytest.approx(getattr(measured, name), rel=0.1), name


def _simulated(loop, K, amplitude):
    """The measured cycle of the fine nonlinear simulation, 30 s after 50 s for the transient."""
    law = PublishedLaw(loop.plant.point, replace(loop.gains, K=K, k=0.0), feed_forward=loop.feed_forward)
    run = simulate(loop.plant.point, law, ACTUATOR, duration=80.0, step=2e-3, offset=0.5 * amplitude)
    return measure_oscillation(run.after(50.0))


def test_linearised_cycle_is_marked_where_it_is_wrong():
    loop = published_loop(Rail.DRY)
    change, error = {}, {}
    for K in (22.5, 30.0, 55.0, 70.0):
        linear, actual = linear_limit_cycle(loop, K=K, load=loop.load), nonlinear_limit_cycle(loop, K=K)
        change[K] = linearisation_change(loop, linear)
        error[K] = linear.sigma_amplitude / actual.sigma_amplitude - 1
    assert (change[22.5], change[30.0]) < (LINEAR_CHANGE, LINEAR_CHANGE) < (change[55.0], change[70.0])
    assert max(error[22.5], error[30.0]) < 0.1 < 0.2 < error[55.0]
    assert error[70.0] == pytest.approx(0.42, abs=0.02)  # as the simulation says, above
    assert change[70.0] == math.inf  # the linearised slip would fall below 0


def test_small_cycle_of_the_nonlinear_wheel_is_the_linearised_one():
    # without load and at a small K the adhesion curve is its tangent: amplitudes to second order of 3 % of the slip
    loop = published_loop(Rail.DRY, inertia_scale=3.6)
    actual, linear = nonlinear_limit_cycle(loop, K=20.0, load=0.0), linear_limit_cycle(loop, K=20.0)
    assert actual.period == pytest.approx(linear.period, rel=1e-3)
    for name in AMPLITUDES:
        assert getattr(actual, name) == pytest.approx(getattr(linear, name), rel=2e-3), name
    assert actual.relay_gain == pytest.approx(linear.relay_gain, rel=2e-3)
    assert sum(actual.sigma_range) / 2 == pytest.approx(loop.plant.point.sigma, rel=1e-3)


def test_nonlinear_cycle_on_a_static_law():
    loop = published_loop(Rail.WET, adhesion="beam")
    actual = nonlinear_limit_cycle(loop, K=200.0)
    measured = _simulated(loop, 200.0, actual.sigma_amplitude)
    assert actual.period == pytest.approx(measured.period, rel=0.01)
    assert actual.sigma_amplitude == pytest.approx(measured.sigma_amplitude, rel=0.02)


# range of the slip and period from an own simulator in C, steps of 0.5 ms, of the same law on the same wheel
RELEASED = [(Rail.DRY, 200.0, -0.005, 0.274, 3.87), (Rail.DRY, 400.0, -0.016, 0.286, 3.60)]
RELEASED += [(Rail.WET, 400.0, -0.009, 0.198, 3.23)]


@pytest.mark.parametrize(("rail", "K", "low", "high", "period"), RELEASED)
def test_a_high_relay_releases_the_wheel_once_a_period_and_does_not_lose_it(rail, K, low, high, period):
    loop = published_loop(rail).with_gains(K=K)
    assert nonlinear_limit_cycle(loop) is None  # it leaves 0 to v
    cycle = simulated_limit_cycle(loop)
    speed = loop.plant.point.speed
    # the extremes of that simulator are over its whole run, and 2 ms of a switch move the slip by 0.001
    assert np.array(cycle.sigma_range) / speed == pytest.approx([low, high], abs=0.004)
    assert cycle.period == pytest.approx(period, rel=0.01)
    effect = actuator_effect(loop)
    assert not effect.holds_the_wheel
    assert "releasing the wheel once a period" in effect.cycle_text
    assert "lost" not in effect.cycle_text
    assert ("beyond twice the reference" in effect.cycle_text) == (high > 2 * loop.plant.point.slip)


def test_simulated_cycle_is_the_one_with_every_harmonic_where_both_exist():
    loop = published_loop(Rail.WET)
    exact, measured = nonlinear_limit_cycle(loop), simulated_limit_cycle(loop)
    assert measured.period == pytest.approx(exact.period, rel=0.005)
    for name in (*AMPLITUDES, "relay_gain", "surface_mean"):
        assert getattr(measured, name) == pytest.approx(getattr(exact, name), rel=0.02), name


def test_a_wheel_that_locks_is_lost():
    loop = published_loop(Rail.DRY, inertia_scale=0.05).with_gains(K=5000.0)  # a light wheel under a heavy relay
    assert simulated_limit_cycle(loop) is None
    with pytest.raises(DomainError, match=r"the wheel is lost at .* outside \+-"):
        _simulated(loop, 5000.0, 1.0)
    effect = effect_on(Rail.WET)
    lost = replace(effect, cycles=tuple(replace(cycle, actual=None) for cycle in effect.cycles))
    assert not lost.holds_the_wheel
    assert "locks or leaves the adhesion model in the simulation: it is lost" in lost.cycle_text
    assert "lost" in cycle_table([lost]).splitlines()[1]
    assert math.isnan(lost.cycles[0].period_error)
    assert math.isnan(lost.cycles[0].amplitude_error)


def test_law_with_its_adaptation_releases_the_wheel_its_relay_alone_would_spare():
    loop = published_loop(Rail.DRY)
    frozen, falling = law_runs(loop)
    # the same C simulator with (49) on: -0.013 to 0.326 once it has settled
    assert frozen.slip_range == pytest.approx((-0.013, 0.326), abs=0.01)
    assert not frozen.spared
    assert not falling.spared
    assert law_runs(published_loop(Rail.WET))[0].spared
    assert effect_on(Rail.DRY).holds_the_wheel
    lost = law_runs(published_loop(Rail.DRY).with_gains(K=9000.0))[1]
    assert (lost.spared, "the wheel is lost at" in lost.text) == (False, True)


@pytest.mark.parametrize("feed_forward", [FeedForward.REST, FeedForward.OFF])
def test_limit_cycle_with_other_feed_forward(feed_forward):
    loop = published_loop(Rail.WET, feed_forward=feed_forward)
    measured = _simulated(loop, loop.gains.K, 0.6)
    for cycle in (linear_limit_cycle(loop, load=loop.load), nonlinear_limit_cycle(loop)):
        assert cycle.period == pytest.approx(measured.period, rel=0.01)
        assert cycle.surface_amplitude == pytest.approx(measured.surface_amplitude, rel=0.02)


def test_integrator_with_dead_time_has_the_textbook_cycle():
    # s' = (r/J) u(t - tau): period 4 tau, amplitude (r/J) K tau
    base = published_loop(Rail.DRY, adhesion="curve")
    wheel = PARK2008.wheel.model_copy(update={"viscous_friction": 0.0})
    point = replace(base.plant.point, vehicle=PARK2008.model_copy(update={"wheel": wheel}))
    plant = replace(base.plant, point=point, A=np.zeros((1, 1)))
    loop = replace(base, plant=plant, gains=SlidingGains(K=70.0, D=0.0, rho=0.0), feed_forward=FeedForward.OFF)
    loop = replace(loop, actuator=Actuator(dead_time=0.15, lag=0.0))
    cycle = linear_limit_cycle(loop)
    assert cycle.period == pytest.approx(0.6, rel=1e-6)
    assert cycle.surface_amplitude == pytest.approx(plant.gain * 70 * 0.15, rel=2e-3)  # the series of a triangle
    # the describing function's own closed form: W = b exp(-j w tau)/(j w) is real at w = pi/(2 tau)
    assert predict_limit_cycle(loop).surface_amplitude == pytest.approx(4 / math.pi * plant.gain * 70 * 0.3 / math.pi)


def test_linearised_cycle_without_load_lies_on_tsypkins_locus():
    loop = published_loop(Rail.WET)
    cycle = linear_limit_cycle(loop)
    locus = tsypkin_locus(loop, cycle.frequency)
    assert locus.real < 0
    assert abs(locus.imag) < 1e-6 * abs(locus.real)
    assert cycle.surface_mean == pytest.approx(0.0, abs=1e-9)
    assert linear_limit_cycle(loop, K=140.0).surface_amplitude == pytest.approx(2 * cycle.surface_amplitude, rel=1e-9)


def test_boundary_layer_removes_the_cycle_from_its_critical_width_on():
    loop = published_loop(Rail.WET)
    width = smallest_layer(loop)
    assert predict_layer_cycle(loop, 1.001 * width) is None
    cycle = predict_layer_cycle(loop, 0.5 * width)
    assert layer_describing_function(cycle.surface_amplitude, 70.0, 0.5 * width) == pytest.approx(cycle.relay_gain)
    assert layer_describing_function(0.1 * width, 70.0, width) == 70.0 / width
    swing = {}
    for factor in (0.5, 1.3):
        law = PublishedLaw(loop.plant.point, replace(loop.gains, k=0.0), layer=factor * width)
        run = simulate(loop.plant.point, law, ACTUATOR, duration=80.0, step=2e-3, offset=0.3).after(60.0)
        swing[factor] = 0.5 * float(np.ptp(run.surface))
    assert swing[0.5] == pytest.approx(cycle.surface_amplitude, rel=0.1)
    assert swing[1.3] < 0.02 * cycle.surface_amplitude
