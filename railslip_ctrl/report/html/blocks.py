"""What a section of the report is made of; the template knows these and nothing of control."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

Cells = Sequence[str]

_NUMBER = re.compile(r"[−+±≤>\d.,·e∞– ×%]*|unstable|unbounded|none holds|none|never")
_SHORT = 16  # rows


@dataclass(frozen=True)
class Paragraph:
    """Text; `strong` sets it apart as a finding."""

    text: str
    strong: bool = False
    kind: ClassVar[str] = "paragraph"


@dataclass(frozen=True)
class Items:
    """A list of texts."""

    texts: tuple[str, ...]
    kind: ClassVar[str] = "items"


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


@dataclass(frozen=True)
class Group:
    """A part of a section under its own heading."""

    anchor: str
    title: str
    blocks: tuple[Block, ...]
    kind: ClassVar[str] = "group"


Block = Paragraph | Items | Facts | Table | Picture | Details | Group


@dataclass(frozen=True)
class Section:
    """A chapter with its anchor in the table of contents."""

    anchor: str
    title: str
    blocks: tuple[Block, ...] = field(default_factory=tuple)

    def pictures(self) -> Iterator[Picture]:
        """Every picture, in order."""
        yield from _pictures(self.blocks)


def _pictures(blocks: Sequence[Block]) -> Iterator[Picture]:
    for block in blocks:
        if isinstance(block, Picture):
            yield block
        elif isinstance(block, Details | Group):
            yield from _pictures(block.blocks)
