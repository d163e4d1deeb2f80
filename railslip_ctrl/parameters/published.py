"""The published vehicle and gains of [Park2008], in SI."""

from __future__ import annotations

from types import MappingProxyType

from .records import Actuator, PIGains, Resistance, Vehicle, Wheel

INITIAL_SPEED_KMH = 100.0
"""v0, the speed at which the brake is applied, of the published run ([Park2008] p. 55)."""

AS_PUBLISHED_INERTIA_SCALE = 3.6
"""The inertia scale under which the published results come out: speeds in km/h, forces in N, no factor."""

PARK2008 = Vehicle(
    name="Park et al. 2008, quarter car",
    mass=3517.0,
    mass_loaded=5276.0,
    wheel_load=34_500.0,
    wheel_load_loaded=34_500.0,  # [Park2008] does not change N with M
    wheel=Wheel(radius=0.43, inertia=60.35, viscous_friction=0.25),
    resistance=Resistance(quadratic=0.63),
    actuator=Actuator(dead_time=0.15, lag=0.6),
    source="[Park2008] Tables 1 and 2, p. 55",
)

# [Park2008] Table 4, printed "N-h" and "N", read as N*m per km/h and N*m per km/h per s: 1 km/h = 1/3.6 m/s.
TABLE4_PI = MappingProxyType(
    {
        "beam": PIGains(kp=3.6 * 400.0, ki=3.6 * 54.0),
        "bristle": PIGains(kp=3.6 * 650.0, ki=3.6 * 27.0),
    }
)
"""Table 4's PI gains by column, in SI (N*m/(m/s) and N*m/m)."""


def table4_gains(adhesion: str) -> PIGains:
    """Table 4's PI gains for an adhesion law by name, SI: the beam's own column, the bristle column for any other."""
    return TABLE4_PI["beam" if adhesion == "beam" else "bristle"]
