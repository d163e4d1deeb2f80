"""Text and JSON of a verification, and of runs judged by the Lyapunov conditions.

The texts of conditions, evidence and conclusions are in `templates/conditions.toml`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from railslip_ctrl.core.templates import filled, texts
from railslip_ctrl.core.units import KMH
from railslip_ctrl.verification.lyapunov_runs import LyapunovRun
from railslip_ctrl.verification.verdict import Condition, Verification

from .document import Facts, Paragraph, Table, heading, render
from .export import exported

_LAWS = {
    "paper": "published law (45), (49), and the robust variants",
    "robust": "robust variants",
    "predictive": "predictive sliding-mode law",
}
_ACTUATOR = "none (the torque acts at once), except in conditions that name it"
_HOLDS = {True: ("yes", "holds"), False: ("NO", "DOES NOT HOLD"), None: ("not decided", "NOT DECIDED")}
_ACTUATORS = {"predictive": "lag and dead time throughout"}
_CONSTANTS = {"inf": math.inf, "KMH": KMH}


def statement(condition: Condition) -> str:
    """Return the statement of a condition as text."""
    return _with_numbers(_texts_of(condition)["statement"], condition.numbers)


def evidence(condition: Condition) -> str:
    """Return the evidence: the identity, or numbers and their set, or the reason why it was not decided."""
    return _with_numbers(_texts_of(condition)["evidence"], condition.numbers)


def conclusion_text(law: str, findings: Mapping[str, Any] | None) -> str:
    """Return the conclusion for the brake with its actuator, from the findings of a law's verification."""
    return "" if findings is None else _with_numbers(_texts()["conclusion"][law], findings)


def _texts() -> dict[str, Any]:
    return texts(__package__, "templates/conditions.toml")


def _texts_of(condition: Condition) -> dict[str, str]:
    own: dict[str, str] = _texts()[condition.name.split(",")[0] if condition.name not in _texts() else condition.name]
    return own


def _with_numbers(text: str, numbers: Mapping[str, Any]) -> str:
    """Return a text with its numbers filled in, in one line."""
    one_line = filled(_texts()["macros"]["text"] + text, {**_CONSTANTS, **numbers})
    return re.sub(r"(?<=\() | (?=[;,:)]|\.(?![\d.]))", "", one_line)


def verification_json(verification: Verification) -> dict[str, Any]:
    """Return a verification as JSON: the conditions in order, and whether all hold.

    `holds` and `how` are None for a condition that was not decided. For a law verified over a box the result has the
    `box`, and in `tolerances` the largest value of each quantity with the others as in the box. `down_to_kmh` and
    `tolerated_errors` (shares in both directions, None if unbounded) are those of `Condition`.
    """
    return {
        "conditions": [
            {
                **{"name": one.name, "statement": statement(one)},
                **exported(one, "holds", "how"),
                "evidence": evidence(one),
                **exported(one, "down_to_kmh", tolerated_errors="tolerated"),
            }
            for one in verification.conditions
        ],
        "all_hold": verification.all_hold,
        **({"box": dict(verification.box)} if verification.box else {}),
        **(
            {"tolerances": [exported(one, "name", "value", "unit", "limited_by") for one in verification.tolerances]}
            if verification.box
            else {}
        ),
    }


def verification_text(verification: Verification, about: Sequence[tuple[str, str]] = ()) -> str:
    """Return a verification as text: table of verdicts, conditions with evidence, failures and conclusion.

    `about`: further rows of the header on vehicle and adhesion, as (name, value).
    """
    known = Facts([*_facts(verification), *about])
    parts: list[RenderableType] = [heading("Conditions of the sliding-mode law"), known, Text("")]
    rows = []
    for one in verification.conditions:
        down_to = "-" if one.down_to_kmh is None else f"{one.down_to_kmh:g} km/h"
        rows.append((one.name, _HOLDS[one.holds][0], down_to, one.how or "-"))
    parts.append(Table(("Condition", "Holds", "Down to", "How"), rows, left=4))
    if verification.box:
        parts += [Text(""), *_box(verification)]
    for one in verification.conditions:
        how = f" ({one.how})" if one.how else ""
        parts += [heading(f"{one.name}: {_HOLDS[one.holds][1]}{how}", "-"), Paragraph(statement(one))]
        parts.append(Paragraph(evidence(one)))
        parts += [Paragraph(f"Tolerated, each alone: {_tolerated(one)}.")] if one.tolerated else []
        parts.append(Text(""))
    parts.append(Text(_verdict(verification)))
    if conclusion := conclusion_text(verification.law, verification.findings):
        parts += [Text(""), heading("Conclusion for the brake with its actuator", "-"), Paragraph(conclusion)]
    return render(parts)


def _box(verification: Verification) -> list[RenderableType]:
    """Return the box, and the table of the largest value of each quantity."""
    box = verification.box
    speeds, masses = ("{:g} to {:g}".format(*box[name]) for name in ("speed_kmh", "mass_kg"))
    text = (
        f"Box: {box['adhesion']}, {' and '.join(box['rails'])} rail, v {speeds} km/h, slip within "
        f"{100 * box['slip']:g} % of the reference, {masses} kg with the wheel load in proportion, |S| <= "
        f"{box['surface']:g} N m, |e_hat| <= {box['error']:g} m/s, 0 <= Tb <= torque_max; otherwise the vehicle is as "
        "the law assumes."
    )
    if not verification.tolerances:
        return [Paragraph(text)]
    rows = [
        (
            one.name.replace("_", " "),
            f"{100 * one.value:.3g} %" if one.unit == "%" else f"{one.value:.3g} {one.unit}",
            one.limited_by or "not limited in the range tried",
        )
        for one in verification.tolerances
    ]
    columns = ("Largest tolerance, the others as in the box", "either way", "condition not proved beyond")
    return [Paragraph(text), Text(""), Table(columns, rows, left=3)]


def _facts(verification: Verification) -> list[tuple[str, str]]:
    reading = {1.0: " (SI)", 3.6: " (as published)"}.get(verification.inertia_scale, "")
    unit = "N m/s" if verification.law == "predictive" else "N m"
    return [
        ("Law", _LAWS[verification.law]),
        ("K", f"{verification.K:.5g} {unit}"),
        *([] if verification.D is None else [("D", f"{verification.D:.5g} N m/(m/s)")]),
        ("Inertia scale", f"{verification.inertia_scale:g}{reading}"),
        ("First seed", str(verification.seed)),
        ("Actuator", _ACTUATORS.get(verification.law, _ACTUATOR)),
    ]


def _tolerated(one: Condition) -> str:
    percent = {name: float(f"{100 * share:.3g}") for name, share in one.tolerated.items()}
    return ", ".join(f"{name} {'any' if math.isinf(x) else f'+-{x:g} %'}" for name, x in percent.items())


def _verdict(verification: Verification) -> str:
    if verification.all_hold:
        return f"Verdict: all {len(verification.conditions)} conditions hold."
    claimed = [one.name for one in verification.failing if one.claimed]
    others = [one.name for one in verification.failing if not one.claimed]
    undecided = [one.name for one in verification.undecided]
    total, failing = len(verification.conditions), len(verification.failing)
    lines = [f"Verdict: {failing} of {total} conditions {'does' if failing == 1 else 'do'} not hold."]
    if undecided:
        was = "was" if len(undecided) == 1 else "were"
        lines[0] = f"{lines[0].removesuffix('.')}, {len(undecided)} {was} not decided."
    titles = ("Claimed or relied on by [Park2008]:", "Others:", "Not decided:")
    for title, names in zip(titles, (claimed, others, undecided), strict=True):
        lines += [title, *(f"  - {name}" for name in names)] if names else []
    return "\n".join(lines)


# --- runs judged by the Lyapunov conditions ---------------------------------------------------------------------------


def lyapunov_runs_text(cases: Sequence[tuple[str, LyapunovRun]]) -> str:
    """Return tables of shares of time, first violations and ultimate bounds, with a row for each case."""
    names = [condition.name for condition in cases[0][1].conditions]
    # rounded down, so that only a condition that always holds shows 100 %
    rows = [(name, *(f"{math.floor(1000 * one.share) / 10:.1f} %" for one in run.conditions)) for name, run in cases]
    shares = Table(("Share of the time each holds", *names), rows)
    broken = [(n, *("never" if one.holds else f"{one.first_violation:.3f}" for one in r.conditions)) for n, r in cases]
    first = Table(("First violation, s", *names), broken)
    columns = ("Last third of each stage", "outcome", "time s", "largest |s| m/s", "largest slip error", "locked %")
    bounds = Table(columns, [_bounds(name, run) for name, run in cases], left=2)
    return render([heading("Lyapunov conditions along braking runs"), shares, first, bounds])


def _bounds(name: str, run: LyapunovRun) -> tuple[str, ...]:
    return (
        name,
        str(run.run.outcome),
        f"{run.run.braking_time:.1f}",
        ", ".join(f"{s:.2f}" for s, _ in run.ultimate),
        ", ".join(f"{slip_error:.3f}" for _, slip_error in run.ultimate),
        f"{100 * run.run.locked_fraction:.1f}",
    )
