"""One sample of a linear controller: its difference equations, limits and anti-windup.

The only statement of them: Python calls it, and the text of this module is compiled into the loop of a braking run.
"""

from __future__ import annotations

import math

from railslip_ctrl.model.kernels import compiled


@compiled
def linear_step(x, c, at, error, applied):
    """The torque to command until the next sample, N*m; changes the state `x`.

    x: n states, the error before (m/s), the torque before its limits (N*m), and room for n numbers. c from `at` on:
    n, limits (N*m), d, and of n each the output's weights, those of the error now and before, and those of what the
    brake took less what was asked (back-calculation); then the n by n transition, by rows. `applied` is the command
    that the brake took since the sample before, N*m. A sample that is not finite is skipped.
    """
    if not math.isfinite(error):
        return applied
    n = int(c[at])
    weights, room = at + 4, n + 2
    excess = applied - x[n + 1]
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += c[weights + (4 + i) * n + j] * x[j]
        now, before, tracking = c[weights + n + i], c[weights + 2 * n + i], c[weights + 3 * n + i]
        x[room + i] = total + (now * error + before * x[n] + tracking * excess)
    torque = c[at + 3] * error
    for i in range(n):
        x[i] = x[room + i]
        torque += c[weights + i] * x[i]
    x[n], x[n + 1] = error, torque
    return min(max(torque, c[at + 1]), c[at + 2])
