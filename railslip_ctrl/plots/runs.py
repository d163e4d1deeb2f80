"""Controllers compared over braking runs."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from railslip_ctrl.run_comparison import RunComparison

from .style import new_figure


def run_comparison_figure(comparisons: Sequence[RunComparison]) -> Figure:
    """Braking distance and mean slip error of every controller, a row of axes a scenario; the bound as a line."""
    figure = new_figure(8.0, 3.2 * len(comparisons), "Braking distance and slip error, means over the seeds")
    for axes, comparison in zip(figure.subplots(len(comparisons), 2, squeeze=False), comparisons, strict=True):
        names = [row.name for row in comparison.rows]
        distance, error = axes
        places = range(len(names))
        distance.barh(
            places,
            [row.braking_distance.value for row in comparison.rows],
            xerr=[row.braking_distance.error for row in comparison.rows],
            color="0.75",
            edgecolor="black",
        )
        bound = comparison.bound.braking_distance
        distance.axvline(bound, color="black", linestyle="--")
        distance.set_xlabel(f"braking distance, m; dashed: no controller below {bound:.0f} m")
        error.barh(places, [row.slip_error.value for row in comparison.rows], color="0.75", edgecolor="black")
        error.set_xlabel("mean |slip - reference|")
        distance.set_title(f"{comparison.scenario.name}, inertia scale {comparison.scenario.vehicle.inertia_scale:g}")
        distance.title.set_fontsize(9)
        distance.set_yticks(places, names, fontsize=8)
        error.set_yticks(places, [""] * len(names))
        for each in axes:
            each.invert_yaxis()
            each.grid(visible=True, axis="x", linewidth=0.3)
            each.set_axisbelow(True)
    return figure
