"""Which stability claims hold: of the published sliding-mode law, of robust variants, and behind the brake actuator.

`joint_verification` decides all conditions of a law, each a `verdict.Condition`: numbers, which `report.verification`
words. Without the actuator, as the paper's proof assumes: `published_law`, `robust`, on the bound of `reaching`. Behind
it: `relay_loop` is what the relay sees, `limit_cycles` its oscillation, `actuator_effects` what is left of the gains;
`layered` is a design that accounts for it, `layered_conditions` its conditions. Both run on `fixed_step`, with the
actuator and without; `lyapunov_runs` judges braking runs. Imports `simulation` and the rooms below. Begin with
`joint_verification`.
"""
