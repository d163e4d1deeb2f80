"""Ctrl-C, a kill, a second command in a folder, no cache folder: one line, nothing stays behind; what is cached."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from project import refused

from railslip_ctrl.core import folders
from railslip_ctrl.core.folders import CACHE_VARIABLE, LOCK, cached, claimed
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
    command = started("-c", WORK.format(wait=wait))
    assert command.stdout.readline() == "begun\n"
    return command


def reporting(folder):
    command = started("-m", "railslip_ctrl", "report", "--out", "made/for/it", cwd=folder)
    assert "over the envelope of" in command.stderr.readline()
    return command


posix_alone = pytest.mark.skipif(os.name != "posix", reason="signals to groups of processes")


@posix_alone
@pytest.mark.parametrize(("begin", "send", "number"), [
    *((lambda _, wait=wait: at_work(wait), send, signal.SIGINT) for wait in (0, 1) for send in (os.kill, os.killpg)),
    (reporting, os.killpg, signal.SIGINT), pytest.param(reporting, os.kill, signal.SIGTERM, marks=pytest.mark.long),
])  # fmt: skip
def test_an_interruption_is_one_line_and_leaves_nothing(tmp_path: Path, begin, send, number: int) -> None:
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
    assert 'if __name__ == "__main__":' in err.splitlines()[-1]
    assert err.count("Traceback") == 1  # of the script, not of the process


def test_an_interruption_waits_for_the_last_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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


# --- results cached from report to report -------------------------------------------------------------------------


@pytest.fixture
def computed(monkeypatch, tmp_path):
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    times: list[int] = []

    def compute():
        times.append(len(times))
        return np.arange(3.0), "text", len(times)

    return compute, times, tmp_path / "results"


def test_a_result_is_computed_once_for_what_it_is_of(computed):
    compute, times, folder = computed
    first, again = cached("name", compute, "vehicle"), cached("name", compute, "vehicle")
    assert (first[0] == again[0]).all()
    assert (first[1:], len(times)) == (again[1:], 1)
    cached("name", compute, "another vehicle")
    cached("other", compute, "vehicle")
    assert len(times) == len(list(folder.iterdir())) == 3
    assert cached("name", compute, "vehicle", fresh=True)[2] == 4
    assert cached("name", compute, "vehicle")[2] == 4  # the fresh one is kept


@pytest.mark.parametrize("spoil", [lambda b: b[:-1], lambda b: b"", lambda b: b.replace(b"text", b"hext")])
def test_a_spoilt_file_is_computed_again(computed, spoil):
    compute, times, folder = computed
    cached("name", compute)
    (path,) = folder.iterdir()
    path.write_bytes(spoil(path.read_bytes()))
    assert (cached("name", compute)[1:], len(times)) == (("text", 2), 2)


def test_other_source_is_another_result(computed, monkeypatch, tmp_path):
    compute, times, _ = computed
    (tmp_path / "package").mkdir()
    monkeypatch.setattr(folders, "_PACKAGE", tmp_path / "package")
    for text, count in (("x = 1\n", 1), ("x = 1\n", 1), ("x = 2\n", 2)):
        (tmp_path / "package" / "module.py").write_text(text)
        folders._of_code.cache_clear()
        cached("name", compute)
        assert len(times) == count
    folders._of_code.cache_clear()


def test_what_a_folder_that_is_shut_cannot_keep_is_kept_for_the_run(computed, monkeypatch, tmp_path):
    compute, times, _ = computed
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "file"))
    assert cached("name", compute)[2] == cached("name", compute)[2] == len(times) == 1


def test_the_folder_keeps_what_was_asked_for_last(computed, monkeypatch):
    compute, times, folder = computed
    monkeypatch.setattr(folders, "_MOST", 3)
    for i, name in enumerate("abcd"):
        cached(name, compute)
        for path in folder.glob(f"{name}-*"):
            os.utime(path, (i, i))
        folders.look_up("a")  # which makes it the latest
    assert {path.name[0] for path in folder.iterdir()} == {"a", "c", "d"}
    assert len(times) == 4
