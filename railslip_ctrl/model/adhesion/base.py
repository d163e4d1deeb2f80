"""What every adhesion law is: a record of parameters in SI, with its equations stated in SymPy on request."""

from __future__ import annotations

import math
import re
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import field
from types import MappingProxyType
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, field_validator

from railslip_ctrl.core.arguments import Floats, number, real, reals
from railslip_ctrl.core.errors import DomainError, InputError, MissingParametersError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH, quantity, to_unit
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH, Rail, Record

INITIAL_SPEED_RANGE_KMH = (30.0, 140.0)
"""Initial braking speeds v0 of the tests behind the published parameters ([Park2008] Table 1, (30)-(32))."""

RIG_WHEEL_LOAD = 34_500.0  #: wheel load, N, at which the published parameters were identified ([Park2008] Table 1)
RANDOM_FORCE = 431.0  #: standard deviation of the random adhesion force at that load, N ([Park2008] p. 55)
RANDOM_SHARE = RANDOM_FORCE / RIG_WHEEL_LOAD  #: the same over the wheel load, with which it grows


class ReferenceSlip(Record):
    """Slip ratio to be held by the controller, by rail condition."""

    dry: float = quantity("1", "reference slip ratio, dry rail", gt=0, lt=1)
    wet: float = quantity("1", "reference slip ratio, wet rail", gt=0, lt=1)

    def on(self, rail: Rail) -> float:
        """The slip ratio on a rail."""
        return self.wet if rail is Rail.WET else self.dry


@dataclass(frozen=True)
class Kink:
    """Where a law has no unique derivative, or no rest state: the `slip` ratio, and the `reason` in words."""

    slip: float
    reason: str


@dataclass(frozen=True)
class Statement:
    """A law in SymPy, in the symbols of `notation` (v, sigma, z, N) and of `AdhesionLaw.symbols`.

    force: Fa, N; has the sign of sigma at rest. state_rate, steady_state: z', m/s, and z at rest as a function of
    sigma, in closed form; None for a static law. functions: numeric counterpart "module:function" of each SymPy
    function the law defines, by class name. sigma_limit: slip velocity, m/s, that |sigma| must stay below; None where
    the equations hold for every sigma. state_limit: largest |z|, m, that slip can build up from no deflection: the
    supremum of |steady_state|, which a state with z' = sigma - |sigma| z/|steady_state| never passes
    ([CanudasDeWit1995]); None for a static law. parts: sub-expressions by name, in order, which generated code computes
    beforehand so that it can be read.
    """

    force: Any
    state_rate: Any = None
    steady_state: Any = None
    functions: Mapping[str, str] = field(default_factory=dict)
    sigma_limit: Any = None
    state_limit: Any = None
    parts: Mapping[str, Any] = field(default_factory=dict)


class AdhesionLaw(Record):
    """Base of the adhesion laws: a subclass in a module of this package is found by itself.

    Its fields made by `units.quantity` are its parameters, SI, in the order in which numeric functions take them.
    sigma > 0 and Fa > 0 in braking. Static laws are odd in sigma; dynamic ones use |sigma| where the source's form
    would diverge for sigma < 0.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    source: ClassVar[str]
    has_state: ClassVar[bool]
    wet_factors: ClassVar[Mapping[str, float]] = MappingProxyType({})
    """Factors that turn the dry parameters into the wet ones."""
    published_sets: ClassVar[Mapping[Rail, Mapping[str, float]]] = MappingProxyType({})
    """Published parameters on dry and on wet rail, for any v0, where they are two sets and not one scaled."""

    rail: Rail = Field(Rail.DRY, description="condition the parameters are for")
    reference: ReferenceSlip | None = Field(None, description="slip ratios to be held, where they are given")
    file: str | None = Field(None, exclude=True, repr=False, description="name of the file it is from, if any")
    of_wheel_load: float | None = Field(
        None, exclude=True, repr=False, description="wheel load, N, that its forces are for, where that is known"
    )

    @field_validator("of_wheel_load", mode="before")
    @classmethod
    def _in_newtons(cls, value: object) -> object:
        """A field with a unit would be a parameter of the law."""
        return None if value is None else to_unit(value, "N", text_needs_unit=True)

    def __eq__(self, other: object) -> bool:
        """Whether it is the same law with the same numbers, from whatever file."""
        if not isinstance(other, AdhesionLaw) or type(self) is not type(other):
            return NotImplemented
        unsaid = {"file": None, "of_wheel_load": None}
        return {**dict(self), **unsaid} == {**dict(other), **unsaid}

    def __hash__(self) -> int:
        return hash((type(self), self.parameters(), self.rail, self.reference))

    @classmethod
    @abstractmethod
    def statement(cls) -> Statement:
        """The law's equations. SymPy is imported inside, so that evaluating numbers does not need it."""

    @classmethod
    def published(cls, rail: Rail, initial_speed_kmh: float, wheel_load: float) -> Self:
        """The published parameters on a `rail`, at v0 = `initial_speed_kmh` (30 to 140 km/h) and a `wheel_load` (N).

        MissingParametersError where the source gives none; InputError for a number outside its range.
        """
        if cls.published_sets:
            check_published_range(INITIAL_SPEED_KMH, wheel_load)  # the load alone: these sets know no v0
            return cls.model_validate({**cls.published_sets[Rail.of(rail)], "rail": rail})
        raise MissingParametersError(
            f"adhesion {cls.name!r}: {cls.source} gives no parameters for it; "
            "give a TOML file with the law and its parameters"
        )

    @classmethod
    def parameter_names(cls) -> tuple[str, ...]:
        """The law's parameters, in order."""
        return tuple(cls.units())

    @classmethod
    def has_forces(cls) -> bool:
        """Whether a parameter is, or has in it, a force or a pressure: then mu at another wheel load is another."""
        return any(re.search(r"\b(N|Pa)\b", unit) for unit in cls.units().values())

    @classmethod
    def argument_names(cls) -> tuple[str, ...]:
        """The names under which generated functions unpack `parameters`; a starred last one takes all that is left."""
        return cls.parameter_names()

    @classmethod
    def symbols(cls) -> tuple[Any, ...]:
        """SymPy symbols of the parameters, in order; positive where the field must be."""
        import sympy as sp

        bounds = ((name, cls.model_fields[name].metadata) for name in cls.parameter_names())
        return tuple(sp.Symbol(name, **{"positive" if _is_positive(one) else "real": True}) for name, one in bounds)

    def numbers(self) -> dict[str, tuple[Any, str]]:
        """Value, SI, and unit of each parameter by name, in order; a column of a table is a tuple of pure numbers."""
        return {name: (getattr(self, name), self.units().get(name, "1")) for name in self.parameter_names()}

    def parameters(self) -> tuple[float, ...]:
        """The parameters' values, SI, in order."""
        return tuple(float(getattr(self, name)) for name in self.parameter_names())

    def wet(self) -> Self:
        """The law on wet rail: the published dry set becomes the wet one, others are multiplied by `wet_factors`."""
        if self.rail is Rail.WET:
            return self
        dry = self.published_sets.get(Rail.DRY, {})
        if dry and all(getattr(self, name) == value for name, value in dry.items()):
            return self.model_copy(update={**self.published_sets[Rail.WET], "rail": Rail.WET})
        update: dict[str, object] = {name: factor * getattr(self, name) for name, factor in self.wet_factors.items()}
        return self.model_copy(update={**update, "rail": Rail.WET})

    def weakened(self, factor: float) -> Self:
        """The law with `factor` (> 0) times its adhesion, by the parameters that `wet_factors` names for one half."""
        number("adhesion factor", factor, gt=0)
        if not self.wet_factors:
            raise InputError(f"adhesion {self.name!r}: nothing says how its parameters change with less adhesion")
        halvings = math.log(factor) / math.log(0.5)
        update = {name: getattr(self, name) * half**halvings for name, half in self.wet_factors.items()}
        return self.model_copy(update=update)

    def on(self, rail: Rail) -> Self:
        """The law on a rail condition. InputError when wet parameters were given and dry ones are asked for."""
        rail = Rail.of(rail)
        if rail is Rail.DRY and self.rail is Rail.WET:
            file = "" if self.file is None else f" of {self.file}"
            raise InputError(
                f"adhesion {self.name!r}{file}: its parameters are for wet rail, and dry ones do not follow from them; "
                "ask for wet rail alone"
            )
        return self.wet() if rail is Rail.WET else self

    def at_wheel_load(self, factor: float) -> Self:
        """The law at `factor` (> 0) times the wheel load with mu as it was: forces grow, stresses and lengths stay.

        This project's assumption for a law known at one wheel load. InputError for a factor not positive and finite.
        """
        number("factor of the wheel load", factor, gt=0)
        forces = {name: -1 if "/N" in unit else 1 for name, unit in self.units().items() if re.search(r"\bN\b", unit)}
        update: dict[str, Any] = {name: getattr(self, name) * factor**power for name, power in forces.items()}
        if self.of_wheel_load is not None:
            update["of_wheel_load"] = factor * self.of_wheel_load
        return self.model_copy(update=update)

    def reference_slip(self, rail: Rail) -> float | None:
        """Reference slip ratio on a rail condition; None where neither source nor user gives one."""
        if self.reference is None:
            return None
        return self.reference.wet if Rail.of(rail) is Rail.WET else self.reference.dry

    def domain_limit(self, v: float) -> tuple[float, str]:
        """Slip ratio the law must stay below at speed v (m/s), and why; infinite where there is none."""
        return math.inf, ""

    def kinks(self, v: float, wheel_load: float) -> tuple[Kink, ...]:
        """Slip ratios at which the law is not differentiable, at a speed `v` (m/s) and a `wheel_load` (N)."""
        return (REST_STATE_UNDEFINED,) if self.has_state else ()

    def check_domain(self, v: float, sigma: ArrayLike) -> None:
        """Raise DomainError unless v > 0 is finite, 0 <= sigma/v <= 1 and the law holds there.

        v in m/s; sigma in m/s, of any shape (the first value outside is named).
        """
        if not (math.isfinite(real("speed", v)) and v > 0.0):
            raise DomainError(f"speed: {v:g} m/s is outside the domain of slip; give a finite speed > 0")
        slip = np.atleast_1d(reals("slip velocity", sigma)) / v
        outside = ~((slip >= 0.0) & (slip <= 1.0))
        if outside.any():
            raise DomainError(f"slip: {slip[outside][0]:g} is outside 0 to 1")
        limit, reason = self.domain_limit(v)
        beyond = slip >= limit
        if beyond.any():
            raise DomainError(
                f"slip: {slip[beyond][0]:g} at {3.6 * v:g} km/h is outside the domain of adhesion {self.name!r}: "
                f"{reason}; stay below slip {limit:.4g}"
            )


REST_STATE_UNDEFINED = Kink(0.0, "without slip every deflection is at rest, so the adhesion state is undefined")
"""Why a dynamic law cannot be linearised at slip 0: z' vanishes with sigma whatever z is."""


def check_published_range(initial_speed_kmh: float, wheel_load: float) -> None:
    """Raise InputError unless the published parameters cover the initial speed (km/h) and the wheel load (N)."""
    low, high = INITIAL_SPEED_RANGE_KMH
    if not low <= real("initial speed", initial_speed_kmh) <= high:
        raise InputError(
            f"initial speed: {initial_speed_kmh:g} km/h is outside {low:g} to {high:g} km/h, "
            "the range of the published adhesion parameters"
        )
    number("wheel load", wheel_load, "N", gt=0)


def _is_positive(metadata: list[Any]) -> bool:
    return any(getattr(constraint, "gt", None) is not None and constraint.gt >= 0 for constraint in metadata)


# --- adhesion available by speed, whatever the slip: an envelope of measurements, not an adhesion law ----------------


def curtius_kniffler(speed: ArrayLike) -> Floats | np.float64:
    """Adhesion coefficient 7.5/(v + 44) + 0.161, v in km/h, for speeds >= 0 in m/s, of any shape.

    E. W. Curtius, A. Kniffler: Neue Erkenntnisse ueber die Haftung zwischen Treibrad und Schiene. Elektrische
    Bahnen 1944.
    """
    v = np.asarray(speed, dtype=float)
    outside = ~(np.isfinite(v) & (v >= 0.0))
    if outside.any():
        raise DomainError(f"speed: {v[outside][0]:g} m/s is outside the curve; give a finite speed >= 0")
    return np.asarray(7.5 / (v / KMH + 44.0) + 0.161, dtype=float)[()]
