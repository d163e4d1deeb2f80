"""Rightmost closed-loop poles of a dead-time loop.

The dead time is a transport line fed by the loop's error; discretised on Chebyshev points it becomes a matrix
whose rightmost eigenvalues approximate those of the infinite-dimensional loop with spectral accuracy
([Breda2005]). Newton's method on the quasi-polynomial takes each to rounding, and the exact root count right of
a line confirms that none is missing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from railslip_ctrl.core.errors import RailslipError

from .rational import Rational
from .stability import count_right_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]

_NEWTON_STEPS = 60
_FIXED_POINT_STEPS = 30  # for the start values of the chain; Newton takes over from there
_RESIDUAL = 1e-10  # |Q|/(|D| + |N exp|) of an accepted pole; a double pole leaves about 1e-15 as well
_POINTS = (40, 80, 160)  # Chebyshev points tried; only the poles near the origin depend on them
_SAME = 1e-7  # relative distance within which two zeros found are one: a double one is good to 1e-8


class SpectrumError(RailslipError, ArithmeticError):
    """The rightmost poles could not be confirmed by the root count."""


def rightmost_poles(system: Rational, dead_time: float, count: int) -> Complexes:
    """The `count` rightmost zeros of D + N exp(-dead_time s), rightmost first, pairs upper half first, 1/s.

    Without dead time there are only as many as the system has poles. Of a neutral loop those right of its chain are
    confirmed; the chain's own have nearly one real part and come in ascending frequency. Raises SpectrumError where
    the exact count contradicts what was found (then nothing is returned).
    """
    if dead_time == 0 or system.gain == 0:
        return _ordered(_rational_poles(system))[:count]
    for attempt, points in enumerate(_POINTS):
        start = np.concatenate(
            [
                _start_values(system, dead_time, points),
                system.poles,
                _chain(system, dead_time, (1 + attempt) * count + 8),
            ]
        )
        poles = _ordered(_polished(system, dead_time, start))
        if poles.size >= count and _confirmed(system, dead_time, poles, count):
            return poles[:count]
    raise SpectrumError(
        f"the {count} rightmost closed-loop poles could not be confirmed by the root count; ask for fewer, or "
        f"check the scaling (dead time {dead_time:g} s, largest open-loop pole "
        f"{np.abs(system.poles).max(initial=0):.3g} 1/s)"
    )


def _chain(system: Rational, dead_time: float, count: int) -> Complexes:
    """Approximate poles far from the origin, one a turn of the dead time.

    From N exp(-tau s)/D = -1: tau s = ln(-N/D) + 2 pi j k, iterated from each k >= 0; it contracts where
    |s| tau exceeds the relative degree.
    """
    turns = np.arange(count, dtype=float)
    s = (2 * np.pi * turns + np.pi / 2) * 1j / dead_time + 1.0 / dead_time
    with np.errstate(all="ignore"):
        for _ in range(_FIXED_POINT_STEPS):
            s = (np.log(-system(s)) + 2j * np.pi * turns) / dead_time
    s = s[np.isfinite(s)]
    return np.concatenate([s, s.real.astype(complex)[:2]])


def _rational_poles(system: Rational) -> Complexes:
    """Closed-loop poles without dead time."""
    a, b, c, d = _cascade(system)
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
        q, slope, size = _quasi_polynomial(system, dead_time, s)
        # next to an open-loop pole D and N exp are small and cancel: there the size of the last step decides
        at_rounding = np.abs(q) <= 1e-13 * np.abs(s) * np.abs(slope)
        return s, np.isfinite(s) & ((np.abs(q) <= _RESIDUAL * size) | at_rounding)


def _polished(system: Rational, dead_time: float, start: Complexes) -> Complexes:
    """Distinct zeros of Q near the start values; a double zero stays double."""
    start = start[np.isfinite(start)]
    found, good = _newton(system, dead_time, start)
    features = np.abs(np.concatenate([system.zeros, system.poles, [1.0 / dead_time]]))
    floor = 1e-9 * float(features[features > 0].min())
    kept: list[complex] = []
    starts: list[complex] = []
    for s, s0 in sorted(zip(found[good], start[good], strict=True), key=lambda pair: abs(pair[0] - pair[1])):
        tolerance = _SAME * abs(s) + floor
        same = [i for i, k in enumerate(kept) if abs(k - s) <= tolerance]
        # two start values may run to one zero; it is double only if Q' vanishes there too
        if not same or (len(same) == 1 and s0 != starts[same[0]] and _is_double(system, dead_time, s)):
            kept.append(s)
            starts.append(s0)
    return _symmetric(np.array(kept, dtype=complex))


def _is_double(system: Rational, dead_time: float, s: complex) -> bool:
    """Whether dQ/ds vanishes at a zero of Q, to the accuracy that a double zero has."""
    at = np.array([s])
    _q, slope, size = _quasi_polynomial(system, dead_time, at)
    if size[0] == 0 or not np.isfinite(size[0]):
        return bool(slope[0] == 0)  # on a hidden mode, where D and N both vanish
    roots = np.concatenate([system.zeros, system.poles])
    nearest = float(np.min(np.abs(roots - s), initial=np.inf))
    scale = 1 / nearest if 1e-300 < nearest < np.inf else 0.0
    return bool(np.abs(slope[0]) <= 1e-6 * size[0] * (scale + dead_time))


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
    scale = 1e-9 * abs(poles[count - 1])
    edge = float(poles.real[count - 1]) - scale
    left = poles.real[poles.real < edge]
    line = 0.5 * (edge + float(left.max())) if left.size else edge - scale
    through = abs(system.feedthrough)
    if through > 0:
        # a neutral loop's chain tends to this real part: only what lies right of it can be counted
        line = max(line, np.log(through) / dead_time + 1e-6 / dead_time)
    expected = count_right_of(system, dead_time, float(line))
    return not expected.marginal and expected.right == np.count_nonzero(poles.real > line)
