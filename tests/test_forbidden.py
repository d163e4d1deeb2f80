"""The gains that a specification forbids, against the definition of its margins on a dense grid."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from railslip_ctrl.design.specification import Specification
from railslip_ctrl.design.tuning_search import Forbidden
from railslip_ctrl.loop import Rational

PLANTS = {
    "lags": (Rational([], [-1.0, -4.0], 8.0), 0.3),
    "resonant": (Rational([], [-1.0, -0.2 + 1.5j, -0.2 - 1.5j], 2.0), 0.2),
    "unstable": (Rational([-3.0], [0.4, -2.0, -8.0], 6.0), 0.1),
    "antiresonant": (Rational([2j, -2j], [-1.0, -1.0, -3.0], 2.0), 0.4),
    "integrator": (Rational([], [0.0, -2.0], 2.0), 0.3),
    "late": (Rational([], [-1.0], 1.0), 6.0),
}
OMEGA = np.geomspace(1e-3, 200.0, 10_000)


def allowed(plant, dead_time, kp, ki, wanted):
    """Whether the loop has the margins at every frequency and crossover, stable or not."""
    with np.errstate(divide="ignore"):
        loop = (kp - 1j * ki / OMEGA) * plant(1j * OMEGA) * np.exp(-1j * OMEGA * dead_time)
        at = np.flatnonzero(np.diff(np.sign(np.log(np.abs(loop)))))
    left = np.angle(-loop[at])
    return (
        (wanted.ms_max is None or np.abs(1 + loop).min() >= 1 / wanted.ms_max)
        and np.all(np.abs(left) >= math.radians(wanted.phase_min_deg or 0.0))
        and (wanted.delay_min_s is None or np.all(np.mod(left, 2 * np.pi) >= wanted.delay_min_s * OMEGA[at]))
    )


@pytest.mark.parametrize("name", PLANTS)
@pytest.mark.parametrize(
    "wanted",
    [
        Specification(ms_max=1.8),
        Specification(phase_min_deg=35.0),
        Specification(delay_min_s=0.15),
        Specification(ms_max=3.0, phase_min_deg=40.0, delay_min_s=0.1),
    ],
    ids=lambda wanted: wanted.words,
)
def test_gaps_are_what_the_margins_leave(name, wanted):
    plant, dead_time = PLANTS[name]
    forbidden, rng = Forbidden([plant], [dead_time], [20.0]), np.random.default_rng(1)
    for ki in (0.05, 0.8, 3.0):
        gaps = forbidden.gaps(ki, wanted)
        assert gaps == forbidden.gaps(ki, replace(wanted, crossover=(0.0, math.inf)))
        ends = np.array(gaps).ravel()
        for kp in rng.normal(size=30) * rng.choice([0.3, 3.0, 10.0], 30):
            if np.abs(ends - kp).min(initial=1.0) > 0.02 * max(abs(kp), 1.0):  # both are rough next to an end
                inside = any(low < kp < high for low, high in gaps)
                assert inside == allowed(plant, dead_time, kp, ki, wanted), (ki, kp)


@pytest.mark.parametrize("name", PLANTS)
def test_the_end_above_is_the_least_ki_that_ms_forbids(name):
    plant, dead_time = PLANTS[name]
    wanted, forbidden = Specification(ms_max=2.0), Forbidden([plant], [dead_time], [20.0])
    for start in (0.01, 0.3, 1.0):
        for kp in (-0.5, 0.1, 0.4, 1.0):
            end = forbidden.end_above(kp, start, 2.0)
            looks = np.geomspace(start, min(end, 100.0) * (1 - 1e-5), 8) if end else []
            assert all(allowed(plant, dead_time, kp, ki, wanted) for ki in looks)
            if end < 100.0:
                assert not allowed(plant, dead_time, kp, (end or start) * (1 + 1e-4), wanted)
