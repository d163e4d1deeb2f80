"""The published sliding-mode law's numbers, and how its adhesion feed-forward is formed.

The law is [Park2008] (33)-(36), (41), (45), its gains read in SI: s = e + rho int e, e = lambda_d v - sigma, and

    Tb_cmd = (J/r)[sigma_d' + (1/(r M) + r/J) Ta_model - (r B/J) omega + rho e + theta phi] + D s + K sgn(s).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.model.vehicle import TABLE4_SLIDING_PRINTED


class FeedForward(StrEnum):
    """Where the law takes its adhesion torque Ta_model from.

    MODEL: the adhesion law with a state of its own, driven by the measured slip velocity. It equals the true Ta once
    its state has met the plant's. REST: the law at rest at the measured slip. OFF: none, Ta held at the operating
    point's. For a static law MODEL and REST are the same.
    """

    MODEL = "model"
    REST = "rest"
    OFF = "off"


@dataclass(frozen=True)
class SlidingGains:
    """Gains of the law, SI.

    Parameters
    ----------
    K : float
        Height of the relay, N*m, >= 0.
    D : float
        N*m/(m/s), >= 0; D and K are added to the torque.
    rho : float
        1/s, >= 0.
    k : float
        Adaptation gain as printed, >= 0: theta1' = k s Ta and theta2' = 12.96 k s omega in SI (theta1 in SI is 3.6
        times smaller than the printed one).

    Raises
    ------
    InputError
        A gain that is negative or not finite.
    """

    K: float
    D: float
    rho: float
    k: float = 0.0

    def __post_init__(self) -> None:
        for name in ("K", "D", "rho", "k"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise InputError(f"{name}: {value} is not allowed; give a finite value >= 0")


OMEGA_UNIT_FACTOR = 12.96
"""3.6^2: theta2' = 12.96 k s omega in SI, since s and omega are both 3.6 times larger in km/h."""

# [Park2008] Table 4: D printed "1/h" and read as N*m per km/h, K printed "km/h^2" and read as N*m, rho per second.
TABLE4_SLIDING = MappingProxyType(
    {
        name: SlidingGains(K=printed.K, D=3.6 * printed.D, rho=printed.rho, k=printed.k)
        for name, printed in TABLE4_SLIDING_PRINTED.items()
    }
)
"""Table 4's sliding-mode gains by column, SI."""
