"""Many dead-time loops on one flat list of points, ordered by loop and frequency, for `batch`.

The points divide each loop's axis into pieces, from a point to the next of the same loop, on which ln|L| and the
continuous phase are both monotone: on a piece a zero is bracketed by its ends, and the responses are bounded by them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .margins import RESPONSES, box_bounds
from .rootfinding import bracketed_roots

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]
    Indices = NDArray[np.intp]

DELICATE = 1e-9
"""A quantity this close to its threshold is left to the scalar engine; rounding is 1e-6 of it."""

_NODES_PER_DECADE = 16  # as in `crossings`: extrema are located exactly, so nodes only have to separate them
_NODES_PER_RESONANCE = 8  # per decade of distance from a complex root's own frequency, as in `crossings`
_REACH = 1e4  # the nodes reach this factor beyond the lowest and highest feature
_FAR, _NODES_FAR_OUT = 1e3, 4  # of which the outer part, where L is all but its asymptote, has fewer
_WIDEST = 1e24  # ratio of highest to lowest node beyond which a loop would make its whole chunk slow
_EXTREME = 1e60  # frequencies beyond it (rad/s), or below its reciprocal, could overflow when squared
_LEAST_DAMPING = 1e-7  # |Re|/|Im| of a root below which it is taken as on the axis
_PHASE_STEP = 0.25  # rad, of a piece searched for a peak; as in `margins`
_MOST_PARTS = 500
_MOST_HALVINGS = 6  # of a piece on which |L| may cross 1 unseen; a loop that has one left is delicate
_BLOCK = 1024  # points evaluated together: few calls where they are few, and in the cache where they are many


@dataclass(frozen=True)
class Loops:
    """n loops: roots of shape (m, n), `sign` (m,) +1 for zeros and -1 for poles, gain and dead time (n,)."""

    real: Floats
    imag: Floats
    sign: Floats
    gain: Floats
    dead_time: Floats

    def take(self, index: Indices) -> Loops:
        return Loops(self.real[:, index], self.imag[:, index], self.sign, self.gain[index], self.dead_time[index])

    def right(self, sign: int) -> Floats:
        """Number of zeros (+1) or poles (-1) with positive real part, (n,)."""
        return np.asarray((self.real[self.sign == sign] > 0).sum(axis=0), dtype=float)

    def at_origin(self, sign: int) -> Floats:
        """Number of zeros (+1) or poles (-1) at s = 0, (n,)."""
        chosen = self.sign == sign
        return np.asarray(((self.real[chosen] == 0) & (self.imag[chosen] == 0)).sum(axis=0), dtype=float)

    def dc_gain(self) -> Floats:
        """L(0), (n,); infinite with an integrator, 0 with a zero at the origin, NaN with both."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            turned = self.gain * np.where((self.real > 0).sum(axis=0) % 2, -1.0, 1.0)
            return np.asarray(turned * np.exp(self.sign @ np.log(np.hypot(self.real, self.imag))))

    def evaluate(self, omega: Floats, row: Indices) -> Points:
        """L(j omega) of loop number `row`, in logarithmic form; arrays (N,). The formulas are those of `Rational`."""
        log_gain, turned = np.log(np.abs(self.gain)), np.where(self.gain < 0, np.pi, 0.0)
        values = np.empty((4, omega.size))
        for start in range(0, omega.size, _BLOCK):
            part = slice(start, start + _BLOCK)
            at, one = omega[part], row[part]
            real, tau = self.real[:, one], self.dead_time[one]
            offset = at - self.imag[:, one]
            square = offset * offset + real * real
            angle = np.arctan2(offset, np.abs(real))
            phase = self.sign @ np.where(real > 0, np.pi - angle, angle)
            values[0, part] = log_gain[one] + 0.5 * (self.sign @ np.log(square))
            values[1, part] = self.sign @ (offset / square)
            values[2, part] = turned[one] + phase - tau * at
            values[3, part] = -(self.sign @ (real / square)) - tau
        return Points(row, omega, *values)


@dataclass(frozen=True)
class Points:
    """Frequencies ordered by loop, then ascending: ln|L| and the continuous phase there, with their slopes; (N,)."""

    row: Indices
    omega: Floats
    size: Floats
    size_slope: Floats
    phase: Floats
    phase_slope: Floats

    def take(self, chosen: Indices | Flags) -> Points:
        return Points(self.row[chosen], *(a[chosen] for a in self._values()))

    def inserted(self, at: Indices, others: Points) -> Points:
        """With `others` put in behind the points number `at`."""
        pairs = zip(self._values(), others._values(), strict=True)
        return Points(np.insert(self.row, at + 1, others.row), *(np.insert(a, at + 1, b) for a, b in pairs))

    def _values(self) -> tuple[Floats, ...]:
        return self.omega, self.size, self.size_slope, self.phase, self.phase_slope

    def changes(self, value: Floats) -> Indices:
        """Numbers of the pieces (point i to i + 1 of one loop) on which `value` changes sign."""
        signs = np.sign(value)
        return np.flatnonzero((signs[:-1] * signs[1:] < 0) & (self.row[:-1] == self.row[1:]))

    def responses(self) -> tuple[Floats, Floats]:
        """|S|, |T|, |S - 1/2| and their logarithmic slopes, both of shape (3, N)."""
        loop = np.exp(np.clip(self.size, -300, 300) + 1j * self.phase)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            both = [shape(loop, self.size_slope + 1j * self.phase_slope) for shape in RESPONSES]
        return np.array([value for value, _ in both]), np.array([slope for _, slope in both])


def band(loops: Loops) -> tuple[Floats, Floats, Flags]:
    """Lowest and highest node of each loop, rad/s, and which loops are not for the vectorised way, each (n,)."""
    real, imag, sign, gain = loops.real, loops.imag, loops.sign, loops.gain
    sizes = np.hypot(real, imag)
    finite = sizes > 0
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        level = np.log(np.abs(gain)) + sign @ np.where(finite, np.log(sizes), 0.0)
        slope = loops.at_origin(-1) - loops.at_origin(1)
        inverse = np.where(finite, 1.0 / (real + 1j * imag), 0.0)
        curvature = 0.5 * (sign @ (inverse * inverse).real)
        # where the asymptotes of |G| at high and at low frequency cross 1; see crossings._asymptotic_crossovers
        top = np.exp(np.log(np.abs(gain)) / -sign.sum())
        bottom = np.where(slope != 0, np.exp(level / slope), np.sqrt(np.maximum(-level / curvature, 0.0)))
        scales = np.array([*sizes, top, bottom, 1.0 / loops.dead_time])
        scales[~((scales > 0) & np.isfinite(scales))] = np.nan
        low, high = np.fmin.reduce(scales) / _REACH, np.fmax.reduce(scales) * _REACH
        dc = loops.dc_gain()
        delicate = ~((low > 1 / _EXTREME) & (high < _EXTREME) & (high < _WIDEST * low))  # NaN included
        delicate |= (np.abs(real) <= _LEAST_DAMPING * np.abs(imag)).any(axis=0, where=imag != 0)
        delicate |= (loops.at_origin(1) > 0) & (loops.at_origin(-1) > 0)
        delicate |= (gain == 0) | (np.abs(1 + dc) < DELICATE)
    return low, high, delicate


def _nodes(loops: Loops, low: Floats, high: Floats) -> Points:
    """Points that resolve every feature of each loop, asymptotes included."""
    begin, end = low * _FAR, high / _FAR
    parts = [
        _spaced(*ends)
        for ends in ((low, begin, _NODES_FAR_OUT), (begin, end, _NODES_PER_DECADE), (end, high, _NODES_FAR_OUT))
    ]
    for real, imag in zip(np.abs(loops.real), loops.imag, strict=True):
        resonant = real < imag
        if resonant.any():
            narrowest = (imag[resonant] / real[resonant]).max()
            fraction = np.linspace(0.0, 1.0, int(_NODES_PER_RESONANCE * np.log10(20 * narrowest)) + 8)
            width = np.where(resonant, 0.05 * real, 1.0)[:, None]
            centre = np.where(resonant, imag, 1.0)[:, None]
            offset = width * (centre / width) ** fraction
            around = np.concatenate([centre - offset[:, :-1], centre + offset], axis=1)
            parts.append(np.where(resonant[:, None], around, low[:, None]))  # repeated nodes are dropped below
    omega = np.sort(np.concatenate(parts, axis=1), axis=1)
    new = np.diff(omega, axis=1, prepend=0.0) > 0
    return loops.evaluate(omega[new], np.nonzero(new)[0])


def _spaced(low: Floats, high: Floats, per_decade: int) -> Floats:
    """Equal in ratio from `low` to `high`, (n,): shape (n, m), as dense as asked or denser."""
    ratio = (high / low)[:, None]
    return np.asarray(low[:, None] * ratio ** np.linspace(0.0, 1.0, int(per_decade * np.log10(ratio.max())) + 2))


def located(loops: Loops, points: Points, at: Indices, function: Callable[[Points, Indices], Floats]) -> Points:
    """The points within the pieces number `at` where `function`, of points and places in `at`, is zero."""
    rows, all_of_them = points.row[at], np.arange(at.size)
    omega = bracketed_roots(
        lambda x, i: function(loops.evaluate(x, rows[i]), i),
        points.omega[at],
        points.omega[at + 1],
        ends=(function(points.take(at), all_of_them), function(points.take(at + 1), all_of_them)),
    )
    return loops.evaluate(omega, rows)


def monotone(loops: Loops, low: Floats, high: Floats) -> tuple[Points, Flags]:
    """Points from `low` to `high`, rad/s, (n,), with all extrema of ln|L| and of the phase that show between nodes; and
    the loops where |L| all but touches 1, or may cross it unseen between two points."""
    points = _nodes(loops, low, high)
    at = points.changes(points.size_slope)
    extrema = located(loops, points, at, lambda found, _: found.size_slope)
    delicate = np.zeros(loops.gain.size, dtype=bool)
    delicate[extrema.row[np.abs(extrema.size) < DELICATE]] = True
    points = points.inserted(at, extrema)
    at = points.changes(points.phase_slope)
    points = points.inserted(at, located(loops, points, at, lambda found, _: found.phase_slope))
    pieces = np.flatnonzero(points.row[:-1] == points.row[1:])
    for _ in range(_MOST_HALVINGS):
        pieces = pieces[_may_cross_unseen(loops, points, pieces)]
        if pieces.size == 0:
            return points, delicate
        middle = loops.evaluate(0.5 * (points.omega[pieces] + points.omega[pieces + 1]), points.row[pieces])
        points = points.inserted(pieces, middle)
        pieces = pieces + np.arange(pieces.size)
        pieces = np.sort(np.concatenate([pieces, pieces + 1]))
    delicate[points.row[pieces]] = True
    return points, delicate


def _may_cross_unseen(loops: Loops, points: Points, at: Indices) -> Flags:
    """On which of the pieces number `at` |L| may cross 1 other than its ends show: neither of two bounds excludes it.

    With |d^2 ln|L|/d omega^2| <= m the slope keeps the sign of both ends if |s1| + |s2| > m h, and ln|L| its own if
    |y1| + |y2| > h max|slope|.
    """
    one, low, high = points.row[at], points.omega[at], points.omega[at + 1]
    real, imag = loops.real[:, one], loops.imag[:, one]
    offset = imag - np.clip(imag, low, high)
    with np.errstate(divide="ignore"):
        turn = (1 / (real * real + offset * offset)).sum(axis=0) * (high - low)
    slopes, sizes = ([values[at], values[at + 1]] for values in (points.size_slope, points.size))
    steady = (slopes[0] * slopes[1] > 0) & (np.abs(slopes[0]) + np.abs(slopes[1]) > turn)
    steepest = np.maximum(np.abs(slopes[0]), np.abs(slopes[1])) + turn
    apart = (sizes[0] * sizes[1] > 0) & (np.abs(sizes[0]) + np.abs(sizes[1]) > steepest * (high - low))
    return np.asarray(~(steady | apart))


def levels(points: Points) -> tuple[Floats, Floats]:
    """First and last k with arg L = pi + 2 pi k on each piece, arrays (N - 1,); first > last where there is none."""
    turns = (points.phase - np.pi) / (2 * np.pi)
    lower, upper = np.minimum(turns[:-1], turns[1:]), np.maximum(turns[:-1], turns[1:])
    return np.ceil(lower), np.floor(upper)


def bounds(points: Points) -> Floats:
    """`margins.box_bounds` over each piece, shape (3, N - 1); 0 between loops."""
    size, half_turns = (np.stack([one[:-1], one[1:]]) for one in (points.size, points.phase / np.pi))
    return np.where(points.row[:-1] == points.row[1:], box_bounds(size, half_turns), 0.0)


def divided(loops: Loops, points: Points, at: Indices) -> tuple[Points, Indices, Flags]:
    """The pieces number `at` divided into equal parts of small phase change, ends included; the place in `at` of
    each point; and the loops in which that takes too many parts (they get fewer)."""
    parts = np.ceil(np.abs(points.phase[at + 1] - points.phase[at]) / _PHASE_STEP).astype(int) + 1
    twisted = np.zeros(loops.gain.size, dtype=bool)
    twisted[points.row[at[parts > _MOST_PARTS]]] = True
    parts = np.minimum(parts, _MOST_PARTS)
    piece = np.repeat(np.arange(at.size), parts + 1)
    step = (np.arange(piece.size) - np.repeat(np.cumsum(parts + 1) - parts - 1, parts + 1)) / parts[piece]
    left, right = points.omega[at][piece], points.omega[at + 1][piece]
    return loops.evaluate(left + step * (right - left), points.row[at][piece]), piece, twisted
