"""Reading a log: CSV with a header, in blocks of lines, so that memory does not grow with the file.

Every row keeps the number of its line. A line that is no row (cut, or with something else than numbers) is left out
and named; a line without a line end at the end of the file is taken to be cut. Empty lines and comments, which begin
with #, are passed over. Time stamps that do not grow are refused, as nothing tells which of them are right.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.errors import InputError
from railslip_ctrl.parameters.validation import file_name
from railslip_ctrl.units import shown

from .columns import UNITS, find_columns

Floats = NDArray[np.float64]
Lines = NDArray[np.int64]

BLOCK_BYTES = 4 << 20
"""Bytes read at a time; a block and the numbers in it take some 20 MB."""

_LONGEST_HEADER = 64 << 10
_SEPARATORS = (";", "\t", ",")
_MOST_NAMED = 5
_COMMENT = b"#"

# A stamp jumps ahead where its step is this many times the way back to the next one; neighbours exchanged have less.
_JUMP = 5.0
_STAMPS_KEPT = 64  # of the block before, among which the jump is looked for


@dataclass(frozen=True)
class Rows:
    """Rows of a log, SI.

    Attributes
    ----------
    line : array of int, (n,)
        Line of each row in the file, the first being line 1.
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
        self._returns_line: int | None = None
        self._block_bytes = block_bytes
        head, self._rows_line, self._rows_start = _head(path, self.name)
        text = _decoded(head, self.name).strip("\r\n")
        self._separator = next((s for s in _SEPARATORS if s in text), ",")
        self._header = _cells(text, self._separator) or [text]
        if any(_is_number(cell, ",") for cell in self._header):
            comment = "; a line that begins with # is a comment, no header" if self._rows_line > 2 else ""
            raise InputError(
                f"{self.name}: line {self._rows_line - 1}: no header, but numbers; "
                f"name the columns there, with their units{comment}"
            )
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
        if self._returns_line is not None:
            notes.append(
                f"line {self._returns_line}: its end was translated twice (\\r\\r\\n); such lines are read all the same"
            )
        return tuple(notes)

    def rows(self) -> Iterator[Rows]:
        """The rows, block by block; `broken` and `bytes_read` say at any time what was met."""
        lines, stamps = np.empty(0, dtype=np.int64), np.empty(0)
        for first_line, block in self._blocks():
            rows = self._parsed(first_line, block)
            if len(rows):
                lines, stamps = np.concatenate([lines, rows.line]), np.concatenate([stamps, rows.columns["time"]])
                _check_growing(lines, stamps, self.name)
                lines, stamps = lines[-_STAMPS_KEPT:], stamps[-_STAMPS_KEPT:]
                yield rows
        if not len(stamps):
            broken = f"; {self.broken.first[0]}" if self.broken.count else ""
            raise InputError(f"{self.name}: no rows after the header{broken}; give a log with data")

    def _blocks(self) -> Iterator[tuple[int, bytes]]:
        """Whole lines, with the number of the first."""
        line, rest = self._rows_line, b""
        with self.path.open("rb") as file:
            file.seek(self._rows_start)
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
        block = self._with_plain_ends(first_line, block)
        codes = np.frombuffer(block, dtype=np.uint8)
        ends = np.flatnonzero(codes == ord("\n"))
        starts = np.concatenate([[0], ends[:-1] + 1])
        lines = np.arange(first_line, first_line + len(ends))
        good = self._complete(block, starts, ends, lines)
        if not good.all():
            block, lines = _without(block, starts, ends, good), lines[good]
        try:
            values = self._numbers(block, len(lines))
        except ValueError:
            lines, values = self._line_by_line(block, lines)
        finite = np.asarray(np.isfinite(np.stack(list(values.values()))).all(axis=0))
        for line in lines[~finite]:
            self.broken.add(int(line), "a value is missing or not finite")
        return Rows(lines, values).where(finite)

    def _with_plain_ends(self, first_line: int, block: bytes) -> bytes:
        """Line ends without carriage returns; of two or more the first is taken note of."""
        if b"\r" not in block:
            return block
        at = block.find(b"\r\r\n")
        if at >= 0 and self._returns_line is None:
            self._returns_line = first_line + block.count(b"\n", 0, at)
        return _LINE_END.sub(b"\n", block)

    def _complete(self, block: bytes, starts: Lines, ends: Lines, lines: Lines) -> NDArray[np.bool_]:
        """Lines of text with as many cells as the header; empty lines and comments are neither rows nor broken."""
        codes = np.frombuffer(block, dtype=np.uint8)
        marks, control = codes == ord(self._separator), (codes < ord(" ")) & (codes != ord("\n")) & (codes != ord("\t"))
        quotes = np.zeros(len(lines), dtype=np.int64)
        if b'"' in block:  # a separator in quotes is none
            count = np.cumsum(codes == ord('"'))
            before = np.where(starts > 0, count[starts - 1], 0)
            quotes = count[ends] - before
            marks &= (count - np.repeat(before, ends - starts + 1)) % 2 == 0
        cells = np.add.reduceat(marks, starts, dtype=np.int64) + 1
        strange = np.add.reduceat(control, starts, dtype=np.int64) > 0
        good: NDArray[np.bool_] = (cells == len(self._header)) & ~strange & (quotes % 2 == 0)
        good &= codes[starts] != ord(_COMMENT)
        for i in np.flatnonzero(~good):
            if not (text := block[starts[i] : ends[i]].strip(b" \t")) or text.startswith(_COMMENT):
                continue
            if strange[i]:
                reason = "a control character or a carriage return within the line"
            elif quotes[i] % 2:
                reason = "a quotation mark without its other one"
            else:
                reason = f"{cells[i]} cells where the header has {len(self._header)}"
            self.broken.add(int(lines[i]), reason)
        return good

    def _numbers(self, block: bytes, count: int) -> dict[str, Floats]:
        """The log's columns out of whole lines, SI; ValueError where a cell is no number."""
        if count == 0:
            return {name: np.empty(0) for name in self.columns}
        import pandas as pd

        frame = pd.read_csv(
            io.BytesIO(block),
            sep=self._separator,
            decimal=self._decimal(block),
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

    def _decimal(self, block: bytes) -> str:
        """The decimal mark of a block: a comma where it separates no cells and is more frequent than the point."""
        return "," if self._separator != "," and block.count(b",") > block.count(b".") else "."

    def _line_by_line(self, block: bytes, lines: Lines) -> tuple[Lines, dict[str, Floats]]:
        """As `_numbers`, each line by itself: those with a cell that is no number are named and left out."""
        decimal, kept, rows = self._decimal(block), [], []
        for line, text in zip(lines.tolist(), block.decode("latin-1").split("\n"), strict=False):
            found = self._row(text, decimal)
            if isinstance(found, str):
                self.broken.add(line, found)
            else:
                kept.append(line)
                rows.append(found)
        table = np.array(rows, dtype=np.float64).reshape(-1, len(self.columns))
        values = {name: c.factor * table[:, i] for i, (name, c) in enumerate(self.columns.items())}
        return np.array(kept, dtype=np.int64), values

    def _row(self, text: str, decimal: str) -> list[float] | str:
        """The log's columns of a line, as they stand; or what is wrong with it."""
        cells, values = _cells(text, self._separator), []
        if cells is None or len(cells) != len(self._header):
            return "quotation marks within a cell"
        for column in self.columns.values():
            cell = cells[column.index].strip()
            if cell and not _is_number(cell, decimal):
                return f"{shown(cell)} is not a number, column {column.header!r}"
            values.append(float(cell.replace(decimal, ".")) if cell else np.nan)
        return values


_LINE_END = re.compile(rb"\r+\n")


def _cells(text: str, separator: str) -> list[str] | None:
    """The cells of a line; None where quotation marks are not as CSV has them."""
    try:
        return next(csv.reader([text], delimiter=separator, strict=True), [])
    except csv.Error:
        return None


def _head(path: Path, name: str) -> tuple[bytes, int, int]:
    """The header; the number of the line after it, and the bytes before that line."""
    try:
        usable, lines = path.is_file(), []
        if usable:
            with path.open("rb") as file:
                lines = _first_lines(file)
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        raise InputError(f"{name}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    if not usable:  # nor a pipe, which may never end
        reason = "is a directory" if path.is_dir() else "no such file" if not path.exists() else "is not a regular file"
        raise InputError(f"{name}: {reason}; give a CSV file")
    if not lines or _passed_over(lines[-1]):
        raise InputError(f"{name}: the file is empty or has no header; give a CSV file with a header")
    if not lines[-1].endswith(b"\n"):
        ends = "; lines must end in \\n, not in \\r" if b"\r" in lines[-1] else ""
        raise InputError(f"{name}: nothing after line {len(lines)}; give a CSV file with a header and rows{ends}")
    return lines[-1], len(lines) + 1, sum(map(len, lines))


def _first_lines(file: BinaryIO) -> list[bytes]:
    """The lines up to the header, the first that is neither empty nor a comment."""
    lines: list[bytes] = []
    while sum(map(len, lines)) < _LONGEST_HEADER and (line := file.readline(_LONGEST_HEADER)):
        lines.append(line)
        if not _passed_over(line):
            break
    return lines


def _passed_over(line: bytes) -> bool:
    text = line.removeprefix(codecs.BOM_UTF8).strip()
    return not text or text.startswith(_COMMENT)


def _decoded(head: bytes, name: str) -> str:
    if b"\0" in head:
        raise InputError(f"{name}: not a text file in UTF-8 or Latin-1; save it as CSV in UTF-8")
    try:
        return head.decode("utf-8-sig")
    except UnicodeDecodeError:
        return head.decode("latin-1")


def _is_number(text: str, decimal: str) -> bool:
    if "_" in text:  # Python's digits, no log's
        return False
    try:
        float(text.strip().replace(decimal, "."))
    except ValueError:
        return False
    return True


def _without(block: bytes, starts: Lines, ends: Lines, good: NDArray[np.bool_]) -> bytes:
    kept = zip(starts[good], ends[good], strict=True)
    return b"".join(block[start : end + 1] for start, end in kept)


def _check_growing(lines: Lines, time: Floats, name: str) -> None:
    steps = np.diff(time)
    if (steps > 0.0).all():
        return
    at = int(np.argmin(steps > 0.0)) + 1
    sound = int(np.searchsorted(time[:at], time[at]))  # stamps before it that are less
    if 0 < sound < at and time[sound] - time[sound - 1] > _JUMP * (time[at] - time[sound - 1]):
        raise InputError(
            f"{name}: line {lines[sound]}: time jumps from {time[sound - 1]:.9g} s to {time[sound]:.9g} s, "
            f"but line {lines[at]} has {time[at]:.9g} s; give times that grow"
        )
    kind = "repeats" if steps[at - 1] == 0.0 else "goes back from"
    raise InputError(
        f"{name}: line {lines[at]}: time {time[at]:.9g} s {kind} {time[at - 1]:.9g} s; give times that grow"
    )
