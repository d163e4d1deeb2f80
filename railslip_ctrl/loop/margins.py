"""Stability margins of a dead-time loop, from its crossovers and the peaks of its closed-loop responses."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise

import numpy as np
from flint import ctx, fmpq
from numpy.typing import NDArray

from railslip_ctrl.core.arguments import Complexes, Flags, Floats
from railslip_ctrl.core.records import dataclass

from .crossings import REFINED_BITS, Pieces, Response
from .stability import count_right_of

_NEWTON_STEPS, _HALF_OF_THE_DIGITS = 8, 1e-9  # for a peak by doubles
_BLUNT = 100.0  # up to here they place it well enough
_STEP = 0.25  # phase change, rad, of the dead time over the parts that one is divided into
_PER_DECADE, _BEYOND = 8, 100.0  # of the points that part the axis first, and how far they reach beyond the features
_PEAK = 1e-11  # relative: no peak exceeds the one reported by more
# Around a peak the axis is cut at distances from it that grow by this factor: a bound good to second order shows each
# part to be lower if it is short against its distance.
_GROWING = np.outer([-1, 1], 1.5 ** np.arange(70)).ravel()
_FAR_FROM_PEAK = 0.6  # relative to its frequency
_NOTHING = 1e-100  # a |T| that is not looked for; bounds are cut off below it
_NARROWEST = 1e-15  # relative: a part that no double divides
_FARTHEST = 1e150  # rad/s: beyond it, and below its inverse, the limits to infinity and 0 stand for L
_MOST_PARTS = 64
_A_CHAIN = 10**9  # unstable poles of a neutral loop beyond its limit: whatever crossed before, it is not stable
_BESIDE = 1e-6  # relative: how far from a gain limit the poles are counted on both sides
_GAINS_EQUAL = 1e-9  # two phase crossovers whose gains agree this well are one limit


@dataclass(frozen=True)
class Margins:
    """Margins of a stable loop, each the distance to instability along its own direction.

    - gain_increase, gain_decrease: factors > 1 and < 1 on the loop gain at which stability is lost; inf and 0.0 if it
      never is.
    - gain_increase_frequency, gain_decrease_frequency: phase crossover they belong to, rad/s; 0 is a pole leaving
      through the origin, inf one at infinite frequency (neutral loops), NaN without a bound.
    - phase_deg, phase_frequency: smallest phase change, in size, lag or lead, that destabilises, deg, over all gain
      crossovers, and where, rad/s; inf and NaN without a crossover.
    - delay_s, delay_frequency: smallest added dead time that destabilises, s, over all gain crossovers; inf and NaN
      without one.
    - ms, ms_frequency, mt, mt_frequency: peaks of |S| = |1/(1 + L)| and |T| = |L/(1 + L)| over all frequencies, to the
      last bit, and where, rad/s. (The other margins may lie some last bits outside what `DeadTimeLoop.certificate`
      encloses them in.)
    - disk, disk_frequency: balanced disk margin alpha = 1/||S - 1/2||_inf, a ratio, and where, rad/s ([Seiler2020]):
      gain and phase may change together within `disk_gain_range` and +-`disk_phase_deg`.
    - gain_crossovers, phase_crossovers: array, 1-D, rad/s; all |L| = 1; and all L < 0 real, 0 included, complete where
      |L| >= 1/100 (with dead time there are infinitely many).
    - phase_margins_deg: array, 1-D; deg, at each gain crossover, in (-180, 180]: positive is destroyed by lag, negative
      by lead.
    - phase_crossover_gains: array, 1-D; factor 1/|L| at each phase crossover.
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
        slope = float(response.phase(1e-12 * response.scales.min(keepdims=True))[1][0])
        limits.append(GainLimit(-1.0 / dc, 0.0, 1 if slope < 0 else -1))
    factors, slopes = np.exp(-response.log_size(phase_crossings)), response.phase(phase_crossings)[1]
    limits += [
        GainLimit(factor, omega, 2 if slope < 0 else -2)
        for omega, factor, slope in zip(phase_crossings.tolist(), factors.tolist(), slopes.tolist(), strict=True)
    ]
    at_infinity = _gain_limit_at_infinity(response)
    if at_infinity is not None:
        limits.append(at_infinity)
    return sorted(limits, key=lambda limit: limit.factor)


def _gain_limit_at_infinity(response: Response) -> GainLimit | None:
    """Where poles arrive from infinity: a chain of a neutral loop, or a real one when L(inf) = -1/k."""
    through = response.system.feedthrough
    if through == 0 or (response.dead_time == 0 and through > 0):
        return None
    factor = 1.0 / abs(through)
    if response.dead_time > 0:
        return GainLimit(factor, float("inf"), _A_CHAIN)
    # (1 + k through) s^n + c s^(n-1) + ...: a real pole -c/(1 + k through) passes through infinity
    c = math.fsum([*response.system.zeros.real, *-response.system.poles.real])
    if c == 0:  # a pair does, in a direction that the lower powers decide
        below, above = (count_right_of(response.system * (factor * side), 0.0) for side in (1 - _BESIDE, 1 + _BESIDE))
        return GainLimit(factor, float("inf"), int(above.right - below.right))
    return GainLimit(factor, float("inf"), 1 if c > 0 else -1)


def compute_margins(
    response: Response, cut: Pieces, crossovers: Floats, rest: Floats, crossings: Floats, limits: list[GainLimit]
) -> Margins:
    """Margins of a loop known to be stable; see `Margins`.

    `rest` is arg(-L)/pi at the gain `crossovers`, in [-1, 1]; `crossings` are the phase crossovers, all in rad/s.
    """
    up = min((g for g in limits if g.factor > 1), key=lambda g: g.factor, default=GainLimit(np.inf, np.nan, 0))
    down = max((g for g in limits if g.factor < 1), key=lambda g: g.factor, default=GainLimit(0.0, np.nan, 0))
    room = smallest_of(_room(rest, crossovers), crossovers)
    if response.dead_time == 0 and abs(response.system.feedthrough) >= 1:
        room = 0.0, float("inf")  # any dead time makes a neutral loop of gain >= 1
    ms, mt, (disk, disk_frequency) = _peaks(response, cut)
    at_zero = [limit for limit in limits if limit.frequency == 0]
    gains = np.exp(-response.log_size(crossings))
    return Margins(
        *(up.factor, up.frequency, down.factor, down.frequency),
        *smallest_of(180 * np.abs(rest), crossovers),
        *room,
        *ms,
        *mt,
        *(1.0 / disk if disk > 0 else float("inf"), disk_frequency),
        gain_crossovers=crossovers,
        phase_margins_deg=180 * np.where(rest == -1, 1.0, rest),
        phase_crossovers=np.concatenate([[g.frequency for g in at_zero], crossings]),
        phase_crossover_gains=np.concatenate([[g.factor for g in at_zero], gains]),
    )


def smallest_at(rest: Floats, crossovers: Floats) -> tuple[int, int]:
    """Which gain crossovers, at least one, limit the phase and the added dead time; see `compute_margins`."""
    return int(np.argmin(np.abs(rest))), int(np.argmin(_room(rest, crossovers)))


def _room(rest: Floats, crossovers: Floats) -> Floats:
    """Dead time, s, that may be added at each gain crossover."""
    return np.pi * np.where(rest > 0, rest, rest + 2) / crossovers


def smallest_of(values: Floats, frequencies: Floats) -> tuple[float, float]:
    if values.size == 0:
        return float("inf"), float("nan")
    at = int(np.argmin(values))
    return float(values[at]), float(frequencies[at])


SHAPES = ((1.0, 0.0), (0.0, 1.0), (0.5, -0.5))  #: (a, b): (a + b L)/(1 + L) is S, T and 1/2 - S


def heights(loop: Complexes) -> Floats:
    """|S|, |T| and |S - 1/2|, (3, n)."""
    s = 1 / (1 + loop)
    return np.abs([s, loop * s, s - 0.5])


def responses(loop: Complexes, slope: Complexes) -> tuple[Floats, Floats]:
    """|S|, |T| and |S - 1/2| and their logarithmic slopes, both (3, n), from L and d ln L/d omega."""
    s = 1 / (1 + loop)
    t, centred = loop * s, s - 0.5
    return np.abs([s, t, centred]), np.array([-(t * slope).real, (s * slope).real, -(s * t * slope / centred).real])


Peaks = list[tuple[float, float]]  #: peaks of S, T and S - 1/2: size and where, rad/s


def _peaks(response: Response, cut: Pieces) -> Peaks:
    """Suprema over omega >= 0: the axis is divided until a bound on every part shows that it has nothing higher."""
    best = [max(ends) for ends in _end_values(response)]
    if response.system.gain == 0:
        return best
    if response.dead_time == 0:
        with ctx.workprec(REFINED_BITS):
            return [(float(peak.mid()), omega) for peak, omega in response.exact.peaks()]
    edges = _first_points(response, cut)
    low, high = np.append(0.0, edges), np.append(edges, np.inf)
    while low.size:
        size, half_turns = cut.ends(response, low, high)
        best, higher = _raised(response, best, low, high, size[0], half_turns[0])
        left = _may_be_higher(box_bounds(size, half_turns), response.rounding(0.0), best)
        left &= (high > low * (1 + _NARROWEST)) & (high > 1 / _FARTHEST) & (low < _FARTHEST)
        low, high = low[left], high[left]
        if higher and low.size:
            low, high = _cut_around(response, low, high, best)
        left = _may_be_higher(*_second_order_bounds(response, low, high), best)
        if not left.any():
            break
        low, high = _divided(response, low[left], high[left])
    return best


def _first_points(response: Response, cut: Pieces) -> Floats:
    """Frequencies, rad/s, ascending, the ends of the pieces among them, between which boxes tell of most loops."""
    inner = np.concatenate([cut.low[1:], response.scales])
    low, high = inner.min() / _BEYOND, inner.max() * _BEYOND
    wide = low * (high / low) ** np.linspace(0, 1, int(_PER_DECADE * math.log10(high / low)) + 2)
    points = np.sort(np.concatenate([inner, wide]))
    return np.asarray(points[np.append(True, np.diff(points) > 0)])


def _raised(
    response: Response, best: Peaks, low: Floats, high: Floats, size: Floats, half_turns: Floats
) -> tuple[Peaks, bool]:
    """The best with the peaks beside the highest of the points `low`, where L is given, and whether any is higher."""
    with np.errstate(all="ignore"):
        sizes = heights(np.exp(np.clip(size, -300, 300) + 1j * np.pi * half_turns))
    sizes[~np.isfinite(sizes)] = 0
    found, higher = best.copy(), False
    for kind, top in enumerate(sizes.argmax(axis=1).tolist()):
        if sizes[kind, top] > best[kind][0] * (1 + _PEAK) and low[top] > 0:
            shape, between = SHAPES[kind], (float(low[top - 1]) if top else 0.0, float(low[top]), float(high[top]))
            omega, found_it = _near_peak(response, *shape, *between)
            with ctx.workprec(REFINED_BITS):
                peak = response.exact.size_at(*shape, omega)
                if not (found_it and peak < _BLUNT):
                    omega, peak = response.exact.peak(*shape, between[0], omega, between[2])
            found[kind], higher = max(best[kind], (float(peak.mid()), float(omega))), True
    return found, higher


def _near_peak(response: Response, a: float, b: float, low: float, start: float, high: float) -> tuple[float, bool]:
    """`ExactLoop.peak` in doubles: where the peak is, rad/s, and True; or `start` and False where that fails."""
    omega = start
    try:
        for _ in range(_NEWTON_STEPS):
            loop, slope, second = response.at(omega)
            size = a + b * loop
            inverse, first = (1 + loop) / size, (a - b) * loop * slope / size / size
            falls = (inverse.conjugate() * first).real
            bends = first * (second / slope + slope * (1 - 2 * b * loop / size))
            step = falls / ((first.conjugate() * first).real + (inverse.conjugate() * bends).real)
            if not low < omega - step < high:
                break
            omega -= step
            if abs(step) < _HALF_OF_THE_DIGITS * omega:
                return omega, True
    except ArithmeticError:
        pass
    return start, False


@np.errstate(all="ignore")
def _cut_around(response: Response, low: Floats, high: Floats, best: Peaks) -> tuple[Floats, Floats]:
    """The parts, divided on either side of the peaks: from so near that the curvature there is below `_PEAK`."""
    peaks = np.array([omega for _, omega in best if 0 < omega < np.inf])[:, None]
    loop, slope, second = (one[:, None] for one in response.value_and_slopes(peaks[:, 0]))
    both = (1 + np.abs(loop)) / np.abs(1 + loop)
    nearest = np.sqrt(_PEAK / (both * (np.abs(second) + np.abs(slope) ** 2 * both)))
    nearest = np.fmax(np.fmin(nearest, _FAR_FROM_PEAK * peaks), _NARROWEST * peaks)  # the bounds of one not finite
    away = nearest * _GROWING
    cut = np.sort((peaks + away)[np.abs(away) <= _FAR_FROM_PEAK * peaks])
    owner = np.searchsorted(low, cut) - 1
    cut = cut[(owner >= 0) & (cut < high[owner])]
    return np.sort(np.append(low, cut)), np.sort(np.append(high, cut))


def _divided(response: Response, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Each part divided, the more the more the dead time turns in it; ends at 0 or infinity part by part. Ascending."""
    scale = 1 / response.dead_time if response.dead_time > 0 else 1.0
    first = np.where(low == 0, np.where(np.isinf(high), scale, high) / _BEYOND, low)
    last = np.where(np.isinf(high), first * _BEYOND, high)
    number = np.clip(np.ceil((last - first) * response.dead_time / _STEP), 4, _MOST_PARTS).astype(int)
    inner = _spread(first, last, number)
    below, above = first > low, last < high
    return (
        np.sort(np.concatenate([low[below], inner[0], last[above]])),
        np.sort(np.concatenate([first[below], inner[1], high[above]])),
    )


def _spread(low: Floats, high: Floats, parts: NDArray[np.int_]) -> tuple[Floats, Floats]:
    """The ends of the parts that each interval is divided into, equal in ratio if it is wide, else in length."""
    at = np.repeat(np.arange(parts.size), parts + 1)
    share = (np.arange(at.size) - np.repeat(np.cumsum(parts + 1) - parts - 1, parts + 1)) / parts[at]
    ratio = high[at] / low[at]
    factor, wide = 1 + (ratio - 1) * share, ratio > 4
    factor[wide] = ratio[wide] ** share[wide]
    omega = np.where(share == 1, high[at], low[at] * factor)
    inside = at[1:] == at[:-1]
    return omega[:-1][inside], omega[1:][inside]


def top_of(sizes: Floats, points: Floats) -> Peaks:
    return [(float(row[i]), float(points[i])) for row in sizes for i in [int(np.argmax(row))]]


def _may_be_higher(bounds: Floats, rounding: Floats, best: Peaks) -> Flags:
    """Which parts may hold a value above the best, by their bounds, (3, n), and the relative rounding of L there."""
    slack = rounding * (best[0][0] * best[1][0])  # |S| and |T| amplify it
    most = np.array([[max(peak, _NOTHING) * (1 + _PEAK)] for peak, _ in best]) + slack
    return np.asarray(~(bounds <= most).all(axis=0))


@np.errstate(all="ignore")
def _second_order_bounds(response: Response, low: Floats, high: Floats) -> tuple[Floats, Floats]:
    """Upper bounds on |S|, |T|, |S - 1/2|, shape (3, n), from value and slope in the middle of each part and a bound on
    the second derivative, common to all three as T = 1 - S; inf where the part is too long. And the rounding of L."""
    half, middle = 0.5 * (high - low), 0.5 * (high + low)
    (loop, slope, _), bend = response.value_and_slopes(middle), response.bend(low, high)
    size, steep = np.abs(loop), half * np.abs(slope)
    bent = half * half * bend
    growth = np.expm1(steep + 0.5 * bent)  # of |L| over the part, relatively
    below = 1 + loop
    least = np.abs(below) - size * growth  # of |1 + L|
    s_most, t_most = 1 / least, size * (1 + growth) / least
    curved = 0.5 * s_most * t_most * (bent + (steep + bent) ** 2 * (s_most + t_most))
    s = 1 / below
    t = loop * s
    middles, rate = np.array([s, t, s - 0.5]), half * slope * s * t
    most = np.maximum(np.abs(middles - rate), np.abs(middles + rate)) + curved
    return np.where(least > 0, most, np.inf), response.rounding(high)


def box_bounds(size: Floats, half_turns: Floats) -> Floats:
    """Upper bounds on |S|, |T|, |S - 1/2|, shape (3, n), from ln|L| and arg L/pi, both monotone, at the ends, (2, n).

    With |L| = m in [m1, m2] and the phase at least d from -180 deg, |1 + L|^2 >= (1 - m)^2 + 2 m (1 - cos d); the
    bound is attained if both ends of the intervals meet, so that it tightens with the part.
    """
    turns = 0.5 * half_turns - 0.5
    lowest, highest = np.minimum(*turns), np.maximum(*turns)
    with np.errstate(invalid="ignore", divide="ignore"):
        e = 2 * np.minimum(*(np.sin(np.pi * turns) ** 2))  # 1 - cos d
        e[np.floor(highest) >= np.ceil(lowest)] = 0.0
        size = np.clip(size, -300, 300)
        least, most = np.minimum(*size), np.maximum(*size)
        low, high = -np.expm1(most), -np.expm1(least)  # of 1 - m
        # |S| and |T| are largest where m or 1/m is next to cos d; |S - 1/2| for |L| nearest to 1 in the left half
        # plane, farthest from it in the right one
        near = np.empty((3, e.size))
        np.clip(e, low, high, out=near[0])
        np.clip(e, -np.expm1(-least), -np.expm1(-most), out=near[1])
        near[2] = np.where(e < 1, np.clip(0.0, low, high), np.where(least + most > 0, low, high))
        m = 1 - near
        squares = 1 / (near**2 + 2 * m * e)
        squares[2] *= (0.5 + 0.5 * m[2]) ** 2 - 0.5 * m[2] * e
        return np.asarray(np.sqrt(squares))


def _end_values(response: Response) -> list[Peaks]:
    """Each response at omega = 0 and its supremum as omega tends to infinity."""
    n, d = response.exact.numerator[0], response.exact.denominator[0]
    through = response.exact.through
    if response.dead_time > 0:
        through = -abs(through)  # the dead time turns it through every phase, -1 included
    # exact, as D + N may be far smaller than both
    near, far = ([abs(one / (2 * (n + d))) for one in (2 * d, 2 * n, d - n)] for n, d in ((n, d), (through, fmpq(1))))
    return [[(int(x.p) / int(x.q), 0.0), (int(y.p) / int(y.q), math.inf)] for x, y in zip(near, far, strict=True)]


def stabilizing_range(limits: list[GainLimit], unstable_at_one: float) -> tuple[float, float] | None:
    """The interval of loop-gain factors that stabilises: the one holding 1, else the nearest to 1 in ratio.

    `unstable_at_one` is the exact number of unstable poles at factor 1; each limit tells how it changes.
    """
    factors = [limit.factor for limit in limits]
    counts = np.cumsum([0, *(limit.crossing for limit in limits)], dtype=float)
    counts += unstable_at_one - counts[np.searchsorted(factors, 1.0, side="right")]
    return next((one for one, count in by_distance(factors, counts) if count == 0), None)


def by_distance(factors: Iterable[float], counts: Iterable[float]) -> list[tuple[tuple[float, float], float]]:
    """The intervals between 0, ascending `factors` of gain and infinity that have a width, each with its count: the
    one that holds 1, and then the nearest to it in ratio."""

    def distance(found: tuple[tuple[float, float], float]) -> float:
        low, high = found[0]
        return 0.0 if low <= 1 <= high else abs(math.log(high if high < 1 else low))

    intervals = zip(pairwise([0.0, *factors, math.inf]), counts, strict=False)
    return sorted((one for one in intervals if one[0][1] > one[0][0] * (1 + _GAINS_EQUAL)), key=distance)
