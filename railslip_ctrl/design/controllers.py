"""Controllers as transfer functions, and the loop they close around the wheel.

The loop transfer function is L(s) = C(s) Ga(s) P(s): C from the slip-velocity error e = lambda_d v - sigma to the
commanded brake torque, Ga the brake actuator with its dead time, P from acting torque to -e. More torque gives
more slip, so that P > 0 and the feedback is negative.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from railslip_ctrl.arguments import check_fields, checked, number
from railslip_ctrl.errors import InputError
from railslip_ctrl.linearization import LinearPlant
from railslip_ctrl.loop import DeadTimeLoop, Rational
from railslip_ctrl.parameters import Actuator, PIGains


@dataclass(frozen=True)
class PIController:
    """C(s) = (kp + ki/s) (lead s + 1)/(lead_filter s + 1).

    Parameters
    ----------
    gains : PIGains
        kp in N*m/(m/s), ki in N*m/m.
    lead : float
        Time constant of the lead (lead s + 1), s, >= 0; 0: none. It adds phase: one equal to the actuator's lag cancels
        that.
    lead_filter : float
        Time constant of the lag (lead_filter s + 1) that bounds the lead's gain at high frequency, s, >= 0; > 0 with a
        lead, or C is not proper. Without a lead it filters the error.

    Raises
    ------
    InputError
        A field of another kind, a negative or non-finite time constant, or a lead without a filter.
    """

    gains: PIGains
    lead: float = 0.0
    lead_filter: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self)
        number("lead", self.lead, "s", ge=0)
        number("lead filter", self.lead_filter, "s", ge=0)
        if self.lead > 0 and self.lead_filter == 0:
            raise InputError(f"lead filter: 0 s with a lead of {self.lead:g} s is not proper; give a value > 0")

    @property
    def structure(self) -> str:
        """ "PI" or "PI-lead"."""
        return "PI-lead" if self.lead > 0 or self.lead_filter > 0 else "PI"

    @property
    def transfer_function(self) -> Rational:
        """C(s) in factored form."""
        kp, ki = self.gains.kp, self.gains.ki
        if ki == 0:
            pi = Rational(np.array([]), np.array([]), kp)
        elif kp == 0:
            pi = Rational(np.array([]), np.array([0.0]), ki)
        else:
            pi = Rational(np.array([-ki / kp]), np.array([0.0]), kp)
        return pi * _first_order(self.lead, self.lead_filter)


def _first_order(lead: float, lag: float) -> Rational:
    """(lead s + 1)/(lag s + 1)."""
    zeros = np.array([-1 / lead]) if lead > 0 else np.array([])
    poles = np.array([-1 / lag]) if lag > 0 else np.array([])
    return Rational(zeros, poles, (lead or 1.0) / (lag or 1.0))


@checked
def actuated_plant(plant: LinearPlant, actuator: Actuator) -> Rational:
    """From commanded torque (N*m) to -e (m/s) without the dead time: lag of the `actuator` and wheel of the `plant`."""
    if plant.speed_state:
        wheel = Rational.from_state_space(plant.A, plant.B, -plant.C[plant.outputs.index("error")], 0.0)
    else:
        wheel = Rational(plant.zeros, plant.poles, plant.gain)  # with v frozen -e is sigma
    return _first_order(0.0, actuator.lag) * wheel


@checked
def wheel_slip_loop(plant: LinearPlant, controller: PIController, actuator: Actuator) -> DeadTimeLoop:
    """L(s) = C(s) Ga(s) P(s), the dead time exact.

    Parameters
    ----------
    plant : LinearPlant
        P, from torque at the wheel (N*m) to -e (m/s); with the speed frozen that is sigma.
    controller : PIController
        C, N*m/(m/s).
    actuator : Actuator
        Ga, dead time and lag, s. [Park2008] p. 55.

    Returns
    -------
    DeadTimeLoop
        L, dimensionless, SISO, closed by unity negative feedback.

    Raises
    ------
    InputError
        An argument of another kind.
    """
    return DeadTimeLoop(controller.transfer_function * actuated_plant(plant, actuator), actuator.dead_time)
