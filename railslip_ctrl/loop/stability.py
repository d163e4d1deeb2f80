"""The exact number of closed-loop poles in the right half plane.

The closed-loop poles are the zeros of the quasi-polynomial Q(s) = D(s) + N(s) exp(-tau s), L = N exp(-tau s)/D.
Along s = j omega the argument of Q is known in closed form wherever |L| != 1: it is arg D + Arg(1 + L) where
|L| < 1 and arg N - tau omega + Arg(1 + 1/L) where |L| > 1, both principal values within +-90 deg. At a gain
crossover the two differ by 2 pi round(arg L/2 pi). So the gain crossovers, with the continuous phase there,
decide: no grid, no Pade, and poles on or near the axis need no indentation because where |L| is large only N
is looked at. This is the direct method of [WaltonMarshall1987] read at one dead time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .crossings import Response, frequency_nodes, gain_crossovers
from .rational import Rational, angle_sum

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

# L at a gain crossover this close to -1 (rad) puts a pole on the axis: rounding of the phase itself.
_ON_AXIS = 1e-12
_FARTHEST = 600.0  # dead times times 1/s; exp(600) is still a double
# Contour shift, relative to the loop's own frequencies, that takes poles on the axis to the counted side.
_SHIFT = 1e-7


@dataclass(frozen=True)
class RootCount:
    """Closed-loop poles right of a line; `marginal` if some lie on it (they are counted as right of it)."""

    right: float
    marginal: bool

    @property
    def stable(self) -> bool:
        """True if no pole lies right of or on the line."""
        return self.right == 0 and not self.marginal


def count_right_of(system: Rational, dead_time: float, line: float = 0.0) -> RootCount:
    """Count the closed-loop poles with real part > `line` (1/s) of L = G exp(-dead_time s), unity feedback.

    `inf` for a neutral loop whose chain of poles lies right of the line.
    """
    if dead_time * line < -_FARTHEST:
        return RootCount(float("inf"), False)  # so far left that exp(-tau line) overflows: beyond any use
    moved = system.shifted(line) * float(np.exp(-dead_time * line)) if line else system
    count, marginal = _count(moved, dead_time)
    if not marginal:
        return RootCount(count, False)
    scale = _shift_scale(moved)
    for attempt in range(1, 8):
        # not a multiple of itself, so that a pole met once by accident is not met again
        c = -_SHIFT * scale * attempt**1.37
        count, again = _count(moved.shifted(c) * float(np.exp(-dead_time * c)), dead_time)
        if not again:
            break
    return RootCount(count, True)


def _shift_scale(system: Rational) -> float:
    sizes = np.abs(np.concatenate([system.zeros, system.poles]))
    response = Response(system, 0.0)
    crossovers = gain_crossovers(response, frequency_nodes(response))
    sizes = np.concatenate([sizes[sizes > 0], crossovers])
    return float(sizes.min()) if sizes.size else 1.0


def _count(system: Rational, dead_time: float) -> tuple[float, bool]:
    """(closed-loop poles with positive real part, whether one is on the axis)."""
    order = system.poles.size
    axis_zeros, axis_poles = (r[r.real == 0] for r in (system.zeros, system.poles))
    if np.intersect1d(axis_zeros, axis_poles).size:
        return float("nan"), True  # a hidden mode on the axis is a closed-loop pole there
    if system.gain == 0:
        return float(np.count_nonzero(system.poles.real > 0)), bool(axis_poles.size)
    limit = abs(system.feedthrough)
    if dead_time > 0 and limit >= 1.0:
        return float("inf"), False  # neutral: a chain of poles tends to Re s = ln|G(inf)|/tau >= 0
    if system.feedthrough == -1.0:
        return float("inf"), False  # 1 + L(inf) = 0: not well posed
    dc = system.dc_gain
    if dc == -1.0:
        return float("nan"), True  # a pole at the origin
    response = Response(system, dead_time)
    nodes = frequency_nodes(response)
    crossovers = gain_crossovers(response, nodes)
    if crossovers.size == 0 and abs(response.log_size(nodes[:1])[0]) < 1e-12:
        return _count_all_pass(system)
    phase = response.angle(crossovers)
    turns = np.round(phase / (2 * np.pi))
    distance = np.pi - np.abs(phase - 2 * np.pi * turns)
    if np.any(distance <= _ON_AXIS * (1 + np.abs(phase))):
        return float("nan"), True
    return float(round(order / 2 - _rotation(response, nodes, crossovers, turns) / np.pi)), False


def _rotation(response: Response, nodes: Floats, crossovers: Floats, turns: Floats) -> float:
    """Change of arg Q(j omega) from omega = 0 to infinity, rad."""
    system = response.system
    origin = np.array([0.0])
    large = response.log_size(_between(nodes, crossovers)) > 0  # |L| > 1, interval by interval
    # the branch of arg Q follows the form in use; at a touch of |L| = 1 the form does not change
    jump = 2 * np.pi * float(np.sum(turns * (large[:-1].astype(float) - large[1:].astype(float))))
    negative = np.pi if system.gain < 0 else 0.0
    start = angle_sum(system.zeros, origin)[0] + negative if large[0] else angle_sum(system.poles, origin)[0]
    # far up the axis every continuous angle is 90 deg, left and right roots alike
    end = np.pi / 2 * system.zeros.size + negative if large[-1] else np.pi / 2 * system.poles.size
    return float(end + jump - start)


def _between(nodes: Floats, crossovers: Floats) -> Floats:
    """A frequency in each interval that the crossovers divide omega > 0 into."""
    if crossovers.size == 0:
        return nodes[:1]
    return np.concatenate([crossovers[:1] / 2, np.sqrt(crossovers[:-1] * crossovers[1:]), crossovers[-1:] * 2])


def _count_all_pass(system: Rational) -> tuple[float, bool]:
    """|L| = 1 at every frequency, no dead time: the polynomial D + N itself."""
    den, num = (np.atleast_1d(np.real(np.poly(roots))) for roots in (system.poles, system.zeros))
    characteristic = den + system.gain * num
    roots = np.roots(characteristic)
    near = np.abs(roots.real) <= 1e-10 * np.abs(roots)
    return float(np.count_nonzero((roots.real > 0) & ~near)), bool(near.any())
