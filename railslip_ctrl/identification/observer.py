"""Observers that estimate the adhesion torque Ta from sampled signals, and models of the sensors and their noise.

`FilterObserver` is the observer of [Park2008] (27), (28) and Fig. 11. `KalmanObserver` models Ta as a random walk. Both
are exact from sample to sample for measured signals that are linear between samples.
"""

from __future__ import annotations

import contextlib
import math
from abc import ABC, abstractmethod
from enum import StrEnum
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from railslip_ctrl.core.arguments import Complexes, Floats, number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.model.vehicle import Vehicle

__all__ = [
    "Encoder", "Estimates", "FilterObserver", "Form", "KalmanObserver", "NoiseGains", "ObserverResponses",
    "ObserverState", "SampledForm", "TorqueObserver", "TorqueSensor", "adhesion_coefficient", "noise_deviation",
    "observer_responses",
]  # fmt: skip

# --- sensors -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Encoder:
    """Incremental encoder; its speed is the difference of two counts over the interval between them.

    The speed is the mean over the interval and therefore half an interval late. The rounding error of each angle is
    modelled as uniform over one count and independent of other errors, which is valid if many counts pass in an
    interval. `counts` is the number of counts per turn: 4 times the number of lines of an encoder with two tracks.
    InputError for fewer than 1.
    """

    counts: int

    def __post_init__(self) -> None:
        if self.counts < 1:
            raise InputError(f"counts: {self.counts} is not allowed; give a value >= 1 (counts a turn)")

    @property
    def angle_step(self) -> float:
        """Angle of one count, rad."""
        return 2 * math.pi / self.counts

    @property
    def angle_variance(self) -> float:
        """Variance of the rounding error of one angle, rad^2."""
        return self.angle_step**2 / 12

    def speed_variance(self, interval: float) -> float:
        """Variance of the measured speed, (rad/s)^2, for a sampling interval in s."""
        return 2 * self.angle_variance / interval**2

    def speed(self, time: ArrayLike, angle: ArrayLike) -> Floats:
        """Return the measured speed (rad/s) at all times but the first: k - 1 values.

        `time` in s and true `angle` in rad are 1-D arrays of equal length k.
        """
        counted = np.floor(np.asarray(angle, dtype=float) / self.angle_step)
        return np.asarray(np.diff(counted) * self.angle_step / np.diff(np.asarray(time, dtype=float)))


@dataclass(frozen=True)
class TorqueSensor:
    """Torque sensor with white noise and a finite resolution, N*m.

    `noise` >= 0 is the standard deviation of a sample, `resolution` >= 0 the step of the readings. InputError for a
    number out of range.
    """

    noise: float
    resolution: float = 0.0

    def __post_init__(self) -> None:
        number("noise", self.noise, "N*m", ge=0)
        number("resolution", self.resolution, "N*m", ge=0)

    @property
    def variance(self) -> float:
        """Variance of one sample, (N*m)^2."""
        return self.noise**2 + self.resolution**2 / 12

    def measured(self, torque: ArrayLike, generator: np.random.Generator) -> Floats:
        """Return the measured torque (N*m) for the true `torque` (N*m, any shape), with noise from `generator`."""
        true = np.asarray(torque, dtype=float)
        noisy = true + self.noise * generator.standard_normal(true.shape)
        return np.asarray(np.round(noisy / self.resolution) * self.resolution if self.resolution else noisy)


# --- linear recursions ---------------------------------------------------------------------------------------------


def linear_recursion(transition: Floats, forcing: Floats, initial: Floats) -> Floats:
    """Compute x[k] = transition[k] x[k-1] + forcing[k] for all k, with x[-1] = initial.

    Shapes: `transition` (k, n, n), `forcing` (k, n), `initial` (n,), result (k, n).
    """
    # first for all blocks in parallel from a zero initial state, then block by block for the initial states
    rows, n = forcing.shape
    length = max(math.isqrt(rows), 1)
    blocks = -(-rows // length)
    padded = np.zeros((blocks * length, n, n + 1))  # zeros fill the last block; the result is cut off after `rows`
    padded[:rows, :, :n], padded[:rows, :, n] = transition, forcing
    steps = padded.reshape(blocks, length, n, n + 1).swapaxes(0, 1).copy()  # by step, then by block
    passed = np.empty_like(steps)  # the product of a block's transitions up to a step, and its response from x = 0
    passed[0] = steps[0]
    for j in range(1, length):
        np.matmul(steps[j, ..., :n], passed[j - 1], out=passed[j])
        passed[j, ..., n] += steps[j, ..., n]
    inherited = np.empty((blocks, n))
    state = initial
    for i in range(blocks):
        inherited[i] = state
        state = passed[-1, i, :, :n] @ state + passed[-1, i, :, n]
    out = np.einsum("jbik,bk->bji", passed[..., :n], inherited) + passed[..., n].swapaxes(0, 1)
    return np.asarray(out.reshape(blocks * length, n)[:rows])


def phi(q: Floats) -> Floats:
    """Return (1 - exp(-q))/q, with the limit 1 at q = 0."""
    small = np.abs(q) < 1e-8
    return np.where(small, 1.0 - q / 2, -np.expm1(-q) / np.where(small, 1.0, q))


def mean_phi(q: Floats) -> Floats:
    """Return (1 - phi(q))/q, with the limit 1/2 at q = 0."""
    small = np.abs(q) < 1e-4  # the difference would cancel here; the series is exact to 1e-12
    return np.where(small, 0.5 - q / 6 + q**2 / 24, (1.0 - phi(q)) / np.where(small, 1.0, q))


@dataclass(frozen=True)
class NoiseGains:
    """Variance of the estimate Ta_hat, (N*m)^2, if one measured signal has white noise of variance 1 (SI).

    The noise is on the measured `torque`, on the measured `speed`, or on the `angle` of an encoder.
    """

    torque: float
    speed: float
    angle: float


@dataclass(frozen=True)
class SampledForm:
    """Recursion of an observer at a constant sampling `interval`, s, with the input u = (Tb, omega).

    The state is x[k] = F x[k-1] + P u[k-1] + Q u[k], the estimate Ta_hat = C x + D u. `F` is (n by n), `P` and `Q` (n
    by 2), `C` (n), `D` (2).
    """

    F: Floats
    P: Floats
    Q: Floats
    C: Floats
    D: Floats
    interval: float

    def noise_gains(self) -> NoiseGains:
        """Return the noise gains: squared H2 norms from each signal to Ta_hat."""
        at_once = self.C @ self.Q + self.D
        after = self.F @ self.Q + self.P  # the impulse response for k >= 1 is C F^(k-1) after
        torque, speed = (at_once[i] ** 2 + self._energy(after[:, i]) for i in range(2))
        first, second = at_once[1], (self.C @ after)[1] - at_once[1]
        angle = first**2 + second**2 + self._energy(self.F @ after[:, 1] - after[:, 1])
        return NoiseGains(float(torque), float(speed), float(angle / self.interval**2))

    def _energy(self, start: Floats) -> float:
        from scipy.linalg import solve_discrete_lyapunov

        return float(self.C @ solve_discrete_lyapunov(self.F, np.outer(start, start)) @ self.C)


def noise_deviation(form: SampledForm, encoder: Encoder, sensor: TorqueSensor) -> float:
    """Standard deviation of Ta_hat, N*m, due to noise of `encoder` and `sensor`, for an observer `form`."""
    gains = form.noise_gains()
    return math.sqrt(gains.angle * encoder.angle_variance + gains.torque * sensor.variance)


# --- samples in, estimates out -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ObserverState:
    """State of an observer after the sample at `time`, s, from which the estimation can continue.

    `sample`, 1-D, has the measured torque (N*m) and speed (rad/s); `x`, 1-D, is the state vector of the observer.
    """

    time: float
    sample: Floats
    x: Floats


@dataclass(frozen=True)
class Estimates:
    """Estimated `adhesion_torque` Ta_hat after each sample, N*m, 1-D, and the `state` after the last sample."""

    adhesion_torque: Floats
    state: ObserverState


def adhesion_coefficient(adhesion_torque: ArrayLike, vehicle: Vehicle) -> Floats | np.float64:
    """Return mu_hat = Ta_hat/(N r), [Park2008] (29), for the wheel of `vehicle`; `adhesion_torque` N*m, any shape."""
    return np.asarray(np.asarray(adhesion_torque, dtype=float) / (vehicle.wheel_load * vehicle.wheel.radius))[()]


def checked_samples(
    time: ArrayLike, torque: ArrayLike, omega: ArrayLike, *, after: float | None
) -> tuple[Floats, Floats]:
    """Check samples; return the times, and an array (k, 2) of torque and speed.

    Times must increase and be later than `after`, s, if that is not None. InputError names the first invalid row.
    """
    columns = {name: np.asarray(x, dtype=float) for name, x in (("time", time), ("torque", torque), ("omega", omega))}
    t = columns["time"]
    for name, values in columns.items():
        if values.ndim != 1 or values.shape != t.shape:
            raise InputError(f"{name}: shape {values.shape} is not allowed; give a 1-D array as long as time")
        if not np.isfinite(values).all():
            row = int(np.argmin(np.isfinite(values)))
            raise InputError(f"{name}: {values[row]} in row {row} is not allowed; give finite values")
    if t.size == 0:
        raise InputError("time: no rows; give at least one row")
    growing = np.diff(t, prepend=-math.inf if after is None else after) > 0
    if not growing.all():
        row = int(np.argmin(growing))
        before = t[row - 1] if row else after
        raise InputError(f"time: {t[row]:.9g} in row {row} is not after {before:.9g}; give increasing times (s)")
    return t, np.stack([columns["torque"], columns["omega"]], axis=1)


_AT_ONCE = 1 << 16  # rows processed together; this bounds the memory and fits into the processor's cache


class TorqueObserver(ABC):
    """Base class of the observers; `inertia` and `viscous_friction` of the wheel include the inertia scale."""

    inertia: float
    viscous_friction: float

    @abstractmethod
    def transfers(self, s: ArrayLike) -> tuple[Complexes, Complexes]:
        """Transfer functions to Ta_hat from measured torque (ratio) and measured speed (N*m*s).

        They are evaluated at the complex frequencies `s`, rad/s, 1-D.
        """

    @abstractmethod
    def sampled(self, interval: float) -> SampledForm:
        """Return the recursion at a constant `interval`, s, > 0."""

    @abstractmethod
    def _at_rest(self, omega: float, steady: float) -> Floats:
        """Return the state x with constant speed `omega`, rad/s, and constant estimate `steady`, N*m."""

    @abstractmethod
    def _after(self, x: Floats, h: Floats, before: Floats, now: Floats) -> tuple[Floats, Floats]:
        """Return estimates and states after the samples `now` (k, 2) of torque and speed.

        `before` (k, 2) has the sample before each of them, and `h` (k,) the time between the two, s. `x` is the state
        after `before[0]`.
        """

    def run(
        self, time: ArrayLike, torque: ArrayLike, omega: ArrayLike, state: ObserverState | None = None
    ) -> Estimates:
        """Estimate the adhesion torque from samples at regular or irregular intervals; arrays of equal length.

        `time`, s, 1-D, must increase; `torque`, N*m, 1-D, and `omega`, rad/s, 1-D, are as measured. Without `state` the
        wheel speed is assumed constant at the first sample; with the `state` after an earlier call the estimation
        continues. InputError for samples that are not finite or not in order.
        """
        t, u = checked_samples(time, torque, omega, after=None if state is None else state.time)
        out, begin = np.empty(t.size), 0
        if state is None:
            out[0] = self.viscous_friction * u[0, 1] + u[0, 0]
            state, begin = ObserverState(float(t[0]), u[0], self._at_rest(float(u[0, 1]), float(out[0]))), 1
        for first in range(begin, t.size, _AT_ONCE):
            part = slice(first, first + _AT_ONCE)
            before = np.concatenate([state.sample[None], u[part][:-1]])
            out[part], x = self._after(state.x, np.diff(t[part], prepend=state.time), before, u[part])
            state = ObserverState(float(t[part][-1]), u[part][-1], x[-1])
        return Estimates(out, state)


# --- the published observer ------------------------------------------------------------------------------------------


class Form(StrEnum):
    """Forms of the published observer.

    PRINTED filters only J omega', as printed in [Park2008] (27). CORRECTED filters every term of (27), so that the
    estimate is Ta_hat = Ta/(tau s + 1).
    """

    PRINTED = "printed"
    CORRECTED = "corrected"


@dataclass(frozen=True)
class FilterObserver(TorqueObserver):
    """Published observer of the adhesion torque, [Park2008] (27), with an exact solution from sample to sample.

    With the interval h between samples, q = h/tau and u = B omega + Tb, the corrected estimate y of Ta is

        y[k] = exp(-q) y[k-1] + (1 - exp(-q)) J (omega[k] - omega[k-1])/h + w0 u[k-1] + w1 u[k],
        w1 = 1 - (1 - exp(-q))/q,  w0 = 1 - exp(-q) - w1.

    In the printed form w0 = w1 = 0, and the estimate is y + u. `inertia` J (kg m^2, > 0) and `viscous_friction` B
    (N*m*s, >= 0) include the vehicle's inertia scale, `time_constant` is tau (s, > 0), and `form` is printed or
    corrected. InputError for a number out of range.
    """

    inertia: float
    viscous_friction: float
    time_constant: float
    form: Form = Form.CORRECTED

    def __post_init__(self) -> None:
        number("inertia", self.inertia, "kg*m^2", gt=0)
        number("viscous_friction", self.viscous_friction, "N*m*s", ge=0)
        number("time_constant", self.time_constant, "s", gt=0)

    @classmethod
    def of(cls, vehicle: Vehicle, time_constant: float, form: Form = Form.CORRECTED) -> Self:
        """Return the observer for the wheel of `vehicle`; `time_constant` in s."""
        return cls(vehicle.effective_inertia, vehicle.effective_viscous_friction, time_constant, form)

    def transfers(self, s: ArrayLike) -> tuple[Complexes, Complexes]:
        point = np.asarray(s, dtype=complex)
        low = np.asarray(1 / (self.time_constant * point + 1), dtype=complex)
        if self.form is Form.PRINTED:
            return np.ones_like(low), np.asarray(self.inertia * point * low + self.viscous_friction)
        return low, np.asarray((self.inertia * point + self.viscous_friction) * low)

    def sampled(self, interval: float) -> SampledForm:
        number("interval", interval, "s", gt=0)
        B, (share, w0, w1) = self.viscous_friction, self._weights(np.array([interval]))
        rate = share * self.inertia / interval
        direct = np.array([1.0, B]) if self.form is Form.PRINTED else np.zeros(2)
        before, now = np.array([[w0, w0 * B - rate]])[..., 0], np.array([[w1, w1 * B + rate]])[..., 0]
        return SampledForm(1 - share[:, None], before, now, np.ones(1), direct, interval)

    def _weights(self, h: Floats) -> tuple[Floats, Floats, Floats]:
        q = h / self.time_constant
        share = -np.expm1(-q)
        if self.form is Form.PRINTED:
            return share, np.zeros_like(q), np.zeros_like(q)
        w1 = 1 - share / q
        return share, share - w1, w1

    def _at_rest(self, omega: float, steady: float) -> Floats:
        return np.array([0.0 if self.form is Form.PRINTED else steady])

    def _after(self, x: Floats, h: Floats, before: Floats, now: Floats) -> tuple[Floats, Floats]:
        share, w0, w1 = self._weights(h)
        u_before, u = (self.viscous_friction * each[:, 1] + each[:, 0] for each in (before, now))
        forcing = share * self.inertia * (now[:, 1] - before[:, 1]) / h + (w0 * u_before + w1 * u)
        y = linear_recursion((1 - share)[:, None, None], forcing[:, None], x)
        return (y[:, 0] + u if self.form is Form.PRINTED else y[:, 0]), y


# --- the Kalman filter -----------------------------------------------------------------------------------------------

# Largest accepted residual of a Riccati equation, relative to the sum of its terms' magnitudes. Correct solutions have
# 1e-10 or less; wrong solutions have no correct digit.
_LARGEST_RESIDUAL = 1e-6


def steady_covariance(A: Floats, driven: Floats, noise: float, *, sampled: bool) -> Floats:
    """Solve the Riccati equation of a Kalman filter for the covariance P of its error; the first state is measured.

    `A` is the matrix of the states, `driven` the covariance of the noise on the states, and `noise` the variance of the
    noise on the measurement C x with C = (1, 0, ...). In continuous time they are intensities, and the equation is
    A P + P A' - P C' C P/noise + driven = 0. If `sampled`, the covariance just before a sample is
    P = A (P - P C' C P/(C P C' + noise)) A' + driven. InputError if no valid solution can be computed.
    """
    import control

    n, solve = len(A), control.dlqe if sampled else control.lqe
    seen, sound = np.eye(1, n), False
    with np.errstate(all="ignore"), contextlib.suppress(ArithmeticError, ValueError):  # LinAlgError is a ValueError
        P = np.asarray(solve(A, np.eye(n), seen, driven, np.array([[noise]]), method="scipy")[1], dtype=float)
        gain = P[:, 0] / (P[0, 0] + noise if sampled else noise)
        taken = np.outer(gain, P[0])
        terms = (A @ P @ A.T, -A @ taken @ A.T, driven, -P) if sampled else (A @ P, P @ A.T, -taken, driven)
        residual, scale = np.abs(sum(terms)), sum(np.abs(term) for term in terms)
        sound = bool(np.isfinite(scale).all() and (residual <= _LARGEST_RESIDUAL * scale).all())
        poles = np.linalg.eigvals(A - np.outer(A @ gain if sampled else gain, seen))
        if sampled:
            sound &= (P - taken).diagonal().min() >= 0 and bool(np.abs(poles).max() < 1)
        else:
            sound &= bool(poles.real.max() < 0)
    if not sound:
        raise InputError(
            f"Kalman filter: no steady gain can be computed with measurement noise {noise:g} and process noise "
            f"{np.abs(driven).max():g}; give noises closer to each other, and an interval near the filter's time "
            "constants"
        )
    return P


@dataclass(frozen=True)
class KalmanObserver(TorqueObserver):
    """Kalman filter that estimates the adhesion torque Ta of a wheel, with a constant gain ([Astrom1997] 11).

    The model is omega' = (-B omega + Ta - Tb)/J with noise on Tb, and Ta' = white noise.

    - inertia, viscous_friction: J, kg m^2, > 0, and B, N m s, >= 0, of the wheel, with the vehicle's inertia scale.
    - interval: nominal sampling interval, s, > 0, for which the gain is computed.
    - speed_variance, torque_variance: noise variance of a sample, (rad/s)^2, > 0, and (N*m)^2, >= 0.
    - walk: intensity of the white noise that drives Ta, (N*m)^2/s, > 0.

    InputError for a number out of range, and if the noises are so different that the gains cannot be computed.
    """

    inertia: float
    viscous_friction: float
    interval: float
    speed_variance: float
    torque_variance: float
    walk: float

    def __post_init__(self) -> None:
        units = {"inertia": "kg*m^2", "interval": "s", "speed_variance": "(rad/s)^2", "walk": "(N*m)^2/s"}
        for name, unit in units.items():
            number(name, getattr(self, name), unit, gt=0)
        number("viscous_friction", self.viscous_friction, "N*m*s", ge=0)
        number("torque_variance", self.torque_variance, "(N*m)^2", ge=0)

    @classmethod
    def of(
        cls, vehicle: Vehicle, encoder: Encoder, sensor: TorqueSensor, *, interval: float, change: float, within: float
    ) -> Self:
        """Return the Kalman filter for a vehicle's wheel and its sensors.

        The `encoder` gives the noise variance of the speed, and the `sensor` that of the torque. `interval` is the
        sampling interval, s. Ta is expected to change by `change` (N*m, one standard deviation) within the time
        `within` (s), so that `walk` is change^2/within.
        """
        number("change", change, "N*m", gt=0)
        number("within", within, "s", gt=0)
        return cls(
            vehicle.effective_inertia,
            vehicle.effective_viscous_friction,
            interval,
            encoder.speed_variance(interval),
            sensor.variance,
            change**2 / within,
        )

    @cached_property
    def model(self) -> tuple[Floats, Floats]:
        """Matrices A (2, 2) and b (2) of x' = A x + b Tb with x = (omega, Ta)."""
        J = self.inertia
        return np.array([[-self.viscous_friction / J, 1 / J], [0.0, 0.0]]), np.array([-1 / J, 0.0])

    @cached_property
    def driving_noise(self) -> Floats:
        """Intensity, (2, 2), of the white noise on x', where x = (omega, Ta)."""
        return np.diag([self.torque_variance * self.interval / self.inertia**2, self.walk])

    @cached_property
    def continuous_gain(self) -> Floats:
        """Gain L, (2,), of x_hat' = A x_hat + b Tb + L (y - omega_hat); y is the measured speed."""
        # noise of the samples acts like white noise of intensity speed_variance * interval
        noise = self.speed_variance * self.interval
        return np.asarray(steady_covariance(self.model[0], self.driving_noise, noise, sampled=False)[:, 0] / noise)

    @cached_property
    def sampled_gain(self) -> Floats:
        """Gain K, shape (2,), of x_hat[k] = prediction + K (y[k] - predicted omega) at the nominal interval.

        The covariance of the noise added within an interval is computed by a matrix exponential ([VanLoan1978]).
        """
        from scipy.linalg import expm

        A, exponential = self.model[0], np.full((4, 4), np.nan)
        with np.errstate(all="ignore"), contextlib.suppress(ValueError):  # not finite
            exponential = expm(np.block([[-A, self.driving_noise], [np.zeros((2, 2)), A.T]]) * self.interval)
        transition = exponential[2:, 2:].T
        driven = transition @ exponential[:2, 2:]
        if not np.isfinite(driven).all():
            raise InputError(
                f"interval: with {self.interval:g} s and these noises no gain can be computed; give an interval near "
                "the filter's time constants"
            )
        # symmetric except for rounding errors
        seen = steady_covariance(transition, (driven + driven.T) / 2, self.speed_variance, sampled=True)[:, 0]
        return np.asarray(seen / (seen[0] + self.speed_variance))

    def transfers(self, s: ArrayLike) -> tuple[Complexes, Complexes]:
        A, b = self.model
        point = np.asarray(s, dtype=complex)[:, None, None]
        closed = A - np.outer(self.continuous_gain, np.eye(1, 2))
        inputs = np.stack([b, self.continuous_gain], axis=1).astype(complex)
        response = np.linalg.solve(point * np.eye(2) - closed, inputs[None])[:, 1, :]
        return response[:, 0], response[:, 1]

    def sampled(self, interval: float) -> SampledForm:
        number("interval", interval, "s", gt=0)
        transition, before, now = (each[0] for each in self._recursion(np.array([interval])))
        return SampledForm(transition, before, now, np.array([0.0, 1.0]), np.zeros(2), interval)

    def _recursion(self, h: Floats) -> tuple[Floats, Floats, Floats]:
        q, by_torque = self.viscous_friction / self.inertia * h, h / self.inertia
        transition, before, now = np.zeros((3, len(h), 2, 2))
        transition[:, 0, 0], transition[:, 0, 1], transition[:, 1, 1] = np.exp(-q), by_torque * phi(q), 1.0
        before[:, 0, 0], now[:, 0, 0] = -by_torque * (phi(q) - mean_phi(q)), -by_torque * mean_phi(q)
        correct = np.eye(2) - np.outer(self.sampled_gain, np.eye(1, 2))
        now = correct @ now
        now[:, :, 1] = self.sampled_gain
        return correct @ transition, correct @ before, now

    def _at_rest(self, omega: float, steady: float) -> Floats:
        return np.array([omega, steady])

    def _after(self, x: Floats, h: Floats, before: Floats, now: Floats) -> tuple[Floats, Floats]:
        transition, by_before, by_now = self._recursion(h)
        forcing = np.einsum("kij,kj->ki", by_before, before) + np.einsum("kij,kj->ki", by_now, now)
        mean = linear_recursion(transition, forcing, x)
        return mean[:, 1], mean


# --- frequency responses ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ObserverResponses:
    """Frequency responses of Ta_hat to the torques on the wheel and to sensor noise; complex arrays of equal length.

    - omega: frequencies, rad/s.
    - adhesion: response to the true adhesion torque Ta + Tr, N*m per N*m; ideally 1.
    - brake, disturbance: responses to the measured brake torque Tb and to Td, N*m per N*m; ideally 0.
    - torque_noise: response to noise on the measured Tb, N*m per N*m.
    - speed_noise: response to noise on the measured wheel speed, N*m per rad/s.
    """

    omega: Floats
    adhesion: Complexes
    brake: Complexes
    disturbance: Complexes
    torque_noise: Complexes
    speed_noise: Complexes


def observer_responses(observer: TorqueObserver, omega: ArrayLike) -> ObserverResponses:
    """Compute the continuous-time frequency responses of an `observer` on its wheel at `omega` > 0, rad/s, 1-D."""
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
