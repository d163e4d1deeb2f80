"""Frozen records of physical parameters, SI inside."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import StrEnum
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Self, get_origin

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from railslip_ctrl.errors import InputError
from railslip_ctrl.units import quantity, shown, to_unit

from .docstrings import documented
from .validation import one_line, unknown_key

GRAVITY = 9.80665
"""Standard acceleration of free fall, m/s^2 (exact, CGPM 1901)."""


_MASS_ALONE = "M alone was changed: the wheel load stayed at"


class Rail(StrEnum):
    """Rail condition: which of the two sets of adhesion parameters holds.

    A member is its own name as text: ``Rail.DRY == "dry"``. Where a function takes a `Rail` or its name, another text
    is refused (InputError); `Rail.of` turns either into the member. What a wet rail changes is the adhesion law's to
    say, see `AdhesionLaw.wet`: of those of [Park2008] the largest adhesion is about halved, for which mu_max of the
    beam model (5)-(10) is halved and beta of the bristle model (19)-(24) doubled. The reference slip goes with the rail
    (`ReferenceSlip`).

    Attributes
    ----------
    DRY
        "dry": the parameters as identified ([Park2008] Table 1, (30)-(32)).
    WET
        "wet": those parameters times the law's own factors, or a published set of their own.

    Raises
    ------
    InputError
        By `of`: neither a member nor "dry" or "wet".
    """

    DRY = "dry"
    WET = "wet"

    @classmethod
    def of(cls, value: str) -> Rail:
        """The condition of a name, `value`: "dry" or "wet", or a member itself; InputError for anything else."""
        try:
            return cls(value)
        except ValueError:
            raise InputError(f"rail: {shown(value)} is not a rail condition; choose dry or wet") from None


class Record(BaseModel):
    """Base of the parameter records: immutable, unknown keys refused, non-finite numbers refused.

    Numbers are SI, or text with a unit ("3.5 t"); neither text without one ("3500") nor True is a number, and no
    number is True or False.

    Raises
    ------
    InputError
        An unknown or missing key, a value of another kind or dimension, or out of its range; or a field that is set
        after the record was made.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    text_needs_unit: ClassVar[bool] = True
    """Whether text that is a number alone is refused."""

    def __init__(self, /, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise InputError(one_line(error, type(self).__name__, model=type(self))) from None

    # As pydantic's own: a record within a record is then checked with it, and errors name the whole way to a key.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        cls.__doc__ = documented(cls)

    @classmethod
    def model_validate(cls, obj: Any, **options: Any) -> Self:
        """The record that `obj`, a mapping of its keys, makes; `options` are pydantic's. Errors as of a new record."""
        try:
            return super().model_validate(obj, **options)
        except ValidationError as error:
            raise InputError(one_line(error, cls.__name__, model=cls)) from None

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """The record with the fields in `update` as given, unchecked: also outside its range, to see what follows.

        `deep` copies what it holds. InputError for a name that is no field.
        """
        unknown = (update or {}).keys() - type(self).model_fields.keys()
        if unknown:
            key = min(unknown)
            raise InputError(f"{type(self).__name__}: {key}: {unknown_key(key, type(self))}")
        return super().model_copy(update=update, deep=deep)

    if not TYPE_CHECKING:  # to a type checker the fields are frozen already

        def __setattr__(self, name: str, value: object) -> None:
            raise InputError(
                f"{type(self).__name__}: {name}: cannot be set; make another with model_copy(update={{{name!r}: ...}})"
            )

    @field_validator("*", mode="before")
    @classmethod
    def _to_si(cls, value: object, info: ValidationInfo) -> object:
        """Convert what was given for a field made by `units.quantity` to that field's unit, a list member by member."""
        field = cls.model_fields[info.field_name or ""]
        extra = field.json_schema_extra
        if isinstance(extra, dict) and "unit" in extra:
            # pydantic names the field itself
            convert = partial(to_unit, unit=str(extra["unit"]), text_needs_unit=cls.text_needs_unit)
            return _each(convert, value) if get_origin(field.annotation) is tuple else convert(value)
        if field.annotation is bool and not isinstance(value, bool):  # pydantic takes 1 and "yes"
            raise InputError(f"{shown(value)} is not allowed; give true or false")
        return value


def _each(convert: Callable[[Any], float], value: Any) -> Any:
    """A number, or each of a list of numbers or of lists."""
    return tuple(_each(convert, one) for one in value) if isinstance(value, (list, tuple)) else convert(value)


class Wheel(Record):
    """One braked wheelset ([Park2008] (3), Tables 1 and 2)."""

    radius: float = quantity("m", "wheel radius r", gt=0)
    inertia: float = quantity("kg*m^2", "moment of inertia J", gt=0)
    viscous_friction: float = quantity(
        "N*m*s", "viscous torque coefficient B between brake pad and wheel", ge=0, default=0.0
    )


class Resistance(Record):
    """Travelling resistance of the quarter car, Fr(v) = constant + linear v + quadratic v^2, N, v in m/s.

    [Park2008] Table 1 has the quadratic term alone.
    """

    constant: float = quantity("N", "constant term", ge=0, default=0.0)
    linear: float = quantity("N/(m/s)", "coefficient of v", ge=0, default=0.0)
    quadratic: float = quantity("N/(m/s)^2", "coefficient of v^2", ge=0, default=0.0)


class Actuator(Record):
    """Pneumatic brake, commanded to acting torque: Ga(s) = exp(-dead_time s)/(lag s + 1) ([Park2008] p. 55)."""

    dead_time: float = quantity("s", "dead time", ge=0)
    lag: float = quantity("s", "time constant of the first-order lag", ge=0)


class PIGains(Record):
    """Tb = kp e + ki integral(e), e = sigma_d - sigma in m/s, Tb in N*m ([Park2008] Table 4); of either sign."""

    kp: float = quantity("N*m/(m/s)", "proportional gain")
    ki: float = quantity("N*m/m", "integral gain")


class Vehicle(Record):
    """The quarter car: the part of the train carried and braked by one wheelset ([Park2008] Fig. 2).

    `inertia_scale` multiplies mass, wheel inertia and viscous friction, and nothing else: 1 is SI, 3.6 is the
    as-published reading (speeds integrated in km/h with forces in N). Use `effective_mass`,
    `effective_inertia` and `effective_viscous_friction` in equations of motion. `wheel_load` is a quantity of
    its own: in the published vehicle it does not follow the mass. `PARK2008` is the published one.

    Raises
    ------
    InputError
        As of any `Record`, and a loaded mass below the empty one.
    """

    name: str = Field(description="for reports")
    mass: float = quantity("kg", "quarter-car mass M, empty", gt=0)
    mass_loaded: float = quantity("kg", "quarter-car mass M, loaded", gt=0)
    wheel_load: float = quantity("N", "wheel load N, empty", gt=0)
    wheel_load_loaded: float = quantity("N", "wheel load N, loaded", gt=0)
    wheel: Wheel = Field(description="the braked wheelset")
    resistance: Resistance = Field(description="travelling resistance of the quarter car")
    actuator: Actuator = Field(description="the brake")
    inertia_scale: float = quantity("1", "factor on M, J and B", gt=0, default=1.0)
    source: str = Field("", description="where the numbers are from")
    notes: tuple[str, ...] = Field((), description="one sentence for each thing that was assumed")
    # text, as a record is hashed; no property of the car, so that it is in no dump
    envelope: str = Field("{}", exclude=True, repr=False, description="the table [envelope] of its file, as JSON")

    @model_validator(mode="after")
    def _load_adds(self) -> Vehicle:
        if self.mass_loaded < self.mass:
            raise InputError(
                f"mass_loaded: {self.mass_loaded:g} is not allowed; give a value >= mass = {self.mass:g} (kg)"
            )
        return self

    @property
    def effective_mass(self) -> float:
        """inertia_scale * M, kg."""
        return self.inertia_scale * self.mass

    @property
    def effective_inertia(self) -> float:
        """inertia_scale * J, kg m^2."""
        return self.inertia_scale * self.wheel.inertia

    @property
    def effective_viscous_friction(self) -> float:
        """inertia_scale * B, N m s."""
        return self.inertia_scale * self.wheel.viscous_friction

    def loaded(self) -> Vehicle:
        """The same vehicle with its loaded mass and wheel load as the ones in use."""
        return self.model_copy(update={"mass": self.mass_loaded, "wheel_load": self.wheel_load_loaded})

    def with_mass(self, mass: float) -> Vehicle:
        """The vehicle with another `mass` in use, kg, and the wheel load it has: a note says so, unless the two are
        the empty or the loaded vehicle's own."""
        changed = self.model_copy(update={"mass": mass, "mass_loaded": max(mass, self.mass_loaded)})
        if any((load.mass, load.wheel_load) == (mass, self.wheel_load) for load in self.loads()):
            return changed
        return changed.model_copy(update={"notes": (*self.notes, f"{_MASS_ALONE} {self.wheel_load:.0f} N.")})

    @property
    def mass_alone(self) -> str:
        """The note of `with_mass`; empty where there is none."""
        return next((note for note in self.notes if note.startswith(_MASS_ALONE)), "")

    def loads(self) -> tuple[Vehicle, ...]:
        """The vehicle as it is and, where that is another mass, `loaded`."""
        return (self,) if self.mass == self.mass_loaded else (self, self.loaded())
