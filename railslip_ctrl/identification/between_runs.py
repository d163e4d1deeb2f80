"""What differs from test to test: the covariance of estimates from runs that are independent of each other.

Rail, weather and warmth are those of a test, and shift all its rows alike; one number for the noise of a long time
would widen every parameter as if all of that went into it. So, where the runs disagree, the covariance is that of the
jackknife which leaves out one test after the other (CV3 of [MacKinnon2023]), with Student's distribution of as many
degrees of freedom as there are tests, less one. It holds for any correlation within a test.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

LEAST_TESTS = 5
"""With fewer, Student's quantile is so large that nothing is told."""

_ALONE = 0.99  # share of what is known of a direction: a test with more stands alone, and cannot be left out
_DISAGREE = 0.01  # probability of runs that differ as these do, or more, by the noise within them
_ONE_TEST = 0.5  # of the longest run: runs nearer to each other than that are pieces of one test
_SEEN = 1e-8  # of the largest singular value: a direction that a test shows at all


@dataclass(frozen=True)
class BetweenRuns:
    """The `covariance` (p, p) of the estimates, and its `freedom`, the degrees of freedom."""

    covariance: Floats
    freedom: int


def whole_tests(time: Floats, step: Floats, run: Integers) -> Integers:
    """The test that each interval belongs to, 0 on; its end at `time`, s, its length `step`, s, and its `run`.

    Runs that a gap or a release has parted are pieces of one test where they lie near to each other.
    """
    first = np.flatnonzero(np.diff(run, prepend=-1))
    if not len(first):
        return np.zeros(0, dtype=np.int64)
    begin, end = time[first] - step[first], time[np.append(first[1:], len(time)) - 1]
    apart = begin[1:] - end[:-1] > _ONE_TEST * float(np.max(end - begin))
    test = np.concatenate([[0], np.cumsum(apart)]).astype(np.int64)
    return np.repeat(test, np.diff(np.append(first, len(time))))


def between_runs(slopes: Floats, residuals: Floats, test: Integers) -> BetweenRuns | None:
    """What the tests say of the estimates by differing; None where they agree, or are too few.

    `residuals` of least squares, of variance 1 each, `slopes` their derivatives (residuals, parameters) at the least,
    of full rank, and the `test` of each, 0 on.
    """
    tests, size = int(test.max(initial=-1)) + 1, slopes.shape[1]
    if tests < max(LEAST_TESTS, size + 2):
        return None
    basis, triangle = np.linalg.qr(slopes)
    known = np.array([basis[test == i].T @ basis[test == i] for i in range(tests)])  # they add up to one
    pull = np.array([basis[test == i].T @ residuals[test == i] for i in range(tests)])
    if not _disagree(known, pull) or float(np.linalg.eigvalsh(known).max()) > _ALONE:
        return None
    # the estimates without a test, by one step of Gauss and Newton
    without = -np.linalg.solve(np.eye(size) - known, pull[:, :, None])[:, :, 0]
    without = np.linalg.solve(triangle, (without - without.mean(axis=0)).T)
    return BetweenRuns((tests - 1) / tests * (without @ without.T), tests - 1)


def _disagree(known: Floats, pull: Floats) -> bool:
    """Whether fits to each test alone would lower the sum of squares by more than noise within the tests does."""
    from scipy.stats import chi2

    singular, directions = np.linalg.eigh(known)
    seen = singular > _SEEN
    along = np.einsum("tji,tj->ti", directions, pull)
    lowered = float(np.sum(along[seen] ** 2 / singular[seen]))
    freedom = int(seen.sum()) - pull.shape[1]
    return freedom > 0 and float(chi2.sf(lowered, freedom)) < _DISAGREE
