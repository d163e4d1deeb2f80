"""The stop that no controller can beat: the highest adhesion of the rail at every moment, through the same actuator."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.integrate import solve_ivp

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.model.numeric import peak, plant_parameters

from .scenario import Event, Scenario, event_place

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

_SPEEDS = 33  # of the grid on which the peak is looked for; it is smooth in speed
_TOLERANCE = 1e-9  # of the integration, relative


@dataclass(frozen=True)
class ClairvoyantStop:
    """Lower bounds of braking time, s, and distance, m, for any controller; infinite where even it does not stop."""

    braking_time: float
    braking_distance: float


def clairvoyant_stop(scenario: Scenario) -> ClairvoyantStop:
    """Bounds of the stop in a scenario without its random force, whose mean is zero.

    The controller knows the rail ahead and holds the slip of highest adhesion (`numeric.peak`) from when the torque is
    there: after the dead time, through the lag where a largest torque is set (without one any lag can be overcome),
    within the rate limit. The wheel's inertia helps nobody: r Fa <= Tb + B omega, omega at most v/r.

    InputError for events in time and in distance together, whose order a bound would have to know.
    """
    kinds = {event.time is None for event in scenario.events}
    if len(kinds) > 1:
        raise InputError("clairvoyant bound: events both in time and in distance; give them all in one of the two")
    by_distance = kinds == {True}
    places = sorted({event_place(event) for event in scenario.events})
    state, start = np.array([scenario.initial_speed, 0.0]), 0.0
    for i in range(len(places) + 1):
        until = places[i] if i < len(places) else math.inf
        begin = places[i - 1] if i else -1.0
        past = [event for event in scenario.events if event_place(event) <= begin]
        solution = _brake(scenario, past, start, state, until, by_distance=by_distance)
        start, state = float(solution.t[-1]), solution.y[:, -1]
        if solution.t_events[0].size:
            return ClairvoyantStop(start, float(state[1]))
        if start >= scenario.longest_time:
            break
    return ClairvoyantStop(math.inf, math.inf)


def _after(scenario: Scenario, past: list[Event]) -> tuple[float, Floats, Floats]:
    """After some events: effective mass, kg, and highest adhesion force, N, over speed, m/s."""
    mass, rail, factor = scenario.vehicle.mass, scenario.rail, scenario.adhesion_factor
    for event in past:
        mass, rail, factor = event.mass or mass, event.rail or rail, event.adhesion_factor or factor
    law, load = scenario.law(rail, factor), scenario.vehicle.wheel_load
    speeds = np.linspace(scenario.final_speed, scenario.initial_speed, _SPEEDS)
    forces = np.array([peak(law, float(v), load).coefficient * load for v in speeds])
    return scenario.vehicle.inertia_scale * mass, speeds, forces


def _brake(
    scenario: Scenario, past: list[Event], start: float, state: Floats, until: float, *, by_distance: bool
) -> Any:
    p = plant_parameters(scenario.adhesion, scenario.vehicle)
    r, resistance = p[3], p[4:7]
    available = _available_torque(scenario)
    mass, speeds, forces = _after(scenario, past)

    def rates(t: float, y: Floats) -> list[float]:
        v = y[0]
        viscous = max(scenario.vehicle.wheel.viscous_friction + scenario.viscous_rate * t, 0.0)
        force = min(
            float(np.interp(v, speeds, forces)),
            (available(t) + scenario.vehicle.inertia_scale * viscous * v / r) / r,
        )
        return [-(force + resistance[0] + resistance[1] * v + resistance[2] * v * v) / mass, v]

    def stopped(t: float, y: Floats) -> float:
        return float(y[0] - scenario.final_speed)

    def changed(t: float, y: Floats) -> float:
        return float(y[1] - until) if by_distance else -1.0

    stopped.terminal = changed.terminal = True  # type: ignore[attr-defined]
    end = scenario.longest_time if by_distance else min(until, scenario.longest_time)
    return solve_ivp(
        rates, (start, max(end, start)), state, events=(stopped, changed), rtol=_TOLERANCE, atol=1e-9, max_step=0.05
    )


def _available_torque(scenario: Scenario) -> Callable[[float], float]:
    """The most that can act at a time, N*m."""
    actuator, limits = scenario.vehicle.actuator, scenario.limits

    def available(t: float) -> float:
        since = t - actuator.dead_time
        if since <= 0.0:
            return 0.0
        most = math.inf
        if limits.torque_max is not None:
            most = limits.torque_max * (1.0 - math.exp(-since / actuator.lag) if actuator.lag > 0 else 1.0)
        return most if limits.rate is None else min(most, limits.rate * since)

    return available
