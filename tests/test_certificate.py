"""Certificates against an independent checker (`loop_checker`: python-flint alone)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import random_loops
from loop_checker import poles_right, refused
from scipy.optimize import brentq

from railslip_ctrl import DeadTimeLoop
from railslip_ctrl.loop import Rational

MARGINS = ("gain_increase", "gain_decrease", "phase_deg", "delay_s", "ms", "mt")
PER_KIND = 3


def made(zeros, poles, gain, dead_time):
    return DeadTimeLoop(Rational(zeros, poles, gain), dead_time)


@pytest.fixture(scope="module")
def certified():
    """Stable loops of every kind, as (kind, parameters, loop, certificate)."""
    found = []
    for kind in random_loops.KINDS:
        stable = ((one, made(*one)) for one in random_loops.loops(kind, 100) if made(*one).is_stable())
        found += [
            (kind, one, loop, loop.certificate()) for (one, loop), _ in zip(stable, range(PER_KIND), strict=False)
        ]
    return found


def test_the_checker_accepts_certificates(certified):
    assert len(certified) == PER_KIND * len(random_loops.KINDS)
    for kind, one, _, certificate in certified:
        assert certificate.stable
        assert certificate.unstable_poles == 0
        assert refused(*one, certificate) == [], (kind, one, certificate)


def test_the_checker_refuses_a_certificate_with_a_margin_moved(certified):
    # by a millionth, a thousand times the width of an enclosure
    _, one, _, certificate = next(one for one in certified if one[0] is random_loops.wheel_slip)
    for name in MARGINS:
        low, high = getattr(certificate, name)
        for factor in (1 - 1e-6, 1 + 1e-6):
            moved = replace(certificate, **{name: (low * factor, high * factor)})
            assert refused(*one, moved), (name, factor)


def test_enclosures_are_narrow_and_hold_the_margins(certified):
    for kind, one, loop, certificate in certified:
        margins = loop.margins()
        for name in MARGINS:
            low, high = getattr(certificate, name)
            value = getattr(margins, name)
            assert high == low or high - low <= 1e-9 * abs(high)
            # 1e-12: what refined doubles promise
            assert low * (1 - 1e-12) <= value <= high * (1 + 1e-12), (kind, one, name)


def test_unstable_loops_have_their_poles_counted_and_no_margins():
    for kind in random_loops.KINDS:
        unstable = (one for one in random_loops.loops(kind, 100) if not made(*one).is_stable())
        for one, _ in zip(unstable, range(PER_KIND), strict=False):
            certificate = made(*one).certificate()
            assert not certificate.stable
            assert certificate.unstable_poles == poles_right(*one), (kind, one)
            assert all(getattr(certificate, name) is None for name in MARGINS)


def test_a_double_beside_half_pi_decides():
    # s + k exp(-s) is stable for k < pi/2, and the double nearest to pi/2 is below it
    for gain, stable in ((np.pi / 2, True), (math.nextafter(np.pi / 2, 2), False)):
        certificate = made([], [0.0], gain, 1.0).certificate()
        assert certificate.stable is stable
        assert certificate.unstable_poles == (0 if stable else 2)


def test_a_loop_without_gain_and_one_of_next_to_none_are_certified():
    none = DeadTimeLoop(Rational([], [-1.0], 0.0), 1.0).certificate()
    assert (none.stable, none.ms, none.mt, none.gain_increase) == (True, (1.0, 1.0), (0.0, 0.0), (np.inf, np.inf))
    least = DeadTimeLoop(Rational([], [-1.0], 1e-150), 1.0)
    low, high = least.certificate().gain_increase
    omega = brentq(lambda w: np.arctan(w) + w - np.pi, 1.0, 3.0, xtol=1e-15)
    assert low <= np.hypot(1, omega) * 1e150 * (1 + 1e-14)  # rounding of brentq's omega
    assert high >= np.hypot(1, omega) * 1e150 * (1 - 1e-14)
    assert least.margins().mt == pytest.approx(1e-150)
