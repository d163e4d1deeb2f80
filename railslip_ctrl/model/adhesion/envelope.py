"""Adhesion available by speed, whatever the slip: an envelope of measurements, not an adhesion law."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from railslip_ctrl.core.errors import DomainError
from railslip_ctrl.core.units import KMH


def curtius_kniffler(speed: ArrayLike) -> NDArray[np.float64] | np.float64:
    """Adhesion coefficient 7.5/(v + 44) + 0.161, v in km/h, of Curtius and Kniffler.

    E. W. Curtius, A. Kniffler: Neue Erkenntnisse ueber die Haftung zwischen Treibrad und Schiene. Elektrische
    Bahnen 1944.

    Parameters
    ----------
    speed : array_like
        Train speed, m/s, of any shape.

    Raises
    ------
    DomainError
        A speed that is negative or not finite.
    """
    v = np.asarray(speed, dtype=float)
    outside = ~(np.isfinite(v) & (v >= 0.0))
    if outside.any():
        raise DomainError(f"speed: {v[outside][0]:g} m/s is outside the curve; give a finite speed >= 0")
    return np.asarray(7.5 / (v / KMH + 44.0) + 0.161, dtype=float)[()]
