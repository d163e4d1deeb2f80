"""Pictures of adhesion-torque observers: lag against noise, estimates beside the truth, frequency responses."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from railslip_ctrl.observer import ObserverResponses, TradeOff, Trial

from .style import legend_below, line_style, new_figure

Floats = NDArray[np.float64]

_NOTHING = 1e-9  # a response that is nowhere larger is the rounding of one that is zero, and is not drawn


def tradeoff_figure(curves: Mapping[str, TradeOff], labels: Mapping[str, str], *, title: str) -> Figure:
    """Error from lag, from noise, and both, over each observer's setting; `labels` name the setting with its unit."""
    figure = new_figure(3.4 * len(curves) + 0.6, 4.6, title)
    axes = figure.subplots(1, len(curves), sharey=True, squeeze=False)[0]
    for ax, (name, curve) in zip(axes, curves.items(), strict=True):
        for i, (kind, label) in enumerate((("lag", "lag"), ("noise", "noise (H2 norm)"), ("total", "both"))):
            ax.loglog(curve.settings, [getattr(e, kind) for e in curve.errors], label=label, **line_style(i))
        simulated = [error.simulated for error in curve.errors]
        ax.loglog(curve.settings, simulated, "o", color="black", markersize=3.5, fillstyle="none", label="simulated")
        ax.axvline(curve.best, color="0.5", linewidth=0.8)
        ax.set_title(f"{name}:\nbest {curve.best:.3g}, {curve.at_best.total:.0f} N·m", fontsize=9)
        ax.set_xlabel(labels[name])
        ax.grid(True, which="major", color="0.88")
        legend_below(ax, 0.16, columns=2)
    axes[0].set_ylabel("rms error of the adhesion torque (N·m)")
    return figure


def estimates_figure(
    trial: Trial, time: Floats, estimates: Mapping[str, Floats], errors: Mapping[str, Floats], *, title: str
) -> Figure:
    """A brake trial: speeds and torques as they were, the estimates at `time` (s) and their errors (N*m)."""
    figure = new_figure(9.0, 8.0, title)
    axes = figure.subplots(3, 1, sharex=True, height_ratios=(1.0, 1.4, 1.2))
    axes[0].plot(trial.time, trial.speed, label="train speed v", **line_style(0))
    axes[0].plot(trial.time, trial.rim_speed, label="rim speed r ω", **line_style(1))
    axes[0].set_ylabel("speed (m/s)")
    axes[1].plot(trial.time, trial.brake_torque / 1e3, color="0.6", label="brake torque, true")
    axes[1].plot(trial.time, trial.adhesion_torque / 1e3, color="black", linewidth=1.6, label="adhesion torque, true")
    for i, (name, estimate) in enumerate(estimates.items()):
        axes[1].plot(time, estimate / 1e3, linewidth=0.9, label=name, **line_style(i))
        axes[2].plot(time, errors[name] / 1e3, linewidth=0.9, **line_style(i))
    axes[1].set_ylabel("torque (kN·m)")
    axes[2].set_ylabel("error of the estimate (kN·m)")
    axes[2].set_xlabel("time (s)")
    for ax in axes:
        ax.grid(True, color="0.88")
    axes[0].legend(fontsize=8, frameon=False)
    axes[1].legend(fontsize=8, frameon=False, loc="upper right")
    return figure


def observer_responses_figure(responses: Mapping[str, ObserverResponses], *, title: str) -> Figure:
    """Magnitudes from true adhesion torque, brake torque and sensor noise to the estimate."""
    figure = new_figure(9.5, 7.5, title)
    axes = figure.subplots(2, 2, sharex=True)
    panels = (
        (axes[0, 0], "adhesion", "from the adhesion torque (N·m per N·m)"),
        (axes[0, 1], "brake", "from the brake torque (N·m per N·m)"),
        (axes[1, 0], "torque_noise", "from noise of the torque (N·m per N·m)"),
        (axes[1, 1], "speed_noise", "from noise of the speed (N·m per rad/s)"),
    )
    for ax, name, label in panels:
        absent = []
        for i, (observer, response) in enumerate(responses.items()):
            magnitude = np.abs(getattr(response, name))
            if magnitude.max() > _NOTHING:
                ax.loglog(response.omega, magnitude, label=observer, **line_style(i))
            else:
                absent.append(observer)
                ax.plot([], [], label=observer, **line_style(i))
        ax.set_title(label + (f"\n0 for {' and '.join(absent)}" if absent else ""), fontsize=9)
        ax.grid(True, which="major", color="0.85")
    for ax in axes[1]:
        ax.set_xlabel("frequency ω (rad/s)")
        legend_below(ax, 0.16, columns=3)
    return figure
