"""Stability margins of a sampled loop, read off its exact frequency response on the unit circle.

Crossovers and peaks are bracketed by frequencies between which bounds show that none is hidden, and refined to
rounding. The delay margin is not read off a crossover: more dead time changes the pulse transfer function itself (what
the hold lets through between samples); see `sampled_delay`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from .margins import RESPONSES, Margins
from .rootfinding import bracketed_roots
from .sampled_boxes import ROUNDING, BoxedResponse
from .sampled_delay import added_delay
from .sampled_system import SampledSystem

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]

_ONE = 1e-9  # ln|L| that counts as 0 all along an interval
_SWAY = 0.75  # largest change of arg L from the middle of an interval, rad: less than an eighth of a turn
_PEAK = 1e-6  # by so much in ratio a peak may be higher than it is said to be, if another is as high
_NARROWEST = 1e-7  # half of an interval over its frequency: no further into a zero or pole of L on the circle
_GAINS_EQUAL = 1e-9  # two gain limits that agree this well are one


def compute_sampled_margins(loop: SampledSystem) -> Margins:
    """Margins of a stable sampled loop; frequencies are > 0 and end at pi/h, which stands for infinity here."""
    nodes = _nodes(loop)
    response, slope = loop.response_and_slope(nodes)
    size = np.log(np.abs(response))
    told = np.abs(size) > ROUNDING  # else its sign says nothing, as near 0 where L(0) = 1
    crossovers = _roots(loop, nodes[told], size[told], lambda value: np.log(np.abs(value)))
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
    nodes = _nodes(loop, peaks=False)
    limits = _gain_limits(loop, nodes, loop.frequency_response(nodes))
    edges = [0.0, *sorted(factor for factor, _ in limits), math.inf]
    intervals = [(low, high) for low, high in pairwise(edges) if high > low * (1 + _GAINS_EQUAL)]

    def distance(interval: tuple[float, float]) -> float:
        low, high = interval
        return 0.0 if low <= 1 <= high else abs(math.log(high if high < 1 else low))

    for low, high in sorted(intervals, key=distance):
        inside = math.sqrt(low * high) if low > 0 and high < math.inf else (0.5 * high if low == 0 else 2 * low)
        if loop.scaled(1.0 if math.isinf(inside) else inside).is_stable():
            return low, high
    return None


def _nodes(loop: SampledSystem, peaks: bool = True) -> Floats:
    """Frequencies up to pi/h, rad/s, ascending, between any two of which nothing is hidden.

    |L| - 1 and the phase less 180 deg each cross 0 at most once, and |S|, |T| and |S - 1/2| rise or fall, or stay
    below what they are at one of the nodes; halves of an interval are looked at until their bounds show it.
    """
    response, turns = BoxedResponse(loop), loop.held.periods + 1
    edges = response.first_edges()
    nodes, best = [edges], np.log(np.maximum(_at_zero(loop), 1e-300))
    theta, half = (edges[:-1] + edges[1:]) / 2, np.diff(edges) / 2
    while theta.size:
        expansion = response.expand(theta, np.full(theta.size, loop.held.fraction))
        logarithm, slope = expansion.value - 1j * turns * theta, expansion.slope - 1j * turns
        (_, rest, level), (_, twice, _) = expansion.bounds(half), expansion.bounds(2 * half)
        slack = twice / half  # of the slope, by Cauchy's estimate
        apart, change = np.abs(logarithm.real), np.abs(slope.real) * half + level
        sure = (apart > change) | (np.abs(slope.real) > slack) | (apart + change < _ONE)
        off = np.remainder(logarithm.imag, 2 * np.pi) - np.pi
        sway = np.abs(slope.imag) * half + rest
        sure &= (sway < _SWAY) & ((np.abs(off) > sway) | (np.abs(slope.imag) > slack))
        if peaks:
            value = np.exp(logarithm)
            heights, slopes = (
                np.array(each) for each in zip(*(shape(value, slope) for shape in RESPONSES), strict=True)
            )
            best = np.maximum(best, np.log(heights.max(axis=1)))
            rests = _shape_rests(value, np.abs(slope) * half, rest)
            bound = np.log(heights) + np.abs(slopes) * half + rests
            slacks = _shape_rests(value, np.abs(slope) * half * 2, twice) / half
            sure &= ((bound <= best[:, None] + _PEAK) | (np.abs(slopes) > slacks)).all(axis=0)
        parted = ~sure & (half > _NARROWEST * theta)
        theta, half = theta[parted], half[parted] / 2
        nodes.append(theta)
        theta, half = np.concatenate([theta - half, theta + half]), np.concatenate([half, half])
    return np.asarray(np.sort(np.concatenate(nodes)) / loop.period)


def _shape_rests(loop: Complexes, linear: Floats, rest: Floats) -> Floats:
    """How far ln of S, T and S - 1/2 can be from linear, (3, n), where ln L changes by `linear` and at most `rest`."""
    grown = np.expm1(linear + rest)

    def of_sum(part: Complexes) -> Floats:  # ln(1 + part (exp(u) - 1))
        moved = np.abs(part) * grown
        return np.asarray(np.abs(part) * (grown - linear) - np.log1p(-np.minimum(moved, 1)) - moved)

    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # 1 + L by L, or L times 1 + 1/L by 1/L: whichever is less
        plus, plus_inverse = of_sum(loop / (1 + loop)), of_sum(1 / (1 + loop))
        minus, minus_inverse = of_sum(loop / (1 - loop)), of_sum(1 / (1 - loop))
        found = [
            np.fmin(plus, rest + plus_inverse),
            np.fmin(rest + plus, plus_inverse),
            np.fmin(plus + minus, plus_inverse + minus_inverse),
        ]
    return np.asarray(np.where(np.isnan(found), np.inf, found))


def _at_zero(loop: SampledSystem) -> Floats:
    """|S|, |T| and |S - 1/2| at frequency 0; with an integrator any |L| far beyond 1 gives the limit."""
    start = np.array([loop.dc_gain if math.isfinite(loop.dc_gain) else 1e100], dtype=complex)
    with np.errstate(invalid="ignore"):  # the slope of S - 1/2 where L = 1
        return np.array([shape(start, np.zeros(1, dtype=complex))[0][0] for shape in RESPONSES])


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
    return [max(peak, (float(value), 0.0)) for peak, value in zip(peaks, _at_zero(loop), strict=True)]


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
