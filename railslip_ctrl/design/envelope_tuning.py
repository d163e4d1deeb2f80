"""Tune one controller over a whole envelope, and judge it over the envelope before it is returned."""

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
    """Controller with its `judgement` over an envelope; `simulate`, `campaign` and `judge` accept a `Design`.

    `reason` states why Ms is larger than required above the hand-over speed; it is empty if Ms is small enough.
    """

    controller: Controller
    judgement: Judgement
    reason: str = ""

    @property
    def structure(self) -> str:
        return self.controller.kind

    def __str__(self) -> str:
        return f"{self.controller.described()}\n{self.judgement}"

    def save(self, path: str | Path) -> None:
        """Write the controller to the TOML file `path`, which every command accepts with --controller.

        InputError if the file cannot be written, or if the envelope's adhesion laws have different reference slips.
        """
        if self.controller.reference is None and self.controller.follows_reference:
            raise InputError(
                "controller: the adhesion laws of the envelope have different reference slips; give the envelope "
                "reference slips"
            )
        self.controller.model_copy(update={"name": Path(path).stem}).save(path)


def by_rule(
    kind: type[Controller],
    envelope: Envelope,
    ms_max: float = ROBUST_MS,
    *,
    nominal: bool = False,
    period: float | None = None,
) -> Design:
    """Compute the parameters of a controller from the vehicle, without tuning, and judge the controller.

    `kind` is a class with a rule for its parameters. If Ms is above `ms_max`, a ratio > 1, the `Design` has a `reason`.
    With `nominal` the judgement has no tolerances. `period`: sampling period, s; by default the rule sets it.
    """
    fields = {} if period is None else {"period": check_period(period)}
    control = kind.for_vehicle(envelope.vehicle, **fields)
    judgement = judge(envelope, control, nominal)
    used = judgement.points.operating & (judgement.points.speed_kmh >= judgement.hand_over_kmh)
    worst = float(judgement.run_ms[used].max(initial=0.0))
    reason = "" if worst <= ms_max else f"with the gains of the rule Ms is {worst:.4g}, not <= {ms_max:g}"
    return Design(control, judgement, reason)


def hand_over_of(judgement: Judgement) -> float:
    """Return the hand-over speed, km/h, of a judged design: below it the controller should not control the slip.

    Above the hand-over speed the design is robust. If it is not robust at the highest speed, every loop is stable above
    the hand-over speed. The result is 0 for an envelope with a single speed, and if no speed has this property.
    """
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
    """Tune one controller for all operating points of an envelope, empty and loaded, with the largest integral gain.

    The gains are tuned at the operating points; the tolerances are used only for the judgement. If the controller has a
    rule that computes the parameters from the vehicle, they are not tuned.

    - envelope: operating points and tolerances of the controller.
    - structure: "pi"; "pi-lead", whose lead cancels the actuator's lag; "pid", whose derivative time is searched; the
      name of a controller with a rule, such as "seeking"; or your own controller class.
    - ms_max: largest Ms of the continuous and of the sampled loop at the operating points, a ratio > 1. The default is
      2 if neither `phase_min`, `delay_min` nor `minimise_ms` is given, else no limit.
    - phase_min, delay_min: smallest phase margin, deg, and smallest delay margin, s.
    - minimise_ms: if true, the worst Ms is minimised; by default the integral gain is maximised.
    - ki_min: smallest integral gain, N*m/m; required with `minimise_ms`, not allowed without it.
    - nominal: judge without tolerances.
    - lead, lead_filter: time constants of the lead and of its filter, s; by default the lead is the actuator's lag, and
      the filter a tenth of the lead.
    - period: sampling period, s, at most twice `lead_filter`; by default 10 ms, or the period that the kind's rule
      sets.

    InfeasibleDesignError: no gains meet the specification; the message has remedies. InputError: an unknown structure,
    a number out of range, `ki_min` without `minimise_ms` or the reverse, an argument that the structure does not use,
    or an envelope without points.
    """
    specification, kind = Specification(ms_max, phase_min, delay_min), structure_named(structure)
    if not issubclass(kind, PI):
        unused = {"phase_min": phase_min, "delay_min": delay_min, "minimise_ms": minimise_ms or None, "ki_min": ki_min}
        for name, given in (unused | {"lead": lead, "lead_filter": lead_filter}).items():
            if given is not None:
                raise InputError(
                    f"{name} has no effect with {kind.kind!r}, whose gains are computed by rules; leave {name} out"
                )
        ruled = by_rule(kind, envelope, ROBUST_MS if ms_max is None else ms_max, nominal=nominal, period=period)
        if ruled.reason:
            raise InfeasibleDesignError(ruled.reason)
        return ruled
    if minimise_ms != (ki_min is not None):
        raise InputError("minimise_ms and ki_min need each other; give both, or neither to maximise ki")
    if not minimise_ms and specification == Specification():
        specification = Specification(ROBUST_MS)
    leads = {"lead": lead, "lead_filter": lead_filter}
    tuned, design = tune_over(envelope, specification, kind, ki_min=ki_min, nominal=nominal, period=period, **leads)
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
    """Tune a controller for any specification; return the tuned gains and the design.

    The arguments are those of `tune`. If the specification is infeasible, the design is None, and the `reason` of
    `TunedCases` states why.
    """
    hold = PERIOD if period is None else check_period(period)
    points = envelope.points(nominal=nominal)
    actuator = envelope.vehicle.actuator
    delayed = _with_hold(actuator, hold)
    tuned_at = partial(
        tune_cases,
        actuator=delayed,
        kind=kind,
        specification=specification,
        ki_min=ki_min,
        lead=lead,
        lead_filter=lead_filter,
    )
    plants = operating_plants(points)
    tuned = _tuned_at_ends(tuned_at, plants)
    at_one_lead = partial(tuned_at, kind=PILead, lead=tuned.lead) if issubclass(kind, PID) else tuned_at
    if tuned.design is not None and len(tuned.points) < len(plants):
        search = at_one_lead if len(plants) > _MANY else tuned_at
        tuned = replace(_for_all(search, tuned, plants, delayed), kind=kind)
    if tuned.design is None:
        return replace(tuned, reason="; ".join([tuned.reason, *_remedies(at_one_lead, envelope, hold)])), None
    run = sampled_below(tuned.controller(tuned.design), period, plants, actuator, specification.ms_max)
    loops = [wheel_slip_loop(plant, run.design, actuator) for plant in plants]
    worst, gains = worst_of(family_margins(loops)), run.design.gains
    assert worst is not None, "the design was tuned with a longer dead time, so that these loops are stable"
    margins = tuple(loop.margins() for loop in loops)
    design = replace(tuned.design, kp=gains.kp, ki=gains.ki, worst=worst, margins=margins)
    return replace(tuned, design=design), judged_design(
        kind, run, envelope, points, common_reference(envelope, points), nominal
    )


def _with_hold(actuator: Actuator, period: float) -> Actuator:
    # half a period of dead time approximates the zero-order hold to second order
    return actuator.model_copy(update={"dead_time": actuator.dead_time + period / 2})


def sampled_below(
    design: PIController, period: float | None, plants: Sequence[LinearPlant], actuator: Actuator, ms_max: float | None
) -> SampledController:
    """Sample a controller, and reduce its ki until Ms of every sampled loop is at most `ms_max`.

    `design` was tuned with half a sampling `period`, s, of additional dead time. If Ms is still larger after
    `_KI_STEPS` reductions, the last controller is returned.
    """
    step, critical = _KI_STEP, list(plants)
    for _ in range(_KI_STEPS):
        run = SampledController(design, run_period(design, period))
        if ms_max is None or actuator.dead_time > MOST_PERIODS * run.period:
            break
        ms = [sampled_peak(sampled_loop(plant, run, actuator)) for plant in critical]
        if max(ms) <= ms_max:
            break
        critical = [plant for plant, peak in zip(critical, ms, strict=True) if peak > _NEAR * max(ms)]
        gains = PIGains(kp=design.gains.kp, ki=design.gains.ki * (1 - step))
        design, step = PIController(gains, design.lead, design.lead_filter), 2 * step
    return run


def judged_design(
    kind: type[PI],
    run: SampledController,
    envelope: Envelope,
    points: EnvelopePoints,
    slips: ReferenceSlip | None,
    nominal: bool = False,
) -> Design:
    """Return a tuned controller as an instance of `kind`, with its judgement over the envelope."""
    judgement = judge_points(envelope, run, points, nominal=nominal)
    operating = [plant.point for plant in operating_plants(points)]
    hand_over = hand_over_of(judgement)
    control = braking_control(
        run.design, operating, slips, name=kind.kind, hand_over_kmh=hand_over, period=run.period, kind=kind
    )
    return Design(control, judgement)


def _ends(plants: Sequence[LinearPlant], from_kmh: float = 0.0) -> list[LinearPlant]:
    speeds = [v for plant in plants if (v := plant.point.speed_kmh) > 0.999 * from_kmh]
    ends = min(speeds), max(speeds)
    return [plant for plant in plants if plant.point.speed_kmh in ends]


def _tuned_at_ends(tuned_at: Tuner, plants: Sequence[LinearPlant]) -> TunedCases:
    tuned = tuned_at(_ends(plants))
    if tuned.design is not None or len(tuned.points) == len(plants):
        return tuned
    speeds = sorted({point.speed_kmh for point in tuned.points})
    return replace(tuned, reason=f"at {' and '.join(f'{v:g}' for v in speeds)} km/h alone: {tuned.reason}")


def _for_all(tuned_at: Tuner, tuned: TunedCases, plants: Sequence[LinearPlant], actuator: Actuator) -> TunedCases:
    # a design that is optimal for a subset and feasible for all plants is optimal for all
    subset, result = _ends(plants), tuned
    while result.design is not None:
        known = {id(plant) for plant in subset}
        violating = _violating(result, [plant for plant in plants if id(plant) not in known], actuator)
        if not violating:
            return replace(result, points=tuple(plant.point for plant in plants))
        subset += violating
        result = tuned_at(subset)
    return tuned_at(plants)  # gives the reason for all plants


def _violating(tuned: TunedCases, plants: Sequence[LinearPlant], actuator: Actuator) -> list[LinearPlant]:
    """Return the plants, at most `_JOINING`, that most violate the specification or exceed the minimised Ms."""
    assert tuned.design is not None
    if not plants:
        return []
    controller, required = tuned.controller(tuned.design), tuned.specification
    ms_max = required.ms_max if tuned.ki_min is None else tuned.design.worst.ms
    margins = family_margins([wheel_slip_loop(plant, controller, actuator) for plant in plants], gain_margins=False)
    low = (margins.phase_deg < (required.phase_min_deg or 0.0)) | (margins.delay_s < (required.delay_min_s or 0.0))
    met = margins.stable & ~low & (margins.ms <= (ms_max or math.inf))
    worst = np.argsort(np.where(met, 0.0, -np.nan_to_num(margins.ms, nan=np.inf)))[:_JOINING]
    return [plants[i] for i in worst.tolist() if not met[i]]


def _feasible_from(tuned_at: Tuner, plants: Sequence[LinearPlant], actuator: Actuator) -> float | None:
    """Return the lowest speed, km/h, above which the specification is feasible; None if no speed is feasible."""
    speeds = sorted({plant.point.speed_kmh for plant in plants})

    def feasible(speed: float) -> bool:
        above = [plant for plant in plants if plant.point.speed_kmh > 0.999 * speed]
        ends = tuned_at(_ends(above))
        return ends.design is not None and (not _violating(ends, above, actuator) or tuned_at(above).design is not None)

    first = bisect_left(speeds, True, key=lambda speed: tuned_at(_ends(plants, speed)).design is not None)
    if first < len(speeds) and not feasible(speeds[first]):
        first = bisect_left(speeds, True, first + 1, key=feasible)
    return None if first == len(speeds) else speeds[first]


def _remedies(tuned_at: Callable[..., TunedCases], envelope: Envelope, period: float) -> Iterator[str]:
    """Yield remedies for an infeasible specification as text: leave out low speeds, reduce slip, speed up the brake."""
    brake, points = envelope.vehicle.actuator, envelope.points(nominal=True)
    plants, slips, delayed = operating_plants(points), common_reference(envelope, points), _with_hold(brake, period)
    lowest = _feasible_from(tuned_at, plants, delayed)
    met = "the specification can be met from"
    yield "no speed meets the specification" if lowest is None else f"{met} {lowest:g} km/h up"
    for factor in _REMEDY_FACTORS:
        if slips is None:
            break
        less = envelope.at(reference=ReferenceSlip(dry=factor * slips.dry, wet=factor * slips.wet))
        lowest = _feasible_from(tuned_at, operating_plants(less.points(nominal=True)), delayed)
        if lowest is not None:
            yield f"with {100 * factor:g} % of the reference slip {met} {lowest:g} km/h up"
            break
    for factor in _REMEDY_FACTORS:
        faster = Actuator(dead_time=factor * brake.dead_time, lag=factor * brake.lag)
        delayed = _with_hold(faster, period)
        lowest = _feasible_from(partial(tuned_at, actuator=delayed), plants, delayed)
        if lowest is not None:
            brake_text = f"dead time {faster.dead_time:.3g} s and lag {faster.lag:.3g} s"
            yield f"with {brake_text} {met} {lowest:g} km/h up"
            break


def operating_plants(points: EnvelopePoints) -> list[LinearPlant]:
    """Return the plants of the operating points."""
    return [points.plants[i] for i in points.plant[points.operating]]


def common_reference(envelope: Envelope, points: EnvelopePoints) -> ReferenceSlip | None:
    """Return the reference slips on dry and wet rail; None if they differ between the adhesion laws.

    If the envelope has only one rail, its slip is also returned for the other rail.
    """
    if envelope.reference is not None:
        return envelope.reference
    slips = {rail: {p.point.slip for p in operating_plants(points) if p.point.rail is rail} for rail in Rail}
    if any(len(values) > 1 for values in slips.values()):
        return None
    (dry,), (wet,) = slips[Rail.DRY] or slips[Rail.WET], slips[Rail.WET] or slips[Rail.DRY]
    return ReferenceSlip(dry=dry, wet=wet)


REFERENCE_FACTORS = (1.0, 0.75, 0.5)
"""Factors that `select` tries on the reference slips of the envelope."""

REACH_SHARE = 0.5
"""Share of the stopping time within which a design must build up the torque of its reference slip."""

# integral times that are tried, relative to dead time plus lag, longest first
_INTEGRAL_TIMES = 64.0 * 2.0 ** -np.array([0, 2, 3, 4, 4.5, 5, 5.5, 6, 6.5, 7, 8])
_LOOKS = (0.5, 0.25, 0.75, 0.1, 0.9)  # further trial gains in the stabilising interval, on a log scale from 0 to 1
_GAINS = 16  # number of gains of an interval, in equal ratios, at which Ms is computed
_INSIDE = 0.02  # share of an interval, on a log scale, left out at its ends, where gains are not stable
_WIDEST = 100.0  # largest ratio of the ends of an interval that is searched; smaller gains hardly control the wheel
_JOINING = 8  # largest number of violating plants added at once
_REMEDY_FACTORS = (0.75, 0.5, 0.25)  # on reference slip, or on dead time and lag, tried for an infeasible design
_MANY = 100  # operating points above which the derivative time of a PID is searched only at the hardest
_ENOUGH = 1e4  # N*m/(m/s), upper gain if nothing bounds it; large for any wheel
_WORSE = 2  # number of successive integral times with worse results that ends the search of shorter ones
_TIME_STEP = 0.95  # ratio of integral times at which the search ends
_KI_STEP, _KI_STEPS = 2e-4, 10  # first relative reduction of ki, doubled each time, and largest number of reductions
_NEAR = 0.99  # share of the largest sampled Ms above which a loop may become the worst while ki is reduced
_NEARLY = 1.05  # allowed Ms relative to the smallest over all integral times, if that is above 2
_BINDING = 6  # number of cases of each speed, for the lower and for the upper bound of the gains, kept for refinement


@dataclass(frozen=True)
class StructureChoice:
    """Candidate of `select`: a structure, a factor on the reference slips, and the design tuned for both.

    - structure: "pi" or "pi-lead".
    - reference_factor: factor on the envelope's reference slips.
    - design: the tuned controller with its judgement; None, with a `reason`, if no gains stabilise the loops.
    - reach_s: time, s, in which the integral term builds up the torque that holds the reference slip.
    - stop_s: time, s, of a stop from the envelope's initial speed with the adhesion of the operating point. Both times
      belong to the operating point at the highest speed with the largest ratio of `reach_s` to `stop_s`.
    - adhesion_share: smallest ratio of adhesion at the candidate's reference slip to adhesion at the envelope's.
    - lead_filter: time constant of the lead's filter, s.
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
        """True if the reference slip is reached within `REACH_SHARE` of the stopping time."""
        return self.reach_s <= REACH_SHARE * self.stop_s

    @property
    def tier(self) -> tuple[bool, float, float]:
        """Sort key for the first three items of the list in `select`."""
        if self.design is None:
            return True, math.inf, math.inf
        judgement = self.design.judgement
        usable, robust = judgement.usable_from_kmh, judgement.robust_from_kmh
        lowest = math.inf if usable is None else usable
        return robust is None, lowest, rounded_up(judgement.worst.ms, 2) if robust is None else robust

    @property
    def rank(self) -> tuple[tuple[bool, float, float], bool, float, str]:
        """Sort key for all items of the list in `select`; the smallest is the best."""
        return self.tier, not self.reaches, -self.reference_factor, self.structure

    @property
    def description(self) -> str:
        if self.design is not None and not isinstance(self.design.controller, PI):
            return f"{self.structure}: {self.design.judgement.verdict_line}"
        kind = f"PI-lead with a filter of {self.lead_filter:.3g} s" if self.structure == "pi-lead" else "PI"
        name = f"{kind}, {100 * self.reference_factor:g} % of the reference slip"
        if self.design is None:
            return f"{name}: {self.reason}"
        less = f"; adhesion {100 * (self.adhesion_share - 1):+.2g} %" if self.reference_factor != 1.0 else ""
        slow = "" if self.reaches else f"; reaches its reference in {self.reach_s:.3g} s, stops in {self.stop_s:.3g} s"
        return f"{name}: {self.design.judgement.verdict_line}{less}{slow}"


@dataclass(frozen=True)
class Selection:
    """Candidates of `select`, best first."""

    choices: tuple[StructureChoice, ...]

    @cached_property
    def best(self) -> StructureChoice | None:
        """Best candidate; None if no candidate stabilises the loops at the highest speed."""
        return self.choices[0] if self.choices[0].design is not None else None

    def __str__(self) -> str:
        return "\n".join(choice.description for choice in self.choices)


@checked
def select(
    envelope: Envelope,
    structures: Sequence[str] = ("pi", "pi-lead"),
    reference_factors: Sequence[float] = REFERENCE_FACTORS,
    filter_ratio: float = FILTER_RATIO,
) -> Selection:
    """Select the best PI or PI-lead, sampled every 10 ms, for an envelope with its reference slips or smaller ones.

    Two candidates are compared by the first of these items in which they differ:

    - robust (Ms <= 2 at the operating points, and stable with every tolerance) at the highest speed
    - lower speed from which up the loops are stable with every tolerance
    - lower speed from which up the design is robust; if it is robust at no speed, smaller worst Ms
    - reference slip reached: the integral term builds up the necessary torque within half the stopping time
    - larger reference slip

    For each structure and reference slip, ki is the largest for which the loops are stable, with Ms <= 2, from the
    lowest possible speed up. If no gains have Ms <= 2, Ms may be 5 % above its smallest value.

    - envelope: operating points and tolerances of the design.
    - structures: "pi", "pi-lead" or both; the lead cancels the actuator's lag.
    - reference_factors: factors > 0 on the envelope's reference slips, ratios. If the adhesion laws have different
      reference slips, only the factor 1 is used.
    - filter_ratio: time constant of the lead's filter over that of the lead, a ratio, > 0.

    InputError: an envelope without points.
    """
    choices = []
    own = envelope.points(nominal=True)
    slips = common_reference(envelope, own)
    for factor in reference_factors if slips is not None else [f for f in reference_factors if f == 1.0]:
        reference = (
            slips if slips is None or factor == 1.0 else ReferenceSlip(dry=factor * slips.dry, wet=factor * slips.wet)
        )
        scaled = envelope if factor == 1.0 else envelope.at(reference=reference)
        points = scaled.points()
        lag = envelope.vehicle.actuator.lag
        for structure in structures:
            lead = lag if structure == "pi-lead" else 0.0
            if structure == "pi-lead" and lag == 0.0:
                continue  # no lag to cancel
            choices.append(_choice(structure, factor, scaled, points, (lead, filter_ratio * lead), reference))
            if choices[-1].design is not None:
                choices[-1] = replace(choices[-1], adhesion_share=_adhesion_share(own, points))
    return Selection(tuple(sorted(choices, key=lambda choice: choice.rank)))


def _choice(
    structure: str,
    factor: float,
    envelope: Envelope,
    points: EnvelopePoints,
    lead: tuple[float, float],
    reference: ReferenceSlip | None,
) -> StructureChoice:
    period = run_period(PIController(PIGains(kp=1.0, ki=0.0), *lead))
    delayed = replace(points, actuators=tuple(_with_hold(actuator, period) for actuator in points.actuators))
    try:
        controller, from_kmh = _Search(delayed, *lead).best()
    except InfeasibleDesignError as error:
        return StructureChoice(structure, factor, None, str(error), lead_filter=lead[1])
    plants = [plant for plant in operating_plants(points) if plant.point.speed_kmh > 0.999 * (from_kmh or 0.0)]
    run = sampled_below(controller, period, plants, envelope.vehicle.actuator, None if from_kmh is None else ROBUST_MS)
    design = judged_design(PILead if lead[0] > 0 else PI, run, envelope, points, reference)
    reach, stop = _reach(run.design, points, envelope)
    return StructureChoice(structure, factor, design, "", reach, stop, lead_filter=lead[1])


def _adhesion_share(own: EnvelopePoints, points: EnvelopePoints) -> float:
    pairs = zip(operating_plants(points), operating_plants(own), strict=True)
    return min(mine.point.adhesion_force / other.point.adhesion_force for mine, other in pairs)


def _reach(controller: PIController, points: EnvelopePoints, envelope: Envelope) -> tuple[float, float]:
    """Return the time to build up the torque that holds the reference slip, and the stopping time, s.

    Both belong to the operating point at the highest speed with the largest ratio of the first time to the second.
    """
    operating = [plant.point for plant in operating_plants(points)]
    start = SURE_SHARE * min(point.brake_torque for point in operating)
    times = []
    for point in operating:
        # at the start the wheel rolls, and the slip error is the reference slip velocity
        error = point.slip * point.speed
        lacking = point.brake_torque - start - controller.gains.kp * error
        reach = (
            0.0 if lacking <= 0 else lacking / (controller.gains.ki * error) if controller.gains.ki > 0 else math.inf
        )
        stop = envelope.initial_speed * KMH * point.vehicle.effective_mass / point.adhesion_force
        if point.speed_kmh > 0.999 * max(envelope.speeds):
            times.append((reach, stop))
    return max(times, key=lambda pair: pair[0] / pair[1])


@dataclass(frozen=True)
class _Result:
    """Gain for an integral time (s), with the lowest speed (km/h) of stable loops and the worst Ms from there up."""

    integral_time: float
    speed: float
    kp: float
    ms: float

    @property
    def rank(self) -> tuple[bool, float, float]:
        robust = is_robust(self.ms)
        return not robust, self.speed, -self.kp / self.integral_time if robust else self.ms


@dataclass(frozen=True)
class _Search:
    """Search for the gains of a PI with a lead over the cases of an envelope; `lead` and `lead_filter` are in s."""

    points: EnvelopePoints
    lead: float
    lead_filter: float

    @cached_property
    def scale(self) -> float:
        actuator = self.points.vehicle.actuator
        return (actuator.dead_time + actuator.lag) or 0.02

    def controller(self, kp: float, integral_time: float) -> PIController:
        return PIController(PIGains(kp=kp, ki=kp / integral_time), self.lead, self.lead_filter)

    def best(self) -> tuple[PIController, float | None]:
        """Return the best controller, and the speed, km/h, from which up its Ms is at most 2; None if Ms > 2."""
        hardest, times = _hardest(self.points), (self.scale * _INTEGRAL_TIMES).tolist()
        slowest, few = self.at(times[0], hardest)
        if slowest is None:
            raise InfeasibleDesignError(
                "no gains were found that stabilise every loop at the highest speed with every tolerance; shorten the "
                "dead time, or choose a smaller reference slip"
            )
        results, worse = [slowest], 0
        for time in times[1:]:
            result, _ = self.at(time, few)
            worse = worse + 1 if result is None or result.rank[:2] > min(r.rank[:2] for r in results) else 0
            results += [] if result is None else [result]
            if worse == _WORSE:
                break
        ranked = sorted(results, key=lambda r: r.rank)
        if not is_robust(ranked[0].ms):
            # the smallest Ms has almost no integral action; a slightly larger Ms allows much more
            limit = _NEARLY * min(r.ms for r in ranked if r.speed <= slowest.speed)
            ranked = [r for r in ranked if r.speed <= slowest.speed and r.ms <= limit]
            ranked.sort(key=lambda r: -r.kp / r.integral_time)
        for result in ranked:
            if result is slowest:
                break
            # check all hard cases, because a case that was left out may be critical here
            checked, _ = self.at(result.integral_time, hardest)
            if checked is not None and checked.rank[:2] <= slowest.rank[:2]:
                return self.faster(checked, times, hardest, few)
        return self.faster(slowest, times, hardest, few)

    def faster(
        self, start: _Result, times: list[float], points: EnvelopePoints, few: EnvelopePoints
    ) -> tuple[PIController, float | None]:
        """Shorten the integral time of `start` while the result is not worse; return what `best` returns."""
        end = max((time for time in times if time < start.integral_time), default=start.integral_time)
        results, ratio = [start], (end / start.integral_time) ** 0.5 if is_robust(start.ms) else 1.0
        while ratio < _TIME_STEP:
            result, _ = self.at(results[-1].integral_time * ratio, few)
            if result is not None and result.rank <= results[-1].rank:
                results.append(result)
            ratio **= 0.5
        best = start
        for result in results[:0:-1]:
            checked, _ = self.at(result.integral_time, points)
            if checked is not None and checked.rank <= start.rank:
                best = checked
                break
        return self.controller(best.kp, best.integral_time), best.speed if is_robust(best.ms) else None

    def at(self, integral_time: float, points: EnvelopePoints) -> tuple[_Result | None, EnvelopePoints]:
        """Return the best gain for an integral time, and the cases that limit this gain.

        The gain is None if no gain stabilises the loops at the highest speed.
        """
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
        margins = margins_at(self.controller(1.0, integral_time), operating, gains)
        ms = np.where(margins.stable, margins.ms, np.inf).reshape(gains.size, len(operating))
        candidates = []
        for speed, (bottom, top) in sorted(ends.items()):
            worst = np.where((bottom < gains) & (gains < top), ms[:, operating.speed_kmh >= speed].max(axis=1), np.inf)
            robust = np.flatnonzero([is_robust(peak) for peak in worst.tolist()])
            best = int(robust[-1]) if robust.size else int(np.argmin(worst))  # the largest gain, or the smallest Ms
            candidates.append(_Result(integral_time, speed, float(gains[best]), float(worst[best])))
        chosen = next((c for c in candidates if is_robust(c.ms)), candidates[0])
        return chosen, _binding(points, low, high, ms, operating)

    def intervals(self, integral_time: float, points: EnvelopePoints) -> tuple[Floats, Floats]:
        """Return the smallest and the largest stabilising gain of each case, (n,); inf and 0 if no gain was found."""
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
            margins = margins_at(self.controller(gain, integral_time), points.take(left), gain_margins=True)
            stable = np.flatnonzero(margins.stable)
            low[left[stable]] = gain * margins.gain_decrease[stable]
            high[left[stable]] = gain * margins.gain_increase[stable]
            left = left[~margins.stable]
            if not left.size:
                break
        return low, high

    def start(self, integral_time: float) -> float:
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
    if not math.isfinite(high):
        high = _WIDEST * low or _ENOUGH
    low = max(low, high / _WIDEST)
    shares = np.linspace(_INSIDE, 1.0 - _INSIDE, count)
    return [low * (high / low) ** share for share in shares.tolist()]


def _binding(
    points: EnvelopePoints, low: Floats, high: Floats, ms: Floats, operating: EnvelopePoints
) -> EnvelopePoints:
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
    dead_times = np.array([actuator.dead_time for actuator in points.actuators])[points.actuator]
    lags = np.array([actuator.lag for actuator in points.actuators])[points.actuator]
    ends = (lags == lags.min()) | (lags == lags.max())
    return points.take(points.operating | ((dead_times == dead_times.max()) & ends))
