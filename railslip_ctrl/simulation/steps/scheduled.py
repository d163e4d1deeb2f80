"""The step of `linear.py` with gains that follow the train's speed, taken over without a bump in torque.

c: reference slip, radius, p, q0, q1, weights of the filtered error now and before (s), h/Tt (below 0: h ki/kp),
period, torque limits, number of speeds n, n times speed (m/s, rising), n times kp, n times ki.
x: integral, error, filtered error, unlimited torque.
"""

from __future__ import annotations

import math

from railslip_ctrl.model.kernels import compiled


@compiled
def gains_at(v, c):
    """kp and ki at a speed: linear between the schedule's speeds, the nearest entry outside."""
    n = int(c[11])
    last = 12 + n - 1
    if v <= c[12]:
        return c[12 + n], c[12 + 2 * n]
    if v >= c[last]:
        return c[last + n], c[last + 2 * n]
    i = 12
    while v >= c[i + 1]:
        i += 1
    share = (v - c[i]) / (c[i + 1] - c[i])
    kp = c[i + n] + share * (c[i + 1 + n] - c[i + n])
    ki = c[i + 2 * n] + share * (c[i + 1 + 2 * n] - c[i + 2 * n])
    return kp, ki


@compiled
def command(x, t, v, omega, applied, c, table):
    """See the package of the steps."""
    error = c[0] * v - (v - c[1] * omega)
    if not math.isfinite(error):
        return applied
    kp, ki = gains_at(v, c)
    x[0] = x[3] - kp * x[2]  # the torque goes on from where the gains before left it
    filtered = c[2] * x[2] + c[3] * error + c[4] * x[1]
    tracking = c[7] if c[7] >= 0.0 else 1.0
    if ki == 0.0:
        tracking = 0.0
    elif c[7] < 0.0 and c[8] * abs(ki) < abs(kp):
        tracking = c[8] * abs(ki / kp)
    x[0] += ki * (c[5] * filtered + c[6] * x[2]) + tracking * (applied - x[3])
    x[1], x[2] = error, filtered
    x[3] = kp * filtered + x[0]
    return min(max(x[3], c[9]), c[10])
