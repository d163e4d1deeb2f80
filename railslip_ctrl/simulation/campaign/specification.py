"""What a campaign is: a scenario, controllers, quantities with distributions, a number of runs and a seed."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np
from pydantic import BaseModel

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.user_files import close_match
from railslip_ctrl.simulation.controllers import Controller
from railslip_ctrl.simulation.scenario import Scenario
from railslip_ctrl.simulation.step_objects import UserStep, as_control

from .paths import Place, numbers, replaced
from .rows import headed
from .sampling import Distribution, Grid, Sampling, draw, grid_points

MOST_RUNS = 10**9
LARGEST_SEED = 2**63 - 1
_LISTED = 200  # characters of the list of paths in an error


@dataclass(frozen=True)
class Quantity:
    """What differs from run to run.

    Attributes
    ----------
    paths : tuple of str
        Where the value goes. A path is looked up in the scenario ("vehicle.mass"), then in the controllers, all that
        have it ("design.gains.kp"); behind a controller's name it is meant there alone ("pi.design.gains.kp").
    distribution : Distribution
        SI.
    relative : bool
        The value is a factor on the number that each path has in the campaign's scenario or controller.
    """

    paths: tuple[str, ...]
    distribution: Distribution
    relative: bool = False

    @property
    def name(self) -> str:
        """Of its column."""
        return self.paths[0] + (" factor" if self.relative else "")


@dataclass(frozen=True)
class Case:
    """Run number `number`: the sampled values, the scenario and the controllers that have them."""

    number: int
    values: dict[str, float]
    scenario: Scenario
    controllers: tuple[Controller, ...]
    seed: np.random.SeedSequence


@dataclass(frozen=True)
class Campaign:
    """Many runs. Run number i (from 0) is a function of the campaign and i: of no other run, machine or order.

    Each run gives every controller the same sampled vehicle, rail and noise.

    Parameters
    ----------
    scenario : Scenario
        What the quantities change.
    controllers : tuple of Controller
        One or more, of different names; whatever `simulation.step_objects.as_control` takes.
    runs : int
        1 to `MOST_RUNS`.
    quantities : tuple of Quantity
        What differs from run to run.
    seed : int
        0 to 2^63 - 1.
    sampling : Sampling
        How the quantities are drawn together.

    Raises
    ------
    InputError
        No controller or two of one name, a path that is not there or is named twice, a number of runs or a seed out of
        range, a number of runs that does not fit the grid or the Sobol sequence, a distribution whose ends the scenario
        or controller refuses.
    """

    scenario: Scenario
    controllers: tuple[Controller, ...]
    runs: int
    quantities: tuple[Quantity, ...] = ()
    seed: int = 0
    sampling: Sampling = Sampling.RANDOM

    def __post_init__(self) -> None:
        vehicle, held = self.scenario.vehicle, self.scenario.adhesion.reference
        object.__setattr__(self, "controllers", tuple(as_control(one, vehicle, held) for one in self.controllers))
        names = self.controller_names
        if not names:
            raise InputError("controllers: none given; give at least one")
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"controllers: two have the name {name!r}; give each its own")
        if not 1 <= self.runs <= MOST_RUNS:
            raise InputError(f"runs: {self.runs} is not allowed; give an integer from 1 to {MOST_RUNS}")
        if not 0 <= self.seed <= LARGEST_SEED:
            raise InputError(f"seed: {self.seed} is not allowed; give an integer from 0 to 2^63 - 1")
        self._check_points()
        _ = self._targets
        self._check_ends()

    @property
    def controller_names(self) -> tuple[str, ...]:
        """In order."""
        return tuple(controller.name for controller in self.controllers)

    @property
    def quantity_units(self) -> dict[str, str]:
        """Unit of each quantity's column, by name; "" where none is known, "1" for a factor."""
        return {
            quantity.name: "1" if quantity.relative else self.place(quantity.paths[0]).unit
            for quantity in self.quantities
        }

    @property
    def quantity_heads(self) -> dict[str, str]:
        """Of each quantity's column, by name: as much of the end of its path as tells it apart, and its unit."""
        parts = {name: name.split(".") for name in self.quantity_units}

        def ending(name: str, length: int) -> str:
            return ".".join(parts[name][-length:])

        heads = {}
        for name, unit in self.quantity_units.items():
            apart = (n for n in range(1, len(parts[name])) if [ending(o, n) for o in parts].count(ending(name, n)) == 1)
            heads[name] = headed(ending(name, next(apart, len(parts[name]))), unit)
        return heads

    @cached_property
    def fingerprint(self) -> str:
        """A hash of everything that the results depend on."""
        return hashlib.sha256(json.dumps(self.described(), sort_keys=True).encode()).hexdigest()

    def described(self) -> dict[str, Any]:
        """The campaign as plain data, equal for equal campaigns."""
        found: dict[str, Any] = described(self)
        return found

    def place(self, path: str) -> Place:
        """The number at a path, as in `Quantity`; InputError, with the nearest path, for none."""
        if path not in self._known:
            near = close_match(path, self._known) or f"scenario: {', '.join(self._known)[:_LISTED]} ... "
            raise InputError(f"quantity: {path!r} is no number of the scenario or of a controller; {near.rstrip()}")
        return self._known[path]

    def case(self, i: int) -> Case:
        """Run number i made ready. InputError for a number out of range or values that a record refuses."""
        values = self.values(i)
        scenario, controllers = self._with_values(tuple(values.values()))
        return Case(i, values, scenario, controllers, np.random.SeedSequence(self.seed, spawn_key=(i,)))

    def values(self, i: int) -> dict[str, float]:
        """The sampled values of run number i alone, by name; InputError for a number out of range."""
        if not 0 <= i < self.runs:
            raise InputError(f"run: {i} is not allowed; the campaign has runs 0 to {self.runs - 1}")
        distributions = [quantity.distribution for quantity in self.quantities]
        values = draw(distributions, self.sampling, self.runs, self.seed, i)
        return {quantity.name: value for quantity, value in zip(self.quantities, values, strict=True)}

    def grid_values(self, point: int) -> dict[str, float]:
        """The values of the grids at one of their points, a `point` by its number from 0, by name."""
        return {q.name: v for q, v in zip(self.quantities, self.values(point).values(), strict=True) if _is_grid(q)}

    @cached_property
    def _known(self) -> dict[str, Place]:
        return _places(self.scenario, self.controllers)

    @cached_property
    def _targets(self) -> tuple[tuple[tuple[int, str], ...], ...]:
        """Of each quantity: (-1 for the scenario or the controller's number, path there)."""
        taken: set[tuple[int, str]] = set()
        found = []
        for quantity in self.quantities:
            targets = tuple(target for path in quantity.paths for target in self._targets_of(path))
            for target in targets:
                if target in taken:
                    raise InputError(f"quantity: {target[1]!r} is given twice; leave one out")
                taken.add(target)
            found.append(targets)
        return tuple(found)

    def _targets_of(self, path: str) -> list[tuple[int, str]]:
        self.place(path)
        if path in numbers(self.scenario):
            return [(-1, path)]
        head, _, rest = path.partition(".")
        if head in self.controller_names and rest in numbers(self.controllers[self.controller_names.index(head)]):
            return [(self.controller_names.index(head), rest)]
        return [(k, path) for k, controller in enumerate(self.controllers) if path in numbers(controller)]

    def _with_values(self, values: tuple[float, ...]) -> tuple[Scenario, tuple[Controller, ...]]:
        changes: dict[int, dict[str, float]] = {}
        for quantity, targets, value in zip(self.quantities, self._targets, values, strict=True):
            for owner, path in targets:
                changes.setdefault(owner, {})[path] = value * self._nominal(owner, path) if quantity.relative else value
        scenario = replaced(self.scenario, changes[-1]) if -1 in changes else self.scenario
        controllers = tuple(
            replaced(controller, changes[k]) if k in changes else controller
            for k, controller in enumerate(self.controllers)
        )
        return scenario, controllers

    @cached_property
    def _nominals(self) -> tuple[dict[str, Place], ...]:
        return (*(numbers(controller) for controller in self.controllers), numbers(self.scenario))

    def _nominal(self, owner: int, path: str) -> float:
        value = self._nominals[owner][path].value
        if value is None:
            raise InputError(f"quantity: {path!r} has no number for a factor to stand on; give the value itself")
        return value

    def _check_points(self) -> None:
        points = grid_points([quantity.distribution for quantity in self.quantities])
        if self.runs % points:
            less, more = self.runs // points * points, (self.runs // points + 1) * points
            raise InputError(
                f"runs: {self.runs} is not allowed; the grid has {points} points, give a multiple of them: "
                f"{f'{less} or ' if less else ''}{more}"
            )
        if self.sampling is Sampling.SOBOL and self.runs & (self.runs - 1):
            more = 1 << self.runs.bit_length()
            raise InputError(
                f"runs: {self.runs} is not allowed; Sobol points are balanced for powers of 2: {more // 2} or {more}"
            )

    def _check_ends(self) -> None:
        """Both ends of every quantity, the others in their middle, must make a scenario and its controllers."""
        ends = [quantity.distribution.ends for quantity in self.quantities]
        middle = [quantity.distribution.at(0.5) for quantity in self.quantities]
        for k, pair in enumerate(ends):
            for end in pair:
                self._with_values((*middle[:k], end, *middle[k + 1 :]))


def _is_grid(quantity: Quantity) -> bool:
    return isinstance(quantity.distribution, Grid)


def _places(scenario: Scenario, controllers: tuple[Controller, ...]) -> dict[str, Place]:
    """Every path that may be named; the scenario's win over the controllers'."""
    found: dict[str, Place] = {}
    for controller in controllers:
        own = numbers(controller)
        found |= own | {f"{controller.name}.{path}": place for path, place in own.items()}
    return found | numbers(scenario)


def described(value: Any) -> Any:
    """A record as plain data for JSON: its kind, and its members by name."""
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, BaseModel):
        members: Mapping[str, Any] = {name: getattr(value, name) for name in type(value).model_fields}
    elif is_dataclass(value):
        members = {field.name: getattr(value, field.name) for field in fields(value)}
    elif isinstance(value, (tuple, list)):
        return [described(member) for member in value]
    elif isinstance(value, float) and not math.isfinite(value):
        return str(value)
    elif value is None or isinstance(value, (str, bool, int, float)):
        return value
    elif isinstance(value, UserStep):
        return value.fingerprint
    else:
        raise InputError(f"campaign: {type(value).__name__} cannot be written down; give records and numbers")
    return {"kind": type(value).__name__, **{name: described(member) for name, member in members.items()}}
