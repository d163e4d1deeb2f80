"""The records of a design report."""

from __future__ import annotations

import datetime
import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from railslip_ctrl.design.envelope import Envelope
from railslip_ctrl.design.judging import Judgement
from railslip_ctrl.design.limits import Limits
from railslip_ctrl.design.selection import Choice, Selection
from railslip_ctrl.loop.curves import FrequencyCurve
from railslip_ctrl.loop.responses import TimeResponse
from railslip_ctrl.model.linearization import OperatingPoint
from railslip_ctrl.model.numeric import Peak
from railslip_ctrl.model.vehicle import Rail, Vehicle
from railslip_ctrl.simulation import LinearControl, Run
from railslip_ctrl.simulation.bound import ClairvoyantStop
from railslip_ctrl.verification.joint_verification import FullVerification

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

_REACHED = 0.95  # of the reference slip: as good as there
_SLIDING = 0.5


@dataclass(frozen=True)
class LawCurve:
    """mu over the slip ratio of one law on one rail at one speed (km/h), with its peak and the operating point."""

    law: str
    rail: Rail
    speed_kmh: float
    slip: Floats
    coefficient: Floats
    peak: Peak
    point: OperatingPoint


@dataclass(frozen=True)
class ShownLoop:
    """A loop to be drawn: where it is, the loop, its margins (None: unstable), its frequency response."""

    label: str
    loop: Any
    margins: Any
    curve: FrequencyCurve


@dataclass(frozen=True)
class Stop:
    """One controller in one stop.

    Attributes
    ----------
    controller, law, load : str
        What runs, the adhesion law's name, "empty" or "loaded".
    rail : Rail
    run : Run
        Of seed 0, recorded.
    others : tuple of Run
        Of the other seeds.
    bound : ClairvoyantStop or None
        What no controller of this brake beats; None where none is known.
    held : float
        Median of slip over the second half of `run`: what is held, without the noise and the start.
    reference : float
        The slip ratio to be held.
    """

    controller: str
    law: str
    rail: Rail
    load: str
    run: Run
    others: tuple[Run, ...]
    bound: ClairvoyantStop | None
    held: float
    reference: float

    @property
    def runs(self) -> tuple[Run, ...]:
        """Of all seeds."""
        return (self.run, *self.others)

    @property
    def reached(self) -> bool:
        """Whether the slip comes to 0.95 of the reference."""
        return self.held >= _REACHED * self.reference

    @property
    def max_slip(self) -> float:
        """Highest slip ratio with any seed."""
        return max(run.max_slip for run in self.runs)

    @property
    def slides(self) -> bool:
        """Whether the slip passes one half, halfway to a locked wheel, with some seed."""
        return self.max_slip > _SLIDING

    @property
    def locks(self) -> bool:
        """Whether the wheel locks with some seed."""
        return any(run.locked_fraction > 0 for run in self.runs)

    @property
    def over_bound(self) -> float:
        """Braking distance of `run` over the bound, less 1; NaN without either."""
        if self.bound is None or not self.run.stopped or math.isinf(self.bound.braking_distance):
            return math.nan
        return self.run.braking_distance / self.bound.braking_distance - 1


@dataclass(frozen=True)
class Trial:
    """A choice in its own stops.

    `above_kmh` is the speed, km/h, above which it may be used: robust from there up, and handed over below it, no wheel
    slides in its stops; None if from none. `lowest_kmh` is the lowest speed that is judged.
    """

    choice: Choice
    above_kmh: float | None
    lowest_kmh: float
    control: LinearControl
    stops: tuple[Stop, ...]

    def distance(self, rail: Rail | None = None) -> float:
        """Mean braking distance of its stops on a rail, or on all, m; inf where one does not stop."""
        runs = [stop.run for stop in self.stops if rail is None or stop.rail is rail]
        return sum(run.braking_distance if run.stopped else math.inf for run in runs) / len(runs)

    @property
    def rank(self) -> tuple[bool, float, float]:
        """Smaller is better: used from the lowest speed, then the shortest stops."""
        return self.above_kmh is None, self.above_kmh or 0.0, self.distance()


@dataclass(frozen=True)
class GainMap:
    """Worst Ms at operating points over kp (m,) and ki (n,) behind the design's lead, (m, n); inf: unstable."""

    kp: Floats
    ki: Floats
    ms: Floats
    chosen: tuple[float, float]
    points: int


@dataclass(frozen=True)
class Responses:
    """Of the recommended design at a point, to a step of the reference slip velocity, and of torque at the wheel."""

    point: OperatingPoint
    reference_step: float
    load_step: float
    reference: TimeResponse
    load: TimeResponse


@dataclass(frozen=True)
class Sliding:
    """The conditions of the layered sliding-mode law; None with the reason."""

    found: FullVerification | None
    reason: str = ""


@dataclass(frozen=True)
class FasterBrake:
    """A brake with dead time and lag `factor` times as long with which the same kind of design is robust throughout."""

    factor: float
    dead_time: float
    lag: float


@dataclass(frozen=True)
class Rival:
    """A controller of the user's, judged and run beside the recommended one."""

    name: str
    controller: Any
    judgement: Judgement
    stops: tuple[Stop, ...]


@dataclass(frozen=True)
class DesignReport:
    """All that a report on a vehicle shows.

    Attributes
    ----------
    envelope : Envelope
        What the design must hold, and its vehicle.
    nominal : bool
        Whether operating points alone are judged.
    selection : Selection
        The candidates, the best first.
    trials : tuple of Trial
        The choices that are robust from the lowest speed that any is, in their stops, the best first; of none robust,
        the best alone.
    control : LinearControl or None
        The recommended design as it runs: what `recommended.toml` says; None if no design holds the loops.
    above_kmh : float or None
        The speed, km/h, above which it may be used: robust from there up, and handed over below it, no wheel slides
        in its own stops; None if nowhere.
    in_use : Judgement or None
        Its judgement over the speeds from `above_kmh` up (if None: all at which it is stable, or all).
    worst_loops : tuple of ShownLoop
        Its loops at the worst operating point, and at the worst with tolerances.
    stops : tuple of Stop
        Of the recommended design.
    rivals : tuple of Rival
        What the user gave.
    limits : tuple of (OperatingPoint, Limits)
        The points where no controller can be better than these, the hardest of each rail and load.
    """

    envelope: Envelope
    nominal: bool
    selection: Selection
    control: LinearControl | None
    above_kmh: float | None
    in_use: Judgement | None
    worst_loops: tuple[ShownLoop, ...]
    stops: tuple[Stop, ...]
    rivals: tuple[Rival, ...]
    limits: tuple[tuple[OperatingPoint, Limits], ...]
    curves: tuple[LawCurve, ...]
    gains: GainMap | None
    responses: Responses | None
    faster: FasterBrake | None
    sliding: Sliding
    published: bool
    trials: tuple[Trial, ...] = ()
    seconds: float = math.nan
    date: datetime.date = field(default_factory=datetime.date.today)

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle, empty."""
        return self.envelope.vehicle

    @property
    def best(self) -> Choice | None:
        """The choice that is recommended."""
        return self.selection.best

    @property
    def judgement(self) -> Judgement | None:
        """The best design's, over the whole envelope."""
        return None if self.best is None or self.best.design is None else self.best.design.judgement

    @property
    def hands_over(self) -> bool:
        """Whether slip control ends at some speed."""
        return self.usable and self.control is not None and self.control.cut_out_speed > 0

    @property
    def usable(self) -> bool:
        """Whether there is a design to use."""
        return self.above_kmh is not None

    @property
    def first_stops(self) -> tuple[Stop, ...]:
        """One a rail: those of the first page."""
        rails = dict.fromkeys(stop.rail for stop in self.stops)
        return tuple(next(stop for stop in self.stops if stop.rail is rail) for rail in rails)


def restricted(judgement: Judgement, from_kmh: float) -> Judgement:
    """The same judgement over the speeds from one up, km/h."""
    kept = judgement.points.speed_kmh >= from_kmh
    columns: dict[str, Any] = {name: values[kept] for name, values in vars(judgement.margins).items()}
    speeds = tuple(v for v in judgement.envelope.speeds if v >= from_kmh)
    envelope = judgement.envelope.at(speeds=speeds)
    return Judgement(
        judgement.controller,
        envelope,
        judgement.nominal,
        judgement.points.take(kept),
        replace(judgement.margins, **columns),
    )
