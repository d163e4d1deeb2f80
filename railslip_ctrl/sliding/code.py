"""The sampled law as a program in Python and in C99, with an adhesion law's own numbers where a file gives them.

The programs are in `templates/`: plain functions of floats that Numba can compile, and C without allocation, recursion
or loop, so that the time of a step is bounded. What is filled in follows from the law.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import sympy as sp
from sympy.printing.c import C99CodePrinter
from sympy.printing.precedence import PRECEDENCE
from sympy.printing.pycode import PythonCodePrinter

from railslip_ctrl import __version__
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.templates import environment
from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.model.vehicle import Rail

from .derivation import Derivation
from .law import HOLD_TIME, KEPT, file_hash, sources_hash
from .sampled_law import EXPLAINED, LARGEST, LIMITED, OPTIONS, PREFIX, Assignment, SampledLaw, sampled_law

WIDTH = 99  #: largest length of a line of generated code

NOT_HOLDING = (
    *("V' <= 0, disturbed", "invariant-set theorem", "theta_hat converges", "scalar gain k"),
    *("reaching condition (40)", "s s' < -eta |s| over the box", "sliding reached and kept", "boundary layer with K"),
    *("theta constant", "theta_hat bounded under noise", "sliding exists behind the actuator"),
    *("the law behind the actuator spares the wheel", "the adaptive loop is stable behind the actuator"),
)
"""Conditions that `joint_verification` finds not to hold for the published law; deciding them takes half a minute."""

_HELPERS = ("reciprocal", "exponential", "limited")
"""Functions of the templates: x^-1 and exp where an argument may be anything, and a number held to limits."""


@dataclass(frozen=True)
class LawCode:
    """Source texts of the law, and what they name."""

    law: SampledLaw
    python: str
    c: str


@cache
def generate(derivation: Derivation) -> LawCode:
    """The law of a derivation as Python and C99 source."""
    return _printed(sampled_law(derivation))


@cache
def python_law(derivation: Derivation) -> ModuleType:
    """The generated Python, ready to call: `Parameters`, `State`, `init`, `control`, `valid`, `step`.

    `control` is the continuous law: a pure function of what is measured, the estimates and the parameters, to
    (torque, s, theta1_hat_rate, theta2_hat_rate). `step(state, v, omega[, Ta], p)` gives (torque, s, new state).
    """
    module = ModuleType("railslip_asmc")
    exec(compile(generate(derivation).python, "<generated sliding-mode law>", "exec"), module.__dict__)
    return module


def _printed(law: SampledLaw) -> LawCode:
    return LawCode(law, _source(law, _PYTHON), _source(law, _C))


# --- formulas in a language -------------------------------------------------------------------------------------------


class _ProductPowers:
    """Printer part: powers up to 4 as products, which overflow to infinity where Python's ** raises."""

    def _print_Pow(self, expression: sp.Expr, **options: object) -> str:
        base, exponent = expression.as_base_exp()
        if exponent.is_Integer and 1 < exponent <= 4:
            factor = self.parenthesize(base, PRECEDENCE["Pow"])  # type: ignore[attr-defined]
            return "(" + "*".join([factor] * int(exponent)) + ")"
        return str(super()._print_Pow(expression, **options))  # type: ignore[misc]


class _PythonPrinter(_ProductPowers, PythonCodePrinter):  # type: ignore[misc]
    """sgn 0 is 0 here and in C; SymPy prints copysign, for which it is 1."""

    def _print_sign(self, expression: sp.Expr) -> str:
        argument = self._print(expression.args[0])
        return f"(({argument} > 0.0) - ({argument} < 0.0))"


class _CPrinter(_ProductPowers, C99CodePrinter):  # type: ignore[misc]
    """C99 has no M_PI."""

    def _print_Pi(self, expression: sp.Expr) -> str:
        return "3.14159265358979324"


@dataclass(frozen=True)
class _Language:
    """How a program is written: its template; what stands before its functions; patterns; a field; a statement.

    A statement is of a name, an expression's text, and what declares the name in C.
    """

    template: str
    prefix: str
    comment: str
    parameter: str
    conjunction: str
    finite: str
    printer: PythonCodePrinter | C99CodePrinter
    field: Callable[[str], str]
    assigned: Callable[[str, str, str], list[str]]


def _assigned_in_python(name: str, text: str, kind: str) -> list[str]:
    line = f"    {name} = {text}"
    return [line] if len(line) <= WIDTH else [f"    {name} = (", *_short(f"        {text}"), "    )"]


_PYTHON = _Language(
    template="law.py.jinja",
    prefix="",
    comment="# {}",
    parameter="p.{}",
    conjunction=" and ",
    finite="math.isfinite({})",
    printer=_PythonPrinter({"fully_qualified_modules": True, "user_functions": {name: name for name in _HELPERS}}),
    field=lambda name: f"    {name}: float{' = 0.0' if name in OPTIONS else ''} ",
    assigned=_assigned_in_python,
)
_C = _Language(
    template="law.c.jinja",
    prefix="railslip_asmc_",
    comment="/* {} */",
    parameter="p->{}",
    conjunction=" && ",
    finite="isfinite({})",
    printer=_CPrinter({"user_functions": {name: f"railslip_asmc_{name}" for name in _HELPERS}}),
    field=lambda name: f"    double {name};",
    assigned=lambda name, text, kind: _short(f"    {kind}{name} = {text};"),
)


# --- the programs -----------------------------------------------------------------------------------------------------


def _source(law: SampledLaw, language: _Language) -> str:
    """The program: a Python module, or a translation unit with the types and functions railslip_asmc_*."""
    lines = {
        "surface": _statements([("s", law.surface)], law, language),
        "control": [line for one in law.control for line in _statements([one], law, language)],
        "prepare": _prepared(law, language),
        "parameters": _fields(law, law.parameters, language),
        "state": _fields(law, (*law.states, *KEPT), language),
    }
    texts = {name: "\n".join(found) for name, found in lines.items()}
    text = (
        environment("railslip_ctrl.sliding")
        .get_template(language.template)
        .render(
            texts,
            law=law,
            fields=(*law.states, *KEPT),
            carried=[name for name in law.states if not name.startswith("theta")],
            started={name: "bounded(v)" if name == "v_filtered" else "0.0" for name in (*law.states, *KEPT[:-1])},
            rules=[*(_rule(name, rule, language) for name, rule in law.rules.items()), language.finite.format("v")],
            used=[name for name in _HELPERS if any(f"{name}(" in text for text in texts.values())],
            head=lambda width, mark: "\n".join((mark + line).rstrip() for line in _head(law.note, width)),
            options=OPTIONS,
            doubles=lambda names: ", ".join(f"double {name}" for name in names),
            hold_time=HOLD_TIME,
            largest=LARGEST,
        )
    )
    return "\n".join(part for line in text.split("\n") for part in _short(line))


def _head(note: tuple[str, ...], width: int) -> list[str]:
    """The head's text in lines of at most `width` characters; `note` as of `SampledLaw`."""
    paragraphs = (
        "Adaptive sliding-mode slip controller, sampled. Generated by `railslip derive`: do not edit.",
        "",
        f"Law: [Park2008] (45), (49), derived and sampled by railslip_ctrl {__version__}",
        f"from sources of SHA-256 {sources_hash()}.",
        *note,
        "",
        "Units: SI throughout (m, kg, s, N, rad), those of each number beside it.",
        "",
        "Conditions that do NOT hold for this law, with the published vehicle, gains and disturbances (railslip verify "
        "tells why, and decides them for other numbers):",
    )
    paragraphs += tuple(f"- {name}" for name in NOT_HOLDING)
    return [line for one in paragraphs for line in (textwrap.wrap(one, width) or [""])]


def _fields(law: SampledLaw, names: tuple[str, ...], language: _Language) -> list[str]:
    """Fields of a record, each with its meaning behind it, or before it where that is too long."""
    lines = []
    for name in names:
        field, comment = language.field(name), language.comment.format(law.meaning(name))
        both = f"{field} {comment}"
        lines += [both] if len(both) <= WIDTH else ["    " + comment, field]
    return lines


def _rule(name: str, rule: tuple[str, ...], language: _Language) -> str:
    value = language.parameter.format(name)
    return language.conjunction.join((language.finite.format(value), *(one.format(value) for one in rule)))


def _prepared(law: SampledLaw, language: _Language) -> list[str]:
    """Statements from what is measured and kept to what the continuous law is a function of."""
    lines, known = [], set(law.states)
    for name, value in law.prepare:
        lines += _statements([(name, value)], law, language, declare=name not in known)
        if name in law.states and value.func is not LIMITED:
            lines += language.assigned(name, f"{language.prefix}bounded({name})", "")
        known.add(name)
    return lines


def _statements(targets: list[Assignment], law: SampledLaw, language: _Language, *, declare: bool = True) -> list[str]:
    """Lines that assign the targets, common parts first; parameters are read from `p`."""
    own = {name for name, _ in targets}
    again = {name for name, value in law.prepare if value.func is LIMITED}
    lines = [f"    {language.comment.format(law.meaning(name))}" for name, _ in targets if name in EXPLAINED]
    for name, value in _common_parts(targets, {one: language.parameter.format(one) for one in law.parameters}):
        kind = "" if name in own and not declare else "double " if name in again else "const double "
        # a case distinction is printed in several lines
        lines += language.assigned(name, " ".join(language.printer.doprint(value).split()), kind)
    return lines


def _common_parts(targets: list[Assignment], names: dict[str, str]) -> list[Assignment]:
    """Targets after `cse`, temporaries before them, parameters renamed by `names`; the same for every language.

    Divided by and exponentiated with the `_HELPERS`, so that a parameter of 0 does in every language the same.
    """
    temporaries, values = sp.cse([value for _, value in targets], symbols=sp.numbered_symbols(f"{targets[0][0]}_part"))
    renamed = {**names, "switching": "switching_"}
    lines = [(symbol.name, value) for symbol, value in temporaries]
    lines += zip((name for name, _ in targets), values, strict=True)
    return [(name, _renamed(_guarded(value), renamed)) for name, value in lines]


def _guarded(expression: sp.Expr) -> sp.Expr:
    """x^-n as reciprocal(x^n) and exp as exponential, but of numbers."""
    reciprocal, exponential = (sp.Function(name) for name in _HELPERS[:2])
    guarded = expression.replace(
        lambda x: x.is_Pow and x.exp.is_Number and x.exp.is_negative and not x.base.is_Number,
        lambda x: reciprocal(x.base**-x.exp),
    )
    return guarded.replace(lambda x: isinstance(x, sp.exp), lambda x: exponential(x.args[0]))


def _renamed(expression: sp.Expr, renamed: dict[str, str]) -> sp.Expr:
    known = (symbol for symbol in expression.free_symbols if symbol.name in renamed)
    return expression.xreplace({symbol: sp.Symbol(renamed[symbol.name], **symbol.assumptions0) for symbol in known})


def _short(line: str, width: int = WIDTH) -> list[str]:
    """A line of code in lines of `width`, broken at blanks, before an operator; from the second on indented farther."""
    if len(line) <= width:
        return [line]
    spaced = re.sub(r"(?<=[\w)])([*/])(?=[\w(])", r" \1 ", line)
    together = re.sub(r" = | [-+*/] |const ", _unbreakable, spaced)
    further = line[: len(line) - len(line.lstrip())] + 4 * " "
    lines = textwrap.wrap(together, width, subsequent_indent=further, break_long_words=False, break_on_hyphens=False)
    return [one.replace("\N{NO-BREAK SPACE}", " ") for one in lines]


def _unbreakable(found: re.Match[str]) -> str:
    """An operator stays with what follows it; `=` and `const` with both sides."""
    blank, text = "\N{NO-BREAK SPACE}", found[0]
    return text.replace(" ", blank) if "=" in text or "const" in text else text[:-1] + blank


# --- an adhesion law's own numbers ------------------------------------------------------------------------------------


_DIGITS = 6  #: significant digits of a number in a formula; the code has all of them


@dataclass(frozen=True)
class LawNumbers:
    """The numbers on one rail: name and value (SI, in the law's order; of a table one for each of its points), and Tb,
    N*m, with the numbers in it; None for a law without a closed form, whose Ta stays an argument.
    """

    rail: Rail
    parameters: tuple[tuple[str, float], ...]
    torque: sp.Expr | None


def law_numbers(derivation: Derivation, law: AdhesionLaw) -> tuple[LawNumbers, ...]:
    """The numbers of `law` in the `derivation` made with it, on dry and on wet rail; of a wet one on wet rail alone.

    InputError for a derivation with another law.
    """
    if derivation.adhesion != law.name:
        raise InputError(f"law: {law.name!r} is not the one derived with, {derivation.adhesion!r}; derive with it")
    rails = (Rail.WET,) if law.rail is Rail.WET else tuple(Rail)
    return tuple(_on(derivation, law.on(rail)) for rail in rails)


def _on(derivation: Derivation, law: AdhesionLaw) -> LawNumbers:
    values = law.parameters()
    if law.statement().functions:
        return LawNumbers(law.rail, tuple(zip(_points(law), values, strict=True)), None)
    numbers = {symbol: sp.Float(value, _DIGITS) for symbol, value in zip(law.symbols(), values, strict=True)}
    parameters = tuple(zip(law.parameter_names(), values, strict=True))
    return LawNumbers(law.rail, parameters, derivation.law_in_adhesion.subs(numbers))


def _points(law: AdhesionLaw) -> list[str]:
    """Names of the values of `parameters`: those of a list are numbered."""
    fields: list[tuple[str, Any]] = [(name, getattr(law, name)) for name in law.parameter_names()]
    return [
        name if len(values) == 1 else f"{name}_{i}"
        for name, value in fields
        for values in ([value] if isinstance(value, float) else value,)
        for i in range(1, len(values) + 1)
    ]


def with_numbers(code: LawCode, numbers: tuple[LawNumbers, ...], file: Path) -> LawCode:
    """The code with the numbers at its end: a dict (Python) and an initialiser's entries (C) for each rail.

    The code's head names the `file` that they are from.
    """
    named = [(one.rail, {PREFIX + name: value for name, value in one.parameters}) for one in numbers]
    if not all(name in code.law.parameters for _, row in named for name in row):
        return code  # Ta is an argument: there are no such parameters
    note = (*code.law.note, "Numbers of the adhesion law, at the end of this file, from:", _origin(file))
    law = replace(code.law, note=note)
    python = ["", "", "# The adhesion law's parameters: Parameters(**ADHESION_DRY, J=..., ...)"]
    c = ["", "/* The adhesion law's parameters, for an initialiser: {RAILSLIP_ASMC_ADHESION_DRY, .J = ..., ...} */"]
    for rail, row in named:
        python += [f"ADHESION_{rail.name} = {{", *(f"    {name!r}: {value!r}," for name, value in row.items()), "}"]
        entries = ", ".join(f".{name} = {value!r}" for name, value in row.items())
        c.append(" \\\n".join(_short(f"#define RAILSLIP_ASMC_ADHESION_{rail.name} {entries}", WIDTH - 2)))
    printed = _printed(law)
    return replace(printed, python=printed.python + "\n".join([*python, ""]), c=printed.c + "\n".join([*c, ""]))


def _origin(file: Path) -> str:
    return f"{file.name}, SHA-256 {file_hash(file)}."
