"""What the README shows is run."""

from __future__ import annotations

import doctest
import re
import shlex
import tomllib

import pytest
from project import REPORT, ROOT

from railslip_ctrl.model.adhesion import law_names, load_law
from railslip_ctrl.simulation.campaign import Sampling
from railslip_ctrl.simulation.campaign.files import KEYS_OF, load_campaign
from railslip_ctrl.simulation.catalogue import NAMES

TEXT = (ROOT / "README.md").read_text(encoding="utf-8")


def test_python_examples_give_what_they_show(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # they write a file
    result = doctest.testfile(str(ROOT / "README.md"), module_relative=False)
    assert (result.attempted > 10, result.failed) == (True, 0)


LINES = {line: shlex.split(line, comments=True)[1:] for line in TEXT.splitlines() if line.startswith("railslip ")}


def test_the_report_is_the_one_that_the_tests_of_the_command_run():
    assert REPORT in LINES.values()


@pytest.mark.parametrize("line", [line for line, words in LINES.items() if words != REPORT])
def test_commands_run(line, tmp_path, monkeypatch, railslip):
    words = LINES[line]
    words = [str(ROOT / word) if word.startswith("designs/") else word for word in words]
    words = [str(ROOT / "designs/controllers/pi_lead.toml") if word.startswith("check/") else word for word in words]
    if words[0] == "report":
        words.append("--no-html")  # report.html takes most of a report's time and has tests of its own
    monkeypatch.chdir(tmp_path)
    status, out, _ = railslip(*words)
    assert status in (0, 1)
    assert out


def test_adhesion_file_example_is_accepted_and_names_all_laws(tmp_path):
    (block,) = re.findall(r"```toml\n(law = .*?)```", TEXT, flags=re.S)
    file = tmp_path / "law.toml"
    file.write_text(block)
    assert load_law(file).name == tomllib.loads(block)["law"] == "lugre"
    assert ", ".join(law_names()) in block


def test_campaign_file_example_is_accepted(tmp_path):
    (block,) = re.findall(r"```toml\n(scenario = .*?)```", TEXT, flags=re.S)
    file = tmp_path / "campaign.toml"
    file.write_text(block)
    campaign = load_campaign(file)
    assert (campaign.runs, campaign.controller_names) == (1000, ("pi", "pi-lead"))
    assert all(kind in block for kind in KEYS_OF)
    assert all(sampling in block for sampling in Sampling)
    assert all(name in block for name in NAMES)
