"""V and the margin of (40) along braking runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from .style import legend_of_figure, line_style, new_figure, panels

if TYPE_CHECKING:  # the second loads SymPy, which no other figure needs
    from numpy.typing import NDArray

    from railslip_ctrl.verification.lyapunov_runs import LyapunovRun

    Floats = NDArray[np.float64]


_LEAST = 1e-16  # of a logarithmic axis: s = 0 exactly has no place on it
_LINEAR = 1e-3  # below it an axis with both signs is linear
_TICKS = 9  # of such an axis, at most
_BLOCKS = 150  # of a run, at least: a run with noise has its spikes apart


def lyapunov_runs_figure(cases: Sequence[tuple[str, LyapunovRun]], title: str) -> Figure:
    """s, V, s s', and what (40) asks for against what K + D|s| gives; of all but s the largest in each interval."""
    interval = _interval(cases)
    figure = new_figure(8.0, f"{title}\nbelow s: the largest in each {interval:g} s")
    surface, value, product, margin = panels(figure, 4, sharex=True)[:, 0]
    for i, (name, judged) in enumerate(cases):
        signals, style = judged.signals, {**line_style(i), "linewidth": 0.9}
        block = _block(signals.time, interval)
        surface.plot(signals.time, signals.s, **style)
        value.semilogy(*_largest(signals.time, np.maximum(signals.V, _LEAST), block), **style)
        product.plot(*_largest(signals.time, signals.s * signals.s_rate, block), **style)
        margin.semilogy(*_largest(signals.time, signals.asked / np.maximum(signals.available, _LEAST), block), **style)
        margin.lines[-1].set_label(name)
    _both_signs(product)
    product.axhline(0.0, color="black", linewidth=0.6)
    margin.axhline(1.0, color="black", linewidth=0.6)
    surface.set_ylabel("s (m/s)")
    value.set_ylabel("V ((m/s)²)")
    product.set_ylabel("s s' (m²/s³)")
    margin.set_ylabel("asked by (40)\n/ available (-)")
    margin.set_xlabel("time (s)")
    legend_of_figure(figure, margin, columns=2)
    return figure


def adaptation_figure(cases: Sequence[tuple[str, LyapunovRun]], title: str) -> Figure:
    """V of (46) and its rate, and the estimates beside the true theta, along runs of the adaptive law."""
    interval = _interval(cases)
    figure = new_figure(8.0, f"{title}\nof V': the largest in each {interval:g} s")
    value, rate, first, second = panels(figure, 4, sharex=True)[:, 0]
    for i, (name, judged) in enumerate(cases):
        signals, style = judged.signals, {**line_style(i), "linewidth": 0.9}
        value.plot(signals.time, signals.V, **style)
        rate.plot(*_largest(signals.time, signals.V_rate_constant, _block(signals.time, interval)), **style)
        for axes, component in ((first, 0), (second, 1)):
            axes.plot(signals.time, signals.theta_hat[:, component], label=name, **style)
    longest = max((judged.signals for _, judged in cases), key=lambda signals: float(signals.time[-1]))
    for axes, component in ((first, 0), (second, 1)):
        axes.plot(longest.time, longest.theta[:, component], color="black", linewidth=1.6, label="true theta")
        axes.set_ylabel(("theta1 (1/(kg·m))", "theta2 (m/s)")[component])
    value.set_yscale("log")
    _both_signs(rate)
    rate.axhline(0.0, color="black", linewidth=0.6)
    value.set_ylabel("V ((m/s)²)")
    rate.set_ylabel("V', theta\nconstant (m²/s³)")
    second.set_xlabel("time (s)")
    legend_of_figure(figure, second, columns=2)
    return figure


def _interval(cases: Sequence[tuple[str, LyapunovRun]]) -> float:
    """Tenths of a second, s, so many that what is left of the longest run can be seen."""
    longest = max(float(judged.signals.time[-1]) for _, judged in cases)
    return max(round(10 * longest / _BLOCKS), 1) / 10


def _block(time: Floats, interval: float) -> int:
    """Samples in an interval."""
    return max(round(interval / float(np.median(np.diff(time)))), 1)


def _both_signs(axes: Any) -> None:
    """Logarithmic above and below zero, with as many ticks as have room."""
    axes.set_yscale("symlog", linthresh=_LINEAR)
    axes.yaxis.get_major_locator().set_params(numticks=_TICKS)


def _largest(time: Floats, values: Floats, block: int) -> tuple[Floats, Floats]:
    """The largest value of each block of samples, at the block's first time."""
    whole = values.size // block * block
    return time[:whole:block], values[:whole].reshape(-1, block).max(axis=1)
