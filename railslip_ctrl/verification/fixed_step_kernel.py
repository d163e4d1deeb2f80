"""Kernel that simulates the published law on the wheel in fixed steps by Heun's method, one run after another.

The law computes a torque once a step. The torque acts at once, or after a dead time of whole steps and a lag.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from railslip_ctrl.model.kernels import adhesion_force, compiled, entry, lag_rate, law_control, rates, rest_state

# columns of a row
SPEED, SIGMA, SURFACE, THETA1, THETA2, TORQUE = range(6)
COLUMNS = 6

RADIUS = 3  # index of the wheel's radius among the plant's parameters


class Settings(NamedTuple):
    """Settings of all runs, SI. `delay` is the dead time in steps; `low1` to `high2` are bounds of theta_hat."""

    step: float
    delay: int
    lag: float
    reference: float
    frozen: bool
    end_speed: float
    slip_limit: float
    largest_slip: float
    fraction: float
    decay: float
    frequency: float
    low1: float
    high1: float
    low2: float
    high2: float


@compiled
def law_torque(v, sigma, z, noise, p, table):
    """Return the law's adhesion torque, N*m: the true one plus the change of steady-state adhesion by the noise."""
    force = adhesion_force(v, sigma, z, 0.0, 0.0, 0.0, p, table)
    if noise != 0.0:
        for x, sign in ((sigma + noise, 1.0), (sigma, -1.0)):
            rest = rest_state(v, x, 0.0, 0.0, 0.0, 0.0, p, table)
            force += sign * adhesion_force(v, x, rest, 0.0, 0.0, 0.0, p, table)
    return p[RADIUS] * force


@compiled
def all_rates(v, sigma, z, torque, command, share, Tr, p, table, given):
    """Return v' (0 at frozen speed), sigma', z' and Tb' (0 without lag); `share`: disturbance over acting torque."""
    Tb = torque if given.lag > 0.0 else command
    v_rate, sigma_rate, z_rate = rates(v, sigma, z, Tb, share * Tb, Tr, p, table)
    torque_rate = lag_rate(torque, command, given.lag) if given.lag > 0.0 else 0.0
    return (0.0 if given.frozen else v_rate), sigma_rate, z_rate, torque_rate


@entry
def run(rows, start, force, noise, plants, change, given, law, table):
    """Simulate the runs, and write each step up to the end of the stop into `rows` (runs, steps, `COLUMNS`).

    - start: v, sigma, z and the torque before the run; theta_hat starts at 0.
    - force, noise: random force, N, and noise of the slip velocity, m/s, (runs, steps).
    - plants: plant parameters before step `change`, and from step `change` on.
    - law: values of the generated `Parameters`.

    Returns the index of the first run that leaves the domain of the adhesion law or exceeds the largest slip; else -1.
    """
    h, n = given.step, given.delay + 1
    commands = np.empty(n)
    for k in range(rows.shape[0]):
        v, sigma, z, torque = start[0], start[1], start[2], start[3]
        commands[:] = torque
        theta1 = theta2 = e_integral = 0.0
        for i in range(rows.shape[1]):
            if v <= given.end_speed:
                break
            row = rows[k, i]
            row[SPEED], row[SIGMA] = v, sigma
            if not abs(sigma) < min(given.slip_limit, given.largest_slip * v):
                return k
            p = plants[0] if i < change else plants[1]
            Tr = p[RADIUS] * force[k, i]
            v_rate = all_rates(v, sigma, z, 0.0, 0.0, 0.0, Tr, p, table, given)[0]  # does not depend on the torque
            Ta = law_torque(v, sigma, z, noise[k, i], p, table)
            measured = sigma + noise[k, i]
            e = given.reference * v - measured
            omega = (v - measured) / p[RADIUS]
            asked, s, rate1, rate2 = law_control(e, e_integral, omega, Ta, v_rate, theta1, theta2, law)
            commands[i % n] = asked
            command = 0.5 * (commands[(i + 1) % n] + commands[(i + 2) % n])  # mean of the delayed command over the step
            if given.lag == 0.0:
                torque = command
            row[SURFACE], row[THETA1], row[THETA2], row[TORQUE] = s, theta1, theta2, torque
            share = given.fraction * math.exp(-given.decay * i * h) * math.sin(given.frequency * i * h)
            a, b, c, d = all_rates(v, sigma, z, torque, command, share, Tr, p, table, given)
            a2, b2, c2, d2 = all_rates(
                v + h * a, sigma + h * b, z + h * c, torque + h * d, command, share, Tr, p, table, given
            )
            v, sigma, z = v + 0.5 * h * (a + a2), sigma + 0.5 * h * (b + b2), z + 0.5 * h * (c + c2)
            torque += 0.5 * h * (d + d2)
            e_integral += 0.5 * h * (e + given.reference * v - sigma - noise[k, i])
            theta1 = min(max(theta1 + h * rate1, given.low1), given.high1)
            theta2 = min(max(theta2 + h * rate2, given.low2), given.high2)
    return -1
