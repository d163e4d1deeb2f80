"""What brake lag and dead time do to the sliding-mode law: limit cycles, the adaptation, a design that accounts for it.

Knows nothing of reports, plots or braking runs.
"""

from .adaptation import Survivors, ideal_adaptation, largest_adaptation, largest_relay, survivors
from .advice import JointAdvice, joint_advice
from .effects import ActuatorEffect, RelayCycle, actuator_effect, conclusion, cycle_table, published_loop
from .law import TABLE4_SLIDING, FeedForward, SlidingGains
from .layered import LayerBound, LayeredDesign, induced_gains, layer_bound, layer_loop
from .limit_cycle import LimitCycle, critical_gains, linear_limit_cycle, predict_limit_cycle, smallest_layer
from .nonlinear_cycle import LINEAR_CHANGE, linearisation_change, nonlinear_limit_cycle
from .simulated_cycle import law_runs, simulated_limit_cycle
from .surface_loop import SlidingExistence, SurfaceLoop

__all__ = [
    "LINEAR_CHANGE",
    "TABLE4_SLIDING",
    "ActuatorEffect",
    "FeedForward",
    "JointAdvice",
    "LayerBound",
    "LayeredDesign",
    "LimitCycle",
    "RelayCycle",
    "SlidingExistence",
    "SlidingGains",
    "SurfaceLoop",
    "Survivors",
    "actuator_effect",
    "conclusion",
    "critical_gains",
    "cycle_table",
    "ideal_adaptation",
    "induced_gains",
    "joint_advice",
    "largest_adaptation",
    "largest_relay",
    "law_runs",
    "layer_bound",
    "layer_loop",
    "linear_limit_cycle",
    "linearisation_change",
    "nonlinear_limit_cycle",
    "predict_limit_cycle",
    "published_loop",
    "simulated_limit_cycle",
    "smallest_layer",
    "survivors",
]
