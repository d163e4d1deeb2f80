"""Certificates: proved intervals (enclosures) for the margins of a loop, by ball (interval) arithmetic.

Root count, gain, phase and delay margins of a dead-time loop follow from roots of polynomials, each enclosed in a ball.
Ms and Mt are bounded on intervals that cover the frequency axis. If the controller contains delays, the frequencies
with |L| = 1 are not roots of a polynomial; then all enclosures follow from bounds on frequency intervals.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property, reduce
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from flint import acb, acb_poly, arb, arb_poly, ctx, fmpq, fmpq_poly

from railslip_ctrl.core.errors import RailslipError
from railslip_ctrl.core.records import dataclass

from .crossings import AXIS, GAIN, MOST_BITS, PHASE, SIZE, Response, limits, phase_crossover
from .margins import SHAPES, Margins
from .rational import DOUBLE_BITS, fraction, nearest_double
from .stability import root_count

Enclosure = tuple[float, float]

WIDTH = 1e-9  #: largest relative width of an enclosure

_BITS = (80, 320, 1280, 4000)  # precisions tried, in this order
_ABOVE = 0.4 * WIDTH  # relative distance from a peak's attained value to the upper end of its enclosure
_BESIDE = 1e-6  # largest relative error of a peak's frequency computed in doubles
_NEAR_PEAK = 1e-6 * 1.5 ** np.arange(30)  # relative distances from a peak at which the axis is divided first
_MOST_PARTS = 50_000  # largest number of frequency intervals; if it is exceeded, the next precision is tried
_FARTHEST = arb(2) ** 1000  # rad/s; largest frequency, still a double
_STEP_OUT = 256.0  # an interval that reaches to 0 or infinity is divided this factor away from its other end


class CertificateError(RailslipError, ArithmeticError):
    """A margin could not be enclosed in an interval of relative width 1e-9, as a certificate requires."""


class _TooWideError(Exception):
    """A ball is too wide, at the current precision, to decide a sign or to enclose a margin closely enough."""


@dataclass(frozen=True)
class Certificate:
    """Proved stability and margins of a loop; each enclosure is (lowest, highest), of relative width <= 1e-9.

    The numbers that define the loop (coefficients, matrices or roots, gain, dead time) are taken as exact, as given in
    double precision.

    - stable: true if every closed-loop pole lies left of the imaginary axis.
    - marginal: true if a closed-loop pole lies on the imaginary axis, or so near that the precision does not show on
      which side; false for a loop with infinitely many poles on the axis or right of it.
    - unstable_poles: number of closed-loop poles with real part >= 0.
    - gain_crossovers: enclosures of all frequencies with |L| = 1, rad/s.
    - bits: precision of the ball arithmetic; the relative width of a ball is 2^-bits.
    - parts: number of frequency intervals on which |S| and |T| were bounded; 0 without dead time.
    - gain_increase, gain_decrease, phase_deg, delay_s, ms, mt: enclosures of the margins with these names in `Margins`:
      factors, deg, s, ratios. All are None for an unstable loop. Both ends are inf for a margin without bound.
      `gain_decrease` is (0, 1e-9) if L(0) < -1e9, as for an integrator with rounded coefficients.
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
    """Compute the certificate of a loop; `margins` are its margins, or None if it is unstable.

    Raises CertificateError if 4000 bits do not suffice; the loop is then on the stability boundary in double precision.
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
                # the loop is stable: the gain limits lie on either side of 1
                found[:2] = (max(found[0][0], 1.0), found[0][1]), (found[1][0], min(found[1][1], 1.0))
                return Certificate(True, False, 0.0, crossovers, bits, parts, *found)
            except _TooWideError:
                continue
    raise CertificateError(
        f"certificate: with {_BITS[-1]} bits the relative width of a margin's enclosure is still above {WIDTH:g}; in "
        "double precision the loop is on the stability boundary; change the gain"
    )


def _ends(ball: arb) -> Enclosure:
    """Lower and upper end of a ball as doubles, rounded outward."""
    if not ball.is_finite():
        return math.inf, math.inf
    low, high = float(ball.lower()), float(ball.upper())
    if ball.is_exact() and low == high:
        return low, high
    return math.nextafter(low, -math.inf), math.nextafter(high, math.inf)


def _narrow(ball: arb) -> Enclosure:
    low, high = _ends(ball)
    if high - low > WIDTH * abs(high):
        raise _TooWideError
    return low, high


def _least(balls: Iterable[arb]) -> arb:
    return reduce(arb.min, balls, arb.pos_inf())


# -- gain, phase and delay ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _End:
    """End of a frequency interval: frequency, ln|L|, and arg L/pi, which is None where the phase tends to -infinity."""

    omega: arb  # rad/s, from 0 to infinity
    size: float
    half_turns: arb | None


def _pieces(response: Response, bits: int) -> Iterator[tuple[_End, _End, bool]]:
    """Yield both ends of each frequency interval with monotone |L| and phase, and True if |L| > 1 on the interval."""
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
            below, above = (arb(at), arb(at)) if rest == 0 else (below, above)  # L < 0 exactly at the node
        size = response.log_size(float(omega.mid()))
        yield start, _End(omega, size, below), large
        start, large = _End(omega, size, above), large != (kind == GAIN and odd == 1)
    yield start, _End(arb.pos_inf(), last_size, None if math.isinf(last) else arb(last)), large


def _gain_margins(response: Response, bits: int) -> tuple[arb, arb]:
    # |L| is monotone on an interval: only the phase crossover with |L| nearest to 1 can limit the gain
    up: list[arb] = []  # values of 1/|L| > 1; `down` has values of |L| > 1
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
    """First odd integer strictly between the values of arg L/pi at `near` and at `far`; None if there is none."""
    if near.half_turns is None:
        return None  # phase crossovers accumulate at infinity; the limit of |L| there is a gain limit of its own
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
    """Ball that is proved to contain a frequency, rad/s, at which arg L = `odd` pi."""
    first, last = (-math.inf if one.half_turns is None else float(one.half_turns.mid()) for one in (start, end))
    found = phase_crossover(response, float(start.omega.mid()), float(end.omega.mid()), first, last, odd)
    omega = response.exact.phase_crossover(found, response.turned(found)[1], odd)
    away = omega * arb(2) ** (-ctx.prec // 2)
    below, above = (response.exact.argument(omega + step) - odd * arb.pi() for step in (-away, away))
    if not (below * above < 0):
        raise _TooWideError
    return (omega - away).union(omega + away)


def _crossover_margins(response: Response, bits: int) -> tuple[arb, arb]:
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
    if response.dead_time > 0:
        cover = _Cover(response, margins, bits)
        return cover.peaks(), cover.parts
    ms, mt = (peak.union(peak.upper() * (1 + _ABOVE)) for peak, _ in response.exact.peaks()[:2])
    return (ms, mt), 0


class _Cover:
    def __init__(self, response: Response, margins: Margins, bits: int) -> None:
        self._response, self._bits = response, bits
        zeros, poles = response.exact.roots()
        self._roots = zeros + poles
        sizes = ((poles, arb.pos_inf()), (zeros, arb(0)))
        self._on_axis = [(root.imag, size) for of, size in sizes for root in of if root.real.is_zero()]
        self._frequencies = margins.ms_frequency, margins.mt_frequency
        self._near: list[arb] = []
        self.parts = 0

    def peaks(self) -> tuple[arb, arb]:
        attained = [self._peak(shape, omega) for shape, omega in zip(SHAPES[:2], self._frequencies, strict=True)]
        self._most = [value.upper() * (1 + _ABOVE) for value in attained]
        for start, end, _ in _pieces(self._response, self._bits):
            self._cover(start, end)
        return attained[0].union(self._most[0]), attained[1].union(self._most[1])

    def _peak(self, shape: tuple[float, float], omega: float) -> arb:
        if 0 < omega < math.inf:
            found, peak = self._response.exact.peak(*shape, omega * (1 - _BESIDE), omega, omega * (1 + _BESIDE))
            self._near += [found * (1 + side * away) for side in (-1, 1) for away in _NEAR_PEAK.tolist()]
            return peak
        num, den = self._fraction_at(omega)
        return abs((shape[0] * den + shape[1] * num) / (num + den))

    def _fraction_at(self, omega: float) -> tuple[arb, arb]:
        # with dead time L(inf) takes every phase; -|G(inf)| is the value nearest to -1
        if omega == 0:
            return arb(self._response.exact.numerator[0]), arb(self._response.exact.denominator[0])
        through = self._response.exact.through
        return arb(-abs(through) if self._response.dead_time > 0 else through), arb(1)

    def _cover(self, start: _End, end: _End) -> None:
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
        # value and slope in the middle, and a bound on the second derivative
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
        # |1 + L|^2 >= 1 + m^2 - 2 m c with m = |L| and cos(arg L) >= -c
        sizes = [self._size_at(one.omega) for one in (low, high)]
        c = _towards_minus_one(low.half_turns, high.half_turns)
        inverses = [arb.pos_inf() if size.is_zero() else 1 / size if size.is_finite() else arb(0) for size in sizes]
        squares = _least_square(sizes, c), _least_square(inverses, c)
        return all(square > 0 and 1 / square.sqrt() < most for square, most in zip(squares, self._most, strict=True))

    def _size_at(self, omega: arb) -> arb:
        if omega > 0 and omega.is_finite():
            at = next((size for one, size in self._on_axis if omega.overlaps(one)), None)
            return abs(self._response.exact.value(omega)[0]) if at is None else at
        num, den = self._fraction_at(float(omega))
        return arb.pos_inf() if den.is_zero() else abs(num / den)


def _towards_minus_one(first: arb | None, second: arb | None) -> arb:
    """Largest value of -cos(arg L) for arg L/pi from `first` to `second`."""
    if first is None or second is None:
        return arb(1)
    lowest, highest = ((first.min(second) - 1) / 2).ceil(), ((first.max(second) - 1) / 2).floor()
    return (-first.cos_pi()).max(-second.cos_pi()) if highest < lowest else arb(1)


def _least_square(sizes: Sequence[arb], c: arb) -> arb:
    """Lower bound on 1 + m^2 - 2 m c for m between the two `sizes`."""
    low, high = sizes[0].min(sizes[1]), sizes[0].max(sizes[1])
    candidates = [1 + m * (m - 2 * c) for m in (low, high) if m.is_finite()]
    if not (c <= low or c >= high):
        candidates.append(1 - c * c)
    return _least(candidates)


def _between(low: _End, high: _End) -> arb:
    if not low.omega > 0:
        middle = high.omega.mid() / _STEP_OUT if high.omega.is_finite() else arb(1)
    elif not high.omega.is_finite():
        middle = low.omega.mid() * _STEP_OUT
    else:
        middle = (low.omega * high.omega).sqrt().mid()
        if not (low.omega < middle < high.omega):
            raise _TooWideError
    if not _FARTHEST > middle > 1 / _FARTHEST:
        raise _TooWideError
    return middle


# -- loops with internal delays: mean-value bounds on frequency intervals -------------------------------------------

Terms = Sequence[tuple[float, Iterable[float]]]
"""Terms of a sum of polynomials times exp(-delay s): pairs of delay, s, and coefficients in descending powers of s."""

# First division: number of intervals with equal ratio of their ends, and lowest end relative to the highest frequency
_FIRST_PARTS, _LOWEST = 64, 1e-6
_APART = 1.5  # least ratio of |D + N| in the middle of an interval to its change to the ends: D + N turns < 90 deg
_MOST_DELAYED = 20_000  # largest number of frequency intervals; each takes some thousand ball operations
_HALVINGS = 8  # bisections of a bracket in addition to `DOUBLE_BITS`


class _Sum:
    """Sum of polynomials times exp(-delay s), divided by s^removed; evaluated in ball arithmetic at s = j omega."""

    def __init__(self, terms: Terms, removed: int) -> None:
        given = [(fraction(delay), fmpq_poly([fraction(c) for c in reversed(list(row))])) for delay, row in terms]
        self.derivatives, self.removed = [given], removed
        for _ in range(removed + 2):
            self.derivatives.append([(tau, one.derivative() - tau * one) for tau, one in self.derivatives[-1]])
        if any(sum((one[0] for _, one in each), fmpq(0)) != 0 for each in self.derivatives[:removed]):
            raise CertificateError(
                f"certificate: numerator or denominator of the loop has no zero of order {removed} at s = 0, because "
                "its coefficients are rounded; give exact coefficients"
            )
        self._longest = max(float(delay) for delay, _ in terms)
        self._balls: dict[int, list[list[tuple[arb, acb_poly]]]] = {}

    def _bare(self, s: acb, order: int) -> acb:
        """Derivative of the given `order` of the sum before the division by s^removed."""
        if ctx.prec not in self._balls:
            self._balls[ctx.prec] = [
                [(arb(tau), acb_poly(arb_poly(one))) for tau, one in each] for each in self.derivatives
            ]
        return sum((one(s) * (-tau * s).exp() for tau, one in self._balls[ctx.prec][order]), acb(0))

    def at(self, omega: arb) -> tuple[acb, acb]:
        """Value at j omega, and its derivative with respect to omega."""
        s, r = acb(0, omega), self.removed
        if omega.is_zero():
            return self._bare(s, r) / math.factorial(r), acb(0, 1) * self._bare(s, r + 1) / math.factorial(r + 1)
        value = self._bare(s, 0) / s**r
        return value, acb(0, 1) * (self._bare(s, 1) / s**r - r * value / s)

    def over(self, low: arb, high: arb) -> _Part:
        middle, r = ((low + high) / 2).mid(), self.removed
        value, rate = self.at(middle)
        if r and high * self._longest < 1:  # near 0: a divided difference is a mean of the derivative
            bend = 2 * self._bare(acb(0, arb(0).union(high)), r + 2) / math.factorial(r + 2)
        else:
            s = acb(0, low.union(high))
            none, one, two = (self._bare(s, k) for k in range(3))
            bend = (two - 2 * r * one / s + r * (r + 1) * none / (s * s)) / s**r if r else two
        offset = low.union(high) - middle
        rates = rate - bend * offset
        return _Part(value, value + rates * offset, rates)

    def total(self, omega: arb) -> arb:
        """Sum of |c| omega^k over the coefficients c of s^k in all polynomials, without the division by s^removed."""
        return sum(
            (abs(arb(c)) * omega**k for _, one in self.derivatives[0] for k, c in enumerate(one.coeffs())), arb(0)
        )


class _Part(NamedTuple):
    """A function on a frequency interval: value at the middle, enclosures of values and derivatives on the interval."""

    middle: acb
    values: acb
    rates: acb

    @property
    def square(self) -> tuple[arb, arb]:
        """Squared magnitude at the middle, and enclosure of its derivative on the interval."""
        rates = 2 * (self.values.real * self.rates.real + self.values.imag * self.rates.imag)
        return self.middle.real**2 + self.middle.imag**2, rates


def certify_delayed(num: Terms, den: Terms, removed: int, margins: Margins | None) -> Certificate:
    """Compute the certificate of L = N/D, where N and D are sums of polynomials times exp(-delay s).

    - num, den: terms of N and D, each a delay in s and coefficients in descending powers of s.
    - removed: N and D are each divided by s^removed; `num` and `den` are the sums before this division.
    - margins: margins in double precision, near which the enclosures are searched; None for an unstable loop.

    The frequency axis is divided until mean-value bounds prove the following on each interval. D + N does not vanish.
    |L| crosses 1 at most once. |S| and |T| stay below the upper ends of their enclosures. No gain factor inside the
    gain margins brings L to -1.
    """
    for bits in _BITS:
        with ctx.workprec(bits):
            try:
                return _Delayed(_Sum(num, removed), _Sum(den, removed), margins).certificate(bits)
            except _TooWideError:
                continue
    raise CertificateError(
        f"certificate: with {_BITS[-1]} bits and {_MOST_DELAYED} frequency intervals the relative width of a margin's "
        f"enclosure is still above {WIDTH:g}; the loop is near the stability boundary, or has two equally high peaks; "
        "change the gain"
    )


class _Delayed:
    def __init__(self, num: _Sum, den: _Sum, margins: Margins | None) -> None:
        self._num, self._den, self._margins = num, den, margins
        lead = den.derivatives[0][0][1]
        self._lead, self._order = arb(lead[lead.degree()]), lead.degree() - den.removed
        self._crossed: list[tuple[arb, arb]] = []
        self._most: list[arb] = []  # squares of the upper bounds on |S| and |T|
        self._up, self._down = arb(1), arb(1)  # no gain factor between these brings L to -1

    def certificate(self, bits: int) -> Certificate:
        m = self._margins
        if m is not None:
            up = self._factor(m.gain_increase, m.gain_increase_frequency)
            down = self._factor(m.gain_decrease, m.gain_decrease_frequency)
            if down.is_zero() and self._large_and_negative():
                down = arb(0).union(arb(WIDTH))
            self._up, self._down = up.lower() * (1 - _ABOVE), down.upper() * (1 + _ABOVE)
            attained = [self._peak(kind, omega) for kind, omega in enumerate((m.ms_frequency, m.mt_frequency))]
            most = [one.upper() * (1 + _ABOVE) for one in attained]
            self._most = [one**2 for one in most]
        count, parts = self._cover()
        omegas = [self._bracketed(self._gap, *ends) for ends in sorted(self._crossed, key=lambda ends: float(ends[0]))]
        crossovers = tuple(map(_ends, omegas))
        if m is None:
            return Certificate(False, False, float(count), crossovers, bits, parts)
        if count:
            raise _TooWideError
        angles = [self._angle(omega) for omega in omegas]
        phase = _least(180 * abs(angle) / arb.pi() for angle in angles)
        delays = (
            (angle if angle > 0 else angle + 2 * arb.pi()) / omega for angle, omega in zip(angles, omegas, strict=True)
        )
        found = [up.union(self._up), down.union(self._down), phase, _least(delays)]
        found += [one.union(end) for one, end in zip(attained, most, strict=True)]
        ends = [_narrow(one) if one.lower() > 0 else (0.0, _ends(one)[1]) for one in found]
        return Certificate(True, False, 0.0, crossovers, bits, parts, *ends)

    def _large_and_negative(self) -> bool:
        """True if L(0) < -1e9, as for an integrator with rounded coefficients."""
        num, den = self._num.at(arb(0))[0].real, self._den.at(arb(0))[0].real
        return bool(num * den < 0 and abs(den) < WIDTH * abs(num))

    def _cover(self) -> tuple[int, int]:
        """Number of closed-loop poles right of the imaginary axis, and number of frequency intervals."""
        # the change of the phase of D + N along the imaginary axis gives the number of poles
        end = self._end()
        edges = [arb(0), *(end * _LOWEST ** (1 - k / _FIRST_PARTS) for k in range(_FIRST_PARTS)), end]
        left, parts, turned = list(pairwise(edge.mid() for edge in edges)), 0, arb(0)
        while left:
            low, high = left.pop()
            parts += 1
            if parts > _MOST_DELAYED:
                raise _TooWideError
            if self._proved(low, high):
                turned += (self._closed(high) / self._closed(low)).arg()
            else:
                middle = high / 16 if low.is_zero() else ((low + high) / 2).mid()
                left += [(low, middle), (middle, high)]
        beyond = (self._closed(end) / (acb(0, 1) ** self._order * self._lead)).arg()
        count = ((self._order * arb.pi() / 2 - turned + beyond) / arb.pi()).unique_fmpz()
        if count is None:
            raise _TooWideError
        return int(count), parts

    def _end(self) -> arb:
        """Frequency, rad/s, above which the statements in `certify_delayed` hold: the highest power of s dominates."""
        end = arb(1)
        while True:
            lead = abs(self._lead) * end ** (self._order + self._den.removed)
            num, den = self._num.total(end), 2 * lead - self._den.total(end)
            shares = [(den - num) ** 2 * most > part**2 for most, part in zip(self._most, (den, num), strict=False)]
            if den > num and den > self._up * num and all(shares):
                return end
            end *= 2
            if end > _FARTHEST:
                raise _TooWideError

    def _proved(self, low: arb, high: arb) -> bool:
        """True if the statements in `certify_delayed` are proved from `low` to `high`; a gain crossover is stored."""
        half = (high - low) / 2
        num, den = self._num.over(low, high), self._den.over(low, high)
        both = _Part(*(a + b for a, b in zip(num, den, strict=True)))
        if not abs(both.middle) > _APART * half * abs(both.rates):
            return False
        (n, n_rate), (d, d_rate), (f, f_rate) = num.square, den.square, both.square

        def sign(value: arb, rate: arb) -> int:  # 0 if not proved on the whole interval
            moved = half * abs(rate)
            return 1 if value > moved else -1 if value < -moved else 0

        gap = sign(n - d, n_rate - d_rate)
        if gap == 0 and not (n_rate > d_rate or n_rate < d_rate):
            return False
        for most, (size, rate) in zip(self._most, (den.square, num.square), strict=False):
            if sign(most * f - size, most * f_rate - rate) < 1:
                return False
        if self._most and not self._off_negative_axis(low, high, num, den, sign):
            up, down = (sign(k * k * n - d, k * k * n_rate - d_rate) for k in (self._up, self._down))
            if not ((gap > 0 or up < 0) and (gap < 0 or down > 0)):
                return False
        if gap == 0 and self._gap(low) * self._gap(high) < 0:
            self._crossed.append((low, high))
        return True

    def _off_negative_axis(self, low: arb, high: arb, num: _Part, den: _Part, sign: Callable[[arb, arb], int]) -> bool:
        """True if L is proved not to be real and negative anywhere from `low` to `high`."""
        if low.is_zero():  # D may vanish at 0: use D without these zeros, which has the same direction
            den = self._direction.over(low, high)
            den = _Part(*(one * acb(0, 1) ** (self._direction.removed - self._den.removed) for one in den))
        product = num.middle * den.middle.conjugate()
        rates = num.rates * den.values.conjugate() + num.values * den.rates.conjugate()
        return sign(product.imag, rates.imag) != 0 or sign(product.real, rates.real) > 0

    @cached_property
    def _direction(self) -> _Sum:
        """D without its zeros at s = 0."""
        terms = [
            (nearest_double(tau), [nearest_double(c) for c in reversed(one.coeffs())] or [0.0])
            for tau, one in self._den.derivatives[0]
        ]
        reduced = self._den
        while reduced.at(arb(0))[0].is_zero():
            reduced = _Sum(terms, reduced.removed + 1)
        return reduced

    def _closed(self, omega: arb) -> acb:
        return self._num.at(omega)[0] + self._den.at(omega)[0]

    def _product(self, omega: arb) -> acb:
        """L |D|^2 at j omega, which has the phase of L."""
        return self._num.at(omega)[0] * self._den.at(omega)[0].conjugate()

    def _gap(self, omega: arb) -> arb:
        return abs(self._num.at(omega)[0]) - abs(self._den.at(omega)[0])

    def _angle(self, omega: arb) -> arb:
        """Phase of -L, rad, from -pi to pi."""
        angle = (-self._product(omega)).arg()
        if not (angle > 0 or angle < 0):
            raise _TooWideError
        return angle

    def _bracketed(self, function: Callable[[arb], arb], low: arb, high: arb) -> arb:
        """Ball that contains the frequency between `low` and `high` at which `function` changes sign."""
        below = function(low)
        if not below * function(high) < 0:
            raise _TooWideError
        for _ in range(DOUBLE_BITS + _HALVINGS):
            middle = ((low + high) / 2).mid()
            at = function(middle)
            if not (at > 0 or at < 0):
                break
            low, high = (middle, high) if at * below > 0 else (low, middle)
        return low.union(high)

    def _factor(self, factor: float, omega: float) -> arb:
        """Gain margin as a ball; `factor` and `omega`, rad/s, are the margin and its frequency in double precision."""
        if not math.isfinite(omega):
            if factor > 0:
                raise CertificateError(
                    f"certificate: gain_increase is {factor:g}; a loop with internal delays has a certificate only if "
                    "some finite gain factor destabilises it"
                )
            return arb(0)
        if omega == 0:
            return -(self._den.at(arb(0))[0] / self._num.at(arb(0))[0]).real
        ends = arb(omega * (1 - _BESIDE)), arb(omega * (1 + _BESIDE))
        at = self._bracketed(lambda one: self._product(one).imag, *ends)
        return abs(self._den.at(at)[0]) / abs(self._num.at(at)[0])

    def _peak(self, kind: int, omega: float) -> arb:
        """|S| (`kind` 0) or |T| (`kind` 1) at the frequency `omega`, rad/s."""
        if math.isinf(omega):
            return arb(1 - kind)
        return abs((self._den, self._num)[kind].at(arb(omega))[0]) / abs(self._closed(arb(omega)))
