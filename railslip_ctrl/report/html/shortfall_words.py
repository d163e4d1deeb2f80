"""What the verdict says where no design is robust: what limits it, the best there is, what would have to change."""

from __future__ import annotations

import math
from collections.abc import Sequence

from railslip_ctrl.design.specification import ROBUST_MS
from railslip_ctrl.design_report import Attempt, DesignReport, LoopDesign, Shortfall
from railslip_ctrl.design_report.candidates import design_names
from railslip_ctrl.loop import Margins

from .numbers import above, below, listed, short, where
from .words import controller_words, locks_elsewhere


def no_robust_design(report: DesignReport, found: Shortfall, least_fragile: LoopDesign | None) -> str:
    """The paragraph: the limit first, as nothing that is tuned can pass it."""
    parts = (_limit(report, found), _best(report, found, least_fragile), _change(report, found))
    return " ".join(part for part in parts if part)


def shortfall_numbers(report: DesignReport, found: Shortfall) -> tuple[tuple[str, str], ...]:
    """The rows that stand beside the paragraph."""
    limits = found.limits
    return (
        *((f"{one.name}, for {where(one.point)} alone", _alone_words(one, margins)) for one, margins in _alone(found)),
        ("Least Ms of any linear controller", f"{below(limits.ms_bound)} ({found.point.words})"),
        (
            "Unstable pole p there",
            f"{short(limits.unstable_pole, 3)} 1/s, doubling in {short(limits.doubling_time, 3)} s",
        ),
        ("Brake", f"dead time {limits.dead_time:g} s, lag {limits.lag:g} s"),
        (f"Dead time for Ms ≤ {ROBUST_MS:g}, any linear controller", f"below {above(found.longest_dead_time)} s"),
        (f"Dead time for Ms ≤ {ROBUST_MS:g}, {design_names(report.check.vehicle).least_ms}", _lead_range(found)),
    )


def margin_words(margins: Sequence[Margins]) -> str:
    """The worst of each margin over some loops, rounded to the side that promises less."""
    return (
        f"Ms ≤ {above(max(m.ms for m in margins))}, phase ≥ {below(min(m.phase_deg for m in margins))} deg, "
        f"added dead time ≤ {below(min(m.delay_s for m in margins))} s, gain "
        f"{above(max(m.gain_decrease for m in margins))} to {below(min(m.gain_increase for m in margins))}"
    )


def _limit(report: DesignReport, found: Shortfall) -> str:
    """The theorem, then the race between the wheel and the brake that it is about."""
    limits, name, asked = found.limits, report.check.vehicle.name, f"robust design (Ms ≤ {ROBUST_MS:g})"
    theorem = f"no linear controller gets Ms below {below(limits.ms_bound)} ({found.point.words})."
    if limits.ms_bound > ROBUST_MS:
        lead = f"{name} has no {asked} at {_slips(report)}, and none can exist there: {theorem}"
    else:
        lead = f"No {asked} was found for {name}; {theorem}"
    product = limits.actuator_product
    needs = "a PI needs less than 1" if product >= 1 else "below 1, as a PI needs"
    return (
        f"{lead} There the slip error doubles in {short(limits.doubling_time, 3)} s (unstable pole p = "
        f"{short(limits.unstable_pole, 3)} 1/s); the brake has dead time τ = {limits.dead_time:g} s, lag T = "
        f"{limits.lag:g} s: p (τ + T) is {short(product, 3)}, {needs}."
    )


def _best(report: DesignReport, found: Shortfall, least_fragile: LoopDesign | None) -> str:
    """The least fragile design, or what is left where none holds all operating points; its rows have the rest."""
    if least_fragile is not None:
        gains = least_fragile.controller.gains
        margins = [one.margins for one in least_fragile.assessments if one.margins is not None]
        return (
            f"The least fragile design, “{least_fragile.name}”, kp {short(gains.kp)} N·m/(m/s), ki "
            f"{short(gains.ki)} N·m/m, holds {_points(report)} with Ms ≤ {above(max(m.ms for m in margins))}, phase ≥ "
            f"{below(min(m.phase_deg for m in margins))} deg{_lost(report)}; not to be used without more."
        )
    none = f"No design compared holds {_points(report)}"
    held = _alone(found)
    name = design_names(report.check.vehicle).least_ms
    if not held:
        return f"{none}, and no “{name}” tuned for one of them alone holds that one."
    told = listed(f"{where(one.point)} (Ms ≤ {above(margins.ms)})" for one, margins in held)
    return f"{none}; the best, “{name}” tuned for one of them alone, holds only that: {told}."


def _lost(report: DesignReport) -> str:
    """That the loop is unstable at some of the speeds, loads and rails looked at, if so; a clause to append."""
    speeds = report.loops.speeds
    if speeds is None or speeds.stable_from <= speeds.least_kmh:
        return ""
    if math.isinf(speeds.stable_from):
        return ", but is unstable at some load or rail"
    return f", but is unstable below {above(speeds.stable_from)} km/h"


def _alone(found: Shortfall) -> list[tuple[Attempt, Margins]]:
    """The designs for one operating point alone that hold it, with their margins."""
    return [(one, one.margins) for one in found.alone if one.margins is not None]


def _alone_words(one: Attempt, margins: Margins) -> str:
    gains = "" if one.controller is None else f"{controller_words(one.controller)}: "
    return f"{gains}{margin_words([margins])}"


def _slips(report: DesignReport) -> str:
    """The reference slips asked for, which what is said of the plant holds at."""
    slips = list(dict.fromkeys(f"{plant.point.slip:g}" for plant in report.plants))
    return f"reference slip{'s' if len(slips) > 1 else ''} {listed(slips)}"


def _points(report: DesignReport) -> str:
    count = len(report.plants)
    if count > 2:
        return f"all {count} operating points asked for"
    return "the operating point asked for" if count == 1 else "both operating points asked for"


def _change(report: DesignReport, found: Shortfall) -> str:
    """The dead time at which a theorem lets go, the one at which a design is robust, and what else slows the race."""
    own, name = report.check.vehicle.actuator.dead_time, design_names(report.check.vehicle).least_ms
    slower = "a smaller p (smaller reference slip, --slip; more wheel inertia)"
    if found.longest_dead_time <= 0:
        return f"No dead time is short enough: Ms ≤ {ROBUST_MS:g} takes {slower}."
    possible = above(found.longest_dead_time)
    of_any = f"any linear controller: below {possible} s; " if found.longest_dead_time < own else ""
    higher = "" if of_any else f"a higher order (not excluded up to {possible} s), "
    lead = (
        f"“{name}”: up to {below(found.lead_dead_time, 2)} s at this lag"
        if found.lead_dead_time > 0
        else f"“{name}”: none, unless the lag is shorter too"
    )
    return f"Ms ≤ {ROBUST_MS:g} takes a shorter dead time ({of_any}{lead}), {higher}or {slower}."


def _lead_range(found: Shortfall) -> str:
    return f"up to {below(found.lead_dead_time, 2)} s" if found.lead_dead_time > 0 else "none at this lag"


def why_none(report: DesignReport) -> str:
    """What came of each design, in a few words each."""
    told = []
    for one in report.loops.designs:
        lost = [each.point.words for each in one.assessments if not each.stable]
        if one.needs_hold:
            told.append(f"{one.name}: needs a known holding torque")
        elif lost:
            told.append(
                f"{one.name}: unstable at {'; '.join(lost) if len(lost) < len(one.assessments) else 'each of them'}"
            )
    told += [f"{name}: {reason}" for name, reason in report.loops.refused.items()]
    return f"{'. '.join(told)}." if told else ""


def stops_meanwhile(report: DesignReport) -> str:
    """What stops the train without a locked wheel on each rail, though no margins vouch for it."""
    told = []
    for stop in report.one_rail_stops:
        best = stop.shortest_unlocked
        if best is not None and best.run is not None:
            rail, but = stop.scenario.rail, locks_elsewhere(report, best, stop)
            told.append(f"{short(best.run.braking_distance, 3)} m on {rail} rail with {best.name}{but}")
    if not told:
        return ""
    return f"The shortest stops without a locked wheel, single runs that no margin vouches for: {listed(told)}."
