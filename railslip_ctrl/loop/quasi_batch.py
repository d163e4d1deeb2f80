"""Number of unstable zeros of many quasi-polynomials at once, by the argument principle.

The change of the phase of F(j omega) along the frequency axis gives the number of zeros of F. The axis is
divided into intervals so short that, by a bound on dF/ds, the phase changes by less than 90 deg from middle to end.
"""

from __future__ import annotations

import math
from functools import cached_property, reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.arguments import Complexes, Flags, Floats
from railslip_ctrl.core.records import dataclass

Rows = NDArray[np.intp]

#: abs(s) times delay below which `_SERIES` terms of the series are used: 0.03^12 = 5e-19 is below rounding.
NEAR_ORIGIN, _SERIES = 0.03, 12

_NARROWEST = 1e-12  # relative width at which an undecided interval is regarded as a zero on the axis
_MOST_INTERVALS = 2_000_000  # intervals in memory at once; functions that need more are regarded as marginal
_EDGES = np.concatenate([[0.0], np.geomspace(1e-6, 1.0, 120)])  # ends of the first steps / highest frequency


@dataclass(frozen=True)
class QuasiPolynomials:
    """Arrays of n quasi-polynomials F(s) = s^-removed times the sum over k of c_k(s) exp(-delay_k s).

    - terms: sequence of arrays (n, m_k); coefficients of the polynomials c_k in descending powers of s. No c_k
      has a higher degree than c_0.
    - delays: sequence of arrays (n,), one per term; s, >= 0; 0 for c_0.
    - removed: power of s by which the sum is divided, as in `QuasiPolynomial`.
    """

    terms: tuple[Floats, ...]
    delays: tuple[Floats, ...]
    removed: int = 0

    def at(self, omega: Floats, row: Rows) -> Complexes:
        """Values F(j omega) of the functions with the indices `row`, at frequencies `omega`, rad/s; both (N,)."""
        value, square = np.zeros(omega.size, dtype=complex), -omega * omega
        for c, delay in zip(self.terms, self.delays, strict=True):
            term = _horner(c[:, ::-1][:, ::2], square, row) + 1j * omega * _horner(c[:, ::-1][:, 1::2], square, row)
            value += term * _turn(delay[row] * omega) if delay.any() else term
        if not self.removed:
            return value
        with np.errstate(divide="ignore", invalid="ignore"):
            value /= (1j * omega) ** self.removed
        near = omega * self.longest[row] < NEAR_ORIGIN  # the terms cancel there: use the series
        value[near] = _horner(self.series, 1j * omega[near], row[near])
        return value

    @cached_property
    def longest(self) -> Floats:
        """Longest delay of each function, s, (n,)."""
        return np.asarray(np.max(self.delays, axis=0))

    @cached_property
    def series(self) -> Floats:
        """First 12 coefficients of the Taylor series of F about s = 0, in ascending powers, (n, 12)."""
        count = self.removed + _SERIES
        series = np.zeros((self.longest.size, count))
        for c, delay in zip(self.terms, self.delays, strict=True):
            turn = np.cumprod(np.column_stack([np.ones(delay.size), -delay[:, None] / np.arange(1, count)]), axis=1)
            for power in range(c.shape[1]):
                series[:, power:] += c[:, -1 - power, None] * turn[:, : count - power]
        return series[:, self.removed :]

    @cached_property
    def _derivative(self) -> QuasiPolynomials:
        return reduce(lambda one, _: one.slope(), range(self.removed), self._bare)

    @cached_property
    def _bare(self) -> QuasiPolynomials:
        return QuasiPolynomials(self.terms, self.delays)

    def slope(self) -> QuasiPolynomials:
        """Derivatives dF/ds as quasi-polynomials; their `removed` is that of F plus 1, or 0 if that of F is 0."""
        parts = []
        for c, delay in zip(self.terms, self.delays, strict=True):
            change = -delay[:, None] * c
            change[:, 1:] += c[:, :-1] * np.arange(c.shape[1] - 1, 0, -1)
            if self.removed:
                change = np.column_stack([change, np.zeros(len(c))])
                change[:, 1:] -= self.removed * c
            parts.append(change)
        return QuasiPolynomials(tuple(parts), self.delays, self.removed + 1 if self.removed else 0)

    def size(self, radius: Floats, row: Rows, least: Floats | float = 0.0) -> Floats:
        """Upper bound on |F(s)| for all s with least <= |s| <= radius and Re s >= 0.

        - radius, least: 1/s, (N,).
        - row: index of the function F for each bound, (N,).
        """
        if self.removed:  # F is bounded by Taylor's remainder of the sum, and away from 0 by the sum itself
            near = self._derivative.size(radius, row) / math.factorial(self.removed)
            with np.errstate(divide="ignore"):
                return np.asarray(np.minimum(near, self._bare.size(radius, row) / np.asarray(least) ** self.removed))
        return sum((_horner(np.abs(c[:, ::-1]), radius, row) for c in self.terms), np.zeros_like(radius))

    def __add__(self, other: QuasiPolynomials) -> QuasiPolynomials:
        """Sums of quasi-polynomials with the same `removed`; only the terms without delay are combined."""
        (one, two), more = (self.terms[0], other.terms[0]), max(self.terms[0].shape[1], other.terms[0].shape[1])
        first = sum(np.pad(c, ((0, 0), (more - c.shape[1], 0))) for c in (one, two))
        terms = (np.asarray(first), *self.terms[1:], *other.terms[1:])
        return QuasiPolynomials(terms, (*self.delays, *other.delays[1:]), self.removed)


def _horner(c: Floats, x: Any, row: Rows) -> Any:
    value = np.zeros_like(x)  # ascending powers
    for column in c.T[::-1]:
        value = value * x + column[row]
    return value


def _turn(angle: Floats) -> Complexes:
    value = np.empty(angle.size, dtype=complex)  # NumPy's complex exponential takes three times as long
    value.real, value.imag = np.cos(angle), -np.sin(angle)
    return value


def count_right(function: QuasiPolynomials) -> Floats:
    """Number of zeros of each function right of the imaginary axis, (n,); NaN if a zero is on or too near the axis."""
    lead, order = function.terms[0][:, 0], function.terms[0].shape[1] - 1
    sizes = np.zeros((lead.size, order + 1))
    for c in function.terms:
        sizes[:, order + 1 - c.shape[1] :] += 2 * np.abs(c / lead[:, None])
    # beyond `top` the highest power exceeds twice the sum of all others, and F stays within 90 deg of it
    top = 2 * np.max(sizes[:, 1:] ** (1 / np.arange(1, order + 1)), axis=1, initial=0.0)
    top[top == 0] = 1.0
    row, omega, value, marginal = _nodes(function, top)
    first, last = np.searchsorted(row, np.arange(lead.size)), np.searchsorted(row, np.arange(lead.size), "right") - 1
    steps = np.zeros(omega.size)
    steps[1:] = np.angle(value[1:] / value[:-1])
    steps[first] = 0.0
    turned = np.bincount(row, steps, minlength=lead.size)
    degree = order - function.removed
    rest = np.angle(value[last] / (lead * (1j * top) ** degree))
    right = np.round((degree * np.pi / 2 - turned + rest) / np.pi)
    return np.where(marginal, np.nan, right)


def _nodes(function: QuasiPolynomials, top: Floats) -> tuple[Rows, Floats, Complexes, Flags]:
    """Frequencies from 0 to `top`, rad/s, between which the phase of each function changes by less than 180 deg.

    Return the index of the function, the frequency and F of each node. The last array is True for each function with a
    zero on the axis or too near it.
    """
    slope, edges = function.slope(), top[:, None] * _EDGES
    every = np.arange(top.size)
    row = np.repeat(every, _EDGES.size - 1)
    low, high = edges[:, :-1].ravel(), edges[:, 1:].ravel()
    marginal = np.zeros(top.size, dtype=bool)
    done = [(every, end, function.at(end, every)) for end in (np.zeros(top.size), top)]
    while row.size:
        half = (high - low) / 2
        middle = low + half
        value = function.at(middle, row)
        safe = np.abs(value) > 1.01 * half * slope.size(high, row, low)  # F turns by < 90 deg from the middle to an end
        done.append((row[safe], middle[safe], value[safe]))
        marginal[row[~safe & ((half <= _NARROWEST * high) | (row.size > _MOST_INTERVALS))]] = True
        left = ~safe & ~marginal[row]
        row, low, middle, high = row[left], low[left], middle[left], high[left]
        row, low, high = np.tile(row, 2), np.concatenate([low, middle]), np.concatenate([middle, high])
    row, omega, value = (np.concatenate(parts) for parts in zip(*done, strict=True))
    order = np.lexsort((omega, row))
    return row[order], omega[order], value[order], marginal
