"""From rows of a log to adhesion coefficients over slip: the observer, and the slip seen through the same filter.

The observed torque is Ta/(tau s + 1): late and smoothed. Set against the slip of the moment it would shift a curve by
tau times the slip's rate. So slip and its powers pass through the same filter: their means are the moments of the slip
that an observed mu is the mean over, which is all that a fit needs (`cells`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.vehicle import Vehicle

from .low_pass import LowPass
from .observer.filters import FilterObserver, Form
from .observer.kalman import KalmanObserver
from .record import Recorder
from .regripping import Regripping
from .rolling import LOWEST_SPEED, FreeRolling
from .rows import Rows
from .survey import Survey

Floats = NDArray[np.float64]

DEFAULT_TIME_CONSTANT = 0.05
"""tau of the observer, s, where the log is sampled fast enough."""

INTERVALS_PER_TIME_CONSTANT = 5.0
"""Least tau, in intervals of the log, that is chosen by itself."""

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
_ABSURD = 1e12  # of any column in SI: whatever its unit, no measurement, and its square may leave the range of doubles
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


class TorqueObserver(Protocol):
    """What is asked of an observer: the estimates of a chunk, and the state to go on from (`observer.filters`)."""

    def run(self, time: Any, torque: Any, omega: Any, state: Any = None) -> Any: ...


@dataclass(frozen=True)
class Observed:
    """Samples of adhesion over slip, each an array of one length.

    Attributes
    ----------
    time : s
    slip, slip2, slip3 : filtered slip ratio, its square and its cube.
    speed : filtered train speed, m/s.
    slip_speed : filtered product of both, m/s.
    mu : observed adhesion coefficient.
    load : filtered wheel load, N.
    step, slip_step : time and change of the filtered slip since the row before; 0 after a row that is not used.
    """

    time: Floats
    slip: Floats
    slip2: Floats
    slip3: Floats
    speed: Floats
    slip_speed: Floats
    mu: Floats
    load: Floats
    step: Floats
    slip_step: Floats

    def __len__(self) -> int:
        return len(self.time)

    def where(self, kept: NDArray[np.bool_]) -> Observed:
        """The samples that are kept."""
        return Observed(*(getattr(self, f.name)[kept] for f in fields(self)))


class AdhesionStream:
    """Observed adhesion of a log that comes in blocks of rows.

    Parameters
    ----------
    vehicle : Vehicle
        Wheel, and wheel load where the log has none.
    time_constant : float, optional
        tau, s; left out, 0.05 s or five intervals of the log, whichever is more.
    observer : Observer
        Which form.

    Raises
    ------
    InputError
        tau not above 0; while running, a log of which more than one row in a hundred is impossible.
    """

    def __init__(
        self, vehicle: Vehicle, *, time_constant: float | None = None, observer: Observer = Observer.CORRECTED
    ) -> None:
        self.vehicle, self.kind = vehicle, observer
        self.survey = Survey()
        self.recorder = Recorder()
        self.free = FreeRolling(vehicle)
        self.wheel_column = ""
        self._tau = time_constant
        self._observer: TorqueObserver | None = None
        self._state: Any = None
        self._low_pass: LowPass | None = None  # of the channels
        self._regripping: Regripping | None = None
        self._states: list[Any] | None = None  # of the channels, with a Kalman filter
        self._last = self._settled = -math.inf
        self._last_used = False
        self._last_slip = 0.0
        self._last_run = -math.inf
        if time_constant is not None:
            self._start_with(time_constant)

    @property
    def time_constant(self) -> float:
        """tau, s; known once the first rows are in."""
        return math.nan if self._tau is None else self._tau

    def _start_with(self, tau: float) -> None:
        self._tau = tau
        if self.kind is not Observer.KALMAN:
            self._observer = FilterObserver.of(self.vehicle, tau, Form(self.kind.value))
        elif math.isfinite(self.survey.interval):
            self._observer = self._kalman(tau)

    def _kalman(self, tau: float) -> KalmanObserver:
        """Damped by 1/sqrt(2) at 1/tau: the gains depend on the ratio of walk and noise alone, so the noise is 1."""
        J, B, interval = (
            self.vehicle.effective_inertia,
            self.vehicle.effective_viscous_friction,
            self.survey.interval,
        )
        return KalmanObserver(J, B, interval, 1.0, 0.0, interval * J**2 / tau**4)

    def add(self, rows: Rows) -> Observed:
        """The samples of the next rows."""
        rows, omega = self._possible(rows)
        if not len(rows):
            return _joined([])
        time = rows.columns["time"]
        if len(time) > 1 and math.isnan(self.survey.interval):
            self.survey.interval = float(np.median(np.diff(time)))
        if self._observer is None:
            least = INTERVALS_PER_TIME_CONSTANT * self.survey.interval if len(time) > 1 else 0.0
            self._start_with(self._tau or max(DEFAULT_TIME_CONSTANT, least))
        steps = np.diff(time, prepend=self._last)
        new = self._gaps(rows, steps)
        self._record(rows, omega, new)
        parts = []
        for start, stop in zip([0, *new], [*new, len(rows)], strict=True):
            if stop > start:
                parts.append(self._stretch(rows.part(start, stop), omega[start:stop], fresh=start in new))
        self.survey.rows += len(rows)
        return _joined(parts)

    def check(self, name: str) -> None:
        """Raise InputError where too many rows were impossible: then it is not noise but the columns or units."""
        survey = self.survey
        if survey.implausible > _TOLERATED_SHARE * (survey.rows + survey.implausible):
            more = f" ({survey.implausible} such rows)" if survey.implausible > 1 else ""
            raise InputError(f"{name}: {survey.first_implausible}{more}; check columns and units")
        if survey.forward < _TOLERATED_SHARE * survey.backward:
            raise InputError(
                f"{name}: train speed is negative in {survey.backward} rows, and positive in {survey.forward}; reverse "
                "its sign, and that of the wheel's speed if need be: the direction of travel is positive"
            )
        if survey.used < _TOLERATED_SHARE * survey.reversed:
            raise InputError(
                f"{name}: brake torque is negative in {survey.reversed} rows with slip, and positive in {survey.used}; "
                "reverse its sign: torque that brakes is positive"
            )
        if survey.used < _TOLERATED_SHARE * survey.lost:
            gaps = f" and each of {survey.gap_count} gaps" if survey.gap_count else ""
            remedy = "a log with fewer gaps" if survey.gap_count else "a smaller --tau, or a longer log"
            raise InputError(
                f"{name}: {survey.used} of {survey.used + survey.lost} rows under brake can be used: after the start"
                f"{gaps} the observer settles for {_SETTLING * self.time_constant:.4g} s; give {remedy}"
            )

    def _possible(self, rows: Rows) -> tuple[Rows, Floats]:
        """The rows a train can have been in, and the wheel's angular speed in them, rad/s."""
        radius = self.vehicle.wheel.radius
        angular = rows.columns.get("wheel_angular_speed")
        self.wheel_column = "wheel_speed" if angular is None else "wheel_angular_speed"
        omega = rows.columns["wheel_speed"] / radius if angular is None else angular
        v, torque, load = rows.columns["train_speed"], rows.columns["brake_torque"], self._load(rows)
        known = np.stack([rows.columns["time"], v, omega, torque, load])
        self.free.add(known[:, np.all(np.abs(known[1:]) < _ABSURD, axis=0)])
        wheel, pressed = radius * omega, load > 0.0
        pull = np.abs(torque[pressed]) / (radius * load[pressed])
        self.survey.backward += int((v < -LOWEST_SPEED).sum())
        self.survey.forward += int((v > LOWEST_SPEED).sum())
        self.survey.highest_pull = max(self.survey.highest_pull, float(pull.max(initial=0.0)))
        # a wheel let go overshoots, as its contact is a spring
        least = np.where(self._braked(torque, load), _LEAST_SLIP, _LEAST_FREE_SLIP)
        checks = (
            (np.abs(v) > _FASTEST, v / KMH, "train speed", "km/h is beyond any train"),
            (np.abs(wheel) > _FASTEST, wheel / KMH, "wheel speed", "km/h is beyond any train"),
            (np.abs(torque) > _LARGEST_TORQUE, torque, "brake torque", "N*m is beyond any wheel"),
            (load <= 0.0, load, "wheel load", "N does not press on the rail"),
            (
                (v - wheel < least * v) & (v > LOWEST_SPEED),
                wheel / KMH,
                "wheel speed",
                "km/h is far above the train's, which braking cannot cause",
            ),
        )
        bad = np.zeros(len(rows), dtype=bool)
        for wrong, value, what, why in checks:
            if wrong.any() and not self.survey.first_implausible:
                at = int(np.argmax(wrong))
                self.survey.first_implausible = f"line {rows.line[at]}: {what} {value[at]:.4g} {why}"
            bad |= wrong
        self.survey.implausible += int(bad.sum())
        return rows.where(~bad), omega[~bad]

    def _load(self, rows: Rows) -> Floats:
        return rows.columns.get("wheel_load", np.full(len(rows), self.vehicle.wheel_load))

    def _braked(self, torque: Floats, load: Floats) -> NDArray[np.bool_]:
        """A released brake counts at once."""
        return torque > LEAST_PULL * self.vehicle.wheel.radius * load

    def _record(self, rows: Rows, omega: Floats, new: NDArray[np.intp]) -> None:
        time, v, torque = (rows.columns[name] for name in ("time", "train_speed", "brake_torque"))
        load, apart = self._load(rows), np.zeros(len(time), dtype=bool)
        apart[new] = True
        rolling = (v > LOWEST_SPEED) & (self.vehicle.wheel.radius * omega > (1.0 - SLIP_RANGE[1]) * v) & (load > 0.0)
        self.recorder.add(np.stack([time, v, omega, torque, load]), rolling & self._braked(torque, load), apart)

    def _gaps(self, rows: Rows, steps: Floats) -> NDArray[np.intp]:
        """The rows before which the observer starts anew: the log's first, and those after a gap."""
        long = steps > _GAP_INTERVALS * self.survey.interval
        new = np.flatnonzero(long & (steps > _BRIDGED * self.time_constant))
        bridged = steps[long & (steps <= _BRIDGED * self.time_constant)]
        self.survey.bridged += len(bridged)
        self.survey.longest_bridged = max(self.survey.longest_bridged, float(bridged.max(initial=0.0)))
        for i in new:
            if math.isfinite(steps[i]):
                self.survey.note_gap(int(rows.line[i]), float(steps[i]))
        return new

    def _stretch(self, rows: Rows, omega: Floats, *, fresh: bool) -> Observed:
        """The samples of rows without a gap in them."""
        assert self._observer is not None
        time, torque, v = (rows.columns[name] for name in ("time", "brake_torque", "train_speed"))
        if fresh or self._low_pass is None or self._regripping is None:
            self._state, self._states, self._last_used = None, None, False
            self._low_pass, self._regripping = LowPass(self.time_constant), Regripping(self.time_constant)
            self._settled = time[0] + _SETTLING * self.time_constant
        estimate = self._observer.run(time, torque, omega, self._state)
        self._state = estimate.state
        load = self._load(rows)
        slip = 1.0 - self.vehicle.wheel.radius * omega / np.where(v > LOWEST_SPEED, v, np.inf)
        channels = np.stack([slip, slip**2, slip**3, v, slip * v, load])
        steps = np.diff(time, prepend=self._last if self._last_used else time[0])
        kalman = self.kind is Observer.KALMAN
        filtered = self._as_torques(time, channels) if kalman else self._low_pass.run(time, channels)
        self._last = float(time[-1])
        braked, regrips = self._braked(torque, load), self._regripping.add(time, slip, torque)
        self._count_unused(time, filtered, braked, self._braked(-torque, load), regrips)
        return self._samples(time, steps, filtered, estimate.adhesion_torque, braked & ~regrips)

    def _count_unused(
        self,
        time: Floats,
        filtered: Floats,
        braked: NDArray[np.bool_],
        reverse: NDArray[np.bool_],
        regrips: NDArray[np.bool_],
    ) -> None:
        """Count what the rows used do not show: braking not used, braking of the wrong sign, a wheel that regrips."""
        settled, sliding = time >= self._settled, _in_range(filtered)
        self.survey.lost += int((braked & sliding & ~settled).sum())
        self.survey.reversed += int((reverse & sliding).sum())
        self.survey.regripping += int((braked & sliding & settled & regrips).sum())

    def _as_torques(self, time: Floats, channels: Floats) -> Floats:
        """Each channel through the filter from Ta to its estimate: that from brake torque, with a wheel that stands."""
        assert self._observer is not None
        before = [None] * len(channels) if self._states is None else self._states
        still = np.zeros(len(time))
        found = [self._observer.run(time, u, still, state) for u, state in zip(channels, before, strict=True)]
        self._states = [each.state for each in found]
        return np.stack([each.adhesion_torque for each in found])

    def _samples(
        self, time: Floats, steps: Floats, filtered: Floats, adhesion_torque: Floats, wanted: NDArray[np.bool_]
    ) -> Observed:
        slip, slip2, slip3, speed, slip_speed, load = filtered
        radius = self.vehicle.wheel.radius
        used = _in_range(filtered) & (time >= self._settled) & wanted
        self.survey.initial_speed = max(self.survey.initial_speed, float(speed.max()))
        follows = np.concatenate([[self._last_used], used[:-1]]) & used
        step = np.where(follows, steps, 0.0)
        slip_step = np.where(follows, np.diff(slip, prepend=self._last_slip), 0.0)
        self._last_used, self._last_slip = bool(used[-1]), float(slip[-1])
        mu = adhesion_torque / (radius * np.where(load > 0.0, load, np.inf))
        found = Observed(time, slip, slip2, slip3, speed, slip_speed, mu, load, step, slip_step).where(used)
        self.survey.load_sum += float(load[used].sum())
        self._count_runs(found)
        return found

    def _count_runs(self, found: Observed) -> None:
        if len(found):
            apart = np.diff(found.time, prepend=self._last_run) > _SETTLING * self.time_constant
            self.survey.runs += int(apart.sum())
            self.survey.note_starts(found.speed[apart])
            self.survey.used += len(found)
            self._last_run = float(found.time[-1])


def _in_range(filtered: Floats) -> NDArray[np.bool_]:
    """Where filtered slip, speed and load can be used."""
    slip, speed, load = filtered[0], filtered[3], filtered[5]
    low, high = SLIP_RANGE
    inside: NDArray[np.bool_] = (slip >= low) & (slip <= high) & (speed > LOWEST_SPEED) & (load > 0.0)
    return inside


def _joined(parts: list[Observed]) -> Observed:
    if not parts:
        return Observed(*(np.empty(0) for _ in fields(Observed)))
    return Observed(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Observed)))
