"""logs"""

from __future__ import annotations

import codecs
import csv
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
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import shown, to_unit
from railslip_ctrl.model.parameters.validation import close_match, file_name

Floats = NDArray[np.float64]
Lines = NDArray[np.int64]


# --- rows ---


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


class BothSpeeds:
    """The two speeds of a wheel, where a log has both: by a straight line through nought, over all rows."""

    def __init__(self) -> None:
        self._product = self._square = 0.0

    def add(self, rows: Rows) -> None:
        """Take rows in."""
        rim, angular = rows.columns.get("wheel_speed"), rows.columns.get("wheel_angular_speed")
        if rim is not None and angular is not None:
            self._product += float(rim @ angular)
            self._square += float(angular @ angular)

    def ratio(self, radius: float) -> float:
        """Of the speed of the rim to the angular one times the radius, m; NaN where the log does not have both."""
        return self._product / (radius * self._square) if self._square > 0.0 else np.nan


# --- columns ---


UNITS: Mapping[str, str] = MappingProxyType(
    {
        "time": "s",
        "train_speed": "m/s",
        "wheel_speed": "m/s",
        "wheel_angular_speed": "rad/s",
        "brake_torque": "N*m",
        "wheel_load": "N",
    }
)
"""The quantities of a log and their SI units."""

NAMES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "time": ("time", "t", "timestamp"),
        "train_speed": ("train speed", "v", "vehicle speed", "speed", "reference speed"),
        "wheel_speed": ("wheel speed", "v wheel", "vw", "circumferential speed", "rolling speed"),
        "wheel_angular_speed": (
            "wheel angular speed",
            "omega",
            "w",
            "angular speed",
            "angular velocity",
            "rotational speed",
            "n",
        ),
        "brake_torque": ("brake torque", "tb", "torque", "braking torque"),
        "wheel_load": ("wheel load", "n", "load", "normal force", "axle load"),
    }
)
"""Accepted names by quantity, the first the one this package writes."""

# Spellings of measurement systems that a unit grammar does not know, or reads as something else: 1/min is rad/min to
# it, but revolutions a minute in a column of speeds.
_SPELLINGS = MappingProxyType(
    {
        **{"knm": "kN*m", "nm": "N*m", "kmh": "km/h", "kph": "km/h", "rads": "rad/s", "kn": "kN"},
        **{
            "1/min": "rpm",
            "min^-1": "rpm",
            "u/min": "rpm",
            "r/min": "rpm",
            "rev/min": "rpm",
            "rev/s": "turn/s",
            "sec": "s",
        },
    }
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

    Parameters
    ----------
    header : sequence of str
        The header's cells.
    columns : mapping, optional
        Header cell by quantity, where the names above do not find it; or its place, the first being 1.
    units : mapping, optional
        Unit by quantity; wins over the header's. Without either a column is SI.

    Raises
    ------
    InputError
        An unknown quantity, a header that is not there, two columns of one name, a missing column, or a unit of
        another dimension.
    """
    columns, units = columns or {}, units or {}
    for option, given in (("--column", columns), ("--unit", units)):
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
    _check_complete(found, header)
    return found


def with_units(header: Sequence[str], units: Sequence[str]) -> list[str]:
    """A header's cells, each with its unit of a row of them, but for those that have one; `-` and nothing are none."""
    given = [_bare(unit) for unit in units]
    return [
        f"{cell.strip()} [{unit}]" if unit not in ("", "-") and not _split(cell)[1] else cell
        for cell, unit in zip(header, given, strict=True)
    ]


def is_unit(cell: str, quantity: str) -> bool:
    """Whether a cell is a unit of a quantity, in brackets or not."""
    try:
        return _column(quantity, 0, f"x [{_bare(cell)}]", None).unit_given
    except InputError:
        return False


def _bare(unit: str) -> str:
    return unit.strip().strip("[]()").strip()


def _named(header: Sequence[str], quantity: str, wanted: str) -> int:
    at = [i for i, cell in enumerate(header) if wanted.strip() in (cell.strip(), _split(cell)[0])]
    if not at and _PLACE.fullmatch(wanted.strip()) and int(wanted) <= len(header):
        return int(wanted) - 1
    if len(at) != 1:
        count = f"{len(at)} columns are" if at else "no column is"
        hint = close_match(wanted, header)
        raise InputError(
            f"--column {quantity}: {count} called {shown(wanted)}; {hint}the header has {_cells(header)}{_places(at)}"
        )
    return at[0]


def _places(at: Sequence[int]) -> str:
    """How columns that may have one name are told apart."""
    return f", or by its place: {' or '.join(str(i + 1) for i in at)}" if len(at) > 1 else ""


def _recognised(header: Sequence[str], quantity: str) -> int | None:
    names = {_plain(name) for name in NAMES[quantity]}
    at = [
        i
        for i, cell in enumerate(header)
        if {_plain(cell), _plain(_split(cell)[0])} & names and _may_be(cell, quantity)
    ]
    if len(at) > 1:
        raise _several(quantity, header, at)
    return at[0] if at else None


def _several(quantity: str, header: Sequence[str], at: Sequence[int]) -> InputError:
    cells = _cells([header[i] for i in at])
    return InputError(
        f"header: {quantity} may be any of {cells}; say which with --column {quantity}=HEADER{_places(at)}"
    )


def _may_be(cell: str, quantity: str) -> bool:
    """Whether a cell is not one of a letter that stands for another quantity: n [1/min] is no load."""
    name, unit = _split(cell)
    if _plain(name) != "n":
        return True
    return is_unit(unit, quantity) if unit else quantity == "wheel_load"


def _column(quantity: str, index: int, cell: str, unit: str | None) -> Column:
    in_header = _split(cell)[1]
    given = unit if unit is not None else in_header
    if not given:
        return Column(quantity, index, cell.strip(), 1.0, unit_given=False)
    if quantity == "wheel_speed" and is_unit(given, "wheel_angular_speed"):
        quantity = "wheel_angular_speed"
    spelled = _SPELLINGS.get(given.strip().lower(), given.strip())
    where = f"--unit {quantity}" if unit is not None else f"header, column {cell.strip()!r}"
    try:
        factor = to_unit(f"1 {spelled}", UNITS[quantity])
    except InputError:
        raise InputError(
            f"{where}: {shown(given)} is not a unit of {quantity}; give one convertible to {UNITS[quantity]!r}, "
            f"in the header or as --unit {quantity}=UNIT"
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


def _check_complete(found: Mapping[str, Column], header: Sequence[str]) -> None:
    wheel = ("wheel_angular_speed", "wheel_speed")
    missing = [q for q in ("time", "train_speed", "brake_torque") if q not in found]
    if not any(q in found for q in wheel):
        missing.append("wheel_speed")
    if missing:
        quantity = missing[0]
        called = " or ".join(repr(name) for name in NAMES[quantity][:2])
        raise InputError(
            f"header: no column for {quantity}; call one {called}, or give --column {quantity}=HEADER "
            f"(the header has {_cells(header)})"
        )


# --- log files ---


STANDARD_INPUT = "-"
"""The path that stands for standard input."""

_GZIP = b"\x1f\x8b"
_UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_OTHER_FORMATS = {
    b"PK\x03\x04": "a ZIP archive or an Excel workbook",
    b"\xd0\xcf\x11\xe0": "an Excel workbook",
    b"BZh": "packed with bzip2",
    b"\xfd7zXZ": "packed with xz",
    b"\x28\xb5\x2f\xfd": "packed with zstd",
    b"MDF ": "an MDF recording",
    b"TDSm": "a TDMS recording",
}
_BUFFER_BYTES = 1 << 16


class LogFile:
    """A log's bytes from its beginning, read once: unpacked, UTF-16 as UTF-8, everything else as it is.

    Parameters
    ----------
    path : Path
        A regular file, or `STANDARD_INPUT`.

    Raises
    ------
    InputError
        No such file, no regular one, one that cannot be read, or one of a format that is no text; while reading also
        a disk or a network that fails.
    """

    def __init__(self, path: Path) -> None:
        standard = str(path) == STANDARD_INPUT
        self.name = "standard input" if standard else file_name(path)
        self._unpacked: _Unpacked | None = None
        self._position = 0
        try:
            file = _standard_input(self.name) if standard else _regular(path, self.name)
        except (OSError, ValueError) as error:  # ValueError: a null character in the path
            raise error if isinstance(error, InputError) else self._unreadable(error) from None
        self._raw = io.BufferedReader(file)
        self._size = 0 if standard else os.fstat(file.fileno()).st_size
        try:
            self._file = self._decoded()
        except (OSError, InputError) as error:
            file.close()
            raise error if isinstance(error, InputError) else self._unreadable(error) from None

    def read(self, count: int) -> bytes:
        """That many bytes; less only at the end."""
        data = self._tried(self._file.read, count)
        self._position = self._raw.tell() if self._size else 0
        return data

    def readline(self, longest: int) -> bytes:
        """A line with its end, or as much of it as allowed."""
        return self._tried(self._file.readline, longest)

    def _tried(self, method: Callable[[int], bytes], count: int) -> bytes:
        try:
            return method(count)
        except OSError as error:
            raise self._unreadable(error) from None

    @property
    def share(self) -> float:
        """Of the file, what has been read, 0 to 1; 0 of standard input, whose end is not known."""
        return self._position / self._size if self._size else 0.0

    @property
    def damage(self) -> str:
        """What ended a gzipped file before its end; empty where nothing did."""
        return "" if self._unpacked is None else self._unpacked.damage

    def close(self) -> None:
        """Close the file; standard input stays open."""
        self._file.close()
        self._raw.close()

    def _decoded(self) -> io.BufferedReader[Any]:
        file: io.BufferedReader[Any] = self._raw
        if self._beginning(file).startswith(_GZIP):
            self._unpacked = _Unpacked(file)
            file = io.BufferedReader(self._unpacked, _BUFFER_BYTES)
        if self._beginning(file).startswith(_UTF_16):
            file = io.BufferedReader(_Recoded(file), _BUFFER_BYTES)
        return file

    def _beginning(self, file: io.BufferedReader[Any]) -> bytes:
        beginning = file.peek(8)
        for magic, what in _OTHER_FORMATS.items():
            if beginning.startswith(magic):
                raise InputError(f"{self.name}: is {what}; give a CSV file, gzipped or not")
        return beginning

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


class _Unpacked(io.RawIOBase):
    """What a gzipped file holds, up to where it is damaged."""

    def __init__(self, file: io.BufferedReader[Any]) -> None:
        self._file = gzip.GzipFile(fileobj=file)
        self.damage = ""

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        room = memoryview(buffer)
        try:
            data = b"" if self.damage else self._file.read1(len(room))
        except EOFError:
            data, self.damage = b"", "ends early: the lines from here on are lost"
        except zlib.error as error:
            data, self.damage = b"", f"is damaged ({error}): the lines from here on are lost"
        except gzip.BadGzipFile as error:  # found at its end
            data, self.damage = b"", f"is damaged ({error}): a line before may be wrong"
        room[: len(data)] = data
        return len(data)


class _Recoded(io.RawIOBase):
    """A file in UTF-16 with its byte order mark, as UTF-8; what is none is replaced, and shows in its line."""

    def __init__(self, file: io.BufferedReader[Any]) -> None:
        self._text = io.TextIOWrapper(file, encoding="utf-16", errors="replace", newline="")

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        room = memoryview(buffer)
        data = self._text.read(len(room) // 4).encode()  # a character has four bytes at most
        room[: len(data)] = data
        return len(data)


# --- header ---


COMMENT = b"#"

BLANKS = " "
"""The separator of cells apart by any number of spaces and tabs."""

_SEPARATORS = (";", "\t", ",")
_LONGEST_HEADER = 64 << 10  # bytes, with the comments before it
_WORDS = re.compile(r"\s+(?![\[(])")  # a unit in brackets belongs to the name before it


@dataclass(frozen=True)
class Header:
    """How the rows are read.

    Attributes
    ----------
    cells : tuple of str
        The header's cells.
    columns : dict of Column
        By quantity.
    separator : str
        Of the rows' cells.
    next_line : int
        The number of the line after the header, or of the first row where it is `pending`.
    pending : bytes
        A line that was read already and belongs to the rows; empty if none.
    """

    cells: tuple[str, ...]
    columns: dict[str, Column]
    separator: str
    next_line: int
    pending: bytes


def read_header(file: LogFile, columns: Mapping[str, str] | None, units: Mapping[str, str] | None) -> Header:
    """The header of a log that is at its beginning; `columns` and `units` as of `find_columns`.

    Raises
    ------
    InputError
        One line with the file and what is wrong: empty, not text, no header, nothing after it, a column or a unit.
    """
    lines = _first_lines(file)
    _check_begun(lines, file.name)
    text = _decoded(lines[-1], file.name)
    separator = _separator(text)
    cells = _cells_or_all(text, separator)
    if any(is_number(cell, ",") for cell in cells):
        return _from_comments([_decoded(line, file.name) for line in lines], lines[-1], file.name, columns, units)
    following = file.readline(_LONGEST_HEADER)
    whole = following.endswith(b"\n") and b"\0" not in following
    below = _cells_or_all(_decoded(following, file.name), separator) if whole else []
    try:
        found = find_columns(cells, columns, units)
        if _are_units(below, cells, found):
            named = find_columns(with_units(cells, below), columns, units)
            return Header(tuple(cells), named, separator, len(lines) + 2, b"")
        return Header(tuple(cells), found, separator, len(lines) + 1, following)
    except InputError as error:
        raise InputError(f"{file.name}: {error}") from None


def split_cells(text: str, separator: str) -> list[str] | None:
    """The cells of a line; None where quotation marks are not as CSV has them."""
    if separator == BLANKS:
        return _WORDS.split(text.strip())
    try:
        return next(csv.reader([text], delimiter=separator, strict=True), [])
    except csv.Error:
        return None


def is_number(text: str, decimal: str) -> bool:
    """Whether a cell is a number with a decimal mark."""
    if "_" in text:  # Python's digits, no log's
        return False
    try:
        float(text.strip().replace(decimal, "."))
    except ValueError:
        return False
    return True


def _first_lines(file: LogFile) -> list[bytes]:
    """The lines up to the first that is neither empty nor a comment."""
    lines: list[bytes] = []
    while sum(map(len, lines)) < _LONGEST_HEADER and (line := file.readline(_LONGEST_HEADER)):
        lines.append(line)
        if not _passed_over(line):
            break
    return lines


def _check_begun(lines: Sequence[bytes], name: str) -> None:
    if not lines or _passed_over(lines[-1]):
        raise InputError(f"{name}: the file is empty or has no header; give a CSV file with a header")
    if not lines[-1].endswith(b"\n"):
        _decoded(lines[-1], name)
        ends = "; lines must end in \\n, not in \\r" if b"\r" in lines[-1] else ""
        raise InputError(f"{name}: nothing after line {len(lines)}; give a CSV file with a header and rows{ends}")


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
        cells = _cells_or_all(text, _separator(text))
        separator = _separator_of(lines[-1], len(cells))
        if separator is None or any(is_number(cell, ",") for cell in cells):
            continue
        try:
            return Header(tuple(cells), find_columns(cells, columns, units), separator, len(lines), first_row)
        except InputError as error:  # another comment may name them; else this one was meant
            failure = failure or InputError(f"{name}: {error}")
    raise failure or InputError(
        f"{name}: line {len(lines)}: no header, but numbers; name the columns in a line above, with their units"
    )


def _are_units(row: Sequence[str], header: Sequence[str], found: Mapping[str, Column]) -> bool:
    """Whether the row below a header is one of units: no numbers, and a unit of its column at least once."""
    if len(row) != len(header) or any(is_number(cell, ",") for cell in row):
        return False
    return any(is_unit(row[column.index], column.quantity) for column in found.values())


def _separator(text: str) -> str:
    return next((s for s in _SEPARATORS if s in text), BLANKS if len(_WORDS.split(text.strip())) > 1 else ",")


def _separator_of(row: str, count: int) -> str | None:
    """The separator that parts a row into so many cells, two at least; an empty one more at its end is none."""
    for separator in (*_SEPARATORS, BLANKS):
        cells = split_cells(row, separator) or [row]
        if count > 1 and (len(cells) == count or (len(cells) == count + 1 and not cells[-1].strip())):
            return separator
    return None


def _cells_or_all(text: str, separator: str) -> list[str]:
    return split_cells(text, separator) or [text]


def _passed_over(line: bytes) -> bool:
    text = line.removeprefix(codecs.BOM_UTF8).strip()
    return not text or text.startswith(COMMENT)


def _decoded(line: bytes, name: str) -> str:
    """A line's text without its end."""
    if b"\0" in line:
        raise InputError(f"{name}: not a text file in UTF-8, UTF-16 with its mark, or Latin-1; save it as CSV in UTF-8")
    try:
        text = line.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = line.decode("latin-1")
    return text.strip("\r\n")


# --- stamps ---


BESIDE = 16
"""Rows on either side among which a stamp that is left out must be the only one out of order."""

FAR = 100.0
"""How far from both its neighbours a stamp that is left out must be, in usual intervals: the median of those beside it.

A stamp that is nearer is a row out of its place, or a clock set back.
"""

_LEAST_BESIDE = 4  # other stamps, without which nothing tells the usual interval

# A stamp jumps ahead where its step is this many times the way back to the next one; neighbours exchanged have less.
_JUMP = 5.0
_STAMPS_KEPT = 64  # rows judged already: neighbours of those to come, and among them a jump is looked for


class StampFilter:
    """Leaves out rows whose time stamp is an outlier, and refuses time that does not grow without them.

    An outlier is a single stamp that is more than `FAR` usual intervals away from both its neighbours, while without it
    time grows over the `BESIDE` rows on either side of it: a glitch. At the ends of a log it has one neighbour. Two in
    a row, or two within `BESIDE` rows, are a second clock as well, so they are refused; so are a stamp that repeats
    another or steps back by less. A stamp far ahead that time then goes on from is a gap; so is one in the last row,
    and one far behind in the first, as nothing tells it from a pause.

    Rows come in blocks of any size and the result does not depend on it: the last rows wait for the next block.

    Parameters
    ----------
    name : str
        Of the log, for errors.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.count = 0
        self.named: list[str] = []
        self._waiting: Rows | None = None
        self._before = 0  # rows at the front of `_waiting` that are judged already

    def add(self, rows: Rows) -> Rows:
        """The rows that can be judged now, without the outliers; InputError where time does not grow."""
        together = rows if self._waiting is None else self._waiting.then(rows)
        stop = len(together) - BESIDE - 1
        if stop <= self._before:
            self._waiting = together
            return together.part(0, 0)
        return self._judged(together, stop)

    def finish(self) -> Rows | None:
        """The rows that were waiting, at the end of the log; InputError where time does not grow."""
        if self._waiting is None:
            return None
        return self._judged(self._waiting, len(self._waiting))

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was left out, a sentence each."""
        more = self.count - len(self.named)
        return (*self.named, f"{self.count} rows with outlying time stamps in all") if more else tuple(self.named)

    def _judged(self, rows: Rows, stop: int) -> Rows:
        time, start = rows.columns["time"], self._before
        bad = self._outliers(rows.line, time, start, stop)[start:stop]
        found = rows.part(start, stop)
        self.count += int(bad.sum())
        for line, stamp in zip(found.line[bad], found.columns["time"][bad], strict=True):
            if len(self.named) < _MOST_NAMED:
                self.named.append(f"line {line}: time {stamp:.9g} s stands apart from those beside it; it is left out")
        keep_from = max(0, stop - _STAMPS_KEPT)
        self._waiting, self._before = rows.part(keep_from, None), stop - keep_from
        return found.where(~bad) if bad.any() else found

    def _outliers(self, lines: Lines, time: Floats, start: int, stop: int) -> NDArray[np.bool_]:
        """Which stamps are outliers, true for those from `start` to `stop`."""
        bad = np.zeros(len(time), dtype=bool)
        # the step into the first row was judged with the rows before, but tells whether the first row is the outlier
        first, end = max(start - 1, 0), min(stop, len(time) - 1)
        for i in first + np.flatnonzero(time[first + 1 : end + 1] <= time[first:end]):
            outlier = _outlier(time, int(i))
            if outlier is None:
                raise InputError(f"{self.name}: {_complaint(lines, time, int(i) + 1)}; give times that grow")
            bad[outlier] = True
        return bad


def _outlier(time: Floats, i: int) -> int | None:
    """Of the stamps i and i+1, the latter not later, the one that is an outlier; None where neither is."""
    # where both may be, that with two neighbours
    for at in (i, i + 1) if i > 0 else (i + 1, i):
        low = max(at - BESIDE, 0)
        others = np.delete(time[low : at + BESIDE + 1], at - low)
        steps = np.diff(others)
        if len(others) < _LEAST_BESIDE or not (steps > 0.0).all():
            continue
        beside = others[max(at - low - 1, 0) : at - low + 1]
        if np.abs(time[at] - beside).min() > FAR * np.median(steps):
            return at
    return None


def _complaint(lines: Lines, time: Floats, at: int) -> str:
    """What is wrong with the stamp at a place, which is not later than that before it."""
    earlier = np.flatnonzero(time[:at] < time[at])
    sound = int(earlier[-1]) + 1 if len(earlier) else 0  # from here on stamps are later than that at the place
    if 0 < sound < at and time[sound] - time[sound - 1] > _JUMP * (time[at] - time[sound - 1]):
        return (
            f"line {lines[sound]}: time jumps from {time[sound - 1]:.9g} s to {time[sound]:.9g} s, "
            f"but line {lines[at]} has {time[at]:.9g} s"
        )
    kind = "repeats" if time[at] == time[at - 1] else "goes back from"
    return f"line {lines[at]}: time {time[at]:.9g} s {kind} {time[at - 1]:.9g} s"


# --- logs ---


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
