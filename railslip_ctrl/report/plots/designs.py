"""Figures of loops (Bode, Nyquist and Nichols diagrams, with exact dead time), of designs, and of design reports."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.path import Path
from matplotlib.ticker import MultipleLocator
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from railslip_ctrl import __version__
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import ms_up
from railslip_ctrl.design import MarginGrid, Strip
from railslip_ctrl.design.assessment import Assessment, ControllerGroup
from railslip_ctrl.design.judging import MsMap
from railslip_ctrl.design.schedule import MarginSweep
from railslip_ctrl.design.specification import ROBUST_MS
from railslip_ctrl.loop.deadtime import FrequencyCurve, GangOfFour, Loop, frequency_curve
from railslip_ctrl.loop.responses import TimeResponse
from railslip_ctrl.report.document import short
from railslip_ctrl.report.export import law_text_at
from railslip_ctrl.report.plots.runs import no_lock_figure, runs_figure
from railslip_ctrl.report.recommendation import DesignReport, GainMap, LawCurve, Responses
from railslip_ctrl.report.stops import Stop

from . import style

_CRITICAL = {"color": "black", "marker": "+", "markersize": 9, "markeredgewidth": 1.6, "linestyle": "none"}

_CIRCLE = np.exp(1j * np.linspace(0, 2 * np.pi, 361))
_TWO = -1 + 0.5 * _CIRCLE  # circle |1 + L| = 1/2; Ms is below 2 if L stays outside


def loop_figure(loop: Loop, kind: str, band: NDArray[np.float64] | None = None) -> Figure:
    """Draw a diagram of one loop; `kind` is "bode", "nyquist" or "nichols".

    The diagram extends from the lowest to the highest frequency of `band`, rad/s; default: the loop's feature band.
    """
    draw = {"bode": bode_figure, "nyquist": nyquist_figure, "nichols": nichols_figure}[kind]
    margins, unstable = loop.margins() if loop.is_stable() else None, loop.unstable_closed_loop_poles
    # the diagrams need an assessment; this one has no operating point
    alone: Any = SimpleNamespace(point=None, loop=loop, margins=margins, unstable_poles=unstable)
    ends = loop.feature_band() if band is None else (float(band.min()), float(band.max()))
    return draw((ControllerGroup("", (alone,), (frequency_curve(loop, *ends),)),))


def _title(groups: tuple[ControllerGroup, ...]) -> str:
    first: Any = groups[0].assessments[0]
    point = first.point
    if point is None:
        return f"{first.loop} (railslip_ctrl {__version__})"
    slips = sorted({f"{a.point.rail} {a.point.slip:g}" for g in groups for a in g.assessments})
    masses = ", ".join(dict.fromkeys(f"{a.point.vehicle.mass:g}" for g in groups for a in g.assessments))
    v0 = "" if point.initial_speed_kmh is None else f", v0 {point.initial_speed_kmh:g} km/h"
    return (
        f"{point.vehicle.name}: adhesion {law_text_at(point)}{v0}, slip {', '.join(slips)}, "
        f"M\u00a0{masses}\u00a0kg (railslip_ctrl {__version__})"
    )


def _new_figure(groups: tuple[ControllerGroup, ...], height: float, lines_each: int = 1) -> Figure:
    height += 0.15 * lines_each * max(len(group.assessments) for group in groups)
    return style.new_figure(height, _title(groups))


def _column(groups: tuple[ControllerGroup, ...]) -> float:
    return (style.PAGE_WIDTH - 0.3) / max(len(groups), 2)


def _label(assessment: Assessment) -> str:
    point: Any = assessment.point
    state = f"Ms {ms_up(assessment.margins.ms)}" if assessment.margins is not None else "unstable"
    if point is None:
        return state
    return f"{point.rail}, {point.speed_kmh:g} km/h ({state})"


def _lines(group: ControllerGroup) -> list[tuple[Assessment, FrequencyCurve, dict[str, Any]]]:
    return [(a, c, style.line_style(i)) for i, (a, c) in enumerate(zip(group.assessments, group.curves, strict=True))]


def bode_figure(groups: tuple[ControllerGroup, ...]) -> Figure:
    """Plot the Bode diagrams of groups of loops, with a column for each group and marks at the gain crossovers."""
    figure = _new_figure(groups, 4.5)
    axes = style.panels(figure, 2, len(groups), sharex="col", sharey="row")
    for column, group in enumerate(groups):
        magnitude, phase = axes[:, column]
        for assessment, curve, look in _lines(group):
            _bode_lines(magnitude, phase, assessment.loop, curve, {"label": _label(assessment), **look})
        _critical_phases(phase, tuple(curve for each in groups for curve in each.curves))
        magnitude.set_title(style.folded(group.title, _column(groups)), fontsize=style.TEXT)
        phase.set_xlabel("frequency ω (rad/s)")
        style.sparse_log_ticks(phase.xaxis)
        style.legend_below(phase, 0.22)
    axes[0, 0].set_ylabel("magnitude |L| (dB)")
    axes[1, 0].set_ylabel("phase arg L (deg),\ndead time exact")
    return figure


def worst_loops_figure(loops: Sequence[Any], *, title: str) -> Figure:
    """Plot the Bode diagram and the Nyquist curve near -1 of loops (`ShownLoop`)."""
    figure = style.new_figure(3.1 + 0.15 * len(loops), title)
    magnitude, phase, near = style.panels(figure, 1, 3)[0]
    for i, shown in enumerate(loops):
        _bode_lines(magnitude, phase, shown.loop, shown.curve, {"label": shown.label, **style.line_style(i)})
        _nyquist_line(near, shown.curve.response, style.line_style(i))
    magnitude.set_ylim(-42, 42)
    _critical_phases(phase, tuple(shown.curve for shown in loops))
    _decorate_near(near)
    near.set_ylabel("Im L (-)")
    for ax, label in ((magnitude, "magnitude |L| (dB)"), (phase, "phase arg L (deg)")):
        ax.set(ylabel=label, xlabel="frequency ω (rad/s)")
        style.sparse_log_ticks(ax.xaxis)
    legend = "dots, dotted: |L| = 1; dash-dotted: Ms = 2; thin: ω < 0; curves continue outside the axes"
    style.legend_of_figure(figure, magnitude, columns=1, title=legend, title_fontsize=style.SMALL)
    return figure


def _bode_lines(magnitude: Any, phase: Any, loop: Any, curve: FrequencyCurve, look: dict[str, Any]) -> None:
    at = np.searchsorted(curve.omega, loop.gain_crossovers)
    at = at[at < curve.omega.size]
    for ax, values in ((magnitude, curve.magnitude_db), (phase, curve.phase_deg)):
        ax.semilogx(curve.omega, values, **look)
        ax.plot(curve.omega[at], values[at], "o", markersize=3.5, color=look["color"])
    magnitude.axhline(0, color="black", linewidth=0.8)


def _critical_phases(ax: Any, curves: tuple[FrequencyCurve, ...]) -> None:
    low, high = _visible_phases(curves)
    ax.set_ylim(low - 20, high + 20)
    ax.yaxis.set_major_locator(MultipleLocator(90))
    for phase in _critical(low, high):
        ax.axhline(phase, color="black", linewidth=0.8)


def _visible_phases(curves: tuple[FrequencyCurve, ...]) -> tuple[float, float]:
    shown = np.concatenate([c.phase_deg[np.abs(c.magnitude_db) < 40] for c in curves])
    if shown.size == 0:
        shown = np.concatenate([c.phase_deg for c in curves])
    return max(float(shown.min()), float(shown.max()) - 540), float(shown.max())


def _critical(low: float, high: float) -> list[float]:
    first, last = int(np.floor((low - 210) / 360)), int(np.ceil((high - 150) / 360))
    return [180.0 + 360.0 * k for k in range(first, last + 1) if low - 30 <= 180 + 360 * k <= high + 30]


def nyquist_figure(groups: tuple[ControllerGroup, ...]) -> Figure:
    """Plot the Nyquist curves of groups of loops, with a column for each group.

    The upper panel shows the whole curve with a compressed radius, the lower one the curve near -1.
    """
    beside = _column(groups) > 3.0  # inches; the legend of a loop then fits on one line
    side = _column(groups) - 0.55  # inches, side of the axes without their labels
    figure = _new_figure(groups, 2.3 + 2 * side, 1 if beside else 2)
    axes = style.panels(figure, 2, len(groups))
    for column, group in enumerate(groups):
        whole, near = axes[0, column], axes[1, column]
        for assessment, curve, look in _lines(group):
            _nyquist_line(whole, _compressed(curve.response), look)
            _closing_arc(whole, assessment.loop, curve, look)
            _nyquist_line(near, curve.response, look)
            near.lines[-2].set_label(_label(assessment) + (": " if beside else "\n") + _encirclements(assessment))
        _decorate_whole(whole)
        _decorate_near(near)
        whole.set_title(style.folded(group.title, _column(groups)), fontsize=style.TEXT)
        style.legend_below(near, 0.4 / side)
    figure.supxlabel(
        "+: −1. Above: rim at infinity; dotted: |L| = 1 and closing arc. Below: dotted: |L| = 1; dash-dotted: Ms = 2.\n"
        "P: unstable poles of L; N: turns around −1, anticlockwise; Z = P − N: unstable poles of the closed loop.",
        fontsize=style.SMALL,
    )
    axes[0, 0].set_ylabel("Im, radius |L|/(1 + |L|) (-)")
    axes[1, 0].set_ylabel("Im L (-)")
    return figure


def _compressed(response: Any) -> Any:
    return response / (1 + np.abs(response))


def _encirclements(assessment: Assessment) -> str:
    unstable_open = assessment.loop.open_loop_unstable_poles
    turns = unstable_open - assessment.unstable_poles
    return f"P {unstable_open}, N {turns:g}, Z {assessment.unstable_poles:g}".replace("-", "−")


def _nyquist_line(ax: Any, response: Any, look: dict[str, Any]) -> None:
    ax.plot(response.real, response.imag, linewidth=1.4, **look)
    ax.plot(response.real, -response.imag, linewidth=0.6, **look)
    visible = np.flatnonzero((np.abs(response.real + 1) < 2) & (np.abs(response.imag) < 1.9) & (np.abs(response) > 0.1))
    if visible.size < 4:
        return
    # equal spacing along the drawn curve, not in frequency
    seen = response[visible]
    length = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(seen)))])
    for fraction in (0.3, 0.6, 0.85):
        i = int(np.clip(np.searchsorted(length, fraction * length[-1]), 0, visible.size - 2))
        _arrow(ax, response[visible[i]], response[min(visible[i] + 12, response.size - 1)], look)


def _arrow(ax: Any, tail: complex, head: complex, look: dict[str, Any]) -> None:
    arrow = {"arrowstyle": "-|>", "color": look["color"], "mutation_scale": 9}
    ax.annotate("", (head.real, head.imag), (tail.real, tail.imag), arrowprops=arrow, annotation_clip=True)


def _closing_arc(ax: Any, loop: Loop, curve: FrequencyCurve, look: dict[str, Any]) -> None:
    integrators = loop.integrators
    if integrators == 0:
        return
    start, end = np.radians(-curve.phase_deg[0]), np.radians(curve.phase_deg[0])
    middle = 0.5 * (end + start) + np.pi * np.round((end - start + np.pi * integrators) / (2 * np.pi))
    angle = np.linspace(middle + np.pi / 2 * integrators, middle - np.pi / 2 * integrators, 181)
    arc = np.abs(_compressed(curve.response[:1]))[0] * np.exp(1j * angle)
    ax.plot(arc.real, arc.imag, linewidth=0.6, color=look["color"], linestyle=":")
    _arrow(ax, arc[angle.size // 3], arc[angle.size // 3 + 8], look)


def _decorate_whole(ax: Any) -> None:
    ax.plot(_CIRCLE.real, _CIRCLE.imag, color="0.6", linewidth=0.8)
    ax.plot(0.5 * _CIRCLE.real, 0.5 * _CIRCLE.imag, color="0.8", linewidth=0.8, linestyle=":")
    ax.set(xlim=(-1.05, 1.05), ylim=(-1.05, 1.05))
    ax.plot(-0.5, 0, **_CRITICAL)
    ax.set(aspect="equal", xlabel="Re, radius |L|/(1 + |L|) (-)")


def _decorate_near(ax: Any) -> None:
    ax.plot(_CIRCLE.real, _CIRCLE.imag, color="0.7", linewidth=0.8, linestyle=":")
    ax.plot(_TWO.real, _TWO.imag, color="0.5", linewidth=0.8, linestyle="-.")
    ax.set(xlim=(-3.0, 1.2), ylim=(-2.1, 2.1))
    ax.plot(-1, 0, **_CRITICAL)
    ax.set(aspect="equal", xlabel="Re L (-)")


def nichols_figure(groups: tuple[ControllerGroup, ...]) -> Figure:
    """Plot the Nichols diagrams of groups of loops, with marks at L = -1 and contours of Ms = 2."""
    figure = _new_figure(groups, 3.7)
    axes = style.panels(figure, 1, len(groups), sharex=True, sharey=True)
    low, high = _visible_phases(tuple(curve for group in groups for curve in group.curves))
    for column, group in enumerate(groups):
        ax = axes[0, column]
        for assessment, curve, look in _lines(group):
            ax.plot(curve.phase_deg, curve.magnitude_db, label=_label(assessment), **look)
        contour_phase = np.degrees(np.unwrap(np.angle(-_TWO)))
        for centre in _critical(low, high):
            ax.plot(centre, 0, **_CRITICAL)
            ax.plot(centre + contour_phase, 20 * np.log10(np.abs(_TWO)), "-.", color="0.5", linewidth=0.8)
        ax.axhline(0, color="black", linewidth=0.6)
        ax.set(xlim=(low - 30, high + 30), ylim=(-42, 42))
        ax.xaxis.set_major_locator(MultipleLocator(90 if _column(groups) > 3.0 else 180))
        ax.set_title(style.folded(group.title, _column(groups)), fontsize=style.TEXT)
        ax.set_xlabel("phase arg L (deg)\n+: −1; dash-dotted: Ms = 2", fontsize=style.SMALL)
        style.legend_below(ax, 0.22)
    axes[0, 0].set_ylabel("magnitude |L| (dB)")
    return figure


_MS_TOP = 8.0  # end of the Ms axis; with a larger Ms a loop is almost unstable
_KICK = 0.03  # share of the time axis after which the initial peak of a command with lead is over
_FITS = 999.0  # largest number that fits into a cell of a map
_NARROW = 0.15  # share of the axes; a shorter contour has no label, which would cover the contour
_SHORT = 4  # largest number of points of a contour without a label
_CLEAR = 0.08  # least distance of a label from the sides, share of the axes
_SHARES = (0.2, 0.98)  # quantiles of a quantity between which contours are drawn
_ROUND = (1, 1.5, 2, 3, 5, 7)


def region_figure(
    strips: Sequence[Strip],
    grid: MarginGrid,
    chosen: Mapping[str, tuple[float, float]],
    *,
    title: str,
    kp_unit: str,
    ki_unit: str,
) -> Figure:
    """Plot the region of gains kp and ki that stabilise, with contours of Ms, phase margin and delay margin.

    - strips: parts of the region.
    - grid: margins over the gains.
    - chosen: gains (kp, ki) that are marked, by label.
    - kp_unit, ki_unit: units for the axes.
    """
    figure = style.new_figure(3.3 + 0.14 * len(chosen), title)
    axes = style.panels(figure, 1, 3, sharex=True, sharey=True)[0]
    mesh = _mesh(strips, grid)
    fields = (
        ("Ms (-)", 1 / grid.ms, {1 / level: f"{level:g}" for level in _ms_levels(grid.ms)}),
        ("phase margin (deg)", grid.phase_deg, _round_levels(grid.phase_deg)),
        ("delay margin (s)", grid.delay_s, _round_levels(grid.delay_s)),
    )
    for ax, (name, values, levels) in zip(axes, fields, strict=True):
        for strip in strips:
            ax.fill(*strip.polygon.T, facecolor="0.95", edgecolor="black", linewidth=1.2)
        _limit(ax, strips)
        for i, (label, (kp, ki)) in enumerate(chosen.items()):
            ax.plot(kp, ki, markersize=5, label=label, **style.mark_style(i))
        if not any(strip.ki_cut for strip in strips):
            ax.set_ylim(0.0, 1.05 * ax.dataLim.ymax)
        _contours(ax, mesh, values, levels, chosen.values())
        ax.set_title(f"contours: {name}", fontsize=style.TEXT)
        ax.set_xlabel(f"kp ({kp_unit})" + (", no bound" if any(strip.kp_cut for strip in strips) else ""))
    axes[0].set_ylabel(f"ki ({ki_unit})" + (", no bound" if any(strip.ki_cut for strip in strips) else ""))
    if chosen:
        style.legend_of_figure(figure, axes[0], columns=2)
    return figure


def _limit(ax: Axes, strips: Sequence[Strip]) -> None:
    cut = max((float(strip.ki_high.max()) for strip in strips if strip.ki_cut), default=None)
    if cut is not None:
        ax.set_ylim(0.0, cut)
    for strip in strips:
        if strip.kp_cut and strip.kp[-1] > 0:
            ax.set_xlim(right=float(strip.kp[-1]))
        elif strip.kp_cut:
            ax.set_xlim(left=float(strip.kp[0]))


@dataclass(frozen=True)
class _Mesh:
    # triangles reach the edge of the region, where every margin is 0: a rectangular grid would give stepped contours
    triangles: Triangulation
    inside: Any
    edge: int

    def values(self, field: Any) -> Any:
        return np.concatenate([field[self.inside], np.zeros(self.edge)])


def _mesh(strips: Sequence[Strip], grid: MarginGrid) -> _Mesh | None:
    inside = np.isfinite(grid.ms) & np.isfinite(grid.phase_deg) & np.isfinite(grid.delay_s)
    if not strips or inside.sum() < 4:
        return None
    polygons = [strip.polygon for strip in strips]
    corners = np.concatenate(polygons)
    cut = min((strip.ki_high.max() for strip in strips if strip.ki_cut), default=np.inf)
    # ki = 0 limits only the drawing: the loop is stable there
    edge = corners[(corners[:, 1] > 0) & (corners[:, 1] < cut)]
    kp, ki = np.meshgrid(grid.kp, grid.ki, indexing="ij")
    points = np.concatenate([np.column_stack([kp[inside], ki[inside]]), edge])
    size = np.ptp(points, axis=0)
    if not (size > 0).all():
        return None
    # Delaunay triangles depend on the scale; use the scale of the picture, whose axes have equal length
    scaled = Triangulation(*(points / size).T)
    centres = points[scaled.triangles].mean(axis=1)
    within = np.any([Path(polygon).contains_points(centres) for polygon in polygons], axis=0)
    return _Mesh(Triangulation(*points.T, scaled.triangles, mask=~within), inside, len(edge))


def _contours(ax: Any, mesh: _Mesh | None, field: Any, levels: dict[float, str], marks: Iterable[Any]) -> None:
    if mesh is None or not levels:
        return
    look = {"colors": "0.25", "linewidths": 0.8, "linestyles": "-"}
    lines = ax.tricontour(mesh.triangles, mesh.values(field), levels=sorted(levels), **look)
    _number_contours(ax, lines, levels, marks)


def _number_contours(ax: Any, lines: Any, labels: Mapping[float, str], marks: Iterable[Any]) -> None:
    ax.get_xlim()  # applies pending limits of the axes
    to_axes = ax.transData - ax.transAxes
    taken = [to_axes.transform(mark) for mark in marks]
    places = []
    for path in lines.get_paths():
        at = to_axes.transform(path.vertices) if len(path.vertices) else np.empty((0, 2))
        at = at[np.all((at > _CLEAR) & (at < 1.0 - _CLEAR), axis=1)]
        if len(at) <= _SHORT or np.ptp(at, axis=0).max() < _NARROW:
            continue
        best = at[np.argmax(np.min([np.hypot(*(at - other).T) for other in taken] or [at[:, 1]], axis=0))]
        taken.append(best)
        places.append(tuple(to_axes.inverted().transform(best)))
    if places:
        ax.clabel(lines, fmt=labels, fontsize=style.SMALL, manual=places, inline_spacing=2)


def _round_levels(values: Any) -> dict[float, str]:
    finite = values[np.isfinite(values)]  # without a crossover a margin is infinite
    if not (finite.size and finite.max() > 0):
        return {}
    low, high = np.quantile(finite, _SHARES)
    decades = np.arange(np.floor(np.log10(max(low, 1e-3 * high))), np.ceil(np.log10(high)) + 1)
    levels = [float(f"{step}e{int(decade)}") for decade in decades for step in _ROUND]
    return {level: f"{level:g}" for level in levels if low <= level <= high}


def _ms_levels(ms: Any) -> list[float]:
    least = float(np.nanmin(ms)) if np.isfinite(ms).any() else 1.0
    levels = [1.2, 1.3, 1.4, 1.5, 1.6, 1.8, 2, 2.5, 3, 4, 5, 6, 8, 10, 15, 20]
    return [level for level in levels if level > least][:8]


def sweep_figure(sweeps: Sequence[MarginSweep], *, title: str) -> Figure:
    """Plot Ms, phase margin, delay margin and rightmost plant pole over speed or slip, with a column for each sweep."""
    figure = style.new_figure(7.2, title)
    # sweeps over speed and over slip have separate axes, because their poles differ in size; two rails share the axes
    alike = len({sweep.axis for sweep in sweeps}) == 1
    axes = style.panels(figure, 4, len(sweeps), sharex="col", sharey="row" if alike else False)
    for column, sweep in enumerate(sweeps):
        for i, (name, margins) in enumerate(sweep.margins.items()):
            look = style.line_style(i)
            axes[0, column].plot(sweep.values, margins.ms, label=name, **look)
            axes[1, column].plot(sweep.values, margins.phase_deg, label=name, **look)
            axes[2, column].semilogy(sweep.values, margins.delay_s, label=name, **look)
        axes[3, column].plot(sweep.values, sweep.pole, color="black")
        axes[3, column].axhline(0, color="0.5", linewidth=0.8)
        axes[0, column].set_title(style.folded(sweep.title, 0.95 * style.PAGE_WIDTH / len(sweeps)), fontsize=style.TEXT)
        axes[3, column].set_xlabel(f"{sweep.axis} ({sweep.unit})")
        style.plain_log_ticks(axes[2, column].yaxis)
        axes[0, column].set_ylim(1, _ms_top(sweeps if alike else [sweep]))
    for row, label in enumerate(("Ms (-)", "phase margin (deg)", "delay margin (s)", "plant pole (1/s)")):
        axes[row, 0].set_ylabel(label)
    gap = any(np.isnan(margins.ms).any() for sweep in sweeps for margins in sweep.margins.values())
    style.legend_of_figure(
        figure, axes[0, 0], columns=3, title="gap: unstable" if gap else None, title_fontsize=style.SMALL
    )
    return figure


def _ms_top(sweeps: Sequence[MarginSweep]) -> float:
    peaks = np.concatenate([m.ms for sweep in sweeps for m in sweep.margins.values()])
    largest = float(np.nanmax(peaks)) if np.isfinite(peaks).any() else _MS_TOP
    return min(_MS_TOP, 1 + 1.2 * (largest - 1)) if largest > 1 else 2


def response_figure(
    reference: Mapping[str, TimeResponse],
    load: Mapping[str, TimeResponse],
    *,
    title: str,
    reference_label: str,
    load_label: str,
) -> Figure:
    """Plot slip velocity and commanded torque of designs after a step of the reference and after a step of the load.

    - reference, load: responses to the two steps, by name of the design.
    - reference_label, load_label: titles that describe the steps.
    """
    figure = style.new_figure(4.4, title)
    axes = style.panels(figure, 2, 2, sharex="col")
    for column, (responses, label) in enumerate(((reference, reference_label), (load, load_label))):
        for i, (name, response) in enumerate(responses.items()):
            axes[0, column].plot(response.time, response.output, label=name, **style.line_style(i))
            axes[1, column].plot(response.time, response.control, **style.line_style(i))
        for height in {response.reference for response in responses.values()}:
            axes[0, column].axhline(height, color="black", linewidth=0.6, label="reference")
        axes[0, column].set_title(style.folded(label, 0.45 * style.PAGE_WIDTH), fontsize=style.TEXT)
        axes[1, column].set_xlabel("time (s)")
        _without_kick(axes[1, column], responses.values())
    axes[0, 0].set_ylabel("slip velocity\ndeviation (m/s)")
    axes[1, 0].set_ylabel("commanded torque\ndeviation (N·m)")
    style.legend_of_figure(figure, axes[0, 0], columns=3)
    return figure


def _without_kick(ax: Any, responses: Collection[TimeResponse]) -> None:
    if not responses:
        return
    later = np.concatenate([response.control[response.time > _KICK * response.time[-1]] for response in responses])
    control = np.concatenate([response.control for response in responses]).round(9)  # 5e-15 becomes 0
    low, high, span = float(later.min()), float(later.max()), float(np.ptp(later))
    if max(control.max() - low, high - control.min()) > 2 * span > 0:
        bottom, top = ax.set_ylim(low - 0.5 * span, high + 0.5 * span)
        ends = (("down", control.min() < bottom, control.min()), ("up", control.max() > top, control.max()))
        ranges = " and ".join(f"{way} to {short(float(end), 3)} N·m" for way, outside, end in ends if outside)
        label = f"cut off: {ranges}"
        ax.annotate(label, (0.98, 0.96), xycoords="axes fraction", ha="right", va="top", fontsize=style.SMALL)


def gang_of_four_figure(gangs: Mapping[str, GangOfFour], *, title: str) -> Figure:
    """Plot |S|, |T|, |PS| and |CS| over frequency, with a line for each design."""
    fields = {
        "s": "|S|, sensitivity (-)",
        "ps": "|PS|, command disturbance to slip velocity ((m/s)/(N·m))",
        "cs": "|CS|, noise to torque (N·m/(m/s))",
        "t": "|T|, complementary sensitivity (-)",
    }
    return style.magnitudes_figure(gangs, fields, title, 4.5)


def ms_map_figure(maps: Mapping[str, MsMap], *, title: str, hand_over_kmh: float = 0.0) -> Figure:
    """Plot the worst Ms over speed and load, at the operating points and with tolerances, with a row per controller.

    A dashed line marks the hand-over speed `hand_over_kmh`, km/h, below which slip is not controlled.
    """
    figure = style.new_figure(0.7 + 2.6 * len(maps), title)
    axes = style.panels(figure, len(maps), 2, sharex="col")
    for row, (name, result) in enumerate(maps.items()):
        shown = (("at the operating points", result.operating), ("with tolerances", result.with_tolerances))
        for ax, (what, worst) in zip(axes[row], shown, strict=True):
            _grid(ax, result.speeds_kmh, result.loads, worst)
            below = np.count_nonzero(result.speeds_kmh < hand_over_kmh * (1 - 1e-9))  # rounding of m/s to km/h
            if 0 < below < result.speeds_kmh.size:
                ax.axhline(below - 0.5, color="black", linestyle="--", linewidth=1.6)
            ax.set_title(f"{name}: worst Ms {what}".removeprefix(": "), fontsize=style.TEXT)
            ax.grid(visible=False)
        axes[row, 0].set_ylabel("speed (km/h)")
    for ax in axes[-1]:
        ax.set_xlabel("load")
    return figure


def _grid(ax: Any, speeds: Any, loads: Sequence[str], worst: Any) -> None:
    shown = np.where(np.isinf(worst), _MS_TOP, np.minimum(worst, _MS_TOP))
    ax.imshow(shown, cmap="Greys", vmin=1.0, vmax=_MS_TOP, aspect="auto", origin="lower")
    for i, j in np.ndindex(*worst.shape):
        ms = float(worst[i, j])
        text = "unst." if ms == np.inf else "" if np.isnan(ms) else ms_up(ms) if ms < _FITS else f">{_FITS:g}"
        ax.text(j, i, text, ha="center", va="center", fontsize=7, color="white" if shown[i, j] > 4.5 else "black")
    ax.set_xticks(range(len(loads)), loads)
    ax.set_yticks(range(speeds.size), [f"{v:g}" for v in speeds])


_MS_LEVELS = (1.5, ROBUST_MS, 3.0, 5.0, 10.0)
_UNSTABLE = 0.02  # 1/Ms below which the map is grey: with Ms over 50 a loop is almost unstable
_POINT = {"marker": "o", "markersize": 8, "markerfacecolor": "none", "markeredgewidth": 1.4, "zorder": 4}


def report_drawings(report: DesignReport) -> dict[str, Callable[[], Figure]]:
    """Map the name of each figure of a design report to a function that draws it; empty figures are left out."""
    drawings: dict[str, Callable[[], Figure]] = {}
    if report.judgement is not None and report.best is not None and report.best.design is not None:
        judged, name = report.judgement, report.best.design.structure
        loops = "sampled" if judged.as_it_runs else "the larger of continuous and sampled"
        title = f"{report.vehicle.name}, {name}: worst Ms over speed and load, {loops}"
        drawings["map"] = lambda: ms_map_figure({"": judged.map}, title=title, hand_over_kmh=judged.hand_over_kmh)
        where = f"{report.vehicle.name}, {name}: loops at the worst points; continuous time"
        drawings["loop"] = lambda: worst_loops_figure(report.worst_loops, title=where)
    if report.stops and report.best is not None:
        structure = report.best.structure
        drawings["stops"] = lambda: _stops(report.longest_stops, report.vehicle.name, structure)
    if report.gains is not None:
        gains = report.gains
        drawings["gains"] = lambda: _gains(gains, report.vehicle.name)
    if report.responses is not None:
        responses = report.responses
        drawings["responses"] = lambda: _responses(responses, report.control)
    drawings["adhesion"] = lambda: _adhesion(report.curves)
    shown = {
        f"{item.stop.rail} rail, {item.stop.law}, {item.stop.load}, seed {item.stop.run.seed}": (
            item.region,
            item.certified,
        )
        for item in report.released
        if item.region is not None and item.certified is not None
    }
    if shown:
        title = f"{report.vehicle.name}, {report.trials[0].choice.structure}: certified no-lock region and stops"
        drawings["no-lock"] = lambda: no_lock_figure(shown, title=title)
    return drawings


def _stops(stops: tuple[Stop, ...], vehicle: str, name: str) -> Figure:
    where = {f"{item.rail} rail, {item.law}, {item.load}, seed {item.run.seed}": item.run for item in stops}
    runs = {f"{name}: {run.braking_distance:.4g} m": run for name, run in where.items()}
    return runs_figure(runs, f"{vehicle}, {name}: the longest stop on each rail")


def _gains(result: GainMap, vehicle: str) -> Figure:
    figure = style.new_figure(3.6, f"{vehicle}: worst Ms of {result.points} operating points over kp and ki")
    ax = style.panels(figure)[0, 0]
    ax.set(xscale="log", yscale="log")
    inverse = 1.0 / result.ms  # 0 if unstable, and continuous at the edge of stability
    ax.contourf(result.kp, result.ki, inverse.T, levels=[0.0, _UNSTABLE], colors=["0.85"])
    levels = {1 / level: f"{level:.3g}" for level in _MS_LEVELS if inverse.min() < 1 / level < inverse.max()}
    if levels:
        lines = ax.contour(result.kp, result.ki, inverse.T, levels=sorted(levels), colors="0.25", linewidths=0.9)
        _number_contours(ax, lines, levels, [result.chosen])
    ax.plot(*result.chosen, marker="*", markersize=11, color=style.line_style(1)["color"], linestyle="none")
    for axis in (ax.xaxis, ax.yaxis):
        style.plain_log_ticks(axis)
    ax.set(xlabel="kp (N·m/(m/s)); star: recommended, grey: unstable", ylabel="ki (N·m/m)")
    return figure


def _responses(result: Responses, control: Any) -> Figure:
    point, name = result.point, control.system.structure
    where = f"{point.adhesion}, {point.rail} rail, {point.speed_kmh:g} km/h, M {point.vehicle.mass:g} kg"
    return response_figure(
        {name: result.reference},
        {name: result.load},
        title=f"Responses at the worst operating point ({where}), exact dead time",
        reference_label="step of 1 km/h of the reference slip velocity",
        load_label=f"step of {result.load_step:g} N·m of torque at the wheel",
    )


def _adhesion(curves: tuple[LawCurve, ...]) -> Figure:
    rails = list(dict.fromkeys(curve.point.rail for curve in curves))
    speeds = ", ".join(f"{v:g}" for v in dict.fromkeys(curve.point.speed_kmh for curve in curves))
    figure = style.new_figure(
        3.6, f"Steady adhesion over slip at {speeds} km/h; circles: judged slips, triangles: peaks"
    )
    axes = style.panels(figure, 1, len(rails), sharex=True, sharey=True)[0]
    for ax, rail in zip(axes, rails, strict=True):
        for i, curve in enumerate(each for each in curves if each.point.rail is rail):
            look = style.line_style(i)
            ax.plot(curve.slip, curve.coefficient, label=curve.point.adhesion, **look)
            top = curve.peak
            ax.plot(top.slip, top.coefficient, marker="^", markersize=5, color=look["color"], clip_on=False)
            ax.plot(curve.point.slip, curve.point.adhesion_coefficient, color=look["color"], **_POINT)
        ax.set_title(f"{rail} rail", fontsize=style.TEXT)
        ax.set(xlabel="slip ratio λ (-)", xlim=(0.0, None), ylim=(0.0, None))
        style.legend_below(ax, 0.18, columns=2)
    axes[0].set_ylabel("adhesion coefficient μ (-)")
    return figure
