"""The help of the command, and the README: what they show runs, options have units and defaults; completion."""

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
from test_smoke import CAMPAIGN, LONG, README, TABLE

from railslip_ctrl import Rail, __version__
from railslip_ctrl.cli.options import Number
from railslip_ctrl.cli.program import _COMMANDS, railslip
from railslip_ctrl.cli.settings import HELP
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion import law_names, published_law

COMMANDS = {name: railslip.get_command(click.Context(railslip, **HELP), name) for name in _COMMANDS}
OPTIONS = {f"{name} {one.opts[0]}": one for name, command in COMMANDS.items() for one in command.params}


def example(text: str) -> str:
    (found,) = re.findall(r"Example: (railslip .+?)(?:\n\n|\Z)", text, flags=re.S)
    return " ".join(found.split())


EXAMPLES = {name: example(command.help) for name, command in COMMANDS.items()} | {"--help": example(railslip.help)}

SHOWN = set(re.findall(r"`(railslip [^`]+)`", README)) - {*TABLE, "railslip reproduce"}  # whose table is in test_smoke
# the page has tests of its own
SHORTER = {"report": ["--no-html"], "campaign": ["--workers", "1"], "identify": ["--model", "beam"]}


def words_of(line: str) -> list[str]:
    return [str(ROOT / word) if word.startswith("designs/") else word for word in shlex.split(line)[1:]]


@pytest.mark.parametrize("line", [
    pytest.param(line, marks=[pytest.mark.long] * (line.split()[1] in LONG))
    for line in dict.fromkeys([*sorted(SHOWN), *EXAMPLES.values()])
])  # fmt: skip
@pytest.mark.usefixtures("without_lag_search")
def test_a_command_that_the_readme_or_its_help_shows_runs(line, file, railslip):
    file("tolerances.toml", CAMPAIGN)
    if "my_train.toml" in line:
        for path in (ROOT / "designs" / "vehicles").glob("*desiro_classic.*"):
            Path("my_train.toml" if path.suffix == ".toml" else path.name).write_bytes(path.read_bytes())
    if line.startswith("railslip identify"):
        write_log(Path("run.csv"), rig_rows(published_law("beam", Rail.WET), initial_speed=100.0 * KMH))
    before, words = set(Path.cwd().iterdir()), words_of(line)
    status, out, err = railslip(*words, *SHORTER.get(words[0], ()))
    assert status == (words[0] == "verify"), err  # the predictive law has a condition that fails
    assert "\x1b" not in out + err
    written = {path.name for path in set(Path.cwd().iterdir()) - before}
    named = {after for word, after in pairwise(words) if word in ("--out", "--csv")}
    assert written == (named or {"railslip-report"} & written)
    assert out or written


def test_the_readme_s_table_says_of_every_command_what_the_program_s_help_says():
    told: dict[str, list[str]] = {}
    for name, text in re.findall(r"^\| `railslip (\w+)[^`]*` \| (.+) \|$", README, flags=re.M):
        told.setdefault(name, []).append(text)
    assert {name: "; ".join(texts) for name, texts in told.items()} == _COMMANDS  # a command may have two rows


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


@pytest.mark.parametrize("name", [name for name, one in OPTIONS.items() if isinstance(one, click.Option)])
def test_an_option_says_its_unit_or_choice_and_its_default(name):
    option = OPTIONS[name]
    text = option.help or ""
    assert re.match(r"[A-Za-z0-9].*\S", text)
    if option.is_flag:
        return
    assert option.required or (option.show_default and option.default is not None) or "[default: " in text
    assert option.metavar
    if isinstance(option.type, Number):
        unit = r"\b([Ff]actor|[Rr]atio|[Ss]lip|Number)\b" if option.type.unit == "1" else re.escape(option.type.unit)
        assert re.search(unit, text), f"no unit in {text!r}"
    else:
        counted = re.search(r"\b([Nn]umber|[Ss]eed|Processes)\b", text)
        assert counted or re.search(r"\||=|FILE|DIR|LAW|MEASURE|ADDRESS", option.metavar), "no choice"


def test_completing_a_command_s_name_imports_no_command():
    code = "import sys; from railslip_ctrl.cli import main\ntry: main()\nfinally: print(*sys.modules, file=sys.stderr)"
    words = {"_RAILSLIP_COMPLETE": "zsh_complete", "COMP_WORDS": "railslip ", "COMP_CWORD": "1"}
    done = subprocess.run([sys.executable, "-c", code], env=os.environ | words, capture_output=True, text=True)
    assert "\nmargins\n" in done.stdout
    assert not {"numpy", "sympy", "numba", "railslip_ctrl.cli.margins"} & set(done.stderr.split())
