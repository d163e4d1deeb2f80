"""Pictures of a campaign: distributions, what they depend on, a run again."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from railslip_ctrl.campaign.execution import Replay
from railslip_ctrl.campaign.rows import measured
from railslip_ctrl.campaign.statistics import CampaignSummary

from .style import line_style, new_figure

SHOWN = ("braking_distance_m", "mean_abs_slip_error", "max_slip", "brake_energy_j")
"""Measures drawn, if none are named."""

# where a controller's label stands beside its worst run: each has its own corner, as two may lie in one place
_CORNERS = ((1, 1), (-1, -1), (1, -1), (-1, 1))


def distributions_figure(summary: CampaignSummary, measures: Sequence[str] = SHOWN) -> Figure | None:
    """Histogram and distribution function of some measures, over the runs that stopped; None where none did."""
    if not summary.any_stopped:
        return None
    figure = new_figure(10.0, 6.2, _title(summary))
    axes = figure.subplots(2, len(measures), sharex="col", squeeze=False)
    for (top, bottom), name in zip(axes.T, measures, strict=True):
        for i, found in enumerate(summary.controllers.values()):
            measure, scale = found.measures[name], measured(name).scale
            if not measure.moments.count:
                top.plot([], [], label=f"{found.name} (none)", **line_style(i))
                continue
            edges, counts = measure.histogram
            shape = measure.histogram.merged()
            density = shape.counts / counts.sum() / np.diff(scale * shape.edges)
            top.stairs(density, scale * shape.edges, label=f"{found.name} ({measure.moments.count})", **line_style(i))
            upto = np.concatenate([[0.0], np.cumsum(counts) / counts.sum()])
            bottom.plot(scale * edges, upto, **line_style(i))
        top.set_yticks([])
        bottom.set_xlabel(_dotted(measured(name).head))
        bottom.grid(True, color="0.88")
    axes[0, 0].set_ylabel("density of runs")
    axes[1, 0].set_ylabel("share of runs up to here")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, loc="outside lower center", frameon=False, ncols=len(labels) or 1)
    return figure


def scatter_figure(summary: CampaignSummary) -> Figure | None:
    """The measure by which the worst are chosen, over each varied quantity, with the worst runs numbered.

    None where nothing is varied or no run stopped.
    """
    heads, measure = summary.campaign.quantity_heads, measured(summary.worst_by)
    if not heads or not summary.any_stopped:
        return None
    columns = min(3, len(heads))
    rows = -(-len(heads) // columns)
    figure = new_figure(3.6 * columns + 0.6, 3.2 * rows + 0.8, _title(summary))
    axes = figure.subplots(rows, columns, sharey=True, squeeze=False)
    for ax, (quantity, head) in zip(axes.flat, heads.items(), strict=False):
        for i, (name, found) in enumerate(summary.controllers.items()):
            sample, color = summary.sample[name], line_style(i)["color"]
            stopped = sample["stopped"].astype(bool)
            values, results = sample[quantity], measure.scale * sample[measure.name]
            ax.plot(values[stopped], results[stopped], ".", color=color, markersize=3, alpha=0.5, label=name)
            for row in found.worst:
                ax.plot(row[quantity], measure.scale * row[measure.name], "o", color=color, fillstyle="none")
            for row in found.worst[:1]:
                place, (right, up) = (row[quantity], measure.scale * row[measure.name]), _CORNERS[i % len(_CORNERS)]
                ax.annotate(
                    f"{row['run']}",
                    place,
                    (4 * right, 4 * up),
                    textcoords="offset points",
                    ha="left" if right > 0 else "right",
                    va="bottom" if up > 0 else "top",
                    fontsize=7,
                    color=color,
                    path_effects=[withStroke(linewidth=1.2, foreground="white")],  # legible over marks
                )
        ax.margins(x=0.12)  # a label beside the outermost mark stays inside
        ax.set_xlabel(_dotted(head))
        ax.grid(True, color="0.88")
    for ax in axes.flat[len(heads) :]:
        ax.set_visible(False)
    for ax in axes[:, 0]:
        ax.set_ylabel(_dotted(measure.head))
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(
        handles, labels, fontsize=8, loc="outside lower center", frameon=False, ncols=len(labels), markerscale=3
    )
    return figure


def replay_figure(replayed: Replay) -> Figure:
    """Speeds, slip and torque of a run, each controller."""
    figure = new_figure(9.0, 3.0 * len(replayed.runs) + 3.0, f"Run {replayed.number} again")
    axes = figure.subplots(3, len(replayed.runs), sharex="col", sharey="row", squeeze=False)
    for column, (name, run) in zip(axes.T, replayed.runs.items(), strict=True):
        signals = run.signals
        assert signals is not None, "a replay records them"
        radius = run.scenario.vehicle.wheel.radius
        column[0].plot(signals.time, 3.6 * signals.speed, label="train", **line_style(0))
        column[0].plot(signals.time, 3.6 * radius * signals.wheel_speed, label="wheel", **line_style(1))
        column[1].plot(signals.time, signals.slip, label="slip", **line_style(0))
        column[1].plot(signals.time, signals.reference, label="reference", **line_style(1))
        column[2].plot(signals.time, signals.command / 1e3, label="command", **line_style(2))
        column[2].plot(signals.time, signals.torque / 1e3, label="acting", **line_style(0))
        column[0].set_title(
            f"{name}: {run.outcome.value} after {run.braking_distance:.0f} m, {run.braking_time:.1f} s", fontsize=9
        )
        column[2].set_xlabel("time (s)")
        for ax in column:
            ax.grid(True, color="0.88")
    for ax, label in zip(axes[:, 0], ("speed (km/h)", "slip ratio", "torque (kN·m)"), strict=True):
        ax.set_ylabel(label)
        ax.legend(fontsize=7, frameon=False)
    return figure


def _title(summary: CampaignSummary) -> str:
    return f"{summary.runs} runs of {summary.campaign.scenario.name}; those that stopped"


def _dotted(head: str) -> str:
    return head.replace("*", "·")
