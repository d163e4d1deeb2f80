"""Records returned by `verify`: conditions with their verdict, the method, and the numbers behind it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Any

import numpy as np

from railslip_ctrl.core.arguments import Flags, Floats
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH

RULE = "relative degree"
"""Method of a condition on sliding: a delay, or a relative degree above 1 from the relay to s, excludes it."""

CORNERS = "checked at the corners"
"""Method: a bound that is affine in each quantity (proved with SymPy), evaluated in floats at a box's corners."""


def checked_at(points: int) -> str:
    """Method of a condition that was evaluated in floats at this number of points."""
    return f"checked at {points} points"


@dataclass(frozen=True)
class Condition:
    """A condition with its verdict; its name is unique in a verification. `report.verification` writes its text.

    - holds: verdict; None if not decided.
    - how: method; None if not decided. "symbolic": proved with SymPy or in closed form; "proved over the box": by
      interval arithmetic; "counterexample": violated at a point of the box; `RULE`; `CORNERS`; `checked_at`;
      "simulated": from runs.
    - numbers: numbers behind the verdict.
    - claimed: whether [Park2008] claims the condition or relies on it.
    - down_to_kmh: the condition holds from 100 km/h down to this speed; None if it does not hold, or does not depend on
      speed.
    - tolerated: largest errors of the law's quantities, by name, as shares either way; inf if there is no bound.
    """

    name: str
    holds: bool | None
    how: str | None
    numbers: Mapping[str, Any] = field(default_factory=dict)
    claimed: bool = False
    down_to_kmh: float | None = None
    tolerated: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Tolerance:
    """Largest value of one quantity for which all conditions still hold, with the other quantities as in the box."""

    name: str
    value: float
    limited_by: str
    unit: str


@dataclass(frozen=True)
class Verification:
    """Verification of a law: its conditions in order, and the settings.

    - law: "paper" (with the robust variants' conditions), "robust" or "predictive".
    - K, D: gains of the law, N*m (N*m/s for the predictive law) and N*m/(m/s) (None for it).
    - seed: first seed of random numbers.
    - box, tolerances: of a law that is decided over a box.
    - findings: numbers for the conclusion with the actuator (`report.verification.conclusion_text`); None without
      actuator, and for the predictive law.
    """

    law: str
    inertia_scale: float
    K: float
    D: float | None
    seed: int
    conditions: tuple[Condition, ...]
    box: Mapping[str, Any] = field(default_factory=dict)
    tolerances: tuple[Tolerance, ...] = ()
    findings: Mapping[str, Any] | None = None

    @property
    def all_hold(self) -> bool:
        """True if every condition holds; an undecided condition does not count as holding."""
        return all(one.holds for one in self.conditions)

    @property
    def failing(self) -> tuple[Condition, ...]:
        """Conditions that do not hold."""
        return tuple(one for one in self.conditions if one.holds is False)

    @property
    def undecided(self) -> tuple[Condition, ...]:
        """Conditions that were not decided."""
        return tuple(one for one in self.conditions if one.holds is None)

    def __getitem__(self, name: str) -> Condition:
        """Condition of this name; KeyError for an unknown name."""
        return {one.name: one for one in self.conditions}[name]


@dataclass(frozen=True)
class NoLock:
    """Largest certified acting torque, N*m, by speed (km/h) and slip, (speeds, slips); 0 if none is certified."""

    speeds_kmh: Floats
    slips: Floats
    torque: Floats


@dataclass(frozen=True)
class ReleasedRun:
    """Samples of a run, with the result whether the wheel certainly does not lock if the brake is released then.

    All of shape (n,): speed (m/s), slip, torque (largest acting torque over the following dead time, N*m), and inside,
    the result.
    """

    speed: Floats
    slip: Floats
    torque: Floats
    inside: Flags

    @property
    def share(self) -> float:
        """Share of the samples that certainly do not lock."""
        return float(np.mean(self.inside))

    @property
    def outside_kmh(self) -> tuple[float, float] | None:
        """Lowest and highest speed, km/h, of the samples that may lock; None if there are none."""
        speeds = self.speed[~self.inside] / KMH
        return (float(speeds.min()), float(speeds.max())) if speeds.size else None
