"""Numbers with so many significant digits: the nearest, or on the side that promises less."""

from __future__ import annotations

import math
from collections.abc import Callable

BOUND_DIGITS = 3  #: significant digits of bounds and of worst cases, the same wherever one is said
_EXACT = 1e-12  # a number that has the digits already keeps them
_SAME = 1e-6  # relative: a design tuned to an Ms meets it to less than that
_LARGE = 100.0  # an Ms beyond is as good as unstable


def rounded_up(value: float, digits: int = BOUND_DIGITS) -> float:
    """The least number of so many significant digits that is not below a value."""
    return _rounded(value, digits, lambda scaled: math.ceil(scaled - _EXACT * abs(scaled)))


def rounded_down(value: float, digits: int = BOUND_DIGITS) -> float:
    """The largest number of so many significant digits that is not above a value."""
    return _rounded(value, digits, lambda scaled: math.floor(scaled + _EXACT * abs(scaled)))


def rounded(value: float, digits: int) -> float:
    """A value to so many significant digits, the nearest."""
    return _rounded(value, digits, round)


def ms_up(ms: float) -> str:
    """An Ms as it is said everywhere: two decimals, not below it; three digits from 100 up."""
    return f"{math.ceil(100 * ms * (1 - _SAME)) / 100:.2f}" if ms < _LARGE else f"{rounded_up(ms):g}"


def ms_down(bound: float) -> str:
    """A lower bound of Ms, likewise not above it."""
    return f"{math.floor(100 * bound * (1 + _SAME)) / 100:.2f}" if bound < _LARGE else f"{rounded_down(bound):g}"


def _rounded(value: float, digits: int, rounding: Callable[[float], float]) -> float:
    if value == 0 or not math.isfinite(value):
        return value
    places = digits - 1 - math.floor(math.log10(abs(value)))
    return float(rounding(value * 10.0**places)) / 10.0**places
