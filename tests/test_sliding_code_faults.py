"""The generated controller where something is wrong: a locked wheel, samples that are no numbers, bad parameters.

In Python and in C at once: each test runs both and compares them.
"""

from __future__ import annotations

import hashlib
import itertools
import math
import subprocess
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from generated_code import COMPILER, Compiled, begun, fields, needs_compiler, parameters, same
from sample_laws import ALL_LAWS, DYNAMIC_LAWS, sample_law

import railslip_ctrl
from railslip_ctrl.model.adhesion import law_class, law_names, load_law, published_law
from railslip_ctrl.model.numeric import numeric_plant, plant_parameters
from railslip_ctrl.model.parameters import PARK2008, Rail
from railslip_ctrl.sliding.code import generate, law_numbers, python_law, with_numbers
from railslip_ctrl.sliding.code_python import NOT_HOLDING
from railslip_ctrl.sliding.derivation import derive
from railslip_ctrl.sliding.law import HOLD_TIME, KEPT, PUBLISHED_LAW, gain_parameters
from railslip_ctrl.sliding.sampled_law import DOMAIN_SHARE, OPTIONS

PERIOD = 1e-3  # s
V0 = 140.0 / 3.6  # m/s


def sanitizer(folder) -> tuple[str, ...]:
    """Flags with which undefined behaviour ends the program, where the compiler has them."""
    (folder / "empty.c").write_text("int main(void) { return 0; }\n")
    flags = ("-fsanitize=undefined", "-fno-sanitize-recover=all")
    done = subprocess.run([COMPILER, *flags, "empty.c", "-o", "empty"], cwd=folder, capture_output=True, check=False)
    return flags if done.returncode == 0 else ()


class Both:
    """The law in Python and in C, stepped together; what they say is asserted to be the same."""

    def __init__(self, adhesion, folder, v) -> None:
        derivation = derive(law=adhesion)
        self.code, self.module = generate(derivation), python_law(derivation)
        self.compiled = Compiled(self.code, folder, *sanitizer(folder))
        values = {"J": 60.35, "r": 0.43, "Mn": 3517.0, "Bn": 0.25, "lambda_d": 0.132, "N": 34_500.0}
        values |= {"filter_time": 0.05, "period": PERIOD, "torque_min": 0.0, "torque_max": 9000.0}
        values |= dict.fromkeys(OPTIONS, 0.0) | gain_parameters(PUBLISHED_LAW) | {"anti_windup": 1.0}
        if adhesion is not None:
            law = published_law("bristle", Rail.DRY, 140.0) if adhesion == "bristle" else sample_law(adhesion)
            named = zip(type(law).parameter_names(), law.parameters(), strict=True)
            values |= {f"adhesion_{name}": value for name, value in named}
            self.adhesion = law
        row = [values[name] for name in self.code.law.parameters]
        self.p, self.c = self.module.Parameters(*row), self.compiled.Parameters(*row)
        self.state, self.memory = begun(self.module, v, self.p), self.compiled.begun(v, self.c)

    def step(self, *measured) -> float:
        torque, s, self.state = self.module.step(self.state, *measured, self.p)
        out = self.compiled.step(self.memory, *measured, self.c)
        assert same((out.torque, out.s, *fields(self.memory)), (torque, s, *self.state))
        return torque

    def run(self, seconds, v, omega) -> np.ndarray:
        """Torques, N*m, at constant measurements."""
        return np.array([self.step(v, omega) for _ in range(round(seconds / PERIOD))])


# --- a locked wheel --------------------------------------------------------------------------------------------------


@needs_compiler
def test_a_wheel_that_has_locked_is_released_and_braked_again(tmp_path) -> None:
    """The bristle law at 140 km/h, where gamma is 116 km/h: beyond it z grew to 1e12 and the brake stayed full."""
    law = Both("bristle", tmp_path, V0)
    turning = (1.0 - 0.132) * V0 / 0.43
    before = law.run(1.0, V0, turning)[-1]
    Fs = law.adhesion.gamma / law.adhesion.beta
    largest = Fs / law.adhesion.alpha
    assert 3000.0 < before < 5000.0  # some 0.9 of r Fs: the bristles are bent
    torques = []
    for i in range(500):
        torques.append(law.step(V0, math.nan if 200 <= i < 350 else 0.0))  # the sensor fails as well
        assert 0.0 <= law.state.z <= largest
    assert max(torques) == 0.0  # from the first sample on
    assert law.state.z == pytest.approx((1.0 - DOMAIN_SHARE) * largest, rel=1e-6)  # at rest at the end of the domain
    # z relaxes to (gamma - sigma)/(alpha beta) with the rate alpha beta sigma/(gamma - sigma), 6.6 1/s here
    sigma = V0 - 0.43 * turning
    rate = law.adhesion.alpha * law.adhesion.beta * sigma / (law.adhesion.gamma - sigma)
    rest, started = (law.adhesion.gamma - sigma) * largest / law.adhesion.gamma, law.state.z
    after = law.run(0.5, V0, turning)
    expected = rest + (started - rest) * math.exp(-0.5 * rate)
    assert law.state.z == pytest.approx(expected, rel=5e-3)  # backward Euler, 1 ms: h rate^2 t/2 = 0.01 of 4 %
    assert after.max() < 9000.0
    assert after[-1] == pytest.approx(before, rel=0.05)  # within 0.5 s


@needs_compiler
@pytest.mark.parametrize("adhesion", DYNAMIC_LAWS)
def test_no_slip_moves_the_adhesion_state_beyond_its_bound(adhesion, tmp_path) -> None:
    """Locked, spinning ahead, in jumps: |z| <= Fs/alpha, and a torque that is finite and within its limits."""
    law = Both(adhesion, tmp_path, V0)
    law.state, law.memory.z = law.state._replace(z=1e9), 1e9  # memory that is damaged
    bound = float(_on_parameters(law.adhesion, law_class(adhesion).statement().state_limit))
    generator = np.random.default_rng(4)
    for _ in range(2000):
        v = generator.uniform(0.0, 45.0)
        assert 0.0 <= law.step(v, v / 0.43 * generator.choice([0.0, 1.0, 2.0, -1.0])) <= 9000.0
        assert abs(law.state.z) <= bound * (1 + 1e-12)


@pytest.mark.parametrize("adhesion", DYNAMIC_LAWS)
def test_the_bound_of_the_adhesion_state_is_what_rest_states_reach(adhesion) -> None:
    law, statement = sample_law(adhesion), law_class(adhesion).statement()
    limit = 100.0 if statement.sigma_limit is None else float(_on_parameters(law, statement.sigma_limit))
    sigma = np.concatenate([np.geomspace(1e-12, 1.0, 200), np.linspace(1.0, DOMAIN_SHARE * limit, 200)])
    rest = numeric_plant(type(law)).rest_state
    p = plant_parameters(law, PARK2008)
    reached = max(abs(float(rest(30.0, x, 0.0, 0.0, 0.0, 0.0, p))) for x in (*sigma, *-sigma))
    assert reached == pytest.approx(float(_on_parameters(law, statement.state_limit)), rel=1e-5)
    assert law.domain_limit(30.0)[0] * 30.0 == pytest.approx(math.inf if limit == 100.0 else limit)


def _on_parameters(law, expression):
    return expression.subs(dict(zip(type(law).symbols(), law.parameters(), strict=True)))


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


# --- samples that are no numbers -------------------------------------------------------------------------------------


@needs_compiler
def test_a_sample_left_out_holds_the_command_for_a_time_and_then_releases(tmp_path) -> None:
    law = Both(None, tmp_path, 25.0)
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


# --- parameters that are refused -------------------------------------------------------------------------------------


@needs_compiler
def test_parameters_that_are_refused_name_themselves_and_keep_the_brake_released(tmp_path) -> None:
    both = Both("lugre", tmp_path, V0)
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


# --- what is read ----------------------------------------------------------------------------------------------------


@cache
def texts():
    return {name: generate(derive(law=name)) for name in (None, *law_names())}


def test_lines_are_shorter_than_100_characters() -> None:
    for name, code in texts().items():
        for text in (code.python, code.c):
            assert max(map(len, text.splitlines())) < 100, name


def test_the_head_tells_where_the_code_comes_from_and_what_does_not_hold(tmp_path) -> None:
    for name, code in texts().items():
        heads = {"python": code.python.split('"""')[1], "c": code.c.split("*/")[0]}
        for head in heads.values():
            told = " ".join(head.replace("\n *", "\n").split())
            assert f"railslip_ctrl {railslip_ctrl.__version__}" in told
            assert all(f"- {one} " in told for one in NOT_HOLDING)
            assert f"held for {HOLD_TIME:g} s" in told
            assert "Units: SI" in told
            if name is not None and code.law.measured == ("v", "omega"):
                path = Path(railslip_ctrl.__file__).parent / "model" / "adhesion" / f"{name}.py"
                assert f"{name}.py, SHA-256 {hashlib.sha256(path.read_bytes()).hexdigest()}" in told
            assert ("its state z" in told) == (name in DYNAMIC_LAWS)
    assert "double adhesion_alpha; /* stiffness of the bristles, N/m */" in texts()["bristle"].c
    file = tmp_path / "leaves.toml"
    file.write_text('law = "burckhardt"\n[parameters]\nc1 = 0.20\nc2 = 18.0\nc3 = 0.08\n')
    derivation = derive(law="burckhardt")
    code = with_numbers(generate(derivation), law_numbers(derivation, load_law(file)), file)
    for text in (code.python, code.c):
        assert f"leaves.toml, SHA-256 {hashlib.sha256(file.read_bytes()).hexdigest()}" in text
