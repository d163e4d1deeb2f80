"""A linear controller, `design.difference.linear_step`.

c: reference slip, radius, speed below which slip is no longer controlled, torque commanded there, then the numbers of
the difference equations.
x: what they remember.
"""

from __future__ import annotations

from railslip_ctrl.design.difference import linear_step
from railslip_ctrl.model.kernels import compiled


@compiled
def command(x, t, v, omega, applied, c, table):
    """See the package of the steps."""
    if v < c[2]:
        return c[3]
    return linear_step(x, c, 4, c[0] * v - (v - c[1] * omega), applied)
