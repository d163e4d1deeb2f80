"""Summaries of fits: model scores, regimes, peak slip, reference slip, dependence on v0."""

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
from .messages import message
from .models import FitModel, spline

# --- the two regimes: mu rises with slip up to its peak, and falls beyond --------------------------------------------


@dataclass(frozen=True)
class Regimes:
    """Adhesion below the slip ratio `boundary`, sliding above it; `source` says where the boundary comes from."""

    boundary: float
    source: str

    def of(self, slip: Floats) -> NDArray[np.str_]:
        return np.where(slip < self.boundary, "adhesion", "sliding")

    def errors(self, score: Score) -> tuple[float, float]:
        """Mean `bin_error` of a score in each regime, (adhesion, sliding); NaN for a regime without bins."""
        below = score.bin_slip < self.boundary
        adhesion, sliding = score.bin_error[below], score.bin_error[~below]
        return (
            float(adhesion.mean()) if adhesion.size else math.nan,
            float(sliding.mean()) if sliding.size else math.nan,
        )


def regimes_of(peak: float, model: str, cells: Cells, otherwise: Regimes) -> Regimes:
    """Regimes with the `peak` (slip ratio) of a model as boundary; `otherwise` if no slip of the log reaches it."""
    if peak <= float(cells.slip.max()):  # false for NaN
        return Regimes(peak, f"the peak of {model}")
    return otherwise


def regimes_of_data(cells: Cells) -> Regimes:
    """Regimes with the slip of the highest measured mu as boundary."""
    return Regimes(peak_slip(cells), "the highest mean mu of the log")


# --- fits side by side, as [Park2008] Table 3 ------------------------------------------------------------------------

_LEAST_BY_PARAMETER = 2.0  # least independent samples for each parameter; AIC and BIC assume many samples


@dataclass(frozen=True)
class Score:
    """Goodness of a fit: error of mu in each bin of slip, and the information criteria `aic` and `bic`.

    A lower criterion is better. Only criteria from one call of `compare` can be compared, because they use the noise of
    the best model in this call.
    """

    fit: Fit
    bin_slip: Floats  # mean slip ratio of each bin
    bin_error: Floats  # |mean mu of the samples - mean mu of the model| in each bin
    aic: float
    bic: float
    independent: float  # number of independent samples

    @property
    def mean_abs_error(self) -> float:
        """Mean of `bin_error` over the bins, as in [Park2008] Table 3."""
        return float(self.bin_error.mean())


def compare(fits: Sequence[Fit], cells: Cells) -> tuple[Score, ...]:
    """Compute the scores of fits to the same cells; return them with the lowest BIC first."""
    samples = float(cells.count.sum())
    least = min(fits, key=lambda each: each.residual_squares)
    noise = least.residual_squares / samples
    independent = samples
    if math.isfinite(least.long_run_variance) and least.long_run_variance > noise:
        stretches = least.degrees_of_freedom + len(least.parameters)  # their sums are assumed independent
        independent = max(samples * noise / least.long_run_variance, float(stretches))
    scores = []
    for fit in fits:
        parameters = len(fit.parameters) + 1  # the variance of the noise is also a parameter
        # the lower limit avoids log(0) for data without noise
        deviance = independent * math.log(max(fit.residual_squares / samples, np.finfo(float).tiny))
        aic, bic = (deviance + each * parameters for each in (2.0, math.log(independent)))
        scores.append(Score(fit, *_bin_errors(fit, cells), aic, bic, independent))
    return tuple(sorted(scores, key=lambda score: score.bic))


FALSE_MISFIT = 0.01  #: significance level of the lack-of-fit test: at most this share of right formulas is rejected


def misfit_probability(fit: Fit, table: Fit) -> float:
    """p-value of an F test; the null hypothesis is that a formula fits the log as well as a table does.

    F is the deviance of the formula minus that of the table, divided by the number of additional parameters of the
    table and by the long-run variance of its whitened errors (at least 1). NaN if a prediction-error fit is missing or
    the table has no additional parameters.
    """
    from scipy.stats import f

    freedom = len(table.parameters) - len(fit.parameters)
    variance, of_variance = table.inflation
    if freedom < 1 or of_variance < 1:
        return math.nan
    return float(f.sf((fit.deviance - table.deviance) / freedom / max(variance, 1.0), freedom, of_variance))


def is_misfit(fit: Fit, table: Fit | None) -> bool:
    """True if the test of `misfit_probability` rejects a formula in favour of a table."""
    return table is not None and misfit_probability(fit, table) < FALSE_MISFIT


def largest_difference(fit: Fit, table: Fit) -> float:
    """Largest difference in the mean mu of a cell between a fit and a table."""
    return float(np.abs(fit.cell_coefficients - table.cell_coefficients).max())


def criteria_note(scores: Sequence[Score]) -> str:
    """Note if the independent samples are too few to compare the models by AIC and BIC; else empty."""
    if all(score.independent >= _LEAST_BY_PARAMETER * len(score.fit.parameters) for score in scores):
        return ""
    return message("too few samples", independent=scores[0].independent)


def _bin_errors(fit: Fit, cells: Cells) -> tuple[Floats, Floats]:
    index = np.minimum((cells.slip * BINS).astype(np.int64), BINS - 1)
    n = np.bincount(index, cells.count, minlength=BINS)
    full = n > 0
    error = np.bincount(index, cells.count * (cells.mu - fit.cell_coefficients), minlength=BINS)
    slip = np.bincount(index, cells.count * cells.slip, minlength=BINS)
    return slip[full] / n[full], np.abs(error[full] / n[full])


# --- peak slip, its uncertainty, and the reference slip --------------------------------------------------------------

QUANTILE = 1.959963984540054  #: half width of a normal 95 % interval in standard errors, used for the peak

LARGEST_LOSS = 0.02  #: largest share of the peak adhesion that a reference slip loses because the peak is uncertain

# Largest ratio of reference slip to peak slip: a slip 25 % above the reference slip, the default tolerance of an
# envelope, does not pass the peak, where the slip pole changes sign.
OFF_THE_PEAK = 0.8

_UNKNOWN = (math.nan, math.nan)
_LOWEST_SLIP = 1e-5  # slip ratio; a law with a peak at a lower slip is assumed to fall from slip 0
_STEP = 0.1  # difference step for the peak's derivatives, in standard errors, or sizes of a coordinate if less
_PEAK_POINTS = 2000  # slips among which a table's peak is searched, 0.3 % apart
_UNRESOLVED = 0.25  # of the distance between knots: resolution of the spline's peak
_NEAR_PEAK = 2.0  # ratio of slips; knots within this ratio of the peak give the spline's error at the peak
_SAME_SLIP = 1e-4  # relative tolerance of equal peak slips: root of the error of mu, 1e-8, at a flat maximum
_LEAST_STEP = 1e-5  # least relative difference step; for smaller steps the peak's rounding error, 1e-8, dominates


@dataclass(frozen=True)
class PeakSlip:
    """Adhesion peak at a `speed`, m/s, on a `rail`: slip ratio and mu with 95 % intervals, and the reference slip.

    If a formula does not fit better than a table, the intervals contain those of the table's peak. The reference slip
    is the larger of two slips, but at most `OFF_THE_PEAK` times the peak slip: the lower end of the peak's 99 %
    interval, and the slip at which adhesion is lower than at the peak by the share `LARGEST_LOSS`.
    """

    speed: float
    rail: Rail
    slip: float  # NaN for a law without peak
    slip_interval: tuple[float, float]  # 95 %
    coefficient: float  # mu at the peak
    coefficient_interval: tuple[float, float]  # 95 %
    reference: float = math.nan
    reference_coefficient: float = math.nan  # mu at the reference slip
    by_rule: bool = False  # converted from dry to wet rail by the rule of the law; the intervals are then NaN
    extrapolated: bool = False  # `speed` is outside the initial speeds of the log

    @property
    def slip_stderr(self) -> float:
        return max(abs(end - self.slip) for end in self.slip_interval) / QUANTILE  # of the longer side

    @property
    def coefficient_stderr(self) -> float:
        return max(abs(end - self.coefficient) for end in self.coefficient_interval) / QUANTILE

    @property
    def lowest_slip(self) -> float:
        # of the 99 % interval
        return self.slip - NORMAL_QUANTILE / QUANTILE * (self.slip - self.slip_interval[0])

    @property
    def basis(self) -> str:
        source = "rule" if self.by_rule else "log"
        return f"{source}, extrapolated" if self.extrapolated else source


def peak_of_law(law: AdhesionLaw, speed: float, wheel_load: float) -> PeakSlip:
    """Adhesion peak, without uncertainty, of a law at a speed in m/s and a wheel load in N."""
    top = peak(law, speed, wheel_load)
    value = np.array([top.slip, top.coefficient])
    return _with_reference(law, speed, wheel_load, value, np.stack([value, value], axis=1))


def peak_of_fit(fit: Fit, speed: float, wheel_load: float, rail: Rail, *, widest: Floats | None = None) -> PeakSlip:
    """Adhesion peak of a fitted model with its intervals, at a speed in m/s and a wheel load in N, on a rail.

    `widest`, (2, 2), has the ends (low, high) of an interval of slip and of an interval of mu, each divided by the
    value at the peak; the result contains these intervals. InputError for dry rail if the log is from wet rail.
    """

    def at(model: FitModel, values: np.ndarray) -> tuple[float, float]:
        top = peak(model.make_force_law(values, fit.law.rail).on(rail), speed, wheel_load)
        return top.slip, top.coefficient

    law = fit.model.make_force_law(fit.values, fit.law.rail).on(rail)
    value = np.array(at(fit.model, fit.values))
    if fit.model.name == "table":
        intervals = table_intervals(fit)
    else:
        intervals = value[:, None] + QUANTILE * np.outer(_stderrs(at, fit), (-1.0, 1.0))
    if widest is not None:
        least, most = (value[:, None] * widest).T
        intervals = np.stack([np.fmin(intervals[:, 0], least), np.fmax(intervals[:, 1], most)], axis=1)
    result = _with_reference(law, speed, wheel_load, value, intervals)
    if rail is fit.law.rail:
        return result
    return replace(result, slip_interval=_UNKNOWN, coefficient_interval=_UNKNOWN, by_rule=True)


def drift(
    fit: Fit,
    speeds: Sequence[float],
    wheel_load: float,
    *,
    shown: tuple[float, float] = (0.0, math.inf),
    widest: Floats | None = None,
) -> tuple[PeakSlip, ...]:
    """Adhesion peaks at several speeds (m/s) and a wheel load (N), on the rail of the log and on wet rail.

    `shown` are the lowest and highest initial speed of the log, m/s; peaks at other speeds are marked as extrapolated.
    `widest` is as in `peak_of_fit`.
    """
    rails = dict.fromkeys((fit.law.rail, Rail.WET))
    peaks = [peak_of_fit(fit, speed, wheel_load, rail, widest=widest) for rail in rails for speed in speeds]
    return tuple(replace(peak, extrapolated=not shown[0] <= peak.speed <= shown[1]) for peak in peaks)


def peak_notes(peaks: Sequence[PeakSlip], model: str, shown: tuple[float, float]) -> tuple[str, ...]:
    """Notes on peaks that are extrapolated or converted from dry to wet rail; `shown` is as in `drift`."""
    notes = []
    if any(peak.extrapolated for peak in peaks):
        low, high = (f"{speed / KMH:.4g}" for speed in shown)
        own = f"{high} km/h" if low == high else f"{low} to {high} km/h"
        notes.append(message("extrapolated", own=own))
    ruled = [peak for peak in peaks if peak.by_rule]
    if ruled:
        notes.append(message("wet by rule", model=model))
    slips = {(peak.speed, peak.by_rule): peak.slip for peak in peaks}
    if ruled and all(math.isclose(slips[p.speed, False], p.slip, rel_tol=_SAME_SLIP) for p in ruled):
        notes.append(message("one factor", model=model))
    return tuple(notes)


def _stderrs(at: Callable[[FitModel, np.ndarray], tuple[float, float]], fit: Fit) -> tuple[float, float]:
    coordinates, covariance = fit.estimate.coordinates, fit.estimate.coordinate_covariance
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


def table_intervals(table: Fit) -> Floats:
    """95 % intervals of slip and mu at the peak of a fitted table: ((low, high), (low, high)).

    A slip belongs to the interval if the highest mu exceeds the mu at this slip by at most the error of the difference,
    including the error of the spline between the knots.
    """
    knots, noise = table.model.knots, np.diag(table.covariance)
    slip = np.geomspace(knots[0], knots[-1], _PEAK_POINTS)
    weights = spline(knots, np.eye(len(knots)))(slip)
    mu = weights @ table.values
    top = int(np.argmax(mu))
    misfit = 0.0
    if table.coarse is not None:
        near = np.abs(np.log(knots / slip[top])) <= math.log(_NEAR_PEAK)
        # with half as many knots the values have half the variance, so the difference has the other half
        squares = (table.coarse - table.values)[near] ** 2 - np.nan_to_num(noise[near]) / 2.0
        misfit = math.sqrt(max(float(squares.mean()), 0.0)) if near.any() else math.inf
    unknown = np.diag(np.where(np.isnan(noise), mu[top] ** 2, 0.0))  # variance of values that are not identifiable
    covariance = np.nan_to_num(table.covariance) + unknown

    def error(of: Floats) -> Floats:
        return np.asarray(QUANTILE * np.sqrt(np.einsum("ij,jk,ik->i", of, covariance, of)) + misfit)

    within = np.flatnonzero((mu[top] - mu <= error(weights - weights[top])) | (mu == mu[top]))
    half = float(error(weights[top : top + 1])[0])
    ends = slip[within[[0, -1]]]
    unresolved = _UNRESOLVED * np.interp(ends, knots[1:], np.diff(knots))
    intervals = np.array([ends + unresolved * [-1.0, 1.0], mu[top] + [-half, half]])
    if within[-1] == len(slip) - 1:
        intervals[:, 1] = math.inf
    return intervals


def _with_reference(law: AdhesionLaw, speed: float, wheel_load: float, value: Floats, intervals: Floats) -> PeakSlip:
    slip, coefficient = value.tolist()
    (low, high), (least, most) = np.maximum(intervals, 0.0).tolist()
    if slip <= _LOWEST_SLIP:
        return PeakSlip(speed, law.rail, math.nan, _UNKNOWN, coefficient, (least, most))
    without_reference = PeakSlip(speed, law.rail, slip, (low, high), coefficient, (least, most))
    lowest = _rising_slip(law, speed, wheel_load, slip, (1.0 - LARGEST_LOSS) * coefficient)
    if lowest <= _LOWEST_SLIP:
        return without_reference
    below = without_reference.lowest_slip if math.isfinite(without_reference.lowest_slip) else -math.inf
    reference = min(max(below, lowest), OFF_THE_PEAK * slip)
    mu_at_reference = float(adhesion_coefficient(law, speed, reference, wheel_load))
    return replace(without_reference, reference=reference, reference_coefficient=mu_at_reference)


def _rising_slip(law: AdhesionLaw, speed: float, wheel_load: float, top: float, coefficient: float) -> float:
    from scipy.optimize import brentq

    if float(adhesion_coefficient(law, speed, _LOWEST_SLIP, wheel_load)) >= coefficient:
        return _LOWEST_SLIP
    root = brentq(
        lambda slip: float(adhesion_coefficient(law, speed, slip, wheel_load)) - coefficient, _LOWEST_SLIP, top
    )
    return float(root)


# --- parameters over the initial speed: [Park2008] (30)-(32) ---------------------------------------------------------

HIGHEST_DEGREE = 2  #: highest degree of the polynomials, as in (30)-(32)

_IMPROBABLE = 0.01  # significance level for a warning about a misfit

_SAME_SPEED = 0.01  # relative difference below which initial speeds are regarded as equal


@dataclass(frozen=True)
class ParameterPolynomial:
    """A parameter, SI, as a polynomial of the initial speed v0 in km/h: the sum of coefficients[k] v0^k."""

    name: str
    coefficients: Floats
    covariance: Floats
    speeds_kmh: Floats
    values: Floats  # fitted in the logs
    misfit_probability: float  # p-value of a chi-squared test; NaN if it is not possible

    @property
    def misses(self) -> str:
        """Warning if the polynomial does not agree with `values` within their errors; else empty."""
        if not self.misfit_probability < _IMPROBABLE:
            return ""
        return message("misses", name=self.name, probability=self.misfit_probability)

    @property
    def stderrs(self) -> Floats:
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def stderr_at(self, speed_kmh: float) -> float:
        powers = speed_kmh ** np.arange(len(self.coefficients))
        return float(np.sqrt(powers @ self.covariance @ powers))

    def at(self, speed_kmh: float) -> float:
        return float(np.polynomial.polynomial.polyval(speed_kmh, self.coefficients))


def over_initial_speed(initial_speeds: Sequence[float], fits: Sequence[Fit]) -> tuple[ParameterPolynomial, ...]:
    """Fit polynomials of v0 to each parameter of a model, weighted by the standard errors if all values have one.

    `initial_speeds` is in m/s. The degree is 2, or lower if there are fewer than three distinct speeds. If the
    confidence interval of a parameter in a log has no upper end, this log is not used for this parameter.
    """
    v0 = np.array(initial_speeds) / KMH
    degree = _degree(v0)
    polynomials = []
    for i, name in enumerate(fits[0].model.names):
        values = np.array([fit.parameters[i].value for fit in fits])
        # an infinite standard error means that the interval has no upper end
        own = (fit.parameters[i] for fit in fits)
        stderrs = np.array([math.inf if math.isnan(p.stderr) and math.isinf(p.interval[1]) else p.stderr for p in own])
        coefficients, covariance = _weighted(v0, values, stderrs, degree)
        misfit = _misfit_probability(coefficients, v0, values, stderrs)
        polynomials.append(ParameterPolynomial(name, coefficients, covariance, v0, values, misfit))
    return tuple(polynomials)


def _misfit_probability(coefficients: Floats, v0: Floats, values: Floats, stderrs: Floats) -> float:
    from scipy.stats import chi2

    known = np.isfinite(stderrs) & (stderrs > 0.0)
    freedom = int(known.sum()) - len(coefficients)
    if freedom < 1:
        return math.nan
    error = (values - np.polynomial.polynomial.polyval(v0, coefficients)) / np.where(known, stderrs, 1.0)
    return float(chi2.sf(np.sum(error[known] ** 2), freedom))


def known_polynomials(initial_speeds: Sequence[float], fits: Sequence[Fit]) -> dict[str, Floats]:
    """Polynomial coefficients, by name, of parameters that were not fitted; see `over_initial_speed`."""
    v0 = np.array(initial_speeds) / KMH
    model = fits[0].model
    coefficients = {}
    for name in model.law.parameter_names():
        values = [fit.model.known.get(name) for fit in fits]
        numbers = np.array([value for value in values if isinstance(value, float)])
        if name not in model.names and len(numbers) == len(fits):
            constant = bool(np.all(numbers == numbers[0]))
            unknown = np.full(len(v0), np.nan)
            coefficients[name] = numbers[:1] if constant else _weighted(v0, numbers, unknown, _degree(v0))[0]
    return coefficients


def _degree(v0: Floats) -> int:
    distinct = 1 + int(np.sum(np.diff(np.sort(v0)) > _SAME_SPEED * np.sort(v0)[1:]))
    return min(HIGHEST_DEGREE, distinct - 1)


def _weighted(v0: Floats, values: Floats, stderrs: Floats, degree: int) -> tuple[Floats, Floats]:
    finite = np.isfinite(stderrs)
    if finite.any() and (stderrs > 0.0).all() and not finite.all():
        coefficients, covariance = _weighted(v0[finite], values[finite], stderrs[finite], _degree(v0[finite]))
        missing = degree + 1 - len(coefficients)
        return np.pad(coefficients, (0, missing)), np.pad(covariance, (0, missing))
    known = bool(finite.all() and (stderrs > 0.0).all())
    weights = 1.0 / stderrs if known else np.ones_like(values)
    unit = v0.max()  # scaling v0 to at most 1 gives columns of similar size
    powers = np.vander(v0 / unit, degree + 1, increasing=True)
    root = np.linalg.pinv(weights[:, None] * powers)
    scale = unit ** -np.arange(degree + 1.0)
    covariance = (root @ root.T) * np.outer(scale, scale) if known else np.full((degree + 1, degree + 1), np.nan)
    return root @ (weights * values) * scale, covariance
