"""Rolling without brake: where the torque stands still and the wheel follows its train, and what that shows.

A released brake has no torque and a wheel without torque no slip, so that what the columns read there is a torque's
zero and a wrong wheel radius. It is looked for in short windows of rows in which neither torque nor slip have a trend,
at the lowest torque at which there are some: a torque's zero may be far above what else would count as braking.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.vehicle import Vehicle

Floats = NDArray[np.float64]

LOWEST_SPEED = 5.0 * KMH
"""m/s, below which the slip ratio is a quotient of noises; the published stop ends there."""

_SECONDS, _LEAST_ROWS = 0.2, 16  # of a window, whichever is longer
_ROUNDING = 1e-6  # of an interval that a median of differences leaves
_GAP_INTERVALS = 5.0
_MOST_WINDOWS = 8192

_STEADY = 3.0  # standard errors within which a trend is none
_STEADY_MU = 0.001  # of the torque over a window, by radius and wheel load: no trend, and no other zero in one log
_STEADY_SLIP = 0.03  # a wheel swings about rolling, as its contact is a spring; beyond, it comes back from braking

_LEAST_WINDOWS = 2
_LEAST_SHARE = 0.02  # of the steady windows: a sensor that drops out for a moment is no zero
_BRAKES = 0.02  # of wheel load times radius: a torque above it is one only if the train is not slowed down by it
_SLOWED = 0.5  # of the deceleration that the torque would give

_MEDIAN = 1.2533  # standard error of a median over that of a mean
_SIGMA_PER_MAD = 1.4826
_UNIFORM = math.sqrt(12.0)


@dataclass(frozen=True)
class Rolling:
    """What the wheel showed while it rolled freely.

    Attributes
    ----------
    slip, slip_error : float
        Slip ratio, and its standard error; that of speeds in steps among it.
    torque, torque_error : float
        What the brake torque's column reads, N*m.
    speed, omega, load, deceleration : float
        Medians of train speed, m/s, angular speed, rad/s, wheel load, N, and the train's deceleration, m/s^2.
    freedom : float
        Degrees of freedom of the errors.
    """

    slip: float
    slip_error: float
    torque: float
    torque_error: float
    speed: float
    omega: float
    load: float
    deceleration: float
    freedom: float

    @property
    def sure(self) -> float:
        """Standard errors beyond which a value is told: Student's quantile of `_DOUBT`."""
        from scipy.special import stdtrit

        return float(stdtrit(self.freedom, 1.0 - _DOUBT / 2.0))


class FreeRolling:
    """Windows of rows in which torque and slip stand still; rows come in blocks of any size.

    Kept are `_MOST_WINDOWS` of them at most, spread over the log.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle, self._radius = vehicle, vehicle.wheel.radius
        self._rows = np.empty((5, 0))
        self._interval = math.nan
        self._windows = np.empty((len(_KEPT), 0))
        self._stride, self._seen = 1, 0

    @property
    def window(self) -> int:
        """Rows of a window; 0 until there are rows."""
        return 0 if math.isnan(self._interval) else max(_LEAST_ROWS, math.ceil(_SECONDS / self._interval - _ROUNDING))

    def add(self, rows: Floats) -> None:
        """Take rows in: 5 by k, s, m/s, rad/s, N*m, N, time growing also from block to block."""
        rows = np.concatenate([self._rows, rows], axis=1)
        if rows.shape[1] < 2:
            self._rows = rows
            return
        if math.isnan(self._interval):
            self._interval = float(np.median(np.diff(rows[0])))
        cuts = np.flatnonzero(np.diff(rows[0]) > _GAP_INTERVALS * self._interval) + 1
        for part in np.split(rows, cuts, axis=1):
            self._rows = self._stretch(part)

    def _stretch(self, rows: Floats) -> Floats:
        """Windows of rows without a gap, half over each other; the rows that the next window begins with."""
        size, hop = self.window, self.window // 2
        count = (rows.shape[1] - size) // hop + 1
        if count < 1:
            return rows
        views = np.lib.stride_tricks.sliding_window_view(rows, size, axis=1)[:, : (count - 1) * hop + 1 : hop]
        self._keep(self._steady(views))
        return rows[:, count * hop :]

    def _steady(self, views: Floats) -> Floats:
        """What is kept of the windows (5, m, rows) that are steady."""
        rolling = (views[1] > LOWEST_SPEED).all(axis=1) & (views[4] > 0.0).all(axis=1)
        time, v, omega, torque, load = views[:, rolling]
        slip = 1.0 - self._radius * omega / v
        still = _stands(time, slip, np.full(len(time), _STEADY_SLIP))
        still &= _stands(time, torque, _STEADY_MU * self._radius * load.mean(axis=1))
        time, v, omega, torque, load = (x[still] for x in (time, v, omega, torque, load))
        return np.stack(
            [
                torque.mean(axis=1),
                torque.std(axis=1) / math.sqrt(self.window),
                v.mean(axis=1),
                omega.mean(axis=1),
                load.mean(axis=1),
                -_slopes(time, v),
                np.ptp(omega, axis=1) > 0.0,
            ]
        )

    def _keep(self, windows: Floats) -> None:
        number = self._seen + np.arange(windows.shape[1])
        self._seen += windows.shape[1]
        self._windows = np.concatenate([self._windows, windows[:, number % self._stride == 0]], axis=1)
        while self._windows.shape[1] > _MOST_WINDOWS:
            self._stride *= 2
            self._windows = self._windows[:, ::2]

    def found(self, *, speed_step: float = 0.0, omega_step: float = 0.0) -> Rolling | None:
        """What was seen, with speeds that come in steps (m/s, rad/s); None where the wheel never rolled freely."""
        windows = self._lowest()
        if windows is None:
            return None
        torque, _, v, omega, load, deceleration, moves = windows
        zero, centre = float(np.median(torque)), float(np.median(load))
        speed, slows = float(np.median(v)), float(np.median(deceleration))
        by_brake = slows - _resistance(self._vehicle, speed) / self._vehicle.effective_mass
        slowed = by_brake > _SLOWED * zero / (self._radius * self._vehicle.effective_mass)
        if zero >= _BRAKES * self._radius * centre and slowed:
            return None
        slip = 1.0 - self._radius * omega / v
        # an encoder's counts add up over a window; a speed that stands still may be off by its rounding all along
        rounding = omega_step / _UNIFORM / (self.window if moves.any() else 1.0)
        of_steps = math.hypot(self._radius * rounding, speed_step / _UNIFORM) / speed
        return Rolling(
            slip=float(np.median(slip)),
            slip_error=math.hypot(_error_of_median(slip), of_steps),
            torque=zero,
            torque_error=_error_of_median(torque),
            speed=speed,
            omega=float(np.median(omega)),
            load=centre,
            deceleration=slows,
            freedom=max(len(slip) / 2.0 - 1.0, 1.0),
        )

    def _lowest(self) -> Floats | None:
        """The windows at the lowest torque at which there are enough of them."""
        order = np.argsort(self._windows[0])
        windows = self._windows[:, order]
        torque, noise, load = windows[0], windows[1], windows[4]
        least = max(_LEAST_WINDOWS, math.ceil(_LEAST_SHARE * len(torque)))
        if len(torque) < least:
            return None
        reach = torque + np.maximum(_STEADY_MU * self._radius * load, 2.0 * _STEADY * noise)
        ends = np.searchsorted(torque, reach, side="right")
        enough = np.flatnonzero(ends - np.arange(len(torque)) >= least)
        return windows[:, enough[0] : ends[enough[0]]] if len(enough) else None


_KEPT = ("torque", "its standard error", "speed", "omega", "load", "deceleration", "whether omega moves")


def _resistance(vehicle: Vehicle, speed: float) -> float:
    """The train's own, N, of the quarter car, at a speed in m/s."""
    r = vehicle.resistance
    return r.constant + r.linear * speed + r.quadratic * speed**2


def _slopes(time: Floats, values: Floats) -> Floats:
    """Of the straight lines through values, window by window."""
    t = time - time.mean(axis=1, keepdims=True)
    result: Floats = np.sum(t * values, axis=1) / np.sum(t**2, axis=1)
    return result


def _stands(time: Floats, values: Floats, least: Floats) -> NDArray[np.bool_]:
    """In which windows values neither rise nor bend, beyond their noise or beyond a least change over the window.

    The noise is that of differences of neighbours, so that a wheel that swings is not taken for a noisy one.
    """
    x = 2.0 * (time - time.mean(axis=1, keepdims=True)) / np.ptp(time, axis=1)[:, None]  # -1 to 1
    bend = x**2 - np.mean(x**2, axis=1, keepdims=True)
    noise = np.mean(np.diff(values, axis=1) ** 2, axis=1) / 2.0
    stands = np.ones(len(time), dtype=bool)
    for shape in (x, bend):
        squares = np.sum(shape**2, axis=1)
        change = 2.0 * np.abs(np.sum(shape * values, axis=1)) / squares
        stands &= change <= np.maximum(least, 2.0 * _STEADY * np.sqrt(noise / squares))
    return stands


def _error_of_median(values: Floats) -> float:
    """Standard error of the median of windows that lie half over each other."""
    scatter = _SIGMA_PER_MAD * float(np.median(np.abs(values - np.median(values))))
    return _MEDIAN * scatter / math.sqrt(max(len(values) / 2.0, 1.0))


# --- what does not fit ---------------------------------------------------------------------------------------------

_DOUBT = 0.001  # probability with which a log without fault is told to have one
_LEAST_SLIP = 5e-4  # 0.2 mm of a radius; below, a log's speeds have errors of their own
_LEAST_OF_PEAK = 0.003  # of the slip at the peak: what is less shifts a fit by less than its errors
_LEAST_MU = 0.001  # a torque's zero by wheel load and radius: as the errors of a good fit
_OTHER_UNIT = 0.15  # slip ratio: no wheel wears so much
MOST_FREE_SLIP = 0.5
"""Slip ratio of a wheel without brake beyond which a log is refused: no radius is so wrong."""

_UNITS_APART = ((1.0 / KMH, "km/h and m/s"), (30.0 / math.pi, "rpm and rad/s"), (2.0 * math.pi, "turns and radians"))
_ALIKE = 0.05  # relative, of a ratio: more than a radius is wrong by
_MOST_CREEP = 0.002  # of a wheel without brake, if a wrong wheel has bent the curve that its slope is taken from
_UNTRUSTED = 0.005  # slip ratio
_EXPLAINED = 0.25  # of the slip that is left without a zero that was given, below which the zero is the cause


@dataclass(frozen=True)
class Known:
    """What rolling is judged by: the vehicle, and what the log and its user say.

    Attributes
    ----------
    vehicle : Vehicle
    slope : float
        dmu/dslip where the curve begins, roughly; inf where it is not known.
    peak_slip : float
        0 where it is not known.
    wheel_column : str
        The quantity that the wheel's speed was read from.
    zeros : mapping
        What was taken off, SI, by quantity.
    """

    vehicle: Vehicle
    slope: float
    peak_slip: float
    wheel_column: str
    zeros: Mapping[str, float]

    def excess(self, rolling: Rolling) -> float:
        """Slip ratio beside that which the rail needs to turn the wheel against its friction, and to slow it down."""
        return rolling.slip - self._creep(rolling)

    def tolerance(self, rolling: Rolling) -> float:
        """Slip ratio of `excess` up to which free rolling is as it should be."""
        least = max(_LEAST_SLIP, _LEAST_OF_PEAK * self.peak_slip)
        return max(rolling.sure * rolling.slip_error + abs(self._creep(rolling)), least)

    def _creep(self, rolling: Rolling) -> float:
        if not self.slope > 0.0:
            return 0.0
        vehicle, radius = self.vehicle, self.vehicle.wheel.radius
        friction = vehicle.effective_viscous_friction * rolling.omega / radius
        force = friction - vehicle.effective_inertia * rolling.deceleration / radius**2
        return min(max(force / (rolling.load * self.slope), -_MOST_CREEP), _MOST_CREEP)


def is_wrong_wheel(rolling: Rolling | None) -> bool:
    """Whether a rolling wheel has so much slip that what else a log shows is not to be trusted."""
    return rolling is not None and abs(rolling.slip) > max(_UNTRUSTED, rolling.sure * rolling.slip_error)


def rolling_warnings(rolling: Rolling | None, known: Known) -> tuple[str, ...]:
    """What a wheel without brake shows to be wrong, a sentence each."""
    if rolling is None:
        return ()
    found = []
    if abs(known.excess(rolling)) > known.tolerance(rolling):
        found.append(_wrong_wheel(rolling, known))
    load = known.vehicle.wheel.radius * rolling.load
    if abs(rolling.torque) >= max(_LEAST_MU * load, rolling.sure * rolling.torque_error):
        given = known.zeros.get("brake_torque", 0.0)
        beside = f" beside the {given:.4g} N*m that is taken off" if given else ""
        option = f"--zero brake_torque={rolling.torque + given:.4g} takes it off"
        if abs(rolling.torque + given) < _LEAST_MU * load:
            option = "leave --zero brake_torque out"
        found.append(
            f"the brake torque reads {rolling.torque:.4g} N*m{beside} where the wheel rolls freely, which is "
            f"{rolling.torque / load:.2g} of mu: {option}"
        )
    return tuple(found)


def _wrong_wheel(rolling: Rolling, known: Known) -> str:
    radius, slip = known.vehicle.wheel.radius, rolling.slip
    shown = f"free rolling shows a slip of {_percent(slip, rolling.slip_error)} %"
    for name, given in known.zeros.items():
        without = _slip_without(rolling, known, name, given)
        if without is not None and abs(without) < max(known.tolerance(rolling), _EXPLAINED * abs(slip)):
            option = f"--zero {name}={given:.4g}"
            return f"{shown}, and without the {option} that is given {100.0 * without:.2g} %: leave it out"
    likely = f"the wheel radius may be {radius / (1.0 - known.excess(rolling)):.4g} m, not {radius:.4g} m"
    if abs(slip) < _OTHER_UNIT:
        return f"{shown}: {likely}"
    text = (
        f"{shown}, the wheel's speed is {1.0 - slip:.3g} times the train's: "
        f"check the units of {known.wheel_column} and train_speed{_apart(1.0 - slip)}, and that no columns are swapped"
    )
    return f"{text}; else {likely}" if abs(slip) <= MOST_FREE_SLIP else text


def rolling_fault(rolling: Rolling | None, known: Known) -> str | None:
    """A sentence where a wheel without brake has so much slip that no curve can be had from the log; else None."""
    if rolling is None or abs(rolling.slip) <= MOST_FREE_SLIP:
        return None
    return _wrong_wheel(rolling, known)


def _apart(ratio: float) -> str:
    """The units whose ratio that of wheel and train is; empty for none."""
    for factor, units in _UNITS_APART:
        if min(abs(abs(ratio) * factor - 1.0), abs(abs(ratio) / factor - 1.0)) < _ALIKE:
            return f" ({units} are {factor:.3g} apart)"
    return ""


def _slip_without(rolling: Rolling, known: Known, name: str, given: float) -> float | None:
    """The slip with a speed's zero put on again; None for a zero of no speed."""
    rim, speed = known.vehicle.wheel.radius * rolling.omega, rolling.speed
    if name == "train_speed":
        return 1.0 - rim / (speed + given)
    if name != known.wheel_column:
        return None
    return 1.0 - (rim + given * (known.vehicle.wheel.radius if name == "wheel_angular_speed" else 1.0)) / speed


def _percent(slip: float, error: float) -> str:
    """A slip ratio in %, with as many digits as its error leaves, three at most."""
    digits = 3 - 1 - math.floor(math.log10(abs(100.0 * slip)))
    if error > 0.0:
        digits = min(digits, max(-math.floor(math.log10(100.0 * error)), 1))
    return f"{100.0 * slip:.{max(digits, 1)}f}"
