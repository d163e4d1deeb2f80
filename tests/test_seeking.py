"""The seeking controller: its parts against closed forms, its loop block by block, its stops against bounds."""

from __future__ import annotations

import copy
import json
import math
import re
from types import SimpleNamespace

import control as ct
import numpy as np
import pytest
from project import ROOT, changed
from scipy.optimize import brentq, lsq_linear

from railslip_ctrl.controllers import seeking as step
from railslip_ctrl.controllers.base import Measurement, Situation
from railslip_ctrl.controllers.files import load_controller
from railslip_ctrl.controllers.seeking import Seeking
from railslip_ctrl.controllers.systems import wheel_slip_loop
from railslip_ctrl.core.errors import InfeasibleDesignError, InputError
from railslip_ctrl.design.envelope import Envelope
from railslip_ctrl.design.envelope_tuning import tune
from railslip_ctrl.design.judging import judge
from railslip_ctrl.loop.quasi import DelayedLoop, DelayedRatio, QuasiPolynomial
from railslip_ctrl.model.adhesion import ReferenceSlip, published_law
from railslip_ctrl.model.linearization import linearize, operating_point
from railslip_ctrl.model.numeric import adhesion_coefficient, peak
from railslip_ctrl.model.vehicle import PARK2008, Actuator, Rail
from railslip_ctrl.model.vehicle_files import load_vehicle
from railslip_ctrl.simulation import Beliefs, BrakeLimits, Event, Simulator, simulate, stop
from railslip_ctrl.simulation.bound import attainable_stop, clairvoyant_stop

CONTROL = Seeking.for_vehicle(PARK2008)
NAMED = Seeking.for_vehicle(PARK2008, name="seeking")
PERIOD = 0.01
GAIN = CONTROL.lag * (CONTROL.reaching_rate + CONTROL.switching_gain / CONTROL.layer)  # torque to rate of the command


@pytest.fixture
def p():
    situation = Situation(Rail.DRY, PERIOD, published_law("curve", "dry"))
    return SimpleNamespace(**CONTROL.parameters(situation), period=PERIOD, reference_slip=math.nan)


@pytest.fixture
def state():
    return SimpleNamespace(**{name: list(x) if isinstance(x, tuple) else x for name, x in CONTROL.start(27.0, PERIOD)})


# --- parts ----------------------------------------------------------------------------------------------------------


def test_the_observer_finds_a_constant_adhesion_torque(p, state):
    """Ta_hat tends to Ta = J omega' + B omega + T: a ramp of omega passes the filters without error."""
    wheel, torque, ta = PARK2008.wheel, 3000.0, 2400.0
    spin, v, omega = (ta - torque) / wheel.inertia, 27.0, 60.0
    state.torque_ahead = torque
    for k in range(100):
        state.samples = k
        step.actuator_model(state, p, torque)
        step.observe(state, p, v, omega, 0.11)
        omega += spin * PERIOD
    friction = wheel.viscous_friction * state.filtered_omega
    assert state.adhesion_torque - friction == pytest.approx(ta, rel=1e-6)  # 17 time constants of the observer
    assert state.holding_torque == pytest.approx(ta, rel=1e-6)  # the train does not slow down
    assert state.deceleration == 0.0


def test_the_predictor_is_exact_for_a_constant_adhesion(p, state):
    """sigma a dead time ahead, sigma' = r/J (T - Th), where T is what the history has: summed here sample by sample."""
    rng = np.random.default_rng(3)
    held, sigma, late = 2000.0, 0.4, round(CONTROL.dead_time / PERIOD)
    ahead = []
    for k in range(60):
        state.samples = k
        step.actuator_model(state, p, rng.uniform(0, 4000))
        ahead.append(state.torque_ahead)
    state.holding_torque, state.deceleration = held, 1.5
    step.predict(state, p, 27.0, sigma, 0.1)
    for torque in ahead[-late:]:
        sigma += PARK2008.wheel.radius / PARK2008.wheel.inertia * PERIOD * (torque - held)
    assert state.sigma_ahead == pytest.approx(sigma - 0.1 * 0.15 * 1.5, rel=1e-12)
    assert state.speed_ahead == pytest.approx(27.0 - 0.15 * 1.5, rel=1e-15)


def curve_of(slip: float, a: float, b: float, c: float) -> float:
    """Adhesion coefficient of the fitted family, slip/mu = a + b slip + c slip^2."""
    return slip / (a + b * slip + c * slip**2)


def feed(state, p, mu: float, slip: float, moved: float = 1.0) -> None:
    state.filtered_speed, state.filtered_sigma, state.moved = 20.0, 20.0 * slip, moved
    state.adhesion_torque = mu * p.wheel_load * p.radius
    step.learn(state, p, slip)


def test_the_fit_is_constrained_least_squares(p, state):
    """Against SciPy's solution of the same normal equations, wherever the constraints bind."""
    rng, bound = np.random.default_rng(5), set()
    for _ in range(300):
        nodes, weights = rng.uniform(0.001, 0.16, 4), rng.uniform(1.0, 50.0, 4)
        ratio = 0.1 + rng.normal(1.0, 6.0) * nodes + rng.normal(0.0, 60.0) * nodes**2
        powers = np.vander(nodes, 3, increasing=True)
        for i in range(5):
            state.sums[i] = float(weights @ nodes**i)
            if i < 3:
                state.sides[i] = float(weights @ (nodes**i * ratio))
        scale, prior = rng.uniform(0.01, 0.1), rng.uniform(1e-4, 1.0)
        matrix = powers.T @ (weights[:, None] * powers) + np.diag([0.0, prior, prior * scale**2])
        factor = np.linalg.cholesky(matrix).T
        side = np.linalg.solve(factor.T, np.array(state.sides))
        expected = lsq_linear(factor, side, bounds=([-np.inf, 0.0, 0.0], np.inf), method="bvls", tol=1e-14).x
        if expected[0] <= 0.0:
            continue
        step.fit(state, scale, prior)
        bound.add((expected[1] < 1e-12, expected[2] < 1e-12))
        np.testing.assert_allclose(state.curve, expected, rtol=1e-5, atol=1e-9)  # condition of the matrix
    assert len(bound) == 4


@pytest.mark.parametrize("peak_slip", [0.015, 0.05, 0.09])
def test_the_elasticity_is_that_of_the_curve(p, state, peak_slip):
    """Exact without noise and without the prior, which moves it by at most 0.2 here."""
    c = 40.0
    a = c * peak_slip**2
    for slip in np.geomspace(0.3 * peak_slip, 1.5 * peak_slip, 400):
        feed(state, p, curve_of(slip, a, 1.0, c), slip)
    without = copy.deepcopy(state)
    step.fit(without, 1.0, 0.0)
    for share in (0.5, 0.9, 1.0, 1.2):
        slip = share * peak_slip
        exact = (a - c * slip**2) / (a + slip + c * slip**2)
        assert step.elasticity_at(without, slip) == pytest.approx(exact, abs=1e-4)  # condition of the matrix
        assert step.elasticity_at(state, slip) == pytest.approx(exact, abs=0.2)


def test_a_sample_counts_less_while_the_torque_changes(p, state):
    """By the variance that 15 % of dead time and lag, times the rate of the torque, add to that of the random force."""
    still, changing = copy.deepcopy(state), copy.deepcopy(state)
    rate = 2000.0  # N*m/s
    changing.filtered_torque = -rate * p.observer_time
    for one in (still, changing):
        feed(one, p, 0.2, 0.05)
    load = p.wheel_load * p.radius
    quiet = step._NOISE**2 * 0.02 / (2 * p.observer_time) + 0.002**2
    assert still.sums[0] / changing.sums[0] == pytest.approx(1 + (0.15 * 0.75 * rate / load) ** 2 / quiet, rel=1e-9)


def known(state, p, elasticity: float, slip: float) -> None:
    state.curve = [1.0 + elasticity, 0.0, (1.0 - elasticity) / slip**2]
    state.reference_slip, state.top_slip, state.moved = slip, slip, 1.0
    state.filtered_speed, state.filtered_sigma, state.remembered_torque = 20.0, 20.0 * slip, 2000.0
    state.adhesion_torque = state.top_torque = 2000.0


@pytest.mark.parametrize(
    ("elasticity", "share", "adhesion", "moves"),
    [
        (0.5, 1.0, 1.0, True),
        (0.5, 0.55, 1.0, True),
        (0.5, 0.45, 1.0, False),  # the slip is below half of it
        (0.0, 0.75, 0.95, False),  # the slip has not reached it
        (0.0, 1.0, 0.95, True),
        (0.0, 1.0, 1.0, False),  # adhesion is as high as ever
    ],
)
def test_the_reference_moves_with_the_elasticity(p, state, elasticity, share, adhesion, moves):
    """d ln reference/dt = (E - E0)/(dead time + observer time)."""
    known(state, p, elasticity, 0.05)
    state.top_slip, state.remembered_torque = 0.0 if elasticity else 0.05, adhesion * state.top_torque
    before, slip = state.reference_slip, share * state.reference_slip
    seen = step.elasticity_at(state, max(slip, min(before, slip / 0.8)))
    step.follow(state, p, slip, before)
    rate = (seen - 0.18) / (p.dead_time + p.observer_time)
    assert state.reference_slip == pytest.approx(before * math.exp(rate * PERIOD if moves else 0.0), rel=1e-12)


@pytest.mark.parametrize("peak_slip", [0.015, 0.05, 0.09])
@pytest.mark.parametrize(("first", "least"), [(0.3, 0.98), (1.15, 0.88)])
def test_without_noise_the_reference_rests_near_the_peak(p, state, peak_slip, first, least):
    """From below with 98 % of its adhesion; a reference that began past the peak has not seen it, and has 88 %."""
    v, load = 25.0, p.wheel_load * p.radius
    state.reference_slip, state.filtered_speed, state.slip_rate = first * peak_slip, v, 1.0
    for _ in range(3000):
        slip = state.reference_slip
        mu = 0.4 * slip * peak_slip / (peak_slip**2 + slip**2)
        state.filtered_sigma, state.adhesion_torque, state.remembered_torque = slip * v, mu * load, mu * load
        state.remembered_slip = slip
        if mu * load >= state.top_torque:
            state.top_torque, state.top_slip = mu * load, slip
        step.seek(state, p, v, slip, 0.0)
    assert mu / 0.2 > least


def test_from_past_the_peak_the_reference_falls_to_just_below_it(p, state):
    known(state, p, -0.5, 0.1)
    state.top_slip, state.remembered_torque = 0.05, 1500.0
    for _ in range(200):
        step.follow(state, p, 0.1, 0.05)
    assert state.reference_slip == pytest.approx(0.8 * 0.05)


@pytest.mark.parametrize("heavier", [1.0, 2.0])
@pytest.mark.parametrize(("elasticity", "share"), [(1.0, 1.0), (0.43, 0.5), (0.25, 0.14), (0.19, 0.02)])
def test_the_lead_of_an_approach_shrinks_with_the_elasticity(p, state, elasticity, share, heavier):
    """It adds a slip of 0.16 in a reaction time if E > 0.68, at most mu = 0.22, and nothing where E is 0.18."""
    known(state, p, elasticity, 0.02)
    p.wheel_inertia *= heavier
    v, held, ahead = 20.0, 3000.0, 2500.0
    state.starting, state.holding_torque, state.torque_ahead, state.speed_ahead = 1.0, held, ahead, v
    lead = 0.16 * v * p.wheel_inertia / p.radius / (p.dead_time + p.observer_time)
    assert (lead > 0.22 * p.wheel_load * p.radius) == (heavier > 1.0)
    lead = share * min(lead, 0.22 * p.wheel_load * p.radius)
    command = step.approach(state, p, v, 0.02 * v)
    assert command == pytest.approx(ahead + GAIN * (held + lead - ahead))
    assert state.starting == 1.0


@pytest.mark.parametrize(("elasticity", "slip_rate", "ends"), [(0.17, 0.0, True), (0.3, 0.0, False), (0.3, 14.0, True)])
def test_an_approach_ends_near_the_peak_or_at_the_largest_slip(p, state, elasticity, slip_rate, ends):
    known(state, p, elasticity, 0.02)
    state.starting, state.speed_ahead, state.slip_rate = 1.0, 20.0, slip_rate
    step.approach(state, p, 20.0, 0.4)
    assert state.starting == (0.0 if ends else 1.0)
    assert state.reference_slip == (0.11 if slip_rate else 0.02)


def test_an_approach_ends_sooner_with_a_long_lag(p, state):
    """The torque still rises: E is seen where a lag 30 % longer lets the slip go, at most twice as far as it is."""
    for lag, ends in ((0.0, False), (0.3, False), (0.6, True), (6.0, True)):
        known(state, p, 0.4, 0.02)
        p.lag, state.starting, state.slip_rate, state.speed_ahead, state.slip_ahead = lag, 1.0, 0.8, 20.0, 0.4
        step.approach(state, p, 20.0, 0.4)
        assert ends == (step.elasticity_at(state, min(0.02 + 0.3 * lag * 0.04, 0.04)) < p.elasticity)
        assert state.starting == (0.0 if ends else 1.0)


def test_until_adhesion_is_seen_the_torque_is_that_of_the_weakest_rail(p, state):
    """0.06 of the wheel load, whatever the lead."""
    state.starting, state.filtered_speed = 1.0, 1e-3
    assert step.approach(state, p, 1e-3, 0.0) == pytest.approx(GAIN * 0.06 * CONTROL.wheel_load * 0.43, rel=1e-3)


@pytest.mark.parametrize(("first_slip", "starts"), [(0.08, 2.0), (0.5, 0.0)])
def test_it_starts_anew_where_the_rail_holds_more_and_not_where_slip_comes_back(p, state, first_slip, starts):
    """Adhesion rises by 60 % in 0.4 s: below the reference it is the rail's, from past the peak the slip's."""
    state.mean_torque, state.quick_torque, state.filtered_speed = 1500.0, 1500.0, 15.0
    for share in np.linspace(0, 1, 41):
        state.adhesion_torque = 1500.0 + 900.0 * share
        step.restart(state, p, 15.0, first_slip + (0.08 - first_slip) * share, 0.1)
        if state.starting:
            break
    assert state.starting == starts


@pytest.mark.parametrize(("share", "starts"), [(0.99, 0.0), (1.01, 2.0)])
def test_on_a_weak_rail_the_random_force_starts_no_approach(p, state, share, starts):
    """Adhesion must rise by 5 % and three standard deviations of the force that passes the filters."""
    weak, force = (mu * p.wheel_load * p.radius for mu in (0.05, 431.0 / 34.5e3))
    risen = share * (1.05 * weak + 3.0 * force * math.sqrt(0.02 / (2.0 * (p.observer_time + 0.05))))
    state.mean_torque = state.top_torque = weak
    state.filtered_speed, state.quick_torque, state.adhesion_torque = 15.0, risen, risen
    step.restart(state, p, 15.0, 0.01, 0.02)
    assert state.starting == starts


@pytest.mark.parametrize(("slip", "samples", "starts"), [(-0.01, 17, 2.0), (-0.01, 14, 0.0), (0.01, 17, 0.0)])
def test_it_starts_anew_where_the_wheel_rolls_free_for_a_dead_time(p, state, slip, samples, starts):
    state.filtered_speed, state.mean_torque, state.top_torque = 25.0, 1500.0, 1500.0
    for _ in range(samples):
        step.restart(state, p, 25.0, slip, 0.02)
    assert state.starting == starts


def test_the_hand_over_holds_a_share_and_less_of_a_slip_that_has_run_away(p, state):
    """84 % of the mean torque at the hand-over, 20 % at 2 km/h, with the fourth power of the speed lost.

    80 % of that once slip was above 0.25.
    """
    g, mean, reference, torque = CONTROL, 2000.0, 0.08, 2500.0
    state.mean_holding, state.filtered_speed = mean, 3.0

    def command(kmh: float, slip: float, ahead: float) -> float:
        state.filtered_sigma, state.sigma_ahead, state.speed_ahead = 3.0 * slip, 3.0 * ahead, 3.0
        return step.hand_over(state, p, kmh / 3.6, torque, reference)

    loss = g.hand_over_share - g.last_share
    share = {kmh: g.hand_over_share - loss * ((14 - kmh) / 12) ** 4 for kmh in (13, 11, 8)}
    assert command(13, 0.1, 0.07) == command(13, 0.07, 0.1) == pytest.approx(share[13] * mean)  # at most
    torque = 500.0
    assert command(13, 0.24, 0.3) == torque  # the inner loop's
    before = copy.deepcopy(state)
    assert command(11, 0.07, 0.07) == command(11, 0.5, 0.5) == pytest.approx(share[11] * mean)  # without feedback
    assert command(2, 0.0, 0.0) == command(1, 0.0, 0.0) == pytest.approx(0.2 * mean)
    vars(state).update(vars(before))
    assert command(11, 0.26, 0.07) == torque
    torque = 2500.0
    assert command(11, 0.26, 0.07) == pytest.approx(0.5 * share[11] * mean)
    assert command(11, 0.1, 0.07) == pytest.approx(share[11] * mean)
    assert command(8, 0.07, 0.07) == command(8, 0.5, 0.5) == pytest.approx(0.8 * share[8] * mean)
    assert command(8, 0.91, 0.91) == 0.0  # it has locked
    assert command(8, 0.5, 0.5) == pytest.approx(0.5 * 0.8 * share[8] * mean)
    assert command(8, 0.07, 0.07) == command(8, 0.5, 0.5) == pytest.approx(0.8**2 * share[8] * mean)


@pytest.mark.parametrize(("kmh", "longest"), [(4, 3.0), (13, 9.0), (15, 12.0)])
def test_a_stop_that_begins_near_the_hand_over_holds_what_a_poor_rail_does(kmh, longest):
    """84 % of an adhesion coefficient of 0.1, and less below; a start that began just above has learned nothing."""
    slow = stop(PARK2008, "wet", adhesion="bristle").with_changes(initial_speed=kmh / 3.6, final_speed=2 / 3.6)
    run = simulate(slow, CONTROL, seed=0)
    assert (run.stopped, run.locked_fraction, run.braking_time < longest) == (True, 0.0, True)
    if kmh < 14 / step.MOST_WEAK:  # the hand-over speed of so poor a rail
        share = 0.84 - 0.64 * ((14 - step.MOST_WEAK * kmh) / 12) ** 4
        held = share * 0.1 * PARK2008.wheel_load * PARK2008.wheel.radius
        assert run.signals.command.max() == pytest.approx(held, rel=0.005)  # noise of the speed


def test_a_wheel_that_locks_at_the_hand_over_is_let_go():
    """To wet at 10 km/h, where what holds the dry peak locks it; for 2 to 4 s if that torque were held."""
    dry = stop(PARK2008, "dry", adhesion="curve")
    seen = simulate(dry, CONTROL, seed=0).signals
    place = float(np.interp(-10 / 3.6, -seen.speed, seen.distance))
    run = simulate(dry.with_changes(events=(Event(distance=place, rail="wet"),), final_speed=2 / 3.6), CONTROL, seed=0)
    assert 0.0 < run.locked_fraction * run.braking_time < 1.5


# --- the loop -------------------------------------------------------------------------------------------------------


def test_the_free_wheel_calibrates_radius_and_noise(p, state):
    """Mean of v/(r omega), and the variances of both speeds, over the samples of the free wheel."""
    rng = np.random.default_rng(2)
    speeds, turns = 27.0 + 0.05 * rng.normal(size=400), 27.0 / 0.42 + 0.1 * rng.normal(size=400)
    for k, (v, omega) in enumerate(zip(speeds, turns, strict=True)):
        state.samples = float(k)
        step.calibrate(state, p, v, omega)
    assert state.rolling == pytest.approx(0.42 / PARK2008.wheel.radius, rel=3e-4)  # three standard errors
    assert state.jitter == pytest.approx(np.var(turns), rel=1e-9)
    assert state.roughness == pytest.approx(0.05**2 + (0.42 * 0.1) ** 2, rel=0.25)


def remember_past_a_peak(state, p, slip, torque):
    """One sample at slip ratio `slip` with a falling adhesion torque, after a peak of 2000 N*m at slip 0.02."""
    v = 20.0
    state.top_torque, state.top_slip, state.reference_slip, state.slip_rate = 2000.0, 0.02, 0.11, 1.0
    state.filtered_speed, state.filtered_sigma, state.sigma_ahead, state.slip_ahead = v, slip * v, slip * v, slip * v
    state.remembered_slip, state.remembered_torque, state.adhesion_torque = slip, torque, torque - 50.0
    step.remember(state, p, v)


@pytest.mark.parametrize(("slip", "torque", "returning"), [(0.08, 1500, 1.0), (0.08, 1900, 0.0), (0.025, 1500, 0.0)])
def test_slip_returns_where_adhesion_has_fallen_far_past_a_narrow_peak(p, state, slip, torque, returning):
    remember_past_a_peak(state, p, slip, torque)
    assert state.returning == returning
    if returning:
        assert state.reference_slip == pytest.approx(0.8 * 0.02)
        assert state.torque_limit == state.top_torque


def test_the_third_of_returns_in_quick_succession_shows_swinging_adhesion(p, state):
    found = []
    for _ in range(3):
        state.returning = state.calm = 0.0
        remember_past_a_peak(state, p, 0.08, 1500.0)
        found.append((state.returning, state.slip_limit < 1.0, state.torque_limit > 0.0))
    assert found == [(1.0, True, True), (1.0, True, True), (0.0, False, False)]
    assert state.reference_slip == 0.11


def test_a_return_ends_three_standard_deviations_above_its_slip_and_then_waits(p, state):
    for above, returning in ((3.1, 1.0), (2.9, 0.0)):
        state.returning, state.reference_slip, state.speed_ahead = 1.0, 0.01, 20.0
        state.slip_ahead = 0.01 * 20.0 / 0.8 + above * 0.05
        step.come_back(state, p, 0.05)
        assert state.returning == returning
    assert state.waiting == pytest.approx(p.dead_time + p.observer_time)


def test_a_peak_is_remembered_only_while_slip_rises(p, state):
    """The adhesion of bristles swings, and is highest as slip falls."""
    state.filtered_speed, state.filtered_sigma, state.reference_slip = 20.0, 0.4, 0.11
    state.adhesion_torque, state.slip_rate = 2000.0, -1.0
    step.remember(state, p, 20.0)
    assert state.top_slip == 0.0
    state.slip_rate = 1.0
    step.remember(state, p, 20.0)
    assert state.top_slip == state.remembered_slip > 0.0


@pytest.mark.parametrize(("slip", "fades"), [(0.03, True), (0.09, False)])
def test_the_memory_fades_near_its_slip_and_not_far_past_it(p, state, slip, fades):
    state.top_torque, state.top_slip, state.reference_slip, state.filtered_speed = 2000.0, 0.04, 0.11, 20.0
    state.remembered_slip, state.filtered_sigma = slip, 20.0 * slip
    state.remembered_torque = state.adhesion_torque = 1000.0
    step.remember(state, p, 20.0)
    share = PERIOD / (8 * (p.dead_time + p.observer_time))
    assert state.top_torque == pytest.approx(2000.0 - 1000.0 * share * fades)


@pytest.mark.parametrize(("v", "share"), [(100.0, 0.97 - 0.12 * CONTROL.hand_over_speed / 100.0), (3.0, 0.85)])
def test_after_a_return_less_is_held_than_the_peak_had_and_the_less_the_slower_the_train_is(p, state, v, share):
    state.torque_limit, state.top_torque, state.deceleration = 1900.0, 2000.0, 2.0
    state.filtered_speed, state.filtered_sigma, state.torque_ahead, state.speed_ahead = 20.0, 0.1, 1000.0, v
    most = share * 1900.0 + PARK2008.effective_inertia / PARK2008.wheel.radius * 2.0
    expected = 1000.0 + GAIN * (most - 1000.0)
    assert step.limited(state, p, 1e5, 0.015) == pytest.approx(expected)
    assert step.limited(state, p, 500.0, 0.015) == pytest.approx(expected)  # with less slip than the reference
    state.remembered_slip = 0.02
    assert step.limited(state, p, 500.0, 0.015) == 500.0
    state.waiting = 0.2  # now the predicted slip decides, 0
    assert step.limited(state, p, 500.0, 0.015) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("elasticity", "slip", "goal"),
    [
        (0.9, 0.01, "curve"),  # 90 % of the torque of the fitted curve at the reference
        (0.5, 0.03, "lead"),  # the fit promises more than the lead allows
        (0.1, 0.03, None),  # E is below E0: no lead, and the law asks for more than the holding torque
        (0.9, 0.09, None),  # the slip is near its reference
    ],
)
def test_a_slip_far_below_its_reference_is_raised_as_far_as_the_fit_goes(p, state, elasticity, slip, goal):
    known(state, p, elasticity, slip)
    reference, held, v, law = 0.1, 1500.0, 20.0, 1501.0
    state.curve = [one / 20.0 for one in state.curve]
    state.remembered_slip, state.holding_torque, state.torque_ahead, state.speed_ahead = slip, held, 1000.0, v
    state.deceleration = 0.5
    if goal == "curve":
        state.holding_torque = held = 1e5
    a, b, c = state.curve
    lead = 0.08 * v * p.wheel_inertia / p.radius / (p.dead_time + p.observer_time)
    at = {
        "curve": 0.9 * p.wheel_load * p.radius * reference / (a + b * reference + c * reference**2),
        "lead": held + lead * min((elasticity - 0.18) / 0.5, 1.0),
    }
    if goal is not None:
        assert at[goal] == min(at.values())
        expected = step.quickly(state, p, at[goal] + p.wheel_inertia / p.radius * 0.5)
        assert step.limited(state, p, 0.0, reference) == pytest.approx(expected)
    else:
        quick = step.quickly(state, p, held + p.wheel_inertia / p.radius * 0.5)
        assert step.limited(state, p, max(law, quick), reference) == max(law, quick)


@pytest.mark.parametrize(("peak", "torque"), [(0.021, 2100.0), (0.06, 4000.0), (0.01, 1000.0)])
def test_the_limits_rise_towards_the_fitted_peak_and_not_far_above_the_remembered_one(p, state, peak, torque):
    """At most 1.25 times what is remembered; they never fall."""
    per = p.wheel_load * p.radius / torque  # slip/mu = a + c slip^2 has its peak N r/(2 sqrt(a c)) at sqrt(a/c)
    state.curve = [per * peak / 2, 0.0, per / (2 * peak)]
    state.top_torque, state.top_slip, state.torque_limit, state.slip_limit = 2000.0, 0.02, 1700.0, 0.015
    step.lift_limits(state, p, 0.25)
    goals = min(torque, 2500.0), 0.8 * min(peak, 0.025)
    assert state.torque_limit == pytest.approx(1700.0 + 0.25 * max(goals[0] - 1700.0, 0.0))
    assert state.slip_limit == pytest.approx(0.015 + 0.25 * max(goals[1] - 0.015, 0.0))


@pytest.mark.parametrize("scale", [0.98, 1.02])
def test_a_wrong_radius_or_train_speed_locks_no_wheel(scale):
    """On Polach's dry rail 2 % locked 12 of 12 stops without calibration."""
    scenario = stop(PARK2008, "dry", adhesion="polach").with_changes(
        beliefs=Beliefs(radius=scale * PARK2008.wheel.radius), limits=BrakeLimits(torque_max=9000.0)
    )
    wrong = Seeking.for_vehicle(scenario.believed_vehicle)
    right, found = simulate(scenario, CONTROL, seed=0), simulate(scenario, wrong, seed=0)
    assert found.locked_fraction == 0
    assert found.braking_distance == pytest.approx(right.braking_distance, rel=0.05)


def test_zeros_removed_at_the_origin():
    """(1 - exp(-theta s))/s: the integral over the dead time, 1 at s -> 0 times theta; its argument principle."""
    integral = QuasiPolynomial([[1.0], [-1.0]], 0.15, removed=1)
    s = np.array([0.0, 1e-9, 1e-4j, 0.1 + 0.2j, 3j])
    exact = [0.15 if x == 0 else complex(-np.expm1(-0.15 * x) / x) for x in s]
    np.testing.assert_allclose(integral(s), exact, rtol=1e-12)
    slopes = (integral(s + 1e-6) - integral(s - 1e-6)) / 2e-6
    np.testing.assert_allclose(integral.slope(s), slopes, rtol=1e-7)  # of the difference quotient
    assert np.all(np.abs(integral(1j * np.linspace(0, 50, 501))) <= integral.size(50.0))
    for one in (integral, integral.slope, integral.slope.slope):
        for radius in (0.1, 3.0, 60.0, 900.0):
            ring = radius * np.linspace(0.7, 1, 9)[:, None] * np.exp(1j * np.linspace(-np.pi / 2, np.pi / 2, 41))
            bound = one.size(radius, 0.0, 0.7 * radius)
            assert np.abs(one(ring)).max() <= bound
            assert np.abs(one(ring)).max() > 0.1 * bound  # at every frequency, so that few are needed
    # s + k (1 - exp(-theta s))/s has, times s, the roots of s^2 + k (1 - exp(-theta s)) but the one at 0
    for k, expected in ((1.0, 0), (1e4, 2)):
        sum_ = QuasiPolynomial([[1.0, 0.0, k], [-k]], 0.15, removed=1)
        num, den = ct.pade(0.15, 12)[0], ct.pade(0.15, 12)[1]
        roots = np.roots(np.polysub(np.polymul([1.0, 0.0, k], den), k * np.asarray(num)))
        roots = roots[np.abs(roots) > 1e-6]
        right = int(np.sum((roots.real > 0) & (np.abs(roots) < 150)))  # as far as Pade of order 12 serves
        assert sum_.count_right().right == right
        assert (right > 0) == bool(expected)
    lag = QuasiPolynomial([[1.0, 1.0], [0.5]], 1.0)  # s + 1 + 0.5 exp(-s)
    assert DelayedLoop(DelayedRatio(QuasiPolynomial([[2.0]], 0.0), lag)).dc_gain == pytest.approx(2 / 1.5)


@pytest.mark.parametrize("late", [1.0, 1.3, math.sqrt(0.5)])
@pytest.mark.parametrize(("law", "slip", "kmh"), [("curve", 0.1, 100), ("bristle", 0.09, 60), ("beam", 0.119, 40)])
def test_the_inner_loop_against_pade_and_a_grid(law, slip, kmh, late):
    """Composed of transfer functions block by block, dead times as Pade of order 9."""
    adhesion = published_law(law, "dry")
    point = operating_point(adhesion, PARK2008, kmh / 3.6, slip)
    brake = Actuator(dead_time=late * 0.15, lag=late * 0.6)
    exact = CONTROL.loop(point, brake)
    s, g = ct.tf("s"), CONTROL
    plant = linearize(point)
    sigma = ct.tf(ct.ss(plant.A, plant.B, [[float(n == "sigma") for n in plant.states]], [[0.0]]))
    moving = linearize(point, speed_state=True)
    rate = ct.tf(ct.ss(plant.A, plant.B, moving.A[:1, 1:], [[0.0]]))
    q, qa = 1 / (g.observer_time * s + 1), 1 / (g.deceleration_time * s + 1)
    quick, ratio = 1 / (g.reaching_rate + g.switching_gain / g.layer), g.wheel_inertia / PARK2008.wheel.radius
    more = 1 + g.kappa * quick + g.kappa * g.dead_time

    def response(w):
        x = 1j * w
        e, e_true = np.exp(-g.dead_time * x), np.exp(-brake.dead_time * x)
        acting = e_true * (g.lag * x + 1) / (brake.lag * x + 1)
        spin = x * sigma(x) - rate(x)  # J omega' = -J/r (sigma' - v')
        holding = ratio * (q(x) * spin + (1 - slip) * qa(x) * rate(x))
        own = quick * x + 1 + g.kappa * quick + g.kappa * (1 - e) / x - more * q(x) * e
        return acting * (more * holding + g.kappa * ratio * sigma(x)) / own

    w = np.geomspace(1e-3, 60, 400)
    np.testing.assert_allclose(exact(1j * w), [response(one) for one in w], rtol=1e-8)
    margins = exact.margins()
    dense = np.geomspace(1e-2, 100, 20_000)
    assert margins.ms == pytest.approx(np.abs(1 / (1 + exact(1j * dense))).max(), rel=1e-5)  # of the grid
    assert exact._nodes.size < 1500  # frequencies up to 900 rad/s: what the time of `margins` goes by
    assert exact.is_stable() == (exact.scaled(1.0).root_count.right == 0)
    assert not exact.scaled(1.02 * margins.gain_increase).is_stable()
    assert exact.scaled(0.98 * margins.gain_increase).is_stable()


@pytest.mark.parametrize("late", [1.0, 4 / 3])
@pytest.mark.parametrize(("law", "slip", "kmh"), [("curve", 0.11, 60), ("bristle", 0.0935, 20), ("bristle", 0.11, 100)])
@pytest.mark.parametrize("faster", [1.0, 7.5])
def test_its_sampled_loop_comes_to_that_of_a_short_period(law, slip, kmh, late, faster):
    own = Actuator(dead_time=0.15 / faster, lag=0.6 / faster)
    car = PARK2008.model_copy(update={"actuator": own})
    control = Seeking.for_vehicle(car)
    assert control.period == min(0.01, own.dead_time / 12)
    point = operating_point(published_law(law, "dry"), car, kmh / 3.6, slip)
    brake = Actuator(dead_time=late * own.dead_time, lag=late * own.lag)
    ms = control.loop(point, brake).margins().ms
    shorter = control.model_copy(update={"period": control.period / 10})
    more = [one.loop_as_run(point, brake).margins().ms / ms - 1 for one in (control, shorter)]
    assert more[0] > 0.01
    assert more[1] == pytest.approx(0.1 * more[0], rel=0.1)  # to the second order of the period


@pytest.mark.parametrize(
    ("rail", "slip", "late"),
    [("wet", 0.092, 1.0), ("dry", 0.11, 1.3), ("dry", 0.15, math.sqrt(0.5)), ("dry", 0.15, 1.3)],
)
def test_certificate_of_the_inner_loop(rail, slip, late):
    point = operating_point(published_law("curve", rail), PARK2008, 10.0, slip)
    loop = CONTROL.loop(point, Actuator(dead_time=late * 0.15, lag=late * 0.6))
    found, seen = loop.certificate(), loop.margins() if loop.is_stable() else None
    assert (found.stable, found.unstable_poles) == (loop.is_stable(), loop.root_count.right)
    if seen is None:
        return
    grid = 1j * np.geomspace(1e-2, 100, 100_000)
    assert np.abs(1 / (1 + loop(grid))).max() <= found.ms[1]
    num, den = loop.ratio.numerator, loop.ratio.denominator
    for side, change in ((0, -1e-8), (1, 1e-8)):  # ten times their width
        stable = side == 0
        assert loop.scaled(found.gain_increase[side] * (1 + change)).is_stable() == stable
        if seen.gain_decrease > 0:
            assert loop.scaled(found.gain_decrease[side] * (1 + change)).is_stable() != stable
        later = [tau + found.delay_s[side] * (1 + change) for tau in num.delays[1:]]
        late_num = QuasiPolynomial(num.terms, [0.0, *later], num.removed)
        assert (late_num + den).count_right().stable == stable
    assert found.phase_deg[0] <= seen.phase_deg * (1 + 1e-12)
    assert seen.phase_deg * (1 - 1e-12) <= found.phase_deg[1]


@pytest.mark.parametrize(
    "name", ["", *(pytest.param(name, marks=pytest.mark.long) for name in ("coach", "desiro_classic"))]
)
def test_its_rules_are_robust_for_light_and_heavy_vehicles(name):
    """Ms at most 2 at every operating point of the default envelope from 10 to 100 km/h, as it runs; stable with every
    tolerance where it is hardest, on dry bristle rail at the ends of the speeds."""
    car = load_vehicle(ROOT / f"designs/vehicles/{name}.toml") if name else PARK2008
    control = Seeking.for_vehicle(car)
    speeds = Envelope.model_fields["speeds"].default  # not those of a faster vehicle's limit
    envelope = Envelope(car, speeds=speeds, initial_speed=max(speeds))
    found = judge(envelope, control, nominal=True)
    assert (found.stable.all(), min(found.points.speed_kmh)) == (True, 10.0)
    own = {round(3.6 * speed) for speed in (control.hand_over_speed, control.fade_speed)}
    assert own < set(np.round(found.points.speed_kmh, 6))
    assert found.run_ms.max() <= 2
    hardest = {"laws": ("bristle",), "rails": ("dry",), "speeds": (10, 60, 100)}
    assert judge(envelope.at(**hardest), control).stable.all()


@pytest.mark.parametrize(("law", "rail"), [("curve", "dry"), ("curve", "wet"), ("beam", "wet"), ("bristle", "dry")])
def test_the_slip_that_it_is_judged_at(law, rail):
    """The least with all but 0.56 % of the highest adhesion, found here by a root. Runs rest between 0.8 and 1.3 of it;
    past beam's flat wet peak they do farther: there they have all but 4 % of it. Where adhesion falls from the start,
    the largest reference."""
    adhesion, load, v = published_law(law, rail), PARK2008.wheel_load, 50 / 3.6
    held = CONTROL.judged_slip(adhesion, v, load)
    top = peak(adhesion, v, load)
    if law == "bristle":
        assert held == 0.11
    else:

        def short(slip):
            return adhesion_coefficient(adhesion, v, slip, load) / top.coefficient - (1 - 0.0056)

        assert held == pytest.approx(min(brentq(short, 1e-3, top.slip), 0.11), rel=2e-3)  # of its grid
        run = simulate(stop(PARK2008, rail, adhesion=law), CONTROL, seed=0, record_every=10)
        between = (run.signals.speed > 30 / 3.6) & (run.signals.speed < 70 / 3.6)
        middle = np.median(run.signals.slip[between])
        if law == "beam":
            assert adhesion_coefficient(adhesion, v, middle, load) > 0.96 * top.coefficient
        else:
            assert 0.8 * held < middle < 1.3 * held


def test_the_slip_that_it_is_judged_at_fades_as_that_of_a_sample(p):
    law = published_law("bristle", "dry")
    for speed in (3.0, 5.0, 7.0, 9.0):
        share = step.fading(p, max(speed, CONTROL.hand_over_speed))  # a sample has no reference below
        assert CONTROL.judged_slip(law, speed, PARK2008.wheel_load) == pytest.approx(0.11 * share, rel=1e-12)


def test_over_an_envelope_it_is_judged_as_any_controller(railslip):
    envelope = Envelope(vehicle=PARK2008, laws=("curve",), speeds=(60,), dead_time=(0.7, 1.3), lag=(1,), radius=(1,))
    found = judge(envelope, CONTROL)
    assert (found.verdict, found.stable.all(), len(found.points)) == ("robust", True, 28)
    case = found.worst.case
    assert case.point.slip == CONTROL.judged_slip(case.point.law, case.point.speed, case.point.vehicle.wheel_load)
    dense = np.abs(1 / (1 + CONTROL.loop(case.point)(1j * np.geomspace(0.1, 100, 20_000)))).max()
    assert found.worst.ms == pytest.approx(dense, rel=1e-5)  # of the grid
    assert wheel_slip_loop(case.point, CONTROL).margins().ms == found.worst.ms
    told = judge(envelope.at(reference=ReferenceSlip(dry=0.05, wet=0.05)), CONTROL)
    assert (told.verdict_line, told.slip_notes) == (found.verdict_line, found.slip_notes)
    options = ["--controller", "seeking", "--adhesion", "curve", "--rail", "wet", "--speed", "60", "--json"]
    table = json.loads(railslip("margins", *options)[1])["cases"][0]
    point = operating_point(published_law("curve", "wet"), PARK2008, 60 / 3.6, 0.092)
    assert table["ms"] == CONTROL.loop(point).margins().ms
    assert table["controller"]["kappa_si"] == CONTROL.kappa


# --- stops ----------------------------------------------------------------------------------------------------------


def over(scenario, control=CONTROL, seeds=(0, 1)):
    """Shares over the bound with the brake's limit, and the highest slip."""
    scenario = scenario.with_changes(limits=BrakeLimits(torque_max=9000.0))
    bound = clairvoyant_stop(scenario).braking_distance
    simulator = Simulator(scenario, control)
    runs = [simulator.run(seed) for seed in seeds]
    assert all(run.stopped and run.locked_fraction == 0 for run in runs)
    return max(run.braking_distance for run in runs) / bound - 1


@pytest.mark.parametrize("load", ["empty", "loaded"])
def test_stops_of_a_rail_that_it_is_not_told(load):
    """The same controller on rails and masses it is not told; a PI-lead told the rail needs 38 % and 10 % over."""
    car = PARK2008 if load == "empty" else PARK2008.loaded()
    assert over(stop(car, "dry")) < 0.06
    assert over(stop(car, "wet")) < 0.06
    assert over(stop(car, "dry", adhesion="bristle")) < 0.10
    assert over(stop(car, "wet", adhesion="beam")) < 0.09


def test_stops_with_a_change_of_rail_or_another_brake():
    dry, wet = stop(PARK2008, "dry"), stop(PARK2008, "wet")
    assert over(dry.with_changes(events=(Event(distance=40, rail="wet"),))) < 0.15
    assert over(wet.with_changes(events=(Event(distance=80, rail="dry"),))) < 0.15
    for share in (0.7, 1.3):
        brake = Actuator(dead_time=share * 0.15, lag=share * 0.6)
        assert over(dry.with_changes(vehicle=PARK2008.model_copy(update={"actuator": brake}))) < 0.15


@pytest.mark.parametrize(("seed", "load"), [(7, "empty"), (14, "empty"), (7, "loaded")])
def test_it_does_not_rest_at_a_low_slip_after_a_change_to_dry(seed, load):
    """With a slip above a low reference at the change, the brake 30 % slower: they stopped 46 to 51 % over."""
    car = PARK2008 if load == "empty" else PARK2008.loaded()
    brake = Actuator(dead_time=1.3 * 0.15, lag=1.3 * 0.6)
    wet = stop(car.model_copy(update={"actuator": brake}), "wet", adhesion="beam")
    assert over(wet.with_changes(events=(Event(distance=80, rail="dry"),), final_speed=2 / 3.6), seeds=(seed,)) < 0.2


def test_it_is_told_neither_mass_nor_rail_nor_curve():
    other = PARK2008.model_copy(update={"mass": 5276.0})
    assert Seeking.for_vehicle(other) == CONTROL
    assert (CONTROL.reference, CONTROL.model_law) == (None, None)
    wet, dry = (Situation(rail, PERIOD, published_law(law, rail)) for law, rail in (("beam", "wet"), ("curve", "dry")))
    judged = changed(CONTROL, reference=ReferenceSlip(dry=0.132, wet=0.092))
    assert judged.parameters(wet) == CONTROL.parameters(dry)
    first, second = (simulate(stop(PARK2008, "wet"), one, seed=0) for one in (CONTROL, judged))
    assert first.braking_distance == second.braking_distance  # a reference is there to judge its slip
    assert math.isnan(first.mean_abs_slip_error) != math.isnan(second.mean_abs_slip_error)


@pytest.mark.parametrize(
    ("law", "rail", "bound", "attainable"),
    [
        ("curve", "dry", 136.8, 139.4),
        ("curve", "wet", 250.8, 253.3),
        ("bristle", "dry", None, 133.4),
        ("bristle", "wet", None, 242.4),
        ("beam", "dry", None, 160.6),
        ("beam", "wet", None, 301.0),
    ],
)
def test_the_bound_with_the_brake_and_what_is_attainable(law, rail, bound, attainable):
    scenario = stop(PARK2008, rail, adhesion=law).with_changes(limits=BrakeLimits(torque_max=9000.0))
    least, had = clairvoyant_stop(scenario).braking_distance, attainable_stop(scenario).braking_distance
    assert least < had
    assert had == pytest.approx(attainable, abs=0.1)  # 0.05 of the digit, the rest of the search
    if bound is not None:
        assert least == pytest.approx(bound, abs=0.05)  # of the digit


def test_without_a_largest_torque_nothing_is_attainable():
    with pytest.raises(InputError, match="torque_max"):
        attainable_stop(stop(PARK2008, "dry"))


# --- files, bad input -----------------------------------------------------------------------------------------------


def test_tune_writes_the_file_of_it_and_judges_it(railslip, tmp_path):
    path = tmp_path / "seeking.toml"
    asked = ["--structure", "seeking", "--adhesion", "curve", "--speed", "60", "--nominal", "--json", "--out", path]
    status, told, _ = railslip("tune", *asked)
    assert (status, json.loads(told)["verdict"], load_controller(path)) == (0, "robust", NAMED)
    status, told, _ = railslip("tune", *asked, "--ms-max", "1.5")
    assert (status, json.loads(told)["feasible"]) == (1, False)
    assert railslip("tune", *asked, "--lead", "0.6")[0] == 2
    design = tune(Envelope(vehicle=PARK2008, laws=("curve",), speeds=(60,), slip=(1,)), structure="seeking")
    design.save(path)
    assert (load_controller(path), design.judgement.verdict) == (NAMED, "robust")
    with pytest.raises(InfeasibleDesignError, match=r"Ms is 1\.89"):
        tune(design.judgement.envelope, structure="seeking", ms_max=1.5)
    path.write_text(path.read_text("utf-8").replace("kappa", "kapa"), "utf-8")
    with pytest.raises(InputError, match="kapa"):
        load_controller(path)


def test_bad_gains_are_refused():
    with pytest.raises(InputError, match="dead_time"):
        Seeking.for_vehicle(PARK2008.model_copy(update={"actuator": Actuator(dead_time=0.0, lag=0.6)}))
    with pytest.raises(InputError, match=r"period 0\.013 s .* a dead time of 0\.15 s; give a value <= 0\.0125"):
        Seeking.for_vehicle(PARK2008, period=0.013)
    for fields, words in (
        ({"elasticity": 1.5}, "elasticity"),
        ({"kappa": -1.0}, "kappa"),
        ({"fade_speed": CONTROL.hand_over_speed}, "last_speed < hand_over_speed < fade_speed"),
        ({"last_share": 0.9}, "last_share <= hand_over_share"),
        ({"period": 0.1}, r"period: 0\.1 "),
    ):
        with pytest.raises(InputError, match=words):
            changed(CONTROL, **fields)


def test_a_sample_that_is_not_finite_keeps_the_command(p, state):
    before = copy.deepcopy(state)
    assert CONTROL.step(state, Measurement(0.0, math.nan, 60.0, 1234.0), p) == 1234.0
    assert CONTROL.step(state, Measurement(0.0, 27.0, 60.0, math.nan), p) == 0.0
    assert state == before


def test_compiled_and_interpreted_it_does_the_same():
    scenario = stop(PARK2008, "wet").with_changes(initial_speed=8.0, final_speed=6.5)
    first, second = (simulate(scenario, CONTROL, seed=0, compiled=compiled) for compiled in (True, False))
    assert first.braking_distance == pytest.approx(second.braking_distance, rel=1e-12)
    np.testing.assert_allclose(first.signals.command, second.signals.command, rtol=1e-9)  # many roundings


def test_sampling_periods_of_others():
    other = changed(CONTROL, period=0.02)
    assert len(other.start(0.0, 0.02).history) < len(CONTROL.start(0.0, PERIOD).history)
    assert over(stop(PARK2008, "dry"), other, seeds=(0,)) < 0.08
    assert over(stop(PARK2008, "dry"), changed(CONTROL, period=0.001), seeds=(2,)) < 0.08  # noise ended this start


def test_a_brake_without_lag():
    car = PARK2008.model_copy(update={"actuator": Actuator(dead_time=0.15, lag=0.0)})
    assert over(stop(car, "dry"), Seeking.for_vehicle(car), seeds=(0,)) < 0.08


def test_the_factors_of_its_gains_are_those_of_the_design_and_of_the_page():
    """Of the published vehicle, whose x is 1."""
    car, g = PARK2008, CONTROL
    theta, lag, weight = car.actuator.dead_time, car.actuator.lag, car.wheel_load * car.wheel.radius
    switching = g.switching_gain * (theta + lag) / weight
    own = [g.kappa * theta, g.reaching_rate * theta, switching, g.observer_time / theta, g.deceleration_time / theta]
    text = (ROOT / "designs" / "seeking.py").read_text("utf-8").partition("The gains: ")[2].partition("\n")[0]
    assert [float(one) for one in re.findall(r"\d\.\d+", text)] == pytest.approx(own, rel=1e-9)
    page = (ROOT / "docs" / "theory" / "seeking.md").read_text("utf-8").partition("| gain | rule |")[2]
    rules = [float(one) for one in re.findall(r"\| \$(\d\.\d+)", page)]
    assert [*rules[:3], *rules[4:6]] == pytest.approx(own, rel=1e-9)  # the fourth is the layer's
