"""What a controller asks of the brake: noise on the torque command, and the peak rate of the acting torque.

Works for any controller given as a function C(s) of complex s: a `Rational` (PI, PI-lead) or a `DelayedRatio`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import KMH
from railslip_ctrl.loop import Rational

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]

SAMPLING_PERIOD = 0.005
"""s; measured noise is taken as white up to the Nyquist frequency of this period, 628 rad/s."""

_HORIZON = 20.0  # s; the peak rates come within the first few
_TIME_STEP = 1e-3  # s
_NOISE_POINTS = 40_000  # resolves the turns of the dead time, 15 of them for 0.15 s, and every resonance of a sane loop
_VERY_FAST = 1e9  # 1/s, where C has its limit


@dataclass(frozen=True)
class Effort:
    """Control effort of a stable loop.

    Attributes
    ----------
    high_frequency_gain : float
        |C(j infinity)|, N*m/(m/s).
    noise_gain : float
        Standard deviation of the commanded torque over that of white measurement noise up to the Nyquist frequency w:
        sqrt(1/w * integral over 0..w of |C S|^2), N*m/(m/s). Multiply by the noise's standard deviation in m/s.
    reference_rate : float
        Largest |rate| of the acting torque (behind dead time and lag) on a step of 1 km/h of the reference sigma_d,
        N*m/s; equally of a step of 1 km/h added to the measured slip velocity. inf without lag if C jumps.
    disturbance_rate : float
        The same on a disturbance that makes the slip velocity itself jump by 1 km/h (an impulse of torque at the
        wheel), N*m/s.
    """

    high_frequency_gain: float
    noise_gain: float
    reference_rate: float
    disturbance_rate: float


def control_effort(
    controller: Any,
    plant: Any,
    dead_time: float,
    *,
    lag: float,
    sampling_period: float = SAMPLING_PERIOD,
) -> Effort:
    """Effort of C(s) in a loop that the caller knows to be stable (the numbers mean nothing otherwise).

    Parameters
    ----------
    controller : callable or linear system
        C(s), N*m/(m/s), for complex arrays s; a limit as s tends to infinity.
    plant : python-control system, `Rational`, or a real number
        From commanded torque to -e without the dead time, lag included, as of `actuated_plant`.
    dead_time, lag : float
        s; actuator.
    sampling_period : float
        s, > 0.

    Raises
    ------
    InputError
        Another kind of system, a time that is negative or not finite, or a sampling period that is not > 0.
    """
    for name, value in (("dead time", dead_time), ("lag", lag), ("sampling period", sampling_period)):
        if not (math.isfinite(value) and value >= 0) or (value == 0 and name == "sampling period"):
            raise InputError(f"{name}: {value} s is not allowed; give a finite value of the proper sign")
    plant = Rational.from_control(plant, "plant")
    if not callable(controller):
        controller = Rational.from_control(controller, "controller")

    def torque(s: Any) -> Complexes:
        c = np.asarray(controller(s))
        return np.asarray(c / (1 + c * plant(s) * np.exp(-dead_time * s)))

    far = np.asarray(controller(_VERY_FAST * np.array([1.0 + 0j, 10.0]))).real
    at_once = float(10 * far[1] - far[0]) / 9  # C = C(inf) + c/s: the second term drops out
    nyquist = math.pi / sampling_period
    omega = (np.arange(_NOISE_POINTS) + 0.5) * nyquist / _NOISE_POINTS
    noise = math.sqrt(float(np.mean(np.abs(torque(1j * omega)) ** 2)))
    wheel_gain = plant.gain * (lag or 1.0)

    def wheel(s: Any) -> Complexes:
        """Slip velocity after a jump by 1, times s."""
        return np.asarray(plant(s) * (lag * s + 1) * s / wheel_gain)

    reference = _peak_rate(torque, lag, at_once)
    disturbance = _peak_rate(lambda s: torque(s) * wheel(s), lag, at_once)
    return Effort(abs(at_once), noise, KMH * reference, KMH * disturbance)


def _peak_rate(torque: Callable[[Any], Complexes], lag: float, at_once: float) -> float:
    """Largest |r(t)|, t > 0, of R(s) = torque(s)/(lag s + 1), the jump at_once/lag at 0 included.

    The Fourier series of exp(-c t) r(t) on a shifted contour; what falls as 1/s is taken out and added in closed form.
    """
    if lag == 0:
        return math.inf if at_once != 0 else _peak(torque, 0.0, 0.0)
    return _peak(lambda s: (torque(s) - at_once) / (lag * s + 1), at_once / lag, lag)


def _peak(response: Callable[[Any], Complexes], jump: float, lag: float) -> float:
    count = round(_HORIZON / _TIME_STEP)
    shift = 12.0 / _HORIZON  # what folds back from beyond the horizon is exp(-12) of itself
    omega = 2 * np.pi * np.arange(count // 2 + 1) / _HORIZON
    # a cosine taper at the top keeps the cut from ringing
    taper = np.cos(np.pi / 2 * omega / omega[-1]) ** 2
    series = np.fft.irfft(response(shift + 1j * omega) * taper, n=count) / _TIME_STEP
    t = np.arange(count) * _TIME_STEP
    inside = t < 0.7 * _HORIZON
    known = jump * np.exp(-t / lag) if lag > 0 else 0.0
    rate = (series * np.exp(shift * t) + known)[inside]
    return float(max(np.abs(rate).max(), abs(jump)))
