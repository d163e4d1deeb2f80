"""The generated sliding-mode law, fed with Ta of the adhesion law it assumes, at the measured slip velocity at rest.

c: reference slip, radius, the numbers of the generated `Parameters` in order, then those of the assumed plant and law.
x: s, then the generated `State`.
"""

from __future__ import annotations

from railslip_ctrl.model.kernels import assumed_torque, compiled, law_parameters, law_state, step, store_state

FIRST = 2  # place of the law's numbers in c


@compiled
def command(x, t, v, omega, applied, c, table):
    """See the package of the steps."""
    p = law_parameters(c, FIRST)
    # floats: the generated law, run in the interpreter, counts with them and not with NumPy's
    torque, s, state = step(law_state(x), float(v), float(omega), float(assumed_torque(v, omega, c, table)), p)
    x[0] = s
    store_state(x, state)
    return torque
