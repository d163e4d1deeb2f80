"""Numbers inside records, by dotted path: "vehicle.actuator.lag", "events.0.time"."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, NamedTuple

from pydantic import BaseModel

from railslip_ctrl.core.user_files import validated


class Place(NamedTuple):
    """A number in a record: its value (None where the record has none there) and unit ("" where nobody says it)."""

    value: float | None
    unit: str


def numbers(record: object, prefix: str = "") -> dict[str, Place]:
    """Every number in a record, its records and its tuples, by path; those that are left out but could be given too."""
    found: dict[str, Place] = {}
    for name, value, unit, settable in _members(record):
        path = f"{prefix}{name}"
        if isinstance(value, bool):
            continue
        if isinstance(value, (int, float)) or (value is None and settable):
            found[path] = Place(None if value is None else float(value), unit)
        elif value is not None:
            found.update(numbers(value, f"{path}."))
    return found


def replaced(record: Any, changes: Mapping[str, float]) -> Any:
    """The record with other numbers at some of its paths, checked as a new one.

    InputError where a record refuses a number.
    """
    return _replaced(record, changes, "")


def _members(record: object) -> Iterator[tuple[str, Any, str, bool]]:
    """Name, value, unit of each member, and whether a number may stand there."""
    if isinstance(record, BaseModel):
        for name, info in type(record).model_fields.items():
            extra = info.json_schema_extra
            unit = str(extra["unit"]) if isinstance(extra, dict) and "unit" in extra else None
            yield name, getattr(record, name), unit or "", unit is not None
    elif isinstance(record, tuple):
        for i, value in enumerate(record):
            yield str(i), value, "", False
    elif is_dataclass(record):
        for field in fields(record):
            yield field.name, getattr(record, field.name), "", str(field.type) in ("float", "float | None")


def _replaced(record: Any, changes: Mapping[str, float], where: str) -> Any:
    new: dict[str, Any] = {}
    inner: dict[str, dict[str, float]] = {}
    for path, value in changes.items():
        head, _, rest = path.partition(".")
        if rest:
            inner.setdefault(head, {})[rest] = value
        else:
            new[head] = value
    for head, deeper in inner.items():
        member = record[int(head)] if isinstance(record, tuple) else getattr(record, head)
        new[head] = _replaced(member, deeper, f"{where}{head}.")
    if isinstance(record, tuple):
        return tuple(new.get(str(i), value) for i, value in enumerate(record))
    if isinstance(record, BaseModel):
        # a field that is None was left out, and stays so
        given = {name: getattr(record, name) for name in type(record).model_fields}
        kept = {name: value for name, value in given.items() if value is not None}
        return validated(type(record), {**kept, **new}, where.rstrip(".") or "campaign")
    return replace(record, **new)
