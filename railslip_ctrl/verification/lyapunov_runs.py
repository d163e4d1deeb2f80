"""V, V', s s', the bound of (40) and theta_hat along a nonlinear braking run, and how long each condition holds.

The nonlinear half of the verification: the conditions of `sliding` are judged on what the simulated wheel does, with
the actuator and without. s' is that of the true state, from the plant's own rates; nothing of the closed form under the
law is assumed, as behind an actuator the torque is not what the law asks for.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from railslip_ctrl.controllers.sliding import Sliding
from railslip_ctrl.core.arguments import Floats
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.model.numeric import numeric_plant, plant_parameters
from railslip_ctrl.model.vehicle import Actuator, Rail
from railslip_ctrl.simulation import Run, Scenario, Signals, simulate

from .reaching import theta_function

TAIL = 1.0 / 3.0  #: share of a stage, at its end, over which the ultimate bound of abs(s) is taken


@dataclass(frozen=True)
class LyapunovSignals:
    """Along a run, arrays over its samples but the last, which has no next one for V' to be taken to.

    time (s); s (m/s); s_rate (m/s^2); V and V_rate: s^2/2 and, where it adapts, (46), (m/s)^2 and (m/s)^2/s;
    V_rate_constant: V' without what changes of the true theta (mass step, drift of B) add; asked and available: |d| of
    (40) and K + D|s| in its place, N*m, (J/r) times (40); theta_hat, theta: (n, 2), 1/(kg m) and m/s.
    """

    time: Floats
    s: Floats
    s_rate: Floats
    V: Floats
    V_rate: Floats
    V_rate_constant: Floats
    asked: Floats
    available: Floats
    theta_hat: Floats
    theta: Floats


@dataclass(frozen=True)
class AlongRun:
    """How a condition fared: share of the time it held, and when it was first violated, s (NaN: never)."""

    name: str
    share: float
    first_violation: float

    @property
    def holds(self) -> bool:
        """Whether it held all the time."""
        return math.isnan(self.first_violation)


@dataclass(frozen=True)
class UltimateBound:
    """Largest |s|, m/s, and slip error over the last third of a stage from `start` to `end`, s."""

    start: float
    end: float
    s: float
    slip_error: float


@dataclass(frozen=True)
class LyapunovRun:
    """A run judged; `actuator` tells whether lag and dead time were in it."""

    run: Run
    actuator: bool
    signals: LyapunovSignals
    conditions: tuple[AlongRun, ...]
    ultimate: tuple[UltimateBound, ...]

    def condition(self, name: str) -> AlongRun:
        """One of the conditions by name; KeyError for another."""
        return {condition.name: condition for condition in self.conditions}[name]


def judge_run(scenario: Scenario, controller: Sliding, *, actuator: bool = True, seed: int | None = 0) -> LyapunovRun:
    """Simulate the scenario and judge the conditions along it.

    `actuator=False` takes lag and dead time away: the torque acts at once, as the proof assumes. `seed` is the noise's;
    None without it.
    """
    if not actuator:
        ideal = scenario.vehicle.model_copy(update={"actuator": Actuator(dead_time=0.0, lag=0.0)})
        scenario = scenario.model_copy(update={"vehicle": ideal})
    run = simulate(scenario, controller, seed=seed)
    signals = lyapunov_signals(run)
    return LyapunovRun(run, actuator, signals, _conditions(signals), _ultimate(run))


def lyapunov_signals(run: Run) -> LyapunovSignals:
    """V and what belongs to it along a run of a `Sliding` that was recorded at every sample."""
    controller, signals = _recorded(run)
    vehicle, gains = run.scenario.vehicle, controller.gains
    J, r = vehicle.effective_inertia, vehicle.wheel.radius
    s = run.controller_signals["s"]
    s_rate, undisturbed_rate = (_surface_rate(run, disturbed=flag) for flag in (True, False))
    theta_hat = np.column_stack([run.controller_signals[f"theta{i}_hat"] for i in (1, 2)])
    theta = _theta(run)
    V, V_rate, V_rate_constant = 0.5 * s**2, s * s_rate, s * s_rate
    for i, gain in enumerate((gains.k1, gains.k2)):
        if gain > 0:
            error = theta[:, i] - theta_hat[:, i]
            V = V + error**2 / (2 * gain)
            V_rate = V_rate + error * _forward_rate(signals.time, error) / gain
            V_rate_constant = V_rate_constant - error * _forward_rate(signals.time, theta_hat[:, i]) / gain
    asked, available = (J / r) * np.abs(s_rate - undisturbed_rate), gains.K + gains.D * np.abs(s)
    found = (signals.time, s, s_rate, V, V_rate, V_rate_constant, asked, available, theta_hat, theta)
    return LyapunovSignals(*(one[:-2] for one in found))  # the last row is the stop itself, between samples


def _recorded(run: Run) -> tuple[Sliding, Signals]:
    assert isinstance(run.controller, Sliding), "the law must be the sliding-mode law"
    assert run.signals is not None, "the run must be recorded"
    return run.controller, run.signals


def _surface_rate(run: Run, *, disturbed: bool) -> Floats:
    """s' = lambda_d v' - sigma' + rho e, m/s^2, from the plant's rates; without Tr, Td and Fr if not `disturbed`."""
    scenario, (controller, signals) = run.scenario, _recorded(run)
    rate = np.empty(signals.time.size)
    for rail, factor, part in _stages(run):
        law = scenario.law(rail, factor)
        p: list[Any] = list(plant_parameters(law, scenario.vehicle))
        p[0], p[2] = signals.mass[part], _viscous(scenario, signals.time[part])
        if not disturbed:
            p[4] = p[5] = p[6] = 0.0
        Tr = scenario.vehicle.wheel.radius * signals.random_force[part] * disturbed
        Td = signals.disturbance[part] * disturbed
        v, sigma, reference = signals.speed[part], signals.slip_velocity[part], signals.reference[part]
        state = (v, sigma, signals.adhesion_state[part], signals.torque[part])
        rates = numeric_plant(type(law)).rates(*state, Td, Tr, tuple(p))
        rate[part] = reference * rates[0] - rates[1] + controller.gains.rho * (reference * v - sigma)
    return rate


def _viscous(scenario: Scenario, time: Floats) -> Floats:
    """B(t), effective, N m s."""
    own = scenario.vehicle.wheel.viscous_friction + scenario.viscous_rate * time
    least = -math.inf if scenario.viscous_least is None else scenario.viscous_least
    return np.asarray(scenario.vehicle.inertia_scale * np.maximum(own, least))


def _stages(run: Run) -> list[tuple[Rail, float, slice]]:
    """Rail, adhesion factor and the samples of each stretch between events that change the rail."""
    scenario, (_, signals) = run.scenario, _recorded(run)
    changes: list[tuple[int, Rail, float]] = [(0, scenario.rail, scenario.adhesion_factor)]
    for event in sorted(scenario.events, key=lambda event: _first_sample(event, signals)):
        if event.rail is not None or event.adhesion_factor is not None:
            _, rail, factor = changes[-1]
            factor = factor if event.adhesion_factor is None else event.adhesion_factor
            changes.append((_first_sample(event, signals), event.rail or rail, factor))
    ends = [start for start, _, _ in changes[1:]] + [signals.time.size]
    return [(rail, factor, slice(start, end)) for (start, rail, factor), end in zip(changes, ends, strict=True)]


def _first_sample(event: Any, signals: Signals) -> int:
    """Number of the first sample at which an event is in force."""
    place, axis = (event.time, signals.time) if event.time is not None else (event.distance, signals.distance)
    return int(np.searchsorted(axis, place - 1e-9 * max(1.0, place)))


def _theta(run: Run) -> Floats:
    """The true theta along the run, (n, 2): it steps with the mass and drifts with B(t)."""
    scenario, (controller, signals) = run.scenario, _recorded(run)
    vehicle, scale = scenario.vehicle, scenario.vehicle.inertia_scale
    Mn = scale * (vehicle.mass if controller.nominal_mass is None else controller.nominal_mass)
    given = controller.nominal_viscous_friction
    Bn = scale * (vehicle.wheel.viscous_friction if given is None else given)
    B = _viscous(scenario, signals.time)
    theta = theta_function()(vehicle.wheel.radius, vehicle.effective_inertia, Mn, signals.mass - Mn, B - Bn)
    return np.column_stack([np.broadcast_to(component, signals.time.shape) for component in theta])


def _forward_rate(time: Floats, values: Floats) -> Floats:
    """Rate over the coming sample; the last has none and is NaN."""
    return np.append(np.diff(values) / np.diff(time), math.nan)


def _conditions(signals: LyapunovSignals) -> tuple[AlongRun, ...]:
    """s s' < 0; V' <= 0; the same without what the changes of the true theta add; K + D|s| > (J/r)|d|.

    Shares of the time, each sample weighted with the time to the next. A sampled relay cannot do better than to carry s
    across 0 within the sample, which counts as held.
    """
    weight = np.append(np.diff(signals.time), 0.0)
    crosses = np.append(signals.s[:-1] * signals.s[1:] <= 0, False)
    judged = {
        "sliding": (signals.s * signals.s_rate < 0) | crosses,
        "Lyapunov": (signals.V_rate <= 0) | crosses,
        "Lyapunov, theta constant": (signals.V_rate_constant <= 0) | crosses,
        "reaching (40)": signals.available > signals.asked,
    }
    found = []
    for name, held in judged.items():
        broken = np.flatnonzero(~held)
        share = float(weight[held].sum() / weight.sum())
        found.append(AlongRun(name, share, float(signals.time[broken[0]]) if broken.size else math.nan))
    return tuple(found)


def _ultimate(run: Run) -> tuple[UltimateBound, ...]:
    (_, signals), s, bounds = _recorded(run), run.controller_signals["s"], []
    for _, _, part in _stages(run):
        time = signals.time[part]
        if time.size < 2:  # an event after the end
            continue
        late = time >= time[-1] - TAIL * (time[-1] - time[0])
        error = np.abs(signals.slip[part] - signals.reference[part])
        largest = (float(np.abs(s[part][late]).max()), float(error[late].max()))
        bounds.append(UltimateBound(float(time[0]), float(time[-1]), *largest))
    return tuple(bounds)
