"""Which of the stability claims of the adaptive sliding-mode law hold, in SI and as published?

[Park2008] (40)-(49) with Table 4's gains, bristle column: the conditions of `railslip verify` in both readings of the
units, and V along an ideal stop (no actuator, theta unknown: a loaded vehicle taken for empty) without and with the
published disturbances. V' <= 0 is a theorem of the first and not of the second.

    python analysis/lyapunov_asmc.py [FOLDER for the picture]
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from railslip_ctrl.parameters import AS_PUBLISHED_INERTIA_SCALE, PARK2008, Vehicle
from railslip_ctrl.report.verification import verification_text
from railslip_ctrl.sliding.conditions import Verification, verify
from railslip_ctrl.sliding.gains import PUBLISHED_LAW
from railslip_ctrl.sliding.ideal_loop import PUBLISHED, UNDISTURBED, IdealRun, simulate

DURATION = 80.0  # s, longer than either stop
SEED = 2008


@dataclass(frozen=True)
class LyapunovCheck:
    """Verifications and runs in one reading: `ideal` without, `disturbed` with the published disturbances."""

    verification: Verification
    ideal: IdealRun
    disturbed: IdealRun

    def largest_rise(self, run: IdealRun) -> float:
        """Largest rise of V above an earlier value, relative to V(0)."""
        V = run.V[np.isfinite(run.V[:, 0]), 0]
        return float(np.max(V - np.minimum.accumulate(V)) / V[0])


def check(vehicle: Vehicle) -> LyapunovCheck:
    """One reading."""
    runs = [
        simulate(
            vehicle.loaded(), PUBLISHED_LAW, nominal=vehicle, duration=DURATION, disturbances=acting, seeds=(SEED,)
        )
        for acting in (UNDISTURBED, PUBLISHED)
    ]
    return LyapunovCheck(verify(vehicle=vehicle, seed=SEED), *runs)


def run() -> tuple[LyapunovCheck, LyapunovCheck]:
    """SI and as published."""
    published = PARK2008.model_copy(update={"inertia_scale": AS_PUBLISHED_INERTIA_SCALE})
    return check(PARK2008), check(published)


def main() -> None:
    """Print the SI report and what differs as published; with a folder, draw V along the runs."""
    si, published = run()
    print(verification_text(si.verification))
    print("As published (M, J and B times 3.6)")
    for one in published.verification.failing:
        print(f"  does not hold: {one.name}: {one.evidence}")
    for name, result in (("SI", si), ("as published", published)):
        print(
            f"V along an ideal stop, {name}: largest rise {result.largest_rise(result.ideal):.1e} V(0) undisturbed, "
            f"{result.largest_rise(result.disturbed):.2g} V(0) with the published disturbances"
        )
    if len(sys.argv) > 1:
        draw(si, published, Path(sys.argv[1]))


def draw(si: LyapunovCheck, published: LyapunovCheck, folder: Path) -> None:
    """V over time, both readings."""
    from matplotlib.figure import Figure

    from railslip_ctrl.plots import save_figure
    from railslip_ctrl.plots.style import line_style

    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    for axes, (name, result) in zip(figure.subplots(1, 2), (("SI", si), ("as published", published)), strict=True):
        for label, one in (("undisturbed", result.ideal), ("published disturbances", result.disturbed)):
            axes.semilogy(one.time, one.V[:, 0], label=label, **line_style(0 if label == "undisturbed" else 1))
        axes.set(title=name, xlabel="time, s", ylabel="V, m²/s²")
        axes.legend()
    folder.mkdir(parents=True, exist_ok=True)
    save_figure(figure, folder / "lyapunov_asmc.png")


if __name__ == "__main__":
    main()
