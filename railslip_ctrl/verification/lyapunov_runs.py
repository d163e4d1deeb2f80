"""Evaluation of V, V', s s', the reaching condition ([Park2008] (40)) and theta_hat along nonlinear braking runs.

The result is the share of time in which a condition holds. s' comes from the plant's rates at the true state, because
with an actuator the torque differs from the law's command.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from railslip_ctrl.controllers.sliding import Sliding
from railslip_ctrl.core.arguments import Floats
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.model.numeric import numeric_plant, plant_parameters
from railslip_ctrl.model.vehicle import Actuator
from railslip_ctrl.simulation import Run, Scenario, Signals, simulate

from .reaching import derived

TAIL = 1.0 / 3.0  #: share of a stage, at its end, in which the ultimate bound of abs(s) is computed


@dataclass(frozen=True)
class LyapunovSignals:
    """Lyapunov function and related signals along a run, without the last two samples, where V' is not known.

    - time (s), s (m/s), s_rate (m/s^2).
    - V, V_rate: V in (m/s)^2 and V' in (m/s)^2/s. V is s^2/2, or (46) of [Park2008] for a law with adaptation.
    - V_rate_constant: V' without the terms from changes of the true theta, which changes with the mass and B.
    - asked, available: the two sides of (40) times J/r: (J/r)|d| and K + D|s|, N*m.
    - theta_hat, theta: estimates and true values, (n, 2), 1/(kg m) and m/s.
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
    """A condition along a run: share of time in which it holds; time of the first violation, s, or NaN if none."""

    name: str
    share: float
    first_violation: float

    @property
    def holds(self) -> bool:
        """True if the condition held during the whole run."""
        return math.isnan(self.first_violation)


@dataclass(frozen=True)
class LyapunovRun:
    """A run and its conditions; `ultimate`: largest |s|, m/s, and slip error in the last third of each stage."""

    run: Run
    signals: LyapunovSignals
    conditions: tuple[AlongRun, ...]
    ultimate: tuple[tuple[float, float], ...]

    def condition(self, name: str) -> AlongRun:
        """Return the condition called `name`; KeyError if there is none."""
        return {condition.name: condition for condition in self.conditions}[name]


def judge_run(scenario: Scenario, controller: Sliding, *, actuator: bool = True, seed: int | None = 0) -> LyapunovRun:
    """Simulate a scenario, without lag and dead time if not `actuator`, and evaluate the conditions along it."""
    if not actuator:
        ideal = scenario.vehicle.model_copy(update={"actuator": Actuator(dead_time=0.0, lag=0.0)})
        scenario = scenario.model_copy(update={"vehicle": ideal})
    run = simulate(scenario, controller, seed=seed)
    assert isinstance(run.controller, Sliding), "the run has the same kind, with the vehicle's parameters"
    assert run.signals is not None, "the run was recorded"
    stages, s = _stages(scenario, run.signals), run.controller_signals["s"]
    signals, ultimate = _lyapunov_signals(run, run.controller, run.signals, stages), []
    for _, part in stages:
        time = run.signals.time[part]
        if time.size >= 2:  # false for an event after the end
            late = time >= time[-1] - TAIL * (time[-1] - time[0])
            error = np.abs(run.signals.slip[part] - run.signals.reference[part])
            ultimate.append((float(np.abs(s[part][late]).max()), float(error[late].max())))
    return LyapunovRun(run, signals, _conditions(signals), tuple(ultimate))


def _stages(scenario: Scenario, signals: Signals) -> list[tuple[AdhesionLaw, slice]]:
    # a stage ends when the rail changes

    def first_sample(event: Any) -> int:
        place, axis = (event.time, signals.time) if event.time is not None else (event.distance, signals.distance)
        return int(np.searchsorted(axis, place - 1e-9 * max(1.0, place)))

    rail, factor = scenario.rail, scenario.adhesion_factor
    changes = [(0, scenario.law(rail, factor))]
    for event in sorted(scenario.events, key=first_sample):
        if event.rail is not None or event.adhesion_factor is not None:
            rail, factor = event.rail or rail, factor if event.adhesion_factor is None else event.adhesion_factor
            changes.append((first_sample(event), scenario.law(rail, factor)))
    ends = [start for start, _ in changes[1:]] + [signals.time.size]
    return [(law, slice(start, end)) for (start, law), end in zip(changes, ends, strict=True)]


def _lyapunov_signals(
    run: Run, controller: Sliding, signals: Signals, stages: list[tuple[AdhesionLaw, slice]]
) -> LyapunovSignals:
    scenario, vehicle, gains = run.scenario, run.scenario.vehicle, controller.gains
    J, r, scale = vehicle.effective_inertia, vehicle.wheel.radius, vehicle.inertia_scale
    # the true theta steps with the mass and drifts with B(t)
    least = -math.inf if scenario.viscous_least is None else scenario.viscous_least
    B = scale * np.maximum(vehicle.wheel.viscous_friction + scenario.viscous_rate * signals.time, least)
    Mn, Bn = (
        scale * (own if given is None else given)
        for given, own in (
            (controller.nominal_mass, vehicle.mass),
            (controller.nominal_viscous_friction, vehicle.wheel.viscous_friction),
        )
    )
    found = derived("r J Mn Mp Bp", "theta")(r, J, Mn, signals.mass - Mn, B - Bn)
    theta = np.column_stack([np.broadcast_to(one, signals.time.shape) for one in found])
    theta_hat = np.column_stack([run.controller_signals[f"theta{i}_hat"] for i in (1, 2)])
    # s' = lambda_d v' - sigma' + rho e from the plant's rates, with all disturbances, and without Tr, Td and Fr
    rates = np.empty((2, signals.time.size))
    for law, part in stages:
        v, sigma, reference = signals.speed[part], signals.slip_velocity[part], signals.reference[part]
        state = (v, sigma, signals.adhesion_state[part], signals.torque[part])
        p: list[Any] = list(plant_parameters(law, vehicle))
        p[0], p[2] = signals.mass[part], B[part]
        Td, Tr = signals.disturbance[part], r * signals.random_force[part]
        for row, resistance, share in ((0, p[4:7], 1.0), (1, [0.0, 0.0, 0.0], 0.0)):
            known = (*p[:4], *resistance, *p[7:])
            v_rate, sigma_rate, _ = numeric_plant(type(law)).rates(*state, share * Td, share * Tr, known)
            rates[row, part] = reference * v_rate - sigma_rate + gains.rho * (reference * v - sigma)
    s, s_rate = run.controller_signals["s"], rates[0]

    def forward_rate(values: Floats) -> Floats:
        return np.append(np.diff(values) / np.diff(signals.time), math.nan)

    V, V_rate, V_rate_constant = 0.5 * s**2, s * s_rate, s * s_rate
    for i, gain in enumerate((gains.k1, gains.k2)):
        if gain > 0:
            error = theta[:, i] - theta_hat[:, i]
            V = V + error**2 / (2 * gain)
            V_rate = V_rate + error * forward_rate(error) / gain
            V_rate_constant = V_rate_constant - error * forward_rate(theta_hat[:, i]) / gain
    asked, available = (J / r) * np.abs(s_rate - rates[1]), gains.K + gains.D * np.abs(s)
    along = (signals.time, s, s_rate, V, V_rate, V_rate_constant, asked, available, theta_hat, theta)
    return LyapunovSignals(*(signal[:-2] for signal in along))  # the last row, the end of the stop, is between samples


def _conditions(signals: LyapunovSignals) -> tuple[AlongRun, ...]:
    # a sampled relay crosses 0 in every switching period, which is no violation
    weight = np.append(np.diff(signals.time), 0.0)
    crosses = np.append(signals.s[:-1] * signals.s[1:] <= 0, False)
    judged = {
        "sliding": (signals.s * signals.s_rate < 0) | crosses,
        "Lyapunov": (signals.V_rate <= 0) | crosses,
        "Lyapunov, theta constant": (signals.V_rate_constant <= 0) | crosses,
        "reaching (40)": signals.available > signals.asked,
    }
    found = []
    for name, satisfied in judged.items():
        broken = np.flatnonzero(~satisfied)
        share = float(weight[satisfied].sum() / weight.sum())
        found.append(AlongRun(name, share, float(signals.time[broken[0]]) if broken.size else math.nan))
    return tuple(found)
