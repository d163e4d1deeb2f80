"""How do the published PI, the published ASMC and this project's PI-lead behave on other vehicles and rails?

In each run the mass varies by +-20 %, the adhesion with a standard deviation of 15 %, and dead time and lag of the
brake within wide tolerances. All controllers get the same vehicles, rails and noise. The scenario is that of [Park2008]
as published. Results, which the tests check with few runs:

- On every vehicle the PI-lead has a shorter braking distance than the published PI and the published ASMC, and its
  median slip error is much smaller. The ASMC has a shorter distance than the PI, but not a smaller slip error.
- If the adhesion is a third lower than the curve that the ASMC assumes, the ASMC has the longest distance, or does not
  stop in time.
- The published PI never locks the wheel. The two faster controllers lock it in about a tenth of the runs, always within
  two seconds after the rail turns wet. These vehicles are slow at that time (light, or with high adhesion), so that the
  brake's dead time is long compared with the time in which the wheel locks.

    python analysis/monte_carlo.py [FOLDER for runs, report and pictures; a campaign in it is resumed] [RUNS]
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from railslip_ctrl.design.catalogue import controller_named
from railslip_ctrl.simulation import built_in_scenario
from railslip_ctrl.simulation.campaign import (
    Campaign,
    CampaignSummary,
    Normal,
    Quantity,
    Triangular,
    Uniform,
    execute,
    summarise,
)

RUNS = 1000
CONTROLLERS = ("pi", "asmc", "pi-lead")
QUANTITIES = (
    Quantity(("vehicle.mass", "vehicle.mass_loaded", "events.0.mass"), Uniform(0.8, 1.2), relative=True),
    Quantity(("adhesion_factor",), Normal(1.0, 0.15, 0.6, 1.4)),
    Quantity(("vehicle.actuator.dead_time",), Triangular(0.10, 0.15, 0.25)),
    Quantity(("vehicle.actuator.lag",), Triangular(0.45, 0.6, 0.8)),
)


def campaign(runs: int = RUNS) -> Campaign:
    """Return the campaign."""
    scenario = built_in_scenario("park2008")
    controllers = tuple(controller_named(name, scenario.vehicle) for name in CONTROLLERS)
    return Campaign(scenario, controllers, runs, QUANTITIES, seed=2008)


def run(folder: Path, *, runs: int = RUNS, workers: int | None = None) -> CampaignSummary:
    """Run all runs that are missing in the folder, and return the statistics of all runs."""
    return summarise(execute(campaign(runs), folder, workers=workers))


def main() -> None:
    """Print the report; with a folder, store the runs and draw the pictures."""
    from railslip_ctrl.report.campaign import campaign_text

    runs = int(sys.argv[2]) if len(sys.argv) > 2 else RUNS
    if len(sys.argv) > 1:
        result = run(Path(sys.argv[1]), runs=runs)
        draw(result, Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as folder:
            result = run(Path(folder) / "runs", runs=runs)
    print(campaign_text(result), end="")


def draw(result: CampaignSummary, folder: Path) -> None:
    """Draw the distributions, and the braking distance over the varied quantities."""
    from railslip_ctrl.report.plots import save_figure
    from railslip_ctrl.report.plots.runs import distributions_figure, scatter_figure

    for name, figure in (("distributions", distributions_figure(result)), ("scatter", scatter_figure(result))):
        assert figure is not None, "quantities are varied, and runs stop"
        save_figure(figure, folder / f"monte_carlo_{name}.png")


if __name__ == "__main__":
    main()
