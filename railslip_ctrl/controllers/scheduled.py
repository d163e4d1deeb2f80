"""PI-lead whose gains depend on speed and rail; a change of the gains causes no jump of the torque."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

from railslip_ctrl.core.arguments import check_fields, number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH, quantity
from railslip_ctrl.core.user_files import read_text, validated
from railslip_ctrl.model.linearization import OperatingPoint
from railslip_ctrl.model.vehicle import PIGains, Rail, Record, Vehicle

from .base import Controller, Situation
from .linear import TRACKING_TIME, describe_windup, full_brake_torque
from .sampled import Rule, SampledController
from .systems import PIController


@dataclass(frozen=True)
class ScheduleEntry:
    """PI gains for one rail and one speed, km/h, tuned for all loads of the vehicle; `worst_ms` is the largest Ms."""

    rail: Rail
    speed_kmh: float
    gains: PIGains
    worst_ms: float


@dataclass(frozen=True)
class GainSchedule:
    """PI gains for each rail, interpolated linearly over speed between the `entries` and constant below and above them.

    All entries have the same `lead` and `lead_filter` (s). Below `lowest_speed_kmh` some loops are unstable, and slip
    control must be switched off. `worst_ms` is the largest Ms at the scheduled speeds and between them. InputError for
    a value that is not allowed.
    """

    entries: tuple[ScheduleEntry, ...]
    lead: float
    lead_filter: float
    lowest_speed_kmh: float
    worst_ms: float

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.entries:
            raise InputError("gain schedule: there are no entries; give at least one")
        seen = set()
        for entry in self.entries:
            number("gain schedule: speed", entry.speed_kmh, "km/h", gt=0)
            number("gain schedule: worst Ms", entry.worst_ms, ge=1)
            if (entry.rail, entry.speed_kmh) in seen:
                raise InputError(f"gain schedule: {entry.rail} rail, {entry.speed_kmh:g} km/h is given twice; keep one")
            seen.add((entry.rail, entry.speed_kmh))
        number("gain schedule: lowest speed", self.lowest_speed_kmh, "km/h", ge=0)
        if not self.worst_ms >= 1:
            raise InputError(f"gain schedule: worst Ms {self.worst_ms} is not allowed; give a value >= 1")
        PIController(self.entries[0].gains, self.lead, self.lead_filter)  # raises InputError for invalid time constants

    def controller(self, speed: float, rail: Rail) -> PIController:
        """Return the PI-lead for a `speed`, m/s, > 0, on a `rail`; InputError if the rail has no entries."""
        number("speed", speed, "m/s", gt=0)
        mine = sorted((e for e in self.entries if e.rail is rail), key=lambda e: e.speed_kmh)
        if not mine:
            raise InputError(
                f"rail: the schedule has no entries for {rail} rail; tune it for this rail, or choose another rail"
            )
        speeds = [e.speed_kmh for e in mine]
        kp = float(np.interp(speed / KMH, speeds, [e.gains.kp for e in mine]))
        ki = float(np.interp(speed / KMH, speeds, [e.gains.ki for e in mine]))
        return PIController(PIGains(kp=kp, ki=ki), self.lead, self.lead_filter)

    def to_json(self) -> str:
        """Return the schedule as JSON text for `from_json`; values are in SI, or in the unit at the end of the key."""
        entries = []
        for e in self.entries:
            gains = {"kp_si": e.gains.kp, "ki_si": e.gains.ki}
            entries.append({"rail": e.rail.value, "speed_kmh": e.speed_kmh, **gains, "worst_ms": e.worst_ms})
        limits = {"lowest_speed_kmh": self.lowest_speed_kmh, "worst_ms": self.worst_ms}
        content = {"lead_s": self.lead, "lead_filter_s": self.lead_filter, **limits, "entries": entries}
        return json.dumps(content, indent=2, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> GainSchedule:
        """Read a schedule from text written by `to_json`; InputError for any other text."""
        try:
            content = json.loads(text)
            entries = []
            for e in content["entries"]:
                gains = validated(PIGains, {"kp": e["kp_si"], "ki": e["ki_si"]}, "gain schedule")
                entries.append(ScheduleEntry(Rail(e["rail"]), float(e["speed_kmh"]), gains, float(e["worst_ms"])))
            others = [float(content[key]) for key in ("lead_s", "lead_filter_s", "lowest_speed_kmh", "worst_ms")]
        except InputError:
            raise
        except (ValueError, KeyError, TypeError) as error:
            reason = " ".join(str(error).split())
            raise InputError(
                f"gain schedule: the text is not a schedule in JSON ({reason}); write the text with to_json"
            ) from None
        return cls(tuple(entries), *others)


class Scheduled(Controller):
    """PI-lead with the gains of a `GainSchedule`.

    InputError for a period, tracking time or torque limit that `SampledController` does not allow, or if the schedule
    has no entries for a rail of the run.
    """

    kind: ClassVar[str] = "scheduled"
    title: ClassVar[str] = "PI-lead with gains over speed and rail"
    source: ClassVar[str] = "this project"

    schedule: GainSchedule
    radius: float | None = quantity("m", "assumed wheel radius; the vehicle's if left out", gt=0, default=None)
    torque_min: float | None = quantity("N*m", "smallest torque; none if left out", default=None)
    torque_max: float | None = quantity("N*m", "largest torque; none if left out", default=None)
    tracking_time: float | None = quantity(
        "s", "tracking time of the anti-windup; kp/ki if left out", gt=0, default=None
    )
    initial_torque: float = quantity("N*m", "torque at the start", default=0.0)
    rule: Rule = Field(Rule.BACKWARD, description="rule that converts the PI to a difference equation")

    class State(Record):
        """State of the controller: states of lead and PI, and values of the previous sample."""

        integral: float = quantity("N*m", "integral part of the torque", default=0.0)
        error: float = quantity("m/s", "slip error of the previous sample", default=0.0)
        filtered_error: float = quantity("m/s", "output of the lead", default=0.0)
        unlimited_torque: float = quantity("N*m", "torque of the previous sample, without limits", default=0.0)

    class Parameters(Record):
        """Parameters of `step`: coefficients of lead and integrator, limits, and the gains over speed on one rail."""

        radius: float = quantity("m", "wheel radius")
        lead_pole: float = quantity("1", "pole of the lead in z")
        lead_now: float = quantity("1", "weight of the error in the filtered error")
        lead_before: float = quantity("1", "weight of the previous error in the filtered error")
        weight_now: float = quantity("s", "weight of the filtered error in the integral")
        weight_before: float = quantity("s", "weight of the previous filtered error in the integral")
        tracking: float = quantity("1", "sampling period over tracking time; if negative, period times ki/kp is used")
        torque_min: float = quantity("N*m", "smallest torque")
        torque_max: float = quantity("N*m", "largest torque")
        speed_count: float = quantity("1", "number of valid entries in speeds, kp and ki")
        speeds: tuple[float, ...] = quantity("m/s", "speeds, rising")
        kp: tuple[float, ...] = quantity("N*m/(m/s)", "proportional gains at these speeds")
        ki: tuple[float, ...] = quantity("N*m/m", "integral gains at these speeds")

    @classmethod
    def from_keys(cls, content: Mapping[str, Any], path: Path, initial_speed: float | None) -> Self:
        """Make the controller from its file's keys; the key `schedule` has a table or the name of a JSON file."""
        if isinstance(content.get("schedule"), str):
            schedule = GainSchedule.from_json(read_text(path.parent / content["schedule"]))
            content = {**content, "schedule": schedule}
        return super().from_keys(content, path, initial_speed)

    def file_keys(self) -> dict[str, Any]:
        return {**super().file_keys(), "schedule": asdict(self.schedule)}

    @model_validator(mode="after")
    def _can_run(self) -> Self:
        if self.period is not None:
            self._lead(self.period)
        return self

    def linear(self, point: OperatingPoint | None) -> PIController:
        if point is None:
            raise InputError(f"controller {self.label}: its gains depend on the speed; give an operating point")
        return self.schedule.controller(point.speed, point.rail)

    def parameters(self, situation: Situation) -> Mapping[str, Any]:
        h, rail = situation.period, situation.rail
        by_rail = [sorted({e.speed_kmh * KMH for e in self.schedule.entries if e.rail is each}) for each in Rail]
        speeds = by_rail[tuple(Rail).index(rail)] or [1.0]  # a rail without entries: the schedule raises InputError
        designs = [self.schedule.controller(speed, rail).gains for speed in speeds]
        p, q0, q1 = self._lead(h)
        now, before = (h * 0.5, h * 0.5) if self.rule is Rule.TUSTIN else (h, 0.0)
        unused = (0.0,) * (max(map(len, by_rail)) - len(speeds))  # arrays of both rails have equal lengths
        return {
            **{"radius": self.radius, "lead_pole": p, "lead_now": q0, "lead_before": q1},
            **{"weight_now": now, "weight_before": before},
            "tracking": -1.0 if self.tracking_time is None else h / self.tracking_time,
            **{"torque_min": self.least_torque, "torque_max": self.largest_torque, "speed_count": len(speeds)},
            "speeds": (*speeds, *unused),
            "kp": (*(gains.kp for gains in designs), *unused),
            "ki": (*(gains.ki for gains in designs), *unused),
        }

    def _lead(self, h: float) -> tuple[float, float, float]:
        """Return p, q0 and q1 of the sampled lead (q0 z + q1)/(z - p), which is the same at all speeds."""
        design = PIController(PIGains(kp=1.0, ki=0.0), self.schedule.lead, self.schedule.lead_filter)
        limits = self.least_torque, self.largest_torque
        lead = SampledController(design, h, *limits, self.rule, self.tracking_time).transfer_function
        return float(np.sum(lead.poles).real), lead.gain, -lead.gain * float(np.sum(lead.zeros).real)

    def start(self, speed: float, period: float) -> Record:
        return self.State(integral=self.initial_torque, unlimited_torque=self.initial_torque)

    @staticmethod
    def step(state: Any, measurement: Any, parameters: Any) -> Any:
        """Return the torque of the PI-lead, N*m, with gains interpolated at the train speed."""
        speed, applied = measurement.train_speed, measurement.applied_torque
        error = parameters.reference_slip * speed - (speed - parameters.radius * measurement.wheel_speed)
        if not math.isfinite(error):
            return applied
        last, i = int(min(parameters.speed_count, len(parameters.speeds))) - 1, 0
        while i < last and speed >= parameters.speeds[i + 1]:
            i += 1
        kp, ki = parameters.kp[i], parameters.ki[i]
        if i < last and speed > parameters.speeds[i]:
            share = (speed - parameters.speeds[i]) / (parameters.speeds[i + 1] - parameters.speeds[i])
            kp += share * (parameters.kp[i + 1] - kp)
            ki += share * (parameters.ki[i + 1] - ki)
        integral = state.unlimited_torque - kp * state.filtered_error  # no jump of the torque when the gains change
        filtered = (
            parameters.lead_pole * state.filtered_error
            + parameters.lead_now * error
            + parameters.lead_before * state.error
        )
        share = parameters.tracking if parameters.tracking >= 0.0 else 1.0
        if ki == 0.0:
            share = 0.0
        elif parameters.tracking < 0.0 and parameters.period * abs(ki) < abs(kp):
            share = parameters.period * abs(ki / kp)
        integral += ki * (
            parameters.weight_now * filtered + parameters.weight_before * state.filtered_error
        ) + share * (applied - state.unlimited_torque)
        state.integral, state.error, state.filtered_error = integral, error, filtered
        state.unlimited_torque = kp * filtered + integral
        return min(max(state.unlimited_torque, parameters.torque_min), parameters.torque_max)

    @classmethod
    def for_vehicle(cls, vehicle: Vehicle, **given: Any) -> Self:
        """Return the controller with the fields `given`, which include `schedule`.

        By default the torque limits are 0 and the full brake torque, and the tracking time is `TRACKING_TIME`.
        """
        limits = {"torque_min": 0.0, "torque_max": full_brake_torque(vehicle), "tracking_time": TRACKING_TIME}
        return cls(**{**limits, **given}).believing(vehicle)

    def described(self) -> str:
        speeds = sorted({entry.speed_kmh for entry in self.schedule.entries})
        rails = {entry.rail for entry in self.schedule.entries}
        return (
            f"{self.label}, PI gains at {len(speeds)} speeds from {speeds[0]:g} to {speeds[-1]:g} km/h, "
            f"{', '.join(rail for rail in Rail if rail in rails)} rail, lead ({self.schedule.lead:g} s + 1)/"
            f"({self.schedule.lead_filter:g} s + 1)"
        )

    def limits_described(self) -> str:
        return super().limits_described() + describe_windup(self, anti_windup=True)

    def gain_values(self) -> dict[str, Any]:
        return {}
