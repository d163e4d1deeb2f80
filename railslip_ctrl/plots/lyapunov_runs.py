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


_LEAST = 1e-16  # of a logarithmic axis: s = 0 exactly has no place on it


def lyapunov_runs_figure(cases: Sequence[tuple[str, LyapunovRun]], title: str) -> Figure:
    """s, V on a logarithmic axis, s s', and what (40) asks for against what K + D|s| gives (largest in each 0.1 s)."""
    figure = new_figure(7.0, 10.0, title)
    surface, value, product, margin = figure.subplots(4, 1, sharex=True)
    for i, (name, judged) in enumerate(cases):
        signals, style = judged.signals, {**line_style(i), "linewidth": 0.9}
        block = _block(signals.time)
        surface.plot(signals.time, signals.s, **style)
        value.semilogy(*_largest(signals.time, np.maximum(signals.V, _LEAST), block), **style)
        product.plot(*_largest(signals.time, signals.s * signals.s_rate, block), **style)
        margin.semilogy(*_largest(signals.time, signals.asked / np.maximum(signals.available, _LEAST), block), **style)
        margin.lines[-1].set_label(name)
    product.set_yscale("symlog", linthresh=1e-3)
    product.axhline(0.0, color="black", linewidth=0.6)
    margin.axhline(1.0, color="black", linewidth=0.6)
    surface.set_ylabel("s, m/s")
    value.set_ylabel("V, (m/s)²")
    product.set_ylabel("s s', m²/s³")
    margin.set_ylabel("asked by (40) / available")
    margin.set_xlabel("time, s")
    for axes in (surface, value, product, margin):
        axes.grid(visible=True, linewidth=0.3)
    legend_below(margin, drop=0.3, columns=2)
    return figure


def adaptation_figure(cases: Sequence[tuple[str, LyapunovRun]], title: str) -> Figure:
    """V of (46) and its rate, and the estimates beside the true theta, along runs of the adaptive law."""
    figure = new_figure(7.0, 10.0, title)
    value, rate, first, second = figure.subplots(4, 1, sharex=True)
    for i, (name, judged) in enumerate(cases):
        signals, style = judged.signals, {**line_style(i), "linewidth": 0.9}
        value.plot(signals.time, signals.V, **style)
        rate.plot(*_largest(signals.time, signals.V_rate_constant, _block(signals.time)), **style)
        for axes, component in ((first, 0), (second, 1)):
            axes.plot(signals.time, signals.theta_hat[:, component], label=name, **style)
    longest = max((judged.signals for _, judged in cases), key=lambda signals: float(signals.time[-1]))
    for axes, component in ((first, 0), (second, 1)):
        axes.plot(longest.time, longest.theta[:, component], color="black", linewidth=1.6, label="true theta")
        axes.set_ylabel(("theta1, 1/(kg m)", "theta2, m/s")[component])
    value.set_yscale("symlog", linthresh=1e-2)
    rate.set_yscale("symlog", linthresh=1e-3)
    rate.axhline(0.0, color="black", linewidth=0.6)
    value.set_ylabel("V, (m/s)²")
    rate.set_ylabel("V', theta constant, m²/s³")
    second.set_xlabel("time, s")
    for axes in (value, rate, first, second):
        axes.grid(visible=True, linewidth=0.3)
    legend_below(second, drop=0.3, columns=2)
    return figure


def _block(time: Floats) -> int:
    """Samples in 0.1 s."""
    return max(round(0.1 / float(np.median(np.diff(time)))), 1)


def _largest(time: Floats, values: Floats, block: int) -> tuple[Floats, Floats]:
    """The largest value of each block of samples, at the block's first time."""
    whole = values.size // block * block
    return time[:whole:block], values[:whole].reshape(-1, block).max(axis=1)
