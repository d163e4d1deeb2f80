"""Base class of the adhesion laws: a record of parameters in SI with equations in SymPy."""

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

INITIAL_SPEED_RANGE_KMH = (30.0, 140.0)  #: v0, km/h, of the tests for the published parameters ([Park2008] Table 1)
RIG_WHEEL_LOAD = 34_500.0  #: wheel load, N, at which the published parameters were identified ([Park2008] Table 1)
RANDOM_FORCE = 431.0  #: standard deviation of the random adhesion force at `RIG_WHEEL_LOAD`, N ([Park2008] p. 55)
RANDOM_SHARE = RANDOM_FORCE / RIG_WHEEL_LOAD  #: standard deviation of the random force divided by the wheel load


class ReferenceSlip(Record):
    """Reference slip ratios of a controller for dry and for wet rail."""

    dry: float = quantity("1", "reference slip ratio, dry rail", gt=0, lt=1)
    wet: float = quantity("1", "reference slip ratio, wet rail", gt=0, lt=1)

    def on(self, rail: Rail) -> float:
        """Reference slip ratio for a rail condition."""
        return self.wet if rail is Rail.WET else self.dry


@dataclass(frozen=True)
class Kink:
    """A `slip` ratio at which a law has no unique derivative or no steady state, and the `reason` as text."""

    slip: float
    reason: str


@dataclass(frozen=True)
class Statement:
    """Equations of a law in SymPy, in the symbols of `notation` (v, sigma, z, N) and of `AdhesionLaw.symbols`.

    - force: Fa, N; with the sign of sigma in steady state.
    - state_rate: z', m/s; None for a static law.
    - steady_state: z with z' = 0, m, as a function of sigma; None for a static law.
    - functions: maps the name of each SymPy function class that the law defines to the numeric function, given as
      "module:function".
    - sigma_limit: upper limit of |sigma|, m/s; None if the equations are valid for every sigma.
    - state_limit: upper limit of |z|, m, the supremum of |steady_state| ([CanudasDeWit1995]); None for a static law.
    - parts: sub-expressions by name; generated code computes them first, for readability.
    """

    force: Any
    state_rate: Any = None
    steady_state: Any = None
    functions: Mapping[str, str] = field(default_factory=dict)
    sigma_limit: Any = None
    state_limit: Any = None
    parts: Mapping[str, Any] = field(default_factory=dict)


class AdhesionLaw(Record):
    """Base class of the adhesion laws; sigma and Fa are positive in braking.

    The fields made by `units.quantity` are the parameters of the law, in SI.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    source: ClassVar[str]
    has_state: ClassVar[bool]
    wet_factors: ClassVar[Mapping[str, float]] = MappingProxyType({})
    """Factors, by parameter, that convert dry to wet parameters; they halve the adhesion."""
    published_sets: ClassVar[Mapping[Rail, Mapping[str, float]]] = MappingProxyType({})
    """Published parameters for dry and for wet rail, if they do not depend on v0."""

    rail: Rail = Field(Rail.DRY, description="rail condition of the parameters")
    reference: ReferenceSlip | None = Field(None, description="reference slip ratios, if given")
    file: str | None = Field(None, exclude=True, repr=False, description="name of the law's file, if any")
    of_wheel_load: float | None = Field(None, exclude=True, repr=False, description="wheel load of the law, N")

    @field_validator("of_wheel_load", mode="before")
    @classmethod
    def _in_newtons(cls, value: object) -> object:
        # the field is not made by `units.quantity`, because it would then be a parameter of the law
        return None if value is None else to_unit(value, "N", text_needs_unit=True)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, AdhesionLaw) or type(self) is not type(other):
            return NotImplemented
        ignored = {"file": None, "of_wheel_load": None}
        return {**dict(self), **ignored} == {**dict(other), **ignored}

    def __hash__(self) -> int:
        return hash((type(self), self.parameters(), self.rail, self.reference))

    @classmethod
    @abstractmethod
    def statement(cls) -> Statement:
        """Equations of the law; import SymPy in this method, so that numeric evaluation does not load SymPy."""

    @classmethod
    def published(cls, rail: Rail, initial_speed_kmh: float, wheel_load: float) -> Self:
        """Law with its published parameters for `rail`, `initial_speed_kmh` (30 to 140 km/h) and `wheel_load` (N).

        MissingParametersError: the source gives no parameters. InputError: a number outside its range.
        """
        if cls.published_sets:
            check_published_range(INITIAL_SPEED_KMH, wheel_load)  # only the load: these sets do not depend on v0
            return cls.model_validate({**cls.published_sets[Rail.of(rail)], "rail": rail})
        raise MissingParametersError(f"adhesion {cls.name!r}: {cls.source} gives no parameters; give a TOML file")

    @classmethod
    def parameter_names(cls) -> tuple[str, ...]:
        """Names of the law's parameters, in order."""
        return tuple(cls.units())

    @classmethod
    def has_forces(cls) -> bool:
        """True if a parameter's unit contains a force or a pressure; mu then depends on the wheel load."""
        return any(re.search(r"\b(N|Pa)\b", unit) for unit in cls.units().values())

    @classmethod
    def argument_names(cls) -> tuple[str, ...]:
        """Names of the parameters in generated functions; a last name "*table" takes all remaining values."""
        return cls.parameter_names()

    @classmethod
    def symbols(cls) -> tuple[Any, ...]:
        """SymPy symbols of the parameters, in order; positive if the field must be positive."""
        import sympy as sp

        bounds = ((name, cls.model_fields[name].metadata) for name in cls.parameter_names())
        return tuple(sp.Symbol(name, **{"positive" if _is_positive(one) else "real": True}) for name, one in bounds)

    def numbers(self) -> dict[str, tuple[Any, str]]:
        """Value (SI) and unit of each parameter by name, in order; the values of a lookup table are tuples."""
        return {name: (getattr(self, name), self.units().get(name, "1")) for name in self.parameter_names()}

    def parameters(self) -> tuple[float, ...]:
        """Values of the parameters, SI, in order."""
        return tuple(float(getattr(self, name)) for name in self.parameter_names())

    def wet(self) -> Self:
        """Law for wet rail: the published one if this law has the published dry parameters, else by `wet_factors`."""
        if self.rail is Rail.WET:
            return self
        dry = self.published_sets.get(Rail.DRY, {})
        if dry and all(getattr(self, name) == value for name, value in dry.items()):
            return self.model_copy(update={**self.published_sets[Rail.WET], "rail": Rail.WET})
        update: dict[str, object] = {name: factor * getattr(self, name) for name, factor in self.wet_factors.items()}
        return self.model_copy(update={**update, "rail": Rail.WET})

    def weakened(self, factor: float) -> Self:
        """Law with the adhesion multiplied by `factor`, > 0: powers of the `wet_factors` multiply the parameters."""
        number("adhesion factor", factor, gt=0)
        if not self.wet_factors:
            raise InputError(
                f"adhesion {self.name!r}: an adhesion factor of {factor:g} needs wet_factors; define this attribute"
            )
        halvings = math.log(factor) / math.log(0.5)
        update = {name: getattr(self, name) * half**halvings for name, half in self.wet_factors.items()}
        return self.model_copy(update=update)

    def on(self, rail: Rail) -> Self:
        """Law for a rail condition; InputError for dry rail if the parameters are for wet rail."""
        rail = Rail.of(rail)
        if rail is Rail.DRY and self.rail is Rail.WET:
            file = "" if self.file is None else f" of {self.file}"
            raise InputError(
                f"adhesion {self.name!r}{file}: its parameters are for wet rail and do not determine those for dry "
                "rail; choose wet rail, or give a law with parameters for dry rail"
            )
        return self.wet() if rail is Rail.WET else self

    def at_wheel_load(self, factor: float) -> Self:
        """Law for `factor` (> 0) times the wheel load, on the assumption that mu does not change with the load."""
        number("factor of the wheel load", factor, gt=0)
        forces = {name: -1 if "/N" in unit else 1 for name, unit in self.units().items() if re.search(r"\bN\b", unit)}
        update: dict[str, Any] = {name: getattr(self, name) * factor**power for name, power in forces.items()}
        if self.of_wheel_load is not None:
            update["of_wheel_load"] = factor * self.of_wheel_load
        return self.model_copy(update=update)

    def reference_slip(self, rail: Rail) -> float | None:
        """Reference slip ratio for a rail condition; None if it is not given."""
        if self.reference is None:
            return None
        return self.reference.wet if Rail.of(rail) is Rail.WET else self.reference.dry

    def domain_limit(self, v: float) -> tuple[float, str]:
        """Upper limit of the slip ratio at speed `v`, m/s, or infinity, and the reason for the limit as text."""
        return math.inf, ""

    def kinks(self, v: float, wheel_load: float) -> tuple[Kink, ...]:
        """Slip ratios at which the law is not differentiable, for a speed `v` (m/s) and a `wheel_load` (N)."""
        return (REST_STATE_UNDEFINED,) if self.has_state else ()

    def check_domain(self, v: float, sigma: ArrayLike) -> None:
        """Raise DomainError for a speed v, m/s, or a slip velocity sigma, m/s, any shape, outside the law's domain."""
        if not (math.isfinite(real("speed", v)) and v > 0.0):
            raise DomainError(f"speed: {v:g} m/s is not allowed; give a finite speed > 0, for which slip is defined")
        slip = np.atleast_1d(reals("slip velocity", sigma)) / v
        outside = ~((slip >= 0.0) & (slip <= 1.0))
        if outside.any():
            raise DomainError(f"slip: {slip[outside][0]:g} is not allowed; give 0 <= slip <= 1")
        limit, reason = self.domain_limit(v)
        beyond = slip >= limit
        if beyond.any():
            raise DomainError(
                f"slip: {slip[beyond][0]:g} at {3.6 * v:g} km/h is outside the domain of adhesion {self.name!r}: "
                f"{reason}; stay below slip {limit:.4g}"
            )


REST_STATE_UNDEFINED = Kink(0.0, "without slip every deflection is steady, so the adhesion state is undefined")


def check_published_range(initial_speed_kmh: float, wheel_load: float) -> None:
    """Raise InputError unless the published parameters cover the initial speed (km/h) and the wheel load (N)."""
    low, high = INITIAL_SPEED_RANGE_KMH
    if not low <= real("initial speed", initial_speed_kmh) <= high:
        raise InputError(
            f"initial speed: {initial_speed_kmh:g} km/h is outside {low:g} to {high:g} km/h, "
            "the range of the published adhesion parameters; give a speed in this range"
        )
    number("wheel load", wheel_load, "N", gt=0)


def _is_positive(metadata: list[Any]) -> bool:
    return any(getattr(constraint, "gt", None) is not None and constraint.gt >= 0 for constraint in metadata)


def curtius_kniffler(speed: ArrayLike) -> Floats | np.float64:
    """Adhesion coefficient 7.5/(v + 44) + 0.161, v in km/h, an envelope of measurements by Curtius and Kniffler.

    - speed: m/s, >= 0, any shape; DomainError otherwise.

    E. W. Curtius, A. Kniffler: Neue Erkenntnisse ueber die Haftung zwischen Treibrad und Schiene. Elektrische
    Bahnen 1944.
    """
    v = np.asarray(speed, dtype=float)
    outside = ~(np.isfinite(v) & (v >= 0.0))
    if outside.any():
        raise DomainError(f"speed: {v[outside][0]:g} m/s is not allowed; give a finite speed >= 0")
    return np.asarray(7.5 / (v / KMH + 44.0) + 0.161, dtype=float)[()]
