"""Gains and rectangles of gains, certified."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest

from railslip_ctrl import stabilizing_pi
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.design import intersection, stabilizing_pid
from railslip_ctrl.loop import Rational

S = ct.tf("s")
LAGS = 1 / ((S + 1) * (S + 2) * (S + 3))  # s^4 + 6 s^3 + 11 s^2 + (6 + kp) s + ki: ki < (6 + kp)(60 - kp)/36
UNSTABLE = 1 / ((S - 1) * (0.5 * S + 1))  # s^3 + s^2 + 2 (kp - 1) s + 2 ki: ki < kp - 1
BIPROPER = (S + 2) / (S + 1)  # (1 + kp) s^2 + (1 + 2 kp + ki) s + 2 ki: ki > -1 - 2 kp
ISLAND = Rational(np.array([-0.4]), np.array([-0.2 + 2.9j, -0.2 - 2.9j, 0.3]), 1.0)
OUTSIDE, INSIDE = 1e-9, 1e-4  # relative distance of the outermost corner from the boundary


@pytest.mark.parametrize(
    ("plant", "dead_time", "kp", "ki", "corner"),
    [
        (LAGS, 0.0, (5.0, 40.0), (1.0, 11 * 55 / 36), (0, 1)),
        (LAGS, 0.0, (5.0, 50.0), (1.0, 56 * 10 / 36), (1, 1)),
        (UNSTABLE, 0.0, (3.0, 9.0), (1e-3, 2.0), (0, 1)),
        (BIPROPER, 0.0, (-0.51, 0.4), (0.02, 3.0), (0, 0)),
        # by the stabilising set: with dead time, in other units, and bounded below in ki
        (UNSTABLE, 0.1, (3.0, 4.0), (0.3, None), (1, 1)),
        (1 / (S + 1), 0.1, (0.0, 0.5), (1.0, None), (0, 1)),
        (1e6 / (S + 1e3), 0.01, (-6e-4, 6e-4), (1e-3, None), (0, 1)),
        (1 / ((1e5 * S + 1) * (S + 1)), 3.0, (-0.5, 100.0), (1e-5, None), (0, 1)),
        (ISLAND, 0.1, (-1.25, -1.2), (None, 4.0), (0, 0)),
    ],
)
def test_a_rectangle_is_certified_until_a_corner_passes_the_boundary(plant, dead_time, kp, ki, corner):
    region = stabilizing_pi(plant, dead_time)
    column, row = corner
    if ki[row] is None:
        ki = [end or region.ki_intervals(kp[column])[0][row] for end in ki]
    for side, certain in ((OUTSIDE, False), (-INSIDE, True)):
        moved = list(ki)
        moved[row] *= 1 + side * (1 if row else -1)
        assert region.certified_rectangle(kp, tuple(moved)) is certain
        assert intersection([region, region]).certified_rectangle(kp, tuple(moved)) is certain
        assert region.certified_contains(kp[column], moved[row]) is certain


def test_gains_are_certified_with_an_integrator_and_without():
    region = stabilizing_pi(LAGS)
    for kp, ki, certain in ((-5.9, 0.0, True), (60.1, 0.0, False), (5.0, -1e-9, False), (5.0, 1e-9, True)):
        assert region.certified_contains(kp, ki) is certain
    assert region.certified_rectangle((5.0, 5.0), (1.0, 1.0))


@pytest.mark.parametrize(
    ("kp", "ki", "match"),
    [
        ((1.0,), (1.0, 2.0), "kp: .* give two finite ends"),
        ((1.0, 2.0), 3.0, "ki: .* give two finite ends"),
        ((1.0, 2.0), (0.0, 2.0), "ki: 0"),
        ((1.0, np.inf), (1.0, 2.0), "kp: inf"),
        ((2.0, 1.0), (1.0, 2.0), "kp: from 2 to 1 is not allowed; give ascending ends"),
    ],
)
def test_a_rectangle_of_other_ends_is_refused(kp, ki, match):
    with pytest.raises(InputError, match=match):
        stabilizing_pi(LAGS).certified_rectangle(kp, ki)


def test_a_rectangle_of_a_pid_is_refused():
    region = stabilizing_pid(LAGS, derivative_time=1.0, derivative_filter=0.1)
    with pytest.raises(InputError, match="PID with a derivative part is not covered"):
        region.certified_rectangle((1.0, 2.0), (1.0, 2.0))
