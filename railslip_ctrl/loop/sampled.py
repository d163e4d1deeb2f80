"""Exact loop of a discrete controller, zero-order hold, dead time and continuous plant: `SampledLoop`.

Between samples the command u is constant. At the samples the plant is therefore exactly a difference equation, also for
a dead time that is not a multiple of the period h ([Astrom1997] 2):

    x[k+1] = Phi x[k] + Gamma0 u[k-d] + Gamma1 u[k-d-1],    y[k] = C x[k],    dead time = (d + fraction) h

d is an integer, and the fraction is from 0 to 1. The difference equations of plant and controller form the closed loop,
which is stable if and only if all eigenvalues of its state matrix lie inside the unit circle.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from railslip_ctrl.core.arguments import Complexes, Flags, Floats, checked, complexes, number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass

from .bounded import ROUNDING, BoundedLoop, Expansion
from .crossings import Response
from .deadtime import Loop
from .rational import Rational, realise
from .responses import TimeResponse, given_times, pieces_at
from .stability import RootCount

# Largest dead time in periods: each period is one state, and the eigenvalues then take a few seconds.
MOST_PERIODS = 500
MOST_SAMPLES = 200_000  # samples of a step response: a second or two of computing
# Lowest frequency relative to the slowest pole or zero. Below it L is at its asymptote, and a crossover is due to
# rounding of |L(0)| = 1.
_BELOW_FEATURES = 1e-5
_CELL_RATIO = 1.5  # ratio of neighbouring frequencies in the first division of the axis
# Weight of the phase relative to ln|L| in the choice of the side of a box to halve: ln|L| excludes a root in the box
# for every number of turns, the phase for one number only.
_OF_PHASE = 0.01
_AT_ONCE = 64  # boxes examined together, those with the least dead time
_MOST_BOXES = 20_000  # boxes examined, some seconds; a loop that needs more has |L| = 1 nearly everywhere
_TURNS_TRIED = 50  # numbers of turns (whole periods of dead time) tried for a box in one pass
_SHARP = 1.5e-12  # deviation of ln L from linear that may be rounding
_TINY = 1e-9  # relative size at which an undecided box is taken for a root: two poles touch the circle there, or nearly
_SAME = 1e-9  # distance of two roots, relative to the margin, below which they are regarded as one root


@dataclass(frozen=True)
class HeldPlant:
    """Sampled plant x[k+1] = (1 + growth) x[k] + gamma0 u[k-periods] + gamma1 u[k-periods-1], y[k] = c x[k].

    - periods, fraction: dead time in sampling periods, as the sum of an integer and a fraction.
    - a, b: the continuous plant x' = a x + b u, with time in sampling periods.
    """

    growth: Floats
    gamma0: Floats
    gamma1: Floats
    c: Floats
    periods: int
    fraction: float
    a: Floats
    b: Floats

    @property
    def chain(self) -> int:
        """Number of past commands that the difference equation needs as states."""
        return self.periods + (1 if np.any(self.gamma1) else 0)

    def flow(self, lengths: Floats) -> Floats:
        """Matrices that map [states; command] to their values after each of the times `lengths`, (n,).

        The command is constant; `lengths` are in sampling periods; the shape is (n, order + 1, order + 1).
        """
        from scipy.linalg import expm

        driven = np.zeros((self.c.size + 1,) * 2)
        driven[:-1, :-1], driven[:-1, -1] = self.a, self.b
        return np.asarray(expm(driven * lengths[:, None, None]))


@dataclass(frozen=True, init=False, repr=False)
class SampledLoop(BoundedLoop):
    """The loop of a discrete controller C and a sampled continuous plant P, with unity negative feedback.

    - controller: C; python-control or scipy.signal system with sampling period `period`, `Rational` in z, or a real
      number; proper. The command is u = C (reference - y) at the samples.
    - plant: P without dead time; python-control or scipy.signal system, or `Rational` in s; continuous-time, strictly
      proper.
    - dead_time: s, >= 0, between the controller output and the plant: computation time plus dead time of the actuator.
    - period: sampling period h, s, > 0.

    InputError: a system of another kind, a plant that is not strictly proper, or a dead time or period out of range.
    """

    controller: Rational
    plant: Rational
    dead_time: float
    period: float

    def __init__(self, controller: Any, plant: Any, dead_time: float, period: float) -> None:
        period, dead_time = check_period(period), number("dead time", dead_time, "s", ge=0)
        c = Rational.from_control(controller, "controller", period=period)
        p = Rational.from_control(plant, "plant")
        if p.relative_degree < 1:
            raise InputError(
                f"sampled plant: {p.zeros.size} zeros and {p.poles.size} poles are not strictly proper; "
                "add the actuator's lag"
            )
        if c.gain == 0:
            raise InputError("controller: a gain of 0 does not close the loop; give a gain other than 0")
        given = {"controller": c, "plant": p, "dead_time": dead_time, "period": period, "_dt": period}
        for name, value in given.items():
            object.__setattr__(self, name, value)

    @property
    def nyquist_frequency(self) -> float:
        """Nyquist frequency pi/h, rad/s, the highest frequency of the response."""
        return math.pi / self.period

    def __repr__(self) -> str:
        order = self.controller.poles.size + self.plant.poles.size
        return f"SampledLoop(order {order}, {self.dead_time:g} s, period {self.period:g} s)"

    def scaled(self, factor: float) -> SampledLoop:
        return SampledLoop(self.controller * number("gain factor", factor), self.plant, self.dead_time, self.period)

    def __mul__(self, other: Any) -> SampledLoop:
        if isinstance(other, Loop):
            raise InputError("factor: a sampled loop cannot be multiplied by a loop; multiply its controller instead")
        factor = Rational.from_control(other, "factor", period=self.period)
        return SampledLoop(factor * self.controller, self.plant, self.dead_time, self.period)

    def delayed(self, extra: float) -> SampledLoop:
        """The loop with the dead time increased by `extra`, s, which need not be a multiple of the period."""
        return SampledLoop(self.controller, self.plant, self.dead_time + extra, self.period)

    # -- stability ----------------------------------------------------------------------------------------

    @cached_property
    def closed_loop_matrix(self) -> Floats:
        """Matrix that gives the states of the closed loop at the next sample, for reference 0.

        The states are those of the plant, the past commands (latest first), and those of the controller. InputError:
        the dead time exceeds 500 periods.
        """
        if self.dead_time > MOST_PERIODS * self.period:
            raise InputError(
                f"period: {self.period:g} s is not allowed with {self.dead_time:g} s of dead time; give a value >= "
                f"{self.dead_time / MOST_PERIODS:.3g} (s), or use the continuous loop"
            )
        held, k = self.held_plant, realise(self.controller)
        n, chain = held.c.size, held.chain
        matrix = np.zeros((n + chain + k.order,) * 2)
        of_x, of_k = slice(0, n), slice(n + chain, None)
        command = np.zeros(matrix.shape[0])
        command[of_x], command[of_k] = -k.d * held.c, k.c
        matrix[of_x, of_x] = held.growth + np.eye(n)
        for gamma, age in ((held.gamma0, held.periods), (held.gamma1, held.periods + 1)):
            if age == 0:
                matrix[of_x] += np.outer(gamma, command)
            elif age <= chain:
                matrix[of_x, n + age - 1] += gamma
        if chain:
            matrix[n] = command
            matrix[n + 1 : n + chain, n : n + chain - 1] = np.eye(chain - 1)
        matrix[of_k, of_x] = -np.outer(k.b, held.c)
        matrix[of_k, of_k] = k.a
        return matrix

    @cached_property
    def _closed_loop_poles(self) -> Complexes:
        poles = np.linalg.eigvals(self.closed_loop_matrix).astype(np.complex128)
        return np.asarray(poles[np.argsort(-np.abs(poles))])

    @checked
    def closed_loop_poles(self, count: int = 6) -> Complexes:
        """The `count` closed-loop poles in z with the largest magnitude, largest first."""
        return self._closed_loop_poles[: int(number("count", count, ge=1))]

    @cached_property
    def root_count(self) -> RootCount:
        """Number of closed-loop poles on or outside the unit circle, from eigenvalues in double precision."""
        sizes = np.abs(self._closed_loop_poles)
        return RootCount(float(np.count_nonzero(sizes >= 1)), bool(np.any(sizes == 1)))

    @property
    def open_loop_unstable_poles(self) -> int:
        return int(np.count_nonzero(np.abs(self.controller.poles) > 1) + np.count_nonzero(self.plant.poles.real > 0))

    @property
    def integrators(self) -> int:
        return int(np.count_nonzero(self.controller.poles == 1) + np.count_nonzero(self.plant.poles == 0))

    def poles(self) -> Complexes:
        """Poles of L in z; the poles at z = 0 are due to the dead time."""
        plant = np.exp(self.plant.poles * self.period)
        return np.concatenate([self.controller.poles, plant, np.zeros(self.held_plant.chain)])

    # -- responses ----------------------------------------------------------------------------------------

    def __call__(self, z: ArrayLike) -> Complexes:
        """L(z) at complex z, of the same shape; `loop.response(omega)` is the frequency response.

        At z = 1 the value is inf + 0j if the loop has an integrator. At z = 0 the value is NaN.
        """
        z = complexes("z", z)
        at_pole = (z == 1) & (self.integrators > 0)
        elsewhere = np.where(at_pole, 2.0, z)
        with np.errstate(all="ignore"):
            value = self.controller(elsewhere) * self._plant_response(elsewhere, elsewhere - 1)[0]
        return np.asarray(np.where(at_pole, np.inf, value))

    def feature_band(self) -> tuple[float, float]:
        low = np.concatenate([self.feature_frequencies, self.gain_crossovers, [self.nyquist_frequency]]).min()
        return float(low / 10), self.nyquist_frequency

    def step_response(self, time: ArrayLike) -> TimeResponse:
        """Exact response of the closed loop, also between samples, to a unit step of the reference at t = 0.

        The sample at t = 0 already contains the step. `control` is constant between samples; `control_rate` is 0.

        - time: array, shape (n,), s, >= 0, ascending; or a float, s, > 0, the end of 1001 equally spaced times from 0.
        """
        times = given_times(*((None, time) if np.ndim(time) == 0 else (time, None)))
        at, inside = pieces_at(times, self.period)
        states, commands = self._run(int(at[-1]) + 1)
        held, age = self.held_plant, at + 1  # `age`: index of the present command in `commands`
        parts = np.stack([np.minimum(inside, held.fraction), np.maximum(inside - held.fraction, 0)])
        x = states[at]
        for length, delay in zip(parts, (held.periods + 1, held.periods), strict=True):
            command = commands[np.maximum(age - delay, 0)]
            with np.errstate(over="ignore", invalid="ignore"):
                x = (held.flow(length) @ np.concatenate([x, command[:, None]], axis=1)[..., None])[:, :-1, 0]
        with np.errstate(over="ignore", invalid="ignore"):
            output, control = x @ held.c, commands[age]
        acting = commands[np.maximum(pieces_at(times - self.dead_time, self.period)[0] + 1, 0)]
        if not np.isfinite(output).all():
            raise InputError(
                f"time: {times[-1]:g} s is not allowed; the response overflows before this time; give a shorter time"
            )
        return TimeResponse(
            times, output, control, acting, 1 - output, np.zeros_like(output), self.dead_time, 1.0, 0.0, 0.0
        )

    def _run(self, count: int) -> tuple[Floats, Floats]:
        # unit step response: plant states at the samples, and commands, the first of which is 0, for t < 0
        if count > MOST_SAMPLES:
            raise InputError(
                f"time: {count} samples are not allowed; give a time <= {MOST_SAMPLES * self.period:.3g} s"
            )
        held, k = self.held_plant, realise(self.controller)
        states, commands = np.zeros((count, held.c.size)), np.zeros(count + 1)
        inner = np.zeros(k.order)
        with np.errstate(over="ignore", invalid="ignore"):
            for i in range(count):
                error = 1 - held.c @ states[i]
                commands[i + 1] = k.c @ inner + k.d * error
                inner = k.a @ inner + k.b * error
                if i + 1 < count:
                    now, before = (commands[max(i + 1 - age, 0)] for age in (held.periods, held.periods + 1))
                    states[i + 1] = states[i] + held.growth @ states[i] + held.gamma0 * now + held.gamma1 * before
        return states, commands

    # -- response and bounds ------------------------------------------------------------------------------

    def response_and_slope(self, omega: Floats) -> tuple[Complexes, Complexes]:
        z = np.exp(1j * omega * self.period)
        # z - 1 is computed separately: with a short period every feature of the plant is next to z = 1
        plant, plant_slope = self._plant_response(z, np.expm1(1j * omega * self.period))
        k = self.controller
        slope = (1 / (z[..., None] - k.zeros)).sum(axis=-1) - (1 / (z[..., None] - k.poles)).sum(axis=-1) + plant_slope
        return np.asarray(k(z) * plant), np.asarray(1j * self.period * z * slope)

    @cached_property
    def _boxed(self) -> BoxedResponse:
        return BoxedResponse(self)

    def _edges(self) -> Floats:
        return self._boxed.first_edges() / self.period

    def _expand(self, omega: Floats) -> Expansion:
        h, turns = self.period, self.held_plant.periods + 1
        box = self._boxed.expand(omega * h, np.full(omega.size, self.held_plant.fraction))
        value, slope = box.value - 1j * turns * omega * h, h * (box.slope - 1j * turns)
        return Expansion(value, slope, lambda half: (*box.bounds(half * h)[1:], box.bounds(2 * half * h)[1]))

    def _first_phase(self, omega: Floats) -> Floats:
        # at low frequency z - 1 is j omega h
        parts = (self.plant, omega), (self.controller.shifted(1.0), omega * self.period)
        phases = [Response(system, 0.0).phase(at)[0] for system, at in parts]
        return phases[0] + phases[1]

    def _added_delay(self) -> tuple[float, float]:
        # a crossover does not give the delay margin, because added dead time also changes the pulse response
        return added_delay(self)

    def _gain_limits(self, nodes: Floats, response: Complexes) -> list[tuple[float, float]]:
        end = float(response[-1].real)  # L is real at pi/h
        sided = np.append(response[:-1], end)
        return super()._gain_limits(nodes, sided) + ([(-1 / end, float(nodes[-1]))] if end < 0 else [])

    def _unstable_description(self) -> tuple[str, str]:
        count = int(self.root_count.right)
        poles = f"{count} pole{'' if count == 1 else 's'} on or outside the unit circle"
        return f"sampled loop (period {self.period:g} s)", poles

    @cached_property
    def dc_gain(self) -> float:
        if np.any(self.plant.poles == 0) or np.any(self.controller.poles == 1):
            return math.inf
        plant, _ = self._plant_response(np.array([1.0 + 0j]), np.array([0j]))
        return float((self.controller(1.0) * plant[0]).real)

    @cached_property
    def feature_frequencies(self) -> Floats:
        """Magnitudes > 0 of the poles and zeros of plant and controller, rad/s.

        The magnitude for a pole or zero z of the controller is |ln(z)|/h, with the sampling period h.
        """
        in_z = np.concatenate([self.controller.zeros, self.controller.poles])
        sizes = [self.plant.zeros, self.plant.poles, np.log(in_z[in_z != 0]) / self.period]
        found = np.abs(np.concatenate(sizes))
        return np.asarray(found[found > 0])

    def _plant_response(self, z: Complexes, beyond_one: Complexes) -> tuple[Complexes, Complexes]:
        """Pulse transfer function P of hold, plant and dead time at z, and d ln P/dz."""
        held = self.held_plant
        # `beyond_one` is z - 1, given separately because the difference loses digits near z = 1
        resolvent = beyond_one[..., None, None] * np.eye(held.c.size) - held.growth
        driven = held.gamma0 + held.gamma1 / z[..., None]
        state = np.linalg.solve(resolvent, driven[..., None])[..., 0]
        state_slope = np.linalg.solve(resolvent, (-held.gamma1 / z[..., None] ** 2 - state)[..., None])[..., 0]
        value = state @ held.c
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = (state_slope @ held.c) / value - held.periods / z
        return np.asarray(value * z ** -float(held.periods)), np.asarray(slope)

    @cached_property
    def held_plant(self) -> HeldPlant:
        """The plant with hold and dead time as a difference equation."""
        from scipy.linalg import expm

        p, h = realise(self.plant), self.period
        periods = math.floor(self.dead_time / h)
        late = max(0.0, self.dead_time - periods * h)

        def integral(time: float) -> Floats:  # of exp(a s) for s from 0 to `time`
            block = np.zeros((2 * p.order, 2 * p.order))
            block[: p.order, : p.order], block[: p.order, p.order :] = p.a * time, np.eye(p.order) * time
            return np.asarray(expm(block)[: p.order, p.order :])

        # within a period the previous command acts for the time `late`, then the present one
        remaining = integral(h - late)
        gamma1 = (np.eye(p.order) + p.a @ remaining) @ (integral(late) @ p.b)
        return HeldPlant(p.a @ integral(h), remaining @ p.b, gamma1, p.c, periods, late / h, p.a * h, p.b * h)


def check_period(period: float) -> float:
    """Check and return a sampling period, s; InputError unless finite and > 0."""
    return number("period", period, "s", gt=0)


# -- bounds on ln L over boxes of frequency and fraction of the period, and the delay margin from these bounds ---------

# With z = exp(j theta), m = 1 - fraction and turns = 1 + whole periods of dead time the response is (the modified
# z-transform, [Astrom1997] 2)
#
#     L = K(z) c (z - Phi)^-1 (G(1) + (z - 1) G(m)) z^-turns,    G(m) = integral of exp(a s) b over [0, m].
#
# Its numerator is a polynomial in z, and G is entire. The sum of the sizes of the Taylor coefficients at the middle of
# a box bounds the deviation of ln L from its linear part anywhere in the box.
#
# The dead time is turns - 1 + fraction periods; theta is the angle of the pole. The delay margin is the least dead time
# with a root of L = -1. The search covers boxes of theta and fraction; each has the least number of turns at which it
# may contain a root. The box with the least possible dead time is examined first: it is divided, narrowed by an
# interval Newton step, or dropped, until a root is isolated.


@dataclass(frozen=True)
class BoxedExpansion:
    """Expansion of ln(L z^turns) about the middles of n boxes in the plane of frequency and fraction of a period.

    The frequency is given by z = exp(j theta), theta in rad. The dead time is turns - 1 + fraction sampling periods,
    where turns is an integer and the fraction is from 0 to 1. The sampled plant has a numerator polynomial in z, which
    depends on the states G(m) of the plant after m = 1 - fraction periods with command 1.

    - value, slope, drift: array of complex, (n,); ln(L z^turns) and its derivatives with respect to theta and to the
      fraction.
    - near: reciprocal distances of z to the poles of L and to the zeros of the controller, (n, number of both).
    - signs: 1 for a zero and -1 for a pole, for each column of `near`.
    - taylor: Taylor coefficients of the plant's numerator about z, (n, order + 1).
    - drifts, follows: derivatives of these coefficients with respect to m, (n, order + 1), and with respect to the
      components of G(m), (n, order + 1, order). `taylor`, `drifts` and `follows` are divided by the numerator at z.
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
        """Upper bounds for each box: on ln|L|, and on the deviations of ln L and of ln|L| from the linear expansion.

        A bound is inf if none exists. The bound for ln L also holds for complex theta in the disk with radius `half`.

        - half: half width of each box in theta, rad, (n,).
        - half_fraction: half width of each box in the fraction, (n,); None if this width is 0.
        """
        # each power of z - middle is bounded by its size; in the third bound the first power is split along the circle,
        # because at low frequency a delay turns L without changing |L|
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
    """Expansions of ln L of a `SampledLoop` on boxes of theta and fraction; time is in sampling periods."""

    def __init__(self, loop: SampledLoop) -> None:
        held = self._held = loop.held_plant
        self.controller, n = loop.controller, held.c.size
        poles = np.concatenate([np.expm1(loop.plant.poles * loop.period), loop.controller.poles - 1])
        self._roots = np.concatenate([poles, loop.controller.zeros - 1])  # in terms of z - 1
        self._signs = np.repeat([-1.0, 1.0], [poles.size, loop.controller.zeros.size])
        # [[bound, 1, 0], [0, 0, 1], [0, 0, 0]] with |exp(a m)| <= exp(bound m): its exponential holds the integrals
        self._bound = np.diag(np.ones(2 * n), n)
        self._bound[:n, :n] = np.where(np.eye(n) > 0, held.a, np.abs(held.a))
        self._whole = self._reached(np.ones(1))[0]
        self._slowest = min(np.pi, float(loop.feature_frequencies.min(initial=np.inf)) * loop.period)

    def first_edges(self) -> Floats:
        """Ends of the first intervals of theta, rad, from far below the slowest pole or zero to pi."""
        low = _BELOW_FEATURES * self._slowest
        return np.geomspace(low, np.pi, 2 + int(np.log(np.pi / low) / np.log(_CELL_RATIO)))

    def _reached(self, m: Floats) -> Floats:
        """States G(m) of the plant, (n, order), after m sampling periods with command 1, from zero states."""
        return np.asarray(self._held.flow(m)[:, :-1, -1])

    def bend(self, fraction: Floats, half: Floats) -> Floats:
        """Upper bound, (n, order), on the error of G's linear expansion up to the distance `half` from `fraction`."""
        from scipy.linalg import expm

        a, b = self._held.a, self._held.b
        n, (halves, at) = b.size, np.unique(half, return_inverse=True)
        with np.errstate(over="ignore", invalid="ignore"):
            powers = expm(self._bound * halves[:, None, None])[at]
        once, twice = powers[:, :n, n : 2 * n], powers[:, :n, 2 * n :]
        ends, at = np.unique(1 - np.stack([fraction, fraction + half]), return_inverse=True)
        # |G''| at the middle and at the least m; from each on the bounding matrix bounds exp(a m)
        curved = np.abs((self._reached(ends) @ a.T + b) @ a.T)[at.reshape(2, -1)][..., None]
        after, before = twice @ curved[0], (half[:, None, None] * once - twice) @ curved[1]
        return np.asarray(np.maximum(after, before)[:, :, 0])

    def expand(self, theta: Floats, fraction: Floats) -> BoxedExpansion:
        """Expand ln(L z^turns) about n points (theta, fraction), rad and ratio, each (n,)."""
        held, n, beyond = self._held, self._held.c.size, np.expm1(1j * theta)
        fractions, at = np.unique(fraction, return_inverse=True)
        reached = self._reached(1 - fractions)[at]
        speed = reached @ held.a.T + held.b  # G' = a G + b
        near = 1 / (beyond[:, None] - self._roots)
        resolvent = np.linalg.inv(beyond[:, None, None] * np.eye(n) - held.growth)
        # c adj(z - Phi)/det(middle - Phi) by powers of z - middle: the resolvent's series times its denominator
        rows = np.zeros((theta.size, n + 1, n), dtype=complex)
        row = held.c @ resolvent
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
            return BoxedExpansion(
                of=self,
                fraction=fraction,
                turn=1j * np.exp(1j * theta),
                value=np.log(self.controller(np.exp(1j * theta)) * numerator[:, 0]),
                slope=1j * np.exp(1j * theta) * (relative[:, 1] + near @ self._signs),
                drift=-drifts[:, 0],
                near=np.abs(near),
                signs=self._signs,
                taylor=relative,
                drifts=drifts,
                follows=through / numerator[:, :1, None],
            )


class Boxes(NamedTuple):
    """Boxes of theta and fraction (see `BoxedExpansion`) that may contain roots of L = -1; each field is (n,).

    - theta, half: middle and half width in theta, rad.
    - fraction, half_fraction: middle and half width in the fraction of a sampling period.
    - turns: number of turns for which the box is examined next.
    - only: true if the box is examined only for this number of turns, false if also for larger numbers.
    - least: smallest dead time at which the box may contain a root, in sampling periods.
    """

    theta: Floats
    half: Floats
    fraction: Floats
    half_fraction: Floats
    turns: Floats
    only: Flags
    least: Floats

    def at(self, index: NDArray[np.intp] | Flags) -> Boxes:
        return Boxes._make(each[index] for each in self)


def added_delay(loop: SampledLoop) -> tuple[float, float]:
    """Least added dead time, s, that makes the loop unstable, and frequency, rad/s, of the resulting oscillation.

    The results are inf and NaN if no added dead time makes the loop unstable.

    Frequencies below 1e-5 times the slowest pole or zero are not searched, nor are dead times with a phase of
    more than 90 deg at this frequency. If 20 000 boxes of frequency and dead time do not isolate the root, the
    result is the dead time up to which stability is certain.
    """
    response, begin = loop._boxed, loop.dead_time / loop.period
    edges = response.first_edges()
    boxes, last = _first_boxes(edges, loop.held_plant.periods, loop.held_plant.fraction), math.pi / 2 / edges[0]
    found, examined = (math.inf, math.nan), 0
    while boxes.least.size and examined < _MOST_BOXES:
        order = np.argsort(boxes.least, kind="stable")
        now, later = boxes.at(order[:_AT_ONCE]), boxes.at(order[_AT_ONCE:])
        examined += now.least.size
        parts, roots = _part(response, now, begin)
        found = min([found, *roots])
        last = min(last, found[0] - _SAME * (found[0] - begin))
        boxes = Boxes._make(np.concatenate(each) for each in zip(later, *parts, strict=True))
        boxes = boxes.at(boxes.least < last)
    # boxes left over after `_MOST_BOXES` may contain an earlier root
    found = min([found, *zip(boxes.least.tolist(), boxes.theta.tolist(), strict=True)])
    return (found[0] - begin) * loop.period, found[1] / loop.period


def _first_boxes(edges: Floats, periods: int, own: float) -> Boxes:
    """Boxes that cover the intervals of theta between `edges`, rad, and all dead times from the loop's dead time on."""
    # the loop has the dead time `periods` + `own`: fractions below `own` begin with one whole period more
    half, boxes = np.diff(edges) / 2, []
    for early, late, turns in ((0.0, own, periods + 2), (own, 1.0, periods + 1)):
        if late > early:
            constants = (early + late) / 2, (late - early) / 2, turns, False, turns - 1 + early
            boxes.append(Boxes._make([edges[:-1] + half, half, *(np.full(half.size, each) for each in constants)]))
    return Boxes._make(np.concatenate(each) for each in zip(*boxes, strict=True))


class Step(NamedTuple):
    """Newton step from the middle of each box to the root of the linearised equation L = -1; each field is (n,).

    - theta, fraction: the step, rad and ratio.
    - theta_room, fraction_room: largest error of the step; inf if unbounded.
    """

    theta: Floats
    theta_room: Floats
    fraction: Floats
    fraction_room: Floats


def _part(response: BoxedResponse, boxes: Boxes, begin: float) -> tuple[list[Boxes], list[tuple[float, float]]]:
    """Divide boxes; return parts that may contain a root, and roots found (dead time in periods, angle in rad)."""
    expansion = response.expand(boxes.theta, boxes.fraction)
    top, rest, level = expansion.bounds(boxes.half, boxes.half_fraction)
    still = expansion.bounds(boxes.half)[2]
    with np.errstate(invalid="ignore"):
        across = np.abs(expansion.drift.real) * boxes.half_fraction + level
        alive = (top >= 0) & ~(np.abs(expansion.value.real) > np.abs(expansion.slope.real) * boxes.half + across)
        boxes, step, alive = _next_turns(expansion, boxes, rest, across, alive)
        lag = np.minimum(np.abs(expansion.slope.imag - boxes.turns) * boxes.half, math.pi)
        turning = np.abs(expansion.slope.real) * boxes.half + still + _OF_PHASE * lag
        drifting = across - still + _OF_PHASE * np.abs(expansion.drift.imag) * boxes.half_fraction
    tiny = (boxes.half < _TINY * boxes.theta) & (boxes.half_fraction < _TINY)
    done = alive & ((rest < _SHARP) & np.isfinite(step.fraction_room) | tiny)
    dead_time = np.where(np.isfinite(step.fraction_room), boxes.turns - 1 + boxes.fraction + step.fraction, boxes.least)
    theta = np.minimum(boxes.theta + step.theta, math.pi)
    # only roots beyond the dead time of the loop, `begin`
    roots = [(float(dead_time[i]), float(theta[i])) for i in np.flatnonzero(done & (dead_time > begin))]
    # if the step leaves less than half of a box, the other part only matters for larger numbers of turns
    narrow = alive & ~done & (step.fraction_room < boxes.half_fraction / 2)
    later = boxes._replace(turns=boxes.turns + 1, least=boxes.turns + boxes.fraction - boxes.half_fraction)
    parts = [_narrowed(boxes, step).at(narrow), later.at((narrow | done) & ~boxes.only)]
    along = np.isinf(still) | (turning >= drifting)
    for way in (-0.5, 0.5):
        half = boxes._replace(theta=boxes.theta + way * boxes.half, half=boxes.half / 2)
        parts.append(half.at(alive & ~done & ~narrow & along))
        half = boxes._replace(
            fraction=boxes.fraction + way * boxes.half_fraction, half_fraction=boxes.half_fraction / 2
        )
        half = half._replace(least=np.maximum(boxes.least, boxes.turns - 1 + half.fraction - half.half_fraction))
        parts.append(half.at(alive & ~done & ~narrow & ~along))
    return parts, roots


def _next_turns(
    expansion: BoxedExpansion, boxes: Boxes, rest: Floats, across: Floats, alive: Flags
) -> tuple[Boxes, Step, Flags]:
    """Find, for each box, the least number of turns, from `boxes.turns` on, at which the box may contain a root.

    Return the boxes with these numbers, the Newton steps, and True for each box that may contain a root.
    """
    size, phase = expansion.value.real, expansion.value.imag - math.pi
    rise, drift, turns = expansion.slope.real, expansion.drift, boxes.turns
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # range of theta, from the middle, in which |L| may be 1
        room, to = across / np.abs(rise), -size / rise
        tight = room < boxes.half
        low = np.where(tight, np.maximum(to - room, -boxes.half), -boxes.half)
        high = np.where(tight, np.minimum(to + room, boxes.half), boxes.half)
        for _ in range(_TURNS_TRIED):
            lag = expansion.slope.imag - turns
            off = phase - turns * boxes.theta + lag * (low + high) / 2
            off -= 2 * math.pi * np.round(off / (2 * math.pi))
            wide = np.abs(lag) * (high - low) / 2 + np.abs(drift.imag) * boxes.half_fraction + rest
            middle = off - lag * (low + high) / 2
            det = rise * drift.imag - drift.real * lag
            sure = (wide < math.pi) & (np.abs(det) > 0)
            step = Step(
                np.where(sure, (drift.real * middle - drift.imag * size) / det, 0.0),
                np.where(sure, rest * (np.abs(drift.real) + np.abs(drift.imag)) / np.abs(det), np.inf),
                np.where(sure, (lag * size - rise * middle) / det, 0.0),
                np.where(sure, rest * (np.abs(rise) + np.abs(lag)) / np.abs(det), np.inf),
            )
            fits = (np.abs(off) <= wide) | ~np.isfinite(wide)
            fits &= np.abs(step.theta) <= boxes.half * (1 + _TINY) + step.theta_room
            fits &= np.abs(step.fraction) <= boxes.half_fraction * (1 + _TINY) + step.fraction_room
            alive = alive & (fits | ~boxes.only)
            if not (alive & ~fits).any():
                break
            # each further turn lowers the phase by theta
            gap = np.where(np.abs(off) <= wide, 0.0, np.mod(off - wide, 2 * math.pi))
            skipped = np.maximum(1.0, np.ceil(gap / (boxes.theta + high) - _TINY))
            turns = np.where(alive & ~fits, turns + skipped, turns)
    step = step._replace(fraction_room=np.where(fits, step.fraction_room, np.inf))
    first = boxes.fraction - boxes.half_fraction
    least = np.maximum(first, boxes.fraction + step.fraction - step.fraction_room)
    return boxes._replace(turns=turns, least=np.maximum(boxes.least, turns - 1 + least)), step, alive


def _narrowed(boxes: Boxes, step: Step) -> Boxes:
    """Reduce each box to the part that may contain a root at `boxes.turns` turns, according to the Newton step."""

    def ends(half: Floats, to: Floats, room: Floats) -> tuple[Floats, Floats]:
        low, high = np.clip(to - room, -half, half), np.clip(to + room, -half, half)
        return (low + high) / 2, (high - low) / 2

    turned, half = ends(boxes.half, step.theta, step.theta_room)
    later, half_fraction = ends(boxes.half_fraction, step.fraction, step.fraction_room)
    moved = boxes._replace(theta=boxes.theta + turned, fraction=boxes.fraction + later)
    return moved._replace(half=half, half_fraction=half_fraction, only=np.ones_like(boxes.only))
