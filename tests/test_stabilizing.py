"""Stabilising sets: published ends, and cell by cell against decisions made another way."""

import re

import control as ct
import numpy as np
import pytest
import random_loops
from flint import fmpq_poly
from test_tuning import ISLAND, twelve_points

from railslip_ctrl import PARK2008, DeadTimeLoop, InputError, Rational, stabilizing_pi
from railslip_ctrl.design import intersection, margin_grid, outline, stabilizing_pid
from railslip_ctrl.design.decomposition import CriticalGains, real_frequencies, stable_intervals
from railslip_ctrl.loop.stability import RootCount

S = ct.tf("s")
UNSTABLE = 1 / ((4 * S - 1) * (0.6 * S + 1))
LAGS = 1 / ((S + 1) * (S + 2) * (S + 3))  # s^4 + 6 s^3 + 11 s^2 + (6 + kp) s + ki: ki < (6 + kp)(60 - kp)/36
NEAR = 1e-6  # relative distance at which inside and outside are told apart
PID = {"derivative_filter": 0.06}


def test_p_and_pi_sets_of_an_unstable_lag_with_dead_time():
    region = stabilizing_pi(UNSTABLE, dead_time=0.15)
    assert region.kp_range == pytest.approx((1, 23.3988133859), abs=0.5001e-10, rel=0)
    assert region.ki_limit(2) == pytest.approx(1.077454753, abs=0.5001e-9, rel=0)
    assert region.ki_limit(12) == pytest.approx(6.719615019, abs=0.5001e-9, rel=0)
    assert (region.reason, region.is_empty) == ("", False)
    assert [region.contains(12, ki) for ki in (-1e-3, 6.7, 6.73)] == [False, True, False]
    assert (region.ki_limit(1e12), region.contains(1e12, 0.0)) == (0.0, False)


def test_plants_without_dead_time_follow_routh():
    assert stabilizing_pi(1 / (S + 1)).kp_range == (-1.0, np.inf)
    assert stabilizing_pi(1 / (S + 1)).ki_limit(0.3) == np.inf
    region = stabilizing_pi(LAGS)
    assert region.kp_range == pytest.approx((-6, 60), rel=1e-13)
    for kp in (-5.0, 0.0, 20.0, 59.0):
        assert region.ki_limit(kp) == pytest.approx((6 + kp) * (60 - kp) / 36, rel=1e-12)
    assert stabilizing_pi(1 / S).ki_intervals(0.5) == ((0.0, np.inf),)
    assert stabilizing_pi(1 / S**2).kp_range is None
    assert stabilizing_pi(Rational([], [-1.0], 1.0)).ki_limit(1e9) == np.inf


def test_gain_at_infinity_is_a_boundary_of_a_biproper_plant():
    plant = 2 * (S + 2) / (S + 1)
    region = stabilizing_pi(plant)
    assert region.p_intervals == ((-np.inf, -0.5), (-0.25, np.inf))
    # beyond the pole's passage through infinity ki < 0 would be needed
    assert region.kp_range == (-0.25, np.inf)
    assert region.ki_intervals(-3.0) == ()
    assert (region.contains(-3.0, 0.1), region.contains(-3.0, 0.0)) == (False, True)
    # C(inf) P(inf) = -1: kp + kd/Tf = -1/2, or kp (1 + Td/Tf) = -1/2
    by_gain = stabilizing_pid(plant, derivative_gain=0.3, derivative_filter=0.1)
    assert by_gain.p_intervals[0] == (-np.inf, pytest.approx(-3.5, rel=1e-14))
    by_time = stabilizing_pid(plant, derivative_time=0.3, derivative_filter=0.1)
    assert by_time.p_intervals[1] == (pytest.approx(-0.125, rel=1e-14), np.inf)


def test_an_unstable_plant_may_need_ki_away_from_zero():
    islands = stabilizing_pi(ISLAND, 0.1)
    assert islands.kp_range is None
    assert not islands.is_empty
    assert "larger ki does stabilise, for example at kp = -1.24" in islands.reason
    ((low, high),) = islands.ki_intervals(-1.24)
    assert low > 3
    assert islands.ki_limit(-1.24) == high
    for ki, inside in ((low, 1), (high, -1)):
        assert islands.contains(-1.24, ki * (1 + inside * NEAR))
        assert not islands.contains(-1.24, ki * (1 - inside * NEAR))


@pytest.mark.parametrize(("plant", "match"), [
    (-1 / (S + 1), r"sign of the plant's numerator.*change the sign.*-5\.89017 < kp < 1"),
    (S / (S + 1) ** 2, r"zero at s = 0 cancels the integrator; use P control \(ki = 0"),
    (0 * S / (S + 1), "the plant is 0"),
    ((S - 1) / ((S - 1) * (S + 2)), "pole at 1.* is cancelled by a zero"),
    (S / (S * (S + 2)), "pole at 0.* is cancelled by a zero"),
    (1 / S**3, "at least 1 closed-loop pole stays unstable"),
    (1 / ((S - 9) * (S - 8)), "at least 2 closed-loop poles stay unstable"),
])  # fmt: skip
def test_empty_sets_say_why(plant, match):
    region = stabilizing_pi(plant, dead_time=0.3)
    assert (region.kp_range, region.kp_intervals, region.ki_limit(0.5)) == (None, (), 0.0)
    assert not region.contains(0.5, 0.1)
    assert re.search(match, region.reason)


def random_region(rng):
    of_kind = (random_loops.wheel_slip, random_loops.extremum_of_gain_near_one, random_loops.neutral, random_loops.flat)
    zeros, poles, gain, dead_time = of_kind[rng.integers(4)](rng)
    dead_time = min(dead_time, 1.0)
    plant = Rational(zeros[: len(poles) - 1], poles, float(gain * rng.choice([1, 1, 1, -1])))
    lag, td, kd, kind = 10 ** rng.uniform(-2, 0), rng.uniform(0, 2), rng.uniform(-2, 2), rng.integers(3)
    if kind == 0:
        return stabilizing_pi(plant, dead_time), (0.0, 0.0, 0.0)
    if kind == 1:
        return stabilizing_pid(plant, dead_time, derivative_time=td, derivative_filter=lag), (td, 0.0, lag)
    return stabilizing_pid(plant, dead_time, derivative_gain=kd, derivative_filter=lag), (0.0, kd, lag)


def columns(rng, region):
    ends = np.array([e for pair in region.p_intervals for e in pair if np.isfinite(e) and e != 0])
    scale = np.abs(ends).max() if ends.size else 10 ** rng.uniform(-1, 1)
    found = list(rng.normal(size=3) * scale)
    for low, high in region.p_intervals:
        found += list(rng.uniform(max(low, -3 * scale), min(high, 3 * scale), 3))
    return found, [e * (1 + side * NEAR) for e in ends for side in (-1, 1)]


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.long)])
def test_intervals_agree_with_the_exact_root_count_everywhere(seed):
    rng = np.random.default_rng(seed)
    points = 0
    for _ in range(15):
        region, _ = random_region(rng)
        inner, at_ends = columns(rng, region)
        for kp in (*inner, *at_ends):
            assert region.contains(kp, 0.0) == any(a < kp < b for a, b in region.p_intervals)
            intervals = region.ki_intervals(kp)
            values = list(10 ** rng.uniform(-3, 2, 3) * max(abs(kp), 0.1))
            if kp in inner:  # at a corner of the set both distances multiply to less than rounding
                ends = [e for pair in intervals for e in pair if 0 < e < np.inf]
                values += [e * (1 + side * NEAR) for e in ends for side in (-1, 1)]
            for ki in values:
                assert region.contains(kp, ki) == any(a < ki < b for a, b in intervals)
            points += 1 + len(values)
    assert points > 300


@pytest.mark.parametrize("seed", range(8))
def test_the_boundary_curve_and_the_controller_are_of_the_pid(seed):
    rng = np.random.default_rng(seed)
    region, (td, kd, lag) = random_region(rng)
    s = 1j * np.geomspace(1e-2, 5.0, 60)
    derivative = s / (lag * s + 1)

    def pid(kp, ki):
        return kp * (1 + td * derivative) + ki / s + kd * derivative

    for gains in (rng.normal(size=2), (rng.normal(), 0.0), (0.0, 1.0)):
        assert region.decomposition.controller(*gains)(s) == pytest.approx(pid(*gains), rel=1e-9)
    with np.errstate(divide="ignore", invalid="ignore"):
        loop = pid(*region.decomposition.curve(s.imag)) * region.plant(s) * np.exp(-s * region.dead_time)
    usable = np.isfinite(loop) & (np.abs(region.plant(s)) > 1e-3)
    assert np.abs(1 + loop[usable]) == pytest.approx(0, abs=1e-8)  # kp and ki/omega may nearly cancel


def test_intersection_over_operating_points():
    regions = [stabilizing_pi(plant, PARK2008.actuator.dead_time) for plant in twelve_points()]
    common = intersection(regions)
    low, high = common.kp_range
    assert (low, high) == (max(r.kp_range[0] for r in regions), min(r.kp_range[1] for r in regions))
    assert common.reason == ""
    for kp in np.random.default_rng(1).uniform(low, high, 10):
        limit = common.ki_limit(kp)
        assert limit == min(r.ki_limit(kp) for r in regions)
        assert common.contains(kp, limit * (1 - NEAR))
        assert not common.contains(kp, limit * (1 + NEAR))
    assert not common.contains(low * (1 - NEAR), 0.0)


@pytest.mark.parametrize(("make", "match"), [
    (lambda: stabilizing_pi((S + 2) / (S + 1), 0.1), r"P\(inf\) = 1: the loop is neutral"),
    (lambda: stabilizing_pi(1 / S, -0.1), "dead time: -0.1"),
    (lambda: stabilizing_pi("1/s"), "not a linear system"),
    (lambda: stabilizing_pi((S + 2) / ((S + 1) * (1e-7 * S + 1)), 1.0).kp_range, r"1\.73e\+07 rad/s"),
    (lambda: stabilizing_pi(1 / S).contains(np.nan, 0), "kp: nan"),
    (lambda: stabilizing_pi(1 / S).ki_limit(np.inf), "kp: inf"),
    (lambda: stabilizing_pid(1 / S, 0.1, derivative_filter=0.1), "derivative_time .*derivative_gain"),
    (lambda: stabilizing_pid(1 / S, 0.1, derivative_time=1, derivative_gain=1, **PID), "derivative_time .*_gain"),
    (lambda: stabilizing_pid(1 / S, 0.1, derivative_time=1, derivative_filter=0.0), "derivative filter: 0 s"),
    (lambda: stabilizing_pid(1 / S, 0.1, derivative_time=-1, **PID), "derivative time: -1 s"),
    (lambda: stabilizing_pid(1 / S, 0.1, derivative_gain=np.nan, **PID), "derivative gain: nan"),
    (lambda: intersection([]), "no region is given"),
    (lambda: intersection([stabilizing_pi(1 / S)], ("dry", "wet")), "names: 2 for 1 regions"),
    (lambda: stabilizing_pi(1 / S).certified_rectangle((1.0,), (1.0, 2.0)), "kp: .* give two finite ends"),
    (lambda: stabilizing_pi(1 / S).certified_rectangle((1.0, 2.0), 3.0), "ki: .* give two finite ends"),
    (lambda: stabilizing_pi(1 / S).certified_rectangle((1.0, 2.0), (0.0, 2.0)), "ki: 0"),
    (lambda: stabilizing_pi(1 / S).certified_rectangle((1.0, np.inf), (1.0, 2.0)), "kp: inf"),
    (lambda: stabilizing_pi(1 / S).certified_rectangle((2.0, 1.0), (1.0, 2.0)), "kp: from 2 to 1 .*give ascending"),
    (lambda: stabilizing_pid(1 / S, derivative_time=1.0, **PID).certified_rectangle((1, 2), (1, 2)), "derivative part"),
])  # fmt: skip
def test_unsuitable_input_is_refused(make, match):
    with pytest.raises(InputError, match=match):
        make()


FASTER = 1 / ((S - 1) * (0.5 * S + 1))  # s^3 + s^2 + 2 (kp - 1) s + 2 ki: ki < kp - 1
BIPROPER = (S + 2) / (S + 1)  # (1 + kp) s^2 + (1 + 2 kp + ki) s + 2 ki: ki > -1 - 2 kp


@pytest.mark.parametrize(("plant", "dead_time", "kp", "ki", "corner"), [
    (LAGS, 0.0, (5.0, 40.0), (1.0, 11 * 55 / 36), (0, 1)),
    (LAGS, 0.0, (5.0, 50.0), (1.0, 56 * 10 / 36), (1, 1)),
    (FASTER, 0.0, (3.0, 9.0), (1e-3, 2.0), (0, 1)),
    (BIPROPER, 0.0, (-0.51, 0.4), (0.02, 3.0), (0, 0)),
    # by the stabilising set: with dead time, in other units, and bounded below in ki
    (FASTER, 0.1, (3.0, 4.0), (0.3, None), (1, 1)),
    (1 / (S + 1), 0.1, (0.0, 0.5), (1.0, None), (0, 1)),
    (1e6 / (S + 1e3), 0.01, (-6e-4, 6e-4), (1e-3, None), (0, 1)),
    (1 / ((1e5 * S + 1) * (S + 1)), 3.0, (-0.5, 100.0), (1e-5, None), (0, 1)),
    (ISLAND, 0.1, (-1.25, -1.2), (None, 4.0), (0, 0)),
])  # fmt: skip
def test_a_rectangle_is_certified_until_a_corner_passes_the_boundary(plant, dead_time, kp, ki, corner):
    region = stabilizing_pi(plant, dead_time)
    column, row = corner
    if ki[row] is None:
        ki = [end or region.ki_intervals(kp[column])[0][row] for end in ki]
    for side, certain in ((1e-9, False), (-1e-4, True)):  # relative distance of the outermost corner from the boundary
        moved = list(ki)
        moved[row] *= 1 + side * (1 if row else -1)
        assert region.certified_rectangle(kp, tuple(moved)) is certain
        assert intersection([region, region]).certified_rectangle(kp, tuple(moved)) is certain
        assert region.certified_contains(kp[column], moved[row]) is certain
    assert region.certified_rectangle((kp[column],) * 2, (moved[row],) * 2)  # a point is one too


@pytest.mark.parametrize(("marginal", "stable"), [(False, ((0.0, 9.0),)), (True, ((0.0, 1.0), (1.0, 9.0)))])
def test_intervals_on_both_sides_of_a_boundary_that_is_stable_itself_are_one(marginal, stable):
    critical = CriticalGains(np.array([1.0]), np.ones(1, dtype=bool), 9.0)
    assert stable_intervals(critical, 1.0, lambda k: RootCount(0, marginal and k == 1), signed=False) == stable


X, ONE = fmpq_poly([0, 1]), fmpq_poly([1])


@pytest.mark.parametrize(("factor", "other", "dead_time", "highest"), [
    (-((1 + X) ** 3), 0 * X, 1.0, 30.0),
    (ONE, -X / 5, 1.0, 30.0),
    (1 + X, -(X**3) / 50, 2.0, 10.0),  # |kappa| 1 to 1.4 at the end
    ((1 + 4 * X**2) * (X + 3), X, 0.7, 25.0),  # F is 0 at 0.5 rad/s
    ((1 - X) ** 2, 3 * X, 0.3, 40.0),
    (X * (4 + X**2), X**3 / 3, 1.0, 12.0),
])  # fmt: skip
def test_frequencies_are_those_of_a_scan(factor, other, dead_time, highest):
    """Changes of sign of the imaginary part at 400 000 frequencies; without poles and zeros on the axis."""
    found, omega = real_frequencies(factor, other, dead_time, highest), np.linspace(0.0, highest, 400_001)[1:]
    f, g = (np.polyval([float(c) for c in p.coeffs()[::-1]] or [0.0], 1j * omega) for p in (factor, other))
    expected = omega[np.flatnonzero(np.diff(np.sign((f * np.exp(1j * dead_time * omega) + g).imag)))]
    assert found.shape == expected.shape
    assert found == pytest.approx(expected, abs=highest / 400_000)


def test_outline_of_a_set_that_goes_on_ends_where_it_is_told_to_and_says_so():
    region = stabilizing_pi(FASTER)
    with pytest.raises(InputError, match="kp from 1 to inf; give kp_limit"):
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
    for name, worst in (("ms", max), ("phase_deg", min), ("delay_s", min)):
        assert getattr(grid, name)[2, 1] == pytest.approx(worst(getattr(m, name) for m in margins), rel=1e-9)
