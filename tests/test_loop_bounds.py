"""What the engine decides with: the gain at zero, the least distance from -1, many bracketed roots."""

import math

import numpy as np
import pytest
from scipy.optimize.elementwise import find_root

from railslip_ctrl.loop import Rational
from railslip_ctrl.loop.crossings import bracketed_roots, monotone_root


@pytest.mark.parametrize(("zeros", "poles", "gain", "value"), [
    *(([-1.0], [0.0, -2.0], 3.0, np.inf), ([0.0], [-1.0, -2.0], 3.0, 0.0), ([0.0], [0.0, -2.0], 3.0, np.nan)),
    *(([-1.0], [-4.0, -2.0], 3.0, 0.375), ([], [0.0], 0.0, np.nan)),
])  # fmt: skip
def test_the_gain_at_zero(zeros, poles, gain, value):
    assert Rational(zeros, poles, gain).dc_gain == pytest.approx(value, nan_ok=True)


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


def test_ends_of_a_bracket_and_open_brackets():
    # a zero at an end, no change of sign, none at all; values at the ends that are known are not asked for again
    low, high = np.array([1.0, -2.0, 3.0, 0.5]), np.array([4.0, 1.0, 5.0, 2.0])
    asked = []
    found = bracketed_roots(lambda x, _: asked.extend(x) or x - 1.0, low, high, ends=(low - 1.0, high - 1.0))
    assert found == pytest.approx([1.0, 1.0, 3.0, 1.0], rel=5e-16)
    assert asked
    assert all(0.5 < x < 2.0 for x in asked)
    assert bracketed_roots(lambda x, _: x, np.zeros(0), np.zeros(0)).size == 0
    # 0 to infinity, from guesses decades off
    roots, starts = (1e-9, 2.0, 5e7), (1e3, 1.0, 1e-2)
    found = [
        monotone_root(lambda x, root=root: (math.log(x / root), 1.0 / x), start, 0.0, math.inf, -1.0)
        for root, start in zip(roots, starts, strict=True)
    ]
    assert found == pytest.approx(roots, rel=5e-16)
