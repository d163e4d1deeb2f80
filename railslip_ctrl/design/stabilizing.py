"""Exact set of (kp, ki) for which a PI, or a PID with fixed derivative part, stabilises a plant with dead time.

The D-decomposition (`decomposition`) divides the (kp, ki) plane into cells. The exact root count decides which cells
are stable ([Gryazina2008]; [Silva2005] has first-order plants in closed form). On request, ball arithmetic proves that
gains stabilise.
"""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np
from flint import arb, ctx
from numpy.typing import ArrayLike

from railslip_ctrl.core.arguments import Complexes, Floats, checked, number, numbers
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.loop import DeadTimeLoop, Rational
from railslip_ctrl.loop.crossings import SIZE, ExactLoop, Response
from railslip_ctrl.loop.stability import RootCount, count_right_of, root_count

from .decomposition import (
    CriticalGains,
    Decomposition,
    Interval,
    Intervals,
    common_intervals,
    probe,
    probes_between,
    stable_intervals,
)
from .specification import family_margins

_BITS = 80  # precision of ball arithmetic, bits
_OUTWARD = 16.0  # factor by which the ends of the frequency band move outward until a bound holds beyond them
_MOST_PARTS = 5_000  # largest number of intervals into which the frequency band is divided


def _ascending(name: str, ends: Interval, gt: float | None = None) -> None:
    if np.shape(ends) != (2,):
        raise InputError(f"{name}: {ends!r} is not allowed; give two finite ends, the lower first")
    low, high = numbers(name, ends, gt=gt).tolist()
    if high < low:
        raise InputError(f"{name}: from {low:g} to {high:g} is not allowed; give ascending ends")


def _without_poles_on_axis(plant: Rational, dead_time: float, kp: Interval, ki: Interval) -> bool:
    """Return True if it is proved that no gains in a closed rectangle put a closed-loop pole on the imaginary axis."""
    # a pole at j omega needs ki + j omega kp = R(omega) with R = -j omega/P(j omega)
    integrated = Response(plant * Rational(np.array([]), np.array([0.0]), 1.0), dead_time)
    with ctx.workprec(_BITS):
        band = _band(Response(plant, dead_time), integrated, kp, ki)
        return band is not None and _keeps_out(integrated, *band, kp, ki)


def _band(plant: Response, integrated: Response, kp: Interval, ki: Interval) -> Interval | None:
    low, high = _ends(integrated)[0], _ends(plant)[1]
    most = max(abs(kp[0]), abs(kp[1]))
    # outside the band |R| < ki or |P| (|kp| + ki/omega) < 1; both left sides are monotone there
    for _ in range(60):
        below = 1 / abs(integrated.exact.value(arb(low))[0]) < ki[0]
        size = abs(plant.exact.value(arb(high))[0])
        beyond = size.max(arb(abs(plant.system.feedthrough))) * (most + arb(ki[1]) / high) < 1
        if below and beyond:
            return low, high
        low, high = (low if below else low / _OUTWARD), (high if beyond else high * _OUTWARD)
    return None


def _ends(response: Response) -> Interval:
    roots = np.concatenate([response.system.zeros, response.system.poles])
    omega = [float(w.mid()) for w, _ in ExactLoop(response.system, response.dead_time).frequencies(SIZE)]
    omega += np.abs(roots[roots != 0]).tolist()
    return (min(omega) / 2, max(omega) * 2) if omega else (1.0, 1.0)


def _keeps_out(integrated: Response, low: float, high: float, kp: Interval, ki: Interval) -> bool:
    left, parts = [(low, high)], 0
    while left:
        a, b = left.pop()
        parts += 1
        middle = math.sqrt(a * b)
        if parts > _MOST_PARTS or not a < middle < b:
            return False
        if not _outside(integrated, a, middle, b, kp, ki):
            left += [(a, middle), (middle, b)]
    return True


def _outside(integrated: Response, low: float, middle: float, high: float, kp: Interval, ki: Interval) -> bool:
    value, slope = integrated.exact.value(arb(middle))
    half = arb(max(high - middle, middle - low)) * (1 + arb(2) ** -50)
    r = -1 / value
    # bound of |d^2 ln L/d omega^2|, a sum of positive terms in doubles
    bend = arb(float(integrated.bend(np.array([low]), np.array([high]))[0]) * (1 + 1e-12))
    # a disc around r with this radius contains R between the two frequencies
    radius = abs(r) * (half * abs(slope) + half * half / 2 * bend).expm1()
    if not radius.is_finite():
        return False
    beside = r.real + radius < ki[0] or r.real - radius > ki[1]
    below = r.imag + radius < min(kp[0] * low, kp[0] * high)
    return bool(beside or below or r.imag - radius > max(kp[1] * low, kp[1] * high))


class Region(ABC):
    """Set of all (kp, ki), ki >= 0, that stabilise one plant, or each of several plants, with negative feedback.

    kp is in units of the plant's input over its output, ki in the unit of kp per second. The ends of all intervals are
    exact to rounding.
    """

    @property
    @abstractmethod
    def kp_intervals(self) -> Intervals:
        """Open intervals of kp that stabilise with arbitrarily small ki > 0, ascending; ends may be infinite."""

    @abstractmethod
    def ki_intervals(self, kp: float) -> Intervals:
        """Return the open intervals of ki > 0 that stabilise at this kp, ascending; the last may end at inf."""

    @abstractmethod
    def contains(self, kp: float, ki: float) -> bool:
        """Return True if (kp, ki) stabilises; ki = 0 is P control. InputError for a gain that is not finite."""

    def certified_contains(self, kp: float, ki: float) -> bool:
        """Return True if ball arithmetic proves that (kp, ki) stabilises."""
        responses = [Response(loop.system, loop.dead_time) for loop in self.loops(kp, ki)]
        return ki >= 0 and all(root_count(response, certain=True).stable for response in responses)

    @abstractmethod
    def certified_rectangle(self, kp: Interval, ki: Interval) -> bool:
        """Return True if ball arithmetic proves that all gains of a closed rectangle stabilise.

        `kp` and `ki` are the lowest and highest gains of the rectangle; ki > 0. InputError for ends that are not finite
        or not ascending, and for a PID with a derivative part.
        """

    @abstractmethod
    def loops(self, kp: float, ki: float) -> tuple[DeadTimeLoop, ...]:
        """Return the loop of each plant with gains kp and ki, stable or not; InputError unless both are finite."""

    @property
    @abstractmethod
    def reason(self) -> str:
        """Reason why `kp_range` is None; empty otherwise."""

    @property
    def kp_range(self) -> Interval | None:
        """Lowest and highest end of `kp_intervals`; None if there are no intervals."""
        intervals = self.kp_intervals
        return (intervals[0][0], intervals[-1][1]) if intervals else None

    def ki_limit(self, kp: float) -> float:
        """Return the upper end of the last of `ki_intervals` at this kp; 0.0 if there is none."""
        intervals = self.ki_intervals(kp)
        return intervals[-1][1] if intervals else 0.0

    def plot(
        self,
        chosen: Mapping[str, tuple[float, float]] | None = None,
        *,
        kp_limit: float = math.inf,
        ki_limit: float = math.inf,
    ) -> Any:
        """Plot the region with contours of its worst margins as a matplotlib figure.

        - chosen: labels of gains to mark, each with its (kp, ki) in the region's units.
        - kp_limit, ki_limit: largest gains to draw, > 0, in the region's units.

        InputError for an empty region, and for an unbounded region without a limit.
        """
        strips, grid = region_map(self, kp_limit, ki_limit)
        plots = import_module("railslip_ctrl.report.plots")  # a package that imports this one
        title = "Gains that stabilise"
        return plots.region_figure(strips, grid, chosen or {}, title=title, kp_unit="u/y", ki_unit="u/(y·s)")


@dataclass(frozen=True)
class StabilizingRegion(Region):
    """Set of the gains that stabilise one plant; `stabilizing_pi` and `stabilizing_pid` return it.

    `decomposition` divides the (kp, ki) plane of this plant into cells; the set consists of the stable cells.
    """

    decomposition: Decomposition

    @property
    def plant(self) -> Rational:
        """Plant P in factored form, without the dead time."""
        return self.decomposition.plant

    @property
    def dead_time(self) -> float:
        """Dead time of the plant, s."""
        return self.decomposition.dead_time

    def loops(self, kp: float, ki: float) -> tuple[DeadTimeLoop, ...]:
        controller = self.decomposition.controller(number("kp", kp), number("ki", ki))
        return (DeadTimeLoop(controller * self.plant, self.dead_time),)

    def contains(self, kp: float, ki: float) -> bool:
        kp, ki = number("kp", kp), number("ki", ki)
        return ki >= 0 and self._count(kp, ki).stable

    def certified_rectangle(self, kp: Interval, ki: Interval) -> bool:
        if self.decomposition.derivative_filter:
            raise InputError(
                "certified rectangle: a PID with a derivative part is not supported; use certified_contains"
            )
        _ascending("kp", kp)
        _ascending("ki", ki, gt=0.0)
        return self.certified_contains(kp[0], ki[0]) and _without_poles_on_axis(self.plant, self.dead_time, kp, ki)

    @property
    def kp_intervals(self) -> Intervals:
        scale = self._reference_gain
        return tuple((low, high) for low, high in self.p_intervals if self._integral_allowed(probe(low, high, scale)))

    @cached_property
    def p_intervals(self) -> Intervals:
        """Open intervals of kp that stabilise with ki = 0, ascending."""
        return stable_intervals(self._critical, self._reference_gain, lambda kp: self._count(kp, 0.0), signed=True)

    @cached_property
    def is_empty(self) -> bool:
        """True if no gains stabilise, neither with ki = 0 nor with any ki > 0."""
        return not self.p_intervals and self._island is None

    def ki_intervals(self, kp: float) -> Intervals:
        kp = number("kp", kp)
        if abs(kp) >= self.decomposition.largest_kp:
            return ()
        critical = self.decomposition.integral_gains(kp)
        scale = (abs(kp) + self._reference_gain) * self._reference_frequency
        return stable_intervals(critical, scale, lambda ki: self._count(kp, ki), signed=False)

    @cached_property
    def reason(self) -> str:
        if self.kp_range is not None:
            return ""
        if self._hidden.size:
            return (
                f"no gains stabilise: the plant's pole at {self._hidden[0]:.6g} 1/s is cancelled by a zero, so that no "
                "controller affects it; remove pole and zero from the plant if they are artefacts of the model"
            )
        if self.p_intervals or self._sign_at_origin == 0 or (self._sign_at_origin < 0 and not self.plant.feedthrough):
            return self._reason_of_sign()
        unstable = np.sort(self.plant.poles[self.plant.poles.real >= 0].real)[::-1]
        which = ", ".join(f"{p:.6g}" for p in unstable)
        one = self._fewest_unstable == 1
        poles = f"{self._fewest_unstable:g} closed-loop {'pole stays' if one else 'poles stay'} unstable"
        reason = f"no kp stabilises with small ki: at least {poles}"
        if unstable.size:
            reason += f" (real part of the plant's unstable poles: {which} 1/s"
            reason += f"; unstable pole times dead time is {unstable[0] * self.dead_time:.6g})"
        if self._island:
            kp, (low, high) = self._island
            return (
                f"{reason}; larger ki does stabilise, for example at kp = {kp:.6g} with ki from {low:.6g} to {high:.6g}"
            )
        return f"{reason}; no PI can: add a lead, or reduce the dead time or the lags"

    def _count(self, kp: float, ki: float) -> RootCount:
        return count_right_of(self.decomposition.controller(kp, ki) * self.plant, self.dead_time)

    @cached_property
    def _critical(self) -> CriticalGains:
        return self.decomposition.proportional_gains()

    @cached_property
    def _reference_frequency(self) -> float:
        sizes = np.abs(np.concatenate([self.plant.poles, self.plant.zeros]))
        sizes = sizes[sizes > 0]
        return float(np.exp(np.log(sizes).mean())) if sizes.size else 1.0

    @cached_property
    def _reference_gain(self) -> float:
        inverse = np.abs(self.decomposition.inverse(self._reference_frequency * np.array([0.83, 1.0, 1.21])))
        usable = inverse[np.isfinite(inverse) & (inverse > 0)]
        return float(usable.min()) if usable.size else 1.0

    @cached_property
    def _hidden(self) -> Complexes:
        common = np.intersect1d(self.plant.zeros, self.plant.poles)
        return np.asarray(common[common.real >= 0], dtype=np.complex128)

    @cached_property
    def _sign_at_origin(self) -> float:
        zeros = self.plant.zeros
        return float(np.sign(self.plant.gain) * np.prod(np.sign(-zeros[zeros.imag == 0].real)))

    def _integral_allowed(self, kp: float) -> bool:
        # with opposite signs at s = 0 and at infinity the characteristic function has a positive real root
        far = 1.0 + self.decomposition.gain_at_infinity(kp)
        return bool(self._sign_at_origin * far > 0)

    def _reason_of_sign(self) -> str:
        if self.plant.gain == 0:
            return "no ki > 0 stabilises: the plant is 0; give a plant with a gain"
        if self._sign_at_origin == 0:
            reason = "no ki > 0 stabilises: the plant's zero at s = 0 cancels the integrator"
            remedy = "use P control"
        else:
            reason = "no ki > 0 stabilises: the sign of the plant's numerator at s = 0 leaves a real pole unstable"
            remedy = "change the sign of the plant"
        ranges = ", ".join(f"{low:.6g} < kp < {high:.6g}" for low, high in self.p_intervals)
        return f"{reason}; {remedy}" + (f" (ki = 0 stabilises for {ranges})" if ranges else "")

    @property
    def _fewest_unstable(self) -> float:
        probes = probes_between(self._edges_of_kp(), self._reference_gain)
        return min((self._count(kp, 0.0).right for kp in probes), default=float("nan"))

    def _edges_of_kp(self) -> list[float]:
        limit = self._critical.complete_to
        return [-limit, *self._critical.values.tolist(), limit]

    @cached_property
    def _island(self) -> tuple[float, Interval] | None:
        """Find a kp for which some ki stabilises although small ki does not; None if there is none."""
        turns = self.decomposition.turning_points
        edges = np.unique([e for e in [*self._edges_of_kp(), *self.decomposition.curve(turns)[0]] if math.isfinite(e)])
        for kp in probes_between([-math.inf, *edges.tolist(), math.inf], self._reference_gain):
            intervals = self.ki_intervals(kp)
            if intervals:
                return kp, intervals[0]
        return None


@dataclass(frozen=True)
class IntersectionRegion(Region):
    """Gains that are in each of `regions`; `intersection` returns it. `names` are the plants' names in `reason`."""

    regions: tuple[Region, ...]
    names: tuple[str, ...] = ()

    def loops(self, kp: float, ki: float) -> tuple[DeadTimeLoop, ...]:
        return tuple(loop for region in self.regions for loop in region.loops(kp, ki))

    def contains(self, kp: float, ki: float) -> bool:
        return all(region.contains(kp, ki) for region in self.regions)

    def certified_rectangle(self, kp: Interval, ki: Interval) -> bool:
        return all(region.certified_rectangle(kp, ki) for region in self.regions)

    @cached_property
    def kp_intervals(self) -> Intervals:
        # at a kp in all sets, each plant is stable for all sufficiently small ki, and so are all plants together
        return common_intervals([region.kp_intervals for region in self.regions])

    def ki_intervals(self, kp: float) -> Intervals:
        return common_intervals([region.ki_intervals(kp) for region in self.regions])

    @property
    def reason(self) -> str:
        if self.kp_range is not None:
            return ""
        names = self.names or tuple(f"plant {i + 1}" for i in range(len(self.regions)))
        alone = [(name, r.reason) for name, r in zip(names, self.regions, strict=True) if r.reason]
        if alone:
            name, reason = alone[0]
            more = f" (and {len(alone) - 1} more of {len(names)} plants)" if len(alone) > 1 else ""
            return f"{name}{more}: {reason}"
        sets = [(name, r.kp_intervals) for name, r in zip(names, self.regions, strict=True)]
        # two disjoint sets are a sufficient reason
        apart = next(([a, b] for a, b in itertools.combinations(sets, 2) if not common_intervals([a[1], b[1]])), sets)
        ranges = "; ".join(
            f"{name}: " + ", ".join(f"{low:.6g} < kp < {high:.6g}" for low, high in own) for name, own in apart
        )
        return f"no kp stabilises all plants with small ki ({ranges}); schedule the gains"


@checked
def stabilizing_pi(plant: Any, dead_time: float = 0.0) -> StabilizingRegion:
    """Return all (kp, ki) with ki >= 0 for which kp + ki/s stabilises P(s) exp(-dead_time s) with negative feedback.

    A gain stabilises if 1 + (kp + ki/s) P(s) exp(-dead_time s) has no root with real part >= 0 ([Gryazina2008];
    [WaltonMarshall1987]). For the wheel, from brake torque to sigma, kp and ki are those of Tb = kp e + ki integral(e),
    e = sigma_d - sigma ([Park2008] (3), Table 4).

    - plant: P(s), the transfer function from controller output to controlled variable, with the actuator's lag and
      without the dead time: python-control TransferFunction or StateSpace, `Rational`, or a real number. Units are
      free, with time in s. The plant is SISO and may be unstable; with dead time it must be strictly proper.
    - dead_time: dead time, s, >= 0.

    Returns the set, with kp in units of the plant's input over its output and ki in the unit of kp per second. If the
    set is empty, `kp_range` is None, and `reason` states why. InputError: a plant or dead time that is not as above.
    """
    return _region(plant, dead_time)


@checked
def stabilizing_pid(
    plant: Any,
    dead_time: float = 0.0,
    *,
    derivative_filter: float,
    derivative_time: float | None = None,
    derivative_gain: float | None = None,
) -> StabilizingRegion:
    """Return all (kp, ki) with ki >= 0 for which a PID with fixed derivative part stabilises; see `stabilizing_pi`.

    The controller is C(s) = kp + ki/s + kd s/(Tf s + 1). Either `derivative_time` or `derivative_gain` sets kd.

    - plant, dead_time: as for `stabilizing_pi`.
    - derivative_filter: Tf, s, > 0.
    - derivative_time: Td, s, >= 0; kd is then Td kp for every kp.
    - derivative_gain: kd, of either sign, in units of kp times s.

    InputError: both or neither of `derivative_time` and `derivative_gain` is given, or a value is out of range.
    """
    if (derivative_time is None) == (derivative_gain is None):
        raise InputError("PID: derivative_time (s) and derivative_gain exclude each other; give exactly one")
    return _region(
        plant,
        dead_time,
        derivative_time=number("derivative time", derivative_time or 0.0, "s", ge=0),
        derivative_gain=number("derivative gain", derivative_gain or 0.0),
        derivative_filter=number("derivative filter", derivative_filter, "s", gt=0),
    )


@checked
def intersection(regions: Sequence[Region], names: Sequence[str] = ()) -> IntersectionRegion:
    """Return the gains that are in each of several regions, in the units of the regions.

    - regions: stabilising sets, in equal units.
    - names: names of the plants, one for each region, used in `reason`; by default the plants are numbered.

    InputError: no region is given, or the numbers of names and of regions differ.
    """
    if not regions:
        raise InputError("intersection: no region is given; give at least one")
    if names and len(names) != len(regions):
        raise InputError(f"names: {len(names)} for {len(regions)} regions; give one name for each region, or none")
    return IntersectionRegion(tuple(regions), tuple(names))


def _region(plant: Any, dead_time: float, **derivative: float) -> StabilizingRegion:
    loop = DeadTimeLoop(plant, dead_time)  # checks both
    if loop.dead_time > 0 and loop.system.feedthrough != 0:
        raise InputError(
            f"plant with dead time {loop.dead_time:g} s and P(inf) = {loop.system.feedthrough:g}: the loop is neutral, "
            "and infinitely many stability boundaries accumulate; make the plant strictly proper, for example by "
            "the actuator's lag"
        )
    return StabilizingRegion(Decomposition(loop.system, loop.dead_time, **derivative))


_GRID = 50, 40  # points of kp and ki; contours have no visible corners
_COLUMNS = 120  # columns of an outline
_BISECTIONS = 40  # bisections for the end of a strip, from the column spacing to rounding


@dataclass(frozen=True)
class Strip:
    """Part of a region: at each kp the gains with ki_low < ki < ki_high, in the region's units.

    - kp, ki_low, ki_high: arrays of shape (n,), kp ascending.
    - kp_cut, ki_cut: True if the region continues beyond the limit of kp or ki that was given to `outline`.
    """

    kp: Floats
    ki_low: Floats
    ki_high: Floats
    kp_cut: bool = False
    ki_cut: bool = False

    @property
    def polygon(self) -> Floats:
        """Corners of the strip in order, array of shape (2 n, 2) with columns kp and ki."""
        return np.column_stack(
            [np.concatenate([self.kp, self.kp[::-1]]), np.concatenate([self.ki_low, self.ki_high[::-1]])]
        )


@dataclass(frozen=True)
class MarginGrid:
    """Worst margins over all plants of a region, on a grid of gains; NaN outside the region.

    - kp, ki: values of the grid, arrays of shape (m,) and (n,), in the region's units.
    - ms: largest Ms, a ratio, shape (m, n).
    - phase_deg: smallest magnitude of the phase margin, deg, shape (m, n).
    - delay_s: smallest delay margin, s, shape (m, n).
    """

    kp: Floats
    ki: Floats
    ms: Floats
    phase_deg: Floats
    delay_s: Floats


@checked
def outline(region: Region, *, kp_limit: float = math.inf, ki_limit: float = math.inf) -> tuple[Strip, ...]:
    """Return a region as strips, from its exact intervals of ki at 120 values of kp.

    - region: stabilising gains of one or several plants.
    - kp_limit, ki_limit: largest gains, > 0, in the region's units; by default there is no limit. A strip that
      continues beyond a limit is cut and marked.

    A strip that lies between two neighbouring values of kp is not found; `Region.contains` is exact. `ki_high` is inf
    where ki is unbounded and there is no `ki_limit`. InputError: a limit is not > 0, or the region is
    unbounded in kp without `kp_limit`.
    """
    for name, limit in (("kp_limit", kp_limit), ("ki_limit", ki_limit)):
        if not limit > 0:
            raise InputError(f"{name}: {limit} is not allowed; give a gain > 0, or leave it out")
    columns = _columns(region, kp_limit)
    if columns.size == 0:
        return ()
    sets = {x: region.ki_intervals(x) for x in columns.tolist()}
    for left, right in itertools.pairwise(columns.tolist()):
        if len(sets[left]) != len(sets[right]):
            sets |= _at_change_of_number(region, left, right)
    strips = []
    for count, group in itertools.groupby(sorted(sets.items()), key=lambda column: len(column[1])):
        alike = list(group)
        strips += [_strip(alike, index, ki_limit) for index in range(count)]
    least, most = region.kp_range or (math.nan, math.nan)
    cut = [float(columns[0])] if least < -kp_limit else []
    cut += [float(columns[-1])] if most > kp_limit else []
    shown = (strip for strip in strips if (strip.ki_low < ki_limit).any())
    return tuple(replace(strip, kp_cut=strip.kp[0] in cut or strip.kp[-1] in cut) for strip in shown)


@checked
def margin_grid(region: Region, kp: ArrayLike, ki: ArrayLike) -> MarginGrid:
    """Return the exact margins at each pair of gains of a grid.

    - region: stabilising gains of one or several plants.
    - kp: values of the grid, 1-D, in units of the plant's input over its output.
    - ki: values of the grid, 1-D, in the unit of kp per second; ki = 0 is P control.

    InputError: a gain is not finite.
    """
    columns, rows = np.atleast_1d(numbers("kp", kp)), np.atleast_1d(numbers("ki", ki))
    members = [region.loops(x, y) for x in columns.tolist() for y in rows.tolist()]
    shape = (columns.size, rows.size, len(members[0]) if members else 1)
    margins = family_margins([loop for loops in members for loop in loops], gain_margins=False)
    inside = margins.stable.reshape(shape).all(axis=2) & (rows >= 0)

    def worst(values: Floats, reduce: Callable[..., Any]) -> Floats:
        return np.asarray(np.where(inside, reduce(values.reshape(shape), axis=2), np.nan))

    return MarginGrid(
        columns, rows, worst(margins.ms, np.max), worst(margins.phase_deg, np.min), worst(margins.delay_s, np.min)
    )


def region_map(
    region: Region, kp_limit: float = math.inf, ki_limit: float = math.inf
) -> tuple[tuple[Strip, ...], MarginGrid]:
    """Return the `outline` of a region, and the margins on a grid of gains that covers it.

    The arguments are those of `outline`. InputError for an empty region, and for an unbounded region without a limit.
    """
    strips = outline(region, kp_limit=kp_limit, ki_limit=ki_limit)
    if not strips:
        raise InputError(f"region: there is nothing to draw; {region.reason or 'give larger limits'}")
    top = max(float(strip.ki_high.max()) for strip in strips)
    if math.isinf(top):
        raise InputError("region: ki is unbounded; give ki_limit, the largest ki to draw")
    low, high = min(float(strip.kp[0]) for strip in strips), max(float(strip.kp[-1]) for strip in strips)
    return strips, margin_grid(region, np.linspace(low, high, _GRID[0]), np.linspace(0.0, top, _GRID[1]))


def _strip(columns: Sequence[tuple[float, Intervals]], index: int, ki_limit: float) -> Strip:
    low, high = np.array([sets[index] for _, sets in columns]).T
    kp, ki_cut = np.array([x for x, _ in columns]), bool((high > ki_limit).any())
    return Strip(kp, np.minimum(low, ki_limit), np.minimum(high, ki_limit), ki_cut=ki_cut)


def _columns(region: Region, kp_limit: float) -> Floats:
    if region.kp_range is None:
        return np.array([])
    low, high = max(region.kp_range[0], -kp_limit), min(region.kp_range[1], kp_limit)
    if math.isinf(high - low):
        raise InputError(
            f"outline: the region is unbounded, kp from {low:.6g} to {high:.6g}; give kp_limit, the largest |kp| to "
            "draw"
        )
    if low >= high:
        return np.array([])
    # denser at the ends of the range, where the boundary is steep
    return np.asarray(low + (high - low) * (0.5 - 0.5 * np.cos(np.pi * (np.arange(_COLUMNS) + 0.5) / _COLUMNS)))


def _at_change_of_number(region: Region, left: float, right: float) -> dict[float, Intervals]:
    columns = {x: region.ki_intervals(x) for x in (left, right)}
    for _ in range(_BISECTIONS):
        middle = 0.5 * (left + right)
        columns[middle] = region.ki_intervals(middle)
        if len(columns[middle]) == len(columns[left]):
            left = middle
        else:
            right = middle
    return {x: columns[x] for x in (left, right)}
