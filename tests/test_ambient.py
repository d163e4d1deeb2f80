"""The user's environment, streams and folders: they change neither numbers nor exit status, and cost no result."""

import json
import os
import shlex
import subprocess
import sys
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from project import ROOT
from test_smoke import SMALL, TABLE, words_of

from railslip_ctrl import InputError
from railslip_ctrl.report.pictures import write_results
from railslip_ctrl.report.plots import style

SIMULATE = "simulate --controller pi --no-noise --speed 30 --json"
FILES = {f"simulation.{suffix}" for suffix in ("txt", "json", "csv", "png", "svg")}
RAILSLIP = f"{shlex.quote(sys.executable)} -m railslip_ctrl"
posix_alone = pytest.mark.skipif(os.name != "posix", reason="a POSIX shell")

BELOW_A_FILE = f"{__file__}/folder"  # nobody can make it, not even root
AMBIENT = {
    "MPLBACKEND": "module://matplotlib_inline.backend_inline",
    "MATPLOTLIBRC": "usetex.rc",
    "LANG": "C",
    "LC_ALL": "de_DE.ISO-8859-1",
    "PYTHONUTF8": "0",
    "PYTHONIOENCODING": "latin-1",
    "COLUMNS": "abc",
    "NO_COLOR": "1",
    "FORCE_COLOR": "1",
    "TERM": "dumb",
    "TZ": "No/Where",
    "TMPDIR": "no/such/folder",
    "HOME": None,
    "OMP_NUM_THREADS": "abc",
    "PYTHONWARNINGS": "error",
    "PYTHONSAFEPATH": "1",
    "PYTHONHASHSEED": "7",
}
"""None for a variable that is unset."""
ALONE = {"RAILSLIP_CACHE": BELOW_A_FILE, "PYTHONOPTIMIZE": "2", "MPLCONFIGDIR": BELOW_A_FILE}  # each takes long


def run(folder: Path, command: str, changed=()) -> tuple[int, str, str]:
    """A command line of the shell, in a folder; exit status, standard output and error."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **dict(changed)}
    environment = {name: value for name, value in environment.items() if value is not None}
    (folder / "usetex.rc").write_text("text.usetex: True\n")
    done = subprocess.run(["sh", "-c", command], cwd=folder, env=environment, capture_output=True)
    return done.returncode, done.stdout.decode("latin-1"), done.stderr.decode("latin-1")


@cache
def printed() -> dict:
    with TemporaryDirectory() as folder:
        return json.loads(run(Path(folder), f"{RAILSLIP} {SIMULATE}")[1])


@posix_alone
@pytest.mark.parametrize("names", [
    tuple(AMBIENT), *(pytest.param((name,), marks=pytest.mark.long) for name in AMBIENT | ALONE)
], ids=lambda names: names[0] if len(names) == 1 else "all")  # fmt: skip
def test_an_environment_changes_nothing(tmp_path, names):
    settings = AMBIENT | ALONE
    status, out, err = run(tmp_path, f"{RAILSLIP} {SIMULATE} --out r", {name: settings[name] for name in names})
    assert (status, "Traceback" in err) == (0, False), err
    assert json.loads(out) == printed()
    assert {path.name for path in (tmp_path / "r").iterdir()} == FILES


@posix_alone
@pytest.mark.parametrize(("shell", "status"), [
    ("{} >&- 2>&- <&-", 0),
    ("({}; echo $? >status) 2>&1 | true; exit $(cat status)", 141),  # 128 + SIGPIPE; 1 would be a check that fails
    *(pytest.param(f"{{}} {to}", status, marks=pytest.mark.long)
      for to, status in ((">&-", 0), (">/dev/full", 2), ("2>/dev/full", 0))),
])  # fmt: skip
def test_a_stream_that_is_closed_or_full_costs_no_file(tmp_path, shell, status):
    found, _, err = run(tmp_path, shell.format(f"{RAILSLIP} {SIMULATE} --out r"))
    assert (found, "Traceback" in err) == (status, False), err
    assert {path.name for path in (tmp_path / "r").iterdir()} == FILES


@posix_alone
@pytest.mark.parametrize("options", ["", "--out r"])
def test_a_folder_where_nothing_can_be_written(tmp_path, options):
    """/proc refuses root too."""
    status, out, err = run(tmp_path, f"cd /proc && {RAILSLIP} {SIMULATE} {options}")
    assert (status, err.count("\n")) == (2, 1) if options else (status, err) == (0, "")
    assert not out if options else json.loads(out) == printed()


@posix_alone
def test_a_picture_that_cannot_be_drawn_costs_neither_numbers_nor_files(tmp_path):
    """Matplotlib cannot be imported where a matplotlibrc is not UTF-8."""
    (tmp_path / "matplotlibrc").write_bytes("# größer\n".encode("latin-1"))
    status, out, err = run(tmp_path, f"{RAILSLIP} {SIMULATE} --out r")
    assert json.loads(out) == printed()
    assert {path.suffix for path in (tmp_path / "r").iterdir()} == {".txt", ".json", ".csv"}
    last = err.splitlines()[-1]
    assert (status, last.startswith("railslip: error: --out: not every picture")) == (2, True)
    assert "UnicodeDecodeError" in last
    assert "simulation.json" in last


def test_a_picture_that_cannot_be_written_costs_no_number(tmp_path):
    (tmp_path / "stop.svg").mkdir()
    with pytest.raises(InputError, match=r"^--out: not every picture .*: report.json; "):
        write_results(tmp_path, {"report.json": "{}"}, lambda: {"stop": style.grid_of(1, 1, "", (1, 1))[0]}, ["svg"])
    assert (tmp_path / "report.json").read_text() == "{}"


@pytest.mark.long
@pytest.mark.parametrize("line", [line for line in TABLE if "--out" in line + SMALL.get(line.split()[1], "")])
@pytest.mark.usefixtures("without_lag_search", "file")
def test_a_command_that_cannot_draw_prints_and_writes_the_rest(line, railslip, monkeypatch):
    def failing(*_):
        raise RuntimeError("latex could not be found")

    monkeypatch.setattr(style, "figure_files", failing)
    words = words_of(line)
    status, out, err = railslip(*words, "--json")
    assert json.loads(out)
    if words[0] != "tune":
        assert (status, "(RuntimeError: latex could not be found)" in err) == (2, True)
        texts = {path.suffix for path in Path(words[words.index("--out") + 1]).iterdir() if path.is_file()}
        assert ".json" in texts
        assert not texts & {".png", ".svg"}
