"""How often does the 95 % interval of the peak contain the true peak, and how often is a false delay reported?

The script counts logs of the virtual rig with random vehicles on random adhesion curves with one peak. No formula of
`identify` fits these curves exactly, so that the intervals must include the misfit. Each log has three tests from
100 km/h, with or without noise.

    python analysis/one_hump_curves.py [CURVES [FIRST_SEED]]
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context

import numpy as np

from railslip_ctrl import InputError
from railslip_ctrl.core.units import KMH
from railslip_ctrl.identification.curves import Options, curve_of
from railslip_ctrl.identification.identify import identify_curve
from railslip_ctrl.identification.virtual_rig import RigTest, run_tests
from railslip_ctrl.simulation.population import Peak, one_hump, peak_of, random_vehicle

CURVES = 200
V0 = 100.0 * KMH
TESTS = 3  # number of tests in a log
RATE = 0.116  # m/s, rate of torque over wheel load: 4 kN*m/s for the published vehicle
SILENT = {"random_force": 0.0, "wheel_noise": 0.0}


@dataclass(frozen=True)
class Identified:
    """Identification of one log: true peak, chosen model, 95 % intervals of slip and mu, and reported delay."""

    seed: int
    true: Peak
    model: str
    slip: tuple[float, float]
    mu: tuple[float, float]
    delayed: bool

    @property
    def covered(self) -> tuple[bool, bool]:
        """Whether the intervals of slip and of mu contain the true values."""
        return self.slip[0] <= self.true.slip <= self.slip[1], self.mu[0] <= self.true.mu <= self.mu[1]


def identified(seed: int, *, noisy: bool) -> Identified:
    """Identify the log for the random curve of a seed."""
    generator = np.random.default_rng(seed)
    vehicle = random_vehicle(generator)
    law = one_hump(generator)
    true = peak_of(law, V0, vehicle.wheel_load)
    noise = {} if noisy else SILENT
    rows = run_tests(RigTest(vehicle, law, V0, rate=RATE * vehicle.wheel_load, **noise), tests=TESTS, seed=seed)
    try:
        result = identify_curve(curve_of(rows, vehicle, Options(), name="virtual rig"), vehicle, Options())
    except InputError:  # if the log is refused, the peak counts as missed
        return Identified(seed, true, "refused", (math.nan, math.nan), (math.nan, math.nan), delayed=False)
    peak, delayed = result.own_peak, result.delay is not None
    return Identified(seed, true, result.chosen.fit.model.name, peak.slip_interval, peak.coefficient_interval, delayed)


def run(curves: int = CURVES, *, first: int = 0, workers: int | None = 1) -> dict[str, tuple[Identified, ...]]:
    """Return the results without and with noise; `workers` is the number of processes, None: all cores."""
    seeds, jobs = range(first, first + curves), {"without noise": False, "with noise": True}
    if workers == 1:
        return {name: tuple(identified(seed, noisy=noisy) for seed in seeds) for name, noisy in jobs.items()}
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        return {name: tuple(pool.map(partial(identified, noisy=noisy), seeds)) for name, noisy in jobs.items()}


def line(name: str, each: Sequence[Identified]) -> str:
    """Return a line of the table."""
    slip, mu = np.mean([x.covered for x in each], axis=0)
    widths = [[(x.slip[1] - x.slip[0]) / x.true.slip / 2.0, (x.mu[1] - x.mu[0]) / x.true.mu / 2.0] for x in each]
    of_slip, of_mu = 100.0 * np.nanmedian(widths, axis=0)
    table, delayed = (np.mean(which) for which in ([x.model == "table" for x in each], [x.delayed for x in each]))
    missed = ", ".join(str(x.seed) for x in each if not all(x.covered))
    return (
        f"{name:14s} {len(each):5d} {slip:8.1%} {mu:8.1%} {of_slip:8.1f} % {of_mu:8.1f} % {delayed:8.1%} {table:8.1%}"
        f"  {missed or 'none'}"
    )


def main() -> None:
    curves, first = (int(x) for x in (*sys.argv[1:], *(CURVES, 0)[len(sys.argv) - 1 :]))
    print("Shares of logs whose 95 % interval contains slip and mu of the peak; median half widths over true values;")
    print("shares with a reported delay and with the table as chosen model; seeds of logs with a missed peak")
    print("               curves  slip       mu   width slip   width mu  delays   table   missed")
    for name, each in run(curves, first=first, workers=None).items():
        print(line(name, each))


if __name__ == "__main__":
    main()
