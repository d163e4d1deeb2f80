"""JSON form of the design report of a vehicle."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from typing import Any

from railslip_ctrl import __version__
from railslip_ctrl.controllers.pi import PI
from railslip_ctrl.design.envelope_tuning import StructureChoice
from railslip_ctrl.design.judging import Judgement
from railslip_ctrl.report.candidates import Trial
from railslip_ctrl.report.recommendation import DesignReport, Rival
from railslip_ctrl.report.stops import Stop

from .design_report import used_from
from .export import exported, plain


def _gains_json(choice: StructureChoice) -> dict[str, float | None]:
    own = None if choice.design is None else choice.design.controller
    return {"kp_si": own.kp, "ki_si": own.ki} if isinstance(own, PI) else {"kp_si": None, "ki_si": None}


def design_report_json(report: DesignReport, files: Iterable[str] = ()) -> dict[str, Any]:
    """Return a design report as JSON, in SI except speeds in km/h; `files` are the names of its files."""
    judgement = report.judgement
    return {
        "version": __version__,
        "date": report.date.isoformat(),
        "vehicle": plain(report.vehicle),
        "recommended": _recommended(report),
        "envelope": report.judged_envelope.table(),
        "skipped": [] if judgement is None else list(judgement.points.skipped),
        "knife_edges": list(report.envelope.knife_edges() if judgement is None else judgement.slip_notes),
        "candidates": [
            {
                **exported(choice, "structure", "reference_factor", "reason"),
                **_gains_json(choice),
                **_from_speeds(None if choice.design is None else choice.design.judgement, report.trial_of(choice)),
            }
            for choice in report.selection.choices
        ],
        "stops": [_stop_json(stop) for stop in report.stops],
        "harder_stops": [_stop_json(stop) for stop in report.harder_stops],
        "seeking": [_stop_json(stop) for stop in (() if report.seeking is None else report.seeking.stops)],
        "given": [
            {
                "name": item.name,
                **({"verdict": None, "reason": item.reason} if item.judgement is None else item.judgement.table()),
                **_from_speeds(item.judgement, item),
                "stops": [_stop_json(stop) for stop in item.stops],
            }
            for item in report.rivals
        ],
        "prefer": report.prefer,
        "trials": [_trial_json(trial) for trial in report.trials],
        "remedy": report.remedy
        and {"brake": report.remedy.description, "mean_stop_m": plain(report.remedy.trial.distance())},
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
                exported(item, "name", "holds", "how")
                for item in (() if report.sliding.verification is None else report.sliding.verification.conditions)
            ],
        },
        "no_lock": [
            {
                **exported(item.stop, "load", "rail", adhesion="law"),
                **exported(item.certified, "share", "outside_kmh"),
                "reason": item.reason,
            }
            for item in report.released
        ],
        "seconds": plain(report.seconds),
        "files": list(files),
    }


def _trial_json(trial: Trial) -> dict[str, Any]:
    return {
        **exported(trial.choice, "structure", "reference_factor"),
        "usable_from_kmh": used_from(trial),
        "mean_stop_m": plain(trial.distance()),
        "mean_stop_as_given_m": plain(trial.distance_as_given()),
        "worst_ms": plain(trial.worst_ms),
        **exported(trial, "air", "locked", "reason"),
    }


def _recommended(report: DesignReport) -> dict[str, Any] | None:
    judgement = report.judgement
    if report.control is None:
        return None
    if judgement is None:
        return {
            "controller": tomllib.loads(report.control.toml),
            "verdict": None,
            "usable_from_kmh": used_from(report),
        }
    table = (report.in_use or judgement).table()
    return {
        "controller": tomllib.loads(report.control.toml),
        "nominal": judgement.nominal,
        **_from_speeds(judgement, report),
        "worst": table["worst"],
        "worst_with_tolerances": table["worst_with_tolerances"],
        "reference_factor": report.best.reference_factor if report.best is not None else None,
        "map": exported(judgement.map, "speeds_kmh", "loads", "operating", "with_tolerances"),
    }


def _from_speeds(judgement: Judgement | None, ran: DesignReport | Trial | Rival | None) -> dict[str, Any]:
    named = {"stable_from_kmh": "usable_from_kmh"}
    return {**exported(judgement, "verdict", "robust_from_kmh", **named), "usable_from_kmh": used_from(ran)}


def _stop_json(stop: Stop) -> dict[str, Any]:
    of_stop = {"adhesion": "law", "held_slip": "settled_slip", "errors": "errors"}
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
