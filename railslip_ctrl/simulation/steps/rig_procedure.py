"""The adhesion test on a brake rig: free rolling, a torque ramp, release when the slip has grown past a limit.

c: reference slip (unused), radius, time at which the ramp begins (s), its rate (N*m/s), slip to release above.
x: whether it was released.
"""

from __future__ import annotations

from railslip_ctrl.model.kernels import compiled


@compiled
def command(x, t, v, omega, applied, c, table):
    """See the package of the steps."""
    if v - c[1] * omega > c[4] * v:
        x[0] = 1.0
    if x[0] > 0.0:
        return 0.0
    return c[3] * max(t - c[2], 0.0)
