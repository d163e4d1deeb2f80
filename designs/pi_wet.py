"""Is a PI that is shaped for wet rail good on dry rail?

On wet rail the adhesion curve falls half as steeply. Therefore the unstable pole is half as fast and the loop is easier
to stabilise. Because the rail may dry at any moment, a PI shaped for wet rail must also be judged on dry rail.

    python designs/pi_wet.py [FOLDER for the picture]
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import railslip_ctrl as rs

SPEED = 100 / 3.6  # m/s
CORNER = 1 / 25  # corner frequency ki/kp over the crossover, as in pi_dry.py


@dataclass(frozen=True)
class WetDesign:
    """The PI shaped for wet rail, assessed on both rails, and the PI with the smallest worst Ms on both."""

    wet: rs.Assessment
    same_on_dry: rs.Assessment
    common: rs.CommonPI


def plant_on(rail: rs.Rail) -> rs.LinearPlant:
    """Return the plant at the published reference slip of a rail."""
    law = rs.published_law("bristle", rail)
    return rs.linearize(rs.operating_point(law, rs.PARK2008, SPEED, law.reference_slip(rail), rail=rail))


def run() -> WetDesign:
    """Design the PI step by step."""
    actuator = rs.PARK2008.actuator
    wet, dry = plant_on(rs.Rail.WET), plant_on(rs.Rail.DRY)
    # 1. The crossover where the phase of the wet loop is largest, and ki/kp well below it.
    loop = rs.DeadTimeLoop(rs.actuated_plant(wet, actuator), actuator.dead_time)
    crossover, _phase = rs.most_phase(loop)
    kp = rs.gain_for_crossover(loop, crossover)
    controller = rs.PIController(rs.PIGains(kp=kp, ki=kp * crossover * CORNER))
    # 2. The rail dries: the same controller on dry rail.
    # 3. One PI for both rails, with the smallest worst Ms.
    return WetDesign(
        wet=rs.assess(wet, controller, actuator),
        same_on_dry=rs.assess(dry, controller, actuator),
        common=rs.common_pi([dry, wet], actuator),
    )


def main() -> None:
    """Print the margin reports and the comparison; with a folder, draw the Nyquist diagrams."""
    design = run()
    print(design.wet, design.same_on_dry, sep="\n\n")
    gains = design.common.controller.gains
    print(
        f"One PI for both rails: kp {gains.kp:.4g} N*m/(m/s), ki {gains.ki:.3g} N*m/m, "
        f"worst Ms {design.common.worst_ms:.4g}."
    )
    if len(sys.argv) > 1:
        folder = Path(sys.argv[1])
        folder.mkdir(parents=True, exist_ok=True)
        groups = (rs.assessment.controller_group("PI shaped for wet rail", (design.wet, design.same_on_dry)),)
        rs.plots.save_figure(rs.plots.nyquist_figure(groups), folder / "pi_wet_nyquist.png")


if __name__ == "__main__":
    main()
