"""V and the margin of (40) along braking runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from railslip_ctrl.lyapunov_runs import LyapunovRun

from .style import legend_below, line_style, new_figure

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


def lyapunov_runs_figure(cases: Sequence[tuple[str, LyapunovRun]], title: str) -> Figure:
    """s, s^2/2 on a logarithmic axis, and what (40) asks for against what K + D|s| gives (running maximum of 0.1 s)."""
    figure = new_figure(7.0, 8.0, title)
    surface, value, margin = figure.subplots(3, 1, sharex=True)
    for i, (name, judged) in enumerate(cases):
        signals, style = judged.signals, {**line_style(i), "linewidth": 0.9}
        surface.plot(signals.time, signals.s, **style)
        value.semilogy(signals.time, np.maximum(0.5 * signals.s**2, 1e-8), **style)
        blocks = max(round(0.1 / float(np.median(np.diff(signals.time)))), 1)
        time, share = _largest(signals.time, signals.asked / np.maximum(signals.available, 1e-12), blocks)
        margin.semilogy(time, np.maximum(share, 1e-2), label=name, **style)
    margin.axhline(1.0, color="black", linewidth=0.6)
    surface.set_ylabel("s, m/s")
    value.set_ylabel("s²/2, (m/s)²")
    margin.set_ylabel("asked by (40) / available")
    margin.set_xlabel("time, s")
    for axes in (surface, value, margin):
        axes.grid(visible=True, linewidth=0.3)
    legend_below(margin, drop=0.25, columns=2)
    return figure


def _largest(time: Floats, values: Floats, block: int) -> tuple[Floats, Floats]:
    """The largest value of each block of samples, at the block's first time."""
    whole = values.size // block * block
    return time[:whole:block], values[:whole].reshape(-1, block).max(axis=1)
