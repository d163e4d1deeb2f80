"""Where F(s) exp(tau s) + G(s) is real on the axis s = j omega, F and G polynomials: no grid is asked.

With phi = tau omega + arg F and kappa = Im G/|F| that is sin phi = -kappa: phi + asin kappa is an even multiple of pi,
or phi - asin kappa an odd one. The frequencies at which |kappa| = 1 and those at which either of these angles turns
back are roots of polynomials in x = omega^2, isolated with certainty. Between neighbours both are monotone, so that
their values at the ends tell how many real values lie there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from flint import arb, ctx, fmpq, fmpq_poly

from railslip_ctrl.loop.crossings import bracketed_roots
from railslip_ctrl.loop.rational import Axis, angle_sum, fraction, positive_square_roots

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]

_BITS = 128
_STEP_OUT = 16.0  # factor by which an end at 0 or infinity is replaced until the function there has its sign
_MOST_STEPS = 250
_NOTHING = 1e-80  # |kappa| next to omega = 0 below which its limit there is 0, so that the angle there is a whole one


def real_frequencies(factor: fmpq_poly, other: fmpq_poly, dead_time: float, highest: float) -> Floats:
    """All omega, rad/s, 0 < omega < `highest`, at which F exp(tau s) + G is real; F without those where it is 0 itself.

    `factor` is F, not 0, `other` G; Im G must not change its sign over omega > 0. `highest` is finite unless the
    `dead_time`, s, is 0. None are found where the value is real everywhere.
    """
    if dead_time == 0:
        factor, other = factor + other, fmpq_poly([0])
    if factor == 0:
        return np.array([])
    angles = _Angles(factor, other, dead_time)
    turns, ends = np.setdiff1d(angles.turns(), angles.on_axis), angles.ends()
    low, high = parts(np.concatenate([turns, ends]), angles.on_axis, highest)
    inside = angles.log_ratio(_between(low, high)) < 0
    low, high = low[inside], high[inside]
    found = [np.array([])]
    for side in (0, 1):
        # a real value at each whole number; those at omega = 0 and infinity are not reached
        start, end = ((angles.half_turns(omega, side, ends) - side) / 2 for omega in (low, high))
        start = np.where(low == 0, np.nextafter(start, end), start)
        end = np.where(np.isinf(high), np.nextafter(end, start), end)
        least = np.floor(np.minimum(start, end))
        count = (np.floor(np.maximum(start, end)) - least).astype(int)
        at = np.repeat(np.arange(count.size), count)
        step = np.arange(at.size) - np.repeat(np.cumsum(count) - count, count)
        target = 2 * (least[at] + 1 + step) + side

        def away(omega: Floats, index: NDArray[np.intp], side: int = side, target: Floats = target) -> Floats:
            return angles.half_turns(omega, side) - target[index]

        found.append(monotone_roots(away, low[at], high[at], np.sign(start - end)[at]))
    return np.unique(np.concatenate(found))


def parts(edges: Floats, jumps: Floats, highest: float) -> tuple[Floats, Floats]:
    """0 < omega < `highest`, divided at edges and at jumps, rad/s: from and to, beside the latter by one bit."""
    every = np.union1d(edges, jumps)
    every = every[every < highest]
    jump = np.isin(every, jumps)
    low, high = (np.where(jump, np.nextafter(every, side), every) for side in (np.inf, 0.0))
    return np.append(0.0, low), np.append(high, highest)


def monotone_roots(
    function: Callable[[Floats, NDArray[np.intp]], Floats], low: Floats, high: Floats, side: Floats
) -> Floats:
    """Roots, as of `bracketed_roots`, of functions that are monotone from `low`, 0 too, to `high`, infinity too, and
    have the sign `side` at the low and the other at the high end."""
    inner = np.where(low == 0, _between(low, high), low)
    outer = np.where(np.isinf(high), inner * _STEP_OUT, high)
    every = np.arange(low.size)
    for _ in range(_MOST_STEPS):
        below = (low == 0) & (function(inner, every) * side < 0)
        beyond = np.isinf(high) & (function(outer, every) * side > 0)
        if not (below | beyond).any():
            break
        inner, outer = (
            np.where(below, inner / _STEP_OUT, np.where(beyond, outer, inner)),
            np.where(below, inner, np.where(beyond, outer * _STEP_OUT, outer)),
        )
    return bracketed_roots(function, inner, outer)


def _between(low: Floats, high: Floats) -> Floats:
    """A frequency inside each interval, whose ends may be 0 and infinity."""
    top = np.where(np.isinf(high), np.maximum(low, 1.0) * _STEP_OUT, high)
    return np.where(low == 0, top / _STEP_OUT, low + 0.5 * (top - low))


class _Angles:
    """phi +- asin kappa of the module's text: its polynomials, and its values in half turns."""

    def __init__(self, factor: fmpq_poly, other: fmpq_poly, dead_time: float) -> None:
        self._dead_time = dead_time
        self._axis, self._other = Axis(factor), Axis(other).odd
        self._roots, self._other_roots = _roots(factor), _roots(self._other)
        lead = factor.coeffs()[-1]
        self._turned = float(lead < 0)
        ratio = self._other.coeffs()[-1] / lead if self._other != 0 else fmpq(0)
        self._sign, self._log_lead = (1.0 if ratio * lead > 0 else -1.0), float(arb(abs(ratio)).log().mid())
        self.on_axis = np.unique(self._roots.imag[(self._roots.real == 0) & (self._roots.imag > 0)])

    def ends(self) -> Floats:
        """Frequencies, rad/s, at which |kappa| = 1."""
        if self._other == 0:
            return np.array([])
        return _frequencies(self._gap)

    @property
    def _gap(self) -> fmpq_poly:
        """|F|^2 - (Im G)^2."""
        return self._axis.power - fmpq_poly([0, 1]) * self._other**2

    def turns(self) -> Floats:
        """Frequencies, rad/s, at which phi + asin kappa or phi - asin kappa turns back."""
        power, g, x = self._axis.power, self._other, fmpq_poly([0, 1])
        speed = fraction(self._dead_time) * power + self._axis.turning
        bend = (g + 2 * x * g.derivative()) * power - x * g * power.derivative()
        return _frequencies((speed**2 * self._gap - bend**2) // power)

    def log_ratio(self, omega: Floats) -> Floats:
        """ln|kappa|."""
        if self._other == 0:
            return np.full(omega.shape, -np.inf)
        with np.errstate(divide="ignore"):
            size = np.log(np.abs(omega[:, None] ** 2 - self._other_roots)).sum(axis=-1) + np.log(omega)
            size -= np.log(np.hypot(self._roots.real, omega[:, None] - self._roots.imag)).sum(axis=-1)
        return np.asarray(size + self._log_lead)

    def half_turns(self, omega: Floats, side: int, ends: Floats | None = None) -> Floats:
        """phi + asin kappa over pi, for side 1 phi - asin kappa; 0 and infinity allowed. |kappa| is 1 at `ends`."""
        inner = np.clip(omega, 1e-100, 1e100)
        phase = angle_sum(self._roots, inner) / np.pi + self._turned + self._dead_time * inner / np.pi
        right, origin = np.count_nonzero(self._roots.real > 0), np.count_nonzero(self._roots == 0)
        phase = np.where(omega == 0, right + origin / 2 + self._turned, phase)
        phase = np.where(np.isinf(omega), self._roots.size / 2 + self._turned, phase)
        if self._other == 0:
            return phase
        with np.errstate(over="ignore"):
            kappa = np.minimum(np.exp(self.log_ratio(inner)), 1.0)
        kappa[kappa < _NOTHING] = 0.0
        if ends is not None:
            kappa = np.where(np.isin(omega, ends), 1.0, kappa)
        return np.asarray(phase + (1 - 2 * side) * self._sign * np.arcsin(kappa) / np.pi)


def _frequencies(polynomial: fmpq_poly) -> Floats:
    """Square roots of the positive real roots, rad/s."""
    with ctx.workprec(_BITS):
        return np.array([float(omega.mid()) for omega, _ in positive_square_roots(polynomial)])


def _roots(polynomial: fmpq_poly) -> Complexes:
    """All complex roots, with their multiplicities; what cannot be told from the axis lies on it."""
    if polynomial.degree() < 1:
        return np.array([], dtype=complex)
    with ctx.workprec(_BITS):
        found = polynomial.complex_roots()
    listed = []
    for root, count in found:
        real = 0.0 if root.real.contains(0) else float(root.real.mid())
        listed += [complex(real, float(root.imag.mid()))] * count
    return np.array(listed)
