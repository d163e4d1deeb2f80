"""Closed-loop time responses with exact dead time to reference, load, measurement offset and initial state.

The method of steps ([Bellen2003]) gives each response with rounding errors only, without a Pade approximation. Over one
dead time tau the delayed command is a known function of time, and the rest of the loop is a linear differential
equation without delay.

Signals with unity negative feedback, L = C G P exp(-tau s)::

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

_DEFAULT_POINTS = 1001  # times of a response by default: a smooth line in print
# Time is divided into intervals (pieces), on which every signal is a polynomial to rounding; signals jump only between
# pieces. On a piece of length 4/rate the truncation error of the Chebyshev series of order 20 of any signal is about
# 1/20! = 4e-19 of the signal, below rounding.
_NODES = 20
_PIECE = 4.0  # largest length of a piece times `rate`
_MOST_PIECES = 200_000  # a second or two of computing; a response that needs more is most likely a mistake
_SAME_TIME = 1e-12  # relative difference within which a time is regarded as the end of a piece
_WELL_POSED = 1e-12  # least |1 + L(inf)| without dead time; a smaller one is 0 within rounding


@dataclass(frozen=True)
class TimeResponse:
    """Signals of a closed loop, all 0 before t = 0; each array has one entry for each time.

    At a jump a signal has the value after the jump. SI units; in a wheel-slip loop torques are in N*m and slip
    velocities in m/s.

    - time: s, ascending.
    - output: y, without measurement noise.
    - control: u, the command of the controller, not delayed.
    - plant_input: q, the input of the plant: the command after dead time and actuator, plus the disturbance.
    - error: e = reference - (output + noise), the input of the controller.
    - control_rate: du/dt, unit of u per s, without the jumps of u. With a biproper controller u jumps at t = 0.
    - dead_time: s, between controller and actuator.
    - reference, disturbance, noise: heights of the steps at t = 0.
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
        """Yield time and output, as the responses of python-control do: `t, y = loop.step_response(10)`."""
        return iter((self.time, self.output))

    @property
    def largest_output(self) -> float:
        """Largest |y| at the given times."""
        return float(np.abs(self.output).max())

    @property
    def overshoot(self) -> float:
        """Largest (y - reference)/reference, at least 0; NaN without a step of the reference."""
        if self.reference == 0:
            return float("nan")
        return max(0.0, float((self.output / self.reference).max()) - 1.0)

    def settling_time(self, target: float, band: float) -> float:
        """First entry of `time`, s, from which |y - target| stays <= band; inf if |y - target| > band at the last time.

        - target, band: final value and tolerance, in the unit of y.
        """
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
    """Compute the response of a loop, stable or not, to steps at t = 0 and to an initial state of the plant.

    - controller, actuator, plant: C, G and P; python-control system, `Rational`, or a real number; each must be proper
      and may be unstable.
    - dead_time: tau, s, >= 0, between controller and actuator.
    - time: array, shape (n,); s, >= 0, ascending; the times of the response. Give either this or `final_time`.
    - final_time: s, > 0; end of 1001 equally spaced times from 0.
    - reference, disturbance, noise: heights of the steps of the reference, of the load at the plant's input and of the
      measurement offset.
    - initial_plant_state: array, shape (order of P,); states of `realise(plant)` at t = 0. It requires a plant given as
      `Rational`. `realise(plant).b * J` is the state after an impulse J at the plant's input.

    InputError: a system, dead time, time, height or state that is not allowed; a last time so large that the
    computation needs more than 200 000 time intervals; without dead time, an algebraic loop with L(inf) = -1.

    The result has only rounding errors. Over 200 dead times they are about 1e-12 of the largest value of the response.
    """
    dead_time = number("dead time", dead_time, "s", ge=0)
    times = given_times(time, final_time)
    steps = np.array([reference, disturbance, noise], dtype=float)
    if not np.isfinite(steps).all():
        raise InputError(f"reference, disturbance, noise: not all of {steps.tolist()} are finite; give finite heights")
    if initial_plant_state is not None and not isinstance(plant, Rational):
        raise InputError(
            f"initial plant state: the plant is a {type(plant).__name__}; give the plant as Rational, because the "
            "states are those of realise(plant)"
        )
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
"""`closed_loop_response` to a step of the reference; its height `reference`, in the unit of y, is 1 by default."""

disturbance_response = partial(closed_loop_response, disturbance=1.0)
"""`closed_loop_response` to a step of the load at the plant's input; its height `disturbance` is 1 by default.

For a torque at the wheel give the brake's lag as `actuator` and the wheel as `plant`.
"""


def _start(order: int, plant_order: int, given: ArrayLike | None) -> Floats:
    start = np.zeros(order)
    if given is None:
        return start
    state = np.asarray(given, dtype=float)
    if state.shape != (plant_order,):
        raise InputError(
            f"initial plant state: the array has shape {state.shape}; give shape ({plant_order},), one value per state"
        )
    if not np.isfinite(state).all():
        raise InputError(f"initial plant state: not all of {state.tolist()} are finite; give finite values")
    start[order - plant_order :] = state
    return start


def given_times(time: ArrayLike | None, final_time: float | None) -> Floats:
    """Return the times of a response, s, from the argument `time` or `final_time`, whichever is given."""
    if (time is None) == (final_time is None):
        raise InputError("time, final_time: both or neither is given; give either the times or the final time")
    if time is None:
        return np.linspace(0.0, number("final time", final_time or 0.0, "s", gt=0), _DEFAULT_POINTS)
    times = np.atleast_1d(reals("time", time))
    allowed = times.ndim == 1 and times.size > 0 and bool(np.isfinite(times).all() and times[0] >= 0)
    if not allowed or np.any(np.diff(times) < 0):
        raise InputError("time: the values are not allowed; give a list of finite ascending values >= 0 (s)")
    return times


def _equations(controller: Rational, actuator: Rational, plant: Rational) -> Equations:
    """State equations of the loop opened at the dead time; the states are those of controller, actuator, then plant."""
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
    """State equations of the loop opened at the dead time: x' = a x + b w + e v, signals = c x + d w + f v.

    x are the states, w(t) = u(t - tau) is the delayed command, and v are the heights of the steps of reference,
    disturbance and noise. The signals are y, u, q and error of `TimeResponse`.
    """

    a: Floats
    b: Floats
    e: Floats
    c: Floats
    d: Floats
    f: Floats

    def without_delay(self) -> Equations:
        """Equations for tau = 0: the delayed command w equals u and is eliminated, so that b and d are 0."""
        gap = 1.0 - self.d[1]
        if abs(gap) < _WELL_POSED:
            raise InputError(
                "algebraic loop: with L(inf) = -1 and no dead time the loop has no solution; give a dead time > 0 or a "
                "strictly proper plant"
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
        """Equations with scaled states, the scale of each state, and a rate, 1/s, that bounds all derivatives.

        The derivative of order k of a signal is at most rate^k times the largest value of the signal over the past dead
        times.
        """
        from scipy.linalg import matrix_balance

        # the spectral radius is the smallest row-sum norm that a scaling of the states can give to this matrix
        size = np.abs(self.a) + np.outer(np.abs(self.b), np.abs(self.c[1]))
        if size.size == 0:
            return self, np.ones(0), 0.0
        _, (scale, _) = matrix_balance(size, permute=False, separate=True)
        rate = float(np.abs(np.linalg.eigvals(size)).max())
        a, e = self.a * scale / scale[:, None], self.e / scale[:, None]
        return replace(self, a=a, b=self.b / scale, e=e, c=self.c * scale), scale, rate


class Marcher:
    """Time stepping of the loop over short intervals (pieces), with the signals at Chebyshev points (nodes)."""

    def __init__(self, equations: Equations, dead_time: float, steps: Floats) -> None:
        scaled, self._scale, rate = equations.balanced()
        self._equations, self._dead_time, self._steps, self._rate = scaled, dead_time, steps, rate

    def run(self, start: Floats, times: Floats) -> tuple[Floats, Floats]:
        """Compute y, u, q and error, shape (4, n), and du/dt, shape (n,), at `times`, s; `start`: states at t = 0."""
        end = float(times[-1])
        back, length = self._pieces(end)
        if not end / length < _MOST_PIECES:
            raise InputError(
                f"time: {end:g} s is too long; for this dead time and these time constants the response is computed "
                f"in intervals of {length:.3g} s, at most {_MOST_PIECES} of them; give a time <= "
                f"{_MOST_PIECES * length:.3g} s"
            )
        where, inside = pieces_at(times, length)
        solution = self._solution(length)
        with np.errstate(over="ignore", invalid="ignore"):
            states, delayed = self._march(start / self._scale, int(where[-1]) + 1, back, *solution)
            signals, rate = self._signals(states[where], delayed[where], inside, length, *solution)
        if not (np.isfinite(signals).all() and np.isfinite(rate).all()):
            raise InputError(
                f"time: {end:g} s is not allowed; the response overflows before this time; give a shorter time"
            )
        return signals, rate

    def _pieces(self, end: float) -> tuple[int, float]:
        """Number of pieces in one dead time (0 without dead time) and their length, s."""
        longest = _PIECE / self._rate if self._rate > 0 else math.inf
        if self._dead_time > 0:
            back = max(1, math.ceil(self._dead_time / longest))
            return back, self._dead_time / back
        return 0, min(longest, max(end, 1e-300))

    def _march(self, start: Floats, count: int, back: int, nodal: Floats, constant: Floats) -> tuple[Floats, Floats]:
        """Scaled states at the start of each piece, (count, n), and delayed command at the nodes of each piece."""
        eq, n, u = self._equations, start.size, self._equations.c[1]
        back = min(back, count)  # no command arrives later than the last piece
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
        # The result is M and c: M [x0; w] + c are the states at the nodes, where x0 are the states at the start of the
        # piece and w is the delayed command there; integration is used, because differentiation amplifies rounding
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
        eq = self._equations
        known = np.hstack([states, delayed])
        weights = chebyshev.chebvander(2 * inside - 1, _NODES - 1) @ _TO_SERIES
        at_nodes = np.tensordot(known, nodal, axes=(1, 2))  # a matrix product: `numpy.einsum` takes four times as long
        x = np.matmul(weights[:, None, :], at_nodes)[:, 0, :] + weights @ constant
        w = np.sum(weights * delayed, axis=1)
        values = x @ eq.c.T + np.outer(w, eq.d) + eq.f @ self._steps
        x_rate = x @ eq.a.T + np.outer(w, eq.b) + eq.e @ self._steps
        w_rate = np.sum((weights @ _DERIVATIVE) * delayed, axis=1) * (2.0 / length)
        return values.T, x_rate @ eq.c[1] + eq.d[1] * w_rate


def pieces_at(times: Floats, length: float) -> tuple[NDArray[np.intp], Floats]:
    """Index of the interval that contains each time, and the position in this interval, 0 to 1.

    All intervals have the same `length`, s. A time at the boundary of two intervals belongs to the later one.
    """
    ratio = times / length
    near = np.round(ratio)
    ratio = np.where(np.abs(ratio - near) <= _SAME_TIME * (1 + near), near, ratio)
    where = np.floor(ratio)
    return where.astype(np.intp), ratio - where


def _node_matrices() -> tuple[Floats, Floats, Floats]:
    """Matrices from the values of a function at the nodes to its Chebyshev series, its integral and its derivative."""
    nodes = -np.cos(np.pi * np.arange(_NODES) / (_NODES - 1))
    to_series = np.linalg.inv(chebyshev.chebvander(nodes, _NODES - 1))
    integral = chebyshev.chebvander(nodes, _NODES) @ chebyshev.chebint(to_series, lbnd=-1, axis=0)
    derivative = chebyshev.chebvander(nodes, _NODES - 2) @ chebyshev.chebder(to_series, axis=0)
    return np.asarray(to_series), np.asarray(integral), np.asarray(derivative)


_TO_SERIES, _INTEGRAL, _DERIVATIVE = _node_matrices()
