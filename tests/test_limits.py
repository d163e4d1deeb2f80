"""Limits of any controller, against closed forms and optimal controllers; compensators and their loops; effort."""

import dataclasses
import math

import control as ct
import numpy as np
import pytest
import random_loops
from test_tuning import plant as wheel

from railslip_ctrl import PARK2008, InputError, PIController, PIGains, Rail, UnstableLoopError, actuated_plant
from railslip_ctrl.design.compensators import filtered_smith_predictor, observer_compensator, smith_predictor
from railslip_ctrl.design.limits import control_effort, fundamental_limits, least_peak
from railslip_ctrl.loop import DeadTimeLoop, Rational, certificate
from railslip_ctrl.loop.quasi import DelayedLoop, DelayedRatio, QuasiPolynomial
from railslip_ctrl.loop.quasi_batch import QuasiPolynomials, count_right

TAU, LAG = PARK2008.actuator.dead_time, PARK2008.actuator.lag


def test_each_unstable_pole_and_zero_costs_its_factor_and_without_any_there_is_no_limit():
    pair = np.array([2 + 3j, 2 - 3j])
    for poles, zeros, tau, peak in (
        ([0.8], [], 0.15, math.exp(0.12)),
        ([1.0], [4.0], 0.2, math.exp(0.2) * 5 / 3),
        ([6.0], [26.0], 0.0, 1.6),  # the X-29's pole 6 and zero 26 rad/s: 32/20 ([Astrom2021] 14.4)
        ([1.0], pair, 0.0, abs((pair[0] + 1) / (pair[0] - 1)) ** 2),
    ):
        assert least_peak(np.array(poles), np.array(zeros), tau) == pytest.approx(peak, rel=1e-13)
    none = fundamental_limits(Rational([], [-1.0], 1.0), 2.0)
    assert (none.mt_bound, none.ms_bound, none.unstable_pole, none.bode_integral) == (1, 1, 0, 0)
    assert (none.doubling_time, none.pi, none.longest_dead_time(2.0)) == (math.inf, None, math.inf)
    for tau in (1e-6, 2.0, 1e6):
        assert fundamental_limits(Rational([], [-1.0], 1.0), tau).crossover_range == (
            0.0,
            pytest.approx(math.pi / (2 * tau)),
        )
    assert fundamental_limits(Rational([], [-1.0], 1.0), 0.0).crossover_range == (0.0, math.inf)


def test_longest_dead_time_is_where_the_least_peak_passes_an_ms():
    one = fundamental_limits(Rational([], [1.3, -2.0], 1.0), 0.7)
    assert one.ms_bound == pytest.approx(math.exp(0.91), rel=1e-12)
    # exp(p tau) = 2 at the doubling time, whatever the dead time that the limits were asked for
    assert one.longest_dead_time(2.0) == pytest.approx(math.log(2) / 1.3, rel=1e-12)
    assert one.longest_dead_time(2.0) == pytest.approx(one.doubling_time, rel=1e-12)
    for poles, zeros in (([0.5, 1.5], []), ([1.0], [8.0]), ([0.4 + 2j, 0.4 - 2j], [])):
        limits = fundamental_limits(Rational(zeros, poles, 1.0), 0.3)
        assert least_peak(np.array(poles), np.array(zeros), limits.longest_dead_time(3.0)) == pytest.approx(3.0)
    assert fundamental_limits(Rational([2.0], [1.0], 1.0), 0.0).longest_dead_time(2.0) == 0.0  # the zero alone costs 3
    with pytest.raises(InputError, match="ms: 1 is not allowed"):
        one.longest_dead_time(1.0)


@pytest.mark.parametrize("p", [[0.8], [0.5, 1.5], [0.4 + 2j, 0.4 - 2j], [0.6, 0.4 + 2j, 0.4 - 2j]])
def test_least_ms_is_the_norm_of_the_inverse_all_pass_on_the_dead_time_interval(p):
    # An independent route to Ms: min ||S|| = norm on L2[0, tau] of the causal inverse of B_p (commutant lifting). The
    # operator is discretised by the exact step response of 1/B_p on n cells; the error falls as 1/n.
    tau, norms = 0.7, []
    system = ct.ss(ct.tf(np.poly(-np.array(p)).real, np.poly(p).real))
    for n in (200, 400):
        t = np.arange(n + 1) * tau / n
        step = ct.step_response(system, t).outputs
        lower = np.concatenate([[(step[0] + step[1]) / 2], np.diff((step[1:] + step[:-1]) / 2)])
        matrix = np.array([[lower[i - j] if i >= j else 0.0 for j in range(n)] for i in range(n)])
        norms.append(np.linalg.norm(matrix, 2))
    extrapolated = norms[1] + (norms[1] - norms[0]) / 3
    assert extrapolated == pytest.approx(least_peak(np.array(p), np.array([]), tau), rel=1e-4)


@pytest.mark.parametrize("rail", list(Rail))
def test_wheel_limits_and_the_best_pi_known_for_it(rail):
    limits = fundamental_limits(actuated(rail), TAU, lag=LAG)
    p = limits.unstable_pole
    assert limits.mt_bound == limits.ms_bound == pytest.approx(math.exp(p * TAU), rel=1e-13)
    assert limits.actuator_product == pytest.approx(p * 0.75, rel=1e-13)
    assert limits.bode_integral == pytest.approx(math.pi * p, rel=1e-13)
    low, high = limits.crossover_range
    for edge in limits.crossover_range:
        assert 2 * math.atan(p / edge) + TAU * edge == pytest.approx(math.pi / 2, rel=1e-10)
    assert p < low < high < math.pi / 2 / TAU
    if rail is Rail.DRY:
        # the best Ms of a PI over its points as ki -> 0 is 4.69, and of a PI-lead 1.43
        assert limits.pi.ms_bound == pytest.approx(4.6663, abs=5e-5)
        assert limits.pi_lead.ms_bound == pytest.approx(1.1388, abs=5e-5)
    assert 10 < limits.pi.phase_deg < limits.pi_lead.phase_deg < 90


def test_the_phase_limit_says_nothing_where_it_is_no_theorem():
    rises, falls_first = ([], [0.5], 0.0), ([-0.3], [1.0, -0.2], 0.01)
    for zeros, poles, tau in (([2.0], [0.5, -1.0], 0.1), ([], [0.5, 0.2, -1.0], 0.1), rises, falls_first):
        assert fundamental_limits(Rational(zeros, poles, 1.0), tau).pi is None
    assert fundamental_limits(Rational([], [3.0, 0.4], 1.0), 0.9).crossover_range is None  # no crossover is sensible


@pytest.mark.long
def test_no_pi_beats_the_limits_of_its_structure():
    rng, checked = np.random.default_rng(4), 0
    while checked < 100:
        p, lags = rng.uniform(0.1, 1.2), rng.uniform(0.02, 0.5, rng.integers(1, 4))
        tau, plant = rng.uniform(0.0, 0.3), Rational([], [p, *(-1 / lags)], float(np.prod(1 / lags)))
        limits = fundamental_limits(plant, tau, lag=lags[0])
        shape = DeadTimeLoop(Rational([-rng.uniform(0.0, 0.3)], [0.0], 1.0) * plant, tau)
        usable = shape.stabilizing_gain_range
        if usable is None or limits.pi is None:
            continue
        assert math.isinf(usable[1]) or limits.pi.feasible
        loop = shape.scaled(usable[0] * (min(usable[1], 100 * usable[0]) / usable[0]) ** rng.uniform(0.01, 0.99))
        if loop.is_stable():
            m, checked = loop.margins(), checked + 1
            assert m.phase_deg <= limits.pi.phase_deg * (1 + 1e-9)
            assert m.ms >= limits.pi.ms_bound * (1 - 1e-9)
            assert min(m.ms, m.mt) >= limits.ms_bound * (1 - 1e-9)


PI_LEAD = PIController(PIGains(kp=229.0, ki=5.0), lead=0.6, lead_filter=0.06).transfer_function


def actuated(rail=Rail.DRY):
    return actuated_plant(wheel(rail), PARK2008.actuator)


def delayed(loop):
    system, tau = loop.system, loop.dead_time
    num, den = system.gain * np.atleast_1d(np.poly(system.zeros).real), np.atleast_1d(np.poly(system.poles).real)
    return DelayedLoop(DelayedRatio(QuasiPolynomial([[0.0], num], tau), QuasiPolynomial([den], tau)))


OF_BOTH = [
    *(([-0.5], [-1e-3, -1.0, -2.0], 3.0, 0.0), ([], [-3.0, -4.0, -5.0], 70.0, 1e-3)),
    *(([-0.5], [-1e-3, -1.0, -2.0], 3.0, 0.1), ([-1 / 8], [0.0, 0.25, -1 / 0.6], 1.2 / 0.6, 0.15)),
    *(([-0.5, -0.7], [0.0, 0.0, 0.25, -4], 20.0, 0.15), ([0.8], [-1.0, 0.3, -3.0], -2.0, 0.4)),
    *(([-1 + 2j, -1 - 2j], [-0.3 + 1j, -0.3 - 1j, -0.7], -0.6, 0.8), ([0.4], [0.1 + 3j, 0.1 - 3j, -2.0], 5.0, 1.2)),
    *random_loops.loops(random_loops.wheel_slip, 5),
]


@pytest.mark.parametrize("one", OF_BOTH, ids=range(len(OF_BOTH)))
def test_margins_and_certificates_by_parts_of_the_axis_are_those_by_polynomials(one):
    *rational, tau = one
    loop = DeadTimeLoop(Rational(*rational), tau)
    if loop.is_stable():
        m, other = loop.margins(), delayed(loop).margins()
        # where a flat peak lies is good to the root of the rounding only; its height is compared
        for name in {f.name for f in dataclasses.fields(m)} - {"ms_frequency", "mt_frequency", "disk_frequency"}:
            a, b = np.atleast_1d(getattr(m, name)), np.atleast_1d(getattr(other, name))
            size = min(a.size, b.size) if name.startswith("phase_crossover") else max(a.size, b.size)
            assert b[:size] == pytest.approx(a[:size], rel=1e-8, abs=1e-8, nan_ok=True), name
    if tau == 0:
        return
    one, other = loop.certificate(), delayed(loop).certificate()
    assert (one.stable, one.unstable_poles) == (other.stable, other.unstable_poles)
    names = ("gain_increase", "gain_decrease", "phase_deg", "delay_s", "ms", "mt") if one.stable else ()
    pairs = [(getattr(one, name), getattr(other, name)) for name in names]
    for (low, high), (least, most) in (*pairs, *zip(one.gain_crossovers, other.gain_crossovers, strict=True)):
        room = 1e-12 * abs(high) if math.isfinite(high) else 0.0  # coefficients made from roots are rounded
        assert most - least <= 1.01e-9 * abs(most) or least == most
        assert low - room <= most
        assert least <= high + room


def test_a_gain_margin_beyond_a_nearer_one_is_not_certified(monkeypatch):
    monkeypatch.setattr(certificate, "_MOST_DELAYED", 600)
    monkeypatch.setattr(certificate, "_BITS", (80,))
    loop = delayed(DeadTimeLoop(Rational([-0.125], [0.0, 0.25, -1 / 0.6], 2.0), 0.15))
    m = loop.margins()
    assert loop.certificate().gain_increase[0] <= m.gain_increase < m.phase_crossover_gains[2]
    farther = {"gain_increase": m.phase_crossover_gains[2], "gain_increase_frequency": m.phase_crossovers[2]}
    for wrong in (farther, {"gain_decrease": 0.0, "gain_decrease_frequency": math.nan}):
        monkeypatch.setattr(DelayedLoop, "margins", lambda _, wrong=wrong: dataclasses.replace(m, **wrong))
        with pytest.raises(certificate.CertificateError):
            loop.certificate()


def test_loops_in_a_batch_are_those_of_their_transfer_functions():
    """k exp(-tau s)/(s - 1): one pole right of the axis with too little gain, two with too much, else none."""
    cases = [(0.5, 0.3, 1), (1.5, 0.3, 0), (5.0, 0.5, 2), (3.0, 0.01, 0), (0.9, 0.0, 1), (2.0, 0.0, 0), (9.0, 0.4, 2)]
    gain, tau = (np.array(column, dtype=float) for column in list(zip(*cases, strict=True))[:2])
    none = np.zeros(gain.size)
    num = QuasiPolynomials((none[:, None], gain[:, None]), (none, tau))
    den = QuasiPolynomials((np.column_stack([none + 1, none - 1]),), (none,))
    assert count_right(num + den).tolist() == [right for *_, right in cases]
    alone = [DeadTimeLoop(Rational([], [1.0], k), late) for k, late, _ in cases]
    assert [right == 0 for *_, right in cases] == [loop.is_stable() for loop in alone]


@pytest.mark.parametrize("delays", [(0.8, 0.8, 0.8), (0.8, 0.8 * math.sqrt(0.5), 0.3 * math.pi)])
def test_delays_commensurate_or_not_count_as_the_product_of_their_factors(delays):
    # (s + 1 + 0.5 q)(s - 0.3 + q)(s + 0.2 + 3 q): each factor counted as a dead-time loop of its own
    assert complex(QuasiPolynomial([[0.0, 1.0, 2.0], [0.0]], 0.8)(3.0)) == 5.0  # leading zeros count for nothing
    product, expected = QuasiPolynomial([[1.0]], 0.8), 0
    for constant, weight, delay in ((1.0, 0.5, delays[0]), (-0.3, 1.0, delays[1]), (0.2, 3.0, delays[2])):
        late = QuasiPolynomial([[0.0], *product.times([weight]).terms], [0.0, *(x + delay for x in product.delays)])
        product = product.times([1.0, constant]) + late
        expected += DeadTimeLoop(Rational([], [-constant], weight), delay).root_count.right
    assert product.count_right().right == expected == 2
    s = 0.3 + 1.1j
    difference = (product(s + 1e-6) - product(s - 1e-6)) / 2e-6
    assert product.slope(s) == pytest.approx(difference, rel=1e-8)


@pytest.mark.parametrize("rail", list(Rail))
def test_classic_smith_predictor_keeps_the_unstable_pole_as_a_hidden_mode(rail):
    plant = actuated(rail)
    p = wheel(rail).poles[0].real
    delay_free = DeadTimeLoop(PI_LEAD * plant)
    assert delay_free.is_stable()  # so that nothing but the hidden mode is to blame
    design = smith_predictor(plant, TAU, PI_LEAD)
    assert not design.is_stable()
    assert design.loop.root_count.right == 1  # found by the count, not only told
    assert abs(design.loop.characteristic(p)) < 1e-9 * abs(design.loop.characteristic(2 * p))
    assert design.hidden_unstable_poles == pytest.approx([p])
    with pytest.raises(UnstableLoopError, match=rf"cancels the plant's pole at {p:.4g} 1/s"):
        design.margins()


def test_smith_predictor_of_a_stable_plant_has_the_delay_free_poles():
    plant = Rational([], [-0.5, -2.0], 1.0)
    controller = Rational([-0.5], [0.0], 1.0)  # L0 = 1/(s (s + 2)): T = q/(s + 1)^2
    design = smith_predictor(plant, 1.5, controller)
    assert (design.is_stable(), design.reason) == (True, "")
    omega = np.array([0.1, 1.0, 3.0])
    t = np.exp(-1.5j * omega) / (1j * omega + 1) ** 2
    assert design.loop.complementary_sensitivity(omega) == pytest.approx(t, rel=1e-10)
    assert design.margins().mt == pytest.approx(1.0, rel=1e-9)
    for poles in (1, 2):  # the filtered one with m = 0 and a filter of so many poles
        filtered = filtered_smith_predictor(plant, 1.5, controller, filter_time=0.3, roll_off=poles)
        slower = t / (0.3j * omega + 1) ** poles
        assert filtered.loop.complementary_sensitivity(omega) == pytest.approx(slower, rel=1e-10)


@pytest.mark.parametrize(("rail", "ms"), [(Rail.DRY, 1.3184), (Rail.WET, 1.3155)])
def test_filtered_smith_predictor_is_stable_inside_with_its_true_margins(rail, ms):
    plant = actuated(rail)
    design = filtered_smith_predictor(plant, TAU, PI_LEAD, filter_time=0.1)
    assert design.is_stable()
    omega = np.geomspace(1e-2, 50, 60)
    p, q = wheel(rail).poles[0].real, np.exp(-1j * omega * TAU)
    b = ((1 + 0.1 * p) * math.exp(p * TAU) - 1) / p
    f = (1 + b * 1j * omega) / (1 + 0.1j * omega)
    nominal = PI_LEAD(1j * omega) * plant(1j * omega)
    assert design.loop.complementary_sensitivity(omega) == pytest.approx(f * q * nominal / (1 + nominal), rel=1e-8)
    c = PI_LEAD(1j * omega) * f / (1 + nominal * (1 - f * q))
    assert design.controller(1j * omega) == pytest.approx(c, rel=1e-8)
    assert design.margins().ms == pytest.approx(ms, abs=5e-4)
    assert design.controller.high_frequency_gain == pytest.approx(2290 * b / 0.1, rel=1e-9)


FEEDBACK, OBSERVER = [-0.1, -1.0, -1.67, -8.6], [-30.0, -21.0, -8.6]


@pytest.mark.parametrize("rail", list(Rail))
def test_observer_design_has_the_finite_spectrum_asked_for(rail):
    design = observer_compensator(actuated(rail), TAU, feedback_poles=FEEDBACK, observer_poles=OBSERVER)
    assert design.is_stable()
    polynomial, delayed = design.loop.characteristic.terms
    expected = np.poly(FEEDBACK + OBSERVER)
    assert polynomial == pytest.approx(expected, rel=1e-9)
    assert np.abs(delayed).max() < 1e-9 * np.abs(expected).max()  # the dead time has left the closed loop
    assert 1.1 < design.margins().ms < 1.6


def test_effort_without_dead_time_equals_state_space():
    lag, kp, filtered = 0.6, 300.0, 0.2
    plant = Rational([], [0.5, -1 / lag], 0.007 / lag)
    controller = Rational([], [-1 / filtered], kp / filtered)
    effort = control_effort(controller, plant, 0.0, lag=lag)
    s = ct.tf("s")
    c, actuator, slip = kp / (filtered * s + 1), 1 / (lag * s + 1), 0.007 / (s - 0.5)
    closed = ct.ss((c * actuator / (1 + c * actuator * slip)).minreal(1e-9))
    jump = ct.ss((c * actuator / (1 + c * actuator * slip) * s / (s - 0.5)).minreal(1e-6))
    for found, system in ((effort.reference_rate, closed), (effort.disturbance_rate, jump)):
        rate = np.abs(ct.impulse_response(system, np.linspace(0, 14, 140_001)).outputs).max()
        assert found == pytest.approx(rate / 3.6, rel=1e-5)
    assert effort.high_frequency_gain == pytest.approx(0.0, abs=1e-6)
    # noise: the whole spectrum's variance by the closed loop's Gramian; beyond the Nyquist frequency falls little
    command = ct.ss((c / (1 + c * actuator * slip)).minreal(1e-9))
    variance = ct.norm(command, 2) ** 2  # (1/pi) integral over 0..inf of |C S|^2
    nyquist = np.pi / 0.005
    tail = kp**2 / filtered**2 / nyquist  # |C S|^2 ~ (kp/(filtered omega))^2
    assert effort.noise_gain == pytest.approx(math.sqrt((np.pi * variance - tail) / nyquist), rel=1e-4)


def observed(plant, feedback, observer=OBSERVER):
    return observer_compensator(plant, 0.1, feedback_poles=feedback, observer_poles=observer)


@pytest.mark.parametrize(("make", "match"), [
    (lambda g: fundamental_limits(g, -1.0), "dead time: -1 s"),
    (lambda g: fundamental_limits(g, math.nan), "dead time: nan"),
    (lambda g: fundamental_limits(g, 0.1, lag=-0.5), "lag: -0.5 s"),
    (lambda g: fundamental_limits(g, 0.1, lag=0.5), "lag: 0.5 s is not in the plant"),
    (lambda g: fundamental_limits(g, 0.1, allowed_lag_deg=180.0), "allowed lag: 180 deg"),
    (lambda g: QuasiPolynomial([[1.0, np.inf]], 0.1), "not finite"),
    (lambda g: QuasiPolynomial([[1.0, 0.0]], -0.1), "delay"),
    (lambda g: QuasiPolynomial([[1.0, 0.0], [0.5, 0.0]], 0.1).count_right(), "neutral"),
    (lambda g: DelayedLoop(DelayedRatio(*[QuasiPolynomial([[1.0, 1.0]], 0.1)] * 2)), "tend to 0"),
    (lambda g: smith_predictor(g, -0.1, PI_LEAD), "dead time: -0.1 s"),
    (lambda g: smith_predictor(Rational([], [], 1.0), 0.1, Rational([], [], 1.0)), "strictly proper"),
    (lambda g: filtered_smith_predictor(g, 0.1, PI_LEAD, filter_time=0.0), "filter time: 0 s"),
    (lambda g: filtered_smith_predictor(g, 0.1, PI_LEAD, filter_time=0.1, roll_off=-1), "roll-off: -1"),
    (lambda g: filtered_smith_predictor(Rational([], [0.5, 0.5], 1.0), 0.1, PI_LEAD, filter_time=0.1), "coincide"),
    (lambda g: observed(g, [-1]), "1 given; give 4"),
    (lambda g: observed(g, [0.1, -1, -1, -1]), "not all left"),
    (lambda g: observed(g, FEEDBACK, [-1, -2 + 1j, -2]), "conjugate pairs"),
    (lambda g: observed(Rational([-2.0], [-1.0], 1.0), [-1, -2], [-3]), "not strictly proper"),
    (lambda g: observed(Rational([0.0], [-1.0, 0.5], 1.0), [-1, -2, -3], [-3, -4]), "not reachable"),
    (lambda g: control_effort(PI_LEAD, g, -0.1, lag=0.6), "dead time: -0.1 s"),
    (lambda g: control_effort(PI_LEAD, g, TAU, lag=math.inf), "lag: inf"),
    (lambda g: control_effort(PI_LEAD, g, TAU, lag=0.6, sampling_period=0.0), "sampling period: 0 s"),
])  # fmt: skip
def test_what_is_refused(make, match):
    with pytest.raises(InputError, match=match):
        make(actuated())
