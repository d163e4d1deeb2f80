"""What `verify` returns: conditions, each with its verdict, how it was reached, and the evidence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

How = Literal["symbolic", "sampled", "simulated"]
"""Proved with SymPy or in closed form; evaluated over a stated set; read off simulated runs."""


@dataclass(frozen=True)
class Condition:
    """One condition: its name, unique in a verification, and what is asked, in words and letters.

    holds, how: None where it was not decided, because what it is about does not exist. evidence: the identity, or the
    numbers and the set they belong to; or why it was not decided. claimed: [Park2008] claims it or relies on it.
    down_to_kmh: speed from 100 km/h down to which it holds; None where it does not hold or speed is no part of it.
    tolerated: what the law may have wrong, by name, and by which share either way it then still holds; inf without
    bound.
    """

    name: str
    statement: str
    holds: bool | None
    how: How | None
    evidence: str
    claimed: bool = False
    down_to_kmh: float | None = None
    tolerated: Mapping[str, float] = field(default_factory=dict)

    @property
    def decided(self) -> bool:
        """Whether it was found to hold or not to."""
        return self.holds is not None


@dataclass(frozen=True)
class Verification:
    """The conditions of a law, in order, and what they were decided for.

    `law` is "paper" (which has the robust variants' conditions too), "robust" or "layered"; K (N*m) and D (N*m/(m/s);
    None for the layered law, which has none) are those of that law; `inertia_scale` is the reading (1 SI, 3.6 as
    published); `seed` is where random numbers start.
    """

    law: str
    inertia_scale: float
    K: float
    D: float | None
    seed: int
    conditions: tuple[Condition, ...]

    @property
    def all_hold(self) -> bool:
        """True where every condition holds; one that was not decided is none that holds."""
        return all(one.holds for one in self.conditions)

    @property
    def failing(self) -> tuple[Condition, ...]:
        """The conditions that were found not to hold."""
        return tuple(one for one in self.conditions if one.holds is False)

    @property
    def undecided(self) -> tuple[Condition, ...]:
        """The conditions that were not decided."""
        return tuple(one for one in self.conditions if not one.decided)

    def __getitem__(self, name: str) -> Condition:
        """The condition of a name; KeyError for another."""
        for one in self.conditions:
            if one.name == name:
                return one
        raise KeyError(name)
