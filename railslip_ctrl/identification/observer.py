"""Adhesion torque observed on samples: the published observer, corrected, and a Kalman filter; sensors and their noise.

`FilterObserver` is [Park2008] (27), (28), Fig. 11. Between samples torque and speed are taken to run straight, and the
first-order filter is solved exactly for that: with h the interval, q = h/tau and u = B omega + Tb,

    y[k] = exp(-q) y[k-1] + (1 - exp(-q)) J (omega[k] - omega[k-1])/h + w0 u[k-1] + w1 u[k],
    w1 = 1 - (1 - exp(-q))/q,  w0 = 1 - exp(-q) - w1,

is the corrected estimate. As printed u is not filtered: w0 = w1 = 0, and Ta_hat = y + u.

`KalmanObserver` has Ta as a random walk, Td left out or a vibration of known frequency:

    omega' = (-B omega + Ta - Tb - Td)/J + torque error/J,    Ta' = white,    Td'' + 2 d Td' + (d^2 + w^2) Td = white

Ta and Td act on the wheel alike, so that both as random walks could not be told apart; a vibration of the caliper can,
as it has a frequency of its own. The steady filter ([Astrom1997] 11) is used: its gain comes from python-control's
Riccati solutions. On samples it predicts over each interval exactly and corrects by the gain of the nominal interval.

`SampledForm` is either as a recursion at a constant interval: its frequency response, and what it makes of noise.
"""

from __future__ import annotations

import contextlib
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Any, Generic, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from railslip_ctrl.core.arguments import number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.model.vehicle import Vehicle

__all__ = [
    "Encoder",
    "Estimates",
    "FilterObserver",
    "FilterState",
    "Form",
    "KalmanObserver",
    "KalmanState",
    "NoiseGains",
    "ObserverResponses",
    "SampledForm",
    "TorqueObserver",
    "TorqueSensor",
    "Vibration",
    "adhesion_coefficient",
    "noise_deviation",
    "observer_responses",
]

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

# --- sensors -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Encoder:
    """An incremental encoder; the speed is the difference of two counts over the interval between them.

    That speed is the mean over the interval, so half an interval late. The error of each angle is taken to be
    uniform over one count and independent of the others, which holds while many counts pass in an interval. `counts`
    are those of a turn, every edge used: 4 times the lines of an encoder with two tracks. InputError for fewer than 1.
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
    """White noise on every sample, then rounding; N*m.

    `noise` is the standard deviation of a sample, >= 0: electronics, and the ripple that is not torque on the wheel;
    `resolution` the step of the digits, >= 0. InputError for a number out of range.
    """

    noise: float
    resolution: float = 0.0

    def __post_init__(self) -> None:
        number("noise", self.noise, "N*m", ge=0)
        number("resolution", self.resolution, "N*m", ge=0)

    @property
    def variance(self) -> float:
        """Of one sample, (N*m)^2."""
        return self.noise**2 + self.resolution**2 / 12

    def measured(self, torque: ArrayLike, generator: np.random.Generator) -> Floats:
        """Measured torque (N*m) of the true `torque` (N*m), of any shape, with noise from a `generator`."""
        true = np.asarray(torque, dtype=float)
        noisy = true + self.noise * generator.standard_normal(true.shape)
        return np.asarray(np.round(noisy / self.resolution) * self.resolution if self.resolution else noisy)


State = TypeVar("State", "FilterState", "KalmanState")

# --- samples in, estimates out -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Estimates(Generic[State]):
    """The `adhesion_torque` Ta_hat after each sample, N*m, 1-D, and the `state` after the last, to go on from."""

    adhesion_torque: Floats
    state: State


def adhesion_coefficient(adhesion_torque: ArrayLike, vehicle: Vehicle) -> NDArray[np.float64] | np.float64:
    """mu_hat = Ta_hat/(N r), of an `adhesion_torque` in N*m, of any shape, on a `vehicle`'s wheel. [Park2008] (29)."""
    return np.asarray(np.asarray(adhesion_torque, dtype=float) / (vehicle.wheel_load * vehicle.wheel.radius))[()]


def checked_samples(
    time: ArrayLike, torque: ArrayLike, omega: ArrayLike, *, after: float | None
) -> tuple[Floats, Floats, Floats]:
    """The three columns as arrays of one length; times must grow, and begin after `after` (s) if it is given.

    InputError names the first row, counted from 0, that is refused.
    """
    columns = {name: np.asarray(x, dtype=float) for name, x in (("time", time), ("torque", torque), ("omega", omega))}
    t = columns["time"]
    for name, values in columns.items():
        if values.ndim != 1 or values.shape != t.shape:
            raise InputError(f"{name}: shape {values.shape} is not allowed; give one value a row, as many as times")
        if not np.isfinite(values).all():
            row = int(np.argmin(np.isfinite(values)))
            raise InputError(f"{name}: {values[row]} in row {row} is not allowed; give finite values")
    if t.size == 0:
        raise InputError("time: no rows; give at least one sample")
    growing = np.diff(t, prepend=-math.inf if after is None else after) > 0
    if not growing.all():
        row = int(np.argmin(growing))
        before = t[row - 1] if row else after
        raise InputError(f"time: {t[row]:.9g} in row {row} is not after {before:.9g}; give growing times (s)")
    return t, columns["torque"], columns["omega"]


class TorqueObserver(ABC, Generic[State]):
    """What observers of a wheel do with samples: `inertia` and `viscous_friction` are its effective J and B."""

    inertia: float
    viscous_friction: float

    @abstractmethod
    def _begun(self, time: float, torque: float, omega: float, steady: float) -> State:
        """The state after the first sample, which gives the estimate `steady`."""

    @abstractmethod
    def _after(self, state: State, t: Floats, tb: Floats, w: Floats) -> Estimates[State]:
        """The estimates of samples, one at least, that come after a state."""

    @abstractmethod
    def transfers(self, s: ArrayLike) -> tuple[Complexes, Complexes]:
        """From measured torque (1) and measured speed (N*m*s) to Ta_hat, at complex `s`, rad/s, 1-D."""

    @abstractmethod
    def sampled(self, interval: float) -> SampledForm:
        """The recursion at a constant `interval`, s."""

    def start(self, time: float, torque: float, omega: float) -> tuple[float, State]:
        """The first sample: the wheel is taken to turn steadily, so that Ta_hat = B omega + Tb.

        `time` in s, `torque` in N*m, `omega` in rad/s.
        """
        found = self.run([time], [torque], [omega])
        return float(found.adhesion_torque[0]), found.state

    def step(self, state: State, time: float, torque: float, omega: float) -> tuple[float, State]:
        """Ta_hat (N*m) after a sample, and the `state` after it; pure.

        `time` in s, `torque` in N*m, `omega` in rad/s.
        """
        found = self.run([time], [torque], [omega], state)
        return float(found.adhesion_torque[0]), found.state

    def run(self, time: ArrayLike, torque: ArrayLike, omega: ArrayLike, state: State | None = None) -> Estimates[State]:
        """Estimates over columns of samples, regular or not, arrays of one length.

        `time`, s, 1-D, grows; `torque`, N*m, 1-D, and `omega`, rad/s, 1-D, are as measured. From the `state` after the
        sample before it goes on: chunks of a long log give the same estimates as the log in one piece.
        """
        t, tb, w = checked_samples(time, torque, omega, after=None if state is None else state.time)
        out, begin = np.empty(t.size), 0
        if state is None:
            out[0] = self.viscous_friction * w[0] + tb[0]
            state, begin = self._begun(float(t[0]), float(tb[0]), float(w[0]), float(out[0])), 1
        for first in range(begin, t.size, _AT_ONCE):
            part = slice(first, first + _AT_ONCE)
            found = self._after(state, t[part], tb[part], w[part])
            out[part], state = found.adhesion_torque, found.state
        return Estimates(out, state)


# --- linear recursions ---------------------------------------------------------------------------------------------

_AT_ONCE = 1 << 16  # rows: what a pass needs stays in the processor's cache, and memory bounded


def linear_recursion(transition: Floats, forcing: Floats, initial: Floats) -> Floats:
    """x[k] = transition[k] x[k-1] + forcing[k] for all k, x[-1] = initial.

    Blocks of steps are run side by side from rest, each with the product of its transitions; a pass over the blocks
    then adds what each inherits. Nothing is divided, so stable transitions give rounding errors only.

    `transition` is (k, n, n), `forcing` (k, n), `initial` (n,); the result (k, n).
    """
    out = np.empty_like(forcing)
    state = initial
    for first in range(0, len(forcing), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        out[part] = _in_blocks(transition[part], forcing[part], state)
        state = out[part][-1]
    return out


def _in_blocks(transition: Floats, forcing: Floats, initial: Floats) -> Floats:
    rows, n = forcing.shape
    length = math.isqrt(rows)
    blocks = -(-rows // length)
    padded = np.zeros((blocks * length, n, n + 1))  # the last block is filled up with zeros, cut off at the end
    padded[:rows, :, :n], padded[:rows, :, n] = transition, forcing
    steps = padded.reshape(blocks, length, n, n + 1).swapaxes(0, 1).copy()  # by step, then by block
    passed = np.empty_like(steps)  # the product of a block's transitions up to a step, and its response from rest
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


# --- the sampled form ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class NoiseGains:
    """Variance of Ta_hat, (N*m)^2, for white noise of variance 1 on every sample of one signal, SI.

    `torque` and `speed` are as measured, `angle` that whose differences are the speed: neighbours share an angle.
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


def noise_deviation(form: SampledForm, encoder: Encoder, sensor: TorqueSensor) -> float:
    """Standard deviation of Ta_hat, N*m: noise of `encoder` and `sensor` through the `form` of an observer."""
    gains = form.noise_gains()
    return math.sqrt(gains.angle * encoder.angle_variance + gains.torque * sensor.variance)


# --- the published observer ------------------------------------------------------------------------------------------


class Form(StrEnum):
    """PRINTED filters J omega' alone (27); CORRECTED filters every term, so that Ta_hat = Ta/(tau s + 1)."""

    PRINTED = "printed"
    CORRECTED = "corrected"


@dataclass(frozen=True)
class FilterState:
    """After a sample: `time` (s), `torque` (N*m), speed `omega` (rad/s); `filtered` (N*m) is what the filter holds."""

    time: float
    torque: float
    omega: float
    filtered: float


@dataclass(frozen=True)
class FilterObserver(TorqueObserver[FilterState]):
    """The published observer; Td is not known to it: the corrected estimate is (Ta + Tr - Td)/(tau s + 1).

    Effective `inertia` J (kg m^2, > 0) and `viscous_friction` B (N m s, >= 0) of the wheel, `time_constant` tau (s, >
    0), as printed or corrected by its `form`. InputError for a number out of range; in `start`, `step` and `run` for a
    sample that is not finite, or not after the one before.
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
        """The observer of a `vehicle`'s wheel, with its inertia scale; `time_constant` in s, `form` as of the class."""
        return cls(vehicle.effective_inertia, vehicle.effective_viscous_friction, time_constant, form)

    def transfers(self, s: ArrayLike) -> tuple[Complexes, Complexes]:
        point = np.asarray(s, dtype=complex)
        low = np.asarray(1 / (self.time_constant * point + 1), dtype=complex)
        if self.form is Form.PRINTED:
            return np.ones_like(low), np.asarray(self.inertia * point * low + self.viscous_friction)
        return low, np.asarray((self.inertia * point + self.viscous_friction) * low)

    def sampled(self, interval: float) -> SampledForm:
        number("interval", interval, "s", gt=0)
        q = interval / self.time_constant
        share = -math.expm1(-q)
        rate, B = share * self.inertia / interval, self.viscous_friction
        transition, output = np.array([[1 - share]]), np.eye(1)
        if self.form is Form.PRINTED:
            return SampledForm(
                transition, np.array([[0.0, -rate]]), np.array([[0.0, rate]]), output, np.array([1.0, B]), interval
            )
        w1 = 1 - share / q
        w0 = share - w1
        return SampledForm(
            transition, np.array([[w0, w0 * B - rate]]), np.array([[w1, w1 * B + rate]]), output, np.zeros(2), interval
        )

    def _begun(self, time: float, torque: float, omega: float, steady: float) -> FilterState:
        return FilterState(time, torque, omega, steady if self.form is Form.CORRECTED else 0.0)

    def _after(self, state: FilterState, t: Floats, tb: Floats, w: Floats) -> Estimates[FilterState]:
        h = np.diff(t, prepend=state.time)
        q = h / self.time_constant
        share = -np.expm1(-q)
        u = self.viscous_friction * w + tb
        forcing = share * self.inertia * np.diff(w, prepend=state.omega) / h
        if self.form is Form.CORRECTED:
            w1 = 1 - share / q
            before = np.concatenate([[self.viscous_friction * state.omega + state.torque], u[:-1]])
            forcing += (share - w1) * before + w1 * u
        initial = np.array([state.filtered])
        y = linear_recursion((1 - share)[:, None, None], forcing[:, None], initial)[:, 0]
        end = FilterState(float(t[-1]), float(tb[-1]), float(w[-1]), float(y[-1]))
        return Estimates(y if self.form is Form.CORRECTED else y + u, end)


# --- steady Kalman covariances ---------------------------------------------------------------------------------------


# An equation's residual against the sum of its terms, entry by entry: sound solutions have 1e-10 and less, and what is
# refused has no digit right.
_LARGEST_RESIDUAL = 1e-6


def steady_covariance(A: Floats, driven: Floats, noise: float, *, sampled: bool) -> Floats:
    """P of A P + P A' - P C' C P/noise + driven = 0, C the first state; InputError where it cannot be had.

    Sampled it is P before a sample, of P = A (P - P C' C P/(C P C' + noise)) A' + driven. The solvers give numbers for
    any input, so that it is checked that these solve the equation.
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
            f"Kalman filter: no steady gain can be computed with measurement noise {noise:g} against driving noise "
            f"{np.abs(driven).max():g}; give noises nearer to each other, and an interval near the filter's time "
            "constants"
        )
    return P


def sampled_noise(A: Floats, intensity: Floats, interval: float) -> tuple[Floats, Floats]:
    """exp(A h), and the covariance that white noise of this intensity on x' adds within h.

    By a matrix exponential ([VanLoan1978]) for a short time, which is then doubled: the exponential holds exp(-A h),
    beside which over a long time nothing else keeps its digits. InputError where the numbers overflow.
    """
    from scipy.linalg import expm

    n = len(A)
    doublings = max(0, math.ceil(math.log2(max(float(np.linalg.norm(A, 2)) * interval, 1.0))))
    with np.errstate(all="ignore"):
        generator = np.block([[-A, intensity], [np.zeros((n, n)), A.T]]) * (interval / 2**doublings)
        exponential = expm(generator) if np.isfinite(generator).all() else np.full_like(generator, np.nan)
        transition = exponential[n:, n:].T
        driven = transition @ exponential[:n, n:]
        for _ in range(doublings):
            driven = driven + transition @ driven @ transition.T
            transition = transition @ transition
        driven = (driven + driven.T) / 2  # symmetric but for rounding
    if not (np.isfinite(transition).all() and np.isfinite(driven).all()):
        raise InputError(
            f"interval: {interval:g} is not allowed with these noises; give values nearer to usual ones (s)"
        )
    return transition, driven


# --- the Kalman filter -----------------------------------------------------------------------------------------------


_SERIES_REACH = 0.5  # interval times norm up to which the exponential's series is summed
_SERIES_TERMS = 14  # 0.5^15/15! is below rounding


@dataclass(frozen=True)
class Vibration:
    """A disturbance torque exp(-decay t) sin(frequency t), set off again and again ([Park2008] p. 55: 4, 10 pi).

    `frequency` in rad/s, `decay` in 1/s, standard `deviation` of Td in the long run in N*m; all > 0.
    """

    frequency: float
    decay: float
    deviation: float

    def __post_init__(self) -> None:
        for name, unit in (("frequency", "rad/s"), ("decay", "1/s"), ("deviation", "N*m")):
            number(name, getattr(self, name), unit, gt=0)


@dataclass(frozen=True)
class KalmanState:
    """After a sample: its time (s) and torque (N*m), and the mean: omega (rad/s), Ta (N*m), Td and Td' if any."""

    time: float
    torque: float
    mean: tuple[float, ...]


@dataclass(frozen=True)
class KalmanObserver(TorqueObserver[KalmanState]):
    """The Kalman filter for the wheel's effective `inertia` (kg m^2, > 0) and `viscous_friction` (N m s, >= 0).

    `interval` is the nominal one of the samples, s, > 0. `speed_variance`, (rad/s)^2, > 0, and `torque_variance`,
    (N*m)^2, >= 0, are those of a sample's noise; `walk`, (N*m)^2/s, > 0, is the intensity of the white noise that
    drives Ta. Without a `vibration` Td = 0, and what there is of it is taken for Ta. InputError as of `FilterObserver`,
    and for noises so far apart that the gains cannot be computed.
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
            number(name, getattr(self, name), unit, gt=0)
        number("viscous_friction", self.viscous_friction, "N*m*s", ge=0)
        number("torque_variance", self.torque_variance, "(N*m)^2", ge=0)

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
        number("change", change, "N*m", gt=0)
        number("within", within, "s", gt=0)
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
        return np.asarray(steady_covariance(self.model[0], self.driving_noise, noise, sampled=False)[:, 0] / noise)

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
        return steady_covariance(transition, driven, self.speed_variance, sampled=True)

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
        number("interval", h, "s", gt=0)
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

    def _begun(self, time: float, torque: float, omega: float, steady: float) -> KalmanState:
        return KalmanState(time, torque, (omega, steady, *(0.0,) * (len(self.model[0]) - 2)))

    def _after(self, state: KalmanState, t: Floats, tb: Floats, w: Floats) -> Estimates[KalmanState]:
        transition, before, now = self._transitions(np.diff(t, prepend=state.time))
        torque_before = np.concatenate([[state.torque], tb[:-1]])
        predicted = before * torque_before[:, None] + now * tb[:, None]
        forcing = predicted @ self._correction.T + w[:, None] * self.sampled_gain
        mean = linear_recursion(self._correction @ transition, forcing, np.array(state.mean))
        return Estimates(mean[:, 1], KalmanState(float(t[-1]), float(tb[-1]), tuple(mean[-1].tolist())))

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


# --- frequency responses ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ObserverResponses:
    """Responses of Ta_hat to what acts on the wheel and to sensor noise, complex arrays of one length.

    At frequencies `omega`, rad/s: from the true Ta with Tr (`adhesion`), the measured Tb (`brake`), Td (`disturbance`)
    and noise on Tb (`torque_noise`), N*m per N*m: 1, 0, 0 and small of a good observer; from noise on omega
    (`speed_noise`), N*m per rad/s.
    """

    omega: Floats
    adhesion: Complexes
    brake: Complexes
    disturbance: Complexes
    torque_noise: Complexes
    speed_noise: Complexes


def observer_responses(observer: TorqueObserver[Any], omega: ArrayLike) -> ObserverResponses:
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
