"""The plant in fixed steps, run as text in a kernel: without an actuator and with the law in the loop, or behind one.

`run`: the derived law at once on the plant, one run after another; the torque is computed once a step and held, the
plant integrated by Heun's method. `advance`: a step of classical Runge-Kutta behind the lag, under a given command.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from railslip_ctrl.model.kernels import (
    adhesion_force,
    compiled,
    entry,
    lag_rate,
    law_control,
    rates,
    rest_state,
)

# columns of a row
SPEED, SIGMA, SURFACE, THETA1, THETA2, TORQUE = range(6)
COLUMNS = 6

RADIUS = 3  # place of the wheel's radius among the plant's parameters


class IdealSettings(NamedTuple):
    """What holds for all runs without an actuator; SI."""

    step: float
    reference: float
    frozen: bool
    end_speed: float
    slip_limit: float
    fraction: float
    decay: float
    frequency: float
    low1: float
    high1: float
    low2: float
    high2: float


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
def plant_rates(v, sigma, z, Tb, Td, Tr, p, table, frozen):
    """The plant's; v' = 0 where the speed is frozen."""
    v_rate, sigma_rate, z_rate = rates(v, sigma, z, Tb, Td, Tr, p, table)
    return (0.0 if frozen else v_rate), sigma_rate, z_rate


@entry
def run(rows, start, force, noise, plants, change, given, law, table):
    """Fill rows (runs, steps, `COLUMNS`), given as NaN, to the end of each stop; the slip velocity that left the law's
    domain, m/s, 0 if none did.

    start: v, sigma, z; theta_hat starts at 0. force, N, and noise, m/s: (runs, steps). plants: the parameters before
    and from step `change` on. law: numbers of the generated `Parameters`.
    """
    h, frozen = given.step, given.frozen
    for k in range(rows.shape[0]):
        v, sigma, z = start[0], start[1], start[2]
        theta1 = theta2 = e_integral = 0.0
        for i in range(rows.shape[1]):
            p = plants[0] if i < change else plants[1]
            if not abs(sigma) < given.slip_limit:
                return sigma
            if v <= given.end_speed:
                break
            Tr = p[RADIUS] * force[k, i]
            v_rate = plant_rates(v, sigma, z, 0.0, 0.0, Tr, p, table, frozen)[0]
            Ta = law_torque(v, sigma, z, noise[k, i], p, table)
            measured = sigma + noise[k, i]
            e = given.reference * v - measured
            omega = (v - measured) / p[RADIUS]
            Tb, s, rate1, rate2 = law_control(e, e_integral, omega, Ta, v_rate, theta1, theta2, law)
            t = i * h
            Td = given.fraction * Tb * math.exp(-given.decay * t) * math.sin(given.frequency * t)
            row = rows[k, i]
            row[SPEED], row[SIGMA], row[SURFACE] = v, sigma, s
            row[THETA1], row[THETA2], row[TORQUE] = theta1, theta2, Tb
            a, b, c = plant_rates(v, sigma, z, Tb, Td, Tr, p, table, frozen)
            a2, b2, c2 = plant_rates(v + h * a, sigma + h * b, z + h * c, Tb, Td, Tr, p, table, frozen)
            v, sigma, z = v + 0.5 * h * (a + a2), sigma + 0.5 * h * (b + b2), z + 0.5 * h * (c + c2)
            e_integral += 0.5 * h * (e + given.reference * v - sigma - noise[k, i])
            theta1 = min(max(theta1 + h * rate1, given.low1), given.high1)
            theta2 = min(max(theta2 + h * rate2, given.low2), given.high2)
    return 0.0


@compiled
def moved(state, rate, h):
    """The state after a step along a rate."""
    return state[0] + h * rate[0], state[1] + h * rate[1], state[2] + h * rate[2], state[3] + h * rate[3]


@compiled
def all_rates(state, command, load, lag, frozen, p, table):
    """v', sigma', z', Tb'; without a lag the command acts at once."""
    v, sigma, z, torque = state
    Tb = torque if lag > 0.0 else command
    v_rate, sigma_rate, z_rate = plant_rates(v, sigma, z, Tb, load, 0.0, p, table, frozen)
    return v_rate, sigma_rate, z_rate, lag_rate(torque, command, lag) if lag > 0.0 else 0.0


@entry
def advance(v, sigma, z, torque, command, now, middle, end, h, lag, frozen, p, table):
    """State and v' after h seconds, the command held; now, middle, end: what else loads the wheel then, N*m."""
    state = (v, sigma, z, torque)
    k1 = all_rates(state, command, now, lag, frozen, p, table)
    k2 = all_rates(moved(state, k1, 0.5 * h), command, middle, lag, frozen, p, table)
    k3 = all_rates(moved(state, k2, 0.5 * h), command, middle, lag, frozen, p, table)
    k4 = all_rates(moved(state, k3, h), command, end, lag, frozen, p, table)
    mean = (
        (k1[0] + 2.0 * k2[0] + 2.0 * k3[0] + k4[0]) / 6.0,
        (k1[1] + 2.0 * k2[1] + 2.0 * k3[1] + k4[1]) / 6.0,
        (k1[2] + 2.0 * k2[2] + 2.0 * k3[2] + k4[2]) / 6.0,
        (k1[3] + 2.0 * k2[3] + 2.0 * k3[3] + k4[3]) / 6.0,
    )
    after = moved(state, mean, h)
    v_rate = all_rates(after, 0.0, end, lag, frozen, p, table)[0]  # of every torque the same
    return after[0], after[1], after[2], after[3], v_rate
