"""Which stability conditions a sliding-mode law meets: the published law, robust variants, behind the actuator.

Imports `simulation` and the rooms below. Begin with `joint_verification`, which collects all conditions of a law, each
a `verdict.Condition` of numbers; `report/verification.py` puts them into words. Without the actuator, as the paper's
proof assumes: `published_law` and `robust`, with the gain bound of `reaching`. Behind it: `relay_loop` is what the
relay sees, `actuator_effects` what it does to the wheel and what is left of the gains. `predictive` decides
the law that accounts for the actuator over boxes, by the interval arithmetic of `boxes`; `no_lock` certifies torques
from which a released wheel does not lock; `rails` is the adhesion of a verification. `fixed_step`, by
`fixed_step_kernel`, simulates the laws with the actuator and without; `lyapunov_runs` judges braking runs.
"""
