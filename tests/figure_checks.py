"""What is wrong with a figure that has been drawn: on paper, 17 cm wide, in grey."""

import itertools
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

_PAGE = 6.7  # inches: what figures are shown at, 17 cm
_LEAST = 7.0  # points: a smaller letter is not read on paper
_RIM = 1.0  # pixels around the letters of a box
_APART = 0.12  # of black to white: less is not told apart in print
_NUMBER = re.compile(r"[−-]?[\d.]+(e[−-]?\d+)?|\$.*\$")
_UNIT = re.compile(r"\([^()]*(\([^()]*\)[^()]*)*\)|density")


def defects(figure: Figure) -> list[str]:
    checks = (_unread, _outside, _overlapping, _without_unit, _alike, _covered)
    return [defect for check in checks for defect in check(figure)]


def _shown(figure: Figure) -> list[Axes]:
    return [ax for ax in figure.axes if ax.get_visible() and ax.axison]


def _tick_labels(axis: Any, *, seen: bool) -> Iterator[Text]:
    low, high = sorted(axis.get_view_interval())
    for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
        if (low <= tick.get_loc() <= high) == seen:
            yield from (tick.label1, tick.label2)


def _texts(figure: Figure) -> list[tuple[Text, Any]]:
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
    for text, box in _texts(figure):
        if figure.bbox.padded(_RIM).count_contains(box.corners()) < 4:
            yield f"{text.get_text()!r} leaves the figure"


def _overlapping(figure: Figure) -> Iterator[str]:
    upright = [(text, box) for text, box in _texts(figure) if text.get_rotation() % 90 == 0]  # else a box says little
    for (one, a), (other, b) in itertools.combinations(upright, 2):
        both = Bbox.intersection(a, b)
        if both is not None and min(both.size) > _RIM:
            yield f"{one.get_text()!r} lies on {other.get_text()!r}"


def _without_unit(figure: Figure) -> Iterator[str]:
    for ax in _shown(figure):
        column = [other for other in _shown(figure) if other.get_subplotspec().colspan == ax.get_subplotspec().colspan]
        row = [other for other in _shown(figure) if other.get_subplotspec().rowspan == ax.get_subplotspec().rowspan]
        of_x = [ax.get_xlabel()] if ax.get_xlabel() else [other.get_xlabel() for other in column]
        of_y = [ax.get_ylabel()] if ax.get_ylabel() else [other.get_ylabel() for other in row]
        for axis, near in ((ax.xaxis, of_x), (ax.yaxis, [*of_y, *(other.get_title() for other in column)])):
            numbers = [t.get_text() for t in _tick_labels(axis, seen=True) if t.get_visible()]
            if any(map(_NUMBER.fullmatch, numbers)) and not any(map(_UNIT.search, near)):
                yield f"{axis.axis_name} axis below {ax.get_title()!r}: no unit in {near}"


def _alike(figure: Figure) -> Iterator[str]:
    for ax in figure.axes:
        lines = [line for line in ax.lines if not line.get_label().startswith("_")]
        # get_linestyle() is "--" for every dash of one's own
        look = {
            ln: (ln.get_linestyle(), ln._unscaled_dash_pattern, ln.get_marker(), ln.get_fillstyle()) for ln in lines
        }
        grey = {line: float(np.dot(to_rgb(line.get_color()), (0.299, 0.587, 0.114))) for line in lines}
        for one, other in itertools.combinations(lines, 2):
            if look[one] == look[other] and abs(grey[one] - grey[other]) < _APART:
                yield f"{one.get_label()!r} and {other.get_label()!r} look the same in grey"


def _covered(figure: Figure) -> Iterator[str]:
    for ax in _shown(figure):
        legend = ax.get_legend()
        box = legend and Bbox.intersection(ax.bbox, legend.get_window_extent(figure.canvas.get_renderer()))
        for line in ax.lines if box else ():
            points = line.get_transform().transform(np.column_stack(line.get_data(orig=False)))
            if len(points) > 2 and box.count_contains(points):
                yield f"the legend of {ax.get_title()!r} covers {line.get_label()!r}"
