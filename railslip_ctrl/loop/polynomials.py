"""Polynomials with exact rational coefficients (FLINT): made of doubles, on the imaginary axis, and their roots."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from flint import acb, arb, ctx, fmpq, fmpq_mat, fmpq_poly

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

DOUBLE_BITS = 64
"""Precision of what is then taken as a double."""
_SHARP = 56  # bits of a part of a root that rounds to a double


class Axis:
    """A polynomial on the axis, F(j omega) = E(x) + j omega O(x): |F|^2, |F|^2 d(arg F)/d omega, and what is 0 at its
    roots on the axis, all in x."""

    def __init__(self, polynomial: fmpq_poly) -> None:
        coefficients = polynomial.coeffs()
        even, odd = (fmpq_poly([(-1) ** k * c for k, c in enumerate(coefficients[i::2])]) for i in (0, 1))
        self.even, self.odd = even, odd
        self.undamped = even.gcd(odd)
        x = fmpq_poly([0, 1])
        self.power = even * even + x * odd * odd
        self.turning = (odd + 2 * x * odd.derivative()) * even - 2 * x * odd * even.derivative()


def fraction(value: float) -> fmpq:
    return fmpq(*float(value).as_integer_ratio())


def coefficients(ascending: Iterable[float | str]) -> fmpq_poly:
    """The polynomial of coefficients that are doubles, or fractions as text."""
    return fmpq_poly([fmpq(*map(int, c.split("/"))) if isinstance(c, str) else fraction(c) for c in ascending])


def expanded(roots: Iterable[complex], gain: float) -> fmpq_poly:
    """gain prod(s - roots); of a pair the upper root stands for both."""
    found = fmpq_poly([fraction(gain)])
    for root in roots:
        a, b = fraction(root.real), fraction(root.imag)
        if root.imag == 0:
            found *= fmpq_poly([-a, 1])
        elif root.imag > 0:
            found *= fmpq_poly([a * a + b * b, -2 * a, 1])
    return found


def characteristic_polynomial(a: NDArray[np.float64], *column_and_row: NDArray[np.float64]) -> fmpq_poly:
    """det(s I - A) or, with a column b and a row c, det(s I - A + b c), of doubles."""
    matrix, *both = (fmpq_mat(*one.shape, list(map(fraction, one.ravel()))) for one in (a, *column_and_row))
    return (matrix - both[0] * both[1] if both else matrix).charpoly()


def complex_roots(polynomial: fmpq_poly) -> list[acb]:
    """All roots, a multiple one as often as it is one, in balls of the precision of the context or a higher one; the
    real part is 0 on the axis alone, and elsewhere it is as precise as a double."""
    if polynomial.degree() < 1:
        return []
    found, bits = [], ctx.prec
    while polynomial[0] == 0:
        polynomial = polynomial.right_shift(1)
        found.append(acb(0))
    undamped = sum(n for _, n in positive_square_roots(Axis(polynomial).undamped))
    while True:
        with ctx.workprec(bits):
            balls = polynomial.complex_roots()
        on_axis = sum(n for root, n in balls if root.real.contains(0))
        parts = [part for root, _ in balls for part in (root.real, root.imag) if not part.contains(0)]
        if on_axis == 2 * undamped and all(part.rel_accuracy_bits() >= _SHARP for part in parts):
            break
        bits *= 2
    for root, n in balls:
        placed = acb(0, root.imag) if undamped and root.real.contains(0) else root
        found += [placed] * n
    return found


def rounded_roots(polynomial: fmpq_poly) -> NDArray[np.complex128]:
    """`complex_roots` as doubles, those on the axis on it; pairs are exact conjugates."""
    with ctx.workprec(DOUBLE_BITS):
        found = [complex(root.mid()) for root in complex_roots(polynomial)]
    return np.array(sorted(found, key=lambda root: (abs(root), root.real, root.imag)), dtype=np.complex128)


def without(factor: fmpq_poly, polynomial: fmpq_poly) -> fmpq_poly:
    """What is left when every root shared with a factor is taken out."""
    while polynomial.degree() > 0 and (common := polynomial.gcd(factor)).degree() > 0:
        polynomial = polynomial // common
    return polynomial


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


def largest_root_of_ratio(above: fmpq_poly, below: fmpq_poly) -> tuple[arb, float]:
    """Square root of the largest ratio of two polynomials over x >= 0, the lower one > 0 and of no lower degree; and
    that of x, infinite where the ratio only tends to it."""
    found = [(arb(above[k] / below[k]), omega) for k, omega in ((0, 0.0), (below.degree(), math.inf))]
    for omega, _ in positive_square_roots(above.derivative() * below - above * below.derivative()):
        x = omega * omega
        found.append((_value(above, x) / _value(below, x), float(omega.mid())))
    most, _ = max(found, key=lambda one: one[0].mid())
    for ratio, _ in found:
        most = most.max(ratio)
    return most.sqrt(), next(omega for ratio, omega in found if ratio.overlaps(most))


def _value(polynomial: fmpq_poly, x: arb) -> arb:
    total = arb(0)
    for coefficient in reversed(polynomial.coeffs()):
        total = total * x + coefficient
    return total
