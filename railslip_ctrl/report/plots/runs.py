"""Controllers compared over braking runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.figure import Figure

from railslip_ctrl.core.units import KMH
from railslip_ctrl.report.plots.style import (
    PAGE_WIDTH,
    SMALL,
    TEXT,
    folded,
    legend_beside,
    line_style,
    new_figure,
    panels,
)
from railslip_ctrl.simulation import Run
from railslip_ctrl.simulation.run import events_log
from railslip_ctrl.simulation.run_comparison import ControllerRow, RunComparison

_BAR = {"color": "0.75", "edgecolor": "black", "linewidth": 0.8}


def run_comparison_figure(comparisons: Sequence[RunComparison]) -> Figure:
    """Braking distance and mean slip error of every controller, a row of axes a scenario; the bound as a line."""
    seeds = ", ".join(dict.fromkeys(f"{len(one.seeds)}" for one in comparisons))
    figure = new_figure(0.4 + 2.7 * len(comparisons), f"Braking distance and slip error, means over {seeds} seeds")
    for axes, comparison in zip(panels(figure, len(comparisons), 2), comparisons, strict=True):
        names = [row.name for row in comparison.rows]
        distance, error = axes
        places = range(len(names))
        bars = distance.barh(
            places,
            [row.braking_distance.value for row in comparison.rows],
            xerr=[row.braking_distance.error for row in comparison.rows],
            **_BAR,
        )
        distance.bar_label(bars, [_met(row) for row in comparison.rows], padding=3, fontsize=SMALL)
        bound = comparison.bound.braking_distance
        distance.axvline(bound, color="black", linestyle="--")
        distance.set_xlabel(f"braking distance (m)\ndashed: no controller below {bound:.0f} m")
        bars = error.barh(places, [row.slip_error.value for row in comparison.rows], **_BAR)
        error.bar_label(bars, [f"{row.slip_error.value:.3f}" for row in comparison.rows], padding=3, fontsize=SMALL)
        error.set_xlabel("mean |slip − reference| (-)")
        distance.set_title(f"{comparison.scenario.name}, inertia scale {comparison.scenario.vehicle.inertia_scale:g}")
        distance.title.set_fontsize(TEXT)
        distance.set_yticks(places, names, fontsize=SMALL)
        error.set_yticks(places, [""] * len(names))
        for each in axes:
            each.invert_yaxis()
            each.grid(visible=False, axis="y")
            each.margins(x=0.2)  # room for the numbers
    return figure


def _met(row: ControllerRow) -> str:
    """The mean distance, and of how many runs where some did not stop."""
    few = "" if row.stopped == row.runs else f" ({row.stopped} of {row.runs})"
    return f"{row.braking_distance.value:.0f}{few}"


# --- pictures of a braking run ---------------------------------------------------------------------------------------


_ENOUGH_TORQUE = 1.15  # of the highest acting torque; a command far above it is cut off in the picture


def simulation_figure(run: Run, *, title: str | None = None) -> Figure:
    """Speeds, slip with its reference, torque commanded and acting, and adhesion over time; needs `run.signals`.

    A vertical line stands at each event that happened.
    """
    assert run.signals is not None, "the run was recorded"
    name = f"{run.scenario.name}, {run.controller.name}: {run.outcome.value} at {run.braking_time:.4g} s"
    noise = "without noise" if run.seed is None else f"seed {run.seed}"
    figure = new_figure(8.0, title or f"{name}, {run.braking_distance:.4g} m; {noise}")
    axes = panels(figure, 4, sharex=True)[:, 0]
    events = [one for one in events_log(run) if one.reached]
    for ax, draw in zip(axes, (_speeds, _slip, _torque, _adhesion), strict=True):
        draw(ax, run)
        for one in events:
            ax.axvline(one.time, color="0.6", linewidth=0.8, linestyle=(0, (1, 2)))
        if len(ax.lines) > 1 and ax.get_legend_handles_labels()[0]:
            legend_beside(ax)
    told = "\n".join(f"dotted, {one.text}" for one in events)
    axes[-1].set_xlabel(folded(f"time (s)\n{told}" if told else "time (s)", 0.8 * PAGE_WIDTH))
    axes[-1].set_xlim(0.0, float(run.signals.time[-1]))
    return figure


def _speeds(ax: Any, run: Run) -> None:
    signals = run.signals
    assert signals is not None
    ax.plot(signals.time, signals.speed / KMH, label="train, v", **line_style(0))
    rim = (signals.speed - signals.slip_velocity) / KMH
    ax.plot(signals.time, rim, label="wheel rim, rω", linewidth=0.9, **line_style(1))
    ax.set_ylabel("speed (km/h)")
    ax.set_ylim(bottom=0.0)


def _slip(ax: Any, run: Run) -> None:
    signals = run.signals
    assert signals is not None
    ax.plot(signals.time, signals.slip, label="slip ratio", linewidth=0.9, **line_style(0))
    ax.plot(signals.time, signals.reference, label="reference", **line_style(1))
    ax.set_ylabel("slip ratio λ (-)")


def _torque(ax: Any, run: Run) -> None:
    signals = run.signals
    assert signals is not None
    ax.plot(signals.time, signals.command / 1000, label="commanded", color="0.65", linewidth=0.7)
    ax.plot(signals.time, signals.torque / 1000, label="acting", **line_style(0))
    top = _ENOUGH_TORQUE * max(run.max_torque, 1.0) / 1000
    cut = float(signals.command.max()) / 1000 > 2 * top
    ax.set_ylim(0.0, top if cut else None)
    ax.set_ylabel("brake torque (kN·m)" + ("\ncommand cut off" if cut else ""))


def _adhesion(ax: Any, run: Run) -> None:
    signals = run.signals
    assert signals is not None
    load = run.scenario.vehicle.wheel_load
    ax.plot(signals.time, signals.adhesion_force / load, color=line_style(0)["color"], linewidth=0.9)
    ax.set_ylabel("adhesion coefficient μ (-)")
