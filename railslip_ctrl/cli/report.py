"""Command `railslip report`: recommend a controller for a vehicle."""

from __future__ import annotations

import shlex
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

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
    help="Write report.html; this also decides the conditions of the sliding-mode law, and certifies where the brake "
    "can be released without a lock.",
)
@switch(
    "--fresh",
    "Decide the conditions of the sliding-mode law again; otherwise an earlier result for the same vehicle is reused.",
)
@preset(
    "--prefer",
    "|".join(PREFERENCES),
    "What decides between candidates that qualify: the shortest mean stop, or the least worst Ms.",
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
    prefer: str,
) -> None:
    """Recommend a slip controller for a vehicle over its envelope of speeds, rails, loads and tolerances.

    The report states from which speed to use the controller, how it brakes, and why. Gains or a controller of your own
    run in the same stops, and are judged if they have margins. The first page of report.html takes a minute to read;
    recommended.toml is the design for simulate and margins. Exit status 0 for every result, or 2 for bad input or a
    folder that cannot be written to.

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
    check_directory(out, [*_TEXTS, RECOMMENDED, *names, _PAGE])  # before the long work
    judged = cases.envelope(envelope or DEFAULT_ENVELOPE)
    plant = judged.points(nominal=True).plants[0]  # fails now, not after the long work, if there is no plant
    given: dict[str, Any] = {}
    gains = chosen_gains(kp, ki)
    if controller is not None:
        given = {Path(controller).name: given_controller(controller, plant.point, gains, judged.reference)}
    elif gains is not None:
        given = {"given PI": PIController(gains)}
    for one in given.values():
        if not no_margins(one):
            wheel_slip_loop(plant, one)  # an InputError if the controller is not linear at this point
    pictures = Pictures()
    with claimed(out):
        draw = partial(_draw, pictures=pictures, note=note)
        found = design_report(
            judged,
            nominal=nominal,
            given=given,
            sliding=whole,
            fresh=fresh,
            prefer=prefer,
            progress=note,
            meanwhile=draw,
        )
        _draw(found, pictures, note)
        rest = f"The rest: {out / (_PAGE if whole else 'report.json')}"
        files, content, text = _made(found, pictures, whole, command_line(ctx), rest, _again(cases, found, out))
        drawn = {name: files.pop(name) for name in [*pictures.files(), _PAGE] if name in files}
        try:
            count = pictures.write(out, write_files(out, files), drawn)
        finally:
            show(as_json, lambda: content, lambda: files["report.txt"].decode() if width() == WIDTH else text())
    note(f"wrote {count} files to {out}" + (f"; open {out / _PAGE} in a browser" if whole else ""))


def _draw(found: DesignReport, pictures: Pictures, note: Callable[[str], None]) -> None:
    """Draw the pictures that are missing, as PNG and SVG, and add them by name."""

    def drawings() -> Drawings:
        from railslip_ctrl.report.plots.designs import report_drawings

        return report_drawings(found)

    if not pictures.drawn:
        note("pictures")
    pictures.draw(drawings)


def _made(
    found: DesignReport, pictures: Pictures, whole: bool, command: str, rest: str, again: str
) -> tuple[dict[str, bytes], dict[str, Any], Callable[[], str]]:
    """Files by name, the content of report.json, and a function that writes the text at the current width."""
    first = first_page(found)
    files = pictures.files()
    if found.control is not None:
        files[RECOMMENDED] = found.control.toml.encode()
    if whole:
        svg = {name: forms["svg"] for name, forms in pictures.drawn.items()}
        files[_PAGE] = page(first, design_sections(found, again), svg, command, found.date, found.seconds).encode()
    content = design_report_json(found, [*_TEXTS, *files])
    files["report.json"] = json_text(content).encode()
    text = partial(design_report_text, found, first, f"{rest}\n{again}".rstrip())
    files["report.txt"] = text().encode()
    return files, content, text


def _again(cases: CaseOptions, found: DesignReport, out: Path) -> str:
    """Command that repeats the first stop of the page digit for digit; empty if there is no stop."""
    if not found.stops:
        return ""
    stop = found.longest_stops[0]
    words = ["railslip simulate --scenario stop", f"--controller {shlex.quote(str(out / RECOMMENDED))}"]
    words += [f"--vehicle {shlex.quote(str(cases.vehicle))}"] if cases.vehicle is not None else []
    laws = {str(getattr(law, "name", law)): law for law in found.envelope.laws}
    files = [law for law in found.envelope.laws if str(law).endswith((".toml", ".py"))]
    law = laws.get(stop.law) or next(iter(files), found.envelope.laws[0])
    words += [f"--adhesion {shlex.quote(str(getattr(law, 'name', law)))}"] if stop.law != "curve" else []
    words += ["--loaded"] if stop.load == "loaded" else []
    speed = found.envelope.initial_speed
    words += [f"--speed {speed:g}"] if speed != 100.0 else []
    v0 = found.envelope.law_speed
    words += [f"--initial-speed {v0:g}"] if v0 != speed else []
    for name, value in (("inertia-scale", cases.inertia_scale), ("dead-time", cases.dead_time), ("lag", cases.lag)):
        words += [f"--{name} {value:g}"] if value is not None else []
    words += [f"--rail {stop.rail}", f"--seed {stop.run.seed}"]
    return f"The {stop.rail} stop again: {' '.join(words)}"
