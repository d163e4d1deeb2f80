"""Published and independently computed loops, exact dead time; each test is named by its source."""

from __future__ import annotations

from types import SimpleNamespace

import control as ct
import numpy as np
import pytest

from railslip_ctrl import DeadTimeLoop
from railslip_ctrl.core.errors import InputError, UnstableLoopError
from railslip_ctrl.loop import Rational, stability
from railslip_ctrl.loop.rational import pade

S = ct.tf("s")


def digits(value: float) -> float:
    """Half a unit in the last place of a printed number."""
    text = f"{value!r}".rstrip("0")
    return 0.5001 * 10.0 ** -(len(text.split(".")[1]) if "." in text else 0)


def printed(value: float, *, places: int | None = None):
    """A printed number, to be met within half a unit of its last place."""
    return pytest.approx(value, abs=digits(value) if places is None else 0.5001 * 10.0**-places, rel=0)


def test_matlab_allmargin_page_and_robust_and_optimal_control_jl():
    m = DeadTimeLoop(25 / (S**3 + 10 * S**2 + 10 * S + 10)).margins()
    assert m.gain_increase == printed(3.6, places=4)
    assert m.gain_increase_frequency == printed(3.1623)
    assert m.gain_decrease == 0.0
    assert m.phase_deg == printed(29.1104)
    assert m.phase_frequency == printed(1.7844)
    assert m.delay_s == printed(0.2847)
    assert m.disk == printed(0.4580925)  # RobustAndOptimalControl.jl's 0.458145 is a grid value
    assert m.disk_phase_deg == printed(25.8017)
    assert m.disk_frequency == printed(1.95503)


def test_third_order_with_gain_margin_1_96():
    m = DeadTimeLoop(2 / ((S + 0.4) * (S + 1) ** 2)).margins()
    assert m.gain_increase == printed(1.96, places=4)
    assert m.gain_increase_frequency == printed(1.3416)
    assert m.phase_deg == printed(24.9252)
    assert m.phase_frequency == printed(0.9604)


def unstable_plant_loop(gain: float = 1.2) -> DeadTimeLoop:
    """gain (8 s + 1)/(8 s) * 1/(s - 0.25) * exp(-0.15 s)/(0.6 s + 1)."""
    return DeadTimeLoop(gain * (8 * S + 1) / (8 * S) / (S - 0.25) / (0.6 * S + 1), dead_time=0.15)


def test_open_loop_unstable_pi_loop_margins():
    loop = unstable_plant_loop()
    assert loop.is_stable()
    assert loop.open_loop_unstable_poles == 1
    m = loop.margins()
    assert m.gain_decrease == printed(0.234619891262)
    assert m.gain_decrease_frequency == printed(0.208677852)
    assert m.gain_increase == printed(4.39578339078)
    assert m.gain_increase_frequency == printed(2.73581826)
    assert m.phase_deg == printed(29.2144640746)
    assert m.phase_frequency == printed(1.00493595554)
    assert m.delay_s == printed(0.507384161643)
    assert m.ms == printed(2.21149397822)
    assert m.mt == printed(1.98840564198)
    assert m.disk == printed(0.507978316)


def test_open_loop_unstable_pi_loop_poles():
    poles = unstable_plant_loop().closed_loop_poles(count=3)
    assert poles[0] == pytest.approx(-0.181657592535, abs=1e-12)
    assert poles[1] == pytest.approx(-0.456875855256 + 1.065733875339j, abs=1e-12)
    assert poles[2] == np.conj(poles[1])


def test_open_loop_unstable_pi_loop_at_gain_20_is_refused():
    loop = unstable_plant_loop(20.0)
    assert not loop.is_stable()
    with pytest.raises(UnstableLoopError, match="unstable with 2 pole") as caught:
        loop.margins()
    # the stabilising interval of the loop at gain 1.2, seen from gain 20
    assert caught.value.stabilizing_gain_range == pytest.approx(
        (0.234619891262 * 1.2 / 20, 4.39578339078 * 1.2 / 20), rel=1e-11
    )


def test_lambert_w_poles_of_the_delayed_integrator():
    # s + exp(-s) = 0 is s = W_k(-1): an independent closed form
    from scipy.special import lambertw

    expected = [lambertw(-1, k) for k in (0, -1, 1, -2, 2, -3)]
    found = DeadTimeLoop(1 / S, dead_time=1.0).closed_loop_poles(count=6)
    for branch in expected:
        assert np.min(np.abs(found - branch)) < 1e-12
    assert found[0] == pytest.approx(-0.3181 + 1.3372j, abs=1e-4)


@pytest.mark.parametrize("gain", [0.4, -3.0])
def test_poles_without_dead_time_of_a_loop_that_passes_all_frequencies(gain, monkeypatch):
    # gain (s^8 + 1)/(s^8 + 256); the eigenvalues alone, as Newton's method finds poles from bad guesses too
    monkeypatch.setattr(stability, "_NEWTON_STEPS", 0)
    turns = np.exp(1j * np.pi * np.arange(1, 16, 2) / 8)
    poles = stability.rightmost_poles(Rational(turns, 2 * turns, gain), 0.0, 9)
    assert poles**8 == pytest.approx(np.full(8, -(256 + gain) / (1 + gain)), rel=1e-12)
    assert np.abs(np.diff(np.sort(np.angle(poles)))) == pytest.approx(np.full(7, np.pi / 4))
    assert list(stability.rightmost_poles(Rational(turns[:0], np.array([0.0, -1.0]), 0.0), 1.0, 9)) == [0, -1]


def test_guesses_of_poles_near_0_are_good_before_newton_s_method_takes_them():
    system = Rational(np.array([-1.0, -2 + 3j, -2 - 3j, 4.0]), np.array([0.0, -0.5, -1 + 1j, -1 - 1j]), 0.4)
    start = stability._start_values(system, 0.8, 40)
    near = start[np.argsort(np.abs(start))[:6]]
    parts = np.polyval(np.poly(system.poles), near), system.gain * np.polyval(np.poly(system.zeros), near)
    parts = parts[0], parts[1] * np.exp(-0.8 * near)
    assert np.all(np.abs(sum(parts)) < 1e-9 * (np.abs(parts[0]) + np.abs(parts[1])))


def test_poles_that_the_root_count_contradicts_are_not_returned(monkeypatch):
    monkeypatch.setattr(stability, "count_right_of", lambda *_: SimpleNamespace(marginal=False, right=7.0))
    with pytest.raises(stability.SpectrumError, match="could not be confirmed"):
        DeadTimeLoop(1 / S, 1.0).closed_loop_poles(2)


def test_delayed_integrator_gain_margin_is_not_the_one_of_pade():
    loop = DeadTimeLoop(2 / S, dead_time=0.3)
    assert loop.margins().gain_increase == pytest.approx(np.pi / 1.2, rel=1e-12)
    assert loop.pade(1).margins().gain_increase == printed(3.33)


def test_pade_of_order_2_is_its_closed_form():
    x = np.array([0.6j, 0.3, -1.0])
    assert pade(0.3, 2)(x / 0.3) == pytest.approx((12 - 6 * x + x * x) / (12 + 6 * x + x * x), rel=1e-14)
    assert pade(0.0, 2)(x) == pytest.approx(1.0)
    assert pade(0.3, 100)(x / 0.3) == pytest.approx(np.exp(-x), rel=1e-12)
    for dead_time, order in ((-0.3, 2), (0.3, 0), (0.3, 101)):
        with pytest.raises(InputError, match="not allowed"):
            pade(dead_time, order)


@pytest.mark.parametrize(
    ("plant", "dead_time", "low", "high", "frequency"),
    [
        (1 / ((4 * S - 1) * (0.6 * S + 1)), 0.15, 1.0, 23.3988133859, 2.90231629),
        (1 / ((S - 1) * (0.5 * S + 1)), 0.2, 1.0, 2.54747483502, None),
    ],
    ids=["(4s-1)(0.6s+1)", "(s-1)(0.5s+1)"],
)
def test_stabilising_p_gains_of_unstable_lags(plant, dead_time, low, high, frequency):
    loop = DeadTimeLoop(1.5 * plant, dead_time=dead_time)
    assert np.multiply(loop.stabilizing_gain_range, 1.5) == pytest.approx((low, high), rel=1e-11)
    if frequency is not None:
        assert loop.margins().gain_increase_frequency == printed(frequency)


def test_unstable_pole_times_dead_time_12_is_not_stabilised_by_any_gain():
    assert DeadTimeLoop(2 / (S - 5), dead_time=2.4).stabilizing_gain_range is None
