"""Controllers compared over braking runs."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from railslip_ctrl.simulation.run_comparison import ControllerRow, RunComparison

from .style import SMALL, TEXT, new_figure, panels

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
