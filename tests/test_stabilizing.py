"""Stabilising sets: published ends, and cell by cell against decisions made another way."""

from __future__ import annotations

import math

import control as ct
import numpy as np
import pytest

import railslip_ctrl
from railslip_ctrl import DeadTimeLoop, stabilizing_pi
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.design import actuated_plant, intersection, stabilizing_pid
from railslip_ctrl.loop import Rational
from railslip_ctrl.model.adhesion import published_law
from railslip_ctrl.model.linearization import linearize, operating_point
from railslip_ctrl.model.vehicle import PARK2008, Rail

S = ct.tf("s")
UNSTABLE = 1 / ((4 * S - 1) * (0.6 * S + 1))
NEAR = 1e-6  # relative distance at which inside and outside are told apart
PID = {"derivative_filter": 0.06}


# -- published and closed-form ends ---------------------------------------------------------------------------


def test_p_and_pi_sets_of_an_unstable_lag_with_dead_time():
    region = stabilizing_pi(UNSTABLE, dead_time=0.15)
    assert region.kp_range == pytest.approx((1, 23.3988133859), abs=0.5001e-10, rel=0)
    assert region.ki_limit(2) == pytest.approx(1.077454753, abs=0.5001e-9, rel=0)
    assert region.ki_limit(12) == pytest.approx(6.719615019, abs=0.5001e-9, rel=0)
    assert region.reason == ""
    assert not region.is_empty
    assert region.contains(12, 6.7)
    assert not region.contains(12, 6.73)


def test_p_set_of_a_faster_unstable_lag():
    region = stabilizing_pi(1 / ((S - 1) * (0.5 * S + 1)), dead_time=0.2)
    assert region.kp_range == pytest.approx((1, 2.54747483502), abs=0.5001e-11, rel=0)


def test_pole_times_dead_time_of_twelve_cannot_be_stabilised():
    region = stabilizing_pi(1 / (S - 5), dead_time=2.4)
    assert region.kp_range is None
    assert region.is_empty
    assert "unstable poles: 5 1/s; unstable pole times dead time is 12" in region.reason
    assert "at least 1 closed-loop pole" in region.reason
    assert region.ki_limit(6.0) == 0.0
    assert not region.contains(6.0, 0.0)


def test_unstable_lag_is_stabilisable_only_if_dead_time_and_lag_are_shorter():
    rng = np.random.default_rng(11)
    for _ in range(40):
        t1, t2, theta = rng.uniform(0.2, 5), rng.uniform(0.05, 2), rng.uniform(0.02, 2)
        region = stabilizing_pi(1 / ((t1 * S - 1) * (t2 * S + 1)), theta)
        assert (region.kp_range is not None) == (theta + t2 < t1)
    for side in (1 - NEAR, 1 + NEAR):
        region = stabilizing_pi(1 / ((2.0 * S - 1) * (0.5 * S + 1)), 1.5 * side)
        assert (region.kp_range is not None) == (side < 1)


def test_integrator_with_dead_time():
    region = stabilizing_pi(2 / S, dead_time=0.25)
    assert region.kp_range == pytest.approx((0, np.pi / 2 / 0.5), rel=1e-14, abs=1e-14)


def test_plants_without_dead_time_follow_routh():
    assert stabilizing_pi(1 / (S + 1)).kp_range == (-1.0, np.inf)
    assert stabilizing_pi(1 / (S + 1)).ki_limit(0.3) == np.inf
    region = stabilizing_pi(1 / ((S + 1) * (S + 2) * (S + 3)))
    assert region.kp_range == pytest.approx((-6, 60), rel=1e-13)
    for kp in (-5.0, 0.0, 20.0, 59.0):
        # s^4 + 6 s^3 + 11 s^2 + (6 + kp) s + ki: ki < (6 + kp)(66 - 6 - kp)/36
        assert region.ki_limit(kp) == pytest.approx((6 + kp) * (60 - kp) / 36, rel=1e-12)
    assert stabilizing_pi(1 / S).ki_intervals(0.5) == ((0.0, np.inf),)
    assert stabilizing_pi(1 / S**2).kp_range is None
    assert stabilizing_pi(Rational(np.array([]), np.array([-1.0]), 1.0)).ki_limit(1e9) == np.inf


def test_a_lag_of_many_equal_parts_has_its_closed_form():
    # (1 + s/n)^-n turns by 180 deg at n tan(pi/n), where its gain is cos(pi/n)^n; its R turns back every 3 degrees
    n = 60
    region = stabilizing_pi(Rational(np.array([]), np.full(n, -float(n)), float(n) ** n))
    assert region.kp_range == pytest.approx((-1, math.cos(math.pi / n) ** -n), rel=1e-13)  # n roundings and more
    limit = region.ki_limit(0.3)
    assert region.certified_contains(0.3, limit * (1 - NEAR))
    assert not region.certified_contains(0.3, limit * (1 + NEAR))


def test_gain_at_infinity_is_a_boundary_of_a_biproper_plant():
    region = stabilizing_pi(2 * (S + 2) / (S + 1))
    assert region.p_intervals == ((-np.inf, -0.5), (-0.25, np.inf))
    # beyond the pole's passage through infinity ki < 0 would be needed
    assert region.kp_range == (-0.25, np.inf)
    assert region.ki_intervals(-3.0) == ()
    assert not region.contains(-3.0, 0.1)
    assert region.contains(-3.0, 0.0)


def test_a_derivative_part_moves_the_gain_at_infinity():
    plant = 2 * (S + 2) / (S + 1)  # C(inf) P(inf) = -1: kp + kd/Tf = -1/2, or kp (1 + Td/Tf) = -1/2
    by_gain = stabilizing_pid(plant, derivative_gain=0.3, derivative_filter=0.1)
    assert by_gain.p_intervals[0] == (-np.inf, pytest.approx(-3.5, rel=1e-14))
    by_time = stabilizing_pid(plant, derivative_time=0.3, derivative_filter=0.1)
    assert by_time.p_intervals[1] == (pytest.approx(-0.125, rel=1e-14), np.inf)


def test_ki_is_bounded_across_a_zero_on_the_axis():
    region = stabilizing_pi(Rational(np.array([0.7j, -0.7j]), np.array([-1.0, -0.5, -2.0]), 1.0), 0.4)
    for kp in np.linspace(*region.kp_range, 9)[1:-1]:
        ((low, high),) = region.ki_intervals(kp)
        assert (low, region.contains(kp, high * (1 - NEAR)), region.contains(kp, high * (1 + NEAR))) == (0, True, False)


def test_an_unstable_plant_may_need_ki_away_from_zero():
    islands = stabilizing_pi(Rational(np.array([-0.4]), np.array([-0.2 + 2.9j, -0.2 - 2.9j, 0.3]), 1.0), 0.1)
    assert islands.kp_range is None
    assert not islands.is_empty
    assert "larger ki does stabilise, for example at kp = -1.24" in islands.reason
    ((low, high),) = islands.ki_intervals(-1.24)
    assert low > 3
    assert islands.ki_limit(-1.24) == high
    for ki, inside in ((low, 1), (high, -1)):
        assert islands.contains(-1.24, ki * (1 + inside * NEAR))
        assert not islands.contains(-1.24, ki * (1 - inside * NEAR))


@pytest.mark.parametrize(
    ("plant", "match"),
    [
        (-1 / (S + 1), r"sign of the plant's numerator.*change the sign.*-5\.89017 < kp < 1"),
        (S / (S + 1) ** 2, r"zero at s = 0 cancels the integrator; use P control \(ki = 0"),
        (0 * S / (S + 1), "the plant is 0"),
        ((S - 1) / ((S - 1) * (S + 2)), "pole at 1.* is cancelled by a zero"),
        (1 / S**3, "at least 1 closed-loop pole stays unstable"),
        (1 / ((S - 9) * (S - 8)), "at least 2 closed-loop poles stay unstable"),
    ],
)
def test_empty_sets_say_why(plant, match):
    region = stabilizing_pi(plant, dead_time=0.3)
    assert region.kp_range is None
    assert region.kp_intervals == ()
    assert region.ki_limit(0.5) == 0.0
    assert not region.contains(0.5, 0.1)
    with pytest.raises(AssertionError, match=match):
        raise AssertionError(region.reason)


def test_negative_plant_is_the_positive_one_with_both_gains_negated():
    mirrored = stabilizing_pi(-UNSTABLE, dead_time=0.15)
    assert mirrored.p_intervals[0] == pytest.approx((-23.3988133859, -1), rel=1e-11)
    assert not mirrored.contains(-12.0, 1.0)
    assert mirrored.contains(-12.0, 0.0)


# -- every cell against the exact count, and against the discretised delay operator ---------------------------


def random_roots(rng, count, high):
    found = []
    while len(found) < count:
        kind = rng.random()
        if count - len(found) >= 2 and kind < 0.4:
            root = complex(rng.uniform(-4, high), rng.uniform(0.05, 6))
            found += [root, root.conjugate()]
        else:
            found.append(0.0 if kind < 0.5 and high <= 1 else rng.uniform(-4, high))
    return np.array(found)


def random_region(rng):
    """A plant of order 1 to 4, zeros, integrators and right half plane included, under a PI or one of two PIDs."""
    order = int(rng.integers(1, 5))
    zeros, poles = random_roots(rng, int(rng.integers(0, order)), 3), random_roots(rng, order, 1)
    plant = Rational(zeros, poles, rng.choice([1, 1, 1, -1]) * 10 ** rng.uniform(-1, 1))
    dead_time = float(rng.choice([0.0, rng.uniform(0.01, 1)]))
    lag = 10 ** rng.uniform(-2, 0)
    kind = rng.integers(3)
    if kind == 0:
        return stabilizing_pi(plant, dead_time), (0.0, 0.0, 0.0)
    if kind == 1:
        td = rng.uniform(0, 2)
        return stabilizing_pid(plant, dead_time, derivative_time=td, derivative_filter=lag), (td, 0.0, lag)
    kd = rng.uniform(-2, 2)
    return stabilizing_pid(plant, dead_time, derivative_gain=kd, derivative_filter=lag), (0.0, kd, lag)


def columns(rng, region):
    """kp inside and outside the set, and just inside and just outside its ends."""
    ends = np.array([e for pair in region.p_intervals for e in pair if np.isfinite(e) and e != 0])
    scale = np.abs(ends).max() if ends.size else 10 ** rng.uniform(-1, 1)
    found = list(rng.normal(size=3) * scale)
    for low, high in region.p_intervals:
        found += list(rng.uniform(max(low, -3 * scale), min(high, 3 * scale), 3))
    return found, [e * (1 + side * NEAR) for e in ends for side in (-1, 1)]


@pytest.mark.parametrize("seed", range(2))
def test_intervals_agree_with_the_exact_root_count_everywhere(seed):
    rng = np.random.default_rng(seed)
    points = 0
    for _ in range(50):
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
    assert points > 1000


def resonant_region(rng):
    """Up to three resonances and antiresonances of damping down to 1e-6, or many equal lags; dead time up to 20 s."""
    if rng.random() < 0.2:
        order = int(rng.integers(8, 30))
        plant = Rational(np.array([]), np.full(order, -float(order)), float(order) ** order)
    else:
        counts = rng.integers([1, 0], [4, 2]).tolist()
        pairs = []
        for count in counts:
            size, damping = 10 ** rng.uniform(-1, 1, count), 10 ** rng.uniform(-6, -0.5, count)
            upper = size * (-damping + 1j * np.sqrt(1 - damping**2))
            pairs.append(np.concatenate([upper, upper.conj()]))
        plant = Rational(pairs[1], np.append(pairs[0], -(10 ** rng.uniform(-1, 0.5))), 1.0)
        plant = plant * (1 / plant.dc_gain)
    dead_time = 10 ** rng.uniform(-2, 1.3)
    kind = rng.integers(3)
    if kind == 0:
        return stabilizing_pi(plant, dead_time)
    derivative = {"derivative_time": rng.uniform(0, 2)} if kind == 1 else {"derivative_gain": rng.uniform(-0.5, 0.5)}
    return stabilizing_pid(plant, dead_time, derivative_filter=10 ** rng.uniform(-2, 0), **derivative)


def test_resonances_and_long_dead_times_hide_no_boundary():
    rng = np.random.default_rng(15)
    for _ in range(60):
        region = resonant_region(rng)
        low, high = region.kp_range or (-1.0, 1.0)
        turns = region.decomposition.curve(region.decomposition.turning_points)[0]
        turns = turns[(turns > low) & (turns < high)]
        columns = [
            *rng.uniform(low, high, 3),
            *(rng.choice(turns, 2) * (1 + 1e-9 * rng.normal(size=2)) if turns.size else ()),
        ]
        gains = [(e * (1 + side * NEAR), 0.0) for pair in region.p_intervals for e in pair for side in (-1, 1)]
        sets = {kp: region.ki_intervals(kp) for kp in columns}
        for kp, intervals in sets.items():
            ends = [e for pair in intervals for e in pair if 0 < e < np.inf]
            gains += [(kp, e * (1 + side * NEAR)) for e in ends for side in (-1, 1)]
            gains += [(kp, max(ends, default=1.0) * 10 ** rng.uniform(-4, 0.3)) for _ in range(8)]
        for kp, ki in gains[:100]:
            expected = region.p_intervals if ki == 0 else sets[kp]
            assert region.contains(kp, ki) == any(a < (ki or kp) < b for a, b in expected), (kp, ki)


def generator_spectrum(plant, dead_time, kp, ki, derivative, points):
    """Closed-loop spectrum: plant and PID realised apart by python-control, the delayed command on Chebyshev points."""
    td, kd, lag = derivative
    p = ct.ss(ct.zpk(plant.zeros, plant.poles, plant.gain))
    # states of the controller: the integral of y (if any), then the filtered y (if any); u = -C y
    n, integral, filtered = p.nstates, int(ki != 0), int(lag != 0)
    size = n + integral + filtered
    now = np.zeros((size, size))
    now[:n, :n] = p.A
    output = np.zeros(size)
    output[:n] = p.C[0]
    command = kp * output
    if integral:
        now[n] = output
        command[n] += ki
    if filtered:  # lag x' = y - x, derivative part (kd + kp td)(y - x)/lag
        now[-1] = output / lag
        now[-1, -1] -= 1 / lag
        change = output.copy()
        change[-1] -= 1
        command = command + (kd + kp * td) / lag * change
    if dead_time == 0:
        now[:n] -= np.outer(p.B[:, 0], command)
        return np.linalg.eigvals(now)
    x = np.cos(np.pi * np.arange(points + 1) / points)
    c = np.r_[2, np.ones(points - 1), 2] * (-1.0) ** np.arange(points + 1)
    d = np.outer(c, 1 / c) / (x[:, None] - x + np.eye(points + 1))
    d = (d - np.diag(d.sum(axis=1))) * 2 / dead_time
    # the line carries the command from x = 1, where it is -command, to x = -1, where the plant receives it
    generator = np.zeros((size + points, size + points))
    generator[:size, :size] = now
    generator[:n, -1] = p.B[:, 0]
    generator[size:, size:] = d[1:, 1:]
    generator[size:, :size] = -np.outer(d[1:, 0], command)
    return np.linalg.eigvals(generator)


def test_contains_agrees_with_the_discretised_delay_operator():
    rng = np.random.default_rng(2005)
    decided = inside = 0
    for _ in range(60):
        region, derivative = random_region(rng)
        inner, _ = columns(rng, region)
        for kp in inner:
            limit = region.ki_limit(kp)
            usual = limit if 0 < limit < np.inf else max(abs(kp), 0.1)
            for ki in (0.0, usual * rng.uniform(0.1, 0.9), usual * rng.uniform(1.1, 3)):
                coarse, fine = (
                    generator_spectrum(region.plant, region.dead_time, kp, ki, derivative, n).real for n in (18, 26)
                )
                settled = np.count_nonzero(coarse > 0) == np.count_nonzero(fine > 0)
                if not settled or np.abs(fine).min() < 1e-4:
                    continue  # on the boundary, or where this decision has not converged itself
                decided += 1
                inside += region.contains(kp, ki)
                assert region.contains(kp, ki) == bool(fine.max() < 0)
    assert decided > 400
    assert inside > 80


def test_boundaries_put_poles_on_the_axis():
    rng = np.random.default_rng(3)
    for _ in range(40):
        region, (td, kd, lag) = random_region(rng)
        omega = np.geomspace(5e-6, 5.0, 60)
        kp, ki = region.decomposition.curve(omega)
        s = 1j * omega
        derivative = s / (lag * s + 1)
        c = kp * (1 + td * derivative) + ki / s + kd * derivative
        with np.errstate(divide="ignore", invalid="ignore"):
            loop = c * region.plant(s) * np.exp(-s * region.dead_time)
        usable = np.isfinite(loop) & (np.abs(region.plant(s)) > 1e-3)
        assert np.abs(1 + loop[usable]) == pytest.approx(0, abs=1e-8)  # kp and ki/omega may nearly cancel


def test_next_to_the_boundary_every_gain_is_decided():
    region = stabilizing_pi(UNSTABLE, dead_time=0.15)
    for kp in (2.0, 7.0, 12.0, 20.0):
        limit = region.ki_limit(kp)
        assert region.contains(kp, limit * (1 - 1e-13))  # the limit itself is good to rounding
        assert not region.contains(kp, limit * (1 + 1e-13))
    assert not region.contains(12.0, -1e-3)


# -- PID ------------------------------------------------------------------------------------------------------


def test_derivative_time_and_gain_agree_where_they_are_the_same_controller():
    by_time = stabilizing_pid(UNSTABLE, 0.15, derivative_time=0.6, **PID)
    for kp in (2.0, 12.0, 29.0):
        by_gain = stabilizing_pid(UNSTABLE, 0.15, derivative_gain=0.6 * kp, **PID)
        assert np.array(by_gain.ki_intervals(kp)) == pytest.approx(np.array(by_time.ki_intervals(kp)), rel=1e-11)
    without = stabilizing_pid(UNSTABLE, 0.15, derivative_gain=0.0, **PID)
    assert without.kp_range == pytest.approx((1, 23.3988133859), rel=1e-11)
    assert without.ki_limit(12) == pytest.approx(6.719615019, rel=1e-9)


def test_pid_gain_range_is_that_of_the_loop_engine():
    region = stabilizing_pid(UNSTABLE, 0.15, derivative_time=0.6, **PID)
    lead = (0.66 * S + 1) / (0.06 * S + 1)  # 1 + Td s/(Tf s + 1)
    assert region.kp_range == pytest.approx(
        DeadTimeLoop(12 * lead * UNSTABLE, 0.15).scaled(1 / 12).stabilizing_gain_range
    )


# -- many plants ----------------------------------------------------------------------------------------------


def wheel_plants():
    found = []
    for rail in Rail:
        law = published_law("bristle", rail)
        for speed in (20, 60, 100):
            point = operating_point(law, PARK2008, speed / 3.6, law.reference_slip(rail), rail=rail)
            found.append(actuated_plant(linearize(point), PARK2008.actuator))
    return found


def test_intersection_over_operating_points():
    regions = [stabilizing_pi(p, PARK2008.actuator.dead_time) for p in wheel_plants()]
    common = intersection(regions)
    low, high = common.kp_range
    assert low == max(r.kp_range[0] for r in regions)
    assert high == min(r.kp_range[1] for r in regions)
    assert common.reason == ""
    rng = np.random.default_rng(1)
    for kp in rng.uniform(low, high, 10):
        limit = common.ki_limit(kp)
        assert limit == min(r.ki_limit(kp) for r in regions)
        assert common.contains(kp, limit * (1 - NEAR))
        assert not common.contains(kp, limit * (1 + NEAR))
    assert not common.contains(low * (1 - NEAR), 0.0)


def test_intersection_intersects_intervals_not_only_their_ends():
    # one plant needs more than a least ki, the other less than a largest: their limits alone would not tell
    island = stabilizing_pi(Rational(np.array([-0.4]), np.array([-0.2 + 2.9j, -0.2 - 2.9j, 0.3]), 1.0), 0.1)
    easy = stabilizing_pi(Rational(np.array([]), np.array([-6.0]), 1.0), 0.1)
    both = intersection([island, easy])
    ((low, high),) = both.ki_intervals(-1.24)
    assert (low, high) == island.ki_intervals(-1.24)[0]
    assert both.kp_range is None
    assert both.reason.startswith("plant 1: no kp stabilises with small ki")
    slow = stabilizing_pi(Rational(np.array([]), np.array([-1.0]), 30.0), 0.1)
    assert intersection([island, slow]).ki_limit(-1.24) == 0.0


def test_intersection_that_is_empty_names_the_ranges():
    strong, weak = stabilizing_pi(UNSTABLE, 0.15), stabilizing_pi(100 * UNSTABLE, 0.15)
    common = intersection([strong, weak])
    assert common.kp_range is None
    assert "plant 1: 1 < kp < 23.3988; plant 2: 0.01 < kp < 0.233988" in common.reason
    many = intersection([strong, strong, weak, weak], ("dry", "drier", "wet", "wetter"))
    assert "(dry: 1 < kp < 23.3988; wet: 0.01 < kp < 0.233988)" in many.reason  # two that exclude each other
    hopeless = stabilizing_pi(Rational(np.array([]), np.array([5.0]), 1.0), 2.4)
    alone = intersection([strong, hopeless, hopeless], ("dry", "wet", "wetter")).reason
    assert alone.startswith("wet (nor 1 more of the 3): no kp stabilises")
    with pytest.raises(InputError, match="names: 1 for 2 regions"):
        intersection([strong, weak], ("dry",))


# -- refusals -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: stabilizing_pi((S + 2) / (S + 1), 0.1), r"P\(inf\) = 1: the loop is neutral"),
        (lambda: stabilizing_pi(1 / S, -0.1), "dead time: -0.1"),
        (lambda: stabilizing_pi("1/s"), "not a linear system"),
        (lambda: stabilizing_pi((S + 2) / ((S + 1) * (1e-7 * S + 1)), 1.0).kp_range, "stays level up to"),
        (lambda: stabilizing_pi(1 / S).contains(np.nan, 0), "kp: nan"),
        (lambda: stabilizing_pi(1 / S).ki_limit(np.inf), "kp: inf"),
        (lambda: stabilizing_pid(1 / S, 0.1, derivative_filter=0.1), "either derivative_time"),
        (lambda: stabilizing_pid(1 / S, 0.1, derivative_time=1, derivative_gain=1, **PID), "either derivative_time"),
        (lambda: stabilizing_pid(1 / S, 0.1, derivative_time=1, derivative_filter=0.0), "derivative filter: 0.0 s"),
        (lambda: stabilizing_pid(1 / S, 0.1, derivative_time=-1, **PID), "derivative time: -1.0 s"),
        (lambda: stabilizing_pid(1 / S, 0.1, derivative_gain=np.nan, **PID), "derivative gain: nan"),
        (lambda: intersection([]), "no region is given"),
    ],
)
def test_unsuitable_input_is_refused(make, match):
    with pytest.raises(InputError, match=match):
        make()


def test_extreme_gains_are_decided_not_searched():
    region = stabilizing_pi(UNSTABLE, 0.15)
    assert region.ki_limit(1e12) == 0.0
    assert not region.contains(1e12, 0.0)
    assert "stabilizing_pi" in dir(railslip_ctrl)
