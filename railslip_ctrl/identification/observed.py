"""Compute adhesion coefficients from the rows of a log with an observer, and filter the slip like the observer.

The observed torque is delayed and smoothed by the filter 1/(tau s + 1). The slip, its square and its cube pass through
the same filter, so that observed mu and slip belong together. `BrakedRows` are unfiltered rows for prediction-error
fits.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import field, fields
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.arguments import Flags, Floats
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.vehicle import Vehicle

from .logs import Lines, Rows
from .messages import message
from .observer import FilterObserver, Form, KalmanObserver, ObserverState, TorqueObserver

# --- the observer's filter -----------------------------------------------------------------------------------------


class Channels:
    """Filters signals in the same way as an observer filters the adhesion torque."""

    def __init__(self, observer: TorqueObserver) -> None:
        self._observer = observer
        self._states: list[ObserverState] | None = None

    def run(self, time: Floats, channels: Floats) -> Floats:
        """Filter the next samples of all signals, (channels, k); `time`, s, (k,). The filters start in steady state."""
        standstill = np.zeros(len(time))  # without acceleration, the observer filters its brake torque
        before: list[ObserverState] | list[None] = self._states or [None] * len(channels)
        estimates = [self._observer.run(time, u, standstill, x) for u, x in zip(channels, before, strict=True)]
        self._states = [each.state for each in estimates]
        return np.stack([each.adhesion_torque for each in estimates])


_RELEASED = 0.1  # relative fall of the torque within a time constant that indicates a release of the brake


class Readhesion:
    """Detects readhesion: rows in which the slip falls after the brake is released.

    After a release beyond the peak the slip falls to zero faster than the observer follows. These rows are left out:
    the adhesion curve is measured only while the slip grows, as in [Park2008] Fig. 13.
    """

    def __init__(self, low_pass: TorqueObserver) -> None:
        self._once, self._twice = Channels(low_pass), Channels(low_pass)
        self._falls_back = False

    def add(self, time: Floats, slip: Floats, torque: Floats) -> Flags:
        """Return True for each row in readhesion. `time` is in s; `slip` and `torque`, N*m, are unfiltered."""
        # a signal falls if it is lower after one filter than after two filters in series
        now = self._once.run(time, np.stack([slip, torque]))
        fallen = self._twice.run(time, now) - now
        falls = fallen[0] > 0.0
        released = falls & (fallen[1] > _RELEASED * np.maximum(now[1], 0.0))
        index = np.arange(len(time))
        last_released = np.maximum.accumulate(np.where(released, index, -1 if self._falls_back else -2))
        last_held = np.maximum.accumulate(np.where(falls, -2, index))
        readhesion: Flags = last_released > last_held
        self._falls_back = bool(readhesion[-1])
        return readhesion


# --- unfiltered rows -----------------------------------------------------------------------------------------------

MOST_ROWS = 20_000  #: largest number of rows in a record: about a hundred rig tests at 100 rows a second

_LONGEST_RUN = 4096  # rows; longer runs are split, so that one run cannot fill the record


@dataclass(frozen=True)
class BrakedRows:
    """Rows under brake, in runs of consecutive rows without a gap; arrays of equal length."""

    time: Floats  # s
    speed: Floats  # of the train, m/s
    omega: Floats  # of the wheel, rad/s
    torque: Floats  # of the brake, N*m
    load: Floats  # of the wheel, N
    run: Floats  # number of the run

    def __len__(self) -> int:
        return len(self.time)


class Recorder:
    """Records rows under brake, but only one run in every `stride` runs, so that the number of rows is bounded."""

    def __init__(self, most_rows: int = MOST_ROWS) -> None:
        self._most = most_rows
        self.stride = 1
        self._kept = np.empty((6, 0))
        self._run, self._position = -1, 0  # run of the last row used, and the position of this row in the run
        self._last_used = False

    def add(self, rows: Floats, used: Flags, apart: Flags) -> None:
        """Add `rows`, (5, k): time, speed, omega, torque and load, as in `BrakedRows`.

        `used` is true for rows under brake, `apart` for rows that follow a gap.
        """
        if not used.any():
            self._last_used = bool(used[-1]) if used.size else self._last_used
            return
        follows = used & np.concatenate([[self._last_used], used[:-1]]) & ~apart
        index = np.arange(used.size)
        start = np.maximum.accumulate(np.where(used & ~follows, index, -1))
        position = np.where(start >= 0, index - start, self._position + 1 + index)
        begins = used & (~follows | (position % _LONGEST_RUN == 0))
        run = self._run + np.cumsum(begins)
        self._run, self._position, self._last_used = int(run[-1]), int(position[-1]), bool(used[-1])
        keep = used & (run % self.stride == 0)
        self._kept = np.concatenate([self._kept, np.vstack([rows[:, keep], run[keep]])], axis=1)
        while self._kept.shape[1] > self._most and self.stride <= self._run:
            self.stride *= 2
            self._kept = self._kept[:, self._kept[5] % self.stride == 0]

    def record(self) -> BrakedRows:
        return BrakedRows(*self._kept)


# --- statistics of a log -------------------------------------------------------------------------------------------

_MOST_NAMED = 5  # gaps that have a warning of their own
_MIXED = 1.25  # ratio of the runs' initial speeds beyond which a single v0 does not describe them


@dataclass
class Survey:
    """Statistics of the rows of a log; speeds are in m/s, times in s, loads in N."""

    rows: int = 0
    used: int = 0  # rows with an adhesion sample: under brake, with slip and speed in range
    runs: int = 0  # separated by pauses longer than the settling time
    gaps: list[tuple[int, float]] = field(default_factory=list)  # the first gaps, as (line, seconds)
    gap_count: int = 0
    implausible: int = 0  # physically impossible rows
    bridged: int = 0  # long intervals between rows over which the observer continues
    longest_bridged: float = 0.0
    lost: int = 0  # rows under brake within the settling time after a gap or the start
    reversed: int = 0  # rows with slip and a brake torque of the wrong sign
    backward: int = 0  # rows in which the train runs backward at more than 5 km/h
    forward: int = 0  # rows in which the train runs forward at more than 5 km/h
    first_implausible: str = ""  # description of the first impossible row
    initial_speed: float = 0.0  # highest filtered train speed
    interval: float = math.nan  # median interval between the first rows
    slowest_start: float = math.nan  # lowest initial speed of a run
    fastest_start: float = math.nan  # highest initial speed of a run
    load_sum: float = 0.0  # of the rows used
    readhesion: int = 0  # rows left out because the slip falls after a release of the brake
    highest_pull: float = 0.0  # highest magnitude of brake torque over wheel load and radius

    @property
    def wheel_load(self) -> float:
        return self.load_sum / self.used

    @property
    def lost_share(self) -> float:
        return self.lost / max(self.lost + self.used, 1)

    @property
    def is_mixed(self) -> bool:
        return self.slowest_start * _MIXED < self.fastest_start


# --- adhesion over slip --------------------------------------------------------------------------------------------

LOWEST_SPEED = 5.0 * KMH  #: lowest train speed used, m/s, as in the published stop; below it noise dominates the slip

DEFAULT_TIME_CONSTANT = 0.05  #: tau of the observer, s, if the log is sampled fast enough

INTERVALS_PER_TIME_CONSTANT = 5.0  #: least default tau, in intervals of the log

SLIP_RANGE = (0.005, 0.98)  #: slip ratios used: lower ones are dominated by noise, above them the wheel is locked

_GAP_INTERVALS = 5.0  # in median intervals; a longer interval is a gap if it is not bridged

# Intervals up to this many time constants are not gaps. Speeds and torque are assumed linear over them; faster changes
# are mostly beyond the observer's bandwidth.
_BRIDGED = 1.0

_SETTLING = 5.0  # time constants after a start until the unknown initial adhesion torque has an effect below 1 %
LEAST_PULL = 0.02  # of wheel load times radius; with a lower torque the brake is regarded as released

# Physical limits of a row. A wheel far faster than its braked train indicates a wrong unit or column.
_FASTEST = 200.0  # m/s
_LARGEST_TORQUE = 1e6  # N*m
_LIMITS = {"fastest": _FASTEST / KMH, "largest": _LARGEST_TORQUE}  # km/h, N*m, for messages
_LEAST_SLIP = -0.5  # slip ratio under brake
_LEAST_FREE_SLIP = -2.0  # slip ratio without brake
_TOLERATED_SHARE = 0.01  # of the rows; a log with more impossible rows, or rows of the wrong sign, is refused


class Observer(StrEnum):
    """Observers of the adhesion torque.

    - CORRECTED: [Park2008] (27) with every term filtered.
    - PRINTED: [Park2008] (27) as printed, in which the brake torque is not filtered.
    - KALMAN: a Kalman filter that models the adhesion torque as a random walk, with a bandwidth of 1/tau.
    """

    CORRECTED = "corrected"
    PRINTED = "printed"
    KALMAN = "kalman"


@dataclass(frozen=True)
class Observed:
    """Samples of adhesion over slip, SI, arrays of equal length; all except `time` are filtered by the observer.

    `slip2`, `slip3` and `slip_speed` are the filtered products slip^2, slip^3 and slip times train speed.
    """

    time: Floats
    slip: Floats
    slip2: Floats
    slip3: Floats
    speed: Floats
    slip_speed: Floats
    mu: Floats
    load: Floats

    def __len__(self) -> int:
        return len(self.time)

    def where(self, kept: Flags) -> Observed:
        return Observed(*(getattr(self, f.name)[kept] for f in fields(self)))


class AdhesionStream:
    """Computes adhesion samples of a log that arrives in blocks of rows.

    If the log has no wheel load, that of `vehicle` is used. `time_constant` is tau of the `observer`, s; by default the
    longer of 0.05 s and five intervals between rows.
    """

    def __init__(
        self, vehicle: Vehicle, *, time_constant: float | None = None, observer: Observer = Observer.CORRECTED
    ) -> None:
        self.vehicle, self.kind = vehicle, observer
        self.survey = Survey()
        self.recorder = Recorder()
        self.wheel_column = ""
        self._tau = time_constant
        self._observer: TorqueObserver | None = None
        self._state: ObserverState | None = None
        self._channels: Channels | None = None
        self._readhesion: Readhesion | None = None
        self._last = self._settled = -math.inf
        self._last_run = -math.inf

    @property
    def time_constant(self) -> float:
        """Time constant tau of the observer, s; NaN if it is not given and there are no rows yet."""
        return math.nan if self._tau is None else self._tau

    def _begin(self) -> None:
        interval = self.survey.interval
        if self._tau is None:
            self._tau = float(np.fmax(DEFAULT_TIME_CONSTANT, INTERVALS_PER_TIME_CONSTANT * interval))
        tau, J, friction = self._tau, self.vehicle.effective_inertia, self.vehicle.effective_viscous_friction
        if self.kind is not Observer.KALMAN:
            self._observer = FilterObserver(J, friction, tau, Form(self.kind.value))
        else:
            # natural frequency 1/tau, damping 1/sqrt(2); the gains depend only on walk over noise, so the noise is 1
            nominal = tau if math.isnan(interval) else interval
            self._observer = KalmanObserver(J, friction, nominal, 1.0, 0.0, nominal * J**2 / tau**4)

    def add(self, rows: Rows) -> Observed:
        line, signals = self._possible(rows)
        time, v, omega, torque, load = signals
        if not len(time):
            return _joined([])
        if len(time) > 1 and math.isnan(self.survey.interval):
            self.survey.interval = float(np.median(np.diff(time)))
        if self._observer is None:
            self._begin()
        new, apart = self._gaps(line, np.diff(time, prepend=self._last)), np.zeros(len(time), dtype=bool)
        apart[new] = True
        rolling = (v > LOWEST_SPEED) & (self.vehicle.wheel.radius * omega > (1.0 - SLIP_RANGE[1]) * v) & (load > 0.0)
        self.recorder.add(signals, rolling & self._braked(torque, load), apart)
        self.survey.rows += len(time)
        pieces = itertools.pairwise([0, *new, len(time)])
        return _joined([self._stretch(signals[:, a:b], fresh=bool(apart[a])) for a, b in pieces if b > a])

    def check(self, name: str) -> None:
        """Raise InputError if too many rows are physically impossible or cannot be used."""
        survey = self.survey
        if survey.implausible > _TOLERATED_SHARE * (survey.rows + survey.implausible):
            more = f" ({survey.implausible} such rows)" if survey.implausible > 1 else ""
            raise InputError(f"{name}: {survey.first_implausible}{more}; check columns and units")
        if survey.forward < _TOLERATED_SHARE * survey.backward:
            raise InputError(message("speed reversed", name=name, survey=survey))
        if survey.used < _TOLERATED_SHARE * survey.reversed:
            raise InputError(message("torque reversed", name=name, survey=survey))
        if survey.used < _TOLERATED_SHARE * survey.lost:
            of, seconds = survey.used + survey.lost, _SETTLING * self.time_constant
            which = "lost to gaps" if survey.gap_count else "lost to the start"
            raise InputError(message(which, name=name, survey=survey, of=of, seconds=seconds))

    def signals(self, rows: Rows) -> Floats:
        """Signals, (5, k): time (s), train speed (m/s), omega (rad/s), brake torque (N*m), load (N)."""
        radius, angular = self.vehicle.wheel.radius, rows.columns.get("wheel_angular_speed")
        self.wheel_column = "wheel_speed" if angular is None else "wheel_angular_speed"
        omega = rows.columns["wheel_speed"] / radius if angular is None else angular
        load = rows.columns.get("wheel_load", np.full(len(rows), self.vehicle.wheel_load))
        return np.stack([rows.columns["time"], rows.columns["train_speed"], omega, rows.columns["brake_torque"], load])

    def _possible(self, rows: Rows) -> tuple[Lines, Floats]:
        signals, radius = self.signals(rows), self.vehicle.wheel.radius
        _, v, omega, torque, load = signals
        wheel, pressed = radius * omega, load > 0.0
        pull = np.abs(torque[pressed]) / (radius * load[pressed])
        self.survey.backward += int((v < -LOWEST_SPEED).sum())
        self.survey.forward += int((v > LOWEST_SPEED).sum())
        self.survey.highest_pull = max(self.survey.highest_pull, float(pull.max(initial=0.0)))
        # after a release the wheel may overshoot the train speed, because the contact acts as a spring
        least = np.where(self._braked(torque, load), _LEAST_SLIP, _LEAST_FREE_SLIP)
        checks = {
            "train too fast": (np.abs(v) > _FASTEST, v / KMH),
            "wheel too fast": (np.abs(wheel) > _FASTEST, wheel / KMH),
            "torque too large": (np.abs(torque) > _LARGEST_TORQUE, torque),
            "no load": (load <= 0.0, load),
            "wheel ahead": ((v - wheel < least * v) & (v > LOWEST_SPEED), wheel / KMH),
        }
        bad = np.zeros(len(rows), dtype=bool)
        for name, (wrong, value) in checks.items():
            if wrong.any() and not self.survey.first_implausible:
                at = int(np.argmax(wrong))
                self.survey.first_implausible = message(name, line=rows.line[at], value=value[at], **_LIMITS)
            bad |= wrong
        self.survey.implausible += int(bad.sum())
        return rows.line[~bad], signals[:, ~bad]

    def _braked(self, torque: Floats, load: Floats) -> Flags:
        return torque > LEAST_PULL * self.vehicle.wheel.radius * load

    def _gaps(self, line: Lines, steps: Floats) -> NDArray[np.intp]:
        """Return the indices of the rows at which the observer restarts."""
        long = steps > _GAP_INTERVALS * self.survey.interval
        new = np.flatnonzero(long & (steps > _BRIDGED * self.time_constant))
        bridged = steps[long & (steps <= _BRIDGED * self.time_constant)]
        self.survey.bridged += len(bridged)
        self.survey.longest_bridged = max(self.survey.longest_bridged, float(bridged.max(initial=0.0)))
        for i in new:
            if math.isfinite(steps[i]):
                self.survey.gap_count += 1
                if len(self.survey.gaps) < _MOST_NAMED:
                    self.survey.gaps.append((int(line[i]), float(steps[i])))
        return new

    def _stretch(self, signals: Floats, *, fresh: bool) -> Observed:
        assert self._observer is not None
        time, v, omega, torque, load = signals
        radius, survey, (low, high) = self.vehicle.wheel.radius, self.survey, SLIP_RANGE
        if fresh or self._channels is None or self._readhesion is None:
            self._state = None
            low_pass = FilterObserver.of(self.vehicle, self.time_constant)
            self._channels = Channels(self._observer if self.kind is Observer.KALMAN else low_pass)
            self._readhesion = Readhesion(low_pass)
            self._settled = time[0] + _SETTLING * self.time_constant
        estimate = self._observer.run(time, torque, omega, self._state)
        self._state = estimate.state
        now = 1.0 - radius * omega / np.where(v > LOWEST_SPEED, v, np.inf)
        filtered = self._channels.run(time, np.stack([now, now**2, now**3, v, now * v, load]))
        self._last = float(time[-1])
        braked, reverse = self._braked(torque, load), self._braked(-torque, load)
        readhesion = self._readhesion.add(time, now, torque)
        slip, slip2, slip3, speed, slip_speed, pressed = filtered
        sliding = (slip >= low) & (slip <= high) & (speed > LOWEST_SPEED) & (pressed > 0.0)
        settled = time >= self._settled
        used = sliding & settled & braked & ~readhesion
        survey.lost += int((braked & sliding & ~settled).sum())
        survey.reversed += int((reverse & sliding).sum())
        survey.readhesion += int((braked & sliding & settled & readhesion).sum())
        survey.initial_speed = max(survey.initial_speed, float(speed.max()))
        mu = estimate.adhesion_torque / (radius * np.where(pressed > 0.0, pressed, np.inf))
        samples = Observed(time, slip, slip2, slip3, speed, slip_speed, mu, pressed).where(used)
        if len(samples):
            apart = np.diff(samples.time, prepend=self._last_run) > _SETTLING * self.time_constant
            survey.runs += int(apart.sum())
            starts = samples.speed[apart]
            survey.slowest_start = float(np.fmin(survey.slowest_start, starts.min(initial=math.inf)))
            survey.fastest_start = float(np.fmax(survey.fastest_start, starts.max(initial=-math.inf)))
            survey.used += len(samples)
            survey.load_sum += float(samples.load.sum())
            self._last_run = float(samples.time[-1])
        return samples


def _joined(parts: list[Observed]) -> Observed:
    if not parts:
        return Observed(*(np.empty(0) for _ in fields(Observed)))
    return Observed(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Observed)))


# --- one run over time ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TimeHistory:
    """Signals of one run of `BrakedRows`, for a picture; SI, arrays of equal length.

    `time` is 0 in the first row of the run. `wheel_speed` is the speed of the wheel's circumference. The adhesion
    torque is the estimate of the corrected observer, NaN while the observer settles.
    """

    time: Floats
    train_speed: Floats
    wheel_speed: Floats
    brake_torque: Floats
    adhesion_torque: Floats
    slip: Floats


def time_history_of(record: BrakedRows, vehicle: Vehicle, time_constant: float) -> TimeHistory | None:
    """Return the signals of the run with the most rows. The `time_constant`, s, is that of the observer."""
    if not len(record):
        return None
    runs, counts = np.unique(record.run, return_counts=True)
    at = record.run == runs[np.argmax(counts)]
    time, speed, omega, torque = (x[at] for x in (record.time, record.speed, record.omega, record.torque))
    observed = FilterObserver.of(vehicle, time_constant).run(time, torque, omega).adhesion_torque
    settled = time - time[0] >= _SETTLING * time_constant
    rim = vehicle.wheel.radius * omega
    return TimeHistory(time - time[0], speed, rim, torque, np.where(settled, observed, np.nan), 1.0 - rim / speed)
