"""Reading a log: CSV with a header, in blocks of lines, so that memory does not grow with the file.

Every row keeps the number of its line. A line that is no row (cut, or with something else than numbers) is left out
and named; a line without a line end at the end of the file is taken to be cut. Time stamps that do not grow are
refused, as nothing tells which of them are right.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.errors import InputError
from railslip_ctrl.parameters.validation import file_name
from railslip_ctrl.units import shown

from .columns import UNITS, Column, find_columns

Floats = NDArray[np.float64]
Lines = NDArray[np.int64]

BLOCK_BYTES = 4 << 20
"""Bytes read at a time; a block and the numbers in it take some 20 MB."""

_LONGEST_HEADER = 64 << 10
_SEPARATORS = (";", "\t", ",")
_MOST_NAMED = 5


@dataclass(frozen=True)
class Rows:
    """Rows of a log, SI.

    Attributes
    ----------
    line : array of int, (n,)
        Line of each row in the file, the header being line 1.
    columns : dict of arrays, (n,)
        By quantity, those of the log.
    """

    line: Lines
    columns: dict[str, Floats]

    def __len__(self) -> int:
        return len(self.line)

    def where(self, kept: NDArray[np.bool_]) -> Rows:
        """The rows that are kept."""
        return Rows(self.line[kept], {name: values[kept] for name, values in self.columns.items()})

    def part(self, start: int, stop: int | None) -> Rows:
        """Rows by position."""
        return Rows(self.line[start:stop], {name: values[start:stop] for name, values in self.columns.items()})

    def then(self, more: Rows) -> Rows:
        """These rows and more after them."""
        return Rows(
            np.concatenate([self.line, more.line]),
            {name: np.concatenate([values, more.columns[name]]) for name, values in self.columns.items()},
        )


@dataclass
class Broken:
    """The lines that were no rows: how many, and the first of them with what was wrong."""

    count: int = 0
    named: list[tuple[int, str]] = field(default_factory=list)

    def add(self, line: int, reason: str) -> None:
        """Take note of a line."""
        self.count += 1
        if len(self.named) < _MOST_NAMED:
            self.named.append((line, reason))

    @property
    def first(self) -> tuple[str, ...]:
        """The lines named, in order, a sentence each."""
        return tuple(f"line {line}: {reason}" for line, reason in sorted(self.named))


class Log:
    """A log opened for reading.

    Parameters
    ----------
    path : Path
        CSV, UTF-8 or Latin-1; separated by commas, semicolons (then a decimal comma is understood) or tabs.
    columns, units : mapping, optional
        See `columns.find_columns`.
    block_bytes : int
        How much is read at a time.

    Raises
    ------
    InputError
        One line with the file and what is wrong: missing, empty, no header, a column or a unit; while reading also
        time stamps that do not grow, and a file without a single row.
    """

    def __init__(
        self,
        path: Path,
        *,
        columns: Mapping[str, str] | None = None,
        units: Mapping[str, str] | None = None,
        block_bytes: int = BLOCK_BYTES,
    ) -> None:
        self.path, self.name = path, file_name(path)
        self.broken = Broken()
        self.bytes_read = 0
        self._block_bytes = block_bytes
        head = _first_line(path, self.name)
        self._header_bytes = len(head)
        text = _decoded(head, self.name)
        self._separator = next((s for s in _SEPARATORS if s in text), ",")
        self._header = next(csv.reader([text.strip("\r\n")], delimiter=self._separator))
        if any(_is_number(cell) for cell in self._header):
            raise InputError(f"{self.name}: line 1: no header, but numbers; name the columns there, with their units")
        try:
            self.columns = find_columns(self._header, columns, units)
        except InputError as error:
            raise InputError(f"{self.name}: {error}") from None
        self.size = path.stat().st_size

    @property
    def notes(self) -> tuple[str, ...]:
        """What was assumed about the columns."""
        assumed = [c for c in self.columns.values() if not c.unit_given]
        notes = [f"column {c.header!r} names no unit: {UNITS[c.quantity]} is taken for {c.quantity}" for c in assumed]
        if {"wheel_speed", "wheel_angular_speed"} <= self.columns.keys():
            notes.append("the log has both speeds of the wheel: the angular one is used")
        return tuple(notes)

    def rows(self) -> Iterator[Rows]:
        """The rows, block by block; `broken` and `bytes_read` say at any time what was met."""
        last_time, any_rows = -np.inf, False
        for first_line, block in self._blocks():
            rows = self._parsed(first_line, block)
            if len(rows):
                _check_growing(rows, last_time, self.name)
                last_time, any_rows = float(rows.columns["time"][-1]), True
                yield rows
        if not any_rows:
            broken = f"; {self.broken.first[0]}" if self.broken.count else ""
            raise InputError(f"{self.name}: no rows after the header{broken}; give a log with data")

    def _blocks(self) -> Iterator[tuple[int, bytes]]:
        """Whole lines, with the number of the first."""
        line, rest = 2, b""
        with self.path.open("rb") as file:
            file.seek(self._header_bytes)
            while read := file.read(self._block_bytes):
                self.bytes_read += len(read)
                cut = read.rfind(b"\n") + 1
                if cut == 0:
                    rest += read
                    continue
                block, rest = rest + read[:cut], read[cut:]
                yield line, block
                line += block.count(b"\n")
        if rest.strip():
            self.broken.add(line, "the file ends within this line, which is left out")

    def _parsed(self, first_line: int, block: bytes) -> Rows:
        ends = np.flatnonzero(np.frombuffer(block, dtype=np.uint8) == ord("\n"))
        starts = np.concatenate([[0], ends[:-1] + 1])
        lines = np.arange(first_line, first_line + len(ends))
        good = self._complete(block, starts, ends, lines)
        if not good.all():
            block, lines = _without(block, starts, ends, good), lines[good]
        try:
            values = self._numbers(block, len(lines))
        except ValueError:
            block, lines = self._only_numbers(block, lines)
            values = self._numbers(block, len(lines))
        finite = np.asarray(np.isfinite(np.stack(list(values.values()))).all(axis=0))
        for line in lines[~finite]:
            self.broken.add(int(line), "a value is missing or not finite")
        return Rows(lines, values).where(finite)

    def _complete(self, block: bytes, starts: Lines, ends: Lines, lines: Lines) -> NDArray[np.bool_]:
        """Which lines have as many cells as the header; an empty line is neither row nor broken."""
        if b'"' in block:  # a separator may stand in quotes; what is wrong then shows as a missing value
            return ends > starts
        marks = np.concatenate([[0], np.cumsum(np.frombuffer(block, dtype=np.uint8) == ord(self._separator))])
        cells = marks[ends] - marks[starts] + 1
        good: NDArray[np.bool_] = cells == len(self._header)
        for i in np.flatnonzero(~good):
            if block[starts[i] : ends[i]].strip():
                self.broken.add(int(lines[i]), f"{cells[i]} cells where the header has {len(self._header)}")
        return good

    def _numbers(self, block: bytes, count: int) -> dict[str, Floats]:
        """The log's columns out of whole lines, SI; ValueError where a cell is no number."""
        if count == 0:
            return {name: np.empty(0) for name in self.columns}
        import pandas as pd

        frame = pd.read_csv(
            io.BytesIO(block),
            sep=self._separator,
            decimal="," if self._separator == ";" and b"," in block else ".",
            header=None,
            names=list(range(len(self._header))),
            usecols=[column.index for column in self.columns.values()],
            dtype=np.float64,
            index_col=False,
            skip_blank_lines=False,
            encoding="latin-1",
        )
        if len(frame) != count:
            raise ValueError("rows")
        return {name: column.factor * frame[column.index].to_numpy() for name, column in self.columns.items()}

    def _only_numbers(self, block: bytes, lines: Lines) -> tuple[bytes, Lines]:
        """Look at each line by itself, and leave out those with a cell that is no number."""
        texts = block.split(b"\n")[:-1]
        good = np.ones(len(texts), dtype=bool)
        for i, text in enumerate(texts):
            wrong = self._not_a_number(text.decode("latin-1"))
            if wrong is not None:
                good[i] = False
                column, cell = wrong
                self.broken.add(int(lines[i]), f"{shown(cell)} is not a number, column {column.header!r}")
        return b"".join(text + b"\n" for text, keep in zip(texts, good, strict=True) if keep), lines[good]

    def _not_a_number(self, text: str) -> tuple[Column, str] | None:
        cells = next(csv.reader([text.strip("\r")], delimiter=self._separator), [])
        for column in self.columns.values():
            cell = cells[column.index].strip() if column.index < len(cells) else ""
            if cell and not _is_number(cell):
                return column, cell
        return None


def _first_line(path: Path, name: str) -> bytes:
    try:
        usable, head = path.is_file(), b""
        if usable:
            with path.open("rb") as file:
                head = file.readline(_LONGEST_HEADER)
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        raise InputError(f"{name}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    if not usable:  # nor a pipe, which may never end
        reason = "is a directory" if path.is_dir() else "no such file" if not path.exists() else "is not a regular file"
        raise InputError(f"{name}: {reason}; give a CSV file")
    if not head.strip():
        raise InputError(f"{name}: the file is empty or its first line is; give a CSV file with a header")
    if not head.endswith(b"\n"):
        raise InputError(f"{name}: nothing after line 1; give a CSV file with a header and rows")
    return head


def _decoded(head: bytes, name: str) -> str:
    if b"\0" in head:
        raise InputError(f"{name}: not a text file in UTF-8 or Latin-1; save it as CSV in UTF-8")
    try:
        return head.decode("utf-8-sig")
    except UnicodeDecodeError:
        return head.decode("latin-1")


def _is_number(text: str) -> bool:
    try:
        float(text.strip().replace(",", "."))
    except ValueError:
        return False
    return True


def _without(block: bytes, starts: Lines, ends: Lines, good: NDArray[np.bool_]) -> bytes:
    kept = zip(starts[good], ends[good], strict=True)
    return b"".join(block[start : end + 1] for start, end in kept)


def _check_growing(rows: Rows, after: float, name: str) -> None:
    time = rows.columns["time"]
    steps = np.diff(time, prepend=after)
    if not (steps > 0.0).all():
        at = int(np.argmin(steps > 0.0))
        before = time[at - 1] if at else after
        kind = "repeats" if steps[at] == 0.0 else "goes back from"
        raise InputError(
            f"{name}: line {rows.line[at]}: time {time[at]:.9g} s {kind} {before:.9g} s; give times that grow"
        )
