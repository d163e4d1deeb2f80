"""A step of a derivation, as it is shown and as it was checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import sympy as sp

from .symbols import latex, plain


@dataclass(frozen=True)
class Step:
    """One step.

    Attributes
    ----------
    name : str
        Short name, unique in a derivation.
    statement : str
        What holds after the step, in words.
    done : str
        What was done to get there.
    equation : Eq
        The result, in the symbols of `notation` and `sliding.symbols`.
    equation_latex, equation_text : str
        The same in LaTeX and in plain text; a column as a tuple.
    source : str
        Where the source has it, or what it follows from.
    checked : bool
        Whether the machine check holds.
    check : str
        How it was checked.
    """

    name: str
    statement: str
    done: str
    equation: sp.Eq
    equation_latex: str
    equation_text: str
    source: str
    checked: bool
    check: str


def step(
    name: str,
    equation: tuple[sp.Basic, sp.Basic],
    *,
    statement: str,
    done: str,
    source: str,
    holds: Sequence[bool],
    check: str,
) -> Step:
    """A step whose `equation` is (left, right); `holds` are the outcomes of its checks."""
    left, right = equation
    return Step(
        name=name,
        statement=statement,
        done=done,
        equation=sp.Eq(left, right, evaluate=False),
        equation_latex=f"{latex(left)} = {latex(right)}",
        equation_text=f"{plain(left)} = {plain(right)}",
        source=source,
        checked=all(holds),
        check=check,
    )
