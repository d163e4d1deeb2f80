"""Sampled frequency responses of a loop, as records for plotting."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .deadtime import DeadTimeLoop

_POINTS = 4000  # a smooth line in print, the turns of the dead time included


@dataclass(frozen=True)
class FrequencyCurve:
    """L(j omega) on a grid: omega in rad/s, complex response, and its continuous phase in deg."""

    omega: NDArray[np.float64]
    response: NDArray[np.complex128]
    phase_deg: NDArray[np.float64]

    @property
    def magnitude_db(self) -> NDArray[np.float64]:
        """20 log10 |L|, dB."""
        return np.asarray(20 * np.log10(np.abs(self.response)))


def frequency_curve(loop: DeadTimeLoop, low: float, high: float) -> FrequencyCurve:
    """Sample a loop between two frequencies, rad/s, the dead time exact; its crossovers are among the points."""
    crossovers = loop.gain_crossovers
    inside = crossovers[(crossovers > low) & (crossovers < high)]
    omega = np.union1d(np.geomspace(low, high, _POINTS), inside)
    return FrequencyCurve(omega, loop.frequency_response(omega), np.degrees(loop.phase(omega)))
