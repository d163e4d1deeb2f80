"""The sections behind the first page of a design report, which can be left unread: tables and figures."""

from __future__ import annotations

import math

from railslip_ctrl.design.limits import StructureLimit
from railslip_ctrl.design.specification import ROBUST_MS
from railslip_ctrl.model.linearization import linearize
from railslip_ctrl.model.vehicle import doubts
from railslip_ctrl.report.judging import envelope_words
from railslip_ctrl.report.recommendation import DesignReport, Rival
from railslip_ctrl.report.text import law_facts, vehicle_facts
from railslip_ctrl.verification.verdict import Condition

from .blocks import Block, Facts, Paragraph, Picture, Section, Table
from .numbers import NONE, above, below, listed, minus, roots, short
from .typography import typeset

HELD = {"symbolic": "proved", "sampled": "held in all samples", "simulated": "held in all runs"}
"""How a condition that holds was decided."""


_AXES = {
    "speed_kmh": "speed, km/h",
    "slip / reference": "slip over reference",
    "radius_m": "wheel radius, m",
    "dead_time_s": "dead time, s",
    "lag_s": "lag, s",
}
_MOST_TOLD = 8  # of points left out and knife edges


def design_sections(report: DesignReport) -> list[Section]:
    """All of them, in order; what there is nothing to say of is left out."""
    made = (
        _envelope(report),
        _candidates(report),
        _rivals(report),
        _stops(report),
        _gains(report),
        _responses(report),
        _limits(report),
        _adhesion(report),
        _plant(report),
        _sliding(report),
        _paper(report),
    )
    return [section for section in made if section is not None]


def _envelope(report: DesignReport) -> Section:
    envelope, judged = report.envelope, report.judgement
    blocks: list[Block] = [Facts((("Envelope", envelope_words(envelope)),))]
    if judged is not None:
        worst = [("Operating points", judged.worst)]
        worst += [] if judged.nominal else [("With tolerances", judged.worst_with_tolerances)]
        blocks.append(Paragraph(minus(judged.verdict_line) + "."))
        rows = [
            (
                name,
                _ms(one.ms),
                NONE if one.margins is None else below(one.margins.phase_deg),
                NONE if one.margins is None else below(one.margins.delay_s),
                one.case.words,
            )
            for name, one in worst
        ]
        blocks.append(
            Table("Worst cases from the usable speed up.", ("", "Ms", "Phase, deg", "Delay, s", "Case"), rows)
        )
        axes = [
            (
                _AXES.get(axis, axis),
                f"{value:g}" if isinstance(value, float) else str(value),
                f"{100 * share:.3g}",
                _ms(ms),
            )
            for axis, values in judged.by_axis().items()
            if len(values) > 1
            for value, (share, ms) in values.items()
        ]
        head = ("Axis", "Value", "Stable, %", "Worst Ms of these")
        blocks.append(Table("The whole envelope by axis: what costs margin.", head, axes))
    car = envelope.vehicle
    if "loaded" in envelope.loads and car.wheel_load_loaded == car.wheel_load and car.mass_loaded > car.mass:
        blocks.append(Paragraph(f"Loaded, this vehicle has more mass; its wheel load stays {short(car.wheel_load)} N."))
    told = (*(judged.points.skipped if judged is not None else ()), *envelope.knife_edges())
    blocks += [Paragraph(minus(text) + ".") for text in told[:_MOST_TOLD]]
    return Section("envelope", "Envelope and worst cases", tuple(blocks))


def _value(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _ms(ms: float) -> str:
    return "unstable" if math.isinf(ms) else above(ms)


def _candidates(report: DesignReport) -> Section:
    rows = []
    for choice in report.selection.choices:
        judged = None if choice.design is None else choice.design.judgement
        kind = "PI-lead" if choice.structure == "pi-lead" else "PI"
        if judged is None:
            rows.append((kind, f"{choice.reference_factor:g}", *(NONE,) * 6, choice.reason))
            continue
        reaches = "yes" if choice.reaches else f"no: {short(choice.reach_s, 2)} s of {short(choice.stop_s, 2)} s"
        speeds = (_speed(judged.usable_from_kmh), _speed(judged.robust_from_kmh))
        gains = (short(choice.design.gains.kp), short(choice.design.gains.ki))  # type: ignore[union-attr]
        stop = next((short(one.distance(), 3) for one in report.trials if one.choice is choice), NONE)
        rows.append((kind, f"{choice.reference_factor:g}", *gains, *speeds, _ms(judged.worst.ms), stop, reaches))
    head = (
        "Structure", "Slip, of reference", "kp, N·m/(m/s)", "ki, N·m/m", "Stable from, km/h", "Robust from, km/h",
        "Worst Ms", "Mean stop, m", "Reaches its slip",
    )  # fmt: skip
    text = (
        f"Best first: robust (Ms ≤ {ROBUST_MS:g}, stable with every tolerance) from the lowest speed. Of designs level "
        "in that: used from the lowest speed without a slide, then the shortest stops."
    )
    return Section("candidates", "Candidates", (Paragraph(text), Table("What was tried.", head, rows, wide=True)))


def _speed(speed: float | None) -> str:
    return "never" if speed is None else f"{speed:g}"


def _rivals(report: DesignReport) -> Section | None:
    if not report.rivals or report.control is None or report.judgement is None:
        return None
    taken = Rival("recommended", None, report.judgement, report.first_stops)
    rows = [
        (
            one.name,
            one.judgement.verdict,
            _speed(one.judgement.usable_from_kmh),
            _ms(one.judgement.worst.ms),
            _ms(one.judgement.worst_with_tolerances.ms),
            " / ".join(
                f"{short(stop.run.braking_distance)} {stop.rail}{', locks' if stop.locks else ''}"
                for stop in one.stops
                if stop.load == one.stops[0].load
            ),
        )
        for one in (taken, *report.rivals)
    ]
    head = ("Controller", "Verdict", "Stable from, km/h", "Worst Ms", "With tolerances", "Stops, m")
    return Section("given", "Your controller beside it", (Table("Judged and run alike.", head, rows),))


def _stops(report: DesignReport) -> Section | None:
    if not report.stops or report.control is None:
        return None
    rows = []
    for stop in report.stops:
        distances = [run.braking_distance for run in stop.runs]
        bound = NONE if stop.bound is None else short(stop.bound.braking_distance)
        spread = (
            f"{short(min(distances))} to {short(max(distances))}" if all(r.stopped for r in stop.runs) else "no stop"
        )
        highest = above(max(run.max_slip for run in stop.runs))
        held = f"{short(stop.held, 2)} of {short(stop.reference)}"
        rows.append((stop.law, stop.load, str(stop.rail), spread, bound, highest, held, "yes" if stop.locks else "no"))
    head = ("Law", "Load", "Rail", "Distance, m", "Bound, m", "Highest slip", "Slip held", "Locks")
    control, envelope = report.control, report.envelope
    facts = [
        ("Limits", f"{short(control.torque_low)} to {short(control.torque_high)} N·m"),
        ("Starts with", f"{short(control.initial_torque)} N·m"),
        ("Anti-windup", f"back-calculation, {short(control.tracking_time or 0.0)} s"),
        (
            "Hand-over",
            f"below {short(control.cut_out_speed * 3.6)} km/h to {short(control.cut_out_torque)} N·m"
            if control.cut_out_speed > 0
            else "none",
        ),
    ]
    text = (
        f"Stops from {envelope.initial_speed:g} to 5 km/h, {len(report.stops[0].runs)} noise seeds each. The bound is "
        "what no controller of this brake beats; slip held is the median over the second half. "
        "railslip simulate --scenario stop --controller recommended.toml repeats them."
    )
    return Section(
        "stops", "Braking runs", (Paragraph(text), Facts(tuple(facts)), Table("Stops.", head, rows, wide=True))
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
    text = "Linear responses of the recommended design at its worst operating point."
    alt = "Slip velocity and commanded torque over ten seconds after a step of the reference and a step of the load."
    return Section("responses", "Time responses", (Picture("responses", text, alt),))


def _limits(report: DesignReport) -> Section:
    rows = []
    for point, limits in report.limits:
        rows.append(
            (
                str(point.rail),
                short(point.vehicle.mass),
                f"{point.speed_kmh:g}",
                short(limits.unstable_pole, 3),
                below(limits.ms_bound),
                _structure(limits.pi),
                _structure(limits.pi_lead),
                above(limits.longest_dead_time(ROBUST_MS)),
            )
        )
    head = (
        "Rail", "Mass, kg", "Speed, km/h", "Unstable pole, 1/s", "Any linear", "Any PI", "Any PI-lead",
        f"Longest dead time for Ms ≤ {ROBUST_MS:g}, s",
    )  # fmt: skip
    text = "Least Ms that any controller can have, theorems, at the hardest operating point of each rail and load."
    sources = "Interpolation at the unstable pole: [Astrom2021] 14.4, [Sarason1967]."
    return Section(
        "limits", "What no controller beats", (Paragraph(f"{text} {sources}"), Table("Least Ms.", head, rows))
    )


def _structure(limit: StructureLimit | None) -> str:
    if limit is None:
        return NONE
    return below(limit.ms_bound) if limit.feasible else "none holds"


def _adhesion(report: DesignReport) -> Section:
    rows = [
        (
            curve.law,
            str(curve.rail),
            f"{curve.speed_kmh:g}",
            short(curve.peak.coefficient),
            short(curve.peak.slip) if curve.peak.slip > curve.slip[1] else "0 (falls)",
            short(curve.point.slip),
            short(curve.point.adhesion_coefficient),
        )
        for curve in report.curves
    ]
    head = ("Law", "Rail", "Speed, km/h", "Peak μ", "at slip", "Slip held", "μ there")
    laws = listed(dict.fromkeys(curve.law for curve in report.curves))
    alt = f"Adhesion coefficient at rest over slip of {laws}, a panel a rail; circles where slip is held."
    return Section(
        "adhesion",
        "Adhesion",
        (
            Picture("adhesion", "Adhesion at rest over the slip ratio.", alt),
            Table("Peaks, and the slip held.", head, rows),
            Facts(tuple(law_facts(curve.point for curve in report.curves))),
        ),
    )


def _plant(report: DesignReport) -> Section:
    vehicle = report.vehicle
    blocks: list[Block] = [Facts(tuple(row for row in vehicle_facts(vehicle) if row[0] != "Note"))]
    noted = [*vehicle.notes, *(f"To be checked: {one}" for one in doubts(vehicle))]
    blocks += [Paragraph(text) for text in noted]
    points = dict.fromkeys(curve.point for curve in report.curves)
    if report.in_use is not None:
        points = {report.in_use.worst.point: None} | points
    rows = []
    for point in points:
        plant = linearize(point)
        where = f"{point.adhesion}, {point.rail}, {point.speed_kmh:g} km/h"
        rows.append((where, short(point.brake_torque), roots(plant.poles), roots(plant.zeros)))
    head = ("Operating point", "Torque, N·m", "Poles", "Zeros, torque to slip velocity")
    blocks.append(Table("The wheel linearised at constant slip, without the brake.", head, rows))
    return Section("plant", "Vehicle and plant", tuple(blocks))


def _sliding(report: DesignReport) -> Section:
    found = report.sliding.found
    if found is None:
        return Section("sliding", "Sliding mode", (Paragraph(f"Not decided: {report.sliding.reason}."),))
    conditions = found.verification.conditions
    held = [one for one in conditions if one.holds]
    rows = [(typeset(one.name), decided(one)) for one in held]
    text = (
        f"Of the layered law, {len(held)} of {len(conditions)} conditions hold, on the published bristle model. It "
        "needs the holding torque of the rail. railslip verify --law layered has the evidence."
    )
    table = (Table("What holds.", ("Condition", "How"), rows),) if rows else ()
    return Section("sliding", "Sliding mode", (Paragraph(text), *table))


def decided(one: Condition) -> str:
    """How a condition that holds was decided."""
    return HELD[one.how] if one.how is not None else "not decided"


def _paper(report: DesignReport) -> Section | None:
    if not report.published:
        return None
    text = "The numbers of [Park2008], its errata and its gains in both readings: railslip reproduce --out DIR."
    return Section("paper", "The paper", (Paragraph(text),))
