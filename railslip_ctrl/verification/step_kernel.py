"""A step of the plant behind its actuator, run as text in a kernel: classical Runge-Kutta."""

from __future__ import annotations

from railslip_ctrl.model.kernels import compiled, entry, lag_rate, rates


@compiled
def moved(state, rate, h):
    """The state after a step along a rate."""
    return state[0] + h * rate[0], state[1] + h * rate[1], state[2] + h * rate[2], state[3] + h * rate[3]


@compiled
def all_rates(state, command, load, lag, frozen, p, table):
    """v', sigma', z', Tb'; without a lag the command acts at once."""
    v, sigma, z, torque = state
    v_rate, sigma_rate, z_rate = rates(v, sigma, z, torque if lag > 0.0 else command, load, 0.0, p, table)
    return 0.0 if frozen else v_rate, sigma_rate, z_rate, lag_rate(torque, command, lag) if lag > 0.0 else 0.0


@entry
def run(v, sigma, z, torque, command, now, middle, end, h, lag, frozen, p, table):
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
