"""Stability conditions of the sliding-mode laws: the published law, its robust variants, the effect of the actuator.

Imports `simulation`, `design`, `controllers`, `sliding`, `loop`, `model` and `core`. Begin with `joint_verification`,
which collects all conditions of a law as `verdict.Condition` records. `report/verification.py` writes their texts.

- Conditions without the actuator: `published_law` and `robust`; `reaching` computes the least switching gain.
- Conditions with the actuator: `actuator_effects` (with the linear loop `relay_loop`) and `predictive`.
- Certified torques from which a released wheel does not lock: `no_lock`, with the interval arithmetic of `boxes`.
- Simulated runs: `fixed_step`, `fixed_step_kernel`, `lyapunov_runs`. Adhesion law, rails and reference slips: `rails`.
"""
