"""The records of a design report."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import numpy as np

from railslip_ctrl.assessment import ROBUST_MS, Assessment
from railslip_ctrl.design import MarginGrid, Strip
from railslip_ctrl.design.controllers import PIController
from railslip_ctrl.design.effort import Effort
from railslip_ctrl.design.limits import Limits
from railslip_ctrl.design_check import DesignCheck
from railslip_ctrl.linearization import LinearPlant, OperatingPoint
from railslip_ctrl.loop import Margins
from railslip_ctrl.loop.curves import GangOfFour
from railslip_ctrl.loop.responses import TimeResponse
from railslip_ctrl.numeric import Peak
from railslip_ctrl.parameters import Rail
from railslip_ctrl.reproduction import Fact, Table5
from railslip_ctrl.simulation import Run, Scenario
from railslip_ctrl.simulation.clairvoyant import ClairvoyantStop
from railslip_ctrl.sliding.erratum import Erratum
from railslip_ctrl.sliding_verification import FullVerification

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


@dataclass(frozen=True)
class LawCurve:
    """mu over the slip ratio at one speed (km/h) on one rail, with its peak; `points` are the operating points on it.

    `asked` is False for a law drawn only beside the one the report is about. `parameters` are the law's, SI, by name.
    """

    law: str
    title: str
    parameters: dict[str, Any]
    rail: Rail
    speed_kmh: float
    slip: Floats
    coefficient: Floats
    peak: Peak
    points: tuple[OperatingPoint, ...]
    asked: bool


@dataclass(frozen=True)
class GainRegion:
    """The (kp, ki) of a plain PI that stabilise every operating point, margins in it, and gains to mark by name.

    `reason` says why there is nothing to draw; else it is empty.
    """

    kp_range: tuple[float, float] | None
    strips: tuple[Strip, ...]
    grid: MarginGrid | None
    chosen: dict[str, tuple[float, float]]
    reason: str

    def near(self, gains: tuple[float, float]) -> bool:
        """Whether (kp, ki) lies in the rectangle around the region, a fifth wider, which is what a picture can show."""
        if not self.strips:
            return False
        outline = np.concatenate([strip.polygon for strip in self.strips])
        low, high = outline.min(axis=0), outline.max(axis=0)
        room = 0.2 * (high - low)
        return bool(np.all((low - room <= gains) & (gains <= high + room)))


class Origin(StrEnum):
    """Where a design's gains come from."""

    CITED = "cited"
    GIVEN = "given"
    COMPUTED = "computed"
    KEPT = "kept"


@dataclass(frozen=True)
class LoopDesign:
    """One controller at every operating point; `efforts` is None where its loop is unstable.

    `origin`: cited from the paper, given by the user, computed for this report, or kept with the package, which is
    where they were rounded after tuning. `over_range`: tuned over speeds, rails and loads, not for these points alone.
    `needs_hold`: works about the holding torque of a rail that has to be known.
    """

    name: str
    how: str
    origin: Origin
    over_range: bool
    needs_hold: bool
    controller: PIController
    assessments: tuple[Assessment, ...]
    efforts: tuple[Effort | None, ...]

    @property
    def stable(self) -> bool:
        """Whether every loop is."""
        return all(one.stable for one in self.assessments)

    @property
    def worst_ms(self) -> float:
        """Largest Ms over the operating points; inf if one is unstable."""
        return max((one.margins.ms if one.margins is not None else float("inf")) for one in self.assessments)


@dataclass(frozen=True)
class Attempt:
    """A known rule or a predictor made for one operating point: its margins, or why there are none."""

    name: str
    point: OperatingPoint
    margins: Margins | None
    reason: str


@dataclass(frozen=True)
class LoopDesigns:
    """Designs side by side; responses and gang of four are of the stable ones, at `shown_at`.

    Steps are of 1 km/h in the reference slip velocity and of `load_step` N*m of torque at the wheel. `refused` has
    designs that do not exist, with the reason.
    """

    designs: tuple[LoopDesign, ...]
    refused: dict[str, str]
    attempts: tuple[Attempt, ...]
    shown_at: OperatingPoint
    load_step: float
    reference: dict[str, TimeResponse]
    load: dict[str, TimeResponse]
    gangs: dict[str, GangOfFour]

    @property
    def best(self) -> LoopDesign | None:
        """The least worst Ms of those that hold every operating point; None if none does."""
        return min((one for one in self.designs if one.stable), key=lambda one: one.worst_ms, default=None)

    @property
    def recommended(self) -> LoopDesign | None:
        """The design to take; None if none holds every operating point.

        Robust ones (worst Ms <= `ROBUST_MS`) before others, then the one tuned over speeds, rails and loads, then the
        least worst Ms. One that needs the rail's holding torque is not taken: it is not a controller by itself.
        """
        stable = [one for one in self.designs if one.stable and not one.needs_hold]
        return min(stable, key=lambda one: (one.worst_ms > ROBUST_MS, not one.over_range, one.worst_ms), default=None)


@dataclass(frozen=True)
class SlidingVerdict:
    """The conditions of the published law and of the layered one; None with the reason where they are not decided."""

    paper: FullVerification | None
    layered: FullVerification | None
    reasons: dict[str, str]


@dataclass(frozen=True)
class StopRun:
    """One controller in a stop; `run` is None with the reason where there is no such controller."""

    name: str
    run: Run | None
    reason: str


@dataclass(frozen=True)
class Stop:
    """One scenario with every controller, the same noise for all, and what no controller can beat.

    `dynamic` has runs of linear controllers again, with the dynamic adhesion law whose static curve `scenario` has;
    empty where the law of `scenario` is the one asked for.
    """

    title: str
    scenario: Scenario
    seed: int
    runs: tuple[StopRun, ...]
    dynamic: tuple[StopRun, ...]
    bound: ClairvoyantStop | None

    def run_of(self, name: str) -> Run | None:
        """The run of a controller by the report's name for it; None where there is none."""
        return next((one.run for one in self.runs if one.name == name), None)

    @property
    def shortest(self) -> Run | None:
        """The shortest of the stops; None if nothing stopped."""
        stopped = [one.run for one in self.runs if one.run is not None and one.run.stopped]
        return min(stopped, key=lambda run: run.braking_distance, default=None)


@dataclass(frozen=True)
class LinearPart:
    """What the report says of the linear loops; `limits` are of `plants`, one each."""

    check: DesignCheck
    plants: tuple[LinearPlant, ...]
    limits: tuple[Limits, ...]
    curves: tuple[LawCurve, ...]
    region: GainRegion
    loops: LoopDesigns


@dataclass(frozen=True)
class RunPart:
    """Braking runs, and the paper's numbers: None and empty for a vehicle that is not the published one."""

    stops: tuple[Stop, ...]
    table5: Table5 | None
    facts: tuple[Fact, ...]


@dataclass(frozen=True)
class DesignReport(LinearPart, RunPart):
    """The whole report; `seconds` is what it took."""

    sliding: SlidingVerdict
    errata: tuple[Erratum, ...]
    seconds: float
