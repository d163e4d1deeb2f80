"""For how long do the Lyapunov conditions of the sliding-mode law hold along a stop, with and without the actuator?

The conditions are [Park2008] (40), (42) and (46), with the gains of Table 4's bristle column in the paper's scenario,
as published and in SI. The law runs without adaptation (k = 0, as in Table 5) and with the printed k. Without actuator
and noise the conditions hold. The actuator prevents sliding, and the noise violates (40). With the actuator and the
printed adaptation the stop is more than three times as long.

    python analysis/lyapunov_along_runs.py [FOLDER for the pictures]
"""

from __future__ import annotations

import sys
from dataclasses import asdict, replace
from pathlib import Path

from railslip_ctrl.controllers.sliding import Sliding
from railslip_ctrl.model.adhesion import ReferenceSlip
from railslip_ctrl.report.verification import lyapunov_runs_text
from railslip_ctrl.simulation import published_scenario
from railslip_ctrl.sliding.law import PUBLISHED_LAW
from railslip_ctrl.verification.lyapunov_runs import LyapunovRun, judge_run

REFERENCE = ReferenceSlip(dry=0.132, wet=0.092)
SEED = 2008
LAWS = {"k = 0": replace(PUBLISHED_LAW, k1=0.0, k2=0.0), "printed k": PUBLISHED_LAW}


def run(*, as_published: bool) -> dict[tuple[str, bool, bool], LyapunovRun]:
    """Return the runs by (law, with actuator, with noise)."""
    scenario = published_scenario(as_published=as_published)
    return {
        (name, actuator, noise): judge_run(
            scenario, Sliding(**asdict(gains), reference=REFERENCE), actuator=actuator, seed=SEED if noise else None
        )
        for name, gains in LAWS.items()
        for actuator in (False, True)
        for noise in (False, True)
    }


def label(case: tuple[str, bool, bool]) -> str:
    name, actuator, noise = case
    return f"{name}, {'actuator' if actuator else 'ideal'}{', noise' if noise else ''}"


def main() -> None:
    """Print the conditions as published and in SI; with a folder, draw s and the estimates."""
    for as_published in (True, False):
        cases = run(as_published=as_published)
        reading = "as published (inertia scale 3.6)" if as_published else "SI"
        print(f"{reading}\n")
        print(lyapunov_runs_text([(label(case), judged) for case, judged in cases.items()]))
        if len(sys.argv) > 1:
            from railslip_ctrl.report.plots import adaptation_figure, lyapunov_runs_figure, save_figure

            folder = Path(sys.argv[1])
            folder.mkdir(parents=True, exist_ok=True)
            suffix = "as_published" if as_published else "si"
            by_law = {law: [(label(case), judged) for case, judged in cases.items() if case[0] == law] for law in LAWS}
            figure = lyapunov_runs_figure(by_law["k = 0"], f"Sliding variable and (40) along a stop, {reading}")
            save_figure(figure, folder / f"lyapunov_along_runs_{suffix}.png")
            figure = adaptation_figure(by_law["printed k"], f"V (46) and the estimates along a stop, {reading}")
            save_figure(figure, folder / f"adaptation_along_runs_{suffix}.png")


if __name__ == "__main__":
    main()
