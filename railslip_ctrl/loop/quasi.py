"""Loops whose controller holds delays of its own: a ratio of quasi-polynomials with commensurate delays.

A dead-time compensator carries a model of the dead time, so that its loop is L(s) = N(s, q)/D(s, q) with polynomials
in s and q = exp(-delay s). Closed-loop poles are the zeros of N + D, counted exactly by the argument principle;
margins come from the same code as those of `DeadTimeLoop`, so that both stand side by side.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import zip_longest

import numpy as np
from numpy.typing import ArrayLike

from railslip_ctrl.core.errors import InputError, UnstableLoopError

from .crossings import Pieces, Response, bracketed_roots, phase_crossovers
from .deadtime import DeadTimeLoop
from .margins import Margins, compute_margins, gain_limits, stabilizing_range
from .rational import Complexes, Floats, Rational
from .stability import RootCount

# An interval of the axis this narrow (relative to its frequency) that still may hold a zero has one on the axis.
_NARROWEST = 1e-12
_MOST_INTERVALS = 2_000_000
_LOG_STEP = 0.4  # change of ln L between frequency nodes; extrema between nodes are then located exactly
_SMALL = 5e-3  # nodes reach to where |L| is for certain below this
_TURNS = 22  # and over as many turns of the dead time, so that the first 20 phase crossovers are listed
_MOST_NODES = 400_000


@dataclass(frozen=True)
class QuasiPolynomial:
    """F(s) = sum over k of c_k(s) exp(-k delay s).

    Parameters
    ----------
    terms : sequence of arrays
        Coefficients of c_0, c_1, ... in descending powers of s, real; c_0 not zero.
    delay : float
        s, >= 0.

    InputError: no term, c_0 = 0, a coefficient that is not finite, or a delay that is negative or not finite.
    """

    terms: tuple[Floats, ...]
    delay: float

    def __init__(self, terms: Sequence[ArrayLike], delay: float) -> None:
        arrays = tuple(np.atleast_1d(np.trim_zeros(np.atleast_1d(np.asarray(c, dtype=float)), "f")) for c in terms)
        arrays = tuple(c if c.size else np.zeros(1) for c in arrays)
        if not (math.isfinite(delay) and delay >= 0):
            raise InputError(f"delay: {delay} s is not allowed; give a finite value >= 0")
        if not all(np.isfinite(c).all() for c in arrays):
            raise InputError("quasi-polynomial has a coefficient that is not finite; give finite numbers")
        object.__setattr__(self, "terms", arrays)
        object.__setattr__(self, "delay", float(delay))

    def __call__(self, s: ArrayLike) -> Complexes:
        """F at complex s (1/s), any shape."""
        return self._weighted(np.asarray(s, dtype=complex), self.terms)

    def slope(self, s: ArrayLike) -> Complexes:
        """dF/ds at complex s, any shape."""
        return self._weighted(np.asarray(s, dtype=complex), self._slopes)

    @cached_property
    def _slopes(self) -> tuple[Floats, ...]:
        return tuple(np.polysub(np.polyder(c), k * self.delay * c) for k, c in enumerate(self.terms))

    def _weighted(self, s: Complexes, terms: tuple[Floats, ...]) -> Complexes:
        q, power = np.exp(-self.delay * s), np.ones_like(s)
        total = np.zeros_like(s)
        for c in terms:
            total = total + np.polyval(c, s) * power
            power = power * q
        return np.asarray(total)

    def __add__(self, other: QuasiPolynomial) -> QuasiPolynomial:
        """Sum of two with the same delay."""
        pairs = zip_longest(self.terms, other.terms, fillvalue=np.zeros(1))
        return QuasiPolynomial([np.polyadd(a, b) for a, b in pairs], self.delay)

    def times(self, polynomial: ArrayLike, power: int = 0) -> QuasiPolynomial:
        """F(s) * polynomial(s) * exp(-power delay s); coefficients in descending powers."""
        factor = np.asarray(polynomial, dtype=float)
        shifted = [np.zeros(1)] * power + [np.polymul(c, factor) for c in self.terms]
        return QuasiPolynomial(shifted, self.delay)

    @property
    def degree(self) -> int:
        """Highest power of s."""
        return max(c.size - 1 for c in self.terms)

    @property
    def retarded(self) -> bool:
        """True if the highest power of s comes without delay alone."""
        return bool(self.terms[0][0] != 0 and all(c.size < self.terms[0].size for c in self.terms[1:]))

    def count_right(self) -> RootCount:
        """Zeros in the open right half plane, and whether some are on the axis (`marginal`; then counted as right).

        The argument of F(j omega) is followed from 0 to where the highest power decides. No step is taken on
        trust: over each, |F| at the middle exceeds its largest possible change, by a bound on dF/ds.
        """
        if not self.retarded:
            raise InputError(
                "quasi-polynomial of neutral type: the highest power of s comes with a delay; make the loop proper"
            )
        top = self._dominant_frequency()
        nodes, marginal = self._axis_nodes(top)
        if marginal:
            return RootCount(float("nan"), True)
        value = self(1j * nodes)
        turned = float(np.angle(value[1:] / value[:-1]).sum())
        # beyond the last node F stays within 90 deg of its highest power
        rest = float(np.angle(value[-1] / (self.terms[0][0] * (1j * top) ** self.degree)))
        return RootCount(float(round((self.degree * np.pi / 2 - turned + rest) / np.pi)), False)

    def _dominant_frequency(self) -> float:
        """omega beyond which the highest power exceeds twice the sum of all others."""
        sizes = 2 * _sum_of_sizes(self.terms) / abs(self.terms[0][0])
        return float(2 * max(sizes[i] ** (1 / i) for i in range(1, sizes.size)) if np.any(sizes[1:]) else 1.0)

    def _axis_nodes(self, top: float) -> tuple[Floats, bool]:
        """Frequencies 0 to `top` between which F cannot turn by 90 deg, and whether F vanishes on the way."""
        bound = _sum_of_sizes(self._slopes)
        edges = np.concatenate([[0.0], np.geomspace(1e-6 * top, top, 120)])
        low, high = edges[:-1], edges[1:]
        done: list[Floats] = [np.array([0.0])]
        held = 0
        while low.size:
            half = (high - low) / 2
            middle = low + half
            safe = np.abs(self(1j * middle)) > 1.01 * half * np.polyval(bound, high)
            if np.any(~safe & (half <= _NARROWEST * high)) or held + low.size > _MOST_INTERVALS:
                return np.array([]), True
            done += [middle[safe], high[safe]]
            held += int(np.count_nonzero(safe))
            low, middle, high = low[~safe], middle[~safe], high[~safe]
            low, high = np.concatenate([low, middle]), np.concatenate([middle, high])
        return np.unique(np.concatenate(done)), False


def _sum_of_sizes(terms: Sequence[Floats]) -> Floats:
    """Sum over k of |c_k|, coefficient by coefficient: bounds |F| on the axis."""
    return np.asarray(reduce(np.polyadd, map(np.abs, terms)), dtype=np.float64)


@dataclass(frozen=True)
class DelayedRatio:
    """A transfer function N(s, q)/D(s, q), q = exp(-delay s); both quasi-polynomials of the same delay."""

    numerator: QuasiPolynomial
    denominator: QuasiPolynomial

    def __post_init__(self) -> None:
        if self.numerator.delay != self.denominator.delay:
            raise InputError(
                f"delays {self.numerator.delay:g} s and {self.denominator.delay:g} s differ; give both in the same unit"
            )

    def __call__(self, s: ArrayLike) -> Complexes:
        """Value at complex s (1/s), any shape; infinite at a pole."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(self.numerator(s) / self.denominator(s))

    @property
    def high_frequency_gain(self) -> float:
        """Limit as s tends to +infinity."""
        num, den = self.numerator.terms[0], self.denominator.terms[0]
        return float(num[0] / den[0]) if num.size == den.size else 0.0


class DelayedLoop:
    """The loop L = N/D of quasi-polynomials under unity negative feedback.

    Parameters
    ----------
    ratio : DelayedRatio
        L. Factors common to N and D are hidden modes: they are kept and count for stability. So N + D must be the
        characteristic function of plant and controller *as realised*.

    InputError: D is not of retarded type, or L does not tend to 0 at infinity.

    Notes
    -----
    `margins` returns the record of `DeadTimeLoop`, by the same code. Its delay margin is added dead time in the
    process, the delays inside the controller staying as they are.
    """

    def __init__(self, ratio: DelayedRatio) -> None:
        if not ratio.denominator.retarded or ratio.numerator.degree >= ratio.denominator.degree:
            raise InputError("delayed loop: L must tend to 0 at infinity with a denominator of retarded type")
        self.ratio = ratio

    @classmethod
    def from_dead_time_loop(cls, loop: DeadTimeLoop) -> DelayedLoop:
        """A dead-time loop as a special case: N = (0, num), D = (den)."""
        system = loop.system
        num = system.gain * np.atleast_1d(np.real(np.poly(system.zeros)))
        den = np.atleast_1d(np.real(np.poly(system.poles)))
        return cls(DelayedRatio(QuasiPolynomial([[0.0], num], loop.dead_time), QuasiPolynomial([den], loop.dead_time)))

    @property
    def characteristic(self) -> QuasiPolynomial:
        """N + D, whose zeros are the closed-loop poles."""
        return self.ratio.numerator + self.ratio.denominator

    def __call__(self, s: ArrayLike) -> Complexes:
        """L at complex s (1/s), any shape."""
        return self.ratio(s)

    def scaled(self, factor: float) -> DelayedLoop:
        """The loop with its gain multiplied by `factor`."""
        return DelayedLoop(DelayedRatio(self.ratio.numerator.times([factor]), self.ratio.denominator))

    def frequency_response(self, omega: ArrayLike) -> Complexes:
        """L(j omega), complex, of the shape of `omega` (rad/s)."""
        return self.ratio(1j * np.asarray(omega, dtype=float))

    def sensitivity(self, omega: ArrayLike) -> Complexes:
        """S(j omega) = D/(N + D), complex, of the shape of `omega` (rad/s)."""
        s = 1j * np.asarray(omega, dtype=float)
        return np.asarray(self.ratio.denominator(s) / self.characteristic(s))

    def complementary_sensitivity(self, omega: ArrayLike) -> Complexes:
        """T(j omega) = N/(N + D), complex, of the shape of `omega` (rad/s)."""
        s = 1j * np.asarray(omega, dtype=float)
        return np.asarray(self.ratio.numerator(s) / self.characteristic(s))

    @cached_property
    def root_count(self) -> RootCount:
        """Closed-loop poles in the right half plane, exactly counted; NaN right of it if some are on the axis."""
        return self.characteristic.count_right()

    def is_stable(self) -> bool:
        """True if every closed-loop pole lies left of the imaginary axis, hidden modes included."""
        return self.root_count.stable

    @cached_property
    def gain_crossovers(self) -> Floats:
        """All omega > 0 with |L| = 1, rad/s, ascending; also of an unstable loop."""
        cut, response = self._response.pieces, self._response
        at = np.flatnonzero(np.sign(cut.size[0]) * np.sign(cut.size[1]) <= 0)
        return np.unique(_zeros(response.log_size, cut.low[at], cut.high[at]))

    @cached_property
    def stabilizing_gain_range(self) -> tuple[float, float] | None:
        """Factors on the loop gain that stabilise, as of `DeadTimeLoop`; None if there are none or a pole is on
        the axis."""
        if self.root_count.marginal:
            return None
        return stabilizing_range(gain_limits(self._response, self._phase_crossings), self.root_count.right)

    def margins(self) -> Margins:
        """All margins; see `Margins`. Raises UnstableLoopError where the closed loop is not stable."""
        if not self.is_stable():
            count = self.root_count.right
            unstable = f"{count:g} unstable pole{'' if count == 1 else 's'}"
            where = "poles on the imaginary axis" if self.root_count.marginal else unstable
            raise UnstableLoopError(
                f"margins are not defined: the closed loop has {where}; change the design",
                unstable_poles=count,
                stabilizing_gain_range=self.stabilizing_gain_range,
            )
        half_turns = self._response.angle(self.gain_crossovers) / np.pi
        rest = half_turns - 2 * np.floor(half_turns / 2) - 1
        limits = gain_limits(self._response, self._phase_crossings)
        cut, crossovers = self._response.pieces, self.gain_crossovers
        return compute_margins(self._response, cut, crossovers, rest, self._phase_crossings, limits)

    @cached_property
    def _phase_crossings(self) -> Floats:
        return phase_crossovers(self._response, self._response.pieces)

    @cached_property
    def _response(self) -> _DelayedResponse:
        return _DelayedResponse(self.ratio)


class _DelayedResponse(Response):
    """L(j omega) as margins want it; the phase is followed over `nodes` between which ln L changes little."""

    def __init__(self, ratio: DelayedRatio) -> None:
        num, den = ratio.numerator, ratio.denominator
        low, top = _band(num, den)
        at_zero = complex(den(0.0)), complex(num(0.0))
        # what the margin code asks of a rational L: its value at 0, and that it vanishes at infinity
        pole = 0.0 if abs(at_zero[0]) <= 1e-13 * float(np.sum([abs(c[-1]) for c in den.terms])) else -low
        gain = 1.0 if pole == 0.0 else (at_zero[1] / at_zero[0]).real * low
        if np.all([not np.any(c) for c in num.terms]):
            gain = 0.0
        stand_in = Rational(np.array([]), np.array([pole]), gain)
        super().__init__(system=stand_in, dead_time=0.0)
        object.__setattr__(self, "_ratio", ratio)
        nodes = _resolving_nodes(self, np.geomspace(low, top, int(16 * math.log10(top / low)) + 2))
        value = self(nodes)
        object.__setattr__(self, "nodes", nodes)
        object.__setattr__(self, "_values", value)
        turns = np.concatenate([[0.0], np.cumsum(np.angle(value[1:] / value[:-1]))])
        object.__setattr__(self, "_phases", float(np.angle(value[0])) + turns)

    is_rational = False
    _ratio: DelayedRatio
    nodes: Floats
    _values: Complexes
    _phases: Floats

    @cached_property
    def pieces(self) -> Pieces:
        """The axis cut at the nodes and at the extrema between them."""
        edges = self.nodes
        for slope in (self.angle_slope, self.log_size_slope):
            value = slope(edges)
            at = np.flatnonzero(np.sign(value[:-1]) * np.sign(value[1:]) < 0)
            edges = np.union1d(edges, _zeros(slope, edges[at], edges[at + 1]))
        values = np.array([self.log_size(edges), self.angle(edges) / np.pi])
        return Pieces(edges[:-1], edges[1:], *np.stack([values[:, :-1], values[:, 1:]], axis=1))

    def value_and_slopes(self, omega: Floats) -> tuple[Complexes, Complexes, Complexes]:
        step = 1e-6 * omega  # for Newton's method inside brackets, which forgives an inexact second derivative
        second = (self.log_slope(omega + step) - self.log_slope(omega - step)) / (2 * step)
        return self(omega), self.log_slope(omega), second

    def bend(self, low: Floats, high: Floats) -> Floats:
        """Twice the largest change of d ln L/d omega over the halves of each interval: an estimate."""
        slopes = self.log_slope(np.array([low, 0.5 * (low + high), high]))
        return np.asarray(4 * np.abs(np.diff(slopes, axis=0)).max(axis=0) / (high - low))

    def __call__(self, omega: Floats) -> Complexes:
        return self._ratio(1j * np.asarray(omega))

    def log_slope(self, omega: Floats) -> Complexes:
        s = 1j * np.asarray(omega)
        num, den = self._ratio.numerator, self._ratio.denominator
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(1j * (num.slope(s) / num(s) - den.slope(s) / den(s)))

    def log_size(self, omega: Floats) -> Floats:
        with np.errstate(divide="ignore"):
            return np.log(np.abs(self(omega)))

    def log_size_slope(self, omega: Floats) -> Floats:
        return self.log_slope(omega).real

    def angle(self, omega: Floats) -> Floats:
        at = np.minimum(np.searchsorted(self.nodes, omega), self.nodes.size - 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            return self._phases[at] + np.angle(self(omega) / self._values[at])

    def angle_slope(self, omega: Floats) -> Floats:
        return self.log_slope(omega).imag


def _zeros(function: Callable[[Floats], Floats], low: Floats, high: Floats) -> Floats:
    return bracketed_roots(lambda w, _: function(w), low, high)


def _band(num: QuasiPolynomial, den: QuasiPolynomial) -> tuple[float, float]:
    """Frequencies, rad/s, below which nothing happens and above which |L| is small for certain."""
    order, lead = den.degree, abs(den.terms[0][0])
    loud, others = _sum_of_sizes(num.terms), _sum_of_sizes(den.terms)
    others[0] -= lead

    def quiet(omega: float) -> bool:
        """|L| < _SMALL at omega, and so beyond, as the highest power of D gains on all the rest."""
        return bool(_SMALL * (lead * omega**order - np.polyval(others, omega)) > np.polyval(loud, omega))

    top = 1e-6
    while not quiet(top):
        top *= 1.5
    together = []
    for f in (num, den, num + den):
        merged: Floats = np.zeros(1)
        for c in f.terms:
            merged = np.asarray(np.polyadd(merged, c), dtype=np.float64)
            together.append(np.roots(c))
        together.append(np.roots(merged))
    sizes = np.abs(np.concatenate(together))
    # a root at the origin, or one that rounding of a leading coefficient puts far out, is no feature
    sizes = sizes[(sizes > 1e-9 * top) & (sizes < top)]
    least = float(sizes.min(initial=top))
    if den.delay > 0:
        least = min(least, 1 / den.delay)
        top = max(top, _TURNS * 2 * np.pi / den.delay)
    return 1e-4 * least, top


def _resolving_nodes(response: _DelayedResponse, nodes: Floats) -> Floats:
    """`nodes` divided until ln L changes by less than a set step between neighbours."""
    while nodes.size < _MOST_NODES:
        value, slope = response(nodes), response.log_slope(nodes)
        width = np.diff(nodes)
        change = np.abs(np.log(value[1:] / value[:-1]))
        change = np.maximum(change, width * np.maximum(np.abs(slope[1:]), np.abs(slope[:-1])))
        wide = (change > _LOG_STEP) & (width > 1e-11 * nodes[1:])
        if not wide.any():
            break
        nodes = np.sort(np.concatenate([nodes, (nodes[:-1] + width / 2)[wide]]))
    return nodes
