"""Parameters over the initial speed, as polynomials, from logs at several speeds: [Park2008] (30)-(32)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.units import KMH

from .fits import Fit, Parameter

Floats = NDArray[np.float64]

HIGHEST_DEGREE = 2
"""As in (30)-(32)."""

_IMPROBABLE = 0.01  # a misfit told

_SAME_SPEED = 0.01  # relative: initial speeds nearer than this are one


@dataclass(frozen=True)
class ParameterPolynomial:
    """A parameter over the initial speed v0 in km/h: the sum of coefficients[k] v0^k, SI.

    Attributes
    ----------
    name : str
    coefficients : array, (degree + 1,)
    covariance : array, (degree + 1, degree + 1)
        Of the coefficients; NaN where the standard errors of the fits are.
    speeds_kmh, values : array, (logs,)
        What it goes through, or near.
    misfit_probability : float
        Of the values being as far from it as they are, or farther, by their standard errors alone (chi-squared); NaN
        where it goes through all of them, or a standard error is not known.
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
        return (
            f"{self.name}: the polynomial passes the logs' values by more than their errors allow; errors as large "
            f"come about with probability {self.misfit_probability:.1g}"
        )

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
        stderrs = np.array([_stderr(fit.parameters[i]) for fit in fits])
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


def _stderr(p: Parameter) -> float:
    """Infinite for a parameter that rests where there is no end."""
    return math.inf if math.isnan(p.stderr) and math.isinf(p.interval[1]) else p.stderr


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
