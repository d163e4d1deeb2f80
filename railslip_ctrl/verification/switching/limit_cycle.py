"""The limit cycle of the relay in the linearised loop around s: describing function, and with every harmonic.

The relay's input is s, its output K sgn(s), and W leads from there to -s. A load (a constant torque the law leaves
out) shifts s until relay and D carry it together; the cycle is then not symmetric.

First harmonic ([Tsypkin1984], biased as in [Gelb1968]): with s = s0 + A sin, 1 + N W(j omega) = 0 and
N = 4 K/(pi A) sqrt(1 - (s0/A)^2), (2 K/pi) asin(s0/A) + D s0 = load. So frequency and N do not depend on K.

With every harmonic, so exactly for the linearised plant: v = K on a share of the period and -K on the rest, all
harmonics through W, s = 0 at both switches, and D s0 + K (2 share - 1) = load. Without load: Tsypkin's locus.

Both are the wheel's own only while the swing is small beside what the adhesion curve bends over: see
`nonlinear_cycle`, which also has the cycle of the wheel as it is.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from railslip_ctrl.core.errors import DomainError, InputError
from railslip_ctrl.loop.crossings import bracketed_roots

from .surface_loop import SurfaceLoop

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]

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
    """A periodic solution of the loop with its relay.

    Attributes
    ----------
    method : str
        "describing function" or "linearised" (every harmonic), both of the linearised loop; "nonlinear"; "simulated".
    K, load, layer : float
        N*m, N*m, and m/s (0 is the relay).
    frequency : float
        rad/s.
    relay_gain : float
        N at the cycle, N*m/(m/s): describing-function value; of the others first harmonic over first harmonic.
    surface_amplitude, sigma_amplitude, torque_amplitude : float
        m/s, m/s, N*m (acting torque): half of peak to peak.
    surface_mean : float
        m/s.
    slip_amplitude : float
        sigma_amplitude/v, slip ratio.
    sigma_range : tuple of float
        Least and largest slip velocity, m/s.
    stable : bool
        By the describing function (Loeb): a larger amplitude, hence a smaller N, makes the linear loop stable.
    """

    method: str
    K: float
    load: float
    layer: float
    frequency: float
    relay_gain: float
    surface_amplitude: float
    sigma_amplitude: float
    torque_amplitude: float
    surface_mean: float
    slip_amplitude: float
    sigma_range: tuple[float, float]
    stable: bool

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

    Crossings are bracketed on a grid from 1e-3 to 1e3 rad/s and refined to rounding; which side is stable is decided
    by the exact root count. Gains beyond a thousand times the smallest are left out.
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
    """Boundary layer, m/s, from which on K sat(s/layer) no longer oscillates: K over the largest stable relay gain.

    Parameters
    ----------
    loop : SurfaceLoop
    K : float, optional
        Height of the relay, N*m; left out, the gains' own.

    Returns
    -------
    float
        0 where no finite gain destabilises.

    Raises
    ------
    DomainError
        The linear loop is unstable within any layer.
    """
    gain = largest_relay_gain(loop)
    if gain == 0.0:
        raise DomainError("boundary layer: the linear loop is unstable at every relay gain; change rho or D")
    return (loop.gains.K if K is None else K) / gain


def relay_describing_function(amplitude: float, K: float, mean: float = 0.0) -> float:
    """N of a relay of height K at an input mean + amplitude sin, N*m/(m/s); |mean| < amplitude."""
    return 4 * K / (math.pi * amplitude) * math.sqrt(1 - (mean / amplitude) ** 2)


def layer_describing_function(amplitude: float, K: float, layer: float) -> float:
    """N of K sat(s/layer) at amplitude sin, N*m/(m/s): K/layer within the layer, the relay's far outside."""
    if amplitude <= layer:
        return K / layer
    x = layer / amplitude
    return 2 * K / (math.pi * layer) * (math.asin(x) + x * math.sqrt(1 - x * x))


def predict_limit_cycle(loop: SurfaceLoop, *, K: float | None = None, load: float = 0.0) -> LimitCycle:
    """The stable limit cycle by the describing function.

    Parameters
    ----------
    loop : SurfaceLoop
    K : float, optional
        Height of the relay, N*m; left out, the gains' own.
    load : float
        Constant torque that the relay has to carry, N*m.

    Raises
    ------
    DomainError
        The relay does not oscillate, or is not high enough to carry its share of the load.
    """
    height = loop.gains.K if K is None else K
    critical = _oscillation(loop)
    ratio = _mean_over_amplitude(loop, height, load, critical.gain)
    amplitude = 4 * height / (math.pi * critical.gain) * math.sqrt(1 - ratio**2)
    return _harmonic_cycle(loop, critical, amplitude, ratio * amplitude, (height, load, 0.0))


def predict_layer_cycle(loop: SurfaceLoop, layer: float, *, K: float | None = None) -> LimitCycle | None:
    """The stable limit cycle with a boundary layer (m/s, > 0), by its describing function; None where there is none.

    Without load. InputError for a layer that is not positive, DomainError where even the relay does not oscillate.
    """
    from scipy.optimize import brentq

    if not (math.isfinite(layer) and layer > 0):
        raise InputError(f"layer: {layer} m/s is not allowed; give a finite value > 0")
    height = loop.gains.K if K is None else K
    critical = _oscillation(loop)
    if height / layer <= critical.gain:
        return None
    widest = 4 * height / (math.pi * critical.gain)  # the relay's own amplitude, always the larger
    amplitude = float(brentq(lambda a: layer_describing_function(a, height, layer) - critical.gain, layer, widest))
    return _harmonic_cycle(loop, critical, amplitude, 0.0, (height, 0.0, layer))


def _oscillation(loop: SurfaceLoop) -> CriticalGain:
    for critical in critical_gains(loop):
        if critical.stable_below:
            return critical
    raise DomainError(
        "limit cycle: no relay gain takes the loop from stable to unstable, so there is no stable limit cycle"
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


def _harmonic_cycle(
    loop: SurfaceLoop, critical: CriticalGain, amplitude: float, mean: float, case: tuple[float, float, float]
) -> LimitCycle:
    omega = critical.frequency
    relay = critical.gain * amplitude
    sigma = relay * abs(complex(loop.slip_response(omega)))
    return LimitCycle(
        method="describing function",
        K=case[0],
        load=case[1],
        layer=case[2],
        frequency=omega,
        relay_gain=critical.gain,
        surface_amplitude=amplitude,
        sigma_amplitude=sigma,
        torque_amplitude=relay * abs(complex(loop.torque_response(omega))),
        surface_mean=mean,
        slip_amplitude=sigma / loop.plant.point.speed,
        sigma_range=(loop.plant.point.sigma - sigma, loop.plant.point.sigma + sigma),
        stable=critical.stable_below,
    )


# --- with every harmonic ---------------------------------------------------------------------------------------------


def linear_limit_cycle(loop: SurfaceLoop, *, K: float | None = None, load: float = 0.0) -> LimitCycle:
    """The linearised loop's periodic solution with two switches a period, every harmonic counted.

    Exact for the linearised plant to the truncation of its Fourier series, about 1e-5. The solution found is the one
    the describing function starts from; s is checked to have one sign between switches.

    Parameters
    ----------
    loop : SurfaceLoop
    K, load : float
        N*m, as of `predict_limit_cycle`.

    Raises
    ------
    DomainError
        As `predict_limit_cycle`; or no such solution exists with two switches a period.
    """
    from scipy.optimize import root

    first = predict_limit_cycle(loop, K=K, load=load)
    height = first.K
    bias = first.surface_mean / height
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
    swing = height * _series(loop.slip_response, omega, part, turns)
    sigma = _half_range(swing)
    fundamental = complex(loop.surface_response(omega))
    return LimitCycle(
        method="linearised",
        K=height,
        load=load,
        layer=0.0,
        frequency=omega,
        relay_gain=1.0 / abs(fundamental),
        surface_amplitude=height * _half_range(surface),
        sigma_amplitude=sigma,
        torque_amplitude=height * _half_range(_series(loop.torque_response, omega, part, turns)),
        surface_mean=height * mean,
        slip_amplitude=sigma / loop.plant.point.speed,
        sigma_range=(loop.plant.point.sigma + float(swing.min()), loop.plant.point.sigma + float(swing.max())),
        stable=first.stable,
    )


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


def _half_range(values: Floats) -> float:
    return float(0.5 * (values.max() - values.min()))


def tsypkin_locus(loop: SurfaceLoop, omega: float) -> complex:
    """Tsypkin's locus at omega (rad/s): sum over odd k of Re W(j k omega) + j Im W(j k omega)/k, (m/s)/(N*m).

    A symmetric limit cycle has Im = 0 and Re < 0 ([Tsypkin1984]): s = 0 at the switch, and passing through it the
    right way.
    """
    k = np.arange(1, 2 * _HARMONICS, 2)
    w = loop.surface_response(k * omega)
    return complex(np.sum(w.real), np.sum(w.imag / k))
