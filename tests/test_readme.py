"""What the README shows is run."""

from __future__ import annotations

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


COMMANDS = [
    line for line in dict.fromkeys(re.findall(r"`(railslip [^`]+)`", TEXT)) if not re.search(r"\b[A-Z]{3,}\b", line)
]
"""Those that need no file of the reader's."""


LONG = {
    line: pytest.mark.long
    for line in COMMANDS
    if line.startswith(("railslip report", "railslip tune", "railslip verify"))
}


@pytest.mark.parametrize(
    "line",
    [
        pytest.param(line, marks=LONG.get(line, ())) for line in COMMANDS if line != "railslip reproduce"
    ],  # has its own tests
)
def test_commands_run(line, tmp_path, monkeypatch, railslip):
    words = [str(ROOT / word) if word.startswith("designs/") else word for word in shlex.split(line)[1:]]
    if words[0] == "report":
        words.append("--no-html")  # report.html takes most of a report's time and has tests of its own
    monkeypatch.chdir(tmp_path)
    status, out, _ = railslip(*words)
    assert status in (0, 1)
    assert out


def test_every_command_is_in_the_table():
    assert {line.split()[1] for line in re.findall(r"\| `(railslip [^`]+)`", TEXT)} == set(_COMMANDS)
