"""Text of controllers compared over braking runs."""

from __future__ import annotations

from rich.console import RenderableType
from rich.text import Text

from railslip_ctrl.simulation.run_comparison import ControllerRow, RunComparison

from .layout import fixed, heading, render, table

COLUMNS = (
    *("Controller", "Dist. m", "± m", "over bound %", "Time s", "Slip error", "error [P]"),
    *("Max slip", "Locked s", "Energy MJ", "Rate kN·m/s"),
)


def run_comparison_text(comparison: RunComparison) -> str:
    """One table: a row a controller, means over the seeds, the standard error of the distance beside it."""
    scenario, bound = comparison.scenario, comparison.bound
    parts: list[RenderableType] = [
        heading(f"Braking runs: {scenario.name}, inertia scale {scenario.vehicle.inertia_scale:g}"),
        Text(
            f"Means over {len(comparison.seeds)} seeds, the same noise for all. No controller can stop in less than "
            f"{bound.braking_distance:.1f} m and {bound.braking_time:.2f} s: the highest adhesion at every moment, "
            "after the dead time. Slip error: mean of |slip - the controller's own reference|; error [P]: against the "
            "0.132/0.092 of [Park2008]; rate: rms of the acting torque's."
        ),
        table(COLUMNS, [run_row(row, bound.braking_distance) for row in comparison.rows], whole=1),
    ]
    parts += [Text(line) for line in _failures(comparison)]
    return render(parts)


def run_row(row: ControllerRow, bound: float) -> tuple[str, ...]:
    """The cells of `COLUMNS`."""
    return (
        row.name,
        f"{row.braking_distance.value:.1f}",
        fixed(row.braking_distance.error, 2),
        fixed(100 * row.beyond_bound.value / bound, 3),
        fixed(row.braking_time.value, 4),
        fixed(row.slip_error.value, 3),
        fixed(row.slip_error_published.value, 3),
        fixed(row.max_slip.value, 3),
        f"{row.lock_time.value:.2f}",
        fixed(row.brake_energy.value / 1e6, 4),
        fixed(row.rms_torque_rate.value / 1e3, 3),
    )


def _failures(comparison: RunComparison) -> list[str]:
    return [
        f"{row.name}: {count} of {row.runs} runs {outcome}."
        for row in comparison.rows
        for outcome, count in row.outcomes.items()
        if row.stopped < row.runs and outcome != "stopped"
    ]
