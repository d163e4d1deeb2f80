"""The search behind `tuning`: the PI gains that a specification leaves to a family of plants, and the best of them.

What each frequency forbids. Ms <= M: |1 + (kp + ki/(j omega)) P| >= 1/M reads (kp + x)^2 + (ki/omega - y)^2 >= r^2 with
x + j y = 1/P and r = |1/P|/M: one ellipse of gains for each plant and frequency ([Astrom1998], MIGO). Phase and delay
margin: a crossover at omega needs kp^2 + (ki/omega)^2 = |1/P|^2, and the phase there is that of C P: an arc of gains.

At one ki, the kp that the specification leaves are the gaps between those that each frequency forbids, however narrow;
one exact loop inside a gap tells whether it is stable, all frequencies heeded. So rows of ki, from the largest down,
find the highest gap; it is followed to its tip on ever closer frequencies, and the exact margins have the last word.
Every scale is the plants' own.

What an ellipse forbids at two ki it forbids between them, being convex: the gaps that remain of the band hold all gains
in it that meet the bound on Ms. They are stable or unstable as a whole if the band is so narrow, k2/k1 - 1 <= 1/M, that
no centre of an ellipse lies in one: the centres are the gains with a pole on the axis. So a band between two rows
without a stable gap has been searched for certain, and another is divided.
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

_PER_NODE = 6  # frequencies between neighbouring nodes of a plant
_TURN = 0.15  # rad of dead time between frequencies, as far as |C P| may matter
_MOST_TURNS = 6000  # of those
_FARTHEST = 4.0  # times its usual largest kp: with much integral action it may be somewhat more
_MATTERS = 0.5 / _FARTHEST  # |C P| below which no peak or margin of use is touched
_CLOSER = 61  # frequencies between the neighbours of one that binds, for a closer look
_NEARLY = 0.2  # of Ms - 1: frequencies that bind on less may do so on closer ones
_NARROWEST = 1e-9  # relative width of a gap below which it is the rounding of its ends
_REACH = 10.0  # from the gains of the highest samples to where those of a plant without dead time are limitless


class Forbidden:
    """The gains that plants exp(-dead_time s) forbid, sampled densely in frequency (rad/s).

    `usual_kp` is the largest gain of use to each plant with little integral action, inf if nothing bounds it.
    """

    def __init__(self, responses: Sequence[Response], omegas: Sequence[Floats], usual_kp: Sequence[float]) -> None:
        self._responses, self._omegas, self._usual_kp = responses, omegas, usual_kp
        self._omega = np.concatenate(omegas)
        self._member = np.repeat(np.arange(len(omegas)), [omega.size for omega in omegas])
        with np.errstate(divide="ignore", invalid="ignore"):
            self._inverse = np.concatenate([1 / r(w) for r, w in zip(responses, omegas, strict=True)])
        self._inverse[~np.isfinite(self._inverse)] = np.nan  # at a zero on the axis, where nothing is forbidden
        self._size = np.abs(self._inverse)
        mine = [self._member == i for i in range(len(omegas))]
        last = np.cumsum([omega.size for omega in omegas]) - 1
        self._last_of_double = last[[r.dead_time == 0 and r.system.relative_degree == 2 for r in responses]]
        self.reach = min(_REACH * float(np.nanmax(self._size[one])) for one in mine)
        """kp, in size, beyond which a crossover of some plant lies above all samples; the like for ki are `ki_ends`."""
        self.reach = min(self.reach, *(_FARTHEST * kp for kp in usual_kp))
        ki = self._omega * self._size
        self.ki_ends = float(np.nanmin(ki)) / _REACH**3, min(float(np.nanmax(ki[one])) for one in mine) / _REACH
        self.log_times = -math.log(self._omega.max()) - 7.0, 7.0 - math.log(self._omega.min())
        """ln of times, s, far below and above those of the plants."""

    @classmethod
    def sampled(cls, systems: Sequence[Rational], dead_times: Sequence[float], usual_kp: Sequence[float]) -> Forbidden:
        """By frequencies between which the gains are nearly straight."""
        responses = [Response(g, tau) for g, tau in zip(systems, dead_times, strict=True)]
        return cls(responses, [_frequencies(*pair) for pair in zip(responses, usual_kp, strict=True)], usual_kp)

    def closer(self, kp: float, ki: float, ms_max: float) -> Forbidden:
        """With more samples where these gains have a crossover, or a dip of |1 + L| near 1/`ms_max` (or inf)."""
        with np.errstate(divide="ignore", invalid="ignore"):  # at a pole on the axis
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
        """The intervals of kp between those that the samples forbid at this ki > 0, ascending, within `reach`.

        With `to`, a larger ki: between those that Ms forbids at all ki from one to the other.
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
        """kp, from and to, that Ms forbids above the last sample of plants that fall as 1/s^2, without dead time.

        There centre -x and radius of the ellipses grow as omega^2, y at most as omega, and ki/omega falls. So if
        ki/omega + |y| < r at the last sample, an ellipse contains every kp beyond its centre. Such gains are stable:
        without this, every row would keep a gap up there.
        """
        last = self._last_of_double
        last = last[ki / self._omega[last] + np.abs(self._inverse.imag[last]) < radius[last]]
        kp = -self._inverse.real[last]
        return np.where(kp > 0, kp, -np.inf), np.where(kp > 0, np.inf, kp)

    def _arcs(self, vertical: Floats, specification: Specification) -> list[tuple[Floats, Floats]]:
        """kp, from and to, that put a crossover between neighbouring samples where it leaves too little phase."""
        phase = np.deg2rad(specification.phase_min_deg or 0.0)
        if specification.ms_max is not None:
            phase = max(phase, 2 * np.arcsin(0.5 / specification.ms_max))  # |1 + L| there is 2 sin(phase/2)
        size = _leg(self._size, vertical)
        with np.errstate(invalid="ignore"):
            at = np.flatnonzero(((size[:-1] > 0) | (size[1:] > 0)) & (np.diff(self._member) == 0))
        found = []
        for kp in (-size, size):
            with np.errstate(invalid="ignore"):
                left = np.angle((1j * vertical - kp) * self._inverse.conj())  # from -180 deg, rad
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
                found.append((np.minimum(one, other), np.maximum(one, other)))
        return found

    def _crossover_ends(self, ki: float, specification: Specification) -> list[tuple[Floats, Floats]]:
        """kp at which a crossover is at an end of its range: forbidden by itself, so that a gap ends there."""
        ends = [w for w in specification.crossover or () if 0 < w < np.inf]
        sizes = np.array([[1 / np.abs(r(np.array([w]))[0]), ki / w] for w in ends for r in self._responses])
        kp = _leg(*sizes.T) if ends else np.array([])
        return [(side * kp, side * kp) for side in (-1.0, 1.0)]


def _frequencies(response: Response, usual_kp: float) -> Floats:
    """Dense enough that what lies between neighbours is nearly straight; the same whatever the unit of gain is."""
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
    """sqrt(hypotenuse^2 - other^2), 0 where that is negative."""
    with np.errstate(invalid="ignore"):
        square = (hypotenuse - other) * (hypotenuse + other)
        return np.asarray(np.sqrt(np.where(square > 0, square, 0.0)))


def _share(*ends: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """From where to where, of a step from 0 to 1, quantities that go straight from one end to the other are all >= 0;
    from past to where they never are."""
    start, end = np.zeros(ends[0][0].size), np.ones(ends[0][0].size)
    for first, last in ends:
        with np.errstate(invalid="ignore", divide="ignore"):
            zero = first / (first - last)
        start = np.where(first < 0, np.where(last < 0, 2.0, np.fmax(start, zero)), start)
        end = np.where(last < 0, np.where(first < 0, -1.0, np.fmin(end, zero)), end)
    return start, end


# --- the search -------------------------------------------------------------------------------------------------------


_BAND = 0.02, 0.25  # least and largest relative width of the bands of ki looked at first
_NEARLY_NO_KI = 1e-9  # of the largest ki, at most
_LIMITLESS = 0.1  # of the largest ki: without dead time a design so high could be as high as you like
_AROUND = 0.01  # relative, of kp: how far from the samples' best gap the exact one may be
_AGREE = 1e-10  # ln ki: how near to the tip of a gap
_MOST_LOOKS = 12  # at a tip, at frequencies 30 times closer each time
_FAR_UP, _FAR_DOWN = 4.0, 20.0  # ln ki: largest step of a search for where a specification is met or missed
_FINEST = 0.04  # relative width of a band of ki that is not divided further
_LOOKS = 7  # at the kp of a gap
_TOP = 2e-3  # relative: how near to the best row a bisection comes before the exact margins take over
_PIECES = 8  # of a gap, where a crossover is asked for: another gain crossover may become the one that counts
_LARGEST_MS = 1e6  # above 1: a loop with more is as good as unstable
_LEAST_MS = 1e-9  # above 1
_TIGHTENINGS = 16  # halvings of a bound before the exact margins take over
_KP_TOLERANCE = 1e-8  # relative, of kp at the optimum
_FEW = 4  # gains asked about all plants at once


@dataclass(frozen=True)
class Family:
    systems: list[Rational]
    dead_times: list[float]
    compensated: bool
    names: tuple[str, ...]

    @cached_property
    def regions(self) -> list[StabilizingRegion]:
        """The gains that stabilise each plant."""
        return [stabilizing_pi(g, dead_time=tau) for g, tau in zip(self.systems, self.dead_times, strict=True)]

    def loops(self, kp: float, ki: float) -> list[DeadTimeLoop]:
        controller = pi_transfer_function(kp, ki)
        return [DeadTimeLoop(controller * g, tau) for g, tau in zip(self.systems, self.dead_times, strict=True)]

    def margins(self, kp: Floats, ki: float, *, peaks: bool) -> BatchMargins:
        """Of every loop but gain margins, for gains kp, (n,): n times the number of plants, those of a kp together."""
        loops = [loop for one in kp.tolist() for loop in self.loops(one, ki)]
        return family_margins(loops, gain_margins=False, peaks=peaks)

    def worst(self, kp: float, ki: float, margin: str) -> float:
        """The worst of a margin over the plants, negative if more of it is better; inf where a loop is unstable."""
        margins = self.margins(np.array([kp]), ki, peaks=margin == "ms")
        values = getattr(margins, margin) * (1 if margin == "ms" else -1)
        return float(np.where(margins.stable, values, np.inf).max())

    def excess(self, kp: float, ki: float, specification: Specification) -> float:
        """How far the worst loop misses the specification, relatively; <= 0 meets it, inf is unstable."""
        return float(self.excesses(np.array([kp]), ki, specification)[0])

    def excesses(self, kp: Floats, ki: float, specification: Specification) -> Floats:
        """As `excess`, for many kp, (n,), at once."""
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
            misses = np.fmax(misses, np.where(np.isnan(at), 1.0, outside))  # a loop without crossover has none there
        return np.asarray(np.where(margins.stable.reshape(shape), misses, np.inf).max(axis=1))

    def meets(self, kp: Floats, ki: float, specification: Specification) -> Flags:
        """Whether each of many kp, (n,), meets the specification: the first plant alone spares the others most of those
        that do not."""
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
        """A ki too small to matter, and one too large to stabilise all plants (without dead time: to be of use)."""
        low, high = self.forbidden.ki_ends
        high = min(high, *(r.decomposition.largest_ki for r in self.regions))
        return min(low, _NEARLY_NO_KI * high), high

    @cached_property
    def binding(self) -> list[int]:
        """The plants that bound kp from below and from above."""
        ranges = [region.kp_range or (-math.inf, math.inf) for region in self.regions]
        return [int(np.argmax([low for low, _ in ranges])), int(np.argmin([high for _, high in ranges]))]

    @cached_property
    def few(self) -> Family:
        """The plants that bound kp alone: what they forbid need not be asked of all."""
        chosen = sorted(set(self.binding))
        return replace(self, systems=[self.systems[i] for i in chosen], dead_times=[self.dead_times[i] for i in chosen])

    def row(self, ki: float, specification: Specification, to: float | None = None) -> list[Interval]:
        """The intervals of kp that meet a specification at a ki; or that Ms leaves from it `to` another, as far as they
        are stable."""
        met, found = Specification() if to else specification, []
        for family in (self.few, self):
            found = family.gaps(family.forbidden.gaps(ki, specification, to), ki, met)
            if not found or len(family.systems) == len(self.systems):
                break
        return found

    def gaps(self, found: list[Interval], ki: float, met: Specification) -> list[Interval]:
        """Those intervals of kp of which one loop inside meets a specification exactly."""
        if met.crossover is not None:
            found = [piece for gap in found for piece in pairwise(np.linspace(*gap, _PIECES + 1).tolist())]
        good = self.meets(np.array([_inside(*gap) for gap in found]), ki, met)
        return _joined([gap for gap, kept in zip(found, good, strict=True) if kept])


def _rows(low: float, high: float, ms_max: float | None) -> Floats:
    """Integral gains from one to another, ascending."""
    ratio = 1 + float(np.clip(1 / (ms_max or 1), *_BAND))
    return np.asarray(low * ratio ** np.arange(math.log(high / low) / math.log(ratio) + 1))


def _joined(gaps: list[Interval]) -> list[Interval]:
    """Those that touch taken together."""
    edges = [x for gap in gaps for x in gap]
    kept = [x for i, x in enumerate(edges) if edges[max(i - 1, 0) : i] != [x] and edges[i + 1 : i + 2] != [x]]
    return list(zip(kept[::2], kept[1::2], strict=True))


def _inside(low: float, high: float) -> float:
    """A gain between two others, of the order of the smaller one: far up, the root count is of larger numbers."""
    if low * high > 0:
        return math.copysign(math.sqrt(low * high), low)
    return 0.5 * (high if low == 0 or (high != 0 and high < -low) else low)


# -- maximise ki ------------------------------------------------------------------------------------------------


def largest_ki(family: Family, specification: Specification) -> tuple[float, float]:
    if any(region.is_empty for region in family.regions):
        raise _infeasible(family, specification)
    for ki, gaps in _highest_rows(family, specification):
        if ki > _LIMITLESS * family.ki_ends[1] and not any(family.dead_times):
            # with little lag, gains may grow for ever: say so instead of returning a search limit
            raise InfeasibleDesignError(
                "ki has no largest value: ever larger gains meet the specification; bound the crossover, or put the "
                "dead time and the lags that the real loop has into the plant"
            )
        best = max((_tip(family, specification, gap, ki) for gap in gaps), key=lambda gains: gains[1])
        if best[1] > 0:
            return best
    raise _infeasible(family, specification)


def _highest_rows(family: Family, specification: Specification) -> Iterator[tuple[float, list[Interval]]]:
    """Integral gains that meet the specification, from near the largest down, with the intervals of kp there."""
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
                found = family.row(middle, specification)
                low, high, gaps = (middle, high, found) if found else (low, middle, gaps)
            yield low, gaps


def _tip(family: Family, specification: Specification, gap: Interval, ki: float) -> tuple[float, float]:
    """(kp, ki) of largest ki next to an interval of kp that meets the specification; ki 0 if none does exactly."""
    stable = Specification(crossover=specification.crossover)
    around = gap[1] - gap[0] + _AROUND * max(map(abs, gap))
    window = ((gap[0] - around, gap[1] + around),)

    def left(samples: Forbidden, log_ki: float) -> tuple[Interval, ...]:
        here = math.exp(log_ki)
        near = common_intervals([tuple(samples.gaps(here, specification)), window])  # stable as a whole, or not
        return tuple(family.gaps(list(near), here, stable))

    # the samples forbid nothing that may be had: a tip that stays where it is on a closer look is the true one
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
        gap = max(left(samples, low), key=lambda one: one[1] - one[0])
        moved, ki = max(abs(low - math.log(ki)), agree), math.exp(low)
        if moved <= 10 * _AGREE:
            break
    kp = 0.5 * (gap[0] + gap[1])
    return kp, _refined_ki(family, specification, kp, ki)


def _least(objective: Callable[[float], float], low: float, high: float) -> float:
    """Where a function is least between `low` and `high`; of several minima, one that a coarse look prefers."""
    from scipy.optimize import minimize_scalar

    look = np.linspace(low, high, _LOOKS)
    best = int(np.argmin([objective(x) for x in look.tolist()]))
    ends = look[max(best - 1, 0)], look[min(best + 1, look.size - 1)]
    tolerance = _KP_TOLERANCE * max(abs(low), abs(high))
    result = minimize_scalar(objective, bounds=ends, method="bounded", options={"xatol": tolerance})
    return float(result.x)


def _refined_ki(family: Family, specification: Specification, kp: float, start: float) -> float:
    """The largest ki near or below `start` that meets the specification exactly; 0 if there is none."""

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
    # land on the side that meets it, by a step of rounding
    for margin in (0.0, 1e-14, 1e-13, 1e-12, 1e-11):
        if miss(root - margin) <= 0:
            return math.exp(root - margin)
    return math.exp(lower)


def _bracket(met: Callable[[float], object], start: float, step: float = 1e-3) -> tuple[float, float] | None:
    """(met, missed) values of ln ki around `start`; both equal if none is missed; None if none is met."""
    first, here = bool(met(start)), start
    while step < (_FAR_UP if first else _FAR_DOWN):
        ahead = here + (step if first else -step)
        if bool(met(ahead)) != first:
            return (here, ahead) if first else (ahead, here)
        here, step = ahead, 5 * step
    return (here, here) if first else None


def _infeasible(family: Family, specification: Specification) -> InfeasibleDesignError:
    """What each bound alone could be, with next to no integral action."""
    common = (
        intersection(family.regions, family.names) if len(family.regions) > 1 or family.names else family.regions[0]
    )
    if common.kp_range is None:
        # a lead is no advice where there is one
        reason = common.reason.replace("; no PI can: add a lead, or reduce", "; reduce")
        return InfeasibleDesignError(
            f"no PI behind the compensator stabilises the plant(s): {reason}"
            if family.compensated
            else f"no PI stabilises the plant(s): {common.reason}"
        )
    remedy = "relax the specification" + ("" if family.compensated else " or add a lead")
    found = []
    alone = True
    for margin, sign, bound, words in (
        ("ms", 1, specification.ms_max, "least worst Ms {:.4g}"),
        ("phase_deg", -1, specification.phase_min_deg, "largest phase margin {:.4g} deg"),
        ("delay_s", -1, specification.delay_min_s, "largest delay margin {:.4g} s"),
    ):
        if bound:
            best = _best(family, margin)
            found.append(words.format(sign * best))
            alone &= best <= sign * bound
    together = "; each alone can be met, together they cannot" if alone and len(found) > 1 else ""
    return InfeasibleDesignError(
        f"specification cannot be met: {specification.words} is asked for, and with ki near 0 the best is "
        f"{', '.join(found)}{together}; {remedy}"
    )


def _best(family: Family, margin: str) -> float:
    """Least `Family.worst` over kp with next to no integral action; inf if nothing is stable."""
    ki = family.ki_ends[0]
    worst = partial(family.worst, ki=ki, margin=margin)
    gaps = _tightest(family, ki, Specification(), margin)
    return min((worst(_least(worst, *gap)) for gap in gaps), default=math.inf)


def _tightest(family: Family, ki: float, others: Specification, margin: str) -> list[Interval]:
    """The intervals of kp that remain of a row as the bound on one margin tightens, whatever the `others` leave."""

    def asked(x: float) -> Specification:
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
    gaps = family.gaps(family.forbidden.gaps(ki, asked(low)), ki, asked(low))
    for _ in range(_TIGHTENINGS):
        middle = 0.5 * (low + high)
        found = family.gaps(family.forbidden.gaps(ki, asked(middle)), ki, asked(middle))
        low, high, gaps = (middle, high, found) if found else (low, middle, gaps)
    return gaps


# -- minimise Ms ------------------------------------------------------------------------------------------------


def least_ms(family: Family, specification: Specification, ki_min: float) -> tuple[float, float]:
    others = replace(specification, ms_max=None)

    def objective(kp: float, ki: float) -> float:
        met = others.only_ms or family.excess(kp, ki, others) <= 0
        return family.worst(kp, ki, "ms") if met else math.inf

    least, best, width = math.inf, None, 0.0
    rows = _rows(ki_min, max(family.ki_ends[1], ki_min), None)
    # Ms seldom falls as ki grows, but an unstable plant may need more than ki_min
    for some in (rows[:1], rows[1:]):
        better = replace(others, ms_max=1 + min(_LARGEST_MS, (least - 1) * (1 - _TOP)))
        for ki in (one for one in some.tolist() if family.row(one, better)):
            for gap in _tightest(family, ki, others, "ms"):
                kp = _least(partial(objective, ki=ki), *gap)
                if (found := objective(kp, ki)) < least:
                    least, best, width = found, (kp, ki), gap[1] - gap[0]
    if best is None:
        raise _no_such_ki(family, specification, ki_min)
    kp, ki = _with_more_ki(objective, *best, ki_min, width)
    least = objective(kp, ki)
    if specification.ms_max is not None and least > specification.ms_max:
        raise InfeasibleDesignError(
            f"Ms <= {specification.ms_max:g} with ki >= {ki_min:g} is asked for, and the least worst Ms is {least:.5g}"
        )
    return kp, ki


def _no_such_ki(family: Family, specification: Specification, ki_min: float) -> InfeasibleDesignError:
    """Nothing holds with that much integral action: say how much there may be, or what the other bounds cost."""
    largest, _ = next(_highest_rows(family, Specification()), (math.nan, []))
    if math.isnan(largest):
        return _infeasible(family, specification)
    if largest > ki_min and specification.words:
        return InfeasibleDesignError(f"with ki >= {ki_min:g} no PI meets it: {_infeasible(family, specification)}")
    return InfeasibleDesignError(
        f"no PI with ki >= {ki_min:g} holds all plants; the largest ki that does is about {largest:.4g}"
    )


def _with_more_ki(
    objective: Callable[[float, float], float], kp: float, ki: float, ki_min: float, width: float
) -> tuple[float, float]:
    """If Ms falls as ki grows (it seldom does), follow it; `width` is a step of kp."""
    least = objective(kp, ki)
    if ki == ki_min and not objective(kp, 1.01 * ki) < least:
        return kp, ki
    from scipy.optimize import minimize

    def at(x: Floats) -> tuple[float, float]:
        return kp + width * float(x[0]), ki_min * math.exp(abs(float(x[1])))

    start = [0.0, math.log(ki / ki_min)]
    simplex = np.array(start) + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 0.05]])
    options = {"initial_simplex": simplex, "xatol": 1e-7, "fatol": 1e-12}
    found = minimize(lambda x: objective(*at(x)), start, method="Nelder-Mead", options=options)
    return at(found.x) if found.fun < least else (kp, ki)
