"""Many plants under one controller: their margins together, and which is worst."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from railslip_ctrl.loop import DeadTimeLoop
from railslip_ctrl.loop.batch import BatchMargins, batch_margins, stack


@dataclass(frozen=True)
class Worst:
    """The worst of each margin over a family of stable loops, and the member (index) it belongs to."""

    ms: float
    ms_member: int
    phase_deg: float
    phase_member: int
    delay_s: float
    delay_member: int


def family_margins(loops: Sequence[DeadTimeLoop], *, gain_margins: bool = True, peaks: bool = True) -> BatchMargins:
    """Margins of loops of any structures, in their order; NaN where a loop is unstable.

    Without `gain_margins` or `peaks` (Ms, Mt, disk margin) those are NaN, and the rest takes less time.

    Loops with as many zeros as poles go through the scalar engine, one by one.
    """
    found: dict[str, np.ndarray] = {f.name: np.full(len(loops), np.nan) for f in fields(BatchMargins)}
    groups: dict[tuple[int, int], list[int]] = {}
    for i, loop in enumerate(loops):
        groups.setdefault((loop.system.zeros.size, loop.system.poles.size), []).append(i)
    for (zeros, poles), members in groups.items():
        if zeros < poles:
            stacked = stack([loops[i].system for i in members], [loops[i].dead_time for i in members])
            part = batch_margins(*stacked, gain_margins=gain_margins, peaks=peaks)
            for name in found:
                found[name][members] = getattr(part, name)
        else:
            for i in members:
                _scalar(loops[i], i, found)
    stable = found.pop("stable") == 1
    return BatchMargins(stable=stable, **found)


def _scalar(loop: DeadTimeLoop, i: int, found: dict[str, np.ndarray]) -> None:
    found["stable"][i] = loop.is_stable()
    found["unstable_poles"][i] = loop.unstable_closed_loop_poles
    if loop.is_stable():
        margins = loop.margins()
        for name in found.keys() - {"stable", "unstable_poles"}:
            found[name][i] = getattr(margins, name)


def worst_of(margins: BatchMargins) -> Worst | None:
    """The worst of each margin; None if any loop is unstable."""
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
