"""Results that are the same from report to report, kept in the user's cache folder beside the compiled kernels.

A report by the same version finds them there; what depends on the vehicle, only if it is of the same one. What a result
is kept under is a hash of all source of this package, of the versions of what it computes with, and of what it was
computed for: nothing stale can be found.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

from .folders import cache_folder, staged

T = TypeVar("T")

_PACKAGE = Path(__file__).parents[1]

_MOST = 600
"""Results at most in the folder, some 100 MB: of those beyond, the ones that were longest not asked for go."""

_COMPUTES = ("numpy", "scipy", "sympy", "control", "numba")


def kept(name: str, compute: Callable[[], T], given: str = "", *, fresh: bool = False) -> T:
    """The result of `compute`, as found, or computed and kept.

    Parameters
    ----------
    name : str
        Of the result, a word.
    compute : callable
        Deterministic, of what `given` says and this package's source alone; not None.
    given : str
        What it is computed for.
    fresh : bool
        Compute it whatever is kept.
    """
    result: T | None = None if fresh else found(name, given)
    if result is None:
        result = compute()
        _keep(_path(name, given), pickle.dumps(result))
    return result


def found(name: str, given: str = "") -> Any:
    """What `kept` keeps under a name for what is given; None if nothing is."""
    path = _path(name, given)
    content = _content(path)
    if content is None:
        return None
    with suppress(OSError):
        os.utime(path)  # asked for now
    return pickle.loads(content)


def _path(name: str, given: str) -> Path:
    return cache_folder("results") / f"{name}-{_hash(given)}.pickle"


def _content(path: Path) -> bytes | None:
    """What is kept at a path; None if nothing, or not all of it, is there."""
    try:
        digest, content = path.read_bytes().split(b"\n", 1)
    except (OSError, ValueError):
        return None
    return content if hashlib.sha256(content).hexdigest().encode() == digest else None


def _keep(path: Path, content: bytes) -> None:
    """Write in one step; a folder that cannot be written to costs the next report some time, and this one nothing."""
    content = hashlib.sha256(content).hexdigest().encode() + b"\n" + content
    with suppress(OSError):
        with staged(path.parent) as new:
            (new / path.name).write_bytes(content)
        for old in sorted(path.parent.iterdir(), key=lambda one: -one.stat().st_mtime)[_MOST:]:
            old.unlink()


def _hash(given: str) -> str:
    return hashlib.sha256(f"{_of_code()} {given}".encode()).hexdigest()[:24]


@cache
def _of_code() -> str:
    """A hash of what computes."""
    digest = hashlib.sha256(" ".join([sys.version, *(f"{name} {version(name)}" for name in _COMPUTES)]).encode())
    for path in sorted(_PACKAGE.rglob("*.py")):
        digest.update(str(path.relative_to(_PACKAGE)).encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()
