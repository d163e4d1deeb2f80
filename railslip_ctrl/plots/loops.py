"""Bode, Nyquist and Nichols pictures of groups of loops, the dead time exact."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from railslip_ctrl.assessment import Assessment
from railslip_ctrl.design_check import ControllerGroup
from railslip_ctrl.loop.curves import FrequencyCurve

# Dark to light with a line style each, so that a grey print still tells them apart.
_STYLES = (
    {"color": "#08306b", "linestyle": "-"},
    {"color": "#d94801", "linestyle": "--"},
    {"color": "#238b45", "linestyle": "-."},
    {"color": "#6a51a3", "linestyle": ":"},
    {"color": "#525252", "linestyle": (0, (5, 1, 1, 1, 1, 1))},
    {"color": "#0f8b8d", "linestyle": (0, (1, 1))},
)
_CRITICAL = {"color": "black", "marker": "+", "markersize": 11, "markeredgewidth": 1.8, "linestyle": "none"}
_COLUMN_WIDTH = 4.1  # inches; three columns fill A4 across


def _new_figure(columns: int, height: float) -> Figure:
    figure = Figure(figsize=(max(_COLUMN_WIDTH * columns, 6.0), height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _label(assessment: Assessment) -> str:
    point = assessment.point
    state = f"Ms {assessment.margins.ms:.3g}" if assessment.margins is not None else "unstable"
    return f"{point.rail}, {point.speed_kmh:g} km/h ({state})"


def _lines(group: ControllerGroup) -> list[tuple[Assessment, FrequencyCurve, dict[str, Any]]]:
    return [
        (a, c, dict(_STYLES[i % len(_STYLES)]))
        for i, (a, c) in enumerate(zip(group.assessments, group.curves, strict=True))
    ]


def bode_figure(groups: tuple[ControllerGroup, ...]) -> Figure:
    """Magnitude and continuous phase of L(j omega) of every group, gain crossovers marked."""
    figure = _new_figure(len(groups), 6.6)
    axes = figure.subplots(2, len(groups), sharex="col", sharey="row", squeeze=False)
    for column, group in enumerate(groups):
        magnitude, phase = axes[0, column], axes[1, column]
        for assessment, curve, style in _lines(group):
            magnitude.semilogx(curve.omega, curve.magnitude_db, label=_label(assessment), **style)
            phase.semilogx(curve.omega, curve.phase_deg, **style)
            crossovers = assessment.loop.gain_crossovers
            at = np.searchsorted(curve.omega, crossovers)
            at = at[at < curve.omega.size]
            phase.plot(curve.omega[at], curve.phase_deg[at], "o", markersize=4, color=style["color"])
            magnitude.plot(curve.omega[at], curve.magnitude_db[at], "o", markersize=4, color=style["color"])
        magnitude.axhline(0, color="black", linewidth=0.8)
        _critical_phases(phase, group.curves)
        magnitude.set_title(_wrapped(group.title), fontsize=9)
        magnitude.legend(fontsize=7)
        phase.set_xlabel("Frequency ω (rad/s)")
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
    bottom, top = ax.get_ylim() if ax.get_autoscaley_on() is False else (low, high)
    ax.set_ylim(min(bottom, low - 20), max(top, high + 20))
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
    figure = _new_figure(len(groups), 8.4)
    axes = figure.subplots(2, len(groups), squeeze=False)
    for column, group in enumerate(groups):
        whole, near = axes[0, column], axes[1, column]
        for assessment, curve, style in _lines(group):
            _nyquist_line(whole, _compressed(curve.response), style, label=_encirclements(assessment))
            _nyquist_line(near, curve.response, style, label=_label(assessment))
        _decorate_whole(whole)
        _decorate_near(near)
        whole.set_title(_wrapped(group.title), fontsize=9)
        whole.legend(fontsize=7, loc="upper right")
        near.legend(fontsize=7, loc="upper right")
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
    ax.plot(response.real, response.imag, label=label, linewidth=1.4, **style)
    ax.plot(response.real, -response.imag, linewidth=0.6, **style)
    for fraction in (0.3, 0.45, 0.6):
        i = int(fraction * response.size)
        ax.annotate(
            "",
            xy=(response[i + 1].real, response[i + 1].imag),
            xytext=(response[i].real, response[i].imag),
            arrowprops={"arrowstyle": "-|>", "color": style["color"]},
            annotation_clip=True,
        )


def _decorate_whole(ax: Any) -> None:
    angle = np.linspace(0, 2 * np.pi, 361)
    ax.plot(np.cos(angle), np.sin(angle), color="0.6", linewidth=0.8)
    ax.plot(0.5 * np.cos(angle), 0.5 * np.sin(angle), color="0.8", linewidth=0.8, linestyle=":")
    ax.plot(-0.5, 0, **_CRITICAL)
    ax.annotate("−1", (-0.5, 0), xytext=(-8, 8), textcoords="offset points", fontsize=9)
    ax.set_xlim(-1.05, 1.05)
    ax.set_ylim(-1.05, 1.45)  # room for the legend
    ax.set_aspect("equal")
    ax.set_xlabel("Re, radius |L|/(1 + |L|); rim: infinity; dotted: |L| = 1")
    ax.grid(True, color="0.92")


def _decorate_near(ax: Any) -> None:
    angle = np.linspace(0, 2 * np.pi, 361)
    ax.plot(np.cos(angle), np.sin(angle), color="0.7", linewidth=0.8, linestyle=":")
    ax.plot(-1 + 0.5 * np.cos(angle), 0.5 * np.sin(angle), color="0.5", linewidth=0.8, linestyle="-.")
    ax.plot(-1, 0, **_CRITICAL)
    ax.set_xlim(-3.0, 1.2)
    ax.set_ylim(-1.9, 2.6)
    ax.set_aspect("equal")
    ax.set_xlabel("Re L; dotted: |L| = 1; dash-dotted: Ms = 2")
    ax.grid(True, color="0.92")


def nichols_figure(groups: tuple[ControllerGroup, ...]) -> Figure:
    """Magnitude against continuous phase, with the critical points and the Ms = 2 contour around them."""
    figure = _new_figure(len(groups), 4.4)
    axes = figure.subplots(1, len(groups), squeeze=False)
    for column, group in enumerate(groups):
        ax = axes[0, column]
        for assessment, curve, style in _lines(group):
            ax.plot(curve.phase_deg, curve.magnitude_db, label=_label(assessment), **style)
        low, high = _visible_phases(group.curves)
        contour = -1 + 0.5 * np.exp(1j * np.linspace(0, 2 * np.pi, 361))  # |1 + L| = 1/2
        contour_phase = np.degrees(np.unwrap(np.angle(-contour)))
        for centre in _critical(low, high):
            ax.plot(centre, 0, **_CRITICAL)
            ax.plot(centre + contour_phase, 20 * np.log10(np.abs(contour)), "-.", color="0.5", linewidth=0.8)
        ax.axhline(0, color="black", linewidth=0.6)
        ax.set_xlim(low - 30, high + 30)
        ax.set_ylim(-42, 52)  # room for the legend
        ax.xaxis.set_major_locator(MultipleLocator(90))
        ax.set_title(_wrapped(group.title), fontsize=9)
        ax.set_xlabel("Phase arg L (deg); +: −1; dash-dotted: Ms = 2")
        ax.grid(True, color="0.9")
        ax.legend(fontsize=7, loc="upper right")
    axes[0, 0].set_ylabel("Magnitude |L| (dB)")
    return figure


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure; the format follows the path's suffix, and the same figure gives the same bytes."""
    metadata = {"Date": None} if path.suffix == ".svg" else {"Software": None}
    figure.savefig(path, dpi=150, metadata=metadata)
