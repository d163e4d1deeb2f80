"""Published and independently computed loops, exact dead time, loops once answered wrongly or refused; certificates."""

import itertools
import math
from dataclasses import replace
from types import SimpleNamespace

import control as ct
import numpy as np
import pytest
import random_loops
from loop_checker import poles_right, refused
from scipy import signal
from scipy.optimize import brentq
from scipy.optimize.elementwise import find_root
from scipy.special import lambertw

from railslip_ctrl import DeadTimeLoop, InputError, Rational, UnstableLoopError
from railslip_ctrl.loop import stability
from railslip_ctrl.loop.certificate import CertificateError, certify
from railslip_ctrl.loop.crossings import Response, bracketed_roots, monotone_root
from railslip_ctrl.loop.margins import _PeakSearch, by_distance, heights
from railslip_ctrl.loop.rational import fraction, nearest_double, pade

S = ct.tf("s")
MODES = Rational([0.5, -2 + 3j, -2 - 3j], [0.3, -0.1 + 4j, -0.1 - 4j, 0.2 + 1j, 0.2 - 1j], 3.0)


def printed(value: float, *, places: int | None = None):
    digits = f"{value!r}".rstrip("0").partition(".")[2]
    return pytest.approx(value, abs=0.5001 * 10.0 ** -(len(digits) if places is None else places), rel=0)


MATLAB = {
    "gain_increase": printed(3.6, places=4),
    "gain_increase_frequency": printed(3.1623),
    "gain_decrease": 0.0,
    "phase_deg": printed(29.1104),
    "phase_frequency": printed(1.7844),
    "delay_s": printed(0.2847),
    "disk": printed(0.4580925),  # RobustAndOptimalControl.jl's 0.458145 is a grid value
    "disk_phase_deg": printed(25.8017),
    "disk_gain_range": pytest.approx((0.6273, 1.5942), abs=0.5001e-4),
    "disk_frequency": printed(1.95503),
}
"""MATLAB's page of allmargin, and RobustAndOptimalControl.jl."""
UNSTABLE_PLANT = {
    **{"gain_decrease": printed(0.234619891262), "gain_decrease_frequency": printed(0.208677852)},
    **{"gain_increase": printed(4.39578339078), "gain_increase_frequency": printed(2.73581826)},
    **{"phase_deg": printed(29.2144640746), "phase_frequency": printed(1.00493595554)},
    **{"delay_s": printed(0.507384161643), "ms": printed(2.21149397822), "mt": printed(1.98840564198)},
    "disk": printed(0.507978316),
}
"""1.2 (8 s + 1)/(8 s) * 1/(s - 0.25) * exp(-0.15 s)/(0.6 s + 1)."""


def test_margins_of_printed_loops():
    unstable = DeadTimeLoop(1.2 * (8 * S + 1) / (8 * S) / (S - 0.25) / (0.6 * S + 1), dead_time=0.15)
    assert (unstable.is_stable(), unstable.open_loop_unstable_poles) == (True, 1)
    ends = np.array([UNSTABLE_PLANT["gain_decrease"].expected, UNSTABLE_PLANT["gain_increase"].expected])
    for factor in (1.0, 0.1, 20.0):  # the gains that stabilise, of what is stable and of what is not
        assert unstable.scaled(factor).stabilizing_gain_range == pytest.approx(ends / factor, rel=1e-10)
    for loop, expected in ((DeadTimeLoop(25 / (S**3 + 10 * S**2 + 10 * S + 10)), MATLAB), (unstable, UNSTABLE_PLANT)):
        assert {name: getattr(loop.margins(), name) for name in expected} == expected


def test_of_intervals_of_gain_that_which_holds_1_comes_first_and_then_the_nearest():
    assert [one for one, _ in by_distance([0.9, 1.05], range(3))] == [(0.9, 1.05), (1.05, math.inf), (0.0, 0.9)]


def test_lambert_w_poles_of_the_delayed_integrator():
    # s + exp(-s) = 0 is s = W_k(-1): an independent closed form
    found = DeadTimeLoop(1 / S, dead_time=1.0).closed_loop_poles(count=6)
    for branch in (lambertw(-1, k) for k in (0, -1, 1, -2, 2, -3)):
        assert np.min(np.abs(found - branch)) < 1e-12
    assert found[0] == pytest.approx(-0.3181 + 1.3372j, abs=1e-4)


@pytest.mark.parametrize("gain", [0.4, -3.0])
def test_poles_without_dead_time_of_a_loop_that_passes_all_frequencies(gain):
    # gain (s^8 + 1)/(s^8 + 256)
    turns = np.exp(1j * np.pi * np.arange(1, 16, 2) / 8)
    poles = stability.rightmost_poles(Rational(turns, 2 * turns, gain), 0.0, 9)
    assert poles**8 == pytest.approx(np.full(8, -(256 + gain) / (1 + gain)), rel=1e-12)
    assert np.abs(np.diff(np.sort(np.angle(poles)))) == pytest.approx(np.full(7, np.pi / 4))
    assert list(stability.rightmost_poles(Rational(turns[:0], np.array([0.0, -1.0]), 0.0), 1.0, 9)) == [0, -1]


def test_poles_that_the_root_count_contradicts_are_not_returned(monkeypatch):
    monkeypatch.setattr(stability, "count_right_of", lambda *_: SimpleNamespace(marginal=False, right=7.0))
    with pytest.raises(stability.SpectrumError, match=r"root count"):
        DeadTimeLoop(1 / S, 1.0).closed_loop_poles(2)


def test_pade_of_order_2_is_its_closed_form_and_the_limit_the_exact_loop():
    x = np.array([0.6j, 0.3, -1.0])
    assert pade(0.3, 2)(x / 0.3) == pytest.approx((12 - 6 * x + x * x) / (12 + 6 * x + x * x), rel=1e-14)
    assert pade(0.0, 2)(x) == pytest.approx(1.0)
    assert pade(0.3, 100)(x / 0.3) == pytest.approx(np.exp(-x), rel=1e-12)
    loop = DeadTimeLoop(1.2 * (8 * S + 1) / (8 * S) / (S - 0.25) / (0.6 * S + 1), dead_time=0.15)
    for order, tolerance in [(1, 1e-1), (3, 1e-4), (5, 1e-8)]:
        assert loop.pade(order).margins().gain_increase == pytest.approx(loop.margins().gain_increase, rel=tolerance)
    for dead_time, order in ((-0.3, 2), (0.3, 0), (0.3, 101)):
        with pytest.raises(InputError, match="not allowed"):
            pade(dead_time, order)


@pytest.mark.parametrize(("system", "dead_time"), [
    (1e-3 / (S + 1) + 0.0085 * 0.2 * S / (S**2 + 0.2 * S + 1e4), 10.0),  # a resonance far below unit gain
    (0.95 * 0.02 * S / (S**2 + 0.02 * S + 1), 4e4),  # 6000 turns of dead time before the resonance
    (0.95 * 0.02 * S / (S**2 + 0.02 * S + 1), 1e5),
])  # fmt: skip
def test_gain_increase_behind_very_many_phase_crossovers(system, dead_time):
    loop = DeadTimeLoop(system, dead_time)
    m = loop.margins()
    assert loop.scaled(m.gain_increase * (1 - 1e-6)).is_stable()
    assert not loop.scaled(m.gain_increase * (1 + 1e-6)).is_stable()
    assert m.gain_increase >= m.ms / (m.ms - 1) * (1 - 1e-9)  # what Ms guarantees


def test_a_real_pole_through_infinity_bounds_the_gain_and_a_positive_gain_there_does_not():
    # s (1 - 2k) + 10 - 2k: stable for k < 1/2 and k > 5, and 1/2 is nearer to 1 in ratio
    assert DeadTimeLoop(-2 * (S + 1) / (S + 10)).stabilizing_gain_range == pytest.approx((0.0, 0.5))
    assert DeadTimeLoop(-12 * (S + 1) / (S + 10)).stabilizing_gain_range == pytest.approx((10 / 12, np.inf))
    positive = DeadTimeLoop(Rational([-0.5, -3.0], [-1.0, -2.0], 2.0))
    assert (positive.margins().gain_increase, positive.delayed(0.1).is_stable()) == (np.inf, False)


def test_static_loops_and_ill_posed_ones():
    for system in (1.0, ct.tf([1], [1]), ct.ss([], [], [], [[1]])):
        assert DeadTimeLoop(system).margins().ms == pytest.approx(0.5)
    for loop in (DeadTimeLoop(-1.0), DeadTimeLoop((1 - S) / (1 + S))):
        assert not loop.is_well_posed
        with pytest.raises(UnstableLoopError, match="not well posed"):
            loop.margins()
        with pytest.raises(InputError, match="not well posed"):
            loop.closed_loop_poles()


@pytest.mark.parametrize(("system", "dead_time", "count"), [
    *((MODES, tau, 20) for tau in (0.1, 0.7, 2.0)),
    (2 / ((S + 1) * (S + 2)), 1e-5, 6),
    (1e-6 / ((S - 1) * (S + 2) * (S + 3)), 0.1, 6),
    (0.4431 / (S - 5.041), 3.195, 6),
    (2 / S, 0.3, 200),
    (2 / S, 1e-9, 4),
    (2 / ((S + 1) * (S + 2)), 100.0, 8),
])  # fmt: skip
def test_rightmost_poles_over_many_scales(system, dead_time, count):
    loop = DeadTimeLoop(system, dead_time)
    poles, system = loop.closed_loop_poles(count), loop.system
    assert poles.size == count
    assert np.count_nonzero(poles.real > 0) == min(count, loop.unstable_closed_loop_poles)
    assert np.all(np.diff(poles.real) <= 1e-12 * (1 + np.abs(poles.real[:-1])))
    for s in poles:  # of D(s) + N(s) exp(-tau s)
        d, n = np.prod(s - system.poles), system.gain * np.prod(s - system.zeros) * np.exp(-s * dead_time)
        assert abs(d + n) <= 1e-8 * (abs(d) + abs(n))  # of a pole next to one of L both are small


def test_poles_of_neutral_loops_lie_on_their_chain():
    static = DeadTimeLoop(0.5, 1.0).closed_loop_poles(4)
    assert static == pytest.approx(np.log(0.5) + np.array([1j, -1j, 3j, -3j]) * np.pi)  # 1 + exp(-s)/2 = 0
    loop = DeadTimeLoop(0.9 * (S + 0.1) / (S + 1), 1.0)
    for pole in loop.closed_loop_poles(4):
        assert abs(1 + 0.9 * (pole + 0.1) / (pole + 1) * np.exp(-pole)) < 1e-9


def test_a_touch_of_unit_gain_is_no_crossing():
    for dead_time in (0.0, 0.4, 4.0):  # |L| is 1 at 1 rad/s and less elsewhere, and L is not -1
        loop = DeadTimeLoop(0.25 * S / (S**2 + 0.25 * S + 1), dead_time)
        assert (loop.root_count.right, loop.gain_crossovers) == (0, pytest.approx([1.0], rel=1e-15))


@pytest.mark.parametrize("velocity", [2.0, 1e6, 3e16, 1e18])
def test_any_velocity_constant(velocity):
    # s + k exp(-s): a pair crosses at each k = pi/2 + 2 pi n
    loop = DeadTimeLoop(ct.tf([velocity], [1, 0]), 1.0)
    assert loop.unstable_closed_loop_poles == pytest.approx(2 * ((velocity - np.pi / 2) // (2 * np.pi) + 1), rel=1e-15)
    margins = DeadTimeLoop(ct.tf([velocity], [1, 0])).margins()
    assert margins.delay_s == pytest.approx(np.pi / 2 / velocity, rel=1e-15)


def test_margins_that_rounding_of_the_phase_would_blur():
    # arg L + 180 deg = w/a - tau w to first order, from numbers near 90 deg: w = sqrt(a/tau) at the phase crossover
    pole, dead_time, gain = 34.71239946735765, 1.5378576654320126e-16, 1.2966870873929182e16
    margins = DeadTimeLoop(Rational([], [0.0, -pole], gain), dead_time).margins()
    crossing = brentq(lambda w: np.arctan2(pole, w) - dead_time * w, 1e7, 1e12, xtol=1e-9, rtol=1e-15)
    assert margins.gain_increase == pytest.approx(crossing * np.hypot(crossing, pole) / gain, rel=1e-13)
    omega = margins.phase_frequency
    assert margins.phase_deg == pytest.approx(np.degrees(np.arctan2(pole, omega) - dead_time * omega), rel=1e-13)


@pytest.mark.parametrize("kind", random_loops.KINDS)
def test_root_counts_and_gain_ranges_of_random_loops(kind):
    for zeros, poles, gain, dead_time in random_loops.loops(kind, 8):
        loop = DeadTimeLoop(Rational(zeros, poles, gain), dead_time)
        told, usable = loop.root_count, loop.stabilizing_gain_range
        try:
            assert (poles_right(zeros, poles, gain, dead_time), False) == (told.right, told.marginal)
        except ArithmeticError:
            assert told.marginal
        if usable is None:
            continue
        for near, stable in ((1e-9, True), (-1e-9, False)):
            for factor in {usable[0] * (1 + near), usable[1] * (1 - near)} - {0.0, np.inf}:
                assert (poles_right(zeros, poles, gain * factor, dead_time) == 0) == stable


@pytest.mark.parametrize(("zeros", "poles", "gain", "value"), [
    *(([-1.0], [0.0, -2.0], 3.0, np.inf), ([0.0], [-1.0, -2.0], 3.0, 0.0), ([0.0], [0.0, -2.0], 3.0, np.nan)),
    *(([-1.0], [-4.0, -2.0], 3.0, 0.375), ([], [0.0], 0.0, np.nan)),
])  # fmt: skip
def test_the_gain_at_zero(zeros, poles, gain, value):
    assert Rational(zeros, poles, gain).dc_gain == pytest.approx(value, nan_ok=True)


ROOTS, LOW, HIGH = np.array([1e-3, 0.7, 1.0, 3.0, 999.0]), np.full(5, 5e-4), np.full(5, 2e3)


@pytest.mark.parametrize(("shape", "slope", "most"), [  # f of x/root, and the most evaluations of Newton's method
    (lambda r: r**3 - 1, lambda r: 3 * r**2, 12),
    (lambda r: np.expm1(np.minimum(40 * (r - 1), 300)), lambda r: 40 * np.exp(40 * (r - 1).clip(max=7)), 19),
    (lambda r: np.where(r < 1, -1.0, 1.0), np.zeros_like, 57),  # which halving alone finds
], ids=["cube", "steep", "step"])  # fmt: skip
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_bracketed_roots_to_the_last_bits_in_few_evaluations(shape, slope, most, sign):
    evaluated = np.zeros(ROOTS.size, dtype=int)

    def function(x, index):
        evaluated[index] += 1
        return sign * shape(x / ROOTS[index]), sign * slope(x / ROOTS[index]) / ROOTS[index]

    found = bracketed_roots(lambda x, index: function(x, index)[0], LOW, HIGH)
    assert found == pytest.approx(ROOTS, rel=5e-16)
    by_scipy = find_root(lambda x, root: shape(x / root), (LOW, HIGH), args=(ROOTS,))  # the same method
    assert np.all(evaluated <= by_scipy.nfev + 2)
    evaluated[:] = 0
    with np.errstate(over="ignore"):
        alone = [monotone_root(lambda x, i=i: function(x, i), 1.3, 5e-4, 2e3, -sign) for i in range(5)]
    assert alone == pytest.approx(ROOTS, rel=5e-16)
    assert evaluated.max() <= most


def test_ends_of_a_bracket_and_open_brackets():
    # a zero at an end, no change of sign, none at all; values at the ends that are known are not asked for again
    low, high, asked = np.array([1.0, -2.0, 3.0, 0.5]), np.array([4.0, 1.0, 5.0, 2.0]), []
    found = bracketed_roots(lambda x, _: asked.extend(x) or x - 1.0, low, high, ends=(low - 1.0, high - 1.0))
    assert found == pytest.approx([1.0, 1.0, 3.0, 1.0], rel=5e-16)
    assert 0.5 < min(asked) <= max(asked) < 2.0
    assert bracketed_roots(lambda x, _: x, np.zeros(0), np.zeros(0)).size == 0
    for root, start in ((1e-9, 1e3), (2.0, 1.0), (5e7, 1e-2)):  # 0 to infinity, from guesses decades off
        found = monotone_root(lambda x, root=root: (math.log(x / root), 1.0 / x), start, 0.0, math.inf, -1.0)
        assert found == pytest.approx(root, rel=5e-16)


@pytest.mark.parametrize(("system", "count"), [
    (4 / (S**2 + 1), 2),  # undamped stays undamped
    (1 / S**2, 2),
    (-1 / (S + 1), 1),  # a pole at the origin
    (S / (S * (S + 1)), 1),  # a hidden integrator
    ((S - 1) / ((S - 1) * (S + 1)), 1),
    (ct.ss([[-1, 0], [0, 0.5]], [[1], [0]], [[1, 1]], 0), 1),  # 0.5 is not reached by the input
])  # fmt: skip
def test_poles_on_the_axis_and_hidden_unstable_ones_are_not_stable(system, count):
    loop = DeadTimeLoop(system)
    assert (loop.is_stable(), loop.unstable_closed_loop_poles) == (False, count)
    with pytest.raises(UnstableLoopError, match=r"on the imaginary axis|unstable with 1"):
        loop.margins()


def test_neutral_loop_is_decided_by_its_chain():
    stable = DeadTimeLoop(0.5 * (S + 2) / (S + 1), dead_time=1.0)
    assert stable.is_stable()
    assert stable.margins().gain_increase <= 2.0  # at 1/|G(inf)| the chain reaches the axis
    chain = DeadTimeLoop(1.1 * (S + 2) / (S + 1), dead_time=1.0)
    low, high = chain.stabilizing_gain_range
    assert (chain.unstable_closed_loop_poles, low, high < 1 / 1.1) == (np.inf, 0.0, True)
    with pytest.raises(UnstableLoopError, match="infinitely many"):
        chain.margins()
    with pytest.raises(InputError, match=r"\|G\(inf\)\| = 1\.1 >= 1"):
        chain.closed_loop_poles()
    # without dead time a gain > 1 at infinity is fine, but any dead time destroys it
    assert DeadTimeLoop(3 * (S + 2) / (S + 1)).margins().delay_s == 0.0


@pytest.mark.parametrize(("system", "dead_time", "match"), [
    (1 / S, -0.1, "dead time: -0.1"),
    (1 / S, float("nan"), "dead time: nan"),
    (S, 0.0, "not proper"),
    (ct.tf([1], [1, 0.5], dt=0.1), 0.0, "discrete-time"),
    (ct.ss(np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2))), 0.0, "not SISO"),
    ("1/s", 0.0, "str is not a linear system"),
    (ct.tf([float("nan")], [1, 1]), 0.0, "not finite"),
    (float("inf"), 0.0, "not finite"),
    (signal.ZerosPolesGain([], [-1 + 1j], 1), 0.0, "conjugate"),
    (ct.frd([1, 2, 3], [1, 2, 3]), 0.0, "not a linear system"),
])  # fmt: skip
def test_unsuitable_systems_are_refused(system, dead_time, match):
    with pytest.raises(InputError, match=match):
        DeadTimeLoop(system, dead_time)


MARGINS = ("gain_increase", "gain_decrease", "phase_deg", "delay_s", "ms", "mt")
PER_KIND = 6


def made(zeros, poles, gain, dead_time):
    return DeadTimeLoop(Rational(zeros, poles, gain), dead_time)


@pytest.fixture(scope="module")
def certified():
    """Stable loops of every kind, as (kind, parameters, loop, certificate)."""
    found = []
    for kind in random_loops.KINDS:
        stable = (one for one in random_loops.loops(kind, 100) if made(*one).is_stable())
        found += [(kind, one, made(*one), made(*one).certificate()) for one in itertools.islice(stable, PER_KIND)]
    return found


def test_the_checker_accepts_certificates(certified):
    assert len(certified) == PER_KIND * len(random_loops.KINDS)
    for kind, one, _, certificate in certified[::PER_KIND]:  # the checker takes up to a second
        assert (certificate.stable, certificate.unstable_poles) == (True, 0)
        assert refused(*one, certificate) == [], (kind, one, certificate)


def test_the_checker_refuses_a_certificate_with_a_margin_moved(certified):
    # by a millionth, a thousand times the width of an enclosure
    _, one, _, certificate = next(one for one in certified if one[0] is random_loops.wheel_slip)
    for name, factor in zip(MARGINS, (1 - 1e-6, 1 + 1e-6) * 3, strict=True):
        low, high = getattr(certificate, name)
        moved = replace(certificate, **{name: (low * factor, high * factor)})
        assert refused(*one, moved), (name, factor)


@pytest.mark.parametrize("name", ["ms_frequency", "mt_frequency"])
def test_a_peak_that_another_part_of_the_axis_exceeds_is_not_certified(name, monkeypatch):
    monkeypatch.setattr("railslip_ctrl.loop.certificate._MOST_PARTS", 300)
    loop = made([-0.125], [0.0, 0.25, -1 / 0.6], 2.0, 0.15)
    with pytest.raises(CertificateError):
        certify(loop._response, replace(loop.margins(), **{name: math.inf}))


def test_enclosures_are_narrow_and_hold_the_margins(certified):
    for kind, one, loop, certificate in certified:
        margins = loop.margins()
        for name in MARGINS:
            (low, high), value = getattr(certificate, name), getattr(margins, name)
            assert high == low or high - low <= 1e-9 * abs(high)
            # peaks are evaluated in balls; 1e-12: what refined doubles promise
            slack = 0.0 if name in ("ms", "mt") else 1e-12
            assert low * (1 - slack) <= value <= high * (1 + slack), (kind, one, name)


def test_unstable_loops_have_their_poles_counted_and_no_margins():
    for kind in random_loops.KINDS:
        unstable = (one for one in random_loops.loops(kind, 100) if not made(*one).is_stable())
        for one in itertools.islice(unstable, 2):
            certificate = made(*one).certificate()
            assert (certificate.stable, certificate.unstable_poles) == (False, poles_right(*one)), (kind, one)
            assert all(getattr(certificate, name) is None for name in MARGINS)


def test_a_loop_without_gain_and_one_of_next_to_none_are_certified():
    none = DeadTimeLoop(Rational([], [-1.0], 0.0), 1.0).certificate()
    assert (none.stable, none.ms, none.mt, none.gain_increase) == (True, (1.0, 1.0), (0.0, 0.0), (np.inf, np.inf))
    least = DeadTimeLoop(Rational([], [-1.0], 1e-150), 1.0)
    low, high = least.certificate().gain_increase
    most = np.hypot(1, brentq(lambda w: np.arctan(w) + w - np.pi, 1.0, 3.0, xtol=1e-15)) * 1e150
    assert low * (1 - 1e-14) <= most <= high * (1 + 1e-14)  # rounding of brentq's omega
    assert least.margins().mt == pytest.approx(1e-150)
    # no dead time may be added to a loop of gain above one at infinity
    assert made([-0.5], [-1.0], 2.0, 0.0).certificate().delay_s == (0.0, 0.0)
    assert made([-0.5], [-1.0], 0.5, 0.1).certificate().delay_s == (np.inf, np.inf)  # |L| < 1 everywhere


def companion(num, den):
    """A realisation of num/den, den monic and of the higher degree."""
    order = len(den) - 1
    a = np.vstack([-np.array(den[1:], dtype=float), np.eye(order)[:-1]])
    return ct.ss(a, np.eye(order)[:, :1], np.array([[0.0] * (order - len(num)) + list(num)]), 0.0)


@pytest.mark.parametrize(("num", "den", "dead_time"), [
    *(([-1], [1, 3, 1], 0.0), ([-1], [1, 3, 1], 0.1), ([1, -1], [1, 3, 1], 0.1), ([-1], [1, 0.3, 1], 0.1)),
    *(([-1], [1, 4, 2, 1], 0.2), ([-3], [1, 7, 5, 3], 0.0), ([-1], [1, 7, 1], 0.5), ([-2], [1, 5, 3, 2], 0.2)),
    *(([3], [1, 1, 3, 0], 0.0), ([1, 0, 2], [1, 3, 2, 6], 0.3)),  # +-j sqrt 3; a hidden +-j sqrt 2
])  # fmt: skip
@pytest.mark.parametrize("form", [ct.tf, companion], ids=["tf", "ss"])
def test_coefficients_that_put_a_pole_on_the_axis_are_told(num, den, dead_time, form):
    certificate = DeadTimeLoop(form(num, den), dead_time).certificate()
    assert (certificate.stable, certificate.marginal) == (False, True)
    assert certificate.unstable_poles >= 1


@pytest.mark.parametrize("dead_time", [0.0, 0.1, 1.0])
@pytest.mark.parametrize("den", [[1, 3, 1], [1, 5, 11, 1]])
def test_the_last_bit_of_a_coefficient_decides(den, dead_time):
    # D(0) + N(0) changes its sign; up to there |L| < 1, and the real pole through the origin is the first
    for gain, stable in ((np.nextafter(1.0, 0.0), True), (1.0, False), (np.nextafter(1.0, 2.0), False)):
        loop = DeadTimeLoop(ct.tf([-gain], den), dead_time)
        assert loop.certificate().stable is loop.is_stable() is stable
        if stable:
            assert loop.margins().ms == 2.0**53
            assert loop.certificate().gain_increase[0] >= 1


@pytest.mark.parametrize(("zeros", "poles", "gain", "margins"), [
    # S = (s - 1/4)/(s + 1/4): |S| is 1 everywhere
    ([], [0.25], 0.5, {"ms": 1.0, "mt": 2.0, "gain_decrease": 0.5, "phase_deg": 60.0}),
    # S and T have their peaks at omega^2 = 7/8, where L is real: a phase crossover at an extremum
    ([0.0], [0.875, 1.0], 2.625, {"ms": 2.5, "mt": 3.5, "gain_decrease": 5 / 7, "gain_increase": np.inf}),
])  # fmt: skip
def test_peaks_without_dead_time_in_closed_form(zeros, poles, gain, margins):
    for loop in (made(zeros, poles, gain, 0.0), DeadTimeLoop(ct.tf(gain * np.poly(zeros), np.poly(poles)))):
        certificate = loop.certificate()
        for name, value in margins.items():
            low, high = getattr(certificate, name)
            assert low * (1 - 1e-15) <= value <= high * (1 + 1e-15), name  # rounding of the closed form
            assert getattr(loop.margins(), name) == pytest.approx(value, rel=1e-15), name


@pytest.mark.parametrize("kind", ["wheel_slip", "many_crossovers", "gain_one_at_zero"])
def test_only_parts_of_the_axis_below_the_peaks_are_shown_to_be(kind):
    rng, shown = np.random.default_rng(5), 0
    for zeros, poles, gain, dead_time in random_loops.loops(getattr(random_loops, kind), 40):
        response = Response(Rational(zeros, poles, gain), dead_time or 0.1)
        for middle, half in zip(10 ** rng.uniform(-2, 2, 40), 10 ** rng.uniform(-2, 0, 40), strict=True):
            low, high = (middle * math.exp(-half) if rng.random() < 0.8 else 0.0), middle * math.exp(half)
            tops = heights(response(np.linspace(low, high, 402)[1:])).max(axis=1)
            for factor in (rng.uniform(0.97, 0.999), 1.1):
                search = _PeakSearch(response, [(factor * top, 1.0) for top in tops.tolist()])
                around = search._expanded(low, high)
                below = [one for one in range(3) if around is not None and search._positive(one, around)]
                assert factor > 1 or not below
                shown += len(below)
    assert shown > 300


def test_a_fraction_becomes_the_double_nearest_to_it():
    for value in (1 / 3, -2.5, 1e-300, 6.02e23, 5e-324, 0.0):
        assert nearest_double(fraction(value)) == value
    third = fraction(1.0) / fraction(3.0)
    assert (nearest_double(third), nearest_double(-third)) == (1 / 3, -1 / 3)
