"""Derivation of a sliding-mode law, and errata of [Park2008], as text, Markdown, LaTeX and JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import sympy as sp
from rich.console import RenderableType
from rich.padding import Padding
from rich.text import Text

from railslip_ctrl import __version__
from railslip_ctrl.controllers.c_code import law_program
from railslip_ctrl.core.notation import SOURCES
from railslip_ctrl.core.templates import environment
from railslip_ctrl.model import plant
from railslip_ctrl.paper.errata import Erratum
from railslip_ctrl.sliding.code import LawCode, LawNumbers
from railslip_ctrl.sliding.derivation import Derivation
from railslip_ctrl.sliding.predictive import PredictiveDerivation
from railslip_ctrl.sliding.proof import latex, plain, sliding_symbol

from .document import Facts, Paragraph, heading, render
from .export import exported

_TITLE = "The adaptive sliding-mode law, derived from the plant"
_PREDICTIVE_TITLE = "The predictive sliding-mode law, derived from the plant"
_STEP = ("name", "statement", "done", "equation_latex", "source", "checked", "check")
_ERRATUM = (
    *("where", "printed_latex", "derived_latex", "difference_latex"),
    *("agrees", "how", "sign_and_size", "explanation"),
)
_NO_FORMULA = "The adhesion law has no closed form: Ta is evaluated from these numbers outside the control law."


def derivation_json(
    derivation: Derivation | PredictiveDerivation,
    errata: Sequence[Erratum] = (),
    code: LawCode | None = None,
    numbers: Sequence[LawNumbers] = (),
) -> dict[str, Any]:
    """Return a derivation as JSON, with errata, code and numeric parameters of the law if given."""
    formulas = [None if rows.torque is None else f"T_b = {latex(rows.torque)}" for rows in numbers]
    of_rails = {
        rows.rail.value: {"parameters": dict(rows.parameters), "latex": formula}
        for rows, formula in zip(numbers, formulas, strict=True)
    }
    torque, law = _law(derivation)
    return {
        **exported(
            derivation, *(("reference", "adhesion") if isinstance(derivation, Derivation) else ()), "all_checked"
        ),
        "steps": [exported(step, *_STEP) for step in derivation.steps],
        "law": {
            "latex": f"{latex(torque)} = {latex(law)}",
            **({} if code is None else {"python": code.python, "c": law_program(code).in_one_file}),
            **({"numbers": of_rails} if numbers else {}),
        },
        "errata": [exported(row, *_ERRATUM) for row in errata],
    }


def _law(derivation: Derivation | PredictiveDerivation) -> tuple[sp.Symbol, sp.Expr]:
    if isinstance(derivation, Derivation):
        return plant.Tb, derivation.law_in_adhesion
    return sliding_symbol("u"), derivation.control_law


def _title(derivation: Derivation | PredictiveDerivation) -> str:
    return _TITLE if isinstance(derivation, Derivation) else _PREDICTIVE_TITLE


def _numeric_title(numbers: LawNumbers) -> str:
    return f"Law with the numbers given, {numbers.rail.value} rail"


def _parameters(numbers: LawNumbers) -> str:
    return ", ".join(f"{name} = {value:.10g}" for name, value in numbers.parameters) + " (SI)"


def _case(derivation: Derivation | PredictiveDerivation) -> str:
    if not isinstance(derivation, Derivation):
        return "proportional reference, holding torque estimated"
    torque = (
        "Ta measured or estimated" if derivation.adhesion is None else f"Ta of the adhesion law {derivation.adhesion}"
    )
    return f"{derivation.reference} reference, {torque}"


def _outcome(derivation: Derivation | PredictiveDerivation) -> str:
    failed = [step.name for step in derivation.steps if not step.checked]
    if failed:
        return f"{len(failed)} of {len(derivation.steps)} steps FAIL their check: {', '.join(failed)}"
    return f"all {len(derivation.steps)} steps pass their machine check"


def _verdict(row: Erratum) -> str:
    return "agrees" if row.agrees else "does not agree"


def _mark(checked: bool) -> str:
    return "checked" if checked else "CHECK FAILS"


def derivation_text(
    derivation: Derivation | PredictiveDerivation, errata: Sequence[Erratum] = (), numbers: Sequence[LawNumbers] = ()
) -> str:
    """Return a derivation as plain text, with errata and numeric parameters of the law if given."""
    parts: list[RenderableType] = [
        heading(_title(derivation)),
        Text(f"railslip_ctrl {__version__}; {_case(derivation)}; {_outcome(derivation)}.\n"),
    ]
    for number, step in enumerate(derivation.steps, 1):
        parts += [
            heading(f"{number}. {step.name}   {step.source}   {_mark(step.checked)}", "-"),
            Text(step.statement),
            Padding(Text(step.equation_text), (1, 0, 1, 4)),
            Facts([("done", step.done), ("check", step.check)]),
            Text(""),
        ]
    torque, law = _law(derivation)
    parts += [heading("Law", "-"), Padding(Text(f"{torque} = {plain(law)}"), (0, 0, 1, 4))]
    for item in numbers:
        parts += [heading(_numeric_title(item), "-"), Paragraph(_parameters(item))]
        formula = _NO_FORMULA if item.torque is None else f"Tb = {plain(item.torque)}"
        parts.append(Padding(Text(formula), (1, 0, 1, 4)))
    if errata:
        parts.append(heading("Errata: printed and derived formulas", "="))
    for row in errata:
        parts += [
            heading(f"{row.where}   {_verdict(row)} ({row.how})", "-"),
            Facts(
                [("printed", row.printed), ("derived", row.derived), ("size", row.sign_and_size), ("", row.explanation)]
            ),
            Text(""),
        ]
    parts += [Text(line) for line in _sources(derivation)]
    return render(parts)


def _sources(derivation: Derivation | PredictiveDerivation) -> list[str]:
    return [
        f"[{key}] {text}"
        for key, text in SOURCES.items()
        if any(f"[{key}]" in step.source for step in derivation.steps)
    ]


_MARKDOWN = {letter: "\\" + letter for letter in "*_|<>`"}
_LATEX = {
    **{letter: "\\" + letter for letter in "&%$#_{}"},
    **{"\\": r"\textbackslash{}", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}"},
    **{"<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}"},
}


def derivation_document(
    form: str,
    derivation: Derivation | PredictiveDerivation,
    errata: Sequence[Erratum] = (),
    code: LawCode | None = None,
    numbers: Sequence[LawNumbers] = (),
) -> str:
    """Return a derivation as a document; `form` is "markdown" (with LaTeX formulas) or "latex".

    The LaTeX document needs the packages amsmath, geometry, graphicx and listings.
    """
    template, escapes = {"markdown": ("derivation.md", _MARKDOWN), "latex": ("derivation.tex", _LATEX)}[form]
    # delimiters without braces, because LaTeX uses braces
    names = ("block_start_string", "block_end_string", "variable_start_string", "variable_end_string")
    filling = environment("railslip_ctrl.report", **dict(zip(names, ("<%", "%>", "<<", ">>"), strict=True)))
    filling.filters |= {
        "escaped": lambda text: "".join(escapes.get(letter, letter) for letter in text),
        **{"latex": latex, "mark": _mark, "verdict": _verdict, "title": _numeric_title, "parameters": _parameters},
    }
    case = _case(derivation)
    torque, law = _law(derivation)
    text: str = filling.get_template(template).render(
        steps=derivation.steps,
        law=f"{latex(torque)} = {latex(law)}",
        errata=errata,
        python="" if code is None else code.python,
        c="" if code is None else law_program(code).in_one_file,
        numbers=numbers,
        title=_title(derivation),
        opening=f"{case[0].upper()}{case[1:]}; {_outcome(derivation)}.",
        no_formula=_NO_FORMULA,
        sources=_sources(derivation),
    )
    return text
