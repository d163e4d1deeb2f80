"""What `verify` returns: conditions, each with its verdict, how it was reached, and the numbers it was decided by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Any

import numpy as np

from railslip_ctrl.core.arguments import Flags, Floats
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH

RULE = "relative degree"
"""How, of sliding that a delay or a relative degree above 1 from the relay to s rules out."""

CORNERS = "checked at the corners"
"""How, of a bound affine in each quantity alone (proved with SymPy), evaluated in floats at the corners of a box."""


def checked_at(points: int) -> str:
    """How, of a condition that was evaluated in floats at points."""
    return f"checked at {points} points"


@dataclass(frozen=True)
class Condition:
    """A condition by its name, unique in a verification; its words are in `report.verification`.

    holds, how: None where it was not decided. how: "symbolic", proved with SymPy or in closed form; "proved over
    the box", by interval arithmetic; "counterexample", a point of it; `RULE`; `CORNERS`; `checked_at`; "simulated",
    read off runs. numbers: what decided it. claimed: [Park2008] claims it or relies on it. down_to_kmh: speed from 100
    km/h down to which it holds; None where it does not hold or speed is no part of it. tolerated: what the law may have
    wrong, by name, and by which share either way; inf without bound.
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
    """The largest value of one quantity, the others as in the box, up to which every condition named still holds."""

    name: str
    value: float
    limited_by: str
    unit: str


@dataclass(frozen=True)
class Verification:
    """The conditions of a law, in order, and what they were decided for.

    `law` is "paper" (with the robust variants' conditions), "robust" or "predictive"; K (N*m; N*m/s for the
    predictive law) and D (N*m/(m/s); None for it) are that law's; `seed` is where random numbers start. box,
    tolerances: of a law that is decided over a box. findings: what an engineer may conclude from behind the actuator
    (`report.verification.conclusion_text`); None without it, and for the predictive law, whose conditions are its own.
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
        """True where every condition holds; one that was not decided does not."""
        return all(one.holds for one in self.conditions)

    @property
    def failing(self) -> tuple[Condition, ...]:
        """The conditions that were found not to hold."""
        return tuple(one for one in self.conditions if one.holds is False)

    @property
    def undecided(self) -> tuple[Condition, ...]:
        """The conditions that were not decided."""
        return tuple(one for one in self.conditions if one.holds is None)

    def __getitem__(self, name: str) -> Condition:
        """The condition of a name; KeyError for another."""
        return {one.name: one for one in self.conditions}[name]


@dataclass(frozen=True)
class NoLock:
    """Largest certified acting torque, N*m, by speed (km/h) and slip; shape (speeds, slips). 0: none is certified."""

    speeds_kmh: Floats
    slips: Floats
    torque: Floats


@dataclass(frozen=True)
class ReleasedRun:
    """Samples of a run, each asked whether the wheel certainly does not lock if the brake is released then.

    speed (m/s), slip, torque: the largest acting torque of the dead time from then on, N*m, as that is under way;
    inside: whether it is certain; all of shape (n,).
    """

    speed: Floats
    slip: Floats
    torque: Floats
    inside: Flags

    @property
    def share(self) -> float:
        """Share of the samples that are inside."""
        return float(np.mean(self.inside))

    @property
    def outside_kmh(self) -> tuple[float, float] | None:
        """Lowest and highest speed of the samples outside; None if there are none."""
        speeds = self.speed[~self.inside] / KMH
        return (float(speeds.min()), float(speeds.max())) if speeds.size else None
