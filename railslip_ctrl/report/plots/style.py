"""Common style of all figures: width, sizes of letters, lines that differ in grey print, and saving."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import rc_context, rcdefaults
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter

from railslip_ctrl.model.vehicle import Rail

if TYPE_CHECKING:
    from numpy.typing import NDArray

PAGE_WIDTH = 6.7
"""Width of every figure, inches: the text width of an A4 page (17 cm), so that letters are printed in full size."""

SMALL, TEXT, TITLE = 7.0, 8.0, 8.5  #: points: ticks and legends, axis labels and panel titles, the figure's title
GRID = {"color": "0.88", "linewidth": 0.6}  #: style of grid lines

_LETTER = 0.56  # mean width of a letter relative to its height, for DejaVu Sans
_DPI = 200  # resolution of a PNG
_PLAIN_SPAN = 2000.0  # largest ratio of the ends of a logarithmic axis with plain numbers as ticks
_LEAST_SPAN = (
    1e-6  # smallest span of an axis with plain ticks, relative to its values: labels have at most eight digits
)
_FEW = 5.0  # a logarithmic axis whose ends have a smaller ratio has fewer than three ticks at 1, 2, 5
_NOTHING = 1e-9  # largest magnitude that is a rounding error of zero and is not drawn
_HANDLE = 3.6  # length of a legend's line in letters; shows two periods of the longest dash
_LEGEND: dict[str, Any] = {"fontsize": SMALL, "frameon": False}

# colours with different lightness in grey, dark enough on white; each line also has its own dash
_COLORS = ("#08306b", "#d9500a", "#6a3d9a", "#47a747", "#7f1d2d", "#2b7a8c")
_DASHES: tuple[Any, ...] = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (8, 2)))
_MARKERS = "os^Dv"


def line_style(i: int) -> dict[str, Any]:
    """Return colour and dash of line number `i`; six colours and six dashes give 36 pairs."""
    count = len(_COLORS)
    return {"color": _COLORS[i % count], "linestyle": _DASHES[(i + i // count) % count]}


def rail_style(rail: Rail) -> dict[str, Any]:
    """Return colour and dash of a rail condition, for plots with one line per rail."""
    return line_style(list(Rail).index(rail))


def mark_style(i: int) -> dict[str, Any]:
    """Return colour and marker of data set number `i`, whose points are not connected by a line."""
    return {"color": line_style(i)["color"], "marker": _MARKERS[i % len(_MARKERS)], "linestyle": "none"}


def new_figure(height: float, title: str) -> Figure:
    """Return an empty figure with a title, as wide as a page and `height` inches high; no window opens."""
    figure = Figure(figsize=(PAGE_WIDTH, height), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(folded(title, PAGE_WIDTH - 0.1, TITLE), fontsize=TITLE)
    return figure


def panels(figure: Figure, rows: int = 1, columns: int = 1, **options: Any) -> NDArray[Any]:
    """Divide a figure into axes with standard letter sizes; `options` are those of `Figure.subplots`."""
    axes: NDArray[Any] = figure.subplots(rows, columns, squeeze=False, **options)
    for ax in axes.flat:
        ax.tick_params(which="both", labelsize=SMALL)
        for label in (ax.xaxis.label, ax.yaxis.label):
            label.set_fontsize(TEXT)
        ax.grid(visible=True, which="major", **GRID)
        ax.set_axisbelow(True)
    return axes


def grid_of(
    count: int, columns: int, title: str, height: tuple[float, float], **options: Any
) -> tuple[Figure, NDArray[Any]]:
    """Return a figure and its `count` panels, arranged in `columns` columns.

    - height: height of title and legend together, and height of each row of panels, inches.
    """
    rows = -(-count // columns)
    figure = new_figure(height[0] + height[1] * rows, title)
    axes = panels(figure, rows, columns, **options).ravel()
    for ax in axes[count:]:
        ax.set_visible(False)
    return figure, axes[:count]


def magnitudes_figure(records: Mapping[str, Any], fields: Mapping[str, str], title: str, height: float) -> Figure:
    """Plot the magnitude of fields of `records` over frequency: a panel for each field, a line for each record.

    - records: maps the labels of lines to records; each record has the frequencies `omega`, rad/s.
    - fields: maps field names to panel titles.
    - height: height of the figure, inches.
    """
    figure, axes = grid_of(len(fields), 2, title, (0.0, height / 2), sharex=True)
    for ax, (field, label) in zip(axes, fields.items(), strict=True):
        absent = []
        for i, (name, record) in enumerate(records.items()):
            magnitude = np.abs(getattr(record, field))
            if magnitude.max() > _NOTHING:
                ax.loglog(record.omega, magnitude, label=name, **line_style(i))
            else:
                absent.append(name)
                ax.plot([], [], label=name, **line_style(i))
        ax.set_title(folded(label, 0.45 * PAGE_WIDTH) + (f"\n0 for {' and '.join(absent)}" if absent else ""))
        ax.title.set_fontsize(TEXT)
        plain_log_ticks(ax.yaxis)
    for ax in axes[-2:]:
        ax.set_xlabel("frequency ω (rad/s)")
        sparse_log_ticks(ax.xaxis)
    legend_of_figure(figure, axes[0], columns=3)
    return figure


def folded(text: str, inches: float, size: float = TEXT) -> str:
    """Wrap a text to a width of `inches`, for letters of `size` points; existing line ends are kept."""
    width = max(int(72 * inches / (_LETTER * size)), 8)
    return "\n".join("\n".join(textwrap.wrap(line, width, break_long_words=False)) for line in text.split("\n"))


def legend_below(ax: Any, drop: float = 0.2, columns: int = 1, **options: Any) -> None:
    """Put a legend below the axes; `drop` is the ratio of the distance from axes to legend to the axes' height."""
    anchor = {"loc": "upper center", "bbox_to_anchor": (0.5, -drop)}
    ax.legend(ncols=columns, handlelength=_HANDLE, **anchor, **_LEGEND, **options)


def legend_beside(ax: Any) -> None:
    """Put a legend on the right of the axes."""
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), handlelength=2.4, **_LEGEND)


def legend_of_figure(figure: Figure, ax: Any, columns: int = 1, **options: Any) -> None:
    """Put one legend below all panels of a figure; it lists the lines of `ax`."""
    handles, labels = ax.get_legend_handles_labels()
    shape: dict[str, Any] = {"ncols": max(min(columns, len(labels)), 1), "handlelength": _HANDLE}
    figure.legend(handles, labels, loc="outside lower center", **shape, **_LEGEND, **options)


def plain_ticks(ax: Any, most: int) -> None:
    """Set at most `most` ticks with full numbers on the x axis; a very short axis is extended."""
    low, high = ax.get_xlim()
    short = _LEAST_SPAN * max(abs(low), abs(high)) - (high - low)
    if short > 0.0:
        ax.set_xlim(low - short / 2, high + short / 2)
    ax.xaxis.set_major_locator(MaxNLocator(most - 1))
    ax.ticklabel_format(axis="x", useOffset=False)


def plain_log_ticks(axis: Any) -> None:
    """If a logarithmic axis spans few decades, set ticks at 0.2, 0.5, 1, 2, 5, ... instead of powers of ten."""
    low, high = axis.get_view_interval()
    if high > _PLAIN_SPAN * low:
        return
    few = high < _FEW * low
    axis.set_major_locator(MaxNLocator(5) if few else LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def sparse_log_ticks(axis: Any) -> None:
    """On a logarithmic axis, set minor ticks only at 2 and 5 of each decade, because more ticks merge in print."""
    axis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
    axis.set_minor_formatter(NullFormatter())


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure to a file, in the format of its suffix; equal figures give identical files."""
    path.write_bytes(figure_bytes(figure, path.suffix.removeprefix(".")))


@contextmanager
def standard_settings() -> Iterator[None]:
    """Use Matplotlib's default settings inside the `with` block instead of those in the user's matplotlibrc."""
    with rc_context():
        rcdefaults()
        yield


def figure_files(figure: Figure, forms: Sequence[str] = ("png", "svg")) -> dict[str, bytes]:
    """Return the file content of a figure for each format in `forms`; the formats are the keys."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
    figure.set_layout_engine(None)  # with a layout engine Matplotlib would draw each file twice
    return {form: figure_bytes(figure, form) for form in forms}


def figure_bytes(figure: Figure, form: str) -> bytes:
    """Return the content of a figure's file in the format `form`, "png" or "svg"; see `save_figure`."""
    stream = BytesIO()
    metadata = {"Date": None} if form == "svg" else {"Software": None}
    with rc_context({"svg.hashsalt": "railslip"}):  # the same figure gives the same file
        figure.savefig(stream, format=form, dpi="figure", metadata=metadata)
    return stream.getvalue()
