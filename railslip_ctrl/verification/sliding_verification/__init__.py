"""The conditions of the sliding-mode laws together with what the actuator does to them: what `railslip verify` shows.

`sliding` decides the conditions for an actuator that acts at once, as the paper's proof assumes; `switching` analyses
the loop that lag and dead time really close. Here the second joins the first.
"""

from .rail_adhesion import PUBLISHED_ADHESION, RailAdhesion
from .together import FullVerification, Law, verify_with_actuator

__all__ = ["PUBLISHED_ADHESION", "FullVerification", "Law", "RailAdhesion", "verify_with_actuator"]
