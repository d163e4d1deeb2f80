"""Stability margins of a dead-time loop from its crossovers and the peaks of its closed-loop responses."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from contextlib import suppress
from itertools import accumulate, pairwise
from typing import NamedTuple

import numpy as np
from flint import ctx, fmpq

from railslip_ctrl.core.arguments import Complexes, Floats
from railslip_ctrl.core.records import dataclass

from .crossings import REFINED_BITS, Piece, Response
from .stability import count_right_of

_NEWTON_STEPS, _HALF_OF_THE_DIGITS = 60, 1e-9  # Newton's method in doubles: most steps, and last relative step
_BLUNT = 100.0  # height up to which doubles locate a peak accurately enough
_PEAK = 1e-11  # no peak exceeds the reported one by more than this, relatively
_NOTHING = 1e-100  # smallest |T| regarded as a peak; bounds have this minimum
_NARROWEST = 1e-15  # relative width of an interval that doubles cannot divide
_FARTHEST = 1e150  # rad/s; beyond it, and below its inverse, the limits at infinity and 0 replace L
# Largest frequency intervals on which bounds are tried: ratio of the ends, and phase of the dead time, rad. On larger
# intervals they mostly fail. These values and `_AROUND_PEAK` need the fewest evaluations for wheel-slip loops.
_WIDEST, _MOST_TURNED = 1.8, 1.5
# Tests for convexity about a peak: first half width in ln omega, factor from one to the next, largest number of tests
_AROUND_PEAK, _NARROWER, _MOST_NARROWED = 0.06, 0.4, 12
_OUTWARD = 4.0  # an interval that reaches to infinity is divided at this multiple of its lower end
_A_CHAIN = 10**9  # stands for the infinitely many unstable poles of a neutral loop beyond its limit
_BESIDE = 1e-6  # relative distance from a gain limit at which the poles on either side are counted
_GAINS_EQUAL = 1e-9  # relative difference below which the gains of two phase crossovers are one limit


@dataclass(frozen=True)
class Margins:
    """Margins of a stable loop: how far gain, phase and dead time may change, and peaks of the closed-loop responses.

    - gain_increase, gain_decrease: factors > 1 and < 1 on the loop gain at which stability is lost; inf and 0.0 if no
      factor destabilises.
    - gain_increase_frequency, gain_decrease_frequency: frequencies, rad/s, of the closed-loop poles that are on the
      stability boundary at these factors; 0 for a pole at the origin, inf for poles at infinity (as in a neutral loop),
      NaN if no factor destabilises.
    - phase_deg, phase_frequency: smallest phase lag or lead that destabilises, deg, and the gain crossover at which it
      does so, rad/s; inf and NaN without a gain crossover.
    - delay_s, delay_frequency: smallest added dead time that destabilises, s, and the gain crossover at which it does
      so, rad/s; inf and NaN without a gain crossover.
    - ms, ms_frequency: peak of |S| = |1/(1 + L)| over all frequencies, a ratio, and its frequency, rad/s.
    - mt, mt_frequency: peak of |T| = |L/(1 + L)| over all frequencies, a ratio, and its frequency, rad/s. `ms` and `mt`
      are exact to the last bit; the other margins may have errors in the last bits.
    - disk, disk_frequency: balanced disk margin alpha = 1/||S - 1/2||_inf, a ratio, and its frequency, rad/s
      ([Seiler2020]): gain and phase may change together within `disk_gain_range` and +-`disk_phase_deg`.
    - gain_crossovers: array, 1-D, rad/s; all frequencies with |L| = 1.
    - phase_crossovers: array, 1-D, rad/s; frequencies at which L is real and negative, 0 included. With dead time
      infinitely many exist; the list contains all with |L| >= 1/100.
    - phase_margins_deg: array, 1-D; phase margin at each gain crossover, deg, in (-180, 180]. A positive phase margin
      is lost by added lag, a negative one by added lead.
    - phase_crossover_gains: array, 1-D; factor 1/|L| at each phase crossover.
    """

    gain_increase: float
    gain_increase_frequency: float
    gain_decrease: float
    gain_decrease_frequency: float
    phase_deg: float
    phase_frequency: float
    delay_s: float
    delay_frequency: float
    ms: float
    ms_frequency: float
    mt: float
    mt_frequency: float
    disk: float
    disk_frequency: float
    gain_crossovers: Floats
    phase_margins_deg: Floats
    phase_crossovers: Floats
    phase_crossover_gains: Floats

    @property
    def disk_phase_deg(self) -> float:
        """Phase change that the disk margin alpha allows at unchanged gain: 2 atan(alpha/2), deg."""
        return float(np.degrees(2 * np.arctan(self.disk / 2)))

    @property
    def disk_gain_range(self) -> tuple[float, float]:
        """Lowest and highest gain factor that the disk margin alpha allows: (2 - alpha)/(2 + alpha) and its inverse."""
        if self.disk >= 2:
            return 0.0, float("inf")
        ratio = (2 - self.disk) / (2 + self.disk)
        return ratio, 1 / ratio


class GainLimit(NamedTuple):
    """A loop-gain factor at which closed-loop poles are on the imaginary axis.

    - frequency: frequency of these poles, rad/s.
    - crossing: change in the number of unstable poles when the gain factor rises beyond `factor`.
    - rate: d ln L/d omega at `frequency`, s; only for a limit at a phase crossover.
    """

    factor: float
    frequency: float
    crossing: int
    rate: complex = 0j


def gain_limits(response: Response, phase_crossings: list[float]) -> list[GainLimit]:
    """Gain limits at the phase crossovers, at frequency 0 and at infinity, ascending.

    From 1 + k L(s) = 0 it follows that Re ds/dk has the sign of -d(arg L)/d omega. Where the phase of L falls with
    frequency, a pair of poles therefore moves to the right as the gain factor k rises.
    """
    dc, limits = 0.0 if response.order_at_zero else response.system.dc_gain, list[GainLimit]()
    if -math.inf < dc < 0:
        # near the origin L ~ dc (1 + s L'/L): as k grows the real pole moves by -1/(L'/L), L'/L = d(arg L)/d omega
        slope = response.turned(1e-12 * float(response.scales.min()))[1]
        limits.append(GainLimit(-1.0 / dc, 0.0, 1 if slope < 0 else -1))
    for omega in phase_crossings:
        loop, rate, _ = response.at(omega)
        size = abs(loop)
        factor = 1 / size if _NOTHING < size < 1 / _NOTHING else 1 / response.size(omega)
        limits.append(GainLimit(factor, omega, 2 if rate.imag < 0 else -2, rate))
    at_infinity = _gain_limit_at_infinity(response)
    if at_infinity is not None:
        limits.append(at_infinity)
    return sorted(limits, key=lambda limit: limit.factor)


def _gain_limit_at_infinity(response: Response) -> GainLimit | None:
    """Gain limit at which closed-loop poles come from infinity; None if there is none."""
    through = response.system.feedthrough
    if through == 0 or (response.dead_time == 0 and through > 0):
        return None
    factor = 1.0 / abs(through)  # k |L(inf)| = 1 in a neutral loop, k L(inf) = -1 without dead time
    if response.dead_time > 0:
        return GainLimit(factor, float("inf"), _A_CHAIN)
    # (1 + k through) s^n + c s^(n-1) + ...: a real pole -c/(1 + k through) passes through infinity
    c = math.fsum([*response.system.zeros.real, *-response.system.poles.real])
    if c == 0:  # a pair passes through infinity; lower powers of s decide its direction, so count the poles
        below, above = (count_right_of(response.system * (factor * side), 0.0) for side in (1 - _BESIDE, 1 + _BESIDE))
        return GainLimit(factor, float("inf"), int(above.right - below.right))
    return GainLimit(factor, float("inf"), 1 if c > 0 else -1)


def compute_margins(
    response: Response, cut: list[Piece], rest: list[float], listed: list[GainLimit], limits: list[GainLimit]
) -> Margins:
    """Compute the margins of a stable loop; see `Margins`.

    - cut: `pieces` of the loop.
    - rest: arg(-L)/pi at the gain crossovers, in [-1, 1].
    - listed: gain limits before refinement.
    - limits: the same gain limits, refined.
    """
    crossovers = response.gain_crossovers.tolist()
    up = min((g for g in limits if g.factor > 1), key=lambda g: g.factor, default=GainLimit(np.inf, np.nan, 0))
    down = max((g for g in limits if g.factor < 1), key=lambda g: g.factor, default=GainLimit(0.0, np.nan, 0))
    delay = smallest_of(_added_dead_times(rest, crossovers), crossovers)
    if response.dead_time == 0 and abs(response.system.feedthrough) >= 1:
        delay = 0.0, float("inf")  # with any dead time it is a neutral loop with |G(inf)| >= 1, unstable
    ms, mt, (disk, disk_frequency) = _peaks(
        response, cut, [g.frequency for g in (up, down) if 0 < g.frequency < math.inf]
    )
    crossings = [limit for limit in limits if limit.frequency == 0]
    crossings += sorted((limit for limit in listed if 0 < limit.frequency < math.inf), key=lambda g: g.frequency)
    return Margins(
        *(up.factor, up.frequency, down.factor, down.frequency),
        *smallest_of([180 * abs(one) for one in rest], crossovers),
        *delay,
        *ms,
        *mt,
        *(1.0 / disk if disk > 0 else float("inf"), disk_frequency),
        gain_crossovers=response.gain_crossovers,
        phase_margins_deg=np.array([180.0 if one == -1 else 180 * one for one in rest]),
        phase_crossovers=np.array([limit.frequency for limit in crossings]),
        phase_crossover_gains=np.array([limit.factor for limit in crossings]),
    )


def smallest_at(rest: list[float], crossovers: list[float]) -> set[int]:
    """Indices of the smallest phase margin and of the smallest delay margin; `rest` is arg(-L)/pi at the crossovers."""
    sizes = ([abs(one) for one in rest], _added_dead_times(rest, crossovers))
    return {one.index(min(one)) for one in sizes if one}


def _added_dead_times(rest: list[float], crossovers: list[float]) -> list[float]:
    return [math.pi * (one if one > 0 else one + 2) / omega for one, omega in zip(rest, crossovers, strict=True)]


def smallest_of(values: Iterable[float], frequencies: Iterable[float]) -> tuple[float, float]:
    """Return the smallest of the values and its frequency; infinity and NaN if there are no values."""
    pairs = zip(values, frequencies, strict=True)
    value, omega = min(pairs, key=lambda pair: pair[0], default=(math.inf, math.nan))
    return float(value), float(omega)


SHAPES = ((1.0, 0.0), (0.0, 1.0), (0.5, -0.5))  #: (a, b): (a + b L)/(1 + L) is S, T and 1/2 - S


def heights(loop: Complexes) -> Floats:
    """Magnitudes |S|, |T| and |S - 1/2|, shape (3, n), from n values of L."""
    s = 1 / (1 + loop)
    return np.abs([s, loop * s, s - 0.5])


def responses(loop: Complexes, slope: Complexes) -> tuple[Floats, Floats]:
    """Magnitudes |S|, |T| and |S - 1/2| and their logarithmic slopes, both (3, n), from L and d ln L/d omega."""
    s = 1 / (1 + loop)
    t, centred = loop * s, s - 0.5
    return np.abs([s, t, centred]), np.array([-(t * slope).real, (s * slope).real, -(s * t * slope / centred).real])


Peaks = list[tuple[float, float]]  #: peaks of |S|, |T| and |S - 1/2|: height and frequency, rad/s


def _peaks(response: Response, cut: list[Piece], starts: Iterable[float]) -> Peaks:
    """Suprema of |S|, |T| and |S - 1/2| over all frequencies, searched from `starts` and the ends of `cut`, rad/s."""
    best = [max(ends) for ends in _end_values(response)]
    if response.system.gain == 0:
        return best
    if response.dead_time == 0:
        with ctx.workprec(REFINED_BITS):
            return [(float(peak.mid()), omega) for peak, omega in response.exact.peaks()]
    search = _PeakSearch(response, best)
    search.climb(sorted({*starts, *(piece.high for piece in cut[:-1])}))
    search.cover(cut)
    return search.best


class _PeakSearch:
    """Search for the peaks of |S|, |T| and |S - 1/2|, with a proof that no frequency has a higher value.

    The proof uses P = |1 + L|^2 and N = |L|^2. For example |S| <= M if and only if M^2 P - 1 >= 0. In general each
    function is below its peak if u P + v N + w >= 0, where the numbers u, v and w follow from the peak. Where |L| > 1,
    1/L replaces L.
    """

    def __init__(self, response: Response, best: Peaks) -> None:
        self.best, self._response, self._rounding = best, response, response.rounding(0.0)
        self._sure = [(0.0, 0.0)] * 3  # intervals, rad/s, on which convexity proves the peak to be the highest
        self._prepare()

    def _prepare(self) -> None:
        # u, v and w for each peak, for L and for 1/L; no higher peak where |L| is below `_small` or above `_large`
        slack = self._rounding * (self.best[0][0] * self.best[1][0])  # |S| and |T| amplify rounding
        s, t, centred = (max(peak, _NOTHING) * (1 + _PEAK) + slack for peak, _ in self.best)
        of_s, of_t, of_both = (s * s, 0.0, -1.0), (t * t, -1.0, 0.0), (centred * centred + 0.25, -0.5, -0.5)
        self._forms = [of_s, of_t, of_both], [(s * s, -1.0, 0.0), (t * t, 0.0, -1.0), of_both]
        ratio = (2 * centred - 1) / (2 * centred + 1)
        self._small = min(1 - 1 / s, t / (1 + t), ratio)
        self._large = max(1 + 1 / s, t / (t - 1) if t > 1 else math.inf, 1 / ratio if ratio > 0 else math.inf)

    def climb(self, starts: list[float]) -> None:
        """Search for each peak, beginning at the frequency of `starts`, rad/s, with the highest value."""
        values = [_sizes(self._response, omega) for omega in starts]
        for kind, sizes in enumerate(zip(*values, strict=True)):
            top = sizes.index(max(sizes))
            if sizes[top] > self.best[kind][0] * (1 + _PEAK):
                self._raise(kind, starts[top], [0.0, *starts, math.inf][top : top + 3 : 2])

    def _raise(self, kind: int, start: float, between: Sequence[float]) -> None:
        """Store the peak of |S|, |T| or |S - 1/2| (`kind` 0, 1 or 2) near `start`, rad/s, if it is higher."""
        shape, exact = SHAPES[kind], self._response.exact
        low, high = between
        omega = _near_peak(self._response, *shape, low, start, high)
        with ctx.workprec(REFINED_BITS):
            peak = exact.size_at(*shape, omega)
            if not peak < _BLUNT:
                found, peak = exact.peak(*shape, low, omega, high)
                omega = float(found)
            if not float(peak.mid()) > self.best[kind][0]:
                omega, peak = start, exact.size_at(*shape, start)
        self.best[kind] = max(self.best[kind], (float(peak.mid()), omega))
        self._prepare()
        half = _AROUND_PEAK
        for _ in range(_MOST_NARROWED):
            low, high = omega * math.exp(-half), omega * math.exp(half)
            around = self._expanded(low, high)
            if around is not None and self._positive(kind, around):
                self._sure[kind] = low, high
                break
            half *= _NARROWER

    def cover(self, cut: list[Piece]) -> None:
        """Prove that no interval in `cut` contains a higher peak, or replace the stored peak by the higher one."""
        left = list[tuple[float, float, float, float]]()  # intervals with monotone |L|: ends, rad/s, and |L| there
        ends = sorted({end for both in self._sure for end in both})
        for piece in cut:
            first, last = (math.exp(min(size, 700.0)) for size in piece.size)
            inner = [(end, self._response.size(end)) for end in ends if piece.low < end < piece.high]
            for (low, before), (high, after) in pairwise([(piece.low, first), *inner, (piece.high, last)]):
                left.append((low, high, before, after))
        left.reverse()
        while left:
            low, high, first, last = left.pop()
            if max(first, last) <= self._small or min(first, last) >= self._large:
                continue
            kinds = [kind for kind, (start, end) in enumerate(self._sure) if low < start or end < high]
            if not (kinds and high > low * (1 + _NARROWEST) and high > 1 / _FARTHEST and low < _FARTHEST):
                continue
            middle, tried = self._middle(low, high)
            around = self._expanded(low, high) if tried else None
            if around is None or not self._below(kinds, around, low, middle):
                size = self._response.size(middle)
                left += [(middle, high, size, last), (low, middle, first, size)]

    def _middle(self, low: float, high: float) -> tuple[float, bool]:
        """Frequency that divides an interval, and True if the interval is short enough to try a proof on it."""
        if math.isinf(high):
            return (_OUTWARD * low or 1 / self._response.dead_time), False
        tried = (high - low) * self._response.dead_time < _MOST_TURNED
        return (math.sqrt(low) * math.sqrt(high), tried and high < _WIDEST * low) if low else (0.5 * high, tried)

    def _below(self, kinds: list[int], around: _Around, low: float, middle: float) -> bool:
        """True if no function in `kinds` can exceed its peak on the interval; a higher value at `middle` is stored."""
        rounding = self._response.rounding(middle)
        if rounding > 2 * self._rounding:
            self._rounding = rounding
            self._prepare()
        for kind in kinds:
            if not self._positive(kind, around, even=low == self.best[kind][1] == 0):
                u, v, w = self._forms[around.inverted][kind]
                if u * around.p[0] + v * around.n[0] + w < 0:
                    self._raise(kind, middle, (0.0, math.inf))
                return False
        return True

    def _positive(self, kind: int, around: _Around, *, even: bool = False) -> bool:
        """True if u P + v N + w > 0 is proved for the peak `kind` on the interval of `around`."""
        # `even`: the peak is at 0 rad/s, where the interval begins, so that the slope is 0 there
        u, v, w = self._forms[around.inverted][kind]
        (p, p1, p2, p3), (n, n1, n2, n3), half = around.p, around.n, around.half
        value, slope, second, third = u * p + v * n + w, abs(u * p1 + v * n1), u * p2 + v * n2, u * p3 - v * n3
        inside = slope < second * half
        least = value - (slope * slope / (2 * second) if inside else slope * half - 0.5 * second * half * half)
        if least > third * half**3 / 6:
            return True
        convex = second - third * half  # the least second derivative
        return convex > 0 and (even or value > slope * slope / (2 * convex))

    def _expanded(self, low: float, high: float) -> _Around | None:
        """Expansion of P and N in ln omega (in omega if `low` is 0); None if there is no useful bound."""
        middle, half = (math.sqrt(low) * math.sqrt(high), 0.5 * math.log(high / low)) if low else (0.5 * high,) * 2
        try:
            value, slope, second = self._response.at(middle)
            bend, twist = self._response.spread(low, middle, high)
            inverted, order = abs(value) > 1, self._response.order_at_zero
            if inverted:
                value, slope, second, order = 1 / value, -slope, -second, -order
        except ArithmeticError:
            return None
        if low:
            slope, second, order = middle * slope, middle * (slope + middle * second), 0
        if order < 0 or not bend * half * half < 100:
            return None
        # L = omega^order F: bounds on the derivatives of F, then on those of L, over |L|
        own = slope - order / middle
        rate, inner = abs(own) + half * bend, order / high
        top = abs(value) * (high / middle) ** order * math.exp(half * abs(own.real) + 0.5 * half * half * bend)
        f2, f3 = rate * rate + bend, rate * (rate * rate + 3 * bend) + twist
        e2 = inner * (order - 1) / high
        d1, d2 = value * slope, value * (slope * slope + second)
        k3 = top * (f3 + 3 * (inner * f2 + e2 * rate) + e2 * (order - 2) / high)
        k2 = min(top * (f2 + 2 * inner * rate + e2), abs(d2) + half * k3)
        first = min(top * (rate + inner), abs(d1) + half * k2)
        below = 1 + value
        one, own = below.conjugate(), value.conjugate()
        both, bent, apart = 2 * (d1 * d1.conjugate()).real, 6 * first * k2, abs(below) + half * first
        p = (one * below).real, 2 * (one * d1).real, both + 2 * (one * d2).real, bent + 2 * apart * k3
        n = (own * value).real, 2 * (own * d1).real, both + 2 * (own * d2).real, bent + 2 * top * k3
        return _Around(inverted, half, p, n)


class _Around(NamedTuple):
    """Expansion of P = |1 + L|^2 and N = |L|^2 on a frequency interval, in ln omega or omega.

    `p` and `n`: value, first and second derivative in the middle, and a bound on the third derivative.
    """

    inverted: bool  # true: P and N are those of 1/L
    half: float  # half width of the interval
    p: tuple[float, float, float, float]
    n: tuple[float, float, float, float]


def _sizes(response: Response, omega: float) -> tuple[float, float, float]:
    with suppress(ArithmeticError):
        loop = response.at(omega)[0]
        s = 1 / (1 + loop)
        return abs(s), abs(loop * s), abs(s - 0.5)
    return 0.0, 0.0, 0.0


def _near_peak(response: Response, a: float, b: float, low: float, start: float, high: float) -> float:
    """Frequency, rad/s, of the peak of |a + b L|/|1 + L| near `start`, by Newton's method in double precision."""
    omega, least, seen = start, math.inf, start
    with suppress(ArithmeticError):
        for _ in range(_NEWTON_STEPS):
            loop, slope, second = response.at(omega)
            size = a + b * loop
            inverse, part = (1 + loop) / size, (a - b) * loop / size / size
            if abs(inverse) <= least * (1 + _PEAK):
                least, seen = abs(inverse), omega
                first, bends = part * slope, part * (second + slope * slope * (1 - 2 * b * loop / size))
                falls = (inverse.conjugate() * first).real
                curvature = (first.conjugate() * first).real + (inverse.conjugate() * bends).real
                low, high = (omega, high) if falls < 0 else (low, omega)
                new = omega - falls / abs(curvature)
                if curvature > 0 and abs(new - omega) < _HALF_OF_THE_DIGITS * omega:
                    return new
                omega = new if low < new < high else 0.5 * (max(low, omega / 4) + min(high, omega * 4))
            else:
                omega = 0.5 * (seen + omega)
    return seen


def top_of(sizes: Floats, points: Floats) -> Peaks:
    """Largest value in each row of `sizes`, and its frequency in `points`, rad/s."""
    return [(float(row[i]), float(points[i])) for row in sizes for i in [int(np.argmax(row))]]


def box_bounds(size: Floats, half_turns: Floats) -> Floats:
    """Upper bounds on |S|, |T| and |S - 1/2| on n frequency intervals with monotone |L| and phase, (3, n).

    - size, half_turns: ln|L| and arg L/pi at both ends, (2, n).
    """
    # |1 + L|^2 >= (1 - m)^2 + 2 m (1 - cos d) with m = |L|, if the phase differs from -180 deg by at least d
    turns = 0.5 * half_turns - 0.5
    lowest, highest = np.minimum(*turns), np.maximum(*turns)
    with np.errstate(invalid="ignore", divide="ignore"):
        e = 2 * np.minimum(*(np.sin(np.pi * turns) ** 2))  # 1 - cos d
        e[np.floor(highest) >= np.ceil(lowest)] = 0.0
        size = np.clip(size, -300, 300)
        least, most = np.minimum(*size), np.maximum(*size)
        low, high = -np.expm1(most), -np.expm1(least)  # range of 1 - m
        # |S| and |T| are largest for m or 1/m nearest to cos d; |S - 1/2| for |L| nearest to 1 in the left half plane,
        # farthest from 1 in the right one
        near = np.empty((3, e.size))
        np.clip(e, low, high, out=near[0])
        np.clip(e, -np.expm1(-least), -np.expm1(-most), out=near[1])
        near[2] = np.where(e < 1, np.clip(0.0, low, high), np.where(least + most > 0, low, high))
        m = 1 - near
        squares = 1 / (near**2 + 2 * m * e)
        squares[2] *= (0.5 + 0.5 * m[2]) ** 2 - 0.5 * m[2] * e
        return np.asarray(np.sqrt(squares))


def _end_values(response: Response) -> list[Peaks]:
    """Values of |S|, |T| and |S - 1/2| at omega = 0, and their suprema as omega tends to infinity."""
    n, d = response.exact.numerator[0], response.exact.denominator[0]
    through = response.exact.through
    if response.dead_time > 0:
        through = -abs(through)  # with dead time L(inf) takes every phase; negative is the worst
    # exact fractions: D + N may be far smaller than D and N
    near, far = ([abs(one / (2 * (n + d))) for one in (2 * d, 2 * n, d - n)] for n, d in ((n, d), (through, fmpq(1))))
    return [[(int(x.p) / int(x.q), 0.0), (int(y.p) / int(y.q), math.inf)] for x, y in zip(near, far, strict=True)]


def stabilizing_range(limits: list[GainLimit], unstable_at_one: float) -> tuple[float, float] | None:
    """Interval of stabilising gain factors that contains 1, or else is nearest to 1 in ratio; None if none exists.

    - limits: gain limits, ascending.
    - unstable_at_one: number of unstable poles at factor 1.
    """
    factors = [limit.factor for limit in limits]
    counts = [0, *accumulate(limit.crossing for limit in limits)]
    more = unstable_at_one - counts[bisect_right(factors, 1.0)]
    return next((one for one, count in by_distance(factors, counts) if count + more == 0), None)


def by_distance(factors: Iterable[float], counts: Iterable[float]) -> list[tuple[tuple[float, float], float]]:
    """Divide the gain factors from 0 to infinity at the ascending `factors`; return the intervals, nearest to 1 first.

    `counts` has one number for each interval in ascending order; each interval is returned with its number. Empty
    intervals are left out.
    """

    def distance(found: tuple[tuple[float, float], float]) -> float:
        low, high = found[0]
        return 0.0 if low <= 1 <= high else abs(math.log(high if high < 1 else low))

    intervals = zip(pairwise([0.0, *factors, math.inf]), counts, strict=False)
    return sorted((one for one in intervals if one[0][1] > one[0][0] * (1 + _GAINS_EQUAL)), key=distance)
