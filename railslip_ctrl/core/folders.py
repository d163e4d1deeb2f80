"""Output folders, and a cache of compiled kernels and results. Files appear in a folder only when they are complete.

The key of a cached result is a hash of the package's source, of the versions of Python and of the numerical
dependencies, and of the inputs of the result.
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

LOCK = ".lock"  #: name of the lock file in an output folder
INCOMPLETE = ".incomplete-"  #: prefix of the names of folders with unfinished files
CACHE_VARIABLE = "RAILSLIP_CACHE"  #: name of the environment variable that sets the folder of the cache


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Lock a folder for this process during the `with` block; create it if it is missing.

    A folder that was created is removed at the end of the block if it is empty. The operating system releases the lock
    when the process ends. InputError if another process has the lock or the folder cannot be written to.
    """
    from filelock import FileLock, Timeout

    made = [path for path in (folder, *folder.parents) if not path.exists()]
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
            # delete before the release: a waiting process with the open file detects this and creates a new file
            with suppress(OSError):
                (folder / LOCK).unlink()
            lock.release()
        for path in made:
            with suppress(OSError):
                path.rmdir()


@contextmanager
def staged(folder: Path) -> Iterator[Path]:
    """Yield a hidden folder inside `folder`; at the end of the `with` block its files are moved to `folder`.

    After an error no file is moved. Ctrl-C and SIGTERM take effect when all files are moved.
    """
    with tempfile.TemporaryDirectory(prefix=INCOMPLETE, dir=folder) as staging:
        yield Path(staging)
        with undisturbed():
            for path in sorted(Path(staging).iterdir()):
                os.replace(path, folder / path.name)


def unwritable(folder: Path, error: OSError) -> InputError:
    """Return the InputError for an output folder that cannot be written to."""
    return InputError(
        f"out: {str(folder)!r} cannot be written to ({error.strerror or error}); free space or choose another folder"
    )


def cache_folder(kind: str = "kernels") -> Path:
    """Return the folder `kind` in the cache, or in a temporary folder if the cache is not writable."""
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
    """Return the secret text in the file `name` of the cache folder `kind`; only the user can read the file.

    If the file is missing, readable by others, or of another length than `made`, the text `made` is returned. It is
    also stored in the file, if the folder is writable.
    """
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
    folder = tempfile.mkdtemp(prefix="railslip-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    os.environ[CACHE_VARIABLE] = folder  # for the processes that this process starts
    return Path(folder)


_PACKAGE = Path(__file__).parents[1]

_MOST = 600  # largest number of cached results, about 100 MB; the least recently used are deleted
_COMPUTES = ("numpy", "scipy", "sympy", "control", "numba")  # dependencies whose version may change a result


def cached(name: str, compute: Callable[[], T], given: str = "", *, fresh: bool = False) -> T:
    """Return the result of `compute` from the cache; if the cache does not have it, compute and store it.

    - name: one word; beginning of the file name.
    - compute: function without arguments. The result must not be None, and depend only on `given` and the package.
    - given: all inputs of the computation as text.
    - fresh: if True, compute the result even if the cache has it.
    """
    result: T | None = None if fresh else look_up(name, given)
    if result is None:
        result, path = compute(), _path(name, given)
        content = pickle.dumps(result)
        with suppress(OSError):  # if the cache is not writable, the next call computes the result again
            with staged(path.parent) as new:
                (new / path.name).write_bytes(hashlib.sha256(content).hexdigest().encode() + b"\n" + content)
            for old in sorted(path.parent.iterdir(), key=lambda file: -file.stat().st_mtime)[_MOST:]:
                old.unlink()
    return result


def look_up(name: str, given: str = "") -> Any:
    """Return the result that `cached` has stored for `name` and `given`; None if nothing is stored."""
    path = _path(name, given)
    try:
        digest, content = path.read_bytes().split(b"\n", 1)
    except (OSError, ValueError):
        return None
    if hashlib.sha256(content).hexdigest().encode() != digest:  # the file is incomplete
        return None
    with suppress(OSError):
        os.utime(path)  # the time of last use
    return pickle.loads(content)


def _path(name: str, given: str) -> Path:
    key = hashlib.sha256(f"{_of_code()} {given}".encode()).hexdigest()[:24]
    return cache_folder("results") / f"{name}-{key}.pickle"


@cache
def _of_code() -> str:
    digest = hashlib.sha256(" ".join([sys.version, *(f"{name} {version(name)}" for name in _COMPUTES)]).encode())
    for path in sorted(_PACKAGE.rglob("*.py")):
        digest.update(str(path.relative_to(_PACKAGE)).encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()
