"""Blocks of reports (facts, tables, paragraphs, pictures, sections) for text and HTML, and formatting of numbers."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import KW_ONLY
from typing import ClassVar, Literal

import rich.table
from rich import box
from rich.console import Console, ConsoleOptions, RenderableType
from rich.measure import Measurement
from rich.padding import Padding
from rich.text import Text

from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import BOUND_DIGITS, ms_up, rounded, rounded_down, rounded_up
from railslip_ctrl.loop import Margins

WIDTH = 110  #: characters per line of a report in a file or a pipe; fits A4 landscape in a usual fixed-width font

NONE = "–"  #: cell of a table without a value

MARGIN_HEAD = ("Gain −", "Gain +", "Phase, deg", "Delay, s", "Ms", "Mt")  #: columns of `margin_cells`

_UNLIMITED = 10_000  # characters per line, wider than any table
_SHORT = 16  # largest number of rows of a table that is not divided between pages
_LARGE = 1e6  # smallest number that is written with a power of ten
_POWER = re.compile(r"e([+-]?)0*(\d+)")
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "+")
_NUMBER = re.compile(r"[−+±≤<>\d.,·e∞– ×%]*|unstable|unbounded|none stabilises|none|never")

_width: ContextVar[int] = ContextVar("width", default=WIDTH)


@dataclass(frozen=True)
class Paragraph:
    """One paragraph of a report."""

    text: str
    kind: ClassVar[str] = "paragraph"

    def __rich__(self) -> RenderableType:
        return Padding(Text(self.text), (0, 0, 0, 2))


@dataclass(frozen=True)
class Facts:
    """List of names and values, in two columns without a head."""

    rows: Sequence[tuple[str, str]]
    kind: ClassVar[str] = "facts"

    def __rich__(self) -> rich.table.Table:
        shown = rich.table.Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
        shown.add_column(no_wrap=True)
        shown.add_column()
        for row in self.rows:
            shown.add_row(*row)
        return shown


@dataclass(frozen=True)
class Table:
    """Table with a line below its head.

    - left: number of columns, counted from the left, that text aligns left; a wide table that is divided repeats them.
    - whole: number of leading columns whose cells are never wrapped in text.
    - text_columns: indices of further columns that are aligned left in text.
    - caption: shown above the table in HTML, not in text.
    - wide: if true, HTML uses smaller letters.
    """

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    _: KW_ONLY
    left: int = 1
    whole: int = 0
    text_columns: Collection[int] = ()
    caption: str = ""
    wide: bool = False
    kind: ClassVar[str] = "table"

    @property
    def numeric(self) -> tuple[bool, ...]:
        columns = zip(*self.rows, strict=True)
        return tuple(all(_NUMBER.fullmatch(cell) for cell in column) for column in columns)

    @property
    def short(self) -> bool:
        return len(self.rows) <= _SHORT

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[RenderableType]:
        unlimited = options.update(max_width=_UNLIMITED)  # otherwise the console's width limits the measured width
        repeated = list(range(self.left))
        shown = repeated
        for i in range(self.left, len(self.head)):
            wider = self._part([*shown, i])
            if shown != repeated and Measurement.get(console, unlimited, wider).minimum > options.max_width:
                yield self._part(shown)
                shown = repeated
            shown = [*shown, i]
        yield self._part(shown)

    def _part(self, numbers: Sequence[int]) -> rich.table.Table:
        part = rich.table.Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1))
        for i in numbers:
            justify: Literal["left", "right"] = "left" if i < self.left or i in self.text_columns else "right"
            part.add_column(self.head[i], justify=justify, no_wrap=i < self.whole)
        for row in self.rows:
            part.add_row(*(row[i] for i in numbers))
        return part


@dataclass(frozen=True)
class Picture:
    """Picture with a caption; `name` selects the drawing, and `alt` describes the picture for a screen reader."""

    name: str
    caption: str
    alt: str
    kind: ClassVar[str] = "picture"


@dataclass(frozen=True)
class Details:
    """Block that HTML hides until the reader opens it: title, verdict in a few words, and the hidden blocks."""

    title: str
    verdict: str
    blocks: tuple[Block, ...]
    kind: ClassVar[str] = "details"

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[RenderableType]:
        yield heading(f"{self.title}: {self.verdict}", "-")
        yield from (block for block in self.blocks if not isinstance(block, Picture))  # text cannot contain pictures
        yield ""


Block = Paragraph | Facts | Table | Picture | Details


@dataclass(frozen=True)
class Section:
    """Section of a report; links of the table of contents use `anchor`."""

    anchor: str
    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True)
class FirstPage:
    """First page of a report, which can be read in a minute.

    - headline: result in a few words.
    - subject: what the headline is about, such as the recommended controller.
    - file: name of the file that contains the subject; empty if there is none.
    - lines: pairs of a heading and its text.
    - head, rows: table of main numbers.
    """

    title: str
    headline: str
    subject: str
    file: str
    lines: tuple[tuple[str, str], ...]
    head: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    pictures: tuple[Picture, ...] = ()


@contextmanager
def columns(number: int) -> Iterator[None]:
    """Make reports in the `with` block `number` characters wide, for a terminal narrower than `WIDTH`."""
    before = _width.set(number)
    try:
        yield
    finally:
        _width.reset(before)


def width() -> int:
    """Return the width of reports in characters per line."""
    return _width.get()


def render(parts: Iterable[RenderableType]) -> str:
    """Return facts, tables, strings and other blocks as text."""
    stream = io.StringIO()
    console = Console(file=stream, width=_width.get(), color_system=None, highlight=False, markup=False, emoji=False)
    for part in parts:
        console.print(part)
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines()) + "\n"


def heading(text: str, mark: str = "=") -> Text:
    """Return an underlined heading."""
    return Text(f"{text}\n{mark * min(len(text), _width.get())}")


def counted(number: int, what: str) -> str:
    """Return a number followed by the noun `what`, such as "1 run" or "2 runs"."""
    return f"{number} {what}{'' if number == 1 else 's'}"


def listed(items: Iterable[str]) -> str:
    """Join items with commas and "and"; return "none" if there are no items."""
    every = list(items)
    return every[0] if len(every) == 1 else f"{', '.join(every[:-1])} and {every[-1]}" if every else "none"


def fixed(value: float, digits: int = 5) -> str:
    """Format a number with `digits` significant digits, without trailing zeros; inf is "unbounded", NaN is "-"."""
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "unbounded" if value > 0 else "-unbounded"
    return f"{value:.{digits}g}"


def short(value: float, digits: int = 4) -> str:
    """Format a number with `digits` significant digits and a true minus sign; inf is "∞", NaN is a dash."""
    if not math.isfinite(value):
        return "∞" if value > 0 else NONE
    nearest = rounded(value, digits)
    text = f"{nearest:.0f}" if 10**digits <= abs(nearest) < _LARGE else fixed(value, digits)
    return minus(_POWER.sub(lambda match: "·10" + (match[1] + match[2]).translate(_RAISED), text))


def above(value: float, digits: int = BOUND_DIGITS) -> str:
    """Format a value rounded up, for an upper bound."""
    return short(rounded_up(value, digits), digits)


def below(value: float, digits: int = BOUND_DIGITS) -> str:
    """Format a value rounded down, for a lower bound."""
    return short(rounded_down(value, digits), digits)


def ms_text(ms: float) -> str:
    """Format a worst Ms; inf is "unstable", and NaN is a dash (`NONE`)."""
    return "unstable" if ms == math.inf else NONE if math.isnan(ms) else ms_up(ms)


def minus(text: str) -> str:
    """Replace hyphens by minus signs in a text of numbers."""
    return text.replace("-", "−")


def roots_text(values: Iterable[complex]) -> str:
    """Format poles or zeros, separated by commas, with one text for a conjugate pair; "none" if there are none."""

    def root_text(value: complex) -> str:
        return f"{value.real:.5g}" if value.imag == 0 else f"{value.real:.5g} ± {abs(value.imag):.5g}j"

    return ",  ".join(root_text(value) for value in values if value.imag >= 0) or "none"


def margin_cells(margins: Margins | None) -> tuple[str, ...]:
    """Return the table cells of the margins in the columns `MARGIN_HEAD`; all are dashes if the loop is unstable."""
    if margins is None:
        return (NONE,) * len(MARGIN_HEAD)
    values = (margins.gain_decrease, margins.gain_increase, margins.phase_deg, margins.delay_s, margins.ms, margins.mt)
    return tuple(short(value) for value in values)
