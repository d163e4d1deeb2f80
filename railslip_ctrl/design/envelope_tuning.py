"""One controller tuned over a whole envelope, and judged over it before it is handed out."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path

from railslip_ctrl.core.arguments import checked
from railslip_ctrl.core.errors import InfeasibleDesignError
from railslip_ctrl.model.adhesion import ReferenceSlip
from railslip_ctrl.model.linearization import LinearPlant
from railslip_ctrl.model.vehicle import Rail

from .controllers import PIController
from .envelope import Envelope, EnvelopePoints
from .judging import Judgement, judge_points
from .specification import Specification
from .tuning_cases import TunedCases, tune_cases

Tuner = Callable[[Sequence[LinearPlant]], TunedCases]


@dataclass(frozen=True)
class EnvelopeDesign(PIController):
    """A tuned controller with its `judgement` over the envelope, and the slip ratios it is to hold.

    `reference` is None where the laws of the envelope have different ones.
    """

    judgement: Judgement | None = None
    reference: ReferenceSlip | None = None

    def __str__(self) -> str:
        lead = f", lead {self.lead:.4g} s / {self.lead_filter:.4g} s" if self.structure == "PI-lead" else ""
        gains = f"{self.structure}: kp {self.gains.kp:.5g} N*m/(m/s), ki {self.gains.ki:.5g} N*m/m{lead}"
        return f"{gains}\n{self.judgement}"

    def save(self, path: str | Path) -> None:
        """Write the TOML file that every command takes with --controller: the controller as it brakes, with its limits.

        InputError where it cannot be written, or the laws of the envelope have different reference slips.
        """
        designed = import_module("railslip_ctrl.simulation.catalogue")  # a room above this one, asked for by the user
        designed.tuned_control(self, name=Path(path).stem).save(path)


@checked
def tune(
    envelope: Envelope,
    structure: str = "pi-lead",
    ms_max: float = 2.0,
    *,
    lead: float | None = None,
    lead_filter: float | None = None,
) -> EnvelopeDesign:
    """The largest integral gain that keeps Ms at every operating point of an envelope, empty and loaded together.

    Parameters
    ----------
    envelope : Envelope
        What the controller must hold.
    structure : str
        "pi"; "pi-lead", with a lead at the actuator's lag; or "pid", whose derivative time is searched.
    ms_max : float
        Largest Ms at the operating points, a ratio, > 1. Tolerances are judged, not tuned for.
    lead, lead_filter : float, optional
        Time constants of the lead, s; left out, the actuator's lag, and a tenth of the lead.

    Returns
    -------
    EnvelopeDesign
        The controller, kp in N*m/(m/s), ki in N*m/m, and its judgement over the envelope, tolerances included.

    Raises
    ------
    InfeasibleDesignError
        No gains keep it; says what is best, and from which speed (km/h) up there are some.
    InputError
        An unknown structure, a number out of its range, or an envelope without points.
    """
    tuned, design = tune_over(envelope, Specification(ms_max), structure, lead=lead, lead_filter=lead_filter)
    if design is None:
        raise InfeasibleDesignError(tuned.reason)
    return design


def tune_over(
    envelope: Envelope,
    specification: Specification,
    structure: str,
    *,
    ki_min: float | None = None,
    lead: float | None = None,
    lead_filter: float | None = None,
    nominal: bool = False,
) -> tuple[TunedCases, EnvelopeDesign | None]:
    """As `tune`, for any specification, judged at the operating points alone if `nominal`; an infeasible one is a
    result, with its reason."""
    points = envelope.points(nominal=nominal)

    def tuned_at(plants: Sequence[LinearPlant]) -> TunedCases:
        return tune_cases(
            plants,
            envelope.vehicle.actuator,
            structure=structure,
            specification=specification,
            ki_min=ki_min,
            lead=lead,
            lead_filter=lead_filter,
        )

    plants = operating_plants(points)
    tuned = tuned_at(plants) if (early := _early(tuned_at, plants)) is None else early
    if tuned.design is None:
        return replace(tuned, reason=f"{tuned.reason}; {_feasible_from(tuned_at, plants)}"), None
    controller = tuned.controller(tuned.design)
    judgement = judge_points(controller, envelope, points, nominal=nominal)
    # the tuner's own margins are of the scalar engine, those of the judgement of the batch
    assert math.isclose(judgement.ms[points.operating].max(), tuned.design.worst.ms, rel_tol=1e-6)
    slips = held_slips(envelope, points)
    return tuned, EnvelopeDesign(controller.gains, controller.lead, controller.lead_filter, judgement, slips)


def _ends(plants: Sequence[LinearPlant], from_kmh: float = 0.0) -> list[LinearPlant]:
    """The plants of the lowest speed from one up, km/h, and of the highest: the hardest, as a rule."""
    speeds = [v for plant in plants if (v := plant.point.speed_kmh) > 0.999 * from_kmh]
    ends = min(speeds), max(speeds)
    return [plant for plant in plants if plant.point.speed_kmh in ends]


def _early(tuned_at: Tuner, plants: Sequence[LinearPlant]) -> TunedCases | None:
    """What is infeasible at the hardest plants alone is so at all: its reason, had in a fraction of the time."""
    hardest = _ends(plants)
    if len(hardest) == len(plants) or (tuned := tuned_at(hardest)).design is not None:
        return None
    speeds = sorted({plant.point.speed_kmh for plant in hardest})
    return replace(tuned, reason=f"at {' and '.join(f'{v:g}' for v in speeds)} km/h alone: {tuned.reason}")


def _feasible_from(tuned_at: Tuner, plants: Sequence[LinearPlant]) -> str:
    """From which speed up it can be met: of fewer plants more can be asked, so that the speeds are halved."""
    speeds = sorted({plant.point.speed_kmh for plant in plants})[1:]
    first = bisect_left(speeds, True, key=lambda speed: tuned_at(_ends(plants, speed)).design is not None)
    for speed in speeds[first:]:
        if tuned_at([plant for plant in plants if plant.point.speed_kmh > 0.999 * speed]).design is not None:
            return f"from {speed:g} km/h up it can"
    return "at no speed of the envelope it can"


def operating_plants(points: EnvelopePoints) -> list[LinearPlant]:
    """The plants of the operating points."""
    return [points.plants[i] for i in points.plant[points.operating]]


def held_slips(envelope: Envelope, points: EnvelopePoints) -> ReferenceSlip | None:
    """The slip ratios held on dry and on wet rail (on one that is not in the envelope: the other's); None where the
    laws have different ones."""
    if envelope.reference is not None:
        return envelope.reference
    held = {rail: {p.point.slip for p in operating_plants(points) if p.point.rail is rail} for rail in Rail}
    if any(len(slips) > 1 for slips in held.values()):
        return None
    (dry,), (wet,) = held[Rail.DRY] or held[Rail.WET], held[Rail.WET] or held[Rail.DRY]
    return ReferenceSlip(dry=dry, wet=wet)
