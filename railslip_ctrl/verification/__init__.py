"""Stability conditions of the sliding-mode laws: the published law, its robust variants, the effect of the actuator.

Imports `simulation`, `design`, `controllers`, `sliding`, `loop`, `model` and `core`. Begin with `joint_verification`,
which collects all conditions of a law as `verdict.Condition` records. `report/verification.py` writes their texts.
"""
