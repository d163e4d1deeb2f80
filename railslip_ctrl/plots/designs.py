"""Pictures of designs: stabilising regions, margins along an axis, closed-loop responses, the gang of four."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from railslip_ctrl.design import MarginGrid, Strip
from railslip_ctrl.design.robustness import Robustness
from railslip_ctrl.design.sweeps import MarginSweep
from railslip_ctrl.loop.curves import GangOfFour
from railslip_ctrl.loop.responses import TimeResponse
from railslip_ctrl.parameters import Rail

from .style import legend_below, line_style, new_figure

_MS_TOP = 8.0  # an Ms beyond it is as good as unstable; the axis ends there


def region_figure(
    strips: Sequence[Strip],
    grid: MarginGrid,
    chosen: Mapping[str, tuple[float, float]],
    *,
    title: str,
    kp_unit: str = "N·m/(m/s)",
    ki_unit: str = "N·m/m",
) -> Figure:
    """The stabilising set of (kp, ki), contours of worst Ms, phase margin and delay margin in it, and chosen gains."""
    figure = new_figure(12.5, 5.0, title)
    axes = figure.subplots(1, 3, sharex=True, sharey=True)
    fields = (
        ("Ms", grid.ms, _ms_levels(grid.ms), "%g"),
        ("phase margin (deg)", grid.phase_deg, None, "%.0f"),
        ("delay margin (s)", grid.delay_s, None, "%.2g"),
    )
    for ax, (name, values, levels, form) in zip(axes, fields, strict=True):
        for strip in strips:
            ax.fill(*strip.polygon.T, facecolor="0.93", edgecolor="black", linewidth=1.2)
        if np.isfinite(values).sum() > 4:
            lines = ax.contour(grid.kp, grid.ki, values.T, levels=levels, colors="0.25", linewidths=0.8)
            ax.clabel(lines, fmt=form, fontsize=7)
        for i, (label, (kp, ki)) in enumerate(chosen.items()):
            ax.plot(kp, ki, marker="os^Dv"[i % 5], color=line_style(i)["color"], linestyle="none", label=label)
        ax.set_title(f"contours: {name}", fontsize=9)
        ax.set_xlabel(f"kp ({kp_unit})")
        ax.grid(True, color="0.85", linewidth=0.5)
        legend_below(ax, 0.17)
    axes[0].set_ylabel(f"ki ({ki_unit})")
    return figure


def _ms_levels(ms: Any) -> list[float]:
    least = float(np.nanmin(ms)) if np.isfinite(ms).any() else 1.0
    levels = [1.2, 1.3, 1.4, 1.5, 1.6, 1.8, 2, 2.5, 3, 4, 5, 6, 8, 10, 15, 20]
    return [level for level in levels if level > least][:8]


def sweep_figure(sweeps: Sequence[MarginSweep], *, title: str) -> Figure:
    """Ms, phase margin, delay margin and the plant's rightmost pole along each sweep; a gap is an unstable loop."""
    figure = new_figure(4.2 * max(len(sweeps), 2), 9.0, title)
    axes = figure.subplots(4, len(sweeps), sharex="col", sharey="row", squeeze=False)
    for column, sweep in enumerate(sweeps):
        for i, (name, margins) in enumerate(sweep.margins.items()):
            style = line_style(i)
            axes[0, column].plot(sweep.values, margins.ms, label=name, **style)
            axes[1, column].plot(sweep.values, margins.phase_deg, label=name, **style)
            axes[2, column].semilogy(sweep.values, margins.delay_s, label=name, **style)
        axes[3, column].plot(sweep.values, sweep.pole, color="black")
        axes[3, column].axhline(0, color="0.5", linewidth=0.8)
        axes[0, column].set_title(sweep.title, fontsize=8)
        axes[3, column].set_xlabel(f"{sweep.axis} ({sweep.unit})")
        for ax in axes[:, column]:
            ax.grid(True, color="0.88")
        handles = axes[0, column].get_legend_handles_labels()
        gap = "gap: unstable" if any(np.isnan(m.ms).any() for m in sweep.margins.values()) else None
        axes[3, column].legend(
            *handles,
            fontsize=7,
            loc="upper center",
            bbox_to_anchor=(0.5, -0.32),
            frameon=False,
            title=gap,
            title_fontsize=7,
        )
    peaks = np.concatenate([m.ms for sweep in sweeps for m in sweep.margins.values()])
    largest = float(np.nanmax(peaks)) if np.isfinite(peaks).any() else _MS_TOP
    axes[0, 0].set_ylim(1, min(_MS_TOP, 1 + 1.2 * (largest - 1)) if largest > 1 else 2)
    for row, label in enumerate(("Ms (-)", "phase margin (deg)", "delay margin (s)", "plant pole (1/s)")):
        axes[row, 0].set_ylabel(label)
    return figure


def response_figure(
    reference: Mapping[str, TimeResponse],
    load: Mapping[str, TimeResponse],
    *,
    title: str,
    reference_label: str,
    load_label: str,
) -> Figure:
    """Output and control of named designs after a reference step and after a load step, the dead time exact."""
    figure = new_figure(10.0, 7.0, title)
    axes = figure.subplots(2, 2, sharex="col")
    for column, (responses, label) in enumerate(((reference, reference_label), (load, load_label))):
        for i, (name, response) in enumerate(responses.items()):
            axes[0, column].plot(response.time, response.output, label=name, **line_style(i))
            axes[1, column].plot(response.time, response.control, **line_style(i))
        axes[0, column].set_title(label, fontsize=9)
        axes[1, column].set_xlabel("time (s)")
        for ax in axes[:, column]:
            ax.grid(True, color="0.88")
        axes[1, column].legend(
            *axes[0, column].get_legend_handles_labels(),
            fontsize=8,
            loc="upper center",
            bbox_to_anchor=(0.5, -0.16),
            frameon=False,
            ncols=2,
        )
    axes[0, 0].set_ylabel("slip velocity deviation (m/s)")
    axes[1, 0].set_ylabel("commanded torque deviation (N·m)")
    return figure


def gang_of_four_figure(gangs: Mapping[str, GangOfFour], *, title: str) -> Figure:
    """|S|, |T|, |PS| and |CS| of named designs."""
    figure = new_figure(9.5, 7.5, title)
    axes = figure.subplots(2, 2, sharex=True)
    panels = (
        (axes[0, 0], "s", "|S|, sensitivity (-)"),
        (axes[0, 1], "ps", "|PS|, disturbance of the command to slip velocity ((m/s)/(N·m))"),
        (axes[1, 0], "cs", "|CS|, noise to torque (N·m/(m/s))"),
        (axes[1, 1], "t", "|T|, complementary sensitivity (-)"),
    )
    for ax, name, label in panels:
        for i, (design, gang) in enumerate(gangs.items()):
            ax.loglog(gang.omega, np.abs(getattr(gang, name)), label=design, **line_style(i))
        ax.set_title(label, fontsize=9)
        ax.grid(True, which="major", color="0.85")
    for ax in axes[1]:
        ax.set_xlabel("frequency ω (rad/s)")
        legend_below(ax, 0.16, columns=2)
    return figure


def margin_map_figure(results: Mapping[str, Robustness], law: str, *, title: str) -> Figure:
    """Worst Ms over load and actuator on a grid of speed and slip, dry and wet, for named controllers."""
    figure = new_figure(10.0, 0.8 + 3.4 * len(results), title)
    axes = figure.subplots(len(results), 2, squeeze=False, sharex="col")
    for row, (name, result) in enumerate(results.items()):
        for column, rail in enumerate(Rail):
            speeds, slips, worst = result.speed_slip_map(law, rail)
            _margin_map(axes[row, column], speeds, slips, worst)
            axes[row, column].set_title(f"{name}: worst Ms, {law}, {rail} rail", fontsize=9)
            axes[row, column].set_ylabel("speed (km/h)")
    for ax in axes[-1]:
        ax.set_xlabel("slip / reference slip (-); black: Ms over 8, or unstable")
    return figure


def _margin_map(ax: Any, speeds: Any, slips: Any, worst: Any) -> None:
    """A grid of cells with their numbers; an unstable cell is black."""
    shown = np.where(np.isinf(worst), _MS_TOP, np.minimum(worst, _MS_TOP))
    ax.imshow(shown, cmap="Greys", vmin=1.0, vmax=_MS_TOP, aspect="auto", origin="lower")
    for i, j in np.ndindex(*worst.shape):
        text = "unst." if np.isinf(worst[i, j]) else "" if np.isnan(worst[i, j]) else f"{worst[i, j]:.3g}"
        ax.text(j, i, text, ha="center", va="center", fontsize=7, color="white" if shown[i, j] > 4.5 else "black")
    ax.set_xticks(range(slips.size), [f"{s:g}" for s in slips])
    ax.set_yticks(range(speeds.size), [f"{v:g}" for v in speeds])
