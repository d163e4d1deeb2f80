"""What brake lag and dead time do to the sliding-mode law: limit cycles, the adaptation, a design that accounts for it.

Knows nothing of reports, plots or braking runs.
"""

from .adaptation import Survivors, ideal_adaptation, largest_adaptation, largest_relay, survivors
from .effects import ActuatorEffect, actuator_effect, conclusion, cycle_table, published_loop
from .law import TABLE4_SLIDING, FeedForward, SlidingGains
from .layered import LayerBound, LayeredDesign, induced_gains, layer_bound, layer_loop
from .limit_cycle import LimitCycle, critical_gains, exact_limit_cycle, predict_limit_cycle, smallest_layer
from .surface_loop import SlidingExistence, SurfaceLoop

__all__ = [
    "TABLE4_SLIDING",
    "ActuatorEffect",
    "FeedForward",
    "LayerBound",
    "LayeredDesign",
    "LimitCycle",
    "SlidingExistence",
    "SlidingGains",
    "SurfaceLoop",
    "Survivors",
    "actuator_effect",
    "conclusion",
    "critical_gains",
    "cycle_table",
    "exact_limit_cycle",
    "ideal_adaptation",
    "induced_gains",
    "largest_adaptation",
    "largest_relay",
    "layer_bound",
    "layer_loop",
    "predict_limit_cycle",
    "published_loop",
    "smallest_layer",
    "survivors",
]
