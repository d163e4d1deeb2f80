"""Records of vehicle, wheel, actuator and rail in SI; published values; checks for implausible values."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from enum import StrEnum
from functools import cache, partial
from operator import attrgetter
from types import MappingProxyType, NoneType
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, field_validator, model_validator
from pydantic.fields import FieldInfo

from railslip_ctrl.core.arguments import checked
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.templates import texts
from railslip_ctrl.core.units import KMH, quantity, shown, to_unit
from railslip_ctrl.core.user_files import one_line, unknown_key

_BOUNDS = (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="))


def documented(record: type[BaseModel]) -> str:
    """Return the docstring of a record with a list of its fields: meaning, unit, range and default of each."""
    entries = [f"- {name}: {_sentence(info)}" for name, info in record.model_fields.items() if info.description]
    own = inspect.cleandoc(record.__doc__ or "")
    return "\n".join([own, "", *entries, ""]) if entries else own


def _sentence(info: FieldInfo) -> str:
    extra, parts = info.json_schema_extra, [info.description or ""]
    if isinstance(extra, dict) and "unit" in extra:
        bounds = ((sign, getattr(each, key, None)) for key, sign in _BOUNDS for each in info.metadata)
        unit = "dimensionless" if extra["unit"] == "1" else str(extra["unit"])
        parts.append(", ".join([unit, *(f"{sign} {bound:g}" for sign, bound in bounds if bound is not None)]))
    if not info.is_required() and isinstance(info.default, (bool, str, int, float)) and info.default != "":
        default = f"{info.default:g}" if type(info.default) in (int, float) else str(info.default)
        parts.append(f"default {default}")
    return "; ".join(parts) + "."


GRAVITY = 9.80665  #: standard acceleration of free fall, m/s^2 (exact, CGPM 1901)
_MASS_ALONE = "M alone was changed: the wheel load is still"


class Rail(StrEnum):
    """Rail condition, "dry" or "wet"."""

    DRY = "dry"
    WET = "wet"

    @classmethod
    def of(cls, value: str) -> Rail:
        """Convert `value`, "dry" or "wet", to a rail condition; InputError for any other text."""
        try:
            return cls(value)
        except ValueError:
            raise InputError(f"rail: {shown(value)} is not a rail condition; choose dry or wet") from None


class Record(BaseModel):
    """Base class of the parameter records: immutable, without unknown keys or non-finite numbers.

    A number is given in SI, or as text with a unit ("3.5 t"). Text without a unit ("3500") is refused.

    InputError: an unknown or missing key; a value of wrong type or dimension, or outside its range; setting a field.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    text_needs_unit: ClassVar[bool] = True  #: refuse numbers given as text without a unit

    def __init__(self, /, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise InputError(one_line(error, type(self).__name__, model=type(self))) from None

    @classmethod
    @cache
    def units(cls) -> dict[str, str]:
        """Return the units of the numeric fields, in the order of the fields; the keys are the names of the fields."""
        extras = {name: info.json_schema_extra for name, info in cls.model_fields.items()}
        return {name: str(each["unit"]) for name, each in extras.items() if isinstance(each, dict) and "unit" in each}

    # marked as pydantic's own: pydantic then validates nested records itself, and errors name the full path of a key
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        cls.__doc__ = documented(cls)

    @classmethod
    def model_validate(cls, obj: Any, **options: Any) -> Self:
        """Make the record from `obj`, a mapping of field values; pydantic gets `options`; InputError as in `Record`."""
        try:
            return super().model_validate(obj, **options)
        except ValidationError as error:
            raise InputError(one_line(error, cls.__name__, model=cls)) from None

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Copy the record with new values of the fields in `update`; the values are not checked.

        `deep` copies nested records too. InputError: a name that is not a field.
        """
        unknown = (update or {}).keys() - type(self).model_fields.keys()
        if unknown:
            key = min(unknown)
            raise InputError(f"{type(self).__name__}: {key}: {unknown_key(key, type(self))}")
        made = super().model_copy(update=update, deep=deep)
        for name in made.__dict__.keys() - type(self).model_fields.keys():  # drop cached properties of the old fields
            del made.__dict__[name]
        return made

    def __iter__(self) -> Iterator[tuple[str, Any]]:  # type: ignore[override]
        # pydantic would iterate over cached properties too
        return ((name, getattr(self, name)) for name in type(self).model_fields)

    if not TYPE_CHECKING:  # type checkers know that the fields are frozen

        def __setattr__(self, name: str, value: object) -> None:
            raise InputError(f"{type(self).__name__}: {name} cannot be set; use model_copy(update={{{name!r}: ...}})")

    @field_validator("*", mode="before")
    @classmethod
    def _to_si(cls, value: object, info: ValidationInfo) -> object:
        name = info.field_name or ""
        field, unit = cls.model_fields[name], cls.units().get(name)
        if value is None and NoneType in get_args(field.annotation):
            return None
        if unit is not None:  # to_unit gets no name, because pydantic's error names the field
            convert = partial(to_unit, unit=unit, text_needs_unit=cls.text_needs_unit)
            return _each(convert, value) if get_origin(field.annotation) is tuple else convert(value)
        if field.annotation is bool and not isinstance(value, bool):  # pydantic alone would accept 1 and "yes"
            raise InputError(f"{shown(value)} is not allowed; give true or false")
        return value


def _each(convert: Callable[[Any], float], value: Any) -> Any:
    return tuple(_each(convert, one) for one in value) if isinstance(value, (list, tuple)) else convert(value)


class Wheel(Record):
    """One braked wheelset ([Park2008] (3), Tables 1 and 2)."""

    radius: float = quantity("m", "wheel radius r", gt=0)
    inertia: float = quantity("kg*m^2", "moment of inertia J", gt=0)
    viscous_friction: float = quantity("N*m*s", "viscous torque coefficient B at the brake pad", ge=0, default=0.0)


class Resistance(Record):
    """Travelling resistance of the quarter car, Fr(v) = constant + linear v + quadratic v^2, N, v in m/s."""

    constant: float = quantity("N", "constant term", ge=0, default=0.0)
    linear: float = quantity("N/(m/s)", "coefficient of v", ge=0, default=0.0)
    quadratic: float = quantity("N/(m/s)^2", "coefficient of v^2", ge=0, default=0.0)

    def force(self, speed: Any) -> Any:
        """Resistance force Fr, N, at `speed`, m/s, a number or an array."""
        return self.constant + self.linear * speed + self.quadratic * speed**2


class Actuator(Record):
    """Pneumatic brake, Ga(s) = exp(-dead_time s)/(lag s + 1) from commanded to acting torque ([Park2008] p. 55)."""

    dead_time: float = quantity("s", "dead time", ge=0)
    lag: float = quantity("s", "time constant of the first-order lag", ge=0)


class PIGains(Record):
    """Gains of PI control Tb = kp e + ki integral(e), e = sigma_d - sigma in m/s, Tb in N*m; of either sign."""

    kp: float = quantity("N*m/(m/s)", "proportional gain")
    ki: float = quantity("N*m/m", "integral gain")


class Vehicle(Record):
    """Quarter car: the part of the train that one wheelset carries and brakes ([Park2008] Fig. 2).

    `inertia_scale` multiplies mass, wheel inertia and viscous friction only. The factor is 1 in SI; 3.6 reproduces the
    published results, for which speeds were in km/h and forces in N. The equations of motion use the multiplied values.
    `mass_loaded` is at least `mass`. A change of mass does not change `wheel_load`.
    """

    name: str = Field(description="name of the vehicle in reports")
    mass: float = quantity("kg", "quarter-car mass M, empty", gt=0)
    mass_loaded: float = quantity("kg", "quarter-car mass M, loaded", gt=0)
    wheel_load: float = quantity("N", "wheel load N, empty", gt=0)
    wheel_load_loaded: float = quantity("N", "wheel load N, loaded", gt=0)
    wheel: Wheel = Field(description="the braked wheelset")
    resistance: Resistance = Field(description="travelling resistance of the quarter car")
    actuator: Actuator = Field(description="the brake")
    inertia_scale: float = quantity("1", "factor on M, J and B", gt=0, default=1.0)
    speed_limit: float | None = quantity("m/s", "highest train speed", gt=0, default=None)
    source: str = Field("", description="source of the numbers")
    notes: tuple[str, ...] = Field((), description="one sentence for each assumption")
    # text, because a record must be hashable; excluded from dumps, because it is not a property of the car
    envelope: str = Field("{}", exclude=True, repr=False, description="table [envelope] of the vehicle's file, as JSON")
    _empty: tuple[float, float] | None = None  # mass, kg, and wheel load, N, before `loaded`

    @model_validator(mode="after")
    def _load_adds(self) -> Vehicle:
        if self.mass_loaded < self.mass:
            raise InputError(
                f"mass_loaded: {self.mass_loaded:g} is not allowed; give a value >= mass = {self.mass:g} (kg)"
            )
        return self

    @property
    def effective_mass(self) -> float:
        """Effective mass inertia_scale * M, kg."""
        return self.inertia_scale * self.mass

    @property
    def effective_inertia(self) -> float:
        """Effective wheel inertia inertia_scale * J, kg m^2."""
        return self.inertia_scale * self.wheel.inertia

    @property
    def effective_viscous_friction(self) -> float:
        """Effective viscous friction inertia_scale * B, N m s."""
        return self.inertia_scale * self.wheel.viscous_friction

    def loaded(self) -> Vehicle:
        """Copy of the vehicle with the loaded mass and wheel load."""
        vehicle = self.model_copy(update={"mass": self.mass_loaded, "wheel_load": self.wheel_load_loaded})
        if (vehicle.mass, vehicle.wheel_load) != (self.mass, self.wheel_load):
            BaseModel.__setattr__(vehicle, "_empty", (self.mass, self.wheel_load))
        return vehicle

    def empty(self) -> Vehicle:
        """Copy of the vehicle; if the vehicle is a result of `loaded`, the copy has the empty mass and wheel load."""
        mass, wheel_load = self._empty or (self.mass, self.wheel_load)
        vehicle = self.model_copy(update={"mass": mass, "wheel_load": wheel_load})
        BaseModel.__setattr__(vehicle, "_empty", None)
        return vehicle

    def with_mass(self, mass: float) -> Vehicle:
        """Copy of the vehicle with another `mass`, kg, and the same wheel load.

        A note records the change, unless the vehicle has a load case with this mass and wheel load.
        """
        changed = self.model_copy(update={"mass": mass, "mass_loaded": max(mass, self.mass_loaded)})
        if any((load.mass, load.wheel_load) == (mass, self.wheel_load) for load in self.loads()):
            return changed
        return changed.model_copy(update={"notes": (*self.notes, f"{_MASS_ALONE} {self.wheel_load:.0f} N.")})

    @property
    def mass_alone(self) -> str:
        """The note that `with_mass` has added; empty if there is none."""
        return next((note for note in self.notes if note.startswith(_MASS_ALONE)), "")

    def loads(self) -> tuple[Vehicle, ...]:
        """Load cases: the vehicle as it is, and loaded if the loaded mass differs."""
        return (self,) if self.mass == self.mass_loaded else (self, self.loaded())


INITIAL_SPEED_KMH = 100.0  #: initial speed v0 of the published run, at which braking starts, km/h ([Park2008] p. 55)
AS_PUBLISHED_INERTIA_SCALE = 3.6  #: reproduces the published results, with speeds in km/h and forces in N

PARK2008 = Vehicle(
    name="Park et al. 2008, quarter car",
    mass=3517.0,
    mass_loaded=5276.0,
    wheel_load=34_500.0,
    wheel_load_loaded=34_500.0,  # [Park2008] does not change N with M
    wheel=Wheel(radius=0.43, inertia=60.35, viscous_friction=0.25),
    resistance=Resistance(quadratic=0.63),
    actuator=Actuator(dead_time=0.15, lag=0.6),
    source="[Park2008] Tables 1 and 2, p. 55",
)


class PrintedPI(NamedTuple):
    """PI gains as printed in [Park2008] Table 4: Kp in "N-h", Ki in "N"; taken as N*m/(km/h) and N*m/(km/h)/s."""

    Kp: float
    Ki: float


class PrintedSliding(NamedTuple):
    """Sliding-mode gains as printed in [Park2008] Table 4; `sliding.law` has their units."""

    D: float
    K: float
    rho: float
    k: float


TABLE4_PI_PRINTED = MappingProxyType({"beam": PrintedPI(400.0, 54.0), "bristle": PrintedPI(650.0, 27.0)})
"""PI gains of [Park2008] Table 4 as printed; the keys are the adhesion laws in the heads of its columns."""

TABLE4_SLIDING_PRINTED = MappingProxyType(
    {"beam": PrintedSliding(1.62, 70.0, 1.65, 2.1e-8), "bristle": PrintedSliding(1.53, 70.0, 1.54, 2.1e-8)}
)
"""ASMC gains of [Park2008] Table 4 as printed; the keys are the adhesion laws in the heads of its columns."""

TABLE4_PI = MappingProxyType(
    {name: PIGains(kp=3.6 * gains.Kp, ki=3.6 * gains.Ki) for name, gains in TABLE4_PI_PRINTED.items()}
)
"""PI gains of [Park2008] Table 4 in SI (N*m/(m/s) and N*m/m), with the keys of `TABLE4_PI_PRINTED`."""


@checked
def table4_gains(adhesion: str) -> PIGains:
    """PI gains of [Park2008] Table 4, SI: the column "beam" if `adhesion` is "beam", otherwise "bristle"."""
    return TABLE4_PI["beam" if adhesion == "beam" else "bristle"]


_SPEED = 100.0 * KMH  # m/s, speed at which the travelling resistance is checked

_VALUES: Mapping[str, Callable[[Vehicle], float]] = {
    **{name: attrgetter(name) for name in ("mass", "mass_loaded", "wheel_load", "wheel_load_loaded")},
    **{name: attrgetter(f"wheel.{name}") for name in ("radius", "inertia", "viscous_friction")},
    **{name: attrgetter(f"actuator.{name}") for name in ("dead_time", "lag")},
    "resistance": lambda v: v.resistance.force(_SPEED),
}
_COMPARED_WITH: Mapping[str, Callable[[Vehicle], float]] = {
    "wheel_load": lambda v: v.mass * GRAVITY,
    "wheel_load_loaded": lambda v: v.mass_loaded * GRAVITY,
    "inertia": lambda v: v.mass * v.wheel.radius**2,
    "viscous_friction": lambda v: v.wheel_load * v.wheel.radius**2 / _SPEED,
    "resistance": lambda v: v.wheel_load,
}

USUAL_RANGES: Mapping[str, Any] = texts(__package__, "usual_ranges.toml")
"""Usual ranges of a vehicle's numbers by key; `usual_ranges.toml` describes its columns."""


@checked
def vehicle_warnings(vehicle: Vehicle) -> tuple[str, ...]:
    """Warnings on implausible numbers of a `vehicle`; `inertia_scale` is ignored."""
    found: dict[str, str] = {}
    for key, usual in USUAL_RANGES.items():
        value, unit = _VALUES[key](vehicle), usual["unit"]
        scale = _COMPARED_WITH[key](vehicle) if key in _COMPARED_WITH else 1.0
        low, high = (bound * scale for bound in usual["range"])
        if not low <= value <= high and not found.keys() & set(usual.get("after", ())):
            found[key] = (
                f"{key} = {_plain(value, 6)} {unit} is taken as given, but is outside the usual {_plain(low)} to "
                f"{_plain(high)} {unit} ({usual['why']}); {_remedy(usual, value, low, high)}."
            )
    return tuple(found.values())


@checked
def notes_and_warnings(vehicle: Vehicle) -> tuple[str, ...]:
    """Notes of a `vehicle` on assumptions, then its `vehicle_warnings`."""
    return (*vehicle.notes, *vehicle_warnings(vehicle))


def _remedy(usual: Mapping[str, Any], value: float, low: float, high: float) -> str:
    for unit, size in usual.get("other_units", {}).items():
        if low <= value * size <= high:
            return f'if {_plain(value, 6)} {unit} is meant, give "{_plain(value, 6)} {unit}"'
    return str(usual.get("remedy", "check the number and its unit"))


def _plain(value: float, digits: int = 3) -> str:
    return f"{float(f'{value:.{digits}g}'):g}"
