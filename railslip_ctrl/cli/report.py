"""`railslip report`, the main job."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from railslip_ctrl.design_check import DesignCheck, design_check
from railslip_ctrl.design_report import LinearPart, design_report
from railslip_ctrl.linearization import OperatingPoint
from railslip_ctrl.parameters import PIGains
from railslip_ctrl.report import check_directory, design_check_json, design_check_text, write_files
from railslip_ctrl.report.html import Provenance, design_report_html

from .options import CaseOptions, case_options, chosen_gains, gain_options
from .output import print_json, progress

_PICTURES = ("bode", "nyquist", "nichols")
_SUFFIXES = ("png", "svg")
_PAGE = "report.html"


@click.command()
@case_options
@gain_options
@click.option(
    "--out",
    default="railslip-report",
    show_default=True,
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Folder for report.html, report.txt, report.json and the pictures (PNG and SVG).",
)
@click.option(
    "--html/--no-html",
    "page",
    default=True,
    show_default=True,
    help="Write report.html too: designs, sliding-mode verdict, braking runs, the paper's numbers. It takes most of "
    "the time.",
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
) -> None:
    """The design check: published (or given) gains in both readings of the units and a PI that holds, dry and wet.
    report.html has that and all else a design review looks at, in one file that needs no network and prints on A4.

    Example: railslip report --vehicle my_train.toml --speed 100 --speed 60 --out check
    """
    names = ["report.txt", "report.json", *(f"{name}.{suffix}" for name in _PICTURES for suffix in _SUFFIXES)]
    names += [_PAGE] if page else []
    check_directory(out, names)  # before the work, not after it
    gains = chosen_gains(kp, ki)
    points = cases.points()
    check = design_check(cases.chosen_vehicle, points, given=gains, progress=progress)
    text, content = design_check_text(check), design_check_json(check, names)
    writers: dict[str, Callable[[Path], None]] = {}
    if page:
        pictures, html = _page(check, points, gains, provenance(ctx))
        writers[_PAGE] = lambda path: _write_text(path, html)
    else:
        pictures = _pictures(check)
    writers |= _writers(text, content, pictures)
    files = write_files(out, {name: writers[name] for name in names})
    if as_json:
        print_json(content)
    else:
        click.echo(text, nl=False)
    progress(f"wrote {len(files)} files to {out}" + (f"; open {out / _PAGE} in a browser" if page else ""))


def _writers(text: str, content: dict[str, Any], pictures: dict[str, bytes]) -> dict[str, Callable[[Path], None]]:
    writers: dict[str, Callable[[Path], None]] = {
        "report.txt": lambda path: _write_text(path, text),
        "report.json": lambda path: _write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n"),
    }
    for name, picture in pictures.items():
        writers[name] = lambda path, picture=picture: path.write_bytes(picture)  # type: ignore[misc]
    return writers


def _pictures(check: DesignCheck) -> dict[str, bytes]:
    """The pictures of the check by file name."""
    from railslip_ctrl.plots import bode_figure, nichols_figure, nyquist_figure
    from railslip_ctrl.plots.style import figure_bytes

    progress("pictures")
    figures = dict(
        zip(_PICTURES, (draw(check.groups) for draw in (bode_figure, nyquist_figure, nichols_figure)), strict=True)
    )
    return {f"{name}.{suffix}": figure_bytes(figures[name], suffix) for name in _PICTURES for suffix in _SUFFIXES}


def _page(
    check: DesignCheck, points: Sequence[OperatingPoint], gains: PIGains | None, source: Provenance
) -> tuple[dict[str, bytes], str]:
    """The pictures of the check, and report.html; what can be drawn is drawn while the rest is computed."""
    from railslip_ctrl.plots.design_report import linear_figures, run_figures
    from railslip_ctrl.plots.style import figure_bytes

    drawn: dict[str, bytes] = {}
    embedded: dict[str, bytes] = {}

    def draw(part: LinearPart) -> None:
        drawn.update(_pictures(check))
        embedded.update({name: figure_bytes(figure, "svg") for name, figure in linear_figures(part).items()})

    report = design_report(check, points, given=gains, progress=progress, meanwhile=draw)
    progress("report.html")
    embedded |= {name: figure_bytes(figure, "svg") for name, figure in run_figures(report).items()}
    return drawn, design_report_html(report, embedded, source)


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


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")
