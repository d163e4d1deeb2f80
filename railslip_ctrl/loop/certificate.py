"""Certificates: the stability and the margins of a dead-time loop as enclosures by ball arithmetic.

Root count, gain, phase and delay margins follow from the isolated roots of polynomials (`crossings`). For Ms and Mt the
axis is covered by parts, on each of which a bound lies below the upper end of the enclosure; the lower end is attained.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise

import numpy as np
from flint import arb, ctx

from railslip_ctrl.core.errors import RailslipError

from .crossings import AXIS, GAIN, MOST_BITS, PHASE, SIZE, Response, limits, phase_crossover
from .margins import SHAPES, Margins
from .stability import root_count

Enclosure = tuple[float, float]

WIDTH = 1e-9
"""Largest relative width of an enclosure."""

_BITS = (80, 320, 1280, 4000)
_ABOVE = 0.4 * WIDTH  # relative: how far the upper end of a peak's enclosure is above the value attained
_BESIDE = 1e-6  # relative: how far a peak may be from where doubles see it
_NEAR_PEAK = 1e-6 * 1.5 ** np.arange(30)  # relative distances from a peak at which the axis is cut first
_MOST_PARTS = 50_000
_FARTHEST = arb(2) ** 1000  # rad/s
_STEP_OUT = 256.0  # factor towards 0 or infinity at which an end part is divided


class CertificateError(RailslipError, ArithmeticError):
    """A margin could not be enclosed as narrowly as a certificate asks."""


class _TooWideError(Exception):
    """At this precision a ball does not decide."""


@dataclass(frozen=True)
class Certificate:
    """What is certain of a loop; each enclosure is (lowest, highest), at most 1e-9 wide relatively.

    It holds for the coefficients, matrices or roots, the gain and the dead time as the doubles they were given as.

    Attributes
    ----------
    stable : bool
        Whether every closed-loop pole lies left of the imaginary axis.
    marginal : bool
        Whether a closed-loop pole lies on the imaginary axis, or cannot be told from it at `bits`; False where
        infinitely many poles are not left of it.
    unstable_poles : float
        Number of closed-loop poles with real part >= 0, as `DeadTimeLoop.unstable_closed_loop_poles`.
    gain_crossovers : tuple of tuple
        Enclosures of all frequencies with |L| = 1, rad/s: they and the phase there decide the root count.
    bits : int
        Precision of the balls: their relative width is 2^-bits.
    parts : int
        Parts of the axis on each of which |S| and |T| were bounded; 0 without dead time, where roots of polynomials
        give their peaks.
    gain_increase, gain_decrease, phase_deg, delay_s, ms, mt : tuple of float, or None
        Enclosures of the margins of `Margins`: factors, deg, s, peaks of |S| and |T|; both ends inf where a margin has
        no bound. None for a loop that is not stable.
    """

    stable: bool
    marginal: bool
    unstable_poles: float
    gain_crossovers: tuple[Enclosure, ...]
    bits: int
    parts: int = 0
    gain_increase: Enclosure | None = None
    gain_decrease: Enclosure | None = None
    phase_deg: Enclosure | None = None
    delay_s: Enclosure | None = None
    ms: Enclosure | None = None
    mt: Enclosure | None = None


def certify(response: Response, margins: Margins | None) -> Certificate:
    """The certificate of a loop; `margins` are those of a stable one, None for another.

    Raises CertificateError where `_BITS` do not do, which means a loop on the boundary for all that a double can tell.
    """
    count = root_count(response, certain=True)
    crossovers = tuple(_ends(omega) for omega, _ in response.exact.frequencies(GAIN))
    if margins is None:
        bits = MOST_BITS if count.marginal else _BITS[0]
        return Certificate(False, count.marginal, count.right, crossovers, bits)
    if response.system.gain == 0:
        without = (math.inf, math.inf)
        ends = (without, (0.0, 0.0), without, without, (1.0, 1.0), (0.0, 0.0))
        return Certificate(True, False, 0.0, (), _BITS[0], 0, *ends)
    for bits in _BITS:
        with ctx.workprec(bits):
            try:
                up, down = _gain_margins(response, bits)
                phase, delay = _crossover_margins(response, bits)
                (ms, mt), parts = _peaks(response, margins, bits)
                found = [_narrow(one) for one in (up, down, phase, delay, ms, mt)]
                # stable, so that the limits of the gain lie on either side of 1
                found[:2] = (max(found[0][0], 1.0), found[0][1]), (found[1][0], min(found[1][1], 1.0))
                return Certificate(True, False, 0.0, crossovers, bits, parts, *found)
            except _TooWideError:
                continue
    raise CertificateError(
        f"certificate: {_BITS[-1]} bits do not enclose every margin to {WIDTH:g}; the loop is as near to the boundary "
        "of stability as a double can tell; change the gain"
    )


def _ends(ball: arb) -> Enclosure:
    """The ends of a ball as doubles, outward."""
    if not ball.is_finite():
        return math.inf, math.inf
    low, high = float(ball.lower()), float(ball.upper())
    return (
        (low, high)
        if ball.is_exact() and low == high
        else (math.nextafter(low, -math.inf), math.nextafter(high, math.inf))
    )


def _narrow(ball: arb) -> Enclosure:
    low, high = _ends(ball)
    if high - low > WIDTH * abs(high):
        raise _TooWideError
    return low, high


def _least(balls: Iterable[arb]) -> arb:
    """A ball that holds the least of numbers, each in one of the balls; infinity for none."""
    return reduce(arb.min, balls, arb.pos_inf())


# -- gain, phase and delay ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _End:
    """An end of a piece: frequency, 0 and infinity included, ln|L| as a double, arg L/pi (None: minus infinity)."""

    omega: arb
    size: float
    half_turns: arb | None


def _pieces(response: Response, bits: int) -> Iterator[tuple[_End, _End, bool]]:
    """Both ends of each piece of the axis on which |L| and the phase are monotone, and whether |L| > 1 on it."""
    exact = response.exact
    kinds = (GAIN, SIZE, PHASE, AXIS)
    nodes = [(w, kind, i, n % 2) for kind in kinds for i, (w, n) in enumerate(exact.frequencies(kind, bits))]
    nodes.sort(key=lambda node: node[0].mid())
    (first_size, first), (last_size, last) = limits(response)
    start, large = _End(arb(0), first_size, arb(first)), exact.large_at_zero
    for omega, kind, i, odd in nodes:
        below, above = (exact.argument(omega, side * (kind == AXIS)) / arb.pi() for side in (-1, 1))
        if response.dead_time == 0 and kind != AXIS and ((below - 1) / 2).contains_integer():
            at, rest = exact.offset(kind, i)
            below, above = (arb(at), arb(at)) if rest == 0 else (below, above)  # L < 0 just there
        size = float(response.log_size(np.array([float(omega.mid())]))[0])
        yield start, _End(omega, size, below), large
        start, large = _End(omega, size, above), large != (kind == GAIN and odd == 1)
    yield start, _End(arb.pos_inf(), last_size, None if math.isinf(last) else arb(last)), large


def _gain_margins(response: Response, bits: int) -> tuple[arb, arb]:
    """The least factor > 1 and the largest < 1 on the gain that put a pole on the axis. Of each piece the phase
    crossover nearest to |L| = 1 counts, as |L| is monotone there."""
    up: list[arb] = []  # 1/|L|, and |L| below: all > 1
    down: list[arb] = []
    for start, end, large in _pieces(response, bits):
        if start.half_turns is not None and ((start.half_turns - 1) / 2).is_integer() and start.omega > 0:
            size = abs(response.exact.value(start.omega)[0])
            (down if size > 1 else up).append(size if size > 1 else 1 / size)
        near, far = (start, end) if abs(start.size) <= abs(end.size) else (end, start)
        odd = _first_odd(near, far)
        if odd is not None:
            size = abs(response.exact.value(_phase_crossover(response, start, end, odd))[0])
            (down if large else up).append(size if large else 1 / size)
    num, den, through = response.exact.numerator, response.exact.denominator, response.exact.through
    at_zero = arb(num[0] / den[0]) if den[0] != 0 else arb(0)
    at_infinity = arb(-abs(through) if response.dead_time > 0 else through)
    for value in (at_zero, at_infinity):
        if value < 0:
            (down if value < -1 else up).append(-value if value < -1 else -1 / value)
    return _least(up), 1 / _least(down) if down else arb(0)


def _first_odd(near: _End, far: _End) -> int | None:
    """The first odd number that arg L/pi meets strictly inside a piece, from its near end on; None without one."""
    if near.half_turns is None:
        return None  # the crossovers accumulate at infinity, where |L| has a limit that counts by itself
    rising = far.half_turns is not None and float(far.half_turns.mid()) > float(near.half_turns.mid())
    half = (near.half_turns - 1) / 2
    below = (half.floor() if rising else half.ceil()).unique_fmpz()
    if below is None:
        raise _TooWideError
    odd = 2 * (int(below) + (1 if rising else -1)) + 1
    if far.half_turns is None:
        return odd
    rest = far.half_turns - odd if rising else odd - far.half_turns
    if not (rest > 0 or rest < 0 or rest.is_zero()):
        raise _TooWideError
    return odd if rest > 0 else None


def _phase_crossover(response: Response, start: _End, end: _End, odd: int) -> arb:
    """The frequency inside a piece at which arg L is `odd` times pi: Newton's method, then the signs on either side."""
    first, last = (-math.inf if one.half_turns is None else float(one.half_turns.mid()) for one in (start, end))
    found = phase_crossover(response, float(start.omega.mid()), float(end.omega.mid()), first, last, odd)
    omega = response.exact.phase_crossover(found, response.turned(found)[1], odd)
    away = omega * arb(2) ** (-ctx.prec // 2)
    below, above = (response.exact.argument(omega + step) - odd * arb.pi() for step in (-away, away))
    if not (below * above < 0):
        raise _TooWideError
    return (omega - away).union(omega + away)


def _crossover_margins(response: Response, bits: int) -> tuple[arb, arb]:
    """The least |phase margin|, deg, and the least delay margin, s, over all gain crossovers."""
    phases, delays = [], []
    for omega, _ in response.exact.frequencies(GAIN, bits):
        half = response.exact.argument(omega) / arb.pi()
        rest = half - (2 * int((half.mid() / 2).floor().unique_fmpz()) + 1)
        if not (rest > 0 or rest < 0):
            raise _TooWideError
        phases.append(180 * abs(rest))
        delays.append((rest if rest > 0 else rest + 2) * arb.pi() / omega)
    if response.dead_time == 0 and abs(response.exact.through) >= 1:
        delays.append(arb(0))
    return _least(phases), _least(delays)


# -- peaks ------------------------------------------------------------------------------------------------------------


def _peaks(response: Response, margins: Margins, bits: int) -> tuple[tuple[arb, arb], int]:
    """Ms and Mt, and the parts of the axis that it took."""
    if response.dead_time > 0:
        cover = _Cover(response, margins, bits)
        return cover.peaks(), cover.parts
    ms, mt = (peak.union(peak.upper() * (1 + _ABOVE)) for peak, _ in response.exact.peaks()[:2])
    return (ms, mt), 0


class _Cover:
    """The axis in parts, and the bounds of |S| and |T| on them."""

    def __init__(self, response: Response, margins: Margins, bits: int) -> None:
        self._response, self._bits = response, bits
        zeros, poles = response.exact.roots()
        self._roots = zeros + poles
        self._on_axis = [
            (root.imag, size)
            for of, size in ((poles, arb.pos_inf()), (zeros, arb(0)))
            for root in of
            if root.real.is_zero()
        ]
        self._frequencies = margins.ms_frequency, margins.mt_frequency
        self._near: list[arb] = []
        self.parts = 0

    def peaks(self) -> tuple[arb, arb]:
        """Ms and Mt: a value that is attained, and what no part exceeds."""
        attained = [self._peak(shape, omega) for shape, omega in zip(SHAPES[:2], self._frequencies, strict=True)]
        self._most = [value.upper() * (1 + _ABOVE) for value in attained]
        for start, end, _ in _pieces(self._response, self._bits):
            self._cover(start, end)
        return attained[0].union(self._most[0]), attained[1].union(self._most[1])

    def _peak(self, shape: tuple[float, float], omega: float) -> arb:
        """|S| or |T| where it is largest, near a frequency, or in the limit to 0 or infinity."""
        if 0 < omega < math.inf:
            found, peak = self._response.exact.peak(*shape, omega * (1 - _BESIDE), omega, omega * (1 + _BESIDE))
            self._near += [found * (1 + side * away) for side in (-1, 1) for away in _NEAR_PEAK.tolist()]
            return peak
        num, den = self._fraction_at(omega)
        return abs((shape[0] * den + shape[1] * num) / (num + den))

    def _fraction_at(self, omega: float) -> tuple[arb, arb]:
        """L as a fraction in the limit to frequency 0 or infinity; with dead time its phase there is any."""
        if omega == 0:
            return arb(self._response.exact.numerator[0]), arb(self._response.exact.denominator[0])
        through = self._response.exact.through
        return arb(-abs(through) if self._response.dead_time > 0 else through), arb(1)

    def _cover(self, start: _End, end: _End) -> None:
        """See that |S| and |T| stay below on a piece, dividing it until they do."""
        inside = sorted((w.mid() for w in self._near if start.omega < w < end.omega), key=float)
        edges = [start, *(self._end(w) for w in inside), end]
        left = list(pairwise(edges))
        while left:
            low, high = left.pop()
            self.parts += 1
            if self.parts > _MOST_PARTS:
                raise _TooWideError
            if not (self._below_to_second_order(low.omega, high.omega) or self._below_in_box(low, high)):
                middle = self._end(_between(low, high))
                left += [(low, middle), (middle, high)]

    def _end(self, omega: arb) -> _End:
        return _End(omega, math.nan, self._response.exact.argument(omega) / arb.pi())

    def _below_to_second_order(self, low: arb, high: arb) -> bool:
        """As `margins` bounds it, in balls: value and slope in the middle, and the most of the second derivative."""
        if not (low > 0 and high.is_finite()):
            return False
        middle = ((low + high) / 2).mid()
        half = (high - middle).max(middle - low)
        bend = arb(0)
        for root in self._roots:
            offset = (low - root.imag).max(root.imag - high).max(arb(0))
            distance = offset * offset + root.real * root.real
            if not distance > 0:
                return False
            bend += 1 / distance
        loop, slope = self._response.exact.value(middle)
        size, rate = abs(loop), abs(slope)
        growth = (half * rate + half * half * bend / 2).expm1()
        least = abs(1 + loop) - size * growth
        if not least > 0:
            return False
        s_most, t_most = 1 / least, size * (1 + growth) / least
        curved = half * half / 2 * s_most * t_most * (bend + (rate + half * bend) ** 2 * (s_most + t_most))
        s = 1 / (1 + loop)
        change = half * slope * loop * s * s
        return all(
            abs(value - change) + curved < most and abs(value + change) + curved < most
            for value, most in zip((s, loop * s), self._most, strict=True)
        )

    def _below_in_box(self, low: _End, high: _End) -> bool:
        """With |L| from m1 to m2 and cos(arg L) >= -c: |1 + L|^2 >= 1 + m^2 - 2 m c, and the same of 1/L."""
        sizes = [self._size_at(one.omega) for one in (low, high)]
        c = _towards_minus_one(low.half_turns, high.half_turns)
        inverses = [arb.pos_inf() if size.is_zero() else 1 / size if size.is_finite() else arb(0) for size in sizes]
        squares = _least_square(sizes, c), _least_square(inverses, c)
        return all(square > 0 and 1 / square.sqrt() < most for square, most in zip(squares, self._most, strict=True))

    def _size_at(self, omega: arb) -> arb:
        """|L| at an end of a part, or in the limit to 0 or infinity."""
        if omega > 0 and omega.is_finite():
            at = next((size for one, size in self._on_axis if omega.overlaps(one)), None)
            return abs(self._response.exact.value(omega)[0]) if at is None else at
        num, den = self._fraction_at(float(omega))
        return arb.pos_inf() if den.is_zero() else abs(num / den)


def _towards_minus_one(first: arb | None, second: arb | None) -> arb:
    """The most of -cos(arg L) between two phases, over pi."""
    if first is None or second is None:
        return arb(1)
    lowest, highest = ((first.min(second) - 1) / 2).ceil(), ((first.max(second) - 1) / 2).floor()
    return (-first.cos_pi()).max(-second.cos_pi()) if highest < lowest else arb(1)


def _least_square(sizes: Sequence[arb], c: arb) -> arb:
    """At most the least of 1 + m^2 - 2 m c over m between the sizes."""
    low, high = sizes[0].min(sizes[1]), sizes[0].max(sizes[1])
    candidates = [1 + m * (m - 2 * c) for m in (low, high) if m.is_finite()]
    if not (c <= low or c >= high):
        candidates.append(1 - c * c)
    return _least(candidates)


def _between(low: _End, high: _End) -> arb:
    """A frequency, rad/s, that divides a part."""
    if not low.omega > 0:
        found = high.omega.mid() / _STEP_OUT if high.omega.is_finite() else arb(1)
    elif not high.omega.is_finite():
        found = low.omega.mid() * _STEP_OUT
    else:
        found = (low.omega * high.omega).sqrt().mid()
        if not (low.omega < found < high.omega):
            raise _TooWideError
    if not _FARTHEST > found > 1 / _FARTHEST:
        raise _TooWideError
    return found
