"""Reading a log: CSV with a header, in blocks of lines, so that memory does not grow with the file.

Every row keeps the number of its line. A line that is no row (cut, or with something else than numbers) is left out and
named; a line without a line end at the end of the file is taken to be cut, unless it has all its cells. A column that
can be done without and is empty is as if absent.
"""

from __future__ import annotations

import gzip
import io
import os
import re
import stat
import sys
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core import extras
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import shown
from railslip_ctrl.core.user_files import file_name

from .columns import BLANKS, COMMENT, UNITS, is_number, read_header, split_cells

Floats = NDArray[np.float64]
Lines = NDArray[np.int64]

BLOCK_BYTES = 4 << 20
"""Bytes read at a time; a block and the numbers in it take some 30 MB."""

LONGEST_LINE = 1 << 20
"""Bytes of a line, beyond which it is no row whatever it holds: a file without line ends takes no more memory."""

STANDARD_INPUT = "-"
"""The path that stands for standard input."""


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


# --- the file ------------------------------------------------------------------------------------------------------

_GZIP = b"\x1f\x8b"
_OTHER_FORMATS = {
    b"PK\x03\x04": "a ZIP archive or an Excel workbook",
    b"\xd0\xcf\x11\xe0": "an Excel workbook",
    b"BZh": "packed with bzip2",
    b"MDF ": "an MDF recording",
}


class LogFile:
    """A log's bytes from its beginning, read once, unpacked where it is gzipped.

    `path` is a regular file or `STANDARD_INPUT`. InputError for a file that is missing, not regular, unreadable or of a
    format that is no text; `damage` says what ended a gzipped file before its end.
    """

    def __init__(self, path: Path) -> None:
        standard = str(path) == STANDARD_INPUT
        self.name = "standard input" if standard else file_name(path)
        self.damage = ""
        self._position = 0
        try:
            raw = _standard_input(self.name) if standard else _regular(path, self.name)
        except (OSError, ValueError) as error:  # ValueError: a null character in the path
            raise error if isinstance(error, InputError) else self._unreadable(error) from None
        self._raw = io.BufferedReader(raw)
        self._size = 0 if standard else os.fstat(raw.fileno()).st_size
        self._file: Any = self._raw
        try:
            if self._tried(self._raw.peek, 8).startswith(_GZIP):
                self._file = gzip.GzipFile(fileobj=self._raw)
            beginning = self._tried(self._file.peek, 8)
            for magic, what in _OTHER_FORMATS.items():
                if beginning.startswith(magic):
                    raise InputError(f"{self.name}: is {what}; give a CSV file, gzipped or not")
        except InputError:
            self._raw.close()
            raise

    def read(self, count: int) -> bytes:
        """That many bytes; less only at the end."""
        parts, missing = [], count
        while missing > 0 and (part := self._tried(self._file.read1, missing)):
            parts.append(part)
            missing -= len(part)
        self._position = self._raw.tell() if self._size else 0
        return b"".join(parts)

    def readline(self, longest: int) -> bytes:
        """A line with its end, or as much of it as allowed."""
        return self._tried(self._file.readline, longest)

    @property
    def share(self) -> float:
        """Of the file, what has been read, 0 to 1; 0 of standard input, whose end is not known."""
        return self._position / self._size if self._size else 0.0

    def close(self) -> None:
        """Close the file; standard input stays open."""
        self._file.close()
        self._raw.close()

    def _tried(self, method: Callable[[int], bytes], count: int) -> bytes:
        try:
            return b"" if self.damage else method(count)
        except EOFError:
            self.damage = "ends early: the lines from here on are lost"
        except zlib.error as error:
            self.damage = f"is damaged ({error}): the lines from here on are lost"
        except gzip.BadGzipFile as error:  # found at its end
            self.damage = f"is damaged ({error}): a line before may be wrong"
        except OSError as error:
            raise self._unreadable(error) from None
        return b""

    def _unreadable(self, error: Exception) -> InputError:
        return InputError(f"{self.name}: cannot be read ({getattr(error, 'strerror', None) or error})")


def _standard_input(name: str) -> io.FileIO:
    if sys.stdin is None:
        raise InputError(f"{name}: is closed; give a CSV file, or pipe one in")
    return io.FileIO(sys.stdin.fileno(), closefd=False)


def _regular(path: Path, name: str) -> io.FileIO:
    """A regular file, opened; nothing else, as a pipe may never end, nor even begin."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise InputError(f"{name}: no such file; give a CSV file") from None
    if not stat.S_ISREG(mode):
        reason = "is a directory" if stat.S_ISDIR(mode) else "is not a regular file"
        raise InputError(f"{name}: {reason}; give a CSV file, or - for standard input")
    return io.FileIO(path)


# --- the rows ------------------------------------------------------------------------------------------------------

# s, some 3000 years: what counts from 1970 in seconds is below, in milliseconds above. Beyond, a double does not tell
# neighbouring rows apart.
_LATEST = 1e11

_MOST_NAMED = 5
_FIRST_ROWS = 1000  # that tell whether a column is empty; so many, and no more, wait in memory for it
_EMPTY = ("", "nan")
_DATE = re.compile(r"\d{4}-\d{1,2}-\d{1,2}|\d{1,2}[./]\d{1,2}[./]\d{2,4}|\d{1,2}:\d{2}")
_PIECE = 1000  # lines that are parsed one by one where one of them is no row
_WHEEL = ("wheel_angular_speed", "wheel_speed")
_DISPENSABLE = {
    "wheel_load": "the vehicle's wheel load is used",
    "wheel_speed": "the wheel's angular speed is used",
    "wheel_angular_speed": "the wheel speed is used",
}
_STRANGE = re.compile(rb"[\0-\x08\x0b-\x1f]")
_QUOTED = re.compile(rb'"[^"]*"')
_BLANKS = re.compile(rb"[ \t]+")
_OUTER_TABS = re.compile(rb"^\t|\t$", re.MULTILINE)


@dataclass
class Broken:
    """The lines that were no rows: how many, the first of them with what was wrong, and the last."""

    count: int = 0
    last: int = 0
    named: list[tuple[int, str]] = field(default_factory=list)

    def add(self, line: int, reason: str) -> None:
        """Take note of a line."""
        self.count += 1
        self.last = max(self.last, line)
        if len(self.named) < _MOST_NAMED:
            self.named.append((line, reason))

    @property
    def first(self) -> tuple[str, ...]:
        """The lines named, in order, a sentence each."""
        return tuple(f"line {line}: {reason}" for line, reason in sorted(self.named))


class Log:
    """A log opened for reading, once.

    Parameters
    ----------
    path : Path
        CSV in UTF-8 or Latin-1, gzipped or not; or `-`, standard input. Separated by commas, semicolons, tabs or
        blanks; a decimal comma is understood where no comma separates.
    columns, units : mapping, optional
        See `find_columns`.
    block_bytes : int
        How much is read at a time.

    Raises
    ------
    InputError
        One line with the file and what is wrong: missing, empty, no header, a column or a unit; while reading also a
        file without a single row.
    """

    def __init__(
        self,
        path: Path,
        *,
        columns: Mapping[str, str] | None = None,
        units: Mapping[str, str] | None = None,
        block_bytes: int = BLOCK_BYTES,
    ) -> None:
        extras.check_extra("identify", "identify")
        self._file = LogFile(path)
        self.name = self._file.name
        self.broken = Broken()
        self._block_bytes = block_bytes
        try:
            self._header = read_header(self._file.readline, self.name, columns, units)
        except InputError:
            self._file.close()
            raise
        self.columns = dict(self._header.columns)
        self._notes: list[str] = []
        self._separator = "\t" if self._header.separator == BLANKS else self._header.separator
        self._count = 0  # of a row's cells, known once there are rows

    @property
    def share(self) -> float:
        """How much of the file has been read, 0 to 1; 0 where its size is not known."""
        return self._file.share

    def close(self) -> None:
        """Close the file; its rows do so at their end."""
        self._file.close()

    @property
    def notes(self) -> tuple[str, ...]:
        """What was assumed about the columns."""
        assumed = [c for c in self.columns.values() if not c.unit_given]
        notes = [f"column {c.header!r} names no unit: {UNITS[c.quantity]} is taken for {c.quantity}" for c in assumed]
        if {*_WHEEL} <= self.columns.keys():
            notes.append("the log has both speeds of the wheel: the angular one is used")
        return (*notes, *self._notes)

    def rows(self) -> Iterator[Rows]:
        """The rows, block by block; `broken` and `share` say at any time what was met."""
        any_row = False
        try:
            for first, block in self._begun(self._blocks()):
                rows = self._parsed(first, block)
                any_row = any_row or bool(len(rows))
                yield rows
        finally:
            self._file.close()
        if not any_row:
            broken = f"; {self.broken.first[0]}" if self.broken.count else ""
            raise InputError(f"{self.name}: no rows after the header{broken}; give a log with data")

    # --- blocks of lines --------------------------------------------------------------------------------------------

    def _blocks(self) -> Iterator[tuple[int, bytes]]:
        """Whole lines, with the number of the first."""
        line, rest = self._header.next_line, self._header.pending
        while read := self._file.read(self._block_bytes):
            block, end, rest = (rest + read).rpartition(b"\n")
            if end:
                yield line, self._plain(block + end)
                line += block.count(b"\n") + 1
            if len(rest) > LONGEST_LINE:
                self.broken.add(line, f"more than {LONGEST_LINE} bytes without a line end, which count as one line")
                line, rest = line + 1, self._after_the_line()
        block, end, rest = rest.rpartition(b"\n")  # a header's next line alone, or what is after a long line
        if end:
            yield line, self._plain(block + end)
            line += block.count(b"\n") + 1
        if self._file.damage:
            self.broken.add(line, f"the gzipped file {self._file.damage}")
        elif rest.strip():
            last = self._plain(rest + b"\n")
            self._count = self._count or len(self._header.cells)
            row = self._row(last[:-1], self._has_comma(last))
            if isinstance(row, str) or not np.isfinite(row).all():
                self.broken.add(line, "the file ends within this line, which is left out")
            else:
                self._notes.append(f"the file ends without a line end: line {line} has all its cells, and is read")
                yield line, last

    def _after_the_line(self) -> bytes:
        """What has been read after the end of the line that is being read; nothing if the file ends in it."""
        while read := self._file.read(self._block_bytes):
            if cut := read.find(b"\n") + 1:
                return read[cut:]
        return b""

    def _plain(self, block: bytes) -> bytes:
        """Lines that end in a line feed alone, with tabs for blanks that separate."""
        block = block.replace(b"\r\n", b"\n")
        return _OUTER_TABS.sub(b"", _BLANKS.sub(b"\t", block)) if self._header.separator == BLANKS else block

    def _begun(self, blocks: Iterator[tuple[int, bytes]]) -> Iterator[tuple[int, bytes]]:
        """The blocks, given out once the first rows have told which columns are empty."""
        held: list[tuple[int, bytes]] = []
        ends = size = 0
        while ends < _FIRST_ROWS and size < BLOCK_BYTES and (more := next(blocks, None)):
            held.append(more)
            ends, size = ends + more[1].count(b"\n"), size + len(more[1])
        self._leave_out_empty(b"".join(block for _, block in held).split(b"\n", _FIRST_ROWS)[:_FIRST_ROWS])
        yield from held
        yield from blocks

    def _leave_out_empty(self, lines: Sequence[bytes]) -> None:
        """Columns that can be done without and are empty in the first rows are none."""
        found = (self._cells(line) for line in lines if line.strip() and not line.startswith(COMMENT))
        rows = [cells for cells in found if cells and len(cells) >= len(self._header.cells)]
        for name, instead in _DISPENSABLE.items():
            column = self.columns.get(name)
            needed = name in _WHEEL and len({*_WHEEL} & self.columns.keys()) < len(_WHEEL)
            if column is None or needed or not rows:
                continue
            if all(row[column.index].strip().lower() in _EMPTY for row in rows):
                del self.columns[name]
                self._notes.append(
                    f"column {column.header!r} is empty in {len(rows)} rows, all or the first of the log, "
                    f"and taken as absent: {instead}"
                )

    # --- from lines to numbers --------------------------------------------------------------------------------------

    def _parsed(self, first: int, block: bytes) -> Rows:
        """The rows of whole lines; the others are taken note of."""
        lines = block.split(b"\n")[:-1]
        self._count = self._count or self._usual_count(lines)
        usual, separator = self._count - 1, self._separator.encode()
        plain = b'"' not in block and not _STRANGE.search(block) and self._count <= len(self._header.cells)
        good = []
        for i, line in enumerate(lines):
            fault = "" if plain and line.count(separator) == usual else self._fault(line)
            if not fault and line[:1] != COMMENT:
                good.append(i)
            elif (text := line.strip(b" \t")) and text[:1] != COMMENT:
                self.broken.add(first + i, fault)
        comma = self._has_comma(block)
        number, table = self._numbers(np.array(good, dtype=np.int64) + first, [lines[i] for i in good], comma)
        values = {name: column.factor * table[:, i] for i, (name, column) in enumerate(self.columns.items())}
        finite = np.asarray(np.isfinite(table).all(axis=1))
        for at in number[~finite]:
            self.broken.add(int(at), "a value is missing or not finite")
        possible = finite & (np.abs(values["time"]) <= _LATEST)
        for at in np.flatnonzero(finite & ~possible):
            self.broken.add(int(number[at]), f"time {values['time'][at]:.9g} s is beyond any clock; check its unit")
        return Rows(number, values).where(possible)

    def _usual_count(self, lines: Sequence[bytes]) -> int:
        """Cells of a row: the header's, but rows may end in one separator more, or without its last empty cells.

        The rows of the first block tell; 0 if it has none.
        """
        most, separator = len(self._header.cells), self._separator.encode()
        least = max((i for i, cell in enumerate(self._header.cells, 1) if cell.strip()), default=most)
        counts = Counter((len(self._cells(line) or ()), line.endswith(separator)) for line in lines[:_FIRST_ROWS])
        usual = [count for (count, ends), _ in counts.most_common() if least <= count <= most + (1 if ends else 0)]
        return usual[0] if usual else 0

    def _fault(self, line: bytes) -> str:
        """What is wrong with a line that should be a row; empty for one with the usual cells."""
        if _STRANGE.search(line):
            return _control_character(line)
        line = _QUOTED.sub(b"", line)  # a separator in quotes is none
        if b'"' in line:
            return "a quotation mark without its other one"
        separator, own = self._separator.encode(), len(self._header.cells)
        count = line.count(separator) + 1
        whole = count == self._count and (count <= own or line.endswith(separator))
        return "" if whole else f"{count} cells where the header has {own}"

    def _numbers(self, line: Lines, texts: Sequence[bytes], comma: bool) -> tuple[Lines, Floats]:
        """The columns of rows in the file's units, (rows, columns), with the numbers of the lines that are rows.

        Where a cell is no number they are gone through in pieces, and the piece that it is in line by line.
        """
        try:
            return line, self._table(texts, comma)
        except ValueError:
            pass
        if len(texts) > _PIECE:
            starts = range(0, len(texts), _PIECE)
            pieces = [self._numbers(line[i : i + _PIECE], texts[i : i + _PIECE], comma) for i in starts]
            return np.concatenate([piece[0] for piece in pieces]), np.concatenate([piece[1] for piece in pieces])
        kept, rows = [], []
        for number, text in zip(line.tolist(), texts, strict=True):
            row = self._row(text, comma)
            if isinstance(row, str):
                self.broken.add(number, row)
            else:
                kept.append(number)
                rows.append(row)
        return np.array(kept, dtype=np.int64), np.array(rows, dtype=np.float64).reshape(-1, len(self.columns))

    def _table(self, texts: Sequence[bytes], comma: bool) -> Floats:
        """The columns of rows, (rows, columns); ValueError where a cell is no number."""
        if not texts:
            return np.empty((0, len(self.columns)))
        import pandas as pd

        places = [column.index for column in self.columns.values()]
        frame = pd.read_csv(
            io.BytesIO(b"\n".join(texts)),
            sep=self._separator,
            decimal="," if comma else ".",
            header=None,
            names=list(range(self._count)),
            usecols=places,
            dtype=np.float64,
            index_col=False,
            skip_blank_lines=False,
            encoding="latin-1",
        )
        if len(frame) != len(texts):
            raise ValueError("rows")
        return np.asarray(frame[places].to_numpy())

    def _has_comma(self, block: bytes) -> bool:
        """Whether the decimal mark is a comma: it separates no cells and is more frequent than the point."""
        return self._separator != "," and block.count(b",") > block.count(b".")

    def _cells(self, line: bytes) -> list[str] | None:
        return split_cells(line.decode("latin-1"), self._separator)

    def _row(self, line: bytes, comma: bool) -> list[float] | str:
        """The log's columns of a line, as they stand; or what is wrong with it."""
        cells, values, decimal = self._cells(line), [], "," if comma else "."
        if cells is None or len(cells) != self._count:
            return "quotation marks within a cell"
        for column in self.columns.values():
            cell = cells[column.index].strip()
            if cell and not is_number(cell, decimal):
                if column.quantity == "time" and _DATE.match(cell):
                    return (
                        f"{shown(cell)} is a date or a time of day, not a number, column {column.header!r}; give the "
                        "time in s, from any beginning, or in another unit that the header names"
                    )
                return f"{shown(cell)} is not a number, column {column.header!r}"
            values.append(float(cell.replace(decimal, ".")) if cell else np.nan)
        return values


def _control_character(line: bytes) -> str:
    """What is said of a line with one: nulls, as a power cut leaves them, may stand for many rows, and end no line."""
    nulls = line.count(b"\0")
    if nulls < 2:
        return "a control character or a carriage return within the line"
    return f"a control character, {nulls} null bytes, which may stand for many rows and count as one line"
