"""Limits of performance for any controller, which follow from the plant alone, and the control effort of a controller.

The lower bound gamma of Mt and Ms follows from the unstable poles p_i, the unstable zeros z_i and the dead time tau. It
is the Nevanlinna-Pick bound: gamma^2 is the largest eigenvalue of A^-1 W A W^*, where A_ij = 1/(p_i + conj p_j) and W =
diag(exp(tau p_i)/B_z(p_i)), with the all-pass function B_z of the zeros. For one real pole p, gamma is exp(p tau) times
the factor |(z + p)/(z - p)| of each zero z ([Astrom2021] 14.4). Ms and Mt have the same bound by commutant lifting
([Sarason1967]).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from railslip_ctrl.core.arguments import Complexes, Floats, checked, number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH
from railslip_ctrl.loop import Rational
from railslip_ctrl.loop.crossings import Response, bracketed_roots, frequency_nodes

# Relative distance below which unstable poles are replaced by one pole, which gives a lower, still valid bound.
_DISTINCT = 1e-3
_FASTEST = 300.0  # largest unstable pole times dead time; exp(2 x 300) is in the range of doubles
# Default of the largest phase lag of the all-pass part: phase margin 45 deg at a slope of -1/2 ([Astrom2021] 14.3).
_ALLOWED_LAG_DEG = 90.0


@dataclass(frozen=True)
class StructureLimit:
    """Limits of a PI or PI-lead, for a plant with one unstable real pole and no unstable zero.

    A PI only adds phase lag. Its phase margin is therefore at most the plant's largest phase above -180 deg, and Ms >=
    |1/(1 + L)| >= 1/(2 sin(phase margin/2)) at the crossover. The PI-lead here cancels the whole lag of the
    actuator, without a filter.

    - structure: "PI" or "PI-lead".
    - phase_deg: upper bound of the phase margin, deg; if it is <= 0, no controller of the structure stabilises.
    - frequency: gain crossover with this phase margin, rad/s; NaN if the phase falls at all frequencies.
    - ms_bound: lower bound of Ms; inf if no controller of the structure stabilises.
    """

    structure: str
    phase_deg: float
    frequency: float
    ms_bound: float

    @property
    def feasible(self) -> bool:
        """False if it is proved that no controller of the structure stabilises."""
        return self.phase_deg > 0


@dataclass(frozen=True)
class Limits:
    """Limits that a plant with dead time tau (s) and actuator lag T (s) sets for any controller.

    - unstable_poles, unstable_zeros: plant poles and zeros with positive real part, 1/s.
    - unstable_pole: largest real part p among the poles, 1/s; 0 if the plant is stable.
    - doubling_time: ln 2/p, s; inf if the plant is stable.
    - actuator_product: p (tau + T). A PI stabilises the plant k/(s - p) with lag and dead time only if this product is
      < 1. For other plants see `StructureLimit`.
    - mt_bound, ms_bound: lower bounds of Mt and Ms for any controller, >= 1.
    - bode_integral: integral of ln|S| over omega from 0 to infinity, rad/s: pi times the sum of the real parts of the
      unstable poles, for a loop L that falls faster than 1/s, or as 1/s with dead time ([Astrom2021] 14.2).
    - crossover_range: lowest and highest suitable gain crossover, rad/s, by the gain crossover frequency inequality, a
      rule of thumb ([Astrom2021] 14.3): the phase lag of the all-pass part of the plant, 2 sum atan(p_i/omega) + tau
      omega + 2 sum atan(omega/z_i), is at most `allowed_lag_deg`. None if no frequency meets the rule.
    - allowed_lag_deg: largest phase lag in the rule for `crossover_range`, deg. With 90 deg the phase margin is 45 deg
      if |L| falls as omega^(-1/2) at the crossover.
    - pi, pi_lead: limits of a PI and a PI-lead; None if `StructureLimit` does not apply to the plant.
    """

    unstable_poles: tuple[complex, ...]
    unstable_zeros: tuple[complex, ...]
    dead_time: float
    lag: float
    unstable_pole: float
    doubling_time: float
    actuator_product: float
    mt_bound: float
    ms_bound: float
    bode_integral: float
    crossover_range: tuple[float, float] | None
    allowed_lag_deg: float
    pi: StructureLimit | None
    pi_lead: StructureLimit | None

    def longest_dead_time(self, ms: float) -> float:
        """Return the dead time, s, above which no linear controller has a peak |S| of at most `ms`, a ratio > 1.

        With one unstable real pole p and no unstable zero it is ln(ms)/p. It is inf for a stable plant, and 0 if
        unstable zeros make the peak larger than `ms` even without dead time. InputError unless `ms` > 1.
        """
        number("ms", ms, gt=1)
        poles, zeros = np.array(self.unstable_poles), np.array(self.unstable_zeros)
        if not self.unstable_poles:
            return math.inf
        if least_peak(poles, zeros, 0.0) >= ms:
            return 0.0
        from scipy.optimize import brentq

        # each pole gives a bound of at least exp(Re p tau): the result is at most ln(ms)/p, with equality for one pole
        top = math.log(ms) / self.unstable_pole
        if least_peak(poles, zeros, top) <= ms * (1.0 + 1e-12):
            return top
        return float(brentq(lambda tau: math.log(least_peak(poles, zeros, tau) / ms), 0.0, top, rtol=1e-12))


@checked
def fundamental_limits(
    plant: Any, dead_time: float, *, lag: float = 0.0, allowed_lag_deg: float = _ALLOWED_LAG_DEG
) -> Limits:
    """Return the limits of a plant with dead time, for unity negative feedback.

    - plant: python-control system, `Rational`, or a real number; transfer function from command to output with the
      actuator's lag and without its dead time. Its gain may have either sign.
    - dead_time: dead time of the actuator, s, >= 0.
    - lag: lag of the actuator, s, >= 0, which a PI-lead can cancel. If it is > 0, -1/lag must be a pole of `plant`.
    - allowed_lag_deg: largest phase lag, deg, in (0, 180), in the rule of thumb for `Limits.crossover_range`.

    InputError: another kind of system, a number out of its range, or a lag that is not in the plant.
    """
    plant = Rational.from_control(plant, "plant")
    number("dead time", dead_time, "s", ge=0)
    number("lag", lag, "s", ge=0)
    number("allowed lag", allowed_lag_deg, "deg", gt=0, lt=180)
    poles, zeros = plant.poles[plant.poles.real > 0], plant.zeros[plant.zeros.real > 0]
    p = float(poles.real.max(initial=0.0))
    peak = least_peak(poles, zeros, dead_time)
    structures = {"PI": plant, "PI-lead": _without_lag(plant, lag)}
    pi, pi_lead = (_phase_limit(name, system, dead_time, peak) for name, system in structures.items())
    return Limits(
        unstable_poles=tuple(complex(x) for x in poles),
        unstable_zeros=tuple(complex(x) for x in zeros),
        dead_time=float(dead_time),
        lag=float(lag),
        unstable_pole=p,
        doubling_time=math.log(2) / p if p > 0 else math.inf,
        actuator_product=p * (dead_time + lag),
        mt_bound=peak,
        ms_bound=peak,
        bode_integral=math.pi * float(poles.real.sum()),
        crossover_range=_crossover_range(poles, zeros, dead_time, math.radians(allowed_lag_deg)),
        allowed_lag_deg=allowed_lag_deg,
        pi=pi,
        pi_lead=pi_lead,
    )


def least_peak(poles: Complexes, zeros: Complexes, dead_time: float) -> float:
    """Return the lower bound, >= 1, of Ms and Mt over all stabilising controllers (Nevanlinna-Pick).

    `poles` and `zeros`, 1/s, have positive real parts and include conjugates; `dead_time` is in s. The bound is inf if
    a pole equals a zero, because no controller stabilises such a plant.
    """
    poles = _distinct(np.asarray(poles, dtype=complex))
    if poles.size == 0:
        return 1.0
    distance = poles[:, None] - zeros
    if np.any(distance == 0):
        return math.inf
    if dead_time * float(poles.real.max()) > _FASTEST:
        return math.inf  # outside the range of doubles, and not controllable in practice
    values = np.exp(dead_time * poles) * np.prod((poles[:, None] + np.conj(zeros)) / distance, axis=1)
    if poles.size == 1:
        return max(1.0, float(np.abs(values[0])))
    gram = 1 / (poles[:, None] + poles.conj())
    # scale to a unit diagonal, which does not change the eigenvalues and improves their accuracy
    scale = np.sqrt(2 * poles.real)
    gram = gram * np.outer(scale, scale)
    root = np.linalg.inv(np.linalg.cholesky(gram))
    largest = float(np.linalg.eigvalsh(root @ (values[:, None] * gram * values.conj()) @ root.conj().T)[-1])
    return max(1.0, math.sqrt(largest))


def _distinct(poles: Complexes) -> Complexes:
    kept: list[complex] = []
    for pole in poles[np.argsort(-poles.real)]:
        if all(abs(pole - other) > _DISTINCT * abs(pole) for other in kept):
            kept.append(complex(pole))
    return np.array(kept, dtype=complex)


def _without_lag(plant: Rational, lag: float) -> Rational:
    if lag == 0:
        return plant
    at = int(np.argmin(np.abs(plant.poles + 1 / lag))) if plant.poles.size else -1
    if at < 0 or abs(plant.poles[at] + 1 / lag) > 1e-6 / lag:
        raise InputError(f"lag: {lag:g} s is not in the plant (no pole at {-1 / lag:g} 1/s); give the plant's own lag")
    if plant.relative_degree == 0:
        return plant  # without this pole the plant would not be proper
    return Rational(plant.zeros, np.delete(plant.poles, at), plant.gain * lag)


def _crossover_range(
    poles: Complexes, zeros: Complexes, dead_time: float, allowed: float
) -> tuple[float, float] | None:
    def lag_of(omega: Floats) -> Floats:
        w = omega[..., None]
        from_poles = np.sum(np.pi - 2 * np.arctan2(w - poles.imag, poles.real), axis=-1)
        from_zeros = np.sum(2 * np.arctan2(w - zeros.imag, zeros.real), axis=-1)
        return np.asarray(from_poles + from_zeros + dead_time * omega)

    sizes = np.concatenate([np.abs(poles), np.abs(zeros), [1 / dead_time] if dead_time > 0 else []])
    if sizes.size == 0:
        return 0.0, math.inf
    omega = np.geomspace(1e-4 * sizes.min(), 1e4 * sizes.max(), 4001)
    excess = lag_of(omega) - allowed
    best = int(np.argmin(excess))
    if excess[best] > 0:
        return None
    below = np.flatnonzero(excess[:best] > 0)
    above = best + np.flatnonzero(excess[best:] > 0)

    def edge(i: int) -> float:
        root = bracketed_roots(lambda w, _: lag_of(w) - allowed, omega[[i]], omega[[i + 1]])
        return float(root[0])

    return (edge(int(below[-1])) if below.size else 0.0), (edge(int(above[0]) - 1) if above.size else math.inf)


def _phase_limit(structure: str, plant: Rational, dead_time: float, peak: float) -> StructureLimit | None:
    unstable = plant.poles[plant.poles.real >= 0]
    if unstable.size != 1 or unstable[0].real == 0 or np.any(plant.zeros.real >= 0) or plant.gain == 0:
        return None
    response = Response(plant * math.copysign(1.0, plant.gain), dead_time)
    nodes = frequency_nodes(response)
    phase, slope = response.phase(nodes)
    if slope[0] <= 0 and np.all(phase + np.pi <= 1e-12):
        return StructureLimit(structure, 0.0, math.nan, math.inf)
    top = int(np.argmax(phase))
    if top in (0, nodes.size - 1) or np.count_nonzero(np.diff(np.sign(phase[1:] + np.pi))) > 1:
        return None  # the phase has no maximum inside, or is above -180 deg in several bands
    omega = bracketed_roots(lambda w, _: response.phase(w)[1], nodes[[top - 1]], nodes[[top + 1]])
    most = float(response.phase(omega)[0][0]) + math.pi
    bound = 1 / (2 * math.sin(min(most, math.pi) / 2)) if most > 0 else math.inf
    return StructureLimit(structure, math.degrees(most), float(omega[0]), max(peak, bound))


SAMPLING_PERIOD = 0.005  #: s; measurement noise is white up to the Nyquist frequency of this period, 628 rad/s

_HORIZON = 20.0  # s, duration of the responses; the peak rates occur in the first seconds
_TIME_STEP = 1e-3  # s, time step of the responses
_NOISE_POINTS = 40_000  # frequencies; resolve the turns of the dead time (15 for 0.15 s) and every practical resonance
_VERY_FAST = 1e9  # 1/s, value of s at which C has its limit at infinity


@dataclass(frozen=True)
class Effort:
    """Control effort of a stable loop.

    - high_frequency_gain: gain of the controller at infinite frequency, |C(j infinity)|, N*m/(m/s).
    - noise_gain: ratio of the standard deviation of the commanded torque to that of the measurement noise, N*m/(m/s).
      The noise is white up to the Nyquist frequency w, and the ratio is sqrt(1/w * integral over 0..w of |C S|^2).
    - reference_rate: largest |rate| of the acting torque, N*m/s, after a step of 1 km/h of the reference.
    - disturbance_rate: largest |rate| of the acting torque, N*m/s, after an impulse of torque at the wheel that changes
      the slip velocity by 1 km/h.

    The rates are inf if the actuator has no lag and `high_frequency_gain` is not 0.
    """

    high_frequency_gain: float
    noise_gain: float
    reference_rate: float
    disturbance_rate: float


def control_effort(
    controller: Any, plant: Any, dead_time: float, *, lag: float, sampling_period: float = SAMPLING_PERIOD
) -> Effort:
    """Return the control effort of a controller in a loop that is known to be stable.

    - controller: linear system, or a function that returns C(s), N*m/(m/s), for a complex array s.
    - plant: linear system from commanded torque to -e, where e is the slip error, without the actuator's dead time.
    - dead_time, lag: dead time and lag of the actuator, s, >= 0.
    - sampling_period: sampling period of the noisy measurement, s, > 0.
    """
    number("dead time", dead_time, "s", ge=0)
    number("lag", lag, "s", ge=0)
    number("sampling period", sampling_period, "s", gt=0)
    plant = Rational.from_control(plant, "plant")
    if not callable(controller):
        controller = Rational.from_control(controller, "controller")

    def torque(s: Any) -> Complexes:
        c = np.asarray(controller(s))
        return np.asarray(c / (1 + c * plant(s) * np.exp(-dead_time * s)))

    far = np.asarray(controller(_VERY_FAST * np.array([1.0 + 0j, 10.0]))).real
    at_once = float(10 * far[1] - far[0]) / 9  # extrapolates C = C(inf) + c/s to infinity
    nyquist = math.pi / sampling_period
    omega = (np.arange(_NOISE_POINTS) + 0.5) * nyquist / _NOISE_POINTS
    noise = math.sqrt(float(np.mean(np.abs(torque(1j * omega)) ** 2)))
    wheel_gain = plant.gain * (lag or 1.0)

    # s times the slip velocity after a torque impulse that changes it by 1 m/s, without feedback
    def wheel(s: Any) -> Complexes:
        return np.asarray(plant(s) * (lag * s + 1) * s / wheel_gain)

    reference = _peak_rate(torque, lag, at_once)
    disturbance = _peak_rate(lambda s: torque(s) * wheel(s), lag, at_once)
    return Effort(abs(at_once), noise, KMH * reference, KMH * disturbance)


def _peak_rate(torque: Callable[[Any], Complexes], lag: float, at_once: float) -> float:
    """Return the largest |r(t)| for t >= 0, where r(t) has the Laplace transform torque(s)/(lag s + 1).

    `at_once` is the limit of torque(s) at infinity.
    """
    if lag == 0 and at_once != 0:
        return math.inf
    # a Fourier series of exp(-shift t) r(t); the term of r that falls as 1/s is added in closed form
    jump = at_once / (lag or 1.0)
    count = round(_HORIZON / _TIME_STEP)
    shift = 12.0 / _HORIZON  # aliasing from times after the horizon is damped by exp(-12)
    omega = 2 * np.pi * np.arange(count // 2 + 1) / _HORIZON
    # a cosine taper at high frequency avoids ringing
    taper = np.cos(np.pi / 2 * omega / omega[-1]) ** 2
    s = shift + 1j * omega
    series = np.fft.irfft((torque(s) - at_once) / (lag * s + 1) * taper, n=count) / _TIME_STEP
    t = np.arange(count) * _TIME_STEP
    inside = t < 0.7 * _HORIZON
    known = jump * np.exp(-t / lag) if lag > 0 else 0.0
    rate = (series * np.exp(shift * t) + known)[inside]
    return float(max(np.abs(rate).max(), abs(jump)))
