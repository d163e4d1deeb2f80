"""Pictures of a design report by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from railslip_ctrl.core.units import KMH
from railslip_ctrl.design.specification import ROBUST_MS
from railslip_ctrl.report.recommendation import DesignReport, GainMap, LawCurve, Responses, Stop

from .designs import ms_map_figure, response_figure
from .loops import worst_loops_figure
from .style import (
    SMALL,
    TEXT,
    legend_below,
    line_style,
    new_figure,
    panels,
    plain_log_ticks,
)

_MS_LEVELS = (1.5, ROBUST_MS, 3.0, 5.0, 10.0)
_UNSTABLE = 0.02  # an Ms over 50 is as good as unstable
_ENOUGH_TORQUE = 1.15  # of the highest acting torque; a command far above it is cut off in the picture
_POINT = {"marker": "o", "markersize": 8, "markerfacecolor": "none", "markeredgewidth": 1.4, "zorder": 4}


def report_drawings(report: DesignReport) -> dict[str, Callable[[], Figure]]:
    """What draws each figure; what has nothing to show is left out."""
    drawings: dict[str, Callable[[], Figure]] = {}
    if report.judgement is not None and report.control is not None:
        found, name = report.judgement.map, report.control.design.structure
        title = f"{report.vehicle.name}, {name}: worst Ms over speed and load"
        drawings["map"] = lambda: ms_map_figure({"": found}, title=title)
        where = f"{report.vehicle.name}, {name}: loops at the worst points in use; dead time exact"
        drawings["loop"] = lambda: worst_loops_figure(report.worst_loops, title=where)
    if report.stops:
        drawings["stops"] = lambda: _stops(report.first_stops, report.vehicle.name)
    if report.gains is not None:
        gains = report.gains
        drawings["gains"] = lambda: _gains(gains)
    if report.responses is not None:
        responses = report.responses
        drawings["responses"] = lambda: _responses(responses, report.control)
    drawings["adhesion"] = lambda: _adhesion(report.curves)
    return drawings


def _stops(stops: tuple[Stop, ...], vehicle: str) -> Figure:
    first = stops[0]
    title = f"{vehicle}, {first.load}: stops with the {first.controller}, law {first.law}, seed {first.run.seed}"
    figure = new_figure(5.2, title)
    axes = panels(figure, 3, len(stops), sharex="col", sharey="row")
    cut = False
    for column, stop in zip(axes.T, stops, strict=True):
        signals = stop.run.signals
        assert signals is not None, "the runs of a report are recorded"
        column[0].set_title(f"{stop.rail} rail: {stop.run.braking_distance:.4g} m", fontsize=TEXT)
        rim = (signals.speed - signals.slip_velocity) / KMH
        column[0].plot(signals.time, rim, label="wheel rim, rω", color="0.6", linewidth=0.9)
        column[0].plot(signals.time, signals.speed / KMH, label="train, v", color="black", linewidth=1.2)
        column[1].plot(signals.time, signals.slip, label="slip", linewidth=0.8, **line_style(0))
        column[1].plot(signals.time, signals.reference, label="reference", linewidth=1.2, **line_style(1))
        column[2].plot(signals.time, signals.command / 1000, label="commanded", color="0.65", linewidth=0.7)
        column[2].plot(signals.time, signals.torque / 1000, label="acting", linewidth=1.0, **line_style(0))
        column[2].set_xlabel("time (s)")
    top = _ENOUGH_TORQUE * max(stop.run.max_torque for stop in stops) / 1000
    slip = max(float(np.quantile(stop.run.signals.slip, 0.999)) for stop in stops if stop.run.signals is not None)
    slip = 1.3 * max(slip, *(stop.reference for stop in stops))
    cut = any(float(s.run.signals.command.max()) / 1000 > top for s in stops if s.run.signals is not None)
    slip_cut = any(float(s.run.signals.slip.max()) > slip for s in stops if s.run.signals is not None)
    axes[0, 0].set_ylim(bottom=0.0)
    axes[1, 0].set_ylim(0.0, slip)
    axes[2, 0].set_ylim(0.0, top)
    axes[0, 0].set_ylabel("speed (km/h)")
    axes[1, 0].set_ylabel("slip ratio λ (-)" + ("\nhigher slip cut off" if slip_cut else ""))
    axes[2, 0].set_ylabel("torque (kN·m)" + ("\ncommand cut off" if cut else ""))
    for ax in axes[:, -1]:
        ax.legend(fontsize=SMALL, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, handlelength=2.4)
    return figure


def _gains(found: GainMap) -> Figure:
    title = f"Worst Ms of {found.points} operating points around the recommended gains; grey: unstable"
    figure = new_figure(3.6, title)
    ax = panels(figure)[0, 0]
    inverse = 1.0 / found.ms  # 0 where unstable: smooth up to the edge
    ax.contourf(found.kp, found.ki, inverse.T, levels=[0.0, _UNSTABLE], colors=["0.85"])
    levels = [1 / level for level in reversed(_MS_LEVELS) if inverse.min() < 1 / level < inverse.max()]
    if levels:
        lines = ax.contour(found.kp, found.ki, inverse.T, levels=levels, colors="0.25", linewidths=0.9)
        ax.clabel(lines, fmt=lambda level: f"{1 / level:.3g}", fontsize=SMALL)
    ax.plot(*found.chosen, marker="*", markersize=11, color=line_style(1)["color"], linestyle="none")
    ax.annotate("recommended", found.chosen, (8, -4), textcoords="offset points", fontsize=SMALL)
    ax.set_xscale("log")
    ax.set_yscale("log")
    for axis in (ax.xaxis, ax.yaxis):
        plain_log_ticks(axis)
    ax.set_xlabel("kp (N·m/(m/s))")
    ax.set_ylabel("ki (N·m/m)")
    return figure


def _responses(found: Responses, control: Any) -> Figure:
    point, name = found.point, control.design.structure
    where = f"{point.adhesion}, {point.rail} rail, {point.speed_kmh:g} km/h, M {point.vehicle.mass:g} kg"
    return response_figure(
        {name: found.reference},
        {name: found.load},
        title=f"Responses at the worst operating point ({where}); dead time exact",
        reference_label="step of 1 km/h of the reference slip velocity",
        load_label=f"step of {found.load_step:g} N·m of torque at the wheel",
    )


def _adhesion(curves: tuple[LawCurve, ...]) -> Figure:
    rails = list(dict.fromkeys(curve.rail for curve in curves))
    speeds = ", ".join(f"{v:g}" for v in dict.fromkeys(curve.speed_kmh for curve in curves))
    figure = new_figure(3.6, f"Adhesion at rest over slip at {speeds} km/h; circles: slip held, triangles: peaks")
    axes = panels(figure, 1, len(rails), sharex=True, sharey=True)[0]
    for ax, rail in zip(axes, rails, strict=True):
        for i, curve in enumerate(one for one in curves if one.rail is rail):
            style = line_style(i)
            ax.plot(curve.slip, curve.coefficient, label=curve.law, **style)
            top = curve.peak
            ax.plot(top.slip, top.coefficient, marker="^", markersize=5, color=style["color"], clip_on=False)
            ax.plot(curve.point.slip, curve.point.adhesion_coefficient, color=style["color"], **_POINT)
        ax.set_title(f"{rail} rail", fontsize=TEXT)
        ax.set_xlabel("slip ratio λ (-)")
        ax.set_xlim(left=0.0)
        ax.set_ylim(bottom=0.0)
        legend_below(ax, 0.18, columns=2)
    axes[0].set_ylabel("adhesion coefficient μ (-)")
    return figure
