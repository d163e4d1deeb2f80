"""The published vehicle and gains of [Park2008], in SI."""

from __future__ import annotations

from types import MappingProxyType
from typing import NamedTuple

from railslip_ctrl.core.arguments import checked

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


class PrintedPI(NamedTuple):
    """PI gains as Table 4 prints them: Kp in "N-h", Ki in "N"; read as N*m per km/h and N*m per km/h per s."""

    Kp: float
    Ki: float


class PrintedSliding(NamedTuple):
    """Sliding-mode gains as Table 4 prints them: D and rho in "1/h", K in "km/h^2", k without a unit.

    Read as D in N*m per km/h and K in N*m, both added to the torque, rho in 1/s, and k with s in km/h, Ta in N*m and
    omega = v_kmh/r.
    """

    D: float
    K: float
    rho: float
    k: float


TABLE4_PI_PRINTED = MappingProxyType({"beam": PrintedPI(400.0, 54.0), "bristle": PrintedPI(650.0, 27.0)})
"""[Park2008] Table 4, PI, by column, as printed."""

TABLE4_SLIDING_PRINTED = MappingProxyType(
    {"beam": PrintedSliding(1.62, 70.0, 1.65, 2.1e-8), "bristle": PrintedSliding(1.53, 70.0, 1.54, 2.1e-8)}
)
"""[Park2008] Table 4, ASMC, by column, as printed."""

# 1 km/h = 1/3.6 m/s
TABLE4_PI = MappingProxyType(
    {name: PIGains(kp=3.6 * gains.Kp, ki=3.6 * gains.Ki) for name, gains in TABLE4_PI_PRINTED.items()}
)
"""Table 4's PI gains by column, in SI (N*m/(m/s) and N*m/m)."""


@checked
def table4_gains(adhesion: str) -> PIGains:
    """Table 4's PI gains, SI, for an `adhesion` law by name: the beam's own column, else the bristle column."""
    return TABLE4_PI["beam" if adhesion == "beam" else "bristle"]
