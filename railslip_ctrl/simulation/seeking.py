"""The seeking controller as a record that a run takes; what it does in a sample is `seeking_step`."""

from __future__ import annotations

import math
from pathlib import Path

from railslip_ctrl.core.arguments import check_fields, number
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.design.controllers import PERIOD
from railslip_ctrl.design.seeking import SeekingGains
from railslip_ctrl.model.adhesion import ReferenceSlip
from railslip_ctrl.model.kernels import plain

from . import seeking_step
from .controllers import Filed, Situation

KNOTS = (0.0, 0.005, 0.01, 0.015, 0.02, 0.03, 0.04, 0.05, 0.06, 0.075, 0.09, 0.105, 0.12, 0.135, 0.15, 0.17)
"""Slip ratios at which the map of adhesion has values."""

_SPARE = 3  # samples of the histories beyond the longest time looked back
_MAP = 7  # numbers that the map takes for each knot


@dataclass(frozen=True)
class SeekingControl(Filed):
    """A controller that seeks the peak of adhesion; it is told neither rail nor mass nor adhesion curve.

    Parameters
    ----------
    gains : SeekingGains
    reference : ReferenceSlip, optional
        Slip ratio that its error is taken against, by rail, if any; it finds its own.
    name, period
        As of `LinearControl`; period in s, at most the 0.05 s of its quickest filter.
    model_law, knows_rail
        None and False.
    """

    gains: SeekingGains
    reference: ReferenceSlip | None = None
    name: str = "seeking"
    period: float = PERIOD
    model_law: None = None
    knows_rail: bool = False

    def __post_init__(self) -> None:
        check_fields(self)
        number("period", self.period, "s", gt=0, le=seeking_step.QUICK_TIME)

    @property
    def states(self) -> tuple[str, ...]:
        """What `seeking_step` names, then the history of torque, then the map."""
        named = [name.lower() for name, at in vars(seeking_step).items() if name.isupper() and type(at) is int]
        own = named[named.index("samples") : named.index("history")]
        return (*own, *(f"torque_{i}" for i in range(self._history)), *(f"map_{i}" for i in range(_MAP * len(KNOTS))))

    @property
    def cut_out_speed(self) -> float:
        """Train speed below which it holds a torque and not a slip, m/s."""
        return self.gains.hand_over_speed

    @property
    def torque_high(self) -> float:
        """Largest torque, N*m."""
        return self.gains.torque_high

    @property
    def _history(self) -> int:
        return math.ceil(self.gains.dead_time / self.period) + _SPARE

    def source(self) -> str:
        text = plain(Path(seeking_step.__file__).read_text("utf-8"))
        return text.replace("def seeking(", "def command(")

    def row(self, situation: Situation) -> tuple[float, ...]:
        """As `seeking_step` names them; what it believes of the vehicle is its own, not the situation's."""
        g, period = self.gains, situation.period
        return (
            *(g.inertia, g.viscous_friction, g.wheel_load, g.dead_time, g.lag, period, g.torque_high),
            *(g.kappa, g.torque_time, g.observer_time, g.deceleration_time),
            *(g.start_lead, g.start_slip, g.elasticity, g.again_share),
            *(g.first_slip, g.least_slip, g.largest_slip),
            *(g.forgetting, g.curvature, g.flatness, g.rise, g.fall),
            *(g.hand_over_speed, g.fade_speed, g.hand_over_share, g.last_share, g.last_speed),
            *(float(self._history), float(len(KNOTS)), *KNOTS),
        )

    def start(self, speed: float) -> tuple[float, ...]:
        return (0.0,) * len(self.states)
