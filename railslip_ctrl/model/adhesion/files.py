"""Adhesion laws with the user's parameters, from a TOML file.

    law = "lugre"
    condition = "dry"            # optional; what the parameters describe, "dry" if left out

    [parameters]                 # SI, or strings with a unit
    alpha = 2.0e4
    Fs = "10.3 kN"

    [reference_slip]             # optional
    dry = 0.13
    wet = 0.09

    [reference_slip]             # or over the initial speed v0 in km/h, straight between and level beyond
    initial_speed = [30, 140]
    dry = [0.25, 0.13]
    wet = [0.17, 0.09]

    [polynomials]                # optional; parameters over the initial speed v0 in km/h, here 0.4 - 0.001 v0
    mu_max = [0.4, -0.001]

    initial_speed_range = [30, 140]   # optional, above the tables; km/h, for which the parameters hold
    wheel_load = 34500                # optional, above the tables; N, at which the parameters were found

Left-out parameters take the law's defaults, where it has any. Wet parameters follow from dry ones by `AdhesionLaw.wet`.
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np

from railslip_ctrl.core.arguments import checked, number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.model.parameters import Rail
from railslip_ctrl.model.parameters.validation import file_name, given_path, read_toml, validated

from .base import AdhesionLaw, ReferenceSlip
from .registry import law_class

_KEYS = frozenset(
    {"law", "condition", "parameters", "polynomials", "initial_speed_range", "reference_slip", "wheel_load"}
)

_ROUNDING = 1e-6  # relative: a speed that went from km/h to m/s and back is in its range still


@checked
def load_law(path: str | Path, *, initial_speed_kmh: float | None = None) -> AdhesionLaw:
    """Read an adhesion law and its parameters from a TOML file.

    Parameters
    ----------
    path : str or Path
        Keys `law`, `condition`, `parameters`, `polynomials`, `initial_speed_range`, `reference_slip` and
        `wheel_load`; numbers SI, or text with a unit.
    initial_speed_kmh : float or None
        v0, km/h, at which polynomials, and reference slips over v0, are taken; not needed without.

    Returns
    -------
    AdhesionLaw
        A frozen record of the law, its fields in SI, with the reference slips (ratios) where the file has them.

    Raises
    ------
    InputError
        The file cannot be read, or one line naming file, key, value and bound.
    """
    path = given_path(path)
    if initial_speed_kmh is not None:
        number("initial speed", initial_speed_kmh, "km/h", gt=0)
    content = read_toml(path)
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
        if condition == Rail.WET and "dry" not in slips:  # such a law is never on dry rail
            slips = slips | {"dry": slips.get("wet")}
        slips = _reference(slips, path, initial_speed_kmh)
        reference = validated(ReferenceSlip, slips, f"{file_name(path)}: reference_slip")
    values = {**parameters, "rail": Rail(condition), "reference": reference, "file": file_name(path)}
    return validated(cls, values, f"{file_name(path)}: parameters")


@checked
def wheel_load_in(path: str | Path) -> float | None:
    """The wheel load, N, at which the law in the file at a path was found; None where the file has none.

    Forces of bristles, and a beam's stiffness, are those of that load and do not scale with another.
    InputError as `load_law`.
    """
    path = given_path(path)
    load = read_toml(path).get("wheel_load")
    if load is None:
        return None
    if type(load) not in (int, float) or not (math.isfinite(load) and load > 0):
        raise InputError(f"{path}: key 'wheel_load': {load!r} is not allowed; give a finite number > 0 (N)")
    return float(load)


@checked
def initial_speeds_in(path: str | Path) -> tuple[float, float] | None:
    """The lowest and the highest v0, km/h, for which the law in the file at a path was found; None where it says none.

    InputError as `load_law`.
    """
    path = given_path(path)
    return _range(read_toml(path), path)


@checked
def is_over_initial_speed(path: str | Path) -> bool:
    """Whether the law in the file at a path changes with v0: by polynomials, or in its reference slips.

    InputError as `load_law`.
    """
    path = given_path(path)
    content = read_toml(path)
    return bool(_table(content, "polynomials", path)) or "initial_speed" in _table(content, "reference_slip", path)


def _reference(slips: dict[str, Any], path: str | Path, speed: float | None) -> dict[str, Any]:
    """The reference slips, those over the initial speed taken at v0 in km/h."""
    _check_names(slips, (*ReferenceSlip.model_fields, "initial_speed"), path, "reference_slip")
    if "initial_speed" not in slips:
        return slips
    if speed is None:
        raise InputError(f"{path}: its reference slips are over the initial speed; give --initial-speed (km/h)")
    speeds = slips["initial_speed"]
    if not (_numbers(speeds) and speeds and all(a < b for a, b in itertools.pairwise(speeds))):
        raise InputError(f"{path}: key 'reference_slip.initial_speed': give a list of growing speeds (km/h)")
    for name in ReferenceSlip.model_fields:
        if not (_numbers(slips.get(name)) and len(slips[name]) == len(speeds)):
            raise InputError(f"{path}: key 'reference_slip.{name}': give as many slips as speeds, {len(speeds)}")
    return {name: float(np.interp(speed, speeds, slips[name])) for name in ReferenceSlip.model_fields}


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
    low, high = _range(content, path) or (0.0, math.inf)
    if not low * (1 - _ROUNDING) <= speed <= high * (1 + _ROUNDING):
        raise InputError(
            f"{path}: initial speed: {speed:.4g} km/h is outside {low:.4g} to {high:.4g}, for which its polynomials "
            "hold; give one inside (km/h)"
        )
    return speed


def _range(content: dict[str, Any], path: str | Path) -> tuple[float, float] | None:
    """The lowest and the highest v0 in km/h that the parameters hold for; None where the file has none."""
    limits = content.get("initial_speed_range")
    if limits is None:
        return None
    if not (_numbers(limits) and len(limits) == 2 and 0 <= limits[0] <= limits[1]):
        raise InputError(f"{path}: key 'initial_speed_range': give the lowest and the highest speed, [30, 140] (km/h)")
    return float(limits[0]), float(limits[1])


def _numbers(value: Any) -> bool:
    return isinstance(value, list) and all(type(x) in (int, float) and not math.isnan(x) for x in value)


def _polynomial(coefficients: Any, speed: float, path: str | Path, name: str) -> float:
    if not (_numbers(coefficients) and coefficients):
        raise InputError(
            f"{path}: key 'polynomials.{name}': {coefficients!r} is not a list of numbers; give the constant, the "
            "factor of v0, of v0^2 and so on (SI over powers of km/h)"
        )
    return float(sum(c * speed**k for k, c in enumerate(coefficients)))


def _table(content: dict[str, Any], key: str, path: str | Path) -> dict[str, Any]:
    table = content.get(key, {})
    if not isinstance(table, dict):
        raise InputError(f"{path}: key {key!r}: {table!r} is not a table; write [{key}]")
    return table


def _check_names(table: dict[str, Any], allowed: tuple[str, ...], path: str | Path, key: str) -> None:
    unknown = [name for name in table if name not in allowed]
    if unknown:
        raise InputError(f"{path}: unknown key '{key}.{unknown[0]}'; allowed are {', '.join(allowed)}")
