"""Text, JSON and files of rare events and confidence levels."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from railslip_ctrl import __version__
from railslip_ctrl.simulation.campaign.rare import ConfidenceLevels, RareEvent, Tail
from railslip_ctrl.simulation.campaign.statistics import CONFIDENCE, Estimate

from .document import Facts, Table, fixed, heading, render
from .export import exported

_HOLDS = "It holds for this model and these distributions, all independent; it is no proof of conformity to a standard."


def rare_text(found: RareEvent) -> str:
    """The probability, what makes it, the most likely failing stop."""
    other = "none" if found.importance is None else _estimate(found.importance, found.importance_variation)
    facts = [
        ("Probability", _estimate(found.probability, found.variation)),
        ("Importance sampling", other),
        ("Stops", f"{found.stops}, {len(found.levels)} levels"),
    ]
    shares = sorted(found.shares.items(), key=lambda item: -item[1])
    means = {name: f"{mean:+.2f}" for name, mean in found.directions.items()}
    cells = [(name, f"{100.0 * share:.1f}", means.get(name, "-")) for name, share in shares]
    parts: list[RenderableType] = [heading(f"P({found.event}): {_case(found)}"), Facts(facts), *_warned(found)]
    parts += [heading("What makes it likely", "-"), Table(("input", "share, %", "mean in it, std"), cells)]
    if found.stop is not None:
        run = found.stop.run
        rows = [(name, fixed(value)) for name, value in found.stop.drawn.values.items()]
        rows.append(("Ends", f"{run.outcome.value} after {run.braking_time:.4g} s and {run.braking_distance:.5g} m"))
        rows.append(("From the middle", f"{found.stop.distance:.3g} standard deviations of all inputs together"))
        parts += [heading("Most likely failing stop", "-"), Facts(rows)]
    return render([*parts, Text(_HOLDS)])


def confidence_text(found: ConfidenceLevels) -> str:
    """The table of Kdry_rst."""
    rows = [
        (str(f.level), f"{f.probability:g}", fixed(f.deceleration, 4), _interval(f.factor, 4)) for f in found.factors
    ]
    facts = [("Nominal", f"{found.nominal:.4g} m/s^2, mean over the distance"), ("Stops", str(found.stops))]
    heads = ("EBCL", "falls short with", "deceleration (m/s^2)", f"Kdry_rst, {100 * CONFIDENCE:g} % interval")
    title = heading(f"Kdry_rst: {_case(found)}")
    return render([title, Facts(facts), *_warned(found), Table(heads, rows), Text(_HOLDS)])


def rare_json(found: RareEvent) -> dict[str, Any]:
    """The same, unrounded."""
    names = ("variation", "importance", "importance_variation", "levels", "accepted", "shares", "directions", "stops")
    stop = found.stop and {
        **exported(found.stop, "distance", values="drawn.values"),
        **exported(found.stop.run, "outcome", "braking_distance", "braking_time", "max_slip"),
    }
    own = {"event": str(found.event), **exported(found, "probability", *names)}
    return {"version": __version__, **own, **exported(found, "warnings", hash="campaign.fingerprint"), "stop": stop}


def confidence_json(found: ConfidenceLevels) -> dict[str, Any]:
    """The same, unrounded."""
    own = exported(found, "factors", "stops", "warnings", hash="campaign.fingerprint", nominal_deceleration="nominal")
    return {"version": __version__, **own}


def confidence_csv(found: ConfidenceLevels) -> str:
    """A row a level."""
    rows = ((f.level, f.probability, f.deceleration, *f.factor) for f in found.factors)
    return _csv("ebcl,probability,deceleration [m/s^2],kdry_rst [1],low [1],high [1]", rows)


def tail_csv(tail: Tail, head: str) -> str:
    """Probabilities of what is worse than each value."""
    rows = zip(*(column.tolist() for column in tail[:4]), strict=True)
    return _csv(f"{head},probability [1],low [1],high [1]", rows)


def stop_toml(found: RareEvent, scenario: str) -> str:
    """Scenario file of the most likely failing stop; `scenario`: the campaign's, by its name or path."""
    assert found.stop is not None, "asked for where there is one"
    changes = found.campaign.changes(found.stop.drawn.values.values()).get(0, {})
    numbers = (f"{json.dumps(path)} = {value!r}" for path, value in changes.items())
    return "\n".join([f"extends = {json.dumps(scenario)}", "", "[changes]  # SI", *numbers]) + "\n"


def _case(found: RareEvent | ConfidenceLevels) -> str:
    return f"{found.campaign.scenario.name}, {found.campaign.controllers[0].label}"


def _warned(found: RareEvent | ConfidenceLevels) -> list[Text]:
    return [Text(f"Warning: {warning}.") for warning in found.warnings]


def _interval(found: Estimate, digits: int) -> str:
    value, low, high = (fixed(number, digits) for number in found)
    return f"{value} [{low}, {high}]"


def _estimate(found: Estimate, variation: float) -> str:
    return f"{_interval(found, 3)}, coefficient of variation {100.0 * variation:.0f} %"


def _csv(head: str, rows: Iterable[tuple[float, ...]]) -> str:
    return "\n".join([head, *(",".join(map(repr, row)) for row in rows)]) + "\n"
