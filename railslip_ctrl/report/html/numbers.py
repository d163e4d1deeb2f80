"""Numbers and names as the report's tables write them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

from railslip_ctrl.core.rounding import BOUND_DIGITS, rounded, rounded_down, rounded_up
from railslip_ctrl.loop import Margins
from railslip_ctrl.report.layout import fixed, roots_text

MARGIN_HEAD = ("Gain −", "Gain +", "Phase, deg", "Delay, s", "Ms", "Mt")
"""Columns of `margin_cells`."""

NONE = "–"

_LARGE = 1e6  # numbers below it are written out
_POWER = re.compile(r"e([+-]?)0*(\d+)")
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "+")


def short(value: float, digits: int = 4) -> str:
    """A number with so many significant digits and a proper minus sign; powers of ten only where they save zeros."""
    if not math.isfinite(value):
        return "∞" if value > 0 else NONE
    nearest = rounded(value, digits)
    text = f"{nearest:.0f}" if 10**digits <= abs(nearest) < _LARGE else fixed(value, digits)
    return minus(_POWER.sub(lambda found: "·10" + (found[1] + found[2]).translate(_RAISED), text))


def above(value: float, digits: int = BOUND_DIGITS) -> str:
    """A number that is not below `value`, for what must not be less."""
    return short(rounded_up(value, digits), digits)


def below(value: float, digits: int = BOUND_DIGITS) -> str:
    """A number that is not above `value`, for what must not be more."""
    return short(rounded_down(value, digits), digits)


def minus(text: str) -> str:
    """Text of numbers with proper minus signs."""
    return text.replace("-", "−")


def roots(values: Iterable[complex]) -> str:
    """Poles or zeros with their unit, 1/s."""
    text = minus(roots_text(values))
    return text if text == "none" else f"{text} 1/s"


def margin_cells(margins: Margins | None) -> tuple[str, ...]:
    """Gain decrease and increase, phase, delay, Ms, Mt; dashes for an unstable loop."""
    if margins is None:
        return (NONE,) * len(MARGIN_HEAD)
    values = (margins.gain_decrease, margins.gain_increase, margins.phase_deg, margins.delay_s, margins.ms, margins.mt)
    return tuple(short(value) for value in values)


def listed(words: Iterable[str]) -> str:
    """Words with commas and an "and"."""
    found = list(words)
    return found[0] if len(found) == 1 else f"{', '.join(found[:-1])} and {found[-1]}" if found else "none"
