"""What stands at the top: one paragraph, and up to four points that go with it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from railslip_ctrl.assessment import ROBUST_MS
from railslip_ctrl.design_report import DesignReport, LoopDesign, Origin, Stop
from railslip_ctrl.simulation.designed import SPEEDS_KMH
from railslip_ctrl.sliding_verification import FullVerification

from .numbers import listed, short, where
from .paper_sections import reproduction_finding
from .sliding_sections import claims_and_own
from .stop_sections import below_reference


@dataclass(frozen=True)
class Verdict:
    """A paragraph that can be read alone, and points with their headings."""

    paragraph: str
    points: tuple[tuple[str, str], ...]

    @property
    def text(self) -> str:
        """All of it in one string."""
        return " ".join([self.paragraph, *(f"{head}: {told}" for head, told in self.points)])


def verdict(report: DesignReport) -> Verdict:
    """What the report finds and recommends."""
    paragraph = " ".join([_limits(report), report.check.conclusion, _recommended(report)])
    points = (
        ("Why, and what it does not cover", _reasons(report)),
        ("Sliding mode", _sliding(report)),
        ("Braking runs", _stops(report)),
        ("The paper", _paper(report)),
    )
    return Verdict(paragraph, tuple((head, text) for head, text in points if text))


def _limits(report: DesignReport) -> str:
    name, count = report.check.vehicle.name, len(report.plants)
    points = "its operating point" if count == 1 else f"its {count} operating points"
    pairs = zip(report.limits, (plant.point for plant in report.plants), strict=True)
    worst, point = max(pairs, key=lambda pair: pair[0].unstable_pole)
    if worst.unstable_pole == 0:
        return f"{name}: the wheel is stable by itself at {points}."
    return (
        f"{name}: at {points} the wheel runs away by itself, doubling its slip error in as little as "
        f"{short(worst.doubling_time, 2)} s ({where(point)}), and no linear controller gets Ms below "
        f"{short(worst.ms_bound, 3)} there."
    )


def _recommended(report: DesignReport) -> str:
    taken = report.loops.recommended
    if taken is None:
        return "Recommendation: none. No design compared here holds all operating points."
    holds = "robust at all these points" if taken.worst_ms <= ROBUST_MS else "stable at all these points, but fragile"
    controller = taken.controller
    gains = f"kp {short(controller.gains.kp)} N·m/(m/s), ki {short(controller.gains.ki)} N·m/m"
    if controller.lead > 0:
        gains += f", behind the lead ({controller.lead:g} s + 1)/({controller.lead_filter:g} s + 1)"
    return f"Recommendation: the design “{taken.name}”, {gains}: {holds} (worst Ms {short(taken.worst_ms, 3)})."


def _reasons(report: DesignReport) -> str:
    taken, best = report.loops.recommended, report.loops.best
    if taken is None or best is None:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in report.loops.refused.items())
        return f"Every design is unstable at one of the points, or does not exist. {reasons}".strip()
    if taken.over_range and taken.worst_ms <= ROBUST_MS:
        why = f"It keeps Ms ≤ {ROBUST_MS:g} here and is the only one tuned for more than these points: {taken.how}."
        if best is not taken:
            why += (
                f" “{best.name}” has the least worst Ms at these points ({short(best.worst_ms, 3)}), but {_weak(best)}."
            )
    elif taken.worst_ms <= ROBUST_MS:
        why = f"It has the least worst Ms of the robust ones; {taken.how}."
    else:
        why = f"None is robust (Ms ≤ {ROBUST_MS:g}); it is the least fragile, to be used with care."
    return f"{why} {_not_covered(report, taken)}"


def _weak(design: LoopDesign) -> str:
    if design.needs_hold:
        return "needs a known holding torque"
    gains = design.controller.gains
    return f"an integral time of {short(gains.kp / gains.ki, 2)} s" if gains.ki > 0 else "no integral action"


def _not_covered(report: DesignReport, taken: LoopDesign) -> str:
    low, high = min(SPEEDS_KMH), max(SPEEDS_KMH)
    range_ = f"speeds outside {low:g} to {high:g} km/h" if taken.over_range else "any other speed, load, rail or slip"
    noise = max((effort.noise_gain for effort in taken.efforts if effort is not None), default=math.nan)
    return (
        f"Not covered: {range_}; errors of the dead time and lag beyond its delay margin; sampling, and sensor noise, "
        f"of which 1 m/s becomes {short(noise, 2)} N·m of commanded torque; adhesion laws other than those named"
        f"{_overshoot(report, taken)}."
    )


def _overshoot(report: DesignReport, taken: LoopDesign) -> str:
    """Where the design's own runs with the dynamic law pass twice the reference, which no margin tells."""
    told = []
    for stop in report.stops:
        run = next((one.run for one in stop.dynamic if one.name == taken.name), None)
        if run is None:
            continue
        reference = getattr(run.controller.reference, stop.scenario.rail.value)
        if run.max_slip > 2 * reference:
            told.append(f"{stop.scenario.rail} rail up to {short(run.max_slip, 2)}, reference {reference:g}")
    if not told:
        return ""
    passed = f"the slip passes twice its reference ({listed(told)})"
    return f"; applying the brake to a free-rolling wheel, where with the dynamic model {passed}"


def _sliding(report: DesignReport) -> str:
    texts = []
    for name, full in (("published", report.sliding.paper), ("layered", report.sliding.layered)):
        if full is not None:
            texts.append(_law(name, full))
    return " ".join(texts)


def _law(name: str, full: FullVerification) -> str:
    claims, own = claims_and_own(full)
    if claims:
        text = f"Of the conditions that the {name} law's proof claims or relies on, {claims}."
        return text + (f" Of this project's own, on mended variants of it, {own}." if own else "")
    return f"Of the conditions set for the {name} law, this project's own design, {own}."


def _stops(report: DesignReport) -> str:
    texts = [_stop(stop) for stop in report.stops]
    if any(stop.dynamic for stop in report.stops):
        texts.append(
            "These runs have the static bristle curve, the margins the dynamic bristle model. With the dynamic model: "
            f"{'; '.join(_dynamic(stop) for stop in report.stops if stop.dynamic)}."
        )
    return " ".join(texts)


def _dynamic(stop: Stop) -> str:
    """What the linear controllers do over the dynamic law, in a few words."""
    told = [
        f"{one.name} {short(one.run.braking_distance, 3)} m, slip up to {short(one.run.max_slip, 2)}"
        for one in stop.dynamic
        if one.run is not None
    ]
    return f"{stop.scenario.rail} rail, {' and '.join(told)}"


def _stop(stop: Stop) -> str:
    shortest, bound = stop.shortest, stop.bound
    if shortest is None:
        return f"{_capital(stop.title)}: no controller stops the train."
    name = next(one.name for one in stop.runs if one.run is shortest)
    text = f"{_capital(stop.title)}: shortest with {name}, {short(shortest.braking_distance, 3)} m"
    if bound is not None and math.isfinite(bound.braking_distance):
        text += f"; no controller can stop in less than {short(bound.braking_distance, 3)} m on the same law"
    return text + below_reference(name, shortest) + "."


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _paper(report: DesignReport) -> str:
    wrong = [one for one in report.errata if not one.agrees]
    text = (
        f"{len(wrong)} of {len(report.errata)} equations, numbers and claims of [Park2008] that were worked out again "
        f"{'differs' if len(wrong) == 1 else 'differ'}."
    )
    return text if report.table5 is None else f"{reproduction_finding(report.table5)} {text}"


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
