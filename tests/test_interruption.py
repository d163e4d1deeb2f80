"""Ctrl-C, a kill, a second command in the same folder, no cache folder: one line, and nothing stays behind."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from project import refused

from railslip_ctrl.core.folders import CACHE_VARIABLE, LOCK, claimed
from railslip_ctrl.report.export import write_files

# A command whose work is done by two processes, for minutes; the word is written once they are there, or about to be.
WORK = """
import os, time
from railslip_ctrl.cli import main, program
from railslip_ctrl.core.processes import processes

def run(_):
    with processes(2) as submit:
        sleeping = [submit(time.sleep, 300.0) for _ in range(2)]
        while {wait} and not all(one.running() for one in sleeping):
            time.sleep(0.01)
        print("begun", flush=True)
        sleeping[0].result()

program.run = run
main()
"""
ENDED = 30.0  # s; an import or two on a busy machine, a tenth of what the processes would sleep


def started(*command, cwd=None):
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([sys.executable, *command], **pipes, start_new_session=True, cwd=cwd)


def at_work(wait):
    """The command above, begun."""
    command = started("-c", WORK.format(wait=wait))
    assert command.stdout.readline() == "begun\n"
    return command


def reporting(folder):
    """A report, begun."""
    command = started("-m", "railslip_ctrl", "report", "--out", "made/for/it", cwd=folder)
    assert "the best design" in command.stderr.readline()
    return command


posix_alone = pytest.mark.skipif(os.name != "posix", reason="signals to groups of processes")


@posix_alone
@pytest.mark.parametrize(("begin", "send", "number"), [
    *((lambda _, wait=wait: at_work(wait), send, signal.SIGINT) for wait in (0, 1) for send in (os.kill, os.killpg)),
    (reporting, os.killpg, signal.SIGINT), pytest.param(reporting, os.kill, signal.SIGTERM, marks=pytest.mark.long),
])  # fmt: skip
def test_an_interruption_is_one_line_and_leaves_nothing(tmp_path: Path, begin, send, number: int) -> None:
    """As its processes start and as they work, of the command alone and of all that the terminal has."""
    command = begin(tmp_path)
    send(command.pid, number)
    out, err = command.communicate(timeout=ENDED)  # to the end of what every process of it might write
    lines = [line for line in err.splitlines() if " s  " not in line]  # progress
    assert (command.returncode, out, lines) == (130, "", ["railslip: interrupted"])
    assert not list(tmp_path.iterdir())


@posix_alone
def test_processes_end_with_the_one_that_started_them() -> None:
    command = at_work(True)
    command.kill()
    command.communicate(timeout=ENDED)


LATE = """\
import concurrent.futures, time
own = concurrent.futures.ProcessPoolExecutor.submit
concurrent.futures.ProcessPoolExecutor.submit = lambda *given: (own(*given), time.sleep(2))[0]
"""


@pytest.mark.parametrize("late", ["", LATE], ids=["", "the process has ended by when this one goes on"])
def test_a_script_that_starts_processes_as_it_is_imported_is_told(tmp_path: Path, late: str) -> None:
    script = tmp_path / "script.py"
    start = f"{late}from railslip_ctrl.core.processes import processes\n"
    script.write_text(f"{start}with processes(1) as submit:\n    print(submit(abs, -3).result())\n")
    out, err = started(str(script)).communicate(timeout=ENDED)
    assert out == ""
    assert 'put the call under if __name__ == "__main__":' in err.splitlines()[-1]
    assert err.count("Traceback") == 1  # of the script, not of the process


def test_an_interruption_waits_for_the_last_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a report written over another there is all or nothing."""
    writers = {name: lambda path: path.write_text("new") for name in "abc"}
    replace = os.replace
    monkeypatch.setattr(os, "replace", lambda *given: (replace(*given), signal.raise_signal(signal.SIGINT)))
    with pytest.raises(KeyboardInterrupt):
        write_files(tmp_path, writers)
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["a", "b", "c"]


@pytest.mark.parametrize("spelling", ["out", "other/../out", "link"])
def test_a_second_report_into_a_folder_is_refused(railslip, tmp_path: Path, spelling: str) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "out")
    with claimed(tmp_path / "out"):
        before = sorted(tmp_path.rglob("*"))
        told = refused(railslip("report", "--no-html", "--out", f"{tmp_path}/{spelling}"))
        at = f"railslip: error: --out: '{tmp_path}/{spelling}' is being written to by another process"
        assert told.startswith(at)
        assert sorted(tmp_path.rglob("*")) == before


def test_a_lock_that_a_killed_command_left_is_none(tmp_path: Path) -> None:
    (tmp_path / LOCK).touch()
    with claimed(tmp_path):
        (tmp_path / "file").touch()
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("variable", [CACHE_VARIABLE, "HOME"])
def test_without_a_cache_folder_no_temporary_one_stays(tmp_path: Path, variable: str) -> None:
    """One for the run and its processes, which goes with it."""
    code = (
        "from railslip_ctrl.core.folders import cache_folder\n"
        "from railslip_ctrl.core.processes import processes\n"
        "mine = cache_folder()\n"
        "with processes(1) as submit: print(mine == cache_folder() == submit(cache_folder).result(), mine.is_dir())\n"
    )
    kept = {name: value for name, value in os.environ.items() if name not in (CACHE_VARIABLE, "XDG_CACHE_HOME")}
    environment = {**kept, variable: os.devnull, "TMPDIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("True True\n", "")
    assert not list(tmp_path.iterdir())
