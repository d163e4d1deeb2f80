"""Text and JSON of a verification, and of runs judged by the Lyapunov conditions."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from railslip_ctrl.report.layout import facts, heading, indented, render, table
from railslip_ctrl.verification.lyapunov_runs import LyapunovRun
from railslip_ctrl.verification.verdict import Condition, Verification

_LAWS = {
    "paper": "published law (45), (49), and the robust variants",
    "robust": "robust variants",
    "layered": "layered law with a lead on the actuator's lag",
}
_ACTUATOR = "none (the torque acts at once) but where a condition names it"
_HOLDS = {True: ("yes", "holds"), False: ("NO", "DOES NOT HOLD"), None: ("not decided", "NOT DECIDED")}
_ACTUATORS = {"layered": "lag and dead time throughout"}


def verification_json(verification: Verification) -> dict[str, Any]:
    """The conditions in order, and whether all hold; of one that was not decided `holds` and `how` are None.

    `down_to_kmh` and `tolerated_errors` (shares either way, None without bound) as of `Condition`.
    """
    return {
        "conditions": [
            {
                "name": one.name,
                "statement": one.statement,
                "holds": one.holds,
                "how": one.how,
                "evidence": one.evidence,
                "down_to_kmh": one.down_to_kmh,
                "tolerated_errors": {
                    name: share if math.isfinite(share) else None for name, share in one.tolerated.items()
                },
            }
            for one in verification.conditions
        ],
        "all_hold": verification.all_hold,
    }


def verification_text(verification: Verification, conclusion: str = "", about: Sequence[tuple[str, str]] = ()) -> str:
    """A table of verdicts, every condition with its evidence, what fails, and what an engineer may conclude.

    `about`: what else the head says of vehicle and adhesion, names and values.
    """
    known = facts([*_facts(verification), *about])
    parts: list[RenderableType] = [heading("Conditions of the sliding-mode law"), known, Text("")]
    rows = [(one.name, _HOLDS[one.holds][0], _down_to(one), one.how or "-") for one in verification.conditions]
    parts.append(table(("Condition", "Holds", "Down to", "How"), rows, left=4))
    for one in verification.conditions:
        parts += _paragraphs(one)
    parts.append(Text(_verdict(verification)))
    if conclusion:
        parts += [Text(""), heading("Conclusion for the brake with its actuator", "-"), indented(conclusion)]
    return render(parts)


def _facts(verification: Verification) -> list[tuple[str, str]]:
    reading = {1.0: " (SI)", 3.6: " (as published)"}.get(verification.inertia_scale, "")
    return [
        ("Law", _LAWS[verification.law]),
        ("K", _authority(verification)),
        *([] if verification.D is None else [("D", f"{verification.D:.5g} N m/(m/s)")]),
        ("Inertia scale", f"{verification.inertia_scale:g}{reading}"),
        ("First seed", str(verification.seed)),
        ("Actuator", _ACTUATORS.get(verification.law, _ACTUATOR)),
    ]


def _authority(verification: Verification) -> str:
    if verification.law == "layered" and verification.K == 0.0:
        return "none, as there is no law"
    return f"{verification.K:.5g} N m"


def _paragraphs(one: Condition) -> list[RenderableType]:
    how = f" ({one.how})" if one.how else ""
    return [
        heading(f"{one.name}: {_HOLDS[one.holds][1]}{how}", "-"),
        indented(one.statement),
        indented(one.evidence),
        *([indented(f"Tolerated, each alone: {_tolerated(one)}.")] if one.tolerated else []),
        Text(""),
    ]


def _down_to(one: Condition) -> str:
    return "-" if one.down_to_kmh is None else f"{one.down_to_kmh:g} km/h"


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
        lines[0] = (
            f"{lines[0].removesuffix('.')}, {len(undecided)} {'was' if len(undecided) == 1 else 'were'} not decided."
        )
    titles = ("Claimed or relied on by [Park2008]:", "Others:", "Not decided:")
    for title, names in zip(titles, (claimed, others, undecided), strict=True):
        lines += [title, *(f"  - {name}" for name in names)] if names else []
    return "\n".join(lines)


# --- runs judged by the Lyapunov conditions ---------------------------------------------------------------------------


def lyapunov_runs_text(cases: Sequence[tuple[str, LyapunovRun]]) -> str:
    """One table of the shares of time and first violations, one of the ultimate bounds; a row a case."""
    names = [condition.name for condition in cases[0][1].conditions]
    shares = table(("Share of the time each holds", *names), [(name, *_shares(run)) for name, run in cases])
    first = table(("First violation, s", *names), [(name, *_first(run)) for name, run in cases])
    columns = ("Last third of each stage", "outcome", "time s", "largest |s| m/s", "largest slip error", "locked %")
    return render(
        [
            heading("Lyapunov conditions along braking runs"),
            shares,
            first,
            table(columns, [_bounds(name, run) for name, run in cases], left=2),
        ]
    )


def _shares(run: LyapunovRun) -> Iterable[str]:
    # rounded down: what does not hold all the time never reads 100 %
    return (f"{math.floor(1000 * condition.share) / 10:.1f} %" for condition in run.conditions)


def _first(run: LyapunovRun) -> Iterable[str]:
    return ("never" if condition.holds else f"{condition.first_violation:.3f}" for condition in run.conditions)


def _bounds(name: str, run: LyapunovRun) -> tuple[str, ...]:
    return (
        name,
        str(run.run.outcome),
        f"{run.run.braking_time:.1f}",
        ", ".join(f"{bound.s:.2f}" for bound in run.ultimate),
        ", ".join(f"{bound.slip_error:.3f}" for bound in run.ultimate),
        f"{100 * run.run.locked_fraction:.1f}",
    )
