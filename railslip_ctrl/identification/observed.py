"""From rows of a log to adhesion coefficients over slip: the observer, and the slip seen through the same filter.

The observed torque is Ta/(tau s + 1): late and smoothed. Set against the slip of the moment it would shift a curve by
tau times the slip's rate. So slip and its powers pass through the same filter: their means are the moments of the slip
that an observed mu is the mean over, which is all that a fit needs (`curves`).

Beside it `BrakedRows`, as they came, for prediction-error fits. Whole runs are kept, from the brake's application to
its release; where there are more rows than `MOST_ROWS`, every second run is dropped, again and again.
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
from .observer import FilterObserver, Form, KalmanObserver, ObserverState, TorqueObserver
from .words import told

# --- the observer's filter -----------------------------------------------------------------------------------------


class Channels:
    """Channels through an observer's filter from Ta to its estimate: each as a brake torque on a wheel that stands."""

    def __init__(self, observer: TorqueObserver) -> None:
        self._observer = observer
        self._states: list[ObserverState] | None = None

    def run(self, time: Floats, channels: Floats) -> Floats:
        """The next samples of the channels, an array (channels, k), filtered; the first are taken as settled."""
        still = np.zeros(len(time))
        before: list[ObserverState] | list[None] = self._states or [None] * len(channels)
        found = [self._observer.run(time, u, still, state) for u, state in zip(channels, before, strict=True)]
        self._states = [each.state for each in found]
        return np.stack([each.adhesion_torque for each in found])


_RELEASED = 0.1  # of the torque, that it falls by in a time constant: no brake is eased so fast while the wheel holds


class Readhesion:
    """Which rows are of readhesion: from where the slip falls under a torque that is let go, while it falls.

    The brake is released past the peak, and the slip falls back to none within tenths of a second. The curve over slip
    is that of a slip that grows, as in [Park2008] Fig. 13; on the way back the observer's torque is a mean over half
    the curve. Torque and slip go through the filter twice: a value that is below its own mean falls.
    """

    def __init__(self, low_pass: TorqueObserver) -> None:
        self._once, self._twice = Channels(low_pass), Channels(low_pass)
        self._falls_back = False

    def add(self, time: Floats, slip: Floats, torque: Floats) -> Flags:
        """Whether the next rows are of readhesion: times in s, slip ratios and brake torques in N*m as logged."""
        now = self._once.run(time, np.stack([slip, torque]))
        fallen = self._twice.run(time, now) - now
        falls = fallen[0] > 0.0
        released = falls & (fallen[1] > _RELEASED * np.maximum(now[1], 0.0))
        index = np.arange(len(time))
        last_released = np.maximum.accumulate(np.where(released, index, -1 if self._falls_back else -2))
        last_held = np.maximum.accumulate(np.where(falls, -2, index))
        found: Flags = last_released > last_held
        self._falls_back = bool(found[-1])
        return found


# --- rows kept as they came ----------------------------------------------------------------------------------------


MOST_ROWS = 20_000  #: rows kept; a hundred rig tests at 100 rows a second

_LONGEST_RUN = 4096  # rows; a longer run is cut, so that one run cannot take all the room for ever


@dataclass(frozen=True)
class BrakedRows:
    """Rows under brake: arrays of one length; s, m/s, rad/s, N*m, N, and the number of the run a row belongs to."""

    time: Floats
    speed: Floats
    omega: Floats
    torque: Floats
    load: Floats
    run: Floats

    def __len__(self) -> int:
        return len(self.time)


class Recorder:
    """Takes rows that come in blocks of any size; the record does not depend on how they come."""

    def __init__(self, most_rows: int = MOST_ROWS) -> None:
        self._most = most_rows
        self.stride = 1
        self._kept = np.empty((6, 0))
        self._run, self._place = -1, 0  # of the last row used: its run, and its place in it
        self._last_used = False

    def add(self, rows: Floats, used: Flags, apart: Flags) -> None:
        """Take in rows (5 by k, the columns of `BrakedRows`), which are used, and which stand after a gap."""
        if not used.any():
            self._last_used = bool(used[-1]) if used.size else self._last_used
            return
        follows = used & np.concatenate([[self._last_used], used[:-1]]) & ~apart
        index = np.arange(used.size)
        start = np.maximum.accumulate(np.where(used & ~follows, index, -1))
        place = np.where(start >= 0, index - start, self._place + 1 + index)
        begins = used & (~follows | (place % _LONGEST_RUN == 0))
        run = self._run + np.cumsum(begins)
        self._run, self._place, self._last_used = int(run[-1]), int(place[-1]), bool(used[-1])
        keep = used & (run % self.stride == 0)
        self._kept = np.concatenate([self._kept, np.vstack([rows[:, keep], run[keep]])], axis=1)
        while self._kept.shape[1] > self._most and self.stride <= self._run:
            self.stride *= 2
            self._kept = self._kept[:, self._kept[5] % self.stride == 0]

    def record(self) -> BrakedRows:
        """The rows kept so far."""
        return BrakedRows(*self._kept)


# --- what is met on the way ----------------------------------------------------------------------------------------


_MOST_NAMED = 5


_MIXED = 1.25  # ratio of the speeds at which braking begins, beyond which one v0 stands for several


@dataclass
class Survey:
    """What was met on the way; speeds in m/s, times in s, loads in N.

    `used` are rows under brake in the range of slip and speed, in `runs` apart by the settling time; `lost` those under
    brake within the settling time after a gap or the start; `reversed` those with slip and a torque as far below 0 as
    braking is above; `readhesion` those of readhesion; `backward` and `forward` those with a train speed
    below and above 0. `gaps` are the first (line, seconds), after each of which the observer starts anew; `bridged` are
    long intervals that it runs through. `initial_speed` is the highest train speed, filtered, `slowest_start` and
    `fastest_start` are those at which runs begin; `highest_pull` is the highest brake torque by wheel load and radius.
    """

    rows: int = 0
    used: int = 0
    runs: int = 0
    gaps: list[tuple[int, float]] = field(default_factory=list)
    gap_count: int = 0
    implausible: int = 0
    bridged: int = 0
    longest_bridged: float = 0.0
    lost: int = 0
    reversed: int = 0
    backward: int = 0
    forward: int = 0
    first_implausible: str = ""
    initial_speed: float = 0.0
    interval: float = math.nan
    slowest_start: float = math.nan
    fastest_start: float = math.nan
    load_sum: float = 0.0
    readhesion: int = 0
    highest_pull: float = 0.0

    @property
    def wheel_load(self) -> float:
        """Mean wheel load of the rows used, N."""
        return self.load_sum / self.used

    @property
    def lost_share(self) -> float:
        """Of the rows under brake, those lost to settling."""
        return self.lost / max(self.lost + self.used, 1)

    @property
    def is_mixed(self) -> bool:
        """Whether the runs begin at speeds so different that one v0 stands for several."""
        return self.slowest_start * _MIXED < self.fastest_start


# --- adhesion over slip --------------------------------------------------------------------------------------------


LOWEST_SPEED = 5.0 * KMH  #: m/s, below which the slip ratio is a quotient of noises; the published stop ends there

DEFAULT_TIME_CONSTANT = 0.05  #: tau of the observer, s, where the log is sampled fast enough

INTERVALS_PER_TIME_CONSTANT = 5.0  #: least tau, in intervals of the log, that is chosen by itself

SLIP_RANGE = (0.005, 0.98)
"""Slip ratios used: below, noise of the speeds is most of it; above, the wheel is locked and its torque unknown."""

_GAP_INTERVALS = 5.0

# An interval up to this many time constants is no gap: speeds and torque are taken to run straight through it, and
# what they do else is mostly beyond the observer's bandwidth anyway.
_BRIDGED = 1.0

_SETTLING = 5.0  # time constants after a start, after which the unknown initial adhesion torque is below 1 %
LEAST_PULL = 0.02  # of wheel load times radius: below it the brake is not applied

# What no train does. A wheel far faster than its braked train is a wrong unit or a wrong column.
_FASTEST = 200.0
_LARGEST_TORQUE = 1e6
_LEAST_SLIP = -0.5
_LEAST_FREE_SLIP = -2.0
_TOLERATED_SHARE = 0.01


class Observer(StrEnum):
    """CORRECTED: every term filtered; PRINTED: [Park2008] (27) as it stands, the brake torque unfiltered.

    KALMAN: a Kalman filter whose adhesion torque walks at random, as fast as its bandwidth of 1/tau asks.
    """

    CORRECTED = "corrected"
    PRINTED = "printed"
    KALMAN = "kalman"


@dataclass(frozen=True)
class Observed:
    """Samples of adhesion over slip, SI, arrays of one length; all but the time behind the observer's filter.

    `slip2`, `slip3` and `slip_speed` are the filtered square, cube, and product with the train's speed.
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
    """Observed adhesion of a log that comes in blocks of rows.

    The vehicle gives the wheel, and the wheel load where the log has none; the `time_constant` tau, s, is 0.05 s or
    five intervals of the log, whichever is more, unless it is given. `add` raises InputError for a tau not above 0.
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
        """tau, s; known once the first rows are in."""
        return math.nan if self._tau is None else self._tau

    def _begin(self) -> None:
        """The observer, with a time constant for the first rows unless it is given."""
        interval = self.survey.interval
        if self._tau is None:
            self._tau = float(np.fmax(DEFAULT_TIME_CONSTANT, INTERVALS_PER_TIME_CONSTANT * interval))
        tau, J, friction = self._tau, self.vehicle.effective_inertia, self.vehicle.effective_viscous_friction
        if self.kind is not Observer.KALMAN:
            self._observer = FilterObserver(J, friction, tau, Form(self.kind.value))
        else:
            # damped by 1/sqrt(2) at 1/tau: the gains depend on the ratio of walk and noise alone, so the noise is 1
            held = tau if math.isnan(interval) else interval
            self._observer = KalmanObserver(J, friction, held, 1.0, 0.0, held * J**2 / tau**4)

    def add(self, rows: Rows) -> Observed:
        """The samples of the next rows."""
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
        """Raise InputError where too many rows were impossible: then it is not noise but the columns or units."""
        survey = self.survey
        if survey.implausible > _TOLERATED_SHARE * (survey.rows + survey.implausible):
            more = f" ({survey.implausible} such rows)" if survey.implausible > 1 else ""
            raise InputError(f"{name}: {survey.first_implausible}{more}; check columns and units")
        if survey.forward < _TOLERATED_SHARE * survey.backward:
            raise InputError(told("speed reversed", name=name, survey=survey))
        if survey.used < _TOLERATED_SHARE * survey.reversed:
            raise InputError(told("torque reversed", name=name, survey=survey))
        if survey.used < _TOLERATED_SHARE * survey.lost:
            of, seconds = survey.used + survey.lost, _SETTLING * self.time_constant
            which = "lost to gaps" if survey.gap_count else "lost to the start"
            raise InputError(told(which, name=name, survey=survey, of=of, seconds=seconds))

    def signals(self, rows: Rows) -> Floats:
        """Time, s, train speed, m/s, angular speed, rad/s, brake torque, N*m, and wheel load, N, of rows: (5, k)."""
        radius, angular = self.vehicle.wheel.radius, rows.columns.get("wheel_angular_speed")
        self.wheel_column = "wheel_speed" if angular is None else "wheel_angular_speed"
        omega = rows.columns["wheel_speed"] / radius if angular is None else angular
        load = rows.columns.get("wheel_load", np.full(len(rows), self.vehicle.wheel_load))
        return np.stack([rows.columns["time"], rows.columns["train_speed"], omega, rows.columns["brake_torque"], load])

    def _possible(self, rows: Rows) -> tuple[Lines, Floats]:
        """The lines of the rows that a train can have been in, and their signals."""
        signals, radius = self.signals(rows), self.vehicle.wheel.radius
        _, v, omega, torque, load = signals
        wheel, pressed = radius * omega, load > 0.0
        pull = np.abs(torque[pressed]) / (radius * load[pressed])
        self.survey.backward += int((v < -LOWEST_SPEED).sum())
        self.survey.forward += int((v > LOWEST_SPEED).sum())
        self.survey.highest_pull = max(self.survey.highest_pull, float(pull.max(initial=0.0)))
        # a wheel let go overshoots, as its contact is a spring
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
                self.survey.first_implausible = told(name, line=rows.line[at], value=value[at])
            bad |= wrong
        self.survey.implausible += int(bad.sum())
        return rows.line[~bad], signals[:, ~bad]

    def _braked(self, torque: Floats, load: Floats) -> Flags:
        """A released brake counts at once."""
        return torque > LEAST_PULL * self.vehicle.wheel.radius * load

    def _gaps(self, line: Lines, steps: Floats) -> NDArray[np.intp]:
        """The rows before which the observer starts anew: the log's first, and those after a gap."""
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
        """The samples of rows without a gap in them."""
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
        found = Observed(time, slip, slip2, slip3, speed, slip_speed, mu, pressed).where(used)
        if len(found):
            apart = np.diff(found.time, prepend=self._last_run) > _SETTLING * self.time_constant
            survey.runs += int(apart.sum())
            starts = found.speed[apart]
            survey.slowest_start = float(np.fmin(survey.slowest_start, starts.min(initial=math.inf)))
            survey.fastest_start = float(np.fmax(survey.fastest_start, starts.max(initial=-math.inf)))
            survey.used += len(found)
            survey.load_sum += float(found.load.sum())
            self._last_run = float(found.time[-1])
        return found


def _joined(parts: list[Observed]) -> Observed:
    if not parts:
        return Observed(*(np.empty(0) for _ in fields(Observed)))
    return Observed(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Observed)))


# --- one run over time ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TimeHistory:
    """A run under brake over time from the brake's application, SI, arrays of one length, as a picture shows it.

    The wheel's speed is that of its circumference; the adhesion torque is observed with every term filtered, NaN while
    the observer settles.
    """

    time: Floats
    train_speed: Floats
    wheel_speed: Floats
    brake_torque: Floats
    adhesion_torque: Floats
    slip: Floats


def time_history_of(record: BrakedRows, vehicle: Vehicle, time_constant: float) -> TimeHistory | None:
    """The longest run of a record, observed with tau in s; None for an empty record."""
    if not len(record):
        return None
    runs, counts = np.unique(record.run, return_counts=True)
    at = record.run == runs[np.argmax(counts)]
    time, speed, omega, torque = (x[at] for x in (record.time, record.speed, record.omega, record.torque))
    observed = FilterObserver.of(vehicle, time_constant).run(time, torque, omega).adhesion_torque
    settled = time - time[0] >= _SETTLING * time_constant
    rim = vehicle.wheel.radius * omega
    return TimeHistory(time - time[0], speed, rim, torque, np.where(settled, observed, np.nan), 1.0 - rim / speed)
