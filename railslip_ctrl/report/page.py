"""HTML page of a report, with embedded pictures, typographic signs and formulas."""

from __future__ import annotations

import base64
import datetime
import re
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from railslip_ctrl import __version__
from railslip_ctrl.core.notation import SOURCES
from railslip_ctrl.core.templates import environment

from .document import FirstPage, Section
from .export import software

if TYPE_CHECKING:  # needs the extra `html`
    from markupsafe import Markup

_ADDRESS = re.compile(r"doi:(10\.\S+[^\s.])|https://\S+[^\s.]")


def page(
    first: FirstPage,
    sections: Sequence[Section],
    pictures: Mapping[str, bytes],
    command: str,
    date: datetime.date,
    seconds: float,
) -> str:
    """Return a report as an HTML document that loads no other file.

    `pictures` maps the names that `first` and `sections` use to SVG files; `seconds` is the computing time.
    """
    filling = environment("railslip_ctrl.report", autoescape=True)
    filling.keep_trailing_newline = False
    filling.filters |= {"css_string": css_string, "with_units": with_units}
    embedded = {name: base64.b64encode(svg).decode("ascii") for name, svg in pictures.items()}
    text = filling.get_template("report.html").render(
        first=first,
        sections=sections,
        software=software(),
        pictures={name: f"data:image/svg+xml;base64,{data}" for name, data in embedded.items()},
        **{"command": command, "version": __version__, "date": date.isoformat(), "seconds": seconds},
    )
    cited = {key: _linked(source) for key, source in SOURCES.items() if f"[{key}]" in text}
    sources = filling.get_template("sources.html").render(sources=cited) if cited else ""
    return str(text.replace("</main>", f"{sources}</main>", 1))


def _linked(source: str) -> Markup:
    from markupsafe import Markup, escape

    def link(match: re.Match[str]) -> str:
        address = f"https://doi.org/{match[1]}" if match[1] else match[0]
        return f'<a href="{address}">{match[0]}</a>'

    return Markup(_ADDRESS.sub(link, str(escape(source))))


def css_string(text: str) -> str:
    """Escape text for a string in a style sheet."""
    return "".join(c if c.isascii() and (c.isalnum() or c == " ") else f"\\{ord(c):06x} " for c in text)


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "+")
_LOWERED = str.maketrans("012", "₀₁₂")
_GREEK = {
    "alpha": "α", "beta": "β", "gamma": "γ", "eta": "η", "theta": "θ", "lambda": "λ", "mu": "μ", "rho": "ρ",
    "sigma": "σ", "tau": "τ", "phi": "φ", "omega": "ω",
}  # fmt: skip
_ACCENTS = {"_tilde": "\N{COMBINING TILDE}", "_hat": "\N{COMBINING CIRCUMFLEX ACCENT}", None: ""}
_LETTERS = "|".join(sorted(_GREEK, key=len, reverse=True))
_RULES: tuple[tuple[str, str | Callable[[re.Match[str]], str]], ...] = (
    (r"(\d)e([+-]?)0*(\d+)\b", lambda match: f"{match[1]}·10{(match[2] + match[3]).translate(_RAISED)}"),
    (r"\*\*(\d+)|(?<=[\w)|])\^(-?\d+)", lambda match: (match[1] or match[2]).translate(_RAISED)),
    (
        rf"(?<![A-Za-z])({_LETTERS})(\d?)(_tilde|_hat)?(?![A-Za-z])",
        lambda match: _GREEK[match[1]] + _ACCENTS[match[3]] + match[2].translate(_LOWERED),
    ),
    (r"(?<=[\w)|²³⁴\u0302\u0303₁₂])\*(?=[\w(|])", "·"),
    (r"\bN m\b", "N·m"),
    (r"\bkg m\b", "kg·m"),
    ("<=", "≤"),
    (">=", "≥"),
    ("->", "→"),
    (r"(?<= )- (?=[\w(|\d])", "− "),
    (r"(?<![\w)\]])-(?=[\w(|])", "−"),
    (r"(?<![A-Za-z])([A-Za-zα-ω][₀-₉]*)'(?![A-Za-z])", r"\1′"),
)
_CODE = re.compile(r"`([^`]+)`")
_INDEX = re.compile(r"(?<!\w)([A-Za-zα-ω][\u0302\u0303]?)_([A-Za-zα-ω]{1,6}|\d)(?![A-Za-z\d])")

_BEFORE_UNIT = re.compile(r"(?<=\d) (?=(?:deg|kg|km|kN|MJ|N|m|s|1/s|rad)\b|%)")


def typeset(text: str) -> Markup:
    """Return text as HTML: text in backticks becomes code, other text gets signs such as Greek letters."""
    from markupsafe import Markup, escape

    pieces = _CODE.split(text)  # pieces with an odd index are code
    for i in range(0, len(pieces), 2):
        for pattern, replacement in _RULES:
            pieces[i] = re.sub(pattern, replacement, pieces[i])
        pieces[i] = Markup(_INDEX.sub(r"\1<sub>\2</sub>", str(escape(pieces[i]))))
    pieces[1::2] = [Markup("<code>{}</code>").format(piece) for piece in pieces[1::2]]
    return Markup("").join(pieces)


def with_units(text: str) -> str:
    """Return text or HTML with a no-break space between each number and its unit."""
    from markupsafe import Markup

    joined = _BEFORE_UNIT.sub("\N{NO-BREAK SPACE}", text)
    return Markup(joined) if isinstance(text, Markup) else joined


def formula(latex: str) -> Markup:
    """Return a LaTeX formula as inline MathML."""
    from latex2mathml.converter import convert
    from markupsafe import Markup

    return Markup(convert(latex).replace('display="inline"', 'display="inline" displaystyle="true"', 1))
