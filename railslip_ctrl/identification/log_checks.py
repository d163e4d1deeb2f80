"""Check whether a log is plausible; each fault is a `Finding`.

Without brake, torque and slip should be zero: a measured torque is therefore a sensor offset, and a measured slip
indicates a wrong wheel radius.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from types import MappingProxyType

import numpy as np

from railslip_ctrl.core.arguments import Flags, Floats
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.vehicle import Vehicle

from .cleaning import Resolution
from .logs import UNITS, Column, Rows
from .messages import message
from .observed import LOWEST_SPEED, BrakedRows, Survey


@dataclass(frozen=True)
class Finding:
    """A fault of a log: name of the `check` that detects it, and message `text`."""

    check: str
    text: str


# --- free rolling: windows with constant torque and slip, at the lowest torque that has enough windows ---------------

_SECONDS, _LEAST_ROWS = 0.2, 16  # least duration, s, and rows of a window
_ROUNDING = 1e-6  # relative rounding error of the median interval
_GAP_INTERVALS = 5.0  # a longer interval separates windows, in median intervals
_MOST_WINDOWS = 8192  # if there are more, every second window is dropped
_LARGEST_VALUE = 1e12  # SI; larger values are not measurements, and their squares might overflow

_STEADY = 3.0  # in standard errors; a smaller trend is not significant
_STEADY_MU = 0.001  # torque over radius and wheel load; smaller changes within or between windows are accepted
_STEADY_SLIP = 0.03  # accepted slip change in a window; contact oscillations are smaller, recovery after braking larger

_LEAST_WINDOWS = 2
_LEAST_SHARE = 0.02  # least share of the steady windows; a shorter zero torque may be a dropout of the sensor
_LEAST_BRAKE = 0.02  # of wheel load times radius; a larger torque is an offset only if it does not slow the train
_BRAKED_SHARE = 0.5  # of the deceleration that the torque would cause; a train that slows more is braked

_MEDIAN = 1.2533  # ratio of the standard errors of a median and of a mean, normal noise
_SIGMA_PER_MAD = 1.4826  # standard deviation over the median absolute deviation, normal noise
_UNIFORM = math.sqrt(12.0)  # quantisation step over the standard deviation of its rounding error


@dataclass(frozen=True)
class Rolling:
    """Slip ratio and brake torque in free rolling, with their standard errors, and medians of other signals; SI."""

    slip: float
    slip_error: float
    torque: float
    torque_error: float
    speed: float  # median of the train speed
    omega: float  # median
    load: float  # median
    deceleration: float  # median
    freedom: float  # degrees of freedom of the standard errors

    @property
    def critical_value(self) -> float:
        from scipy.special import stdtrit

        return float(stdtrit(self.freedom, 1.0 - _FALSE_ALARM / 2.0))  # in standard errors


class FreeRolling:
    """Detects free rolling in a log, from windows of rows in which torque and slip are constant."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle, self._radius = vehicle, vehicle.wheel.radius
        self._rows = np.empty((5, 0))
        self._interval, self._size = math.nan, 0  # interval, s, and rows of a window; set from the first rows
        self._windows = np.empty((7, 0))  # columns as returned by `_steady`
        self._stride, self._seen = 1, 0

    def add(self, rows: Floats) -> None:
        """Add rows, (5, k), in order of time: time (s), v (m/s), omega (rad/s), torque (N*m) and load (N)."""
        rows = np.concatenate([self._rows, rows[:, np.all(np.abs(rows[1:]) < _LARGEST_VALUE, axis=0)]], axis=1)
        if rows.shape[1] < 2:
            self._rows = rows
            return
        if not self._size:
            self._interval = float(np.median(np.diff(rows[0])))
            self._size = max(_LEAST_ROWS, math.ceil(_SECONDS / self._interval - _ROUNDING))
        cuts = np.flatnonzero(np.diff(rows[0]) > _GAP_INTERVALS * self._interval) + 1
        hop = self._size // 2  # windows overlap by half
        for part in np.split(rows, cuts, axis=1):
            count = max((part.shape[1] - self._size) // hop + 1, 0)
            if count:
                views = np.lib.stride_tricks.sliding_window_view(part, self._size, axis=1)
                self._keep(self._steady(views[:, : (count - 1) * hop + 1 : hop]))
            self._rows = part[:, count * hop :]  # beginning of the next window

    def _steady(self, views: Floats) -> Floats:
        """Return seven numbers for each window in which torque and slip are constant; `views` is (5, windows, rows).

        The numbers are the means of torque, v, omega and load, the standard error of the torque, the deceleration,
        and 1 if omega changes within the window, else 0.
        """
        rolling = (views[1] > LOWEST_SPEED).all(axis=1) & (views[4] > 0.0).all(axis=1)
        time, v, omega, torque, load = views[:, rolling]
        slip = 1.0 - self._radius * omega / v
        steady = _is_steady(time, slip, np.full(len(time), _STEADY_SLIP))
        steady &= _is_steady(time, torque, _STEADY_MU * self._radius * load.mean(axis=1))
        time, v, omega, torque, load = (x[steady] for x in (time, v, omega, torque, load))
        t = time - time.mean(axis=1, keepdims=True)
        noise = torque.std(axis=1) / math.sqrt(self._size)
        deceleration = -(np.sum(t * v, axis=1) / np.sum(t**2, axis=1))
        means = (each.mean(axis=1) for each in (torque, v, omega, load))
        return np.stack([*means, noise, deceleration, np.ptp(omega, axis=1) > 0.0])

    def _keep(self, windows: Floats) -> None:
        number = self._seen + np.arange(windows.shape[1])
        self._seen += windows.shape[1]
        self._windows = np.concatenate([self._windows, windows[:, number % self._stride == 0]], axis=1)
        while self._windows.shape[1] > _MOST_WINDOWS:
            self._stride *= 2
            self._windows = self._windows[:, ::2]

    def result(self, *, speed_step: float = 0.0, omega_step: float = 0.0) -> Rolling | None:
        """Return slip and torque in free rolling; None if the wheel never rolls freely.

        `speed_step`, m/s, and `omega_step`, rad/s, are the quantisation steps of train speed and wheel speed.
        """
        windows = self._lowest()
        if windows is None:
            return None
        torque, v, omega, _, _, _, moves = windows
        zero, speed, turning, centre, _, slows, _ = np.median(windows, axis=1).tolist()
        by_brake = slows - self._vehicle.resistance.force(speed) / self._vehicle.effective_mass
        slowed = by_brake > _BRAKED_SHARE * zero / (self._radius * self._vehicle.effective_mass)
        if zero >= _LEAST_BRAKE * self._radius * centre and slowed:
            return None
        slip = 1.0 - self._radius * omega / v
        # rounding averages out over a window if the encoder's reading changes; a constant reading keeps its error
        rounding = omega_step / _UNIFORM / (self._size if moves.any() else 1.0)
        of_steps = math.hypot(self._radius * rounding, speed_step / _UNIFORM) / speed
        return Rolling(
            slip=float(np.median(slip)),
            slip_error=math.hypot(_error_of_median(slip), of_steps),
            torque=zero,
            torque_error=_error_of_median(torque),
            speed=speed,
            omega=turning,
            load=centre,
            deceleration=slows,
            freedom=max(len(slip) / 2.0 - 1.0, 1.0),
        )

    def _lowest(self) -> Floats | None:
        """Windows of the lowest torque level that has enough windows; None if no level has enough."""
        windows = self._windows[:, np.argsort(self._windows[0])]
        torque, _, _, load, noise, _, _ = windows
        least = max(_LEAST_WINDOWS, math.ceil(_LEAST_SHARE * len(torque)))
        if len(torque) < least:
            return None
        reach = torque + np.maximum(_STEADY_MU * self._radius * load, 2.0 * _STEADY * noise)
        ends = np.searchsorted(torque, reach, side="right")
        enough = np.flatnonzero(ends - np.arange(len(torque)) >= least)
        return windows[:, enough[0] : ends[enough[0]]] if len(enough) else None


def _is_steady(time: Floats, values: Floats, least: Floats) -> Flags:
    x = 2.0 * (time - time.mean(axis=1, keepdims=True)) / np.ptp(time, axis=1)[:, None]  # -1 to 1
    bend = x**2 - np.mean(x**2, axis=1, keepdims=True)
    noise = np.mean(np.diff(values, axis=1) ** 2, axis=1) / 2.0
    steady = np.ones(len(time), dtype=bool)
    for shape in (x, bend):
        squares = np.sum(shape**2, axis=1)
        change = 2.0 * np.abs(np.sum(shape * values, axis=1)) / squares
        steady &= change <= np.maximum(least, 2.0 * _STEADY * np.sqrt(noise / squares))
    return steady


def _error_of_median(values: Floats) -> float:
    scatter = _SIGMA_PER_MAD * float(np.median(np.abs(values - np.median(values))))
    return _MEDIAN * scatter / math.sqrt(max(len(values) / 2.0, 1.0))


# --- findings from free rolling ------------------------------------------------------------------------------------

_FALSE_ALARM = 0.001  # false-alarm probability of a finding
_LEAST_SLIP = 5e-4  # slip ratio due to 0.2 mm of the radius; a smaller slip may be an error of the log's speeds
_LEAST_OF_PEAK = 0.003  # of the slip at the peak; a smaller slip shifts a fit by less than its errors
_LEAST_MU = 0.001  # torque offset over wheel load times radius; a smaller one is within the errors of a good fit
_OTHER_UNIT = 0.15  # slip ratio; wear of the wheel causes less, so a larger slip is due to a wrong unit
MOST_FREE_SLIP = 0.5  #: slip ratio in free rolling beyond which a log is refused; no error of a radius is so large

_UNITS_APART = ((1.0 / KMH, "km/h and m/s"), (30.0 / math.pi, "rpm and rad/s"), (2.0 * math.pi, "turns and radians"))
_EQUAL = 0.05  # largest relative difference of equal ratios; larger than usual errors of the radius
_MOST_CREEP = 0.002  # upper limit of the computed creep, slip ratio, because a wrong radius distorts the slope used
_UNTRUSTED = 0.005  # slip ratio in free rolling beyond which other checks of the log are unreliable
_EXPLAINED = 0.25  # of the slip: a given zero is the cause if less than this share of the slip remains without the zero


@dataclass(frozen=True)
class Known:
    """Vehicle, features of the adhesion curve and corrections by the user, with which free rolling is judged."""

    vehicle: Vehicle
    slope: float  # dmu/dslip at low slip; inf if not known
    peak_slip: float  # slip ratio; 0 if not known
    wheel_column: str  # quantity from which the wheel speed was read
    zeros: Mapping[str, float]  # subtracted sensor offsets, SI, by quantity

    def creep(self, rolling: Rolling) -> float:
        """Slip ratio at which the adhesion force on an unbraked wheel balances the wheel's friction and inertia."""
        if not self.slope > 0.0:
            return 0.0
        vehicle, radius = self.vehicle, self.vehicle.wheel.radius
        friction = vehicle.effective_viscous_friction * rolling.omega / radius
        force = friction - vehicle.effective_inertia * rolling.deceleration / radius**2
        return min(max(force / (rolling.load * self.slope), -_MOST_CREEP), _MOST_CREEP)

    def tolerance(self, rolling: Rolling) -> float:
        least = max(_LEAST_SLIP, _LEAST_OF_PEAK * self.peak_slip)
        return max(rolling.critical_value * rolling.slip_error + abs(self.creep(rolling)), least)


def is_wrong_wheel(rolling: Rolling | None) -> bool:
    """True if the slip in free rolling is so large that other checks of the log are unreliable."""
    return rolling is not None and abs(rolling.slip) > max(_UNTRUSTED, rolling.critical_value * rolling.slip_error)


def rolling_findings(rolling: Rolling | None, known: Known) -> Iterator[Finding]:
    """Yield findings if slip or torque in free rolling are too large."""
    if rolling is None:
        return
    if abs(rolling.slip - known.creep(rolling)) > known.tolerance(rolling):
        yield Finding("free rolling", _wrong_wheel(rolling, known))
    load = known.vehicle.wheel.radius * rolling.load
    if abs(rolling.torque) >= max(_LEAST_MU * load, rolling.critical_value * rolling.torque_error):
        given = known.zeros.get("brake_torque", 0.0)
        beside = f" {message('offset given', zero=given)}" if given else ""
        nothing = abs(rolling.torque + given) < _LEAST_MU * load
        option = message("offset, none" if nothing else "offset, another", zero=rolling.torque + given)
        text = message("torque offset", torque=rolling.torque, mu=rolling.torque / load, beside=beside, option=option)
        yield Finding("torque offset", text)


def _wrong_wheel(rolling: Rolling, known: Known) -> str:
    radius, slip = known.vehicle.wheel.radius, rolling.slip
    digits = 3 - 1 - math.floor(math.log10(abs(100.0 * slip)))  # three significant, fewer if the error is large
    if rolling.slip_error > 0.0:
        digits = min(digits, max(-math.floor(math.log10(100.0 * rolling.slip_error)), 1))
    shown = f"free rolling shows a slip of {100.0 * slip:.{max(digits, 1)}f} %"
    # slip without each of the given zeros
    rim, speed = radius * rolling.omega, rolling.speed
    on_rim = radius if known.wheel_column == "wheel_angular_speed" else 1.0
    speed_ratios = {
        "train_speed": lambda zero: rim / (speed + zero),
        known.wheel_column: lambda zero: (rim + zero * on_rim) / speed,
    }
    for name, zero in known.zeros.items():
        without = 1.0 - speed_ratios[name](zero) if name in speed_ratios else math.inf
        if abs(without) < max(known.tolerance(rolling), _EXPLAINED * abs(slip)):
            return shown + message("zero makes slip", name=name, zero=zero, percent=100.0 * without)
    likely = message("other radius", likely=radius / (1.0 - slip + known.creep(rolling)), radius=radius)
    ratio = 1.0 - slip
    if abs(slip) < _OTHER_UNIT:
        return f"{shown}: {likely}"
    apart = next((f" ({units} are {x:.3g} apart)" for x, units in _UNITS_APART if _is_ratio(abs(ratio), x)), "")
    text = shown + message("other units", ratio=ratio, column=known.wheel_column, apart=apart)
    return f"{text}; otherwise {likely}" if abs(slip) <= MOST_FREE_SLIP else text


def _is_ratio(ratio: float, factor: float) -> bool:
    return min(abs(ratio * factor - 1.0), abs(ratio / factor - 1.0)) < _EQUAL


def rolling_fault(rolling: Rolling | None, known: Known) -> str | None:
    """Return a message if the slip in free rolling is so large that the log cannot be used; else None."""
    if rolling is None or abs(rolling.slip) <= MOST_FREE_SLIP:
        return None
    return _wrong_wheel(rolling, known)


# --- the adhesion --------------------------------------------------------------------------------------------------

HIGHEST_MU, LOWEST_MU = 0.7, 0.01  #: plausible range of steel on steel: about 0.6 with sand, 0.02 with leaves

MU_RANGE = {"least": LOWEST_MU, "most": HIGHEST_MU}  #: this range, as arguments of messages

_UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {"brake_torque": {"N*m": 1.0, "kN*m": 1e3}, "wheel_load": {"N": 1.0, "kN": 1e3}}
)


def unit_hint(mu: float, factors: Mapping[str, float]) -> str:
    """Suggest a unit of torque or load that would make the adhesion coefficient `mu` plausible; empty if none does.

    `factors` maps each quantity to the SI value of the unit in which its column is read.
    """
    hints, other = [], math.nan
    for quantity, units in _UNITS.items():
        for unit, factor in units.items():
            ratio = factor / factors.get(quantity, factor)
            made = mu * ratio if quantity == "brake_torque" else mu / ratio
            if ratio != 1.0 and LOWEST_MU <= made <= HIGHEST_MU:
                hints.append(f"{quantity} seems to be in {unit} (`units` {quantity}={unit})")
                other = made
    return f"{', or '.join(hints)}, which would make this value {other:.2g}" if hints else ""


def units_or(mu: float, factors: Mapping[str, float]) -> str:
    """Return the result of `unit_hint`, or general advice if this result is empty."""
    return unit_hint(mu, factors) or message("check the units")


def mu_findings(mean_mu: Floats, factors: Mapping[str, float]) -> Iterator[Finding]:
    """Yield a finding if the highest `mean_mu` of all bins is implausible for steel on steel."""
    highest = float(mean_mu.max(initial=-math.inf))
    if not LOWEST_MU <= highest <= HIGHEST_MU:
        yield Finding("adhesion", message("highest mean mu", mu=highest, **MU_RANGE, cause=units_or(highest, factors)))


# --- the train's deceleration, and the unit of the time ------------------------------------------------------------

_OTHER_DECELERATION = 1.15  # plausible ratio; errors of mass, load and forces outside the model are smaller
_SLOWED_DOWN = 0.02  # least share of its speed that the train must lose; a rig at constant speed cannot be checked
_OTHER_TIME_UNIT = 200.0  # ratio of decelerations that indicates a wrong time unit; s for ms gives at least 1000
_TIME_UNITS = {"us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}  # s
_PULL_RANGE = (0.02, 1.0)  # highest brake torque over wheel load times radius; outside, the torque's unit is wrong


def _speed_lost(record: BrakedRows) -> float:
    """Speed that the train loses, summed over all runs, m/s; NaN if the sum is too small for a check."""
    inside, begins = np.diff(record.run) == 0, np.flatnonzero(np.diff(record.run, prepend=-1))
    lost = -float(np.diff(record.speed)[inside].sum())
    return lost if lost > _SLOWED_DOWN * float(record.speed[begins].sum()) else math.nan


def deceleration_ratio(record: BrakedRows, vehicle: Vehicle) -> float:
    """Ratio of the train's measured deceleration to the deceleration expected from adhesion and resistance.

    The adhesion follows from the wheel's equation of motion, (3) of [Park2008], and the expected deceleration from the
    train's equation of motion, (4). NaN if the train hardly slows down or the expected deceleration is not positive.
    """
    inside = np.diff(record.run) == 0
    step = np.diff(record.time)[inside]
    v, omega, torque = ((x[1:] + x[:-1])[inside] / 2.0 for x in (record.speed, record.omega, record.torque))
    turned = -float(np.diff(record.omega)[inside].sum())
    adhesion = float(step @ (torque + vehicle.effective_viscous_friction * omega)) - vehicle.effective_inertia * turned
    resistance = float(step @ vehicle.resistance.force(v))
    expected = (adhesion / vehicle.wheel.radius + resistance) / vehicle.effective_mass
    return _speed_lost(record) / expected if expected > 0.0 else math.nan


def deceleration_differs(ratio: float) -> bool:
    """True if a ratio from `deceleration_ratio` is not plausible; False if it is NaN."""
    return not math.isnan(ratio) and not 1.0 / _OTHER_DECELERATION < ratio < _OTHER_DECELERATION


def time_fault(record: BrakedRows, vehicle: Vehicle, highest_pull: float, unit: float) -> str | None:
    """Return a message if the time of the log seems to have another unit than assumed; else None.

    The speed lost by the train is compared with the loss expected from the brake torque of one wheel and the mass
    of the quarter car. `highest_pull` is the largest ratio of brake torque to wheel load times radius. `unit` is the
    assumed unit, s.
    """
    if not len(record) or not _PULL_RANGE[0] < highest_pull < _PULL_RANGE[1]:
        return None
    impulse = float((np.diff(record.time) * record.torque[1:])[np.diff(record.run) == 0].sum())
    ratio = _speed_lost(record) * vehicle.wheel.radius * vehicle.effective_mass / impulse if impulse > 0.0 else math.nan
    if math.isnan(ratio) or 1.0 / _OTHER_TIME_UNIT < ratio < _OTHER_TIME_UNIT:
        return None
    likely = min(_TIME_UNITS, key=lambda name: abs(math.log(_TIME_UNITS[name] / (unit * ratio))))
    read = next((name for name, clock in _TIME_UNITS.items() if math.isclose(clock, unit)), f"units of {unit:.3g} s")
    less, times = ("less", 1.0 / ratio) if ratio < 1.0 else ("more", ratio)
    return message("other clock", ratio=times, less=less, likely=likely, read=read)


# --- loads, two wheel speeds, steps --------------------------------------------------------------------------------

_OTHER_LOAD = 1.5  # plausible ratio of the log's wheel load to the vehicle's; empty and full trains differ by less
_OTHER_SPEED = 0.02  # plausible relative difference of a wheel's two speeds; wear of the wheel causes less
_COARSE = 0.005  # in slip ratio or mu, as the lowest slip used (`SLIP_RANGE`); a smaller step does not matter

LOADS_DIFFER = 1.05  #: least ratio of two mean wheel loads that are reported as different


def load_findings(record: BrakedRows, of_vehicle: float) -> Iterator[Finding]:
    """Yield findings if the wheel load differs from run to run, or from the vehicle's wheel load `of_vehicle`, N."""
    if not len(record):
        return
    run = record.run.astype(np.int64)
    rows = np.bincount(run)
    loads = np.bincount(run, record.load)[rows > 0] / rows[rows > 0]
    if loads.min() * LOADS_DIFFER < loads.max():
        mean = np.average(loads, weights=rows[rows > 0])
        yield Finding("loads", message("loads of runs", least=loads.min(), most=loads.max(), mean=mean))
    logged = float(record.load.mean())
    if not of_vehicle / _OTHER_LOAD < logged < of_vehicle * _OTHER_LOAD:
        yield Finding("load", message("other load", logged=logged, of_vehicle=of_vehicle))


class WheelSpeeds:
    """Compares wheel speed and angular speed in a log that has both, by a least-squares line through 0."""

    def __init__(self) -> None:
        self._product = self._square = 0.0

    def add(self, rows: Rows) -> None:
        rim, angular = rows.columns.get("wheel_speed"), rows.columns.get("wheel_angular_speed")
        if rim is not None and angular is not None:
            self._product += float(rim @ angular)
            self._square += float(angular @ angular)

    def findings(self, radius: float) -> Iterator[Finding]:
        """Yield a finding if the two speeds disagree for the wheel `radius`, m."""
        ratio = self._product / (radius * self._square) if self._square > 0.0 else math.nan
        if abs(ratio - 1.0) > _OTHER_SPEED:
            yield Finding("wheel speeds", message("two wheel speeds", ratio=ratio))


@dataclass(frozen=True)
class ColumnStep:
    """Quantisation step of a column of a log, and its effect on the slip ratio or on mu."""

    label: str  # header of the column
    step: float  # in the unit of the file
    share: float  # change of the slip ratio at the initial speed, or of mu for a torque, by one step
    is_torque: bool

    @property
    def matters(self) -> bool:
        return self.share >= _COARSE

    def __str__(self) -> str:
        of_mu, of_slip = f"{self.share:.2g} of mu", f"{100.0 * self.share:.2g} % of slip at the initial speed"
        return f"{self.label!r} in steps of {self.step:.4g}, {of_mu if self.is_torque else of_slip}"


def column_steps(
    resolution: Resolution, columns: Mapping[str, Column], radius: float, speed: float, load: float
) -> tuple[ColumnStep, ...]:
    """Return the quantisation step of each quantised column of a log.

    `resolution` contains the steps, SI, and `columns` the columns of the file, both by quantity. The effect of a step
    on slip and mu is computed with wheel `radius`, m, initial `speed`, m/s, and wheel `load`, N.
    """
    shares = {"train_speed": 1.0 / speed, "wheel_speed": 1.0 / speed, "wheel_angular_speed": radius / speed}
    steps = []
    for name, share in (*shares.items(), ("brake_torque", 1.0 / (radius * load))):
        if step := resolution[name]:
            column = columns.get(name)
            label, factor = (f"{name} [{UNITS[name]}]", 1.0) if column is None else (column.header, column.factor)
            steps.append(ColumnStep(label, step / factor, step * share, name == "brake_torque"))
    return tuple(steps)


# --- findings from the statistics of the log -----------------------------------------------------------------------

_LEAST_LOST = 0.01  # a smaller share of the braking rows lost to settling is not reported


def survey_findings(survey: Survey) -> Iterator[Finding]:
    """Yield findings on impossible rows, gaps, unused braking rows and different initial speeds."""
    if survey.implausible:
        yield Finding("rows", message("impossible rows", survey=survey))
    if survey.bridged:
        yield Finding("gaps", message("bridged", survey=survey))
    yield from (Finding("gaps", message("gap", line=line, seconds=seconds)) for line, seconds in survey.gaps)
    if survey.gap_count > len(survey.gaps):
        yield Finding("gaps", f"{survey.gap_count} gaps in all")
    if survey.lost_share >= _LEAST_LOST:
        yield Finding("settling", message("settling", percent=100.0 * survey.lost_share, rows=survey.lost))
    if survey.is_mixed:
        slowest, fastest, v0 = (x / KMH for x in (survey.slowest_start, survey.fastest_start, survey.initial_speed))
        yield Finding("initial speed", message("initial speeds", slowest=slowest, fastest=fastest, v0=v0))
