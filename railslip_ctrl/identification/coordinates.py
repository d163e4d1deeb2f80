"""The coordinates in which a model's parameters are looked for: those in which its force is as good as linear.

Most parameters are their own coordinate. The bristles' force at rest is (gamma - |sigma|)/beta: a log that hardly shows
its fall leaves beta and gamma free to grow together without bound, along a bend that neither a search nor a standard
error follows. Their coordinates are the level gamma/beta, which every log shows, and 1/gamma, which is nought where
nothing falls. beta alone, gamma being given, is looked for as 1/beta.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

FLAT = 1e-6
"""Fall of the bristles' force, relative, at the least gamma, below which it is none: 1/gamma ends there."""

_TINY = 1e-12  # stands for the nought that a level and a slope must stay above
_SMALL = 0.01  # of what is typical: a coordinate that tends to nought is small beside it
_SMALLEST = 1e-9


@dataclass(frozen=True)
class Coordinates:
    """Coordinates x of the values of free parameters, with their bounds; arrays of one length.

    Attributes
    ----------
    names : tuple of str
    least, most : array
        Bounds of the values.
    typical : array
        Values of an ordinary size.
    lower, upper : array
        Bounds of the coordinates.
    pair : (int, int) or None
        Places of beta and gamma where both are looked for, and beta has no bounds but its sign.
    inverse : int or None
        Place of beta where gamma is given.
    """

    names: tuple[str, ...]
    least: Floats
    most: Floats
    typical: Floats
    lower: Floats
    upper: Floats
    pair: tuple[int, int] | None = None
    inverse: int | None = None

    @classmethod
    def of(cls, names: tuple[str, ...], least: Floats, most: Floats, typical: Floats) -> Coordinates:
        """For free parameters within bounds."""
        low, high, ends = least.copy(), most.copy(), (least, most)
        b = names.index("beta") if "beta" in names else None
        if b is None:
            return cls(names, *ends, typical, low, high)
        if "gamma" not in names:
            low[b], high[b] = max(1.0 / most[b], _TINY), 1.0 / least[b]
            return cls(names, *ends, typical, low, high, inverse=b)
        if least[b] > _TINY or np.isfinite(most[b]):  # bounds of beta are none of level and 1/gamma
            return cls(names, *ends, typical, low, high)
        g = names.index("gamma")
        low[b], high[b] = _TINY, np.inf
        low[g], high[g] = max(1.0 / most[g], FLAT / least[g]), 1.0 / least[g]
        return cls(names, *ends, typical, low, high, pair=(b, g))

    def without(self, index: int) -> Coordinates:
        """Of the other parameters, where one is held."""
        others = np.arange(len(self.names)) != index
        names = tuple(name for i, name in enumerate(self.names) if i != index)
        return Coordinates.of(names, self.least[others], self.most[others], self.typical[others])

    def at(self, values: Floats) -> Floats:
        """The coordinates of values."""
        x = np.array(values, dtype=float)
        if self.pair is not None:
            b, g = self.pair
            x[b], x[g] = values[g] / values[b], 1.0 / values[g]
        elif self.inverse is not None:
            x[self.inverse] = 1.0 / values[self.inverse]
        return x

    def values(self, x: Floats) -> Floats:
        """The values at coordinates."""
        values = np.array(x, dtype=float)
        if self.pair is not None:
            b, g = self.pair
            values[b], values[g] = 1.0 / (x[b] * x[g]), 1.0 / x[g]
        elif self.inverse is not None:
            values[self.inverse] = 1.0 / x[self.inverse]
        return values

    def slopes(self, x: Floats) -> Floats:
        """Derivatives of the values by the coordinates, (values, coordinates)."""
        result, values = np.eye(len(x)), self.values(x)
        if self.pair is not None:
            b, g = self.pair
            result[b, b], result[b, g] = -values[b] / x[b], -values[b] / x[g]
            result[g, g] = -values[g] / x[g]
        elif self.inverse is not None:
            result[self.inverse, self.inverse] = -values[self.inverse] / x[self.inverse]
        return result

    def sizes(self, x: Floats) -> Floats:
        """What is large for each coordinate."""
        result: Floats = np.maximum(np.abs(x), _SMALL * np.abs(self.at(self.typical)))
        return np.maximum(result, _SMALLEST)

    def inside(self, x: Floats, margin: float) -> Floats:
        """x moved off its bounds by a margin, in sizes: on a bound a search would hardly leave it."""
        off = margin * self.sizes(x)
        low, high = self.lower + off, self.upper - off
        return np.where(low < high, np.clip(x, low, np.maximum(low, high)), np.clip(x, self.lower, self.upper))

    # --- one parameter after the other ------------------------------------------------------------------------------

    def by_inverse(self, index: int) -> bool:
        """Whether a parameter is followed by its inverse, for which infinity is at nought."""
        return index == self.inverse or (self.pair is not None and index in self.pair)

    def followed(self, index: int, value: float) -> float:
        """What a parameter is followed by, at a value of it: its inverse, or itself; and the value again from that."""
        return 1.0 / value if self.by_inverse(index) else value

    def range_of(self, index: int, x: Floats) -> tuple[float, float]:
        """Bounds of a parameter, or of its inverse where it is followed by that, at coordinates x."""
        if self.pair is not None and index == self.pair[0]:
            return float(x[index] * self.lower[self.pair[1]]), float(1.0 / self.least[index])
        return float(self.lower[index]), float(self.upper[index])

    def moved(self, values: Floats, index: int, value: float) -> Floats:
        """Values with one of them changed; of a pair the other follows, so that the level stays."""
        result = values.copy()
        if self.pair is not None and index in self.pair:
            other = self.pair[1 - self.pair.index(index)]
            result[other] *= value / values[index]
        result[index] = value
        return result
