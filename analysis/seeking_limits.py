"""What limits any slip controller without preview of the rail, and how close to these limits is the seeking controller?

The script computes four limits for the published vehicle: a change from dry to wet rail, filling of the brake, Polach's
steep curve, and low speed. Results, which the tests check:

- A wheel at the dry peak locks after a change to wet rail even if the brake is released at the instant of the change.
  This holds below 48 km/h (curve, empty) and 57 km/h (polach); with a brake 30 % slower it holds below 62 and 75 km/h.
  Polach's runs that lock after a change at 90 m are of this kind; no other run locks above 7 km/h.
- With a brake 30 % slower, a controller that works at the dry peak of curve, empty, therefore always locks after a
  change at 90 m. On polach, a controller that works at the dry peak and releases immediately after a change at 40 m
  stops 15 % over the bound.
- A stop needs no more filling than its holding torque, 5 kN*m on dry rail and 8 kN*m on polach. The start and the
  return from beyond the peak add 1 to 6 kN*m. Noise in the inner loop adds 2 to 8 kN*m, or up to 6 kN*m with a loop
  half as fast (on curve, bristle and beam). A filled torque of 12 kN*m would be possible.
- Because of the dead time, no controller has Ms <= 2 above 1.2 times the slip of polach's peak. Staying below this slip
  costs no distance.
- Random forces do not prevent a stop to 2 km/h without locks on static curves. On bristle they sometimes lock a wheel
  even with a tenth of the torque.

    python analysis/seeking_limits.py [SEEDS, default 8]
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, root_scalar

import railslip_ctrl as rs
from railslip_ctrl.design.limits import least_peak
from railslip_ctrl.model.adhesion import AdhesionLaw, ReferenceSlip, law_class, published_law
from railslip_ctrl.model.linearization import linearize, operating_point
from railslip_ctrl.model.numeric import adhesion_coefficient, numeric_plant, peak, plant_parameters
from railslip_ctrl.model.vehicle import Vehicle
from railslip_ctrl.simulation import BrakeLimits, Scenario
from railslip_ctrl.simulation.bound import clairvoyant_stop
from railslip_ctrl.simulation.run import Run
from railslip_ctrl.simulation.scenario import Disturbances

KMH = 1 / 3.6
LAWS = ("curve", "bristle", "beam", "polach", "lugre")
STATIC = ("curve", "beam", "polach")
LOADS = {"empty": rs.PARK2008, "loaded": rs.PARK2008.loaded()}
BRAKES = (0.7, 1.0, 1.3)
PLACES = (40.0, 90.0)  # m, distances at which the rail turns wet
RAILS = ("dry", "wet", "wet to dry at 80 m", "dry to wet at 40 m", "dry to wet at 90 m")
TORQUES = {"dry": (5200.0, 6000.0, 7500.0, 9000.0), "wet": (3000.0, 4500.0, 9000.0)}  # N*m, largest torques
SHARES = (0.9, 0.7, 0.5, 0.3, 0.1)  # constant torque over the holding torque at the peak
LUGRE = {"alpha": 2.2e4, "alpha1": 310.0, "alpha2": 21.0, "Fs": 1.13e4, "Fc": 6.1e3, "vs": 4.7}
CONTROL = rs.Seeking.for_vehicle(rs.PARK2008)


def law_of(name: str) -> AdhesionLaw:
    """Return a law on dry rail with a reference slip, because a run needs one."""
    law = law_class("lugre").model_validate(LUGRE) if name == "lugre" else published_law(name, "dry")
    return law.model_copy(update={"reference": law.reference or ReferenceSlip(dry=0.1, wet=0.1)})


def braked(load: str, share: float) -> Vehicle:
    """Return the vehicle with dead time and lag multiplied by `share`."""
    own = LOADS[load].actuator
    actuator = rs.Actuator(dead_time=share * own.dead_time, lag=share * own.lag)
    return LOADS[load].model_copy(update={"actuator": actuator})


def stop_on(law: AdhesionLaw, rails: str, vehicle: Vehicle = rs.PARK2008, **changes: Any) -> Scenario:
    """Return a stop to 2 km/h; `rails` is one of `RAILS`, and `changes` are further fields of the scenario."""
    first, _, change = rails.partition(" to ")  # "dry to wet at 40 m"
    events = (rs.Event(distance=float(change.split()[2]), rail=change.split()[0]),) if change else ()
    given = {"events": events, "limits": BrakeLimits(torque_max=CONTROL.torque_max), "final_speed": 2 * KMH}
    return rs.stop(vehicle, first, adhesion=law).with_changes(**given | changes)


def at_peak(law: AdhesionLaw, vehicle: Vehicle, speed: float) -> tuple[list[float], float]:
    """Return speed, slip velocity and adhesion state at the adhesion peak, and the torque that holds it, N*m."""
    now = (speed, peak(law, speed, vehicle.wheel_load).slip * speed)
    functions, p = numeric_plant(type(law)), plant_parameters(law, vehicle)
    state = float(functions.rest_state(*now, 0.0, 0.0, 0.0, 0.0, p))
    return [*now, state], float(functions.trim_torque(*now, state, 0.0, 0.0, 0.0, p))


# --- a change from dry to wet ---------------------------------------------------------------------------------------


def slip_after(law: AdhesionLaw, vehicle: Vehicle, begin: list[float], torque: Callable[[float], float]) -> float:
    """Return the highest slip on wet rail if the brake is released at time 0, without noise; 1 for a lock.

    During the dead time the brake still applies `torque`, N*m, a function of time; then the torque decays. `begin` is
    the state as from `at_peak`.
    """
    wet, theta, lag = law.on("wet"), vehicle.actuator.dead_time, vehicle.actuator.lag
    rates, p = numeric_plant(type(wet)).rates, plant_parameters(wet, vehicle)

    def motion(t: float, y: np.ndarray) -> list[float]:
        rate = rates(*y, torque(min(t, theta)) * math.exp(-max(t - theta, 0.0) / lag), 0.0, 0.0, p)
        return [float(rate[0]), float(rate[1]), float(rate[2]) if len(rate) > 2 else 0.0]

    def locks(t: float, y: np.ndarray) -> float:
        return float(y[1] - 0.98 * y[0])  # the limit of a lock in runs

    locks.terminal = True  # type: ignore[attr-defined]
    end = theta + 4 * lag  # then 2 % of the torque is left
    solution = solve_ivp(motion, (0.0, end), begin, events=locks, method="LSODA", rtol=1e-6, atol=1e-8, max_step=0.02)
    return 1.0 if solution.t_events[0].size else float((solution.y[1] / solution.y[0]).max())


def least_speed(law: AdhesionLaw, vehicle: Vehicle, slip: float) -> float:
    """Return the speed, km/h, below which a wheel at the dry peak exceeds a slip after a change to wet rail.

    The brake is released at the instant of the change. The error of the speed is at most 0.5 km/h. 0 if the wheel does
    not exceed the slip at 10 km/h.
    """

    def slides(speed: float) -> bool:
        begin, torque = at_peak(law, vehicle, speed)
        return slip_after(law, vehicle, begin, lambda t: torque) >= slip

    low, high = 10 * KMH, 200 * KMH
    while slides(low) and high - low > 0.5 * KMH:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if slides(middle) else (low, middle)
    return 0.5 * (low + high) / KMH if high < 200 * KMH else 0.0


def speed_there(law: AdhesionLaw, vehicle: Vehicle, place: float) -> float:
    """Return the speed, m/s, of the clairvoyant stop on dry rail at a distance `place`, m.

    The root is searched in the square of the speed, which is nearly linear in distance.
    """

    def short(squared: float) -> float:
        scenario = stop_on(law, "dry", vehicle, final_speed=math.sqrt(squared))
        return clairvoyant_stop(scenario).braking_distance - place

    return math.sqrt(root_scalar(short, x0=(70 * KMH) ** 2, x1=(50 * KMH) ** 2, xtol=1.0).root)


def released_at_change(name: str, load: str, brake: float, place: float) -> float:
    """Return the excess over the bound, %, of an ideal controller at a change from dry to wet; infinite for a lock.

    The controller stays at the dry peak up to the change, then releases the brake, and stays at the wet peak, without
    delay, as soon as the slip has returned to it. The computation is without noise, and only for static laws.
    """
    law, vehicle = law_of(name), braked(load, brake)
    wet, theta, lag = law.on("wet"), vehicle.actuator.dead_time, vehicle.actuator.lag
    rates, p = numeric_plant(type(wet)).rates, plant_parameters(wet, vehicle)
    begin, torque = at_peak(law, vehicle, speed_there(law, vehicle, place))

    def motion(t: float, y: np.ndarray) -> list[float]:
        rate = rates(*y[:2], 0.0, torque * math.exp(-max(t - theta, 0.0) / lag), 0.0, 0.0, p)
        return [float(rate[0]), float(rate[1]), float(y[0])]

    def locks(t: float, y: np.ndarray) -> float:
        return float(y[1] - 0.98 * y[0])  # the limit of a lock in runs

    def is_back(t: float, y: np.ndarray) -> float:
        return float(y[1] - peak(wet, float(y[0]), vehicle.wheel_load).slip * y[0])

    locks.terminal = is_back.terminal = True  # type: ignore[attr-defined]
    is_back.direction = -1.0  # type: ignore[attr-defined]
    ends = {"events": (locks, is_back), "method": "LSODA", "rtol": 1e-6, "atol": 1e-8, "max_step": 0.02}
    solution = solve_ivp(motion, (0.0, theta + 10 * lag), [*begin[:2], place], **ends)
    if not solution.t_events[1].size:
        return math.inf
    without_delay = vehicle.model_copy(update={"actuator": rs.Actuator(dead_time=0.0, lag=0.0)})
    speed, _, distance = solution.y[:, -1]
    rest = clairvoyant_stop(stop_on(law, "wet", without_delay, initial_speed=float(speed))).braking_distance
    bound = clairvoyant_stop(stop_on(law, f"dry to wet at {place:g} m", vehicle)).braking_distance
    return 100 * float((distance + rest) / bound - 1)


def doomed(seen: Run, place: float) -> bool:
    """Return True if the wheel of a run would lock after a change to wet rail even with an immediate release.

    The computation starts from the state of the run at the change, with the torques already commanded, and without
    random force.
    """
    s = seen.signals
    assert s is not None, "the run is recorded"
    at = int(np.argmax(s.distance >= place))
    begin = [float(s.speed[at]), float(s.slip_velocity[at]), float(s.adhesion_state[at])]
    vehicle, law = seen.scenario.vehicle, seen.scenario.adhesion
    return slip_after(law, vehicle, begin, lambda t: float(np.interp(s.time[at] + t, s.time, s.torque))) >= 1.0


def change(name: str, load: str, brake: float, place: float, seeds: Iterable[int]) -> tuple[float, float, int, int]:
    """Return lowest and highest speed at a change from dry to wet, km/h, and two numbers of runs.

    These are the number of runs that lock above 5 km/h, and how many of them are `doomed`.
    """
    simulator = rs.Simulator(stop_on(law_of(name), f"dry to wet at {place:g} m", braked(load, brake)), CONTROL)
    runs = [simulator.run(seed, record_every=1) for seed in seeds]
    speeds = [float(np.interp(place, run.signals.distance, run.signals.speed)) / KMH for run in runs if run.signals]
    locked = [run for run in runs if run.signals and np.any(run.signals.speed[run.signals.locked > 0] > 5 * KMH)]
    return min(speeds), max(speeds), len(locked), sum(doomed(run, place) for run in locked)


# --- filling --------------------------------------------------------------------------------------------------------


def filled(scenario: Scenario, seeds: Iterable[int | None], **gains: float) -> tuple[float, float]:
    """Return medians over stops: sum of all increases of the acting torque, kN*m, and excess over the bound, %."""
    simulator = rs.Simulator(scenario, CONTROL.model_copy(update=gains))
    runs = [simulator.run(seed, record_every=1) for seed in seeds]
    sums = [np.maximum(np.diff(run.signals.torque), 0.0).sum() / 1e3 for run in runs if run.signals]
    over = np.median([run.braking_distance for run in runs]) / clairvoyant_stop(scenario).braking_distance - 1
    return float(np.median(sums)), 100 * float(over)


def filling(name: str, rails: str, seeds: Iterable[int]) -> tuple[float, list[tuple[float, float]]]:
    """Return the smallest filled torque, kN*m, and `filled` without noise, with noise, and with a slower inner loop.

    The smallest filled torque is that of staying at the peak down to 30 km/h, from a released brake.
    """
    law, used = law_of(name), rails.split()
    scenario = stop_on(law, rails)
    holding = [
        at_peak(law.on(rail), rs.PARK2008, kmh * KMH)[1]
        for rail, kmh in product(("dry", "wet"), (100, 30))
        if rail in used
    ]
    slower = filled(scenario, seeds, reaching_rate=CONTROL.reaching_rate / 2, layer=2 * CONTROL.layer)
    quiet = filled(scenario.with_changes(disturbances=Disturbances()), [None])
    return max(holding) / 1e3, [quiet, filled(scenario, seeds), slower]


# --- a steep curve --------------------------------------------------------------------------------------------------


def steep(law: AdhesionLaw, kmh: float) -> tuple[list[float], float, float]:
    """Return limits that follow from the unstable pole and the dead time on a steep curve, at a speed, km/h.

    These are the smallest Ms of any controller at 1, 1.25, 1.5 and 2 times the slip of the peak; the slip, relative to
    that of the peak, at which the smallest Ms is 2; and the loss of adhesion, %, at a slip 25 % below this slip.
    """
    car, speed = rs.PARK2008, kmh * KMH
    top = peak(law, speed, car.wheel_load)

    def least_ms(share: float) -> float:
        poles = np.linalg.eigvals(linearize(operating_point(law, car, speed, share * top.slip)).A)
        return least_peak(poles[poles.real > 0].astype(complex), np.array([]), car.actuator.dead_time)

    share = float(brentq(lambda x: least_ms(x) - 2.0, 1.0, 1.5)) if least_ms(1.5) > 2 else math.inf
    slip = min(share / 1.25, 1.0) * top.slip
    loss = 1 - float(adhesion_coefficient(law, speed, slip, car.wheel_load)) / top.coefficient
    return [least_ms(x) for x in (1.0, 1.25, 1.5, 2.0)], share, 100 * loss


# --- low speed ------------------------------------------------------------------------------------------------------


class Constant:
    """Controller that commands a constant torque."""

    def __init__(self, torque: float) -> None:
        self.torque = torque

    def step(self, t: float, v: float, omega: float) -> float:
        """Return the torque, N*m."""
        return self.torque


def locks_under(name: str, rail: str, share: float, seeds: Iterable[int]) -> int:
    """Return how many runs from 30 to 2 km/h lock with a share of the torque that holds the peak at 5 km/h."""
    torque = share * at_peak(law_of(name).on(rail), rs.PARK2008, 5 * KMH)[1]
    simulator = rs.Simulator(stop_on(law_of(name), rail, initial_speed=30 * KMH), Constant(torque))
    return sum(not math.isnan(simulator.run(seed).first_lock) for seed in seeds)


# --- the script -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Results:
    """Results by case: `least_speed` for slip 0.5 and for a lock, and the results of the other functions."""

    speeds: dict[tuple[str, str, float], list[float]]
    released: dict[tuple[str, str, float, float], float]
    changes: dict[tuple[str, str, float, float], tuple[float, float, int, int]]
    fillings: dict[tuple[str, str], tuple[float, list[tuple[float, float]]]]
    starts: dict[tuple[str, float], tuple[float, float]]
    steeps: dict[float, tuple[list[float], float, float]]
    locks: dict[tuple[str, str, float], int]


def run(seeds: int = 8, laws: tuple[str, ...] = LAWS, rails: tuple[str, ...] = RAILS) -> Results:
    """Return all results, for seeds from 0 on."""
    every, brakes = range(seeds), tuple(product(laws, LOADS, BRAKES))
    curve = law_of("curve")
    return Results(
        {case: [least_speed(law_of(case[0]), braked(*case[1:]), slip) for slip in (0.5, 1.0)] for case in brakes},
        {
            (*case, place): released_at_change(*case, place)
            for case, place in product(brakes, PLACES)
            if case[0] in STATIC
        },
        {(*case, place): change(*case, place, every) for case, place in product(brakes, PLACES)},
        {case: filling(*case, every) for case in product(laws, rails)},
        {(on, t): filled(stop_on(curve, on), every, torque_max=t) for on, most in TORQUES.items() for t in most},
        {kmh: steep(law_of("polach"), kmh) for kmh in (100.0, 50.0, 20.0)},
        {case: locks_under(*case, range(5 * seeds)) for case in product(laws, ("dry", "wet"), SHARES)},
    )


def main() -> None:
    """Print the tables."""
    seeds = int([*sys.argv[1:], "8"][:1][0])
    results = run(seeds)
    print("dry to wet, brake released at the change; speed, km/h, below which slip exceeds 0.5, below which it locks")
    for (law, load, brake), (past, locks) in results.speeds.items():
        print(f"  {law:8s}{load:7s}brake x {brake:g}: {past:6.0f}{locks:6.0f}")
    print("\ndry to wet, brake released at the change from the dry peak: excess over the bound, %")
    for (law, load, brake, place), over in results.released.items():
        print(f"  {law:8s}{load:7s}brake x {brake:g}, {place:g} m: {f'{over:6.1f}' if over < math.inf else ' locks'}")
    print(f"\nof {seeds} runs with this change: locked above 5 km/h; of these, locked even with immediate release")
    for (law, load, brake, place), (slow, fast, locked, lost) in results.changes.items():
        if locked:
            where = f"{law:8s}{load:7s}brake x {brake:g}, {place:g} m, at {slow:.0f} to {fast:.0f} km/h"
            print(f"  {where}: {locked}; {lost}")
    print("\nfilled torque, kN*m (excess, %): smallest; without noise; with noise; inner loop half as fast")
    for (law, rails), (least, stops) in results.fillings.items():
        print(f"  {law:8s}{rails:20s}{least:5.1f}" + "".join(f"{torque:7.1f} ({over:4.1f})" for torque, over in stops))
    print("\ncurve with less torque, kN*m: filled torque, kN*m; excess over the bound, %")
    for (rail, most), (torque, over) in results.starts.items():
        print(f"  {rail} {most / 1e3:4.1f}: {torque:5.1f} {over:6.1f}")
    print("\npolach dry: smallest Ms at 1, 1.25, 1.5, 2 times the peak slip; slip of Ms 2; loss 25 % below, %")
    for kmh, (least_ms, share, loss) in results.steeps.items():
        print(f"  {kmh:4.0f} km/h " + "".join(f"{ms:6.2f}" for ms in least_ms) + f"{share:7.2f}{loss:7.3f}")
    print(f"\nof {5 * seeds} runs from 30 to 2 km/h, locked under shares of the peak torque {SHARES}")
    for law, rail in dict.fromkeys(case[:2] for case in results.locks):
        print(f"  {law:8s}{rail:4s}" + "".join(f"{results.locks[law, rail, share]:4d}" for share in SHARES))


if __name__ == "__main__":
    main()
