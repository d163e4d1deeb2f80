"""The adhesion-torque observers: statement, transfers, recursions, the Kalman filter's gains, noise, the truth."""

import functools
import itertools
import math

import numpy as np
import pytest
import sympy as sp
from project import script
from scipy.integrate import trapezoid
from scipy.linalg import expm, solve_discrete_are

from railslip_ctrl import PARK2008, DomainError, InputError, Rail, published_law
from railslip_ctrl.identification import observer as observers
from railslip_ctrl.identification.observer import Encoder, FilterObserver, Form, KalmanObserver, TorqueSensor
from railslip_ctrl.identification.virtual_rig import BrakeCourse, brake_trial
from railslip_ctrl.model import plant
from railslip_ctrl.paper import printed
from railslip_ctrl.paper.errata import corrected_observer

TAU, INTERVAL, SPEED = 0.08, 5e-3, 140 / 3.6
S, TAU_SYMBOL = printed.laplace, printed.tau
STATEMENTS = {Form.PRINTED: printed.observer, Form.CORRECTED: corrected_observer()}
ENCODER, SENSOR = Encoder(counts=4096), TorqueSensor(noise=50.0, resolution=5.0)
KALMAN = KalmanObserver.of(PARK2008, ENCODER, SENSOR, interval=INTERVAL, change=1500.0, within=1.0)
OBSERVERS = [*(FilterObserver.of(PARK2008, tau, form) for form in Form for tau in (0.02, 0.1)), KALMAN]

# estimates of a few kN*m that are sums of terms of up to 1e5 N*m, over a few thousand steps: 1e5 * 1e-16 * 1e3
ROUNDING = 1e-8


def kalman_of(**changes) -> KalmanObserver:
    usual = {"inertia": 60.35, "viscous_friction": 0.25, "interval": INTERVAL}
    return KalmanObserver(**(usual | {"speed_variance": 0.02, "torque_variance": 2500.0, "walk": 3e6} | changes))


def irregular_log(rows: int, gap: float = 0.0):
    """Times 1 to 9 ms apart, but for a gap in the middle, torque and speed that run straight between samples."""
    generator = np.random.default_rng(1)
    steps = generator.uniform(1e-3, 9e-3, rows)
    steps[rows // 2] += gap
    t = np.cumsum(steps)
    torque = 4000 + np.cumsum(generator.normal(0, 30, rows))
    return t, torque, 60 - 0.5 * t + 0.3 * np.sin(3 * t) + generator.normal(0, 1e-2, rows)


@pytest.mark.parametrize("form", Form)
def test_responses_are_those_of_the_statement(form):
    """Of the estimate to what acts on the wheel, with omega from the wheel's equation (3) in it, and to noise."""
    wheel = sp.solve(plant.WHEEL.subs({plant.omega_rate: S * plant.omega, plant.Tr: 0}), plant.omega)[0]
    direct, estimate = STATEMENTS[form], STATEMENTS[form].subs(plant.omega, wheel)
    symbolic = {"adhesion": (estimate, plant.Ta), "brake": (estimate, plant.Tb), "disturbance": (estimate, plant.Td)}
    symbolic |= {"torque_noise": (direct, plant.Tb), "speed_noise": (direct, plant.omega)}
    observer = FilterObserver.of(PARK2008.model_copy(update={"inertia_scale": 3.6}), TAU, form)
    omega = np.geomspace(1e-3, 1e3, 25)
    responses = observers.observer_responses(observer, omega)
    numbers = {plant.J: 3.6 * 60.35, plant.B: 3.6 * 0.25, TAU_SYMBOL: TAU}
    for name, (expression, one) in symbolic.items():
        expected = sp.lambdify(S, sp.diff(expression, one).subs(numbers), "numpy")(1j * omega) * np.ones(omega.size)
        # the response to Tb is a difference of two terms that may cancel down to rounding
        assert getattr(responses, name) == pytest.approx(expected, rel=1e-12, abs=1e-13), name


def exactly(A, b, x, u, h):
    """x after h seconds of x' = A x + b u, an input u that runs straight between its two values."""
    n, generator = len(x), np.zeros((len(x) + 2, len(x) + 2))
    generator[:n, :n], generator[:n, n], generator[n, n + 1] = A, b, 1.0
    return (expm(generator * h) @ np.array([*x, u[0], (u[1] - u[0]) / h]))[:n]


@pytest.mark.parametrize("form", Form)
def test_filter_is_solved_exactly(form):
    """The filter's equation (28), the wheel turning steadily before the first sample."""
    t, torque, omega = irregular_log(60)
    observer = FilterObserver.of(PARK2008, TAU, form)
    both, rim = observer.viscous_friction * omega + torque, observer.inertia / TAU * omega
    u, direct = (-rim, both) if form is Form.PRINTED else (both - rim, 0.0 * both)
    x, filtered = u[:1], [u[0]]
    for k in range(t.size - 1):
        x = exactly([[-1 / TAU]], [1 / TAU], x, u[k : k + 2], t[k + 1] - t[k])
        filtered.append(x[0])
    assert observer.run(t, torque, omega).adhesion_torque == pytest.approx(filtered + rim + direct, abs=ROUNDING)


@pytest.mark.parametrize("gap", [0.0, 3.0])
def test_kalman_filter_is_prediction_by_exponentials_and_correction(gap):
    k, (t, torque, omega) = kalman_of(viscous_friction=25.0), irregular_log(300, gap=gap)
    x = np.array([omega[0], 25.0 * omega[0] + torque[0]])
    expected = [x[1]]
    for i in range(1, t.size):
        x = exactly(*k.model, x, torque[i - 1 : i + 1], t[i] - t[i - 1])
        x = x + k.sampled_gain * (omega[i] - x[0])
        expected.append(x[1])
    assert k.run(t, torque, omega).adhesion_torque == pytest.approx(expected, abs=ROUNDING)


@pytest.mark.parametrize("observer", OBSERVERS)
def test_chunks_of_a_log_and_the_sampled_form_give_what_the_whole_gives(observer):
    t, torque, omega = irregular_log(1200)
    whole, parts, state = observer.run(t, torque, omega), [], None
    for first, last in zip((0, 1, 2, 900), (1, 2, 900, 1200), strict=True):
        part = observer.run(t[first:last], torque[first:last], omega[first:last], state)
        parts.append(part.adhesion_torque)
        state = part.state
    assert np.concatenate(parts) == pytest.approx(whole.adhesion_torque, abs=ROUNDING)
    form, u = observer.sampled(INTERVAL), np.stack([torque, omega], axis=1)
    steady = observer.run([0.0], torque[:1], omega[:1])
    x, expected = steady.state.x, [steady.adhesion_torque[0]]
    for before, now in itertools.pairwise(u):
        x = form.F @ x + form.P @ before + form.Q @ now
        expected.append(form.C @ x + form.D @ now)
    found = observer.run(INTERVAL * np.arange(1200), torque, omega).adhesion_torque
    assert found == pytest.approx(expected, abs=1e-6)  # J/h omega of 1e6 N*m is a difference here


def test_gains_are_those_of_the_closed_form_and_of_an_independent_riccati_solution():
    """Continuous, B = 0, an exact torque: a double integrator, l2 = sqrt(q/r), l1 = sqrt(2 l2/J). Sampled: SciPy's."""
    k = kalman_of(viscous_friction=0.0, torque_variance=0.0)
    second = math.sqrt(k.walk / (k.speed_variance * INTERVAL))
    assert k.continuous_gain == pytest.approx([math.sqrt(2 * second / k.inertia), second])
    k = kalman_of(viscous_friction=25.0)
    nodes, weights = np.polynomial.legendre.leggauss(20)
    steps = [(w * INTERVAL / 2, expm(k.model[0] * (x + 1) * INTERVAL / 2)) for x, w in zip(nodes, weights, strict=True)]
    Q, R = sum(w * F @ k.driving_noise @ F.T for w, F in steps), k.speed_variance
    P = solve_discrete_are(expm(k.model[0] * INTERVAL).T, np.eye(2, 1), Q, [[R]])
    assert k.sampled_gain == pytest.approx(P[:, 0] / (P[0, 0] + R), rel=1e-9)


NOISE = {"walk": 1e300}, {"walk": 1e-300}, {"speed_variance": 1e-30}, {"torque_variance": 1e30}, {"interval": 1e-300}
NO_GAIN = r"Kalman filter: no steady gain can be computed with .*give noises|interval: "
BRISTLE, BEAM = (published_law(name, Rail.DRY, 140.0) for name in ("bristle", "beam"))


@functools.cache
def trial_of(law=BEAM, speed=SPEED, interval=INTERVAL, **course):
    return brake_trial(law, PARK2008, speed, interval=interval, course=BrakeCourse(**course))


@pytest.mark.parametrize(("make", "message"), [
    (lambda: FilterObserver(0.0, 0.25, TAU), r"inertia: 0 kg\*m\^2 is not allowed; give a finite value > 0"),
    (lambda: FilterObserver(60.0, -1.0, TAU), r"viscous_friction: -1 N\*m\*s is not allowed"),
    (lambda: FilterObserver(60.0, 0.25, math.nan), "time_constant: nan s is not allowed"),
    (lambda: kalman_of(speed_variance=0.0), "speed_variance: 0 "),
    (lambda: kalman_of(torque_variance=-1.0), "torque_variance: -1 "),
    (lambda: KalmanObserver.of(PARK2008, ENCODER, SENSOR, interval=1, change=-1, within=1), "change: -1"),
    *((lambda k=k: (kalman_of(**k).sampled_gain, kalman_of(**k).continuous_gain), NO_GAIN) for k in NOISE),
    *((lambda o=o: o.sampled(0.0), "interval: 0 s is not allowed") for o in (OBSERVERS[0], KALMAN)),
    (lambda: KALMAN.run([0, 1, 1], [1, 1, 1], [1, 1, 1]), "time: 1 in row 2 is not after 1; give increasing times"),
    (lambda: KALMAN.run([0.5], [0], [60], KALMAN.run([1], [0], [60]).state), "time: 0.5 in row 0 is not after 1"),
    (lambda: KALMAN.run([0, 1], [1, np.nan], [1, 1]), "torque: nan in row 1"),
    (lambda: KALMAN.run([0, 1], [1, 1, 1], [1, 1]), r"torque: shape \(3,\)"),
    (lambda: KALMAN.run([], [], []), "time: no rows"),
    (lambda: Encoder(0), "counts: 0 is not allowed; give a value >= 1"),
    (lambda: TorqueSensor(1.0, -5.0), r"resolution: -5 N\*m is not allowed"),
    (lambda: BrakeCourse(rise=0.0), r"rise: 0 N\*m/s is not allowed"),
    (lambda: BrakeCourse(release_slip=1.0), "release_slip: 1 is not allowed"),
    (lambda: trial_of(speed=5.0, rise=100.0), r"release_slip: the train stops before .* 0\.5; give"),
    (lambda: trial_of(BRISTLE, release_slip=0.9), "slip"),
])  # fmt: skip
def test_what_cannot_be_is_refused(make, message):
    with pytest.raises((InputError, DomainError), match=message):
        make()


def test_sensors():
    rounded, free = (TorqueSensor(50.0, step).measured(np.zeros(99), np.random.default_rng(3)) for step in (5.0, 0.0))
    assert np.array_equal(rounded, 5.0 * np.round(free / 5.0))
    time = np.array([0.0, 0.5, 1.0, 2.0])
    angle = 2 * math.pi * np.array([0.0, 0.30, 0.49, 1.0])
    assert Encoder(4).speed(time, angle) == pytest.approx([math.pi, 0.0, 1.5 * math.pi])  # counts 0, 1, 1, 4
    generator, time = np.random.default_rng(3), np.arange(200_001) * INTERVAL
    angle = np.cumsum(generator.uniform(0.2, 0.4, time.size))  # some 200 counts a sample, no pattern in them
    error = ENCODER.speed(time, angle) - np.diff(angle) / INTERVAL
    # 2e5 samples: a variance good to 0.3 %, 4 of those and a little
    assert error.var() == pytest.approx(ENCODER.speed_variance(INTERVAL), rel=0.015)
    assert np.mean(error[1:] * error[:-1]) == pytest.approx(-error.var() / 2, rel=0.03)  # neighbours share an angle


@pytest.mark.parametrize("observer", OBSERVERS)
def test_noise_gains_are_the_area_under_the_squared_response(observer):
    """Parseval: the same norm from the frequency response, on a grid of 2e5."""
    form = observer.sampled(INTERVAL)
    omega = np.linspace(0, math.pi / INTERVAL, 200_001)
    back = np.exp(-1j * omega * INTERVAL)
    inside = np.linalg.solve(np.eye(len(form.F)) - back[:, None, None] * form.F, back[:, None, None] * form.P + form.Q)
    torque, speed = np.abs(form.C @ inside + form.D).T ** 2
    gains = form.noise_gains()
    angle = speed * np.abs(1 - back) ** 2 / INTERVAL**2
    for gain, density in ((gains.torque, torque), (gains.speed, speed), (gains.angle, angle)):
        assert gain == pytest.approx(trapezoid(density, omega) * INTERVAL / math.pi, rel=1e-6)
    noisy = TorqueSensor(noise=2000.0)  # as much as the encoder's
    expected = math.hypot(math.sqrt(gains.angle * ENCODER.angle_variance), 2000.0 * math.sqrt(gains.torque))
    assert observers.noise_deviation(form, ENCODER, noisy) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("observer", OBSERVERS)
@pytest.mark.parametrize("law", [BEAM, BRISTLE], ids=lambda law: law.name)
def test_estimates_are_the_truth_but_for_lag_and_noise(law, observer):
    trial = trial_of(law)
    errors = script("analysis/observer_tradeoff.py").observer_errors(observer, trial, ENCODER, SENSOR, seed=2008)
    # one draw; the errors' deviation over 1000 samples with memory is good to some 5 %
    assert errors.simulated == pytest.approx(errors.total, rel=0.12)
    if observer is KALMAN:
        assert errors.total < 0.06 * trial.adhesion_torque.max()
