"""Sensors, what their noise does to the estimates, and the estimates against the truth in simulation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import trapezoid

from railslip_ctrl.core.errors import DomainError, InputError
from railslip_ctrl.identification.observer import Encoder, FilterObserver, Form, KalmanObserver, TorqueSensor
from railslip_ctrl.identification.observer_study import (
    BrakeCourse,
    brake_trial,
    estimated,
    measured,
    observer_errors,
)
from railslip_ctrl.model.adhesion import published_law
from railslip_ctrl.model.vehicle import PARK2008, Rail

INTERVAL = 5e-3
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
        (lambda: TorqueSensor(-1.0), "noise: -1 is not allowed"),
        (lambda: TorqueSensor(1.0, -5.0), "resolution: -5 is not allowed"),
        (lambda: BrakeCourse(rise=0.0), "rise: 0 is not allowed"),
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


def test_printed_estimate_is_wrong_by_a_released_torque(trial):
    """What it has over the corrected one is Tb through tau s/(tau s + 1): rise and fall of the torque by hand."""
    tau, course = 0.5, BrakeCourse()
    printed, corrected = (estimated(FilterObserver.of(PARK2008, tau, form), trial) for form in Form)
    drop = trial.brake_torque.max()
    at = trial.time[1:].searchsorted(trial.release_time + drop / course.fall)
    risen, fallen = trial.release_time - course.start, drop / course.fall
    kept = course.rise * tau * (1 - math.exp(-risen / tau)) * math.exp(-fallen / tau)
    expected = kept - course.fall * tau * (1 - math.exp(-fallen / tau))
    # the sample is up to an interval after the end, the peak up to one before the release; B omega is left out (20 N*m)
    assert printed[at] - corrected[at] == pytest.approx(expected, abs=1.1 * INTERVAL / tau * drop + 20)
    assert expected < -0.6 * drop  # most of the released torque stands in the estimate


def test_same_seed_same_noise(trial):
    one, same, other = (measured(trial, ENCODER, SENSOR, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(one.torque, same.torque)
    assert not np.array_equal(one.torque, other.torque)
    assert np.array_equal(one.omega, other.omega)  # an encoder's counts are no chance


def test_trials_that_cannot_be():
    law = published_law("beam", Rail.DRY, 140.0)
    with pytest.raises(InputError, match=r"release_slip: 0\.5 is not reached, the train stops before"):
        brake_trial(law, PARK2008, 5.0, interval=INTERVAL, course=BrakeCourse(rise=100.0))
    with pytest.raises(InputError, match="speed: 0 is not allowed"):
        brake_trial(law, PARK2008, 0.0, interval=INTERVAL, course=BrakeCourse())
    with pytest.raises(InputError, match="interval: 0 is not allowed"):
        brake_trial(law, PARK2008, SPEED, interval=0.0, course=BrakeCourse())
    bristle = published_law("bristle", Rail.DRY, 140.0)
    with pytest.raises(DomainError):
        brake_trial(bristle, PARK2008, SPEED, interval=INTERVAL, course=BrakeCourse(release_slip=0.9))
