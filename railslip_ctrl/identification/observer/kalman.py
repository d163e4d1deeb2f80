"""Kalman filter for the adhesion torque: Ta a random walk, Td left out or a vibration of known frequency.

    omega' = (-B omega + Ta - Tb - Td)/J + torque error/J,    Ta' = white,    Td'' + 2 d Td' + (d^2 + w^2) Td = white

Ta and Td act on the wheel alike, so that both as random walks could not be told apart; a vibration of the caliper can,
as it has a frequency of its own. Every measured speed is y = omega + white noise.

The steady filter ([Astrom1997] 11) is used: its gain comes from python-control's Riccati solutions, continuous (`lqe`)
and sampled (`dlqe`). On samples it predicts over each interval exactly, torque taken to run straight, and corrects by
the gain of the nominal interval. After a gap the estimate recovers as fast as it would from any error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from railslip_ctrl.model.vehicle import Vehicle

from .forms import SampledForm
from .recursion import linear_recursion
from .riccati import continuous_covariance, sampled_covariance, sampled_noise
from .samples import Complexes, Estimates, Floats, checked_samples, checked_step, require
from .sensors import Encoder, TorqueSensor

_AT_ONCE = 1 << 16  # rows for which transitions are held at a time
_SERIES_REACH = 0.5  # interval times norm up to which the exponential's series is summed
_SERIES_TERMS = 14  # 0.5^15/15! is below rounding


@dataclass(frozen=True)
class Vibration:
    """A disturbance torque exp(-decay t) sin(frequency t), set off again and again ([Park2008] p. 55: 4, 10 pi).

    Parameters
    ----------
    frequency : float
        rad/s, > 0.
    decay : float
        1/s, > 0.
    deviation : float
        Standard deviation of Td in the long run, N*m, > 0.
    """

    frequency: float
    decay: float
    deviation: float

    def __post_init__(self) -> None:
        for name, unit in (("frequency", "rad/s"), ("decay", "1/s"), ("deviation", "N*m")):
            require(name, getattr(self, name), unit)


@dataclass(frozen=True)
class KalmanState:
    """After a sample: its time (s) and torque (N*m), and the mean: omega (rad/s), Ta (N*m), Td and Td' if any."""

    time: float
    torque: float
    mean: tuple[float, ...]


@dataclass(frozen=True)
class KalmanObserver:
    """Ta_hat from the measured brake torque (N*m) and the wheel's angular speed (rad/s).

    Parameters
    ----------
    inertia, viscous_friction : float
        Effective J (kg m^2, > 0) and B (N m s, >= 0) of the wheel.
    interval : float
        Nominal interval of the samples, s, > 0.
    speed_variance : float
        Of the noise on a measured speed, (rad/s)^2, > 0.
    torque_variance : float
        Of the noise on a measured torque, (N*m)^2, >= 0.
    walk : float
        Intensity of the white noise that drives Ta, (N*m)^2/s, > 0.
    vibration : Vibration, optional
        Td; without it Td = 0, and what there is of it is taken for Ta.

    Raises
    ------
    InputError
        A number out of range; noises so far apart that the gains cannot be computed; in `start`, `step` and `run` a
        sample that is not finite, or not after the one before.
    """

    inertia: float
    viscous_friction: float
    interval: float
    speed_variance: float
    torque_variance: float
    walk: float
    vibration: Vibration | None = None

    def __post_init__(self) -> None:
        units = {"inertia": "kg*m^2", "interval": "s", "speed_variance": "(rad/s)^2", "walk": "(N*m)^2/s"}
        for name, unit in units.items():
            require(name, getattr(self, name), unit)
        require("viscous_friction", self.viscous_friction, "N*m*s", zero_allowed=True)
        require("torque_variance", self.torque_variance, "(N*m)^2", zero_allowed=True)

    @classmethod
    def of(
        cls,
        vehicle: Vehicle,
        encoder: Encoder,
        sensor: TorqueSensor,
        *,
        interval: float,
        change: float,
        within: float,
        vibration: Vibration | None = None,
    ) -> Self:
        """The filter of a vehicle's wheel and its sensors.

        The speed's variance is that of the encoder's rounding, taken as white: at low frequencies its rounding errors
        cancel, so that the filter trusts the speed less than it might. The torque's is the sensor's. Ta is expected
        to change by `change` (N*m, one standard deviation) within `within` (s): the walk is change^2/within.
        """
        require("change", change, "N*m")
        require("within", within, "s")
        return cls(
            vehicle.effective_inertia,
            vehicle.effective_viscous_friction,
            interval,
            encoder.speed_variance(interval),
            sensor.variance,
            change**2 / within,
            vibration,
        )

    # --- the model, x = (omega, Ta, Td, Td'/w0) ---------------------------------------------------------------------

    @cached_property
    def model(self) -> tuple[Floats, Floats]:
        """x' = A x + b Tb: A (n by n) and b (n), with n = 2, or 4 with a vibration."""
        J = self.inertia
        A = np.array([[-self.viscous_friction / J, 1 / J], [0.0, 0.0]])
        if self.vibration is not None:
            w0, d = math.hypot(self.vibration.frequency, self.vibration.decay), self.vibration.decay
            A = np.block(
                [[A, np.array([[-1 / J, 0.0], [0.0, 0.0]])], [np.zeros((2, 2)), np.array([[0, w0], [-w0, -2 * d]])]]
            )
        b = np.zeros(len(A))
        b[0] = -1 / J
        return A, b

    @cached_property
    def driving_noise(self) -> Floats:
        """Intensity of the white noise on x', n by n; a sampled torque's noise counts as variance * interval."""
        intensity = [self.torque_variance * self.interval / self.inertia**2, self.walk]
        if self.vibration is not None:
            # with this the oscillator's variance is deviation^2 in both of its states
            intensity += [0.0, 4 * self.vibration.decay * self.vibration.deviation**2]
        return np.diag(intensity)

    @cached_property
    def continuous_gain(self) -> Floats:
        """L (n) of x_hat' = A x_hat + b Tb + L (y - omega_hat); a sampled noise counts as variance * interval."""
        noise = self.speed_variance * self.interval
        return np.asarray(continuous_covariance(self.model[0], self.driving_noise, noise)[:, 0] / noise)

    @cached_property
    def sampled_gain(self) -> Floats:
        """K (n) of x_hat[k] = prediction + K (y[k] - predicted omega) at the nominal interval."""
        seen = self._predicted_covariance[:, 0]
        return np.asarray(seen / (seen[0] + self.speed_variance))

    @property
    def deviation(self) -> float:
        """Standard deviation of Ta_hat - Ta after a sample, N*m, if the noises are what the model says."""
        before = self._predicted_covariance
        return math.sqrt(before[1, 1] - self.sampled_gain[1] * before[0, 1])

    @cached_property
    def _predicted_covariance(self) -> Floats:
        transition, driven = sampled_noise(self.model[0], self.driving_noise, self.interval)
        return sampled_covariance(transition, driven, self.speed_variance)

    @property
    def _seen(self) -> Floats:
        return np.eye(1, len(self.model[0]))

    @cached_property
    def _correction(self) -> Floats:
        """1 - K C."""
        return np.asarray(np.eye(len(self.model[0])) - np.outer(self.sampled_gain, self._seen))

    # --- what it does -----------------------------------------------------------------------------------------------

    def transfers(self, s: ArrayLike) -> tuple[Complexes, Complexes]:
        """Continuous filter: from measured torque (1) and speed (N*m*s) to Ta_hat, at complex s (rad/s, 1-D)."""
        A, b = self.model
        point = np.asarray(s, dtype=complex)[:, None, None]
        closed = A - np.outer(self.continuous_gain, self._seen)
        inputs = np.stack([b, self.continuous_gain], axis=1).astype(complex)
        response = np.linalg.solve(point * np.eye(len(A)) - closed, inputs[None])[:, 1, :]
        return response[:, 0], response[:, 1]

    def sampled(self, interval: float | None = None) -> SampledForm:
        """The recursion at a constant interval (s), the nominal one if none is given."""
        h = self.interval if interval is None else interval
        require("interval", h, "s")
        transition, before, now = (each[0] for each in self._transitions(np.array([h])))
        still = np.zeros(len(transition))
        correct = self._correction
        return SampledForm(
            correct @ transition,
            np.stack([correct @ before, still], axis=1),
            np.stack([correct @ now, self.sampled_gain], axis=1),
            np.eye(1, len(transition), 1),
            np.zeros(2),
            h,
        )

    def start(self, time: float, torque: float, omega: float) -> tuple[float, KalmanState]:
        """The first sample: the wheel is taken to turn steadily, so that Ta_hat = B omega + Tb; Td = 0.

        `time` in s, `torque` in N*m, `omega` in rad/s.
        """
        checked_samples([time], [torque], [omega], after=None)
        steady = self.viscous_friction * omega + torque
        rest = (0.0,) * (len(self.model[0]) - 2)
        return steady, KalmanState(time, torque, (omega, steady, *rest))

    def step(self, state: KalmanState, time: float, torque: float, omega: float) -> tuple[float, KalmanState]:
        """Ta_hat (N*m) after a sample, and the `state` after it; pure.

        `time` in s, `torque` in N*m, `omega` in rad/s.
        """
        h = checked_step(time, torque, omega, after=state.time)
        transition, before, now = (each[0] for each in self._transitions(np.array([h])))
        predicted = transition @ np.array(state.mean) + before * state.torque + now * torque
        mean = predicted + self.sampled_gain * (omega - predicted[0])
        return float(mean[1]), KalmanState(time, torque, tuple(mean.tolist()))

    def run(
        self, time: ArrayLike, torque: ArrayLike, omega: ArrayLike, state: KalmanState | None = None
    ) -> Estimates[KalmanState]:
        """`step` over columns of samples (s, N*m, rad/s), regular or not; from `start` without a state.

        Chunks of a long log give the same estimates as the log in one piece, each run from the state before it.
        """
        t, tb, w = checked_samples(time, torque, omega, after=None if state is None else state.time)
        out = np.empty(t.size)
        begin = 0
        if state is None:
            out[0], state = self.start(float(t[0]), float(tb[0]), float(w[0]))
            begin = 1
        for first in range(begin, t.size, _AT_ONCE):
            part = slice(first, first + _AT_ONCE)
            out[part], state = self._after(state, t[part], tb[part], w[part])
        return Estimates(out, state)

    def _after(self, state: KalmanState, t: Floats, tb: Floats, w: Floats) -> tuple[Floats, KalmanState]:
        transition, before, now = self._transitions(np.diff(t, prepend=state.time))
        torque_before = np.concatenate([[state.torque], tb[:-1]])
        predicted = before * torque_before[:, None] + now * tb[:, None]
        forcing = predicted @ self._correction.T + w[:, None] * self.sampled_gain
        mean = linear_recursion(self._correction @ transition, forcing, np.array(state.mean))
        return mean[:, 1], KalmanState(float(t[-1]), float(tb[-1]), tuple(mean[-1].tolist()))

    def _transitions(self, interval: Floats) -> tuple[Floats, Floats, Floats]:
        """Over intervals (k): what x is multiplied by (k, n, n), and Tb before and after them (k, n)."""
        n = len(self.model[0])
        exponential = np.empty((interval.size, n, n + 2))
        short = interval * self._norm <= _SERIES_REACH
        series = np.polynomial.polynomial.polyval(interval[short], self._series)
        exponential[short] = np.moveaxis(series, -1, 0)
        if not short.all():
            exponential[~short] = self._long(interval[~short])
        slope = exponential[..., n + 1] / interval[:, None]
        return exponential[..., :n], exponential[..., n] - slope, slope

    def _long(self, interval: Floats) -> Floats:
        from scipy.linalg import expm

        different, which = np.unique(interval, return_inverse=True)
        return np.asarray(expm(self._with_inputs * different[:, None, None])[which, : len(self.model[0])])

    @cached_property
    def _with_inputs(self) -> Floats:
        """The generator of (x, Tb, slope of Tb)."""
        A, b = self.model
        n = len(b)
        generator = np.zeros((n + 2, n + 2))
        generator[:n, :n], generator[:n, n], generator[n, n + 1] = A, b, 1.0
        return generator

    @cached_property
    def _norm(self) -> float:
        return float(np.linalg.norm(self.model[0], 2))

    @cached_property
    def _series(self) -> Floats:
        """Coefficients of the exponential's power series in the interval, rows of x only."""
        terms = [np.eye(len(self._with_inputs))]
        for k in range(1, _SERIES_TERMS + 1):
            terms.append(terms[-1] @ self._with_inputs / k)
        return np.array(terms)[:, : len(self.model[0])]
