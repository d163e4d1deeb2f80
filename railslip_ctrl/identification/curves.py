"""From a log to its adhesion curve, and all that is to be said of the log before anything is fitted."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.model.vehicle import Vehicle

from .alignment import Alignment, corrections_told
from .cells import Accumulator, Bins, Cells, SlipCounts, Stretches
from .columns import Column
from .logs import Broken, Log
from .observed import LEAST_PULL, SLIP_RANGE, AdhesionStream, Observed
from .options import Options
from .outliers import OutlierFilter
from .plausibility import HIGHEST_MU, deceleration_ratio, deceleration_warning, mu_warning, unit_hint
from .record import MOST_ROWS, Record
from .regimes import peak_slip
from .resolution import ColumnStep, column_steps, step_warnings
from .rolling import Known, Rolling, rolling_fault, rolling_warnings
from .rows import BothSpeeds, Rows
from .stamps import StampFilter
from .survey import Survey, load_warning, vehicle_load_warning, wheel_speeds_warning
from .timing import time_fault

Floats = NDArray[np.float64]

_LEAST_SAMPLES = 20


@dataclass(frozen=True)
class Curve:
    """What was taken from a log before anything is fitted.

    Attributes
    ----------
    name : str
        The file.
    survey : Survey
    time_constant : float
        tau, s.
    bins, cells, stretches, slip_counts : Bins, Cells, Stretches, SlipCounts
    record : Record
        Rows for the fits along the motion.
    record_stride : int
        Of how many runs one is in the record.
    peak_slip : float
        Where the data's own mu is highest, of which noise tells a part on a flat top: searches for a fit start there.
    wheel_column : str
        The quantity that the wheel's speed was read from.
    deceleration_ratio : float
        Of the train's, to that which the wheel's adhesion and the resistance make; NaN where it is not known.
    rolling : Rolling or None
        What the wheel showed without brake; None where it was never so.
    steps : tuple of ColumnStep
        In which columns come.
    factors : mapping
        What one of the unit that a column was read in is in SI, by quantity.
    broken_lines, outliers : int
        Lines that were no rows; rows left out as outliers, those of time among them.
    warnings, notes : tuple of str
        What was wrong with the log; what was assumed.
    """

    name: str
    survey: Survey
    time_constant: float
    bins: Bins
    cells: Cells
    stretches: Stretches
    slip_counts: SlipCounts
    record: Record
    record_stride: int
    peak_slip: float
    wheel_column: str
    deceleration_ratio: float
    rolling: Rolling | None
    steps: tuple[ColumnStep, ...]
    factors: Mapping[str, float]
    broken_lines: int
    outliers: int
    warnings: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def highest_mu(self) -> float:
        """Highest mean of mu in a bin."""
        return float(self.bins.mean.max())

    @property
    def followed_note(self) -> str:
        """Which rows the fits along the motion are of, where that is not every row under brake; else empty."""
        if self.record_stride == 1:
            return ""
        return (
            f"{len(self.record)}: fits along the motion take {MOST_ROWS} rows at most, in whole runs spread evenly "
            f"over the log, here one run of {self.record_stride}; the observed curve and the fits to it are of all rows"
        )


def read_curve(
    path: Path,
    vehicle: Vehicle,
    options: Options,
    *,
    progress: Callable[[float], None] | None = None,
    observed: Callable[[Observed], None] | None = None,
) -> Curve:
    """The adhesion curve of a log; memory does not grow with it.

    `progress` is told the share read, `observed` is given the samples as they come.
    InputError with one line for a log that cannot be used.
    """
    log = Log(path, columns=options.columns, units=options.units, block_bytes=options.block_bytes)

    def told() -> Iterator[Rows]:
        for rows in log.rows():
            yield rows
            if progress is not None:
                progress(log.share)
        if progress is not None:
            progress(log.share)

    try:
        gathered = _Gathered(log.name, vehicle, options, told(), log.columns, observed)
    except InputError as error:  # what was assumed may be what is wrong
        raise InputError("; ".join([str(error), *log.notes])) from None
    return gathered.curve(log.broken, log.stamps, log.notes)


def curve_of(rows: Rows, vehicle: Vehicle, options: Options, *, name: str = "log") -> Curve:
    """The adhesion curve of rows in memory, time growing from row to row. InputError as `read_curve`."""
    return _Gathered(name, vehicle, options, iter([rows]), {}).curve(Broken(), StampFilter(name), ())


class _Gathered:
    """What is gathered from the rows of a log, and what it shows; InputError where there is nothing to use."""

    def __init__(
        self,
        name: str,
        vehicle: Vehicle,
        options: Options,
        blocks: Iterator[Rows],
        columns: Mapping[str, Column],
        observed: Callable[[Observed], None] | None = None,
    ) -> None:
        self._name, self._vehicle, self._options = name, vehicle, options
        self._columns = columns
        self._factors = {"brake_torque": 1.0, **{name: column.factor for name, column in columns.items()}}
        self._outliers, self._speeds = OutlierFilter(), BothSpeeds()
        self._stream = AdhesionStream(vehicle, time_constant=options.time_constant, observer=options.observer)
        sums: Accumulator | None = None
        for rows in Alignment(options.delays, options.zeros, name).rows(_kept(blocks, self._outliers)):
            self._speeds.add(rows)
            samples = self._stream.add(rows)
            if observed is not None:
                observed(samples)
            sums = sums or (Accumulator(self._stream.time_constant) if len(rows) else None)
            if sums is not None:
                sums.add(samples)
        self._check(sums)
        assert sums is not None
        self._sums = sums

    def _check(self, sums: Accumulator | None) -> None:
        survey, low_high = self._stream.survey, "{:g} and {:g}".format(*SLIP_RANGE)
        clock = time_fault(self._stream.recorder.record(), self._vehicle, survey.highest_pull)
        if clock is not None:
            raise InputError(f"{self._name}: {clock}")
        try:
            self._stream.check(self._name)
            if sums is None or survey.used < _LEAST_SAMPLES:
                raise InputError(
                    f"{self._name}: {survey.used} of {survey.rows} rows are under brake with slip between {low_high}; "
                    "give a log with braking, and check columns, units, --vehicle and the wheel's radius"
                )
        except InputError as error:  # a wheel that does not follow its train may be the cause
            given = corrections_told(self._options.delays, self._options.zeros)
            told = [str(error), *given, *self._torque_told(), *rolling_warnings(self._rolling(), self._known())]
            raise InputError("; ".join(told)) from None
        wheel = rolling_fault(self._rolling(), self._known())
        if wheel is not None:
            raise InputError(f"{self._name}: {wheel}")

    def _torque_told(self) -> tuple[str, ...]:
        """What is to be said of torques that are all below what counts as braking, or of a unit that they may have."""
        pull = self._stream.survey.highest_pull
        hint = unit_hint(pull, self._factors)
        if pull > HIGHEST_MU:
            return (hint,) if hint else ()
        if not 0.0 < pull < LEAST_PULL:
            return ()
        text = f"the highest brake torque is {pull:.2g} of wheel load times radius, where a brake has {LEAST_PULL:g}"
        return (f"{text} or more; {hint}" if hint else f"{text} or more",)

    def _rolling(self) -> Rolling | None:
        resolution, radius = self._outliers.resolution, self._vehicle.wheel.radius
        omega_step = max(resolution["wheel_angular_speed"], resolution["wheel_speed"] / radius)
        return self._stream.free.found(speed_step=resolution["train_speed"], omega_step=omega_step)

    def _known(self, slope: float = math.inf, peak: float = 0.0) -> Known:
        return Known(self._vehicle, slope, peak, self._stream.wheel_column, self._options.zeros)

    def curve(self, broken: Broken, stamps: StampFilter, notes: tuple[str, ...]) -> Curve:
        """The curve, with what else was met."""
        cells, bins, survey = self._sums.cells(), self._sums.bins(), self._stream.survey
        peak, record = peak_slip(cells), self._stream.recorder.record()
        radius, rolling = self._vehicle.wheel.radius, self._rolling()
        steps = column_steps(self._outliers.resolution, self._columns, radius, survey.initial_speed, survey.wheel_load)
        strange, loads = mu_warning(bins.mean, self._factors), load_warning(record)
        far, ratio = vehicle_load_warning(record, self._vehicle.wheel_load), deceleration_ratio(record, self._vehicle)
        speeds = wheel_speeds_warning(self._speeds.ratio(self._vehicle.wheel.radius), "wheel speed")
        free = rolling_warnings(self._rolling(), self._known(float(bins.mean[0] / bins.slip[0]), peak))
        slows = None if free else deceleration_warning(ratio)  # else the cause is told
        found = (
            *self._warnings(broken, stamps),
            *free,
            *step_warnings(steps),
            *(text for text in (loads, far, speeds, strange, slows) if text is not None),
        )
        return Curve(
            name=self._name,
            survey=survey,
            time_constant=self._stream.time_constant,
            bins=bins,
            cells=cells,
            stretches=self._sums.stretches(),
            slip_counts=self._sums.slip_counts(),
            record=record,
            record_stride=self._stream.recorder.stride,
            peak_slip=peak,
            wheel_column=self._stream.wheel_column,
            deceleration_ratio=ratio,
            rolling=rolling,
            steps=steps,
            factors=self._factors,
            broken_lines=broken.count,
            outliers=self._outliers.count + stamps.count,
            warnings=tuple(f"{self._name}: {text}" for text in found),
            notes=notes,
        )

    def _warnings(self, broken: Broken, stamps: StampFilter) -> tuple[str, ...]:
        found, outliers = [*broken.first], self._outliers
        if broken.count > len(broken.first):
            found.append(f"{broken.count} broken lines in all, the last line {broken.last}; every other line is used")
        found += stamps.warnings
        if outliers.count:
            rows = "1 row" if outliers.count == 1 else f"{outliers.count} rows"
            found.append(f"{rows} with outliers left out, the first in line {outliers.first_line}")
        return (*found, *self._stream.survey.warnings())


def _kept(blocks: Iterator[Rows], outliers: OutlierFilter) -> Iterator[Rows]:
    """The rows without the outliers."""
    for rows in blocks:
        yield outliers.add(rows)
    rest = outliers.finish()
    if rest is not None:
        yield rest
