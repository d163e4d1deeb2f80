"""Rightmost closed-loop poles of a dead-time loop.

The dead time is a transport line fed by the loop's error; discretised on Chebyshev points it becomes a matrix
whose rightmost eigenvalues approximate those of the infinite-dimensional loop with spectral accuracy
([Breda2005]). Newton's method on the quasi-polynomial takes each to rounding, and the exact root count right of
a line confirms that none is missing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from railslip_ctrl.errors import RailslipError

from .rational import Rational
from .stability import count_right_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]

_NEWTON_STEPS = 60
_RESIDUAL = 1e-10  # |Q|/(|D| + |N exp|) of an accepted pole; a double pole leaves about 1e-15 as well
_LARGEST_LINE = 640  # Chebyshev points; resolves about 200 pairs of poles


class SpectrumError(RailslipError, ArithmeticError):
    """The rightmost poles could not be confirmed by the root count."""


def rightmost_poles(system: Rational, dead_time: float, count: int) -> Complexes:
    """The `count` rightmost zeros of D + N exp(-dead_time s), rightmost first, pairs upper half first, 1/s.

    Without dead time there are only as many as the system has poles. Raises SpectrumError where the exact
    count contradicts what was found (then nothing is returned).
    """
    if dead_time == 0 or system.gain == 0:
        return _ordered(_rational_poles(system))[:count]
    points = max(24, 4 * count + 12)
    while points <= _LARGEST_LINE:
        poles = _ordered(_polished(system, dead_time, _start_values(system, dead_time, points), count))
        if poles.size >= count and _confirmed(system, dead_time, poles, count):
            return poles[:count]
        points *= 2
    raise SpectrumError(
        f"the {count} rightmost closed-loop poles could not be confirmed by the root count; ask for fewer, or "
        f"check the scaling (dead time {dead_time:g} s, largest open-loop pole "
        f"{np.abs(system.poles).max(initial=0):.3g} 1/s)"
    )


def _rational_poles(system: Rational) -> Complexes:
    """Closed-loop poles without dead time."""
    a, b, c, d = _cascade(system)
    if a.size == 0 or system.gain == 0:
        return system.poles
    start = np.asarray(np.linalg.eigvals(a - np.outer(b, c) / (1 + d)), dtype=np.complex128)
    return _symmetric(_newton(system, 0.0, start)[0])


def _cascade(system: Rational) -> tuple[Complexes, Complexes, Complexes, float]:
    """Complex realisation of G as first-order sections in series: well conditioned at any order."""
    zeros = list(system.zeros)
    n = system.poles.size
    a, b = np.zeros((n, n), dtype=np.complex128), np.zeros(n, dtype=np.complex128)
    through: complex = 1.0
    row = np.zeros(n, dtype=np.complex128)  # the signal between sections as a combination of states and the input
    for i, pole in enumerate(system.poles):
        a[i], b[i] = row, through
        a[i, i] += pole
        if zeros:
            zero = zeros.pop(int(np.argmin(np.abs(np.array(zeros) - pole))))
            row[i] += pole - zero
        else:
            row, through = np.zeros(n, complex), 0.0
            row[i] = 1.0
    return a, b, system.gain * row, system.gain * float(np.real(through))


def _start_values(system: Rational, dead_time: float, points: int) -> Complexes:
    """Eigenvalues of the loop with the dead time as a transport line on `points` + 1 Chebyshev points."""
    a, b, c, d = _cascade(system)
    n = a.shape[0]
    nodes = np.cos(np.pi * np.arange(points + 1) / points)
    weight = np.concatenate([[2.0], np.ones(points - 1), [2.0]]) * (-1.0) ** np.arange(points + 1)
    difference = nodes[:, None] - nodes[None, :] + np.eye(points + 1)
    derivative = np.outer(weight, 1.0 / weight) / difference
    derivative -= np.diag(derivative.sum(axis=1))
    derivative *= 2.0 / dead_time
    # u on the line at theta = dead_time (node - 1)/2; u(0) = -C x - D u(-dead_time) closes the loop
    matrix = np.zeros((n + points, n + points), complex)
    matrix[:n, :n] = a
    matrix[:n, -1] = b
    matrix[n:, n:] = derivative[1:, 1:]
    matrix[n:, :n] = np.outer(derivative[1:, 0], -c)
    matrix[n:, -1] -= derivative[1:, 0] * d
    return np.asarray(np.linalg.eigvals(matrix))


def _quasi_polynomial(system: Rational, dead_time: float, s: Complexes) -> tuple[Complexes, Complexes, Floats]:
    """Q, dQ/ds and |D| + |N exp| at s."""
    d, d_slope = _product(system.poles, s)
    n, n_slope = _product(system.zeros, s)
    delay = system.gain * np.exp(-dead_time * s)
    return d + n * delay, d_slope + (n_slope - dead_time * n) * delay, np.abs(d) + np.abs(n * delay)


def _product(roots: Complexes, s: Complexes) -> tuple[Complexes, Complexes]:
    """prod(s - roots) and its derivative, exact at the roots themselves."""
    value, slope = np.ones_like(s), np.zeros_like(s)
    for root in roots:
        slope = slope * (s - root) + value
        value = value * (s - root)
    return value, slope


def _newton(system: Rational, dead_time: float, start: Complexes) -> tuple[Complexes, NDArray[np.bool_]]:
    """Newton's method from each start value, and whether each ended on a zero of Q."""
    s = start.astype(complex)
    with np.errstate(all="ignore"):
        for _ in range(_NEWTON_STEPS):
            q, slope, _size = _quasi_polynomial(system, dead_time, s)
            step = np.where(slope == 0, 0, q / slope)
            s = s - step
            if np.all(~np.isfinite(s) | (np.abs(step) <= 4e-16 * np.abs(s))):
                break
        q, _slope, size = _quasi_polynomial(system, dead_time, s)
        return s, np.isfinite(s) & (np.abs(q) <= _RESIDUAL * size)


def _polished(system: Rational, dead_time: float, start: Complexes, count: int) -> Complexes:
    """Distinct zeros of Q near the rightmost start values; a double zero stays double."""
    start = start[np.argsort(-start.real)][: 2 * count + system.poles.size + 8]
    found, good = _newton(system, dead_time, start)
    moved = np.abs(found - start) / (1e-300 + np.abs(start) + 1.0 / dead_time)
    good &= moved < 0.3
    kept: list[complex] = []
    close_starts: list[complex] = []
    for s, s0, near in sorted(zip(found[good], start[good], moved[good], strict=True), key=lambda item: item[2]):
        same = [k for k in kept if abs(k - s) <= 1e-6 * (abs(s) + 1e-3 / dead_time)]
        # two start values may run to one zero; it is double only if both began on top of it
        if not same or (near < 1e-3 and all(abs(s0 - other) > 0 for other in close_starts)):
            kept.append(s)
            close_starts.append(s0)
    return _symmetric(np.array(kept, dtype=complex))


def _symmetric(poles: Complexes) -> Complexes:
    """Real ones made real; of each pair the upper one, with its exact conjugate."""
    scale = np.abs(poles)
    real = poles[np.abs(poles.imag) <= 1e-9 * scale].real.astype(complex)
    upper = poles[poles.imag > 1e-9 * scale]
    return np.concatenate([real, upper, upper.conj()])


def _ordered(poles: Complexes) -> Complexes:
    return poles[np.lexsort((-poles.imag, np.abs(poles.imag), -poles.real))]


def _confirmed(system: Rational, dead_time: float, poles: Complexes, count: int) -> bool:
    """Whether the exact count right of a line just left of pole number `count` is what was found."""
    scale = 1e-6 * (abs(poles[count - 1]) + 1.0 / dead_time)
    right_of = poles.real[count - 1] - scale
    left = poles.real[poles.real < right_of]
    line = 0.5 * (right_of + left.max()) if left.size else right_of
    expected = count_right_of(system, dead_time, float(line))
    return not expected.marginal and expected.right == np.count_nonzero(poles.real > line)
