"""Figures of braking runs, of comparisons of controllers, of Lyapunov functions along runs, and of campaigns."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from railslip_ctrl.core.arguments import Floats
from railslip_ctrl.core.units import KMH
from railslip_ctrl.report.campaign import headed, measure_head, quantity_heads
from railslip_ctrl.simulation import Run, Signals
from railslip_ctrl.simulation.bound import RunComparison
from railslip_ctrl.simulation.campaign.execution import Replay, measured
from railslip_ctrl.simulation.campaign.rare import ConfidenceLevels, RareEvent
from railslip_ctrl.simulation.campaign.statistics import CampaignSummary
from railslip_ctrl.simulation.run import events_log

from . import style

if TYPE_CHECKING:  # importing it loads SymPy
    from railslip_ctrl.verification.lyapunov_runs import LyapunovRun
    from railslip_ctrl.verification.verdict import NoLock, ReleasedRun


_BAR = {"color": "0.75", "edgecolor": "black", "linewidth": 0.8}


def run_comparison_figure(comparisons: Sequence[RunComparison]) -> Figure:
    """Plot mean braking distance and mean slip error of every controller, one row per scenario; dashed: the bound."""
    seeds = ", ".join(dict.fromkeys(f"{len(item.seeds)}" for item in comparisons))
    title = f"Braking distance and slip error, means over {seeds} seeds"
    figure = style.new_figure(0.4 + 2.7 * len(comparisons), title)
    for axes, comparison in zip(style.panels(figure, len(comparisons), 2), comparisons, strict=True):
        names = [row.name for row in comparison.rows]
        distance, error = axes
        places = range(len(names))
        means = [row.braking_distance for row in comparison.rows]
        bars = distance.barh(places, [item.value for item in means], xerr=[item.error for item in means], **_BAR)
        few = ("" if row.stopped == row.runs else f" ({row.stopped} of {row.runs})" for row in comparison.rows)
        met = [f"{mean.value:.0f}{text}" for mean, text in zip(means, few, strict=True)]
        distance.bar_label(bars, met, padding=3, fontsize=style.SMALL)
        bound = comparison.bound.braking_distance
        distance.axvline(bound, color="black", linestyle="--")
        distance.set_xlabel(f"braking distance (m)\ndashed: no controller below {bound:.0f} m")
        errors = [row.slip_error.value for row in comparison.rows]
        bars = error.barh(places, errors, **_BAR)
        error.bar_label(bars, [f"{value:.3f}" for value in errors], padding=3, fontsize=style.SMALL)
        error.set_xlabel("mean |slip − reference| (-)")
        distance.set_title(f"{comparison.scenario.name}, inertia scale {comparison.scenario.vehicle.inertia_scale:g}")
        distance.title.set_fontsize(style.TEXT)
        distance.set_yticks(places, names, fontsize=style.SMALL)
        error.set_yticks(places, [""] * len(names))
        for each in axes:
            each.invert_yaxis()
            each.grid(visible=False, axis="y")
            each.margins(x=0.2)  # room for the numbers
    return figure


_ENOUGH_TORQUE = 1.15  # top of the torque axis over the highest acting torque; a higher command is clipped
_ENOUGH_SLIP = 1.3  # top of the slip axis over the larger of reference slip and 99.9 % quantile of the slip


def simulation_figure(run: Run) -> Figure:
    """Plot a recorded run over time: speeds, slip and reference, torques and mu; a dotted line marks each event."""
    signals = recorded(run)
    name = f"{run.scenario.name}, {run.controller.label}: {run.outcome.value} at {run.braking_time:.4g} s"
    noise = "without noise" if run.seed is None else f"seed {run.seed}"
    figure = style.new_figure(8.0, f"{name}, {run.braking_distance:.4g} m; {noise}")
    axes = style.panels(figure, 4, sharex=True)
    _draw(axes[:3], [run])
    adhesion = signals.adhesion_force / run.scenario.vehicle.wheel_load
    axes[3, 0].plot(signals.time, adhesion, color=style.line_style(0)["color"], linewidth=0.9)
    axes[3, 0].set_ylabel("adhesion coefficient μ (-)")
    events = [item for item in events_log(run) if item.reached]
    for ax in axes.flat:
        for item in events:
            ax.axvline(item.time, color="0.6", linewidth=0.8, linestyle=(0, (1, 2)))
    label = "\n".join(("time (s)", *(f"dotted, {item.text}" for item in events)))
    axes[3, 0].set(xlabel=style.folded(label, 0.8 * style.PAGE_WIDTH), xlim=(0.0, float(signals.time[-1])))
    return figure


def runs_figure(runs: Mapping[str, Run], title: str) -> Figure:
    """Plot speeds, slip and torque of recorded runs over time, with one column for each run."""
    figure = style.new_figure(5.2, title)
    axes = style.panels(figure, 3, len(runs), sharex="col", sharey="row")
    _draw(axes, list(runs.values()))
    for ax, name in zip(axes[0], runs, strict=True):
        ax.set_title(style.folded(name, 0.9 * style.PAGE_WIDTH / len(runs)), fontsize=style.TEXT)
    for ax in axes[-1]:
        ax.set_xlabel("time (s)")
    figure.align_ylabels(axes[:, 0])
    return figure


def no_lock_figure(result: Mapping[str, tuple[NoLock, ReleasedRun]], *, title: str) -> Figure:
    """Plot no-lock regions and runs, torque over slip, with a panel for each entry of `result`.

    Below the line of a speed it is proved that the wheel does not lock at this speed if the brake is released. A grey
    line shows the run. A cross marks each sample for which this is not proved. For each speed, a further mark shows
    where the run reaches the speed; the mark is hollow if the proof does not hold there.
    """
    legend = "below a line the wheel certainly does not lock if the brake is released; marks: the run at these speeds"
    figure = style.new_figure(3.9, f"{title}; {legend}")
    axes = style.panels(figure, 1, len(result), sharex=True, sharey=True)[0]
    for ax, (name, (region, run)) in zip(axes, result.items(), strict=True):
        ax.plot(run.slip, run.torque / 1e3, color="0.6", linewidth=0.7, label="run, samples every 0.1 s")
        lost = ~run.inside
        ax.plot(run.slip[lost], run.torque[lost] / 1e3, "kx", markersize=3, label="sample that is not certified")
        for i, (kmh, most) in enumerate(zip(region.speeds_kmh, region.torque, strict=True)):
            ax.plot(region.slips, most / 1e3, label=f"{kmh:g} km/h", **style.line_style(i))
            at = np.flatnonzero(run.speed / KMH <= kmh)[:1]
            for j in at:  # no sample if the run does not reach this speed
                fill = "full" if run.inside[j] else "none"
                look = {**style.mark_style(i), "markersize": 5, "fillstyle": fill}
                ax.plot(max(run.slip[j], 0.0), run.torque[j] / 1e3, clip_on=False, zorder=4, **look)
        ax.set_title(style.folded(name, 0.9 * style.PAGE_WIDTH / len(result)), fontsize=style.TEXT)
        ax.set(xlabel="slip ratio λ (-)", xlim=(0.0, float(region.slips[-1])), ylim=(0.0, None))
    axes[0].set_ylabel("largest acting torque in the\nnext dead time (kN·m)")
    style.legend_of_figure(figure, axes[0], columns=3)
    return figure


def _draw(axes: NDArray[Any], runs: Sequence[Run]) -> None:
    slips, torques, highest = [], [1.0], [0.0]
    for (speed, slip, torque), run in zip(axes.T, runs, strict=True):
        signals = recorded(run)
        rim = (signals.speed - signals.slip_velocity) / KMH
        speed.plot(signals.time, signals.speed / KMH, label="train, v", **style.line_style(0))
        speed.plot(signals.time, rim, label="wheel rim, rω", linewidth=0.9, **style.line_style(1))
        slip.plot(signals.time, signals.slip, label="slip", linewidth=0.8, **style.line_style(0))
        if run.controller.reference is not None:
            slip.plot(signals.time, signals.reference, label="reference", linewidth=1.2, **style.line_style(1))
            slips.append(float(signals.reference.max()))
        slips.append(float(np.quantile(signals.slip, 0.999)))
        torque.plot(signals.time, signals.command / 1000, label="commanded", color="0.65", linewidth=0.7)
        torque.plot(signals.time, signals.torque / 1000, label="acting", linewidth=1.0, **style.line_style(0))
        torques.append(run.max_torque)
        highest.append(float(signals.command.max()))
    top = _ENOUGH_TORQUE * max(torques)
    _limited(axes[0], "speed (km/h)")
    slipping = max(float(recorded(run).slip.max()) for run in runs)
    _limited(axes[1], "slip ratio λ (-)", _ENOUGH_SLIP * max(slips), slipping, "higher slip")
    _limited(axes[2], "torque (kN·m)", top / 1000, max(highest) / 1000, "command")


def _limited(row: Sequence[Any], label: str, top: float = np.inf, highest: float = 0.0, what: str = "") -> None:
    row[0].set(
        ylim=(0.0, top if highest > top else None), ylabel=f"{label}\n{what} clipped" if highest > top else label
    )
    style.legend_beside(row[-1])


def recorded(run: Run) -> Signals:
    """Return the signals of a recorded run."""
    assert run.signals is not None, "the run was recorded"
    return run.signals


_LEAST = 1e-16  # least value on a logarithmic axis, where 0 cannot be drawn
_LINEAR = 1e-3  # magnitude below which an axis with both signs is linear
_TICKS = 7  # largest number of ticks on an axis with both signs
_BLOCKS = 150  # least number of intervals of a run, so that spikes from noise are separate


_Curve = tuple[str, str, bool, Callable[[Any], Floats]]
"""Axis label, axis scale, whether only the largest value of each interval is drawn, and function of the signals."""


def lyapunov_runs_figure(cases: Sequence[tuple[str, LyapunovRun]], title: str) -> Figure:
    """Plot along runs: s, the Lyapunov function V, s s', and the ratio of both sides of condition (40) of [Park2008].

    If the ratio is above 1, condition (40) does not hold. Except for s, only the largest value of each time interval is
    drawn.
    """
    curves: tuple[_Curve, ...] = (
        ("s (m/s)", "linear", False, lambda x: x.s),
        ("V ((m/s)²)", "log", True, lambda x: np.maximum(x.V, _LEAST)),
        ("s s' (m²/s³)", "symlog", True, lambda x: x.s * x.s_rate),
        ("required by (40)\n/ available (-)", "log", True, lambda x: x.asked / np.maximum(x.available, _LEAST)),
    )
    figure, axes = _along_runs(cases, f"{title}\nbelow s", curves)
    axes[3].axhline(1.0, color="black", linewidth=0.6)
    style.legend_of_figure(figure, axes[3], columns=2)
    return figure


def adaptation_figure(cases: Sequence[tuple[str, LyapunovRun]], title: str) -> Figure:
    """Plot V of (46) of [Park2008], its rate, and the true and estimated theta along runs of the adaptive law."""
    curves: tuple[_Curve, ...] = (
        ("V ((m/s)²)", "log", False, lambda x: x.V),
        ("V', theta\nconstant (m²/s³)", "symlog", True, lambda x: x.V_rate_constant),
        ("theta1 (1/(kg·m))", "linear", False, lambda x: x.theta_hat[:, 0]),
        ("theta2 (m/s)", "linear", False, lambda x: x.theta_hat[:, 1]),
    )
    figure, axes = _along_runs(cases, f"{title}\nof V'", curves)
    longest = max((judged.signals for _, judged in cases), key=lambda signals: float(signals.time[-1]))
    for ax, theta in zip(axes[2:], longest.theta.T, strict=True):
        ax.plot(longest.time, theta, color="black", linewidth=1.6, label="true theta")
    style.legend_of_figure(figure, axes[3], columns=2)
    return figure


def _along_runs(
    cases: Sequence[tuple[str, LyapunovRun]], title: str, curves: Sequence[_Curve]
) -> tuple[Figure, NDArray[Any]]:
    longest = max(float(judged.signals.time[-1]) for _, judged in cases)
    interval = max(round(10 * longest / _BLOCKS), 1) / 10  # s, a multiple of 0.1 s that is visible in the picture
    figure = style.new_figure(8.0, f"{title}: the largest in each {interval:g} s")
    axes = style.panels(figure, len(curves), sharex=True)[:, 0]
    for ax, (label, scale, largest, values) in zip(axes, curves, strict=True):
        for i, (name, judged) in enumerate(cases):
            time, line = judged.signals.time, values(judged.signals)
            if largest:  # drawn at the first time of each block of samples
                block = max(round(interval / float(np.median(np.diff(time)))), 1)
                whole = line.size // block * block
                time, line = time[:whole:block], line[:whole].reshape(-1, block).max(axis=1)
            ax.plot(time, line, label=name, **{**style.line_style(i), "linewidth": 0.9})
        ax.set_ylabel(label)
        if scale == "symlog":  # logarithmic above and below zero
            ax.set_yscale(scale, linthresh=_LINEAR)
            ax.yaxis.get_major_locator().set_params(numticks=_TICKS)
            ax.axhline(0.0, color="black", linewidth=0.6)
        else:
            ax.set_yscale(scale)
    axes[-1].set_xlabel("time (s)")
    return figure, axes


_SHOWN = ("braking_distance_m", "mean_abs_slip_error", "max_slip", "brake_energy_j")
# position of a controller's label relative to its worst run; corners differ, because two runs may coincide
_CORNERS = ((1, 1), (-1, -1), (1, -1), (-1, 1))
_LEGIBLE = [withStroke(linewidth=1.2, foreground="white")]  # white outline, so that labels over marks are legible


def distributions_figure(summary: CampaignSummary) -> Figure | None:
    """Plot the distribution of four measures over the runs in which the train stopped; None without such runs."""
    if not summary.any_stopped:
        return None
    figure = style.new_figure(0.9 + 1.5 * len(_SHOWN), _title(summary))
    axes = style.panels(figure, len(_SHOWN), 2, sharex="row")
    for (density_axes, share), name in zip(axes, _SHOWN, strict=True):
        for i, result in enumerate(summary.controllers.values()):
            measure, scale = result.measures[name], measured(name).scale
            if not measure.moments.count:
                density_axes.plot([], [], label=f"{result.name} (none)", **style.line_style(i))
                continue
            edges, counts = measure.histogram
            shape = measure.histogram.merged()
            density = shape.counts / counts.sum() / np.diff(scale * shape.edges)
            label = f"{result.name} ({measure.moments.count})"
            density_axes.stairs(density, scale * shape.edges, label=label, **style.line_style(i))
            upto = np.concatenate([[0.0], np.cumsum(counts) / counts.sum()])
            share.plot(scale * edges, upto, **style.line_style(i))
        density_axes.set_yticks([])
        style.plain_ticks(share, 4)  # also for the other axes, which share the x axis
        for ax in (density_axes, share):
            ax.set_xlabel(_dotted(measure_head(measured(name))))
    axes[0, 0].set_title("density of runs", fontsize=style.TEXT)
    axes[0, 1].set_title("share of runs up to here (-)", fontsize=style.TEXT)
    style.legend_of_figure(figure, axes[0, 0], columns=4)
    return figure


def scatter_figure(summary: CampaignSummary) -> Figure | None:
    """Plot the measure that ranks the runs against each varied quantity.

    Rings mark the worst runs of each controller. None if no quantity is varied, or if the train stopped in no run.
    """
    heads, measure = quantity_heads(summary.campaign), measured(summary.worst_by)
    if not heads or not summary.any_stopped:
        return None
    columns = 2 if len(heads) in (2, 4) else min(3, len(heads))
    rings = "rings: the worst runs of each controller, with the number of the worst"
    figure, axes = style.grid_of(len(heads), columns, f"{_title(summary)}; {rings}", (0.8, 2.5), sharey=True)
    for ax, (quantity, head) in zip(axes, heads.items(), strict=True):
        for i, (name, result) in enumerate(summary.controllers.items()):
            sample, color = summary.sample[name], style.line_style(i)["color"]
            fill = "none" if i % 2 else "full"  # filled and hollow marks differ in grey print
            look = {"markersize": 2.4, "alpha": 0.6, "fillstyle": fill, "markeredgewidth": 0.6, **style.mark_style(i)}
            ax.plot(sample[quantity], measure.scale * sample[measure.name], label=name, **look)
            for row in result.worst:
                ax.plot(row[quantity], measure.scale * row[measure.name], "o", color=color, fillstyle="none")
            for row in result.worst[:1]:
                place, (right, up) = (row[quantity], measure.scale * row[measure.name]), _CORNERS[i % len(_CORNERS)]
                side = {"ha": "left" if right > 0 else "right", "va": "bottom" if up > 0 else "top"}
                letters = {"fontsize": style.SMALL, "color": color, "path_effects": _LEGIBLE}
                ax.annotate(f"{row['run']}", place, (6 * right, 6 * up), textcoords="offset points", **side, **letters)
        ax.margins(x=0.12, y=0.15)  # room for labels at the outermost marks
        ax.set_xlabel(style.folded(_dotted(head), 0.9 * style.PAGE_WIDTH / columns))
    for ax in axes[::columns]:
        ax.set_ylabel(_dotted(measure_head(measure)))
    style.legend_of_figure(figure, axes[0], columns=4, markerscale=3)
    return figure


def replay_figure(replayed: Replay) -> Figure:
    """Plot speeds, slip and torque of one repeated run of a campaign, with a column for each controller."""
    runs = {
        f"{name}: {run.outcome.value} after {run.braking_distance:.0f}\u00a0m, {run.braking_time:.1f}\u00a0s": run
        for name, run in replayed.runs.items()
    }
    return runs_figure(runs, f"Run {replayed.number}, repeated")


def _title(summary: CampaignSummary) -> str:
    return f"{summary.runs} runs of {summary.campaign.scenario.name}; only those that stopped"


def _dotted(head: str) -> str:
    label = head.replace("_", " ").replace("*", "·")
    return label if "(" in head else f"{label} (-)"


def tail_figure(result: RareEvent | ConfidenceLevels) -> Figure:
    """Plot the probability that the result of a stop is worse than x, and its 95 % interval, against x.

    Estimates by plain Monte Carlo are added where the probability is large enough for them.
    """
    tail, figure = result.tail, style.new_figure(3.6, str(result))
    ax = style.panels(figure)[0, 0]
    reached = tail.value > 0.0
    x, value, low, high = (column[reached] for column in tail[:4])
    ax.fill_between(x, low, high, color="0.8", linewidth=0, label="95 % interval")
    ax.plot(x, value, label="subset simulation", **style.line_style(0))
    place, share, least, most = tail.plain.T
    errors = np.array([share - least, most - share])
    ax.errorbar(place, share, errors, label="plain Monte Carlo", markersize=3, linewidth=0.8, **style.mark_style(1))
    ax.set_yscale("log")
    ax.set_ylim(max(float(value.min(initial=1.0)), 1e-12) / 3.0, 1.5)
    ax.set_xlabel(_dotted(headed(*result.measured)))
    ax.set_ylabel("probability of a worse value (-)")
    style.legend_of_figure(figure, ax, columns=4)
    return figure
