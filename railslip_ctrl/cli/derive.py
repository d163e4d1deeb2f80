"""`railslip derive`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import get_args

import click

from railslip_ctrl.adhesion import law_class, law_name_in
from railslip_ctrl.errors import InputError
from railslip_ctrl.report.derivation import derivation_json, derivation_latex, derivation_markdown, derivation_text
from railslip_ctrl.report.files import check_directory, write_files
from railslip_ctrl.sliding.code import generate
from railslip_ctrl.sliding.derivation import derive
from railslip_ctrl.sliding.errata import errata
from railslip_ctrl.sliding.surface import Reference

from .options import from_file
from .output import progress

_FORMATS = ("text", "markdown", "latex", "c", "python")


@click.command()
@click.option(
    "--reference",
    default="proportional",
    show_default=True,
    metavar="proportional|constant",
    help="Reference slip velocity: lambda_d v, or constant.",
)
@click.option(
    "--adhesion",
    metavar="LAW|FILE.toml",
    help="Adhesion law put in for Ta, a file's with its parameters as symbols.  [default: none, Ta is an argument]",
)
@click.option("--format", "form", metavar="|".join(_FORMATS), help="What to print.  [default: text]")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object and nothing else.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Write it into a file instead; its folder is made if missing.  [default: it is printed]",
)
def command(reference: str, adhesion: str | None, form: str | None, as_json: bool, out: Path | None) -> None:
    """The sliding-mode law derived from the plant, each step checked by machine; errata; generated code.

    Example: railslip derive --adhesion bristle --format latex --out derivation.tex
    """
    if as_json and form is not None:
        raise InputError(f"--format: {form!r} beside --json is not allowed; give one of the two")
    if out is not None:
        _check_out(out)  # before the work, not after it
    text = _text(_reference(reference), adhesion, "json" if as_json else _format(form))
    if out is None:
        click.echo(text, nl=False)
        return
    made = "" if out.parent.is_dir() else f", made the folder {out.parent}"
    write_files(out.parent, {out.name: lambda path: _write(path, text)})
    progress(f"wrote {out}{made}")


def _reference(word: str) -> Reference:
    for reference in get_args(Reference):
        if word == reference:
            return reference  # type: ignore[no-any-return]
    raise InputError(f"--reference: {word!r} is not known; choose one of {', '.join(get_args(Reference))}")


def _format(form: str | None) -> str:
    if form is not None and form not in _FORMATS:
        raise InputError(f"--format: {form!r} is not known; choose one of {', '.join(_FORMATS)}")
    return form or "text"


def _check_out(out: Path) -> None:
    """InputError where the file could not be written."""
    if out.name == "" or out.is_dir():
        raise InputError(f"--out: {str(out)!r} is a folder; give the path of a file")
    check_directory(out.absolute().parent, [out.name])


def _text(reference: Reference, adhesion: str | None, form: str) -> str:
    derivation = derive(reference=reference, law=None if adhesion is None else _law_name(adhesion))
    code = generate(derivation)
    if form in ("c", "python"):
        return code.c if form == "c" else code.python
    rows = errata(derivation)
    if form == "json":
        return json.dumps(derivation_json(derivation, rows, code), indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    if form == "markdown":
        return derivation_markdown(derivation, rows, code)
    if form == "latex":
        return derivation_latex(derivation, rows, code)
    return derivation_text(derivation, rows)


def _law_name(adhesion: str) -> str:
    """The name of the law, a file's too: the derivation is symbolic, and its numbers are not used."""
    if adhesion.lower().endswith(".toml"):
        return from_file("--adhesion", Path(adhesion), law_name_in)
    return law_class(adhesion).name


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")
