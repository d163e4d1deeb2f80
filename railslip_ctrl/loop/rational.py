"""A rational SISO transfer function held as zeros, poles and gain.

G(s) = gain * prod(s - zeros)/prod(s - poles). Factored form evaluates to full accuracy where expanded
polynomials lose digits, gives the phase of G(j omega) as a *continuous* function of omega in closed form
(no unwrapping over a grid), and makes shifting the contour (s -> s + c) exact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from numbers import Real
from typing import TYPE_CHECKING, Any

import numpy as np

from railslip_ctrl.arguments import complexes, number, real, reals
from railslip_ctrl.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]

# A state-space system and its factored form must agree this well where they are compared. Zeros come out of a
# generalised eigenvalue problem, so a double zero is only good to sqrt(eps) ~ 1e-8, though their product is
# far better; what is refused beyond this bound is a system so badly scaled that no margin of it would be right.
_FACTORING_TOLERANCE = 1e-7

_AT_ORIGIN = 1e-14  # relative to the largest root: a pole that slow is an integrator in any loop with the others
_MULTIPLE = 1e-4  # relative distance within which roots may be one multiple root (1e-16^(1/4): up to fourfold)
_ON_AXIS = 1e-12  # real part over size of an undamped root after rounding
_COEFFICIENT = 1e-13  # relative change of a polynomial's coefficient that counts as rounding of its sum


@dataclass(frozen=True)
class Rational:
    """A SISO rational transfer function with real coefficients.

    Parameters
    ----------
    zeros, poles : array of complex, 1-D
        rad/s; complex ones in conjugate pairs. Common factors are kept: a pole cancelled by a zero is still a
        pole of every closed loop.
    gain : float
        Ratio of the leading coefficients.

    Raises
    ------
    InputError
        More zeros than poles (not proper), or something that is not a finite number.
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
                f"transfer function with {self.zeros.size} zeros and {self.poles.size} poles is not proper; "
                "add poles (for example a derivative filter)"
            )
        finite = np.isfinite(self.zeros).all() and np.isfinite(self.poles).all() and math.isfinite(self.gain)
        if not finite:
            raise InputError("transfer function has a coefficient that is not finite; give finite numbers")

    @classmethod
    def from_polynomials(cls, num: ArrayLike, den: ArrayLike) -> Rational:
        """From coefficients `num` and `den`, 1-D, in descending powers of s, whose unit is rad/s.

        InputError for what are no finite numbers, a denominator 0, or a higher power in `num` than in `den`.
        """
        numerator, denominator = (np.atleast_1d(reals(name, x)) for name, x in (("num", num), ("den", den)))
        if numerator.ndim > 1 or denominator.ndim > 1:
            raise InputError("transfer function: num and den are not 1-D; give the coefficients of one polynomial each")
        numerator, denominator = np.trim_zeros(numerator, "f"), np.trim_zeros(denominator, "f")
        if not (np.isfinite(numerator).all() and np.isfinite(denominator).all()):
            raise InputError("transfer function has a coefficient that is not finite; give finite numbers")
        if denominator.size == 0:
            raise InputError("transfer function has the denominator 0; give a nonzero polynomial")
        if numerator.size == 0:
            return cls(np.array([]), cleaned(polynomial_roots(denominator)), 0.0)
        zeros, poles = cleaned(polynomial_roots(numerator)), cleaned(polynomial_roots(denominator))
        return cls(zeros, poles, numerator[0] / denominator[0])

    @classmethod
    def from_state_space(cls, a: ArrayLike, b: ArrayLike, c: ArrayLike, d: ArrayLike) -> Rational:
        """From a SISO realisation x' = A x + B u, y = C x + D u; hidden modes are kept as pole-zero pairs.

        Parameters
        ----------
        a, b, c, d : array
            In SI units, n by n, n by 1, 1 by n and 1 by 1.

        Raises
        ------
        InputError
            Entries that are no finite numbers, shapes that do not fit, or a factored form that does not reproduce the
            realisation's frequency response.
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
        return _factor(a, b, c, d)

    @classmethod
    def from_control(cls, system: Any, name: str = "loop", *, period: float | None = None) -> Rational:
        """From a linear `system` of python-control or scipy.signal, SISO, or a real number.

        Continuous-time, in s; with a `period` (s) discrete-time with that dt, in z. What has a `transfer_function`,
        as a `PIController`, is taken by that.

        Raises
        ------
        InputError
            Discrete-time, or of another period, MIMO, nonlinear, frequency-response data, or not proper; it begins
            with `name`.
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
                f"{name}: a system with {ports[0]} inputs and {ports[1]} outputs is not SISO; "
                "select one input and one output"
            )
        _check_time(name, system.dt, period)
        if form == "A":
            return cls.from_state_space(system.A, system.B, system.C, system.D)
        if form == "gain":
            if any(np.iscomplexobj(np.poly(roots)) for roots in (system.zeros, system.poles)):
                raise InputError(f"{name}: complex zeros or poles without their conjugates; give both of each pair")
            return cls(system.zeros, system.poles, system.gain)
        if hasattr(system, "ninputs"):  # python-control has a polynomial for each pair of an output and an input
            return cls.from_polynomials(system.num[0][0], system.den[0][0])
        return cls.from_polynomials(system.num, system.den)

    def __mul__(self, other: Rational | float) -> Rational:
        """Series connection, or a change of gain."""
        if isinstance(other, Rational):
            return Rational(
                np.concatenate([self.zeros, other.zeros]),
                np.concatenate([self.poles, other.poles]),
                self.gain * other.gain,
            )
        if isinstance(other, (bool, str)) or not isinstance(other, Real):
            return NotImplemented
        return Rational(self.zeros, self.poles, self.gain * other)

    __rmul__ = __mul__

    def shifted(self, c: float) -> Rational:
        """G(s + c) as a function of s; `c` is real, rad/s. InputError for one that is not finite."""
        number("c", c, "rad/s")
        return Rational(self.zeros - c, self.poles - c, self.gain)

    @property
    def relative_degree(self) -> int:
        """Poles minus zeros."""
        return int(self.poles.size - self.zeros.size)

    @property
    def feedthrough(self) -> float:
        """G(infinity)."""
        return self.gain if self.relative_degree == 0 else 0.0

    @property
    def dc_gain(self) -> float:
        """G(0), infinite with an integrator; NaN where a zero and a pole meet at the origin."""
        if self.gain == 0.0:
            return 0.0 if np.all(self.poles != 0) else float("nan")
        at_zero, at_pole = np.count_nonzero(self.zeros == 0), np.count_nonzero(self.poles == 0)
        if at_zero and at_pole:
            return float("nan")
        if at_pole:
            return float("inf")
        return float((self.gain * np.prod(-self.zeros) / np.prod(-self.poles)).real)

    def __call__(self, s: ArrayLike) -> Complexes:
        """G at complex s, any shape; infinite at a pole. InputError for what are no numbers."""
        s = complexes("s", s)[..., None]
        # zeros and poles are interleaved so that the running product stays in range for high orders
        paired = self.zeros.size
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            value = np.prod((s - self.zeros) / (s - self.poles[:paired]), axis=-1)
            value = self.gain * value / np.prod(s - self.poles[paired:], axis=-1)
        at_pole = np.any(s == self.poles, axis=-1) & ~np.any(s == self.zeros, axis=-1)
        return np.asarray(np.where(at_pole, complex(np.inf, 0.0), value))

    @cached_property
    def _roots(self) -> tuple[Floats, Floats, Floats]:
        """Real parts, imaginary parts and signs (+1 zero, -1 pole) of all zeros and poles."""
        roots = np.concatenate([self.zeros, self.poles])
        signs = np.repeat([1.0, -1.0], [self.zeros.size, self.poles.size])
        return roots.real.copy(), roots.imag.copy(), signs

    def log_size(self, omega: Floats) -> Floats:
        """ln abs G(j omega); shape of `omega`, rad/s."""
        real, imag, sign = self._roots
        distance = np.hypot(real, omega[..., None] - imag)  # hypot, not squares: no overflow at any frequency
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.log(abs(self.gain)) + np.log(distance) @ sign)

    def log_size_slope(self, omega: Floats) -> Floats:
        """d ln abs G(j omega)/d omega; shape of `omega`, rad/s."""
        real, imag, sign = self._roots
        offset = omega[..., None] - imag
        distance = np.hypot(real, offset)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray((offset / distance / distance) @ sign)

    def log_slope(self, omega: Floats) -> Complexes:
        """d ln G(j omega)/d omega, complex; shape of `omega`, rad/s."""
        s = 1j * omega[..., None]
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(1j * ((1 / (s - self.zeros)).sum(axis=-1) - (1 / (s - self.poles)).sum(axis=-1)))

    def phase(self, omega: Floats) -> tuple[Floats, Floats]:
        """Continuous phase of G(j omega), rad, and its derivative; shapes of `omega`.

        Continuous on omega > 0 but for a step of pi at each zero or pole on the imaginary axis.
        """
        return self.angle(omega), self.angle_slope(omega)

    def angle(self, omega: Floats) -> Floats:
        """The phase of `phase` alone, rad, continuous, at `omega`, rad/s, of any shape."""
        turned = np.pi if self.gain < 0 else 0.0
        return np.asarray(angle_sum(self.zeros, omega) - angle_sum(self.poles, omega) + turned)

    def angle_slope(self, omega: Floats) -> Floats:
        """Its derivative alone, s, at `omega`, rad/s, of any shape."""
        return np.asarray(_angle_slope(self.zeros, omega) - _angle_slope(self.poles, omega))


def _check_time(name: str, dt: float | bool | None, period: float | None) -> None:
    """Refuse a discrete-time system where a continuous one is asked for, and any but that of a period, s."""
    if period is None and dt not in (None, 0):
        raise InputError(f"{name}: a discrete-time system (dt = {dt}) is not accepted; give a continuous one")
    if period is not None and not (dt in (None, True) or math.isclose(dt, period)):
        raise InputError(
            f"{name}: a system with dt = {dt:g} s does not go with a period of {period:g} s; sample it there"
        )


def polynomial_roots(coefficients: ArrayLike) -> Complexes:
    """Roots of a polynomial given in descending powers, always complex."""
    given = np.asarray(coefficients, dtype=float)
    if given.shape == (2,) and given.all():  # what `np.roots` does by an eigenvalue solver: a PI's zero, asked often
        return np.array([-given[1] / given[0]], dtype=np.complex128)
    return np.asarray(np.roots(given), dtype=np.complex128)


def cleaned(roots: Complexes) -> Complexes:
    """Roots with what rounding did to multiple ones, to pairs on the axis and to those at the origin undone.

    A double root comes out of an eigenvalue solver as two that are about 1e-8 apart; an undamped pair with a real part
    of some 1e-17. Each is moved back only where that changes no coefficient by more than rounding.
    """
    if roots.size == 0:
        return roots
    top = float(np.abs(roots).max())
    roots = np.where(np.abs(roots) <= _AT_ORIGIN * top, 0.0, roots)
    merged = roots.copy()
    for root in roots:
        near = np.abs(roots - root) <= _MULTIPLE * np.abs(root)
        if np.count_nonzero(near) > 1:
            merged[near] = roots[near].mean()
    for candidate in (_on_axis(merged), merged, _on_axis(roots)):
        if np.array_equal(candidate, roots) or _same_coefficients(candidate, roots):
            return candidate
    return roots


def _on_axis(roots: Complexes) -> Complexes:
    """Roots whose real part is rounding of their size, put on the axis."""
    return np.where(np.abs(roots.real) <= _ON_AXIS * np.abs(roots), 1j * roots.imag, roots)


def _same_coefficients(candidate: Complexes, roots: Complexes) -> bool:
    """Whether two sets of roots give one polynomial, each coefficient to rounding of the terms it sums."""
    change = np.abs(np.atleast_1d(np.poly(candidate)) - np.atleast_1d(np.poly(roots)))
    size = np.atleast_1d(np.poly(-np.abs(roots))).real
    return bool(np.all(change <= _COEFFICIENT * size))


def _zero_multiplicity(a: Floats) -> int:
    """Algebraic multiplicity of the eigenvalue 0, by the nullity of powers of the matrix."""
    order = int(a.shape[0])
    size = float(np.linalg.norm(a, 2))
    if size == 0:
        return order
    power, found = np.eye(order), 0
    for _ in range(order):
        power = power @ a / size
        singular = np.linalg.svd(power, compute_uv=False)
        nullity = int(np.count_nonzero(singular <= 20 * order * np.finfo(float).eps))
        if nullity == found:
            break
        found = nullity
    return found


def angle_sum(roots: Complexes, omega: Floats) -> Floats:
    """Continuous argument of prod(j omega - roots), rad; a root on the axis counts as one left of it."""
    real = roots.real
    angle = np.arctan2(omega[..., None] - roots.imag, np.abs(real))
    return np.asarray(np.where(real > 0, np.pi - angle, angle).sum(axis=-1))


def _angle_slope(roots: Complexes, omega: Floats) -> Floats:
    """Derivative of `angle_sum`."""
    real = roots.real
    distance = np.hypot(real, omega[..., None] - roots.imag)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(real == 0, 0.0, -real / distance / distance).sum(axis=-1))


def _factor(a: Floats, b: Floats, c: Floats, d: float) -> Rational:
    """Zeros, poles and gain of a realisation; the number of finite zeros is the one that reproduces it best."""
    from scipy.linalg import eigvals, matrix_balance

    order = a.shape[0]
    a, (scale, permutation) = matrix_balance(a, separate=True)
    b, c = b[permutation] / scale[:, None], c[:, permutation] * scale
    poles = np.linalg.eigvals(a).astype(complex)
    integrators = _zero_multiplicity(a)
    poles[np.argsort(np.abs(poles))[:integrators]] = 0.0  # a multiple 0 comes out as a ring of about eps^(1/m)
    poles = cleaned(poles)
    input_size, output_size = np.linalg.norm(b), np.linalg.norm(c)
    if input_size == 0 or output_size == 0:
        # the whole dynamics is hidden: keep every mode as a pole with a zero on it
        return Rational(poles if d != 0 else np.array([]), poles, d)
    b, c, feedthrough = b / input_size, c / output_size, d / (input_size * output_size)
    pencil = np.block([[a, b], [c, np.array([[feedthrough]])]])
    with np.errstate(all="ignore"):
        candidates = eigvals(pencil, np.diag([1.0] * order + [0.0]))
    candidates = candidates[np.isfinite(candidates)]
    candidates = candidates[np.argsort(np.abs(candidates))]
    probes = _probe_points(poles)
    truth = np.array([(c @ np.linalg.solve(s * np.eye(order) - a, b))[0, 0] + feedthrough for s in probes])
    if not np.any(truth):
        return Rational(np.array([]), poles, 0.0)
    best, best_error = None, np.inf
    for count in range(min(order, candidates.size) + 1):
        zeros = cleaned(candidates[:count])
        if abs(zeros.imag.sum()) > 1e-6 * (1e-300 + np.abs(zeros).sum()):
            continue  # would split a conjugate pair
        shape = Rational(zeros, poles, 1.0)(probes)
        gain = float(np.real(np.vdot(shape / np.abs(truth), truth / np.abs(truth))))
        gain /= float(np.real(np.vdot(shape / np.abs(truth), shape / np.abs(truth))))
        error = float(np.max(np.abs(gain * shape / truth - 1.0)))
        # a spurious zero near infinity may fit a digit better by chance: prefer fewer zeros
        if error < 0.01 * best_error:
            best, best_error = Rational(zeros, poles, float(gain * input_size * output_size)), error
    if best is None or best_error > _FACTORING_TOLERANCE:
        raise InputError(
            f"state-space system of order {order} is too badly scaled to be factored "
            f"(relative error {best_error:.1e}); give a transfer function or rescale the states"
        )
    return best


def _probe_points(poles: Complexes) -> Complexes:
    """Points right of all poles, over the range of their sizes, at which realisations are compared."""
    sizes = np.abs(poles)
    top = float(sizes.max()) or 1.0
    # below 1e-6 of the fastest pole the resolvent of a badly scaled matrix is rounding noise
    low = float(np.min(sizes[sizes > 1e-6 * top], initial=top))
    return np.asarray(np.geomspace(0.3 * low, 30.0 * top, 9) * np.exp(0.35j) + max(0.0, float(poles.real.max())))
