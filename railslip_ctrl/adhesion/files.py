"""Adhesion laws with the user's parameters, from a TOML file.

    law = "lugre"
    condition = "dry"            # optional; what the parameters describe, "dry" if left out

    [parameters]                 # SI, or strings with a unit
    alpha = 2.0e4
    Fs = "10.3 kN"

    [reference_slip]             # optional
    dry = 0.13
    wet = 0.09

Left-out parameters take the law's defaults, where it has any. Wet parameters follow from dry ones by `AdhesionLaw.wet`.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from railslip_ctrl.errors import InputError
from railslip_ctrl.parameters import Rail, Record

from .base import AdhesionLaw, ReferenceSlip
from .registry import law_class

_R = TypeVar("_R", bound=Record)
_KEYS = frozenset({"law", "condition", "parameters", "reference_slip"})


def load_law(path: str | Path) -> AdhesionLaw:
    """Read an adhesion law and its parameters from a TOML file.

    Parameters
    ----------
    path : str or Path
        Keys `law`, `condition`, `parameters` and `reference_slip`; numbers SI, or text with a unit.

    Raises
    ------
    InputError
        The file cannot be read, or one line naming file, key, value and bound.
    """
    content = _read(Path(path))
    unknown = sorted(content.keys() - _KEYS)
    if unknown:
        raise InputError(f"{path}: unknown key {unknown[0]!r}; allowed are {', '.join(sorted(_KEYS))}")
    name = content.get("law")
    if not isinstance(name, str):
        raise InputError(f'{path}: key "law": give the name of an adhesion law, for example law = "lugre"')
    try:
        cls = law_class(name)
    except InputError as error:
        raise InputError(f"{path}: key 'law': {error}") from None
    condition = content.get("condition", Rail.DRY.value)
    if condition not in tuple(Rail):
        raise InputError(f"{path}: key 'condition': {condition!r} is not allowed; give 'dry' or 'wet'")
    parameters = _table(content, "parameters", path)
    _check_names(parameters, cls.parameter_names(), path, "parameters")
    reference = None
    if "reference_slip" in content:
        slips = _table(content, "reference_slip", path)
        _check_names(slips, tuple(ReferenceSlip.model_fields), path, "reference_slip")
        reference = _validated(ReferenceSlip, slips, path, "reference_slip")
    return _validated(cls, {**parameters, "rail": Rail(condition), "reference": reference}, path, "parameters")


def _read(path: Path) -> dict[str, Any]:
    try:
        text = path.read_bytes().decode("utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file in UTF-8") from None
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not a TOML file: {' '.join(str(error).split())}") from None
    if not content:
        raise InputError(f"{path}: empty; it must name a law and give its parameters")
    return content


def _table(content: dict[str, Any], key: str, path: str | Path) -> dict[str, Any]:
    table = content.get(key, {})
    if not isinstance(table, dict):
        raise InputError(f"{path}: key {key!r}: {table!r} is not a table; write [{key}]")
    return table


def _check_names(table: dict[str, Any], allowed: tuple[str, ...], path: str | Path, key: str) -> None:
    unknown = [name for name in table if name not in allowed]
    if unknown:
        raise InputError(f"{path}: unknown key '{key}.{unknown[0]}'; allowed are {', '.join(allowed)}")


def _validated(cls: type[_R], values: dict[str, Any], path: str | Path, key: str) -> _R:
    try:
        return cls(**values)
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(str(part) for part in first["loc"])
        if first["type"] == "missing":
            raise InputError(f"{path}: key '{key}.{name}' is missing") from None
        message = first["msg"].removeprefix("Value error, ").removeprefix(f"{name}: ")
        shown = "" if repr(first["input"]) in message else f"{first['input']!r}: "
        raise InputError(f"{path}: key '{key}.{name}': {shown}{message}") from None
