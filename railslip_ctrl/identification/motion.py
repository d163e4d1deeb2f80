"""A fit to the cells, fitted again along the motion: its errors, its intervals, the ramp of its peak."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.errors import InputError, RailslipError
from railslip_ctrl.model.adhesion.curve import SLIP_ACCELERATION
from railslip_ctrl.model.numeric import peak
from railslip_ctrl.model.vehicle import Vehicle

from .between_runs import whole_tests
from .cells import Cells, Stretches
from .estimates import estimate, slopes_of
from .fits import Fit, long_run_variance, refitted
from .models import FitModel, Setting
from .prediction import DYNAMIC, STATIC, Along, Intervals, enough
from .record import Record

Floats = NDArray[np.float64]

_STRETCH = 10.0  # intervals: the shortest stretch over which the errors are summed
_ALPHA_FACTORS = (0.2, 1.0)  # slip that runs away lets the stiffness seem larger than it is, so the search starts below
_FAR_BELOW = 1 / 3  # of the slip that a ramp is looked at up to
_RAMP_RANGE = 2.0  # the peak is told for ramps slower and steeper by this factor


def is_followed(model: FitModel, record: Record) -> bool:
    """Whether a model is fitted along the motion: not every one is, and not along a short record."""
    return model.name in (*STATIC, *DYNAMIC) and enough(record)


def along_the_motion(
    found: Fit, record: Record, vehicle: Vehicle, cells: Cells, setting: Setting, *, profiles: bool = True
) -> Fit:
    """A fit to the cells, fitted again along the motion; as it was where `is_followed` says no.

    `profiles` as of `fits.fit`. InputError for a log whose wheel the model cannot follow.
    """
    if not is_followed(found.model, record):
        return found
    try:
        return _along(found, record, vehicle, cells, setting, profiles)
    except RailslipError:
        raise
    except ValueError as error:  # SciPy's and LAPACK's word for errors that are not finite
        raise InputError(
            "the model cannot follow the wheel of this log; check units, the wheel's radius and inertia (--vehicle)"
        ) from error


def _along(found: Fit, record: Record, vehicle: Vehicle, cells: Cells, setting: Setting, profiles: bool) -> Fit:
    model = found.model
    problem = Along(model, record, vehicle, setting.wheel_load)
    factors = _ALPHA_FACTORS if model.name in DYNAMIC and "alpha" in model.names else (1.0,)
    starts = [np.array([f if name == "alpha" else 1.0 for name in model.names]) * found.values for f in factors]
    x, errors = problem.solve(starts)
    slopes = slopes_of(problem, x)
    variance, freedom = _inflation(problem.intervals, errors, len(x))
    i, shifts = problem.intervals, problem.discretisation(x, slopes)
    tests = whole_tests(i.time, i.step, i.run)
    known = estimate(problem, x, slopes, variance, freedom, tests=tests, shifts=shifts, profiles=profiles)
    if model.name in STATIC:
        return refitted(found, model, known, cells, setting)
    model, spread = _with_ramp(model, known.values, setting)
    again = refitted(found, model, known, cells, setting, problem.followed(known.values))
    return replace(again, known_stderrs={} if spread is None else {"R": spread})


def _inflation(intervals: Intervals, errors: Floats, parameters: int) -> tuple[float, int]:
    """Long-run variance of the whitened errors, 1 or more where they are not as white as they should be."""
    length = _STRETCH * float(np.median(intervals.step))
    stretch = ((intervals.time - intervals.time[0]) / length).astype(np.int64)
    none = np.zeros(len(errors), dtype=np.int64)
    sums = Stretches(length, stretch, none, np.ones(len(errors)), errors)
    return long_run_variance(np.zeros(1), np.ones(1, dtype=bool), sums, parameters, 0.0)


def slip_ramp(record: Record, radius: float, top: float, initial_speed: float) -> tuple[float, float | None]:
    """Mean slip acceleration R, m/s^2, on the way up to a slip ratio, and its standard deviation from test to test.

    Of the tests that come to it from below, each until it does, by their time; of all, as far as they go, where none
    does. Tests that begin far below go before those that are cut off there, as slip rises the faster the nearer the
    peak. Nought for an empty record; no deviation where fewer than two tests come there.
    """
    slip = 1.0 - radius * record.omega / record.speed
    test = whole_tests(record.time, np.zeros(len(record)), record.run.astype(np.int64))
    cuts = np.flatnonzero(np.diff(test)) + 1
    ways = []
    for time, of_test in zip(np.split(record.time, cuts), np.split(slip, cuts), strict=True):
        if len(time) > 1 and of_test[0] < top:
            up = of_test >= top
            end = int(np.argmax(up)) if up.any() else -1
            gain = initial_speed * (of_test[end] - of_test[0])
            ways.append((time[end] - time[0], gain, float(up.any()), float(of_test[0] < _FAR_BELOW * top)))
    if not ways:
        return 0.0, None
    duration, gain, arrived, whole = np.array(ways).T
    kept = arrived > 0.0 if arrived.any() else np.ones(len(ways), dtype=bool)
    kept = kept & (whole > 0.0) if (kept & (whole > 0.0)).any() else kept
    duration, gain = duration[kept], gain[kept]
    mean = float(gain.sum() / duration.sum())
    if not arrived.any() or len(duration) < 2:
        return mean, None
    scatter = np.sum(duration * (gain / duration - mean) ** 2) / duration.sum() * len(duration) / (len(duration) - 1)
    return mean, float(np.sqrt(scatter))


def _with_ramp(model: FitModel, values: Floats, setting: Setting) -> tuple[FitModel, float | None]:
    """The model whose curve over slip, and so whose peak, is that of a build-up by a ramp, said in its note.

    With it the scatter of the ramp, where the log shows it.
    """
    R, source, spread = setting.given_acceleration, "as given", None
    if R is None:
        R, source, spread = setting.slip_acceleration, "the log's mean up to its peak", setting.acceleration_spread
    if R is None:
        R, source, spread = SLIP_ACCELERATION, "the default", None

    def at(ramp: float) -> tuple[FitModel, float]:
        trial = replace(model, known={**model.known, "R": ramp})
        law = trial.make_force_law(values, setting.rail)
        return trial, peak(law, setting.initial_speed, setting.wheel_load).slip

    chosen, slip = at(R)
    low, high = (at(ramp)[1] for ramp in (R / _RAMP_RANGE, R * _RAMP_RANGE))
    if spread is None:
        counted = "beside which its standard error is of alpha, beta and gamma alone"
    else:
        counted = f"and its standard error counts the ramp's scatter from run to run, {spread:.2g} m/s^2"
    note = (
        "fitted, and compared, along the slip as it went; the peak depends on how fast the slip rises, and is that of "
        f"a ramp of {R:.4g} m/s^2 ({source}; --slip-acceleration changes it): slip {slip:.4g}, {low:.4g} at half and "
        f"{high:.4g} at twice that ramp, {counted}"
    )
    return replace(chosen, notes=(note,)), spread
