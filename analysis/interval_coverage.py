"""How often do the 99 % intervals of an identification contain the true value?

The script counts logs of the virtual rig with different seeds, for the beam law and the dynamic bristle law at the four
speeds of [Park2008] Table 1. A log has six tests. At 30 km/h the adhesion hardly falls up to a slip of 0.5, so that the
intervals of beta and gamma often have no upper end. SPREAD is the relative standard deviation of the adhesion from test
to test, by default 0.

    python analysis/interval_coverage.py [SEEDS [SPREAD]]
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np

from railslip_ctrl.core.units import KMH
from railslip_ctrl.identification.curves import Options, curve_of
from railslip_ctrl.identification.fits import Parameter
from railslip_ctrl.identification.identify import identify_curve
from railslip_ctrl.identification.virtual_rig import RigTest, published_tests, run_tests

LAWS = ("beam", "bristle")
SEEDS = 100
TESTS = 6  # number of tests in a log


@dataclass(frozen=True)
class Coverage:
    """Coverage of the intervals of a parameter at one initial speed.

    Of the `logs`, the interval contains the true value in `covered` and has no upper end in `endless`. `width` is the
    median half width and `bias` the median error of the value, both relative to the true value.
    """

    law: str
    speed_kmh: float
    parameter: str
    logs: int
    covered: int
    endless: int
    width: float
    bias: float


def identified(test: RigTest, seed: int) -> tuple[Parameter, ...]:
    """Return the parameters of the test's law, identified from one log."""
    rows = run_tests(test, tests=TESTS, seed=seed)
    options = Options(model=test.law.name, initial_speed=test.initial_speed)
    curve = curve_of(rows, test.vehicle, options, name="virtual rig")
    return identify_curve(curve, test.vehicle, options).chosen.fit.parameters


def coverage(test: RigTest, name: str, estimates: Iterable[Parameter]) -> Coverage:
    """Return the coverage of the parameter `name`, estimated from each log."""
    truth, each = getattr(test.law, name), tuple(estimates)
    low, high = np.array([p.interval for p in each]).T
    return Coverage(
        law=test.law.name,
        speed_kmh=test.initial_speed / KMH,
        parameter=name,
        logs=len(each),
        covered=int(np.sum((low <= truth) & (truth <= high))),
        endless=int(np.sum(np.isinf(high))),
        width=float(np.median(high - low)) / (2.0 * truth),
        bias=float(np.median([p.value for p in each])) / truth - 1.0,
    )


def run(seeds: int = SEEDS, *, spread: float = 0.0, workers: int | None = 1) -> tuple[Coverage, ...]:
    """Return the coverage for each law, speed and parameter; `workers` is the number of processes, None: all cores."""
    tests = [dataclasses.replace(test, spread=spread) for law in LAWS for test in published_tests(law)]
    jobs = [test for test in tests for _ in range(seeds)], list(range(seeds)) * len(tests)
    if workers == 1:
        fits = list(map(identified, *jobs))
    else:
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            fits = list(pool.map(identified, *jobs))
    return tuple(
        coverage(test, p.name, (fit[i] for fit in fits[k * seeds : (k + 1) * seeds]))
        for k, test in enumerate(tests)
        for i, p in enumerate(fits[k * seeds])
    )


def main() -> None:
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else SEEDS
    spread = float(sys.argv[2]) if len(sys.argv) > 2 else 0.0
    print(
        f"Number of {seeds} logs whose 99 % interval contains the true value; its median half width, bias of the value"
    )
    for c in run(seeds, spread=spread, workers=None):
        width = "no end" if math.isinf(c.width) else f"{100 * c.width:5.1f} %"
        print(
            f"  {c.law:8s} {c.speed_kmh:4.0f} km/h  {c.parameter:7s} {c.covered:4d}  {width:>8s} {100 * c.bias:+6.1f} %"
            + (f"  {c.endless} without an upper end" if c.endless else "")
        )


if __name__ == "__main__":
    main()
