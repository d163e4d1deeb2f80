"""The command as its users meet it: output, JSON, exit status, bad input, terminals; numbers in the derived law."""

import json
import os
import re
import shlex
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from generated_code import COMPILER, WARNINGS, needs_compiler
from project import ROOT, refused

from railslip_ctrl import InputError, Rail, derive
from railslip_ctrl.controllers.c_code import law_program
from railslip_ctrl.model.adhesion import law_class, load_law, published_law
from railslip_ctrl.report.derivation import derivation_document, derivation_json, derivation_text
from railslip_ctrl.report.document import WIDTH
from railslip_ctrl.sliding.code import generate, law_numbers, with_numbers

MARGINS = "margins --rail dry --kp 190 --ki 5"
KEPT = {
    "margins.json": (0, f"{MARGINS} --certify"),
    "unstable.json": (1, "margins"),
    "linearize.json": (0, "linearize --rail dry"),
    "tune.json": (1, "tune --ms-max 2 --speed 100"),
}
"""Files of tests/data/cli by name, with the exit status and the command that printed each with --json."""


def leaves(content, path=""):
    if isinstance(content, dict | list):
        items = content.items() if isinstance(content, dict) else enumerate(content)
        return {path: len(content)} | {k: v for name, one in items for k, v in leaves(one, f"{path}/{name}").items()}
    return {path: content}


@pytest.fixture
def cases(railslip):
    return lambda words: json.loads(railslip(*shlex.split(words), "--json")[1])["cases"]


@pytest.mark.parametrize("name", KEPT)
def test_the_json_of_a_command_is_that_which_is_kept(name, railslip):
    status, words = KEPT[name]
    found, out, err = railslip(*shlex.split(words), "--json")
    assert (found, err) == (status, "")
    same = partial(pytest.approx, rel=1e-6, abs=1e-12)  # as far as the linear algebra of two processors agrees
    kept = leaves(json.loads((ROOT / "tests/data/cli" / name).read_text("utf-8")))
    assert leaves(json.loads(out)) == {path: same(one) if isinstance(one, float) else one for path, one in kept.items()}


def test_values_may_carry_their_unit(cases):
    (a,) = cases("margins --rail dry --kp 234 --ki 5 --mass 3500")
    (b,) = cases("margins --rail dry --kp '65 N*m/(km/h)' --ki '5 N' --mass '3.5 t' --speed '100 km/h'")
    assert (a["stable"], a["mass_kg"], b["mass_kg"]) == (True, 3500.0, 3500.0)
    assert a["phase_margin_deg"] == pytest.approx(b["phase_margin_deg"], rel=1e-12)
    assert cases("linearize --rail dry --speed-state")[0]["states"] == ["v", "sigma", "z"]


FILES = {
    "law.toml": 'law = "dahl"\nparameters = {alpha = 1e4, Fc = 9e3}\nreference_slip = {dry = 0.1, wet = 0.1}',
    "log.csv": "time [s],v [m/s],omega [rad/s],torque [N*m]\n0,30,69,0\n",
    "mine.toml": 'extends = "park2008"\ninitial_speed = 50.0\nadhesion = "law.toml"\n',
    "empty.npz": "",
    "own.toml": 'kind = "pi"\nkp = 100\nki = 10\n',
    "sampled.py": "import control as ct\nCONTROLLER = ct.tf([190.0], [1.0], 0.05)\n",
    "own.py": "class C:\n  def step(self, *x): ...\n  def linear(self, x): return 'text'\nCONTROLLER = C()\n",
}
SAMPLED = "margins --rail dry --speed 100 --controller sampled.py"
GIVEN = "is not allowed with a controller file"
TWICE = "identify log.csv {0} train_speed=1 {0} train_speed=2"
SEEDS = "give a whole number from 2 to 100000"


@pytest.mark.parametrize(("words", "told"), [
    ("margins --mass -3", "--mass: -3 kg is not allowed; give a value > 0 kg"),
    ("margins --slip 1", "--slip: 1 is not allowed; give a value < 1"),
    ("margins --slip 0", "at slip 0 "),
    ("margins --speed 1e9", "--speed: the reference slip 0.132 at 1e+09 km/h is outside the domain"),
    ("margins --speed 1e9 --slip 0.1", "--slip: 0.1 at 1e+09 km/h is outside the domain"),
    ("margins --speed 1e9 --envelope default", "--speed: 1e+09 is not allowed; give finite values > 0 and <= 1000"),
    ("margins --slip 0.9 --envelope default", "--slip: a factor of 1.25 on the reference slip 0.9, dry"),
    ("margins --adhesion nosuch --envelope default", "error: --adhesion: 'nosuch' is not a law"),
    ("margins --adhesion nosuch.py --envelope default", "error: --adhesion: nosuch.py: no such file"),
    ("margins --adhesion table --envelope default", "error: --adhesion 'table': a table gives no parameters"),
    ("margins --initial-speed 200 --envelope default", "error: --initial-speed: 200 km/h is outside 30 to 140"),
    ("margins --controller asmc", "error: --controller: asmc has no margins: the law switches with the sign of s"),
    ("margins --controller nope", "--controller: 'nope' is "),
    (f"{SAMPLED} --certify", "--certify: the loop of a discrete controller has no"),
    (f"{SAMPLED} --lead 0.6", "--lead has no effect with --controller"),
    (f"{SAMPLED} --kp 1 --ki 1", "--kp has no effect with a controller from a file"),
    ("margins --kp nan --ki 5", "--kp: nan is not allowed; give a finite number"),
    ("margins --kp '65 N*m' --ki 5", "--kp: '65 N*m' has the wrong dimension"),
    ("margins --kp 190", "--ki: missing, but --kp is given; give both"),
    ("margins --rail icy", "--rail: 'icy' is not a rail condition; choose dry or wet"),
    ("margins --initial-speed 140 --speed 140 --slip 0.9", "0.827"),
    (f"margins --adhesion beam --slip {3 * 0.261 * 34500 / 274360!r} --rail dry", "kink"),
    ("margins --inertia-scale 0", "--inertia-scale: 0 is not allowed; give a value > 0"),
    ("margins --dead-time -1", "--dead-time: -1 s is not allowed; give a value >= 0 s"),
    ("margins --vehicle .", "--vehicle: '.' is not a file; give the path of a file"),
    ("margins --nonsense", "--nonsense"),
    ("margin", "'margin'; did you mean 'margins'?"),
    ("xyzzy", "'xyzzy'; choose one of report, "),
    ("tune", "--ms-max is missing"),
    ("tune --ms-max 1", "--ms-max: 1 is not allowed; give a value > 1"),
    ("tune --minimise-ms", "--minimise-ms and --ki-min"),
    ("tune --structure pdf", "error: --structure: 'pdf' is not known; choose one of pi, pi-lead, pid"),
    ("tune --ms-max 2 --lead 0.6", "error: --lead has no effect with structure 'pi'"),
    ("tune --ms-max 2 --lead-filter 0.6", "error: --lead-filter has no effect with structure 'pi'"),
    ("report --no-html --controller own.py", "linear() has an invalid result"),
    ("report --no-html --out .", "--out: the working folder"),
    ("verify --law paper --adhesion law.toml", "--adhesion: dahl as given is not allowed with the law 'paper'"),
    ("verify --law paper --slip 0.1", "--slip: 0.1 is not allowed with the law 'paper'"),
    ("verify --law layered", "--law: 'layered' was replaced by the predictive law; give --law predictive"),
    ("verify --law predictive --adhesion law.toml", "--adhesion: the law dahl has a state"),
    ("verify --law robust --adhesion burckhardt --slip 0.05", "burckhardt is not allowed with the law 'robust'"),
    ("verify --law theirs", "--law: 'theirs' is not allowed; give 'paper' or 'robust' or 'predictive'"),
    ("verify --K 1e6", "--K: 1e+06 is not allowed; give a value from 0 to 10000 (N*m)"),
    ("verify --law predictive --D 3", "--D: 3 is not allowed; the predictive law has no D"),
    ("verify --D 0.01", "--D: 0.01 is not allowed; give a value from 0.1 to 10000 (N*m/(m/s))"),
    ("verify --inertia-scale 50", "--inertia-scale: 50 is not allowed; give a value from 0.5 to 10"),
    *((f"verify --seed {seed}", "give a whole number from 0 to 2147483648") for seed in ("1.5", "99999999999999")),
    ("derive --reference falling", "--reference: 'falling' is not known"),
    ("derive --adhesion glue", "--adhesion: 'glue' is not a law"),
    ("derive --adhesion law.py", "--adhesion: law.py: "),
    ("derive --law predictive --adhesion beam", "--adhesion is only for --law published"),
    ("derive --law predictive --reference constant", "--reference: 'constant' is only for --law published"),
    ("derive --out .", "--out: '.' is a folder"),
    ("derive --format c --json", "--format: 'c' "),
    *((f"derive {law} --initial-speed 60", "--initial-speed is only for") for law in ("", "--adhesion beam")),
    *((f"reproduce --seeds={seeds}", SEEDS) for seeds in ("1", "many", "100001", "9" * 30)),
    ("identify log.csv --model beem", "--model: 'beem' cannot be fitted; did you mean 'beam'"),
    ("identify log.csv --observer luenberger", "--observer: 'luenberger' is not known; choose corrected, printed, kal"),
    ("identify log.csv --tau 0", "--tau: 0 s is not allowed; give a value > 0 s"),
    ("identify log.csv --column time", "--column: 'time' is not allowed; give NAME=VALUE"),
    ("identify log.csv --fix mu_max=high", "--fix mu_max: 'high' is not a number"),
    ("identify log.csv --bound mu_max=0.2", "--bound mu_max: '0.2' is not allowed; give LOW:HIGH"),
    ("identify log.csv --fix q=1", "--fix: 'q' is not a parameter of the model"),
    ("identify log.csv --vehicle nothing.toml", "--vehicle: nothing.toml"),
    ("simulate --scenario park2009", "--scenario: unknown name 'park2009'; choose one of park2008, park2008-si, stop"),
    ("simulate --encoder-teeth 0.5", "encoder_teeth: 0.5 is not allowed; give at least 1, or 0"),
    ("simulate --controller pid", "did you mean 'pi'"),
    ("simulate --gains dahl", "--gains: 'dahl' is not a column of Park et al., Table 4; choose beam or bristle"),
    ("simulate --controller asmc --kp 1 --ki 1", "'asmc' has no kp and ki"),
    ("simulate --unknown-rail", "--controller: 'pi' has neither adaptation nor"),
    ("simulate --adaptive --controller pi-lead", "choose 'asmc'"),
    ("simulate --seed -1", "--seed: '-1' is not allowed; give a whole number"),
    ("simulate --seed no.npz", "no.npz: no such file"),
    ("simulate --seed empty.npz", "empty.npz contains no random numbers of a run"),
    ("simulate --initial-speed 5", "--initial-speed: 5 km/h is outside 30 to 140 km/h"),
    ("simulate --speed 5", "--speed: 5 km/h is not allowed, because the run ends at 5 km/h"),
    ("simulate --step 3", "error: --step: 3 s is not allowed; give a value <= 1 s"),
    ("simulate --period 0", "--period: 0 s is not allowed"),
    ("simulate --csv no/such/folder/run.csv", "--csv: 'no/such/folder' is not a writable folder"),
    (f"simulate --csv {os.devnull}", "is not a regular file; choose another"),
    ("simulate --csv .", "--csv: '.' is a folder; give a file name"),
    *((f"simulate --controller own.toml {x}", GIVEN) for x in ("--gains beam", "--kp 1", "--slip 0.1", "--adaptive")),
    ("simulate --controller own.toml --period 0.1", GIVEN),
    ("simulate --scenario mine.toml --initial-speed 80", "error: --initial-speed "),
    # the scenario's own initial speed is what a published law cannot have
    ("simulate --scenario mine.toml --adhesion curve", "--scenario: the run begins at 180 km/h, outside 30 to 140"),
    ("margins --kp 1 --ki 1 --kp 2", "--kp is given 2 times; give it once"),
    ("simulate --seed 1 --seed=1", "--seed is given 2 times; give it once"),
    ("report --html --no-html", "--html is given 2 times; give it once"),
    *((TWICE.format(x), f"{x}: train_speed is given twice") for x in ("--delay", "--zero", "--column", "--unit")),
])  # fmt: skip
def test_bad_input_is_one_clear_line_and_exit_2(railslip, file, words, told):
    written = {file(name, text) for name, text in FILES.items()}
    assert told in refused(railslip(*shlex.split(words)))
    assert {path.name for path in Path.cwd().iterdir()} == written


def test_an_option_that_may_be_given_again_counts_once(railslip):
    once = railslip("linearize", "--speed", "100", "--rail", "dry", "--json")
    assert once[0] == 0
    assert railslip("linearize", "--speed", "100", "--speed", "100", "--rail", "dry", "--json", "--json") == once


@pytest.mark.parametrize(("words", "speed", "advised"), [
    ("--speed '100 m/s'", "360", False),  # above 140 km/h, to where the published parameters go
    ("--speed 120", "120", True),
    ("--speed '100 m/s' --adhesion polach --slip 0.05", "360", True),  # knows no v0
    ("--speed 120 --adhesion law.toml", "120", False),  # its polynomials end at 110 km/h
    ("--speed 105 --adhesion law.toml", "105", True),
])  # fmt: skip
def test_a_speed_above_v0_is_advised_only_what_is_taken(railslip, file, words, speed, advised):
    law = 'law = "dahl"\ninitial_speed_range = [30, 110]\nparameters = {alpha = 2.0e4}\n'
    file("law.toml", f"{law}polynomials = {{Fc = [1e4, -10]}}\nreference_slip = {{dry = 0.12, wet = 0.08}}\n")
    given = ("linearize", "--rail", "dry", *shlex.split(words))
    status, _, told = railslip(*given)
    advice = f"--initial-speed {speed}\n" in told
    assert (status, told.count("warning: --speed: "), advice) == (0, 1, advised)
    status, _, told = railslip(*given, "--initial-speed", speed)
    assert (status, "--speed: " in told) == (0, False) if advised else status == 2


def test_what_was_assumed_of_a_railtoolkit_vehicle_is_said(railslip, cases):
    yaml = "tests/data/rolling-stock/Facs124.yaml"
    for command in ("margins", "linearize"):
        _, out, err = railslip(command, "--vehicle", yaml, "--rail", "dry")
        assert ("4 axles are assumed" in err, "Facs 124" in out) == (True, True)
    (case,) = cases(f"margins --vehicle {yaml} --rail dry --initial-speed 80")
    assert (any("axles" in note for note in case["notes"]), case["initial_speed_kmh"]) == (True, 80)


def test_a_report_that_cannot_be_written_is_refused_before_the_work(railslip, tmp_path):
    (tmp_path / "report.txt").write_text("old")
    (tmp_path / "loop.png").mkdir()  # in the way of a picture
    for out, told in ((tmp_path, "loop.png"), (tmp_path / "report.txt", "--out")):
        assert told in refused(railslip("report", "--rail", "dry", "--out", out))
    assert (tmp_path / "report.txt").read_text() == "old"
    assert {p.name for p in tmp_path.iterdir()} == {"report.txt", "loop.png"}


def test_output_survives_a_closed_pipe_and_a_terminal_without_unicode():
    command = f"{shlex.quote(sys.executable)} -m railslip_ctrl {MARGINS}"
    environment = os.environ | {"PYTHONIOENCODING": "latin-1"}
    piped = subprocess.run(["sh", "-c", f"{command} | head -1"], capture_output=True, check=True, env=environment)
    assert piped.stderr == b""


def test_a_report_fits_the_terminal_and_says_the_same(railslip, monkeypatch):
    piped = railslip(*MARGINS.split())[1]
    assert 80 < max(map(len, piped.splitlines())) <= WIDTH
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "80")
    narrow = railslip(*MARGINS.split())[1]
    assert max(map(len, narrow.splitlines())) <= 80
    number = re.compile(r"(?<![\w.])\d+\.\d+")
    assert set(number.findall(narrow)) == set(number.findall(piped))  # no number is broken in two


@pytest.fixture
def derived(file):
    text = 'law = "burckhardt"\n[parameters]\nc1 = 0.20\nc2 = 18.0\nc3 = 0.08\n'
    derivation, law = derive(law="burckhardt"), load_law(file("leaves.toml", text))
    return derivation, generate(derivation), law, law_numbers(derivation, law)


def told(derivation, code, numbers):
    yield derivation_text(derivation, (), numbers)
    yield from (derivation_document(form, derivation, (), code, numbers) for form in ("markdown", "latex"))


def test_derive_puts_the_numbers_of_a_file_into_the_law_and_the_code(derived):
    derivation, code, law, numbers = derived
    found = derivation_json(derivation, (), code, numbers)["law"]["numbers"]
    for rail, one in (("dry", law), ("wet", law.wet())):
        assert list(found[rail]["parameters"].items()) == list(
            zip(law.parameter_names(), one.parameters(), strict=True)
        )
    for text in told(derivation, code, numbers):
        assert "Law with the numbers given, dry rail" in text
        assert "c1 = 0.2, c2 = 18, c3 = 0.08 (SI)" in text
    assert "numbers given" not in derivation_text(derivation, ())
    code, namespace = with_numbers(code, numbers, Path("leaves.toml")), {}
    exec(compile(code.python, "law", "exec"), namespace)
    for one in numbers:
        given = dict(one.parameters)
        assert namespace[f"ADHESION_{one.rail.name}"] == {f"adhesion_{name}": value for name, value in given.items()}
        in_c = ", ".join(f".adhesion_{name} = {value!r}" for name, value in given.items())
        assert f"#define RAILSLIP_ASMC_ADHESION_{one.rail.name} {in_c}\n" in law_program(code).header
        symbols = dict(zip(type(law).symbols(), given.values(), strict=True))
        rest = sorted(one.torque.free_symbols, key=str)
        state = dict(zip(rest, np.random.default_rng(1).uniform(0.5, 2.0, len(rest)), strict=True))
        expected = derivation.law_in_adhesion.subs(symbols).subs(state)
        assert float(one.torque.subs(state)) == pytest.approx(float(expected), rel=1e-5)
        assert not one.torque.free_symbols & set(symbols)


def test_a_law_without_closed_form_says_so(derived):
    derivation = replace(derived[0], adhesion="table")  # a table's own takes long, and is not asked for
    law, code = law_class("table")(slip=(0.0, 0.05, 0.1, 1.0), mu=(0.0, 0.2, 0.25, 0.1)), derived[1]
    numbers = law_numbers(derivation, law)
    assert (numbers[0].torque, dict(numbers[0].parameters)["mu_3"]) == (None, 0.25)
    assert with_numbers(code, numbers, Path("table.toml")) == code  # Ta is an argument: nothing to initialise
    assert derivation_json(derivation, (), code, numbers)["law"]["numbers"]["dry"]["latex"] is None
    for text in told(derivation, code, numbers):
        assert "Ta is evaluated from these numbers outside the control law" in text
    with pytest.raises(InputError, match=r"'burckhardt', not 'beam'"):
        law_numbers(derived[0], published_law("beam", Rail.DRY))


def test_derive_takes_a_file_over_the_initial_speed(railslip, file):
    text = 'law = "burckhardt"\n[parameters]\nc2 = 18.0\nc3 = 0.08\n[polynomials]\nc1 = [0.5, -0.0025]\n'
    words = ("derive", "--adhesion", file("model.toml", text), "--format", "c")
    for options, c1 in (((), 0.25), (("--initial-speed", "60"), 0.35)):
        assert f"ADHESION_DRY .adhesion_c1 = {c1}, .adhesion_c2 = 18.0" in railslip(*words, *options)[1]


@needs_compiler
def test_derive_writes_c_into_two_files(railslip, tmp_path):
    status, out, err = railslip("derive", "--format", "c", "--out", tmp_path / "new" / "Slip-law.c")
    assert (status, out, "Slip-law.h" in err) == (0, "", True)
    source = tmp_path / "new" / "Slip-law.c"
    command = [COMPILER, "-std=c99", *WARNINGS, "-c", source, "-o", tmp_path / "a.o"]
    assert subprocess.run(command, capture_output=True).returncode == 0
    assert "int railslip_slip_law_init(" in source.with_suffix(".h").read_text()
    status, _, err = railslip("derive", "--format", "c", "--out", tmp_path / "law.txt")
    assert (status, "does not end in .c; give" in err) == (2, True)
