"""Functions for a controller's method `step`: static force of the adhesion law that the controller assumes."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable
from functools import cache
from typing import Any

from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.model.numeric import has_table, source
from railslip_ctrl.sliding.law import module_of

BEFORE_LOAD = 7  #: number of plant parameters before the wheel load in the parameter array; the force does not use them

# patterns in the generated text, and replacements that a step may contain
_REPLACED: tuple[tuple[str, str | Callable[[re.Match[str]], str]], ...] = (
    (r"\bnumpy\.sign\(", "sign("),
    (r"\bnumpy\.arctan\(", "math.atan("),
    (r"\bnumpy\.", "math."),
    (r"\b_x(?=\d)", "x"),
    (r"\bp\[(\d+)\]", lambda match: f"p.assumed[{int(match[1]) - BEFORE_LOAD}]"),
    (r", z, Tb, Td, Tr, p, \*nodes", ", z, p"),
)
_HEAD = '''import math


def sign(x):
    """Return the sign of x, 0 for 0."""
    return 1.0 if x > 0.0 else (-1.0 if x < 0.0 else 0.0)


def where(condition, one, other):
    """Return the first number if the condition holds, else the second."""
    return one if condition > 0.0 else other


'''
_LAST = '''

def assumed_force(v, sigma, p):
    """Return the static adhesion force, N, at a train speed and a slip velocity, m/s."""
    return force(v, sigma, rest_state(v, sigma, 0.0, p), p)
'''


@cache
def force_of(law: type[AdhesionLaw]) -> Callable[..., Any]:
    """Return a function (v, sigma, parameters) that computes the static force of an adhesion law, N.

    v is the train speed and sigma the slip velocity, m/s. `parameters.assumed` contains the wheel load, N, and the
    parameters of the law. If the law has no closed form, `parameters.assumed_table` contains its force over slip.
    """
    if has_table(law):
        return _force_from_table
    functions = {node.name: node for node in ast.parse(source(law)).body if isinstance(node, ast.FunctionDef)}
    text = "\n\n\n".join(ast.unparse(functions[name]) for name in ("force", "rest_state"))
    for pattern, replacement in _REPLACED:
        text = re.sub(pattern, replacement, text)
    function: Callable[..., Any] = module_of(_HEAD + text + _LAST).assumed_force
    return function


def _force_from_table(v: Any, sigma: Any, p: Any) -> Any:
    """Return the adhesion force, N, at a train speed and a slip velocity, m/s, interpolated in a table."""
    table_cells = int(0.5 * len(p.assumed_table)) - 1
    position = abs(sigma / v) * p.assumed_table[0]
    i = int(min(table_cells - 1.0, position))
    u = position - i
    f0, d0 = p.assumed_table[1 + 2 * i], p.assumed_table[2 + 2 * i]
    f1, d1 = p.assumed_table[3 + 2 * i], p.assumed_table[4 + 2 * i]
    rise = f1 - f0
    value = f0 + u * (d0 + u * (3.0 * rise - 2.0 * d0 - d1 + u * (d0 + d1 - 2.0 * rise)))
    return value if sigma >= 0.0 else -value
