"""Makes a controller for braking runs from any linear system."""

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

SURE_SHARE = 0.8  #: initial torque over the brake torque at the least adhesion; 20 % is a margin for the random force


def linear_control(system: Any, **fields: Any) -> LinearControl:
    """Convert a linear system to a controller: `PI` or a class derived from it, `TransferFunction` or `StateSpace`.

    `fields` are further fields of the controller, for example `rule` (by default Tustin's) and `period`, s (by default
    from `run_period`). InputError if `system` is not linear.
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
    """Convert a linear system to a controller whose torque is limited to the range from 0 to the full brake.

    The initial torque is `SURE_SHARE` times the smallest brake torque at the operating points `points`. Below
    `hand_over_kmh`, km/h, the controller commands this torque without slip control.
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
