"""The header of a log: the line that names the columns, what separates them, and where the rows begin.

The header is the first line that is neither empty nor a comment, which begins with #. Where that line has numbers
already, it is the last comment above it that names the columns, as NumPy writes it. A line of units may follow it.
"""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from railslip_ctrl.core.errors import InputError

from .columns import Column, find_columns, is_unit, with_units
from .log_files import LogFile

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
