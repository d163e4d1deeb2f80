"""An observer run in steps and in chunks against its run in one piece, for the tests of all observers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

# estimates of a few kN*m that are sums of terms of up to 1e5 N*m, over a few thousand steps: 1e5 * 1e-16 * 1e3
ROUNDING = 1e-8


def run_is_step_is_chunks(observer: Any, log: tuple[np.ndarray, ...], cuts: Sequence[int]) -> tuple[Any, Any, Any]:
    """Asserts that the three ways estimate the same of a log (t, torque, omega).

    Gives the run in one piece, the state after the steps and that after the chunks; `cuts` are the rows they end at.
    """
    whole = observer.run(*log)
    estimate, state = observer.start(*(column[0] for column in log))
    steps = [estimate]
    for row in zip(*(column[1:] for column in log), strict=True):
        estimate, state = observer.step(state, *row)
        steps.append(estimate)
    assert steps == pytest.approx(whole.adhesion_torque, abs=ROUNDING)
    chunked, after = [], None
    for first, last in zip((0, *cuts), (*cuts, log[0].size), strict=True):
        part = observer.run(*(column[first:last] for column in log), after)
        chunked.append(part.adhesion_torque)
        after = part.state
    assert np.concatenate(chunked) == pytest.approx(whole.adhesion_torque, abs=ROUNDING)
    return whole, state, after
