"""`railslip report`, the main job."""

from __future__ import annotations

import json
import shlex
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from railslip_ctrl.design_check import DesignCheck, design_check
from railslip_ctrl.design_report import LinearPart, RunPart, design_report
from railslip_ctrl.folders import claimed
from railslip_ctrl.linearization import OperatingPoint
from railslip_ctrl.machine import cores
from railslip_ctrl.parameters import PIGains
from railslip_ctrl.report import check_directory, design_check_json, design_check_text, write_files
from railslip_ctrl.report.design_report_json import design_report_json
from railslip_ctrl.report.html import design_report_html
from railslip_ctrl.report.html.verdict import verdict
from railslip_ctrl.report.layout import WIDTH, width
from railslip_ctrl.report.provenance import Provenance

from .options import CaseOptions, case_options, chosen_gains, gain_options
from .output import print_json, print_text, progress
from .settings import HELP

_TEXTS = ("report.txt", "report.json")
_PAGE = "report.html"
_OF_CHECK = ("bode", "nyquist", "nichols")
_OF_PAGE = (
    *_OF_CHECK,
    "adhesion",
    "region",
    "gang",
    "responses",
    "recommended",
    "range",
    "stop-1",
    "stop-2",
    "stop-3",
    "table5",
)


@click.command(context_settings=HELP)
@case_options
@gain_options
@click.option(
    "--out",
    default="railslip-report",
    show_default=True,
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Folder for report.html, report.txt, report.json and every picture as PNG and SVG.",
)
@click.option(
    "--html/--no-html",
    "page",
    default=True,
    show_default=True,
    help="Write report.html too: designs, sliding-mode verdict, braking runs, the paper's numbers. It takes most of "
    "the time.",
)
@click.option(
    "--fresh",
    is_flag=True,
    help="Decide the conditions of the sliding-mode laws, compute the paper's numbers and errata, and draw the "
    "pictures, again; what an earlier report of this version found of the same vehicle, or drew of the same numbers, "
    "is taken otherwise.",
)
@click.pass_context
def command(
    ctx: click.Context,
    cases: CaseOptions,
    as_json: bool,
    kp: float | None,
    ki: float | None,
    out: Path,
    page: bool,
    fresh: bool,
) -> None:
    """The design check: a recommendation with its margins from 100 km/h to walking pace, dry and wet, beside the
    published (or given) gains in both readings of the units and a PI that holds. report.html has that and all else a
    design review looks at, in one file that needs no network and prints on A4; the text begins with its verdict.
    Exit status 0 whatever is found, or 2 for bad input or a folder that cannot be written to: nothing is written then.

    Example: railslip report --vehicle my_train.toml --speed 100 --speed 60 --out check
    """
    told = _timed()
    check_directory(out, _may_write(page))  # before the work, not after it
    gains = chosen_gains(kp, ki)
    points = cases.points()
    with claimed(out):
        check = design_check(cases.chosen_vehicle, points, given=gains, progress=told)
        files, content, text = (
            _with_page(check, points, gains, provenance(ctx), told, fresh) if page else _without_page(check, told)
        )
        whole = text()
        files["report.txt"] = whole.encode()
        files["report.json"] = (json.dumps(content, indent=2, allow_nan=False) + "\n").encode()
        written = write_files(out, {name: _writer(files[name]) for name in content["files"]})
    if as_json:
        print_json(content)
    else:
        print_text(lambda: whole if width() == WIDTH else text())
    told(f"wrote {len(written)} files to {out}" + (f"; open {out / _PAGE} in a browser" if page else ""))


def _may_write(page: bool) -> list[str]:
    """Names of all files that a report may have."""
    pictures = [f"{name}.{suffix}" for name in (_OF_PAGE if page else _OF_CHECK) for suffix in ("png", "svg")]
    return [*_TEXTS, *pictures, *([_PAGE] if page else [])]


def _timed() -> Callable[[str], None]:
    """Progress with the seconds since now before it."""
    started = time.perf_counter()
    return lambda message: progress(f"{time.perf_counter() - started:5.1f} s  {message}")


def _writer(content: bytes) -> Callable[[Path], None]:
    return lambda path: _write(path, content)


def _write(path: Path, content: bytes) -> None:
    path.write_bytes(content)


def _named(pictures: Mapping[str, Mapping[str, bytes]]) -> dict[str, bytes]:
    """Pictures by file name."""
    return {f"{name}.{suffix}": content for name, forms in pictures.items() for suffix, content in forms.items()}


Made = tuple[dict[str, bytes], dict[str, Any], Callable[[], str]]
"""Pictures and page by file name, the content of report.json, and what writes the text at the width of the moment."""


def _without_page(check: DesignCheck, told: Callable[[str], None]) -> Made:
    """The check alone: no designs, no runs, no recommendation."""
    from railslip_ctrl.plots.design_report import check_drawings
    from railslip_ctrl.plots.style import figure_files

    told("pictures")
    files = _named({name: figure_files(make()) for name, make in check_drawings(check).items()})
    return files, design_check_json(check, [*_TEXTS, *files]), partial(design_check_text, check)


def _with_page(
    check: DesignCheck,
    points: Sequence[OperatingPoint],
    gains: PIGains | None,
    source: Provenance,
    told: Callable[[str], None],
    fresh: bool,
) -> Made:
    """The whole report.

    What can be drawn is drawn while the rest is computed, each picture once.
    """
    from railslip_ctrl.plots.design_report import linear_drawings, run_drawings
    from railslip_ctrl.plots.side_by_side import drawing_room

    with drawing_room(helped=cores() > 1, fresh=fresh) as room:

        def draw(part: LinearPart | RunPart) -> list[Callable[[], None]]:
            drawings = linear_drawings(part) if isinstance(part, LinearPart) else run_drawings(part)
            left = room.take(drawings)
            again = [name for name in drawings if name in room.from_cache]
            told(f"pictures: {', '.join(drawings)}" + (f" (from the cache: {len(again)})" if again else ""))
            return left

        report = design_report(check, points, given=gains, fresh=fresh, progress=told, meanwhile=draw)
        pictures = room.files()
    told(_PAGE)
    html = design_report_html(report, {name: forms["svg"] for name, forms in pictures.items()}, source)
    files = _named(pictures) | {_PAGE: html.encode()}
    content = design_report_json(report, html, source, [*_TEXTS, *files])
    return files, content, partial(design_check_text, report.whole_check, verdict(report))


def provenance(ctx: click.Context) -> Provenance:
    """The command line as it could be typed again, and every option with its value."""
    words, options = [ctx.command_path], []
    for option in ctx.command.params:
        given = ctx.get_parameter_source(option.name or "") is ParameterSource.COMMANDLINE
        value = ctx.params.get(option.name or "")
        values = list(value) if isinstance(value, tuple) else [value]
        shown = ", ".join(str(one) for one in values if one is not None) or "left out"
        options.append((option.opts[0], shown if given else f"{shown} (default)"))
        if given and isinstance(option, click.Option):
            words += [option.opts[0]] if value is True else [option.secondary_opts[0]] if value is False else []
            words += [] if isinstance(value, bool) else [f"{option.opts[0]} {shlex.quote(str(one))}" for one in values]
    return Provenance(" ".join(words), tuple(options))
