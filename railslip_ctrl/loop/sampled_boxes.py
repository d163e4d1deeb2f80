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

ROUNDING = 1e-12  # of ln L, many times what is seen
# Slower than this share of the slowest pole or zero L is its asymptote, and a crossover is rounding of |L(0)| = 1.
_BELOW_FEATURES = 1e-5
_CELL_RATIO = 1.5


@dataclass(frozen=True)
class Expansion:
    """ln(L z^turns) about the middles of boxes: `value`, and its slopes to theta and to the fraction, complex, (n,).

    `near` holds the reciprocal distances to poles and zeros, (n, roots), with `signs` 1 for a zero and -1 for a pole;
    `taylor` the numerator's Taylor coefficients in z over its value, (n, order + 1), `drifts` those of its derivative
    to 1 - fraction, `follows` how each follows the components of G, (n, order + 1, order).
    """

    of: BoxedResponse
    fraction: Floats
    turn: Complexes
    value: Complexes
    slope: Complexes
    drift: Complexes
    near: Floats
    signs: Floats
    taylor: Complexes
    drifts: Complexes
    follows: Complexes

    def bounds(self, half: Floats, half_fraction: Floats | None = None) -> tuple[Floats, Floats, Floats]:
        """The largest ln|L| in the boxes; the largest distances of ln L and of ln|L| from their linear parts; or inf.

        `half` and `half_fraction` are half the widths, (n,). The second holds for complex theta in the disk of radius
        `half` too. The third is far less at low frequency, where a delay turns L and leaves |L| as it is.
        """
        # each power of z - middle by its size; in the third the first power by its part along the circle
        reach = np.expm1(half)  # |z - middle|
        powers: Floats = reach[:, None] ** np.arange(self.taylor.shape[1])
        powers[:, 0] = 0.0
        beyond = powers.copy()
        beyond[:, 1] = reach - half
        moved, curved = (np.abs(self.taylor) * powers).sum(axis=1), (np.abs(self.taylor) * beyond).sum(axis=1)
        linear = np.abs(self.taylor[:, 1]) * half
        if half_fraction is not None:
            bend = self.of.bend(self.fraction, half_fraction)[:, :, None]
            along = np.stack([self.follows[:, 0], self.follows[:, 1] * self.turn[:, None]], axis=1)
            bent, sideways = (np.abs(self.follows) @ bend)[:, :, 0], (np.abs(along.real) @ bend)[:, :, 0]
            drifts = np.abs(self.drifts) * half_fraction[:, None]
            moved += drifts[:, 0] + bent[:, 0] + ((drifts + bent) * powers).sum(axis=1)
            curved += sideways[:, 0] + ((drifts + bent) * beyond).sum(axis=1)
            curved += half * (sideways[:, 1] + np.abs((self.drifts[:, 1] * self.turn).real) * half_fraction)
            linear = linear + drifts[:, 0]
        apart = np.minimum(self.near * reach[:, None], 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            roots, log = -np.log1p(-apart), -np.log1p(-np.minimum(moved, 1))
            top = self.value.real + np.where(self.signs > 0, np.log1p(apart), roots).sum(axis=1) + np.log1p(moved)
            apart = roots.sum(axis=1) - self.near.sum(axis=1) * half
            found = np.array([top, log - linear + apart, log - moved + curved + apart]) + ROUNDING
        top, rest, level = np.where(np.isnan(found), np.inf, found)
        return top, rest, level


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
            relative = numerator / numerator[:, :1]
            drifts = drift / numerator[:, :1]
            return Expansion(
                of=self,
                fraction=fraction,
                turn=1j * np.exp(1j * theta),
                value=np.log(self._controller(np.exp(1j * theta)) * numerator[:, 0]),
                slope=1j * np.exp(1j * theta) * (relative[:, 1] + near @ self._signs),
                drift=-drifts[:, 0],
                near=np.abs(near),
                signs=self._signs,
                taylor=relative,
                drifts=drifts,
                follows=through / numerator[:, :1, None],
            )
