"""Results cached from report to report, in the user's cache folder beside the compiled kernels.

The key is a hash of this package's source, of the versions of what it computes with, and of what a result is for.
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
