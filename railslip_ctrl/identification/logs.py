"""Reading a log: CSV with a header, in blocks of lines, so that memory does not grow with the file.

A header cell is a name with or without a unit: "train speed [km/h]", "Wheel speed (km/h)", "brake_torque_kNm"; case,
spaces, underscores and hyphens do not count. `NAMES` lists the names. The unit decides what `n` means; without one it
is the wheel load. A wheel speed in rad/s, rpm or the like is an angular one. Time, train speed, brake torque and one of
the wheel's two speeds must be there; other columns are not read.

The header is the first line that is neither empty nor a comment (#). Where that line has numbers already, it is the
last comment above it that names the columns, as NumPy writes it. A line of units may follow it.

Every row keeps the number of its line. A line that is no row (cut, or with something else than numbers) is left out and
named; a line without a line end at the end of the file is taken to be cut, unless it has all its cells. A column that
can be done without and is empty is as if absent.
"""

from __future__ import annotations

import codecs
import csv
import gzip
import io
import itertools
import os
import re
import stat
import sys
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from railslip_ctrl.core.arguments import Flags, Floats, Integers
from railslip_ctrl.core.errors import InputError, check_extra
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.templates import texts
from railslip_ctrl.core.units import shown, to_unit
from railslip_ctrl.core.user_files import close_match, file_name

Lines = Integers

BLOCK_BYTES = 4 << 20  #: bytes read at a time; a block and the numbers in it take some 30 MB

LONGEST_LINE = 1 << 20
"""Bytes of a line, beyond which it is no row whatever it holds: a file without line ends takes no more memory."""

STANDARD_INPUT = "-"  #: the path that stands for standard input

_QUANTITIES = texts(__package__, "quantities.toml")
UNITS = MappingProxyType({quantity: known["unit"] for quantity, known in _QUANTITIES.items()})
"""The quantities of a log and their SI units."""

NAMES = MappingProxyType({quantity: tuple(known["names"]) for quantity, known in _QUANTITIES.items()})
"""Accepted names by quantity, the first the one this package writes."""

_WHEEL = ("wheel_angular_speed", "wheel_speed")

# Spellings of measurement systems that a unit grammar does not know, or reads as something else: 1/min is rad/min to
# it, but revolutions a minute in a column of speeds.
_SPELLINGS = MappingProxyType(
    {"knm": "kN*m", "nm": "N*m", "kmh": "km/h", "kph": "km/h", "rads": "rad/s", "kn": "kN", "sec": "s"}
    | {"rev/s": "turn/s"}
    | dict.fromkeys(("1/min", "min^-1", "u/min", "r/min", "rev/min"), "rpm")
)
_HEADER = re.compile(r"\s*(?P<name>[^\[\](]*?)\s*(?:\[(?P<square>[^\]]*)\]|\((?P<round>.*)\))?\s*")
_SUFFIX = re.compile(r"(?P<name>.+)[_ ](?P<unit>kmh|ms|rads|rpm|knm|nm|kn|s|n)", re.IGNORECASE)
_PLACE = re.compile(r"[1-9]\d*")
_SUFFIX_UNITS = MappingProxyType({"ms": "m/s", "s": "s", "n": "N", "rpm": "rpm"})


@dataclass(frozen=True)
class Column:
    """Where a quantity is in a log: the column's number, its header, and what one of its unit is in SI."""

    quantity: str
    index: int
    header: str
    factor: float
    unit_given: bool


def find_columns(
    header: Sequence[str], columns: Mapping[str, str] | None = None, units: Mapping[str, str] | None = None
) -> dict[str, Column]:
    """The columns of a header by quantity, in the order of `UNITS`.

    `columns` has the header cell of a quantity where `NAMES` does not find it, or its place, the first being 1; `units`
    wins over the header's; without either a column is SI. InputError for an unknown quantity, a header that is not
    there, two columns of one name, a missing column, or a unit of another dimension.
    """
    columns, units = columns or {}, units or {}
    for option, given in (("`columns`", columns), ("`units`", units)):
        for quantity in given:
            if quantity not in UNITS:
                raise InputError(f"{option}: {quantity!r} is not a quantity of a log; choose one of {', '.join(UNITS)}")
    found: dict[str, Column] = {}
    for quantity in UNITS:
        index = _named(header, quantity, columns[quantity]) if quantity in columns else _recognised(header, quantity)
        if index is not None:
            column = _column(quantity, index, header[index], units.get(quantity))
            other = found.get(column.quantity)
            if other is not None and quantity not in columns:
                raise _several(column.quantity, header, sorted((other.index, index)))
            found[column.quantity] = column
    missing = [q for q in ("time", "train_speed", "brake_torque") if q not in found]
    if not any(q in found for q in _WHEEL):
        missing.append("wheel_speed")
    if missing:
        quantity = missing[0]
        called = " or ".join(repr(name) for name in NAMES[quantity][:2])
        raise InputError(
            f"header: no column for {quantity}; call one {called}, or give `columns` {quantity}=HEADER "
            f"(the header has {_cells(header)})"
        )
    return found


def with_units(header: Sequence[str], units: Sequence[str]) -> list[str]:
    """A header's cells, each with its unit of a row of them, but for those that have one; `-` and nothing are none."""
    bare = [unit.strip(" \t[]()") for unit in units]
    return [
        f"{cell.strip()} [{unit}]" if unit not in ("", "-") and not _split(cell)[1] else cell
        for cell, unit in zip(header, bare, strict=True)
    ]


def is_unit(cell: str, quantity: str) -> bool:
    """Whether a cell is a unit of a quantity, in brackets or not."""
    with suppress(InputError):
        return _column(quantity, 0, f"x [{cell.strip(' []()')}]", None).unit_given
    return False


def _named(header: Sequence[str], quantity: str, wanted: str) -> int:
    at = [i for i, cell in enumerate(header) if wanted.strip() in (cell.strip(), _split(cell)[0])]
    if not at and _PLACE.fullmatch(wanted.strip()) and int(wanted) <= len(header):
        return int(wanted) - 1
    if len(at) != 1:
        count = f"{len(at)} columns are" if at else "no column is"
        hint = close_match(wanted, header)
        raise InputError(
            f"`columns` {quantity}: {count} called {shown(wanted)}; {hint}the header has {_cells(header)}"
            f"{_by_place(at)}"
        )
    return at[0]


def _recognised(header: Sequence[str], quantity: str) -> int | None:
    names, at = {_plain(name) for name in NAMES[quantity]}, []
    for i, cell in enumerate(header):
        name, unit = _split(cell)
        # n is a letter for two quantities: n [1/min] is no load
        other = _plain(name) == "n" and not (is_unit(unit, quantity) if unit else quantity == "wheel_load")
        if {_plain(cell), _plain(name)} & names and not other:
            at.append(i)
    if len(at) > 1:
        raise _several(quantity, header, at)
    return at[0] if at else None


def _several(quantity: str, header: Sequence[str], at: Sequence[int]) -> InputError:
    cells, option = _cells([header[i] for i in at]), f"`columns` {quantity}=HEADER"
    return InputError(f"header: {quantity} may be any of {cells}; say which with {option}{_by_place(at)}")


def _by_place(at: Sequence[int]) -> str:
    return f", or by its place: {' or '.join(str(i + 1) for i in at)}" if len(at) > 1 else ""


def _column(quantity: str, index: int, cell: str, unit: str | None) -> Column:
    in_header = _split(cell)[1]
    given = unit if unit is not None else in_header
    if not given:
        return Column(quantity, index, cell.strip(), 1.0, unit_given=False)
    if quantity == "wheel_speed" and is_unit(given, "wheel_angular_speed"):
        quantity = "wheel_angular_speed"
    spelled = _SPELLINGS.get(given.strip().lower(), given.strip())
    where = f"`units` {quantity}" if unit is not None else f"header, column {cell.strip()!r}"
    try:
        factor = to_unit(f"1 {spelled}", UNITS[quantity])
    except InputError:
        raise InputError(
            f"{where}: {shown(given)} is not a unit of {quantity}; give one convertible to {UNITS[quantity]!r}, "
            f"in the header or as `units` {quantity}=UNIT"
        ) from None
    return Column(quantity, index, cell.strip(), factor, unit_given=True)


def _split(cell: str) -> tuple[str, str]:
    """A header cell's name and unit, the latter empty where there is none."""
    match = _HEADER.fullmatch(cell)
    if match is None:
        return cell.strip(), ""
    name, unit = match["name"], match["square"] or match["round"] or ""
    suffix = _SUFFIX.fullmatch(name)
    if not unit and suffix is not None:
        return suffix["name"], _SUFFIX_UNITS.get(suffix["unit"].lower(), suffix["unit"])
    return name, unit


def _plain(name: str) -> str:
    return re.sub(r"[\s_\-]+", "", name).lower()


def _cells(header: Sequence[str]) -> str:
    return ", ".join(shown(cell.strip()) for cell in header[:12]) + (", ..." if len(header) > 12 else "")


# --- the lines of the header --------------------------------------------------------------------------------------

COMMENT = b"#"

BLANKS = " "  #: the separator of cells apart by any number of spaces and tabs

_SEPARATORS = (";", "\t", ",")
_LONGEST_HEADER = 64 << 10  # bytes, with the comments before it
_WORDS = re.compile(r"\s+(?![\[(])")  # a unit in brackets belongs to the name before it


@dataclass(frozen=True)
class Header:
    """How the rows are read: the header's cells, the columns by quantity, and what separates the cells of a row.

    `next_line` is the number of the line after the header, or of the first row where that is `pending`: read already.
    """

    cells: tuple[str, ...]
    columns: dict[str, Column]
    separator: str
    next_line: int
    pending: bytes


def read_header(
    readline: Callable[[int], bytes], name: str, columns: Mapping[str, str] | None, units: Mapping[str, str] | None
) -> Header:
    """The header of a log, read by `readline` from its beginning; `name` is for errors, the rest as of `logs.Log`."""
    lines: list[bytes] = []  # up to the first that is neither empty nor a comment
    while sum(map(len, lines)) < _LONGEST_HEADER and (line := readline(_LONGEST_HEADER)):
        lines.append(line)
        if not _passed_over(line):
            break
    if not lines or _passed_over(lines[-1]):
        raise InputError(f"{name}: the file is empty or has no header; give a CSV file with a header")
    text = _decoded(lines[-1], name)
    if not lines[-1].endswith(b"\n"):
        raise InputError(f"{name}: nothing after line {len(lines)}; give a CSV file with a header and rows")
    separator = _separator(text)
    cells = split_cells(text, separator) or [text]
    if _has_numbers(cells):
        return _from_comments([_decoded(line, name) for line in lines], lines[-1], name, columns, units)
    following = readline(_LONGEST_HEADER)
    whole = following.endswith(b"\n") and b"\0" not in following
    below = split_cells(_decoded(following, name), separator) or [] if whole else []
    may_be_units = len(below) == len(cells) and not _has_numbers(below)
    try:
        found = find_columns(cells, columns, units)
        if may_be_units and any(is_unit(below[column.index], column.quantity) for column in found.values()):
            named = find_columns(with_units(cells, below), columns, units)
            return Header(tuple(cells), named, separator, len(lines) + 2, b"")
        return Header(tuple(cells), found, separator, len(lines) + 1, following)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


def split_cells(text: str, separator: str) -> list[str] | None:
    """The cells of a line; None where quotation marks are not as CSV has them."""
    if separator == BLANKS:
        return _WORDS.split(text.strip())
    try:
        return next(csv.reader([text], delimiter=separator, strict=True), [])
    except csv.Error:
        return None


def number_in(cell: str, decimal: str) -> float | None:
    """A cell as a number with a decimal mark; None where it is none."""
    with suppress(ValueError):
        return None if "_" in cell else float(cell.strip().replace(decimal, "."))  # 1_0 is Python's, no log's
    return None


def _from_comments(
    lines: Sequence[str],
    first_row: bytes,
    name: str,
    columns: Mapping[str, str] | None,
    units: Mapping[str, str] | None,
) -> Header:
    """The header in the comments above the first row, which is the last of the lines."""
    failure = None
    for comment in reversed(lines[:-1]):
        text = comment.strip().lstrip("#").strip()
        cells = split_cells(text, _separator(text)) or [text]
        separator = _separator_of(lines[-1], len(cells))
        if separator is None or _has_numbers(cells):
            continue
        try:
            return Header(tuple(cells), find_columns(cells, columns, units), separator, len(lines), first_row)
        except InputError as error:  # another comment may name them; else this one was meant
            failure = failure or InputError(f"{name}: {error}")
    raise failure or InputError(
        f"{name}: line {len(lines)}: no header, but numbers; name the columns in a line above, with their units"
    )


def _separator(text: str) -> str:
    return next((s for s in _SEPARATORS if s in text), BLANKS if len(_WORDS.split(text.strip())) > 1 else ",")


def _separator_of(row: str, count: int) -> str | None:
    """The separator that parts a row into so many cells, two at least; an empty one more at its end is none."""
    for separator in (*_SEPARATORS, BLANKS):
        cells = split_cells(row, separator) or [row]
        if count > 1 and (len(cells) == count or (len(cells) == count + 1 and not cells[-1].strip())):
            return separator
    return None


def _has_numbers(cells: Sequence[str]) -> bool:
    return any(number_in(cell, ",") is not None for cell in cells)


def _passed_over(line: bytes) -> bool:
    text = line.removeprefix(codecs.BOM_UTF8).strip()
    return not text or text.startswith(COMMENT)


def _decoded(line: bytes, name: str) -> str:
    """A line's text without its end."""
    if b"\0" in line:
        raise InputError(f"{name}: not a text file in UTF-8 or Latin-1; save it as CSV in UTF-8")
    try:
        text = line.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = line.decode("latin-1")
    return text.strip("\r\n")


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
        if standard and sys.stdin is None:
            raise InputError(f"{self.name}: is closed; give a CSV file, or pipe one in")
        opened = io.FileIO(sys.stdin.fileno(), closefd=False) if standard else self._regular(path)
        self._raw = io.BufferedReader(opened)
        self._size = 0 if standard else os.fstat(self._raw.fileno()).st_size
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

    def _regular(self, path: Path) -> io.FileIO:
        """A regular file, opened; nothing else, as a pipe may never end, nor even begin."""
        try:
            mode = path.stat().st_mode
            if stat.S_ISREG(mode):
                return io.FileIO(path)
        except FileNotFoundError:
            raise InputError(f"{self.name}: no such file; give a CSV file") from None
        except (OSError, ValueError) as error:  # ValueError: a null character in the path
            raise self._unreadable(error) from None
        reason = "is a directory" if stat.S_ISDIR(mode) else "is not a regular file"
        raise InputError(f"{self.name}: {reason}; give a CSV file, or - for standard input")

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


# --- the rows ------------------------------------------------------------------------------------------------------

# s, some 3000 years: what counts from 1970 in seconds is below, in milliseconds above. Beyond, a double does not tell
# neighbouring rows apart.
_LATEST = 1e11

_MOST_NAMED = 5
_FIRST_ROWS = 1000  # that tell whether a column is empty; so many, and no more, wait in memory for it
_EMPTY = ("", "nan")
_DATE = re.compile(r"\d{4}-\d{1,2}-\d{1,2}|\d{1,2}[./]\d{1,2}[./]\d{2,4}|\d{1,2}:\d{2}")
_PIECE = 1000  # lines that are parsed one by one where one of them is no row
_DISPENSABLE = {
    "wheel_load": "the vehicle's wheel load is used",
    "wheel_speed": "the wheel's angular speed is used",
    "wheel_angular_speed": "the wheel speed is used",
}
_STRANGE = re.compile(rb"[\0-\x08\x0b-\x1f]")
_QUOTED = re.compile(rb'"[^"]*"')
_BLANKS = re.compile(rb"[ \t]+")
_ORDINARY = bytes(code for code in range(256) if code in b"\t\n" or (code >= 32 and code not in b'"#'))
_OUTER_TABS = re.compile(rb"^\t|\t$", re.MULTILINE)


@dataclass(frozen=True)
class Rows:
    """Rows of a log, SI: the line of each in the file, the first being line 1, and its columns by quantity."""

    line: Lines
    columns: dict[str, Floats]

    def __len__(self) -> int:
        return len(self.line)

    def where(self, kept: Flags) -> Rows:
        return Rows(self.line[kept], {name: values[kept] for name, values in self.columns.items()})

    def part(self, start: int, stop: int | None) -> Rows:
        return Rows(self.line[start:stop], {name: values[start:stop] for name, values in self.columns.items()})

    def then(self, more: Rows) -> Rows:
        return Rows(
            np.concatenate([self.line, more.line]),
            {name: np.concatenate([values, more.columns[name]]) for name, values in self.columns.items()},
        )


@dataclass
class Broken:
    """What is counted and named by its line: how many, the first of them with what was wrong, and the last line."""

    count: int = 0
    last: int = 0
    named: list[tuple[int, str]] = field(default_factory=list)

    def add(self, line: int, reason: str) -> None:
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

    `path` is a CSV in UTF-8 or Latin-1, gzipped or not, or `-`, standard input; separated by commas, semicolons, tabs
    or blanks; a decimal comma is understood where no comma separates. `columns` and `units` as of `find_columns`;
    `block_bytes` are read at a time. InputError in one line for a file that is missing or empty, for its header, a
    column or a unit, and while reading for a file without a single row.
    """

    def __init__(
        self,
        path: Path,
        *,
        columns: Mapping[str, str] | None = None,
        units: Mapping[str, str] | None = None,
        block_bytes: int = BLOCK_BYTES,
    ) -> None:
        check_extra("identify", "identify")
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
        """Close the file; `rows` does so at its end."""
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
        self._count = self._count or self._usual_count(block)
        number = np.arange(first, first + block.count(b"\n"))
        number, table = self._numbers(number, block, self._has_comma(block))
        values = {name: column.factor * table[:, i] for i, (name, column) in enumerate(self.columns.items())}
        finite = np.asarray(np.isfinite(table).all(axis=1))
        for at in number[~finite]:
            self.broken.add(int(at), "a value is missing or not finite")
        possible = finite & (np.abs(values["time"]) <= _LATEST)
        for at in np.flatnonzero(finite & ~possible):
            self.broken.add(int(number[at]), f"time {values['time'][at]:.9g} s is beyond any clock; check its unit")
        return Rows(number, values).where(possible)

    def _usual_count(self, block: bytes) -> int:
        """Cells of a row: the header's, but rows may end in one separator more, or without its last empty cells.

        The rows of the first block tell; 0 if it has none.
        """
        lines = block.split(b"\n", _FIRST_ROWS)[:-1]
        most, separator = len(self._header.cells), self._separator.encode()
        least = max((i for i, cell in enumerate(self._header.cells, 1) if cell.strip()), default=most)
        counts = Counter((len(self._cells(line) or ()), line.endswith(separator)) for line in lines)
        usual = [count for (count, ends), _ in counts.most_common() if least <= count <= most + (1 if ends else 0)]
        return usual[0] if usual else 0

    def _numbers(self, number: Lines, text: bytes, comma: bool) -> tuple[Lines, Floats]:
        """The columns of rows in the file's units, (rows, columns), with the numbers of the lines that are rows.

        Where a cell is no number they are gone through in pieces, and the piece that it is in line by line.
        """
        if not self._is_regular(text):
            lines, kept = text.split(b"\n"), []
            for i, at in enumerate(number.tolist()):
                if lines[i].strip() and not lines[i].strip(b" \t").startswith(COMMENT):
                    if fault := self._fault(lines[i]):
                        self.broken.add(at, fault)
                    else:
                        kept.append(i)
            number, text = number[kept], b"".join(lines[i] + b"\n" for i in kept)
        with suppress(ValueError):
            return number, self._table(number, text, comma)
        lines = text.split(b"\n")[:-1]
        if len(lines) > _PIECE:
            parts = [slice(i, i + _PIECE) for i in range(0, len(lines), _PIECE)]
            found = [self._numbers(number[at], b"\n".join([*lines[at], b""]), comma) for at in parts]
            return np.concatenate([each[0] for each in found]), np.concatenate([each[1] for each in found])
        rows = [self._row(line, comma) for line in lines]
        for at, row in zip(number.tolist(), rows, strict=True):
            if isinstance(row, str):
                self.broken.add(at, row)
        good = [not isinstance(row, str) for row in rows]
        return number[good], np.array(list(itertools.compress(rows, good)), dtype=float).reshape(-1, len(self.columns))

    def _is_regular(self, block: bytes) -> bool:
        """Whether every line has the usual cells and nothing that is to be looked at: most blocks of most logs."""
        if block.translate(None, _ORDINARY) or self._count > len(self._header.cells):
            return False
        codes = np.frombuffer(block, dtype=np.uint8)
        ends, separators = np.flatnonzero(codes == ord("\n")), np.flatnonzero(codes == ord(self._separator))
        return bool((np.diff(np.searchsorted(separators, ends), prepend=0) == self._count - 1).all())

    def _table(self, number: Lines, text: bytes, comma: bool) -> Floats:
        """The columns of rows, (rows, columns); ValueError where a cell is no number, and where there is no row."""
        import pandas as pd

        places = [column.index for column in self.columns.values()]
        frame = pd.read_csv(
            io.BytesIO(text),
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
        if len(frame) != len(number):
            raise ValueError("rows")
        return np.asarray(frame[places].to_numpy())

    def _has_comma(self, block: bytes) -> bool:
        """Whether the decimal mark is a comma: it separates no cells and is more frequent than the point."""
        return self._separator != "," and block.count(b",") > block.count(b".")

    def _cells(self, line: bytes) -> list[str] | None:
        return split_cells(line.decode("latin-1"), self._separator)

    def _fault(self, line: bytes) -> str:
        """What is wrong with a line that should be a row; empty for one with the usual cells."""
        if _STRANGE.search(line):
            nulls = line.count(b"\0")  # as a power cut leaves them
            if nulls < 2:
                return "a control character or a carriage return within the line"
            return f"a control character, {nulls} null bytes, which may stand for many rows and count as one line"
        line = _QUOTED.sub(b"", line)  # a separator in quotes is none
        if b'"' in line:
            return "a quotation mark without its other one"
        separator, own = self._separator.encode(), len(self._header.cells)
        count = line.count(separator) + 1
        whole = count == self._count and (count <= own or line.endswith(separator))
        return "" if whole else f"{count} cells where the header has {own}"

    def _row(self, line: bytes, comma: bool) -> list[float] | str:
        """The log's columns of a line, as they stand; or what is wrong with it."""
        cells, values, decimal = self._cells(line), [], "," if comma else "."
        if cells is None or len(cells) != self._count:
            return "quotation marks within a cell"
        for column in self.columns.values():
            cell = cells[column.index].strip()
            value = number_in(cell, decimal) if cell else np.nan
            if value is None:
                if column.quantity == "time" and _DATE.match(cell):
                    return (
                        f"{shown(cell)} is a date or a time of day, not a number, column {column.header!r}; give the "
                        "time in s, from any beginning, or in another unit that the header names"
                    )
                return f"{shown(cell)} is not a number, column {column.header!r}"
            values.append(value)
        return values
