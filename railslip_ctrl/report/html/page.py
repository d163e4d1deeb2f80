"""The whole page: sections in order, numbers of tables and figures, pictures embedded, the template filled in."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from railslip_ctrl import __version__
from railslip_ctrl.design_report import DesignReport
from railslip_ctrl.report.provenance import Provenance, software
from railslip_ctrl.sources import SOURCES

from .blocks import Block, Details, Group, Picture, Section, Table
from .closing_sections import unchecked_section
from .loop_sections import designs_section, margins_section
from .paper_sections import errata_section, reproduction_section
from .plant_sections import adhesion_section, limits_section, linear_section, region_section, vehicle_section
from .range_sections import range_section
from .sliding_sections import paper_law_section, sliding_section
from .stop_sections import stops_section
from .typography import with_units
from .verdict import gains_not_computed, verdict

_ADDRESS = re.compile(r"doi:(10\.\S+[^\s.])|https://\S+[^\s.]")

_SECTIONS = (
    vehicle_section,
    adhesion_section,
    linear_section,
    limits_section,
    region_section,
    designs_section,
    range_section,
    margins_section,
    stops_section,
    sliding_section,
    unchecked_section,
    paper_law_section,
    reproduction_section,
    errata_section,
)


def design_report_html(report: DesignReport, pictures: Mapping[str, bytes], provenance: Provenance) -> str:
    """The report as HTML.

    Parameters
    ----------
    report : DesignReport
    pictures : mapping
        SVG by the names of `plots.design_report`'s figures; KeyError if one is missing.
    provenance : Provenance

    Returns
    -------
    str
        One document that loads nothing: style within, pictures as data.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    sections = _numbered([make(report) for make in _SECTIONS])
    environment = Environment(
        loader=PackageLoader("railslip_ctrl.report.html"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["css_string"] = css_string
    environment.filters["with_units"] = with_units
    used = [picture for section in sections for picture in section.pictures()]
    data = {picture.name: _data(pictures[picture.name]) for picture in used}
    vehicle = report.check.vehicle
    text = environment.get_template("report.html").render(
        title=f"Wheel-slip control design check: {vehicle.name}",
        vehicle=vehicle.name,
        verdict=verdict(report),
        not_computed=gains_not_computed(report),
        software=software(),
        sections=sections,
        pictures=data,
        provenance=provenance,
        version=__version__,
        date=report.check.date.isoformat(),
        seconds=report.seconds,
        from_cache=report.from_cache,
    )
    return text.replace("</main>", _sources(text, environment) + "</main>", 1)


def cited_sources(text: str) -> dict[str, str]:
    """The sources that a text cites, by key."""
    return {key: source for key, source in SOURCES.items() if f"[{key}]" in text}


def _sources(text: str, environment: Any) -> str:
    """The sources that the text cites, as its last section; a DOI or an address in them is a link."""
    cited = {key: _linked(source) for key, source in cited_sources(text).items()}
    return str(environment.get_template("sources.html").render(sources=cited))


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
        if isinstance(block, Details | Group):
            return replace(block, blocks=tuple(number(one) for one in block.blocks))
        return block

    return [replace(section, blocks=tuple(number(block) for block in section.blocks)) for section in sections]
