"""Fits side by side: errors as in [Park2008] Table 3, by regime, and information criteria."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .cells import BINS, Cells
from .fits import Fit

Floats = NDArray[np.float64]

_PEAK_WINDOW = 0.15  # half width, relative, of the window in which mu is averaged to find its peak
_LEAST_SHARE = 0.002  # of all samples that such a window must hold
_LEAST_BY_PARAMETER = 2.0  # independent samples; the criteria are for many, and n - p - 1 of them must stay at least


@dataclass(frozen=True)
class Score:
    """How well a fit follows the data.

    Attributes
    ----------
    fit : Fit
    mean_abs_error : float
        Mean over the bins of slip of |mean mu - model|, as [Park2008] Table 3.
    adhesion_error, sliding_error : float
        The same over the bins below and from the peak on; NaN where there are none.
    aic, bic : float
        Akaike's and Schwarz's criterion, of as many samples as are independent; lower is better.
    independent : float
        How many that are: by the noise's long-run variance, but no fewer than the stretches that gave it.
    """

    fit: Fit
    mean_abs_error: float
    adhesion_error: float
    sliding_error: float
    aic: float
    bic: float
    independent: float


def peak_slip(cells: Cells) -> float:
    """The slip ratio at which the data's mu, averaged over neighbouring cells, is highest.

    It parts the adhesion regime, where mu rises with slip, from the sliding regime.
    """
    order = np.argsort(cells.slip)
    slip, n, total = cells.slip[order], cells.count[order], (cells.count * cells.mu)[order]
    counts, totals = (np.concatenate([[0.0], np.cumsum(x)]) for x in (n, total))
    low = np.searchsorted(slip, slip * (1.0 - _PEAK_WINDOW))
    high = np.searchsorted(slip, slip * (1.0 + _PEAK_WINDOW), side="right")
    held = counts[high] - counts[low]
    mean = np.where(held >= _LEAST_SHARE * counts[-1], (totals[high] - totals[low]) / held, -math.inf)
    return float(slip[np.argmax(mean)])


def compare(fits: Sequence[Fit], cells: Cells, peak: float) -> tuple[Score, ...]:
    """Scores of fits to the same cells, the lowest BIC first; `peak` is the slip ratio that parts the regimes."""
    samples = float(cells.count.sum())
    least = min(fits, key=lambda each: each.residual_squares)
    noise = least.residual_squares / samples
    independent = samples
    if math.isfinite(least.long_run_variance) and least.long_run_variance > noise:
        stretches = least.degrees_of_freedom + len(least.parameters)  # whose sums are taken as independent
        independent = max(samples * noise / least.long_run_variance, float(stretches))
    scores = [_score(each, cells, peak, samples, independent) for each in fits]
    return tuple(sorted(scores, key=lambda score: score.bic))


def _score(fit: Fit, cells: Cells, peak: float, samples: float, independent: float) -> Score:
    slip, error = _bin_errors(fit, cells)
    below = slip < peak
    parameters = len(fit.parameters) + 1  # and the variance of the noise
    # data without noise leave rounding alone, which is not nought
    deviance = independent * math.log(max(fit.residual_squares / samples, np.finfo(float).tiny))
    return Score(
        fit,
        float(error.mean()),
        float(error[below].mean()) if below.any() else math.nan,
        float(error[~below].mean()) if (~below).any() else math.nan,
        deviance + 2.0 * parameters,
        deviance + math.log(independent) * parameters,
        independent,
    )


def too_few(scores: Sequence[Score]) -> str:
    """A sentence where some model has so many parameters that the criteria cannot weigh it; else empty."""
    if all(score.independent >= _LEAST_BY_PARAMETER * len(score.fit.parameters) for score in scores):
        return ""
    return (
        f"AIC and BIC are of {scores[0].independent:.3g} independent samples, too few for them to weigh these models: "
        "compare the errors"
    )


def _bin_errors(fit: Fit, cells: Cells) -> tuple[Floats, Floats]:
    """Mean slip of each bin of the curve, and |mean mu - model's mean mu| in it."""
    place = np.minimum((cells.slip * BINS).astype(np.int64), BINS - 1)
    n = np.bincount(place, cells.count, minlength=BINS)
    full = n > 0
    error = np.bincount(place, cells.count * (cells.mu - fit.cell_coefficients), minlength=BINS)
    slip = np.bincount(place, cells.count * cells.slip, minlength=BINS)
    return slip[full] / n[full], np.abs(error[full] / n[full])
