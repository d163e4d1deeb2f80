"""The search behind `tuning`: a family of plants, the gains that keep a specification, the best of them.

Where Ms <= M is asked for, each frequency forbids an ellipse of gains: |1 + (kp + ki/(j omega)) P| >= 1/M reads
(kp + Re 1/P)^2 + (ki/omega - Im 1/P)^2 >= |1/P|^2/M^2 ([Astrom1998], MIGO). The exact loop decides each gap between
the ellipses, and the best point is refined on the exact margins.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.errors import InfeasibleDesignError
from railslip_ctrl.loop import DeadTimeLoop, Rational
from railslip_ctrl.loop.batch import BatchMargins
from railslip_ctrl.loop.crossings import Response, frequency_nodes

from .families import family_margins
from .specification import Specification
from .stabilizing import StabilizingRegion, intersection, stabilizing_pi

Floats = NDArray[np.float64]

_KP_POINTS = 80  # over the stabilising range: a coarse look, refined afterwards
_PER_NODE = 6  # frequencies between neighbouring nodes of a loop, for the ellipses
_SCAN_POINTS, _SCAN_RATIO = 40, 1.25  # integral gains looked at below a bound: down to 1e-4 of it
_ZOOM_STARTS, _ZOOMS, _ZOOM_POINTS, _ZOOM_SHRINK = 4, 12, 9, 0.6
_LOG_SCAN_RATIO = math.log(_SCAN_RATIO) + 1e-6
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

    def margins(self, kp: Floats, ki: Floats) -> BatchMargins:
        """Of every loop, for gains of shape (n,): n times the number of plants, the plants of a gain together."""
        return family_margins([loop for a, b in zip(kp, ki, strict=True) for loop in self.loops(a, b)])

    def worst(self, kp: Floats, ki: Floats, margin: str) -> Floats:
        """The worst of a margin over the plants, negative if more of it is better; inf where a loop is unstable."""
        margins, shape = self.margins(kp, ki), (kp.size, len(self.systems))
        values = getattr(margins, margin).reshape(shape) * (1 if margin == "ms" else -1)
        return np.asarray(np.where(margins.stable.reshape(shape), values, np.inf).max(axis=1))

    def excess(self, kp: float, ki: float, specification: Specification) -> float:
        """How far the worst loop misses the specification, relatively; <= 0 meets it, inf is unstable."""
        return float(self.excesses(np.array([kp]), np.array([ki]), specification)[0])

    def excesses(self, kp: Floats, ki: Floats, specification: Specification) -> Floats:
        """As `excess`, for many gains at once; arrays of one shape (n,)."""
        margins, shape = self.margins(kp, ki), (kp.size, len(self.systems))
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
    ellipses = _Ellipses(family, specification.ms_max) if specification.ms_max is not None else None

    def upper(kp: Floats) -> Floats:
        return ellipses.largest_ki(kp) if ellipses is not None else _largest_stable_ki(family, kp)

    def refined(kp: float) -> float:
        return _refined_ki(family, specification, kp, float(upper(np.array([kp]))[0]))

    coarse = upper(grid)
    if not specification.only_ms:
        coarse = _scanned(family, specification, grid, coarse)
    if not np.any(coarse > 0):
        raise _infeasible(family, specification, grid)
    _refuse_unbounded(family, grid, coarse)
    if specification.only_ms:
        kp = _maximise_near(refined, grid, coarse)
        ki = refined(kp)
    else:
        kp, start = _zoomed(family, specification, grid, coarse)
        near = kp + abs(kp) * np.array([-0.1, 0.0, 0.1])  # the ridge of one smooth bound, finer than the zoom
        kp = _maximise_near(lambda x: _refined_ki(family, specification, x, start), near, np.array([0.0, start, 0.0]))
        ki = _refined_ki(family, specification, kp, start)
    if ki <= 0:
        raise _infeasible(family, specification, grid)
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
            met = family.excesses(*gains, specification) <= 0
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
    live = upper > 0
    found = np.zeros(kp.size)
    if not live.any():
        return found
    gains = np.repeat(kp[live], _SCAN_POINTS), ki[live].ravel()
    met = family.excesses(*gains, specification).reshape(-1, _SCAN_POINTS) <= 0
    first = np.argmax(met, axis=1)
    found[live] = np.where(met.any(axis=1), ki[live][np.arange(first.size), first], 0.0)
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


class _Ellipses:
    """The gains that Ms <= M forbids, sampled densely in frequency."""

    def __init__(self, family: Family, ms_max: float) -> None:
        self._family = family
        self._specification = Specification(ms_max=ms_max)
        omegas, inverses = [], []
        for g, tau in zip(family.systems, family.dead_times, strict=True):
            response = Response(g, tau)
            nodes = frequency_nodes(response)
            # beyond a hundred times the gain's own bandwidth |C P| is too small to matter
            omega = np.interp(np.arange((nodes.size - 1) * _PER_NODE + 1) / _PER_NODE, np.arange(nodes.size), nodes)
            omegas.append(omega)
            inverses.append(1 / response(omega))
        self._omega = np.concatenate(omegas)
        inverse = np.concatenate(inverses)
        self._x, self._y, self._radius = inverse.real, inverse.imag, np.abs(inverse) / ms_max

    def largest_ki(self, kp: Floats) -> Floats:
        """For each kp, (n,), the upper end of the highest gap between forbidden ki that is stable; 0 without one."""
        gaps = [self._gaps(float(one)) for one in kp]
        found, left, looked, more = np.zeros(kp.size), list(range(kp.size)), 0, 1
        while left := [i for i in left if looked < len(gaps[i])]:
            tried = [(i, end, inside) for i in left for end, inside in gaps[i][looked : looked + more]]
            index, ends, insides = (np.array(values) for values in zip(*tried, strict=True))
            # the sampled frequencies end somewhere: what lies beyond their reach only the exact loop tells
            met = self._family.excesses(kp[index], insides, self._specification) <= 0
            found[index[met][::-1]] = ends[met][::-1]  # the first of each, which is its highest, is put in last
            left = sorted(set(left) - set(index[met].tolist()))
            looked, more = looked + more, 2 * more  # few calls where the stable gap comes late
        return found

    def _gaps(self, kp: float) -> list[tuple[float, float]]:
        """Upper end of each gap between forbidden ki, and a ki inside it; the highest first."""
        with np.errstate(invalid="ignore"):
            half = np.sqrt(self._radius**2 - (kp + self._x) ** 2)
        hit = half > 0
        low = self._omega[hit] * (self._y[hit] - half[hit])
        high = self._omega[hit] * (self._y[hit] + half[hit])
        order = np.argsort(low)
        low, high = low[order], np.maximum.accumulate(high[order])
        starts = np.maximum(np.concatenate([[0.0], high]), 0.0)
        ends = np.concatenate([low, [np.inf]])
        gaps = np.flatnonzero((ends > starts * (1 + 1e-9)) & (ends > 0))[::-1]
        inside = np.where(np.isfinite(ends[gaps]), 0.5 * (starts[gaps] + ends[gaps]), 2 * starts[gaps] + abs(kp))
        return list(zip(ends[gaps].tolist(), inside.tolist(), strict=True))


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
