"""What the package offers: names listed and documented; dependencies named, loaded where used, missing ones told."""

import ast
import dataclasses
import importlib
import inspect
import re
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from pathlib import Path
from typing import Any

import pydantic
import pytest
from project import ROOT, refused

import railslip_ctrl
from railslip_ctrl.controllers.base import Controller
from railslip_ctrl.core import errors
from railslip_ctrl.core.errors import EXTRAS
from railslip_ctrl.core.notation import SOURCES
from railslip_ctrl.identification.observer import TorqueObserver
from railslip_ctrl.simulation.campaign.specification import Distribution

PACKAGE = Path(railslip_ctrl.__file__).parent
ROOMS = (*("model.adhesion", "design", "loop", "simulation", "simulation.campaign"), "identification.observer")

ENTRIES = {
    "identification.identify": "Identification Options identify identify_several",
    "identification.virtual_rig": "BrakeCourse BrakeTrial Measurements brake_trial measured",
    "controllers.sampled": "SampledController",
    "design.specification": "Specification",
    "model.vehicle": "GRAVITY INITIAL_SPEED_KMH PARK2008 Actuator PIGains Rail Record Resistance Vehicle Wheel "
    "vehicle_warnings notes_and_warnings table4_gains",
    "model.vehicle_files": "load_vehicle",
    "model.linearization": "LinearPlant OperatingPoint",
    "sliding.derivation": "Derivation",
    "verification.joint_verification": "verify",
}
"""What is public of the modules that do not list their names."""

PROTOCOLS = (TorqueObserver, Controller, Distribution)
"""What public classes implement without inheriting it."""

UNIT = re.compile(
    r"(?<![\w'])(?:s|m|N|J|rad|deg|kg|1/s|km/h|m/s|%|SI)(?![\w'])|kg\*?m|N\*m|N m|/s\b"
    r"|\b(?:[Rr]atios?|share|[Ff]actors?|[Nn]umber of|dimensionless|units?|as printed)\b"
)
"""A unit, or a word that says that there is none or where it is given."""

SHAPE = re.compile(r"\d-D|\bshape|of (?:one|equal) length|array,? \([\w, ]+\)|\b[a-z] by [a-z0-9]\b")


def public() -> dict[str, Any]:
    found = {f"railslip_ctrl.{name}": getattr(railslip_ctrl, name) for name in railslip_ctrl.__all__}
    for room in (*ROOMS, *ENTRIES):
        module = importlib.import_module(f"railslip_ctrl.{room}")
        found |= {f"{room}.{name}": getattr(module, name) for name in ENTRIES.get(room, "").split() or module.__all__}
    return found


THINGS = {name: inspect.unwrap(one) for name, one in public().items() if inspect.isroutine(one) or inspect.isclass(one)}


def test_the_top_lists_what_it_offers() -> None:
    tree = ast.parse((PACKAGE / "__init__.pyi").read_text(encoding="utf-8"))
    imported = [alias for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) for alias in node.names]
    assert all(alias.name == alias.asname for alias in imported)  # else a type checker takes the name for private
    assert {alias.name for alias in imported} == set(railslip_ctrl.__all__) - {"__version__"}
    assert dir(railslip_ctrl) == sorted(railslip_ctrl.__all__)
    with pytest.raises(AttributeError, match="no attribute 'derivee'"):
        _ = railslip_ctrl.derivee


def test_every_error_of_the_package_is_at_the_top_and_a_builtin_too() -> None:
    own = {name for name, thing in vars(errors).items() if inspect.isclass(thing) and issubclass(thing, Exception)}
    assert own <= set(railslip_ctrl.__all__)
    for name in own - {"RailslipError"}:
        bases = getattr(errors, name).__mro__
        assert errors.RailslipError in bases
        assert any(base.__module__ == "builtins" and base not in (Exception, BaseException, object) for base in bases)


def test_no_room_takes_its_names_from_the_top_and_every_source_key_resolves() -> None:
    """What is at the top is of rooms of every height: the import contract does not see through it. [Name2008] cites."""
    for path in PACKAGE.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        for names in re.findall(r"from (?:railslip_ctrl|\.+) import \(?([\w\s,]+)", text):
            assert not set(re.findall(r"\w+", names)) & set(railslip_ctrl._HOME), path.relative_to(PACKAGE)
        keys = re.findall(r"\[([A-Z][A-Za-z]+(?:19|20)\d\d[a-z]?)\]", text)
        assert set(keys) <= set(SOURCES), path.relative_to(PACKAGE)


@pytest.mark.parametrize("name", THINGS)
def test_every_argument_field_and_method_is_documented_and_every_number_has_its_unit_and_shape(name: str) -> None:
    thing = THINGS[name]
    text, is_class = documentation(thing), inspect.isclass(thing)
    assert text
    general = text.partition("\n\n")[0] if is_class else ""
    assert not [one for one, annotation in arguments_of(thing).items() if not told(text, one, annotation, general)]
    body = ast.parse(inspect.getsource(thing)).body[0].body if is_class else []
    for method in (one for one in body if isinstance(one, ast.FunctionDef) and one.name[0] != "_"):
        bases = (base for base in (*thing.__mro__, *PROTOCOLS) if method.name in vars(base))  # what it implements, too
        own = "\n\n".join(inspect.cleandoc(vars(base)[method.name].__doc__ or "") for base in bases)
        assert own.strip(), method.name
        for argument in (*method.args.args, *method.args.kwonlyargs):
            if argument.arg not in ("self", "cls") and argument.annotation is not None:
                asked = argument.arg, ast.unparse(argument.annotation)
                assert told(own, *asked) or told(text, *asked), f"{method.name}: {argument.arg}"


def documentation(thing: Any) -> str:
    if not inspect.isclass(thing):
        return inspect.getdoc(thing) or ""
    own = (base for base in thing.__mro__ if base.__module__.startswith("railslip_ctrl"))
    return "\n\n".join(inspect.cleandoc(base.__doc__ or "") for base in own)


def arguments_of(thing: Any) -> dict[str, str]:
    if not inspect.isclass(thing):
        return {name: str(argument.annotation) for name, argument in inspect.signature(thing).parameters.items()}
    if issubclass(thing, pydantic.BaseModel):
        return {field: str(info.annotation) for field, info in thing.model_fields.items()}
    if dataclasses.is_dataclass(thing):
        return {field.name: str(field.type) for field in dataclasses.fields(thing) if not field.name.startswith("_")}
    return {field: str(thing.__annotations__[field]) for field in getattr(thing, "_fields", ())}


def entry(text: str, name: str) -> str:
    block = re.search(rf"^- (?:[\w, ]*[ ,])?{name}(?:,[\w, ]*)?(?::.*)?$(?:\n {{2}}.*)*", text, flags=re.M)
    if block:
        return block[0]
    sentences = re.split(r"(?<=[.;])\s+|\n\n", text)
    return " ".join(sentence for sentence in sentences if re.search(rf"(?<!\w){name}(?!\w)", sentence))


def told(text: str, name: str, annotation: str, general: str = "") -> bool:
    said, array = entry(text, name), re.search(r"ArrayLike|Floats|NDArray|Complexes", annotation)
    if not said or annotation.startswith("Callable") or not (array or re.search(r"\bfloat\b", annotation)):
        return bool(said)
    for pointed_at in re.findall(r"[Aa]s (?:of|for)\s+`(?:[\w.]+\.)?(\w+)`", said)[:1]:
        said += "".join(entry(documentation(THINGS[one]), name) for one in THINGS if one.endswith(f".{pointed_at}"))
    said = f"{said}\n{general}"
    return bool(UNIT.search(said) and (not array or SHAPE.search(said)))


PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
PAGE = (ROOT / "docs/reference/dependencies.md").read_text("utf-8")

EVERY_COMMAND = {"click", "numpy", "pydantic", "python-flint", "rich"}
IMPORTED = {
    **{"python-flint": "flint", "PyYAML": "yaml", "dask[distributed]": "distributed"},
    "numba-cuda[cu12]": "numba_cuda",
}
LOADED = """
import contextlib, io, sys
from railslip_ctrl.cli import main
with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
    main(sys.argv[1:])
print(*{name.split(".")[0] for name in sys.modules if not name.startswith("_")} - set(sys.stdlib_module_names))
"""


def packages(requirements):
    names = {re.split("[>=]", one)[0] for one in requirements}
    return {name for name in names if not name.startswith("railslip_ctrl")}


def test_the_documentation_names_every_dependency_with_its_extra():
    named = re.findall(r"^\| `([^`]+)` \| (?:`(\w+)` \|)?", PAGE, flags=re.M)
    asked = [(name, "") for name in packages(PROJECT["dependencies"])]
    of_users = PROJECT["optional-dependencies"].keys() - {"dev", "docs", "test"}
    extras = [(name, extra) for extra in of_users for name in packages(PROJECT["optional-dependencies"][extra])]
    assert sorted(named) == sorted(asked + extras)


def test_the_extras_that_are_looked_for_are_those_of_the_project():
    for extra, found in EXTRAS.items():
        asked = {IMPORTED.get(name, name) for name in packages(PROJECT["optional-dependencies"][extra])}
        assert set(found) <= asked
    common = (extra for extra in EXTRAS if extra != "gpu")  # NVIDIA's libraries serve a machine with a GPU alone
    assert PROJECT["optional-dependencies"]["all"] == [f"railslip_ctrl[{','.join(common)}]"]


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
    data = ("py.typed", "report/templates/report.html", "model/_generated/curve.py", "simulation/kernel.py")
    data += tuple(f"page/static/page.{suffix}" for suffix in ("html", "css", "js"))
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
