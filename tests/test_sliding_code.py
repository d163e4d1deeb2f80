"""The generated controller: Python against the derivation, C99 against the Python."""

from __future__ import annotations

import ctypes
import math
import re
import shutil
import subprocess

import numpy as np
import pytest
import sympy as sp
from sample_laws import ALL_LAWS, sample_law

from railslip_ctrl.adhesion import law_names
from railslip_ctrl.sliding.code import generate, python_law
from railslip_ctrl.sliding.derivation import derive
from railslip_ctrl.sliding.symbols import sliding_symbol

COMPILER = shutil.which("cc")
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler (cc) on this system")
FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2")
REFERENCES = ("proportional", "constant")
CASES = [(reference, law) for law in (None, *ALL_LAWS) for reference in REFERENCES]

INPUTS = 10_000

RANGES = {
    **{"J": (20.0, 900.0), "r": (0.3, 0.6), "Mn": (1500.0, 2e4), "Bn": (0.0, 1.0), "lambda_d": (0.02, 0.3)},
    **{"sigma_d": (0.1, 5.0), "rho": (0.1, 5.0), "D": (0.1, 500.0), "K": (1.0, 3000.0), "k1": (1e-10, 1e-7)},
    **{"k2": (1e-8, 1e-5), "filter_time": (0.01, 0.5), "N": (2e4, 6e4), "period": (1e-3, 0.05)},
}
ARGUMENTS = {
    **{"e": (-4.0, 4.0), "e_integral": (-3.0, 3.0), "omega": (1.0, 90.0), "Ta": (-6e3, 6e3), "v_rate": (-4.0, 1.0)},
    **{"theta1_hat": (-3e-4, 3e-4), "theta2_hat": (-0.01, 0.01)},
}


def parameters(code, generator, adhesion, **given):
    """Random parameters; the adhesion law's own; no boundary layer and no limits unless given."""
    values = {"boundary": 0.0, "torque_min": -math.inf, "torque_max": math.inf}
    for name in code.law.parameters:
        if name in RANGES:
            values[name] = generator.uniform(*RANGES[name])
    if adhesion is not None:
        law = sample_law(adhesion)
        named = zip(type(law).parameter_names(), law.parameters(), strict=True)
        values |= {f"adhesion_{name}": value for name, value in named}
    return [{**values, **given}[name] for name in code.law.parameters]


# --- Python against the derivation ---------------------------------------------------------------------------------


@pytest.mark.parametrize("reference", REFERENCES)
def test_control_is_the_derived_law(reference) -> None:
    derivation = derive(reference=reference)
    module, law = python_law(derivation), generate(derivation).law
    generator = np.random.default_rng(7)
    s = sliding_symbol("s")
    names = [*law.control_arguments, *law.parameters]
    expressions = (derivation.adaptive_law_control.subs(s, derivation.s), derivation.s)
    rates = (rate.subs(s, derivation.s) for rate in derivation.adaptation_matrix)
    known = {str(x): x for e in (*expressions, *derivation.adaptation_matrix) for x in e.free_symbols}
    symbols = [known.get(name, sp.Symbol(name)) for name in names]
    reference_law = sp.lambdify(symbols, (*expressions, *rates), "math")
    for _ in range(300):
        p = parameters(generate(derivation), generator, None)
        arguments = [generator.uniform(*ARGUMENTS[name]) for name in law.control_arguments]
        expected = reference_law(*arguments, *p)
        assert module.control(*arguments, module.Parameters(*p)) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_switching() -> None:
    switching = python_law(derive()).switching
    assert [switching(s, 0.0) for s in (-2.0, 0.0, 3.0)] == [-1.0, 0.0, 1.0]
    assert [switching(s, 2.0) for s in (-5.0, -1.0, 0.0, 1.0, 5.0)] == [-1.0, -0.5, 0.0, 0.5, 1.0]


def test_filter_and_integral_converge_to_the_continuous_ones() -> None:
    """v falls by 1 m/s^2: the estimate tends to -1 as s/(tau s + 1) does, the integral to that of e; first order."""
    derivation = derive()
    module = python_law(derivation)
    errors = []
    for period in (2e-3, 1e-3):
        values = dict.fromkeys(module.Parameters._fields, 0.0)
        values |= {"J": 60.0, "r": 0.43, "Mn": 3517.0, "lambda_d": 0.1, "rho": 1.0, "torque_max": math.inf}
        p = module.Parameters(**{**values, "filter_time": 0.1, "period": period})
        state = module.start(20.0)
        for i in range(round(0.2 / period)):
            v = 20.0 - (i + 1) * period
            _, _, state = module.step(state, v, v / 0.43, 0.0, p)  # no slip: e = lambda_d v
        estimate = (v - state.v_filtered) / p.filter_time
        exact = -(1.0 - math.exp(-0.2 / 0.1))
        errors.append((abs(estimate - exact), abs(state.e_integral - 0.1 * (20.0 * 0.2 - 0.02))))
    assert np.array(errors[1]) == pytest.approx(np.array(errors[0]) / 2.0, rel=0.05)
    assert errors[1][0] < 3e-3


def test_torque_limits_and_no_further_state_changes() -> None:
    module = python_law(derive())
    values = parameters(generate(derive()), np.random.default_rng(1), None, torque_min=0.0, torque_max=100.0)
    p = module.Parameters(*values)
    state = module.start(25.0)
    assert module.step(state, 25.0, 25.0 / p.r, 5e3, p)[0] == 100.0
    assert module.step(state, 25.0, 10.0 / p.r, -9e4, p)[0] == 0.0
    assert state == module.start(25.0)  # a step gives a new state and leaves the old


@pytest.mark.parametrize("name", law_names())
def test_adhesion_in_the_code_or_said_to_be_outside(name) -> None:
    code = generate(derive(law=name))
    inside = code.law.measured == ("v", "omega")
    assert inside is (f"Ta comes from the adhesion law {name!r}" in code.c)
    assert inside is not ("no closed form" in code.c)
    assert inside is any(parameter.startswith("adhesion_") for parameter in code.law.parameters)


def test_bristle_state_settles_where_the_law_is_at_rest() -> None:
    derivation = derive(law="bristle")
    module, law = python_law(derivation), sample_law("bristle")
    values = parameters(generate(derivation), np.random.default_rng(3), "bristle", period=0.01)
    p = module.Parameters(*values)
    state, v, sigma = module.start(20.0), 20.0, 2.0
    for _ in range(2000):
        _, _, state = module.step(state, v, (v - sigma) / p.r, p)
    assert law.alpha * state.z == pytest.approx((law.gamma - sigma) / law.beta, rel=1e-9)


# --- C against Python ----------------------------------------------------------------------------------------------


class Compiled:
    """The C source as a shared object, called through ctypes."""

    def __init__(self, code, folder) -> None:
        source, target = folder / "law.c", folder / "law.so"
        source.write_text(code.c)
        command = [COMPILER, *FLAGS, "-shared", "-fPIC", "-o", target, source, "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")
        library = ctypes.CDLL(str(target))
        law = code.law
        self.Parameters = _structure(law.parameters)
        self.State = _structure(law.states)
        output = _structure(("torque", "s", "theta1_hat_rate", "theta2_hat_rate"))
        pointer = ctypes.POINTER
        self.start = library.railslip_asmc_start
        self.start.argtypes, self.start.restype = [pointer(self.State), ctypes.c_double], None
        self.control = library.railslip_asmc_control
        self.control.argtypes = [ctypes.c_double] * len(law.control_arguments) + [pointer(self.Parameters)]
        self.step = library.railslip_asmc_step
        self.step.argtypes = [pointer(self.State)] + [ctypes.c_double] * len(law.measured) + [pointer(self.Parameters)]
        self.control.restype = self.step.restype = output


def _structure(fields):
    return type("Structure", (ctypes.Structure,), {"_fields_": [(name, ctypes.c_double) for name in fields]})


def same(left, right) -> bool:
    """Equal to 1e-12, relative to the size where that is above 1."""
    return all(abs(a - b) <= 1e-12 * max(1.0, abs(a), abs(b)) for a, b in zip(left, right, strict=True))


@needs_compiler
@pytest.mark.parametrize("reference", REFERENCES)
def test_c_control_is_the_python_s(reference, tmp_path) -> None:
    code = generate(derive(reference=reference))
    module, compiled = python_law(derive(reference=reference)), Compiled(code, tmp_path)
    generator = np.random.default_rng(99)
    for i in range(INPUTS):
        boundary = 0.0 if i % 2 else generator.uniform(0.01, 2.0)
        p = parameters(code, generator, None, boundary=boundary)
        arguments = [generator.uniform(*ARGUMENTS[name]) for name in code.law.control_arguments]
        out = compiled.control(*arguments, compiled.Parameters(*p))
        expected = module.control(*arguments, module.Parameters(*p))
        assert same((out.torque, out.s, out.theta1_hat_rate, out.theta2_hat_rate), expected)


@needs_compiler
@pytest.mark.parametrize(("reference", "adhesion"), CASES)
def test_c_sequences_are_the_python_s(reference, adhesion, tmp_path) -> None:
    """Sequences of 200 samples at random measurements, states included, 1e4 samples a case."""
    derivation = derive(reference=reference, law=adhesion)
    code = generate(derivation)
    module, compiled = python_law(derivation), Compiled(code, tmp_path)
    inside = adhesion if code.law.measured == ("v", "omega") else None
    generator = np.random.default_rng(123)
    for run in range(INPUTS // 200):
        limits = {} if run % 2 else {"torque_min": 0.0, "torque_max": 8e3, "boundary": 0.3}
        p = parameters(code, generator, inside, **limits)
        mine, theirs = module.Parameters(*p), compiled.Parameters(*p)
        v = generator.uniform(5.0, 38.0)
        state, memory = module.start(v), compiled.State()
        compiled.start(memory, v)
        for _ in range(200):
            v = max(1.0, v + generator.uniform(-0.1, 0.02))
            omega = v * (1.0 - generator.uniform(0.005, 0.4)) / mine.r
            measured = [{"v": v, "omega": omega, "Ta": generator.uniform(0.0, 6e3)}[name] for name in code.law.measured]
            torque, s, state = module.step(state, *measured, mine)
            out = compiled.step(memory, *measured, theirs)
            assert same((out.torque, out.s), (torque, s))
            assert same([getattr(memory, name) for name in code.law.states], state)
            assert all(map(math.isfinite, (torque, s, *state)))


@needs_compiler
@pytest.mark.parametrize("name", law_names())
def test_c_of_every_law_compiles_without_a_warning(name, tmp_path) -> None:
    Compiled(generate(derive(law=name)), tmp_path)


@pytest.mark.parametrize("name", [None, *law_names()])
def test_c_has_no_allocation_no_loop_and_no_recursion(name) -> None:
    text = re.sub(r"/\*.*?\*/", "", generate(derive(law=name)).c, flags=re.S)
    for word in ("malloc", "calloc", "realloc", "free", "for", "while", "do", "goto"):
        assert not re.search(rf"\b{word}\b", text)
    functions = dict(re.findall(r"\b(railslip_asmc_\w+)\([^;{]*\)\n\{(.*?)\n\}", text, flags=re.S))
    assert set(functions) == {f"railslip_asmc_{part}" for part in ("switching", "start", "control", "step")}
    calls = {name: set(re.findall(r"\b(railslip_asmc_\w+)\(", body)) for name, body in functions.items()}
    assert calls["railslip_asmc_step"] == {"railslip_asmc_control"}
    assert calls["railslip_asmc_control"] == {"railslip_asmc_switching"}
    assert calls["railslip_asmc_switching"] == calls["railslip_asmc_start"] == set()
