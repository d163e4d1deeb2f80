"""What a page is made of; the template knows these and nothing of control."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

Cells = Sequence[str]

_NUMBER = re.compile(r"[−+±≤<>\d.,·e∞– ×%]*|unstable|unbounded|none holds|none|never")
_SHORT = 16  # rows


@dataclass(frozen=True)
class Paragraph:
    """Text; `strong` sets it apart as a finding."""

    text: str
    strong: bool = False
    kind: ClassVar[str] = "paragraph"


@dataclass(frozen=True)
class Facts:
    """Names and values."""

    rows: tuple[tuple[str, str], ...]
    kind: ClassVar[str] = "facts"


@dataclass(frozen=True)
class Table:
    """A captioned table; `wide` sets it smaller, so that its columns fit a page."""

    caption: str
    head: Cells
    rows: Sequence[Cells]
    wide: bool = False
    number: int = 0
    kind: ClassVar[str] = "table"

    @property
    def numeric(self) -> tuple[bool, ...]:
        """By column, whether it holds numbers, which are aligned to the right."""
        columns = zip(*self.rows, strict=True)
        return tuple(all(_NUMBER.fullmatch(cell) for cell in column) for column in columns)

    @property
    def short(self) -> bool:
        """Whether it is kept on one page."""
        return len(self.rows) <= _SHORT


@dataclass(frozen=True)
class Picture:
    """A captioned picture by the name it was drawn under; `alt` says in words what is seen."""

    name: str
    caption: str
    alt: str
    number: int = 0
    kind: ClassVar[str] = "picture"


@dataclass(frozen=True)
class Details:
    """Something to open: its title, a word that judges it, and what is inside."""

    title: str
    verdict: str
    blocks: tuple[Block, ...]
    kind: ClassVar[str] = "details"


Block = Paragraph | Facts | Table | Picture | Details


@dataclass(frozen=True)
class Section:
    """A chapter with its anchor in the table of contents."""

    anchor: str
    title: str
    blocks: tuple[Block, ...] = field(default_factory=tuple)


@dataclass(frozen=True)
class FirstPage:
    """What is read in a minute.

    `headline` says what to do in a word or four, `subject` of what; `file` has it as data; `lines` are headed texts;
    `rows` of the table say what, its number, and where.
    """

    title: str
    headline: str
    subject: str
    file: str
    lines: tuple[tuple[str, str], ...]
    head: Cells
    rows: Sequence[Cells]
    pictures: tuple[Picture, ...] = ()

    @property
    def words(self) -> int:
        """Of the headline and the lines."""
        return sum(len(text.split()) for text in (self.headline, *(text for _, text in self.lines)))


def pictures_in(blocks: Sequence[Block]) -> Iterator[Picture]:
    """Every picture, in order."""
    for block in blocks:
        if isinstance(block, Picture):
            yield block
        elif isinstance(block, Details):
            yield from pictures_in(block.blocks)
