"""What is met while a log is observed, and what is said of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.core.units import KMH

from .record import Record

Floats = NDArray[np.float64]

_MOST_NAMED = 5
_LEAST_LOST = 0.01  # share of the braking rows lost to settling from which it is told

LOADS_DIFFER = 1.05
"""Ratio of mean wheel loads beyond which they are not one: within it a train's load varies with its passengers."""

_OTHER_LOAD = 1.5  # ratio of the log's wheel load to the vehicle's: empty and full trains differ by less
_OTHER_SPEED = 0.02  # ratio of two speeds of a wheel, less one: more than wear of its radius

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
    backward, forward : int
        Rows with a train speed below 0, and above, of more than `rolling.LOWEST_SPEED`.
    first_implausible : str
        The first of those that are impossible.
    initial_speed : float
        Highest train speed, m/s, filtered.
    interval : float
        Median interval of the first rows, s.
    slowest_start, fastest_start : float
        Train speeds at which the runs begin, m/s; NaN without a run.
    load_sum : float
        Sum of the wheel load over the rows used, N.
    regripping : int
        Rows under brake that are not used, as the brake was let go and the wheel regrips.
    highest_pull : float
        Highest brake torque of all rows by wheel load and radius: the adhesion coefficient that it asks for.
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
    regripping: int = 0
    highest_pull: float = 0.0

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

    def warnings(self) -> tuple[str, ...]:
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
                f"v0, with which the parameters change, is taken as {self.initial_speed / KMH:.4g} km/h "
                "(--initial-speed); a log for each speed shows the change"
            )
        return tuple(found)


def vehicle_load_warning(record: Record, of_vehicle: float) -> str | None:
    """A sentence where the mean wheel load of a record is far from that of the vehicle, N; else None."""
    if not len(record):
        return None
    logged = float(record.load.mean())
    if of_vehicle / _OTHER_LOAD < logged < of_vehicle * _OTHER_LOAD:
        return None
    return (
        f"the wheel load of the log is {logged:.4g} N on average, that of the vehicle {of_vehicle:.4g} N: mu is by the "
        "log's; check the unit of the column (--unit wheel_load=), and whether it is one wheel's, or the vehicle "
        "(--vehicle, --loaded)"
    )


def wheel_speeds_warning(ratio: float, other: str) -> str | None:
    """A sentence where a log's two wheel speeds are not one; `ratio` of that not used, `other`, to that used."""
    if not abs(ratio - 1.0) > _OTHER_SPEED:
        return None
    return (
        f"the log has two wheel speeds, and {other} is {ratio:.3g} times the angular speed by the wheel's radius: the "
        "angular speed is used; check the units of both and the wheel's radius (--vehicle)"
    )


def load_warning(record: Record) -> str | None:
    """A sentence where the wheel loads of a record's runs are not one; else None."""
    if not len(record):
        return None
    rows = np.bincount(record.run.astype(np.int64))
    loads = np.bincount(record.run.astype(np.int64), record.load)[rows > 0] / rows[rows > 0]
    if loads.min() * LOADS_DIFFER >= loads.max():
        return None
    return (
        f"the wheel load lies between {loads.min():.4g} and {loads.max():.4g} N from run to run: parameters that are "
        f"forces are of the mean, {np.average(loads, weights=rows[rows > 0]):.4g} N, and a law whose force does not "
        "follow the load, as bristles, fits none of them; a log for each load shows the difference"
    )
