"""Adhesion law, rails and reference slips of a verification."""

from __future__ import annotations

from railslip_ctrl.core.arguments import check_fields, number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion import AdhesionLaw, law_class, published_law
from railslip_ctrl.model.linearization import OperatingPoint, operating_point
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH, Rail, Vehicle


@dataclass(frozen=True)
class RailAdhesion:
    """Adhesion law, rails and reference slip for which a sliding-mode law is verified.

    - law: adhesion law with fixed parameters, or the name of a published law. The parameters of a published law depend
      on rail, wheel load and initial speed; the stiffness `alpha` of a law with a state is multiplied by
      `vehicle.inertia_scale`.
    - rails: rail conditions, at least one.
    - slip: reference slip ratio on every rail, 0 to 1; by default that of the adhesion law.
    - initial_speed_kmh: initial speed, 30 to 140 km/h.

    InputError for a value outside its range, no rail, or dry rail with a law for wet rail only.
    """

    law: AdhesionLaw | str = "bristle"
    rails: tuple[Rail, ...] = tuple(Rail)
    slip: float | None = None
    initial_speed_kmh: float = INITIAL_SPEED_KMH

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.rails:
            raise InputError("rail: the list is empty; give dry, wet or both")
        object.__setattr__(self, "rails", tuple(rail for rail in Rail if rail in self.rails))
        if self.slip is not None:
            number("slip", self.slip, gt=0, lt=1)
        if isinstance(self.law, str):
            object.__setattr__(self, "law", law_class(self.law).name)
        else:
            for rail in self.rails:
                self.law.on(rail)  # raises InputError for dry rail if the law is for wet rail only

    def on(self, rail: Rail, vehicle: Vehicle) -> AdhesionLaw:
        """Return the adhesion law for a rail condition and a vehicle's wheel load."""
        if isinstance(self.law, AdhesionLaw):
            return self.law.on(rail)
        law = published_law(self.law, rail, self.initial_speed_kmh, vehicle.wheel_load)
        stiffness = getattr(law, "alpha", None)
        if law.has_state and stiffness is not None:
            return law.model_copy(update={"alpha": vehicle.inertia_scale * stiffness})
        return law

    def reference(self, rail: Rail, vehicle: Vehicle) -> float:
        """Return the reference slip ratio on a rail; InputError if neither `slip` nor the adhesion law gives one."""
        slip = self.slip if self.slip is not None else self.on(rail, vehicle).reference_slip(rail)
        if slip is None:
            remedy = "`slip`" if isinstance(self.law, str) else "`slip`, or [reference_slip] in the law's file"
            raise InputError(f"slip: the adhesion law {self.name!r} has no reference slip; give {remedy}")
        return slip

    def point(self, rail: Rail, vehicle: Vehicle) -> OperatingPoint:
        """Return the operating point on a rail at the reference slip and 100 km/h."""
        slip, speed = self.reference(rail, vehicle), INITIAL_SPEED_KMH * KMH
        return operating_point(self.on(rail, vehicle), vehicle, speed, slip, rail=rail)

    @property
    def name(self) -> str:
        return self.law if isinstance(self.law, str) else self.law.name

    @property
    def text(self) -> str:
        if isinstance(self.law, AdhesionLaw):
            return f"{self.name} law as given"
        return f"{self.name} model" if self.name == "bristle" else f"published {self.name} law"


PUBLISHED_ADHESION = RailAdhesion()  #: the published bristle model at its reference slips, on both rails
