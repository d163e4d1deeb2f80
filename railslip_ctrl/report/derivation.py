"""The derivation and the errata as text, Markdown, LaTeX and JSON; computes nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.console import RenderableType
from rich.padding import Padding
from rich.text import Text

from railslip_ctrl import __version__
from railslip_ctrl.core.sources import SOURCES
from railslip_ctrl.paper.errata import Erratum
from railslip_ctrl.sliding.code import LawCode, LawNumbers
from railslip_ctrl.sliding.derivation import Derivation
from railslip_ctrl.sliding.proof import latex, plain

from .document import facts, heading, indented, render
from .export import exported

_TITLE = "The adaptive sliding-mode law, derived from the plant"
_STEP = ("name", "statement", "done", "equation_latex", "source", "checked", "check")
_ERRATUM = (
    *("where", "printed_latex", "derived_latex", "difference_latex"),
    *("agrees", "how", "sign_and_size", "explanation"),
)
_NO_FORMULA = "The law has no closed form: Ta is evaluated from these numbers outside the control law."


def derivation_json(
    derivation: Derivation, errata: Sequence[Erratum], code: LawCode, numbers: Sequence[LawNumbers] = ()
) -> dict[str, Any]:
    """The contract's keys, and beside them what was done, how each step was checked, and a law's `numbers` by rail."""
    return {
        "reference": derivation.reference,
        "adhesion": derivation.adhesion,
        "all_checked": derivation.all_checked,
        "steps": [exported(step, *_STEP) for step in derivation.steps],
        "law": {
            "latex": f"T_b = {latex(derivation.law_in_adhesion)}",
            "python": code.python,
            "c": code.c,
            **({"numbers": {one.rail.value: _numbers_json(one) for one in numbers}} if numbers else {}),
        },
        "errata": [exported(row, *_ERRATUM) for row in errata],
    }


def _numbers_json(numbers: LawNumbers) -> dict[str, Any]:
    return {"parameters": dict(numbers.parameters), "latex": _numeric_latex(numbers)}


def _numeric_latex(numbers: LawNumbers) -> str | None:
    return None if numbers.torque is None else f"T_b = {latex(numbers.torque)}"


def _numeric_title(numbers: LawNumbers) -> str:
    return f"Law with the numbers given, {numbers.rail.value} rail"


def _parameters(numbers: LawNumbers) -> str:
    return ", ".join(f"{name} = {value:.10g}" for name, value in numbers.parameters) + " (SI)"


def _case(derivation: Derivation) -> str:
    torque = (
        "Ta measured or estimated" if derivation.adhesion is None else f"Ta of the adhesion law {derivation.adhesion}"
    )
    return f"{derivation.reference} reference, {torque}"


def _opening(derivation: Derivation) -> str:
    """The first sentence of a document."""
    case = _case(derivation)
    return f"{case[0].upper()}{case[1:]}; {_outcome(derivation)}."


def _outcome(derivation: Derivation) -> str:
    failed = [step.name for step in derivation.steps if not step.checked]
    if failed:
        return f"{len(failed)} of {len(derivation.steps)} steps FAIL their check: {', '.join(failed)}"
    return f"all {len(derivation.steps)} steps hold their machine check"


def _verdict(row: Erratum) -> str:
    return "agrees" if row.agrees else "does not agree"


def _mark(checked: bool) -> str:
    return "checked" if checked else "CHECK FAILS"


# --- text ----------------------------------------------------------------------------------------------------------


def derivation_text(derivation: Derivation, errata: Sequence[Erratum], numbers: Sequence[LawNumbers] = ()) -> str:
    """Plain text."""
    parts: list[RenderableType] = [
        heading(_TITLE),
        Text(f"railslip_ctrl {__version__}; {_case(derivation)}; {_outcome(derivation)}.\n"),
    ]
    for number, step in enumerate(derivation.steps, 1):
        parts += [
            heading(f"{number}. {step.name}   {step.source}   {_mark(step.checked)}", "-"),
            Text(step.statement),
            Padding(Text(step.equation_text), (1, 0, 1, 4)),
            facts([("done", step.done), ("check", step.check)]),
            Text(""),
        ]
    parts += [
        heading("Law", "-"),
        Padding(Text(f"Tb = {plain(derivation.law_in_adhesion)}"), (0, 0, 1, 4)),
    ]
    for one in numbers:
        parts += [heading(_numeric_title(one), "-"), indented(_parameters(one))]
        parts.append(Padding(Text(_numeric_text(one)), (1, 0, 1, 4)))
    parts.append(heading("Errata: as printed, and as derived", "="))
    for row in errata:
        parts += [
            heading(f"{row.where}   {_verdict(row)} ({row.how})", "-"),
            facts(
                [
                    ("printed", row.printed),
                    ("derived", row.derived),
                    ("size", row.sign_and_size),
                    ("", row.explanation),
                ]
            ),
            Text(""),
        ]
    parts.append(Text(_sources_line()))
    return render(parts)


def _numeric_text(numbers: LawNumbers) -> str:
    return _NO_FORMULA if numbers.torque is None else f"Tb = {plain(numbers.torque)}"


def _sources_line() -> str:
    return f"[Park2008] {SOURCES['Park2008']}"


# --- Markdown ------------------------------------------------------------------------------------------------------


def derivation_markdown(
    derivation: Derivation, errata: Sequence[Erratum], code: LawCode, numbers: Sequence[LawNumbers] = ()
) -> str:
    """Markdown with LaTeX formulas."""
    lines = [f"# {_TITLE}", "", _opening(derivation), ""]
    for number, step in enumerate(derivation.steps, 1):
        lines += [
            f"## {number}. {step.name}",
            "",
            f"{_markdown(step.statement)} *{step.source}*",
            "",
            f"$$ {step.equation_latex} $$",
            "",
            f"- done: {_markdown(step.done)}",
            f"- {_mark(step.checked)}: {_markdown(step.check)}",
            "",
        ]
    lines += ["## Law", "", f"$$ T_b = {latex(derivation.law_in_adhesion)} $$", ""]
    for one in numbers:
        formula = _NO_FORMULA if one.torque is None else f"$$ {_numeric_latex(one)} $$"
        lines += [f"### {_numeric_title(one)}", "", _markdown(_parameters(one)), "", formula, ""]
    lines += ["## Errata", ""]
    for row in errata:
        lines += [
            f"### {row.where}: {_verdict(row)}",
            "",
            f"$$ \\text{{printed: }} {row.printed_latex} $$",
            "",
            f"$$ \\text{{derived: }} {row.derived_latex} $$",
            "",
            _markdown(f"{row.sign_and_size}. {row.explanation}"),
            "",
        ]
    lines += ["## Code", "", "```python", code.python.rstrip(), "```", "", "```c", code.c.rstrip(), "```", ""]
    return "\n".join([*lines, _sources_line(), ""])


def _markdown(text: str) -> str:
    return "".join("\\" + letter if letter in "*_|<>`" else letter for letter in text)


# --- LaTeX ---------------------------------------------------------------------------------------------------------

_PREAMBLE = r"""\documentclass[a4paper]{article}
\usepackage[T1]{fontenc}
\usepackage[utf8]{inputenc}
\usepackage{amsmath}
\usepackage{graphicx}
\usepackage{listings}
\usepackage[margin=25mm]{geometry}
\newcommand{\formula}[1]{\begin{center}\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}%
{$\displaystyle #1$}\end{center}}
\renewcommand{\arraystretch}{1.8} % fractions in matrices keep apart
\lstset{basicstyle=\ttfamily\scriptsize, columns=fullflexible, keepspaces=true, breaklines=true,
  postbreak={\mbox{$\hookrightarrow$\space}}}
\setlength{\emergencystretch}{3em}
\begin{document}
"""

_ESCAPES = {
    **{letter: "\\" + letter for letter in "&%$#_{}"},
    "\\": r"\textbackslash{}",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
}


def derivation_latex(
    derivation: Derivation, errata: Sequence[Erratum], code: LawCode, numbers: Sequence[LawNumbers] = ()
) -> str:
    """A LaTeX document that needs amsmath, geometry, graphicx and listings; too wide a formula is made to fit."""
    lines = [
        _PREAMBLE + rf"\section*{{{_escape(_TITLE)}}}",
        _escape(_opening(derivation)),
        r"\section{Steps}",
    ]
    for step in derivation.steps:
        lines += [
            rf"\subsection{{{_escape(step.name)}}}",
            _escape(f"{step.statement} ({step.source})"),
            rf"\formula{{{step.equation_latex}}}",
            _escape(f"Done: {step.done} {_mark(step.checked).capitalize()}: {step.check}."),
        ]
    lines += [r"\section{Law}", rf"\formula{{T_b = {latex(derivation.law_in_adhesion)}}}"]
    for one in numbers:
        formula = _NO_FORMULA if one.torque is None else rf"\formula{{{_numeric_latex(one)}}}"
        lines += [rf"\subsection*{{{_escape(_numeric_title(one))}}}", _escape(_parameters(one)), formula]
    lines.append(r"\section{Errata}")
    for row in errata:
        lines += [
            rf"\subsection*{{{_escape(f'{row.where}: {_verdict(row)}')}}}",
            rf"\formula{{\text{{printed: }} {row.printed_latex}}}",
            rf"\formula{{\text{{derived: }} {row.derived_latex}}}",
            _escape(f"{row.sign_and_size}. {row.explanation}"),
        ]
    lines += [r"\section{Code}", *_listing("Python", code.python), *_listing("C99", code.c)]
    return "\n".join([*lines, _escape(_sources_line()), r"\end{document}", ""])


def _listing(title: str, text: str) -> list[str]:
    return [rf"\subsection*{{{title}}}", r"\begin{lstlisting}", text.rstrip(), r"\end{lstlisting}"]


def _escape(text: str) -> str:
    return "".join(_ESCAPES.get(letter, letter) for letter in text)
