"""What the polynomials of a loop L = N/D exp(-tau s) decide, in integers and ball arithmetic.

On the axis, with x = omega^2, |N|^2, |D|^2 and the numerators of d|L|^2/d omega and of d(arg L)/d omega are polynomials
in x, dead time included. Their positive roots are isolated with certainty (FLINT): all gain crossovers are known, and
between neighbouring extrema |L| and its phase are monotone. No grid is asked. The numbers are those of the factored
`Rational`, taken as exact.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING

from flint import acb, arb, ctx, fmpq, fmpq_poly

if TYPE_CHECKING:
    from collections.abc import Iterable

    from .rational import Rational

_BITS = 64  # of the frequencies that are then taken as doubles
_NEWTON_STEPS = 4  # from a double
_NEAR = 1e-6  # relative: how far a peak may lie from where doubles see it
REFINED_BITS = 160  # of margins that doubles would give with fewer digits
MOST_BITS = 4000
"""Precision at which a sign that is still open is given up as zero."""

GAIN, SIZE, PHASE = "gain", "size", "phase"
"""Kinds of frequencies: |L| = 1, extrema of |L|, extrema of arg L."""


class ExactLoop:
    """A `Rational` and its `dead_time`, s, as exact polynomials."""

    def __init__(self, system: Rational, dead_time: float) -> None:
        self._system = system
        self._given, self._dead_time = dead_time, fraction(dead_time)
        self._found: dict[tuple[str, int], list[tuple[arb, int]]] = {}

    def __reduce__(self) -> tuple[type[ExactLoop], tuple[Rational, float]]:
        """To another process go the numbers it was made from: FLINT's do not."""
        return ExactLoop, (self._system, self._given)

    @cached_property
    def numerator(self) -> fmpq_poly:
        """N(s), gain included."""
        return polynomial(self._system.zeros, self._system.gain)

    @cached_property
    def denominator(self) -> fmpq_poly:
        """D(s), monic."""
        return polynomial(self._system.poles, 1.0)

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

    def frequencies(self, kind: str, bits: int = _BITS) -> list[tuple[arb, int]]:
        """All omega > 0 of a kind, rad/s, ascending, as balls of relative width 2^-bits, with their multiplicities."""
        if (kind, bits) not in self._found:
            with ctx.workprec(bits):
                self._found[kind, bits] = positive_square_roots(self._polynomials[kind])
        return self._found[kind, bits]

    def value(self, omega: arb) -> tuple[acb, acb]:
        """L(j omega) and d ln L/d omega, at the precision of the context."""
        s, value, slope = acb(0, omega), acb(self._system.gain), acb(0)
        for root in self._system.zeros.tolist():
            away = s - acb(root)
            value, slope = value * away, slope + 1 / away
        for root in self._system.poles.tolist():
            away = 1 / (s - acb(root))
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

    def argument(self, omega: arb, side: int = 1) -> arb:
        """Continuous phase of L(j omega), rad, as `Rational.angle` has it, at the precision of the context; with a root
        on the axis there, just above (`side` 1) or below it (-1)."""
        turned = arb.pi() if self._system.gain < 0 else arb(0)
        zeros, poles = (_angle(roots, omega, side) for roots in (self._system.zeros, self._system.poles))
        return turned + zeros - poles - arb(self._dead_time) * omega

    def offset(self, kind: str, index: int) -> tuple[int, float]:
        """The phase at frequency number `index` of a kind, as an odd n next to arg L/pi and the signed rest; 0.0 if
        `MOST_BITS` do not tell it from zero."""
        bits = _BITS
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
    def _polynomials(self) -> dict[str, fmpq_poly]:
        num, den = Axis(self.numerator), Axis(self.denominator)
        common = num.power.gcd(den.power)
        p, r = num.power // common, den.power // common
        turned = num.turning * r - den.turning * p - self._dead_time * common * p * r
        return {GAIN: p - r, SIZE: p.derivative() * r - p * r.derivative(), PHASE: turned}


class Axis:
    """A polynomial on the axis, F(j omega) = E(x) + j omega O(x): |F|^2 and |F|^2 d(arg F)/d omega, both in x."""

    def __init__(self, polynomial: fmpq_poly) -> None:
        coefficients = polynomial.coeffs()
        even, odd = (fmpq_poly([(-1) ** k * c for k, c in enumerate(coefficients[i::2])]) for i in (0, 1))
        self.even, self.odd = even, odd
        x = fmpq_poly([0, 1])
        self.power = even * even + x * odd * odd
        self.turning = (odd + 2 * x * odd.derivative()) * even - 2 * x * odd * even.derivative()


def fraction(value: float) -> fmpq:
    return fmpq(*float(value).as_integer_ratio())


def polynomial(roots: Iterable[complex], gain: float) -> fmpq_poly:
    """gain prod(s - roots); of a pair the upper root stands for both."""
    found = fmpq_poly([fraction(gain)])
    for root in roots:
        a, b = fraction(root.real), fraction(root.imag)
        if root.imag == 0:
            found *= fmpq_poly([-a, 1])
        elif root.imag > 0:
            found *= fmpq_poly([a * a + b * b, -2 * a, 1])
    return found


def positive_square_roots(polynomial: fmpq_poly) -> list[tuple[arb, int]]:
    """Square roots of the positive real roots, ascending, with multiplicities."""
    if polynomial.degree() < 1:
        return []
    while polynomial[0] == 0:
        polynomial = polynomial.right_shift(1)
    signs = [c > 0 for c in polynomial.coeffs() if c != 0]
    if all(signs) or not any(signs):
        return []  # Descartes: no change of sign, no positive root
    found = [(root.real, count) for root, count in polynomial.complex_roots() if root.imag == 0 and root.real > 0]
    return [(root.sqrt(), count) for root, count in sorted(found, key=lambda pair: pair[0].mid())]


def _angle(roots: Iterable[complex], omega: arb, side: int) -> arb:
    """`rational.angle_sum` in balls."""
    total = arb(0)
    for root in roots:
        real, away = abs(root.real), omega - root.imag
        angle = side * arb.pi() / 2 if real == 0 and away.contains(0) else arb.atan2(away, arb(real))
        total += arb.pi() - angle if root.real > 0 else angle
    return total
