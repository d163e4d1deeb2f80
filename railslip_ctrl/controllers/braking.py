"""Make a controller that brakes of any linear system."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion import ReferenceSlip
from railslip_ctrl.model.linearization import OperatingPoint

from .linear import TRACKING_TIME, LinearControl, StateSpace, TransferFunction, full_brake_torque
from .pi import pi_control
from .sampled import Rule, run_period
from .systems import PolynomialController, StateSpaceController, linear_controller

SURE_SHARE = 0.8
"""Start and hand-over torque of a linear controller, relative to the brake torque at the point of least adhesion.

The rest is reserve for the random force.
"""


def linear_control(system: Any, **fields: Any) -> LinearControl:
    """Return the controller of a linear system: a PI, transfer function or state space.

    It is sampled every 10 ms or at its own period, by Tustin's rule, unless `fields` set them. InputError if it is not
    a linear system.
    """
    design = linear_controller(system)
    kind = fields.pop("kind", None)
    fields = {"period": run_period(design), "rule": Rule.TUSTIN, **fields}
    if isinstance(design, PolynomialController):
        return TransferFunction(num=design.num, den=design.den, discrete=design.period is not None, **fields)
    if isinstance(design, StateSpaceController):
        matrices = {"A": design.a, "B": design.b, "C": design.c, "D": design.d}
        return StateSpace(**matrices, discrete=design.period is not None, **fields)
    return pi_control(design, kind, **fields)


def braking_control(
    system: Any,
    points: Sequence[OperatingPoint],
    reference: ReferenceSlip | None,
    *,
    name: str,
    hand_over_kmh: float = 0.0,
    period: float | None = None,
    **fields: Any,
) -> LinearControl:
    """Return the controller of a linear system for some operating points, by Tustin's rule, within 0 and full brake.

    It starts with `SURE_SHARE` of the torque at the point of least adhesion, and holds that torque below a speed (km/h;
    0: never).
    """
    sure = SURE_SHARE * min(point.brake_torque for point in points)
    vehicle = points[0].vehicle
    return linear_control(
        system,
        reference=reference,
        name=name,
        period=run_period(linear_controller(system), period),
        radius=vehicle.wheel.radius,
        torque_min=0.0,
        torque_max=full_brake_torque(vehicle),
        tracking_time=TRACKING_TIME,
        initial_torque=sure,
        hand_over_speed=hand_over_kmh * KMH,
        hand_over_torque=sure if hand_over_kmh else 0.0,
        **fields,
    )
