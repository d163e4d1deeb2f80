"""Symbols of the plant: name in formulas and code, LaTeX, unit, meaning; and the sources cited by key.

Symbols of an adhesion law are its fields. "[Park2008] (45)" is equation 45 of a source.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from railslip_ctrl.core.records import dataclass

from .templates import texts


@dataclass(frozen=True)
class Notation:
    """One symbol. `positive` is what SymPy may assume of it; every symbol is real."""

    name: str
    latex: str
    unit: str
    meaning: str
    positive: bool = False


def notation_in(rows: Mapping[str, Sequence[str]]) -> Mapping[str, Notation]:
    """A table of symbols by name, from rows of LaTeX, unit, meaning and, where it is so, "positive"."""
    return MappingProxyType({name: Notation(name, row[0], row[1], row[2], len(row) > 3) for name, row in rows.items()})


NOTATION = notation_in(texts(__package__, "notation.toml"))  #: the table, by name


def symbol(name: str) -> Any:
    """The SymPy symbol of a name in `NOTATION`; KeyError for another name. Imports SymPy."""
    import sympy as sp

    entry = NOTATION[name]
    return sp.Symbol(name, positive=True) if entry.positive else sp.Symbol(name, real=True)


def latex_names() -> dict[Any, str]:
    """What `sympy.latex(..., symbol_names=...)` needs to print the table's symbols as the source does."""
    return {symbol(entry.name): entry.latex for entry in NOTATION.values()}


SOURCES = MappingProxyType({key: " ".join(text.split()) for key, text in texts(__package__, "sources.toml").items()})
"""Full references by key."""


def cite(key: str, where: str = "") -> str:
    """Return "[key] where"; raises KeyError for a key that is not in `SOURCES`."""
    SOURCES[key]
    return f"[{key}] {where}".rstrip()
