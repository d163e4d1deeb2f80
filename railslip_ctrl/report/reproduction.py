"""Comparison of the numbers of [Park2008] with those of this package, as text, JSON and HTML page.

The "reading" is the set of assumptions on units and details that the paper does not state.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from railslip_ctrl.design.assessment import ControllerGroup
from railslip_ctrl.model.vehicle import AS_PUBLISHED_INERTIA_SCALE
from railslip_ctrl.paper import printed
from railslip_ctrl.paper.errata import Erratum
from railslip_ctrl.paper.reading import READING, Sensitivity, SensitivityRow
from railslip_ctrl.paper.tables import DEFAULT_SEEDS, QUANTITIES, TOLERANCE_PERCENT, Fact, Row, Table3, Table5

from .document import (
    MARGIN_HEAD,
    NONE,
    Block,
    Details,
    Facts,
    FirstPage,
    Paragraph,
    Picture,
    Section,
    Table,
    heading,
    listed,
    margin_cells,
    minus,
    render,
    short,
)
from .export import exported, number
from .page import formula, typeset

_NAMES = ("braking time, s", "braking distance, m", "brake energy, N·m", "mean |slip error|, -")
QUANTITY_NAMES = dict(zip(QUANTITIES, _NAMES, strict=True))  #: names of the rows of Table 5, with units

FIGURES = {"fig_13": "Fig. 13", "figs_14_15": "Figs. 14 and 15"} | {f"fig_{n}": f"Fig. {n}" for n in range(17, 22)}
"""For each redrawn picture, by name, the figure of the paper."""

_ENERGY = QUANTITIES[2]
_ROW = (
    *("item", "published", "obtained", "standard_error", "deviation_percent", "tolerance_percent", "within", "source"),
)

_DECIDED = {
    "symbolic": "symbolically, as expressions",
    "computed": "numerically, from the numbers of the paper",
    "argument": "by the quantities on which the expression depends",
}


def reproduction_json(
    comparison: Table5, three: Table3, facts: Sequence[Fact], sensitivity: Sensitivity | None = None
) -> dict[str, Any]:
    """Return the comparison with the paper as JSON: Tables 5 and 3, further facts, and effect of each assumption."""
    content = {
        "rows": [exported(row, *_ROW) for row in comparison.rows],
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
        "facts": [exported(item, "name", "statement", "found", "holds", "how") for item in facts],
    }
    if sensitivity is not None:
        content["sensitivity"] = sensitivity_json(sensitivity)
    return content


def sensitivity_json(sensitivity: Sensitivity) -> dict[str, Any]:
    """Return the effect of each alternative assumption as JSON; a number is null if a run did not stop."""
    return {
        "seeds": sensitivity.seeds,
        "rms_deviation_percent": number(sensitivity.base_rms_deviation_percent),
        "rows": [
            {
                **exported(row, rule="alternative.rule", alternative="alternative.name"),
                **exported(row, "rms_deviation_percent", "largest_change_percent"),
                "largest_change_of": row.largest_change_of or None,
                "not_stopped": row.not_stopped,
                "numbers": {item.setup.case.name: [number(x) for x in item.mean] for item in row.results},
            }
            for row in sensitivity.rows
        ],
    }


def reproduction_text(
    comparison: Table5, three: Table3, facts: Sequence[Fact], sensitivity: Sensitivity | None = None
) -> str:
    """Return the comparison with the paper as text."""
    five = _table5(comparison)
    parts: list[RenderableType] = [
        heading("[Park2008] Table 5: the stop from 100 to 5 km/h"),
        five,
        Paragraph(f"{five.caption}\n"),
        heading("Reading: rules for units and for details that the paper does not state"),
        _reading(str),
        *_table3_parts(three),
        heading("Other facts of the published runs"),
        *(_fact(item, str) for item in facts),
    ]
    if sensitivity is not None:
        parts += _sensitivity_parts(sensitivity)
    return render([*parts, Text(f"Verdict: {reproduction_finding(comparison)}")])


def _table3_parts(three: Table3) -> list[RenderableType]:
    means, printed_value = printed.TABLE3_MEANS, f"printed {printed.TABLE3_IMPROVEMENT:g} %"
    obtained = f"{three.improvement_percent:.1f} %"
    if three.improvement_follows_from_printed_means:
        printed_value += f", which follows from the printed means ({three.improvement_of_printed_means_percent:.1f} %)"
        obtained += " of the row means"
    rows = [(three.beam_mean, "beam"), (three.bristle_mean, "bristle")]
    known = Facts(
        [
            ("Row means", ", ".join(f"{name} {mean:.6g} (printed {means[name]:g})" for mean, name in rows)),
            ("Improvement", f"{obtained}; {printed_value}"),
            ("Where adhesion rises", f"{three.improvement_in_adhesion_regime_percent:.1f} %"),
        ]
    )
    title = heading("[Park2008] Table 3: mean absolute errors of the adhesion models")
    return [title, known, Paragraph(three.not_reproducible), Text("")]


def _sensitivity_parts(sensitivity: Sensitivity) -> list[RenderableType]:
    known = Facts(
        [
            ("Runs", f"{sensitivity.seeds} seeds for each column, the same for reading and alternative"),
            ("Reading", f"rms deviation {sensitivity.base_rms_deviation_percent:.2f} %"),
            ("Rms", "deviation from the sixteen published numbers; - where runs did not stop"),
            ("Largest change", "of a number by the alternative, in affected columns in which all runs stopped"),
        ]
    )
    columns = ("Rule", "Alternative", "Largest change", "Rms, %", "Did not stop")
    rows = [_sensitivity_row(row, sensitivity.seeds) for row in sensitivity.rows]
    title = heading("Effect of each rule: one alternative at a time")
    return [title, known, Table(columns, rows, left=3)]


def _sensitivity_row(row: SensitivityRow, seeds: int) -> tuple[str, ...]:
    rms, change = row.rms_deviation_percent, row.largest_change_percent
    return (
        row.alternative.rule,
        row.alternative.name,
        "-" if math.isnan(change) else f"{change:+.1f} % {_item(row.largest_change_of)}",
        "-" if math.isnan(rms) else f"{rms:.2f}",
        ", ".join(f"{column} {count}/{seeds}" for column, count in row.not_stopped.items()),
    )


def _fact(fact: Fact, style: Callable[[str], str]) -> Details:
    texts = (fact.statement, f"Result: {fact.found}. Method: {fact.how}.")
    return Details(fact.name, "holds" if fact.holds else "does not hold", tuple(Paragraph(style(x)) for x in texts))


def reproduction_finding(comparison: Table5) -> str:
    """Return sentences on how many numbers of Table 5 are within tolerance, and which of them need more seeds."""
    out = [row for row in comparison.rows if not row.within]
    total, seeds = len(comparison.rows), comparison.seeds
    text = (
        f"{total - len(out)} of {total} numbers of Table 5 are reproduced within {TOLERANCE_PERCENT:g} % (rms "
        f"deviation {comparison.rms_deviation_percent:.1f} %), as means of {seeds} noise seeds for each column."
    )
    open_ = [row for row in out if _undecided(row)]
    if open_:
        which = "; ".join(
            f"{_item(row.item)}: {minus(format(row.deviation_percent, '+.2f'))} % ± {_error(row):.2f} %"
            for row in open_
        )
        text += f" Outside the tolerance by less than two standard errors, so that more seeds are needed: {which}. "
        text += f"railslip reproduce uses {DEFAULT_SEEDS} seeds."
    return text


def _item(item: str) -> str:
    column, quantity = item.split(" / ")[-2:]
    return f"{column}, {QUANTITY_NAMES[quantity].split(', ')[0]}"


def _error(row: Row) -> float:
    return 100 * row.standard_error / row.published


def _undecided(row: Row) -> bool:
    return abs(row.deviation_percent) - 2 * _error(row) <= row.tolerance_percent


def _table5(comparison: Table5) -> Table:
    rows = []
    for row in comparison.rows:
        _, column, quantity = row.item.split(" / ")
        within = "yes" if row.within else "undecided" if _undecided(row) else "no"
        numbers = ((row.deviation_percent, "+.2f"), (_error(row), ".2f"))
        beside = [NONE if math.isnan(x) else minus(f"{x:{form}}") for x, form in numbers]
        rows.append((column, QUANTITY_NAMES[quantity], short(row.published), short(row.obtained), *beside, within))
    head = ("Column", "Quantity", "Published", "Obtained", "Deviation, %", "Std. error, %")
    caption = (
        f"[Park2008] Table 5 compared with the mean of {comparison.seeds} runs. Energies are in units of the paper, "
        f"{AS_PUBLISHED_INERTIA_SCALE:g} times the value in J{_energy(comparison)}."
    )
    return Table((*head, f"Within {TOLERANCE_PERCENT:g} %"), rows, left=2, caption=caption)


def _energy(comparison: Table5) -> str:
    row = next((row for row in comparison.rows if row.item.endswith(f" / {_ENERGY}")), None)
    if row is None:
        return ""
    joules = row.published / AS_PUBLISHED_INERTIA_SCALE
    return f": the printed {short(row.published)} are {short(joules / 1e6, 3)} MJ in other tables of braking runs"


def _reading(style: Callable[[str], str]) -> Table:
    rows = [(rule.name, rule.basis.value, style(rule.used), rule.where) for rule in READING]
    return Table(
        ("Rule", "Basis", "Used", "Where"),
        rows,
        left=4,
        caption="Each rule with its source.",
        wide=True,
    )


def reproduction_first_page(
    comparison: Table5, held: Sequence[Fact], errata: Sequence[Erratum], groups: Sequence[ControllerGroup]
) -> FirstPage:
    """Return the first page of the reproduction report.

    - held: facts of the published runs.
    - groups: loops with the gains of Table 4, one group for each inertia scale.
    """
    within, total = sum(row.within for row in comparison.rows), len(comparison.rows)
    wrong = sum(not item.agrees for item in errata)
    rows = [
        ("Rms deviation", f"{comparison.rms_deviation_percent:.1f} %", f"of {total} numbers, Table 5"),
        ("Facts that hold", f"{sum(item.holds for item in held)} of {len(held)}", "of the published runs"),
        ("Errata", str(wrong), f"of {len(errata)} equations, numbers and claims checked"),
    ]
    for group in groups:
        unstable = sum(not item.stable for item in group.assessments)
        rows.append((group.title, f"{unstable} unstable", f"of {len(group.assessments)} operating points"))
    return FirstPage(
        title="Reproduction of [Park2008]",
        headline=f"{within} OF {total} NUMBERS WITHIN {TOLERANCE_PERCENT:g} %",
        subject="Table 5, braking from 100 to 5 km/h",
        file="",
        lines=(("Why", reproduction_finding(comparison)),),
        head=("", "Result", "Of"),
        rows=rows,
        pictures=(
            Picture(
                "table5",
                "Deviation from [Park2008] Table 5 with two standard errors; grey: tolerance.",
                f"Deviations in percent by column and quantity. {reproduction_finding(comparison)}",
            ),
        ),
    )


def reproduction_sections(
    comparison: Table5, held: Sequence[Fact], errata: Sequence[Erratum], groups: Sequence[ControllerGroup]
) -> list[Section]:
    """Return the sections of the reproduction report after the first page."""
    alt = "The curves of {} of the paper, as computed by this software."
    figures = tuple(Picture(name, f"[Park2008] {item}, redrawn.", alt.format(item)) for name, item in FIGURES.items())
    return [
        Section("table5", "Table 5", (_table5(comparison),)),
        Section("reading", "Reading of the paper", (_reading(typeset),)),
        Section("facts", "Further facts of the published runs", tuple(_fact(item, typeset) for item in held)),
        _gains(groups),
        Section("figures", "Figures", figures),
        _errata(errata),
    ]


def _gains(groups: Sequence[ControllerGroup]) -> Section:
    rows = [
        (group.title, f"{a.point.rail}, {a.point.speed_kmh:g} km/h", *margin_cells(a.margins), a.verdict.value)
        for group in groups
        for a in group.assessments
    ]
    head = ("Gains and inertia scale", "Operating point", *MARGIN_HEAD, "Verdict")
    text = "Table 4's PI gains, in N·m per km/h, with exact dead time; [Park2008] states no margins."
    alt = "Magnitude and phase of the loops with Table 4's gains, one panel for each inertia scale."
    return Section(
        "gains",
        "Table 4's gains with both inertia scales",
        (
            Paragraph(text),
            Table(head, rows, caption="Margins; a dash means unstable.", wide=True),
            Picture("bode", "Bode diagrams with Table 4's gains.", alt),
            Picture(
                "nyquist",
                "Nyquist diagrams, same loops.",
                alt.replace("Magnitude and phase", "Nyquist curves"),
            ),
        ),
    )


def _errata(errata: Sequence[Erratum]) -> Section:
    wrong, right = ([item for item in errata if item.agrees is agrees] for agrees in (False, True))
    blocks: list[Block] = []
    for item in wrong:
        rows = (
            ("Printed", formula(item.printed_latex)),
            ("Derived", formula(item.derived_latex)),
            ("Size", typeset(item.sign_and_size)),
            ("Checked", _DECIDED[item.how]),
        )
        blocks.append(Details(typeset(item.where), "differs", (Facts(rows), Paragraph(typeset(item.explanation)))))
    blocks.append(Paragraph(typeset(f"Checked and correct: {listed(item.where for item in right)}.")))
    return Section("errata", "Errata", tuple(blocks))
