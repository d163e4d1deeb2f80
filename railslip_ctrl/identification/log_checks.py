"""Can a log be right? What it shows of itself that does not fit: a list of `Finding`s.

Rolling without brake: a released brake has no torque and a wheel without torque no slip, so that what the columns read
there is a torque's offset and a wrong wheel radius. The adhesion: beside what steel on steel has. The train: whether it
slows down as its wheel's adhesion makes it. The clock, the steps in which columns come, wheel loads.
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
from .observed import LOWEST_SPEED, BrakedRows, Survey
from .words import told


@dataclass(frozen=True)
class Finding:
    """Something of a log that is not as it should be: the `check` that found it, and a sentence."""

    check: str
    text: str


# --- rolling without brake: where torque and slip stand still, at the lowest torque at which there are some ----------


_SECONDS, _LEAST_ROWS = 0.2, 16  # of a window, whichever is longer
_ROUNDING = 1e-6  # of an interval that a median of differences leaves
_GAP_INTERVALS = 5.0
_MOST_WINDOWS = 8192
_ABSURD = 1e12  # of any column in SI: no measurement, and its square may leave the range of doubles

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
    """What the wheel showed while it rolled freely, SI: slip ratio and brake torque with their standard errors.

    The others are medians; `freedom` are degrees of freedom of the errors.
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
    """Windows of rows in which torque and slip stand still, `_MOST_WINDOWS` at most, spread over the log.

    Rows come in blocks of any size.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle, self._radius = vehicle, vehicle.wheel.radius
        self._rows = np.empty((5, 0))
        self._interval, self._size = math.nan, 0  # s; rows of a window, once there are some
        self._windows = np.empty((7, 0))  # columns as of `_steady`
        self._stride, self._seen = 1, 0

    def add(self, rows: Floats) -> None:
        """Take rows in: 5 by k, s, m/s, rad/s, N*m, N, time growing also from block to block."""
        rows = np.concatenate([self._rows, rows[:, np.all(np.abs(rows[1:]) < _ABSURD, axis=0)]], axis=1)
        if rows.shape[1] < 2:
            self._rows = rows
            return
        if not self._size:
            self._interval = float(np.median(np.diff(rows[0])))
            self._size = max(_LEAST_ROWS, math.ceil(_SECONDS / self._interval - _ROUNDING))
        cuts = np.flatnonzero(np.diff(rows[0]) > _GAP_INTERVALS * self._interval) + 1
        hop = self._size // 2  # windows lie half over each other
        for part in np.split(rows, cuts, axis=1):
            count = max((part.shape[1] - self._size) // hop + 1, 0)
            if count:
                views = np.lib.stride_tricks.sliding_window_view(part, self._size, axis=1)
                self._keep(self._steady(views[:, : (count - 1) * hop + 1 : hop]))
            self._rows = part[:, count * hop :]  # that the next window begins with

    def _steady(self, views: Floats) -> Floats:
        """What is kept of the windows (5, m, rows) that are steady."""
        rolling = (views[1] > LOWEST_SPEED).all(axis=1) & (views[4] > 0.0).all(axis=1)
        time, v, omega, torque, load = views[:, rolling]
        slip = 1.0 - self._radius * omega / v
        still = _stands(time, slip, np.full(len(time), _STEADY_SLIP))
        still &= _stands(time, torque, _STEADY_MU * self._radius * load.mean(axis=1))
        time, v, omega, torque, load = (x[still] for x in (time, v, omega, torque, load))
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

    def found(self, *, speed_step: float = 0.0, omega_step: float = 0.0) -> Rolling | None:
        """What was seen, with speeds that come in steps (m/s, rad/s); None where the wheel never rolled freely."""
        windows = self._lowest()
        if windows is None:
            return None
        torque, v, omega, _, _, _, moves = windows
        zero, speed, turning, centre, _, slows, _ = np.median(windows, axis=1).tolist()
        by_brake = slows - self._vehicle.resistance.force(speed) / self._vehicle.effective_mass
        slowed = by_brake > _SLOWED * zero / (self._radius * self._vehicle.effective_mass)
        if zero >= _BRAKES * self._radius * centre and slowed:
            return None
        slip = 1.0 - self._radius * omega / v
        # an encoder's counts add up over a window; a speed that stands still may be off by its rounding all along
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
        """The windows at the lowest torque at which there are enough of them."""
        windows = self._windows[:, np.argsort(self._windows[0])]
        torque, _, _, load, noise, _, _ = windows
        least = max(_LEAST_WINDOWS, math.ceil(_LEAST_SHARE * len(torque)))
        if len(torque) < least:
            return None
        reach = torque + np.maximum(_STEADY_MU * self._radius * load, 2.0 * _STEADY * noise)
        ends = np.searchsorted(torque, reach, side="right")
        enough = np.flatnonzero(ends - np.arange(len(torque)) >= least)
        return windows[:, enough[0] : ends[enough[0]]] if len(enough) else None


def _stands(time: Floats, values: Floats, least: Floats) -> Flags:
    """In which windows values neither rise nor bend, beyond the noise of neighbours or a least change."""
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
MOST_FREE_SLIP = 0.5  #: slip ratio of a wheel without brake beyond which a log is refused: no radius is so wrong

_UNITS_APART = ((1.0 / KMH, "km/h and m/s"), (30.0 / math.pi, "rpm and rad/s"), (2.0 * math.pi, "turns and radians"))
_ALIKE = 0.05  # relative, of a ratio: more than a radius is wrong by
_MOST_CREEP = 0.002  # of a wheel without brake, if a wrong wheel has bent the curve that its slope is taken from
_UNTRUSTED = 0.005  # slip ratio
_EXPLAINED = 0.25  # of the slip that is left without a zero that was given, below which the zero is the cause


@dataclass(frozen=True)
class Known:
    """What rolling is judged by: the vehicle, and what the log and its user say.

    `slope` is dmu/dslip where the curve begins, inf where it is not known, as `peak_slip` is 0; `wheel_column` the
    quantity that the wheel's speed was read from, `zeros` the offsets that were taken off, SI.
    """

    vehicle: Vehicle
    slope: float
    peak_slip: float
    wheel_column: str
    zeros: Mapping[str, float]

    def creep(self, rolling: Rolling) -> float:
        """Slip ratio that the rail needs to turn the wheel against its friction, and to slow it down."""
        if not self.slope > 0.0:
            return 0.0
        vehicle, radius = self.vehicle, self.vehicle.wheel.radius
        friction = vehicle.effective_viscous_friction * rolling.omega / radius
        force = friction - vehicle.effective_inertia * rolling.deceleration / radius**2
        return min(max(force / (rolling.load * self.slope), -_MOST_CREEP), _MOST_CREEP)

    def tolerance(self, rolling: Rolling) -> float:
        """Slip ratio beside `creep` up to which free rolling is as it should be."""
        least = max(_LEAST_SLIP, _LEAST_OF_PEAK * self.peak_slip)
        return max(rolling.sure * rolling.slip_error + abs(self.creep(rolling)), least)


def is_wrong_wheel(rolling: Rolling | None) -> bool:
    """Whether a rolling wheel has so much slip that what else a log shows is not to be trusted."""
    return rolling is not None and abs(rolling.slip) > max(_UNTRUSTED, rolling.sure * rolling.slip_error)


def rolling_findings(rolling: Rolling | None, known: Known) -> Iterator[Finding]:
    """What a wheel without brake shows to be wrong."""
    if rolling is None:
        return
    if abs(rolling.slip - known.creep(rolling)) > known.tolerance(rolling):
        yield Finding("free rolling", _wrong_wheel(rolling, known))
    load = known.vehicle.wheel.radius * rolling.load
    if abs(rolling.torque) >= max(_LEAST_MU * load, rolling.sure * rolling.torque_error):
        given = known.zeros.get("brake_torque", 0.0)
        beside = f" {told('offset given', zero=given)}" if given else ""
        nothing = abs(rolling.torque + given) < _LEAST_MU * load
        option = told("offset, none" if nothing else "offset, another", zero=rolling.torque + given)
        text = told("torque offset", torque=rolling.torque, mu=rolling.torque / load, beside=beside, option=option)
        yield Finding("torque offset", text)


def _wrong_wheel(rolling: Rolling, known: Known) -> str:
    radius, slip = known.vehicle.wheel.radius, rolling.slip
    digits = 3 - 1 - math.floor(math.log10(abs(100.0 * slip)))  # as many as its error leaves, three at most
    if rolling.slip_error > 0.0:
        digits = min(digits, max(-math.floor(math.log10(100.0 * rolling.slip_error)), 1))
    shown = f"free rolling shows a slip of {100.0 * slip:.{max(digits, 1)}f} %"
    # the slip with a speed's zero put on again
    rim, speed = radius * rolling.omega, rolling.speed
    on_rim = radius if known.wheel_column == "wheel_angular_speed" else 1.0
    again = {
        "train_speed": lambda zero: rim / (speed + zero),
        known.wheel_column: lambda zero: (rim + zero * on_rim) / speed,
    }
    for name, zero in known.zeros.items():
        without = 1.0 - again[name](zero) if name in again else math.inf
        if abs(without) < max(known.tolerance(rolling), _EXPLAINED * abs(slip)):
            return shown + told("zero makes slip", name=name, zero=zero, percent=100.0 * without)
    likely = told("other radius", likely=radius / (1.0 - slip + known.creep(rolling)), radius=radius)
    ratio = 1.0 - slip
    if abs(slip) < _OTHER_UNIT:
        return f"{shown}: {likely}"
    apart = next((f" ({units} are {x:.3g} apart)" for x, units in _UNITS_APART if _is_ratio(abs(ratio), x)), "")
    text = shown + told("other units", ratio=ratio, column=known.wheel_column, apart=apart)
    return f"{text}; else {likely}" if abs(slip) <= MOST_FREE_SLIP else text


def _is_ratio(ratio: float, factor: float) -> bool:
    """Whether a ratio of units is a factor, or one over it."""
    return min(abs(ratio * factor - 1.0), abs(ratio / factor - 1.0)) < _ALIKE


def rolling_fault(rolling: Rolling | None, known: Known) -> str | None:
    """A sentence where a wheel without brake has so much slip that no curve can be had from the log; else None."""
    if rolling is None or abs(rolling.slip) <= MOST_FREE_SLIP:
        return None
    return _wrong_wheel(rolling, known)


# --- the adhesion --------------------------------------------------------------------------------------------------

HIGHEST_MU, LOWEST_MU = 0.7, 0.01  #: adhesion coefficients of steel on steel: some 0.6 with sand, 0.02 with leaves

ORDINARY = {"least": LOWEST_MU, "most": HIGHEST_MU}  #: these two, as sentences name them

_UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {"brake_torque": {"N*m": 1.0, "kN*m": 1e3}, "wheel_load": {"N": 1.0, "kN": 1e3}}
)


def unit_hint(mu: float, factors: Mapping[str, float]) -> str:
    """The option with a unit that makes an adhesion coefficient an ordinary one; empty where none does.

    `factors` are what one of the unit that was read is in SI, by quantity, of the columns of the log.
    """
    found, other = [], math.nan
    for quantity, units in _UNITS.items():
        for unit, factor in units.items():
            ratio = factor / factors.get(quantity, factor)
            made = mu * ratio if quantity == "brake_torque" else mu / ratio
            if ratio != 1.0 and LOWEST_MU <= made <= HIGHEST_MU:
                found.append(f"{quantity} seems to be in {unit} (`units` {quantity}={unit})")
                other = made
    return f"{', or '.join(found)}, which would make it {other:.2g}" if found else ""


def units_or(mu: float, factors: Mapping[str, float]) -> str:
    """`unit_hint`, or what to check else."""
    return unit_hint(mu, factors) or told("check the units")


def mu_findings(mean_mu: Floats, factors: Mapping[str, float]) -> Iterator[Finding]:
    """Whether the highest mean of mu, by bins, is one of steel on steel; `factors` as of `unit_hint`."""
    highest = float(mean_mu.max(initial=-math.inf))
    if not LOWEST_MU <= highest <= HIGHEST_MU:
        yield Finding("adhesion", told("highest mean mu", mu=highest, **ORDINARY, cause=units_or(highest, factors)))


# --- the train's deceleration, and the unit of the time ------------------------------------------------------------

_OTHER_DECELERATION = 1.15  # ratio: mass, load and the pull of what is not in the model are known to less
_SLOWED_DOWN = 0.02  # of its speed that the train loses in the runs: on a rig that keeps its speed this tells nothing
_OTHER_CLOCK = 200.0  # ratio of decelerations; of s and ms it is 1000, and a train brakes with more than the one wheel
_CLOCKS = {"us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}  # s
_PULLS = (0.02, 1.0)  # highest brake torque by wheel load and radius: else the torque's unit is what is wrong


def _lost(record: BrakedRows) -> float:
    """Speed that the train loses in the runs, m/s; NaN where that is hardly any."""
    inside, begins = np.diff(record.run) == 0, np.flatnonzero(np.diff(record.run, prepend=-1))
    lost = -float(np.diff(record.speed)[inside].sum())
    return lost if lost > _SLOWED_DOWN * float(record.speed[begins].sum()) else math.nan


def deceleration_ratio(record: BrakedRows, vehicle: Vehicle) -> float:
    """By how much more the train slows down in the runs than the wheel's own adhesion and the resistance make it.

    By momentum over each run, of the wheel (3) and of the train (4) [Park2008]. NaN where the train hardly slows down,
    or no torque is left for the adhesion.
    """
    inside = np.diff(record.run) == 0
    step = np.diff(record.time)[inside]
    v, omega, torque = ((x[1:] + x[:-1])[inside] / 2.0 for x in (record.speed, record.omega, record.torque))
    turned = -float(np.diff(record.omega)[inside].sum())
    adhesion = float(step @ (torque + vehicle.effective_viscous_friction * omega)) - vehicle.effective_inertia * turned
    resistance = float(step @ vehicle.resistance.force(v))
    asked = (adhesion / vehicle.wheel.radius + resistance) / vehicle.effective_mass
    return _lost(record) / asked if asked > 0.0 else math.nan


def deceleration_differs(ratio: float) -> bool:
    """Whether a ratio of decelerations is another than 1; not where it is not known."""
    return not math.isnan(ratio) and not 1.0 / _OTHER_DECELERATION < ratio < _OTHER_DECELERATION


def time_fault(record: BrakedRows, vehicle: Vehicle, highest_pull: float, read: float) -> str | None:
    """A sentence where the train slows down as if its time had another unit than it is `read` in, s; else None.

    The speed lost in the runs under brake is set against that by the brake torque on the vehicle's mass, each wheel its
    own. `highest_pull` as of `Survey`.
    """
    if not len(record) or not _PULLS[0] < highest_pull < _PULLS[1]:
        return None
    asked = float((np.diff(record.time) * record.torque[1:])[np.diff(record.run) == 0].sum())
    ratio = _lost(record) * vehicle.wheel.radius * vehicle.effective_mass / asked if asked > 0.0 else math.nan
    if math.isnan(ratio) or 1.0 / _OTHER_CLOCK < ratio < _OTHER_CLOCK:
        return None
    likely = min(_CLOCKS, key=lambda unit: abs(math.log(_CLOCKS[unit] / (read * ratio))))
    now = next((unit for unit, clock in _CLOCKS.items() if math.isclose(clock, read)), f"units of {read:.3g} s")
    less, times = ("less", 1.0 / ratio) if ratio < 1.0 else ("more", ratio)
    return told("other clock", ratio=times, less=less, likely=likely, read=now)


# --- loads, two wheel speeds, steps --------------------------------------------------------------------------------

_OTHER_LOAD = 1.5  # ratio of the log's wheel load to the vehicle's: empty and full trains differ by less
_OTHER_SPEED = 0.02  # ratio of two speeds of a wheel, less one: more than wear of its radius
_COARSE = 0.005

LOADS_DIFFER = 1.05
"""Ratio of mean wheel loads beyond which they are not one: within it a train's load varies with its passengers."""


def load_findings(record: BrakedRows, of_vehicle: float) -> Iterator[Finding]:
    """Whether the runs have one wheel load, and one near to that of the vehicle, N."""
    if not len(record):
        return
    run = record.run.astype(np.int64)
    rows = np.bincount(run)
    loads = np.bincount(run, record.load)[rows > 0] / rows[rows > 0]
    if loads.min() * LOADS_DIFFER < loads.max():
        mean = np.average(loads, weights=rows[rows > 0])
        yield Finding("loads", told("loads of runs", least=loads.min(), most=loads.max(), mean=mean))
    logged = float(record.load.mean())
    if not of_vehicle / _OTHER_LOAD < logged < of_vehicle * _OTHER_LOAD:
        yield Finding("load", told("other load", logged=logged, of_vehicle=of_vehicle))


class WheelSpeeds:
    """The two speeds of a wheel, where a log has both: their ratio by a straight line through 0 over all rows."""

    def __init__(self) -> None:
        self._product = self._square = 0.0

    def add(self, rows: Rows) -> None:
        """Take rows in."""
        rim, angular = rows.columns.get("wheel_speed"), rows.columns.get("wheel_angular_speed")
        if rim is not None and angular is not None:
            self._product += float(rim @ angular)
            self._square += float(angular @ angular)

    def findings(self, radius: float) -> Iterator[Finding]:
        """Whether they are one, of a wheel with a radius in m."""
        ratio = self._product / (radius * self._square) if self._square > 0.0 else math.nan
        if abs(ratio - 1.0) > _OTHER_SPEED:
            yield Finding("wheel speeds", told("two wheel speeds", ratio=ratio))


@dataclass(frozen=True)
class ColumnStep:
    """A column that comes in steps: its header, the step in the file's unit, and its `share`.

    The share is of slip at the initial speed, or of mu for a torque.
    """

    label: str
    step: float
    share: float
    is_torque: bool

    @property
    def matters(self) -> bool:
        """Whether the step is coarser than the lowest slips that are used, or than that of mu."""
        return self.share >= _COARSE

    def __str__(self) -> str:
        of_mu, of_slip = f"{self.share:.2g} of mu", f"{100.0 * self.share:.2g} % of slip at the initial speed"
        return f"{self.label!r} in steps of {self.step:.4g}, {of_mu if self.is_torque else of_slip}"


def column_steps(
    resolution: Resolution, columns: Mapping[str, Column], radius: float, speed: float, load: float
) -> tuple[ColumnStep, ...]:
    """The steps of the columns of a log (none: SI), at a wheel radius, m, initial speed, m/s, and wheel load, N."""
    shares = {"train_speed": 1.0 / speed, "wheel_speed": 1.0 / speed, "wheel_angular_speed": radius / speed}
    found = []
    for name, share in (*shares.items(), ("brake_torque", 1.0 / (radius * load))):
        if step := resolution[name]:
            column = columns.get(name)
            label, factor = (f"{name} [{UNITS[name]}]", 1.0) if column is None else (column.header, column.factor)
            found.append(ColumnStep(label, step / factor, step * share, name == "brake_torque"))
    return tuple(found)


# --- what was met while the log was observed -----------------------------------------------------------------------

_LEAST_LOST = 0.01  # share of the braking rows lost to settling from which it is told


def survey_findings(survey: Survey) -> Iterator[Finding]:
    """Impossible rows, gaps, braking that is not used, runs from several speeds."""
    if survey.implausible:
        yield Finding("rows", told("impossible rows", survey=survey))
    if survey.bridged:
        yield Finding("gaps", told("bridged", survey=survey))
    yield from (Finding("gaps", told("gap", line=line, seconds=seconds)) for line, seconds in survey.gaps)
    if survey.gap_count > len(survey.gaps):
        yield Finding("gaps", f"{survey.gap_count} gaps in all")
    if survey.lost_share >= _LEAST_LOST:
        yield Finding("settling", told("settling", percent=100.0 * survey.lost_share, rows=survey.lost))
    if survey.is_mixed:
        slowest, fastest, v0 = (x / KMH for x in (survey.slowest_start, survey.fastest_start, survey.initial_speed))
        yield Finding("initial speed", told("initial speeds", slowest=slowest, fastest=fastest, v0=v0))
