"""Many bracketed scalar roots at once.

SciPy's `optimize.elementwise.find_root` is the same method; this one carries no per-call overhead of
milliseconds, which is what one `DeadTimeLoop.margins()` may take in all, and loads no `scipy.optimize`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_HALF_OF_THE_DIGITS = 1e-9
_MOST_STEPS = 100  # bisection alone needs about 60 from a factor-of-two bracket to the last bit


def bracketed_roots(
    function: Callable[[Floats, NDArray[np.intp]], Floats],
    low: Floats,
    high: Floats,
    ends: tuple[Floats, Floats] | None = None,
) -> Floats:
    """Roots of `function` in the brackets [low, high], to the last bits of a double.

    Parameters
    ----------
    function : callable
        f(x, index) with x and index of one shape: the value at x of the function of bracket number index.
    low, high : arrays, shape (n,)
        Ends with f of opposite sign (an end that is zero is its root). Without a change of sign the end of
        smaller size of f is returned.
    ends : two arrays, shape (n,)
        The values of f at them, where they are known already.

    Notes
    -----
    Chandrupatla's method: T. R. Chandrupatla, Advances in Engineering Software 28(3), 1997, pp. 145-149.
    """
    if low.size == 0:
        return low
    index = np.arange(low.size)
    x1, x2 = low.astype(float), high.astype(float)
    f1, f2 = (function(x1, index), function(x2, index)) if ends is None else ends
    root = np.where(np.abs(f1) < np.abs(f2), x1, x2)
    live = np.sign(f1) * np.sign(f2) < 0
    if not live.all():
        x1, x2, f1, f2, index = x1[live], x2[live], f1[live], f2[live], index[live]
    t: Floats | float = 0.5
    for _ in range(_MOST_STEPS):
        if index.size == 0:
            break
        x = x1 + t * (x2 - x1)
        f = function(x, index)
        same = np.sign(f) == np.sign(f1)
        x3, f3 = np.where(same, x1, x2), np.where(same, f1, f2)
        x2, f2 = np.where(same, x2, x1), np.where(same, f2, f1)
        x1, f1 = x, f
        best = np.where(np.abs(f1) < np.abs(f2), x1, x2)
        root[index] = best
        width = np.abs(x2 - x1)
        smallest = 2e-16 * np.abs(best) + 1e-300
        keep = (width > 2 * smallest) & (f != 0)
        least = smallest / np.maximum(width, 1e-300)
        if not keep.all():
            kept = np.flatnonzero(keep)
            x1, x2, x3, f1, f2, f3, least = (q.take(kept) for q in (x1, x2, x3, f1, f2, f3, least))
            index = index.take(kept)
        t = _next_fraction(x1, x2, x3, f1, f2, f3, least)
    return root


def _next_fraction(x1: Floats, x2: Floats, x3: Floats, f1: Floats, f2: Floats, f3: Floats, least: Floats) -> Floats:
    """Where in [x1, x2] to look next: inverse quadratic where it can be trusted, else the middle."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        of12, of13, of32 = f1 - f2, f1 - f3, f3 - f2
        xi, phi = (x1 - x2) / (x3 - x2), of12 / of32
        quadratic = f1 / of12 * f3 / of32 - (x3 - x1) / (x2 - x1) * f1 / of13 * f2 / of32
        trusted = (phi**2 < xi) & ((1 - phi) ** 2 < 1 - xi) & np.isfinite(quadratic)
    edge = np.minimum(least, 0.5)
    return np.asarray(np.minimum(np.maximum(np.where(trusted, quadratic, 0.5), edge), 1 - edge))


def monotone_roots(
    function: Callable[[Floats, NDArray[np.intp]], tuple[Floats, Floats]],
    start: Floats,
    low: Floats,
    high: Floats,
    side: Floats,
) -> Floats:
    """Roots of `function`, one in each [low, high], to rounding, by Newton's method kept inside the bracket.

    Parameters
    ----------
    function : callable
        (f, df/dx) of (x, index), as for `bracketed_roots`.
    start, low, high : arrays, shape (n,)
        First guesses and brackets, >= 0; `low` may be 0 and `high` infinite.
    side : array, shape (n,)
        Sign of f at the lower end.
    """
    root, low, high = start.astype(float), low.astype(float), high.astype(float)
    index = np.arange(root.size)
    x, width = root, np.full(root.size, np.inf)
    for _ in range(_MOST_STEPS):
        if index.size == 0:
            break
        with np.errstate(all="ignore"):
            f, slope = function(x, index)
            below = f * side > 0
            low, high = np.where(below, x, low), np.where(below, high, x)
            new = x - f / slope
            inside = (new > low) & (new < high) & (np.abs(new - x) < 0.5 * width)
            wide = high > 4 * low
            middle = np.where(wide, np.sqrt(np.maximum(low, x / 64) * np.minimum(high, x * 64)), 0.5 * (low + high))
            new = np.where(f == 0, x, np.where(inside, new, middle))
            width = np.abs(new - x)
            # Newton's method doubles the digits, so that half of them before the step are all after it
            done = (f == 0) | (inside & (width <= _HALF_OF_THE_DIGITS * x)) | (high - low <= 4e-16 * x)
        root[index] = new
        left = ~done
        x, index, width = new[left], index[left], width[left]
        low, high, side = low[left], high[left], side[left]
    return root
