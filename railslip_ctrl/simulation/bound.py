"""The stop that no controller can beat, and controllers side by side over the same runs: how far each is from it.

It has the highest adhesion of the rail at every moment, through the same actuator.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import minimize, minimize_scalar

from railslip_ctrl.core.arguments import Floats, checked
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.model.numeric import numeric_plant, peak, plant_parameters

from .run import Outcome, Run, Simulator
from .scenario import Event, Scenario, event_place

_SPEEDS = 33  # of the grid on which the peak is looked for; it is smooth in speed
_TOLERANCE = 1e-9  # of the integration, relative
_FAR = 1e6  # m, in place of no stop at all, with which a search by parabolas cannot reckon


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
    available = _available_torque(scenario)
    mass, speeds, forces = _after(scenario, past)
    car = scenario.vehicle.model_copy(update={"mass": mass / scenario.vehicle.inertia_scale})
    p = plant_parameters(scenario.adhesion, car, scenario.gradient)
    r, resistance = p[3], p[4:7]

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


# --- with the time that slip takes to build up ----------------------------------------------------------------------

_SWITCHES = 9  # times tried first at which the torque is taken back
_MOST_SLIP = 0.4  # a build-up that comes here is of no use
_SAMPLES = 100  # of the hold, at which its command is looked at
_SLACK = 0.02  # of the largest torque, by which a command may pass its limits: of the differences that give it


def attainable_stop(scenario: Scenario) -> ClairvoyantStop:
    """A stop that can be had in a scenario without noise, by one that knows the rail: the largest torque through the
    actuator, then none until the slip comes to rest, from where it is held, or brought to less in some time; the best
    such slips and times.

    It is no bound but a stop of the true plant, adhesion state and wheel included, so that the best there is lies
    between `clairvoyant_stop` and it. Infinite where no such stop is found.

    InputError for a scenario without a largest torque, or with a rate limit or events.
    """
    limits = scenario.limits
    if limits.torque_max is None or limits.rate is not None or scenario.events:
        raise InputError("attainable stop: give a largest torque, no rate limit and no events")
    path = _Path(scenario)
    latest = path.latest
    first = scenario.vehicle.actuator.dead_time
    tried = np.linspace(first, latest, _SWITCHES + 2)[1:-1]
    found = [path.stop(float(switch)) for switch in tried]
    at = int(np.argmin([one.braking_distance for one in found]))
    ends = tried[max(at - 1, 0)], tried[min(at + 1, _SWITCHES - 1)]
    once = minimize_scalar(lambda x: min(path.stop(x).braking_distance, _FAR), bounds=ends, method="bounded")
    every = [path.stop(float(once.x)), found[at]]
    if path.stop(float(once.x), *_LESS).braking_distance < every[0].braking_distance:  # as where adhesion falls
        best = minimize(
            lambda x: path.stop(*x.tolist()).braking_distance,
            [once.x, *_LESS],
            method="Nelder-Mead",
            options={"fatol": 0.02, "xatol": 0.02, "maxfev": 80},
        )
        every.append(path.stop(*best.x.tolist()))
    return min(every, key=lambda one: one.braking_distance)


class _Path:
    """The plant of a scenario without noise: speed, slip velocity, adhesion state, acting torque, distance."""

    def __init__(self, scenario: Scenario) -> None:
        law = scenario.law(scenario.rail, scenario.adhesion_factor)
        self._rates, self._scenario = numeric_plant(type(law)).rates, scenario
        self._parameters = plant_parameters(law, scenario.vehicle, scenario.gradient)
        self._actuator, self._most = scenario.vehicle.actuator, scenario.limits.torque_max or 0.0
        begin = np.array([scenario.initial_speed, 0.0, 0.0, 0.0, 0.0])
        free = solve_ivp(self._driven(0.0), (0.0, self._actuator.dead_time), begin, **_SOLVER)
        start = free.y[:, -1]

        def slipped(t: float, y: Floats) -> float:
            return float(y[1] - _MOST_SLIP * y[0])

        slipped.terminal = True  # type: ignore[attr-defined]
        self._full = solve_ivp(
            self._driven(self._most),
            (self._actuator.dead_time, scenario.longest_time),
            start,
            events=slipped,
            dense_output=True,
            **_SOLVER,
        )

    @property
    def latest(self) -> float:
        """When the slip would be too much with the largest torque, s."""
        return float(self._full.t[-1])

    def stop(self, switch: float, share: float = 1.0, time: float = 1.0) -> ClairvoyantStop:
        """With the torque taken back at a time, s, and then a share of the slip left after some times `time`, s;
        infinite where that brings the slip nowhere to rest, or passes the limits of the brake."""
        try:
            return self._stop(switch, share, time)
        except ValueError:  # of SciPy's search for an event, where the solution of a step ends on its other side
            return ClairvoyantStop(math.inf, math.inf)

    def _stop(self, switch: float, share: float, time: float) -> ClairvoyantStop:
        never = ClairvoyantStop(math.inf, math.inf)
        taken_back = self._driven(0.0)

        def rests(t: float, y: Floats) -> float:
            rates = taken_back(t, y)
            return float(rates[1] * y[0] - y[1] * rates[0])

        rests.terminal, rests.direction = True, -1.0  # type: ignore[attr-defined]
        if not (self._actuator.dead_time < switch < self.latest and 0 < share <= 1 and time > _LEAST_TIME):
            return never
        begin = self._full.sol(switch)
        if self._actuator.lag == 0:  # the torque jumps, so that the slip is held from here on
            return self._held(switch, begin, share, time)
        if rests(switch, begin) <= 0:
            return never
        back = solve_ivp(taken_back, (switch, switch + _LONGEST_BACK), begin, events=rests, **_SOLVER)
        if not back.t_events[0].size or back.y[1, -1] > _MOST_SLIP * back.y[0, -1]:
            return never
        return self._held(float(back.t[-1]), back.y[:, -1], share, time)

    def _held(self, start: float, begin: Floats, share: float, time: float) -> ClairvoyantStop:
        """The slip ratio held from a time on to the end, or brought to a share of it."""
        first, final = begin[1] / begin[0], self._scenario.final_speed

        def slip(t: Any) -> Any:
            return first * (share + (1 - share) / (1 + ((t - start) / time) ** 2))

        def rates(t: float, y: Floats) -> list[float]:
            speed, _, state = self._plant(t, y[0], slip(t) * y[0], y[1], 0.0)
            return [speed, state, y[0]]

        def stopped(t: float, y: Floats) -> float:
            return float(y[0] - final)

        stopped.terminal = True  # type: ignore[attr-defined]
        end = start + self._scenario.longest_time
        found = solve_ivp(rates, (start, end), begin[[0, 2, 4]], events=stopped, dense_output=True, **_SOLVER)
        if not found.t_events[0].size:
            return ClairvoyantStop(math.inf, math.inf)
        times = np.linspace(start, float(found.t[-1]), _SAMPLES)
        acting = self._holding(times, found.sol(times)[0], found.sol(times)[1], slip)
        asked = acting + self._actuator.lag * np.gradient(acting, times)
        if asked[1:].max() > (1 + _SLACK) * self._most or asked.min() < -_SLACK * self._most:
            return ClairvoyantStop(math.inf, math.inf)
        return ClairvoyantStop(float(found.t[-1]), float(found.y[2, -1]))

    def _holding(self, t: Floats, speed: Floats, state: Floats, slip: Callable[[Floats], Floats]) -> Floats:
        """The acting torque, N*m, at times, s, that gives a slip ratio over time."""
        ratio, rate = slip(t), (slip(t + _STEP) - slip(t - _STEP)) / (2 * _STEP)
        change, none, _ = self._plant(t, speed, ratio * speed, state, 0.0)
        one = self._plant(t, speed, ratio * speed, state, 1.0)[1]
        return np.asarray((ratio * change + rate * speed - none) / (one - none))

    def _plant(self, t: Any, speed: Any, sigma: Any, state: Any, torque: float) -> tuple[Any, Any, Any]:
        """Rates of speed, slip velocity and adhesion state; of arrays, arrays."""
        found = self._rates(speed, sigma, state, torque, 0.0, self._scenario.viscous_rate * t, self._parameters)
        return found[0], found[1], found[2] if len(found) > 2 else 0.0

    def _driven(self, command: float) -> Callable[[float, Floats], list[float]]:
        """Rates with a command that has passed the dead time."""

        def rates(t: float, y: Floats) -> list[float]:
            lag = self._actuator.lag
            torque = y[3] if lag > 0 else command
            return [*self._plant(t, y[0], y[1], y[2], torque), (command - y[3]) / lag if lag > 0 else 0.0, y[0]]

        return rates


_SOLVER: dict[str, Any] = {"method": "LSODA", "rtol": 1e-6, "atol": 1e-7}
_STEP = 1e-4  # s, of the difference that gives the rate of the slip
_LEAST_TIME = 0.05  # s
_LESS = (0.6, 1.0)  # share of the slip, and s, from which the best are looked for
_LONGEST_BACK = 5.0  # s, until the slip rests


# --- controllers side by side over the same braking runs --------------------------------------------------------------


@dataclass(frozen=True)
class Mean:
    """Mean over the runs and its standard error (NaN for a single run); NaN where no run stopped."""

    value: float
    error: float


@dataclass(frozen=True)
class ControllerRow:
    """A controller over the seeds of a scenario: `outcomes` of all `runs`, means over those that `stopped`.

    SI, as of `Run`; `lock_time` is that with r omega < 0.02 v, s; `beyond_bound` the braking distance beyond the
    clairvoyant's, m.
    """

    name: str
    runs: int
    stopped: int
    outcomes: Mapping[Outcome, int]
    braking_time: Mean
    braking_distance: Mean
    brake_energy: Mean
    slip_error: Mean
    slip_error_published: Mean
    max_slip: Mean
    lock_time: Mean
    rms_torque_rate: Mean
    max_torque: Mean
    beyond_bound: Mean


@dataclass(frozen=True)
class RunComparison:
    """`rows` of controllers over one scenario, each over all `seeds`, with the `bound` that none can beat."""

    scenario: Scenario
    seeds: tuple[int, ...]
    bound: ClairvoyantStop
    rows: tuple[ControllerRow, ...]

    def __str__(self) -> str:
        text = import_module("railslip_ctrl.report.simulation")  # a room above this one, asked for by the user
        return str(text.run_comparison_text(self))

    def row(self, name: str) -> ControllerRow:
        """The row of a controller by name; KeyError for another."""
        return {row.name: row for row in self.rows}[name]


@checked
def compare_runs(scenario: Scenario, controllers: Mapping[str, Any], seeds: Sequence[int]) -> RunComparison:
    """Run every controller through the scenario with every seed, on all cores; all meet the same noise.

    - scenario: the run, SI.
    - controllers: by name, what `simulate` takes.
    - seeds: one for each run, any number of them.

    Returns means for each controller, SI, and the bound of `clairvoyant_stop`, without noise: where the scenario sets
    no largest torque, it has the actuator's dead time but not its lag, which a large enough command overcomes.
    """
    bound = clairvoyant_stop(scenario)
    simulators = {name: Simulator(scenario, controller) for name, controller in controllers.items()}
    with ThreadPoolExecutor() as pool:  # the kernel holds no lock of the interpreter
        rows = [_row(name, list(pool.map(one.run, seeds)), bound) for name, one in simulators.items()]
    return RunComparison(scenario, tuple(seeds), bound, tuple(rows))


_MEANS: dict[str, Callable[[Run], float]] = {
    "braking_time": lambda run: run.braking_time,
    "braking_distance": lambda run: run.braking_distance,
    "brake_energy": lambda run: run.brake_energy,
    "slip_error": lambda run: run.mean_abs_slip_error,
    "slip_error_published": lambda run: run.mean_abs_slip_error_published,
    "max_slip": lambda run: run.max_slip,
    "lock_time": lambda run: run.locked_fraction * run.braking_time,
    "rms_torque_rate": lambda run: run.rms_torque_rate,
    "max_torque": lambda run: run.max_torque,
}


def _row(name: str, runs: list[Run], bound: ClairvoyantStop) -> ControllerRow:
    stopped = [run for run in runs if run.stopped]
    return ControllerRow(
        name=name,
        runs=len(runs),
        stopped=len(stopped),
        outcomes={outcome: n for outcome in Outcome if (n := sum(run.outcome is outcome for run in runs))},
        beyond_bound=_mean([run.braking_distance - bound.braking_distance for run in stopped]),
        **{column: _mean([read(run) for run in stopped]) for column, read in _MEANS.items()},
    )


def _mean(values: list[float]) -> Mean:
    if not values:
        return Mean(math.nan, math.nan)
    error = float(np.std(values, ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else math.nan
    return Mean(float(np.mean(values)), error)
