"""Results of `railslip campaign --rare` or `--confidence-levels` as text, JSON and files."""

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

Result = RareEvent | ConfidenceLevels
Rows = list[tuple[str, str]]

_HOLDS = "Valid for this model with these independent distributions; it does not prove conformity to a standard."


def text_of(result: Result) -> str:
    """Return the result as text.

    The text on a rare event has its probability, the contribution of each input, and the most likely stop with the
    event. The text on confidence levels has Kdry_rst, the ratio of a quantile of the deceleration to
    the nominal one.
    """
    facts, table, last = _levels(result) if isinstance(result, ConfidenceLevels) else _event(result)
    title = heading(f"{result}: {result.campaign.scenario.name}, {result.campaign.controllers[0].label}")
    warnings = [Text(f"Warning: {warning}.") for warning in result.warnings]
    return render([title, Facts(facts), *warnings, table, *last, Text(_HOLDS)])


def _levels(result: ConfidenceLevels) -> tuple[Rows, Table, list[RenderableType]]:
    levels, nominal = result.factors, result.nominal
    rows = [(str(n), f"{p:g}", fixed(k.value * nominal, 4), _interval(*k, digits=4)) for n, p, k in levels]
    head = "EBCL", "probability of lower", "deceleration (m/s^2)", f"Kdry_rst, {100 * CONFIDENCE:g} % interval"
    return [("Nominal", f"{nominal:.4g} m/s^2, mean over the distance")], Table(head, rows), []


def _event(result: RareEvent) -> tuple[Rows, Table, list[RenderableType]]:
    facts = [
        (name, f"{_interval(*estimate[:3], digits=3)}, coefficient of variation {100.0 * estimate.variation:.0f} %")
        for name, estimate in (("Subset simulation", result.subset), ("Importance sampling", result.importance))
        if estimate is not None
    ]
    shares = sorted(result.shares.items(), key=lambda item: -item[1])
    table = Table(("Contribution of", "share, %"), [(name, f"{100.0 * share:.1f}") for name, share in shares])
    if result.stop is None:
        return facts, table, []
    run, rows = result.stop.run, [(name, fixed(value)) for name, value in result.stop.values.items()]
    rows += [
        ("Ends", f"{run.outcome.value} after {run.braking_time:.4g} s and {run.braking_distance:.5g} m"),
        ("Distance from medians", f"{result.stop.distance:.3g} standard deviations, for all inputs together"),
        ("To repeat it", "railslip simulate --scenario stop.toml --controller controller.toml --seed stop.npz"),
    ]
    return facts, table, [heading("Most likely failing stop", "-"), Facts(rows)]


def json_of(result: Result) -> dict[str, Any]:
    """Return the result as JSON, with unrounded numbers."""
    own = {"version": __version__, **exported(result, "stops", "warnings", hash="campaign.fingerprint")}
    if isinstance(result, ConfidenceLevels):
        return own | exported(result, "factors", nominal_deceleration="nominal")
    names = ("probability", "subset", "importance", "levels", "shares")
    stop = result.stop and {
        **exported(result.stop, "distance", "values"),
        **exported(result.stop.run, "outcome", "braking_distance", "braking_time", "max_slip"),
    }
    return {"event": str(result.event), **own, **exported(result, *names), "stop": stop}


def files_of(result: Result, scenario: str) -> dict[str, FileContent]:
    """Return the content of each file by file name; `stop.toml` refers to the scenario `scenario`."""
    name = "rare" if isinstance(result, RareEvent) else "confidence"
    files: dict[str, FileContent] = {f"{name}.txt": text_of(result), f"{name}.json": json_text(json_of(result))}
    rows = zip(*(column.tolist() for column in result.tail[:4]), strict=True)
    files["tail.csv"] = _csv("{} [{}],probability [1],low [1],high [1]".format(*result.measured), rows)
    if isinstance(result, ConfidenceLevels):
        levels = ((n, p, k.value * result.nominal, *k) for n, p, k in result.factors)
        files["confidence.csv"] = _csv("ebcl,probability,deceleration [m/s^2],kdry_rst [1],low [1],high [1]", levels)
    elif result.stop is not None:
        changes = result.campaign.changes(result.stop.values.values()).get(0, {})
        numbers = (f"{json.dumps(path)} = {value!r}" for path, value in changes.items())
        files["stop.toml"] = "\n".join([f"extends = {json.dumps(scenario)}", "", "[changes]  # SI", *numbers]) + "\n"
        files["stop.npz"] = partial(np.savez, **result.stop.noise._asdict())
        with suppress(InputError):  # a controller with only a step function has no file
            files["controller.toml"] = result.stop.run.controller.toml
    return files


def _interval(*numbers: float, digits: int) -> str:
    return "{} [{}, {}]".format(*(fixed(number, digits) for number in numbers))


def _csv(head: str, rows: Iterable[tuple[float, ...]]) -> str:
    return "\n".join([head, *(",".join(map(repr, row)) for row in rows)]) + "\n"
