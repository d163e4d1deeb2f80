"""The layout of plain-text reports: headings, facts, tables, numbers."""

from __future__ import annotations

import io
import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Literal

from rich import box
from rich.console import Console, ConsoleOptions, RenderableType
from rich.measure import Measurement
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

WIDTH = 110
"""Columns of a report in a file or a pipe, the same everywhere; A4 across in a usual fixed-width print."""

_UNLIMITED = 10_000
"""Columns that no table of a report has."""

_width: ContextVar[int] = ContextVar("width", default=WIDTH)


@contextmanager
def columns(number: int) -> Iterator[None]:
    """Reports made inside are `number` columns wide: those for a terminal narrower than `WIDTH`."""
    before = _width.set(number)
    try:
        yield
    finally:
        _width.reset(before)


def width() -> int:
    """Columns of the reports made here."""
    return _width.get()


def render(parts: Iterable[RenderableType]) -> str:
    stream = io.StringIO()
    console = Console(file=stream, width=_width.get(), color_system=None, highlight=False, markup=False, emoji=False)
    for part in parts:
        console.print(part)
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines()) + "\n"


def heading(text: str, mark: str = "=") -> Text:
    return Text(f"{text}\n{mark * min(len(text), _width.get())}")


def counted(number: int, what: str) -> str:
    """ "1 run", "2 runs"."""
    return f"{number} {what}{'' if number == 1 else 's'}"


def indented(text: str) -> RenderableType:
    """A paragraph."""
    return Padding(Text(text), (0, 0, 0, 2))


def facts(rows: Iterable[tuple[str, str]]) -> Table:
    """Two columns: what, and its value."""
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True)
    table.add_column()
    for name, value in rows:
        table.add_row(name, value)
    return table


@dataclass(frozen=True)
class _Columns:
    """A table that is continued below itself where it is too wide to show every number whole."""

    names: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    left: int
    whole: int
    words: Collection[int]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[RenderableType]:
        unlimited = options.update(max_width=_UNLIMITED)  # within a limit a table would measure no more than that
        repeated = list(range(self.left))
        shown = repeated
        for i in range(self.left, len(self.names)):
            wider = self._part([*shown, i])
            if shown != repeated and Measurement.get(console, unlimited, wider).minimum > options.max_width:
                yield self._part(shown)
                shown = repeated
            shown = [*shown, i]
        yield self._part(shown)

    def _part(self, numbers: Sequence[int]) -> Table:
        table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1))
        for i in numbers:
            justify: Literal["left", "right"] = "left" if i < self.left or i in self.words else "right"
            table.add_column(self.names[i], justify=justify, no_wrap=i < self.whole)
        for row in self.rows:
            table.add_row(*(row[i] for i in numbers))
        return table


def table(
    columns: Sequence[str], rows: Iterable[Sequence[str]], *, left: int = 1, whole: int = 0, words: Collection[int] = ()
) -> RenderableType:
    """A table with a ruled head; the first `left` columns and those numbered in `words` are aligned left, others right.

    Cells of the first `whole` columns are never broken. Where the columns have no room beside each other, those on the
    right follow below, the first `left` ones repeated.
    """
    return _Columns(tuple(columns), tuple(tuple(row) for row in rows), left, whole, words)


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
