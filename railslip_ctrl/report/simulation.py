"""Results of a braking run as text, JSON and CSV, and a comparison of controllers as text."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import RenderableType

from railslip_ctrl import simulation
from railslip_ctrl.controllers.base import torque_range
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion import named_law
from railslip_ctrl.model.vehicle import notes_and_warnings
from railslip_ctrl.simulation.bound import ControllerRow, RunComparison
from railslip_ctrl.simulation.run import GIVEN_DRAWS, events_log

from .document import Facts, Table, fixed, heading, render
from .export import exported, law_json, law_text, number, plain, source_of
from .text import vehicle_facts

CSV_COLUMNS = {
    "time": "time [s]",
    "distance": "distance [m]",
    "speed": "train speed [m/s]",
    "slip_velocity": "slip velocity [m/s]",
    "slip": "slip ratio [1]",
    "wheel_speed": "wheel angular speed [rad/s]",
    "adhesion_state": "adhesion state [m]",
    "adhesion_force": "adhesion force [N]",
    "random_force": "random adhesion force [N]",
    "command": "commanded torque [N*m]",
    "torque": "brake torque [N*m]",
    "disturbance": "disturbance torque [N*m]",
    "mass": "effective mass [kg]",
    "reference": "reference slip [1]",
    "locked": "locked [1]",
    "measured_speed": "measured train speed [m/s]",
    "measured_wheel_speed": "measured wheel angular speed [rad/s]",
}
"""Column title in the CSV file for each field of `Signals`; `railslip identify` can read this file."""

_WORKS = {
    "brake": "brake, torque times wheel speed",
    "slip": "slip, adhesion force times slip velocity",
    "viscous": "viscous torque",
    "resistance": "travelling resistance",
    "random_force": "random adhesion force",
    "disturbance": "caliper disturbance",
}


def simulation_json(run: simulation.Run, gains: str | None, law_speed: float) -> dict[str, Any]:
    """Return the results of a run as JSON; time, distance, energy and slip error are null if the train did not stop.

    - gains: column of [Park2008] Table 4 that gives the gains; None for other gains.
    - law_speed: initial speed v0 for which a published adhesion law is computed, m/s.
    """
    scenario = run.scenario
    of_stop = {
        "braking_time_s": "braking_time",
        "braking_distance_m": "braking_distance",
        "brake_energy_j": "brake_energy",
        "mean_abs_slip_error": "mean_abs_slip_error",
        "mean_abs_slip_error_published": "mean_abs_slip_error_published",
    }
    ends = {"max_torque_nm": "max_torque", "ended_at_s": "braking_time", "ended_at_m": "braking_distance"}
    rates = {"max_torque_rate_nm_per_s": "max_torque_rate", "rms_torque_rate_nm_per_s": "rms_torque_rate"}
    ends |= {"first_lock_s": "first_lock", **rates}
    return {
        "scenario": scenario.name,
        "controller": run.controller.label,
        "gains": gains,
        "inertia_scale": scenario.vehicle.inertia_scale,
        **exported(run if run.stopped else None, **of_stop),
        **exported(run, "seed", "stopped", "max_slip", "locked_fraction", "outcome", **ends),
        "final_speed_kmh": number(run.final_speed / KMH),
        "gain_values": run.controller.gain_values(),
        "reference_slip": plain(run.controller.reference),
        "adhesion": scenario.adhesion.name,
        "adhesion_law": law_json(scenario.adhesion, _law_source(scenario, law_speed)),
        "vehicle": scenario.vehicle.name,
        "notes": list(notes_and_warnings(scenario.vehicle)),
        "step_s": scenario.step,
        "period_s": _period(run),
        **exported(scenario, "limits", "measurement", "disturbances"),
        "events": [
            {**plain(log.event), "reached": log.reached, "happened_at_s": number(log.time)} for log in events_log(run)
        ],
        "energy_balance": {
            **exported(run.energies, "error", starting_j="starting", booked_j="booked", final_j="final"),
            **{f"{name}_j": number(work) for name, work in run.energies.works.items()},
        },
    }


def _law_source(scenario: simulation.Scenario, law_speed: float) -> str:
    return source_of(scenario.adhesion, lambda: named_law(scenario.adhesion.name, scenario.vehicle, law_speed))


def simulation_text(run: simulation.Run, law_speed: float) -> str:
    """Return the report on a run as text; the run must be recorded if an event of its scenario is given by distance.

    `law_speed` is the initial speed v0 for which a published adhesion law is computed, m/s.
    """
    scenario = run.scenario
    end = f"after {run.braking_time:.4g} s and {run.braking_distance:.5g} m, at {run.final_speed / KMH:.3g} km/h"
    unfinished = f"NO STOP: {run.outcome.value}, {end}; the numbers below cover the time up to this end"
    outcome = f"reached the final speed {end}" if run.stopped else unfinished
    parts: list[RenderableType] = [
        heading(f"Braking run: {scenario.name}, controller {run.controller.label}"),
        Facts([*_scenario_facts(run, law_speed), *_controller_facts(run)]),
        f"\nOutcome: {outcome}\n",
        heading("Numbers", "-"),
        Facts(_numbers(run)),
        "",
        heading("Energy balance", "-"),
        _energy_table(run),
    ]
    return render(parts)


def _scenario_facts(run: simulation.Run, law_speed: float) -> list[tuple[str, str]]:
    scenario, noise, sensors = run.scenario, run.scenario.disturbances, run.scenario.measurement
    law = law_text(scenario.adhesion, _law_source(scenario, law_speed))
    numbers = {name: value for name, value in scenario.adhesion.model_dump().items() if isinstance(value, float)}
    weaker = "" if scenario.adhesion_factor == 1.0 else f", adhesion times {scenario.adhesion_factor:g}"
    least = "" if scenario.viscous_least is None else f", at least {scenario.viscous_least:g} N·m·s"
    viscous = f"changes by {scenario.viscous_rate:g} N·m·s per second" if scenario.viscous_rate else "constant"
    speeds = f"{scenario.initial_speed / KMH:g} to {scenario.final_speed / KMH:g} km/h"
    return [
        *vehicle_facts(scenario.vehicle),
        ("Initial load", f"mass {scenario.vehicle.mass:g} kg, wheel load {scenario.vehicle.wheel_load:g} N"),
        ("Viscous friction", f"{viscous}{least}"),
        *([("Gradient", f"{scenario.gradient:+g}")] if scenario.gradient else []),
        ("Brake limits", _limits(scenario)),
        *_believed(scenario),
        ("Adhesion", f"{law}, {scenario.adhesion.title}; {scenario.rail} rail at the start{weaker}"),
        ("Adhesion, SI", ", ".join(f"{name} {value:.6g}" for name, value in numbers.items()) or "table"),
        ("Speeds", f"{speeds}; time limit {scenario.longest_time:g} s"),
        *(("Event", item.text) for item in events_log(run)),
        (
            "Disturbances",
            f"random force {noise.random_force:g} N (1 sigma), constant for {noise.random_hold:g} s; caliper torque "
            f"{noise.caliper_fraction:g} times the acting one, decay rate {noise.caliper_decay:g} 1/s, frequency "
            f"{noise.caliper_frequency:.5g} rad/s",
        ),
        (
            "Measurement",
            f"train speed: scale {sensors.speed_scale:g}, noise {sensors.speed_noise:g} m/s (1 sigma), resolution "
            f"{sensors.speed_quantum:g} m/s; wheel speed: noise {sensors.wheel_noise:g} rad/s, resolution "
            f"{sensors.wheel_quantum:g} rad/s, encoder with {sensors.encoder_teeth:g} teeth (0: none); filter "
            f"{sensors.filter_time:g} s",
        ),
    ]


def _limits(scenario: simulation.Scenario) -> str:
    limits, lag = scenario.limits, scenario.vehicle.actuator.lag
    rate = "no rate limit" if limits.rate is None else f"rate at most {limits.rate:g} N·m/s"
    dump = lag if limits.dump_lag is None else limits.dump_lag
    most = math.inf if limits.torque_max is None else limits.torque_max
    torque = torque_range(limits.torque_min, most)
    acting = "" if limits.torque_gain == 1.0 else f", acting torque {limits.torque_gain:g} times the commanded one"
    return f"commanded torque {torque}{acting}, {rate}, lag {dump:g} s for falling torque"


def _believed(scenario: simulation.Scenario) -> list[tuple[str, str]]:
    units = scenario.beliefs.units()
    texts = [
        f"{name.replace('_', ' ')} {value:g} {units[name]}" for name, value in scenario.beliefs if value is not None
    ]
    return [("Controllers assume", ", ".join(texts))] if texts else []


def _controller_facts(run: simulation.Run) -> list[tuple[str, str]]:
    controller, reference = run.controller, run.controller.reference
    noise = "none: neither random force nor measurement noise" if run.seed is None else str(run.seed)
    noise = "random numbers from a file" if run.seed == GIVEN_DRAWS else noise
    return [
        ("Controller", controller.described()),
        ("Controller's limits", controller.limits_described()),
        ("Reference slip", "none" if reference is None else f"{reference.dry:g} dry, {reference.wet:g} wet"),
        ("Sampling", f"every {_period(run):g} s; integrated in steps of at most {run.scenario.step:g} s"),
        ("Noise seed", noise),
    ]


def _period(run: simulation.Run) -> float:
    return run.scenario.step if run.controller.period is None else run.controller.period


def _numbers(run: simulation.Run) -> list[tuple[str, str]]:
    rows = [
        ("Braking time", f"{fixed(run.braking_time)} s"),
        ("Braking distance", f"{fixed(run.braking_distance)} m"),
        ("Brake energy", f"{fixed(run.brake_energy)} J"),
    ]
    if run.controller.reference is not None:
        rows.append(("Mean |slip error|", f"{fixed(run.mean_abs_slip_error, 4)} from the reference of the run"))
    if not math.isnan(run.mean_abs_slip_error_published):
        published = fixed(run.mean_abs_slip_error_published, 4)
        rows.append(("", f"{published} from the published 0.132 dry, 0.092 wet"))
    lock = "never" if np.isnan(run.first_lock) else f"first at {run.first_lock:.4g} s"
    return [
        *rows,
        ("Highest slip", fixed(run.max_slip, 4) + ("" if run.reached else ", does not reach the reference slip")),
        ("Wheel locked", f"{100 * run.locked_fraction:.3g} % of the time, {lock}"),
        ("Highest torque", f"{fixed(run.max_torque)} N·m"),
        ("Torque rate", f"{fixed(run.rms_torque_rate, 4)} N·m/s rms, {fixed(run.max_torque_rate, 4)} N·m/s at most"),
    ]


def _energy_table(run: simulation.Run) -> RenderableType:
    energies = run.energies

    def row(name: str, value: float) -> tuple[str, str, str]:
        return name, f"{value / 1000:.3f}", f"{100 * value / energies.starting:.3f}"

    rows = [
        row("kinetic, at the start", energies.starting),
        row("added by mass changes", energies.booked),
        *(row(f"removed by {_WORKS[name]}", -work) for name, work in energies.works.items()),
        row("kinetic, at the end", energies.final),
        ("energy balance error", f"{energies.error * energies.starting / 1000:.1e}", f"{100 * energies.error:.1e}"),
    ]
    return Table(("Energy", "kJ", "% of the start"), rows)


def write_simulation_csv(run: simulation.Run, path: Path, *, internal: bool = False) -> None:
    """Write the time series of a recorded run as CSV: a header with units, and one row for each sample.

    If `internal`, the controller's internal state is written too.
    """
    signals = run.signals
    assert signals is not None, "the run was recorded"
    own = run.controller_signals if internal else {}
    names = [*(CSV_COLUMNS[name] for name in simulation.Signals._fields), *(f"controller {name}" for name in own)]
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(",".join(names) + "\n")
        np.savetxt(file, np.column_stack([*signals, *own.values()]), fmt="%.12g", delimiter=",")


COLUMNS = (
    *("Controller", "Dist. m", "± m", "over bound %", "Time s", "Slip error", "error [P]"),
    *("Max slip", "Locked s", "Energy MJ", "Rate kN·m/s"),
)


def run_comparison_text(comparison: RunComparison) -> str:
    """Return a table of controllers: means over the seeds, and the standard error of the mean distance."""
    scenario, bound = comparison.scenario, comparison.bound
    parts: list[RenderableType] = [
        heading(f"Braking runs: {scenario.name}, inertia scale {scenario.vehicle.inertia_scale:g}"),
        (
            f"Means over {len(comparison.seeds)} seeds, the same noise for all. No controller can stop in less than "
            f"{bound.braking_distance:.1f} m and {bound.braking_time:.2f} s, the bound with the highest adhesion at "
            "every moment after the dead time. Slip error: mean |slip - reference|, if there is a reference; error "
            "[P]: with 0.132/0.092 of [Park2008] as reference; rate: rms of the rate of the acting torque."
        ),
        Table(COLUMNS, [_row(row, bound.braking_distance) for row in comparison.rows], whole=1),
    ]
    for row in comparison.rows:
        ended = row.outcomes.items() if row.stopped < row.runs else ()
        parts += [f"{row.name}: {count} of {row.runs} runs {how}." for how, count in ended if how != "stopped"]
    return render(parts)


def _row(row: ControllerRow, bound: float) -> tuple[str, ...]:
    return (
        row.name,
        f"{row.braking_distance.value:.1f}",
        fixed(row.braking_distance.error, 2),
        fixed(100 * row.beyond_bound.value / bound, 3),
        fixed(row.braking_time.value, 4),
        fixed(row.slip_error.value, 3),
        fixed(row.slip_error_published.value, 3),
        fixed(row.max_slip.value, 3),
        f"{row.lock_time.value:.2f}",
        fixed(row.brake_energy.value / 1e6, 4),
        fixed(row.rms_torque_rate.value / 1e3, 3),
    )
