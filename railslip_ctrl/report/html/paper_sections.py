"""Sections about the paper: its own numbers computed again, and its errata."""

from __future__ import annotations

from railslip_ctrl.design_report import DesignReport
from railslip_ctrl.parameters import AS_PUBLISHED_INERTIA_SCALE
from railslip_ctrl.reproduction import QUANTITIES, READING, TOLERANCE_PERCENT, Fact, Row, Table5
from railslip_ctrl.reproduction.table5 import DEFAULT_SEEDS

from .blocks import Block, Details, Facts, Paragraph, Picture, Section, Table
from .formulas import formula
from .numbers import listed, minus, short
from .typography import typeset

QUANTITY_WORDS = dict(
    zip(
        QUANTITIES, ("braking time, s", "braking distance, m", "brake energy, N·m", "mean |slip error|, -"), strict=True
    )
)
"""What a row of Table 5 is called, with its unit."""

ERRATA_TITLE = "Appendix: errata found in the paper"

_ENERGY = QUANTITIES[2]

_DECIDED = {
    "symbolic": "as expressions, symbolically",
    "computed": "by numbers computed from the paper's own",
    "argument": "by what the expression depends on",
}


def reproduction_section(report: DesignReport) -> Section:
    """Table 5 of the paper, or why it is not here."""
    comparison = report.table5
    if comparison is None:
        text = (
            "Left out: the printed results are of the published vehicle, and this report is about "
            f"{report.check.vehicle.name}. "
            "railslip reproduce computes them."
        )
        return Section("reproduction", "Appendix: reproduction of the paper", (Paragraph(text),))
    facts = tuple(_fact(one) for one in report.facts)
    return Section(
        "reproduction",
        "Appendix: reproduction of the paper",
        (
            Paragraph(reproduction_finding(comparison), strong=True),
            Picture(
                "table5",
                f"Deviation of the {len(comparison.rows)} numbers from [Park2008] Table 5, with two standard errors; "
                "grey: "
                "the tolerance.",
                f"Deviations in percent by column and quantity. {reproduction_finding(comparison)}",
            ),
            _table5(comparison),
            Details("The reading they are computed under", f"{len(READING)} rules", (_reading(),)),
            *facts,
        ),
    )


def _fact(one: Fact) -> Details:
    found = Paragraph(typeset(f"Found: {one.found}. By: {one.how}."))
    return Details(one.name, "holds" if one.holds else "does not hold", (Paragraph(typeset(one.statement)), found))


def reproduction_finding(comparison: Table5) -> str:
    """How many of the numbers are met, and how far the seeds here decide it."""
    out = [row for row in comparison.rows if not row.within]
    total, seeds = len(comparison.rows), comparison.seeds
    text = (
        f"{total - len(out)} of {total} numbers of Table 5 come out within {TOLERANCE_PERCENT:g} % (rms "
        f"{comparison.rms_deviation_percent:.1f} %), the mean of {seeds} noise seeds a column."
    )
    open_ = [row for row in out if _undecided(row)]
    if open_:
        which = "; ".join(
            f"{_item(row)}: {minus(format(row.deviation_percent, '+.2f'))} % ± {_error(row):.2f} %" for row in open_
        )
        text += f" Beyond the tolerance by less than two standard errors, which so few seeds do not decide: {which}. "
        text += f"railslip reproduce takes {DEFAULT_SEEDS} seeds."
    return text


def _item(row: Row) -> str:
    _, column, quantity = row.item.split(" / ")
    return f"{column}, {QUANTITY_WORDS[quantity].split(', ')[0]}"


def _error(row: Row) -> float:
    """Standard error, % of the published number."""
    return 100 * row.standard_error / row.published


def _undecided(row: Row) -> bool:
    return abs(row.deviation_percent) - 2 * _error(row) <= row.tolerance_percent


def _table5(comparison: Table5) -> Table:
    rows = []
    for row in comparison.rows:
        _, column, quantity = row.item.split(" / ")
        within = "yes" if row.within else "undecided" if _undecided(row) else "no"
        rows.append(
            (
                column,
                QUANTITY_WORDS[quantity],
                short(row.published),
                short(row.obtained),
                minus(f"{row.deviation_percent:+.2f}"),
                f"{_error(row):.2f}",
                within,
            )
        )
    head = (
        "Column",
        "Quantity",
        "Published",
        "Obtained",
        "Deviation, %",
        "Std. error, %",
        f"Within {TOLERANCE_PERCENT:g} %",
    )
    return Table(
        f"[Park2008] Table 5 beside the mean of {comparison.seeds} seeded runs. Energies are in the printed reading, "
        f"{AS_PUBLISHED_INERTIA_SCALE:g} times the joules{_energy(comparison)}.",
        head,
        rows,
    )


def _energy(comparison: Table5) -> str:
    """A printed energy in joules, as the tables of braking runs have them."""
    row = next((row for row in comparison.rows if row.item.endswith(f" / {_ENERGY}")), None)
    if row is None:
        return ""
    joules = row.published / AS_PUBLISHED_INERTIA_SCALE
    return f": the printed {short(row.published)} are {short(joules / 1e6, 3)} MJ in the tables of the braking runs"


def _reading() -> Table:
    rows = [(rule.name, rule.basis.value, typeset(rule.used), rule.where) for rule in READING]
    return Table("Each rule, and where it comes from.", ("Rule", "Basis", "Used", "Where"), rows, wide=True)


def errata_section(report: DesignReport) -> Section:
    """Where the paper's print does not follow from its own statement."""
    wrong = [one for one in report.errata if not one.agrees]
    right = [one for one in report.errata if one.agrees]
    blocks: list[Block] = [
        Paragraph(
            f"{len(report.errata)} equations, numbers and claims of [Park2008] were derived or computed again: "
            f"{len(right)} {'agrees' if len(right) == 1 else 'agree'}, {len(wrong)} "
            f"{'does' if len(wrong) == 1 else 'do'} not.",
            strong=True,
        )
    ]
    if report.table5 is None:
        text = (
            f"They differ at: {listed(one.where for one in wrong)}. railslip derive prints each; report.json has them."
        )
        return Section("errata", ERRATA_TITLE, (*blocks, Paragraph(typeset(text))))
    for one in wrong:
        rows = (
            ("Printed", formula(one.printed_latex)),
            ("Follows", formula(one.derived_latex)),
            ("Size", typeset(one.sign_and_size)),
            ("Decided", _DECIDED[one.how]),
        )
        blocks.append(Details(typeset(one.where), "differs", (Facts(rows), Paragraph(typeset(one.explanation)))))
    blocks.append(Paragraph(typeset(f"Found to agree: {listed(one.where for one in right)}.")))
    return Section("errata", ERRATA_TITLE, tuple(blocks))
