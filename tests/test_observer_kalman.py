"""The Kalman filter: its gains against independent Riccati solutions, its sampled form against matrix exponentials."""

from __future__ import annotations

import math

import numpy as np
import pytest
from observer_runs import ROUNDING, run_is_step_is_chunks
from scipy.linalg import expm, solve_continuous_are, solve_continuous_lyapunov, solve_discrete_are

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.identification.observer import (
    Encoder,
    KalmanObserver,
    TorqueSensor,
    Vibration,
    observer_responses,
    sampled_noise,
)
from railslip_ctrl.model import plant
from railslip_ctrl.model.vehicle import PARK2008

INTERVAL = 5e-3
SHAKE = Vibration(frequency=10 * math.pi, decay=4.0, deviation=200.0)  # [Park2008] p. 55, its size assumed
PARAMETERS = {
    "inertia": 60.35,
    "viscous_friction": 0.25,
    "interval": INTERVAL,
    "speed_variance": 0.02,
    "torque_variance": 2500.0,
    "walk": 3e6,
}


def observer(**changes) -> KalmanObserver:
    return KalmanObserver(**(PARAMETERS | changes))


def irregular_log(rows: int, seed: int = 1, gap: float = 0.0):
    generator = np.random.default_rng(seed)
    steps = generator.uniform(0.2, 1.8, rows) * INTERVAL
    steps[rows // 2] += gap
    torque = 4000 + np.cumsum(generator.normal(0, 30, rows))
    return np.cumsum(steps), torque, 60 + generator.normal(0, 0.1, rows)


def test_model_is_the_wheel():
    A, b = observer(vibration=SHAKE).model
    rate = plant.WHEEL.rhs.subs(plant.Tr, 0) / plant.J
    numbers = {plant.J: PARAMETERS["inertia"], plant.B: PARAMETERS["viscous_friction"]}
    by = [float(rate.diff(each).subs(numbers)) for each in (plant.omega, plant.Ta, plant.Td)]
    assert A[0] == pytest.approx([*by, 0.0])
    assert b == pytest.approx([float(rate.diff(plant.Tb).subs(numbers)), 0, 0, 0])


def test_vibration_rings_and_lasts_as_it_is_told():
    k = observer(vibration=SHAKE)
    block, noise = k.model[0][2:, 2:], k.driving_noise[2:, 2:]
    assert np.sort_complex(np.linalg.eigvals(block)) == pytest.approx([-4 - 10j * math.pi, -4 + 10j * math.pi])
    assert solve_continuous_lyapunov(block, -noise)[0, 0] == pytest.approx(SHAKE.deviation**2)


# --- gains ---------------------------------------------------------------------------------------------------------


def test_continuous_gain_in_closed_form():
    """B = 0 and an exact torque: a double integrator, l2 = sqrt(q/r), l1 = sqrt(2 l2/J)."""
    k = observer(viscous_friction=0.0, torque_variance=0.0)
    second = math.sqrt(k.walk / (k.speed_variance * INTERVAL))
    assert k.continuous_gain == pytest.approx([math.sqrt(2 * second / k.inertia), second])


@pytest.mark.parametrize("vibration", [None, SHAKE])
def test_continuous_gain_is_an_independent_riccati_solution(vibration):
    k = observer(vibration=vibration)
    A, _ = k.model
    noise = k.speed_variance * INTERVAL
    solution = solve_continuous_are(A.T, np.eye(1, len(A)).T, k.driving_noise, [[noise]])
    assert k.continuous_gain == pytest.approx(solution[:, 0] / noise, rel=1e-9)


@pytest.mark.parametrize("vibration", [None, SHAKE])
def test_sampled_gain_is_an_independent_riccati_solution(vibration):
    """Covariances stepped until they rest, their noise by quadrature; and SciPy's solver."""
    k = observer(vibration=vibration)
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


# --- responses -----------------------------------------------------------------------------------------------------


def test_vibration_is_told_from_adhesion():
    """The stronger Td is expected to be, the less of it is taken for Ta; slow adhesion is still seen."""
    omega = [0.5, 10 * math.pi]
    filters = [observer(vibration=None if d == 0 else Vibration(10 * math.pi, 4.0, d)) for d in (0, 200.0, 2000.0)]
    taken = [abs(observer_responses(each, omega).disturbance[1]) for each in filters]
    assert taken[0] > 0.9
    assert taken[1] < 0.6 * taken[0]
    assert taken[2] < 0.1 * taken[0]
    assert all(abs(observer_responses(each, omega).adhesion[0] - 1) < 0.1 for each in filters)


# --- samples -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("vibration", [None, SHAKE])
@pytest.mark.parametrize("gap", [0.0, 3.0])  # the gap's transition is beyond the power series' reach with a vibration
def test_run_is_prediction_by_exponentials_and_correction(vibration, gap):
    k = observer(vibration=vibration)
    t, torque, omega = irregular_log(300, gap=gap)
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
def test_run_is_step_is_chunks(vibration):
    k = observer(vibration=vibration)
    whole, state, _ = run_is_step_is_chunks(k, irregular_log(1500), (1, 2, 900))
    assert state.mean == pytest.approx(whole.state.mean, abs=ROUNDING)


def test_sampled_form_is_the_run():
    k, rows = observer(), 500
    _, torque, omega = irregular_log(rows)
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
def test_parameters_out_of_range_are_refused(name, value, bound):
    with pytest.raises(InputError, match=f"{name}: {value} is not allowed; give a finite value {bound}"):
        observer(**{name: float(value)})


def test_vibration_and_choice_out_of_range():
    with pytest.raises(InputError, match="decay: 0 is not allowed"):
        Vibration(frequency=31.0, decay=0.0, deviation=1.0)
    encoder, sensor = Encoder(100), TorqueSensor(1.0)
    with pytest.raises(InputError, match="within: 0 is not allowed"):
        KalmanObserver.of(PARK2008, encoder, sensor, interval=INTERVAL, change=1.0, within=0.0)
    with pytest.raises(InputError, match="change: -1 is not allowed"):
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
        _ = observer(**change).sampled_gain, observer(**change).continuous_gain


def test_driving_noise_over_a_long_interval_is_that_of_many_short_ones():
    """With a vibration that dies within it; a single exponential would lose every digit (exp(4 * 20))."""
    k = observer(vibration=SHAKE)
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
