"""The loop of `ideal_loop`, run as text in a kernel: the derived law at once on the plant, one run after another.

The torque is computed once a step and held; the plant is integrated by Heun's method.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from railslip_ctrl.model.kernels import (
    adhesion_force,
    compiled,
    entry,
    law_control,
    law_parameters,
    rates,
    rest_state,
)

# columns of a row
SPEED, SIGMA, SURFACE, THETA1, THETA2, TORQUE = range(6)
COLUMNS = 6


class IdealSettings(NamedTuple):
    """What holds for all runs; SI."""

    step: float
    reference: float
    held: bool
    end_speed: float
    slip_limit: float
    fraction: float
    decay: float
    frequency: float
    low1: float
    high1: float
    low2: float
    high2: float


RADIUS = 3  # place of the wheel's radius among the plant's parameters


@compiled
def law_torque(v, sigma, z, noise, p, table):
    """Ta of the law, N*m: the true one, moved by what the noise moves the model at rest."""
    force = adhesion_force(v, sigma, z, 0.0, 0.0, 0.0, p, table)
    if noise != 0.0:
        for x, sign in ((sigma + noise, 1.0), (sigma, -1.0)):
            rest = rest_state(v, x, 0.0, 0.0, 0.0, 0.0, p, table)
            force += sign * adhesion_force(v, x, rest, 0.0, 0.0, 0.0, p, table)
    return p[RADIUS] * force


@compiled
def plant_rates(v, sigma, z, Tb, Td, Tr, p, table, held):
    """The plant's; v' = 0 where the speed is held."""
    v_rate, sigma_rate, z_rate = rates(v, sigma, z, Tb, Td, Tr, p, table)
    return (0.0 if held else v_rate), sigma_rate, z_rate


@entry
def run(rows, start, force, noise, plants, change, given, law, table):
    """Fill rows (runs, steps, `COLUMNS`), given as NaN, to the end of each stop; the slip velocity that left the law's
    domain, m/s, 0 if none did.

    start: v, sigma, z, theta1_hat, theta2_hat. force, N, and noise, m/s: (runs, steps). plants: the parameters before
    and from step `change` on. law: numbers of the generated `Parameters`.
    """
    h, held = given.step, given.held
    parameters = law_parameters(law, 0)
    for k in range(rows.shape[0]):
        v, sigma, z, theta1, theta2 = start[0], start[1], start[2], start[3], start[4]
        e_integral = 0.0
        for i in range(rows.shape[1]):
            p = plants[0] if i < change else plants[1]
            if not abs(sigma) < given.slip_limit:
                return sigma
            if v <= given.end_speed:
                break
            Tr = p[RADIUS] * force[k, i]
            v_rate = plant_rates(v, sigma, z, 0.0, 0.0, Tr, p, table, held)[0]
            Ta = law_torque(v, sigma, z, noise[k, i], p, table)
            measured = sigma + noise[k, i]
            e = given.reference * v - measured
            omega = (v - measured) / p[RADIUS]
            Tb, s, rate1, rate2 = law_control(e, e_integral, omega, Ta, v_rate, theta1, theta2, parameters)
            t = i * h
            Td = given.fraction * Tb * math.exp(-given.decay * t) * math.sin(given.frequency * t)
            row = rows[k, i]
            row[SPEED], row[SIGMA], row[SURFACE], row[THETA1], row[THETA2], row[TORQUE] = (
                v,
                sigma,
                s,
                theta1,
                theta2,
                Tb,
            )
            a, b, c = plant_rates(v, sigma, z, Tb, Td, Tr, p, table, held)
            a2, b2, c2 = plant_rates(v + h * a, sigma + h * b, z + h * c, Tb, Td, Tr, p, table, held)
            v, sigma, z = v + 0.5 * h * (a + a2), sigma + 0.5 * h * (b + b2), z + 0.5 * h * (c + c2)
            e_integral += 0.5 * h * (e + given.reference * v - sigma - noise[k, i])
            theta1 = min(max(theta1 + h * rate1, given.low1), given.high1)
            theta2 = min(max(theta2 + h * rate2, given.low2), given.high2)
    return 0.0
