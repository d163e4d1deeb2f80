"""What the polynomials of a loop L = N/D exp(-tau s) decide, in integers and ball arithmetic.

On the axis, with x = omega^2, |N|^2, |D|^2 and the numerators of d|L|^2/d omega and of d(arg L)/d omega are polynomials
in x, dead time included. Their positive roots are isolated with certainty (FLINT): all gain crossovers are known, and
between neighbouring extrema |L| and its phase are monotone. No grid is asked. The polynomials are those of `Rational`:
of the coefficients, matrices or roots as they were given.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING

from flint import acb, arb, ctx, fmpq, fmpq_poly

from .polynomials import (
    DOUBLE_BITS,
    Axis,
    complex_roots,
    fraction,
    largest_root_of_ratio,
    positive_square_roots,
    without,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    from .rational import Rational

_NEWTON_STEPS = 4  # from a double
_NEAR = 1e-6  # relative: how far a peak may lie from where doubles see it
REFINED_BITS = 160  # of margins that doubles would give with fewer digits
MOST_BITS = 4000
"""Precision at which a sign that is still open is given up as zero."""

GAIN, SIZE, PHASE, AXIS = "gain", "size", "phase", "axis"
"""Kinds of frequencies: |L| = 1, extrema of |L|, extrema of arg L, zeros and poles of G on the axis."""


class ExactLoop:
    """A `Rational` and its `dead_time`, s, as exact polynomials."""

    def __init__(self, system: Rational, dead_time: float) -> None:
        self._system = system
        self._given, self._dead_time = dead_time, fraction(dead_time)
        self._found: dict[tuple[str, int], list[tuple[arb, int]]] = {}
        self._roots: dict[int, tuple[list[acb], list[acb]]] = {}

    def __reduce__(self) -> tuple[type[ExactLoop], tuple[Rational, float]]:
        """To another process go the numbers it was made from: FLINT's do not."""
        return ExactLoop, (self._system, self._given)

    @property
    def numerator(self) -> fmpq_poly:
        """N(s), gain included."""
        return self._system.polynomials[0]

    @property
    def denominator(self) -> fmpq_poly:
        """D(s)."""
        return self._system.polynomials[1]

    @property
    def through(self) -> fmpq:
        """G(infinity)."""
        order = self.denominator.degree()
        return self.numerator[order] / self.denominator[order]

    @property
    def hidden_on_axis(self) -> bool:
        """Whether a zero and a pole of G meet on the axis, 0 aside."""
        common = self._axis[0].undamped.gcd(self._axis[1].undamped)
        return bool(positive_square_roots(common))

    @property
    def pole_at_origin(self) -> bool:
        """Whether s = 0 is a closed-loop pole."""
        return bool(self.numerator[0] + self.denominator[0] == 0)

    @property
    def all_pass(self) -> bool:
        """Whether |L| = 1 at every frequency."""
        return bool(self._polynomials[GAIN].degree() < 0)

    @property
    def large_at_zero(self) -> bool:
        """Whether |L| > 1 as omega tends to 0."""
        gap = self._polynomials[GAIN]
        return bool(next(c for c in gap.coeffs() if c != 0) > 0)

    def frequencies(self, kind: str, bits: int = DOUBLE_BITS) -> list[tuple[arb, int]]:
        """All omega > 0 of a kind, rad/s, ascending, as balls of relative width 2^-bits, with their multiplicities."""
        if (kind, bits) not in self._found:
            with ctx.workprec(bits):
                self._found[kind, bits] = positive_square_roots(self._polynomials[kind])
        return self._found[kind, bits]

    def value(self, omega: arb) -> tuple[acb, acb]:
        """L(j omega) and d ln L/d omega, at the precision of the context."""
        s, slope = acb(0, omega), acb(0)
        value = acb(self.numerator.leading_coefficient() / self.denominator.leading_coefficient())
        zeros, poles = self.roots()
        for root in zeros:
            away = s - root
            value, slope = value * away, slope + 1 / away
        for root in poles:
            away = 1 / (s - root)
            value, slope = value * away, slope - away
        delay = arb(self._dead_time)
        return value * (s * -delay).exp(), acb(0, 1) * (slope - delay)

    def phase_crossover(self, omega: float, slope: float) -> tuple[float, float]:
        """A phase crossover near `omega`, rad/s, and 1/|L| there, refined; `slope` is d(arg L)/d omega."""
        with ctx.workprec(REFINED_BITS):
            refined, found = arb(omega), self.argument(arb(omega)) / arb.pi()
            odd = 2 * round((float(found) - 1) / 2) + 1
            for _ in range(2):
                refined = (refined - (self.argument(refined) - odd * arb.pi()) / slope).mid()
            return float(refined), float((1 / abs(self.value(refined)[0])).mid())

    def peak(self, a: float, b: float, omega: float) -> tuple[arb, arb]:
        """Where, rad/s, |a + b L|/|1 + L| has its peak near `omega`, refined by Newton's method, and the peak."""

        def slope(at: arb) -> arb:
            """Of half the square of the inverse, which is nearly a parabola however sharp the peak is."""
            loop, rate = self.value(at)
            inverse = (1 + loop) / (a + b * loop)
            return (inverse.conjugate() * (a - b) * rate * loop / (a + b * loop) ** 2).real

        found = arb(omega)
        for _ in range(_NEWTON_STEPS):
            step = found * arb(2) ** (-ctx.prec // 3)
            here = slope(found)
            change = here * step / (slope(found + step) - here)
            if not abs(change) < found * _NEAR:
                break  # no peak so near: a resonance beside it, or the precision does not tell
            found = (found - change).mid()
        loop, _ = self.value(found)
        return found, abs((a + b * loop) / (1 + loop))

    def peaks(self) -> list[tuple[arb, float]]:
        """Suprema over omega >= 0 of |S|, |T| and |S - 1/2| without dead time, and where they are attained, rad/s."""
        n, d = self.numerator, self.denominator
        below = Axis(n + d).power
        return [largest_root_of_ratio(Axis(one).power, below) for one in (d, n, (d - n) / 2)]

    def roots(self) -> tuple[list[acb], list[acb]]:
        """Zeros and poles of G, at the precision of the context or higher; the real part is 0 on the axis alone."""
        if not self._system.from_coefficients:
            return [acb(root) for root in self._system.zeros], [acb(root) for root in self._system.poles]
        if ctx.prec not in self._roots:
            self._roots[ctx.prec] = complex_roots(self.numerator), complex_roots(self.denominator)
        return self._roots[ctx.prec]

    def argument(self, omega: arb, side: int = 0) -> arb:
        """Continuous phase of L(j omega), rad, as `Rational.angle` has it, at the context's precision; at a frequency
        of the kind `AXIS` just above (`side` 1) or below it (-1)."""
        turned = arb.pi() if self._system.gain < 0 else arb(0)
        zeros, poles = (_angle(roots, omega, side) for roots in self.roots())
        return turned + zeros - poles - arb(self._dead_time) * omega

    def offset(self, kind: str, index: int) -> tuple[int, float]:
        """The phase at frequency number `index` of a kind, as an odd n next to arg L/pi and the signed rest; 0.0 if
        `MOST_BITS` do not tell it from zero."""
        bits = DOUBLE_BITS
        while True:
            bits = min(4 * bits, MOST_BITS)
            with ctx.workprec(bits):
                half = self.argument(self.frequencies(kind, bits)[index][0]) / arb.pi()
                odd = 2 * int((half.mid() / 2).floor().unique_fmpz()) + 1
                rest = half - odd
            if rest > 0 or rest < 0:
                return odd, float(rest.mid()) or math.copysign(math.ulp(0.0), 1 if rest > 0 else -1)
            if bits == MOST_BITS:
                return odd, 0.0

    @cached_property
    def _axis(self) -> tuple[Axis, Axis]:
        return Axis(self.numerator), Axis(self.denominator)

    @cached_property
    def _polynomials(self) -> dict[str, fmpq_poly]:
        num, den = self._axis
        common = num.power.gcd(den.power)
        p, r = num.power // common, den.power // common
        turned = num.turning * r - den.turning * p - self._dead_time * common * p * r
        undamped = num.undamped * den.undamped
        size, phase = (without(undamped, one) for one in (p.derivative() * r - p * r.derivative(), turned))
        return {GAIN: p - r, SIZE: size, PHASE: phase, AXIS: undamped}


def _angle(roots: Iterable[acb], omega: arb, side: int) -> arb:
    """`rational.angle_sum` in balls."""
    total = arb(0)
    for root in roots:
        away = omega - root.imag
        if not (root.real.is_zero() and away.contains(0)):
            angle = arb.atan2(away, abs(root.real))
        else:
            angle = side * arb.pi() / 2 if side else arb(0, 1.6)  # not known on which side: more than a quarter turn
        total += arb.pi() - angle if root.real > 0 else angle
    return total
