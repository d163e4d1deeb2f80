"""What the README shows is run."""

import doctest
import re
import shlex

import pytest
from project import ROOT

from railslip_ctrl.cli.program import _COMMANDS

TEXT = (ROOT / "README.md").read_text(encoding="utf-8")


def test_python_examples_give_what_they_show(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # they write a file
    result = doctest.testfile(str(ROOT / "README.md"), module_relative=False)
    assert (result.attempted > 9, result.failed) == (True, 0)


SHOWN = dict.fromkeys(re.findall(r"`(railslip [^`]+)`", TEXT))
COMMANDS = [line for line in SHOWN if not re.search(r"\b[A-Z]{3,}\b", line)]  # that need no file of the reader's
TUNE = next(line for line in COMMANDS if line.startswith("railslip tune"))
LONG = {line: pytest.mark.long for line in COMMANDS if line.startswith(("railslip report", "railslip verify"))}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where the commands are pasted: one takes the file of another."""
    return tmp_path_factory.mktemp("pasted")


def pasted(line, folder, monkeypatch, railslip):
    words = [str(ROOT / word) if word.startswith("designs/") else word for word in shlex.split(line)[1:]]
    if words[0] == "report":
        words.append("--no-html")  # report.html takes most of a report's time and has tests of its own
    monkeypatch.chdir(folder)
    status, out, err = railslip(*words)
    assert status == (words[0] == "verify"), err  # what it finds of that law
    assert out


@pytest.mark.parametrize("line", [pytest.param(x, marks=LONG.get(x, ())) for x in COMMANDS if "reproduce" not in x])
def test_commands_do_what_their_row_says(line, folder, monkeypatch, railslip):
    if "best.toml" in line and not (folder / "best.toml").exists():
        pasted(TUNE, folder, monkeypatch, railslip)
    if line != TUNE:
        pasted(line, folder, monkeypatch, railslip)
    for made in re.findall(r"--out (\S+)", line):
        assert (folder / made).exists()


def test_the_table_says_of_every_command_what_the_program_s_help_says():
    told: dict[str, list[str]] = {}
    for name, text in re.findall(r"^\| `railslip (\w+)[^`]*` \| (.+) \|$", TEXT, flags=re.M):
        told.setdefault(name, []).append(text)
    assert {name: "; ".join(texts) for name, texts in told.items()} == _COMMANDS  # a command may have two rows
