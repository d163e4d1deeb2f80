"""Text that was written for a terminal, set as print: signs, Greek letters, powers, units, code.

What the library's evidence and explanations say holds expressions as SymPy prints them ("-r*(D*s**2 + K*Abs(s))/J")
and units in ASCII. Only how they look is changed here.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from markupsafe import Markup, escape

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_LOWERED = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
_GREEK = {
    "alpha": "α", "beta": "β", "gamma": "γ", "eta": "η", "theta": "θ", "lambda": "λ", "mu": "μ", "rho": "ρ",
    "sigma": "σ", "tau": "τ", "phi": "φ", "omega": "ω", "Phi": "Φ", "Gamma": "Γ",
}  # fmt: skip
_ACCENTS = {"_tilde": "\N{COMBINING TILDE}", "~": "\N{COMBINING TILDE}", "_hat": "\N{COMBINING CIRCUMFLEX ACCENT}",
            "^": "\N{COMBINING CIRCUMFLEX ACCENT}"}  # fmt: skip

_Rule = tuple[re.Pattern[str], str | Callable[[re.Match[str]], str]]


def _power(found: re.Match[str]) -> str:
    return (found[1] or found[2]).translate(_RAISED)


def _ten(found: re.Match[str]) -> str:
    exponent = f"{found[2].replace('+', '')}{found[3]}".translate(_RAISED)
    return f"{found[1]}·10{exponent}"


def _letter(found: re.Match[str]) -> str:
    """A Greek letter with its index, its accent (on the letter), and a dot written as a prime."""
    name, first, accent, second, rest = found.groups()
    index = (first or second or "").translate(_LOWERED)
    prime = "′" if rest else ""
    return f"{_GREEK[name]}{_ACCENTS.get(accent or '', '')}{index}{prime}"


def _primes(found: re.Match[str]) -> str:
    return found[1] + "′" * len(found[2])


_LETTERS = "|".join(sorted(_GREEK, key=len, reverse=True))
_RULES: tuple[_Rule, ...] = (
    (re.compile(r"(\d)e([+-]?)0*(\d+)\b"), _ten),
    (re.compile(r"(?<![\d.])1·(?=10[⁻⁰-⁹¹²³])"), ""),
    (re.compile(r"\*\*\((-?\d+)\)|\*\*(-?\d+)"), _power),
    (re.compile(r"(?<=[\w)|])\^\((-?\d+)\)|(?<=[\w)|])\^(-?\d+)"), _power),
    (re.compile(rf"(?<![A-Za-z])({_LETTERS})(\d?)(_tilde|_hat|~)?(\d?)(_rate)?(?![A-Za-z])"), _letter),
    (re.compile(r"\bAbs\(([^()]*)\)"), r"|\1|"),
    (re.compile(r"\bsign\("), "sgn("),
    (re.compile(r"\bint (?=\S+ d\w)"), "∫ "),
    (re.compile(r"(?<=[\w)\]|²³′\u0302\u0303₁₂]) ?\* ?(?=[\w(|])"), "·"),
    (re.compile(r"\bN m\b"), "N·m"),
    (re.compile(r"N·m s\b"), "N·m·s"),
    (re.compile(r"\bkg m\b"), "kg·m"),
    (re.compile(r"(?<=inertia) x (?=\d)"), " × "),
    (re.compile(r"<="), "≤"),
    (re.compile(r">="), "≥"),
    (re.compile(r"\+-"), "±"),
    (re.compile(r"->"), "→"),
    (re.compile(r"(?<=\d)\.\.(?=[-−\d])"), "…"),
    (re.compile(r"(?<= )- (?=[\w(|\d])"), "− "),
    (re.compile(r"(?<![\w)\]])-(?=[\w(|])"), "−"),
    (re.compile(r"\bsqrt\("), "√("),
    (re.compile(r"(?<![A-Za-z])([A-Za-zα-ωΑ-Ω][\u0302\u0303]?[₀-₉]*(?:_\w)?)('{1,2})(?![A-Za-z])"), _primes),
)
_CODE = re.compile(r"`([^`]+)`")
_INDEX = re.compile(r"(?<!\w)([A-Za-zα-ωΑ-Ω][\u0302\u0303]?)_([A-Za-zα-ωΑ-Ω]{1,6}|\d)(?![A-Za-z\d])")

_BEFORE_UNIT = re.compile(r"(?<=\d) (?=(?:deg|kg|km|kN|MJ|N|m|s|1/s|rad)\b|%)")


def typeset(text: str) -> Markup:
    """The text as HTML: what stood between backticks as code, everything else with the signs of print."""
    pieces = _CODE.split(text)  # odd pieces are code
    return Markup("").join(
        Markup("<code>{}</code>").format(piece) if i % 2 else _indexed(signs(piece)) for i, piece in enumerate(pieces)
    )


def _indexed(text: str) -> Markup:
    return Markup(_INDEX.sub(r"\1<sub>\2</sub>", str(escape(text))))


def signs(text: str) -> str:
    """The text without code in it, with the signs of print."""
    for pattern, replacement in _RULES:
        text = pattern.sub(replacement, text)
    return text


def with_units(text: str) -> str:
    """The text, or HTML, with no line end between a number and its unit."""
    found = _BEFORE_UNIT.sub("\N{NO-BREAK SPACE}", text)
    return Markup(found) if isinstance(text, Markup) else found
