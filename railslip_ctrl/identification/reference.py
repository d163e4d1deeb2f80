"""The slip of highest adhesion, how well it is known, and the slip to hold; over speed, on dry and on wet rail."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.model.numeric import adhesion_coefficient, peak
from railslip_ctrl.model.vehicle import Rail

from .fits import NORMAL_QUANTILE, Fit
from .models import FitModel

LARGEST_LOSS = 0.02
"""Share of the highest adhesion that a reference slip may give away for the peak's uncertainty."""

OFF_THE_PEAK = 0.8
"""Largest reference slip over that of the peak: on the peak the slip's pole changes sign, and margins say nothing of
a little more slip; a quarter more, as an envelope tolerates, is just the peak."""

_LOWEST_SLIP = 1e-5  # a peak here is none: the law falls from the start
_STEP = 0.1  # of a standard error, or of a coordinate's size where that is less, for the derivatives of the peak
_PROBES = (0.01, 0.03, 0.1, 0.2)  # of a law's slips, to see whether it depends on the speed
_ROUNDING = 1e-12
_SAME_SLIP = 1e-4  # relative: a flat maximum is found to 1e-8 of mu, and so to the root of it
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
        By the delta method from the fit's covariance, and from the scatter of the ramp where the peak is that of one;
        NaN where that is not known.
    reference : float
        The slip to hold: as near to the peak as its 99 % interval allows without passing it, as beyond the peak the
        wheel is unstable, but giving away no more than `LARGEST_LOSS` for that, and at most `OFF_THE_PEAK` of it; NaN
        without a peak, and for a law that has less than `LARGEST_LOSS` to rise.
    reference_coefficient : float
        mu there.
    by_rule : bool
        Of a law on wet rail that was made from one on dry rail by its own rule, and not from data. It has no standard
        errors: what the rule is wrong by is not known.
    extrapolated : bool
        At an initial speed that the log did not have.
    """

    speed: float
    rail: Rail
    slip: float
    slip_stderr: float
    coefficient: float
    coefficient_stderr: float
    reference: float
    reference_coefficient: float
    by_rule: bool = False
    extrapolated: bool = False

    @property
    def basis(self) -> str:
        """What it rests on, in words."""
        source = "rule" if self.by_rule else "log"
        return f"{source}, extrapolated" if self.extrapolated else source

    def without_reference(self) -> PeakSlip:
        """The same peak, with no slip to hold."""
        return replace(self, reference=math.nan, reference_coefficient=math.nan)


def peak_of_law(law: AdhesionLaw, speed: float, wheel_load: float) -> PeakSlip:
    """The peak of a law whose parameters are taken as exact, at a speed in m/s and a wheel load in N."""
    found = peak(law, speed, wheel_load)
    return _with_reference(law, speed, wheel_load, (found.slip, found.coefficient), (0.0, 0.0))


def peak_of_fit(fit: Fit, speed: float, wheel_load: float, rail: Rail) -> PeakSlip:
    """The peak of a fitted model, with its uncertainty; wet from dry by the law's own rule.

    InputError for dry rail from a log on wet rail.
    """

    def at(model: FitModel, values: np.ndarray) -> tuple[float, float]:
        found = peak(model.make_force_law(values, fit.law.rail).on(rail), speed, wheel_load)
        return found.slip, found.coefficient

    law = fit.model.make_force_law(fit.values, fit.law.rail).on(rail)
    found = _with_reference(law, speed, wheel_load, at(fit.model, fit.values), _stderrs(at, fit))
    if rail is fit.law.rail:
        return found
    return replace(found, slip_stderr=math.nan, coefficient_stderr=math.nan, by_rule=True)


def drift(
    fit: Fit, speeds: Sequence[float], wheel_load: float, *, shown: tuple[float, float] = (0.0, math.inf)
) -> tuple[PeakSlip, ...]:
    """The peak over speeds (m/s), on the rail of the log, and on wet rail too; `shown` are the speeds the log is of."""
    rails = dict.fromkeys((fit.law.rail, Rail.WET))
    if _is_of_slip_alone(fit, speeds, wheel_load):
        first = [peak_of_fit(fit, speeds[0], wheel_load, rail) for rail in rails]
        peaks = [replace(peak, speed=speed) for peak in first for speed in speeds]
    else:
        peaks = [peak_of_fit(fit, speed, wheel_load, rail) for rail in rails for speed in speeds]
    return tuple(replace(peak, extrapolated=not shown[0] <= peak.speed <= shown[1]) for peak in peaks)


def peak_notes(peaks: Sequence[PeakSlip], model: str, shown: tuple[float, float]) -> tuple[str, ...]:
    """What of the peaks of a model is not from the log, a sentence each; `shown` as of `drift`."""
    notes = []
    if any(peak.extrapolated for peak in peaks):
        low, high = (f"{speed / KMH:.4g}" for speed in shown)
        own = f"{high} km/h" if low == high else f"{low} to {high} km/h"
        notes.append(f"extrapolated: the log is of v0 = {own}; at other speeds it shows neither peak nor slip to hold")
    ruled = [peak for peak in peaks if peak.by_rule]
    if ruled:
        notes.append(
            f"wet rail: not from this log but from the dry law by the rule of {model}, and so without an uncertainty; "
            "a log on wet rail (--rail wet) tells it"
        )
    slips = {(peak.speed, peak.by_rule): peak.slip for peak in peaks}
    if ruled and all(math.isclose(slips[p.speed, False], p.slip, rel_tol=_SAME_SLIP) for p in ruled):
        notes.append(
            f"wet rail: the rule of {model} lessens mu by one factor at every slip, so that the slip of the peak is "
            "that on dry rail, which is the rule's alone"
        )
    return tuple(notes)


def _is_of_slip_alone(fit: Fit, speeds: Sequence[float], wheel_load: float) -> bool:
    """Whether mu is the same at all speeds."""
    law = fit.model.make_force_law(fit.values, fit.law.rail)
    limits = [law.domain_limit(speed)[0] for speed in speeds]
    if not np.allclose(limits, limits[0], rtol=_ROUNDING, atol=0.0):
        return False
    slips = min(limits[0], 1.0) * np.array(_PROBES)
    mu = [np.asarray(adhesion_coefficient(law, speed, slips, wheel_load)) for speed in speeds]
    return bool(np.allclose(mu, mu[0], rtol=_ROUNDING, atol=0.0))


def _stderrs(at: Callable[[FitModel, np.ndarray], tuple[float, float]], fit: Fit) -> tuple[float, float]:
    """Delta method: the gradient of slip and height of the peak, by differences over a tenth of a standard error.

    Of the coordinates of the search, in which the parameters are not bound to each other, and of what else is known but
    not exactly.
    """
    if fit.model.name == "table":
        return _stderrs_of_table(fit)
    coordinates, covariance = fit.coordinates, fit.coordinate_covariance
    known = [i for i, variance in enumerate(np.diag(covariance)) if math.isfinite(variance)]
    if not known:
        return math.nan, math.nan
    x = coordinates.at(fit.values)
    sizes = coordinates.sizes(x)
    gradient = np.empty((2, len(known)))
    for column, i in enumerate(known):
        step = max(_STEP * min(math.sqrt(covariance[i, i]), sizes[i]), _LEAST_STEP * abs(x[i]))
        high, low = x.copy(), x.copy()
        high[i], low[i] = min(x[i] + step, coordinates.upper[i]), max(x[i] - step, coordinates.lower[i])
        ends = [np.array(at(fit.model, coordinates.values(each))) for each in (high, low)]
        gradient[:, column] = (ends[0] - ends[1]) / (high[i] - low[i])
    variance = np.diag(gradient @ covariance[np.ix_(known, known)] @ gradient.T).copy()
    for name, stderr in fit.known_stderrs.items():
        step = _STEP * stderr
        ends = [np.array(at(_knowing(fit.model, name, side * step), fit.values)) for side in (1.0, -1.0)]
        variance += ((ends[0] - ends[1]) / (2.0 * _STEP)) ** 2
    slip, coefficient = np.sqrt(variance)
    return float(slip), float(coefficient)


def _stderrs_of_table(fit: Fit) -> tuple[float, float]:
    """Of a table's peak, which lies on a knot whatever the values: it may be at any knot as high within 99 %.

    And up to the knots next to these, as between knots a table knows nothing.
    """
    knots = fit.model.known["slip"]
    assert isinstance(knots, tuple)
    slips, mu, deviation = np.array(knots), fit.values, np.sqrt(np.diag(fit.covariance))
    top = int(np.argmax(mu))
    lower = mu + NORMAL_QUANTILE * np.hypot(deviation, deviation[top]) < mu[top]  # not where a deviation is unknown
    near = np.flatnonzero(~lower)
    low, high = slips[max(near[0] - 1, 0)], slips[min(near[-1] + 1, len(slips) - 1)]
    return float(max(slips[top] - low, high - slips[top])) / NORMAL_QUANTILE, float(deviation[top])


def _knowing(model: FitModel, name: str, change: float) -> FitModel:
    """The model with a known parameter changed."""
    value = model.known[name]
    assert isinstance(value, float)
    return replace(model, known={**model.known, name: value + change})


def _with_reference(
    law: AdhesionLaw, speed: float, wheel_load: float, found: tuple[float, float], stderrs: tuple[float, float]
) -> PeakSlip:
    slip, coefficient = found
    if slip <= _LOWEST_SLIP:
        return PeakSlip(speed, law.rail, math.nan, math.nan, coefficient, stderrs[1], math.nan, math.nan)
    found_peak = PeakSlip(speed, law.rail, slip, stderrs[0], coefficient, stderrs[1], math.nan, math.nan)
    lowest = _rising_slip(law, speed, wheel_load, slip, (1.0 - LARGEST_LOSS) * coefficient)
    if lowest <= _LOWEST_SLIP:
        return found_peak
    margin = NORMAL_QUANTILE * stderrs[0] if math.isfinite(stderrs[0]) else math.inf
    reference = min(max(slip - margin, lowest), OFF_THE_PEAK * slip)
    held = float(adhesion_coefficient(law, speed, reference, wheel_load))
    return replace(found_peak, reference=reference, reference_coefficient=held)


def _rising_slip(law: AdhesionLaw, speed: float, wheel_load: float, top: float, coefficient: float) -> float:
    """Where below the peak the law passes a coefficient."""
    from scipy.optimize import brentq

    if float(adhesion_coefficient(law, speed, _LOWEST_SLIP, wheel_load)) >= coefficient:
        return _LOWEST_SLIP
    found = brentq(
        lambda slip: float(adhesion_coefficient(law, speed, slip, wheel_load)) - coefficient, _LOWEST_SLIP, top
    )
    return float(found)
