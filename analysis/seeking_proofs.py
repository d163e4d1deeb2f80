"""What can be proven of the seeking controller's start, of its seeking and of its second start?

Three statements with their numbers for the published vehicle, each compared with the controller itself, without noise;
the theory page of the controller has the proofs. Answers, asserted in the tests:

- A bound on the slip after the start holds for every static adhesion curve between two, by comparison of scalar
  equations. From 100 km/h it excludes locking on beam and on wet curve for boxes of 5 %. For a single law it is up to
  four times the simulated slip, because a slow start may be released late. On dry curve there is a bound only for the
  single law, and on dry polach there is none.
- Where the reference rests, the loss of adhesion is limited by the flatness and the errors of the map. In simulations
  it stays within 0.022 of the peak on curves of one hump between 0.01 and 0.11. A peak below the knots is not found.
- After the rail has improved, the second start is commanded within a time that follows from the change.

    python analysis/seeking_proofs.py
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np

import railslip_ctrl as rs
from railslip_ctrl.controllers.base import Situation
from railslip_ctrl.controllers.seeking import KNOTS, SLOW_FROM, SLOW_SHARE, Seeking, seek
from railslip_ctrl.model.adhesion import AdhesionLaw, published_law
from railslip_ctrl.model.numeric import adhesion_coefficient, peak
from railslip_ctrl.model.vehicle import Rail, Vehicle
from railslip_ctrl.simulation import BrakeLimits
from railslip_ctrl.simulation.run import Run
from railslip_ctrl.simulation.scenario import Disturbances

KMH = 1 / 3.6
PERIOD = 0.01  # s
STEP = 1e-3  # s, of the comparison in time; its error is below the digits printed
SLIP_STEP = 2e-4  # of the comparison over slip
WITHIN = 0.6  # s, from when the release acts: the bound is of the slip up to then
LONGEST = 3.0  # s, of a start
SLIPS = np.linspace(0.0, 1.0, 2001)
CAR = rs.PARK2008
CONTROL = rs.Seeking.for_vehicle(CAR)


# --- the slip after the start ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Box:
    """Set of static curves between two, over `SLIPS`.

    A curve does not fall before `hump`, and then by at most `fall` for a unit of slip. At a constant slip it does not
    fall when the speed falls.
    """

    least: np.ndarray
    most: np.ndarray
    hump: float = 0.0
    fall: float = 1e9


def box_about(law: AdhesionLaw, speed: float, wheel_load: float, width: float) -> Box:
    """Return the box of curves within a share of a law's curve, with its slopes up to slip 0.6.

    The speeds, m/s, are between the given speed and 0.8 of it.
    """
    speeds, slips = (speed, 0.8 * speed), np.minimum(SLIPS, 0.999 * law.domain_limit(speed)[0])
    mu = np.array([adhesion_coefficient(law, v, slips, wheel_load) for v in speeds])
    fall = float(-np.gradient(mu, SLIPS, axis=1)[:, SLIPS < 0.6].min())
    first = min(peak(law, v, wheel_load).slip for v in speeds)
    return Box((1 - width) * mu.min(axis=0), (1 + width) * mu.max(axis=0), first, (1 + width) * fall)


def holding(vehicle: Vehicle, slip: Any, mu: Any, resisted: float, rolling: Any) -> Any:
    """Return the torque that holds a slip ratio.

    `resisted` is the speed for the travelling resistance and `rolling` is r omega, both in m/s.
    """
    r, terms, force = vehicle.wheel.radius, vehicle.resistance, vehicle.wheel_load * mu
    slowing = (force + terms.constant + terms.linear * resisted + terms.quadratic * resisted**2) / vehicle.mass
    return r * force + vehicle.wheel.inertia / r * (1 - slip) * slowing - vehicle.wheel.viscous_friction * rolling / r


def overshoot(vehicle: Vehicle, g: Seeking, box: Box, speed: float, *, again: int = 0) -> float:
    """Return an upper bound of the first slip maximum after a start, for all curves of a box; 1: no bound.

    Without noise, wheel and brake as assumed, in SI. speed: at the start, m/s; again: number of samples at which a
    second start commands the largest torque before that maximum.
    """
    r, rate = vehicle.wheel.radius, vehicle.wheel.radius / vehicle.wheel.inertia
    top, rising = float(box.most.max()), np.maximum.accumulate(box.most)
    still = float(holding(vehicle, 0.0, 0.0, speed, 0.0)) * rate  # deceleration by travelling resistance
    slowing = vehicle.wheel_load * top / vehicle.mass + still  # the most there is
    steps, count = round(PERIOD / STEP), round(LONGEST / STEP)
    since = np.maximum(STEP * np.arange(count + 1) - g.dead_time, 0.0)
    full = g.torque_max * (1 - np.exp(-since / g.lag))
    # while the wheel slows down, r Fa <= T + B omega
    force = np.minimum((full + vehicle.wheel.viscous_friction * speed / r) / r, vehicle.wheel_load * top)
    slow = np.maximum(speed - STEP * np.cumsum(force / vehicle.mass + still), 0.3 * speed)

    def path(slip: float, first: int, last: int, mu: np.ndarray, *, quick: bool, full: np.ndarray = full) -> np.ndarray:
        """Slip over steps with a torque, the largest: from above (`quick`, with the least adhesion) or from below."""
        found = [slip]
        for i in range(first, last):
            resisted, rolling = (slow[i + 1], speed) if quick else (speed, slow[i + 1])
            at = slip
            for part in (0.5, 1.0):  # the midpoint rule
                held = holding(vehicle, at, np.interp(at, SLIPS, mu), resisted, rolling * (1 - at))
                drive = rate * (full[i] + (1 - part) * (full[i + 1] - full[i]) - held)
                at = slip + part * STEP * drive / (slow[i + 1] if quick == (drive > 0) else speed)
            slip = min(at, 1.0)
            found.append(slip)
        return np.array(found)

    # samples of the start, until release is certain: least slip, greatest, least of the filtered rate
    low, high = path(0.0, 0, count, box.most, quick=False), path(0.0, 0, count, box.least, quick=True)
    held = holding(vehicle, low, np.interp(high, SLIPS, rising), speed, slow * (1 - high))
    rises = np.maximum(rate * (full - held) - high * slowing, 0.0)
    blend, share, filtered = 1 - math.exp(-PERIOD / g.observer_time), min(g.start_slip, 0.85 * g.first_slip), [0.0]
    while low[(len(filtered) - 1) * steps] + g.start_lead * filtered[-1] / speed < share:
        k = len(filtered)
        if (k + 1) * PERIOD + g.dead_time + WITHIN >= LONGEST:
            return 1.0
        filtered.append((1 - blend) * filtered[-1] + blend / PERIOD * STEP * rises[(k - 1) * steps : k * steps].sum())

    # slips between which each release begins to act, and the torque then; the sample that releases commands the most
    begins = []
    for k in range(1, len(filtered)):
        end = round(((k + 1) * PERIOD + g.dead_time) / STEP)
        over = min(high[(k - 1) * steps], share - g.start_lead * filtered[k - 1] / speed)
        begins.append((low[end], path(over, (k - 1) * steps, end, box.least, quick=True)[-1], full[end]))

    # a slow start, once it acts: at most the torque of then or its share of what holds; released at any later sample
    first = round(((np.argmax(high[::steps] > SLOW_FROM) + 1) * PERIOD + g.dead_time) / STEP)
    twice = SLOW_SHARE * float(holding(vehicle, 0.0, top, speed, 0.0))
    slowly = np.full_like(full, max(full[end], min(twice, g.torque_max)))
    farthest = path(share, 0, round((2 * PERIOD + g.dead_time) / STEP), box.least, quick=True, full=slowly)[-1]
    begins.append((low[first], farthest, slowly[0]))
    return _highest(vehicle, g, box, speed, begins, float(slow[end + round(WITHIN / STEP)]), again)


def rate_of_torque(g: Seeking, wanted: float, over: float) -> float:
    """Rate of the torque that is `over` what holds the slip, by the law whose surface is `wanted` less that; N*m."""
    surface = wanted - over
    reached = g.reaching_rate * surface + g.switching_gain * min(max(surface / g.layer, -1.0), 1.0)
    return reached - g.kappa * over


def resting(g: Seeking, wanted: float) -> float:
    """The torque over what holds the slip at which that rate is 0, N*m."""
    gain = g.reaching_rate + g.switching_gain / g.layer
    inside = gain * wanted / (g.kappa + gain)
    if abs(wanted - inside) <= g.layer:
        return inside
    return (g.reaching_rate * wanted + math.copysign(g.switching_gain, wanted)) / (g.kappa + g.reaching_rate)


def _highest(vehicle: Vehicle, g: Seeking, box: Box, speed: float, begins: Any, after: float, again: int) -> float:
    """The slip at which T - H, bounded over the slip while it rises, is no more than what adhesion can have fallen; H
    is the holding torque of the highest adhesion so far, `after` the least speed."""
    rate, rising = vehicle.wheel.radius / vehicle.wheel.inertia, np.maximum.accumulate(box.most)
    force = vehicle.wheel_load * float(rising[-1])
    slowing = rate * float(holding(vehicle, 0.0, rising[-1], speed, 0.0) - vehicle.wheel.radius * force)
    slips = np.arange(0.0, 1.0 + SLIP_STEP, SLIP_STEP)
    least, most = np.interp(slips, SLIPS, box.least), np.interp(slips, SLIPS, rising)
    drop = np.minimum(most - least, box.fall * np.maximum(slips - box.hump, 0.0))
    fallen = vehicle.wheel_load * (vehicle.wheel.radius + 1 / (rate * vehicle.mass)) * drop
    fallen += holding(vehicle, 0.0, 0.0, speed, 0.0) - holding(vehicle, 0.0, 0.0, after, 0.0)
    worst, best = np.maximum.accumulate(fallen), np.maximum.accumulate(least)
    reference, turning = max(g.first_slip, g.largest_slip), slowing / rate
    second = again * g.torque_max * (1 - math.exp(-PERIOD / g.lag))
    over, farthest = -math.inf, max(begin[1] for begin in begins)
    for i, slip in enumerate(slips):
        held = float(holding(vehicle, slip, best[i], speed, speed * (1 - slip)))
        acting = [torque - held for near, far, torque in begins if near - SLIP_STEP <= slip <= far + SLIP_STEP]
        over = max([over, *acting])
        if over == -math.inf:
            continue
        error = (reference - slip) * (speed if slip < reference else after)
        error += g.dead_time * (reference * slowing + rate * worst[i])
        rests = g.kappa * error / rate + turning * max(slip - reference, 0.0)  # it holds the reference, not the slip
        over = max(over, resting(g, rests))
        drives = over + second + fallen[i]
        if drives <= 0:
            if slip > farthest:
                return float(slip)
            continue
        falls = max(rate_of_torque(g, rests, over), -(over + held) / g.lag)
        over += SLIP_STEP * (falls * after / (rate * drives) + turning)
    return 1.0


def quiet(law: str | AdhesionLaw, rail: str, speed: float, **changes: Any) -> Run:
    """A stop of the published vehicle without noise, recorded."""
    limits = BrakeLimits(torque_max=CONTROL.torque_max)
    scenario = rs.stop(CAR, rail, adhesion=law).with_changes(
        **{"initial_speed": speed, "disturbances": Disturbances(), "limits": limits, **changes}
    )
    return rs.simulate(scenario, CONTROL, seed=None)


def first_maximum(seen: Run) -> tuple[float, int]:
    """Of the slip after the start, and samples at which a second start commanded before it."""
    assert seen.signals is not None, "it is recorded"
    slip, starting = seen.signals.slip, seen.controller_signals["starting"]
    release = int(np.argmax(starting == 0))
    top = release + int(np.argmax(np.diff(slip[release:]) <= 0))
    return float(slip[top]), int(np.sum(starting[release:top] > 0))


def start(law: str, rail: str, kmh: float, widths: tuple[float, ...]) -> tuple[list[float], float, int, float]:
    """Bounds by width of the box; first maximum simulated, its samples of a second start, the bound with these."""
    speed = kmh * KMH
    boxes = [box_about(published_law(law, rail), speed, CAR.wheel_load, width) for width in widths]
    simulated, again = first_maximum(quiet(law, rail, speed))
    bounds = [overshoot(CAR, CONTROL, box, speed) for box in boxes]
    return bounds, simulated, again, overshoot(CAR, CONTROL, boxes[0], speed, again=again) if again else bounds[0]


# --- seeking --------------------------------------------------------------------------------------------------------


def misfit(bend: float, g: Seeking, first: float, last: float, weight: float) -> float:
    """Bound on the rms misfit of the map to data between two knots, without noise, where |mu''| <= bend; weight: sum
    over the data. The map's cost is at most that of the curve's values at these knots, continued straight."""
    widths = np.diff([knot for knot in KNOTS if first <= knot <= last])
    bends = bend * (0.5 * (widths[1:] + widths[:-1])) ** 2
    return math.hypot(bend * widths.max() ** 2 / 8, math.sqrt(g.curvature * float(bends @ bends) / weight))


def hump(at: float, power: float) -> Callable[[float], float]:
    """A curve of one hump, of height 0.3: 0.6 u/(1 + u^2), u = (slip/at)^power."""

    def curve(slip: float) -> float:
        u = (max(slip, 0.0) / at) ** power
        return 0.6 * u / (1 + u * u)

    return curve


def state_and_parameters() -> tuple[SimpleNamespace, SimpleNamespace]:
    """Of the controller, as its step has them: train speed 1 m/s, wheel radius 1 m."""
    situation = Situation(Rail.DRY, PERIOD, published_law("curve", "dry"))
    start = {name: list(one) if isinstance(one, tuple) else one for name, one in CONTROL.start(20.0, PERIOD)}
    numbers = {**CONTROL.parameters(situation), "radius": 1.0}
    return SimpleNamespace(**{**start, "filtered_speed": 1.0}), SimpleNamespace(**numbers, period=PERIOD)


def sought(curve: Callable[[float], float], seconds: float) -> np.ndarray:
    """The reference slip every sample, by the controller's `seek` itself, where the slip is the reference and adhesion
    the curve's; a start to the first reference comes before."""
    (x, p), slips = state_and_parameters(), []
    x.reference_slip = CONTROL.first_slip
    for k in range(round(seconds / PERIOD)):
        started = (k * PERIOD - CONTROL.dead_time - 2 * CONTROL.observer_time) / (3 * CONTROL.dead_time)  # from 0
        slip = CONTROL.first_slip * max(started, 0.0) if started < 1 else x.reference_slip
        x.samples, x.starting = k, float(started < 1)
        x.filtered_sigma, x.adhesion_torque = slip, curve(slip) * CONTROL.wheel_load
        seek(x, p, x.reference_slip)
        slips.append(slip)
    return np.array(slips)


def seek_hump(at: float, power: float) -> tuple[float, float, float]:
    """From 2 to 10 s: farthest from the peak, or from the largest reference where that is less; shares of the adhesion
    there given away, mean and most."""
    curve, goal = hump(at, power), min(at, CONTROL.largest_slip)
    slips = sought(curve, 10.0)[round(2 / PERIOD) :]
    away = np.array([1 - curve(float(slip)) / curve(goal) for slip in slips])
    return float(np.abs(slips - goal).max()), float(away.mean()), float(away.max())


# --- re-adhesion ----------------------------------------------------------------------------------------------------


def restart_within(before: float, after: AdhesionLaw, v: float, s: float) -> float:
    """Time, s, within which the second start is commanded after the coefficient at the reference slip `s` rose from
    `before` to a static law's, speed `v`, m/s, no noise; infinite where that does not follow.

    Until the dead time has passed the torque is that of before; then at most all the brake's. Where by comparison with
    it the slip stays below 0.69 s for a dead time, the second start is commanded: it looks at samples.
    """
    held = holding(CAR, s, before, v, v * (1 - s))
    slip, low_since = s, math.inf
    for t in STEP * np.arange(1, 1001):
        torque = held + (CONTROL.torque_max - held) * (1 - math.exp(-max(t - CONTROL.dead_time, 0.0) / CONTROL.lag))
        need = holding(CAR, slip, float(adhesion_coefficient(after, v, slip, CAR.wheel_load)), 0.0, v)
        slip = min(max(slip + STEP * CAR.wheel.radius / CAR.wheel.inertia * (torque - need) / v, 0.0), s)
        low_since = min(low_since, t) if slip < 0.69 * s else math.inf
        if t >= low_since + CONTROL.dead_time + 2 * PERIOD:
            return float(t)
    return math.inf


def restart(law: str, place: float = 80.0) -> tuple[float, float]:
    """From wet to dry at a place, m: time to the second start, s, bound and simulated."""
    seen = quiet(law, "wet", 100 * KMH, events=(rs.Event(distance=place, rail="dry"),))
    assert seen.signals is not None, "it is recorded"
    at = int(np.argmax(seen.signals.distance >= place)) - 1
    speed, slip = float(seen.signals.speed[at]), float(seen.controller_signals["reference_slip"][at])
    before = float(adhesion_coefficient(published_law(law, "wet"), speed, slip, CAR.wheel_load))
    again = at + int(np.argmax(seen.controller_signals["starting"][at:] > 0))
    passed = np.interp(place, seen.signals.distance, seen.signals.time)
    return restart_within(before, published_law(law, "dry"), speed, slip), float(seen.signals.time[again] - passed)


# --- the script -----------------------------------------------------------------------------------------------------

WIDTHS = (0.0, 0.02, 0.05)
STARTS = tuple((*law, kmh) for law in product(("curve", "beam", "polach"), ("dry", "wet")) for kmh in (100.0, 50.0))
HUMPS = tuple(product((0.003, 0.006, 0.01, 0.015, 0.02, 0.03, 0.05, 0.07, 0.09, 0.11, 0.13), (0.5, 1.0, 2.0)))


@dataclass(frozen=True)
class Proofs:
    """`start`, `seek_hump` and `restart` of their cases."""

    starts: dict[tuple[str, str, float], tuple[list[float], float, int, float]]
    humps: dict[tuple[float, float], tuple[float, float, float]]
    restarts: dict[str, tuple[float, float]]


def run(starts: Any = STARTS, humps: Any = HUMPS) -> Proofs:
    """All three."""
    return Proofs(
        {case: start(*case, WIDTHS) for case in starts},
        {case: seek_hump(*case) for case in humps},
        {law: restart(law) for law in ("curve", "beam")},
    )


def main() -> None:
    """Print the tables."""
    found = run()
    print("first maximum of slip, no noise: bounds by width of the box; simulated (second starts: bound with them)")
    print(" " * 20 + "".join(f"{100 * width:6.0f} %" for width in WIDTHS) + "  simulated")
    for (law, rail, kmh), (bounds, simulated, again, more) in found.starts.items():
        *cells, last = (f"{bound:8.3f}" if bound < 1 else "    none" for bound in (*bounds, more))
        print(f"{law:7s}{rail:4s}{kmh:4.0f} km/h{''.join(cells)}{simulated:10.3f}  ({again}:{last})")
    print("\nreference sought on curves of one hump, 2 to 10 s: farthest from the peak; given away, mean and most")
    for (at, power), (distance, mean, most) in found.humps.items():
        print(f"peak {at:5.3f}, power {power:3.1f}: {distance:6.3f} {100 * mean:7.2f} %{100 * most:7.2f} %")
    print("\nsecond start after wet to dry at 80 m, s: bound, simulated")
    for law, (bound, simulated) in found.restarts.items():
        print(f"{law:8s}{bound:6.3f} {simulated:6.3f}")


if __name__ == "__main__":
    main()
