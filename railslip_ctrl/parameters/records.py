"""Frozen records of physical parameters, SI inside."""

from __future__ import annotations

from enum import StrEnum

from pydantic import BaseModel, ConfigDict, ValidationInfo, field_validator, model_validator

from railslip_ctrl.errors import InputError
from railslip_ctrl.units import quantity, to_unit

GRAVITY = 9.80665
"""Standard acceleration of free fall, m/s^2 (exact, CGPM 1901)."""


class Rail(StrEnum):
    """Rail condition: which of the two sets of adhesion parameters holds."""

    DRY = "dry"
    WET = "wet"

    @classmethod
    def of(cls, value: str) -> Rail:
        """The condition of a name, `value`: "dry" or "wet", or a member itself; InputError for anything else."""
        try:
            return cls(value)
        except ValueError:
            raise InputError(f"rail: {value!r} is not a rail condition; choose dry or wet") from None


class Record(BaseModel):
    """Base of the parameter records: immutable, unknown keys refused, non-finite numbers refused.

    Numbers are SI, or text with a unit ("3.5 t").

    Raises
    ------
    pydantic.ValidationError
        A value of another dimension or out of its range; it is a ValueError. What reads a record from a file raises
        InputError in its place.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _to_si(cls, value: object, info: ValidationInfo) -> object:
        """Convert what was given for a field made by `units.quantity` to that field's unit."""
        extra = cls.model_fields[info.field_name or ""].json_schema_extra
        if isinstance(extra, dict) and "unit" in extra:
            return to_unit(value, str(extra["unit"]))  # pydantic names the field itself
        return value


class Wheel(Record):
    """One braked wheelset ([Park2008] (3), Tables 1 and 2)."""

    radius: float = quantity("m", "wheel radius r", gt=0)
    inertia: float = quantity("kg*m^2", "moment of inertia J", gt=0)
    viscous_friction: float = quantity(
        "N*m*s", "viscous torque coefficient B between brake pad and wheel", ge=0, default=0.0
    )


class Resistance(Record):
    """Travelling resistance of the quarter car, Fr(v) = constant + linear v + quadratic v^2, N, v in m/s."""

    constant: float = quantity("N", "constant term", ge=0, default=0.0)
    linear: float = quantity("N/(m/s)", "coefficient of v", ge=0, default=0.0)
    quadratic: float = quantity("N/(m/s)^2", "coefficient of v^2", ge=0, default=0.0)


class Actuator(Record):
    """Pneumatic brake, commanded to acting torque: Ga(s) = exp(-dead_time s)/(lag s + 1) ([Park2008] p. 55)."""

    dead_time: float = quantity("s", "dead time", ge=0)
    lag: float = quantity("s", "time constant of the first-order lag", ge=0)


class PIGains(Record):
    """Tb = kp e + ki integral(e), e = sigma_d - sigma in m/s, Tb in N*m."""

    kp: float = quantity("N*m/(m/s)", "proportional gain")
    ki: float = quantity("N*m/m", "integral gain")


class Vehicle(Record):
    """The quarter car: the part of the train carried and braked by one wheelset ([Park2008] Fig. 2).

    `inertia_scale` multiplies mass, wheel inertia and viscous friction, and nothing else: 1 is SI, 3.6 is the
    as-published reading (speeds integrated in km/h with forces in N). Use `effective_mass`,
    `effective_inertia` and `effective_viscous_friction` in equations of motion. `wheel_load` is a quantity of
    its own: in the published vehicle it does not follow the mass.

    Attributes
    ----------
    name : str
        For reports.
    wheel : Wheel
        The braked wheelset.
    resistance : Resistance
        Travelling resistance of the quarter car.
    actuator : Actuator
        The brake.
    source : str
        Where the numbers are from.
    notes : tuple of str
        One sentence for each thing that was assumed.
    """

    name: str
    mass: float = quantity("kg", "quarter-car mass M, empty", gt=0)
    mass_loaded: float = quantity("kg", "quarter-car mass M, loaded", gt=0)
    wheel_load: float = quantity("N", "wheel load N, empty", gt=0)
    wheel_load_loaded: float = quantity("N", "wheel load N, loaded", gt=0)
    wheel: Wheel
    resistance: Resistance
    actuator: Actuator
    inertia_scale: float = quantity("1", "factor on M, J and B", gt=0, default=1.0)
    source: str = ""
    notes: tuple[str, ...] = ()

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
