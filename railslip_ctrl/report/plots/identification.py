"""Figures of an identification, of observers of the adhesion torque, and of a test on the virtual rig."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from railslip_ctrl.core.arguments import Floats
from railslip_ctrl.core.units import KMH
from railslip_ctrl.identification.identify import Identification, LogSeries
from railslip_ctrl.identification.logs import Rows
from railslip_ctrl.identification.models import parameter_unit
from railslip_ctrl.identification.observed import time_history_of
from railslip_ctrl.identification.observer import ObserverResponses
from railslip_ctrl.identification.results import PeakSlip
from railslip_ctrl.model.adhesion.base import curtius_kniffler

from . import style

if TYPE_CHECKING:  # importing it loads the simulation
    from railslip_ctrl.identification.virtual_rig import BrakeTrial


_MARKS = (("most", "^", "maximum"), ("mean", "o", "mean"), ("least", "x", "minimum"))
_MODELS_SHOWN = 4  # largest number of models in a figure


def adhesion_figure(result: Sequence[Identification]) -> Figure:
    """Plot mu over slip, a panel for each log: maximum, mean and minimum in each bin of slip, and fitted models."""
    columns = min(len(result), 2)
    title = f"Adhesion coefficient over slip: {result[0].vehicle.name}, {result[0].setting.rail} rail"
    figure, axes = style.grid_of(len(result), columns, title, (0.4, 4.4 if columns == 1 else 3.6), sharey=True)
    bottom = min(0.0, *(float(each.curve.bins.least.min()) for each in result))
    for ax, each in zip(axes, result, strict=True):
        _adhesion(ax, each, columns)
    for ax in axes[::columns]:
        ax.set_ylabel("adhesion coefficient μ (-)")
    axes[0].set_ylim(
        bottom=bottom - (0.03 * axes[0].dataLim.ymax if bottom < 0 else 0.0)
    )  # room for marks at the bottom
    return figure


def _adhesion(ax: Any, result: Identification, columns: int) -> None:
    bins = result.curve.bins
    for name, mark, label in _MARKS:
        ax.plot(bins.slip, getattr(bins, name), mark, color="0.45", markersize=4, fillstyle="none", label=label)
    chosen = result.chosen.fit.model.name
    errors = {score.fit.model.name: score.mean_abs_error for score in result.scores}
    # the bristle state lags behind the slip: the mean of mu over slip follows the log and is not a smooth curve
    along = {score.fit.model.name for score in result.scores if score.fit.followed is not None}
    lines = sorted(result.lines, key=lambda line: line.name != chosen)[:_MODELS_SHOWN]
    for i, line in enumerate(lines):
        mean = "\nmean along the log's slip" if line.name in along else ""
        taken = ", chosen" if line.name == chosen else ""
        label = f"{line.name} (mean |error| {errors[line.name]:.2g}{taken}){mean}"
        ax.plot(line.slip, line.mu, label=label, linewidth=2.0 if i == 0 else 1.1, **style.line_style(i))
    ax.axvline(result.regimes.boundary, color="0.7", linewidth=0.8)
    ax.set_xlim(left=0.0)
    late = result.regimes.boundary > 0.7 * ax.get_xlim()[1]
    where = {"ha": "right" if late else "left", "transform": ax.get_xaxis_transform()}
    ax.text(
        result.regimes.boundary, 0.02, "sliding " if late else " sliding", fontsize=style.SMALL, color="0.4", **where
    )
    name = result.curve.name.rsplit("/", 1)[-1]
    ax.set_title(f"{name}, v0 = {result.setting.initial_speed / KMH:.4g} km/h", fontsize=style.TEXT)
    ax.set_xlabel("slip ratio λ (-)")
    style.legend_below(ax, 0.16, columns=1 if columns > 1 else 2)


def drift_figure(result: Identification) -> Figure:
    """Plot slip and mu of the adhesion peak over train speed, for each rail, with the reference slip.

    Hollow marks are extrapolated, or computed for wet rail from the dry law. Error bars are 95 % intervals. The curve
    of Curtius and Kniffler (largest mu of locomotives on dry rail) is drawn for comparison.
    """
    title = f"Peak of {result.chosen.fit.model.name} over speed: {result.curve.name.rsplit('/', 1)[-1]}"
    figure = style.new_figure(4.2, title)
    slip, height = style.panels(figure, 1, 2)[0]
    for rail in dict.fromkeys(peak.rail for peak in result.peaks):
        _drift(slip, height, [peak for peak in result.peaks if peak.rail is rail])
    shown = [peak.speed / KMH for peak in result.peaks]
    speeds = np.linspace(min(shown), max(shown), 50)
    height.plot(speeds, curtius_kniffler(speeds * KMH), ":", color="0.4", label="Curtius-Kniffler, dry rail")
    slip.set_ylabel("slip ratio λ (-)")
    height.set_ylabel("highest adhesion coefficient μ (-)")
    for ax in (slip, height):
        ax.set_xlabel("train speed (km/h)")
    for ax, most in ((slip, 1.0), (height, math.inf)):  # an interval may exceed slip 1
        if math.isfinite(ax.dataLim.ymax):  # not finite without a peak
            ax.set_ylim(0.0, min(1.08 * ax.dataLim.ymax, most))
        style.legend_below(ax, 0.17)
    return figure


def _drift(slip: Any, height: Any, peaks: Sequence[PeakSlip]) -> None:
    rail = peaks[0].rail
    look, where = style.rail_style(rail), f"{rail} rail, by rule" if peaks[0].by_rule else f"{rail} rail"
    speed, values, ends, mu, mu_ends, reference = (
        np.array([getattr(peak, name) for peak in peaks])
        for name in ("speed", "slip", "slip_interval", "coefficient", "coefficient_interval", "reference")
    )
    speed = speed / KMH
    _peaks(slip, (speed, values, ends), peaks, f"peak, {where}", look)
    size = 9.0 if peaks[0].by_rule else 5.0  # a larger mark remains visible if the rule does not change the slip
    mark = {"marker": "s", "linestyle": "", "fillstyle": "none", "markersize": size, "color": look["color"]}
    slip.plot(speed, reference, label=f"reference, {where}", **mark)
    _peaks(height, (speed, mu, mu_ends), peaks, where, look)


def _peaks(ax: Any, data: tuple[Any, Any, Any], peaks: Sequence[PeakSlip], label: str, look: dict[str, Any]) -> None:
    speed, values, ends = data
    if peaks[0].by_rule:
        ax.plot(speed, values, marker="D", markersize=4, fillstyle="none", label=label, **look)
        return
    ax.plot(speed, values, **look)
    beyond = np.array([peak.extrapolated for peak in peaks])
    for at, fill, suffix in ((~beyond, "full", "95 %"), (beyond, "none", "95 %, extrapolated")):
        if at.any():
            bars = np.nan_to_num(np.abs(ends[at].T - values[at]), posinf=0.0)  # an infinite end has no bar
            marks = {"fmt": "o", "capsize": 3.0, "markersize": 4.5, "fillstyle": fill, "color": look["color"]}
            ax.errorbar(speed[at], values[at], bars, label=f"{label}, {suffix}", **marks)


def braking_figure(result: Identification) -> Figure:
    """Plot the longest braking of a log over time: speeds, brake torque, observed adhesion torque, and slip."""
    run = time_history_of(result.curve.record, result.vehicle, result.curve.time_constant)
    figure = style.new_figure(5.6, f"Longest braking of {result.curve.name.rsplit('/', 1)[-1]}, as logged and observed")
    speed, torque, slip = style.panels(figure, 3, 1, sharex=True)[:, 0]
    if run is not None:
        speed.plot(run.time, run.train_speed / KMH, label="train", **style.line_style(0))
        speed.plot(run.time, run.wheel_speed / KMH, label="wheel rim", **style.line_style(1))
        torque.plot(run.time, run.brake_torque / 1e3, label="brake torque", **style.line_style(0))
        label = f"adhesion torque observed, τ = {result.curve.time_constant:.3g} s"
        torque.plot(run.time, run.adhesion_torque / 1e3, label=label, **style.line_style(1))
        slip.plot(run.time, run.slip, **style.line_style(0))
        for ax in (speed, torque):
            ax.legend(fontsize=style.SMALL)
    speed.set_ylabel("speed (km/h)")
    torque.set_ylabel("torque at the\nwheel (kN·m)")
    slip.set(ylabel="slip ratio λ (-)", xlabel="time since the brake was applied (s)")
    return figure


def coefficients_figure(
    result: LogSeries, *, beside: tuple[str, Callable[[float], Sequence[float]]] | None = None
) -> Figure:
    """Plot each parameter over the initial speed: its value for each log with a 99 % interval, and the polynomial.

    - beside: label of a second line, and a function that returns the parameters at a speed, km/h.
    """
    count, first = len(result.polynomials), result.logs[0].chosen.fit
    title = f"Parameters of {first.model.name} over the initial speed v0"
    figure, axes = style.grid_of(count, min(count, 3), title, (0.8, 2.3))
    for k, (ax, p) in enumerate(zip(axes, result.polynomials, strict=True)):
        intervals = np.array([each.chosen.fit.parameters[k].interval for each in result.logs]).T
        reach = np.nan_to_num(np.maximum(np.abs(intervals - p.values), 0.0))
        ax.errorbar(p.speeds_kmh, p.values, reach, fmt="o", color="black", capsize=3, markersize=4, label="fit, 99 %")
        speeds = np.linspace(p.speeds_kmh.min(), p.speeds_kmh.max(), 100)
        ax.plot(speeds, [p.at(speed) for speed in speeds], label="polynomial of v0", **style.line_style(0))
        if beside is not None:
            ax.plot(speeds, [beside[1](speed)[k] for speed in speeds], label=beside[0], **style.line_style(1))
        unit = parameter_unit(p.name)
        ax.set(ylabel=f"{p.name} (-)" if unit == "1" else f"{p.name} ({unit})", xlabel="initial speed v0 (km/h)")
    style.legend_of_figure(figure, axes[0], columns=3)
    return figure


def estimates_figure(
    trial: BrakeTrial, time: Floats, estimates: Mapping[str, Floats], errors: Mapping[str, Floats], *, title: str
) -> Figure:
    """Plot a simulated braking: true speeds and torques, and estimates of the adhesion torque with their errors.

    - time: times of the estimates, s, shape (n,).
    - estimates, errors: estimated adhesion torques and errors of the estimates, by observer, N*m, shape (n,).
    """
    figure = style.new_figure(4.2 + 1.1 * len(estimates), title)
    axes = style.panels(figure, 2 + len(estimates), sharex=True, height_ratios=(1.0, 1.8, *(1.0 for _ in estimates)))[
        :, 0
    ]
    for ax in axes[3:]:
        ax.sharey(axes[2])
    axes[0].plot(trial.time, trial.speed, label="train speed v", **style.line_style(0))
    axes[0].plot(trial.time, trial.rim_speed, label="rim speed r ω", **style.line_style(1))
    axes[0].set_ylabel("speed (m/s)")
    dashed = {"color": "black", "linestyle": "--", "linewidth": 1.0}
    axes[1].plot(trial.time, trial.brake_torque / 1e3, label="brake torque, true", **dashed)
    for i, (name, estimate) in enumerate(estimates.items()):
        color = str(max(0.75 - 0.2 * i, 0.2))  # noisier estimates come first and are lighter
        axes[1].plot(time, estimate / 1e3, linewidth=0.7, label=name, color=color)
        axes[2 + i].plot(time, errors[name] / 1e3, linewidth=0.7, color="black")
        axes[2 + i].set_ylabel(f"{name}:\nerror (kN·m)")
    axes[1].plot(trial.time, trial.adhesion_torque / 1e3, color="black", linewidth=1.2, label="adhesion torque, true")
    axes[1].set_ylabel("torque (kN·m)")
    axes[-1].set_xlabel("time (s)")
    for ax in axes[:2]:
        style.legend_beside(ax)
    return figure


def observer_responses_figure(responses: Mapping[str, ObserverResponses], *, title: str) -> Figure:
    """Plot the gain of observers over frequency: from adhesion torque, brake torque and noise to the estimate."""
    fields = {
        "adhesion": "from the adhesion torque (N·m per N·m)",
        "brake": "from the brake torque (N·m per N·m)",
        "torque_noise": "from noise of the torque (N·m per N·m)",
        "speed_noise": "from noise of the speed (N·m per rad/s)",
    }
    return style.magnitudes_figure(responses, fields, title, 5.6)


def rig_test_figure(log: Rows, *, radius: float, title: str) -> Figure:
    """Plot a log over time: speeds of train and wheel rim (km/h), slip ratio, and brake torque (kN*m).

    - radius: wheel radius, m.
    """
    figure = style.new_figure(6.0, title)
    speeds, slip, torque = style.panels(figure, 3, sharex=True)[:, 0]
    names = ("time", "train_speed", "wheel_angular_speed", "brake_torque")
    time, v, omega, brake = (log.columns[name] for name in names)
    speeds.plot(time, v / KMH, label="train, v", **style.line_style(0))
    speeds.plot(time, radius * omega / KMH, label="wheel rim, rω", **style.line_style(1))
    speeds.set_ylabel("speed (km/h)")
    style.legend_below(speeds, 0.04, columns=2)
    slip.plot(time, 1.0 - radius * omega / v, **style.line_style(0))
    slip.set_ylabel("slip ratio λ (-)")
    torque.plot(time, brake / 1e3, **style.line_style(0))
    torque.set(ylabel="brake torque (kN·m)", xlabel="time (s)")
    return figure
