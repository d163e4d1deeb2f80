"""Kernels compiled by numba, and kept.

A kernel is a module of its own in the user's cache folder, named by a hash of its text, so that numba's cache of
machine code lies beside it and nothing stale can be loaded. The first use of one compiles for some seconds and says
so; later ones load.
"""

from __future__ import annotations

import hashlib
import importlib.util
import logging
import os
import sys
import tempfile
from functools import cache
from pathlib import Path
from types import ModuleType

from railslip_ctrl.core.folders import cache_folder

logger = logging.getLogger(__name__)


@cache
def module_of(text: str, *, compiled: bool = True) -> ModuleType:
    """The module of a text (see `text.module_text`), ready to run; the same `compiled` as the text was made for."""
    name = f"railslip_kernel_{hashlib.sha256(text.encode()).hexdigest()[:24]}"
    if not compiled:
        module = ModuleType(name)
        exec(compile(text, f"<{name}>", "exec"), module.__dict__)
        return module
    path = _stored(name, text)
    if not any(path.parent.glob(f"__pycache__/{name}.run-*.nbi")):
        _tell_of_compiling(path.parent)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None, "a path that ends in .py has a specification"
    assert spec.loader is not None, "and a loader"
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # numba finds the functions of a cached module by its name
    spec.loader.exec_module(module)
    return module


@cache
def _tell_of_compiling(folder: Path) -> None:
    """Say it, once in a process however many pairs of law and controller it compiles."""
    logger.warning("compiling the simulation, some seconds for each law and controller (kept in %s)", folder)


def _stored(name: str, text: str) -> Path:
    path = cache_folder() / f"{name}.py"
    if not path.is_file() or path.read_text("utf-8") != text:
        with tempfile.NamedTemporaryFile("w", dir=path.parent, suffix=".tmp", delete=False, encoding="utf-8") as file:
            file.write(text)
        os.replace(file.name, path)  # another process may be doing the same: whichever comes last wins, both are equal
    return path
