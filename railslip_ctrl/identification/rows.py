"""Rows of a log, in SI, as they are handed from stage to stage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Lines = NDArray[np.int64]


@dataclass(frozen=True)
class Rows:
    """Rows of a log, SI.

    Attributes
    ----------
    line : array of int, (n,)
        Line of each row in the file, the first being line 1.
    columns : dict of arrays, (n,)
        By quantity, those of the log.
    """

    line: Lines
    columns: dict[str, Floats]

    def __len__(self) -> int:
        return len(self.line)

    def where(self, kept: NDArray[np.bool_]) -> Rows:
        """The rows that are kept."""
        return Rows(self.line[kept], {name: values[kept] for name, values in self.columns.items()})

    def part(self, start: int, stop: int | None) -> Rows:
        """Rows by position."""
        return Rows(self.line[start:stop], {name: values[start:stop] for name, values in self.columns.items()})

    def then(self, more: Rows) -> Rows:
        """These rows and more after them."""
        return Rows(
            np.concatenate([self.line, more.line]),
            {name: np.concatenate([values, more.columns[name]]) for name, values in self.columns.items()},
        )


class BothSpeeds:
    """The two speeds of a wheel, where a log has both: by a straight line through nought, over all rows."""

    def __init__(self) -> None:
        self._product = self._square = 0.0

    def add(self, rows: Rows) -> None:
        """Take rows in."""
        rim, angular = rows.columns.get("wheel_speed"), rows.columns.get("wheel_angular_speed")
        if rim is not None and angular is not None:
            self._product += float(rim @ angular)
            self._square += float(angular @ angular)

    def ratio(self, radius: float) -> float:
        """Of the speed of the rim to the angular one times the radius, m; NaN where the log does not have both."""
        return self._product / (radius * self._square) if self._square > 0.0 else np.nan
