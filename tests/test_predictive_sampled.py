"""The loop of the predictive law as it runs, against its own step in time: wheel, hold and brake by exponentials."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm

from railslip_ctrl import PARK2008, Actuator, Envelope, ReferenceSlip, judge
from railslip_ctrl.controllers import predictive as step
from railslip_ctrl.controllers.predictive import Predictive
from railslip_ctrl.model.adhesion import published_law
from railslip_ctrl.model.linearization import linearize, operating_point

PULSE = 1.0  # N*m in one sample: far within the boundary layer, where the step is linear


def answers(law, point, brake, count, *, pulse=PULSE, error=0.0, load=0.0):
    """Commands and slip velocity, samples 0 on, after a pulse of the command, and steps of the slip error that the law
    sees, m/s, and of torque at the wheel, N*m. S over frequency is the transform of the commands after a pulse.

    The speed is frozen: what is predicted from it stays, and only its rate is observed.
    """
    h, r = law.period, law.radius
    plant, rates = linearize(point), linearize(point, speed_state=True).A[0, 1:]
    n = len(plant.states)
    held = np.zeros((n + 4, n + 4))  # wheel, train speed, acting torque, command, load
    held[:n, n + 3] = plant.B[:, 0]
    held[:n, :n], held[:n, n + 1], held[n, :n] = plant.A, plant.B[:, 0], rates
    if brake.lag > 0:
        held[n + 1, n + 1], held[n + 1, n + 2] = -1 / brake.lag, 1 / brake.lag
    late = brake.dead_time / h
    whole, rest = int(late + 1e-9), (late - int(late + 1e-9)) * h
    before, after = expm(held * rest), expm(held * (h - rest))
    p = SimpleNamespace(**{name: getattr(law, name) for name in law.parameter_fields()}, period=h)
    x, wheel, torques, slips, own = law.start(1.0, h), np.zeros(n + 4), [], [], 0.0
    wheel[n + 3] = load
    x = SimpleNamespace(**{name: getattr(x, name) for name in type(x).model_fields})
    x.history = list(x.history)
    for k in range(count):
        speed, sigma = wheel[n], wheel[0]
        step.actuator_model(x, p, own)
        step.observe(x, p, speed, (speed - sigma) / r, point.slip)
        step.predict(x, p, 0.0, sigma - error, point.slip)
        own = step.sliding_torque(x, p, point.slip)
        x.samples += 1.0
        torques.append(own + (pulse if k == 0 else 0.0))
        slips.append(sigma)
        for part, age in ((before, whole + 1), (after, whole)):
            wheel[n + 2] = torques[k - age] if k >= age else 0.0
            if brake.lag <= 0:
                wheel[n + 1] = wheel[n + 2]
            wheel = part @ wheel
    return np.array(torques), np.array(slips)


CASES = [
    ("curve", 60, 0.11, 1.0, 1.0, True),
    ("curve", 60, 0.11, 1.3, 0.7, True),  # no whole number of samples
    ("bristle", 20, 0.0935, 0.7, 1.3, True),
    ("bristle", 100, 0.11, 1.0, 0.0, False),  # a brake without the lag that it believes
    ("bristle", 100, 0.13, 2.2, 0.7, False),
    ("curve", 20, 0.14, 2.0, 1.0, False),
]


@pytest.mark.parametrize(
    ("name", "kmh", "slip", "late", "slow", "stable", "lag"),
    [*((*case, 0.6) for case in CASES), ("bristle", 60, 0.09, 1.05, 1.0, True, 0.0)],
)
def test_its_loop_is_that_of_the_step(name, kmh, slip, late, slow, stable, lag):
    car = PARK2008.model_copy(update={"actuator": Actuator(dead_time=0.15, lag=lag)})
    law = Predictive.for_vehicle(car)
    point = operating_point(published_law(name, "dry"), car, kmh / 3.6, slip)
    brake = Actuator(dead_time=0.15 * late, lag=lag * slow)
    loop = law.loop_as_run(point, brake)
    assert loop.is_stable() == stable
    found, _ = answers(law, point, brake, 6000 if stable else 1500)
    if not stable:
        assert np.abs(found[-100:]).max() > 10 * np.abs(found[100:200]).max()
        assert loop.margins().ms == np.inf
        return
    assert np.abs(found[-100:]).max() < 1e-9
    omega = np.arange(1, found.size // 2) * 2 * np.pi / (found.size * law.period)
    spectrum = np.fft.rfft(found)[1 : found.size // 2]
    np.testing.assert_allclose(1 / (1 + loop.response(omega)), spectrum, atol=1e-7)
    assert np.abs(spectrum).max() <= loop.margins().ms * (1 + 1e-7)
    assert loop.margins().ms == pytest.approx(np.abs(spectrum).max(), rel=2e-3)  # of the transform's frequencies


@pytest.mark.parametrize("every", [1, 3])
@pytest.mark.parametrize("lag", [0.6, 0.0])
@pytest.mark.parametrize(("name", "kmh", "slip", "late", "slow", "stable"), CASES)
def test_its_responses_are_those_of_the_step(name, kmh, slip, late, slow, stable, lag, every):
    car = PARK2008.model_copy(update={"actuator": Actuator(dead_time=0.15, lag=lag)})
    law = Predictive.for_vehicle(car)
    point = operating_point(published_law(name, "dry"), car, kmh / 3.6, slip)
    brake = Actuator(dead_time=0.15 * late, lag=lag * slow)
    count = 600 if stable else 198
    # so small that the command of an unstable loop stays within the boundary layer too, where the step is linear
    time, *found = law.loop_as_run(point, brake).responses(
        count * law.period, count // every, reference=1e-9, torque=1e-7
    )
    np.testing.assert_allclose(time, np.arange(count // every) * every * law.period, atol=1e-12)
    for response, steps in zip(found, ({"error": 1e-9}, {"load": 1e-7}), strict=True):
        _, expected = answers(law, point, brake, count, pulse=0.0, **steps)
        assert np.abs(expected).max() > 3e-11
        np.testing.assert_allclose(response, expected[::every], atol=1e-8 * np.abs(expected).max())


def test_every_case_of_an_envelope_is_judged_as_it_runs():
    law = Predictive.for_vehicle(PARK2008, reference=ReferenceSlip(dry=0.1, wet=0.07))
    envelope = Envelope(PARK2008, laws=("curve", "bristle"), speeds=(20, 100), loads=("empty",), radius=(1.0,))
    found = judge(envelope, law)
    assert not np.isnan(found.sampled_ms).any()
    for i in range(0, len(found.points), 7):
        case = found.points.case(i)
        one = law.loop_as_run(case.point, case.actuator)
        assert one.margins().ms == pytest.approx(found.sampled_ms[i], rel=1e-9)
    assert found.worst_with_tolerances.run_ms == pytest.approx(found.sampled_ms.max(), rel=1e-9)
    assert found.worst_with_tolerances.run_ms > 1.05 * found.worst_with_tolerances.ms
    assert found.verdict == ("robust" if found.run_ms[found.points.operating].max() <= 2 else "fragile")
    assert f"sampled every {law.period:g} s" in found.verdict_line
