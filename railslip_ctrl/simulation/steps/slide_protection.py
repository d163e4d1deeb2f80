"""Rule-based slide protection: the valve dumps, holds or fills by slip and by the wheel's deceleration.

c: reference slip (unused), radius, slip to dump above, slip to fill below, wheel deceleration to dump above (m/s^2),
rate of filling and of dumping (N*m/s), largest torque (N*m), period (s), time constant of the deceleration's filter.
x: torque asked for, filtered wheel speed r omega, whether it has started, what the valve does (-1, 0, 1).
"""

from __future__ import annotations

from railslip_ctrl.model.kernels import compiled


@compiled
def command(x, t, v, omega, applied, c, table):
    """See the package of the steps."""
    rim = c[1] * omega
    if x[2] == 0.0:
        x[1], x[2] = rim, 1.0
    blend = c[8] / (c[8] + c[9])
    deceleration = (x[1] - rim) / (c[8] + c[9])
    x[1] += blend * (rim - x[1])
    slip = (v - rim) / v if v > 0.0 else 0.0
    if slip > c[2] or deceleration > c[4]:
        x[3] = -1.0
    elif slip < c[3]:
        x[3] = 1.0
    else:
        x[3] = 0.0
    if x[3] < 0.0:
        x[0] -= c[6] * c[8]
    elif x[3] > 0.0:
        x[0] += c[5] * c[8]
    x[0] = min(max(x[0], 0.0), c[7])
    return x[0]
