"""Text of runs judged by the Lyapunov conditions."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from railslip_ctrl.verification.lyapunov_runs import LyapunovRun

from .document import heading, render, table


def lyapunov_runs_text(cases: Sequence[tuple[str, LyapunovRun]]) -> str:
    """One table of the shares of time and first violations, one of the ultimate bounds; a row a case."""
    names = [condition.name for condition in cases[0][1].conditions]
    shares = table(("Share of the time each holds", *names), [(name, *_shares(run)) for name, run in cases])
    first = table(("First violation, s", *names), [(name, *_first(run)) for name, run in cases])
    columns = ("Last third of each stage", "outcome", "time s", "largest |s| m/s", "largest slip error", "locked %")
    return render(
        [
            heading("Lyapunov conditions along braking runs"),
            shares,
            first,
            table(columns, [_bounds(name, run) for name, run in cases], left=2),
        ]
    )


def _shares(run: LyapunovRun) -> Iterable[str]:
    # rounded down: what does not hold all the time never reads 100 %
    return (f"{math.floor(1000 * condition.share) / 10:.1f} %" for condition in run.conditions)


def _first(run: LyapunovRun) -> Iterable[str]:
    return ("never" if condition.holds else f"{condition.first_violation:.3f}" for condition in run.conditions)


def _bounds(name: str, run: LyapunovRun) -> tuple[str, ...]:
    return (
        name,
        str(run.run.outcome),
        f"{run.run.braking_time:.1f}",
        ", ".join(f"{bound.s:.2f}" for bound in run.ultimate),
        ", ".join(f"{bound.slip_error:.3f}" for bound in run.ultimate),
        f"{100 * run.run.locked_fraction:.1f}",
    )
