"""Closed-loop time responses with the dead time exact: reference, load, measurement and initial state.

Each is computed by the method of steps on Chebyshev points, to rounding; nothing is Pade. Between multiples of the dead
time tau the delayed command is a known smooth function, and the delay-free rest of the loop a linear differential
equation driven by it ([Bellen2003]). Cut into pieces short against every time constant, command and states are
polynomials to rounding, so that one constant matrix takes the nodal values of the command one dead time ago to those of
now. Kinks and jumps fall on the ends of pieces.

Signals, unity negative feedback, L = C G P exp(-tau s)::

    e = reference - (y + noise)    u = C e    q(t) = (G u)(t - tau) + disturbance    y = P q
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray

from railslip_ctrl.core.arguments import Floats, number, reals
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass

from .rational import Rational, realise

_DEFAULT_POINTS = 1001  # a smooth line in print
# On a piece of length h = 4/rate the Chebyshev series of order 20 of any signal of the loop is cut off
# at about (rate h/4)^20/20! = 4e-19 of its size, so that only rounding remains.
_NODES = 20
_PIECE = 4.0
# A second or two of computing; a response this fine-grained is asked for by mistake.
_MOST_PIECES = 200_000
_SAME_TIME = 1e-12  # relative to the time: a multiple of the dead time computed in another way is still one
_WELL_POSED = 1e-12  # |1 + L(inf)| without dead time; less is rounding of 0


@dataclass(frozen=True)
class TimeResponse:
    """Signals of a closed loop that is at rest before t = 0; arrays of one shape, one entry a time.

    Where a signal jumps the value after the jump is given. SI; for a wheel-slip loop torques in N*m and slip
    velocities in m/s.

    - time: s, ascending.
    - output: y, without measurement noise.
    - control: u, the controller's command, before the dead time.
    - plant_input: q, what acts on the plant: the command after dead time and actuator, plus the disturbance.
    - error: e = reference - (output + noise), what the controller sees.
    - control_rate: du/dt, per s; jumps of u (a reference step through a biproper controller, at t = 0) not included.
    - dead_time, reference, disturbance, noise: s, and the heights of the steps at t = 0.
    """

    time: Floats
    output: Floats
    control: Floats
    plant_input: Floats
    error: Floats
    control_rate: Floats
    dead_time: float
    reference: float
    disturbance: float
    noise: float

    def __iter__(self) -> Iterator[Floats]:
        """Time and output, as python-control's responses come apart: `t, y = loop.step_response(10)`."""
        return iter((self.time, self.output))

    @property
    def largest_output(self) -> float:
        """Largest |y| at the times given."""
        return float(np.abs(self.output).max())

    @property
    def overshoot(self) -> float:
        """Largest excess of y over the reference, as a share of it, >= 0; NaN without a reference step."""
        if self.reference == 0:
            return float("nan")
        return max(0.0, float((self.output / self.reference).max()) - 1.0)

    def settling_time(self, target: float, band: float) -> float:
        """First of the times, s, from which on |y - target| <= band; inf if the last one is outside."""
        outside = np.flatnonzero(np.abs(self.output - target) > band)
        if outside.size == 0:
            return float(self.time[0])
        last = int(outside[-1])
        return float(self.time[last + 1]) if last + 1 < self.time.size else math.inf


def closed_loop_response(
    controller: Any,
    plant: Any,
    dead_time: float,
    *,
    time: ArrayLike | None = None,
    final_time: float | None = None,
    actuator: Any = 1.0,
    reference: float = 0.0,
    disturbance: float = 0.0,
    noise: float = 0.0,
    initial_plant_state: ArrayLike | None = None,
) -> TimeResponse:
    """Response of the loop to steps at t = 0 and to an initial state of the plant, stable or not.

    - controller, actuator, plant: python-control system, `Rational`, or a real number; C, G and P, proper, each with
      any poles; the dead time acts between C and G.
    - dead_time: tau, s, >= 0.
    - time: array, shape (n,); s, >= 0, ascending, at which to give the response. Either this or `final_time`.
    - final_time: s, > 0: 1001 equally spaced times from 0.
    - reference, disturbance, noise: heights of the steps of the reference, of the load at the plant's input and of the
      measurement's offset.
    - initial_plant_state: array, shape (order of P,); states of `realise(plant)`, of a `Rational`, at t = 0;
      `realise(plant).b * J` is what an impulse J at its input leaves.

    InputError: a system, dead time, time, height or state that is not allowed; times so long against dead time and time
    constants that the response would take minutes; without dead time, an algebraic loop with L(inf) = -1.

    Errors are rounding: about 1e-12 of the largest value over 200 dead times, of a growing response of its size.
    """
    dead_time = number("dead time", dead_time, "s", ge=0)
    times = given_times(time, final_time)
    steps = np.array([reference, disturbance, noise], dtype=float)
    if not np.isfinite(steps).all():
        raise InputError(f"steps: {steps.tolist()} hold a value that is not finite; give finite heights")
    if initial_plant_state is not None and not isinstance(plant, Rational):
        raise InputError("initial plant state: goes with a Rational, as realise() has its states; give such a plant")
    systems = {"controller": controller, "actuator": actuator, "plant": plant}
    c, g, p = (Rational.from_control(system, name) for name, system in systems.items())
    equations = _equations(c, g, p)
    if dead_time == 0:
        equations = equations.without_delay()
    start = _start(equations.a.shape[0], p.poles.size, initial_plant_state)
    signals, rate = Marcher(equations, dead_time, steps).run(start, times)
    output, control, plant_input, error = signals
    return TimeResponse(times, output, control, plant_input, error, rate, dead_time, *steps.tolist())


step_response = partial(closed_loop_response, reference=1.0)
"""To a unit step of the reference, or one of the height `reference` (unit of y)."""

disturbance_response = partial(closed_loop_response, disturbance=1.0)
"""To a unit load, or one of the height `disturbance`, at the plant's input, behind dead time and actuator.

For a torque at the wheel give the brake's lag as `actuator`, the wheel as `plant`.
"""


def _start(order: int, plant_order: int, given: ArrayLike | None) -> Floats:
    """States of the loop at t = 0: the plant's, which come last, as `given`, all others at rest."""
    start = np.zeros(order)
    if given is None:
        return start
    state = np.asarray(given, dtype=float)
    if state.shape != (plant_order,) or not np.isfinite(state).all():
        raise InputError(
            f"initial plant state: {np.shape(given)} is not allowed; give {plant_order} finite "
            "numbers, one a state of the plant"
        )
    start[order - plant_order :] = state
    return start


def given_times(time: ArrayLike | None, final_time: float | None) -> Floats:
    """The times of a response, s, from either of its arguments."""
    if (time is None) == (final_time is None):
        raise InputError("time: give either the times or the final time, one of the two")
    if time is None:
        return np.linspace(0.0, number("final time", final_time or 0.0, "s", gt=0), _DEFAULT_POINTS)
    times = np.atleast_1d(reals("time", time))
    allowed = times.ndim == 1 and times.size > 0 and bool(np.isfinite(times).all() and times[0] >= 0)
    if not allowed or np.any(np.diff(times) < 0):
        raise InputError("time: the times are not allowed; give a list of finite ascending values >= 0 (s)")
    return times


def _equations(controller: Rational, actuator: Rational, plant: Rational) -> Equations:
    """The loop opened at the dead time; states of controller, actuator and plant in this order."""
    k, g, p = realise(controller), realise(actuator), realise(plant)
    n = k.order + g.order + p.order
    of_k, of_g, of_p = slice(0, k.order), slice(k.order, k.order + g.order), slice(k.order + g.order, n)
    # each signal as a row over x, w and v = (reference, disturbance, noise)
    q = np.zeros(n + 4)
    q[of_g], q[n], q[n + 2] = g.c, g.d, 1.0
    y = p.d * q
    y[of_p] += p.c
    error = -y
    error[n + 1] += 1.0
    error[n + 3] -= 1.0
    u = k.d * error
    u[of_k] += k.c
    w = np.zeros(n + 4)
    w[n] = 1.0
    rows = np.zeros((n, n + 4))
    rows[of_k] = np.outer(k.b, error)
    rows[of_g] = np.outer(g.b, w)
    rows[of_p] = np.outer(p.b, q)
    for part, system in ((of_k, k), (of_g, g), (of_p, p)):
        rows[part, part] += system.a
    signals = np.array([y, u, q, error])
    return Equations(
        a=rows[:, :n], b=rows[:, n], e=rows[:, n + 1 :], c=signals[:, :n], d=signals[:, n], f=signals[:, n + 1 :]
    )


# -- the method of steps -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Equations:
    """x' = a x + b w + e v; (y, u, q, error) = c x + d w + f v; w(t) = u(t - tau), v the three steps."""

    a: Floats
    b: Floats
    e: Floats
    c: Floats
    d: Floats
    f: Floats

    def without_delay(self) -> Equations:
        """With w = u solved for; b and d become 0."""
        gap = 1.0 - self.d[1]
        if abs(gap) < _WELL_POSED:
            raise InputError(
                "algebraic loop: without dead time L(inf) = -1 has no response; give a dead time > 0 or a strictly "
                "proper plant"
            )
        from_x, from_v = self.c[1] / gap, self.f[1] / gap
        return Equations(
            a=self.a + np.outer(self.b, from_x),
            b=np.zeros_like(self.b),
            e=self.e + np.outer(self.b, from_v),
            c=self.c + np.outer(self.d, from_x),
            d=np.zeros_like(self.d),
            f=self.f + np.outer(self.d, from_v),
        )

    def balanced(self) -> tuple[Equations, Floats, float]:
        """The same with states scaled, their scales, and a bound on how fast its signals change, 1/s.

        No derivative of order k of a signal, over the past dead times, exceeds rate^k times its size: the
        spectral radius of |a| + |b c_u| is the least row-sum norm of it under any scaling.
        """
        from scipy.linalg import matrix_balance

        size = np.abs(self.a) + np.outer(np.abs(self.b), np.abs(self.c[1]))
        if size.size == 0:
            return self, np.ones(0), 0.0
        _, (scale, _) = matrix_balance(size, permute=False, separate=True)
        rate = float(np.abs(np.linalg.eigvals(size)).max())
        a, e = self.a * scale / scale[:, None], self.e / scale[:, None]
        return replace(self, a=a, b=self.b / scale, e=e, c=self.c * scale), scale, rate


class Marcher:
    """The loop piece by piece; within a piece every signal is held by its values at Chebyshev points."""

    def __init__(self, equations: Equations, dead_time: float, steps: Floats) -> None:
        scaled, self._scale, rate = equations.balanced()
        self._equations, self._dead_time, self._steps, self._rate = scaled, dead_time, steps, rate

    def run(self, start: Floats, times: Floats) -> tuple[Floats, Floats]:
        """(y, u, q, error) at the times, shape (4, n), and du/dt."""
        end = float(times[-1])
        back, length = self._pieces(end)
        if not end / length < _MOST_PIECES:
            raise InputError(
                f"time: {end:g} s is not allowed; dead time and time constants ask for pieces of {length:.3g} s, of "
                f"which at most {_MOST_PIECES} are computed; give a time <= {_MOST_PIECES * length:.3g} s"
            )
        where, inside = pieces_at(times, length)
        solution = self._solution(length)
        with np.errstate(over="ignore", invalid="ignore"):
            states, delayed = self._march(start / self._scale, int(where[-1]) + 1, back, *solution)
            signals, rate = self._signals(states[where], delayed[where], inside, length, *solution)
        if not (np.isfinite(signals).all() and np.isfinite(rate).all()):
            raise InputError(f"time: {end:g} s is not allowed; the response overflows before it; give a shorter time")
        return signals, rate

    def _pieces(self, end: float) -> tuple[int, float]:
        """Pieces in a dead time (0: none) and their length, s."""
        longest = _PIECE / self._rate if self._rate > 0 else math.inf
        if self._dead_time > 0:
            back = max(1, math.ceil(self._dead_time / longest))
            return back, self._dead_time / back
        return 0, min(longest, max(end, 1e-300))

    def _march(self, start: Floats, count: int, back: int, nodal: Floats, constant: Floats) -> tuple[Floats, Floats]:
        """Scaled states at the start of each piece, (count, n), and the delayed command at its nodes."""
        eq, n, u = self._equations, start.size, self._equations.c[1]
        back = min(back, count)  # beyond it no command has arrived yet
        # [u at the nodes; x at the end] = step [x at the start; w at the nodes] + shift
        step = np.vstack([np.einsum("j,ijk->ik", u, nodal), nodal[-1]])
        step[:_NODES, n:] += eq.d[1] * np.eye(_NODES)
        shift = np.concatenate([constant @ u + eq.f[1] @ self._steps, constant[-1]])
        states, commands = np.empty((count, n)), np.zeros((count + back, _NODES))
        x = start
        for piece in range(count):
            states[piece] = x
            new = step @ np.concatenate([x, commands[piece]]) + shift
            if back:
                commands[piece + back] = new[:_NODES]
            x = new[_NODES:]
        return states, commands[:count]

    def _solution(self, length: float) -> tuple[Floats, Floats]:
        """x at the nodes as (nodes, n, n + nodes) times [x at the start; w at the nodes], plus (nodes, n).

        Collocation in integrated form, x = x0 + S (a x + b w + e v): no differentiation amplifies rounding.
        """
        eq, n = self._equations, self._equations.a.shape[0]
        integral = 0.5 * length * _INTEGRAL
        left = np.eye(_NODES * n) - np.kron(integral, eq.a)
        from_x = np.kron(np.ones((_NODES, 1)), np.eye(n))
        from_w = np.kron(integral, eq.b[:, None])
        from_v = np.kron(integral.sum(axis=1)[:, None], (eq.e @ self._steps)[:, None])
        solution = np.linalg.solve(left, np.hstack([from_x, from_w, from_v])).reshape(_NODES, n, n + _NODES + 1)
        return solution[:, :, :-1], solution[:, :, -1]

    def _signals(
        self, states: Floats, delayed: Floats, inside: Floats, length: float, nodal: Floats, constant: Floats
    ) -> tuple[Floats, Floats]:
        """(y, u, q, error) and du/dt where `inside` says in the pieces that these states and commands belong to."""
        eq = self._equations
        known = np.hstack([states, delayed])
        weights = chebyshev.chebvander(2 * inside - 1, _NODES - 1) @ _TO_SERIES
        at_nodes = np.tensordot(known, nodal, axes=(1, 2))  # a product of matrices: one einsum takes four times as long
        x = np.matmul(weights[:, None, :], at_nodes)[:, 0, :] + weights @ constant
        w = np.sum(weights * delayed, axis=1)
        values = x @ eq.c.T + np.outer(w, eq.d) + eq.f @ self._steps
        x_rate = x @ eq.a.T + np.outer(w, eq.b) + eq.e @ self._steps
        w_rate = np.sum((weights @ _DERIVATIVE) * delayed, axis=1) * (2.0 / length)
        return values.T, x_rate @ eq.c[1] + eq.d[1] * w_rate


def pieces_at(times: Floats, length: float) -> tuple[NDArray[np.intp], Floats]:
    """Piece of each time, and the place in it, 0 to 1; the end of a piece counts as the start of the next."""
    ratio = times / length
    near = np.round(ratio)
    ratio = np.where(np.abs(ratio - near) <= _SAME_TIME * (1 + near), near, ratio)
    where = np.floor(ratio)
    return where.astype(np.intp), ratio - where


def _node_matrices() -> tuple[Floats, Floats, Floats]:
    """Nodal values to Chebyshev series, to the integral from the start, and to the derivative; on [-1, 1]."""
    nodes = -np.cos(np.pi * np.arange(_NODES) / (_NODES - 1))
    to_series = np.linalg.inv(chebyshev.chebvander(nodes, _NODES - 1))
    integral = chebyshev.chebvander(nodes, _NODES) @ chebyshev.chebint(to_series, lbnd=-1, axis=0)
    derivative = chebyshev.chebvander(nodes, _NODES - 2) @ chebyshev.chebder(to_series, axis=0)
    return np.asarray(to_series), np.asarray(integral), np.asarray(derivative)


_TO_SERIES, _INTEGRAL, _DERIVATIVE = _node_matrices()
