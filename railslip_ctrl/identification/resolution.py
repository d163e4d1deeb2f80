"""The step in which a column's values come: an encoder's count, a converter's digit, the decimals that are printed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .columns import UNITS, Column

Floats = NDArray[np.float64]

# Second differences: of values in steps they are whole steps, of a straight ramp they are nought, so that a ramp is
# not taken for a staircase. Nought is what rounding leaves of the values.
_NOUGHT = 1e-7
_LEAST_CHANGES = 20
_LEAST_SHARE = 0.01  # of the rows: fewer are the corners of ramps

# The step is the largest of these quantiles of the differences in which all but a few of them are whole numbers: the
# least ones may be of a glitch. Of differences without a step a fifth would be within this tolerance of one.
_QUANTILES = (0.0, 0.01, 0.03, 0.1, 0.3, 0.5)
_TOLERANCE = 0.1
_WHOLE_SHARE = 0.95
_FEW = 20.0  # steps: of larger differences, uneven intervals of an encoder blur the step


def step_of(values: Floats) -> float:
    """The step in which some values, in the order they came, change; 0 where they show none."""
    changes = np.abs(np.diff(values, 2))
    changes = changes[changes > _NOUGHT * np.abs(values).max(initial=0.0)]
    if len(changes) < max(_LEAST_CHANGES, _LEAST_SHARE * len(values)):
        return 0.0
    return max((float(step) for step in np.quantile(changes, _QUANTILES) if _comes_in(changes, step)), default=0.0)


def _comes_in(changes: Floats, step: float) -> bool:
    counts = changes[changes < _FEW * step] / step
    whole = np.abs(counts - np.round(counts)) < _TOLERANCE
    # below half a step a difference is none of it
    return bool(len(counts) >= _LEAST_CHANGES and np.mean(whole & (counts > 0.5)) >= _WHOLE_SHARE)


class Resolution:
    """Steps of the columns of a log, from pieces of it: the least that any piece shows, as a piece may miss some."""

    def __init__(self) -> None:
        self._steps: dict[str, float] = {}

    def add(self, name: str, values: Floats) -> None:
        """Take a piece of a column in."""
        step = step_of(values)
        if step > 0.0:
            self._steps[name] = min(step, self._steps.get(name, step))

    def __getitem__(self, name: str) -> float:
        """The step of a column, SI; 0 where none was seen."""
        return self._steps.get(name, 0.0)


@dataclass(frozen=True)
class ColumnStep:
    """A column that comes in steps.

    Attributes
    ----------
    label : str
        The column's header with its unit, or the quantity and its SI unit.
    step : float
        In the file's unit.
    share : float
        As slip ratio at the initial speed; of a torque as adhesion coefficient.
    is_torque : bool
    """

    label: str
    step: float
    share: float
    is_torque: bool

    @property
    def matters(self) -> bool:
        """Whether the step is coarser than the lowest slips that are used, or than that of mu."""
        return self.share >= _COARSE

    def __str__(self) -> str:
        if self.is_torque:
            return f"{self.label!r} in steps of {self.step:.4g}, {self.share:.2g} of mu"
        return f"{self.label!r} in steps of {self.step:.4g}, {100.0 * self.share:.2g} % of slip at the initial speed"


_COARSE = 0.005


def column_steps(
    resolution: Resolution, columns: Mapping[str, Column], radius: float, speed: float, load: float
) -> tuple[ColumnStep, ...]:
    """The steps of the columns of a log (none: SI), at a wheel radius, m, initial speed, m/s, and wheel load, N."""
    slips = {"train_speed": 1.0 / speed, "wheel_speed": 1.0 / speed, "wheel_angular_speed": radius / speed}
    found = []
    for name, slip in (*slips.items(), ("brake_torque", 1.0 / (radius * load))):
        if step := resolution[name]:
            column = columns.get(name)
            label, factor = (f"{name} [{UNITS[name]}]", 1.0) if column is None else (column.header, column.factor)
            found.append(ColumnStep(label, step / factor, step * slip, name == "brake_torque"))
    return tuple(found)


def step_warnings(steps: tuple[ColumnStep, ...]) -> tuple[str, ...]:
    """A sentence for each step that matters."""
    return tuple(f"column {step}: what is finer is known from means alone" for step in steps if step.matters)
