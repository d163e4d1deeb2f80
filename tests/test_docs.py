"""The documentation: what its pages show is run, what they name is there, what they derive follows.

Links, includes and tables of contents are looked at by its build, `make docs`, of which each warning is an error.
"""

import doctest
import importlib
import importlib.util
import json
import math
import pkgutil
import re
import runpy
import shlex
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
import yaml
from generated_code import needs_compiler
from project import CONTRIBUTING, ROOT, recipe

import railslip_ctrl
from railslip_ctrl import PARK2008, derive, load_controller, load_vehicle
from railslip_ctrl.cli.program import _COMMANDS
from railslip_ctrl.controllers.guard import ControlUnit, Status
from railslip_ctrl.core.notation import SOURCES
from railslip_ctrl.design.catalogue import margins_over_points, published_controller, recommended_pi_lead
from railslip_ctrl.model import plant
from railslip_ctrl.model.adhesion import beam
from railslip_ctrl.model.adhesion.beam import integrated_force
from railslip_ctrl.report import candidates
from railslip_ctrl.simulation.embedded import save_c

DOCS = ROOT / "docs"


def documentation(name: str):
    if str(DOCS) not in sys.path:
        sys.path.append(str(DOCS))
    return importlib.import_module(name)


pages, equations, generate = (documentation(name) for name in ("pages", "equations", "generate"))
SOURCES_OF_PAGES = pages.sources()
TEXTS = {path: path.read_text("utf-8") for path in SOURCES_OF_PAGES}


def named(path: Path) -> str:
    return str(path.relative_to(DOCS).with_suffix(""))


LONG = ("tutorial", "howto/campaign", "howto/log", "howto/reproduce", "howto/scenario")


@pytest.mark.parametrize("page", [
    pytest.param(path, marks=[pytest.mark.long] * (named(path) in LONG))
    for path, text in TEXTS.items() if pages.blocks(text) or ">>>" in text
], ids=named)  # fmt: skip
def test_pages_run(page, tmp_path, monkeypatch, capsys, railslip):
    monkeypatch.chdir(pages.prepare(tmp_path))
    monkeypatch.syspath_prepend(str(tmp_path))
    printed = []
    for block in pages.blocks(TEXTS[page]):
        assert block.name or block.commands, "a block of commands has some"
        if block.name:
            Path(block.name).write_text(block.text, encoding="utf-8")
        elif block.tested:
            ((_, command),) = block.commands
            assert f'railslip("{command}")' in (ROOT / block.tested).read_text("utf-8")
        for program, *words in () if block.name or block.tested else block.commands:
            if program == "python":
                runpy.run_path(words[0])
                assert capsys.readouterr().out
            else:
                status, out, err = railslip(*words)
                assert (status in (0, 1), out != "") == (True, True), err
                printed.append(out)
    for picture in re.findall(r"^:pictures: (.*)$", TEXTS[page], flags=re.M):
        assert all(Path(name).is_file() for name in picture.split())
    assert doctest.testfile(str(page), module_relative=False).failed == 0
    if named(page) == "tutorial":
        assert_gains_of_the_tutorial_are_those_found(TEXTS[page], "".join(printed))


def assert_gains_of_the_tutorial_are_those_found(text: str, printed: str) -> None:
    (typed,) = re.findall(r"PIGains\(kp=(\d+), ki=(\d+)\)", text)
    (tuned,) = re.findall(r"Controller +PI-lead: kp ([\d.]+) N·m/\(m/s\), ki ([\d.]+) N·m/m", printed)
    assert [int(one) for one in typed] == [5 * int(float(one) / 5) for one in tuned]  # less, in fives
    car, control = load_vehicle("railcar.toml"), load_controller("gains.toml")
    lag = car.actuator.lag
    assert [control.kp, control.ki] == [int(one) for one in typed]
    assert (control.lead, control.lead_filter) == (lag, pytest.approx(lag / 10, rel=1e-12))
    assert float(np.max(margins_over_points(control, car).ms)) <= 2.0  # also where full ranges are tuned
    (friction,) = {float(one) for one in re.findall(r"(0\.\d+) \* \w+\.wheel_load", text)}
    # given in kN*m with one decimal
    assert control.initial_torque == pytest.approx(friction * car.wheel_load * car.wheel.radius, abs=50.0)


C_PAGES = "".join(TEXTS[DOCS / "howto" / f"{name}.md"] for name in ("embedded_c", "sliding_c"))


@needs_compiler
def test_the_programs_of_the_c_pages_brake(file, tmp_path, monkeypatch, railslip):
    monkeypatch.syspath_prepend(str(tmp_path))
    for block in (one for one in pages.blocks(C_PAGES) if one.name):
        file(block.name, block.text)
    runpy.run_path("write_c.py")
    numbers = {}
    for shown in re.findall(r"^```sh\n(.*?)^```$", C_PAGES, flags=re.M | re.S):
        for words in map(shlex.split, shown.splitlines()):
            if words[0] == "railslip":
                assert railslip(*words[1:])[0] == 0
            else:
                done = subprocess.run(words, capture_output=True, text=True, check=False)
                assert (done.returncode, done.stderr) == (0, "")
                numbers[words[0]] = np.array([[float(x) for x in line.split()] for line in done.stdout.splitlines()])
    unit, v, torque, expected = ControlUnit(recommended_pi_lead(PARK2008), PARK2008, 100.0 / 3.6), 100.0 / 3.6, 0.0, []
    for i in range(200):
        omega = v * (1.0 - (0.02 + 0.03 * (i % 7))) / 0.43 if i < 150 else math.nan
        torque, status = unit.step(v, omega, torque)
        expected.append((torque, status))
        v -= 0.01
    assert numbers["./brake"] == pytest.approx(np.array(expected), rel=1e-10)
    assert {Status.OK, Status.HOLDING, Status.RELEASING, Status.FAULT} == {
        Status(int(x)) for _, x in numbers["./brake"]
    }
    # that this program has the numbers of the Python is of test_sliding_code; here its gains are sound
    assert numbers["./law"].shape == (200, 2)
    assert np.unique(numbers["./law"][:, 0]).size > 100  # within the limits, not at them


def test_what_pages_type_of_the_designs_is_what_the_package_has():
    shown = dict(re.findall(r"\.(\w+) = ([\d.]+)", C_PAGES.partition("{file} law_main.c")[2].partition("};")[0]))
    law, car = published_controller("asmc", "bristle"), PARK2008
    published = {"rho": law.rho, "D": law.D, "K": law.K, "lambda_d": law.reference.dry}
    published |= {"J": car.wheel.inertia, "r": car.wheel.radius, "Mn": car.mass, "Bn": car.wheel.viscous_friction}
    assert {name: float(shown[name]) for name in published} == pytest.approx(published, rel=1e-12)  # 1.53 times 3.6
    criterion = TEXTS[DOCS / "howto" / "report.md"]
    limits = (f"at most {candidates.NEARLY_UNSTABLE:g}:", f"less than {100 * candidates.TIE:g} %,")
    assert all(one in criterion for one in (*limits, "three reductions"))
    assert len(candidates.FASTER) == 3


def test_the_gallery_knows_the_arguments_of_every_script(tmp_path):
    gallery = documentation("gallery")
    for script in gallery.scripts(tmp_path):
        assert set(script.arguments()) <= {*gallery.NUMBERS.values(), str(script.folder)}, script.path


def test_a_failing_command_stops_the_build(tmp_path):
    with pytest.raises(RuntimeError, match="--rail"):
        pages.run(["railslip", "margins", "--rail", "icy"], tmp_path, "")


@cache
def stated() -> dict[str, list]:
    """The equations of the source by group; half a second."""
    return equations.groups(derive())


def test_objects_named_in_pages_and_equations_exist():
    names = {name for text in TEXTS.values() for name in re.findall(r"\{py:\w+\}`([\w.]+)`", text)}
    names |= {one.home for group in stated().values() for one in group if one.home}
    assert len(names) > 20
    for name in names:
        pkgutil.resolve_name(name)


def test_spelling():
    """Words outside code are English, or in docs/words.txt."""
    from spellchecker import SpellChecker

    dictionary = SpellChecker(language="en")
    dictionary.word_frequency.load_words((DOCS / "words.txt").read_text("utf-8").split())
    for path in (*SOURCES_OF_PAGES, *(ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md"))):
        text = re.sub(r"^(`{3,}).*?^\1$", "", path.read_text("utf-8"), flags=re.M | re.S)
        text = re.sub(r"`+[^`]*`+|\$[^$]*\$|\]\([^)]*\)|https?://\S+|\{[^}]*\}|\[\[\w+\]\]", "", text)
        words = {word.lower().removesuffix("'s").strip("'") for word in re.findall(r"[A-Za-z][a-z']+(?![\w])", text)}
        plurals = {word for word in words if dictionary.known([word.removesuffix("s")])}
        assert not dictionary.unknown(words - plurals), path.name


def test_every_equation_of_the_source_stands_once():
    found = [one.number for group in stated().values() for one in group]
    assert found == list(range(1, 50))
    theory = "\n".join(text for path, text in TEXTS.items() if path.parent.name == "theory")
    for name in stated():
        assert theory.count(f"_generated/equations/{name}.md") == 1


def test_the_beam_stated_here_integrates_to_the_package_s():
    """(5)-(9) over the footprint, as (10) says: the closed form in u, and `beam.integrated_force`."""
    parts, own = equations.beam_parts(), equations.printed
    locking, sliding = parts.per_length
    positive = {name: sp.Symbol(name, positive=True) for name in ("p", "l_h")}
    mu_d = parts.mu_d.subs(positive["l_h"], parts.sticking)
    slides = sliding.subs(positive["p"], parts.pressure).subs(own.mu_d, mu_d)
    force = sp.integrate(locking, (own.xc, 0, parts.sticking))
    force += sp.integrate(slides, (own.xc, parts.sticking, own.length))
    (mu_max, _, Kx), N = beam.Beam.symbols(), plant.symbol("N")
    force = force.subs(own.Cx, 2 * Kx / own.length**2).subs(own.slip, plant.sigma / plant.v)
    assert sp.simplify(force.subs(own.wheel_load, N) - integrated_force()) == 0
    u = Kx * plant.sigma / plant.v / (3 * mu_max * N)
    assert sp.simplify(equations.beam_force_in_u().subs(sp.Symbol("u", positive=True), u) - integrated_force()) == 0


@pytest.mark.long
def test_formulas_become_mathml(tmp_path, monkeypatch):
    from latex2mathml.converter import convert

    monkeypatch.setattr(generate, "GENERATED", tmp_path)
    monkeypatch.setattr(generate, "write_api", lambda: None)
    monkeypatch.setattr(generate, "write_gallery", lambda folder, run: None)
    generate.main(["--without-gallery"])
    texts = [path.read_text("utf-8") for path in tmp_path.rglob("*.md")]
    formulas = [one for text in texts for one in re.findall(r"\$\$\n(.*?)\n\$\$|\$([^$\n]+)\$", text)]
    assert len(formulas) > 150
    for display, inline in formulas:
        assert "\\" not in convert(display or inline), display or inline


def test_citation():
    content = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    assert (content["cff-version"], content["version"]) == ("1.2.0", railslip_ctrl.__version__)
    assert {"message", "title", "authors", "type"} <= content.keys()
    (paper,) = content["references"]
    told = (f"doi:{paper['doi']}", paper["title"], *(author["family-names"] for author in paper["authors"]))
    assert all(one in " ".join(SOURCES["Park2008"].split()) for one in told)


def test_the_places_to_extend_are_there():
    package = ROOT / "railslip_ctrl"
    modules = [path for path in package.rglob("*.py") if "_generated" not in path.parts]
    names = {word for path in modules for word in re.findall(r"\w+", path.read_text("utf-8"))}
    table = CONTRIBUTING.partition("## Extension points")[2].partition("\n\n### ")[0]
    for said in re.findall(r"`([^`\s]+)`", table):
        place, name = re.fullmatch(r"(.*(?:\.py|\.toml|/))?(?:::)?(.*)", said).groups()
        assert any((folder / (place or "")).exists() for folder in (ROOT, package, package / "simulation")), said
        assert set(re.findall(r"\w+", name)) <= names, said
    for room in package.glob("*/__init__.py"):
        told = set(re.findall(r"`(\w+)[`.]", room.read_text("utf-8").split('"""')[1]))
        inside = {path.stem for path in room.parent.glob("*.py")} - {"__init__"}
        # of cli the commands are its modules, and the program lists them
        assert inside <= told | (set(_COMMANDS) if room.parent.name == "cli" else set()), room


def contributed(words: str, railslip) -> dict:
    (line,) = re.findall(rf"^railslip (.*{words}.*)$", CONTRIBUTING, flags=re.M)
    status, out, err = railslip(*line.split(), "--json")
    assert status == 0, err
    return json.loads(out)


def test_the_law_of_contributing_is_found_and_linearised(file, tmp_path, monkeypatch, railslip):
    for name in ("kalker.py", "kalker.toml"):
        file(name, recipe(name))
    package = importlib.import_module("railslip_ctrl.model.adhesion")
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(tmp_path)])
    try:
        law = package.law_class("kalker")(friction=0.3, creep=20.0)
        assert law.wet().friction == 0.15
        assert contributed("linearize", railslip)["cases"][0]["adhesion"] == "kalker"
    finally:
        sys.modules.pop("railslip_ctrl.model.adhesion.kalker", None)


@pytest.mark.long
def test_the_controller_kind_of_contributing_is_tuned_saved_run_and_written_as_c(file, tmp_path, railslip):
    """All from one file: its limit, 6 kN*m/s, is in the file of the tuned controller and in its C program."""
    file("gentle.py", recipe("gentle.py"))
    assert contributed("scenario park2008-si --controller gentle.py", railslip)["max_torque_rate_nm_per_s"] <= 6000.0
    contributed("structure gentle.py", railslip)
    run = contributed("controller gentle.toml", railslip)
    assert (run["outcome"], run["max_torque_rate_nm_per_s"] <= 6000.0) == ("stopped", True)
    control = load_controller(tmp_path / "gentle.toml")
    assert (control.kind, control.torque_rate) == ("gentle", 6000.0)
    save_c(control, tmp_path / "gentle.c")
    assert "REAL(6000.0), /* torque_rate */" in (tmp_path / "gentle.c").read_text("utf-8")


def test_the_scenario_and_the_controller_of_contributing_brake(file, tmp_path, monkeypatch, railslip):
    for name in ("downpour.toml", "relay.py"):
        file(name, recipe(name))
    monkeypatch.syspath_prepend(str(tmp_path))
    (rain,) = contributed("downpour.toml", railslip)["events"]
    assert (rain["rail"], rain["happened_at_s"]) == ("wet", pytest.approx(4.0, abs=0.01))  # s, and a step
    assert contributed("relay.py", railslip)["max_torque_nm"] <= 6000.0
    (usage,) = re.findall(r"^```python\n(.*?)^```$", CONTRIBUTING, flags=re.M | re.S)
    found: dict[str, object] = {}
    try:
        exec(compile(usage, "CONTRIBUTING.md", "exec"), found)
    finally:
        sys.modules.pop("relay", None)
    # a relay overshoots its reference by what the brake's lag lets it
    assert (str(found["run"].outcome), found["run"].max_slip > 0.1) == ("stopped", True)
