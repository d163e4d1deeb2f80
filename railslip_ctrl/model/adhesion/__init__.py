"""Adhesion laws, one a module: parameters, domain, dry and wet, and the equations in SymPy.

To add a law, add a module with a subclass of `AdhesionLaw`; it is found by itself.
"""

from .base import INITIAL_SPEED_RANGE_KMH, RIG_WHEEL_LOAD, AdhesionLaw, Kink, ReferenceSlip, Statement
from .registry import (
    initial_speeds_in,
    is_over_initial_speed,
    law_class,
    law_classes,
    law_in,
    law_names,
    load_law,
    published_law,
    wheel_load_in,
)

__all__ = [
    "INITIAL_SPEED_RANGE_KMH",
    "RIG_WHEEL_LOAD",
    "AdhesionLaw",
    "Kink",
    "ReferenceSlip",
    "Statement",
    "initial_speeds_in",
    "is_over_initial_speed",
    "law_class",
    "law_classes",
    "law_in",
    "law_names",
    "load_law",
    "published_law",
    "wheel_load_in",
]
