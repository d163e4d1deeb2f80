"""Torques from which a released wheel certainly does not lock.

The brake is released now: the acting torque stays for the dead time and then decays with the lag. From (3) and (4)

    v slip' = -(1 - slip)(Fa + Fr)/M + (r/J)(B omega + (1 + c) T - r Fa),

which falls with Fa. The slip is therefore below the solution with the least adhesion of each cell of slip and speed,
less the random force's bound, and the caliper's share c of the torque against the wheel. That equation is stepped with
the largest rate over each step. The least adhesion comes from balls; the arithmetic after it is in floats, whose
rounding `_ROUNDING` covers. It is a certificate of no lock, not of convergence.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from flint import arb
from numpy.lib.stride_tricks import sliding_window_view

from railslip_ctrl.core.arguments import Floats
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion import AdhesionLaw
from railslip_ctrl.model.vehicle import Vehicle

from .boxes import adhesion_on_balls, ball, upper
from .reaching import ADHESION_NOISE, TORQUE_FRACTION

SIGMAS = 3.0  #: bound of the random force, standard deviations
_CELLS, _SPEEDS = 512, 6  # cells of slip from 0 to 1, and of speed: the least adhesion of a cell is within 2 %
_STEP = 0.0025  # s: the largest rate over a step costs 0.1 kN*m of the largest torque
_LONGEST = 4.0  # s, after which a wheel that still slips more counts as not certified
_LEAST_SPEED = 1.0  # m/s, below which nothing is certified
_ROUNDING = 1e-9  # relative, of a rate: a million times the rounding of its some twenty operations
_ROUNDS, _TRIED = 2, 51  # torques tried at once, twice: the largest to 1/2500 of the range


@dataclass(frozen=True)
class NoLock:
    """Largest certified acting torque, N*m, by speed (km/h) and slip; shape (speeds, slips). 0: none is certified."""

    speeds_kmh: Floats
    slips: Floats
    torque: Floats


def bounded_adhesion(law: AdhesionLaw, vehicle: Vehicle, speed: float) -> tuple[Floats, float]:
    """Lower bounds of Fa, N, by cells of slip from 0 to 1, at every speed from `_LEAST_SPEED` to `speed`, m/s; and the
    upper bound of all. The least of cells where the law ends is 0, the largest the wheel load.
    """
    enclosed, load = adhesion_on_balls(law), arb(vehicle.wheel_load)
    edges = np.linspace(_LEAST_SPEED, speed, _SPEEDS + 1)
    found, most = np.empty(_CELLS), 0.0
    for i in range(_CELLS):
        slip = ball(max(i / _CELLS, 1e-6), (i + 1) / _CELLS)
        forces = [enclosed(ball(*ends), slip, load)[0] for ends in pairwise(edges.tolist())]
        found[i] = min(-upper(-one) if one.is_finite() else 0.0 for one in forces)
        most = max(most, *(min(upper(one), vehicle.wheel_load) for one in forces))
    return np.maximum(found, 0.0), most


def no_lock(law: AdhesionLaw, vehicle: Vehicle, speeds_kmh: Floats, slips: Floats, *, torque_max: float) -> NoLock:
    """Certify torques up to `torque_max`, N*m, on a grid of speeds, km/h, and slips."""
    largest = [
        _largest(bounded_adhesion(law, vehicle, kmh * KMH), vehicle, kmh * KMH, np.asarray(slips, float), torque_max)
        for kmh in speeds_kmh
    ]
    return NoLock(np.asarray(speeds_kmh, float), np.asarray(slips, float), np.array(largest))


def _largest(force: tuple[Floats, float], vehicle: Vehicle, speed: float, slips: Floats, torque_max: float) -> Floats:
    low, width = np.zeros(slips.size), torque_max
    for _ in range(_ROUNDS):
        tried = low[:, None] + width * np.linspace(0.0, 1.0, _TRIED)
        every = np.repeat(slips, _TRIED)
        holds = certain(force, vehicle, speed, every, tried.ravel()).reshape(tried.shape)
        # up to the first that is not certain; 0 where none is
        count = np.argmin(np.column_stack((holds, np.zeros(slips.size, bool))), axis=1)
        low = np.where(count > 0, tried[np.arange(slips.size), np.maximum(count - 1, 0)], 0.0)
        width /= _TRIED - 1
    return low


def certain(force: tuple[Floats, float], vehicle: Vehicle, speed: float, slips: Floats, torques: Floats) -> Floats:
    """Whether wheels at a speed, m/s, at slips, under acting torques, N*m, certainly do not lock; shape (n,).

    force: `bounded_adhesion`.
    """
    J, M, r = vehicle.effective_inertia, vehicle.effective_mass, vehicle.wheel.radius
    noise = SIGMAS * ADHESION_NOISE * vehicle.wheel_load
    weakest = force[0] - noise
    friction = vehicle.effective_viscous_friction * speed / r  # B omega at most
    falling = (force[1] + noise + vehicle.resistance.force(speed)) / M

    def numerator(least: Floats, end: Floats, torque: Floats) -> Floats:
        """Largest v slip', m/s^2, with at least this adhesion, N, and at most this slip."""
        train = -(1.0 - np.where(least > 0.0, end, 0.0)) * least / M
        wheel = r / J * (friction + (1.0 + TORQUE_FRACTION) * torque - r * least)
        return np.asarray(train + wheel + _ROUNDING * (np.abs(train) + r / J * (friction + torque + r * np.abs(least))))

    slip, safe, lost = slips.copy(), np.zeros(slips.size, bool), np.zeros(slips.size, bool)
    actuator = vehicle.actuator
    for n in range(round(_LONGEST / _STEP)):
        t = n * _STEP
        acting = torques * (1.0 if t <= actuator.dead_time else np.exp(-(t - actuator.dead_time) / actuator.lag))
        slowest = speed - falling * (t + _STEP)
        lost |= slip >= 1.0 - 1.0 / _CELLS
        if slowest < _LEAST_SPEED or np.all(safe | lost):
            break
        cell = np.minimum((slip * _CELLS).astype(int), _CELLS - 1)
        # from here on the torque falls: a rate below 0 over the cell keeps the slip below the cell's upper end
        safe |= ~lost & (numerator(weakest[cell], (cell + 1) / _CELLS, acting) < 0.0)
        # over the step the slip stays within the cells that the largest rate at all can reach
        steepest = float(np.max(numerator(np.full(slips.size, np.min(weakest)), np.ones(slips.size), acting)))
        reach = int(_STEP * max(steepest, 0.0) / slowest * _CELLS) + 2
        ahead = np.min(sliding_window_view(np.append(weakest, np.full(reach - 1, np.inf)), reach), axis=1)
        rate = numerator(ahead[cell], np.minimum((cell + reach) / _CELLS, 1.0), acting) / slowest
        slip = np.where(safe, slip, np.minimum((slip + _STEP * np.maximum(rate, 0.0)) * (1.0 + _ROUNDING), 1.0))
    return np.asarray(safe)
