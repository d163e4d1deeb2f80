"""The generated controller: Python against the derivation, C99 against the Python."""

from __future__ import annotations

import math
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from generated_code import Compiled, begun, fields, needs_compiler, parameters, same
from sample_laws import ALL_LAWS, sample_law

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.model.adhesion import law_names, published_law
from railslip_ctrl.model.kernels.compilation import module_of
from railslip_ctrl.model.parameters import PARK2008, Rail
from railslip_ctrl.sliding.code import generate, python_law
from railslip_ctrl.sliding.derivation import derive
from railslip_ctrl.sliding.law import LAW_FILE, PUBLISHED_LAW, SOURCES, gain_parameters, generate_law, law_source
from railslip_ctrl.sliding.proof import sliding_symbol
from railslip_ctrl.sliding.sampled_law import LARGEST, OPTIONS
from railslip_ctrl.verification import ideal_loop
from railslip_ctrl.verification.ideal_loop import STEP, Disturbances, simulate

REFERENCES = ("proportional", "constant")
CASES = [(reference, law) for law in (None, *ALL_LAWS) for reference in REFERENCES]

INPUTS = 10_000
SEQUENCES = 12  # four of each kind of parameters

ARGUMENTS = {
    **{"e": (-4.0, 4.0), "e_integral": (-3.0, 3.0), "omega": (1.0, 90.0), "Ta": (-6e3, 6e3), "v_rate": (-4.0, 1.0)},
    **{"theta1_hat": (-3e-4, 3e-4), "theta2_hat": (-0.01, 0.01)},
}


def options(generator):
    """Random options of the robust variants, limits that are met, and anti-windup."""
    box = {f"theta{i}_{side}": sign * generator.uniform(0.1, 1.0) * 1e-4 for i in (1, 2) for side, sign in SIDES}
    limits = {"torque_min": 0.0, "torque_max": generator.uniform(500.0, 4e3), "boundary": generator.uniform(0.05, 0.5)}
    flags = {"dead_zone": float(generator.integers(2)), "anti_windup": float(generator.integers(2))}
    return {**limits, **box, **flags, "leak": generator.uniform(0.0, 2.0)}


SIDES = (("min", -1.0), ("max", 1.0))


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
    symbols = [known.get(name, sp.Symbol(name)) for name in names]  # an option has no place in the paper's law
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


def test_torque_limits_and_no_further_state_changes() -> None:
    module = python_law(derive())
    values = parameters(generate(derive()), np.random.default_rng(1), None, torque_min=0.0, torque_max=100.0)
    p = module.Parameters(*values)
    state = begun(module, 25.0, p)
    assert module.step(state, 25.0, 25.0 / p.r, 5e3, p)[0] == 100.0
    assert module.step(state, 25.0, 10.0 / p.r, -9e4, p)[0] == 0.0
    assert state == begun(module, 25.0, p)  # a step gives a new state and leaves the old


# --- the robust variants in the sampled law -------------------------------------------------------------------------


def stepped(given, measured, state=None):
    """(torque, s, new state, parameters) of one sample of the law without adhesion, SI, dry."""
    module = python_law(derive())
    values = {"J": 60.35, "r": 0.43, "Mn": 3517.0, "Bn": 0.25, "lambda_d": 0.132, "filter_time": 0.1, "period": 0.01}
    values |= {
        "torque_min": -LARGEST,
        "torque_max": LARGEST,
        "boundary": 0.0,
        **gain_parameters(PUBLISHED_LAW),
        **given,
    }
    p = module.Parameters(**values)
    # init refuses the lower limit above 0 with which anti-windup is tested
    free = begun(module, measured[0], p._replace(torque_min=-LARGEST))
    return *module.step(state or free, *measured, p), p


def theta_hat(sample):
    return sample[2].theta1_hat, sample[2].theta2_hat


MEASURED = (25.0, 53.0, 4000.0)  # m/s, rad/s, N*m: sigma = 2.21 m/s, e = 1.09 m/s


def test_options_left_out_leave_the_papers_law() -> None:
    module = python_law(derive())
    assert module.Parameters._field_defaults == dict.fromkeys(OPTIONS, 0.0)
    _, s, state, p = stepped({}, MEASURED)
    assert state.theta1_hat == pytest.approx(0.01 * PUBLISHED_LAW.k1 * s * 4000.0, rel=1e-12)
    assert state.theta2_hat == pytest.approx(0.01 * PUBLISHED_LAW.k2 * s * 53.0, rel=1e-12)
    # the robust record without any variant gives the same parameters
    assert gain_parameters(PUBLISHED_LAW) == {name: getattr(p, name) for name in gain_parameters(PUBLISHED_LAW)}


def test_variants_of_the_adaptation() -> None:
    """Leak, dead zone and box as `robust` derives them, one Euler step by hand."""
    module = python_law(derive())
    start = begun(module, 25.0, stepped({}, MEASURED)[3])._replace(theta1_hat=3e-4, theta2_hat=-2e-3)
    gains = replace(PUBLISHED_LAW, layer=0.2, dead_zone=True, leak=0.7)
    _, s, state, _ = stepped(gain_parameters(gains), MEASURED, start)
    assert s > 0.2
    drive = s - 0.2
    assert state.theta1_hat == pytest.approx(3e-4 + 0.01 * (gains.k1 * drive * 4000.0 - 0.7 * 3e-4), rel=1e-12)
    assert state.theta2_hat == pytest.approx(-2e-3 + 0.01 * (gains.k2 * drive * 53.0 + 0.7 * 2e-3), rel=1e-12)
    # within the layer nothing drives the estimates
    wide = replace(PUBLISHED_LAW, layer=2.0, dead_zone=True)
    assert theta_hat(stepped(gain_parameters(wide), MEASURED, start)) == (3e-4, -2e-3)
    boxed = replace(PUBLISHED_LAW, box=((-1e-4, 1e-4), (-1e-3, 5e-3)))
    assert theta_hat(stepped(gain_parameters(boxed), MEASURED, start)) == (1e-4, -1e-3)
    with pytest.raises(InputError, match=r"box: 0\.1 \.\. 0\.1 of theta1_hat"):
        gain_parameters(replace(PUBLISHED_LAW, box=((0.1, 0.1), (0.0, 1.0))))


@pytest.mark.parametrize(("limit", "integral"), [("torque_max", False), ("torque_min", True)])
def test_anti_windup(limit, integral) -> None:
    """e > 0 raises the torque: at the upper limit the integral rests, at the lower it unwinds; the estimates rest."""
    free = stepped({}, MEASURED)
    bound = free[0] - 100.0 if limit == "torque_max" else free[0] + 100.0
    torque, s, state, _ = stepped({limit: bound, "anti_windup": 1.0}, MEASURED)
    assert (torque, s) == (bound, free[1])
    assert (state.theta1_hat, state.theta2_hat) == (0.0, 0.0)
    assert state.e_integral == (free[2].e_integral if integral else 0.0)
    assert state.v_filtered == free[2].v_filtered
    # without it all of them go on, and off its limits it changes nothing
    assert stepped({limit: bound}, MEASURED)[2] == free[2]._replace(command=bound)
    assert stepped({"anti_windup": 1.0}, MEASURED)[:3] == free[:3]


def test_anti_windup_shortens_the_overshoot_of_a_limited_brake() -> None:
    """A wheel without adhesion: the integral that grew at the limit must be paid back by e < 0."""
    overshoot = {}
    for flag in (0.0, 1.0):
        sigma, state, least = 0.0, None, 0.0
        for _ in range(4000):
            omega = (25.0 - sigma) / 0.43
            given = {"torque_max": 20.0, "torque_min": 0.0, "k1": 0.0, "k2": 0.0, "K": 0.0, "anti_windup": flag}
            torque, _, state, _ = stepped(given, (25.0, omega, 0.0), state)
            sigma += 0.01 * 0.43 / 60.35 * torque
            least = min(least, 0.132 * 25.0 - sigma)
        overshoot[flag] = -least
    assert overshoot[1.0] < 0.5 * overshoot[0.0]


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
    state, v, sigma = begun(module, 20.0, p), 20.0, 2.0
    for _ in range(2000):
        _, _, state = module.step(state, v, (v - sigma) / p.r, p)
    assert law.alpha * state.z == pytest.approx((law.gamma - sigma) / law.beta, rel=1e-9)


def test_the_ideal_loop_runs_the_generated_control(monkeypatch) -> None:
    """Its torque is what `control` says: with half of it in its place the loop's is half."""
    options = {"duration": 2 * STEP, "held_speed": 20.0, "start_estimate": (1e-5, 0.0)}
    whole = simulate(PARK2008, PUBLISHED_LAW, **options)
    text = ideal_loop.kernel_text(type(sample_law("bristle")), compiled=False)
    halved = text.replace("    return bounded(torque)", "    return 0.5 * bounded(torque)")
    assert halved != text
    monkeypatch.setattr(ideal_loop, "_kernel", lambda law: module_of(halved, compiled=False))
    half = simulate(PARK2008, PUBLISHED_LAW, **options)
    assert half.torque[0, 0] == 0.5 * whole.torque[0, 0] != 0.0


def test_the_law_of_the_ideal_loop_is_fed_the_measured_slip() -> None:
    """At rest Ta is the model's at the slip velocity with its noise, which s tells: s = slip v - sigma - noise."""
    noisy = Disturbances(slip_noise=0.05)
    run = simulate(PARK2008, PUBLISHED_LAW, duration=STEP, held_speed=20.0, disturbances=noisy, seeds=(3,))
    law, s = published_law("bristle", Rail.DRY), float(run.s[0, 0])
    slip = law.reference_slip(Rail.DRY)
    measured = slip * 20.0 - s
    assert abs(measured - run.sigma[0, 0]) > 0.01  # there is noise
    values = {"J": 60.35, "r": 0.43, "Mn": 3517.0, "Bn": 0.25, "lambda_d": slip}
    limits = {"torque_min": -LARGEST, "torque_max": LARGEST, "filter_time": 1.0, "period": STEP}
    module = python_law(derive())
    p = module.Parameters(**values, **limits, **gain_parameters(PUBLISHED_LAW))
    Ta = 0.43 * (law.gamma - measured) / law.beta
    torque, _, _, _ = module.control(s, 0.0, (20.0 - measured) / 0.43, Ta, 0.0, 0.0, 0.0, p)
    assert run.torque[0, 0] == pytest.approx(torque, rel=1e-12)


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_the_compiled_ideal_loop_is_the_interpreted_one(monkeypatch, noise) -> None:
    """A relay would drive rounding apart; without it the two arithmetics differ by rounding alone."""
    options = {"duration": 1.0, "disturbances": Disturbances(random_share=90 / 34_500, torque=True, slip_noise=noise)}
    gains = replace(PUBLISHED_LAW, K=0.0)
    compiled = simulate(PARK2008, gains, seeds=(1, 2), **options)
    text = ideal_loop.kernel_text(type(sample_law("bristle")), compiled=False)
    monkeypatch.setattr(ideal_loop, "_kernel", lambda law: module_of(text, compiled=False))
    interpreted = simulate(PARK2008, gains, seeds=(1, 2), **options)
    for name, values in vars(interpreted).items():
        size = np.max(np.abs(values))
        assert np.max(np.abs(getattr(compiled, name) - values)) <= 1e-12 * size, name  # 500 steps of 1e-16


def test_the_ideal_loop_adapts_as_the_generated_step() -> None:
    """Leak, dead zone and box of one record in the simulated loop and in `step`, from the same start."""
    gains = replace(PUBLISHED_LAW, layer=0.01, dead_zone=True, leak=0.4, box=((-2e-5, 2e-5), (-1.0, 1.0)))
    start = (3e-5, 0.01)
    run = simulate(PARK2008, gains, duration=2 * STEP, held_speed=20.0, start_estimate=start)
    law, sigma = published_law("bristle", Rail.DRY), run.sigma[0, 0]
    values = {"J": 60.35, "r": 0.43, "Mn": 3517.0, "Bn": 0.25, "lambda_d": law.reference_slip(Rail.DRY)}
    module = python_law(derive())
    limits = {"torque_min": -LARGEST, "torque_max": LARGEST, "filter_time": 1.0, "period": STEP}
    p = module.Parameters(**values, **limits, **gain_parameters(gains))
    state = begun(module, 20.0, p)._replace(theta1_hat=start[0], theta2_hat=start[1])
    Ta = 0.43 * (law.gamma - sigma) / law.beta
    _, s, state = module.step(state, 20.0, (20.0 - sigma) / 0.43, Ta, p)
    assert s == pytest.approx(run.s[0, 0], abs=1e-12)
    assert (state.theta1_hat, state.theta2_hat) == pytest.approx(tuple(run.theta_hat[1, 0]), rel=1e-12)
    assert state.theta1_hat == 2e-5


# --- C against Python ----------------------------------------------------------------------------------------------


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
    """Sequences of 200 samples at random measurements, states included; `control` is tested with 1e4 inputs."""
    derivation = derive(reference=reference, law=adhesion)
    code = generate(derivation)
    module, compiled = python_law(derivation), Compiled(code, tmp_path)
    inside = adhesion if code.law.measured == ("v", "omega") else None
    generator = np.random.default_rng(123)
    for run in range(SEQUENCES):
        given = ({}, {"torque_min": 0.0, "torque_max": 8e3, "boundary": 0.3}, options(generator))[run % 3]
        p = parameters(code, generator, inside, **given)
        mine, theirs = module.Parameters(*p), compiled.Parameters(*p)
        v = generator.uniform(5.0, 38.0)
        state, memory = begun(module, v, mine), compiled.begun(v, theirs)
        for _ in range(200):
            v = max(1.0, v + generator.uniform(-0.1, 0.02))
            omega = v * (1.0 - generator.uniform(0.005, 0.4)) / mine.r
            measured = [{"v": v, "omega": omega, "Ta": generator.uniform(0.0, 6e3)}[name] for name in code.law.measured]
            torque, s, state = module.step(state, *measured, mine)
            out = compiled.step(memory, *measured, theirs)
            assert same((out.torque, out.s), (torque, s))
            assert same(fields(memory), state)
            assert all(map(math.isfinite, (torque, s, *state)))


EXTREMES = (0.0, -0.0, 5e-324, 1e-300, -1e-160, 1.0, -3.0, 80.0, 1e12, -1e13, 1e100, -1e200, 1.7e308, -1.7e308)
NOT_FINITE = (math.nan, math.inf, -math.inf)


@needs_compiler
@pytest.mark.parametrize("adhesion", [None, *ALL_LAWS])
def test_measurements_of_any_size_give_the_same_finite_numbers(adhesion, tmp_path) -> None:
    derivation = derive(law=adhesion)
    code = generate(derivation)
    module, compiled = python_law(derivation), Compiled(code, tmp_path)
    inside = adhesion if code.law.measured == ("v", "omega") else None
    generator = np.random.default_rng(5)
    for run in range(40):
        p = parameters(code, generator, inside, **(options(generator) if run % 2 else {}))
        mine, theirs = module.Parameters(*p), compiled.Parameters(*p)
        v = float(generator.choice(EXTREMES))
        state, memory = begun(module, v, mine), compiled.begun(v, theirs)
        for _ in range(60):
            measured = [float(generator.choice(EXTREMES)) for _ in code.law.measured]
            if generator.random() < 0.1:
                measured[int(generator.integers(len(measured)))] = float(generator.choice(NOT_FINITE))
            before = state
            torque, s, state = module.step(state, *measured, mine)
            out = compiled.step(memory, *measured, theirs)
            assert all(map(math.isfinite, (torque, s, *state)))
            assert mine.torque_min <= torque <= mine.torque_max
            assert max(map(abs, (torque, s, *state))) <= LARGEST
            if not all(map(math.isfinite, measured)):
                assert s == 0.0
                assert state[:-3] == before[:-3]
            # rounding of terms of 1e12 that cancel is the languages' own, unless both sum in the same order: they do
            assert same((out.torque, out.s), (torque, s))
            assert same(fields(memory), state)


@needs_compiler
def test_control_of_anything_is_the_same_number(tmp_path) -> None:
    code, module = generate(derive()), python_law(derive())
    compiled = Compiled(code, tmp_path)
    generator = np.random.default_rng(6)
    for _ in range(2000):
        # parameters too: K and D large enough that terms of the torque overflow, to both signs
        zero = dict.fromkeys(generator.choice(("J", "r", "Mn", "rho"), int(generator.integers(2))), 0.0)
        large = {name: 10.0 ** generator.uniform(0, 308) for name in ("D", "K")}
        p = parameters(code, generator, None, **large, **zero)
        arguments = [float(generator.choice((*EXTREMES, *NOT_FINITE))) for _ in code.law.control_arguments]
        expected = module.control(*arguments, module.Parameters(*p))
        out = compiled.control(*arguments, compiled.Parameters(*p))
        assert all(map(math.isfinite, expected))
        assert same((out.torque, out.s, out.theta1_hat_rate, out.theta2_hat_rate), expected)


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
    functions = {name.removeprefix("railslip_asmc_"): body for name, body in functions.items()}
    calls = {name: set(re.findall(r"\brailslip_asmc_(\w+)\(", body)) for name, body in functions.items()}
    helpers = {"bounded", "reciprocal", "exponential", "limited"} & set(functions)
    assert set(functions) == {"switching", "init", "refused", "control", "valid", "step", *helpers}
    assert {"control", "valid", "bounded"} <= calls["step"] <= {"control", "valid", *helpers}
    assert {"switching", "bounded"} <= calls["control"] <= {"switching", *helpers}
    assert calls["init"] <= {"refused", "bounded"}
    assert not any(calls[name] for name in ("switching", "valid", "refused", *helpers))


# --- the committed law -----------------------------------------------------------------------------------------------


def test_the_committed_law_is_what_the_derivation_gives():
    assert LAW_FILE.read_text(encoding="utf-8") == generate_law(), "run `make generate`"
    assert law_source() == generate(derive()).python


def test_the_committed_law_depends_on_the_sources_that_are_hashed():
    """All of the package's SymPy that is imported to derive and print the law, and nothing else of `sliding`."""
    program = (
        "import sys, railslip_ctrl.sliding.code_python, railslip_ctrl.sliding.derivation as d\n"
        "names = [n for n in sys.modules if n.startswith('railslip_ctrl.sliding.')]\n"
        "print(*sorted(n.rpartition('.')[2] for n in names))"
    )
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.split()
    hashed = {name.removeprefix("sliding/").removesuffix(".py") for name in SOURCES if name.startswith("sliding/")}
    assert set(found) - {"gains", "erratum"} == hashed


def test_a_law_whose_sources_have_changed_is_derived_at_once(tmp_path, monkeypatch):
    stale = tmp_path / "sliding_law.py"
    stale.write_text(LAW_FILE.read_text(encoding="utf-8").replace("SHA-256 ", "SHA-256 0"), encoding="utf-8")
    monkeypatch.setattr("railslip_ctrl.sliding.law.LAW_FILE", stale)
    monkeypatch.setattr("railslip_ctrl.sliding.law._derived", lambda: "derived")
    assert law_source.__wrapped__() == "derived"
