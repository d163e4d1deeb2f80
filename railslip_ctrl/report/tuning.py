"""Text and JSON of tuned designs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from railslip_ctrl.design.judging import Judgement
from railslip_ctrl.design.specification import Worst
from railslip_ctrl.design.tuning import PIDesign, TunedCases
from railslip_ctrl.loop import Margins
from railslip_ctrl.model.linearization import OperatingPoint
from railslip_ctrl.report.laws import source_at, words_at

from .jsonable import case_json, margin_numbers, number
from .judging import judgement_parts
from .laws import law_json
from .layout import facts, fixed, heading, render, table
from .text import case_title, controller_text


def tuning_json(tuned: TunedCases, judgement: Judgement | None = None) -> dict[str, Any]:
    """The design and its margins at every case, and its judgement over an envelope; of an infeasible one null, with
    the reason."""
    design = tuned.design
    asked = tuned.specification.ms_max
    return {
        "structure": tuned.structure,
        "kp_si": None if design is None else design.kp,
        "ki_si": None if design is None else design.ki,
        "lead_s": tuned.lead,
        "lead_filter_s": tuned.lead_filter,
        "ms_max_asked": asked,
        "worst": None if design is None else _worst_json(design.worst, tuned.points),
        "cases": [
            {**case_json(point), "adhesion_law": law_json(point.law, source_at(point)), **margin_numbers(margins)}
            for point, margins in zip(tuned.points, _margins(tuned), strict=True)
        ],
        "feasible": design is not None,
        "reason": tuned.reason,
        **({} if judgement is None else judgement.table()),
    }


def _margins(tuned: TunedCases) -> Sequence[Margins | None]:
    return [None] * len(tuned.points) if tuned.design is None else tuned.design.margins


def _worst_json(worst: Worst, points: Sequence[OperatingPoint]) -> dict[str, Any]:
    return {
        "ms": number(worst.ms),
        "phase_margin_deg": number(worst.phase_deg),
        "delay_margin_s": number(worst.delay_s),
        "case": case_json(points[worst.ms_member]),
    }


def tuning_text(tuned: TunedCases, judgement: Judgement | None = None) -> str:
    """The design, its worst case, and its margins at every case, or its judgement over an envelope."""
    parts: list[RenderableType] = [heading(_title(tuned))]
    if tuned.design is None:
        parts += [facts([_law_fact(tuned), ("Asked for", tuned.asked), ("Result", f"infeasible: {tuned.reason}")])]
        return render(parts)
    design = tuned.design
    parts.append(facts(_design_facts(tuned, design)))
    if judgement is not None:
        return render([*parts, Text(""), *judgement_parts(judgement)])
    parts.append(_case_table(tuned.points, design.margins))
    verdict = f"worst Ms {design.worst.ms:.4g} at {case_title(tuned.points[design.worst.ms_member])}"
    alone = [point.vehicle.mass_alone for point in tuned.points if point.vehicle.mass_alone]
    parts.append(Text(f"Verdict: {verdict}, of the operating points alone{'. ' + alone[0] if alone else ''}"))
    return render(parts)


def _title(tuned: TunedCases) -> str:
    count = len(tuned.points)
    name = {"pi": "PI", "pi-lead": "PI-lead", "pid": "PID (series form)"}[tuned.structure]
    return f"Tuning: {name} at {count} operating point{'s' if count != 1 else ''}"


def _design_facts(tuned: TunedCases, design: PIDesign) -> list[tuple[str, str]]:
    return [
        _law_fact(tuned),
        ("Asked for", tuned.asked),
        ("Controller", controller_text(tuned.controller(design))),
        ("Worst phase margin", f"{fixed(design.worst.phase_deg)} deg"),
        ("Worst delay margin", f"{fixed(design.worst.delay_s)} s"),
    ]


def _law_fact(tuned: TunedCases) -> tuple[str, str]:
    laws = dict.fromkeys(words_at(point) for point in tuned.points)
    return "Adhesion", ", ".join(laws)


def _case_table(points: Sequence[OperatingPoint], margins: Sequence[Margins]) -> RenderableType:
    rows = []
    for p, m in zip(points, margins, strict=True):
        where = f"{p.rail}, {p.speed_kmh:g} km/h, {p.vehicle.mass:g} kg"
        decrease = fixed(m.gain_decrease, 4) if m.gain_decrease > 0 else "unbounded"
        numbers = (decrease, *(fixed(x, 4) for x in (m.gain_increase, m.phase_deg, m.delay_s, m.ms, m.mt)))
        rows.append((where, *numbers))
    return table(("Case", "Gain −", "Gain +", "Phase, deg", "Delay, s", "Ms", "Mt"), rows)
