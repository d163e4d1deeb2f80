"""One braking of a log over time, as a picture shows it: speeds, torques, slip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.model.vehicle import Vehicle

from .observer.filters import FilterObserver, Form
from .record import Record

Floats = NDArray[np.float64]

_SETTLED = 5.0  # time constants, after which the observer's unknown start is below 1 %


@dataclass(frozen=True)
class Course:
    """A run under brake, arrays of one length.

    Attributes
    ----------
    time : s, from the brake's application.
    train_speed, wheel_speed : m/s; the wheel's is that of its circumference.
    brake_torque, adhesion_torque : N*m
        As logged, and as observed with every term filtered; NaN while the observer settles.
    slip : ratio.
    """

    time: Floats
    train_speed: Floats
    wheel_speed: Floats
    brake_torque: Floats
    adhesion_torque: Floats
    slip: Floats


def course_of(record: Record, vehicle: Vehicle, time_constant: float) -> Course | None:
    """The longest run of a record, observed with tau in s; None for an empty record."""
    if not len(record):
        return None
    runs, counts = np.unique(record.run, return_counts=True)
    at = record.run == runs[np.argmax(counts)]
    time, speed, omega, torque = (x[at] for x in (record.time, record.speed, record.omega, record.torque))
    observed = FilterObserver.of(vehicle, time_constant, Form.CORRECTED).run(time, torque, omega).adhesion_torque
    settled = time - time[0] >= _SETTLED * time_constant
    rim = vehicle.wheel.radius * omega
    return Course(time - time[0], speed, rim, torque, np.where(settled, observed, np.nan), 1.0 - rim / speed)
