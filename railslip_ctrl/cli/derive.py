"""The command `railslip derive`."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, get_args

import click

from railslip_ctrl.controllers.c_code import CProgram, c_program, law_program
from railslip_ctrl.controllers.predictive import Predictive
from railslip_ctrl.controllers.python_code import python_text
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.model.adhesion import AdhesionLaw, law_class, law_names
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH, PARK2008
from railslip_ctrl.paper.errata import errata
from railslip_ctrl.report.derivation import derivation_document, derivation_json, derivation_text
from railslip_ctrl.report.export import check_directory, json_text, write_files
from railslip_ctrl.sliding.code import LawCode, LawNumbers, generate, law_numbers, with_numbers
from railslip_ctrl.sliding.derivation import Derivation, Reference, derive
from railslip_ctrl.sliding.predictive import derive_predictive

from .options import law_from_file, number_option
from .output import print_text, progress
from .settings import HELP, json_option, option, path_option, preset

_FORMATS = ("text", "markdown", "latex", "c", "python")
_LAWS = ("published", "predictive")


@click.command(context_settings=HELP)
@preset(
    "--law",
    "|".join(_LAWS),
    "published: adaptive law of [Park2008]; predictive: law for a brake with dead time and lag.",
    "published",
)
@preset("--reference", "proportional|constant", "Reference slip velocity: lambda_d v, or constant.", "proportional")
@option(
    "--adhesion",
    "LAW|FILE.toml",
    f"Adhesion law that gives the adhesion torque Ta: {', '.join(law_names())}; or a file, whose numbers are inserted.",
    "none; Ta stays an argument of the law",
)
@number_option(
    "--initial-speed",
    "km/h",
    "Speed v0 at which the brake was applied, km/h; only for a file whose parameters depend on it.",
    f"{INITIAL_SPEED_KMH:g}",
    gt=0,
)
@option("--format", "|".join(_FORMATS), "What to print.", "text", to="form")
@json_option
@path_option(
    "--out",
    "FILE",
    "Write to FILE (C: also its header) instead of printing; a missing folder is created.",
    "standard output",
)
def command(
    law: str,
    reference: str,
    adhesion: str | None,
    initial_speed: float | None,
    form: str | None,
    as_json: bool,
    out: Path | None,
) -> None:
    """Derive the sliding-mode law from the plant and check each step by machine.

    For the published law, the command also prints the errata of the paper. The law is printed with symbols and, if
    --adhesion is a file, also with the numbers of this file. --format c or python prints only the generated code. Exit
    status 0, or 2 for bad input.

    Example: railslip derive --adhesion bristle --format latex --out derivation.tex
    """
    if as_json and form is not None:
        raise InputError(f"--format: {form!r} has no effect with --json; give only one of the two")
    chosen_form = "json" if as_json else _choice("--format", form or "text", _FORMATS)
    if out is not None:
        _check_out(out, chosen_form)  # before the computation starts
    reference_kind: Reference = _choice("--reference", reference, get_args(Reference))
    if _choice("--law", law, _LAWS) == "predictive":
        _check_predictive(reference_kind, adhesion, initial_speed, chosen_form)
        make_text, statement = partial(_predictive_text, chosen_form), None
    else:
        statement = reference_kind, *_law(adhesion, initial_speed)
        make_text = partial(_text, *statement, chosen_form)
    if out is None:
        print_text(make_text)
        return
    if chosen_form == "c":
        program = law_program(_derived(*statement)[1], name=out.stem) if statement else _predictive_program(out.stem)
        texts = {out.name: program.source, out.with_suffix(".h").name: program.header}
    else:
        texts = {out.name: make_text()}
    created = "" if out.parent.is_dir() else f", created the folder {out.parent}"
    write_files(out.parent, texts)
    progress(f"wrote {' and '.join(str(out.with_name(name)) for name in texts)}{created}")


def _choice(option: str, value: str, allowed: Sequence[str]) -> Any:
    if value not in allowed:
        raise InputError(f"{option}: {value!r} is not known; choose one of {', '.join(allowed)}")
    return value


def _check_out(out: Path, form: str) -> None:
    if out.name == "" or out.is_dir():
        raise InputError(f"--out: {str(out)!r} is a folder; give the path of a file")
    if form == "c" and out.suffix != ".c":
        raise InputError(f"--out: {str(out)!r} does not end in .c; give the path of the C source file")
    check_directory(out.absolute().parent, [out.name])


def _derived(
    reference: Reference, adhesion: str | None, law: AdhesionLaw | None, file: Path | None
) -> tuple[Derivation, LawCode, tuple[LawNumbers, ...]]:
    derivation = derive(reference=reference, law=adhesion)
    numbers = () if law is None else law_numbers(derivation, law)
    code = generate(derivation)
    return derivation, code if file is None else with_numbers(code, numbers, file), numbers


def _text(reference: Reference, adhesion: str | None, law: AdhesionLaw | None, file: Path | None, form: str) -> str:
    derivation, code, numbers = _derived(reference, adhesion, law, file)
    if form in ("c", "python"):
        return law_program(code).in_one_file if form == "c" else code.python
    rows = errata(derivation)
    if form == "json":
        return json_text(derivation_json(derivation, rows, code, numbers), ensure_ascii=False)
    if form == "text":
        return derivation_text(derivation, rows, numbers)
    return derivation_document(form, derivation, rows, code, numbers)


def _check_predictive(reference: str, adhesion: str | None, initial_speed: float | None, form: str) -> None:
    if reference != "proportional":
        raise InputError(
            f"--reference: {reference!r} is only for --law published, because the predictive law tracks a slip ratio; "
            "leave --reference out"
        )
    if adhesion is not None or initial_speed is not None:
        name = "--initial-speed" if adhesion is None else "--adhesion"
        raise InputError(
            f"{name} is only for --law published, because the predictive law estimates the holding torque without an "
            f"adhesion law; leave {name} out"
        )


def _predictive_program(name: str) -> CProgram:
    return c_program(Predictive.for_vehicle(PARK2008), PARK2008, name=name)


def _predictive_text(form: str) -> str:
    if form == "c":
        return _predictive_program(Predictive.kind).in_one_file
    if form == "python":
        return python_text(Predictive.for_vehicle(PARK2008))
    derivation = derive_predictive()
    if form == "json":
        return json_text(derivation_json(derivation), ensure_ascii=False)
    return derivation_text(derivation) if form == "text" else derivation_document(form, derivation)


def _law(adhesion: str | None, initial_speed: float | None) -> tuple[str | None, AdhesionLaw | None, Path | None]:
    if adhesion is not None and adhesion.lower().endswith(".toml"):
        v0 = INITIAL_SPEED_KMH if initial_speed is None else initial_speed
        file = Path(adhesion)
        law = law_from_file(file, v0, None, assumed=initial_speed is None)
        return law.name, law, file
    if initial_speed is not None:
        raise InputError(
            "--initial-speed is only for an --adhesion file whose numbers depend on the initial speed; leave "
            "--initial-speed out"
        )
    if adhesion is not None and adhesion.lower().endswith(".py"):
        raise InputError(f"--adhesion: {adhesion}: derive cannot use a Python file; give a law by name, or FILE.toml")
    return None if adhesion is None else law_class(adhesion).name, None, None
