"""Lower bound of the stopping distance for any controller, and a comparison of controllers with this bound."""

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
from .scenario import Event, Scenario, event_position

_SPEEDS = 33  # number of speeds at which the peak adhesion is computed, and between which it is interpolated
_TOLERANCE = 1e-9  # relative tolerance of the integration
_FAR = 1e6  # m, replaces an infinite distance, through which the optimiser could not fit a parabola


@dataclass(frozen=True)
class ClairvoyantStop:
    """Braking time, s, and braking distance, m, of a stop; infinite if the train does not stop."""

    braking_time: float
    braking_distance: float


def clairvoyant_stop(scenario: Scenario) -> ClairvoyantStop:
    """Return lower bounds of braking time and distance in a scenario, for any controller.

    The ideal controller keeps the slip of highest adhesion (`numeric.peak`) as soon as the brake allows it. The brake
    torque begins to rise after the dead time, and not faster than the rate limit. If the scenario has a largest torque,
    the torque also rises with the lag. Without a largest torque the lag is neglected, because a large command overcomes
    it. The inertia of the wheel is neglected: the adhesion torque r Fa is at most the brake torque plus the viscous
    torque B v/r. The random force, whose mean is zero, is left out.

    InputError if some events are at a time and others at a distance, because their order depends on the controller.
    """
    kinds = {event.time is None for event in scenario.events}
    if len(kinds) > 1:
        raise InputError(
            "events: some have a time, others a distance; to compute the bound of a stop, give times only or distances "
            "only"
        )
    by_distance = kinds == {True}
    places = sorted({event_position(event) for event in scenario.events})
    state, start = np.array([scenario.initial_speed, 0.0]), 0.0
    for i in range(len(places) + 1):
        until = places[i] if i < len(places) else math.inf
        begin = places[i - 1] if i else -1.0
        past = [event for event in scenario.events if event_position(event) <= begin]
        solution = _brake(scenario, past, start, state, until, by_distance=by_distance)
        start, state = float(solution.t[-1]), solution.y[:, -1]
        if solution.t_events[0].size:
            return ClairvoyantStop(start, float(state[1]))
        if start >= scenario.longest_time:
            break
    return ClairvoyantStop(math.inf, math.inf)


def _after(scenario: Scenario, past: list[Event]) -> tuple[float, Floats, Floats]:
    """Effective mass, kg, speeds, m/s, 1-D, and highest adhesion force at each speed, N, after the `past` events."""
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


_SWITCHES = 9  # number of equally spaced times that are tried first for the end of the full torque
_MOST_SLIP = 0.4  # largest slip ratio up to which full torque is tried; the shortest stops need less
_SAMPLES = 100  # number of times at which the command that holds the slip is compared with its limits
_SLACK = 0.02  # excess of this command over its limits that is accepted as numerical error, relative to `torque_max`


def attainable_stop(scenario: Scenario) -> ClairvoyantStop:
    """Search for the shortest stop of a controller that knows rail and vehicle exactly, without noise.

    The controller commands the largest torque, then no torque until the slip stops rising. Then it holds this slip
    ratio, or lets it decay to a smaller value. The search varies the time at which the torque is switched off, the
    final slip and the decay time. Time and distance are infinite if no stop is found.

    In contrast to `clairvoyant_stop`, the dynamics of adhesion and wheel are included. The shortest possible distance
    is therefore between the results of the two functions.

    InputError for a scenario without a largest torque, or with a rate limit or events.
    """
    limits = scenario.limits
    if limits.torque_max is None or limits.rate is not None or scenario.events:
        raise InputError(
            "scenario: the attainable stop needs a brake with torque_max and without a rate limit, and a scenario "
            "without events; change the scenario"
        )
    path = _Path(scenario)
    latest = path.latest
    first = scenario.vehicle.actuator.dead_time
    switches = np.linspace(first, latest, _SWITCHES + 2)[1:-1]
    stops = [path.stop(float(switch)) for switch in switches]
    at = int(np.argmin([stop.braking_distance for stop in stops]))
    ends = switches[max(at - 1, 0)], switches[min(at + 1, _SWITCHES - 1)]
    holding = minimize_scalar(lambda x: min(path.stop(x).braking_distance, _FAR), bounds=ends, method="bounded")
    candidates = [path.stop(float(holding.x)), stops[at]]
    if path.stop(float(holding.x), *_LESS).braking_distance < candidates[0].braking_distance:  # decay is better
        best = minimize(
            lambda x: path.stop(*x.tolist()).braking_distance,
            [holding.x, *_LESS],
            method="Nelder-Mead",
            options={"fatol": 0.02, "xatol": 0.02, "maxfev": 80},
        )
        candidates.append(path.stop(*best.x.tolist()))
    return min(candidates, key=lambda stop: stop.braking_distance)


class _Path:
    """Braking runs without noise; the states are speed, slip velocity, adhesion state, torque and distance."""

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
        """Time, s, at which the slip ratio under the largest torque reaches `_MOST_SLIP`, or the end of the run."""
        return float(self._full.t[-1])

    def stop(self, switch: float, share: float = 1.0, time: float = 1.0) -> ClairvoyantStop:
        """Simulate a stop: full torque until `switch`, s, none until the slip stops rising, then a decay of the slip.

        The final slip is the ratio `share` of the slip at which the decay begins; half of the decay takes `time`, s.
        """
        try:
            return self._stop(switch, share, time)
        except ValueError:  # SciPy: the interpolation has no sign change at the event
            return ClairvoyantStop(math.inf, math.inf)

    def _stop(self, switch: float, share: float, time: float) -> ClairvoyantStop:
        never = ClairvoyantStop(math.inf, math.inf)
        released = self._driven(0.0)

        def rests(t: float, y: Floats) -> float:
            rates = released(t, y)
            return float(rates[1] * y[0] - y[1] * rates[0])

        rests.terminal, rests.direction = True, -1.0  # type: ignore[attr-defined]
        if not (self._actuator.dead_time < switch < self.latest and 0 < share <= 1 and time > _LEAST_TIME):
            return never
        begin = self._full.sol(switch)
        if self._actuator.lag == 0:  # the torque drops at once, so the slip is held from now on
            return self._hold(switch, begin, share, time)
        if rests(switch, begin) <= 0:
            return never
        back = solve_ivp(released, (switch, switch + _LONGEST_BACK), begin, events=rests, **_SOLVER)
        if not back.t_events[0].size or back.y[1, -1] > _MOST_SLIP * back.y[0, -1]:
            return never
        return self._hold(float(back.t[-1]), back.y[:, -1], share, time)

    def _hold(self, start: float, begin: Floats, share: float, time: float) -> ClairvoyantStop:
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
        solution = solve_ivp(rates, (start, end), begin[[0, 2, 4]], events=stopped, dense_output=True, **_SOLVER)
        if not solution.t_events[0].size:
            return ClairvoyantStop(math.inf, math.inf)
        times = np.linspace(start, float(solution.t[-1]), _SAMPLES)
        torque = self._holding_torque(times, solution.sol(times)[0], solution.sol(times)[1], slip)
        command = torque + self._actuator.lag * np.gradient(torque, times)
        if command[1:].max() > (1 + _SLACK) * self._most or command.min() < -_SLACK * self._most:
            return ClairvoyantStop(math.inf, math.inf)
        return ClairvoyantStop(float(solution.t[-1]), float(solution.y[2, -1]))

    def _holding_torque(self, t: Floats, speed: Floats, state: Floats, slip: Callable[[Floats], Floats]) -> Floats:
        ratio, rate = slip(t), (slip(t + _STEP) - slip(t - _STEP)) / (2 * _STEP)
        change, at_zero, _ = self._plant(t, speed, ratio * speed, state, 0.0)
        at_unit = self._plant(t, speed, ratio * speed, state, 1.0)[1]  # the rate of sigma is linear in the torque
        return np.asarray((ratio * change + rate * speed - at_zero) / (at_unit - at_zero))

    def _plant(self, t: Any, speed: Any, sigma: Any, state: Any, torque: float) -> tuple[Any, Any, Any]:
        """Return the time derivatives of speed, slip velocity and adhesion state."""
        rates = self._rates(speed, sigma, state, torque, 0.0, self._scenario.viscous_rate * t, self._parameters)
        return rates[0], rates[1], rates[2] if len(rates) > 2 else 0.0

    def _driven(self, command: float) -> Callable[[float, Floats], list[float]]:
        """Return the right-hand side of the differential equations for a constant command, N*m."""

        def rates(t: float, y: Floats) -> list[float]:
            lag = self._actuator.lag
            torque = y[3] if lag > 0 else command
            return [*self._plant(t, y[0], y[1], y[2], torque), (command - y[3]) / lag if lag > 0 else 0.0, y[0]]

        return rates


_SOLVER: dict[str, Any] = {"method": "LSODA", "rtol": 1e-6, "atol": 1e-7}
_STEP = 1e-4  # s, step of the difference for the rate of the slip ratio
_LEAST_TIME = 0.05  # s, shortest decay time of the slip ratio that is tried
_LESS = (0.6, 1.0)  # start of the search with decay: `share` and decay time, s, of `stop`
_LONGEST_BACK = 5.0  # s, longest time without torque until the slip stops rising


@dataclass(frozen=True)
class Mean:
    """Mean over the runs in which the train stopped, and its standard error; NaN if there are too few of these runs."""

    value: float
    error: float


@dataclass(frozen=True)
class ControllerRow:
    """Results of a controller over all seeds; the means are over the runs in which the train stopped.

    - runs, stopped: number of runs, and number of runs in which the train stopped.
    - outcomes: number of runs by outcome.
    - lock_time: time with r omega < 0.02 v, s.
    - beyond_bound: braking distance minus that of `clairvoyant_stop`, m.

    The other fields are those of `Run`, in SI units.
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
    """Comparison of controllers in a `scenario` over all `seeds`: `rows` contains one row for each controller.

    `bound` is the result of `clairvoyant_stop`: lower bounds of braking time and distance.
    """

    scenario: Scenario
    seeds: tuple[int, ...]
    bound: ClairvoyantStop
    rows: tuple[ControllerRow, ...]

    def __str__(self) -> str:
        text = import_module("railslip_ctrl.report.simulation")  # imported here, because `report` imports this
        return str(text.run_comparison_text(self))

    def row(self, name: str) -> ControllerRow:
        """Return the row of a controller by name; KeyError for an unknown name."""
        return {row.name: row for row in self.rows}[name]


@checked
def compare_runs(scenario: Scenario, controllers: Mapping[str, Any], seeds: Sequence[int]) -> RunComparison:
    """Simulate every controller in the scenario with every seed, on all cores.

    - scenario: the braking run.
    - controllers: dictionary with names as keys and controllers, which `simulate` accepts, as values.
    - seeds: seeds of the noise, one for each run; all controllers have the same noise.
    """
    bound = clairvoyant_stop(scenario)
    simulators = {name: Simulator(scenario, controller) for name, controller in controllers.items()}
    with ThreadPoolExecutor() as pool:  # the kernel releases the interpreter's lock
        rows = [_row(name, list(pool.map(simulator.run, seeds)), bound) for name, simulator in simulators.items()]
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
