"""How well do beam and bristle model fit data of a known law, and does the fit recover the polynomials (30)-(32)?

The script reproduces [Park2008] Figs. 12 and 13, Table 3 and (30)-(32) from simulated data, because the rig's records
are not available. A simulated rig with the paper's dynamic bristle model runs the tests of Table 1, and both models are
fitted to its logs.

    python analysis/virtual_rig.py [FOLDER for the pictures]
"""

from __future__ import annotations

import dataclasses
import sys
from dataclasses import dataclass
from pathlib import Path

from railslip_ctrl.core.units import KMH
from railslip_ctrl.identification.curves import Options, curve_of
from railslip_ctrl.identification.identify import Identification, LogSeries, identify_curve
from railslip_ctrl.identification.logs import Rows
from railslip_ctrl.identification.results import over_initial_speed
from railslip_ctrl.identification.virtual_rig import RigTest, published_tests, run_tests
from railslip_ctrl.model.adhesion.bristle import published_coefficients
from railslip_ctrl.model.vehicle import PARK2008

MODELS = ("bristle", "beam")
SPREAD = 0.03  # relative standard deviation of the adhesion from test to test: the spread of the marks in Fig. 13
TORQUE_NOISE = 50.0  # N*m
TESTS = {30: 60, 60: 24, 100: 12, 140: 12}  # number of tests by v0, km/h; at 30 km/h the adhesion hardly falls
# mean absolute errors of Table 3, by model, at the four speeds
PUBLISHED = {"beam": (0.0130, 0.0085, 0.0132, 0.0093), "bristle": (0.0080, 0.0080, 0.0102, 0.0077)}


@dataclass(frozen=True)
class VirtualRig:
    """Signals of one test, and the identifications by model at the four speeds."""

    course: Rows
    tests: tuple[RigTest, ...]
    found: dict[str, tuple[Identification, ...]]
    campaign: LogSeries

    def errors(self, model: str) -> tuple[float, ...]:
        """Return the mean absolute error of mu at each speed, as in Table 3."""
        return tuple(each.chosen.mean_abs_error for each in self.found[model])


def identified(test: RigTest, model: str) -> Identification:
    """Return the fit of a model to the log of a test condition."""
    speed = round(test.initial_speed / KMH)
    rows = run_tests(test, tests=TESTS[speed], seed=speed)
    options = Options(model=model, initial_speed=test.initial_speed)
    return identify_curve(curve_of(rows, test.vehicle, options, name="virtual rig"), test.vehicle, options)


def run() -> VirtualRig:
    """Run the tests and fit both models."""
    tests = tuple(
        dataclasses.replace(test, spread=SPREAD, torque_noise=TORQUE_NOISE) for test in published_tests("bristle")
    )
    found = {model: tuple(identified(test, model) for test in tests) for model in MODELS}
    fits = [each.chosen.fit for each in found["bristle"]]
    polynomials = over_initial_speed([test.initial_speed for test in tests], fits)
    return VirtualRig(run_tests(tests[2], tests=1), tests, found, LogSeries(found["bristle"], polynomials))


def main() -> None:
    """Print a table like Table 3 and the parameters; with a folder, draw the figures."""
    result = run()
    speeds = [test.initial_speed / KMH for test in result.tests]
    print("Mean absolute error of mu for the data of the virtual rig (in brackets: Table 3, data of the real rig)")
    print("  model   " + "".join(f"{speed:>10.0f} km/h" for speed in speeds))
    for model in MODELS:
        pairs = zip(result.errors(model), PUBLISHED[model], strict=True)
        print(f"  {model:8s}" + "".join(f" {ours:.4f} ({theirs:.4f})" for ours, theirs in pairs))
    print("Parameters of the bristle model, fitted (in brackets: (30)-(32)):")
    for speed, each in zip(speeds, result.found["bristle"], strict=True):
        truth = published_coefficients(speed, PARK2008.wheel_load)
        fitted = each.chosen.fit.parameters
        texts = [f"{p.name} {p.value:.4g} ± {p.stderr:.2g} ({t:.4g})" for p, t in zip(fitted, truth, strict=True)]
        print(f"  {speed:3.0f} km/h: " + ", ".join(texts))
    if len(sys.argv) > 1:
        draw(result, Path(sys.argv[1]))


def draw(result: VirtualRig, folder: Path) -> None:
    """Draw Fig. 12, and Fig. 13 with each model."""
    from railslip_ctrl.report.plots import adhesion_figure, coefficients_figure, rig_test_figure, save_figure

    folder.mkdir(parents=True, exist_ok=True)
    title = f"A test on the virtual rig, v0 = {result.tests[2].initial_speed / KMH:.0f} km/h"
    save_figure(
        rig_test_figure(result.course, radius=PARK2008.wheel.radius, title=title), folder / "virtual_rig_course.png"
    )
    both = [
        dataclasses.replace(bristle, lines=(*bristle.lines, *beam.lines), scores=(*bristle.scores, *beam.scores))
        for bristle, beam in zip(result.found["bristle"], result.found["beam"], strict=True)
    ]
    save_figure(adhesion_figure(both), folder / "virtual_rig_adhesion.png")
    printed = ("[Park2008] (30)-(32)", lambda speed: published_coefficients(speed, PARK2008.wheel_load))
    save_figure(coefficients_figure(result.campaign, beside=printed), folder / "virtual_rig_coefficients.png")


if __name__ == "__main__":
    main()
