"""Controllers as systems, the envelope and the verdict over it, tuning, limits."""

from .controllers import (
    PIController,
    PolynomialController,
    StateSpaceController,
    actuated_plant,
    controller_system,
    linear_controller,
    wheel_slip_loop,
)
from .holding import HoldingDesign, holding_gains
from .region_maps import MarginGrid, Strip, margin_grid, outline
from .shaping import gain_for_crossover, most_phase
from .stabilizing import (
    BoundaryCurve,
    IntersectionRegion,
    Region,
    StabilizingRegion,
    intersection,
    stabilizing_pi,
    stabilizing_pid,
)

__all__ = [
    "BoundaryCurve",
    "HoldingDesign",
    "IntersectionRegion",
    "MarginGrid",
    "PIController",
    "PolynomialController",
    "Region",
    "StabilizingRegion",
    "StateSpaceController",
    "Strip",
    "actuated_plant",
    "controller_system",
    "gain_for_crossover",
    "holding_gains",
    "intersection",
    "linear_controller",
    "margin_grid",
    "most_phase",
    "outline",
    "stabilizing_pi",
    "stabilizing_pid",
    "wheel_slip_loop",
]
