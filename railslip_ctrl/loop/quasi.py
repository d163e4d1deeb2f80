"""Loops whose controller has internal delays, for example a dead-time compensator with a model of the dead time.

The loop is L(s) = N(s)/D(s), where N and D are quasi-polynomials: sums of polynomials in s times exp(-delay s).
Closed-loop poles are the zeros of N + D, counted exactly by the argument principle. Margins follow from bounds on ln L
on frequency intervals (`bounded`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property, reduce
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from railslip_ctrl.core.arguments import Complexes, Floats, number, numbers
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass

from .bounded import BoundedLoop, Expansion
from .certificate import Certificate, certify_delayed
from .margins import smallest_of
from .quasi_batch import NEAR_ORIGIN, QuasiPolynomials, count_right
from .rational import DOUBLE_BITS, Rational
from .stability import RootCount

_SMALL = 5e-3  # bound on |L| at and above the highest frequency
_TURNS = 22  # least phase of the longest delay at the highest frequency, in turns: enough for 20 phase crossovers
_BELOW_FEATURES = 1e-4  # lowest frequency as a ratio to the lowest feature
_CELL_RATIO = 1.5  # ratio of neighbouring frequencies in the first division of the axis
_ROUNDING = 1e-13  # bound on the rounding of F, relative to the sizes of its terms


@dataclass(frozen=True)
class QuasiPolynomial:
    """A quasi-polynomial F(s) = s^-removed times the sum over k of c_k(s) exp(-delay_k s).

    - terms: sequence of arrays; real coefficients of the polynomials c_0, c_1, ... in descending powers of s.
    - delays: s, >= 0; one delay per term, 0 for c_0. A single number h stands for the delays 0, h, 2 h, ...
    - removed: exponent of s^-removed. The sum must have at least `removed` zeros at s = 0. Example: the integral over
      the last `delay` seconds has the transfer function (1 - exp(-delay s))/s with `removed` = 1.

    InputError: a coefficient that is not finite, or a delay that is negative or not finite.
    """

    terms: tuple[Floats, ...]
    delays: tuple[float, ...]
    removed: int = 0

    def __init__(self, terms: Sequence[ArrayLike], delays: float | Sequence[float], removed: int = 0) -> None:
        arrays = tuple(_without_leading_zeros(np.atleast_1d(np.asarray(c, dtype=float))) for c in terms)
        if not all(np.isfinite(c).all() for c in arrays):
            raise InputError("quasi-polynomial has a coefficient that is not finite; give finite numbers")
        object.__setattr__(self, "terms", arrays)
        given = delays if isinstance(delays, Sequence) else [delays]
        checked = tuple(number("delay", delay, "s", ge=0) for delay in given)
        multiples = tuple(k * checked[0] for k in range(len(arrays)))
        object.__setattr__(self, "delays", checked if isinstance(delays, Sequence) else multiples)
        object.__setattr__(self, "removed", removed)

    def __call__(self, s: ArrayLike) -> Complexes:
        """Value of F at complex s (1/s), any shape."""
        s = np.asarray(s, dtype=complex)
        terms = (_polynomial(c, s) * np.exp(-delay * s) if delay else _polynomial(c, s) for delay, c in self._present)
        value = np.asarray(sum(terms))
        if not self.removed:
            return value
        near = np.abs(s) * max(self.delays) < NEAR_ORIGIN  # the terms cancel there: use the series
        if not near.any():
            return np.asarray(value / s**self.removed)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(near, np.polyval(self._alone.series[0, ::-1], s), value / s**self.removed)

    @cached_property
    def bare(self) -> QuasiPolynomial:
        """The sum F(s) s^removed, a quasi-polynomial with `removed` = 0."""
        return QuasiPolynomial(self.terms, self.delays)

    @cached_property
    def _alone(self) -> QuasiPolynomials:
        delays = tuple(np.array([delay]) for delay in self.delays)
        return QuasiPolynomials(tuple(c[None] for c in self.terms), delays, self.removed)

    @cached_property
    def slope(self) -> QuasiPolynomial:
        """Derivative dF/ds as a quasi-polynomial."""
        derivative = self._alone.slope()
        return QuasiPolynomial([c[0] for c in derivative.terms], self.delays, derivative.removed)

    def size(self, radius: Floats | float, left: Floats | float = 0.0, least: Floats | float = 0.0) -> Floats:
        """Upper bound on |F(s)| for all s with least <= |s| <= radius and Re s >= -left.

        - radius, left, least: 1/s; numbers, or arrays of equal shape.
        """
        if self.removed:  # F is bounded by Taylor's remainder of the sum, and away from 0 by the sum itself
            with np.errstate(divide="ignore"):
                far = np.asarray(self.bare.size(radius, left) / np.asarray(least) ** self.removed)
            if np.all(np.asarray(least) * max(self.delays) > 1):
                return far
            return np.asarray(np.minimum(far, self._derivative.size(radius, left) / math.factorial(self.removed)))
        return np.asarray(sum(_polynomial(np.abs(c), radius) * np.exp(delay * left) for delay, c in self._present))

    @cached_property
    def _derivative(self) -> QuasiPolynomial:
        return reduce(lambda one, _: one.slope, range(self.removed), self.bare)

    @cached_property
    def _present(self) -> list[tuple[float, Floats]]:
        return [(delay, c) for delay, c in zip(self.delays, self.terms, strict=True) if c.any()]

    def __add__(self, other: QuasiPolynomial) -> QuasiPolynomial:
        """Sum of two quasi-polynomials with the same `removed`."""
        terms: dict[float, Floats] = {}
        for delay, c in zip(self.delays + other.delays, self.terms + other.terms, strict=True):
            terms[delay] = np.asarray(np.polyadd(terms.get(delay, np.zeros(1)), c))
        return QuasiPolynomial(list(terms.values()), list(terms), self.removed)

    def times(self, polynomial: ArrayLike) -> QuasiPolynomial:
        """Product of F(s) and a polynomial; `polynomial` has its coefficients, in descending powers of s."""
        return QuasiPolynomial([np.polymul(c, np.asarray(polynomial)) for c in self.terms], self.delays, self.removed)

    @property
    def undelayed(self) -> Floats:
        """Coefficients of F(s) s^`removed` with all delays set to 0, in descending powers of s."""
        return reduce(lambda a, b: np.asarray(np.polyadd(a, b), dtype=float), self.terms)

    @property
    def zeros_at_origin(self) -> int:
        """Multiplicity of the zero of F at s = 0, within rounding."""
        count, one = 0, self
        while count <= self.degree and abs(one(0.0)) <= _ROUNDING * one.size(0.0):
            count, one = count + 1, one.slope
        return count

    @property
    def degree(self) -> int:
        """Highest power of s in F."""
        return max(c.size - 1 for c in self.terms) - self.removed

    @property
    def retarded(self) -> bool:
        """True if the highest power of s has no delay (retarded type)."""
        return bool(self.terms[0][0] != 0 and all(c.size < self.terms[0].size for c in self.terms[1:]))

    def count_right(self) -> RootCount:
        """Count the zeros of F with positive real part; the number is NaN if some are on the imaginary axis."""
        if not self.retarded:
            raise InputError(
                "quasi-polynomial of neutral type: the highest power of s has a delay; make the loop strictly proper"
            )
        right = float(count_right(self._alone)[0])
        return RootCount(right, math.isnan(right))


def _without_leading_zeros(coefficients: Floats) -> Floats:
    first = np.flatnonzero(coefficients)[:1]
    return coefficients[first[0] :] if first.size else np.zeros(1)


def _polynomial(coefficients: Floats, x: Any) -> Any:
    # `numpy.polyval` takes twice as long
    value = np.full(np.shape(x), coefficients[0], dtype=np.result_type(x, float))
    for coefficient in coefficients[1:].tolist():
        value *= x
        value += coefficient
    return value


@dataclass(frozen=True)
class DelayedRatio:
    """A transfer function N(s)/D(s) of two quasi-polynomials with the same `removed`."""

    numerator: QuasiPolynomial
    denominator: QuasiPolynomial

    def __post_init__(self) -> None:
        if self.numerator.removed != self.denominator.removed:
            raise InputError(
                f"delayed ratio: `removed` is {self.numerator.removed} in the numerator and {self.denominator.removed} "
                "in the denominator; give both the same value"
            )

    def __call__(self, s: ArrayLike) -> Complexes:
        """Value of N/D at complex s (1/s), any shape; infinite at a pole."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(self.numerator(s) / self.denominator(s))

    @property
    def high_frequency_gain(self) -> float:
        """Limit of N/D as s tends to +infinity."""
        num, den = self.numerator.terms[0], self.denominator.terms[0]
        return float(num[0] / den[0]) if num.size == den.size else 0.0


@dataclass(frozen=True, repr=False)
class DelayedLoop(BoundedLoop):
    """The loop L = N/D of quasi-polynomials under unity negative feedback.

    - ratio: L = N/D. Common zeros of N and D (hidden modes) are not cancelled and count for stability. Therefore give
      N and D such that N + D is the characteristic function of plant and controller *as realised*.

    InputError: D is not of retarded type (its highest power of s has a delay), or L does not tend to 0 at infinity.

    The delay margin is the dead time that may be added to the plant while the delays inside the controller do not
    change. `margins` lists phase crossovers up to a frequency above which |L| < 1/200, and at least up to
    22 * 2 pi/(longest delay).
    """

    ratio: DelayedRatio
    _to_infinity: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if not self.ratio.denominator.retarded or self.ratio.numerator.degree >= self.ratio.denominator.degree:
            raise InputError(
                "delayed loop: L must tend to 0 at infinity, and no delay may multiply the denominator's highest power "
                "of s (retarded type); make the loop strictly proper"
            )

    def __repr__(self) -> str:
        delays = ", ".join(f"{delay:g}" for delay, _ in self.characteristic._present[1:])
        return f"loop with internal delays of {delays} s, order {self.ratio.denominator.degree}"

    @cached_property
    def characteristic(self) -> QuasiPolynomial:
        """Characteristic function N + D, whose zeros are the closed-loop poles."""
        return self.ratio.numerator + self.ratio.denominator

    def __call__(self, s: ArrayLike) -> Complexes:
        """Value of L at complex s (1/s), any shape."""
        return self.ratio(s)

    def __mul__(self, other: Any) -> DelayedLoop:
        num, den = (one.coeffs()[::-1] for one in Rational.from_control(other, "factor").polynomials)
        factors = [[float(c) for c in one] for one in (num, den)]
        return DelayedLoop(
            DelayedRatio(self.ratio.numerator.times(factors[0]), self.ratio.denominator.times(factors[1]))
        )

    def scaled(self, factor: float) -> DelayedLoop:
        return DelayedLoop(DelayedRatio(self.ratio.numerator.times([factor]), self.ratio.denominator))

    @cached_property
    def root_count(self) -> RootCount:
        """Exact number of closed-loop poles with positive real part; NaN if some are on the imaginary axis."""
        return self.characteristic.count_right()

    def certificate(self) -> Certificate:
        """Decide stability and enclose the margins in intervals, by ball arithmetic; see `Certificate`.

        The coefficients and delays of N and D are taken as exact. Raises CertificateError if the loop is too near the
        stability boundary.
        """
        num, den = (
            [*zip(one.delays, one.terms, strict=True)] for one in (self.ratio.numerator, self.ratio.denominator)
        )
        if self.root_count.marginal:
            return Certificate(False, True, math.nan, (), DOUBLE_BITS)
        margins = self.margins() if self.is_stable() else None
        return certify_delayed(num, den, self.ratio.numerator.removed, margins)

    @cached_property
    def open_loop_unstable_poles(self) -> int:
        """Number of poles of L (zeros of D) right of the imaginary axis.

        InputError: L has poles on the imaginary axis other than at 0.
        """
        den = self.ratio.denominator
        count = QuasiPolynomial(den.terms, den.delays, den.removed + den.zeros_at_origin).count_right()
        if count.marginal:
            raise InputError("delayed loop: L has poles on the imaginary axis; give plant or controller some damping")
        return int(count.right)

    @cached_property
    def integrators(self) -> int:
        return max(self.ratio.denominator.zeros_at_origin - self.ratio.numerator.zeros_at_origin, 0)

    @cached_property
    def dc_gain(self) -> float:
        if self.ratio.denominator.zeros_at_origin:
            return math.inf
        return float((self.ratio.numerator(0.0) / self.ratio.denominator(0.0)).real)

    def response(self, omega: ArrayLike) -> Complexes:
        return self(1j * numbers("omega", omega, "rad/s", gt=0))

    def response_and_slope(self, omega: Floats) -> tuple[Complexes, Complexes]:
        (n, n_slope), (d, d_slope) = self._values(omega)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(n / d), np.asarray(1j * (n_slope / n - d_slope / d))

    def _values(self, omega: Floats) -> list[tuple[Complexes, Complexes]]:
        s = 1j * omega
        return [(one(s), one.slope(s)) for one in (self.ratio.numerator, self.ratio.denominator)]

    def feature_band(self) -> tuple[float, float]:
        return self._band

    def _expand(self, omega: Floats) -> Expansion:
        functions = self.ratio.numerator, self.ratio.denominator
        (n, n_slope), (d, d_slope) = values = self._values(omega)
        sizes = [(np.abs(value), np.abs(slope)) for value, slope in values]

        def bounds(half: Floats) -> tuple[Floats, Floats, Floats]:
            rest, twice = np.zeros_like(half), np.zeros_like(half)
            reach, left, least = omega + 2 * half, 2 * half, np.maximum(omega - 2 * half, 0.0)
            for one, (size, steep) in zip(functions, sizes, strict=True):
                curved = half**2 / 2 * one.slope.slope.size(reach, left, least)
                rounding = _ROUNDING * one.size(reach, 0.0, least)
                for found, width in ((rest, 1), (twice, 2)):
                    linear, bend = width * half * steep / size, width**2 * curved + rounding
                    # ln(1 + x + r) is within -ln(1 - |x| - |r|) - |x| of x
                    with np.errstate(divide="ignore"):
                        found += -np.log1p(-np.minimum(linear + bend / size, 1)) - linear
            return rest, rest, twice

        with np.errstate(divide="ignore", invalid="ignore"):
            return Expansion(np.log(n / d), np.asarray(1j * (n_slope / n - d_slope / d)), bounds)

    def _edges(self) -> Floats:
        low, high = self._band
        return np.geomspace(low, high, 2 + int(math.log(high / low) / math.log(_CELL_RATIO)))

    def _first_phase(self, omega: Floats) -> Floats:
        phase = np.angle(self.response(omega))
        # an unstable pole gives -180 deg, an integrator -90 deg; the zeros have not turned L yet
        return np.where(phase > np.pi / 4, phase - 2 * np.pi, phase) if self.dc_gain else phase

    def _added_delay(self) -> tuple[float, float]:
        angle = np.mod(np.angle(-self.response(self.gain_crossovers)), 2 * np.pi)
        return smallest_of(angle / self.gain_crossovers, self.gain_crossovers)

    def _unstable_description(self) -> tuple[str, str]:
        count = self.root_count.right
        poles = f"{count:g} unstable pole{'' if count == 1 else 's'}"
        return "closed loop", "poles on the imaginary axis" if self.root_count.marginal else poles

    @cached_property
    def _band(self) -> tuple[float, float]:
        """Lowest and highest frequency of the computation, rad/s; |L| < 1/200 above the highest."""
        num, den = self.ratio.numerator.bare, self.ratio.denominator.bare
        lead, order = abs(den.terms[0][0]), den.degree
        # begin where the highest power of D exceeds each of the other terms, then raise `top` until |L| is small
        others = [(order - k, abs(x)) for c in den.terms for k, x in enumerate(c[::-1].tolist()) if k < order]
        top = max([1e-6, *((size / lead) ** (1 / below) for below, size in others)])
        while _SMALL * (2 * lead * top**order - den.size(top)) <= num.size(top):
            top *= 1.5
        functions = num, den, self.characteristic
        sizes = np.abs(np.concatenate([np.roots(c) for f in functions for c in (*f.terms, f.undelayed)]))
        # a root at the origin, or far out by rounding of a leading coefficient, is no feature
        least = float(sizes[(sizes > 1e-9 * top) & (sizes < top)].min(initial=top))
        longest = max(num.delays + den.delays)
        if longest > 0:
            least, top = min(least, 1 / longest), max(top, _TURNS * 2 * np.pi / longest)
        return _BELOW_FEATURES * least, top
