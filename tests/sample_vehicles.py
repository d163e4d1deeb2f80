"""Vehicles that tests design for."""

from railslip_ctrl.model.vehicle import GRAVITY, Actuator, Resistance, Vehicle, Wheel

COACH = Vehicle(
    name="Coach, quarter car",
    mass=11_000.0,
    mass_loaded=17_437.0,
    wheel_load=11_000.0 * GRAVITY,
    wheel_load_loaded=17_437.0 * GRAVITY,  # 171 kN
    wheel=Wheel(radius=0.46, inertia=90.0, viscous_friction=0.25),
    resistance=Resistance(constant=100.0, quadratic=0.6),
    actuator=Actuator(dead_time=0.12, lag=0.4),
)
"""A four-axle coach whose load, brake and wheel all differ from those of the published vehicle."""
