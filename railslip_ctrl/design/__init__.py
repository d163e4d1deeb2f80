"""Design and judgement of slip controllers.

Imports `controllers`, `sliding`, `loop`, `model` and `core`. Begin with `envelope` and `judging`: the operating points
that a design must stabilise, and one verdict over them.

- `assessment`: margins, limits and verdict of one loop at one operating point
- `envelope`: operating points and tolerances for a design
- `judging`: margins of every case of an envelope, and one verdict
- `specification`: margins that a design must have, and the margins of many plants with one controller
- `tuning`: PI gains from a specification, by hand, or by published rules; `tuning_search` searches the gains
- `envelope_tuning`: a controller tuned over an envelope, and the best of several structures
- `schedule`: gains scheduled over speed and rail, the lowest stable speed, margins swept over speed or slip
- `stabilizing`: all gains that stabilise, their outline and margins; `decomposition` computes their boundaries
- `gain_map`: map of the gains with Ms below a level at every operating point
- `workbench`: controllers shaped by hand over an envelope
- `limits`: limits of performance for any controller, and the control effort of a controller
- `compensators`: Smith predictors and the predictor-observer
- `catalogue`: the controllers that come with the package, by name
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
