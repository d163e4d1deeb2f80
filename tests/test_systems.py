"""Systems as the ecosystem writes them, responses of their closed loops, and figures of what is found about them."""

import itertools
import math
from dataclasses import replace
from fractions import Fraction
from types import SimpleNamespace

import control as ct
import numpy as np
import pytest
from figure_checks import defects
from matplotlib.contour import ContourSet
from scipy import signal
from scipy.interpolate import RegularGridInterpolator
from test_sampled import INTEGRATOR, gain

import railslip_ctrl as rs
from railslip_ctrl import PARK2008, DeadTimeLoop, InputError, PIController, PIGains, Rational, stabilizing_pi, tune_pi
from railslip_ctrl.design.assessment import assess, controller_group, published_groups
from railslip_ctrl.design.compensators import filtered_smith_predictor, observer_compensator, smith_predictor
from railslip_ctrl.design.limits import control_effort, fundamental_limits
from railslip_ctrl.design.schedule import plant_at, sweep_slip, sweep_speed
from railslip_ctrl.design.tuning import first_order_model, pi_for_crossover, simc_pi
from railslip_ctrl.loop.deadtime import frequency_curve, gang_of_four
from railslip_ctrl.loop.rational import realise
from railslip_ctrl.loop.responses import TimeResponse, closed_loop_response, disturbance_response, step_response
from railslip_ctrl.loop.sampled import SampledLoop
from railslip_ctrl.report import plots
from railslip_ctrl.report.plots import designs, style
from railslip_ctrl.report.plots.style import figure_bytes
from railslip_ctrl.report.recommendation import GainMap

NUM, DEN = [1.5, 6.0], [2.0, 9.0, 10.0]  # zero -4, poles -2 and -2.5
SYSTEMS = {
    "control.tf": lambda: ct.tf(NUM, DEN),
    "control.ss": lambda: ct.ss(ct.tf(NUM, DEN)),
    "control.zpk": lambda: ct.zpk([-4], [-2, -2.5], 0.75),
    "scipy.lti": lambda: signal.lti(NUM, DEN),
    "scipy.StateSpace": lambda: signal.StateSpace([[-4.5, -5], [1, 0]], [[1], [0]], [[0.75, 3]], [[0]]),
    "scipy.ZerosPolesGain": lambda: signal.ZerosPolesGain([-4], [-2, -2.5], 0.75),
}
SAME = Rational([-4.0], [-2.0, -2.5], 0.75)
S = np.array([0.3 + 2j, 5j])
LAG = ct.tf([1], [0.3, 1])
TIMES = np.linspace(0, 3, 7)
POLES = {"feedback_poles": [-2, -3, -4], "observer_poles": [-5, -6]}

CALLS = {
    "loop": lambda x: DeadTimeLoop(x, 0.1)(S),
    "controller": lambda x: step_response(x, LAG, 0.1, time=TIMES).output,
    "plant": lambda x: disturbance_response(2.0, x, 0.1, time=TIMES).output,
    "actuator": lambda x: closed_loop_response(2.0, LAG, 0.1, time=TIMES, actuator=x, reference=1.0).output,
    "plants": lambda x: tune_pi([x], 0.1, ms_max=1.6).kp,
    "compensator": lambda x: tune_pi(LAG, 0.1, ms_max=1.6, compensator=x).kp,
    "plant of pi_for_crossover": lambda x: pi_for_crossover(x, 0.1, 2.0, 60.0),
    "loop of stabilizing_pi": lambda x: stabilizing_pi(x, 0.1).kp_range,
    "plant of fundamental_limits": lambda x: fundamental_limits(x, 0.1).ms_bound,
    "plant of first_order_model": lambda x: first_order_model(x, 0.3).time_constant,
    "plant of simc_pi": lambda x: simc_pi(x, 0.3).gains.kp,
    "plant of smith_predictor": lambda x: smith_predictor(x, 0.1, 2.0).loop(S),
    "controller of smith_predictor": lambda x: smith_predictor(LAG, 0.1, x).loop(S),
    "controller of filtered_smith_predictor": lambda x: filtered_smith_predictor(LAG, 0.1, x, filter_time=0.2).loop(S),
    "plant of observer_compensator": lambda x: observer_compensator(x, 0.1, **POLES).loop(S),
    "plant of control_effort": lambda x: control_effort(ct.tf([2], [1]), x, 0.1, lag=0.3).noise_gain,
    "controller of control_effort": lambda x: control_effort(x, LAG, 0.1, lag=0.3).noise_gain,
}


@pytest.mark.parametrize("call", CALLS)
def test_what_takes_a_system_takes_those_of_both_libraries_and_refuses_a_discrete_one_by_its_name(call: str) -> None:
    expected = np.asarray(CALLS[call](SAME))  # searches stop at 1e-9
    assert np.asarray(CALLS[call](SYSTEMS["scipy.StateSpace"]())) == pytest.approx(expected, rel=1e-7)

    with pytest.raises(InputError, match=rf"^{call.split()[0]}: a discrete-time system \(dt = 0.1\)"):
        CALLS[call](signal.dlti(NUM, DEN, dt=0.1))


PLANT, DELAY = ct.tf([4], [0.4, 1, 0]), 0.15
LOOP = DeadTimeLoop(PLANT, DELAY)


@pytest.mark.parametrize("name", SYSTEMS)
def test_a_system_of_any_library_is_its_zeros_and_poles_and_multiplies_a_loop_from_either_side(name):
    # a polynomial of order 2 loses a digit or two
    assert Rational.from_control(SYSTEMS[name]())(S) == pytest.approx(SAME(S), rel=1e-12)
    expected = PLANT(S) * SYSTEMS["control.tf"]()(S) * np.exp(-DELAY * S)
    for found in (SYSTEMS[name]() * LOOP, LOOP * SYSTEMS[name](), SAME * LOOP, LOOP * DeadTimeLoop(SAME)):
        assert found(S) == pytest.approx(expected, rel=1e-10)


def test_a_loop_has_what_python_control_asks_of_it():
    assert sorted(LOOP.poles().real) == pytest.approx([-2.5, 0.0], abs=1e-14)
    omega = np.geomspace(0.3, 30, 4000)
    record = LOOP.frequency_response(omega)
    gain, phase, _, _, crossover, _ = ct.stability_margins(record)  # interpolates between the points
    m = LOOP.margins()
    assert (gain, phase, crossover) == pytest.approx((m.gain_increase, m.phase_deg, m.phase_frequency), rel=1e-6)
    magnitude = ct.bode_plot(record, display_margins=False).axes[0, 0].lines[0].get_ydata()
    assert magnitude == pytest.approx(np.abs(PLANT(1j * omega)), rel=1e-9)


def test_python_control_s_plots_of_a_loop_itself_say_what_they_take():
    for plot in (ct.bode_plot, ct.nyquist_plot, ct.nichols_plot, ct.singular_values_plot):
        with pytest.raises(AttributeError, match=r"loop\.frequency_response\(omega\)"):
            plot(LOOP)


H, FINE = 0.2, 20
SAMPLED = SampledLoop(ct.tf([0.15, -0.147], [1, -1], H), PLANT, 1.75 * H, H)


def test_a_sampled_loop_answers_a_step_between_its_samples_too():
    """The plant advanced by python-control in steps of a 20th of a period."""
    fine, late = ct.c2d(ct.ss(PLANT), H / FINE), 7 * FINE // 4
    x, past, command, expected, errors = np.zeros(2), [0.0] * late, 0.0, [], [0.0]
    for k in range(12 * FINE):
        expected.append(float((fine.C @ x)[0]))
        if k % FINE == 0:
            errors.append(1 - expected[-1])
            command += 0.15 * errors[-1] - 0.147 * errors[-2]  # u[k] = u[k-1] + 0.15 e[k] - 0.147 e[k-1]
        past.append(command)
        x = fine.A @ x + fine.B[:, 0] * past.pop(0)
    found = SAMPLED.step_response(np.arange(12 * FINE) * H / FINE)
    assert found.output == pytest.approx(expected, abs=1e-12)  # rounding of 240 steps
    assert found.error == pytest.approx(1 - np.array(expected), abs=1e-12)
    assert found.control[: 2 * FINE] == pytest.approx([0.15] * FINE + [0.153] * FINE)
    assert found.plant_input == pytest.approx(np.append(np.zeros(late), found.control[:-late]))
    with pytest.raises(InputError, match=r"give a time <= 4e\+04 s"):
        SAMPLED.step_response(1e6)
    with pytest.raises(InputError, match="overflows"):
        (60 * SAMPLED).step_response(300)


def test_a_sampled_loop_is_multiplied_and_divided():
    factor = ct.tf([1, -0.3], [1, 0.2], H)
    z = np.exp(1j * np.array([0.3, 2.0, 15.0]) * H)
    assert SAMPLED(z) == pytest.approx(SAMPLED.response(np.array([0.3, 2.0, 15.0])), rel=1e-12)
    for found in (2 * SAMPLED, SAMPLED * 2.0, np.float64(2) * SAMPLED, -SAMPLED * -2, SAMPLED / np.float64(0.5)):
        assert found(z) == pytest.approx(2 * SAMPLED(z), rel=1e-12)
    for found in (factor * SAMPLED, SAMPLED * factor):
        assert found(z) == pytest.approx(factor(z) * SAMPLED(z), rel=1e-9)
    for other in (SAMPLED, PLANT, "C", ct.tf([1], [1, 2], 0.1)):
        with pytest.raises(InputError, match="factor: "):
            SAMPLED * other
    for loop, divisor in itertools.product((LOOP, SAMPLED), (0, "C", None)):
        with pytest.raises(InputError, match=r"divisor: |gain factor: "):
            loop / divisor
        with pytest.raises(InputError, match=r"^final time: 'a'"):
            loop.step_response("a")


def test_a_sampled_loop_has_what_python_control_asks_of_it():
    assert np.sort_complex(SAMPLED.poles()) == pytest.approx([0, 0, np.exp(-2.5 * H), 1, 1])
    assert np.isinf(SAMPLED(1))
    assert SAMPLED.integrators == 2
    record = SAMPLED.frequency_response(np.geomspace(0.1, np.pi / H, 4000))
    assert record.dt == H
    gain, phase, *_ = ct.stability_margins(record)  # interpolates between the points
    margins = SAMPLED.margins()
    assert (gain, phase) == pytest.approx((margins.gain_increase, margins.phase_deg), rel=1e-5)
    assert SAMPLED.gain_crossovers == pytest.approx(margins.gain_crossovers)
    assert np.degrees(SAMPLED.phase(SAMPLED.gain_crossovers)) == pytest.approx(margins.phase_margins_deg - 180)
    slow = 1e-3  # rad/s, where the hold and 1/(z - 1) are half a period of dead time each
    zero = np.angle((np.exp(1j * slow * H) - 0.98) / (1 + 0.4j * slow))
    assert SAMPLED.phase(slow) == pytest.approx(-np.pi + zero - slow * 2.75 * H, abs=1e-6)


def test_a_loop_and_a_region_draw_themselves():
    drawn = (LOOP.bode_plot(), LOOP.nyquist_plot(), LOOP.nichols_plot(), SAMPLED.bode_plot())
    for figure, x in zip(drawn, ("frequency", "Re", "phase", "frequency"), strict=True):
        figure.draw_without_rendering()
        assert defects(figure) == []
        assert x in figure.axes[-1].get_xlabel()
    assert "P 0, N -2, Z 2".replace("-", "−") in (4 * LOOP).nyquist_plot().axes[-1].get_legend().texts[0].get_text()
    ends = LOOP.bode_plot(np.geomspace(0.2, 5.0, 30)).axes[0].get_xlim()
    assert ends == pytest.approx((0.2, 5.0), rel=0.3)  # with matplotlib's own border
    t, y = LOOP.step_response(3.0)
    assert (t[-1], y[-1]) == (3.0, pytest.approx(LOOP.step_response([3.0]).output[0], rel=1e-9))
    region = stabilizing_pi(LAG, 0.0)
    assert len(region.plot(kp_limit=5, ki_limit=5).axes) == 3
    empty = stabilizing_pi(ct.tf([1], [1, -9]), 0.5)
    refused = ((region, {}, "kp_limit"), (region, {"kp_limit": 5}, "ki_limit"), (empty, {}, "nothing to draw"))
    for one, given, match in refused:
        with pytest.raises(InputError, match=match):
            one.plot(**given)


ONE = gain(1.0)


def rational(num, den) -> Rational:
    return Rational.from_polynomials(num, den)


# An unstable wheel-like loop: pole at +0.82 1/s behind 0.6 s of lag and 0.15 s of dead time, PI with a lead.
WHEEL = Rational([-7.8], [0.82, -8.64], 0.43 / 60.35)
BRAKE = rational([1], [0.6, 1])
PI_LEAD = rational([229.0, 5.0], [1, 0]) * rational([0.6, 1], [0.06, 1])
DEAD_TIME = 0.15

REALISED = {
    "gain": gain(3.0),
    "PI": rational([190.0, 5.0], [1, 0]),
    "double integrator": Rational([], [0.0, 0.0], 2.0),
    "complex poles": rational([3.0], [1, 0.2, 9]),
    "complex poles, one zero": rational([3.0, 5], [1, 0.2, 9]),
    "complex poles, two real zeros": rational([3.0, 5, 1], [1, 0.2, 9]),
    "complex zeros on complex poles": rational([3.0, 0.1, 30], [1, 0.2, 9]),
    "complex zeros, real poles": rational([1, 0.4, 4], [1, 6, 11, 6]),
    "complex zeros, double pole": rational([1, 0.4, 4], [1, 4, 4]),
    "mixed": rational([2, 1, 8, 3], np.polymul([1, 0.2, 9], [1, 3, 2])),
    "wheel": PI_LEAD * BRAKE * WHEEL,
}


@pytest.mark.parametrize("name", REALISED)
def test_realisation_has_the_response_and_the_poles_of_the_factored_form(name):
    system = REALISED[name]
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


@pytest.mark.parametrize(
    ("k", "dead_time", "segments"),
    [(2.0, 1.0, 40), (1.0, 1.0, 200), (1.5, 1.0, 60), (0.5, 0.25, 60), (12.0, 0.125, 60), (32.0, 0.5, 20)],
)
def test_delayed_integrator_equals_the_method_of_steps(k, dead_time, segments):
    """y = sum over n >= 1 with n tau < t of (-1)^(n+1) (K (t - n tau))^n/n!, from y'(t) = K (1 - y(t - tau)) segment by
    segment; in exact arithmetic, as the alternating sum would cancel."""
    tau, steps, expected = Fraction(dead_time), np.arange(0, 8 * segments + 1, 5), []
    for t in (int(step) * tau / 8 for step in steps):  # binary fractions, so that the closed form sees the same ones
        terms = range(1, math.ceil(t / tau))
        expected.append(float(-sum((-Fraction(k) * (t - n * tau)) ** n / math.factorial(n) for n in terms)))
    found = step_response(gain(k), INTEGRATOR, dead_time, time=steps * dead_time / 8)
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
    found = step_response(PI_LEAD, WHEEL, 0.0, actuator=BRAKE, time=t)
    assert found.output == pytest.approx(expected, abs=1e-9)  # lsim's expanded polynomials lose digits


def test_superposition_and_the_impulse_as_an_initial_state():
    t = np.linspace(0, 6, 200)
    options = {"actuator": BRAKE, "time": t}
    heights = {"reference": 2.0, "disturbance": 30.0, "noise": 0.2}
    together = closed_loop_response(PI_LEAD, WHEEL, DEAD_TIME, **heights, **options)
    parts = [closed_loop_response(PI_LEAD, WHEEL, DEAD_TIME, **{one: heights[one]}, **options) for one in heights]
    for name in ("output", "control", "plant_input", "error", "control_rate"):
        total = sum(getattr(part, name) for part in parts)
        assert getattr(together, name) == pytest.approx(total, abs=1e-10 * np.max(np.abs(total)))
    # the response to an impulse of 1 N*m*s is the derivative of the one to a step of 1 N*m
    kick = closed_loop_response(PI_LEAD, WHEEL, DEAD_TIME, initial_plant_state=realise(WHEEL).b, **options)
    h = 1e-5
    loop = (PI_LEAD, WHEEL, DEAD_TIME)
    ahead, behind = (disturbance_response(*loop, actuator=BRAKE, time=t[1:] + s).output for s in (h, -h))
    # central difference: h^2 of the third derivative and rounding over h
    assert (ahead - behind) / (2 * h) == pytest.approx(kick.output[1:], abs=1e-8)
    assert kick.output[0] == pytest.approx(0.43 / 60.35, rel=1e-14)


@pytest.mark.parametrize("dead_time", [1e-3, 0.15, 3.0, 50.0, 1e9])
def test_any_dead_time_and_any_times_give_the_same_curve(dead_time):
    # asked for in one piece or at single points, beyond the dead time or not
    t = np.array([0.0, 0.4, 1.0, 1.0, 2.5])
    whole = step_response(PI_LEAD, WHEEL, dead_time, actuator=BRAKE, time=t).output
    single = [step_response(PI_LEAD, WHEEL, dead_time, actuator=BRAKE, time=[x]).output[0] for x in t]
    assert whole == pytest.approx(single, abs=1e-13)


def test_overshoot_and_settling_time():
    t, y = np.arange(5.0), np.array([0.0, 2.6, 1.8, 2.02, 2.0])
    response = TimeResponse(t, y, y, y, y, y, 0.1, reference=2.0, disturbance=0.0, noise=0.0)
    assert response.overshoot == pytest.approx(0.3)
    assert response.settling_time(2.0, 0.05) == 3.0
    assert response.settling_time(2.0, 5.0) == 0.0
    assert response.settling_time(0.0, 0.05) == math.inf
    assert response.largest_output == 2.6
    assert math.isnan(replace(response, reference=0.0).overshoot)


def wheel(**options):
    return closed_loop_response(PI_LEAD, WHEEL, DEAD_TIME, actuator=BRAKE, **options)


@pytest.mark.parametrize(("make", "message"), [
    (lambda: wheel(), "give either the times or the final time"),
    (lambda: wheel(time=[0, 1], final_time=1.0), "give either the times or the final time"),
    (lambda: wheel(final_time=0.0), "final time: 0 s is not allowed"),
    (lambda: wheel(time=[1.0, 0.5]), "ascending"),
    (lambda: wheel(time=[-1.0]), ">= 0"),
    (lambda: wheel(time=[math.nan]), "finite"),
    (lambda: wheel(final_time=1.0, reference=math.nan), "not all of .* finite"),
    (lambda: wheel(final_time=1.0, initial_plant_state=[1.0]), r"give shape \(2,\)"),
    (lambda: wheel(final_time=1e6), "at most 200000"),
    *((lambda x=x: step_response(ONE, ONE, x, final_time=1.0), "dead time") for x in (-0.1, math.nan, math.inf)),
    (lambda: step_response(gain(-1.0), rational([1, 2], [1, 5]), 0.0, final_time=1.0), "algebraic loop"),
    (lambda: step_response(ONE, Rational([], [20.0], 1.0), 0.1, final_time=100.0), "overflows"),
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
    four = np.array([1 + 0 * p, c * p, p, c]) / (1 + c * p)
    assert np.array([gang.s, gang.t, gang.ps, gang.cs]) == pytest.approx(four, rel=1e-12)
    s = 1j * curve.omega
    expected = PI_LEAD(s) * WHEEL(s) * np.exp(-DEAD_TIME * s)
    assert curve.response == pytest.approx(expected, rel=1e-12)
    assert curve.magnitude_db == pytest.approx(20 * np.log10(np.abs(expected)), abs=1e-10)
    assert np.exp(1j * np.radians(curve.phase_deg)) == pytest.approx(expected / np.abs(expected), abs=1e-10)
    assert np.abs(np.diff(curve.phase_deg)).max() < 2.0  # continuous


# Each figure that a test saves is looked at (conftest.py); here are those that no other test saves.

PI = PIController(PIGains(kp=190.0, ki=5.0))


@pytest.fixture(scope="module")
def groups():
    return published_groups([plant_at("bristle", PARK2008, rail, 100.0).point for rail in rs.Rail])


def defects_of(figure):
    figure.draw_without_rendering()
    return defects(figure)


def test_a_loop_without_gain_is_drawn_without_a_curve(groups):
    plant = plant_at("bristle", PARK2008, rs.Rail.DRY, 100.0)
    zero = controller_group("no gain", (assess(plant, PIController(PIGains(kp=0.0, ki=0.0)), PARK2008.actuator),))
    assert np.all(zero.curves[0].magnitude_db == -np.inf)
    drawn = [draw((zero,)) for draw in (plots.bode_figure, plots.nyquist_figure, plots.nichols_figure)]
    beside, curve = plots.bode_figure((zero, groups[0])), groups[0].curves[0]
    assert not any(map(defects_of, [*drawn, beside]))
    assert np.array_equal(beside.axes[1].lines[0].get_data(), [curve.omega, curve.magnitude_db])


def test_nyquist_shows_minus_one_encirclements_and_closing_arc(groups):
    figure = plots.nyquist_figure(groups)
    critical = [line.get_data() for ax in figure.axes for line in ax.lines if line.get_marker() == "+"]
    assert critical == [([-0.5], [0])] * len(groups) + [([-1], [0])] * len(groups)
    assert "+: −1" in figure.get_supxlabel()
    legend = [t.get_text() for t in figure.axes[len(groups)].get_legend().get_texts()]
    assert legend[0] == "dry, 100 km/h (unstable): P 1, N −1, Z 2"
    arcs = [line for line in figure.axes[0].lines if line.get_linestyle() == ":" and len(line.get_xdata()) == 181]
    # one turn, drawn: the whole curve of the unstable loop winds once clockwise around -1 (at -1/2 in the picture)
    curve, arc = groups[0].curves[0], arcs[-2]
    w = curve.response / (1 + np.abs(curve.response))
    closed = np.concatenate([np.conj(w[::-1]), arc.get_xdata() + 1j * arc.get_ydata(), w])
    turns = np.angle((closed[1:] + 0.5) / (closed[:-1] + 0.5)).sum() / (2 * np.pi)
    assert round(-turns) == 1


def test_sweep_figure_leaves_gaps_where_unstable():
    slow = sweep_speed({"PI": PI}, [5.0, 10.0, 40.0, 100.0], law="curve")
    assert np.isnan(slow.margins["PI"].ms[[0, -1]]).tolist() == [True, False]
    figure = plots.sweep_figure([slow, sweep_slip({"PI": PI}, [0.05, 0.1, 0.13])], title="sweeps")
    assert np.isnan(figure.axes[0].lines[0].get_ydata()[0])


def test_the_contours_of_gains_are_where_their_levels_are():
    kp, ki = np.geomspace(100.0, 800.0, 5), np.geomspace(1.0, 90.0, 7)
    ms, region = 1.2 + 0.01 * kp[:, None] + 0.002 * ki**2, stabilizing_pi(LAG, 0.1)
    record = RegularGridInterpolator((kp, ki), 1 / ms)
    drawn = designs._gains(GainMap(kp, ki, ms, (200.0, 4.0), 9), "car").axes[0]
    for ax, value in (
        (drawn, lambda *gains: record(gains)),
        (region.plot(kp_limit=5, ki_limit=30).axes[1], lambda *gains: region.loops(*gains)[0].margins().phase_deg),
    ):
        (lines,) = (one for one in ax.collections if isinstance(one, ContourSet) and not one.filled)
        assert len(lines.levels) > 2
        for level, path in zip(lines.levels, lines.get_paths(), strict=True):
            place = path.vertices[len(path.vertices) // 2]
            assert value(*place) == pytest.approx(level, rel=0.1)  # drawn as if linear in a cell


def test_the_map_of_a_judgement_has_the_worst_of_its_cases_where_the_labels_of_speed_and_load_are():
    lead = PIController(PIGains(kp=229.4, ki=5.0), lead=0.6, lead_filter=0.06)
    judged = rs.judge(rs.Envelope(speeds=(20.0, 100.0)), lead)
    points, axes, unstable = judged.points, judged.map.plot().axes, []
    for ax, speed, load in itertools.product(axes, (20.0, 100.0), ("empty", "loaded")):
        there = (points.speed_kmh == speed) & (points.load == load) & (points.operating | (ax is axes[1]))
        rows, columns = ([t.get_text() for t in labels] for labels in (ax.get_yticklabels(), ax.get_xticklabels()))
        worst = judged.run_ms[there].max()
        x, y = ax.get_xticks()[columns.index(load)], ax.get_yticks()[rows.index(f"{speed:g}")]
        event = SimpleNamespace(**dict(zip("xy", ax.transData.transform((x, y)), strict=True)))
        assert ax.images[0].get_cursor_data(event) == min(worst, designs._MS_TOP)
        (number,) = (text.get_text() for text in ax.texts if text.get_position() == (x, y))
        unstable.append(number == "unst.")
        assert math.isinf(worst) if unstable[-1] else 0 <= float(number) - worst < 0.0101 * max(1.0, worst / 10)
    assert (any(unstable[:4]), any(unstable[4:])) == (False, True)


def test_panels_that_nothing_is_drawn_in_are_not_seen():
    figure, axes = style.grid_of(3, 2, "title", (0.5, 2.0))
    assert ([ax.get_visible() for ax in figure.axes], len(axes)) == ([True, True, True, False], 3)


def test_a_command_that_begins_far_above_the_rest_is_cut_off_and_says_so():
    plant, lag = Rational([], [-0.2], 2.0), Rational([], [-1.0], 1.0)
    for lead, highest in (((0.0, 0.0), 0.5), ((1.0, 0.02), 25.0)):  # kp, and kp times 1/0.02
        c = PIController(PIGains(kp=0.5, ki=0.1), *lead).transfer_function
        steps = {"PI": step_response(c, plant, 0.1, final_time=30.0, actuator=lag)}
        figure = plots.response_figure(steps, steps, title="r", reference_label="a", load_label="b")
        assert steps["PI"].control[0] == pytest.approx(highest, rel=1e-6)
        told = [text.get_text() for text in figure.axes[2].texts]
        assert told == ["cut off: down to 0.0526 N·m and up to 25 N·m"] * (highest > 1)
        top = figure.axes[2].get_ylim()[1]
        assert top < 2.0 if told else top > steps["PI"].control.max()
        assert defects_of(figure) == []


def test_the_same_figure_gives_the_same_file():
    def drawn(form):
        return figure_bytes(LOOP.bode_plot(), form)

    assert all(drawn(form) == drawn(form) for form in ("png", "svg"))
