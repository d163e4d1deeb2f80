"""How do the published PI, the published ASMC and this project's PI-lead behave when nothing is quite as printed?

Mass +-20 %, adhesion with a standard deviation of 15 %, dead time and lag of the brake within wide tolerances, drawn
anew for every run; every controller gets the same vehicles, rails and noise. The scenario is [Park2008]'s in the
as-published reading. Answers, of few runs asserted in the tests:

- the PI-lead stops shorter than the published PI and the published ASMC on every vehicle, and in the median holds the
  slip far better; the ASMC beats the PI in distance and not in slip error;
- where adhesion is a third less than its curve says, the ASMC is the longest of the three, or does not stop in time;
- the published PI never locks the wheel. The two quicker ones do, in about a tenth of the runs, and always within two
  seconds of the moment at which the rail turns wet: on vehicles that are slow by then (light, or with much adhesion),
  where the brake's dead time is long against the time the wheel takes to lock.

    python analysis/monte_carlo.py [FOLDER for runs, report and pictures; resumed if it holds some] [RUNS]
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
    """The question as a campaign."""
    scenario = built_in_scenario("park2008")
    controllers = tuple(controller_named(name, scenario.vehicle) for name in CONTROLLERS)
    return Campaign(scenario, controllers, runs, QUANTITIES, seed=2008)


def run(folder: Path, *, runs: int = RUNS, workers: int | None = None) -> CampaignSummary:
    """Every run that the folder lacks, then the statistics of all."""
    return summarise(execute(campaign(runs), folder, workers=workers))


def main() -> None:
    """Print the report; with a folder, keep the runs and draw."""
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
    """Distributions, and the braking distance over what was varied."""
    from railslip_ctrl.report.plots import save_figure
    from railslip_ctrl.report.plots.runs import distributions_figure, scatter_figure

    for name, figure in (("distributions", distributions_figure(result)), ("scatter", scatter_figure(result))):
        assert figure is not None, "quantities are varied, and runs stop"
        save_figure(figure, folder / f"monte_carlo_{name}.png")


if __name__ == "__main__":
    main()
