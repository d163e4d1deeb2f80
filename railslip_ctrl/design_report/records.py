"""The records of a design report."""

from __future__ import annotations

from collections.abc import Container, Iterable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import numpy as np

from railslip_ctrl.assessment import Assessment
from railslip_ctrl.design import MarginGrid, Strip
from railslip_ctrl.design.controllers import PIController
from railslip_ctrl.design.effort import Effort
from railslip_ctrl.design.limits import Limits
from railslip_ctrl.design.specification import is_robust
from railslip_ctrl.design_check import ControllerGroup, DesignCheck
from railslip_ctrl.linearization import LinearPlant, OperatingPoint
from railslip_ctrl.loop import Margins
from railslip_ctrl.loop.batch import BatchMargins
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
    def holds(self) -> bool:
        """Whether every loop is stable, and by feedback: zero gain is no design, though its Ms is 1."""
        gains = self.controller.gains
        return self.stable and not gains.kp == gains.ki == 0

    @property
    def robust(self) -> bool:
        """Whether the largest Ms over the operating points is called robust."""
        return is_robust(self.worst_ms)

    @property
    def worst_ms(self) -> float:
        """Largest Ms over the operating points; inf if one is unstable."""
        return max((one.margins.ms if one.margins is not None else float("inf")) for one in self.assessments)


@dataclass(frozen=True)
class RangeLine:
    """One controller's loops on one law, rail and load, linearised at each speed of a range in turn.

    `slip` is the slip ratio held, `mass` kg, `tuned` whether the controller was tuned for this law. `margins` has an
    entry for each speed, NaN where the loop is unstable. `stable_from` and `robust_from`, km/h: the lowest speeds from
    which on up to the highest one the loop is stable, and has Ms <= `ROBUST_MS`; the least of the speeds if it is over
    all of them, inf if it is not at the highest one.
    """

    law: str
    rail: Rail
    mass: float
    slip: float
    tuned: bool
    speeds_kmh: Floats
    margins: BatchMargins
    stable_from: float
    robust_from: float

    @property
    def holds_throughout(self) -> bool:
        """Whether the loop is stable at every speed of the range."""
        return bool(self.stable_from <= self.speeds_kmh[0])

    def at(self, speed_kmh: float) -> int:
        """Index of a speed of the range, the nearest."""
        return int(np.argmin(np.abs(self.speeds_kmh - speed_kmh)))

    def worst_ms(self, low_kmh: float, high_kmh: float) -> float:
        """Largest Ms between two speeds; inf if the loop is unstable at one of them."""
        among = (self.speeds_kmh >= low_kmh) & (self.speeds_kmh <= high_kmh)
        return float(self.margins.ms[among].max()) if self.margins.stable[among].all() else float("inf")


@dataclass(frozen=True)
class SpeedRange:
    """A design over speed, from where nobody controls slip any more, on each law, rail and load.

    `shown_kmh` are the speeds of tables, `skipped` says what has no linear plant, and why.
    """

    name: str
    lines: tuple[RangeLine, ...]
    shown_kmh: tuple[float, ...]
    skipped: tuple[str, ...]

    @property
    def stable_from(self) -> float:
        """Lowest speed, km/h, from which on every loop is stable."""
        return max(line.stable_from for line in self.lines)

    @property
    def robust_from(self) -> float:
        """Lowest speed, km/h, from which on every loop has Ms <= `ROBUST_MS`; inf if one has not at the highest."""
        return max(line.robust_from for line in self.lines)

    @property
    def least_kmh(self) -> float:
        """Least speed looked at, km/h."""
        return float(self.lines[0].speeds_kmh[0])

    @property
    def first_lost(self) -> RangeLine:
        """Where stability ends first as the train slows down."""
        return max(self.lines, key=lambda line: line.stable_from)

    def worst_ms(self, low_kmh: float, high_kmh: float) -> float:
        """Largest Ms over all lines between two speeds."""
        return max(line.worst_ms(low_kmh, high_kmh) for line in self.lines)


@dataclass(frozen=True)
class Attempt:
    """A controller made for one operating point: its margins, or why there are none.

    `controller` is there where it is a PI; a predictor is none.
    """

    name: str
    point: OperatingPoint
    margins: Margins | None
    reason: str
    controller: PIController | None = None


@dataclass(frozen=True)
class Shortfall:
    """Why no design is robust (Ms <= `ROBUST_MS`), and what the brake would have to be.

    `point` is where the least Ms of any linear controller is highest, `limits` what holds there. `longest_dead_time`,
    s: beyond it no linear controller is robust at every operating point, a theorem. `lead_dead_time`, s: up to it the
    PI of least Ms, behind a lead if the brake has a lag, is robust at all of them, found by tuning; 0 if with none.
    `alone`: that PI tuned for each operating point alone, where none holds them together; empty where one does.
    """

    point: OperatingPoint
    limits: Limits
    longest_dead_time: float
    lead_dead_time: float
    alone: tuple[Attempt, ...]


@dataclass(frozen=True)
class LoopDesigns:
    """Designs side by side; responses and gang of four are of the stable ones, at `shown_at`.

    Steps are of 1 km/h in the reference slip velocity and of `load_step` N*m of torque at the wheel. `refused` has
    designs that do not exist, with the reason. `speeds` is of the recommended design; None if none is. `shortfall` is
    there where no design is robust.
    """

    designs: tuple[LoopDesign, ...]
    refused: dict[str, str]
    attempts: tuple[Attempt, ...]
    shown_at: OperatingPoint
    load_step: float
    reference: dict[str, TimeResponse]
    load: dict[str, TimeResponse]
    gangs: dict[str, GangOfFour]
    speeds: SpeedRange | None = None
    shortfall: Shortfall | None = None

    @property
    def best(self) -> LoopDesign | None:
        """The least worst Ms of those that hold every operating point; None if none does."""
        return min((one for one in self.designs if one.holds), key=lambda one: one.worst_ms, default=None)

    @property
    def recommended(self) -> LoopDesign | None:
        """The design to take; None if none holds every operating point.

        Robust ones (worst Ms <= `ROBUST_MS`) before others, then the one tuned over speeds, rails and loads, then any
        before the paper's, which were made for its vehicle, then the least worst Ms. One that needs the rail's holding
        torque is not taken: it is not a controller by itself.
        """

        def rank(one: LoopDesign) -> tuple[bool, bool, bool, float]:
            return not one.robust, not one.over_range, one.origin is Origin.CITED, one.worst_ms

        return min((one for one in self.designs if one.holds and not one.needs_hold), key=rank, default=None)


@dataclass(frozen=True)
class SlidingVerdict:
    """The conditions of the published law and of the layered one; None with the reason where they are not decided.

    `gains` has what each was decided with, by the law's name: symbol, value and unit.
    """

    paper: FullVerification | None
    layered: FullVerification | None
    reasons: dict[str, str]
    gains: dict[str, tuple[tuple[str, float, str], ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class StopRun:
    """One controller in a stop; `run` is None with the reason where there is no such controller.

    `distances`: braking distances, m, with the seeds of the spread, of the runs that stopped; empty if not asked for.
    `drawn`: whether it has a row in the picture, or stands in the table only. `most_locked`: the largest share of time
    with a locked wheel, 0 to 1, and `highest_slip`, the slip ratio, are those of the worst seed; `highest_slip_kmh` is
    the speed, km/h, at that slip. 0, and NaN, without a run. `locking_seeds`: those with which the wheel locks;
    `endless_seeds`: those with which the train does not stop.
    """

    name: str
    run: Run | None
    reason: str
    distances: tuple[float, ...] = ()
    drawn: bool = True
    most_locked: float = 0.0
    highest_slip: float = float("nan")
    highest_slip_kmh: float = float("nan")
    locking_seeds: tuple[int, ...] = ()
    endless_seeds: tuple[int, ...] = ()

    @property
    def locks(self) -> bool:
        """Whether the wheel locks with any of the seeds."""
        return self.most_locked > 0

    @property
    def stops(self) -> bool:
        """Whether there is a run, and the train stops with every seed: only then is a distance one of stopping."""
        return self.run is not None and self.run.stopped and not self.endless_seeds


@dataclass(frozen=True)
class SlowRun:
    """How one run ends, read from every step of it; speeds in km/h, NaN for never.

    `mass`: kg. `seed`: of the noise; None without random force and caliper torque. `highest_slip` and
    `highest_slip_usual`: slip ratios from the upper speed of its `SlowEnd` on down to the least one, and to the usual
    one. `beyond_kmh`: where slip first passes twice the reference; `locked_kmh`: where the wheel first locks.
    """

    mass: float
    seed: int | None
    highest_slip: float
    highest_slip_usual: float
    beyond_kmh: float
    locked_kmh: float

    @property
    def locks(self) -> bool:
        """Whether the wheel locks."""
        return bool(np.isfinite(self.locked_kmh))


@dataclass(frozen=True)
class SlowEnd:
    """The end of a stop of the controller `name`, continued below the speed at which slip control ends.

    Runs from the full speed, empty and loaded, looked at from `from_kmh` down to `least_kmh`, slip ratio `reference`
    held: `controlled` goes on with the controller, each noise seed in turn; `undisturbed` is the same without random
    force and caliper torque; `handed_over` hands over, at `from_kmh`, to a held `torque`, N*m, with the same seeds.
    `usual_kmh` is where a stop usually ends. `friction_needed` is the adhesion coefficient that the held torque takes
    at constant slip, empty; `friction_there` the largest of the law at rest at `from_kmh`.
    """

    name: str
    law: str
    rail: Rail
    reference: float
    from_kmh: float
    usual_kmh: float
    least_kmh: float
    torque: float
    friction_needed: float
    friction_there: float
    controlled: tuple[SlowRun, ...]
    undisturbed: tuple[SlowRun, ...]
    handed_over: tuple[SlowRun, ...]

    @property
    def lost_at(self) -> float:
        """Highest speed, km/h, at which a controlled run passes twice its reference or locks; NaN if none does."""
        return _highest([speed for one in self.controlled for speed in (one.beyond_kmh, one.locked_kmh)])

    @property
    def locks_at(self) -> float:
        """Highest speed, km/h, at which a controlled run locks; NaN if none does."""
        return _highest([one.locked_kmh for one in self.controlled])

    @property
    def held_locks_at(self) -> float:
        """Highest speed, km/h, at which a run with the torque held locks; NaN if none does."""
        return _highest([one.locked_kmh for one in self.handed_over])

    @property
    def torque_there(self) -> float:
        """Torque, N*m, that takes `friction_there`: more than it locks the wheel."""
        return self.torque * self.friction_there / self.friction_needed


def _highest(speeds: list[float]) -> float:
    """The highest of the speeds that are not NaN; NaN if all are."""
    return max((speed for speed in speeds if not np.isnan(speed)), default=float("nan"))


@dataclass(frozen=True)
class Stop:
    """One scenario with every controller, the same noise for all, and what no controller can beat.

    `dynamic` has runs of linear controllers again, with the dynamic adhesion law whose static curve `scenario` has;
    empty where the law of `scenario` is the one asked for. `slow` is how a design's stop ends, law by law.
    """

    title: str
    scenario: Scenario
    seed: int
    runs: tuple[StopRun, ...]
    dynamic: tuple[StopRun, ...]
    bound: ClairvoyantStop | None
    slow: tuple[SlowEnd, ...] = ()

    def run_of(self, name: str) -> Run | None:
        """The run of a controller by the report's name for it; None where there is none."""
        return next((one.run for one in self.runs if one.name == name), None)

    @property
    def shortest(self) -> StopRun | None:
        """The shortest of the stops; None if nothing stopped."""
        return _shortest(one for one in self.runs if one.run is not None)

    @property
    def shortest_unlocked(self) -> StopRun | None:
        """The shortest of those that lock no wheel here, with any seed, though perhaps on another rail (`locks_on`)."""
        return self.shortest_of({one.name for one in self.runs if not one.locks})

    def shortest_of(self, names: Container[str]) -> StopRun | None:
        """The shortest of the stops of some controllers; None if none of them stopped."""
        return _shortest(one for one in self.runs if one.run is not None and one.name in names)

    @property
    def without_dynamic(self) -> tuple[str, ...]:
        """Controllers that were run with the static law alone."""
        again = {one.name for one in self.dynamic}
        return tuple(one.name for one in self.runs if one.run is not None and one.name not in again)


def _shortest(runs: Iterable[StopRun]) -> StopRun | None:
    stopped = [(one.run.braking_distance, i, one) for i, one in enumerate(runs) if one.run and one.stops]
    return min(stopped)[2] if stopped else None


@dataclass(frozen=True)
class LinearPart:
    """What the report says of the linear loops; `limits` are of `plants`, one each.

    `recommended` has the recommended design's loops as a group like those of the check; None if none is.
    """

    check: DesignCheck
    plants: tuple[LinearPlant, ...]
    limits: tuple[Limits, ...]
    curves: tuple[LawCurve, ...]
    region: GainRegion
    loops: LoopDesigns
    recommended: ControllerGroup | None = field(default=None, kw_only=True)

    @property
    def whole_check(self) -> DesignCheck:
        """The check with the recommended design's loops before the others."""
        return (
            self.check
            if self.recommended is None
            else replace(self.check, groups=(self.recommended, *self.check.groups))
        )


@dataclass(frozen=True)
class RunPart:
    """Braking runs, and the paper's numbers: None and empty for a vehicle that is not the published one."""

    stops: tuple[Stop, ...]
    table5: Table5 | None
    facts: tuple[Fact, ...]

    @property
    def one_rail_stops(self) -> tuple[Stop, ...]:
        """The stops on one rail from the start; the published run changes its rail on the way."""
        return tuple(stop for stop in self.stops if not stop.scenario.events)

    def locks_on(self, name: str) -> tuple[Rail, ...]:
        """The rails of `one_rail_stops` on which a controller locks the wheel with any of the seeds."""
        stops = self.one_rail_stops
        return tuple(stop.scenario.rail for stop in stops if any(one.name == name and one.locks for one in stop.runs))

    def endless(self, name: str) -> tuple[str, ...]:
        """Where the train does not stop with a controller, in words: each rail, or that with the dynamic law alone."""
        found = []
        for stop in self.one_rail_stops:
            for runs, law in ((stop.runs, ""), (stop.dynamic, " with the dynamic law")):
                if any(one.name == name and one.run is not None and not one.stops for one in runs):
                    found.append(f"on {stop.scenario.rail} rail{law}")
                    break
        return tuple(found)


@dataclass(frozen=True)
class DesignReport(LinearPart, RunPart):
    """The whole report; `seconds` is what it took, `from_cache` which results an earlier report had kept."""

    sliding: SlidingVerdict
    errata: tuple[Erratum, ...]
    seconds: float
    from_cache: tuple[str, ...] = ()
