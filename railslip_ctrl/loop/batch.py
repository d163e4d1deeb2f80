"""Margins of many dead-time loops at once, for maps and sweeps: `DeadTimeLoop.margins()`, vectorised over loops.

Each loop is evaluated at frequencies from a factor 1e4 below to a factor 1e4 above all poles, all zeros, and the gain
crossovers of the asymptotes. Bounds on the second derivative of ln L prove that no gain crossover between these
frequencies is missed, that no missed phase crossover limits a margin, and that no peak is more than 0.1 % higher than
the reported peak. `DeadTimeLoop` computes the loops for which the proof fails or rounding could decide.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from railslip_ctrl.core.arguments import Complexes, Flags, Floats
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass

from .crossings import bracketed_roots
from .deadtime import DeadTimeLoop
from .margins import SHAPES, box_bounds, heights, responses
from .rational import Rational

Indices = NDArray[np.intp]
Spans = tuple[Floats, Floats]

#: Distance from a threshold, for example |L| = 1, below which `DeadTimeLoop` computes the loop; 1e6 times the rounding.
DELICATE = 1e-9

_NODES_PER_DECADE = 5  # extrema that the nodes show are located exactly; bounds exclude or find the others
_NODES_PER_RESONANCE = 8  # per decade of distance from a complex root's own frequency, as in `crossings`
_REACH = 1e4  # factor from the lowest and highest feature to the outermost nodes
_FAR, _NODES_FAR_OUT = 1e3, 2  # in the outer factor 1e3 of `_REACH`, L is nearly its asymptote: 2 nodes per decade
_WIDEST = 1e24  # ratio of highest to lowest node above which a loop would slow down all loops solved with it
_EXTREME = 1e60  # rad/s; frequencies above it, or below its reciprocal, could overflow when squared
_LEAST_DAMPING = 1e-7  # |Re|/|Im| of a complex root up to which `DeadTimeLoop` computes the loop
_PHASE_STEP = 0.5  # rad, largest change of phase over one interval in the search for a peak
_MOST_PARTS = 500  # parts of one interval in the search for a peak; `DeadTimeLoop` computes loops that need more
_MOST_HALVINGS = 6  # halvings of an interval that may hide a gain crossover; then `DeadTimeLoop` computes it
_BLOCK = 1024  # points evaluated in one call: few enough to stay in the processor's cache
_CHUNK = 512  # loops solved together: their points stay in the cache, and NumPy's cost per call is shared
_ON_LEVEL = 1e-12  # as `DELICATE`, but for values at nodes, which more often lie near a threshold by chance
_OF_GAIN, _OF_PEAKS = (
    tuple(f"{name}{end}" for name in names for end in ("", "_frequency"))
    for names in (("gain_increase", "gain_decrease"), ("ms", "mt", "disk"))
)
_PEAK_SURE = 1e-3  # no peak exceeds the reported one by more than this, relatively
_PARTS, _MOST_ROUNDS = 4, 8  # parts of an undecided interval, and most divisions before `DeadTimeLoop` decides
_PEAK_GAIN = 1e-10  # an interval is searched if its bound exceeds the highest known value by more than this, relatively


@dataclass(frozen=True)
class BatchMargins:
    """Margins of n loops; every field is an array of shape (n,). `Margins` explains the margins.

    - stable: bool; true if the closed loop is stable.
    - unstable_poles: number of closed-loop poles with real part >= 0, exact.
    - gain_increase, gain_decrease, phase_deg, delay_s, ms, mt, disk: margins (factors, deg, s, peaks of |S| and |T|,
      balanced disk margin); NaN for an unstable loop.
    - gain_increase_frequency, gain_decrease_frequency, phase_frequency, delay_frequency, ms_frequency, mt_frequency,
      disk_frequency: frequencies of these margins, rad/s.
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
    """Return zeros, poles, gains and dead times of n loops as arrays for `batch_margins`.

    - loops: transfer functions with equal numbers of zeros and equal numbers of poles.
    - dead_times: s; one dead time for all loops, or one per loop.

    InputError: the loops have different numbers of zeros or poles, or the number of dead times is wrong.
    """
    shapes = {(g.zeros.size, g.poles.size) for g in loops}
    if len(shapes) > 1:
        raise InputError(f"loops: numbers of (zeros, poles) differ: {sorted(shapes)}; give loops with equal numbers")
    if np.ndim(dead_times) > 0 and np.shape(dead_times) != (len(loops),):
        raise InputError(
            f"dead times: shape {np.shape(dead_times)} for {len(loops)} loops; give one value, or one per loop"
        )
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
    """Compute all margins of n loops L(s) = gain prod(s - zeros)/prod(s - poles) exp(-dead_time s).

    - zeros, poles: array of complex, shapes (n, mz) and (n, mp), mz < mp; 1/s; complex values in conjugate pairs. A
      pole cancelled by a zero still counts for stability.
    - gain: array (n,); ratio of the leading coefficients.
    - dead_time: array (n,); s, >= 0.
    - gain_margins: true to compute the gain margins; otherwise they and their frequencies are NaN.
    - peaks: true to compute `ms`, `mt` and `disk`; otherwise they and their frequencies are NaN. Without the gain
      margins, or without the peaks, the computation takes half the time.

    InputError: inconsistent shapes, a loop that is not strictly proper, a number that is not finite, a negative dead
    time, or complex roots without their conjugates.
    """
    loops = _checked(zeros, poles, gain, dead_time)
    n = loops.gain.size
    results = {f.name: np.full(n, np.nan) for f in fields(BatchMargins)}
    low, high, delicate = band(loops)
    plain = np.flatnonzero(~delicate)
    for start in range(0, plain.size, _CHUNK):
        index = plain[start : start + _CHUNK]
        requested = gain_margins, peaks
        delicate[index] = _solve(loops.take(index), low[index], high[index], index, results, requested)
    for i in np.flatnonzero(delicate):
        fill_alone(loops.single(int(i)), int(i), results)
    for group, wanted in ((_OF_GAIN, gain_margins), (_OF_PEAKS, peaks)):
        if not wanted:
            results |= {name: np.full(n, np.nan) for name in group}
    stable = results.pop("stable") == 1
    return BatchMargins(stable=stable, **results)


def fill_alone(loop: DeadTimeLoop, i: int, results: dict[str, Floats]) -> None:
    """Write the margins of `loop`, computed by `DeadTimeLoop`, into element `i` of each array in `results`."""
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
            f"shapes: zeros {z.shape}, poles {p.shape}, gain {k.shape}, dead time {tau.shape} are inconsistent; "
            "give (n, mz), (n, mp), (n,), (n,)"
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
            raise InputError(f"{name}: a complex value has no conjugate partner; give conjugate pairs")
    roots = np.concatenate([z, p], axis=1).T
    sign = np.repeat([1.0, -1.0], [z.shape[1], p.shape[1]])
    return Loops(np.ascontiguousarray(roots.real), np.ascontiguousarray(roots.imag), sign, k, tau)


def _solve(
    loops: Loops, low: Floats, high: Floats, index: Indices, results: dict[str, Floats], requested: tuple[bool, bool]
) -> Flags:
    # the result is True for each loop that `DeadTimeLoop` must compute
    points, bent, delicate = monotone(loops, low, high)
    n = index.size
    at = points.changes(points.size)
    crossovers, falling = located(loops, points, at, lambda found, _: found.size), points.size[at] > 0
    # the root count below is wrong if a node lies on |L| = 1 or |L| >= 1 at the last node
    delicate[points.row[np.abs(points.size) < _ON_LEVEL]] = True
    first = np.flatnonzero(np.diff(points.row, prepend=-1))
    last = np.append(first[1:], points.row.size) - 1
    delicate |= points.size[last] >= 0
    # as in `stability`: the turns of L at the crossovers give the closed-loop poles in the right half plane
    turns = np.round(crossovers.phase / (2 * np.pi))
    distance = np.pi - np.abs(crossovers.phase - 2 * np.pi * turns)
    delicate[crossovers.row[distance <= DELICATE * (1 + np.abs(crossovers.phase))]] = True
    start = np.where(points.size[first] > 0, loops.right(1) + (loops.gain < 0), loops.right(-1))
    unstable = start - 2 * np.bincount(crossovers.row, np.where(falling, turns, -turns), minlength=n)
    stable = unstable == 0
    results["stable"][index], results["unstable_poles"][index] = stable, unstable
    if not stable.any():
        return delicate
    margins = _crossover_margins(crossovers, n)
    if any(requested):
        points, bent = points.inserted(at, crossovers), bent[:, _repeated(bent, at)]  # the bound holds on both parts
        wanted = stable[points.row]
        points, bent = points.take(wanted), bent[:, wanted]
        spans = ranges(points, bent)
    for part in (part for part, wanted in zip((_gain_margins, _peaks), requested, strict=True) if wanted):
        values, doubtful = part(loops, points, bent, spans, n)
        margins |= values
        delicate |= doubtful
    for name, column in margins.items():
        results[name][index[stable]] = column[stable]
    return delicate


def _extreme(values: Floats, rows: Indices, n: int, default: float) -> tuple[Floats, Indices]:
    """Smallest value in each of n loops, and its index; `default` and -1 for a loop without values."""
    order = np.lexsort((values, rows))
    present, position = np.unique(rows[order], return_index=True)
    smallest, number = np.full(n, default), np.full(n, -1)
    number[present] = order[position]
    smallest[present] = values[number[present]]
    return smallest, number


def _where(omega: Floats, number: Indices) -> Floats:
    return np.append(omega, np.nan)[number]


def _crossover_margins(crossovers: Points, n: int) -> dict[str, Floats]:
    angle = np.mod(crossovers.phase + np.pi, 2 * np.pi)
    phase, phase_at = _extreme(np.degrees(np.minimum(angle, 2 * np.pi - angle)), crossovers.row, n, np.inf)
    delay, delay_at = _extreme(angle / crossovers.omega, crossovers.row, n, np.inf)
    return {
        "phase_deg": phase,
        "phase_frequency": _where(crossovers.omega, phase_at),
        "delay_s": delay,
        "delay_frequency": _where(crossovers.omega, delay_at),
    }


def _gain_margins(loops: Loops, points: Points, bent: Floats, spans: Spans, n: int) -> tuple[dict[str, Floats], Flags]:
    off = points.phase - np.pi
    off -= 2 * np.pi * np.round(off / (2 * np.pi))
    delicate = np.zeros(n, dtype=bool)
    delicate[points.row[np.abs(off) < _ON_LEVEL * (1 + np.abs(points.phase))]] = True
    dc = loops.dc_gain()
    # a closed-loop pole that passes through the origin is a gain limit too
    real = (dc < 0) & np.isfinite(dc)
    at_zero = np.where(real, np.log(np.where(real, -dc, 1.0)), np.nan)
    found, limits = {}, []
    for name, side in (("gain_increase", -1.0), ("gain_decrease", 1.0)):
        limit, frequency = _nearest_limit(loops, points, n, side)
        closer = (side * at_zero > 0) & (np.abs(at_zero) < limit)
        limit = np.where(closer, np.abs(at_zero), limit)
        found[name] = np.exp(-side * limit)
        found[f"{name}_frequency"] = np.where(closer, 0.0, frequency)
        delicate |= limit < DELICATE
        limits.append(limit)
    nearest = np.array(limits)

    # intervals that may contain an unknown phase crossover that limits the gain margins
    def may_hide(points: Points, pieces: Points, _: Floats, spans: Spans) -> Indices:
        first, last = levels(pieces)
        turns, rows = (spans[1] - np.pi) / (2 * np.pi), points.row[:-1]
        hidden = (pieces.row[:-1] == pieces.row[1:]) & ((np.ceil(turns[0]) < first) | (np.floor(turns[1]) > last))
        return np.flatnonzero(hidden & ((spans[0][0] > -nearest[0, rows]) & (spans[0][1] < nearest[1, rows])))

    return found, delicate | _undecided(loops, points, bent, may_hide(points, points, bent, spans), may_hide)


def _undecided(
    loops: Loops, points: Points, bent: Floats, left: Indices, test: Callable[[Points, Points, Floats, Spans], Indices]
) -> Flags:
    """Divide the intervals `left` repeatedly; return True for each loop with intervals that `test` always selects."""
    for _ in range(_MOST_ROUNDS):
        if left.size == 0:
            break
        points, pieces, bent = parted(loops, points, bent, left, np.full(left.size, _PARTS))
        left = test(points, pieces, bent, ranges(pieces, bent))
    doubtful = np.zeros(loops.gain.size, dtype=bool)
    doubtful[points.row[left]] = True
    return doubtful


def _nearest_limit(loops: Loops, points: Points, n: int, side: float) -> tuple[Floats, Floats]:
    """For each loop, abs(ln|L|) and frequency, rad/s, of the phase crossover with |L| nearest to 1.

    Only crossovers with |L| > 1 count if `side` is 1, and only those with |L| < 1 if `side` is -1.
    """
    # |L| is monotone and does not cross 1 on an interval: only the crossover nearest to the end with |L| closer to 1
    # matters, and only intervals that can contain it
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


def _peaks(loops: Loops, points: Points, bent: Floats, spans: Spans, n: int) -> tuple[dict[str, Floats], Flags]:
    dc = np.clip(loops.dc_gain(), -1e100, 1e100).astype(complex)  # with an integrator 1e100 gives the limit of |S|, |T|
    peak, omega = np.zeros((3, n)), np.zeros((3, n))
    for loop, end in ((dc, 0.0), (np.zeros_like(dc), np.inf)):
        with np.errstate(divide="ignore", invalid="ignore"):
            values = heights(loop)
        _raise(peak, omega, values, np.arange(n), np.full(n, end))
    _raise(peak, omega, heights(points.loop()), points.row, points.omega)
    (lowest, highest), rows = spans[0], points.row[:-1]
    with np.errstate(divide="ignore"):
        most = -1 / np.expm1(-np.maximum(np.maximum(lowest, -highest), 0))  # bound on |S| and |T| for any phase
    sizes = np.array([most - (lowest > 0), most - (highest < 0), most - 0.5])
    at = np.flatnonzero((rows == points.row[1:]) & (sizes > peak[:, rows]).any(axis=0))
    may_rise = box_bounds(spans[0][:, at], spans[1][:, at] / np.pi) > peak[:, rows[at]] * (1 + _PEAK_GAIN)
    at = at[may_rise.any(axis=0)]
    parts = np.ceil(np.abs(points.phase[at + 1] - points.phase[at]) / _PHASE_STEP).astype(int) + 1
    twisted = np.zeros(n, dtype=bool)
    twisted[points.row[at[parts > _MOST_PARTS]]] = True
    fine, pieces, bent = parted(loops, points, bent, at, np.minimum(parts, _MOST_PARTS))
    values, slopes = fine.responses()
    _raise(peak, omega, values, fine.row, fine.omega)
    spans = ranges(pieces, bent)
    may_rise = bounds(pieces, spans) > peak[:, fine.row[:-1]] * (1 + _PEAK_GAIN)
    kind, at = np.nonzero(may_rise & (slopes[:, :-1] > 0) & (slopes[:, 1:] < 0))
    a, b = np.array(SHAPES)[kind].T

    def rise(found: Points, index: Indices) -> Floats:
        loop = found.loop()
        slope = (b - a)[index] * (found.size_slope + 1j * found.phase_slope)
        return np.asarray((slope * loop / ((1 + loop) * (a[index] + b[index] * loop))).real)

    top = located(loops, fine, at, rise)
    own = np.where(kind == np.arange(3)[:, None], heights(top.loop()), 0.0)
    _raise(peak, omega, own, top.row, top.omega)
    most = peak * (1 + _PEAK_SURE)

    def may_exceed(points: Points, pieces: Points, bent: Floats, spans: Spans) -> Indices:
        boxes = bounds(pieces, spans)
        return np.flatnonzero(exceeding(pieces, bent[0], boxes, heights(points.loop()), most[:, points.row[:-1]]))

    twisted |= _undecided(loops, fine, bent, may_exceed(fine, pieces, bent, spans), may_exceed)
    peak[2] = 1 / peak[2]
    names = ("ms", "mt", "disk")
    found = dict(zip(names, peak, strict=True))
    return found | {f"{name}_frequency": where for name, where in zip(names, omega, strict=True)}, twisted


def _raise(peak: Floats, omega: Floats, values: Floats, rows: Indices, frequencies: Floats) -> None:
    for best, where, value in zip(peak, omega, values, strict=True):
        before = best[rows]
        np.maximum.at(best, rows, np.where(np.isfinite(value), value, 0.0))
        higher = (value > before) & (value == best[rows])
        where[rows[higher]] = frequencies[higher]


# -- points, ordered by loop and frequency -------------------------------------------------------------------------

# Points divide each loop's frequency axis into intervals (in the code: pieces). On an interval ln|L| and the phase are
# monotone as far as their slopes at the nodes show; bounds on their second derivatives hold in any case.


@dataclass(frozen=True)
class Loops:
    """Real and imaginary parts of the m zeros and poles of n loops, (m, n); gains and dead times (s), (n,).

    `sign`, (m,), is 1 for a zero and -1 for a pole.
    """

    real: Floats
    imag: Floats
    sign: Floats
    gain: Floats
    dead_time: Floats

    def take(self, index: Indices) -> Loops:
        return Loops(self.real[:, index], self.imag[:, index], self.sign, self.gain[index], self.dead_time[index])

    def single(self, i: int) -> DeadTimeLoop:
        roots = self.real[:, i] + 1j * self.imag[:, i]
        rational = Rational(roots[self.sign > 0], roots[self.sign < 0], float(self.gain[i]))
        return DeadTimeLoop(rational, float(self.dead_time[i]))

    def right(self, sign: int) -> Floats:
        """Number of zeros (`sign` 1) or poles (`sign` -1) with positive real part, (n,)."""
        return np.asarray((self.real[self.sign == sign] > 0).sum(axis=0), dtype=float)

    def at_origin(self, sign: int) -> Floats:
        """Number of zeros (`sign` 1) or poles (`sign` -1) at s = 0, (n,)."""
        chosen = self.sign == sign
        return np.asarray(((self.real[chosen] == 0) & (self.imag[chosen] == 0)).sum(axis=0), dtype=float)

    def dc_gain(self) -> Floats:
        """L(0), (n,); infinite with an integrator, 0 with a zero at the origin, NaN with both."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            turned = self.gain * np.where((self.real > 0).sum(axis=0) % 2, -1.0, 1.0)
            return np.asarray(turned * np.exp(self.sign @ np.log(np.hypot(self.real, self.imag))))

    def evaluate(self, omega: Floats, row: Indices) -> Points:
        """Evaluate the loops with the indices `row`, (N,), at the frequencies `omega`, rad/s, (N,)."""
        log_gain, turned = np.log(np.abs(self.gain)), np.where(self.gain < 0, np.pi, 0.0)
        values = np.empty((4, omega.size))
        for start in range(0, omega.size, _BLOCK):
            part = slice(start, start + _BLOCK)
            at, one = omega[part], row[part]
            real, tau = self.real[:, one], self.dead_time[one]
            offset = at - self.imag[:, one]
            square = offset * offset + real * real
            angle = np.arctan2(offset, np.abs(real))
            phase = self.sign @ np.where(real > 0, np.pi - angle, angle)
            values[0, part] = log_gain[one] + 0.5 * (self.sign @ np.log(square))
            values[1, part] = self.sign @ (offset / square)
            values[2, part] = turned[one] + phase - tau * at
            values[3, part] = -(self.sign @ (real / square)) - tau
        return Points(row, omega, *values)


@dataclass(frozen=True)
class Points:
    """Points (frequency, ln|L|, phase, both slopes), ordered by loop (index `row`) and frequency; arrays (N,).

    Interval i lies between the points i and i + 1 of one loop.
    """

    row: Indices
    omega: Floats
    size: Floats
    size_slope: Floats
    phase: Floats
    phase_slope: Floats

    def take(self, chosen: Indices | Flags) -> Points:
        return Points(*(one[chosen] for one in self._columns()))

    def inserted(self, at: Indices, others: Points) -> Points:
        size = self.row.size
        order = np.insert(np.arange(size), at + 1, np.arange(size, size + at.size))
        pairs = zip(self._columns(), others._columns(), strict=True)
        return Points(*(np.concatenate(pair)[order] for pair in pairs))

    def _columns(self) -> tuple[Any, ...]:
        return self.row, self.omega, self.size, self.size_slope, self.phase, self.phase_slope

    def changes(self, value: Floats) -> Indices:
        """Indices of the intervals on which `value` changes sign."""
        signs = np.sign(value)
        return np.flatnonzero((signs[:-1] * signs[1:] < 0) & (self.row[:-1] == self.row[1:]))

    def responses(self) -> tuple[Floats, Floats]:
        """Magnitudes |S|, |T| and |S - 1/2|, (3, N), and their logarithmic slopes, (3, N)."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            return responses(self.loop(), self.size_slope + 1j * self.phase_slope)

    def loop(self) -> Complexes:
        return np.asarray(np.exp(np.clip(self.size, -300, 300) + 1j * self.phase))


def band(loops: Loops) -> tuple[Floats, Floats, Flags]:
    """Return the lowest and the highest frequency, rad/s, at which each loop is evaluated, (n,).

    The third array, (n,), is True for each loop that `DeadTimeLoop` must compute.
    """
    real, imag, sign, gain = loops.real, loops.imag, loops.sign, loops.gain
    sizes = np.hypot(real, imag)
    finite = sizes > 0
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        level = np.log(np.abs(gain)) + sign @ np.where(finite, np.log(sizes), 0.0)
        slope = loops.at_origin(-1) - loops.at_origin(1)
        inverse = np.where(finite, 1.0 / (real + 1j * imag), 0.0)
        curvature = 0.5 * (sign @ (inverse * inverse).real)
        # frequencies at which the high- and low-frequency asymptotes of |G| cross 1
        top = np.exp(np.log(np.abs(gain)) / -sign.sum())
        bottom = np.where(slope != 0, np.exp(level / slope), np.sqrt(np.maximum(-level / curvature, 0.0)))
        scales = np.array([*sizes, top, bottom, 1.0 / loops.dead_time])
        scales[~((scales > 0) & np.isfinite(scales))] = np.nan
        low, high = np.fmin.reduce(scales) / _REACH, np.fmax.reduce(scales) * _REACH
        dc = loops.dc_gain()
        delicate = ~((low > 1 / _EXTREME) & (high < _EXTREME) & (high < _WIDEST * low))  # NaN included
        delicate |= (np.abs(real) <= _LEAST_DAMPING * np.abs(imag)).any(axis=0, where=imag != 0)
        delicate |= (loops.at_origin(1) > 0) & (loops.at_origin(-1) > 0)
        delicate |= (gain == 0) | (np.abs(1 - np.abs(dc)) < DELICATE)
    return low, high, delicate


def _nodes(loops: Loops, low: Floats, high: Floats) -> Points:
    begin, end = low * _FAR, high / _FAR
    parts = [
        _spaced(*ends)
        for ends in ((low, begin, _NODES_FAR_OUT), (begin, end, _NODES_PER_DECADE), (end, high, _NODES_FAR_OUT))
    ]
    for real, imag in zip(np.abs(loops.real), loops.imag, strict=True):
        resonant = real < imag
        if resonant.any():
            narrowest = (imag[resonant] / real[resonant]).max()
            fraction = np.linspace(0.0, 1.0, int(_NODES_PER_RESONANCE * np.log10(20 * narrowest)) + 8)
            width = np.where(resonant, 0.05 * real, 1.0)[:, None]
            centre = np.where(resonant, imag, 1.0)[:, None]
            offset = width * (centre / width) ** fraction
            around = np.concatenate([centre - offset[:, :-1], centre + offset], axis=1)
            parts.append(np.where(resonant[:, None], around, low[:, None]))  # repeated nodes are dropped below
    omega = np.sort(np.concatenate(parts, axis=1), axis=1)
    new = np.diff(omega, axis=1, prepend=0.0) > 0
    return loops.evaluate(omega[new], np.nonzero(new)[0])


def _spaced(low: Floats, high: Floats, per_decade: int) -> Floats:
    ratio = (high / low)[:, None]
    return np.asarray(low[:, None] * ratio ** np.linspace(0.0, 1.0, int(per_decade * np.log10(ratio.max())) + 2))


def located(loops: Loops, points: Points, at: Indices, function: Callable[[Points, Indices], Floats]) -> Points:
    """Return points at the zeros of `function`, one zero in each interval with an index in `at`.

    `function(points, i)` returns its values at `points`; point k lies in the interval `at[i[k]]`.
    """
    rows, all_of_them = points.row[at], np.arange(at.size)
    omega = bracketed_roots(
        lambda x, i: function(loops.evaluate(x, rows[i]), i),
        points.omega[at],
        points.omega[at + 1],
        ends=(function(points.take(at), all_of_them), function(points.take(at + 1), all_of_them)),
    )
    return loops.evaluate(omega, rows)


def monotone(loops: Loops, low: Floats, high: Floats) -> tuple[Points, Floats, Flags]:
    """Divide the axis from `low` to `high`, rad/s, at the extrema of ln|L| and the phase.

    Return the points, the `bends` of their intervals, and an array that is True for each loop in which |L| nearly
    touches 1 or a gain crossover may be missed.
    """
    points = _nodes(loops, low, high)
    at = points.changes(points.size_slope)
    extrema = located(loops, points, at, lambda found, _: found.size_slope)
    delicate = np.zeros(loops.gain.size, dtype=bool)
    delicate[extrema.row[np.abs(extrema.size) < DELICATE]] = True
    points = points.inserted(at, extrema)
    at = points.changes(points.phase_slope)
    points = points.inserted(at, located(loops, points, at, lambda found, _: found.phase_slope))
    bent = bends(loops, points)
    pieces = np.flatnonzero(points.row[:-1] == points.row[1:])
    for _ in range(_MOST_HALVINGS):
        pieces = pieces[_may_cross_unseen(points, bent[0], pieces)]
        if pieces.size == 0:
            return points, bent, delicate
        middle = loops.evaluate(0.5 * (points.omega[pieces] + points.omega[pieces + 1]), points.row[pieces])
        points = points.inserted(pieces, middle)
        bent = bent[:, _repeated(bent, pieces)]  # the bound holds on both parts
        pieces = pieces + np.arange(pieces.size)
        pieces = np.sort(np.concatenate([pieces, pieces + 1]))
    delicate[points.row[pieces]] = True
    return points, bent, delicate


def _repeated(bent: Floats, at: Indices) -> Indices:
    return np.insert(np.arange(bent.shape[1]), at, at)


def bends(loops: Loops, points: Points) -> Floats:
    """Upper bounds on |d^2 ln L/d omega^2| and on |d^2 arg L/d omega^2| on each interval, (2, N)."""
    bounds_on_bend = np.empty((2, points.omega.size))
    for start in range(0, points.omega.size, _BLOCK):
        part = slice(start, start + _BLOCK)
        low, one = points.omega[part], points.row[part]
        high = np.maximum(np.append(points.omega[start + 1 : start + _BLOCK + 1], np.inf)[: low.size], low)
        real, imag = loops.real[:, one], loops.imag[:, one]
        near, square = imag - np.clip(imag, low, high), real * real
        far = np.maximum(np.abs(imag - low), np.abs(imag - high))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            each = 1 / (square + near * near)
            bounds_on_bend[0, part] = each.sum(axis=0)
            # the term of each root has the imaginary part 2 real offset/distance^4
            bounds_on_bend[1, part] = (each * np.fmin(2 * np.abs(real) * far * each, 1)).sum(axis=0)
    return bounds_on_bend


def _may_cross_unseen(points: Points, bend: Floats, at: Indices) -> Flags:
    """True for each interval with an index in `at` on which a gain crossover may be missed."""
    # no crossover is missed if ln|L| or its slope has one sign: the end values together exceed the largest change
    low, high = points.omega[at], points.omega[at + 1]
    turn = bend[at] * (high - low)
    slopes, sizes = ([values[at], values[at + 1]] for values in (points.size_slope, points.size))
    steady = (slopes[0] * slopes[1] > 0) & (np.abs(slopes[0]) + np.abs(slopes[1]) > turn)
    steepest = np.maximum(np.abs(slopes[0]), np.abs(slopes[1])) + turn
    apart = (sizes[0] * sizes[1] > 0) & (np.abs(sizes[0]) + np.abs(sizes[1]) > steepest * (high - low))
    return np.asarray(~(steady | apart))


def levels(points: Points) -> tuple[Floats, Floats]:
    """First and last integer k with pi + 2 pi k in the range of arg L on each interval, two arrays (N - 1,).

    The first exceeds the last if the range contains no such value.
    """
    turns = (points.phase - np.pi) / (2 * np.pi)
    lower, upper = np.minimum(turns[:-1], turns[1:]), np.maximum(turns[:-1], turns[1:])
    return np.ceil(lower), np.floor(upper)


def ranges(points: Points, bent: Floats) -> tuple[Floats, Floats]:
    """Lowest and highest ln|L| on each interval, (2, N - 1), and lowest and highest phase, rad, (2, N - 1).

    The entries between the last point of a loop and the first point of the next loop are 0.
    """
    width, same, found = np.diff(points.omega), points.row[:-1] == points.row[1:], []
    for value, slope, bend in ((points.size, points.size_slope, bent[0]), (points.phase, points.phase_slope, bent[1])):
        with np.errstate(invalid="ignore", over="ignore"):
            turn = bend[:-1] * width
            steady = (slope[:-1] * slope[1:] > 0) & (np.abs(slope[:-1]) + np.abs(slope[1:]) > turn)
            # between its end values a function deviates by at most width^2/8 times its second derivative
            over = np.where(steady, 0.0, turn * width / 8)
        ends = np.minimum(value[:-1], value[1:]) - over, np.maximum(value[:-1], value[1:]) + over
        found.append(np.where(same, np.stack(ends), 0.0))
    return found[0], found[1]


def bounds(points: Points, spans: tuple[Floats, Floats]) -> Floats:
    """Upper bounds on |S|, |T| and |S - 1/2| between neighbouring points, (3, N - 1); `ranges` returns `spans`."""
    return np.where(points.row[:-1] == points.row[1:], box_bounds(spans[0], spans[1] / np.pi), 0.0)


def exceeding(points: Points, bend: Floats, boxes: Floats, values: Floats, most: Floats) -> Flags:
    """True for each interval on which |S|, |T| or |S - 1/2| may exceed its limit in `most`, (3, N - 1).

    `boxes`, (3, N - 1), are upper bounds on the intervals, and `values`, (3, N), are the magnitudes at the points.
    """
    open_ones = np.any(boxes > most, axis=0)
    at = np.flatnonzero(open_ones)
    width, (s, t, d), bend = points.omega[at + 1] - points.omega[at], boxes[:, at], bend[at]
    slope = np.hypot(points.size_slope, points.phase_slope)
    steepest = np.maximum(slope[at], slope[at + 1]) + 0.5 * bend * width
    ends = np.maximum(values[:, at], values[:, at + 1])
    # the second derivative of S and of T is S T (l' + l^2 (S - T)), up to sign, with l = d ln L/d omega
    curved = width * width / 8 * s * t * (bend + steepest * steepest * 2 * d)  # |S - T| is 2 |S - 1/2|
    open_ones[at] = ~np.all(ends + curved <= most[:, at], axis=0)
    return np.asarray(open_ones)


def parted(loops: Loops, points: Points, bent: Floats, at: Indices, parts: Indices) -> tuple[Points, Points, Floats]:
    """Divide each interval in `at` into as many equal parts as `parts` states; return their ends twice, and `bends`.

    In the first `Points`, `row` is the index of the loop; in the second, the position of the interval in `at`.
    """
    piece = np.repeat(np.arange(at.size), parts + 1)
    step = (np.arange(piece.size) - np.repeat(np.cumsum(parts + 1) - parts - 1, parts + 1)) / parts[piece]
    low, high = points.omega[at][piece], points.omega[at + 1][piece]
    found = loops.evaluate(low + step * (high - low), points.row[at][piece])
    return found, replace(found, row=piece), bent[:, at[piece]]
