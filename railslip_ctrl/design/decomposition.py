"""D-decomposition of the (kp, ki) plane: where closed-loop poles of a dead-time loop can reach the axis.

The controller is C(s) = kp A(s) + ki/s + B(s) with d(s) = s/(derivative_filter s + 1), A = 1 + derivative_time d
and B = derivative_gain d; a PI has A = 1, B = 0. With R(s) = exp(tau s)/P(s) + B(s) a pole at s = j omega means

    R(j omega) + kp A(j omega) + ki/(j omega) = 0,

two real equations, linear in the gains: kp = -Re R/Re A, ki = omega (Im R + kp Im A). Together with the line
ki = 0 (a pole at the origin) this curve divides the plane into cells of constant root count ([Gryazina2008]).

With dead time the curve has infinitely many branches. Where they cease to matter is bounded, not guessed: the
argument of the characteristic function (`loop.stability`) is made of the angles of the n poles and m zeros of
the plant and two each of the controller, each turning by at most pi, of a principal value that moves by at most
pi between gain crossovers, of which there are at most n + 2, and of -tau omega wherever |L| > 1. So

    tau * measure of {omega > 0: |L(j omega)| > 1} >= pi (2 n + m + 7)

leaves unstable poles. As |C| >= |kp| - |B| and |C| >= ki/omega - |Im (kp A + B)|, this bounds both gains.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np

from railslip_ctrl.errors import InputError
from railslip_ctrl.loop import Rational
from railslip_ctrl.loop.crossings import Response, frequency_nodes, gain_crossovers
from railslip_ctrl.loop.rational import polynomial_roots
from railslip_ctrl.loop.rootfinding import bracketed_roots

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]
    Sampled = tuple[Floats, Floats, Floats]  # value, slope, rounding error of the value

_PHASE_STEP = 0.25  # rad of dead time between nodes
_MORE_DECADES = 4  # beyond the plant's own: where the real or imaginary part alone vanishes may lie far off
_MORE_PER_DECADE = 8
_MOST_NODES = 4_000_000
_ROUNDING = 2.3e-16
_SURELY_FALLING = 1e-9  # relative slope below which a crossing is taken for one of unknown direction


@dataclass(frozen=True)
class CriticalGains:
    """Values of one gain at which poles are on the axis, ascending, and where they are, +-j omega, rad/s.

    No gain larger in size than `complete_to` stabilises; inf without dead time. `leftward` marks those at which
    the growing gain may take poles to the left: all others take a pair of them to the right.
    """

    values: Floats
    omega: Floats
    leftward: NDArray[np.bool_]
    complete_to: float

    @classmethod
    def within(
        cls, low: float, high: float, values: Floats, omega: Floats, leftward: NDArray[np.bool_]
    ) -> CriticalGains:
        """Those between two bounds, sorted."""
        kept = np.flatnonzero((values > low) & (values < high))
        order = kept[np.argsort(values[kept], kind="stable")]
        return cls(values[order], omega[order], leftward[order], high)


@dataclass(frozen=True)
class Decomposition:
    """A plant, its dead time (s) and the fixed derivative part of the controller (see the module's text).

    `derivative_time` s, `derivative_gain` in units of kp times s, `derivative_filter` s.
    """

    plant: Rational
    dead_time: float
    derivative_time: float = 0.0
    derivative_gain: float = 0.0
    derivative_filter: float = 0.0

    def controller(self, kp: float, ki: float) -> Rational:
        """C(s) in factored form; with ki = 0 it has no integrator."""
        return _controller(kp, ki, self.derivative_gain + kp * self.derivative_time, self.derivative_filter)

    # -- the boundary curve -------------------------------------------------------------------------------

    def inverse(self, omega: Floats) -> tuple[Complexes, Complexes, Floats]:
        """R(j omega), dR/d omega and the sum of the sizes of its terms; omega > 0 in rad/s."""
        plant, s = self.plant, 1j * omega[..., None]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            value = np.prod(s - plant.poles, axis=-1) / np.prod(s - plant.zeros, axis=-1) / plant.gain
            value = value * np.exp(1j * omega * self.dead_time)
            slope = value * (1j * self.dead_time - plant.log_slope(omega))
            d, d_slope = self._derivative(omega)
            size = np.abs(value) + abs(self.derivative_gain) * np.abs(d)
        return value + self.derivative_gain * d, slope + self.derivative_gain * d_slope, size

    def proportional(self, omega: Floats) -> tuple[Complexes, Complexes]:
        """A(j omega) and dA/d omega."""
        d, d_slope = self._derivative(omega)
        return 1 + self.derivative_time * d, self.derivative_time * d_slope

    def _derivative(self, omega: Floats) -> tuple[Complexes, Complexes]:
        filtered = 1 + 1j * omega * self.derivative_filter
        return np.asarray(1j * omega / filtered), np.asarray(1j / filtered**2)

    def curve(self, omega: Floats) -> tuple[Floats, Floats]:
        """(kp, ki) that put a pair of poles at +-j omega; shapes of `omega`, rad/s."""
        inverse, _slope, _size = self.inverse(omega)
        shape, _ = self.proportional(omega)
        kp = -inverse.real / shape.real
        return np.asarray(kp), np.asarray(omega * (inverse.imag + kp * shape.imag))

    # -- critical gains -----------------------------------------------------------------------------------

    def proportional_gains(self) -> CriticalGains:
        """All kp at which the loop without integral action has a pole on the axis; origin and infinity included."""

        def imaginary_part(omega: Floats, _: NDArray[np.intp]) -> Sampled:
            inverse, slope, size = self.inverse(omega)
            shape, shape_slope = self.proportional(omega)
            with np.errstate(invalid="ignore"):
                ratio = inverse / shape
                return ratio.imag, ((slope - ratio * shape_slope) / shape).imag, size / np.abs(shape)

        omega, leftward = self._roots(imaginary_part, self._nodes)
        on_curve = -(self.inverse(omega)[0] / self.proportional(omega)[0]).real
        # kp = 0 leaves the plant's own poles on the axis, as many as there are
        fixed = [0.0] * int(np.count_nonzero(self.plant.poles.real == 0))
        dc = self.plant.dc_gain
        if np.isfinite(dc) and dc != 0:
            fixed.append(-1.0 / dc)
        at_infinity = self._gain_at_infinity()
        values = np.concatenate([on_curve, fixed, at_infinity])
        omega = np.concatenate([omega, np.zeros(len(fixed)), np.full(at_infinity.size, np.inf)])
        leftward = np.append(leftward, np.ones(omega.size - leftward.size, dtype=bool))
        return CriticalGains.within(-self.largest_kp, self.largest_kp, values, omega, leftward)

    def integral_gains(self, kp: float) -> CriticalGains:
        """All ki > 0 at which the loop with this kp, at most `largest_kp` in size, has a pair of poles on the axis."""

        def real_part(omega: Floats, _: NDArray[np.intp]) -> Sampled:
            inverse, slope, size = self.inverse(omega)
            shape, shape_slope = self.proportional(omega)
            return (
                inverse.real + kp * shape.real,
                slope.real + kp * shape_slope.real,
                size + abs(kp) * np.abs(shape),
            )

        nodes = self._nodes if self.dead_time > 0 else self._make_nodes(kp, np.inf)
        omega, leftward = self._roots(real_part, nodes)
        inverse, shape = self.inverse(omega)[0], self.proportional(omega)[0]
        values = omega * (inverse.imag + kp * shape.imag)
        return CriticalGains.within(0.0, self.largest_ki, values, omega, leftward)

    def turning_points(self) -> Floats:
        """Frequencies, rad/s, at which kp(omega) turns back: there ki intervals appear or vanish."""
        nodes = self._nodes
        step = np.sign(np.diff(self.curve(nodes)[0]))
        over_pole = self._over_pole(nodes)
        at = np.flatnonzero((step[:-1] * step[1:] < 0) & ~over_pole[:-1] & ~over_pole[1:])

        def slope(omega: Floats, _: NDArray[np.intp]) -> Floats:
            inverse, inverse_slope, _size = self.inverse(omega)
            shape, shape_slope = self.proportional(omega)
            return np.asarray(inverse_slope.real * shape.real - inverse.real * shape_slope.real)

        return bracketed_roots(slope, nodes[at], nodes[at + 2])

    # -- how far to look ----------------------------------------------------------------------------------

    def _largest_shape(self) -> float:
        """Largest |A| on the axis."""
        return 1 + self.derivative_time / self.derivative_filter if self.derivative_time else 1.0

    def _largest_fixed(self) -> float:
        """Largest |B| on the axis."""
        return abs(self.derivative_gain) / self.derivative_filter if self.derivative_gain else 0.0

    def gain_at_infinity(self, kp: float) -> float:
        """L(infinity), not 0 only for a plant with as many zeros as poles."""
        fixed = self.derivative_gain / self.derivative_filter if self.derivative_gain else 0.0
        return self.plant.feedthrough * (kp * self._largest_shape() + fixed)

    def _gain_at_infinity(self) -> Floats:
        """kp at which 1 + L(infinity) = 0: a pole passes through infinity."""
        through = self.plant.feedthrough
        if through == 0:
            return np.array([])
        return np.array([-(1 + self.gain_at_infinity(0.0)) / (through * self._largest_shape())])

    @cached_property
    def largest_kp(self) -> float:
        """Every kp that stabilises, whatever ki, is smaller in size; inf without dead time."""
        if self.dead_time == 0 or self.plant.gain == 0:
            return np.inf
        return self._unstable_from(self.plant, lambda kp: kp, lambda _: np.inf) + self._largest_fixed()

    @cached_property
    def largest_ki(self) -> float:
        """No ki beyond this stabilises, whatever kp; inf without dead time."""
        if self.dead_time == 0 or self.plant.gain == 0:
            return np.inf
        integrated = Rational(self.plant.zeros, np.append(self.plant.poles, 0.0), self.plant.gain)
        if self.derivative_filter == 0:
            return self._unstable_from(integrated, lambda ki: ki, lambda _: np.inf)
        # |Im j omega/(1 + j omega Tf)| <= 1/(2 Tf); where ki/omega is twice that much, half of it remains
        other = (self.largest_kp * self.derivative_time + abs(self.derivative_gain)) / (2 * self.derivative_filter)
        return self._unstable_from(integrated, lambda ki: ki / 2, lambda ki: ki / (2 * other) if other else np.inf)

    def _unstable_from(
        self, system: Rational, factor: Callable[[float], float], highest: Callable[[float], float]
    ) -> float:
        """A gain k that satisfies the module's inequality, |L| being at least |system| factor(k) up to highest(k)."""
        needed = np.pi * (2 * self.plant.poles.size + self.plant.zeros.size + 7) / self.dead_time
        size, _ = system.log_magnitude(np.linspace(0.0, 1.5 * needed, 301)[1:])
        gain = float(np.exp(-np.quantile(size, 0.25)))
        while self._width_above_one(system * factor(gain), highest(gain)) < needed:
            gain *= 2
        return gain

    def _width_above_one(self, system: Rational, highest: float) -> float:
        """Measure of the frequencies 0 < omega < highest with |system| > 1, rad/s; `system` strictly proper."""
        response = Response(system, 0.0)
        crossovers = gain_crossovers(response)
        ends = np.minimum(np.concatenate([[0.0], crossovers]), highest)
        inside = response.log_size(0.5 * (ends[:-1] + ends[1:])) > 0
        return float(np.sum(np.diff(ends)[inside]))

    def _last_crossover(self, system: Rational) -> float:
        """Frequency beyond which |system| < 1, rad/s; 0 if it always is."""
        response = Response(system, 0.0)
        return float(np.max(gain_crossovers(response), initial=0.0))

    @cached_property
    def _nodes(self) -> Floats:
        """Frequencies, rad/s, that separate the critical ones, up to where none is left within the largest gains."""
        if self.dead_time == 0 or self.plant.gain == 0:
            return self._make_nodes(1.0, np.inf)
        integrated = Rational(self.plant.zeros, np.append(self.plant.poles, 0.0), self.plant.gain)
        # poles on the axis need |P| (|kp A + B| + ki/omega) >= 1, so that one of the two terms is at least half
        proportional = self.largest_kp * self._largest_shape() + self._largest_fixed()
        limit = max(
            self._last_crossover(self.plant * (2 * proportional)),
            self._last_crossover(integrated * (2 * self.largest_ki)),
        )
        turns = limit * self.dead_time / _PHASE_STEP
        if turns > _MOST_NODES:
            raise InputError(
                f"plant: its gain stays level up to {limit:.3g} rad/s, over which the dead time of {self.dead_time:g} "
                f"s turns {turns * _PHASE_STEP:.3g} rad: too many stability boundaries; add the actuator's lag"
            )
        return self._make_nodes(1.0, limit)

    def _make_nodes(self, gain: float, limit: float) -> Floats:
        nodes = frequency_nodes(Response(self.plant * (gain or 1.0), self.dead_time))
        count = _MORE_DECADES * _MORE_PER_DECADE
        low, high = float(nodes[0]), float(nodes[-1])
        parts = [nodes, np.geomspace(low * 10.0**-_MORE_DECADES, low, count, endpoint=False)]
        if self.derivative_filter:
            corner = 1 / self.derivative_filter
            parts.append(np.geomspace(1e-3 * corner, 1e3 * corner, 96))
        if np.isinf(limit):
            parts.append(np.geomspace(high, high * 10.0**_MORE_DECADES, count))
            return np.unique(np.concatenate(parts))
        turns = np.arange(1, int(limit * self.dead_time / _PHASE_STEP) + 1)
        found = np.unique(np.concatenate([*parts, turns * (_PHASE_STEP / self.dead_time), [limit]]))
        return found[found <= limit]

    def _over_pole(self, points: Floats) -> NDArray[np.bool_]:
        """Which intervals between points hold a pole of R, a zero of the plant on the axis."""
        poles = np.sort(self.plant.zeros.imag[(self.plant.zeros.real == 0) & (self.plant.zeros.imag > 0)])
        return np.asarray(np.searchsorted(poles, points[1:]) > np.searchsorted(poles, points[:-1]))

    def _roots(
        self, function: Callable[[Floats, NDArray[np.intp]], Sampled], nodes: Floats
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """Zeros of a function of omega over the nodes, extrema between them looked at, poles of R left out; and
        whether it rises there.

        With F(s, k) the left side of the module's equation, a pole on the axis moves by ds = -dk (dF/dk)/(dF/ds),
        of which the real part has the sign of -d/d omega of Im (R/A) for k = kp, of Re (R + kp A) for k = ki.
        """
        side, rise = (np.sign(q) for q in function(nodes, np.zeros(nodes.size, dtype=np.intp))[:2])
        # only an extremum on the way to zero can hide a pair of zeros
        towards = (rise[:-1] * rise[1:] < 0) & (side[:-1] * rise[:-1] < 0)
        at = np.flatnonzero(towards & (side[:-1] * side[1:] > 0))
        extrema = bracketed_roots(lambda w, i: function(w, i)[1], nodes[at], nodes[at + 1])
        points = np.union1d(nodes, extrema)
        value, _, size = function(points, np.zeros(points.size, dtype=np.intp))
        # a value that is all rounding has no sign (the real part of 1/s is zero everywhere)
        terms = 8 + self.plant.poles.size + self.plant.zeros.size
        sure = np.abs(value) > _ROUNDING * (terms + points * self.dead_time) * size
        points, value = points[sure], value[sure]
        at = np.flatnonzero((np.sign(value[:-1]) != np.sign(value[1:])) & ~self._over_pole(points))
        found = bracketed_roots(lambda w, i: function(w, i)[0], points[at], points[at + 1])
        _, slope, size = function(found, at)
        return found, np.asarray(slope * found > -_SURELY_FALLING * size)


@lru_cache(maxsize=16)  # the plants of a family are asked about the same gains one after another
def _controller(kp: float, ki: float, derivative: float, lag: float) -> Rational:
    """kp + ki/s + derivative s/(lag s + 1)."""
    poles = [] if lag == 0 else [-1 / lag]
    numerator = [kp * lag + derivative, kp] if ki == 0 else [kp * lag + derivative, kp + ki * lag, ki]
    if ki != 0:
        poles = [0.0, *poles]
    coefficients = np.trim_zeros(np.array(numerator), "f")
    if coefficients.size == 0:
        return Rational(np.array([]), np.array(poles), 0.0)
    return Rational(_real_roots_first(coefficients), np.array(poles), float(coefficients[0]) / (lag or 1.0))


def _real_roots_first(coefficients: Floats) -> Complexes:
    """Roots of a polynomial of degree 0 to 2, real ones without cancellation."""
    if coefficients.size < 3:
        return polynomial_roots(coefficients)
    a, b, c = coefficients.tolist()
    discriminant = b * b - 4 * a * c
    if discriminant < 0:
        root = complex(-b / (2 * a), np.sqrt(-discriminant) / (2 * a))
        return np.array([root, root.conjugate()])
    half = -(b + np.copysign(np.sqrt(discriminant), b)) / 2
    return np.array([half / a, c / half], dtype=np.complex128)
