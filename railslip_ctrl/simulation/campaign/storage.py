"""A campaign's folder: a manifest that says what it is, and one Parquet file for each finished part.

A part is written beside its place and moved there in one step, so that a file that is there is whole. The parts of a
campaign are fixed when it begins; which of them are there is all that a resumed campaign needs to know.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from railslip_ctrl import __version__
from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.folders import LOCK, claimed, unwritable

from .rows import COLUMNS
from .specification import Campaign

if TYPE_CHECKING:
    import pyarrow as pa

MANIFEST = "manifest.json"
PARTS = "parts"
FORMAT = 2

_INCOMPLETE = ".incomplete-"
# a part is what a kill costs and what one message of a worker carries: short, but never thousands of files
_FEWEST_RUNS, _MOST_RUNS, _PARTS = 4, 500, 250


class Part(NamedTuple):
    """Runs `start` to `stop` - 1."""

    start: int
    stop: int

    @property
    def file_name(self) -> str:
        return f"runs-{self.start:010d}-{self.stop - 1:010d}.parquet"


def usual_part(runs: int) -> int:
    """Runs in a part where nobody says."""
    return max(_FEWEST_RUNS, min(_MOST_RUNS, runs // _PARTS))


@dataclass(frozen=True)
class Store:
    """The folder of a campaign, begun or finished; a part, the unit of writing, has `part_runs` runs."""

    campaign: Campaign
    folder: Path
    part_runs: int

    @classmethod
    def open(cls, campaign: Campaign, folder: Path, *, part_runs: int | None = None) -> Store:
        """The store of a campaign in a folder; one that is there keeps its `part_runs`. Nothing is written.

        InputError where the folder holds something else: another campaign, another version's, or no campaign at all.
        """
        if (folder / MANIFEST).exists():
            return cls._resumed(campaign, folder)
        if folder.exists() and (not folder.is_dir() or _foreign(folder)):
            raise InputError(f"--out: {str(folder)!r} holds something else; choose a new or empty folder")
        size = usual_part(campaign.runs) if part_runs is None else part_runs
        if size < 1:
            raise InputError(f"part_runs: {size} is not allowed; give an integer >= 1")
        return cls(campaign, folder, size)

    @contextmanager
    def claimed(self) -> Iterator[Store]:
        """The store to write into, begun if it is not there; nobody else can claim it meanwhile.

        InputError where another process has it or the folder cannot be written to.
        """
        with claimed(self.folder):
            store = Store.open(self.campaign, self.folder, part_runs=self.part_runs)  # begun by now?
            store._begin()
            yield store

    def _begin(self) -> None:
        """Write the manifest, if there is none, and remove what a killed campaign had not finished writing."""
        content = {
            "format": FORMAT,
            "package": "railslip_ctrl",
            "version": __version__,
            "hash": self.campaign.fingerprint,
            "part_runs": self.part_runs,
            "campaign": self.campaign.described(),
        }
        text = json.dumps(content, indent=2) + "\n"
        try:
            (self.folder / PARTS).mkdir(exist_ok=True)
            for place in (self.folder, self.folder / PARTS):
                for path in place.glob(f"{_INCOMPLETE}*"):
                    path.unlink(missing_ok=True)
            if not (self.folder / MANIFEST).exists():
                _write(self.folder / MANIFEST, lambda path: path.write_text(text, "utf-8"))
        except OSError as error:
            raise unwritable(self.folder, error) from None

    @classmethod
    def _resumed(cls, campaign: Campaign, folder: Path) -> Store:
        where = f"--out: {str(folder)!r}"
        try:
            content = json.loads((folder / MANIFEST).read_text("utf-8"))
            known = content["package"], content["format"]
            version, fingerprint, size = content["version"], content["hash"], int(content["part_runs"])
        except (OSError, ValueError, LookupError, TypeError):
            raise InputError(f"{where} has a {MANIFEST} that is no campaign's; choose another folder") from None
        if known != ("railslip_ctrl", FORMAT) or version != __version__:
            raise InputError(
                f"{where} was begun with version {version} (format {known[1]}), this is {__version__} (format "
                f"{FORMAT}); finish it with that one, or choose another folder"
            )
        if fingerprint != campaign.fingerprint:
            raise InputError(
                f"{where} holds another campaign; choose another folder, or the campaign it was begun with"
            )
        return cls(campaign, folder, size)

    def parts(self) -> Iterator[Part]:
        """Every part, in order."""
        for start in range(0, self.campaign.runs, self.part_runs):
            yield Part(start, min(start + self.part_runs, self.campaign.runs))

    def path(self, part: Part) -> Path:
        """Where a part is, or will be."""
        return self.folder / PARTS / part.file_name

    def finished(self) -> Iterator[Part]:
        """The parts that are there, in order."""
        return (part for part in self.parts() if self.path(part).is_file())

    def missing(self) -> Iterator[Part]:
        """The parts still to be run, in order."""
        return (part for part in self.parts() if not self.path(part).is_file())

    @property
    def complete(self) -> bool:
        """Whether every part is there."""
        return next(self.missing(), None) is None

    def write(self, part: Part, rows: Sequence[dict[str, Any]]) -> None:
        """Write the `rows` of a part, all or nothing. InputError where the folder cannot be written to."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        table = pa.Table.from_pylist(list(rows), schema=self.schema())
        try:
            _write(self.path(part), lambda path: pq.write_table(table, path, compression="zstd"))
        except OSError as error:
            raise unwritable(self.folder, error) from None

    def read(self, part: Part, columns: Sequence[str] | None = None) -> pa.Table:
        """The rows of a part, in order of run and controller; all or some `columns`.

        InputError for a file that is damaged.
        """
        import pyarrow as pa
        import pyarrow.parquet as pq

        path = self.path(part)
        try:
            table = pq.ParquetFile(path).read(columns=None if columns is None else list(columns))
        except (OSError, pa.ArrowInvalid) as error:
            raise InputError(f"{path}: cannot be read ({' '.join(str(error).split())}); delete it and resume") from None
        expected = (part.stop - part.start) * len(self.campaign.controllers)
        if table.num_rows != expected:
            raise InputError(f"{path}: has {table.num_rows} rows in place of {expected}; delete it and resume")
        return table

    def tables(self, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
        """The finished parts one after the other, all or some `columns`: never more than one part in memory."""
        return (self.read(part, columns) for part in self.finished())

    def row(self, i: int) -> dict[str, dict[str, Any]] | None:
        """The rows of run number i by controller; None where its part is not there."""
        start = i // self.part_runs * self.part_runs
        part = Part(start, min(start + self.part_runs, self.campaign.runs))
        if not self.path(part).is_file():
            return None
        return {row["controller"]: row for row in self.read(part).to_pylist() if row["run"] == i}

    def schema(self) -> pa.Schema:
        """Columns, each with its unit and what it is."""
        import pyarrow as pa

        fields = [pa.field("run", pa.int64()), pa.field("controller", pa.string())]
        for name, unit in self.campaign.quantity_units.items():
            fields.append(pa.field(name, pa.float64(), metadata={"unit": unit, "title": "sampled"}))
        fields.append(pa.field("outcome", pa.string()))
        for measure in COLUMNS:
            fields.append(pa.field(measure.name, pa.float64(), metadata={"unit": measure.unit, "title": measure.title}))
        return pa.schema(fields)


def _foreign(folder: Path) -> bool:
    """Whether a folder without a manifest has anything in it that a killed beginning cannot have left."""
    return any(
        not path.name.startswith((_INCOMPLETE, LOCK))
        and not (path.name == PARTS and path.is_dir() and not any(path.iterdir()))
        for path in folder.iterdir()
    )


def _write(path: Path, write: Any) -> None:
    """Write a file beside its place, then move it there."""
    number, name = tempfile.mkstemp(prefix=_INCOMPLETE, dir=path.parent)
    try:
        os.close(number)
        write(Path(name))
        os.replace(name, path)
    finally:
        Path(name).unlink(missing_ok=True)
