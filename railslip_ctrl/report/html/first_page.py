"""The first page of a design report: what to do, why, and at most ten numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from railslip_ctrl.design.controllers import PIController
from railslip_ctrl.design.judging import Judgement
from railslip_ctrl.report.recommendation import DesignReport, Stop

from .blocks import FirstPage, Picture
from .numbers import above, below, minus, short

RECOMMENDED = "recommended.toml"
"""The file with the recommended design."""

HEAD = ("", "worst", "where")


def first_page(report: DesignReport) -> FirstPage:
    """What a reviewer reads in a minute."""
    return FirstPage(
        title=f"Wheel-slip control design: {report.vehicle.name}",
        headline=headline(report),
        subject=design_words(report),
        file=RECOMMENDED if report.control is not None else "",
        lines=(("Why", _why(report)), ("To do", _to_do(report))),
        head=HEAD,
        rows=tuple((name, value, minus(where)) for name, value, where in _rows(report)),
        pictures=tuple(_pictures(report)),
    )


def headline(report: DesignReport) -> str:
    """Use it, use it above a speed, or do not."""
    if report.above_kmh is None:
        return "DO NOT USE"
    at = " at the operating points" if report.nominal else ""
    return (f"USE ABOVE {report.above_kmh:g} km/h" if report.hands_over else "USE") + at


def design_words(report: DesignReport) -> str:
    """The recommended design with its numbers."""
    if report.control is None:
        return "any PI or PI-lead"
    design, held = report.control.design, report.control.reference
    slips = {"dry": held.dry, "wet": held.wet}
    slip = ", ".join(f"{short(slips[rail.value])} {rail}" for rail in report.envelope.rails)
    return f"{controller_words(design)}; slip {slip}"


def controller_words(design: PIController) -> str:
    """A PI or PI-lead with its numbers."""
    gains = f"{design.structure}: kp {short(design.gains.kp)} N·m/(m/s), ki {short(design.gains.ki)} N·m/m"
    return gains + (f", lead {short(design.lead)} s / {short(design.lead_filter)} s" if design.lead > 0 else "")


def _why(report: DesignReport) -> str:
    if report.in_use is None or report.best is None:
        return "No PI or PI-lead keeps every loop stable, not even at the highest speed of the envelope."
    judged = report.in_use
    operating = int(judged.points.operating.sum())
    robust = None if report.judgement is None else report.judgement.robust_from_kmh
    if report.above_kmh is None and robust is not None:
        return "The best PI or PI-lead is robust by its margins, but its slip passes 0.5 in a stop."
    if report.above_kmh is None:
        asked = "Ms ≤ 2" if report.nominal else "Ms ≤ 2, and stability with every tolerance,"
        return f"No PI or PI-lead found keeps {asked} at any speed. The best has {ms_words(judged.worst.ms)}."
    told = f"Ms ≤ 2 at all {operating} operating points"
    if not report.nominal:
        told += f", stable at all {len(judged.points)} with tolerances"
    slides = "" if robust == report.above_kmh else " Used at less speed, its slip passes 0.5 in a stop."
    factor = report.best.reference_factor
    less = "" if factor == 1.0 else f" It holds {factor:g} of the reference slip; with more, fewer points are robust."
    return f"{told}.{slides}{less}"


def ms_words(ms: float) -> str:
    """An Ms, not below what it is."""
    return "unstable loops" if math.isinf(ms) else f"Ms {above(ms)}"


def _to_do(report: DesignReport) -> str:
    """The steps that the numbers ask for, the first ones first; few words."""
    told = []
    if report.control is not None and report.usable and report.control.cut_out_speed > 0:
        told.append(
            f"Below {report.above_kmh:g} km/h the file holds {short(report.control.cut_out_torque)} N·m, without slip "
            "control."
        )
    if report.faster is not None:
        brake = f"dead time {short(report.faster.dead_time, 3)} s, lag {short(report.faster.lag, 3)} s"
        told.append(f"For Ms ≤ 2 from {min(report.envelope.speeds):g} km/h up: {brake}.")
    elif not report.usable:
        told.append("Take a brake with less dead time and lag, or hold less slip.")
    if report.judgement is not None and report.judgement.envelope.knife_edges():
        told.append("The reference is at the adhesion peak: hold less slip.")
    slow = list(dict.fromkeys(str(stop.rail) for stop in report.stops if not stop.reached))
    if slow:
        told.append(f"In stops on {' and '.join(slow)} rail the slip stays below its reference.")
    return " ".join(told) or "Load the file, and confirm it on the rig."


def _rows(report: DesignReport) -> Iterator[tuple[str, str, str]]:
    """At most ten numbers over the speeds in use."""
    judged = report.in_use
    if judged is None:
        point, limits = max(report.limits, key=lambda one: one[1].ms_bound)
        yield "Least Ms of any linear controller", below(limits.ms_bound), f"{point.rail}, {point.speed_kmh:g} km/h"
        return
    worst = judged.worst
    yield "Ms", _ms(worst.ms), f"{worst.case.words}"
    if not judged.nominal:
        beyond = judged.worst_with_tolerances
        yield "Ms with tolerances", _ms(beyond.ms), beyond.case.words
    if worst.margins is not None:
        yield from _margin_rows(judged)
    for stop in report.first_stops:
        yield f"Stop, {stop.rail}", _distance(stop), f"{stop_words(stop)}; {_locks(report, stop)}"
    if report.usable:
        yield "Mean stop", f"{short(report.trials[0].distance())} m", _chosen(report)


def _chosen(report: DesignReport) -> str:
    """By what the design was chosen, and what the next would give."""
    tried, (_, *others) = len(report.selection.choices), report.trials
    told = f"of all laws, loads and rails; best of {tried} tried: robust from the lowest speed, then the shortest stops"
    if not others:
        return told
    after = others[0]
    usable = "of no use" if after.above_kmh is None else f"above {after.above_kmh:g} km/h"
    return f"{told}; next: {short(after.distance())} m with {after.choice.reference_factor:g} of the slip, {usable}"


def _margin_rows(judged: Judgement) -> Iterator[tuple[str, str, str]]:
    """The least margins of the operating points, each with its case."""
    operating = np.flatnonzero(judged.points.operating)
    m = judged.margins

    def least(values: np.ndarray, sign: float = 1.0) -> tuple[float, str]:
        index = int(operating[np.argmin(sign * values[operating])])
        return float(values[index]), judged.points.case(index).words

    phase, where = least(m.phase_deg)
    yield "Phase margin", f"{below(phase)} deg", where
    delay, where = least(m.delay_s)
    yield "Delay margin", f"{below(delay)} s", where
    (low, under), (high, over) = least(m.gain_decrease, -1.0), least(m.gain_increase)
    yield "Gain range", f"{above(low)} to {below(high)}", under if under == over else f"{under} | {over}"


def _ms(ms: float) -> str:
    return "unstable" if math.isinf(ms) else above(ms)


def _distance(stop: Stop) -> str:
    return f"{short(stop.run.braking_distance)} m" if stop.run.stopped else "no stop"


def stop_words(stop: Stop) -> str:
    """How far over the bound, which slip, whether the wheel locks."""
    told = []
    if stop.bound is not None and not math.isnan(stop.over_bound):
        bound = short(stop.bound.braking_distance)
        told.append(f"{100 * stop.over_bound:.0f} % over the bound with this brake ({bound} m)")
    told.append(f"slip ≤ {above(stop.max_slip)}, held {short(stop.held, 2)} of {short(stop.reference)}")
    return "; ".join(told)


def _locks(report: DesignReport, first: Stop) -> str:
    """Whether the wheel locks in some stop on the rail, or else the largest slip, where it is another stop's."""
    others = [stop for stop in report.stops if stop.rail is first.rail]
    where = [f"{stop.law}, {stop.load}" for stop in others if stop.locks]
    if where:
        return f"locks ({'; '.join(where)})"
    most = max(others, key=lambda stop: stop.max_slip)
    return "no lock" if most is first else f"≤ {above(most.max_slip)} with {most.law}, {most.load}; no lock"


def _pictures(report: DesignReport) -> Iterator[Picture]:
    judged = report.judgement
    if judged is None or report.control is None:
        return
    yield Picture(
        "map",
        "Worst Ms over speed and load.",
        f"Worst Ms in cells over speed and load, at the operating points and with tolerances: {judged.verdict_line}",
    )
    yield Picture(
        "loop",
        "The recommended design at its worst points: Bode and Nyquist, the dead time exact.",
        "Magnitude, phase and Nyquist curve of the recommended design at its worst operating point and its worst point "
        f"with tolerances: {'; '.join(one.label for one in report.worst_loops)}",
    )
    if report.stops:
        told = "; ".join(f"{stop.rail}: {_distance(stop)}, {stop_words(stop)}" for stop in report.first_stops)
        yield Picture(
            "stops", "One stop a rail with the recommended design.", f"Speed, slip and torque over time. {told}"
        )
