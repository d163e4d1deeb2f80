"""Design and judgement of slip controllers.

`envelope` has the operating points that a design must stabilise, and `judging` the verdict over them. `tuning`,
`envelope_tuning` and `schedule` find gains; `stabilizing` computes all gains that stabilise.
"""

from railslip_ctrl.controllers.systems import (
    PIController,
    PolynomialController,
    StateSpaceController,
    actuated_plant,
    controller_system,
    linear_controller,
    wheel_slip_loop,
)

from .stabilizing import (
    IntersectionRegion,
    MarginGrid,
    Region,
    StabilizingRegion,
    Strip,
    intersection,
    margin_grid,
    outline,
    stabilizing_pi,
    stabilizing_pid,
)
from .tuning import CommonPI, common_pi, gain_for_crossover, most_phase

__all__ = [
    "CommonPI", "IntersectionRegion", "MarginGrid", "PIController", "PolynomialController", "Region",
    "StabilizingRegion", "StateSpaceController", "Strip", "actuated_plant", "common_pi", "controller_system",
    "gain_for_crossover", "intersection", "linear_controller", "margin_grid", "most_phase", "outline",
    "stabilizing_pi", "stabilizing_pid", "wheel_slip_loop",
]  # fmt: skip
