"""Linear equations with one dead time, solved by the method of steps on Chebyshev points.

Between multiples of the dead time tau the delayed command is a known smooth function, and the delay-free rest of
the loop a linear differential equation driven by it ([Bellen2003]). Cut into pieces short against every time
constant, command and states are polynomials to rounding, so that one constant matrix takes the nodal values of
the command one dead time ago to those of now. Kinks and jumps fall on the ends of pieces.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import chebyshev

from railslip_ctrl.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

# On a piece of length h = 4/rate the Chebyshev series of order 20 of any signal of the loop is cut off
# at about (rate h/4)^20/20! = 4e-19 of its size, so that only rounding remains.
_NODES = 20
_PIECE = 4.0
# A second or two of computing; a response this fine-grained is asked for by mistake.
_MOST_PIECES = 200_000
_SAME_TIME = 1e-12  # relative to the time: a multiple of the dead time computed in another way is still one
_WELL_POSED = 1e-12  # |1 + L(inf)| without dead time; less is rounding of 0


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
        scaled = Equations(
            a=self.a * scale / scale[:, None],
            b=self.b / scale,
            e=self.e / scale[:, None],
            c=self.c * scale,
            d=self.d,
            f=self.f,
        )
        return scaled, scale, rate


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
        x = np.einsum("tk,ijk,ti->tj", known, nodal, weights, optimize=True) + weights @ constant
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
