"""Least squares over all samples by way of their cells, with intervals that know how few of them are independent."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.model.adhesion import AdhesionLaw

from .cells import Cells, Stretches
from .coordinates import Coordinates
from .estimates import CONFIDENCE as CONFIDENCE
from .estimates import NORMAL_QUANTILE as NORMAL_QUANTILE
from .estimates import SINGULAR, Estimate, estimate, slopes_of
from .models import SLIDING_ALONE, FitModel, Setting
from .search import search

Floats = NDArray[np.float64]

_LEAST_FREEDOM = 5  # a variance with less is too uncertain to be preferred to that of shorter stretches

_CONVERGED = 1e-14
_SEARCH = 300  # evaluations at most of the residuals and their slopes
_NOTHING = 1e-9  # of a value: a lower end below it says nothing
_ALIKE = 1e-9  # relative: two searches whose sums of squares agree so ended in one place, and no third is needed
_INSIDE = 1e-6  # of a coordinate's size: how far inside its bounds a search begins


@dataclass(frozen=True)
class Parameter:
    """A fitted parameter, SI.

    `stderr` is the half width of its 99 % interval over 2.576, so that it holds the uncertainty of the noise level
    too; NaN where the parameter is not identified or rests on a bound. `status` is "fitted", "at lower bound",
    "at upper bound" or "not identifiable". `limits` is the interval from the profile of the likelihood, where the
    symmetric one would not hold: beside a bound, and where the data hardly show the parameter; it may have no end. A
    symmetric one that reaches beyond a bound ends there.
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

    @property
    def is_untold(self) -> bool:
        """Whether the log agrees with any value, so that this one is of the search."""
        return _is_open(self) and self.interval[0] < _NOTHING * self.value


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
        Of the fitted values, as `Estimate.covariance`.
    coordinates : Coordinates
    coordinate_covariance : array, (p, p)
        Of the coordinates of the search, in which a step of some standard errors is as good as linear.
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
    known_stderrs : mapping
        Standard deviations of parameters of the curve that are known from elsewhere, by name.
    with_profiles : bool
        Whether intervals were taken from the profile of the likelihood where the symmetric ones do not hold.
    """

    model: FitModel
    law: AdhesionLaw
    parameters: tuple[Parameter, ...]
    covariance: Floats
    coordinates: Coordinates
    coordinate_covariance: Floats
    residual_squares: float
    cell_coefficients: Floats
    long_run_variance: float
    degrees_of_freedom: int
    notes: tuple[str, ...]
    followed: Floats | None = None
    known_stderrs: Mapping[str, float] = field(default_factory=dict)
    with_profiles: bool = True

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


def fit(
    model: FitModel,
    cells: Cells,
    stretches: Stretches,
    setting: Setting,
    sliding_from: float,
    tau: float,
    *,
    profiles: bool = True,
) -> Fit:
    """Fit a model to the cells: the sum over all samples of (mu - model)^2 is made least, within the bounds.

    `sliding_from` is the slip ratio where sliding begins, for the models of it alone; `tau` is the observer's time
    constant, s. Without `profiles` every interval is the symmetric one, which will do where the motion is followed
    afterwards.

    Raises
    ------
    InputError
        Fewer cells than parameters.
    """
    used = cells.slip >= sliding_from if model.name in SLIDING_ALONE else np.ones(len(cells.slip), dtype=bool)
    if used.sum() <= len(model.names):
        raise InputError(
            f"model: {used.sum()} distinct slips are too few for the {len(model.names)} parameters of {model.name!r}; "
            "give a log with more slip"
        )
    problem = _Problem(model, cells, used)
    x = problem.solve()
    mean, spread = in_cells(model, problem.coordinates.values(x), cells)
    variance, freedom = long_run_variance(mean, used, stretches, len(x), tau)
    known = estimate(problem, x, slopes_of(problem, x), variance, freedom, profiles=profiles)
    parameters = _parameters(model, known)
    return Fit(
        model=model,
        law=model.make(known.values, setting.rail),
        parameters=parameters,
        covariance=known.covariance,
        coordinates=known.coordinates,
        coordinate_covariance=known.coordinate_covariance,
        residual_squares=_residual_squares(cells, mean, spread),
        cell_coefficients=mean,
        long_run_variance=variance,
        degrees_of_freedom=freedom,
        notes=(*model.notes, *_remarks(parameters, variance)),
    )


def refitted(
    found: Fit, model: FitModel, known: Estimate, cells: Cells, setting: Setting, followed: Floats | None = None
) -> Fit:
    """A fit with other values: what follows from them, anew; the noise over the cells stays as it was found."""
    mean, spread = in_cells(model, known.values, cells)
    if followed is not None:
        mean = np.interp(cells.slip, *followed)
    parameters = _parameters(model, known)
    return replace(
        found,
        model=model,
        law=model.make(known.values, setting.rail),
        parameters=parameters,
        covariance=known.covariance,
        coordinates=known.coordinates,
        coordinate_covariance=known.coordinate_covariance,
        residual_squares=_residual_squares(cells, mean, spread),
        cell_coefficients=mean,
        notes=(*model.notes, *_remarks(parameters, found.long_run_variance)),
        followed=followed,
    )


def _parameters(model: FitModel, known: Estimate) -> tuple[Parameter, ...]:
    stderrs = np.where(known.active == 0, np.sqrt(np.diag(known.covariance)), np.nan)
    return tuple(
        Parameter(
            name,
            float(known.values[i]),
            float(stderrs[i]),
            _status(int(known.active[i]), bool(known.dead[i])),
            known.limits.get(i) or _inside(float(known.values[i]), float(stderrs[i]), model.lower[i], model.upper[i]),
        )
        for i, name in enumerate(model.names)
    )


def _inside(value: float, stderr: float, lower: float, upper: float) -> tuple[float, float] | None:
    """The symmetric interval where a bound cuts it off; None where none does."""
    low, high = value - NORMAL_QUANTILE * stderr, value + NORMAL_QUANTILE * stderr
    return (max(low, float(lower)), min(high, float(upper))) if low < lower or high > upper else None


def _residual_squares(cells: Cells, mean: Floats, spread: Floats) -> float:
    # of the scatter in a cell, that which the model has there too is no residual
    inside = np.maximum(cells.squares - cells.count * spread, 0.0)
    return float(np.sum(inside + cells.count * (cells.mu - mean) ** 2))


def in_cells(model: FitModel, values: Floats, cells: Cells) -> tuple[Floats, Floats]:
    """The model's mean and variance of mu in every cell."""
    mu = model.coefficient(values, cells.nodes, cells.node_speeds, cells.load)
    mean: Floats = np.sum(cells.weights * mu, axis=0)
    return mean, np.sum(cells.weights * (mu - mean) ** 2, axis=0)


class _Problem:
    """The residuals of the cells used, and their solution by SciPy, in coordinates scaled by the start."""

    def __init__(self, model: FitModel, cells: Cells, used: NDArray[np.bool_]) -> None:
        self.model, self.cells, self.used = model, cells, used
        self.coordinates = model.coordinates
        self.root = np.sqrt(cells.count[used])

    def residuals(self, values: Floats) -> Floats:
        """How far the model's mean of mu lies above that of the samples, in the cells used, by root of the samples."""
        c, at = self.cells, self.used
        mu = self.model.coefficient(values, c.nodes[:, at], c.node_speeds[:, at], c.load[at])
        result: Floats = self.root * (np.sum(c.weights[:, at] * mu, axis=0) - c.mu[at])
        return result

    def solve(self) -> Floats:
        """The best of the solutions from all starts, in coordinates; of those that are alike the first."""
        coordinates, found = self.coordinates, []
        weight = SINGULAR * float(np.linalg.norm(self.root * self.cells.mu[self.used]))
        starts = [coordinates.at(start) for start in self.model.starts]
        for start in starts:
            begin = coordinates.inside(start, _INSIDE)
            end = search(
                self.residuals, coordinates, begin, weight=weight, centre=starts[0], tolerance=_CONVERGED, most=_SEARCH
            )
            found.append(end)
            least = min(squares for squares, _ in found)
            alike = [x for squares, x in found if squares <= (1.0 + _ALIKE) * least]
            if len(alike) > 1:
                break
        return alike[0]


def _status(active: int, dead: bool) -> str:
    if dead:
        return "not identifiable"
    return {-1: "at lower bound", 0: "fitted", 1: "at upper bound"}[active]


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
    return f"{text}; by this log it is not {side} than {limit:.4g} (99 %)"


def _is_open(p: Parameter) -> bool:
    return p.status == "fitted" and p.limits is not None and math.isinf(p.limits[1])


def _without_end(p: Parameter) -> str:
    if p.is_untold:
        return f"{p.name}: this log cannot tell it"
    return f"{p.name}: by this log it is not less than {p.interval[0]:.4g} (99 %), and has no upper end"


def _remarks(parameters: tuple[Parameter, ...], variance: float) -> tuple[str, ...]:
    remarks = []
    dead = [p.name for p in parameters if p.status == "not identifiable"]
    if dead:
        remarks.append(
            f"{', '.join(dead)}: not identifiable from this log, as the curve stays the same when "
            f"{'it changes' if len(dead) == 1 else 'they change together'}"
        )
    remarks += [_at_bound(p) for p in parameters if "bound" in p.status]
    remarks += [_without_end(p) for p in parameters if _is_open(p)]
    loose = [p.name for p in parameters if p.stderr > abs(p.value) and not _is_open(p)]
    if loose:
        remarks.append(f"{', '.join(loose)}: hardly identified, standard error larger than the value")
    if math.isnan(variance) and all(math.isnan(p.stderr) for p in parameters):
        remarks.append("too few independent stretches of data for standard errors")
    return tuple(remarks)
