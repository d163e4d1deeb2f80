"""The derived law as a program in Python and in C99, with an adhesion law's own numbers where a file gives them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import sympy as sp

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.model.vehicle import Rail

from .code_c import c_source
from .code_python import WIDTH, python_source, short
from .derivation import Derivation
from .law import file_hash
from .sampled_law import PREFIX, SampledLaw, sampled_law


@dataclass(frozen=True)
class LawCode:
    """Source texts of the law, and what they name."""

    law: SampledLaw
    python: str
    c: str


@cache
def generate(derivation: Derivation) -> LawCode:
    """The law of a derivation as Python and C99 source."""
    law = sampled_law(derivation)
    return LawCode(law, python_source(law), c_source(law))


@cache
def python_law(derivation: Derivation) -> ModuleType:
    """The generated Python, ready to call: `Parameters`, `State`, `init`, `control`, `valid`, `step`.

    `control` is the continuous law: a pure function of what is measured, the estimates and the parameters, to
    (torque, s, theta1_hat_rate, theta2_hat_rate). `step(state, v, omega[, Ta], p)` gives (torque, s, new state).
    """
    module = ModuleType("railslip_asmc")
    exec(compile(generate(derivation).python, "<generated sliding-mode law>", "exec"), module.__dict__)
    return module


# --- an adhesion law's own numbers ------------------------------------------------------------------------------------


_DIGITS = 6
"""Significant digits of a number in a formula; the code has all of them."""


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
        c.append(" \\\n".join(short(f"#define RAILSLIP_ASMC_ADHESION_{rail.name} {entries}", WIDTH - 2)))
    return LawCode(law, python_source(law) + "\n".join([*python, ""]), c_source(law) + "\n".join([*c, ""]))


def _origin(file: Path) -> str:
    return f"{file.name}, SHA-256 {file_hash(file)}."
