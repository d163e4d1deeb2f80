"""Records returned by `verify`: conditions with their verdict, the method, and the numbers behind it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Any

import numpy as np

from railslip_ctrl.core.arguments import Flags, Floats
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH

RULE = "relative degree"  #: method: a delay, or a relative degree above 1 from the relay to s, excludes a sliding mode
CORNERS = "checked at the corners"  #: method: the bound is affine in each quantity, so its maximum is at a corner
BY_CORNERS = "symbolic; numbers checked at the corners"  #: method: proved for the least gain at the corners


def checked_at(points: int) -> str:
    """Return the method of a condition that was evaluated in floats at a number of `points`."""
    return f"checked at {points} points"


@dataclass(frozen=True)
class Condition:
    """A stability condition with its verdict.

    - name: name, unique in a verification. `report.verification` writes the text.
    - holds: verdict; None if undecided.
    - how: method, None if undecided: "symbolic" (proved with SymPy or in closed form), "proved over the box" (by
      interval arithmetic), "counterexample" (violated at a point of the box), "simulated", or `RULE`, `CORNERS`,
      `BY_CORNERS`, `checked_at`.
    - numbers: values, by name, from which the verdict follows.
    - claimed: True if [Park2008] claims the condition or relies on it.
    - down_to_kmh: the condition holds from 100 km/h down to this speed, km/h; None if it does not hold or does not
      depend on speed.
    - tolerated: largest relative errors of the law's estimates with which the condition holds, by name; may be inf.
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
    """Limit `value` (in `unit`) up to which the conditions hold if the other quantities are in `Verification.box`.

    `limited_by` is the condition that is not proved for larger values. |S| falls to `tube`, N*m.
    """

    name: str
    value: float
    limited_by: str
    unit: str
    tube: float


@dataclass(frozen=True)
class Verification:
    """Verification of a law: settings, and conditions in order.

    - law: "paper" (with the conditions of the robust variants), "robust" or "predictive".
    - K: switching gain, N*m, for the predictive law N*m/s.
    - D: gain on the sliding variable s, N*m/(m/s); None for the predictive law.
    - seed: first seed of random numbers.
    - box: ranges of the quantities for which the conditions are checked; empty unless the law is "predictive".
    - tolerances: limits of single quantities; empty unless the law is "predictive".
    - findings: numbers for the conclusion about the actuator (`report.verification.conclusion_text`); None without
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
        """True if every condition was decided and holds."""
        return all(one.holds for one in self.conditions)

    @property
    def failing(self) -> tuple[Condition, ...]:
        return tuple(one for one in self.conditions if one.holds is False)

    @property
    def undecided(self) -> tuple[Condition, ...]:
        return tuple(one for one in self.conditions if one.holds is None)

    def __getitem__(self, name: str) -> Condition:
        return {one.name: one for one in self.conditions}[name]


@dataclass(frozen=True)
class NoLock:
    """Largest acting torque, N*m, (speeds, slips), from which a released wheel certainly does not lock; 0 if none."""

    speeds_kmh: Floats
    slips: Floats
    torque: Floats


@dataclass(frozen=True)
class ReleasedRun:
    """Samples of a run; `inside` is True if the wheel certainly does not lock when the brake is released at the sample.

    All arrays have shape (n,). speed: m/s; torque: largest acting torque over the following dead time, N*m.
    """

    speed: Floats
    slip: Floats
    torque: Floats
    inside: Flags

    @property
    def share(self) -> float:
        """Share of the samples at which `inside` is True."""
        return float(np.mean(self.inside))

    @property
    def outside_kmh(self) -> tuple[float, float] | None:
        """Lowest and highest speed, km/h, of the samples at which `inside` is False; None if there are none."""
        speeds = self.speed[~self.inside] / KMH
        return (float(speeds.min()), float(speeds.max())) if speeds.size else None
