"""Stability conditions of the sliding-mode laws: the published law, its robust variants, the effect of the actuator.

Imports `simulation` and the rooms below. Begin with `joint_verification`, which collects all conditions of a law as
`verdict.Condition` records; `report/verification.py` writes their texts.

- `published_law`, `robust`: conditions without the actuator, as in the paper's proof; `reaching` has the gain bound.
- `relay_loop`, `actuator_effects`: the linear loop with the actuator; its effect on the wheel and on the largest gains.
- `predictive`: conditions of the law that accounts for the actuator, over boxes, by the interval arithmetic of `boxes`.
- `no_lock`: certifies torques from which a released wheel does not lock.
- `rails`: adhesion law, rails and reference slips of a verification.
- `fixed_step`, `fixed_step_kernel`: simulation of the laws with and without actuator.
- `lyapunov_runs`: evaluates the conditions along braking runs.
"""
