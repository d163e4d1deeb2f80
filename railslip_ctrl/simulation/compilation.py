"""Kernels: the text of a law, a controller and the loop put together, compiled by numba, and kept.

A kernel is a module of its own in the user's cache folder, named by a hash of its text, so that numba's cache of
machine code lies beside it and nothing stale can be loaded. The first use of a pair of law and controller compiles
for some seconds and says so; later ones load.
"""

from __future__ import annotations

import hashlib
import importlib.util
import logging
import os
import re
import sys
import tempfile
from functools import cache
from pathlib import Path
from types import ModuleType

from railslip_ctrl.adhesion import AdhesionLaw
from railslip_ctrl.scalar_code import scalar_source

logger = logging.getLogger(__name__)

CACHE_VARIABLE = "RAILSLIP_CACHE"
"""Environment variable that names another folder for compiled kernels, and for results that are kept."""

_HERE = Path(__file__).parent
_HEAD = '''"""A simulation kernel, put together by railslip_ctrl.simulation.compilation: law {law!r}."""
import math
from typing import NamedTuple

import numpy as np
{marker}


@compiled
def table_cell(x, table):
    """Where |x| lies between two nodes, 0 to 1, and there: value and slope at the first, slope at the second, rise."""
    nodes = (table.size - 1) // 2
    place = abs(x) * table[0]
    i = min(int(place), nodes - 2)
    f0, d0, f1, d1 = table[1 + 2 * i], table[2 + 2 * i], table[3 + 2 * i], table[4 + 2 * i]
    return place - i, f0, d0, d1, f1 - f0


@compiled
def tabulated(x, table):
    """A function of the slip ratio, odd, by the cubic through values and slopes."""
    u, f0, d0, d1, rise = table_cell(x, table)
    value = f0 + u * (d0 + u * (3.0 * rise - 2.0 * d0 - d1 + u * (d0 + d1 - 2.0 * rise)))
    return value if x >= 0.0 else -value


@compiled
def tabulated_slope(x, table):
    """Its slope, even."""
    u, _, d0, d1, rise = table_cell(x, table)
    return table[0] * (d0 + u * (2.0 * (3.0 * rise - 2.0 * d0 - d1) + u * 3.0 * (d0 + d1 - 2.0 * rise)))

'''
# Only `run` allocates. Everything below it is put into it, without counting references to arrays at every call: three
# times as fast, a few per cent from the same loop in C. Python calls `run` alone: wrappers for the others would take a
# quarter of the time to compile.
_COMPILED = """from numba import njit

inlined = {'forceinline': True, '_nrt': False, 'no_cpython_wrapper': True, 'no_cfunc_wrapper': True}
compiled = njit(nogil=True, error_model='numpy', **inlined)
entry = njit(cache=True, nogil=True, error_model='numpy')"""
_INTERPRETED = "\n\ndef compiled(function):\n    return function\n\n\nentry = compiled"

# the modules' own imports are of names that the put-together text defines itself
_IMPORTS = re.compile(r"^(from \S+ import (\([^)]*\)|.*)|import .*)\n", re.MULTILINE)


def kernel_text(law: type[AdhesionLaw], controller: str, *, compiled: bool = True) -> str:
    """The module of a law and a controller's source text (see `steps`), to be compiled or to be interpreted."""
    head = _HEAD.format(law=law.name, marker=_COMPILED if compiled else _INTERPRETED)
    return "\n".join([head, plain(scalar_source(law)), controller, plain((_HERE / "kernel.py").read_text("utf-8"))])


def step_text(name: str) -> str:
    """The source of a file of `steps/`, without its imports."""
    return plain((_HERE / "steps" / f"{name}.py").read_text("utf-8"))


def plain(text: str) -> str:
    """A module's text without its docstring and imports, to be put into another."""
    return _IMPORTS.sub("", re.sub(r'\A""".*?"""\n', "", text, count=1, flags=re.DOTALL))


def prefixed(text: str, prefix: str) -> str:
    """The text with a prefix before the names of the functions it defines."""
    return re.sub(r"^def (\w+)\(", rf"def {prefix}\1(", text, flags=re.MULTILINE)


@cache
def kernel(law: type[AdhesionLaw], controller: str, *, compiled: bool = True) -> ModuleType:
    """The kernel module, ready to run."""
    text = kernel_text(law, controller, compiled=compiled)
    name = f"railslip_kernel_{hashlib.sha256(text.encode()).hexdigest()[:24]}"
    if not compiled:
        module = ModuleType(name)
        exec(compile(text, f"<kernel for {law.name}>", "exec"), module.__dict__)
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


def cache_folder(kind: str = "kernels") -> Path:
    """Where a kind of thing is kept: `RAILSLIP_CACHE`, or the user's cache folder, or a temporary one if it is shut."""
    from platformdirs import user_cache_path

    given = os.environ.get(CACHE_VARIABLE)
    folder = (Path(given) if given else user_cache_path("railslip_ctrl")) / kind
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        return Path(tempfile.mkdtemp(prefix=f"railslip-{kind}-"))


def _stored(name: str, text: str) -> Path:
    path = cache_folder() / f"{name}.py"
    if not path.is_file() or path.read_text("utf-8") != text:
        with tempfile.NamedTemporaryFile("w", dir=path.parent, suffix=".tmp", delete=False, encoding="utf-8") as file:
            file.write(text)
        os.replace(file.name, path)  # another process may be doing the same: whichever comes last wins, both are equal
    return path
