"""The command `railslip reproduce`."""

from __future__ import annotations

import datetime
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import click

from railslip_ctrl.core.errors import check_extra
from railslip_ctrl.design.assessment import ControllerGroup, published_groups
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH, PARK2008, Rail
from railslip_ctrl.paper import tables
from railslip_ctrl.paper.reading import DEFAULT_SEEDS as SENSITIVITY_SEEDS
from railslip_ctrl.paper.reading import sensitivity
from railslip_ctrl.report.export import check_directory, json_text, write_files
from railslip_ctrl.report.pictures import Drawings, Pictures
from railslip_ctrl.report.reproduction import FIGURES, reproduction_json, reproduction_text

from .options import whole_number
from .output import command_line, progress, show
from .settings import HELP, json_option, path_option, preset, switch

_PAGE = "reproduce.html"


@click.command(context_settings=HELP)
@preset("--seeds", "N", "Number of noise seeds: runs of each column of Table 5.", str(tables.DEFAULT_SEEDS))
@switch(
    "--sensitivity",
    f"Replace each unit assumption by its alternatives, one at a time, with at most {SENSITIVITY_SEEDS} seeds. "
    "The first call compiles for one or two minutes.",
    to="with_sensitivity",
)
@path_option(
    "--out",
    "DIR",
    "Folder for reproduce.html (with the errata, and Table 4's gains with both inertia scales), reproduction.txt, "
    "reproduction.json and the redrawn figures (PNG).",
    "nothing is written",
)
@json_option
@click.pass_context
def command(ctx: click.Context, seeds: str, with_sensitivity: bool, out: Path | None, as_json: bool) -> None:
    """Compare the tables and figures of [Park2008] with the results of this software.

    Shows the sixteen numbers of Table 5, the units with which they can be reproduced, the parts of Table 3 that can be
    checked, and further facts about the published runs. Exit status 1 if a number of Table 5 is out of tolerance, 2
    for bad input.

    Example: railslip reproduce --seeds 16 --out reproduced
    """
    count = whole_number("--seeds", seeds, 2, tables.MOST_SEEDS)
    names = ["reproduction.txt", "reproduction.json", _PAGE, *(f"{name}.png" for name in FIGURES)]
    if out is not None:
        check_extra("html", "--out")
        check_directory(out, names)  # before the computation starts
    comparison = tables.table5(count, progress=progress)
    facts = tables.published_facts(progress=progress)
    alternatives = sensitivity(min(count, SENSITIVITY_SEEDS), progress=progress) if with_sensitivity else None
    text = reproduction_text(comparison, tables.table3(), facts, alternatives)
    content = reproduction_json(comparison, tables.table3(), facts, alternatives)
    try:
        if out is not None:
            written = write_files(out, {"reproduction.txt": text, "reproduction.json": json_text(content)})
            count = _write_page(out, written, comparison, facts, command_line(ctx))
            progress(f"wrote {count} files to {out}")
    finally:
        show(as_json, lambda: content, lambda: reproduction_text(comparison, tables.table3(), facts, alternatives))
    ctx.exit(0 if comparison.within else 1)


def _write_page(
    out: Path, written: Sequence[Path], comparison: tables.Table5, facts: Sequence[tables.Fact], command: str
) -> int:
    from railslip_ctrl.core.folders import cached
    from railslip_ctrl.design.schedule import plant_at
    from railslip_ctrl.paper.errata import errata
    from railslip_ctrl.report.page import page
    from railslip_ctrl.report.reproduction import reproduction_first_page, reproduction_sections
    from railslip_ctrl.sliding.derivation import derive

    started = time.perf_counter()
    progress("compute the errata, and margins with the gains of Table 4 in SI and as published")
    misprints = cached("errata", lambda: errata(derive()))
    points = [plant_at("bristle", PARK2008, rail, v).point for rail in Rail for v in (100.0, 60.0, 20.0)]
    groups = published_groups([replace(point, initial_speed_kmh=INITIAL_SPEED_KMH) for point in points])
    progress("draw the pictures")
    pictures = Pictures()
    pictures.draw(partial(_drawings, comparison, groups))
    svg = {name: files["svg"] for name, files in pictures.drawn.items()}
    content = (comparison, facts, misprints, groups)
    today, seconds = datetime.date.today(), time.perf_counter() - started
    html = page(reproduction_first_page(*content), reproduction_sections(*content), svg, command, today, seconds)
    figures = {f"{name}.png": files["png"] for name, files in pictures.drawn.items() if name in FIGURES}
    return pictures.write(out, written, {_PAGE: html, **figures})


def _drawings(comparison: tables.Table5, groups: tuple[ControllerGroup, ...]) -> Drawings:
    from railslip_ctrl.report.plots.designs import bode_figure, nyquist_figure
    from railslip_ctrl.report.plots.reproduction import (
        deviations_figure,
        model_figures,
        run_figures,
        wet_and_dry_figure,
    )

    return {
        **model_figures(tables.model_curves()),
        "fig_17": wet_and_dry_figure(tables.wet_and_dry()),
        **run_figures(tables.published_runs()),
        "table5": deviations_figure(comparison),
        "bode": bode_figure(groups),
        "nyquist": nyquist_figure(groups),
    }
