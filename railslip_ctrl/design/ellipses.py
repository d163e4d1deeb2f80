"""The PI gains that Ms <= M forbids: one ellipse for each plant and frequency ([Astrom1998], MIGO).

|1 + (kp + ki/(j omega)) P| >= 1/M reads (kp + x)^2 + (ki/omega - y)^2 >= r^2 with x + j y = 1/P and r = |1/P|/M, so
that at one kp each frequency forbids the ki between omega (y - h) and omega (y + h), h^2 = r^2 - (kp + x)^2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from railslip_ctrl.loop import Rational
from railslip_ctrl.loop.crossings import Response, frequency_nodes
from railslip_ctrl.loop.rootfinding import bracketed_roots

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Indices = NDArray[np.intp]

_PER_NODE = 6  # frequencies between neighbouring nodes of a loop
_NEARLY = 1.05  # a sampled dip is above its bottom by far less: those beyond this factor of the lowest cannot be lower


@dataclass(frozen=True)
class Gap:
    """The ki between two forbidden ones at some kp: the upper `end`, inf without one, and an `inside`."""

    end: float
    inside: float


class Ellipses:
    """The ellipses of plants exp(-dead_time s), `ms_max` > 1, sampled densely in frequency (rad/s)."""

    def __init__(self, systems: Sequence[Rational], dead_times: Sequence[float], ms_max: float) -> None:
        self._responses = [Response(g, tau) for g, tau in zip(systems, dead_times, strict=True)]
        self._ms_max = ms_max
        omegas = []
        for response in self._responses:
            nodes = frequency_nodes(response)
            # beyond a hundred times the gain's own bandwidth |C P| is too small to matter
            omega = np.interp(np.arange((nodes.size - 1) * _PER_NODE + 1) / _PER_NODE, np.arange(nodes.size), nodes)
            omegas.append(omega)
        self._omega = np.concatenate(omegas)
        self._member = np.repeat(np.arange(len(omegas)), [omega.size for omega in omegas])
        inverse = np.concatenate([1 / response(w) for response, w in zip(self._responses, omegas, strict=True)])
        self._x, self._y, self._radius = inverse.real, inverse.imag, np.abs(inverse) / ms_max

    def gaps(self, kp: float) -> list[Gap]:
        """The gaps between forbidden ki > 0 at this kp, as the samples show them; the highest first."""
        low, high = self._ends(kp)
        hit = np.isfinite(low)
        low, high = low[hit], high[hit]
        order = np.argsort(low)
        low, high = low[order], np.maximum.accumulate(high[order])
        starts = np.maximum(np.concatenate([[0.0], high]), 0.0)
        ends = np.concatenate([low, [np.inf]])
        found = np.flatnonzero((ends > starts * (1 + 1e-9)) & (ends > 0))[::-1]
        inside = np.where(np.isfinite(ends[found]), 0.5 * (starts[found] + ends[found]), 2 * starts[found] + abs(kp))
        return [Gap(*pair) for pair in zip(ends[found].tolist(), inside.tolist(), strict=True)]

    def end_of(self, kp: float, gap: Gap) -> float:
        """The upper end of one of `gaps`, to rounding: the lowest bottom of the dips of the forbidden ki's lower end
        over frequency that the samples show just above the gap."""
        if not np.isfinite(gap.end):
            return gap.end
        low, _ = self._ends(kp)
        same = np.diff(self._member) == 0
        before = np.append(np.inf, np.where(same, low[:-1], np.inf))
        after = np.append(np.where(same, low[1:], np.inf), np.inf)
        dips = np.flatnonzero((low <= before) & (low <= after) & (low > gap.inside) & (low <= _NEARLY * gap.end))
        neighbours = np.append(False, same), np.append(same, False)
        left, right = (self._omega[dips + step * has[dips]] for step, has in zip((-1, 1), neighbours, strict=True))
        at, member = self._omega[dips], self._member[dips]

        def slope(omega: Floats, index: Indices) -> Floats:
            return self._slope(kp, omega, member[index], omega < at[index])

        bottom = bracketed_roots(slope, left, right)
        inverse, _ = self._inverse(bottom, member)
        with np.errstate(invalid="ignore"):
            half = np.sqrt((np.abs(inverse) / self._ms_max) ** 2 - (kp + inverse.real) ** 2)
        return float(np.nanmin(np.append(bottom * (inverse.imag - half), low[dips])))

    def _ends(self, kp: float) -> tuple[Floats, Floats]:
        """The forbidden ki at each sample, from and to; inf where there are none."""
        with np.errstate(invalid="ignore"):
            half = np.sqrt(self._radius**2 - (kp + self._x) ** 2)
        hit = half > 0
        low, high = (np.where(hit, self._omega * (self._y + side * half), np.inf) for side in (-1.0, 1.0))
        return low, high

    def _slope(self, kp: float, omega: Floats, member: Indices, left: NDArray[np.bool_]) -> Floats:
        """d/d omega of the lower end; infinite, towards the dip, `left` and right of where it forbids anything."""
        inverse, change = self._inverse(omega, member)
        with np.errstate(invalid="ignore", divide="ignore"):
            half = np.sqrt((np.abs(inverse) / self._ms_max) ** 2 - (kp + inverse.real) ** 2)
            growth = (inverse.conj() * change).real / self._ms_max**2 - (kp + inverse.real) * change.real
            slope = inverse.imag - half + omega * (change.imag - growth / half)
        return np.where(half > 0, slope, np.where(left, -np.inf, np.inf))

    def _inverse(self, omega: Floats, member: Indices) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """1/P with its dead time, and its derivative, each frequency of its own plant."""
        value, change = np.empty((2, omega.size), dtype=complex)
        for one in np.unique(member).tolist():
            mine = member == one
            response = self._responses[one]
            value[mine] = 1 / response(omega[mine])
            change[mine] = -value[mine] * response.log_slope(omega[mine])
        return value, change
