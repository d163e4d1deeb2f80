"""Which single PI has the smallest worst Ms at twelve operating points, and where does it fail?

The points are dry and wet rail at 20, 60 and 100 km/h with 3517 and 5276 kg, for the bristle model with v0 = 100 km/h
and the published actuator; ki is at least 5 N*m/m. The script compares the PI with the limits of the plant, and checks
it with the tolerances of the actuator and beyond the adhesion peak.

    python designs/pi_robust.py [FOLDER for the pictures]
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import railslip_ctrl as rs

KI_MIN = 5.0  # N*m/m: without a lower bound the optimum has no integral action
ENVELOPE = rs.Envelope(laws="bristle", speeds=(20, 60, 100))  # published vehicle; a load changes only its mass
DEAD_TIME = ENVELOPE.vehicle.actuator.dead_time  # s


@dataclass(frozen=True)
class RobustPI:
    """The design, its stabilising region, and the verdict on the bristle model and on two laws."""

    design: Any  # result of `tune_pi`
    least_without_integral: float
    region: rs.IntersectionRegion
    bristle: rs.Judgement
    all_laws: rs.Judgement


def run() -> RobustPI:
    """Compute the stabilising set, the optimum and the worst case."""
    points = ENVELOPE.points(nominal=True)
    plants = [rs.actuated_plant(plant, ENVELOPE.vehicle.actuator) for plant in points.plants]
    # 1. Every PI that stabilises all twelve points: the intersection of the exact sets.
    region = rs.intersection([rs.stabilizing_pi(plant, dead_time=DEAD_TIME) for plant in plants])
    # 2. The smallest worst Ms, for ki >= 5 N*m/m and for a vanishing ki.
    design = rs.tune_pi(plants, DEAD_TIME, minimise_ms=True, ki_min=KI_MIN)
    limit = rs.tune_pi(plants, DEAD_TIME, minimise_ms=True, ki_min=1e-6)
    # 3. The verdict over slip, actuator tolerance and speed, also with another adhesion law.
    controller = rs.PIController(rs.PIGains(kp=design.kp, ki=design.ki))
    return RobustPI(
        design=design,
        least_without_integral=limit.worst.ms,
        region=region,
        bristle=rs.judge(rs.Envelope(laws="bristle"), controller),
        all_laws=rs.judge(rs.Envelope(), controller),
    )


def main() -> None:
    """Print the design; with a folder, draw the region."""
    result = run()
    assert result.region.kp_range is not None
    low, high = result.region.kp_range
    print(f"PI stabilises all twelve points for kp in ({low:.4g}, {high:.4g}) N*m/(m/s).")
    print(f"Smallest worst Ms with ki >= {KI_MIN:g}: {result.design.worst.ms:.4g} at kp = {result.design.kp:.4g};")
    print(f"with ki near 0: {result.least_without_integral:.4g}. Even the best PI is fragile.")
    for name, judged in (("bristle model", result.bristle), ("bristle model and curve", result.all_laws)):
        print(f"Over the envelope, {name}: {100 * judged.stable.mean():.1f} % of the loops stable")
        print(judged)
    if len(sys.argv) > 1:
        draw(result, Path(sys.argv[1]))


def draw(result: RobustPI, folder: Path) -> None:
    """Draw the stabilising region with contours and the chosen point."""
    folder.mkdir(parents=True, exist_ok=True)
    chosen = {f"smallest worst Ms ({result.design.worst.ms:.3g})": (result.design.kp, result.design.ki)}
    result.region.plot(chosen).savefig(folder / "pi_robust_region.png")


if __name__ == "__main__":
    main()
