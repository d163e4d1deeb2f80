"""Systems as the ecosystem writes them, wherever a function takes one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import control as ct
import numpy as np
import pytest
from scipy import signal

from railslip_ctrl import DeadTimeLoop, InputError, stabilizing_pi, tune_pi
from railslip_ctrl.design.compensators import filtered_smith_predictor, observer_compensator, smith_predictor
from railslip_ctrl.design.effort import control_effort
from railslip_ctrl.design.limits import fundamental_limits
from railslip_ctrl.design.rules import first_order_model, simc_pi
from railslip_ctrl.design.tuning import pi_for_crossover
from railslip_ctrl.loop import Rational
from railslip_ctrl.loop.responses import closed_loop_response, disturbance_response, step_response

NUM, DEN = [1.5, 6.0], [2.0, 9.0, 10.0]  # zero -4, poles -2 and -2.5
SYSTEMS: dict[str, Callable[[], Any]] = {
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

CALLS: dict[str, Callable[[Any], Any]] = {
    "loop": lambda x: DeadTimeLoop(x, 0.1).frequency_response(S.imag),
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
    "plant of observer_compensator": lambda x: observer_compensator(
        x, 0.1, feedback_poles=[-2, -3, -4], observer_poles=[-5, -6]
    ).loop(S),
    "plant of control_effort": lambda x: control_effort(ct.tf([2], [1]), x, 0.1, lag=0.3).noise_gain,
    "controller of control_effort": lambda x: control_effort(x, LAG, 0.1, lag=0.3).noise_gain,
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_a_system_of_any_library_is_its_zeros_and_poles(name: str) -> None:
    # a polynomial of order 2 loses a digit or two
    assert Rational.from_control(SYSTEMS[name]())(S) == pytest.approx(SAME(S), rel=1e-12)


@pytest.mark.parametrize("call", CALLS)
def test_what_takes_a_system_takes_those_of_both_libraries(call: str) -> None:
    expected = np.asarray(CALLS[call](SAME))
    for name in ("control.tf", "scipy.StateSpace"):
        # searches stop at 1e-9
        assert np.asarray(CALLS[call](SYSTEMS[name]())) == pytest.approx(expected, rel=1e-7), name


@pytest.mark.parametrize("call", CALLS)
def test_what_takes_a_system_refuses_a_discrete_one_by_its_name(call: str) -> None:
    with pytest.raises(InputError, match=rf"^{call.split()[0]}: a discrete-time system \(dt = 0.1\)"):
        CALLS[call](signal.dlti(NUM, DEN, dt=0.1))


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: signal.StateSpace(-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2))), "not SISO"),
        (lambda: signal.lti([1, 2, 3], [1, 2]), "not proper"),
        (lambda: signal.ZerosPolesGain([], [-1 + 1j], 1), "without their conjugates"),
        (lambda: ct.frd([1, 2, 3], [1, 2, 3]), "not a linear system"),
    ],
)
def test_what_is_no_such_system_is_refused(make: Callable[[], Any], match: str) -> None:
    with pytest.raises(InputError, match=match):
        DeadTimeLoop(make())


def test_states_of_a_plant_are_those_of_its_realisation() -> None:
    with pytest.raises(InputError, match=r"^initial plant state: .* a Rational"):
        closed_loop_response(2.0, SYSTEMS["control.ss"](), 0.1, time=TIMES, initial_plant_state=[1.0, 0.0])
