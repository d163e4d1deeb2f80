"""Text and JSON of the paper's numbers beside ours."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from railslip_ctrl.paper import printed
from railslip_ctrl.paper.facts import Fact
from railslip_ctrl.paper.reading import READING, Sensitivity, SensitivityRow
from railslip_ctrl.paper.tables import (
    QUANTITIES,
    TOLERANCE_PERCENT,
    Row,
    Table3,
    Table5,
)

from .document import facts, heading, indented, render, table
from .export import exported, number

_STANDARD_ERRORS = 2.0  # within so many, a deviation may be the seeds'
_WORDS = dict(zip(QUANTITIES, ("time", "distance", "energy", "slip error"), strict=True))


def reproduction_json(
    comparison: Table5, three: Table3, found: Sequence[Fact], sensitivity: Sensitivity | None = None
) -> dict[str, Any]:
    """The rows of Table 5, the reading, Table 3, the facts, and the sensitivity where it was asked for."""
    content = {
        "rows": [row_json(row) for row in comparison.rows],
        "seeds": comparison.seeds,
        "rms_deviation_percent": number(comparison.rms_deviation_percent),
        "all_within": comparison.within,
        "reading": [{"rule": r.name, "used": r.used, "basis": r.basis.value, "where": r.where} for r in READING],
        "table3": exported(
            three,
            *("beam_mean", "bristle_mean", "improvement_percent", "improvement_of_printed_means_percent"),
            *("improvement_in_adhesion_regime_percent", "not_reproducible", "source"),
        )
        | {"improvement_percent_published": printed.TABLE3_IMPROVEMENT},
        "facts": [exported(one, "name", "statement", "found", "holds", "how") for one in found],
    }
    if sensitivity is not None:
        content["sensitivity"] = sensitivity_json(sensitivity)
    return content


def row_json(row: Row) -> dict[str, Any]:
    """One number of Table 5, published and obtained."""
    names = ("item", "published", "obtained", "standard_error", "deviation_percent", "tolerance_percent", "within")
    return exported(row, *names, "source")


def sensitivity_json(sensitivity: Sensitivity) -> dict[str, Any]:
    """The alternatives; `numbers` are the sixteen by column, null where runs did not stop."""
    return {
        "seeds": sensitivity.seeds,
        "rms_deviation_percent": number(sensitivity.base_rms_deviation_percent),
        "rows": [
            {
                "rule": row.alternative.rule,
                "alternative": row.alternative.name,
                "rms_deviation_percent": number(row.rms_deviation_percent),
                "largest_change_percent": number(row.largest_change_percent),
                "largest_change_of": row.largest_change_of or None,
                "not_stopped": row.not_stopped,
                "numbers": {one.setup.case.name: [number(x) for x in one.mean] for one in row.results},
            }
            for row in sensitivity.rows
        ],
    }


def reproduction_text(
    comparison: Table5, three: Table3, found: Sequence[Fact], sensitivity: Sensitivity | None = None
) -> str:
    """The same as text."""
    parts = [*_table5_parts(comparison), *_reading_parts(), *_table3_parts(three), *_facts_parts(found)]
    if sensitivity is not None:
        parts += _sensitivity_parts(sensitivity)
    parts.append(Text(_verdict(comparison)))
    return render(parts)


def _table5_parts(comparison: Table5) -> Iterable[RenderableType]:
    yield heading("[Park2008] Table 5: the stop from 100 to 5 km/h")
    yield facts(
        [
            ("Runs", f"{comparison.seeds} noise seeds a column; obtained is their mean, with its standard error"),
            ("Rms deviation", f"{comparison.rms_deviation_percent:.2f} % over {len(comparison.rows)} numbers"),
            ("Tolerance", f"{TOLERANCE_PERCENT:g} %"),
        ]
    )
    rows = []
    for row in comparison.rows:
        _, column, quantity = row.item.split(" / ")
        rows.append(
            (
                column,
                quantity,
                f"{row.published:.4g}",
                "-" if math.isnan(row.obtained) else f"{row.obtained:.4g}",
                "-" if math.isnan(row.standard_error) else f"{row.standard_error:.1g}",
                "-" if math.isnan(row.deviation_percent) else f"{row.deviation_percent:+.2f}",
                "yes" if row.within else "NO",
            )
        )
    yield table(("Column", "Quantity", "Published", "Obtained", "Std. error", "Deviation, %", "Within"), rows, left=2)


def _reading_parts() -> Iterable[RenderableType]:
    yield heading("The reading it is computed under")
    rows = [(rule.name, rule.basis.value, rule.used, rule.where) for rule in READING]
    yield table(("Rule", "Basis", "Used", "Where"), rows, left=4)


def _table3_parts(three: Table3) -> Iterable[RenderableType]:
    yield heading("[Park2008] Table 3: mean absolute errors of the adhesion models")
    yield facts(
        [
            (
                "Row means",
                f"beam {three.beam_mean:.6g} (printed {printed.TABLE3_MEANS['beam']:g}), "
                f"bristle {three.bristle_mean:.6g} (printed {printed.TABLE3_MEANS['bristle']:g})",
            ),
            (
                "Improvement",
                f"{three.improvement_percent:.1f} % of the row means; printed {printed.TABLE3_IMPROVEMENT:g} %, which "
                f"is that of the printed means ({three.improvement_of_printed_means_percent:.1f} %)"
                if three.improvement_follows_from_printed_means
                else f"{three.improvement_percent:.1f} %; printed {printed.TABLE3_IMPROVEMENT:g} %",
            ),
            ("Where adhesion rises", f"{three.improvement_in_adhesion_regime_percent:.1f} %"),
        ]
    )
    yield indented(three.not_reproducible)
    yield Text("")


def _facts_parts(found: Sequence[Fact]) -> Iterable[RenderableType]:
    yield heading("Other facts of the published runs")
    for one in found:
        yield heading(f"{one.name}: {'holds' if one.holds else 'DOES NOT HOLD'}", "-")
        yield indented(one.statement)
        yield indented(f"Found: {one.found}.")
        yield indented(f"By: {one.how}.")
        yield Text("")


def _sensitivity_parts(sensitivity: Sensitivity) -> Iterable[RenderableType]:
    yield heading("What each rule is worth: one at a time put to an alternative")
    yield facts(
        [
            ("Runs", f"{sensitivity.seeds} seeds a column, the same on both sides"),
            ("The reading itself", f"rms deviation {sensitivity.base_rms_deviation_percent:.2f} %"),
            ("Rms", "deviation from the sixteen published numbers; - where runs did not stop"),
            ("Largest change", "of a number against the reading, in the columns concerned whose runs all stopped"),
        ]
    )
    columns = ("Rule", "Instead", "Largest change", "Rms, %", "Did not stop")
    yield table(columns, [_sensitivity_row(row, sensitivity.seeds) for row in sensitivity.rows], left=3)


def _sensitivity_row(row: SensitivityRow, seeds: int) -> tuple[str, ...]:
    rms, change = row.rms_deviation_percent, row.largest_change_percent
    return (
        row.alternative.rule,
        row.alternative.name,
        "-" if math.isnan(change) else f"{change:+.1f} % {_short(row.largest_change_of)}",
        "-" if math.isnan(rms) else f"{rms:.2f}",
        ", ".join(f"{column} {count}/{seeds}" for column, count in row.not_stopped.items()),
    )


def _short(item: str) -> str:
    """A number of a column in few words."""
    column, quantity = item.split(" / ")
    return f"{column} {_WORDS[quantity]}"


def _verdict(comparison: Table5) -> str:
    out = [row.item for row in comparison.rows if not row.within]
    total = len(comparison.rows)
    if not out:
        return f"Verdict: all {total} numbers of Table 5 within {TOLERANCE_PERCENT:g} %."
    lines = [f"Verdict: {len(out)} of {total} numbers of Table 5 out of tolerance:", *(f"  - {x}" for x in out)]
    unsure = [row for row in comparison.rows if not row.within and _beyond(row) < _STANDARD_ERRORS * row.standard_error]
    if unsure:
        lines.append(
            f"{len(unsure)} of them by less than {_STANDARD_ERRORS:g} standard errors: {comparison.seeds} seeds do not "
            "decide that; take more (256 are usual)."
        )
    return "\n".join(lines)


def _beyond(row: Row) -> float:
    """By how much a number is outside its tolerance, in its own unit."""
    return abs(row.obtained - row.published) - 0.01 * row.tolerance_percent * row.published
