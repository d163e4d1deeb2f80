"""One controller tuned over a whole envelope, and judged over it before it is returned."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.controllers.base import PERIOD, Controller
from railslip_ctrl.controllers.braking import SURE_SHARE, braking_control
from railslip_ctrl.controllers.files import structure_named
from railslip_ctrl.controllers.pi import FILTER_RATIO, PI, PID, PILead
from railslip_ctrl.controllers.sampled import SampledController, run_period, sampled_loop, sampled_peak
from railslip_ctrl.controllers.systems import PIController, wheel_slip_loop
from railslip_ctrl.core.arguments import checked
from railslip_ctrl.core.errors import InfeasibleDesignError, InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH, rounded_up
from railslip_ctrl.loop.sampled import MOST_PERIODS, check_period
from railslip_ctrl.model.adhesion import ReferenceSlip
from railslip_ctrl.model.linearization import LinearPlant
from railslip_ctrl.model.vehicle import Actuator, PIGains, Rail

from .envelope import Envelope, EnvelopePoints
from .judging import Judgement, judge, judge_points, margins_at
from .specification import ROBUST_MS, Specification, family_margins, is_robust, worst_of
from .tuning import TunedCases, tune_cases

Floats = NDArray[np.float64]
Tuner = Callable[[Sequence[LinearPlant]], TunedCases]


@dataclass(frozen=True)
class Design:
    """A controller as it brakes, with its `judgement` over an envelope; `simulate`, `campaign` and `judge` take it.

    `reason` says why it does not have the Ms asked for at the speeds that it controls; empty if it has.
    """

    controller: Controller
    judgement: Judgement
    reason: str = ""

    @property
    def structure(self) -> str:
        """The kind of its controller."""
        return self.controller.kind

    def __str__(self) -> str:
        return f"{self.controller.described()}\n{self.judgement}"

    def save(self, path: str | Path) -> None:
        """Write the TOML file that every command takes with --controller.

        InputError where it cannot be written, or the laws of the envelope have different reference slips.
        """
        if self.controller.reference is None and self.controller.follows_reference:
            raise InputError("controller: the laws of its envelope hold different slips; give the envelope a reference")
        self.controller.model_copy(update={"name": Path(path).stem}).save(path)


def by_rule(
    kind: type[Controller],
    envelope: Envelope,
    ms_max: float = ROBUST_MS,
    *,
    nominal: bool = False,
    period: float | None = None,
) -> Design:
    """The controller of a kind whose parameters follow from the vehicle, judged; one with a larger Ms than `ms_max` is
    a result, with its reason."""
    asked = {} if period is None else {"period": check_period(period)}
    control = kind.for_vehicle(envelope.vehicle, **asked)
    judgement = judge(envelope, control, nominal)
    used = judgement.points.operating & (judgement.points.speed_kmh >= judgement.hand_over_kmh)
    worst = float(judgement.run_ms[used].max(initial=0.0))
    reason = "" if worst <= ms_max else f"its gains go by rules, with which Ms is {worst:.4g}, not <= {ms_max:g}"
    return Design(control, judgement, reason)


def hand_over_of(judgement: Judgement) -> float:
    """The speed, km/h, below which slip is no longer controlled: the lowest at which a design is robust, or if it is
    nowhere, stable with every tolerance; 0, never, over a single speed."""
    robust = judgement.robust_from_kmh
    lowest = robust if robust is not None else judgement.usable_from_kmh or 0.0
    return lowest if len(judgement.envelope.speeds) > 1 else 0.0


@checked
def tune(
    envelope: Envelope,
    structure: str | type[Controller] = "pi-lead",
    ms_max: float | None = None,
    *,
    phase_min: float | None = None,
    delay_min: float | None = None,
    minimise_ms: bool = False,
    ki_min: float | None = None,
    nominal: bool = False,
    lead: float | None = None,
    lead_filter: float | None = None,
    period: float | None = None,
) -> Design:
    """The largest integral gain that keeps a specification at every operating point of an envelope, empty and loaded
    together; or a controller of a kind whose parameters follow from the vehicle. The arguments are the options of
    `railslip tune`.

    - envelope: what the controller must hold.
    - structure: a kind: "pi"; "pi-lead", with a lead at the actuator's lag; "pid", whose derivative time is searched;
      one that follows from the vehicle, such as "seeking"; or the class of a kind of one's own.
    - ms_max: largest Ms at the operating points, a ratio, > 1, of the loop and as it runs, sampled; 2 if nothing else
      is asked for. Tolerances are judged, not tuned for.
    - phase_min, delay_min: least phase margin, deg, and least delay margin, s.
    - minimise_ms, ki_min: minimise the worst Ms instead, at an integral gain of at least `ki_min`, N*m/m.
    - nominal: judge without tolerances.
    - lead, lead_filter: time constants of the lead, s; left out, the actuator's lag, and a tenth of the lead.
    - period: sampling period at which it runs, s, or twice the lead's filter if that is less; left out 10 ms, or that
      of the kind's rule.

    Returns the controller, kp in N*m/(m/s), ki in N*m/m, and its judgement over the envelope, tolerances included.
    InfeasibleDesignError: no gains keep it; says from which speed (km/h) up some do, also with less slip and a faster
    brake. InputError: an unknown structure, a number out of its range, `ki_min` or `minimise_ms` alone, an argument
    that the structure does not use, or an envelope without points.
    """
    asked, kind = Specification(ms_max, phase_min, delay_min), structure_named(structure)
    if not issubclass(kind, PI):
        unused = {"phase_min": phase_min, "delay_min": delay_min, "minimise_ms": minimise_ms or None, "ki_min": ki_min}
        for name, given in (unused | {"lead": lead, "lead_filter": lead_filter}).items():
            if given is not None:
                raise InputError(f"{name}: does not go with {kind.kind!r}, whose gains go by rules; leave it out")
        found = by_rule(kind, envelope, ROBUST_MS if ms_max is None else ms_max, nominal=nominal, period=period)
        if found.reason:
            raise InfeasibleDesignError(found.reason)
        return found
    if minimise_ms != (ki_min is not None):
        raise InputError("minimise_ms and ki_min: go together; give both, or neither to maximise ki")
    if not minimise_ms and asked == Specification():
        asked = Specification(ROBUST_MS)
    leads = {"lead": lead, "lead_filter": lead_filter}
    tuned, design = tune_over(envelope, asked, kind, ki_min=ki_min, nominal=nominal, period=period, **leads)
    if design is None:
        raise InfeasibleDesignError(tuned.reason)
    return design


def tune_over(
    envelope: Envelope,
    specification: Specification,
    kind: type[PI],
    *,
    ki_min: float | None = None,
    lead: float | None = None,
    lead_filter: float | None = None,
    nominal: bool = False,
    period: float | None = None,
) -> tuple[TunedCases, Design | None]:
    """As `tune`, for any specification, judged at the operating points alone if `nominal`; an infeasible one is a
    result, with its reason."""
    held_for = PERIOD if period is None else check_period(period)
    points = envelope.points(nominal=nominal)
    actuator = envelope.vehicle.actuator
    late = _held(actuator, held_for)
    tuned_at = partial(
        tune_cases,
        actuator=late,
        kind=kind,
        specification=specification,
        ki_min=ki_min,
        lead=lead,
        lead_filter=lead_filter,
    )
    plants = operating_plants(points)
    tuned = _early(tuned_at, plants)
    at_one_lead = partial(tuned_at, kind=PILead, lead=tuned.lead) if issubclass(kind, PID) else tuned_at
    if tuned.design is not None and len(tuned.points) < len(plants):
        search = at_one_lead if len(plants) > _MANY else tuned_at
        tuned = replace(_for_all(search, tuned, plants, late), kind=kind)
    if tuned.design is None:
        return replace(tuned, reason="; ".join([tuned.reason, *_what_would(at_one_lead, envelope, held_for)])), None
    run = sampled_below(tuned.controller(tuned.design), period, plants, actuator, specification.ms_max)
    loops = [wheel_slip_loop(plant, run.design, actuator) for plant in plants]
    worst, gains = worst_of(family_margins(loops)), run.design.gains
    assert worst is not None, "less dead time than it was tuned with"
    margins = tuple(loop.margins() for loop in loops)
    design = replace(tuned.design, kp=gains.kp, ki=gains.ki, worst=worst, margins=margins)
    return replace(tuned, design=design), judged_design(
        kind, run, envelope, points, held_slips(envelope, points), nominal
    )


def _held(actuator: Actuator, period: float) -> Actuator:
    """With the delay of a hold, half a period: sampled loops come out as these to the square of the period."""
    return actuator.model_copy(update={"dead_time": actuator.dead_time + period / 2})


def sampled_below(
    design: PIController, period: float | None, plants: Sequence[LinearPlant], actuator: Actuator, ms_max: float | None
) -> SampledController:
    """A design tuned with the delay of its hold as it runs, ki so much less that no sampled loop has more than an Ms.

    Where that does not come about in some steps the last is given: its judgement says what it is.
    """
    step, looked_at = _KI_STEP, list(plants)
    for _ in range(_KI_STEPS):
        run = SampledController(design, run_period(design, period))
        if ms_max is None or actuator.dead_time > MOST_PERIODS * run.period:
            break
        ms = [sampled_peak(sampled_loop(plant, run, actuator)) for plant in looked_at]
        if max(ms) <= ms_max:
            break
        looked_at = [plant for plant, one in zip(looked_at, ms, strict=True) if one > _NEAR * max(ms)]
        gains = PIGains(kp=design.gains.kp, ki=design.gains.ki * (1 - step))
        design, step = PIController(gains, design.lead, design.lead_filter), 2 * step
    return run


def judged_design(
    kind: type[PI],
    run: SampledController,
    envelope: Envelope,
    points: EnvelopePoints,
    held: ReferenceSlip | None,
    nominal: bool = False,
) -> Design:
    """A tuned controller of a kind, as it brakes, with its judgement."""
    judgement = judge_points(envelope, run, points, nominal=nominal)
    operating = [plant.point for plant in operating_plants(points)]
    hand_over = hand_over_of(judgement)
    control = braking_control(
        run.design, operating, held, name=kind.kind, hand_over_kmh=hand_over, period=run.period, kind=kind
    )
    return Design(control, judgement)


def _ends(plants: Sequence[LinearPlant], from_kmh: float = 0.0) -> list[LinearPlant]:
    """The plants of the lowest speed from one up, km/h, and of the highest: the hardest, as a rule."""
    speeds = [v for plant in plants if (v := plant.point.speed_kmh) > 0.999 * from_kmh]
    ends = min(speeds), max(speeds)
    return [plant for plant in plants if plant.point.speed_kmh in ends]


def _early(tuned_at: Tuner, plants: Sequence[LinearPlant]) -> TunedCases:
    """At the hardest plants alone: what is infeasible there is so at all, and its reason is had much sooner."""
    tuned = tuned_at(_ends(plants))
    if tuned.design is not None or len(tuned.points) == len(plants):
        return tuned
    speeds = sorted({point.speed_kmh for point in tuned.points})
    return replace(tuned, reason=f"at {' and '.join(f'{v:g}' for v in speeds)} km/h alone: {tuned.reason}")


def _for_all(tuned_at: Tuner, tuned: TunedCases, plants: Sequence[LinearPlant], actuator: Actuator) -> TunedCases:
    """What was tuned at the hardest plants, for all: those that miss the specification worst join, until none does.

    What is the best of some plants and does for all is the best of all.
    """
    some, found = _ends(plants), tuned
    while found.design is not None:
        known = {id(plant) for plant in some}
        missed = _missed(found, [plant for plant in plants if id(plant) not in known], actuator)
        if not missed:
            return replace(found, points=tuple(plant.point for plant in plants))
        some += missed
        found = tuned_at(some)
    return tuned_at(plants)  # for the reason


def _missed(tuned: TunedCases, plants: Sequence[LinearPlant], actuator: Actuator) -> list[LinearPlant]:
    """The few of some plants that miss most of what others were tuned for: the specification, or their least Ms."""
    assert tuned.design is not None
    if not plants:
        return []
    controller, asked = tuned.controller(tuned.design), tuned.specification
    most = asked.ms_max if tuned.ki_min is None else tuned.design.worst.ms
    found = family_margins([wheel_slip_loop(plant, controller, actuator) for plant in plants], gain_margins=False)
    low = (found.phase_deg < (asked.phase_min_deg or 0.0)) | (found.delay_s < (asked.delay_min_s or 0.0))
    met = found.stable & ~low & (found.ms <= (most or math.inf))
    worst = np.argsort(np.where(met, 0.0, -np.nan_to_num(found.ms, nan=np.inf)))[:_JOINING]
    return [plants[i] for i in worst.tolist() if not met[i]]


def _feasible_from(tuned_at: Tuner, plants: Sequence[LinearPlant], actuator: Actuator) -> float | None:
    """The speed, km/h, from which up it can be met, or None; of fewer plants more can be asked: speeds are halved."""
    speeds = sorted({plant.point.speed_kmh for plant in plants})

    def feasible(speed: float) -> bool:
        above = [plant for plant in plants if plant.point.speed_kmh > 0.999 * speed]
        ends = tuned_at(_ends(above))
        return ends.design is not None and (not _missed(ends, above, actuator) or tuned_at(above).design is not None)

    first = bisect_left(speeds, True, key=lambda speed: tuned_at(_ends(plants, speed)).design is not None)
    if first < len(speeds) and not feasible(speeds[first]):
        first = bisect_left(speeds, True, first + 1, key=feasible)
    return None if first == len(speeds) else speeds[first]


def _what_would(tuned_at: Callable[..., TunedCases], envelope: Envelope, period: float) -> Iterator[str]:
    """From which speed up it can be met, also with less slip and with a faster brake."""
    brake, points = envelope.vehicle.actuator, envelope.points(nominal=True)
    plants, slips, late = operating_plants(points), held_slips(envelope, points), _held(brake, period)
    lowest = _feasible_from(tuned_at, plants, late)
    yield "at no speed of the envelope it can" if lowest is None else f"from {lowest:g} km/h up it can"
    for factor in _REMEDIES:
        if slips is None:
            break
        less = envelope.at(reference=ReferenceSlip(dry=factor * slips.dry, wet=factor * slips.wet))
        lowest = _feasible_from(tuned_at, operating_plants(less.points(nominal=True)), late)
        if lowest is not None:
            yield f"with {factor:g} of the reference slip from {lowest:g} km/h up"
            break
    for factor in _REMEDIES:
        faster = Actuator(dead_time=factor * brake.dead_time, lag=factor * brake.lag)
        late = _held(faster, period)
        lowest = _feasible_from(partial(tuned_at, actuator=late), plants, late)
        if lowest is not None:
            yield f"with dead time {faster.dead_time:.3g} s and lag {faster.lag:.3g} s from {lowest:g} km/h up"
            break


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


# --- selection: the best PI or PI-lead, with a smaller reference slip where that helps --------------------------------


REFERENCE_FACTORS = (1.0, 0.75, 0.5)
"""Reference slips that are tried, over those of the envelope."""

REACH_SHARE = 0.5
"""Share of the time of a stop in which a design must have built up the torque that its reference slip takes."""

_INTEGRAL_TIMES = 64.0 * 2.0 ** -np.array(
    [0, 2, 3, 4, 4.5, 5, 5.5, 6, 6.5, 7, 8]
)  # over dead time and lag together, slowest first
_LOOKS = (0.5, 0.25, 0.75, 0.1, 0.9)  # shares of an interval of gains, in ratio, at which others are looked for
_GAINS = 16  # of an interval of gains, in equal ratios, at which Ms is looked at
_INSIDE = 0.02  # share of an interval, in ratio, left at its ends: a gain on the end is not stable
_WIDEST = 100.0  # ratio of the ends of an interval that is looked at: below, a stable wheel is left to itself
_JOINING = 8  # plants at once, of those that miss what was tuned at others
_REMEDIES = (0.75, 0.5, 0.25)  # of the reference slip, and of dead time and lag: what is tried where no gains do
_MANY = 100  # operating points: of more the derivative time of a PID is searched at the hardest alone
_ENOUGH = 1e4  # N*m/(m/s), a gain that is large for any wheel, where none is too large and none too small
_WORSE = 2  # integral times in a row at which less is had than at longer ones, which end the search of shorter ones
_TIME_STEP = 0.95  # ratio of integral times that are told apart
_KI_STEP, _KI_STEPS = 2e-4, 10  # of ki, doubled each time, where sampling does more than its delay
_NEAR = 0.99  # of the largest sampled Ms: loops that may become the worst while ki is taken down
_NEARLY = 1.05  # times the least Ms that any integral time has, where it is above 2
_BINDING = 6  # cases of each speed that bound the gains from below, and as many from above, kept for a closer look


@dataclass(frozen=True)
class StructureChoice:
    """One candidate: a structure with the slips it holds, and the design, or None with the reason.

    `reference_factor` is that on the envelope's reference slips. `reach_s` is the longest time, s, in which the
    integral builds up the torque that the reference slip takes, over the operating points of highest speed, and
    `stop_s` the time of a stop there with the adhesion of the reference slip. `adhesion_share` is the adhesion at the
    slips held over that at the envelope's, the least over the operating points. `lead_filter` is that of the lead, s.
    """

    structure: str
    reference_factor: float
    design: Design | None
    reason: str = ""
    reach_s: float = math.inf
    stop_s: float = math.nan
    adhesion_share: float = math.nan
    lead_filter: float = 0.0

    @property
    def reaches(self) -> bool:
        """Whether the reference slip is reached in `REACH_SHARE` of a stop."""
        return self.reach_s <= REACH_SHARE * self.stop_s

    @property
    def tier(self) -> tuple[bool, float, float]:
        """Smaller is better: what comes first in the criterion of `select`, of the judgement alone."""
        if self.design is None:
            return True, math.inf, math.inf
        judgement = self.design.judgement
        usable, robust = judgement.usable_from_kmh, judgement.robust_from_kmh
        lowest = math.inf if usable is None else usable
        return robust is None, lowest, rounded_up(judgement.worst.ms, 2) if robust is None else robust

    @property
    def rank(self) -> tuple[tuple[bool, float, float], bool, float, str]:
        """Smaller is better; see `select`."""
        return self.tier, not self.reaches, -self.reference_factor, self.structure

    @property
    def words(self) -> str:
        """What it is and what its judgement says."""
        if self.design is not None and not isinstance(self.design.controller, PI):
            return f"{self.structure}: {self.design.judgement.verdict_line}"
        kind = f"PI-lead with a filter of {self.lead_filter:.3g} s" if self.structure == "pi-lead" else "PI"
        name = f"{kind}, {self.reference_factor:g} of the reference slip"
        if self.design is None:
            return f"{name}: {self.reason}"
        less = f"; adhesion {100 * (self.adhesion_share - 1):+.2g} %" if self.reference_factor != 1.0 else ""
        slow = "" if self.reaches else f"; its reference takes {self.reach_s:.3g} s of a stop of {self.stop_s:.3g} s"
        return f"{name}: {self.design.judgement.verdict_line}{less}{slow}"


@dataclass(frozen=True)
class Selection:
    """What `select` tried, best first."""

    choices: tuple[StructureChoice, ...]

    @cached_property
    def best(self) -> StructureChoice | None:
        """The best; None if none holds the loops at the highest speed."""
        return self.choices[0] if self.choices[0].design is not None else None

    def __str__(self) -> str:
        return "\n".join(choice.words for choice in self.choices)


@checked
def select(
    envelope: Envelope,
    structures: Sequence[str] = ("pi", "pi-lead"),
    reference_factors: Sequence[float] = REFERENCE_FACTORS,
    filter_ratio: float = FILTER_RATIO,
) -> Selection:
    """The best PI or PI-lead for an envelope, at its reference slip or a smaller one, judged as it runs every 10 ms.

    The criterion, in this order: robust from some speed up (Ms <= 2 at the operating points, and stable with every
    tolerance), rather than nowhere; stable with every tolerance from the lowest speed; robust from the lowest speed
    (if nowhere: the least worst Ms); the reference slip is reached, that is, the integral has built up the torque that
    it takes within half the time of a stop; the larger reference slip. Of one structure and reference slip the gains
    are those that hold from the lowest speed with Ms <= 2 and the largest ki; where none has Ms <= 2, the largest ki
    with an Ms within 5 % of the least.

    - envelope: what the design must hold.
    - structures: of "pi" and "pi-lead"; the lead is at the actuator's lag.
    - reference_factors: reference slips that are tried, over those of the envelope, > 0, ratios; 1 alone where the laws
      have different ones.
    - filter_ratio: time constant of the lead's filter over that of the lead, a ratio, > 0.

    Returns every candidate with its judgement (speeds in km/h), the best first. InputError: an envelope without points.
    """
    choices = []
    own = envelope.points(nominal=True)
    slips = held_slips(envelope, own)
    for factor in reference_factors if slips is not None else [one for one in reference_factors if one == 1.0]:
        held = (
            slips if slips is None or factor == 1.0 else ReferenceSlip(dry=factor * slips.dry, wet=factor * slips.wet)
        )
        scaled = envelope if factor == 1.0 else envelope.at(reference=held)
        points = scaled.points()
        lag = envelope.vehicle.actuator.lag
        for structure in structures:
            lead = lag if structure == "pi-lead" else 0.0
            if structure == "pi-lead" and lag == 0.0:
                continue  # nothing to lead
            choices.append(_choice(structure, factor, scaled, points, (lead, filter_ratio * lead), held))
            if choices[-1].design is not None:
                choices[-1] = replace(choices[-1], adhesion_share=_adhesion_share(own, points))
    return Selection(tuple(sorted(choices, key=lambda choice: choice.rank)))


def _choice(
    structure: str,
    factor: float,
    envelope: Envelope,
    points: EnvelopePoints,
    lead: tuple[float, float],
    held: ReferenceSlip | None,
) -> StructureChoice:
    """`lead` and its filter, s."""
    period = run_period(PIController(PIGains(kp=1.0, ki=0.0), *lead))
    late = replace(points, actuators=tuple(_held(one, period) for one in points.actuators))
    try:
        found, from_kmh = _Search(late, *lead).best()
    except InfeasibleDesignError as error:
        return StructureChoice(structure, factor, None, str(error), lead_filter=lead[1])
    kept = [plant for plant in operating_plants(points) if plant.point.speed_kmh > 0.999 * (from_kmh or 0.0)]
    run = sampled_below(found, period, kept, envelope.vehicle.actuator, None if from_kmh is None else ROBUST_MS)
    design = judged_design(PILead if lead[0] > 0 else PI, run, envelope, points, held)
    reach, stop = _reach(run.design, points, envelope)
    return StructureChoice(structure, factor, design, "", reach, stop, lead_filter=lead[1])


def _adhesion_share(own: EnvelopePoints, points: EnvelopePoints) -> float:
    """Least adhesion at the operating points over that at the envelope's own, in the same order."""
    pairs = zip(operating_plants(points), operating_plants(own), strict=True)
    return min(mine.point.adhesion_force / other.point.adhesion_force for mine, other in pairs)


def _reach(controller: PIController, points: EnvelopePoints, envelope: Envelope) -> tuple[float, float]:
    """(time to build up the torque of the reference slip, time of a stop), s, where the one is longest over the other.

    From a rolling wheel the error is the whole reference slip velocity; the run begins with what every rail takes.
    """
    operating = [plant.point for plant in operating_plants(points)]
    start = SURE_SHARE * min(point.brake_torque for point in operating)
    times = []
    for point in operating:
        error = point.slip * point.speed
        lacking = point.brake_torque - start - controller.gains.kp * error
        reach = (
            0.0 if lacking <= 0 else lacking / (controller.gains.ki * error) if controller.gains.ki > 0 else math.inf
        )
        stop = envelope.initial_speed * KMH * point.vehicle.effective_mass / point.adhesion_force
        if point.speed_kmh > 0.999 * max(envelope.speeds):
            times.append((reach, stop))
    return max(times, key=lambda one: one[0] / one[1])


# --- the search -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Held:
    """Gains of one integral time, s: the lowest speed held, km/h, and the worst Ms from there up."""

    integral_time: float
    speed: float
    kp: float
    ms: float

    @property
    def rank(self) -> tuple[bool, float, float]:
        """Smaller is better: robust from the lowest speed with the largest ki; else the least Ms from the lowest."""
        robust = is_robust(self.ms)
        return not robust, self.speed, -self.kp / self.integral_time if robust else self.ms


@dataclass(frozen=True)
class _Search:
    """The gains of a PI behind a lead with its filter, s, over some points."""

    points: EnvelopePoints
    lead: float
    lead_filter: float

    @cached_property
    def scale(self) -> float:
        """Dead time and lag together, s."""
        actuator = self.points.vehicle.actuator
        return (actuator.dead_time + actuator.lag) or 0.02

    def controller(self, kp: float, integral_time: float) -> PIController:
        return PIController(PIGains(kp=kp, ki=kp / integral_time), self.lead, self.lead_filter)

    def best(self) -> tuple[PIController, float | None]:
        """The controller, and the lowest speed, km/h, from which it has Ms <= 2; None if from none.

        InfeasibleDesignError if no gains hold the loops at the highest speed.
        """
        hardest, times = _hardest(self.points), (self.scale * _INTEGRAL_TIMES).tolist()
        slowest, few = self.held(times[0], hardest)
        if slowest is None:
            raise InfeasibleDesignError("no gains found that hold every loop, with tolerances, at the highest speed")
        looks, worse = [slowest], 0
        for time in times[1:]:
            look, _ = self.held(time, few)
            worse = worse + 1 if look is None or look.rank[:2] > min(one.rank[:2] for one in looks) else 0
            looks += [] if look is None else [look]
            if worse == _WORSE:
                break
        found = sorted(looks, key=lambda one: one.rank)
        if not is_robust(found[0].ms):
            # the least Ms is had by next to no integral: a little more buys much of it
            limit = _NEARLY * min(one.ms for one in found if one.speed <= slowest.speed)
            found = [one for one in found if one.speed <= slowest.speed and one.ms <= limit]
            found.sort(key=lambda one: -one.kp / one.integral_time)
        for one in found:
            if one is slowest:
                break
            # what the closer look left out may bind after all
            checked, _ = self.held(one.integral_time, hardest)
            if checked is not None and checked.rank[:2] <= slowest.rank[:2]:
                return self.faster(checked, times, hardest, few)
        return self.faster(slowest, times, hardest, few)

    def faster(
        self, held: _Held, times: list[float], points: EnvelopePoints, few: EnvelopePoints
    ) -> tuple[PIController, float | None]:
        """`best` from gains that hold, or of a shorter integral time, before the next that was tried, that does as
        well: looked for by halves at a few of the points, asked of all."""
        end = max((time for time in times if time < held.integral_time), default=held.integral_time)
        found, ratio = [held], (end / held.integral_time) ** 0.5 if is_robust(held.ms) else 1.0
        while ratio < _TIME_STEP:
            look, _ = self.held(found[-1].integral_time * ratio, few)
            if look is not None and look.rank <= found[-1].rank:
                found.append(look)
            ratio **= 0.5
        best = held
        for look in found[:0:-1]:
            checked, _ = self.held(look.integral_time, points)
            if checked is not None and checked.rank <= held.rank:
                best = checked
                break
        return self.controller(best.kp, best.integral_time), best.speed if is_robust(best.ms) else None

    def held(self, integral_time: float, points: EnvelopePoints) -> tuple[_Held | None, EnvelopePoints]:
        """The lowest speed from which up some gain holds every loop, with Ms <= 2 if that can be had at any speed;
        and the points that decide it."""
        low, high = self.intervals(integral_time, points)
        above = {speed: points.speed_kmh >= speed for speed in np.unique(points.speed_kmh).tolist()}
        ends = {speed: (float(low[mine].max()), float(high[mine].min())) for speed, mine in above.items()}
        ends = {speed: inside for speed, inside in ends.items() if inside[0] < inside[1]}
        if not ends:
            return None, points
        gains = np.unique(
            [*_spread(*ends[max(ends)], _GAINS), *(x for inside in ends.values() for x in _spread(*inside, 3))]
        )
        operating = points.take(points.operating)
        found = margins_at(self.controller(1.0, integral_time), operating, gains)
        ms = np.where(found.stable, found.ms, np.inf).reshape(gains.size, len(operating))
        candidates = []
        for speed, (bottom, top) in sorted(ends.items()):
            worst = np.where((bottom < gains) & (gains < top), ms[:, operating.speed_kmh >= speed].max(axis=1), np.inf)
            robust = np.flatnonzero([is_robust(one) for one in worst.tolist()])
            best = int(robust[-1]) if robust.size else int(np.argmin(worst))  # the largest gain, or the least Ms
            candidates.append(_Held(integral_time, speed, float(gains[best]), float(worst[best])))
        chosen = next((one for one in candidates if is_robust(one.ms)), candidates[0])
        return chosen, _binding(points, low, high, ms, operating)

    def intervals(self, integral_time: float, points: EnvelopePoints) -> tuple[Floats, Floats]:
        """The gains that hold each case: the ends of their interval, (n,); inf and 0 where none was found.

        Looked for where gains hold every loop of highest speed that is known: others are of no use.
        """
        low, high = np.full(len(points), np.inf), np.zeros(len(points))
        fastest = points.speed_kmh == points.speed_kmh.max()
        left, gain = np.arange(len(points)), self.start(integral_time)
        for share in (None, *_LOOKS):
            if share is not None:
                known = fastest & (high > 0)
                bottom, top = low[known].max(initial=1e-6), high[known].min(initial=_ENOUGH)
                if not bottom < top:
                    break
                gain = bottom * (top / bottom) ** share
            found = margins_at(self.controller(gain, integral_time), points.take(left), gain_margins=True)
            held = np.flatnonzero(found.stable)
            low[left[held]] = gain * found.gain_decrease[held]
            high[left[held]] = gain * found.gain_increase[held]
            left = left[~found.stable]
            if not left.size:
                break
        return low, high

    def start(self, integral_time: float) -> float:
        """A gain that holds some operating point of highest speed, or 1."""
        fast = np.flatnonzero(self.points.operating & (self.points.speed_kmh == self.points.speed_kmh.max()))
        for index in fast.tolist():
            case = self.points.case(index)
            usable = wheel_slip_loop(
                case.plant, self.controller(1.0, integral_time), case.actuator
            ).stabilizing_gain_range
            if usable is not None:
                low, high = usable
                return math.sqrt(max(low, 1e-3 * high) * high) if math.isfinite(high) else 2.0 * max(low, 1e-3)
        return 1.0


def _spread(low: float, high: float, count: int) -> list[float]:
    """Gains within an interval, in equal ratios; far within one that has no end."""
    if not math.isfinite(high):
        high = _WIDEST * low or _ENOUGH
    low = max(low, high / _WIDEST)
    shares = np.linspace(_INSIDE, 1.0 - _INSIDE, count)
    return [low * (high / low) ** share for share in shares.tolist()]


def _binding(
    points: EnvelopePoints, low: Floats, high: Floats, ms: Floats, operating: EnvelopePoints
) -> EnvelopePoints:
    """The cases of each speed that bound the gains first, and its operating points of highest Ms at each gain."""
    chosen = np.zeros(len(points), dtype=bool)
    numbers = np.flatnonzero(points.operating)
    for speed in np.unique(points.speed_kmh):
        here = np.flatnonzero(points.speed_kmh == speed)
        chosen[here[np.argsort(-low[here])[:_BINDING]]] = True
        chosen[here[np.argsort(high[here])[:_BINDING]]] = True
        mine = np.flatnonzero(operating.speed_kmh == speed)
        chosen[numbers[mine[ms[:, mine].argmax(axis=1)]]] = True
    return points.take(chosen)


def _hardest(points: EnvelopePoints) -> EnvelopePoints:
    """The operating points and the cases of longest dead time, which holds least, with the ends of the lag."""
    dead_times = np.array([one.dead_time for one in points.actuators])[points.actuator]
    lags = np.array([one.lag for one in points.actuators])[points.actuator]
    ends = (lags == lags.min()) | (lags == lags.max())
    return points.take(points.operating | ((dead_times == dead_times.max()) & ends))
