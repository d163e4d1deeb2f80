"""The exact set of (kp, ki) for which a PI, or a PID with its derivative part fixed, stabilises a dead-time plant.

The boundaries come from the D-decomposition (`decomposition`); which of the cells between them are stable is
decided by the exact root count inside each ([Gryazina2008]; [Silva2005] has first-order plants in closed form).
"""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from railslip_ctrl.core.arguments import checked, number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.loop import DeadTimeLoop, Rational
from railslip_ctrl.loop.stability import RootCount, count_right_of

from .certified import certain_rectangle, certainly_stable
from .decomposition import CriticalGains, Decomposition
from .intervals import Interval, Intervals, common_intervals, probe, probes_between, stable_intervals

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


@dataclass(frozen=True)
class BoundaryCurve:
    """Gains `kp`, `ki` with closed-loop poles on the imaginary axis at +-j `omega` (rad/s), arrays of one shape.

    omega = 0 throughout is the line ki = 0, a pole at the origin.
    """

    omega: Floats
    kp: Floats
    ki: Floats


class Region(ABC):
    """A set of (kp, ki), ki >= 0, that stabilises one plant, or each of several.

    Gains are in the units of the plant's input over its output (kp) and that per second (ki); a positive
    loop means negative feedback. Nothing is sampled: each end is refined to rounding.
    """

    @property
    @abstractmethod
    def kp_intervals(self) -> Intervals:
        """All open intervals of kp that stabilise with ki > 0 arbitrarily small, ascending; the same as those of P
        control unless the plant's sign or a zero at the origin forbids integral action. Ends may be infinite."""

    @abstractmethod
    def ki_intervals(self, kp: float) -> Intervals:
        """All open intervals of ki > 0 that stabilise at this kp, ascending; the first starts at 0.0 where ki may
        be arbitrarily small, the last may end at inf. Empty where no ki > 0 stabilises."""

    @abstractmethod
    def contains(self, kp: float, ki: float) -> bool:
        """Whether (kp, ki) stabilises, by the exact root count; ki = 0 is P control, without an integrator.

        False for ki < 0, and on the boundary itself; next to it the numbers as given decide.
        Raises InputError for a gain that is not finite.
        """

    def certified_contains(self, kp: float, ki: float) -> bool:
        """As `contains`, every step of the root count in ball arithmetic."""
        return number("ki", ki) >= 0 and all(certainly_stable(loop) for loop in self.loops(kp, ki))

    @abstractmethod
    def certified_rectangle(self, kp: Interval, ki: Interval) -> bool:
        """Whether all gains of a closed rectangle stabilise, shown by ball arithmetic; ki > 0.

        False where that is not so, or where the rectangle is so near to the boundary that it cannot be shown.
        InputError for ends that are not finite or not ascending.
        """

    @abstractmethod
    def loops(self, kp: float, ki: float) -> tuple[DeadTimeLoop, ...]:
        """The loop of each plant with these gains, stable or not. InputError for a gain that is not finite."""

    @property
    @abstractmethod
    def reason(self) -> str:
        """Why `kp_range` is None; empty where it is not."""

    @property
    def kp_range(self) -> Interval | None:
        """(lowest, highest) end of `kp_intervals`; None where they are empty, see `reason`.

        Of a set in several intervals it is the hull.
        """
        found = self.kp_intervals
        return (found[0][0], found[-1][1]) if found else None

    def ki_limit(self, kp: float) -> float:
        """Largest ki that stabilises at this kp (not itself stabilising): inf without bound, 0.0 where no ki > 0
        stabilises. Below it there may be gaps: see `ki_intervals`."""
        found = self.ki_intervals(kp)
        return found[-1][1] if found else 0.0

    def plot(
        self,
        chosen: Mapping[str, tuple[float, float]] | None = None,
        *,
        kp_limit: float = math.inf,
        ki_limit: float = math.inf,
    ) -> Any:
        """The region with contours of its worst margins, a matplotlib figure.

        Parameters
        ----------
        chosen : mapping, optional
            (kp, ki) to mark, in the region's units, by name.
        kp_limit, ki_limit : float
            Gains > 0, in those units, up to which to draw it.

        InputError for an empty region, with the reason, and for one that goes on without bound and has no limit.
        """
        strips, grid = import_module("railslip_ctrl.design.region_maps").region_map(self, kp_limit, ki_limit)
        plots = import_module("railslip_ctrl.report.plots")  # a room above this one, asked for by the user
        title = "Gains that stabilise"
        return plots.region_figure(strips, grid, chosen or {}, title=title, kp_unit="u/y", ki_unit="u/(y·s)")


@dataclass(frozen=True)
class StabilizingRegion(Region):
    """The stabilising set of one plant: the stable cells of its `decomposition` of the (kp, ki) plane.

    Made by `stabilizing_pi` and `stabilizing_pid`.
    """

    decomposition: Decomposition

    @property
    def plant(self) -> Rational:
        """P in factored form, without the dead time."""
        return self.decomposition.plant

    @property
    def dead_time(self) -> float:
        """Dead time, s."""
        return self.decomposition.dead_time

    def loops(self, kp: float, ki: float) -> tuple[DeadTimeLoop, ...]:
        controller = self.decomposition.controller(number("kp", kp), number("ki", ki))
        return (DeadTimeLoop(controller * self.plant, self.dead_time),)

    def contains(self, kp: float, ki: float) -> bool:
        kp, ki = number("kp", kp), number("ki", ki)
        return ki >= 0 and self._count(kp, ki).stable

    def certified_rectangle(self, kp: Interval, ki: Interval) -> bool:
        """As of `Region`. InputError also for a PID with a derivative part, which is not covered."""
        if self.decomposition.derivative_filter:
            raise InputError("certified rectangle: a PID with a derivative part is not covered; use certified_contains")
        return certain_rectangle(self.plant, self.dead_time, kp, ki)

    @property
    def kp_intervals(self) -> Intervals:
        return tuple(
            (low, high)
            for low, high in self.p_intervals
            if self._integral_allowed(probe(low, high, self._reference_gain))
        )

    @cached_property
    def p_intervals(self) -> Intervals:
        """All open intervals of kp that stabilise with ki = 0, whatever an integrator would do, ascending."""
        return stable_intervals(self._critical, self._reference_gain, lambda kp: self._count(kp, 0.0), signed=True)

    @cached_property
    def is_empty(self) -> bool:
        """True if nothing at all stabilises. An unstable plant may need ki away from 0, so that `kp_range` is None
        although the set is not empty; that is looked for between all kp at which the boundary turns back."""
        return not self.p_intervals and self._island is None

    def ki_intervals(self, kp: float) -> Intervals:
        kp = number("kp", kp)
        if abs(kp) >= self.decomposition.largest_kp:
            return ()
        critical = self.decomposition.integral_gains(kp)
        scale = (abs(kp) + self._reference_gain) * self._reference_frequency
        return stable_intervals(critical, scale, lambda ki: self._count(kp, ki), signed=False)

    def boundary_curves(self, omega_max: float | None = None, points_per_turn: int = 200) -> tuple[BoundaryCurve, ...]:
        """The line ki = 0 over the critical kp, then the curve (kp, ki)(omega), in one piece per interval between
        zeros of the plant on the axis; up to `omega_max`, rad/s (default: as far as `kp_intervals` need it), with
        `points_per_turn` for each turn of the dead time's phase.
        """
        kp = self._critical.values
        ends = np.array([kp.min(), kp.max()]) if kp.size else np.zeros(2)
        line = BoundaryCurve(np.zeros(2), ends, np.zeros(2))
        highest = self._highest_frequency if omega_max is None else omega_max
        count = int(points_per_turn * (2 + highest * self.dead_time / (2 * np.pi)))
        omega = np.union1d(np.geomspace(1e-6 * highest, highest, count), np.linspace(0, highest, count)[1:])
        on_axis = self.plant.zeros[self.plant.zeros.real == 0].imag
        omega = omega[~np.isin(omega, on_axis)]
        pieces = np.split(omega, np.searchsorted(omega, np.unique(on_axis)))
        return (line, *(BoundaryCurve(w, *self.decomposition.curve(w)) for w in pieces if w.size))

    @cached_property
    def reason(self) -> str:
        if self.kp_range is not None:
            return ""
        if self._hidden.size:
            return (
                f"nothing stabilises: the plant's pole at {self._hidden[0]:.6g} 1/s is cancelled by a zero, so that no "
                "controller reaches it; remove it from the plant if it is not there"
            )
        if self.p_intervals or self._sign_at_origin == 0 or (self._sign_at_origin < 0 and not self.plant.feedthrough):
            return self._reason_of_sign()
        unstable = np.sort(self.plant.poles[self.plant.poles.real >= 0].real)[::-1]
        which = ", ".join(f"{p:.6g}" for p in unstable)
        one = self._fewest_unstable == 1
        poles = f"{self._fewest_unstable:g} closed-loop {'pole stays' if one else 'poles stay'} unstable"
        told = f"no kp stabilises with small ki: at least {poles}"
        if unstable.size:
            told += f" (real part of the plant's unstable poles: {which} 1/s"
            told += f"; unstable pole times dead time is {unstable[0] * self.dead_time:.6g})"
        if self._island:
            kp, (low, high) = self._island
            return (
                f"{told}; larger ki does stabilise, for example at kp = {kp:.6g} with ki from {low:.6g} to {high:.6g}"
            )
        return f"{told}; no PI can: add a lead, or reduce the dead time or the lags"

    # -- internals ----------------------------------------------------------------------------------------

    def _count(self, kp: float, ki: float) -> RootCount:
        return count_right_of(self.decomposition.controller(kp, ki) * self.plant, self.dead_time)

    @cached_property
    def _critical(self) -> CriticalGains:
        return self.decomposition.proportional_gains()

    @cached_property
    def _reference_frequency(self) -> float:
        """Any frequency of the plant's, rad/s: a root count in an unbounded cell may be taken anywhere in it."""
        sizes = np.abs(np.concatenate([self.plant.poles, self.plant.zeros]))
        sizes = sizes[sizes > 0]
        return float(np.exp(np.log(sizes).mean())) if sizes.size else 1.0

    @cached_property
    def _reference_gain(self) -> float:
        """1/|P| at about that frequency."""
        inverse = np.abs(self.decomposition.inverse(self._reference_frequency * np.array([0.83, 1.0, 1.21])))
        usable = inverse[np.isfinite(inverse) & (inverse > 0)]
        return float(usable.min()) if usable.size else 1.0

    @property
    def _highest_frequency(self) -> float:
        """The highest frequency, rad/s, at which poles reach the axis at an end of `p_intervals`."""
        ends = np.array(self.p_intervals).ravel()
        omega = self._critical.omega[np.isin(self._critical.values, ends)]
        highest = float(np.max(omega[np.isfinite(omega)], initial=0.0))
        return highest or 10 * self._reference_frequency

    @cached_property
    def _hidden(self) -> NDArray[np.complex128]:
        """Poles not left of the axis that a zero cancels exactly."""
        found = np.intersect1d(self.plant.zeros, self.plant.poles)
        return np.asarray(found[found.real >= 0], dtype=np.complex128)

    @cached_property
    def _sign_at_origin(self) -> float:
        """Sign of the plant's numerator N at s = 0, the denominator D monic."""
        zeros = self.plant.zeros
        return float(np.sign(self.plant.gain) * np.prod(np.sign(-zeros[zeros.imag == 0].real)))

    def _integral_allowed(self, kp: float) -> bool:
        """Whether any ki > 0 can stabilise at this kp.

        On the real axis s D + (kp s + ki) N exp(-tau s) is ki N(0) at the origin and has the sign of
        1 + kp P(inf) far out: if the two differ there is a positive real zero (the same with a derivative).
        """
        far = 1.0 + self.decomposition.gain_at_infinity(kp)
        return bool(self._sign_at_origin * far > 0)

    def _reason_of_sign(self) -> str:
        if self.plant.gain == 0:
            return "no ki > 0 stabilises: the plant is 0; give a plant with a gain"
        if self._sign_at_origin == 0:
            told = "no ki > 0 stabilises: the plant's zero at s = 0 cancels the integrator"
            remedy = "use P control"
        else:
            told = "no ki > 0 stabilises: the sign of the plant's numerator at s = 0 leaves a real pole unstable"
            remedy = "change the sign of the plant"
        ranges = ", ".join(f"{low:.6g} < kp < {high:.6g}" for low, high in self.p_intervals)
        return f"{told}; {remedy}" + (f" (ki = 0 stabilises for {ranges})" if ranges else "")

    @property
    def _fewest_unstable(self) -> float:
        probes = probes_between(self._edges_of_kp(), self._reference_gain)
        return min((self._count(kp, 0.0).right for kp in probes), default=float("nan"))

    def _edges_of_kp(self) -> list[float]:
        limit = self._critical.complete_to
        return [-limit, *self._critical.values.tolist(), limit]

    @cached_property
    def _island(self) -> tuple[float, Interval] | None:
        """A kp with stabilising ki although small ki do not: looked for in a column between any two kp at which
        the boundary meets ki = 0 or turns back."""
        turns = self.decomposition.turning_points
        edges = np.unique([e for e in [*self._edges_of_kp(), *self.decomposition.curve(turns)[0]] if math.isfinite(e)])
        for kp in probes_between([-math.inf, *edges.tolist(), math.inf], self._reference_gain):
            found = self.ki_intervals(kp)
            if found:
                return kp, found[0]
        return None


@dataclass(frozen=True)
class IntersectionRegion(Region):
    """The gains that lie in all of `regions`; made by `intersection`. `names` are what `reason` calls their plants."""

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
        # ki small enough for each of finitely many plants is small enough for all: intersecting kp is exact
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
            more = f" (nor {len(alone) - 1} more of the {len(names)})" if len(alone) > 1 else ""
            return f"{name}{more}: {reason}"
        sets = [(name, r.kp_intervals) for name, r in zip(names, self.regions, strict=True)]
        # two that exclude each other are reason enough
        apart = next(([a, b] for a, b in itertools.combinations(sets, 2) if not common_intervals([a[1], b[1]])), sets)
        told = "; ".join(
            f"{name}: " + ", ".join(f"{low:.6g} < kp < {high:.6g}" for low, high in found) for name, found in apart
        )
        return f"no kp stabilises all plants with small ki ({told}); schedule the gains"


@checked
def stabilizing_pi(plant: Any, dead_time: float = 0.0) -> StabilizingRegion:
    """All (kp, ki) with ki >= 0 for which kp + ki/s stabilises plant(s) exp(-dead_time s), negative feedback.

    The loop is L(s) = (kp + ki/s) P(s) exp(-dead_time s), and a gain stabilises if 1 + L has no root with real part
    >= 0, the dead time exact ([Gryazina2008]; [WaltonMarshall1987]). With the wheel's plant, from brake torque to
    sigma, P > 0 at high frequency, and kp and ki are those of Tb = kp e + ki integral(e), e = sigma_d - sigma
    ([Park2008] (3), Table 4); the set of a plant of the other sign has kp < 0.

    Parameters
    ----------
    plant : python-control TransferFunction or StateSpace, `Rational`, or a real number
        P, controlled variable over controller output, in any units, time in s; continuous-time, SISO; strictly proper
        if there is dead time. It may be unstable; hidden unstable modes empty the set. The actuator's lag belongs to
        it.
    dead_time : float
        s, >= 0.

    Returns
    -------
    StabilizingRegion
        The whole set, open: `kp_range` and `kp_intervals`, `ki_limit` and `ki_intervals` at a kp, `contains`; kp in
        units of the plant's input over its output, ki in that per second. Empty where no PI stabilises: `kp_range` is
        then None, and `reason` says why. Ends are exact to rounding, and may be infinite.

    Raises
    ------
    InputError
        The plant or the dead time is not of this form; or a plant with direct feedthrough and dead time, whose loop is
        neutral.
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
    """All (kp, ki) with ki >= 0 for which a PID with fixed derivative part stabilises; see `stabilizing_pi`.

    Parameters
    ----------
    plant, dead_time
        As for `stabilizing_pi`.
    derivative_filter : float
        Tf, s, > 0, in C(s) = kp + ki/s + kd s/(Tf s + 1).
    derivative_time : float
        Td, s, >= 0: kd = Td kp, so that the derivative part scales with kp.
    derivative_gain : float
        kd itself, in units of kp times s, of either sign. Give one of the two.

    Raises
    ------
    InputError
        Both or neither of derivative time and gain, or a value outside its range.
    """
    if (derivative_time is None) == (derivative_gain is None):
        raise InputError("PID: give either derivative_time (s) or derivative_gain, not both and not neither")
    lag = number("derivative filter", derivative_filter)
    if lag <= 0:
        raise InputError(f"derivative filter: {lag} s is not allowed; give a value > 0, or the PID is not proper")
    time = number("derivative time", derivative_time or 0.0)
    if time < 0:
        raise InputError(f"derivative time: {time} s is not allowed; give a value >= 0")
    gain = number("derivative gain", derivative_gain or 0.0)
    return _region(plant, dead_time, derivative_time=time, derivative_gain=gain, derivative_filter=lag)


@checked
def intersection(regions: Sequence[Region], names: Sequence[str] = ()) -> IntersectionRegion:
    """The gains that lie in every one of `regions`, intervals and all.

    Parameters
    ----------
    regions : sequence of Region
        At least one.
    names : sequence of str
        What to call the plant of each where the intersection is empty; left out, by number.

    Returns
    -------
    IntersectionRegion
        In the units of the regions.

    Raises
    ------
    InputError
        No region is given, or another number of names.
    """
    if not regions:
        raise InputError("intersection: no region is given; give at least one")
    if names and len(names) != len(regions):
        raise InputError(f"names: {len(names)} for {len(regions)} regions; give one for each, or none")
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
