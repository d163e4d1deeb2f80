"""Numbers with so many significant digits: the nearest, or on the side that promises less."""

from __future__ import annotations

import math
from collections.abc import Callable

BOUND_DIGITS = 3  #: significant digits of bounds and of worst cases, the same wherever one is said
_EXACT = 1e-12  # a number that has the digits already keeps them


def rounded_up(value: float, digits: int = BOUND_DIGITS) -> float:
    """The least number of so many significant digits that is not below a value."""
    return _rounded(value, digits, lambda scaled: math.ceil(scaled - _EXACT * abs(scaled)))


def rounded_down(value: float, digits: int = BOUND_DIGITS) -> float:
    """The largest number of so many significant digits that is not above a value."""
    return _rounded(value, digits, lambda scaled: math.floor(scaled + _EXACT * abs(scaled)))


def rounded(value: float, digits: int) -> float:
    """A value to so many significant digits, the nearest."""
    return _rounded(value, digits, round)


def _rounded(value: float, digits: int, rounding: Callable[[float], float]) -> float:
    if value == 0 or not math.isfinite(value):
        return value
    places = digits - 1 - math.floor(math.log10(abs(value)))
    return float(rounding(value * 10.0**places)) / 10.0**places
