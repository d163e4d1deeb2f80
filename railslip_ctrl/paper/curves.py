"""The adhesion models as curves: [Park2008] Figs. 13 to 15 (dry, by initial speed) and 17 (dry and wet)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion import RIG_WHEEL_LOAD, published_law
from railslip_ctrl.model.numeric import Peak, adhesion_coefficient, peak
from railslip_ctrl.model.vehicle import INITIAL_SPEED_KMH, Rail

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

SPEEDS_KMH = (30.0, 60.0, 100.0, 140.0)
"""Initial braking speeds of the rig tests, [Park2008] Table 1."""

LAWS = ("beam", "curve", "bristle")
"""Laws drawn: the beam model, the bristle model along a slip ramp, and at rest."""

_POINTS = 801


@dataclass(frozen=True)
class AdhesionCurve:
    """mu over the slip ratio at v = v0, on one rail.

    Attributes
    ----------
    law : str
        Name of the adhesion law.
    rail : Rail
    initial_speed_kmh : float
        v0, km/h.
    slip, coefficient : array
        Slip ratio and mu = Fa/N, of one length.
    peak : Peak
        Where mu is highest.
    reference : float or None
        The published slip ratio to hold; at 100 km/h only.
    """

    law: str
    rail: Rail
    initial_speed_kmh: float
    slip: Floats
    coefficient: Floats
    peak: Peak
    reference: float | None

    @property
    def rises(self) -> bool:
        """Whether adhesion rises with slip to its peak; at rest the bristle model falls from the start."""
        return bool(self.peak.slip > self.slip[1])


def model_curves(
    laws: Sequence[str] = LAWS,
    *,
    speeds_kmh: Sequence[float] = SPEEDS_KMH,
    rails: Sequence[Rail] = (Rail.DRY,),
    largest_slip: float = 1.0,
) -> tuple[AdhesionCurve, ...]:
    """Curves by law, then initial speed, then rail, at the rig's wheel load. [Park2008] Figs. 13 to 15.

    Parameters
    ----------
    laws : sequence of str
        Names of laws with published parameters.
    speeds_kmh : sequence of float
        Initial speeds v0, km/h, 30 to 140.
    rails : sequence of Rail
    largest_slip : float
        Each curve goes from slip 0 to this ratio, or just short of where its law's domain ends.

    Raises
    ------
    InputError
        A law that is not one, or an initial speed out of range.
    MissingParametersError
        A law without published parameters.
    """
    return tuple(_curve(law, rail, v0, largest_slip) for law in laws for v0 in speeds_kmh for rail in rails)


def _curve(name: str, rail: Rail, v0: float, largest_slip: float) -> AdhesionCurve:
    law, speed = published_law(name, rail, v0), v0 * KMH
    end = min(largest_slip, law.domain_limit(speed)[0] * (1.0 - 1e-9))
    # a dynamic law has no rest state without slip: its curve starts just above
    slip = np.linspace(1e-6 if law.has_state else 0.0, end, _POINTS)
    return AdhesionCurve(
        law=name,
        rail=rail,
        initial_speed_kmh=v0,
        slip=slip,
        coefficient=np.asarray(adhesion_coefficient(law, speed, slip, RIG_WHEEL_LOAD)),
        peak=peak(law, speed, RIG_WHEEL_LOAD),
        reference=law.reference_slip(rail) if v0 == INITIAL_SPEED_KMH else None,
    )


def wet_and_dry() -> tuple[AdhesionCurve, ...]:
    """The curves of [Park2008] Fig. 17: bristle along a ramp and beam, dry and wet, at 100 km/h up to slip 0.5."""
    return model_curves(("curve", "beam"), speeds_kmh=(INITIAL_SPEED_KMH,), rails=tuple(Rail), largest_slip=0.5)
