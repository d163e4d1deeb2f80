"""Mathematics as MathML, which browsers set without scripts, fonts or network."""

from __future__ import annotations

import re
from collections.abc import Iterable

from markupsafe import Markup

from railslip_ctrl.report.layout import fixed

_EXPONENT = re.compile(r"e([+-])0*(\d+)$")
_DIGITS = 6
_SMALL_SIZE = 1e-12  # of the largest coefficient: a coefficient below it is rounding


def formula(latex: str) -> Markup:
    """A formula within a line, from LaTeX, its fractions as large as in a line of its own."""
    from latex2mathml.converter import convert

    return Markup(convert(latex).replace('display="inline"', 'display="inline" displaystyle="true"', 1))


def matrix(rows: Iterable[Iterable[float]]) -> Markup:
    """A matrix of numbers with six significant digits, in brackets."""
    body = r" \\ ".join(" & ".join(latex_number(x) for x in row) for row in rows)
    return formula(rf"\begin{{bmatrix}} {body} \end{{bmatrix}}")


def transfer_function(num: Iterable[float], den: Iterable[float], unit: str) -> Markup:
    """num(s)/den(s), coefficients of falling powers of s; `unit` in LaTeX follows it."""
    return formula(rf"\frac{{{_polynomial(list(num))}}}{{{_polynomial(list(den))}}}\;{unit}")


def latex_number(value: float, digits: int = _DIGITS) -> str:
    """A number as LaTeX, a power of ten as such."""
    return _EXPONENT.sub(
        lambda found: rf"\cdot 10^{{{'-' if found[1] == '-' else ''}{found[2]}}}", fixed(float(value), digits)
    )


def _polynomial(coefficients: list[float]) -> str:
    largest = max((abs(x) for x in coefficients), default=0.0)
    terms: list[str] = []
    for power, x in zip(range(len(coefficients) - 1, -1, -1), coefficients, strict=True):
        if abs(x) <= _SMALL_SIZE * largest:
            continue
        letter = "" if power == 0 else "s" if power == 1 else f"s^{{{power}}}"
        size = "" if abs(x) == 1.0 and letter else latex_number(abs(x))
        sign = "-" if x < 0 else "+" if terms else ""
        terms.append(sign + (rf"{size}\,{letter}" if size and letter else size + letter))
    return "".join(terms) or "0"
