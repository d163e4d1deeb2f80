"""A design report computed: the best design over an envelope, and what a design review asks of it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from railslip_ctrl.core.cache import cached, look_up
from railslip_ctrl.core.errors import RailslipError
from railslip_ctrl.core.folders import cache_folder
from railslip_ctrl.core.processes import cpu_count, processes
from railslip_ctrl.core.units import KMH
from railslip_ctrl.design import PIController
from railslip_ctrl.design.assessment import limits_of
from railslip_ctrl.design.envelope import Envelope
from railslip_ctrl.design.judging import Judgement, WorstCase, judge, margins_at
from railslip_ctrl.design.limits import Limits
from railslip_ctrl.design.selection import Choice, Selection, select
from railslip_ctrl.loop import Rational
from railslip_ctrl.loop.curves import frequency_curve
from railslip_ctrl.loop.responses import disturbance_response, step_response
from railslip_ctrl.model.adhesion import law_names
from railslip_ctrl.model.linearization import OperatingPoint
from railslip_ctrl.model.numeric import adhesion_coefficient, peak
from railslip_ctrl.model.vehicle import Actuator, PIGains, Vehicle
from railslip_ctrl.simulation.catalogue import hand_over_of, is_published
from railslip_ctrl.simulation.controllers import Controller
from railslip_ctrl.verification.joint_verification import verify_with_actuator

from .records import (
    DesignReport,
    FasterBrake,
    GainMap,
    LawCurve,
    Responses,
    Rival,
    ShownLoop,
    Sliding,
    Trial,
    restricted,
)
from .stops import as_run, laws_of, stops

Progress = Callable[[str], None]

LOAD_STEP = 100.0
"""N*m at the wheel, of the load response."""

_CACHED = "conditions-layered"
_LARGEST_SLIP = 0.5  # end of the adhesion curves
_SLIPS = 401
_GAINS = 4.0 ** np.linspace(-1.0, 1.0, 13)  # over the design's own, which stand in the middle
_RESPONSE_TIME = 10.0  # s
_FASTER = (0.75, 0.5, 0.25)  # times dead time and lag, tried in turn


def design_report(
    envelope: Envelope,
    *,
    nominal: bool = False,
    given: dict[str, Any] | None = None,
    sliding: bool = True,
    fresh: bool = False,
    progress: Progress = lambda message: None,
) -> DesignReport:
    """Everything of one vehicle that a design review looks at.

    Parameters
    ----------
    envelope : Envelope
        What the design must hold.
    nominal : bool
        Judge its operating points alone.
    given : dict, optional
        Linear controllers of the user's by name, judged and run beside; one of a file runs as that says.
    sliding : bool
        Decide the conditions of the layered sliding-mode law too, in another process where there are two cores.
    fresh : bool
        Decide them again, which an earlier report of the same vehicle may have kept.
    progress : callable
        Told what is done, a line at a time.

    Raises
    ------
    InputError
        An envelope without points, or a controller without margins.
    """
    with _beside() as submit:
        here: Beside = partial if not _may_be_sent(envelope) else submit
        plain = here(select, envelope, ("pi",))
        decided = _sliding(envelope.vehicle, submit, fresh=fresh) if sliding else lambda: Sliding(None, "not asked for")
        return _report(envelope, nominal, given or {}, (here, plain, decided), progress)


Beside = Callable[..., Callable[[], Any]]
"""Takes a function and its arguments; what gives the result, computed in another process, or when asked for."""


@contextmanager
def _beside() -> Iterator[Beside]:
    """Another process where there are two cores."""
    if cpu_count() < 2:
        yield partial
        return
    cache_folder()  # the other process's too, where there is none but for this run
    with processes(1) as submit:
        yield lambda function, *arguments: submit(function, *arguments).result


def _may_be_sent(envelope: Envelope) -> bool:
    """Whether its laws are published ones, by name: the class of a law of the user's own is unknown elsewhere."""
    return all(isinstance(law, str) and law in law_names() for law in envelope.laws)


def _sliding(vehicle: Vehicle, submit: Beside, *, fresh: bool) -> Callable[[], Sliding]:
    """What gives the conditions: from an earlier report, or decided beside."""
    before = None if fresh else look_up(_CACHED, vehicle.model_dump_json())
    return submit(_verified, vehicle) if before is None else lambda: Sliding(before)


def _verified(vehicle: Vehicle) -> Sliding:
    """The conditions of the layered law, or why they cannot be decided for this vehicle."""
    decide = lambda: verify_with_actuator(law="layered", vehicle=vehicle)  # noqa: E731
    try:
        return Sliding(cached(_CACHED, decide, vehicle.model_dump_json(), fresh=True))
    except RailslipError as error:
        return Sliding(None, str(error))


def _report(
    envelope: Envelope,
    nominal: bool,
    given: dict[str, Any],
    beside: tuple[Beside, Callable[[], Selection], Callable[[], Sliding]],
    progress: Progress,
) -> DesignReport:
    """`beside`: where to compute, and what gives the plain PI, and the sliding-mode law."""
    started = time.perf_counter()
    submit, plain, sliding = beside
    progress(f"the best design over the envelope of {envelope.vehicle.name}")
    lead = select(envelope, ("pi-lead",)).choices if envelope.vehicle.actuator.lag > 0 else ()
    selection = Selection(tuple(sorted((*lead, *plain().choices), key=lambda choice: choice.rank)))
    report = _designed(envelope, nominal, selection, submit, progress)
    rivals = []
    for name, controller in given.items():
        progress(f"{name}, judged and run beside")
        rivals.append(_rival(name, controller, envelope, nominal, report))
    progress("conditions of the layered sliding-mode law")
    return replace(report, rivals=tuple(rivals), sliding=sliding(), seconds=time.perf_counter() - started)


def _designed(
    envelope: Envelope, nominal: bool, selection: Selection, submit: Beside, progress: Progress
) -> DesignReport:
    """The report but for rivals and the sliding-mode law."""
    empty = DesignReport(
        envelope, nominal, selection, None, None, None, (), (), (), (), (), None, None, None, Sliding(None),
        is_published(envelope.vehicle),
    )  # fmt: skip
    if selection.best is None:
        points = envelope.points(nominal=True)
        blank = Judgement(None, envelope, True, points, None)  # type: ignore[arg-type]
        return replace(empty, limits=_limits(blank), curves=_curves(blank))
    progress("braking runs")
    tied = [one for one in selection.choices if one.tier == selection.best.tier]
    trials = sorted((_trial(one, nominal) for one in tied), key=lambda trial: trial.rank)
    best, control = trials[0].choice, trials[0].control
    selection = Selection((*(trial.choice for trial in trials), *selection.choices[len(tied) :]))
    assert best.design is not None, "as its tier"
    assert best.design.judgement is not None
    plain, judgement = control.design, best.design.judgement
    robust = judgement.robust_from_kmh == min(envelope.speeds)
    faster = (lambda: None) if robust else submit(_faster, envelope, best.structure, judgement.envelope)
    in_use = restricted(judgement, trials[0].lowest_kmh)
    progress("limits, gains around the design, responses")
    found = replace(
        empty,
        selection=selection,
        trials=tuple(trials),
        control=control,
        above_kmh=trials[0].above_kmh,
        in_use=in_use,
        worst_loops=_worst_loops(in_use),
        stops=trials[0].stops,
        limits=_limits(judgement),
        curves=_curves(judgement),
        gains=_gain_map(in_use, plain),
        responses=_responses(in_use.worst, plain),
    )
    if not robust:
        progress("the brake that would do")
    return replace(found, faster=faster())


def _trial(choice: Choice, nominal: bool) -> Trial:
    """A choice, judged at the operating points alone if `nominal`, in its stops: handed over above speeds at which it
    is not robust, or the wheel slides."""
    assert choice.design is not None, "a choice of the best tier is a design"
    assert choice.design.judgement is not None
    design, judgement = choice.design, choice.design.judgement
    if nominal:
        judgement = judge(design, judgement.envelope, nominal=True)
        choice = replace(choice, design=replace(design, judgement=judgement))
    plain = PIController(design.gains, design.lead, design.lead_filter)
    robust, begins = judgement.robust_from_kmh, hand_over_of(judgement)
    lowest = robust if robust is not None else judgement.usable_from_kmh or 0.0
    speeds = [speed for speed in sorted(judgement.envelope.speeds) if speed >= lowest]
    first = None
    for speed in speeds[:-1] if robust is not None and len(speeds) > 1 else [lowest]:
        control = as_run(plain, judgement, speed if begins else 0.0)
        runs = stops(control, judgement)
        first = first or (control, runs)
        if not any(stop.slides for stop in runs):
            return Trial(choice, robust if robust is None else speed, speed, control, runs)
    assert first is not None
    return Trial(choice, None, lowest, *first)


def _rival(name: str, controller: Any, envelope: Envelope, nominal: bool, report: DesignReport) -> Rival:
    judgement = judge(controller, envelope, nominal=nominal)
    runs = isinstance(controller, Controller)  # of a file: as that says
    control = controller if runs else as_run(controller, judgement, hand_over_of(judgement), name)
    return Rival(name, controller, judgement, stops(control, judgement, every_law=False))


# --- loops ----------------------------------------------------------------------------------------------------------


def _worst_loops(judgement: Judgement) -> tuple[ShownLoop, ...]:
    cases = [judgement.worst] + ([] if judgement.nominal else [judgement.worst_with_tolerances])
    bands = [case.loop.feature_band() for case in cases]
    low, high = min(band[0] for band in bands), max(band[1] for band in bands)
    return tuple(
        ShownLoop(case.words, case.loop, case.margins, frequency_curve(case.loop, low, high)) for case in cases
    )


def _limits(judgement: Judgement) -> tuple[tuple[OperatingPoint, Limits], ...]:
    """What no controller beats, at the hardest operating point of each rail and load."""
    points = judgement.points
    operating = points.plant[points.operating].tolist()
    found: dict[tuple[str, str], tuple[OperatingPoint, Limits]] = {}
    for i in operating:
        plant = points.plants[i]
        here = limits_of(plant, points.vehicle.actuator)
        key = (plant.point.rail.value, points.loads[i])
        if key not in found or here.ms_bound > found[key][1].ms_bound:
            found[key] = (plant.point, here)
    return tuple(found.values())


def _gain_map(judgement: Judgement, design: PIController) -> GainMap:
    """Worst Ms around the design, at the operating points of the lowest and the highest speed in use."""
    points = judgement.points
    speeds = points.speed_kmh
    some = points.take(points.operating & ((speeds == speeds.min()) | (speeds == speeds.max())))
    kp, ki = design.gains.kp * _GAINS, design.gains.ki * _GAINS
    ms = np.empty((kp.size, ki.size))
    for i, j in np.ndindex(*ms.shape):
        gains = PIGains(kp=float(kp[i]), ki=float(ki[j]))
        found = margins_at(PIController(gains, design.lead, design.lead_filter), some)
        ms[i, j] = found.ms.max() if found.stable.all() else math.inf
    return GainMap(kp, ki, ms, (design.gains.kp, design.gains.ki), len(some))


def _responses(worst: WorstCase, design: PIController) -> Responses | None:
    """At the worst operating point; None of a loop too fast or too slow for the time shown."""
    if worst.margins is None:
        return None
    plant, actuator = worst.case.plant, worst.case.actuator
    bare, brake = Rational(plant.zeros, plant.poles, plant.gain), _lag(actuator)
    c, tau = design.transfer_function, actuator.dead_time
    try:
        step = step_response(c, bare, tau, final_time=_RESPONSE_TIME, actuator=brake, height=KMH)
        push = disturbance_response(c, bare, tau, final_time=_RESPONSE_TIME, actuator=brake, height=LOAD_STEP)
    except RailslipError:
        return None
    return Responses(worst.point, KMH, LOAD_STEP, step, push)


def _lag(actuator: Actuator) -> Rational:
    none: Any = np.array([])
    lag = actuator.lag
    return Rational(none, np.array([-1 / lag]), 1 / lag) if lag > 0 else Rational(none, none, 1)


def _faster(envelope: Envelope, structure: str, held: Envelope) -> FasterBrake | None:
    """The brake with which a structure is robust over the whole envelope, at the slip `held`; None if none tried is."""
    for factor in _FASTER:
        old = envelope.vehicle.actuator
        actuator = Actuator(dead_time=factor * old.dead_time, lag=factor * old.lag)
        faster = held.at(vehicle=envelope.vehicle.model_copy(update={"actuator": actuator}))
        found = select(faster, (structure,), (1.0,)).choices[0].design
        judgement = None if found is None else found.judgement
        if judgement is not None and judgement.robust_from_kmh == min(envelope.speeds):
            return FasterBrake(factor, actuator.dead_time, actuator.lag)
    return None


# --- adhesion -------------------------------------------------------------------------------------------------------


def _curves(judgement: Judgement) -> tuple[LawCurve, ...]:
    """The laws of the envelope, rail by rail."""
    return tuple(_curve(point) for point in laws_of(judgement))


def _curve(point: OperatingPoint) -> LawCurve:
    law, load = point.law, point.vehicle.wheel_load
    end = min(_LARGEST_SLIP, law.domain_limit(point.speed)[0] * (1.0 - 1e-9))
    slip = np.linspace(1e-6 if law.has_state else 0.0, end, _SLIPS)  # no rest state of a dynamic law without slip
    coefficient = np.asarray(adhesion_coefficient(law, point.speed, slip, load))
    return LawCurve(law.name, point.rail, point.speed_kmh, slip, coefficient, peak(law, point.speed, load), point)
