"""What the engine decides with: extrema, bounds over parts of the axis, against sampling; many bracketed roots."""

from __future__ import annotations

import math

import numpy as np
import pytest
import random_loops
from flint import arb
from scipy.optimize.elementwise import find_root

from railslip_ctrl.loop import DeadTimeLoop, Rational
from railslip_ctrl.loop.certificate import _least_square
from railslip_ctrl.loop.crossings import (
    PHASE,
    SIZE,
    Response,
    bracketed_roots,
    frequency_nodes,
    monotone_root,
    pieces,
)
from railslip_ctrl.loop.margins import _divided, _may_be_higher, _second_order_bounds, box_bounds


def responses(count):
    for seed in range(count):
        zeros, poles, gain, dead_time = random_loops.wheel_slip(np.random.default_rng(seed))
        yield Response(Rational(np.array(zeros), np.array(poles), gain), dead_time)
    pair = complex(-0.05, 1.0)
    yield Response(Rational(np.array([-0.3, -4.0]), np.array([0.0, pair, pair.conjugate(), -2.0]), 0.7), 0.4)


def shapes(response, omega):
    loop = response.value_and_slopes(omega.ravel())[0].reshape(omega.shape)
    return np.abs([1 / (1 + loop), loop / (1 + loop), 0.5 * (1 - loop) / (1 + loop)])


@pytest.mark.parametrize("kind", [SIZE, PHASE])
def test_extrema_are_where_the_slope_changes_sign(kind):
    for response in responses(8):
        omega = np.geomspace(1e-4, 1e4, 20_000)
        at = np.flatnonzero(np.diff(np.sign(getattr(response.log_slope(omega), "real" if kind == SIZE else "imag"))))
        found = np.array([float(w.mid()) for w, _ in response.exact.frequencies(kind)])
        assert found.size == at.size
        assert np.all((omega[at] <= found) & (found <= omega[at + 1]))


def test_bounds_hold_over_a_part_and_tighten_to_second_order():
    for response in responses(6):
        cut = pieces(response)
        middle = np.geomspace(0.05, 20, 60)
        for share, slack in ((0.1, np.inf), (1e-3, 1e-3), (1e-5, 1e-7)):
            low, high = middle * (1 - share), middle * (1 + share)
            within = low + (high - low) * np.linspace(0, 1, 101)[:, None]
            most = shapes(response, within).max(axis=1)
            bounds, _ = _second_order_bounds(response, low, high)
            assert np.all(bounds >= most * (1 - 1e-12))  # rounding
            assert np.all(bounds <= most * (1 + slack))
            # on parts without an edge inside, where |L| and the phase are monotone
            own = np.searchsorted(cut.low, low) == np.searchsorted(cut.low, high)
            boxes = box_bounds(*cut.ends(response, low[own], high[own]))
            assert np.all(boxes >= most[:, own] * (1 - 1e-12))
            assert np.all(boxes <= most[:, own] * (1 + 200 * share))


def test_a_part_with_something_higher_is_not_dismissed():
    for response in responses(6):
        cut = pieces(response)
        edges = np.union1d(np.geomspace(0.01, 100, 400), cut.low[cut.low > 0])
        low, high = edges[:-1], edges[1:]
        most = shapes(response, low + (high - low) * np.linspace(0, 1, 201)[:, None]).max(axis=1)
        for share in (0.5, 0.9, 1 - 1e-6):
            best = [(share * peak, 1.0) for peak in most.max(axis=1)]
            higher = np.any(most > np.array([[peak] for peak, _ in best]), axis=0)
            for bounds, rounding in (
                _second_order_bounds(response, low, high),
                (box_bounds(*cut.ends(response, low, high)), response.rounding(0.0)),
            ):
                assert np.all(_may_be_higher(bounds, rounding, best)[higher])


def test_a_part_whose_corner_is_next_to_minus_one_is_not_dismissed():
    # at 180 deg to rounding, |L| from 1/2 to 2: its bounds near 1e16 are no rounding of the best
    bounds = box_bounds(np.log([[0.5], [2.0]]), np.array([[-1.0 + 2e-16], [-0.9]]))
    assert np.all(bounds > 1e14)
    assert _may_be_higher(bounds, 1e-14, [(2.0, 1.0)] * 3).all()


def test_nodes_reach_four_decades_beyond_every_feature():
    for response in responses(3):
        roots = np.abs(np.concatenate([response.system.zeros, response.system.poles]))
        scales = np.concatenate([roots[roots > 0], response.gain_crossovers, [1 / response.dead_time]])
        nodes = frequency_nodes(response)
        # the closest to an end lies within its spacing, 16 a decade
        assert nodes[0] == pytest.approx(1e-4 * scales.min(), rel=0.16)
        assert nodes[-1] == pytest.approx(1e4 * scales.max(), rel=0.16)


def test_frequencies_of_any_shape():
    response = next(responses(1))
    omega = np.array([[0.3, 0.7, 1.1], [1.3, 2.0, 5.0]])
    for function in (response.angle, response.log_slope, response.system.log_size):
        assert function(omega) == pytest.approx(np.array([[function(np.array([w]))[0] for w in row] for row in omega]))


def test_nodes_close_in_on_a_resonance():
    for width in (1e-2, 1e-5):
        pair = complex(-width, 1.0)
        nodes = frequency_nodes(Response(Rational([], [pair, pair.conjugate(), -3.0], 1.0), 0.1))
        away = np.sort(nodes[nodes > 1.0] - 1.0)
        near = away[away < 0.5]
        assert near[0] < 0.1 * width
        assert np.max(near[1:] / near[:-1]) < 1.4  # eight a decade, over one decade and a third more


@pytest.mark.parametrize(
    ("zeros", "poles", "gain", "value"),
    [
        ([-1.0], [0.0, -2.0], 3.0, np.inf),
        ([0.0], [-1.0, -2.0], 3.0, 0.0),
        ([0.0], [0.0, -2.0], 3.0, np.nan),
        ([-1.0], [-4.0, -2.0], 3.0, 0.375),
        ([], [0.0], 0.0, np.nan),
    ],
)
def test_the_gain_at_zero(zeros, poles, gain, value):
    assert Rational(zeros, poles, gain).dc_gain == pytest.approx(value, nan_ok=True)


def test_divided_parts_leave_no_gap():
    for response in responses(3):
        low, high = np.array([0.0, 0.5, 2.0]), np.array([0.2, 2.0, np.inf])
        below, above = _divided(response, low, high)
        assert np.all(below < above)
        joined = np.flatnonzero(below[1:] != above[:-1])
        assert (below[0], above[joined].tolist(), below[joined + 1].tolist(), above[-1]) == (0, [0.2], [0.5], np.inf)


@pytest.mark.parametrize("sizes", [(0.2, 0.7), (0.7, 0.2), (1.2, 3.0), (0.5, np.inf), (np.inf, 0.5)])
@pytest.mark.parametrize("c", [-1.0, 0.3, 0.6, 1.0])
def test_the_least_distance_from_minus_one_over_an_interval_of_sizes(sizes, c):
    # of m exp(j phi) with -cos(phi) <= c
    m = np.linspace(min(sizes), min(max(sizes), 50.0), 100_001)
    least = np.min(1 + m * (m - 2 * c))
    assert float(_least_square([arb(one) for one in sizes], arb(c)).mid()) == pytest.approx(least, abs=1e-8)


def test_a_positive_gain_at_infinity_limits_no_gain_without_dead_time():
    loop = DeadTimeLoop(Rational([-0.5, -3.0], [-1.0, -2.0], 2.0))
    assert loop.margins().gain_increase == np.inf
    assert loop.delayed(0.1).is_stable() is False


# -- many bracketed roots: to the last bits, each of its own function, in few evaluations -------------------------

ROOTS = np.array([1e-3, 0.7, 1.0, 3.0, 999.0])
LOW, HIGH = np.full(5, 5e-4), np.full(5, 2e3)
SHAPES = {
    # f of x/root, its slope, and the most evaluations of Newton's method in this bracket, a factor of 4e6
    "cube": (lambda r: r**3 - 1, lambda r: 3 * r**2, 12),
    "logarithm": (np.log, lambda r: 1 / r, 10),
    "steep": (lambda r: np.expm1(np.minimum(40 * (r - 1), 300)), lambda r: 40 * np.exp(40 * (r - 1).clip(max=7)), 19),
    "step": (lambda r: np.where(r < 1, -1.0, 1.0), np.zeros_like, 57),  # which halving alone finds
}


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("name", SHAPES)
def test_roots_to_the_last_bits_in_few_evaluations(name, sign):
    shape, slope, most = SHAPES[name]
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


def test_ends_of_a_bracket():
    # a zero at an end, no change of sign, none at all; values at the ends that are known are not asked for again
    low, high = np.array([1.0, -2.0, 3.0, 0.5]), np.array([4.0, 1.0, 5.0, 2.0])
    asked = []
    found = bracketed_roots(lambda x, _: asked.extend(x) or x - 1.0, low, high, ends=(low - 1.0, high - 1.0))
    assert found == pytest.approx([1.0, 1.0, 3.0, 1.0], rel=5e-16)
    assert asked
    assert all(0.5 < x < 2.0 for x in asked)
    assert bracketed_roots(lambda x, _: x, np.zeros(0), np.zeros(0)).size == 0


def test_roots_in_an_open_bracket():
    # 0 to infinity, from guesses decades off
    roots, starts = (1e-9, 2.0, 5e7), (1e3, 1.0, 1e-2)
    found = [
        monotone_root(lambda x, root=root: (math.log(x / root), 1.0 / x), start, 0.0, math.inf, -1.0)
        for root, start in zip(roots, starts, strict=True)
    ]
    assert found == pytest.approx(roots, rel=5e-16)
