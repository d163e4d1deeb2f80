"""Blocks of `document` as one HTML page: the template filled in, pictures embedded, text and formulas typeset."""

from __future__ import annotations

import base64
import datetime
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from railslip_ctrl import __version__
from railslip_ctrl.core.notation import SOURCES

from .document import Block, Details, FirstPage, Picture, Section, Table, pictures_in
from .export import Provenance, software

if TYPE_CHECKING:  # an extra
    from markupsafe import Markup

_ADDRESS = re.compile(r"doi:(10\.\S+[^\s.])|https://\S+[^\s.]")


def page(
    first: FirstPage,
    sections: Sequence[Section],
    pictures: Mapping[str, bytes],
    provenance: Provenance,
    date: datetime.date,
    seconds: float,
) -> str:
    """One HTML document that loads nothing: style within, pictures as data; `seconds` is what it took, s.

    `pictures` are SVG by the names that `first` and `sections` use; KeyError if one is missing.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("railslip_ctrl.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["css_string"] = css_string
    environment.filters["with_units"] = with_units
    top, *chapters = _numbered([Section("first", "", first.pictures), *sections])
    used = [picture for section in (top, *chapters) for picture in pictures_in(section.blocks)]
    embedded = {one.name: base64.b64encode(pictures[one.name]).decode("ascii") for one in used}
    text = environment.get_template("report.html").render(
        first=first,
        shown=top.blocks,
        sections=chapters,
        software=software(),
        pictures={name: f"data:image/svg+xml;base64,{one}" for name, one in embedded.items()},
        **{"provenance": provenance, "version": __version__, "date": date.isoformat(), "seconds": seconds},
    )
    return text.replace("</main>", _sources(text, environment) + "</main>", 1)


def _sources(text: str, environment: Any) -> str:
    """The sources that the text cites, as its last section; a DOI or an address in them is a link."""
    cited = {key: _linked(source) for key, source in SOURCES.items() if f"[{key}]" in text}
    return str(environment.get_template("sources.html").render(sources=cited)) if cited else ""


def _linked(source: str) -> Any:
    from markupsafe import Markup, escape

    def link(found: re.Match[str]) -> str:
        address = f"https://doi.org/{found[1]}" if found[1] else found[0]
        return f'<a href="{address}">{found[0]}</a>'

    return Markup(_ADDRESS.sub(link, str(escape(source))))


def css_string(text: str) -> str:
    """Text for between quotes in a style sheet: everything but letters, digits and spaces as its number,
    with the space that ends one."""
    return "".join(c if c.isascii() and (c.isalnum() or c == " ") else f"\\{ord(c):06x} " for c in text)


def _numbered(sections: Sequence[Section]) -> list[Section]:
    """Tables and figures numbered through, each kind for itself."""
    counts = {Table: 0, Picture: 0}

    def number(block: Block) -> Block:
        if isinstance(block, Table | Picture):
            counts[type(block)] += 1
            return replace(block, number=counts[type(block)])
        if isinstance(block, Details):
            return replace(block, blocks=tuple(number(one) for one in block.blocks))
        return block

    return [replace(section, blocks=tuple(number(block) for block in section.blocks)) for section in sections]


# --- text written for a terminal, set as print: signs, Greek letters, powers, units, code ---------------------------


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
    from markupsafe import Markup

    pieces = _CODE.split(text)  # odd pieces are code
    return Markup("").join(
        Markup("<code>{}</code>").format(piece) if i % 2 else _indexed(signs(piece)) for i, piece in enumerate(pieces)
    )


def _indexed(text: str) -> Markup:
    from markupsafe import Markup, escape

    return Markup(_INDEX.sub(r"\1<sub>\2</sub>", str(escape(text))))


def signs(text: str) -> str:
    """The text without code in it, with the signs of print."""
    for pattern, replacement in _RULES:
        text = pattern.sub(replacement, text)
    return text


def with_units(text: str) -> str:
    """The text, or HTML, with no line end between a number and its unit."""
    from markupsafe import Markup

    found = _BEFORE_UNIT.sub("\N{NO-BREAK SPACE}", text)
    return Markup(found) if isinstance(text, Markup) else found


def formula(latex: str) -> Markup:
    """A formula within a line as MathML, from LaTeX, its fractions as large as in a line of its own."""
    from latex2mathml.converter import convert
    from markupsafe import Markup

    return Markup(convert(latex).replace('display="inline"', 'display="inline" displaystyle="true"', 1))
