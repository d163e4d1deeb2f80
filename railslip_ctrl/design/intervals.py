"""Sets of a gain as ascending open intervals, and which intervals between critical gains are stable."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from railslip_ctrl.loop.stability import RootCount

from .decomposition import CriticalGains

Interval = tuple[float, float]
Intervals = tuple[Interval, ...]

_SAME = 1e-12  # relative width below which two boundaries are one: what rounding leaves of them


def stable_intervals(
    critical: CriticalGains, scale: float, count: Callable[[float], RootCount], *, signed: bool
) -> Intervals:
    """The intervals between critical gains in which the root count is 0; over all reals, or over those > 0.

    Only boundaries marked leftward can lower the count, each by at most 2, all others raise it: with n unstable poles
    the next interval worth a count lies beyond (n + 1)//2 of the former, and from a stable one beyond the next.
    """
    limit = critical.complete_to
    edges = [-limit if signed else 0.0, *critical.values.tolist(), limit]
    leftward = np.flatnonzero(critical.leftward) + 1  # as indices into edges: interval i starts at edge i
    found: list[Interval] = []
    i = 0
    while i < len(edges) - 1:
        low, high = edges[i], edges[i + 1]
        if math.isfinite(high - low) and high - low <= _SAME * max(abs(low), abs(high)):
            i += 1
            continue
        inside = count(probe(low, high, scale))
        if inside.stable:
            # poles that touch the axis and return, or a boundary that was rounding: stable on both sides
            if found and found[-1][1] == low and count(low).stable:
                low = found.pop()[0]
            found.append((low, high))
        unknown = inside.marginal or not math.isfinite(inside.right)
        needed = 0 if unknown else max(1, (int(inside.right) + 1) // 2)
        ahead = leftward[leftward > i]
        if needed > ahead.size:
            break
        i = int(ahead[needed - 1]) if needed else i + 1
    return tuple(found)


def probe(low: float, high: float, scale: float) -> float:
    """A gain between two others, either of which may be infinite."""
    if math.isinf(low) and math.isinf(high):
        return scale
    if math.isinf(low):
        return high - max(abs(high), scale)
    if math.isinf(high):
        return low + max(abs(low), scale)
    return 0.5 * (low + high)


def probes_between(edges: Sequence[float], scale: float) -> list[float]:
    """A gain inside each interval between ascending edges."""
    return [probe(low, high, scale) for low, high in pairwise(edges) if high > low]


def common_intervals(families: Sequence[Intervals]) -> Intervals:
    """Intersection of sets given as ascending open intervals."""
    common = families[0]
    for other in families[1:]:
        pairs = [(max(a, c), min(b, d)) for a, b in common for c, d in other]
        common = tuple(sorted((low, high) for low, high in pairs if low < high))
    return common
