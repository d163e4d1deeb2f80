"""A run as a row of numbers: what is kept of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from railslip_ctrl.simulation.run import Run

REFUSED = "values not allowed"
"""Outcome of a run whose sampled values a record refuses (a mass above the loaded mass): it was never started."""


@dataclass(frozen=True)
class Measure:
    """A number kept of every run: its column, what it is, its unit, how it is read.

    One `of_stop` is unknown of a run that did not stop. People are shown `scale` times the number, in `shown_unit`
    ("": as it is).
    """

    name: str
    title: str
    unit: str
    read: Callable[[Run], float]
    of_stop: bool = False
    scale: float = 1.0
    shown_unit: str = ""

    def of(self, run: Run) -> float | None:
        """The number of a run; None where it has none."""
        value = float(self.read(run)) if run.stopped or not self.of_stop else math.nan
        return None if math.isnan(value) else value

    @property
    def head(self) -> str:
        """What it is, with the unit people are shown."""
        return headed(self.title, self.shown_unit or self.unit)


def headed(title: str, unit: str) -> str:
    """The head of a column or axis: the unit in brackets, if there is one."""
    return title if unit in ("", "1") else f"{title} ({unit})"


MEASURES = (
    Measure("braking_time_s", "braking time", "s", lambda run: run.braking_time, of_stop=True),
    Measure("braking_distance_m", "braking distance", "m", lambda run: run.braking_distance, of_stop=True),
    Measure("brake_energy_j", "brake energy", "J", lambda run: run.brake_energy, True, 1e-6, "MJ"),
    Measure("mean_abs_slip_error", "mean abs slip error", "1", lambda run: run.mean_abs_slip_error, of_stop=True),
    Measure("max_slip", "highest slip", "1", lambda run: run.max_slip),
    Measure("locked_fraction", "share of time locked", "1", lambda run: run.locked_fraction),
    Measure("max_torque_nm", "highest torque", "N*m", lambda run: run.max_torque),
    Measure("rms_torque_rate", "rms torque rate", "N*m/s", lambda run: run.rms_torque_rate),
)
"""What statistics are made of."""

OTHERS = (
    Measure("ended_at_s", "time at the end, stop or not", "s", lambda run: run.braking_time),
    Measure("ended_at_m", "distance at the end, stop or not", "m", lambda run: run.braking_distance),
    Measure("first_lock_s", "first lock; null: never", "s", lambda run: run.first_lock),
    Measure("final_speed", "speed at the end", "m/s", lambda run: run.final_speed),
    Measure(
        "mean_abs_slip_error_published",
        "mean abs slip error against 0.132/0.092",
        "1",
        lambda run: run.mean_abs_slip_error_published,
        of_stop=True,
    ),
    Measure("max_torque_rate", "highest torque rate", "N*m/s", lambda run: run.max_torque_rate),
    Measure("energy_error", "what the energy balance lacks", "1", lambda run: run.energies.error),
)
"""What is kept beside them."""

COLUMNS = MEASURES + OTHERS


def measured(name: str) -> Measure:
    """The measure of a column."""
    return next(measure for measure in MEASURES if measure.name == name)


def row(number: int, values: dict[str, float], controller: str, run: Run) -> dict[str, Any]:
    """The row of a run; None where it has no such number."""
    kept = {measure.name: measure.of(run) for measure in COLUMNS}
    return {"run": number, "controller": controller, **values, "outcome": run.outcome.value, **kept}


def refused_row(number: int, values: dict[str, float], controller: str) -> dict[str, Any]:
    """The row of a run that could not be started: no number is known."""
    unknown = dict.fromkeys(measure.name for measure in COLUMNS)
    return {"run": number, "controller": controller, **values, "outcome": REFUSED, **unknown}
