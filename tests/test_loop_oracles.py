"""Published and independently computed loops, exact dead time; each test is named by its source."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest

from railslip_ctrl import DeadTimeLoop
from railslip_ctrl.errors import UnstableLoopError

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


def test_delayed_integrator_gain_margin_is_not_the_one_of_pade():
    loop = DeadTimeLoop(2 / S, dead_time=0.3)
    assert loop.margins().gain_increase == pytest.approx(np.pi / 1.2, rel=1e-12)
    assert loop.pade(1).margins().gain_increase == printed(3.33)


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
