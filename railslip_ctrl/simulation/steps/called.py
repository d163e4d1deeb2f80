"""A step that is called where it is: a user's Python object or Numba function.

c: reference slip, radius, address of the function.
x: the function's own numbers.
"""

from __future__ import annotations

from railslip_ctrl.model.kernels import compiled
from railslip_ctrl.simulation.step_calls import call_step


@compiled
def command(x, t, v, omega, applied, c, table):
    """See the package of the steps."""
    return call_step(c[2], t, v, omega, x)
