"""Content of the design report of a vehicle: first page, further sections, and the first page as text."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np
from rich.console import RenderableType

from railslip_ctrl import __version__
from railslip_ctrl.controllers.base import Controller
from railslip_ctrl.controllers.linear import LinearControl
from railslip_ctrl.controllers.seeking import MOST_WEAK, WEAK, Seeking
from railslip_ctrl.core.units import KMH, ms_down
from railslip_ctrl.design.catalogue import is_published
from railslip_ctrl.design.envelope_tuning import StructureChoice
from railslip_ctrl.design.limits import StructureLimit
from railslip_ctrl.design.specification import ROBUST_MS
from railslip_ctrl.model.linearization import linearize
from railslip_ctrl.model.vehicle import vehicle_warnings
from railslip_ctrl.report.candidates import FASTER, NEARLY_UNSTABLE, NOT_RUN, SEEKING, TIE, Trial
from railslip_ctrl.report.recommendation import DesignReport, Rival, longest
from railslip_ctrl.report.stops import CHANGES, ERRORS, SLIDING, TEETH, Stop, stopping_distance
from railslip_ctrl.simulation.population import SPEED_NOISE

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
    heading,
    listed,
    minus,
    ms_text,
    render,
    roots_text,
    short,
)
from .page import typeset
from .text import envelope_text, law_facts, no_lock_section, vehicle_facts, worst_cells, worst_rows

RECOMMENDED = "recommended.toml"  #: file with the recommended controller

_AXES = {
    "speed_kmh": "speed, km/h",
    "slip / reference": "slip factor",
    "radius_m": "wheel radius, m",
    "dead_time_s": "dead time, s",
    "lag_s": "lag, s",
}
MS_TO_WARN = 10.0
"""Worst Ms with tolerances above which the first page warns; a gain error of 10 % may then cause instability."""

_RANKED = {
    "distance": f"shortest mean stop (within {100 * TIE:g} %: smallest Ms)",
    "robustness": f"smallest Ms (within {100 * TIE:g} %: shortest mean stop)",
}
_PAPER = "railslip reproduce --out DIR shows the errata of [Park2008] and the units in which its numbers hold."
_MOST_WORDS = 60  # largest number of words of headline, reasons, risks and actions, which can be read in a minute
_MOST_NOTES = 8  # largest number of notes on skipped points and on reference slips near the peak


def first_page(report: DesignReport) -> FirstPage:
    """First page of the report, which can be read in a minute: recommendation, reasons and main numbers."""
    headline, subject = _headline(report), _design_text(report)
    after = tuple(_not_judged(report))
    phrase = " ".join([headline, subject, *(text for _, text in after)])
    texts = _within(_MOST_WORDS - len(phrase.split()), _why(report), _risks(report), _steps(report))
    why, risk, to_do = map(" ".join, texts)
    return FirstPage(
        title=f"Wheel-slip control design: {report.vehicle.name}",
        headline=headline,
        subject=subject,
        file=RECOMMENDED if report.control is not None else "",
        lines=(
            ("Why", why),
            *_decided(report),
            *after,
            *([("Risk", risk)] if risk else []),
            ("To do", to_do or f"Load {RECOMMENDED} and confirm the design on the rig."),
            *_yours(report),
        ),
        head=("", "", "Case: adhesion law, rail, load"),
        rows=tuple((name, value, minus(where)) for name, value, where in _rows(report)),
        pictures=tuple(_pictures(report)),
    )


def _headline(report: DesignReport) -> str:
    if report.above_kmh is None:
        return "NO CONTROLLER QUALIFIES; the least bad:"
    at = " at the operating points" if report.nominal else ""
    top = max(report.envelope.speeds)
    to = "" if top >= report.envelope.initial_speed else f" TO {top:g} km/h"
    if report.hands_over:
        from_kmh = f"{used_from(report):g}"
        return f"USE FROM {from_kmh}{to}{at}" if to else f"USE ABOVE {from_kmh} km/h{at}"
    return f"USE{' UP' if to else ''}{to}{at}"


def used_from(ran: DesignReport | Trial | Rival | None) -> float | None:
    """Speed, km/h, above which a controller qualifies and controls slip; None if it does not qualify or did not run."""
    if ran is None or ran.above_kmh is None:
        return None
    if ran.judgement is None:
        return ran.above_kmh
    return max(ran.above_kmh, round(ran.judgement.hand_over_kmh, 9))


def _design_text(report: DesignReport) -> str:
    if report.control is None:
        return "any PI or PI-lead"
    held = report.control.reference if report.control.follows_reference else None
    if held is None:
        return report.control.headline()
    slips = [f"{short(held.on(rail))} {rail}" for rail in report.envelope.rails]
    return f"{report.control.headline()}; slip {', '.join(slips)}"


def _why(report: DesignReport) -> Iterator[str]:
    if not report.trials:
        return
    best, judged = report.trials[0], report.in_use
    if report.above_kmh is None:
        yield f"{best.reason[0].upper()}{best.reason[1:]}."
        return
    every = len(best.stops) + len(best.harder)
    if judged is None:
        yield f"No wheel locks in {every} stops. The controller is not linear and has no margins."
        return
    phrase = f"Ms ≤ 2 at all {int(judged.points.operating.sum())} operating points"
    if not report.nominal:
        phrase += f", stable at all {len(judged.points)} with tolerances"
    yield f"{phrase}."
    factor = best.choice.reference_factor
    if factor < 1.0:
        yield f"The controller holds {100 * factor:g} % of the reference slip."


def _decided(report: DesignReport) -> Iterator[tuple[str, str]]:
    if not report.trials:
        return
    best, good = report.trials[0], report.qualified
    if not good:
        peer = report.peer
        locks = f"{best.locked} of {len(best.stops) + len(best.harder)}, mean stop {_metres(best)}"
        phrase = f"fewest stops with a locked wheel: {locks}"
        if peer is not None and peer is not best:
            runs = len(peer.stops) + len(peer.harder)
            phrase += f"; slide protection: {peer.locked} of {runs}, mean stop {_metres(peer)}"
        remedy, tried = report.remedy, f"{100 * FASTER[-1]:g} % of dead time and lag"
        yield "Choice", f"{phrase}."
        helps = f"none of the faster brakes helps, down to {tried}"
        if remedy is not None:
            kind, mean = _kind(remedy.trial.choice), _metres(remedy.trial)
            helps = f"a brake with {remedy.description}: {kind} then qualifies, mean stop {mean}"
        yield "Remedy", f"{helps}. A smaller slip or a higher hand-over speed does not help."
    else:
        of = f"{len(good)} of {len(report.trials)} candidates qualify"
        yield "Choice", f"{of}; {_RANKED[report.prefer]}: {_short(best)}.{_needs_the_rail(report)}"
        if len(good) > 1:
            other = good[1]
            cost = other.distance() / best.distance() - 1
            tie = ", which counts as equal" if report.prefer == "distance" and abs(cost) <= TIE else ""
            excess = minus(f"{100 * cost:+.1f}")
            yield "Runner-up", f"{_kind(other.choice)}{_share(other)}: {_short(other)}; distance {excess} %{tie}."
        else:
            rest = "; ".join(f"{_kind(item.choice)} ({item.reason})" for item in report.trials[1:3])
            yield "Runner-up", f"no other candidate qualifies: {rest}."
    yield "Stops", _which(report, "")


def _needs_the_rail(report: DesignReport) -> str:
    held = report.control.reference if report.control is not None and report.control.follows_reference else None
    several = held is not None and len({held.on(rail) for rail in report.envelope.rails}) > 1
    return " It must know whether the rail is dry or wet." if several else ""


def _short(trial: Trial) -> str:
    tolerant = "" if trial.judgement is None or trial.judgement.nominal else " with tolerances"
    ms = "no margins" if trial.judgement is None else f"Ms{tolerant} {ms_text(trial.worst_ms)}"
    start = used_from(trial)
    from_speed = f", usable from {short(start)} km/h" if start else ""
    return f"mean stop {_metres(trial)}, {ms}, air {trial.air:.2g} brake fillings{from_speed}"


def _metres(trial: Trial) -> str:
    if math.isfinite(trial.distance()):
        return f"{short(trial.distance())} m"
    given = trial.distance_as_given()
    return "infinite" if math.isinf(given) else f"{short(given)} m nominal, infinite in the harder stops"


def _share(trial: Trial) -> str:
    factor = trial.choice.reference_factor
    return "" if factor == 1.0 else f" at {100 * factor:g} % of the reference slip"


def _which(report: DesignReport, sizes: str | None = None) -> str:
    given, harder = report.stops, report.harder_stops
    laws = listed(dict.fromkeys(stop.law for stop in given))
    phrase = f"{len(given)} nominal, {len(given[0].runs)} noise seeds each"
    wrong = [stop for stop in harder if stop.errors != CHANGES]
    if wrong:
        ends = (("dead time", report.envelope.dead_time), ("lag", report.envelope.lag), *ERRORS.items())
        spans = (f"{name} {100 * (min(axis) - 1):+.3g} to {100 * (max(axis) - 1):+.3g} %" for name, axis in ends)
        own = f" ({', '.join(spans)}, noise {SPEED_NOISE:g} m/s, {TEETH:g} teeth)" if sizes is None else sizes
        phrase += f"; {len(wrong)} with errors of sensors and brake{own}"
    changing = len(harder) - len(wrong)
    phrase += f"; {changing} on a rail that {CHANGES}" if changing else ""
    return minus(f"{phrase}; adhesion laws {laws}.")


def _within(most: int, *texts: Iterable[str]) -> list[list[str]]:
    """Keep the first sentence of each text, and further sentences up to `most` words in total."""
    sentences = [list(text) for text in texts]
    result = [text[:1] for text in sentences]
    most -= sum(len(item.split()) for text in result for item in text)
    for kept, text in zip(result, sentences, strict=True):
        for item in text[1:]:
            if len(item.split()) <= most:
                kept.append(item)
                most -= len(item.split())
    return result


def _not_judged(report: DesignReport) -> Iterator[tuple[str, str]]:
    top, begins = max(report.envelope.speeds), report.envelope.initial_speed
    if report.stops and begins > top:
        yield f"{top:g} to {begins:g} km/h", "not judged, although the stops begin here."
    if report.hands_over and report.control is not None:
        over, used = short(report.control.controlled_from / KMH), report.above_kmh or 0.0
        if used > float(over):
            yield f"{over} to {used:g} km/h", f"slip controlled, but {_between(report, float(over), used)}."
        yield (
            f"Below {over} km/h",
            f"no slip control{_on_weak_rails(report.control)}; holds {report.control.handed_over()}.",
        )


def _on_weak_rails(control: Controller) -> str:
    """Return the lower hand-over speed of the seeking controller on the weakest rails as text."""
    least = control.hand_over_speed / MOST_WEAK if isinstance(control, Seeking) else 0.0
    return f" (with mu below {WEAK / MOST_WEAK:.2g}: below {least / KMH:.2g} km/h)" if least else ""


def _between(report: DesignReport, over: float, used: float) -> str:
    assert report.judgement is not None, "only a design with margins reports these speeds"
    speeds, ms = report.judgement.points.speed_kmh, report.judgement.run_ms
    below_use = speeds < used * (1 - 1e-9)  # rounding of the conversion from m/s
    judged = (speeds > over * (1 - 1e-9)) & below_use
    if not judged.any():
        return "not judged"
    unstable = np.unique(speeds[judged & np.isinf(ms)]).tolist()
    where = (
        f"unstable{'' if report.nominal else ' with tolerances'} at {listed(f'{item:.3g}' for item in unstable)} km/h"
    )
    return where if unstable else "not robust"


def _risks(report: DesignReport) -> Iterator[str]:
    least = 0.0 if report.control is None else report.control.controlled_from
    every = (*report.stops, *report.harder_stops)
    worst = report.trials[0].worst_ms if report.trials else math.inf
    if report.usable and not report.nominal and MS_TO_WARN < worst < math.inf:
        yield f"With tolerances the loop is nearly unstable: Ms {ms_text(worst)}."
    below_use = [stop for stop in every if stop.locks and stop.locked_from <= least]
    if swinging := dict.fromkeys(stop.law for stop in report.stops if stop.swings):
        yield f"With adhesion law {' and '.join(swinging)} the wheel oscillates."
    if below_use:
        yield f"Below {short(least / KMH)} km/h a wheel locks in {len(below_use)} of {len(every)} stops."
    if not report.usable or report.nominal:
        return
    sliding = sum(stop.slides for stop in every)
    if sliding and not below_use:
        yield f"Slip exceeds {SLIDING:g} in {sliding} stop{'' if sliding == 1 else 's'}."


def _steps(report: DesignReport) -> Iterator[str]:
    seeks = report.control is not None and report.control.finds_slip
    slow = [str(stop.rail) for stop in report.longest_stops if not stop.reached and not stop.own_slip]
    over_kmh = 0.0 if report.control is None else report.control.controlled_from / KMH
    if report.hands_over and (report.above_kmh or 0.0) > over_kmh * (1 + 1e-9):  # rounding of m/s to km/h
        yield f"Use another protection below {report.above_kmh:g} km/h."
    if slow and report.usable:
        yield f"Expect long stops: slip stays below its reference ({', '.join(slow)})."
    if report.usable and any(stop.slides for stop in report.harder_stops):
        yield "Measure dead time, lag and torque gain; repeat the report."
    if not report.usable:
        yield "Change the brake or use another wheel protection; do not rely on this file."
    if not seeks and report.usable and report.judgement is not None and report.judgement.envelope.knife_edges():
        yield "The reference slip is near the adhesion peak; choose a smaller slip."


def _yours(report: DesignReport) -> Iterator[tuple[str, str]]:
    for item in report.rivals:
        phrase = "; ".join(f"{stop.rail} {_distance(stop)} ({_stop_text(stop)})" for stop in longest(item.stops))
        locks = "the wheel locks" if any(stop.locks for stop in item.stops) else "no lock"
        verdict = f"NOT JUDGED: {item.name} is {item.reason} and has no margins"
        if (judged := item.judgement) is not None:
            start, held = judged.usable_from_kmh, "stable" if judged.nominal else "stable with every tolerance"
            state = f"not {held} at the highest speed" if start is None else f"{held} from {start:g} km/h up"
            if judged.verdict_in_use is None:
                state = f"every speed is below its hand-over speed, {judged.hand_over_kmh:g} km/h"
            worst = worst_cells(judged.worst)
            ms = f"{worst[0]}: {worst[1]} at {worst[2]}" if judged.worst.margins else f"unstable at {worst[2]}"
            verdict = f"{judged.verdict.upper()}: {item.name} is {state}; {ms}"
        yield "Yours", f"{verdict}. Longest stops: {phrase}; {locks}."


def _rows(report: DesignReport) -> Iterator[tuple[str, str, str]]:
    judged = report.in_use
    if judged is None:
        point, limits = max(report.limits, key=lambda item: item[1].ms_bound)
        yield "Least Ms of any linear controller", ms_down(limits.ms_bound), f"{point.rail}, {point.speed_kmh:g} km/h"
    else:
        yield from worst_rows(judged)
    for stop in report.longest_stops:
        here = [item for item in (*report.stops, *report.harder_stops) if item.rail is stop.rail]
        least = 0.0 if report.control is None else report.control.controlled_from
        late, locked = sum(0 < item.locked_from <= least for item in here), sum(item.locks for item in here)
        locks = f"locks in {locked} of {len(here)} stops" if locked else f"no lock in {len(here)} stops"
        in_late = "" if late == locked else f"in {late} "
        locks += f", {in_late}only below {short(least / KMH)} km/h" if late else ""
        yield (
            f"Stop, {stop.rail}, {report.envelope.initial_speed:g} to 5 km/h",
            _distance(stop),
            f"{_stop_text(stop)}; {locks}",
        )
    if report.stops:
        slipped = max((*report.stops, *report.harder_stops), key=lambda stop: stop.max_slip)
        hard = "" if not slipped.errors else f"rail {CHANGES}" if slipped.errors == CHANGES else "with errors"
        where = ", ".join(filter(None, (slipped.law, slipped.rail, slipped.load, hard)))
        fastest = max(slipped.runs, key=lambda run: run.max_slip)
        yield "Highest slip", above(slipped.max_slip), f"{where}: stop of {short(stopping_distance(fastest))} m"
        best = report.trials[0]
        if wrong := [stop for stop in report.harder_stops if stop.errors and stop.errors != CHANGES]:
            far = max(wrong, key=lambda stop: stop.distance)
            yield (
                "Longest stop with errors",
                _distance(far),
                f"{far.law}, {far.rail}, {far.load}{_over_same(report, far)}",
            )
        phrase = f"{len(best.stops) + len(best.harder)} stops; nominal {short(best.distance_as_given())} m"
        yield "Mean stop", _metres(best), phrase + _over_attainable(best)


def _over_same(report: DesignReport, far: Stop) -> str:
    """Return the excess of a stop with errors over the attainable stop without errors, as text."""
    kind = far.law, far.rail, far.load
    best = next((item.attainable for item in report.stops if (item.law, item.rail, item.load) == kind), None)
    if best is None or not math.isfinite(far.distance / best.braking_distance):
        return ""
    return f": {100 * (far.distance / best.braking_distance - 1):.0f} % over the attainable"


def _over_attainable(trial: Trial) -> str:
    known = [stop for stop in trial.stops if stop.attainable and math.isfinite(stop.attainable.braking_distance)]
    if not known or any(not run.stopped for stop in known for run in stop.runs):
        return ""
    attainable = sum(stop.attainable.braking_distance for stop in known if stop.attainable)
    distance = sum(run.braking_distance for stop in known for run in stop.runs) / len(known[0].runs)
    return f", {100 * (distance / attainable - 1):.0f} % over the attainable stops"


def _kind(choice: StructureChoice) -> str:
    if choice.structure != "pi-lead":
        return "PI" if choice.structure == "pi" else choice.structure
    lead = None if choice.design is None else getattr(choice.design.controller, "lead", None)
    return "PI-lead" if lead is None else f"PI-lead {lead:.3g}/{choice.lead_filter:.3g} s"


def _distance(stop: Stop) -> str:
    return f"{short(stop.distance)} m" if stop.run.stopped else "no stop"


def _over(stop: Stop) -> str:
    if stop.bound is None or math.isnan(stop.over_bound):
        return ""
    if stop.attainable is None or math.isinf(stop.attainable.braking_distance):
        return f"{100 * stop.over_bound:.0f} % over the bound of {short(stop.bound.braking_distance)} m; "
    attainable = stop.attainable.braking_distance
    return f"{100 * (stop.distance / attainable - 1):.0f} % over the attainable {short(attainable)} m; "


def _slip(stop: Stop) -> str:
    return short(stop.settled_slip, 2) + ("" if stop.own_slip else f" (reference {short(stop.reference)})")


def _stop_text(stop: Stop) -> str:
    return f"{stop.law}, {stop.load}: {_over(stop)}slip held {_slip(stop)}, highest {above(stop.max_slip)}"


def _sampled_ms(report: DesignReport) -> str:
    assert report.in_use is not None, "only a judged design has these loops"
    worst = [report.in_use.worst] + ([] if report.in_use.nominal else [report.in_use.worst_with_tolerances])
    return " and ".join("the same" if math.isnan(item.run_ms) else ms_text(item.run_ms) for item in worst)


def _line_drawn(report: DesignReport) -> bool:
    assert report.judgement is not None, "only a judged design has a map"
    speeds, over = report.judgement.map.speeds_kmh, report.judgement.hand_over_kmh
    return bool(report.hands_over and speeds.min() < over <= speeds.max())


def _pictures(report: DesignReport) -> Iterator[Picture]:
    judged = report.judgement
    if judged is None or report.control is None or report.in_use is None:
        if report.stops:
            yield _stops_picture(report)
        return
    loops = "of the sampled loop" if judged.as_it_runs else "the larger of continuous and sampled loop"
    yield Picture(
        "map",
        f"Worst Ms over speed and load, {loops}; black: 8 or more."
        + (" Below the dashed line slip is not controlled." if _line_drawn(report) else ""),
        f"Worst Ms in cells over speed and load, at the operating points and with tolerances: {judged.verdict_line}",
    )
    yield Picture(
        "loop",
        "Bode and Nyquist diagrams of the design at its worst points, in continuous time with the exact dead time. "
        f"Ms of the sampled loop: {_sampled_ms(report)}.",
        "Magnitude, phase and Nyquist curve of the design at its worst operating point and its worst point "
        f"with tolerances: {'; '.join(item.label for item in report.worst_loops)}",
    )
    if report.stops:
        yield _stops_picture(report)


def _stops_picture(report: DesignReport) -> Picture:
    phrase = "; ".join(f"{stop.rail}: {_distance(stop)}, {_stop_text(stop)}" for stop in report.longest_stops)
    caption = (
        "The longest nominal stop on each rail, over all laws, loads and seeds. Slip below 0 (wheel faster than train) "
        "is not shown."
    )
    return Picture("stops", caption, f"Speed, slip and torque over time. {phrase}")


def design_sections(report: DesignReport, again: str = "") -> list[Section]:
    """Sections of the report after the first page; `again` is the sentence on how to repeat a stop."""
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
    blocks: list[Block] = [Facts([("Envelope", envelope_text(report.judged_envelope))])]
    if judged is not None and used is not None:
        worst = [("Operating points", used.worst)]
        worst += [] if used.nominal else [("With tolerances", used.worst_with_tolerances)]
        rows = []
        for name, item in worst:
            result = item.margins
            margins = (NONE, NONE) if result is None else (below(result.phase_deg), below(result.delay_s))
            run = () if item.as_run is None else (ms_text(item.run_ms), item.run_case.description)
            rows.append((name, ms_text(item.ms), *margins, item.case.description, *run))
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
        head = ("Axis", "Value", "Stable, %", "Worst Ms of stable loops")
        worst_head = ("", "Ms", "Phase, deg", "Delay, s", "Case", "Ms, sampled", "Case, sampled")[: len(rows[0])]
        lowest = f"{min(used.envelope.speeds):g} km/h"
        kind = "sampled loops" if judged.as_it_runs else "continuous-time loops"
        costs = Table(
            head,
            axes,
            caption=f"Effect of each axis over the whole envelope ({kind}); axes without effect are omitted.",
        )
        blocks += [
            Paragraph(f"Verdict over the whole envelope: {minus(judged.verdict_line)}."),
            Table(
                worst_head,
                rows,
                caption=f"Points of worst Ms from {lowest} up, with their margins in continuous time.",
            ),
            *([costs] if axes else []),
        ]
    notes = report.envelope.knife_edges() if judged is None else (*judged.points.skipped, *judged.slip_notes)
    if "loaded" in report.envelope.loads and car.wheel_load_loaded == car.wheel_load and car.mass_loaded > car.mass:
        load = f"the wheel load stays {short(car.wheel_load)} N, because the vehicle has no loaded wheel load"
        notes = (*notes, f"Loaded, the mass is {short(car.mass_loaded)} kg; {load}")
    begins, v0 = report.envelope.initial_speed, report.envelope.law_speed
    if begins != v0:
        notes = (
            f"Stops begin at {begins:g} km/h; published adhesion laws are those of v0 = {v0:g} km/h, extrapolated",
            *notes,
        )
    blocks += [Paragraph(f"{text[0].upper()}{minus(text[1:])}.") for text in notes[:_MOST_NOTES]]
    if len(notes) > _MOST_NOTES:
        blocks.append(Paragraph(f"{len(notes) - _MOST_NOTES} more notes: see skipped and knife_edges in report.json."))
    return Section("envelope", "Envelope and worst cases", tuple(blocks))


def _candidates(report: DesignReport) -> Section:
    text = (
        f"A candidate qualifies if it is robust above its hand-over speed (Ms ≤ {ROBUST_MS:g}, with every tolerance "
        f"Ms ≤ {NEARLY_UNSTABLE:g}) and no wheel locks above this speed in any of these stops: {_which(report)} A "
        "candidate without margins is judged by its stops alone. Designs that hold a reference slip are given the "
        f"rail condition. Ranking: {_RANKED[report.prefer]}. Air consumption (air) is the sum of all rises of the "
        "brake torque in a stop over the full brake torque."
    )
    ran = Table(
        ("Candidate", "Used from, km/h", "Mean stop, m", "Nominal, m", "Ms with tolerances", "Air", "Locks in"),
        [_ran_cells(trial, report.nominal) for trial in report.trials if trial.stops],
        caption="Candidates that ran, the best first: mean braking distance in all stops and in the nominal stops.",
        wide=True,
    )
    rows = [(*_choice_cells(item.choice), item.reason) for item in report.trials if item.reason]
    for choice in report.selection.choices:
        if not any(_same(choice, trial.choice) for trial in report.trials):
            rows.append((*_choice_cells(choice), choice.reason or "less robust than the designs that ran"))
    head = ("Candidate", "Stable from, km/h", "Robust from, km/h", "Worst Ms where stable", "Reason")
    rest = Table(head, rows, caption=f"Candidates that do not qualify, or are {NOT_RUN} because others are better.")
    return Section("candidates", "Candidates", (Paragraph(text), ran, *([rest] if rows else [])))


def _same(choice: StructureChoice, other: StructureChoice) -> bool:
    names = ("structure", "reference_factor", "lead_filter")
    return all(getattr(choice, name) == getattr(other, name) for name in names)


def _named(choice: StructureChoice) -> str:
    holds = choice.structure in ("pi", "pi-lead") or choice.reference_factor != 1.0
    return _kind(choice) + (f", {100 * choice.reference_factor:g} % of the reference slip" if holds else "")


def _choice_cells(choice: StructureChoice) -> tuple[str, ...]:
    if choice.design is None:
        return _named(choice), *(NONE,) * 3
    judged = choice.design.judgement
    speeds = (_speed(judged.usable_from_kmh), _speed(judged.robust_from_kmh))
    return _named(choice), *speeds, worst_cells(judged.worst)[1]


def _ran_cells(trial: Trial, nominal: bool) -> tuple[str, ...]:
    ms = NONE if trial.judgement is None else ms_text(trial.worst_ms)
    means = (trial.distance(), trial.distance_as_given())
    whole, given = ("no stop" if math.isinf(item) else short(item) for item in means)
    used = NONE if trial.above_kmh is None else _speed(used_from(trial))
    locks = f"{trial.locked} of {len(trial.stops) + len(trial.harder)}"
    return _named(trial.choice), used, whole if trial.harder or nominal else NONE, given, ms, f"{trial.air:.2f}", locks


def _rivals(report: DesignReport) -> Section | None:
    if not report.rivals:
        return None
    taken = [Rival("recommended", report.judgement, report.stops)] if report.control is not None else []
    first = report.rivals[0].stops[0]
    rows = []
    for item in (*taken, *report.rivals):
        distances = " / ".join(
            f"{_distance(stop)} {stop.rail}{', locks' if stop.locks else ''}"
            for stop in item.stops
            if (stop.law, stop.load) == (first.law, first.load)
        )
        cells: tuple[str, ...] = ("not judged: no margins", *(NONE,) * 3)
        if (judged := item.judgement) is not None:
            worst = (worst_cells(judged.worst)[1], worst_cells(judged.worst_with_tolerances)[1])
            cells = (judged.verdict, _speed(judged.usable_from_kmh), *worst)
        rows.append((item.name, *cells, distances))
    head = (
        "Controller", "Verdict over the envelope", "Stable from, km/h", "Worst Ms where stable", "With tolerances",
        f"Longest stops, {first.law}, {first.load}",
    )  # fmt: skip
    return Section("given", "Your controllers", (Table(head, rows, caption="Judged and run like the candidates."),))


def _stops(report: DesignReport, again: str = "") -> Section | None:
    shown = [_stop_table(report.stops, "Nominal stops.")] if report.stops else []
    for trial, name in ((report.seeking, SEEKING), (report.peer, "slide-protection")):
        if trial is not None and trial.stops and trial.stops is not report.stops:
            shown.append(_stop_table(trial.stops, f"The same stops with --controller {name}."))
    if report.harder_stops:
        shown.append(_harder_table(report.harder_stops))
    if not shown:
        return None
    ran = report.stops or report.trials[0].stops
    torques = sorted({stop.brake_torque for stop in ran if math.isfinite(stop.brake_torque)})
    brake = f"a brake of {listed(f'{short(item)} N·m' for item in torques)}" if torques else "a brake"
    text = (
        f"Stops from {report.envelope.initial_speed:g} to 5 km/h with {len(ran[0].runs)} noise seeds each. The bound "
        f"is the stop of {brake} with the highest adhesion at every moment after dead time and lag; no controller is "
        "better. The attainable stop includes the rise of the slip; its controller knows the rail, and there is no "
        "noise. Slip held is the median over the second half of the time under control in the longest stop. Highest "
        "slip is the highest of all seeds. "
        f"{_elsewhere(report)}{again if report.stops else ''}"
    )
    return Section("stops", "Braking runs", (Paragraph(text), *_limits_of_stops(report), *shown, *_rolling(report)))


def _limits_of_stops(report: DesignReport) -> Iterator[Block]:
    control = report.control
    if control is None:
        return
    facts = [("Torque limits", f"{short(max(control.least_torque, 0.0))} to {short(control.largest_torque)} N·m")]
    if isinstance(control, LinearControl):
        facts += [
            ("Initial torque", f"{short(control.initial_torque)} N·m"),
            ("Anti-windup", f"back-calculation, time constant {short(control.tracking_time or 0.0)} s"),
        ]
    else:
        facts.append(("Initial torque", "up to the largest torque"))
    below_speed = f"no slip control below {short(control.controlled_from / KMH)} km/h; holds {control.handed_over()}"
    yield Facts([*facts, ("Hand-over", below_speed if control.controlled_from > 0 else "none")])


def _elsewhere(report: DesignReport) -> str:
    phrase = ""
    for item in report.unjudged_slips:
        slips = listed(dict.fromkeys(short(slip, 2) for slip in item.slips))
        phrase += (
            f"The stops with {item.law} on {item.rail} rail hold slip {slips} outside the envelope; Ms at this slip is "
            f"at most {ms_text(item.ms)}. "
        )
    return phrase


def _stop_table(stops: Iterable[Stop], caption: str) -> Table:
    rows = []
    for stop in stops:
        distances = [run.braking_distance for run in stop.runs]
        stopped = all(run.stopped for run in stop.runs)
        spread = f"{short(min(distances))} to {short(max(distances))}" if stopped else "no stop"
        limits = [NONE if item is None else short(item.braking_distance) for item in (stop.bound, stop.attainable)]
        locks = "yes" if stop.locks else "no"
        rows.append((stop.law, stop.load, str(stop.rail), spread, *limits, above(stop.max_slip), _slip(stop), locks))
    head = ("Law", "Load", "Rail", "Distance, m", "Bound, m", "Attainable, m", "Highest slip", "Slip held", "Locks")
    return Table(head, rows, caption=caption, wide=True)


def _harder_table(stops: Iterable[Stop]) -> Table:
    rows = [
        (stop.law, stop.load, str(stop.rail), minus(stop.errors), _distance(stop), above(stop.max_slip),
         "yes" if stop.locks else "no")
        for stop in stops
    ]  # fmt: skip
    head = ("Law", "Load", "Rail", "Errors or change of rail", "Distance, m", "Highest slip", "Locks")
    return Table(head, rows, caption="Harder stops: with errors or on a changing rail, one noise seed each.", wide=True)


def _rolling(report: DesignReport) -> Iterator[Paragraph]:
    for law in dict.fromkeys(item.law for item in report.rolling):
        loops = [item for item in report.rolling if item.law == law]
        where = ", ".join(f"{item.rail} {item.load}: {item.frequency / (2 * math.pi):.2g} Hz" for item in loops)
        unstable = sum(not item.stable for item in loops)
        yield Paragraph(
            f"With {law} the contact of a rolling wheel acts as a spring with little damping ({where}). In {unstable} "
            f"of these {len(loops)} cases the loop is unstable near free rolling; the oscillation then grows until the "
            "friction of the law limits it."
        )


def _gains(report: DesignReport) -> Section | None:
    if report.gains is None:
        return None
    kp, ki = report.gains.chosen
    alt = f"Contours of the worst Ms over kp and ki on logarithmic axes; the design at kp {short(kp)}, ki {short(ki)}."
    text = "Worst Ms for gains near the recommended ones, with the same lead, at the lowest and the highest speed."
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
        "Lower bounds of Ms for any controller, by theorem, at the hardest operating point of each rail and load. The "
        "proof uses interpolation at the unstable pole: [Astrom2021] 14.4, [Sarason1967]."
    )
    table = Table(head, rows, caption="Lower bounds of Ms.")
    return Section("limits", "Limits for any controller", (Paragraph(text), table))


def _structure(limit: StructureLimit | None) -> str:
    if limit is None:
        return NONE
    return ms_down(limit.ms_bound) if limit.feasible else "none stabilises"


def _adhesion(report: DesignReport) -> Section:
    rows = []
    for curve in report.curves:
        point = curve.point
        peak = short(curve.peak.slip) if curve.peak.slip > curve.slip[1] else "0 (μ only falls)"
        held = (short(point.slip), short(point.adhesion_coefficient))
        where = (point.adhesion, str(point.rail), f"{point.speed_kmh:g}")
        rows.append((*where, short(curve.peak.coefficient), peak, *held))
    head = ("Law", "Rail", "Speed, km/h", "Peak μ", "At slip", "Judged slip", "μ at judged slip")
    laws = listed(dict.fromkeys(curve.point.adhesion for curve in report.curves))
    alt = f"Steady adhesion coefficient over slip for {laws}, one panel per rail; circles mark the judged slips."
    picture = Picture("adhesion", "Steady adhesion coefficient over the slip ratio.", alt)
    peaks = Table(head, rows, caption="Adhesion peaks, and the slips at which the controller is judged.")
    return Section("adhesion", "Adhesion", (picture, peaks, Facts(law_facts(curve.point for curve in report.curves))))


def _plant(report: DesignReport) -> Section:
    vehicle = report.vehicle
    noted = [*vehicle.notes, *(f"Check this: {item}" for item in vehicle_warnings(vehicle))]
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
        Table(head, rows, caption="Wheel linearised at constant slip, without the brake."),
    )
    return Section("plant", "Vehicle and plant", blocks)


def _sliding(report: DesignReport) -> Section:
    result = report.sliding.verification
    if result is None:
        return Section("sliding", "Sliding mode", (Paragraph(f"Not decided: {report.sliding.reason}."),))
    conditions = result.conditions
    met = sum(bool(item.holds) for item in conditions)
    text = (
        f"The predictive sliding-mode law meets {met} of the {len(conditions)} conditions over a box of "
        "speed, slip and load, for the static curve of the published bristle model. railslip verify --law predictive "
        "prints the box and the evidence."
    )
    rows = [
        (typeset(item.name), "not decided" if item.holds is None else item.how or "" if item.holds else "not met")
        for item in conditions
    ]
    table = Table(("Condition", "Verdict"), rows, caption="Conditions of the law.")
    return Section("sliding", "Sliding mode", (Paragraph(text), table))


def _speed(speed: float | None) -> str:
    return "never" if speed is None else f"{speed:g}"


def design_report_text(report: DesignReport, first: FirstPage, rest: str) -> str:
    """First page of the report as text, followed by `rest`, which lists the other files."""
    file = f"   {first.file}" if first.file else ""
    parts: list[RenderableType] = [
        heading(f"{first.title}   railslip_ctrl {__version__}, {report.date.isoformat()}"),
        Facts([(first.headline, first.subject + file), *first.lines]),
        Table(first.head, first.rows, text_columns=(2,)),
        rest,
    ]
    return render(parts)
