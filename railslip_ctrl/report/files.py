"""Writing a report's files so that an existing report is never left half-written."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.folders import INCOMPLETE, staged


def check_directory(directory: Path, names: Iterable[str]) -> None:
    """Raise InputError if files of these names could not be written into `directory`; it need not exist yet."""
    if str(directory) in ("", "."):
        raise InputError(
            "--out: the working folder itself is not taken, so that nothing in it is overwritten; name one"
        )
    existing = directory
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    if not _takes_a_folder(existing):
        raise InputError(f"--out: {str(directory)!r} cannot be made or written to; choose another folder")
    for name in names:
        if (directory / name).is_dir():
            raise InputError(f"--out: {str(directory / name)!r} is a folder; remove it or choose another folder")


def _takes_a_folder(directory: Path) -> bool:
    """Whether a folder can be made in a directory; tried, as rights alone do not tell (of /proc, say)."""
    try:
        with tempfile.TemporaryDirectory(prefix=INCOMPLETE, dir=directory):
            return True
    except OSError:
        return False


def check_file(path: Path, option: str) -> None:
    """Raise InputError, naming the option, if a file could not be written at `path`; its folder must exist."""
    if path.is_dir() or not path.name:
        raise InputError(f"{option}: {str(path)!r} is a folder; give a file name")
    if path.exists() and not path.is_file():  # a device or pipe would be replaced, not written to
        raise InputError(f"{option}: {str(path)!r} is not a regular file; choose another")
    if not path.parent.is_dir() or not os.access(path.parent, os.W_OK | os.X_OK):
        raise InputError(f"{option}: {str(path.parent)!r} is not a folder to write to; choose another")


def write_files(
    directory: Path, writers: Mapping[str, Callable[[Path], object]], *, option: str = "--out"
) -> list[Path]:
    """Write files into `directory` (made if missing), all or none.

    Parameters
    ----------
    directory : Path
    writers : mapping
        By file name, what writes that file at the path it is given.
    option : str
        What an error begins with.

    Returns
    -------
    list of Path
        The files, in order.

    Raises
    ------
    InputError
        The directory cannot be made or written to; what was there before is untouched.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with staged(directory) as new:
            for name, write in writers.items():
                write(new / name)
    except OSError as error:
        raise InputError(
            f"{option}: {str(directory)!r} cannot be written to ({error.strerror or error}); choose another folder"
        ) from None
    return [directory / name for name in writers]
