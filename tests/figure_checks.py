"""What is wrong with a figure that has been drawn: on paper, 17 cm wide, in grey."""

import itertools
import re
from collections.abc import Iterator
from typing import Any

import matplotlib.colors
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

_PAGE = 6.7  # inches: what figures are shown at, 17 cm
_LEAST = 7.0  # points: a smaller letter is not read on paper
_RIM = 1.0  # pixels around the letters of a box
_APART = 0.12  # of black to white: less is not told apart in print
_NUMBER = re.compile(r"[−-]?[\d.]+(e[−-]?\d+)?|\$.*\$")
_UNIT = re.compile(r"\([^()]*(\([^()]*\)[^()]*)*\)|density")


def defects(figure: Figure) -> list[str]:
    """Defects in words, none if it is good; the figure has been drawn or saved before."""
    checks = (_unread, _outside, _overlapping, _without_unit, _alike, _covered)
    return [defect for check in checks for defect in check(figure)]


def _shown(figure: Figure) -> list[Axes]:
    return [ax for ax in figure.axes if ax.get_visible() and ax.axison]


def _tick_labels(axis: Any, *, seen: bool) -> Iterator[Text]:
    """Those of ticks within the axis's limits, or the others, which are not drawn."""
    low, high = sorted(axis.get_view_interval())
    for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
        if (low <= tick.get_loc() <= high) == seen:
            yield from (tick.label1, tick.label2)


def _texts(figure: Figure) -> list[tuple[Text, Any]]:
    """Every text that is seen, with its box in pixels."""
    renderer = figure.canvas.get_renderer()
    unseen = {id(t) for ax in figure.axes if ax not in _shown(figure) for t in ax.findobj(Text)}
    unseen |= {id(t) for ax in figure.axes for axis in (ax.xaxis, ax.yaxis) for t in _tick_labels(axis, seen=False)}
    texts = [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]
    return [(text, text.get_window_extent(renderer)) for text in texts if id(text) not in unseen]


def _unread(figure: Figure) -> Iterator[str]:
    smaller = min(1.0, _PAGE / figure.get_figwidth())
    for text, _ in _texts(figure):
        if text.get_fontsize() * smaller < _LEAST:
            yield f"{text.get_text()!r} is {text.get_fontsize() * smaller:.1f} pt on paper"


def _outside(figure: Figure) -> Iterator[str]:
    canvas = figure.bbox.padded(_RIM)
    for text, box in _texts(figure):
        if box.x0 < canvas.x0 or box.y0 < canvas.y0 or box.x1 > canvas.x1 or box.y1 > canvas.y1:
            yield f"{text.get_text()!r} leaves the figure"


def _overlapping(figure: Figure) -> Iterator[str]:
    upright = [(text, box) for text, box in _texts(figure) if text.get_rotation() % 90 == 0]  # else a box says little
    for (one, a), (other, b) in itertools.combinations(upright, 2):
        width, height = min(a.x1, b.x1) - max(a.x0, b.x0), min(a.y1, b.y1) - max(a.y0, b.y0)
        if width > _RIM and height > _RIM:
            yield f"{one.get_text()!r} lies on {other.get_text()!r}"


def _without_unit(figure: Figure) -> Iterator[str]:
    """Numbers at an axis need a unit: in its label or that of its column or row, for y also in a title above."""
    for ax in _shown(figure):
        column = [other for other in _shown(figure) if other.get_subplotspec().colspan == ax.get_subplotspec().colspan]
        row = [other for other in _shown(figure) if other.get_subplotspec().rowspan == ax.get_subplotspec().rowspan]
        words = {
            ax.xaxis: [ax.get_xlabel()] if ax.get_xlabel() else [other.get_xlabel() for other in column],
            ax.yaxis: [ax.get_ylabel()] if ax.get_ylabel() else [other.get_ylabel() for other in row],
        }
        words[ax.yaxis] += [other.get_title() for other in column]
        for axis, near in words.items():
            numbers = [t.get_text() for t in _tick_labels(axis, seen=True) if t.get_visible()]
            if any(_NUMBER.fullmatch(number) for number in numbers) and not any(map(_UNIT.search, near)):
                yield f"{axis.axis_name} axis below {ax.get_title()!r}: no unit in {near}"


def _alike(figure: Figure) -> Iterator[str]:
    """Lines of one legend that a grey print does not tell apart."""
    for ax in figure.axes:
        lines = [line for line in ax.lines if not line.get_label().startswith("_")]
        for one, other in itertools.combinations(lines, 2):
            if _pattern(one) == _pattern(other) and abs(_grey(one) - _grey(other)) < _APART:
                yield f"{one.get_label()!r} and {other.get_label()!r} look the same in grey"


def _pattern(line: Any) -> tuple[Any, ...]:
    # get_linestyle() is "--" for every dash of one's own
    return line.get_linestyle(), line._unscaled_dash_pattern, line.get_marker(), line.get_fillstyle()


def _grey(line: Any) -> float:
    return float(np.dot(matplotlib.colors.to_rgb(line.get_color()), (0.299, 0.587, 0.114)))


def _covered(figure: Figure) -> Iterator[str]:
    """Legends that lie on what is drawn in their axes."""
    for ax in _shown(figure):
        if ax.get_legend() is None:
            continue
        box = ax.get_legend().get_window_extent(figure.canvas.get_renderer())
        for line in ax.lines:
            points = line.get_transform().transform(np.column_stack(line.get_data(orig=False)))
            if len(points) > 2 and np.any(_inside(points, ax.bbox) & _inside(points, box)):
                yield f"the legend of {ax.get_title()!r} covers {line.get_label()!r}"


def _inside(points: np.ndarray, box: Any) -> np.ndarray:
    """Which of the points, a row each, lie in a box or on its rim; at once, as there are thousands of them."""
    return np.all((box.min <= points) & (points <= box.max), axis=1)
