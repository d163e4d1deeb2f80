"""Scenarios and controllers that the tests of the simulation share, and a start from any state."""

import math

import numpy as np

from railslip_ctrl import PIController, ReferenceSlip
from railslip_ctrl.model.adhesion.curve import Curve
from railslip_ctrl.model.vehicle import PARK2008, TABLE4_PI, Actuator, PIGains, Resistance, Vehicle
from railslip_ctrl.simulation import BrakeLimits, LinearControl, Scenario, Simulator, TorqueProfile
from railslip_ctrl.simulation import kernel as layout

REFERENCE = ReferenceSlip(dry=0.132, wet=0.092)
PLAIN = {"period": None, "rule": "backward", "tracking_time": math.inf}
NO_LIMITS = BrakeLimits(torque_min=-1e9)
NO_ADHESION = Curve(alpha=1e-20, beta=0.0475, gamma=41.5, v0=100 / 3.6, reference=REFERENCE)
"""A curve that never builds up a force: below 1e-16 N."""


def published_pi() -> LinearControl:
    return LinearControl(PIController(TABLE4_PI["bristle"]), REFERENCE, **PLAIN)


def pi(kp: float, ki: float = 0.0, *, slip: float = 0.132, **fields: object) -> LinearControl:
    return LinearControl(PIController(PIGains(kp=kp, ki=ki)), ReferenceSlip(dry=slip, wet=slip), **{**PLAIN, **fields})


def constant_torque(torque: float, **fields: object) -> TorqueProfile:
    return TorqueProfile((0.0,), (torque,), REFERENCE, **fields)


def bare_vehicle(*, dead_time: float = 0.0, lag: float = 0.0, viscous: float = 0.0, **fields: object) -> Vehicle:
    """The published wheel and mass without travelling resistance, with an actuator of choice."""
    wheel = PARK2008.wheel.model_copy(update={"viscous_friction": viscous})
    actuator = Actuator(dead_time=dead_time, lag=lag)
    return PARK2008.model_copy(update={"wheel": wheel, "resistance": Resistance(), "actuator": actuator, **fields})


def scenario(vehicle: Vehicle, **fields: object) -> Scenario:
    """From 30 m/s, without adhesion unless one is given, and without limits on the command."""
    given = {"adhesion": NO_ADHESION, "initial_speed": 30.0, "limits": NO_LIMITS, **fields}
    return Scenario(name="test", vehicle=vehicle, **given)


def run_from(simulator: Simulator, state: dict[int, float], memory: tuple[float, ...], *, every: int) -> np.ndarray:
    """The log of a run without noise that starts from a state of the plant (by index) and of the controller.

    The command before the start is the torque that acts at it, as at an operating point.
    """
    plan, kernel = simulator._plan, simulator._kernel
    y, summary = np.zeros(layout.STATES), np.empty(layout.SUMMARY)
    y[list(state)] = list(state.values())
    log = np.empty((plan.samples // every + 2, layout.COLUMNS + len(memory)))
    _, written = kernel.run(
        kernel.Settings(**plan.settings), kernel.Events(*plan.events), np.zeros(1), np.zeros((0, 2)), plan.p.copy(),
        plan.c.copy(), plan.chosen.copy(), plan.tables, plan.limits, y, np.array(memory), log, every, summary,
    )  # fmt: skip
    return log[:written]
