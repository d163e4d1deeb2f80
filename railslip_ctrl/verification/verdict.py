"""What `verify` returns: conditions, each with its verdict, how it was reached, and the numbers it was decided by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Any, Literal

from railslip_ctrl.core.records import dataclass

How = Literal["symbolic", "sampled", "simulated"]
"""Proved with SymPy or in closed form; evaluated over a stated set; read off simulated runs."""


@dataclass(frozen=True)
class Condition:
    """A condition by its name, unique in a verification; its words are in `report.verification`.

    holds, how: None where it was not decided, as what it is about does not exist. numbers: what decided it, or under
    "missing" what does not exist. claimed: [Park2008] claims it or relies on it. down_to_kmh: speed from 100 km/h down
    to which it holds; None where it does not hold or speed is no part of it. tolerated: what the law may have wrong, by
    name, and by which share either way; inf without bound.
    """

    name: str
    holds: bool | None
    how: How | None
    numbers: Mapping[str, Any] = field(default_factory=dict)
    claimed: bool = False
    down_to_kmh: float | None = None
    tolerated: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Verification:
    """The conditions of a law, in order, and what they were decided for.

    `law` is "paper" (with the robust variants' conditions), "robust" or "layered"; K (N*m) and D (N*m/(m/s); None for
    the layered law) are that law's; `seed` is where random numbers start.
    """

    law: str
    inertia_scale: float
    K: float
    D: float | None
    seed: int
    conditions: tuple[Condition, ...]

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
