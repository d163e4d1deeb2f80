"""The best single PI for twelve operating points, and what it cannot do.

Dry and wet rail, 20, 60 and 100 km/h, 3517 and 5276 kg, bristle model, v0 = 100 km/h, the published actuator. Which PI
with ki >= 5 N*m/m has the least worst Ms? How far is it from what the plant allows, and does it survive the actuator's
tolerance and the adhesion peak?

    python designs/pi_robust.py [FOLDER for the pictures]
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from railslip_ctrl.design import (
    IntersectionRegion,
    MarginGrid,
    PIController,
    Strip,
    actuated_plant,
    intersection,
    margin_grid,
    outline,
    stabilizing_pi,
)
from railslip_ctrl.design.envelope import Envelope
from railslip_ctrl.design.judging import Judgement, judge
from railslip_ctrl.design.schedule import plant_at
from railslip_ctrl.design.tuning import PIDesign, tune_pi
from railslip_ctrl.linearization import LinearPlant
from railslip_ctrl.parameters import PARK2008, PIGains, Rail

SPEEDS_KMH = (20.0, 60.0, 100.0)
MASSES = (3517.0, 5276.0)  # kg, empty and loaded
KI_MIN = 5.0  # N*m/m: without a least ki the integral action vanishes
ACTUATOR = PARK2008.actuator


@dataclass(frozen=True)
class RobustPI:
    """The design, its region, and the verdict over the envelope, on the bristle model and on two laws."""

    design: PIDesign
    least_without_integral: float
    region: IntersectionRegion
    strips: tuple[Strip, ...]
    grid: MarginGrid
    bristle: Judgement
    all_laws: Judgement


def twelve_plants() -> list[LinearPlant]:
    """The operating points, in the order rail, speed, mass."""
    return [
        plant_at("bristle", PARK2008.model_copy(update={"mass": mass}), rail, speed)
        for rail in Rail
        for speed in SPEEDS_KMH
        for mass in MASSES
    ]


def run() -> RobustPI:
    """Stabilising set, optimum, worst case."""
    plants = [actuated_plant(plant, ACTUATOR) for plant in twelve_plants()]
    # 1. Every PI that stabilises all twelve: the intersection of the exact sets.
    region = intersection([stabilizing_pi(plant, dead_time=ACTUATOR.dead_time) for plant in plants])
    assert region.kp_range is not None
    low, high = region.kp_range
    # 2. The least worst Ms, at ki = 5 and as ki vanishes.
    design = tune_pi(plants, ACTUATOR.dead_time, minimise_ms=True, ki_min=KI_MIN)
    limit = tune_pi(plants, ACTUATOR.dead_time, minimise_ms=True, ki_min=1e-6)
    # 3. What happens to it over slip, actuator tolerance and speed.
    controller = PIController(PIGains(kp=design.kp, ki=design.ki))
    return RobustPI(
        design=design,
        least_without_integral=limit.worst.ms,
        region=region,
        strips=outline(region),
        grid=margin_grid(region, np.linspace(low, high, 60), np.linspace(0, region.ki_limit(design.kp) * 1.5, 50)),
        bristle=judge(controller, Envelope(laws="bristle")),
        all_laws=judge(controller, Envelope()),
    )


def main() -> None:
    """Print the design; with a folder, draw the region."""
    result = run()
    assert result.region.kp_range is not None
    low, high = result.region.kp_range
    print(f"PI stabilises all twelve points for kp in ({low:.4g}, {high:.4g}) N*m/(m/s).")
    print(f"Least worst Ms with ki >= {KI_MIN:g}: {result.design.worst.ms:.4g} at kp = {result.design.kp:.4g};")
    print(f"as ki vanishes {result.least_without_integral:.4g}: a PI alone is fragile at its best.")
    for name, judged in (("bristle model", result.bristle), ("bristle model and curve", result.all_laws)):
        print(f"Over the envelope, {name}: {100 * judged.stable.mean():.1f} % of the loops stable")
        print(judged)
    if len(sys.argv) > 1:
        draw(result, Path(sys.argv[1]))


def draw(result: RobustPI, folder: Path) -> None:
    """The stabilising region with contours and the chosen point."""
    from railslip_ctrl.plots import region_figure, save_figure

    folder.mkdir(parents=True, exist_ok=True)
    chosen = {f"least worst Ms ({result.design.worst.ms:.3g})": (result.design.kp, result.design.ki)}
    figure = region_figure(
        result.strips, result.grid, chosen, title="PI that stabilises twelve operating points, bristle"
    )
    save_figure(figure, folder / "pi_robust_region.png")


if __name__ == "__main__":
    main()
