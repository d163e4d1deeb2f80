"""How much longer than the bound are stops with the seeking controller, on unknown rails and with brake errors?

The stops are those of the published vehicle, empty and loaded, with five adhesion laws, five sequences of rails, and a
brake as assumed, 30 % faster or 30 % slower. Every stop is compared with the clairvoyant stop with the same brake.
Results, which the tests check with few seeds:

- On curve, bristle and beam the median excess is 6 %. 95 of 100 stops are below 10 % with the brake as assumed, and
  below 18 % with a brake 30 % slower.
- The largest excess with these laws is 13 %; with a faster brake it is 15 %, and with a slower one 34 %: a slower brake
  makes the measured adhesion too high, so that a change from wet to dry rail can be missed.
- With these three laws no wheel locks above the hand-over speed. Below 7 km/h one stop in two hundred does.
- Polach's peak is at a slip of 0.014 (dry, 100 km/h), and the adhesion falls immediately beyond it. A change from dry
  to wet rail makes the stop 25 % longer. Wheels lock after the change in one stop of ten at 90 m, and more often with
  the slower brake.
- A change from dry to wet rail has the largest effect, because the torque cannot be released within the dead time.

    python analysis/seeking_campaign.py [SEEDS, default 16] [FIRST SEED, default 0]
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

import railslip_ctrl as rs
from railslip_ctrl import catalogue
from railslip_ctrl.model.adhesion import AdhesionLaw, law_class
from railslip_ctrl.simulation import BrakeLimits, Scenario
from railslip_ctrl.simulation.bound import clairvoyant_stop

KMH = 1 / 3.6
CONTROLLERS = {"asmc": "published ASMC", "slide-protection": "slide protection", "pi-lead": "PI-lead",
    "predictive": "predictive, slip known", "seeking": "seeking"}  # fmt: skip
"""Names in the table, by controller. All but slide protection and seeking get the reference slip of law and rail."""

LAWS = ("curve", "bristle", "beam", "polach", "lugre")
RAILS = {
    "dry": ("dry", ()),
    "wet": ("wet", ()),
    "dry to wet at 40 m": ("dry", (rs.Event(distance=40, rail="wet"),)),
    "dry to wet at 90 m": ("dry", (rs.Event(distance=90, rail="wet"),)),
    "wet to dry at 80 m": ("wet", (rs.Event(distance=80, rail="dry"),)),
}
BRAKES = (0.7, 1.0, 1.3)
"""Dead time and lag of the brake relative to those that the controller assumes."""

TORQUE_MAX = 9000.0
"""Largest torque, N*m."""

# [Park2008] has no LuGre law: these numbers give the friction of its bristle model, falling with the sliding speed
LUGRE = {"alpha": 2.2e4, "alpha1": 310.0, "alpha2": 21.0, "Fs": 1.13e4, "Fc": 6.1e3, "vs": 4.7}


@dataclass(frozen=True)
class Stop:
    """Result of a stop.

    The fields are the case of the stop, the excess `over` the bound in distance, %, the highest slip, the highest speed
    with a locked wheel, km/h (0: none), and the `filled` torque, the sum of all increases of the torque, N*m.
    """

    controller: str
    law: str
    rails: str
    load: str
    brake: float
    over: float
    slip: float
    locked_at_kmh: float
    filled: float


def controller(name: str, law: AdhesionLaw) -> rs.Controller:
    """Return a controller of the package; its reference slips, if it has any, are those of the law."""
    reference, column = law.reference, catalogue.default_column(law)
    return catalogue.controller_named(name, rs.PARK2008, column=column, reference=reference)


def run(
    seeds: Iterable[int],
    *,
    controllers: Iterable[str] = ("seeking",),
    laws: Iterable[str] = LAWS,
    brakes: Iterable[float] = BRAKES,
    rails: Iterable[str] = RAILS,
) -> list[Stop]:
    """Return all stops for these seeds, down to 2 km/h."""
    names, seeds = tuple(controllers), tuple(seeds)
    cases = product(laws, rails, ("empty", "loaded"), brakes)
    return [stop for case in cases for stop in _stops(names, *case, seeds)]


def _stops(
    names: tuple[str, ...], law: str, rails: str, load: str, brake: float, seeds: tuple[int, ...]
) -> Iterator[Stop]:
    scenario = _scenario(law, rails, load, brake)
    bound = clairvoyant_stop(scenario).braking_distance
    for name in names:
        simulator = rs.Simulator(scenario, controller(name, scenario.adhesion))
        for seed in seeds:
            seen = simulator.run(seed, record_every=1)
            assert seen.signals is not None, "the run is recorded"
            steps = np.diff(seen.signals.torque)
            sliding = seen.signals.speed[seen.signals.locked > 0.0]
            yield Stop(
                *(name, law, rails, load, brake, 100.0 * (seen.braking_distance / bound - 1.0), seen.max_slip),
                locked_at_kmh=float(sliding.max()) / KMH if sliding.size else 0.0,
                filled=float(steps[steps > 0.0].sum()),
            )


def _scenario(law: str, rails: str, load: str, brake: float) -> Scenario:
    vehicle = rs.PARK2008 if load == "empty" else rs.PARK2008.loaded()
    rail, events = RAILS[rails]
    adhesion: str | AdhesionLaw = law_class("lugre").model_validate(LUGRE) if law == "lugre" else law
    scenario = rs.stop(vehicle, rail, adhesion=adhesion)
    actuator = rs.Actuator(
        dead_time=brake * vehicle.actuator.dead_time,
        lag=brake * vehicle.actuator.lag,
    )
    return scenario.with_changes(
        vehicle=vehicle.model_copy(update={"actuator": actuator}),
        events=events,
        limits=BrakeLimits(torque_max=TORQUE_MAX),
        final_speed=2 * KMH,
    )


# --- tolerances of the loops ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Tolerated:
    """Tolerances of the loop of a controller on curve, bristle and beam, empty and loaded, from `SLOWEST` up.

    - gain: smallest and largest brake gain, relative to the assumed one, with all loops stable.
    - dead_time, lag: largest relative error of each alone, in both directions, at most 1, with all loops stable.
    - from_kmh: lowest speed above which the loop is robust with all tolerances of an envelope; None if it is nowhere.
    """

    gain: tuple[float, float]
    dead_time: float
    lag: float
    from_kmh: float | None


SLOWEST = 20.0
"""Lowest speed, km/h; at 10 km/h the loops at the published slips have almost no tolerance."""


def tolerated(name: str) -> Tolerated | None:
    """Return the tolerances of a controller; None for a controller without a linear loop."""
    control = controller(name, rs.published_law("curve", "dry"))
    if isinstance(control, rs.Sliding | rs.SlideProtection):
        return None
    whole = rs.Envelope(rs.PARK2008, laws=LAWS[:3])
    fast = whole.at(speeds=[speed for speed in whole.speeds if speed >= SLOWEST], slip=1, radius=1, dead_time=1, lag=1)
    nominal = rs.judge(fast, control, nominal=True)
    gain = nominal.least("gain_decrease", largest=True)[0], nominal.least("gain_increase")[0]

    def largest(axis: str) -> float:
        good, bad = 0.0, 1.0
        while bad - good > 0.005:
            error = 0.5 * (good + bad)
            kept = rs.judge(fast.at(**{axis: (1 - error, 1 + error)}), control).stable.all()
            good, bad = (error, bad) if kept else (good, error)
        return good

    return Tolerated(gain, largest("dead_time"), largest("lag"), rs.judge(whole, control).robust_from_kmh)


def cells(tolerance: Tolerated | None) -> tuple[str, str, str, str]:
    """Return gain, dead time, lag and lowest speed as texts of the table."""
    if tolerance is None:
        return ("-",) * 4
    errors = [f"+-{100 * error:.0f} %" for error in (tolerance.dead_time, tolerance.lag)]
    start = "-" if tolerance.from_kmh is None else f"{tolerance.from_kmh:.0f} km/h"
    return f"{tolerance.gain[0]:.2f}-{tolerance.gain[1]:.2f}", errors[0], errors[1], start


# --- the script -------------------------------------------------------------------------------------------------------


def numbers(stops: list[Stop]) -> tuple[float, ...]:
    """Return the numbers of a row.

    These are the median, the 95 % quantile and the largest excess over the bound, %; the highest slip; the shares of
    stops with a lock above and only below 5 km/h, %; the median and the largest filled torque, kN*m.
    """
    over, filled = [stop.over for stop in stops], [stop.filled / 1e3 for stop in stops]
    above, below = (
        100.0 * float(np.mean([low < stop.locked_at_kmh <= high for stop in stops]))
        for low, high in ((5.0, 1e9), (0.0, 5.0))
    )
    distances = float(np.median(over)), float(np.quantile(over, 0.95)), max(over)
    return *distances, max(stop.slip for stop in stops), above, below, float(np.median(filled)), max(filled)


def row(name: str, stops: list[Stop]) -> str:
    """Return a line of the table."""
    cells_ = "{:7.1f} {:6.1f} {:6.1f} {:6.2f} {:7.1f} {:7.1f} {:7.1f} {:6.1f}".format(*numbers(stops))
    return f"{name:30s} {len(stops):6d} {cells_}"


def main() -> None:
    count, first = (int(word) for word in [*sys.argv[1:], *("16", "0")[len(sys.argv) - 1 :]])
    seeds = range(first, first + count)
    beside = run(seeds, controllers=[name for name in CONTROLLERS if name != "seeking"], laws=LAWS[:3])
    stops = run(seeds)
    print(f"{'':30s}           over the bound, %   highest    locked, %     filled, kN*m")
    print(f"{'':30s}  stops  median   95 %  worst   slip  >5 km/h <5 km/h  median  worst")
    print("curve, bristle and beam, all brakes" + 71 * " " + "gain    dead time    lag   used from")
    for name, shown in CONTROLLERS.items():
        mine = [stop for stop in (*beside, *stops) if stop.controller == name and stop.law in LAWS[:3]]
        print(row(f"  {shown}", mine), "{:>12s} {:>8s} {:>8s} {:>9s}".format(*cells(tolerated(name))))
    print("seeking")
    for brake in BRAKES:
        print(f"dead time and lag x {brake:g}")
        mine = [stop for stop in stops if stop.brake == brake]
        for law in LAWS:
            print(row("  " + law, [stop for stop in mine if stop.law == law]))
        print(row("  curve, bristle, beam", [stop for stop in mine if stop.law in LAWS[:3]]))
    print("brake as assumed")
    for law, rails in product(LAWS, RAILS):
        mine = [stop for stop in stops if (stop.brake, stop.law, stop.rails) == (1.0, law, rails)]
        print(row(f"  {law}, {rails}", mine))


if __name__ == "__main__":
    main()
