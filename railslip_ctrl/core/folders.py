"""Output folders and the cache. Files are written whole, by one process at a time.

Results are cached from report to report beside the compiled kernels, by a hash of this package's source, of the
versions of what it computes with, and of what a result is for.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import pickle
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

from .errors import InputError
from .processes import undisturbed

T = TypeVar("T")

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


def private_text(kind: str, name: str, made: str) -> str:
    """A secret of a `name` in the cache folder of a kind, that only the user may read: the one of last time, or the one
    `made` now, if there is none as long; it is lost where it cannot be written."""
    path = cache_folder(kind) / name
    with suppress(OSError, UnicodeDecodeError):
        known = path.read_text("ascii")
        if path.stat().st_mode & 0o077 == 0 and len(known) == len(made):
            return known
    with suppress(OSError):
        path.unlink(missing_ok=True)
        with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
            file.write(made)
    return made


@cache
def _temporary() -> Path:
    """A folder for this process and those that it starts from now on; removed at its end."""
    folder = tempfile.mkdtemp(prefix="railslip-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    os.environ[CACHE_VARIABLE] = folder
    return Path(folder)


_PACKAGE = Path(__file__).parents[1]

_MOST = 600  # results in the folder, some 100 MB: beyond, those that were longest not asked for go
_COMPUTES = ("numpy", "scipy", "sympy", "control", "numba")


def cached(name: str, compute: Callable[[], T], given: str = "", *, fresh: bool = False) -> T:
    """The result of `compute` by its `name`, a word, from the cache or computed now (always if `fresh`) and put there.

    `compute` depends on what `given` says and this package's source alone; its result is not None.
    """
    result: T | None = None if fresh else look_up(name, given)
    if result is None:
        result, path = compute(), _path(name, given)
        content = pickle.dumps(result)
        with suppress(OSError):  # a folder that cannot be written to costs the next report some time, and this one none
            with staged(path.parent) as new:
                (new / path.name).write_bytes(hashlib.sha256(content).hexdigest().encode() + b"\n" + content)
            for old in sorted(path.parent.iterdir(), key=lambda one: -one.stat().st_mtime)[_MOST:]:
                old.unlink()
    return result


def look_up(name: str, given: str = "") -> Any:
    """What `cached` has put there under a name for what is given; None if nothing."""
    path = _path(name, given)
    try:
        digest, content = path.read_bytes().split(b"\n", 1)
    except (OSError, ValueError):
        return None
    if hashlib.sha256(content).hexdigest().encode() != digest:  # not all of it is there
        return None
    with suppress(OSError):
        os.utime(path)  # asked for now
    return pickle.loads(content)


def _path(name: str, given: str) -> Path:
    key = hashlib.sha256(f"{_of_code()} {given}".encode()).hexdigest()[:24]
    return cache_folder("results") / f"{name}-{key}.pickle"


@cache
def _of_code() -> str:
    """A hash of what computes."""
    digest = hashlib.sha256(" ".join([sys.version, *(f"{name} {version(name)}" for name in _COMPUTES)]).encode())
    for path in sorted(_PACKAGE.rglob("*.py")):
        digest.update(str(path.relative_to(_PACKAGE)).encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()
