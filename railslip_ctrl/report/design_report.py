"""The design report of a vehicle: its first page, the sections behind it, its text and its JSON."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from rich.console import RenderableType

from railslip_ctrl import __version__
from railslip_ctrl.controllers.linear import LinearControl
from railslip_ctrl.controllers.pi import PI
from railslip_ctrl.core.units import KMH, ms_down
from railslip_ctrl.design.catalogue import is_published
from railslip_ctrl.design.envelope_tuning import StructureChoice
from railslip_ctrl.design.judging import Judgement
from railslip_ctrl.design.limits import StructureLimit
from railslip_ctrl.design.specification import ROBUST_MS
from railslip_ctrl.model.linearization import linearize
from railslip_ctrl.model.vehicle import doubts
from railslip_ctrl.report.recommendation import FASTER, LEVEL_KMH, SEEKING, DesignReport, Rival, Trial, longest
from railslip_ctrl.report.stops import SLIDING, Stop

from .document import (
    NONE,
    Block,
    Facts,
    FirstPage,
    Paragraph,
    Picture,
    Section,
    Table,
    above,
    below,
    counted,
    heading,
    listed,
    minus,
    ms_text,
    render,
    roots_text,
    short,
)
from .export import exported, plain
from .page import typeset
from .text import envelope_words, law_facts, no_lock_section, vehicle_facts, worst_cells, worst_rows

RECOMMENDED = "recommended.toml"
"""The file with the recommended design."""

_AXES = {
    "speed_kmh": "speed, km/h",
    "slip / reference": "slip factor",
    "radius_m": "wheel radius, m",
    "dead_time_s": "dead time, s",
    "lag_s": "lag, s",
}
_RANKED = (
    f"first by the lowest speed of use (robust, and slip below 0.5 with the brake as given; {LEVEL_KMH:g} km/h count "
    "as equal), then no oscillation, then the shortest mean stop"
)
_PAPER = "The numbers of [Park2008], its errata and its gains in both readings: railslip reproduce --out DIR."
_MOST_WORDS = 60  # of headline, why and what to do: a minute's reading leaves time for the numbers
_NEARLY_UNSTABLE = 10.0  # Ms: the curve of L passes -1 at a tenth
_MOST_TOLD = 8  # of points left out and knife edges


# --- first page -----------------------------------------------------------------------------------------------------


def first_page(report: DesignReport) -> FirstPage:
    """What to do, why, and at most ten numbers: what a reviewer reads in a minute."""
    headline, subject = _headline(report), _design_words(report)
    after = tuple(_not_judged(report))
    told = " ".join([headline, subject, *(text for _, text in after)])
    texts = _within(_MOST_WORDS - len(told.split()), _why(report), _risks(report), _steps(report))
    why, risk, to_do = map(" ".join, texts)
    return FirstPage(
        title=f"Wheel-slip control design: {report.vehicle.name}",
        headline=headline,
        subject=subject,
        file=RECOMMENDED if report.control is not None else "",
        lines=(
            ("Why", why),
            *after,
            *([("Risk", risk)] if risk else []),
            ("To do", to_do or f"Load {RECOMMENDED} and confirm it on the rig."),
            *_yours(report),
        ),
        head=("", "", "case: adhesion law, rail, load"),
        rows=tuple((name, value, minus(where)) for name, value, where in _rows(report)),
        pictures=tuple(_pictures(report)),
    )


def _headline(report: DesignReport) -> str:
    """Use it, use it above a speed, or do not."""
    if report.above_kmh is None:
        verdict = "" if report.in_use is None else report.in_use.verdict
        return "DO NOT USE: fragile" if verdict == "fragile" else "DO NOT USE"
    at = " at the operating points" if report.nominal else ""
    top = max(report.envelope.speeds)
    to = "" if top >= report.envelope.initial_speed else f" TO {top:g} km/h"
    if report.hands_over:
        from_kmh = f"{_used_from(report):g}"
        return f"USE FROM {from_kmh}{to}{at}" if to else f"USE ABOVE {from_kmh} km/h{at}"
    return f"USE{' UP' if to else ''}{to}{at}"


def _used_from(ran: DesignReport | Trial | Rival | None) -> float | None:
    """The speed, km/h, from which up a controller may be used and controls slip; None of one that did not run too."""
    if ran is None or ran.above_kmh is None or ran.judgement is None:
        return None
    return max(ran.above_kmh, round(ran.judgement.hand_over_kmh, 9))


def _design_words(report: DesignReport) -> str:
    """The recommended design with its numbers."""
    if report.control is None:
        return "any PI or PI-lead"
    held = report.control.reference if report.control.follows_reference else None
    if held is None:
        return report.control.headline()
    return f"{report.control.headline()}; slip " + ", ".join(
        f"{short(held.on(rail))} {rail}" for rail in report.envelope.rails
    )


def _why(report: DesignReport) -> Iterator[str]:
    """What decides, first."""
    if report.in_use is None or report.best is None:
        yield "No PI or PI-lead keeps every loop stable, not even at the highest speed of the envelope."
        if report.seeking is not None:
            yield f"{_shortest(report.seeking).capitalize()}."
        return
    judged = report.in_use
    operating = int(judged.points.operating.sum())
    robust = None if report.judgement is None else report.judgement.robust_from_kmh
    if report.above_kmh is None and robust is not None:
        yield "The best design is robust by its margins, but in a stop the wheel slides: slip over 0.5."
        return
    if report.above_kmh is None:
        asked = "Ms ≤ 2" if report.nominal else "Ms ≤ 2, and stability with every tolerance,"
        told = f"No design found keeps {asked} at any speed. The best"
        lowest = min(judged.envelope.speeds)
        begins = f"from {lowest:g} km/h up" if lowest > min(report.envelope.speeds) else "at every operating point"
        stable = f"is stable {begins}, Ms {worst_cells(judged.worst)[1]} at worst"
        yield f"{told} {'has unstable loops' if judged.verdict == 'unstable' else stable}."
        return
    told = f"Ms ≤ 2 at all {operating} operating points"
    if not report.nominal:
        told += f", stable at all {len(judged.points)} with tolerances"
    yield f"{told}."
    if robust != report.above_kmh:
        yield f"Controlled below {report.above_kmh:g} km/h, a wheel slides in a stop."
    factor = report.best.reference_factor
    if factor < 1.0 and all(stop.reached for stop in report.stops):
        more = [choice.tier for choice in report.selection.choices if choice.reference_factor > factor]
        less_robust = min(more, default=report.best.tier) > report.best.tier
        others = "are less robust" if less_robust else "do no better"
        yield f"It holds {100 * factor:g} % of the reference slip; designs that hold more {others}."


def _within(most: int, *texts: Iterable[str]) -> list[list[str]]:
    """The first sentence of each text, and more as far as so many words go."""
    sentences = [list(text) for text in texts]
    found = [text[:1] for text in sentences]
    most -= sum(len(one.split()) for text in found for one in text)
    for kept, text in zip(found, sentences, strict=True):
        for one in text[1:]:
            if len(one.split()) <= most:
                kept.append(one)
                most -= len(one.split())
    return found


def _not_judged(report: DesignReport) -> Iterator[tuple[str, str]]:
    """What the file does at speeds that were not judged, and below that at which it hands over."""
    top, begins = max(report.envelope.speeds), report.envelope.initial_speed
    if report.stops and begins > top:
        yield f"{top:g} to {begins:g} km/h", "its stops begin there, but it was not judged."
    if report.hands_over and report.control is not None:
        over, used = short(report.control.controlled_from / KMH), report.above_kmh or 0.0
        if used > float(over):
            yield f"{over} to {used:g} km/h", f"slip controlled, but {_between(report, float(over), used)}."
        yield f"Below {over} km/h", f"no slip control; holds {report.control.handed_over()}."


def _between(report: DesignReport, over: float, used: float) -> str:
    """What a judgement says of speeds, km/h, at which a design controls slip and is not to be used."""
    assert report.judgement is not None, "as it is in use"
    speeds, ms = report.judgement.points.speed_kmh, report.judgement.run_ms
    below_use = speeds < used * (1 - 1e-9)  # from m/s
    judged = (speeds > over * (1 - 1e-9)) & below_use
    if not judged.any():
        return "not judged"
    unstable = np.unique(speeds[judged & np.isinf(ms)]).tolist()
    told = f"unstable{'' if report.nominal else ' with tolerances'} at {listed(f'{one:.3g}' for one in unstable)} km/h"
    return told if unstable else "not robust"


def _risks(report: DesignReport) -> Iterator[str]:
    """What may happen all the same."""
    locking = [stop for stop in report.tolerance_stops if stop.locks]
    if locking:
        worst = ", ".join((locking[0].law, locking[0].rail, locking[0].load, locking[0].brake))
        of = f"{len(locking)} of {len(report.tolerance_stops)} stops with the actuator's tolerances"
        yield f"A wheel locks in {of} ({minus(worst)})."
    if swinging := dict.fromkeys(stop.law for stop in report.stops if stop.swings):
        yield f"With {' and '.join(swinging)} the wheel oscillates."
    if not report.usable or report.in_use is None or report.nominal:
        return
    told = []
    if not locking and (slid := max((stop.max_slip for stop in report.tolerance_stops), default=0.0)) > SLIDING:
        told.append(f"slip reaches {above(slid)}")
    worst_case = report.in_use.worst_with_tolerances
    if max(worst_case.ms, worst_case.as_run is not None and worst_case.run_ms) > _NEARLY_UNSTABLE:
        told.append(f"Ms {worst_cells(worst_case)[1]} is nearly unstable")
    if told:
        yield f"With tolerances {', and '.join(told)}."


def _steps(report: DesignReport) -> Iterator[str]:
    """What the numbers ask for."""
    seeks = report.control is not None and report.control.finds_slip
    lowest = min(report.envelope.speeds)
    robust = report.judgement is not None and report.judgement.robust_from_kmh == lowest
    slow = list(dict.fromkeys(str(stop.rail) for stop in report.stops if not stop.reached and not seeks))
    brake, reach = "", ""
    if report.faster is not None:
        brake = f"dead time {short(report.faster.dead_time, 3)} s, lag {short(report.faster.lag, 3)} s"
        reach = f"; with {brake} it comes there in every stop tried" if report.faster.reaches else ""
    over_kmh = 0.0 if report.control is None else report.control.controlled_from / KMH
    if report.hands_over and (report.above_kmh or 0.0) > over_kmh * (1 + 1e-9):  # from m/s
        yield "Below, use another slide protection."
    if report.usable and any(stop.slides for stop in report.tolerance_stops):
        yield "Measure dead time and lag, and report again."
    if slow and report.usable:
        yield f"Expect long stops: slip stays below its reference ({', '.join(slow)}){reach}."
    if brake and not robust and not seeks:
        yield f"For Ms ≤ 2 from {lowest:g} km/h up: {brake}."
    elif brake and not report.usable:
        yield f"With {brake} it is robust, and no wheel slides in the stops tried."
    elif not report.usable:
        yield "Judge from a higher speed, or change the brake."
        least = min(choice.reference_factor for choice in report.selection.choices)
        tried = [] if least == 1 else [f"holding {100 * least:g} % of the reference slip"]
        tried.append(f"a brake with {100 * FASTER[-1]:g} % of this dead time and lag")
        yield f"Tried, and not enough: {'; '.join(tried)}."
    if not seeks and report.usable and report.judgement is not None and report.judgement.envelope.knife_edges():
        yield "The reference is at the adhesion peak: hold less slip."


def _yours(report: DesignReport) -> Iterator[tuple[str, str]]:
    """Of each controller of the user's the verdict, or why there is none, and its longest stops."""
    for one in report.rivals:
        told = "; ".join(f"{stop.rail} {_distance(stop)} ({_stop_words(stop)})" for stop in longest(one.stops))
        locks = "a wheel locks" if any(stop.locks for stop in one.stops) else "no lock"
        said = f"NOT JUDGED: {one.name} is {one.reason} and has no margins"
        if (judged := one.judgement) is not None:
            start = "at no speed" if judged.usable_from_kmh is None else f"from {judged.usable_from_kmh:g} km/h up"
            held = "" if judged.nominal else " with every tolerance"
            worst = worst_cells(judged.worst)
            ms = f"{worst[0]}: {worst[1]} at {worst[2]}" if judged.worst.margins else f"unstable at {worst[2]}"
            said = f"{judged.verdict.upper()}: {one.name} is stable{held} {start}; {ms}"
        yield "Yours", f"{said}. Stops: {told}; {locks}."


def _rows(report: DesignReport) -> Iterator[tuple[str, str, str]]:
    """At most ten numbers over the speeds in use."""
    judged = report.in_use
    if judged is None:
        point, limits = max(report.limits, key=lambda one: one[1].ms_bound)
        yield "Least Ms of any linear controller", ms_down(limits.ms_bound), f"{point.rail}, {point.speed_kmh:g} km/h"
        return
    yield from worst_rows(judged)
    for stop in report.longest_stops:
        where = "; ".join(f"{one.law}, {one.load}" for one in report.stops if one.rail is stop.rail and one.locks)
        locks = f"locks ({where})" if where else "no lock"
        yield (
            f"Stop, {stop.rail}, {report.envelope.initial_speed:g} to 5 km/h",
            _distance(stop),
            f"{_stop_words(stop)}; {locks}",
        )
    if report.stops:
        slipped = max((*report.stops, *report.tolerance_stops), key=lambda stop: stop.max_slip)
        locked = sum(stop.locks for stop in report.tolerance_stops)
        where = ", ".join(filter(None, (slipped.law, slipped.rail, slipped.load, slipped.brake)))
        of = f"; in {len(report.tolerance_stops)} stops with the actuator's tolerances, one noise seed each, "
        locks = of + (counted(locked, "lock") if locked else "no lock") if report.tolerance_stops else ""
        yield "Highest slip", above(slipped.max_slip), f"{where}: stop of {_distance(slipped)}{locks}"
    if report.usable:
        seeds = len(report.stops[0].runs)
        told = f"all laws, loads and rails, {seeds} runs each; ranked first of {len(report.selection.choices)} designs"
        yield "Mean stop", f"{short(report.trials[0].distance())} m", told
    shortest = min(report.trials, key=Trial.distance)
    if shortest is not report.trials[0]:
        yield "Shortest mean", f"{short(shortest.distance())} m", _shortest(shortest)


def _shortest(trial: Trial) -> str:
    """What a design that stops shorter than the one taken is, its longest stops, and what it lacks."""
    choice = trial.choice
    slip = "" if choice.structure == SEEKING else f" at {100 * choice.reference_factor:g} % of the reference slip"
    told = ", ".join(f"{stop.rail} up to {short(stop.distance)} m" for stop in longest(trial.stops))
    robust = None if trial.judgement is None else trial.judgement.robust_from_kmh
    told += "; robust at no speed" if robust is None else f"; robust above {robust:g} km/h"
    for what, name in (
        ("a wheel locks", "locks"),
        ("slip over 0.5 in a stop", "slides"),
        ("the wheel oscillates", "swings"),
    ):
        told += f"; {what}" if any(getattr(stop, name) for stop in trial.stops) else ""
    return f"{_kind(choice)}{slip}: {told}"


def _kind(choice: StructureChoice) -> str:
    """Its structure, of a PI-lead with the lead and its filter."""
    if choice.structure != "pi-lead":
        return SEEKING if choice.structure == SEEKING else "PI"
    lead = None if choice.design is None else getattr(choice.design.controller, "lead", None)
    return "PI-lead" if lead is None else f"PI-lead {lead:.3g}/{choice.lead_filter:.3g} s"


def _distance(stop: Stop) -> str:
    return f"{short(stop.distance)} m" if stop.run.stopped else "no stop"


def _over(stop: Stop) -> str:
    """How far over what could be had, or the bound; ends before what follows."""
    if stop.bound is None or math.isnan(stop.over_bound):
        return ""
    if stop.attainable is None or math.isinf(stop.attainable.braking_distance):
        return f"{100 * stop.over_bound:.0f} % over the bound of {short(stop.bound.braking_distance)} m; "
    had = stop.attainable.braking_distance
    return f"{100 * (stop.distance / had - 1):.0f} % over the attainable {short(had)} m; "


def _held(stop: Stop) -> str:
    """The slip held, and of what, where the controller does not find its slip."""
    return short(stop.held, 2) + ("" if stop.own_slip else f" of {short(stop.reference)}")


def _stop_words(stop: Stop) -> str:
    """How far over the bound, and which slip."""
    highest = f"highest {above(stop.max_slip)} in {counted(len(stop.runs), 'run')}"
    return f"{stop.law}, {stop.load}: {_over(stop)}slip held {_held(stop)}, {highest}"


def _pictures(report: DesignReport) -> Iterator[Picture]:
    judged = report.judgement
    if judged is None or report.control is None:
        return
    yield Picture(
        "map",
        "Worst Ms over speed and load, of the sampled loop where that is larger; black from 8 up. Slip control ends "
        "below a dashed line.",
        f"Worst Ms in cells over speed and load, at the operating points and with tolerances: {judged.verdict_line}",
    )
    yield Picture(
        "loop",
        "The design at its worst points: Bode and Nyquist, in continuous time, the dead time exact.",
        "Magnitude, phase and Nyquist curve of the design at its worst operating point and its worst point "
        f"with tolerances: {'; '.join(one.label for one in report.worst_loops)}",
    )
    if report.stops:
        told = "; ".join(f"{stop.rail}: {_distance(stop)}, {_stop_words(stop)}" for stop in report.longest_stops)
        caption = (
            "The longest stop on each rail with the design, of all laws, loads and seeds; slip below 0, a "
            "wheel faster than the train, is not shown."
        )
        yield Picture("stops", caption, f"Speed, slip and torque over time. {told}")


# --- sections -------------------------------------------------------------------------------------------------------


def design_sections(report: DesignReport, again: str = "") -> list[Section]:
    """What stands behind the first page and can be left unread; what there is nothing to say of is left out.

    `again` says how a stop is repeated.
    """
    made = (
        _envelope(report),
        _candidates(report),
        _rivals(report),
        _stops(report, again),
        _gains(report),
        _responses(report),
        _limits(report),
        _adhesion(report),
        _plant(report),
        _sliding(report),
        no_lock_section(report.released),
        Section("paper", "The paper", (Paragraph(_PAPER),)) if is_published(report.vehicle) else None,
    )
    return [section for section in made if section is not None]


def _envelope(report: DesignReport) -> Section:
    judged, used, car = report.judgement, report.in_use, report.vehicle
    blocks: list[Block] = [Facts([("Envelope", envelope_words(report.judged_envelope))])]
    if judged is not None and used is not None:
        worst = [("Operating points", used.worst)]
        worst += [] if used.nominal else [("With tolerances", used.worst_with_tolerances)]
        rows = []
        for name, one in worst:
            found = one.margins
            margins = (NONE, NONE) if found is None else (below(found.phase_deg), below(found.delay_s))
            run = () if one.as_run is None else (ms_text(one.run_ms), one.run_case.words)
            rows.append((name, ms_text(one.ms), *margins, one.case.words, *run))
        axes = [
            (
                _AXES.get(axis, axis),
                f"{value:{'' if isinstance(value, str) else 'g'}}",
                f"{100 * share:.3g}",
                ms_text(ms),
            )
            for axis, values in judged.by_axis().items()
            if len({(share, ms_text(ms)) for share, ms in values.values()}) > 1
            for value, (share, ms) in sorted(values.items())
        ]
        head = ("Axis", "Value", "Stable, %", "Worst Ms of these")
        worst_head = ("", "Ms", "Phase, deg", "Delay, s", "Case", "Ms, sampled", "Its case")[: len(rows[0])]
        lowest = f"{min(used.envelope.speeds):g} km/h"
        blocks += [
            Paragraph(f"Verdict over the whole envelope: {minus(judged.verdict_line)}."),
            Table(
                worst_head,
                rows,
                caption=f"Points of worst Ms from {lowest} up, with the margins there, in continuous time.",
            ),
            Table(
                head,
                axes,
                caption="What costs margin over the whole envelope; continuous time, axes without effect omitted.",
            ),
        ]
    told = report.envelope.knife_edges() if judged is None else (*judged.points.skipped, *judged.slips_told)
    if "loaded" in report.envelope.loads and car.wheel_load_loaded == car.wheel_load and car.mass_loaded > car.mass:
        load = f"the wheel load stays {short(car.wheel_load)} N: the vehicle has no other"
        told = (*told, f"Loaded, the mass is {short(car.mass_loaded)} kg, and {load}")
    blocks += [Paragraph(f"{text[0].upper()}{minus(text[1:])}.") for text in told[:_MOST_TOLD]]
    return Section("envelope", "Envelope and worst cases", tuple(blocks))


def _candidates(report: DesignReport) -> Section:
    rows: list[tuple[str, ...]] = []
    choices, seeking = report.selection.choices, report.seeking
    if seeking is not None and all(one.structure != SEEKING for one in choices):
        choices = (*choices, seeking.choice)
    for choice in choices:
        kind, slip = _kind(choice), f"{100 * choice.reference_factor:g}"
        if choice.design is None:
            rows.append((kind, slip, *(NONE,) * 7, choice.reason))
            continue
        judged, own, trial = choice.design.judgement, choice.design.controller, report.trial_of(choice)
        told = (short(own.kp), short(own.ki)) if isinstance(own, PI) else (NONE, NONE)
        cells = (*told, _speed(judged.usable_from_kmh), _speed(judged.robust_from_kmh))
        ran = (NONE, NONE) if trial is None else (_speed(_used_from(trial)), short(trial.distance(), 3))
        needs = f"{short(choice.reach_s, 2)} s of a {short(choice.stop_s, 2)} s stop"
        seeks = choice.structure == SEEKING
        reaches = "finds its own" if seeks else "yes" if choice.reaches else f"no: needs {needs}"
        rows.append((kind, NONE if seeks else slip, *cells, worst_cells(judged.worst)[1], *ran, reaches))
    head = (
        "Structure", "Slip, % of reference", "kp, N·m/(m/s)", "ki, N·m/m", "Stable from, km/h", "Robust from, km/h",
        "Worst Ms where stable", "Used from, km/h", "Mean stop, m", "Reaches its slip",
    )  # fmt: skip
    text = (
        f"The designs most robust (Ms ≤ {ROBUST_MS:g}, stable with every tolerance, from the lowest speed up) and the "
        f"seeking controller ran in the same stops. The order: {_RANKED}."
    )
    shown = Table(head, rows, caption="What was tried.", wide=True)
    return Section("candidates", "Candidates", (Paragraph(text), shown))


def _rivals(report: DesignReport) -> Section | None:
    if not report.rivals:
        return None
    taken = [Rival("recommended", report.judgement, report.stops)] if report.judgement is not None else []
    first = report.rivals[0].stops[0]
    rows = []
    for one in (*taken, *report.rivals):
        distances = " / ".join(
            f"{_distance(stop)} {stop.rail}{', locks' if stop.locks else ''}"
            for stop in one.stops
            if (stop.law, stop.load) == (first.law, first.load)
        )
        told = ("not judged: no margins", *(NONE,) * 3)
        if (judged := one.judgement) is not None:
            worst = (worst_cells(judged.worst)[1], worst_cells(judged.worst_with_tolerances)[1])
            told = (judged.verdict, _speed(judged.usable_from_kmh), *worst)
        rows.append((one.name, *told, distances))
    head = (
        "Controller", "Over the whole envelope", "Stable from, km/h", "Worst Ms where stable", "With tolerances",
        f"Longest stops, {first.law}, {first.load}",
    )  # fmt: skip
    return Section("given", "Your controller beside it", (Table(head, rows, caption="Judged and run alike."),))


def _stops(report: DesignReport, again: str = "") -> Section | None:
    shown = [_stop_table(report.stops, "Stops.")] if report.stops else []
    if report.seeking is not None and report.seeking.stops is not report.stops:
        caption = f"The seeking controller (--controller seeking) in {'the same' if shown else 'its'} stops."
        shown.append(_stop_table(report.seeking.stops, caption))
    if not shown:
        return None
    ran = report.stops or report.trials[0].stops
    torques = sorted({stop.brake_torque for stop in ran if math.isfinite(stop.brake_torque)})
    brake = f"a brake of {listed(f'{short(one)} N·m' for one in torques)}" if torques else "a brake"
    text = (
        f"Stops from {report.envelope.initial_speed:g} to 5 km/h, {len(ran[0].runs)} noise seeds each. No "
        f"controller stops before the bound, that of {brake} which is at the peak of adhesion "
        "at once. Attainable is a stop in which the slip builds up too, without noise, by a controller that "
        "knows the rail. Slip held is the median over the second half of the time under control, in the longest stop; "
        f"highest slip is that of all seeds. {_elsewhere(report)}{again if report.stops else ''}"
    )
    return Section("stops", "Braking runs", (Paragraph(text), *_limits_of_stops(report), *shown, *_rolling(report)))


def _limits_of_stops(report: DesignReport) -> Iterator[Block]:
    """How the recommended design runs."""
    control = report.control
    if control is None:
        return
    told = [("Limits", f"{short(max(control.least_torque, 0.0))} to {short(control.largest_torque)} N·m")]
    if isinstance(control, LinearControl):
        told += [
            ("Starts with", f"{short(control.initial_torque)} N·m"),
            ("Anti-windup", f"back-calculation, {short(control.tracking_time or 0.0)} s"),
        ]
    else:
        told.append(("Starts with", "up to the largest torque"))
    below_speed = f"no slip control below {short(control.controlled_from / KMH)} km/h: {control.handed_over()}"
    yield Facts([*told, ("Hand-over", below_speed if control.controlled_from > 0 else "none")])


def _elsewhere(report: DesignReport) -> str:
    """Where a stop holds less or more slip than was judged, and Ms there; ends before what follows."""
    told = ""
    for one in report.held_elsewhere:
        slips = listed(dict.fromkeys(short(slip, 2) for slip in one.slips))
        told += (
            f"On {one.law}, {one.rail}, the runs held slip {slips}, outside the envelope: Ms there is at most "
            f"{ms_text(one.ms)}. "
        )
    return told


def _stop_table(stops: Iterable[Stop], caption: str) -> Table:
    rows = []
    for stop in stops:
        distances = [run.braking_distance for run in stop.runs]
        stopped = all(run.stopped for run in stop.runs)
        spread = f"{short(min(distances))} to {short(max(distances))}" if stopped else "no stop"
        bound, had = (NONE if one is None else short(one.braking_distance) for one in (stop.bound, stop.attainable))
        locks = "yes" if stop.locks else "no"
        rows.append((stop.law, stop.load, str(stop.rail), spread, bound, had, above(stop.max_slip), _held(stop), locks))
    head = ("Law", "Load", "Rail", "Distance, m", "Bound, m", "Attainable, m", "Highest slip", "Slip held", "Locks")
    return Table(head, rows, caption=caption, wide=True)


def _rolling(report: DesignReport) -> Iterator[Paragraph]:
    """Why the wheel oscillates with a dynamic law."""
    for law in dict.fromkeys(one.law for one in report.rolling):
        loops = [one for one in report.rolling if one.law == law]
        where = ", ".join(f"{one.rail} {one.load}: {one.frequency / (2 * math.pi):.2g} Hz" for one in loops)
        unstable = sum(not one.stable for one in loops)
        yield Paragraph(
            f"With {law} the contact of a rolling wheel is a spring, with hardly any damping of its own ({where}). "
            f"About free rolling the loop is unstable in {unstable} of these {len(loops)} cases, and drives the swing "
            "until the law's friction bounds it."
        )


def _gains(report: DesignReport) -> Section | None:
    if report.gains is None:
        return None
    kp, ki = report.gains.chosen
    alt = f"Contours of the worst Ms over kp and ki on logarithmic axes; the design at kp {short(kp)}, ki {short(ki)}."
    text = "Worst Ms around the recommended gains, lead kept, at the operating points of the lowest and highest speed."
    return Section("gains", "Gains", (Picture("gains", text, alt),))


def _responses(report: DesignReport) -> Section | None:
    if report.responses is None:
        return None
    text = "Linear responses of the design at its worst operating point."
    alt = "Slip velocity and commanded torque over ten seconds after a step of the reference and a step of the load."
    return Section("responses", "Time responses", (Picture("responses", text, alt),))


def _limits(report: DesignReport) -> Section:
    rows = []
    for point, limits in report.limits:
        where = (str(point.rail), short(point.vehicle.mass), f"{point.speed_kmh:g}", short(limits.unstable_pole, 3))
        structures = (_structure(limits.pi), _structure(limits.pi_lead))
        rows.append((*where, ms_down(limits.ms_bound), *structures, above(limits.longest_dead_time(ROBUST_MS))))
    head = (
        "Rail", "Mass, kg", "Speed, km/h", "Unstable pole, 1/s", "Any linear", "Any PI", "Any PI-lead",
        f"Longest dead time for Ms ≤ {ROBUST_MS:g}, s",
    )  # fmt: skip
    text = (
        "Least Ms that any controller can have, theorems, at the hardest operating point of each rail and load. "
        "Interpolation at the unstable pole: [Astrom2021] 14.4, [Sarason1967]."
    )
    return Section("limits", "What no controller beats", (Paragraph(text), Table(head, rows, caption="Least Ms.")))


def _structure(limit: StructureLimit | None) -> str:
    if limit is None:
        return NONE
    return ms_down(limit.ms_bound) if limit.feasible else "none holds"


def _adhesion(report: DesignReport) -> Section:
    rows = []
    for curve in report.curves:
        point = curve.point
        peak = short(curve.peak.slip) if curve.peak.slip > curve.slip[1] else "0 (falls)"
        held = (short(point.slip), short(point.adhesion_coefficient))
        where = (point.adhesion, str(point.rail), f"{point.speed_kmh:g}")
        rows.append((*where, short(curve.peak.coefficient), peak, *held))
    head = ("Law", "Rail", "Speed, km/h", "Peak μ", "at slip", "Slip judged at", "μ there")
    laws = listed(dict.fromkeys(curve.point.adhesion for curve in report.curves))
    alt = f"Steady adhesion coefficient over slip of {laws}, a panel a rail; circles where slip is judged."
    picture = Picture("adhesion", "Steady adhesion over the slip ratio.", alt)
    peaks = Table(head, rows, caption="Peaks, and the slip judged at.")
    return Section("adhesion", "Adhesion", (picture, peaks, Facts(law_facts(curve.point for curve in report.curves))))


def _plant(report: DesignReport) -> Section:
    vehicle = report.vehicle
    noted = [*vehicle.notes, *(f"To be checked: {one}" for one in doubts(vehicle))]
    points = dict.fromkeys(curve.point for curve in report.curves)
    if report.in_use is not None:
        points = {report.in_use.worst.point: None} | points
    rows = []
    for point in points:
        plant = linearize(point)
        roots = [minus(roots_text(values)) for values in (plant.poles, plant.zeros)]
        shown = [text if text == "none" else f"{text} 1/s" for text in roots]
        where = f"{point.adhesion}, {point.rail}, {point.speed_kmh:g} km/h, {short(point.vehicle.mass)} kg"
        rows.append((where, short(point.brake_torque), *shown))
    head = ("Operating point", "Torque, N·m", "Poles", "Zeros, torque to slip velocity")
    blocks: tuple[Block, ...] = (
        Facts([row for row in vehicle_facts(vehicle) if row[0] != "Note"]),
        *(Paragraph(text) for text in noted),
        Table(head, rows, caption="The wheel linearised at constant slip, without the brake."),
    )
    return Section("plant", "Vehicle and plant", blocks)


def _sliding(report: DesignReport) -> Section:
    found = report.sliding.found
    if found is None:
        return Section("sliding", "Sliding mode", (Paragraph(f"Not decided: {report.sliding.reason}."),))
    conditions = found.conditions
    met = sum(bool(one.holds) for one in conditions)
    text = (
        f"The predictive sliding-mode law meets {met} of the {len(conditions)} conditions that are asked over a box of "
        "speed, slip and load, on the static curve of the published bristle model. railslip verify --law predictive "
        "has the box and the evidence."
    )
    rows = [
        (typeset(one.name), "not decided" if one.holds is None else one.how or "" if one.holds else "not met")
        for one in conditions
    ]
    return Section(
        "sliding", "Sliding mode", (Paragraph(text), Table(("Condition", "Verdict"), rows, caption="Its conditions."))
    )


def _speed(speed: float | None) -> str:
    return "never" if speed is None else f"{speed:g}"


# --- text and JSON --------------------------------------------------------------------------------------------------


def design_report_text(report: DesignReport, first: FirstPage, rest: str) -> str:
    """The first page, and where the rest is and how a stop is repeated."""
    file = f"   {first.file}" if first.file else ""
    parts: list[RenderableType] = [
        heading(f"{first.title}   railslip_ctrl {__version__}, {report.date.isoformat()}"),
        Facts([(first.headline, first.subject + file), *first.lines]),
        Table(first.head, first.rows, words=(2,)),
        rest,
    ]
    return render(parts)


def _gains_json(choice: StructureChoice) -> dict[str, float | None]:
    """kp and ki of a candidate; null where it has none."""
    own = None if choice.design is None else choice.design.controller
    return {"kp_si": own.kp, "ki_si": own.ki} if isinstance(own, PI) else {"kp_si": None, "ki_si": None}


def design_report_json(report: DesignReport, files: Iterable[str] = ()) -> dict[str, Any]:
    """The recommendation, the envelope, the candidates, stops and limits; SI but speeds in km/h."""
    judgement = report.judgement
    return {
        "version": __version__,
        "date": report.date.isoformat(),
        "vehicle": plain(report.vehicle),
        "recommended": _recommended(report),
        "envelope": report.judged_envelope.table(),
        "skipped": [] if judgement is None else list(judgement.points.skipped),
        "knife_edges": list(report.envelope.knife_edges() if judgement is None else judgement.slips_told),
        "candidates": [
            {
                **exported(choice, "structure", "reference_factor", "reason"),
                **_gains_json(choice),
                **_from_speeds(None if choice.design is None else choice.design.judgement, report.trial_of(choice)),
            }
            for choice in report.selection.choices
        ],
        "stops": [_stop_json(stop) for stop in report.stops],
        "seeking": [_stop_json(stop) for stop in (() if report.seeking is None else report.seeking.stops)],
        "given": [
            {
                "name": one.name,
                **({"verdict": None, "reason": one.reason} if one.judgement is None else one.judgement.table()),
                **_from_speeds(one.judgement, one),
                "stops": [_stop_json(stop) for stop in one.stops],
            }
            for one in report.rivals
        ],
        "faster_brake": report.faster and exported(report.faster, dead_time_s="dead_time", lag_s="lag"),
        "limits": [
            {
                **exported(point, "rail", "speed_kmh", mass_kg="vehicle.mass"),
                **exported(limits, ms_lower_bound="ms_bound", unstable_pole_per_s="unstable_pole"),
            }
            for point, limits in report.limits
        ],
        "sliding": {
            "reason": report.sliding.reason,
            "predictive": [
                exported(one, "name", "holds", "how")
                for one in (() if report.sliding.found is None else report.sliding.found.conditions)
            ],
        },
        "no_lock": [
            {
                **exported(one.stop, "load", "rail", adhesion="law"),
                **exported(one.found, "share", "outside_kmh"),
                "reason": one.reason,
            }
            for one in report.released
        ],
        "seconds": plain(report.seconds),
        "files": list(files),
    }


def _recommended(report: DesignReport) -> dict[str, Any] | None:
    judgement = report.judgement
    if report.control is None or judgement is None:
        return None
    said = (report.in_use or judgement).table()
    return {
        "controller": tomllib.loads(report.control.toml),
        "nominal": judgement.nominal,
        **_from_speeds(judgement, report),
        "worst": said["worst"],
        "worst_with_tolerances": said["worst_with_tolerances"],
        "reference_factor": report.best.reference_factor if report.best is not None else None,
        "map": exported(judgement.map, "speeds_kmh", "loads", "operating", "with_tolerances"),
    }


def _from_speeds(judgement: Judgement | None, ran: DesignReport | Trial | Rival | None) -> dict[str, Any]:
    """The verdict, and the speeds, km/h, from which up a controller is stable, robust, and to be used: robust, slip
    controlled, and no wheel slides in its stops."""
    named = {"stable_from_kmh": "usable_from_kmh"}
    return {**exported(judgement, "verdict", "robust_from_kmh", **named), "usable_from_kmh": _used_from(ran)}


def _stop_json(stop: Stop) -> dict[str, Any]:
    """A stop: numbers of the seed with the longest, and the distances and highest slips of all seeds."""
    of_stop = {"adhesion": "law", "held_slip": "held"}
    of_reference = {"reference_slip": "reference", "reference_reached": "reached"}
    of_run = {"braking_time_s": "braking_time", "braking_distance_m": "braking_distance"}
    return {
        **exported(stop, "controller", "load", "rail", "locks", **of_stop),
        **exported(None if stop.own_slip else stop, **of_reference),
        **exported(stop.run, "seed", "stopped", "max_slip", "locked_fraction", **of_run),
        **exported(stop.bound, bound_m="braking_distance"),
        **exported(stop.attainable, attainable_m="braking_distance"),
        "seeds": [run.seed for run in stop.runs],
        "distances_m": [plain(run.braking_distance) for run in stop.runs],
        "max_slips": [plain(run.max_slip) for run in stop.runs],
    }
