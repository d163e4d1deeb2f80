"""Bode, Nyquist and Nichols pictures of groups of loops, the dead time exact."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from railslip_ctrl import __version__
from railslip_ctrl.assessment import Assessment
from railslip_ctrl.design_check import ControllerGroup
from railslip_ctrl.loop import DeadTimeLoop
from railslip_ctrl.loop.curves import FrequencyCurve

from .style import legend_below, line_style, new_figure

_CRITICAL = {"color": "black", "marker": "+", "markersize": 11, "markeredgewidth": 1.8, "linestyle": "none"}
_COLUMN_WIDTH = 4.1  # inches; three columns fill A4 across


def _title(groups: tuple[ControllerGroup, ...]) -> str:
    """What the whole figure belongs to, so that it can be filed without its report."""
    point = groups[0].assessments[0].point
    slips = sorted({f"{a.point.rail} {a.point.slip:g}" for g in groups for a in g.assessments})
    masses = ", ".join(dict.fromkeys(f"{a.point.vehicle.mass:g}" for g in groups for a in g.assessments))
    v0 = "" if point.initial_speed_kmh is None else f", v0 {point.initial_speed_kmh:g} km/h"
    return (
        f"{point.vehicle.name}: adhesion {point.adhesion}{v0}, slip {', '.join(slips)}, M {masses} kg "
        f"(railslip_ctrl {__version__})"
    )


def _new_figure(groups: tuple[ControllerGroup, ...], height: float) -> Figure:
    columns = len(groups)
    height += 0.16 * max(len(group.assessments) for group in groups)
    return new_figure(max(_COLUMN_WIDTH * columns, 6.0), height, _title(groups))


def _label(assessment: Assessment) -> str:
    point = assessment.point
    state = f"Ms {assessment.margins.ms:.3g}" if assessment.margins is not None else "unstable"
    return f"{point.rail}, {point.speed_kmh:g} km/h ({state})"


def _lines(group: ControllerGroup) -> list[tuple[Assessment, FrequencyCurve, dict[str, Any]]]:
    return [(a, c, line_style(i)) for i, (a, c) in enumerate(zip(group.assessments, group.curves, strict=True))]


def bode_figure(groups: tuple[ControllerGroup, ...]) -> Figure:
    """Magnitude and continuous phase of L(j omega) of every group, gain crossovers marked."""
    figure = _new_figure(groups, 6.6)
    axes = figure.subplots(2, len(groups), sharex="col", sharey="row", squeeze=False)
    for column, group in enumerate(groups):
        magnitude, phase = axes[0, column], axes[1, column]
        for assessment, curve, style in _lines(group):
            magnitude.semilogx(curve.omega, curve.magnitude_db, **style)
            phase.semilogx(curve.omega, curve.phase_deg, label=_label(assessment), **style)
            crossovers = assessment.loop.gain_crossovers
            at = np.searchsorted(curve.omega, crossovers)
            at = at[at < curve.omega.size]
            phase.plot(curve.omega[at], curve.phase_deg[at], "o", markersize=4, color=style["color"])
            magnitude.plot(curve.omega[at], curve.magnitude_db[at], "o", markersize=4, color=style["color"])
        magnitude.axhline(0, color="black", linewidth=0.8)
        _critical_phases(phase, tuple(curve for each in groups for curve in each.curves))
        magnitude.set_title(_wrapped(group.title), fontsize=9)
        phase.set_xlabel("Frequency ω (rad/s)")
        legend_below(phase)
        for ax in (magnitude, phase):
            ax.grid(True, which="major", color="0.85")
    axes[0, 0].set_ylabel("Magnitude |L| (dB)")
    axes[1, 0].set_ylabel("Phase arg L (deg), dead time exact")
    return figure


def _wrapped(title: str) -> str:
    return title.replace(", ", ",\n", 1)


def _critical_phases(ax: Any, curves: tuple[FrequencyCurve, ...]) -> None:
    """Lines at odd multiples of 180 deg within view; the fall of the dead time is cut where it says no more."""
    low, high = _visible_phases(curves)
    ax.set_ylim(low - 20, high + 20)
    ax.yaxis.set_major_locator(MultipleLocator(90))
    for phase in _critical(low, high):
        ax.axhline(phase, color="black", linewidth=0.8)


def _visible_phases(curves: tuple[FrequencyCurve, ...]) -> tuple[float, float]:
    """Range of the phase, deg, where |L| is within 40 dB of 1, at most a turn and a half."""
    shown = np.concatenate([c.phase_deg[np.abs(c.magnitude_db) < 40] for c in curves])
    if shown.size == 0:
        shown = np.concatenate([c.phase_deg for c in curves])
    return max(float(shown.min()), float(shown.max()) - 540), float(shown.max())


def _critical(low: float, high: float) -> list[float]:
    """The odd multiples of 180 deg from just below `low` to just above `high`."""
    first, last = int(np.floor((low - 210) / 360)), int(np.ceil((high - 150) / 360))
    return [180.0 + 360.0 * k for k in range(first, last + 1) if low - 30 <= 180 + 360 * k <= high + 30]


def nyquist_figure(groups: tuple[ControllerGroup, ...]) -> Figure:
    """L(j omega), -inf < omega < inf: the whole curve (radius compressed) and the neighbourhood of -1."""
    figure = _new_figure(groups, 8.6)
    axes = figure.subplots(2, len(groups), squeeze=False)
    for column, group in enumerate(groups):
        whole, near = axes[0, column], axes[1, column]
        for assessment, curve, style in _lines(group):
            _nyquist_line(whole, _compressed(curve.response), style, label=_encirclements(assessment))
            _closing_arc(whole, assessment.loop, curve, style)
            _nyquist_line(near, curve.response, style, label=_label(assessment))
        _decorate_whole(whole)
        _decorate_near(near)
        whole.set_title(_wrapped(group.title), fontsize=9)
        legend_below(whole)
        legend_below(near)
    axes[0, 0].set_ylabel("Im, radius |L|/(1 + |L|)")
    axes[1, 0].set_ylabel("Im L")
    return figure


def _compressed(response: Any) -> Any:
    """Radius |L|/(1 + |L|): -1 stays on the negative axis at radius 1/2, infinity is the rim, turns are kept."""
    return response / (1 + np.abs(response))


def _encirclements(assessment: Assessment) -> str:
    unstable_open = assessment.loop.open_loop_unstable_poles
    turns = unstable_open - assessment.unstable_poles
    return (
        f"{assessment.point.rail}, {assessment.point.speed_kmh:g} km/h: P = {unstable_open}, N = {turns:g}, "
        f"Z = P − N = {assessment.unstable_poles:g}"
    )


def _nyquist_line(ax: Any, response: Any, style: dict[str, Any], *, label: str) -> None:
    """Positive frequencies thick, with arrows, negative ones thin."""
    ax.plot(response.real, response.imag, label=label, linewidth=1.4, **style)
    ax.plot(response.real, -response.imag, linewidth=0.6, **style)
    visible = np.flatnonzero((np.abs(response.real + 1) < 2) & (np.abs(response.imag) < 1.9) & (np.abs(response) > 0.1))
    if visible.size < 4:
        return
    # spaced along the curve as it is seen, not along frequency
    seen = response[visible]
    length = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(seen)))])
    for fraction in (0.3, 0.6, 0.85):
        i = int(np.clip(np.searchsorted(length, fraction * length[-1]), 0, visible.size - 2))
        tail, head = response[visible[i]], response[min(visible[i] + 12, response.size - 1)]
        ax.annotate(
            "",
            xy=(head.real, head.imag),
            xytext=(tail.real, tail.imag),
            arrowprops={"arrowstyle": "-|>", "color": style["color"], "mutation_scale": 9},
            annotation_clip=True,
        )


def _closing_arc(ax: Any, loop: DeadTimeLoop, curve: FrequencyCurve, style: dict[str, Any]) -> None:
    """The arc at infinity, clockwise from omega = 0- to 0+, that each integrator adds: 180 deg a pole at the origin."""
    integrators = int(np.count_nonzero(loop.system.poles == 0))
    if integrators == 0:
        return
    start, end = np.radians(-curve.phase_deg[0]), np.radians(curve.phase_deg[0])
    middle = 0.5 * (end + start) + np.pi * np.round((end - start + np.pi * integrators) / (2 * np.pi))
    angle = np.linspace(middle + np.pi / 2 * integrators, middle - np.pi / 2 * integrators, 181)
    radius = np.abs(_compressed(curve.response[:1]))[0]
    ax.plot(radius * np.cos(angle), radius * np.sin(angle), linewidth=0.6, color=style["color"], linestyle=":")
    at = angle.size // 3
    ax.annotate(
        "",
        xy=(radius * np.cos(angle[at + 8]), radius * np.sin(angle[at + 8])),
        xytext=(radius * np.cos(angle[at]), radius * np.sin(angle[at])),
        arrowprops={"arrowstyle": "-|>", "color": style["color"], "mutation_scale": 8},
    )


def _minus_one(ax: Any, x: float) -> None:
    """The critical point, labelled clear of the curves."""
    ax.plot(x, 0, **_CRITICAL)
    box = {"boxstyle": "round,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.8}
    ax.annotate("−1", (x, 0), xytext=(-14, -14), textcoords="offset points", fontsize=9, bbox=box)


def _decorate_whole(ax: Any) -> None:
    angle = np.linspace(0, 2 * np.pi, 361)
    ax.plot(np.cos(angle), np.sin(angle), color="0.6", linewidth=0.8)
    ax.plot(0.5 * np.cos(angle), 0.5 * np.sin(angle), color="0.8", linewidth=0.8, linestyle=":")
    _minus_one(ax, -0.5)
    ax.set_xlim(-1.05, 1.05)
    ax.set_ylim(-1.05, 1.05)
    ax.set_aspect("equal")
    ax.set_xlabel("Re, radius |L|/(1 + |L|)\nrim: infinity; dotted: |L| = 1 and closing arc", fontsize=8)
    ax.grid(True, color="0.92")


def _decorate_near(ax: Any) -> None:
    angle = np.linspace(0, 2 * np.pi, 361)
    ax.plot(np.cos(angle), np.sin(angle), color="0.7", linewidth=0.8, linestyle=":")
    ax.plot(-1 + 0.5 * np.cos(angle), 0.5 * np.sin(angle), color="0.5", linewidth=0.8, linestyle="-.")
    _minus_one(ax, -1.0)
    ax.set_xlim(-3.0, 1.2)
    ax.set_ylim(-2.1, 2.1)
    ax.set_aspect("equal")
    ax.set_xlabel("Re L\ndotted: |L| = 1; dash-dotted: Ms = 2", fontsize=8)
    ax.grid(True, color="0.92")


def nichols_figure(groups: tuple[ControllerGroup, ...]) -> Figure:
    """Magnitude against continuous phase, with the critical points and the Ms = 2 contour around them."""
    figure = _new_figure(groups, 4.4)
    axes = figure.subplots(1, len(groups), squeeze=False, sharex=True, sharey=True)
    low, high = _visible_phases(tuple(curve for group in groups for curve in group.curves))
    for column, group in enumerate(groups):
        ax = axes[0, column]
        for assessment, curve, style in _lines(group):
            ax.plot(curve.phase_deg, curve.magnitude_db, label=_label(assessment), **style)
        contour = -1 + 0.5 * np.exp(1j * np.linspace(0, 2 * np.pi, 361))  # |1 + L| = 1/2
        contour_phase = np.degrees(np.unwrap(np.angle(-contour)))
        for centre in _critical(low, high):
            ax.plot(centre, 0, **_CRITICAL)
            ax.plot(centre + contour_phase, 20 * np.log10(np.abs(contour)), "-.", color="0.5", linewidth=0.8)
        ax.axhline(0, color="black", linewidth=0.6)
        ax.set_xlim(low - 30, high + 30)
        ax.set_ylim(-42, 42)
        ax.xaxis.set_major_locator(MultipleLocator(90))
        ax.set_title(_wrapped(group.title), fontsize=9)
        ax.set_xlabel("Phase arg L (deg)\n+: −1; dash-dotted: Ms = 2", fontsize=8)
        ax.grid(True, color="0.9")
        legend_below(ax)
    axes[0, 0].set_ylabel("Magnitude |L| (dB)")
    return figure
