"""Vehicles of the railtoolkit rolling-stock schema (YAML): mass, load limit and running resistance.

The schema knows neither axles nor wheels nor brakes; `files` puts them beside it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

from pydantic import ConfigDict

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import KMH, quantity, shown

from .records import GRAVITY, Record, Resistance
from .validation import close_match, file_name, read_text, validated

_DEEPEST = 20
"""Levels of nesting; the schema has four, and libyaml's recursive composer overruns its stack on thousands."""

_REFERENCE_SPEED = 100.0 * KMH
"""The speed at which the schema's coefficients are the resistance, m/s."""

_MOST_IDS_SHOWN = 10


RESISTANCE_COEFFICIENTS = ("base_resistance", "rolling_resistance", "air_resistance")
"""The schema's names of the coefficients of v^0, v^1 and v^2."""


class RollingStock(Record):
    """What is used of one vehicle of a railtoolkit file, in the schema's units; its other keys are ignored.

    Running resistance per weight: base + rolling (v/100 km/h) + air (v/100 km/h)^2, per mille of m g; a
    coefficient the file does not give is None ([railtoolkit] schema 2022.05).
    """

    # it is somebody else's schema: keys this package does not know are not the user's mistakes
    model_config = ConfigDict(extra="ignore")
    # PyYAML reads 4e1 as text, and the schema says which unit each number has
    text_needs_unit: ClassVar[bool] = False

    name: str
    id: str
    mass: float = quantity("t", "mass of the empty vehicle", gt=0)
    load_limit: float | None = quantity("t", "largest load", ge=0, default=None)
    rotation_mass: float | None = quantity("1", "factor on the mass for rotating parts", ge=1, default=None)
    base_resistance: float | None = quantity("permille", "constant resistance of m g", ge=0, default=None)
    rolling_resistance: float | None = quantity("permille", "resistance linear in v, of m g", ge=0, default=None)
    air_resistance: float | None = quantity("permille", "resistance quadratic in v, of m g", ge=0, default=None)

    def resistance(self, mass: float) -> Resistance:
        """Return the running resistance of `mass` (kg) of the vehicle, in SI; an absent coefficient is 0."""
        per_mille = 1e-3 * mass * GRAVITY
        return Resistance(
            constant=per_mille * (self.base_resistance or 0.0),
            linear=per_mille * (self.rolling_resistance or 0.0) / _REFERENCE_SPEED,
            quadratic=per_mille * (self.air_resistance or 0.0) / _REFERENCE_SPEED**2,
        )


def read_rolling_stock(path: Path, *, vehicle_id: str | None = None, where: str = "") -> RollingStock:
    """Return one vehicle of a railtoolkit file.

    Parameters
    ----------
    path : Path
        YAML in the railtoolkit rolling-stock schema, at most `validation.LARGEST_FILE` bytes, without aliases.
    vehicle_id : str, optional
        The `id` of the vehicle; needed when the file holds several.
    where : str
        What an error begins with; left out, the path.

    Raises
    ------
    InputError
        The file cannot be read, is not YAML, or lacks the vehicle; or a value is missing or not allowed.
    """
    where = where or file_name(path)
    vehicles = _vehicles(_parse(read_text(path, where=where), where), where)
    chosen = _choose(vehicles, vehicle_id, where)
    # an empty value in YAML is null, and means the same as no key
    given = {key: value for key, value in chosen.items() if isinstance(key, str) and value is not None}
    return validated(RollingStock, given, f"{where}: vehicle {shown(given.get('id'))}")


def _parse(text: str, where: str) -> Any:
    import yaml

    # libyaml's loader is some ten times faster; PyYAML can be built without it
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
    # ValueError: a date such as 2022-99-99, or an integer of more digits than Python reads
    except (yaml.YAMLError, ValueError) as error:
        raise InputError(f"{where}: not valid YAML: {' '.join(str(error).split())}") from None


def _refuse_bombs(text: str, where: str, loader: Any) -> None:
    """Refuse, before anything is built, aliases (which multiply) and deep nesting (which overruns the stack)."""
    import yaml

    depth = 0
    for event in yaml.parse(text, Loader=loader):
        if isinstance(event, yaml.AliasEvent):
            alias = shown(f"*{event.anchor}")
            raise InputError(f"{where}: aliases ({alias}) are not read; write the value out in their place")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST:
            raise InputError(f"{where}: is nested more than {_DEEPEST} levels deep; give a railtoolkit file")


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
                f"{where}: holds {len(vehicles)} vehicles; give vehicle_id in a TOML file, one of {listed}"
            )
        return vehicles[0]
    found = [one for one, its_id in zip(vehicles, ids, strict=True) if its_id == vehicle_id]
    if not found:
        near = close_match(vehicle_id, [one for one in ids if isinstance(one, str)])
        raise InputError(f"{where}: vehicle_id: no vehicle {shown(vehicle_id)}; {near}the file has {listed}")
    if len(found) > 1:
        raise InputError(f"{where}: vehicle_id: {len(found)} vehicles have the id {shown(vehicle_id)}; make it unique")
    return found[0]
