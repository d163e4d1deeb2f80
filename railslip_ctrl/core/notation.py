"""Symbols of the plant with LaTeX, unit and meaning, and the list of cited sources.

The symbols of an adhesion law are the fields of its class. "[Park2008] (45)" cites equation 45 of a source.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

from railslip_ctrl.core.records import dataclass

from .templates import texts


@dataclass(frozen=True)
class Notation:
    """Symbol of the plant; SymPy assumes that it is real, and positive if `positive` is True."""

    name: str
    latex: str
    unit: str
    meaning: str
    positive: bool = False


def notation_in(rows: Mapping[str, Sequence[str]]) -> Mapping[str, Notation]:
    """Make symbols from names and `rows` (LaTeX, unit, meaning and, for a positive symbol, the text "positive")."""
    return MappingProxyType({name: Notation(name, row[0], row[1], row[2], len(row) > 3) for name, row in rows.items()})


NOTATION = notation_in(texts(__package__, "notation.toml"))  #: symbols of the plant by name


def symbol(name: str) -> Any:
    """SymPy symbol for a name in `NOTATION`; KeyError for any other name. The call imports SymPy."""
    import sympy as sp

    entry = NOTATION[name]
    return sp.Symbol(name, positive=True) if entry.positive else sp.Symbol(name, real=True)


def latex_names() -> dict[Any, str]:
    """LaTeX of each symbol of the plant, as in [Park2008], for the argument `symbol_names` of `sympy.latex`."""
    return {symbol(entry.name): entry.latex for entry in NOTATION.values()}


SOURCES = MappingProxyType({key: " ".join(text.split()) for key, text in texts(__package__, "sources.toml").items()})
"""Full bibliographic references by the key of the source, for example "Park2008"."""


def cite(key: str, where: str = "") -> str:
    """Return the citation "[key] where"; KeyError for a key that is not in `SOURCES`."""
    SOURCES[key]
    return f"[{key}] {where}".rstrip()
