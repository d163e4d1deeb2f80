"""The adhesion-torque observer: its statement, its transfers, and its sampled form, in one piece and in chunks."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sp
from observer_runs import ROUNDING, run_is_step_is_chunks
from scipy.integrate import solve_ivp

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.identification import observer_study as statement
from railslip_ctrl.identification.observer import (
    FilterObserver,
    Form,
    adhesion_coefficient,
    linear_recursion,
    observer_responses,
)
from railslip_ctrl.model import plant
from railslip_ctrl.model.vehicle import AS_PUBLISHED_INERTIA_SCALE, PARK2008
from railslip_ctrl.paper import printed as sliding_printed

TAU = 0.08
S, TAU_SYMBOL = statement.s, statement.tau


def zero(expression: sp.Expr) -> bool:
    return sp.simplify(expression) == 0


# --- statement -----------------------------------------------------------------------------------------------------


def test_25_follows_from_the_wheel():
    J, B, w, w_rate, tb = plant.J, plant.B, plant.omega, plant.omega_rate, plant.Tb
    assert zero(statement.adhesion_torque() - (J * w_rate + B * w + tb))


def test_27_is_28():
    derivative, without = statement.printed(), statement.printed_without_derivative()
    assert zero(derivative.torque - without.torque)
    assert zero(derivative.speed - without.speed)


def test_27_is_the_one_in_the_errata():
    ours = statement.printed()
    errata = sliding_printed.observer.subs({sliding_printed.laplace: S, sliding_printed.tau: TAU_SYMBOL})
    assert zero(ours.torque * plant.Tb + ours.speed * plant.omega - errata)


def test_corrected_observer_is_a_lag_of_the_true_torque_and_of_nothing_else():
    lag = 1 / (TAU_SYMBOL * S + 1)
    wheel = statement.behind_the_wheel(statement.corrected())
    assert zero(wheel.adhesion - lag)
    assert zero(wheel.brake)
    assert zero(wheel.disturbance + lag)  # what nobody measures is taken for adhesion
    assert zero(wheel.torque_noise - lag)


def test_printed_observer_lets_the_brake_torque_through():
    wheel = statement.behind_the_wheel(statement.printed())
    J, B = plant.J, plant.B
    assert zero(wheel.brake - J * TAU_SYMBOL * S**2 / ((TAU_SYMBOL * S + 1) * (J * S + B)))
    assert statement.passed_at_once(wheel.brake) == 1
    assert statement.passed_at_once(wheel.torque_noise) == 1
    assert statement.passed_at_once(statement.behind_the_wheel(statement.corrected()).brake) == 0
    assert not zero(wheel.adhesion - 1 / (TAU_SYMBOL * S + 1))


# --- continuous ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", Form)
def test_responses_are_those_of_the_statement(form):
    observer = FilterObserver.of(PARK2008, TAU, form)
    omega = np.geomspace(1e-3, 1e3, 25)
    responses = observer_responses(observer, omega)
    symbolic = statement.behind_the_wheel(statement.printed() if form is Form.PRINTED else statement.corrected())
    numbers = {plant.J: observer.inertia, plant.B: observer.viscous_friction, TAU_SYMBOL: TAU}
    for name in ("adhesion", "brake", "disturbance", "torque_noise", "speed_noise"):
        expected = sp.lambdify(S, getattr(symbolic, name).subs(numbers), "numpy")(1j * omega) * np.ones(omega.size)
        # the response to Tb is a difference of two terms that may cancel down to rounding
        assert getattr(responses, name) == pytest.approx(expected, rel=1e-12, abs=1e-13), name


def test_effective_inertia_is_used():
    scaled = PARK2008.model_copy(update={"inertia_scale": AS_PUBLISHED_INERTIA_SCALE})
    observer = FilterObserver.of(scaled, TAU)
    assert (observer.inertia, observer.viscous_friction) == pytest.approx((3.6 * 60.35, 3.6 * 0.25))


def test_adhesion_coefficient():
    torque = np.array([0.0, 0.3 * 34_500 * 0.43])
    assert adhesion_coefficient(torque, PARK2008) == pytest.approx([0.0, 0.3])


# --- samples -------------------------------------------------------------------------------------------------------


def irregular_log(rows: int, seed: int = 1):
    """Times 1 to 9 ms apart, torque and speed that run straight between samples."""
    generator = np.random.default_rng(seed)
    t = np.cumsum(generator.uniform(1e-3, 9e-3, rows))
    torque = 4000 + np.cumsum(generator.normal(0, 30, rows))
    omega = 60 - 0.5 * t + 0.3 * np.sin(3 * t) + generator.normal(0, 1e-3, rows)
    return t, torque, omega


@pytest.mark.parametrize("form", Form)
def test_sampled_form_solves_the_filter_exactly(form):
    """Against an ODE solver on the filter's equation (28), with inputs that run straight between samples."""
    t, torque, omega = irregular_log(60)
    observer = FilterObserver.of(PARK2008, TAU, form)
    J, B = observer.inertia, observer.viscous_friction

    # the wheel turns steadily before the first sample
    x = -J / TAU * omega[0] if form is Form.PRINTED else (B - J / TAU) * omega[0] + torque[0]
    expected = []
    for k in range(t.size - 1):
        span = t[k : k + 2]

        def rate(at, filtered, span=span, k=k):
            w, tb = np.interp(at, span, omega[k : k + 2]), np.interp(at, span, torque[k : k + 2])
            u = -J / TAU * w if form is Form.PRINTED else (B - J / TAU) * w + tb
            return (u - filtered) / TAU

        x = solve_ivp(rate, span, [x], rtol=1e-12, atol=1e-9).y[0, -1]
        direct = B * omega[k + 1] + torque[k + 1] if form is Form.PRINTED else 0.0
        expected.append(x + J / TAU * omega[k + 1] + direct)
    # terms of 5e4 N*m at the solver's 1e-12, 60 intervals
    assert observer.run(t, torque, omega).adhesion_torque[1:] == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("form", Form)
def test_run_is_step_is_chunks(form):
    t, torque, omega = irregular_log(3001)
    observer = FilterObserver.of(PARK2008, TAU, form)
    whole, state, after = run_is_step_is_chunks(observer, (t, torque, omega), (1, 2, 1000))
    assert state.filtered == pytest.approx(whole.state.filtered, abs=ROUNDING)
    assert (after.time, after.torque, after.omega) == (t[-1], torque[-1], omega[-1])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"inertia": 0.0}, "inertia: 0 is not allowed; give a finite value > 0"),
        ({"viscous_friction": -1.0}, "viscous_friction: -1 is not allowed; give a finite value >= 0"),
        ({"time_constant": float("nan")}, "time_constant: nan is not allowed"),
    ],
)
def test_parameters_out_of_range_are_refused(change, message):
    with pytest.raises(InputError, match=message):
        FilterObserver(**({"inertia": 60.0, "viscous_friction": 0.25, "time_constant": TAU} | change))


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (([0, 1, 1], [1, 1, 1], [1, 1, 1]), "time: 1 in row 2 is not after 1"),
        (([0, 2, 1], [1, 1, 1], [1, 1, 1]), "time: 1 in row 2 is not after 2"),
        (([0, 1], [1, np.nan], [1, 1]), "torque: nan in row 1"),
        (([0, 1], [1, 1], [np.inf, 1]), "omega: inf in row 0"),
        (([0, 1], [1, 1, 1], [1, 1]), r"torque: shape \(3,\)"),
        (([], [], []), "time: no rows"),
    ],
)
def test_columns_that_are_no_log_are_refused(columns, message):
    with pytest.raises(InputError, match=message):
        FilterObserver.of(PARK2008, TAU).run(*columns)


def test_samples_out_of_order_are_refused():
    observer = FilterObserver.of(PARK2008, TAU)
    _, state = observer.start(1.0, 0.0, 60.0)
    with pytest.raises(InputError, match="time: 1 in row 0 is not after 1; give growing"):
        observer.step(state, 1.0, 0.0, 60.0)
    with pytest.raises(InputError, match="omega: nan in row 0"):
        observer.step(state, 2.0, 0.0, np.nan)
    with pytest.raises(InputError, match=r"time: 0\.5 in row 0 is not after 1"):
        observer.run([0.5], [0.0], [60.0], state)
    with pytest.raises(InputError, match="interval: 0 is not allowed"):
        observer.sampled(0.0)


# --- recursion -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rows", [0, 1, 2, 17, 1000, 70_000])  # the last is more than one pass
def test_recursion_is_the_loop(rows):
    generator = np.random.default_rng(rows)
    transition = 0.6 * generator.uniform(-1, 1, (rows, 2, 2))
    forcing, initial = generator.normal(size=(rows, 2)), np.array([1.0, -2.0])
    expected, x = np.empty((rows, 2)), initial
    for k in range(rows):
        x = expected[k] = transition[k] @ x + forcing[k]
    # sums of terms of order 1 that are forgotten within a few steps
    np.testing.assert_allclose(linear_recursion(transition, forcing, initial), expected, rtol=0, atol=1e-12)
