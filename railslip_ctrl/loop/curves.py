"""Sampled frequency responses of a loop, as records for plotting."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.arguments import checked, number

from .deadtime import DeadTimeLoop, Loop

_POINTS = 4000  # a smooth line in print, the turns of the dead time included


@dataclass(frozen=True)
class FrequencyCurve:
    """L(j omega) on a grid: omega in rad/s, complex response, and its continuous phase in deg."""

    omega: NDArray[np.float64]
    response: NDArray[np.complex128]
    phase_deg: NDArray[np.float64]

    @property
    def magnitude_db(self) -> NDArray[np.float64]:
        """20 log10 |L|, dB; -inf where L is 0, as it is everywhere without gain."""
        with np.errstate(divide="ignore"):
            return np.asarray(20 * np.log10(np.abs(self.response)))


@checked
def frequency_curve(loop: Loop, low: float, high: float) -> FrequencyCurve:
    """Sample a loop between two frequencies, rad/s, the dead time exact; its crossovers are among the points.

    InputError unless 0 < low < high.
    """
    _check_band(low, high)
    omega = np.union1d(np.geomspace(low, high, _POINTS), loop.gain_crossovers.clip(low, high))
    return FrequencyCurve(omega, loop.response(omega), np.degrees(loop.phase(omega)))


@dataclass(frozen=True)
class GangOfFour:
    """The four closed-loop responses that matter ([Astrom2021] 12.1), complex, on one grid of omega (rad/s).

    S = 1/(1 + C P), T = C P/(1 + C P), PS = P/(1 + C P) (load to output), CS = C/(1 + C P) (noise to control).
    """

    omega: NDArray[np.float64]
    s: NDArray[np.complex128]
    t: NDArray[np.complex128]
    ps: NDArray[np.complex128]
    cs: NDArray[np.complex128]


@checked
def gang_of_four(controller: Callable[[Any], Any], plant: DeadTimeLoop, low: float, high: float) -> GangOfFour:
    """The gang of four between two frequencies, rad/s; `controller` is C(s), `plant` P with its dead time, exact.

    InputError unless 0 < low < high.
    """
    _check_band(low, high)
    omega = np.geomspace(low, high, _POINTS)
    p, c = plant(1j * omega), controller(1j * omega)
    s = 1 / (1 + c * p)
    return GangOfFour(omega, np.asarray(s), np.asarray(c * p * s), np.asarray(p * s), np.asarray(c * s))


def _check_band(low: float, high: float) -> None:
    """Of frequencies, rad/s."""
    number("low", low, "rad/s", gt=0)
    number("high", high, "rad/s", gt=low)
