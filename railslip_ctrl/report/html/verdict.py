"""The paragraph at the top."""

from __future__ import annotations

import math

from railslip_ctrl.assessment import limits_of
from railslip_ctrl.design_report import DesignReport, Stop

from .numbers import short, where
from .run_sections import below_reference, reproduction_finding


def verdict(report: DesignReport) -> str:
    """What the report finds, in one paragraph: limits, designs, sliding mode, stops, the paper."""
    sentences = [_limits(report), report.check.conclusion, _designs(report), _sliding(report)]
    sentences += [_stop(stop) for stop in report.stops]
    if report.table5 is not None:
        sentences.append(reproduction_finding(report.table5))
    return " ".join(sentence for sentence in sentences if sentence)


def _limits(report: DesignReport) -> str:
    actuator = report.check.vehicle.actuator
    bounds = [(limits_of(plant, actuator), plant.point) for plant in report.plants]
    points = "its operating point" if len(bounds) == 1 else f"its {len(bounds)} operating points"
    worst, point = max(bounds, key=lambda pair: pair[0].unstable_pole)
    if worst.unstable_pole == 0:
        return f"{report.check.vehicle.name}: the wheel is stable by itself at {points}."
    return (
        f"{report.check.vehicle.name}: at {points} the wheel runs away by itself, doubling "
        "its slip "
        f"error in as little as {short(worst.doubling_time, 2)} s ({where(point)}), and no controller gets Ms below "
        f"{short(worst.ms_bound, 3)} there."
    )


def _designs(report: DesignReport) -> str:
    best = report.loops.best
    if best is None:
        return "None of the designs compared holds all operating points."
    return f"Most robust of the designs compared: {best.name}, worst Ms {short(best.worst_ms, 3)}."


def _sliding(report: DesignReport) -> str:
    texts = []
    for name, full in (("published", report.sliding.paper), ("layered", report.sliding.layered)):
        if full is not None:
            count, failing = len(full.verification.conditions), len(full.verification.failing)
            texts.append(f"of the {name} sliding-mode law {failing} of {count} stability conditions fail")
    return "" if not texts else f"{'; '.join(texts)}.".capitalize()


def _stop(stop: Stop) -> str:
    shortest, bound = stop.shortest, stop.bound
    if shortest is None:
        return f"Stop on {stop.title}: no controller stops the train."
    name = next(one.name for one in stop.runs if one.run is shortest)
    text = f"Stop, {stop.title}: shortest with {name}, {short(shortest.braking_distance, 3)} m"
    if bound is not None and math.isfinite(bound.braking_distance):
        text += f" (no controller: below {short(bound.braking_distance, 3)} m)"
    return text + below_reference(shortest) + "."
