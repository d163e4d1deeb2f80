"""A torque given over time: open loop, as on a test rig.

c: reference slip, radius, number of points n, n times (s), n torques (N*m); linear in between, constant outside.
"""

from __future__ import annotations

from railslip_ctrl.model.kernels import compiled


@compiled
def command(x, t, v, omega, applied, c, table):
    """See the package of the steps."""
    n = int(c[2])
    if t >= c[2 + n]:
        return c[2 + 2 * n]
    for i in range(n - 1):
        if t < c[4 + i]:
            share = (t - c[3 + i]) / (c[4 + i] - c[3 + i])
            return c[3 + n + i] + max(share, 0.0) * (c[4 + n + i] - c[3 + n + i])
    return c[2 + 2 * n]
