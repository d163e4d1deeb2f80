"""Stable intervals from root counts that are told, one for each interval between critical gains."""

from __future__ import annotations

import numpy as np
import pytest

from railslip_ctrl.design.decomposition import CriticalGains, common_intervals, probe, stable_intervals
from railslip_ctrl.loop.stability import RootCount

INF = float("inf")
MARGINAL = RootCount(0, True)


@pytest.mark.parametrize(
    ("edges", "leftward", "counts", "stable", "asked"),
    [
        # four unstable poles need two leftward boundaries, none one; beyond the last of them nothing is asked
        ([1, 2, 3, 4, 5], [1, 1, 0, 1, 0], [4, 2, 0, 2, 0, 2], [(2, 3), (4, 5)], [0, 2, 4]),
        ([1, 2, 3], [1, 0, 0], [1, 0, 2, 2], [(1, 2)], [0, 1]),
        # a count that is not known forbids no interval, none is beyond the last
        ([1, 2], [0, 1], [MARGINAL, 0, 0], [(1, 2), (2, INF)], [0, 1, 2]),
        ([1], [0], [INF, MARGINAL], [], [0, 1]),
        # two boundaries that are one but for rounding, far from 1 as well
        ([1e6, 1e6 * (1 + 1e-13), 2e6], [1, 1, 0], [1, 1, 0, 2], [(1e6 * (1 + 1e-13), 2e6)], [0, 2]),
    ],
)
def test_only_intervals_that_may_be_stable_are_counted(edges, leftward, counts, stable, asked):
    told = []

    def count(gain):
        if gain in edges:
            return MARGINAL
        told.append(int(np.searchsorted(edges, gain)))
        here = counts[told[-1]]
        return here if isinstance(here, RootCount) else RootCount(here, False)

    values = np.array(edges, dtype=float)
    critical = CriticalGains(values, np.ones(values.size), np.array(leftward, dtype=bool), INF)
    assert list(stable_intervals(critical, 1.0, count, signed=True)) == stable
    assert told == asked


@pytest.mark.parametrize(("at", "stable"), [(RootCount(0, False), ((0.0, 9.0),)), (MARGINAL, ((0.0, 1.0), (1.0, 9.0)))])
def test_intervals_on_both_sides_of_a_boundary_that_is_stable_itself_are_one(at, stable):
    critical = CriticalGains(np.array([1.0]), np.ones(1), np.ones(1, dtype=bool), 9.0)
    assert stable_intervals(critical, 1.0, lambda k: at if k == 1 else RootCount(0, False), signed=False) == stable


def test_a_gain_between_two_others_may_be_far_out():
    ends = [(-INF, INF), (-INF, 3.0), (-7.0, INF), (0.0, INF), (2.0, 4.0)]
    assert [probe(*pair, 5.0) for pair in ends] == [5.0, -2.0, 0.0, 5.0, 3.0]


def test_common_intervals_are_those_of_all_and_have_a_width():
    first, second, third = ((0.0, 2.0), (3.0, 6.0)), ((1.0, 3.0), (4.0, 5.0)), ((2.0, 4.5),)
    assert common_intervals([first]) == first
    assert common_intervals([first, second]) == ((1.0, 2.0), (4.0, 5.0))
    assert common_intervals([first, second, third]) == ((4.0, 4.5),)
