"""Folders: the cache, and those to write into, whole files alone and by one process at a time."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

from .errors import InputError
from .processes import undisturbed

LOCK = ".lock"

INCOMPLETE = ".incomplete-"  #: what the name of a folder of unfinished files begins with
CACHE_VARIABLE = "RAILSLIP_CACHE"
"""Environment variable that names another folder for compiled kernels and cached results."""


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Lock a folder, made if missing, for this process alone; one that was made and stays empty is removed.

    The lock is the operating system's, and ends with the process. InputError where another process has it or the folder
    cannot be written to.
    """
    from filelock import FileLock, Timeout

    made = [one for one in (folder, *folder.parents) if not one.exists()]
    lock = FileLock(folder / LOCK)
    try:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            lock.acquire(timeout=0)
        except Timeout:
            raise InputError(
                f"out: {str(folder)!r} is being written to by another process; wait for it, or choose another folder"
            ) from None
        except OSError as error:
            raise unwritable(folder, error) from None
        yield
    finally:
        if lock.is_locked:
            with suppress(OSError):  # while it is held: who has opened it by now finds it gone, and makes another
                (folder / LOCK).unlink()
            lock.release()
        for one in made:
            with suppress(OSError):
                one.rmdir()


@contextmanager
def staged(folder: Path) -> Iterator[Path]:
    """A hidden folder inside `folder` to write files to: they are moved out of it, each in one step, at the end.

    After an error none is moved; an interruption waits until all are.
    """
    with tempfile.TemporaryDirectory(prefix=INCOMPLETE, dir=folder) as staging:
        yield Path(staging)
        with undisturbed():
            for path in sorted(Path(staging).iterdir()):
                os.replace(path, folder / path.name)


def unwritable(folder: Path, error: OSError) -> InputError:
    """The error of a folder that cannot be written to."""
    return InputError(
        f"out: {str(folder)!r} cannot be written to ({error.strerror or error}); make room or choose another folder"
    )


def cache_folder(kind: str = "kernels") -> Path:
    """Cache folder of a kind: in `RAILSLIP_CACHE`, or the user's; a temporary one if that cannot be written to."""
    from platformdirs import user_cache_path

    given = os.environ.get(CACHE_VARIABLE)
    folder = (Path(given) if given else user_cache_path("railslip_ctrl")) / kind
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        folder = _temporary() / kind
        folder.mkdir(exist_ok=True)
        return folder


@cache
def _temporary() -> Path:
    """A folder for this process and those that it starts from now on; removed at its end."""
    folder = tempfile.mkdtemp(prefix="railslip-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    os.environ[CACHE_VARIABLE] = folder
    return Path(folder)
