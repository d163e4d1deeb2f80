"""All gain and phase crossovers of L(s) = G(s) exp(-tau s).

On nodes placed at the scale of every pole and zero, completed by the extrema of ln|L| and of the phase, both
functions are monotone between neighbours, so that each crossover is found once and none is missed; it is then
refined to the last bits. The dead time needs no finer nodes: the continuous phase is known in closed form.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .rational import Rational
from .rootfinding import bracketed_roots

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

_NODES_PER_DECADE = 16  # between features; extrema are located exactly, so this only has to separate them
_NODES_PER_RESONANCE = 8  # per decade of distance from a complex root's own frequency
_AXIS_GAP = 1e-12  # relative half-width of the gap left around a root on the imaginary axis
# Phase crossovers are listed wherever |L| is above this (or what the caller asks), and at least these many: with dead
# time there are infinitely many, whose gains 1/|L| grow without bound beyond the last feature of a strictly proper L.
SMALLEST_LISTED = 1e-2
_LISTED_ALWAYS = 20
_MOST_LISTED = 5_000


@dataclass(frozen=True)
class Response:
    """L(j omega) with its logarithmic derivatives; G and tau held together."""

    system: Rational
    dead_time: float

    def log_magnitude(self, omega: Floats) -> tuple[Floats, Floats]:
        """ln|L| and d ln|L|/d omega."""
        return self.log_size(omega), self.log_size_slope(omega)

    def phase(self, omega: Floats) -> tuple[Floats, Floats]:
        """Continuous phase of L, rad, and its derivative."""
        return self.angle(omega), self.angle_slope(omega)

    def log_size(self, omega: Floats) -> Floats:
        """ln|L|."""
        return self.system.log_size(omega)

    def log_size_slope(self, omega: Floats) -> Floats:
        """d ln|L|/d omega."""
        return self.system.log_size_slope(omega)

    def angle(self, omega: Floats) -> Floats:
        """Continuous phase of L, rad."""
        return self.system.angle(omega) - self.dead_time * omega

    def angle_slope(self, omega: Floats) -> Floats:
        """Its derivative."""
        return self.system.angle_slope(omega) - self.dead_time

    def log_slope(self, omega: Floats) -> NDArray[np.complex128]:
        """d ln L(j omega)/d omega, complex."""
        return np.asarray(self.system.log_slope(omega) - 1j * self.dead_time)

    def __call__(self, omega: Floats) -> NDArray[np.complex128]:
        """L(j omega)."""
        value = self.system(1j * omega)
        with np.errstate(invalid="ignore"):
            turned = value * np.exp(-1j * self.dead_time * omega)
        return np.asarray(np.where(np.isinf(value), value, turned))


def frequency_nodes(response: Response) -> Floats:
    """Frequencies, rad/s, ascending, that resolve every feature of L, asymptotes included."""
    system = response.system
    roots = np.concatenate([system.zeros, system.poles])
    sizes = np.abs(roots)
    sizes = sizes[sizes > 0]
    scales = [*sizes, *_asymptotic_crossovers(system)]
    if response.dead_time > 0:
        scales.append(1.0 / response.dead_time)
    if not scales:
        scales = [1.0]
    low, high = 1e-4 * min(scales), 1e4 * max(scales)
    parts = [np.geomspace(low, high, int(_NODES_PER_DECADE * np.log10(high / low)) + 2)]
    for root in roots[roots.imag > 0]:
        width = max(abs(root.real), 1e-8 * root.imag)
        if width < root.imag:
            count = int(_NODES_PER_RESONANCE * np.log10(root.imag / width)) + 8
            offset = np.geomspace(0.05 * width, root.imag, count)
            parts += [root.imag - offset[:-1], root.imag + offset]
    on_axis = np.unique(roots.imag[(roots.real == 0) & (roots.imag > 0)])
    parts += [on_axis * (1 - _AXIS_GAP), on_axis * (1 + _AXIS_GAP)]
    nodes = np.unique(np.concatenate(parts))
    for frequency in on_axis:
        nodes = nodes[np.abs(nodes - frequency) > 0.5 * _AXIS_GAP * frequency]
    return nodes[nodes > 0]


def _asymptotic_crossovers(system: Rational) -> list[float]:
    """Where the low- and high-frequency asymptotes of |G| cross 1, rad/s."""
    if system.gain == 0:
        return []
    found = []
    if system.relative_degree > 0:
        found.append(abs(system.gain) ** (1.0 / system.relative_degree))
    elif abs(system.gain) != 1.0:
        # ln|G| tends to ln|gain| + curvature/omega^2
        curvature = 0.5 * float((np.sum(system.zeros**2) - np.sum(system.poles**2)).real)
        square = -curvature / np.log(abs(system.gain))
        found.append(float(np.sqrt(max(square, 0.0))))
    integrators = np.count_nonzero(system.poles == 0) - np.count_nonzero(system.zeros == 0)
    dc = abs(system.dc_gain)
    if np.isfinite(dc) and dc > 0:
        # ln|G| starts from ln|G(0)| + curvature omega^2: a crossover as low as |G(0)| is near 1
        curvature = 0.5 * float((np.sum(system.zeros**-2.0) - np.sum(system.poles**-2.0)).real)
        found.append(float(np.sqrt(max(-np.log(dc) / curvature, 0.0))) if curvature else 0.0)
    if integrators != 0:
        finite_z, finite_p = system.zeros[system.zeros != 0], system.poles[system.poles != 0]
        level = abs(system.gain) * np.exp(np.log(np.abs(finite_z)).sum() - np.log(np.abs(finite_p)).sum())
        found.append(float(level ** (1.0 / integrators)))
    return [f for f in found if np.isfinite(f) and 1e-150 < f < 1e150]


def _with_extrema(nodes: Floats, slope: Callable[[Floats], Floats]) -> Floats:
    """The nodes and the zeros of `slope` between them."""
    value = slope(nodes)
    at = np.flatnonzero(np.sign(value[:-1]) * np.sign(value[1:]) < 0)
    extrema = bracketed_roots(lambda x, _: slope(x), nodes[at], nodes[at + 1])
    return np.union1d(nodes, extrema)


def _axis_intervals(system: Rational, nodes: Floats) -> NDArray[np.bool_]:
    """Which intervals between nodes hold a root on the imaginary axis (no crossover is looked for there)."""
    roots = np.concatenate([system.zeros, system.poles])
    on_axis = np.sort(roots.imag[(roots.real == 0) & (roots.imag > 0)])
    return np.asarray(np.searchsorted(on_axis, nodes[1:]) > np.searchsorted(on_axis, nodes[:-1]))


def gain_crossovers(response: Response, nodes: Floats) -> Floats:
    """All omega > 0 with |L(j omega)| = 1, ascending, rad/s.

    A touch (an extremum of |L| equal to 1 within rounding) counts as a crossover.
    """
    if response.system.gain == 0:
        return np.array([])
    nodes = _with_extrema(nodes, response.log_size_slope)
    value = response.log_size(nodes)
    if np.all(np.abs(value) < 1e-12):
        return np.array([])  # all-pass: |L| = 1 everywhere
    crossing = (np.sign(value[:-1]) * np.sign(value[1:]) < 0) & ~_axis_intervals(response.system, nodes)
    at = np.flatnonzero(crossing)
    found = bracketed_roots(lambda w, _: response.log_size(w), nodes[at], nodes[at + 1])
    touching = nodes[1:-1][np.abs(value[1:-1]) < 1e-13]
    return np.unique(np.concatenate([found, touching]))


def _listed(count: NDArray[np.int_], size: Floats, smallest: float) -> NDArray[np.int_]:
    """How many of each interval's crossovers are listed, given the largest ln|L| within each interval."""
    first = np.cumsum(count) - count < _LISTED_ALWAYS
    large = size >= np.log(smallest)
    listed = np.where(large, count, np.where(first, np.minimum(count, _LISTED_ALWAYS), 0))
    # too many to list: those of the largest |L| matter most to the gain limits
    order = np.argsort(-size)
    beyond = order[np.cumsum(listed[order]) > _MOST_LISTED]
    listed[beyond] = np.where(first[beyond], np.minimum(listed[beyond], _LISTED_ALWAYS), 0)
    return listed


def phase_crossovers(
    response: Response, nodes: Floats, *, level: float = np.pi, smallest: float = SMALLEST_LISTED
) -> Floats:
    """Frequencies omega > 0 with arg L = level modulo 2 pi, ascending, rad/s.

    Complete wherever |L| >= smallest and for the first 20; beyond, with dead time, there are infinitely many.
    """
    if response.system.gain == 0:
        return np.array([])
    nodes = _with_extrema(nodes, response.angle_slope)
    # the largest |L| within an interval is at its ends only if the extrema of |L| are among them
    nodes = _with_extrema(nodes, response.log_size_slope)
    phase = response.angle(nodes)
    size = response.log_size(nodes)
    lower, upper = np.minimum(phase[:-1], phase[1:]), np.maximum(phase[:-1], phase[1:])
    first = np.ceil((lower - level) / (2 * np.pi))
    count = np.floor((upper - level) / (2 * np.pi)) - first + 1
    # a constant phase (a double integrator at -180 deg, say) crosses nothing
    flat = upper - lower < 4e-16 * (1 + np.abs(phase[:-1]))
    count[flat | _axis_intervals(response.system, nodes)] = 0
    count = np.maximum(count, 0).astype(int)
    count = _listed(count, np.maximum(size[:-1], size[1:]), smallest)
    at = np.repeat(np.arange(count.size), count)
    step = np.arange(at.size) - np.repeat(np.cumsum(count) - count, count)
    # within an interval the levels are met from the one nearest to its left end on
    falling = phase[:-1][at] > phase[1:][at]
    total = np.floor((upper - level) / (2 * np.pi)) - first
    number = np.where(falling, first[at] + total[at] - step, first[at] + step)
    target = level + 2 * np.pi * number
    found = bracketed_roots(lambda w, i: response.angle(w) - target[i], nodes[at], nodes[at + 1])
    return np.unique(found)
