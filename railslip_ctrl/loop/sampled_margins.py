"""Stability margins of a sampled loop, read off its exact frequency response on the unit circle.

Crossovers are bracketed on frequencies between which L turns and grows by little, and refined to rounding, as are
the peaks. The delay margin is not read off a crossover: more dead time changes the pulse transfer function itself
(what the hold lets through between samples); see `sampled_delay`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from .margins import RESPONSES, Margins
from .rootfinding import bracketed_roots
from .sampled_delay import added_delay
from .sampled_system import SampledSystem

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]

_NODES_PER_DECADE = 40
_BELOW_FEATURES = 1e-3  # of the slowest pole or zero; slower than that L is its asymptote
_STEP = 0.1  # largest change of arg L, rad, and of ln|L| between nodes
_REFINEMENTS = 12
_GAINS_EQUAL = 1e-9  # two gain limits that agree this well are one


def compute_sampled_margins(loop: SampledSystem) -> Margins:
    """Margins of a stable sampled loop; frequencies are > 0 and end at pi/h, which stands for infinity here."""
    nodes = _nodes(loop)
    response, slope = loop.response_and_slope(nodes)
    crossovers = _roots(loop, nodes, np.log(np.abs(response)), lambda value: np.log(np.abs(value)))
    limits = _gain_limits(loop, nodes, response)
    up = min((g for g in limits if g[0] > 1), default=(math.inf, math.nan))
    down = max((g for g in limits if g[0] < 1), default=(0.0, math.nan))
    signed = np.angle(-loop.frequency_response(crossovers), deg=True)  # of -L: 0 at the critical point
    smallest = int(np.argmin(np.abs(signed))) if signed.size else None
    delay, delay_frequency = added_delay(loop)
    (ms, ms_frequency), (mt, mt_frequency), (disk, disk_frequency) = _peaks(loop, nodes, response, slope)
    return Margins(
        gain_increase=up[0],
        gain_increase_frequency=up[1],
        gain_decrease=down[0],
        gain_decrease_frequency=down[1],
        phase_deg=math.inf if smallest is None else abs(float(signed[smallest])),
        phase_frequency=math.nan if smallest is None else float(crossovers[smallest]),
        delay_s=delay,
        delay_frequency=delay_frequency,
        ms=ms,
        ms_frequency=ms_frequency,
        mt=mt,
        mt_frequency=mt_frequency,
        disk=1.0 / disk,
        disk_frequency=disk_frequency,
        gain_crossovers=crossovers,
        phase_margins_deg=signed,
        phase_crossovers=np.array([frequency for _, frequency in limits]),
        phase_crossover_gains=np.array([factor for factor, _ in limits]),
    )


def stabilizing_range(loop: SampledSystem) -> tuple[float, float] | None:
    """The interval of loop-gain factors that stabilises and holds 1, else the nearest to 1 in ratio."""
    nodes = _nodes(loop)
    limits = _gain_limits(loop, nodes, loop.frequency_response(nodes))
    edges = [0.0, *sorted(factor for factor, _ in limits), math.inf]
    found = []
    for low, high in pairwise(edges):
        if high <= low * (1 + _GAINS_EQUAL):
            continue
        inside = math.sqrt(low * high) if low > 0 and high < math.inf else (0.5 * high if low == 0 else 2 * low)
        inside = 1.0 if math.isinf(inside) else inside
        if loop.scaled(inside).is_stable():
            distance = 0.0 if low <= 1 <= high else abs(math.log(high if high < 1 else low))
            found.append((distance, (low, high)))
    return min(found)[1] if found else None


def _nodes(loop: SampledSystem) -> Floats:
    """Frequencies up to pi/h, rad/s, ascending, between which L turns and grows by little."""
    top = loop.nyquist_frequency
    low = _BELOW_FEATURES * min(top, float(loop.feature_frequencies.min(initial=top)))
    slow = np.geomspace(low, top, int(_NODES_PER_DECADE * math.log10(top / low)) + 2)
    # the dead time turns L by at most a quarter of a turn between these
    fast = np.linspace(0.0, top, 3 + 2 * math.ceil(loop.dead_time / loop.period))[1:]
    nodes = np.union1d(slow[:-1], fast)
    for _ in range(_REFINEMENTS):
        with np.errstate(divide="ignore", invalid="ignore"):
            change = np.log(loop.frequency_response(nodes))
        turned = np.abs(np.angle(np.exp(1j * np.diff(change.imag))))
        coarse = (turned > _STEP) | (np.abs(np.diff(change.real)) > _STEP * 3)
        if not coarse.any():
            break
        nodes = np.union1d(nodes, 0.5 * (nodes[:-1] + nodes[1:])[coarse])
    return nodes


def _roots(loop: SampledSystem, nodes: Floats, values: Floats, function: Callable[[Complexes], Floats]) -> Floats:
    """Refined zeros of a real function of L between nodes where it changes sign."""
    at = np.flatnonzero(np.sign(values[:-1]) * np.sign(values[1:]) < 0)
    return bracketed_roots(lambda w, _: function(loop.frequency_response(w)), nodes[at], nodes[at + 1])


def _gain_limits(loop: SampledSystem, nodes: Floats, response: Complexes) -> list[tuple[float, float]]:
    """Loop-gain factors that put a pole on the unit circle, each with its frequency, by frequency."""
    limits = []
    dc, end = loop.dc_gain, float(response[-1].real)  # L is real at pi/h
    if -math.inf < dc < 0:
        limits.append((-1 / dc, 0.0))
    sideways = np.where(response.real < 0, response.imag, np.nan)
    sideways[-1] = 0.0
    found = _roots(loop, nodes, sideways, lambda value: value.imag / np.abs(value))
    size = np.abs(loop.frequency_response(found))
    limits += [(float(1 / s), float(w)) for s, w in zip(size, found, strict=True)]
    if end < 0:
        limits.append((-1 / end, float(nodes[-1])))
    return limits


def _peaks(loop: SampledSystem, nodes: Floats, response: Complexes, slope: Complexes) -> list[tuple[float, float]]:
    """Largest |S|, |T| and |S - 1/2| over 0 <= omega <= pi/h, and where, rad/s."""
    peaks = [_peak(loop, shape, nodes, *shape(response, slope)) for shape in RESPONSES]
    # with an integrator any |L| far beyond 1 gives the limit at 0
    start = np.array([loop.dc_gain if math.isfinite(loop.dc_gain) else 1e100], dtype=complex)
    at_zero = [float(shape(start, np.zeros(1, dtype=complex))[0][0]) for shape in RESPONSES]
    return [max(peak, (value, 0.0)) for peak, value in zip(peaks, at_zero, strict=True)]


def _peak(
    loop: SampledSystem,
    shape: Callable[[Complexes, Complexes], tuple[Floats, Floats]],
    nodes: Floats,
    value: Floats,
    rise: Floats,
) -> tuple[float, float]:
    """Largest value of one closed-loop response on (0, pi/h] and where, from its values and slopes at the nodes."""
    top = np.flatnonzero((value[1:-1] >= value[:-2]) & (value[1:-1] >= value[2:])) + 1
    # the peak lies on the side to which the response still rises
    rising = rise[top] > 0
    low, high = np.where(rising, nodes[top], nodes[top - 1]), np.where(rising, nodes[top + 1], nodes[top])
    refined = bracketed_roots(lambda w, _: shape(*loop.response_and_slope(w))[1], low, high)
    height = shape(*loop.response_and_slope(refined))[0]
    at = np.concatenate([refined, nodes[[0, -1]], nodes[top]])
    heights = np.concatenate([height, value[[0, -1]], value[top]])
    best = int(np.argmax(heights))
    return float(heights[best]), float(at[best])
