"""Pictures of a campaign: distributions, what they depend on, a run again."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from railslip_ctrl.report.campaign import measure_head, quantity_heads
from railslip_ctrl.simulation.campaign.execution import Replay, measured
from railslip_ctrl.simulation.campaign.statistics import CampaignSummary

from .runs import runs_figure
from .style import (
    PAGE_WIDTH,
    SMALL,
    TEXT,
    folded,
    grid_of,
    legend_of_figure,
    line_style,
    mark_style,
    new_figure,
    panels,
    plain_ticks,
)

SHOWN = ("braking_distance_m", "mean_abs_slip_error", "max_slip", "brake_energy_j")
"""Measures drawn, if none are named."""

# where a controller's label stands beside its worst run: each has its own corner, as two may lie in one place
_CORNERS = ((1, 1), (-1, -1), (1, -1), (-1, 1))


def distributions_figure(summary: CampaignSummary, measures: Sequence[str] = SHOWN) -> Figure | None:
    """Histogram and distribution function of some measures, over the runs that stopped; None where none did."""
    if not summary.any_stopped:
        return None
    figure = new_figure(0.9 + 1.5 * len(measures), _title(summary))
    axes = panels(figure, len(measures), 2, sharex="row")
    for (density_axes, share), name in zip(axes, measures, strict=True):
        for i, found in enumerate(summary.controllers.values()):
            measure, scale = found.measures[name], measured(name).scale
            if not measure.moments.count:
                density_axes.plot([], [], label=f"{found.name} (none)", **line_style(i))
                continue
            edges, counts = measure.histogram
            shape = measure.histogram.merged()
            density = shape.counts / counts.sum() / np.diff(scale * shape.edges)
            label = f"{found.name} ({measure.moments.count})"
            density_axes.stairs(density, scale * shape.edges, label=label, **line_style(i))
            upto = np.concatenate([[0.0], np.cumsum(counts) / counts.sum()])
            share.plot(scale * edges, upto, **line_style(i))
        density_axes.set_yticks([])
        plain_ticks(share, 4)  # for both, which share the axis
        for ax in (density_axes, share):
            ax.set_xlabel(_dotted(measure_head(measured(name))))
    axes[0, 0].set_title("density of runs", fontsize=TEXT)
    axes[0, 1].set_title("share of runs up to here (-)", fontsize=TEXT)
    legend_of_figure(figure, axes[0, 0], columns=4)
    return figure


def scatter_figure(summary: CampaignSummary) -> Figure | None:
    """The measure by which the worst are chosen, over each varied quantity, with the worst runs numbered.

    None where nothing is varied or no run stopped.
    """
    heads, measure = quantity_heads(summary.campaign), measured(summary.worst_by)
    if not heads or not summary.any_stopped:
        return None
    columns = 2 if len(heads) in (2, 4) else min(3, len(heads))
    told = "rings: the worst runs of each controller, with the number of the worst"
    figure, axes = grid_of(len(heads), columns, f"{_title(summary)}; {told}", (0.8, 2.5), sharey=True)
    for ax, (quantity, head) in zip(axes, heads.items(), strict=True):
        for i, (name, found) in enumerate(summary.controllers.items()):
            sample, color = summary.sample[name], line_style(i)["color"]
            fill = "none" if i % 2 else "full"  # in grey, what is in marks of one size tells them apart
            look = {"markersize": 2.4, "alpha": 0.6, "fillstyle": fill, "markeredgewidth": 0.6, **mark_style(i)}
            ax.plot(sample[quantity], measure.scale * sample[measure.name], label=name, **look)
            for row in found.worst:
                ax.plot(row[quantity], measure.scale * row[measure.name], "o", color=color, fillstyle="none")
            for row in found.worst[:1]:
                place, (right, up) = (row[quantity], measure.scale * row[measure.name]), _CORNERS[i % len(_CORNERS)]
                ax.annotate(
                    f"{row['run']}",
                    place,
                    (6 * right, 6 * up),
                    textcoords="offset points",
                    ha="left" if right > 0 else "right",
                    va="bottom" if up > 0 else "top",
                    fontsize=SMALL,
                    color=color,
                    path_effects=[withStroke(linewidth=1.2, foreground="white")],  # legible over marks
                )
        ax.margins(x=0.12, y=0.15)  # a label beside the outermost mark stays inside
        ax.set_xlabel(folded(_dotted(head), 0.9 * PAGE_WIDTH / columns))
    for ax in axes[::columns]:
        ax.set_ylabel(_dotted(measure_head(measure)))
    legend_of_figure(figure, axes[0], columns=4, markerscale=3)
    return figure


def replay_figure(replayed: Replay) -> Figure:
    """Speeds, slip and torque of a run, each controller."""
    runs = {
        f"{name}: {run.outcome.value} after {run.braking_distance:.0f}\u00a0m, {run.braking_time:.1f}\u00a0s": run
        for name, run in replayed.runs.items()
    }
    return runs_figure(runs, f"Run {replayed.number} again")


def _title(summary: CampaignSummary) -> str:
    return f"{summary.runs} runs of {summary.campaign.scenario.name}; those that stopped"


def _dotted(head: str) -> str:
    """A column's name and unit as on an axis."""
    words = head.replace("_", " ").replace("*", "·")
    return words if "(" in head else f"{words} (-)"
