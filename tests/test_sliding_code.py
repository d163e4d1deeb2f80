"""The sliding-mode law derived from the plant, against (45) and broken plants, and generated: Python against the
derivation, C99 against the Python."""

import json
import math
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import sympy as sp
from generated_code import COMPILER, Program, adhesion_of, needs_compiler, parameters, python_law
from sample_laws import ALL_LAWS, sample_law

import railslip_ctrl
from railslip_ctrl import PARK2008, InputError, Rail, derive
from railslip_ctrl.controllers.base import Measurement
from railslip_ctrl.controllers.c_code import law_program
from railslip_ctrl.controllers.guard import Guard, Status, guarded, is_good
from railslip_ctrl.model import plant
from railslip_ctrl.model.adhesion import law_class, law_names, published_law
from railslip_ctrl.model.numeric import numeric_plant, plant_parameters
from railslip_ctrl.paper.errata import errata
from railslip_ctrl.sliding.code import generate
from railslip_ctrl.sliding.generate import LAW_FILE, generate_law, law_source
from railslip_ctrl.sliding.law import PUBLISHED_LAW, SOURCES, LawGains, gain_parameters
from railslip_ctrl.sliding.proof import agree_at_random_points, identical, sliding_symbol, vanishes
from railslip_ctrl.sliding.sampled_law import DOMAIN_SHARE, LARGEST, OPTIONS


@pytest.mark.parametrize("reference", ["proportional", "constant"])
def test_every_step_is_checked_and_the_law_is_45_with_theta_corrected(reference: str) -> None:
    """[Park2008] (45), typed here from the paper, sigma_d' as the reference has it; theta from the masses."""
    derivation = derive(reference=reference)
    assert [step.name for step in derivation.steps if not step.checked] == []
    assert len({step.name for step in derivation.steps}) == len(derivation.steps) >= 18
    for step in derivation.steps:
        assert all((step.statement, step.done, step.source, step.check))
    s, e, rho, D, K, k, k1, k2 = map(sliding_symbol, ("s", "e", "rho", "D", "K", "k", "k1", "k2"))
    lambda_d, th1, th2 = map(sliding_symbol, ("lambda_d", "theta1_hat", "theta2_hat"))
    Mn, Mp, Bn, Bp = map(sliding_symbol, ("Mn", "Mp", "Bn", "Bp"))
    r, J, Ta, omega = plant.r, plant.J, plant.Ta, plant.omega
    sigma_d_rate = lambda_d * plant.v_rate if reference == "proportional" else 0
    bracket = sigma_d_rate + (1 / (r * Mn) + r / J) * Ta - r * Bn / J * omega + th1 * Ta + th2 * omega + rho * e
    printed = J / r * bracket + D * s + K * sp.sign(s)
    assert sp.simplify(derivation.adaptive_law_control - printed) == 0
    assert sp.simplify(derivation.theta[0] - (1 / (Mn + Mp) - 1 / Mn) / r) == 0
    assert sp.simplify(derivation.theta[1] + r * Bp / J) == 0
    assert derivation.adaptation == (k * s * Ta, k * s * omega)
    assert derivation.adaptation_matrix == (k1 * s * Ta, k2 * s * omega)
    assert sp.simplify(derivation.V_rate_final + r / J * (D * s**2 + K * sp.Abs(s))) == 0


def test_identities_tell_true_from_false() -> None:
    x, a = sp.Symbol("x", real=True), sp.Symbol("a", positive=True)
    assert identical(x * sp.sign(x), sp.Abs(x))
    assert not vanishes(x * sp.sign(x) - x)
    assert vanishes(sp.sign(x) ** 3 - sp.sign(x))
    assert not vanishes(sp.sign(x) ** 2 - 1)  # at x = 0
    assert vanishes(sp.sign(x - a) ** 2 * (x - a) - (x - a))
    assert not agree_at_random_points(x, a)
    assert vanishes(sp.exp(x) * a - a * sp.exp(x))


DRIVER = """
import json, sys
from pathlib import Path

sys.dont_write_bytecode = True  # of one text of the statement would be taken for another's

def probe(text):
    Path("railslip_ctrl/model/plant.py").write_text(text)
    for name in [name for name in sys.modules if name.startswith("railslip_ctrl")]:
        del sys.modules[name]
    from railslip_ctrl.sliding.derivation import derive
    from railslip_ctrl.paper.errata import law_errata

    d = derive()
    found = {"law": str(d.adaptive_law_control), "disturbance": str(d.disturbance)}
    found["failed"] = [step.name for step in d.steps if not step.checked]
    return found | {"disagree": [row.where for row in law_errata(d) if not row.agrees]}

print(json.dumps({name: probe(text) for name, text in json.load(sys.stdin).items()}))
"""

MUTATIONS = {  # of these (35) and the law or the disturbance change too
    "Ta drives the wheel backwards": ("-B * omega + Ta - Tb", "-B * omega - Ta - Tb"),
    "brake drives": ("+ Ta - Tb - Td", "+ Ta + Tb - Td"),
    "adhesion pushes the train": ("sp.Eq(M * v_rate, -Fa - Fr", "sp.Eq(M * v_rate, Fa - Fr"),
    "resistance pushes the train": ("-Fa - Fr - Tr / r)", "-Fa + Fr - Tr / r)"),
    "r lost in the adhesion torque": ("sp.Eq(Ta, r * Fa)", "sp.Eq(Ta, Fa)"),
    "slip of the other sign": ("sp.Eq(sigma, v - r * omega)", "sp.Eq(sigma, v + r * omega)"),
}
OTHERS = {
    "slip ratio of the other sign": ("sp.Eq(slip, sigma / v)", "sp.Eq(slip, -sigma / v)"),
    "resistance that helps": ("Fr0 + Fr1 * v +", "Fr0 - Fr1 * v +"),
    "unstable lag": ("(T * s + 1)", "(T * s - 1)"),
}


@pytest.mark.long
def test_a_broken_plant_is_noticed(tmp_path) -> None:
    """A step of `derive` fails, and (35)-(45) agree no longer: of copies of the package, in one process."""
    text = Path(plant.__file__).read_text(encoding="utf-8")
    assert all(text.count(before) == 1 for before, _ in (*MUTATIONS.values(), *OTHERS.values()))
    asked = {name: text.replace(*pair) for name, pair in {"sound": ("", ""), **MUTATIONS, **OTHERS}.items()}
    ignore = shutil.ignore_patterns("plant.*.pyc")  # the other modules, imported anew for each text, stay compiled
    shutil.copytree(Path(railslip_ctrl.__file__).parent, tmp_path / "railslip_ctrl", ignore=ignore)
    run = {"cwd": tmp_path, "env": {**os.environ, "PYTHONPATH": str(tmp_path)}, "capture_output": True, "text": True}
    done = subprocess.run([sys.executable, "-c", DRIVER], input=json.dumps(asked), check=False, **run)
    assert done.returncode == 0, done.stderr[-2000:]
    probed = json.loads(done.stdout)
    sound = probed.pop("sound")
    assert sound["failed"] == []
    for name, broken in probed.items():
        assert broken["failed"], name
        if name in MUTATIONS:
            assert (broken["law"], broken["disturbance"]) != (sound["law"], sound["disturbance"]), name
            assert set(broken["disagree"]) > {"(35)"} | set(sound["disagree"]), name


def test_json_has_the_contract_s_keys(railslip) -> None:
    status, out, err = railslip("derive", "--reference", "constant", "--adhesion", "bristle", "--json")
    content = json.loads(out)
    assert (status, err, set(content["law"])) == (0, "", {"latex", "python", "c"})
    assert all({"equation_latex", "source"} <= set(step) and step["checked"] is True for step in content["steps"])
    assert all({"where", "printed_latex", "derived_latex"} <= set(row) for row in content["errata"])
    verdicts = {row["where"]: row["agrees"] for row in content["errata"]}  # the same for a constant reference
    assert verdicts == {**dict.fromkeys(AGREE, True), **dict.fromkeys(SIZES, False)}


def test_latex_is_a_document(railslip, tmp_path) -> None:
    file = tmp_path / "derivation.tex"
    status, out, err = railslip("derive", "--format", "latex", "--out", file, "--adhesion", "beam")
    assert (status, out, "wrote" in err) == (0, "", True)
    text = file.read_text(encoding="utf-8")
    compiler = shutil.which("pdflatex") or shutil.which("tectonic")
    if compiler is not None:
        halt = ["-interaction=nonstopmode", "-halt-on-error"] if compiler.endswith("pdflatex") else []
        done = subprocess.run([compiler, *halt, file.name], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout[-2000:]
        assert "Overfull" not in done.stdout  # nothing runs out of the page
        assert file.with_suffix(".pdf").stat().st_size > 10_000
    # environments are closed, braces and \\left/\\right balance in each formula, nothing outside ASCII
    assert text.isascii()
    assert text.count(r"\begin{") == text.count(r"\end{")
    for line in (line for line in text.splitlines() if line.startswith(r"\formula")):
        bare = line.replace(r"\{", "").replace(r"\}", "")
        assert (bare.count("{"), line.count(r"\left")) == (bare.count("}"), line.count(r"\right")), line


AGREE = {
    *("(24) with brackets", "(28) = (27)", "(35)", "(36)", "(37)", "(41)", "(42)", "(43)"),
    *("(44), theta_2", "(45)", "(46)", "(47) with (45)"),
}
SIZES = {
    "(6)": ("0.019 times", "274360 N", "8e+10 Pa"),
    "(10)": ("printed -120 N, derived 271 N", "0.0985", "0.500 times the force"),
    "(22)-(24)": ("11297 N", "negative"),
    "(27)": (": 1; ", ": 0"),
    "(38)-(39) with (41)": ("same sign", "140.3"),
    "F_r in (4) and (35)": ("0.123 m/s^2", "486 N", "0.138 m/s^2"),
    "(44), theta_1": ("3517 -> 5276 kg", "+1.322e-03", "-2.205e-04", "opposite sign, 6.00 times"),
    "(47)-(48)": ("same sign", "140.3 times too large"),
    "(49)": ("k1 in s**2/(kg**2*m**4), k2 in 1",),
    "p. 54, invariant set theorem": ("one equation for two errors", "0.0893 m^2/s^2", "25 s"),
    "(40) with Table 4": ("K0 = (r/J) K = 0.499", "1.581", "3.2 times", "27.6 m/s", "27.8 m/s", "75.2 m/s", "1402 N*m"),
    "(42), strict": ("0 < 0 is false",),
    # (gamma - 0)/beta over the wheel load, and -sigma/beta less at slip 0.132; peaks: the tests of the laws
    "Fig. 17, bristle maximum": ("0.3274 at slip 0+", "0.2985 at slip 0.132", "2.93 m/s^2 slip 0.129"),
    "p. 46, slip of the largest adhesion": (
        "0.119 and 0.059",
        "0.132 and 0.092",
        "beam wet 0.0448",
        "curve wet 0.0957",
    ),
    "B = 0.25 - 0.01 t": ("zero at 25 s", "-0.345"),
    "Table 3": ("0.0110 and 0.008475", "23.0 % better", "24.5 % from 0.011 and 0.0083"),
    "Table 4, Kp": ("beam: as printed 1.44e+06", "bristle: as printed 2.34e+06", "a factor of 1000"),
    "Table 4, Ki": ("beam: as printed 54 ", "bristle: as printed 27 ", "a factor of 0.278"),
    "Table 4, D, K, rho": ("4.25e-04 1/s", "5.40e-03 m/s^2", "5.51 N*m/(m/s)", "70 N*m", "beam: ", "5.83 N*m/(m/s)"),
    "Table 5, energy": ("1.77e-04 J", "4.87e+06 J", "1.75e+07"),
    "Table 5 / (4), braking time": ("2.94 m/s^2", "9.0 s", "46.8 s"),
}


def test_every_row_is_decided_as_expected_and_has_its_size_in_the_paper_s_numbers() -> None:
    rows = {row.where: row for row in errata(derive())}
    assert {where for where, row in rows.items() if row.agrees} == AGREE
    assert {where for where, row in rows.items() if not row.agrees} == set(SIZES)
    for where, texts in SIZES.items():
        assert [text for text in texts if text not in rows[where].sign_and_size] == [], where


# --- the generated code ---------------------------------------------------------------------------------------------

CASES = [("proportional", "bristle"), ("constant", None)]  # `make test` compiles; the others have the same printer
LONG_CASES = [*(("proportional", law) for law in (None, *ALL_LAWS) if law != "bristle"), ("constant", "bristle")]
CASES += (pytest.param(*case, marks=pytest.mark.long) for case in LONG_CASES)

ARGUMENTS = {
    **{"e": (-4.0, 4.0), "e_integral": (-3.0, 3.0), "omega": (1.0, 90.0), "Ta": (-6e3, 6e3), "v_rate": (-4.0, 1.0)},
    **{"theta1_hat": (-3e-4, 3e-4), "theta2_hat": (-0.01, 0.01)},
}


def options(generator):
    sides = (("min", -1.0), ("max", 1.0))
    box = {f"theta{i}_{side}": sign * generator.uniform(0.1, 1.0) * 1e-4 for i in (1, 2) for side, sign in sides}
    limits = {"torque_min": 0.0, "torque_max": generator.uniform(500.0, 4e3), "boundary": generator.uniform(0.05, 0.5)}
    flags = {"dead_zone": float(generator.integers(2)), "anti_windup": float(generator.integers(2))}
    return {**limits, **box, **flags, "leak": generator.uniform(0.0, 2.0)}


@pytest.mark.parametrize("reference", ["proportional", "constant"])
def test_control_is_the_derived_law(reference) -> None:
    derivation = derive(reference=reference)
    module, law = python_law(derivation), generate(derivation).law
    generator = np.random.default_rng(7)
    s = sliding_symbol("s")
    names = [*law.control_arguments, *law.parameters]
    expressions = (derivation.adaptive_law_control.subs(s, derivation.s), derivation.s)
    rates = (rate.subs(s, derivation.s) for rate in derivation.adaptation_matrix)
    known = {str(x): x for e in (*expressions, *derivation.adaptation_matrix) for x in e.free_symbols}
    symbols = [known.get(name, sp.Symbol(name)) for name in names]  # an option has no place in the paper's law
    reference_law = sp.lambdify(symbols, (*expressions, *rates), "math")
    for _ in range(300):
        p = parameters(generate(derivation), generator, None)
        arguments = [generator.uniform(*ARGUMENTS[name]) for name in law.control_arguments]
        expected = reference_law(*arguments, *p)
        assert module.control(*arguments, module.Parameters(*p)) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_filter_and_integral_converge_to_the_continuous_ones() -> None:
    """v falls by 1 m/s^2: the estimate tends to -1 as s/(tau s + 1) does, the integral to that of e; first order."""
    derivation = derive()
    module = python_law(derivation)
    errors = []
    for period in (2e-3, 1e-3):
        values = dict.fromkeys(module.Parameters._fields, 0.0)
        values |= {"J": 60.0, "r": 0.43, "Mn": 3517.0, "lambda_d": 0.1, "rho": 1.0, "D": 1.0, "torque_max": LARGEST}
        p = module.Parameters(**{**values, "filter_time": 0.1, "period": period})
        state = module.start(20.0)
        for i in range(round(0.2 / period)):
            v = 20.0 - (i + 1) * period
            module.law_step(state, v, v / 0.43, 0.0, p)  # no slip: e = lambda_d v
        estimate = (v - state.v_filtered) / p.filter_time
        exact = -(1.0 - math.exp(-0.2 / 0.1))
        errors.append((abs(estimate - exact), abs(state.e_integral - 0.1 * (20.0 * 0.2 - 0.02))))
    assert np.array(errors[1]) == pytest.approx(np.array(errors[0]) / 2.0, rel=0.05)
    assert errors[1][0] < 3e-3


PLAIN = {"J": 60.35, "r": 0.43, "Mn": 3517.0, "Bn": 0.25, "lambda_d": 0.132}
MEASURED = (25.0, 53.0, 4000.0)  # m/s, rad/s, N*m: sigma = 2.21 m/s, e = 1.09 m/s


def stepped(given, **estimates):
    module = python_law(derive())
    values = PLAIN | {"filter_time": 0.1, "period": 0.01, "boundary": 0.0} | gain_parameters(PUBLISHED_LAW)
    p = module.Parameters(**values | {"torque_min": -LARGEST, "torque_max": LARGEST} | given)
    state = SimpleNamespace(**{**vars(module.State), **vars(module.start(MEASURED[0])), **estimates})
    return module.law_step(state, *MEASURED, p), {name: getattr(state, name) for name in generate(derive()).law.states}


def test_variants_of_the_adaptation() -> None:
    def after_a_step(gains):
        _, state = stepped(gain_parameters(gains), theta1_hat=3e-4, theta2_hat=-2e-3)
        return state["s"], (state["theta1_hat"], state["theta2_hat"])

    gains = replace(PUBLISHED_LAW, layer=0.2, dead_zone=True, leak=0.7)
    s, theta_hat = after_a_step(gains)
    assert s > 0.2
    drive = s - 0.2
    rates = (gains.k1 * drive * 4000.0 - 0.7 * 3e-4, gains.k2 * drive * 53.0 + 0.7 * 2e-3)
    assert theta_hat == pytest.approx((3e-4 + 0.01 * rates[0], -2e-3 + 0.01 * rates[1]), rel=1e-12)
    # within the layer nothing drives the estimates
    assert after_a_step(replace(PUBLISHED_LAW, layer=2.0, dead_zone=True))[1] == (3e-4, -2e-3)
    boxed = replace(PUBLISHED_LAW, box=((-1e-4, 1e-4), (-1e-3, 5e-3)))
    assert after_a_step(boxed)[1] == (1e-4, -1e-3)
    plain = gain_parameters(LawGains(K=1.0, D=2.0, rho=3.0))  # without adaptation and variants
    assert {name: value for name, value in plain.items() if value} == {"K": 1.0, "D": 2.0, "rho": 3.0}
    with pytest.raises(InputError, match=r"0\.1 \.\. 0\.1 of theta1_hat"):
        gain_parameters(replace(PUBLISHED_LAW, box=((0.1, 0.1), (0.0, 1.0))))


@pytest.mark.parametrize(("limit", "integral"), [("torque_max", False), ("torque_min", True)])
def test_anti_windup(limit, integral) -> None:
    """e > 0 raises the torque: at the upper limit the integral rests, at the lower it unwinds; the estimates rest."""
    free = stepped({})
    bound = free[0] - 100.0 if limit == "torque_max" else free[0] + 100.0
    rests = {"theta1_hat": 0.0, "theta2_hat": 0.0} | ({} if integral else {"e_integral": 0.0})
    assert stepped({limit: bound, "anti_windup": 1.0}) == (bound, free[1] | rests)
    # without it all of them go on, and off its limits it changes nothing
    assert stepped({limit: bound}) == (bound, free[1])
    assert stepped({"anti_windup": 1.0}) == free


@pytest.fixture(scope="module")
def in_both_languages(tmp_path_factory):
    flags, empty = ("-fsanitize=undefined", "-fno-sanitize-recover=all"), tmp_path_factory.mktemp("flags") / "empty.c"
    empty.write_text("int main(void) { return 0; }\n")
    if subprocess.run([COMPILER, *flags, empty, "-o", empty.with_suffix("")], capture_output=True).returncode:
        flags = ()

    @cache
    def made(adhesion, reference="proportional"):
        derivation = derive(reference=reference, law=adhesion)
        code = generate(derivation)
        return code, python_law(derivation), Program(law_program(code), tmp_path_factory.mktemp("law"), *flags)

    return made


NOT_FINITE = (math.nan, math.inf, -math.inf)
EXTREMES = (0.0, -0.0, 5e-324, 1e-300, -1e-160, 1.0, -3.0, 80.0, 1e12, -1e13, 1e100, -1e200, 1.7e308, -1.7e308)


@needs_compiler
@pytest.mark.parametrize(("reference", "adhesion"), CASES)
def test_c_is_the_python_at_measurements_of_any_size(reference, adhesion, in_both_languages) -> None:
    """States included: 12 sequences of a stop, four of each kind of parameters, then 40 of any numbers, or none."""
    made = in_both_languages(adhesion, reference)
    law = made[0].law
    inside, generator = adhesion if law.measured == ("v", "omega") else None, np.random.default_rng(123)
    for run in range(12):
        given = ({}, {"torque_min": 0.0, "torque_max": 8e3, "boundary": 0.3}, options(generator))[run % 3]
        row, v = parameters(made[0], generator, inside, **given), generator.uniform(5.0, 38.0)
        both = Both(made, row, v)
        for _ in range(200):
            v = max(1.0, v + generator.uniform(-0.1, 0.02))
            omega = v * (1.0 - generator.uniform(0.005, 0.4)) / both.p.r
            both.step(*({"v": v, "omega": omega, "Ta": generator.uniform(0.0, 6e3)}[name] for name in law.measured))
    for run in range(40):
        row = parameters(made[0], generator, inside, **(options(generator) if run % 2 else {}))
        both = Both(made, row, min(abs(float(generator.choice(EXTREMES))), LARGEST))
        for _ in range(60):
            measured = [abs(float(generator.choice(EXTREMES))) for _ in law.measured]
            measured[2:] = [float(generator.choice(EXTREMES)) for _ in measured[2:]]
            if generator.random() < 0.1:
                measured[int(generator.integers(len(measured)))] = float(generator.choice(NOT_FINITE))
            before, torque = dict(vars(both.state)), both.step(*measured)
            assert both.p.torque_min <= torque <= both.p.torque_max
            assert max(map(abs, (torque, *vars(both.state).values()))) <= LARGEST
            if not all(map(math.isfinite, measured)):
                assert (vars(both.state), both.status is Status.OK) == (before, False)


@pytest.mark.parametrize("name", [None, *law_names()])
def test_each_adhesion_law_is_derived_and_its_c_has_no_allocation_no_loop_and_no_recursion(name) -> None:
    derivation = derive(law=name)
    assert derivation.all_checked
    if name:
        assert derivation.steps[-1].name == "adhesion law"
        assert not derivation.law_in_adhesion.has(plant.Ta)
        assert (derivation.adhesion_state_rate is not None) == law_class(name).has_state
    text = re.sub(r"/\*.*?\*/", "", law_program(generate(derivation)).in_one_file, flags=re.S)
    for word in ("malloc", "calloc", "realloc", "free", "for", "while", "do", "goto"):
        assert not re.search(rf"\b{word}\b", text)
    functions = dict(re.findall(r"\b(\w+)\([^;{]*\)\n\{(.*?)\n\}", text, flags=re.S))
    assert {"slip_control", "slip_law_step", "guarded", "railslip_asmc_init", "railslip_asmc_step"} < set(functions)
    called = {one: set(re.findall(r"\b(\w+)\(", body)) & set(functions) for one, body in functions.items()}
    order = list(functions)
    assert all(order.index(other) < order.index(one) for one, others in called.items() for other in others)


def test_the_committed_law_is_what_the_derivation_gives(tmp_path, monkeypatch):
    assert LAW_FILE.read_text(encoding="utf-8") == generate_law(), "run `make generate`"
    assert law_source() == generate(derive()).python
    program = "import sys, railslip_ctrl.sliding.code, railslip_ctrl.sliding.derivation\nprint(*sys.modules)"
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.split()
    hashed = {Path(name).stem for name in SOURCES if name.startswith("sliding/") and name.endswith(".py")}
    assert {name.rpartition(".")[2] for name in found if name.startswith("railslip_ctrl.sliding.")} == hashed
    stale = tmp_path / "sliding_law.py"
    stale.write_text(LAW_FILE.read_text(encoding="utf-8").replace("SHA-256 ", "SHA-256 0"), encoding="utf-8")
    monkeypatch.setattr("railslip_ctrl.sliding.generate.LAW_FILE", stale)
    monkeypatch.setattr("railslip_ctrl.sliding.generate.generate_law", lambda: "derived")
    assert law_source.__wrapped__() == "derived"


PERIOD = 1e-3  # s
V0 = 140.0 / 3.6  # m/s


class Both:
    """The law with its guard in Python and in C, stepped together: the same torque, status and state, all finite.

    The guard takes speeds of any size, and neither a wheel that stands nor a stuck sensor for a fault.
    """

    def __init__(self, made, row, v) -> None:
        self.code, self.module, self.program = made
        self.p = self.module.Parameters(*row)
        limits = {"period": self.p.period, "radius": self.p.r, "torque_max": self.p.torque_max}
        off = dict.fromkeys(("speed_max", "wheel_speed_max", "stuck_time", "lock_time"), 1.79e308)
        guard = Guard(**limits, torque_min=self.p.torque_min, **off)
        self._g, self._q = SimpleNamespace(**dict(Guard.State())), SimpleNamespace(**dict(guard))
        names = self.code.law.states
        self.state = SimpleNamespace(**{**dict.fromkeys(names, 0.0), **vars(self.module.start(v))})
        self.row = self.program.numbers(*row, *(value for _, value in guard))
        assert self.program.init(v, self.row) == 0

    def step(self, *measured) -> float:
        m, others = Measurement(0.0, *measured[:2], 0.0), measured[2:]
        good = is_good(self._g, m, self._q) if all(map(math.isfinite, others)) else 0.0
        wanted = self.module.law_step(self.state, *measured, self.p) if good else 0.0
        torque = guarded(self._g, m, self._q, good, wanted)
        self.status = Status(int(self._g.status))
        found, status = self.program.step(*measured[:2], 0.0, *others)
        names = self.code.law.states
        mine = (torque, *(getattr(self.state, one) for one in names))
        both = (found, *self.program.first(len(names)))
        # relative to the size where that is above 1
        assert all(abs(a - b) <= 1e-12 * max(1.0, abs(a)) for a, b in zip(mine, both, strict=True))
        assert (status, all(map(math.isfinite, mine))) == (self.status, True)
        return torque

    def run(self, seconds, v, omega) -> np.ndarray:
        """Torques, N*m, at constant measurements."""
        return np.array([self.step(v, omega) for _ in range(round(seconds / PERIOD))])


def published(made, law, v) -> Both:
    """The published gains with an adhesion law, limits and anti-windup, the brake applied at speed v."""
    values = PLAIN | {"N": 34_500.0, "filter_time": 0.05, "period": PERIOD, "torque_min": 0.0, "torque_max": 9000.0}
    values |= dict.fromkeys(OPTIONS, 0.0) | gain_parameters(PUBLISHED_LAW) | {"anti_windup": 1.0}
    values |= adhesion_of(law)
    return Both(made, [values[name] for name in made[0].law.parameters], v)


@needs_compiler
def test_a_wheel_that_has_locked_is_released_and_braked_again(in_both_languages) -> None:
    """The bristle law at 140 km/h, where gamma is 116 km/h: beyond it z grew to 1e12 and the brake stayed full."""
    bristle = published_law("bristle", Rail.DRY, 140.0)
    law = published(in_both_languages("bristle"), bristle, V0)
    turning = (1.0 - 0.132) * V0 / 0.43
    before = law.run(1.0, V0, turning)[-1]
    largest = bristle.gamma / bristle.beta / bristle.alpha  # Fs/alpha
    assert 3000.0 < before < 5000.0  # some 0.9 of r Fs: the bristles are bent
    torques = []
    for i in range(500):
        torques.append(law.step(V0, math.nan if 200 <= i < 350 else 0.0))  # the sensor fails as well
        assert 0.0 <= law.state.z <= largest
    assert max(torques) == 0.0  # from the first sample on
    assert law.state.z == pytest.approx((1.0 - DOMAIN_SHARE) * largest, rel=1e-6)  # at rest at the end of the domain
    # z relaxes to (gamma - sigma)/(alpha beta) with the rate alpha beta sigma/(gamma - sigma), 6.6 1/s here
    sigma = V0 - 0.43 * turning
    rate = bristle.alpha * bristle.beta * sigma / (bristle.gamma - sigma)
    rest, started = (bristle.gamma - sigma) * largest / bristle.gamma, law.state.z
    after = law.run(0.5, V0, turning)
    expected = rest + (started - rest) * math.exp(-0.5 * rate)
    assert law.state.z == pytest.approx(expected, rel=5e-3)  # backward Euler, 1 ms: h rate^2 t/2 = 0.01 of 4 %
    assert after.max() < 9000.0
    assert after[-1] == pytest.approx(before, rel=0.05)  # within 0.5 s


@pytest.mark.parametrize("adhesion", [name for name in ALL_LAWS if name not in ("curve", "table")])
def test_the_adhesion_in_the_code_is_the_law(adhesion) -> None:
    """Its intermediate names change nothing: the torque with Ta of the law put in from outside is the same."""
    law, inside, outside = sample_law(adhesion), python_law(derive(law=adhesion)), python_law(derive())
    functions, p_law = numeric_plant(type(law)), plant_parameters(law, PARK2008)
    generator = np.random.default_rng(11)
    for _ in range(50):
        given = {"r": PARK2008.wheel.radius, "N": PARK2008.wheel_load, "torque_max": 1e9, "torque_min": -1e9}
        row = parameters(generate(derive(law=adhesion)), generator, adhesion, **given)
        p = inside.Parameters(*row)
        q = outside.Parameters(**{name: getattr(p, name) for name in outside.Parameters._fields})
        v, slip = generator.uniform(5.0, 30.0), generator.uniform(-0.5, 0.9)
        omega, sigma = (1 - slip) * v / p.r, slip * v
        z = float(functions.rest_state(v, sigma, 0.0, 0.0, 0.0, 0.0, p_law))
        Ta = p.r * float(functions.force(v, sigma, z, 0.0, 0.0, 0.0, p_law))
        start = inside.start(v)
        if law.has_state:
            start.z = z
        expected = outside.law_step(outside.start(v), v, omega, Ta, q)
        assert inside.law_step(start, v, omega, p) == pytest.approx(expected, rel=1e-9)


@needs_compiler
def test_an_adhesion_torque_that_is_no_number_releases_the_brake(in_both_languages) -> None:
    law = published(in_both_languages(None), None, 25.0)
    for wrong in (math.nan, math.inf, -math.inf):
        held, state = law.step(25.0, 53.0, 4000.0), dict(vars(law.state))
        assert 0.0 < held < 9000.0
        torques = [law.step(25.0, 53.0, wrong) for _ in range(400)]
        assert torques[:99] == [held] * 99
        assert (torques[-1], law.status, vars(law.state)) == (0.0, Status.FAULT, state)


@needs_compiler
def test_parameters_that_are_refused_name_themselves_and_keep_the_brake_released(in_both_languages) -> None:
    both = published(in_both_languages("lugre"), sample_law("lugre"), V0)
    names, good = both.code.law.parameters, list(both.row)
    may_be_zero = {"Bn", "K", "k1", "k2", "boundary", "torque_min", "adhesion_alpha1", "adhesion_alpha2", *OPTIONS}
    above = {"lambda_d": 13.2, "torque_min": 10.0}  # a slip in per cent; a brake that cannot release

    def refused(v, changed):
        """The code of init; the step after a refusal."""
        row = [changed.get(name, value) for name, value in zip(names, good, strict=False)] + good[len(names) :]
        code = both.program.init(v, both.program.numbers(*row))
        if code:
            assert both.program.step(V0, 70.0, 0.0) == (0.0, Status.FAULT)
        return code

    for place, name in enumerate(names, 1):
        bad = [math.nan, *([] if name in ("torque_min", "torque_max") else [math.inf, -math.inf])]
        bad += ([] if name in may_be_zero else [0.0, -1.0]) + ([above[name]] if name in above else [])
        assert [refused(V0, {name: value}) for value in bad] == [place] * len(bad), name
    assert refused(math.nan, {}) == len(good) + 1
    assert refused(V0, dict.fromkeys(may_be_zero & set(names), 0.0)) == 0
    assert both.program.init(V0) == 1  # the default parameters are the user's to fill in
