"""Texts of kernels: the functions of an adhesion law and what runs them, put together into one module."""

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


_HEAD = '''"""A simulation kernel, put together by railslip_ctrl.model.kernels: law {law!r}."""
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
    """Where |x| lies between two nodes, 0 to 1, and there: value and slope at the first, slope at the second, rise."""
    nodes = (table.size - 1) // 2
    place = abs(x) * table[0]
    i = min(int(place), nodes - 2)
    f0, d0, f1, d1 = table[1 + 2 * i], table[2 + 2 * i], table[3 + 2 * i], table[4 + 2 * i]
    return place - i, f0, d0, d1, f1 - f0


@compiled
def tabulated(x, *rest):
    """A function of the slip ratio, odd, by the cubic through values and slopes of the table, which comes last."""
    u, f0, d0, d1, rise = table_cell(x, rest[-1])
    value = f0 + u * (d0 + u * (3.0 * rise - 2.0 * d0 - d1 + u * (d0 + d1 - 2.0 * rise)))
    return value if x >= 0.0 else -value


@compiled
def tabulated_slope(x, *rest):
    """Its slope, even."""
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
# Only `run` allocates. Everything below it is put into it, without counting references to arrays at every call: three
# times as fast, a few per cent from the same loop in C. Python calls `run` alone: wrappers for the others would take a
# quarter of the time to compile.
COMPILED = """from numba import njit

inlined = {'forceinline': True, '_nrt': False, 'no_cpython_wrapper': True, 'no_cfunc_wrapper': True}
compiled = njit(nogil=True, error_model='numpy', **inlined)
entry = njit(cache=True, nogil=True, error_model='numpy')"""
_INTERPRETED = "\n\ndef compiled(function):\n    return function\n\n\nentry = compiled"

# the modules' own imports are of names that the put-together text defines itself
_IMPORTS = re.compile(r"^(from \S+ import (\([^)]*\)|.*)|import .*)\n", re.MULTILINE)


def scalar_source(law: type[AdhesionLaw]) -> str:
    """The functions of a law for a kernel."""
    return re.sub(r"^def ", "@compiled\ndef ", plain(source(law)), flags=re.MULTILINE)


def module_text(law: type[AdhesionLaw], *parts: str, compiled: bool = True) -> str:
    """A module of the functions of a law, then the parts; to be compiled or to be interpreted.

    Parts are texts as `plain` gives them. What Python calls is named `run` and marked `entry`.
    """
    head = _HEAD.format(law=law.name, marker=COMPILED if compiled else _INTERPRETED)
    return "\n".join([head, scalar_source(law), _STIFFNESS, *parts])


def plain(text: str) -> str:
    """A module's text without its docstring and imports, to be put into another."""
    return _IMPORTS.sub("", re.sub(r'\A""".*?"""\n', "", text, count=1, flags=re.DOTALL))


def prefixed(text: str, prefix: str) -> str:
    """The text with a prefix before the names of the functions it defines."""
    return re.sub(r"^def (\w+)\(", rf"def {prefix}\1(", text, flags=re.MULTILINE)


# --- what a kernel's text finds in its own module when it is put together: here only named and typed, for reading ----


F = TypeVar("F", bound=Callable[..., object])


def compiled(function: F) -> F:
    """Marks what numba compiles into the loop, and what may not allocate; in interpreted use it does nothing."""
    return function


def entry(function: F) -> F:
    """Marks what Python calls: compiled, cached, and free to allocate; in interpreted use it does nothing."""
    return function


def _filled_in(name: str) -> Callable[..., object]:
    def slot(*_: object) -> object:
        raise NotImplementedError(f"{name} is filled in where a kernel is put together")

    return slot


adhesion_force = _filled_in("adhesion_force")
command = _filled_in("command")
lag_rate = _filled_in("lag_rate")
law_control = _filled_in("law_control")
rates = _filled_in("rates")
rates_and_powers = _filled_in("rates_and_powers")
rest_state = _filled_in("rest_state")
stiffness = _filled_in("stiffness")


# --- kernels compiled by numba, and cached ---------------------------------------------------------------------------


logger = logging.getLogger(__name__)


@cache
def module_of(text: str, *, compiled: bool = True) -> ModuleType:
    """The module of a text (see `module_text`), ready to run; the same `compiled` as the text was made for."""
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
    """Log it, once in a process."""
    logger.warning("compiling the simulation, some seconds for each law and controller (kept in %s)", folder)


def _stored(name: str, text: str) -> Path:
    path = cache_folder() / f"{name}.py"
    if not path.is_file() or path.read_text("utf-8") != text:
        with staged(path.parent) as new:  # another process may be doing the same: the last wins, both are equal
            (new / path.name).write_text(text, encoding="utf-8")
    return path
