"""The observed adhesion of a log as a CSV, row by row with the regime each belongs to, whole or not at all."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.folders import staged
from railslip_ctrl.core.units import KMH
from railslip_ctrl.identification.observed import Observed
from railslip_ctrl.identification.results import Regimes

COLUMNS = (
    *("time [s]", "filtered train speed [km/h]", "filtered slip [1]", "filtered wheel load [N]"),
    *("adhesion torque [N*m]", "mu [1]", "regime"),
)
"""Header of the file. The observed torque is late by the observer's filter; what stands beside it is as late."""

_SLIP = COLUMNS.index("filtered slip [1]")
_NUMBERS = len(COLUMNS) - 1
_BLOCK = 1 << 16  # rows in memory at a time


class ObservedRows:
    """Rows that wait in a scratch file, as bytes, until the regimes are known.

    Parameters
    ----------
    path : Path
        The CSV to be.
    radius : float
        Of the wheel, m.
    rows : binary file
        Where they wait.
    """

    def __init__(self, path: Path, radius: float, rows: IO[bytes]) -> None:
        self._path, self._radius, self._rows = path, radius, rows

    def __call__(self, samples: Observed) -> None:
        """Take samples in, in the order they come."""
        torque = samples.mu * self._radius * samples.load
        columns = (samples.time, samples.speed / KMH, samples.slip, samples.load, torque, samples.mu)
        self._rows.write(np.column_stack(columns).tobytes())

    def finish(self, regimes: Regimes) -> None:
        """Write the file."""
        import pandas as pd

        self._rows.seek(0)
        with self._path.open("w", encoding="utf-8") as file:
            file.write(",".join(COLUMNS) + "\n")
            while content := self._rows.read(8 * _BLOCK * _NUMBERS):
                block = np.frombuffer(content).reshape(-1, _NUMBERS)
                table = pd.DataFrame(block).assign(regime=regimes.of(block[:, _SLIP]))
                table.to_csv(file, float_format="%.10g", header=False, index=False)


@contextmanager
def observed_rows(path: Path | None, radius: float) -> Iterator[ObservedRows | None]:
    """What writes observed samples to the file at `path`, once it is finished; None without one.

    `radius` is the wheel's, m. InputError where it cannot be written.
    """
    if path is None:
        yield None
        return
    try:
        with tempfile.TemporaryFile(dir=path.parent) as rows, staged(path.parent) as new:
            yield ObservedRows(new / path.name, radius, rows)
    except OSError as error:
        raise InputError(f"--observed: {str(path)!r} cannot be written ({error.strerror or error})") from None
