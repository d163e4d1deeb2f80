"""The wheel as it is installed; dependencies: named in the documentation, loaded where used, missing ones named."""

import re
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest
from project import ROOT, refused

from railslip_ctrl.core.errors import EXTRAS

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
PAGE = (ROOT / "docs/reference/dependencies.md").read_text("utf-8")

EVERY_COMMAND = {"click", "numpy", "pydantic", "python-flint", "rich"}
IMPORTED = {"python-flint": "flint", "PyYAML": "yaml", "dask[distributed]": "distributed"}
LOADED = """
import contextlib, io, sys
from railslip_ctrl.cli import main
with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
    main(sys.argv[1:])
print(*{name.split(".")[0] for name in sys.modules if not name.startswith("_")} - set(sys.stdlib_module_names))
"""


def packages(requirements):
    """Their names, without the versions and what the project says of itself."""
    names = {re.split("[>=]", one)[0] for one in requirements}
    return {name for name in names if not name.startswith("railslip_ctrl")}


def test_the_documentation_names_every_dependency_with_its_extra():
    named = re.findall(r"^\| `([^`]+)` \| (?:`(\w+)` \|)?", PAGE, flags=re.M)
    asked = [(name, "") for name in packages(PROJECT["dependencies"])]
    extras = PROJECT["optional-dependencies"].items()
    assert sorted(named) == sorted(asked + [(name, extra) for extra, found in extras for name in packages(found)])


def test_the_extras_that_are_looked_for_are_those_of_the_project():
    for extra, found in EXTRAS.items():
        asked = {IMPORTED.get(name, name) for name in packages(PROJECT["optional-dependencies"][extra])}
        assert set(found) <= asked
    assert PROJECT["optional-dependencies"]["all"] == [f"railslip_ctrl[{','.join(EXTRAS)}]"]


MORE = {
    "margins --rail dry": set(),
    "linearize --rail dry --speed 60": set(),
    "tune --rail dry --ms-max 2": {"scipy"},
    "simulate --scenario stop --controller asmc": {"scipy", "numba", "platformdirs", "PyYAML"},
}


@pytest.mark.parametrize("words", [pytest.param(x, marks=[pytest.mark.long] * ("margins" not in x)) for x in MORE])
def test_a_command_loads_what_it_needs_alone(words):
    done = subprocess.run([sys.executable, "-c", LOADED, *words.split()], capture_output=True, text=True, check=True)
    loaded, named = done.stdout.split(), re.findall(r"^\| `([^`]+)` ", PAGE, flags=re.M)
    assert {name for name in named if IMPORTED.get(name, name) in loaded} == EVERY_COMMAND | MORE[words]


@pytest.mark.parametrize(("words", "package", "extra"), [
    ("campaign tolerances.toml --out runs", "pyarrow", "campaign"),
    ("campaign tolerances.toml --controller pi --out runs --scheduler tcp://localhost:1", "distributed", "cluster"),
    ("identify run.csv", "pandas", "identify"),
    ("report --out check", "latex2mathml", "html"),
    ("reproduce --out check", "latex2mathml", "html"),
])  # fmt: skip
def test_a_missing_extra_is_named_before_the_work(words, package, extra, railslip, file, monkeypatch):
    file("tolerances.toml", 'scenario = "stop"\nruns = 1\n')
    rows = "".join(f"{0.01 * i:.2f},{30 - 0.01 * i},{29 - 0.01 * i},900\n" for i in range(60))
    file("run.csv", "time [s],train speed [m/s],wheel speed [m/s],brake torque [N*m]\n" + rows)
    monkeypatch.setitem(sys.modules, package, None)
    assert f'{package} is not installed; pip install "railslip_ctrl[{extra}]"' in refused(railslip(*words.split()))
    assert {path.name for path in Path.cwd().iterdir()} <= {"tolerances.toml", "run.csv", "runs"}


@pytest.mark.long
def test_command_works_from_an_installed_wheel(tmp_path):
    built = tmp_path / "wheel"
    make = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", built, ROOT]
    subprocess.run(make, check=True, capture_output=True)
    (wheel,) = built.glob("railslip_ctrl-*.whl")
    files = set(zipfile.ZipFile(wheel).namelist())
    data = ("py.typed", "report/templates/report.html", "model/_generated/curve.py", "simulation/steps.py")
    assert {f"railslip_ctrl/{name}" for name in data} <= files
    environment = tmp_path / "environment"
    venv.create(environment, with_pip=False)
    scripts = environment / ("Scripts" if sys.platform == "win32" else "bin")
    (site,) = environment.glob("lib/python*/site-packages")
    # the dependencies of this environment, but not the project's own source tree
    (site / "dependencies.pth").write_text(sysconfig.get_paths()["purelib"] + "\n")
    install = [sys.executable, "-m", "pip", f"--python={scripts / 'python'}", "install", "--quiet", "--no-deps"]
    install.append("--no-compile")  # of all modules, few of which are imported here
    subprocess.run([*install, "--force-reinstall", "--no-index", wheel], check=True, capture_output=True)
    words = [scripts / "railslip", "report", "--no-html", "--rail", "wet"]
    subprocess.run(words, capture_output=True, text=True, cwd=tmp_path, check=True)
    assert (tmp_path / "railslip-report" / "loop.svg").exists()
