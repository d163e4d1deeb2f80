"""Pictures of adhesion-torque observers: lag against noise, estimates beside the truth, frequency responses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from railslip_ctrl.identification.observer import ObserverResponses

from .style import PAGE_WIDTH, TEXT, folded, legend_beside, legend_of_figure, line_style, new_figure, panels

if TYPE_CHECKING:  # it loads SymPy, which no other figure needs
    from railslip_ctrl.identification.observer_study import BrakeTrial, TradeOff

Floats = NDArray[np.float64]

_NOTHING = 1e-9  # a response that is nowhere larger is the rounding of one that is zero, and is not drawn


def tradeoff_figure(curves: Mapping[str, TradeOff], labels: Mapping[str, str], *, title: str) -> Figure:
    """Error from lag, from noise, and both, over each observer's setting; `labels` name the setting with its unit."""
    columns = min(len(curves), 3)
    rows = -(-len(curves) // columns)
    figure = new_figure(1.0 + 2.8 * rows, title)
    axes = panels(figure, rows, columns, sharey=True).ravel()
    for ax in axes[len(curves) :]:
        ax.set_axis_off()
    for ax, (name, curve) in zip(axes, curves.items(), strict=False):
        for i, (kind, label) in enumerate((("lag", "lag"), ("noise", "noise (H2 norm)"), ("total", "both"))):
            ax.loglog(curve.settings, [getattr(e, kind) for e in curve.errors], label=label, **line_style(i))
        simulated = [error.simulated for error in curve.errors]
        ax.loglog(curve.settings, simulated, "o", color="black", markersize=3.5, fillstyle="none", label="simulated")
        ax.axvline(curve.best, color="0.5", linewidth=0.8)
        ax.set_title(f"{name}:\nbest at {curve.best:.3g}: {curve.at_best.total:.0f} N·m", fontsize=TEXT)
        ax.set_xlabel(folded(labels[name], 0.9 * PAGE_WIDTH / columns))
    for ax in axes[::columns]:
        ax.set_ylabel("rms error of the adhesion torque (N·m)")
    legend_of_figure(figure, axes[0], columns=4)
    return figure


def estimates_figure(
    trial: BrakeTrial, time: Floats, estimates: Mapping[str, Floats], errors: Mapping[str, Floats], *, title: str
) -> Figure:
    """A brake trial: speeds and torques as they were, the estimates at `time` (s), and the error (N*m) of each."""
    figure = new_figure(4.2 + 1.1 * len(estimates), title)
    axes = panels(figure, 2 + len(estimates), sharex=True, height_ratios=(1.0, 1.8, *(1.0 for _ in estimates)))[:, 0]
    for ax in axes[3:]:
        ax.sharey(axes[2])
    axes[0].plot(trial.time, trial.speed, label="train speed v", **line_style(0))
    axes[0].plot(trial.time, trial.rim_speed, label="rim speed r ω", **line_style(1))
    axes[0].set_ylabel("speed (m/s)")
    axes[1].plot(
        trial.time, trial.brake_torque / 1e3, color="black", linestyle="--", linewidth=1.0, label="brake torque, true"
    )
    for i, (name, estimate) in enumerate(estimates.items()):
        color = str(max(0.75 - 0.2 * i, 0.2))  # the noisier ones come first and are the lighter
        axes[1].plot(time, estimate / 1e3, linewidth=0.7, label=name, color=color)
        axes[2 + i].plot(time, errors[name] / 1e3, linewidth=0.7, color="black")
        axes[2 + i].set_ylabel(f"{name}:\nerror (kN·m)")
    axes[1].plot(trial.time, trial.adhesion_torque / 1e3, color="black", linewidth=1.2, label="adhesion torque, true")
    axes[1].set_ylabel("torque (kN·m)")
    axes[-1].set_xlabel("time (s)")
    for ax in axes[:2]:
        legend_beside(ax)
    return figure


def observer_responses_figure(responses: Mapping[str, ObserverResponses], *, title: str) -> Figure:
    """Magnitudes from true adhesion torque, brake torque and sensor noise to the estimate."""
    figure = new_figure(5.6, title)
    axes = panels(figure, 2, 2, sharex=True)
    fields = (
        (axes[0, 0], "adhesion", "from the adhesion torque (N·m per N·m)"),
        (axes[0, 1], "brake", "from the brake torque (N·m per N·m)"),
        (axes[1, 0], "torque_noise", "from noise of the torque (N·m per N·m)"),
        (axes[1, 1], "speed_noise", "from noise of the speed (N·m per rad/s)"),
    )
    for ax, name, label in fields:
        absent = []
        for i, (observer, response) in enumerate(responses.items()):
            magnitude = np.abs(getattr(response, name))
            if magnitude.max() > _NOTHING:
                ax.loglog(response.omega, magnitude, label=observer, **line_style(i))
            else:
                absent.append(observer)
                ax.plot([], [], label=observer, **line_style(i))
        ax.set_title(label + (f"\n0 for {' and '.join(absent)}" if absent else ""), fontsize=TEXT)
    for ax in axes[1]:
        ax.set_xlabel("frequency ω (rad/s)")
    legend_of_figure(figure, axes[0, 0], columns=3)
    return figure
