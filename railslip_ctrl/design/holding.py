"""A PI that holds the loop at given operating points: computed for them, not looked up."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from railslip_ctrl.core.arguments import checked
from railslip_ctrl.core.errors import InfeasibleDesignError, InputError, UnstableLoopError
from railslip_ctrl.loop import DeadTimeLoop, Rational
from railslip_ctrl.model.linearization import LinearPlant
from railslip_ctrl.model.vehicle import Actuator, PIGains

from .controllers import PIController, actuated_plant

# Integral time in units of the actuator's dead time and lag together: the corner of the integral action lies far
# enough below the crossover to cost the fragile loop less than 2 deg of phase, and the offset still dies out.
_INTEGRAL_TIME = 50.0


NO_FEEDBACK_NEEDED = (
    "the wheel is stable by itself at every operating point, and least Ms asks for zero gain, which is no controller; "
    "tune the largest ki under an Ms instead"
)
"""Why there is no design of least Ms where no plant is unstable."""


def needs_feedback(plants: Sequence[LinearPlant]) -> bool:
    """Whether any of the `plants` has a pole that is not left of the imaginary axis."""
    return any(bool(np.any(plant.poles.real >= 0)) for plant in plants)


@dataclass(frozen=True)
class HoldingDesign:
    """PI gains of least worst Ms over some operating points, at a fixed integral time.

    Attributes
    ----------
    controller : PIController
    worst_ms : float
        Largest peak of |S| over the operating points, a ratio.
    integral_time : float
        kp/ki, s.
    gain_range : tuple of float
        The kp that stabilise all of them at that integral time, N*m/(m/s).
    """

    controller: PIController
    worst_ms: float
    integral_time: float
    gain_range: tuple[float, float]


@checked
def holding_gains(plants: Sequence[LinearPlant], actuator: Actuator) -> HoldingDesign:
    """The kp that minimises the worst Ms over some plants, at an integral time of 50 (dead time + lag).

    Parameters
    ----------
    plants : sequence of LinearPlant
        At least one.
    actuator : Actuator
        Dead time and lag, s.

    Returns
    -------
    HoldingDesign
        kp in N*m/(m/s), ki in N*m/m.

    Raises
    ------
    InfeasibleDesignError
        No single kp stabilises all the plants; says the range of each. Or none of them needs to be held: without
        feedback Ms is 1, and the gain of least Ms is none (`needs_feedback`).
    InputError
        No plant is given.
    """
    if not plants:
        raise InputError("holding gains: no operating point is given; give at least one")
    if not needs_feedback(plants):
        raise InfeasibleDesignError(NO_FEEDBACK_NEEDED)
    integral_time = _INTEGRAL_TIME * ((actuator.dead_time + actuator.lag) or 0.02)
    shape = Rational(np.array([-1 / integral_time]), np.array([0.0]), 1.0)
    loops = [DeadTimeLoop(shape * actuated_plant(plant, actuator), actuator.dead_time) for plant in plants]
    low, high = _common_range(plants, loops, actuator)

    def worst_ms(log_kp: float) -> float:
        try:
            return max(loop.scaled(math.exp(log_kp)).margins().ms for loop in loops)
        except UnstableLoopError:
            return math.inf

    log_kp = _minimise(worst_ms, low, high)
    kp = math.exp(log_kp)
    controller = PIController(PIGains(kp=kp, ki=kp / integral_time))
    return HoldingDesign(controller, worst_ms(log_kp), integral_time, (low, high))


def _common_range(
    plants: Sequence[LinearPlant], loops: Sequence[DeadTimeLoop], actuator: Actuator
) -> tuple[float, float]:
    ranges = [loop.stabilizing_gain_range for loop in loops]
    found = [r for r in ranges if r is not None]
    low, high = max((r[0] for r in found), default=0.0), min((r[1] for r in found), default=0.0)
    if len(found) == len(ranges) and low < high:
        return low, high
    told = "; ".join(
        f"{plant.point.rail} {plant.point.speed_kmh:g} km/h: "
        + ("none" if r is None else f"{r[0]:.4g} to {r[1]:.4g} N*m/(m/s)")
        + f" (unstable pole times actuator {max(plant.poles.real.max(), 0) * (actuator.dead_time + actuator.lag):.3g})"
        for plant, r in zip(plants, ranges, strict=True)
    )
    raise InfeasibleDesignError(f"no single PI stabilises all operating points; stabilising kp: {told}")


def _minimise(objective: object, low: float, high: float) -> float:
    """Minimum of a quasi-convex function of ln kp inside a stabilising range."""
    from scipy.optimize import minimize_scalar

    top = min(high, 1e6 * (low or 1.0))
    ends = math.log(low or 1e-6 * top), math.log(top)
    result = minimize_scalar(objective, bounds=ends, method="bounded", options={"xatol": 1e-10})
    return float(result.x)
