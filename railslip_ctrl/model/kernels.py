"""Simulation kernels: Python modules assembled from the functions of an adhesion law and from code that calls them."""

from __future__ import annotations

import hashlib
import importlib.util
import logging
import re
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from railslip_ctrl.core.folders import cache_folder, staged

from .adhesion import AdhesionLaw
from .numeric import source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

_HEAD = '''"""A simulation kernel, assembled by railslip_ctrl.model.kernels: law {law!r}."""
import math
from typing import NamedTuple

import numpy
import numpy as np
{marker}


@compiled
def where(condition, one, other):
    return one if condition else other


@compiled
def table_cell(x, table):
    """Position of |x| in its interval, 0 to 1; value and slope at the first node; slope at the second; rise."""
    nodes = (table.size - 1) // 2
    place = abs(x) * table[0]
    i = min(int(place), nodes - 2)
    f0, d0, f1, d1 = table[1 + 2 * i], table[2 + 2 * i], table[3 + 2 * i], table[4 + 2 * i]
    return place - i, f0, d0, d1, f1 - f0


@compiled
def tabulated(x, *rest):
    """Force at the slip ratio x by cubic interpolation of the table, which is the last argument."""
    u, f0, d0, d1, rise = table_cell(x, rest[-1])
    value = f0 + u * (d0 + u * (3.0 * rise - 2.0 * d0 - d1 + u * (d0 + d1 - 2.0 * rise)))
    return value if x >= 0.0 else -value


@compiled
def tabulated_slope(x, *rest):
    """Derivative of `tabulated` with respect to the slip ratio."""
    u, _, d0, d1, rise = table_cell(x, rest[-1])
    return rest[-1][0] * (d0 + u * (2.0 * (3.0 * rise - 2.0 * d0 - d1) + u * 3.0 * (d0 + d1 - 2.0 * rise)))

'''
_STIFFNESS = """
adhesion_force = force


@compiled
def stiffness(v, sigma, z, Tb, Td, Tr, p, table):
    rows = jacobian(v, sigma, z, Tb, Td, Tr, p, table)
    return rows[1][1], rows[1][2], rows[2][1], rows[2][2]

"""
# Only `run` allocates memory and is called from Python. The other functions are inlined without reference counts of
# arrays, which makes a run three times as fast, and without wrappers, which would take a quarter of the compile time.
COMPILED = """from numba import njit

inlined = {'forceinline': True, '_nrt': False, 'no_cpython_wrapper': True, 'no_cfunc_wrapper': True}
compiled = njit(nogil=True, error_model='numpy', **inlined)
entry = njit(cache=True, nogil=True, error_model='numpy')"""
_INTERPRETED = "\n\ndef compiled(function):\n    return function\n\n\nentry = compiled"

_IMPORTS = re.compile(r"^(from \S+ import (\([^)]*\)|.*)|import .*)\n", re.MULTILINE)


def scalar_source(law: type[AdhesionLaw]) -> str:
    """Text of the numeric functions of an adhesion law, each with the decorator `compiled`."""
    return re.sub(r"^def ", "@compiled\ndef ", plain(source(law)), flags=re.MULTILINE)


def module_text(law: type[AdhesionLaw], *parts: str, compiled: bool = True) -> str:
    """Text of a kernel module: the functions of an adhesion law, then `parts`, texts of code that calls them.

    One part defines `run`, the function that Python calls. Numba compiles the module if `compiled` is True.
    """
    head = _HEAD.format(law=law.name, marker=COMPILED if compiled else _INTERPRETED)
    return "\n".join([head, scalar_source(law), _STIFFNESS, *parts])


def plain(text: str) -> str:
    """Remove docstring and imports from the text of a module."""
    return _IMPORTS.sub("", re.sub(r'\A""".*?"""\n', "", text, count=1, flags=re.DOTALL))


def prefixed(text: str, prefix: str) -> str:
    """Prefix the names of the functions that a text defines."""
    return re.sub(r"^def (\w+)\(", rf"def {prefix}\1(", text, flags=re.MULTILINE)


F = TypeVar("F", bound=Callable[..., object])


def compiled(function: F) -> F:
    """Mark a function that Numba inlines and that may not allocate memory."""
    return function


def entry(function: F) -> F:
    """Mark the function that Python calls; it may allocate memory."""
    return function


# for type checkers: the assembled kernel module defines the function
def _placeholder(name: str) -> Callable[..., object]:
    def undefined(*_: object) -> object:
        raise NotImplementedError(f"{name} is defined only in an assembled kernel module (see module_text)")

    return undefined


adhesion_force = _placeholder("adhesion_force")
command = _placeholder("command")
lag_rate = _placeholder("lag_rate")
law_control = _placeholder("law_control")
rates = _placeholder("rates")
rates_and_powers = _placeholder("rates_and_powers")
rest_state = _placeholder("rest_state")
stiffness = _placeholder("stiffness")

logger = logging.getLogger(__name__)


@cache
def module_of(text: str, *, compiled: bool = True) -> ModuleType:
    """Load a kernel text as a module; `compiled` must have the same value as in the call of `module_text`."""
    name = f"railslip_kernel_{hashlib.sha256(text.encode()).hexdigest()[:24]}"
    if not compiled:
        module = ModuleType(name)
        exec(compile(text, f"<{name}>", "exec"), module.__dict__)
        return module
    path = _stored(name, text)
    if not any(path.parent.glob(f"__pycache__/{name}.run-*.nbi")):
        _log_compiling(path.parent)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None, "a path that ends in .py has an import specification"
    assert spec.loader is not None, "a path that ends in .py has a loader"
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # numba finds the functions of a cached module by its name
    spec.loader.exec_module(module)
    return module


@cache  # one message per process
def _log_compiling(folder: Path) -> None:
    logger.warning("compiling the simulation, which takes some seconds per law and controller (stored in %s)", folder)


def _stored(name: str, text: str) -> Path:
    path = cache_folder() / f"{name}.py"
    if not path.is_file() or path.read_text("utf-8") != text:
        with staged(path.parent) as new:  # another process may write the same text at the same time
            (new / path.name).write_text(text, encoding="utf-8")
    return path
