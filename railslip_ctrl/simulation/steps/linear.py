"""The step of `design.sampled.SampledController`: a PI, with or without a lead, and back-calculation.

c: reference slip, radius, kp, p, q0, q1, weights of the filtered error now and before, h/Tt, torque limits, speed below
which slip is no longer controlled, torque commanded there.
x: integral, error, filtered error, unlimited torque.
"""

from __future__ import annotations

import math

from railslip_ctrl.kernels.slots import compiled


@compiled
def command(x, t, v, omega, applied, c, table):
    """See the package of the steps."""
    if v < c[11]:
        return c[12]
    error = c[0] * v - (v - c[1] * omega)
    if not math.isfinite(error):
        return applied
    filtered = c[3] * x[2] + c[4] * error + c[5] * x[1]
    x[0] += c[6] * filtered + c[7] * x[2] + c[8] * (applied - x[3])
    x[1], x[2] = error, filtered
    x[3] = c[2] * filtered + x[0]
    return min(max(x[3], c[9]), c[10])
