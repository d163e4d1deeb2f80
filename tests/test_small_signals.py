"""The linear loop against the nonlinear plant for small signals: an integration that shares nothing but the plant."""

from __future__ import annotations

import numpy as np
import pytest

from railslip_ctrl.design import PIController
from railslip_ctrl.loop import Rational
from railslip_ctrl.loop.responses import disturbance_response, step_response
from railslip_ctrl.model.adhesion import published_law
from railslip_ctrl.model.linearization import linearize, operating_point
from railslip_ctrl.model.numeric import numeric_plant, plant_parameters
from railslip_ctrl.model.vehicle import PARK2008, PIGains, Rail

SPEED = 100 / 3.6
STEP = 1e-3  # s; the dead time is 150 steps
FINAL = 6.0
SMALL = 1e-5  # m/s of reference, against a slip velocity of 3.7 m/s: its square is below every tolerance here


def nonlinear_response(controller: PIController, *, reference: float, load: float):
    """Speed frozen, bristle law, Heun steps with the dead-time buffer exact; deviations of sigma, m/s."""
    law = published_law("bristle", Rail.DRY)
    point = operating_point(law, PARK2008, SPEED, 0.132)
    rates, p = numeric_plant(type(law)).rates, plant_parameters(law, PARK2008)
    lag, delay = PARK2008.actuator.lag, round(PARK2008.actuator.dead_time / STEP)
    gains, lead, lead_filter = controller.gains, controller.lead, controller.lead_filter
    trim = np.array([point.sigma, point.adhesion_state, point.brake_torque, 0.0, 0.0])
    # with the speed frozen the point of constant slip drifts at sigma' = lambda v'; the deviation is measured from it
    drift = float(rates(SPEED, point.sigma, point.adhesion_state, point.brake_torque, 0.0, 0.0, p)[1])
    buffer = [0.0] * (delay + 1)

    def command(x):
        error = reference - (x[0] - point.sigma)
        if lead_filter == 0:
            return gains.kp * error + x[3]
        return gains.kp * (x[4] + (error - x[4]) * lead / lead_filter) + x[3]

    def slope(x, delayed):
        error = reference - (x[0] - point.sigma)
        filtered = error if lead_filter == 0 else x[4] + (error - x[4]) * lead / lead_filter
        sigma, z, torque = x[0], x[1], x[2]
        _, sigma_rate, z_rate = (float(q) for q in rates(SPEED, sigma, z, torque + load, 0.0, 0.0, p))
        lagged = (point.brake_torque + delayed - torque) / lag
        filter_rate = 0.0 if lead_filter == 0 else (error - x[4]) / lead_filter
        return np.array([sigma_rate - drift, z_rate, lagged, gains.ki * filtered, filter_rate])

    x, out = trim.copy(), [0.0]
    for _ in range(round(FINAL / STEP)):
        buffer.append(command(x))
        before, after = buffer[-delay - 1], buffer[-delay]
        first = slope(x, before)
        x = x + 0.5 * STEP * (first + slope(x + STEP * first, after))
        out.append(x[0] - point.sigma)
    return np.arange(len(out)) * STEP, np.array(out)


@pytest.mark.parametrize(
    "controller",
    [PIController(PIGains(kp=190.0, ki=5.0)), PIController(PIGains(kp=229.4, ki=5.0), lead=0.6, lead_filter=0.06)],
    ids=["PI", "PI-lead"],
)
@pytest.mark.parametrize("kind", ["reference", "load"])
def test_step_responses_equal_a_nonlinear_simulation_of_small_steps(controller, kind):
    plant = linearize(operating_point(published_law("bristle", Rail.DRY), PARK2008, SPEED, 0.132))
    wheel = Rational(plant.zeros, plant.poles, plant.gain)
    lag = Rational(np.array([]), np.array([-1 / 0.6]), 1 / 0.6)
    load = 1e-3  # N*m
    time, simulated = nonlinear_response(
        controller, reference=SMALL if kind == "reference" else 0.0, load=load if kind == "load" else 0.0
    )
    respond, height = (step_response, SMALL) if kind == "reference" else (disturbance_response, load)
    linear = respond(controller.transfer_function, wheel, 0.15, time=time, actuator=lag, height=height)
    # Heun at 1 ms with a filter of 60 ms: (h/T)^2 ~ 3e-4 of the response's size, and first order at its jumps
    assert np.abs(simulated - linear.output).max() < 3e-3 * np.abs(linear.output).max()
