"""Adhesion laws with the user's parameters, from a TOML file.

    law = "lugre"
    condition = "dry"            # optional; what the parameters describe, "dry" if left out

    [parameters]                 # SI, or strings with a unit
    alpha = 2.0e4
    Fs = "10.3 kN"

    [reference_slip]             # optional
    dry = 0.13
    wet = 0.09

    [polynomials]                # optional; parameters over the initial speed v0 in km/h, here 0.4 - 0.001 v0
    mu_max = [0.4, -0.001]

    initial_speed_range = [30, 140]   # optional, above the tables; km/h, for which the polynomials hold

Left-out parameters take the law's defaults, where it has any. Wet parameters follow from dry ones by `AdhesionLaw.wet`.
"""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from railslip_ctrl.errors import InputError
from railslip_ctrl.parameters import Rail, Record

from .base import AdhesionLaw, ReferenceSlip
from .registry import law_class

_R = TypeVar("_R", bound=Record)
_KEYS = frozenset({"law", "condition", "parameters", "polynomials", "initial_speed_range", "reference_slip"})

_ROUNDING = 1e-6  # relative: a speed that went from km/h to m/s and back is in its range still


def load_law(path: str | Path, *, initial_speed_kmh: float | None = None) -> AdhesionLaw:
    """Read an adhesion law and its parameters from a TOML file.

    Parameters
    ----------
    path : str or Path
        Keys `law`, `condition`, `parameters`, `polynomials`, `initial_speed_range` and `reference_slip`; numbers SI,
        or text with a unit.
    initial_speed_kmh : float or None
        v0, km/h, at which polynomials are taken; not needed without.

    Raises
    ------
    InputError
        The file cannot be read, or one line naming file, key, value and bound.
    """
    content = _read(Path(path))
    unknown = sorted(content.keys() - _KEYS)
    if unknown:
        raise InputError(f"{path}: unknown key {unknown[0]!r}; allowed are {', '.join(sorted(_KEYS))}")
    cls = _class(content, path)
    condition = content.get("condition", Rail.DRY.value)
    if condition not in tuple(Rail):
        raise InputError(f"{path}: key 'condition': {condition!r} is not allowed; give 'dry' or 'wet'")
    parameters = _table(content, "parameters", path)
    _check_names(parameters, cls.parameter_names(), path, "parameters")
    polynomials = _table(content, "polynomials", path)
    _check_names(polynomials, cls.parameter_names(), path, "polynomials")
    if polynomials:
        v0 = _speed_in_range(content, path, initial_speed_kmh)
        parameters = parameters | {k: _polynomial(c, v0, path, k) for k, c in polynomials.items()}
    reference = None
    if "reference_slip" in content:
        slips = _table(content, "reference_slip", path)
        _check_names(slips, tuple(ReferenceSlip.model_fields), path, "reference_slip")
        reference = _validated(ReferenceSlip, slips, path, "reference_slip")
    return _validated(cls, {**parameters, "rail": Rail(condition), "reference": reference}, path, "parameters")


def law_name_in(path: str | Path) -> str:
    """The name of the law in the file at a path, whatever its parameters. InputError as `load_law`."""
    return _class(_read(Path(path)), path).name


def _class(content: dict[str, Any], path: str | Path) -> type[AdhesionLaw]:
    name = content.get("law")
    if not isinstance(name, str):
        raise InputError(f'{path}: key "law": give the name of an adhesion law, for example law = "lugre"')
    try:
        return law_class(name)
    except InputError as error:
        raise InputError(f"{path}: key 'law': {error}") from None


def _speed_in_range(content: dict[str, Any], path: str | Path, speed: float | None) -> float:
    """v0 in km/h, given and in the range that the polynomials hold for."""
    if speed is None:
        raise InputError(f"{path}: its parameters are polynomials of the initial speed; give --initial-speed (km/h)")
    limits = content.get("initial_speed_range", [0.0, math.inf])
    if not (_numbers(limits) and len(limits) == 2):
        raise InputError(f"{path}: key 'initial_speed_range': give the lowest and the highest speed, [30, 140] (km/h)")
    low, high = limits
    if not low * (1 - _ROUNDING) <= speed <= high * (1 + _ROUNDING):
        raise InputError(
            f"{path}: initial speed: {speed:.4g} km/h is outside {low:.4g} to {high:.4g}, for which its polynomials "
            "hold; give one inside (km/h)"
        )
    return speed


def _numbers(value: Any) -> bool:
    return isinstance(value, list) and all(type(x) in (int, float) and not math.isnan(x) for x in value)


def _polynomial(coefficients: Any, speed: float, path: str | Path, name: str) -> float:
    if not (_numbers(coefficients) and coefficients):
        raise InputError(
            f"{path}: key 'polynomials.{name}': {coefficients!r} is not a list of numbers; give the constant, the "
            "factor of v0, of v0^2 and so on (SI over powers of km/h)"
        )
    return float(sum(c * speed**k for k, c in enumerate(coefficients)))


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
