"""Texts of kernels: the scalar functions of an adhesion law and what runs them, put together into one module."""

from __future__ import annotations

import re

from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.model.scalar_code import scalar_source

_HEAD = '''"""A simulation kernel, put together by railslip_ctrl.model.kernels: law {law!r}."""
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


def module_text(law: type[AdhesionLaw], *parts: str, compiled: bool = True) -> str:
    """A module of the scalar functions of a law, then the parts; to be compiled or to be interpreted.

    Parts are texts as `plain` gives them. What Python calls is named `run` and marked `entry`.
    """
    head = _HEAD.format(law=law.name, marker=_COMPILED if compiled else _INTERPRETED)
    return "\n".join([head, plain(scalar_source(law)), *parts])


def plain(text: str) -> str:
    """A module's text without its docstring and imports, to be put into another."""
    return _IMPORTS.sub("", re.sub(r'\A""".*?"""\n', "", text, count=1, flags=re.DOTALL))


def prefixed(text: str, prefix: str) -> str:
    """The text with a prefix before the names of the functions it defines."""
    return re.sub(r"^def (\w+)\(", rf"def {prefix}\1(", text, flags=re.MULTILINE)
