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
