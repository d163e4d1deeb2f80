"""Identify an adhesion law from a log of a brake rig or a train: `railslip identify`.

Begin with `identify`. `observer` has observers of the adhesion torque and models of sensors; `virtual_rig` simulates a
brake rig whose adhesion law is known.
"""
