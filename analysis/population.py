"""How well does the seeking controller work on vehicles and rails for which it was not tuned?

It is compared with slide protection, which does not know the rail either, and with the best linear design: a PI-lead
that knows vehicle, adhesion law and slip of the peak. The reference of the PI-lead is 80 % of this slip, and its ki is
the largest with Ms <= 2.

In 1000 stops (seeds 9000 to 9999), without errors and with errors in half of the stops:

- Half of the seeking controller's stops are at most 5.9 % (7.5 % with errors) longer than the attainable stop, 95 of
  100 at most 28 % (35 %). The wheel locks above the hand-over speed in 0.3 % (1.0 %) of them.
- The excess is largest with a narrow peak, or with a heavy car that hands over above 40 km/h.
- The PI-lead, which knows the rail, has a median of 6.8 % (9.9 %), but 5 of 100 stops take more than twice the
  attainable distance, and 3.4 % (4.3 %) lock.
- Slide protection has a median of 79 %, and locks in 31 % of the stops.

Each seed gives a random vehicle and a random rail. Each stop, from 100 to 5 km/h, is compared with the attainable stop,
or with the clairvoyant stop if the rail changes during the stop. In the second half of the table, every second stop has
errors of the sensors, the brake and the assumed vehicle. A third argument may be the name of one of the
`population.FAMILIES` of rails; the default is "one hump".

    python analysis/population.py [SEEDS, default 200] [FIRST SEED, default 9000]
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import pairwise
from multiprocessing import get_context

import numpy as np

import railslip_ctrl as rs
from railslip_ctrl.controllers.base import Controller
from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.simulation import Scenario
from railslip_ctrl.simulation.bound import attainable_stop, clairvoyant_stop
from railslip_ctrl.simulation.population import CHECK, peak_of, random_stop

KMH = 1 / 3.6
SEEDS = 200
CONTROLLERS = ("seeking", "slide protection", "PI-lead, rail known")
PEAKS = (0.008, 0.015, 0.03, 0.06, 0.11, 0.15)
"""Limits of the groups of stops by the slip of the adhesion peak, ratios."""
HAND_OVERS = (0.0, 10.0, 20.0, 40.0, math.inf)
"""Limits of the groups of stops by the hand-over speed, km/h."""


@dataclass(frozen=True)
class Stop:
    """Stop: excess over the attainable distance, %, highest slip, speed of the first lock, km/h (0: no lock)."""

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
        """True if the wheel locks above the hand-over speed."""
        return self.locked_at_kmh > self.hand_over_kmh


def attainable(scenario: Scenario) -> float:
    """Return the distance of the attainable or the clairvoyant stop, m, with which the stops are compared."""
    distance = math.inf if scenario.events else attainable_stop(scenario).braking_distance
    return distance if math.isfinite(distance) else clairvoyant_stop(scenario).braking_distance


def stops_of(seed: int, family: str = "one hump") -> list[Stop]:
    """Return the stops of a seed: each controller, without and with errors."""
    scenarios = {wrong: random_stop(seed, family=family, errors=wrong) for wrong in (False, True)}
    plain = scenarios[False]
    least, top = attainable(plain), peak_of(plain.adhesion, plain.initial_speed, plain.vehicle.wheel_load)
    hand_over_kmh = rs.Seeking.for_vehicle(plain.vehicle).controlled_from / KMH
    stops = []
    for wrong, scenario in scenarios.items():
        for name in CONTROLLERS:
            simulator = rs.Simulator(scenario, controller(name, scenario))
            run = simulator.run(seed)
            over = 100.0 * (run.braking_distance / least - 1.0) if run.stopped else math.inf
            locked = _locked_at(simulator, run)
            stops.append(Stop(seed, name, wrong, top.slip, hand_over_kmh, over, run.max_slip, locked))
    return stops


def controller(name: str, scenario: Scenario) -> Controller:
    """Return a controller for the assumed vehicle of a stop; the PI-lead also knows the adhesion law."""
    if name != CONTROLLERS[2]:
        return (rs.Seeking if name == CONTROLLERS[0] else rs.SlideProtection).for_vehicle(scenario.believed_vehicle)
    return _pi_lead(scenario.believed_vehicle, scenario.adhesion)


@lru_cache(2)  # without errors, and with them
def _pi_lead(vehicle: rs.Vehicle, law: AdhesionLaw) -> Controller:
    envelope = rs.Envelope(vehicle, laws=(law,), rails=("dry",), loads=("empty",), reference=law.reference)
    return rs.tune(envelope, "pi-lead", 2.0, nominal=True).controller


def _locked_at(simulator: rs.Simulator, run: rs.Run) -> float:
    """Return the speed at which the wheel first locks, km/h; 0 if it never locks."""
    if math.isnan(run.first_lock):
        return 0.0
    signals = simulator.run(run.seed, record_every=1).signals
    assert signals is not None, "the run is recorded"
    return float(np.interp(run.first_lock, signals.time, signals.speed)) / KMH


def run(seeds: Iterable[int], *, family: str = "one hump", workers: int | None = 1) -> list[Stop]:
    """Return the stops of some seeds; `workers` is the number of processes, None: all cores."""
    stops_of_seed = partial(stops_of, family=family)
    if workers == 1:
        return [stop for seed in seeds for stop in stops_of_seed(seed)]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        return [stop for stops in pool.map(stops_of_seed, seeds, chunksize=10) for stop in stops]


def row(name: str, stops: Sequence[Stop]) -> str:
    """Return a line of the table: without errors, and with errors in half of the stops."""
    half = [[stop for stop in stops if stop.errors is (wrong and stop.seed % 2 == 1)] for wrong in (False, True)]
    cells = []
    for part in half:
        over = [stop.over for stop in part]
        quantiles = [np.median(over), np.quantile(over, 0.95, method="nearest"), max(over)] if over else [math.nan] * 3
        locked, slid = (100.0 * np.mean(each) for each in ([s.locked for s in part], [s.slip > 0.5 for s in part]))
        cells.append("{:6.1f} {:6.1f} {:6.1f} {:6.1f} {:5.1f}".format(*quantiles, locked, slid))
    return f"{name:24s} {len(half[0]):5d}  " + "  | ".join(cells)


def table(stops: Sequence[Stop]) -> str:
    """Return the table: each controller by the slip of the peak and by the hand-over speed."""
    head = "median   95 %  worst locked  >0.5"
    lines = [
        f"{'':31s}{'no errors':35s} |  errors in half of the stops",
        f"{'per cent over attainable':24s} stops  {head}  | {head}",
    ]
    for name in CONTROLLERS:
        mine = [stop for stop in stops if stop.controller == name]
        lines.append(row(name, mine))
        for low, high in pairwise(PEAKS):
            part = [stop for stop in mine if low <= stop.peak_slip < high]
            lines += [row(f"  peak {low:g} to {high:g}", part)] if part else []
        for low, high in pairwise(HAND_OVERS):
            part = [stop for stop in mine if low <= stop.hand_over_kmh < high]
            lines += [row(f"  hand-over {low:g} to {high:g} km/h", part)] if part else []
    return "\n".join(lines)


def main() -> None:
    count, first, family = [*sys.argv[1:], *(str(SEEDS), str(CHECK), "one hump")[len(sys.argv) - 1 :]]
    seeds = range(int(first), int(first) + int(count))
    print(
        f"{family}, seeds {seeds[0]} to {seeds[-1]}; locked: % of stops with a lock above the hand-over speed; "
        ">0.5: % of stops with a higher slip"
    )
    print(table(run(seeds, family=family, workers=None)))


if __name__ == "__main__":
    main()
