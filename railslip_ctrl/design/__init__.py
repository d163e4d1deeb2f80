"""Controllers, and gains computed for the plants at hand. Knows nothing of simulation."""

from .controllers import PIController, actuated_plant, wheel_slip_loop
from .holding import HoldingDesign, holding_gains
from .shaping import gain_for_crossover, most_phase

__all__ = [
    "HoldingDesign",
    "PIController",
    "actuated_plant",
    "gain_for_crossover",
    "holding_gains",
    "most_phase",
    "wheel_slip_loop",
]
