"""Pictures of a design report: adhesion with its operating points, stops side by side, the paper's numbers."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from railslip_ctrl.design.specification import ROBUST_MS
from railslip_ctrl.design_check import DesignCheck
from railslip_ctrl.design_report import LawCurve, LinearPart, RunPart, SpeedRange, Stop
from railslip_ctrl.law_sources import PUBLISHED, law_words, words_at
from railslip_ctrl.reproduction import QUANTITIES, Table5
from railslip_ctrl.simulation import Run
from railslip_ctrl.units import KMH

from .designs import gang_of_four_figure, region_figure, response_figure
from .loops import bode_figure, nichols_figure, nyquist_figure, one_group_figure
from .style import (
    PAGE_HEIGHT,
    TEXT,
    folded,
    legend_below,
    legend_of_figure,
    line_style,
    mark_style,
    new_figure,
    panels,
    plain_log_ticks,
)

_COLUMNS = ("speed (km/h)", "slip ratio λ (-)", "brake torque (kN·m)")
_QUANTITIES = dict(
    zip(QUANTITIES, ("braking time", "braking distance", "brake energy", "mean |slip error|"), strict=True)
)
# open, around the triangle of a peak at the same place, and above the lines of other laws
_POINT = {"marker": "o", "markersize": 10, "markerfacecolor": "none", "markeredgewidth": 1.4, "zorder": 4}
_ROW = 1.17  # inches, of a controller in the picture of a stop
_MS_TOP = 5.0  # an Ms beyond it is as good as unstable; the axis ends there
_ENOUGH_TORQUE = 1.3  # of the highest acting torque; a command far above it is cut off in the picture


Drawing = Callable[[], Figure]
"""What draws a figure, here or, as it can be pickled, in another process."""


def linear_drawings(part: LinearPart) -> dict[str, Drawing]:
    """Figures of the linear loops by name; what has nothing to show is left out."""
    loops, region, where = part.loops, part.region, part.loops.shown_at
    title = f"{where.adhesion}, {where.rail} rail, {where.speed_kmh:g} km/h, slip {where.slip:g}; dead time exact"
    drawings: dict[str, Drawing] = {"adhesion": partial(_adhesion, part.curves)}
    if region.grid is not None:
        drawings["region"] = partial(
            region_figure,
            region.strips,
            region.grid,
            {name: gains for name, gains in region.chosen.items() if region.near(gains)},
            title=f"PI gains that stabilise each of the {len(part.plants)} operating points; dead time exact",
        )
    drawings |= check_drawings(part.check)
    if part.recommended is not None:
        drawings["recommended"] = partial(one_group_figure, part.recommended)
    if loops.gangs:
        drawings["gang"] = partial(gang_of_four_figure, loops.gangs, title=title)
    if loops.reference:
        drawings["responses"] = partial(
            response_figure,
            loops.reference,
            loops.load,
            title=title,
            reference_label="step of 1 km/h of the reference slip velocity",
            load_label=f"step of {loops.load_step:g} N·m of torque at the wheel",
        )
    if loops.speeds is not None:
        drawings["range"] = partial(_range, loops.speeds)
    return drawings


def check_drawings(check: DesignCheck) -> dict[str, Drawing]:
    """Figures of the design check alone by name: Bode, Nyquist, Nichols."""
    drawn = {"bode": bode_figure, "nyquist": nyquist_figure, "nichols": nichols_figure}
    return {name: partial(draw, check.groups) for name, draw in drawn.items()}


def run_drawings(part: RunPart) -> dict[str, Drawing]:
    """Figures of the braking runs and of the paper's numbers by name."""
    drawings: dict[str, Drawing] = {
        f"stop-{i}": partial(_stop, stop) for i, stop in enumerate(part.stops, start=1) if _ran(stop)
    }
    if part.table5 is not None:
        drawings["table5"] = partial(_deviations, part.table5)
    return drawings


def _adhesion(curves: tuple[LawCurve, ...]) -> Figure:
    rails = list(dict.fromkeys(curve.rail for curve in curves))
    speeds = {curve.speed_kmh for curve in curves}
    figure = new_figure(4.4, "Adhesion at rest over slip; circles: operating points, triangles: peaks")
    axes = panels(figure, 1, len(rails), sharex=True, sharey=True)[0]
    for ax, rail in zip(axes, rails, strict=True):
        for i, curve in enumerate(one for one in curves if one.rail is rail):
            style = line_style(i) | {"linewidth": 1.8 if curve.asked else 1.0}
            at = f", {curve.speed_kmh:g} km/h" if len(speeds) > 1 else ""
            ax.plot(curve.slip, curve.coefficient, label=f"{_law_name(curve)}{at}", **style)
            ax.plot(
                curve.peak.slip, curve.peak.coefficient, marker="^", markersize=5, color=style["color"], clip_on=False
            )
            for point in curve.points:
                ax.plot(point.slip, point.adhesion_coefficient, color=style["color"], **_POINT)
        ax.set_title(f"{rail} rail", fontsize=TEXT)
        ax.set_xlabel("slip ratio λ (-)")
        ax.set_xlim(left=0.0)
        ax.set_ylim(bottom=0.0)
        legend_below(ax, 0.15, columns=2)
    axes[0].set_ylabel("adhesion coefficient μ (-)")
    return figure


def _law_name(curve: LawCurve) -> str:
    return words_at(curve.points[0]) if curve.points else curve.law


def _range(speeds: SpeedRange) -> Figure:
    """Ms and phase margin over speed, a line a law and rail: the worse of its loads."""
    figure = new_figure(3.9, f"{speeds.name}: margins over speed, worse of the loads; a line ends where it is unstable")
    top, bottom = panels(figure, 2, 1, sharex=True)[:, 0]
    kinds = list(dict.fromkeys((line.law, line.rail) for line in speeds.lines))
    for i, (law, rail) in enumerate(kinds):
        lines = [line for line in speeds.lines if (line.law, line.rail) == (law, rail)]
        # NaN of one load, unstable there, is NaN of both
        ms = np.max([line.margins.ms for line in lines], axis=0)
        phase = np.min([line.margins.phase_deg for line in lines], axis=0)
        top.semilogx(lines[0].speeds_kmh, ms, label=f"{law}, {rail}", **line_style(i))
        bottom.semilogx(lines[0].speeds_kmh, phase, **line_style(i))
        end = max(line.stable_from for line in lines)
        if np.isfinite(end) and end > lines[0].speeds_kmh[0]:
            for ax in (top, bottom):
                ax.axvline(end, linewidth=0.8, **line_style(i))
    top.axhspan(ROBUST_MS, _MS_TOP, color="0.93", zorder=0)
    top.set_ylim(1.0, _MS_TOP)
    top.set_ylabel("Ms (-)")
    bottom.set_ylim(bottom=0.0)
    bottom.set_ylabel("phase margin (deg)")
    bottom.set_xlabel("speed (km/h)")
    plain_log_ticks(bottom.xaxis)
    legend_of_figure(figure, top, columns=4)
    return figure


def _ran(stop: Stop) -> dict[str, Run]:
    return {one.name: one.run for one in stop.runs if one.run is not None and one.drawn}


def _stop(stop: Stop) -> Figure:
    runs = _ran(stop)
    height = min(0.9 + _ROW * len(runs), PAGE_HEIGHT)
    law = stop.scenario.adhesion
    words = law_words(law, law.file or PUBLISHED)
    figure = new_figure(height, f"{stop.title}; adhesion law {words}; seed {stop.seed}")
    axes = panels(figure, len(runs), len(_COLUMNS), sharex=True, sharey="col")
    for row, (name, run) in zip(axes, runs.items(), strict=True):
        _speed(row[0], run)
        _slip(row[1], run)
        _torque(row[2], run)
        row[0].set_ylabel(_row_label(name), fontsize=TEXT)
    for ax, label in zip(axes[0], _COLUMNS, strict=True):
        ax.set_title(label, fontsize=TEXT)
    for ax in axes[-1]:
        ax.set_xlabel("time (s)")
        legend_below(ax, 0.4)  # one above the other: side by side they are wider than the panel, and make it narrow
    highest = max(run.max_torque for run in runs.values())
    axes[0][2].set_ylim(0.0, _ENOUGH_TORQUE * highest / 1000)
    return figure


def _row_label(name: str) -> str:
    """A controller's name in lines as long as its row is high, broken at commas where that will do."""
    kept_together = ", ".join(part.replace(" ", "\N{NO-BREAK SPACE}") for part in name.split(", "))
    return folded(kept_together, _ROW - 0.1)


def _signals(run: Run) -> Any:
    assert run.signals is not None, "the runs of a report are recorded"
    return run.signals


def _speed(ax: Any, run: Run) -> None:
    signals = _signals(run)
    rim = (signals.speed - signals.slip_velocity) / KMH
    ax.plot(signals.time, rim, label="wheel rim, rω", color="0.6", linewidth=0.9)
    ax.plot(signals.time, signals.speed / KMH, label="train, v", color="black", linewidth=1.2)


def _slip(ax: Any, run: Run) -> None:
    signals = _signals(run)
    ax.plot(signals.time, signals.slip, label="slip", linewidth=0.9, **line_style(0))
    ax.plot(signals.time, signals.reference, label="reference", linewidth=1.2, **line_style(1))


def _torque(ax: Any, run: Run) -> None:
    signals = _signals(run)
    ax.plot(signals.time, signals.command / 1000, label="commanded", color="0.65", linewidth=0.7)
    ax.plot(signals.time, signals.torque / 1000, label="acting", linewidth=1.0, **line_style(0))


def _deviations(comparison: Table5) -> Figure:
    groups: dict[str, list[tuple[str, float, float]]] = {}
    for row in comparison.rows:
        _, column, quantity = row.item.split(" / ")
        error = 100 * row.standard_error / row.published
        groups.setdefault(quantity, []).append((column, row.deviation_percent, error))
    figure = new_figure(3.4, f"Table 5: deviation of the mean of {comparison.seeds} runs, bars: 2 std. errors")
    ax = panels(figure)[0, 0]
    for i, (quantity, found) in enumerate(groups.items()):
        names, deviations, errors = zip(*found, strict=True)
        places = np.arange(len(names)) + 0.16 * (i - 1.5)
        ax.errorbar(
            places,
            deviations,
            yerr=2 * np.array(errors),
            **mark_style(i),
            markersize=4.5,
            capsize=3,
            label=_QUANTITIES[quantity],
        )
    ax.set_xticks(range(len(names)), names)
    ax.axhspan(-comparison.rows[0].tolerance_percent, comparison.rows[0].tolerance_percent, color="0.93", zorder=0)
    ax.axhline(0.0, color="black", linewidth=0.8)
    ax.set_ylabel("deviation (%); grey: tolerance")
    ax.grid(visible=False, axis="x")
    legend_below(ax, 0.12, columns=4)
    return figure
