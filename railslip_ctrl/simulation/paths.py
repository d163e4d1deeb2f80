"""Numbers inside records, by dotted path: "vehicle.actuator.lag", "events.0.time"."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, NamedTuple

from pydantic import BaseModel

from railslip_ctrl.core.user_files import validated
from railslip_ctrl.model.vehicle import Record


class Place(NamedTuple):
    """A number in a record: its value (None where the record has none there) and unit ("" where nobody says it)."""

    value: float | None
    unit: str


def members(record: Any) -> dict[str, Any]:
    """The members of a record or tuple, by name; none of anything else."""
    if isinstance(record, tuple):
        return {str(i): value for i, value in enumerate(record)}
    if isinstance(record, BaseModel):
        return {name: getattr(record, name) for name in type(record).model_fields}
    return {one.name: getattr(record, one.name) for one in fields(record)} if is_dataclass(record) else {}


def numbers(record: Any, prefix: str = "") -> dict[str, Place]:
    """Every number in a record, its records and its tuples, by path; those that are left out but could be given too."""
    units: dict[str, str] = {}  # of members that are, or may be, a number
    if isinstance(record, Record):
        units = record.units()
    elif is_dataclass(record):
        units = {one.name: "" for one in fields(record) if str(one.type) in ("float", "float | None")}
    found: dict[str, Place] = {}
    for name, value in members(record).items():
        if isinstance(value, bool):
            continue
        if isinstance(value, (int, float)) or (value is None and name in units):
            found[prefix + name] = Place(None if value is None else float(value), units.get(name, ""))
        else:
            found |= numbers(value, f"{prefix}{name}.")
    return found


def replaced(record: Any, changes: Mapping[str, float], where: str = "") -> Any:
    """The record with other numbers at some of its paths, checked as a new one.

    InputError, which names the record by `where`, for a number that it refuses.
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
        given = {name: value for name, value in own.items() if value is not None}  # None: left out, and stays so
        return validated(type(record), {**given, **new}, where or "campaign")
    return replace(record, **new)
