"""Read a log, a CSV file with a header, in blocks of lines; memory does not grow with the size of the file.

A header cell is a name of `NAMES`, with or without a unit: "train speed [km/h]", "Wheel speed (km/h)", "time_ms". Case,
spaces, underscores and hyphens are ignored. A column without a unit is in SI. Lines may precede the header, and a line
of units may follow it. Lines that cannot be read are left out and reported.
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
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import field
from functools import cache, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from railslip_ctrl.core.arguments import Flags, Floats, Integers
from railslip_ctrl.core.errors import InputError, check_extra
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.templates import texts
from railslip_ctrl.core.units import KMH, TRADE_UNITS, factor, shown
from railslip_ctrl.core.user_files import close_match, file_name

Lines = Integers

BLOCK_BYTES = 4 << 20  #: bytes read at a time; a block and its numbers take about 30 MB of memory

LONGEST_LINE = 1 << 20  #: longest line that is read, bytes; it bounds the memory for a file without line ends

STANDARD_INPUT = "-"  #: path that means standard input

_QUANTITIES = texts(__package__, "quantities.toml")
#: SI units of the quantities of a log, by quantity
UNITS = MappingProxyType({quantity: known["unit"] for quantity, known in _QUANTITIES.items()})

#: accepted names in a header, by quantity; files written by this package use the first name
NAMES = MappingProxyType({quantity: tuple(known["names"]) for quantity, known in _QUANTITIES.items()})

_WHEEL = ("wheel_angular_speed", "wheel_speed")

_BRACKETS = re.compile(r"[\[({<]([^\[\](){}<>]*)[\])}>]")
_POSITION = re.compile(r"[1-9]\d*")
_SUFFIXES = frozenset(name.lower() for name in TRADE_UNITS)  # units accepted without brackets; not all Pint units


@dataclass(frozen=True)
class Column:
    """Column of a quantity in a log."""

    quantity: str
    factor: float  # SI value of its unit
    index: int  # from 0
    header: str
    unit_given: bool  # if false, the column is read in SI


def find_columns(
    header: Sequence[str], columns: Mapping[str, str] | None = None, units: Mapping[str, str] | None = None
) -> dict[str, Column]:
    """Find the column of each quantity in a header; the result has the quantities as keys, in the order of `UNITS`.

    `columns` maps a quantity to its header cell or to the position of its column, counted from 1. `units` maps a
    quantity to its unit and overrides the unit in the header. InputError for an unknown quantity, an unknown or
    ambiguous header, a missing column, or a unit that does not suit the quantity.
    """
    columns, units = columns or {}, units or {}
    for option, given in (("`columns`", columns), ("`units`", units)):
        for quantity in given:
            if quantity not in UNITS:
                raise InputError(f"{option}: {quantity!r} is not a quantity of a log; choose one of {', '.join(UNITS)}")
    by_quantity: dict[str, Column] = {}
    for quantity in UNITS:
        cell = columns.get(quantity)
        index = _known_index(header, quantity) if cell is None else _given_index(header, quantity, cell)
        if index is not None:
            column = _column(quantity, index, header[index], units.get(quantity))
            other = by_quantity.get(column.quantity)
            if other is not None and quantity not in columns:
                raise _ambiguous(column.quantity, header, sorted((other.index, index)))
            by_quantity[column.quantity] = column
    missing = [q for q in ("time", "train_speed", "brake_torque") if q not in by_quantity]
    if missing or not {*_WHEEL} & by_quantity.keys():
        quantity = [*missing, "wheel_speed"][0]
        names = " or ".join(repr(name) for name in NAMES[quantity][:2])
        raise InputError(
            f"header: no column for {quantity}; call a column {names}, or give `columns` {quantity}=HEADER "
            f"(the header has {_cells(header)})"
        )
    return by_quantity


@cache
def is_unit(text: str, quantity: str) -> bool:
    """True if `text` is a unit of the `quantity`; a wheel speed may also have a unit of angular speed."""
    with suppress(InputError):
        return bool(_unit(text, quantity))
    return False


def _given_index(header: Sequence[str], quantity: str, wanted: str) -> int:
    at = [i for i, cell in enumerate(header) if " ".join(wanted.split()) in _names(cell, quantity)]
    if not at and _POSITION.fullmatch(wanted.strip()) and int(wanted) <= len(header):
        return int(wanted) - 1
    if len(at) != 1:
        count = f"`columns` {quantity}: {len(at) or 'no'} {'columns are' if at else 'column is'} called {shown(wanted)}"
        remedy = f"give the position of the column, {_positions(at)}; " if at else close_match(wanted, header)
        raise InputError(f"{count}; {remedy}the header has {_cells(header)}")
    return at[0]


def _known_index(header: Sequence[str], quantity: str) -> int | None:
    known = {_plain(name) for name in NAMES[quantity]}
    at = [i for i, cell in enumerate(header) if known & {_plain(name) for name in _names(cell, quantity)}]
    if len(at) > 1:
        raise _ambiguous(quantity, header, at)
    return at[0] if at else None


def _ambiguous(quantity: str, header: Sequence[str], at: Sequence[int]) -> InputError:
    remedy = f"choose with `columns` {quantity}=HEADER, or give the position of the column, {_positions(at)}"
    return InputError(f"header: {quantity} may be any of {_cells([header[i] for i in at])}; {remedy}")


def _positions(at: Sequence[int]) -> str:
    return " or ".join(str(i + 1) for i in at)


def _column(quantity: str, index: int, cell: str, unit: str | None) -> Column:
    where = f"header, column {cell.strip()!r}" if unit is None else f"`units` {quantity}"
    texts, failure = [unit] if unit is not None else _split(cell)[1], ""
    for text in texts or (text for _, text in _suffixes(cell) if is_unit(text, quantity)):
        try:
            return Column(*_unit(text, quantity), index, cell.strip(), unit_given=True)
        except InputError as error:
            failure = failure or str(error).split(";", maxsplit=1)[0]
    if not texts and re.search(r"[\[({]", _BRACKETS.sub("", cell)):
        failure = "a bracket is not closed"
    if failure:
        raise InputError(
            f"{where}: {failure}; give a unit of {quantity}, convertible to {UNITS[quantity]!r}, "
            f"in the header or as `units` {quantity}=UNIT"
        )
    return Column(quantity, 1.0, index, cell.strip(), unit_given=False)


def _unit(text: str, quantity: str) -> tuple[str, float]:
    if quantity == "wheel_speed":
        with suppress(InputError):
            return quantity, factor(text, UNITS[quantity])
        quantity = "wheel_angular_speed"
    return quantity, factor(text, UNITS[quantity])


def _split(cell: str) -> tuple[str, list[str]]:
    """Split a header cell into its name and the texts in its brackets, last bracket first."""
    texts = [text.strip() for text in reversed(_BRACKETS.findall(cell)) if text.strip()]
    return " ".join(_BRACKETS.sub(" ", cell).split()).rstrip(" /,:"), texts


def _suffixes(cell: str) -> Iterator[tuple[str, str]]:
    """Yield the ways to split a header cell without brackets, such as v_kmh or "Tb kN m", into name and unit."""
    pieces = re.split(r"[\s_,:]+", cell.strip())
    for count, sign in ((1, ""), (2, "/"), (2, " ")):
        name, text = " ".join(pieces[:-count]).rstrip(" /"), sign.join(pieces[-count:])
        if name and all(part.lower() in _SUFFIXES for part in re.split(r"[ /*.]", text)):
            yield name, text
            if text.lower() == "ms":
                yield name, "m/s"


def _names(cell: str, quantity: str) -> set[str]:
    name, texts = _split(cell)
    if _plain(name) == "n" and not (any(is_unit(t, quantity) for t in texts) if texts else quantity == "wheel_load"):
        return set()  # n may be the angular speed or the load; for example n [1/min] is not the load
    named = {name} if texts else {before for before, text in _suffixes(cell) if is_unit(text, quantity)}
    return {" ".join(cell.split()), name, *named}


def _plain(name: str) -> str:
    return re.sub(r"[\s_\-]+", "", name).lower()


def _cells(header: Sequence[str]) -> str:
    return ", ".join(shown(cell.strip()) for cell in header[:12]) + (", ..." if len(header) > 12 else "")


# --- the lines of the header --------------------------------------------------------------------------------------

COMMENT = b"#"

BLANKS = " "  #: separator that stands for any number of spaces and tabs

_SEPARATORS = (";", "\t", ",", "|")
_BLANK = codecs.BOM_UTF8 + b" \t\r\n"
_MOST_ABOVE = 200  # lines searched for the header; data loggers write tens of lines above it
_WORDS = re.compile(r"\s+(?![\[(])")  # a unit in brackets belongs to the name before it
_GROUPS = re.compile("(?<=\\d)[ '\u2019\u00a0\u2009\u202f](?=\\d{3}(?!\\d))")
_NOTHING = ("", "-", "--", "n/a", "na", "nan", "null", "none")
_ALL_NAMES = frozenset(_plain(name) for names in NAMES.values() for name in names)


@dataclass(frozen=True)
class Header:
    """Format of the rows of a log, as read from the header."""

    cells: tuple[str, ...]
    columns: dict[str, Column]
    separator: str
    next_line: int  # number of the first line after the header and its line of units
    notes: tuple[str, ...]


def read_header(
    file: LogFile, columns: Mapping[str, str] | None, units: Mapping[str, str] | None, skip_lines: int
) -> Header:
    """Read the header of a log; after this call `file.read` returns rows. The other arguments are those of `Log`."""
    lines = file.first_lines()
    if b"\0" in lines[0]:
        raise InputError(f"{file.name}: not a text file in UTF-8 or Latin-1; save it as CSV in UTF-8")
    searched = range(skip_lines, min(len(lines), skip_lines + _MOST_ABOVE))
    plain = [i for i in searched if lines[i].strip(_BLANK) and not _is_comment(lines[i])]
    if not plain:
        raise InputError(f"{file.name}: empty, or no header from line {skip_lines + 1} on; give a CSV with a header")
    comments = [i for i in reversed(range(skip_lines, plain[0])) if _is_comment(lines[i])]
    find = partial(find_columns, columns=columns, units=units)
    best = (0, 0, f"line {plain[0] + 1}: no header, but numbers; name the columns in a line above, with their units")
    for at in (*plain, *comments):
        for cells, separator, end in _records(lines, at, plain[0]):
            try:
                by_quantity, end = _with_units_below(cells, lines, end, plain[0], find)
            except InputError as error:
                known = len({_plain(_split(cell)[0]) for cell in cells} & _ALL_NAMES)
                if known or (at in plain and not _has_numbers(cells)):
                    best = max(best, (known, len(cells), str(error)), key=lambda each: each[:2])
                continue
            # columns given by their positions can also be found in a row
            if _has_numbers([cells[column.index] for column in by_quantity.values()]):
                continue
            end = max(end, plain[0] * (at in comments))
            file.ahead = io.BytesIO(b"\n".join(lines[end:]))
            above = any(i < at and not lines[i].strip(_BLANK).lower().startswith(b"sep=") for i in plain)
            notes = (f"the header is in line {at + 1}; the lines above it are skipped",) if above else ()
            return Header(tuple(cells), by_quantity, separator, end + 1, notes)
    raise InputError(f"{file.name}: {best[2]}")


def split_cells(lines: Iterable[str], separator: str) -> tuple[list[str], int] | None:
    """Return the first record of `lines`: its cells and its number of lines; None for invalid quotation marks."""
    if separator == BLANKS:
        return _WORDS.split(next(iter(lines)).strip()), 1
    reader = csv.reader((f"{line}\n" for line in lines), delimiter=separator, strict=True)
    try:
        return next(reader, []), reader.line_num
    except csv.Error:
        return None


def number_in(cell: str, decimal: str) -> float | None:
    """Convert a cell to a number; None if it is not a number. Blanks and apostrophes may separate thousands."""
    if "_" in cell or (decimal != "." and "." in cell):  # 1_0 is Python syntax; 1.024 with decimal comma is ambiguous
        return None
    with suppress(ValueError):
        return float(_GROUPS.sub("", cell).strip().replace(decimal, ".").replace("\N{MINUS SIGN}", "-"))
    return None


def _records(lines: Sequence[bytes], at: int, first_row: int) -> Iterator[tuple[list[str], str, int]]:
    """Yield each way to read the line `at` as a header: (cells, separator of the rows, index of the next line)."""
    comment, text = _is_comment(lines[at]), _decoded(lines[at]).strip("# \t")
    for separator in [s for s in _SEPARATORS if s in text or '"' in text] or [BLANKS]:
        split = split_cells([text] if comment else map(_decoded, itertools.islice(lines, at, None)), separator)
        of_rows = separator if split is None or not comment else _separator_of(lines[first_row], len(split[0]))
        if split and of_rows:
            yield [" ".join(cell.split()) for cell in split[0]], of_rows, at + split[1]


def _with_units_below(
    cells: list[str], lines: Sequence[bytes], end: int, first_row: int, find: Callable[[list[str]], dict[str, Column]]
) -> tuple[dict[str, Column], int]:
    """Return the columns of a header, and the index of the line after the header and its line of units."""
    by_quantity = find(cells)
    at = next((i for i in range(end, len(lines)) if lines[i].strip(_BLANK)), end)
    for row, _, after in _records(lines, at, first_row) if at < len(lines) else ():
        below = [cell.strip(" []()") for cell in row]
        if len(below) != len(cells):
            continue
        beside = [below[column.index] for column in by_quantity.values()]
        if _has_numbers(beside) or all(text.lower() in _NOTHING for text in beside):
            return by_quantity, end
        wanted = not all(column.unit_given for column in by_quantity.values())
        if wanted or any(map(is_unit, beside, by_quantity)):  # if a unit is missing, `find` refuses an unknown text
            pairs = zip(cells, below, strict=True)
            return find([name if unit.lower() in _NOTHING else f"{name} [{unit}]" for name, unit in pairs]), after
    return by_quantity, end


def _separator_of(row: bytes, count: int) -> str | None:
    for separator in (*_SEPARATORS, BLANKS):
        cells, _ = split_cells([_decoded(row)], separator) or ([""], 1)
        if count > 1 and (len(cells) == count or (len(cells) == count + 1 and not cells[-1].strip())):
            return separator
    return None


def _has_numbers(cells: Sequence[str]) -> bool:
    return any(number_in(cell, decimal) is not None for cell in cells for decimal in ".,")


def _is_comment(line: bytes) -> bool:
    return line.strip(_BLANK).startswith(COMMENT)


def _decoded(line: bytes) -> str:
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
    """Reads the bytes of a log once, from the beginning; a gzipped file is unpacked.

    `path` is a regular file or `STANDARD_INPUT`. InputError for a file that cannot be read. `damage` says why a gzipped
    file ends early; it is empty if the file is complete.
    """

    def __init__(self, path: Path) -> None:
        standard = str(path) == STANDARD_INPUT
        self.name = "standard input" if standard else file_name(path)
        self.damage = ""
        self.ahead = io.BytesIO()
        self._returns = False  # lines end in carriage returns alone
        self._position = 0
        if standard and sys.stdin is None:
            raise InputError(f"{self.name} is closed; give a CSV file, or pipe one in")
        opened = io.FileIO(sys.stdin.fileno(), closefd=False) if standard else self._regular(path)
        self._raw = io.BufferedReader(opened)
        self._size = 0 if standard else os.fstat(self._raw.fileno()).st_size
        self._file: Any = self._raw
        try:
            if self._guarded(self._raw.peek, 8).startswith(_GZIP):
                self._file = gzip.GzipFile(fileobj=self._raw)
            beginning = self._guarded(self._file.peek, 8)
            for magic, description in _OTHER_FORMATS.items():
                if beginning.startswith(magic):
                    raise InputError(f"{self.name} is {description}; give a CSV file, gzipped or not")
        except InputError:
            self._raw.close()
            raise

    def _regular(self, path: Path) -> io.FileIO:
        try:
            mode = path.stat().st_mode
            if stat.S_ISREG(mode):
                return io.FileIO(path)
        except FileNotFoundError:
            raise InputError(f"{self.name}: no such file; give a CSV file") from None
        except (OSError, ValueError) as error:  # ValueError: a null character in the path
            raise self._unreadable(error) from None
        reason = "is a directory" if stat.S_ISDIR(mode) else "is not a regular file"
        raise InputError(f"{self.name} {reason}; give a CSV file, or - for standard input")

    def read(self, count: int) -> bytes:
        parts = [self.ahead.read(count)]
        missing = count - len(parts[0])
        while missing > 0 and (part := self._guarded(self._file.read1, missing)):
            parts.append(part)
            missing -= len(part)
        self._position = self._raw.tell() if self._size else 0
        return b"".join(parts).replace(b"\r", b"\n") if self._returns else b"".join(parts)

    def first_lines(self) -> list[bytes]:
        """Lines of the first megabyte; the last line may be cut off."""
        head = self.read(LONGEST_LINE)
        self._returns = b"\n" not in head
        return head.split(b"\r" if self._returns else b"\n")

    @property
    def share(self) -> float:
        return self._position / self._size if self._size else 0.0

    def close(self) -> None:
        self._file.close()
        self._raw.close()

    def _guarded(self, method: Callable[[int], bytes], count: int) -> bytes:
        try:
            return b"" if self.damage else method(count)
        except EOFError:
            self.damage = "ends early: the lines from here on are lost"
        except (zlib.error, gzip.BadGzipFile) as error:  # BadGzipFile: the checksum at the end is wrong
            self.damage = f"is damaged ({error}): earlier lines may be wrong, and the lines from here on are lost"
        except OSError as error:
            raise self._unreadable(error) from None
        return b""

    def _unreadable(self, error: Exception) -> InputError:
        return InputError(f"{self.name} cannot be read ({getattr(error, 'strerror', None) or error})")


# --- the rows ------------------------------------------------------------------------------------------------------

# Largest time, s; milliseconds since 1970 are above it. Doubles above it are too coarse to separate neighbouring rows.
_LATEST = 1e11

_MOST_NAMED = 5  # unreadable lines that have a message of their own
_FIRST_ROWS = 1000  # rows that are buffered to detect empty columns, decimal mark and cell count
_DATE = re.compile(r"\d{4}-\d{1,2}-\d{1,2}|\d{1,2}[./]\d{1,2}[./]\d{2,4}|\d{1,2}:\d{2}")
_PIECE = 1000  # number of lines that are parsed one by one if a line among them cannot be read
_OPTIONAL = {
    "wheel_load": "the vehicle's wheel load is used",
    "wheel_speed": "the wheel's angular speed is used",
    "wheel_angular_speed": "the wheel speed is used",
}
_CONTROL = re.compile(rb"[\0-\x08\x0b-\x1f]")
_QUOTED = re.compile(rb'"[^"]*"')
_BLANKS = re.compile(rb"[ \t]+")
_REGULAR = bytes(code for code in range(256) if code in b"\t\n" or (code >= 32 and code not in b'"#'))
_MARK = re.compile(r"[+-]?(?:[\d.]*(?P<comma>,)|[\d,]*(?P<point>\.))\d+(?:[eE][+-]?\d+)?")
_GROUPED = re.compile(r"[+-]?\d{1,3}(?:[.,]\d{3})+(?:[.,]\d+)?")  # a number with thousands separators
_FASTEST, _SHARE_FAST = 60.0, 0.1  # m/s, and share of rows; if a larger share is faster, a missing unit may be km/h
_UNREAD = 0.01  # share of unreadable lines that does not affect the curve
_OUTER_TABS = re.compile(rb"^\t|\t$", re.MULTILINE)


@dataclass(frozen=True)
class Rows:
    """Rows of a log: `line` contains the line numbers, from 1; `columns` maps each quantity to its values, SI."""

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
    """Unreadable lines of a log."""

    count: int = 0
    last: int = 0  # number of the last unreadable line
    named: list[tuple[int, str]] = field(default_factory=list)  # line numbers and reasons of the first

    def add(self, line: int, reason: str) -> None:
        self.count += 1
        self.last = max(self.last, line)
        if len(self.named) < _MOST_NAMED:
            self.named.append((line, reason))

    @property
    def first(self) -> tuple[str, ...]:
        return tuple(f"line {line}: {reason}" for line, reason in sorted(self.named))


class Log:
    """Reads the rows of a log once, from the beginning.

    - path: a CSV file in UTF-8 or Latin-1, gzipped or not, or `-` for standard input. Cells are separated by commas,
      semicolons, tabs, bars or blanks. The decimal mark is a point or a comma.
    - columns, units: as in `find_columns`.
    - skip_lines: number of lines to skip before the header.
    - block_bytes: number of bytes that are read at a time.

    InputError for a file, header, column or unit that cannot be used; `rows` also raises InputError.
    """

    def __init__(
        self,
        path: Path,
        *,
        columns: Mapping[str, str] | None = None,
        units: Mapping[str, str] | None = None,
        skip_lines: int = 0,
        block_bytes: int = BLOCK_BYTES,
    ) -> None:
        check_extra("identify", "identify")
        self._file = LogFile(path)
        self.name = self._file.name
        self.broken = Broken()
        self._block_bytes = block_bytes
        try:
            self._header = read_header(self._file, columns, units, skip_lines)
        except InputError:
            self._file.close()
            raise
        self.columns = dict(self._header.columns)
        self._notes = [*self._header.notes]
        self._kept = self._grouped = 0
        self._decimal = ""  # decimal mark, known from the first cell that has a mark
        self._separator = "\t" if self._header.separator == BLANKS else self._header.separator
        self._count = 0  # cells of a row, known from the first block

    @property
    def share(self) -> float:
        return self._file.share

    def close(self) -> None:
        self._file.close()

    @property
    def notes(self) -> tuple[str, ...]:
        assumed = [c for c in self.columns.values() if not c.unit_given]
        notes = [f"column {c.header!r} has no unit: {c.quantity} is read in {UNITS[c.quantity]}" for c in assumed]
        if {*_WHEEL} <= self.columns.keys():
            notes.append("the log has wheel_speed and wheel_angular_speed; wheel_angular_speed is used")
        return (*notes, *self._notes)

    def rows(self) -> Iterator[Rows]:
        """Yield the rows, block by block; `broken` and `share` are up to date after each block."""
        try:
            for first, block in self._after_first_rows(self._blocks()):
                rows = self._parsed(first, block)
                self._kept += len(rows)
                yield rows
        finally:
            self._file.close()
        if not self._kept:
            broken = f"; {self.broken.first[0]}" if self.broken.count else ""
            raise InputError(f"{self.name}: no rows after the header{broken}; give a log with data")
        if self._grouped > _UNREAD * (self._kept + self.broken.count):  # losing only large values would bias a fit
            raise InputError(f"{self.name}: {self._grouped} lines have thousands separators; remove the separators")

    def refused(self, error: InputError) -> InputError:
        """Return the error with the notes on the log, and with the number of unreadable lines if it is large."""
        count, lines, text = self.broken.count, self.broken.count + self._kept, str(error)
        if self._kept and count > _UNREAD * lines:
            unread = f"{self.name}: {count} of {lines} lines could not be read, first {self.broken.first[0]}"
            text = f"{unread}; {text.removeprefix(f'{self.name}: ')}"
        return InputError("; ".join([text, *self.notes]))

    def _blocks(self) -> Iterator[tuple[int, bytes]]:
        """Yield blocks of whole lines: (number of the first line, bytes)."""
        line, rest = self._header.next_line, b""
        while read := self._file.read(self._block_bytes):
            block, end, rest = (rest + read).rpartition(b"\n")
            if end:
                yield line, self._plain(block + end)
                line += block.count(b"\n") + 1
            if len(rest) > LONGEST_LINE:
                self.broken.add(line, f"more than {LONGEST_LINE} bytes without a line end, counted as one line")
                line, rest = line + 1, self._after_the_line()
        block, end, rest = rest.rpartition(b"\n")  # after a long line the rest may hold whole lines
        if end:
            yield line, self._plain(block + end)
            line += block.count(b"\n") + 1
        if self._file.damage:
            self.broken.add(line, f"the gzipped file {self._file.damage}")
        elif rest.strip():
            last = self._plain(rest + b"\n")
            self._count = self._count or len(self._header.cells)
            row = self._row(last[:-1], self._decimal or self._mark([last]))
            if isinstance(row, str) or not np.isfinite(row).all():
                self.broken.add(line, "the file ends within this line, which is left out")
            else:
                self._notes.append(f"the last line, {line}, has no line end, but is complete and used")
                yield line, last

    def _after_the_line(self) -> bytes:
        """Skip the rest of the current line; return the bytes already read of the next lines."""
        while read := self._file.read(self._block_bytes):
            if cut := read.find(b"\n") + 1:
                return read[cut:]
        return b""

    def _plain(self, block: bytes) -> bytes:
        block = block.replace(b"\r\r\n", b"\n").replace(b"\r\n", b"\n")  # \r\r\n: line ends converted twice
        return _OUTER_TABS.sub(b"", _BLANKS.sub(b"\t", block)) if self._header.separator == BLANKS else block

    def _after_first_rows(self, blocks: Iterator[tuple[int, bytes]]) -> Iterator[tuple[int, bytes]]:
        buffered: list[tuple[int, bytes]] = []
        ends = size = 0
        while ends < _FIRST_ROWS and size < BLOCK_BYTES and (more := next(blocks, None)):
            buffered.append(more)
            ends, size = ends + more[1].count(b"\n"), size + len(more[1])
        lines = b"".join(block for _, block in buffered).split(b"\n", _FIRST_ROWS)[:_FIRST_ROWS]
        self._decimal = self._mark(lines)
        self._leave_out_empty(lines)
        yield from buffered
        yield from blocks

    def _leave_out_empty(self, lines: Sequence[bytes]) -> None:
        split = (self._cells(line) for line in lines if line.strip() and not line.startswith(COMMENT))
        rows = [cells for cells in split if cells and len(cells) >= len(self._header.cells)]
        for name, instead in _OPTIONAL.items():
            column = self.columns.get(name)
            needed = name in _WHEEL and len({*_WHEEL} & self.columns.keys()) < len(_WHEEL)
            if column is None or needed or not rows:
                continue
            if all(row[column.index].strip().lower() in _NOTHING for row in rows):
                del self.columns[name]
                self._notes.append(
                    f"column {column.header!r} is empty in the first {len(rows)} rows and is ignored: {instead}"
                )

    def _parsed(self, first: int, block: bytes) -> Rows:
        self._count = self._count or self._usual_count(block)
        number = np.arange(first, first + block.count(b"\n"))
        if not self._decimal and (b'"' if self._separator == "," else b",") in block:
            self._decimal = self._mark(block.split(b"\n"))
        number, table = self._numbers(number, block)
        values = {name: column.factor * table[:, i] for i, (name, column) in enumerate(self.columns.items())}
        finite = np.asarray(np.isfinite(table).all(axis=1))
        for at in number[~finite]:
            self.broken.add(int(at), "a value is missing or not finite")
        possible = finite & (np.abs(values["time"]) <= _LATEST)
        for at in np.flatnonzero(finite & ~possible):
            self.broken.add(
                int(number[at]), f"time {values['time'][at]:.9g} s is beyond the limit of {_LATEST:g} s; check its unit"
            )
        column, speed = self.columns["train_speed"], values["train_speed"][possible]
        if not column.unit_given and np.sum(speed > _FASTEST) > _SHARE_FAST * len(speed):
            highest = f"{speed.max():.4g} m/s ({speed.max() / KMH:.4g} km/h)"
            remedy = "give `units` train_speed=km/h, or train_speed=m/s if this is right"
            raise InputError(
                f"{self.name}: column {column.header!r} has no unit, and in m/s its highest value, {highest}, is "
                f"implausible; {remedy}"
            )
        return Rows(number, values).where(possible)

    def _usual_count(self, block: bytes) -> int:
        # rows may end in a separator, which adds an empty cell, and may lack empty last cells
        lines = block.split(b"\n", _FIRST_ROWS)[:-1]
        most, separator = len(self._header.cells), self._separator.encode()
        least = max((i for i, cell in enumerate(self._header.cells, 1) if cell.strip()), default=most)
        counts = Counter((len(self._cells(line) or ()), line.endswith(separator)) for line in lines)
        usual = [count for (count, ends), _ in counts.most_common() if least <= count <= most + (1 if ends else 0)]
        return usual[0] if usual else 0

    def _numbers(self, number: Lines, text: bytes) -> tuple[Lines, Floats]:
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
            return number, self._table(number, text)
        lines = text.split(b"\n")[:-1]
        if len(lines) > _PIECE:
            parts = [slice(i, i + _PIECE) for i in range(0, len(lines), _PIECE)]
            parsed = [self._numbers(number[at], b"\n".join([*lines[at], b""])) for at in parts]
            return np.concatenate([each[0] for each in parsed]), np.concatenate([each[1] for each in parsed])
        rows = [self._row(line, self._decimal) for line in lines]
        for at, row in zip(number.tolist(), rows, strict=True):
            if isinstance(row, str):
                self.broken.add(at, row)
        good = [not isinstance(row, str) for row in rows]
        return number[good], np.array(list(itertools.compress(rows, good)), dtype=float).reshape(-1, len(self.columns))

    def _is_regular(self, block: bytes) -> bool:
        if block.translate(None, _REGULAR) or self._count > len(self._header.cells):
            return False
        codes = np.frombuffer(block, dtype=np.uint8)
        ends, separators = np.flatnonzero(codes == ord("\n")), np.flatnonzero(codes == ord(self._separator))
        return bool((np.diff(np.searchsorted(separators, ends), prepend=0) == self._count - 1).all())

    def _table(self, number: Lines, text: bytes) -> Floats:
        import pandas as pd

        indices = [column.index for column in self.columns.values()]
        frame = pd.read_csv(
            io.BytesIO(text),
            sep=self._separator,
            decimal=self._decimal or ".",
            header=None,
            names=list(range(self._count)),
            usecols=indices,
            dtype=np.float64,
            index_col=False,
            skip_blank_lines=False,
            encoding="latin-1",
        )
        if len(frame) != len(number):
            raise ValueError("rows")
        return np.asarray(frame[indices].to_numpy())

    def _mark(self, lines: Iterable[bytes]) -> str:
        marks: Counter[str | None] = Counter()
        for cells in map(self._cells, lines):
            for column in self.columns.values() if cells else ():
                if cells and column.index < len(cells) and (match := _MARK.fullmatch(cells[column.index].strip())):
                    marks[match.lastgroup] += 1
        return "" if not marks else "," if marks["comma"] > marks["point"] else "."

    def _cells(self, line: bytes) -> list[str] | None:
        split = split_cells([_decoded(line)], self._separator)
        return split and split[0]

    def _fault(self, line: bytes) -> str:
        if _CONTROL.search(line):
            nulls = line.count(b"\0")  # a power cut during recording leaves null bytes
            if nulls < 2:
                return "a control character or a carriage return within the line"
            return f"a control character, {nulls} null bytes, which may replace many rows and count as one line"
        line = _QUOTED.sub(b"", line)  # separators in quotes do not count
        if b'"' in line:
            return "an unpaired quotation mark"
        separator, own = self._separator.encode(), len(self._header.cells)
        count = line.count(separator) + 1
        whole = count == self._count and (count <= own or line.endswith(separator))
        return "" if whole else f"{count} cells where the header has {own}"

    def _row(self, line: bytes, decimal: str) -> list[float] | str:
        """Values of a line in the units of the file, or a message about its fault."""
        cells, values = self._cells(line), []
        if cells is None or len(cells) != self._count:
            return "quotation marks within a cell"
        for column in self.columns.values():
            cell = cells[column.index].strip()
            value = number_in(cell, decimal or ".") if cell else np.nan
            if value is None:
                if column.quantity == "time" and _DATE.match(cell):
                    return (
                        f"{shown(cell)} is a date or a time of day, not a number, column {column.header!r}; give the "
                        "time as a number, from any origin, in s or in the unit named in the header"
                    )
                self._grouped += _GROUPED.fullmatch(cell) is not None
                return f"{shown(cell)} is not a number, column {column.header!r}"
            values.append(value)
        return values
