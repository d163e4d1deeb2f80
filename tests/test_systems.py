"""Systems as the ecosystem writes them, wherever a function takes one."""

import control as ct
import numpy as np
import pytest
from figure_checks import defects
from scipy import signal

from railslip_ctrl import DeadTimeLoop, InputError, Rational, stabilizing_pi, tune_pi
from railslip_ctrl.design.compensators import filtered_smith_predictor, observer_compensator, smith_predictor
from railslip_ctrl.design.limits import control_effort, fundamental_limits
from railslip_ctrl.design.tuning import first_order_model, pi_for_crossover, simc_pi
from railslip_ctrl.loop.responses import closed_loop_response, disturbance_response, step_response
from railslip_ctrl.loop.sampled import SampledLoop

NUM, DEN = [1.5, 6.0], [2.0, 9.0, 10.0]  # zero -4, poles -2 and -2.5
SYSTEMS = {
    "control.tf": lambda: ct.tf(NUM, DEN),
    "control.ss": lambda: ct.ss(ct.tf(NUM, DEN)),
    "control.zpk": lambda: ct.zpk([-4], [-2, -2.5], 0.75),
    "scipy.lti": lambda: signal.lti(NUM, DEN),
    "scipy.StateSpace": lambda: signal.StateSpace([[-4.5, -5], [1, 0]], [[1], [0]], [[0.75, 3]], [[0]]),
    "scipy.ZerosPolesGain": lambda: signal.ZerosPolesGain([-4], [-2, -2.5], 0.75),
}
SAME = Rational(np.array([-4.0]), np.array([-2.0, -2.5]), 0.75)
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
        with pytest.raises(AttributeError, match=r"bode_plot and its like loop\.frequency_response\(omega\)"):
            plot(LOOP)
    assert not hasattr(LOOP, "dt")  # by which a system is known


H, FINE = 0.2, 20
CONTROLLER = ct.tf([0.15, -0.147], [1, -1], H)
SAMPLED = SampledLoop(CONTROLLER, PLANT, 1.75 * H, H)


def finely_sampled() -> tuple[np.ndarray, np.ndarray]:
    """Time and output of the closed loop of SAMPLED, the plant advanced by python-control in steps of H/FINE."""
    plant = ct.c2d(ct.ss(PLANT), H / FINE)
    x, past, command, y = np.zeros(2), [0.0] * (FINE * 7 // 4), 0.0, []
    errors = [0.0]
    for k in range(12 * FINE):
        y.append(float((plant.C @ x)[0]))
        if k % FINE == 0:
            errors.append(1 - y[-1])
            command += 0.15 * errors[-1] - 0.147 * errors[-2]  # u[k] = u[k-1] + 0.15 e[k] - 0.147 e[k-1]
        past.append(command)
        x = plant.A @ x + plant.B[:, 0] * past.pop(0)
    return np.arange(12 * FINE) * H / FINE, np.array(y)


def test_a_sampled_loop_answers_a_step_between_its_samples_too():
    time, expected = finely_sampled()
    found = SAMPLED.step_response(time)
    assert found.output == pytest.approx(expected, abs=1e-12)  # rounding of 240 steps
    assert found.error == pytest.approx(1 - expected, abs=1e-12)
    assert found.control[: 2 * FINE] == pytest.approx([0.15] * FINE + [0.153] * FINE)
    late = 7 * FINE // 4
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
    for loop in (LOOP, SAMPLED):
        for divisor in (0, "C", None):
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
    kinds = (("bode_plot", "frequency"), ("nyquist_plot", "Re"), ("nichols_plot", "phase"))
    for loop, (draw, x) in [*zip((LOOP,) * 3, kinds, strict=True), (SAMPLED, kinds[0])]:
        figure = getattr(loop, draw)()
        figure.draw_without_rendering()
        assert defects(figure) == []
        assert x in figure.axes[-1].get_xlabel()
    assert "P 0, N -2, Z 2".replace("-", "−") in (4 * LOOP).nyquist_plot().axes[-1].get_legend().texts[0].get_text()
    ends = LOOP.bode_plot(np.geomspace(0.2, 5.0, 30)).axes[0].get_xlim()
    assert ends == pytest.approx((0.2, 5.0), rel=0.3)  # with matplotlib's own border
    t, y = LOOP.step_response(3.0)
    assert (t[-1], y[-1]) == (3.0, pytest.approx(LOOP.step_response([3.0]).output[0], rel=1e-9))
    region = stabilizing_pi(LAG, 0.0)
    with pytest.raises(InputError, match="kp_limit"):
        region.plot()
    with pytest.raises(InputError, match="ki_limit"):
        region.plot(kp_limit=5)
    assert len(region.plot(kp_limit=5, ki_limit=5).axes) == 3
    with pytest.raises(InputError, match="nothing to draw"):
        stabilizing_pi(ct.tf([1], [1, -9]), 0.5).plot()
