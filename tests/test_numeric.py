"""The plant's statement, the functions generated from it, and its operating points and linear plants."""

import itertools
import math
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import control as ct
import mpmath
import numpy as np
import pytest
import sympy as sp
from sample_laws import ALL_LAWS, DYNAMIC_LAWS, sample_law

from railslip_ctrl import PARK2008, DomainError, InputError, KinkError, Rail, published_law
from railslip_ctrl.core.notation import NOTATION, latex_names, symbol
from railslip_ctrl.core.units import KMH, quantity
from railslip_ctrl.model import numeric as written
from railslip_ctrl.model import plant
from railslip_ctrl.model.adhesion import AdhesionLaw, law_class, law_names
from railslip_ctrl.model.adhesion.base import Statement
from railslip_ctrl.model.adhesion.burckhardt import Burckhardt
from railslip_ctrl.model.adhesion.curve import curve_force
from railslip_ctrl.model.adhesion.lugre import Dahl
from railslip_ctrl.model.kernels import module_of, module_text
from railslip_ctrl.model.linearization import linearize, linearize_rolling, nonlinear_plant, operating_point
from railslip_ctrl.model.numeric import adhesion_coefficient, adhesion_table, has_table, numeric_plant, plant_parameters
from railslip_ctrl.model.vehicle import Resistance
from railslip_ctrl.sliding import generate as sliding

# all terms of the resistance at work
VEHICLE = PARK2008.model_copy(update={"resistance": Resistance(constant=210.0, linear=13.0, quadratic=0.63)})
v, sigma, z, Fa, Tb, Td, Tr, M, J, B, r = map(symbol, ["v", "sigma", "z", "Fa", "Tb", "Td", "Tr", "M", "J", "B", "r"])
RESISTANCE = sum(symbol(f"Fr{power}") * v**power for power in range(3))


def states(law: AdhesionLaw, count: int, seed: int) -> np.ndarray:
    """Rows (v, sigma, z, Tb, Td, Tr), slips of both signs within the law's domain."""
    rng = np.random.default_rng(seed)
    speed = rng.uniform(1.5, 27.0, count)
    most = np.array([min(0.95, 0.95 * law.domain_limit(one)[0]) for one in speed])
    slip = rng.uniform(0.005, 1.0, count) * most * rng.choice([-1.0, 1.0], count)
    torques = rng.uniform(-1.0, 1.0, (3, count)) * np.array([[2e4], [500.0], [400.0]])
    return np.stack([speed, slip * speed, rng.uniform(-0.6, 0.6, count), *torques], axis=1)


def flat(value: object) -> list[object]:
    return [item for part in value for item in flat(part)] if isinstance(value, tuple) else [value]


def test_the_motion_is_that_of_3_and_4() -> None:
    """sigma' = -(1/M + r^2/J) Fa + (r/J)(Tb + Td + B omega) - Fr/M, plus Tr as it enters [Park2008] (35); energy."""
    motion, omega = plant.motion(), (v - sigma) / r
    expected = -(1 / M + r**2 / J) * Fa + r / J * (Tb + Td + B * omega) - RESISTANCE / M - (1 / (r * M) + r / J) * Tr
    assert sp.simplify(motion.sigma_rate - expected) == 0
    power = M * v * motion.v_rate + J * omega * motion.omega_rate  # d/dt (M v^2/2 + J omega^2/2)
    losses = Fa * sigma + RESISTANCE * v + (Tb + Td + B * omega) * omega + Tr * sigma / r
    assert sp.simplify(power + losses) == 0
    assert sp.simplify(motion.slip_rate.subs(Tb, plant.trim_torque())) == 0
    # [Park2008] p. 55: the lag's state equation has Ga's rational part as its transfer function
    s, tau, Tc = (symbol(name) for name in ("s", "tau", "Tc"))
    lag = sp.solve(sp.Eq(s * Tb, plant.actuator_lag_rate()), Tb)[0] / Tc
    assert sp.simplify(lag * sp.exp(-tau * s) - plant.actuator_transfer()) == 0
    assert set(plant.ARGUMENTS) | set(plant.VEHICLE_PARAMETERS) <= set(NOTATION)
    assert sp.latex(plant.WHEEL.lhs, symbol_names=latex_names()) == r"J \dot\omega"
    assert {name for name, entry in NOTATION.items() if entry.positive} == {*"vNMJrT", "tau"}


@pytest.mark.parametrize("name", ALL_LAWS)
def test_laws_are_odd_and_rest_states_at_rest(name: str) -> None:
    law, positive = law_class(name), sp.Symbol("sigma_p", positive=True)
    closed = plant.close(law)
    known = {symbol(n) for n in (*plant.ARGUMENTS, *plant.VEHICLE_PARAMETERS)} | set(law.symbols())
    for expression in (closed.force, closed.rest_state, closed.trim_torque, *closed.rates):
        assert expression.free_symbols <= known
    if name != "curve":  # a numeric function, of which test_laws has it
        for expression in (closed.force, closed.rates[2]):
            mirrored = expression.subs({sigma: -positive, z: -z}, simultaneous=True)
            assert sp.simplify(sp.piecewise_fold(mirrored + expression.subs(sigma, positive))) == 0
    if name in DYNAMIC_LAWS:
        for sign in (1, -1):
            at_rest = closed.rates[2].subs(z, closed.rest_state).subs(sigma, sign * positive)
            assert sp.simplify(at_rest) == 0


def test_parameter_named_like_a_plant_symbol_is_refused() -> None:
    class Clash(Dahl):
        M: float = quantity("kg", "clashes with the mass", gt=0)

    with pytest.raises(InputError, match="'M' is the name of a plant symbol"):
        plant.close(Clash)


def oracle(expressions: list[sp.Expr], symbols: list[sp.Symbol]) -> Callable[..., list[float]]:
    """The statement itself in mpmath, 30 digits; the curve by its numeric function, which is tested elsewhere."""
    curve = {"BristleCurve": lambda *arguments: mpmath.mpf(float(curve_force(*map(float, arguments))))}
    exact = sp.lambdify(symbols, [sp.sympify(expression) for expression in expressions], [curve, "mpmath"])

    def numbers(*values: float) -> list[float]:
        with mpmath.workdps(30):
            return [float(value) for value in exact(*map(mpmath.mpf, values))]

    return numbers


@pytest.mark.parametrize("name", ALL_LAWS)
def test_functions_are_the_statement_for_numbers_and_arrays(name: str) -> None:
    law = sample_law(name)
    functions, closed, p = numeric_plant(type(law)), plant.close(type(law)), plant_parameters(law, VEHICLE)
    symbols = [*(symbol(n) for n in (*plant.ARGUMENTS, *plant.VEHICLE_PARAMETERS)), *type(law).symbols()]
    rows = states(law, 6, seed=1)
    for function, expressions in vars(closed).items():
        exact = oracle(flat(expressions), symbols)
        together = flat(getattr(functions, function)(*rows.T, p))
        for i, row in enumerate(rows):
            expected = exact(*map(float, row), *p)
            # Machine precision of sums whose terms cancel: some ten roundings of the largest entry's terms.
            scale = max(1.0, float(np.max(np.abs(expected))))
            for found in (flat(getattr(functions, function)(*row, p)), [np.broadcast_to(x, 6)[i] for x in together]):
                np.testing.assert_allclose(np.array(found, dtype=float), expected, rtol=1e-12, atol=2e-14 * scale)


@pytest.mark.parametrize("name", ALL_LAWS)
def test_functions_in_a_kernel_are_the_same_and_powers_the_whole_loss_of_kinetic_energy(name: str) -> None:
    law = sample_law(name)
    numeric, table = numeric_plant(type(law)), adhesion_table(law, VEHICLE.wheel_load)
    kernel = module_of(module_text(type(law), compiled=False), compiled=False)  # in the interpreter
    p, (radius, J_, M_) = plant_parameters(law, VEHICLE), (0.43, 60.35, 3517.0)
    points = states(law, 100, seed=3)
    largest = max(float(np.max(np.abs([numeric.force(*row, p) for row in points]))), 1.0)
    assert has_table(type(law)) == (name in ("curve", "table"))
    # of a force from a table the cubic's error is below 1e-11 of the largest force; the others are the same text
    share = 1e-11 if has_table(type(law)) else 1e-15
    tolerance = 10 * share * largest * (radius**2 / J_ + 1 / M_)
    for row in points:
        speed, slip, _, torque, disturbance, random = row
        force = float(numeric.force(*row, p))
        assert kernel.adhesion_force(*row, p, table) == pytest.approx(force, rel=1e-12, abs=share * largest)
        rates = [float(x) for x in numeric.rates(*row, p)]
        assert kernel.rates(*row, p, table) == pytest.approx(rates, rel=1e-11, abs=tolerance)
        jacobian = np.array(numeric.jacobian(*row, p), dtype=float)
        # the curve's slope is alpha times the difference of 1 and h F, which cancels: 1e-11 of its terms is left
        near = {"rel": 1e-9, "abs": 1e-9 * (np.abs(jacobian).max() + 1e3)}
        assert kernel.stiffness(*row, p, table) == pytest.approx(jacobian[1:, 1:3].ravel(), **near)
        found = kernel.rates_and_powers(*row, p, table)
        assert found[:3] == pytest.approx(rates, rel=1e-11, abs=tolerance)
        omega, resistance = (speed - slip) / radius, 210.0 + 13.0 * speed + 0.63 * speed**2
        expected = (torque * omega, force * slip, 0.25 * omega**2, resistance * speed)
        expected += (random / radius * slip, disturbance * omega)
        assert len(written.WORKS) == len(found[3:])
        # a force from a table is within 1e-11 of 1e4 N: times the slip velocity at most 3e-6 W
        assert found[3:] == pytest.approx(expected, rel=1e-12, abs=3e-6)
        loss = -(M_ * speed * rates[0] + J_ * omega * (rates[0] - rates[1]) / radius)
        assert math.fsum(found[3:]) == pytest.approx(loss, rel=1e-9, abs=3e-5)  # some 1e6 W cancel in it


@pytest.mark.parametrize("name", law_names())
def test_committed_code_is_what_the_statement_generates(name: str) -> None:
    committed = (written.GENERATED / f"{name}.py").read_text(encoding="utf-8")
    assert committed == written.generate(law_class(name)), "run `make generate`"
    assert numeric_plant(law_class(name)).__file__ == str(written.GENERATED / f"{name}.py")
    assert {path.stem for path in written.GENERATED.glob("*.py")} == {*law_names(), "__init__", "sliding_law"}


def test_code_that_does_not_fit_its_sources_is_generated_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("model/plant.py", "core/notation.toml"):
        path, content = tmp_path / name, (written.PACKAGE / name).read_bytes()
        path.parent.mkdir()
        path.write_bytes(content)
    monkeypatch.setattr("railslip_ctrl.model.numeric.PACKAGE", tmp_path)
    assert numeric_plant.__wrapped__(Dahl).__file__ == str(written.GENERATED / "dahl.py")
    path.write_bytes(content + b"\n")
    assert numeric_plant.__wrapped__(Dahl).__name__ == "generated_dahl"
    monkeypatch.undo()
    (tmp_path / "model" / "_generated").mkdir()
    monkeypatch.setattr(sliding, "LAW_FILE", tmp_path / "model" / "_generated" / "sliding_law.py")
    monkeypatch.setattr(sliding, "generate_law", str)
    sliding.main()
    for name in law_names():
        assert (sliding.LAW_FILE.parent / f"{name}.py").read_text() == (written.GENERATED / f"{name}.py").read_text()
    code = "import sys, railslip_ctrl as rs\n"
    code += 'rs.linearize(rs.operating_point(rs.published_law("bristle", "dry"), rs.PARK2008, 27.0, 0.132))\n'
    code += "print([name for name in ('sympy', 'control', 'matplotlib', 'scipy') if name in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout == "[]\n"


class NewLaw(Burckhardt):
    """Burckhardt's curve, stated with what a printer has to know beside the package's own laws, and here is nought."""

    name = "new_law"

    @classmethod
    def statement(cls) -> Statement:
        (c1, c2, c3), slip = cls.symbols(), sigma / v
        mu = sp.sign(slip) * c1 * (1 - sp.exp(-c2 * sp.Abs(slip))) - c3 * slip
        more = sp.Piecewise((sp.Max(slip, c1, 2 * c1) * 0.125, (slip > 2) & (slip < 3)), (sp.Min(0, c1, c2), True))
        return Statement(force=symbol("N") * (mu + more))


def test_a_law_that_is_not_the_package_s_is_printed_and_linearised() -> None:
    law = NewLaw(c1=0.86, c2=33.82, c3=0.35)
    assert not hasattr(numeric_plant(NewLaw), "__file__")
    found = written.peak(law, 20.0, 34_500.0)
    # oracle: Burckhardt wet, peak 0.80391 at 0.13069; tolerance half a unit of the last digit
    assert (found.slip, found.coefficient) == pytest.approx((0.13069, 0.80391), abs=0.5e-5)
    # SymPy's derivative drops the jump of sign(sigma) at 0: a silent -b3 instead of b1 b2 - b3
    with pytest.raises(KinkError, match="slip: 0"):
        linearize(operating_point(law, PARK2008, 20.0, 0.0))
    run = "@entry\ndef run(v, sigma, p, table):\n    return force(v, sigma, 0.0, 0.0, 0.0, 0.0, p, table)\n"
    p, kernel = np.array(plant_parameters(law, PARK2008)), module_of(module_text(NewLaw, run))
    for slip, more in ((0.1, 0.0), (2.5, 2.5 * 0.125)):  # where the maximum counts too
        exact = numeric_plant(NewLaw).force(20.0, slip * 20.0, 0.0, 0.0, 0.0, 0.0, p)
        assert kernel.run(20.0, slip * 20.0, p, np.zeros(1)) == pytest.approx(exact, rel=1e-14)
        assert exact == pytest.approx(34_500.0 * (0.86 * (1 - np.exp(-33.82 * slip)) - 0.35 * slip + more))


V100 = 100.0 * KMH
BRISTLE = published_law("bristle", Rail.DRY)


def bristle_point(slip: float = 0.132):
    return operating_point(BRISTLE, PARK2008, V100, slip)


def static_pole(slope: float) -> float:
    return -(1 / 3517 + 0.43**2 / 60.35) * slope - 0.25 / 60.35  # system.md, section 2


def test_the_published_operating_point() -> None:
    """Dry, 100 km/h, slip 0.132, 3517 kg; tolerance half a unit of the last digit."""
    point = bristle_point()
    assert point.brake_torque == pytest.approx(4787.78, abs=0.005)
    assert point.adhesion_coefficient == pytest.approx(0.29850, abs=0.5e-5)
    assert (point.adhesion, point.rail, point.slip) == ("bristle", Rail.DRY, 0.132)
    assert point.speed_kmh == pytest.approx(100.0, rel=1e-15)
    assert point.residual < 1e-14  # a few roundings
    plant = linearize(point)
    assert plant.poles.real == pytest.approx([0.82083763, -8.63596062], abs=0.5e-8)
    assert (plant.poles.imag == 0.0).all()
    np.testing.assert_allclose(plant.C, [[1, 0], [1 / V100, 0], [-1, 0]], rtol=1e-15)
    np.testing.assert_allclose(plant.B, [[0.43 / 60.35], [0.0]], rtol=1e-14)  # r/J
    # z eliminated at rest: the slope of the static characteristic Fa = (gamma - sigma)/beta
    reduced = plant.A[0, 0] - plant.A[0, 1] * plant.A[1, 0] / plant.A[1, 1]
    assert reduced == pytest.approx(static_pole(-1.0 / BRISTLE.parameters()[1]), rel=1e-12)  # closed form
    assert reduced == pytest.approx(0.91, abs=0.005)
    full = linearize(point, speed_state=True)
    assert full.states == ("v", "sigma", "z")
    np.testing.assert_allclose(full.C, [[0, 1, 0], [-0.132 / V100, 1 / V100, 0], [0.132, -1, 0]], rtol=1e-15)
    np.testing.assert_array_equal(plant.A, full.A[1:, 1:])
    # Freezing the speed is a good approximation of the slip mode: v moves by (Fa + Fr)/M = 3 m/s^2 only through
    # the 1/M terms, 5 % of r^2/J; here the unstable pole moves by less than 1e-3 of itself.
    assert full.poles[0].real == pytest.approx(plant.poles[0].real, rel=1e-3)


def test_a_published_law_is_refused_for_a_vehicle_of_another_wheel_load() -> None:
    """mu would be that of other forces: 0.084 in place of 0.2985 at the coach's load."""
    coach = PARK2008.model_copy(update={"wheel_load": 122.6e3})
    with pytest.raises(InputError, match=r"wheel load of 34500 N, .* 122600 N; .*published_law"):
        operating_point(BRISTLE, coach, V100, 0.132)
    mu = bristle_point().adhesion_coefficient
    own = published_law("bristle", Rail.DRY, wheel_load=coach.wheel_load)
    for law in (own, BRISTLE.at_wheel_load(coach.wheel_load / PARK2008.wheel_load)):
        assert operating_point(law, coach, V100, 0.132).adhesion_coefficient == pytest.approx(mu, rel=1e-12)
    # one without forces is of any load
    assert operating_point(published_law("burckhardt", Rail.DRY), coach, V100, 0.132).adhesion_coefficient > 0.2


@pytest.mark.parametrize("rail", Rail)
@pytest.mark.parametrize("name", ALL_LAWS)
def test_against_python_control(name: str, rail: Rail) -> None:
    law = sample_law(name, rail)
    slip = law.reference_slip(rail) or 0.11
    point = operating_point(law, PARK2008, 70.0 * KMH, slip)
    ours, frozen = linearize(point, speed_state=True), linearize(point)
    system = nonlinear_plant(law, PARK2008, reference_slip=slip)
    z = [] if point.adhesion_state is None else [point.adhesion_state]
    theirs = ct.linearize(system, [point.speed, point.sigma, *z], [point.brake_torque, 0.0, 0.0], eps=1e-6)
    # forward differences with step 1e-6: truncation 1e-6 f''/2 and rounding 1e-16 * 1e2/1e-6
    tolerance = {"rtol": 2e-6, "atol": 2e-6}
    np.testing.assert_allclose(theirs.A, ours.A, **tolerance)
    np.testing.assert_allclose(theirs.A[1:, 1:], frozen.A, **tolerance)
    random = [-1 / (0.43 * 3517), -1 / (0.43 * 3517) - 0.43 / 60.35, 0.0][: len(ours.states)]  # Tr in (3) and (4)
    np.testing.assert_allclose(theirs.B, np.column_stack([ours.B, ours.B, random]), **tolerance)  # Td beside Tb in (3)
    np.testing.assert_allclose(theirs.C[:3], ours.C, **tolerance)
    np.testing.assert_allclose(theirs.C[3:, :2], [[1.0, 0.0], [1 / 0.43, -1 / 0.43]], **tolerance)  # v and omega
    np.testing.assert_array_equal(theirs.D[:3, :1], ours.D)
    labels = ["sigma", "lambda", "error", "v", "omega"]
    assert (system.state_labels, system.output_labels) == (list(ours.states), labels)
    for speed, each in itertools.product((5.0, 40.0, 100.0), (0.001, 0.05, 0.6)):
        at = operating_point(law, PARK2008, speed * KMH, each)
        z = [] if at.adhesion_state is None else [at.adhesion_state]
        rate = system.dynamics(0.0, [at.speed, at.sigma, *z], [at.brake_torque, 0.0, 0.0])
        # lambda' = (sigma' - lambda v')/v; accelerations of 100 m/s^2 cancel to rounding
        assert rate[1] - each * rate[0] == pytest.approx(0.0, abs=1e-11)


@pytest.mark.parametrize("name", ALL_LAWS)
@pytest.mark.parametrize("speed_state", [False, True])
def test_poles_zeros_and_transfer_function(name: str, speed_state: bool) -> None:
    plant = linearize(operating_point(sample_law(name), PARK2008, V100, 0.12), speed_state=speed_state)
    system = plant.to_control()
    assert (system.state_labels, system.input_labels) == (list(plant.states), ["brake_torque"])
    assert (system.output_labels, plant.speed_state) == (["sigma", "lambda", "error"], speed_state)
    to_sigma = system["sigma", "brake_torque"]
    # two ways to the same eigenvalues: roundings of entries of order 1e3
    np.testing.assert_allclose(np.sort_complex(plant.poles), np.sort_complex(ct.poles(to_sigma)), atol=1e-9)
    np.testing.assert_allclose(np.sort_complex(plant.zeros), np.sort_complex(ct.zeros(to_sigma)), atol=1e-9)
    (num, den), s = plant.transfer_function(), 0.3 + 1.7j
    assert np.polyval(num, s) / np.polyval(den, s) == pytest.approx(complex(to_sigma(s)), rel=1e-9)


def test_the_pole_of_a_static_law_is_its_slope() -> None:
    for name, slip in (("polach", 0.05), ("burckhardt", 0.05), ("curve", 0.2), ("beam", 0.02)):
        law, h = published_law(name, Rail.WET), 1e-6
        high, low = (adhesion_coefficient(law, V100, s, PARK2008.wheel_load) for s in (slip + h, slip - h))
        plant = linearize(operating_point(law, PARK2008, V100, slip))
        slope = PARK2008.wheel_load * (high - low) / (2 * h * V100)
        assert plant.poles == pytest.approx([static_pole(slope)], rel=1e-6)  # truncation h^2 and rounding eps/h
    # dFa/dlambda at 0: Kx for the beam (9); 0 for the curve, which starts as alpha s^2/(2 R); Polach's whatever mu is
    polach, tyre = (published_law(other, Rail.WET) for other in ("polach", "burckhardt"))
    slopes = {"beam": 274_360.0, "curve": 0.0, "burckhardt": 34_500.0 * (tyre.c1 * tyre.c2 - tyre.c3)}
    slopes["polach"] = (polach.kA + polach.kS) / 2 * polach.G * polach.a * polach.b * polach.c11
    for other, slope in slopes.items():
        at_zero = linearize(operating_point(published_law(other, Rail.WET), PARK2008, V100, 0.0))
        assert at_zero.poles[0].real == pytest.approx(static_pole(slope / V100), rel=1e-12)  # rounding


def test_points_out_of_range() -> None:
    for slip in (1.0, -0.1, 1.5, math.nan, math.inf):
        with pytest.raises(DomainError, match="locked wheel" if slip == 1.0 else "0 <= slip < 1"):
            bristle_point(slip)
    for speed in (0.0, -3.0, math.nan, math.inf):
        with pytest.raises(DomainError, match="speed"):
            operating_point(published_law("beam", Rail.DRY), PARK2008, speed, 0.1)
    with pytest.raises(DomainError, match="gamma"):
        operating_point(published_law("bristle", Rail.DRY, 140.0), PARK2008, 140 * KMH, 0.83)
    for name in DYNAMIC_LAWS:
        with pytest.raises(KinkError, match="undefined"):
            operating_point(sample_law(name), PARK2008, V100, 0.0)


@pytest.mark.parametrize("name", DYNAMIC_LAWS)
def test_a_rolling_wheel_swings_against_its_bristles(name: str) -> None:
    """Closed form: with z' = sigma and F = F_z z + F_s sigma, s^2 + (k F_s + B/J) s + k F_z, k = 1/M + r^2/J."""
    law, k = sample_law(name), 1 / 3517 + 0.43**2 / 60.35
    plant = linearize_rolling(law, PARK2008, V100)
    load = PARK2008.wheel_load if name == "tyre_lugre" else 1.0  # its coefficients are normalised
    friction = load * (getattr(law, "alpha1", 0.0) + getattr(law, "alpha2", 0.0))
    expected = np.roots([1.0, k * friction + 0.25 / 60.35, k * load * law.alpha])
    np.testing.assert_allclose(np.sort_complex(plant.poles), np.sort_complex(expected), rtol=1e-9)
    assert (plant.point.slip, plant.point.adhesion_state, plant.point.adhesion_force) == (0.0, 0.0, 0.0)
    static = published_law("curve", Rail.DRY)
    at_0 = linearize(operating_point(static, PARK2008, V100, 0.0))
    np.testing.assert_array_equal(linearize_rolling(static, PARK2008, V100).A, at_0.A)


@pytest.mark.parametrize("rail", Rail)
def test_kink_of_the_beam(rail: Rail) -> None:
    law = published_law("beam", rail)
    (kink,) = law.kinks(V100, PARK2008.wheel_load)
    for off in (-0.5e-9, 0.0, 0.5e-9):
        with pytest.raises(KinkError, match="whole footprint"):
            linearize(operating_point(law, PARK2008, V100, kink.slip * (1 + off)))
    below, above = (linearize(operating_point(law, PARK2008, V100, kink.slip * (1 + off))) for off in (-3e-9, 3e-9))
    assert abs(below.poles[0] - above.poles[0]) > 0.1  # the derivative does jump there


def test_a_law_with_a_wrong_rest_state_is_found_out() -> None:
    class WrongRest(Dahl):
        name: ClassVar[str] = "wrong_rest"

        @classmethod
        def statement(cls) -> Statement:
            right = super().statement()
            return replace(right, steady_state=right.steady_state / 2)

    law = WrongRest(alpha=1e4, Fc=9e3)
    for slip in (0.1, 0.01):
        with pytest.raises(
            DomainError, match=r"slip 0\.\d+, .*\(residual 5.0e-01"
        ):  # z'/sigma = 1 - alpha z/Fc, z halved
            operating_point(law, PARK2008, V100, slip)
