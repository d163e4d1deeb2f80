"""Rare events and confidence levels as text, JSON and files."""

from __future__ import annotations

import json
from collections.abc import Iterable
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from railslip_ctrl import __version__
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.simulation.campaign.rare import ConfidenceLevels, RareEvent
from railslip_ctrl.simulation.campaign.statistics import CONFIDENCE

from .document import Facts, Table, fixed, heading, render
from .export import FileContent, exported, json_text

Found = RareEvent | ConfidenceLevels
Rows = list[tuple[str, str]]

_HOLDS = "It holds for this model and these distributions, all independent; it is no proof of conformity to a standard."


def text_of(found: Found) -> str:
    """Probability, contributions and most likely failing stop as text; or the table of Kdry_rst."""
    facts, table, last = _levels(found) if isinstance(found, ConfidenceLevels) else _event(found)
    title = heading(f"{found}: {found.campaign.scenario.name}, {found.campaign.controllers[0].label}")
    warnings = [Text(f"Warning: {warning}.") for warning in found.warnings]
    return render([title, Facts(facts), *warnings, table, *last, Text(_HOLDS)])


def _levels(found: ConfidenceLevels) -> tuple[Rows, Table, list[RenderableType]]:
    rows = [(str(n), f"{p:g}", fixed(k.value * found.nominal, 4), _interval(*k, digits=4)) for n, p, k in found.factors]
    head = "EBCL", "falls short with", "deceleration (m/s^2)", f"Kdry_rst, {100 * CONFIDENCE:g} % interval"
    return [("Nominal", f"{found.nominal:.4g} m/s^2, mean over the distance")], Table(head, rows), []


def _event(found: RareEvent) -> tuple[Rows, Table, list[RenderableType]]:
    facts = [
        (name, f"{_interval(*one[:3], digits=3)}, coefficient of variation {100.0 * one.variation:.0f} %")
        for name, one in (("Subset simulation", found.subset), ("Importance sampling", found.importance))
        if one is not None
    ]
    shares = sorted(found.shares.items(), key=lambda item: -item[1])
    table = Table(("what makes it likely", "share, %"), [(name, f"{100.0 * share:.1f}") for name, share in shares])
    if found.stop is None:
        return facts, table, []
    run, rows = found.stop.run, [(name, fixed(value)) for name, value in found.stop.values.items()]
    rows += [
        ("Ends", f"{run.outcome.value} after {run.braking_time:.4g} s and {run.braking_distance:.5g} m"),
        ("From the medians", f"{found.stop.distance:.3g} standard deviations of all inputs together"),
        ("Repeat it", "railslip simulate --scenario stop.toml --controller controller.toml --seed stop.npz"),
    ]
    return facts, table, [heading("Most likely failing stop", "-"), Facts(rows)]


def json_of(found: Found) -> dict[str, Any]:
    """The result as JSON, unrounded."""
    own = {"version": __version__, **exported(found, "stops", "warnings", hash="campaign.fingerprint")}
    if isinstance(found, ConfidenceLevels):
        return own | exported(found, "factors", nominal_deceleration="nominal")
    names = ("probability", "subset", "importance", "levels", "shares")
    stop = found.stop and {
        **exported(found.stop, "distance", "values"),
        **exported(found.stop.run, "outcome", "braking_distance", "braking_time", "max_slip"),
    }
    return {"event": str(found.event), **own, **exported(found, *names), "stop": stop}


def files_of(found: Found, scenario: str) -> dict[str, FileContent]:
    """Files by name; `scenario` is the campaign's, by name or path."""
    name = "rare" if isinstance(found, RareEvent) else "confidence"
    files: dict[str, FileContent] = {f"{name}.txt": text_of(found), f"{name}.json": json_text(json_of(found))}
    rows = zip(*(column.tolist() for column in found.tail[:4]), strict=True)
    files["tail.csv"] = _csv("{} [{}],probability [1],low [1],high [1]".format(*found.measured), rows)
    if isinstance(found, ConfidenceLevels):
        levels = ((n, p, k.value * found.nominal, *k) for n, p, k in found.factors)
        files["confidence.csv"] = _csv("ebcl,probability,deceleration [m/s^2],kdry_rst [1],low [1],high [1]", levels)
    elif found.stop is not None:
        changes = found.campaign.changes(found.stop.values.values()).get(0, {})
        numbers = (f"{json.dumps(path)} = {value!r}" for path, value in changes.items())
        files["stop.toml"] = "\n".join([f"extends = {json.dumps(scenario)}", "", "[changes]  # SI", *numbers]) + "\n"
        files["stop.npz"] = partial(np.savez, **found.stop.noise._asdict())
        with suppress(InputError):  # a Python step has no controller file
            files["controller.toml"] = found.stop.run.controller.toml
    return files


def _interval(*numbers: float, digits: int) -> str:
    return "{} [{}, {}]".format(*(fixed(number, digits) for number in numbers))


def _csv(head: str, rows: Iterable[tuple[float, ...]]) -> str:
    return "\n".join([head, *(",".join(map(repr, row)) for row in rows)]) + "\n"
