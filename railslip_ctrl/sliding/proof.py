"""Parts of a derivation: symbols, machine-checked identities, and the record of a checked step.

The symbols of the sliding-mode laws (name, LaTeX, unit, meaning) extend those of the plant (`core.notation`). The
estimation error is theta_tilde = theta - theta_hat. A rate that is measured, estimated or unknown has its own symbol,
whose name ends in `_rate`.
"""

from __future__ import annotations

from collections.abc import Iterator

import sympy as sp

from railslip_ctrl.core import templates
from railslip_ctrl.core.notation import cite, latex_names, notation_in
from railslip_ctrl.core.records import dataclass

_OTHER_LATEX = (("Kx", "K_x"), ("mu_max", r"\mu_\mathrm{max}"), ("mu_d", r"\mu_d"))

_TABLES = templates.texts(__package__, "notation.toml")

SLIDING_NOTATION = notation_in(_TABLES["symbols"])  #: symbols of the published law, by name
PREDICTIVE_NOTATION = notation_in(_TABLES["predictive"])  #: symbols of the predictive law, by name
_SYMBOLS = {**PREDICTIVE_NOTATION, **SLIDING_NOTATION}
CODE_NOTATION: dict[str, tuple[str, str]] = _TABLES["code"]
"""Unit and meaning of further names in the generated code."""


def sliding_symbol(name: str) -> sp.Symbol:
    """Return the SymPy symbol of a name in `SLIDING_NOTATION` or `PREDICTIVE_NOTATION`; KeyError for another name."""
    entry = _SYMBOLS[name]
    return sp.Symbol(name, positive=True) if entry.positive else sp.Symbol(name, real=True)


def latex(expression: sp.Basic) -> str:
    """Return the LaTeX of an expression, with the symbols of [Park2008]."""
    own = {sp.Symbol(name, positive=True): text for name, text in _OTHER_LATEX}
    names = {**latex_names(), **own, **{sliding_symbol(name): entry.latex for name, entry in _SYMBOLS.items()}}
    return str(sp.latex(expression, symbol_names=names)).replace(r"\operatorname{sign}", r"\operatorname{sgn}")


def plain(expression: sp.Basic) -> str:
    """Return an expression as plain text; a column becomes a tuple."""
    if isinstance(expression, sp.MatrixBase):
        return "(" + ", ".join(plain(entry) for entry in expression) + ")"
    return str(sp.sstr(expression)).replace("sign(", "sgn(")


POINTS = 32  #: random points of the numeric check
_TOLERANCE = 1e-9  # relative; rounding errors are far smaller
_SEED = 2008  # fixed, so that every run checks the same points


def vanishes(expression: sp.Expr) -> bool:
    """Return True if a rational expression in symbols, sgn and absolute values is proved to be zero.

    Each sgn x is replaced by 1, by -1 and, if x is a symbol, by 0 with x = 0. Other functions are treated as symbols.
    """
    functions = {part for part in expression.atoms(sp.Function) if not isinstance(part, (sp.sign, sp.Abs))}
    opaque = {part: sp.Dummy() for part in functions | expression.atoms(sp.Piecewise)}
    plain = expression.xreplace(opaque).replace(sp.Abs, lambda x: x * sp.sign(x))
    return all(sp.expand(sp.numer(sp.together(sp.expand(case)))) == 0 for case in _sign_cases(plain))


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


def agree_at_random_points(left: sp.Expr, right: sp.Expr) -> bool:
    """Return True if both sides are equal, except for rounding, at `POINTS` random points, the same in every run."""
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
    """Return True if left = right is proved and also holds at random points."""
    return vanishes(left - right) and agree_at_random_points(left, right)


def linear_solution(equation: sp.Basic, unknown: sp.Symbol) -> sp.Expr:
    """Solve an equation that is linear in the unknown."""
    # the solution is unique, and each step of a derivation is checked afterwards
    return sp.solve(equation, unknown, simplify=False, check=False)[0]


@dataclass(frozen=True)
class DerivationStep:
    """One step of a derivation.

    - name: short name, unique in a derivation.
    - statement: result of the step in words.
    - done: operation of the step in words.
    - equation, equation_latex, equation_text: the resulting equation, in SymPy, LaTeX and plain text.
    - source: section or equation number in the literature.
    - checked: True if the machine check holds.
    - check: description of the machine check.
    """

    name: str
    statement: str
    done: str
    equation: sp.Eq
    equation_latex: str
    equation_text: str
    source: str
    checked: bool
    check: str


@dataclass(frozen=True)
class Checked:
    """Base class of the derivations, with the steps in order."""

    steps: tuple[DerivationStep, ...]

    @property
    def all_checked(self) -> bool:
        """True if the machine check of every step holds."""
        return all(step.checked for step in self.steps)


def step(name: str, equation: tuple[sp.Basic, sp.Basic], *holds: bool, **inserts: object) -> DerivationStep:
    """Make the step `name`, with its texts from `steps.toml`.

    - equation: left and right side.
    - holds: results of the step's machine checks; the field `checked` is true if all are true.
    - inserts: values for the placeholders of the texts.
    """
    left, right = equation
    texts = {key: text.format(**inserts) for key, text in templates.texts(__package__, "steps.toml")[name].items()}
    if texts["source"].startswith(("(", "p. ")):
        texts["source"] = cite("Park2008", texts["source"])
    return DerivationStep(
        name=name,
        equation=sp.Eq(left, right, evaluate=False),
        equation_latex=f"{latex(left)} = {latex(right)}",
        equation_text=f"{plain(left)} = {plain(right)}",
        checked=all(holds),
        **texts,
    )
