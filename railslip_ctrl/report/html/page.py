"""A whole page: what is read in a minute, sections in order, pictures embedded, the template filled in."""

from __future__ import annotations

import base64
import datetime
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from railslip_ctrl import __version__
from railslip_ctrl.core.sources import SOURCES
from railslip_ctrl.report.provenance import Provenance, software

from .blocks import Block, Details, FirstPage, Picture, Section, Table, pictures_in
from .typography import with_units

_ADDRESS = re.compile(r"doi:(10\.\S+[^\s.])|https://\S+[^\s.]")


def page(
    first: FirstPage,
    sections: Sequence[Section],
    pictures: Mapping[str, bytes],
    provenance: Provenance,
    date: datetime.date,
    seconds: float,
) -> str:
    """The page as HTML.

    Parameters
    ----------
    first : FirstPage
    sections : sequence of Section
    pictures : mapping
        SVG by the names that `first` and `sections` use; KeyError if one is missing.
    provenance : Provenance
    date : date
    seconds : float
        What it took, s.

    Returns
    -------
    str
        One document that loads nothing: style within, pictures as data.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("railslip_ctrl.report.html"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["css_string"] = css_string
    environment.filters["with_units"] = with_units
    top, *chapters = _numbered([Section("first", "", first.pictures), *sections])
    used = [picture for section in (top, *chapters) for picture in pictures_in(section.blocks)]
    text = environment.get_template("report.html").render(
        first=first,
        shown=top.blocks,
        sections=chapters,
        software=software(),
        pictures={picture.name: _data(pictures[picture.name]) for picture in used},
        provenance=provenance,
        version=__version__,
        date=date.isoformat(),
        seconds=seconds,
    )
    return text.replace("</main>", _sources(text, environment) + "</main>", 1)


def cited_sources(text: str) -> dict[str, str]:
    """The sources that a text cites, by key."""
    return {key: source for key, source in SOURCES.items() if f"[{key}]" in text}


def _sources(text: str, environment: Any) -> str:
    """The sources that the text cites, as its last section; a DOI or an address in them is a link."""
    cited = {key: _linked(source) for key, source in cited_sources(text).items()}
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


def _data(svg: bytes) -> str:
    return "data:image/svg+xml;base64," + base64.b64encode(svg).decode("ascii")


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
