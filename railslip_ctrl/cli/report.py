"""`railslip report`, the main job."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from railslip_ctrl.design_check import DesignCheck, design_check
from railslip_ctrl.report import check_directory, design_check_json, design_check_text, write_files

from .options import CaseOptions, case_options, chosen_gains, gain_options
from .output import print_json, progress

_PICTURES = ("bode", "nyquist", "nichols")


@click.command()
@case_options
@gain_options
@click.option(
    "--out",
    default="railslip-report",
    show_default=True,
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Folder for report.txt, report.json and the pictures (PNG and SVG).",
)
def command(
    cases: CaseOptions,
    as_json: bool,
    kp: float | None,
    ki: float | None,
    out: Path,
) -> None:
    """The design check: published (or given) gains in both readings of the units and a PI that holds, dry and wet.

    Example: railslip report --vehicle my_train.toml --speed 100 --speed 60 --out check
    """
    names = ["report.txt", "report.json", *(f"{name}.{suffix}" for name in _PICTURES for suffix in ("png", "svg"))]
    check_directory(out, names)  # before the work, not after it
    gains = chosen_gains(kp, ki)
    check = design_check(cases.chosen_vehicle, cases.points(), given=gains, progress=progress)
    text, content = design_check_text(check), design_check_json(check, names)
    progress("pictures")
    files = write_files(out, _writers(check, text, content))
    if as_json:
        print_json(content)
    else:
        click.echo(text, nl=False)
    progress(f"wrote {len(files)} files to {out}")


def _writers(check: DesignCheck, text: str, content: dict[str, Any]) -> dict[str, Callable[[Path], None]]:
    from railslip_ctrl.plots import bode_figure, nichols_figure, nyquist_figure, save_figure

    writers: dict[str, Callable[[Path], None]] = {
        "report.txt": lambda path: _write_text(path, text),
        "report.json": lambda path: _write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n"),
    }
    for name, draw in zip(_PICTURES, (bode_figure, nyquist_figure, nichols_figure), strict=True):
        figure = draw(check.groups)
        for suffix in ("png", "svg"):
            writers[f"{name}.{suffix}"] = lambda path, figure=figure: save_figure(figure, path)  # type: ignore[misc]
    return writers


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")
