"""What the sampled observers share: the checks of their input, and what a run gives back."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.model.vehicle import Vehicle

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
State = TypeVar("State")


@dataclass(frozen=True)
class Estimates(Generic[State]):
    """The estimate after each sample, and the state from which the next rows go on.

    Attributes
    ----------
    adhesion_torque : array, (k,)
        Ta_hat, N*m.
    state : FilterState or KalmanState
        After the last row.
    """

    adhesion_torque: Floats
    state: State


def adhesion_coefficient(adhesion_torque: ArrayLike, vehicle: Vehicle) -> NDArray[np.float64] | np.float64:
    """mu_hat = Ta_hat/(N r), with the wheel load and radius of the `vehicle`. [Park2008] (29).

    Parameters
    ----------
    adhesion_torque : array of any shape
        Ta_hat, N*m.
    vehicle : Vehicle
    """
    return np.asarray(np.asarray(adhesion_torque, dtype=float) / (vehicle.wheel_load * vehicle.wheel.radius))[()]


def checked_samples(
    time: ArrayLike, torque: ArrayLike, omega: ArrayLike, *, after: float | None
) -> tuple[Floats, Floats, Floats]:
    """The three columns as arrays of one length; times must grow, and begin after `after` (s) if it is given.

    InputError names the first row, counted from 0, that is refused.
    """
    columns = {
        "time": np.asarray(time, dtype=float),
        "torque": np.asarray(torque, dtype=float),
        "omega": np.asarray(omega, dtype=float),
    }
    t = columns["time"]
    for name, values in columns.items():
        if values.ndim != 1 or values.shape != t.shape:
            raise InputError(f"{name}: shape {values.shape} is not allowed; give one value a row, as many as times")
        if not np.isfinite(values).all():
            row = int(np.argmin(np.isfinite(values)))
            raise InputError(f"{name}: {values[row]} in row {row} is not allowed; give finite values")
    if t.size == 0:
        raise InputError("time: no rows; give at least one sample")
    if after is not None and not t[0] > after:
        raise InputError(f"time: {t[0]:g} in row 0 is not after {after:g}, the last sample; give growing times (s)")
    growing = np.diff(t) > 0
    if not growing.all():
        row = int(np.argmin(growing)) + 1
        raise InputError(f"time: {t[row]:.9g} in row {row} is not after {t[row - 1]:.9g}; give growing times (s)")
    return t, columns["torque"], columns["omega"]


def checked_step(time: float, torque: float, omega: float, *, after: float) -> float:
    """The interval from the last sample, s; InputError where it is not positive or a value is not finite."""
    if not (math.isfinite(time) and time > after):
        raise InputError(f"time: {time:.9g} is not after {after:.9g}, the last sample; give growing times (s)")
    for name, value in (("torque", torque), ("omega", omega)):
        if not math.isfinite(value):
            raise InputError(f"{name}: {value} at {time:.9g} s is not allowed; give finite values")
    return time - after


def require(name: str, value: float, unit: str, *, zero_allowed: bool = False) -> None:
    """InputError where a number is not finite, negative, or 0 though that is not allowed."""
    if not (math.isfinite(value) and (value > 0 or (zero_allowed and value == 0))):
        bound = ">= 0" if zero_allowed else "> 0"
        raise InputError(f"{name}: {value:g} is not allowed; give a finite value {bound} ({unit})")
