"""What stands at the top of the page, report.txt and report.json: one paragraph, numbers beside it, and points."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

from railslip_ctrl.design.specification import ROBUST_MS
from railslip_ctrl.design_report import DesignReport, LoopDesign, Origin, SpeedRange, Stop, StopRun
from railslip_ctrl.design_report.candidates import design_names
from railslip_ctrl.design_report.slow_end import HANDED_OVER
from railslip_ctrl.law_sources import words_at
from railslip_ctrl.parameters import doubts
from railslip_ctrl.report.text import Verdict
from railslip_ctrl.simulation.clairvoyant import ClairvoyantStop
from railslip_ctrl.sliding_verification import FullVerification

from .numbers import above, below, listed, short, where
from .paper_sections import reproduction_finding
from .shortfall_words import margin_words, no_robust_design, shortfall_numbers, stops_meanwhile, why_none
from .sliding_sections import claims_and_own, decided_for
from .words import (
    controller_words,
    distance_spread,
    distances,
    load_words,
    lost_words,
    outcome_words,
    percent_over,
    policy_words,
    reference_of,
    slow_words,
)


def verdict(report: DesignReport) -> Verdict:
    """What the report finds and recommends."""
    taken = report.loops.recommended
    if taken is None:
        return _none(report)
    fragile = report.loops.shortfall is not None  # what limits it then fills the paragraph, and its stops are points
    points = (
        ("Why this one", _reasons(report, taken)),
        ("Low speed", _joined(_over_speed(report) if fragile else "", _low_speed(report, taken))),
        (
            "Braking runs" if fragile else "Dry against wet",
            _joined(*(_told_stops(report, taken) if fragile else ()), _dry_against_wet(report, taken)),
        ),
        ("Not covered", _not_covered(report, taken)),
        ("Sliding mode", _sliding(report)),
        ("The paper", _paper(report)),
    )
    return Verdict(
        _paragraph(report, taken), _numbers(report, taken), tuple((head, text) for head, text in points if text)
    )


def _none(report: DesignReport) -> Verdict:
    """The verdict where no design holds all operating points."""
    shortfall = report.loops.shortfall
    text = f"{report.check.vehicle.name}: none of the designs compared here holds all operating points."
    paragraph = _joined(_doubted(report), text)
    numbers: tuple[tuple[str, str], ...] = ()
    if shortfall is not None:
        paragraph = _joined(_doubted(report), no_robust_design(report, shortfall, None))
        numbers = shortfall_numbers(report, shortfall)
    points = (
        ("Why none", why_none(report)),
        ("Limits", "" if shortfall is not None else _limits(report)),
        ("Braking runs", stops_meanwhile(report)),
        ("Sliding mode", _sliding(report)),
        ("The paper", _paper(report)),
    )
    return Verdict(paragraph, numbers, tuple((head, text) for head, text in points if text))


# --- the paragraph --------------------------------------------------------------------------------------------------


def _paragraph(report: DesignReport, taken: LoopDesign) -> str:
    if report.loops.shortfall is not None:
        return _joined(_doubted(report), no_robust_design(report, report.loops.shortfall, taken))
    return _joined(_doubted(report), _recommended(report, taken), _over_speed(report), *_told_stops(report, taken))


def _doubted(report: DesignReport) -> str:
    """How many of the vehicle's numbers are to be checked, as all else rests on them; empty if none is."""
    count = len(doubts(report.check.vehicle))
    if not count:
        return ""
    numbers = f"{count} numbers of the vehicle are" if count > 1 else "1 number of the vehicle is"
    return f"{numbers} far from usual (see Vehicle)."


def _told_stops(report: DesignReport, taken: LoopDesign) -> tuple[str, ...]:
    """The stops of the recommended design, what is shorter, and where it overshoots."""
    told = [_stop(report, stop, taken) for stop in report.one_rail_stops]
    return (*told, _shortest(report, taken), _surge(report, taken))


def _joined(*texts: str) -> str:
    return " ".join(text for text in texts if text)


def _recommended(report: DesignReport, taken: LoopDesign) -> str:
    count = len(report.plants)
    points = "the operating point" if count == 1 else f"the {count} operating points"
    name, gains = report.check.vehicle.name, controller_words(taken.controller)
    worst, endless = f"(worst Ms {above(taken.worst_ms)})", report.endless(taken.name)
    if not taken.robust:
        return (
            f"No robust design was found for {name}. The least fragile is “{taken.name}”, {gains}: stable at {points} "
            f"asked for {worst}, and not to be used without more."
        )
    if endless:
        return (
            f"No design is recommended for {name}. By its margins alone it would be “{taken.name}”, {gains}, robust at "
            f"{points} asked for {worst}, but the train does not stop with it {listed(endless)}."
        )
    return f"Recommended for {name}: the design “{taken.name}”, {gains}. It is robust at {points} asked for {worst}."


def _over_speed(report: DesignReport) -> str:
    speeds = report.loops.speeds
    if speeds is None:
        return ""
    text = _robust_speeds(report, speeds)
    if speeds.stable_from <= speeds.least_kmh:
        return f"{text}; every loop is stable down to {speeds.least_kmh:g} km/h."
    if report.loops.shortfall is not None:
        return f"{text}."  # it stands under Low speed, which goes on with where stability ends
    if math.isinf(speeds.robust_from):
        return f"{text}, and {lost_words(speeds)}, where slip control has to be cut out."
    return f"{text}. Not for lower speeds (see Low speed): {lost_words(speeds)}."


def _robust_speeds(report: DesignReport, speeds: SpeedRange) -> str:
    if math.isinf(speeds.robust_from):
        return f"On some law, rail or load Ms is above {ROBUST_MS:g} up to the highest speed"
    return f"Ms stays at most {ROBUST_MS:g} from {above(speeds.robust_from)} km/h up, on {_conditions(report, speeds)}"


def _conditions(report: DesignReport, speeds: SpeedRange) -> str:
    asked = report.plants[0].point
    names = {asked.adhesion: words_at(asked)}
    laws = list(dict.fromkeys(names.get(line.law, line.law) for line in speeds.lines))
    rails = list(dict.fromkeys(str(line.rail) for line in speeds.lines))
    loaded = ", empty and loaded" if len({line.mass for line in speeds.lines}) > 1 else ""
    return f"{listed(rails)} rail{loaded}, with the adhesion {'law' if len(laws) == 1 else 'laws'} {listed(laws)}"


def _of(runs: Iterable[StopRun], name: str) -> StopRun | None:
    return next((one for one in runs if one.name == name and one.run is not None), None)


def _stop(report: DesignReport, stop: Stop, taken: LoopDesign) -> str:
    """The stop of the design in a sentence, beside the shortest that locks on no rail and the bound."""
    one = _of(stop.runs, taken.name)
    if one is None or one.run is None:
        return ""
    rail, run = stop.scenario.rail, one.run
    if not one.stops:  # of a robust one it is told in the first sentence
        fragile = report.loops.shortfall is not None or not taken.robust
        return f"On {rail} rail the train does not stop with it." if fragile else ""
    text = f"On {rail} rail it stops in {short(run.braking_distance, 3)} m{percent_over(run, stop.bound)}"
    if one.locks:
        text += f", its wheel locked for up to {short(100 * one.most_locked, 2)} % of the time"
    best = _best(report, stop)
    if best is one:
        text += f", the shortest of those that lock {_nowhere(report)}"
    elif best is not None and best.run is not None and not _one_is_best(report):
        text += f"; “{best.name}” (locks {_nowhere(report)}) takes {short(best.run.braking_distance, 3)} m"
    return text + "."


def _shortest(report: DesignReport, taken: LoopDesign) -> str:
    """The one controller that is, on every rail, the shortest of those that lock on none; empty if there is none."""
    bests = [_best(report, stop) for stop in report.one_rail_stops]
    found = [one.run for one in bests if one is not None and one.run is not None]
    best = bests[0] if bests else None
    if best is None or best.name == taken.name or not _one_is_best(report):
        return ""
    told = [f"{short(run.braking_distance, 3)} m on {run.scenario.rail} rail" for run in found]
    return f"The shortest that locks {_nowhere(report)} is “{best.name}”: {listed(told)}."


def _nowhere(report: DesignReport) -> str:
    """Where a controller of `_best` locks the wheel, to follow the verb: not on the rail spoken of alone."""
    return "on neither rail" if len(report.one_rail_stops) > 1 else "no wheel"


def _one_is_best(report: DesignReport) -> bool:
    bests = [_best(report, stop) for stop in report.one_rail_stops]
    return len({None if one is None else one.name for one in bests}) == 1


def _best(report: DesignReport, stop: Stop) -> StopRun | None:
    """The shortest run of a stop by a controller that locks the wheel on no rail: which it meets is not known."""
    return stop.shortest_of({one.name for one in stop.runs if not report.locks_on(one.name)})


def _surge(report: DesignReport, taken: LoopDesign) -> str:
    """Where the design's own runs with the dynamic law pass twice the reference, which no margin tells."""
    told = []
    for stop in report.one_rail_stops:
        one = _of(stop.dynamic, taken.name)
        if one is not None and one.run is not None and one.highest_slip > 2 * reference_of(one.run):
            told.append(
                f"{short(one.highest_slip, 2)}{' (locked)' if one.locks else ''} on {stop.scenario.rail} rail "
                f"(reference {reference_of(one.run):g}), at "
                f"{short(one.highest_slip_kmh, 2)} km/h"
            )
    return f"With the dynamic bristle model its slip overshoots to {listed(told)}." if told else ""


# --- the numbers ----------------------------------------------------------------------------------------------------


def _numbers(report: DesignReport, taken: LoopDesign) -> tuple[tuple[str, str], ...]:
    """What the recommendation rests on, a row each."""
    margins = [one.margins for one in taken.assessments if one.margins is not None]
    rows = [
        ("Design", f"{taken.name}: {controller_words(taken.controller)}"),
        ("Margins at the operating points", margin_words(margins)),
    ]
    if report.loops.shortfall is not None:
        rows += shortfall_numbers(report, report.loops.shortfall)
    speeds = report.loops.speeds
    if speeds is not None:
        rows.append((f"Ms ≤ {ROBUST_MS:g}", _from(speeds.robust_from, speeds.least_kmh)))
        rows.append(("Stable", f"{_from(speeds.stable_from, speeds.least_kmh)}{_first_lost(report)}"))
    for stop in report.one_rail_stops:
        one, again = _of(stop.runs, taken.name), _of(stop.dynamic, taken.name)
        if one is not None:
            rows.append((f"Stop, {stop.scenario.rail} rail", _stop_words(one, stop.bound)))
        if again is not None:
            rows.append((f"Stop, {stop.scenario.rail} rail, dynamic bristle model", _stop_words(again, None)))
    return tuple(rows)


def _from(speed: float, least: float) -> str:
    if math.isinf(speed):
        return "not at all of the speeds, laws, rails and loads"
    if speed <= least:
        return f"at all speeds from {least:g} km/h up"
    return f"from {above(speed)} km/h up"


def _first_lost(report: DesignReport) -> str:
    speeds = report.loops.speeds
    if speeds is None or speeds.stable_from <= speeds.least_kmh:
        return ""
    line = speeds.first_lost
    return f" (first lost: law {line.law}, {line.rail} rail, {load_words(line, speeds)})"


def _stop_words(one: StopRun, bound: ClairvoyantStop | None) -> str:
    run = one.run
    assert run is not None, "only runs are told"
    if not one.stops:
        return outcome_words(one)
    text = (
        f"{distance_spread(one)}{percent_over(run, bound)}; slip at most {short(one.highest_slip, 2)} (at "
        f"{short(one.highest_slip_kmh, 2)} km/h), reference {reference_of(run):g}"
    )
    return text + (f"; locked {short(100 * one.most_locked, 2)} % of the time" if one.locks else "")


# --- the points -----------------------------------------------------------------------------------------------------


def _limits(report: DesignReport) -> str:
    count = len(report.plants)
    away = sum(one.unstable_pole > 0 for one in report.limits)
    points = "its operating point" if count == 1 else f"its {count} operating points"
    pairs = zip(report.limits, (plant.point for plant in report.plants), strict=True)
    worst, point = max(pairs, key=lambda pair: pair[0].unstable_pole)
    if worst.unstable_pole == 0:
        return f"The wheel is stable by itself at {points}."
    at = points if away == count else f"{away} of {points}"
    bound = below(worst.ms_bound)
    least = "" if bound == "1" else f", and no linear controller gets Ms below {bound} there"  # every loop's is above 1
    return (
        f"At {at} the wheel runs away by itself, doubling its slip error in as little as "
        f"{short(worst.doubling_time, 2)} s ({where(point)}){least}."
    )


def _reasons(report: DesignReport, taken: LoopDesign) -> str:
    best = report.loops.best
    names = design_names(report.check.vehicle)
    if taken.name == names.largest_ki:
        why = f"Where the wheel is stable by itself less Ms is no aim, as no feedback has the least: {taken.how}."
    elif taken.over_range and taken.robust:
        why = (
            f"Of the designs with Ms ≤ {ROBUST_MS:g} it is the only one tuned for more than these points: {taken.how}."
        )
    elif taken.robust:
        why = f"It has the least worst Ms of the robust ones; {taken.how}."
    else:
        why = f"None is robust (Ms ≤ {ROBUST_MS:g}); it is the least fragile."
    if names.full_range in report.loops.refused:
        why += f" There is no {names.full_range}: {report.loops.refused[names.full_range]}."
    if best is not None and best is not taken:
        least = above(best.worst_ms)
        why += f" “{best.name}” has the least worst Ms at these points ({least}), but {_weak(report, best)}."
    return f"{_limits(report)} {why}"


def _weak(report: DesignReport, design: LoopDesign) -> str:
    """What speaks against a design of less Ms, with its runs where there are any."""
    if design.needs_hold:
        return "needs a known holding torque"
    gains = design.controller.gains
    text = f"an integral time of {short(gains.kp / gains.ki, 2)} s" if gains.ki > 0 else "no integral action"
    told = []
    for stop in report.one_rail_stops:
        one = _of(stop.runs, design.name)
        if one is not None and one.run is not None and one.stops:
            told.append(f"{short(one.run.braking_distance, 3)} m on {stop.scenario.rail} rail")
    return f"{text}, and takes {listed(told)} to stop" if told else text


def _low_speed(report: DesignReport, taken: LoopDesign) -> str:
    speeds = report.loops.speeds
    ends = [end for stop in report.stops for end in stop.slow if end.name == taken.name]
    texts = []
    if speeds is not None and speeds.stable_from > speeds.least_kmh:
        texts.append(f"Linearised at each speed, {lost_words(speeds)}.")
        if not ends:
            texts.append("Below that it has to hand over to a limit of the brake itself; no run of it was made there.")
    if ends:
        texts += [slow_words(ends), policy_words(ends)]
    return " ".join(texts)


def _dry_against_wet(report: DesignReport, taken: LoopDesign) -> str:
    """The recommended design's stop on each rail beside those that are shorter on one of them, and why."""
    stops = report.one_rail_stops
    if len(stops) < 2:
        return ""
    own, rows = [_of(stop.runs, taken.name) for stop in stops], []
    for name in dict.fromkeys(one.name for stop in stops for one in stop.runs):
        runs = [_of(stop.runs, name) for stop in stops]
        if all(one is not None for one in runs) and (name == taken.name or _shorter_somewhere(runs, own)):
            told = " and ".join(
                f"{distances(one)} {stop.scenario.rail}{' (locks)' if one.locks else ''}"
                for stop, one in zip(stops, runs, strict=True)
                if one is not None and one.run is not None
            )
            rows.append(f"{name} {told}")
    spread = [
        100 * (max(one.distances) - min(one.distances)) / one.run.braking_distance
        for stop in stops
        for one in stop.runs
        if one.run is not None and one.stops and len(one.distances) > 1
    ]
    varies = f"Between noise seeds a distance changes by at most {short(max(spread), 2)} %." if spread else ""
    texts = (f"It, and what is shorter on one rail: {'; '.join(rows)}.", _why_slow(report, taken), varies)
    return " ".join(text for text in texts if text)


def _shorter_somewhere(runs: Sequence[StopRun | None], own: Sequence[StopRun | None]) -> bool:
    pairs = [(a, b) for a, b in zip(runs, own, strict=True) if a is not None and b is not None]
    return any(a.stops and _distance(a) < _distance(b) for a, b in pairs)


def _distance(one: StopRun) -> float:
    """Braking distance, m; inf if the train does not stop."""
    return one.run.braking_distance if one.run is not None and one.stops else math.inf


def _why_slow(report: DesignReport, taken: LoopDesign) -> str:
    """Why the recommended design stays under its reference on a rail, if it does, and what more torque would do."""
    texts = []
    for stop in report.one_rail_stops:
        one = _of(stop.runs, taken.name)
        if one is None or one.run is None or one.highest_slip >= reference_of(one.run) or not taken.over_range:
            continue
        rail = stop.scenario.rail
        holding = max(plant.point.brake_torque for plant in report.plants if plant.point.rail is rail)
        begins = getattr(one.run.controller, "initial_torque", 0.0)
        texts.append(
            f"On {rail} rail “{taken.name}” never comes to its reference with the law {stop.scenario.adhesion.name}: "
            f"it begins with {short(begins, 3)} N·m, which even wet rail takes, where {short(holding, 3)} N·m would "
            f"hold the slip, and the integral that Ms ≤ {ROBUST_MS:g} allows brings it to "
            f"{short(one.run.max_torque, 3)} N·m {'before the train stands' if one.stops else 'by the end of the run'}."
        )
    started = design_names(report.check.vehicle).started_dry
    begun, handed = (_takes(report, name) for name in (started, f"{started}{HANDED_OVER}"))
    if texts and begun:
        over = f"; {HANDED_OVER.removeprefix(', ')} (see Low speed) besides, {handed}" if handed else ""
        runs = [one.run for stop in report.one_rail_stops if (one := _of(stop.runs, started)) is not None]
        torque = max(getattr(run.controller, "initial_torque", 0.0) for run in runs if run is not None)
        texts.append(f"Begun with {short(torque, 3)} N·m it would take {begun}{over}.")
    return " ".join(texts)


def _takes(report: DesignReport, name: str) -> str:
    """Where a controller stops on each rail; empty if it has no runs, or does not stop in one of them."""
    told = [
        f"{short(one.run.braking_distance, 3)} m on {stop.scenario.rail} rail"
        + (f", locked up to {short(100 * one.most_locked, 2)} % of the time" if one.locks else "")
        for stop in report.one_rail_stops
        if (one := _of(stop.runs, name)) is not None and one.run is not None and one.stops
    ]
    return listed(told) if told and len(told) == len(report.one_rail_stops) else ""


def _not_covered(report: DesignReport, taken: LoopDesign) -> str:
    noise = max((effort.noise_gain for effort in taken.efforts if effort is not None), default=math.nan)
    range_ = "" if taken.over_range else "any other speed, load, rail or slip; "
    alone = list(dict.fromkeys(name for stop in report.stops if stop.dynamic for name in stop.without_dynamic))
    text = (
        f"{range_}errors of the dead time and lag beyond the delay margin; sampling, and sensor noise, of which 1 m/s "
        f"becomes {short(noise, 2)} N·m of commanded torque; adhesion laws other than those named."
    )
    text = text[:1].upper() + text[1:]
    if alone:
        text += (
            f" Run with the static adhesion law only: {listed(alone)}. The distance below which no controller can stop "
            "is known for the static law only."
        )
    return text


def _sliding(report: DesignReport) -> str:
    texts = []
    for name, full in (("published", report.sliding.paper), ("layered", report.sliding.layered)):
        if full is not None:
            texts.append(_law(name, full))
    which = decided_for(report)
    if which and texts:
        texts.append(f"All of them are {which}.")
    return " ".join(["Not recommended.", *texts]) if texts else ""


def _law(name: str, full: FullVerification) -> str:
    claims, own = claims_and_own(full)
    if claims:
        return f"Of the conditions that the {name} law's proof claims or relies on, {claims}."
    return (
        f"Of the conditions set for the {name} law, this project's own design, {own}; it needs the rail's holding "
        "torque, which has to be known."
    )


def _paper(report: DesignReport) -> str:
    if report.table5 is None:
        return ""
    wrong = sum(not one.agrees for one in report.errata)
    published = tuple(group for group in report.check.groups if group.title.startswith("Table 4"))
    return (
        f"{replace(report.check, groups=published).conclusion} {reproduction_finding(report.table5)} {wrong} of "
        f"{len(report.errata)} equations, numbers and claims of [Park2008] that were worked out again "
        f"{'differs' if wrong == 1 else 'differ'}."
    )


def gains_not_computed(report: DesignReport) -> tuple[str, ...]:
    """What the report shows and did not compute: gains that were typed, by design, and where they come from."""
    where_from = {
        Origin.CITED: "cited: {how}",
        Origin.GIVEN: "given on the command line",
        Origin.KEPT: "kept with the package, where they were rounded after tuning; its tests tune them again",
    }
    return tuple(
        f"{one.name}: {where_from[one.origin].format(how=one.how)}"
        for one in report.loops.designs
        if one.origin in where_from
    )
