"""Which controller has the shortest stop, and how far is it from the bound?

The script compares the published PI and sliding-mode law ([Park2008] Table 4), this project's PI-lead, a gain schedule
of the PI-lead, and a rule-based slide protection. A variant of the sliding-mode law uses the adhesion curve of dry rail
also on wet rail. All run the paper's scenario with the same seeds, as published (inertia scale 3.6) and in SI. The
bound assumes the highest adhesion at every moment, within the limits of the actuator.

    python designs/compare_runs.py [FOLDER for the picture]
"""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import railslip_ctrl as rs
from railslip_ctrl import catalogue, plots

SEEDS = range(32)


@dataclass(frozen=True)
class WorstMargins:
    """Worst margins of a linear controller over the operating points of a vehicle; valid if no point is unstable."""

    name: str
    unstable_points: int
    points: int
    ms: float
    gain_increase: float
    phase_deg: float
    delay_s: float


@dataclass(frozen=True)
class Comparison:
    """Runs and margins of the linear designs, each as published and in SI."""

    runs: tuple[rs.RunComparison, rs.RunComparison]
    margins: tuple[tuple[WorstMargins, ...], tuple[WorstMargins, ...]]


def controllers(scenario: rs.Scenario) -> dict[str, Any]:
    """Return the compared controllers by name."""
    vehicle = scenario.vehicle
    return {
        "PI beam": catalogue.published_controller("pi", "beam"),
        "PI bristle": catalogue.published_controller("pi", "bristle"),
        "ASMC beam": catalogue.published_controller("asmc", "beam"),
        "ASMC bristle": catalogue.published_controller("asmc", "bristle"),
        "ASMC, rail unknown": catalogue.published_controller("asmc", "bristle", knows_rail=False),
        "slide protection": rs.SlideProtection.for_vehicle(vehicle),
        "PI-lead": catalogue.recommended_pi_lead(vehicle),
        "PI-lead scheduled": catalogue.recommended_schedule(vehicle),
    }


def worst_margins(scenario: rs.Scenario, chosen: Mapping[str, Any]) -> tuple[WorstMargins, ...]:
    """Return the worst margins of every linear controller, over rails, loads, speeds and laws."""
    rows = []
    for name, control in chosen.items():
        if not isinstance(control, rs.PI | rs.Scheduled):
            continue
        found = catalogue.margins_over_points(control, scenario.vehicle)
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
    """Compare every controller, as published and in SI."""
    scenarios = [rs.built_in_scenario(name) for name in ("park2008", "park2008-si")]
    chosen = [controllers(scenario) for scenario in scenarios]
    published, si = (rs.compare_runs(scenario, each, seeds) for scenario, each in zip(scenarios, chosen, strict=True))
    margins = tuple(worst_margins(scenario, each) for scenario, each in zip(scenarios, chosen, strict=True))
    return Comparison((published, si), (margins[0], margins[1]))


def margins_text(rows: tuple[WorstMargins, ...]) -> str:
    """Return a table of the worst margins, with a note."""
    lines = [
        "Margins, dead time exact, worst case over rails, laws, loads and speeds",
        f"{'':20s} {'unstable':>8s} {'Ms':>7s} {'gain x':>7s} {'phase, deg':>10s} {'delay, s':>8s}",
    ]
    for row in rows:
        lines.append(f"{row.name:20s} {f'{row.unstable_points}/{row.points}':>8s}")
        if row.unstable_points == 0:
            lines[-1] += f" {row.ms:7.4g} {row.gain_increase:7.4g} {row.phase_deg:10.4g} {row.delay_s:8.4g}"
    note = (
        "The ASMC and the slide protection are nonlinear and have no margins. Gains that are unstable at the reference "
        "slip may still stop the train, if the stop ends before the slip reaches the reference."
    )
    return "\n".join([*lines, *textwrap.wrap(note, 110), ""])


def main() -> None:
    """Print one table for each reading; with a folder, draw the distances."""
    comparison = run()
    for runs, margins in zip(comparison.runs, comparison.margins, strict=True):
        print(runs, margins_text(margins), sep="\n")
    if len(sys.argv) > 1:
        folder = Path(sys.argv[1])
        folder.mkdir(parents=True, exist_ok=True)
        plots.save_figure(plots.run_comparison_figure(comparison.runs), folder / "compare_runs.png")


if __name__ == "__main__":
    main()
