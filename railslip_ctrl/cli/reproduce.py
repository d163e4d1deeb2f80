"""`railslip reproduce`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from railslip_ctrl.errors import InputError
from railslip_ctrl.report import check_directory, write_files
from railslip_ctrl.report.reproduction import reproduction_json, reproduction_text
from railslip_ctrl.reproduction import published_facts, sensitivity, table3, table5
from railslip_ctrl.reproduction.runs import MOST_SEEDS, checked_seeds
from railslip_ctrl.reproduction.sensitivity import DEFAULT_SEEDS as SENSITIVITY_SEEDS
from railslip_ctrl.reproduction.table5 import DEFAULT_SEEDS

from .output import print_json, print_text, progress
from .settings import HELP

PICTURES = ("fig_13", "figs_14_15", "fig_17", "fig_18", "fig_19", "fig_20", "fig_21")


@click.command(context_settings=HELP)
@click.option(
    "--seeds",
    default=str(DEFAULT_SEEDS),
    show_default=True,
    metavar="N",
    help="Number of noise seeds, runs of each column.",
)
@click.option(
    "--sensitivity",
    "with_sensitivity",
    is_flag=True,
    help="Put each rule of the reading to its alternatives, one at a time, with fewer seeds "
    f"(N, at most {SENSITIVITY_SEEDS}). The first time this compiles for a minute or two.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Folder for reproduction.txt, reproduction.json and the figures redrawn (PNG).  [default: nothing is written]",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object and nothing else.")
@click.pass_context
def command(ctx: click.Context, seeds: str, with_sensitivity: bool, out: Path | None, as_json: bool) -> None:
    """The tables and figures of [Park2008] beside what this software obtains: Table 5's sixteen numbers, the reading
    they come out under, Table 3 as far as it can be, and other facts of the runs. Exit status 1 if a number of Table 5
    is out of tolerance, 2 for bad input.

    Example: railslip reproduce --seeds 16 --out reproduced
    """
    count = _seeds(seeds)
    names = ["reproduction.txt", "reproduction.json", *(f"{name}.png" for name in PICTURES)]
    if out is not None:
        check_directory(out, names)  # before the work, not after it
    comparison = table5(count, progress=progress)
    found = published_facts(progress=progress)
    worth = sensitivity(min(count, SENSITIVITY_SEEDS), progress=progress) if with_sensitivity else None
    text = reproduction_text(comparison, table3(), found, worth)
    content = reproduction_json(comparison, table3(), found, worth)
    if out is not None:
        progress("pictures")
        write_files(out, _writers(text, content))
        progress(f"wrote {len(names)} files to {out}")
    if as_json:
        print_json(content)
    else:
        print_text(reproduction_text, comparison, table3(), found, worth)
    ctx.exit(0 if comparison.within else 1)


def _seeds(text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) <= len(str(MOST_SEEDS))):
        raise InputError(f"--seeds: {text[:60]!r} is not allowed; give a whole number from 2 to {MOST_SEEDS}")
    try:
        return checked_seeds(int(text))
    except InputError as error:
        raise InputError(f"--{error}") from None


def _writers(text: str, content: dict[str, Any]) -> dict[str, Callable[[Path], None]]:
    from railslip_ctrl.plots import save_figure
    from railslip_ctrl.plots.reproduction import model_figures, run_figures, wet_and_dry_figure
    from railslip_ctrl.reproduction import model_curves, published_runs
    from railslip_ctrl.reproduction.curves import wet_and_dry

    figures = {
        **model_figures(model_curves()),
        "fig_17": wet_and_dry_figure(wet_and_dry()),
        **run_figures(published_runs()),
    }
    writers: dict[str, Callable[[Path], None]] = {
        "reproduction.txt": lambda path: _write_text(path, text),
        "reproduction.json": lambda path: _write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n"),
    }
    for name in PICTURES:
        writers[f"{name}.png"] = lambda path, figure=figures[name]: save_figure(figure, path)  # type: ignore[misc]
    return writers


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")
