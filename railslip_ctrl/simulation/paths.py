"""Reads and changes numbers of a record by dotted paths such as "vehicle.actuator.lag" or "events.0.time"."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, NamedTuple

from pydantic import BaseModel

from railslip_ctrl.core.user_files import validated
from railslip_ctrl.model.vehicle import Record


class Number(NamedTuple):
    """Number of a record: its value (None if it is not set) and its unit ("" if the unit is not known)."""

    value: float | None
    unit: str


def members(record: Any) -> dict[str, Any]:
    """Return the fields of a record by name, or the entries of a tuple by index; empty for any other object."""
    if isinstance(record, tuple):
        return {str(i): value for i, value in enumerate(record)}
    if isinstance(record, BaseModel):
        return {name: getattr(record, name) for name in type(record).model_fields}
    return {one.name: getattr(record, one.name) for one in fields(record)} if is_dataclass(record) else {}


def numbers(record: Any, prefix: str = "") -> dict[str, Number]:
    """Return paths and numbers of a record and of all records and tuples inside it; paths begin with `prefix`."""
    units: dict[str, str] = {}  # units of the members whose type allows a number
    if isinstance(record, Record):
        units = record.units()
    elif is_dataclass(record):
        units = {one.name: "" for one in fields(record) if str(one.type) in ("float", "float | None")}
    found: dict[str, Number] = {}
    for name, value in members(record).items():
        if isinstance(value, bool):
            continue
        if isinstance(value, (int, float)) or (value is None and name in units):
            found[prefix + name] = Number(None if value is None else float(value), units.get(name, ""))
        else:
            found |= numbers(value, f"{prefix}{name}.")
    return found


def replaced(record: Any, changes: Mapping[str, float], where: str = "") -> Any:
    """Return a copy of a record with some numbers replaced.

    `changes` maps dotted paths to new numbers in the units of the record. `where` names the record in messages.
    InputError for a number that the record does not allow.
    """
    new: dict[str, Any] = {}
    inner: dict[str, dict[str, float]] = {}
    for path, value in changes.items():
        head, _, rest = path.partition(".")
        if rest:
            inner.setdefault(head, {})[rest] = value
        else:
            new[head] = value
    own = members(record)
    for head, deeper in inner.items():
        new[head] = replaced(own[head], deeper, f"{where}.{head}".lstrip("."))
    if isinstance(record, tuple):
        return tuple({**own, **new}.values())
    if isinstance(record, BaseModel):
        given = {name: value for name, value in own.items() if value is not None}  # None stays unset
        return validated(type(record), {**given, **new}, where or "campaign")
    return replace(record, **new)
