"""The help of the command: examples that run, units and defaults of every option; completion; no colour in a pipe."""

import os
import re
import shlex
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import click
import pytest
from click.testing import CliRunner
from project import ROOT
from rig_logs import rig_rows, write_log

from railslip_ctrl import Rail, __version__
from railslip_ctrl.cli import main
from railslip_ctrl.cli.options import Number
from railslip_ctrl.cli.program import _COMMANDS, railslip
from railslip_ctrl.cli.settings import HELP
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion import law_names, published_law

CONTEXT = click.Context(railslip, **HELP)
COMMANDS = {name: railslip.get_command(CONTEXT, name) for name in _COMMANDS}
OPTIONS = [
    pytest.param(option, id=f"{name} {option.opts[0]}")
    for name, command in COMMANDS.items()
    for option in command.params
    if isinstance(option, click.Option)
]


def example(text: str) -> str:
    """The one example of a help text, on one line."""
    (found,) = re.findall(r"Example: (railslip .+?)(?:\n\n|\Z)", text, flags=re.S)
    return " ".join(found.split())


EXAMPLES = {name: example(command.help) for name, command in COMMANDS.items()} | {"--help": example(railslip.help)}

LONG = ("campaign", "identify", "report", "reproduce", "tune", "verify")
CAMPAIGN = """
scenario = "park2008"
runs = 2
controller = [{controller = "pi"}]
quantity = [{path = "vehicle.mass", distribution = "uniform", low = 3400.0, high = 3600.0}]
"""


def prepare(name: str, folder: Path) -> list[str]:
    """Put the files that a command's example names into a folder; give what shortens it."""
    if name == "report":
        for file in (ROOT / "designs" / "vehicles").glob("*desiro_classic.*"):
            folder.joinpath("my_train.toml" if file.suffix == ".toml" else file.name).write_bytes(file.read_bytes())
        return ["--no-html"]  # the page has tests of its own
    if name == "campaign":
        folder.joinpath("tolerances.toml").write_text(CAMPAIGN)
        return ["--workers", "1"]
    if name == "identify":
        write_log(folder / "run.csv", rig_rows(published_law("beam", Rail.WET), initial_speed=100.0 * KMH)[0])
        return ["--model", "beam"]
    return []


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.long] * (name in LONG)) for name in EXAMPLES])
@pytest.mark.usefixtures("without_lag_search")
def test_the_example_of_a_command_runs(name, tmp_path, monkeypatch, capsys):
    words = shlex.split(EXAMPLES[name])[1:] + prepare(name, tmp_path)
    before = set(tmp_path.iterdir())
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as caught:
        main(words)
    printed = capsys.readouterr()
    written = set(tmp_path.iterdir()) - before
    assert caught.value.code == (name == "verify"), printed.err  # the layered law has a condition that fails
    assert "\x1b" not in printed.out + printed.err
    assert {path.name for path in written} == {after for word, after in pairwise(words) if word in ("--out", "--csv")}
    assert printed.out or written


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_of_a_command_has_an_example_and_the_exit_status(name):
    # -h first, and without the program above it, as click keeps the names of the help option from the first call
    assert CliRunner().invoke(COMMANDS[name], ["-h"]).exit_code == 0
    short, done = (CliRunner().invoke(railslip, [name, option], terminal_width=120) for option in ("-h", "--help"))
    assert (done.exit_code, short.output) == (0, done.output)
    assert done.output.startswith(f"Usage: railslip {name} ")
    words = " ".join(done.output.split())
    assert words.count(EXAMPLES[name]) == 1
    assert EXAMPLES[name].startswith(f"railslip {name} ")
    assert "xit status" in words
    assert ", ".join(law_names()) in words or not any("--adhesion" in option.opts for option in COMMANDS[name].params)


def test_the_help_of_the_program_lists_the_commands():
    done = CliRunner().invoke(railslip, ["--help"])
    listed = re.findall(r"^  (\w+)  +\S", done.output.partition("Commands:")[2], flags=re.M)
    assert (done.exit_code, listed) == (0, list(_COMMANDS))
    assert CliRunner().invoke(railslip, []).exit_code == 2
    assert CliRunner().invoke(railslip, ["--version"]).output == f"railslip, version {__version__}\n"


@pytest.mark.parametrize("option", OPTIONS)
def test_an_option_says_its_unit_or_choice_and_its_default(option):
    text = option.help or ""
    assert re.match(r"[A-Za-z0-9].*\S", text)
    if option.is_flag:
        return
    default = option.required or (option.show_default and option.default is not None) or "[default: " in text
    assert default, "no default"
    assert option.metavar
    if isinstance(option.type, Number):
        unit = r"\b([Ff]actor|[Rr]atio|[Ss]lip)\b" if option.type.unit == "1" else re.escape(option.type.unit)
        assert re.search(unit, text), f"no unit in {text!r}"
    else:
        counted = re.search(r"\b([Nn]umber|[Ss]eed|Processes)\b", text)
        assert counted or re.search(r"\||=|FILE|DIR|LAW|MEASURE|ADDRESS", option.metavar), "no choice"


def test_completing_a_command_s_name_imports_no_command():
    code = "import sys; from railslip_ctrl.cli import main\ntry: main()\nfinally: print(*sys.modules, file=sys.stderr)"
    words = {"_RAILSLIP_COMPLETE": "zsh_complete", "COMP_WORDS": "railslip ", "COMP_CWORD": "1"}
    done = subprocess.run([sys.executable, "-c", code], env=os.environ | words, capture_output=True, text=True)
    assert "\nmargins\n" in done.stdout
    assert not {"numpy", "railslip_ctrl.cli.margins"} & set(done.stderr.split())
