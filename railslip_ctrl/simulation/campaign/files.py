"""A campaign from the user's TOML file: numbers in SI, or strings with a unit, in that of the quantity's path."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import MISSING, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import quantity, to_unit
from railslip_ctrl.core.user_files import close_match, file_name, given_path, read_toml, validated
from railslip_ctrl.model.adhesion import ReferenceSlip
from railslip_ctrl.model.vehicle import PIGains, Record
from railslip_ctrl.simulation.catalogue import controller_named, default_column, published_reference, reference_of
from railslip_ctrl.simulation.controller_files import load_controller
from railslip_ctrl.simulation.controllers import Controller
from railslip_ctrl.simulation.scenario import Scenario, load_scenario
from railslip_ctrl.simulation.step_objects import as_control

from .specification import DISTRIBUTIONS, LARGEST_SEED, MOST_RUNS, Campaign, Distribution, Quantity, Sampling

T = TypeVar("T")

KEYS_OF = {kind: tuple(field.name for field in fields(made)) for kind, made in DISTRIBUTIONS.items()}
"""Keys of each distribution."""

_WITHOUT_UNIT = ("spread", "weights")
_LISTS = ("values", "weights")


class ControllerTable(Record):
    """Table `[[controller]]`: one that comes with the package, or a file; `name` tells two of a kind apart."""

    controller: str
    name: str | None = Field(None, pattern=r"^[\w-]+$")
    gains: Literal["beam", "bristle"] | None = None
    kp: float | None = quantity("N*m/(m/s)", "proportional gain", default=None)
    ki: float | None = quantity("N*m/m", "integral gain", default=None)
    slip: float | None = quantity("1", "reference slip ratio on either rail", gt=0, lt=1, default=None)
    knows_rail: bool = True
    adaptive: bool = False


class QuantityKeys(BaseModel):
    """Table `[[quantity]]`; which of the numbers belong to a distribution says `KEYS_OF`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    path: str | list[str] = Field(min_length=1, description="dotted path of a number, or a list of them")
    distribution: str = Field(description=", ".join(KEYS_OF))
    relative: bool = Field(False, strict=True)
    low: Any = None
    high: Any = None
    mean: Any = None
    std: Any = None
    median: Any = None
    spread: Any = None
    mode: Any = None
    values: list[Any] | None = None
    weights: list[Any] | None = None


class CampaignKeys(BaseModel):
    """The keys of a campaign's TOML file."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    scenario: str = Field(description="a built-in scenario or a TOML file beside this one")
    runs: int = Field(strict=True, ge=1, le=MOST_RUNS, description="number of runs")
    seed: int = Field(0, strict=True, ge=0, le=LARGEST_SEED)
    sampling: Sampling = Sampling.RANDOM
    controller: list[ControllerTable] = Field([], description="one table for each controller")
    quantity: list[QuantityKeys] = []


def load_campaign(path: str | Path, *, controllers: Sequence[str] = ()) -> Campaign:
    """The campaign a file describes; `controllers`, names or files, in place of its own.

    InputError: one line with the file, the key, the value and what is allowed.
    """
    path = given_path(path)
    where = file_name(path)
    keys = validated(CampaignKeys, read_toml(path), where)
    named = path.parent / keys.scenario if keys.scenario.lower().endswith(".toml") else keys.scenario
    scenario = _located(f"{where}: scenario", lambda: load_scenario(named))
    if controllers:
        tables = [("--controller", ControllerTable(controller=text), Path()) for text in controllers]
    else:
        tables = [(f"{where}: controller {i}", table, path.parent) for i, table in enumerate(keys.controller)]
    made = tuple(_located(place, partial(_controller, table, scenario, beside)) for place, table, beside in tables)
    nominal = _located(where, lambda: Campaign(scenario, made, 1))
    quantities = tuple(
        _located(f"{where}: quantity {i}", partial(_quantity, given, nominal)) for i, given in enumerate(keys.quantity)
    )
    return _located(where, lambda: Campaign(scenario, made, keys.runs, quantities, keys.seed, keys.sampling))


def _located(where: str, make: Callable[[], T]) -> T:
    """What `make` makes, with the place in the file before its complaint; what both name is named once."""
    try:
        return make()
    except InputError as error:
        table = where.rpartition(": ")[2].partition(" ")[0]  # "quantity" of "file: quantity 0"
        raise InputError(f"{where}: {str(error).removeprefix(f'{table}: ')}") from None


def _controller(keys: ControllerTable, scenario: Scenario, beside: Path) -> Controller:
    if (keys.kp is None) != (keys.ki is None):
        raise InputError("kp and ki: give both, or neither")
    gains = None if keys.kp is None or keys.ki is None else PIGains(kp=keys.kp, ki=keys.ki)
    if keys.controller.lower().endswith((".toml", ".py")):
        for key in sorted(keys.model_fields_set - {"controller", "name"}):
            raise InputError(f"{key}: {keys.controller} has its own; leave it out")
        path = beside / keys.controller
        loaded = load_controller(path, initial_speed=scenario.initial_speed)
        found = as_control(loaded, scenario.vehicle, scenario.adhesion.reference, path.stem)
    else:
        found = controller_named(
            keys.controller,
            scenario.vehicle,
            column=keys.gains or default_column(scenario.adhesion),
            gains=gains,
            reference=_reference(keys, scenario),
            knows_rail=keys.knows_rail,
            adaptive=keys.adaptive,
        )
    return found if keys.name is None else replace(found, name=keys.name)  # type: ignore[type-var]


def _reference(keys: ControllerTable, scenario: Scenario) -> ReferenceSlip:
    if keys.slip is not None:
        return ReferenceSlip(dry=keys.slip, wet=keys.slip)
    if keys.gains is not None:
        return published_reference(keys.gains)
    return reference_of(scenario.adhesion, "slip", "slip = X, or gains for that of Table 4")


def _quantity(keys: QuantityKeys, nominal: Campaign) -> Quantity:
    paths = (keys.path,) if isinstance(keys.path, str) else tuple(keys.path)
    units = {nominal.place(path).unit for path in paths}
    if len(units) > 1 and not keys.relative:
        raise InputError(f"path: {', '.join(paths)} have different units; give each its own table, or relative = true")
    unit = "1" if keys.relative else units.pop()
    return Quantity(paths, _distribution(keys, unit), keys.relative)


def _distribution(keys: QuantityKeys, unit: str) -> Distribution:
    kind = keys.distribution
    if kind not in KEYS_OF:
        raise InputError(
            f"distribution: {kind!r} is not known; {close_match(kind, KEYS_OF)}choose one of {', '.join(KEYS_OF)}"
        )
    given = keys.model_dump(exclude={"path", "distribution", "relative"}, exclude_none=True)
    for name in given:
        if name not in KEYS_OF[kind]:
            raise InputError(f"{name}: {kind} has no such key; it has {', '.join(KEYS_OF[kind])}")
    for field in fields(DISTRIBUTIONS[kind]):
        if field.name not in given and field.default is MISSING:
            raise InputError(f"{field.name}: missing; {kind} needs it")
    made: Distribution = DISTRIBUTIONS[kind](**{name: _si(value, unit, name) for name, value in given.items()})
    return made


def _si(value: Any, unit: str, name: str) -> Any:
    """A number, or a tuple of them, in SI; where no unit is known a plain number is asked for."""
    unit = "1" if name in _WITHOUT_UNIT else unit or "1"
    if name in _LISTS:
        return tuple(to_unit(member, unit, name=name, text_needs_unit=True) for member in value)
    return to_unit(value, unit, name=name, text_needs_unit=True)
