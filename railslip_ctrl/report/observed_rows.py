"""The observed adhesion of a log as a CSV, row by row as it is read, whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from railslip_ctrl.errors import InputError
from railslip_ctrl.identification.observed import Observed
from railslip_ctrl.units import KMH

COLUMNS = ("time [s]", "train speed [km/h]", "slip [1]", "wheel load [N]", "adhesion torque [N*m]", "mu [1]")
"""Header of the file."""


@contextmanager
def observed_rows(path: Path | None, radius: float) -> Iterator[Callable[[Observed], None] | None]:
    """What writes observed samples, in the order they come, to the file at `path`; None without one.

    `radius` is the wheel's, m. The file is there when the block ends without an error.
    InputError where it cannot be written.
    """
    if path is None:
        yield None
        return
    try:
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=".incomplete-") as scratch:
            whole = Path(scratch) / path.name
            with whole.open("w", encoding="utf-8") as file:
                file.write(",".join(COLUMNS) + "\n")

                def write(samples: Observed) -> None:
                    torque = samples.mu * radius * samples.load
                    columns = (samples.time, samples.speed / KMH, samples.slip, samples.load, torque, samples.mu)
                    np.savetxt(file, np.column_stack(columns), fmt="%.10g", delimiter=",")

                yield write
            os.replace(whole, path)
    except OSError as error:
        raise InputError(f"--observed: {str(path)!r} cannot be written ({error.strerror or error})") from None
