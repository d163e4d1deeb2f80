"""What is met while a log is observed, and what is said of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_MOST_NAMED = 5
_LEAST_LOST = 0.01  # share of the braking rows lost to settling from which it is told

# Free rolling: slips beyond are a wheel recovering, not a wrong radius. Noise of the pickups averages out far below
# the slip told, and the viscous friction of a released wheel asks for 1e-4 or so.
_FREE_RANGE = 0.2
_FREE_BINS = 4000
_LEAST_FREE_ROWS = 20
_LEAST_FREE_SLIP = 0.005
_NARROW = 0.5  # share of the median within which half the slips lie; of a wheel recovering evenly it is 1


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

    def warnings(self, free: FreeRolling, radius: float) -> tuple[str, ...]:
        """What was wrong, a sentence each; `radius` is the wheel's, m."""
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
        slip = free.slip
        if slip is not None and abs(slip) >= _LEAST_FREE_SLIP:
            likely = radius / (1.0 - slip)
            found.append(
                f"free rolling shows a slip of {100.0 * slip:.1f} %: the wheel radius may be {likely:.4g} m, "
                f"not {radius:.4g} m"
            )
        return tuple(found)


class FreeRolling:
    """Slip ratios of a wheel without brake, counted by size; the result does not depend on how they come."""

    def __init__(self) -> None:
        self._counts = np.zeros(_FREE_BINS, dtype=np.int64)

    def add(self, slip: Floats) -> None:
        """Take slip ratios in; those out of range are a wheel recovering."""
        place = np.floor((slip / _FREE_RANGE + 1.0) * (_FREE_BINS / 2))
        inside = (place >= 0) & (place < _FREE_BINS)
        self._counts += np.bincount(place[inside].astype(np.int64), minlength=_FREE_BINS)

    @property
    def slip(self) -> float | None:
        """The median; None where there are too few, or they spread as those of a wheel recovering."""
        if self._counts.sum() < _LEAST_FREE_ROWS:
            return None
        share = np.concatenate([[0.0], np.cumsum(self._counts) / self._counts.sum()])
        edges = np.linspace(-_FREE_RANGE, _FREE_RANGE, _FREE_BINS + 1)
        low, median, high = (float(each) for each in np.interp([0.25, 0.5, 0.75], share, edges))
        return median if high - low < _NARROW * abs(median) else None
