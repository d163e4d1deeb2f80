"""Certificates against an independent checker (`loop_checker`: python-flint alone)."""

import itertools
import math
from dataclasses import replace

import control
import numpy as np
import pytest
import random_loops
from loop_checker import poles_right, refused
from scipy.optimize import brentq

from railslip_ctrl import DeadTimeLoop, Rational
from railslip_ctrl.loop.certificate import CertificateError, certify

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
    """|S| and |T| in the limit are below their peaks, which the bounds of the parts have to tell by themselves."""
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
    omega = brentq(lambda w: np.arctan(w) + w - np.pi, 1.0, 3.0, xtol=1e-15)
    assert low <= np.hypot(1, omega) * 1e150 * (1 + 1e-14)  # rounding of brentq's omega
    assert high >= np.hypot(1, omega) * 1e150 * (1 - 1e-14)
    assert least.margins().mt == pytest.approx(1e-150)
    # no dead time may be added to a loop of gain above one at infinity
    assert made([-0.5], [-1.0], 2.0, 0.0).certificate().delay_s == (0.0, 0.0)
    assert made([-0.5], [-1.0], 0.5, 0.1).certificate().delay_s == (np.inf, np.inf)  # |L| < 1 everywhere


def companion(num, den):
    """A realisation of num/den, den monic and of the higher degree."""
    order = len(den) - 1
    a = np.vstack([-np.array(den[1:], dtype=float), np.eye(order)[:-1]])
    return a, np.eye(order)[:, :1], np.array([[0.0] * (order - len(num)) + list(num)]), 0.0


@pytest.mark.parametrize(("num", "den", "dead_time"), [
    *(([-1], [1, 3, 1], 0.0), ([-1], [1, 3, 1], 0.1), ([1, -1], [1, 3, 1], 0.1), ([-1], [1, 0.3, 1], 0.1)),
    *(([-1], [1, 4, 2, 1], 0.2), ([-3], [1, 7, 5, 3], 0.0), ([-1], [1, 7, 1], 0.5), ([-2], [1, 5, 3, 2], 0.2)),
    *(([3], [1, 1, 3, 0], 0.0), ([1, 0, 2], [1, 3, 2, 6], 0.3)),  # +-j sqrt 3; a hidden +-j sqrt 2
])  # fmt: skip
@pytest.mark.parametrize("form", [control.tf, lambda num, den: control.ss(*companion(num, den))], ids=["tf", "ss"])
def test_coefficients_that_put_a_pole_on_the_axis_are_told(num, den, dead_time, form):
    certificate = DeadTimeLoop(form(num, den), dead_time).certificate()
    assert (certificate.stable, certificate.marginal) == (False, True)
    assert certificate.unstable_poles >= 1


@pytest.mark.parametrize("dead_time", [0.0, 0.1, 1.0])
@pytest.mark.parametrize("den", [[1, 3, 1], [1, 5, 11, 1]])
def test_the_last_bit_of_a_coefficient_decides(den, dead_time):
    # D(0) + N(0) changes its sign; up to there |L| < 1, and the real pole through the origin is the first
    for gain, stable in ((np.nextafter(1.0, 0.0), True), (1.0, False), (np.nextafter(1.0, 2.0), False)):
        loop = DeadTimeLoop(control.tf([-gain], den), dead_time)
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
    for loop in (made(zeros, poles, gain, 0.0), DeadTimeLoop(control.tf(gain * np.poly(zeros), np.poly(poles)))):
        certificate = loop.certificate()
        for name, value in margins.items():
            low, high = getattr(certificate, name)
            assert low <= value * (1 + 1e-15), name  # rounding of the closed form
            assert high >= value * (1 - 1e-15), name
            assert getattr(loop.margins(), name) == pytest.approx(value, rel=1e-15), name
