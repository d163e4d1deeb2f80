"""Crossovers, gain limits and peaks of loops from bounds on ln L over intervals of frequency.

A subclass of `BoundedLoop` gives L, its slope, and a bound on how far ln L deviates from its linear expansion.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from railslip_ctrl.core.arguments import Complexes, Floats, numbers

from .crossings import bracketed_roots
from .deadtime import Loop, unstable_error
from .margins import Margins, Peaks, by_distance, heights, responses, smallest_of, top_of

ROUNDING = 1e-12  # bound on the rounding of ln L, many times the largest observed
_ONE = 1e-9  # if |ln|L|| is below this over a whole interval, |L| is regarded as 1 there, without a crossover
_SWAY = 0.75  # rad, largest change of arg L from the middle of an interval; less than an eighth of a turn
_PEAK = 1e-6  # among nearly equal peaks the reported one may be below the highest by this, relatively
_NARROWEST = 1e-7  # half width over frequency at which division ends, next to a zero or pole of L on the axis
_PARTS = 4  # intervals into which one is divided: more need more frequencies, fewer need more passes
_ENDS = np.array([0.0, np.inf])


class Expansion(NamedTuple):
    """Linear expansion of ln L about the middles of n frequency intervals, with bounds on the deviation.

    - value, slope: array (n,); ln L and its derivative with respect to omega, s, at the middles.
    - bounds: function of the half widths of the intervals, (n,), rad/s. It returns three upper bounds, (n,) each, on
      the deviation of ln L, of ln|L|, and of ln L on intervals of twice the width; inf if no bound exists. The bounds
      on ln L also hold for complex frequencies in the disk that has the interval as diameter.
    """

    value: Complexes
    slope: Complexes
    bounds: Callable[[Floats], tuple[Floats, Floats, Floats]]


class BoundedLoop(Loop):
    """A `Loop` whose margins come from bounds on ln L on frequency intervals."""

    _to_infinity: ClassVar[bool] = False  # True if the frequency axis reaches to infinity, where L is 0

    @property
    @abstractmethod
    def dc_gain(self) -> float:
        """L at frequency 0; infinite with an integrator."""

    def dcgain(self) -> float:
        """The value of `dc_gain`, under the name python-control uses."""
        return self.dc_gain

    @abstractmethod
    def response_and_slope(self, omega: Floats) -> tuple[Complexes, Complexes]:
        """L and d ln L/d omega (s), complex, of the shape of `omega`."""

    @abstractmethod
    def _edges(self) -> Floats:
        """Ends of the frequency intervals before they are divided, rad/s, ascending."""

    @abstractmethod
    def _expand(self, omega: Floats) -> Expansion:
        """Expand ln L to first order about the frequencies `omega`, rad/s, (n,)."""

    @abstractmethod
    def _first_phase(self, omega: Floats) -> Floats:
        """Continuous phase of L, rad, at frequencies far below the slowest pole or zero."""

    @abstractmethod
    def _added_delay(self) -> tuple[float, float]:
        """Smallest added dead time, s, that makes the loop unstable, and frequency, rad/s, of the pole that causes it.

        They are inf and NaN if no dead time makes the loop unstable.
        """

    @abstractmethod
    def _unstable_description(self) -> tuple[str, str]:
        """Kind of the loop and description of its unstable poles, for the message of UnstableLoopError."""

    def response(self, omega: ArrayLike) -> Complexes:
        """L(j omega), complex, of the shape of `omega`.

        - omega: rad/s, > 0, any shape; at most pi/h for a sampled loop with period h.
        """
        return self.response_and_slope(numbers("omega", omega, "rad/s", gt=0))[0]

    def phase(self, omega: ArrayLike) -> Floats:
        omega = numbers("omega", omega, "rad/s", gt=0)
        both = np.concatenate([self._nodes, omega.ravel()])
        order = np.argsort(both, kind="stable")
        angles = np.angle(np.concatenate([self._at_nodes[0], self.response(omega.ravel())]))
        first = self._first_phase(both[order[:1]])
        phase = np.empty(both.size)
        phase[order] = np.unwrap(np.concatenate([first, angles[order]]))[1:]
        return np.asarray(phase[self._nodes.size :].reshape(omega.shape))

    @cached_property
    def gain_crossovers(self) -> Floats:
        nodes = self._nodes
        size = np.log(np.abs(self._at_nodes[0]))
        certain = np.abs(size) > ROUNDING  # below it the sign is rounding, as at low frequency if L(0) = 1
        return self._roots(nodes[certain], size[certain], lambda value: np.log(np.abs(value)))

    @cached_property
    def stabilizing_gain_range(self) -> tuple[float, float] | None:
        """Interval of loop-gain factors that make the loop stable; None if no factor does.

        The interval contains 1 if the loop is stable; otherwise it is the interval nearest to 1 in ratio.
        """
        nodes = self._nodes
        factors = sorted(factor for factor, _ in self._gain_limits(nodes, self._at_nodes[0]))
        for (low, high), _ in by_distance(factors, range(len(factors) + 1)):
            inside = math.sqrt(low * high) if low > 0 and high < math.inf else (0.5 * high if low == 0 else 2 * low)
            if self.scaled(1.0 if math.isinf(inside) else inside).is_stable():
                return low, high
        return None

    def margins(self) -> Margins:
        """All margins of the loop; see `Margins`.

        Crossovers and peaks of a sampled loop with period h are those at frequencies up to pi/h.
        """
        if not self.is_stable():
            raise unstable_error(*self._unstable_description(), self.root_count.right, self.stabilizing_gain_range)
        nodes = self._nodes
        response, slope = self._at_nodes
        crossovers, limits = self.gain_crossovers, self._gain_limits(nodes, response)
        up = min((g for g in limits if g[0] > 1), default=(math.inf, math.nan))
        down = max((g for g in limits if g[0] < 1), default=(0.0, math.nan))
        signed = np.angle(-self.response(crossovers), deg=True)  # phase of -L: 0 at the critical point
        ms, mt, (disk, disk_frequency) = self._peaks(nodes, response, slope)
        return Margins(
            *up,
            *down,
            *smallest_of(np.abs(signed), crossovers),
            *self._added_delay(),
            *ms,
            *mt,
            *(1.0 / disk, disk_frequency),
            gain_crossovers=crossovers,
            phase_margins_deg=signed,
            phase_crossovers=np.array([frequency for _, frequency in limits]),
            phase_crossover_gains=np.array([factor for factor, _ in limits]),
        )

    # -- division of the frequency axis ------------------------------------------------------------------------

    @cached_property
    def _nodes(self) -> Floats:
        # divide until |L| - 1 and the phase minus 180 deg each cross 0 at most once on an interval, and |S|, |T| and
        # |S - 1/2| are each monotone or lower than at another frequency
        edges = self._edges()
        nodes, best = [edges], np.log(np.maximum(self._at_ends().max(axis=1), 1e-300))
        omega, half = (edges[:-1] + edges[1:]) / 2, np.diff(edges) / 2
        while omega.size:
            logarithm, slope, bounds = self._expand(omega)
            rest, level, twice = bounds(half)
            slack = twice / half  # bound on the change of the slope, by Cauchy's estimate
            apart, change = np.abs(logarithm.real), np.abs(slope.real) * half + level
            sure = (apart > change) | (np.abs(slope.real) > slack) | (apart + change < _ONE)
            off = np.remainder(logarithm.imag, 2 * np.pi) - np.pi
            sway = np.abs(slope.imag) * half + rest
            sure &= (sway < _SWAY) & ((np.abs(off) > sway) | (np.abs(slope.imag) > slack))
            value = np.exp(logarithm)
            sizes, slopes = responses(value, slope)
            best = np.maximum(best, np.log(sizes.max(axis=1)))
            bound = np.log(sizes) + np.abs(slopes) * half + _shape_rests(value, np.abs(slope) * half, rest)
            slacks = _shape_rests(value, np.abs(slope) * half * 2, twice) / half
            sure &= ((bound <= best[:, None] + _PEAK) | (np.abs(slopes) > slacks)).all(axis=0)
            parted = ~sure & (half > _NARROWEST * omega)
            omega, half = omega[parted], half[parted] / _PARTS
            places = omega + np.arange(-_PARTS, _PARTS + 1)[:, None] * half
            nodes.append(places[2:-1:2].ravel())
            omega, half = places[1::2].ravel(), np.tile(half, _PARTS)
        return np.asarray(np.sort(np.concatenate(nodes)))

    @cached_property
    def _at_nodes(self) -> tuple[Complexes, Complexes]:
        return self.response_and_slope(self._nodes)

    def _at_ends(self) -> Floats:
        # with an integrator 1e100 gives the limits of |S| and |T|
        values = np.array([np.clip(self.dc_gain, -1e100, 1e100), 0.0], dtype=complex)[: 1 + self._to_infinity]
        return heights(values)

    def _roots(self, nodes: Floats, values: Floats, function: Callable[[Complexes], Floats]) -> Floats:
        at = np.flatnonzero(np.sign(values[:-1]) * np.sign(values[1:]) < 0)
        ends = values[at], values[at + 1]
        return bracketed_roots(lambda w, _: function(self.response(w)), nodes[at], nodes[at + 1], ends)

    def _gain_limits(self, nodes: Floats, response: Complexes) -> list[tuple[float, float]]:
        """Loop-gain factors that put a pole on the stability boundary, each with the frequency of the pole, rad/s."""
        sideways = np.where(response.real < 0, response.imag, np.nan)
        crossovers = self._roots(nodes, sideways, lambda value: value.imag)
        limits = list(zip((1 / np.abs(self.response(crossovers))).tolist(), crossovers.tolist(), strict=True))
        return [(-1 / self.dc_gain, 0.0), *limits] if -math.inf < self.dc_gain < 0 else limits

    def _peaks(self, nodes: Floats, response: Complexes, slope: Complexes) -> Peaks:
        sizes, rises = responses(response, slope)
        inner = sizes[:, 1:-1]
        kinds, left = np.nonzero((inner >= sizes[:, :-2]) & (inner >= sizes[:, 2:]))
        left += rises[kinds, left + 1] > 0  # the peak lies on the side to which the response rises

        def rise(omega: Floats, index: NDArray[np.intp]) -> Floats:
            return responses(*self.response_and_slope(omega))[1][kinds[index], np.arange(index.size)]

        at_ends = rises[kinds, left], rises[kinds, left + 1]
        refined = bracketed_roots(rise, nodes[left], nodes[left + 1], at_ends)
        tops = heights(self.response_and_slope(refined)[0])
        ends = self._at_ends()
        return top_of(np.hstack([ends, tops, sizes]), np.concatenate([_ENDS[: ends.shape[1]], refined, nodes]))


def _shape_rests(loop: Complexes, linear: Floats, rest: Floats) -> Floats:
    """Upper bounds, (3, n), on how far ln S, ln T and ln(S - 1/2) deviate from linear functions of frequency."""
    # ln L changes by at most `linear` along its linear expansion, and deviates from it by at most `rest`
    grown = np.expm1(linear + rest)

    def of_sum(part: Complexes) -> Floats:  # ln(1 + part (exp(u) - 1))
        moved = np.abs(part) * grown
        return np.asarray(np.abs(part) * (grown - linear) - np.log1p(-np.minimum(moved, 1)) - moved)

    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # expand 1 + L in L, or as L (1 + 1/L) in 1/L: both bounds hold, the smaller is used
        plus, plus_inverse = of_sum(loop / (1 + loop)), of_sum(1 / (1 + loop))
        minus, minus_inverse = of_sum(loop / (1 - loop)), of_sum(1 / (1 - loop))
        rests = [
            np.fmin(plus, rest + plus_inverse),
            np.fmin(rest + plus, plus_inverse),
            np.fmin(plus + minus, plus_inverse + minus_inverse),
        ]
    return np.asarray(np.where(np.isnan(rests), np.inf, rests))
