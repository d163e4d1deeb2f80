"""What a stabilising region looks like: its outline over kp, and margins over a grid of gains, as records."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from railslip_ctrl.core.arguments import checked, number, numbers
from railslip_ctrl.core.errors import InputError

from .families import family_margins
from .intervals import Intervals
from .stabilizing import Region

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]

_GRID = 50, 40  # kp by ki: contours without visible corners
_BISECTIONS = 40  # from a column spacing to the last bits of where a strip ends


@dataclass(frozen=True)
class Strip:
    """Part of a region between two curves, in the region's units.

    ki_low < ki < ki_high at each kp, arrays of one shape, kp ascending. `kp_cut` and `ki_cut` tell that the region goes
    on past the kp largest in size, and past the largest ki_high: there `outline` was told to stop.
    """

    kp: Floats
    ki_low: Floats
    ki_high: Floats
    kp_cut: bool = False
    ki_cut: bool = False

    @property
    def polygon(self) -> Floats:
        """The closed outline, shape (2 n, 2), columns kp and ki."""
        return np.column_stack(
            [np.concatenate([self.kp, self.kp[::-1]]), np.concatenate([self.ki_low, self.ki_high[::-1]])]
        )


@dataclass(frozen=True)
class MarginGrid:
    """Worst margins over all plants of a region, arrays of shape (kp.size, ki.size), NaN outside the region.

    `kp` and `ki` are the grid lines in the region's units; `ms` peak of |S|, a ratio, `phase_deg` smallest phase margin
    in size, deg, `delay_s` smallest delay margin, s.
    """

    kp: Floats
    ki: Floats
    ms: Floats
    phase_deg: Floats
    delay_s: Floats


@checked
def outline(
    region: Region,
    kp: ArrayLike | None = None,
    count: int = 120,
    *,
    kp_limit: float = math.inf,
    ki_limit: float = math.inf,
) -> tuple[Strip, ...]:
    """The region as strips over kp, each between two continuous boundaries; exact in every column.

    Parameters
    ----------
    region : Region
    kp : array, 1-D, optional
        Columns, ascending, in the plant's unit of gain; by default `count` of them over `region.kp_range`, closer
        towards its ends.
    count : int
        Number of columns where none are given, >= 2.
    kp_limit, ki_limit : float
        Gains > 0, in those units, past which nothing is drawn; a strip that goes on past them says so. By default the
        whole region.

    Returns
    -------
    tuple of Strip
        From the lowest kp to the highest; empty where the region is. `ki_high` is inf where ki goes on without bound
        and no `ki_limit` is given.

    Raises
    ------
    InputError
        The region goes on without bound in kp, and neither columns nor a limit are given; a limit is not > 0.

    Notes
    -----
    A strip's ends are refined only where the number of intervals changes between columns; what appears and
    vanishes between two of them is not seen. `Region.contains` is what decides.
    """
    number("count", count, ge=2)
    for name, limit in (("kp_limit", kp_limit), ("ki_limit", ki_limit)):
        if not limit > 0:
            raise InputError(f"{name}: {limit} is not allowed; give a gain > 0, or leave it out")
    columns = _columns(region, count, kp_limit) if kp is None else np.atleast_1d(numbers("kp", kp))
    columns = columns[np.abs(columns) <= kp_limit]
    if columns.size == 0:
        return ()
    found = [
        _strip(xs, [column[i] for column in ends], ki_limit)
        for xs, ends in _groups(region, columns)
        for i in range(len(ends[0]))
    ]
    least, most = region.kp_range or (math.nan, math.nan)
    cut = [float(columns[0])] if least < -kp_limit else []
    cut += [float(columns[-1])] if most > kp_limit else []
    return tuple(
        replace(strip, kp_cut=strip.kp[0] in cut or strip.kp[-1] in cut)
        for strip in found
        if (strip.ki_low < ki_limit).any()
    )


@checked
def margin_grid(region: Region, kp: ArrayLike, ki: ArrayLike) -> MarginGrid:
    """Exact margins at each pair of gains inside a region; see `MarginGrid`.

    Parameters
    ----------
    region : Region
    kp, ki : arrays, 1-D
        Grid lines, in the plant's unit of gain and that per second; ki = 0 is P control.

    Returns
    -------
    MarginGrid
        Arrays of shape (kp.size, ki.size), Ms a ratio, phase margin in deg, delay margin in s; NaN outside the region.

    Raises
    ------
    InputError
        A gain is not finite.
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
    """A region's `outline` up to limits of kp and ki, and margins over a grid within it.

    InputError for an empty region, with the reason, and for one that goes on without bound and has no limit.
    """
    strips = outline(region, kp_limit=kp_limit, ki_limit=ki_limit)
    if not strips:
        raise InputError(f"region: there is nothing to draw; {region.reason or 'give larger limits'}")
    top = max(float(strip.ki_high.max()) for strip in strips)
    if math.isinf(top):
        raise InputError("region: it goes on without bound in ki; give ki_limit, up to which to draw it")
    low, high = min(float(strip.kp[0]) for strip in strips), max(float(strip.kp[-1]) for strip in strips)
    return strips, margin_grid(region, np.linspace(low, high, _GRID[0]), np.linspace(0.0, top, _GRID[1]))


def _groups(region: Region, columns: Floats) -> list[tuple[list[float], list[Intervals]]]:
    """Columns with their intervals, in groups of one number of them."""
    ki = [region.ki_intervals(float(x)) for x in columns]
    groups: list[tuple[list[float], list[Intervals]]] = [([float(columns[0])], [ki[0]])]
    for x0, x1, before, after in zip(columns[:-1], columns[1:], ki[:-1], ki[1:], strict=True):
        if len(before) != len(after):
            left, right = _where_the_number_changes(region, (float(x0), before), (float(x1), after))
            _extend(groups[-1], left)
            groups.append(([right[0]], [right[1]]))
        _extend(groups[-1], (float(x1), after))
    return groups


def _strip(kp: list[float], between: list[tuple[float, float]], ki_limit: float) -> Strip:
    low, high = np.array(between).T
    ki_cut = bool((high > ki_limit).any())
    return Strip(np.array(kp), np.minimum(low, ki_limit), np.minimum(high, ki_limit), ki_cut=ki_cut)


def _columns(region: Region, count: int, kp_limit: float) -> Floats:
    if region.kp_range is None:
        return np.array([])
    low, high = max(region.kp_range[0], -kp_limit), min(region.kp_range[1], kp_limit)
    if math.isinf(high - low):
        raise InputError(
            f"outline: the region goes on without bound, kp from {low:.6g} to {high:.6g}; give the columns kp to draw, "
            "or kp_limit, up to which to draw it"
        )
    if low >= high:
        return np.array([])
    # the boundary leaves the ends of the range steeply
    return np.asarray(low + (high - low) * (0.5 - 0.5 * np.cos(np.pi * (np.arange(count) + 0.5) / count)))


def _where_the_number_changes(
    region: Region, left: tuple[float, Intervals], right: tuple[float, Intervals]
) -> tuple[tuple[float, Intervals], tuple[float, Intervals]]:
    """Neighbouring columns, with their intervals, on the two sides of the last change in number between two."""
    for _ in range(_BISECTIONS):
        middle = 0.5 * (left[0] + right[0])
        here = region.ki_intervals(middle)
        if len(here) == len(left[1]):
            left = middle, here
        else:
            right = middle, here
    return left, right


def _extend(group: tuple[list[float], list[Intervals]], column: tuple[float, Intervals]) -> None:
    if column[0] > group[0][-1] and len(column[1]) == len(group[1][-1]):
        group[0].append(column[0])
        group[1].append(column[1])
