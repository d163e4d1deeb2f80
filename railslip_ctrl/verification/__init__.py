"""Stability conditions of the sliding-mode laws: the published law, its robust variants, the effect of the actuator.

Imports `simulation`, `design`, `controllers`, `sliding`, `loop`, `model` and `core`. Begin with `joint_verification`,
which collects all conditions of a law as `verdict.Condition` records. `report/verification.py` writes their texts.

- `published_law`, `robust`: conditions without the actuator, as in the proof of [Park2008].
- `reaching`: least switching gain with which the reaching condition, [Park2008] (40), holds over a box of operating
  points.
- `relay_loop`: the linear loop with the actuator.
- `actuator_effects`: effect of the actuator on the motion of the wheel and on the largest stable gains.
- `predictive`: conditions over boxes for the law that accounts for the actuator.
- `boxes`: interval arithmetic for `predictive` and `no_lock`.
- `no_lock`: certified torques from which a released wheel does not lock.
- `rails`: adhesion law, rails and reference slips of a verification.
- `fixed_step`, `fixed_step_kernel`: simulation of the laws with and without actuator.
- `lyapunov_runs`: evaluation of V, V' and the reaching condition along braking runs.
"""
