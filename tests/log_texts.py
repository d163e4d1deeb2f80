"""Logs as text, for the tests of reading them."""

from __future__ import annotations

from pathlib import Path

from railslip_ctrl.identification.cleaning import StampFilter
from railslip_ctrl.identification.logs import Log, Rows

HEADER = "time [s],train speed [km/h],wheel speed [km/h],brake torque [kN*m]"


def log_text(count: int, header: str = HEADER) -> str:
    """A log with a row every 10 ms; row i, from 0, is in line i + 2."""
    rows = (f"{0.01 * i:.2f},{100 - 0.01 * i:.2f},{99 - 0.02 * i:.2f},1.5\n" for i in range(count))
    return header + "\n" + "".join(rows)


def with_stamps(count: int, stamps: dict[int, str]) -> str:
    """`log_text` with other time stamps, by line."""
    lines = log_text(count).splitlines(keepends=True)
    for line, stamp in stamps.items():
        lines[line - 1] = stamp + "," + lines[line - 1].split(",", 1)[1]
    return "".join(lines)


def write(tmp_path: Path, text: str | bytes, name: str = "log.csv") -> Path:
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode("latin-1"))
    return path


def read(path: Path, **options: object) -> tuple[Rows, Log]:
    """All rows of a log as one, and the log with the filter of its time stamps."""
    log = Log(path, **options)
    log.stamps = StampFilter(log.name)
    parts = list(log.stamps.rows(log.rows()))
    rows = parts[0]
    for part in parts[1:]:
        rows = rows.then(part)
    return rows, log
