"""Bounds on ln L of a sampled loop over boxes of frequency and fraction of the period, so that no grid decides.

With z = exp(j theta), m = 1 - fraction and turns = 1 + whole periods of dead time the response is (the modified
z-transform, [Astrom1997] 2)

    L = K(z) c (z - Phi)^-1 (G(1) + (z - 1) G(m)) z^-turns,    G(m) = integral of exp(a s) b over [0, m].

Its numerator is a polynomial in z, and G is entire: the sizes of the Taylor coefficients at the middle of a box,
summed, bound what ln L is from its linear part anywhere in the box.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .sampled_system import SampledSystem

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]

_ROUNDING = 1e-12  # of ln L, many times what is seen
# Slower than this share of the slowest pole or zero L is its asymptote, and a crossover is rounding of |L(0)| = 1.
_BELOW_FEATURES = 1e-5
_CELL_RATIO = 1.5


@dataclass(frozen=True)
class Expansion:
    """ln(L z^turns) about the middles of boxes: `value`, and its slopes to theta and to the fraction, complex, (n,).

    `near` holds the reciprocal distances to poles and zeros, (n, roots), with `signs` 1 for a zero and -1 for a pole;
    `sizes` those of the numerator's Taylor coefficients in z, (n, order + 1), `drifts` those of its derivative to the
    fraction, `bends` how each is moved by the components of G, (n, order + 1, order).
    """

    of: BoxedResponse
    fraction: Floats
    value: Complexes
    slope: Complexes
    drift: Complexes
    near: Floats
    signs: Floats
    sizes: Floats
    drifts: Floats
    bends: Floats

    def bounds(self, half: Floats, half_fraction: Floats | None = None) -> tuple[Floats, Floats]:
        """The largest ln|L| in the boxes, and the largest distance of ln L from its linear part; inf if not found.

        `half` and `half_fraction` are half the widths, (n,). Complex theta in the disk of radius `half` is covered too.
        """
        reach = np.expm1(half)[:, None]  # |z - middle|
        middle, change = self.sizes[:, 0], self.sizes.copy()
        change[:, 0] = 0.0
        linear = change[:, 1] * half
        if half_fraction is not None:
            bend = self.of.bend(self.fraction, half_fraction)[:, :, None]
            change += self.drifts * half_fraction[:, None] + (self.bends @ bend)[:, :, 0]
            linear = linear + self.drifts[:, 0] * half_fraction
        moved = (change * reach ** np.arange(change.shape[1])).sum(axis=1)
        apart = np.minimum(self.near * reach, 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            roots = -np.log1p(-apart)
            top = np.where(self.signs > 0, np.log1p(apart), roots).sum(axis=1) + np.log1p(moved / middle)
            rest = -np.log1p(-np.minimum(moved / middle, 1)) - linear / middle
            rest += roots.sum(axis=1) - self.near.sum(axis=1) * half
            top = np.where(middle > 0, self.value.real + top, np.inf)
        return top + _ROUNDING, np.where(np.isfinite(rest), rest + _ROUNDING, np.inf)


class BoxedResponse:
    """The response of a loop as its expansions need it; time is counted in periods."""

    def __init__(self, loop: SampledSystem) -> None:
        held, self._controller = loop.held, loop.controller
        self._a, self._b, self._c, self._growth = held.a, held.b, held.c, held.growth
        n = held.c.size
        self._plant_poles = np.expm1(loop.plant.poles * loop.period)
        poles = np.concatenate([self._plant_poles, loop.controller.poles - 1])
        self._roots = np.concatenate([poles, loop.controller.zeros - 1])  # of z - 1
        self._signs = np.repeat([-1.0, 1.0], [poles.size, loop.controller.zeros.size])
        self._driven = np.zeros((n + 1, n + 1))
        self._driven[:n, :n], self._driven[:n, n] = held.a, held.b
        # [[bound, 1, 0], [0, 0, 1], [0, 0, 0]] with |exp(a m)| <= exp(bound m): its exponential holds the integrals
        self._bound = np.diag(np.ones(2 * n), n)
        self._bound[:n, :n] = np.where(np.eye(n) > 0, held.a, np.abs(held.a))
        self._whole = self._reached(np.ones(1))[0]
        self._slowest = min(np.pi, float(loop.feature_frequencies.min(initial=np.inf)) * loop.period)

    def first_edges(self) -> Floats:
        """Values of theta from which to part further, from far below the slowest pole or zero to pi."""
        low = _BELOW_FEATURES * self._slowest
        return np.geomspace(low, np.pi, 2 + int(np.log(np.pi / low) / np.log(_CELL_RATIO)))

    def _reached(self, m: Floats) -> Floats:
        """G(m), (n, order)."""
        from scipy.linalg import expm

        return np.asarray(expm(self._driven * m[:, None, None])[:, :-1, -1])

    def bend(self, fraction: Floats, half: Floats) -> Floats:
        """Bound on what G is from linear about `fraction` within `half`, by components, (n, order)."""
        from scipy.linalg import expm

        n, (halves, at) = self._c.size, np.unique(half, return_inverse=True)
        with np.errstate(over="ignore", invalid="ignore"):
            powers = expm(self._bound * halves[:, None, None])[at]
        once, twice = powers[:, :n, n : 2 * n], powers[:, :n, 2 * n :]
        ends, at = np.unique(1 - np.stack([fraction, fraction + half]), return_inverse=True)
        # |G''| at the middle, and where m is least: from each on exp(a m) is less than exp of the bounding matrix
        curved = np.abs((self._reached(ends) @ self._a.T + self._b) @ self._a.T)[at.reshape(2, -1)][..., None]
        after, before = twice @ curved[0], (half[:, None, None] * once - twice) @ curved[1]
        return np.asarray(np.maximum(after, before)[:, :, 0])

    def expand(self, theta: Floats, fraction: Floats) -> Expansion:
        """The expansion about points, theta in rad per period and the fraction, (n,) each."""
        n, beyond = self._c.size, np.expm1(1j * theta)
        fractions, at = np.unique(fraction, return_inverse=True)
        reached = self._reached(1 - fractions)[at]
        speed = reached @ self._a.T + self._b  # G' = a G + b
        near = 1 / (beyond[:, None] - self._roots)
        resolvent = np.linalg.inv(beyond[:, None, None] * np.eye(n) - self._growth)
        # c adj(z - Phi)/det(middle - Phi) by powers of z - middle: the resolvent's series times its denominator
        rows = np.zeros((theta.size, n + 1, n), dtype=complex)
        row = self._c @ resolvent
        for k in range(n):
            rows[:, k] = row
            row = -(row[:, None] @ resolvent)[:, 0]
        for k in range(n):
            rows[:, 1:n] += rows[:, : n - 1] * near[:, k, None, None]
        through = rows * beyond[:, None, None]
        through[:, 1:] += rows[:, :-1]
        numerator = rows @ self._whole + (through @ reached[:, :, None])[:, :, 0]
        drift = (through @ speed[:, :, None])[:, :, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            return Expansion(
                of=self,
                fraction=fraction,
                value=np.log(self._controller(np.exp(1j * theta)) * numerator[:, 0]),
                slope=1j * np.exp(1j * theta) * (numerator[:, 1] / numerator[:, 0] + near @ self._signs),
                drift=-drift[:, 0] / numerator[:, 0],
                near=np.abs(near),
                signs=self._signs,
                sizes=np.abs(numerator),
                drifts=np.abs(drift),
                bends=np.abs(through),
            )
