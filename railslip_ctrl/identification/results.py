"""What is told of fits: scores side by side, regimes, the slip of highest adhesion and that to hold, change with v0."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.arguments import Floats
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.model.numeric import adhesion_coefficient, peak
from railslip_ctrl.model.vehicle import Rail

from .curves import BINS, Cells, peak_slip
from .fits import NORMAL_QUANTILE, Fit, differences
from .models import FitModel
from .words import told

# --- the two regimes: mu rises with slip up to its peak, and falls beyond --------------------------------------------


@dataclass(frozen=True)
class Regimes:
    """Adhesion below a slip ratio, the `boundary`, sliding from there on; the `source` is whose peak that is."""

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


# --- fits side by side, as [Park2008] Table 3 ------------------------------------------------------------------------


_LEAST_BY_PARAMETER = 2.0  # independent samples; the criteria are for many, and n - p - 1 of them must stay at least


@dataclass(frozen=True)
class Score:
    """How well a fit follows the data: |mean mu - model's mean mu| by bin of slip, and information criteria.

    The criteria are of as many samples as are `independent`: by the noise's long-run variance, but no fewer than the
    stretches that gave it. The noise is what the best of the models compared leaves, so that criteria are to be
    compared within one comparison alone; lower is better.
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
    scores = []
    for fit in fits:
        parameters = len(fit.parameters) + 1  # and the variance of the noise
        # data without noise leave rounding alone, which is not 0
        deviance = independent * math.log(max(fit.residual_squares / samples, np.finfo(float).tiny))
        aic, bic = (deviance + each * parameters for each in (2.0, math.log(independent)))
        scores.append(Score(fit, *_bin_errors(fit, cells), aic, bic, independent))
    return tuple(sorted(scores, key=lambda score: score.bic))


def too_few(scores: Sequence[Score]) -> str:
    """A sentence where some model has so many parameters that the criteria cannot weigh it; else empty."""
    if all(score.independent >= _LEAST_BY_PARAMETER * len(score.fit.parameters) for score in scores):
        return ""
    return told("too few samples", independent=scores[0].independent)


def _bin_errors(fit: Fit, cells: Cells) -> tuple[Floats, Floats]:
    """Mean slip of each bin of the curve, and |mean mu - model's mean mu| in it."""
    place = np.minimum((cells.slip * BINS).astype(np.int64), BINS - 1)
    n = np.bincount(place, cells.count, minlength=BINS)
    full = n > 0
    error = np.bincount(place, cells.count * (cells.mu - fit.cell_coefficients), minlength=BINS)
    slip = np.bincount(place, cells.count * cells.slip, minlength=BINS)
    return slip[full] / n[full], np.abs(error[full] / n[full])


# --- the slip of highest adhesion, how well it is known, and the slip to hold ----------------------------------------


LARGEST_LOSS = 0.02  #: share of the highest adhesion that a reference slip may give away for the peak's uncertainty

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
    """Highest adhesion at a speed, m/s, on a rail: the slip where it is, and mu there; NaN for a law without a peak.

    Standard errors are by the delta method from the fit's covariance, and from the scatter of the ramp where the peak
    is that of one. The `reference` is the slip to hold: as near to the peak as its 99 % interval allows without passing
    it, as beyond the peak the wheel is unstable, but giving away no more than `LARGEST_LOSS` for that, and at most
    `OFF_THE_PEAK` of it. `by_rule` is a law on wet rail made from the dry one by its own rule, without standard errors;
    `extrapolated` one at an initial speed that the log did not have.
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
        notes.append(told("extrapolated", own=own))
    ruled = [peak for peak in peaks if peak.by_rule]
    if ruled:
        notes.append(told("wet by rule", model=model))
    slips = {(peak.speed, peak.by_rule): peak.slip for peak in peaks}
    if ruled and all(math.isclose(slips[p.speed, False], p.slip, rel_tol=_SAME_SLIP) for p in ruled):
        notes.append(told("one factor", model=model))
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
    """Delta method in the coordinates of the search, over a tenth of a standard error: slip and height of the peak."""
    if fit.model.name == "table":
        return _stderrs_of_table(fit)
    coordinates, covariance = fit.known.coordinates, fit.known.coordinate_covariance
    known = np.flatnonzero(np.isfinite(np.diag(covariance)))
    if not len(known):
        return math.nan, math.nan
    x = coordinates.at(fit.values)
    steps = np.maximum(_STEP * np.minimum(np.sqrt(np.diag(covariance)), coordinates.sizes(x)), _LEAST_STEP * np.abs(x))
    gradient = differences(lambda values: np.array(at(fit.model, values)), coordinates, x, steps, known)
    variance = np.diag(gradient @ covariance[np.ix_(known, known)] @ gradient.T).copy()
    for name, stderr in fit.known_stderrs.items():
        step = _STEP * stderr
        value = fit.model.known[name]
        assert isinstance(value, float)
        changed = (replace(fit.model, known={**fit.model.known, name: value + side * step}) for side in (1.0, -1.0))
        ends = [np.array(at(model, fit.values)) for model in changed]
        variance += ((ends[0] - ends[1]) / (2.0 * _STEP)) ** 2
    slip, coefficient = np.sqrt(variance)
    return float(slip), float(coefficient)


def _stderrs_of_table(fit: Fit) -> tuple[float, float]:
    """A table's peak is on a knot: any knot as high within 99 %, and up to the knots next to these."""
    knots = fit.model.known["slip"]
    assert isinstance(knots, tuple)
    slips, mu, deviation = np.array(knots), fit.values, np.sqrt(np.diag(fit.covariance))
    top = int(np.argmax(mu))
    lower = mu + NORMAL_QUANTILE * np.hypot(deviation, deviation[top]) < mu[top]  # not where a deviation is unknown
    near = np.flatnonzero(~lower)
    low, high = slips[max(near[0] - 1, 0)], slips[min(near[-1] + 1, len(slips) - 1)]
    return float(max(slips[top] - low, high - slips[top])) / NORMAL_QUANTILE, float(deviation[top])


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


# --- parameters over the initial speed: [Park2008] (30)-(32) ---------------------------------------------------------


HIGHEST_DEGREE = 2  #: as in (30)-(32)

_IMPROBABLE = 0.01  # a misfit told

_SAME_SPEED = 0.01  # relative: initial speeds nearer than this are one


@dataclass(frozen=True)
class ParameterPolynomial:
    """A parameter over the initial speed v0 in km/h: the sum of coefficients[k] v0^k, SI, with their covariance.

    It goes near the `values` at `speeds_kmh`. `misfit_probability` is that of the values being as far from it as they
    are, or farther, by their standard errors alone (chi-squared); NaN where it goes through all of them, or a standard
    error is not known.
    """

    name: str
    coefficients: Floats
    covariance: Floats
    speeds_kmh: Floats
    values: Floats
    misfit_probability: float

    @property
    def misses(self) -> str:
        """A sentence where the logs' values are farther from it than their errors allow; empty where they are not."""
        if not self.misfit_probability < _IMPROBABLE:
            return ""
        return told("misses", name=self.name, probability=self.misfit_probability)

    @property
    def stderrs(self) -> Floats:
        """Standard errors of the coefficients."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def stderr_at(self, speed_kmh: float) -> float:
        """Standard error of the parameter at v0 in km/h."""
        powers = speed_kmh ** np.arange(len(self.coefficients))
        return float(np.sqrt(powers @ self.covariance @ powers))

    def at(self, speed_kmh: float) -> float:
        """The parameter at v0 in km/h."""
        return float(np.polynomial.polynomial.polyval(speed_kmh, self.coefficients))


def over_initial_speed(initial_speeds: Sequence[float], fits: Sequence[Fit]) -> tuple[ParameterPolynomial, ...]:
    """Polynomials through the parameters of fits of one model, weighted by their standard errors where all have one.

    `initial_speeds` in m/s. The degree is 2, or one less than there are distinct speeds. A log that leaves a parameter
    on a bound at infinity says nothing of it.
    """
    v0 = np.array(initial_speeds) / KMH
    degree = _degree(v0)
    found = []
    for i, name in enumerate(fits[0].model.names):
        values = np.array([fit.parameters[i].value for fit in fits])
        # infinite for a parameter that rests where there is no end
        own = (fit.parameters[i] for fit in fits)
        stderrs = np.array([math.inf if math.isnan(p.stderr) and math.isinf(p.interval[1]) else p.stderr for p in own])
        coefficients, covariance = _weighted(v0, values, stderrs, degree)
        misfit = _misfit_probability(coefficients, v0, values, stderrs)
        found.append(ParameterPolynomial(name, coefficients, covariance, v0, values, misfit))
    return tuple(found)


def _misfit_probability(coefficients: Floats, v0: Floats, values: Floats, stderrs: Floats) -> float:
    from scipy.stats import chi2

    told = np.isfinite(stderrs) & (stderrs > 0.0)
    freedom = int(told.sum()) - len(coefficients)
    if freedom < 1:
        return math.nan
    error = (values - np.polynomial.polynomial.polyval(v0, coefficients)) / np.where(told, stderrs, 1.0)
    return float(chi2.sf(np.sum(error[told] ** 2), freedom))


def of_known(initial_speeds: Sequence[float], fits: Sequence[Fit]) -> dict[str, Floats]:
    """Coefficients, as `over_initial_speed` gives them, of the law's parameters that were not fitted."""
    v0 = np.array(initial_speeds) / KMH
    model = fits[0].model
    found = {}
    for name in model.law.parameter_names():
        values = [fit.model.known.get(name) for fit in fits]
        numbers = np.array([value for value in values if isinstance(value, float)])
        if name not in model.names and len(numbers) == len(fits):
            constant = bool(np.all(numbers == numbers[0]))
            found[name] = numbers[:1] if constant else _weighted(v0, numbers, np.full(len(v0), np.nan), _degree(v0))[0]
    return found


def _degree(v0: Floats) -> int:
    distinct = 1 + int(np.sum(np.diff(np.sort(v0)) > _SAME_SPEED * np.sort(v0)[1:]))
    return min(HIGHEST_DEGREE, distinct - 1)


def _weighted(v0: Floats, values: Floats, stderrs: Floats, degree: int) -> tuple[Floats, Floats]:
    told = np.isfinite(stderrs)
    if told.any() and (stderrs > 0.0).all() and not told.all():
        coefficients, covariance = _weighted(v0[told], values[told], stderrs[told], _degree(v0[told]))
        missing = degree + 1 - len(coefficients)
        return np.pad(coefficients, (0, missing)), np.pad(covariance, (0, missing))
    known = bool(told.all() and (stderrs > 0.0).all())
    weights = 1.0 / stderrs if known else np.ones_like(values)
    unit = v0.max()  # powers of a number up to 1, so that the columns are of one size
    powers = np.vander(v0 / unit, degree + 1, increasing=True)
    root = np.linalg.pinv(weights[:, None] * powers)
    scale = unit ** -np.arange(degree + 1.0)
    covariance = (root @ root.T) * np.outer(scale, scale) if known else np.full((degree + 1, degree + 1), np.nan)
    return root @ (weights * values) * scale, covariance
