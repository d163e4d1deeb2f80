"""A design report put together: independent sections computed side by side in processes."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple

from railslip_ctrl.assessment import limits_of
from railslip_ctrl.design import PIController
from railslip_ctrl.design_check import DesignCheck
from railslip_ctrl.errors import RailslipError
from railslip_ctrl.kept import found as look_up
from railslip_ctrl.kept import kept
from railslip_ctrl.kernels import compilation
from railslip_ctrl.kernels.compilation import cache_folder
from railslip_ctrl.linearization import OperatingPoint, linearize
from railslip_ctrl.machine import Submit, cores, processes
from railslip_ctrl.parameters import PIGains, Vehicle
from railslip_ctrl.reproduction import Fact, Table5, published_facts, table5
from railslip_ctrl.simulation.designed import is_published
from railslip_ctrl.sliding.derivation import derive
from railslip_ctrl.sliding.errata import errata
from railslip_ctrl.sliding.gains import PUBLISHED_LAW
from railslip_ctrl.sliding_verification import FullVerification, Law, verify_with_actuator

from .loops import gain_region, law_curves, loop_designs, recommended_group
from .records import DesignReport, LinearPart, LoopDesigns, RunPart, SlidingVerdict
from .stops import stops

Progress = Callable[[str], None]
Part = LinearPart | RunPart
Work = Callable[[], None]

SEEDS = 64
"""Noise seeds of the paper's runs here; `railslip reproduce` takes 256."""

SECTIONS = {
    "paper": "conditions of the published sliding-mode law",
    "layered": "conditions of the layered sliding-mode law",
    "runs": "braking runs, and the paper's numbers",
    "errata": "errata of the paper",
}
"""What is computed beside the loops, by name, the longest first."""

KEPT = SECTIONS | {"runs": "the paper's numbers (Table 5 and what follows from it)"}
"""What an earlier report may have kept, by name; braking runs are made anew each time."""

_FROM_CACHE = " (taken from the cache of results)"


def design_report(
    check: DesignCheck,
    points: Sequence[OperatingPoint],
    *,
    given: PIGains | None = None,
    workers: int | None = None,
    fresh: bool = False,
    progress: Progress = lambda message: None,
    meanwhile: Callable[[Part], Sequence[Work]] = lambda part: (),
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
    fresh : bool
        Compute again what does not change from report to report (conditions of the sliding-mode laws for the vehicle,
        the paper's numbers, its errata), and is kept otherwise.
    progress : callable
        Told what is done, a line at a time.
    meanwhile : callable
        Handed the linear part and the braking runs while the rest is still computed; what it returns is called, piece
        by piece, before anything is waited for: to draw them.

    Raises
    ------
    InputError, DomainError, KinkError
        What the operating points do not allow; a section that cannot be had says so in its place instead.
    """
    started = time.perf_counter()
    tasks: dict[str, Callable[[], Any]] = {
        "paper": partial(_verified, "paper", check.vehicle, fresh),
        "layered": partial(_verified, "layered", check.vehicle, fresh),
        "runs": partial(
            _runs, tuple(points), given, None if check.holding is None else check.holding.controller, fresh
        ),
        "errata": partial(_errata, fresh),
    }
    # looked for here, so that no process is started for what is there
    found: dict[str, Any] = {} if fresh else _found_before(check.vehicle)
    left = {name: task for name, task in tasks.items() if name not in found}
    work: list[Work] = []

    def take(results: Iterable[tuple[str, _Found]]) -> None:
        for name, found[name] in results:
            progress(f"done: {SECTIONS[name]}{_FROM_CACHE if found[name].from_cache else ''}")
            if name == "runs":
                work.extend(meanwhile(found[name].value))

    take(list(found.items()))
    with _started(left, cores() if workers is None else workers) as under_way:
        plants = tuple(linearize(point) for point in points)
        progress("adhesion curves, stabilising region")
        curves, region = law_curves(plants), gain_region(check, plants)
        limits = tuple(limits_of(plant, check.vehicle.actuator) for plant in plants)
        take(under_way.ready())
        progress("designs side by side")
        loops = loop_designs(check, plants, given)
        linear = LinearPart(check, plants, limits, curves, region, loops, recommended=recommended_group(loops))
        work.extend(meanwhile(linear))
        while work or under_way.any():
            take(under_way.ready() if work else under_way.next())
            if work:
                work.pop(0)()
    return DesignReport(
        **vars(linear),
        **vars(found["runs"].value),
        sliding=_sliding(found["paper"].value, found["layered"].value, loops),
        errata=found["errata"].value,
        seconds=time.perf_counter() - started,
        from_cache=tuple(KEPT[name] for name in SECTIONS if found[name].from_cache),
    )


def _sliding(paper: FullVerification | str, layered: FullVerification | str, loops: LoopDesigns) -> SlidingVerdict:
    """Both laws' conditions, or the reasons, with the gains they were decided with."""
    reasons = {name: one for name, one in (("paper", paper), ("layered", layered)) if isinstance(one, str)}
    gains: dict[str, tuple[tuple[str, float, str], ...]] = {}
    if not isinstance(paper, str):
        gains["paper"] = (
            ("ρ", PUBLISHED_LAW.rho, "1/s"),
            ("k1", PUBLISHED_LAW.k1, "s²/(kg² m⁴)"),
            ("k2", PUBLISHED_LAW.k2, "-"),
        )
    within = next((one.controller for one in loops.designs if one.needs_hold), None)
    if not isinstance(layered, str) and within is not None:
        kp, ki = within.gains.kp, within.gains.ki
        gains["layered"] = (
            ("kp = K/layer", kp, "N·m/(m/s)"),
            ("ki = ρ K/layer", ki, "N·m/m"),
            ("ρ", ki / kp, "1/s"),
            ("layer", layered.verification.K / kp, "m/s"),
            ("lead", within.lead, "s"),
            ("filter of the lead", within.lead_filter, "s"),
        )
    return SlidingVerdict(
        None if isinstance(paper, str) else paper, None if isinstance(layered, str) else layered, reasons, gains
    )


# --- tasks ----------------------------------------------------------------------------------------------------------


class _Found(NamedTuple):
    """What a task gave, and whether an earlier report had kept it."""

    value: Any
    from_cache: bool = False


def _found_before(vehicle: Vehicle) -> dict[str, _Found]:
    """Results of tasks that are nothing but what an earlier report kept, by task."""
    car = vehicle.model_dump_json()
    places = {"paper": ("conditions-paper", car), "layered": ("conditions-layered", car), "errata": ("errata", "")}
    values = {task: look_up(name, given) for task, (name, given) in places.items()}
    return {task: _Found(value, True) for task, value in values.items() if value is not None}


def _taken(name: str, compute: Callable[[], Any], given: str = "", *, fresh: bool) -> _Found:
    """A result kept or computed, and which of the two."""
    computed = False

    def noted() -> Any:
        nonlocal computed
        computed = True
        return compute()

    value = kept(name, noted, given, fresh=fresh)
    return _Found(value, not computed)


def _verified(law: Law, vehicle: Vehicle, fresh: bool) -> _Found:
    """The conditions of a law, or why they cannot be decided for this vehicle."""
    decided = partial(verify_with_actuator, law=law, vehicle=vehicle)
    try:
        with _compilation_told(at_most=0):  # the braking runs, in another process, tell it
            return _taken(f"conditions-{law}", decided, vehicle.model_dump_json(), fresh=fresh)
    except RailslipError as error:
        return _Found(str(error))


def _runs(
    points: tuple[OperatingPoint, ...], given: PIGains | None, holding: PIController | None, fresh: bool
) -> _Found:
    """Braking runs and, of the published vehicle, the paper's numbers: the same compiled kernels serve both."""
    with _compilation_told(at_most=1):
        braking = stops(points, given, holding)
        if not is_published(points[0].vehicle):
            return _Found(RunPart(braking, None, ()))
        paper, from_cache = _taken("paper", _paper_numbers, str(SEEDS), fresh=fresh)
        return _Found(RunPart(braking, *paper), from_cache)


def _paper_numbers() -> tuple[Table5, tuple[Fact, ...]]:
    return table5(SEEDS), published_facts()


def _errata(fresh: bool) -> _Found:
    return _taken("errata", lambda: errata(derive()), fresh=fresh)


# --- processes ------------------------------------------------------------------------------------------------------


class _UnderWay:
    """Tasks in other processes, or, without one, done when they are asked for; each result is handed out once."""

    def __init__(self, tasks: dict[str, Callable[[], Any]], submit: Submit | None) -> None:
        self._tasks = {} if submit is not None else dict(tasks)
        self._futures = {} if submit is None else {submit(task): name for name, task in tasks.items()}

    def any(self) -> bool:
        """Whether results are still to come."""
        return bool(self._tasks or self._futures)

    def ready(self) -> list[tuple[str, Any]]:
        """Results there are by now, with their names."""
        return [self._handed(future) for future in list(self._futures) if future.done()]

    def next(self) -> list[tuple[str, Any]]:
        """The results that come next."""
        if self._tasks:
            name = next(iter(self._tasks))
            return [(name, self._tasks.pop(name)())]
        wait(self._futures, return_when=FIRST_COMPLETED)
        return self.ready()

    def _handed(self, future: Future[Any]) -> tuple[str, Any]:
        return self._futures.pop(future), future.result()


@contextmanager
def _started(tasks: dict[str, Callable[[], Any]], workers: int) -> Iterator[_UnderWay]:
    """The tasks under way, in as many processes; with a single core in this one."""
    if workers < 2 or not tasks:
        yield _UnderWay(tasks, None)
        return
    cache_folder()  # theirs too, where there is none but for this run
    with processes(min(workers, len(tasks))) as submit:
        yield _UnderWay(tasks, submit)


@contextmanager
def _compilation_told(at_most: int) -> Iterator[None]:
    """Kernels of several laws and controllers are compiled the first time; one line says why it takes long."""
    told: list[logging.LogRecord] = []

    def first(record: logging.LogRecord) -> bool:
        told.append(record)
        return len(told) <= at_most

    logger = logging.getLogger(compilation.__name__)
    logger.addFilter(first)
    try:
        yield
    finally:
        logger.removeFilter(first)
