"""Reading a log: CSV with a header, in blocks of lines, so that memory does not grow with the file.

Every row keeps the number of its line. A line that is no row (cut, or with something else than numbers) is left out
and named; a line without a line end at the end of the file is taken to be cut, unless it has all its cells. Empty lines
and comments, which begin with #, are passed over. A column that can be done without and is empty is as if absent.
"""

from __future__ import annotations

import io
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import shown

from .columns import UNITS
from .header import BLANKS, COMMENT, is_number, read_header, split_cells
from .log_files import LogFile
from .rows import Floats, Lines, Rows
from .stamps import StampFilter

BLOCK_BYTES = 4 << 20
"""Bytes read at a time; a block and the numbers in it take some 30 MB."""

LONGEST_LINE = 1 << 20
"""Bytes of a line, beyond which it is no row whatever it holds: a file without line ends takes no more memory."""

# s, some 3000 years: what counts from 1970 in seconds is below, in milliseconds above. Beyond, a double does not tell
# neighbouring rows apart.
_LATEST = 1e11

_MOST_NAMED = 5
_FIRST_ROWS = 1000  # that tell whether a column is empty; so many, and no more, wait in memory for it
_EMPTY = ("", "nan")
_DATE = re.compile(r"\d{4}-\d{1,2}-\d{1,2}|\d{1,2}[./]\d{1,2}[./]\d{2,4}|\d{1,2}:\d{2}")
_PIECE = 1000  # lines that are parsed one by one where one of them is no row


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
        CSV; UTF-8, Latin-1, or UTF-16 with its byte order mark; gzipped or not; or `-`, standard input. Separated by
        commas, semicolons, tabs or blanks; a decimal comma is understood where no comma separates.
    columns, units : mapping, optional
        See `columns.find_columns`.
    block_bytes : int
        How much is read at a time.

    Raises
    ------
    InputError
        One line with the file and what is wrong: missing, empty, no header, a column or a unit; while reading also
        time stamps that do not grow (`StampFilter`), and a file without a single row.
    """

    def __init__(
        self,
        path: Path,
        *,
        columns: Mapping[str, str] | None = None,
        units: Mapping[str, str] | None = None,
        block_bytes: int = BLOCK_BYTES,
    ) -> None:
        self._file = LogFile(path)
        self.name = self._file.name
        self.broken = Broken()
        self.stamps = StampFilter(self.name)
        self._returns_line: int | None = None
        self._block_bytes = block_bytes
        try:
            self._header = read_header(self._file, columns, units)
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
        return (*notes, *self._notes)

    def rows(self) -> Iterator[Rows]:
        """The rows, block by block; `broken`, `stamps` and `share` say at any time what was met."""
        any_row = False
        try:
            for first_line, block in self._begun(self._blocks()):
                rows = self.stamps.add(self._parsed(first_line, block))
                any_row = any_row or bool(len(rows))
                if len(rows):
                    yield rows
        finally:
            self._file.close()
        rest = self.stamps.finish()
        if rest is not None and len(rest):
            yield rest
        elif not any_row:
            broken = f"; {self.broken.first[0]}" if self.broken.count else ""
            raise InputError(f"{self.name}: no rows after the header{broken}; give a log with data")

    def _blocks(self) -> Iterator[tuple[int, bytes]]:
        """Whole lines, with the number of the first."""
        line, rest = self._header.next_line, self._header.pending
        while read := self._file.read(self._block_bytes):
            block, rest = _parted(rest + read)
            if block:
                yield line, block
                line += block.count(b"\n")
            if len(rest) > LONGEST_LINE:
                self.broken.add(line, f"more than {LONGEST_LINE} bytes without a line end, which count as one line")
                line, rest = line + 1, self._after_the_line()
        block, rest = _parted(rest)
        if block:
            yield line, block
            line += block.count(b"\n")
        if self._file.damage:
            self.broken.add(line, f"the gzipped file {self._file.damage}")
        elif rest.strip() and (ended := self._ended(line, rest)):
            yield line, ended
        elif rest.strip():
            self.broken.add(line, "the file ends within this line, which is left out")

    def _begun(self, blocks: Iterator[tuple[int, bytes]]) -> Iterator[tuple[int, bytes]]:
        """The blocks, given out once the first rows have told which columns are empty."""
        held: list[tuple[int, bytes]] = []
        ends = size = 0
        while ends < _FIRST_ROWS and size < BLOCK_BYTES and (more := next(blocks, None)):
            held.append(more)
            ends, size = ends + more[1].count(b"\n"), size + len(more[1])
        if held:
            self._leave_out_empty(held[0][0], b"".join(block for _, block in held))
        yield from held
        yield from blocks

    def _leave_out_empty(self, first_line: int, block: bytes) -> None:
        """Columns that can be done without and are empty in the first rows are none."""
        lines = block.split(b"\n", _FIRST_ROWS)[:_FIRST_ROWS]
        text = self._with_plain_ends(first_line, b"\n".join(lines)).decode("latin-1")
        rows = [
            cells
            for line in text.split("\n")
            if line.strip()
            and not line.startswith(COMMENT.decode())
            and (cells := split_cells(line, self._separator))
            and len(cells) >= len(self._header.cells)
        ]
        for name, instead in _DISPENSABLE.items():
            column = self.columns.get(name)
            needed = name != "wheel_load" and len({*_WHEEL} & self.columns.keys()) < len(_WHEEL)
            if column is None or needed or not rows:
                continue
            if all(row[column.index].strip().lower() in _EMPTY for row in rows):
                del self.columns[name]
                self._notes.append(
                    f"column {column.header!r} is empty in {len(rows)} rows, all or the first of the log, "
                    f"and taken as absent: {instead}"
                )

    def _ended(self, line: int, rest: bytes) -> bytes:
        """The last line, which has no end, with one; nothing where it is cut."""
        whole = self._with_plain_ends(line, rest + b"\n")
        text, count = whole.decode("latin-1").strip("\n"), self._count or len(self._header.cells)
        cells = split_cells(text, self._separator) or []
        decimal = self._decimal(whole)
        if len(cells) != count or not all(is_number(cells[c.index], decimal) for c in self.columns.values()):
            return b""
        self._notes.append(f"the file ends without a line end: line {line} has all its cells, and is read")
        return rest + b"\n"

    def _after_the_line(self) -> bytes:
        """What has been read after the end of the line that is being read; nothing if the file ends in it."""
        while read := self._file.read(self._block_bytes):
            if cut := read.find(b"\n") + 1:
                return read[cut:]
        return b""

    def _parsed(self, first_line: int, block: bytes) -> Rows:
        block = self._with_plain_ends(first_line, block)
        codes = np.frombuffer(block, dtype=np.uint8)
        ends = np.flatnonzero(codes == ord("\n"))
        starts = np.concatenate([[0], ends[:-1] + 1])
        lines = np.arange(first_line, first_line + len(ends))
        good = self._complete(block, starts, ends, lines)
        if not good.all():
            block, lines = _without(block, starts, ends, good), lines[good]
        decimal = self._decimal(block)
        try:
            values = self._numbers(block, len(lines), decimal)
        except ValueError:
            lines, values = self._piece_by_piece(block, lines, decimal)
        finite = np.asarray(np.isfinite(np.stack(list(values.values()))).all(axis=0))
        for line in lines[~finite]:
            self.broken.add(int(line), "a value is missing or not finite")
        possible = finite & (np.abs(values["time"]) <= _LATEST)
        for at in np.flatnonzero(finite & ~possible):
            self.broken.add(int(lines[at]), f"time {values['time'][at]:.9g} s is beyond any clock; check its unit")
        return Rows(lines, values).where(possible)

    def _with_plain_ends(self, first_line: int, block: bytes) -> bytes:
        """Line ends without carriage returns, of which two or more are taken note of; blanks that separate as tabs."""
        if b"\r" in block:
            at = block.find(b"\r\r\n")
            if at >= 0 and self._returns_line is None:
                self._returns_line = first_line + block.count(b"\n", 0, at)
            block = _LINE_END.sub(b"\n", block)
        return _OUTER_TABS.sub(b"", _BLANKS.sub(b"\t", block)) if self._header.separator == BLANKS else block

    def _complete(self, block: bytes, starts: Lines, ends: Lines, lines: Lines) -> NDArray[np.bool_]:
        """Lines of text with as many cells as the header; empty lines and comments are neither rows nor broken."""
        codes = np.frombuffer(block, dtype=np.uint8)
        marks = codes == ord(self._separator)
        quotes = np.zeros(len(lines), dtype=np.int64)
        if b'"' in block:  # a separator in quotes is none
            quotes = _count_in(codes == ord('"'), starts, ends)
            opened = np.cumsum(codes == ord('"'), dtype=np.int32)
            opened -= np.repeat((np.cumsum(quotes) - quotes).astype(np.int32), ends - starts + 1)
            marks &= opened % 2 == 0
        cells = _count_in(marks, starts, ends) + 1
        strange = _count_in(_STRANGE[codes], starts, ends) > 0
        last = (ends > starts) & marks[ends - 1]
        if not self._count:
            self._count = self._usual_count(cells, last)
        good: NDArray[np.bool_] = (cells == self._count) & ~strange & (quotes % 2 == 0)
        if self._count > len(self._header.cells):
            good &= last
        good &= codes[starts] != ord(COMMENT)
        for i in np.flatnonzero(~good):
            if not (text := block[starts[i] : ends[i]].strip(b" \t")) or text.startswith(COMMENT):
                continue
            if strange[i]:
                reason = _control_character(block[starts[i] : ends[i]])
            elif quotes[i] % 2:
                reason = "a quotation mark without its other one"
            else:
                reason = f"{cells[i]} cells where the header has {len(self._header.cells)}"
            self.broken.add(int(lines[i]), reason)
        return good

    def _usual_count(self, cells: Lines, last: NDArray[np.bool_]) -> int:
        """Cells of a row: the header's, but rows may end in one separator more, or without its last empty cells.

        The rows of the first block tell, 0 if it has none; `last` is where a line ends in a separator.
        """
        most = len(self._header.cells)
        least = max((i for i, cell in enumerate(self._header.cells, 1) if cell.strip()), default=most)
        found = Counter(cells[((cells >= least) & (cells <= most)) | ((cells == most + 1) & last)].tolist())
        return found.most_common(1)[0][0] if found else 0

    def _numbers(self, block: bytes, count: int, decimal: str) -> dict[str, Floats]:
        """The log's columns out of whole lines, SI; ValueError where a cell is no number."""
        if count == 0:
            return {name: np.empty(0) for name in self.columns}
        import pandas as pd

        frame = pd.read_csv(
            io.BytesIO(block),
            sep=self._separator,
            decimal=decimal,
            header=None,
            names=list(range(self._count)),
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

    def _piece_by_piece(self, block: bytes, lines: Lines, decimal: str) -> tuple[Lines, dict[str, Floats]]:
        """As `_numbers`, in pieces: those with a cell that is no number are gone through line by line."""
        texts = block.split(b"\n")
        pieces = []
        for first in range(0, len(lines), _PIECE):
            numbers, part = lines[first : first + _PIECE], texts[first : first + _PIECE]
            try:
                pieces.append(
                    Rows(numbers, self._numbers(b"\n".join([*part[: len(numbers)], b""]), len(numbers), decimal))
                )
            except ValueError:
                pieces.append(self._line_by_line(part, numbers, decimal))
        whole = Rows(
            np.concatenate([piece.line for piece in pieces]),
            {name: np.concatenate([piece.columns[name] for piece in pieces]) for name in self.columns},
        )
        return whole.line, whole.columns

    def _line_by_line(self, texts: Sequence[bytes], lines: Lines, decimal: str) -> Rows:
        """Each line by itself: those with a cell that is no number are named and left out."""
        kept, rows = [], []
        for line, text in zip(lines.tolist(), texts, strict=False):
            found = self._row(text.decode("latin-1"), decimal)
            if isinstance(found, str):
                self.broken.add(line, found)
            else:
                kept.append(line)
                rows.append(found)
        table = np.array(rows, dtype=np.float64).reshape(-1, len(self.columns))
        values = {name: c.factor * table[:, i] for i, (name, c) in enumerate(self.columns.items())}
        return Rows(np.array(kept, dtype=np.int64), values)

    def _row(self, text: str, decimal: str) -> list[float] | str:
        """The log's columns of a line, as they stand; or what is wrong with it."""
        cells, values = split_cells(text, self._separator), []
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
    if nulls < _MANY_NULLS:
        return "a control character or a carriage return within the line"
    return f"a control character, {nulls} null bytes, which may stand for many rows and count as one line"


_WHEEL = ("wheel_angular_speed", "wheel_speed")
_DISPENSABLE = {
    "wheel_load": "the vehicle's wheel load is used",
    "wheel_speed": "the wheel's angular speed is used",
    "wheel_angular_speed": "the wheel speed is used",
}
_MANY_NULLS = 2
_STRANGE = np.array([code < ord(" ") and chr(code) not in "\t\n" for code in range(256)])
_LINE_END = re.compile(rb"\r+\n")
_BLANKS = re.compile(rb"[ \t]+")
_OUTER_TABS = re.compile(rb"^\t|\t$", re.MULTILINE)


def _count_in(marks: NDArray[np.bool_], starts: Lines, ends: Lines) -> Lines:
    """How many marks each line has, given where it starts and ends."""
    at = np.flatnonzero(marks)
    return np.searchsorted(at, ends) - np.searchsorted(at, starts)


def _parted(text: bytes) -> tuple[bytes, bytes]:
    """Whole lines, and what is after them."""
    cut = text.rfind(b"\n") + 1
    return text[:cut], text[cut:]


def _without(block: bytes, starts: Lines, ends: Lines, good: NDArray[np.bool_]) -> bytes:
    kept = zip(starts[good], ends[good], strict=True)
    return b"".join(block[start : end + 1] for start, end in kept)
