"""Stability margins of a dead-time loop, from its crossovers and the peaks of its closed-loop responses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .crossings import Response
from .rootfinding import bracketed_roots

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]

# Phase change between the points at which |S| and |T| are looked at for peaks, rad, where |L| still matters.
_PHASE_STEP = 0.25
_SMALL = 0.02
_MOST_POINTS = 20_000
_A_CHAIN = 10**9  # unstable poles of a neutral loop beyond its limit: whatever crossed before, it is not stable
_GAINS_EQUAL = 1e-9  # two phase crossovers whose gains agree this well are one limit


@dataclass(frozen=True)
class Margins:
    """Margins of a stable loop, each the distance to instability along its own direction.

    Attributes
    ----------
    gain_increase, gain_decrease : float
        Factors > 1 and < 1 on the loop gain at which stability is lost; inf and 0.0 if it never is.
    gain_increase_frequency, gain_decrease_frequency : float
        Phase crossover they belong to, rad/s; 0 is a pole leaving through the origin, inf one at infinite
        frequency (neutral loops), NaN without a bound.
    phase_deg, phase_frequency : float
        Smallest phase change, in size, lag or lead, that destabilises, deg, over all gain crossovers, and where,
        rad/s; inf and NaN without a crossover.
    delay_s, delay_frequency : float
        Smallest added dead time that destabilises, s, over all gain crossovers; inf and NaN without one.
    ms, ms_frequency, mt, mt_frequency : float
        Peaks of |S| = |1/(1 + L)| and |T| = |L/(1 + L)| over all frequencies, and where, rad/s.
    disk, disk_frequency : float
        Balanced disk margin alpha = 1/||S - 1/2||_inf, a ratio, and where, rad/s ([Seiler2020]): gain and phase may
        change together within `disk_gain_range` and +-`disk_phase_deg`.
    gain_crossovers, phase_crossovers : array, 1-D, rad/s
        All |L| = 1; and all L < 0 real, 0 included, complete where |L| >= 1/100 (with dead time there are
        infinitely many).
    phase_margins_deg : array, 1-D
        deg, at each gain crossover, in (-180, 180]: positive is destroyed by lag, negative by lead.
    phase_crossover_gains : array, 1-D
        Factor 1/|L| at each phase crossover.
    """

    gain_increase: float
    gain_increase_frequency: float
    gain_decrease: float
    gain_decrease_frequency: float
    phase_deg: float
    phase_frequency: float
    delay_s: float
    delay_frequency: float
    ms: float
    ms_frequency: float
    mt: float
    mt_frequency: float
    disk: float
    disk_frequency: float
    gain_crossovers: Floats
    phase_margins_deg: Floats
    phase_crossovers: Floats
    phase_crossover_gains: Floats

    @property
    def disk_phase_deg(self) -> float:
        """Phase change tolerated together with any gain in no change: 2 atan(alpha/2), deg."""
        return float(np.degrees(2 * np.arctan(self.disk / 2)))

    @property
    def disk_gain_range(self) -> tuple[float, float]:
        """Gain factors tolerated by the disk: ((2 - alpha)/(2 + alpha), its reciprocal)."""
        if self.disk >= 2:
            return 0.0, float("inf")
        ratio = (2 - self.disk) / (2 + self.disk)
        return ratio, 1 / ratio


@dataclass(frozen=True)
class GainLimit:
    """A loop-gain factor at which closed-loop poles are on the imaginary axis.

    `crossing` is the change in the number of unstable poles when the factor grows past it.
    """

    factor: float
    frequency: float
    crossing: int


def gain_limits(response: Response, phase_crossings: Floats) -> list[GainLimit]:
    """Every listed factor k > 0 for which k L puts poles on the axis, ascending.

    From 1 + k L(s) = 0: Re ds/dk has the sign of -d(arg L)/d omega, so where the phase falls a pair moves right.
    """
    system = response.system
    limits = []
    dc = system.dc_gain
    if np.isfinite(dc) and dc < 0:
        # near the origin L ~ dc (1 + s L'/L): with k growing the real pole moves by -1/(L'/L), L'/L = d(arg L)/d omega
        slope = float(response.angle_slope(np.array([1e-12 * _smallest(response)]))[0])
        limits.append(GainLimit(-1.0 / dc, 0.0, 1 if slope < 0 else -1))
    log_size = response.log_size(phase_crossings)
    slopes = response.angle_slope(phase_crossings)
    limits += [
        GainLimit(float(np.exp(-size)), float(w), 2 if slope < 0 else -2)
        for w, size, slope in zip(phase_crossings, log_size, slopes, strict=True)
    ]
    at_infinity = _gain_limit_at_infinity(response)
    if at_infinity is not None:
        limits.append(at_infinity)
    return sorted(limits, key=lambda limit: limit.factor)


def _smallest(response: Response) -> float:
    sizes = np.abs(np.concatenate([response.system.zeros, response.system.poles]))
    sizes = sizes[sizes > 0]
    return float(sizes.min()) if sizes.size else 1.0


def _gain_limit_at_infinity(response: Response) -> GainLimit | None:
    """Where poles arrive from infinity: a chain of a neutral loop, or a real one when L(inf) = -1/k."""
    through = response.system.feedthrough
    if through == 0 or (response.dead_time == 0 and through > 0):
        return None
    factor = 1.0 / abs(through)
    if response.dead_time > 0:
        return GainLimit(factor, float("inf"), _A_CHAIN)
    # (1 + k through) s^n + c s^(n-1) + ...: a real pole -c/(1 + k through) passes through infinity
    c = float((response.system.zeros.sum() - response.system.poles.sum()).real)
    return GainLimit(factor, float("inf"), 1 if c > 0 else -1)


def compute_margins(response: Response, nodes: Floats, crossovers: Floats, phase_crossings: Floats) -> Margins:
    """Margins of a loop known to be stable; see `Margins`."""
    limits = gain_limits(response, phase_crossings)
    up = min((g for g in limits if g.factor > 1), key=lambda g: g.factor, default=GainLimit(np.inf, np.nan, 0))
    down = max((g for g in limits if g.factor < 1), key=lambda g: g.factor, default=GainLimit(0.0, np.nan, 0))
    phase = response.angle(crossovers)
    signed = np.degrees(np.pi - np.mod(np.pi - (phase + np.pi), 2 * np.pi))
    room = np.mod(phase + np.pi, 2 * np.pi) / crossovers
    smallest_phase, phase_frequency = _smallest_of(np.abs(signed), crossovers)
    smallest_delay, delay_frequency = _smallest_of(room, crossovers)
    if response.dead_time == 0 and abs(response.system.feedthrough) >= 1:
        smallest_delay, delay_frequency = 0.0, float("inf")  # any dead time makes a neutral loop of gain >= 1
    points = _peak_points(response, nodes, crossovers, phase_crossings)
    (ms, ms_frequency), (mt, mt_frequency), (disk, disk_frequency) = _peaks(response, points)
    at_zero = [limit for limit in limits if limit.frequency == 0]
    gains = np.exp(-response.log_size(phase_crossings))
    return Margins(
        gain_increase=up.factor,
        gain_increase_frequency=up.frequency,
        gain_decrease=down.factor,
        gain_decrease_frequency=down.frequency,
        phase_deg=smallest_phase,
        phase_frequency=phase_frequency,
        delay_s=smallest_delay,
        delay_frequency=delay_frequency,
        ms=ms,
        ms_frequency=ms_frequency,
        mt=mt,
        mt_frequency=mt_frequency,
        disk=1.0 / disk if disk > 0 else float("inf"),
        disk_frequency=disk_frequency,
        gain_crossovers=crossovers,
        phase_margins_deg=signed,
        phase_crossovers=np.concatenate([[g.frequency for g in at_zero], phase_crossings]),
        phase_crossover_gains=np.concatenate([[g.factor for g in at_zero], gains]),
    )


def _smallest_of(values: Floats, frequencies: Floats) -> tuple[float, float]:
    if values.size == 0:
        return float("inf"), float("nan")
    at = int(np.argmin(values))
    return float(values[at]), float(frequencies[at])


def _sensitivity(loop: Complexes, slope: Complexes) -> tuple[Floats, Floats]:
    return 1 / np.abs(1 + loop), -(slope * loop / (1 + loop)).real


def _complementary(loop: Complexes, slope: Complexes) -> tuple[Floats, Floats]:
    return np.abs(loop / (1 + loop)), (slope / (1 + loop)).real


def _disk(loop: Complexes, slope: Complexes) -> tuple[Floats, Floats]:
    return np.abs((1 - loop) / (1 + loop)) / 2, -2 * (slope * loop / ((1 - loop) * (1 + loop))).real


# Each takes L and d ln L/d omega, and gives the response's magnitude and the logarithmic slope of that.
RESPONSES = (_sensitivity, _complementary, _disk)


def _peak_points(response: Response, nodes: Floats, crossovers: Floats, phase_crossings: Floats) -> Floats:
    """Frequencies that separate all local peaks: the nodes, the crossovers, and a bound on the phase step."""
    points = np.union1d(np.union1d(nodes, crossovers), phase_crossings)
    phase = response.angle(points)
    size = response.log_size(points)
    matters = np.maximum(size[:-1], size[1:]) > np.log(_SMALL)
    parts = np.where(matters, np.ceil(np.abs(np.diff(phase)) / _PHASE_STEP), 1).astype(int)
    divided = int(np.count_nonzero(parts > 1))
    parts = np.clip(parts, 1, max(1, _MOST_POINTS // max(1, divided)))
    if np.all(parts == 1):
        return points
    at = np.repeat(np.arange(parts.size), parts)
    step = (np.arange(at.size) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[at]
    return np.append(points[at] + step * np.diff(points)[at], points[-1])


def _peaks(response: Response, points: Floats) -> list[tuple[float, float]]:
    """Suprema over omega >= 0 of |S|, |T| and |S - 1/2|, and where they are attained, rad/s."""
    loop, loop_slope = response(points), response.log_slope(points)
    low, high, kind, candidates = [], [], [], _end_values(response)
    for number, shape in enumerate(RESPONSES):
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            value, slope = shape(loop, loop_slope)
        value = np.where(np.isfinite(value), value, 0.0)
        top = np.flatnonzero((value[1:-1] >= value[:-2]) & (value[1:-1] >= value[2:])) + 1
        candidates[number] += [(float(value[i]), float(points[i])) for i in top]
        # the peak lies on the side to which the response still rises
        rising = slope[top] > 0
        low.append(np.where(rising, points[top], points[top - 1]))
        high.append(np.where(rising, points[top + 1], points[top]))
        kind.append(np.full(top.size, number))
    kinds = np.concatenate(kind)

    def slope_of(omega: Floats, index: NDArray[np.intp]) -> Floats:
        here, here_slope = response(omega), response.log_slope(omega)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            return np.choose(kinds[index], [shape(here, here_slope)[1] for shape in RESPONSES])

    refined = bracketed_roots(slope_of, np.concatenate(low), np.concatenate(high))
    here, here_slope = response(refined), response.log_slope(refined)
    for number, shape in enumerate(RESPONSES):
        mine = kinds == number
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            height = shape(here[mine], here_slope[mine])[0]
        candidates[number] += [(float(h), float(w)) for h, w in zip(height, refined[mine], strict=True)]
    return [max((c for c in mine if np.isfinite(c[0])), key=lambda item: item[0]) for mine in candidates]


def _end_values(response: Response) -> list[list[tuple[float, float]]]:
    """Each response at omega = 0 and its supremum as omega tends to infinity."""
    dc, through = response.system.dc_gain, response.system.feedthrough
    if response.dead_time > 0:
        through = -abs(through)  # the dead time turns it through every phase, -1 included
    # an integrator: any |L| far beyond 1 gives the limit, and does not overflow
    ends = np.array([1e100 if np.isinf(dc) else dc, through], dtype=complex)
    with np.errstate(divide="ignore", invalid="ignore"):
        values = [shape(ends, np.zeros(2, dtype=complex))[0] for shape in RESPONSES]
    return [[(float(v[0]), 0.0), (float(v[1]), float("inf"))] for v in values]


def stabilizing_range(limits: list[GainLimit], unstable_at_one: float) -> tuple[float, float] | None:
    """The interval of loop-gain factors that stabilises: the one holding 1, else the nearest to 1 in ratio.

    `unstable_at_one` is the exact number of unstable poles at factor 1; each limit tells how it changes.
    """
    edges = [0.0, *(limit.factor for limit in limits), float("inf")]
    # pair counts with intervals (edges[i], edges[i+1]); start from the one that holds 1
    home = int(np.searchsorted([limit.factor for limit in limits], 1.0, side="right"))
    counts = np.zeros(len(edges) - 1)
    counts[home] = unstable_at_one
    for i in range(home + 1, counts.size):
        counts[i] = counts[i - 1] + limits[i - 1].crossing
    for i in range(home - 1, -1, -1):
        counts[i] = counts[i + 1] - limits[i].crossing
    best: tuple[float, tuple[float, float]] | None = None
    for i in np.flatnonzero(counts == 0).tolist():
        low, high = edges[i], edges[i + 1]
        if high <= low * (1 + _GAINS_EQUAL):
            continue
        distance = 0.0 if low <= 1 <= high else min(abs(np.log(low)) if low > 0 else np.inf, abs(np.log(high)))
        if best is None or distance < best[0]:
            best = float(distance), (low, high)
    return None if best is None else best[1]
