"""Command `railslip campaign`: many braking runs with statistics, or the probability of a rare event."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal

import click

from railslip_ctrl.core.errors import InputError, check_extra
from railslip_ctrl.core.user_files import read_toml
from railslip_ctrl.report.campaign import campaign_json, campaign_text, replay_json, replay_text
from railslip_ctrl.report.export import check_directory, json_text
from railslip_ctrl.report.pictures import Drawings, write_results
from railslip_ctrl.report.rare import files_of, json_of, text_of
from railslip_ctrl.simulation.campaign.execution import execute, replay
from railslip_ctrl.simulation.campaign.rare import POINTS, ConfidenceLevels, RareEvent, rare_event
from railslip_ctrl.simulation.campaign.rare import confidence_levels as confidence_levels_of
from railslip_ctrl.simulation.campaign.specification import Campaign, load_campaign
from railslip_ctrl.simulation.campaign.statistics import CampaignSummary, check_measure, summarise
from railslip_ctrl.simulation.run import Run

from .options import controller_option, print_remarks, refuse_given
from .output import progress, show
from .settings import HELP, json_option, option, preset, switch

_REPORT = ("report.txt", "report.json")
_PICTURES = ("distributions", "scatter")  # PNG


@click.command(context_settings=HELP)
@click.argument("campaign_file", metavar="CAMPAIGN.toml", type=click.Path(path_type=Path))
@controller_option("the tables of the file; may be given several times", multiple=True)
@click.option(
    "--out",
    required=True,
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Folder for runs (Parquet), report and pictures; an unfinished campaign in this folder is continued.",
)
@option("--workers", "N", "Number of processes.", "one for each core", type=int)
@option("--scheduler", "ADDRESS", "Address tcp://HOST:PORT of the Dask scheduler that runs the campaign.", "none")
@preset("--device", "cpu|gpu", "Run on the processor's cores, or on an NVIDIA GPU (extra gpu).", "cpu")
@preset("--worst-by", "MEASURE", "Measure that ranks the worst runs.", "braking_distance_m")
@option("--replay", "I", "Repeat run number I and write its time series (CSV, picture).", "none", to="number", type=int)
@option("--rare", "lock|BOUND", 'Probability of "distance > 420 m", "time > 20 s", "slip > 0.5" or lock.', "none")
@switch("--confidence-levels", "Table of Kdry_rst, the factor on the deceleration for ETCS confidence levels 0 to 9.")
@preset(
    "--points",
    "N",
    "With --rare or --confidence-levels: number of stops in each level of the simulation.",
    POINTS,
    type=int,
)
@switch("--internal", "With --replay: also write the controllers' internal state into the time series.")
@json_option
def command(
    campaign_file: Path,
    controller: tuple[str, ...],
    out: Path,
    workers: int | None,
    scheduler: str | None,
    device: Literal["cpu", "gpu"],
    worst_by: str,
    number: int | None,
    rare: str | None,
    confidence_levels: bool,
    points: int,
    internal: bool,
    as_json: bool,
) -> None:
    """Run a scenario many times with sampled quantities and report statistics.

    The runs use every core. The command continues an interrupted campaign in DIR. Exit status 0, or 2 for bad input.

    The adhesion law comes from the scenario; there is no option --adhesion. To choose a law, name a scenario file in
    CAMPAIGN.toml (scenario = "own.toml"), and name the law in the scenario file (adhesion = "beam", or adhesion =
    "law.toml" for your own law).

    Example: railslip campaign tolerances.toml --out tolerances
    """
    check_extra("campaign", "campaign")
    check_directory(out, [*_REPORT, *(f"{name}.png" for name in _PICTURES)])
    if device not in ("cpu", "gpu"):
        raise InputError(f"--device: {device!r} is not allowed; choose cpu or gpu")
    if device == "gpu":
        refuse_given("workers", "scheduler", because="with --device gpu")
    campaign = replace(load_campaign(campaign_file, controllers=controller), device=device)
    print_remarks(campaign.scenario.vehicle)
    if rare is not None or confidence_levels:
        both = "with --rare or --confidence-levels"
        refuse_given("device", "worst_by", "number", "internal", *(["rare"] if confidence_levels else []), because=both)
        estimate = confidence_levels_of if rare is None else partial(rare_event, event=rare)
        result = estimate(campaign, folder=out, workers=workers, scheduler=scheduler, points=points, progress=progress)
        _show_rare(result, out, _scenario_from(campaign_file, out), as_json=as_json)
        return
    refuse_given("points", because="without --rare or --confidence-levels")
    if number is None:
        refuse_given("internal", because="without --replay")
    else:
        refuse_given("workers", "scheduler", "worst_by", because="with --replay")
        _replay(campaign, number, out, internal=internal, as_json=as_json)
        return
    check_measure(worst_by)
    with _bar(campaign.runs) as advance:
        store = execute(campaign, out, workers=workers, scheduler=scheduler, progress=advance)
    progress("compute the statistics and draw the pictures")
    summary = summarise(store, worst_by=worst_by)
    text, content = campaign_text(summary), campaign_json(summary)
    try:
        results = {"report.txt": text, "report.json": json_text(content)}
        count = write_results(out, results, partial(_drawings, summary), ["png"])
    finally:
        show(as_json, lambda: content, lambda: campaign_text(summary))
    progress(f"wrote {count} files to {out}")


def _show_rare(result: RareEvent | ConfidenceLevels, out: Path, scenario: str, *, as_json: bool) -> None:
    def figures() -> Drawings:
        from railslip_ctrl.report.plots.runs import tail_figure

        return {"tail": tail_figure(result)}

    try:
        count = write_results(out, files_of(result, scenario), figures, ["png"])
    finally:
        show(as_json, lambda: json_of(result), lambda: text_of(result))
    progress(f"wrote {count} files to {out}")


def _scenario_from(campaign_file: Path, out: Path) -> str:
    named = str(read_toml(campaign_file)["scenario"])
    return os.path.relpath(campaign_file.parent / named, out) if named.lower().endswith(".toml") else named


def _replay(campaign: Campaign, number: int, out: Path, *, internal: bool, as_json: bool) -> None:
    def figures() -> Drawings:
        from railslip_ctrl.report.plots.runs import replay_figure

        return {f"run-{number}": replay_figure(again)}

    if not 0 <= number < campaign.runs:
        raise InputError(f"--replay: {number} is not allowed; the campaign has runs 0 to {campaign.runs - 1}")
    again = replay(campaign, number, out)
    logs = {f"run-{number}-{name}.csv": partial(_write_csv, run, internal=internal) for name, run in again.runs.items()}
    try:
        write_results(out, logs, figures, ["png"])
    finally:
        show(as_json, lambda: replay_json(again), lambda: replay_text(again))
    progress(f"wrote {', '.join(str(out / name) for name in (*logs, f'run-{number}.png'))}")


def _write_csv(run: Run, path: Path, *, internal: bool) -> None:
    assert run.signals is not None, "a replay records them"
    own = run.controller_signals.items() if internal else ()
    columns = {**run.signals._asdict(), **{f"controller_{name}": values for name, values in own}}
    with path.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(columns)
        for row in zip(*(values.tolist() for values in columns.values()), strict=True):
            rows.writerow("" if isinstance(x, float) and math.isnan(x) else x for x in row)


def _drawings(summary: CampaignSummary) -> Drawings:
    from railslip_ctrl.report.plots.runs import distributions_figure, scatter_figure

    figures = zip(_PICTURES, (distributions_figure(summary), scatter_figure(summary)), strict=True)
    return {name: figure for name, figure in figures if figure is not None}


@contextmanager
def _bar(runs: int) -> Iterator[Callable[[int], None]]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("railslip: runs"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    bar = Progress(*columns, console=Console(stderr=True))
    task = bar.add_task("runs", total=runs)

    def advance(done: int) -> None:
        bar.start()  # not earlier: a rejected command prints only its message
        bar.advance(task, done)

    try:
        yield advance
    finally:
        if bar.live.is_started:
            bar.stop()
