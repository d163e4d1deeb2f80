"""Frozen parameter records, published sets, and files."""

from .files import load_vehicle
from .plausibility import doubts, remarks
from .published import (
    AS_PUBLISHED_INERTIA_SCALE,
    INITIAL_SPEED_KMH,
    PARK2008,
    TABLE4_PI,
    TABLE4_PI_PRINTED,
    TABLE4_SLIDING_PRINTED,
    table4_gains,
)
from .records import GRAVITY, Actuator, PIGains, Rail, Record, Resistance, Vehicle, Wheel

__all__ = [
    "AS_PUBLISHED_INERTIA_SCALE",
    "GRAVITY",
    "INITIAL_SPEED_KMH",
    "PARK2008",
    "TABLE4_PI",
    "TABLE4_PI_PRINTED",
    "TABLE4_SLIDING_PRINTED",
    "Actuator",
    "PIGains",
    "Rail",
    "Record",
    "Resistance",
    "Vehicle",
    "Wheel",
    "doubts",
    "load_vehicle",
    "remarks",
    "table4_gains",
]
