"""The job: a log, or several, to adhesion curve, fits and the slip to hold, as records."""

from __future__ import annotations

import filecmp
import itertools
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.errors import DomainError, InputError
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion import ReferenceSlip
from railslip_ctrl.model.vehicle import Rail, Vehicle

from .candidates import DRIFT_SPEEDS, Candidates, fit_doubts, lag_of, lag_warning, speeds_looked_at
from .cleaning import check_corrections
from .curves import Cells
from .curves import Curve as Curve
from .curves import Options as Options
from .curves import curve_of as curve_of
from .curves import read_curve as read_curve
from .fits import Fit
from .log_checks import LOADS_DIFFER, TrainLag, deceleration_differs, is_wrong_wheel, train_lag
from .models import CANDIDATES, Setting, check_model, check_options
from .observed import Observed
from .prediction import slip_ramp
from .results import (
    ParameterPolynomial,
    PeakSlip,
    Regimes,
    Score,
    compare,
    drift,
    over_initial_speed,
    peak_notes,
    regimes_of,
)

Floats = NDArray[np.float64]


_LINE_POINTS = 200
_RAMP_SLIP = 0.05  # the ramp is looked at up to here at least, where the peak is lower
_OTHER_SPEED = 1.25  # ratio of a speed that is given to the log's: a log may begin after the brake was applied
_OTHER_RAMP = 3.0  # ratio of a ramp that is given to the log's: runs of one log differ by less
_LEAST_RAMP = 0.05  # m/s^2: slower than this, slip is held, not ramped


@dataclass(frozen=True)
class ModelLine:
    """A fitted model's mu over slip, at the mean speed that the log has at each slip."""

    name: str
    slip: Floats
    mu: Floats


@dataclass(frozen=True)
class Identification:
    """A log identified.

    Attributes
    ----------
    vehicle : Vehicle
    options : Options
    curve : Curve
    setting : Setting
    scores : tuple of Score
        All models fitted, the lowest BIC first.
    chosen : Score
        The model asked for, or the first that is not the table.
    not_fitted : tuple of str
        Models left out of the comparison, and why.
    peaks : tuple of PeakSlip
        Over speed, on the log's rail and on wet rail.
    regimes : Regimes
        Parted at the chosen model's peak, where the log goes past it.
    reference : ReferenceSlip or None
        Slips to hold at the initial speed; None without a peak.
    lines : tuple of ModelLine
        The models' curves, in the order of `scores`.
    warnings : tuple of str
        What was wrong with the log, and what the fits show to be.
    doubts : tuple of str
        What is not to be believed of the model chosen.
    train_lag : TrainLag or None
        What a lag of the train's speed would do; None where the log does not tell.
    """

    vehicle: Vehicle
    options: Options
    curve: Curve
    setting: Setting
    scores: tuple[Score, ...]
    chosen: Score
    not_fitted: tuple[str, ...]
    peaks: tuple[PeakSlip, ...]
    regimes: Regimes
    reference: ReferenceSlip | None
    lines: tuple[ModelLine, ...]
    warnings: tuple[str, ...]
    doubts: tuple[str, ...] = ()
    train_lag: TrainLag | None = None

    @property
    def speeds_shown(self) -> tuple[float, float]:
        """The lowest and the highest v0 that the log stands for, m/s: of one that begins at many speeds all of them."""
        return speeds_shown(self.curve, self.setting)

    @property
    def own_peak(self) -> PeakSlip:
        """At the initial speed, on the log's own rail."""
        return _own_peak(self.peaks, self.setting)

    @property
    def no_reference(self) -> str | None:
        """Why there is no slip to hold; None where there is one."""
        if self.reference is not None:
            return None
        seen = float(self.curve.cells.slip.max())
        if self.own_peak.slip > seen:
            return (
                f"the slip of this log goes up to {seen:.3g}, and the model's peak lies beyond; give a log that goes "
                "past the peak"
            )
        return "this model falls from the start, or nearly so; take the slip to hold from another model"

    @property
    def peak_notes(self) -> tuple[str, ...]:
        """What of the peaks is not from the log, a sentence each."""
        return peak_notes(self.peaks, self.chosen.fit.model.name, self.speeds_shown)


def speeds_shown(curve: Curve, setting: Setting) -> tuple[float, float]:
    """As `Identification.speeds_shown`."""
    v0, survey = setting.initial_speed, curve.survey
    return (min(survey.slowest_start, v0) if survey.is_mixed else v0), v0


def identify(
    path: Path,
    vehicle: Vehicle,
    options: Options,
    *,
    progress: Callable[[float], None] | None = None,
    observed: Callable[[Observed], None] | None = None,
) -> Identification:
    """Identify a log: its curve, fits of the models asked for, their comparison, and the slip to hold.

    Parameters
    ----------
    path : Path
        The CSV, as `railslip identify --help` says.
    vehicle : Vehicle
        Its wheel and load, SI.
    options : Options
        The rest.
    progress : callable, optional
        Told the share that is read, a ratio of 0 to 1.
    observed : callable, optional
        Given the observed samples as they come, SI.

    Returns
    -------
    Identification
        In SI.

    Raises
    ------
    InputError
        A log or an option that cannot be used, in one line.
    """
    _model_names(options)  # before a large log is read
    curve = read_curve(path, vehicle, options, progress=progress, observed=observed)
    return identify_curve(curve, vehicle, options)


def _model_names(options: Options) -> tuple[str, ...]:
    names = CANDIDATES if options.model == "best" else (options.model,)
    check_model(options.model)
    check_options(names, options.fixed, options.bounds)
    check_corrections(options.delays, options.zeros)
    return names


def identify_curve(curve: Curve, vehicle: Vehicle, options: Options) -> Identification:
    """Identify from an adhesion curve that is read already. InputError as `identify`."""
    names = _model_names(options)
    setting = setting_of(curve, vehicle, options)
    candidates = Candidates(curve, vehicle, setting)
    found = candidates.fitted(names)
    if not found.fits:
        raise InputError("; ".join([*_wheel_told(curve), found.failures[0]]))
    scores, chosen, peaks, without = _chosen(compare(found.fits, curve.cells), candidates)
    regimes = regimes_of(_own_peak(peaks, setting).slip, chosen.fit.model.name, curve.cells, candidates.regimes)
    return Identification(
        vehicle=vehicle,
        options=options,
        curve=curve,
        setting=setting,
        scores=scores,
        chosen=chosen,
        not_fitted=(*found.failures, *without),
        peaks=peaks,
        regimes=regimes,
        reference=_reference(peaks, setting.rail),
        lines=tuple(_line(score.fit, curve.cells, setting) for score in scores),
        warnings=(
            *curve.warnings,
            *_against_the_log(curve, setting, options),
            *_late(chosen.fit, candidates, options),
            *_left_out(found.impossible, curve),
        ),
        doubts=_doubts(chosen, curve, setting),
        train_lag=train_lag(curve.record, vehicle.wheel.radius, regimes.boundary),
    )


def _chosen(
    scores: tuple[Score, ...], candidates: Candidates
) -> tuple[tuple[Score, ...], Score, tuple[PeakSlip, ...], tuple[str, ...]]:
    """The scores, the first of them that is not the table, its peaks; and why models before it had none.

    The table follows any curve: it shows what a formula leaves, and is taken where it is asked for. InputError where no
    model has a peak.
    """
    failures: list[str] = []
    curve, setting = candidates.curve, candidates.setting
    for score in sorted(scores, key=lambda each: each.fit.model.name == "table"):
        with_intervals = replace(score, fit=candidates.with_intervals(score.fit))
        try:
            peaks = _peaks(with_intervals, setting, curve)
        except DomainError as error:
            failures.append(f"{curve.name}: {score.fit.model.name}: {error}")
            scores = tuple(each for each in scores if each is not score)
        else:
            scores = tuple(with_intervals if each is score else each for each in scores)
            return scores, with_intervals, peaks, tuple(failures)
    raise InputError("; ".join([*_wheel_told(curve), failures[0]]))


def _against_the_log(curve: Curve, setting: Setting, options: Options) -> tuple[str, ...]:
    """A sentence for each value that is given and that the log shows to be another."""
    found, seen, v0 = [], curve.survey.initial_speed, setting.initial_speed
    if options.initial_speed is not None and not 1.0 / _OTHER_SPEED < v0 / seen < _OTHER_SPEED:
        found.append(
            f"--initial-speed is {v0 / KMH:.4g} km/h, and the highest train speed of the log {seen / KMH:.4g} km/h: "
            "the model is written as one of the speed that is given"
        )
    given, ramp = options.slip_acceleration, setting.slip_acceleration
    if given is not None and ramp is not None and not 1.0 / _OTHER_RAMP < given / ramp < _OTHER_RAMP:
        found.append(
            f"--slip-acceleration is {given:.4g} m/s^2, and the slip of the log rises by {ramp:.4g} m/s^2 on its way "
            "to the peak: the peak of a bristle model is that of the ramp that is given"
        )
    return tuple(f"{curve.name}: {text}" for text in found)


def _left_out(impossible: Sequence[str], curve: Curve) -> tuple[str, ...]:
    """A sentence where models were left out for adhesion that cannot be: what did that may be wrong of the others."""
    if not impossible:
        return ()
    return (
        f"{curve.name}: {', '.join(impossible)}: left out, as fitted to this log their adhesion cannot be; unless "
        "it has too little slip for them, the brake torque's unit (--unit), wheel load or vehicle (--vehicle) is wrong",
    )


def _doubts(score: Score, curve: Curve, setting: Setting) -> tuple[str, ...]:
    found = fit_doubts(score.fit, setting, speeds_looked_at(setting), curve.highest_mu, curve.factors)
    return tuple(f"{curve.name}: {text}" for text in found)


def _late(fit: Fit, candidates: Candidates, options: Options) -> tuple[str, ...]:
    """A sentence where the motion shows that the columns are out of step; not where something else is amiss first.

    One v0 that stands for several, and a wheel of quite another radius, are no motion that can be followed.
    """
    curve, load = candidates.curve, candidates.setting.wheel_load
    if curve.survey.is_mixed or is_wrong_wheel(curve.rolling):
        return ()
    lag = lag_of(fit, curve.record, candidates.vehicle, load)
    if lag is None:
        return ()
    if deceleration_differs(curve.deceleration_ratio):
        return (
            f"{curve.name}: the wheel's motion is followed best with its speed shifted by {lag.seconds:.3g} s, which "
            "a torque of the wrong scale, or a wrong vehicle, makes too: no --delay is advised while the train's "
            "deceleration does not fit",
        )
    better = candidates.better_followed(fit) if options.model != "best" else fit
    if better is not fit and lag_of(better, curve.record, candidates.vehicle, load) is None:
        return (
            f"{curve.name}: {fit.model.name} follows the wheel's motion best with its speed shifted by "
            f"{lag.seconds:.3g} s, which {better.model.name}, a better fit, does not: the law is not that of the log, "
            "and no column is late",
        )
    return (f"{curve.name}: {lag_warning(lag, curve.survey.interval, curve.wheel_column, options.delays)}",)


def _wheel_told(curve: Curve) -> tuple[str, ...]:
    """What was said of a wheel that does not follow its train, as the cause of what fails."""
    return tuple(f"{curve.name}: {each.text}" for each in curve.findings if each.check == "free rolling")


def _peaks(score: Score, setting: Setting, curve: Curve) -> tuple[PeakSlip, ...]:
    """The peaks over speed; a peak beyond all slip of the log is the formula's alone, and no slip to hold."""
    speeds = [share * setting.initial_speed for share in DRIFT_SPEEDS]
    peaks = drift(score.fit, speeds, setting.wheel_load, shown=speeds_shown(curve, setting))
    seen = float(curve.cells.slip.max())
    return tuple(peak.without_reference() if peak.slip > seen else peak for peak in peaks)


def _line(fit: Fit, cells: Cells, setting: Setting) -> ModelLine:
    order = np.argsort(cells.slip)
    slip = np.linspace(math.sqrt(cells.slip[order[0]]), math.sqrt(cells.slip[order[-1]]), _LINE_POINTS) ** 2
    if fit.followed is not None:
        return ModelLine(fit.model.name, slip, np.interp(slip, *fit.followed))
    speed = np.interp(slip, cells.slip[order], cells.speed[order])
    return ModelLine(fit.model.name, slip, fit.model.coefficient(fit.values, slip, speed, setting.wheel_load))


def setting_of(curve: Curve, vehicle: Vehicle, options: Options) -> Setting:
    """What the fits take as known: the wheel load, v0 and the ramp of the log, unless they are given."""
    v0 = curve.survey.initial_speed if options.initial_speed is None else options.initial_speed
    ramp, spread = slip_ramp(curve.record, vehicle.wheel.radius, max(curve.peak_slip, _RAMP_SLIP), v0)
    ramped = ramp >= _LEAST_RAMP
    return Setting(
        wheel_load=curve.survey.wheel_load,
        initial_speed=v0,
        slip_acceleration=ramp if ramped else None,
        given_acceleration=options.slip_acceleration,
        rail=options.rail,
        fixed=options.fixed,
        bounds=options.bounds,
        acceleration_spread=spread if ramped else None,
    )


def _own_peak(peaks: Sequence[PeakSlip], setting: Setting) -> PeakSlip:
    return [each for each in peaks if each.rail is setting.rail][-1]


def _reference(peaks: Sequence[PeakSlip], rail: Rail) -> ReferenceSlip | None:
    """The slips to hold at the initial speed, the last of each rail; of a wet log both are the wet one."""
    held = {peak.rail: peak.reference for peak in peaks}
    dry, wet = held.get(rail, math.nan), held[Rail.WET]
    return ReferenceSlip(dry=dry, wet=wet) if math.isfinite(dry) and math.isfinite(wet) else None


@dataclass(frozen=True)
class Campaign:
    """Several logs identified with one model, and its parameters over the initial speed.

    `warnings` are of the logs together, beside those that each has.
    """

    logs: tuple[Identification, ...]
    polynomials: tuple[ParameterPolynomial, ...]
    warnings: tuple[str, ...] = ()


def identify_several(
    paths: Sequence[Path], vehicle: Vehicle, options: Options, *, progress: Callable[[float], None] | None = None
) -> Campaign:
    """Identify logs at several initial speeds, `paths`, with one model; of "best", the one with the lowest sum of BIC.

    `vehicle`, `options`, `progress` and InputError as of `identify`.
    """
    whole = [path.resolve() for path in paths]
    for i, path in enumerate(whole):
        if path in whole[:i]:
            raise InputError(
                f"LOG.csv: {paths[i]} is given twice; give each log once, as each counts as a test of its own"
            )
    for first, second in itertools.combinations([path for path in paths if path.is_file()], 2):
        if first.stat().st_size == second.stat().st_size and filecmp.cmp(first, second, shallow=False):
            raise InputError(f"LOG.csv: {second} is a copy of {first}; give each log once, as each counts as a test")
    done = []
    for i, path in enumerate(paths):
        share = None if progress is None else (lambda x, i=i: progress((i + x) / len(paths)))
        done.append(identify(path, vehicle, options, progress=share))
    if options.model == "best":
        done = _with_one_model(done)
    fits = [each.chosen.fit for each in done]
    return Campaign(
        logs=tuple(done),
        polynomials=over_initial_speed([each.setting.initial_speed for each in done], fits),
        warnings=_different_loads(done),
    )


def _different_loads(done: Sequence[Identification]) -> tuple[str, ...]:
    """A sentence where the logs' mean wheel loads are not one."""
    loads = {each.curve.name: each.setting.wheel_load for each in done}
    least, most = min(loads, key=lambda name: loads[name]), max(loads, key=lambda name: loads[name])
    if loads[least] * LOADS_DIFFER >= loads[most]:
        return ()
    mean = sum(each.setting.wheel_load for each in done) / len(done)
    return (
        f"the logs' wheel loads lie between {loads[least]:.4g} N ({least}) and {loads[most]:.4g} N ({most}): what "
        f"changes with the load is taken to change with v0, and model.toml is of their mean, {mean:.4g} N; give logs "
        "of one load",
    )


def _with_one_model(done: Sequence[Identification]) -> list[Identification]:
    totals: dict[str, float] = {}
    for score in done[0].scores:
        name = score.fit.model.name
        same = [s for each in done for s in each.scores if s.fit.model.name == name]
        if len(same) == len(done) and name != "table":  # the knots of tables differ from log to log
            totals[name] = sum(s.bic for s in same)
    if not totals:
        raise InputError("model: no model fits every log; name one with --model")
    for best in sorted(totals, key=lambda name: totals[name]):
        with suppress(DomainError):  # of a model that has no peak in one of the logs
            return [_choosing(each, best) for each in done]
    raise InputError("model: no model has a peak in every log; name one with --model")


def _choosing(identification: Identification, name: str) -> Identification:
    if identification.chosen.fit.model.name == name:
        return identification
    curve, setting = identification.curve, identification.setting
    candidates = Candidates(curve, identification.vehicle, setting, identification.regimes)
    score = next(s for s in identification.scores if s.fit.model.name == name)
    chosen = replace(score, fit=candidates.with_intervals(score.fit))
    peaks = _peaks(chosen, setting, curve)
    return replace(
        identification,
        scores=tuple(chosen if each is score else each for each in identification.scores),
        chosen=chosen,
        peaks=peaks,
        regimes=regimes_of(_own_peak(peaks, setting).slip, name, curve.cells, identification.regimes),
        reference=_reference(peaks, setting.rail),
        doubts=_doubts(chosen, curve, setting),
    )
