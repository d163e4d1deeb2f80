"""Do the published PI gains stabilise the loop?

[Park2008] Table 4 prints the gains in "N-h" and "N", which are read as N*m per km/h and N*m per km/h per s. This script
converts them to SI and checks the loop at 100 km/h on dry and wet rail, with the exact dead time of the actuator of
p. 55, in SI and in the as-published reading (M, J and B times 3.6), which reproduces the paper's results.

    python designs/pi_published.py [FOLDER for the pictures]
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import railslip_ctrl as rs
from railslip_ctrl import Rail

SPEED = 100 / 3.6  # m/s
CONTROLLER = rs.PIController(rs.TABLE4_PI["bristle"])  # 650 N*m per km/h and 27 N*m per km/h per s, in SI


@dataclass(frozen=True)
class PublishedCheck:
    """Assessments by rail, in both readings of the units."""

    si: dict[Rail, rs.Assessment]
    as_published: dict[Rail, rs.Assessment]


def check(rail: Rail, inertia_scale: float) -> rs.Assessment:
    """Assess the loop with the published PI on one rail."""
    # 1. The vehicle in this reading, and the adhesion law on this rail.
    vehicle = rs.PARK2008.model_copy(update={"inertia_scale": inertia_scale})
    law = rs.published_law("bristle", rail)
    # 2. The operating point: the published reference slip and its holding torque.
    point = rs.operating_point(law, vehicle, SPEED, law.reference_slip(rail), rail=rail)
    # 3. The linear plant, its loop and the margins.
    return rs.assess(rs.linearize(point), CONTROLLER, vehicle.actuator)


def run() -> PublishedCheck:
    return PublishedCheck(
        si={rail: check(rail, 1.0) for rail in Rail},
        as_published={rail: check(rail, rs.AS_PUBLISHED_INERTIA_SCALE) for rail in Rail},
    )


def main() -> None:
    """Print the margin reports; with a folder, draw Bode, Nyquist and Nichols diagrams."""
    result = run()
    for title, found in (("IN SI", result.si), ("AS PUBLISHED (M, J and B times 3.6)", result.as_published)):
        print(f"{title}\n", *found.values(), sep="\n")
    if len(sys.argv) > 1:
        draw(result, Path(sys.argv[1]))


def draw(result: PublishedCheck, folder: Path) -> None:
    """Draw the Bode, Nyquist and Nichols diagrams of both readings."""
    plots, folder = rs.plots, Path(folder)
    groups = tuple(
        rs.assessment.controller_group(f"Table 4, {name}", tuple(found.values()))
        for name, found in (("SI", result.si), ("as published", result.as_published))
    )
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("bode", "nyquist", "nichols"):
        plots.save_figure(getattr(plots, f"{name}_figure")(groups), folder / f"pi_published_{name}.png")


if __name__ == "__main__":
    main()
