"""Exact number of closed-loop poles in the right half plane, and the rightmost closed-loop poles.

The poles are the zeros of Q(s) = D(s) + N(s) exp(-tau s), where L(s) = N(s) exp(-tau s)/D(s). The gain crossovers and
the continuous phase of L at each of them give the number of poles, without a grid or a Pade approximation. This is the
direct method of [WaltonMarshall1987], applied to one dead time. Ball arithmetic decides where rounding could matter.
"""

from __future__ import annotations

import numpy as np
from flint import ctx

from railslip_ctrl.core.arguments import Complexes, Flags, Floats
from railslip_ctrl.core.errors import RailslipError
from railslip_ctrl.core.records import dataclass

from .crossings import GAIN, MOST_BITS, Response
from .rational import Rational, realise, rounded_roots

_FARTHEST = 600.0  # largest dead time times |line|: exp(600) is still a double
_SHIFT = 1e-7  # shift of the contour to the left, relative to the loop's frequencies, to count poles on the axis
_NEWTON_STEPS = 60  # most steps from one start value
_FIXED_POINT_STEPS = 30  # iterations for the start values of the chain; Newton's method refines them
_RESIDUAL = 1e-10  # largest |Q|/(|D| + |N exp|) of an accepted pole; even a double pole leaves about 1e-15
_POINTS = (40, 80, 160)  # numbers of Chebyshev points, tried in turn; they only matter for the poles near the origin
_SAME = 1e-7  # relative distance within which two computed zeros are regarded as one; a double zero is accurate to 1e-8


@dataclass(frozen=True)
class RootCount:
    """Number of closed-loop poles right of the imaginary axis, or of a line parallel to it.

    For a sampled loop it is the number of poles outside the unit circle.

    - right: the number of these poles, including poles on the line or circle.
    - marginal: true if poles lie on the line or circle.
    """

    right: float
    marginal: bool

    @property
    def stable(self) -> bool:
        """True if all closed-loop poles are left of the axis or line (sampled loop: inside the unit circle)."""
        return self.right == 0 and not self.marginal


def count_right_of(system: Rational, dead_time: float, line: float = 0.0) -> RootCount:
    """Number of closed-loop poles of L(s) = system(s) exp(-dead_time s) right of Re s = `line`, 1/s; it may be inf."""
    if dead_time * line < -_FARTHEST:
        return RootCount(float("inf"), False)  # exp(-tau line) would overflow
    return root_count(_moved(Response(system, dead_time), line) if line else Response(system, dead_time))


def root_count(response: Response, *, certain: bool = False) -> RootCount:
    """Count the closed-loop poles right of the imaginary axis; if `certain`, ball arithmetic computes all phases."""
    count, marginal = _count(response, certain)
    if not marginal:
        return RootCount(count, False)
    scale = float(response.scales.min())
    for attempt in range(1, 8):
        # the power 1.37 avoids multiples of one shift: a pole on one shifted line is not on the next
        count, again = _count(_moved(response, -_SHIFT * scale * attempt**1.37))
        if not again:
            break
    return RootCount(count, True)


def _moved(response: Response, c: float) -> Response:
    """Response of the shifted loop L(s + c), `c` in 1/s."""
    return Response(response.system.shifted(c) * float(np.exp(-response.dead_time * c)), response.dead_time)


def _count(response: Response, certain: bool = False) -> tuple[float, bool]:
    system, dead_time = response.system, response.dead_time
    both = (system.zeros.tolist(), system.poles.tolist())
    axis_zeros, axis_poles = (any(root.real == 0 for root in roots) for roots in both)
    if axis_zeros and axis_poles and response.exact.hidden_on_axis:
        return float("nan"), True  # a hidden mode on the axis is a closed-loop pole there
    right = [sum(root.real > 0 for root in roots) for roots in both]
    if system.gain == 0:
        return float(right[1]), axis_poles
    through = response.exact.through
    if dead_time > 0 and abs(through) >= 1:
        return float("inf"), False  # neutral: a chain of poles tends to Re s = ln|G(inf)|/tau >= 0
    if through == -1:
        return float("inf"), False  # 1 + L(inf) = 0: not well posed
    characteristic = response.exact.numerator + response.exact.denominator
    if characteristic[0] == 0:
        return float("nan"), True
    if response.exact.all_pass:  # |L| = 1 everywhere, without dead time: count the roots of the polynomial
        with ctx.workprec(MOST_BITS):
            roots = characteristic.complex_roots()
        return float(sum(n for root, n in roots if root.real > 0)), any(root.real.contains(0) for root, _ in roots)
    # Half turns of arg Q from omega = 0 to infinity. On the axis it is arg D + Arg(1 + L) where |L| < 1, and
    # arg N - tau omega + Arg(1 + 1/L) where |L| > 1, with Arg within +-90 deg. At a gain crossover the two forms differ
    # by 2 pi round(arg L/2 pi).
    large, turned = response.exact.large_at_zero, int(system.gain < 0)
    change = -(right[0] + turned) if large else -right[1]
    phases = response.phases_at_crossovers(certain=True) if certain else response.crossover_phases
    if not all(rest for _, rest in phases):  # L = -1, only without dead time: else exp(-j tau omega) is transcendental
        return float("nan"), True
    for (odd, rest), (_, multiplicity) in zip(phases, response.exact.frequencies(GAIN), strict=True):
        if multiplicity % 2:  # at a touch of |L| = 1 the form does not change
            n = int(odd) + (1 if rest > 0 else -1)
            change += n if large else -n
            large = not large
    # as omega tends to infinity the continuous angle of every root, left or right, is 90 deg
    end = system.zeros.size + 2 * turned if large else system.poles.size
    return float(system.poles.size / 2 - end / 2 - change), False


# -- the rightmost poles ------------------------------------------------------------------------------------------


class SpectrumError(RailslipError, ArithmeticError):
    """The exact number of closed-loop poles right of a line differs from the number of computed poles there."""


def rightmost_poles(system: Rational, dead_time: float, count: int) -> Complexes:
    """Compute the `count` rightmost closed-loop poles of L(s) = G(s) exp(-dead_time s), rightmost first, 1/s.

    - system: G.
    - dead_time: s, >= 0.
    - count: number of poles; of a conjugate pair the pole with Im > 0 comes first. Without dead time the loop has only
      as many poles as G.

    Raises SpectrumError if the exact root count differs from the number of computed poles. A neutral loop has
    infinitely many poles with nearly equal real parts (a chain). The chain is listed in ascending frequency, and only
    poles right of the chain are compared with the root count.

    Newton's method starts at the eigenvalues of a loop in which a transport line at Chebyshev points replaces the dead
    time ([Breda2005]), and at further approximations of the poles.
    """
    num, den = system.polynomials
    if dead_time == 0 or system.gain == 0:
        return _ordered(rounded_roots(num + den))[:count]
    for attempt, points in enumerate(_POINTS):
        chain = _chain(system, dead_time, (1 + attempt) * count + 8)
        start = np.concatenate([_start_values(system, dead_time, points), system.poles, chain])
        poles = _ordered(_polished(system, dead_time, start))
        if poles.size >= count and _confirmed(system, dead_time, poles, count):
            return poles[:count]
    raise SpectrumError(
        f"the number of computed closed-loop poles differs from the exact root count; compute fewer poles than "
        f"{count}, or check the units (dead time {dead_time:g} s, largest open-loop pole "
        f"{np.abs(system.poles).max(initial=0):.3g} 1/s)"
    )


def _chain(system: Rational, dead_time: float, count: int) -> Complexes:
    # poles far from the origin by iteration of tau s = ln(-N/D) + 2 pi j k for k = 0 to `count` - 1
    turns = np.arange(count, dtype=float)
    s = (2 * np.pi * turns + np.pi / 2) * 1j / dead_time + 1.0 / dead_time
    with np.errstate(all="ignore"):
        for _ in range(_FIXED_POINT_STEPS):
            s = (np.log(-system(s)) + 2j * np.pi * turns) / dead_time
    s = s[np.isfinite(s)]
    return np.concatenate([s, s.real.astype(complex)[:2]])


def _start_values(system: Rational, dead_time: float, points: int) -> Complexes:
    """Eigenvalues, 1/s, of the loop whose dead time is a transport line with `points` + 1 Chebyshev points."""
    open_loop = realise(system)
    n = open_loop.order
    nodes = np.cos(np.pi * np.arange(points + 1) / points)
    weight = np.concatenate([[2.0], np.ones(points - 1), [2.0]]) * (-1.0) ** np.arange(points + 1)
    difference = nodes[:, None] - nodes[None, :] + np.eye(points + 1)
    derivative = np.outer(weight, 1.0 / weight) / difference
    derivative -= np.diag(derivative.sum(axis=1))
    derivative *= 2.0 / dead_time
    # u is the signal on the line at theta = dead_time (node - 1)/2; u(0) = -C x - D u(-dead_time) closes the loop
    matrix = np.zeros((n + points, n + points))
    matrix[:n, :n] = open_loop.a
    matrix[:n, -1] = open_loop.b
    matrix[n:, n:] = derivative[1:, 1:]
    matrix[n:, :n] = np.outer(derivative[1:, 0], -open_loop.c)
    matrix[n:, -1] -= derivative[1:, 0] * open_loop.d
    return np.asarray(np.linalg.eigvals(matrix))


def _quasi_polynomial(system: Rational, dead_time: float, s: Complexes) -> tuple[Complexes, Complexes, Floats]:
    """Values at s of Q = D + N exp(-dead_time s), dQ/ds and |D| + |N exp(-dead_time s)|."""
    d, d_slope = _product(system.poles, s)
    n, n_slope = _product(system.zeros, s)
    delay = system.gain * np.exp(-dead_time * s)
    return d + n * delay, d_slope + (n_slope - dead_time * n) * delay, np.abs(d) + np.abs(n * delay)


def _product(roots: Complexes, s: Complexes) -> tuple[Complexes, Complexes]:
    """prod(s - roots) and its derivative with respect to s, both accurate also at the roots."""
    value, slope = np.ones_like(s), np.zeros_like(s)
    for root in roots:
        slope = slope * (s - root) + value
        value = value * (s - root)
    return value, slope


def _newton(system: Rational, dead_time: float, start: Complexes) -> tuple[Complexes, Flags]:
    """Apply Newton's method to each start value; return the final values, and whether each is a zero of Q."""
    s = start.astype(complex)
    with np.errstate(all="ignore"):
        for _ in range(_NEWTON_STEPS):
            q, slope, _size = _quasi_polynomial(system, dead_time, s)
            step = np.where(slope == 0, 0, q / slope)
            s = s - step
            if np.all(~np.isfinite(s) | (np.abs(step) <= 4e-16 * np.abs(s))):
                break
        q, slope, size = _quasi_polynomial(system, dead_time, s)
        # next to an open-loop pole D and N exp are small and cancel: the size of the last step decides instead
        at_rounding = np.abs(q) <= 1e-13 * np.abs(s) * np.abs(slope)
        return s, np.isfinite(s) & ((np.abs(q) <= _RESIDUAL * size) | at_rounding)


def _polished(system: Rational, dead_time: float, start: Complexes) -> Complexes:
    """Zeros of Q to which Newton's method converges from `start`; simple zeros are listed once, double zeros twice."""
    start = start[np.isfinite(start)]
    found, good = _newton(system, dead_time, start)
    features = np.abs(np.append(system.roots, 1 / dead_time))
    floor = 1e-9 * float(features[features > 0].min())
    kept: list[complex] = []
    starts: list[complex] = []
    for s, s0 in sorted(zip(found[good], start[good], strict=True), key=lambda pair: abs(pair[0] - pair[1])):
        tolerance = _SAME * abs(s) + floor
        same = [i for i, k in enumerate(kept) if abs(k - s) <= tolerance]
        # two start values may converge to one zero; it is double only if Q' vanishes too
        if not same or (len(same) == 1 and s0 != starts[same[0]] and _is_double(system, dead_time, s)):
            kept.append(s)
            starts.append(s0)
    poles = np.array(kept, dtype=complex)
    off_axis = np.abs(poles.imag) > 1e-9 * np.abs(poles)
    upper = poles[off_axis & (poles.imag > 0)]
    return np.concatenate([poles[~off_axis].real, upper, upper.conj()])


def _is_double(system: Rational, dead_time: float, s: complex) -> bool:
    at = np.array([s])
    _q, slope, size = _quasi_polynomial(system, dead_time, at)
    if size[0] == 0 or not np.isfinite(size[0]):
        return bool(slope[0] == 0)  # a hidden mode: D and N both vanish
    nearest = float(np.min(np.abs(system.roots - s), initial=np.inf))
    scale = 1 / nearest if 1e-300 < nearest < np.inf else 0.0
    return bool(np.abs(slope[0]) <= 1e-6 * size[0] * (scale + dead_time))


def _ordered(poles: Complexes) -> Complexes:
    return poles[np.lexsort((-poles.imag, np.abs(poles.imag), -poles.real))]


def _confirmed(system: Rational, dead_time: float, poles: Complexes, count: int) -> bool:
    """True if the exact root count right of a vertical line equals the number of `poles` right of this line."""
    # the line lies just left of pole number `count`
    scale = 1e-9 * abs(poles[count - 1])
    edge = float(poles.real[count - 1]) - scale
    left = poles.real[poles.real < edge]
    line = 0.5 * (edge + float(left.max())) if left.size else edge - scale
    through = abs(system.feedthrough)
    if through > 0:
        # a neutral loop's chain tends to this real part: only poles right of it can be counted
        line = max(line, np.log(through) / dead_time + 1e-6 / dead_time)
    expected = count_right_of(system, dead_time, float(line))
    return not expected.marginal and expected.right == np.count_nonzero(poles.real > line)
