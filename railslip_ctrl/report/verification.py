"""Verification of a sliding-mode law as text and JSON; the texts are in `templates/conditions.toml`."""

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
from railslip_ctrl.verification.verdict import Condition, Tolerance, Verification

from .document import Facts, Paragraph, Table, heading, render
from .export import exported

_LAWS = {
    "paper": "published law (45), (49), and the robust variants",
    "robust": "robust variants",
    "predictive": "predictive sliding-mode law",
}
_ACTUATOR = "none (the torque acts at once), except in conditions that mention it"
_HOLDS = {True: ("yes", "holds"), False: ("NO", "DOES NOT HOLD"), None: ("not decided", "NOT DECIDED")}
_ACTUATORS = {"predictive": "lag and dead time in all conditions"}
_CONSTANTS = {"inf": math.inf, "KMH": KMH}


def statement(condition: Condition) -> str:
    """Return the text that states a condition."""
    return _with_numbers(_texts_of(condition)["statement"], condition.numbers)


def evidence(condition: Condition) -> str:
    """Return the evidence for the verdict on a condition, or the reason why it was not decided."""
    return _with_numbers(_texts_of(condition)["evidence"], condition.numbers)


def conclusion_text(law: str, findings: Mapping[str, Any] | None) -> str:
    """Return the conclusion for a brake with lag and dead time; empty without `findings`."""
    return "" if findings is None else _with_numbers(_texts()["conclusion"][law], findings)


def _texts() -> dict[str, Any]:
    return texts(__package__, "templates/conditions.toml")


def _texts_of(condition: Condition) -> dict[str, str]:
    own: dict[str, str] = _texts()[condition.name.split(",")[0] if condition.name not in _texts() else condition.name]
    return own


def _with_numbers(text: str, numbers: Mapping[str, Any]) -> str:
    one_line = filled(_texts()["macros"]["text"] + text, {**_CONSTANTS, **numbers})
    return re.sub(r"(?<=\() | (?=[;,:)]|\.(?![\d.]))", "", one_line)


def verification_json(verification: Verification) -> dict[str, Any]:
    """Return a verification as JSON; `holds` and `how` are null if a condition was not decided.

    - tolerated_errors: largest relative error of each estimate of the law if the others are exact; null if unbounded.
    - tolerances: for each quantity, the largest value at which all conditions hold while the others are as in `box`.
    """
    return {
        "conditions": [
            {
                **{"name": item.name, "statement": statement(item)},
                **exported(item, "holds", "how"),
                "evidence": evidence(item),
                **exported(item, "down_to_kmh", tolerated_errors="tolerated"),
            }
            for item in verification.conditions
        ],
        "all_hold": verification.all_hold,
        **({"box": dict(verification.box)} if verification.box else {}),
        **(
            {
                "tolerances": [
                    exported(item, "name", "value", "unit", "limited_by", "tube") for item in verification.tolerances
                ]
            }
            if verification.box
            else {}
        ),
    }


def verification_text(verification: Verification, about: Sequence[tuple[str, str]] = ()) -> str:
    """Return a verification as text; `about` are pairs (name, value), which are added to the facts at the beginning."""
    known = Facts([*_facts(verification), *about])
    parts: list[RenderableType] = [heading("Conditions of the sliding-mode law"), known, Text("")]
    rows = []
    for item in verification.conditions:
        down_to = "-" if item.down_to_kmh is None else f"{item.down_to_kmh:g} km/h"
        rows.append((item.name, _HOLDS[item.holds][0], down_to, item.how or "-"))
    parts.append(Table(("Condition", "Holds", "Holds down to", "Method"), rows, left=4))
    if verification.box:
        parts += [Text(""), *_box(verification)]
    for item in verification.conditions:
        how = f" ({item.how})" if item.how else ""
        parts += [heading(f"{item.name}: {_HOLDS[item.holds][1]}{how}", "-"), Paragraph(statement(item))]
        parts.append(Paragraph(evidence(item)))
        parts += [Paragraph(f"Tolerated, each alone: {_tolerated(item)}.")] if item.tolerated else []
        parts.append(Text(""))
    parts.append(Text(_verdict(verification)))
    if conclusion := conclusion_text(verification.law, verification.findings):
        parts += [Text(""), heading("Conclusion for the brake with its actuator", "-"), Paragraph(conclusion)]
    return render(parts)


def _box(verification: Verification) -> list[RenderableType]:
    box = verification.box
    speeds, masses = ("{:g} to {:g}".format(*box[name]) for name in ("speed_kmh", "mass_kg"))
    text = (
        f"Box: {box['adhesion']}, {' and '.join(box['rails'])} rail, v {speeds} km/h, slip within "
        f"{100 * box['slip']:g} % of the reference, {masses} kg with the wheel load in proportion, |S| <= "
        f"{box['surface']:g} N m, |e_hat| <= {box['error']:g} m/s, 0 <= Tb <= torque_max, and an observer that "
        "has settled; all other vehicle parameters are those that the law assumes."
    )
    if not verification.tolerances:
        return [Paragraph(f"{text} No tolerances are computed, because reaching is not proved without errors.")]
    rows = [
        (
            item.name.replace("_", " "),
            _limit(item),
            f"{item.tube:.4g}",
            item.limited_by or "no limit in the range tried",
        )
        for item in verification.tolerances
    ]
    columns = ("Largest tolerance, others as in the box", "limit", "|S| falls to, N m", "condition that limits it")
    return [Paragraph(text), Text(""), Table(columns, rows, left=4)]


def _limit(item: Tolerance) -> str:
    if item.name == "lowest_speed":
        return f"from {item.value:.3g} {item.unit} up"
    if item.name == "surface":
        return f"|S| <= {item.value:.0f} {item.unit.replace('*', ' ')}"
    return "+-" + (f"{100 * item.value:.3g} %" if item.unit == "%" else f"{item.value:.3g} {item.unit}")


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


def _tolerated(item: Condition) -> str:
    percent = {name: float(f"{100 * share:.3g}") for name, share in item.tolerated.items()}
    return ", ".join(f"{name} {'any' if math.isinf(x) else f'+-{x:g} %'}" for name, x in percent.items())


def _verdict(verification: Verification) -> str:
    if verification.all_hold:
        return f"Verdict: all {len(verification.conditions)} conditions hold."
    claimed = [item.name for item in verification.failing if item.claimed]
    others = [item.name for item in verification.failing if not item.claimed]
    undecided = [item.name for item in verification.undecided]
    total, failing = len(verification.conditions), len(verification.failing)
    lines = [f"Verdict: {failing} of {total} conditions {'does' if failing == 1 else 'do'} not hold."]
    if undecided:
        was = "was" if len(undecided) == 1 else "were"
        lines[0] = f"{lines[0].removesuffix('.')}, {len(undecided)} {was} not decided."
    titles = ("Claimed or used by [Park2008]:", "Others:", "Not decided:")
    for title, names in zip(titles, (claimed, others, undecided), strict=True):
        lines += [title, *(f"  - {name}" for name in names)] if names else []
    return "\n".join(lines)


def lyapunov_runs_text(cases: Sequence[tuple[str, LyapunovRun]]) -> str:
    """Return three tables on braking runs, with a row for each case.

    The first two tables give the share of time in which each Lyapunov condition holds, and the time of its first
    violation. The third gives the largest |s| and slip error in the last third of each stage of the run.
    """
    names = [condition.name for condition in cases[0][1].conditions]
    # rounded down, so that only a condition that always holds shows 100 %
    rows = [(name, *(f"{math.floor(1000 * item.share) / 10:.1f} %" for item in run.conditions)) for name, run in cases]
    shares = Table(("Share of time it holds", *names), rows)
    rows = [(n, *("never" if c.holds else f"{c.first_violation:.3f}" for c in run.conditions)) for n, run in cases]
    first = Table(("First violation, s", *names), rows)
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
