"""Gain crossovers, phase crossovers and extrema of a loop L(s) = G(s) exp(-tau s).

Gain crossovers and the extrema of |L| and arg L are roots of exact polynomials (`ExactLoop`). They divide the frequency
axis into intervals (`Piece`) on which |L| and arg L are monotone. The phase at both ends of an interval therefore gives
the number of its phase crossovers.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Iterable
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from flint import acb, acb_poly, arb, arb_poly, ctx, fmpq, fmpq_poly
from numpy.typing import NDArray

from railslip_ctrl.core.arguments import Complexes, Floats
from railslip_ctrl.core.records import dataclass

from .rational import (
    DOUBLE_BITS,
    Axis,
    Rational,
    complex_roots,
    fraction,
    largest_root_of_ratio,
    positive_square_roots,
    without,
)

# -- many bracketed scalar roots at once ---------------------------------------------------------------------------

# SciPy's `optimize.elementwise.find_root` has the same method, but one call costs milliseconds, as long as a whole
# `DeadTimeLoop.margins()`, and loads `scipy.optimize`.

_HALF_OF_THE_DIGITS = 1e-9  # relative step of Newton's method after which one more gives all digits of a double
_LARGEST = 700.0  # bound on ln|L|: exp(700) is still a double
_MOST_STEPS = 100  # bisection alone needs about 60 from a factor-of-two bracket to the last bit


def bracketed_roots(
    function: Callable[[Floats, NDArray[np.intp]], Floats],
    low: Floats,
    high: Floats,
    ends: tuple[Floats, Floats] | None = None,
) -> Floats:
    """Find one root of a function in each of n brackets, to the last bits of a double.

    - function: `function(x, index)` gives f(x), where x[i] lies in bracket number index[i].
    - low, high: ends of the brackets, (n,).
    - ends: values of f at `low` and at `high`, (n,) each; they are computed if not given.

    If f has the same sign at both ends of a bracket, the end with the smaller |f| is returned. Chandrupatla's method:
    Advances in Engineering Software 28(3), 1997, pp. 145-149.
    """
    if low.size == 0:
        return low
    index = np.arange(low.size)
    x1, x2 = low.astype(float), high.astype(float)
    f1, f2 = (function(x1, index), function(x2, index)) if ends is None else ends
    root = np.where(np.abs(f1) < np.abs(f2), x1, x2)
    live = np.sign(f1) * np.sign(f2) < 0
    if not live.all():
        x1, x2, f1, f2, index = x1[live], x2[live], f1[live], f2[live], index[live]
    t: Floats | float = 0.5
    for _ in range(_MOST_STEPS):
        if index.size == 0:
            break
        x = x1 + t * (x2 - x1)
        f = function(x, index)
        same = np.sign(f) == np.sign(f1)
        x3, f3 = np.where(same, x1, x2), np.where(same, f1, f2)
        x2, f2 = np.where(same, x2, x1), np.where(same, f2, f1)
        x1, f1 = x, f
        best = np.where(np.abs(f1) < np.abs(f2), x1, x2)
        root[index] = best
        width = np.abs(x2 - x1)
        smallest = 2e-16 * np.abs(best) + 1e-300
        keep = (width > 2 * smallest) & (f != 0)
        least = smallest / np.maximum(width, 1e-300)
        if not keep.all():
            kept = np.flatnonzero(keep)
            x1, x2, x3, f1, f2, f3, least = (q.take(kept) for q in (x1, x2, x3, f1, f2, f3, least))
            index = index.take(kept)
        t = _next_fraction(x1, x2, x3, f1, f2, f3, least)
    return root


def _next_fraction(x1: Floats, x2: Floats, x3: Floats, f1: Floats, f2: Floats, f3: Floats, least: Floats) -> Floats:
    """Next point of Chandrupatla's method in the bracket [x1, x2], as a fraction of its width."""
    # inverse quadratic interpolation through three points, or bisection where that is not reliable
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        of12, of13, of32 = f1 - f2, f1 - f3, f3 - f2
        xi, phi = (x1 - x2) / (x3 - x2), of12 / of32
        quadratic = f1 / of12 * f3 / of32 - (x3 - x1) / (x2 - x1) * f1 / of13 * f2 / of32
        trusted = (phi**2 < xi) & ((1 - phi) ** 2 < 1 - xi) & np.isfinite(quadratic)
    edge = np.minimum(least, 0.5)
    return np.asarray(np.minimum(np.maximum(np.where(trusted, quadratic, 0.5), edge), 1 - edge))


def monotone_root(
    function: Callable[[float], tuple[float, float]], start: float, low: float, high: float, side: float
) -> float:
    """Find the root of a monotone function between `low` and `high`, to rounding, by Newton's method.

    `function` gives f and df/dx; `start` is the start value. `low` may be 0, and `high` may be infinite. `side` is the
    sign of f at `low`.
    """
    x, width = start, math.inf
    for _ in range(_MOST_STEPS):
        f, slope = function(x)
        if f == 0:
            return x
        low, high = (x, high) if f * side > 0 else (low, x)
        new = x - f / slope if slope else math.nan
        step = abs(new - x)
        if low < new < high and step < 0.5 * width:
            if step <= _HALF_OF_THE_DIGITS * x:
                return new  # Newton's method doubles the correct digits
        elif high - low <= 4e-16 * x:
            return x
        else:
            new = math.sqrt(max(low, x / 64)) * math.sqrt(min(high, x * 64)) if high > 4 * low else 0.5 * (low + high)
        x, width = new, abs(new - x)
    return x


# -- exact polynomials of a loop --------------------------------------------------------------------------------------

# With x = omega^2, |N|^2, |D|^2 and the numerators of d|L|^2/d omega and of d(arg L)/d omega are polynomials in x, also
# with dead time. FLINT isolates their positive roots with certainty, without a grid.

_NEWTON_STEPS = 60  # most steps, bisections included
_NOTHING_GAINED = 1e-18  # relative increase of a peak by a step below which the search ends
_BITS_OF_A_STEP = 50  # bits that a Newton step adds at least if its slope is accurate to double precision
REFINED_BITS = 160  # precision for margins that lose digits in doubles
MOST_BITS = 4000  #: precision up to which a sign is computed; a number with an undecided sign is regarded as zero

GAIN, SIZE, PHASE, AXIS = "gain", "size", "phase", "axis"
"""Kinds of frequencies: gain crossovers, extrema of |L|, extrema of arg L, zeros and poles on the imaginary axis."""


class ExactLoop:
    """The loop L(s) = G(s) exp(-dead_time s) with exact polynomials; `dead_time` in s."""

    def __init__(self, system: Rational, dead_time: float) -> None:
        self._system = system
        self._given, self._dead_time = dead_time, fraction(dead_time)
        self._found: dict[tuple[str, int], list[tuple[arb, int]]] = {}
        self._roots: dict[int, tuple[list[acb], list[acb]]] = {}
        self._made: dict[int, list[tuple[acb_poly, acb_poly]]] = {}

    def __reduce__(self) -> tuple[type[ExactLoop], tuple[Rational, float]]:
        return ExactLoop, (self._system, self._given)  # FLINT's numbers cannot be pickled

    @property
    def numerator(self) -> fmpq_poly:
        return self._system.polynomials[0]

    @property
    def denominator(self) -> fmpq_poly:
        return self._system.polynomials[1]

    @property
    def through(self) -> fmpq:
        """Exact G(infinity), the feedthrough."""
        order = self.denominator.degree()
        return self.numerator[order] / self.denominator[order]

    @property
    def hidden_on_axis(self) -> bool:
        """True if a zero and a pole of G cancel on the imaginary axis, other than at 0."""
        common = self._axis[0].undamped.gcd(self._axis[1].undamped)
        return bool(positive_square_roots(common))

    @property
    def all_pass(self) -> bool:
        """True if |L| = 1 at every frequency."""
        return bool(self._polynomials[GAIN].degree() < 0)

    @property
    def large_at_zero(self) -> bool:
        """True if |L| > 1 as omega tends to 0."""
        gap = self._polynomials[GAIN]
        return bool(next(c for c in gap.coeffs() if c != 0) > 0)

    def frequencies(self, kind: str, bits: int = DOUBLE_BITS) -> list[tuple[arb, int]]:
        """All frequencies > 0, rad/s, of a `kind`, ascending, and their multiplicities.

        `kind` is `GAIN` (|L| = 1), `SIZE` (extrema of |L|), `PHASE` (extrema of arg L) or `AXIS` (zeros and poles on
        the imaginary axis). Each frequency is a ball of relative width 2^-bits.
        """
        if (kind, bits) not in self._found:
            with ctx.workprec(bits):
                self._found[kind, bits] = positive_square_roots(self._polynomials[kind])
        return self._found[kind, bits]

    def value(self, omega: arb) -> tuple[acb, acb]:
        """L(j omega) and d ln L/d omega, at FLINT's current precision."""
        s, delay = acb(0, omega), arb(self._dead_time)
        (num, den), (num_slope, den_slope) = ([one(s) for one in pair] for pair in self._balls[:2])
        return num / den * (s * -delay).exp(), acb(0, 1) * (num_slope / num - den_slope / den - delay)

    @property
    def _balls(self) -> list[tuple[acb_poly, acb_poly]]:
        if ctx.prec not in self._made:
            both = [(self.numerator, self.denominator)]
            for _ in range(2):
                both.append((both[-1][0].derivative(), both[-1][1].derivative()))
            self._made[ctx.prec] = [(acb_poly(arb_poly(num)), acb_poly(arb_poly(den))) for num, den in both]
        return self._made[ctx.prec]

    def phase_crossover(self, omega: float, slope: float, odd: int) -> arb:
        """Refine the frequency `omega`, rad/s, at which arg L = `odd` pi; `slope` is d(arg L)/d omega, s."""
        refined = arb(omega)
        for _ in range(ctx.prec // _BITS_OF_A_STEP + 1):
            refined = (refined - (self.argument(refined) - odd * arb.pi()) / slope).mid()
        return refined

    def size_at(self, a: float, b: float, omega: arb | float) -> arb:
        """|a + b L|/|1 + L| at one frequency, rad/s; a = 1, b = 0 give |S|, a = 0, b = 1 give |T|."""
        s = acb(0, omega)
        num, den = (one(s) for one in self._balls[0])
        num *= (s * acb(-self._dead_time)).exp()
        return abs(a * den + b * num) / abs(den + num)

    def peak(self, a: float, b: float, low: float, start: float, high: float) -> tuple[arb, arb]:
        """Frequency and height of the peak of `size_at` between `low` and `high`, rad/s, searched from `start`."""
        # Newton's method minimises |1 + L|^2/|a + b L|^2, which is nearly a parabola even for a sharp peak
        delay, below, omega, above = arb(self._dead_time), arb(low), arb(start), arb(high)
        for _ in range(_NEWTON_STEPS):
            s = acb(0, omega)
            (n, d), (n1, d1), (n2, d2) = ([one(s) for one in pair] for pair in self._balls)
            turn = (s * -delay).exp()
            e, e1, e2 = n * turn, (n1 - delay * n) * turn, (n2 - delay * (2 * n1 - delay * n)) * turn
            size, size1, size2 = a * d + b * e, a * d1 + b * e1, a * d2 + b * e2
            inverse = (d + e) / size
            first = (d1 + e1 - inverse * size1) / size
            second = (d2 + e2 - 2 * first * size1 - inverse * size2) / size
            slope = -(inverse.conjugate() * first).imag
            curvature = abs(first) ** 2 - (inverse.conjugate() * second).real
            below, above = (omega, above) if slope < 0 else (below, omega)
            new = (omega - slope / curvature).mid()
            step = new - omega
            if not (below < new < above and curvature > 0):
                new = ((below + above) / 2).mid() if above.is_finite() else 2 * omega
            elif abs(step) < _HALF_OF_THE_DIGITS * omega and abs(step * slope) < _NOTHING_GAINED * abs(inverse) ** 2:
                omega = new
                break
            omega = new
        return omega, self.size_at(a, b, omega)

    def peaks(self) -> list[tuple[arb, float]]:
        """Suprema of |S|, |T| and |S - 1/2|, and their frequencies, rad/s; only for a loop without dead time."""
        n, d = self.numerator, self.denominator
        below = Axis(n + d).power
        return [largest_root_of_ratio(Axis(one).power, below) for one in (d, n, (d - n) / 2)]

    def roots(self) -> tuple[list[acb], list[acb]]:
        """Zeros and poles of G as balls of FLINT's current precision or higher.

        A real part is exactly 0 for a root on the imaginary axis and differs from 0 for every other root.
        """
        if not self._system.from_coefficients:
            return [acb(root) for root in self._system.zeros], [acb(root) for root in self._system.poles]
        if ctx.prec not in self._roots:
            self._roots[ctx.prec] = complex_roots(self.numerator), complex_roots(self.denominator)
        return self._roots[ctx.prec]

    def argument(self, omega: arb, side: int = 0) -> arb:
        """Continuous phase of L(j omega), rad, as a ball of FLINT's current precision.

        At a zero or pole on the imaginary axis the phase jumps; `side` 1 gives its value above the jump, -1 below.
        """
        turned = arb.pi() if self._system.gain < 0 else arb(0)
        zeros, poles = (_angle(roots, omega, side) for roots in self.roots())
        return turned + zeros - poles - arb(self._dead_time) * omega

    def offset(self, kind: str, index: int) -> tuple[int, float]:
        """Nearest odd number to arg L/pi, and arg L/pi minus this number, at frequency number `index` of a `kind`.

        The difference is 0.0 if a precision of `MOST_BITS` does not separate it from zero.
        """
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
        powers = num.power, den.power
        common = powers[0].gcd(powers[1])
        p, r = (one // common for one in powers)
        turned = num.turning * r - den.turning * p - self._dead_time * common * p * r
        undamped = num.undamped * den.undamped
        size, phase = (without(undamped, one) for one in (p.derivative() * r - p * r.derivative(), turned))
        return {GAIN: p - r, SIZE: size, PHASE: phase, AXIS: undamped}


def _angle(roots: Iterable[acb], omega: arb, side: int) -> arb:
    """Continuous argument of prod(j omega - roots), rad, as a ball; `side` as in `ExactLoop.argument`."""
    total = arb(0)
    for root in roots:
        away = omega - root.imag
        if not (root.real.is_zero() and away.contains(0)):
            angle = arb.atan2(away, abs(root.real))
        else:
            angle = side * arb.pi() / 2 if side else arb(0, 1.6)  # side unknown: a ball of +-90 deg (1.6 > pi/2)
        total += arb.pi() - angle if root.real > 0 else angle
    return total


# -- the response and its crossovers ------------------------------------------------------------------------------

# With dead time a loop has infinitely many phase crossovers; beyond the last pole or zero of a strictly proper L their
# gains 1/|L| grow without bound.
SMALLEST_LISTED = 1e-2  # phase crossovers with |L| above this are listed, unless the caller gives another value
_LISTED_ALWAYS = 20  # phase crossovers listed in any case
_MOST_LISTED = 5_000  # phase crossovers listed on one interval
_ROUNDING = 1e-15  # rounding of arg L/pi per root and per radian of tau omega; balls decide if an odd number is nearer


@dataclass(frozen=True)
class Response:
    """Frequency response L(j omega) of L(s) = G(s) exp(-tau s), with the derivatives of ln L."""

    system: Rational
    dead_time: float

    @cached_property
    def exact(self) -> ExactLoop:
        return ExactLoop(self.system, self.dead_time)

    @cached_property
    def gain_crossovers(self) -> Floats:
        """All frequencies > 0 at which |L| crosses or touches 1, rad/s, ascending; empty if |L| = 1 everywhere."""
        return np.array([float(omega.mid()) for omega, _ in self.exact.frequencies(GAIN)])

    @cached_property
    def scales(self) -> Floats:
        """Nonzero magnitudes of zeros and poles, gain crossovers, and 1/dead time, rad/s; [1] if all are missing."""
        sizes = np.concatenate([np.abs(self.system.roots), self.gain_crossovers, [1 / (self.dead_time or np.inf)]])
        return sizes[sizes > 0] if np.any(sizes > 0) else np.ones(1)

    @cached_property
    def crossover_phases(self) -> list[tuple[float, float]]:
        """Nearest odd number to arg L/pi, and arg L/pi minus that number (0 only if L = -1), at each gain crossover."""
        return self.phases_at_crossovers()

    def phases_at_crossovers(self, *, certain: bool = False) -> list[tuple[float, float]]:
        """The result of `crossover_phases`; if `certain`, by ball arithmetic at every crossover."""
        return [self.half_turns(one, GAIN, i, certain=certain) for i, one in enumerate(self.gain_crossovers.tolist())]

    def half_turns(self, omega: float, kind: str, index: int, *, certain: bool = False) -> tuple[float, float]:
        """The result of `ExactLoop.offset` at `omega`, rad/s; unless `certain`, in double precision if possible."""
        half = self.turned(omega)[0] / math.pi
        odd = 2 * math.floor(half / 2) + 1
        if certain or abs(half - odd) <= self.rounding(omega):
            return self.exact.offset(kind, index)
        return odd, half - odd

    def rounding(self, omega: Any) -> Any:
        """Bound on the relative rounding error of L; also a bound on the rounding error of arg L/pi."""
        return _ROUNDING * (8 + 2 * self.system.poles.size + self.dead_time * omega)

    def log_size(self, omega: float) -> float:
        """ln|L| at one frequency, rad/s, as a Python float; -inf at a zero, inf at a pole."""
        total = math.log(abs(self.system.gain))
        for away, height, _, sign in self._turns:
            distance = math.hypot(away, omega - height)
            total += sign * (math.log(distance) if distance else -math.inf)
        return total

    def size(self, omega: float) -> float:
        """|L| at one frequency, rad/s, limited to finite values > 0."""
        return math.exp(min(max(self.log_size(omega), -_LARGEST), _LARGEST))

    def phase(self, omega: Floats) -> tuple[Floats, Floats]:
        """Continuous phase of L, rad, and its derivative with respect to omega, s."""
        size, imag, turns, _ = np.array(self._turns).reshape(-1, 4).T
        offset = omega[..., None] - imag
        distance = np.hypot(size, offset)
        angle = np.arctan2(offset, size) @ turns + (self._at_zero - self.dead_time * omega)
        return np.asarray(angle), np.asarray((size / distance / distance) @ turns - self.dead_time)

    def turned(self, omega: float) -> tuple[float, float]:
        """The results of `phase` at one frequency, rad/s, as Python floats."""
        total, slope = self._at_zero - self.dead_time * omega, -self.dead_time
        for away, height, turn, _ in self._turns:
            offset = omega - height
            distance = math.hypot(away, offset)
            total += turn * math.atan2(offset, away)
            slope += turn * (away / distance) / distance
        return total, slope

    @cached_property
    def _turns(self) -> list[tuple[float, float, float, float]]:
        """For each zero and pole of G: |Re|, Im, sign of its phase slope, and 1 for a zero or -1 for a pole."""
        zeros, poles = self._listed_roots
        pairs = [*((root, 1.0) for root in zeros), *((root, -1.0) for root in poles)]
        return [(abs(root.real), root.imag, -sign if root.real > 0 else sign, sign) for root, sign in pairs]

    @cached_property
    def _at_zero(self) -> float:
        """Constant part of the phase, rad, due to a negative gain and to zeros and poles in the right half plane."""
        zeros, poles = ([root.real > 0 for root in roots].count(True) for roots in self._listed_roots)
        return math.pi * (float(self.system.gain < 0) + zeros - poles)

    def at(self, omega: float) -> tuple[complex, complex, complex]:
        """L(j omega), d ln L/d omega and d^2 ln L/d omega^2 as Python numbers; ArithmeticError on overflow."""
        zeros, poles = self._listed_roots
        s = complex(0, omega)
        value, slope, second = self.system.gain * cmath.exp(-self.dead_time * s), complex(-self.dead_time), 0j
        for zero in zeros:
            away = s - zero
            inverse = 1 / away
            value, slope, second = value * away, slope + inverse, second + inverse * inverse
        for pole in poles:
            inverse = 1 / (s - pole)
            value, slope, second = value * inverse, slope - inverse, second - inverse * inverse
        return value, 1j * slope, second

    @cached_property
    def order_at_zero(self) -> int:
        """Number of zeros of G at s = 0 minus number of poles of G at s = 0."""
        zeros, poles = self._listed_roots
        return zeros.count(0) - poles.count(0)

    def spread(self, low: float, middle: float, high: float) -> tuple[float, float]:
        """Bounds on the second and third derivative of ln L with respect to ln omega, from `low` to `high`, rad/s.

        If `low` is 0, the derivatives are with respect to omega.
        """
        s, reach = complex(0, middle), high - middle
        bend = twist = self.dead_time * high if low else 0.0
        for root, size in self._off_zero:  # zeros and poles at s = 0 are left out
            near = abs(s - root) - reach
            if near <= 0:
                return math.inf, math.inf
            x = high * size / (near * near) if low else 1 / (near * near)
            bend, twist = bend + x, twist + x * ((high + size) if low else 2) / near
        return bend, twist

    @cached_property
    def _off_zero(self) -> list[tuple[complex, float]]:
        zeros, poles = self._listed_roots
        return [(root, abs(root)) for root in zeros + poles if root]

    @cached_property
    def _listed_roots(self) -> tuple[list[complex], list[complex]]:
        return self.system.zeros.tolist(), self.system.poles.tolist()

    def bend(self, low: Floats, high: Floats) -> Floats:
        """Bound on |d^2 ln L/d omega^2| between two frequencies."""
        roots = self.system.roots
        offset = roots.imag - np.clip(roots.imag, low[..., None], high[..., None])
        with np.errstate(divide="ignore"):
            return np.asarray((1 / (roots.real**2 + offset**2)).sum(axis=-1))

    def __call__(self, omega: Floats) -> Complexes:
        value = self.system(1j * omega)
        with np.errstate(invalid="ignore"):
            return np.where(np.isinf(value), value, value * np.exp(-1j * self.dead_time * omega))


class Piece(NamedTuple):
    """A frequency interval with monotone |L| and phase, on which |L| - 1 does not change sign.

    - low, high: ends of the interval, rad/s, from 0 to infinity.
    - size: ln|L| at `low` and at `high`; at a pole, a zero, 0 or infinity its limit from inside the interval.
    - half_turns: arg L/pi at `low` and at `high`, or its limits.
    """

    low: float
    high: float
    size: tuple[float, float]
    half_turns: tuple[float, float]


def pieces(response: Response) -> list[Piece]:
    """Divide the frequency axis into ascending intervals with monotone |L| and phase, by the exact polynomials of L."""
    exact, system = response.exact, response.system
    if system.gain == 0:
        return [Piece(0.0, math.inf, (-math.inf, -math.inf), (0.0, 0.0))]
    ends = dict[float, tuple[float, float, float, float]]()  # ln|L| and arg L/pi from below, then from above
    for kind in (GAIN, SIZE, PHASE):
        for i, (ball, _) in enumerate(exact.frequencies(kind)):
            omega = float(ball.mid())
            if omega not in ends:
                size, (odd, rest) = response.log_size(omega), response.half_turns(omega, kind, i)
                half = odd + rest
                if half == odd and rest:
                    half = math.nextafter(odd, math.copysign(math.inf, rest))
                ends[omega] = size, half, size, half
    for omega in {root.imag for root in system.roots.tolist() if root.real == 0 and root.imag > 0}:
        beside = (math.nextafter(omega, 0.0), math.nextafter(omega, math.inf))
        values = [(response.log_size(one), response.turned(one)[0] / math.pi) for one in beside]
        ends.setdefault(omega, (*values[0], *values[1]))
    low, high = limits(response)
    edges = [(0.0, 0.0, 0.0, *low), *((omega, *ends[omega]) for omega in sorted(ends)), (math.inf, *high, 0.0, 0.0)]
    return [
        Piece(before[0], after[0], (before[3], after[1]), (before[4], after[2])) for before, after in pairwise(edges)
    ]


def limits(response: Response) -> tuple[tuple[float, float], tuple[float, float]]:
    """Limits of (ln|L|, arg L/pi) as omega tends to 0 and to infinity; arg L/pi is -inf at infinity with dead time."""
    zeros, poles, gain = response.system.zeros.tolist(), response.system.poles.tolist(), response.system.gain
    turned, integrators = float(gain < 0), poles.count(0) - zeros.count(0)
    right = sum(root.real > 0 for root in zeros) - sum(root.real > 0 for root in poles)
    sizes = ([math.log(abs(root)) for root in roots if root] for roots in (zeros, poles))
    level = math.log(abs(gain)) + sum(next(sizes)) - sum(next(sizes))
    at_zero = (level if integrators == 0 else math.copysign(math.inf, integrators), turned + right - integrators / 2)
    small = -math.inf if response.system.relative_degree else math.log(abs(gain))
    return at_zero, (small, -math.inf if response.dead_time > 0 else _turned_at_infinity(response))


def _turned_at_infinity(response: Response) -> float:
    """Limit of arg G/pi as omega tends to infinity."""
    return float(response.system.gain < 0) - response.system.relative_degree / 2


def frequency_nodes(response: Response) -> Floats:
    """Frequencies, rad/s, ascending, that resolve every pole, zero and crossover of L; for plots and searches only."""
    roots = response.system.roots
    low, high = 1e-4 * response.scales.min(), 1e4 * response.scales.max()
    parts = [np.geomspace(low, high, int(16 * np.log10(high / low)) + 2)]
    for root in roots[roots.imag > 0]:
        width = max(abs(root.real), 1e-8 * root.imag)
        if width < root.imag:
            offset = np.geomspace(0.05 * width, root.imag, int(8 * np.log10(root.imag / width)) + 8)
            parts += [root.imag - offset[:-1], root.imag + offset]
    return np.setdiff1d(np.concatenate(parts), roots.imag[roots.real == 0])


def phase_crossovers(response: Response, cut: list[Piece], *, smallest: float = SMALLEST_LISTED) -> list[float]:
    """List phase crossovers (arg L = pi modulo 2 pi), rad/s: the first 20, and all others with |L| >= `smallest`.

    `cut` are the intervals that `pieces` returns for the loop.
    """
    least, found = math.log(smallest), list[float]()
    for low, high, sizes, turns in cut:
        start, end = turns
        way = 2 if end > start else -2
        # odd numbers after the start up to and including the end; at infinity the end is not reached
        first = 2 * math.floor((start - 1) / 2) + 3 if end > start else 2 * math.ceil((start - 1) / 2) - 1
        number = max(math.floor((end - first) / way) + 1, 0) if math.isfinite(end) else math.inf
        if number and math.isinf(high) and end == first + way * (number - 1):
            number -= 1
        wanted = min(number, max(_LISTED_ALWAYS - len(found), 0))
        if max(sizes) >= least:
            wanted = max(wanted, min(number, _until(response, cut, least)) if math.isinf(number) else number)
        steps = list(range(int(wanted) if wanted <= _MOST_LISTED else _MOST_LISTED // 2))
        if wanted > _MOST_LISTED and math.isfinite(number):
            # too many crossovers: list those next to the ends, where |L| is nearest to 1 and where it is largest
            steps += [int(number) - 1 - step for step in reversed(steps)]
        found += [phase_crossover(response, low, high, start, end, first + way * step) for step in steps]
    return sorted(set(found))


def phase_crossover(response: Response, low: float, high: float, first: float, last: float, odd: float) -> float:
    """Frequency, rad/s, at which arg L/pi is `odd`; arg L/pi is `first` at `low` and `last` at `high`, both rad/s."""
    target, dead_time = math.pi * odd, response.dead_time
    if math.isinf(high):  # at high frequency the dead time dominates the phase
        start = (math.pi * _turned_at_infinity(response) - target) / dead_time if dead_time else math.inf
    else:
        start = (
            math.sqrt(low) * math.sqrt(high) if high > 4 * low else low + (high - low) * (odd - first) / (last - first)
        )
    if not low < start < high:
        start = 2 * low or (0.5 * high if high < math.inf else 1 / (dead_time or 1.0))

    def away(omega: float) -> tuple[float, float]:
        angle, slope = response.turned(omega)
        return angle - target, slope

    return monotone_root(away, start, low, high, -1.0 if last > first else 1.0)


def _until(response: Response, cut: list[Piece], least: float) -> float:
    """Upper bound on the number of phase crossovers with ln|L| >= `least` on the last interval; may be inf."""
    last = cut[-1]
    if last.size[1] >= least:
        return math.inf
    top = max(last.low, 1 / response.dead_time)
    while response.log_size(top) > least:
        top *= 2
    return float((last.half_turns[0] - response.turned(top)[0] / math.pi) // 2 + 1)
