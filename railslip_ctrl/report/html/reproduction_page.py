"""The page of `railslip reproduce`: the paper's numbers computed again, its gains in both readings, its errata."""

from __future__ import annotations

from collections.abc import Sequence

from railslip_ctrl.design.design_check import ControllerGroup
from railslip_ctrl.model.vehicle import AS_PUBLISHED_INERTIA_SCALE
from railslip_ctrl.paper.errata import Erratum
from railslip_ctrl.paper.facts import Fact
from railslip_ctrl.paper.reading import READING
from railslip_ctrl.paper.tables import DEFAULT_SEEDS, QUANTITIES, TOLERANCE_PERCENT, Row, Table5

from .blocks import Block, Details, Facts, FirstPage, Paragraph, Picture, Section, Table
from .formulas import formula
from .numbers import MARGIN_HEAD, listed, margin_cells, minus, short
from .typography import typeset

QUANTITY_WORDS = dict(
    zip(
        QUANTITIES, ("braking time, s", "braking distance, m", "brake energy, N·m", "mean |slip error|, -"), strict=True
    )
)
"""What a row of Table 5 is called, with its unit."""

FIGURES = {
    "fig_13": "Fig. 13",
    "figs_14_15": "Figs. 14 and 15",
    "fig_17": "Fig. 17",
    "fig_18": "Fig. 18",
    "fig_19": "Fig. 19",
    "fig_20": "Fig. 20",
    "fig_21": "Fig. 21",
}
"""The paper's figures by the names of the pictures redrawn."""

_ENERGY = QUANTITIES[2]

_DECIDED = {
    "symbolic": "as expressions, symbolically",
    "computed": "by numbers computed from the paper's own",
    "argument": "by what the expression depends on",
}


def reproduction_first_page(
    comparison: Table5, facts: Sequence[Fact], errata: Sequence[Erratum], groups: Sequence[ControllerGroup]
) -> FirstPage:
    """What is read in a minute."""
    within, total = sum(row.within for row in comparison.rows), len(comparison.rows)
    wrong = sum(not one.agrees for one in errata)
    rows = [
        ("Rms deviation", f"{comparison.rms_deviation_percent:.1f} %", f"of {total} numbers, Table 5"),
        ("Facts that hold", f"{sum(one.holds for one in facts)} of {len(facts)}", "of the published runs"),
        ("Errata", str(wrong), f"of {len(errata)} equations, numbers and claims looked at"),
    ]
    for group in groups:
        unstable = sum(not one.stable for one in group.assessments)
        rows.append((group.title, f"{unstable} unstable", f"of {len(group.assessments)} operating points"))
    return FirstPage(
        title="[Park2008] computed again",
        headline=f"{within} OF {total} NUMBERS WITHIN {TOLERANCE_PERCENT:g} %",
        subject="Table 5, braking from 100 to 5 km/h",
        file="",
        lines=(("Why", reproduction_finding(comparison)),),
        head=("", "found", "of what"),
        rows=rows,
        pictures=(
            Picture(
                "table5",
                "Deviation from [Park2008] Table 5, with two standard errors; grey: the tolerance.",
                f"Deviations in percent by column and quantity. {reproduction_finding(comparison)}",
            ),
        ),
    )


def reproduction_sections(
    comparison: Table5, facts: Sequence[Fact], errata: Sequence[Erratum], groups: Sequence[ControllerGroup]
) -> list[Section]:
    """What stands behind it."""
    figures = tuple(
        Picture(
            name, f"[Park2008] {shown}, redrawn.", f"The curves of {shown} of the paper, computed by this software."
        )
        for name, shown in FIGURES.items()
    )
    return [
        Section("table5", "Table 5", (_table5(comparison),)),
        Section("reading", "The reading", (_reading(),)),
        Section("facts", "Facts of the runs", tuple(_fact(one) for one in facts)),
        _gains(groups),
        Section("figures", "Figures", figures),
        _errata(errata),
    ]


def _gains(groups: Sequence[ControllerGroup]) -> Section:
    """Table 4's gains in both readings of the units."""
    rows = [
        (group.title, f"{a.point.rail}, {a.point.speed_kmh:g} km/h", *margin_cells(a.margins), a.verdict.value)
        for group in groups
        for a in group.assessments
    ]
    head = ("Reading", "Operating point", *MARGIN_HEAD, "Verdict")
    text = "Table 4's PI gains, read as N·m per km/h, with the dead time exact: [Park2008] asks for no margins."
    alt = "Magnitude and phase of the loops with Table 4's gains in both readings, a panel a reading."
    return Section(
        "gains",
        "Table 4's gains in both readings",
        (
            Paragraph(text),
            Table("Margins; dashes: unstable.", head, rows, wide=True),
            Picture("bode", "Bode, Table 4's gains.", alt),
            Picture("nyquist", "Nyquist, Table 4's gains.", alt.replace("Magnitude and phase", "Nyquist curves")),
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


def _errata(errata: Sequence[Erratum]) -> Section:
    """Where the paper's print does not follow from its own statement."""
    wrong, right = ([one for one in errata if one.agrees is agrees] for agrees in (False, True))
    blocks: list[Block] = []
    for one in wrong:
        rows = (
            ("Printed", formula(one.printed_latex)),
            ("Follows", formula(one.derived_latex)),
            ("Size", typeset(one.sign_and_size)),
            ("Decided", _DECIDED[one.how]),
        )
        blocks.append(Details(typeset(one.where), "differs", (Facts(rows), Paragraph(typeset(one.explanation)))))
    blocks.append(Paragraph(typeset(f"Found to agree: {listed(one.where for one in right)}.")))
    return Section("errata", "Errata", tuple(blocks))
