"""A fit to the cells, fitted again along the motion: its errors, its intervals beside bounds, the ramp of its peak."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.adhesion.curve import SLIP_ACCELERATION
from railslip_ctrl.numeric import peak
from railslip_ctrl.parameters import Vehicle

from .cells import Cells, Stretches
from .fits import CONFIDENCE, Fit, covariance_of, long_run_variance, refitted, unidentified
from .models import FitModel, Setting
from .prediction import DYNAMIC, STATIC, Along, Intervals, sizes
from .profile import profile_interval
from .record import Record

Floats = NDArray[np.float64]

_STRETCH = 10.0  # intervals: the shortest stretch over which the errors are summed
_ALPHA_FACTORS = (0.2, 1.0)  # slip that runs away lets the stiffness seem larger than it is, so the search starts below
_AT_BOUND = 0.1  # of a standard error: a parameter nearer to its bound rests on it
_NEAR_BOUND = 1.0  # and nearer than this the likelihood is cut off where a symmetric interval would still count on it
_RAMP_RANGE = 2.0  # the peak is told for ramps slower and steeper by this factor


def along_the_motion(found: Fit, record: Record, vehicle: Vehicle, cells: Cells, setting: Setting) -> Fit:
    """A fit to the cells, fitted again along the motion; as it was for other models and too short a record."""
    model = found.model
    if model.name not in (*STATIC, *DYNAMIC):
        return found
    problem = Along(model, record, vehicle, setting.wheel_load)
    if not problem.enough:
        return found
    factors = _ALPHA_FACTORS if model.name in DYNAMIC and "alpha" in model.names else (1.0,)
    scaled = np.array([[f if name == "alpha" else 1.0 for name in model.names] for f in factors])
    values, errors = problem.solve(found.values * scaled)
    jacobian = problem.jacobian(values)
    dead = unidentified(jacobian * sizes(values, model))
    variance, freedom = _inflation(problem.intervals, errors, int((~dead).sum()))
    covariance = covariance_of(jacobian, ~dead, variance, freedom)
    stderrs = np.sqrt(np.diag(covariance))
    active = _bounds_at(values, model, _AT_BOUND * stderrs)
    limits = {}
    if _bounds_at(values, model, _NEAR_BOUND * stderrs).any():
        limits = _limits(problem, values, stderrs, variance, freedom)
    # what the steps of the integration shift counts as an error of its own
    shift = np.where(dead, 0.0, problem.discretisation(values, jacobian))
    covariance = covariance + np.outer(shift, shift)
    followed = None
    if model.name in DYNAMIC:
        model, followed = _with_ramp(model, values, setting), problem.followed(values)
    return refitted(found, model, values, covariance, active, dead, cells, setting, followed, limits)


def _bounds_at(values: Floats, model: FitModel, distance: Floats) -> NDArray[np.int_]:
    """Which bound each parameter is no further from than a distance: -1 the lower, 1 the upper, 0 none."""
    return np.where(values - model.lower <= distance, -1, np.where(model.upper - values <= distance, 1, 0))


def _limits(
    problem: Along, values: Floats, stderrs: Floats, variance: float, freedom: int
) -> dict[int, tuple[float, float]]:
    """Intervals from the profile of the likelihood, for every parameter that has a standard error."""
    from scipy.stats import t as student

    rise = variance * float(student.ppf(0.5 + CONFIDENCE / 2.0, freedom)) ** 2
    model = problem.model
    size, found = sizes(values, model), {}
    for i in (int(each) for each in np.flatnonzero(np.isfinite(stderrs))):
        found[i] = profile_interval(
            problem.residuals, values, model.lower, model.upper, i, size=size, stderr=float(stderrs[i]), rise=rise
        )
    return found


def _inflation(intervals: Intervals, errors: Floats, parameters: int) -> tuple[float, int]:
    """Long-run variance of the whitened errors, 1 or more where they are not as white as they should be."""
    length = _STRETCH * float(np.median(intervals.step))
    stretch = ((intervals.time - intervals.time[0]) / length).astype(np.int64)
    none = np.zeros(len(errors), dtype=np.int64)
    sums = Stretches(length, stretch, none, np.ones(len(errors)), errors)
    return long_run_variance(np.zeros(1), np.ones(1, dtype=bool), sums, parameters, 0.0)


def _with_ramp(model: FitModel, values: Floats, setting: Setting) -> FitModel:
    """The model whose curve over slip, and so whose peak, is that of a build-up by a ramp that is said in its note."""
    R, source = setting.given_acceleration, "as given"
    if R is None:
        R, source = setting.slip_acceleration, "the log's mean up to its peak"
    if R is None:
        R, source = SLIP_ACCELERATION, "the default"

    def at(ramp: float) -> tuple[FitModel, float]:
        trial = replace(model, known={**model.known, "R": ramp})
        law = trial.make_force_law(values, setting.rail)
        return trial, peak(law, setting.initial_speed, setting.wheel_load).slip

    chosen, slip = at(R)
    low, high = (at(ramp)[1] for ramp in (R / _RAMP_RANGE, R * _RAMP_RANGE))
    note = (
        "fitted, and compared, along the slip as it went; the peak depends on how fast the slip rises, and is that of "
        f"a ramp of {R:.4g} m/s^2 ({source}; --slip-acceleration changes it): slip {slip:.4g}, {low:.4g} at half and "
        f"{high:.4g} at twice that ramp, beside which its standard error is of alpha, beta and gamma alone"
    )
    return replace(chosen, notes=(note,))
