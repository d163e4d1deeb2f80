"""The layout of plain-text reports: headings, facts, tables, numbers."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Sequence

from rich import box
from rich.console import Console, RenderableType
from rich.table import Table
from rich.text import Text

WIDTH = 110
"""Columns; A4 across in a usual fixed-width print."""


def render(parts: Iterable[RenderableType]) -> str:
    stream = io.StringIO()
    console = Console(file=stream, width=WIDTH, color_system=None, highlight=False, markup=False, emoji=False)
    for part in parts:
        console.print(part)
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines()) + "\n"


def heading(text: str, mark: str = "=") -> Text:
    return Text(f"{text}\n{mark * min(len(text), WIDTH)}")


def facts(rows: Iterable[tuple[str, str]]) -> Table:
    """Two columns: what, and its value."""
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True)
    table.add_column()
    for name, value in rows:
        table.add_row(name, value)
    return table


def table(columns: Sequence[str], rows: Iterable[Sequence[str]], *, left: int = 1, whole: int = 0) -> Table:
    """A table with a ruled head; the first `left` columns are aligned left, the others right.

    Cells of the first `whole` columns are never broken.
    """
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1))
    for i, name in enumerate(columns):
        table.add_column(name, justify="left" if i < left else "right", no_wrap=i < whole)
    for row in rows:
        table.add_row(*row)
    return table


def fixed(value: float, digits: int = 5) -> str:
    """A number with `digits` significant digits, trailing zeros kept off; "unbounded" for inf, "-" for NaN."""
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "unbounded" if value > 0 else "-unbounded"
    return f"{value:.{digits}g}"


def _root(value: complex) -> str:
    return f"{value.real:.5g}" if value.imag == 0 else f"{value.real:.5g} ± {abs(value.imag):.5g}j"


def roots_text(values: Iterable[complex]) -> str:
    """Poles or zeros, one of each pair, separated by commas; "none" if there are none."""
    return ",  ".join(_root(v) for v in values if v.imag >= 0) or "none"
