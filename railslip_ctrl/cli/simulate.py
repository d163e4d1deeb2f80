"""Command `railslip simulate`: one braking run."""

from __future__ import annotations

import math
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import click

from railslip_ctrl.controllers.base import Controller
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.design.catalogue import (
    COLUMNS,
    controller_named,
    default_column,
    is_tuned_when_asked,
    tracked_reference,
)
from railslip_ctrl.report.export import FileContent, check_directory, check_file, json_text, write_files
from railslip_ctrl.report.pictures import Drawings, write_results
from railslip_ctrl.report.simulation import simulation_json, simulation_text, write_simulation_csv
from railslip_ctrl.simulation import Noise, Run, Scenario, Simulator
from railslip_ctrl.simulation.scenario import LEAST_STEP

from . import options
from .output import progress, show
from .settings import HELP, option, path_option, preset, switch

LOG_PERIOD = 0.01  #: s, default interval between rows of the CSV and between points of the pictures

LARGEST_SEED = 2**63 - 1
_TABLE_4 = ("pi", "asmc")
_FILES = ("simulation.txt", "simulation.json", "simulation.csv", "simulation.png", "simulation.svg")


@click.command(context_settings=HELP)
@options.case_options(run=True)
@options.controller_option("pi", default="pi")
@option(
    "--gains",
    "|".join(COLUMNS),
    "Column of Park et al., Table 4, for gains and reference slip.",
    "gains of column beam for the beam law, of bristle for other laws; slip of the law",
)
@option("--slip", "X", "Reference slip on both rails.", "from the adhesion law, or from --gains", type=options.SLIP)
@switch("--unknown-rail", "asmc: use the adhesion model of dry rail also on wet rail.")
@switch("--adaptive", "asmc: use the adaptation law as printed in the paper.")
@options.number_option(
    "--period", "s", "The controller's sampling period, s.", "integration step; slide-protection 0.01", ge=LEAST_STEP
)
@options.gain_options("those of Park et al., Table 4")
@preset("--seed", "N|FILE", "Seed of random force and sensor noise, or an .npz file that campaign wrote.", "0")
@switch("--no-noise", "No random force and no sensor noise.")
@path_option("--csv", "FILE", "Write the time series.")
@switch("--internal", "Also write the controller's internal state into the time series.")
@click.option(
    "--out",
    "--plot",
    "out",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Write report, JSON, time series and pictures (PNG and SVG) into a folder.  [default: none]",
)
@preset(
    "--log-period",
    "S",
    "Interval between rows of the time series, s; at least the sampling period.",
    LOG_PERIOD,
    type=options.Number("s", ge=LEAST_STEP),
)
@click.pass_context
def command(
    ctx: click.Context,
    /,
    cases: options.CaseOptions,
    seed: str,
    no_noise: bool,
    csv: Path | None,
    internal: bool,
    out: Path | None,
    log_period: float,
    as_json: bool,
    **control: Any,
) -> None:
    """Simulate a braking run and report outcome, time, distance, energy, slip error, time series and pictures.

    Exit status 0, 1 if the train did not stop, or 2 for bad input.

    Example: railslip simulate --scenario park2008 --controller asmc --gains bristle --seed 7 --csv run.csv
    """
    if csv is None and out is None:
        options.refuse_given("internal", because="without --csv or --out")
    if no_noise:
        options.refuse_given("seed", because="with --no-noise")
    if csv is not None:
        check_file(csv, "--csv")
    if out is not None:
        check_directory(out, _FILES)
    noise: int | Noise | None = None
    if not no_noise:
        drawn = seed.lower().endswith(".npz")
        noise = Noise.load(Path(seed)) if drawn else options.whole_number("--seed", seed, 0, LARGEST_SEED)
    scenario = cases.run_scenario()
    law_speed = cases.law_speed(scenario.initial_speed)
    controller, column = _chosen(scenario, law_speed, slip=cases.slip, **control)
    simulator = Simulator(scenario, controller)
    every = max(round(log_period / simulator.period), 1)
    rows = every * simulator.period
    if (csv is not None or out is not None) and not math.isclose(rows, log_period):
        progress(
            f"note: --log-period: {log_period:g} s is not a multiple of the sampling period {simulator.period:g} s; "
            f"rows are {rows:g} s apart"
        )
    run = simulator.run(noise, record_every=every)  # recorded: the report needs the times of events
    content = simulation_json(run, column, law_speed)
    with ExitStack() as parts:  # runs the callbacks from the last to the first, even if one fails
        parts.callback(show, as_json, lambda: content, lambda: simulation_text(run, law_speed))
        if out is not None:
            parts.callback(_write, out, run, content, simulation_text(run, law_speed), internal=internal)
        if csv is not None:
            series = {csv.name: partial(write_simulation_csv, run, internal=internal)}
            parts.callback(write_files, csv.parent, series, option="--csv")
    ctx.exit(0 if run.stopped else 1)


def _chosen(
    scenario: Scenario,
    law_speed: float,
    *,
    controller: str,
    gains: str | None,
    slip: float | None,
    unknown_rail: bool,
    adaptive: bool,
    period: float | None,
    kp: float | None,
    ki: float | None,
) -> tuple[Controller, str | None]:
    vehicle, law = scenario.believed_vehicle, scenario.adhesion
    if options.is_file(controller):
        numbers = {"--gains": gains, "--kp": kp, "--ki": ki, "--slip": slip, "--period": period}
        for flag, given in (numbers | {"--unknown-rail": unknown_rail or None, "--adaptive": adaptive or None}).items():
            if given is not None:
                raise InputError(f"{flag} is not allowed with a controller file; write the value into {controller}")
        return options.controller_from_file(controller, vehicle, law.reference, law_speed), None
    name, own = options.controller_name(controller), options.chosen_gains(kp, ki)
    column = None if gains is None else next((label for label in COLUMNS if label == gains.lower()), None)
    if column is None and gains is not None:
        raise InputError(f"--gains: {gains!r} is not a column of Park et al., Table 4; choose {' or '.join(COLUMNS)}")
    reference = tracked_reference(name, law, slip, column, dashes="--")
    if is_tuned_when_asked(name, vehicle.empty(), own):
        progress(f"tuning {name} for {vehicle.name}; this takes some seconds")
    column = column or default_column(law)
    asked: dict[str, Any] = {"column": column, "gains": own, "reference": reference, "period": period}
    asked |= {"knows_rail": not unknown_rail, "adaptive": adaptive}
    made = options.naming("--controller", lambda: controller_named(name, vehicle, **asked))
    return made, column if name in _TABLE_4 and own is None else None


def _write(out: Path, run: Run, content: dict[str, Any], text: str, *, internal: bool) -> None:
    def figures() -> Drawings:
        from railslip_ctrl.report.plots.runs import simulation_figure

        return {"simulation": simulation_figure(run)}

    results: dict[str, FileContent] = {
        "simulation.txt": text,
        "simulation.json": json_text(content),
        "simulation.csv": partial(write_simulation_csv, run, internal=internal),
    }
    progress(f"wrote {write_results(out, results, figures)} files to {out}")
