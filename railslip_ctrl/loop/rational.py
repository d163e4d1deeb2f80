"""Rational SISO transfer functions as zeros, poles and gain; their realisations; Pade approximations of dead time.

The factored form keeps full accuracy where expanded polynomials lose digits, and gives the phase as a continuous
function of frequency. Decisions, for example on stability, use exact polynomials with fractions as coefficients
(FLINT).
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable, Iterator
from functools import cached_property, lru_cache
from itertools import pairwise
from numbers import Real
from typing import Any

import numpy as np
from flint import acb, arb, arb_poly, ctx, fmpq, fmpq_mat, fmpq_poly
from numpy.typing import ArrayLike

from railslip_ctrl.core.arguments import Complexes, Floats, checked, complexes, number, real, reals
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass

# -- exact polynomials: from doubles, on the imaginary axis, and their roots --------------------------------------

DOUBLE_BITS = 64  #: precision of balls that are then rounded to doubles (53 bits)
_NEWTON_STEPS, _HALF_OF_THE_DIGITS = 60, 1e-9  # in doubles: most steps, and the last relative step before balls refine
_SPARE_BITS = 32  # bits allowed for cancellation at a root; if more are lost, FLINT isolates all roots
_SHARP = 56  # correct bits of a real or imaginary part that is rounded to a double


class Axis:
    """A polynomial F on the imaginary axis: F(j omega) = E(x) + j omega O(x), with x = omega^2.

    The polynomials E (`even`) and O (`odd`) have the even and the odd powers of F.
    """

    def __init__(self, polynomial: fmpq_poly) -> None:
        coefficients = polynomial.coeffs()
        self.even, self.odd = (
            fmpq_poly([-c if k % 2 else c for k, c in enumerate(coefficients[i::2])]) for i in (0, 1)
        )

    @property
    def undamped(self) -> fmpq_poly:
        """Polynomial in x; each positive root x = omega^2 gives the roots +-j omega of F."""
        return self.even.gcd(self.odd)

    @property
    def power(self) -> fmpq_poly:
        """Squared magnitude |F|^2 as a polynomial in x."""
        return self.even * self.even + fmpq_poly([0, 1]) * self.odd * self.odd

    @property
    def turning(self) -> fmpq_poly:
        """Phase slope d(arg F)/d omega times |F|^2, as a polynomial in x = omega^2."""
        twice = fmpq_poly([0, 2])
        return (self.odd + twice * self.odd.derivative()) * self.even - twice * self.odd * self.even.derivative()


def fraction(value: float) -> fmpq:
    """The double `value` as an exact fraction."""
    return fmpq(*float(value).as_integer_ratio())


def nearest_double(value: fmpq) -> float:
    """Double nearest to a fraction; python-flint up to 0.8 has no `float(fmpq)`."""
    return int(value.p) / int(value.q)


def coefficients(ascending: Iterable[float | str]) -> fmpq_poly:
    """Exact polynomial from its coefficients in ascending powers: doubles, or fractions as text, for example "1/3"."""
    return fmpq_poly([fmpq(*map(int, c.split("/"))) if isinstance(c, str) else fraction(c) for c in ascending])


def expanded(roots: Iterable[complex], gain: float) -> fmpq_poly:
    """Exact polynomial gain prod(s - roots); the root with Im > 0 of a conjugate pair stands for both roots."""
    product = fmpq_poly([fraction(gain)])
    for root in roots:
        a, b = fraction(root.real), fraction(root.imag)
        if root.imag == 0:
            product *= fmpq_poly([-a, 1])
        elif root.imag > 0:
            product *= fmpq_poly([a * a + b * b, -2 * a, 1])
    return product


def characteristic_polynomial(a: Floats, *column_and_row: Floats) -> fmpq_poly:
    """Exact det(s I - A), or det(s I - A + b c) with a column b and a row c."""
    matrix, *both = (fmpq_mat(*one.shape, list(map(fraction, one.ravel()))) for one in (a, *column_and_row))
    return (matrix - both[0] * both[1] if both else matrix).charpoly()


def complex_roots(polynomial: fmpq_poly) -> list[acb]:
    """All roots of a polynomial, as balls of FLINT's current precision or higher; multiple roots are repeated.

    The real part is exactly 0 for a root on the imaginary axis. For every other root it differs from 0, with at least
    the relative accuracy of a double.
    """
    if polynomial.degree() < 1:
        return []
    found, bits = [], ctx.prec
    while polynomial[0] == 0:
        polynomial = polynomial.right_shift(1)
        found.append(acb(0))
    if polynomial.degree() == 1:
        return [*found, acb(-polynomial[0] / polynomial[1])]
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


def rounded_roots(polynomial: fmpq_poly) -> Complexes:
    """All roots as doubles; the pairs are exactly conjugate, and the roots on the imaginary axis exactly imaginary."""
    with ctx.workprec(DOUBLE_BITS):
        roots = [complex(root.mid()) for root in complex_roots(polynomial)]
    return np.array(sorted(roots, key=lambda root: (abs(root), root.real, root.imag)), dtype=np.complex128)


def without(factor: fmpq_poly, polynomial: fmpq_poly) -> fmpq_poly:
    """Remove from `polynomial` all roots, also repeated ones, that are also roots of `factor`."""
    while polynomial.degree() > 0 and (common := polynomial.gcd(factor)).degree() > 0:
        polynomial = polynomial // common
    return polynomial


def positive_square_roots(polynomial: fmpq_poly) -> list[tuple[arb, int]]:
    """Square roots of the positive real roots of a polynomial, ascending, each with the multiplicity of the root."""
    if polynomial.degree() < 1:
        return []
    while polynomial[0] == 0:
        polynomial = polynomial.right_shift(1)
    signs = [c > 0 for c in polynomial.coeffs() if c != 0]
    changes = sum(one != other for one, other in pairwise(signs))
    if not changes:
        return []  # Descartes' rule: without a sign change no positive root
    if changes == 1 and (only := _only_root(polynomial)):
        return [(only.sqrt(), 1)]
    roots = [(root.real, count) for root, count in polynomial.complex_roots() if root.imag == 0 and root.real > 0]
    return [(root.sqrt(), count) for root, count in sorted(roots, key=lambda pair: pair[0].mid())]


def _only_root(polynomial: fmpq_poly) -> arb | None:
    """Positive root of a polynomial whose coefficients change sign once; None if Newton's method in doubles fails."""
    # by Descartes' rule the polynomial has one positive root, and it is simple
    try:
        terms = [(k, nearest_double(c)) for k, c in enumerate(polynomial.coeffs()) if c != 0]
        (_, first), (degree, last) = terms[0], terms[-1]
        x = abs(first / last) ** (1 / degree)
        # Newton's method on ln(positive terms/negative terms) over ln x, whose slope lies between 1 and the degree
        for _ in range(_NEWTON_STEPS):
            sums, slopes = [0.0, 0.0], [0.0, 0.0]
            for k, c in terms:
                part = abs(c) * x**k
                sums[c * last > 0] += part
                slopes[c * last > 0] += k * part
            step = math.log(sums[1] / sums[0]) / (slopes[1] / sums[1] - slopes[0] / sums[0])
            x *= math.exp(-step)
            if abs(step) < _HALF_OF_THE_DIGITS:
                break
    except (ArithmeticError, ValueError):
        return None
    bits = ctx.prec
    with ctx.workprec(bits + _SPARE_BITS):
        value, root = arb_poly(polynomial), arb(x)
        slope = value.derivative()
        for _ in range(max(bits // 40, 1).bit_length()):  # each step doubles the digits
            root = (root - value(root) / slope(root)).mid()
        ball = arb(root, root * arb(2) ** -bits)
        return ball if value(ball.lower()) * value(ball.upper()) < 0 else None


def largest_root_of_ratio(above: fmpq_poly, below: fmpq_poly) -> tuple[arb, float]:
    """Supremum of sqrt(above(x)/below(x)) over x >= 0, and sqrt(x) where it is attained.

    - above, below: polynomials in x. `below` is > 0, and its degree is not lower than that of `above`.

    The second value is infinite if the supremum is the limit for large x.
    """
    found = [(arb(above[k] / below[k]), omega) for k, omega in ((0, 0.0), (below.degree(), math.inf))]
    for omega, _ in positive_square_roots(above.derivative() * below - above * below.derivative()):
        x = omega * omega
        found.append((arb_poly(above)(x) / arb_poly(below)(x), float(omega.mid())))
    most, _ = max(found, key=lambda one: one[0].mid())
    for ratio, _ in found:
        most = most.max(ratio)
    return most.sqrt(), next(omega for ratio, omega in found if ratio.overlaps(most))


# -- the transfer function --------------------------------------------------------------------------------------

_LEVEL = 20 * np.finfo(float).eps  # relative rounding of a sum of products of matrix entries, per state
_PAIRED = 1e-9  # relative distance within which two roots are a conjugate pair; eigenvalue routines round
LARGEST_ORDER = 100
"""Largest order of a Pade approximation; order 10 is exact to rounding for a phase of a few radians."""


@dataclass(frozen=True)
class Rational:
    """A SISO rational transfer function with real coefficients.

    - zeros, poles: array of complex, 1-D; rad/s; complex values in conjugate pairs. Common zeros and poles are not
      cancelled: they remain poles of every closed loop.
    - gain: ratio of the leading coefficients.

    InputError: more zeros than poles (not proper), or a value that is not a finite number.
    """

    zeros: Complexes
    poles: Complexes
    gain: float

    def __post_init__(self) -> None:
        for name in ("zeros", "poles"):
            roots = complexes(name, getattr(self, name))
            object.__setattr__(self, name, roots if roots.ndim else roots[None])
        object.__setattr__(self, "gain", real("gain", self.gain))
        if self.zeros.size > self.poles.size:
            raise InputError(
                f"transfer function with more zeros ({self.zeros.size}) than poles ({self.poles.size}) is not proper; "
                "add poles (for example a derivative filter)"
            )
        if not all(map(cmath.isfinite, [*self.zeros.tolist(), *self.poles.tolist(), self.gain])):
            raise InputError("transfer function has a coefficient that is not finite; give finite numbers")

    @classmethod
    def from_polynomials(cls, num: ArrayLike, den: ArrayLike) -> Rational:
        """Make a transfer function from polynomial coefficients.

        - num, den: array, 1-D; coefficients in descending powers of s (rad/s).

        InputError: values that are not finite numbers, a denominator 0, or a higher power in `num` than in `den`.
        """
        numerator, denominator = (np.atleast_1d(reals(name, x)) for name, x in (("num", num), ("den", den)))
        if numerator.ndim > 1 or denominator.ndim > 1:
            raise InputError("transfer function: num and den are not 1-D; give the coefficients of one polynomial each")
        above, below = numerator[::-1].tolist(), denominator[::-1].tolist()
        if not all(map(math.isfinite, above + below)):
            raise InputError("transfer function has a coefficient that is not finite; give finite numbers")
        if not any(below):
            raise InputError("transfer function has the denominator 0; give a nonzero polynomial")
        return cls._from_exact(coefficients(above), coefficients(below))

    @classmethod
    def _from_exact(cls, num: fmpq_poly, den: fmpq_poly) -> Rational:
        """Make a transfer function; the rounding moves no zero or pole across, onto or off the imaginary axis."""
        if num.degree() < 0:
            return cls(np.array([]), rounded_roots(den), 0.0)._with(num, den)
        gain = num.leading_coefficient() / den.leading_coefficient()
        try:
            size = int(gain.p) / int(gain.q)
        except OverflowError:
            size = math.inf
        return cls(rounded_roots(num), rounded_roots(den), size)._with(num, den)

    def _with(self, num: fmpq_poly, den: fmpq_poly) -> Rational:
        """Store the exact numerator and denominator, whose rounded roots are `zeros` and `poles`; return self."""
        self.__dict__.update(polynomials=(num, den), from_coefficients=True)
        return self

    from_coefficients = False
    """True if the system was given by polynomials, which are then exact; false if its zeros and poles are exact."""

    @cached_property
    def polynomials(self) -> tuple[fmpq_poly, fmpq_poly]:
        """Exact numerator, with the gain, and exact denominator."""
        return expanded(self.zeros, self.gain), expanded(self.poles, 1.0)

    def __getstate__(self) -> dict[str, Any]:
        state = {"zeros": self.zeros, "poles": self.poles, "gain": self.gain}
        if self.from_coefficients:
            # as text, because FLINT's numbers cannot be pickled
            state["polynomials"] = [[str(c) for c in one.coeffs()] for one in self.polynomials]
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        given = state.pop("polynomials", None)
        self.__dict__.update(state)
        if given:
            self._with(*(coefficients(one) for one in given))

    @classmethod
    def from_state_space(cls, a: ArrayLike, b: ArrayLike, c: ArrayLike, d: ArrayLike) -> Rational:
        """Make a transfer function from a SISO realisation x' = A x + B u, y = C x + D u.

        Hidden modes are kept as pole-zero pairs. The matrices are taken as exact, with two exceptions. An eigenvalue
        that is 0 within rounding is set to 0, which is an integrator. A very large zero that exists only because of
        rounding is dropped.

        - a, b, c, d: A, B, C and D in SI units, n by n, n by 1, 1 by n and 1 by 1.

        InputError: entries that are not finite numbers, or shapes that do not fit.
        """
        a, b = np.atleast_2d(reals("a", a)), reals("b", b).reshape(-1, 1)
        c, d = reals("c", c).reshape(1, -1), reals("d", d)
        if d.size != 1 or not (a.size == b.size**2 == c.size**2) or (b.size and a.shape != (b.size, b.size)):
            raise InputError(
                f"state-space system: shapes {a.shape}, {b.shape}, {c.shape} and {d.shape} do not fit; give n by n, "
                "n by 1, 1 by n and 1 by 1"
            )
        d = float(d.reshape(()))
        if b.size == 0:
            return cls(np.array([]), np.array([]), d)
        if not all(np.isfinite(m).all() for m in (a, b, c, np.array(d))):
            raise InputError("state-space system has an entry that is not finite; give finite numbers")
        den = characteristic_polynomial(a)
        # det(sI - A + B C) = det(sI - A) (1 + C (sI - A)^-1 B)
        num = characteristic_polynomial(a, b, c) - den
        integrators, excess = _structure(a, b, c)
        num = fmpq_poly(num.coeffs()[: max(b.size - excess, 0)])
        return cls._from_exact(num + fraction(d) * den, fmpq_poly([0] * integrators + den.coeffs()[integrators:]))

    @classmethod
    def from_control(cls, system: Any, name: str = "loop", *, period: float | None = None) -> Rational:
        """Make a transfer function from a SISO system of python-control or scipy.signal, or a real number.

        - system: a continuous-time system in s or, if `period` is given, a discrete-time system in z with this sampling
          period. If the system has an attribute `transfer_function`, for example a `PIController`, it is used.
        - name: name of the system in error messages.
        - period: sampling period, s; None for continuous time.

        InputError: a MIMO, nonlinear or improper system; frequency-response data; a discrete-time system if
        `period` is None; a continuous-time system, or another sampling period, if `period` is given.
        """
        if isinstance(system, Rational):
            return system
        own = getattr(system, "transfer_function", None)
        if isinstance(own, Rational):
            _check_time(name, getattr(system, "period", None) or 0, period)
            return own
        if isinstance(system, (int, float, np.integer, np.floating)) and not isinstance(system, bool):
            return cls(np.array([]), np.array([]), real("system", system))
        ports = [getattr(system, f"n{side}", getattr(system, side, None)) for side in ("inputs", "outputs")]
        form = next((form for form in ("A", "num", "gain") if hasattr(system, form)), None)
        if form is None or None in ports:
            raise InputError(
                f"{name}: {type(system).__name__} is not a linear system; give a python-control "
                "TransferFunction or StateSpace"
            )
        if ports != [1, 1]:
            raise InputError(
                f"{name}: a system of {ports[1]} x {ports[0]}, outputs x inputs, is not SISO; "
                "select one input and one output"
            )
        _check_time(name, system.dt, period)
        if form == "A":
            return cls.from_state_space(system.A, system.B, system.C, system.D)
        if form == "gain":
            if any(np.iscomplexobj(np.poly(roots)) for roots in (system.zeros, system.poles)):
                raise InputError(f"{name}: a complex zero or pole has no partner; give conjugate pairs")
            return cls(system.zeros, system.poles, system.gain)
        if hasattr(system, "ninputs"):  # python-control has a polynomial for each pair of output and input
            return cls.from_polynomials(system.num[0][0], system.den[0][0])
        return cls.from_polynomials(system.num, system.den)

    def __mul__(self, other: Rational | float) -> Rational:
        """Connect in series with another transfer function, or multiply the gain by a number."""
        if isinstance(other, (bool, str)) or not isinstance(other, Rational | Real):
            return NotImplemented
        if not isinstance(other, Rational):
            other = Rational(np.array([]), np.array([]), float(other))
        product = Rational(
            np.concatenate([self.zeros, other.zeros]), np.concatenate([self.poles, other.poles]), self.gain * other.gain
        )
        if self.from_coefficients or other.from_coefficients:
            (n, d), (m, e) = self.polynomials, other.polynomials
            product._with(n * m, d * e)
        return product

    __rmul__ = __mul__

    def shifted(self, c: float) -> Rational:
        """Transfer function G(s + c); `c` is real, rad/s. InputError: `c` is not finite."""
        number("c", c, "rad/s")
        if self.from_coefficients:
            there = coefficients([c, 1.0])
            return Rational._from_exact(*(one(there) for one in self.polynomials))
        return Rational(self.zeros - c, self.poles - c, self.gain)

    @property
    def relative_degree(self) -> int:
        """Number of poles minus number of zeros."""
        return int(self.poles.size - self.zeros.size)

    @property
    def feedthrough(self) -> float:
        """Gain at infinite frequency, G(infinity)."""
        return self.gain if self.relative_degree == 0 else 0.0

    @property
    def dc_gain(self) -> float:
        """Gain at frequency 0, G(0); infinite with an integrator, NaN with both a zero and a pole at the origin."""
        if self.gain == 0.0:
            return 0.0 if np.all(self.poles != 0) else float("nan")
        at_zero, at_pole = np.count_nonzero(self.zeros == 0), np.count_nonzero(self.poles == 0)
        if at_zero and at_pole:
            return float("nan")
        if at_pole:
            return float("inf")
        return float((self.gain * np.prod(-self.zeros) / np.prod(-self.poles)).real)

    def __call__(self, s: ArrayLike) -> Complexes:
        """G(s) at complex s, rad/s, any shape; infinite at a pole. InputError: `s` is not numeric."""
        s = complexes("s", s)[..., None]
        # zeros and poles alternate so that the running product stays in range for high orders
        paired = self.zeros.size
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            value = np.prod((s - self.zeros) / (s - self.poles[:paired]), axis=-1)
            value = self.gain * value / np.prod(s - self.poles[paired:], axis=-1)
        at_pole = np.any(s == self.poles, axis=-1) & ~np.any(s == self.zeros, axis=-1)
        return np.asarray(np.where(at_pole, complex(np.inf, 0.0), value))

    @cached_property
    def roots(self) -> Complexes:
        """All zeros, then all poles."""
        return np.concatenate([self.zeros, self.poles])

    @cached_property
    def signs(self) -> Floats:
        """Signs of `roots`: 1 for each zero and -1 for each pole."""
        return np.repeat([1.0, -1.0], [self.zeros.size, self.poles.size])

    def log_size(self, omega: Floats) -> Floats:
        """ln|G(j omega)|, an array of the shape of `omega`, rad/s."""
        distance = np.hypot(self.roots.real, omega[..., None] - self.roots.imag)  # squares could overflow
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.log(abs(self.gain)) + np.log(distance) @ self.signs)

    def log_slope(self, omega: Floats) -> Complexes:
        """d ln G(j omega)/d omega, complex, s, an array of the shape of `omega`, rad/s."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(1j * ((1 / (1j * omega[..., None] - self.roots)) @ self.signs))


def _check_time(name: str, dt: float | bool | None, period: float | None) -> None:
    if period is None and dt not in (None, 0):
        raise InputError(f"{name}: a discrete-time system (dt = {dt}) is not accepted; give a continuous one")
    if period is not None and not (dt in (None, True) or math.isclose(dt, period)):
        raise InputError(
            f"{name}: a system with dt = {dt:g} s does not fit a period of {period:g} s; sample it with that period"
        )


def angle_sum(roots: Complexes, omega: Floats) -> Floats:
    """Continuous argument of prod(j omega - roots), rad; roots on the imaginary axis are treated as left of it."""
    real = roots.real
    angle = np.arctan2(omega[..., None] - roots.imag, np.abs(real))
    return np.asarray(np.where(real > 0, np.pi - angle, angle).sum(axis=-1))


def _structure(a: Floats, b: Floats, c: Floats) -> tuple[int, int]:
    """Number of integrators and relative degree of the realisation (a, b, c, 0), both within rounding."""
    from scipy.linalg import matrix_balance

    column, size, excess = b, np.abs(b), 0
    while excess < b.size and abs(c @ column).item() <= _LEVEL * b.size * (np.abs(c) @ size).item():
        scale = float(size.max()) or 1.0  # prevents overflow
        column, size, excess = a @ (column / scale), np.abs(a) @ (size / scale), excess + 1
    return _zero_multiplicity(matrix_balance(a, separate=False, permute=False)[0]), excess


def _zero_multiplicity(a: Floats) -> int:
    """Algebraic multiplicity of the eigenvalue 0 of a matrix, from the nullity of powers of the matrix."""
    order, size = int(a.shape[0]), float(np.linalg.norm(a, 2))
    power, multiplicity = np.eye(order), 0
    while size and multiplicity < order:
        power = power @ a / size
        nullity = int(np.count_nonzero(np.linalg.svd(power, compute_uv=False) <= _LEVEL * order))
        if nullity == multiplicity:
            return multiplicity
        multiplicity = nullity
    return order


# -- a real state-space realisation -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Realisation:
    """SISO state-space realisation x' = a x + b u, y = c x + d u; in discrete time x[k+1] replaces x'.

    The arrays a, b and c have the shapes (n, n), (n,) and (n,).
    """

    a: Floats
    b: Floats
    c: Floats
    d: float

    @property
    def order(self) -> int:
        """Number of states."""
        return int(self.b.size)


def realise(system: Rational) -> Realisation:
    """Real state-space realisation of `system`, in s or z, with one state per pole, cancelled poles included.

    It is a series of first- and second-order sections. The entries of `a` are real and imaginary parts of the poles;
    the eigenvalues of `a`, also double eigenvalues, are therefore accurate to rounding.

    InputError: complex zeros or poles that are not in conjugate pairs.
    """
    n = system.poles.size
    a, b, row, through = np.zeros((n, n)), np.zeros(n), np.zeros(n), 1.0
    at = 0
    for section in _sections(system):
        here = slice(at, at + section.order)
        # the input of this section is `row` times the states plus `through` times the input of the series
        a[here] = np.outer(section.b, row)
        a[here, here] += section.a
        b[here] = section.b * through
        row, through = section.d * row, section.d * through
        row[here] += section.c
        at += section.order
    return Realisation(a, b, system.gain * row, system.gain * through)


def _sections(system: Rational) -> Iterator[Realisation]:
    """Yield sections of order 1 or 2 whose product is the system with gain 1."""
    zeros, zero_pairs = _split(system.zeros, "zeros")
    poles, pole_pairs = _split(system.poles, "poles")
    for pole in pole_pairs:
        if zero_pairs:
            zero = _take_nearest(zero_pairs, pole)
            yield _section([pole, pole.conjugate()], [zero, zero.conjugate()])
        else:
            # real zeros only if they outnumber the real poles
            surplus = min(2, max(0, len(zeros) - len(poles)))
            yield _section([pole, pole.conjugate()], [_take_nearest(zeros, pole) for _ in range(surplus)])
    for zero in zero_pairs:
        yield _section([_take_nearest(poles, zero) for _ in range(2)], [zero, zero.conjugate()])
    for pole in reversed(poles):
        yield _section([pole], [_take_nearest(zeros, pole)] if zeros else [])


def _split(roots: Complexes, name: str) -> tuple[list[complex], list[complex]]:
    real, upper, left = (roots[mask].tolist() for mask in (roots.imag == 0, roots.imag > 0, roots.imag < 0))
    for root in upper:
        partner = _take_nearest(left, root.conjugate()) if left else complex(np.inf)
        if not abs(partner - root.conjugate()) <= _PAIRED * abs(root):
            left.insert(0, root)
            break
    if left:
        raise InputError(f"transfer function: {name} contain {left[0]:g} without its conjugate; give conjugate pairs")
    return real, upper


def _take_nearest(roots: list[complex], to: complex) -> complex:
    return roots.pop(min(range(len(roots)), key=lambda i: abs(roots[i] - to)))


def _section(poles: list[complex], zeros: list[complex]) -> Realisation:
    """Realise prod(s - zeros)/prod(s - poles) with one or two poles, real or a conjugate pair."""
    through, last = float(len(zeros) == len(poles)), poles[-1]
    level = math.prod((last - zero for zero in zeros), start=1 + 0j).real  # the numerator at a pole
    if len(poles) == 1:
        return Realisation(np.array([[last.real]]), np.array([1.0]), np.array([level]), through)
    # numerator minus through times denominator is slope s + a constant
    slope = (sum(poles) - sum(zeros)).real if through else float(len(zeros))
    re, im = last.real, poles[0].imag
    if im:  # a conjugate pair as a scaled rotation
        return Realisation(
            np.array([[re, im], [-im, re]]), np.array([0.0, 1.0]), np.array([level / im, slope]), through
        )
    return Realisation(
        np.array([[poles[0].real, 0.0], [1.0, re]]), np.array([1.0, 0.0]), np.array([slope, level]), through
    )


# -- Pade -------------------------------------------------------------------------------------------------------


@checked
def pade(dead_time: float, order: int) -> Rational:
    """Diagonal Pade approximation of exp(-dead_time s), for comparison with the exact dead time.

    - dead_time: s, >= 0; for 0 s the approximation is 1.
    - order: 1 to 100.

    With the order n, the coefficient of (dead_time s)^k in the denominator is (2n - k)! n!/((2n)! k! (n - k)!); in the
    numerator it is multiplied by (-1)^k. See for example G. H. Golub, C. F. Van Loan: Matrix Computations, 3rd edition,
    Johns Hopkins University Press, 1996, p. 572.
    """
    number("Pade order", order, ge=1, le=LARGEST_ORDER)
    number("dead time", dead_time, "s", ge=0)
    if dead_time == 0:
        return Rational(np.array([]), np.array([]), 1.0)
    poles = _poles(order) / dead_time
    return Rational(-poles, poles, (-1.0) ** order)


@lru_cache
def _poles(n: int) -> Complexes:
    """Poles of the Pade approximation of order n for a dead time of 1 s."""
    coefficients = [fmpq(math.factorial(2 * n - k), math.factorial(k) * math.factorial(n - k)) for k in range(n + 1)]
    return rounded_roots(fmpq_poly(coefficients))
