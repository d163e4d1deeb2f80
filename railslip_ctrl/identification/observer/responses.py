"""Frequency responses of the observers as records: from what acts on the wheel, and from sensor noise, to Ta_hat."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from .forms import SampledForm
from .samples import Complexes, Estimates, Floats


class AdhesionObserver(Protocol):
    """What `FilterObserver` and `KalmanObserver` have in common."""

    @property
    def inertia(self) -> float:
        """Effective J, kg m^2."""

    @property
    def viscous_friction(self) -> float:
        """Effective B, N m s."""

    def transfers(self, s: ArrayLike) -> tuple[Complexes, Complexes]:
        """From measured torque (1) and measured speed (N*m*s) to Ta_hat, at complex `s`, 1/s, 1-D."""

    def sampled(self, interval: float) -> SampledForm:
        """The recursion at a constant interval, s."""

    def run(self, time: ArrayLike, torque: ArrayLike, omega: ArrayLike, state: Any = None) -> Estimates[Any]:
        """Estimates over columns of samples.

        Parameters
        ----------
        time : array, 1-D
            s, growing.
        torque, omega : array, 1-D
            Measured brake torque, N*m, and speed of the wheel, rad/s.
        state : optional
            After the sample before, to go on from.
        """


@dataclass(frozen=True)
class ObserverResponses:
    """Responses of Ta_hat, complex arrays of one length; the names are those of `statement.WheelTransfers`.

    Attributes
    ----------
    omega : array
        Frequencies, rad/s.
    adhesion, brake, disturbance, torque_noise : array
        N*m per N*m. A good observer has 1, 0, 0 and little.
    speed_noise : array
        N*m per rad/s.
    """

    omega: Floats
    adhesion: Complexes
    brake: Complexes
    disturbance: Complexes
    torque_noise: Complexes
    speed_noise: Complexes


def observer_responses(observer: AdhesionObserver, omega: ArrayLike) -> ObserverResponses:
    """The continuous `observer` behind the wheel, on a 1-D grid of `omega` > 0, rad/s."""
    grid = np.asarray(omega, dtype=float)
    s = 1j * grid
    torque, speed = observer.transfers(s)
    wheel = 1 / (observer.inertia * s + observer.viscous_friction)
    return ObserverResponses(
        omega=grid,
        adhesion=speed * wheel,
        brake=torque - speed * wheel,
        disturbance=-speed * wheel,
        torque_noise=torque,
        speed_noise=speed,
    )
