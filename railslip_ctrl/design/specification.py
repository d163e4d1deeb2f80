"""Specification of a design, and the margins of many plants with one controller."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from railslip_ctrl.core.arguments import check_fields, number
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.loop import DeadTimeLoop
from railslip_ctrl.loop.batch import BatchMargins, batch_margins, fill_alone, stack

ROBUST_MS = 2.0
"""Largest Ms of a robust loop: with Ms = 2, gain factors of 2/3 to 2, or 29 deg, are tolerated ([Astrom2021] 13)."""

_ROUNDING = 1e-6  # relative tolerance for a design that was tuned to the limit


def is_robust(ms: float) -> bool:
    """Return True if `ms` is at most `ROBUST_MS`, with a tolerance for rounding."""
    return ms <= ROBUST_MS * (1.0 + _ROUNDING)


@dataclass(frozen=True)
class Specification:
    """Requirements that a design must meet with every plant; None means no requirement.

    - ms_max: largest Ms, a ratio, > 1.
    - phase_min_deg: smallest phase margin, deg, 0 to 180.
    - delay_min_s: smallest delay margin, s, >= 0.
    - crossover: lowest and highest frequency, rad/s, of the gain crossover that has the smallest phase margin.

    InputError: a value of wrong type or out of its range.
    """

    ms_max: float | None = None
    phase_min_deg: float | None = None
    delay_min_s: float | None = None
    crossover: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        if self.ms_max is not None:
            number("ms_max", self.ms_max, gt=1)
        if self.phase_min_deg is not None:
            number("phase_min_deg", self.phase_min_deg, "deg", ge=0, lt=180)
        if self.delay_min_s is not None:
            number("delay_min_s", self.delay_min_s, "s", ge=0)
        if self.crossover is not None and not (len(self.crossover) == 2 and 0 <= self.crossover[0] < self.crossover[1]):
            raise InputError(f"crossover: {self.crossover} is not allowed; give (lowest, highest) in rad/s")

    @property
    def only_ms(self) -> bool:
        """True if Ms is the only limited quantity, or if nothing is limited."""
        return self.phase_min_deg is None and self.delay_min_s is None and self.crossover is None

    @property
    def description(self) -> str:
        """Requirements as text; empty without requirements."""
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


@dataclass(frozen=True)
class Worst:
    """Worst value of each margin over several stable loops, and the index of the loop with this value."""

    ms: float
    ms_member: int
    phase_deg: float
    phase_member: int
    delay_s: float
    delay_member: int


def family_margins(loops: Sequence[DeadTimeLoop], *, gain_margins: bool = True, peaks: bool = True) -> BatchMargins:
    """Return the margins of `loops`, in the same order; NaN for an unstable loop.

    Gain margins are NaN if `gain_margins` is false. Ms, Mt and disk margin are NaN if `peaks` is false.
    """
    columns: dict[str, np.ndarray] = {f.name: np.full(len(loops), np.nan) for f in fields(BatchMargins)}
    groups: dict[tuple[int, int], list[int]] = {}
    for i, loop in enumerate(loops):
        groups.setdefault((loop.system.zeros.size, loop.system.poles.size), []).append(i)
    for (zeros, poles), members in groups.items():
        if zeros < poles:
            stacked = stack([loops[i].system for i in members], [loops[i].dead_time for i in members])
            part = batch_margins(*stacked, gain_margins=gain_margins, peaks=peaks)
            for name in columns:
                columns[name][members] = getattr(part, name)
        else:  # `batch_margins` is only for strictly proper loops
            for i in members:
                fill_alone(loops[i], i, columns)
    stable = columns.pop("stable") == 1
    return BatchMargins(stable=stable, **columns)


def worst_of(margins: BatchMargins) -> Worst | None:
    """Return the worst value of each margin; None if any loop is unstable."""
    if not margins.stable.all():
        return None
    ms, phase, delay = (int(f) for f in (margins.ms.argmax(), margins.phase_deg.argmin(), margins.delay_s.argmin()))
    return Worst(
        ms=float(margins.ms[ms]),
        ms_member=ms,
        phase_deg=float(margins.phase_deg[phase]),
        phase_member=phase,
        delay_s=float(margins.delay_s[delay]),
        delay_member=delay,
    )
