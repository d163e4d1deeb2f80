"""Certified brake torques: a wheel with this torque does not lock if the brake is released.

After the release the acting torque T is constant for the dead time and then decays with the lag. From [Park2008] (3)
and (4)

    v slip' = -(1 - slip)(Fa + Fr)/M + (r/J)(B omega + (1 + c) T - r Fa),

where c T is the largest disturbance torque of the caliper. The larger Fa, the smaller the slip rate. An upper bound on
the slip is therefore the solution with a smaller force instead of Fa: the smallest adhesion force in the cell of slip,
at the initial and all lower speeds, minus the bound of the random force. The solution is computed in time steps, with
the largest slip rate in each step. Interval arithmetic gives the smallest adhesion force. The rest uses floats, whose
rounding `_ROUNDING` covers. The certificate excludes locking, but it does not prove that the slip converges.
"""

from __future__ import annotations

import math
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from flint import arb
from numpy.lib.stride_tricks import sliding_window_view

from railslip_ctrl.core.arguments import Flags, Floats
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.folders import cached
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion import AdhesionLaw, law_names
from railslip_ctrl.model.vehicle import Vehicle
from railslip_ctrl.simulation import Run

from .boxes import adhesion_on_balls, ball, upper
from .reaching import ADHESION_NOISE, TORQUE_FRACTION
from .verdict import NoLock, ReleasedRun

EVERY = 0.1  #: interval between the checked samples of a run, s; the slip changes by less than 0.1 per interval
SIGMAS = 3.0  #: bound of the random force, standard deviations
_CELLS, _SPEEDS = 256, 6  # numbers of cells of slip (0 to 1) and of speed; 512 slip cells certify 1 % more torque
_STEP = 0.0025  # s; the largest rate over a step of this length lowers the certified torque by 0.1 kN*m
_LONGEST = 4.0  # s; a wheel whose slip still grows after this time is not certified
_LEAST_SPEED = 1.0  # lowest speed that is certified, m/s
_ROUNDING = 1e-9  # relative bound of a rate's rounding error: a million times that of its twenty operations
_ROUNDS, _TRIED = 2, 51  # refinement rounds, and torques tried in each; resolution 1/2500 of the range


@dataclass(frozen=True)
class Force:
    """Bounds of Fa, N. Row i holds for all speeds from `_LEAST_SPEED` to `speeds[i]`, m/s; `speeds` ascends.

    - least: lower bound in each cell of slip from 0 to 1, (speeds, cells); 0 for cells beyond the law's domain.
    - most: upper bound over all slips, (speeds,).
    """

    speeds: Floats
    least: Floats
    most: Floats


def bounded_adhesion(law: AdhesionLaw, vehicle: Vehicle, speed: float) -> Force:
    """Return bounds of a static law's force up to a speed, m/s; the upper bound is at most the wheel load."""
    # the curve law takes a second
    bound = partial(_bounded_adhesion, law, vehicle, speed)
    known = law.name in law_names()
    return cached("adhesion-bounds", bound, f"{law!r} {vehicle.wheel_load!r} {speed!r}") if known else bound()


def _bounded_adhesion(law: AdhesionLaw, vehicle: Vehicle, speed: float) -> Force:
    enclosed, load = adhesion_on_balls(law), arb(vehicle.wheel_load)
    edges = np.linspace(_LEAST_SPEED, speed, _SPEEDS + 1)
    found, most = np.empty((_SPEEDS, _CELLS)), np.empty((_SPEEDS, _CELLS))
    for i in range(_CELLS):
        slip = ball(max(i / _CELLS, 1e-6), (i + 1) / _CELLS)
        forces = [enclosed(ball(*ends), slip, load)[0] for ends in pairwise(edges.tolist())]
        found[:, i] = [-upper(-one) if one.is_finite() else 0.0 for one in forces]
        most[:, i] = [min(upper(one), vehicle.wheel_load) for one in forces]
    least = np.minimum.accumulate(np.maximum(found, 0.0), axis=0)
    return Force(edges[1:], least, np.maximum.accumulate(most.max(axis=1)))


def no_lock(law: AdhesionLaw, vehicle: Vehicle, speeds_kmh: Floats, slips: Floats, *, torque_max: float) -> NoLock:
    """Find the largest certified torques, up to `torque_max`, N*m, on a grid of speeds, km/h, and slips."""
    kmh, slip = np.asarray(speeds_kmh, float), np.asarray(slips, float)
    force = bounded_adhesion(law, vehicle, float(kmh.max()) * KMH)
    v, at = np.repeat(kmh * KMH, slip.size), np.tile(slip, kmh.size)
    low, width = np.zeros(v.size), torque_max
    for _ in range(_ROUNDS):
        tried = low[:, None] + width * np.linspace(0.0, 1.0, _TRIED)
        flat = (np.repeat(v, _TRIED), np.repeat(at, _TRIED), tried.ravel())
        holds = certain(force, vehicle, *flat).reshape(tried.shape)
        # number of certified torques before the first that is not
        count = np.argmin(np.column_stack((holds, np.zeros(v.size, bool))), axis=1)
        low = np.where(count > 0, tried[np.arange(v.size), np.maximum(count - 1, 0)], 0.0)
        width /= _TRIED - 1
    return NoLock(kmh, slip, low.reshape(kmh.size, slip.size))


def released_run(run: Run, *, above: float) -> ReleasedRun:
    """Check for a recorded run, every `EVERY` s, whether locking is excluded if the brake is released at this time.

    Only speeds > `above`, m/s, are checked. The check uses the vehicle's actuator and the rail at the start of the run.
    InputError if the adhesion law has a state or cannot be evaluated with intervals.
    """
    assert run.signals is not None, "the run is recorded"
    vehicle, seen, period = run.scenario.vehicle, run.signals, float(run.signals.time[1])
    window = math.ceil(vehicle.actuator.dead_time / period) + 1
    ahead = sliding_window_view(np.append(seen.torque, np.zeros(window - 1)), window).max(axis=1)
    step = max(round(EVERY / period), 1)
    moving = np.flatnonzero(seen.speed > above)[::step]
    speed, slip, torque = seen.speed[moving], seen.slip[moving], ahead[moving]
    force = bounded_adhesion(run.scenario.law(run.scenario.rail), vehicle, float(seen.speed.max()))
    return ReleasedRun(speed, slip, torque, certain(force, vehicle, speed, slip, torque))


def certain(force: Force, vehicle: Vehicle, speeds: Floats, slips: Floats, torques: Floats) -> Flags:
    """Return True for each wheel that certainly does not lock after a release of the brake.

    `speeds` (m/s), `slips` and acting `torques` (N*m) have the shape (n,). A negative slip counts as 0, the worse
    case. InputError for a speed above the speeds of `force`.
    """
    J, M, r = vehicle.effective_inertia, vehicle.effective_mass, vehicle.wheel.radius
    noise = SIGMAS * ADHESION_NOISE * vehicle.wheel_load
    weakest, row = force.least - noise, np.searchsorted(force.speeds * (1.0 + _ROUNDING), speeds)
    if np.any(row == force.speeds.size):
        raise InputError(
            f"speed: {np.max(speeds):g} m/s is above {force.speeds[-1]:g} m/s, the highest speed for "
            "which bounds of the adhesion force are known; give a lower speed"
        )
    friction = vehicle.effective_viscous_friction * speeds / r  # upper bound of B omega
    falling = (force.most[row] + noise + vehicle.resistance.force(speeds)) / M

    def numerator(which: Any, least: Floats, end: Floats, torque: Floats) -> Floats:
        # largest v slip', m/s^2, for Fa >= `least` and a slip up to `end`
        train = -(1.0 - np.where(least > 0.0, end, 0.0)) * least / M
        wheel = r / J * (friction[which] + (1.0 + TORQUE_FRACTION) * torque - r * least)
        sizes = np.abs(train) + r / J * (friction[which] + torque + r * np.abs(least))
        return np.asarray(train + wheel + _ROUNDING * sizes)

    slip, safe = np.maximum(slips, 0.0), np.zeros(slips.size, bool)
    left = np.arange(slips.size)  # indices of the wheels that are not decided yet
    actuator = vehicle.actuator
    for n in range(round(_LONGEST / _STEP)):
        t = n * _STEP
        left = left[(slip[left] < 1.0 - 1.0 / _CELLS) & (speeds[left] - falling[left] * (t + _STEP) >= _LEAST_SPEED)]
        if not left.size:
            break
        late = max(t - actuator.dead_time, 0.0)
        acting = torques[left] * (np.exp(-late / actuator.lag) if actuator.lag > 0 else float(late == 0.0))
        at, cell = row[left], np.minimum((slip[left] * _CELLS).astype(int), _CELLS - 1)
        # the torque does not rise again, so that a rate below 0 over the cell keeps the slip below the cell's upper end
        falls = numerator(left, weakest[at, cell], (cell + 1) / _CELLS, acting) < 0.0
        safe[left[falls]] = True
        left, at, cell, acting = left[~falls], at[~falls], cell[~falls], acting[~falls]
        if not left.size:
            break
        slowest = speeds[left] - falling[left] * (t + _STEP)
        # over the step the slip stays within the cells that the largest possible rate can reach
        none = np.full(left.size, np.min(weakest))
        steepest = float(np.max(numerator(left, none, np.ones(left.size), acting) / slowest))
        reach = min(int(_STEP * max(steepest, 0.0) * _CELLS) + 2, _CELLS)
        padded = np.pad(weakest, ((0, 0), (0, reach - 1)), constant_values=np.inf)
        ahead = np.min(sliding_window_view(padded, reach, axis=1), axis=2)[at, cell]
        rate = numerator(left, ahead, np.minimum((cell + reach) / _CELLS, 1.0), acting) / slowest
        slip[left] = np.minimum((slip[left] + _STEP * np.maximum(rate, 0.0)) * (1.0 + _ROUNDING), 1.0)
    return np.asarray(safe)
