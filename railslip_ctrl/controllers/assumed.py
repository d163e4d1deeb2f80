"""The force of an adhesion law that a controller assumes, at rest, in the language of steps.

A law in closed form has its generated functions (`model.numeric`) written again with named parameters. A law without
one is read from the table that kernels have too (`model.kernels`).
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable
from functools import cache
from typing import Any

from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.model.numeric import has_table, source
from railslip_ctrl.sliding.law import module_of

BEFORE_LOAD = 7
"""Numbers of the plant before the wheel load in the generated functions' `p`; no force reads them."""

# what the generated text has, and what stands for it in a step
_REPLACED: tuple[tuple[str, str | Callable[[re.Match[str]], str]], ...] = (
    (r"\bnumpy\.sign\(", "sign("),
    (r"\bnumpy\.arctan\(", "math.atan("),
    (r"\bnumpy\.", "math."),
    (r"\b_x(?=\d)", "x"),
    (r"\bp\[(\d+)\]", lambda found: f"p.assumed[{int(found[1]) - BEFORE_LOAD}]"),
    (r", z, Tb, Td, Tr, p, \*nodes", ", z, p"),
)
_HEAD = '''import math


def sign(x):
    """sgn x."""
    return 1.0 if x > 0.0 else (-1.0 if x < 0.0 else 0.0)


def where(condition, one, other):
    """The first number if the condition holds, else the second."""
    return one if condition > 0.0 else other


'''
_LAST = '''

def assumed_force(v, sigma, p):
    """Adhesion force, N, at rest at a train speed and a slip velocity, m/s."""
    return force(v, sigma, rest_state(v, sigma, 0.0, p), p)
'''


@cache
def force_of(law: type[AdhesionLaw]) -> Callable[..., Any]:
    """The function of (v, sigma, parameters) of a law: `parameters.assumed` has the wheel load (N) and the law's
    parameters, `parameters.assumed_table` the table of a law without closed form."""
    if has_table(law):
        return _force_from_table
    functions = {one.name: one for one in ast.parse(source(law)).body if isinstance(one, ast.FunctionDef)}
    text = "\n\n\n".join(ast.unparse(functions[name]) for name in ("force", "rest_state"))
    for pattern, replacement in _REPLACED:
        text = re.sub(pattern, replacement, text)
    function: Callable[..., Any] = module_of(_HEAD + text + _LAST).assumed_force
    return function


def _force_from_table(v: Any, sigma: Any, p: Any) -> Any:
    """Adhesion force, N, at a train speed and a slip velocity, m/s: `tabulated` of a kernel."""
    table_cells = int(0.5 * len(p.assumed_table)) - 1
    place = abs(sigma / v) * p.assumed_table[0]
    i = int(min(table_cells - 1.0, place))
    u = place - i
    f0, d0 = p.assumed_table[1 + 2 * i], p.assumed_table[2 + 2 * i]
    f1, d1 = p.assumed_table[3 + 2 * i], p.assumed_table[4 + 2 * i]
    rise = f1 - f0
    value = f0 + u * (d0 + u * (3.0 * rise - 2.0 * d0 - d1 + u * (d0 + d1 - 2.0 * rise)))
    return value if sigma >= 0.0 else -value
