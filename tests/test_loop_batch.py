"""The vectorised margins against the scalar engine, which has its own tests."""

from dataclasses import fields

import numpy as np
import pytest

from railslip_ctrl import DeadTimeLoop, InputError
from railslip_ctrl.loop import Rational, batch
from railslip_ctrl.loop.batch import BatchMargins, batch_margins, stack

NAMES = [f.name for f in fields(BatchMargins) if f.name not in ("stable", "unstable_poles")]
VALUES = [name for name in NAMES if not name.endswith("_frequency")]


def slip_loops(n, *, lead=False, dead_time=True, seed=0):
    rng = np.random.default_rng(seed)
    lag, reset = rng.uniform(0.3, 0.9, n), 10 ** rng.uniform(-0.5, 1.5, n)
    slip_pole, fast_pole, zero = rng.uniform(-1.5, 3, n), rng.uniform(-40, -2, n), rng.uniform(-30, -1, n)
    gain = 10 ** rng.uniform(-1, 1, n) / lag * fast_pole / zero
    zeros, poles = [-1 / reset, zero], [np.zeros(n), -1 / lag, slip_pole, fast_pole]
    if lead:
        zeros.append(-1 / (lag * rng.uniform(0.8, 1.2, n)))
        poles.append(-10 / lag)
        gain = 10 * gain
    tau = rng.uniform(0.05, 0.4, n) if dead_time else np.zeros(n)
    return np.stack(zeros, axis=1).astype(complex), np.stack(poles, axis=1).astype(complex), gain, tau


def random_roots(rng, n, real, pairs):
    """n sets of roots: real ones of either sign or 0, pairs with a damping ratio down to 1e-5, of either sign."""
    size = 10 ** rng.uniform(-2, 1.5, (n, real))
    sign = rng.choice([-1.0, 1.0, 0.0], (n, real), p=[0.72, 0.14, 0.14])
    frequency, damping = 10 ** rng.uniform(-1, 1.5, (n, pairs)), 10 ** rng.uniform(-5, -0.01, (n, pairs))
    pair = frequency * (-damping * rng.choice([1, -1], (n, pairs), p=[0.9, 0.1]) + 1j * np.sqrt(1 - damping**2))
    return np.concatenate([sign * size, pair, pair.conj()], axis=1)


def random_loops(n, zero_shape, pole_shape, seed):
    """Loops with `(real, pairs)` zeros and poles, gains over three decades and of either sign, a third without tau."""
    rng = np.random.default_rng(seed)
    zeros, poles = random_roots(rng, n, *zero_shape), random_roots(rng, n, *pole_shape)
    level = [np.prod(np.where(r == 0, 1, np.abs(r)), axis=1) for r in (zeros, poles)]
    gain = 10 ** rng.uniform(-2, 1.5, n) * level[1] / level[0] * rng.choice([1, -1], n, p=[0.85, 0.15])
    return zeros, poles, gain, rng.choice([0.0, 1.0, 1.0], n) * rng.uniform(0, 1, n)


def assert_equals_scalar(arguments, found, *, names=VALUES, every=1):
    for i, (zeros, poles, gain, tau) in list(enumerate(zip(*arguments, strict=True)))[::every]:
        loop = DeadTimeLoop(Rational(zeros, poles, gain), tau)
        assert found.stable[i] == loop.is_stable()
        assert found.unstable_poles[i] == loop.unstable_closed_loop_poles
        ours = {name: getattr(found, name)[i] for name in names}
        if not loop.is_stable():
            assert all(np.isnan(value) for value in ours.values())
            continue
        expected = {name: getattr(loop.margins(), name) for name in names}
        # 1e-7 is the promise; both refine to rounding, which a distance of 1e-9 to -1 magnifies to about that
        assert ours == pytest.approx(expected, rel=1e-7, abs=1e-12, nan_ok=True), (i, loop.system, tau)


@pytest.fixture
def used(monkeypatch):
    """The loops handed to the scalar engine."""
    found = []
    monkeypatch.setattr(batch, "DeadTimeLoop", lambda system, tau: found.append(system) or DeadTimeLoop(system, tau))
    return found


@pytest.mark.parametrize(("lead", "dead_time"), [(False, False), (True, True)])
def test_wheel_slip_loops_equal_the_scalar_engine_without_using_it(lead, dead_time, used):
    arguments = slip_loops(1100, lead=lead, dead_time=dead_time)  # twice more than are worked on together
    found = batch_margins(*arguments)
    assert (len(used), len(found)) == (0, 1100)
    assert 0.2 < found.stable.mean() < 0.9
    assert found.unstable_poles.max() >= 2
    # without dead time some peaks tie with the end of the axis, where rounding decides which frequency is named
    assert_equals_scalar(arguments, found, names=NAMES if dead_time else VALUES, every=7)


@pytest.mark.parametrize(("zero_shape", "pole_shape"), [  # numbers of real ones and of pairs
    *(((0, 0), (1, 0)), ((0, 0), (0, 1)), ((0, 0), (0, 3)), ((1, 0), (3, 0)), ((1, 0), (1, 1)), ((2, 0), (1, 1))),
    *(((0, 1), (2, 1)), ((0, 1), (4, 0)), ((2, 0), (2, 2)), ((1, 1), (0, 2)), ((2, 1), (4, 1)), ((1, 2), (2, 2))),
])  # fmt: skip
def test_resonances_integrators_and_non_minimum_phase_equal_the_scalar_engine(zero_shape, pole_shape):
    arguments = random_loops(60, zero_shape, pole_shape, seed=sum(zero_shape) + 10 * sum(pole_shape))
    assert_equals_scalar(arguments, batch_margins(*arguments))


@pytest.mark.parametrize(
    ("left_out", "names"), [("gain_margins", ("gain_increase", "gain_decrease")), ("peaks", ("ms", "mt", "disk"))]
)
def test_margins_that_are_not_asked_for_are_nan_and_change_no_other(left_out, names):
    delicate = stack([Rational([-1.0], [-1e-9 + 1j, -1e-9 - 1j], 0.01)], 0.0)  # left to the scalar engine
    for arguments in (slip_loops(50), delicate):
        whole, part = batch_margins(*arguments), batch_margins(*arguments, **{left_out: False})
        assert whole.stable.any()
        for name in NAMES:
            if name.removesuffix("_frequency") in names:
                assert np.isnan(getattr(part, name)).all()
            else:
                assert np.array_equal(getattr(part, name), getattr(whole, name), equal_nan=True)
        assert np.array_equal(part.unstable_poles, whole.unstable_poles)


@pytest.mark.parametrize(("damping", "level", "tau"), [(0.05, 9e-4, 10.0), (0.02, 3.9e-4, 3.0)])
def test_a_weak_resonance_behind_more_than_20_phase_crossovers_limits_the_gain(damping, level, tau):
    pole = 100 * (-damping + 1j * np.sqrt(1 - damping**2))
    arguments = stack([Rational([], [pole, pole.conjugate()], level * 100**2)], tau)
    assert_equals_scalar(arguments, batch_margins(*arguments))


HALF_TURN = np.pi / 2
DELICATE = {
    "pair on the axis": ([], [1j, -1j], 4.0, 0.0),
    "damped by the feedback": ([0.0], [1j, -1j], 1.0, 0.0),
    "double integrator": ([], [0, 0], 1.0, 0.0),
    "hidden integrator": ([0.0], [0.0, -1.0], 1.0, 0.1),
    "hidden resonance on the axis": ([1j, -1j], [1j, -1j, -1.0], 1.0, 0.1),
    "pole at the origin closed loop": ([], [-1.0], -1.0, 0.0),
    "|L(0)| = 1 but for a last digit": ([], [-9.006626, -1.0], 9.006626 * (1 + 3e-16), 0.1),
    "pair on the axis closed loop": ([], [0.0], HALF_TURN, 1.0),
    "one part in 1e10 before it": ([], [0.0], HALF_TURN * (1 - 1e-10), 1.0),
    "one part in 1e10 beyond it": ([], [0.0], HALF_TURN * (1 + 1e-10), 1.0),
    "no gain": ([], [-1.0], 0.0, 0.3),
    "no gain, unstable": ([], [1.0], 0.0, 0.3),
    "a resonance that touches |L| = 1": ([], [-0.1 + 1j, -0.1 - 1j], 0.2, 0.4),  # peak gain/(2 0.1 1)
    "all but undamped": ([], [-1e-9 + 1j, -1e-9 - 1j], 0.01, 0.0),
    "features 30 decades apart": ([-1e-15], [-1e-14, -1e15], 1e15, 0.0),
    "frequencies of 1e70": ([], [-1e70], 3e70, 1e-71),
    "phase along -180 deg": ([-1.0], [-1.0, 0.0, 0.0], 2.0, 0.0),
}


@pytest.mark.parametrize("case", DELICATE.values(), ids=DELICATE)
def test_delicate_loops_are_left_to_the_scalar_engine(case, used):
    zeros, poles, gain, tau = case
    # among ordinary ones, which keep their results
    loops = [Rational(zeros, poles, gain), Rational(-1.0 - np.arange(len(zeros)), -2.0 - np.arange(len(poles)), 0.7)]
    arguments = stack(loops, [tau, 0.2])
    assert_equals_scalar(arguments, batch_margins(*arguments))
    assert [system.gain for system in used] == [gain]


def test_empty_batches_and_loops_of_different_structure():
    found = batch_margins(np.empty((0, 1)), np.empty((0, 3)), np.empty(0), np.empty(0))
    assert (len(found), found.stable.dtype, len(batch_margins(*stack([], 0.1)))) == (0, bool, 0)
    assert all(getattr(found, name).shape == (0,) for name in NAMES)
    with pytest.raises(InputError, match=r"\[\(0, 1\), \(0, 2\)\]"):
        stack([Rational([], [-1.0], 1.0), Rational([], [-1.0, -2.0], 1.0)], 0.1)
    with pytest.raises(InputError, match=r"dead times: shape \(3,\) for 2 loops"):
        stack([Rational([], [-1.0], 1.0)] * 2, [0.1, 0.2, 0.3])


@pytest.mark.parametrize(("change", "match"), [
    ({"gain": np.ones(3)}, "shapes"),
    ({"zeros": np.ones(2)}, "shapes"),
    ({"zeros": -np.ones((2, 2))}, "not strictly proper"),
    ({"gain": [1.0, np.inf]}, "not finite"),
    ({"poles": [[-1.0, np.nan], [-1.0, -2.0]]}, "not finite"),
    ({"dead_time": [0.1, -0.2]}, "dead time: -0.2 s"),
    ({"dead_time": [0.1, np.nan]}, "dead time: nan s"),
    ({"poles": [[-1.0, -2.0], [-1.0 + 1j, -2.0 - 1j]]}, "poles: .*conjugate"),
    ({"zeros": [[-1.0], [-1.0 + 1j]]}, "zeros: .*conjugate"),
])  # fmt: skip
def test_unsuitable_arrays_are_refused(change, match):
    arguments = {"zeros": 2 * [[-1.0]], "poles": 2 * [[-1.0, -2.0]], "gain": [1.0, 1.0], "dead_time": [0.1, 0.1]}
    with pytest.raises(InputError, match=match):
        batch_margins(**(arguments | change))
