"""What is met while a log is observed, and what is said of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.parameters import Wheel
from railslip_ctrl.units import KMH

Floats = NDArray[np.float64]

_MOST_NAMED = 5
_LEAST_LOST = 0.01  # share of the braking rows lost to settling from which it is told

# Free rolling: slips beyond are a wheel recovering, not a wrong radius. Noise of the pickups averages out far below
# the slip told, and the viscous friction of a released wheel asks for 1e-4 or so. Of the torque's zero, by wheel load
# and radius, that is told which falsifies mu by more than the errors of a good fit.
_FREE_RANGE = 0.2
_FREE_TORQUE = 0.03
_FREE_BINS = 4001  # odd: a column that reads nought has a bin about nought
_LEAST_FREE_ROWS = 20
_LEAST_FREE_SLIP = 0.005
_LEAST_ZERO = 0.001
_NARROW = 0.5  # share of the median within which half the slips lie; of a wheel recovering evenly it is 1

# of the mean mu in a bin of slip: steel on steel has some 0.6 with sand, 0.02 with leaves
_HIGHEST_MU, _LOWEST_MU = 0.7, 0.01
_MIXED = 1.25  # ratio of the speeds at which braking begins, beyond which one v0 stands for several


@dataclass
class Survey:
    """What was met on the way.

    Attributes
    ----------
    rows, used : int
        Rows observed, and those with the brake applied in the range of slip and speed.
    runs : int
        Stretches of rows used, apart by at least the settling time.
    gaps : list of (line, seconds)
        The first gaps; the observer starts anew after each.
    gap_count, implausible : int
        All gaps; rows left out as impossible.
    bridged, longest_bridged : int, float
        Long intervals that the observer runs through, and the longest of them, s.
    lost : int
        Rows under brake that are not used, as they lie within the settling time after a gap or the log's start.
    reversed : int
        Rows with slip in range and a torque as far below 0 as braking is above.
    first_implausible : str
        The first of them.
    initial_speed : float
        Highest train speed, m/s, filtered.
    interval : float
        Median interval of the first rows, s.
    slowest_start, fastest_start : float
        Train speeds at which the runs begin, m/s; NaN without a run.
    load_sum : float
        Sum of the wheel load over the rows used, N.
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
    first_implausible: str = ""
    initial_speed: float = 0.0
    interval: float = math.nan
    slowest_start: float = math.nan
    fastest_start: float = math.nan
    load_sum: float = 0.0

    @property
    def wheel_load(self) -> float:
        """Mean wheel load of the rows used, N."""
        return self.load_sum / self.used

    @property
    def lost_share(self) -> float:
        """Of the rows under brake, those lost to settling."""
        return self.lost / max(self.lost + self.used, 1)

    def note_gap(self, line: int, seconds: float) -> None:
        """Take note of a gap before a line."""
        self.gap_count += 1
        if len(self.gaps) < _MOST_NAMED:
            self.gaps.append((line, seconds))

    @property
    def is_mixed(self) -> bool:
        """Whether the runs begin at speeds so different that one v0 stands for several."""
        return self.slowest_start * _MIXED < self.fastest_start

    def note_starts(self, speeds: Floats) -> None:
        """Take note of the train speeds at which runs begin, m/s."""
        if len(speeds):
            self.slowest_start = float(np.fmin(self.slowest_start, speeds.min()))
            self.fastest_start = float(np.fmax(self.fastest_start, speeds.max()))

    def warnings(self, free: FreeRolling, wheel: Wheel) -> tuple[str, ...]:
        """What was wrong, a sentence each."""
        found = []
        if self.implausible:
            found.append(f"{self.implausible} impossible rows left out; {self.first_implausible}")
        if self.bridged:
            found.append(
                f"{self.bridged} long intervals, up to {self.longest_bridged:.4g} s, are bridged: the observer's time "
                "constant is no shorter"
            )
        for line, seconds in self.gaps:
            found.append(f"gap of {seconds:.4g} s before line {line}: the observer starts anew")
        if self.gap_count > len(self.gaps):
            found.append(f"{self.gap_count} gaps in all")
        if self.lost_share >= _LEAST_LOST:
            found.append(
                f"{100.0 * self.lost_share:.2g} % of the braking data ({self.lost} rows) lies within the settling time "
                "after gaps or the start, and is not used"
            )
        if self.is_mixed:
            found.append(
                f"braking begins between {self.slowest_start / KMH:.4g} and {self.fastest_start / KMH:.4g} km/h: "
                f"v0, with which bristles and curve change, is taken as {self.initial_speed / KMH:.4g} km/h "
                "(--initial-speed); a log for each speed shows the change"
            )
        return (*found, *free.warnings(wheel.radius, self.wheel_load if self.used else math.nan))


def mu_warning(mean_mu: Floats) -> str | None:
    """A sentence where the mean of mu, by bins, is higher or lower than steel on steel has it; else None."""
    highest = float(mean_mu.max(initial=-math.inf))
    if _LOWEST_MU <= highest <= _HIGHEST_MU:
        return None
    return (
        f"the highest mean adhesion coefficient is {highest:.3g}, where steel on steel has {_LOWEST_MU:g} to "
        f"{_HIGHEST_MU:g}: check the unit of the brake torque, the wheel load and radius (--vehicle)"
    )


class FreeRolling:
    """Slip ratio and torque of a wheel without brake, counted by size; the result does not depend on how they come."""

    def __init__(self) -> None:
        self._slips, self._torques = _Counts(_FREE_RANGE), _Counts(_FREE_TORQUE)

    def add(self, slip: Floats, torque: Floats) -> None:
        """Take slip ratios, and torques by radius and wheel load, in; those out of range are a wheel recovering."""
        self._slips.add(slip)
        self._torques.add(torque)

    @property
    def slip(self) -> float | None:
        """The median; None where there are too few, or they spread as those of a wheel recovering."""
        if self._slips.count < _LEAST_FREE_ROWS:
            return None
        low, median, high = self._slips.quartiles()
        return median if high - low < _NARROW * abs(median) else None

    @property
    def torque(self) -> float | None:
        """The median: before a ramp there are some rows of a torque that rises. None where there are too few."""
        return self._torques.quartiles()[1] if self._torques.count >= _LEAST_FREE_ROWS else None

    def warnings(self, radius: float, wheel_load: float) -> tuple[str, ...]:
        """What a wheel without brake shows to be wrong; its radius in m, the wheel load in N."""
        found, slip, torque = [], self.slip, self.torque
        if slip is not None and abs(slip) >= _LEAST_FREE_SLIP:
            likely = radius / (1.0 - slip)
            found.append(
                f"free rolling shows a slip of {100.0 * slip:.1f} %: the wheel radius may be {likely:.4g} m, "
                f"not {radius:.4g} m"
            )
        if torque is not None and abs(torque) >= _LEAST_ZERO:
            zero = torque * radius * wheel_load
            found.append(
                f"the brake torque reads {zero:.3g} N*m where the wheel rolls freely, which is {torque:.2g} of mu: "
                f"--zero brake_torque={zero:.3g} takes it off"
            )
        return tuple(found)


class _Counts:
    """How many values lie where, in bins between minus and plus a range."""

    def __init__(self, reach: float) -> None:
        self._reach, self._counts = reach, np.zeros(_FREE_BINS, dtype=np.int64)

    @property
    def count(self) -> int:
        return int(self._counts.sum())

    def add(self, values: Floats) -> None:
        place = np.floor((values / self._reach + 1.0) * (_FREE_BINS / 2))
        inside = (place >= 0) & (place < _FREE_BINS)
        self._counts += np.bincount(place[inside].astype(np.int64), minlength=_FREE_BINS)

    def quartiles(self) -> tuple[float, float, float]:
        share = np.concatenate([[0.0], np.cumsum(self._counts) / self._counts.sum()])
        edges = np.linspace(-self._reach, self._reach, _FREE_BINS + 1)
        low, median, high = (float(each) for each in np.interp([0.25, 0.5, 0.75], share, edges))
        return low, median, high
