"""Controllers, and gains computed for the plants at hand. Knows nothing of simulation."""

from .controllers import PIController, actuated_plant, wheel_slip_loop
from .holding import HoldingDesign, holding_gains

__all__ = ["HoldingDesign", "PIController", "actuated_plant", "holding_gains", "wheel_slip_loop"]
