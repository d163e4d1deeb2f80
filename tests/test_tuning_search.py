"""The parts of tuning, each against what it is defined by."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from railslip_ctrl import DeadTimeLoop
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.design.specification import Specification, family_margins, is_robust, worst_of
from railslip_ctrl.design.tuning_search import Family, _bracket, _inside, _refined_ki, _tightest, _to_the_tip
from railslip_ctrl.loop import Rational


def test_a_specification_takes_whatever_can_be_asked_and_says_it():
    asked = Specification(ms_max=1.01, phase_min_deg=179.0, delay_min_s=0.002, crossover=(0.0, 0.003))
    assert all(value in asked.words for value in ("1.01", "179", "0.002", "0 to 0.003"))
    assert not asked.only_ms
    assert Specification(ms_max=2.0).only_ms
    assert Specification().words == ""
    assert is_robust(2.0)
    assert not is_robust(2.0001)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("ms_max", (1.0, np.nan, np.inf, "2")),
        ("phase_min_deg", (-1.0, 180.0, np.nan)),
        ("delay_min_s", (-1.0, np.inf)),
        ("crossover", ((2.0, 1.0), (1.0, 1.0), (-1.0, 1.0), (1.0, 2.0, 3.0))),
    ],
)
def test_a_specification_refuses_what_cannot_be(name, values):
    for value in values:
        with pytest.raises(InputError, match=name):
            Specification(**{name: value})


def test_a_family_of_any_structures_has_the_margins_of_its_loops():
    roots = [([], [-1.0], 2), ([-2.0], [-1.0], 0.5), ([-2.0], [1.0, -3.0], 4), ([-1.0], [-2.0], 3), ([], [1.0], 9)]
    loops = [DeadTimeLoop(Rational(*one), 0.2) for one in roots]
    found = family_margins(loops)
    assert found.stable.tolist() == [True, True, True, False, False]
    assert found.unstable_poles.tolist() == [loop.unstable_closed_loop_poles for loop in loops]
    assert worst_of(found) is None
    for name in {f.name for f in fields(found)} - {"stable", "unstable_poles"}:
        expected = [getattr(loop.margins(), name) for loop in loops[:3]] + [np.nan] * 2
        assert getattr(found, name) == pytest.approx(expected, rel=1e-9, nan_ok=True), name
    worst = worst_of(family_margins(loops[:3]))
    assert (worst.ms, worst.phase_deg, worst.delay_s) == (found.ms[2], found.phase_deg[2], found.delay_s[2])
    assert (worst.ms_member, worst.phase_member, worst.delay_member) == (2, 2, 2)


@pytest.mark.parametrize("limit", [-9.5, -4.0, -0.5, -0.05, -1e-3, 0.0, 5e-4, 0.01, 0.3, 1.9])
def test_a_bracket_holds_the_limit(limit):
    lower, upper = _bracket(lambda x: x - limit, 0.0)
    assert lower <= limit < upper


def test_a_bracket_tells_that_all_or_nothing_is_met():
    lower, upper = _bracket(lambda _: -1.0, 0.0)
    assert lower == upper > 0
    assert _bracket(lambda _: 0.5, 0.0) is None


@pytest.mark.parametrize("gap", [(2.0, 8.0), (-8.0, -2.0), (-1.0, 0.0), (0.0, 3.0), (-1.0, 5.0), (-5.0, 1.0)])
def test_a_gain_inside_a_gap_is_of_the_order_of_the_smaller_end(gap):
    inside = _inside(*gap)
    assert gap[0] < inside < gap[1]
    assert abs(inside) <= 2 * min(abs(end) for end in gap if end)


@pytest.mark.parametrize(("margin", "best"), [("ms", 1.1070848), ("phase_deg", -64.591644), ("delay_s", -1.8992699)])
def test_the_tightest_interval_is_where_a_margin_is_best(margin, best):
    # 1/(s - 0.5) with 0.1 s under P control, the best by a grid of 4000 gains
    family = Family([Rational([], [0.5], 1.0)], [0.1], compensated=False, names=())
    ki = family.ki_ends[0]
    ((low, high),) = _tightest(family, ki, Specification(), margin)
    found = family.worst(np.linspace(low, high, 3), np.full(3, ki), margin)
    assert found == pytest.approx(np.full(3, best), rel=1e-4)  # 16 halvings of what there may be


def test_an_island_of_gains_is_followed_to_its_tip():
    island = Rational(np.array([-0.4]), np.array([-0.2 + 2.9j, -0.2 - 2.9j, 0.3]), 1.0)
    family, asked = Family([island], [0.1], compensated=False, names=()), Specification(ms_max=10.0)
    kp = -3.6241  # the tip is at -3.6251
    ki = _refined_ki(family, asked, kp, 5.0799)
    assert 5.0799 < ki < 5.0801
    # at an end of the gap, and in its midst, where no tip is looked for
    assert _to_the_tip(family, asked, (kp, kp + 1e-3), kp, ki)[1] == pytest.approx(5.0801932, rel=1e-7)
    assert _to_the_tip(family, asked, (kp - 1e-3, kp + 1e-3), kp, ki) == (kp, ki)
