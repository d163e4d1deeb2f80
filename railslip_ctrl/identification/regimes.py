"""The two regimes of adhesion: mu rises with slip up to its peak, and falls beyond."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .cells import Cells
from .comparison import Score

Floats = NDArray[np.float64]

_PEAK_WINDOW = 0.15  # half width, relative, of the window in which mu is averaged to find its peak
_LEAST_SHARE = 0.002  # of all samples that such a window must hold


@dataclass(frozen=True)
class Regimes:
    """Adhesion below a slip ratio, sliding from there on.

    Attributes
    ----------
    boundary : float
        The slip ratio.
    source : str
        Whose peak it is, in words.
    """

    boundary: float
    source: str

    def of(self, slip: Floats) -> NDArray[np.str_]:
        """The regime of data by slip ratio."""
        return np.where(slip < self.boundary, "adhesion", "sliding")

    def errors(self, score: Score) -> tuple[float, float]:
        """Mean over the bins of each regime of |mean mu - model|; NaN where there are none."""
        below = score.bin_slip < self.boundary
        adhesion, sliding = score.bin_error[below], score.bin_error[~below]
        return (
            float(adhesion.mean()) if adhesion.size else math.nan,
            float(sliding.mean()) if sliding.size else math.nan,
        )


def regimes_of(peak: float, model: str, cells: Cells, otherwise: Regimes) -> Regimes:
    """Parted at the `peak` (slip ratio) of a model, where the data go past it; else as without."""
    if peak <= float(cells.slip.max()):  # not where it is NaN
        return Regimes(peak, f"the peak of {model}")
    return otherwise


def regimes_of_data(cells: Cells) -> Regimes:
    """Parted where the data's own mu is highest, which on a flat top the noise tells: for want of a model's peak."""
    return Regimes(peak_slip(cells), "the highest mean mu of the log")


def peak_slip(cells: Cells) -> float:
    """The slip ratio at which the data's mu, averaged over neighbouring cells, is highest."""
    order = np.argsort(cells.slip)
    slip, n, total = cells.slip[order], cells.count[order], (cells.count * cells.mu)[order]
    counts, totals = (np.concatenate([[0.0], np.cumsum(x)]) for x in (n, total))
    low = np.searchsorted(slip, slip * (1.0 - _PEAK_WINDOW))
    high = np.searchsorted(slip, slip * (1.0 + _PEAK_WINDOW), side="right")
    held = counts[high] - counts[low]
    mean = np.where(held >= _LEAST_SHARE * counts[-1], (totals[high] - totals[low]) / held, -math.inf)
    return float(slip[np.argmax(mean)])
