"""The header of a log: which column is which quantity, its unit, what separates the columns, where the rows begin.

A header cell is a name with or without a unit: "train speed [km/h]", "Wheel speed (km/h)", "brake_torque_kNm"; case,
spaces, underscores and hyphens do not count. `NAMES` has the names. n is what its unit says, and a wheel load without
one; a wheel speed in rad/s, rpm or the like is an angular one. Time, train speed, brake torque and one of the wheel's
two speeds must be there; other columns are not read.

The header is the first line that is neither empty nor a comment (#). Where that line has numbers already, it is the
last comment above it that names the columns, as NumPy writes it. A line of units may follow it.
"""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import shown, to_unit
from railslip_ctrl.core.user_files import close_match

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
            *("wheel angular speed", "omega", "w", "angular speed", "angular velocity", "rotational speed", "n"),
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
        "knm": "kN*m",
        "nm": "N*m",
        "kmh": "km/h",
        "kph": "km/h",
        "rads": "rad/s",
        "kn": "kN",
        "sec": "s",
        "rev/s": "turn/s",
    }
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


# --- the lines of the header --------------------------------------------------------------------------------------

COMMENT = b"#"

BLANKS = " "
"""The separator of cells apart by any number of spaces and tabs."""

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
    lines = _first_lines(readline)
    _check_begun(lines, name)
    text = _decoded(lines[-1], name)
    separator = _separator(text)
    cells = _cells_or_all(text, separator)
    if any(is_number(cell, ",") for cell in cells):
        return _from_comments([_decoded(line, name) for line in lines], lines[-1], name, columns, units)
    following = readline(_LONGEST_HEADER)
    whole = following.endswith(b"\n") and b"\0" not in following
    below = _cells_or_all(_decoded(following, name), separator) if whole else []
    try:
        found = find_columns(cells, columns, units)
        if _are_units(below, cells, found):
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


def is_number(text: str, decimal: str) -> bool:
    """Whether a cell is a number with a decimal mark."""
    if "_" in text:  # Python's digits, no log's
        return False
    try:
        float(text.strip().replace(decimal, "."))
    except ValueError:
        return False
    return True


def _first_lines(readline: Callable[[int], bytes]) -> list[bytes]:
    """The lines up to the first that is neither empty nor a comment."""
    lines: list[bytes] = []
    while sum(map(len, lines)) < _LONGEST_HEADER and (line := readline(_LONGEST_HEADER)):
        lines.append(line)
        if not _passed_over(line):
            break
    return lines


def _check_begun(lines: Sequence[bytes], name: str) -> None:
    if not lines or _passed_over(lines[-1]):
        raise InputError(f"{name}: the file is empty or has no header; give a CSV file with a header")
    if not lines[-1].endswith(b"\n"):
        _decoded(lines[-1], name)
        raise InputError(f"{name}: nothing after line {len(lines)}; give a CSV file with a header and rows")


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
        raise InputError(f"{name}: not a text file in UTF-8 or Latin-1; save it as CSV in UTF-8")
    try:
        text = line.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = line.decode("latin-1")
    return text.strip("\r\n")
