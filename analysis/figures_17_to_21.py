"""How do the slip, the torque and the speed develop in the published runs?

The script reproduces [Park2008] Figs. 17 to 21: adhesion on dry and wet rail, then speeds, brake torques and slip
ratios of the four controllers of Table 5, each in one run with the same noise.

    python analysis/figures_17_to_21.py [FOLDER for the pictures]
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from railslip_ctrl.paper.tables import ModelCurve, published_runs, wet_and_dry
from railslip_ctrl.simulation import Run

SEED = 0
SWITCH = 25.0  # s, time at which the rail turns wet and the mass rises
SETTLED = 10.0  # s, time after which the slip has settled on dry rail


@dataclass(frozen=True)
class Figures:
    """Curves of Fig. 17, and runs of Figs. 18 to 21 by the column of Table 5."""

    adhesion: tuple[ModelCurve, ...]
    runs: dict[str, Run]

    def highest_slip_after_switch(self, column: str) -> float:
        """Highest slip ratio after the rail has turned wet."""
        signals = self.runs[column].signals
        return float(signals.slip[signals.time >= SWITCH].max())

    def mean_error_on_dry(self, column: str) -> float:
        """Mean of slip minus reference slip from 10 s until the rail turns wet: the steady-state error."""
        signals = self.runs[column].signals
        part = (signals.time > SETTLED) & (signals.time < SWITCH)
        return float(np.mean(signals.slip[part] - signals.reference[part]))


def run() -> Figures:
    """Return the curves and the runs."""
    return Figures(wet_and_dry(), published_runs(seed=SEED))


def main(argv: Sequence[str]) -> None:
    """Print the main numbers of the figures; with a folder, draw the figures."""
    result = run()
    for curve in result.adhesion:
        print(f"Fig. 17, {curve.law} {curve.rail}: peak {curve.peak.coefficient:.3f} at slip {curve.peak.slip:.3f}, "
              f"published reference {curve.reference:g}")  # fmt: skip
    for name, trial in result.runs.items():
        print(
            f"Figs. 18-21, {name}: {trial.braking_time:.1f} s, {trial.braking_distance:.0f} m, highest torque "
            f"{trial.max_torque / 1e3:.2f} kN m, mean slip error {result.mean_error_on_dry(name):+.3f} on dry rail, "
            f"highest slip {result.highest_slip_after_switch(name):.2f} after the rail turns wet"
        )
    if argv:
        draw(result, Path(argv[0]))


def draw(result: Figures, folder: Path) -> None:
    """Draw Figs. 17 to 21."""
    from railslip_ctrl.report.plots import save_figure
    from railslip_ctrl.report.plots.reproduction import run_figures, wet_and_dry_figure

    folder.mkdir(parents=True, exist_ok=True)
    figures = {"fig_17": wet_and_dry_figure(result.adhesion)} | run_figures(result.runs)
    for name, figure in figures.items():
        save_figure(figure, folder / f"{name}.png")


if __name__ == "__main__":
    main(sys.argv[1:])
