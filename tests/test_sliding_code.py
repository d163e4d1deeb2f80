"""The generated controller: Python against the derivation, C99 against the Python."""

import itertools
import math
import re
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from generated_code import COMPILER, Compiled, adhesion_of, begun, fields, needs_compiler, parameters, same
from sample_laws import ALL_LAWS, sample_law

from railslip_ctrl import PARK2008, InputError, Rail, derive
from railslip_ctrl.model.adhesion import law_names, published_law
from railslip_ctrl.model.numeric import numeric_plant, plant_parameters
from railslip_ctrl.sliding.code import generate, python_law
from railslip_ctrl.sliding.generate import LAW_FILE, generate_law, law_source
from railslip_ctrl.sliding.law import HOLD_TIME, KEPT, PUBLISHED_LAW, SOURCES, LawGains, gain_parameters
from railslip_ctrl.sliding.proof import sliding_symbol
from railslip_ctrl.sliding.sampled_law import DOMAIN_SHARE, LARGEST, OPTIONS

CASES = [("proportional", "bristle"), ("constant", None)]  # `make test` compiles; the others have the same printer
LONG_CASES = [*(("proportional", law) for law in (None, *ALL_LAWS) if law != "bristle"), ("constant", "bristle")]
CASES += (pytest.param(*case, marks=pytest.mark.long) for case in LONG_CASES)

ARGUMENTS = {
    **{"e": (-4.0, 4.0), "e_integral": (-3.0, 3.0), "omega": (1.0, 90.0), "Ta": (-6e3, 6e3), "v_rate": (-4.0, 1.0)},
    **{"theta1_hat": (-3e-4, 3e-4), "theta2_hat": (-0.01, 0.01)},
}


def options(generator):
    """Random options of the robust variants, limits that are met, and anti-windup."""
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
        state = begun(module, 20.0, p)
        for i in range(round(0.2 / period)):
            v = 20.0 - (i + 1) * period
            _, _, state = module.step(state, v, v / 0.43, 0.0, p)  # no slip: e = lambda_d v
        estimate = (v - state.v_filtered) / p.filter_time
        exact = -(1.0 - math.exp(-0.2 / 0.1))
        errors.append((abs(estimate - exact), abs(state.e_integral - 0.1 * (20.0 * 0.2 - 0.02))))
    assert np.array(errors[1]) == pytest.approx(np.array(errors[0]) / 2.0, rel=0.05)
    assert errors[1][0] < 3e-3


PLAIN = {"J": 60.35, "r": 0.43, "Mn": 3517.0, "Bn": 0.25, "lambda_d": 0.132}
MEASURED = (25.0, 53.0, 4000.0)  # m/s, rad/s, N*m: sigma = 2.21 m/s, e = 1.09 m/s


def stepped(given, **estimates):
    """(torque, s, new state) of one sample of the law without adhesion, SI, dry."""
    module = python_law(derive())
    values = PLAIN | {"filter_time": 0.1, "period": 0.01, "boundary": 0.0} | gain_parameters(PUBLISHED_LAW)
    p = module.Parameters(**values | {"torque_min": -LARGEST, "torque_max": LARGEST} | given)
    # init refuses the lower limit above 0 with which anti-windup is tested
    start = begun(module, MEASURED[0], p._replace(torque_min=-LARGEST))
    return module.step(start._replace(**estimates), *MEASURED, p)


def test_variants_of_the_adaptation() -> None:
    """Leak, dead zone and box as `robust` derives them, one Euler step by hand."""

    def after_a_step(gains):
        _, s, state = stepped(gain_parameters(gains), theta1_hat=3e-4, theta2_hat=-2e-3)
        return s, (state.theta1_hat, state.theta2_hat)

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
    with pytest.raises(InputError, match=r"box: 0\.1 \.\. 0\.1 of theta1_hat"):
        gain_parameters(replace(PUBLISHED_LAW, box=((0.1, 0.1), (0.0, 1.0))))


@pytest.mark.parametrize(("limit", "integral"), [("torque_max", False), ("torque_min", True)])
def test_anti_windup(limit, integral) -> None:
    """e > 0 raises the torque: at the upper limit the integral rests, at the lower it unwinds; the estimates rest."""
    free = stepped({})
    bound = free[0] - 100.0 if limit == "torque_max" else free[0] + 100.0
    rests = {"command": bound, "theta1_hat": 0.0, "theta2_hat": 0.0} | ({} if integral else {"e_integral": 0.0})
    assert stepped({limit: bound, "anti_windup": 1.0}) == (bound, free[1], free[2]._replace(**rests))
    # without it all of them go on, and off its limits it changes nothing
    assert stepped({limit: bound})[2] == free[2]._replace(command=bound)
    assert stepped({"anti_windup": 1.0}) == free


@pytest.fixture(scope="module")
def in_both_languages(tmp_path_factory):
    """The code of a law, its Python and its C, made once."""
    flags = sanitizer(tmp_path_factory.mktemp("flags"))

    @cache
    def made(adhesion, reference="proportional"):
        derivation = derive(reference=reference, law=adhesion)
        code = generate(derivation)
        return code, python_law(derivation), Compiled(code, tmp_path_factory.mktemp("law"), *flags)

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
        both = Both(made, row, float(generator.choice(EXTREMES)))
        for _ in range(60):
            measured = [float(generator.choice(EXTREMES)) for _ in law.measured]
            if generator.random() < 0.1:
                measured[int(generator.integers(len(measured)))] = float(generator.choice(NOT_FINITE))
            before, torque = both.state, both.step(*measured)
            assert both.p.torque_min <= torque <= both.p.torque_max
            assert max(map(abs, (torque, both.s, *both.state))) <= LARGEST
            if not all(map(math.isfinite, measured)):
                assert (both.s, both.state[:-3]) == (0.0, before[:-3])


@pytest.mark.parametrize("name", [None, *law_names()])
def test_c_has_no_allocation_no_loop_and_no_recursion(name) -> None:
    text = re.sub(r"/\*.*?\*/", "", generate(derive(law=name)).c, flags=re.S)
    for word in ("malloc", "calloc", "realloc", "free", "for", "while", "do", "goto"):
        assert not re.search(rf"\b{word}\b", text)
    functions = re.findall(r"\brailslip_asmc_(\w+)\([^;{]*\)\n\{(.*?)\n\}", text, flags=re.S)
    calls = {name: set(re.findall(r"\brailslip_asmc_(\w+)\(", body)) for name, body in functions}
    helpers = {"bounded", "reciprocal", "exponential", "limited"} & set(calls)
    assert set(calls) == {"switching", "init", "refused", "control", "valid", "step", *helpers}
    assert {"control", "valid", "bounded"} <= calls["step"] <= {"control", "valid", *helpers}
    assert {"switching", "bounded"} <= calls["control"] <= {"switching", *helpers}
    assert calls["init"] <= {"refused", "bounded"}
    assert not any(calls[name] for name in ("switching", "valid", "refused", *helpers))


def test_the_committed_law_is_what_the_derivation_gives(tmp_path, monkeypatch):
    """And depends on the sources that are hashed: all that is imported of `sliding` to derive and print it; where they
    have changed it is derived at once."""
    assert LAW_FILE.read_text(encoding="utf-8") == generate_law(), "run `make generate`"
    assert law_source() == generate(derive()).python
    program = "import sys, railslip_ctrl.sliding.code, railslip_ctrl.sliding.derivation\nprint(*sys.modules)"
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.split()
    hashed = {Path(name).stem for name in SOURCES if name.startswith("sliding/") and name.endswith(".py")}
    assert {name.rpartition(".")[2] for name in found if name.startswith("railslip_ctrl.sliding.")} == hashed
    stale = tmp_path / "sliding_law.py"
    stale.write_text(LAW_FILE.read_text(encoding="utf-8").replace("SHA-256 ", "SHA-256 0"), encoding="utf-8")
    monkeypatch.setattr("railslip_ctrl.sliding.generate.LAW_FILE", stale)
    monkeypatch.setattr("railslip_ctrl.sliding.generate._derived", lambda: "derived")
    assert law_source.__wrapped__() == "derived"


PERIOD = 1e-3  # s
V0 = 140.0 / 3.6  # m/s


def sanitizer(folder) -> tuple[str, ...]:
    """Flags with which undefined behaviour ends the program, where the compiler has them."""
    (folder / "empty.c").write_text("int main(void) { return 0; }\n")
    flags = ("-fsanitize=undefined", "-fno-sanitize-recover=all")
    done = subprocess.run([COMPILER, *flags, "empty.c", "-o", "empty"], cwd=folder, capture_output=True, check=False)
    return flags if done.returncode == 0 else ()


class Both:
    """The law in Python and in C, stepped together; what they say is asserted to be the same, and finite."""

    def __init__(self, made, row, v) -> None:
        self.code, self.module, self.compiled = made
        self.p, self.c = self.module.Parameters(*row), self.compiled.Parameters(*row)
        self.state, self.memory = begun(self.module, v, self.p), self.compiled.State()
        assert self.compiled.init(self.memory, v, self.c) == 0

    def step(self, *measured) -> float:
        torque, self.s, self.state = self.module.step(self.state, *measured, self.p)
        out = self.compiled.step(self.memory, *measured, self.c)
        assert same((out.torque, out.s, *fields(self.memory)), (torque, self.s, *self.state))
        assert all(map(math.isfinite, (torque, self.s, *self.state)))
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
        start = begun(inside, v, p)
        start = start._replace(z=z) if law.has_state else start
        expected = outside.step(begun(outside, v, q), v, omega, Ta, q)[0]
        assert inside.step(start, v, omega, p)[0] == pytest.approx(expected, rel=1e-9)


@needs_compiler
def test_a_sample_left_out_holds_the_command_for_a_time_and_then_releases(in_both_languages) -> None:
    law = published(in_both_languages(None), None, 25.0)
    sound = [25.0, 53.0, 4000.0]
    for wrong, place in itertools.product((math.nan, math.inf, -math.inf), range(3)):
        lost = [wrong if i == place else value for i, value in enumerate(sound)]
        assert not law.module.valid(*lost)
        assert law.compiled.valid(*lost) == 0
        held = law.step(*sound)
        assert 0.0 < held < 9000.0
        state = law.state
        torques = [law.step(*lost) for _ in range(300)]
        samples = torques.count(held)
        assert samples * PERIOD == pytest.approx(HOLD_TIME, abs=1.5 * PERIOD)  # a sum of periods is one more or less
        assert torques == [held] * samples + [0.0] * (300 - samples)
        assert law.state[: -len(KEPT)] == state[: -len(KEPT)]  # the law rests


@needs_compiler
def test_parameters_that_are_refused_name_themselves_and_keep_the_brake_released(in_both_languages) -> None:
    both = published(in_both_languages("lugre"), sample_law("lugre"), V0)
    names = both.code.law.parameters
    may_be_zero = {"Bn", "K", "k1", "k2", "boundary", "torque_min", "adhesion_alpha1", "adhesion_alpha2", *OPTIONS}
    above = {"lambda_d": 13.2, "torque_min": 10.0}  # a slip in per cent; a brake that cannot release
    for place, name in enumerate(names, 1):
        bad = [math.nan, math.inf, -math.inf, *([] if name in may_be_zero else [0.0, -1.0])]
        for value in bad + ([above[name]] if name in above else []):
            assert _refused(both, V0, {name: value}) == place, (name, value)
    assert _refused(both, math.nan, {}) == len(names) + 1
    assert _refused(both, V0, dict.fromkeys(names, 0.0)) == 1
    assert _refused(both, V0, dict.fromkeys(may_be_zero & set(names), 0.0)) == 0
    untouched = both.compiled.State()  # of static storage, without init
    assert both.compiled.step(untouched, V0, 70.0, both.c).torque == 0.0


def _refused(both, v, changed) -> int:
    """The code of init, the same in both languages; the step that follows a refusal."""
    row = [changed.get(name, value) for name, value in zip(both.p._fields, both.p, strict=True)]
    p, c, memory = both.module.Parameters(*row), both.compiled.Parameters(*row), both.compiled.State()
    code, state = both.module.init(v, p)
    assert both.compiled.init(memory, v, c) == code
    if code:
        assert both.module.step(state, V0, 70.0, p)[0] == both.compiled.step(memory, V0, 70.0, c).torque == 0.0
    return code
