"""The slip of highest adhesion, how well it is known, and the slip to hold; over speed, on dry and on wet rail."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from railslip_ctrl.adhesion import AdhesionLaw
from railslip_ctrl.numeric import adhesion_coefficient, peak
from railslip_ctrl.parameters import Rail

from .fits import NORMAL_QUANTILE, Fit

LARGEST_LOSS = 0.02
"""Share of the highest adhesion that a reference slip below the peak may give away."""

_LOWEST_SLIP = 1e-5  # a peak here is none: the law falls from the start
_STEP = 0.1  # of a standard error, for the derivatives of the peak
_LEAST_STEP = 1e-5  # relative: below it rounding of the peak (1e-8, a flat maximum) is what would be differentiated


@dataclass(frozen=True)
class PeakSlip:
    """Highest adhesion at a speed, on a rail.

    Attributes
    ----------
    speed : float
        m/s.
    rail : Rail
    slip, coefficient : float
        Where it is, and mu there. `slip` is NaN for a law that falls from the start.
    slip_stderr, coefficient_stderr : float
        By the delta method from the fit's covariance; NaN where that is not known.
    reference : float
        The slip to hold: as near to the peak as its 99 % interval allows without passing it, as beyond the peak the
        wheel is unstable, but giving away no more than `LARGEST_LOSS`; NaN without a peak.
    reference_coefficient : float
        mu there.
    """

    speed: float
    rail: Rail
    slip: float
    slip_stderr: float
    coefficient: float
    coefficient_stderr: float
    reference: float
    reference_coefficient: float


def peak_of_law(law: AdhesionLaw, speed: float, wheel_load: float) -> PeakSlip:
    """The peak of a law whose parameters are taken as exact, at a speed in m/s and a wheel load in N."""
    found = peak(law, speed, wheel_load)
    return _with_reference(law, speed, wheel_load, (found.slip, found.coefficient), (0.0, 0.0))


def peak_of_fit(fit: Fit, speed: float, wheel_load: float, rail: Rail) -> PeakSlip:
    """The peak of a fitted model, with its uncertainty; wet from dry by the law's own rule.

    InputError for dry rail from a log on wet rail.
    """

    def at(values: np.ndarray) -> tuple[float, float]:
        found = peak(fit.model.make_force_law(values, fit.law.rail).on(rail), speed, wheel_load)
        return found.slip, found.coefficient

    law = fit.model.make_force_law(fit.values, fit.law.rail).on(rail)
    return _with_reference(law, speed, wheel_load, at(fit.values), _stderrs(at, fit))


def drift(fit: Fit, speeds: Iterable[float], wheel_load: float) -> tuple[PeakSlip, ...]:
    """The peak over speeds (m/s), on the rail of the log, and on wet rail too."""
    rails = dict.fromkeys((fit.law.rail, Rail.WET))
    return tuple(peak_of_fit(fit, speed, wheel_load, rail) for rail in rails for speed in speeds)


def _stderrs(at: Callable[[np.ndarray], tuple[float, float]], fit: Fit) -> tuple[float, float]:
    """Delta method: the gradient of slip and height of the peak, by differences over a tenth of a standard error."""
    known = [i for i, variance in enumerate(np.diag(fit.covariance)) if math.isfinite(variance)]
    if not known:
        return math.nan, math.nan
    gradient = np.empty((2, len(known)))
    for column, i in enumerate(known):
        p = fit.parameters[i]
        step = max(_STEP * math.sqrt(fit.covariance[i, i]), _LEAST_STEP * abs(p.value))
        high, low = fit.values, fit.values
        high[i] = min(p.value + step, fit.model.upper[i])
        low[i] = max(p.value - step, fit.model.lower[i])
        gradient[:, column] = (np.array(at(high)) - np.array(at(low))) / (high[i] - low[i])
    variance = np.diag(gradient @ fit.covariance[np.ix_(known, known)] @ gradient.T)
    slip, coefficient = np.sqrt(variance)
    return float(slip), float(coefficient)


def _with_reference(
    law: AdhesionLaw, speed: float, wheel_load: float, found: tuple[float, float], stderrs: tuple[float, float]
) -> PeakSlip:
    slip, coefficient = found
    if slip <= _LOWEST_SLIP:
        return PeakSlip(speed, law.rail, math.nan, math.nan, coefficient, stderrs[1], math.nan, math.nan)
    margin = NORMAL_QUANTILE * stderrs[0] if math.isfinite(stderrs[0]) else math.inf
    reference = max(slip - margin, _rising_slip(law, speed, wheel_load, slip, (1.0 - LARGEST_LOSS) * coefficient))
    held = float(adhesion_coefficient(law, speed, reference, wheel_load))
    return PeakSlip(speed, law.rail, slip, stderrs[0], coefficient, stderrs[1], reference, held)


def _rising_slip(law: AdhesionLaw, speed: float, wheel_load: float, top: float, coefficient: float) -> float:
    """Where below the peak the law passes a coefficient."""
    from scipy.optimize import brentq

    if float(adhesion_coefficient(law, speed, _LOWEST_SLIP, wheel_load)) >= coefficient:
        return _LOWEST_SLIP
    found = brentq(
        lambda slip: float(adhesion_coefficient(law, speed, slip, wheel_load)) - coefficient, _LOWEST_SLIP, top
    )
    return float(found)
