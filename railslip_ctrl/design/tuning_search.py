"""The search behind `tuning`: a family of plants, the gains that keep a specification, the best of them.

Where Ms <= M is asked for, each frequency forbids an ellipse of gains (`ellipses`). The exact loop decides each gap
between the ellipses, and the best point is refined on the exact margins.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.errors import InfeasibleDesignError
from railslip_ctrl.loop import DeadTimeLoop, Rational
from railslip_ctrl.loop.batch import BatchMargins

from .ellipses import Ellipses, Gap
from .families import family_margins
from .specification import Specification
from .stabilizing import StabilizingRegion, intersection, stabilizing_pi

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

_KP_POINTS = 80  # over the stabilising range: a coarse look, refined afterwards
_SCAN_POINTS, _SCAN_RATIO = 40, 1.25  # integral gains looked at below a bound: down to 1e-4 of it
_ZOOM_STARTS, _ZOOMS, _ZOOM_POINTS, _ZOOM_SHRINK = 4, 12, 9, 0.6
_LOG_SCAN_RATIO = math.log(_SCAN_RATIO) + 1e-6
_ELLIPSES_AGREE = 1e-6  # relative, of their end with the exact limit: both are exact, this one's rounding is 1e-9
_FEW = 4  # gains asked about all plants at once
_SCANNED_AT_ONCE = 10  # of `_SCAN_POINTS`
_UNBOUNDED = 1e4  # a stabilising range without upper end is searched up to this factor above its scale


def pi_transfer_function(kp: float, ki: float) -> Rational:
    """kp + ki/s in factored form; ki = 0 has no integrator."""
    if ki == 0:
        return Rational(np.array([]), np.array([]), kp)
    if kp == 0:
        return Rational(np.array([]), np.array([0.0]), ki)
    return Rational(np.array([-ki / kp]), np.array([0.0]), kp)


@dataclass(frozen=True)
class Family:
    systems: list[Rational]
    dead_times: list[float]
    compensated: bool = False
    names: tuple[str, ...] = ()

    @cached_property
    def regions(self) -> list[StabilizingRegion]:
        """The gains that stabilise each plant."""
        return [stabilizing_pi(g, dead_time=tau) for g, tau in zip(self.systems, self.dead_times, strict=True)]

    def loops(self, kp: float, ki: float) -> list[DeadTimeLoop]:
        controller = pi_transfer_function(kp, ki)
        return [DeadTimeLoop(controller * g, tau) for g, tau in zip(self.systems, self.dead_times, strict=True)]

    def stable(self, kp: float, ki: float) -> bool:
        return all(loop.is_stable() for loop in self.loops(kp, ki))

    def margins(self, kp: Floats, ki: Floats, *, peaks: bool) -> BatchMargins:
        """Of every loop but gain margins, for gains of shape (n,): n times the number of plants, those of a gain
        together."""
        loops = [loop for a, b in zip(kp, ki, strict=True) for loop in self.loops(a, b)]
        return family_margins(loops, gain_margins=False, peaks=peaks)

    def worst(self, kp: Floats, ki: Floats, margin: str) -> Floats:
        """The worst of a margin over the plants, negative if more of it is better; inf where a loop is unstable."""
        margins, shape = self.margins(kp, ki, peaks=margin == "ms"), (kp.size, len(self.systems))
        values = getattr(margins, margin).reshape(shape) * (1 if margin == "ms" else -1)
        return np.asarray(np.where(margins.stable.reshape(shape), values, np.inf).max(axis=1))

    def excess(self, kp: float, ki: float, specification: Specification) -> float:
        """How far the worst loop misses the specification, relatively; <= 0 meets it, inf is unstable."""
        return float(self.excesses(np.array([kp]), np.array([ki]), specification)[0])

    def excesses(self, kp: Floats, ki: Floats, specification: Specification) -> Floats:
        """As `excess`, for many gains at once; arrays of one shape (n,)."""
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
            outside = np.fmax(at / high - 1, 1 - at / low if low > 0 else -1.0)
            misses = np.fmax(misses, np.where(np.isnan(at), 1.0, outside))  # a loop without crossover has none there
        return np.asarray(np.where(margins.stable.reshape(shape), misses, np.inf).max(axis=1))

    def meets(self, kp: Floats, ki: Floats, specification: Specification) -> Flags:
        """Whether each of many gains, (n,), meets the specification: the first plant alone spares the others most of
        those that do not."""
        met = np.ones(kp.size, dtype=bool)
        for part in (slice(0, 1), slice(1, None)) if kp.size > _FEW else (slice(None),):
            some = replace(self, systems=self.systems[part], dead_times=self.dead_times[part])
            if some.systems and met.any():
                met[met] = some.excesses(kp[met], ki[met], specification) <= 0
        return met

    def kp_values(self) -> Floats:
        """A coarse grid over the gains that stabilise all plants with little integral action."""
        common = intersection(self.regions, self.names) if len(self.regions) > 1 or self.names else self.regions[0]
        if common.kp_range is None:
            # a lead is no advice where there is one
            reason = common.reason.replace("; no PI can: add a lead, or reduce", "; reduce")
            raise InfeasibleDesignError(
                f"no PI behind the compensator stabilises the plant(s): {reason}"
                if self.compensated
                else f"no PI stabilises the plant(s): {common.reason}"
            )
        return np.concatenate([_spread(low, high) for low, high in common.kp_intervals])

    def kp_unbounded(self) -> bool:
        """Whether ever larger kp stabilise all plants: then a peak or a margin may bound nothing."""
        return all(region.kp_range is not None and math.isinf(region.kp_range[1]) for region in self.regions)


def _spread(low: float, high: float) -> Floats:
    """Points inside (low, high), geometric where the sign allows it, dense towards the ends."""
    if not math.isfinite(high):
        high = max(abs(low), 1.0) * _UNBOUNDED
    if not math.isfinite(low):
        low = -max(abs(high), 1.0) * _UNBOUNDED
    share = 0.5 * (1 - np.cos(np.pi * (np.arange(_KP_POINTS) + 0.5) / _KP_POINTS))
    if low > 0 and high / low > 4:
        return np.asarray(low * (high / low) ** share)
    if low >= 0 and high > 0:
        floor = max(low, high * 1e-6)
        return np.union1d(low + (high - low) * share, floor * (high / floor) ** share)
    # a stable plant: gains near 0 are where Ms tends to 1
    size = np.geomspace(1e-6, 1.0, _KP_POINTS // 2)
    inside = np.concatenate([low * size, [0.0], high * size, low + (high - low) * share])
    return np.unique(inside[(inside > low) & (inside < high)])


# -- maximise ki ------------------------------------------------------------------------------------------------


def largest_ki(family: Family, specification: Specification) -> tuple[float, float]:
    grid = family.kp_values()
    search = _Search(family, specification.ms_max) if specification.ms_max is not None else None
    coarse = search.largest_ki(grid) if search is not None else _largest_stable_ki(family, grid)
    if not specification.only_ms:
        coarse = _scanned(family, specification, grid, coarse)
    if not np.any(coarse > 0):
        raise _infeasible(family, specification, grid)
    _refuse_unbounded(family, grid, coarse)
    if search is not None and specification.only_ms:
        kp, ki = _on_the_ellipses(family, specification, search, grid, coarse)
    else:
        kp, start = _zoomed(family, specification, grid, coarse)
        near = kp + abs(kp) * np.array([-0.1, 0.0, 0.1])  # the ridge of one smooth bound, finer than the zoom
        kp = _maximise_near(lambda x: _refined_ki(family, specification, x, start), near, np.array([0.0, start, 0.0]))
        ki = _refined_ki(family, specification, kp, start)
    if ki <= 0:
        raise _infeasible(family, specification, grid)
    return kp, ki


def _on_the_ellipses(
    family: Family, specification: Specification, search: _Search, grid: Floats, coarse: Floats
) -> tuple[float, float]:
    """(kp, ki) of largest ki where Ms alone bounds it: along the ellipses, and at the end by the exact margins."""

    def exactly(kp: float) -> float:
        return _refined_ki(family, specification, kp, search.end_at(kp))

    kp = _maximise_near(search.end_at, grid, coarse)
    ki = exactly(kp)
    if not abs(ki - search.end_at(kp)) <= _ELLIPSES_AGREE * ki:
        # what bounds ki lies beyond the frequencies of the ellipses: search on the exact margins
        kp = _maximise_near(exactly, grid, coarse)
        ki = exactly(kp)
    return kp, ki


def _refuse_unbounded(family: Family, grid: Floats, coarse: Floats) -> None:
    """Without dead time and with little lag, gains may grow for ever: say so instead of returning a search limit."""
    if family.kp_unbounded() and (np.isinf(coarse).any() or int(np.argmax(coarse)) == grid.size - 1):
        raise InfeasibleDesignError(
            "ki has no largest value: ever larger gains meet the specification; bound the crossover, or put the dead "
            "time and the lags that the real loop has into the plant"
        )


def _zoomed(family: Family, specification: Specification, grid: Floats, coarse: Floats) -> tuple[float, float]:
    """(kp, ki) of largest ki that meets the specification, by grids that close in on the best point found.

    Several bounds together leave a region with corners, where a search along kp alone would stop early.
    """
    best = (float(grid[int(np.argmax(coarse))]), float(coarse.max()))
    padded = np.concatenate([[-np.inf], coarse, [-np.inf]])
    peaks = np.flatnonzero((coarse >= padded[:-2]) & (coarse >= padded[2:]) & (coarse > 0))
    tops = peaks[np.argsort(-coarse[peaks])][:_ZOOM_STARTS]
    for top in tops:
        kp, ki = float(grid[top]), float(coarse[top])
        spacing = 1.5 * float(max(grid[min(top + 1, grid.size - 1)] - kp, kp - grid[max(top - 1, 0)]))
        ratio = _SCAN_RATIO
        for _ in range(_ZOOMS):
            across = kp + spacing * np.linspace(-1, 1, _ZOOM_POINTS)
            up = ki * ratio ** np.linspace(-0.25, 1, _ZOOM_POINTS)
            gains = np.repeat(across, up.size), np.tile(up, across.size)
            met = family.meets(*gains, specification)
            if met.any():
                at = int(np.argmax(np.where(met, gains[1], -np.inf)))
                kp, ki = float(gains[0][at]), float(gains[1][at])
            spacing, ratio = _ZOOM_SHRINK * spacing, ratio**_ZOOM_SHRINK
        if ki > best[1]:
            best = kp, ki
    return best


def _scanned(family: Family, specification: Specification, kp: Floats, upper: Floats) -> Floats:
    """For each kp the largest ki of a geometric grid below `upper` that meets the specification; 0 if none does."""
    upper = np.where(np.isinf(upper), np.maximum(np.abs(kp), 1.0) * _UNBOUNDED, upper)
    ki = upper[:, None] * _SCAN_RATIO ** -np.arange(_SCAN_POINTS, dtype=float)[None, :]
    found = np.zeros(kp.size)
    for start in range(0, _SCAN_POINTS, _SCANNED_AT_ONCE):
        live = np.flatnonzero((upper > 0) & (found == 0))
        below = ki[live, start : start + _SCANNED_AT_ONCE]
        met = family.meets(np.repeat(kp[live], below.shape[1]), below.ravel(), specification).reshape(below.shape)
        found[live] = np.where(met.any(axis=1), below[np.arange(live.size), np.argmax(met, axis=1)], 0.0)
    return found


def _largest_stable_ki(family: Family, kp: Floats) -> Floats:
    return np.array([min(region.ki_limit(float(one)) for region in family.regions) for one in kp])


def _refined_ki(family: Family, specification: Specification, kp: float, start: float) -> float:
    """The largest ki near or below `start` that meets the specification exactly; 0 if there is none."""
    if not start > 0:
        return 0.0
    if math.isinf(start):
        start = abs(kp) * _UNBOUNDED or _UNBOUNDED

    def miss(log_ki: float) -> float:
        return min(family.excess(kp, math.exp(log_ki), specification), 1e3)

    # the ellipses are sampled, the scan is coarse: the exact limit may lie a little to either side
    bracket = _bracket(miss, math.log(start))
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


def _bracket(miss: Callable[[float], float], start: float) -> tuple[float, float] | None:
    """(met, missed) neighbouring values of ln ki around `start`; both equal if none is missed; None if none is met."""
    if miss(start) <= 0:
        lower = start
        for step in (1e-3, 0.02, 0.1, 0.4, 1.5):
            if miss(lower + step) > 0:
                return lower, lower + step
            lower += step
        return lower, lower
    upper = start
    for step in (2e-3, 0.02, 0.15, _LOG_SCAN_RATIO, 1.5, 3.0, 6.0, 10.0):
        if miss(start - step) <= 0:
            return start - step, upper
        upper = start - step
    return None


def _maximise_near(value: Callable[[float], float], grid: Floats, coarse: Floats) -> float:
    """Maximum of `value` around the best grid point."""
    from scipy.optimize import minimize_scalar

    top = int(np.argmax(coarse))
    low, high = grid[max(top - 1, 0)], grid[min(top + 1, grid.size - 1)]
    result = minimize_scalar(
        lambda kp: -value(kp), bounds=(float(low), float(high)), method="bounded", options={"xatol": 1e-7 * abs(high)}
    )
    return float(result.x) if -result.fun >= value(float(grid[top])) else float(grid[top])


class _Search:
    """Over the `Ellipses` of a family: which gaps are stable only the exact loops tell."""

    def __init__(self, family: Family, ms_max: float) -> None:
        self._family = family
        self._specification = Specification(ms_max=ms_max)
        self._ellipses = Ellipses(family.systems, family.dead_times, ms_max)

    def largest_ki(self, kp: Floats) -> Floats:
        """For each kp, (n,), the upper end of the highest gap between forbidden ki that is stable, as the samples
        show it; 0 without one."""
        return np.array([0.0 if gap is None else gap.end for gap in self._highest(kp)])

    def end_at(self, kp: float) -> float:
        """As `largest_ki`, to rounding, for one kp."""
        gap = self._highest(np.array([kp]))[0]
        return 0.0 if gap is None else self._ellipses.end_of(kp, gap)

    def _highest(self, kp: Floats) -> list[Gap | None]:
        gaps = [self._ellipses.gaps(float(one)) for one in kp]
        found: list[Gap | None] = [None] * kp.size
        left, looked, more = list(range(kp.size)), 0, max(1, _FEW // kp.size)
        while left := [i for i in left if looked < len(gaps[i])]:
            tried = [(i, gap) for i in left for gap in gaps[i][looked : looked + more]]
            index, insides = np.array([i for i, _ in tried]), np.array([gap.inside for _, gap in tried])
            # the sampled frequencies end somewhere: what lies beyond their reach only the exact loop tells
            met = np.flatnonzero(self._family.meets(kp[index], insides, self._specification))
            for number in met[::-1].tolist():  # the first of each, which is its highest, is put in last
                found[tried[number][0]] = tried[number][1]
            left = [i for i in left if found[i] is None]
            looked, more = looked + more, 2 * more  # few calls where the stable gap comes late
        return found


def _infeasible(family: Family, specification: Specification, grid: Floats) -> InfeasibleDesignError:
    """What each bound alone could be, with next to no integral action."""
    remedy = "relax the specification" + ("" if family.compensated else " or add a lead")
    found = []
    alone = True
    if specification.ms_max is not None:
        best = _best(family, grid, "ms")
        found.append(f"least worst Ms {best:.4g}")
        alone &= best <= specification.ms_max
    if specification.phase_min_deg:
        best = -_best(family, grid, "phase_deg")
        found.append(f"largest phase margin {best:.4g} deg")
        alone &= best >= specification.phase_min_deg
    if specification.delay_min_s:
        best = -_best(family, grid, "delay_s")
        found.append(f"largest delay margin {best:.4g} s")
        alone &= best >= specification.delay_min_s
    together = "; each alone can be met, together they cannot" if alone and len(found) > 1 else ""
    return InfeasibleDesignError(
        f"specification cannot be met: {specification.words} is asked for, and with ki near 0 the best is "
        f"{', '.join(found)}{together}; {remedy}"
    )


def _best(family: Family, grid: Floats, margin: str) -> float:
    """Least `Family.worst` over kp with next to no integral action; inf if nothing is stable."""
    from scipy.optimize import minimize_scalar

    def at(kp: Floats) -> Floats:
        return family.worst(kp, 1e-7 * np.maximum(np.abs(kp), 1e-9), margin)

    coarse = at(grid)
    if not np.isfinite(coarse).any():
        return math.inf
    top = int(np.argmin(coarse))
    ends = float(grid[max(top - 1, 0)]), float(grid[min(top + 1, grid.size - 1)])
    found = minimize_scalar(
        lambda kp: float(at(np.array([kp]))[0]), bounds=ends, method="bounded", options={"xatol": 1e-7 * abs(ends[1])}
    )
    return float(min(found.fun, coarse[top]))


# -- minimise Ms ------------------------------------------------------------------------------------------------


def least_ms(family: Family, specification: Specification, ki_min: float) -> tuple[float, float]:
    from scipy.optimize import minimize_scalar

    def objectives(kp: Floats, ki: Floats) -> Floats:
        worst = family.worst(kp, ki, "ms")
        return worst if specification.only_ms else np.where(family.excesses(kp, ki, specification) > 0, np.inf, worst)

    def objective(kp: float, ki: float) -> float:
        return float(objectives(np.array([kp]), np.array([ki]))[0])

    grid = family.kp_values()
    coarse = objectives(grid, np.full(grid.size, ki_min))
    if not np.isfinite(coarse).any():
        raise _no_such_ki(family, specification, grid, ki_min)
    top = int(np.argmin(coarse))
    low, high = float(grid[max(top - 1, 0)]), float(grid[min(top + 1, grid.size - 1)])
    result = minimize_scalar(
        lambda kp: objective(kp, ki_min), bounds=(low, high), method="bounded", options={"xatol": 1e-10 * abs(high)}
    )
    kp = float(result.x) if result.fun <= coarse[top] else float(grid[top])
    kp, ki = _with_more_ki(objective, kp, ki_min)
    least = objective(kp, ki)
    if specification.ms_max is not None and least > specification.ms_max:
        raise InfeasibleDesignError(
            f"Ms <= {specification.ms_max:g} with ki >= {ki_min:g} is asked for, and the least worst Ms is {least:.5g}"
        )
    return kp, ki


def _no_such_ki(family: Family, specification: Specification, grid: Floats, ki_min: float) -> InfeasibleDesignError:
    """Nothing holds with that much integral action: say how much there may be, or what the other bounds cost."""
    largest = float(_largest_stable_ki(family, grid).max(initial=0.0))
    asked = specification.words
    if largest > ki_min and asked:
        return InfeasibleDesignError(
            f"with ki >= {ki_min:g} no PI meets it: {_infeasible(family, specification, grid)}"
        )
    return InfeasibleDesignError(
        f"no PI with ki >= {ki_min:g} holds all plants; the largest ki that does is about {largest:.4g}"
    )


def _with_more_ki(objective: Callable[[float, float], float], kp: float, ki_min: float) -> tuple[float, float]:
    """If Ms falls as ki grows (it seldom does), follow it."""
    least = objective(kp, ki_min)
    if not objective(kp, 1.01 * ki_min) < least:
        return kp, ki_min
    from scipy.optimize import minimize

    found = minimize(
        lambda x: objective(float(x[0]), ki_min * math.exp(abs(float(x[1])))), [kp, 0.05], method="Nelder-Mead"
    )
    if found.fun < least:
        return float(found.x[0]), ki_min * math.exp(abs(float(found.x[1])))
    return kp, ki_min
