"""A design report put together: independent sections computed side by side in processes."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from typing import Any

from railslip_ctrl.design_check import DesignCheck
from railslip_ctrl.errors import RailslipError
from railslip_ctrl.linearization import OperatingPoint, linearize
from railslip_ctrl.parameters import PIGains, Vehicle
from railslip_ctrl.reproduction import Fact, Table5, published_facts, table5
from railslip_ctrl.simulation.designed import is_published
from railslip_ctrl.sliding.derivation import derive
from railslip_ctrl.sliding.errata import errata
from railslip_ctrl.sliding.erratum import Erratum
from railslip_ctrl.sliding_verification import FullVerification, Law, verify_with_actuator

from .loops import gain_region, law_curves, loop_designs
from .records import DesignReport, LinearPart, SlidingVerdict, Stop
from .stops import stops

Progress = Callable[[str], None]
Reproduced = tuple[Table5 | None, tuple[Fact, ...]]

SEEDS = 64
"""Noise seeds of the paper's runs here; `railslip reproduce` takes 256."""

SECTIONS = {
    "paper": "conditions of the published sliding-mode law",
    "layered": "conditions of the layered sliding-mode law",
    "runs": "braking runs, and the paper's numbers",
    "errata": "errata of the paper",
}
"""What is computed beside the loops, by name, the longest first."""


def design_report(
    check: DesignCheck,
    points: Sequence[OperatingPoint],
    *,
    given: PIGains | None = None,
    workers: int | None = None,
    progress: Progress = lambda message: None,
    meanwhile: Callable[[LinearPart], None] = lambda part: None,
) -> DesignReport:
    """Everything of one vehicle that a design review looks at.

    Parameters
    ----------
    check : DesignCheck
        Margins of the published gains and of gains that hold, at `points`.
    points : sequence of OperatingPoint
        One or more, of the vehicle of `check`.
    given : PIGains, optional
        Gains to look at beside the published ones, SI.
    workers : int, optional
        Processes beside this one; left out, as many as there are cores, and none on a single core. A script that
        leaves it out guards its own code with ``if __name__ == "__main__"``, as processes demand.
    progress : callable
        Told what is done, a line at a time.
    meanwhile : callable
        Handed the linear part while the rest is still computed, to draw it.

    Raises
    ------
    InputError, DomainError, KinkError
        What the operating points do not allow; a section that cannot be had says so in its place instead.
    """
    started = time.perf_counter()
    tasks: dict[str, Callable[[], Any]] = {
        "paper": partial(_verified, "paper", check.vehicle),
        "layered": partial(_verified, "layered", check.vehicle),
        "runs": partial(_runs, tuple(points), given),
        "errata": _errata,
    }
    with _started(tasks, _cores() if workers is None else workers) as results:
        plants = tuple(linearize(point) for point in points)
        progress("adhesion curves, stabilising region")
        curves, region = law_curves(plants), gain_region(check, plants)
        progress("designs side by side")
        linear = LinearPart(check, plants, curves, region, loop_designs(check, plants, given))
        meanwhile(linear)
        found = {}
        for name, result in results.items():
            progress(SECTIONS[name])
            found[name] = result()
    braking, (comparison, facts) = found["runs"]
    verdicts = {name: found[name] for name in ("paper", "layered")}
    reasons = {name: one for name, one in verdicts.items() if isinstance(one, str)}
    decided = {name: None if name in reasons else one for name, one in verdicts.items()}
    return DesignReport(
        **vars(linear),
        sliding=SlidingVerdict(decided["paper"], decided["layered"], reasons),
        stops=braking,
        table5=comparison,
        facts=facts,
        errata=found["errata"],
        seconds=time.perf_counter() - started,
    )


# --- tasks ----------------------------------------------------------------------------------------------------------


def _verified(law: Law, vehicle: Vehicle) -> FullVerification | str:
    """The conditions of a law, or why they cannot be decided for this vehicle."""
    try:
        return verify_with_actuator(law=law, vehicle=vehicle)
    except RailslipError as error:
        return str(error)


def _runs(points: tuple[OperatingPoint, ...], given: PIGains | None) -> tuple[tuple[Stop, ...], Reproduced]:
    """Braking runs and, of the published vehicle, the paper's numbers: the same compiled kernels serve both."""
    braking = stops(points, given)
    if not is_published(points[0].vehicle):
        return braking, (None, ())
    return braking, (table5(SEEDS), published_facts())


def _errata() -> tuple[Erratum, ...]:
    return errata(derive())


# --- processes ------------------------------------------------------------------------------------------------------


@contextmanager
def _started(tasks: dict[str, Callable[[], Any]], workers: int) -> Iterator[dict[str, Callable[[], Any]]]:
    """The tasks under way; calling one gives its result. Without a second core they run when they are called."""
    if workers < 2:
        yield tasks
        return
    from multiprocessing import get_context

    # new processes, not copies: a copy of a process with threads may hang
    pool = ProcessPoolExecutor(min(workers, len(tasks)), mp_context=get_context("spawn"), initializer=_quiet)
    try:
        futures: dict[str, Future[Any]] = {name: pool.submit(task) for name, task in tasks.items()}
        yield {name: future.result for name, future in futures.items()}
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _quiet() -> None:
    """A worker leaves an interruption to the process that started it."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _cores() -> int:
    """Cores this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1
