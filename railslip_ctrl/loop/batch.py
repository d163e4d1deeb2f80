"""Margins of many dead-time loops at once: `DeadTimeLoop.margins()` for maps and sweeps, vectorised over loops.

The method is that of the scalar engine (`crossings`, `stability`, `margins`), on the points of all loops at once
(`batch_points`), between which ln|L| and the continuous phase are monotone. That gives every crossover, the exact root
count and, piece by piece, a closed-form upper bound on |S|, |T| and |S - 1/2|: only pieces whose bound exceeds what is
already attained are searched for a peak. A loop in which a decision hangs on rounding is handed to the scalar engine,
so that there the results are equal by construction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np

from railslip_ctrl.core.errors import InputError

from .batch_points import DELICATE, Loops, Points, band, bounds, divided, levels, located, monotone
from .deadtime import DeadTimeLoop
from .margins import RESPONSES
from .rational import Rational

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]
    Complexes = NDArray[np.complex128]
    Flags = NDArray[np.bool_]
    Indices = NDArray[np.intp]

_CHUNK = 512  # loops worked on together: their points stay in the cache, and NumPy's cost per call is shared
_ON_LEVEL = 1e-12  # as `DELICATE`, for values at nodes, which come near a threshold by accident more often
_OF_GAIN, _OF_PEAKS = (
    tuple(f"{name}{end}" for name in names for end in ("", "_frequency"))
    for names in (("gain_increase", "gain_decrease"), ("ms", "mt", "disk"))
)
_PEAK_GAIN = 1e-10  # a piece whose bound exceeds the attained peak by less, relatively, is not searched


@dataclass(frozen=True)
class BatchMargins:
    """Margins of n loops; every field has shape (n,), and each means what it means in `Margins`.

    Attributes
    ----------
    stable : array of bool
    unstable_poles : array
        Closed-loop poles with real part >= 0, exactly counted.
    gain_increase, gain_decrease, phase_deg, delay_s, ms, mt, disk : array
        Margins (factors, deg, s, peaks of |S| and |T|, balanced disk margin); NaN for a loop that is not stable.
    gain_increase_frequency, gain_decrease_frequency, phase_frequency, delay_frequency, ms_frequency, mt_frequency, \
disk_frequency : array
        Where, rad/s.
    """

    stable: Flags
    unstable_poles: Floats
    gain_increase: Floats
    gain_increase_frequency: Floats
    gain_decrease: Floats
    gain_decrease_frequency: Floats
    phase_deg: Floats
    phase_frequency: Floats
    delay_s: Floats
    delay_frequency: Floats
    ms: Floats
    ms_frequency: Floats
    mt: Floats
    mt_frequency: Floats
    disk: Floats
    disk_frequency: Floats

    def __len__(self) -> int:
        return int(self.stable.size)


def stack(loops: Sequence[Rational], dead_times: ArrayLike) -> tuple[Complexes, Complexes, Floats, Floats]:
    """Arguments of `batch_margins` from n transfer functions of one structure.

    Parameters
    ----------
    loops : sequence of Rational
        G of each loop, all with the same numbers of zeros and of poles.
    dead_times : float or array (n,)
        s.

    Raises
    ------
    InputError
        The numbers of zeros or of poles differ, or the dead times are not one per loop.
    """
    shapes = {(g.zeros.size, g.poles.size) for g in loops}
    if len(shapes) > 1:
        raise InputError(f"loops: (zeros, poles) counts {sorted(shapes)} differ; stack loops of one structure only")
    if np.ndim(dead_times) > 0 and np.shape(dead_times) != (len(loops),):
        raise InputError(f"dead times: shape {np.shape(dead_times)} for {len(loops)} loops; give one each, or one")
    mz, mp = shapes.pop() if shapes else (0, 1)
    zeros = np.array([g.zeros for g in loops], dtype=complex).reshape(len(loops), mz)
    poles = np.array([g.poles for g in loops], dtype=complex).reshape(len(loops), mp)
    gain = np.array([g.gain for g in loops], dtype=float)
    return zeros, poles, gain, np.broadcast_to(np.asarray(dead_times, dtype=float), gain.shape).copy()


def batch_margins(
    zeros: ArrayLike,
    poles: ArrayLike,
    gain: ArrayLike,
    dead_time: ArrayLike,
    *,
    gain_margins: bool = True,
    peaks: bool = True,
) -> BatchMargins:
    """All margins of L(s) = gain prod(s - zeros)/prod(s - poles) exp(-dead_time s), loop by loop.

    Parameters
    ----------
    zeros, poles : array of complex, shapes (n, mz) and (n, mp), mz < mp
        1/s; complex ones in conjugate pairs. A pole cancelled by a zero still counts for stability.
    gain : array (n,)
        Ratio of the leading coefficients.
    dead_time : array (n,)
        s, >= 0.
    gain_margins, peaks : bool
        False leaves the gain margins, or `ms`, `mt`, `disk` and where they are, NaN: the rest takes half the time.

    Raises
    ------
    InputError
        Shapes that do not belong together, not strictly proper, a number that is not finite, a negative dead time,
        or complex roots without their conjugates.
    """
    loops = _checked(zeros, poles, gain, dead_time)
    n = loops.gain.size
    results = {f.name: np.full(n, np.nan) for f in fields(BatchMargins)}
    low, high, delicate = band(loops)
    plain = np.flatnonzero(~delicate)
    for start in range(0, plain.size, _CHUNK):
        index = plain[start : start + _CHUNK]
        asked = gain_margins, peaks
        delicate[index] = _solve(loops.take(index), low[index], high[index], index, results, asked)
    for i in np.flatnonzero(delicate):
        _solve_alone(loops, int(i), results)
    for group, wanted in ((_OF_GAIN, gain_margins), (_OF_PEAKS, peaks)):
        if not wanted:
            results |= {name: np.full(n, np.nan) for name in group}
    stable = results.pop("stable") == 1
    return BatchMargins(stable=stable, **results)


def _solve_alone(loops: Loops, i: int, results: dict[str, Floats]) -> None:
    """Loop number i by the scalar engine."""
    roots = loops.real[:, i] + 1j * loops.imag[:, i]
    rational = Rational(roots[loops.sign > 0], roots[loops.sign < 0], float(loops.gain[i]))
    loop = DeadTimeLoop(rational, float(loops.dead_time[i]))
    margins = loop.margins() if loop.is_stable() else None
    for name, column in results.items():
        column[i] = getattr(margins, name, np.nan)
    results["stable"][i], results["unstable_poles"][i] = loop.is_stable(), loop.unstable_closed_loop_poles


def _checked(zeros: ArrayLike, poles: ArrayLike, gain: ArrayLike, dead_time: ArrayLike) -> Loops:
    z, p = np.asarray(zeros, dtype=complex), np.asarray(poles, dtype=complex)
    k, tau = np.asarray(gain, dtype=float), np.asarray(dead_time, dtype=float)
    n = k.size
    if not (k.ndim == tau.ndim == 1 and z.ndim == p.ndim == 2 and tau.size == z.shape[0] == p.shape[0] == n):
        raise InputError(
            f"shapes: zeros {z.shape}, poles {p.shape}, gain {k.shape}, dead time {tau.shape} do not belong "
            "together; give (n, mz), (n, mp), (n,), (n,)"
        )
    if z.shape[1] >= p.shape[1]:
        raise InputError(
            f"loops with {z.shape[1]} zeros and {p.shape[1]} poles are not strictly proper; add poles (for example "
            "a derivative filter) or use DeadTimeLoop"
        )
    if not all(np.isfinite(x).all() for x in (z, p, k)):
        raise InputError("zeros, poles or gain: a number is not finite; give finite numbers")
    bad = ~(np.isfinite(tau) & (tau >= 0))
    if bad.any():
        raise InputError(f"dead time: {tau[bad][0]} s is not allowed; give finite values >= 0")
    for name, roots in (("zeros", z), ("poles", p)):
        # the polynomial is real if and only if all power sums of its roots are (Newton's identities)
        scaled = roots / np.maximum(np.abs(roots).max(axis=1, initial=0.0), 1e-300)[:, None]
        odd = [np.abs((scaled**power).sum(axis=1).imag) > 1e-9 for power in range(1, roots.shape[1] + 1)]
        if np.any(odd):
            raise InputError(f"{name}: complex ones without their conjugates; give conjugate pairs")
    roots = np.concatenate([z, p], axis=1).T
    sign = np.repeat([1.0, -1.0], [z.shape[1], p.shape[1]])
    return Loops(np.ascontiguousarray(roots.real), np.ascontiguousarray(roots.imag), sign, k, tau)


def _solve(
    loops: Loops, low: Floats, high: Floats, index: Indices, results: dict[str, Floats], asked: tuple[bool, bool]
) -> Flags:
    """Fill `results` at `index` for these loops, gain margins and peaks as `asked`; returns which of them are delicate
    and to be done again alone."""
    points, delicate = monotone(loops, low, high)
    n = index.size
    at = points.changes(points.size)
    crossovers, falling = located(loops, points, at, lambda found, _: found.size), points.size[at] > 0
    # a node on |L| = 1, or |L| not yet small at the last node, would upset the count
    delicate[points.row[np.abs(points.size) < _ON_LEVEL]] = True
    first = np.flatnonzero(np.diff(points.row, prepend=-1))
    last = np.append(first[1:], points.row.size) - 1
    delicate |= points.size[last] >= 0
    # the root count of `stability`: closed-loop poles in the right half plane from the turns of L at the crossovers
    turns = np.round(crossovers.phase / (2 * np.pi))
    distance = np.pi - np.abs(crossovers.phase - 2 * np.pi * turns)
    delicate[crossovers.row[distance <= DELICATE * (1 + np.abs(crossovers.phase))]] = True
    start = np.where(points.size[first] > 0, loops.right(1) + (loops.gain < 0), loops.right(-1))
    unstable = start - 2 * np.bincount(crossovers.row, np.where(falling, turns, -turns), minlength=n)
    stable = unstable == 0
    results["stable"][index], results["unstable_poles"][index] = stable, unstable
    if not stable.any():
        return delicate
    found = _crossover_margins(crossovers, n)
    if any(asked):
        points = points.inserted(at, crossovers)
        points = points.take(stable[points.row])
    for part in (part for part, wanted in zip((_gain_margins, _peaks), asked, strict=True) if wanted):
        values, doubtful = part(loops, points, n)
        found |= values
        delicate |= doubtful
    for name, column in found.items():
        results[name][index[stable]] = column[stable]
    return delicate


def _extreme(values: Floats, rows: Indices, n: int, default: float) -> tuple[Floats, Indices]:
    """Smallest of the `values` that belong to each of n rows, and its number; `default` and -1 for a row without."""
    order = np.lexsort((values, rows))
    present, position = np.unique(rows[order], return_index=True)
    smallest, number = np.full(n, default), np.full(n, -1)
    number[present] = order[position]
    smallest[present] = values[number[present]]
    return smallest, number


def _where(omega: Floats, number: Indices) -> Floats:
    """omega[number], NaN for number -1."""
    return np.append(omega, np.nan)[number]


def _crossover_margins(crossovers: Points, n: int) -> dict[str, Floats]:
    """Phase and delay margins; rows of unstable loops mean nothing."""
    angle = np.mod(crossovers.phase + np.pi, 2 * np.pi)
    phase, phase_at = _extreme(np.degrees(np.minimum(angle, 2 * np.pi - angle)), crossovers.row, n, np.inf)
    delay, delay_at = _extreme(angle / crossovers.omega, crossovers.row, n, np.inf)
    return {
        "phase_deg": phase,
        "phase_frequency": _where(crossovers.omega, phase_at),
        "delay_s": delay,
        "delay_frequency": _where(crossovers.omega, delay_at),
    }


def _gain_margins(loops: Loops, points: Points, n: int) -> tuple[dict[str, Floats], Flags]:
    """Gain margins, and the loops where one hangs on rounding."""
    off = points.phase - np.pi
    off -= 2 * np.pi * np.round(off / (2 * np.pi))
    delicate = np.zeros(n, dtype=bool)
    delicate[points.row[np.abs(off) < _ON_LEVEL * (1 + np.abs(points.phase))]] = True
    dc = loops.dc_gain()
    # a pole that leaves through the origin is a limit too
    real = (dc < 0) & np.isfinite(dc)
    at_zero = np.where(real, np.log(np.where(real, -dc, 1.0)), np.nan)
    found = {}
    for name, side in (("gain_increase", -1.0), ("gain_decrease", 1.0)):
        limit, frequency = _nearest_limit(loops, points, n, side)
        closer = (side * at_zero > 0) & (np.abs(at_zero) < limit)
        limit = np.where(closer, np.abs(at_zero), limit)
        found[name] = np.exp(-side * limit)
        found[f"{name}_frequency"] = np.where(closer, 0.0, frequency)
        delicate |= limit < DELICATE
    return found, delicate


def _nearest_limit(loops: Loops, points: Points, n: int, side: float) -> tuple[Floats, Floats]:
    """Smallest abs ln|L| at a phase crossover with |L| > 1 (`side` 1) or |L| < 1 (-1), and its frequency, rad/s.

    On a piece |L| is monotone and does not cross 1, so that of all its phase crossovers only the one nearest to
    the end where |L| is closer to 1 can count; and of all pieces only those that may beat the best of the others.
    """
    first, last = levels(points)
    size, row = points.size, points.row[:-1]
    near, far = (f(np.abs(size[:-1]), np.abs(size[1:])) for f in (np.minimum, np.maximum))
    mine = (last >= first) & (row == points.row[1:]) & (side * (size[:-1] + size[1:]) > 0)
    reach = np.full(n, np.inf)
    np.minimum.at(reach, row[mine], far[mine])
    at = np.flatnonzero(mine & (near <= reach[row]))
    rises, at_left = points.phase[at] < points.phase[at + 1], np.abs(size[at]) <= np.abs(size[at + 1])
    target = np.pi + 2 * np.pi * np.where(rises == at_left, first[at], last[at])
    crossings = located(loops, points, at, lambda found, i: found.phase - target[i])
    limit, number = _extreme(np.abs(crossings.size), crossings.row, n, np.inf)
    return limit, _where(crossings.omega, number)


def _peaks(loops: Loops, points: Points, n: int) -> tuple[dict[str, Floats], Flags]:
    """Suprema of |S|, |T| and |S - 1/2|, and the loops whose pieces turn too far to be searched here."""
    dc = np.clip(loops.dc_gain(), -1e100, 1e100).astype(complex)  # 1e100 for an integrator gives the limit
    peak, omega = np.zeros((3, n)), np.zeros((3, n))
    for loop, end in ((dc, 0.0), (np.zeros_like(dc), np.inf)):
        with np.errstate(divide="ignore", invalid="ignore"):
            values = np.array([shape(loop, loop)[0] for shape in RESPONSES])
        _raise(peak, omega, values, np.arange(n), np.full(n, end))
    _raise(peak, omega, points.responses()[0], points.row, points.omega)
    may_rise = bounds(points) > peak[:, points.row[:-1]] * (1 + _PEAK_GAIN)
    fine, piece, twisted = divided(loops, points, np.flatnonzero(may_rise.any(axis=0)))
    values, slopes = fine.responses()
    _raise(peak, omega, values, fine.row, fine.omega)
    # numbered by piece, so that neighbours from different pieces are not taken for a piece
    may_rise = bounds(replace(fine, row=piece)) > peak[:, fine.row[:-1]] * (1 + _PEAK_GAIN)
    kind, at = np.nonzero(may_rise & (slopes[:, :-1] > 0) & (slopes[:, 1:] < 0))
    top = located(loops, fine, at, lambda found, i: found.responses()[1][kind[i], np.arange(i.size)])
    own = np.where(kind == np.arange(3)[:, None], top.responses()[0], 0.0)
    _raise(peak, omega, own, top.row, top.omega)
    peak[2] = 1 / peak[2]
    names = ("ms", "mt", "disk")
    found = dict(zip(names, peak, strict=True))
    return found | {f"{name}_frequency": where for name, where in zip(names, omega, strict=True)}, twisted


def _raise(peak: Floats, omega: Floats, values: Floats, rows: Indices, frequencies: Floats) -> None:
    """Replace peaks (3, n) and where they are by those of the `values` (3, N), of loops `rows`, that are higher."""
    for best, where, value in zip(peak, omega, values, strict=True):
        before = best[rows]
        np.maximum.at(best, rows, np.where(np.isfinite(value), value, 0.0))
        higher = (value > before) & (value == best[rows])
        where[rows[higher]] = frequencies[higher]
