"""Scenarios from the user's TOML files.

    extends = "park2008"              # optional: a built-in scenario or another file; what is left out comes from it
    vehicle = "my_train.toml"         # or a railtoolkit .yaml, "park2008", or a table [vehicle] with a vehicle's keys
    adhesion = "curve"                # a law by name, published parameters at the vehicle's wheel load, or a file
    initial_speed = "120 km/h"        # plain numbers are SI

    [disturbances]                    # keys of `Disturbances`; so [measurement] and [limits]
    random_force = "431 N"

    [[events]]                        # keys of `Event`: from a time or a distance on
    distance = "150 m"
    adhesion_factor = 0.4             # leaves on the rail

Keys are the fields of `Scenario`, and `extends`, `loaded` (true: the vehicle's loaded mass and wheel load) and
`inertia_scale` (of the vehicle). Events given replace those of the scenario extended. Paths are relative to the file.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from railslip_ctrl.core.arguments import checked
from railslip_ctrl.core.errors import InputError, MissingParametersError
from railslip_ctrl.core.units import KMH, quantity, shown, to_unit
from railslip_ctrl.core.user_files import file_name, given_path, read_toml, validated
from railslip_ctrl.model.adhesion import AdhesionLaw, load_law
from railslip_ctrl.model.vehicle import PARK2008, Vehicle
from railslip_ctrl.model.vehicle_files import load_vehicle, vehicle_from_keys

from .scenario import BUILT_IN, Scenario, built_in_scenario, named_law

_TABLES = ("disturbances", "measurement", "limits")
_PUBLISHED_VEHICLE = "park2008"
_LONGEST_CHAIN = 8  # of scenarios that extend one another; a circle has no end


class _Keys(Scenario):
    """The keys of a file: a scenario's, and what leads to one."""

    extends: str | None = None
    loaded: bool = False
    inertia_scale: float | None = quantity("1", "factor on M, J and B", gt=0, default=None)


@checked
def load_scenario(source: str | Path) -> Scenario:
    """A built-in scenario by name, or one from a TOML file.

    Parameters
    ----------
    source : str or Path
        "park2008", "park2008-si", "stop" or a file.

    Returns
    -------
    Scenario
        In SI.

    Raises
    ------
    InputError
        One line with the file, the key, the value and what is allowed.
    """
    path = given_path(source, "scenario")
    if str(source) in BUILT_IN:
        return built_in_scenario(str(source))
    if path.suffix.lower() != ".toml":
        return built_in_scenario(str(source))  # refuses, listing the names
    return _from_file(path, ())


def _from_file(path: Path, chain: tuple[Path, ...]) -> Scenario:
    where = file_name(path)
    if len(chain) >= _LONGEST_CHAIN:
        raise InputError(f"{where}: extends: {len(chain)} files extend one another; end with a built-in scenario")
    keys = read_toml(path)
    base = None if "extends" not in keys else _extended(keys, path, chain)
    content = {} if base is None else base.given()
    own = {name: value for name, value in keys.items() if name not in ("vehicle", "adhesion", *_TABLES)}
    content |= {"name": path.stem, **own}
    for table in _TABLES:
        if table in keys:
            content[table] = _table(keys[table], getattr(base, table, None), f"{where}: {table}")
    content |= _vehicle_and_law(keys, base, path)
    read = validated(_Keys, content, where)
    return Scenario(**{name: value for name, value in read.given().items() if name in Scenario.model_fields})


def _extended(keys: dict[str, Any], path: Path, chain: tuple[Path, ...]) -> Scenario:
    name = keys["extends"]
    if not isinstance(name, str):
        raise InputError(f"{file_name(path)}: extends: {shown(name)} is not allowed; give a scenario's name or file")
    if name in BUILT_IN:
        return built_in_scenario(name)
    if not name.lower().endswith(".toml"):
        raise InputError(
            f"{file_name(path)}: extends: {shown(name)} is not one; choose {' or '.join(BUILT_IN)}, or a TOML file"
        )
    return _from_file(path.parent / name, (*chain, path))


def _table(given: Any, base: Any, where: str) -> Any:
    """A table over that of the scenario extended."""
    if not isinstance(given, dict):
        raise InputError(f"{where}: {shown(given)} is not allowed; give a table of keys")
    return {**({} if base is None else base.model_dump(exclude_none=True)), **given}


def _vehicle_and_law(keys: dict[str, Any], base: Scenario | None, path: Path) -> dict[str, Any]:
    """Vehicle, adhesion law and events that follow from both; what cannot be had is left for the checker to miss."""
    where = file_name(path)
    vehicle = _vehicle(keys["vehicle"], path) if "vehicle" in keys else None if base is None else base.vehicle
    if vehicle is None:
        return {}
    if "inertia_scale" in keys:
        scale = to_unit(keys["inertia_scale"], "1", name=f"{where}: inertia_scale", text_needs_unit=True)
        vehicle = vehicle.model_copy(update={"inertia_scale": scale})
    if keys.get("loaded") is True:
        vehicle = vehicle.loaded()
    found: dict[str, Any] = {"vehicle": vehicle}
    speed = None if base is None else base.initial_speed
    if "initial_speed" in keys:
        speed = to_unit(keys["initial_speed"], "m/s", name=f"{where}: initial_speed", text_needs_unit=True)
    if "adhesion" in keys:
        found["adhesion"] = _law(keys["adhesion"], vehicle, speed, path)
    elif base is not None and speed is not None and speed > 0:
        follows = base.has_named_law
        found["adhesion"] = _law(base.adhesion.name, vehicle, speed, path) if follows else base.adhesion
    if base is not None and "events" not in keys:
        found["events"] = base.for_vehicle(vehicle).events
    return found


def _vehicle(given: Any, path: Path) -> Vehicle:
    where = f"{file_name(path)}: vehicle"
    if isinstance(given, dict):
        return vehicle_from_keys(given, path, where=where)
    if not isinstance(given, str):
        raise InputError(f"{where}: {shown(given)} is not allowed; give a file's name or a table [vehicle]")
    if given == _PUBLISHED_VEHICLE:
        return PARK2008
    try:
        return load_vehicle(path.parent / given)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _law(given: Any, vehicle: Vehicle, speed: float | None, path: Path) -> AdhesionLaw:
    where = f"{file_name(path)}: adhesion"
    if not isinstance(given, str):
        raise InputError(f"{where}: {shown(given)} is not allowed; give a law's name or a TOML file")
    try:
        if given.lower().endswith(".toml"):
            return load_law(path.parent / given, initial_speed_kmh=None if speed is None else speed / KMH)
        if speed is None:
            raise InputError(f"{given!r} needs initial_speed, which is missing; give it (m/s)")
        return named_law(given, vehicle, speed)
    except (InputError, MissingParametersError) as error:
        raise InputError(f"{where}: {error}") from None
