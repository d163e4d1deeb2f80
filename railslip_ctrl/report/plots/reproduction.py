"""Figures of [Park2008], drawn again: adhesion models (Figs. 13 to 15, 17) and braking runs (Figs. 18 to 21)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion.bristle import REFERENCE
from railslip_ctrl.paper.printed import TABLE5
from railslip_ctrl.paper.tables import QUANTITIES, ModelCurve, Table5
from railslip_ctrl.report.reproduction import QUANTITY_NAMES
from railslip_ctrl.simulation import Run

from . import style
from .runs import recorded

# style of two noisy lines: light below dark, so that they differ in grey print
_PAIR = ({"color": "0.62", "linewidth": 0.9}, {"color": "black", "linewidth": 0.7})
_PAIR_OF_REFERENCES = ({"color": "0.45", "linestyle": "--"}, {"color": "black", "linestyle": ":"})
_LAWS = {"beam": "beam", "curve": "bristle, along a slip ramp", "bristle": "bristle, steady state"}
_SHORT = {"beam": "beam", "curve": "bristle", "bristle": "bristle, steady"}


def model_figures(curves: Sequence[ModelCurve]) -> dict[str, Figure]:
    """Return Fig. 13, and one figure for Figs. 14 and 15: adhesion models on dry rail, with file names as keys."""
    return {"fig_13": _models_by_speed(curves), "figs_14_15": _speeds_by_model(curves)}


def run_figures(runs: Mapping[str, Run]) -> dict[str, Figure]:
    """Return Figs. 18 to 21, with file names as keys; `runs` has a recorded run for each column of Table 5."""
    return {
        "fig_18": _speeds(18, {name: run for name, run in runs.items() if name.startswith("PI")}),
        "fig_19": _speeds(19, {name: run for name, run in runs.items() if name.startswith("ASMC")}),
        "fig_20": _torques(runs),
        "fig_21": _slips(runs),
    }


def _models_by_speed(curves: Sequence[ModelCurve]) -> Figure:
    speeds = list(dict.fromkeys(curve.initial_speed_kmh for curve in curves))
    title = "[Park2008] Fig. 13: adhesion models on dry rail by initial speed (without the rig's marks)"
    figure = style.new_figure(5.6, title)
    axes = style.panels(figure, 2, (len(speeds) + 1) // 2, sharex=True, sharey=True).ravel()
    for ax, speed in zip(axes, speeds, strict=True):
        chosen = [curve for curve in curves if curve.initial_speed_kmh == speed]
        for i, curve in enumerate(chosen):
            ax.plot(curve.slip, curve.coefficient, label=_LAWS[curve.law], **style.line_style(i))
        peaks = ", ".join(
            f"{c.law.replace('curve', 'ramp')} {c.peak.coefficient:.3f} at {c.peak.slip:.3f}" for c in chosen if c.rises
        )
        title = style.folded(f"v0 = {speed:g} km/h\npeaks: {peaks}", 0.45 * style.PAGE_WIDTH, style.SMALL)
        ax.set_title(title, fontsize=style.SMALL)
        _adhesion_axes(ax)
    style.legend_of_figure(figure, axes[0], columns=3)
    return figure


def _speeds_by_model(curves: Sequence[ModelCurve]) -> Figure:
    laws = list(dict.fromkeys(curve.law for curve in curves))
    title = "[Park2008] Figs. 14 and 15: adhesion models on dry rail, by initial speed"
    figure = style.new_figure(4.4, title)
    for ax, law in zip(style.panels(figure, 1, len(laws), sharey=True)[0], laws, strict=True):
        chosen = [curve for curve in curves if curve.law == law]
        for i, curve in enumerate(chosen):
            ax.plot(curve.slip, curve.coefficient, label=f"{curve.initial_speed_kmh:g} km/h", **style.line_style(i))
        for curve in chosen:  # last, so that the speeds are adjacent in the legend
            if curve.reference is not None:
                label = f"reference {curve.reference:g} for {curve.initial_speed_kmh:g} km/h"
                ax.axvline(curve.reference, color="0.5", linewidth=0.8, label=label)
        ax.set_title(_LAWS[law], fontsize=style.TEXT)
        _adhesion_axes(ax)
        style.legend_below(ax, 0.15)
    return figure


def wet_and_dry_figure(curves: Sequence[ModelCurve]) -> Figure:
    """Draw Fig. 17: adhesion on dry and wet rail, with the published reference slips."""
    speeds = " and ".join(f"{speed:g}" for speed in dict.fromkeys(curve.initial_speed_kmh for curve in curves))
    figure = style.new_figure(4.8, f"[Park2008] Fig. 17: adhesion dry and wet, v0 = {speeds} km/h")
    ax = style.panels(figure)[0, 0]
    for i, curve in enumerate(curves):
        look = style.line_style(i)
        peak = f"peak {curve.peak.coefficient:.3f} at slip {curve.peak.slip:.3f}"
        ax.plot(curve.slip, curve.coefficient, label=f"{_LAWS[curve.law]}, {curve.rail}: {peak}", **look)
        if curve.reference is not None:
            ax.axvline(curve.reference, color=look["color"], linewidth=0.8, linestyle=look["linestyle"], alpha=0.7)
            ax.annotate(
                f"{curve.reference:g}, {_SHORT[curve.law]} {curve.rail}", (curve.reference, 1.0),
                xycoords=("data", "axes fraction"), fontsize=style.SMALL, rotation=90, xytext=(1, -2),
                textcoords="offset points", va="top",
            )  # fmt: skip
    ax.plot([], [], color="0.4", linewidth=0.8, label="vertical: published reference slips")
    _adhesion_axes(ax)
    ax.set_ylim(0.0, 1.4 * max(curve.peak.coefficient for curve in curves))  # room for the labels of the references
    style.legend_below(ax, 0.14, columns=2)
    return figure


def _adhesion_axes(ax: Any) -> None:
    ax.set(
        xlabel="slip ratio λ (-)",
        ylabel="adhesion coefficient μ (-)",
        xlim=(0.0, max(line.get_xdata()[-1] for line in ax.lines if len(line.get_xdata()) > 2)),
        ylim=(0.0, None),
    )
    ax.label_outer()


def _speeds(number: int, runs: Mapping[str, Run]) -> Figure:
    figure = style.new_figure(1.0 + 2.2 * len(runs), f"[Park2008] Fig. {number}: train and wheel speed{_seeded(runs)}")
    axes = style.panels(figure, len(runs), sharex=True, sharey=True)[:, 0]
    for ax, (name, run) in zip(axes, runs.items(), strict=True):
        signals = recorded(run)
        rim = signals.wheel_speed * run.scenario.vehicle.wheel.radius
        ax.plot(signals.time, rim / KMH, color="0.55", linewidth=0.8, label="wheel, r ω")
        ax.plot(signals.time, signals.speed / KMH, color="black", label="train, v")
        time, distance = (TABLE5[name][QUANTITIES.index(q)] for q in ("braking_time_s", "braking_distance_m"))
        stop = f"{run.braking_time:.1f} s, {run.braking_distance:.0f} m"
        ax.set_title(f"{name}: {stop} (Table 5: {time:g} s, {distance:g} m)", fontsize=style.TEXT)
        ax.set_ylabel("speed (km/h)")
        ax.legend(fontsize=style.SMALL, frameon=False)
    _time_axes(axes)
    return figure


def _torques(runs: Mapping[str, Run]) -> Figure:
    def draw(ax: Any, i: int, name: str, run: Run) -> None:
        signals, energy = recorded(run), run.scenario.vehicle.inertia_scale * run.brake_energy
        printed = TABLE5[name][QUANTITIES.index("brake_energy_published_reading")]
        label = f"{name}: energy in the printed reading {energy / 1e7:.2f}·10⁷ N·m (Table 5: {printed / 1e7:.2f}·10⁷)"
        ax.plot(signals.time, signals.torque / 1e3, label=label, **_PAIR[i])

    figure = style.new_figure(5.4, f"[Park2008] Fig. 20: brake torque{_seeded(runs)}")
    return _by_controller(figure, runs, "acting torque Tb (kN·m)", draw)


def _slips(runs: Mapping[str, Run]) -> Figure:
    def draw(ax: Any, i: int, name: str, run: Run) -> None:
        signals, printed = recorded(run), TABLE5[name][QUANTITIES.index("mean_abs_slip_error")]
        label = f"{name}: mean error {run.mean_abs_slip_error_published:.4f} (Table 5: {printed:.4f})"
        ax.plot(signals.time, signals.slip, label=label, **_PAIR[i])
        ax.plot(signals.time, signals.reference, label=f"{name}: reference", linewidth=1.0, **_PAIR_OF_REFERENCES[i])

    against = f"{REFERENCE.dry:g}/{REFERENCE.wet:g}"
    figure = style.new_figure(5.6, f"[Park2008] Fig. 21: slip ratio{_seeded(runs)}; mean errors against {against}")
    return _by_controller(figure, runs, "slip ratio λ (-)", draw)


def _by_controller(
    figure: Figure, runs: Mapping[str, Run], label: str, draw: Callable[[Any, int, str, Run], None]
) -> Figure:
    kinds = list(dict.fromkeys(name.split()[0] for name in runs))
    axes = style.panels(figure, len(kinds), sharex=True, sharey=True)[:, 0]
    for ax, kind in zip(axes, kinds, strict=True):
        for i, name in enumerate(name for name in runs if name.split()[0] == kind):
            draw(ax, i, name, runs[name])
        ax.set_ylabel(label)
        count = len(ax.get_legend_handles_labels()[0])
        ax.legend(fontsize=style.SMALL, frameon=False, loc="upper left", ncols=2 if count > 2 else 1)
        ax.margins(y=0.35)
    _time_axes(axes)
    return figure


def _time_axes(axes: Any) -> None:
    for ax in axes:
        ax.set(xlim=(0.0, None), ylim=(0.0, None))
    axes[-1].set_xlabel("time (s)")


def _seeded(runs: Mapping[str, Run]) -> str:
    seeds = ", ".join(sorted({"without noise" if run.seed is None else f"seed {run.seed}" for run in runs.values()}))
    return f"; one run each, {seeds}"


def deviations_figure(comparison: Table5) -> Figure:
    """Plot the deviation of each computed number from Table 5, %, with bars of two standard errors."""
    groups: dict[str, list[tuple[str, float, float]]] = {}
    for row in comparison.rows:
        _, column, quantity = row.item.split(" / ")
        error = 100 * row.standard_error / row.published
        groups.setdefault(quantity, []).append((column, row.deviation_percent, error))
    figure = style.new_figure(3.4, f"Table 5: deviation of the mean of {comparison.seeds} runs, bars: 2 std. errors")
    ax = style.panels(figure)[0, 0]
    for i, (quantity, points) in enumerate(groups.items()):
        names, deviations, errors = zip(*points, strict=True)
        places = np.arange(len(names)) + 0.16 * (i - 1.5)
        marks = {"label": QUANTITY_NAMES[quantity].split(", ")[0], "markersize": 4.5, "capsize": 3}
        ax.errorbar(places, deviations, yerr=2 * np.array(errors), **marks, **style.mark_style(i))
    ax.set_xticks(range(len(names)), names)
    ax.axhspan(-comparison.rows[0].tolerance_percent, comparison.rows[0].tolerance_percent, color="0.93", zorder=0)
    ax.axhline(0.0, color="black", linewidth=0.8)
    ax.set_ylabel("deviation (%); grey: tolerance")
    ax.grid(visible=False, axis="x")
    style.legend_below(ax, 0.12, columns=4)
    return figure
