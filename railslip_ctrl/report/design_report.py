"""A design report as the terminal and `report.json` have it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rich.text import Text

from railslip_ctrl import __version__
from railslip_ctrl.design.judging import Judgement
from railslip_ctrl.report.recommendation import DesignReport, Stop
from railslip_ctrl.simulation import LinearControl

from .html.blocks import FirstPage
from .jsonable import number
from .layout import facts, heading, render, table


def design_report_text(report: DesignReport, first: FirstPage, rest: str) -> str:
    """The first page, and where the rest is."""
    named = [(f"{first.headline}", f"{first.subject}{f'   {first.file}' if first.file else ''}")]
    parts = [
        heading(f"{first.title}   railslip_ctrl {__version__}, {report.date.isoformat()}"),
        facts([*named, *first.lines]),
        table(first.head, first.rows, words=(2,)),
        Text(rest),
    ]
    return render(parts)


def design_report_json(report: DesignReport, files: Iterable[str] = ()) -> dict[str, Any]:
    """The recommendation, the envelope, the candidates, stops and limits; SI but speeds in km/h."""
    judgement = report.judgement
    recommended: dict[str, Any] | None = None
    if report.control is not None and judgement is not None:
        said = (report.in_use or judgement).table()
        recommended = {
            "controller": controller_json(report.control),
            "verdict": judgement.verdict,
            "nominal": judgement.nominal,
            "usable_from_kmh": report.above_kmh,
            "robust_from_kmh": judgement.robust_from_kmh,
            **{name: said[name] for name in ("worst", "worst_with_tolerances")},
            "reference_factor": report.best.reference_factor if report.best is not None else None,
            "map": map_json(judgement),
        }
    return {
        "version": __version__,
        "date": report.date.isoformat(),
        "vehicle": report.vehicle.model_dump(mode="json"),
        "recommended": recommended,
        "envelope": report.envelope.table(),
        "skipped": [] if judgement is None else list(judgement.points.skipped),
        "knife_edges": list(report.envelope.knife_edges()),
        "candidates": [
            {
                "structure": choice.structure,
                "reference_factor": choice.reference_factor,
                "reason": choice.reason,
                "kp_si": None if choice.design is None else choice.design.gains.kp,
                "ki_si": None if choice.design is None else choice.design.gains.ki,
                **_verdict(None if choice.design is None else choice.design.judgement),
            }
            for choice in report.selection.choices
        ],
        "stops": [stop_json(stop) for stop in report.stops],
        "given": [
            {"name": one.name, **one.judgement.table(), "stops": [stop_json(stop) for stop in one.stops]}
            for one in report.rivals
        ],
        "faster_brake": None
        if report.faster is None
        else {"dead_time_s": report.faster.dead_time, "lag_s": report.faster.lag},
        "limits": [
            {
                "rail": point.rail.value,
                "mass_kg": point.vehicle.mass,
                "speed_kmh": point.speed_kmh,
                "ms_lower_bound": number(limits.ms_bound),
                "unstable_pole_per_s": limits.unstable_pole,
            }
            for point, limits in report.limits
        ],
        "sliding": _sliding(report),
        "seconds": number(report.seconds),
        "files": list(files),
    }


def controller_json(control: LinearControl) -> dict[str, Any]:
    """A controller as its TOML has it."""
    import tomllib

    return tomllib.loads(control.toml)


def map_json(judgement: Judgement) -> dict[str, Any]:
    """Worst Ms over speed and load; null where a loop is unstable, or there is none."""
    found = judgement.map
    return {
        "speeds_kmh": found.speeds_kmh.tolist(),
        "loads": list(found.loads),
        "operating": [[number(ms) for ms in row] for row in found.operating.tolist()],
        "with_tolerances": [[number(ms) for ms in row] for row in found.with_tolerances.tolist()],
    }


def stop_json(stop: Stop) -> dict[str, Any]:
    """A stop: numbers of seed 0, and the distances and highest slips of all seeds."""
    run, bound = stop.run, stop.bound
    return {
        "controller": stop.controller,
        "adhesion": stop.law,
        "load": stop.load,
        "rail": stop.rail.value,
        "seed": run.seed,
        "stopped": run.stopped,
        "braking_time_s": number(run.braking_time),
        "braking_distance_m": number(run.braking_distance),
        "bound_m": None if bound is None else number(bound.braking_distance),
        "max_slip": number(run.max_slip),
        "held_slip": number(stop.held),
        "reference_slip": stop.reference,
        "reference_reached": stop.reached,
        "locked_fraction": number(run.locked_fraction),
        "seeds": [one.seed for one in stop.runs],
        "distances_m": [number(one.braking_distance) for one in stop.runs],
        "max_slips": [number(one.max_slip) for one in stop.runs],
        "locks": stop.locks,
    }


def _verdict(judgement: Judgement | None) -> dict[str, Any]:
    if judgement is None:
        return {"verdict": None, "usable_from_kmh": None, "robust_from_kmh": None}
    return {name: getattr(judgement, name) for name in ("verdict", "usable_from_kmh", "robust_from_kmh")}


def _sliding(report: DesignReport) -> dict[str, Any]:
    found = report.sliding.found
    conditions = () if found is None else found.verification.conditions
    return {
        "reason": report.sliding.reason,
        "layered": [{"name": one.name, "holds": one.holds, "how": one.how} for one in conditions],
    }
