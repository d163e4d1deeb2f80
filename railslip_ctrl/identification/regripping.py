"""A wheel that regrips: the brake is released past the peak, and the slip falls back to none within tenths of a second.

The curve over slip is that of a slip that grows, as in [Park2008] Fig. 13. On the way back the slip runs through most
of it within few time constants of the observer, whose torque is then a mean over half the curve.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .low_pass import LowPass

Floats = NDArray[np.float64]

_RELEASED = 0.1  # of the torque, that it falls by in a time constant: no brake is eased so fast while the wheel holds


class Regripping:
    """Which rows are of a wheel that regrips: from where the slip falls under a torque that is let go, while it falls.

    Torque and slip are smoothed by the observer's time constant, s, twice: a value that is below its own mean falls.
    """

    def __init__(self, tau: float) -> None:
        self._once, self._twice = LowPass(tau), LowPass(tau)
        self._regrips = False

    def add(self, time: Floats, slip: Floats, torque: Floats) -> NDArray[np.bool_]:
        """Whether the wheel regrips in the next rows: times in s, slip ratios and brake torques in N*m as logged."""
        now = self._once.run(time, np.stack([slip, torque]))
        fallen = self._twice.run(time, now) - now
        falls = fallen[0] > 0.0
        released = falls & (fallen[1] > _RELEASED * np.maximum(now[1], 0.0))
        index = np.arange(len(time))
        last_released = np.maximum.accumulate(np.where(released, index, -1 if self._regrips else -2))
        last_held = np.maximum.accumulate(np.where(falls, -2, index))
        regrips: NDArray[np.bool_] = last_released > last_held
        self._regrips = bool(regrips[-1])
        return regrips
