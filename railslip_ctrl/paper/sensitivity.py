"""What each rule of the reading is worth: one at a time put to its alternative, the sixteen numbers run again."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .alternatives import ALTERNATIVES, Alternative
from .runs import CASES, QUANTITIES, CaseResult, Progress, Setup, checked_seeds, published_setup, run_setups
from .table5 import rms_deviation_percent

DEFAULT_SEEDS = 8
"""Fewer than Table 5's own: the same seeds on both sides, so that most of the noise drops out of a change."""

_UNTOUCHED = np.full(len(QUANTITIES), math.nan)


@dataclass(frozen=True)
class SensitivityRow:
    """One alternative.

    Attributes
    ----------
    alternative : Alternative
    results : tuple of CaseResult
        The four columns; one that the alternative does not concern is the reading's own.
    rms_deviation_percent : float
        From Table 5 over all sixteen numbers, %; NaN where a run did not stop.
    largest_change_percent, largest_change_of : float, str
        The number that changes most against the reading, by how much, %, and which it is, among the columns that the
        alternative concerns and whose runs all stopped; NaN and "" if none did.
    """

    alternative: Alternative
    results: tuple[CaseResult, ...]
    rms_deviation_percent: float
    largest_change_percent: float
    largest_change_of: str

    @property
    def not_stopped(self) -> dict[str, int]:
        """Number of runs that did not stop, by column, where there are any."""
        return {one.setup.case.name: len(one.failures) for one in self.results if one.failures}


@dataclass(frozen=True)
class Sensitivity:
    """All alternatives against the reading itself with the same seeds.

    Attributes
    ----------
    base : tuple of CaseResult
        The four columns in the reading.
    rows : tuple of SensitivityRow
        One for each alternative.
    seeds : int
        Runs of each column.
    """

    base: tuple[CaseResult, ...]
    rows: tuple[SensitivityRow, ...]
    seeds: int

    @property
    def base_rms_deviation_percent(self) -> float:
        """Of the reading itself, %."""
        return rms_deviation_percent(self.base)


def sensitivity(
    seeds: int = DEFAULT_SEEDS,
    *,
    alternatives: Sequence[Alternative] = ALTERNATIVES,
    progress: Progress | None = None,
) -> Sensitivity:
    """Run the reading and each alternative to one of its rules.

    Parameters
    ----------
    seeds : int
        Runs of each column, 2 to `MOST_SEEDS`.
    alternatives : sequence of Alternative
    progress : callable, optional
        Told each alternative's name when it has been run.

    Raises
    ------
    InputError
        A number of seeds out of range.
    """
    checked_seeds(seeds)
    base = run_setups([published_setup(case) for case in CASES], seeds)
    rows = []
    for number, alternative in enumerate(alternatives, 1):
        rows.append(_row(alternative, base, seeds))
        if progress is not None:
            progress(f"sensitivity {number} of {len(alternatives)}: {alternative.name}")
    return Sensitivity(base, tuple(rows), seeds)


def _row(alternative: Alternative, base: tuple[CaseResult, ...], seeds: int) -> SensitivityRow:
    changed = [alternative.change(result.setup) for result in base]
    concerned: list[Setup] = [setup for setup in changed if setup is not None]
    again = iter(run_setups(concerned, seeds))
    results = tuple(old if setup is None else next(again) for setup, old in zip(changed, base, strict=True))
    change, item = _largest_change(results, base)
    return SensitivityRow(alternative, results, rms_deviation_percent(results), change, item)


def _largest_change(results: tuple[CaseResult, ...], base: tuple[CaseResult, ...]) -> tuple[float, str]:
    pairs = zip(results, base, strict=True)
    changes = np.array([100.0 * (new.mean / old.mean - 1.0) if new is not old else _UNTOUCHED for new, old in pairs])
    if np.isnan(changes).all():
        return math.nan, ""
    column, quantity = np.unravel_index(np.nanargmax(np.abs(changes)), changes.shape)
    return float(changes[column, quantity]), f"{CASES[column].name} / {QUANTITIES[quantity]}"
