"""Command `railslip report`: recommend a controller for a vehicle."""

from __future__ import annotations

import shlex
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Literal

import click

from railslip_ctrl.controllers.systems import PIController, wheel_slip_loop
from railslip_ctrl.core.errors import check_extra
from railslip_ctrl.core.folders import claimed
from railslip_ctrl.report.candidates import PREFERENCES, no_margins
from railslip_ctrl.report.design_json import design_report_json
from railslip_ctrl.report.design_report import (
    RECOMMENDED,
    design_report_text,
    design_sections,
    first_page,
)
from railslip_ctrl.report.document import WIDTH, width
from railslip_ctrl.report.export import check_directory, json_text, write_files
from railslip_ctrl.report.page import page
from railslip_ctrl.report.pictures import Drawings, Pictures
from railslip_ctrl.report.recommendation import DesignReport, design_report

from .margins import given_controller
from .options import (
    DEFAULT_ENVELOPE,
    CaseOptions,
    case_options,
    chosen_gains,
    controller_option,
    envelope_options,
    gain_options,
    refuse_given,
)
from .output import command_line, progress, show
from .settings import HELP, preset, switch

_TEXTS = ("report.txt", "report.json")
_PAGE = "report.html"
_PICTURES = ("map", "loop", "stops", "gains", "responses", "adhesion", "no-lock")


@click.command(context_settings=HELP)
@case_options(over=True)
@envelope_options("the vehicle's own, or the default")
@gain_options("only the recommended design is judged and run")
@controller_option("only the recommended design is judged and run")
@preset(
    "--out",
    "DIR",
    f"Folder for {RECOMMENDED}, report.html, report.txt, report.json and every picture as PNG and SVG.",
    "railslip-report",
    type=click.Path(path_type=Path),
)
@click.option(
    "--html/--no-html",
    "whole",
    default=True,
    show_default=True,
    help="Write report.html; this also verifies the conditions of the sliding-mode law, and certifies where a brake "
    "release prevents a lock.",
)
@switch(
    "--fresh",
    "Verify the conditions of the sliding-mode law again instead of reusing an earlier result for the same vehicle.",
)
@preset(
    "--prefer",
    "|".join(PREFERENCES),
    "Recommend the qualified candidate with the shortest mean stop (distance) or the smallest worst Ms (robustness).",
    PREFERENCES[0],
    type=click.Choice(PREFERENCES),
)
@click.pass_context
def command(
    ctx: click.Context,
    cases: CaseOptions,
    as_json: bool,
    envelope: str | None,
    nominal: bool,
    kp: float | None,
    ki: float | None,
    controller: str | None,
    out: Path,
    whole: bool,
    fresh: bool,
    prefer: Literal["distance", "robustness"],
) -> None:
    """Recommend a slip controller for a vehicle over its envelope of speeds, rails, loads and tolerances.

    The report states the lowest speed at which to use the controller, how it brakes, and the reasons. If you give gains
    or a controller, the report simulates the stops with them too, and judges them if they have margins. The first page
    of report.html takes a minute to read. The file recommended.toml contains the recommended controller; simulate and
    margins accept it. Exit status 0 for every result, or 2 for bad input or a folder that cannot be written to.

    Example: railslip report --vehicle my_train.toml --speed 100 --speed 60 --out check
    """
    if whole:
        check_extra("html", "--html", ", or give --no-html")
    else:
        refuse_given("fresh", because="with --no-html")
    started = time.perf_counter()

    def note(message: str) -> None:
        progress(f"{time.perf_counter() - started:5.1f} s  {message}")

    names = [f"{name}.{suffix}" for name in _PICTURES for suffix in ("png", "svg")]
    check_directory(out, [*_TEXTS, RECOMMENDED, *names, _PAGE])  # before the long computation
    judged = cases.envelope(envelope or DEFAULT_ENVELOPE)
    plant = judged.points(nominal=True).plants[0]  # an error comes before the long computation, if no plant exists
    given: dict[str, Any] = {}
    gains = chosen_gains(kp, ki)
    if controller is not None:
        given = {Path(controller).name: given_controller(controller, plant.point, gains, judged.reference)}
    elif gains is not None:
        given = {"given PI": PIController(gains)}
    for candidate in given.values():
        if not no_margins(candidate):
            wheel_slip_loop(plant, candidate)  # raises InputError if the controller is not linear here
    pictures = Pictures()
    with claimed(out):
        draw = partial(_draw, pictures=pictures, note=note)
        design = design_report(
            judged,
            nominal=nominal,
            given=given,
            sliding=whole,
            fresh=fresh,
            prefer=prefer,
            progress=note,
            meanwhile=draw,
        )
        _draw(design, pictures, note)
        rest = f"All results: {out / (_PAGE if whole else 'report.json')}"
        files, content, text = _made(design, pictures, whole, command_line(ctx), rest, _again(cases, design, out))
        drawn = {name: files.pop(name) for name in [*pictures.files(), _PAGE] if name in files}
        try:
            count = pictures.write(out, write_files(out, files), drawn)
        finally:
            show(as_json, lambda: content, lambda: files["report.txt"].decode() if width() == WIDTH else text())
    note(f"wrote {count} files to {out}" + (f"; open {out / _PAGE} in a browser" if whole else ""))


def _draw(design: DesignReport, pictures: Pictures, note: Callable[[str], None]) -> None:
    def drawings() -> Drawings:
        from railslip_ctrl.report.plots.designs import report_drawings

        return report_drawings(design)

    if not pictures.drawn:
        note("pictures")
    pictures.draw(drawings)


def _made(
    design: DesignReport, pictures: Pictures, whole: bool, command: str, rest: str, again: str
) -> tuple[dict[str, bytes], dict[str, Any], Callable[[], str]]:
    first = first_page(design)
    files = pictures.files()
    if design.control is not None:
        files[RECOMMENDED] = design.control.toml.encode()
    if whole:
        svg = {name: forms["svg"] for name, forms in pictures.drawn.items()}
        files[_PAGE] = page(first, design_sections(design, again), svg, command, design.date, design.seconds).encode()
    content = design_report_json(design, [*_TEXTS, *files])
    files["report.json"] = json_text(content).encode()
    text = partial(design_report_text, design, first, f"{rest}\n{again}".rstrip())
    files["report.txt"] = text().encode()
    return files, content, text


def _again(cases: CaseOptions, design: DesignReport, out: Path) -> str:
    if not design.stops:
        return ""
    stop = design.longest_stops[0]
    parts = ["railslip simulate --scenario stop", f"--controller {shlex.quote(str(out / RECOMMENDED))}"]
    parts += [f"--vehicle {shlex.quote(str(cases.vehicle))}"] if cases.vehicle is not None else []
    laws = {str(getattr(law, "name", law)): law for law in design.envelope.laws}
    files = [law for law in design.envelope.laws if str(law).endswith((".toml", ".py"))]
    law = laws.get(stop.law) or next(iter(files), design.envelope.laws[0])
    parts += [f"--adhesion {shlex.quote(str(getattr(law, 'name', law)))}"] if stop.law != "curve" else []
    parts += ["--loaded"] if stop.load == "loaded" else []
    speed = design.envelope.initial_speed
    parts += [f"--speed {speed:g}"] if speed != 100.0 else []
    v0 = design.envelope.law_speed
    parts += [f"--initial-speed {v0:g}"] if v0 != speed else []
    for name, value in (("inertia-scale", cases.inertia_scale), ("dead-time", cases.dead_time), ("lag", cases.lag)):
        parts += [f"--{name} {value:g}"] if value is not None else []
    parts += [f"--rail {stop.rail}", f"--seed {stop.run.seed}"]
    return f"To repeat the {stop.rail} stop: {' '.join(parts)}"
