"""Mathematics as MathML, which browsers set without scripts, fonts or network."""

from __future__ import annotations

from markupsafe import Markup


def formula(latex: str) -> Markup:
    """A formula within a line, from LaTeX, its fractions as large as in a line of its own."""
    from latex2mathml.converter import convert

    return Markup(convert(latex).replace('display="inline"', 'display="inline" displaystyle="true"', 1))
