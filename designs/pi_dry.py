"""How large can the margins of a PI be on dry rail, and with which gains?

At 100 km/h and the published reference slip the dry-rail plant has an unstable pole near 0.8 1/s. The actuator in
series has a lag of 0.6 s and a dead time of 0.15 s. The crossover is placed where the phase of the loop is largest. The
corner frequency ki/kp of the PI lies far below, where the integral costs little phase.

    python designs/pi_dry.py [FOLDER for the picture]
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import railslip_ctrl as rs

SPEED = 100 / 3.6  # m/s
CORNER = 1 / 25  # corner frequency ki/kp over the crossover: 1/25 costs atan(1/25) = 2.3 deg of phase


@dataclass(frozen=True)
class DryDesign:
    """Results of the steps of `run`, in their order."""

    proportional_range: tuple[float, float]  # kp that stabilises the loop with ki = 0, N*m/(m/s)
    crossover: float  # rad/s
    shaped: rs.Assessment
    rounded: rs.Assessment  # rounded gains: kp 190, ki 5


def run() -> DryDesign:
    """Design the PI step by step."""
    # 1. The plant at the reference slip, at constant speed, in series with the actuator's lag.
    law = rs.published_law("bristle", rs.Rail.DRY)
    point = rs.operating_point(law, rs.PARK2008, SPEED, law.reference_slip(rs.Rail.DRY), rail=rs.Rail.DRY)
    plant = rs.linearize(point)
    actuator = rs.PARK2008.actuator
    loop = rs.DeadTimeLoop(rs.actuated_plant(plant, actuator), actuator.dead_time)

    # 2. The range of stabilising kp: the unstable pole sets the smallest gain, the dead time the largest.
    proportional_range = loop.stabilizing_gain_range
    assert proportional_range is not None

    # 3. The crossover is where the phase of the loop is largest: there a P controller has its largest phase margin.
    crossover, _phase = rs.most_phase(loop)
    kp = rs.gain_for_crossover(loop, crossover)

    # 4. The corner frequency ki/kp is well below the crossover.
    ki = kp * crossover * CORNER

    # 5. Check this loop, and the loop with rounded gains.
    return DryDesign(
        proportional_range=proportional_range,
        crossover=crossover,
        shaped=rs.assess(plant, rs.PIController(rs.PIGains(kp=kp, ki=ki)), actuator),
        rounded=rs.assess(plant, rs.PIController(rs.PIGains(kp=190.0, ki=5.0)), actuator),
    )


def main() -> None:
    """Print the design and its margin reports; with a folder, draw the Nyquist diagrams."""
    design = run()
    low, high = design.proportional_range
    print(f"P control stabilises the loop for kp between {low:.4g} and {high:.4g} N*m/(m/s).")
    print(f"The loop has its largest phase at {design.crossover:.4g} rad/s, chosen as crossover.\n")
    print(design.shaped, design.rounded, sep="\n\n")
    if len(sys.argv) > 1:
        folder = Path(sys.argv[1])
        folder.mkdir(parents=True, exist_ok=True)
        found = (("PI shaped for dry rail", design.shaped), ("round gains", design.rounded))
        groups = tuple(rs.assessment.controller_group(title, (one,)) for title, one in found)
        rs.plots.save_figure(rs.plots.nyquist_figure(groups), folder / "pi_dry_nyquist.png")


if __name__ == "__main__":
    main()
