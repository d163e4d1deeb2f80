"""One line of the errata: what is printed, what follows, and by how much they differ."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import sympy as sp

from railslip_ctrl.sliding.identities import vanishes
from railslip_ctrl.sliding.symbols import latex, plain

How = Literal["symbolic", "computed", "argument"]


@dataclass(frozen=True)
class Erratum:
    """A printed equation, number or claim beside what the source's own equations give.

    Attributes
    ----------
    where : str
        Equation, table or page of [Park2008].
    printed_latex, derived_latex, difference_latex : str
        As printed; as derived or computed; printed less derived ("0" where they agree).
    printed, derived : str
        The first two as plain text.
    agrees : bool
        True where the difference is proved to be zero.
    how : str
        "symbolic": compared as expressions; "computed": numbers; "argument": by what an expression depends on.
    sign_and_size : str
        The difference in the paper's own numbers, computed.
    explanation : str
        What goes wrong, and what is used instead; says so where only a simulation could show the rest.
    """

    where: str
    printed_latex: str
    derived_latex: str
    difference_latex: str
    printed: str
    derived: str
    agrees: bool
    how: How
    sign_and_size: str
    explanation: str


def compared(
    where: str, printed: Sequence[sp.Expr], derived: Sequence[sp.Expr], *, sign_and_size: str, explanation: str
) -> Erratum:
    """An erratum by comparing expressions, one or a column of them."""
    difference = tuple(_tidy(a - b) for a, b in zip(printed, derived, strict=True))
    return Erratum(
        where=where,
        printed_latex=column(printed),
        derived_latex=column(derived),
        difference_latex=column(difference),
        printed=_text(printed),
        derived=_text(derived),
        agrees=all(vanishes(entry) for entry in difference),
        how="symbolic",
        sign_and_size=sign_and_size,
        explanation=explanation,
    )


def _tidy(difference: sp.Expr) -> sp.Expr:
    return sp.Integer(0) if vanishes(difference) else sp.factor_terms(sp.expand(difference))


def column(entries: Sequence[sp.Expr]) -> str:
    """LaTeX of one expression, or of several as a column."""
    return latex(entries[0]) if len(entries) == 1 else latex(sp.Matrix(entries))


def told(where: str, printed: str, derived: str, *, how: How, sign_and_size: str, explanation: str) -> Erratum:
    """An erratum of numbers or of a claim that disagrees; both sides in LaTeX."""
    texts = _without_latex(printed), _without_latex(derived)
    return Erratum(where, printed, derived, r"\text{see size}", *texts, False, how, sign_and_size, explanation)


def _text(entries: Sequence[sp.Expr]) -> str:
    return plain(entries[0]) if len(entries) == 1 else plain(sp.Matrix(entries))


# In this order: what only decorates, then what has meaning, innermost braces first.
_LATEX = (
    (r"\\(?:mathrm|text|operatorname)\s*\{([^{}]*)\}", r"\1"),
    (r"\\tilde\s*\{?\\?(\w+)\}?", r"\1~"),
    (r"\\hat\s*\{?\\?(\w+)\}?", r"\1^"),
    (r"\\dot\s*\{?\\?(\w+)\}?", r"\1'"),
    (r"\\left|\\right", ""),
    (r"\\[ ,;]", " "),
    (r"\\times", "*"),
    (r"\\ge\b", ">="),
    (r"\\%", "%"),
    (r"\\quad", " "),
    (r"\^\{([^{}]*)\}", r"^\1"),
    (r"_\{([^{}]*)\}", r"_\1"),
)
_FRACTION = re.compile(r"\\frac\{([^{}]*)\}\{([^{}]*)\}")
_BRACES = re.compile(r"\{([^{}]*)\}")


def _without_latex(text: str) -> str:
    """Plain text of the LaTeX that `told` is given: theta~ is an error, theta^ an estimate, s' a rate."""
    for pattern, replacement in _LATEX:
        text = re.sub(pattern, replacement, text)
    while _FRACTION.search(text) or _BRACES.search(text):
        text = _FRACTION.sub(r"(\1)/(\2)", text) if _FRACTION.search(text) else _BRACES.sub(r"\1", text, count=1)
    return re.sub(r" +", " ", re.sub(r"\\(?=[a-zA-Z])", "", text)).strip()
