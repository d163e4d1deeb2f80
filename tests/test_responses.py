"""Closed-loop responses with exact dead time: closed forms, SciPy, python-control, poles and final values."""

import math
from fractions import Fraction

import control as ct
import numpy as np
import pytest
from test_sampled import INTEGRATOR, gain

from railslip_ctrl import DeadTimeLoop, InputError, Rational
from railslip_ctrl.loop.deadtime import frequency_curve, gang_of_four
from railslip_ctrl.loop.rational import realise
from railslip_ctrl.loop.responses import TimeResponse, closed_loop_response, disturbance_response, step_response

ONE = gain(1.0)


def rational(num, den) -> Rational:
    return Rational.from_polynomials(num, den)


# An unstable wheel-like loop: pole at +0.82 1/s behind 0.6 s of lag and 0.15 s of dead time, PI with a lead.
WHEEL = Rational(np.array([-7.8]), np.array([0.82, -8.64]), 0.43 / 60.35)
LAG = rational([1], [0.6, 1])
PI_LEAD = rational([229.0, 5.0], [1, 0]) * rational([0.6, 1], [0.06, 1])
DEAD_TIME = 0.15

SYSTEMS = {
    "gain": gain(3.0),
    "PI": rational([190.0, 5.0], [1, 0]),
    "double integrator": Rational(np.array([]), np.array([0.0, 0.0]), 2.0),
    "complex poles": rational([3.0], [1, 0.2, 9]),
    "complex poles, one zero": rational([3.0, 5], [1, 0.2, 9]),
    "complex poles, two real zeros": rational([3.0, 5, 1], [1, 0.2, 9]),
    "complex zeros on complex poles": rational([3.0, 0.1, 30], [1, 0.2, 9]),
    "complex zeros, real poles": rational([1, 0.4, 4], [1, 6, 11, 6]),
    "complex zeros, double pole": rational([1, 0.4, 4], [1, 4, 4]),
    "mixed": rational([2, 1, 8, 3], np.polymul([1, 0.2, 9], [1, 3, 2])),
    "wheel": PI_LEAD * LAG * WHEEL,
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_realisation_has_the_response_and_the_poles_of_the_factored_form(name):
    system = SYSTEMS[name]
    r = realise(system)
    assert r.order == system.poles.size
    s = np.array([0.3 + 2j, 5j, -0.1 + 0.7j, 40.0])
    value = np.array([r.c @ np.linalg.solve(x * np.eye(r.order) - r.a, r.b) + r.d for x in s])
    assert value == pytest.approx(system(s), rel=1e-12)
    found, given = np.sort_complex(np.linalg.eigvals(r.a)), np.sort_complex(system.poles)
    assert found == pytest.approx(given, abs=1e-7)  # a double pole is good to sqrt(eps)


@pytest.mark.parametrize("poles", [[1j], [1j, -2j], [-1j, -1.0]])
def test_realisation_refuses_complex_roots_without_their_conjugates(poles):
    with pytest.raises(InputError, match="without its conjugate"):
        realise(Rational(np.array([]), np.array(poles), 1.0))


def delayed_integrator_step(gain: Fraction, dead_time: Fraction, t: Fraction) -> float:
    """y = sum over k >= 1 with k tau < t of (-1)^(k+1) (K (t - k tau))^k/k!, in exact arithmetic.

    From y'(t) = K (1 - y(t - tau)) segment by segment; in floating point the alternating sum would cancel.
    """
    total, k = Fraction(0), 1
    while t > k * dead_time:
        total -= (-gain * (t - k * dead_time)) ** k / math.factorial(k)
        k += 1
    return float(total)


@pytest.mark.parametrize(
    ("k", "dead_time", "segments"),
    [(2.0, 1.0, 40), (1.0, 1.0, 200), (1.5, 1.0, 60), (0.5, 0.25, 60), (12.0, 0.125, 60), (32.0, 0.5, 20)],
)
def test_delayed_integrator_equals_the_method_of_steps(k, dead_time, segments):
    # times that are binary fractions, so that the closed form sees the same ones
    steps = np.arange(0, 8 * segments + 1, 5)
    t = steps * dead_time / 8
    exact = Fraction(k), Fraction(dead_time)
    expected = [delayed_integrator_step(*exact, int(n) * exact[1] / 8) for n in steps]
    found = step_response(gain(k), INTEGRATOR, dead_time, time=t)
    # K tau > pi/2 grows: then relative to the size reached so far
    size = np.maximum(1.0, np.maximum.accumulate(np.abs(expected)))
    assert np.max(np.abs(found.output - expected) / size) < 1e-11
    assert np.max(np.abs(found.control - k * (1 - found.output)) / size) < 1e-11


def test_a_biproper_loop_jumps_at_multiples_of_the_dead_time():
    # first segments of L = K (s + z)/(s + p) exp(-tau s) with K = 0.6: jump of K at tau, of -K^2 at 2 tau
    tau, plant = 0.3, rational([1, 2], [1, 5])
    t = np.array([tau - 1e-9, tau, 2 * tau - 1e-9, 2 * tau])
    y = step_response(gain(0.6), plant, tau, time=t).output
    assert y[1] - y[0] == pytest.approx(0.6, abs=1e-7)
    assert y[3] - y[2] == pytest.approx(-0.36, abs=1e-7)
    # a multiple but for rounding is after the jump: 0.3/0.1 = 2.9999999999999996
    assert step_response(ONE, ONE, 0.1, time=[0.1, 0.3]).output == pytest.approx([1.0, 1.0], abs=1e-15)


def test_without_dead_time_it_is_the_response_of_scipy():
    from scipy.signal import lsim

    loop = ct.tf([229 * 0.6, 229 + 5 * 0.6, 5], [0.06, 1, 0]) * ct.tf([1], [0.6, 1])
    loop *= ct.zpk([-7.8], [0.82, -8.64], 0.43 / 60.35)
    closed = ct.ss(ct.feedback(loop, 1))
    t = np.linspace(0, 5, 400)
    expected = lsim((closed.A, closed.B, closed.C, closed.D), np.ones(t.size), t)[1]
    found = step_response(PI_LEAD, WHEEL, 0.0, actuator=LAG, time=t)
    assert found.output == pytest.approx(expected, abs=1e-9)  # lsim's expanded polynomials lose digits


def test_superposition_and_the_impulse_as_an_initial_state():
    t = np.linspace(0, 6, 200)
    options = {"actuator": LAG, "time": t}
    together = closed_loop_response(PI_LEAD, WHEEL, DEAD_TIME, reference=2.0, disturbance=30.0, noise=0.2, **options)
    parts = [
        closed_loop_response(PI_LEAD, WHEEL, DEAD_TIME, **{name: height}, **options)
        for name, height in (("reference", 2.0), ("disturbance", 30.0), ("noise", 0.2))
    ]
    for name in ("output", "control", "plant_input", "error", "control_rate"):
        total = sum(getattr(part, name) for part in parts)
        assert getattr(together, name) == pytest.approx(total, abs=1e-10 * np.max(np.abs(total)))
    # the response to an impulse of 1 N*m*s is the derivative of the one to a step of 1 N*m
    kick = closed_loop_response(PI_LEAD, WHEEL, DEAD_TIME, initial_plant_state=realise(WHEEL).b, **options)
    h = 1e-5
    ahead, behind = (
        disturbance_response(PI_LEAD, WHEEL, DEAD_TIME, actuator=LAG, time=t[1:] + s).output for s in (h, -h)
    )
    # central difference: h^2 of the third derivative and rounding over h
    assert (ahead - behind) / (2 * h) == pytest.approx(kick.output[1:], abs=1e-8)
    assert kick.output[0] == pytest.approx(0.43 / 60.35, rel=1e-14)


@pytest.mark.parametrize("dead_time", [1e-3, 0.15, 3.0, 50.0, 1e9])
def test_any_dead_time_and_any_times_give_the_same_curve(dead_time):
    # asked for in one piece or at single points, beyond the dead time or not
    t = np.array([0.0, 0.4, 1.0, 1.0, 2.5])
    whole = step_response(PI_LEAD, WHEEL, dead_time, actuator=LAG, time=t).output
    single = [step_response(PI_LEAD, WHEEL, dead_time, actuator=LAG, time=[x]).output[0] for x in t]
    assert whole == pytest.approx(single, abs=1e-13)


def test_overshoot_and_settling_time():
    t = np.arange(5.0)
    y = np.array([0.0, 2.6, 1.8, 2.02, 2.0])
    response = TimeResponse(t, y, y, y, y, y, 0.1, reference=2.0, disturbance=0.0, noise=0.0)
    assert response.overshoot == pytest.approx(0.3)
    assert response.settling_time(2.0, 0.05) == 3.0
    assert response.settling_time(2.0, 5.0) == 0.0
    assert response.settling_time(0.0, 0.05) == math.inf
    assert response.largest_output == 2.6
    none = TimeResponse(t, y, y, y, y, y, 0.1, reference=0.0, disturbance=1.0, noise=0.0)
    assert math.isnan(none.overshoot)


def wheel(**options):
    return closed_loop_response(PI_LEAD, WHEEL, DEAD_TIME, actuator=LAG, **options)


@pytest.mark.parametrize(("make", "message"), [
    (lambda: wheel(), "give either the times or the final time"),
    (lambda: wheel(time=[0, 1], final_time=1.0), "give either the times or the final time"),
    (lambda: wheel(final_time=0.0), "final time: 0 s is not allowed"),
    (lambda: wheel(time=[1.0, 0.5]), "ascending"),
    (lambda: wheel(time=[-1.0]), ">= 0"),
    (lambda: wheel(time=[math.nan]), "finite"),
    (lambda: wheel(final_time=1.0, reference=math.nan), "steps: .* not finite"),
    (lambda: wheel(final_time=1.0, initial_plant_state=[1.0]), "give 2 finite numbers"),
    (lambda: wheel(final_time=1e6), "at most 200000"),
    *((lambda x=x: step_response(ONE, ONE, x, final_time=1.0), "dead time") for x in (-0.1, math.nan, math.inf)),
    (lambda: step_response(gain(-1.0), rational([1, 2], [1, 5]), 0.0, final_time=1.0), "algebraic loop"),
    (lambda: step_response(ONE, Rational(np.array([]), np.array([20.0]), 1.0), 0.1, final_time=100.0), "overflows"),
    *((lambda b=b: frequency_curve(DeadTimeLoop(WHEEL, 0.1), *b), "rad/s") for b in ((0.0, 1.0), (2.0, 2.0))),
    *((lambda b=b: gang_of_four(ONE, DeadTimeLoop(WHEEL, 0.1), *b), "rad/s") for b in ((0.0, 1.0), (2.0, 2.0))),
])  # fmt: skip
def test_bad_input_is_refused_in_one_line(make, message):
    with pytest.raises(InputError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)


def test_frequency_curves_are_the_formulas():
    loop = DeadTimeLoop(PI_LEAD * WHEEL, DEAD_TIME)
    curve, gang = frequency_curve(loop, 0.1, 50.0), gang_of_four(PI_LEAD, DeadTimeLoop(WHEEL, DEAD_TIME), 0.1, 50.0)
    assert set(loop.gain_crossovers) <= set(curve.omega)
    for given in (curve, gang):
        assert (given.omega[0], given.omega[-1]) == pytest.approx((0.1, 50.0), rel=1e-15)
        assert np.diff(np.log(given.omega)).max() < 2e-3  # a smooth line
    s = 1j * gang.omega
    c, p = PI_LEAD(s), WHEEL(s) * np.exp(-DEAD_TIME * s)
    assert np.array([gang.s, gang.t, gang.ps, gang.cs]) == pytest.approx(
        np.array([1 + 0 * p, c * p, p, c]) / (1 + c * p), rel=1e-12
    )
    s = 1j * curve.omega
    expected = PI_LEAD(s) * WHEEL(s) * np.exp(-DEAD_TIME * s)
    assert curve.response == pytest.approx(expected, rel=1e-12)
    assert curve.magnitude_db == pytest.approx(20 * np.log10(np.abs(expected)), abs=1e-10)
    assert np.exp(1j * np.radians(curve.phase_deg)) == pytest.approx(expected / np.abs(expected), abs=1e-10)
    assert np.abs(np.diff(curve.phase_deg)).max() < 2.0  # continuous
