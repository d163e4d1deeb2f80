"""The limit cycle with the adhesion curve as it is: where its amplitude is no longer small beside the slip.

Periodic solution of the wheel's own rates, the law with its model, lag, dead time and relay, the speed frozen: slip
velocity and adhesion state at equidistant instants of a period, so that the rates hold at each of them (derivatives,
lag, dead time and relay by Fourier series), with s = 0 at both switches. The unknowns are these samples, the
frequency, the relay's share and the mean of s; Newton's method, from the linearised cycle or from a lower relay's.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from railslip_ctrl.core.errors import DomainError, InputError, KinkError
from railslip_ctrl.model.linearization import linearize, operating_point
from railslip_ctrl.model.numeric import numeric_plant, plant_parameters

from .actuation import actuator_response
from .law import FeedForward
from .limit_cycle import LimitCycle, linear_limit_cycle
from .simulate import slip_velocity_limit
from .surface_loop import SurfaceLoop

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]

_SAMPLES = 101  # odd, for a derivative without a lone highest harmonic; sigma falls as 1/k^3: 1/(2 50^2) is left out
_FINE = 1024  # times in a period at which peaks are looked for
_SOLVED = 1e-6  # residual, all unknowns being of order 1
_EVALUATIONS = 700  # of the residual: three Jacobians, one a column; what has not been found then is not near
_RATIO, _LEAST_RATIO = 1.3, 1.01  # of relays on the way up; where even 1 % more finds nothing, there is nothing
_SMALL = 0.3  # of the slip: the swing of the cycle the ladder starts from
_LEAST_OVER_LOAD = 1.15  # times the load: the lowest relay to start from; below it the load takes nearly all of K

LINEAR_CHANGE = 0.1
"""Change of the wheel's response over a cycle's swing up to which its linearisation holds; amplitudes are then good to
a tenth (tested against the nonlinear wheel)."""


class _Equations:
    """The periodic solution's residual; deviations from the operating point, phases of the period.

    Unknowns: sigma/scale, z/z_rest - 1 (left out for a static law), log omega, share, mean of s/scale.
    """

    def __init__(self, loop: SurfaceLoop, K: float, load: float, scale: float) -> None:
        self.loop, self.point, self.K, self.scale = loop, loop.plant.point, K, scale
        self.torque = loop.load - load  # at the wheel, what stands between the load asked for and the vehicle's own
        self.functions = numeric_plant(type(self.point.law))
        self.p = plant_parameters(self.point.law, self.point.vehicle)
        self.k = np.fft.rfftfreq(_SAMPLES, 1.0 / _SAMPLES)
        self.states = 2 if self.point.law.has_state else 1

    def split(self, x: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """Samples of sigma and z along the last axis; frequency, share and mean of s with a last axis of 1."""
        sigma = self.scale * x[..., :_SAMPLES]
        rest = self.point.adhesion_state or 0.0
        z = rest * (1 + x[..., _SAMPLES:-3]) if self.states == 2 else np.zeros(_SAMPLES)
        return sigma, z, np.exp(x[..., -3:-2]), x[..., -2:-1], self.scale * x[..., -1:]

    def residual(self, x: Floats) -> Floats:
        """What is to be nought, for unknowns along the last axis; further axes are further trials."""
        sigma, z, omega, share, mean = self.split(x)
        rate = self.time(1j * self.k * omega * self.series(sigma))
        sigma_rate, z_rate = self._rates(sigma, z, self.time(self.torque_series(x)))
        wheel = (rate - sigma_rate) / (omega * self.scale)
        switches = np.concatenate([np.zeros_like(share), share], axis=-1)
        ends = self.at(self.surface_series(sigma, omega, mean), switches) / self.scale
        closing = [np.mean(sigma, axis=-1, keepdims=True) / self.scale, ends]
        if self.states == 1:
            return np.concatenate([wheel, *closing], axis=-1)
        rest = self.point.adhesion_state or 1.0
        adhesion = (self.time(1j * self.k * omega * self.series(z)) - z_rate) / (omega * rest)
        return np.concatenate([wheel, adhesion, *closing], axis=-1)

    def jacobian(self, x: Floats) -> Floats:
        """Its derivatives, (residuals, unknowns), by forward differences: all unknowns' steps are one call."""
        steps = math.sqrt(np.finfo(float).eps) * np.where(x == 0.0, 1.0, np.abs(x))
        moved = self.residual(x + np.diag(steps)) - self.residual(x)
        return np.asarray((moved / steps[:, None]).T)

    def torque_series(self, x: Floats) -> Complexes:
        """Tb, N*m, by harmonics: law, dead time and lag."""
        sigma, z, omega, share, mean = self.split(x)
        loop, (M, J, B, r) = self.loop, self.p[:4]
        v, slip_velocity = self.point.speed, self.point.sigma + sigma
        Ta = r * self._model_force(slip_velocity, z)
        bracket = (1 / (r * M) + r / J) * Ta - r * B / J * (v - slip_velocity) / r - loop.gains.rho * sigma
        command = self.series(J / r * bracket) + loop.gains.D * self.surface_series(sigma, omega, mean)
        command = command + self.K * self.relay_series(share)
        return command * actuator_response(loop.actuator, np.asarray(1j * self.k * omega))

    def surface_series(self, sigma: Floats, omega: Floats, mean: Floats) -> Complexes:
        """s = mean - (sigma + rho int sigma), by harmonics."""
        k = self.k.copy()
        k[0] = 1.0  # the mean is set apart
        series = -self.series(sigma) * (1 + self.loop.gains.rho / (1j * k * omega))
        series[..., :1] = mean
        return series

    def at(self, series: Complexes, phase: Floats) -> Floats:
        """Values of a series at phases of the period, 0 to 1."""
        terms = series * np.where(self.k > 0, 2.0, 1.0)
        turns = np.exp(2j * np.pi * phase[..., None] * self.k)
        return np.asarray(np.real((turns @ terms[..., None])[..., 0]))

    def within(self, x: Floats) -> bool:
        """Whether slip velocity stays above 0, where the rates have a kink, and below `slip_velocity_limit`."""
        sigma = self.point.sigma + self.split(x)[0]
        return bool(sigma.min() > 0.0 and sigma.max() < slip_velocity_limit(self.point.law, self.point.speed))

    def relay_series(self, share: Floats) -> Complexes:
        """Of height 1, positive over [0, share)."""
        k = self.k[1:]
        return np.concatenate([2 * share - 1, (1 - np.exp(-2j * np.pi * k * share)) / (1j * np.pi * k)], axis=-1)

    def _model_force(self, sigma: Floats, z: Floats) -> Floats:
        v, none = self.point.speed, (0.0, 0.0, 0.0)
        if self.loop.feed_forward is FeedForward.OFF:
            return np.full_like(sigma, self.point.adhesion_force)
        if self.loop.feed_forward is FeedForward.REST:
            z = self.functions.rest_state(v, sigma, 0.0, *none, self.p)
        return np.asarray(self.functions.force(v, sigma, z, *none, self.p))

    def _rates(self, sigma: Floats, z: Floats, torque: Floats) -> tuple[Floats, Floats]:
        at = (self.point.speed, self.point.sigma + sigma, z, torque, self.torque, 0.0, self.p)
        _, sigma_rate, z_rate = self.functions.rates(*at)
        return sigma_rate, z_rate

    def series(self, values: Floats) -> Complexes:
        """Harmonics of samples."""
        return np.asarray(np.fft.rfft(values) / _SAMPLES)

    def time(self, series: Complexes) -> Floats:
        """Samples of harmonics."""
        return np.asarray(np.fft.irfft(series * _SAMPLES, _SAMPLES))


def linearisation_change(loop: SurfaceLoop, cycle: LimitCycle) -> float:
    """How much the wheel's response to torque at the cycle's frequency changes over the swing, relative to its middle.

    The larger of |P0/P - 1| at the two ends of the slip's swing, adhesion at rest there; inf where an end is outside
    0 to v or the adhesion law's domain. Up to `LINEAR_CHANGE` the linearised `cycle` of the `loop` is the wheel's.
    """
    point = loop.plant.point
    s = np.asarray(1j * cycle.frequency)
    here, changes = complex(loop.inverse_wheel(s)), []
    for sigma in (point.sigma - cycle.sigma_amplitude, point.sigma + cycle.sigma_amplitude):
        try:
            end = operating_point(point.law, point.vehicle, point.speed, sigma / point.speed, rail=point.rail)
            there = complex(replace(loop, plant=linearize(end)).inverse_wheel(s))
        except (DomainError, InputError, KinkError):
            return math.inf
        changes.append(abs(there / here - 1))
    return max(changes)


def nonlinear_limit_cycle(loop: SurfaceLoop, *, K: float | None = None, load: float | None = None) -> LimitCycle | None:
    """The limit cycle of the wheel with its adhesion curve; None where it leaves 0 to v or the adhesion law's domain.

    It may yet exist on both sides of 0, where the brake releases the wheel once a period: `simulated_limit_cycle`.
    The series' truncation leaves out 2e-4 of the swing.

    Parameters
    ----------
    loop : SurfaceLoop
    K, load : float, optional
        N*m, as of `predict_limit_cycle`; the load left out is the vehicle's own.

    Raises
    ------
    DomainError
        As `linear_limit_cycle`.
    """
    height, torque = loop.gains.K if K is None else K, loop.load if load is None else load
    linear = linear_limit_cycle(loop, K=height, load=torque)
    start = _start(loop, linear)
    if linear.sigma_amplitude < loop.plant.point.sigma:
        direct = _solve(loop, height, torque, start)
        if direct is not None:
            return _cycle(loop, height, torque, direct, linear.stable)
    found = _climb(loop, height, torque, linear)
    return None if found is None else _cycle(loop, height, torque, found, linear.stable)


def _climb(loop: SurfaceLoop, K: float, load: float, linear: LimitCycle) -> Floats | None:
    """The solution for K by way of lower relays; None where it leaves the range on the way."""
    lowest = max(_LEAST_OVER_LOAD * abs(load), K * _SMALL * loop.plant.point.sigma / linear.sigma_amplitude)
    if lowest >= K:
        return None
    height, ratio = lowest, _RATIO
    x = _solve(loop, height, load, _start(loop, linear_limit_cycle(loop, K=height, load=load)))
    while x is not None and height < K and ratio > _LEAST_RATIO:
        found = _solve(loop, min(height * ratio, K), load, x)
        if found is None:
            ratio = math.sqrt(ratio)
        else:
            height, x = min(height * ratio, K), found
    return x if height == K else None


def _solve(loop: SurfaceLoop, K: float, load: float, start: Floats) -> Floats | None:
    """Newton's method from a start; None where it finds nothing within the range of the model."""
    from scipy.optimize import root

    equations = _Equations(loop, K, load, loop.plant.point.sigma)
    search = _Search(equations)
    with np.errstate(all="ignore"), suppress(_TooLong):  # a step may leave the domain; it is then no solution
        root(search.residual, start, jac=search.jacobian, tol=1e-10)
    solved = float(np.abs(search.residuals).max()) < _SOLVED
    return search.best if solved and equations.within(search.best) else None


class _TooLong(Exception):
    """A search has had its evaluations."""


class _Search:
    """The residual and its derivatives while evaluations are left, and the best unknowns met."""

    def __init__(self, equations: _Equations) -> None:
        self.equations, self.evaluations = equations, 0
        self.best, self.residuals = np.zeros(0), np.full(1, np.inf)

    def residual(self, x: Floats) -> Floats:
        self._count(1)
        found = self.equations.residual(x)
        if np.linalg.norm(found) < np.linalg.norm(self.residuals):
            self.best, self.residuals = x.copy(), found
        return found

    def jacobian(self, x: Floats) -> Floats:
        self._count(x.size)
        return self.equations.jacobian(x)

    def _count(self, evaluations: int) -> None:
        if self.evaluations >= _EVALUATIONS:
            raise _TooLong
        self.evaluations += evaluations


def _start(loop: SurfaceLoop, linear: LimitCycle) -> Floats:
    """Unknowns of the linearised cycle."""
    scale = loop.plant.point.sigma
    equations = _Equations(loop, linear.K, linear.load, scale)
    share = 0.5 + 0.5 * (linear.load - loop.gains.D * linear.surface_mean) / linear.K
    k = np.maximum(equations.k, 1.0)
    swing = linear.K * equations.relay_series(np.array([share])) * loop.slip_response(k * linear.frequency)
    swing[0] = 0.0
    sigma = np.fft.irfft(swing * _SAMPLES, _SAMPLES)
    adhesion = np.zeros((equations.states - 1) * _SAMPLES)
    return np.array([*sigma / scale, *adhesion, math.log(linear.frequency), share, linear.surface_mean / scale])


def _cycle(loop: SurfaceLoop, K: float, load: float, x: Floats, stable: bool) -> LimitCycle:
    point = loop.plant.point
    equations = _Equations(loop, K, load, point.sigma)
    sigma, _, omega, share, mean = equations.split(x)
    surface = equations.surface_series(sigma, omega, mean)
    phase = np.linspace(0.0, 1.0, _FINE, endpoint=False)
    signals = [equations.at(series, phase) for series in (surface, equations.series(sigma))]
    torque = equations.at(equations.torque_series(x), phase)
    swing = _half_range(signals[1])
    return LimitCycle(
        method="nonlinear",
        K=K,
        load=load,
        layer=0.0,
        frequency=float(omega[0]),
        relay_gain=K * abs(complex(equations.relay_series(share)[1] / surface[1])),
        surface_amplitude=_half_range(signals[0]),
        sigma_amplitude=swing,
        torque_amplitude=_half_range(torque),
        surface_mean=float(mean[0]),
        slip_amplitude=swing / point.speed,
        sigma_range=(point.sigma + float(signals[1].min()), point.sigma + float(signals[1].max())),
        stable=stable,
    )


def _half_range(values: Floats) -> float:
    return float(0.5 * (values.max() - values.min()))
