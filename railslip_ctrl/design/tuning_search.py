"""Search of the PI gains that meet a specification for a family of plants, and of the best gains; used by `tuning`.

The plant is P, with dead time. A bound M on Ms means |1 + (kp + ki/(j omega)) P| >= 1/M at each frequency. With x + j y
= 1/P and r = |1/P|/M this is (kp + x)^2 + (ki/omega - y)^2 >= r^2: each plant and frequency excludes the gains inside
an ellipse ([Astrom1998], MIGO). Gains with a crossover at omega are on the ellipse kp^2 + (ki/omega)^2 = |1/P|^2. The
arc of this ellipse on which the phase or delay margin is too small is excluded.

At one ki (a row), the kp that meet the specification are the gaps between the excluded intervals of all frequencies.
The exact root count of one loop inside a gap decides whether the gap is stable. The search tries rows from large to
small ki until a row has a stable gap. It then follows this gap up to the largest ki at which the gap exists (its tip).

With a bound on Ms the search excludes larger ki by examining bands of ki. An ellipse is convex: a kp that it excludes
at both ends of a band is excluded in the whole band. The centres of the ellipses are the gains with a pole on the
imaginary axis, so that a gap without a centre is stable or unstable as a whole. A band from k1 to k2 with k2/k1 - 1 <=
1/M has no gap with a centre. A band without a stable gap has no solution; any other band is divided.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property, partial
from itertools import pairwise

import numpy as np

from railslip_ctrl.controllers.systems import pi_transfer_function
from railslip_ctrl.core.arguments import Flags, Floats
from railslip_ctrl.core.errors import InfeasibleDesignError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.loop import DeadTimeLoop, Rational
from railslip_ctrl.loop.batch import BatchMargins
from railslip_ctrl.loop.crossings import Response, frequency_nodes

from .decomposition import Interval, common_intervals
from .specification import Specification, family_margins
from .stabilizing import StabilizingRegion, intersection, stabilizing_pi

_PER_NODE = 6  # number of frequencies per interval between two neighbours of `frequency_nodes`
_TURN = 0.15  # rad, phase of the dead time between neighbouring frequencies, while |C P| is relevant
_MOST_TURNS = 6000  # largest number of these frequencies
_FARTHEST = 4.0  # largest kp searched, relative to the largest that stabilises with little integral action
_MATTERS = 0.5 / _FARTHEST  # |C P| below which a frequency affects no peak or margin
_CLOSER = 61  # number of frequencies that refine the interval between the two neighbours of a critical frequency
_NEARLY = 0.2  # relative to Ms - 1: frequencies this close to the bound may be critical after refinement
_NARROWEST = 1e-9  # relative width of a gap below which it is due to rounding of its ends
_REACH = 10.0  # factor between the gains at the highest samples and the ends of the search, without dead time


class Forbidden:
    """Gains that a specification excludes for plants with dead time, at densely sampled frequencies.

    `omegas` contains the frequencies for each plant, rad/s. `usual_kp` contains for each plant the largest kp that
    stabilises the plant with little integral action, or inf if there is no largest kp.
    """

    def __init__(self, responses: Sequence[Response], omegas: Sequence[Floats], usual_kp: Sequence[float]) -> None:
        self._responses, self._omegas, self._usual_kp = responses, omegas, usual_kp
        self._omega = np.concatenate(omegas)
        self._member = np.repeat(np.arange(len(omegas)), [omega.size for omega in omegas])
        with np.errstate(divide="ignore", invalid="ignore"):
            self._inverse = np.concatenate([1 / r(w) for r, w in zip(responses, omegas, strict=True)])
        self._inverse[~np.isfinite(self._inverse)] = np.nan  # a zero on the axis excludes no gains
        self._size = np.abs(self._inverse)
        members = [self._member == i for i in range(len(omegas))]
        last = np.cumsum([omega.size for omega in omegas]) - 1
        self._last_of_double = last[[r.dead_time == 0 and r.system.relative_degree == 2 for r in responses]]
        self.reach = min(_REACH * float(np.nanmax(self._size[member])) for member in members)
        """Largest |kp| of the search; a larger one has a crossover above all samples. `ki_ends` bounds ki likewise."""
        self.reach = min(self.reach, *(_FARTHEST * kp for kp in usual_kp))
        ki = self._omega * self._size
        self.ki_ends = float(np.nanmin(ki)) / _REACH**3, min(float(np.nanmax(ki[m])) for m in members) / _REACH
        self.log_times = -math.log(self._omega.max()) - 7.0, 7.0 - math.log(self._omega.min())
        """Logarithms of a shortest and a longest time, s, between which the delay margin is searched."""

    @classmethod
    def sampled(cls, systems: Sequence[Rational], dead_times: Sequence[float], usual_kp: Sequence[float]) -> Forbidden:
        """Sample the plants so densely that the excluded gains change nearly linearly with frequency."""
        responses = [Response(g, tau) for g, tau in zip(systems, dead_times, strict=True)]
        return cls(responses, [_frequencies(*pair) for pair in zip(responses, usual_kp, strict=True)], usual_kp)

    def closer(self, kp: float, ki: float, ms_max: float) -> Forbidden:
        """Return a copy with more frequencies near |L| = 1 and near minima of |1 + L| of about 1/`ms_max`."""
        with np.errstate(divide="ignore", invalid="ignore"):  # division by 0 at a pole on the axis
            loop = (kp - 1j * ki / self._omega) / self._inverse
            apart, above = np.abs(1 + loop), np.abs(loop) > 1
            near = apart * ms_max < 1 + _NEARLY * (ms_max - 1)
        dip = near & (apart <= np.roll(apart, 1)) & (apart <= np.roll(apart, -1))
        hit = dip | (above != np.roll(above, 1)) | (above != np.roll(above, -1))
        omegas = []
        for i, omega in enumerate(self._omegas):
            at = np.flatnonzero(hit[self._member == i])
            ends = omega[np.maximum(at - 1, 0)], omega[np.minimum(at + 1, omega.size - 1)]
            omegas.append(np.union1d(omega, np.linspace(*ends, _CLOSER)))
        return Forbidden(self._responses, omegas, self._usual_kp)

    def gaps(self, ki: float, specification: Specification, to: float | None = None) -> list[Interval]:
        """Return the intervals of kp, ascending, that no frequency excludes at `ki` > 0; |kp| is at most `self.reach`.

        With `to` > `ki`, a kp is left out only if the bound on Ms excludes it at every ki from `ki` to `to`.
        """
        parts = [*self._arcs(ki / self._omega, specification), *self._crossover_ends(ki, specification)]
        if to is not None:
            parts = []
        if specification.ms_max is not None:
            radius = self._size / specification.ms_max
            half = np.minimum(*(_leg(radius, x / self._omega - self._inverse.imag) for x in (ki, to or ki)))
            hit = half > 0
            parts.append((-self._inverse.real[hit] - half[hit], -self._inverse.real[hit] + half[hit]))
            parts.append(self._beyond_samples(max(ki, to or ki), radius))
        low, high = (np.concatenate(ends) for ends in zip(*parts, strict=True))
        order = np.argsort(low)
        starts = np.maximum(np.append(-np.inf, np.maximum.accumulate(high[order])), -self.reach)
        ends = np.minimum(np.append(low[order], np.inf), self.reach)
        wide = ends - starts > _NARROWEST * np.maximum(np.abs(starts), np.abs(ends))
        return list(zip(starts[wide].tolist(), ends[wide].tolist(), strict=True))

    def _beyond_samples(self, ki: float, radius: Floats) -> tuple[Floats, Floats]:
        # where |P| falls as 1/s^2, a kp beyond the last ellipse is inside an ellipse of a higher frequency
        last = self._last_of_double
        last = last[ki / self._omega[last] + np.abs(self._inverse.imag[last]) < radius[last]]
        kp = -self._inverse.real[last]
        return np.where(kp > 0, kp, -np.inf), np.where(kp > 0, np.inf, kp)

    def _arcs(self, vertical: Floats, specification: Specification) -> list[tuple[Floats, Floats]]:
        phase = np.deg2rad(specification.phase_min_deg or 0.0)
        if specification.ms_max is not None:
            phase = max(phase, 2 * np.arcsin(0.5 / specification.ms_max))  # |1 + L| = 2 sin(phase/2) at a crossover
        size = _leg(self._size, vertical)
        with np.errstate(invalid="ignore"):
            at = np.flatnonzero(((size[:-1] > 0) | (size[1:] > 0)) & (np.diff(self._member) == 0))
        arcs = []
        for kp in (-size, size):
            with np.errstate(invalid="ignore"):
                left = np.angle((1j * vertical - kp) * self._inverse.conj())  # phase above -180 deg, rad
            first, last = left[at], left[at + 1]
            last = first + np.mod(last - first + np.pi, 2 * np.pi) - np.pi
            bands = [_share((phase - first, phase - last), (phase + first, phase + last))]
            if specification.delay_min_s is not None:
                turned = specification.delay_min_s * self._omega
                for lap in (-2 * np.pi, 0.0, 2 * np.pi):
                    left_of = turned[at] + lap - first, turned[at + 1] + lap - last
                    bands.append(_share((first - lap, last - lap), left_of))
            for start, end in bands:
                kept = np.flatnonzero((start <= end) & np.isfinite(first + last))
                step, origin = kp[at + 1] - kp[at], kp[at]
                one, other = (origin[kept] + part[kept] * step[kept] for part in (start, end))
                arcs.append((np.minimum(one, other), np.maximum(one, other)))
        return arcs

    def _crossover_ends(self, ki: float, specification: Specification) -> list[tuple[Floats, Floats]]:
        # intervals of zero length divide a gap where the crossover leaves its range
        ends = [w for w in specification.crossover or () if 0 < w < np.inf]
        sizes = np.array([[1 / np.abs(r(np.array([w]))[0]), ki / w] for w in ends for r in self._responses])
        kp = _leg(*sizes.T) if ends else np.array([])
        return [(side * kp, side * kp) for side in (-1.0, 1.0)]


def _frequencies(response: Response, usual_kp: float) -> Floats:
    system, dead_time = response.system, response.dead_time
    scales = np.abs(np.concatenate([system.zeros, system.poles, [1 / dead_time] if dead_time else []]))
    middle = np.exp(np.log(scales[scales > 0]).mean(keepdims=True)) if scales.any() else np.ones(1)
    with np.errstate(invalid="ignore"):
        unit = np.exp(-system.log_size(middle)[0])
    nodes = frequency_nodes(Response(system * float(unit), dead_time))
    omega = np.interp(np.arange((nodes.size - 1) * _PER_NODE + 1) / _PER_NODE, np.arange(nodes.size), nodes)
    if dead_time == 0 or np.isinf(usual_kp):
        return omega
    matters = system.log_size(omega) > np.log(_MATTERS / usual_kp)
    turns = min(float(np.max(omega[matters], initial=0.0)) * dead_time / _TURN, _MOST_TURNS)
    return np.union1d(omega, np.arange(1, int(turns) + 1) * (_TURN / dead_time))


def _leg(hypotenuse: Floats, other: Floats) -> Floats:
    """Return sqrt(hypotenuse^2 - other^2), or 0 if the difference is negative."""
    with np.errstate(invalid="ignore"):
        square = (hypotenuse - other) * (hypotenuse + other)
        return np.asarray(np.sqrt(np.where(square > 0, square, 0.0)))


def _share(*ends: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """Return start and end of the interval inside [0, 1] on which linear functions are all >= 0.

    Each function is given by its values at 0 and 1. If there is no such interval, the start is above the end.
    """
    start, end = np.zeros(ends[0][0].size), np.ones(ends[0][0].size)
    for first, last in ends:
        with np.errstate(invalid="ignore", divide="ignore"):
            zero = first / (first - last)
        start = np.where(first < 0, np.where(last < 0, 2.0, np.fmax(start, zero)), start)
        end = np.where(last < 0, np.where(first < 0, -1.0, np.fmin(end, zero)), end)
    return start, end


_BAND = 0.02, 0.25  # smallest and largest relative width of the first bands of ki
_NEARLY_NO_KI = 1e-9  # largest ratio of the smallest ki, which stands for no integral action, to the largest ki
_LIMITLESS = 0.1  # without dead time, a ki above this share of the largest ki means that nothing bounds ki
_AROUND = 0.01  # relative distance in kp between the gap of the samples and the exact gap
_AGREE = 1e-10  # tolerance of ln ki at the tip of a gap
_MOST_LOOKS = 12  # largest number of refinements at a tip, each with 30 times denser frequencies
_FAR_UP, _FAR_DOWN = 4.0, 20.0  # largest steps of ln ki in the search for a bracket
_FINEST = 0.04  # relative width of a band of ki that is not divided further
_LOOKS = 7  # number of kp in a gap for a coarse minimum
_TOP = 2e-3  # relative tolerance of ki at which the bisection ends and exact margins are used
_PIECES = 8  # number of intervals in a gap if the crossover is limited, because the crossover may jump in a gap
_LARGEST_MS = 1e6  # largest Ms - 1 of the search
_LEAST_MS = 1e-9  # smallest Ms - 1
_TIGHTENINGS = 16  # bisections of a bound before exact margins are used
_KP_TOLERANCE = 1e-8  # relative tolerance of kp at the optimum
_FEW = 4  # number of gains up to which all plants are computed at once


@dataclass(frozen=True)
class Family:
    """Plants for which one common PI is tuned; `systems` excludes dead times, s, and includes any compensator."""

    systems: list[Rational]
    dead_times: list[float]
    compensated: bool
    names: tuple[str, ...]

    @cached_property
    def regions(self) -> list[StabilizingRegion]:
        return [stabilizing_pi(g, dead_time=tau) for g, tau in zip(self.systems, self.dead_times, strict=True)]

    def loops(self, kp: float, ki: float) -> list[DeadTimeLoop]:
        controller = pi_transfer_function(kp, ki)
        return [DeadTimeLoop(controller * g, tau) for g, tau in zip(self.systems, self.dead_times, strict=True)]

    def margins(self, kp: Floats, ki: float, *, peaks: bool) -> BatchMargins:
        loops = [loop for gain in kp.tolist() for loop in self.loops(gain, ki)]
        return family_margins(loops, gain_margins=False, peaks=peaks)

    def worst(self, kp: float, ki: float, margin: str) -> float:
        """Return the largest Ms over the plants, or -1 times the smallest value of another margin; inf if unstable."""
        margins = self.margins(np.array([kp]), ki, peaks=margin == "ms")
        values = getattr(margins, margin) * (1 if margin == "ms" else -1)
        return float(np.where(margins.stable, values, np.inf).max())

    def excess(self, kp: float, ki: float, specification: Specification) -> float:
        """Return the relative violation of the specification by the worst loop: <= 0 if it is met, inf if unstable."""
        return float(self.excesses(np.array([kp]), ki, specification)[0])

    def excesses(self, kp: Floats, ki: float, specification: Specification) -> Floats:
        margins = self.margins(kp, ki, peaks=specification.ms_max is not None)
        shape = kp.size, len(self.systems)
        misses = np.full(shape, -np.inf)
        if specification.ms_max is not None:
            misses = np.fmax(misses, margins.ms.reshape(shape) / specification.ms_max - 1)
        if specification.phase_min_deg:
            misses = np.fmax(misses, 1 - margins.phase_deg.reshape(shape) / specification.phase_min_deg)
        if specification.delay_min_s:
            misses = np.fmax(misses, 1 - margins.delay_s.reshape(shape) / specification.delay_min_s)
        if specification.crossover is not None:
            low, high = specification.crossover
            at = margins.phase_frequency.reshape(shape)
            outside = np.fmax(at / high, low / at) - 1
            # a loop without crossover violates the range
            misses = np.fmax(misses, np.where(np.isnan(at), 1.0, outside))
        return np.asarray(np.where(margins.stable.reshape(shape), misses, np.inf).max(axis=1))

    def meets(self, kp: Floats, ki: float, specification: Specification) -> Flags:
        met = np.ones(kp.size, dtype=bool)
        for part in (slice(0, 1), slice(1, None)) if kp.size > _FEW else (slice(None),):
            some = replace(self, systems=self.systems[part], dead_times=self.dead_times[part])
            if some.systems and met.any():
                met[met] = some.excesses(kp[met], ki, specification) <= 0
        return met

    @cached_property
    def forbidden(self) -> Forbidden:
        usual = [np.abs(r.kp_range).max() if r.kp_range else r.decomposition.largest_kp for r in self.regions]
        return Forbidden.sampled(self.systems, self.dead_times, usual)

    @cached_property
    def ki_ends(self) -> tuple[float, float]:
        """Ends of the search for ki: a negligible ki, and a ki that does not stabilise all plants."""
        low, high = self.forbidden.ki_ends
        high = min(high, *(r.decomposition.largest_ki for r in self.regions))
        return min(low, _NEARLY_NO_KI * high), high

    @cached_property
    def binding(self) -> list[int]:
        """Indices of the plants whose ranges of stabilising kp have the largest lower and the smallest upper end."""
        ranges = [region.kp_range or (-math.inf, math.inf) for region in self.regions]
        return [int(np.argmax([low for low, _ in ranges])), int(np.argmin([high for _, high in ranges]))]

    @cached_property
    def few(self) -> Family:
        chosen = sorted(set(self.binding))
        return replace(self, systems=[self.systems[i] for i in chosen], dead_times=[self.dead_times[i] for i in chosen])

    def row(self, ki: float, specification: Specification, to: float | None = None) -> list[Interval]:
        """Return the intervals of kp that meet a specification at `ki`, or the stable gaps of the band `ki` to `to`."""
        met, intervals = Specification() if to else specification, []
        for family in (self.few, self):
            intervals = family.gaps(family.forbidden.gaps(ki, specification, to), ki, met)
            if not intervals or len(family.systems) == len(self.systems):
                break
        return intervals

    def gaps(self, intervals: list[Interval], ki: float, met: Specification) -> list[Interval]:
        """Return the intervals in which one tested kp meets the specification `met`; adjacent intervals are joined."""
        if met.crossover is not None:
            intervals = [piece for gap in intervals for piece in pairwise(np.linspace(*gap, _PIECES + 1).tolist())]
        good = self.meets(np.array([_inside(*gap) for gap in intervals]), ki, met)
        return _joined([gap for gap, is_good in zip(intervals, good, strict=True) if is_good])


def _rows(low: float, high: float, ms_max: float | None) -> Floats:
    ratio = 1 + float(np.clip(1 / (ms_max or 1), *_BAND))
    return np.asarray(low * ratio ** np.arange(math.log(high / low) / math.log(ratio) + 1))


def _joined(gaps: list[Interval]) -> list[Interval]:
    edges = [x for gap in gaps for x in gap]
    outer = [x for i, x in enumerate(edges) if edges[max(i - 1, 0) : i] != [x] and edges[i + 1 : i + 2] != [x]]
    return list(zip(outer[::2], outer[1::2], strict=True))


def _inside(low: float, high: float) -> float:
    # a small magnitude makes the root count cheaper
    if low * high > 0:
        return math.copysign(math.sqrt(low * high), low)
    return 0.5 * (high if low == 0 or (high != 0 and high < -low) else low)


def largest_ki(family: Family, specification: Specification) -> tuple[float, float]:
    """Return (kp, ki) with the largest ki that meets the specification; InfeasibleDesignError if there is none."""
    if any(region.is_empty for region in family.regions):
        raise _infeasible(family, specification)
    for ki, gaps in _highest_rows(family, specification):
        if ki > _LIMITLESS * family.ki_ends[1] and not any(family.dead_times):
            # without dead time and lag ki may be unbounded; report this instead of the limit of the search
            raise InfeasibleDesignError(
                "ki has no largest value: arbitrarily large gains meet the specification; bound the crossover, or "
                "include the dead time and the lags of the real loop in the plant"
            )
        best = max((_tip(family, specification, gap, ki) for gap in gaps), key=lambda gains: gains[1])
        if best[1] > 0:
            return best
    raise _infeasible(family, specification)


def _highest_rows(family: Family, specification: Specification) -> Iterator[tuple[float, list[Interval]]]:
    """Yield, from the largest down, values of ki with which some kp meet the specification, and the intervals of kp."""
    bounded = specification.ms_max is not None
    bands = list(pairwise(_rows(*family.ki_ends, specification.ms_max).tolist()))
    while bands:
        low, high = bands.pop()
        if bounded and not family.row(low, specification, high):
            continue
        if bounded and high > low * (1 + _FINEST):
            middle = math.sqrt(low * high)
            bands += [(low, middle), (middle, high)]
        elif gaps := family.row(low, specification):
            while high > low * (1 + _TOP):
                middle = math.sqrt(low * high)
                inner = family.row(middle, specification)
                low, high, gaps = (middle, high, inner) if inner else (low, middle, gaps)
            yield low, gaps


def _tip(family: Family, specification: Specification, gap: Interval, ki: float) -> tuple[float, float]:
    """Return (kp, ki) with the largest feasible ki near the interval `gap` of kp; ki is 0 if no gains are feasible."""
    stable = Specification(crossover=specification.crossover)
    around = gap[1] - gap[0] + _AROUND * max(map(abs, gap))
    window = ((gap[0] - around, gap[1] + around),)

    def left(samples: Forbidden, log_ki: float) -> tuple[Interval, ...]:
        here = math.exp(log_ki)
        near = common_intervals([tuple(samples.gaps(here, specification)), window])  # each stable throughout or nowhere
        return tuple(family.gaps(list(near), here, stable))

    # samples exclude no feasible gains: a tip that does not move when samples are refined is exact
    samples, moved = family.forbidden, _TOP
    for _ in range(_MOST_LOOKS):
        samples = samples.closer(0.5 * (gap[0] + gap[1]), ki, specification.ms_max or math.inf)
        bracket = _bracket(partial(left, samples), math.log(ki), moved)
        if bracket is None:
            return 0.0, 0.0
        low, high = bracket
        agree = max(_AGREE, moved / 1000)
        while high - low > agree:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if left(samples, middle) else (low, middle)
        gap = max(left(samples, low), key=lambda interval: interval[1] - interval[0])
        moved, ki = max(abs(low - math.log(ki)), agree), math.exp(low)
        if moved <= 10 * _AGREE:
            break
    kp = 0.5 * (gap[0] + gap[1])
    return kp, _refined_ki(family, specification, kp, ki)


def _least(objective: Callable[[float], float], low: float, high: float) -> float:
    from scipy.optimize import minimize_scalar

    grid = np.linspace(low, high, _LOOKS)
    best = int(np.argmin([objective(x) for x in grid.tolist()]))
    ends = grid[max(best - 1, 0)], grid[min(best + 1, grid.size - 1)]
    tolerance = _KP_TOLERANCE * max(abs(low), abs(high))
    result = minimize_scalar(objective, bounds=ends, method="bounded", options={"xatol": tolerance})
    return float(result.x)


def _refined_ki(family: Family, specification: Specification, kp: float, start: float) -> float:
    """Return the largest ki near or below `start` that meets the specification exactly; 0 if there is none."""

    def miss(log_ki: float) -> float:
        return min(family.excess(kp, math.exp(log_ki), specification), 1e3)

    bracket = _bracket(lambda x: miss(x) <= 0, math.log(start), 10 * _AGREE)
    if bracket is None:
        return 0.0
    lower, upper = bracket
    if lower == upper:
        return math.exp(lower)
    from scipy.optimize import brentq

    root = float(brentq(miss, lower, upper, xtol=1e-13, rtol=1e-15))
    # move by rounding errors to the side that meets the specification
    for margin in (0.0, 1e-14, 1e-13, 1e-12, 1e-11):
        if miss(root - margin) <= 0:
            return math.exp(root - margin)
    return math.exp(lower)


def _bracket(met: Callable[[float], object], start: float, step: float = 1e-3) -> tuple[float, float] | None:
    """Return two values of ln ki near `start`: `met` is true at the first and false at the second.

    Both are equal if no false value is found; None if no true one is found.
    """
    first, here = bool(met(start)), start
    while step < (_FAR_UP if first else _FAR_DOWN):
        ahead = here + (step if first else -step)
        if bool(met(ahead)) != first:
            return (here, ahead) if first else (ahead, here)
        here, step = ahead, 5 * step
    return (here, here) if first else None


def _infeasible(family: Family, specification: Specification) -> InfeasibleDesignError:
    common = (
        intersection(family.regions, family.names) if len(family.regions) > 1 or family.names else family.regions[0]
    )
    if common.kp_range is None:
        # do not recommend a lead if there is one
        reason = common.reason.replace("; no PI can: add a lead, or reduce", "; reduce")
        return InfeasibleDesignError(
            f"no PI behind the compensator stabilises the plant(s): {reason}"
            if family.compensated
            else f"no PI stabilises the plant(s): {common.reason}"
        )
    remedy = "relax the specification" + ("" if family.compensated else " or add a lead")
    texts = []
    alone = True
    for margin, sign, bound, text in (
        ("ms", 1, specification.ms_max, "the smallest worst Ms is {:.4g}"),
        ("phase_deg", -1, specification.phase_min_deg, "the largest phase margin is {:.4g} deg"),
        ("delay_s", -1, specification.delay_min_s, "the largest delay margin is {:.4g} s"),
    ):
        if bound:
            best = _best(family, margin)
            texts.append(text.format(sign * best))
            alone &= best <= sign * bound
    together = "; each requirement alone can be met, but not all together" if alone and len(texts) > 1 else ""
    return InfeasibleDesignError(
        f"specification cannot be met: {specification.description} is required, and with ki near 0 "
        f"{', '.join(texts)}{together}; {remedy}"
    )


def _best(family: Family, margin: str) -> float:
    ki = family.ki_ends[0]
    worst = partial(family.worst, ki=ki, margin=margin)
    gaps = _tightest(family, ki, Specification(), margin)
    return min((worst(_least(worst, *gap)) for gap in gaps), default=math.inf)


def _tightest(family: Family, ki: float, others: Specification, margin: str) -> list[Interval]:
    """Return the intervals of kp that meet the tightest bound on `margin` that can be met at `ki` with `others`."""

    def bounded(x: float) -> Specification:
        if margin == "ms":
            return replace(others, ms_max=1 + math.exp(-x))
        if margin == "phase_deg":
            return replace(others, phase_min_deg=x)
        return replace(others, delay_min_s=math.exp(x))

    low, high = {
        "ms": (-math.log(_LARGEST_MS), -math.log(_LEAST_MS)),
        "phase_deg": (0.0, 179.9),
        "delay_s": family.forbidden.log_times,
    }[margin]
    gaps = family.gaps(family.forbidden.gaps(ki, bounded(low)), ki, bounded(low))
    for _ in range(_TIGHTENINGS):
        middle = 0.5 * (low + high)
        inner = family.gaps(family.forbidden.gaps(ki, bounded(middle)), ki, bounded(middle))
        low, high, gaps = (middle, high, inner) if inner else (low, middle, gaps)
    return gaps


def least_ms(family: Family, specification: Specification, ki_min: float) -> tuple[float, float]:
    """Return (kp, ki) with the smallest worst Ms at ki >= `ki_min`; InfeasibleDesignError if there is none."""
    others = replace(specification, ms_max=None)

    def objective(kp: float, ki: float) -> float:
        met = others.only_ms or family.excess(kp, ki, others) <= 0
        return family.worst(kp, ki, "ms") if met else math.inf

    least, best, width = math.inf, None, 0.0
    rows = _rows(ki_min, max(family.ki_ends[1], ki_min), None)
    # Ms usually rises with ki, but an unstable plant may need more than ki_min
    for some in (rows[:1], rows[1:]):
        better = replace(others, ms_max=1 + min(_LARGEST_MS, (least - 1) * (1 - _TOP)))
        for ki in (row for row in some.tolist() if family.row(row, better)):
            for gap in _tightest(family, ki, others, "ms"):
                kp = _least(partial(objective, ki=ki), *gap)
                if (ms := objective(kp, ki)) < least:
                    least, best, width = ms, (kp, ki), gap[1] - gap[0]
    if best is None:
        raise _no_such_ki(family, specification, ki_min)
    kp, ki = _with_more_ki(objective, *best, ki_min, width)
    least = objective(kp, ki)
    if specification.ms_max is not None and least > specification.ms_max:
        raise InfeasibleDesignError(
            f"Ms <= {specification.ms_max:g} with ki >= {ki_min:g} cannot be met: the smallest worst Ms is "
            f"{least:.5g}; relax the specification"
        )
    return kp, ki


def _no_such_ki(family: Family, specification: Specification, ki_min: float) -> InfeasibleDesignError:
    largest, _ = next(_highest_rows(family, Specification()), (math.nan, []))
    if math.isnan(largest):
        return _infeasible(family, specification)
    if largest > ki_min and specification.description:
        reason = str(_infeasible(family, specification)).removeprefix("specification cannot be met: ")
        return InfeasibleDesignError(f"no PI with ki >= {ki_min:g} meets the specification: {reason}")
    return InfeasibleDesignError(
        f"no PI with ki >= {ki_min:g} stabilises all plants; give a ki_min of at most about {largest:.4g}, the "
        "largest ki with which a PI stabilises all plants"
    )


def _with_more_ki(
    objective: Callable[[float, float], float], kp: float, ki: float, ki_min: float, width: float
) -> tuple[float, float]:
    """Return gains with a larger ki and a smaller Ms than (kp, ki) if there are any, else (kp, ki)."""
    least = objective(kp, ki)
    if ki == ki_min and not objective(kp, 1.01 * ki) < least:
        return kp, ki
    from scipy.optimize import minimize

    def at(x: Floats) -> tuple[float, float]:
        return kp + width * float(x[0]), ki_min * math.exp(abs(float(x[1])))

    start = [0.0, math.log(ki / ki_min)]
    simplex = np.array(start) + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 0.05]])
    options = {"initial_simplex": simplex, "xatol": 1e-7, "fatol": 1e-12}
    better = minimize(lambda x: objective(*at(x)), start, method="Nelder-Mead", options=options)
    return at(better.x) if better.fun < least else (kp, ki)
