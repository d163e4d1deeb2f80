"""Adhesion laws; to add a law, add a module with a subclass of `AdhesionLaw` to this package."""

from __future__ import annotations

import importlib
import itertools
import math
import pkgutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from railslip_ctrl.core.arguments import checked, number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import KMH, quantity, shown, to_unit
from railslip_ctrl.core.user_files import file_name, given_path, read_toml, record_in, validated
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH, PARK2008, Rail, Record, Vehicle

from .base import INITIAL_SPEED_RANGE_KMH, RIG_WHEEL_LOAD, AdhesionLaw, Kink, ReferenceSlip, Statement

__all__ = [
    "INITIAL_SPEED_RANGE_KMH", "RIG_WHEEL_LOAD", "AdhesionLaw", "Kink", "ReferenceSlip", "Statement",
    "in_reading", "initial_speeds_in", "is_over_initial_speed", "law_class", "law_classes", "law_names", "load_law",
    "named_law", "published_law", "wheel_load_in",
]  # fmt: skip


def _laws() -> Iterator[type[AdhesionLaw]]:
    for info in pkgutil.iter_modules(__path__):
        if info.name == "base":
            continue
        module = importlib.import_module(f".{info.name}", __package__)
        for value in vars(module).values():
            if isinstance(value, type) and issubclass(value, AdhesionLaw) and value.__module__ == module.__name__:
                yield value


def law_classes() -> dict[str, type[AdhesionLaw]]:
    """Classes of all laws by name, in alphabetical order."""
    return {law.name: law for law in sorted(_laws(), key=lambda law: law.name)}


def law_names() -> tuple[str, ...]:
    """Names of the laws, in alphabetical order."""
    return tuple(law_classes())


@checked
def law_class(name: str) -> type[AdhesionLaw]:
    """Class of the law `name`, which may have hyphens instead of underscores; InputError if there is no such law."""
    laws = law_classes()
    key = name.strip().lower().replace("-", "_")
    if key not in laws:
        raise InputError(f"adhesion: {shown(name)} is not a law; choose one of {', '.join(laws)}")
    return laws[key]


@checked
def published_law(
    name: str, rail: Rail | str, initial_speed_kmh: float = INITIAL_SPEED_KMH, wheel_load: float = PARK2008.wheel_load
) -> AdhesionLaw:
    """Return an adhesion law with its published parameters.

    - name: one of `law_names`. [Park2008] gives parameters for "beam" ((5)-(10), Table 1), "bristle" ((19)-(24),
      (30)-(32)) and "curve" (Fig. 17). The attribute `source` of a law names its publication.
    - rail: rail condition, "dry" or "wet".
    - initial_speed_kmh: speed v0 at which braking starts, km/h, 30 to 140; the parameters of some laws depend on it.
    - wheel_load: wheel load N, newtons, > 0. [Park2008] has parameters for 34 500 N; for another load they are
      converted on the assumption that mu does not change.

    InputError: an unknown name or rail condition, or a number outside its range. MissingParametersError: the source
    gives no parameters for this law.
    """
    law = law_class(name).published(Rail.of(rail), initial_speed_kmh, wheel_load)
    return law.model_copy(update={"of_wheel_load": wheel_load}) if law.has_forces() else law


@checked
def named_law(name: str, vehicle: Vehicle, initial_speed: float = INITIAL_SPEED_KMH * KMH) -> AdhesionLaw:
    """Return the published adhesion law `name` for dry rail, scaled by `in_reading`.

    - vehicle: quarter car; its wheel load and inertia scale are used.
    - initial_speed: v0, m/s, within 30 to 140 km/h.

    Errors as in `published_law`.
    """
    v0 = round(initial_speed / KMH, 9)  # 100 km/h, not 100.00000000000001
    return in_reading(published_law(name, Rail.DRY, v0, vehicle.wheel_load), vehicle)


@checked
def in_reading(law: AdhesionLaw, vehicle: Vehicle) -> AdhesionLaw:
    """Multiply the stiffness alpha of a published dynamic `law` by the inertia scale of the `vehicle`."""
    if law.has_state and vehicle.inertia_scale != 1.0:
        law = law.model_copy(update={"alpha": vehicle.inertia_scale * law.alpha})  # type: ignore[attr-defined]
    return law


_ROUNDING = 1e-6  # relative tolerance of the range of v0, for a speed converted from km/h to m/s and back


class LawFile(Record):
    """Keys of the TOML file of an adhesion law."""

    law: str = Field(description="name of the law")
    condition: Rail = Field(Rail.DRY, description="rail condition of the parameters")
    parameters: dict[str, Any] = Field({}, description="parameters of the law")
    polynomials: dict[str, Any] = Field({}, description="parameters as polynomials of v0, km/h, constant first")
    initial_speed_range: tuple[float, ...] = quantity("km/h", "lowest and highest v0 of the log", default=())
    reference_slip: dict[str, Any] = Field({}, description="reference slip ratios, or lists of them over v0")
    wheel_load: float | None = quantity("N", "wheel load of the log", gt=0, default=None)

    @field_validator("initial_speed_range")
    @classmethod
    def _low_and_high(cls, limits: tuple[float, ...]) -> tuple[float, ...]:
        if limits and not (len(limits) == 2 and 0 <= limits[0] <= limits[1]):
            raise InputError(f"{limits} is not allowed; give lowest and highest speed in km/h, for example [30, 140]")
        return limits

    @field_validator("polynomials")
    @classmethod
    def _coefficients(cls, polynomials: dict[str, Any]) -> dict[str, Any]:
        for name, each in polynomials.items():
            if not (isinstance(each, list) and each):
                raise InputError(
                    f"{name}: {shown(each)} is not allowed; give a list of coefficients of v0 (km/h), constant first"
                )
            for coefficient in each:
                to_unit(coefficient, "1", name=name, text_needs_unit=True)
        return polynomials


class SlipsOverSpeed(Record):
    """Table `[reference_slip]` with a slip for each initial speed v0, linearly interpolated between these speeds."""

    initial_speed: tuple[float, ...] = quantity("km/h", "initial speeds v0, ascending")
    dry: tuple[float, ...] = quantity("1", "slip ratios at these speeds, dry rail")
    wet: tuple[float, ...] = quantity("1", "slip ratios at these speeds, wet rail")

    @model_validator(mode="after")
    def _one_each(self) -> Self:
        if not self.initial_speed or any(b <= a for a, b in itertools.pairwise(self.initial_speed)):
            raise InputError("initial_speed: the list is not allowed; give ascending speeds (km/h)")
        if {len(self.dry), len(self.wet)} != {len(self.initial_speed)}:
            raise InputError(
                f"dry, wet: {len(self.dry)} and {len(self.wet)} slips for {len(self.initial_speed)} speeds; give one "
                "slip for each speed"
            )
        return self


@checked
def load_law(path: str | Path, *, initial_speed_kmh: float | None = None) -> AdhesionLaw:
    """Load an adhesion law from its file or by its name.

    - path: a TOML file with the keys of `LawFile`; a Python file, which is run and must define `LAW`; or a name in
      `law_names`, which gives the published law for dry rail.
    - initial_speed_kmh: v0, km/h; required if values in the file depend on v0; by default 100 for a published law.

    InputError: the file cannot be read, or a key or value in it is not allowed.
    """
    path = given_path(path)
    if initial_speed_kmh is not None:
        number("initial speed", initial_speed_kmh, "km/h", gt=0)
    if _is_python(path):
        return _python_law(path)
    if str(path).strip().lower().replace("-", "_") in law_classes():
        return published_law(str(path), Rail.DRY, initial_speed_kmh or INITIAL_SPEED_KMH)
    return law_of(_keys(path), file_name(path), initial_speed_kmh)


def law_of(keys: Any, where: str, initial_speed_kmh: float | None = None) -> AdhesionLaw:
    """Make a law from a mapping with the keys of `LawFile`; error messages begin with `where`."""
    keys = validated(LawFile, keys, where)
    try:
        cls = law_class(keys.law)
    except InputError as error:
        raise InputError(f"{where}: law: {error}") from None
    for table in ("parameters", "polynomials"):  # checked here, because the record of the law has more fields
        for name in getattr(keys, table).keys() - set(cls.parameter_names()):
            raise InputError(f"{where}: {table}.{name}: unknown key; allowed: {', '.join(cls.parameter_names())}")
    values = {**keys.parameters, "rail": keys.condition, "file": where}
    if keys.polynomials:
        v0 = _speed_in_range(keys, where, initial_speed_kmh)
        for name, coefficients in keys.polynomials.items():
            values[name] = float(sum(c * v0**power for power, c in enumerate(coefficients)))
    if keys.reference_slip:
        values["reference"] = validated(
            ReferenceSlip, _slips(keys, where, initial_speed_kmh), f"{where}: reference_slip"
        )
    return validated(cls, values, f"{where}: parameters")


def keys_of(law: AdhesionLaw) -> dict[str, Any]:
    """Keys from which `law_of` makes the law again; InputError for a law that a user's file defines."""
    if law_classes().get(law.name) is not type(law):
        raise InputError(f"adhesion: law {law.name!r} of a Python file cannot be saved; use a law of this package")
    slips = {} if law.reference is None else {"reference_slip": {"dry": law.reference.dry, "wet": law.reference.wet}}
    return {
        "law": law.name,
        "condition": law.rail.value,
        "parameters": {n: getattr(law, n) for n in law.parameter_names()},
        **slips,
    }


@checked
def wheel_load_in(path: str | Path) -> float | None:
    """Wheel load, N, at which the law in the file `path` was identified; None if the file does not give it."""
    path = given_path(path)
    return None if _is_python(path) else _keys(path).wheel_load


@checked
def initial_speeds_in(path: str | Path) -> tuple[float, float] | None:
    """Lowest and highest v0, km/h, of the logs to which the law in the file `path` was fitted; None if not given."""
    limits = _keys(given_path(path)).initial_speed_range
    return (limits[0], limits[1]) if limits else None


@checked
def is_over_initial_speed(path: str | Path) -> bool:
    """True if parameters or reference slips of the law in the file `path` depend on v0."""
    keys = _keys(given_path(path))
    return bool(keys.polynomials) or "initial_speed" in keys.reference_slip


def _keys(path: Path) -> LawFile:
    return validated(LawFile, read_toml(path), file_name(path))


def _slips(keys: LawFile, where: str, speed: float | None) -> dict[str, Any]:
    slips = keys.reference_slip
    if keys.condition is Rail.WET and "wet" in slips:  # a law for wet rail needs no slip for dry rail
        slips = {"dry": slips["wet"], **slips}
    if "initial_speed" not in slips:
        return slips
    if speed is None:
        raise InputError(f"{where}: reference_slip depends on the initial speed; give initial_speed_kmh (km/h)")
    over = validated(SlipsOverSpeed, slips, f"{where}: reference_slip")
    return {rail: float(np.interp(speed, over.initial_speed, getattr(over, rail))) for rail in ("dry", "wet")}


def _speed_in_range(keys: LawFile, where: str, speed: float | None) -> float:
    if speed is None:
        raise InputError(f"{where}: polynomials depend on the initial speed; give initial_speed_kmh (km/h)")
    low, high = keys.initial_speed_range or (0.0, math.inf)
    if not low * (1 - _ROUNDING) <= speed <= high * (1 + _ROUNDING):
        raise InputError(
            f"{where}: initial speed: {speed:.4g} km/h is outside {low:.4g} to {high:.4g} km/h, the range in "
            "which the polynomials of the law are valid; give a speed in this range"
        )
    return speed


def _is_python(path: Path) -> bool:
    return path.suffix.lower() == ".py"


def _python_law(path: Path) -> AdhesionLaw:
    law = record_in(path, "LAW", ("statement", "parameters"))
    if not isinstance(law, AdhesionLaw):
        raise InputError(
            f"{file_name(path)}: LAW is a {type(law).__name__}; assign an instance of a subclass of AdhesionLaw"
        )
    return law.model_copy(update={"file": file_name(path)})
