"""A campaign run: on the cores of one machine, or on a Dask cluster; and one of its runs again, with its signals."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from railslip_ctrl import __version__
from railslip_ctrl.core.arguments import checked
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.folders import cache_folder
from railslip_ctrl.core.processes import cpu_count, processes
from railslip_ctrl.simulation.run import Run, Simulator
from railslip_ctrl.simulation.scenario import Scenario

from .rows import refused_row, row
from .specification import Campaign, Quantity
from .statistics import CampaignSummary, summarise
from .storage import Part, Store

if TYPE_CHECKING:
    from distributed import Client

Rows = list[dict[str, Any]]
Progress = Callable[[int], None]

_AHEAD = 3  # parts in the queue for each worker: none waits, and memory does not grow with the runs


def execute(
    campaign: Campaign,
    folder: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    part_runs: int | None = None,
    progress: Progress | None = None,
) -> Store:
    """Run what of a campaign is not in its folder yet.

    Parameters
    ----------
    campaign : Campaign
    folder : Path
        Made, or resumed where it holds the same campaign; one process at a time.
    workers : int, optional
        Processes; left out, as many as there are cores to use. One runs in this process.
    scheduler : str, optional
        Address of a Dask scheduler (``tcp://host:8786``) whose workers run the campaign in their place; they need
        this package in the same version, and no common file system.
    part_runs : int, optional
        Runs from one checkpoint to the next; left out, by the number of runs.
    progress : callable, optional
        Told the number of runs that are done, first of those that were already there.

    Returns
    -------
    Store
        Complete. Its rows depend on neither workers nor scheduler nor part_runs.

    Raises
    ------
    InputError
        The folder holds something else, is being written to or cannot be; a worker died; the cluster cannot be reached
        or has another version.
    """
    count = _workers(workers, scheduler)
    tell = progress or (lambda runs: None)
    store = Store.open(campaign, folder, part_runs=part_runs)
    if store.complete:
        tell(campaign.runs)
        return store
    # a cluster that is not there is found out before anything is written
    with _connected(scheduler) as client, store.claimed() as store:
        tell(sum(part.stop - part.start for part in store.finished()))
        with _map(campaign, count, client) as run_parts:
            warm_up(campaign)  # while the workers start
            for part, rows in run_parts(store.missing()):
                store.write(part, rows)
                tell(part.stop - part.start)
    return store


@checked
def campaign(
    scenario: Scenario,
    controllers: Sequence[Any],
    runs: int = 200,
    *,
    quantities: Sequence[Quantity] = (),
    seed: int = 0,
    folder: str | Path | None = None,
    workers: int = 1,
) -> CampaignSummary:
    """Many runs of a scenario, each with noise of its own, the same for every controller.

    Parameters
    ----------
    scenario : Scenario
        The run, SI.
    controllers : sequence
        One or more, whatever `simulate` takes.
    runs : int
        Number of runs of each.
    quantities : sequence of Quantity
        What else differs from run to run, SI.
    seed : int
        Number that the runs repeat with.
    folder : str or Path, optional
        Where the runs are kept, and resumed; left out, nothing is kept.
    workers : int, optional
        Number of processes; more than this one import the calling script again, which then needs its
        `if __name__ == "__main__"`.

    Returns
    -------
    CampaignSummary
        Statistics in SI; its `table()` has a line a controller.

    Raises
    ------
    InputError
        As of `Campaign` and `execute`.
    """
    told = Campaign(scenario, tuple(controllers), runs, tuple(quantities), seed)
    with ExitStack() as kept:
        place = kept.enter_context(TemporaryDirectory()) if folder is None else folder
        return summarise(execute(told, Path(place) / "campaign" if folder is None else Path(place), workers=workers))


def warm_up(campaign: Campaign) -> None:
    """Compile every controller's kernel, once and not in every worker. InputError for a controller that fails."""
    for controller in campaign.controllers:
        Simulator(campaign.scenario, controller).run()


def run_rows(campaign: Campaign, i: int) -> Rows:
    """The rows of run number i, one a controller."""
    try:
        case = campaign.case(i)
    except InputError:
        return [refused_row(i, campaign.values(i), name) for name in campaign.controller_names]
    rows = []
    for controller in case.controllers:
        try:
            simulator = Simulator(case.scenario, controller)
        except InputError:
            rows.append(refused_row(i, case.values, controller.name))
            continue
        rows.append(row(i, case.values, controller.name, simulator.run(case.seed)))
    return rows


def run_part(campaign: Campaign, part: Part, version: str) -> Rows:
    """The rows of a part; what a worker does. InputError where the worker's package has another version."""
    if version != __version__:
        raise InputError(
            f"--scheduler: a worker has version {__version__} in place of {version}; install the same there"
        )
    return [row for i in range(*part) for row in run_rows(campaign, i)]


@dataclass(frozen=True)
class Replay:
    """A run of a campaign again, with its time series.

    Attributes
    ----------
    number : int
    values : dict
        What was sampled, SI, by name.
    runs : dict
        By controller, with signals.
    stored : bool
        Whether the campaign's folder has the run; then every number of it was found equal to the last bit.
    """

    number: int
    values: dict[str, float]
    runs: dict[str, Run]
    stored: bool


def replay(campaign: Campaign, i: int, folder: Path | None = None, *, record_every: int = 1) -> Replay:
    """Run number i of a campaign again, with its time series.

    Parameters
    ----------
    campaign : Campaign
    i : int
        From 0.
    folder : Path, optional
        Where the campaign was run: the numbers are compared with the row stored there, if there is one.
    record_every : int
        Samples from one row of signals to the next.

    Raises
    ------
    InputError
        A number out of range, values that were refused, or a stored row that is not reproduced (another processor or
        another NumPy may round differently).
    """
    case = campaign.case(i)
    runs = {c.name: Simulator(case.scenario, c).run(case.seed, record_every=record_every) for c in case.controllers}
    stored = None if folder is None else Store.open(campaign, folder).row(i)
    for name, run in runs.items():
        if stored is not None:
            _check_same(row(i, case.values, name, run), stored[name])
    return Replay(i, case.values, runs, stored is not None)


def _check_same(found: dict[str, Any], kept: dict[str, Any]) -> None:
    for column, value in kept.items():
        again = found[column]
        if again != value:
            raise InputError(
                f"run {found['run']}, {found['controller']}: {column} is {again!r} and {value!r} is stored; replay it "
                "where the campaign ran, with the same versions"
            )


# --- where parts are run --------------------------------------------------------------------------------------------

Parts = Callable[[Iterable[Part]], Iterator[tuple[Part, Rows]]]


def _workers(workers: int | None, scheduler: str | None) -> int:
    if workers is None:
        return cpu_count()
    if scheduler is not None:
        raise InputError("--workers: the cluster has its own; leave it out with --scheduler")
    if workers < 1:
        raise InputError(f"--workers: {workers} is not allowed; give an integer >= 1")
    return workers


@contextmanager
def _map(campaign: Campaign, workers: int, client: Client | None) -> Iterator[Parts]:
    """What runs parts and hands back their rows as they are done."""
    if client is not None:
        with _cluster(campaign, client) as parts:
            yield parts
    elif workers == 1:
        yield lambda missing: ((part, run_part(campaign, part, __version__)) for part in missing)
    else:
        with _processes(campaign, workers) as parts:
            yield parts


@contextmanager
def _processes(campaign: Campaign, workers: int) -> Iterator[Parts]:
    """In processes, not threads: making a run ready takes a third of its time and holds the interpreter's lock."""

    def run(missing: Iterable[Part]) -> Iterator[tuple[Part, Rows]]:
        waiting: dict[Future[Rows], Part] = {}
        for part in missing:
            waiting[submit(run_part, campaign, part, __version__)] = part
            if len(waiting) >= _AHEAD * workers:
                yield from _done(waiting)
        while waiting:
            yield from _done(waiting)

    cache_folder()  # theirs too, where there is none but for this run
    try:
        with processes(workers) as submit:
            for _ in range(workers):
                submit(_nothing)  # starts a process each
            yield run
    except BrokenProcessPool:
        raise InputError(
            "--workers: a worker process died (out of memory?); run the same command again, with fewer workers, and it "
            "goes on from what is there"
        ) from None


def _nothing() -> None:
    """Makes a worker start and import what it needs."""


def _done(waiting: dict[Future[Rows], Part]) -> Iterator[tuple[Part, Rows]]:
    for future in wait(waiting, return_when=FIRST_COMPLETED).done:
        yield waiting.pop(future), future.result()


@contextmanager
def _connected(scheduler: str | None) -> Iterator[Client | None]:
    """A client of the cluster; None without one."""
    if scheduler is None:
        yield None
        return
    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            '--scheduler: dask.distributed is not installed; pip install "railslip_ctrl[cluster]"'
        ) from None
    try:
        asyncio.run(_reach(scheduler))
        client = Client(scheduler, timeout=_REACH, set_as_default=False)
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split()) or f"no answer within {_REACH:g} s"
        raise InputError(f"--scheduler: {scheduler!r} cannot be reached ({reason}); give its address") from None
    with client:
        yield client


async def _reach(scheduler: str) -> None:
    """Ask whether a scheduler is there: a client that finds none would be a long time going, and not quietly."""
    from distributed import Security
    from distributed.core import rpc

    ask = rpc(scheduler, timeout=_REACH, connection_args=Security().get_connection_args("client"))
    try:
        await asyncio.wait_for(ask.identity(), _REACH)
    finally:
        await ask.close_rpc()


@contextmanager
def _cluster(campaign: Campaign, client: Client) -> Iterator[Parts]:
    from distributed import KilledWorker, as_completed
    from distributed.client import FutureCancelledError

    def run(missing: Iterable[Part]) -> Iterator[tuple[Part, Rows]]:
        shared = client.scatter(campaign, broadcast=True, hash=False)
        ahead = _AHEAD * max(1, sum(client.nthreads().values()))
        parts = iter(missing)
        waiting = as_completed(loop=client.loop, with_results=True)
        numbers: dict[str, Part] = {}

        def submit(part: Part) -> None:
            future = client.submit(run_part, shared, part, __version__, pure=False)
            numbers[future.key] = part
            waiting.add(future)

        for _, part in zip(range(ahead), parts, strict=False):  # in this order: zip asks the first one once more
            submit(part)
        for future, rows in waiting:
            yield numbers.pop(future.key), rows
            for part in parts:
                submit(part)
                break

    try:
        yield run
    except (KilledWorker, FutureCancelledError) as error:
        raise InputError(
            f"--scheduler: the cluster gave up ({' '.join(str(error).split())[:200]}); run the same command again "
            "and it goes on from what is there"
        ) from None


_REACH = 5.0  # s; a scheduler that does not answer by then is not there
