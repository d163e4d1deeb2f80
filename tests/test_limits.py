"""Limits of any controller: closed forms, optimal controllers that reach them, random ones that must not beat them."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from test_assessment import plant as wheel
from test_loop_properties import rounded

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.design import actuated_plant
from railslip_ctrl.design.compensators import observer_compensator
from railslip_ctrl.design.limits import fundamental_limits, least_peak
from railslip_ctrl.loop import DeadTimeLoop, Rational
from railslip_ctrl.model.vehicle import PARK2008, Rail

TAU, LAG = PARK2008.actuator.dead_time, PARK2008.actuator.lag


def real(zeros, poles, gain=1.0):
    return Rational(np.array(zeros, dtype=complex), np.array(poles, dtype=complex), gain)


def test_one_real_pole_costs_exp_p_tau_and_each_zero_its_factor():
    assert least_peak(np.array([0.8]), np.array([]), 0.15) == pytest.approx(math.exp(0.12), rel=1e-14)
    with_zero = least_peak(np.array([1.0]), np.array([4.0]), 0.2)
    assert with_zero == pytest.approx(math.exp(0.2) * 5 / 3, rel=1e-14)
    # the X-29's pole 6 and zero 26 rad/s: 32/20 ([Astrom2021] 14.4)
    assert least_peak(np.array([6.0]), np.array([26.0]), 0.0) == pytest.approx(1.6, rel=1e-14)
    pair = np.array([2 + 3j, 2 - 3j])
    assert least_peak(np.array([1.0]), pair, 0.0) == pytest.approx(abs((pair[0] + 1) / (pair[0] - 1)) ** 2, rel=1e-13)


def test_without_unstable_pole_there_is_no_limit_on_the_peaks():
    limits = fundamental_limits(real([], [-1.0]), 2.0)
    assert (limits.mt_bound, limits.ms_bound, limits.unstable_pole, limits.bode_integral) == (1, 1, 0, 0)
    assert limits.doubling_time == math.inf
    assert limits.pi is None
    for tau in (1e-6, 2.0, 1e6):
        assert fundamental_limits(real([], [-1.0]), tau).crossover_range == (0.0, pytest.approx(math.pi / (2 * tau)))
    assert fundamental_limits(real([], [-1.0]), 0.0).crossover_range == (0.0, math.inf)


def test_longest_dead_time_is_where_the_least_peak_passes_an_ms():
    one = fundamental_limits(real([], [1.3, -2.0]), 0.7)
    assert one.ms_bound == pytest.approx(math.exp(0.91), rel=1e-12)
    # exp(p tau) = 2 at the doubling time, whatever the dead time that the limits were asked for
    assert one.longest_dead_time(2.0) == pytest.approx(math.log(2) / 1.3, rel=1e-12)
    assert one.longest_dead_time(2.0) == pytest.approx(one.doubling_time, rel=1e-12)
    for poles, zeros in (([0.5, 1.5], []), ([1.0], [8.0]), ([0.4 + 2j, 0.4 - 2j], [])):
        limits = fundamental_limits(real(zeros, poles), 0.3)
        assert least_peak(np.array(poles), np.array(zeros), limits.longest_dead_time(3.0)) == pytest.approx(3.0)
    assert fundamental_limits(real([], [-1.0]), 2.0).longest_dead_time(2.0) == math.inf
    assert fundamental_limits(real([2.0], [1.0]), 0.0).longest_dead_time(2.0) == 0.0  # the zero alone costs 3
    with pytest.raises(InputError, match="ms: 1 is not allowed"):
        one.longest_dead_time(1.0)


def test_pole_on_a_zero_or_far_too_fast_cannot_be_stabilised():
    assert least_peak(np.array([1.0]), np.array([1.0]), 0.0) == math.inf
    assert least_peak(np.array([200.0]), np.array([]), 2.0) == math.inf


def test_several_poles_cost_at_least_what_each_costs_and_coinciding_ones_stay_finite():
    both = least_peak(np.array([0.5, 1.5]), np.array([]), 0.3)
    assert both > least_peak(np.array([1.5]), np.array([]), 0.3)
    near = least_peak(np.array([1.5, 1.5 * (1 + 1e-9)]), np.array([]), 0.3)
    assert near == pytest.approx(least_peak(np.array([1.5]), np.array([]), 0.3), rel=1e-8)
    pair = np.array([0.4 + 2j, 0.4 - 2j])
    assert least_peak(pair, np.array([]), 0.3) > math.exp(0.4 * 0.3)


@pytest.mark.parametrize("p", [[0.8], [0.5, 1.5], [0.4 + 2j, 0.4 - 2j], [0.6, 0.4 + 2j, 0.4 - 2j]])
def test_least_ms_is_the_norm_of_the_inverse_all_pass_on_the_dead_time_interval(p):
    # An independent route to Ms: min ||S|| = norm on L2[0, tau] of the causal inverse of B_p (commutant lifting). The
    # operator is discretised by the exact step response of 1/B_p on n cells; the error falls as 1/n.
    tau, norms = 0.7, []
    inverse = real(-np.array(p), p)
    import control as ct

    system = ct.ss(ct.tf(np.poly(inverse.zeros).real, np.poly(inverse.poles).real))
    for n in (200, 400):
        t = np.arange(n + 1) * tau / n
        step = ct.step_response(system, t).outputs
        lower = np.concatenate([[(step[0] + step[1]) / 2], np.diff((step[1:] + step[:-1]) / 2)])
        matrix = np.array([[lower[i - j] if i >= j else 0.0 for j in range(n)] for i in range(n)])
        norms.append(np.linalg.norm(matrix, 2))
    extrapolated = norms[1] + (norms[1] - norms[0]) / 3
    assert extrapolated == pytest.approx(least_peak(np.array(p), np.array([]), tau), rel=1e-4)


def test_the_optimal_controller_reaches_the_bound_on_mt_in_the_limit():
    # for exp(-tau s)/(s - p): T = exp(-tau s) exp(p tau)(1 + p eps)/(1 + eps s) has T(p) = 1, so S cancels nothing
    # unstable, and its peak exp(p tau)(1 + p eps) falls to the bound as the roll-off moves out
    p, tau = 0.8, 0.15
    bound = fundamental_limits(real([], [p]), tau).mt_bound
    omega = np.concatenate([[0.0], np.geomspace(1e-3, 1e4, 2001)])
    peaks = []
    for eps in (1.0, 0.1, 0.01, 0.001):
        t = math.exp(p * tau) * (1 + p * eps) / (1 + eps * 1j * omega) * np.exp(-1j * omega * tau)
        assert math.exp(p * tau) * (1 + p * eps) / (1 + eps * p) * math.exp(-p * tau) == pytest.approx(1.0)
        peaks.append(np.abs(t).max())
    assert np.all(np.diff(peaks) < 0)
    assert peaks[-1] == pytest.approx(bound, rel=1e-3)
    assert peaks[-1] > bound


@pytest.mark.parametrize("rail", list(Rail))
def test_wheel_limits_and_the_best_pi_known_for_it(rail):
    plant = actuated_plant(wheel(rail), PARK2008.actuator)
    limits = fundamental_limits(plant, TAU, lag=LAG)
    p = limits.unstable_pole
    assert limits.mt_bound == limits.ms_bound == pytest.approx(math.exp(p * TAU), rel=1e-13)
    assert limits.actuator_product == pytest.approx(p * 0.75, rel=1e-13)
    assert limits.bode_integral == pytest.approx(math.pi * p, rel=1e-13)
    low, high = limits.crossover_range
    for edge in (low, high):
        assert 2 * math.atan(p / edge) + TAU * edge == pytest.approx(math.pi / 2, rel=1e-10)
    assert p < low < high < math.pi / 2 / TAU
    if rail is Rail.DRY:
        # the best Ms of a PI over its points as ki -> 0 is 4.69, and of a PI-lead 1.43
        assert limits.pi.ms_bound == pytest.approx(4.6663, abs=5e-5)
        assert limits.pi_lead.ms_bound == pytest.approx(1.1388, abs=5e-5)
    pi = np.array([s.phase_deg for s in (limits.pi, limits.pi_lead)])
    assert 10 < pi[0] < pi[1] < 90


def test_the_pi_limit_is_the_theorem_for_lag_and_dead_time():
    # 1/((T1 s - 1)(T2 s + 1)) exp(-theta s): a PI needs theta + T2 < T1 (oracles)
    for t1, feasible in ((0.749, False), (0.75, False), (0.7501, True)):
        plant = real([], [1 / t1, -1 / 0.6], 1.0)
        limit = fundamental_limits(plant, 0.15, lag=0.6).pi
        assert limit.feasible is feasible
        assert (limit.ms_bound == math.inf) is not feasible


def test_the_phase_limit_says_nothing_where_it_is_no_theorem():
    assert fundamental_limits(real([2.0], [0.5, -1.0]), 0.1).pi is None
    assert fundamental_limits(real([], [0.5, 0.2, -1.0]), 0.1).pi is None
    assert fundamental_limits(real([], [0.5]), 0.0).pi is None  # the phase only rises
    assert fundamental_limits(real([-0.3], [1.0, -0.2]), 0.01).pi is None  # it falls first, and rises then
    assert fundamental_limits(real([], [3.0, 0.4]), 0.9).crossover_range is None  # no crossover is sensible


@pytest.mark.parametrize(
    ("arguments", "options", "match"),
    [
        ((real([], [1.0]), -1.0), {}, "dead time"),
        ((real([], [1.0]), math.nan), {}, "dead time"),
        ((real([], [1.0]), 0.1), {"lag": -0.5}, "lag"),
        ((real([], [1.0]), 0.1), {"lag": 0.5}, "not in the plant"),
        ((real([], [1.0]), 0.1), {"allowed_lag_deg": 180.0}, "allowed lag"),
    ],
)
def test_bad_input(arguments, options, match):
    with pytest.raises(InputError, match=match):
        fundamental_limits(*arguments, **options)


@st.composite
def unstable_plants(draw):
    poles = [draw(rounded(0.05, 1.5))]
    if draw(st.booleans()):
        poles.append(draw(rounded(0.05, 0.6)))
    poles += [-draw(rounded(0.5, 10.0)) for _ in range(draw(st.integers(1, 2)))]
    zeros = [draw(rounded(3.0, 20.0))] if draw(st.booleans()) else []
    return real(zeros, poles, draw(st.sampled_from([1.0, -1.0])))


@settings(max_examples=300, suppress_health_check=[HealthCheck.filter_too_much])
@given(unstable_plants(), rounded(0.0, 0.5), st.lists(rounded(0.3, 8.0), min_size=9, max_size=9))
def test_no_observer_based_design_beats_the_bounds(plant, tau, roots):
    n = plant.poles.size
    assume(np.min(np.abs(plant.poles[:, None] - plant.poles) + 9 * np.eye(n)) > 0.05)
    limits = fundamental_limits(plant, tau)
    design = observer_compensator(
        plant, tau, feedback_poles=[-r for r in roots[: n + 1]], observer_poles=[-r for r in roots[-n:]]
    )
    assume(design.is_stable())
    m = design.margins()
    assert m.mt >= limits.mt_bound * (1 - 1e-9)
    assert m.ms >= limits.ms_bound * (1 - 1e-9)


@settings(max_examples=300, suppress_health_check=[HealthCheck.filter_too_much])
@given(
    rounded(0.1, 1.2),
    st.lists(rounded(0.02, 0.5), min_size=1, max_size=3),
    rounded(0.0, 0.3),
    rounded(0.01, 0.99),
    rounded(0.0, 0.3),
)
def test_no_pi_beats_the_limits_of_its_structure(p, lags, tau, where, ki_over_kp):
    plant = real([], [p, *[-1 / lag for lag in lags]], float(np.prod([1 / lag for lag in lags])))
    limits = fundamental_limits(plant, tau, lag=lags[0])
    shape = DeadTimeLoop(real([-ki_over_kp], [0.0]) * plant, tau)
    usable = shape.stabilizing_gain_range
    if usable is None or math.isinf(usable[1]):
        assume(usable is not None)
        usable = (usable[0], 100 * usable[0])
    else:
        assert limits.pi.feasible
    assume(limits.pi is not None)
    loop = shape.scaled(usable[0] ** (1 - where) * usable[1] ** where)
    assume(loop.is_stable())
    m = loop.margins()
    assert m.phase_deg <= limits.pi.phase_deg * (1 + 1e-9)
    assert m.ms >= limits.pi.ms_bound * (1 - 1e-9)
    assert min(m.ms, m.mt) >= limits.ms_bound * (1 - 1e-9)


@pytest.mark.parametrize("rail", list(Rail))
def test_bode_integral_with_the_exact_dead_time(rail):
    from scipy.integrate import quad

    plant = actuated_plant(wheel(rail), PARK2008.actuator)
    loop = DeadTimeLoop(real([-5 / 229, -1 / 0.6], [0.0, -1 / 0.06], 229 * 10.0) * plant, TAU)
    assert loop.is_stable()
    expected = fundamental_limits(plant, TAU, lag=LAG).bode_integral

    def log_s(omega):
        return math.log(abs(loop.sensitivity(np.array([omega]))[0]))

    edges = [0.0, 1e-3, 0.1, 1.0, 5.0, *np.arange(20.0, 4000.0, 40.0)]
    total = sum(quad(log_s, a, b, limit=200, epsabs=1e-11)[0] for a, b in itertools.pairwise(edges))
    # |L| ~ a/omega^2 beyond the last edge: the tail is an oscillation below a/(tau omega^2)
    size = abs(loop(1j * edges[-1]))
    assert total == pytest.approx(expected, abs=5 * size / TAU + 1e-8)
