"""Verdicts on sampled loops that no grid may decide: the delay margin over fractions of the period, narrow peaks."""

import math

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq
from test_sampled import gain

from railslip_ctrl.core.errors import UnstableLoopError
from railslip_ctrl.loop import Rational, sampled
from railslip_ctrl.loop.sampled import SampledLoop


class FractionalModel:
    """PI control kp + ki h/(z - 1) of k (zero - s)/zero/(lag s + 1)^2 behind any dead time, with NumPy and SciPy alone.

    The period is 1 s; states: the lag's two, the integral, and the commands that are under way.
    """

    def __init__(self, zero: float, lag: float, kp: float, ki: float) -> None:
        self.a = np.array([[0.0, 1.0], [-(lag**-2), -2 / lag]])
        self.c = np.array([1.0, -1 / zero]) / lag**2
        self.kp, self.ki = kp, ki
        plant = Rational(np.array([zero]), np.full(2, -1 / lag), -1 / (zero * lag**2))
        self.loop = SampledLoop(Rational(np.array([1 - ki / kp]), np.array([1.0]), kp), plant, 0.0, 1.0)

    def driven(self, times: np.ndarray) -> np.ndarray:
        block = np.zeros((times.size, 3, 3))
        block[:, :2, :2], block[:, 1, 2] = self.a * times[:, None, None], times
        return expm(block)[:, :2, 2]

    def radius(self, dead_times: np.ndarray) -> np.ndarray:
        """Spectral radius at each dead time, s; all in one period."""
        whole = int(dead_times[0])
        now = self.driven(1 - (dead_times - whole))
        before = self.driven(np.ones(1)) - now
        command = np.zeros(4 + whole)
        command[:2], command[2] = -self.kp * self.c, 1.0
        matrix = np.zeros((dead_times.size, 4 + whole, 4 + whole))
        matrix[:, :2, :2], matrix[:, 2, 2], matrix[:, 2, :2] = expm(self.a), 1.0, -self.ki * self.c
        matrix[:, :2, 3 + whole] = before
        if whole:
            matrix[:, :2, 2 + whole] += now
            matrix[:, 4:, 3:-1] = np.eye(whole)
        else:
            matrix[:, :2] += now[:, :, None] * command
        matrix[:, 3] = command
        return np.abs(np.linalg.eigvals(matrix)).max(axis=1)

    def first_loss(self, dead_time: float, periods: int) -> float:
        """Least added dead time at which a scan in 64ths of a period, then bisected, finds the loop unstable, s."""
        for whole in range(int(dead_time), int(dead_time) + periods):
            times = whole + np.arange(64) / 64
            times = times[times > dead_time]
            unstable = np.flatnonzero(self.radius(times) >= 1) if times.size else times
            if unstable.size:
                high = times[unstable[0]]
                low = max(dead_time, high - 1 / 64)
                return brentq(lambda t: self.radius(np.array([t]))[0] - 1, low, high, xtol=1e-14) - dead_time
        return math.inf


def test_delay_margin_is_the_first_loss_of_stability_that_a_scan_of_eigenvalues_finds(monkeypatch):
    looked_at, part = [], sampled._part
    monkeypatch.setattr(sampled, "_part", lambda *given: looked_at.append(given[1].least.size) or part(*given))
    rng, beyond, checked = np.random.default_rng(15), 0, 0
    while checked < 16:
        zero, lag = 10 ** rng.uniform(-0.5, 0.7), 10 ** rng.uniform(-1, 0.3)
        model = FractionalModel(zero, lag, rng.uniform(0.05, 1.2), rng.uniform(0.005, 0.4))
        dead_time = rng.uniform(0.2, 2.5)
        if model.radius(np.array([dead_time]))[0] >= 1:
            continue
        checked += 1
        margin, expected = model.loop.delayed(dead_time).margins().delay_s, model.first_loss(dead_time, 8)
        if math.isinf(expected):
            beyond += 1
            assert margin > 7
        else:
            # the eigenvalues are good to some 1e-15, and the radius grows by more than 1e-5 of the added share
            assert margin == pytest.approx(expected, rel=1e-9)
    assert beyond < 8  # most are decided by the scan
    assert sum(looked_at) < 7_700  # boxes; bounds looser than need be show here alone


RESONANT = {
    # resonance, its damping, the dip beside it, its damping, gain, dead time; period 0.1 s; with a lag of 1 s
    "peak": (15.806749, 4.306e-6, 15.804366, 8.014e-5, 0.441226, 0.146655),
    "crossovers": (0.39231810, 1.0538e-4, 0.39216351, 2.843e-6, 0.742162, 0.08961),
    "phase crossover above 1": (0.33770287, 7.1609e-5, 0.33804286, 1.0664e-4, 2.012753, 0.131492),
}


def resonant(resonance, damping, dip, damping_dip, k, dead_time) -> SampledLoop:
    poles, zeros = (np.roots([1, 2 * z * w, w * w]) for w, z in ((resonance, damping), (dip, damping_dip)))
    return SampledLoop(gain(1.0), Rational(zeros, np.append(poles, -1.0), k), dead_time, 0.1)


@pytest.mark.parametrize("name", RESONANT)
def test_no_resonance_is_too_narrow_to_be_seen(name):
    # a grid of 40 points a decade sees none of these: Ms 1.06 for 11.9, gain margin 20.9 for 1.10, no crossover for two
    resonance, loop = RESONANT[name][0], resonant(*RESONANT[name])
    m = loop.margins()
    top = loop.nyquist_frequency
    grid = np.union1d(resonance * (1 + np.linspace(-2e-3, 2e-3, 200_000)), np.geomspace(1e-4, top, 2000))
    response = loop.response(grid[grid <= top])
    # the grid's step is a few hundredths of the narrowest peak's width
    assert m.ms == pytest.approx(np.max(np.abs(1 / (1 + response))), rel=1e-3)
    assert m.mt == pytest.approx(np.max(np.abs(response / (1 + response))), rel=1e-3)
    assert 1 / m.disk == pytest.approx(np.max(np.abs(1 / (1 + response) - 0.5)), rel=1e-3)
    crossings = np.count_nonzero(np.diff(np.abs(response) > 1))
    assert crossings <= m.gain_crossovers.size <= crossings + 1
    for limit in (m.gain_increase, m.gain_decrease):
        if 0 < limit < math.inf:
            outward = 1e-9 if limit > 1 else -1e-9
            assert not loop.scaled(limit * (1 + outward)).is_stable()
            assert loop.scaled(limit * (1 - outward)).is_stable()


@pytest.mark.parametrize(("poles", "k", "crossover", "phase_margin"), [
    ([-1e-7], 1e-6, 1e-7 * math.sqrt(99), math.pi - math.atan(math.sqrt(99))),
    ([0.0, -1.0], 1.2e-5, 1.2e-5, math.pi / 2 - 1.2e-5),  # near the lowest frequency that is looked at, 1e-5 of a pole
])  # fmt: skip
def test_a_loop_far_slower_than_its_period_has_the_margins_of_the_continuous_one(poles, k, crossover, phase_margin):
    m = SampledLoop(gain(1.0), Rational(np.array([]), np.array(poles), k), 0.0, 1.0).margins()
    assert m.gain_crossovers == pytest.approx([crossover], rel=1e-6)  # the hold is half a second of days
    assert m.delay_s == pytest.approx(phase_margin / crossover, rel=1e-5)  # and half a second in some 1e5


def test_a_pole_on_the_unit_circle_is_counted():
    # an integrator with gain 2: x[k+1] = -x[k]
    loop = SampledLoop(gain(2.0), Rational(np.array([]), np.array([0.0]), 0.1), 0.0, 10.0)
    m = loop.scaled(0.5).margins()
    assert (m.gain_increase, m.gain_increase_frequency, m.gain_decrease) == pytest.approx((2.0, math.pi / 10, 0.0))
    assert (m.ms, m.ms_frequency, m.mt) == pytest.approx((2.0, math.pi / 10, 1.0), rel=1e-12)  # S = 1 - 1/z, T = 1/z
    with pytest.raises(UnstableLoopError) as caught:
        loop.margins()
    assert (caught.value.unstable_poles, caught.value.stabilizing_gain_range) == (1, (0.0, pytest.approx(1.0)))


def test_two_phase_crossovers_side_by_side_hold_the_gains_that_stabilise():
    # k (s + 1)^2/s^3: the phase rises past -180 deg by 1e-4 rad before the dead time turns it back
    grid = np.linspace(1.5, 4.0, 2001)

    def delayed(dead_time: float) -> SampledLoop:
        return SampledLoop(gain(1.0), Rational(np.full(2, -1.0), np.zeros(3), 1.0), dead_time, 0.1)

    loop = delayed(brentq(lambda d: np.angle(-delayed(d).response(grid)).max() - 1e-4, 0.2, 0.35))
    limits = loop.stabilizing_gain_range
    low, high = limits
    assert low < high < 1.1 * low
    within = [loop.scaled(edge * (1 + move)).is_stable() for edge in limits for move in (-1e-7, 1e-7)]
    assert within == [False, True, True, False]
