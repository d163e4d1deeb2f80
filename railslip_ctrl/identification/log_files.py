"""The bytes of a log: a file, gzipped or not, in UTF-8, Latin-1 or UTF-16, or standard input."""

from __future__ import annotations

import codecs
import gzip
import io
import os
import stat
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.user_files import file_name

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

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

    def readinto(self, buffer: WriteableBuffer) -> int:
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

    def readinto(self, buffer: WriteableBuffer) -> int:
        room = memoryview(buffer)
        data = self._text.read(len(room) // 4).encode()  # a character has four bytes at most
        room[: len(data)] = data
        return len(data)
