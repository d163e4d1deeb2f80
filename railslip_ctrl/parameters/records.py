"""Frozen records of physical parameters, SI inside."""

from __future__ import annotations

from enum import StrEnum

from pydantic import BaseModel, ConfigDict

from ..units import quantity

GRAVITY = 9.80665
"""Standard acceleration of free fall, m/s^2 (exact, CGPM 1901)."""


class Rail(StrEnum):
    """Rail condition."""

    DRY = "dry"
    WET = "wet"


class Record(BaseModel):
    """Base of the parameter records: immutable, unknown keys refused, non-finite numbers refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Wheel(Record):
    """One braked wheelset ([Park2008] (3), Tables 1 and 2)."""

    radius: quantity("m", "wheel radius r", gt=0)
    inertia: quantity("kg*m^2", "moment of inertia J", gt=0)
    viscous_friction: quantity("N*m*s", "viscous torque coefficient B between brake pad and wheel", ge=0) = (
        0.0
    )


class Resistance(Record):
    """Travelling resistance of the quarter car, Fr(v) = constant + linear v + quadratic v^2, N, v in m/s."""

    constant: quantity("N", "constant term", ge=0) = 0.0
    linear: quantity("N/(m/s)", "coefficient of v", ge=0) = 0.0
    quadratic: quantity("N/(m/s)^2", "coefficient of v^2", ge=0) = 0.0


class Actuator(Record):
    """Pneumatic brake, commanded to acting torque: Ga(s) = exp(-dead_time s)/(lag s + 1) ([Park2008] p. 55)."""

    dead_time: quantity("s", "dead time", ge=0)
    lag: quantity("s", "time constant of the first-order lag", ge=0)


class PIGains(Record):
    """Tb = kp e + ki integral(e), e = sigma_d - sigma in m/s, Tb in N*m."""

    kp: quantity("N*m/(m/s)", "proportional gain")
    ki: quantity("N*m/m", "integral gain")


class Vehicle(Record):
    """The quarter car: the part of the train carried and braked by one wheelset ([Park2008] Fig. 2).

    `inertia_scale` multiplies mass, wheel inertia and viscous friction, and nothing else: 1 is SI, 3.6 is the
    as-published reading (speeds integrated in km/h with forces in N). Use `effective_mass`,
    `effective_inertia` and `effective_viscous_friction` in equations of motion. `wheel_load` is a quantity of
    its own: in the published vehicle it does not follow the mass.
    """

    name: str
    mass: quantity("kg", "quarter-car mass M, empty", gt=0)
    mass_loaded: quantity("kg", "quarter-car mass M, loaded", gt=0)
    wheel_load: quantity("N", "wheel load N, empty", gt=0)
    wheel_load_loaded: quantity("N", "wheel load N, loaded", gt=0)
    wheel: Wheel
    resistance: Resistance
    actuator: Actuator
    inertia_scale: quantity("1", "factor on M, J and B", gt=0) = 1.0
    source: str = ""
    notes: tuple[str, ...] = ()

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
