"""Closed-loop time responses with the dead time exact: reference, load, measurement and initial state.

Each is computed by the method of steps (`steps`), to rounding; nothing is Pade.

Signals, unity negative feedback, L = C G P exp(-tau s)::

    e = reference - (y + noise)    u = C e    q(t) = (G u)(t - tau) + disturbance    y = P q
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from railslip_ctrl.arguments import number, reals
from railslip_ctrl.errors import InputError

from .rational import Rational
from .realisation import realise
from .steps import Equations, Marcher

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]

_DEFAULT_POINTS = 1001  # a smooth line in print


@dataclass(frozen=True)
class TimeResponse:
    """Signals of a closed loop that is at rest before t = 0; arrays of one shape, one entry a time.

    Where a signal jumps the value after the jump is given. SI; for a wheel-slip loop torques in N*m and slip
    velocities in m/s.

    Attributes
    ----------
    time : array
        s, ascending.
    output : array
        y, without measurement noise.
    control : array
        u, the controller's command, before the dead time.
    plant_input : array
        q, what acts on the plant: the command after dead time and actuator, plus the disturbance.
    error : array
        e = reference - (output + noise), what the controller sees.
    control_rate : array
        du/dt, per s; jumps of u (a reference step through a biproper controller, at t = 0) not included.
    dead_time, reference, disturbance, noise : float
        s, and the heights of the steps at t = 0.
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

    @property
    def largest_control_rate(self) -> float:
        """Largest |du/dt| at the times given, per s."""
        return float(np.abs(self.control_rate).max())

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


def step_response(
    controller: Any,
    plant: Any,
    dead_time: float,
    *,
    time: ArrayLike | None = None,
    final_time: float | None = None,
    actuator: Any = 1.0,
    height: float = 1.0,
) -> TimeResponse:
    """Response to a reference step of `height` (unit of y) at t = 0; see `closed_loop_response`."""
    return closed_loop_response(
        controller, plant, dead_time, time=time, final_time=final_time, actuator=actuator, reference=height
    )


def disturbance_response(
    controller: Any,
    plant: Any,
    dead_time: float,
    *,
    time: ArrayLike | None = None,
    final_time: float | None = None,
    actuator: Any = 1.0,
    height: float = 1.0,
) -> TimeResponse:
    """Response to a load step of `height` (unit of q) at the plant's input, behind dead time and actuator.

    See `closed_loop_response`; for a torque at the wheel give the brake's lag as `actuator`, the wheel as `plant`.
    """
    return closed_loop_response(
        controller, plant, dead_time, time=time, final_time=final_time, actuator=actuator, disturbance=height
    )


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

    Parameters
    ----------
    controller, actuator, plant : python-control system, `Rational`, or a real number
        C, G and P, proper, each with any poles; the dead time acts between C and G.
    dead_time : float
        tau, s, >= 0.
    time : array, shape (n,)
        s, >= 0, ascending, at which to give the response. Either this or `final_time`.
    final_time : float
        s, > 0: 1001 equally spaced times from 0.
    reference, disturbance, noise : float
        Heights of the steps of the reference, of the load at the plant's input and of the measurement's offset.
    initial_plant_state : array, shape (order of P,)
        States of `realise(plant)`, of a `Rational`, at t = 0; `realise(plant).b * J` is what an impulse J at its input
        leaves.

    Raises
    ------
    InputError
        A system, dead time, time, height or state that is not allowed; times so long against dead time and time
        constants that the response would take minutes; without dead time, an algebraic loop with L(inf) = -1.

    Notes
    -----
    Errors are rounding: about 1e-12 of the largest value over 200 dead times. A growing response keeps that
    accuracy relative to its size.
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
