"""A real state-space realisation of a factored transfer function: first- and second-order sections in series.

Each section holds its poles on its diagonal, not in the coefficients of a polynomial, so that eigenvalues,
double ones included, are those given to rounding. The variable may be s or z: only the factored form is used.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from railslip_ctrl.core.errors import InputError

from .rational import Rational

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]

_PAIRED = 1e-9  # relative distance of a root's conjugate from its partner: what eigenvalue routines leave of it


@dataclass(frozen=True)
class Realisation:
    """x' = a x + b u, y = c x + d u (or x of the next sample for x'); shapes (n, n), (n,), (n,) and a float."""

    a: Floats
    b: Floats
    c: Floats
    d: float

    @property
    def order(self) -> int:
        """Number of states."""
        return int(self.b.size)


def realise(system: Rational) -> Realisation:
    """Real realisation of as many states as `system` has poles, cancelled ones included.

    States are those of the sections in series, fed at the first, with the gain at the output.

    Raises
    ------
    InputError
        Complex zeros or poles that are not in conjugate pairs.
    """
    n = system.poles.size
    a, b, row, through = np.zeros((n, n)), np.zeros(n), np.zeros(n), 1.0
    at = 0
    for section in _sections(system):
        here = slice(at, at + section.order)
        # `row` and `through` are the signal fed to this section as a combination of the states and the input
        a[here] = np.outer(section.b, row)
        a[here, here] += section.a
        b[here] = section.b * through
        row, through = section.d * row, section.d * through
        row[here] += section.c
        at += section.order
    return Realisation(a, b, system.gain * row, system.gain * through)


def _sections(system: Rational) -> list[Realisation]:
    """Monic sections whose product is the system with gain 1, each zero in the section of the poles nearest to it."""
    zeros, zero_pairs = _split(system.zeros, "zeros")
    poles, pole_pairs = _split(system.poles, "poles")
    sections = []
    for pole in pole_pairs:
        if zero_pairs:
            zero = _take_nearest(zero_pairs, pole)
            sections.append(_pair_section(pole, (zero, zero.conjugate())))
        else:
            # real zeros only where the real poles cannot hold them all
            surplus = min(2, max(0, len(zeros) - len(poles)))
            sections.append(_pair_section(pole, tuple(_take_nearest(zeros, pole) for _ in range(surplus))))
    for zero in zero_pairs:
        first, second = _take_nearest(poles, zero), _take_nearest(poles, zero)
        sections.append(_two_poles_section(first.real, second.real, zero))
    while poles:
        pole = poles.pop()
        sections.append(_single_section(pole.real, _take_nearest(zeros, pole).real if zeros else None))
    return sections


def _split(roots: Complexes, name: str) -> tuple[list[complex], list[complex]]:
    """The real roots, and of each conjugate pair the upper one."""
    real, upper, lower = (roots[mask] for mask in (roots.imag == 0, roots.imag > 0, roots.imag < 0))
    left = [complex(root) for root in lower]
    for root in upper:
        partner = _take_nearest(left, root.conjugate()) if left else complex(np.inf)
        if not abs(partner - root.conjugate()) <= _PAIRED * abs(root):
            raise _unpaired(complex(root), name)
    if left:
        raise _unpaired(left[0], name)
    return [complex(root) for root in real], [complex(root) for root in upper]


def _unpaired(root: complex, name: str) -> InputError:
    return InputError(f"transfer function: {name} hold {root:g} without its conjugate; give complex ones in pairs")


def _take_nearest(roots: list[complex], to: complex) -> complex:
    """Remove and return the root nearest to a point."""
    return roots.pop(min(range(len(roots)), key=lambda i: abs(roots[i] - to)))


def _single_section(pole: float, zero: float | None) -> Realisation:
    """1/(s - pole), or (s - zero)/(s - pole)."""
    residue, through = (1.0, 0.0) if zero is None else (pole - zero, 1.0)
    return Realisation(np.array([[pole]]), np.array([1.0]), np.array([residue]), through)


def _pair_section(pole: complex, zeros: tuple[complex, ...]) -> Realisation:
    """prod(s - zeros)/((s - pole)(s - its conjugate)), for 0, 1 or 2 zeros; `a` is a scaled rotation."""
    re, im = pole.real, pole.imag
    # the numerator less d times the denominator is slope (s - re) + level
    if len(zeros) == 2:
        offset = [re - zero for zero in zeros]
        slope, level, through = sum(offset).real, (offset[0] * offset[1]).real - im * im, 1.0
    elif len(zeros) == 1:
        slope, level, through = 1.0, re - zeros[0].real, 0.0
    else:
        slope, level, through = 0.0, 1.0, 0.0
    return Realisation(np.array([[re, im], [-im, re]]), np.array([0.0, 1.0]), np.array([level / im, slope]), through)


def _two_poles_section(first: float, second: float, zero: complex) -> Realisation:
    """(s - zero)(s - its conjugate)/((s - first)(s - second)), real poles."""
    slope = first + second - 2 * zero.real
    level = (second - zero.real) ** 2 + zero.imag**2
    # y = u + slope u/(s - first) + level u/((s - first)(s - second))
    a = np.array([[first, 0.0], [1.0, second]])
    return Realisation(a, np.array([1.0, 0.0]), np.array([slope, level]), 1.0)
