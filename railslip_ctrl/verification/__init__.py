"""What holds of a sliding law: its conditions, limit cycles behind the actuator, Lyapunov functions along runs.

Imports `simulation` and what is below. A newcomer begins with `conditions`.
"""
