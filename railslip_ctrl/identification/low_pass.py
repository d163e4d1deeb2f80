"""The low-pass of the observer, 1/(tau s + 1), for channels that come in chunks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .observer.recursion import linear_recursion

Floats = NDArray[np.float64]


class LowPass:
    """Channels through 1/(tau s + 1), taken to run straight between samples, as in the observer; tau in s.

    It begins settled at the first sample.
    """

    def __init__(self, tau: float) -> None:
        self._tau = tau
        self._time = 0.0
        self._input: Floats | None = None
        self._output = np.empty(0)

    def run(self, time: Floats, channels: Floats) -> Floats:
        """The next samples of the channels, an array (channels, k), filtered."""
        before = channels[:, 0] if self._input is None else self._input
        start = before if self._input is None else self._output
        h = np.diff(time, prepend=time[0] if self._input is None else self._time)
        q = np.maximum(h / self._tau, np.finfo(float).tiny)
        share = -np.expm1(-q)
        w1 = 1.0 - share / q
        transition = (1.0 - share)[:, None, None]
        out = np.empty_like(channels)
        for i, u in enumerate(channels):
            forcing = (share - w1) * np.concatenate([before[i : i + 1], u[:-1]]) + w1 * u
            out[i] = linear_recursion(transition, forcing[:, None], start[i : i + 1])[:, 0]
        self._time, self._input, self._output = float(time[-1]), channels[:, -1].copy(), out[:, -1].copy()
        return out
