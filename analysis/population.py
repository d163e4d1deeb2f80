"""How do the seeking controller and the slide protection do on vehicles and rails that nobody tuned them on?

Each seed gives a random vehicle and a random rail. Each stop, from 100 to 5 km/h, is compared with the attainable one,
or with the clairvoyant one where the rail changes on the way. In the second column the sensors, the brake and the
beliefs of every second stop are wrong. A third argument names one of `population.FAMILIES`, "one hump" unless given.

    python analysis/population.py [SEEDS, 200 unless given] [FIRST SEED, 9000 unless given]
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from multiprocessing import get_context

import numpy as np

import railslip_ctrl as rs
from railslip_ctrl.controllers.base import Controller
from railslip_ctrl.simulation import Scenario
from railslip_ctrl.simulation.bound import attainable_stop, clairvoyant_stop
from railslip_ctrl.simulation.population import CHECK, peak_of, random_stop

KMH = 1 / 3.6
SEEDS = 200
CONTROLLERS: dict[str, type[Controller]] = {"seeking": rs.Seeking, "slide protection": rs.SlideProtection}
PEAKS = (0.008, 0.015, 0.03, 0.06, 0.11, 0.15)
"""Slips of the peak between which the stops are grouped."""
HAND_OVERS = (0.0, 10.0, 20.0, 40.0, math.inf)
"""Hand-over speeds, km/h, likewise."""


@dataclass(frozen=True)
class Stop:
    """A stop: per cent over the attainable, highest slip, speed at which the wheel first locked, km/h (0: never)."""

    seed: int
    controller: str
    errors: bool
    peak_slip: float
    hand_over_kmh: float
    over: float
    slip: float
    locked_at_kmh: float

    @property
    def locked(self) -> bool:
        """Whether the wheel locked above the hand-over speed."""
        return self.locked_at_kmh > self.hand_over_kmh


def attainable(scenario: Scenario) -> float:
    """Distance, m, of the stop that others are compared with."""
    found = math.inf if scenario.events else attainable_stop(scenario).braking_distance
    return found if math.isfinite(found) else clairvoyant_stop(scenario).braking_distance


def stops_of(seed: int, family: str = "one hump") -> list[Stop]:
    """The stops of a seed: each controller, without and with errors."""
    scenarios = {wrong: random_stop(seed, family=family, errors=wrong) for wrong in (False, True)}
    plain = scenarios[False]
    least, top = attainable(plain), peak_of(plain.adhesion, plain.initial_speed, plain.vehicle.wheel_load)
    hand_over_kmh = rs.Seeking.for_vehicle(plain.vehicle).controlled_from / KMH
    found = []
    for wrong, scenario in scenarios.items():
        for name, kind in CONTROLLERS.items():
            simulator = rs.Simulator(scenario, kind.for_vehicle(scenario.believed_vehicle))
            run = simulator.run(seed)
            over = 100.0 * (run.braking_distance / least - 1.0) if run.stopped else math.inf
            locked = _locked_at(simulator, run)
            found.append(Stop(seed, name, wrong, top.slip, hand_over_kmh, over, run.max_slip, locked))
    return found


def _locked_at(simulator: rs.Simulator, run: rs.Run) -> float:
    """Speed at which the wheel first locked, km/h; 0 if it never did."""
    if math.isnan(run.first_lock):
        return 0.0
    signals = simulator.run(run.seed, record_every=1).signals
    assert signals is not None, "it is recorded"
    return float(np.interp(run.first_lock, signals.time, signals.speed)) / KMH


def run(seeds: Iterable[int], *, family: str = "one hump", workers: int | None = 1) -> list[Stop]:
    """The stops of some seeds; `workers` processes, as many as processors if None."""
    one = partial(stops_of, family=family)
    if workers == 1:
        return [stop for seed in seeds for stop in one(seed)]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        return [stop for stops in pool.map(one, seeds, chunksize=10) for stop in stops]


def row(name: str, stops: Sequence[Stop]) -> str:
    """A line of the table: without errors, and with errors in half of the stops."""
    half = [[one for one in stops if one.errors is (wrong and one.seed % 2 == 1)] for wrong in (False, True)]
    cells = []
    for part in half:
        over = [one.over for one in part]
        quantiles = [np.median(over), np.quantile(over, 0.95, method="nearest"), max(over)] if over else [math.nan] * 3
        shares = [100.0 * np.mean([one.locked for one in part]), 100.0 * np.mean([one.slip > 0.5 for one in part])]
        cells.append("{:6.1f} {:6.1f} {:6.1f} {:6.1f} {:5.1f}".format(*quantiles, *shares))
    return f"{name:24s} {len(half[0]):5d}  " + "  | ".join(cells)


def table(stops: Sequence[Stop]) -> str:
    """Every controller by the slip of the peak and by the hand-over speed."""
    head = "median   95 %  worst locked  >0.5"
    lines = [
        f"{'':31s}{'no errors':35s} |  errors in half of the stops",
        f"{'per cent over attainable':24s} stops  {head}  | {head}",
    ]
    for name in CONTROLLERS:
        mine = [one for one in stops if one.controller == name]
        lines.append(row(name, mine))
        for low, high in pairwise(PEAKS):
            part = [one for one in mine if low <= one.peak_slip < high]
            lines += [row(f"  peak {low:g} to {high:g}", part)] if part else []
        for low, high in pairwise(HAND_OVERS):
            part = [one for one in mine if low <= one.hand_over_kmh < high]
            lines += [row(f"  hand-over {low:g} to {high:g} km/h", part)] if part else []
    return "\n".join(lines)


def main() -> None:
    """Print the table."""
    count, first, family = [*sys.argv[1:], *(str(SEEDS), str(CHECK), "one hump")[len(sys.argv) - 1 :]]
    seeds = range(int(first), int(first) + int(count))
    print(f"{family}, seeds {seeds[0]} to {seeds[-1]}; locked: above the hand-over speed; >0.5: highest slip; %")
    print(table(run(seeds, family=family, workers=None)))


if __name__ == "__main__":
    main()
