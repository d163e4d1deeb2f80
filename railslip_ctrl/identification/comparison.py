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

_LEAST_BY_PARAMETER = 2.0  # independent samples; the criteria are for many, and n - p - 1 of them must stay at least


@dataclass(frozen=True)
class Score:
    """How well a fit follows the data.

    Attributes
    ----------
    fit : Fit
    bin_slip, bin_error : arrays, (bins,)
        Mean slip ratio of each bin of the curve, and |mean mu - model's mean mu| in it.
    aic, bic : float
        Akaike's and Schwarz's criterion, of as many samples as are independent; lower is better.
    independent : float
        How many that are: by the noise's long-run variance, but no fewer than the stretches that gave it. The noise is
        what the best of the models compared leaves, so that criteria are to be compared within one comparison alone.
    """

    fit: Fit
    bin_slip: Floats
    bin_error: Floats
    aic: float
    bic: float
    independent: float

    @property
    def mean_abs_error(self) -> float:
        """Mean over the bins of slip of |mean mu - model|, as [Park2008] Table 3."""
        return float(self.bin_error.mean())


def compare(fits: Sequence[Fit], cells: Cells) -> tuple[Score, ...]:
    """Scores of fits to the same cells, the lowest BIC first."""
    samples = float(cells.count.sum())
    least = min(fits, key=lambda each: each.residual_squares)
    noise = least.residual_squares / samples
    independent = samples
    if math.isfinite(least.long_run_variance) and least.long_run_variance > noise:
        stretches = least.degrees_of_freedom + len(least.parameters)  # whose sums are taken as independent
        independent = max(samples * noise / least.long_run_variance, float(stretches))
    scores = [_score(each, cells, samples, independent) for each in fits]
    return tuple(sorted(scores, key=lambda score: score.bic))


def _score(fit: Fit, cells: Cells, samples: float, independent: float) -> Score:
    parameters = len(fit.parameters) + 1  # and the variance of the noise
    # data without noise leave rounding alone, which is not nought
    deviance = independent * math.log(max(fit.residual_squares / samples, np.finfo(float).tiny))
    return Score(
        fit,
        *_bin_errors(fit, cells),
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
