"""Pictures of braking runs: one over time, controllers compared over runs, and V with the margin of (40) along them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from railslip_ctrl.core.units import KMH
from railslip_ctrl.simulation import Run, Signals
from railslip_ctrl.simulation.run import events_log
from railslip_ctrl.simulation.run_comparison import ControllerRow, RunComparison

from .style import (
    PAGE_WIDTH,
    SMALL,
    TEXT,
    folded,
    legend_beside,
    legend_of_figure,
    line_style,
    new_figure,
    panels,
)

if TYPE_CHECKING:  # it loads SymPy
    from railslip_ctrl.verification.lyapunov_runs import LyapunovRun

Floats = NDArray[np.float64]

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
        draw(ax, run, run.signals)
        for one in events:
            ax.axvline(one.time, color="0.6", linewidth=0.8, linestyle=(0, (1, 2)))
        if len(ax.lines) > 1 and ax.get_legend_handles_labels()[0]:
            legend_beside(ax)
    told = "\n".join(f"dotted, {one.text}" for one in events)
    axes[-1].set_xlabel(folded(f"time (s)\n{told}" if told else "time (s)", 0.8 * PAGE_WIDTH))
    axes[-1].set_xlim(0.0, float(run.signals.time[-1]))
    return figure


def _speeds(ax: Any, run: Run, signals: Signals) -> None:
    ax.plot(signals.time, signals.speed / KMH, label="train, v", **line_style(0))
    rim = (signals.speed - signals.slip_velocity) / KMH
    ax.plot(signals.time, rim, label="wheel rim, rω", linewidth=0.9, **line_style(1))
    ax.set_ylabel("speed (km/h)")
    ax.set_ylim(bottom=0.0)


def _slip(ax: Any, run: Run, signals: Signals) -> None:
    ax.plot(signals.time, signals.slip, label="slip ratio", linewidth=0.9, **line_style(0))
    ax.plot(signals.time, signals.reference, label="reference", **line_style(1))
    ax.set_ylabel("slip ratio λ (-)")


def _torque(ax: Any, run: Run, signals: Signals) -> None:
    ax.plot(signals.time, signals.command / 1000, label="commanded", color="0.65", linewidth=0.7)
    ax.plot(signals.time, signals.torque / 1000, label="acting", **line_style(0))
    top = _ENOUGH_TORQUE * max(run.max_torque, 1.0) / 1000
    cut = float(signals.command.max()) / 1000 > 2 * top
    ax.set_ylim(0.0, top if cut else None)
    ax.set_ylabel("brake torque (kN·m)" + ("\ncommand cut off" if cut else ""))


def _adhesion(ax: Any, run: Run, signals: Signals) -> None:
    load = run.scenario.vehicle.wheel_load
    ax.plot(signals.time, signals.adhesion_force / load, color=line_style(0)["color"], linewidth=0.9)
    ax.set_ylabel("adhesion coefficient μ (-)")


# --- runs judged by the Lyapunov conditions ---------------------------------------------------------------------------


_LEAST = 1e-16  # of a logarithmic axis: s = 0 exactly has no place on it
_LINEAR = 1e-3  # below it an axis with both signs is linear
_TICKS = 9  # of such an axis, at most
_BLOCKS = 150  # of a run, at least: a run with noise has its spikes apart


def lyapunov_runs_figure(cases: Sequence[tuple[str, LyapunovRun]], title: str) -> Figure:
    """s, V, s s', and what (40) asks for against what K + D|s| gives; of all but s the largest in each interval."""
    interval = _interval(cases)
    figure = new_figure(8.0, f"{title}\nbelow s: the largest in each {interval:g} s")
    surface, value, product, margin = panels(figure, 4, sharex=True)[:, 0]
    for i, (name, judged) in enumerate(cases):
        signals, style = judged.signals, {**line_style(i), "linewidth": 0.9}
        block = _block(signals.time, interval)
        surface.plot(signals.time, signals.s, **style)
        value.semilogy(*_largest(signals.time, np.maximum(signals.V, _LEAST), block), **style)
        product.plot(*_largest(signals.time, signals.s * signals.s_rate, block), **style)
        margin.semilogy(*_largest(signals.time, signals.asked / np.maximum(signals.available, _LEAST), block), **style)
        margin.lines[-1].set_label(name)
    _both_signs(product)
    product.axhline(0.0, color="black", linewidth=0.6)
    margin.axhline(1.0, color="black", linewidth=0.6)
    surface.set_ylabel("s (m/s)")
    value.set_ylabel("V ((m/s)²)")
    product.set_ylabel("s s' (m²/s³)")
    margin.set_ylabel("asked by (40)\n/ available (-)")
    margin.set_xlabel("time (s)")
    legend_of_figure(figure, margin, columns=2)
    return figure


def adaptation_figure(cases: Sequence[tuple[str, LyapunovRun]], title: str) -> Figure:
    """V of (46) and its rate, and the estimates beside the true theta, along runs of the adaptive law."""
    interval = _interval(cases)
    figure = new_figure(8.0, f"{title}\nof V': the largest in each {interval:g} s")
    value, rate, first, second = panels(figure, 4, sharex=True)[:, 0]
    for i, (name, judged) in enumerate(cases):
        signals, style = judged.signals, {**line_style(i), "linewidth": 0.9}
        value.plot(signals.time, signals.V, **style)
        rate.plot(*_largest(signals.time, signals.V_rate_constant, _block(signals.time, interval)), **style)
        for axes, component in ((first, 0), (second, 1)):
            axes.plot(signals.time, signals.theta_hat[:, component], label=name, **style)
    longest = max((judged.signals for _, judged in cases), key=lambda signals: float(signals.time[-1]))
    for axes, component in ((first, 0), (second, 1)):
        axes.plot(longest.time, longest.theta[:, component], color="black", linewidth=1.6, label="true theta")
        axes.set_ylabel(("theta1 (1/(kg·m))", "theta2 (m/s)")[component])
    value.set_yscale("log")
    _both_signs(rate)
    rate.axhline(0.0, color="black", linewidth=0.6)
    value.set_ylabel("V ((m/s)²)")
    rate.set_ylabel("V', theta\nconstant (m²/s³)")
    second.set_xlabel("time (s)")
    legend_of_figure(figure, second, columns=2)
    return figure


def _interval(cases: Sequence[tuple[str, LyapunovRun]]) -> float:
    """Tenths of a second, s, so many that what is left of the longest run can be seen."""
    longest = max(float(judged.signals.time[-1]) for _, judged in cases)
    return max(round(10 * longest / _BLOCKS), 1) / 10


def _block(time: Floats, interval: float) -> int:
    """Samples in an interval."""
    return max(round(interval / float(np.median(np.diff(time)))), 1)


def _both_signs(axes: Any) -> None:
    """Logarithmic above and below zero, with as many ticks as have room."""
    axes.set_yscale("symlog", linthresh=_LINEAR)
    axes.yaxis.get_major_locator().set_params(numticks=_TICKS)


def _largest(time: Floats, values: Floats, block: int) -> tuple[Floats, Floats]:
    """The largest value of each block of samples, at the block's first time."""
    whole = values.size // block * block
    return time[:whole:block], values[:whole].reshape(-1, block).max(axis=1)
