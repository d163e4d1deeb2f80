"""Bode, Nyquist and Nichols pictures of groups of loops, the dead time exact."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from railslip_ctrl import __version__
from railslip_ctrl.design.assessment import Assessment, ControllerGroup
from railslip_ctrl.loop.deadtime import FrequencyCurve, Loop, frequency_curve
from railslip_ctrl.report.laws import words_at

from .style import (
    PAGE_WIDTH,
    SMALL,
    TEXT,
    folded,
    legend_below,
    legend_of_figure,
    line_style,
    new_figure,
    panels,
    sparse_log_ticks,
)

_CRITICAL = {"color": "black", "marker": "+", "markersize": 9, "markeredgewidth": 1.6, "linestyle": "none"}


class _Alone:
    """A loop without an operating point, drawn as an assessment is."""

    point = None

    def __init__(self, loop: Loop) -> None:
        self.loop = loop
        self.margins = loop.margins() if loop.is_stable() else None
        self.unstable_poles = loop.unstable_closed_loop_poles


def loop_figure(loop: Loop, kind: str) -> Figure:
    """A "bode", "nyquist" or "nichols" figure of one loop, over the band in which everything happens."""
    draw = {"bode": bode_figure, "nyquist": nyquist_figure, "nichols": nichols_figure}[kind]
    alone: Any = _Alone(loop)
    return draw((ControllerGroup("", (alone,), (frequency_curve(loop, *loop.feature_band()),)),))


def _title(groups: tuple[ControllerGroup, ...]) -> str:
    """What the whole figure belongs to, so that it can be filed without its report."""
    first: Any = groups[0].assessments[0]
    point = first.point
    if point is None:
        return f"{first.loop} (railslip_ctrl {__version__})"
    slips = sorted({f"{a.point.rail} {a.point.slip:g}" for g in groups for a in g.assessments})
    masses = ", ".join(dict.fromkeys(f"{a.point.vehicle.mass:g}" for g in groups for a in g.assessments))
    v0 = "" if point.initial_speed_kmh is None else f", v0 {point.initial_speed_kmh:g} km/h"
    return (
        f"{point.vehicle.name}: adhesion {words_at(point)}{v0}, slip {', '.join(slips)}, M\u00a0{masses}\u00a0kg "
        f"(railslip_ctrl {__version__})"
    )


def _new_figure(groups: tuple[ControllerGroup, ...], height: float, lines_each: int = 1) -> Figure:
    """`height` without the legends, inches."""
    height += 0.15 * lines_each * max(len(group.assessments) for group in groups)
    return new_figure(height, _title(groups))


def _column(groups: tuple[ControllerGroup, ...]) -> float:
    """Inches a column has, with its axis labels."""
    return (PAGE_WIDTH - 0.3) / max(len(groups), 2)


def _label(assessment: Assessment) -> str:
    point: Any = assessment.point
    state = f"Ms {assessment.margins.ms:.3g}" if assessment.margins is not None else "unstable"
    if point is None:
        return state
    return f"{point.rail}, {point.speed_kmh:g} km/h ({state})"


def _lines(group: ControllerGroup) -> list[tuple[Assessment, FrequencyCurve, dict[str, Any]]]:
    return [(a, c, line_style(i)) for i, (a, c) in enumerate(zip(group.assessments, group.curves, strict=True))]


def bode_figure(groups: tuple[ControllerGroup, ...]) -> Figure:
    """Magnitude and continuous phase of L(j omega) of every group, gain crossovers marked."""
    figure = _new_figure(groups, 4.5)
    axes = panels(figure, 2, len(groups), sharex="col", sharey="row")
    for column, group in enumerate(groups):
        magnitude, phase = axes[0, column], axes[1, column]
        for assessment, curve, style in _lines(group):
            magnitude.semilogx(curve.omega, curve.magnitude_db, **style)
            phase.semilogx(curve.omega, curve.phase_deg, label=_label(assessment), **style)
            crossovers = assessment.loop.gain_crossovers
            at = np.searchsorted(curve.omega, crossovers)
            at = at[at < curve.omega.size]
            phase.plot(curve.omega[at], curve.phase_deg[at], "o", markersize=3.5, color=style["color"])
            magnitude.plot(curve.omega[at], curve.magnitude_db[at], "o", markersize=3.5, color=style["color"])
        magnitude.axhline(0, color="black", linewidth=0.8)
        _critical_phases(phase, tuple(curve for each in groups for curve in each.curves))
        magnitude.set_title(folded(group.title, _column(groups)), fontsize=TEXT)
        phase.set_xlabel("frequency ω (rad/s)")
        sparse_log_ticks(phase.xaxis)
        legend_below(phase, 0.22)
    axes[0, 0].set_ylabel("magnitude |L| (dB)")
    axes[1, 0].set_ylabel("phase arg L (deg),\ndead time exact")
    return figure


def worst_loops_figure(loops: Sequence[Any], *, title: str) -> Figure:
    """Magnitude, continuous phase and the Nyquist curve near -1 of labelled loops (`design_report.ShownLoop`)."""
    figure = new_figure(3.1 + 0.15 * len(loops), title)
    magnitude, phase, near = panels(figure, 1, 3)[0]
    for i, shown in enumerate(loops):
        curve, style = shown.curve, line_style(i)
        magnitude.semilogx(curve.omega, curve.magnitude_db, label=shown.label, **style)
        phase.semilogx(curve.omega, curve.phase_deg, **style)
        _nyquist_line(near, curve.response, style)
        at = np.searchsorted(curve.omega, shown.loop.gain_crossovers)
        at = at[at < curve.omega.size]
        for ax, values in ((magnitude, curve.magnitude_db), (phase, curve.phase_deg)):
            ax.plot(curve.omega[at], values[at], "o", markersize=3.5, color=style["color"])
    magnitude.axhline(0, color="black", linewidth=0.8)
    magnitude.set_ylim(-42, 42)
    _critical_phases(phase, tuple(shown.curve for shown in loops))
    _decorate_near(near)
    near.set_ylabel("Im L (-)")
    for ax, label in ((magnitude, "magnitude |L| (dB)"), (phase, "phase arg L (deg)")):
        ax.set_ylabel(label)
        ax.set_xlabel("frequency ω (rad/s)")
        sparse_log_ticks(ax.xaxis)
    told = "dots: |L| = 1; axes cut: |L| beyond 40 dB, phase, and L far from −1; dash-dotted: Ms = 2"
    legend_of_figure(figure, magnitude, columns=1, title=told, title_fontsize=SMALL)
    return figure


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
    beside = _column(groups) > 3.0  # what the legend says of a loop fits on one line
    side = _column(groups) - 0.55  # inches, of the axes
    figure = _new_figure(groups, 2.3 + 2 * side, 1 if beside else 2)
    axes = panels(figure, 2, len(groups))
    for column, group in enumerate(groups):
        whole, near = axes[0, column], axes[1, column]
        for assessment, curve, style in _lines(group):
            _nyquist_line(whole, _compressed(curve.response), style)
            _closing_arc(whole, assessment.loop, curve, style)
            _nyquist_line(near, curve.response, style)
            near.lines[-2].set_label(_label(assessment) + (": " if beside else "\n") + _encirclements(assessment))
        _decorate_whole(whole)
        _decorate_near(near)
        whole.set_title(folded(group.title, _column(groups)), fontsize=TEXT)
        legend_below(near, 0.4 / side)
    figure.supxlabel(
        "+: −1. Above: rim at infinity; dotted: |L| = 1 and closing arc. Below: dotted: |L| = 1; dash-dotted: Ms = 2.\n"
        "P: unstable poles of L; N: turns around −1, anticlockwise; Z = P − N: unstable poles of the closed loop.",
        fontsize=SMALL,
    )
    axes[0, 0].set_ylabel("Im, radius |L|/(1 + |L|) (-)")
    axes[1, 0].set_ylabel("Im L (-)")
    return figure


def _compressed(response: Any) -> Any:
    """Radius |L|/(1 + |L|): -1 stays on the negative axis at radius 1/2, infinity is the rim, turns are kept."""
    return response / (1 + np.abs(response))


def _encirclements(assessment: Assessment) -> str:
    unstable_open = assessment.loop.open_loop_unstable_poles
    turns = unstable_open - assessment.unstable_poles
    return f"P {unstable_open}, N {turns:g}, Z {assessment.unstable_poles:g}".replace("-", "−")


def _nyquist_line(ax: Any, response: Any, style: dict[str, Any]) -> None:
    """Positive frequencies thick, with arrows, negative ones thin."""
    ax.plot(response.real, response.imag, linewidth=1.4, **style)
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


def _closing_arc(ax: Any, loop: Loop, curve: FrequencyCurve, style: dict[str, Any]) -> None:
    """The arc at infinity, clockwise from omega = 0- to 0+, that each integrator adds: 180 deg a pole at the origin."""
    integrators = loop.integrators
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


def _decorate_whole(ax: Any) -> None:
    angle = np.linspace(0, 2 * np.pi, 361)
    ax.plot(np.cos(angle), np.sin(angle), color="0.6", linewidth=0.8)
    ax.plot(0.5 * np.cos(angle), 0.5 * np.sin(angle), color="0.8", linewidth=0.8, linestyle=":")
    ax.set_xlim(-1.05, 1.05)
    ax.set_ylim(-1.05, 1.05)
    ax.plot(-0.5, 0, **_CRITICAL)
    ax.set_aspect("equal")
    ax.set_xlabel("Re, radius |L|/(1 + |L|) (-)")


def _decorate_near(ax: Any) -> None:
    angle = np.linspace(0, 2 * np.pi, 361)
    ax.plot(np.cos(angle), np.sin(angle), color="0.7", linewidth=0.8, linestyle=":")
    ax.plot(-1 + 0.5 * np.cos(angle), 0.5 * np.sin(angle), color="0.5", linewidth=0.8, linestyle="-.")
    ax.set_xlim(-3.0, 1.2)
    ax.set_ylim(-2.1, 2.1)
    ax.plot(-1, 0, **_CRITICAL)
    ax.set_aspect("equal")
    ax.set_xlabel("Re L (-)")


def nichols_figure(groups: tuple[ControllerGroup, ...]) -> Figure:
    """Magnitude against continuous phase, with the critical points and the Ms = 2 contour around them."""
    figure = _new_figure(groups, 3.7)
    axes = panels(figure, 1, len(groups), sharex=True, sharey=True)
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
        ax.xaxis.set_major_locator(MultipleLocator(90 if _column(groups) > 3.0 else 180))
        ax.set_title(folded(group.title, _column(groups)), fontsize=TEXT)
        ax.set_xlabel("phase arg L (deg)\n+: −1; dash-dotted: Ms = 2", fontsize=SMALL)
        legend_below(ax, 0.22)
    axes[0, 0].set_ylabel("magnitude |L| (dB)")
    return figure
