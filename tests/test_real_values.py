"""Where F exp(tau s) + G is real on the axis, against closed forms and a scan."""

from __future__ import annotations

import math

import numpy as np
import pytest
from flint import fmpq_poly

from railslip_ctrl.design.decomposition import real_frequencies

S = fmpq_poly([0, 1])
NOTHING, ONE = fmpq_poly([0]), fmpq_poly([1])


@pytest.mark.parametrize("factor", [(1 + S) ** 3, (1 - S) ** 3, -((1 - S) ** 3), (1 - S) ** 3 * (S**2 + 9)])
def test_three_equal_lags_turn_by_half_a_turn_at_the_root_of_three(factor):
    assert real_frequencies(factor, NOTHING, 0.0, math.inf) == pytest.approx([math.sqrt(3)], rel=1e-15)
    assert real_frequencies(factor * 1000**3, NOTHING, 0.0, 1.7).size == 0


def scanned(factor, other, dead_time, highest):
    """Changes of sign of the imaginary part at 400 000 frequencies; without poles and zeros on the axis."""
    omega = np.linspace(0.0, highest, 400_001)[1:]
    f, g = (np.polyval([float(c) for c in p.coeffs()[::-1]] or [0.0], 1j * omega) for p in (factor, other))
    value = (f * np.exp(1j * dead_time * omega) + g).imag
    return omega[np.flatnonzero(np.diff(np.sign(value)))]


@pytest.mark.parametrize(
    ("factor", "other", "dead_time", "highest"),
    [
        (-((1 + S) ** 3), NOTHING, 1.0, 30.0),
        (ONE, -S / 5, 1.0, 30.0),
        (1 + S, -(S**3) / 50, 2.0, 10.0),  # |kappa| 1 to 1.4 at the end
        ((1 + 4 * S**2) * (S + 3), S, 0.7, 25.0),  # F is 0 at 0.5 rad/s
        ((1 - S) ** 2, 3 * S, 0.3, 40.0),
        (S * (4 + S**2), S**3 / 3, 1.0, 12.0),
    ],
)
def test_frequencies_are_those_of_a_scan(factor, other, dead_time, highest):
    found = real_frequencies(factor, other, dead_time, highest)
    expected = scanned(factor, other, dead_time, highest)
    assert found.shape == expected.shape
    assert found == pytest.approx(expected, abs=highest / 400_000)


@pytest.mark.parametrize("past", [1e-4, -1e-4, 1e-7, -1e-7])
def test_roots_next_to_where_they_cease_are_found(past):
    # sin(tau omega) = omega/5: the last crossing lies just before the top of both, 5 rad/s; none counts at omega = 0
    found = real_frequencies(ONE, -S / 5, (2.5 * math.pi + past) / 5, 30.0)
    assert found[:2] == pytest.approx([1.7697, 4.8370], abs=2e-4)
    assert 5.0 - found[2:] == pytest.approx([2.5 * past**2], rel=0.05)
