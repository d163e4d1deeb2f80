"""Outlines of stabilising sets, and margins over a grid of gains."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest

from railslip_ctrl import DeadTimeLoop, stabilizing_pi
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.design import intersection, margin_grid, outline

S = ct.tf("s")
UNSTABLE = 1 / ((4 * S - 1) * (0.6 * S + 1))


def test_outline_is_the_set():
    region = stabilizing_pi(UNSTABLE, 0.15)
    (strip,) = outline(region, count=15)
    assert strip.polygon.shape == (30, 2)
    assert np.all(strip.ki_low == 0)
    assert list(strip.ki_high) == [region.ki_limit(kp) for kp in strip.kp]


def test_outline_of_a_set_that_begins_within_the_columns():
    region = stabilizing_pi(UNSTABLE, 0.15)
    (strip,) = outline(region, kp=np.linspace(0, 30, 7))
    assert (strip.kp[0], strip.kp[-1]) == pytest.approx((1, 23.3988133859), rel=1e-9)
    assert outline(stabilizing_pi(1 / (S - 5), 2.4)) == ()
    (column,) = outline(region, kp=[2.0])
    assert column.ki_high == [region.ki_limit(2.0)]


def test_an_outline_is_cut_at_the_lower_end_alone():
    region = stabilizing_pi(1 / ((S**2 + 0.1 * S + 1) * (S + 1)))  # Routh: -1 < kp < 0.21
    for limit, least in ((0.5, -0.5), (1.01, -1.0)):
        (strip,) = outline(region, kp_limit=limit)
        assert (strip.kp[0], strip.kp[-1]) == pytest.approx((least, 0.21), abs=2e-3)
        assert strip.kp_cut == (limit < 1.0)


def test_outline_of_a_set_that_goes_on_ends_where_it_is_told_to_and_says_so():
    region = stabilizing_pi(1 / ((S - 1) * (0.5 * S + 1)))  # Routh: 0 < ki < kp - 1
    with pytest.raises(InputError, match="without bound, kp from 1 to inf; give the columns kp to draw, or kp_limit"):
        outline(region)
    (strip,) = outline(region, kp_limit=10.0)
    assert (strip.kp_cut, strip.ki_cut) == (True, False)
    assert (strip.kp[0], strip.kp[-1]) == pytest.approx((1.0, 10.0), abs=0.01)
    assert strip.ki_high == pytest.approx(strip.kp - 1.0, rel=1e-9)
    (both,) = outline(stabilizing_pi(1 / (S + 1)), kp_limit=10.0, ki_limit=5.0)  # every ki > 0
    assert (both.kp_cut, both.ki_cut) == (True, True)
    assert set(both.ki_high) == {5.0}
    (whole,) = outline(stabilizing_pi(UNSTABLE, 0.15), kp_limit=30.0, ki_limit=30.0)
    (part,) = outline(stabilizing_pi(UNSTABLE, 0.15), kp_limit=10.0)
    assert (whole.kp_cut, whole.ki_cut, part.kp_cut, part.ki_cut) == (False, False, True, False)
    assert outline(region, kp_limit=0.5) == ()
    with pytest.raises(InputError, match=r"ki_limit: 0\.0 is not allowed; give a gain > 0"):
        outline(region, ki_limit=0.0)


def test_margin_grid_holds_the_worst_margins_and_nan_outside():
    regions = [stabilizing_pi(UNSTABLE, 0.15), stabilizing_pi(1.2 * UNSTABLE, 0.15)]
    grid = margin_grid(intersection(regions), [0.9, 4.0, 12.0], [0.0, 0.5])
    assert grid.ms.shape == grid.phase_deg.shape == grid.delay_s.shape == (3, 2)
    assert np.all(np.isnan(grid.ms[0]))
    assert not np.any(np.isnan(grid.ms[1:]))
    pi = 12 + 0.5 / S
    margins = [DeadTimeLoop(pi * gain * UNSTABLE, 0.15).margins() for gain in (1, 1.2)]
    assert grid.ms[2, 1] == pytest.approx(max(m.ms for m in margins), rel=1e-9)
    assert grid.phase_deg[2, 1] == pytest.approx(min(m.phase_deg for m in margins), rel=1e-9)
    assert grid.delay_s[2, 1] == pytest.approx(min(m.delay_s for m in margins), rel=1e-9)
