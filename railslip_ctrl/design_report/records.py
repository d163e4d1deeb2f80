"""The records of a design report."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import numpy as np

from railslip_ctrl.assessment import ROBUST_MS, Assessment
from railslip_ctrl.design import MarginGrid, Strip
from railslip_ctrl.design.controllers import PIController
from railslip_ctrl.design.effort import Effort
from railslip_ctrl.design.limits import Limits
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
from railslip_ctrl.simulation.run import Signals
from railslip_ctrl.sliding.erratum import Erratum
from railslip_ctrl.sliding_verification import FullVerification
from railslip_ctrl.units import KMH

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
    """A known rule or a predictor made for one operating point: its margins, or why there are none."""

    name: str
    point: OperatingPoint
    margins: Margins | None
    reason: str


@dataclass(frozen=True)
class LoopDesigns:
    """Designs side by side; responses and gang of four are of the stable ones, at `shown_at`.

    Steps are of 1 km/h in the reference slip velocity and of `load_step` N*m of torque at the wheel. `refused` has
    designs that do not exist, with the reason. `speeds` is of the recommended design; None if none is.
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
    with a locked wheel, 0 to 1, over the seeds.
    """

    name: str
    run: Run | None
    reason: str
    distances: tuple[float, ...] = ()
    drawn: bool = True
    most_locked: float = 0.0

    @property
    def locks(self) -> bool:
        """Whether the wheel locks with any of the seeds."""
        return self.most_locked > 0

    @property
    def speed_of_highest_slip(self) -> float:
        """Speed, km/h, at which the slip of the recorded run is highest; NaN without one."""
        if self.run is None or self.run.signals is None:
            return float("nan")
        return float(self.run.signals.speed[int(np.argmax(self.run.signals.slip))] / KMH)


@dataclass(frozen=True)
class SlowEnd:
    """The end of a stop of the controller `name`, continued below the speed at which slip control ends.

    `controlled` goes on with the controller, from the full speed down to `least_kmh`; `cut_out` is the torque `torque`,
    N*m, held from `from_kmh` down, free rolling at first. `reference` is the slip ratio the controller holds.
    """

    name: str
    law: str
    rail: Rail
    reference: float
    from_kmh: float
    least_kmh: float
    torque: float
    controlled: Run
    cut_out: Run

    def highest_slip(self, below_kmh: float) -> float:
        """Highest slip ratio of the controlled run below a speed; NaN if it does not come there."""
        signals = _signals(self.controlled)
        slow = signals.speed < below_kmh * KMH
        return float(signals.slip[slow].max()) if slow.any() else float("nan")

    def highest_slip_cut_out(self, above_kmh: float) -> float:
        """Highest slip ratio of the run with the torque held, down to a speed."""
        if above_kmh <= self.least_kmh:
            return self.cut_out.max_slip  # of every step, of which the signals have some
        signals = _signals(self.cut_out)
        return float(signals.slip[signals.speed >= above_kmh * KMH].max())

    def first_beyond(self, slip: float, below_kmh: float) -> float:
        """Speed, km/h, at which the slip ratio of the controlled run first passes `slip` below a speed; NaN: never."""
        signals = _signals(self.controlled)
        beyond = np.flatnonzero((signals.speed < below_kmh * KMH) & (signals.slip > slip))
        return float(signals.speed[beyond[0]] / KMH) if beyond.size else float("nan")

    @property
    def locks_at(self) -> float:
        """Speed, km/h, at which the wheel of the controlled run is first locked below `from_kmh`; NaN if never."""
        signals = _signals(self.controlled)
        locked = np.flatnonzero((signals.speed < self.from_kmh * KMH) & (signals.locked > 0))
        return float(signals.speed[locked[0]] / KMH) if locked.size else float("nan")


def _signals(run: Run) -> Signals:
    assert run.signals is not None, "the runs of a report are recorded"
    return run.signals


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
        """The shortest of the stops without a locked wheel with any seed; None if there is none."""
        return _shortest(one for one in self.runs if one.run is not None and not one.locks)

    @property
    def without_dynamic(self) -> tuple[str, ...]:
        """Controllers that were run with the static law alone."""
        again = {one.name for one in self.dynamic}
        return tuple(one.name for one in self.runs if one.run is not None and one.name not in again)


def _shortest(runs: Iterable[StopRun]) -> StopRun | None:
    stopped = [(one.run.braking_distance, i, one) for i, one in enumerate(runs) if one.run and one.run.stopped]
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


@dataclass(frozen=True)
class DesignReport(LinearPart, RunPart):
    """The whole report; `seconds` is what it took, `from_cache` which results an earlier report had kept."""

    sliding: SlidingVerdict
    errata: tuple[Erratum, ...]
    seconds: float
    from_cache: tuple[str, ...] = ()
