"""Results of a campaign (many runs with varied quantities) and of one repeated run, as text and JSON."""

from __future__ import annotations

import math
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from railslip_ctrl import __version__
from railslip_ctrl.simulation.campaign.execution import COLUMNS, MEASURES, Measure, Replay, measured
from railslip_ctrl.simulation.campaign.specification import Campaign, Quantity, Sampling, described
from railslip_ctrl.simulation.campaign.statistics import (
    CONFIDENCE,
    LEVELS,
    LISTED,
    CampaignSummary,
    ControllerSummary,
    Estimate,
)
from railslip_ctrl.simulation.run import Outcome, Run

from .document import Facts, Table, fixed, heading, render
from .export import exported, plain


def headed(title: str, unit: str) -> str:
    """Return the title of a table column or an axis; the unit follows in brackets unless it is empty or "1"."""
    return title if unit in ("", "1") else f"{title} ({unit})"


def measure_head(measure: Measure) -> str:
    """Return the title of a measure, such as the braking distance, with the unit in which tables show it."""
    return headed(measure.title, measure.shown_unit or measure.unit)


def quantity_heads(campaign: Campaign) -> dict[str, str]:
    """Return a column title for each varied quantity: the end of its dotted path, and its unit.

    A title is as short as possible, but no two quantities have the same title.
    """
    endings = {
        name: [name.split(".", dots)[-1] for dots in range(name.count("."), -1, -1)]  # shortest first
        for name in campaign.quantity_units
    }
    heads = {}
    for name, unit in campaign.quantity_units.items():
        apart = (e for e in endings[name] if not any(e in endings[other] for other in endings if other != name))
        heads[name] = headed(next(apart, name), unit)
    return heads


def campaign_text(summary: CampaignSummary) -> str:
    """Return the report of a campaign as text."""
    parts: list[RenderableType] = [heading(f"Campaign: {summary.runs} runs of {summary.campaign.scenario.name}")]
    parts += [Facts(_campaign_facts(summary)), heading("Outcomes", "-"), _outcome_table(summary)]
    if failed := _failures(summary):
        parts += [*failed, Text("The averages below do not include these runs.")]
    parts.append(heading("Runs that stopped", "-"))
    if summary.any_stopped:
        parts += [_mean_table(summary), _quantile_table(summary), Text(_interval_note(summary))]
    else:
        parts.append(Text("No run stopped, so that there are no statistics and no pictures."))
    if summary.points:
        parts += [
            heading("Grid: mean braking distance, m, and share of unfinished stops", "-"),
            _grid_table(summary),
        ]
    if summary.paired:
        parts += [heading("Controllers on the same runs (second minus first)", "-"), _paired_table(summary)]
    parts += [heading(f"Worst runs by {measured(summary.worst_by).title}", "-"), *_worst(summary)]
    parts.append(Text("To repeat a run with its time series, give the same command with --replay NUMBER"))
    return render(parts)


def campaign_table(summary: CampaignSummary) -> str:
    """Return a table with one line for each controller."""

    def row(item: ControllerSummary) -> tuple[str, ...]:
        distance, slip = item.measures["braking_distance_m"], item.measures["max_slip"]
        levels = (distance.quantiles[level].value for level in (0.5, 0.95) if level in distance.quantiles)
        ends = (*levels, distance.moments.high, slip.moments.high) if item.stopped else (None,) * 4
        numbers = (_shown(measured("max_slip"), value, 4) for value in ends)
        return (item.name, f"{item.stopped} of {summary.runs}", *numbers, _percent(item.locked))

    heads = ("controller", "stopped", "median (m)", "95 % (m)", "worst (m)", "highest slip", "locked (%)")
    return render([Table(heads, [row(item) for item in summary.controllers.values()])]).strip("\n")


def replay_text(replayed: Replay) -> str:
    """Return the report on one repeated run of a campaign as text."""
    rows = [("Sampled", ", ".join(f"{name} {fixed(value)}" for name, value in replayed.values.items()) or "nothing")]
    known = "bit for bit equal to the stored row" if replayed.stored else "the folder does not contain this run yet"
    rows.append(("Compared", known))
    rows += [(name, _end(run)) for name, run in replayed.runs.items()]
    cells = [
        (measure_head(measure), *(_shown(measure, measure.of(run)) for run in replayed.runs.values()))
        for measure in MEASURES
    ]
    return render([heading(f"Run {replayed.number}, repeated"), Facts(rows), Table(("measure", *replayed.runs), cells)])


def replay_json(replayed: Replay) -> dict[str, Any]:
    """Return one repeated run of a campaign as JSON, with unrounded numbers."""
    runs = {
        name: {"outcome": run.outcome.value, **{measure.name: plain(measure.of(run)) for measure in COLUMNS}}
        for name, run in replayed.runs.items()
    }
    return exported(replayed, "values", "stored", run="number") | {"controllers": runs}


def campaign_json(summary: CampaignSummary) -> dict[str, Any]:
    """Return a campaign as JSON, with unrounded numbers; an unbounded end of an interval is null."""
    pair_names = {"mean_difference": "difference", "share_second_smaller": "second_smaller"}
    named = {"hash": "fingerprint", "scenario": "scenario.name", "runs_asked": "runs"}
    return {
        "version": __version__,
        "confidence": CONFIDENCE,
        **exported(summary.campaign, "seed", "sampling", **named),
        **exported(summary, "runs", "complete", "worst_by"),
        "quantities": _quantity_texts(summary),
        "controllers": {name: _controller_json(item) for name, item in summary.controllers.items()},
        "paired": [exported(pair, "first", "second", "measure", "pairs", **pair_names) for pair in summary.paired],
        "points": [
            {
                **exported(point, "values", "not_stopped"),
                "means": [
                    {"controller": name, "measure": measure, **plain(item)}
                    for (name, measure), item in point.means.items()
                ],
            }
            for point in summary.points
        ],
    }


def _controller_json(item: ControllerSummary) -> dict[str, Any]:
    shares = {"failed_runs": "failed", "share_not_stopped": "not_stopped", "share_locked": "locked"}
    moments = {"count": "count", "mean": "estimate", "std": "std", "min": "low", "max": "high"}
    measures = {
        name: {
            **exported(measure, "excluded"),
            **exported(measure.moments, **moments),
            "quantiles": {f"{level:g}": plain(value) for level, value in measure.quantiles.items()},
        }
        for name, measure in item.measures.items()
    }
    return exported(item, "outcomes", "worst", **shares) | {"measures": measures}


def _campaign_facts(summary: CampaignSummary) -> list[tuple[str, str]]:
    campaign = summary.campaign
    rows = [("Controllers", ", ".join(campaign.controller_names))]
    rows += [("Varied", text) for text in _quantity_texts(summary) or ["only the noise"]]
    rows.append(("Sampling", f"{campaign.sampling.value}, seed {campaign.seed}"))
    if not summary.complete:
        rows.append(("Unfinished", f"{summary.runs} of {campaign.runs} runs; the same command continues the campaign"))
    return rows


def _quantity_texts(summary: CampaignSummary) -> list[str]:
    units = summary.campaign.quantity_units
    return [_quantity_text(quantity, units[quantity.name]) for quantity in summary.campaign.quantities]


def _quantity_text(quantity: Quantity, unit: str) -> str:
    given = described(quantity.distribution)
    del given["kind"]
    lists = {name: value if isinstance(value, list) else [value] for name, value in given.items() if value is not None}
    numbers = ", ".join(f"{name} {' '.join(f'{v:g}' for v in values)}" for name, values in lists.items())
    factor = "factor on " if quantity.relative else ""
    return headed(f"{factor}{', '.join(quantity.paths)}: {quantity.distribution.kind}, {numbers}", unit)


def _outcome_table(summary: CampaignSummary) -> RenderableType:
    outcomes = [o.value for o in Outcome]
    present = {o for c in summary.controllers.values() for o in c.outcomes}
    columns = [o for o in [*outcomes, *sorted(present - set(outcomes))] if o in present]
    rows = [
        (c.name, *(str(c.outcomes.get(o, 0)) for o in columns), _percent(c.not_stopped), _percent(c.locked))
        for c in summary.controllers.values()
    ]
    return Table(("controller", *columns, "not stopped, %", "wheel locked at some time, %"), rows)


def _failures(summary: CampaignSummary) -> list[RenderableType]:
    lines = []
    for c in summary.controllers.values():
        for outcome, runs in c.failed.items():
            more = " ..." if c.outcomes[outcome] > LISTED else ""
            lines.append(f"{c.name}, {outcome}: runs {', '.join(map(str, runs))}{more}")
    return [Text("\n".join(lines))] if lines else []


def _mean_table(summary: CampaignSummary) -> RenderableType:
    rows = []
    for measure in MEASURES:
        for c in summary.controllers.values():
            statistics, moments = c.measures[measure.name], c.measures[measure.name].moments
            spread = (moments.std, moments.low, moments.high) if moments.count else (None, None, None)
            runs = str(moments.count) + (f" ({statistics.excluded} without a value)" if statistics.excluded else "")
            numbers = (_shown(measure, value, 3) for value in spread)
            rows.append(
                (measure_head(measure), c.name, runs, _with_interval(moments.estimate, measure.scale), *numbers)
            )
    return Table(("measure", "controller", "runs", "mean", "std", "min", "max"), rows, left=2)


def _quantile_table(summary: CampaignSummary) -> RenderableType:
    rows = []
    for measure in MEASURES:
        for c in summary.controllers.values():
            quantiles = c.measures[measure.name].quantiles
            cells = [_with_interval(quantiles[level], measure.scale) if level in quantiles else "-" for level in LEVELS]
            rows.append((measure_head(measure), c.name, *cells))
    head = ("measure", "controller", *("median" if level == 0.5 else f"{100 * level:g} %" for level in LEVELS))
    return Table(head, rows, left=2)


def _shown(measure: Measure, value: float | None, digits: int = 5) -> str:
    return "-" if value is None else fixed(measure.scale * value, digits)


def _end(run: Run) -> str:
    return f"{run.outcome.value} after {fixed(run.braking_time)} s and {fixed(run.braking_distance)} m"


def _interval_note(summary: CampaignSummary) -> str:
    note = (
        f"Brackets contain the {100 * CONFIDENCE:g} % interval: Student's for a mean, between two order statistics for "
        "a quantile, Wilson's for a share. A missing bound needs more runs."
    )
    if summary.campaign.sampling is not Sampling.RANDOM:
        note += " The intervals assume independent runs; with evenly spaced points means are more accurate than shown."
    if summary.points:
        note += " Over the whole grid, statistics weight all points equally."
    return note


def _grid_table(summary: CampaignSummary) -> RenderableType:
    names = summary.campaign.controller_names
    rows = []
    for point in summary.points:
        where = ", ".join(f"{name} {value:g}" for name, value in point.values.items())
        means = (_with_interval(point.means[name, "braking_distance_m"]) for name in names)
        rows.append((where, *means, *(_percent(point.not_stopped[name]) for name in names)))
    return Table(("point", *names, *(f"{name}, % not stopped" for name in names)), rows)


def _paired_table(summary: CampaignSummary) -> RenderableType:
    rows = []
    for pair in summary.paired:
        measure, names = measured(pair.measure), f"{pair.second} - {pair.first}"
        difference = _with_interval(pair.difference, measure.scale)
        rows.append((measure_head(measure), names, str(pair.pairs), difference, _percent(pair.second_smaller)))
    return Table(("measure", "controllers", "runs", "mean difference", "second smaller, %"), rows, left=2)


def _worst(summary: CampaignSummary) -> list[RenderableType]:
    heads, measure = quantity_heads(summary.campaign), measured(summary.worst_by)
    rows = [
        (c.name, str(row["run"]), _shown(measure, row[measure.name]), *(fixed(row[name]) for name in heads))
        for c in summary.controllers.values()
        for row in c.worst
    ]
    failed = _failures(summary)
    return [*failed, *([Table(("controller", "run", measure_head(measure), *heads.values()), rows)] if rows else [])]


def _with_interval(estimate: Estimate, scale: float = 1.0) -> str:
    value, low, high = (scale * v for v in estimate)
    if math.isnan(value):
        return "-"
    known = [end for end in (low, high) if math.isfinite(end)]
    half = max((abs(end - value) for end in known), default=0.0)
    # the last digit is about a tenth of the half interval
    digits = 3 if half == 0.0 or abs(value) <= half else min(7, 2 + math.ceil(math.log10(abs(value) / half)))
    if not known:
        return fixed(value, digits)
    low_text, high_text = (fixed(end, digits) if math.isfinite(end) else "" for end in (low, high))
    return f"{fixed(value, digits)} [{low_text}, {high_text}]"


def _percent(estimate: Estimate) -> str:
    if math.isnan(estimate.value):
        return "-"
    low, high = (fixed(100 * end, 3) for end in estimate[1:])
    return f"{fixed(100 * estimate.value, 3)} [{low}, {high}]"
