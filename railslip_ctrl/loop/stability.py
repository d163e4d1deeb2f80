"""The exact number of closed-loop poles in the right half plane.

The closed-loop poles are the zeros of the quasi-polynomial Q(s) = D(s) + N(s) exp(-tau s), L = N exp(-tau s)/D.
Along s = j omega the argument of Q is known in closed form wherever |L| != 1: it is arg D + Arg(1 + L) where
|L| < 1 and arg N - tau omega + Arg(1 + 1/L) where |L| > 1, both principal values within +-90 deg. At a gain
crossover the two differ by 2 pi round(arg L/2 pi). So the gain crossovers, with the continuous phase there,
decide: no grid, no Pade, and poles on or near the axis need no indentation because where |L| is large only N
is looked at. This is the direct method of [WaltonMarshall1987] read at one dead time.

The crossovers are algebraic numbers, isolated exactly (`exact`). Where rounding of the phase could matter, balls of
growing precision decide; with dead time they do so in the end, as exp(-j tau omega) is transcendental there (Lindemann)
and L cannot be -1. Without, L = -1 at a crossover is a pole on the axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from flint import ctx

from .crossings import Response, crossover_phases, gain_crossovers
from .exact import GAIN, MOST_BITS
from .rational import Rational

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

_FARTHEST = 600.0  # dead times times 1/s; exp(600) is still a double
# Contour shift, relative to the loop's own frequencies, that takes poles on the axis to the counted side.
_SHIFT = 1e-7


@dataclass(frozen=True)
class RootCount:
    """Closed-loop poles right of a line; `marginal` if some lie on it (they are counted as right of it)."""

    right: float
    marginal: bool

    @property
    def stable(self) -> bool:
        """True if no pole lies right of or on the line."""
        return self.right == 0 and not self.marginal


def count_right_of(system: Rational, dead_time: float, line: float = 0.0) -> RootCount:
    """Count the closed-loop poles with real part > `line` (1/s) of L = G exp(-dead_time s), unity feedback.

    `inf` for a neutral loop whose chain of poles lies right of the line.
    """
    if dead_time * line < -_FARTHEST:
        return RootCount(float("inf"), False)  # so far left that exp(-tau line) overflows: beyond any use
    return root_count(_moved(Response(system, dead_time), line) if line else Response(system, dead_time))


def root_count(response: Response, *, certain: bool = False) -> RootCount:
    """Count the closed-loop poles right of the imaginary axis, as `count_right_of`; all of it in balls if `certain`."""
    count, marginal = _count(response, certain)
    if not marginal:
        return RootCount(count, False)
    scale = _shift_scale(response)
    for attempt in range(1, 8):
        # not a multiple of itself, so that a pole met once by accident is not met again
        count, again = _count(_moved(response, -_SHIFT * scale * attempt**1.37))
        if not again:
            break
    return RootCount(count, True)


def _moved(response: Response, c: float) -> Response:
    """L(s + c) as a function of s."""
    return Response(response.system.shifted(c) * float(np.exp(-response.dead_time * c)), response.dead_time)


def _shift_scale(response: Response) -> float:
    sizes = np.abs(np.concatenate([response.system.zeros, response.system.poles]))
    sizes = np.concatenate([sizes[sizes > 0], gain_crossovers(response)])
    return float(sizes.min()) if sizes.size else 1.0


def _count(response: Response, certain: bool = False) -> tuple[float, bool]:
    """(closed-loop poles with positive real part, whether one is on the axis)."""
    system, dead_time = response.system, response.dead_time
    axis_zeros, axis_poles = (r[r.real == 0] for r in (system.zeros, system.poles))
    if axis_zeros.size and axis_poles.size and response.exact.hidden_on_axis:
        return float("nan"), True  # a hidden mode on the axis is a closed-loop pole there
    right = [int(np.count_nonzero(roots.real > 0)) for roots in (system.zeros, system.poles)]
    if system.gain == 0:
        return float(right[1]), bool(axis_poles.size)
    through = response.exact.through
    if dead_time > 0 and abs(through) >= 1:
        return float("inf"), False  # neutral: a chain of poles tends to Re s = ln|G(inf)|/tau >= 0
    if through == -1:
        return float("inf"), False  # 1 + L(inf) = 0: not well posed
    if response.exact.pole_at_origin:
        return float("nan"), True
    if response.exact.all_pass:
        return _count_polynomial(response)
    # half turns of arg Q from omega = 0 to infinity: the branch follows the form in use, that of N where |L| > 1
    large, turned = response.exact.large_at_zero, int(system.gain < 0)
    change = -(right[0] + turned) if large else -right[1]
    odd, rest = crossover_phases(response, certain=certain)
    if not rest.all():
        return float("nan"), True
    for n, (_, multiplicity) in zip(odd + np.sign(rest), response.exact.frequencies(GAIN), strict=True):
        if multiplicity % 2:  # at a touch of |L| = 1 the form does not change
            change += int(n) if large else -int(n)
            large = not large
    # far up the axis every continuous angle is 90 deg, left and right roots alike
    end = system.zeros.size + 2 * turned if large else system.poles.size
    return float(system.poles.size / 2 - end / 2 - change), False


def _count_polynomial(response: Response) -> tuple[float, bool]:
    """|L| = 1 at every frequency, no dead time: the polynomial D + N itself."""
    characteristic = response.exact.numerator + response.exact.denominator
    with ctx.workprec(MOST_BITS):
        roots = characteristic.complex_roots()
    return float(sum(n for root, n in roots if root.real > 0)), any(root.real.contains(0) for root, _ in roots)
