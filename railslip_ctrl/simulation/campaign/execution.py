"""Execution of a campaign, in processes of this machine or on a Dask cluster, and repetition of single runs.

The runs of a campaign are divided into parts. The folder of the campaign contains a manifest, and a Parquet file for
each finished part. If a campaign is interrupted, a new call simulates only the missing parts.
"""

from __future__ import annotations

import asyncio
import json
import math
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from railslip_ctrl import __version__
from railslip_ctrl.core.errors import InputError, check_extra
from railslip_ctrl.core.folders import INCOMPLETE, LOCK, cache_folder, claimed, staged, unwritable
from railslip_ctrl.core.processes import cpu_count, processes
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.simulation.gpu import check_device, run_batch
from railslip_ctrl.simulation.run import Run, Simulator

from .specification import Campaign, described

if TYPE_CHECKING:
    import pyarrow as pa

Rows = list[dict[str, Any]]

REFUSED = "values not allowed"
"""Outcome of a run that is not simulated because a sampled value is not allowed, for example mass > loaded mass."""

MANIFEST = "manifest.json"
PARTS = "parts"
FORMAT = 2

# smallest and largest number of runs in a part, and number of parts between these limits; an interruption loses
# unfinished parts, so that they should be small, but the folder should not have too many files
_FEWEST_RUNS, _MOST_RUNS, _PARTS = 4, 500, 250
_GPU_PART = 100_000  # number of runs in a part on a GPU; enough to use all its processors
_AHEAD = 3  # number of queued parts for each worker; no worker waits, and memory does not grow with the number of runs
_REACH = 5.0  # s, longest wait for an answer of the scheduler


@dataclass(frozen=True)
class Measure:
    """A result of a run, which is a column of the results of a campaign.

    - name, title, unit: name of the column, title in reports, and unit.
    - read: function that returns the value for a run.
    - of_stop: if True, the value is null for a run that did not stop.
    - scale, shown_unit: reports show the value times `scale` (ratio), in `shown_unit` or, if this is empty, in `unit`.
    """

    name: str
    title: str
    unit: str
    read: Callable[[Run], float]
    of_stop: bool = False
    scale: float = 1.0
    shown_unit: str = ""

    def of(self, run: Run) -> float | None:
        """Return the value of the measure for a run; None if there is no value."""
        value = float(self.read(run)) if run.stopped or not self.of_stop else math.nan
        return None if math.isnan(value) else value


MEASURES = (
    Measure("braking_time_s", "braking time", "s", lambda run: run.braking_time, of_stop=True),
    Measure("braking_distance_m", "braking distance", "m", lambda run: run.braking_distance, of_stop=True),
    Measure("brake_energy_j", "brake energy", "J", lambda run: run.brake_energy, True, 1e-6, "MJ"),
    Measure("mean_abs_slip_error", "mean abs slip error", "1", lambda run: run.mean_abs_slip_error, of_stop=True),
    Measure("max_slip", "highest slip", "1", lambda run: run.max_slip),
    Measure("locked_fraction", "share of time locked", "1", lambda run: run.locked_fraction),
    Measure("max_torque_nm", "highest torque", "N*m", lambda run: run.max_torque),
    Measure("rms_torque_rate", "rms torque rate", "N*m/s", lambda run: run.rms_torque_rate),
)
"""Measures of which the statistics of a campaign are computed."""

OTHERS = (
    Measure("ended_at_s", "time at the end of the run", "s", lambda run: run.braking_time),
    Measure("ended_at_m", "distance at the end of the run", "m", lambda run: run.braking_distance),
    Measure("first_lock_s", "first lock; null: never", "s", lambda run: run.first_lock),
    Measure("final_speed", "speed at the end", "m/s", lambda run: run.final_speed),
    Measure(
        "mean_abs_slip_error_published",
        "mean abs slip error against 0.132/0.092",
        "1",
        lambda run: run.mean_abs_slip_error_published,
        of_stop=True,
    ),
    Measure("max_torque_rate", "highest torque rate", "N*m/s", lambda run: run.max_torque_rate),
    Measure("energy_error", "error of the energy balance", "1", lambda run: run.energies.error),
)
"""Measures that are stored, but without statistics."""

COLUMNS = MEASURES + OTHERS


def measured(name: str) -> Measure:
    """Return the measure in `MEASURES` with the given name; StopIteration for an unknown name."""
    return next(measure for measure in MEASURES if measure.name == name)


def row(number: int, values: dict[str, float], controller: str, run: Run | None) -> dict[str, Any]:
    """Return the results of a run by column; measures are None if `run` is None (values drawn for it not allowed)."""
    outcome = REFUSED if run is None else run.outcome.value
    measures = {measure.name: None if run is None else measure.of(run) for measure in COLUMNS}
    return {"run": number, "controller": controller, **values, "outcome": outcome, **measures}


def run_rows(campaign: Campaign, i: int) -> Rows:
    """Simulate run number i with every controller; return a row of results for each controller."""
    values, ready = campaign.values(i), dict[str, Simulator]()
    with suppress(InputError):
        case = campaign.case(i)
        for controller in case.controllers:
            with suppress(InputError):
                ready[controller.label] = Simulator(case.scenario, controller)
    runs = {name: simulator.run(case.seed) for name, simulator in ready.items()}
    return [row(i, values, name, runs.get(name)) for name in campaign.controller_names]


class Part(NamedTuple):
    """Part of a campaign: the runs with the numbers from `start` to `stop` - 1."""

    start: int
    stop: int


def check_version(version: str) -> None:
    """Raise InputError if this process has a version of the package other than `version`."""
    if version != __version__:
        raise InputError(f"scheduler: a worker has version {__version__} instead of {version}; install {version} there")


def run_part(campaign: Campaign, part: Part, version: str) -> Rows:
    """Simulate the runs of a part in a worker process; return their rows. InputError as in `check_version`."""
    check_version(version)
    return [row for i in range(*part) for row in run_rows(campaign, i)]


def gpu_part(campaign: Campaign, part: Part, version: str) -> Rows:
    """Simulate the runs of a part on the GPU of this machine; return their rows. InputError as in `check_version`."""
    check_version(version)
    runs: dict[tuple[int, str], Run] = {}
    for k, name in enumerate(campaign.controller_names):
        ready: dict[tuple[int, str], tuple[Simulator, Any]] = {}
        for i in range(*part):
            with suppress(InputError):
                case = campaign.case(i)
                ready[i, name] = Simulator(case.scenario, case.controllers[k]), case.seed
        runs |= dict(zip(ready, run_batch([*ready.values()]) if ready else (), strict=True))
    names = campaign.controller_names
    return [row(i, campaign.values(i), name, runs.get((i, name))) for i in range(*part) for name in names]


@dataclass(frozen=True)
class Store:
    """Results of a `campaign` in a `folder`; each file contains a part, which has `part_runs` runs."""

    campaign: Campaign
    folder: Path
    part_runs: int

    @classmethod
    def open(cls, campaign: Campaign, folder: Path, *, part_runs: int | None = None) -> Store:
        """Return the store of a campaign in a new or existing folder, without writing anything.

        `part_runs` is the number of runs in a part; a folder with results keeps the earlier number. InputError if
        the folder contains results of another campaign or of another version of the package, or other files.
        """
        if (folder / MANIFEST).exists():
            return cls._resumed(campaign, folder)
        if folder.exists() and (not folder.is_dir() or _foreign(folder)):
            raise InputError(f"out: {str(folder)!r} has other files; choose a new or empty folder")
        usual = max(_FEWEST_RUNS, min(_MOST_RUNS, campaign.runs // _PARTS))
        size = usual if part_runs is None else part_runs
        if size < 1:
            raise InputError(f"part_runs: {size} is not allowed; give an integer >= 1")
        return cls(campaign, folder, size)

    @classmethod
    def _resumed(cls, campaign: Campaign, folder: Path) -> Store:
        where = f"out: {str(folder)!r}"
        try:
            content = json.loads((folder / MANIFEST).read_text("utf-8"))
            known = content["package"], content["format"]
            version, fingerprint, size = content["version"], content["hash"], int(content["part_runs"])
        except (OSError, ValueError, LookupError, TypeError):
            raise InputError(f"{where}: {MANIFEST} is not the manifest of a campaign; choose another folder") from None
        if known != ("railslip_ctrl", FORMAT) or version != __version__:
            raise InputError(
                f"{where}: the campaign was begun with version {version} (format {known[1]}), but this is version "
                f"{__version__} (format {FORMAT}); finish it with version {version}, or choose another folder"
            )
        if fingerprint != campaign.fingerprint:
            raise InputError(
                f"{where} has the results of a different campaign; choose another folder, or give that campaign"
            )
        return cls(campaign, folder, size)

    @contextmanager
    def claimed(self) -> Iterator[Store]:
        """Lock the folder for this process, and write the manifest if the folder has none.

        InputError if another process has locked the folder, or if the folder is not writable.
        """
        with claimed(self.folder):
            # opened again, because another process may have begun the campaign meanwhile
            store = Store.open(self.campaign, self.folder, part_runs=self.part_runs)
            try:
                store._begin()
                yield store
            except BaseException:
                if not any(store.finished()):
                    with suppress(OSError):
                        (self.folder / MANIFEST).unlink()
                        (self.folder / PARTS).rmdir()
                raise

    def _begin(self) -> None:
        content = {
            "format": FORMAT,
            "package": "railslip_ctrl",
            "version": __version__,
            "hash": self.campaign.fingerprint,
            "part_runs": self.part_runs,
            "campaign": described(self.campaign),
        }
        try:
            (self.folder / PARTS).mkdir(exist_ok=True)
            for path in list(self.folder.rglob(f"{INCOMPLETE}*")):
                shutil.rmtree(path, ignore_errors=True)
            if not (self.folder / MANIFEST).exists():
                with staged(self.folder) as new:
                    (new / MANIFEST).write_text(json.dumps(content, indent=2) + "\n", "utf-8")
        except OSError as error:
            raise unwritable(self.folder, error) from None

    def part(self, i: int) -> Part:
        """Return the part that contains run number i."""
        start = i // self.part_runs * self.part_runs
        return Part(start, min(start + self.part_runs, self.campaign.runs))

    def parts(self) -> Iterator[Part]:
        """Yield all parts in order."""
        return map(self.part, range(0, self.campaign.runs, self.part_runs))

    def path(self, part: Part) -> Path:
        """Return the path of the file of a part; the file exists only if the part is finished."""
        return self.folder / PARTS / f"runs-{part.start:010d}-{part.stop - 1:010d}.parquet"

    def finished(self) -> Iterator[Part]:
        """Yield the finished parts in order."""
        return (part for part in self.parts() if self.path(part).is_file())

    @property
    def complete(self) -> bool:
        """True if every part is finished."""
        return all(self.path(part).is_file() for part in self.parts())

    def write(self, part: Part, rows: Rows) -> None:
        """Write the `rows` of a part to its file; InputError if the folder is not writable."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        table = pa.Table.from_pylist(rows, schema=self.schema())
        try:
            with staged(self.folder / PARTS) as new:
                pq.write_table(table, new / self.path(part).name, compression="zstd")
        except OSError as error:
            raise unwritable(self.folder, error) from None

    def read(self, part: Part, columns: list[str] | None = None) -> pa.Table:
        """Return the rows of a part in order of run and controller.

        `columns` are the names of the columns to read, by default all. InputError for a damaged file.
        """
        import pyarrow as pa
        import pyarrow.parquet as pq

        path = self.path(part)
        try:
            table = pq.ParquetFile(path).read(columns)
        except (OSError, pa.ArrowInvalid) as error:
            raise InputError(
                f"{path} cannot be read ({' '.join(str(error).split())}); delete the file and run the campaign again"
            ) from None
        expected = (part.stop - part.start) * len(self.campaign.controllers)
        if table.num_rows != expected:
            raise InputError(
                f"{path} has {table.num_rows} rows instead of {expected}; delete the file and run the campaign again"
            )
        return table

    def row(self, i: int) -> dict[str, dict[str, Any]]:
        """Return the row of run number i for each controller, by name; empty if the run has not been stored."""
        rows = self.read(self.part(i)).to_pylist() if self.path(self.part(i)).is_file() else []
        return {row["controller"]: row for row in rows if row["run"] == i}

    def schema(self) -> pa.Schema:
        """Columns of the Parquet files: name, type, unit and title of each."""
        import pyarrow as pa

        def number(name: str, unit: str, title: str) -> pa.Field:
            return pa.field(name, pa.float64(), metadata={"unit": unit, "title": title})

        sampled = [number(name, unit, "sampled") for name, unit in self.campaign.quantity_units.items()]
        measures = [number(measure.name, measure.unit, measure.title) for measure in COLUMNS]
        controller, outcome = (pa.field(name, pa.string()) for name in ("controller", "outcome"))
        return pa.schema([pa.field("run", pa.int64()), controller, *sampled, outcome, *measures])


def _foreign(folder: Path) -> bool:
    return any(
        not path.name.startswith((INCOMPLETE, LOCK))
        and not (path.name == PARTS and path.is_dir() and not any(path.iterdir()))
        for path in folder.iterdir()
    )


def execute(
    campaign: Campaign,
    folder: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    part_runs: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> Store:
    """Simulate the parts of a `campaign` that are missing in a new or existing `folder`; return the complete results.

    The options have no effect on the results:

    - `workers`: number of processes, by default one for each core; with 1 the runs are simulated in this process.
    - `scheduler`: address of a Dask scheduler (``tcp://host:8786``), whose workers then run the campaign. The workers
      need the same version of this package, but no common file system.
    - `part_runs`: number of runs in a part; the default depends on the number of runs in the campaign.
    - `progress`: function that is called with the number of runs already stored, then with the number of runs of each
      newly finished part.

    InputError if the folder contains other files, is not writable, or is locked by another process; if a worker process
    ends unexpectedly; or if the cluster cannot be reached or has another version of this package.
    """
    work: Work = run_part
    if campaign.device == "gpu":
        check_device()
        work, workers, part_runs = gpu_part, 1, part_runs or _GPU_PART
    made = workers_for(work, campaign, workers, scheduler)
    tell = progress or (lambda runs: None)
    store = Store.open(campaign, folder, part_runs=part_runs)
    if store.complete:
        tell(campaign.runs)
        return store
    # connect to the cluster before anything is written
    with made as (submit, ahead), store.claimed() as store:
        tell(sum(part.stop - part.start for part in store.finished()))
        for controller in campaign.controllers:  # compile each kernel once while the workers start
            Simulator(campaign.scenario, controller).run()
        waiting: dict[Future[Rows], Part] = {}
        parts = (part for part in store.parts() if not store.path(part).is_file())
        while True:
            for part in islice(parts, ahead - len(waiting)):
                waiting[submit(part)] = part
            if not waiting:
                return store
            for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                part = waiting.pop(future)
                store.write(part, future.result())
                tell(part.stop - part.start)


Work = Callable[[Any, Any, str], Any]
"""Function that a worker process calls with the data common to all tasks, a task, and the version of the package."""

Workers = tuple[Callable[[Any], "Future[Any]"], int]
"""Function that submits a task, and how many submitted tasks keep every worker process busy."""


def workers_for(work: Work, shared: Any, workers: int | None, scheduler: str | None) -> AbstractContextManager[Workers]:
    """Return workers that compute tasks: this process, several processes, or a cluster.

    - work: function that computes a task.
    - shared: data common to all tasks.
    - workers, scheduler: number of processes, or address of a Dask scheduler, as for `execute`.
    """
    check_extra("campaign", "campaign")
    if workers is not None and scheduler is not None:
        raise InputError(
            "workers: not allowed with a scheduler, whose cluster has its own workers; give workers or scheduler"
        )
    count = cpu_count() if workers is None else workers
    if count < 1:
        raise InputError(f"workers: {count} is not allowed; give an integer >= 1")
    if scheduler is not None:
        return _cluster(work, shared, scheduler)
    return nullcontext((partial(_at_once, work, shared), 1)) if count == 1 else _processes(work, shared, count)


def _at_once(work: Work, shared: Any, task: Any) -> Future[Any]:
    done: Future[Any] = Future()
    done.set_result(work(shared, task, __version__))
    return done


@contextmanager
def _processes(work: Work, shared: Any, count: int) -> Iterator[Workers]:
    cache_folder()  # created before the workers start, so that they share a temporary folder
    try:
        with processes(
            count
        ) as submit:  # threads would wait for each other: a run needs Python's lock a third of its time
            for _ in range(count):
                submit(_nothing)  # each call starts a process
            yield lambda task: submit(work, shared, task, __version__), _AHEAD * count
    except BrokenProcessPool:
        raise InputError(
            "workers: a worker process ended, perhaps for lack of memory; run the command again with fewer workers"
        ) from None


def _nothing() -> None:
    """Do nothing: a worker process starts and imports the package when its first task is submitted."""


@contextmanager
def _cluster(work: Work, shared: Any, scheduler: str) -> Iterator[Workers]:
    check_extra("cluster", "--scheduler")
    from distributed import Client, KilledWorker

    try:
        asyncio.run(_reach(scheduler))
        client = Client(scheduler, timeout=_REACH, set_as_default=False)
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split()) or f"no answer within {_REACH:g} s"
        raise InputError(f"scheduler: {scheduler!r} cannot be reached ({reason}); give another address") from None
    try:
        with client:
            sent = client.scatter(shared, broadcast=True, hash=False)
            submit = client.get_executor(pure=False).submit
            ahead = _AHEAD * max(1, sum(client.nthreads().values()))
            yield lambda task: submit(work, sent, task, __version__), ahead
    except (KilledWorker, CancelledError, TimeoutError) as error:
        raise InputError(
            f"scheduler: a task failed on the cluster ({' '.join(str(error).split())[:200]}); run the command again to "
            "continue"
        ) from None


async def _reach(scheduler: str) -> None:
    """Raise an error at once if a scheduler does not answer; a Dask client would wait longer and print warnings."""
    from distributed import Security
    from distributed.core import rpc

    ask = rpc(scheduler, timeout=_REACH, connection_args=Security().get_connection_args("client"))
    try:
        await asyncio.wait_for(ask.identity(), _REACH)
    finally:
        await ask.close_rpc()


@dataclass(frozen=True)
class Replay:
    """A run of a campaign that was simulated again.

    - number, values: number of the run, and sampled values by name, SI.
    - runs: the run with each controller, by name.
    - stored: True if the folder of the campaign contains results of this run; the repeated run then agrees with them.
    """

    number: int
    values: dict[str, float]
    runs: dict[str, Run]
    stored: bool


def replay(campaign: Campaign, i: int, folder: Path | None = None) -> Replay:
    """Simulate run number `i` (from 0) of a `campaign` again and record its time series at every sample.

    InputError for an i out of range, for sampled values that are not allowed, or if the results differ from those in
    the `folder` of the campaign. Another processor or another version of NumPy may round differently. For a campaign on
    a GPU, relative differences up to 1e-9 are accepted.
    """
    case = campaign.case(i)
    runs = {c.label: Simulator(case.scenario, c).run(case.seed, record_every=1) for c in case.controllers}
    stored = {} if folder is None else Store.open(campaign, folder).row(i)
    for name, before in stored.items():
        again = row(i, case.values, name, runs[name])
        for column, value in before.items():
            if again[column] != value and not (campaign.device == "gpu" and _close(again[column], value)):
                raise InputError(
                    f"run {i}, {name}: {column} is {again[column]!r} in the repeated run, but {value!r} in the folder; "
                    "replay the run on the machine of the campaign, with the same versions"
                )
    return Replay(i, case.values, runs, bool(stored))


def _close(one: Any, other: Any) -> bool:
    return isinstance(one, float) and isinstance(other, float) and math.isclose(one, other, rel_tol=1e-9, abs_tol=1e-9)
