"""What the commands say of an adhesion law from a file: v0, reference slip, a law in Python; options given twice."""

import json
import re
import sys

import pytest
from project import recipe, refused

from railslip_ctrl import PARK2008, adhesion, operating_point
from railslip_ctrl.model.adhesion import initial_speeds_in, is_over_initial_speed, load_law, published_law
from railslip_ctrl.model.adhesion.burckhardt import Burckhardt
from railslip_ctrl.report.export import source_at
from railslip_ctrl.report.text import case_title

PARAMETERS = "[parameters]\nc1 = 0.3\nc2 = 30.0\nc3 = 0.2\n"
SLIPS = "[reference_slip]\ndry = 0.1\nwet = 0.1\n"
OVER = 'law = "burckhardt"\ninitial_speed_range = [30, 140]\n[polynomials]\nc1 = [0.4, -1e-3]\nc2 = [30]\nc3 = [0.2]\n'

BEAM = """law = "beam"
[parameters]
mu_max = 0.3
a = 0.004
Kx = "300 kN"
[reference_slip]
dry = 0.1
wet = 0.07
"""

LAW = f"""{recipe("kalker.py")}
from railslip_ctrl.model.adhesion import ReferenceSlip

LAW = Kalker(friction=0.3, creep=20.0, reference=ReferenceSlip(dry=0.02, wet=0.01))
"""


AT = {"linearize": ("--speed", "20", "--rail", "dry"), "derive": ("--format", "c"), "margins": ("--speed", "20")}


@pytest.mark.parametrize("command", AT)
def test_a_law_of_another_v0_or_over_v0_is_told_in_every_command(railslip, file, command):
    slow = ("--adhesion", file("slow.toml", f'law = "burckhardt"\ninitial_speed_range = [28, 30]\n{PARAMETERS}{SLIPS}'))
    assert (initial_speeds_in(slow[1]), is_over_initial_speed(slow[1])) == ((28.0, 30.0), False)
    told = "slow.toml was found at an initial speed v0 of 28 to 30 km/h and is used at 100 km/h"
    status, _, err = railslip(command, *slow, *AT[command])
    assert (status in (0, 1), err.count("\n"), told in err) == (True, 1, True)  # once, whatever the number of rails
    assert "v0" not in railslip(command, *slow, "--initial-speed", "32", *AT[command])[2]  # within a tenth

    over = ("--adhesion", file("over.toml", OVER + SLIPS))
    assert is_over_initial_speed(over[1])
    status, _, err = railslip(command, *over, *AT[command])
    assert "over.toml changes with the initial speed v0, and is taken at 100 km/h; give --initial-speed" in err
    assert status in (0, 1)
    assert "v0" not in railslip(command, *over, "--initial-speed", "100", *AT[command])[2]
    assert "outside 30 to 140" in refused(railslip(command, *over, "--initial-speed", "160", *AT[command]))


def test_a_law_found_at_another_wheel_load_is_told(railslip, file):
    name = file("heavy.toml", BEAM.replace("[parameters]", 'wheel_load = "50 kN"\n[parameters]'))
    assert adhesion.wheel_load_in(name) == 50e3
    assert "was found at a wheel load of 50000 N and is used at 34500 N" in railslip("linearize", "--adhesion", name)[2]


def test_a_law_without_a_reference_slip_is_refused_alike(railslip, file):
    """The paper's slip may lie anywhere beside the peak of a law of one's own."""
    law = file("bare.toml", f'law = "burckhardt"\n{PARAMETERS}')
    for command in ("linearize", "margins", "tune --ms-max 2", "verify --law layered", "simulate"):
        told = refused(railslip(*command.split(), "--adhesion", law))
        assert re.search(r"--slip: adhesion '(bare.toml|burckhardt)' has no reference slip", told)
    assert "--slip: adhesion 'polach' has no reference slip" in refused(railslip("simulate", "--adhesion", "polach"))
    for given, slips in ((("--slip", "0.1"), (0.1, 0.1)), (("--gains", "beam"), (0.119, 0.059))):
        status, out, _ = railslip("simulate", "--adhesion", law, *given, "--no-noise", "--json")
        assert (status, json.loads(out)["reference_slip"]) == (0, dict(zip(("dry", "wet"), slips, strict=True)))


def test_a_law_of_one_s_own_in_a_python_file(railslip, file, monkeypatch):
    """Its force by hand, and its one pole, which is its slope there: 0 where it has reached mu."""
    monkeypatch.setattr(sys, "dont_write_bytecode", False)  # nor is a text taken for one of its length and second
    name = file("mine.py", LAW)
    poles = []
    for slip in ((), ("--slip", "0.5")):
        status, out, err = railslip("linearize", "--adhesion", name, "--rail", "dry", *slip, "--json")
        assert (status, err) == (0, "")
        found = json.loads(out)["cases"][0]
        poles.append(found["poles"][0][0])
        if not slip:
            assert (found["adhesion"], found["slip"]) == ("kalker", 0.02)
            assert found["adhesion_force_n"] == pytest.approx(34500 * 0.3 * 0.8701, rel=1e-4)  # tanh 4/3, from a table
    assert poles[0] < 100.0 * poles[1] < 0.0
    assert "a Python file is not derived with" in refused(railslip("derive", "--adhesion", name))
    assert "no such file" in refused(railslip("linearize", "--adhesion", "none.py"))
    for text, told in (
        ("LAW = 3\n", ": LAW has no statement, parameters"),
        ("law = 3\n", ": has no LAW"),
        ("1/0\n", ", line 1: running it fails with ZeroDivisionError: division by zero; mend the file"),
        (f"{LAW}LAW = Kalker\n", ": LAW is no adhesion law with its parameters"),
    ):
        assert f"--adhesion: other.py{told}" in refused(railslip("linearize", "--adhesion", file("other.py", text)))
    text = "from railslip_ctrl.model.adhesion.burckhardt import Burckhardt\nLAW = Burckhardt(c1=0.3, c2=30.0, c3=0.2)\n"
    assert adhesion.law_in(file("set.py", text)) == Burckhardt(c1=0.3, c2=30.0, c3=0.2)
    assert adhesion.law_in("set.py") == load_law(file("set.toml", f'law = "burckhardt"\n{PARAMETERS}'))


ASKED = {
    "linearize": ("--rail", "dry"),
    "margins": ("--rail", "dry", "--kp", "190", "--ki", "5"),
    "tune": ("--rail", "dry", "--minimise-ms", "--ki-min", "5"),
    "simulate": ("--no-noise", "--controller", "pi-lead"),
}


def law_in(out):
    """The law that a command's JSON names: of its one case, or of the run."""
    found = json.loads(out)
    return found.get("cases", [found])[0]["adhesion_law"]


@pytest.mark.parametrize("command", [pytest.param(x, marks=[pytest.mark.long] * (x == "tune")) for x in ASKED])
def test_text_and_json_tell_a_file_s_law_from_the_published_one(railslip, file, command):
    """Of one name, with other parameters."""
    law = ("--adhesion", file("model.toml", BEAM))
    out = railslip(command, *law, *ASKED[command], "--json")[1]
    values = {"mu_max": (0.3, "1"), "a": (0.004, "s/m"), "Kx": (300e3, "N")}
    parameters = {name: {"value": value, "unit": unit} for name, (value, unit) in values.items()}
    assert law_in(out) == {"name": "beam", "source": "model.toml", "rail": "dry", "parameters": parameters}
    assert "beam as given (model.toml)" in " ".join(railslip(command, *law, *ASKED[command])[1].split())
    published = ("--adhesion", "beam", *ASKED[command])
    one = law_in(railslip(command, *published, "--json")[1])
    assert (one["name"], one["source"]) == ("beam", "published")
    assert one["parameters"]["mu_max"]["value"] == 0.261  # [Park2008] Table 1, at 100 km/h
    text = railslip(command, *published)[1]
    assert ("beam" in text, "as given" in text) == (True, False)


def test_a_published_law_with_a_number_changed_is_told_as_given():
    beam = published_law("beam", "dry")
    laws = (beam.model_copy(update={"mu_max": 0.3}), beam)
    points = [operating_point(law, PARK2008, 20.0, 0.05) for law in laws]
    assert [source_at(point) for point in points] == ["given", "published"]
    assert case_title(points[0]).startswith("beam as given, dry rail, 72 km/h")


@pytest.mark.parametrize("command", ["linearize", "margins", "tune", "report", "simulate", "verify"])
def test_a_wet_log_s_law_asks_for_wet_rail_by_its_option(railslip, file, command):
    """And with that option it is taken."""
    name = file("fitted.toml", BEAM.replace("[parameters]", 'condition = "wet"\n[parameters]'))
    more = {"tune": ASKED["tune"][2:], "verify": ("--law", "layered"), "report": ("--out", "never")}.get(command, ())
    told = refused(railslip(command, "--adhesion", name, *more))
    assert told.startswith("railslip: error: --adhesion 'beam' of fitted.toml: its parameters are for wet rail")
    assert "; ask for wet rail alone" in told
    if command in ASKED:
        assert railslip(command, "--adhesion", name, *more, "--rail", "wet")[0] in (0, 1)
