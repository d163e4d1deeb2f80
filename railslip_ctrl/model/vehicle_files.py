"""Read a vehicle from a TOML file, from a railtoolkit YAML file, or from a TOML file that names a YAML file."""

from __future__ import annotations

import json
from copy import copy
from pathlib import Path
from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field, create_model

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import KMH, quantity, shown
from railslip_ctrl.core.user_files import close_match, file_name, given_path, read_text, read_toml, validated

from .vehicle import GRAVITY, PARK2008, Actuator, Record, Resistance, Vehicle, Wheel

DEFAULT_AXLES = 4  #: axles of a railtoolkit vehicle if none are given: two bogies, as in [Park2008] Fig. 2


def _optional(record: type[BaseModel], name: str) -> Any:
    field = copy(record.model_fields[name])
    field.default = None
    return field


def _table(record: type[Record]) -> type[Record]:
    """Make a record with the same fields as `record`, all optional."""
    keys: dict[str, Any] = {name: (float | None, _optional(record, name)) for name in record.model_fields}
    return create_model(f"{record.__name__}Keys", __base__=Record, **keys)


WheelKeys, ResistanceKeys, ActuatorKeys = _table(Wheel), _table(Resistance), _table(Actuator)


class VehicleKeys(Record):
    """Keys of a vehicle's TOML file; `mass` or `rolling_stock` is required, all others are optional.

    `mass` and `wheel_load` are those of the quarter car. `rolling_stock` names a YAML file with the mass of the whole
    vehicle; `axles` and `vehicle_id` are used only with this file.
    """

    name: str | None = None
    mass: float | None = _optional(Vehicle, "mass")
    mass_loaded: float | None = _optional(Vehicle, "mass_loaded")
    wheel_load: float | None = _optional(Vehicle, "wheel_load")
    wheel_load_loaded: float | None = _optional(Vehicle, "wheel_load_loaded")
    rolling_stock: str | None = None
    vehicle_id: str | None = None
    axles: int | None = Field(None, ge=1, le=100, strict=True, description="axles of the whole vehicle")
    inertia_scale: float | None = _optional(Vehicle, "inertia_scale")
    speed_limit: float | None = _optional(Vehicle, "speed_limit")
    wheel: WheelKeys = WheelKeys()  # type: ignore[valid-type]
    resistance: ResistanceKeys = ResistanceKeys()  # type: ignore[valid-type]
    actuator: ActuatorKeys = ActuatorKeys()  # type: ignore[valid-type]
    envelope: dict[str, Any] = Field({}, description="operating range of its designs; see `design.envelope`")


def load_vehicle(path: str | Path) -> Vehicle:
    """Load the quarter car described by a file.

    - path: `.toml` with the keys of `VehicleKeys`, or `.yaml`/`.yml` in the railtoolkit rolling-stock schema with one
      vehicle. The TOML file has priority over a YAML file that it names.

    Returns the vehicle in SI. Wheel and brake of [Park2008] replace missing values, and `notes` has one sentence for
    each assumption. InputError: the file cannot be read, or a key or value in it is not allowed.
    """
    path = given_path(path)
    suffix = path.suffix.lower()
    if suffix == ".toml":
        return vehicle_from_keys(read_toml(path), path, where=file_name(path))
    if suffix in {".yaml", ".yml"}:
        stock = read_rolling_stock(path)
        return _vehicle(VehicleKeys(), stock, where=file_name(path), source=f"{path.name} [railtoolkit]")
    raise InputError(f"{file_name(path)}: the file type {shown(path.suffix)} is not read; give .toml, .yaml or .yml")


def vehicle_from_keys(content: dict[str, Any], path: Path, *, where: str) -> Vehicle:
    """Make a vehicle from the keys of the file `path`; error messages begin with `where`."""
    keys = validated(VehicleKeys, content, where)
    keys = keys.model_copy(update={"envelope": with_laws_beside(keys.envelope, path)})
    if keys.rolling_stock is None:
        _refuse_incomplete(keys, where)
        return _vehicle(keys, None, where=where, source=path.name)
    beside = path.parent / keys.rolling_stock  # relative to the TOML, not to the working directory
    stock = read_rolling_stock(beside, vehicle_id=keys.vehicle_id, where=f"{where}: rolling_stock: {file_name(beside)}")
    return _vehicle(keys, stock, where=where, source=f"{path.name} with {beside.name} [railtoolkit]")


def with_laws_beside(table: dict[str, Any], path: Path) -> dict[str, Any]:
    """Prefix the names of law files in the table [envelope] of the file `path` with the folder of this file."""
    laws = table.get("laws")
    if not isinstance(laws, list):
        return table
    beside = [str(path.parent / x) if isinstance(x, str) and x.lower().endswith((".toml", ".py")) else x for x in laws]
    return table | {"laws": beside}


def _refuse_incomplete(keys: VehicleKeys, where: str) -> None:
    if keys.mass is None:
        raise InputError(f"{where}: mass: missing; give mass (quarter car, kg) or rolling_stock (a railtoolkit file)")
    for name in ("axles", "vehicle_id"):
        if getattr(keys, name) is not None:
            raise InputError(f"{where}: {name} is used only with rolling_stock; remove {name}")


def _vehicle(keys: VehicleKeys, stock: RollingStock | None, *, where: str, source: str) -> Vehicle:
    """Make the vehicle; the TOML file has priority over the YAML file, and both have priority over published values."""
    notes: list[str] = []
    mass, mass_loaded = _masses(keys, stock, notes)
    wheel_load = _first(keys.wheel_load, mass * GRAVITY)
    wheel = validated(Wheel, _or_published("wheel", keys.wheel, PARK2008.wheel, notes), where)
    resistance = validated(Resistance, _resistance(keys.resistance, stock, mass, notes), where)
    actuator = validated(Actuator, _or_published("actuator", keys.actuator, PARK2008.actuator, notes), where)
    if stock is not None and stock.rotation_mass is not None:
        implied = (stock.rotation_mass - 1.0) * mass * wheel.radius * wheel.radius
        notes.append(
            f"rotation_mass = {stock.rotation_mass:g} is not applied to M, because the wheel has its own inertia; this "
            f"factor implies J = {implied:.4g} kg*m^2 per axle, but {wheel.inertia:.4g} kg*m^2 is used."
        )
    limit = None if stock is None or stock.speed_limit is None else stock.speed_limit * KMH
    values = {
        "name": " ".join((keys.name or (stock.name if stock else Path(source).stem)).split()),
        "mass": mass,
        "mass_loaded": mass_loaded,
        "wheel_load": wheel_load,
        "wheel_load_loaded": _first(keys.wheel_load_loaded, wheel_load * (mass_loaded / mass)),
        "wheel": wheel,
        "resistance": resistance,
        "actuator": actuator,
        "inertia_scale": _first(keys.inertia_scale, 1.0),
        "speed_limit": limit if keys.speed_limit is None else keys.speed_limit,
        "source": source,
        "notes": tuple(notes),
        "envelope": json.dumps(keys.envelope, default=str),
    }
    return validated(Vehicle, values, where)


def _masses(keys: VehicleKeys, stock: RollingStock | None, notes: list[str]) -> tuple[float, float]:
    if stock is None:
        assert keys.mass is not None  # _refuse_incomplete
        mass, load = keys.mass, None
    else:
        axles = keys.axles or DEFAULT_AXLES
        if keys.axles is None and keys.mass is None:
            notes.append(
                f"{DEFAULT_AXLES} axles are assumed, because no number is given; M is a quarter of the vehicle's mass."
            )
        mass = _first(keys.mass, stock.mass * 1000.0 / axles)
        load = None if stock.load_limit is None else stock.load_limit * 1000.0 / axles
    if keys.mass_loaded is not None:
        return mass, keys.mass_loaded
    if load is None:
        notes.append("No load is given: the loaded vehicle has the mass of the empty one.")
    return mass, mass + (load or 0.0)


def _resistance(keys: Record, stock: RollingStock | None, mass: float, notes: list[str]) -> dict[str, float]:
    given: dict[str, float] = keys.model_dump(exclude_none=True)
    if stock is None:
        if not given:
            notes.append("No travelling resistance is given: it is taken as 0.")
        return given
    if len(given) < len(ResistanceKeys.model_fields):
        notes.append("The running resistance is that of the empty mass, also for the loaded vehicle.")
    of_key = dict(zip(ResistanceKeys.model_fields, RESISTANCE_COEFFICIENTS, strict=True))
    absent = [name for key, name in of_key.items() if getattr(stock, name) is None and key not in given]
    if absent:
        notes.append(f"No {' and no '.join(absent)} is given: 0 is used in the running resistance.")
    return {**stock.resistance(mass).model_dump(), **given}


def _or_published(table: str, keys: Record, published: Record, notes: list[str]) -> dict[str, float]:
    given: dict[str, float] = keys.model_dump(exclude_none=True)
    values: dict[str, float] = published.model_dump()
    units = type(published).units()
    lacking = [f"{name} = {values[name]:g} {units[name]}" for name in values if name not in given]
    if lacking:
        notes.append(f"Missing values of the {table} are from [Park2008], Tables 1 and 2, p. 55: {', '.join(lacking)}.")
    return {**values, **given}


def _first(given: float | None, otherwise: float) -> float:
    return otherwise if given is None else given


_DEEPEST = 20  # largest depth of nesting; the schema has four levels, and thousands overflow the stack of libyaml
_REFERENCE_SPEED = 100.0 * KMH  # m/s, speed unit of the schema's resistance coefficients
_MOST_IDS_SHOWN = 10  # vehicle ids listed in an error message

RESISTANCE_COEFFICIENTS = ("base_resistance", "rolling_resistance", "air_resistance")  #: of v^0, v^1 and v^2


class RollingStock(Record):
    """Vehicle of a railtoolkit file, with the units of [railtoolkit] schema 2022.05; other keys are ignored.

    Running resistance: base + rolling (v/100 km/h) + air (v/100 km/h)^2, per mille of the weight m g.
    """

    model_config = ConfigDict(extra="ignore")
    text_needs_unit: ClassVar[bool] = False  # PyYAML reads 4e1 as text, and the schema defines the units

    name: str
    id: str
    mass: float = quantity("t", "mass of the empty vehicle", gt=0)
    load_limit: float | None = quantity("t", "largest load", ge=0, default=None)
    speed_limit: float | None = quantity("km/h", "highest speed", gt=0, default=None)
    rotation_mass: float | None = quantity("1", "factor on the mass for rotating parts", ge=1, default=None)
    base_resistance: float | None = quantity("permille", "constant resistance over m g", ge=0, default=None)
    rolling_resistance: float | None = quantity("permille", "resistance linear in v, over m g", ge=0, default=None)
    air_resistance: float | None = quantity("permille", "resistance quadratic in v, over m g", ge=0, default=None)

    def resistance(self, mass: float) -> Resistance:
        """Running resistance, SI, of a part of the vehicle with the mass `mass`, kg; a missing coefficient is 0."""
        per_mille = 1e-3 * mass * GRAVITY
        return Resistance(
            constant=per_mille * (self.base_resistance or 0.0),
            linear=per_mille * (self.rolling_resistance or 0.0) / _REFERENCE_SPEED,
            quadratic=per_mille * (self.air_resistance or 0.0) / _REFERENCE_SPEED**2,
        )


def read_rolling_stock(path: Path, *, vehicle_id: str | None = None, where: str = "") -> RollingStock:
    """Read the vehicle `vehicle_id`, or the only one, from a railtoolkit file; error messages begin with `where`."""
    where = where or file_name(path)
    vehicles = _vehicles(_parse(read_text(path, where=where), where), where)
    chosen = _choose(vehicles, vehicle_id, where)
    given = {key: value for key, value in chosen.items() if isinstance(key, str) and value is not None}
    return validated(RollingStock, given, f"{where}: vehicle {shown(given.get('id'))}")


def _parse(text: str, where: str) -> Any:
    import yaml

    # libyaml's loader is about ten times faster; some builds of PyYAML lack it
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        _refuse_bombs(text, where, loader)
        return yaml.load(text, Loader=loader)  # CSafeLoader and SafeLoader build plain values only
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        line = f" (at line {mark.line + 1}, column {mark.column + 1})" if mark is not None else ""
        raise InputError(f"{where}: not valid YAML: {error.problem}{line}") from None
    except InputError:
        raise
    # ValueError: a date such as 2022-99-99, or an integer with more digits than Python allows
    except (yaml.YAMLError, ValueError) as error:
        raise InputError(f"{where}: not valid YAML: {' '.join(str(error).split())}") from None


def _refuse_bombs(text: str, where: str, loader: Any) -> None:
    """Refuse aliases, which can multiply the content, and deep nesting, which overflows the stack."""
    import yaml

    depth = 0
    for event in yaml.parse(text, Loader=loader):
        if isinstance(event, yaml.AliasEvent):
            alias = shown(f"*{event.anchor}")
            raise InputError(f"{where}: aliases ({alias}) are not read; replace each by its value")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST:
            raise InputError(f"{where}: the file is nested more than {_DEEPEST} levels deep; give a railtoolkit file")


def _vehicles(content: Any, where: str) -> list[dict[Any, Any]]:
    vehicles = content.get("vehicles") if isinstance(content, dict) else None
    if not isinstance(vehicles, list) or not vehicles or not all(isinstance(one, dict) for one in vehicles):
        raise InputError(f"{where}: vehicles: missing or not a list of vehicles; give a railtoolkit rolling-stock file")
    return vehicles


def _choose(vehicles: list[dict[Any, Any]], vehicle_id: str | None, where: str) -> dict[Any, Any]:
    ids = [one.get("id") for one in vehicles]
    listed = ", ".join(shown(one) for one in ids[:_MOST_IDS_SHOWN])
    if len(ids) > _MOST_IDS_SHOWN:
        listed += f" and {len(ids) - _MOST_IDS_SHOWN} more"
    if vehicle_id is None:
        if len(vehicles) > 1:
            raise InputError(
                f"{where}: the file contains {len(vehicles)} vehicles; write a TOML vehicle file with rolling_stock = "
                f"this file and vehicle_id = one of {listed}"
            )
        return vehicles[0]
    matches = [one for one, its_id in zip(vehicles, ids, strict=True) if its_id == vehicle_id]
    if not matches:
        near = close_match(vehicle_id, [one for one in ids if isinstance(one, str)])
        raise InputError(f"{where}: vehicle_id: no vehicle {shown(vehicle_id)}; {near}the file has {listed}")
    if len(matches) > 1:
        raise InputError(
            f"{where}: vehicle_id: {len(matches)} vehicles have the id {shown(vehicle_id)}; make it unique"
        )
    return matches[0]
