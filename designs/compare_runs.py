"""Which controller stops the train best, and how far is it from what could be had?

The published PI and sliding-mode law ([Park2008] Table 4), this project's PI with a lead on the brake's lag, its gain
schedule, and a rule-based slide protection, over the same seeds of the paper's scenario as published (inertia scale
3.6) and in SI. The bound is a clairvoyant's: the highest adhesion at every moment, through the same actuator. The
sliding-mode law is also run with the dry curve kept after the rail has turned wet, as a controller that does not know
the rail would.

    python designs/compare_runs.py [FOLDER for the picture]
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from railslip_ctrl import LinearControl, Scenario, built_in_scenario, compare_runs, slide_protection
from railslip_ctrl.report.document import fixed, heading, render, table
from railslip_ctrl.report.simulation import run_comparison_text
from railslip_ctrl.simulation import ScheduledControl
from railslip_ctrl.simulation.catalogue import (
    margins_over_points,
    published_controller,
    recommended_pi_lead,
    recommended_schedule,
)
from railslip_ctrl.simulation.controllers import Controller
from railslip_ctrl.simulation.run_comparison import RunComparison

SEEDS = range(32)


@dataclass(frozen=True)
class WorstMargins:
    """Worst margins of a linear controller over the vehicle's design points; None where a point is unstable."""

    name: str
    unstable_points: int
    points: int
    ms: float
    gain_increase: float
    phase_deg: float
    delay_s: float


@dataclass(frozen=True)
class Comparison:
    """Both readings, and the margins of the linear designs in each."""

    runs: tuple[RunComparison, RunComparison]
    margins: tuple[tuple[WorstMargins, ...], tuple[WorstMargins, ...]]


def controllers(scenario: Scenario) -> dict[str, Controller]:
    """What is compared, by name."""
    vehicle = scenario.vehicle
    return {
        "PI beam": published_controller("pi", "beam"),
        "PI bristle": published_controller("pi", "bristle"),
        "ASMC beam": published_controller("asmc", "beam"),
        "ASMC bristle": published_controller("asmc", "bristle"),
        "ASMC, rail unknown": published_controller("asmc", "bristle", knows_rail=False),
        "slide protection": slide_protection(vehicle),
        "PI-lead": recommended_pi_lead(vehicle),
        "PI-lead scheduled": recommended_schedule(vehicle),
    }


def worst_margins(scenario: Scenario, chosen: Mapping[str, Controller]) -> tuple[WorstMargins, ...]:
    """Of every linear controller, over rails, loads, speeds and laws."""
    rows = []
    for name, control in chosen.items():
        if not isinstance(control, LinearControl | ScheduledControl):
            continue
        found = margins_over_points(control, scenario.vehicle)
        rows.append(
            WorstMargins(
                name,
                int((~found.stable).sum()),
                found.stable.size,
                float(found.ms.max()),
                float(found.gain_increase.min()),
                float(abs(found.phase_deg).min()),
                float(found.delay_s.min()),
            )
        )
    return tuple(rows)


def run(seeds: range = SEEDS) -> Comparison:
    """Every controller in both readings."""
    scenarios = [built_in_scenario(name) for name in ("park2008", "park2008-si")]
    chosen = [controllers(scenario) for scenario in scenarios]
    published, si = (compare_runs(scenario, each, seeds) for scenario, each in zip(scenarios, chosen, strict=True))
    margins = tuple(worst_margins(scenario, each) for scenario, each in zip(scenarios, chosen, strict=True))
    return Comparison((published, si), (margins[0], margins[1]))


def margins_text(rows: tuple[WorstMargins, ...]) -> str:
    """A table of the worst margins."""
    columns = ("Linear design, worst over the points", "unstable", "Ms", "gain x", "phase deg", "delay s")
    cells = [
        (
            row.name,
            f"{row.unstable_points}/{row.points}",
            *(
                fixed(value, 4) if row.unstable_points == 0 else "-"
                for value in (row.ms, row.gain_increase, row.phase_deg, row.delay_s)
            ),
        )
        for row in rows
    ]
    note = (
        "Over rails, laws, loads and speeds of the designs. The relay of the ASMC and the valve of the slide "
        "protection have no such margins. Gains that are unstable at the reference slip may still stop the train where "
        "the stop is over before the slip gets there."
    )
    return render([heading("Margins, dead time exact", "-"), table(columns, cells, whole=1), note])


def main() -> None:
    """Print a table a reading; with a folder, draw the distances."""
    comparison = run()
    for runs, margins in zip(comparison.runs, comparison.margins, strict=True):
        print(run_comparison_text(runs))
        print(margins_text(margins))
    if len(sys.argv) > 1:
        from railslip_ctrl.report.plots import run_comparison_figure, save_figure

        folder = Path(sys.argv[1])
        folder.mkdir(parents=True, exist_ok=True)
        save_figure(run_comparison_figure(comparison.runs), folder / "compare_runs.png")


if __name__ == "__main__":
    main()
