"""What the sensors of a brake rig make of torque and speed: an incremental encoder and a torque sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from railslip_ctrl.core.errors import InputError

Floats = NDArray[np.float64]


def require(name: str, value: float, unit: str, *, zero_allowed: bool = False) -> None:
    """InputError where a number is not finite, negative, or 0 though that is not allowed."""
    if not (math.isfinite(value) and (value > 0 or (zero_allowed and value == 0))):
        bound = ">= 0" if zero_allowed else "> 0"
        raise InputError(f"{name}: {value:g} is not allowed; give a finite value {bound} ({unit})")


@dataclass(frozen=True)
class Encoder:
    """An incremental encoder; the speed is the difference of two counts over the interval between them.

    That speed is the mean over the interval, so half an interval late. The error of each angle is taken to be
    uniform over one count and independent of the others, which holds while many counts pass in an interval.

    Parameters
    ----------
    counts : int
        Counts a turn, >= 1, every edge used: 4 times the lines of an encoder with two tracks.

    Raises
    ------
    InputError
        Fewer.
    """

    counts: int

    def __post_init__(self) -> None:
        if self.counts < 1:
            raise InputError(f"counts: {self.counts} is not allowed; give a value >= 1 (counts a turn)")

    @property
    def angle_step(self) -> float:
        """One count, rad."""
        return 2 * math.pi / self.counts

    @property
    def angle_variance(self) -> float:
        """Of the rounding of one angle, rad^2: a count squared over 12."""
        return self.angle_step**2 / 12

    def speed_step(self, interval: float) -> float:
        """The smallest change of speed that is seen at an interval in s, rad/s."""
        return self.angle_step / interval

    def speed_variance(self, interval: float) -> float:
        """Of the speed at an interval in s, (rad/s)^2: two angles a difference. Neighbours are not independent."""
        return 2 * self.angle_variance / interval**2

    def speed(self, time: ArrayLike, angle: ArrayLike) -> Floats:
        """Measured speed (rad/s) at all times but the first, so k - 1 values.

        `time` in s and true `angle` in rad are arrays of one length k, 1-D.
        """
        counted = np.floor(np.asarray(angle, dtype=float) / self.angle_step)
        return np.asarray(np.diff(counted) * self.angle_step / np.diff(np.asarray(time, dtype=float)))


@dataclass(frozen=True)
class TorqueSensor:
    """White noise on every sample, then rounding.

    Parameters
    ----------
    noise : float
        Standard deviation of a sample, N*m, >= 0: electronics, and the ripple that is not torque on the wheel.
    resolution : float
        Step of the digits, N*m, >= 0.

    Raises
    ------
    InputError
        A number out of range.
    """

    noise: float
    resolution: float = 0.0

    def __post_init__(self) -> None:
        require("noise", self.noise, "N*m", zero_allowed=True)
        require("resolution", self.resolution, "N*m", zero_allowed=True)

    @property
    def variance(self) -> float:
        """Of one sample, (N*m)^2."""
        return self.noise**2 + self.resolution**2 / 12

    def measured(self, torque: ArrayLike, generator: np.random.Generator) -> Floats:
        """Measured torque (N*m) of the true `torque` (N*m), of any shape, with noise from a `generator`."""
        true = np.asarray(torque, dtype=float)
        noisy = true + self.noise * generator.standard_normal(true.shape)
        return np.asarray(np.round(noisy / self.resolution) * self.resolution if self.resolution else noisy)
