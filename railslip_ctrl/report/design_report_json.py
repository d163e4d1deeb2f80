"""A design report as plain dictionaries for JSON: all that `report.html` shows, section by section."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from railslip_ctrl.design.controllers import PIController
from railslip_ctrl.design.effort import Effort
from railslip_ctrl.design.limits import Limits, StructureLimit
from railslip_ctrl.design_report import (
    Attempt,
    DesignReport,
    GainRegion,
    LawCurve,
    LoopDesign,
    RangeLine,
    Shortfall,
    SlidingVerdict,
    SlowEnd,
    SlowRun,
    SpeedRange,
    Stop,
    StopRun,
)
from railslip_ctrl.linearization import LinearPlant
from railslip_ctrl.reproduction import READING
from railslip_ctrl.sliding.erratum import Erratum
from railslip_ctrl.sliding_verification import FullVerification

from .html.closing_sections import unchecked
from .html.loop_sections import SETTLED
from .html.page import cited_sources
from .html.range_sections import RANGE
from .html.sliding_sections import PAPER_LAW
from .html.verdict import gains_not_computed, verdict
from .jsonable import case_json, design_check_json, linear_plant_json, margin_numbers, number
from .provenance import Provenance, software
from .reproduction import row_json
from .simulation import simulation_json

KEY_OF_SECTION = {"margins": "groups", PAPER_LAW: "sliding"}
"""Where a section of the page, by its anchor, stands under a key of another name."""


def design_report_json(
    report: DesignReport, page: str, provenance: Provenance, files: Iterable[str] = ()
) -> dict[str, Any]:
    """The design check's keys as they are without the page, and one for every other section of the page.

    `page` is the HTML; the sources are those that it cites.
    """
    found = verdict(report)
    return design_check_json(report.whole_check, files) | {
        "verdict": {"paragraph": found.paragraph, "numbers": dict(found.numbers), "points": dict(found.points)},
        "adhesion": [_curve(curve) for curve in report.curves],
        "linearisation": [linear_plant_json(plant) for plant in report.plants],
        "limits": [_limits(*pair) for pair in zip(report.plants, report.limits, strict=True)],
        "region": _region(report.region),
        "designs": _designs(report),
        RANGE: _speeds(report.loops.speeds),
        "sliding": _sliding(report.sliding),
        "stops": [_stop(stop) for stop in report.stops],
        "reproduction": _reproduction(report),
        "errata": [_erratum(one) for one in report.errata],
        "unchecked": list(unchecked(report)),
        "sources": cited_sources(page),
        "provenance": {
            "command": provenance.command,
            "options": dict(provenance.options),
            "software": software(),
            "not_computed": list(gains_not_computed(report)),
            "from_cache": list(report.from_cache),
            "seconds": report.seconds,
        },
    }


# --- linear loops ---------------------------------------------------------------------------------------------------


def _curve(curve: LawCurve) -> dict[str, Any]:
    return {
        "law": curve.law,
        "title": curve.title,
        "parameters": curve.parameters,
        "rail": curve.rail.value,
        "speed_kmh": curve.speed_kmh,
        "asked": curve.asked,
        "peak": {"slip": curve.peak.slip, "coefficient": curve.peak.coefficient},
        "operating_points": [{**case_json(point), "coefficient": point.adhesion_coefficient} for point in curve.points],
        "slip": curve.slip.tolist(),
        "coefficient": curve.coefficient.tolist(),
    }


def _limits(plant: LinearPlant, limits: Limits) -> dict[str, Any]:
    crossover = limits.crossover_range
    return {
        **case_json(plant.point),
        "unstable_pole_rad_s": limits.unstable_pole,
        "doubling_time_s": number(limits.doubling_time),
        "pole_times_dead_time_and_lag": limits.actuator_product,
        "ms_lower_bound": number(limits.ms_bound),
        "mt_lower_bound": number(limits.mt_bound),
        "bode_integral_rad_s": limits.bode_integral,
        "pi": _structure(limits.pi),
        "pi_lead": _structure(limits.pi_lead),
        "crossover_range_rad_s": None if crossover is None else [number(end) for end in crossover],
    }


def _structure(limit: StructureLimit | None) -> dict[str, Any] | None:
    if limit is None:
        return None
    return {
        "feasible": limit.feasible,
        "phase_margin_upper_bound_deg": number(limit.phase_deg),
        "ms_lower_bound": number(limit.ms_bound),
    }


def _region(region: GainRegion) -> dict[str, Any]:
    grid = region.grid
    return {
        "kp_range_si": None if region.kp_range is None else [number(k) for k in region.kp_range],
        "strips": [
            {
                "kp_si": one.kp.tolist(),
                "ki_low_si": one.ki_low.tolist(),
                "ki_high_si": one.ki_high.tolist(),
                "goes_on_in": [name for name, cut in (("kp", one.kp_cut), ("ki", one.ki_cut)) if cut],
            }
            for one in region.strips
        ],
        "margins": None
        if grid is None
        else {
            "kp_si": grid.kp.tolist(),
            "ki_si": grid.ki.tolist(),
            **{name: _finite(getattr(grid, name)) for name in ("ms", "phase_deg", "delay_s")},
        },
        "chosen": {
            name: {"kp_si": gains[0], "ki_si": gains[1], "in_picture": region.near(gains)}
            for name, gains in region.chosen.items()
        },
        "reason": region.reason,
    }


def _finite(rows: Any) -> list[list[float | None]]:
    """A table of numbers by rows, null outside the region."""
    return [[number(x) for x in row] for row in rows]


def _designs(report: DesignReport) -> dict[str, Any]:
    loops = report.loops
    best, taken = loops.best, loops.recommended
    endless = () if taken is None else report.endless(taken.name)
    return {
        "designs": [_design(one) for one in loops.designs],
        "least_worst_ms": None if best is None else best.name,
        "recommended": None if taken is None or endless else taken.name,
        "recommended_by_its_margins_alone": None if taken is None else taken.name,
        "does_not_stop": list(endless),
        "refused": dict(loops.refused),
        "no_robust_design": _shortfall(loops.shortfall),
        "known_rules_and_predictors": [_attempt(one) for one in loops.attempts],
        "shown_at": case_json(loops.shown_at),
        "reference_steps": {
            name: {
                "overshoot": number(step.overshoot),
                "settling_time_s": number(step.settling_time(step.reference, SETTLED * step.reference)),
            }
            for name, step in loops.reference.items()
        },
    }


def _speeds(speeds: SpeedRange | None) -> dict[str, Any] | None:
    if speeds is None:
        return None
    return {
        "design": speeds.name,
        "speeds_kmh": speeds.lines[0].speeds_kmh.tolist(),
        "stable_from_kmh": number(speeds.stable_from),
        "robust_from_kmh": number(speeds.robust_from),
        "lines": [_line(line) for line in speeds.lines],
        "skipped": list(speeds.skipped),
    }


def _line(line: RangeLine) -> dict[str, Any]:
    of = line.margins
    return {
        "adhesion": line.law,
        "rail": line.rail.value,
        "mass_kg": line.mass,
        "slip": line.slip,
        "tuned_for": line.tuned,
        "stable_from_kmh": number(line.stable_from),
        "robust_from_kmh": number(line.robust_from),
        "stable": [bool(one) for one in of.stable],
        "gain_decrease": [number(x) for x in of.gain_decrease],
        "gain_increase": [number(x) for x in of.gain_increase],
        "phase_margin_deg": [number(x) for x in of.phase_deg],
        "delay_margin_s": [number(x) for x in of.delay_s],
        "ms": [number(x) for x in of.ms],
    }


def _design(one: LoopDesign) -> dict[str, Any]:
    return {
        "name": one.name,
        "how": one.how,
        "origin": one.origin.value,
        **_gains(one.controller),
        "stable": one.stable,
        "worst_ms": number(one.worst_ms),
        "cases": [
            {
                **case_json(assessment.point),
                **margin_numbers(assessment.margins),
                "verdict": assessment.verdict.value,
                "effort": _effort(effort),
            }
            for assessment, effort in zip(one.assessments, one.efforts, strict=True)
        ],
    }


def _effort(effort: Effort | None) -> dict[str, float | None] | None:
    if effort is None:
        return None
    return {
        "noise_gain_si": number(effort.noise_gain),
        "reference_rate_nm_per_s": number(effort.reference_rate),
        "disturbance_rate_nm_per_s": number(effort.disturbance_rate),
    }


def _shortfall(found: Shortfall | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "case": case_json(found.point),
        "ms_lower_bound": number(found.limits.ms_bound),
        "dead_time_s": found.limits.dead_time,
        "lag_s": found.limits.lag,
        "dead_time_upper_bound_of_any_linear_controller_s": number(found.longest_dead_time),
        "dead_time_of_least_ms_design_s": found.lead_dead_time,
        "least_ms_design_of_each_case_alone": [_attempt(one) for one in found.alone],
    }


def _gains(controller: PIController) -> dict[str, float]:
    gains = {"kp_si": controller.gains.kp, "ki_si": controller.gains.ki}
    return {**gains, "lead_s": controller.lead, "lead_filter_s": controller.lead_filter}


def _attempt(one: Attempt) -> dict[str, Any]:
    made = {} if one.controller is None else _gains(one.controller)
    return {"name": one.name, **case_json(one.point), **made, **margin_numbers(one.margins), "reason": one.reason}


# --- sliding mode, runs, the paper ----------------------------------------------------------------------------------


def _sliding(sliding: SlidingVerdict) -> dict[str, Any]:
    return {
        "paper": _verified(sliding.paper, sliding.gains.get("paper", ())),
        "layered": _verified(sliding.layered, sliding.gains.get("layered", ())),
        "reasons": dict(sliding.reasons),
    }


def _verified(full: FullVerification | None, gains: Iterable[tuple[str, float, str]]) -> dict[str, Any] | None:
    if full is None:
        return None
    one = full.verification
    return {
        "K_nm": one.K,
        "D_si": one.D,
        "gains": [{"name": name, "value": value, "unit": unit} for name, value, unit in gains],
        "inertia_scale": one.inertia_scale,
        "seed": one.seed,
        "conclusion": full.conclusion,
        "conditions": [
            {
                "name": each.name,
                "statement": each.statement,
                "claimed_by_the_paper": each.claimed,
                "holds": each.holds,
                "how": each.how,
                "evidence": each.evidence,
            }
            for each in one.conditions
        ],
    }


def _stop(stop: Stop) -> dict[str, Any]:
    bound = stop.bound
    return {
        "title": stop.title,
        "scenario": stop.scenario.name,
        "rail": stop.scenario.rail.value,
        "adhesion": stop.scenario.adhesion.name,
        "adhesion_is_dynamic": stop.scenario.adhesion.has_state,
        "seed": stop.seed,
        "runs": [_run(one) for one in stop.runs],
        "runs_with_the_dynamic_law": [_run(one) for one in stop.dynamic],
        "below_its_range": [_slow(one) for one in stop.slow],
        "bound": None
        if bound is None
        else {"braking_time_s": number(bound.braking_time), "braking_distance_m": number(bound.braking_distance)},
    }


def _run(one: StopRun) -> dict[str, Any]:
    told = None if one.run is None else simulation_json(one.run, None)
    worst = {
        "highest_slip_of_seeds": number(one.highest_slip),
        "most_locked_fraction_of_seeds": one.most_locked,
        "seeds_that_lock": list(one.locking_seeds),
        "seeds_that_do_not_stop": list(one.endless_seeds),
    }
    return {"name": one.name, "reason": one.reason, "run": told, "distances_m": list(one.distances), **worst}


def _slow(end: SlowEnd) -> dict[str, Any]:
    return {
        "adhesion": end.law,
        "rail": str(end.rail),
        "controller": end.name,
        "reference_slip": end.reference,
        "from_kmh": end.from_kmh,
        "usual_end_kmh": end.usual_kmh,
        "to_kmh": end.least_kmh,
        "torque_held_nm": end.torque,
        "torque_held_locks_from_kmh": number(end.held_locks_at),
        "friction_that_it_needs": number(end.friction_needed),
        "friction_there_is": number(end.friction_there),
        "torque_of_that_friction_nm": number(end.torque_there),
        "controlled": [_slow_run(one) for one in end.controlled],
        "undisturbed": [_slow_run(one) for one in end.undisturbed],
        "handed_over_to_a_held_torque": [_slow_run(one) for one in end.handed_over],
    }


def _slow_run(one: SlowRun) -> dict[str, Any]:
    return {
        "mass_kg": one.mass,
        "seed": one.seed,
        "highest_slip": one.highest_slip,
        "highest_slip_to_usual_end": one.highest_slip_usual,
        "over_twice_its_reference_from_kmh": number(one.beyond_kmh),
        "locked_from_kmh": number(one.locked_kmh),
    }


def _reproduction(report: DesignReport) -> dict[str, Any] | None:
    comparison = report.table5
    if comparison is None:
        return None
    return {
        "rows": [row_json(row) for row in comparison.rows],
        "seeds": comparison.seeds,
        "rms_deviation_percent": number(comparison.rms_deviation_percent),
        "all_within": comparison.within,
        "reading": [{"rule": r.name, "used": r.used, "basis": r.basis.value, "where": r.where} for r in READING],
        "facts": [
            {"name": f.name, "statement": f.statement, "found": f.found, "holds": f.holds, "how": f.how}
            for f in report.facts
        ],
    }


def _erratum(one: Erratum) -> dict[str, Any]:
    return {
        "where": one.where,
        "printed": one.printed,
        "derived": one.derived,
        "printed_latex": one.printed_latex,
        "derived_latex": one.derived_latex,
        "agrees": one.agrees,
        "how": one.how,
        "sign_and_size": one.sign_and_size,
        "explanation": one.explanation,
    }
