"""Shape a PI for wet rail, and ask what it does on dry rail.

On wet rail the adhesion curve falls half as steeply, so the unstable pole is half as fast and the loop easier to hold.
But the rail may dry at any moment: a PI shaped for wet rail must also be judged on dry, and the other way round.

    python designs/pi_wet.py
"""

from __future__ import annotations

from dataclasses import dataclass

from railslip_ctrl.adhesion import published_law
from railslip_ctrl.assessment import Assessment, assess
from railslip_ctrl.design import (
    HoldingDesign,
    PIController,
    actuated_plant,
    gain_for_crossover,
    holding_gains,
    most_phase,
)
from railslip_ctrl.linearization import LinearPlant, linearize, operating_point
from railslip_ctrl.loop import DeadTimeLoop
from railslip_ctrl.parameters import PARK2008, PIGains, Rail
from railslip_ctrl.report import margins_text

SPEED = 100 / 3.6  # m/s
CORNER = 1 / 25  # integral corner over crossover, as in pi_dry.py


@dataclass(frozen=True)
class WetDesign:
    """The PI shaped on wet rail, on both rails, and the one PI of least worst Ms over both."""

    wet: Assessment
    same_on_dry: Assessment
    holding: HoldingDesign


def plant_on(rail: Rail) -> LinearPlant:
    """The plant at the published reference slip of a rail."""
    law = published_law("bristle", rail)
    return linearize(operating_point(law, PARK2008, SPEED, law.reference_slip(rail), rail=rail))


def run() -> WetDesign:
    """The design, line by line."""
    actuator = PARK2008.actuator
    wet, dry = plant_on(Rail.WET), plant_on(Rail.DRY)
    # 1. The crossover where the wet loop has most phase, and the integral corner below it.
    loop = DeadTimeLoop(actuated_plant(wet, actuator), actuator.dead_time)
    crossover, _phase = most_phase(loop)
    kp = gain_for_crossover(loop, crossover)
    controller = PIController(PIGains(kp=kp, ki=kp * crossover * CORNER))
    # 2. The rail dries: the same controller there.
    # 3. One PI for both, by the least worst Ms.
    return WetDesign(
        wet=assess(wet, controller, actuator),
        same_on_dry=assess(dry, controller, actuator),
        holding=holding_gains([dry, wet], actuator),
    )


def main() -> None:
    """Print the margin reports and the comparison."""
    design = run()
    print(margins_text([design.wet, design.same_on_dry]))
    gains = design.holding.controller.gains
    print(
        f"One PI for both rails: kp {gains.kp:.4g} N*m/(m/s), ki {gains.ki:.3g} N*m/m, "
        f"worst Ms {design.holding.worst_ms:.4g}."
    )


if __name__ == "__main__":
    main()
