"""Pictures of designs: stabilising regions, margins along an axis, closed-loop responses, the gang of four."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.path import Path
from matplotlib.tri import Triangulation

from railslip_ctrl.core.rounding import rounded_up
from railslip_ctrl.design import MarginGrid, Strip
from railslip_ctrl.design.judging import MsMap
from railslip_ctrl.design.schedule import MarginSweep
from railslip_ctrl.loop.deadtime import GangOfFour
from railslip_ctrl.loop.responses import TimeResponse

from .style import (
    PAGE_WIDTH,
    SMALL,
    TEXT,
    folded,
    legend_of_figure,
    line_style,
    mark_style,
    new_figure,
    panels,
    plain_log_ticks,
    sparse_log_ticks,
)

_MS_TOP = 8.0  # an Ms beyond it is as good as unstable; the axis ends there
_KICK = 0.03  # of the time shown: what a lead adds to the command at first is over by then
_FITS = 9999.0  # the highest number a cell of a map has room for
_NARROW = 0.15  # of the axes: a contour that its label would take away has none
_SHORT = 4  # points of a contour too short for a label
_CLEAR = 0.08  # of the axes: between a label and the side at which a picture is cut
_APART = 0.07  # of the axes: labels nearer to each other, or to a mark, are moved
_SHARES = (0.2, 0.98)  # of a field's values, between which contours are drawn
_ROUND = (1, 1.5, 2, 3, 5, 7)


def region_figure(
    strips: Sequence[Strip],
    grid: MarginGrid,
    chosen: Mapping[str, tuple[float, float]],
    *,
    title: str,
    kp_unit: str = "N·m/(m/s)",
    ki_unit: str = "N·m/m",
) -> Figure:
    """The stabilising set of (kp, ki), contours of worst Ms, phase margin and delay margin in it, and chosen gains."""
    figure = new_figure(3.3 + 0.14 * len(chosen), title)
    axes = panels(figure, 1, 3, sharex=True, sharey=True)[0]
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
        _contours(ax, mesh, values, levels, chosen.values())
        for i, (label, (kp, ki)) in enumerate(chosen.items()):
            ax.plot(kp, ki, markersize=5, label=label, **mark_style(i))
        if not any(strip.ki_cut for strip in strips):
            ax.set_ylim(0.0, 1.05 * ax.dataLim.ymax)
        ax.set_title(f"contours: {name}", fontsize=TEXT)
        ax.set_xlabel(f"kp ({kp_unit})" + (", no bound" if any(strip.kp_cut for strip in strips) else ""))
    axes[0].set_ylabel(f"ki ({ki_unit})" + (", no bound" if any(strip.ki_cut for strip in strips) else ""))
    if chosen:
        legend_of_figure(figure, axes[0], columns=2)
    return figure


def _limit(ax: Axes, strips: Sequence[Strip]) -> None:
    """A region that goes on leaves the picture."""
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
    """Triangles over the stable points of a grid and the edge of the set, where every margin is nothing.

    A rectangular grid ends in steps where its edge is not, and contours between its last points and the edge wiggle.
    """

    triangles: Triangulation
    inside: Any
    edge: int

    def values(self, field: Any) -> Any:
        """A field of the grid at the points, 0 at the edge."""
        return np.concatenate([field[self.inside], np.zeros(self.edge)])


def _mesh(strips: Sequence[Strip], grid: MarginGrid) -> _Mesh | None:
    """None where nothing can be spanned."""
    inside = np.isfinite(grid.ms) & np.isfinite(grid.phase_deg) & np.isfinite(grid.delay_s)
    if not strips or inside.sum() < 4:
        return None
    polygons = [strip.polygon for strip in strips]
    corners = np.concatenate(polygons)
    cut = min((strip.ki_high.max() for strip in strips if strip.ki_cut), default=np.inf)
    # ki = 0 bounds the drawing, as a cut does: the loop is stable there
    edge = corners[(corners[:, 1] > 0) & (corners[:, 1] < cut)]
    kp, ki = np.meshgrid(grid.kp, grid.ki, indexing="ij")
    points = np.concatenate([np.column_stack([kp[inside], ki[inside]]), edge])
    size = np.ptp(points, axis=0)
    if not (size > 0).all():
        return None
    # Delaunay's triangles depend on the scale: in the picture both axes are equally long
    scaled = Triangulation(*(points / size).T)
    centres = points[scaled.triangles].mean(axis=1)
    within = np.any([Path(polygon).contains_points(centres) for polygon in polygons], axis=0)
    return _Mesh(Triangulation(*points.T, scaled.triangles, mask=~within), inside, len(edge))


def _contours(ax: Any, mesh: _Mesh | None, field: Any, levels: dict[float, str], marks: Iterable[Any]) -> None:
    """Lines of a field that is 0 at the edge, each labelled on its falling side, clear of labels and `marks`."""
    if mesh is None or not levels:
        return
    style = {"colors": "0.25", "linewidths": 0.8, "linestyles": "-"}
    lines = ax.tricontour(mesh.triangles, mesh.values(field), levels=sorted(levels), **style)
    size = np.ptp(ax.dataLim.get_points(), axis=0)
    last = np.inf if ax.get_autoscalex_on() else ax.get_xlim()[1] - _CLEAR * size[0]
    places: list[Any] = []
    taken = [np.asarray(mark) for mark in marks]
    for path in lines.get_paths():
        starts = np.flatnonzero(path.codes == Path.MOVETO)  # `to_polygons` would thin the points out
        parts = [part for part in np.split(path.vertices, starts[1:]) if len(part) > _SHORT]
        if not parts:
            continue
        longest = max(parts, key=lambda part: float(np.ptp(part[:, 0])))
        longest = longest[longest[:, 0] < last]
        if len(longest) <= _SHORT or np.ptp(longest[:, 0]) < _NARROW * size[0]:
            continue
        top = longest[np.argmax(longest[:, 1])]
        falling = longest[longest[:, 0] >= top[0]]
        found = [falling[np.argmin(np.abs(falling[:, 1] - part * top[1]))] for part in (0.5, 0.7, 0.3, 0.9)]
        room = [min([np.hypot(*((one - other) / size)) for other in taken], default=1.0) for one in found]
        best = found[next((i for i, far in enumerate(room) if far > _APART), int(np.argmax(room)))]
        places.append(tuple(best))
        taken.append(best)
    if places:
        ax.clabel(lines, fmt=levels, fontsize=SMALL, manual=places, inline_spacing=2)


def _round_levels(values: Any) -> dict[float, str]:
    """Round values, as many as show where a field rises: between its fifth part and nearly all of it."""
    finite = values[np.isfinite(values)]  # gains without a crossover have endless margins
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
    """Ms, phase margin, delay margin and the plant's rightmost pole along each sweep; a gap is an unstable loop."""
    figure = new_figure(7.2, title)
    # over speed and over slip the pole has different sizes; over speed, on two rails, it is to be compared
    alike = len({sweep.axis for sweep in sweeps}) == 1
    axes = panels(figure, 4, len(sweeps), sharex="col", sharey="row" if alike else False)
    for column, sweep in enumerate(sweeps):
        for i, (name, margins) in enumerate(sweep.margins.items()):
            style = line_style(i)
            axes[0, column].plot(sweep.values, margins.ms, label=name, **style)
            axes[1, column].plot(sweep.values, margins.phase_deg, label=name, **style)
            axes[2, column].semilogy(sweep.values, margins.delay_s, label=name, **style)
        axes[3, column].plot(sweep.values, sweep.pole, color="black")
        axes[3, column].axhline(0, color="0.5", linewidth=0.8)
        axes[0, column].set_title(folded(sweep.title, 0.95 * PAGE_WIDTH / len(sweeps)), fontsize=TEXT)
        axes[3, column].set_xlabel(f"{sweep.axis} ({sweep.unit})")
        plain_log_ticks(axes[2, column].yaxis)
        axes[0, column].set_ylim(1, _ms_top(sweeps if alike else [sweep]))
    for row, label in enumerate(("Ms (-)", "phase margin (deg)", "delay margin (s)", "plant pole (1/s)")):
        axes[row, 0].set_ylabel(label)
    gap = any(np.isnan(margins.ms).any() for sweep in sweeps for margins in sweep.margins.values())
    legend_of_figure(figure, axes[0, 0], columns=3, title="gap: unstable" if gap else None, title_fontsize=SMALL)
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
    """Output and control of named designs after a reference step and after a load step, the dead time exact."""
    figure = new_figure(4.4, title)
    axes = panels(figure, 2, 2, sharex="col")
    for column, (responses, label) in enumerate(((reference, reference_label), (load, load_label))):
        for i, (name, response) in enumerate(responses.items()):
            axes[0, column].plot(response.time, response.output, label=name, **line_style(i))
            axes[1, column].plot(response.time, response.control, **line_style(i))
        for height in {response.reference for response in responses.values()}:
            axes[0, column].axhline(height, color="black", linewidth=0.6, label="reference")
        axes[0, column].set_title(folded(label, 0.45 * PAGE_WIDTH), fontsize=TEXT)
        axes[1, column].set_xlabel("time (s)")
        _without_kick(axes[1, column], responses.values())
    axes[0, 0].set_ylabel("slip velocity\ndeviation (m/s)")
    axes[1, 0].set_ylabel("commanded torque\ndeviation (N·m)")
    legend_of_figure(figure, axes[0, 0], columns=3)
    return figure


def _without_kick(ax: Any, responses: Collection[TimeResponse]) -> None:
    """Cut a command off that begins far above all that follows, and say how high it goes."""
    if not responses:
        return
    later = np.concatenate([response.control[response.time > _KICK * response.time[-1]] for response in responses])
    top = max(float(response.control.max()) for response in responses)
    low, span = float(later.min()), float(np.ptp(later))
    if top > low + 2 * span > low:
        ax.set_ylim(low - 0.1 * span, low + 1.5 * span)
        words = f"cut off: begins with up to {top:.3g} N·m"
        ax.annotate(words, (0.98, 0.96), xycoords="axes fraction", ha="right", va="top", fontsize=SMALL)


def gang_of_four_figure(gangs: Mapping[str, GangOfFour], *, title: str) -> Figure:
    """|S|, |T|, |PS| and |CS| of named designs."""
    figure = new_figure(4.5, title)
    axes = panels(figure, 2, 2, sharex=True)
    fields = (
        (axes[0, 0], "s", "|S|, sensitivity (-)"),
        (axes[0, 1], "ps", "|PS|, disturbance of the command to slip velocity ((m/s)/(N·m))"),
        (axes[1, 0], "cs", "|CS|, noise to torque (N·m/(m/s))"),
        (axes[1, 1], "t", "|T|, complementary sensitivity (-)"),
    )
    for ax, name, label in fields:
        for i, (design, gang) in enumerate(gangs.items()):
            ax.loglog(gang.omega, np.abs(getattr(gang, name)), label=design, **line_style(i))
        ax.set_title(folded(label, 0.45 * PAGE_WIDTH), fontsize=TEXT)
        plain_log_ticks(ax.yaxis)
    for ax in axes[1]:
        ax.set_xlabel("frequency ω (rad/s)")
        sparse_log_ticks(ax.xaxis)
    legend_of_figure(figure, axes[0, 0], columns=3)
    return figure


def ms_map_figure(maps: Mapping[str, MsMap], *, title: str) -> Figure:
    """Worst Ms on a grid of speed and load, at the operating points and with tolerances, for named controllers."""
    figure = new_figure(0.7 + 2.6 * len(maps), title)
    axes = panels(figure, len(maps), 2, sharex="col")
    for row, (name, found) in enumerate(maps.items()):
        shown = (("at the operating points", found.operating), ("with tolerances", found.with_tolerances))
        for ax, (what, worst) in zip(axes[row], shown, strict=True):
            _grid(ax, found.speeds_kmh, found.loads, worst)
            ax.set_title(f"{name}: worst Ms {what}".removeprefix(": "), fontsize=TEXT)
            ax.grid(visible=False)
        axes[row, 0].set_ylabel("speed (km/h)")
    for ax in axes[-1]:
        ax.set_xlabel("load; black: Ms over 8, or unstable")
    return figure


def _grid(ax: Any, speeds: Any, loads: Sequence[str], worst: Any) -> None:
    """A grid of cells with their numbers; an unstable cell is black."""
    shown = np.where(np.isinf(worst), _MS_TOP, np.minimum(worst, _MS_TOP))
    ax.imshow(shown, cmap="Greys", vmin=1.0, vmax=_MS_TOP, aspect="auto", origin="lower")
    for i, j in np.ndindex(*worst.shape):
        text = "unst." if np.isinf(worst[i, j]) else "" if np.isnan(worst[i, j]) else _three(worst[i, j])
        ax.text(j, i, text, ha="center", va="center", fontsize=7, color="white" if shown[i, j] > 4.5 else "black")
    ax.set_xticks(range(len(loads)), loads)
    ax.set_yticks(range(speeds.size), [f"{v:g}" for v in speeds])


def _three(value: float) -> str:
    """Three digits, not below the value, and no exponent: what fits into a cell."""
    value = rounded_up(value)
    return f"{value:.{2 if value < 9.995 else 1 if value < 99.95 else 0}f}" if value < _FITS else f">{_FITS:g}"
