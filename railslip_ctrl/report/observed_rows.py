"""The observed adhesion of a log as a CSV, row by row with the regime each belongs to, whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from railslip_ctrl.core.errors import InputError
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
    scratch : Path
        A folder on the same disk.
    """

    def __init__(self, path: Path, radius: float, scratch: Path) -> None:
        self._path, self._radius = path, radius
        self._rows, self._whole = scratch / "rows", scratch / path.name
        self._rows.touch()

    def __call__(self, samples: Observed) -> None:
        """Take samples in, in the order they come."""
        torque = samples.mu * self._radius * samples.load
        columns = (samples.time, samples.speed / KMH, samples.slip, samples.load, torque, samples.mu)
        with self._rows.open("ab") as file:
            np.column_stack(columns).tofile(file)

    def finish(self, regimes: Regimes) -> None:
        """Write the file."""
        import pandas as pd

        with self._rows.open("rb") as rows, self._whole.open("w", encoding="utf-8") as file:
            file.write(",".join(COLUMNS) + "\n")
            while len(block := np.fromfile(rows, count=_BLOCK * _NUMBERS).reshape(-1, _NUMBERS)):
                table = pd.DataFrame(block).assign(regime=regimes.of(block[:, _SLIP]))
                table.to_csv(file, float_format="%.10g", header=False, index=False)
        os.replace(self._whole, self._path)


@contextmanager
def observed_rows(path: Path | None, radius: float) -> Iterator[ObservedRows | None]:
    """What writes observed samples to the file at `path`, once it is finished; None without one.

    `radius` is the wheel's, m. InputError where it cannot be written.
    """
    if path is None:
        yield None
        return
    try:
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=".incomplete-") as scratch:
            yield ObservedRows(path, radius, Path(scratch))
    except OSError as error:
        raise InputError(f"--observed: {str(path)!r} cannot be written ({error.strerror or error})") from None
