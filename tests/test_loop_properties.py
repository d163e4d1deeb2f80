"""The loop engine against decisions it does not share any code with.

The numbers of examples are twice those that noticed each of six faults put into the engine: a wrong branch of the
phase, sign, side of a root, imaginary part, crossing or delay margin. More where new ones are drawn.
"""

import os

import control as ct
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import signal

from railslip_ctrl import DeadTimeLoop, InputError, Rational, UnstableLoopError

S = ct.tf("s")
MORE = 5 if os.environ.get("HYPOTHESIS_PROFILE") == "explore" else 1


def rounded(low, high):
    """Four decimals: coincidences (hidden modes, poles on the axis) come up, denormal numbers do not."""
    return st.floats(low, high).map(lambda x: round(x, 4) + 0.0)


roots = st.one_of(
    rounded(-5, 3).map(lambda a: (a,)),
    st.tuples(rounded(-4, 2), rounded(0.05, 8)).map(lambda p: (complex(*p), complex(p[0], -p[1]))),
    st.just((0.0,)),
)


@st.composite
def random_loops(draw, *, max_factors=3):
    """Strictly proper loops of order up to 6, unstable and integrating ones included, with dead time."""
    poles = [p for pair in draw(st.lists(roots, min_size=1, max_size=max_factors)) for p in pair]
    zeros = [z for pair in draw(st.lists(roots, max_size=max_factors - 1)) for z in pair][: len(poles)]
    while len(zeros) >= len(poles) or abs(sum(np.imag(zeros))) > 1e-12:
        zeros.pop()
    gain = draw(st.sampled_from([1.0, -1.0])) * 10 ** draw(st.floats(-1.5, 1.5))
    return DeadTimeLoop(Rational(np.array(zeros), np.array(poles), gain), draw(rounded(0.0, 2.0)))


@settings(max_examples=32 * MORE)
@given(random_loops())
def test_each_margin_is_where_stability_is_lost(loop):
    assume(loop.is_stable())
    m = loop.margins()
    # where |L| only touches 1 a pole touches the axis and returns: stable on both sides
    assume(np.all(np.abs(loop.system.log_slope(m.gain_crossovers).real) > 1e-4))
    inside, outside = 1 - 1e-6, 1 + 1e-6
    if np.isfinite(m.gain_increase):
        assert loop.scaled(1 + (m.gain_increase - 1) * inside).is_stable()
        assert not loop.scaled(m.gain_increase * outside).is_stable()
    if m.gain_decrease > 0:
        assert loop.scaled(1 + (m.gain_decrease - 1) * inside).is_stable()
        assert not loop.scaled(m.gain_decrease * inside).is_stable()
    if np.isfinite(m.delay_s):
        assert loop.delayed(m.delay_s * inside).is_stable()
        assert not loop.delayed(m.delay_s * outside).is_stable()
    assert loop.stabilizing_gain_range == pytest.approx((m.gain_decrease, m.gain_increase), rel=1e-12)


@settings(max_examples=32 * MORE)
@given(random_loops())
def test_peaks_are_suprema_and_attained(loop):
    assume(loop.is_stable())
    m = loop.margins()
    low, high = loop.feature_band()
    omega = np.geomspace(low / 100, high * 10, 20_001)
    s, t = loop.sensitivity(omega), loop.complementary_sensitivity(omega)
    for peak, frequency, sampled, response in (
        (m.ms, m.ms_frequency, s, loop.sensitivity),
        (m.mt, m.mt_frequency, t, loop.complementary_sensitivity),
        (1 / m.disk, m.disk_frequency, s - 0.5, lambda w: loop.sensitivity(w) - 0.5),
    ):
        assert np.abs(sampled).max() <= peak * (1 + 1e-9)
        if 0 < frequency < np.inf:
            assert abs(response(np.array([frequency]))[0]) == pytest.approx(peak, rel=1e-9)


@settings(max_examples=16 * MORE)
@given(random_loops(max_factors=2))
def test_closed_loop_poles_solve_the_quasi_polynomial_and_are_rightmost(loop):
    assume(loop.dead_time > 1e-3 and not loop.root_count.marginal)
    poles, system = loop.closed_loop_poles(count=6), loop.system
    assert poles.size == 6
    assert np.all(np.diff(poles.real) <= 1e-12 * (1 + np.abs(poles.real[:-1])))
    assert loop.unstable_closed_loop_poles == np.count_nonzero(loop.closed_loop_poles(count=20).real > 0)
    for s in poles:
        d = np.prod(s - system.poles)
        n = system.gain * np.prod(s - system.zeros) * np.exp(-s * loop.dead_time)
        assert abs(d + n) <= 1e-9 * (abs(d) + abs(n))


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
    assert chain.unstable_closed_loop_poles == np.inf
    assert chain.stabilizing_gain_range[0] == 0.0
    assert chain.stabilizing_gain_range[1] < 1 / 1.1
    with pytest.raises(UnstableLoopError, match="infinitely many"):
        chain.margins()
    with pytest.raises(InputError, match="chain of poles"):
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
    (signal.ZerosPolesGain([], [-1 + 1j], 1), 0.0, "without their conjugates"),
    (ct.frd([1, 2, 3], [1, 2, 3]), 0.0, "not a linear system"),
])  # fmt: skip
def test_unsuitable_systems_are_refused(system, dead_time, match):
    with pytest.raises(InputError, match=match):
        DeadTimeLoop(system, dead_time)
