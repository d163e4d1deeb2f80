"""Sections about the sliding-mode law, the braking runs, and the paper's own numbers."""

from __future__ import annotations

import math
import re

from railslip_ctrl.design_report import DesignReport, Stop, StopRun
from railslip_ctrl.reproduction import READING, TOLERANCE_PERCENT, Fact, Row, Table5
from railslip_ctrl.simulation import Run
from railslip_ctrl.sliding_verification import FullVerification
from railslip_ctrl.units import KMH

from .blocks import Block, Details, Facts, Group, Items, Paragraph, Picture, Section, Table
from .numbers import NONE, minus, short, typeset

_SENTENCE_END = re.compile(r"(?<=\.) (?=[A-Za-z])")
_LAWS = {"paper": "The published law", "layered": "A layered law with a lead on the brake's lag"}


def sliding_section(report: DesignReport) -> Section:
    """Which stability conditions of the sliding-mode laws hold, each with its evidence."""
    sliding = report.sliding
    groups = []
    for name, title in _LAWS.items():
        full: FullVerification | None = getattr(sliding, name)
        blocks = (Paragraph(f"Not decided: {sliding.reasons[name]}."),) if full is None else _conditions(full)
        groups.append(Group(f"sliding-{name}", title, tuple(blocks)))
    intro = Paragraph(
        "Every claim that the law's proof makes or relies on is put as a condition and decided: symbolically, over "
        "samples, or "
        "by simulation. The evidence is under each condition."
    )
    return Section("sliding", "The sliding-mode law: verdict", (intro, *groups))


def _conditions(full: FullVerification) -> list[Block]:
    verification = full.verification
    count, failing = len(verification.conditions), verification.failing
    claimed = sum(one.claimed for one in failing)
    told = f"{count - len(failing)} of {count} conditions hold; {len(failing)} do not"
    told += f", {claimed} of them claimed or relied on by [Park2008]." if claimed else "."
    blocks: list[Block] = [Paragraph(told, strong=True)]
    if full.conclusion:
        blocks.append(Items(tuple(_SENTENCE_END.split(typeset(full.conclusion)))))
    rows = [("K", f"{short(verification.K)} N·m")]
    if verification.D is not None:
        rows.append(("D", f"{short(verification.D)} N·m/(m/s)"))
    blocks.append(
        Facts((*rows, ("Inertia scale", f"{verification.inertia_scale:g}"), ("Seed", str(verification.seed))))
    )
    for one in verification.conditions:
        verdict = "holds" if one.holds else "does not hold"
        blocks.append(
            Details(
                one.name,
                f"{verdict} ({one.how})",
                (Paragraph(typeset(one.statement)), Paragraph(typeset(one.evidence))),
            )
        )
    return blocks


# --- braking runs ---------------------------------------------------------------------------------------------------


def stops_section(report: DesignReport) -> Section:
    """The same stop with every controller."""
    if not report.stops:
        text = "No braking run: the adhesion law cannot be had on the rails asked for."
        return Section("stops", "Braking runs", (Paragraph(text),))
    groups = [_stop_group(i, stop) for i, stop in enumerate(report.stops, start=1)]
    intro = Paragraph(
        "Nonlinear runs of the quarter car through the brake's dead time and lag, with the published random force "
        "and caliper "
        "disturbance, the same noise for every controller. Adhesion is the static law; of the bristle model the "
        "curve along a "
        "slip ramp. The bound is the stop of a controller that knows the rail ahead."
    )
    return Section("stops", "Braking runs", (intro, *groups))


def _stop_group(i: int, stop: Stop) -> Group:
    start, end = stop.scenario.initial_speed / KMH, stop.scenario.final_speed / KMH
    blocks: list[Block] = [Paragraph(_stop_finding(stop), strong=True), _stop_table(stop, start, end)]
    missing = tuple(f"{one.name}: none. {one.reason}." for one in stop.runs if one.run is None)
    if missing:
        blocks.append(Items(missing))
    ran = [one for one in stop.runs if one.run is not None]
    if ran:
        told = "; ".join(f"{one.name}: {_words(one)}" for one in ran)
        blocks.append(
            Picture(
                f"stop-{i}",
                f"{stop.title[0].upper()}{stop.title[1:]}: speeds, slip and torque over time, a row a controller. "
                "Commands far "
                "above the acting torque are cut off.",
                "Time series of train and wheel speed, slip with its reference, and torque commanded and acting. "
                f"{told}.",
            )
        )
    return Group(f"stop-group-{i}", stop.title[0].upper() + stop.title[1:], tuple(blocks))


def _words(one: StopRun) -> str:
    run = one.run
    assert run is not None, "only runs are told"
    end = f"{short(run.braking_distance)} m in {short(run.braking_time, 3)} s"
    return f"stops in {end}" if run.stopped else f"{run.outcome.value} within {end}"


def _stop_finding(stop: Stop) -> str:
    shortest, bound = stop.shortest, stop.bound
    locked = [one.name for one in stop.runs if one.run is not None and one.run.locked_fraction > 0]
    if shortest is None:
        return "No controller stops the train."
    name = next(one.name for one in stop.runs if one.run is shortest)
    text = f"Shortest: {name}, {short(shortest.braking_distance)} m"
    if bound is not None and math.isfinite(bound.braking_distance):
        over = 100 * (shortest.braking_distance / bound.braking_distance - 1)
        text += f", {over:.0f} % over what no controller can beat ({short(bound.braking_distance)} m)"
    text += below_reference(shortest)
    return text + (f". The wheel locks with: {', '.join(locked)}." if locked else ". No wheel locks.")


def below_reference(run: Run) -> str:
    """That a run never came to the slip it was to hold, if so; a clause to append."""
    slips = run.controller.reference
    if run.max_slip >= min(slips.dry, slips.wet):
        return ""
    return f"; its slip stays below the reference throughout (at most {short(run.max_slip, 2)})"


def _stop_table(stop: Stop, start: float, end: float) -> Table:
    rows = []
    for one in stop.runs:
        run = one.run
        if run is None:
            continue
        rows.append(
            (
                one.name,
                run.outcome.value,
                short(run.braking_time),
                short(run.braking_distance),
                short(run.brake_energy / 1e6),
                short(run.mean_abs_slip_error, 3),
                short(run.max_slip, 3),
                f"{100 * run.locked_fraction:.2g}",
                short(run.max_torque / 1e3, 3),
            )
        )
    if stop.bound is not None:
        bound = (short(stop.bound.braking_time), short(stop.bound.braking_distance))
        rows.append(("no controller can beat", "bound", *bound, *(NONE,) * 5))
    head = (
        "Controller", "Outcome", "Time, s", "Distance, m", "Energy, MJ", "Mean |slip error|, -",
        "Highest slip, -", "Locked, %", "Highest torque, kN·m",
    )  # fmt: skip
    mass = f"M {stop.scenario.vehicle.mass:g} kg at the start"
    return Table(
        f"From {start:g} to {end:g} km/h, {mass}, adhesion {stop.scenario.adhesion.name}, noise seed {stop.seed}. "
        "Slip error: "
        "mean over time against the controller's own reference; locked: share of the time with rω < 0.02 v.",
        head,
        rows,
        wide=True,
    )


# --- the paper ------------------------------------------------------------------------------------------------------


def reproduction_section(report: DesignReport) -> Section:
    """Table 5 of the paper, or why it is not here."""
    comparison = report.table5
    if comparison is None:
        text = (
            "Left out: the printed results are of the published vehicle, and this report is about "
            f"{report.check.vehicle.name}. "
            "railslip reproduce computes them."
        )
        return Section("reproduction", "Reproduction of the paper", (Paragraph(text),))
    facts = tuple(_fact(one) for one in report.facts)
    return Section(
        "reproduction",
        "Reproduction of the paper",
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
    found = Paragraph(f"Found: {one.found}. By: {one.how}.")
    return Details(one.name, "holds" if one.holds else "does not hold", (Paragraph(one.statement), found))


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
        text += "railslip reproduce takes 256 seeds."
    return text


def _item(row: Row) -> str:
    return " ".join(row.item.split(" / ")[1:]).replace("_", " ")


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
                quantity.replace("_", " "),
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
        f"[Park2008] Table 5 beside the mean of {comparison.seeds} seeded runs; times in s, distances in m, energy "
        "in the "
        "printed reading.",
        head,
        rows,
    )


def _reading() -> Table:
    rows = [(rule.name, rule.basis.value, rule.used, rule.where) for rule in READING]
    return Table("Each rule, and where it comes from.", ("Rule", "Basis", "Used", "Where"), rows, wide=True)
