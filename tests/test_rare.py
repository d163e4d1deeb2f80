"""Rare events: estimates against closed forms, and their intervals; what cannot be trusted is reported."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from scipy import integrate, stats

from railslip_ctrl.simulation.campaign import subset

REPEATS = 8


class Case(NamedTuple):
    """A limit state, its number of inputs, the event's threshold and its probability in closed form."""

    limit_state: Callable[[np.ndarray], np.ndarray]
    inputs: int
    threshold: float
    probability: float
    points: int = 1000


def linear(inputs: int, probability: float, points: int = 1000) -> Case:
    """Beyond a plane that all inputs share in equally."""
    return Case(
        lambda z: z.sum(axis=1) / math.sqrt(inputs), inputs, float(-stats.norm.ppf(probability)), probability, points
    )


def _four_branches(z: np.ndarray) -> np.ndarray:
    """The series system of four branches, Waarts' example: the worst branch's excess."""
    first, second = z.T
    curve, sum_ = 3.0 + 0.1 * (first - second) ** 2, (first + second) / math.sqrt(2.0)
    far = 7.0 / math.sqrt(2.0)
    return -np.minimum.reduce([curve - sum_, curve + sum_, first - second + far, second - first + far])


def _four_branch_probability() -> float:
    """By quadrature in the axes u = (x + y)/sqrt 2, w = (x - y)/sqrt 2: safe for |w| < 3.5 and |u| < 3 + 0.2 w^2."""
    safe, _ = integrate.quad(lambda w: stats.norm.pdf(w) * (1 - 2 * stats.norm.sf(3 + 0.2 * w * w)), -3.5, 3.5)
    return 1.0 - safe


TWO_POINTS = Case(
    lambda z: np.minimum(np.abs(z[:, 0]), z[:, 1] + 2.0), 2, 3.5, 2 * stats.norm.sf(3.5) * stats.norm.sf(1.5)
)
DISCRETE = Case(lambda z: np.floor(2.0 * z[:, 0]), 3, 6.9, float(stats.norm.sf(3.5)))
CASES = {
    **{f"linear {n} {p:g}": linear(n, p) for n in (2, 20) for p in (1e-3, 1e-6, 1e-9)},
    **{f"linear 5000 {p:g}": linear(5000, p, 500) for p in (1e-3, 1e-6, 1e-9)},
    "four branches": Case(_four_branches, 2, 0.0, _four_branch_probability()),
    "parallel system, two design points": TWO_POINTS,
    "discrete": DISCRETE,
}


def estimated(case: Case, seed: int) -> tuple[subset.Pooled, list[subset.Repeat]]:
    """One estimate from a pilot and independent repeats."""
    streams = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(REPEATS + 1))
    levels = subset.pilot(case.limit_state, case.inputs, case.threshold, next(streams))
    repeats = [
        subset.repeat(case.limit_state, case.inputs, levels, case.threshold, rng, count=case.points) for rng in streams
    ]
    return subset.pooled(np.array([one.probability(case.threshold) for one in repeats])), repeats


def study(case: Case, estimates: int) -> tuple[float, float, float]:
    """Relative bias, its standard error, and the share of intervals that hold the probability."""
    found = [estimated(case, seed)[0] for seed in range(estimates)]
    values = np.array([one.value for one in found]) / case.probability
    inside = np.mean([one.low <= case.probability <= one.high for one in found])
    return float(values.mean() - 1.0), float(values.std(ddof=1) / math.sqrt(estimates)), float(inside)


@pytest.mark.parametrize("name", ["linear 2 1e-06", "four branches", "discrete"])
def test_estimates_are_without_bias_and_intervals_hold(name):
    bias, error, inside = study(CASES[name], 24)
    assert abs(bias) < 4.0 * error  # chance reaches this in one of 16 000
    assert inside >= 18 / 24  # of 24 intervals of 95 % chance leaves out more than 6 in one of 10 000


@pytest.mark.long
@pytest.mark.parametrize("name", CASES)
def test_bias_and_coverage_over_200_estimates(name):
    bias, error, inside = study(CASES[name], 200)
    print(f"{name}: bias {bias:+.4f} +- {error:.4f}, inside {inside:.3f}")
    assert abs(bias) < 0.05
    assert 0.90 <= inside <= 0.98
