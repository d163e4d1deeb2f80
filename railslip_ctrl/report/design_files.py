"""Files that the page of `railslip design` saves: controller (TOML), Python script, and report."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import Enum
from importlib import import_module
from pprint import pformat
from types import MappingProxyType
from typing import Any

from railslip_ctrl.controllers.base import Controller, python_file
from railslip_ctrl.core.errors import InputError, check_extra
from railslip_ctrl.design.envelope import Envelope
from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.model.vehicle import PARK2008, Record

from .candidates import no_margins
from .design_report import design_sections, first_page
from .page import page
from .pictures import Pictures
from .recommendation import design_report


def toml_text(envelope: Envelope, control: Controller) -> str:
    """Return the text of a TOML file with the controller, which the option --controller of the commands reads."""
    return control.toml


def script_text(envelope: Envelope, control: Controller) -> str:
    """Return a Python script that judges the controller over the envelope, simulates a stop, and saves the controller.

    A controller without a linear loop is not judged.

    InputError: the controller's class comes from a Python file of the user, or a law is an `AdhesionLaw` object.
    """
    kind = type(control)
    if python_file(kind) is not None or any(isinstance(law, AdhesionLaw) for law in envelope.laws):
        raise InputError(
            "script: a Python script with your own controller class or adhesion law is not supported; save "
            "controller.toml instead"
        )
    given = {**control.file_keys(), "name": control.label, "reference": control.reference}
    fields = type(envelope).model_fields
    changed = {n: getattr(envelope, n) for n in fields if n != "vehicle" and getattr(envelope, n) != fields[n].default}
    car = "rs.PARK2008" if envelope.vehicle == PARK2008 else f"rs.Vehicle(**{_shown(dict(envelope.vehicle))})"
    judge, done = ("", "run") if no_margins(control) else ("    print(rs.judge(envelope, controller))\n", "judged, run")
    return f'''"""A slip controller shaped by hand with `railslip design`: {done} in a stop, and saved."""

from {kind.__module__} import {kind.__name__}

import railslip_ctrl as rs

car = {car}
envelope = rs.Envelope(car, **{_shown(changed)})
controller = {kind.__name__}(**{_shown(given)})

if __name__ == "__main__":
{judge}    print(rs.simulate(rs.stop(car, "wet"), controller))
    controller.save("controller.toml")
'''


def _shown(values: Mapping[str, Any]) -> str:
    return pformat(_plain(values), width=100, sort_dicts=False)


def _plain(value: Any) -> Any:
    if isinstance(value, Record | Mapping):
        return {name: _plain(entry) for name, entry in dict(value).items() if entry is not None}
    if isinstance(value, tuple | list):
        return tuple(map(_plain, value))
    if isinstance(value, Enum):
        return value.value
    return value if isinstance(value, float | int | None) else str(value)


def report_text(envelope: Envelope, control: Controller) -> str:
    """Return the design report of the envelope with this controller as an HTML page."""
    check_extra("html", "report")
    report = design_report(envelope, given={control.label: control}, sliding=False)
    pictures = Pictures()
    pictures.draw(lambda: import_module("railslip_ctrl.report.plots.designs").report_drawings(report), ("svg",))
    svg = {name: forms["svg"] for name, forms in pictures.drawn.items()}
    return page(first_page(report), design_sections(report), svg, "railslip design", report.date, report.seconds)


FILES: Mapping[str, Callable[[Envelope, Controller], str]] = MappingProxyType(
    {"controller.toml": toml_text, "design.py": script_text, "report.html": report_text}
)
"""For each file name, the function that returns the content of the file."""
