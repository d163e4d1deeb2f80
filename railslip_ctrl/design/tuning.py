"""PI gains from a specification, for one plant or many.

Where Ms <= M is asked for, each frequency forbids an ellipse of gains: |1 + (kp + ki/(j omega)) P| >= 1/M reads
(kp + Re 1/P)^2 + (ki/omega - Im 1/P)^2 >= |1/P|^2/M^2 ([Astrom1998], MIGO). Between the ellipses stability does not
change, so an exact root count in each gap decides it. That finds the region; its best point is then refined on the
exact margins.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.errors import InfeasibleDesignError, InputError
from railslip_ctrl.loop import DeadTimeLoop, Margins, Rational
from railslip_ctrl.loop.crossings import Response, frequency_nodes

from .families import Worst, family_margins, worst_of
from .stabilizing import intersection, stabilizing_pi

Floats = NDArray[np.float64]

_KP_POINTS = 80  # over the stabilising range: a coarse look, refined afterwards
_PER_NODE = 6  # frequencies between neighbouring nodes of a loop, for the ellipses
_SCAN_POINTS, _SCAN_RATIO = 24, 1.5  # integral gains looked at below a bound: down to 1e-4 of it
_LOG_SCAN_RATIO = math.log(_SCAN_RATIO) + 1e-6
_UNBOUNDED = 1e4  # a stabilising range without upper end is searched up to this factor above its scale


@dataclass(frozen=True)
class Specification:
    """What a design must keep at every plant; None is not asked for.

    ms_max: largest Ms (> 1). phase_min_deg: least phase margin, deg. delay_min_s: least delay margin, s.
    crossover: (lowest, highest) gain crossover, rad/s, that of the phase margin.
    """

    ms_max: float | None = None
    phase_min_deg: float | None = None
    delay_min_s: float | None = None
    crossover: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.ms_max is not None and not (math.isfinite(self.ms_max) and self.ms_max > 1):
            raise InputError(f"ms_max: {self.ms_max} is not allowed; give a finite value > 1")
        for name, value in (("phase_min_deg", self.phase_min_deg), ("delay_min_s", self.delay_min_s)):
            if value is not None and not (math.isfinite(value) and value >= 0):
                raise InputError(f"{name}: {value} is not allowed; give a finite value >= 0")
        if self.crossover is not None and not 0 <= self.crossover[0] < self.crossover[1]:
            raise InputError(f"crossover: {self.crossover} is not allowed; give (lowest, highest) in rad/s")

    @property
    def only_ms(self) -> bool:
        """Whether nothing but Ms is asked for."""
        return self.phase_min_deg is None and self.delay_min_s is None and self.crossover is None


@dataclass(frozen=True)
class PIDesign:
    """Tuned gains, the margins of every plant with them, and the worst.

    kp in units of plant input per output, ki in that per second.
    """

    kp: float
    ki: float
    worst: Worst
    margins: tuple[Margins, ...]
    specification: Specification


def tune_pi(
    plants: Any,
    dead_time: float | Sequence[float] = 0.0,
    *,
    ms_max: float | None = None,
    phase_min_deg: float | None = None,
    delay_min_s: float | None = None,
    crossover: tuple[float, float] | None = None,
    minimise_ms: bool = False,
    ki_min: float | None = None,
    compensator: Rational | None = None,
) -> PIDesign:
    """One PI, kp + ki/s, for all the plants.

    Parameters
    ----------
    plants : python-control system, `Rational`, or a sequence of them
        From controller output to controlled variable, without the dead time; negative feedback.
    dead_time : float or sequence
        s; one for all plants, or one each.
    ms_max, phase_min_deg, delay_min_s, crossover
        What every loop must keep, see `Specification`; ki is maximised under it.
    minimise_ms : bool
        Instead minimise the worst Ms at ki >= `ki_min` (which must be given: without it the integral action
        vanishes), under whatever else is asked for.
    compensator : Rational
        A further transfer function in series with the PI, such as a lead.

    Returns
    -------
    PIDesign

    Raises
    ------
    InfeasibleDesignError
        No PI meets the specification; the message gives the best that can be achieved.
    InputError
        No plants, or a specification that contradicts itself.
    """
    specification = Specification(ms_max, phase_min_deg, delay_min_s, crossover)
    family = _Family(_systems(plants, compensator), _dead_times(plants, dead_time))
    if minimise_ms:
        if ki_min is None or not (math.isfinite(ki_min) and ki_min > 0):
            raise InputError(f"ki_min: {ki_min} is not allowed with minimise_ms; give a least ki > 0")
        kp, ki = _least_ms(family, specification, ki_min)
    else:
        if ms_max is None and phase_min_deg is None and delay_min_s is None:
            raise InputError("specification: nothing bounds ki; give ms_max, phase_min_deg or delay_min_s")
        if ki_min is not None:
            raise InputError("ki_min: goes with minimise_ms; ki is maximised otherwise")
        kp, ki = _largest_ki(family, specification)
    loops = family.loops(kp, ki)
    worst = worst_of(family_margins(loops))
    assert worst is not None  # only stable gains are returned
    return PIDesign(kp, ki, worst, tuple(loop.margins() for loop in loops), specification)


def pi_for_crossover(plant: Any, dead_time: float, crossover: float, phase_margin_deg: float) -> tuple[float, float]:
    """(kp, ki) with |L(j crossover)| = 1 and arg L = -180 deg + phase margin there, exactly.

    Raises
    ------
    InfeasibleDesignError
        That PI does not stabilise the plant, needs ki < 0, or has a smaller phase margin at another crossover.
    """
    if not (math.isfinite(crossover) and crossover > 0):
        raise InputError(f"crossover: {crossover} rad/s is not allowed; give a finite frequency > 0")
    if not 0 < phase_margin_deg < 180:
        raise InputError(f"phase margin: {phase_margin_deg} deg is not allowed; give a value between 0 and 180")
    system = Rational.from_control(plant)
    at = DeadTimeLoop(system, dead_time).frequency_response(crossover)
    wanted = -np.exp(1j * math.radians(phase_margin_deg)) / at
    kp, ki = float(wanted.real), float(-wanted.imag * crossover)
    asked = f"crossover {crossover:g} rad/s with phase margin {phase_margin_deg:g} deg"
    if ki < 0:
        raise InfeasibleDesignError(
            f"{asked} needs ki = {ki:.4g} < 0: the plant's own phase there leaves {phase_margin_deg:g} deg only to a "
            "lead; ask for a smaller phase margin's complement, a lower crossover, or add a lead"
        )
    loop = DeadTimeLoop(pi_transfer_function(kp, ki) * system, dead_time)
    if not loop.is_stable():
        raise InfeasibleDesignError(
            f"{asked} gives kp = {kp:.4g}, ki = {ki:.4g}, which does not stabilise the plant "
            f"({loop.unstable_closed_loop_poles:g} unstable poles); choose another crossover"
        )
    smallest = loop.margins().phase_deg
    if smallest < phase_margin_deg * (1 - 1e-9):
        raise InfeasibleDesignError(
            f"{asked} is met, but another gain crossover leaves only {smallest:.4g} deg; choose another crossover"
        )
    return kp, ki


def pi_transfer_function(kp: float, ki: float) -> Rational:
    """kp + ki/s in factored form; ki = 0 has no integrator."""
    if ki == 0:
        return Rational(np.array([]), np.array([]), kp)
    if kp == 0:
        return Rational(np.array([]), np.array([0.0]), ki)
    return Rational(np.array([-ki / kp]), np.array([0.0]), kp)


# -- the family -------------------------------------------------------------------------------------------------


def _systems(plants: Any, compensator: Rational | None) -> list[Rational]:
    members = list(plants) if isinstance(plants, (list, tuple)) else [plants]
    if not members:
        raise InputError("plants: none is given; give at least one")
    extra = compensator or Rational(np.array([]), np.array([]), 1.0)
    return [extra * Rational.from_control(plant) for plant in members]


def _dead_times(plants: Any, dead_time: float | Sequence[float]) -> list[float]:
    count = len(plants) if isinstance(plants, (list, tuple)) else 1
    given = [float(d) for d in np.atleast_1d(np.asarray(dead_time, dtype=float))]
    if len(given) not in (1, count):
        raise InputError(f"dead_time: {len(given)} values for {count} plants; give one, or one each")
    return given * count if len(given) == 1 else given


@dataclass(frozen=True)
class _Family:
    systems: list[Rational]
    dead_times: list[float]

    def loops(self, kp: float, ki: float) -> list[DeadTimeLoop]:
        controller = pi_transfer_function(kp, ki)
        return [DeadTimeLoop(controller * g, tau) for g, tau in zip(self.systems, self.dead_times, strict=True)]

    def stable(self, kp: float, ki: float) -> bool:
        return all(loop.is_stable() for loop in self.loops(kp, ki))

    def excess(self, kp: float, ki: float, specification: Specification) -> float:
        """How far the worst loop misses the specification, relatively; <= 0 meets it, inf is unstable."""
        return float(self.excesses(np.array([kp]), np.array([ki]), specification)[0])

    def excesses(self, kp: Floats, ki: Floats, specification: Specification) -> Floats:
        """As `excess`, for many gains at once; arrays of one shape (n,)."""
        margins = family_margins([loop for a, b in zip(kp, ki, strict=True) for loop in self.loops(a, b)])
        shape = (kp.size, len(self.systems))
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
        regions = [stabilizing_pi(g, dead_time=tau) for g, tau in zip(self.systems, self.dead_times, strict=True)]
        common = intersection(regions) if len(regions) > 1 else regions[0]
        if common.kp_range is None:
            raise InfeasibleDesignError(f"no PI stabilises the plant(s): {common.reason}")
        return np.concatenate([_spread(low, high) for low, high in common.kp_intervals])


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
    return np.asarray(low + (high - low) * share)


# -- maximise ki ------------------------------------------------------------------------------------------------


def _largest_ki(family: _Family, specification: Specification) -> tuple[float, float]:
    grid = family.kp_values()
    ellipses = _Ellipses(family, specification.ms_max) if specification.ms_max is not None else None

    def upper(kp: float) -> float:
        return ellipses.largest_ki(kp) if ellipses is not None else _largest_stable_ki(family, kp)

    coarse = np.array([upper(kp) for kp in grid])
    if not specification.only_ms:
        coarse = _scanned(family, specification, grid, coarse)

    def best_ki(kp: float) -> float:
        start = upper(kp)
        if not specification.only_ms and start > 0:
            start = float(_scanned(family, specification, np.array([kp]), np.array([start]))[0]) * _SCAN_RATIO
        return _refined_ki(family, specification, kp, start)

    if not np.any(coarse > 0):
        raise _infeasible(family, specification, grid)
    kp = _maximise_near(best_ki, grid, coarse)
    ki = best_ki(kp)
    if ki <= 0:
        raise _infeasible(family, specification, grid)
    return kp, ki


def _scanned(family: _Family, specification: Specification, kp: Floats, upper: Floats) -> Floats:
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


def _largest_stable_ki(family: _Family, kp: float) -> float:
    limits = [
        stabilizing_pi(g, dead_time=tau).ki_limit(kp) for g, tau in zip(family.systems, family.dead_times, strict=True)
    ]
    return min(limits)


def _refined_ki(family: _Family, specification: Specification, kp: float, start: float) -> float:
    """The largest ki near or below `start` that meets the specification exactly; 0 if there is none."""
    if not start > 0:
        return 0.0
    if math.isinf(start):
        start = abs(kp) * _UNBOUNDED or _UNBOUNDED

    def miss(log_ki: float) -> float:
        return min(family.excess(kp, math.exp(log_ki), specification), 1e3)

    # the ellipses are sampled, the scan is coarse: the exact limit may lie a little to either side
    upper, lower = math.log(start) + 1e-3, None
    for step in (2e-3, 0.02, 0.15, _LOG_SCAN_RATIO, 1.5, 3.0, 6.0, 10.0):
        if miss(upper) <= 0:
            return math.exp(upper)
        candidate = math.log(start) - step
        if miss(candidate) <= 0:
            lower = candidate
            break
        upper = candidate
    if lower is None:
        return 0.0
    from scipy.optimize import brentq

    root = float(brentq(miss, lower, upper, xtol=1e-13, rtol=1e-15))
    # land on the side that meets it, by a step of rounding
    for margin in (0.0, 1e-14, 1e-13, 1e-12, 1e-11):
        if miss(root - margin) <= 0:
            return math.exp(root - margin)
    return math.exp(lower)


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

    def __init__(self, family: _Family, ms_max: float) -> None:
        self._family = family
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

    def largest_ki(self, kp: float) -> float:
        """The upper end of the highest gap between forbidden ki that is stable; 0.0 if there is none."""
        with np.errstate(invalid="ignore"):
            half = np.sqrt(self._radius**2 - (kp + self._x) ** 2)
        hit = half > 0
        low = self._omega[hit] * (self._y[hit] - half[hit])
        high = self._omega[hit] * (self._y[hit] + half[hit])
        order = np.argsort(low)
        low, high = low[order], np.maximum.accumulate(high[order])
        starts = np.concatenate([[0.0], high])
        ends = np.concatenate([low, [np.inf]])
        gaps = np.flatnonzero((ends > np.maximum(starts, 0.0) * (1 + 1e-9)) & (ends > 0))
        for i in gaps[::-1]:
            start, end = max(float(starts[i]), 0.0), float(ends[i])
            inside = 0.5 * (start + end) if math.isfinite(end) else 2 * start + abs(kp)
            if self._family.stable(kp, inside):
                return end
        return 0.0


def _infeasible(family: _Family, specification: Specification, grid: Floats) -> InfeasibleDesignError:
    """The best that can be achieved, with next to no integral action."""
    ms = np.array([_worst_ms(family, float(kp), 1e-6 * abs(float(kp))) for kp in grid[:: max(1, grid.size // 40)]])
    best = float(np.nanmin(np.where(np.isfinite(ms), ms, np.nan))) if np.isfinite(ms).any() else math.inf
    return InfeasibleDesignError(
        f"specification cannot be met: {_asked(specification)} is asked for, and with ki near 0 the least worst Ms is "
        f"about {best:.4g}; relax the specification or add a lead"
    )


def _asked(specification: Specification) -> str:
    parts = []
    if specification.ms_max is not None:
        parts.append(f"Ms <= {specification.ms_max:g}")
    if specification.phase_min_deg is not None:
        parts.append(f"phase margin >= {specification.phase_min_deg:g} deg")
    if specification.delay_min_s is not None:
        parts.append(f"delay margin >= {specification.delay_min_s:g} s")
    if specification.crossover is not None:
        parts.append(f"crossover in {specification.crossover[0]:g} to {specification.crossover[1]:g} rad/s")
    return ", ".join(parts)


# -- minimise Ms ------------------------------------------------------------------------------------------------


def _worst_ms(family: _Family, kp: float, ki: float) -> float:
    worst = worst_of(family_margins(family.loops(kp, ki)))
    return math.inf if worst is None else worst.ms


def _least_ms(family: _Family, specification: Specification, ki_min: float) -> tuple[float, float]:
    from scipy.optimize import minimize_scalar

    def objective(kp: float, ki: float) -> float:
        if not specification.only_ms and family.excess(kp, ki, specification) > 0:
            return math.inf
        return _worst_ms(family, kp, ki)

    grid = family.kp_values()
    coarse = np.array([objective(float(kp), ki_min) for kp in grid])
    if not np.isfinite(coarse).any():
        raise InfeasibleDesignError(
            f"no PI with ki >= {ki_min:g} holds all plants"
            + (f" with {_asked(specification)}" if _asked(specification) else "")
            + f"; kp from {grid.min():.4g} to {grid.max():.4g} stabilises them with less ki"
        )
    top = int(np.argmin(coarse))
    low, high = float(grid[max(top - 1, 0)]), float(grid[min(top + 1, grid.size - 1)])
    result = minimize_scalar(
        lambda kp: objective(kp, ki_min), bounds=(low, high), method="bounded", options={"xatol": 1e-10 * abs(high)}
    )
    kp = float(result.x) if result.fun <= coarse[top] else float(grid[top])
    return _with_more_ki(objective, kp, ki_min)


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
