"""Least squares with one answer whatever the data: what these do not tell stays where it was first looked for.

Without that, a search runs along a direction in which the residuals do not change for as long as rounding lets it, and
which numbers come out, or none, is decided by the processor. Tikhonov's remedy: to the residuals is added, for every
coordinate, its distance from a centre in sizes, with a weight so small beside the noise that it moves nothing which the
data tell, and so large beside rounding that the least is one place. What is known is then said by the residuals alone.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from .coordinates import Coordinates

Floats = NDArray[np.float64]
Residuals = Callable[[Floats], Floats]

PULL = 0.1
"""Weight in standard deviations of the noise: the centre counts as known to ten sizes of a coordinate.

An estimate with a standard error of one size, three sizes away, is moved by 3 % of that error.
"""

_STEP = 1e-4  # of a coordinate's size, for differences: rounding and the third derivative both leave some 1e-8


def search(
    residuals: Residuals,
    coordinates: Coordinates,
    begin: Floats,
    *,
    weight: float,
    centre: Floats | None = None,
    tolerance: float,
    most: int,
) -> tuple[float, Floats]:
    """The sum of squares and the coordinates where it is least, within their bounds, looked for from `begin`.

    `residuals` are of the values; `weight` is `PULL` in their unit; the `centre` is where the search begins unless it
    is given. It ends when the sum would change by less than `tolerance` of it, or after `most` evaluations.
    """
    from scipy.optimize import least_squares

    size, centre = coordinates.sizes(begin), begin if centre is None else centre
    pull = weight / np.maximum(np.abs(centre), np.abs(coordinates.at(coordinates.typical)))

    def pulled(y: Floats) -> Floats:
        x = y * size
        return np.concatenate([residuals(coordinates.values(x)), pull * (x - centre)])

    def slopes(y: Floats) -> Floats:
        x = y * size
        own = differences(residuals, coordinates, x, _STEP * coordinates.sizes(x))
        return np.concatenate([own, np.diag(pull)]) * size

    found = least_squares(
        pulled,
        begin / size,
        jac=slopes,
        bounds=(coordinates.lower / size, coordinates.upper / size),
        x_scale="jac",
        method="dogbox",  # it ends on a bound, where SciPy's other way only tends to it
        ftol=tolerance,
        xtol=tolerance,
        gtol=tolerance,
        max_nfev=most,
    )
    x = found.x * size
    return 2.0 * float(found.cost) - float(np.sum((pull * (x - centre)) ** 2)), x


def differences(residuals: Residuals, coordinates: Coordinates, x: Floats, steps: Floats) -> Floats:
    """Derivatives of the residuals by the coordinates, (residuals, coordinates), by differences inside the bounds."""
    columns = []
    for i, step in enumerate(steps):
        high, low = x.copy(), x.copy()
        high[i], low[i] = min(x[i] + step, coordinates.upper[i]), max(x[i] - step, coordinates.lower[i])
        difference = residuals(coordinates.values(high)) - residuals(coordinates.values(low))
        columns.append(difference / (high[i] - low[i]))
    return np.stack(columns, axis=1)
