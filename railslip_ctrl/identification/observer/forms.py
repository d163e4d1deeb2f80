"""A sampled observer as a linear recursion at a constant interval: its frequency response, and what it makes of noise.

    x[k] = F x[k-1] + P u[k-1] + Q u[k],    Ta_hat[k] = C x[k] + D u[k],    u = (measured Tb, measured omega)

White noise on u gives the estimate a variance that is the square of the H2 norm, the sum of the squared impulse
response ([Astrom1997] 10); so does white noise on the angle of an encoder whose differences are the speed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .samples import Complexes, Floats


@dataclass(frozen=True)
class NoiseGains:
    """Variance of Ta_hat ((N*m)^2) for white noise of variance 1 on every sample of one signal.

    Attributes
    ----------
    torque : float
        On the measured torque, 1 (N*m)^2.
    speed : float
        On the measured speed, 1 (rad/s)^2, independent from sample to sample.
    angle : float
        On the angle, 1 rad^2, whose differences over the interval are the speed: neighbours share an angle.
    """

    torque: float
    speed: float
    angle: float


@dataclass(frozen=True)
class SampledForm:
    """F (n by n), P and Q (n by 2), C (1 by n), D (2), and the interval, s."""

    F: Floats
    P: Floats
    Q: Floats
    C: Floats
    D: Floats
    interval: float

    def transfers(self, omega: ArrayLike) -> tuple[Complexes, Complexes]:
        """From measured torque (1) and speed (N*m*s) to Ta_hat at omega (rad/s, 1-D, below pi/interval)."""
        back: Complexes = np.exp(-1j * np.asarray(omega, dtype=float) * self.interval)[:, None, None]
        inside = np.linalg.solve(np.eye(len(self.F)) - back * self.F, back * self.P + self.Q)
        response = np.asarray((self.C @ inside)[:, 0, :] + self.D, dtype=complex)
        return response[:, 0], response[:, 1]

    def noise_gains(self) -> NoiseGains:
        """Squared H2 norms, in closed form but for a Lyapunov equation of the observer's order."""
        at_once = (self.C @ self.Q)[0] + self.D
        after = self.F @ self.Q + self.P  # the impulse response goes on with C F^(k-1) after, k >= 1
        torque, speed = (at_once[i] ** 2 + self._energy(after[:, i]) for i in range(2))
        first, second = at_once[1], float((self.C @ after)[0, 1]) - at_once[1]
        angle = first**2 + second**2 + self._energy(self.F @ after[:, 1] - after[:, 1])
        return NoiseGains(float(torque), float(speed), float(angle) / self.interval**2)

    def _energy(self, start: Floats) -> float:
        """The sum of (C F^k start)^2 over k >= 0."""
        from scipy.linalg import solve_discrete_lyapunov

        gramian = solve_discrete_lyapunov(self.F, np.outer(start, start))
        return float((self.C @ gramian @ self.C.T)[0, 0])
