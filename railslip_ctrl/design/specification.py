"""What a design must keep at every plant."""

from __future__ import annotations

import math
from dataclasses import dataclass

from railslip_ctrl.core.arguments import check_fields
from railslip_ctrl.core.errors import InputError

ROBUST_MS = 2.0
"""Largest Ms called robust: at 2 the gain may double or halve and the phase may change by 29 deg ([Astrom2021] 13)."""

_ROUNDING = 1e-6  # relative: a design tuned to the limit meets it to less than that


def is_robust(ms: float) -> bool:
    """Whether a loop of that Ms is called robust: at most `ROBUST_MS`, rounding aside."""
    return ms <= ROBUST_MS * (1.0 + _ROUNDING)


@dataclass(frozen=True)
class Specification:
    """What a design must keep at every plant; None is not asked for.

    Parameters
    ----------
    ms_max : float
        Largest Ms, a ratio, > 1.
    phase_min_deg : float
        Least phase margin, deg, 0 to 180.
    delay_min_s : float
        Least delay margin, s, >= 0.
    crossover : tuple of float
        Lowest and highest gain crossover, rad/s, that of the phase margin.

    Raises
    ------
    InputError
        A value of another kind or out of its range.
    """

    ms_max: float | None = None
    phase_min_deg: float | None = None
    delay_min_s: float | None = None
    crossover: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        if self.ms_max is not None and not (math.isfinite(self.ms_max) and self.ms_max > 1):
            raise InputError(f"ms_max: {self.ms_max} is not allowed; give a finite value > 1")
        for name, value in (("phase_min_deg", self.phase_min_deg), ("delay_min_s", self.delay_min_s)):
            if value is not None and not (math.isfinite(value) and value >= 0):
                raise InputError(f"{name}: {value} is not allowed; give a finite value >= 0")
        if self.phase_min_deg is not None and self.phase_min_deg >= 180:
            raise InputError(f"phase_min_deg: {self.phase_min_deg:g} is not allowed; give a value < 180")
        if self.crossover is not None and not (len(self.crossover) == 2 and 0 <= self.crossover[0] < self.crossover[1]):
            raise InputError(f"crossover: {self.crossover} is not allowed; give (lowest, highest) in rad/s")

    @property
    def only_ms(self) -> bool:
        """Whether nothing but Ms is asked for."""
        return self.phase_min_deg is None and self.delay_min_s is None and self.crossover is None

    @property
    def words(self) -> str:
        """What is asked for, in words; empty if nothing is."""
        parts = []
        if self.ms_max is not None:
            parts.append(f"Ms <= {self.ms_max:g}")
        if self.phase_min_deg is not None:
            parts.append(f"phase margin >= {self.phase_min_deg:g} deg")
        if self.delay_min_s is not None:
            parts.append(f"delay margin >= {self.delay_min_s:g} s")
        if self.crossover is not None:
            parts.append(f"crossover in {self.crossover[0]:g} to {self.crossover[1]:g} rad/s")
        return ", ".join(parts)
