"""The PI gains that a specification forbids, frequency by frequency.

Ms <= M: |1 + (kp + ki/(j omega)) P| >= 1/M reads (kp + x)^2 + (ki/omega - y)^2 >= r^2 with x + j y = 1/P and
r = |1/P|/M: one ellipse of gains for each plant and frequency ([Astrom1998], MIGO). Phase and delay margin: a crossover
at omega needs kp^2 + (ki/omega)^2 = |1/P|^2, and the phase there is that of C P: an arc of gains.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from railslip_ctrl.loop import Rational
from railslip_ctrl.loop.crossings import Response, bracketed_roots, frequency_nodes

from .intervals import Interval
from .specification import Specification

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Indices = NDArray[np.intp]

_PER_NODE = 6  # frequencies between neighbouring nodes of a plant
_TURN = 0.15  # rad of dead time between frequencies, as far as |C P| may matter
_MOST_TURNS = 6000  # of those
_FARTHEST = 4.0  # times its usual largest kp: with much integral action it may be somewhat more
_MATTERS = 0.5 / _FARTHEST  # |C P| below which no peak or margin of use is touched
_NEARLY = 1.05  # a sampled dip is above its bottom by far less: those beyond this factor of the lowest cannot be lower
_NARROWEST = 1e-9  # relative width of a gap below which it is the rounding of its ends
_REACH = 10.0  # from the gains of the highest samples to where those of a plant without dead time are limitless


class Forbidden:
    """The gains that plants exp(-dead_time s) forbid, sampled densely in frequency (rad/s).

    `usual_kp` is the largest gain of use to each plant with little integral action, inf if nothing bounds it.
    """

    def __init__(self, systems: Sequence[Rational], dead_times: Sequence[float], usual_kp: Sequence[float]) -> None:
        self._responses = [Response(g, tau) for g, tau in zip(systems, dead_times, strict=True)]
        omegas = [_frequencies(*pair) for pair in zip(self._responses, usual_kp, strict=True)]
        self._omega = np.concatenate(omegas)
        self._member = np.repeat(np.arange(len(omegas)), [omega.size for omega in omegas])
        with np.errstate(divide="ignore", invalid="ignore"):
            self._inverse = np.concatenate([1 / r(w) for r, w in zip(self._responses, omegas, strict=True)])
        self._inverse[~np.isfinite(self._inverse)] = np.nan  # at a zero on the axis, where nothing is forbidden
        self._size = np.abs(self._inverse)
        mine = [self._member == i for i in range(len(omegas))]
        self.reach = min(_REACH * float(np.nanmax(self._size[one])) for one in mine)
        """kp, in size, beyond which a crossover of some plant lies above all samples; the like for ki are `ki_ends`."""
        self.reach = min(self.reach, *(_FARTHEST * kp for kp in usual_kp))
        ki = self._omega * self._size
        self.ki_ends = float(np.nanmin(ki)) / _REACH**3, min(float(np.nanmax(ki[one])) for one in mine) / _REACH
        self.log_times = -math.log(self._omega.max()) - 7.0, 7.0 - math.log(self._omega.min())
        """ln of times, s, far below and above those of the plants."""

    def gaps(self, ki: float, specification: Specification) -> list[Interval]:
        """The intervals of kp between those that the samples forbid at this ki > 0, ascending, within `reach`."""
        parts = [*self._arcs(ki / self._omega, specification), *self._crossover_ends(ki, specification)]
        if specification.ms_max is not None:
            half = _leg(self._size / specification.ms_max, ki / self._omega - self._inverse.imag)
            hit = half > 0
            parts.append((-self._inverse.real[hit] - half[hit], -self._inverse.real[hit] + half[hit]))
        low, high = (np.concatenate(ends) for ends in zip(*parts, strict=True))
        order = np.argsort(low)
        starts = np.maximum(np.append(-np.inf, np.maximum.accumulate(high[order])), -self.reach)
        ends = np.minimum(np.append(low[order], np.inf), self.reach)
        wide = ends - starts > _NARROWEST * np.maximum(np.abs(starts), np.abs(ends))
        return list(zip(starts[wide].tolist(), ends[wide].tolist(), strict=True))

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

    def end_above(self, kp: float, ki: float, ms_max: float) -> float:
        """The least ki above this one that Ms <= `ms_max` forbids at `kp`, to rounding: the lowest bottom of the dips
        of the forbidden ki's lower end over frequency; inf without one, 0 where it forbids `ki` itself."""
        half = _leg(self._size / ms_max, kp + self._inverse.real)
        low = np.where(half > 0, self._omega * (self._inverse.imag - half), np.inf)
        if np.any((low <= ki) & (ki <= self._omega * (self._inverse.imag + half))):
            return 0.0
        end = float(np.min(low[low > ki], initial=np.inf))
        if not np.isfinite(end):
            return end
        same = np.diff(self._member) == 0
        before = np.append(np.inf, np.where(same, low[:-1], np.inf))
        after = np.append(np.where(same, low[1:], np.inf), np.inf)
        dips = np.flatnonzero((low <= before) & (low <= after) & (low > ki) & (low <= _NEARLY * end))
        neighbours = np.append(False, same), np.append(same, False)
        left, right = (self._omega[dips + step * has[dips]] for step, has in zip((-1, 1), neighbours, strict=True))
        at, member = self._omega[dips], self._member[dips]

        def slope(omega: Floats, index: Indices) -> Floats:
            return self._slope(kp, ms_max, omega, member[index], omega < at[index])

        bottom = bracketed_roots(slope, left, right)
        inverse, _ = self._inverse_at(bottom, member)
        half = _leg(np.abs(inverse) / ms_max, kp + inverse.real)
        found = np.where(half > 0, bottom * (inverse.imag - half), np.inf)
        return float(np.min(np.append(found, end)))

    def _slope(self, kp: float, ms_max: float, omega: Floats, member: Indices, left: NDArray[np.bool_]) -> Floats:
        """d/d omega of the lower end; infinite, towards the dip, `left` and right of where it forbids anything."""
        inverse, change = self._inverse_at(omega, member)
        half = _leg(np.abs(inverse) / ms_max, kp + inverse.real)
        with np.errstate(invalid="ignore", divide="ignore"):
            growth = (inverse.conj() * change).real / ms_max**2 - (kp + inverse.real) * change.real
            slope = inverse.imag - half + omega * (change.imag - growth / half)
        return np.where(half > 0, slope, np.where(left, -np.inf, np.inf))

    def _inverse_at(self, omega: Floats, member: Indices) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """1/P with its dead time, and its derivative, each frequency of its own plant."""
        value, change = np.empty((2, omega.size), dtype=complex)
        for one in np.unique(member).tolist():
            mine = member == one
            response = self._responses[one]
            value[mine] = 1 / response(omega[mine])
            change[mine] = -value[mine] * response.log_slope(omega[mine])
        return value, change


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
