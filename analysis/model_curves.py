"""How do the paper's two adhesion models differ, and are the paper's reference slips at the peaks of these models?

The script reproduces [Park2008] Figs. 13 to 15: mu over slip on dry rail at initial speeds of 30, 60, 100 and 140 km/h,
for the beam model and the bristle model; the latter along a slip ramp and in steady state. The rig's measurements were
only printed as marks in Fig. 13, so that only the arithmetic of Table 3 can be checked.

    python analysis/model_curves.py [FOLDER for the pictures]
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from railslip_ctrl.paper.tables import ModelCurve, Table3, model_curves, table3


@dataclass(frozen=True)
class ModelCurves:
    """Curves of Figs. 13 to 15, and the check of Table 3."""

    curves: tuple[ModelCurve, ...]
    table3: Table3

    def curve(self, law: str, initial_speed_kmh: float) -> ModelCurve:
        """Return the curve of a law and an initial speed, km/h; StopIteration if there is none."""
        return next(c for c in self.curves if (c.law, c.initial_speed_kmh) == (law, initial_speed_kmh))


def run() -> ModelCurves:
    """Return all curves and the check of Table 3."""
    return ModelCurves(model_curves(), table3())


def main(argv: Sequence[str]) -> None:
    """Print the peaks and Table 3; with a folder, draw the figures."""
    result = run()
    for curve in result.curves:
        peak = (
            f"peak {curve.peak.coefficient:.4f} at slip {curve.peak.slip:.4f}"
            if curve.rises
            else f"falls from {curve.peak.coefficient:.4f} at slip 0"
        )
        reference = "" if curve.reference is None else f", published reference {curve.reference:g}"
        print(f"{curve.law:8s} v0 = {curve.initial_speed_kmh:3.0f} km/h: {peak}{reference}")
    three = result.table3
    print(f"Table 3: bristle over beam {three.improvement_percent:.1f} % by the row means {three.beam_mean:.4g} and "
          f"{three.bristle_mean:.4g}. {three.not_reproducible}")  # fmt: skip
    if argv:
        draw(result, Path(argv[0]))


def draw(result: ModelCurves, folder: Path) -> None:
    """Draw Figs. 13 to 15."""
    from railslip_ctrl.report.plots import save_figure
    from railslip_ctrl.report.plots.reproduction import model_figures

    folder.mkdir(parents=True, exist_ok=True)
    for name, figure in model_figures(result.curves).items():
        save_figure(figure, folder / f"{name}.png")


if __name__ == "__main__":
    main(sys.argv[1:])
