"""The published adaptive sliding-mode law as a controller."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar, Self

from pydantic import Field

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import KMH, quantity
from railslip_ctrl.core.user_files import file_name, given_path
from railslip_ctrl.model.adhesion import AdhesionLaw, keys_of, law_of, load_law
from railslip_ctrl.model.kernels import prefixed, scalar_source
from railslip_ctrl.model.numeric import adhesion_table, has_table
from railslip_ctrl.model.vehicle import Vehicle
from railslip_ctrl.sliding.generate import generated_law
from railslip_ctrl.sliding.law import CAUTIONS, LawGains, gain_parameters

from .assumed import BEFORE_LOAD, force_of
from .base import Controller, Situation, layout_of, outside
from .translate import ARGUMENTS, PARAMETERS

FILTER_TIME = 0.1  #: s, of the filter that estimates v'; not given by [Park2008], and of little effect
_LEAST_SPEED = 1e-3  # m/s; below it the assumed adhesion is set to 0: at standstill the slip ratio is not defined


@outside
def assumed_force(v: Any, sigma: Any, parameters: Any) -> Any:
    """Return the static force of the assumed adhesion law, N, at a train speed and a slip velocity, m/s."""
    raise NotImplementedError


@outside
def law_step(state: Any, v: Any, omega: Any, Ta: Any, parameters: Any) -> Any:
    """Return the torque of the generated law, N*m, and update `state`."""
    raise NotImplementedError


class Sliding(Controller):
    """Sampled sliding-mode law of [Park2008] (45), derived by `sliding.derivation`.

    The law needs the adhesion torque Ta, which is not measured. The controller computes Ta at the measured slip
    velocity from the static force of `adhesion` or, by default, of the adhesion law of the run. When the rail changes,
    the reference slip changes; if `knows_rail` is True, the assumed adhesion law changes too. InputError: torque_min >=
    torque_max.
    """

    kind: ClassVar[str] = "asmc"
    title: ClassVar[str] = "published adaptive sliding-mode law"
    source: ClassVar[str] = "[Park2008] (45), (49)"
    no_loop: ClassVar[str] = "the law switches with the sign of s, so it is not linear"

    K: float = quantity("N*m", "gain on sgn s", ge=0)
    D: float = quantity("N*m/(m/s)", "gain on s", gt=0)
    rho: float = quantity("1/s", "weight of the integral in s", gt=0)
    k1: float = quantity("s^2/(kg^2*m^4)", "adaptation gain of theta1_hat", ge=0, default=0.0)
    k2: float = quantity("1", "adaptation gain of theta2_hat", ge=0, default=0.0)
    layer: float = quantity("m/s", "boundary layer", ge=0, default=0.0)
    leak: float = quantity("1/s", "sigma-modification", ge=0, default=0.0)
    dead_zone: bool = Field(False, description="whether the estimates stay constant within the boundary layer")
    box: tuple[tuple[float, float], tuple[float, float]] | None = Field(
        None, description="bounds of theta1_hat (1/(kg*m)) and theta2_hat (m/s); none if left out"
    )
    radius: float | None = quantity("m", "assumed wheel radius; the vehicle's if left out", gt=0, default=None)
    wheel_inertia: float | None = quantity("kg*m^2", "assumed wheel inertia J", gt=0, default=None)
    wheel_load: float | None = quantity("N", "assumed wheel load", gt=0, default=None)
    inertia_scale: float | None = quantity("1", "factor on nominal mass and friction", gt=0, default=None)
    nominal_mass: float | None = quantity("kg", "Mn; the vehicle's if left out", gt=0, default=None)
    nominal_viscous_friction: float | None = quantity("N*m*s", "Bn; the vehicle's if left out", ge=0, default=None)
    filter_time: float = quantity("s", "time constant of the filter that estimates v'", gt=0, default=FILTER_TIME)
    torque_min: float | None = quantity("N*m", "smallest torque; none if left out", default=None)
    torque_max: float | None = quantity("N*m", "largest torque; none if left out", default=None)
    anti_windup: bool = Field(False, description="whether the integral in s stops while the torque is limited")
    knows_rail: bool = Field(True, description="whether its adhesion model follows a change of the rail")
    adhesion: AdhesionLaw | None = Field(None, description="assumed adhesion law; that of the run if left out")

    @classmethod
    def from_keys(cls, content: Mapping[str, Any], path: Path, initial_speed: float | None) -> Self:
        """Make the controller from the keys of a file; `adhesion` is a table with a law, or a file name."""
        v0 = None if initial_speed is None else initial_speed / KMH
        if isinstance(given := content.get("adhesion"), str):
            if not given.lower().endswith(".toml"):
                raise InputError(f"adhesion: {given!r} is not a TOML file; give a TOML file with an adhesion law")
            content = {**content, "adhesion": load_law(given_path(path.parent / given), initial_speed_kmh=v0)}
        elif isinstance(given, dict):
            content = {**content, "adhesion": law_of(given, f"{file_name(path)}: adhesion", v0)}
        return super().from_keys(content, path, initial_speed)

    def file_keys(self) -> dict[str, Any]:
        keys = super().file_keys()
        return keys if self.adhesion is None else {**keys, "adhesion": keys_of(self.adhesion)}

    @property
    def gains(self) -> LawGains:
        """Gains of the law as a `LawGains` record, which the verification of the law reads."""
        names = ("K", "D", "rho", "k1", "k2", "layer", "leak", "box", "dead_zone")
        return LawGains(**{name: getattr(self, name) for name in names})

    @property
    def model_law(self) -> AdhesionLaw | None:
        return self.adhesion

    @property
    def model_follows_rail(self) -> bool:
        return self.knows_rail

    def assuming(self, law: AdhesionLaw) -> Self:
        return self if self.adhesion is not None else self.model_copy(update={"adhesion": law})

    @classmethod
    def state_fields(cls) -> dict[str, Any]:
        return dict.fromkeys(generated_law().State.__annotations__, float)

    @classmethod
    def parameter_fields(cls) -> dict[str, Any]:
        names = (name for name in generated_law().Parameters._fields if name != "period")
        return {**dict.fromkeys(names, float), "assumed": tuple[float, ...]}

    @classmethod
    def described_in(cls) -> tuple[type, ...]:
        return generated_law().State, generated_law().Parameters

    @property
    def cautions(self) -> tuple[str, ...]:
        assert self.adhesion is not None, "a C program needs an adhesion law"
        given = f", {self.adhesion.file}" if self.adhesion.file else ""
        return (
            "",
            f"The controller assumes the static force of the adhesion law {self.adhesion.name!r}{given}, on "
            f"{self.adhesion.rail.value} rail.",
            "",
            *CAUTIONS,
        )

    def parameters(self, situation: Situation) -> Mapping[str, Any]:
        assert self.wheel_load is not None, "`believing` sets it"
        assert self.inertia_scale is not None, "`believing` sets it"
        assert self.nominal_mass is not None, "`believing` sets it"
        assert self.nominal_viscous_friction is not None, "`believing` sets it"
        assert self.reference is not None, "checked by `step_parameters`"
        if situation.assumed is None:
            raise InputError(
                f"controller {self.label}: the adhesion law that the controller assumes is missing; give `adhesion`"
            )
        law = generated_law().Parameters
        return {
            **law._field_defaults,
            "J": self.wheel_inertia,
            "r": self.radius,
            "Mn": self.inertia_scale * self.nominal_mass,
            "Bn": self.inertia_scale * self.nominal_viscous_friction,
            "lambda_d": self.reference.on(situation.rail),
            "filter_time": self.filter_time,
            "torque_min": self.least_torque,
            "torque_max": self.largest_torque,
            "anti_windup": self.anti_windup,
            **gain_parameters(self.gains),
            "assumed": (self.wheel_load, *situation.assumed.parameters()),
        }

    def outside_numbers(self, situation: Situation) -> Mapping[str, Any]:
        law = situation.assumed
        if law is None or not has_table(type(law)):
            return {}
        assert self.wheel_load is not None, "`believing` sets it"
        return {"assumed_table": tuple(adhesion_table(law, self.wheel_load).tolist())}

    def gain_values(self) -> dict[str, Any]:
        return {"K_nm": self.K, "D_si": self.D, "rho_per_s": self.rho, "k1_si": self.k1, "k2": self.k2}

    def described(self) -> str:
        knows = "" if self.knows_rail else "; its adhesion model is always that of dry rail"
        model = self.adhesion
        own = "" if model is None else f"; its adhesion model is {model.name!r}, {model.file or 'without file'}"
        return (
            f"{self.label}, K {self.K:g} N·m, D {self.D:g} N·m/(m/s), rho {self.rho:g} 1/s, boundary layer "
            f"{self.layer:g} m/s{self._adaptation}{knows}{own}"
        )

    @property
    def _adaptation(self) -> str:
        if not (self.k1 or self.k2):
            return ", no adaptation"
        box = "" if self.box is None else ", estimates within " + " and ".join(f"{a:g} to {b:g}" for a, b in self.box)
        rests = ", constant in the layer" if self.dead_zone else ""
        return f", k1 {self.k1:g}, k2 {self.k2:g}, leak {self.leak:g} 1/s{box}{rests}"

    def limits_described(self) -> str:
        return (
            f"{super().limits_described()}, anti-windup {'on' if self.anti_windup else 'none'}, filter of v' "
            f"{self.filter_time:g} s, nominal mass {self.nominal_mass:g} kg, nominal friction "
            f"{self.nominal_viscous_friction:g} N·m·s"
        )

    def start(self, speed: float, period: float) -> Any:
        return SimpleNamespace(**{**dict.fromkeys(self.state_fields(), 0.0), **vars(generated_law().start(speed))})

    @staticmethod
    def step(state: Any, measurement: Any, parameters: Any) -> Any:
        """Return the torque of the generated law; the adhesion torque Ta comes from the assumed adhesion law."""
        v, omega, Ta = measurement.train_speed, measurement.wheel_speed, 0.0
        if v > _LEAST_SPEED:
            Ta = parameters.r * assumed_force(v, v - parameters.r * omega, parameters)
        return law_step(state, v, omega, Ta, parameters)

    @classmethod
    def outside_functions(cls, model: type[AdhesionLaw] | None) -> Mapping[str, Any]:
        own = {} if model is None else {"assumed_force": force_of(model)}
        return {"law_step": generated_law().law_step, **own}

    @classmethod
    def outside_text(cls, model: type[AdhesionLaw] | None) -> str:
        return _force_text(cls, model)

    @classmethod
    def for_vehicle(cls, vehicle: Vehicle, **given: Any) -> Self:
        """Return a controller with the fields `given`; the `vehicle` gives the assumed parameters that are left out."""
        return cls(**given).believing(vehicle)


@cache
def _force_text(kind: type[Sliding], model: type[AdhesionLaw] | None) -> str:
    """Return the source text of a compiled `assumed_force` for the law `model`, or if None for the law of the run."""
    own, prefix = ("", "") if model is None else (prefixed(scalar_source(model), "own_"), "own_")
    return f"""{own}
@compiled
def assumed_force({", ".join(ARGUMENTS)}, v, sigma):
    p = _c[int(_c[{layout_of(kind).array_header(PARAMETERS, "assumed")}]) - {BEFORE_LOAD}:]
    z = {prefix}rest_state(v, sigma, 0.0, 0.0, 0.0, 0.0, p, _table)
    return {prefix}force(v, sigma, z, 0.0, 0.0, 0.0, p, _table)

"""
