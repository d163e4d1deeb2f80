"""How a step of the derivation is checked by machine: an identity is proved, and evaluated at random points too."""

from __future__ import annotations

from collections.abc import Iterator

import sympy as sp

POINTS = 32
"""Random points of the numeric check."""

_TOLERANCE = 1e-9
_SEED = 2008


def vanishes(expression: sp.Expr) -> bool:
    """True where a rational expression in symbols, sgn and absolute values is proved to be zero.

    Each sgn x is taken as 1, as -1 and, where x is a symbol, as 0 with x = 0; functions and cases of an adhesion law
    are generators like any symbol. Complete for what the control law consists of, and much faster than `simplify`.
    """
    functions = {part for part in expression.atoms(sp.Function) if not isinstance(part, (sp.sign, sp.Abs))}
    opaque = {part: sp.Dummy() for part in functions | expression.atoms(sp.Piecewise)}
    plain = expression.xreplace(opaque).replace(sp.Abs, lambda x: x * sp.sign(x))
    return all(_is_zero(case) for case in _sign_cases(plain))


def _sign_cases(expression: sp.Expr) -> Iterator[sp.Expr]:
    signs = sorted(expression.atoms(sp.sign), key=str)
    if not signs:
        yield expression
        return
    argument = signs[0].args[0]
    for value in (1, -1):
        yield from _sign_cases(expression.xreplace({signs[0]: sp.Integer(value)}))
    if argument.is_Symbol:
        yield from _sign_cases(expression.subs(argument, 0))


def _is_zero(expression: sp.Expr) -> bool:
    return bool(sp.expand(sp.numer(sp.together(sp.expand(expression)))) == 0)


def agree_at_random_points(left: sp.Expr, right: sp.Expr) -> bool:
    """True where both sides have the same value at `POINTS` random points, to rounding.

    Positive symbols are drawn from 0.2 to 3, the others from -2 to 2; the same points on every run.
    """
    import numpy as np

    symbols = sorted(left.free_symbols | right.free_symbols, key=str)
    generator = np.random.default_rng(_SEED)
    points = [
        generator.uniform(0.2, 3.0, POINTS) if symbol.is_positive else generator.uniform(-2.0, 2.0, POINTS)
        for symbol in symbols
    ]
    sides = sp.lambdify(symbols, [left, right], "numpy")(*points)
    values = [np.broadcast_to(np.asarray(side, dtype=float), POINTS) for side in sides]
    scale = 1.0 + np.abs(values[0]) + np.abs(values[1])
    return bool(np.all(np.abs(values[0] - values[1]) <= _TOLERANCE * scale))


def identical(left: sp.Expr, right: sp.Expr) -> bool:
    """True where left = right is proved and holds at random points."""
    return vanishes(left - right) and agree_at_random_points(left, right)


def linear_solution(equation: sp.Basic, unknown: sp.Symbol) -> sp.Expr:
    """The unknown from an equation that is linear in it, as `sympy.solve` gives it.

    Without its `simplify` and `check`, which take most of its time: of a linear equation there is one solution, which
    is the same without them, and what is made of it is proved by its step.
    """
    return sp.solve(equation, unknown, simplify=False, check=False)[0]
