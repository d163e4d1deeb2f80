"""What all figures share: line styles that survive a grey print, the canvas, saving."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

# Dark to light with a dash each, so that a grey print still tells lines apart.
_COLORS = ("#08306b", "#d94801", "#238b45", "#6a51a3", "#525252")
_DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)))


def line_style(i: int) -> dict[str, Any]:
    """Colour and dash of line number i; 30 lines before a pair repeats, as the two cycles differ in length."""
    return {"color": _COLORS[i % len(_COLORS)], "linestyle": _DASHES[i % len(_DASHES)]}


def new_figure(width: float, height: float, title: str) -> Figure:
    """A figure of so many inches, without a window."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=9)
    return figure


def legend_below(ax: Any, drop: float = 0.2, columns: int = 1) -> None:
    """A legend under the axes, where it hides nothing."""
    ax.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -drop), frameon=False, ncols=columns)


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure; the format follows the path's suffix, and the same record drawn again gives the same PNG."""
    path.write_bytes(figure_bytes(figure, path.suffix.removeprefix(".")))


def figure_bytes(figure: Figure, form: str) -> bytes:
    """A figure as the content of a file, "png" or "svg"; see `save_figure`."""
    stream = BytesIO()
    figure.savefig(stream, format=form, dpi=150, metadata={"Date": None} if form == "svg" else {"Software": None})
    return stream.getvalue()
