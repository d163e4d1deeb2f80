"""Which braking distance does one stop in a billion exceed, and do three methods agree on it?

The published vehicle and a coach stop on wet rail from 100 km/h with the seeking controller. Mass, adhesion, brake gain
and dead time vary, and a random force acts. Subset simulation estimates the probabilities of all distances, importance
sampling those of the longest, and a plain campaign those of the shorter ones. Results of one seed:

- The published vehicle exceeds 368 m with a probability of 3e-10; the nominal stop takes 256 m.
- Importance sampling and subset simulation agree with a plain campaign where it has failing stops.
- Adhesion contributes nine tenths, mass one tenth, the brake and the random force almost nothing.

    python analysis/rare_events.py [STOPS of the plain campaign, default 2000] [POINTS of a level, default 1000]
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

import railslip_ctrl as rs
from railslip_ctrl.simulation.campaign import Campaign, LogNormal, Normal, Quantity, RareEvent, Uniform, execute
from railslip_ctrl.simulation.campaign.statistics import Estimate, share

ROOT = Path(__file__).parents[1]
CUT = 7.0
"""Standard deviations at which a distribution is cut off; the probability beyond is 1e-12, far below 1e-9."""

LONG = {"published": 366.0, "coach": 370.0}
"""Distance, m, that about one stop of a billion exceeds."""

STEP = 5e-3
"""Step of the integration, s; the relative difference of the distance from that with 1 ms is at most 3e-5."""


@dataclass(frozen=True)
class Found:
    """Rare event of a vehicle, computing time (s), and for each distance (m) its probability by two methods."""

    event: RareEvent
    seconds: float
    plain: tuple[tuple[float, Estimate, Estimate], ...]


def varied(vehicle: rs.Vehicle) -> Campaign:
    """Return the campaign of stops of a vehicle with the seeking controller."""
    scenario = rs.stop(vehicle, "wet").with_changes(step=STEP, longest_time=120.0)

    def about(path: str, std: float) -> Quantity:
        return Quantity((path,), Normal(1.0, std, 1.0 - CUT * std, 1.0 + CUT * std), relative=True)

    quantities = (
        about("vehicle.mass", 0.02),
        Quantity(("adhesion_factor",), LogNormal(1.0, 0.06, float(np.exp(-CUT * 0.06)), float(np.exp(CUT * 0.06)))),
        about("limits.torque_gain", 0.05),
        Quantity(("vehicle.actuator.dead_time",), Uniform(0.8, 1.2), relative=True),
    )
    return Campaign(scenario, (rs.Seeking.for_vehicle(vehicle),), 1, quantities, seed=1)


def run(stops: int = 2000, points: int = 1000, workers: int = 2) -> dict[str, Found]:
    """Return the results of both vehicles, by name."""
    vehicles = {"published": rs.PARK2008, "coach": rs.load_vehicle(ROOT / "designs" / "vehicles" / "coach.toml")}
    found = {}
    for name, vehicle in vehicles.items():
        campaign, begun = varied(vehicle), time.perf_counter()
        event = rs.rare_event(campaign, f"distance > {LONG[name]} m", workers=workers, points=points)
        seconds = time.perf_counter() - begun
        found[name] = Found(event, seconds, tuple(compared(campaign, event, stops, workers)))
    return found


def compared(campaign: Campaign, event: RareEvent, stops: int, workers: int) -> list[tuple[float, Estimate, Estimate]]:
    """Return each level that ten or more of the plain stops exceed, with its probability by both methods."""
    with tempfile.TemporaryDirectory() as folder:
        execute(replace(campaign, runs=stops), Path(folder) / "runs", workers=workers)
        distances = pd.read_parquet(Path(folder) / "runs" / "parts")["braking_distance_m"].fillna(np.inf).to_numpy()
    tail, rows = event.tail, []
    for level in event.levels:
        count = int(np.sum(distances >= level))
        value, low, high = (float(np.interp(level, tail.x, column)) for column in (tail.value, tail.low, tail.high))
        if count >= 10:
            rows.append((level, share(count, stops), Estimate(value, low, high)))
    return rows


def main() -> None:
    """Print the results of both vehicles."""
    arguments = [int(argument) for argument in sys.argv[1:]]
    for name, found in run(*arguments).items():
        event = found.event
        print(f"{name}: {event}, {found.seconds:.0f} s")
        for method, one in (("subset simulation", event.subset), ("importance sampling", event.importance)):
            if one is not None:
                value, low, high, variation = map(float, one)
                print(
                    f"  {method} {value:.3g} [{low:.2g}, {high:.2g}], coefficient of variation {100 * variation:.0f} %"
                )
        shares = sorted(event.shares.items(), key=lambda item: -item[1])
        print("  contributions: " + ", ".join(f"{name} {100 * value:.0f} %" for name, value in shares))
        for distance, plain, rare in found.plain:
            texts = ("{:.3g} [{:.2g}, {:.2g}]".format(*one) for one in (plain, rare))
            print(f"  over {distance:.1f} m: plain campaign {', subset simulation '.join(texts)}")
        for warning in event.warnings:
            print(f"  warning: {warning}")


if __name__ == "__main__":
    main()
