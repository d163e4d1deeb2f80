"""The adhesion-torque observers: statement, transfers, sampled form, the Kalman filter's gains, noise, the truth."""

from __future__ import annotations

import math

import numpy as np
import pytest
import sympy as sp
from scipy.integrate import solve_ivp, trapezoid
from scipy.linalg import expm, solve_continuous_are, solve_continuous_lyapunov, solve_discrete_are

from railslip_ctrl.core.errors import DomainError, InputError
from railslip_ctrl.identification.observer import (
    Encoder,
    FilterObserver,
    Form,
    KalmanObserver,
    TorqueSensor,
    Vibration,
    adhesion_coefficient,
    linear_recursion,
    observer_responses,
    sampled_noise,
)
from railslip_ctrl.identification.observer_study import BrakeCourse, brake_trial, estimated, measured, observer_errors
from railslip_ctrl.model import plant
from railslip_ctrl.model.adhesion import published_law
from railslip_ctrl.model.vehicle import AS_PUBLISHED_INERTIA_SCALE, PARK2008, Rail
from railslip_ctrl.paper import printed
from railslip_ctrl.paper.errata import adhesion_torque, corrected_observer, passed_at_once

TAU, INTERVAL = 0.08, 5e-3
S, TAU_SYMBOL = printed.laplace, printed.tau
STATEMENTS = {Form.PRINTED: printed.observer, Form.CORRECTED: corrected_observer()}


def zero(expression: sp.Expr) -> bool:
    return sp.simplify(expression) == 0


# estimates of a few kN*m that are sums of terms of up to 1e5 N*m, over a few thousand steps: 1e5 * 1e-16 * 1e3
ROUNDING = 1e-8


def run_is_step_is_chunks(observer, log, cuts):
    """Asserts that the three ways estimate the same of a log (t, torque, omega).

    Gives the run in one piece, the state after the steps and that after the chunks; `cuts` are the rows they end at.
    """
    whole = observer.run(*log)
    estimate, state = observer.start(*(column[0] for column in log))
    steps = [estimate]
    for row in zip(*(column[1:] for column in log), strict=True):
        estimate, state = observer.step(state, *row)
        steps.append(estimate)
    assert steps == pytest.approx(whole.adhesion_torque, abs=ROUNDING)
    chunked, after = [], None
    for first, last in zip((0, *cuts), (*cuts, log[0].size), strict=True):
        part = observer.run(*(column[first:last] for column in log), after)
        chunked.append(part.adhesion_torque)
        after = part.state
    assert np.concatenate(chunked) == pytest.approx(whole.adhesion_torque, abs=ROUNDING)
    return whole, state, after


# --- statement -----------------------------------------------------------------------------------------------------


def behind_the_wheel(form: Form) -> dict[str, sp.Expr]:
    """What acts on the wheel, and noise, to the estimate, with omega from the wheel's equation (3) in it."""
    wheel = sp.solve(plant.WHEEL.subs({plant.omega_rate: S * plant.omega, plant.Tr: 0}), plant.omega)[0]
    estimate = STATEMENTS[form].subs(plant.omega, wheel)
    acting = {"adhesion": plant.Ta, "brake": plant.Tb, "disturbance": plant.Td}
    sensors = {"torque_noise": plant.Tb, "speed_noise": plant.omega}
    found = {name: sp.factor(sp.together(sp.diff(estimate, one))) for name, one in acting.items()}
    return found | {name: sp.diff(STATEMENTS[form], one) for name, one in sensors.items()}


def test_25_follows_from_the_wheel():
    J, B, w, w_rate, tb = plant.J, plant.B, plant.omega, plant.omega_rate, plant.Tb
    assert zero(adhesion_torque() - (J * w_rate + B * w + tb))


def test_corrected_observer_is_a_lag_of_the_true_torque_and_of_nothing_else():
    lag = 1 / (TAU_SYMBOL * S + 1)
    wheel = behind_the_wheel(Form.CORRECTED)
    assert zero(wheel["adhesion"] - lag)
    assert zero(wheel["brake"])
    assert zero(wheel["disturbance"] + lag)  # what nobody measures is taken for adhesion
    assert zero(wheel["torque_noise"] - lag)
    assert passed_at_once(corrected_observer()) == 0


def test_printed_observer_lets_the_brake_torque_through():
    wheel = behind_the_wheel(Form.PRINTED)
    J, B = plant.J, plant.B
    assert zero(wheel["brake"] - J * TAU_SYMBOL * S**2 / ((TAU_SYMBOL * S + 1) * (J * S + B)))
    assert sp.limit(wheel["brake"], S, sp.oo) == passed_at_once(printed.observer) == wheel["torque_noise"] == 1
    assert not zero(wheel["adhesion"] - 1 / (TAU_SYMBOL * S + 1))


# --- continuous ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", Form)
def test_responses_are_those_of_the_statement(form):
    observer = FilterObserver.of(PARK2008, TAU, form)
    omega = np.geomspace(1e-3, 1e3, 25)
    responses = observer_responses(observer, omega)
    symbolic = behind_the_wheel(form)
    numbers = {plant.J: observer.inertia, plant.B: observer.viscous_friction, TAU_SYMBOL: TAU}
    for name in ("adhesion", "brake", "disturbance", "torque_noise", "speed_noise"):
        expected = sp.lambdify(S, symbolic[name].subs(numbers), "numpy")(1j * omega) * np.ones(omega.size)
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
        ({"inertia": 0.0}, r"inertia: 0 kg\*m\^2 is not allowed; give a finite value > 0"),
        ({"viscous_friction": -1.0}, r"viscous_friction: -1 N\*m\*s is not allowed; give a finite value >= 0"),
        ({"time_constant": float("nan")}, "time_constant: nan s is not allowed"),
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
    with pytest.raises(InputError, match="interval: 0 s is not allowed"):
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


# --- the Kalman filter: against independent Riccati solutions and matrix exponentials ---------------------------------

SHAKE = Vibration(frequency=10 * math.pi, decay=4.0, deviation=200.0)  # [Park2008] p. 55, its size assumed
PARAMETERS = {
    "inertia": 60.35,
    "viscous_friction": 0.25,
    "interval": INTERVAL,
    "speed_variance": 0.02,
    "torque_variance": 2500.0,
    "walk": 3e6,
}


def kalman_of(**changes) -> KalmanObserver:
    return KalmanObserver(**(PARAMETERS | changes))


def jittered_log(rows: int, seed: int = 1, gap: float = 0.0):
    generator = np.random.default_rng(seed)
    steps = generator.uniform(0.2, 1.8, rows) * INTERVAL
    steps[rows // 2] += gap
    torque = 4000 + np.cumsum(generator.normal(0, 30, rows))
    return np.cumsum(steps), torque, 60 + generator.normal(0, 0.1, rows)


def test_model_is_the_wheel():
    A, b = kalman_of(vibration=SHAKE).model
    rate = plant.WHEEL.rhs.subs(plant.Tr, 0) / plant.J
    numbers = {plant.J: PARAMETERS["inertia"], plant.B: PARAMETERS["viscous_friction"]}
    by = [float(rate.diff(each).subs(numbers)) for each in (plant.omega, plant.Ta, plant.Td)]
    assert A[0] == pytest.approx([*by, 0.0])
    assert b == pytest.approx([float(rate.diff(plant.Tb).subs(numbers)), 0, 0, 0])


def test_vibration_rings_and_lasts_as_it_is_told():
    k = kalman_of(vibration=SHAKE)
    block, noise = k.model[0][2:, 2:], k.driving_noise[2:, 2:]
    assert np.sort_complex(np.linalg.eigvals(block)) == pytest.approx([-4 - 10j * math.pi, -4 + 10j * math.pi])
    assert solve_continuous_lyapunov(block, -noise)[0, 0] == pytest.approx(SHAKE.deviation**2)


# --- gains ---------------------------------------------------------------------------------------------------------


def test_continuous_gain_in_closed_form():
    """B = 0 and an exact torque: a double integrator, l2 = sqrt(q/r), l1 = sqrt(2 l2/J)."""
    k = kalman_of(viscous_friction=0.0, torque_variance=0.0)
    second = math.sqrt(k.walk / (k.speed_variance * INTERVAL))
    assert k.continuous_gain == pytest.approx([math.sqrt(2 * second / k.inertia), second])


@pytest.mark.parametrize("vibration", [None, SHAKE])
def test_continuous_gain_is_an_independent_riccati_solution(vibration):
    k = kalman_of(vibration=vibration)
    A, _ = k.model
    noise = k.speed_variance * INTERVAL
    solution = solve_continuous_are(A.T, np.eye(1, len(A)).T, k.driving_noise, [[noise]])
    assert k.continuous_gain == pytest.approx(solution[:, 0] / noise, rel=1e-9)


@pytest.mark.parametrize("vibration", [None, SHAKE])
def test_sampled_gain_is_an_independent_riccati_solution(vibration):
    """Covariances stepped until they rest, their noise by quadrature; and SciPy's solver."""
    k = kalman_of(vibration=vibration)
    A, _ = k.model
    n = len(A)
    F = expm(A * INTERVAL)
    nodes, weights = np.polynomial.legendre.leggauss(20)
    at = (nodes + 1) * INTERVAL / 2
    Q = sum(w * expm(A * s) @ k.driving_noise @ expm(A * s).T for s, w in zip(at, weights, strict=True)) * INTERVAL / 2
    C, R = np.eye(1, n), k.speed_variance
    P = np.eye(n)
    for _ in range(5000):
        gain = P[:, 0] / (P[0, 0] + R)
        P = F @ (P - np.outer(gain, P[0])) @ F.T + Q
    assert k.sampled_gain == pytest.approx(P[:, 0] / (P[0, 0] + R), rel=1e-9)
    assert k.deviation == pytest.approx(math.sqrt((P - np.outer(k.sampled_gain, P[0]))[1, 1]), rel=1e-9)
    scipys = solve_discrete_are(F.T, C.T, Q, [[R]])
    assert k.sampled_gain == pytest.approx(scipys[:, 0] / (scipys[0, 0] + R), rel=1e-9)


def test_choice_of_noises():
    encoder, sensor = Encoder(4096), TorqueSensor(noise=50.0, resolution=12.0)
    k = KalmanObserver.of(PARK2008, encoder, sensor, interval=INTERVAL, change=4000.0, within=0.5)
    assert k.speed_variance == pytest.approx((2 * math.pi / 4096 / INTERVAL) ** 2 / 6)
    assert k.torque_variance == pytest.approx(50.0**2 + 12.0**2 / 12)
    assert k.walk == pytest.approx(4000.0**2 / 0.5)
    assert k.driving_noise[0, 0] == pytest.approx(k.torque_variance * INTERVAL / 60.35**2)


# --- samples -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("vibration", [None, SHAKE])
@pytest.mark.parametrize("gap", [0.0, 3.0])  # the gap's transition is beyond the power series' reach with a vibration
def test_run_is_prediction_by_exponentials_and_correction(vibration, gap):
    k = kalman_of(vibration=vibration)
    t, torque, omega = jittered_log(300, gap=gap)
    A, b = k.model
    n = len(A)
    generator = np.zeros((n + 2, n + 2))
    generator[:n, :n], generator[:n, n], generator[n, n + 1] = A, b, 1.0
    x = np.array([omega[0], k.viscous_friction * omega[0] + torque[0], *([0.0] * (n - 2))])
    expected = [x[1]]
    for i in range(1, t.size):
        h = t[i] - t[i - 1]
        x = (expm(generator * h) @ np.array([*x, torque[i - 1], (torque[i] - torque[i - 1]) / h]))[:n]
        x = x + k.sampled_gain * (omega[i] - x[0])
        expected.append(x[1])
    assert k.run(t, torque, omega).adhesion_torque == pytest.approx(expected, abs=ROUNDING)


@pytest.mark.parametrize("vibration", [None, SHAKE])
def test_kalman_run_is_step_is_chunks(vibration):
    k = kalman_of(vibration=vibration)
    whole, state, _ = run_is_step_is_chunks(k, jittered_log(1500), (1, 2, 900))
    assert state.mean == pytest.approx(whole.state.mean, abs=ROUNDING)


def test_sampled_form_is_the_run():
    k, rows = kalman_of(), 500
    _, torque, omega = jittered_log(rows)
    form = k.sampled()
    steady = k.viscous_friction * omega[0] + torque[0]
    x, u_before, expected = np.array([omega[0], steady]), np.array([torque[0], omega[0]]), [steady]
    for u in np.stack([torque, omega], axis=1)[1:]:
        x = form.F @ x + form.P @ u_before + form.Q @ u
        u_before = u
        expected.append((form.C @ x)[0] + form.D @ u)
    assert k.run(np.arange(rows) * INTERVAL, torque, omega).adhesion_torque == pytest.approx(expected, abs=ROUNDING)


# --- refusals ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "bound"),
    [
        *((name, 0, "> 0") for name in ("inertia", "interval", "speed_variance", "walk")),
        *((name, -1, ">= 0") for name in ("viscous_friction", "torque_variance")),
    ],
)
def test_kalman_parameters_out_of_range_are_refused(name, value, bound):
    with pytest.raises(InputError, match=f"{name}: {value} [^ ]+ is not allowed; give a finite value {bound}"):
        kalman_of(**{name: float(value)})


def test_vibration_and_choice_out_of_range():
    with pytest.raises(InputError, match="decay: 0 1/s is not allowed"):
        Vibration(frequency=31.0, decay=0.0, deviation=1.0)
    encoder, sensor = Encoder(100), TorqueSensor(1.0)
    with pytest.raises(InputError, match="within: 0 s is not allowed"):
        KalmanObserver.of(PARK2008, encoder, sensor, interval=INTERVAL, change=1.0, within=0.0)
    with pytest.raises(InputError, match=r"change: -1 N\*m is not allowed"):
        KalmanObserver.of(PARK2008, encoder, sensor, interval=INTERVAL, change=-1.0, within=1.0)


@pytest.mark.parametrize(
    "change",
    [
        {"walk": 1e300},
        {"walk": 1e-300},
        {"speed_variance": 1e-30},
        {"speed_variance": 1e30},
        {"torque_variance": 1e30},
        {"interval": 1e-300},
    ],
)
def test_noises_without_a_gain_are_refused(change):
    with pytest.raises(InputError, match=r"Kalman filter: no steady gain can be computed with .* nearer|interval: "):
        _ = kalman_of(**change).sampled_gain, kalman_of(**change).continuous_gain


def test_driving_noise_over_a_long_interval_is_that_of_many_short_ones():
    """With a vibration that dies within it; a single exponential would lose every digit (exp(4 * 20))."""
    k = kalman_of(vibration=SHAKE)
    A, noise = k.model[0], k.driving_noise
    long, total = sampled_noise(A, noise, 20.0)
    F, Q = sampled_noise(A, noise, 0.01)
    expected = np.zeros_like(Q)
    for _ in range(2000):
        expected = F @ expected @ F.T + Q
    # a sum of 2000 terms that grows with the cube of time
    assert np.abs(total - expected).max() < 1e-9 * np.abs(expected).max()
    assert total[2, 2] == pytest.approx(SHAKE.deviation**2)
    assert long == pytest.approx(expm(A * 20.0), abs=1e-12)


# --- sensors, and what their noise does to the estimates --------------------------------------------------------------

SPEED = 140 / 3.6
ENCODER = Encoder(counts=4096)
SENSOR = TorqueSensor(noise=50.0, resolution=5.0)
SEED = 2008


def filters():
    return [FilterObserver.of(PARK2008, tau, form) for form in Form for tau in (0.02, 0.1)]


def kalman() -> KalmanObserver:
    return KalmanObserver.of(PARK2008, ENCODER, SENSOR, interval=INTERVAL, change=1500.0, within=1.0)


OBSERVERS = [*filters(), kalman()]


@pytest.fixture(scope="module", params=["beam", "bristle"])
def trial(request):
    law = published_law(request.param, Rail.DRY, 140.0)
    return brake_trial(law, PARK2008, SPEED, interval=INTERVAL, course=BrakeCourse())


# --- sensors -------------------------------------------------------------------------------------------------------


def test_encoder_counts():
    time = np.array([0.0, 0.5, 1.0, 2.0])
    angle = 2 * math.pi * np.array([0.0, 0.30, 0.49, 1.0])
    encoder = Encoder(4)  # counts 0, 1, 1, 4
    assert encoder.speed(time, angle) == pytest.approx([math.pi, 0.0, 1.5 * math.pi])
    assert encoder.speed_step(0.5) == pytest.approx(math.pi)


def test_encoder_noise_is_uniform_rounding():
    generator = np.random.default_rng(3)
    time = np.arange(200_001) * INTERVAL
    angle = np.cumsum(generator.uniform(0.2, 0.4, time.size))  # some 200 counts a sample, no pattern in them
    error = ENCODER.speed(time, angle) - np.diff(angle) / INTERVAL
    # 2e5 samples: a variance good to 0.3 %, 4 of those and a little
    assert error.var() == pytest.approx(ENCODER.speed_variance(INTERVAL), rel=0.015)
    assert np.mean(error[1:] * error[:-1]) == pytest.approx(-error.var() / 2, rel=0.03)  # neighbours share an angle


def test_torque_sensor():
    generator = np.random.default_rng(4)
    seen = SENSOR.measured(np.full(200_000, 5001.3), generator)
    assert np.allclose(seen % 5.0, 0.0)
    assert seen.std() == pytest.approx(math.sqrt(SENSOR.variance), rel=0.01)  # 2e5 samples: 0.16 %
    assert seen.mean() == pytest.approx(5001.3, abs=0.5)
    assert TorqueSensor(0.0).measured([1.23], generator) == pytest.approx([1.23])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Encoder(0), "counts: 0 is not allowed; give a value >= 1"),
        (lambda: TorqueSensor(-1.0), r"noise: -1 N\*m is not allowed"),
        (lambda: TorqueSensor(1.0, -5.0), r"resolution: -5 N\*m is not allowed"),
        (lambda: BrakeCourse(rise=0.0), r"rise: 0 N\*m/s is not allowed"),
        (lambda: BrakeCourse(release_slip=1.0), "release_slip: 1 is not allowed; give a value between 0 and 1"),
    ],
)
def test_numbers_out_of_range_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()


# --- noise to estimate ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tau", [0.01, 0.1, 1.0])
def test_noise_gains_in_closed_form(tau):
    """B = 0, e = exp(-h/tau): the sums of squared impulse responses by hand."""
    J, h = 60.35, INTERVAL
    e = math.exp(-h / tau)
    rate = (1 - e) * J / h
    w1 = 1 - (1 - e) * tau / h
    w0 = 1 - e - w1
    corrected, printed = (FilterObserver(J, 0.0, tau, form).sampled(h).noise_gains() for form in reversed(Form))
    for gains in (corrected, printed):
        assert gains.speed == pytest.approx(rate**2 * 2 / (1 + e))
        assert gains.angle == pytest.approx((rate / h) ** 2 * (1 + (2 - e) ** 2 + (1 - e) ** 3 / (1 + e)))
    assert corrected.torque == pytest.approx(w1**2 + (w0 + e * w1) ** 2 / (1 - e**2))
    assert printed.torque == pytest.approx(1.0)


@pytest.mark.parametrize("observer", OBSERVERS)
def test_noise_gains_are_the_area_under_the_squared_response(observer):
    """Parseval: the same norm from the frequency response."""
    form = observer.sampled(INTERVAL)
    omega = np.linspace(0, math.pi / INTERVAL, 200_001)
    torque, speed = (np.abs(each) ** 2 for each in form.transfers(omega))
    difference = np.abs(1 - np.exp(-1j * omega * INTERVAL)) ** 2 / INTERVAL**2
    gains = form.noise_gains()
    for gain, density in ((gains.torque, torque), (gains.speed, speed), (gains.angle, speed * difference)):
        assert gain == pytest.approx(trapezoid(density, omega) * INTERVAL / math.pi, rel=1e-6)  # grid of 2e5


# --- against the truth ---------------------------------------------------------------------------------------------


def test_trial_is_the_one_of_figure_12(trial):
    slip = 1 - trial.omega * 0.43 / trial.speed
    released = trial.time >= trial.release_time
    assert slip[~released].max() == pytest.approx(0.5, abs=0.01)
    assert trial.brake_torque[~released].max() == pytest.approx(2500 * (trial.release_time - trial.brake_time), abs=15)
    assert 5000 < trial.brake_torque.max() < 8000  # the figure's axis ends at 8 kN*m
    assert trial.brake_torque[-1] == 0
    assert slip[-1] < 0.1  # the wheel has recovered


@pytest.mark.parametrize("observer", OBSERVERS)
def test_estimates_are_the_truth_but_for_lag_and_noise(trial, observer):
    errors = observer_errors(observer, trial, ENCODER, SENSOR, seed=SEED)
    # one draw; the errors' deviation over 1000 samples with memory is good to some 5 %
    assert errors.simulated == pytest.approx(errors.total, rel=0.12)
    if isinstance(observer, KalmanObserver):
        assert errors.total < 0.06 * trial.adhesion_torque.max()


def test_corrected_estimate_is_the_filtered_truth(trial):
    """With perfect sensors, against Ta through the lag by an independent integration: what half an interval costs."""
    from scipy.signal import cont2discrete, lfilter

    tau = 0.05
    b, a, _ = cont2discrete(([1.0], [tau, 1.0]), INTERVAL, method="foh")
    lagged = lfilter(b[0], a, trial.adhesion_torque[1:] - trial.adhesion_torque[1]) + trial.adhesion_torque[1]
    error = estimated(FilterObserver.of(PARK2008, tau), trial) - lagged
    rate = PARK2008.wheel.inertia * np.gradient(trial.omega, trial.time)
    late = INTERVAL / 2 * np.abs(np.diff(rate)).max() / INTERVAL  # J omega' is half an interval late
    assert np.abs(error[200:]).max() < 1.1 * late
    assert np.abs(error[200:]).max() < 0.05 * trial.adhesion_torque.max()


def test_same_seed_same_noise(trial):
    one, same, other = (measured(trial, ENCODER, SENSOR, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(one.torque, same.torque)
    assert not np.array_equal(one.torque, other.torque)
    assert np.array_equal(one.omega, other.omega)  # an encoder's counts are no chance


def test_trials_that_cannot_be():
    law = published_law("beam", Rail.DRY, 140.0)
    with pytest.raises(InputError, match=r"release_slip: 0\.5 is not reached, the train stops before"):
        brake_trial(law, PARK2008, 5.0, interval=INTERVAL, course=BrakeCourse(rise=100.0))
    with pytest.raises(InputError, match="speed: 0 m/s is not allowed"):
        brake_trial(law, PARK2008, 0.0, interval=INTERVAL, course=BrakeCourse())
    with pytest.raises(InputError, match="interval: 0 s is not allowed"):
        brake_trial(law, PARK2008, SPEED, interval=0.0, course=BrakeCourse())
    bristle = published_law("bristle", Rail.DRY, 140.0)
    with pytest.raises(DomainError):
        brake_trial(bristle, PARK2008, SPEED, interval=INTERVAL, course=BrakeCourse(release_slip=0.9))
