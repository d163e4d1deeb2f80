"""Least squares over all samples by way of their cells, with intervals that know how few of them are independent."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.adhesion import AdhesionLaw
from railslip_ctrl.errors import InputError

from .cells import Cells, Stretches
from .models import FitModel, Setting

Floats = NDArray[np.float64]

CONFIDENCE = 0.99
"""Of the intervals given."""

NORMAL_QUANTILE = 2.5758293035489004
"""Half width of a normal 99 % interval in standard errors."""

_LEAST_FREEDOM = 5  # a variance with less is too uncertain to be preferred to that of shorter stretches

# Singular values of the scaled Jacobian below this share of the largest: a direction in which the parameters can
# move without the curve following. Differences of numbers of 1e-16, over steps of 1e-5 of a parameter, leave 1e-10.
_SINGULAR = 1e-8

_CONVERGED = 1e-14
_ALIKE = 1e-9  # relative: two searches whose sums of squares agree so ended in one place, and no third is needed
_AT_BOUND = 1e-6  # of a parameter's size: the search stays inside its bounds and only tends to them


@dataclass(frozen=True)
class Parameter:
    """A fitted parameter, SI.

    `stderr` is the half width of its 99 % interval over 2.576, so that it holds the uncertainty of the noise level
    too; NaN where the parameter is not identified or rests on a bound. `status` is "fitted", "at lower bound",
    "at upper bound" or "not identifiable". `limits` is the interval from the profile of the likelihood, where a bound
    is so near that the symmetric one would not hold.
    """

    name: str
    value: float
    stderr: float
    status: str
    limits: tuple[float, float] | None = None

    @property
    def interval(self) -> tuple[float, float]:
        """The 99 % interval."""
        if self.limits is not None:
            return self.limits
        half = NORMAL_QUANTILE * self.stderr
        return self.value - half, self.value + half


@dataclass(frozen=True)
class Fit:
    """A model fitted.

    Attributes
    ----------
    model : FitModel
    law : AdhesionLaw
        With the fitted parameters.
    parameters : tuple of Parameter
    covariance : array, (p, p)
        Of the fitted values, scaled as `Parameter.stderr`; rows of parameters that are not identified are NaN. One
        that the search along the motion left on a bound has a row: the others are not as sure as if it were known.
    residual_squares : float
        Sum of the squared deviations of all samples from the model.
    cell_coefficients : array
        The model's mean mu of each cell.
    long_run_variance : float
        Of the noise: the variance of a mean over n samples is this over n. NaN where it cannot be had.
    degrees_of_freedom : int
        Of the long-run variance.
    notes : tuple of str
    followed : array, (2, k), or None
        Slip ratio and mu as a dynamic model had them along the log's motion; None for a model that is a curve.
    """

    model: FitModel
    law: AdhesionLaw
    parameters: tuple[Parameter, ...]
    covariance: Floats
    residual_squares: float
    cell_coefficients: Floats
    long_run_variance: float
    degrees_of_freedom: int
    notes: tuple[str, ...]
    followed: Floats | None = None

    @property
    def values(self) -> Floats:
        """The fitted values."""
        return np.array([p.value for p in self.parameters])

    @property
    def correlation(self) -> Floats:
        """Correlation of the estimates, NaN as in `covariance`."""
        deviation = np.sqrt(np.diag(self.covariance))
        result: Floats = self.covariance / np.outer(deviation, deviation)
        return result


def fit(model: FitModel, cells: Cells, stretches: Stretches, setting: Setting, peak_slip: float, tau: float) -> Fit:
    """Fit a model to the cells: the sum over all samples of (mu - model)^2 is made least, within the bounds.

    `peak_slip` parts the regimes, for models of sliding alone; `tau` is the observer's time constant, s.

    Raises
    ------
    InputError
        Fewer cells than parameters.
    """
    used = cells.slip >= peak_slip if model.sliding_only else np.ones(len(cells.slip), dtype=bool)
    if used.sum() <= len(model.names):
        raise InputError(
            f"model: {used.sum()} distinct slips are too few for the {len(model.names)} parameters of {model.name!r}; "
            "give a log with more slip"
        )
    problem = _Problem(model, cells, used, setting.wheel_load)
    values, scale = problem.solve()
    active = active_bounds(values, model, scale)
    mean, spread = in_cells(model, values, cells, setting.wheel_load)
    jacobian = problem.jacobian(values)
    dead = np.zeros(len(values), dtype=bool)
    dead[active == 0] = unidentified((jacobian * scale)[:, active == 0])
    free = ~dead & (active == 0)
    variance, freedom = long_run_variance(mean, used, stretches, int(free.sum()), tau)
    covariance = covariance_of(jacobian, free, variance, freedom)
    parameters = _parameters(model, values, covariance, active, dead)
    return Fit(
        model=model,
        law=model.make(values, setting.rail),
        parameters=parameters,
        covariance=covariance,
        residual_squares=_residual_squares(cells, mean, spread),
        cell_coefficients=mean,
        long_run_variance=variance,
        degrees_of_freedom=freedom,
        notes=(*model.notes, *_remarks(parameters, variance)),
    )


def refitted(
    found: Fit,
    model: FitModel,
    values: Floats,
    covariance: Floats,
    active: NDArray[np.int_],
    dead: NDArray[np.bool_],
    cells: Cells,
    setting: Setting,
    followed: Floats | None = None,
    limits: Mapping[int, tuple[float, float]] = MappingProxyType({}),
) -> Fit:
    """A fit with other values: what follows from them, anew; the noise over the cells stays as it was found."""
    mean, spread = in_cells(model, values, cells, setting.wheel_load)
    if followed is not None:
        mean = np.interp(cells.slip, *followed)
    parameters = _parameters(model, values, covariance, active, dead, limits)
    return replace(
        found,
        model=model,
        law=model.make(values, setting.rail),
        parameters=parameters,
        covariance=covariance,
        residual_squares=_residual_squares(cells, mean, spread),
        cell_coefficients=mean,
        notes=(*model.notes, *_remarks(parameters, found.long_run_variance)),
        followed=followed,
    )


def _parameters(
    model: FitModel,
    values: Floats,
    covariance: Floats,
    active: NDArray[np.int_],
    dead: NDArray[np.bool_],
    limits: Mapping[int, tuple[float, float]] = MappingProxyType({}),
) -> tuple[Parameter, ...]:
    stderrs = np.where(active == 0, np.sqrt(np.diag(covariance)), np.nan)
    return tuple(
        Parameter(name, float(value), float(stderrs[i]), _status(int(active[i]), bool(dead[i])), limits.get(i))
        for i, (name, value) in enumerate(zip(model.names, values, strict=True))
    )


def _residual_squares(cells: Cells, mean: Floats, spread: Floats) -> float:
    # of the scatter in a cell, that which the model has there too is no residual
    inside = np.maximum(cells.squares - cells.count * spread, 0.0)
    return float(np.sum(inside + cells.count * (cells.mu - mean) ** 2))


def in_cells(model: FitModel, values: Floats, cells: Cells, wheel_load: float) -> tuple[Floats, Floats]:
    """The model's mean and variance of mu in every cell."""
    mu = model.coefficient(values, cells.nodes, cells.node_speeds, wheel_load)
    mean: Floats = np.sum(cells.weights * mu, axis=0)
    return mean, np.sum(cells.weights * (mu - mean) ** 2, axis=0)


class _Problem:
    """The residuals of the cells used, and their solution by SciPy, in parameters scaled by the start."""

    def __init__(self, model: FitModel, cells: Cells, used: NDArray[np.bool_], wheel_load: float) -> None:
        self.model, self.cells, self.used, self.load = model, cells, used, wheel_load
        self.root = np.sqrt(cells.count[used])

    def means(self, values: Floats) -> Floats:
        """The model's mean of mu in the cells used."""
        c, at = self.cells, self.used
        mu = self.model.coefficient(values, c.nodes[:, at], c.node_speeds[:, at], self.load)
        result: Floats = np.sum(c.weights[:, at] * mu, axis=0)
        return result

    def solve(self) -> tuple[Floats, Floats]:
        """The best of the solutions from all starts, and the size of its parameters."""
        from scipy.optimize import least_squares

        model, best = self.model, None
        for start in model.starts:
            scale = np.maximum(np.abs(start), 1e-9)
            inside = np.clip(start, model.lower + 1e-6 * scale, model.upper - 1e-6 * scale)
            found = least_squares(
                lambda x, scale=scale: self.root * (self.means(x * scale) - self.cells.mu[self.used]),
                inside / scale,
                jac="3-point",
                bounds=(model.lower / scale, model.upper / scale),
                x_scale="jac",
                ftol=_CONVERGED,
                xtol=_CONVERGED,
                gtol=_CONVERGED,
                max_nfev=300,
            )
            alike = best is not None and abs(found.cost - best[0]) <= _ALIKE * best[0]
            if best is None or found.cost < best[0]:
                best = found.cost, found.x * scale, np.maximum(scale, np.abs(found.x * scale))
            if alike:
                break
        assert best is not None
        return best[1], best[2]

    def jacobian(self, values: Floats) -> Floats:
        """Derivatives of the residuals by the parameters, (cells used, parameters), by central differences."""
        columns = []
        for i, value in enumerate(values):
            step = 1e-5 * max(abs(value), 1e-9)
            high, low = values.copy(), values.copy()
            high[i], low[i] = min(value + step, self.model.upper[i]), max(value - step, self.model.lower[i])
            columns.append(self.root * (self.means(high) - self.means(low)) / (high[i] - low[i]))
        return np.stack(columns, axis=1)


def active_bounds(values: Floats, model: FitModel, scale: Floats) -> NDArray[np.int_]:
    """Which bound each parameter rests on: -1 the lower, 1 the upper, 0 none."""
    low, high = values - model.lower <= _AT_BOUND * scale, model.upper - values <= _AT_BOUND * scale
    return np.where(low, -1, np.where(high, 1, 0))


def unidentified(scaled: Floats) -> NDArray[np.bool_]:
    """Parameters that take part in a direction in which the residuals do not change."""
    if not scaled.size:
        return np.zeros(scaled.shape[1], dtype=bool)
    _, singular, directions = np.linalg.svd(scaled, full_matrices=False)
    flat = singular <= _SINGULAR * singular[0]
    result: NDArray[np.bool_] = (np.abs(directions[flat]) > 1e-3).any(axis=0)
    return result


def _status(active: int, dead: bool) -> str:
    if dead:
        return "not identifiable"
    return {-1: "at lower bound", 0: "fitted", 1: "at upper bound"}[active]


def covariance_of(jacobian: Floats, free: NDArray[np.bool_], variance: float, freedom: int) -> Floats:
    """Long-run variance times the inverse of the normal matrix, widened from Student's quantile to the normal one."""
    from scipy.stats import t as student

    size = jacobian.shape[1]
    covariance = np.full((size, size), np.nan)
    if free.any() and math.isfinite(variance):
        width = float(student.ppf(0.5 + CONFIDENCE / 2.0, freedom)) / NORMAL_QUANTILE
        _, triangle = np.linalg.qr(jacobian[:, free])
        root = np.linalg.inv(triangle)
        covariance[np.ix_(free, free)] = variance * width**2 * (root @ root.T)
    return covariance


def long_run_variance(
    mean: Floats, used: NDArray[np.bool_], stretches: Stretches, parameters: int, tau: float
) -> tuple[float, int]:
    """Variance of sums of the residuals over stretches of time, by sample, and its degrees of freedom.

    The largest over all lengths of stretch that leave some freedom: too short ones do not see scatter from run to run.
    What the correlation through the filter alone takes from a stretch of finite length is given back; `tau` of 0 is
    for residuals that passed no filter.
    """
    entry = used[stretches.cell]
    stretch, length = stretches.stretch[entry], stretches.length
    deviation = stretches.total[entry] - stretches.count[entry] * mean[stretches.cell[entry]]
    count = stretches.count[entry].sum()
    best = (math.nan, 0)
    while True:
        _, place = np.unique(stretch, return_inverse=True)
        sums = np.bincount(place, deviation)
        freedom = len(sums) - parameters
        if freedom < 1 or (freedom < _LEAST_FREEDOM and best[1]):
            return best
        share = 1.0 - tau / length * -math.expm1(-length / tau) if tau > 0.0 else 1.0
        variance = float(np.sum(sums**2)) / count * len(sums) / freedom / share
        if not variance <= best[0]:
            best = variance, freedom
        stretch, length = stretch // 2, 2.0 * length
        if len(sums) < 2:
            return best


def _at_bound(p: Parameter) -> str:
    text = f"{p.name}: rests {p.status.replace('at', 'on its', 1)}"
    if p.limits is None:
        return text
    side, limit = ("more", p.limits[1]) if "lower" in p.status else ("less", p.limits[0])
    return f"{text}; this log cannot tell it, only that it is not {side} than {limit:.4g} (99 %)"


def _remarks(parameters: tuple[Parameter, ...], variance: float) -> tuple[str, ...]:
    remarks = []
    dead = [p.name for p in parameters if p.status == "not identifiable"]
    if dead:
        remarks.append(
            f"{', '.join(dead)}: not identifiable from this log, as the curve stays the same when "
            f"{'it changes' if len(dead) == 1 else 'they change together'}"
        )
    remarks += [_at_bound(p) for p in parameters if "bound" in p.status]
    loose = [p.name for p in parameters if p.stderr > abs(p.value)]
    if loose:
        remarks.append(f"{', '.join(loose)}: hardly identified, standard error larger than the value")
    if math.isnan(variance):
        remarks.append("too few independent stretches of data for standard errors")
    return tuple(remarks)
