"""The docstring of a record: what it says itself, then its fields, each from its own description."""

from __future__ import annotations

import inspect
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

_BOUNDS = (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="))


def documented(record: type[BaseModel]) -> str:
    """Return the docstring of a record with a section of its described fields: type, meaning, unit, range, default."""
    entries = [
        f"{name} : {_type_words(info.annotation)}\n    {_sentence(info)}"
        for name, info in record.model_fields.items()
        if info.description
    ]
    own = inspect.cleandoc(record.__doc__ or "")
    return "\n".join([own, "", "Attributes", "----------", *entries, ""]) if entries else own


def _sentence(info: FieldInfo) -> str:
    meaning = info.description or ""
    extra = info.json_schema_extra
    parts = [meaning[0].upper() + meaning[1:]]
    if isinstance(extra, dict) and "unit" in extra:
        unit = "dimensionless" if extra["unit"] == "1" else str(extra["unit"])
        parts.append(", ".join([unit, *_range(info)]))
    if not info.is_required() and _default(info.default):
        parts.append(f"default {_default(info.default)}")
    return "; ".join(parts) + "."


def _range(info: FieldInfo) -> list[str]:
    return [
        f"{sign} {bound:g}"
        for key, sign in _BOUNDS
        for constraint in info.metadata
        if (bound := getattr(constraint, key, None)) is not None
    ]


def _default(value: object) -> str:
    """A default as a word; nothing for what is absent or empty, or a record, which lists its own."""
    if isinstance(value, (bool, str)):
        return str(value)
    return f"{value:g}" if isinstance(value, (int, float)) else ""


def _type_words(annotation: Any) -> str:
    if get_origin(annotation) in (Union, UnionType):
        members = [_type_words(member) for member in get_args(annotation) if member is not NoneType]
        return " or ".join([*members, *(["None"] if NoneType in get_args(annotation) else [])])
    if get_origin(annotation) is tuple:
        return f"tuple of {_type_words(get_args(annotation)[0])}"
    return getattr(annotation, "__name__", str(annotation))
