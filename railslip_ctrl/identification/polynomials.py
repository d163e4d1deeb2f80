"""Parameters over the initial speed, as polynomials, from logs at several speeds: [Park2008] (30)-(32)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from railslip_ctrl.units import KMH

from .fits import Fit

Floats = NDArray[np.float64]

HIGHEST_DEGREE = 2
"""As in (30)-(32)."""

_SAME_SPEED = 0.01  # relative: initial speeds nearer than this are one


@dataclass(frozen=True)
class ParameterPolynomial:
    """A parameter over the initial speed v0 in km/h: the sum of coefficients[k] v0^k, SI.

    Attributes
    ----------
    name : str
    coefficients, stderrs : array, (degree + 1,)
        Standard errors are NaN where those of the fits are.
    speeds_kmh, values : array, (logs,)
        What it goes through, or near.
    """

    name: str
    coefficients: Floats
    stderrs: Floats
    speeds_kmh: Floats
    values: Floats

    def at(self, speed_kmh: float) -> float:
        """The parameter at v0 in km/h."""
        return float(np.polynomial.polynomial.polyval(speed_kmh, self.coefficients))


def over_initial_speed(initial_speeds: Sequence[float], fits: Sequence[Fit]) -> tuple[ParameterPolynomial, ...]:
    """Polynomials through the parameters of fits of one model, weighted by their standard errors where all have one.

    `initial_speeds` in m/s. The degree is 2, or one less than there are distinct speeds.
    """
    v0 = np.array(initial_speeds) / KMH
    distinct = 1 + int(np.sum(np.diff(np.sort(v0)) > _SAME_SPEED * np.sort(v0)[1:]))
    degree = min(HIGHEST_DEGREE, distinct - 1)
    found = []
    for i, name in enumerate(fits[0].model.names):
        values = np.array([fit.parameters[i].value for fit in fits])
        stderrs = np.array([fit.parameters[i].stderr for fit in fits])
        found.append(ParameterPolynomial(name, *_weighted(v0, values, stderrs, degree), v0, values))
    return tuple(found)


def _weighted(v0: Floats, values: Floats, stderrs: Floats, degree: int) -> tuple[Floats, Floats]:
    known = bool(np.isfinite(stderrs).all() and (stderrs > 0.0).all())
    weights = 1.0 / stderrs if known else np.ones_like(values)
    unit = v0.max()  # powers of a number up to 1, so that the columns are of one size
    powers = np.vander(v0 / unit, degree + 1, increasing=True)
    root = np.linalg.pinv(weights[:, None] * powers)
    scale = unit ** -np.arange(degree + 1.0)
    deviations = np.sqrt(np.sum(root**2, axis=1)) * scale if known else np.full(degree + 1, np.nan)
    return root @ (weights * values) * scale, deviations
