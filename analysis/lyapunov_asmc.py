"""Which of the stability claims of the adaptive sliding-mode law hold, in SI and as published?

The claims are [Park2008] (40)-(49), with the gains of Table 4's bristle column. The script checks the conditions
without the actuator, in SI and with the units as published (`railslip verify` also checks those with the actuator). It
computes V along a stop of a loaded vehicle that the law assumes to be empty, without actuator, without and with the
published disturbances. V' <= 0 is proved only without disturbances. When s has reached 0, V stays constant, because
theta_hat need not converge. If the stop takes longer than 25 s, the published mass step changes theta, and V jumps: up
if theta_hat was correct, otherwise up or down.

    python analysis/lyapunov_asmc.py [FOLDER for the picture]
"""

from __future__ import annotations

import sys
import textwrap
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from railslip_ctrl.model.vehicle import AS_PUBLISHED_INERTIA_SCALE, PARK2008, Vehicle
from railslip_ctrl.report.verification import evidence
from railslip_ctrl.sliding.law import PUBLISHED_LAW
from railslip_ctrl.verification.fixed_step import IdealRun, simulate_ideal
from railslip_ctrl.verification.joint_verification import verify
from railslip_ctrl.verification.published_law import STEP_TIME
from railslip_ctrl.verification.verdict import Verification

DURATION = 80.0  # s, longer than either stop
SEED = 2008


@dataclass(frozen=True)
class LyapunovCheck:
    """Verification and runs without actuator, in SI or as published.

    `ideal` and `disturbed` are stops of the loaded vehicle, without and with the published disturbances. In `stepped`
    the vehicle is empty, as the law assumes, and loaded from 25 s on, without disturbances; None if the stop ends
    before.
    """

    verification: Verification
    ideal: IdealRun
    disturbed: IdealRun
    stepped: IdealRun | None

    def largest_rise(self, run: IdealRun) -> float:
        """Largest rise of V above an earlier value, relative to V(0)."""
        V = run.V[np.isfinite(run.V[:, 0]), 0]
        return float(np.max(V - np.minimum.accumulate(V)) / V[0])

    def plateau(self) -> float:
        """V at the end of the undisturbed run, m^2/s^2, due to the remaining error of theta_hat."""
        return float(self.ideal.V[np.isfinite(self.ideal.V[:, 0]), 0][-1])

    def jump(self) -> float:
        """Step of V at 25 s in `stepped`, m^2/s^2; NaN if `stepped` is None."""
        if self.stepped is None:
            return float("nan")
        i = int(np.searchsorted(self.stepped.time, STEP_TIME - 1e-9))
        return float(self.stepped.V[i, 0] - self.stepped.V[i - 1, 0])


def check(vehicle: Vehicle) -> LyapunovCheck:
    """Return the verification and the runs of a vehicle, whose inertia scale is 1 or as published."""
    ideal, with_disturbances = (
        simulate_ideal(
            vehicle.loaded(), PUBLISHED_LAW, nominal=vehicle, duration=DURATION, disturbed=disturbed, seeds=(SEED,)
        )
        for disturbed in (False, True)
    )
    stepped = None
    if ideal.time[-1] > STEP_TIME:  # the loaded stop is the longer one
        stepped = simulate_ideal(vehicle, PUBLISHED_LAW, duration=DURATION, change=(STEP_TIME, vehicle.loaded()))
    return LyapunovCheck(verify(vehicle=vehicle, seed=SEED, actuator=False), ideal, with_disturbances, stepped)


def run() -> tuple[LyapunovCheck, LyapunovCheck]:
    """Return the checks in SI and as published."""
    published = PARK2008.model_copy(update={"inertia_scale": AS_PUBLISHED_INERTIA_SCALE})
    return check(PARK2008), check(published)


def main() -> None:
    """Print the conditions that fail; with a folder, draw V along the runs."""
    si, published = run()
    print(failures(si.verification, published.verification))
    for name, result in (("SI", si), ("as published", published)):
        text = (
            f"V along an ideal stop, {name}: largest rise {result.largest_rise(result.ideal):.1e} V(0) undisturbed, "
            f"{result.largest_rise(result.disturbed):.2g} V(0) with the published disturbances; {step_text(result)}; "
            f"without disturbances V ends at {result.plateau():.3g} m^2/s^2, because theta_hat does not reach theta"
        )
        print(textwrap.fill(text, 110, subsequent_indent="  ", break_on_hyphens=False))
    if len(sys.argv) > 1:
        draw(si, published, Path(sys.argv[1]))


def failures(si: Verification, published: Verification) -> str:
    """Return the conditions that fail without the actuator in SI, and how the conditions as published differ."""
    lines = [
        f"Without the actuator {len(si.failing)} of {len(si.conditions)} conditions do not hold in SI",
        "(railslip verify also checks the conditions with the actuator):",
    ]
    for each in si.failing:
        lines += [f"  {each.name}", textwrap.fill(evidence(each), 110, initial_indent="    ", subsequent_indent="    ")]
    other = ", ".join(sorted({each.name for each in si.failing} ^ {each.name for each in published.failing}))
    lines.append(f"As published (M, J and B times 3.6) the {f'differences are: {other}' if other else 'same fail.'}")
    return "\n".join(lines)


def step_text(result: LyapunovCheck) -> str:
    """Return a text about V at the mass step."""
    if result.stepped is None:
        return f"the stop is over before the mass steps at {STEP_TIME:g} s"
    theta1, k1 = result.stepped.theta[0], PUBLISHED_LAW.k1
    return (
        f"at the mass step at {STEP_TIME:g} s V jumps by {result.jump():+.4f} m^2/s^2 (by {theta1**2 / (2 * k1):+.4f} "
        "if theta_hat = theta before the step)"
    )


def draw(si: LyapunovCheck, published: LyapunovCheck, folder: Path) -> None:
    """Draw V over time, in SI and as published."""
    from railslip_ctrl.report.plots import save_figure
    from railslip_ctrl.report.plots.style import (
        PAGE_WIDTH,
        SMALL,
        TEXT,
        folded,
        legend_below,
        line_style,
        new_figure,
        panels,
    )

    figure = new_figure(4.2, "V of (46) along stops of the ASMC of [Park2008], with its adaptation")
    loaded, empty = PARK2008.mass_loaded, PARK2008.mass
    readings = (("SI", si), ("as published", published))
    for axes, (name, result) in zip(panels(figure, 1, 2, sharey=True)[0], readings, strict=True):
        lines = [
            (f"{loaded:g} kg, undisturbed", result.ideal),
            (f"{loaded:g} kg, published disturbances", result.disturbed),
        ]
        if result.stepped is not None:
            lines.append((f"{empty:g} kg, {loaded:g} kg from {STEP_TIME:g} s on, undisturbed", result.stepped))
        for i, (label, ideal) in enumerate(lines):
            axes.semilogy(ideal.time, ideal.V[:, 0], label=label, **line_style(i))
        axes.axhline(result.plateau(), color="0.4", linewidth=0.8, linestyle=":")
        axes.annotate(
            folded("final value without disturbances: s = 0, theta_hat is not theta", 0.35 * PAGE_WIDTH, SMALL),
            (0.02, result.plateau()),
            xycoords=("axes fraction", "data"),
            xytext=(0, 3),
            textcoords="offset points",
            fontsize=SMALL,
        )
        axes.set_xlabel("time (s)")
        axes.set_title(f"{name}\nno actuator, law's mass {empty:g} kg, theta_hat from 0", fontsize=TEXT)
        axes.label_outer()
        legend_below(axes, 0.15)
        if name == "SI":
            axes.set_ylabel("V ((m/s)²)")
    folder.mkdir(parents=True, exist_ok=True)
    save_figure(figure, folder / "lyapunov_asmc.png")


if __name__ == "__main__":
    main()
