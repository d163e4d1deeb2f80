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
    """An adhesion law, the rails to verify on, and the reference slip.

    - law: name of a published law, whose parameters depend on rail, wheel load and initial speed (30 to 140 km/h); the
      stiffness of a dynamic law is multiplied by the inertia scale, like a change of units. Or a law with given
      parameters, which are not changed; `AdhesionLaw.wet` gives those on wet rail.
    - slip: reference slip ratio on every rail, 0 to 1; by default the law's.

    InputError for a value outside its range, no rail, or dry rail with parameters for wet rail.
    """

    law: AdhesionLaw | str = "bristle"
    rails: tuple[Rail, ...] = tuple(Rail)
    slip: float | None = None
    initial_speed_kmh: float = INITIAL_SPEED_KMH

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.rails:
            raise InputError("rail: none is given; give dry, wet or both")
        object.__setattr__(self, "rails", tuple(rail for rail in Rail if rail in self.rails))
        if self.slip is not None:
            number("slip", self.slip, gt=0, lt=1)
        if isinstance(self.law, str):
            object.__setattr__(self, "law", law_class(self.law).name)
        else:
            for rail in self.rails:
                self.law.on(rail)  # raises InputError for dry rail with a wet rail's parameters

    def on(self, rail: Rail, vehicle: Vehicle) -> AdhesionLaw:
        """Adhesion law on a rail under a vehicle's wheel."""
        if isinstance(self.law, AdhesionLaw):
            return self.law.on(rail)
        law = published_law(self.law, rail, self.initial_speed_kmh, vehicle.wheel_load)
        stiffness = getattr(law, "alpha", None)
        if law.has_state and stiffness is not None:
            return law.model_copy(update={"alpha": vehicle.inertia_scale * stiffness})
        return law

    def reference(self, rail: Rail, vehicle: Vehicle) -> float:
        """Reference slip ratio on a rail; InputError if there is none."""
        slip = self.slip if self.slip is not None else self.on(rail, vehicle).reference_slip(rail)
        if slip is None:
            remedy = "`slip` X" if isinstance(self.law, str) else "[reference_slip] in its file, or `slip` X"
            raise InputError(f"slip: adhesion {self.name!r} has no reference slip; give {remedy}")
        return slip

    def point(self, rail: Rail, vehicle: Vehicle) -> OperatingPoint:
        """Operating point at the reference slip on a rail, at 100 km/h."""
        slip, speed = self.reference(rail, vehicle), INITIAL_SPEED_KMH * KMH
        return operating_point(self.on(rail, vehicle), vehicle, speed, slip, rail=rail)

    @property
    def name(self) -> str:
        """Name of the adhesion law."""
        return self.law if isinstance(self.law, str) else self.law.name

    @property
    def text(self) -> str:
        """Description of the law for messages."""
        if isinstance(self.law, AdhesionLaw):
            return f"{self.name} law as given"
        return f"{self.name} model" if self.name == "bristle" else f"published {self.name} law"

    @property
    def rails_text(self) -> str:
        """Description of the rails, as "dry and wet"."""
        return " and ".join(self.rails)


PUBLISHED_ADHESION = RailAdhesion()  #: the published bristle model at its reference slips, on both rails
