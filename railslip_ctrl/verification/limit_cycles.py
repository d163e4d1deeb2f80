"""The limit cycle of the relay behind the actuator: of the linearised loop, of the nonlinear wheel, and as simulated.

The relay's input is s, its output K sgn(s), and W leads from there to -s. A load (a constant torque the law leaves
out) shifts s until relay and D carry it together; the cycle is then not symmetric.

First harmonic ([Tsypkin1984], biased as in [Gelb1968]): with s = s0 + A sin, 1 + N W(j omega) = 0 and
N = 4 K/(pi A) sqrt(1 - (s0/A)^2), (2 K/pi) asin(s0/A) + D s0 = load. So frequency and N do not depend on K.

With every harmonic, so exactly for the linearised plant: v = K on a share of the period and -K on the rest, all
harmonics through W, s = 0 at both switches, and D s0 + K (2 share - 1) = load. Without load: Tsypkin's locus.

Both are the wheel's own only while the swing is small beside what the adhesion curve bends over. The nonlinear cycle
is the periodic solution of the wheel's own rates, the speed frozen: slip velocity and adhesion state at equidistant
instants of a period, so that the rates hold at each (derivatives, lag, dead time and relay by Fourier series), with
s = 0 at both switches; by Newton's method, from the linearised cycle or a lower relay's.

Slip below 0 is a wheel that the brake has released and that runs ahead; the adhesion laws are odd in it. A wheel is
lost where it locks or leaves its adhesion law's domain.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.arguments import Complexes, Floats
from railslip_ctrl.core.errors import DomainError, InputError, KinkError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH
from railslip_ctrl.loop.crossings import bracketed_roots
from railslip_ctrl.model.linearization import linearize, operating_point
from railslip_ctrl.model.numeric import numeric_plant, plant_parameters

from .fixed_step import END_SPEED, HeldRun, PublishedLaw, held_run, simulate_fine, slip_velocity_limit, whole_periods
from .relay_loop import SurfaceLoop, actuator_response

# W falls at least as 1/omega^2 with the lag, so that s misses about 1/(2 n^2) of itself beyond n harmonics
_HARMONICS = 400
_SOLVED = 1e-8  # residual relative to the relay's height and the cycle's amplitude
_SAMPLES = 1024  # times in a period at which peaks are looked for: misses a crest by less than 1e-5 of it
_LOWEST, _HIGHEST = 1e-3, 1e3  # rad/s, scanned for W < 0: slower than a stop, faster than any wheel's slip
_SCAN_POINTS = 16_001  # 0.09 % apart: at 1e3 rad/s a tenth of a turn of a dead time of 0.7 s
_TURNS = 30.0  # with a very short dead time the scan reaches to this many radians of it
_FARTHEST_GAIN = 1e3  # cycles a thousandth as large as the first, from higher turns of the dead time, are left out


@dataclass(frozen=True)
class LimitCycle:
    """A stable periodic solution of the loop with its relay (Loeb, by the describing function).

    K, load: N*m; frequency: rad/s; relay_gain: N at the cycle, N*m/(m/s), first harmonic over first harmonic;
    surface_amplitude, sigma_amplitude (m/s), torque_amplitude (N*m, acting): half of peak to peak; surface_mean: m/s;
    slip_amplitude: sigma_amplitude/v; sigma_range: least and largest slip velocity, m/s.
    """

    K: float
    load: float
    frequency: float
    relay_gain: float
    surface_amplitude: float
    sigma_amplitude: float
    torque_amplitude: float
    surface_mean: float
    slip_amplitude: float
    sigma_range: tuple[float, float]

    @property
    def period(self) -> float:
        """s."""
        return 2 * math.pi / self.frequency


@dataclass(frozen=True)
class CriticalGain:
    """A relay gain N (N*m/(m/s)) at which the linear loop has poles on the axis, at `frequency` (rad/s).

    `stable_below`: the loop is stable for N just below it, which makes the relay's cycle there a stable one.
    """

    gain: float
    frequency: float
    stable_below: bool


def critical_gains(loop: SurfaceLoop) -> list[CriticalGain]:
    """Every N > 0 with 1 + N W(j omega) = 0 of a `loop`, ascending; empty where the relay cannot oscillate.

    Crossings are bracketed on a grid from 1e-3 rad/s and refined to rounding; which side is stable is decided by the
    exact root count. Gains beyond a thousand times the smallest are left out.
    """
    dead_time = loop.actuator.dead_time
    scan = np.geomspace(_LOWEST, max(_HIGHEST, _TURNS / dead_time if dead_time > 0 else 0.0), _SCAN_POINTS)

    def imaginary(omega: Floats, _index: NDArray[np.intp] | None = None) -> Floats:
        value = loop.surface_response(omega)
        return np.asarray(value.imag / np.abs(value))

    values = imaginary(scan)
    at = np.flatnonzero(np.sign(values[:-1]) * np.sign(values[1:]) < 0)
    omega = bracketed_roots(imaginary, scan[at], scan[at + 1])
    real = loop.surface_response(omega).real
    pairs = sorted((-1.0 / float(w), float(o)) for w, o in zip(real, omega, strict=True) if w < 0)
    pairs = [(n, o) for n, o in pairs if n < _FARTHEST_GAIN * pairs[0][0]]
    edges = [0.0, *(n for n, _ in pairs)]
    return [
        CriticalGain(n, o, loop.is_stable(relay_gain=0.5 * (low + n)))
        for (n, o), low in zip(pairs, edges[:-1], strict=True)
    ]


def largest_relay_gain(loop: SurfaceLoop) -> float:
    """Largest gain that may stand for the relay, N*m/(m/s); inf where none destabilises, 0 where none stabilises."""
    stable = [c.gain for c in critical_gains(loop) if c.stable_below]
    if stable:
        return max(stable)
    return math.inf if loop.is_stable() else 0.0


def smallest_layer(loop: SurfaceLoop, K: float | None = None) -> float:
    """Boundary layer, m/s, from which on K sat(s/layer) no longer oscillates: K (N*m; the gains' own) over the largest
    stable relay gain; 0 where no finite gain destabilises. DomainError where the linear loop is unstable in any layer.
    """
    gain = largest_relay_gain(loop)
    if gain == 0.0:
        raise DomainError("boundary layer: the linear loop is unstable at every relay gain; change rho or D")
    return (loop.gains.K if K is None else K) / gain


def predict_limit_cycle(loop: SurfaceLoop, *, K: float | None = None, load: float = 0.0) -> LimitCycle:
    """The stable limit cycle by the describing function.

    K: height of the relay, N*m, left out the gains' own; load: constant torque that the relay has to carry, N*m.
    DomainError where the relay does not oscillate, or is not high enough to carry its share of the load.
    """
    height, point = loop.gains.K if K is None else K, loop.plant.point
    critical = next((one for one in critical_gains(loop) if one.stable_below), None)
    if critical is None:
        raise DomainError(
            "limit cycle: no relay gain takes the loop from stable to unstable, so there is no stable limit cycle"
        )
    ratio = _mean_over_amplitude(loop, height, load, critical.gain)
    amplitude = 4 * height / (math.pi * critical.gain) * math.sqrt(1 - ratio**2)
    omega, relay = critical.frequency, critical.gain * amplitude
    sigma, torque = (relay * abs(complex(one(omega))) for one in (loop.slip_response, loop.torque_response))
    return LimitCycle(
        *(height, load, omega, critical.gain, amplitude, sigma, torque),
        surface_mean=ratio * amplitude,
        slip_amplitude=sigma / point.speed,
        sigma_range=(point.sigma - sigma, point.sigma + sigma),
    )


def _mean_over_amplitude(loop: SurfaceLoop, K: float, load: float, gain: float) -> float:
    """s0/A from the balance of mean torques; A follows from it."""
    from scipy.optimize import brentq

    if not abs(load) < K:
        raise DomainError(
            f"K: {K:g} N*m does not carry the load of {load:g} N*m, so the relay rests on one side; give a larger K"
        )
    if load == 0:
        return 0.0

    def excess(x: float) -> float:
        amplitude = 4 * K / (math.pi * gain) * math.sqrt(1 - x * x)
        return 2 * K / math.pi * math.asin(x) + loop.gains.D * x * amplitude - abs(load)

    return math.copysign(float(brentq(excess, 0.0, 1.0)), load)


# --- with every harmonic ---------------------------------------------------------------------------------------------


def linear_limit_cycle(loop: SurfaceLoop, *, K: float | None = None, load: float = 0.0) -> LimitCycle:
    """The linearised loop's periodic solution with two switches a period, every harmonic counted, to about 1e-5.

    That which the describing function starts from; K, load and errors as of `predict_limit_cycle`; DomainError too
    where no such solution exists.
    """
    from scipy.optimize import root

    first = predict_limit_cycle(loop, K=K, load=load)
    height, bias = first.K, first.surface_mean / first.K
    share = 0.5 + math.asin(first.surface_mean / first.surface_amplitude) / math.pi

    def residual(x: Floats) -> Floats:
        omega, part, mean = float(np.exp(x[0])), float(x[1]), float(x[2])
        ends = mean - _series(loop.surface_response, omega, part, _turns(np.array([0.0, part])))
        return np.array([*(ends * first.relay_gain), loop.gains.D * mean + 2 * part - 1 - load / height])

    found = root(residual, np.array([math.log(first.frequency), share, bias]), tol=1e-12)
    omega, part, mean = float(np.exp(found.x[0])), float(found.x[1]), float(found.x[2])
    phase, turns = _over_a_period()
    surface = mean - _series(loop.surface_response, omega, part, turns)
    margin = 2.0 / _SAMPLES  # next to a switch s is 0 to rounding
    inside = (phase > margin) & (phase < part - margin)
    outside = (phase > part + margin) & (phase < 1 - margin)
    solved = np.abs(residual(found.x)).max() < _SOLVED and 0.0 < part < 1.0
    if not (solved and np.all(surface[inside] > 0) and np.all(surface[outside] < 0)):
        raise DomainError(
            f"limit cycle: with K = {height:g} N*m and a load of {load:g} N*m there is none with two switches a period "
            "(s would change sign in between); change K or the load"
        )
    sigma, torque = (height * _series(one, omega, part, turns) for one in (loop.slip_response, loop.torque_response))
    known = (height, load, omega, 1.0 / abs(complex(loop.surface_response(omega))))
    return _of_signals(loop, known, height * surface, loop.plant.point.sigma + sigma, torque, mean=height * mean)


def _of_signals(
    loop: SurfaceLoop,
    known: tuple[float, float, float, float],
    surface: Floats,
    sigma: Floats,
    torque: Floats,
    *,
    mean: float,
) -> LimitCycle:
    """The stable cycle of signals over a period; known: K, load, frequency and relay gain."""
    surface_amplitude, swing, torque_amplitude = (float(np.ptp(one)) / 2 for one in (surface, sigma, torque))
    limits = (float(sigma.min()), float(sigma.max()))
    amplitudes = (surface_amplitude, swing, torque_amplitude, mean, swing / loop.plant.point.speed)
    return LimitCycle(*known, *amplitudes, sigma_range=limits)


def _series(response: Callable[[Floats], Complexes], omega: float, share: float, turns: Complexes) -> Floats:
    """Response, without its mean, to a relay of height 1 that is positive over [0, share) of the period."""
    k = np.arange(1, _HARMONICS + 1)
    relay = (1 - np.exp(-2j * np.pi * k * share)) / (1j * np.pi * k)
    terms = response(np.asarray(k * omega, dtype=np.float64)) * relay
    return np.asarray(2 * np.real(turns @ terms))


def _turns(phase: Floats) -> Complexes:
    """exp(2 pi j k phase), by phase, 0 to 1, and harmonic k."""
    return np.asarray(np.exp(2j * np.pi * np.outer(phase, np.arange(1, _HARMONICS + 1))))


@cache
def _over_a_period() -> tuple[Floats, Complexes]:
    """The phases at which peaks are looked for, and their turns: the same for every cycle, and slow to work out."""
    phase = np.linspace(0.0, 1.0, _SAMPLES, endpoint=False)
    return phase, _turns(phase)


# --- with the adhesion curve as it is ---------------------------------------------------------------------------------


_INSTANTS = 101  # odd, for a derivative without a lone highest harmonic; sigma falls as 1/k^3: 1/(2 50^2) is left out
_FOUND = 1e-6  # residual, all unknowns being of order 1
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

    def __init__(self, loop: SurfaceLoop, K: float) -> None:
        self.loop, self.point, self.K, self.scale = loop, loop.plant.point, K, loop.plant.point.sigma
        self.functions = numeric_plant(type(self.point.law))
        self.p = plant_parameters(self.point.law, self.point.vehicle)
        self.k = np.fft.rfftfreq(_INSTANTS, 1.0 / _INSTANTS)
        self.states = 2 if self.point.law.has_state else 1

    def split(self, x: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """Samples of sigma and z along the last axis; frequency, share and mean of s with a last axis of 1."""
        sigma = self.scale * x[..., :_INSTANTS]
        rest = self.point.adhesion_state or 0.0
        z = rest * (1 + x[..., _INSTANTS:-3]) if self.states == 2 else np.zeros(_INSTANTS)
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
        Ta = r * np.asarray(self.functions.force(v, slip_velocity, z, 0.0, 0.0, 0.0, self.p))
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

    def _rates(self, sigma: Floats, z: Floats, torque: Floats) -> tuple[Floats, Floats]:
        at = (self.point.speed, self.point.sigma + sigma, z, torque, 0.0, 0.0, self.p)
        _, sigma_rate, z_rate = self.functions.rates(*at)
        return sigma_rate, z_rate

    def series(self, values: Floats) -> Complexes:
        """Harmonics of samples."""
        return np.asarray(np.fft.rfft(values) / _INSTANTS)

    def time(self, series: Complexes) -> Floats:
        """Samples of harmonics."""
        return np.asarray(np.fft.irfft(series * _INSTANTS, _INSTANTS))


def linearisation_change(loop: SurfaceLoop, cycle: LimitCycle) -> float:
    """How much the wheel's response to torque at the cycle's frequency changes over the swing, relative to its middle.

    The larger of |P0/P - 1| at the two ends of the slip's swing, adhesion at rest there; inf where an end is outside
    0 to v or the adhesion law's domain.
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


def nonlinear_limit_cycle(loop: SurfaceLoop, *, K: float | None = None) -> LimitCycle | None:
    """The limit cycle of the wheel with its adhesion curve; None where it leaves 0 to v or the adhesion law's domain.

    It may yet exist on both sides of 0, where the brake releases the wheel once a period: `simulated_limit_cycle`. The
    series' truncation leaves out 2e-4 of the swing. K and errors as of `linear_limit_cycle`; the load is the vehicle's
    own.
    """
    height, found = loop.gains.K if K is None else K, None
    linear = linear_limit_cycle(loop, K=height, load=loop.load)
    if linear.sigma_amplitude < loop.plant.point.sigma:
        found = _solve(loop, height, _start(loop, linear))
    if found is None:
        found = _climb(loop, height, linear)
    return None if found is None else _cycle(loop, height, found)


def _climb(loop: SurfaceLoop, K: float, linear: LimitCycle) -> Floats | None:
    """The solution for K by way of lower relays; None where it leaves the range on the way."""
    lowest = max(_LEAST_OVER_LOAD * abs(loop.load), K * _SMALL * loop.plant.point.sigma / linear.sigma_amplitude)
    if lowest >= K:
        return None
    height, ratio = lowest, _RATIO
    x = _solve(loop, height, _start(loop, linear_limit_cycle(loop, K=height, load=loop.load)))
    while x is not None and height < K and ratio > _LEAST_RATIO:
        found = _solve(loop, min(height * ratio, K), x)
        if found is None:
            ratio = math.sqrt(ratio)
        else:
            height, x = min(height * ratio, K), found
    return x if height == K else None


def _solve(loop: SurfaceLoop, K: float, start: Floats) -> Floats | None:
    """Newton's method from a start; None where it finds nothing within the range of the model."""
    from scipy.optimize import root

    equations, evaluations = _Equations(loop, K), 0
    best, least = np.zeros(0), np.full(1, np.inf)

    def count(more: int) -> None:
        nonlocal evaluations
        if evaluations >= _EVALUATIONS:
            raise _TooLong
        evaluations += more

    def residual(x: Floats) -> Floats:
        nonlocal best, least
        count(1)
        found = equations.residual(x)
        if np.linalg.norm(found) < np.linalg.norm(least):
            best, least = x.copy(), found
        return found

    def jacobian(x: Floats) -> Floats:
        count(x.size)
        return equations.jacobian(x)

    with np.errstate(all="ignore"), suppress(_TooLong):  # a step may leave the domain; it is then no solution
        root(residual, start, jac=jacobian, tol=1e-10)
    return best if float(np.abs(least).max()) < _FOUND and equations.within(best) else None


class _TooLong(Exception):
    """A search has had its evaluations."""


def _start(loop: SurfaceLoop, linear: LimitCycle) -> Floats:
    """Unknowns of the linearised cycle."""
    equations = _Equations(loop, linear.K)
    scale = equations.scale
    share = 0.5 + 0.5 * (linear.load - loop.gains.D * linear.surface_mean) / linear.K
    k = np.maximum(equations.k, 1.0)
    swing = linear.K * equations.relay_series(np.array([share])) * loop.slip_response(k * linear.frequency)
    swing[0] = 0.0
    sigma = np.fft.irfft(swing * _INSTANTS, _INSTANTS)
    adhesion = np.zeros((equations.states - 1) * _INSTANTS)
    return np.array([*sigma / scale, *adhesion, math.log(linear.frequency), share, linear.surface_mean / scale])


def _cycle(loop: SurfaceLoop, K: float, x: Floats) -> LimitCycle:
    equations = _Equations(loop, K)
    sigma, _, omega, share, mean = equations.split(x)
    surface = equations.surface_series(sigma, omega, mean)
    phase = np.linspace(0.0, 1.0, _SAMPLES, endpoint=False)
    slips = equations.scale + equations.at(equations.series(sigma), phase)
    torques = equations.at(equations.torque_series(x), phase)
    known = (K, loop.load, float(omega[0]), K * abs(complex(equations.relay_series(share)[1] / surface[1])))
    return _of_signals(loop, known, equations.at(surface, phase), slips, torques, mean=float(mean[0]))


# --- as simulated -----------------------------------------------------------------------------------------------------


_SETTLING, _MEASURED = 30.0, 20.0  # s, times the inertia scale: some 8 and 5 periods
_STEP = 2e-3  # s: the instant of a switch is good to a two-thousandth of a period of 4 s
_LAW_STEP = 5e-3  # s: extremes of the slip only
_OFFSET = 0.05  # of the reference, where the runs of the whole law start above it
_FROZEN = 60.0  # s, times the inertia scale
_STOP = 60.0  # s, times the inertia scale: longer than any stop


def simulated_limit_cycle(loop: SurfaceLoop, *, K: float | None = None) -> LimitCycle | None:
    """The cycle measured in a fine simulation, adaptation off, speed frozen; None where the wheel is lost.

    The load is the vehicle's own; K, N*m, left out the gains' own. DomainError where s does not cycle.
    """
    height, point = loop.gains.K if K is None else K, loop.plant.point
    law = PublishedLaw(point, replace(loop.gains, K=height, k=0.0))
    scale = point.vehicle.inertia_scale
    duration = (_SETTLING + _MEASURED) * scale
    try:
        run = simulate_fine(point, law, loop.actuator, duration=duration, step=_STEP, offset=_OFFSET * point.sigma)
    except DomainError:
        return None
    period, run = whole_periods(run.after(_SETTLING * scale))
    turn = np.exp(-2j * math.pi / period * run.time)
    gain = abs(np.sum(height * np.sign(run.surface) * turn) / np.sum(run.surface * turn))
    known = (height, loop.load, 2 * math.pi / period, float(gain))
    return _of_signals(loop, known, run.surface, run.sigma, run.torque, mean=float(run.surface.mean()))


def law_runs(loop: SurfaceLoop) -> dict[str, HeldRun]:
    """The law with relay, adaptation and actuator, from 5 % above the reference, undisturbed and with known parameters.

    At the loop's speed, frozen, for 60 s times the inertia scale; and with the speed falling from it to 5 km/h.
    """
    point, runs = loop.plant.point, {}
    for name, frozen in ((f"{point.speed / KMH:.3g} km/h frozen", True), ("speed falling", False)):
        law = PublishedLaw(point, loop.gains, frozen=frozen)
        known: dict[str, Any] = {"offset": _OFFSET * point.sigma, "frozen": frozen, "end_speed": END_SPEED}
        known |= {"duration": (_FROZEN if frozen else _STOP) * point.vehicle.inertia_scale, "step": _LAW_STEP}
        runs[name] = held_run(partial(simulate_fine, point, law, loop.actuator, **known), point.slip)
    return runs
