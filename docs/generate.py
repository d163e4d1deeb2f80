"""Write the computed parts of the documentation into docs/_generated: equations, tables, API pages, gallery.

The generated files are not committed. A page shows its numbers and formulas from these files, from commands that it
runs, or in doctests.

    python docs/generate.py [--without-gallery]
"""

from __future__ import annotations

import argparse
import pkgutil
import re
import sys
from collections.abc import Iterable, Sequence
from importlib import import_module
from pathlib import Path
from types import ModuleType

import railslip_ctrl
from railslip_ctrl.controllers.files import controller_kinds
from railslip_ctrl.core.notation import NOTATION, SOURCES, Notation
from railslip_ctrl.model.adhesion import law_classes
from railslip_ctrl.paper.errata import Erratum, errata
from railslip_ctrl.sliding.derivation import Derivation, derive
from railslip_ctrl.sliding.predictive import PredictiveDerivation, derive_predictive
from railslip_ctrl.sliding.proof import PREDICTIVE_NOTATION, SLIDING_NOTATION

sys.path.insert(0, str(Path(__file__).resolve().parent))

from equations import SOURCE, Equation, groups
from gallery import write_gallery
from pages import GENERATED

_HOW = {"symbolic": "comparing the expressions", "computed": "computing the numbers", "argument": "an argument"}

HIDDEN = ("_generated", "__main__", "cli")
"""Parts of the names of modules without an API page: generated code, and the command line, which has a help page."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Write all parts; `--without-gallery` skips the scripts of the gallery, which take the longest time."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--without-gallery", action="store_true")
    given = parser.parse_args(arguments)
    derivation = derive()
    rows = errata(derivation)
    for name, equations in groups(derivation).items():
        _write(f"equations/{name}.md", equations_text(equations, rows))
    _write("equations/derivation.md", steps_text(derivation))
    _write("equations/predictive.md", steps_text(derive_predictive()))
    for step in derive_predictive().steps:
        name = step.name.replace("'", "").replace(" ", "_")
        _write(f"equations/predictive/{name}.md", f"$$\n{step.equation_latex}\n$$\n")
    _write("equations/errata.md", errata_text(rows))
    _write("equations/nomenclature.md", nomenclature_text())
    _write("equations/laws.md", laws_text())
    _write("equations/controllers.md", controllers_text())
    _write("equations/sources.md", sources_text())
    _write("equations/commands.md", commands_text())
    write_api()
    write_gallery(GENERATED / "gallery", run=not given.without_gallery)


def _write(name: str, text: str) -> None:
    path = GENERATED / name
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.is_file() or path.read_text("utf-8") != text:  # Sphinx does not read an unchanged file again
        path.write_text(text, encoding="utf-8")


# --- theory --------------------------------------------------------------------------------------------------------


def equations_text(equations: Iterable[Equation], rows: Sequence[Erratum]) -> str:
    """Return each equation as Markdown, with its source, its place in the package and its errata."""
    parts = []
    for equation in equations:
        parts += [f"(eq-{equation.number})=", "", f"### ({equation.number}) {equation.title}", ""]
        parts += [f"$$\n{line}\n$$\n" for line in equation.lines]
        home = f"; {{py:obj}}`{equation.home}`" if equation.home else ""
        parts += [f"[[{SOURCE}]](#source-{SOURCE.lower()}) ({equation.number}){home}. {equation.note}".rstrip(), ""]
        for row in equation.errata(rows):
            parts += [_erratum_line(row, rows, printed_here=equation.prints(row)), ""]
    return "\n".join(parts)


def _erratum_line(row: Erratum, rows: Sequence[Erratum], *, printed_here: bool) -> str:
    """Return one erratum of an equation as text; the printed formula only if `printed_here`."""
    where = _prose(row.where)
    link = f"[errata, {where}](#erratum-{rows.index(row) + 1})"
    if row.agrees:
        subject = "the print is correct" if printed_here else where
        return f"Checked, {subject}: {_prose(row.explanation)} See {link}."
    if printed_here:
        return f"**Erratum**: printed $\\displaystyle {row.printed_latex}$. {_prose(row.explanation)} See {link}."
    return f"**Erratum**, {where}: {_prose(row.explanation)} See {link}."


def errata_text(rows: Sequence[Erratum]) -> str:
    """Return every row of the errata with an anchor, including rows where the print is correct."""
    wrong = sum(not row.agrees for row in rows)
    parts = [f"{wrong} of the {len(rows)} formulas, tables and claims below contradict the source's own equations.", ""]
    for number, row in enumerate(rows, 1):
        word = "correct" if row.agrees else "wrong"
        parts += [f"(erratum-{number})=", "", f"### {_prose(row.where)}: {word}", ""]
        if row.agrees:
            parts += [f"$$\n{row.derived_latex}\n$$\n"]
        else:
            parts += [f"Printed:\n\n$$\n{row.printed_latex}\n$$\n", f"Derived:\n\n$$\n{row.derived_latex}\n$$\n"]
        parts += [f"Checked by {_HOW[row.how]}: {_prose(row.sign_and_size)}. {_prose(row.explanation)}", ""]
    return "\n".join(parts)


def steps_text(derivation: Derivation | PredictiveDerivation) -> str:
    """Return the steps of a derivation as Markdown, each with its equation and its check."""
    parts = []
    for number, step in enumerate(derivation.steps, 1):
        mark = "checked" if step.checked else "CHECK FAILS"
        parts += [f"### {number}. {step.name}", "", f"{_prose(step.statement)} *{_prose(step.source)}*", ""]
        parts += [
            f"$$\n{step.equation_latex}\n$$\n",
            f"{_prose(step.done)} {mark.capitalize()}: {_prose(step.check)}.",
            "",
        ]
    return "\n".join(parts)


def _prose(text: str) -> str:
    """Return plain text with the markup characters of Markdown escaped."""
    return re.sub(r"([*_|<>`\[\]$])", r"\\\1", text)


def nomenclature_text() -> str:
    """Return the tables of symbols: plant, published and predictive sliding-mode law."""
    return "\n".join(
        [
            "### Plant",
            "",
            *_symbols(NOTATION.values()),
            "",
            "### Published sliding-mode law",
            "",
            *_symbols(SLIDING_NOTATION.values()),
            "",
            "### Predictive sliding-mode law",
            "",
            *_symbols(PREDICTIVE_NOTATION.values()),
            "",
        ]
    )


def _symbols(entries: Iterable[Notation]) -> list[str]:
    head = ["| symbol | name in code | unit | meaning |", "|---|---|---|---|"]
    return head + [f"| ${e.latex}$ | `{e.name}` | {_unit(e.unit)} | {_prose(e.meaning)} |" for e in entries]


def _unit(unit: str) -> str:
    return "-" if unit == "1" else _prose(unit)


def laws_text() -> str:
    """Return the adhesion laws with their parameters."""
    parts = []
    for name, law in law_classes().items():
        parts += [
            f"## `{name}`: {law.title}",
            "",
            f"Source: {_prose(law.source)}.",
            "",
            "| key | unit | meaning |",
            "|---|---|---|",
        ]
        for key in law.parameter_names():
            info = law.model_fields[key]
            extra = info.json_schema_extra
            unit = str(extra["unit"]) if isinstance(extra, dict) and "unit" in extra else ""
            parts.append(f"| `{key}` | {_unit(unit)} | {_prose(info.description or 'see the class')} |")
        parts.append("")
    return "\n".join(parts)


def controllers_text() -> str:
    """Return the controller kinds with their parameters."""
    parts = []
    for name, kind in controller_kinds().items():
        parts += [
            f"## `{name}`: {kind.title}",
            "",
            f"Source: {_prose(kind.source)}.",
            "",
            "| key | unit | meaning |",
            "|---|---|---|",
        ]
        for key, info in kind.model_fields.items():
            if key not in ("name", "reference"):
                meaning = _prose(info.description or "see the class")
                parts.append(f"| `{key}` | {_unit(kind.units().get(key, ''))} | {meaning} |")
        parts.append("")
    return "\n".join(parts)


def sources_text() -> str:
    """Return the sources sorted by key, each with an anchor."""
    parts = []
    for key, text in sorted(SOURCES.items()):
        linked = re.sub(r"doi:(\S+)", r"doi:[\1](https://doi.org/\1)", text)
        parts += [f"(source-{key.lower()})=", "", f"**[{key}]** {linked}", ""]
    return "\n".join(parts)


# --- reference -----------------------------------------------------------------------------------------------------


def commands_text() -> str:
    """Return the help text of every command."""
    import click

    from railslip_ctrl.cli.program import railslip
    from railslip_ctrl.cli.settings import HELP

    shown = HELP | {"max_content_width": 100, "terminal_width": 100}
    parts = []
    group = click.Context(railslip, info_name="railslip", **shown)
    parts += ["```text", railslip.get_help(group), "```", ""]
    for name in railslip.list_commands(group):
        command = railslip.get_command(group, name)
        assert command is not None, "a listed command exists"
        context = click.Context(command, info_name=name, parent=group, **shown)
        parts += [f"## railslip {name}", "", "```text", command.get_help(context), "```", ""]
    return "\n".join(parts)


def packages() -> dict[str, list[str]]:
    """Return the names of all documented modules, grouped by package or top-level module and sorted by name."""
    found: dict[str, list[str]] = {"railslip_ctrl": ["railslip_ctrl"]}
    for info in pkgutil.walk_packages(railslip_ctrl.__path__, "railslip_ctrl."):
        parts = info.name.split(".")
        if not set(parts) & set(HIDDEN):
            found.setdefault(".".join(parts[:2]), []).append(info.name)
    return found


def write_api() -> None:
    """Write one page for each package, with the docstrings of its modules."""
    for package, modules in packages().items():
        lines = [package, "=" * len(package), ""]
        for module in modules:
            if module != package:
                lines += [module, "-" * len(module), ""]
            lines += [f".. automodule:: {module}", *_offered(import_module(module)), ""]
        _write(f"api/{package}.rst", "\n".join(lines))
    keep = {f"{package}.rst" for package in packages()}
    for path in (GENERATED / "api").glob("*.rst"):
        if path.name not in keep:
            path.unlink()


def _offered(module: ModuleType) -> list[str]:
    """Return, for a package, the lines that link its exported names to their definitions; none for another module."""
    if not hasattr(module, "__path__"):
        return []
    lines = ["   :no-members:", ""]
    names = [name for name in getattr(module, "__all__", ()) if hasattr(getattr(module, name), "__module__")]
    homes = {name: f"{getattr(module, name).__module__}.{name}" for name in names}
    return lines + ["Exports " + ", ".join(f":py:obj:`~{home}`" for home in homes.values()) + "."] * bool(homes)


if __name__ == "__main__":
    main()
