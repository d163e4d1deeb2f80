"""Table 5 of [Park2008]: sixteen published numbers beside the means of many seeded runs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from railslip_ctrl.core.sources import cite

from .runs import CASES, QUANTITIES, CaseResult, Progress, checked_seeds, published_setup, run_setups

TOLERANCE_PERCENT = 4.0
"""Largest deviation allowed of a number, %: single runs scatter by up to 5 % in slip error, and the paper shows one."""

DEFAULT_SEEDS = 256

TABLE5: Mapping[str, tuple[float, ...]] = MappingProxyType(
    {
        "PI beam": (59.5, 700.0, 1.77e7, 0.0378),
        "PI bristle": (58.9, 682.0, 1.77e7, 0.0351),
        "ASMC beam": (55.3, 607.0, 1.71e7, 0.0354),
        "ASMC bristle": (50.7, 581.0, 1.71e7, 0.0272),
    }
)
"""[Park2008] Table 5 by column, in the order of `QUANTITIES`.

The energy is printed as 1.77 10^-7 kN m and, on p. 56, as 1.77 10^7 N m; the latter is meant.
"""


@dataclass(frozen=True)
class Row:
    """One number, published and obtained; deviations in percent of the published one, NaN where runs did not stop.

    Attributes
    ----------
    item : str
        "Table 5 / PI beam / braking_time_s", and so on.
    published, obtained, standard_error : float
        In the unit that the item names; the last of `obtained`, from the runs' spread.
    tolerance_percent : float
        Largest deviation that counts as reproduced, %.
    source : str
        Where it is printed.
    """

    item: str
    published: float
    obtained: float
    standard_error: float
    tolerance_percent: float
    source: str

    @property
    def deviation_percent(self) -> float:
        """Obtained over published, less 1."""
        return 100.0 * (self.obtained / self.published - 1.0)

    @property
    def within(self) -> bool:
        """Whether the deviation is within the tolerance; a NaN is not."""
        return abs(self.deviation_percent) <= self.tolerance_percent


@dataclass(frozen=True)
class Table5:
    """The comparison.

    Attributes
    ----------
    rows : tuple of Row
        By column and quantity.
    results : tuple of CaseResult
        The runs behind them, by column.
    seeds : int
        Runs of each column.
    """

    rows: tuple[Row, ...]
    results: tuple[CaseResult, ...]
    seeds: int

    @property
    def rms_deviation_percent(self) -> float:
        """Root mean square of the rows' deviations; NaN where one of them has none."""
        return _rms([row.deviation_percent for row in self.rows])

    @property
    def within(self) -> bool:
        """Whether every row is within its tolerance."""
        return all(row.within for row in self.rows)


def table5(seeds: int = DEFAULT_SEEDS, *, progress: Progress | None = None) -> Table5:
    """Run the four columns and compare them with [Park2008] Table 5.

    Parameters
    ----------
    seeds : int
        Runs of each column, 2 to `MOST_SEEDS`.
    progress : callable, optional
        Told what is run, a line for each column done.

    Raises
    ------
    InputError
        A number of seeds out of range.
    """
    results = run_setups([published_setup(case) for case in CASES], checked_seeds(seeds), progress=progress)
    rows = tuple(
        Row(
            item=f"Table 5 / {result.setup.case.name} / {quantity}",
            published=published,
            obtained=float(mean),
            standard_error=float(error),
            tolerance_percent=TOLERANCE_PERCENT,
            source=cite("Park2008", "Table 5"),
        )
        for result in results
        for quantity, published, mean, error in zip(
            QUANTITIES, TABLE5[result.setup.case.name], result.mean, result.standard_error, strict=True
        )
    )
    return Table5(rows, results, seeds)


def deviations_percent(result: CaseResult) -> tuple[float, ...]:
    """Deviations of a column's four means from Table 5, %."""
    published = np.array(TABLE5[result.setup.case.name])
    return tuple((100.0 * (result.mean / published - 1.0)).tolist())


def rms_deviation_percent(results: tuple[CaseResult, ...]) -> float:
    """Root mean square of the deviations of all columns, %; NaN where one of them did not always stop."""
    return _rms([deviation for result in results for deviation in deviations_percent(result)])


def _rms(values: Sequence[float]) -> float:
    return math.sqrt(sum(value**2 for value in values) / len(values))
