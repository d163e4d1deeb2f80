"""D-decomposition of the (kp, ki) plane: gains for which a dead-time loop has closed-loop poles on the imaginary axis.

The plant is P(s) exp(-tau s). The controller is C(s) = kp A(s) + ki/s + B(s), where A and B contain the filtered
derivative d(s) = s/(derivative_filter s + 1): A = 1 + derivative_time d, B = derivative_gain d. A PI has A = 1, B = 0.
With R(s) = exp(tau s)/P(s) + B(s), the closed loop has a pole at s = j omega if

    R(j omega) + kp A(j omega) + ki/(j omega) = 0.

These are two real equations, linear in the gains: kp = -Re R/Re A, ki = omega (Im R + kp Im A). For all omega > 0 they
give a curve. The curve and the line ki = 0 (a pole at the origin) divide the (kp, ki) plane into cells. In each cell
the number of unstable poles is constant ([Gryazina2008]).

With dead time the curve has infinitely many branches, of which only finitely many can bound a stable cell. The argument
of the characteristic function turns by -tau omega wherever |L| > 1. The n poles and m zeros of the plant, those of the
controller and at most n + 2 gain crossovers can compensate only a finite angle. Hence the loop has unstable poles if

    tau * measure of {omega > 0: |L(j omega)| > 1} >= pi (2 n + m + 7).

With |C| >= |kp| - |B| this inequality bounds kp. With |C| >= ki/omega - |kp A + B| it bounds ki.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np
from flint import arb, ctx, fmpq, fmpq_poly
from numpy.typing import NDArray

from railslip_ctrl.controllers.systems import pi_transfer_function
from railslip_ctrl.core.arguments import Complexes, Flags, Floats
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.loop import Rational
from railslip_ctrl.loop.crossings import Response, bracketed_roots
from railslip_ctrl.loop.rational import Axis, angle_sum, fraction, positive_square_roots, rounded_roots
from railslip_ctrl.loop.stability import RootCount

# Let F and G be polynomials, phi = tau omega + arg F and kappa = Im G/|F|. F(s) exp(tau s) + G(s) is real on
# s = j omega if sin phi = -kappa: phi + asin kappa is an even multiple of pi, or phi - asin kappa an odd one. No grid
# is needed: the frequencies with |kappa| = 1 and the turning points of either angle are roots of polynomials in x =
# omega^2, isolated with certainty. Between two neighbours among these frequencies both angles are monotone, so that
# the angles at both ends give the number of frequencies between them at which the function is real.

_BITS = 128  # precision of the isolated roots, bits
_STEP_OUT = 16.0  # ratio of successive trial frequencies near an end at 0 or infinity
_MOST_STEPS = 250  # largest number of trial ends
_NOTHING = 1e-80  # smaller |kappa|, near omega = 0, is replaced by its limit 0; the angle is then a multiple of pi


def real_frequencies(factor: fmpq_poly, other: fmpq_poly, dead_time: float, highest: float) -> Floats:
    """Return all frequencies omega, rad/s, at which F(s) exp(tau s) + G(s) is real for s = j omega.

    The polynomial F is `factor`, which must not be 0, and G is `other`; tau is `dead_time`, s. Im G(j omega) must not
    change its sign over omega > 0. The search ends at `highest`, rad/s, which may be infinite if tau = 0. Roots of F
    are left out. The result is empty if the function is real at every frequency.
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
    roots = [np.array([])]
    for side in (0, 1):
        # the value is real where the angle is an even (side 0) or odd (side 1) number of half turns, 0 and inf excluded
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

        roots.append(monotone_roots(away, low[at], high[at], np.sign(start - end)[at]))
    return np.unique(np.concatenate(roots))


def parts(edges: Floats, jumps: Floats, highest: float) -> tuple[Floats, Floats]:
    """Divide 0 < omega < `highest`, rad/s, at `edges` and `jumps`; return the ends of the parts, just off the jumps."""
    every = np.union1d(edges, jumps)
    every = every[every < highest]
    jump = np.isin(every, jumps)
    low, high = (np.where(jump, np.nextafter(every, side), every) for side in (np.inf, 0.0))
    return np.append(0.0, low), np.append(high, highest)


def monotone_roots(
    function: Callable[[Floats, NDArray[np.intp]], Floats], low: Floats, high: Floats, side: Floats
) -> Floats:
    """Return one root of each of several functions that are monotone from `low` to `high`.

    `low` may be 0 and `high` infinite. `side` is the sign of each function at `low`; at `high` the sign is opposite.
    """
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
    top = np.where(np.isinf(high), np.maximum(low, 1.0) * _STEP_OUT, high)
    return np.where(low == 0, top / _STEP_OUT, low + 0.5 * (top - low))


class _Angles:
    """Angles phi + asin kappa and phi - asin kappa, with phi = tau omega + arg F and kappa = Im G/|F|."""

    def __init__(self, factor: fmpq_poly, other: fmpq_poly, dead_time: float) -> None:
        self._dead_time = dead_time
        self._axis, self._other = Axis(factor), Axis(other).odd
        self._roots, self._other_roots = rounded_roots(factor), rounded_roots(self._other)
        lead = factor.coeffs()[-1]
        self._turned = float(lead < 0)
        ratio = self._other.coeffs()[-1] / lead if self._other != 0 else fmpq(0)
        self._sign, self._log_lead = (1.0 if ratio * lead > 0 else -1.0), float(arb(abs(ratio)).log().mid())
        self.on_axis = np.unique(self._roots.imag[(self._roots.real == 0) & (self._roots.imag > 0)])

    def ends(self) -> Floats:
        if self._other == 0:
            return np.array([])
        return _frequencies(self._gap)

    @property
    def _gap(self) -> fmpq_poly:
        return self._axis.power - fmpq_poly([0, 1]) * self._other**2

    def turns(self) -> Floats:
        power, g, x = self._axis.power, self._other, fmpq_poly([0, 1])
        speed = fraction(self._dead_time) * power + self._axis.turning
        bend = (g + 2 * x * g.derivative()) * power - x * g * power.derivative()
        return _frequencies((speed**2 * self._gap - bend**2) // power)

    def log_ratio(self, omega: Floats) -> Floats:
        if self._other == 0:
            return np.full(omega.shape, -np.inf)
        with np.errstate(divide="ignore"):
            size = np.log(np.abs(omega[:, None] ** 2 - self._other_roots)).sum(axis=-1) + np.log(omega)
            size -= np.log(np.hypot(self._roots.real, omega[:, None] - self._roots.imag)).sum(axis=-1)
        return np.asarray(size + self._log_lead)

    def half_turns(self, omega: Floats, side: int, ends: Floats | None = None) -> Floats:
        """Return (phi + asin kappa)/pi for `side` 0, (phi - asin kappa)/pi for `side` 1.

        `omega` may be 0 or infinite. `ends` are frequencies at which |kappa| = 1.
        """
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
    with ctx.workprec(_BITS):
        return np.array([float(omega.mid()) for omega, _ in positive_square_roots(polynomial)])


Interval = tuple[float, float]
Intervals = tuple[Interval, ...]

_SAME = 1e-12  # relative distance below which two boundaries are equal; rounding separates them by less


def stable_intervals(
    critical: CriticalGains, scale: float, count: Callable[[float], RootCount], *, signed: bool
) -> Intervals:
    """Return the intervals between critical gains in which no closed-loop pole is unstable.

    `count` counts the unstable poles at a gain, `scale` is a typical gain. If `signed`, gains may be negative.
    """
    limit = critical.complete_to
    edges = [-limit if signed else 0.0, *critical.values.tolist(), limit]
    leftward = np.flatnonzero(critical.leftward) + 1  # as indices into edges: interval i starts at edge i
    found: list[Interval] = []
    i = 0
    while i < len(edges) - 1:
        low, high = edges[i], edges[i + 1]
        if math.isfinite(high - low) and high - low <= _SAME * max(abs(low), abs(high)):
            i += 1
            continue
        inside = count(probe(low, high, scale))
        if inside.stable:
            # stable on both sides: poles touch the axis and return, or the boundary is due to rounding
            if found and found[-1][1] == low and count(low).stable:
                low = found.pop()[0]
            found.append((low, high))
        # the number of unstable poles can fall only at leftward gains, by at most 2 at each
        unknown = inside.marginal or not math.isfinite(inside.right)
        needed = 0 if unknown else max(1, (int(inside.right) + 1) // 2)
        ahead = leftward[leftward > i]
        if needed > ahead.size:
            break
        i = int(ahead[needed - 1]) if needed else i + 1
    return tuple(found)


def probe(low: float, high: float, scale: float) -> float:
    """Return a gain between `low` and `high`, which may be infinite; `scale` is a typical gain."""
    if math.isinf(low) and math.isinf(high):
        return scale
    if math.isinf(low):
        return high - max(abs(high), scale)
    if math.isinf(high):
        return low + max(abs(low), scale)
    return 0.5 * (low + high)


def probes_between(edges: Sequence[float], scale: float) -> list[float]:
    """Return a gain inside each interval between ascending edges."""
    return [probe(low, high, scale) for low, high in pairwise(edges) if high > low]


def common_intervals(families: Sequence[Intervals]) -> Intervals:
    """Return the intersection of sets given as ascending open intervals."""
    common = families[0]
    for other in families[1:]:
        pairs = [(max(a, c), min(b, d)) for a, b in common for c, d in other]
        common = tuple(sorted((low, high) for low, high in pairs if low < high))
    return common


_S = fmpq_poly([0, 1])
_MOST_TURNED = 1e6  # rad, largest phase of the dead time at the highest relevant frequency
_SURELY_FALLING = 1e-9  # relative slope below which rounding may change the direction of a crossing


@dataclass(frozen=True)
class CriticalGains:
    """Values of one gain at which closed-loop poles are on the imaginary axis, ascending.

    As the gain rises, poles may move to the left at the values marked `leftward`; at all other values a pair moves to
    the right. No gain with magnitude above `complete_to` stabilises.
    """

    values: Floats
    leftward: Flags
    complete_to: float

    @classmethod
    def within(cls, low: float, high: float, values: Floats, leftward: Flags) -> CriticalGains:
        """Return the `values` between `low` and `high`, sorted, as critical gains."""
        inside = np.flatnonzero((values > low) & (values < high))
        order = inside[np.argsort(values[inside], kind="stable")]
        return cls(values[order], leftward[order], high)


@dataclass(frozen=True)
class Decomposition:
    """D-decomposition for a plant, a dead time (s), and a fixed derivative part of the controller.

    `derivative_time` and `derivative_filter` are in s, `derivative_gain` is in units of kp times s.
    """

    plant: Rational
    dead_time: float
    derivative_time: float = 0.0
    derivative_gain: float = 0.0
    derivative_filter: float = 0.0

    def controller(self, kp: float, ki: float) -> Rational:
        """Return the controller C(s), without an integrator if ki = 0."""
        return _controller(kp, ki, self.derivative_gain + kp * self.derivative_time, self.derivative_filter)

    def inverse(self, omega: Floats) -> Complexes:
        """Return R(j omega) as in the module docstring, for `omega` > 0, rad/s."""
        delayed = self._delayed(omega)
        return delayed + self.derivative_gain * self._derivative(omega) if self.derivative_gain else delayed

    def _delayed(self, omega: Floats) -> Complexes:
        plant, s = self.plant, 1j * omega[..., None]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            value = np.prod(s - plant.poles, axis=-1) / np.prod(s - plant.zeros, axis=-1)
            return np.asarray(value / plant.gain * np.exp(1j * omega * self.dead_time))

    def proportional(self, omega: Floats) -> Complexes | float:
        """Return A(j omega) as in the module docstring, for `omega`, rad/s."""
        return 1 + self.derivative_time * self._derivative(omega) if self.derivative_time else 1.0

    def slopes(self, omega: Floats) -> tuple[Complexes, Complexes, Floats]:
        """Return dR/d omega, dA/d omega, and the sum of the magnitudes of the terms of R, to scale rounding errors."""
        delayed = self._delayed(omega)
        d_slope = 1j / (1 + 1j * omega * self.derivative_filter) ** 2
        slope = delayed * (1j * self.dead_time - self.plant.log_slope(omega)) + self.derivative_gain * d_slope
        size = np.abs(delayed) + np.abs(self.derivative_gain * self._derivative(omega))
        return np.asarray(slope), np.asarray(self.derivative_time * d_slope), size

    def _derivative(self, omega: Floats) -> Complexes:
        return np.asarray(1j * omega / (1 + 1j * omega * self.derivative_filter))

    def curve(self, omega: Floats) -> tuple[Floats, Floats]:
        """Return kp and ki, arrays of the shape of `omega` (rad/s), that put a pair of poles at +-j omega."""
        inverse, shape = self.inverse(omega), self.proportional(omega)
        kp = -inverse.real / shape.real
        return np.asarray(kp), np.asarray(omega * (inverse.imag + kp * shape.imag))

    def proportional_gains(self) -> CriticalGains:
        """Return all kp for which the loop with ki = 0 has a pole on the imaginary axis or at infinity."""
        den, num, lag, lead = self._polynomials
        # Im (R/A) = 0, times the positive |N A|^2
        turned = _mirrored(num * lead)
        omega = self._real(den * lag * turned, self._fixed * num * turned)
        shape, (slope, shape_slope, size) = self.proportional(omega), self.slopes(omega)
        ratio = self.inverse(omega) / shape
        leftward = _may_rise(omega, ((slope - ratio * shape_slope) / shape).imag, size / np.abs(shape))
        # with kp = 0 the plant's own poles on the axis are closed-loop poles
        fixed = [0.0] * int(np.count_nonzero(self.plant.poles.real == 0))
        dc = self.plant.dc_gain
        if np.isfinite(dc) and dc != 0:
            fixed.append(-1.0 / dc)
        through = self.plant.feedthrough
        if through:  # 1 + L(infinity) = 0: a pole passes through infinity
            fixed.append(-(1 + self.gain_at_infinity(0.0)) / (through * self._ends[0]))
        values, leftward = np.append(-ratio.real, fixed), np.append(leftward, np.ones(len(fixed), dtype=bool))
        return CriticalGains.within(-self.largest_kp, self.largest_kp, values, leftward)

    def integral_gains(self, kp: float) -> CriticalGains:
        """Return all ki > 0 for which the loop with this kp has poles on the imaginary axis."""
        low, high, first, last = self._branches
        at = np.flatnonzero((first < kp) != (last < kp))

        def away(omega: Floats, _: NDArray[np.intp]) -> Floats:
            return self.curve(omega)[0] - kp

        omega = monotone_roots(away, low[at], high[at], np.where(first < last, -1.0, 1.0)[at])
        shape, (slope, shape_slope, size) = self.proportional(omega), self.slopes(omega)
        leftward = _may_rise(omega, slope.real + kp * shape_slope.real, size + abs(kp) * np.abs(shape))
        values = omega * (self.inverse(omega).imag + kp * shape.imag)
        return CriticalGains.within(0.0, self.largest_ki, values, leftward)

    @cached_property
    def turning_points(self) -> Floats:
        """Frequencies, rad/s, at which dkp/d omega = 0 on the curve."""
        # kp = -Re H with H = exp(tau s) a/b + B: Im H' = 0, times the positive |b lag|^4
        a, b, lag = self._rational
        slope = fraction(self.dead_time) * a * b + a.derivative() * b - a * b.derivative()
        turned = _mirrored(b * lag) ** 2
        return self._real(slope * lag**2 * turned, fraction(self.derivative_gain) * b**2 * turned)

    @cached_property
    def _branches(self) -> tuple[Floats, Floats, Floats, Floats]:
        zeros = self.plant.zeros
        poles = np.unique(zeros.imag[(zeros.real == 0) & (zeros.imag > 0)])  # poles of R
        low, high = parts(self.turning_points, poles, self._limit)
        dc, curve = self.plant.dc_gain, self.curve
        first = np.append(-1 / dc if dc else np.inf, curve(low[1:])[0])
        end = self._kp_at_infinity() if self.dead_time == 0 else curve(high[-1:])[0]
        last = np.append(curve(high[:-1])[0], end)
        # the limits at omega = 0 and infinity are excluded
        start = np.where(low == 0, np.nextafter(first, last), first)
        return low, high, start, np.where(np.isinf(high), np.nextafter(last, first), last)

    def _kp_at_infinity(self) -> float:
        a, b, lag = self._rational
        below = Axis(b * lag).power
        above = Axis((a * lag + self._fixed * b) * _mirrored(b * lag)).even
        if above.degree() < below.degree():
            return 0.0
        ratio = -above.coeffs()[-1] / below.coeffs()[-1]
        if above.degree() > below.degree():
            return math.copysign(math.inf, 1 if ratio > 0 else -1)
        return int(ratio.p) / int(ratio.q)

    @property
    def _fixed(self) -> fmpq_poly:
        return fraction(self.derivative_gain) * _S

    @cached_property
    def _polynomials(self) -> tuple[fmpq_poly, fmpq_poly, fmpq_poly, fmpq_poly]:
        lag, lead = fraction(self.derivative_filter), fraction(self.derivative_filter) + fraction(self.derivative_time)
        num, den = self.plant.polynomials
        return den, num, 1 + lag * _S, 1 + lead * _S

    @property
    def _rational(self) -> tuple[fmpq_poly, fmpq_poly, fmpq_poly]:
        den, num, lag, lead = self._polynomials
        if self.derivative_gain:
            return den, num, lag
        # Re A = Re (lead conj(lag))/|lag|^2
        return den * lag * _mirrored(lag), num * _even(lead * _mirrored(lag)), fmpq_poly([1])

    def _real(self, factor: fmpq_poly, other: fmpq_poly) -> Floats:
        return real_frequencies(factor, other, self.dead_time, self._limit)

    @property
    def _ends(self) -> tuple[float, float]:
        lag = self.derivative_filter or 1.0
        return 1 + self.derivative_time / lag, self.derivative_gain / lag

    def gain_at_infinity(self, kp: float) -> float:
        """Return the open loop L at infinite frequency."""
        shape, fixed = self._ends
        return self.plant.feedthrough * (kp * shape + fixed)

    @cached_property
    def largest_kp(self) -> float:
        """Upper bound of |kp| for all stabilising kp and any ki; inf without dead time."""
        if self.dead_time == 0 or self.plant.gain == 0:
            return np.inf
        return self._unstable_from(self.plant, lambda kp: kp, lambda _: np.inf) + abs(self._ends[1])

    @property
    def _largest_proportional(self) -> float:
        shape, fixed = self._ends
        return self.largest_kp * shape + abs(fixed)

    @cached_property
    def largest_ki(self) -> float:
        """Upper bound of all stabilising ki for any kp; inf without dead time."""
        if self.dead_time == 0 or self.plant.gain == 0:
            return np.inf
        if self.derivative_filter == 0:
            return self._unstable_from(self._integrated, lambda ki: ki, lambda _: np.inf)
        # if ki/omega is at least twice the rest of C, |C| is at least half of it
        rest = 2 * self._largest_proportional
        return self._unstable_from(self._integrated, lambda ki: ki / 2, lambda ki: ki / rest)

    def _unstable_from(
        self, system: Rational, factor: Callable[[float], float], highest: Callable[[float], float]
    ) -> float:
        """Return a gain at and above which the loop is unstable, by the inequality of the module docstring.

        With a gain k, |L| is at least factor(k) times |system| up to the frequency highest(k), rad/s.
        """
        needed = np.pi * (2 * self.plant.poles.size + self.plant.zeros.size + 7) / self.dead_time
        size = system.log_size(np.linspace(0.0, 1.5 * needed, 301)[1:])
        gain = float(np.exp(-np.quantile(size, 0.25)))
        while self._width_above_one(system * factor(gain), highest(gain)) < needed:
            gain *= 2
        return gain

    def _width_above_one(self, system: Rational, highest: float) -> float:
        ends = np.minimum(np.append(0.0, Response(system, 0.0).gain_crossovers), highest)
        inside = system.log_size(0.5 * (ends[:-1] + ends[1:])) > 0
        return float(np.sum(np.diff(ends)[inside]))

    @property
    def _integrated(self) -> Rational:
        return self.plant * Rational(np.array([]), np.array([0.0]), 1.0)

    @staticmethod
    def _last_crossover(system: Rational) -> float:
        return float(np.max(Response(system, 0.0).gain_crossovers, initial=0.0))

    @cached_property
    def _limit(self) -> float:
        """Frequency, rad/s, above which no kp and ki within their bounds put a pole on the imaginary axis."""
        if self.dead_time == 0:
            return np.inf
        if self.plant.gain == 0:
            return 0.0
        # poles on the axis need |P| (|kp A + B| + ki/omega) >= 1, so that one of the two terms is >= 1/2
        limit = max(
            self._last_crossover(self.plant * (2 * self._largest_proportional)),
            self._last_crossover(self._integrated * (2 * self.largest_ki)),
        )
        turned = limit * self.dead_time
        if turned > _MOST_TURNED:
            raise InputError(
                f"plant: the gain falls too slowly: the crossover may be at {limit:.3g} rad/s, where the dead time "
                f"{self.dead_time:g} s has a phase of {turned:.3g} rad, more than {_MOST_TURNED:g}; add the actuator's "
                "lag"
            )
        return limit


def _mirrored(polynomial: fmpq_poly) -> fmpq_poly:
    return polynomial(-_S)


def _even(polynomial: fmpq_poly) -> fmpq_poly:
    return (polynomial + _mirrored(polynomial)) / 2


def _may_rise(omega: Floats, slope: Floats, size: Floats) -> Flags:
    """Return True at frequencies where `slope` may be >= 0; `size` scales the rounding errors."""
    # Re ds/dk of a pole s = j omega has the opposite sign of the slope: where it may rise, poles may move to the left
    return np.asarray(slope * omega > -_SURELY_FALLING * size)


@lru_cache(maxsize=16)  # the plants of a family use the same gains one after another
def _controller(kp: float, ki: float, derivative: float, lag: float) -> Rational:
    if derivative == 0:
        return pi_transfer_function(kp, ki)
    order = 3 if ki else 2  # without an integrator if ki = 0
    return Rational.from_polynomials([kp * lag + derivative, kp + ki * lag, ki][:order], [lag, 1.0, 0.0][:order])
