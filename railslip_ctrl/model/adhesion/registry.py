"""Adhesion laws by name: published ones, those of files, and those of Python modules of the user's own."""

from __future__ import annotations

import importlib
import itertools
import math
import pkgutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from railslip_ctrl.core.arguments import checked, number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import shown
from railslip_ctrl.core.user_files import file_name, given_path, read_toml, record_in, validated
from railslip_ctrl.model.adhesion.base import AdhesionLaw, ReferenceSlip
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH, PARK2008, Rail

_NOT_LAWS = frozenset({"base", "files", "modules", "registry"})


def _laws() -> Iterator[type[AdhesionLaw]]:
    for info in pkgutil.iter_modules(sys.modules[__package__].__path__):
        if info.name in _NOT_LAWS:
            continue
        module = importlib.import_module(f".{info.name}", __package__)
        for value in vars(module).values():
            if isinstance(value, type) and issubclass(value, AdhesionLaw) and value.__module__ == module.__name__:
                yield value


def law_classes() -> dict[str, type[AdhesionLaw]]:
    """The laws by name, in alphabetical order."""
    return {law.name: law for law in sorted(_laws(), key=lambda law: law.name)}


def law_names() -> tuple[str, ...]:
    """Names of the laws, in alphabetical order."""
    return tuple(law_classes())


@checked
def law_class(name: str) -> type[AdhesionLaw]:
    """The law of a name, hyphen or underscore ("tyre-lugre" is "tyre_lugre").

    Raises
    ------
    InputError
        No law of that `name`; lists the names.
    """
    laws = law_classes()
    key = name.strip().lower().replace("-", "_")
    if key not in laws:
        raise InputError(f"adhesion: {shown(name)} is not a law; choose one of {', '.join(laws)}")
    return laws[key]


@checked
def published_law(
    name: str,
    rail: Rail | str,
    initial_speed_kmh: float = INITIAL_SPEED_KMH,
    wheel_load: float = PARK2008.wheel_load,
) -> AdhesionLaw:
    """The published parameter set of a law by name.

    Slip velocity sigma = v - r omega and adhesion force Fa are positive in braking ([Park2008] (1), (2)). Parameters
    that were identified at the rig's wheel load of 34 500 N are taken to another so that mu(slip) stays what was
    measured: this project's assumption, [Park2008] has that load alone.

    Parameters
    ----------
    name : str
        One of `law_names`, hyphen or underscore. [Park2008] gives parameters for "beam" ((5)-(10), Table 1), "bristle"
        ((19)-(24), (30)-(32)) and its "curve" (Fig. 17); `source` of a law names its own.
    rail : Rail or str
        Condition the parameters are for: "dry" or "wet".
    initial_speed_kmh : float
        Speed v0 at which the brake was applied, km/h, 30 to 140: a parameter of the run, not the speed of the moment
        ([Park2008] (30)-(32), Table 1). Laws that are not published over v0 do not use it.
    wheel_load : float
        Wheel load N, N, > 0; the published vehicle's 34 500 N unless given. `operating_point` refuses the law for a
        vehicle of another.

    Returns
    -------
    AdhesionLaw
        A frozen record of the law, its fields in SI, with the reference slips where the source has them.

    Raises
    ------
    InputError
        No law of that name, no such rail condition, or a number outside its range.
    MissingParametersError
        The source gives no parameters for this law.
    """
    law = law_class(name).published(Rail.of(rail), initial_speed_kmh, wheel_load)
    return law.model_copy(update={"of_wheel_load": wheel_load}) if law.has_forces() else law


# --- adhesion laws with the user's parameters, from a TOML file ------------------------------------------------------


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


# --- adhesion laws from the user's Python files: the record that the file names `LAW`, of a class of its own or ours -


NAME = "LAW"
"""What the file has to call its law."""


@checked
def law_in(path: str | Path) -> AdhesionLaw:
    """Run the Python file at a path and take its law, with its parameters and reference slips.

    Raises
    ------
    InputError
        One line: the file cannot be read or run, or its `LAW` is no record of an `AdhesionLaw`.
    """
    path = given_path(path)
    law = record_in(path, NAME, ("statement", "parameters"))
    if not isinstance(law, AdhesionLaw):
        raise InputError(
            f"{file_name(path)}: {NAME} is no adhesion law with its parameters; name a record of a subclass of "
            f"AdhesionLaw so, {NAME} = MyLaw(...)"
        )
    return law.model_copy(update={"file": file_name(path)})
