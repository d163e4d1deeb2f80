"""Every command of the README's table, and its Python; `make test-lowest` runs these with the lowest versions."""

import doctest
import json
import re
import shlex
from itertools import pairwise
from pathlib import Path

import pytest
from project import ROOT
from rig_logs import rig_rows, write_log

from railslip_ctrl import Rail
from railslip_ctrl.core.units import KMH
from railslip_ctrl.model.adhesion import published_law

README = (ROOT / "README.md").read_text(encoding="utf-8")
TABLE = re.findall(r"^\| `(railslip [^`]+)` \|", README, flags=re.M)
TUNE = next(line for line in TABLE if line.startswith("railslip tune"))
LONG = ("campaign", "identify", "report", "reproduce", "verify")
MASSES = '{path = "vehicle.mass", distribution = "uniform", low = 3400.0, high = 3600.0}'
CAMPAIGN = f'scenario = "park2008"\nruns = 2\ncontroller = [{{controller = "pi"}}]\nquantity = [{MASSES}]\n'
SMALL = {
    "report": "--no-html --nominal --rail dry --speed 100 --out report",
    "campaign": "--workers 1",
    "identify": "--model beam",
    "reproduce": "--seeds 2 --out page",
}
STATUS = {"verify": 1, "reproduce": 1}
"""The predictive law has a condition that fails; the mean of two seeds is farther from the paper than that of 256."""


def words_of(line: str) -> list[str]:
    Path("CAMPAIGN.toml").write_text(CAMPAIGN)
    write_log(Path("LOG.csv"), rig_rows(published_law("beam", Rail.WET), initial_speed=100.0 * KMH))
    return [*shlex.split(line)[1:], *shlex.split(SMALL.get(line.split()[1], ""))]


@pytest.mark.parametrize("line", [
    pytest.param(line, marks=[pytest.mark.long] * (line.split()[1] in LONG)) for line in TABLE
])  # fmt: skip
@pytest.mark.usefixtures("without_lag_search", "file")
def test_a_command_of_the_readme_s_table_runs(line, railslip):
    if "--controller best.toml" in line:
        assert railslip(*shlex.split(TUNE)[1:])[0] == 0
    words = words_of(line)
    status, out, err = railslip(*words, *["--json"] * (not {"--json", "--format"} & set(words)))
    assert status == STATUS.get(words[0], 0), err
    assert "Traceback" not in err
    assert out.startswith("/*") if "--format" in words else json.loads(out)
    for made in (Path(after) for word, after in pairwise(words) if word == "--out"):
        written = [path for path in made.rglob("*") if path.is_file()] if made.is_dir() else [made]
        assert written
        assert all(path.stat().st_size for path in written)


@pytest.mark.usefixtures("file")
def test_the_python_of_the_readme_gives_what_it_shows():
    result = doctest.testfile(str(ROOT / "README.md"), module_relative=False)
    assert (result.attempted > 9, result.failed) == (True, 0)
