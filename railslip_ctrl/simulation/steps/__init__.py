"""Controllers' steps, run as text inside a kernel: one controller a file, one function `command`.

`command(x, t, v, omega, applied, c, table)` gives the torque asked for, N*m, from the measured train speed (m/s) and
wheel speed (rad/s) at time t (s), and changes the controller's own state `x` in place. `applied` is the command of the
previous sample after the limits, N*m. `c` is the controller's row of numbers: c[0] is its reference slip ratio,
c[1] the wheel radius, c[-1] the scenario's reference, the rest its own. `table` belongs to the adhesion law it
assumes, if any.
"""
